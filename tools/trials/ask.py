"""Put recordings to `twin diagnose` as a user would, and keep what it says."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
import traceback
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ruamel.yaml import YAML

from tools.trials.make import EDIT
from tools.trials.store import ROOT, engine_hash, write

LIMIT_S = 300.0
MEMORY_BYTES = 6 * 2**30
EDITED = "01234"  # first digits of the names of the cases that are put to the edit test too: 5 of 16


def ask(
    split: Path,
    name: str,
    without: list[str],
    limit_s: float = LIMIT_S,
    deadline: float | None = None,
    robot: str | None = None,
) -> bool:
    """Diagnose one case and keep the result; a refusal, a crash and a timeout are answers too.

    Whether it was asked: past `deadline` (clock of the machine, s) it is left for another time. `robot`: file of its
    description in the split; `None`: the recording names a shipped one.
    """
    if deadline is not None and time.time() > deadline:
        return False
    result: dict[str, Any] = {"id": name, "engine": engine_hash(), "code": -1, "diagnosis": None, "edit_error": None}
    begin, used = time.perf_counter(), _cpu_s()
    try:
        with TemporaryDirectory() as scratch:
            options = [word for entry in without for word in ("--without", entry)]
            options += ["--robot", str(split / robot)] if robot else []
            _put(split, name, options, limit_s, Path(scratch) / "out", result)
    except Exception:  # of the trial itself: kept with the case, the others go on
        result["complaint"] = traceback.format_exc()
    spent = {"wall_s": time.perf_counter() - begin, "cpu_s": _cpu_s() - used}
    write(split / "results" / f"{name}.json", {**spent, **result})
    return True


def _put(split: Path, name: str, options: list[str], limit_s: float, out: Path, result: dict[str, Any]) -> None:
    recordings = map(str, sorted((split / "recordings" / name).glob("*.h5")))
    begin = time.perf_counter()
    code, said, complaint = run(["diagnose", *recordings, *options, "--json", "--out", str(out)], limit_s)
    result.update(wall_s=time.perf_counter() - begin, code=code, complaint=complaint[-4000:])
    if code == 0:
        result["diagnosis"] = json.loads(said)
        if name[0] in EDITED and (split / "edit" / name).exists():
            result["edit_error"] = _edit(next((split / "edit" / name).glob("*.h5")), out / "robot.yaml", limit_s)


def run(arguments: list[str], limit_s: float) -> tuple[int, str, str]:
    """Exit code, standard output and error of `twin`; 124 past the limit. Time and memory are bounded."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", *arguments], cwd=ROOT, env=environment, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, preexec_fn=_bounded,
    )  # fmt: skip
    try:
        said, complaint = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        said, complaint = process.communicate()
        return 124, said, f"no answer within {limit_s:g} s\n{complaint}"
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    if process.returncode < 0:  # as the system does where memory runs out
        complaint += f"\nkilled by signal {-process.returncode}"
    return process.returncode, said, complaint


def _cpu_s() -> float:
    """Processor time of the commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _bounded() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


def _edit(recording: Path, robot: Path, limit_s: float) -> Any:
    """Error of the diagnosed model, changed as the robot was and not refitted, on the changed robot's recording."""
    yaml = YAML(typ="safe", pure=True)
    content = yaml.load(robot)
    content["physics"].append({"effect": EDIT.kind, "site": EDIT.site, **EDIT.parameters})
    edited = robot.with_name("edited.yaml")
    yaml.dump(content, edited)
    options = ["--robot", str(edited), "--json", "--out", str(robot.parent / "edited")]
    code, said, _ = run(["compare", str(recording), *options], limit_s)
    return json.loads(said)["error"] if code == 0 else None
