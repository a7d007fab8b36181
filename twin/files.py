"""Files that appear whole or not at all: written aside, then renamed."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from twin.errors import InputError
from twin.stopping import unfinished


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A scratch path beside ``path`` that takes its place when the block ends, and vanishes when it fails."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    except OSError as error:
        raise InputError(path, "", f"cannot be written ({error.strerror})") from error
    os.close(handle)
    unfinished.add(Path(scratch))
    try:
        yield Path(scratch)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(scratch, 0o666 & ~umask)
        os.replace(scratch, path)
    except OSError as error:  # of a full disk, which names no file
        error.filename = error.filename or str(path)
        raise
    finally:
        Path(scratch).unlink(missing_ok=True)
        unfinished.discard(Path(scratch))


@contextmanager
def writing(path: str | Path) -> Iterator[TextIO]:
    """A text stream whose content becomes ``path`` when the block ends."""
    with replacing(path) as scratch, scratch.open("w", encoding="utf-8", newline="") as stream:
        yield stream
