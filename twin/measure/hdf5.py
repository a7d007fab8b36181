"""Reading HDF5 that others wrote: what is missing, malformed or in another unit becomes one clear line."""

import os
import re
import reprlib
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError, tell
from twin.files import replacing
from twin.parallel import isolated
from twin.ranges import MOST_CHARACTERS, check_array, check_size

_DIMENSION = {  # exponents of m, kg, s of every unit that is SI without a factor
    "m": (1, 0, 0),
    "kg": (0, 1, 0),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "Hz": (0, 0, -1),
    "Nm": (2, 1, -2),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
}
_SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴", "-01234")
_TOKEN = re.compile(r"\s*(?:(?P<unit>kg|Hz|[a-zA-Zµ°%]+|1)(?:\^|\*\*)?(?P<power>[-+]?\d+)?|(?P<mark>[/*·().⋅]))\s*")


def _dimension(unit: str) -> tuple[int, ...] | None:
    """Exponents of m, kg, s in ``unit`` (a / holds for the next factor or bracket), None unless plain SI."""
    text = re.sub(r"\^\((-?\d+)\)", r"^\1", unit.translate(_SUPERSCRIPT))
    total, sign, outer, at = np.zeros(3, dtype=int), 1, [1], 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            return None
        at = token.end()
        match token["mark"]:
            case "/":
                sign = -1
            case "(":
                outer.append(outer[-1] * sign)
                sign = 1
            case ")":
                if len(outer) == 1:
                    return None
                outer.pop()
                sign = 1
            case None:
                if token["unit"] not in _DIMENSION:
                    return None
                power = sign * outer[-1] * int(token["power"] or 1)
                total += power * np.array(_DIMENSION[token["unit"]])
                sign = 1
    return tuple(int(n) for n in total)


def check_unit(source: str | Path, field: str, unit: str, *expected: str) -> None:
    """Raise :class:`InputError` unless ``unit`` is one of the SI units ``expected``, however it is spelt."""
    if _dimension(unit) not in [_dimension(one) for one in expected]:
        raise InputError(source, f"{field}: unit", f"expected {' or '.join(expected)}, found {unit!r}")


def _plain(value: Any) -> Any:
    """An attribute or string dataset as plain Python: bytes decoded, arrays of one unpacked."""
    if isinstance(value, np.ndarray):
        if value.size == 1:
            return _plain(value.reshape(-1)[0])
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace")
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value


@contextmanager
def undamaged(source: Path) -> Iterator[None]:
    """What the library says of a damaged file inside becomes an :class:`InputError`."""
    try:
        yield
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError) as error:
        raise InputError(source, "", f"the file is damaged, expected it whole ({error})") from error


LOOKED_S = 2  # of CPU for one object of a file: more hangs
READ = 1 << 20  # bytes of a data set that are read to look whether they can be; of a larger one its chunks are counted


@contextmanager
def opened(path: Path, expected: str = "expected an HDF5 file") -> Iterator[h5py.File]:
    """An HDF5 file, to read. A process of its own goes through it before: some damaged files end or hang their reader.

    Raises:
        InputError: no HDF5 (``expected`` is said), or damaged.
    """
    if not h5py.is_hdf5(path):
        raise InputError(path, "", expected)
    at = path.stat()
    if not _readable(path.absolute(), at.st_size, at.st_mtime_ns):
        raise InputError(path, "", "the file is damaged, expected it whole")
    try:
        file = h5py.File(path)
    except OSError as error:
        raise InputError(path, "", expected) from error
    with file, undamaged(path):
        yield file


@cache
def _readable(path: Path, size: int, changed_ns: int) -> bool:
    """Whether the process that goes through a file of this size and date lives; true where none can be forked."""
    caller = os.getpid()
    try:
        return isolated(lambda: os.getpid() == caller or _gone_through(path))
    except EOFError:
        return False


def _gone_through(path: Path) -> bool:
    """What the library refuses is no matter here: whoever reads it is told then, with the name of the field.

    The process ends if it takes too long: it must be one of its own.
    """
    met: set[int] = set()

    def look(item: Any) -> None:
        _allow(LOOKED_S)
        with suppress(Exception):
            if (place := h5py.h5o.get_info(item.id).addr) in met:
                return
            met.add(place)
            for name in item.attrs:
                with suppress(Exception):
                    item.attrs[name]
            if isinstance(item, h5py.Dataset):
                if item.nbytes <= READ:
                    item[()]
                elif item.chunks:
                    item.id.get_num_chunks()
                return
            for name in item:
                with suppress(Exception):
                    look(item[name])

    with suppress(Exception), h5py.File(path) as file:
        look(file["/"])
    return True


def _allow(seconds: int) -> None:
    """End this process after so many more seconds of CPU."""
    if sys.platform != "win32":
        import resource

        most = resource.getrlimit(resource.RLIMIT_CPU)[1]
        soon = int(time.process_time()) + 1 + seconds
        resource.setrlimit(resource.RLIMIT_CPU, (soon if most < 0 else min(soon, most), most))


class _Disk:
    """A file that the HDF5 library writes into, and that keeps the error of a full disk for whoever opened it.

    The library itself would end the process over such an error.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, data: bytes) -> int:
        left = memoryview(data).cast("B")
        count = len(left)
        try:
            while len(left) and self.error is None:
                left = left[self._stream.write(left) :]
        except OSError as error:
            self.error = error
        return count

    def truncate(self, size: int | None = None) -> int:
        if self.error is None:
            try:
                return self._stream.truncate(size)
            except OSError as error:
                self.error = error
        return size or 0

    def read(self, size: int = -1) -> bytes:
        return self._stream.read(size)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        return self._stream.tell()

    def flush(self) -> None:
        pass  # nothing is kept back


@contextmanager
def created(path: str | Path) -> Iterator[h5py.File]:
    """A new HDF5 file, to write; it appears whole or not at all.

    Raises:
        OSError: there is no room for it, or no permission.
    """
    with replacing(path) as scratch:
        with scratch.open("w+b", buffering=0) as stream:
            disk = _Disk(stream)
            try:
                with h5py.File(disk, "w") as file:
                    yield file
            except (OSError, RuntimeError):  # that the library met because of it
                if disk.error is None:
                    raise
        if disk.error is not None:
            raise OSError(disk.error.errno, disk.error.strerror, str(path)) from disk.error


class Node:
    """A group or dataset of an open file; every reading method raises :class:`InputError` for what it cannot read."""

    def __init__(self, source: Path, item: h5py.Group | h5py.Dataset) -> None:
        self.source, self.item = source, item
        self.field = item.name.strip("/")

    def fail(self, name: str, expected: str) -> InputError:
        return InputError(self.source, name, expected)

    def attribute(self, name: str) -> Any:
        """Plain value, None where absent."""
        try:
            return _plain(self.item.attrs[name]) if name in self.item.attrs else None
        except (OSError, TypeError, ValueError, RuntimeError) as error:
            raise self.fail(f"{self.field}: {name}".strip(": "), f"expected a number or text ({error})") from error

    def text(self, name: str) -> str | None:
        value = self.attribute(name)
        if value is None or isinstance(value, h5py.Empty):
            return None
        if not isinstance(value, str):
            raise self.fail(f"{self.field}: {name}".strip(": "), f"expected text, found {reprlib.repr(value)}")
        if len(value) > MOST_CHARACTERS:
            raise self.fail(f"{self.field}: {name}".strip(": "), f"expected at most {MOST_CHARACTERS} characters")
        return value

    def tell_unknown(self, *known: str) -> None:
        """Tell of what else a group holds: it is not read, and may be a known name that was misspelt."""
        if strange := [name for name in self.item if name not in known]:
            some = ", ".join(map(reprlib.repr, strange[:3])) + (f" and {len(strange) - 3} more" * (len(strange) > 3))
            tell(
                self.source, self.field, f"holds {some}, which no reader knows: not read; known are {', '.join(known)}"
            )

    def number(self, name: str, default: float | None = None) -> float | None:
        value = self.attribute(name)
        if value is None or isinstance(value, h5py.Empty):
            return default
        try:
            found = float(value)
        except (TypeError, ValueError, OverflowError):
            raise self.fail(f"{self.field}: {name}".strip(": "), f"expected a number, found {value!r}") from None
        check_array(self.source, f"{self.field}: {name}".strip(": "), np.array([found]))
        return found

    def _get(self, name: str) -> Any:
        try:
            return self.item.get(name)
        except (OSError, RuntimeError, KeyError) as error:
            raise self.fail(
                f"{self.field}/{name}".strip("/"), "expected data, found a link that leads nowhere"
            ) from error

    def group(self, name: str) -> "Node":
        item = self._get(name)
        if not isinstance(item, h5py.Group):
            what = "it is missing" if item is None else "found a dataset"
            raise self.fail(f"{self.field}/{name}".strip("/"), f"expected a group, {what}")
        return Node(self.source, item)

    def dataset(self, name: str) -> "Node":
        item = self._get(name)
        if not isinstance(item, h5py.Dataset):
            what = "it is missing" if item is None else "found a group"
            raise self.fail(f"{self.field}/{name}".strip("/"), f"expected a dataset, {what}")
        if item.shape is None:
            raise self.fail(f"{self.field}/{name}".strip("/"), "expected data, found an empty data set")
        check_size(self.source, f"{self.field}/{name}".strip("/"), int(item.size))
        return Node(self.source, item)

    def has(self, name: str) -> bool:
        return name in self.item

    def real(self, name: str, *unit: str, part: slice = slice(None)) -> NDArray[np.float64]:
        node = self.dataset(name)
        if node.item.dtype.kind not in "iuf":
            raise self.fail(node.field, f"expected real numbers, found {node.item.dtype}")
        node.check_unit(*unit)
        try:
            values = np.asarray(node.item[part] if node.item.shape else node.item[()], dtype=np.float64)
        except OSError as error:
            raise self.fail(node.field, "expected readable data, the file is damaged") from error
        check_array(
            self.source, node.field, values, {"m/s^2": "m/s²", "N·m": "N·m"}.get(unit[0], unit[0]) if unit else ""
        )
        return values

    def check_unit(self, *expected: str) -> None:
        unit = self.text("unit")
        if unit is not None and expected:
            check_unit(self.source, self.field, unit, *expected)

    def complex(self) -> NDArray[np.complex128]:
        dtype = self.item.dtype
        try:
            values = self.item[()]
        except OSError as error:
            raise self.fail(self.field, "expected readable data, the file is damaged") from error
        if (
            dtype.names is not None and len(dtype.names) == 2 and all(dtype[one].kind in "iuf" for one in dtype.names)
        ):  # {real, imag} pairs, as MATLAB writes them
            return np.asarray(values[dtype.names[0]] + 1j * values[dtype.names[1]], dtype=np.complex128)
        if dtype.kind != "c":
            raise self.fail(self.field, f"expected complex numbers, found {dtype}")
        return np.asarray(values, dtype=np.complex128)

    def strings(self, name: str) -> tuple[str, ...]:
        node = self.dataset(name)
        try:
            values = np.atleast_1d(node.item[()])
        except OSError as error:
            raise self.fail(node.field, "expected readable data, the file is damaged") from error
        if values.dtype.kind not in "OSU":
            raise self.fail(node.field, f"expected text, found {node.item.dtype}")
        return tuple(str(_plain(value)) for value in values.ravel())
