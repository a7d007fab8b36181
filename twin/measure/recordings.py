"""Recordings of any kind: what a file holds, reading it, and taking what is in memory already in its stead."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import Campaign, forward
from twin.measure.campaign import read_campaign as read_hdf5
from twin.measure.hdf5 import Node, opened
from twin.measure.modal_table import ModalTable, read_modal_table
from twin.measure.motion_log import MotionLog, read_motion_log, write_motion_log
from twin.measure.spectra import HitTable, with_frfs
from twin.robot.description import Robot, load_robot

Kind = Literal["frf-campaign", "modal-table", "motion-log"]
Content = Campaign | MotionLog | ModalTable
Given = str | Path | Content | Sequence[str | Path | Content]
"""What commands take: a path or what was read from it, or several of these."""

read_log = read_motion_log
write_log = write_motion_log

TITLES: dict[Kind, str] = {
    "frf-campaign": "a hammer test (.h5, .uff, .unv)",
    "modal-table": "a modal table (.yaml)",
    "motion-log": "a motion log (.h5, .csv)",
}
UFF = (".uff", ".unv", ".bunv", ".ufb", ".58")
TABLES = (".yaml", ".yml")
SAME = 1e-6  # m, and of unit vectors: points of two tests are the same


@dataclass(frozen=True)
class Recording:
    """A recording, read.

    Attributes:
        kind: of recording; ``content`` is a campaign, motion log or modal table accordingly.
        source: the file (of several universal files the first), or what an object in memory calls itself.
        inputs: the files, or the object: what a result is traced back to.
        hits: posture → which blows counted, where FRFs were computed from time records.
    """

    kind: Kind
    source: str
    content: Any
    inputs: tuple[Any, ...]
    hits: dict[str, HitTable] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """The name without folder and suffix."""
        return Path(self.source).stem

    @property
    def named(self) -> str | None:
        """The robot that the recording names."""
        name: str | None = self.content.robot
        return name

    def named_in(self, folder: str | Path) -> str | None:
        """The same as a file in another folder has to write it: a path beside the recording, relative to the folder."""
        beside = Path(self.source).parent / (self.named or "")
        if self.named and not Path(self.named).is_absolute() and beside.is_file():
            return os.path.relpath(beside, folder)
        return self.named

    @property
    def names(self) -> tuple[str, ...]:
        """Its postures or runs."""
        return tuple(self.content.runs if self.kind == "motion-log" else self.content.postures)

    def described(self, robot: Robot | str | Path | None = None, without: Sequence[str] | None = None) -> Robot:
        """The robot: the one given, else the recording's (looked up beside the file), else kr90; entries removed.

        Raises:
            InputError: no such robot or entry.
        """
        return robot_of(self.source, self.named, robot).without(list(without or []))


def read_campaign(paths: str | Path | Sequence[str | Path]) -> Campaign:
    """Read a hammer test: ``frf-campaign`` files (HDF5) of the same points, or universal files (58, 58b).

    FRFs are computed where the file holds time records of blows alone.

    Args:
        paths: one file, or several that belong together.

    Raises:
        InputError: a file is missing or breaks the contract, or kinds are mixed.
    """
    found: Campaign = read_one([paths] if isinstance(paths, str | Path) else list(paths), "frf-campaign").content
    return found


def read_one(given: Given, *kinds: Kind, robot: Robot | str | Path | None = None) -> Recording:
    """The one recording that was given; hammer tests of the same points are one, see :func:`one_test_each`.

    Args:
        given: files, or what was read from them.
        kinds: that are taken.
        robot: as for :func:`robot_of_all`.

    Raises:
        InputError: it is of another kind, there are several, or those of one test name different robots.
    """
    several = sorted(read_recordings(given), key=lambda one: not one.named)  # who names the robot speaks for all
    found = one_test_each(several)
    if len(found) > 1:
        expected = "is a recording of its own; only hammer tests of the same sensors and hammer points are taken as one"
        raise InputError(found[1].source, "", expected)
    if len(several) > 1:
        robot_of_all(several, robot)
    if found[0].kind not in kinds:
        expected = " or ".join(TITLES[kind] for kind in kinds)
        raise InputError(found[0].source, "", f"expected {expected}, found {TITLES[found[0].kind].partition(' (')[0]}")
    return found[0]


def read_recordings(given: Given) -> list[Recording]:
    """Every recording that was given, in that order; universal files together are one, where the first stands.

    Raises:
        InputError: a file is missing, of no kind, breaks its contract, or is given twice.
        TypeError: an object that is no recording.
    """
    items = [given] if isinstance(given, str | Path | Campaign | MotionLog | ModalTable) else list(given)
    if not items:
        raise InputError("recordings", "", "expected at least one")
    paths = [Path(item) for item in items if isinstance(item, str | Path)]
    for path in paths:
        if paths.count(path) > 1:
            raise InputError(path, "", "is given twice")
    universal = [path for path in paths if path.suffix.lower() in UFF]
    found: list[Recording] = []
    for item in items:
        if not isinstance(item, str | Path):
            found.append(_in_memory(item))
        elif Path(item) not in universal:
            found.append(_read(Path(item)))
        elif Path(item) == universal[0]:
            found.append(_read(*universal))
    sources = [recording.source for recording in found]
    for source in sources:
        if sources.count(source) > 1:
            raise InputError(source, "", "is given twice; recordings in memory are told by their source")
    return found


def one_test_each(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings; hammer tests of the same points are one of all their postures."""
    found: list[Recording] = []
    for one in recordings:
        same = next((k for k, r in enumerate(found) if r.kind == one.kind == "frf-campaign" and _alike(r, one)), None)
        if same is None:
            found.append(one)
            continue
        first = found[same]
        postures, hits = dict(first.content.postures), dict(first.hits)
        for name, posture in one.content.postures.items():
            told = (name, f"{name} ({one.stem})", *(f"{name} ({one.stem} {k})" for k in range(2, len(recordings) + 2)))
            free = next(n for n in told if n not in postures)  # files of several folders may have one name
            postures[free] = replace(posture, name=free)
            hits |= {free: one.hits[name]} if name in one.hits else {}
        content = replace(first.content, postures=postures)
        found[same] = replace(first, content=content, inputs=(*first.inputs, *one.inputs), hits=hits)
    return found


def _alike(one: Recording, other: Recording) -> bool:
    """Whether sensors and hammer points are the same, on the same bodies."""
    return all(
        a.label == b.label and a.body == b.body
        and np.allclose(a.position, b.position, atol=SAME) and np.allclose(a.direction, b.direction, atol=SAME)
        for a, b in ((getattr(r.content, side) for r in (one, other)) for side in ("response", "excitation"))
    )  # fmt: skip


def robot_of(source: str | Path, named: str | None, robot: Robot | str | Path | None = None) -> Robot:
    """The robot given, else the one that a file names (looked up beside it), else kr90.

    Raises:
        InputError: no such robot.
    """
    if robot or not named:
        return load_robot(robot or "kr90")
    try:
        return load_robot(named, relative_to=Path(source).parent)
    except InputError as error:
        if error.source != named:  # the file is there, and has a fault of its own
            raise
        raise InputError(source, "robot", f"{named}: {error.expected}; say which with --robot") from error


def robot_of_all(recordings: Sequence[Recording], robot: Robot | str | Path | None) -> Robot:
    """The one robot of all recordings: the one given, else the one that they name.

    Raises:
        InputError: the recordings name different robots.
    """
    if robot:
        return load_robot(robot)
    first, *others = [one for one in recordings if one.named] or recordings[:1]
    described = first.described()
    for other in others:
        if other.described().model_dump() != described.model_dump():
            raise InputError(
                other.source, "robot",
                f"{other.named!r} is not the same as {first.named!r} of {first.source}; say which with --robot",
            )  # fmt: skip
    return described


def traced(recordings: Sequence[Recording], robot: Robot | str | Path | None) -> list[Any]:
    """What a result is traced back to: recordings, and the robot where it is a file or in memory."""
    found = [item for recording in recordings for item in recording.inputs]
    return [*found, robot] if isinstance(robot, Robot) or (robot and Path(robot).is_file()) else found


def recording_kind(path: str | Path) -> Kind:
    """What a file holds, told by its suffix or the format it states.

    Raises:
        InputError: no such file, or another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "is a folder; expected a file" if path.is_dir() else "no such file")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return "motion-log"
    if suffix in UFF:
        return "frf-campaign"
    if suffix in TABLES:
        return "modal-table"
    with opened(path, "expected a hammer test (HDF5, UFF), a modal table (YAML) or a motion log (HDF5, CSV)") as file:
        kind = Node(path, file).text("format")
    if kind == "trajectory":
        raise InputError(path, "format", "is a trajectory, without torque: nothing was recorded")
    if kind not in ("motion-log", "frf-campaign"):
        raise InputError(path, "format", f"expected 'motion-log' or 'frf-campaign', found {kind!r}")
    return "motion-log" if kind == "motion-log" else "frf-campaign"


def _read(*paths: Path) -> Recording:
    for path in paths:
        kind = recording_kind(path)
    source = str(paths[0])
    if kind == "motion-log":
        return Recording(kind, source, read_motion_log(source), paths)
    if kind == "modal-table":
        return Recording(kind, source, read_modal_table(source), paths)
    if paths[0].suffix.lower() in UFF:
        from twin.measure.uff import read_uff

        campaign = read_uff(paths)
    else:
        campaign = read_hdf5(source)
    return Recording(kind, source, *_with_frfs(campaign, paths))


def _in_memory(content: Content) -> Recording:
    if isinstance(content, MotionLog) and not content.runs:
        raise InputError(content.source, "runs", "there are no runs: expected at least one")
    if isinstance(content, Campaign | ModalTable) and not content.postures:
        raise InputError(content.source, "postures", "there are no postures: expected at least one")
    if isinstance(content, Campaign):
        return Recording("frf-campaign", content.source, *_with_frfs(content, (content,)))
    if isinstance(content, MotionLog):
        return Recording("motion-log", content.source, content, (content,))
    if isinstance(content, ModalTable):
        return Recording("modal-table", content.source, content, (content,))
    raise TypeError(f"expected a path, a Campaign, a MotionLog or a ModalTable, found {type(content).__name__}")


def _with_frfs(campaign: Campaign, inputs: tuple[Any, ...]) -> tuple[Campaign, tuple[Any, ...], dict[str, HitTable]]:
    complete, hits = with_frfs(campaign, campaign.source)
    return forward(complete.source, complete), inputs, hits
