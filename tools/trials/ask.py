"""Put a recording to `twin diagnose` as a user would, and keep what it says."""

import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ruamel.yaml import YAML

from tools.trials.make import EDIT
from tools.trials.store import ROOT, engine_hash, write

TIMEOUT_S = 900.0


def ask(split: Path, name: str, without: list[str]) -> dict[str, Any]:
    """Diagnose one case; a refusal, a crash and a timeout are answers too."""
    recording = split / "recordings" / f"{name}.h5"
    with TemporaryDirectory() as scratch:
        out = Path(scratch) / "out"
        options = [word for entry in without for word in ("--without", entry)]
        begin = time.perf_counter()
        said = _twin("diagnose", str(recording), *options, "--json", "--out", str(out))
        result: dict[str, Any] = {
            "id": name, "engine": engine_hash(), "wall_s": time.perf_counter() - begin, "code": said.returncode,
            "diagnosis": None, "complaint": said.stderr[-2000:], "edit_error": None,
        }  # fmt: skip
        if said.returncode == 0:
            result["diagnosis"] = json.loads(said.stdout)
            result["edit_error"] = _edit(split / "edit" / f"{name}.h5", out / "robot.yaml")
    write(split / "results" / f"{name}.json", result)
    return result


def _twin(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "twin", *arguments]
    try:
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 124, "", "timeout")


def _edit(recording: Path, robot: Path) -> dict[str, float] | None:
    """Error of the model, changed as the robot was and not refitted, on the changed robot's recording."""
    yaml = YAML(typ="safe", pure=True)
    content = yaml.load(robot)
    content["physics"].append({"effect": EDIT.kind, "site": EDIT.site, **EDIT.parameters})
    edited = robot.with_name("edited.yaml")
    yaml.dump(content, edited)
    said = _twin("compare", str(recording), "--robot", str(edited), "--json")
    return json.loads(said.stdout)["error"] if said.returncode == 0 else None
