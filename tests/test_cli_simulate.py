"""``twin simulate`` as a user runs it: what it prints and writes, and one clear line for every bad input."""

import json
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from test_kr90 import TABLE_7

from twin.commands.describe import describe
from twin.commands.simulate import simulate
from twin.diagnose.large_motion import moved_far
from twin.errors import Told
from twin.measure.campaign import read_campaign
from twin.measure.motion_log import MotionLog, MotionRun, read_motion_log, write_motion_log
from twin.model.recorded import prepare
from twin.robot.description import SHIPPED, Robot

MILLING = 'posture: {name: milling, q_deg: [0, 70, -100], brakes: "on"}\n'


@pytest.fixture
def posture(tmp_path: Path):  # type: ignore[no-untyped-def]
    def write(text: str) -> Path:
        path = tmp_path / "posture.yaml"
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("name", TABLE_7)
def test_shipped_postures_print_table_7_as_json(twin, tmp_path: Path, name: str) -> None:  # type: ignore[no-untyped-def]
    modes_only = tmp_path / f"{name}.yaml"
    text = (SHIPPED / "postures" / f"{name}.yaml").read_text()
    modes_only.write_text(
        "\n".join(line for line in text.splitlines() if not line.startswith("hammer")) + "\nhammer: false\n"
    )
    found = twin("simulate", modes_only, "--json")
    assert found.code == 0
    assert found.json["posture"] == name
    np.testing.assert_allclose([m["frequency_hz"] for m in found.json["modes"][:4]], TABLE_7[name][0], atol=0.02)
    np.testing.assert_allclose([m["damping_percent"] for m in found.json["modes"][:4]], TABLE_7[name][1], atol=0.02)
    assert found.json["modes"][0]["dominant"][0].keys() == {"site", "share"}
    assert found.json["files"] == []


def test_a_blow_that_moves_a_light_arm_beyond_small_motion_is_told(tmp_path: Path) -> None:
    """For the KR90 a blow of 300 N is small motion; one of 10 kN moves it as 300 N move a light arm."""
    blow = {"hits": 1, "duration_s": 2}
    with warnings.catch_warnings():
        warnings.simplefilter("error", Told)
        simulate([0, 70, -100], robot="kr90", hammer=blow)
    with pytest.warns(Told, match="10000 N moves this robot so far"):
        simulate([0, 70, -100], robot="kr90", hammer={**blow, "force_n": 1e4})


def test_a_light_arm_is_hit_with_a_force_that_suits_it_unless_the_file_says_so(tmp_path: Path) -> None:
    """What is written is what fit and diagnose compare with: FRFs of small motion."""
    light = describe(SHIPPED.parent / "twin/examples/arm/arm.urdf").robot
    q_deg, blow = [30, -80, 100, 20, 60, 10], {"hits": 1, "duration_s": 1}
    with pytest.warns(Told, match="300 N moves this robot so far .* so it is hit with 20 N"):
        (posture,) = simulate(q_deg, robot=light, hammer=blow).campaign.postures.values()
    assert posture.peak_force_n == pytest.approx(20, rel=0.02)
    with pytest.warns(Told, match="20 N suits it"):
        found = simulate(q_deg, robot=light, hammer={**blow, "force_n": 300})
    (hard,) = found.campaign.postures.values()
    assert hard.peak_force_n == pytest.approx(300, rel=0.02)
    recordings = prepare(found.campaign, light, "hit hard")
    (note,) = moved_far(light, found.campaign, list(recordings.values()))
    assert note.kind == "linearity"
    assert note.endswith("Hit it with 20 N")


def test_hammer_and_replay_write_what_they_say(twin, posture, kr90: Robot, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    t = np.arange(0, 1, 1 / 250)
    q = np.deg2rad([0, 70, -100]) + np.outer(0.1 * (1 - np.cos(2 * np.pi * t)), [1, 1, -1])
    write_motion_log(tmp_path / "path.h5", MotionLog({"a": MotionRun("a", t, q, 250.0)}, "kr90"))
    file = posture(
        MILLING + "hammer: {force_n: [100, 300], duration_s: 1, hits: 2, response_noise: 0.001}\nreplay: path.h5\n"
    )
    out = tmp_path / "out"
    found = twin("simulate", file, "--out", out)
    assert found.code == 0, found.err
    assert "9.96 Hz" in found.out
    data = json.loads((out / "simulate.json").read_text())
    assert all(Path(file).is_file() for file in data["files"])
    campaign = read_campaign(out / "hammer.h5")
    assert list(campaign.postures) == ["milling@100N", "milling@300N"]
    assert campaign.postures["milling@100N"].frf.shape[1:] == (3, 23)
    assert campaign.postures["milling@300N"].averages == 2
    log = read_motion_log(out / "replay.h5")
    np.testing.assert_allclose(log.runs["a"].position, q, atol=5e-3)
    assert log.runs["a"].torque is not None
    mujoco.MjModel.from_xml_path(str(out / "robot.xml"))
    assert {"modes.png", "modes.rrd", "frf.png", "replay.png", "replay.rrd"} <= {p.name for p in out.iterdir()}


def test_without_and_robot_options(twin, posture) -> None:  # type: ignore[no-untyped-def]
    file = posture(MILLING + "hammer: false\n")
    found = twin("simulate", file, "--json", "--without", "transverse_compliance")
    assert len(found.json["modes"]) == 3
    one = twin("simulate", file, "--json", "--without", "transverse_compliance@joint1.x", "--without", "payload")
    assert len(one.json["modes"]) == 8
    assert twin("simulate", file, "--json", "--robot", "kr90_identified").json["robot"] == "kr90_identified"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("posture: {q_deg: [0, 70]}", "posture.q_deg: expected 3 values for robot kr90, found 2"),
        ("posture: {q_deg: [0, 170, -100]}", "posture.q_deg[1]: joint2 at 170° is outside its limits"),
        ("posture: {q_deg: [0, .nan, -100]}", "posture.q_deg[1]"),
        ("posture: {q_deg: [0, east, -100]}", "posture.q_deg[1]: expected a number, found 'east'"),
        ("posture: {q_deg: [0, 70, -100], brakes: maybe}", "posture.brakes"),
        ("posture: {q_deg: [0, 70, -100], joint4: 3}", "posture.joint4: unknown field"),
        ("hammer: false", "posture: missing"),
        ("robot: nowhere\n" + MILLING, "no such robot"),
        (MILLING + "replay: missing.h5", "replay: missing.h5: no such file"),
        (MILLING + "hammer: {force_n: -3}", "hammer"),
        (MILLING + "hammer: {sample_rate_hz: 100}", "hammer.sample_rate_hz"),
        ("posture: [", "not valid YAML"),
        ("", "expected a mapping"),
    ],
)
def test_bad_posture_files_give_one_line_and_write_nothing(twin, posture, tmp_path: Path, text: str, line: str) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "out"
    found = twin("simulate", posture(text), "--out", out)
    assert found.code == 2
    assert found.out == ""
    assert found.err.count("\n") == 1
    assert line in found.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--without", "gremlins"], "unknown effect 'gremlins'"),
        (["--without", "payload@joint7"], "unknown site 'joint7'"),
        (["--robot", "kr91"], "no such robot"),
    ],
)
def test_bad_options_give_one_line(twin, posture, arguments: list[str], line: str) -> None:  # type: ignore[no-untyped-def]
    found = twin("simulate", posture(MILLING + "hammer: false"), *arguments)
    assert found.code == 2
    assert line in found.err
    assert found.err.count("\n") == 1


def test_missing_file(twin, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    found = twin("simulate", tmp_path / "nothing.yaml")
    assert found.code == 2
    assert "cannot be read" in found.err


def test_a_robot_that_cannot_be(twin, posture, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    good = (SHIPPED / "kr90.yaml").read_text().replace("meshes/kr90", str(SHIPPED / "meshes" / "kr90"))
    for old, new, line in (
        ("mass: 249,", "mass: -249,", "links[1].mass"),
        ("[45.9, 125.9, 125.9,", "[4.9, 25.9, 125.9,", "links[2]: inertia violates the triangle inequality"),
        ("site: joint3.y,", "site: joint4.y,", "unknown site 'joint4.y'"),
        ("effect: gravity_compensator", "effect: antigravity", "unknown effect 'antigravity'"),
    ):
        (tmp_path / "robot.yaml").write_text(good.replace(old, new))
        found = twin("simulate", posture("robot: robot.yaml\n" + MILLING))
        assert found.code == 2
        assert line in found.err, found.err
        assert found.err.count("\n") == 1
