"""The output folder of a command: checked before anything is computed, there whole or not at all.

Files are written into a stage beside the folder. A new folder is the stage renamed. A folder that is there already is
exchanged for the stage in one system call: whoever looks sees the old one or the new one. What the same command wrote
before is left behind; everything else in the folder is taken along as hard links.
"""

import ctypes
import errno
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from twin.errors import InputError, tell
from twin.parallel import Progress, cores, silent, spread
from twin.result import Result
from twin.robot.description import SHIPPED
from twin.stopping import hold, holds, unfinished

if TYPE_CHECKING:
    from twin.measure.recordings import Recording

STAGED = ".writing"  # ends the name of a stage
LISTED = ".twin-"  # starts the name of the list of what a command wrote
AT_CWD, EXCHANGE = -100, 2  # AT_FDCWD of fcntl.h, RENAME_EXCHANGE of linux/fs.h
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # what a folder may say while it is being filled


def check_out(out: str | Path | None, *, alone: bool = True) -> None:
    """Raise before the work starts what would spoil it at the end.

    Args:
        out: the folder.
        alone: no other run may have asked for it.

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
    if alone and not hold(str(out.resolve())):
        raise InputError("--out", str(out), "another run is writing there; wait for it, or name another folder")


def check_spared(out: str | Path | None, recordings: "Sequence[Recording]") -> None:
    """Raise where the model that a command writes would replace the one that a recording names.

    Raises:
        InputError: the same command would start from another robot the next time.
    """
    for one in recordings if out is not None else ():
        if one.named and (Path(one.source).parent / one.named).resolve() == (Path(str(out)) / "robot.yaml").resolve():
            text = f"{one.source} names the robot.yaml there, which would be replaced; expected another folder"
            raise InputError("--out", str(out), text)


class Outputs:
    """Context manager: files are written beside the folder, which takes their place when all went well.

    Attributes:
        files: where the files will be, in the order they were asked for.
    """

    def __init__(self, out: str | Path, command: str) -> None:
        self.out, self.command, self.list = Path(out), command, f"{LISTED}{command}"
        self.files: list[str] = []

    def __enter__(self) -> "Outputs":
        self.place = self.out.resolve()
        try:
            self.place.parent.mkdir(parents=True, exist_ok=True)
            if holds(str(self.place)):
                _clear(self.place)
            stage = tempfile.mkdtemp(dir=self.place.parent, prefix=f".{self.place.name}.", suffix=STAGED)
        except OSError as error:
            raise InputError("--out", str(self.out), f"cannot be written ({error.strerror})") from error
        self.stage = Path(stage)
        unfinished.add(self.stage)
        return self

    def __call__(self, name: str) -> Path:
        """Path to write a file of that name to."""
        self.files.append(str(self.out / name))
        return self.stage / name

    def draw(
        self, result: Result, progress: Progress = silent, meanwhile: Callable[[], None] | None = None
    ) -> dict[str, Path]:
        """Write a result's figures as PNG; file name → where it is for now. ``meanwhile`` is called beside that."""
        from twin.report.figures import save

        figures, images = result.figures(), {}
        tick = progress("figures", len(figures))
        for name in figures:
            images[f"{name}.png"] = self(f"{name}.png")
        drawn, paths = list(figures.values()), list(images.values())
        for _ in spread(lambda number: save(drawn[number], paths[number]), len(drawn), cores()):
            tick(1)
            if meanwhile:
                meanwhile()
                meanwhile = None
        if meanwhile:
            meanwhile()
        return images

    def report(
        self,
        result: Result,
        page: str | None = None,
        progress: Progress = silent,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        """Write a result's figures, and the page that shows them with its tables; see :meth:`draw`.

        The page has the command's name by default, so that commands can share a folder.
        """
        from twin.report.html import write_html

        images = self.draw(result, progress, meanwhile)
        told = import_module(result.drawn_by)
        inputs = [f"{_called(name)} {digest[:12]}" for name, digest in result.origin["inputs"].items()]
        footer = " · ".join([f"twin {result.origin['version']}", *inputs])
        target = self(page or f"{self.command}.html")
        write_html(target, told.title(result), told.lead(result), told.sections(result, images), footer)

    def scene(self, result: Result, name: str) -> None:
        """Write what ``twin view`` shows of a result."""
        import_module(result.drawn_by).write_scene(self(name), result)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._publish()
        except OSError as found:
            raise InputError("--out", str(self.out), f"cannot be written ({found.strerror or found})") from found
        finally:
            shutil.rmtree(self.stage, ignore_errors=True)
            unfinished.discard(self.stage)
        if isinstance(error, OSError) and error.errno in FULL:
            raise InputError("--out", str(self.out), f"cannot be written ({error.strerror})") from error

    def _publish(self) -> None:
        made = sorted(str(path.relative_to(self.stage)) for path in self.stage.rglob("*") if path.is_file())
        (self.stage / self.list).write_text("".join(f"{name}\n" for name in made))
        umask = os.umask(0)
        os.umask(umask)
        self.stage.chmod(0o777 & ~umask)
        self._tell_replaced(made)
        if not self.place.exists():
            self.stage.rename(self.place)
        elif self.place in (Path.cwd(), *Path.cwd().parents) or self.place.is_mount():
            self._into(made)  # a folder that is stood in, or mounted, keeps its identity
        else:
            self._take_along()
            exchange(self.stage, self.place)

    def _take_along(self) -> None:
        """Link what this command did not write before into the stage."""
        before = self._before()

        def known(folder: str, names: list[str]) -> set[str]:
            place = Path(folder).relative_to(self.place)
            return {
                name for name in names
                if str(place / name) in before
                or ((self.stage / place / name).exists() and not (self.stage / place / name).is_dir())
            }  # fmt: skip

        shutil.copytree(self.place, self.stage, symlinks=True, ignore=known, copy_function=_link, dirs_exist_ok=True)

    def _into(self, made: list[str]) -> None:
        """Move the files in one by one, and take away those of before."""
        for name in (*made, self.list):
            target = self.place / name
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(self.stage / name, target)
        for name in self._before() - set(made):
            (self.place / name).unlink(missing_ok=True)

    def _before(self) -> set[str]:
        """Names of what the same command wrote into the folder."""
        return _listed(self.place / self.list)

    def _tell_replaced(self, made: list[str]) -> None:
        """Tell of files of another command that have the names of new ones."""
        own = self._before()
        for listed in sorted(self.place.glob(f"{LISTED}*")):
            lost = sorted(name for name in (_listed(listed) & set(made)) - own if (self.place / name).exists())
            if lost and listed.name != self.list:
                some = ", ".join(lost[:3]) + (f" and {len(lost) - 3} more" * (len(lost) > 3))
                command = listed.name.removeprefix(LISTED)
                tell("--out", str(self.out), f"{some} of `twin {command}`: replaced; -o names another folder")


def _listed(path: Path) -> set[str]:
    """Names in a list of what a command wrote."""
    names = path.read_text(errors="replace").splitlines() if path.is_file() else []
    return {name for name in names if not Path(name).is_absolute() and ".." not in Path(name).parts}


def exchange(stage: Path, place: Path) -> None:
    """Two folders change their names at once; where the system cannot, by two renames, one after the other."""
    if sys.platform == "linux":
        try:
            rename = ctypes.CDLL(None, use_errno=True).renameat2
        except (OSError, AttributeError):
            rename = None
        if rename is not None:
            if rename(AT_CWD, os.fsencode(stage), AT_CWD, os.fsencode(place), EXCHANGE) == 0:
                return
            number = ctypes.get_errno()
            if number not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
                raise OSError(number, os.strerror(number), str(place))
    aside = stage.with_name(f"{stage.name}.old")
    place.rename(aside)
    stage.rename(place)
    aside.rename(stage)


def _called(name: str) -> str:
    """A shipped file by its name: where the package is installed is nobody's business."""
    return Path(name).name if Path(name).is_relative_to(SHIPPED) else name


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:  # a file system without links
        shutil.copy2(source, target, follow_symlinks=False)


def _clear(place: Path) -> None:
    """Remove the stages of runs that were killed: the folder is held, no other run is there."""
    stale = re.compile(rf"\.{re.escape(place.name)}\.[a-z0-9_]{{8}}{re.escape(STAGED)}(\.old)?")
    for path in place.parent.iterdir():
        if stale.fullmatch(path.name):
            shutil.rmtree(path, ignore_errors=True)
