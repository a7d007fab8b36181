"""What every reader gives: tables of named channels with the units their file states; and which reader reads what."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.measure.recordings import UFF

EXTRA = 'pip install "twin[import]"'
READERS = {
    ".csv": "text",
    ".tsv": "text",
    ".txt": "text",
    ".trc": "text",
    ".mat": "matlab",
    ".wav": "wave",
    ".tdms": "tdms",
    ".dat": "krc",
    ".bag": "ros_bag",
    ".db3": "ros_bag",
    ".mcap": "mcap_log",
}
"""Suffix → module of this package."""
MOST_SAID = 200  # characters of what a library says: some repeat the bytes they could not read


@dataclass(frozen=True)
class Channel:
    """One series.

    Attributes:
        values: (nt,), or an array of more axes where the file holds one.
        unit: as the file states it; empty where it does not.
    """

    values: NDArray[Any]
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """Channels that were recorded together.

    Attributes:
        name: of the run or record: the file's, or the part of the file.
        channels: by name, in the order of the file.
        sample_rate_hz: where the file states it and holds no clock.
    """

    name: str
    channels: dict[str, Channel]
    sample_rate_hz: float | None = None


def joined(name: str, tables: Sequence[Table]) -> Table:
    """Tables of one run, recorded beside one another, as one.

    A channel that several have with the same values, a clock, is taken once; of other values, it is ``TABLE.CHANNEL``.

    Raises:
        ValueError: channels of different lengths, or two tables of one name.
    """
    names = [table.name for table in tables]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"two files are called {twice}: rename one, for their channels are told apart by it")
    lengths = {table.name: len(next(iter(table.channels.values())).values) for table in tables}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {count}" for name, count in lengths.items())
        raise ValueError(f"expected as many samples in every file of a run, found {found}")
    channels: dict[str, Channel] = {}
    for table in tables:
        for key, channel in table.channels.items():
            others = [t.channels[key] for t in tables if t is not table and key in t.channels]
            same = all(np.array_equal(channel.values, other.values) for other in others)
            channels[key if same else f"{table.name}.{key}"] = channel
    return Table(name, channels, tables[0].sample_rate_hz)


def read_tables(path: Path) -> list[Table]:
    """Tables of a foreign file.

    Raises:
        InputError: no such file, no reader for it, the reader is not installed, or the file is damaged.
    """
    if path.is_dir() and (path / "metadata.yaml").is_file():
        module = "ros_bag"  # ROS 2 keeps a bag in a folder
    elif not path.is_file():
        raise InputError(path, "", "is a folder; expected a file" if path.is_dir() else "no such file")
    elif (suffix := path.suffix.lower()) in READERS:
        module = READERS[suffix]
    else:
        text = f"no reader for {suffix or 'a file without suffix'}; expected {', '.join([*READERS, *UFF])}"
        raise InputError(path, "", text)
    read: Callable[[Path], list[Table]] = import_module(f"twin.importing.{module}").read
    try:
        tables = [table for table in read(path) if table.channels]
    except InputError:
        raise
    except Exception as error:  # whatever a library raises over a damaged file
        if isinstance(error, OSError) and error.filename:  # of the system, which names the file
            raise
        said = str(error).splitlines()[0] if str(error) else repr(error)
        raise InputError(
            path, "", f"cannot be read: {said[:MOST_SAID]}{' …' if len(said) > MOST_SAID else ''}"
        ) from error
    if not tables:
        raise InputError(path, "", "expected channels of numbers, found none")
    return tables


def library(name: str) -> ModuleType:
    """A reader's library.

    Raises:
        InputError: it is not installed; the remedy is in the message.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(name, "", f"is not installed, this format needs it: {EXTRA}") from error


def chosen(names: Sequence[str], wanted: str | Sequence[str]) -> list[str]:
    """Names that a list, or one pattern with ``*``, asks for; those of a pattern by their numbers, in rising order."""
    if not isinstance(wanted, str):
        return list(wanted)
    if wanted in names or "*" not in wanted:
        return [wanted]
    return sorted((n for n in names if fnmatchcase(n, wanted.replace("[", "[[]"))), key=natural)


def natural(name: str) -> list[tuple[int, str]]:
    """Sorting key by which q2 comes before q10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", name)]


def columns(name: str, values: NDArray[Any], unit: str = "") -> dict[str, Channel]:
    """A matrix (nt, n) as channels ``name.1`` … ``name.n``; anything else as one channel."""
    values = np.squeeze(values)
    if values.ndim == 2 and values.shape[0] > values.shape[1] and not np.iscomplexobj(values):
        return {f"{name}.{i + 1}": Channel(column, unit) for i, column in enumerate(values.T)}
    return {name: Channel(values, unit)}
