"""MATLAB .mat: up to v7 through SciPy, v7.3 (an HDF5 file) through h5py. Structures are flattened with dots."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from twin.errors import InputError
from twin.importing.tables import Channel, Table, columns
from twin.measure.hdf5 import opened
from twin.parallel import isolated


def read(path: Path) -> list[Table]:
    """One table with every variable of numbers; a matrix (nt, n) is n channels, ``q.1`` … ``q.n``."""
    channels: dict[str, Channel] = {}
    for name, values in _hdf5(path) if h5py.is_hdf5(path) else _variables(path):
        channels |= columns(name, values)
    return [Table(path.stem, channels)]


def _variables(path: Path) -> list[tuple[str, Any]]:
    """Read in a process of its own where there are such: some damaged files end the process that reads them."""
    try:
        return isolated(lambda: list(_loaded(path)))
    except EOFError:
        raise InputError(path, "", "cannot be read: the file is damaged") from None


def _loaded(path: Path) -> Iterator[tuple[str, Any]]:
    found = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
    for name, value in found.items():
        if not name.startswith("__"):
            yield from _flat(name, value)


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _flat(f"{name}.{field}", getattr(value, field))
    elif np.asarray(value).dtype.kind in "iufcb":
        yield name, np.asarray(value)


def _hdf5(path: Path) -> Iterator[tuple[str, Any]]:
    """MATLAB stores the axes of an array in reverse, and complex numbers as pairs."""
    found: list[tuple[str, Any]] = []

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        values = item[()]
        if item.dtype.names == ("real", "imag"):
            values = values["real"] + 1j * values["imag"]
        if np.asarray(values).dtype.kind in "iufcb":
            found.append((name.replace("/", "."), np.asarray(values).T))

    with opened(path) as file:
        file.visititems(visit)
    yield from found
