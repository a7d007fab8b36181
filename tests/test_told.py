"""What is taken but hardly meant is told; what contradicts itself, or is out of every range, is refused by its name."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from twin.errors import InputError, Told
from twin.importing.plausible import check_log
from twin.measure.campaign import read_campaign
from twin.measure.motion_log import MotionLog, MotionRun, check_against, read_motion_log, write_motion_log
from twin.milling.toolpath import read_toolpath
from twin.robot.description import load_robot
from twin.robot.urdf import read_urdf

Twin = Callable[..., SimpleNamespace]
CSV = ("import", "foreign.csv", "--map", "csv-map.yaml", "-o", "a.h5")
WAV = ("import", "blows.wav", "--map", "wav-map.yaml", "-o", "a.h5")
COMPARE = ("compare", "modes.yaml")
SIMULATE = ("simulate", "posture.yaml", "--robot", "two.yaml")


@pytest.fixture
def folder(copies: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Copies of all valid files, in the working folder."""
    monkeypatch.chdir(copies)
    return copies


def put(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert old in text, (file, old)
    (folder / file).write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("command", "file", "old", "new", "field"),
    [
        # numbers that no machine has
        (SIMULATE, "two.yaml", "name: two", "gravity: [0, 0, -9810]\nname: two", "gravity"),
        (SIMULATE, "two.yaml", "d: 0.5", "d: 500", "axes[0].d"),
        (SIMULATE, "two.yaml", "com: [0.4, 0, 0]", "com: [400, 0, 0]", "links[1].com"),
        (SIMULATE, "two.yaml", "rotor_inertia: 2.0e-3", "rotor_inertia: 2.0e+6", "drives[0].rotor_inertia"),
        (SIMULATE, "two.yaml", "joint1: 0.1", "joint1: 1.0e+6", "drives[1].coupling"),
        (SIMULATE, "two.yaml", "flange: {position: [0.8", "flange: {position: [800", "flange.position"),
        (SIMULATE, "two.yaml", "factor: 2.0", "factor: 2.0e+12", "priors[0].factor"),
        (SIMULATE, "two.yaml", "{mass: 0.03}", "{posture_deg: 1.0e+9}", "tolerances.posture_deg"),
        (SIMULATE, "two.yaml", "{mass: 0.03}", "{com: 1.0e+9}", "tolerances.com"),
        (SIMULATE, "two.yaml", "name: two", 'name: "tw\\to"', "name"),
        (SIMULATE, "two.yaml", "1X+, body", f"{'1' * 40}X+, body", "test_points[0].label"),
        (SIMULATE, "two.yaml", "[1.0, 0.2]", "[1.0, 0.2, 7.0]", "physics[2].coefficients"),
        (SIMULATE, "posture.yaml", "force_n: [300]", "force_n: [3.0e+8]", "hammer.force_n"),
        (SIMULATE, "posture.yaml", "hits: 2", "hits: 2, off_axis_deg: 1000", "hammer.off_axis_deg"),
        (SIMULATE, "posture.yaml", "hits: 2", "hits: 2, force_spread: 100", "hammer.force_spread"),
        (SIMULATE, "posture.yaml", "mass_kg: 12", "mass_kg: 12000", "cut.tool.mass_kg"),
        (SIMULATE, "posture.yaml", "mass_kg: 12", "mass_kg: 12, com_m: 30", "cut.tool: com_m"),
        (SIMULATE, "posture.yaml", "overhang_m: 0.25", "tip_m: [250, 0, 0]", "cut.tool.tip_m"),
        (SIMULATE, "posture.yaml", "immersion: 0.5", "immersion: 1.0e-5", "cut.immersion"),
        (SIMULATE, "posture.yaml", "immersion: 0.5", "immersion: 0.5\n  table_z_m: 1000", "cut.table_z_m"),
        (SIMULATE, "posture.yaml", "[1000, 12000]", "[1, 12000]", "cut: spindle_rpm"),
        (("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "payload: 5", "payload: 1.0e+9", "payload"),
        (("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "payload: 5", "reach: 700", "reach"),
        (
            ("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "payload: 5", "coupling: {a9: {a1: 1}}",
            "coupling.a9",
        ),
        (("describe", "arm.urdf", "--tool", "tool.yaml"), "tool.yaml", "mass: 4", "mass: 4\ndensity: 1e-9", "density"),
        # a drawing in degrees or millimetres, or that contradicts itself
        (("describe", "arm.urdf"), "arm.urdf", 'xyz="0 0 0.3"', 'xyz="0 0 300"', "joint a1: xyz"),
        (("describe", "arm.urdf"), "arm.urdf", '0.3" rpy="0 0 0"', '0.3" rpy="0 0 90"', "joint a1: rpy"),
        (("describe", "arm.urdf"), "arm.urdf", 'radius="0.05"', 'radius="50000"', "link upper: <cylinder>"),
        (("describe", "arm.urdf"), "arm.urdf", 'name="a2"', 'name="a1"', "joint a1: appears twice"),
        (("describe", "arm.urdf"), "arm.urdf", '<axis xyz="0 1 0"/>', "<axis/>", "joint a2: <axis>"),
        (("describe", "arm.urdf"), "arm.urdf", '<mass value="5"/>', "<mass/>", "link upper: <mass>"),
        # fields unknown, and texts that are numbers
        (("compare", "modes.yaml"), "modes.yaml", "q_deg: [10", "q_deg: [1.0e+7", "postures.bent: q_deg"),
        (("compare", "modes.yaml"), "modes.yaml", "robot: two.yaml", "robot: 7", "robot"),
        (
            ("compare", "modes.yaml"), "modes.yaml", "{frequency_hz", "{frequency_std_hz: 1.0e+5, frequency_hz",
            "postures.bent.modes[0].frequency_std_hz",
        ),
        (
            ("compare", "modes.yaml"), "modes.yaml", "{frequency_hz", "{shape: {1Z+: [0, 0]}, frequency_hz",
            "postures.bent.modes[0].shape",
        ),
        (SIMULATE, "two.yaml", "gear_ratio: 120", "gear_ratio: 0", "drives[1].gear_ratio"),
        (CSV, "csv-map.yaml", "unit: Nm", "unit: Nm, factor: 0", "torque"),
        (WAV, "wav-map.yaml", "record_s: 0.9", "record_s: 0.9\ntrigger_n: 1.0e+9", "trigger_n"),
        (WAV, "wav-map.yaml", "[10, 40]", "[1.0e+7, 40]", "q_deg"),
        (("map", "cut.yaml", "--robot", "two.yaml", "--random", "3", "--place-turn-deg", "1e6"), "cut.yaml", "t", "t",
         "--place-turn-deg"),
        (SIMULATE, "two.yaml", "damping: 900,", "damping: 9.0e+8,", "hammer"),  # of 176 million steps a record
    ],
)  # fmt: skip
def test_what_no_machine_has_and_what_contradicts_itself_is_refused(
    folder: Path, twin: Twin, command: tuple[str, ...], file: str, old: str, new: str, field: str
) -> None:
    put(folder, file, old, new)
    found = twin(*command)
    assert found.code == 2, found.err
    assert found.err.count("\n") == 1
    assert field in found.err


@pytest.mark.parametrize(
    ("command", "file", "old", "new", "said"),
    [
        (SIMULATE, "two.yaml", "stiffness: 2.0e6", "stiffness: 2.0", "axes[0].stiffness"),
        (SIMULATE, "two.yaml", "damping: 900", "damping: 9.0e+6", "axes[0].damping"),
        (SIMULATE, "two.yaml", "stiffness: 2.0e6, ", "", "axes[0].damping: is not used"),
        (SIMULATE, "two.yaml", "mass: 120", "mass: 120000", "links[0].inertia"),
        (SIMULATE, "two.yaml", "mass: 120", "mass: 0.1", "links[0].inertia"),
        (SIMULATE, "two.yaml", "position: [-3, 3]", "position: [-170, 170]", "axes[0].limits.position"),
        (SIMULATE, "two.yaml", "velocity: 2,", "velocity: 120,", "axes[0].limits.velocity"),
        (SIMULATE, "two.yaml", "velocity: 2,", "torque: 3.0e+8, velocity: 2,", "axes[0].limits.torque"),
        (SIMULATE, "two.yaml", "gear_ratio: 150", "gear_ratio: 150000", "drives[0].gear_ratio"),
        (SIMULATE, "two.yaml", "rotor_inertia: 2.0e-3", "rotor_inertia: 20", "drives[0].rotor_inertia"),
        (SIMULATE, "two.yaml", "alpha_deg: 90, a: 0.2, ", "", "axes[1]: turns about the same line as joint1"),
        (SIMULATE, "two.yaml", "acceleration: 6", "acceleration: 6.0e-9", "axes[0].limits.acceleration"),
        (SIMULATE, "two.yaml", "velocity: 2,", "torque: 3.0e-3, velocity: 2,", "axes[0].limits.torque"),
        (SIMULATE, "two.yaml", "name: two", "base: {mass: 9.0e+5}\nname: two", "base.mass"),
        (("describe", "arm.urdf"), "arm.urdf", '<mass value="5"/>', '<mass value="500000"/>', "links[0].inertia"),
        (("map", "cut.yaml", "--robot", "two.yaml", "--random", "3", "--spacing", "1"), "cut.yaml", "t", "t",
         "--spacing"),
        (SIMULATE, "two.yaml", "torque: 40", "torque: 400000", "physics[1].torque"),
        (SIMULATE, "two.yaml", "stiffness: 3.0e6", "stiffness: 3.0e+14", "physics[0].stiffness"),
        (SIMULATE, "two.yaml", "1X+, body: link2, position: [0.8", "2X+, body: link2, position: [20", "test_points[0]"),
        (SIMULATE, "two.yaml", "1Z+, body: link2", "1Z+, body: link1", "test_points[1].position"),
        (SIMULATE, "two.yaml", "factor: 2.0", "factor: 2000", "priors[0].factor"),
        (SIMULATE, "two.yaml", "name: two", "gravity: [0, 0, -1.62]\nname: two", "gravity"),
        (SIMULATE, "posture.yaml", "  coefficients: aluminium_7075\n", "", "coefficients aluminium_7075"),
        (SIMULATE, "posture.yaml", "[10, 40]", "[0.17, 0.7]", "below 3.2 degrees"),
        (("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "[330, ", "[0.33, ", "max_torque[0]"),
        (("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "payload: 5", "reach: 40", "reach"),
        (("describe", "arm.urdf", "--sheet", "sheet.yaml"), "sheet.yaml", "payload: 5", "mass: 9000", "mass"),
        (COMPARE, "modes.yaml", "{freq", "{frequency_hz: 7.0, damping_percent: 1.0e-3}, {freq", "is it a ratio?"),
        (COMPARE, "modes.yaml", "{freq", "{frequency_hz: 30000.0}, {freq", "leap"),
        (COMPARE, "modes.yaml", "postures:", "robots: two.yaml\npostures:", "'robots'"),
        (COMPARE, "modes.yaml", "{q_deg", "{brake: on, q_deg", "postures.bent: field 'brake'"),
        (("compare", "modes.yaml", "--low-pass", "20", "30"), "modes.yaml", "[10, ", "[10.0, ", "--low-pass"),
    ],
)  # fmt: skip
def test_what_is_hardly_meant_is_told(
    folder: Path, twin: Twin, command: tuple[str, ...], file: str, old: str, new: str, said: str
) -> None:
    put(folder, "posture.yaml", "hammer: {", "hammer: false  # {")
    put(folder, "posture.yaml", "replay: log.h5", "")
    plain = next((k for k, word in enumerate(command) if word in ("--low-pass", "--spacing")), None)
    assert "note" not in twin(*command[:plain]).err
    put(folder, file, old, new)
    found = twin(*command)
    assert found.code == 0, found.err
    assert all(line.startswith("twin: note: ") for line in found.err.splitlines())
    assert said in found.err


def test_a_refusal_stays_one_line_beside_what_is_told(folder: Path, twin: Twin) -> None:
    put(folder, "two.yaml", "factor: 2.0", "factor: 2000")
    put(folder, "posture.yaml", "q_deg: [10", "q_deg: [1000")
    found = twin(*SIMULATE)
    assert (found.code, found.err.count("\n")) == (2, 1)


def test_a_drawing_tells_what_it_holds_and_nobody_reads(folder: Path) -> None:
    put(folder, "arm.urdf", 'lower="-2"', 'lowest="-2"')
    put(folder, "arm.urdf", '<mass value="10"/>', "")
    put(folder, "arm.urdf", '<geometry><cylinder radius="0.05" length="0.4"/></geometry>', "<geometri/>")
    put(folder, "arm.urdf", 'upper="2" velocity="2" effort="100"/></joint>', 'upper="200" velocity="2"/></joint>')
    notes = " ".join(read_urdf(folder / "arm.urdf").notes)
    for said in ("'lowest' of <limit> of joint a1", "link base has no <mass>", "<geometri> of link upper", "degrees?"):
        assert said in notes
    with pytest.warns(Told, match="lowest"):
        load_robot(folder / "arm.urdf")


@pytest.mark.parametrize("file", ["hammer.h5", "hits.h5", "log.h5"])
def test_what_no_reader_knows_in_a_recording_is_told(folder: Path, twin: Twin, file: str) -> None:
    with h5py.File(folder / file, "r+") as stream:
        within = stream["runs/path" if file == "log.h5" else "postures/bent"]
        within["coherance"] = within["position" if file == "log.h5" else "coherence"]
    found = twin("compare", file, "--as-is")
    assert found.code == 0, found.err
    assert "'coherance'" in found.err


def test_one_node_at_two_places_is_told(folder: Path) -> None:
    edit(folder / "hammer.h5", lambda f: f["excitation/position"].write_direct(np.array([[9.0, 0, 0]] * 2)))
    with pytest.warns(Told, match="node 1 at one place"):
        read_campaign(folder / "hammer.h5")


def test_coherence_of_no_number_of_blows_is_told(folder: Path) -> None:
    with h5py.File(folder / "hammer.h5", "r+") as stream:
        del stream["postures/bent/coherence"].attrs["averages"]
    with pytest.warns(Told, match="averages: is missing"):
        read_campaign(folder / "hammer.h5")


def edit(path: Path, change: Callable[[Any], None]) -> None:
    with h5py.File(path, "r+") as stream:
        change(stream)


@pytest.mark.parametrize(
    ("file", "change", "field"),
    [
        ("hammer.h5", lambda f: f["response/position"].write_direct(np.array([[800.0, 0, 0]])), "response/position"),
        ("hammer.h5", lambda f: f["postures/bent"].attrs.update({"q_deg": [1e7, 40.0]}), "q_deg"),
        ("hammer.h5", lambda f: f["postures/bent"].attrs.update({"peak_force_n": 1e8}), "peak_force_n"),
        ("hammer.h5", lambda f: f["postures/bent"].attrs.update({"peak_force_n": 1e-9}), "peak_force_n"),
        ("hammer.h5", lambda f: f["postures/bent"].attrs.update({"pulse_s": 5.0, "record_s": 1.0}), "pulse_s"),
        ("hammer.h5", lambda f: f.attrs.update({"robot": 7}), "robot"),
        ("hits.h5", lambda f: f["postures/bent/hits"].attrs.update({"windowed": 7.0}), "windowed"),
        ("hits.h5", lambda f: f["postures/bent/hits"].attrs.update({"sample_rate_hz": 1e12}), "sample_rate_hz"),
    ],
)
def test_a_hammer_test_that_no_hammer_makes_is_refused(
    folder: Path, file: str, change: Callable[[Any], None], field: str
) -> None:
    edit(folder / file, change)
    with pytest.raises(InputError, match=field):
        read_campaign(folder / file)


def test_a_running_record_of_no_number_is_refused(folder: Path, twin: Twin) -> None:
    with h5py.File(folder / "hammer.h5") as source, h5py.File(folder / "running.h5", "w") as stream:
        stream.attrs["format"] = "frf-campaign"
        source.copy("response", stream)
        posture = stream.create_group("postures/bent")
        posture.attrs["q_deg"] = "bent"
        running = posture.create_group("running")
        running.attrs["sample_rate_hz"] = 1000.0
        running["response"] = np.random.default_rng(0).normal(size=(1, 4000))
    found = twin("modal", "running.h5", "--operational")
    assert (found.code, found.err.count("\n")) == (2, 1)
    assert "q_deg" in found.err


def motion(change: Callable[[dict[str, np.ndarray]], None], path: Path) -> MotionLog:
    """A log of two axes, after a change of its series, as it is read."""
    time = np.arange(0, 10, 0.01)
    position = 0.5 * np.sin(2 * np.pi * np.outer(time, [0.2, 0.3]))
    series = {"position": position, "torque": 100 * position + 3, "link_position": position + 1e-4 * position**3}
    series["velocity"] = np.gradient(position, 0.01, axis=0)
    change(series)
    write_motion_log(path, MotionLog({"a": MotionRun("a", time, sample_rate_hz=100.0, **series)}))  # type: ignore[arg-type]
    return read_motion_log(path)


@pytest.mark.parametrize(
    ("key", "part", "value", "said"),
    [
        ("torque", (300, 1), 1e5, "1 samples leap away from their neighbours, the farthest of joint2 at 3.000 s"),
        ("torque", (300, 0), 0.0, "torque: 1 samples leap"),
        ("link_position", (slice(None), 0), 0.0, "link_position: that of joint1 never moves"),
        ("link_position", (slice(None), 1), np.sin(np.arange(0, 10, 0.01)), "more than a gear winds up"),
    ],
)
def test_a_log_tells_what_its_recorder_may_have_done(
    tmp_path: Path, key: str, part: Any, value: Any, said: str
) -> None:
    assert motion(lambda series: None, tmp_path / "whole.h5").notes == ()
    notes = motion(lambda series: series[key].__setitem__(part, value), tmp_path / "log.h5").notes
    assert said in " ".join(notes)


def test_a_velocity_that_is_not_of_the_positions_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"runs/a/velocity: expected the derivative of the positions"):
        motion(lambda series: series.update(velocity=np.rad2deg(series["velocity"])), tmp_path / "log.h5")


def test_a_log_in_which_nothing_moves_is_told(folder: Path, twin: Twin) -> None:
    with h5py.File(folder / "log.h5", "r+") as stream:
        for name in ("position", "link_position"):
            stream["runs/path"][name][...] *= 1e-9
    found = twin("compare", "log.h5", "--as-is")
    assert "no axis moves" in found.out + found.err


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "x_mm,y_mm,z_mm,y_mm\n1,2,3,4\n5,6,7,8\n", "y_mm is there twice"),
        ("a.csv", "x_m,y_m,z_m,x_mm\n1,2,3,4\n5,6,7,8\n", "expected one unit"),
        ("a.csv", "x_mm,y_mm,z_mm,rapid\n1,2,3,0\n5,6,7,8\n", "line 3: rapid: expected 0 or 1"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3\n5,6,7,8\n", "line 3: expected 3 values"),
        ("a.nc", "G21\nG0 X1 Y0 Z0\nG1 X2 X3\n", "line 3: X: expected once"),
        ("a.nc", "G21\nG0 X1 Y0 Z0\nG1 G0 X2\n", "line 3: expected one of G0 and G1"),
        ("a.apt", "UNITS/FURLONGS\nGOTO/1,0,0\nGOTO/2,0,0\n", "line 1: UNITS"),
        ("a.apt", "UNITS/MM\nGOTO/1,0,0,nan,0,1\nGOTO/2,0,0\n", "line 2: GOTO: expected finite"),
    ],
)
def test_a_tool_path_that_contradicts_itself_is_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        read_toolpath(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "x_mm,y_mm,z_mm,rapide\n1,2,3,0\n5,6,7,1\n", "columns that are not read: 'rapide'"),
        ("a.nc", "G0 X1 Y0 Z0\nG1 X2\n", "states no unit"),
        ("a.apt", "GOTO/1,0,0\nGOTO/2,0,0\n", "states no unit"),
        ("a.apt", "UNITS/MM\nGOTO/1,0,0\nGOTOO/5,0,0\nGOTO/2,0,0\n", "'GOTOO' .line 3."),
    ],
)
def test_a_tool_path_tells_what_is_not_read(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.warns(Told, match=said):
        read_toolpath(tmp_path / name)


@pytest.mark.parametrize(("factor", "unit"), [(1e-6, "kN·m"), (1e4, "N·mm")])
def test_a_torque_that_no_robot_of_its_weight_has_is_told(folder: Path, factor: float, unit: str) -> None:
    log, robot = read_motion_log(folder / "log.h5"), load_robot(folder / "two.yaml")
    runs = {name: replace(run, torque=factor * run.torque) for name, run in log.runs.items() if run.torque is not None}
    with pytest.warns(Told, match=f"path: torque.* look like {unit}"):
        check_against(replace(log, runs=runs), robot)


def test_blows_that_are_not_those_of_the_frfs_are_told(folder: Path) -> None:
    read_campaign(folder / "hits.h5")
    with h5py.File(folder / "hits.h5", "r+") as file:
        file["postures/bent/hits/response"][...] *= 1e-6
    with pytest.warns(Told, match="postures/bent/hits: make accelerances 1e-06 times those of frf"):
        read_campaign(folder / "hits.h5")


def test_units_that_nobody_declared_are_not_told(folder: Path) -> None:
    """Found by fuzzing: torques that miss were tried in other units, and those were told."""
    log, robot = read_motion_log(folder / "log.h5"), load_robot(folder / "two.yaml")
    runs = {name: replace(run, torque=run.torque[::-1]) for name, run in log.runs.items() if run.torque is not None}
    with warnings.catch_warnings():
        warnings.simplefilter("error", Told)
        check_log(replace(log, runs=runs), robot)
