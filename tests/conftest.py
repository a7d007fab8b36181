"""What the tests share: the paper's robot and postures, and a way to run the command as a user would."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does, before numpy is imported

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin.robot.description import Robot, load_robot, parse_robot

WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")  # gw0, gw1 …; none where one process runs all tests
if WORKER and sys.platform == "linux":  # a core of its own: processes that fork more wait for each other
    CORES = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {CORES[int(WORKER[2:]) % len(CORES)]})

POSTURES = {"milling": (0, 70, -100), "upright": (0, 135, -100), "rigid": (0, 135, -140)}


@pytest.fixture(scope="session")
def kr90() -> Robot:
    return load_robot("kr90")


@pytest.fixture(scope="session")
def milling(kr90: Robot) -> np.ndarray:
    return kr90.angles(POSTURES["milling"])


@pytest.fixture(scope="session")
def with_entry(kr90: Robot) -> Callable[..., Robot]:
    """kr90 with one more physics entry, or with only the given effects kept before it is added."""

    def add(effect: str, site: str, keep: tuple[str, ...] | None = None, **values: object) -> Robot:
        data = kr90.model_dump(mode="json")
        if keep is not None:
            data["physics"] = [entry for entry in data["physics"] if entry["effect"] in keep]
        data["physics"].append({"effect": effect, "site": site, **values})
        return parse_robot(data)

    return add


@pytest.fixture(scope="session")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A valid file of every format, made once: only to be read."""
    from tools.fuzz import seeds

    folder = tmp_path_factory.mktemp("valid")
    seeds.make(folder)
    return folder


@pytest.fixture
def copies(valid: Path, tmp_path: Path) -> Path:
    """Copies of all valid files."""
    for file in valid.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path / file.name)
    return tmp_path


@pytest.fixture
def twin(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., SimpleNamespace]:
    """Run ``twin ARGS…`` in this process: exit code, standard output, standard error, JSON where it printed that."""
    from twin.cli import main

    def run(*arguments: str | Path) -> SimpleNamespace:
        monkeypatch.setattr("sys.argv", ["twin", *map(str, arguments)])
        capsys.readouterr()
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        printed = capsys.readouterr()
        data = json.loads(printed.out) if "--json" in arguments and code == 0 else None
        return SimpleNamespace(code=code, out=printed.out, err=printed.err, json=data)

    return run
