"""Diagnosis of motion logs: recordings of the truth code, which shares nothing with the twin, and real ones."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from test_identify_real import emps, needs, tx40

from tools.study_payload import cases, holds
from tools.study_ten_hertz import slipping
from tools.truth import motion as truth_motion
from tools.truth.__main__ import main as truth
from tools.truth.recording import draw_truth
from tools.truth.robots import machines, write_description
from twin import diagnose
from twin.diagnose import engine, torque, torque_search
from twin.diagnose.borne_out import falls
from twin.diagnose.calibration import calibration
from twin.diagnose.joint import followed
from twin.diagnose.note import Note
from twin.diagnose.sentences import sentence
from twin.diagnose.torque import Log, diagnose_log, pooled, predicted_by, wider_bands, with_evidence
from twin.diagnose.torque_fit import base_fit, evaluate, fitted, refine, settle, start
from twin.diagnose.torque_judge import Judge
from twin.diagnose.torque_revise import _as_suspected, _with_element, at_once, seen_at_rest_only
from twin.diagnose.torque_search import _of_another_size
from twin.diagnose.torque_step import too_narrow
from twin.diagnose.torque_suspects import log_suspects
from twin.diagnose.torque_system import (
    Trial,
    extended,
    own_prior,
    own_values,
    relinearised,
    system_of,
    unshrunk,
    whitened_entry,
    with_doubts,
)
from twin.diagnose.verdict import Candidate, Finding, Missing, Verdict
from twin.errors import InputError
from twin.identify.rigid_compare import compare_log
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun, read_motion_log
from twin.measure.signals import lowpass
from twin.model.regressor import inertia_six
from twin.model.replay import inverse_dynamics
from twin.model.torque_base import APART, PRESLIDING, _apart
from twin.model.torque_design import Block, Design
from twin.model.torque_laws import State, entry_torque, model_torque
from twin.model.torque_noise import _correlation, prediction_filter
from twin.model.torque_robot import _rounded
from twin.model.torque_rows import Bands, in_joints
from twin.model.torque_signal import Run, bands_of, prepare
from twin.model.torque_stops import _creeping, stop_columns
from twin.model.torque_whitened import Columns
from twin.physics import CATALOGUE
from twin.physics.motion import Motion
from twin.robot.description import Entry, Robot, load_robot, parse_robot
from twin.robot.mechanism import assemble

DATA = Path(__file__).parent / "data"


def recorded(path: Path, *options: str, seed: int = 3) -> MotionLog:
    """Three runs of 30 s with a standstill each."""
    file = path / "log.h5"
    base = ["log", "--out", str(file), "--seed", str(seed), "--runs", "3", "--seconds", "30", "--dwells", "1"]
    assert truth([*base, *options]) == 0
    return read_motion_log(file)


@pytest.fixture(scope="module")
def drifting(tmp_path_factory: pytest.TempPathFactory) -> Finding:
    """A hose pack that pulls joint 1 back with 60 N·m/rad."""
    options = ("--effect", "cable_stiffness@joint1:stiffness=60,rest=0.3")
    return diagnose_log(recorded(tmp_path_factory.mktemp("cable"), *options), load_robot("kr90"), "cable.h5")


def test_a_complete_model_is_adequate_in_spite_of_ordinary_ripple_and_a_gas_law(tmp_path: Path, kr90: Robot) -> None:
    """Wrong inertias, coloured noise, ripple of 1.5 N·m at every joint, a compensator that is no series: tolerance."""
    found = diagnose_log(recorded(tmp_path, "--ripple", "1.5", "--compensator", "gas"), kr90)
    assert found.word == "adequate"
    assert found.none > 0.88  # 0.81 where numbers that gain nothing count as rivals
    assert not found.missing
    assert found.error["before"]["held_out"] < 1.3 * found.error["noise_floor"]


def test_the_zero_of_a_current_sensor_is_no_physics(tmp_path: Path, kr90: Robot) -> None:
    """A constant of 80 N·m in all runs of joint 3, 0.5 % of its drive's range, is what such sensors have."""
    robot = kr90.model_copy(deep=True)
    robot.axes[2].limits.torque = 16e3  # type: ignore[union-attr]
    log = recorded(tmp_path, "--ripple", "1.5", "--compensator", "gas")
    for run in log.runs.values():
        assert run.torque is not None
        run.torque[:, 2] += 80.0
    assert diagnose_log(log, robot).word == "adequate"


def test_a_pump_beside_one_run_is_told_and_ordinary_friction_is_not(drifting: Finding, tmp_path: Path) -> None:
    """Above the band of the fit runs differ by how their friction reverses; 25 Hz in one run alone is no such thing."""
    assert not any("is restless" in warning for warning in drifting.warnings)
    log = recorded(tmp_path, "--ripple", "1.5")
    name, run = next(iter(log.runs.items()))
    assert run.torque is not None
    run.torque[:, 1] += 60.0 * np.sin(2 * np.pi * 25.0 * run.time)
    found = diagnose_log(log, load_robot("kr90"))
    (told,) = [warning for warning in found.warnings if "is restless" in warning]
    assert f"'{name}' is restless at" in told
    assert "joint2" in told
    assert not found.missing


def test_a_hose_pack_is_named_measured_and_put_back(drifting: Finding) -> None:
    (missing,) = drifting.missing
    assert missing.first.key == "cable_stiffness@joint1"
    assert missing.probability > 0.9
    stiffness = missing.first.parameters["stiffness"]
    assert stiffness["value"] == pytest.approx(60, rel=0.1)
    assert stiffness["interval90"][0] < 60 < stiffness["interval90"][1]
    (entry,) = [e for e in drifting.robot.physics if e.effect == "cable_stiffness"]
    assert entry.values["rest"] == pytest.approx(0.3, abs=0.15)
    assert drifting.error["after"]["held_out"] < drifting.error["before"]["held_out"]


def test_a_slide_among_hinges_has_presliding_of_its_own(kr90: Robot) -> None:
    data = kr90.model_dump(mode="json")
    data["axes"][0]["type"] = "prismatic"
    own, *others = _apart(parse_robot(data))
    assert own == PRESLIDING
    assert others == [APART, APART] == _apart(kr90)[1:].tolist()


def test_what_a_log_says_does_not_depend_on_how_many_processes_look(drifting: Finding, tmp_path: Path) -> None:
    options = ("--effect", "cable_stiffness@joint1:stiffness=60,rest=0.3")
    other = diagnose_log(recorded(tmp_path, *options), load_robot("kr90"), "cable.h5", processes=2)
    assert other.missing[0].probability == drifting.missing[0].probability
    assert other.missing[0].first.parameters == drifting.missing[0].first.parameters
    assert other.error == drifting.error


@pytest.mark.parametrize("turned_deg", [90.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_a_compensator_of_a_robot_whose_zero_is_not_level_is_found(tmp_path: Path, turned_deg: float) -> None:
    """Angles that are counted from upright: a ripple stood in for the sines, with 0.97."""
    log = recorded(tmp_path, "--compensator", "gas", seed=5)
    robot, turned = load_robot("kr90").without(["gravity_compensator"]), np.deg2rad([0.0, turned_deg, 0.0])
    axes = [a.model_copy(update={"theta_deg": a.theta_deg + np.rad2deg(x), "limits": None}) for a, x in
            zip(robot.axes, turned, strict=True)]  # fmt: skip
    runs = {name: replace(run, position=run.position - turned) for name, run in log.runs.items()}
    finding = diagnose_log(replace(log, runs=runs), robot.model_copy(update={"axes": axes}))
    (answer,) = finding.missing
    assert answer.first.key == "gravity_compensator@joint2"
    coefficients, zero = (answer.first.parameters[name] for name in ("coefficients", "zero"))
    quarter = (np.rad2deg(zero["value"]) + turned_deg + 90) % 180 - 90  # half a turn changes the sign
    assert quarter == pytest.approx(0.0, abs=1.0)
    assert abs(coefficients["value"][0]) == pytest.approx(7450, rel=0.02)


def test_dry_friction_left_out_is_named_and_its_level_found(tmp_path: Path, kr90: Robot) -> None:
    """The truth's bristles are not the catalogue's sign: alike at all joints they are Coulomb friction all the same."""
    log = recorded(tmp_path, "--friction", "lugre", "--nominal")
    found = diagnose_log(log, kr90.without(["coulomb_friction@joint2"]))
    (missing,) = found.missing
    assert missing.first.key == "coulomb_friction@joint2"
    assert missing.first.parameters["torque"]["value"] == pytest.approx(373.24, rel=0.03)
    assert found.error["after"]["held_out"] < 0.1 * found.error["before"]["held_out"]
    assert found.held_out_misfit > calibration()["held_out_adequate"]  # by the base model: it is left if the name goes


@pytest.mark.slow
def test_bristles_at_every_joint_are_a_complete_model_and_a_slower_gear_is_not(tmp_path: Path, kr90: Robot) -> None:
    """Presliding over 0.2 mrad alike at all joints is how friction is; slip over 1 mrad at one joint is missing.

    What was fitted is what is written: the new description turns round as the record does, Coulomb's friction does not.
    """
    log = recorded(tmp_path, "--friction", "lugre")
    found = diagnose_log(log, kr90)
    assert found.word == "adequate"
    assert found.written is not None
    assert compare_log(log, found.written).error < 1.3 * found.error["noise_floor"]
    assert compare_log(log, found.robot).error > 3 * found.error["noise_floor"]
    assert Verdict.of(found).robot is found.written
    again = pooled(predicted_by(found.written, log, found, found.held_out), "after")
    assert again["held_out"] == pytest.approx(found.error["after"]["held_out"], rel=0.05)
    assert {e.site for e in found.written.physics if e.effect == "presliding"} == {"joint1", "joint2", "joint3"}
    slip = "hysteresis@joint3.z:stiffness=80000,yield_torque=80"
    missing = diagnose_log(recorded(tmp_path, "--friction", "lugre", "--effect", slip), kr90).missing
    assert [m.first.key for m in missing] == ["hysteresis@joint3.z"]


@pytest.mark.slow
def test_slip_that_is_part_of_dry_friction_is_not_taken_for_how_friction_ordinarily_turns_round(
    tmp_path: Path, kr90: Robot
) -> None:
    """A fifth of joint 2's friction turns over 0.2 mrad where Coulomb's turns at once: no other joint's does."""
    slip = "hysteresis@joint2.z:stiffness=200000,yield_torque=40"
    (missing,) = diagnose_log(recorded(tmp_path, "--effect", slip), kr90).missing
    assert missing.first.key == "hysteresis@joint2.z"


def test_described_friction_of_another_size_is_told_and_bends_no_link(tmp_path: Path, kr90: Robot) -> None:
    """A complete log, and coefficients as the motors have them: at no joint of the size that the log shows."""

    def at_the_motor(entry: Entry) -> Entry:
        if entry.effect != "viscous_friction":
            return entry
        ratio = kr90.drives[int(entry.site[5:]) - 1].gear_ratio
        return Entry.model_validate({**entry.model_dump(), "coefficient": entry.values["coefficient"] / ratio**2})

    log = recorded(tmp_path)
    wrong = kr90.model_copy(update={"physics": [at_the_motor(entry) for entry in kr90.physics]})
    found = diagnose_log(log, wrong)
    assert not found.missing
    (note,) = [n for n in found.warnings if isinstance(n, Note) and n.kind == "description"]
    assert note.sites == tuple(f"viscous_friction@joint{k}.coefficient" for k in (1, 2, 3))
    assert "of the motors instead of the joints" in note
    assert found.error["after"]["held_out"] < 1.2 * found.error["noise_floor"]
    assert _of_another_size(torque.base_system(prepare(log, kr90, "log"))) is None


def test_the_search_for_slip_starts_at_the_torque_that_the_log_shows(tmp_path: Path, kr90: Robot) -> None:
    """A start with a usual torque, eight times what there was, lost more than it explained: no slip was found there."""
    faint = "hysteresis@joint2.z:stiffness=16000,yield_torque=27"
    prepared = prepare(recorded(tmp_path, "--friction", "lugre", "--effect", faint), kr90, "log")
    system = torque.base_system(prepared)
    slip = next(s for s in log_suspects(kr90, prepared.used) if s.name == "hysteresis@joint2.z")
    begun = start(system, slip)
    found = own_values(slip.hypothesis.own, begun.u)
    assert begun.gain > 25
    assert 10 < found[0] < 60 < 0.5 * slip.starts[0, 0]
    column, _ = whitened_entry(system, slip, begun.u, slopes=False)
    np.testing.assert_allclose(begun.column.rows, column.rows, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_friction_that_all_joints_lack_is_found_at_ten_hertz_and_the_model_can_be_stepped(tmp_path: Path) -> None:
    """A replay's torque is a mean over one sample, and a tenth of a second is long."""
    path = tmp_path / "robot.yaml"
    write_description(machines()["six"], path)
    verdict = diagnose(slipping("six", 60.0, 0), robot=path, without=["viscous_friction", "coulomb_friction"])
    named = {missing.first.key for missing in verdict.missing}
    joints = range(1, 7)
    friction = {f"{kind}@joint{k}" for kind in ("viscous_friction", "coulomb_friction") for k in joints}
    assert friction <= named
    assert all(check["passed"] for check in verdict.checks)
    assert str(verdict).count("The error on what was used falls") == 1


def test_slip_of_several_elements_is_put_to_its_rivals_again(tmp_path: Path, kr90: Robot) -> None:
    """What is found loses its usual size and grows; judged once more, all its elements have the first one's prior."""
    suspects = log_suspects(kr90, prepare(recorded(tmp_path), kr90, "log").used)
    slip = next(s for s in suspects if s.name == "hysteresis@joint1.z")
    none = Columns((), np.zeros((0, 2)))
    found = unshrunk(Trial(slip, np.array([3.0, 0.5]), 0.0, none, none))
    longer, u = _with_element(found, 10.0)
    again = _as_suspected(Trial(longer, u, 0.0, none, none), suspects)
    own = again.suspect.hypothesis.own
    assert [p.deviation for p in own] == 2 * [p.deviation for p in slip.hypothesis.own]
    assert own_values(own, again.u) == pytest.approx(own_values(longer.hypothesis.own, u))


def test_slip_that_holds_more_than_friction_in_motion_is_written_as_it_was_fitted(kr90: Robot) -> None:
    """Dry friction below zero beside it is no friction: a law without a name has the same torque."""
    fitted = Entry.model_validate({"effect": "coulomb_friction", "site": "joint2", "torque": -150.0})
    written = _rounded(fitted, kr90)
    assert written.effect == "discovered"
    t = np.linspace(0, 4, 2001)
    speed = np.stack([0 * t, np.clip(np.sin(3 * t), -0.6, 0.6) * (np.abs(np.sin(3 * t)) > 0.1), 0 * t], 1)
    motion = Motion(t, np.cumsum(speed, axis=0) * t[1], speed, np.gradient(speed, t, axis=0))
    torque = [CATALOGUE[e.effect].torque(motion, e.site, e.values)[1] for e in (fitted, written)]
    np.testing.assert_allclose(*torque)
    assert np.ptp(torque[0]) == 300


def test_what_of_slip_yields_at_once_is_told_from_what_travels(tmp_path: Path, kr90: Robot) -> None:
    """Travels of 0.2 µrad and 6 mrad: the first is passed between two samples after every reversal."""
    slip = "hysteresis@joint3.z:stiffness=1e9|40000,yield_torque=100|120"
    prepared = prepare(recorded(tmp_path, "--effect", slip), kr90, "log")
    system = system_of(prepared, [])
    suspect = next(s for s in log_suspects(kr90, prepared.used) if s.name == "hysteresis@joint3.z")
    none = Columns((), np.zeros((0, 2)))
    longer, _ = _with_element(Trial(suspect, np.zeros(2), 0.0, none, none), 10.0)
    u = own_prior(longer.hypothesis.own, np.array([100, 1e9, 120, 4e4]))
    assert at_once(extended(system, evaluate(system, longer, u)), longer) == [0]


def test_friction_that_falls_between_two_samples_of_a_reversal_shows_at_rest_only(tmp_path: Path, kr90: Robot) -> None:
    """Of a curve over 1 mrad/s an axis that reaches 10 mrad/s within a sample shows nothing; of 0.5 rad/s, much."""
    prepared = prepare(recorded(tmp_path), kr90, "log")
    system = system_of(prepared, [])
    suspect = next(s for s in log_suspects(kr90, prepared.used) if s.name == "stribeck_friction@joint2")

    def beside(velocity: float) -> bool:
        u = own_prior(suspect.hypothesis.own, np.array([50.0, velocity]))
        here = extended(system, evaluate(system, suspect, u))
        here.z = np.r_[system.z, u]
        return seen_at_rest_only(here, suspect)

    assert beside(1e-3)
    assert not beside(0.5)


def test_a_description_is_too_narrow_where_its_numbers_stay_far_from_it(tmp_path: Path, kr90: Robot) -> None:
    system = system_of(prepare(recorded(tmp_path), kr90, "log"), [])
    fit = base_fit(system)
    assert not too_narrow(system, fit).scale
    far = replace(fit, z=np.where(np.abs(fit.z) > 0.3, 20 * fit.z, fit.z))
    scale = dict(too_narrow(system, far).scale)
    assert set(scale) == set(system.parameters.names[: system.base.spread.shape[1]])
    assert min(scale.values()) > 5


def test_runs_not_used_judge_a_gain_on_the_torques_that_it_settles_on(tmp_path: Path, kr90: Robot) -> None:
    """A gain of 0.6 is first multiplied with torques that were fitted without it, far too small."""
    prepared = prepare(recorded(tmp_path, "--effect", "torque_constant@joint1:gain=0.6"), kr90, "log")
    system = system_of(prepared, [])
    suspect = next(s for s in log_suspects(kr90, prepared.used) if s.name == "torque_constant@joint1")
    first = refine(system, evaluate(system, suspect, start(system, suspect).u))
    judge = Judge(system, prepared.kept)
    early, late = (judge.gain(system, fitted(system, t), t)[0] for t in (first, settle(system, first)))
    assert early == pytest.approx(late, rel=0.1)


def test_doubt_of_other_numbers_excuses_no_larger_error(
    tmp_path: Path, kr90: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A TX40 had a payload by the predictive density of rows kept aside, whose squares it made a fifth larger."""
    prepared = prepare(recorded(tmp_path, "--effect", "torque_constant@joint1:gain=0.6"), kr90, "log")
    system = system_of(prepared, [])
    suspect = next(s for s in log_suspects(kr90, prepared.used) if s.name == "torque_constant@joint1")
    trial, judge = settle(system, start(system, suspect)), Judge(system, prepared.kept)
    assert judge.gain(system, fitted(system, trial), trial)[1]  # it keeps the base model's residual from now on
    (rest, _), density = judge.rest(system, base_fit(system)), judge.rest
    monkeypatch.setattr(judge, "rest", lambda *fit: (1.1 * rest, density(*fit)[1]))
    assert not judge.gain(system, fitted(system, trial), trial)[1]


@pytest.mark.slow
def test_presliding_is_in_proportion_to_friction_where_none_was_described(tmp_path: Path, kr90: Robot) -> None:
    """Bristles carry dry friction alone: viscous friction left out makes no joint turn round unlike the others."""
    log = recorded(tmp_path, "--friction", "lugre")
    (missing,) = diagnose_log(log, kr90.without(["viscous_friction@joint2"])).missing
    assert missing.first.key == "viscous_friction@joint2"


@pytest.mark.parametrize("without", [[], ["coulomb_friction@joint2"]])
def test_a_payload_left_out_is_not_taken_for_dry_friction(tmp_path: Path, kr90: Robot, without: list[str]) -> None:
    """How much friction has presliding is known before anything is found: 500 kg are slow beside a step of friction."""
    log = recorded(tmp_path, "--friction", "lugre", "--effect", "payload@link2:mass=500,com=1.2|0|0")
    sliding = system_of(prepare(log, kr90.without(without), "heavy.h5"), []).base.sliding
    np.testing.assert_allclose(sliding, draw_truth(3, (), (), log=True).chain.coulomb, rtol=0.02)


@pytest.mark.slow
def test_a_drive_that_turns_two_axes_keeps_the_friction_it_shares(tmp_path: Path, kr90: Robot) -> None:
    """Presliding is written for what rubs at its own joint only: the new description can be stepped."""
    coupling = "joint_coupling@joint3:from=1,ratio=0.5,inertia=200,friction=100,coulomb=200"
    found = diagnose_log(recorded(tmp_path, "--friction", "lugre", "--effect", coupling), kr90)
    assert "joint_coupling@joint3" in [m.first.key for m in found.missing]
    assert found.written is not None
    shared = next(e for e in found.written.physics if e.effect == "joint_coupling").values["friction"][1]
    dry = next(e for e in found.written.physics if (e.effect, e.site) == ("coulomb_friction", "joint1"))
    assert dry.values["torque"] >= shared * (1 - 1e-9) > 20
    mechanism = assemble(found.written, np.array([0.0, 1.2, -1.7]), brakes="off", drives="servo")
    assert mechanism.tendons


CLOCK = np.arange(0, 20, 1 / 200)


def doubts(
    speed_about: Callable[[FloatArray], FloatArray], recorded_late: float = 0.0, outside: bool = True
) -> list[tuple[slice, FloatArray]]:
    """Doubts of friction of an axis whose speed follows a law for 2 s about the middle, and 1 rad/s ``outside``."""
    since = CLOCK - 10.0025
    speed = speed_about(np.clip(since, -2, 2))
    speed += outside * np.sign(speed) * np.clip(np.abs(since) - 2, 0, None) / 8
    motion = Motion(CLOCK, *(x[:, None] for x in (np.cumsum(speed) / 200, speed, np.gradient(speed, CLOCK))))
    rows = Motion(*(x[::8] for x in (CLOCK, motion.position, motion.velocity, motion.acceleration)))
    none = np.zeros((len(rows.time), 1))
    valid, bands = np.ones(len(none), bool), Bands((8.0, 10.0), (12.0, 15.0))
    run = Run("run", rows.time, rows, motion, motion, none, none, none, None, valid, bands, 25.0, 250.0)
    return stop_columns(run, 0, recorded_late=recorded_late)


@pytest.mark.parametrize("late", [0.004, 0.02, 0.06, 0.12])
def test_friction_that_steps_later_than_a_slow_axis_seems_to_turn_back_is_in_doubt(late: float) -> None:
    """An axis of 1 rad/s that turns back at 5 mrad/s² does so up to 0.14 s earlier or later than it seems to."""
    ((near, columns),) = doubts(lambda since: 0.005 * since)
    passed = 2 * (np.abs(CLOCK - 10.0025 - late / 2) < late / 2).astype(float)
    step = lowpass(passed, 200, 8.0, 10.0)[::8][near]
    left = step - columns @ np.linalg.lstsq(columns, step, rcond=None)[0]
    assert np.abs(left).max() < 0.05 * np.abs(step).max()
    assert sum(columns.shape[1] for _, columns in doubts(lambda since: 0.5 * since)) == 2


def test_friction_is_in_doubt_as_late_as_torque_is_recorded() -> None:
    """The same columns, three rows of 40 ms later."""
    ((near, columns),), ((later, moved),) = (doubts(lambda since: 0.5 * since, late) for late in (0.0, 0.12))
    assert (later.start, later.stop) == (near.start + 3, near.stop + 3)
    np.testing.assert_allclose(moved, columns, atol=1e-9)


def test_an_axis_that_all_but_stops_may_have_turned_back() -> None:
    """Nothing tells a speed of 0.1 mrad/s from one of the other sign: dry friction steps there, or it does not."""
    ((_, columns),) = doubts(lambda since: 1e-4 + 0.1 * since**2)
    assert columns.shape[1] >= 4
    assert not doubts(lambda since: 1e-2 + 0.1 * since**2)


def test_a_slow_stop_is_in_doubt_for_as_long_as_the_axis_creeps() -> None:
    """Speed falls with the cube of the time left: from where it is too low to be told, as long again."""
    left = 0.001 * np.arange(300, 4000)
    assert _creeping(left**3) == pytest.approx(300, abs=2)
    assert _creeping(np.full(50, 1e-4)) == 0


def test_an_axis_that_hardly_moves_between_rests_creeps_no_longer_than_it_moves() -> None:
    """It was in doubt until the next fast motion, minutes later, with a column for every half row."""
    since = CLOCK - 10.0

    def law(_: FloatArray) -> FloatArray:
        speed = np.where(np.abs(since) < 0.5, 1e-4, 0.0)  # between two rests, far from the motions before and after
        return np.where(np.abs(since) > 6, np.sign(since) * 0.1, speed)

    assert max(columns.shape[1] for _, columns in doubts(law, outside=False)) < 20


def test_play_shows_in_the_difference_of_two_encoders(tmp_path: Path, kr90: Robot) -> None:
    """The load on joint 2 changes sign; the truth's link lags by ±gap/2 then, its motor does not."""
    log = recorded(tmp_path, "--link-encoder", "--effect", "backlash@joint2.z:gap=0.00015")
    found = diagnose_log(log, kr90, "play.h5")
    (missing,) = found.missing
    assert missing.first.key == "backlash@joint2.z"
    assert missing.first.parameters["gap"]["value"] == pytest.approx(1.5e-4, rel=0.1)
    assert any(entry.effect == "backlash" for entry in found.robot.physics)
    misfit = {f"{row['effect']}@{row['site']}": row["misfit"] * row["data"] for row in found.finalists}
    assert min(misfit, key=lambda name: misfit[name]) == "backlash@joint2.z"


@pytest.mark.parametrize(("rows", "step"), [(900, 8), (901, 2), (60, 8)])
def test_low_pass_and_thinning_in_one_step_are_those_in_two(rows: int, step: int) -> None:
    signal = np.cumsum(np.random.default_rng(0).normal(size=((rows - 1) * step + 1, 2)), axis=0)
    expected = lowpass(signal, 25.0 * step, 8.0, 10.0)[::step]
    np.testing.assert_allclose(lowpass(signal, 25.0 * step, 8.0, 10.0, every=step), expected, atol=1e-9)


def test_a_design_kept_by_joint_is_the_dense_matrix() -> None:
    rng = np.random.default_rng(0)
    acting = (np.array([0, 1, 3]), np.array([0, 2, 4]))
    blocks = tuple(rng.normal(size=(7, 3)) for _ in acting)
    dense = np.zeros((14, 5))
    for joint, (at, block) in enumerate(zip(acting, blocks, strict=True)):
        dense[7 * joint : 7 * joint + 7, at] = block
    more = rng.normal(size=(7, 2))
    own = tuple(Block(joint, at, block) for joint, (at, block) in enumerate(zip(acting, blocks, strict=True)))
    both = rng.normal(size=(14, 1))
    design = Design(7, 2, own, np.ones(5)).scaled({3: 5.0, 0: 0.1}).beside(((1,), more), ((0, 1), both))
    dense = np.column_stack([dense * [0.1, 1, 1, 5, 1], np.vstack([np.zeros((7, 2)), more]), both])
    design, dense = design.without([1, 5]), np.delete(dense, [1, 5], axis=1)
    z, y, columns = rng.normal(size=6), rng.normal(size=14), rng.normal(size=(7, 3))
    np.testing.assert_allclose(design.times(z), dense @ z)
    np.testing.assert_allclose(design.transposed(y), dense.T @ y)
    np.testing.assert_allclose(design.gram, dense.T @ dense)
    np.testing.assert_allclose(design.across((1,), columns), columns.T @ dense[7:])


@pytest.mark.slow
def test_a_law_outside_the_vocabulary_is_located_and_not_named(tmp_path: Path, kr90: Robot) -> None:
    """A torque 300 v₁ cos(q₁) at joint 1: a law is discovered, and it holds on runs not used."""
    log = recorded(tmp_path, "--nominal")
    runs = {}
    for name, run in log.runs.items():
        velocity = np.gradient(run.position, run.time, axis=0)
        torque = run.torque.copy()
        torque[:, 0] += 300 * np.cos(run.position[:, 0]) * velocity[:, 0]
        runs[name] = MotionRun(name, run.time, run.position, run.sample_rate_hz, torque=torque)
    found = diagnose_log(MotionLog(runs), kr90)
    assert found.word == "located"
    law = found.missing[-1].first
    assert (law.effect, law.site) == ("discovered", "joint1")
    assert law.formula is not None
    assert {"v1", "q1"} <= set(re.findall(r"[qv]\d", law.formula))
    assert found.error["after"]["held_out"] < 0.7 * found.error["before"]["held_out"]
    assert any(entry.effect == "discovered" for entry in found.robot.physics)


def test_a_late_channel_is_the_signal_of_a_moment_ago() -> None:
    time = np.arange(0, 20, 0.04)
    late = lowpass(np.sin(2 * np.pi * 1.3 * time), 25.0, 9.0, 11.0, delay_s=0.0117)
    np.testing.assert_allclose(late[50:-50], np.sin(2 * np.pi * 1.3 * (time - 0.0117))[50:-50], atol=1e-6)


def test_a_recording_acts_on_the_sum_of_all_laws_whichever_was_found_first(tmp_path: Path, kr90: Robot) -> None:
    """Late and too large by 20 %: what friction adds to the record is 1.2 times its torque of 4 ms ago."""
    prepared = prepare(recorded(tmp_path), kr90, "log.h5")
    run = prepared.used[0]
    friction = Entry(effect="viscous_friction", site="joint2", coefficient=500.0)
    chain = [Entry(effect="time_delay", site="log", delay=0.004)]
    chain.append(Entry(effect="torque_constant", site="joint2", gain=1.2))

    def state() -> State:
        return State(run.torque.copy(), np.zeros_like(run.dense.position), np.zeros_like(run.dense.position))

    sums = [
        sum(model_torque(run, here, [entry]) for entry in entries)
        for here, entries in ((state(), [*chain, friction]), (state(), [friction, *reversed(chain)]))
    ]
    np.testing.assert_allclose(sums[0], sums[1], atol=1e-9 * np.abs(run.torque).max())
    with_chain = state()
    model_torque(run, with_chain, chain)
    law = 500.0 * np.interp(run.time - 0.004, run.dense.time, run.dense.velocity[:, 1])
    added = entry_torque(run, with_chain, friction, friction.values)[:, 1]
    assert np.sqrt(np.mean((added - 1.2 * law)[50:-50] ** 2)) < 2e-3 * np.sqrt(np.mean(law**2))


@pytest.mark.slow
def test_what_a_later_find_makes_needless_goes(tmp_path: Path, kr90: Robot) -> None:
    """Torque 4 ms late looks like friction that follows the load at every joint until the delay is in the model."""
    effects = ("--effect", "load_dependent_friction@joint2:coefficient=0.02", "--effect", "time_delay@log:delay=0.004")
    log = recorded(tmp_path, *effects)
    found = diagnose_log(log, kr90)
    assert {m.first.key for m in found.missing} == {"load_dependent_friction@joint2", "time_delay@log"}
    # compared as it was recorded, also where another recording has moved what was found by nothing worth telling
    moved = [
        e.model_copy(update={"delay": (1 + 1e-9) * e.values["delay"]}) if e.effect == "time_delay" else e
        for e in found.model.physics
    ]
    for robot in (found.model, found.model.model_copy(update={"physics": moved})):
        again = pooled(predicted_by(robot, log, found, found.held_out), "after")
        assert again["held_out"] == pytest.approx(found.error["after"]["held_out"], rel=0.05)


@pytest.mark.parametrize(("seconds", "stops"), [(5.0, [20.0, 40.0]), (45.0, [])])
def test_a_short_log_may_be_fitted_through_wider_low_passes(seconds: float, stops: list[float], tmp_path: Path) -> None:
    """Some seconds below 10 Hz have fewer rows of a joint than a robot has numbers; 45 s have enough."""
    machine = machines()["six"]
    rng = np.random.default_rng(5)
    robot = draw_truth(5, (), (), machine.tolerances, chain=machine.chain, log=True)
    how = truth_motion.Log(white=machine.torque, coloured=machine.torque)
    clock = np.arange(int(seconds * how.rate_hz)) / how.rate_hz
    runs = {}
    for k in range(2):
        path = truth_motion.draw_fourier(machine.chain, rng, seconds)
        found = truth_motion.record(robot, truth_motion.Run(f"run{k}", path, clock, 60.0 * k), how, rng)
        runs[f"run{k}"] = MotionRun(f"run{k}", clock + 60 * k, found.position, how.rate_hz, torque=found.torque)
    write_description(machine, tmp_path / "arm.yaml")
    first = prepare(MotionLog(runs), load_robot(tmp_path / "arm.yaml"), "log", ["run1"])
    assert [bands.fit[1] for bands in wider_bands(first, MotionLog(runs))] == stops


def test_a_second_log_keeps_what_it_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model of all is the last log's, which stands on the first: nothing of it follows the first one's numbers."""
    told: dict[str, Any] = {}
    monkeypatch.setattr(engine, "together", lambda findings, base, robot: told.update(robot=robot))
    first, last = (
        SimpleNamespace(
            following=lambda robot: "the first log's", error={}, missing=[], robot=name, model=name, base=""
        )
        for name in ("first", "last")
    )
    logs = [SimpleNamespace(again=lambda *_: None)] * 2
    engine._settled([first, last], logs, [None, None])  # type: ignore[arg-type, list-item]
    assert told["robot"] == "last"


def test_low_speed_friction_or_slip_lists_each_once() -> None:
    low, slip = (
        SimpleNamespace(effect=effect, site=site, key=f"{effect}@{site}")
        for effect, site in (("stribeck_friction", "joint2"), ("hysteresis", "joint2.z"))
    )
    other = SimpleNamespace(key="coulomb_friction@joint2")
    search = SimpleNamespace(system=None, found=[])
    found = Missing(low, 0.6, ((slip, 0.3), (other, 0.05)), "")  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torque, "_at_rest", lambda _: [low])
        said = torque._or_slip(search, found, [found, Missing(slip, 0.9, (), "")])  # type: ignore[arg-type]
    assert [c.key for c, _ in said.alternatives] == ["hysteresis@joint2.z", "coulomb_friction@joint2"]
    assert said.probability == said.alternatives[0][1] == pytest.approx(0.45)


@pytest.mark.slow
def test_a_large_payload_is_not_drawn_towards_a_usual_one(tmp_path: Path, kr90: Robot) -> None:
    """500 kg on link 2, twenty-five times what is usual: its prior width would make 440 kg of it."""
    log = recorded(tmp_path, "--nominal", "--effect", "payload@link2:mass=500,com=1.0|0|0")
    (missing,) = diagnose_log(log, kr90).missing
    low, high = missing.first.parameters["mass"]["interval90"]
    assert low < 500 < high
    assert high - low < 150


@pytest.mark.slow
def test_a_load_that_a_links_own_mass_may_be_has_that_mass_as_its_rival(tmp_path: Path, kr90: Robot) -> None:
    """50 kg on the elbow's axis, within what links may weigh: on the outer link, or that link's own."""
    found = diagnose_log(recorded(tmp_path, "--effect", "payload@link2:mass=50,com=1.35|0|0"), kr90)
    (missing,) = found.missing
    said = {c.key: p for c, p in [(missing.first, missing.probability), *missing.alternatives]}
    assert set(said) == {"payload@link3", "parameter@link3.mass"}
    assert max(said.values()) < 0.6


@pytest.mark.slow
def test_play_stays_where_what_was_named_beside_it_is_refused(
    tmp_path: Path, kr90: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load that only relieves tension goes; the gap, which the second encoder shows, does not go with it."""
    effects = ("--effect", "backlash@joint2.z:gap=0.00015", "--effect", "payload@link2:mass=70,com=1.35|0|0")
    log = recorded(tmp_path, "--link-encoder", *effects)
    monkeypatch.setattr(torque, "falls", lambda _: False)
    monkeypatch.setattr(torque, "taken_back", lambda _: None)
    found = diagnose_log(log, kr90)
    assert [missing.first.key for missing in found.missing] == ["backlash@joint2.z"]
    (note,) = (w for w in found.warnings if isinstance(w, Note) and w.kind == "tension")
    assert len(note.sites) == 1
    assert note.sites[0].startswith("payload@")


@pytest.mark.slow
def test_a_drive_that_hardly_turns_with_another_axis_is_found(tmp_path: Path, kr90: Robot) -> None:
    """A ratio of −0.016: far from one, and where its dry friction turns round goes with its sign."""
    found = diagnose_log(recorded(tmp_path, "--effect", "joint_coupling@joint2:from=3,ratio=-0.016"), kr90)
    (missing,) = found.missing
    assert missing.first.key == "joint_coupling@joint2"
    assert missing.first.parameters["ratio"]["value"] == pytest.approx(-0.016, rel=0.15)


def test_whitening_makes_coloured_noise_white() -> None:
    rng = np.random.default_rng(1)
    noise = lfilter([1.0], [1.0, -0.9], rng.normal(size=20_000))
    none = np.zeros((len(noise), 1))
    filter_ = prediction_filter(_correlation([noise], [none], [np.ones(len(noise), bool)], 30))
    white = lfilter(filter_, [1.0], noise)[30:]
    assert np.std(white) == pytest.approx(1, rel=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03


def test_slip_elements_by_reversals_are_those_by_samples() -> None:
    """Stepping through every sample, as the law is written down, gives the same torque."""
    rng = np.random.default_rng(2)
    q = np.cumsum(rng.normal(size=500))[:, None] * 1e-3
    stiffness, limit = np.array([1e4, 3e3]), np.array([20.0, 15.0])
    element, expected = np.zeros(2), []
    for step in np.diff(q[:, 0], prepend=q[0, 0]):
        element = np.clip(element + stiffness * step, -limit, limit)
        expected.append(element.sum())
    values = {"stiffness": stiffness.tolist(), "yield_torque": limit.tolist()}
    found = CATALOGUE["hysteresis"].torque(Motion(np.arange(500.0), q, 0 * q, 0 * q), "joint1.z", values)
    np.testing.assert_allclose(found[0], expected, atol=1e-9)


def test_a_discovered_law_loads_and_adds_its_formula_to_the_torque(kr90: Robot) -> None:
    data = kr90.model_dump(mode="json")
    formula = "c1*sign(v2)*abs(q1) + c2*sin(2*q3)**2"
    data["physics"].append({"effect": "discovered", "site": "joint3", "formula": formula, "coefficients": [3, -2.5]})
    robot = parse_robot(data)
    rng = np.random.default_rng(0)
    q, v, a = (rng.uniform(0.2, 1.0, (20, 3)) * sign for sign in (1, -1, 1))
    difference = inverse_dynamics(robot, Motion(np.arange(20.0), q, v, a)) - inverse_dynamics(
        kr90, Motion(np.arange(20.0), q, v, a)
    )
    np.testing.assert_allclose(difference[:, 2], -3 * q[:, 0] - 2.5 * np.sin(2 * q[:, 2]) ** 2, atol=1e-9)
    assert not difference[:, :2].any()


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("c1*w1", "unknown 'w1'"), ("c3*q1", "c3 is missing"), ("__import__('os')", "before a bracket"),
        ("c1 if q1 else 0", "expected arithmetic"), ("c1*", "not an expression"), ("q1.real", "expected arithmetic"),
    ],
)  # fmt: skip
def test_a_formula_is_arithmetic_only(kr90: Robot, formula: str, message: str) -> None:
    data = kr90.model_dump(mode="json")
    data["physics"].append({"effect": "discovered", "site": "joint1", "formula": formula, "coefficients": [1, 2]})
    with pytest.raises(InputError, match=message):
        parse_robot(data)


@pytest.mark.slow
def test_churned_oil_is_not_taken_for_a_friction_that_has_a_name(tmp_path: Path, kr90: Robot) -> None:
    """Drag c q̇|q̇|: Stribeck friction beside described viscous friction nearly mimics it, one term of a law is it."""
    log = recorded(tmp_path, "--effect", "quadratic_friction@joint1:coefficient=150")
    found = diagnose_log(log, kr90)
    assert found.word == "located"
    (law,) = [missing.first for missing in found.missing]
    assert law.key == "discovered@joint1"
    assert law.formula == "c1*abs(v1)*v1"
    ((low, high),) = law.parameters["coefficients"]["interval90"]
    assert low < 150 < high
    faint = recorded(tmp_path, "--effect", "quadratic_friction@joint1:coefficient=20", "--friction", "lugre")
    assert [m.first.key for m in diagnose_log(faint, kr90).missing] in ([], ["discovered@joint1"])


@pytest.mark.parametrize("coefficient", [-40.0, pytest.param(80.0, marks=pytest.mark.slow)])
def test_friction_that_bends_alike_at_most_joints_belongs_to_the_model(
    coefficient: float, tmp_path: Path, kr90: Robot
) -> None:
    """c q̇|q̇| at every joint, which the description has not: no answer, and the written robot has it."""
    each = [f"quadratic_friction@joint{j}:coefficient={coefficient}" for j in (1, 2, 3)]
    found = diagnose_log(recorded(tmp_path, *(part for one in each for part in ("--effect", one))), kr90)
    assert found.word == "adequate"
    assert found.error["before"]["held_out"] < 1.3 * found.error["noise_floor"]
    (note,) = [w for w in found.warnings if "no straight line in speed" in w]
    assert note.sites == ("joint1", "joint2", "joint3")  # type: ignore[attr-defined]
    laws = [e for e in found.robot.physics if e.effect == "discovered"]
    assert [e.site for e in laws] == ["joint1", "joint2", "joint3"]
    sizes = [e.values["coefficients"][0] for e in laws]
    assert sizes == pytest.approx(3 * [coefficient], rel=0.5)


def test_friction_that_bends_at_one_joint_is_no_habit_of_its_drives(tmp_path: Path, kr90: Robot) -> None:
    found = diagnose_log(recorded(tmp_path, "--effect", "quadratic_friction@joint2:coefficient=-60"), kr90)
    assert not any("no straight line in speed" in w for w in found.warnings)
    assert {m.first.site for m in found.missing} <= {"joint2"}


@pytest.mark.parametrize(("joint", "velocity"), [(1, 0.05), (3, 0.2)])
@pytest.mark.slow
def test_friction_that_falls_as_a_film_builds_up_keeps_its_name(
    tmp_path: Path, kr90: Robot, joint: int, velocity: float
) -> None:
    """A Stribeck curve bends at low speed: q̇|q̇| explains less of it, and bristles that carry it are no slip beside."""
    effect = f"stribeck_friction@joint{joint}:static_excess=50,velocity={velocity}"
    (missing,) = diagnose_log(recorded(tmp_path, "--friction", "lugre", "--effect", effect), kr90).missing
    assert missing.first.key == f"stribeck_friction@joint{joint}"
    low, high = missing.first.parameters["velocity"]["interval90"]
    assert low < velocity < high


@pytest.mark.slow
def test_friction_that_follows_the_load_feels_a_payload_that_is_found_beside_it(tmp_path: Path, kr90: Robot) -> None:
    """Its coefficient is that of the loaded robot: without the payload in the load it came out twice too large."""
    effects = ("--effect", "payload@flange:mass=100", "--effect", "load_dependent_friction@joint2:coefficient=0.05")
    found = diagnose_log(recorded(tmp_path, *effects), kr90)
    named = {missing.first.effect: missing.first for missing in found.missing}
    assert set(named) == {"payload", "load_dependent_friction"}
    low, high = named["load_dependent_friction"].parameters["coefficient"]["interval90"]
    assert low < 0.05 < high


@pytest.mark.parametrize(
    "effect",
    [
        "friction_drift@joint2:amplitude=0.8,time_constant=40",
        pytest.param("load_dependent_friction@joint2:coefficient=0.06", marks=pytest.mark.slow),
    ],
)
def test_what_varies_dry_friction_varies_how_it_turns_round(tmp_path: Path, kr90: Robot, effect: str) -> None:
    """Bristles carry as much as friction does just then; else slip or asymmetry was named beside it."""
    found = diagnose_log(recorded(tmp_path, "--friction", "lugre", "--effect", effect), kr90)
    assert [m.first.key for m in found.missing] == [effect.partition(":")[0]]


def test_a_ripple_has_one_amplitude_and_phase(tmp_path: Path, kr90: Robot) -> None:
    """−A sin(φ) is A sin(φ ± π): the amplitude is given above zero."""
    log = recorded(tmp_path, "--effect", "torque_ripple@joint2:amplitude=30,order=16,phase=-2.5")
    (missing,) = diagnose_log(log, kr90).missing
    assert missing.first.key == "torque_ripple@joint2"
    for name, true in (("amplitude", 30), ("order", 16), ("phase", -2.5)):
        low, high = missing.first.parameters[name]["interval90"]
        assert low < true < high


@pytest.mark.slow
def test_a_fast_ripple_is_found_at_its_own_order_and_not_beside_it(tmp_path: Path, kr90: Robot) -> None:
    """Slopes over a step in which the wave turns by half a radian stalled one lobe of the spectrum away."""
    log = recorded(tmp_path, "--effect", "torque_ripple@joint2:amplitude=16,order=37.6,phase=-0.75")
    (missing,) = diagnose_log(log, kr90).missing
    assert missing.first.key == "torque_ripple@joint2"
    low, high = missing.first.parameters["order"]["interval90"]
    deviation = (high - low) / (2 * NINETY)
    assert abs((low + high) / 2 - 37.6) < 3 * deviation
    assert high - low < 1.0  # the next lobe is further


@pytest.mark.slow
def test_friction_that_differs_by_direction_holds_its_share_through_a_standstill(tmp_path: Path, kr90: Robot) -> None:
    """Bristles hold 45 N·m more than the mean in one direction, at rest too: taken for nothing there they halved it."""
    effect = "asymmetric_friction@joint1:torque_difference=90,viscous_difference=110"
    (missing,) = diagnose_log(recorded(tmp_path, "--friction", "lugre", "--effect", effect), kr90).missing
    assert missing.first.key == "asymmetric_friction@joint1"
    assert missing.first.parameters["torque_difference"]["value"] == pytest.approx(90, rel=0.15)


def test_a_drive_that_turns_with_two_axes_is_in_doubt_where_it_turns_back_itself(tmp_path: Path, kr90: Robot) -> None:
    """Its friction steps between two samples, away from where its axis turns back."""
    log = recorded(tmp_path, "--effect", "joint_coupling@joint1:from=2,ratio=-0.02")
    prepared = prepare(log, kr90, "log")
    plain = system_of(prepared, [])
    suspect = next(s for s in log_suspects(kr90, prepared.used) if s.name == "joint_coupling@joint1 joint2")
    system = relinearised(extended(plain, settle(plain, start(plain, suspect))))
    turning = with_doubts(system)
    assert turning.turning[1, 0] == pytest.approx(-0.02, rel=0.1)
    assert len(turning.stops[1]) > len(system.stops[1])
    assert [len(stops) for stops in turning.stops[::2]] == [len(stops) for stops in system.stops[::2]]
    own = turning.own(suspect)[0]
    spread = np.sqrt(np.linalg.inv(turning.information)[own, own])
    assert spread > np.sqrt(np.linalg.inv(system.information)[own, own])
    assert abs(0.5 * turning.z[own] + 0.02) < 3 * 0.5 * spread


def test_an_answer_is_told_of_its_joint_and_its_rivals_whichever_model_is_looked_at(drifting: Finding) -> None:
    """With a hammer test beside the log, its errors are those of the model that both end with."""
    (missing,) = drifting.missing
    error = {**drifting.error, "after": {"train": 0.5, "held_out": 0.25}}
    apart = {missing.first.key: ["The log tells them apart."]}
    (again,) = with_evidence(replace(drifting, error=error, apart=apart))
    assert again.evidence.startswith("Without cable_stiffness at joint1 the torque of joint1 in run")
    assert "→ 25.00%" in again.evidence
    assert again.evidence.endswith("The log tells them apart.")


def test_the_rest_of_a_log_follows_where_links_are_settled_by_another_recording(
    tmp_path: Path, drifting: Finding
) -> None:
    """An arm 3 % heavier, beside what the log says, weighs like a compensator that unloads it more."""
    log = recorded(tmp_path, "--effect", "cable_stiffness@joint1:stiffness=60,rest=0.3")
    links = list(drifting.model.links)
    mass, _, inertia = links[1].inertial
    links[1] = links[1].model_copy(update={"mass": 1.03 * mass, "inertia": inertia_six(1.03 * inertia)})
    heavier = drifting.model.model_copy(update={"links": links})
    assert drifting.following is not None
    followed_robot = drifting.following(heavier)
    assert followed_robot.links == links
    fit = drifting.error["after"]["train"]
    judged = [predicted_by(robot, log, drifting, drifting.held_out) for robot in (heavier, followed_robot)]
    stiff, freed = (pooled(records, "after")["train"] for records in judged)
    assert freed < 1.1 * fit < 1.3 * fit < stiff
    (was,), (now,) = (
        [e.values["coefficients"][0] for e in robot.physics if e.effect == "gravity_compensator"]
        for robot in (heavier, followed_robot)
    )
    assert now < was < 0
    (answer,) = drifting.missing
    moved = followed(answer, drifting.model, followed_robot).first.parameters["stiffness"]
    (entry,) = [e for e in followed_robot.physics if e.effect == "cable_stiffness"]
    assert moved["value"] == entry.values["stiffness"] != answer.first.parameters["stiffness"]["value"]
    assert np.ptp(moved["interval90"]) == pytest.approx(np.ptp(answer.first.parameters["stiffness"]["interval90"]))


def test_links_within_what_a_log_knows_cost_it_no_more_than_their_tension(drifting: Finding) -> None:
    """Links two deviations off, as the gain of the record would have them: gain, ripple and zeros go with them."""
    follow = drifting.following
    assert follow is not None
    fit = follow.fit
    gain = fit.parameters.names.index("torque_gain")
    covariance = np.linalg.inv(fit.information)
    z = fit.z + 2 * covariance[gain] / np.sqrt(covariance[gain, gain])
    told = dict(zip(fit.parameters.names, fit.parameters.values(z), strict=True))
    robot = follow(follow.system.robot(z))
    assert follow.values(robot)["torque_gain"] == pytest.approx(told["torque_gain"], rel=1e-3)
    own, moved = (predicted_by(r, drifting.content, drifting, drifting.held_out) for r in (drifting.robot, robot))

    def cost(records: list[Any]) -> float:
        rest = [((r.measured - r.predicted["after"]) / r.noise)[r.valid] for r in records]
        return 0.5 * sum(float(np.sum(part**2)) for part in rest)

    assert cost(moved) - cost(own) < 4  # ½ 2² of tension, and as much for what is not linear


def test_a_log_s_name_is_judged_with_the_links_that_all_recordings_agree_on(drifting: Finding) -> None:
    """They may cost the log more than its name gains: both models have them, or the name would be refused."""
    links = list(drifting.model.links)
    _, com, _ = links[2].inertial
    links[2] = links[2].model_copy(update={"com": tuple(com + np.array([0, 0.08, 0.0]))})
    agreed = drifting.model.model_copy(update={"links": links})
    finding = replace(drifting)
    assert drifting.following is not None
    last = SimpleNamespace(robot=agreed, records=[])
    Log(SimpleNamespace()).again(finding, drifting.following(agreed), last, finding.held_out)  # type: ignore[arg-type]
    own, here = (found.error["before"]["held_out"] for found in (drifting, finding))
    assert own < finding.error["after"]["held_out"] < here
    assert falls(finding)
    number = Missing(Candidate("parameter", "link3.com", 1.0, drifting.robot, {}), 0.9, (), "")
    told = replace(drifting, missing=[number])  # a number that blows show, too: before it, links are the log's own
    Log(SimpleNamespace()).again(told, drifting.following(agreed), last, told.held_out)  # type: ignore[arg-type]
    assert told.error["before"]["held_out"] == pytest.approx(own)


def test_evidence_is_about_the_joint_that_an_answer_acts_on(drifting: Finding) -> None:
    """The hose pack pulls joint 1: that joint's torque by itself, joint 3's where something at joint 3 is judged."""
    (missing,) = drifting.missing
    assert missing.evidence.startswith("Without cable_stiffness at joint1 the torque of joint1 in run")
    other = sentence("backlash at joint3.z", drifting.records, drifting.error, drifting.held_out, 2)
    assert "the torque of joint3 in run" in other


def test_the_joint_that_was_missed_is_shown(drifting: Finding) -> None:
    """Without the hose pack the refitted model misses joint 1 most."""
    assert drifting.sites["joint1"] == max(drifting.sites.values())


def test_a_run_too_short_and_an_unknown_run_are_refused(kr90: Robot) -> None:
    time = np.arange(200) / 250
    moving = np.tile(np.sin(time)[:, None], 3)
    run = MotionRun("a", time, moving, 250.0, torque=np.random.default_rng(0).normal(size=(200, 3)))
    with pytest.raises(InputError, match="too short"):
        prepare(MotionLog({"a": run}), kr90, "log.h5")


@needs("emps")
def test_emps_has_dry_friction_whichever_record_is_held_out() -> None:
    """Stribeck friction that falls over all speeds of the axis is nearly that; it may not take its place."""
    robot = load_robot(DATA / "emps.yaml").without(["asymmetric_friction", "coulomb_friction"])
    found = diagnose_log(emps(), robot, "emps", hold_out=["training"])
    names = {m.first.effect: m.first.parameters for m in found.missing}
    assert names["coulomb_friction"]["torque"]["value"] == pytest.approx(20.0, abs=3.0)
    assert "stribeck_friction" not in names


@needs("emps")
def test_emps_from_viscous_only_comes_to_dry_and_direction_dependent_friction() -> None:
    """Published: F_c 20.4 N, F_v 166.7 and 240.4; ≤ 3.11 % on the training record, ≤ 2.56 N on the pulse record."""
    robot = load_robot(DATA / "emps.yaml").without(["asymmetric_friction", "coulomb_friction"])
    found = diagnose_log(emps(), robot, "emps", hold_out=["pulses"])
    assert [missing.first.effect for missing in found.missing] == ["coulomb_friction", "asymmetric_friction"]
    assert found.missing[0].first.parameters["torque"]["value"] == pytest.approx(20.4, rel=0.02)
    viscous = found.missing[1].first.parameters["viscous_difference"]
    assert viscous["value"] == pytest.approx(166.7 - 240.4, rel=0.02)
    assert viscous["interval90"][0] < 166.7 - 240.4 < viscous["interval90"][1]
    assert found.error["after"]["train"] < 0.0311
    (pulses,) = [record for record in found.records if record.held_out]
    rest = (pulses.measured - pulses.predicted["after"])[pulses.valid]  # type: ignore[union-attr]
    assert np.sqrt(np.mean(rest**2)) < 2.56
    restless = [spot for spot in found.location if spot["band_hz"][0] > 10]
    assert restless[0]["run"] == "pulses"
    assert restless[0]["band_hz"][0] < 19 < 33 < restless[0]["band_hz"][1]
    assert any("'pulses' is restless at" in warning for warning in found.warnings)


@pytest.mark.slow
@needs("tx40")
def test_the_tx40s_wrist_is_found_to_be_coupled() -> None:
    """Nine seconds of a small robot, its axes recorded: joints 5 and 6 are predicted as when the coupling is known."""
    described = load_robot(DATA / "tx40.yaml")
    drives = [drive.model_copy(update={"coupling": {}}) for drive in described.drives]
    log = in_joints(tx40(), described)
    found = diagnose_log(log, described.model_copy(update={"drives": drives}), bands=bands_of(log))  # 10 Hz: RMS
    assert found.missing[0].first.title == "joint_coupling at joint5, from joint6"
    assert found.missing[0].data()["words"] == {"from": "joint6"}
    assert not any(missing.first.effect == "stribeck_friction" for missing in found.missing)
    before, after = _held_out_rms(found)
    assert np.all(before[4:] > [8, 2.5])
    assert np.all(after[4:] <= [1.22, 0.58])  # the base model's that knows it: `before` of the same log as `described`


@pytest.mark.slow
@needs("tx40")
@pytest.mark.xfail(strict=True, reason="a second coupling of joint 5 is named; joint 5 is predicted better with it")
def test_friction_of_the_tx40s_coupled_drive_is_on_both_axes() -> None:
    """A described coupling explains its drive's friction on both: nothing is missing at the wrist."""
    found = diagnose_log(tx40(), load_robot(DATA / "tx40.yaml"), "tx40")
    assert {missing.first.site for missing in found.missing} <= {"joint1", "joint2", "joint3"}
    before, _ = _held_out_rms(found)
    assert np.all(before[4:] <= [1.3, 0.65])


def _held_out_rms(found: Finding) -> tuple[FloatArray, FloatArray]:
    """RMS (n,) of the error before and after, N·m."""
    (kept,) = [record for record in found.records if record.held_out]
    rests = ((kept.measured - kept.predicted[stage])[kept.valid] for stage in ("before", "after"))  # type: ignore[union-attr]
    before, after = (np.sqrt(np.mean(rest**2, axis=0)) for rest in rests)
    return before, after


def test_ten_seconds_of_an_arm_that_carries_a_load_show_it_and_nothing_else(tmp_path: Path) -> None:
    """Through 40 Hz the noise of accelerations was told as a filter of the record and slip at three joints."""
    ((robot, log, load),) = cases("six", tmp_path, range(4, 5), seed=0)
    (missing,) = diagnose_log(log, robot).missing
    assert missing.first.key == "payload@flange"
    assert holds(missing.first, load.mass)


def test_a_load_whose_inertia_would_come_out_below_zero_is_told_with_none(tmp_path: Path) -> None:
    """Friction that gives way before it slips passes for less inertia about joint 6; the load was then told as none."""
    ((robot, log, load),) = cases("six", tmp_path, range(7, 8), seed=5)
    (missing,) = diagnose_log(log, robot).missing
    assert missing.first.key == "payload@flange"
    assert holds(missing.first, load.mass)
    ends = np.array(missing.first.parameters["inertia"]["interval90"])
    assert (ends[:, 1] > 0).all()


def test_what_can_only_be_explained_by_what_cannot_be_is_not_adequate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load with a moment of inertia below zero halves the error kept aside: no load, but not nothing either."""
    monkeypatch.setattr(torque_search, "bounded", lambda steps, system: system)
    ((robot, log, _),) = cases("six", tmp_path, range(7, 8), seed=5)
    finding = diagnose_log(log, robot)
    assert (finding.word, finding.missing) == ("unexplained", [])
    assert finding.other == 1.0
