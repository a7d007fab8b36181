"""``twin diagnose`` as a user runs it, on recordings of the truth code: what it answers, writes and refuses."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from tools.truth.__main__ import main as truth
from twin.measure.campaign import read_campaign
from twin.robot.description import load_robot

POSTURES = ["--posture", "milling=0,70,-100", "--posture", "upright=50,135,-100", "--posture", "rigid=-40,135,-140"]
CONTRACT = {
    "format", "version", "verdict", "effects", "probabilities", "location", "error", "smallest_visible", "next_test",
    "model",
}  # fmt: skip


@pytest.fixture(scope="module")
def twin_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., SimpleNamespace]:
    """As the fixture ``twin``, for the module: exit code and printed text."""
    import contextlib
    import io
    import sys

    from twin.cli import main

    def run(*arguments: str | Path) -> SimpleNamespace:
        out, err, code = io.StringIO(), io.StringIO(), 0
        kept = sys.argv
        sys.argv = ["twin", *map(str, arguments)]
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        finally:
            sys.argv = kept
        return SimpleNamespace(code=code, out=out.getvalue(), err=err.getvalue())

    return run


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, twin_once: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """A foundation that tilts, concealed in three postures, diagnosed."""
    folder = tmp_path_factory.mktemp("diagnose")
    recording = folder / "test.h5"
    effect = ["--effect", "base_compliance@base.rx:stiffness=1.5e8,damping=500"]
    assert truth(["campaign", "--out", str(recording), "--seed", "11", "--lines", "50", *effect, *POSTURES]) == 0
    printed = twin_once("diagnose", recording, "-o", folder / "out", "--hold-out", "rigid", "--json")
    assert printed.code == 0, printed.err
    answer = json.loads((folder / "test.truth.json").read_text())["truth"]["effects"][0]
    data = json.loads(printed.out)
    return SimpleNamespace(folder=folder, recording=recording, out=folder / "out", data=data, truth=answer)


def test_the_concealed_effect_is_named_with_an_interval_that_holds_its_size(found: SimpleNamespace) -> None:
    assert found.data["verdict"] in ("named", "ambiguous")
    effect = found.data["effects"][0]
    assert (effect["effect"], effect["site"]) == ("base_compliance", "base.rx")
    stiffness = effect["parameters"]["stiffness"]
    low, high = stiffness["interval90"]
    assert stiffness["unit"] == "N·m/rad"
    assert low < found.truth["parameters"]["stiffness"] < high
    total = effect["probability"] + sum(a["probability"] for a in effect["alternatives"])
    assert total + found.data["probabilities"]["none"] + found.data["probabilities"]["other"] == pytest.approx(
        1, abs=1e-6
    )


def test_the_error_falls_to_noise_where_it_was_fitted_and_falls_where_it_was_not(found: SimpleNamespace) -> None:
    error = found.data["error"]
    assert found.data["held_out"] == ["rigid"]
    assert error["after"]["train"] < 1.1 * error["noise_floor"] < 0.6 * error["before"]["train"]
    assert error["after"]["held_out"] < 0.4 * error["before"]["held_out"]
    part = next(p for p in found.data["recordings"][0]["parts"] if p["held_out"])
    assert part["name"] == "rigid"
    assert part["error"]["after"] == pytest.approx(error["after"]["held_out"], rel=1e-6)


def test_the_evidence_names_a_posture_a_channel_and_numbers(found: SimpleNamespace) -> None:
    text = found.data["effects"][0]["evidence"]
    assert "Without base_compliance at base.rx" in text
    assert any(f"'{name}'" in text for name in ("milling", "upright", "rigid"))
    assert "21" in text
    assert "Hz" in text
    assert "on rigid, not used" in text


def test_every_documented_key_is_there_and_paths_are_relative(found: SimpleNamespace) -> None:
    written = json.loads((found.out / "diagnosis.json").read_text())
    assert written == found.data
    assert set(written) >= CONTRACT
    assert (written["format"], written["version"]) == ("twin-diagnosis", 2)
    assert written["model"] == {"robot": "robot.yaml", "mjcf": "robot.xml"}
    assert set(written["location"][0]) == {"recording", "posture", "run", "site", "band_hz", "channels", "share"}
    assert set(written["smallest_visible"][0]) == {"effect", "site", "parameter", "value", "unit"}
    assert written["provenance"]["inputs"].keys() == {str(found.recording)}


def test_the_written_model_is_checked_in_mujoco_and_loads_anywhere(found: SimpleNamespace) -> None:
    assert {check["name"] for check in found.data["checks"]} >= {"model in MuJoCo", "MJCF in MuJoCo"}
    assert all(check["passed"] and check["value"] < check["limit"] for check in found.data["checks"])
    robot = load_robot(found.out / "robot.yaml")
    assert ("base_compliance", "base.rx") in [(entry.effect, entry.site) for entry in robot.physics]
    assert robot.axes[0].limits == load_robot("kr90").axes[0].limits
    model = mujoco.MjModel.from_xml_path(str(found.out / "robot.xml"))
    assert "base.rx" in [model.joint(k).name for k in range(model.njnt)]


def test_the_edit_test_says_what_a_payload_would_do_to_both_models(found: SimpleNamespace) -> None:
    edit = found.data["payload_edit"]
    for mode in edit["modes"]:
        for pair in (mode["before_hz"], mode["after_hz"]):
            assert pair[1] < pair[0], "a mass lowers every natural frequency"
    assert f"{edit['mass_kg']:g} kg" in edit["description"]


def test_the_report_stands_alone_with_all_figures_and_modes_to_view(
    found: SimpleNamespace, twin: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (found.out / "diagnosis.html").read_text()
    assert "http:" not in page
    assert "https:" not in page
    figures = {"errors.png", "mismatch.png", "overlay.png", "probabilities.png", "smallest_visible.png", "sites.png"}
    assert figures <= {path.name for path in found.out.glob("*.png")}
    assert page.count("data:image/png;base64,") == len(list(found.out.glob("*.png")))
    listed = {Path(file).name for file in found.data["files"]}
    assert listed == {path.name for path in found.out.iterdir() if path.is_file()} - {".twin-diagnose"}
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    shown = twin("view", found.out)
    assert shown.code == 0
    assert "modes-before.rrd" in shown.out
    assert "modes-after.rrd" in shown.out


@pytest.mark.slow
def test_a_complete_model_is_adequate_and_is_written_all_the_same(
    tmp_path: Path, twin: Callable[..., SimpleNamespace]
) -> None:
    recording = tmp_path / "null.h5"
    options = ["campaign", "--out", str(recording), "--seed", "12", "--lines", "50", "--nominal", "--no-sag"]
    assert truth([*options, "--noise", "1e-7", "--scatter", "0.01", *POSTURES[:4]]) == 0
    printed = twin("diagnose", recording, "-o", tmp_path / "out", "--json")
    assert printed.code == 0, printed.err
    assert printed.json["verdict"] == "adequate"
    assert printed.json["effects"] == []
    assert printed.json["next_test"] is None
    labels = read_campaign(recording).excitation.label
    assert printed.json["held_out"] == list(labels)  # two postures: every blow is left out in turn
    error = printed.json["error"]
    assert error["after"]["held_out"] == error["before"]["held_out"] > error["after"]["train"]
    robot = load_robot(tmp_path / "out" / "robot.yaml")
    assert len(robot.physics) == len(load_robot("kr90").physics)
    assert (tmp_path / "out" / "robot.xml").is_file()


def test_friction_concealed_in_a_motion_log_is_named_and_the_torque_replayed(
    tmp_path: Path, twin: Callable[..., SimpleNamespace]
) -> None:
    recording = tmp_path / "log.h5"
    assert truth(["log", "--out", str(recording), "--seed", "21", "--runs", "3", "--seconds", "25", "--nominal"]) == 0
    printed = twin(
        "diagnose", recording, "--robot", "kr90_identified", "--without", "coulomb_friction@joint2",
        "--hold-out", "run2", "-o", tmp_path / "out", "--json",
    )  # fmt: skip
    assert printed.code == 0, printed.err
    effect = printed.json["effects"][0]
    assert (effect["effect"], effect["site"]) == ("coulomb_friction", "joint2")
    assert printed.json["held_out"] == ["run2"]
    assert printed.json["error"]["after"]["held_out"] < 0.3 * printed.json["error"]["before"]["held_out"]
    assert "torque of joint2 in run" in effect["evidence"]
    replayed = next(check for check in printed.json["checks"] if check["name"] == "replay in MuJoCo")
    assert replayed["passed"]
    assert {"residual.png", "torque.png"} <= {path.name for path in (tmp_path / "out").glob("*.png")}


# --- refusals: one line, exit code 2, nothing written -----------------------------------------------------------------


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    folder = tmp_path_factory.mktemp("small")
    assert truth(["campaign", "--out", str(folder / "test.h5"), "--seed", "1", "--postures", "1", "--lines", "20"]) == 0
    assert truth(["log", "--out", str(folder / "log.h5"), "--seed", "1", "--seconds", "20"]) == 0
    return SimpleNamespace(test=folder / "test.h5", log=folder / "log.h5")


def refused(printed: SimpleNamespace, *words: str) -> None:
    assert printed.code == 2
    assert printed.out == ""
    assert printed.err.startswith("twin: ")
    assert printed.err.count("\n") == 1
    for word in words:
        assert word in printed.err


def test_a_posture_that_is_not_there_cannot_be_held_out(
    small: SimpleNamespace, tmp_path: Path, twin: Callable[..., SimpleNamespace]
) -> None:
    out = tmp_path / "out"
    refused(
        twin("diagnose", small.test, "--hold-out", "nowhere", "-o", out), "nowhere", "no such posture or run", "milling"
    )
    refused(twin("diagnose", small.test, "--hold-out", "milling", "-o", out), "nothing is left")
    assert not out.exists()


def test_a_robot_without_springs_and_one_of_other_axes_are_refused(
    small: SimpleNamespace, tmp_path: Path, twin: Callable[..., SimpleNamespace]
) -> None:
    arm6 = Path(__file__).parent / "data" / "arm6.urdf"
    refused(twin("diagnose", small.test, "--robot", arm6), "stiffness")
    refused(twin("diagnose", small.log, "--robot", arm6), "6")
    rigid = load_robot("kr90")
    two = rigid.model_copy(
        update={"axes": [a.model_copy(update={"stiffness": None}) for a in rigid.axes], "physics": []}
    )
    from twin.robot.description import save_robot

    save_robot(tmp_path / "rigid.yaml", two)
    refused(twin("diagnose", small.test, "--robot", tmp_path / "rigid.yaml"), "nothing can vibrate")


def test_files_that_hold_nothing_to_compare_are_refused(
    small: SimpleNamespace, tmp_path: Path, twin: Callable[..., SimpleNamespace]
) -> None:
    trajectory = tmp_path / "trajectory.csv"
    t = np.arange(0, 30, 0.01)
    rows = np.column_stack([t, np.sin(t), 1.5 + 0.2 * np.sin(t), -1.5 + 0.2 * np.cos(t)])
    np.savetxt(trajectory, rows, delimiter=",", header="time,q1,q2,q3", comments="")
    refused(twin("diagnose", trajectory), "torque")
    refused(twin("diagnose", small.test, small.test), "given twice")
    refused(twin("diagnose", tmp_path / "absent.h5"), "no such file")
    refused(twin("diagnose", small.test, "--without", "magnetism"), "magnetism")


@pytest.mark.slow
def test_one_model_does_for_a_hammer_test_and_a_log_of_friction_that_turns_round(
    tmp_path: Path, twin_once: Callable[..., SimpleNamespace]
) -> None:
    """Presliding is in the model that is written, and stiffens no joint behind a held rotor."""
    hammer, log = tmp_path / "hammer.h5", tmp_path / "log.h5"
    assert truth(["campaign", "--out", str(hammer), "--seed", "12", "--lines", "40", "--nominal", *POSTURES]) == 0
    motion = ["--runs", "3", "--seconds", "30", "--dwells", "1", "--friction", "lugre", "--nominal"]
    assert truth(["log", "--out", str(log), "--seed", "12", *motion]) == 0
    printed = twin_once("diagnose", log, hammer, "-o", tmp_path / "out", "--hold-out", "rigid", "--json")
    assert printed.code == 0, printed.err
    data = json.loads(printed.out)
    assert data["verdict"] == "adequate"
    after, floor = data["error"]["after"], data["error"]["noise_floor"]
    assert after["held_out"][str(log)] < 1.2 * floor[str(log)]
    assert after["train"][str(hammer)] < 1.1 * floor[str(hammer)]
    assert all(check["passed"] for check in data["checks"])
    robot = load_robot(str(tmp_path / "out" / "robot.yaml"))
    assert {e.site for e in robot.physics if e.effect == "presliding"} == {"joint1", "joint2", "joint3"}


def test_what_a_hammer_test_has_no_use_for_is_not_imported() -> None:
    code = (
        "import sys, twin.cli, twin.commands.diagnose; print({'scipy.signal', 'scipy.stats', 'glfw'} & {*sys.modules})"
    )
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert run.stdout.strip() == "set()"


def test_numpy_is_not_imported_before_its_threads_are_set() -> None:
    """OpenBLAS reads the number of threads once: more than one cost ten times the CPU on a busy machine."""
    code = "import os, sys, twin.cli; print('numpy' in sys.modules, os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert run.stdout.split() == ["False", "1"]
