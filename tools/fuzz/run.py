"""One case: a child forked from a process that has everything imported, its limits, and what is checked afterwards."""

import os
import random
import re
import resource
import shutil
import signal
import sys
import time
import traceback
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tools.fuzz.mutate import NUMBERS, WORDS, mutate
from tools.fuzz.seeds import TARGETS, Target
from twin.commands.outputs import LISTED

LIMIT_S = 60.0  # a hang
STOPPED_S = 8.0  # --timeout given to every case
MEMORY = 4 << 30  # bytes that a case may take
KEPT = re.compile(r"\.found\.map-[0-9a-f]{12}(/|$)")  # blocks of a map that was stopped: the next run goes on with them
OK = ("accepted", "refused", "stopped", "numerical")


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes:
        kind: accepted, refused, stopped (--timeout), numerical, or a fault: traceback, hang, signal, memory, lines,
            unnamed, partial.
    """

    number: int
    kind: str
    command: list[str]
    change: str
    code: int
    seconds: float
    said: str

    def data(self) -> dict[str, Any]:
        """As a line of the corpus."""
        return asdict(self)


def case(
    number: int, seed: int, seeds: Path, folder: Path, memory: int = MEMORY, stopped: float = STOPPED_S
) -> Outcome:
    """Make a case from its number, run it in a child and judge it; the folder is emptied before."""
    rng = random.Random(f"{seed}:{number}")
    target = rng.choices(TARGETS, [target.weight for target in TARGETS])[0]
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in (target.file, *target.beside):
        shutil.copy(seeds / name, folder / name)
    arguments, change = _line(target, rng, seeds, folder)
    written = rng.random() < 0.15
    where = ["-o", {"view": "found.rrd", "import": "found.h5"}.get(target.command, "found")]
    if "--guess" in arguments:
        where = ["--json"]
    arguments += where if written or target.command == "view" else ["--json"]
    arguments += ["--timeout", str(stopped)]
    before = set(_tree(folder))
    begin = time.monotonic()
    status = _child(arguments, folder, memory)
    seconds = time.monotonic() - begin
    out, said = ((folder / f".{name}").read_text(errors="replace") for name in ("out", "err"))
    after = set(_tree(folder)) - before
    kind, code = judge(status, said, out, after)
    return Outcome(number, kind, arguments, change, code, round(seconds, 2), said[-400:] if said else out[:200])


def _line(target: Target, rng: random.Random, seeds: Path, folder: Path) -> tuple[list[str], str]:
    if target.command == "example":
        word = rng.choice(("cell", *WORDS)).replace("\x00", "")
        return ["example", "--", word] if word.startswith("-") else ["example", word], f"NAME {word[:60]!r}"
    if not (target.numbers and rng.random() < 0.25):
        return target.line(), f"{target.file}: {mutate(seeds / target.file, folder / target.file, rng)}"
    option = rng.choice(target.numbers)
    pair = option in ("--low-pass", "--band", "--rpm")
    values = [str(rng.choice((*NUMBERS, 3, 10, 10**4, 10**9, "x"))) for _ in range(1 + pair)]
    line = target.line()
    if option in line:
        del line[line.index(option) : line.index(option) + 2]
    return [*line, option, *values], f"{option} {' '.join(values)}"


def _tree(folder: Path) -> list[str]:
    return [str(path.relative_to(folder)) for path in folder.rglob("*") if path.name not in (".out", ".err")]


def _child(arguments: list[str], folder: Path, memory: int) -> int | None:
    """Wait status of ``twin ARGUMENTS`` in a forked process; None where it had to be killed."""
    child = os.fork()
    if child == 0:
        inside(arguments, folder, memory)
    deadline, pause = time.monotonic() + LIMIT_S, 0.002
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        time.sleep(pause)
        pause = min(0.05, 1.2 * pause)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def inside(arguments: list[str], folder: Path, memory: int) -> None:
    code = 70
    try:
        os.setpgid(0, 0)
        os.chdir(folder)
        for stream, name in ((1, ".out"), (2, ".err")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        sys.stdout, sys.stderr = (os.fdopen(stream, "w", closefd=False) for stream in (1, 2))
        reserved = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()  # by what is imported
        resource.setrlimit(resource.RLIMIT_AS, (reserved + memory, reserved + memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        sys.argv = ["twin", *arguments]
        from twin.cli import main

        main()
        code = 0
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def judge(status: int | None, said: str, out: str, made: set[str]) -> tuple[str, int]:
    """Kind and exit code of what a child left."""
    if status is None:
        return "hang", -1
    if os.WIFSIGNALED(status):
        return "signal", -os.WTERMSIG(status)
    code = os.waitstatus_to_exitcode(status)
    if "Traceback (most recent call last)" in said or "Traceback" in out:
        return "traceback", code
    if code == 0:
        left = [name for name in (Path(path).name for path in made) if name.startswith(".")]
        return "accepted" if all(name.startswith(LISTED) for name in left) else "partial", code
    if any(not KEPT.match(name) for name in made):
        return "partial", code
    lines = said.strip().splitlines()
    if len(lines) != 1 or not lines[0].startswith("twin: "):
        return "lines", code
    if "not enough memory" in lines[0]:  # without the limit of this process it would have filled the machine
        return "memory", code
    if code == 124:
        return "stopped", code
    if code == 3:
        return "numerical", code
    return ("refused" if lines[0].count(": ") >= 2 else "unnamed"), code
