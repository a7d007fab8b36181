"""Every command on the output of every other, noise-free ones too: an honest result, or one line and exit code 2."""

import contextlib
import io
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin.cli import main
from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log

POSTURE = """robot: kr90
posture: {name: milling, q_deg: [0, 70, -100], brakes: "on"}
hammer: {force_n: 300, duration_s: 2, hits: 2}
replay: path.h5
"""
OUTPUTS = {  # by folder: what a command wrote, or a user has beside it
    "given": ("milling.yaml", "path.h5"),
    "simulate": ("hammer.h5", "replay.h5", "robot.yaml", "robot.xml", "simulate.json", "modes.rrd", "frf.png"),
    "modal": ("modes.yaml", "milling_modes.unv", "modal.json"),
    "fit": ("robot.yaml", "robot.xml", "fit.json", "report.html"),
    "excite": ("trajectory.h5", "excitation1.csv", "excite.json"),
    "identify": ("robot.yaml", "robot.xml", "identify.json"),
    "compare": ("compare.json",),
    "diagnose": ("robot.yaml", "robot.xml", "diagnosis.json", "diagnosis.html", "modes-after.rrd"),
}
COMMANDS = ("simulate", "modal", "fit", "identify", "compare", "diagnose", "view")
ROBOTS = [(folder, name) for folder, names in OUTPUTS.items() for name in names if name.startswith("robot.")]


def run(*arguments: str | Path) -> SimpleNamespace:
    out, err, code, kept = io.StringIO(), io.StringIO(), 0, sys.argv
    sys.argv = ["twin", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    finally:
        sys.argv = kept
    return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What every command writes about one robot, without noise."""
    root = tmp_path_factory.mktemp("cross")
    (root / "given").mkdir()
    (root / "given" / "milling.yaml").write_text(POSTURE)
    time = np.arange(0, 12, 0.004)
    swing = np.sin(2 * np.pi * np.outer(time, [0.2, 0.3, 0.25]) + [0, 1, 2])
    position = np.deg2rad([0, 80, -100]) + 0.4 * swing
    write_motion_log(root / "given" / "path.h5", MotionLog({"path": MotionRun("path", time, position, 250.0)}, "kr90"))
    hammer, replay = root / "simulate" / "hammer.h5", root / "simulate" / "replay.h5"
    for command, *options in (
        ("simulate", root / "given" / "milling.yaml"),
        ("modal", hammer),
        ("fit", hammer, "--starts", "1"),
        ("excite", "--count", "1", "--harmonics", "2"),
        ("identify", replay),
        ("compare", hammer, replay),
        ("diagnose", root / "modal" / "modes.yaml"),
    ):
        found = run(command, *options, "-o", root / command)
        assert found.code == 0, f"{command}: {found.err}"
    return root


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("folder", "name"), [(f, n) for f, names in OUTPUTS.items() for n in names])
def test_a_command_answers_or_refuses_in_one_line(
    written: Path, tmp_path: Path, command: str, folder: str, name: str
) -> None:
    file = written / folder / name
    assert file.is_file()
    if command == "view" and file.suffix == ".rrd":
        return  # opens a viewer
    found = run(command, file, "-o", tmp_path / ("out.rrd" if command == "view" else "out"))
    assert found.code in (0, 2)
    if found.code == 2:
        assert found.err.count("\n") == 1
        assert str(file) in found.err
        assert not list(tmp_path.iterdir())
    else:
        assert found.out.strip()
        assert list(tmp_path.iterdir())


@pytest.mark.parametrize(("folder", "name"), ROBOTS)
def test_a_written_robot_is_taken_as_robot(written: Path, folder: str, name: str) -> None:
    found = run("simulate", written / "given" / "milling.yaml", "--json", "--robot", written / folder / name)
    assert found.code == (0 if name.endswith(".yaml") else 2), found.err
    assert found.err.count("\n") == (name.endswith(".xml"))
