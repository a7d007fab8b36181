"""The output folder of a command: checked before anything is computed, filled only when everything is there."""

import errno
import os
import shutil
import tempfile
from importlib import import_module
from pathlib import Path
from types import TracebackType

from twin.errors import InputError
from twin.parallel import Progress, silent
from twin.result import Result
from twin.stopping import unfinished

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # what a folder may say while it is being filled


def check_out(out: str | Path | None) -> None:
    """Raise before the work starts what would spoil it at the end.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    if out is None:
        return
    out = Path(out)
    if out.exists() and not out.is_dir():
        raise InputError("--out", str(out), "is a file; expected a folder")
    parent = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise InputError("--out", str(out), f"cannot be written: no permission in {parent}")


class Outputs:
    """Context manager: files are written beside the folder and moved into it when all went well.

    Attributes:
        files: where the files will be, in the order they were asked for.
    """

    def __init__(self, out: str | Path) -> None:
        self.out = Path(out)
        self.files: list[str] = []

    def __enter__(self) -> "Outputs":
        parent = self.out.absolute().parent
        parent.mkdir(parents=True, exist_ok=True)
        self.stage = Path(tempfile.mkdtemp(dir=parent, prefix=f".{self.out.name}."))
        unfinished.add(self.stage)
        return self

    def __call__(self, name: str) -> Path:
        """Path to write a file of that name to."""
        self.files.append(str(self.out / name))
        return self.stage / name

    def draw(self, result: Result, progress: Progress = silent) -> dict[str, Path]:
        """Write a result's figures as PNG; file name → where it is for now."""
        from twin.report.figures import save

        figures, images = result.figures(), {}
        tick = progress("figures", len(figures))
        for name, figure in figures.items():
            images[f"{name}.png"] = self(f"{name}.png")
            save(figure, images[f"{name}.png"])
            tick(1)
        return images

    def report(self, result: Result, page: str = "report.html", progress: Progress = silent) -> None:
        """Write a result's figures, and the page that shows them with its tables."""
        from twin.report.html import write_html

        images = self.draw(result, progress)
        told = import_module(result.drawn_by)
        inputs = [f"{name} {digest[:12]}" for name, digest in result.origin["inputs"].items()]
        footer = " · ".join([f"twin {result.origin['version']}", *inputs])
        write_html(self(page), told.title(result), told.lead(result), told.sections(result, images), footer)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None and not self.out.exists():
                umask = os.umask(0)
                os.umask(umask)
                self.stage.chmod(0o777 & ~umask)
                self.stage.rename(self.out)  # the whole folder at once
            elif kind is None:
                for file in sorted(path for path in self.stage.rglob("*") if path.is_file()):
                    target = self.out / file.relative_to(self.stage)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    os.replace(file, target)
        finally:
            shutil.rmtree(self.stage, ignore_errors=True)
            unfinished.discard(self.stage)
        if isinstance(error, OSError) and error.errno in FULL:
            raise InputError("--out", str(self.out), f"cannot be written ({error.strerror})") from error
