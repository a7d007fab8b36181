"""Every command on the output of every other, noise-free ones too: an honest result, or one line and exit code 2."""

import contextlib
import io
import json
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.cli import main
from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log

ROBOT = """name: two
links:
  - {mass: 120, com: [0.1, 0, 0.2], inertia: [4, 5, 3, 0, 0.1, 0]}
  - {mass: 60, com: [0.4, 0, 0], inertia: [0.5, 6, 6, 0, 0, 0]}
axes:
  - {d: 0.5, stiffness: 2.0e6, damping: 900, limits: {position: [-3, 3], velocity: 2, acceleration: 6}}
  - {alpha_deg: 90, a: 0.2, stiffness: 1.5e6, damping: 700, limits: {position: [-2, 2], velocity: 2, acceleration: 6}}
drives: [{gear_ratio: 150, rotor_inertia: 2.0e-3}, {gear_ratio: 120, rotor_inertia: 2.0e-3}]
flange: {position: [0.8, 0, 0]}
test_points:
  - {label: 1X+, body: link2, position: [0.8, 0, 0], direction: [1, 0, 0]}
  - {label: 1Y+, body: link2, position: [0.8, 0, 0], direction: [0, 1, 0]}
  - {label: 1Z+, body: link2, position: [0.8, 0, 0], direction: [0, 0, 1]}
accelerometers: [1Y+, 1Z+]
physics:
  - {effect: transverse_compliance, site: joint1.x, stiffness: 3.0e6, damping: 900}
  - {effect: coulomb_friction, site: joint1, torque: 40}
"""
POSTURE = """robot: two.yaml
posture: {name: bent, q_deg: [10, 40], brakes: "on"}
hammer: {force_n: 300, duration_s: 2, hits: 2}
replay: path.h5
"""
OUTPUTS = {  # by folder: what a command wrote, or a user has beside it
    "given": ("bent.yaml", "two.yaml", "path.h5"),
    "simulate": ("hammer.h5", "replay.h5", "robot.yaml", "robot.xml", "simulate.json", "modes.rrd", "frf.png"),
    "modal": ("modes.yaml", "bent_modes.unv", "modal.json"),
    "fit": ("robot.yaml", "robot.xml", "fit.json", "fit.html"),
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


TRIED: set[tuple[str, Path]] = set()
"""Commands and the file that they were given while the outputs were made."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What every command writes about one robot, without noise."""
    root = tmp_path_factory.mktemp("cross")
    (root / "given").mkdir()
    (root / "given" / "bent.yaml").write_text(POSTURE)
    (root / "given" / "two.yaml").write_text(ROBOT)
    time = np.arange(0, 12, 0.004)
    position = 0.5 * np.sin(2 * np.pi * np.outer(time, [0.2, 0.3]) + [0, 1])
    log = MotionLog({"path": MotionRun("path", time, position, 250.0)}, "two.yaml")
    write_motion_log(root / "given" / "path.h5", log)
    hammer, replay = root / "simulate" / "hammer.h5", root / "simulate" / "replay.h5"
    for command, *options in (
        ("simulate", root / "given" / "bent.yaml"),
        ("modal", hammer),
        ("fit", hammer, "--starts", "1"),
        ("excite", "--robot", root / "given" / "two.yaml", "--count", "1", "--harmonics", "2"),
        ("identify", replay),
        ("compare", hammer, replay),
        ("diagnose", root / "modal" / "modes.yaml"),
    ):
        found = run(command, *options, "-o", root / command)
        assert found.code == 0, f"{command}: {found.err}"
        TRIED.add((command, Path(options[0])))
    return root


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("folder", "name"), [(f, n) for f, names in OUTPUTS.items() for n in names])
def test_a_command_answers_or_refuses_in_one_line(
    written: Path, tmp_path: Path, command: str, folder: str, name: str
) -> None:
    file = written / folder / name
    assert file.is_file()
    if (command, file) in TRIED or (command == "view" and file.suffix == ".rrd"):  # the latter opens a viewer
        return
    found = run(command, file, "-o", tmp_path / ("out.rrd" if command == "view" else "out"))
    assert found.code in (0, 2)
    if found.code == 2:
        assert found.err.count("\n") == 1
        assert str(file) in found.err
        assert not list(tmp_path.iterdir())
    else:
        assert found.out.strip()
        assert list(tmp_path.iterdir())


def test_the_robot_that_a_recording_names_is_not_replaced(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second run of the same command would start from another robot."""
    shutil.copytree(written / "simulate", tmp_path / "out" / "replay")
    monkeypatch.chdir(tmp_path)
    folder = Path("out") / "replay"
    before = (folder / "robot.yaml").read_bytes()
    refused = run("identify", folder / "replay.h5", "-o", folder)
    assert refused.code == 2
    assert "names the robot.yaml there" in refused.err
    assert run("identify", folder / "replay.h5").code == 0
    assert (folder / "robot.yaml").read_bytes() == before
    assert (Path("out") / "replay-identify" / "robot.yaml").is_file()


def test_what_is_rigid_is_told_what_makes_it_soft(written: Path, tmp_path: Path) -> None:
    arm = Path(__file__).parent / "data" / "arm6.urdf"
    for command in ("compare", "fit", "diagnose"):
        found = run(command, written / "simulate" / "hammer.h5", "--robot", arm, "-o", tmp_path / "out")
        assert found.code == 2
        assert "no axis has a stiffness, so nothing can vibrate; `twin describe` fills it in" in found.err


def test_nothing_is_missing_in_a_log_that_the_twin_simulated_without_noise(written: Path, tmp_path: Path) -> None:
    found = run("diagnose", written / "simulate" / "replay.h5", "-o", tmp_path / "out")
    assert found.code == 0, found.err
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert told["verdict"] == "adequate"
    assert not told["effects"]
    assert told["error"]["before"]["train"] <= 1.05 * told["error"]["as_given"]["train"]
    assert not [note["text"] for note in told["triage"] if "standard deviations off" in note["text"]]


class Page(HTMLParser):
    """What a page loads, shows and calls things."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.lang, self.script = "", False
        self.loads: list[str] = []
        self.unnamed = 0
        self.data: list[dict[str, Any]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.lang = given.get("lang") or self.lang
        self.loads += [value for name in ("src", "href") if (value := given.get(name)) and value[:1] != "#"]
        named = given.get("alt") or given.get("aria-label") or "aria-hidden" in given
        self.unnamed += tag in ("img", "svg") and not named
        self.script = tag == "script" and given.get("type") == "application/json"

    def handle_data(self, data: str) -> None:
        if self.script and data.strip():
            self.data.append(json.loads(data))


@pytest.mark.parametrize("folder", [f for f in OUTPUTS if f != "given"])
def test_every_command_writes_a_page_that_loads_nothing_and_names_its_pictures(written: Path, folder: str) -> None:
    (file,) = (written / folder).glob("*.html")
    page = Page(file.read_text(encoding="utf-8"))
    assert page.lang == "en"
    assert page.loads
    assert all(address.startswith("data:image/png;base64,") for address in page.loads)
    assert not page.unnamed
    for plot in page.data:
        assert ", " in plot["x_label"]
        for panel in plot["panels"]:
            assert all(len(curve["y"]) == len(plot["x"][panel["x"]]) for curve in panel["curves"])
    assert bool(page.data) == (folder not in ("excite", "diagnose"))  # of a modal table there are no curves


@pytest.mark.parametrize(("folder", "name"), ROBOTS)
def test_a_written_robot_is_taken_as_robot(written: Path, folder: str, name: str) -> None:
    found = run("simulate", written / "given" / "bent.yaml", "--json", "--robot", written / folder / name)
    assert found.code == (0 if name.endswith(".yaml") else 2), found.err
    said = [line for line in found.err.splitlines() if "moves this robot so far" not in line]  # it is a light one
    assert len(said) == name.endswith(".xml")


def test_recordings_of_one_robot_go_together_wherever_they_lie(written: Path, tmp_path: Path) -> None:
    """A modal table names the robot of its test by another path; a robot without an entry is another one."""
    hammer, table = written / "simulate" / "hammer.h5", written / "modal" / "modes.yaml"
    assert run("diagnose", hammer, table, "--json").code == 0
    run("simulate", written / "given" / "bent.yaml", "--without", "coulomb_friction", "-o", tmp_path / "other")
    refused = run("diagnose", hammer, tmp_path / "other" / "replay.h5")
    assert refused.code == 2
    assert "is not the same as" in refused.err


def test_the_version_is_printed_with_the_name() -> None:
    import twin

    found = run("--version")
    assert (found.code, found.out, found.err) == (0, f"twin {twin.__version__}\n", "")
