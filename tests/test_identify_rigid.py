"""Identification from torque logs: the truth code's robots, consistency, hold-out, and logs that are damaged."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tools.coverage_rigid import study
from twin.commands.example import EXAMPLES
from twin.commands.simulate import simulate
from twin.errors import InputError
from twin.identify.excitation import Fourier
from twin.identify.rigid import LOW_PASSES, Identification, consistent, identify
from twin.identify.rigid_compare import compare_log
from twin.measure import motion_log
from twin.measure.motion_log import (
    MotionLog,
    MotionRun,
    check_against,
    read_motion_log,
    saturated,
    write_motion_log,
)
from twin.measure.signals import advance, differentiate, lowpass
from twin.measure.torque_unit import unit_note
from twin.model.possible import nearest_possible
from twin.model.regressor import Regressor, pseudo_inertia
from twin.model.replay import inverse_dynamics
from twin.model.torque_rows import Bands, holding, joint_run, relative_error, rows_of
from twin.physics.motion import Motion
from twin.robot.description import Assumed, Robot, load_robot, parse_robot, save_robot

RATE = 250.0


@pytest.fixture(scope="module")
def fourier() -> list[Fourier]:
    rng = np.random.default_rng(4)
    centre = np.array([0.0, 1.3, -1.6])
    return [
        Fourier(rng.normal(0, 0.25, (3, 5)), rng.normal(0, 0.25, (3, 5)), centre + rng.normal(0, 0.05, 3))
        for _ in range(4)
    ]


def recorded(robot: Robot, fourier: list[Fourier], noise: float = 0.0, seconds: float = 20.0) -> MotionLog:
    """Inverse dynamics of the robot along trajectories, 250 Hz, with white torque noise."""
    rng = np.random.default_rng(1)
    runs = {}
    for k, f in enumerate(fourier):
        time = np.arange(round(seconds * RATE)) / RATE
        motion = f.motion(time)
        torque = inverse_dynamics(robot, motion) + noise * rng.normal(size=motion.position.shape)
        runs[f"run{k + 1}"] = MotionRun(f"run{k + 1}", time, motion.position, RATE, torque)
    return MotionLog(runs, robot.name)


@pytest.fixture(scope="module")
def log(kr90: Robot, fourier: list[Fourier]) -> MotionLog:
    return recorded(kr90, fourier, 10.0)


@pytest.fixture(scope="module")
def found(kr90: Robot, log: MotionLog) -> Identification:
    return identify(log, kr90)


@pytest.fixture
def saved(tmp_path: Path, log: MotionLog) -> Path:
    path = tmp_path / "log.h5"
    write_motion_log(path, MotionLog({"run1": log.runs["run1"]}, "kr90"))
    return path


def change(path: Path, key: str, edit: Callable[[np.ndarray], np.ndarray]) -> None:
    with h5py.File(path, "r+") as file:
        values = edit(file[f"runs/run1/{key}"][()])
        del file[f"runs/run1/{key}"]
        file[f"runs/run1/{key}"] = values


def test_without_noise_the_parameters_come_back(kr90: Robot, fourier: list[Fourier]) -> None:
    """Every base, friction and compensator parameter to 1e-3 of its torque from a log that starts in mid-motion."""
    result = identify(recorded(kr90, fourier), kr90)
    true = result.estimate.base.combine @ result.regressor.described
    Y = np.concatenate([r.matrix[r.valid] for r in result.split.train])[:, :, result.estimate.base.kept]
    torque = (result.estimate.value - true) * np.sqrt(np.mean(Y**2, axis=0)).max(axis=0)
    largest = max(np.abs(r.torque).max() for r in result.split.train)
    assert np.abs(torque).max() < 1e-3 * largest
    assert relative_error(result.split.held_out, result.parameters)[0].max() < 1e-3


@pytest.mark.parametrize("width", [0.003, 0.01, 0.04])
def test_intervals_tell_that_friction_may_turn_gradually(kr90: Robot, fourier: list[Fourier], width: float) -> None:
    """Dry friction tanh(q̇ / width rad/s): its 90 % intervals hold it all the same."""
    runs = {}
    rng = np.random.default_rng(2)
    time = np.arange(round(20 * RATE)) / RATE
    for k, f in enumerate(fourier[:2]):
        motion = replace(f.motion(time), sign=lambda v: np.tanh(v / width))
        torque = inverse_dynamics(kr90, motion) + 10.0 * rng.normal(size=motion.position.shape)
        runs[f"run{k}"] = MotionRun(f"run{k}", time, motion.position, RATE, torque)
    log = MotionLog(runs, kr90.name)
    result = identify(log, kr90, hold_out=["run1"], bands=Bands())
    estimate, true = result.estimate, result.estimate.base.combine @ result.regressor.described
    friction = np.array(["friction" in name for name in estimate.base.names])
    off = np.abs(estimate.value - true)[friction] / estimate.deviation[friction]
    assert np.mean(off < 1.645) >= 0.9


def test_intervals_hold_the_truth_of_independent_robots(tmp_path: Path) -> None:
    """Robots, encoders, noise and trajectories of the truth code: of 26 parameters in 6 logs about nine in ten.

    156 draws, correlated within a log; the bounds are three binomial deviations of 40 independent ones. The full study
    is tools/coverage_rigid.py.
    """
    hits, ratios = [], []
    for seed in range(6):
        result, true = study(100 + seed, 3, 30.0, tmp_path)
        low, high = result.estimate.interval90.T
        hits += list((true >= low) & (true <= high))
        ratios.append(relative_error(result.split.held_out, result.parameters)[1] / result.estimate.noise)
    assert 0.76 < np.mean(hits) < 0.99
    assert 0.8 < np.mean(ratios) < 1.25  # held-out runs are predicted to the noise floor


def test_effective_samples_follow_the_noises_bandwidth(kr90: Robot, log: MotionLog) -> None:
    """White noise after the 3–4 Hz taper is worth 2 ∫ gain² df = 6.75 independent samples a second and joint.

    The bandwidth of one joint comes from some fifteen lines of a spectrum, that of three from as many times more.
    """
    result = identify(log, kr90, hold_out=["run4"])
    seconds = sum(r.valid.sum() / r.rate_hz for r in result.split.train)
    assert np.mean(result.estimate.effective) == pytest.approx(6.75 * seconds, rel=0.25)


def test_what_the_low_pass_removes_is_said_to_be_unidentifiable(kr90: Robot, found: Identification) -> None:
    """The rotors' torques in sin 2Nq do not pass 4 Hz: named as such; everything else of the KR90 is identifiable."""
    named = [note for note in found.notes if "not identifiable" in note]
    assert [note.split(":")[0] for note in named] == [f"drive{i}.Ixx − drive{i}.Iyy" for i in (2, 3)]
    assert found.estimate.identifiable.all()


def test_the_consistent_robot_can_exist_where_least_squares_cannot(kr90: Robot, log: MotionLog) -> None:
    """From data that asks for Table A1's impossible arm, positive pseudo-inertias, and the torque still explained."""
    found = identify(log, kr90)
    asked = found.estimate.value.copy()
    names = found.estimate.base.names
    asked[names.index("link2.mcx")] = 678.7  # Table A1
    robbed = replace(found.estimate, value=asked)
    for estimate in (found.estimate, robbed):
        x = consistent(found.regressor, estimate)
        for i in range(3):
            assert np.linalg.eigvalsh(pseudo_inertia(x[10 * i : 10 * i + 10])).min() > 0
        robot = found.regressor.robot_with(x)  # its own checks pass
        assert all(link.mass is not None and link.mass > 0 for link in robot.links)
    error, _ = relative_error(found.split.held_out, found.parameters)
    free, _ = relative_error(found.split.held_out, found.least_squares_parameters())
    assert (error < 1.05 * free + 1e-4).all()


def test_friction_is_filtered_like_the_data(kr90: Robot, fourier: list[Fourier]) -> None:
    """At 25 Hz, where a reversal falls between samples, friction is found to 5 %: its column is made at 250 Hz."""
    log = recorded(kr90, fourier)
    runs = {}
    for name, run in log.runs.items():
        smooth = np.array([np.convolve(t, np.ones(1), "same") for t in run.torque.T]).T
        runs[name] = MotionRun(name, run.time[::10], run.position[::10], 25.0, smooth[::10])
    result = identify(MotionLog(runs), kr90, bands=Bands((2.0, 3.0)))
    for i, true in enumerate((307.8, 373.24, 225.0)):
        k = result.estimate.base.names.index(f"coulomb_friction@joint{i + 1}.torque")
        assert result.estimate.value[k] == pytest.approx(true, rel=0.05)


def test_whole_runs_are_held_out_or_blocks_of_the_only_one(kr90: Robot, log: MotionLog, found: Identification) -> None:
    """Without names every third run; with one run blocks with a gap; a name that is no run is refused."""
    assert [r.name for r in found.split.held_out] == ["run3"]
    assert [r.name for r in identify(log, kr90, hold_out=["run2"]).split.held_out] == ["run2"]
    with pytest.raises(InputError, match="runs are run1, run2"):
        identify(log, kr90, hold_out=["nope"])
    alone = identify(MotionLog({"run1": log.runs["run1"]}), kr90).split
    train, held = alone.train[0], alone.held_out[0]
    assert not (train.valid & held.valid).any()
    distance = np.abs(train.time[train.valid][:, None] - held.time[held.valid][None]).min()
    assert distance > 0.2


def test_a_coupled_wrist_is_read_in_joint_coordinates(kr90: Robot) -> None:
    """θ3 = q3 + 0.5 q2: positions are turned back, torque of motor 3 also acts on joint 2, power is kept."""
    data = kr90.model_dump(mode="json")
    data["drives"][2]["coupling"] = {"joint2": 0.5}
    rng = np.random.default_rng(0)
    theta, torque, rate = rng.normal(size=(3, 50, 3))
    run = joint_run(parse_robot(data), MotionRun("a", np.arange(50) / RATE, theta, RATE, torque, rate))
    np.testing.assert_allclose(run.position[:, 2], theta[:, 2] - 0.5 * theta[:, 1])
    np.testing.assert_allclose(np.sum(run.torque * run.velocity, axis=1), np.sum(torque * rate, axis=1))


def test_position_is_differentiated_also_at_the_ends(fourier: list[Fourier]) -> None:
    """Half a second from either end of a run in motion the acceleration is right to 1 % of its largest."""
    time = np.arange(5000) / RATE
    motion = fourier[0].motion(time)
    q, v, a = differentiate(np.round(motion.position / 6e-6) * 6e-6, RATE, 10, 12)
    inner = slice(125, -125)
    for ours, true, share in ((q, motion.position, 1e-5), (v, motion.velocity, 5e-4), (a, motion.acceleration, 1e-2)):
        assert np.abs(ours - true)[inner].max() < share * np.abs(true).max()


def test_a_late_channel_is_advanced(fourier: list[Fourier]) -> None:
    """A delay of 3.3 ms, four fifths of a sample, to 0.05 ms."""
    time = np.arange(5000) / RATE
    early, late = (fourier[0].motion(t).velocity[:, 0] for t in (time, time - 0.0033))
    np.testing.assert_allclose(advance(late, RATE, 0.0033)[:-5], early[:-5], atol=1e-5)


def test_dropped_samples_are_bridged_or_refused(saved: Path, log: MotionLog) -> None:
    """Three missing samples are interpolated with a note; half a second is named and refused."""
    for key in ("time", "position", "torque"):
        change(saved, key, lambda x: np.delete(x, [700, 701, 1500], axis=0))
    repaired = read_motion_log(saved)
    assert any("3 dropped samples in 2 gaps" in note for note in repaired.notes)
    run = repaired.runs["run1"]
    assert len(run.time) == len(log.runs["run1"].time)
    np.testing.assert_allclose(run.position, log.runs["run1"].position, atol=1e-6)
    for key in ("time", "position", "torque"):
        change(saved, key, lambda x: np.delete(x, np.arange(1000, 1125), axis=0))
    with pytest.raises(InputError, match=r"runs/run1/time: 125 samples are missing after 4\.0"):
        read_motion_log(saved)


def test_samples_held_by_the_recorder_are_taken_as_missing(saved: Path, log: MotionLog) -> None:
    """A row that repeats the one before in all channels while the robot moves was not measured."""
    for key in ("position", "torque"):

        def hold(x: np.ndarray) -> np.ndarray:
            x[900] = x[899]
            return x

        change(saved, key, hold)
    repaired = read_motion_log(saved)
    assert any("1 samples repeat the one before" in note for note in repaired.notes)
    np.testing.assert_allclose(repaired.runs["run1"].position, log.runs["run1"].position, atol=1e-6)


@pytest.mark.parametrize(
    ("digit", "jitter", "resampled"), [(1e-5, 2.5e-4, True), (1e-3, 0.0, False), (1e-5, 0.0, False)]
)
def test_jitter_is_told_from_stamps_that_are_rounded(digit: float, jitter: float, resampled: bool) -> None:
    """A quarter of a millisecond at 62.5 Hz had a payload of 15 kg found as 12.8, beside a false low-pass."""
    rng, exact = np.random.default_rng(3), np.arange(2000) * 0.0163
    when = exact + jitter * rng.uniform(-1.7, 1.7, len(exact))
    stamps = np.round(when / digit) * digit
    q = np.sin(np.outer(when, [2.0, 3.0]))
    run, notes = motion_log.even_run(Path("log.h5"), "run", "run", stamps, {"position": q}, 1 / 0.0163)
    assert any("resampled" in note for note in notes) is resampled
    if resampled:
        even = np.sin(np.outer(run.time, [2.0, 3.0]))
        assert np.abs(run.position - even)[5:-5].max() < 0.05 * np.abs(q - np.sin(np.outer(exact, [2.0, 3.0]))).max()


def test_jitter_is_resampled_or_refused(saved: Path, log: MotionLog, fourier: list[Fourier]) -> None:
    """Samples taken at jittered, stamped instants come out even to 2e-5 rad; stamps without order are refused."""
    rng = np.random.default_rng(0)
    time = log.runs["run1"].time + rng.uniform(-0.3, 0.3, 5000) / RATE
    change(saved, "time", lambda x: time)
    change(saved, "position", lambda x: fourier[0].motion(time).position)
    repaired = read_motion_log(saved)
    assert any("jitter by 0.7 ms RMS" in note for note in repaired.notes)
    run = repaired.runs["run1"]
    assert np.ptp(np.diff(run.time)) < 1e-9
    assert np.abs(run.position - fourier[0].motion(run.time).position)[10:-10].max() < 2e-5
    change(saved, "time", lambda x: x[::-1])
    with pytest.raises(InputError, match="increasing instants"):
        read_motion_log(saved)


def test_repeated_stamps_are_dropped(saved: Path, log: MotionLog) -> None:
    """Rows written twice are dropped with a note; five samples to a stamp are put on an even clock; rows written five
    times are refused."""
    for key in ("time", "position", "torque"):
        change(saved, key, lambda x: np.insert(x, 300, x[300], axis=0))
    repaired = read_motion_log(saved)
    assert repaired.notes == ("runs/run1: 1 repeated time stamps dropped, the first at 1.200 s",)
    np.testing.assert_array_equal(repaired.runs["run1"].position, log.runs["run1"].position)
    change(saved, "time", lambda x: np.delete(x, 300))
    for key in ("position", "torque"):
        change(saved, key, lambda x: np.delete(x, 300, axis=0))
    change(saved, "time", lambda x: np.floor(x * 50 + 1e-6) / 50)
    repaired = read_motion_log(saved)
    assert "no sample is missing, and they were put on an even clock" in repaired.notes[0]
    np.testing.assert_array_equal(repaired.runs["run1"].position, log.runs["run1"].position)
    assert repaired.runs["run1"].sample_rate_hz == pytest.approx(RATE, rel=1e-4)
    for key in ("position", "torque"):
        change(saved, key, lambda x: np.repeat(x[::5], 5, axis=0)[: len(x)])
    with pytest.raises(InputError, match="time stamps are repeated"):
        read_motion_log(saved)


def test_wrong_units_are_named(kr90: Robot, saved: Path, log: MotionLog) -> None:
    """Degrees read as radians and milliseconds read as seconds are refused with the likely cause."""
    run = log.runs["run1"]
    degrees = MotionLog({"run1": replace(run, position=np.rad2deg(run.position))})
    with pytest.raises(InputError, match="expected rad, these look like degrees"):
        check_against(degrees, kr90)
    check_against(log, kr90)
    change(saved, "time", lambda x: 1000 * x)
    with pytest.raises(InputError, match=r"stamps are 4 s apart, but sample_rate_hz is 250; expected seconds"):
        read_motion_log(saved)


def test_saturated_torque_is_left_out_or_refused(kr90: Robot, log: MotionLog, found: Identification) -> None:
    """Cut off for a moment: the moment and the filter's memory are left out, with a note; for long: refused."""

    def cut(limit: float) -> MotionLog:
        runs = {
            name: replace(run, torque=np.clip(run.torque, -np.inf, [np.inf, limit, np.inf]))
            for name, run in log.runs.items()
        }
        return MotionLog(runs)

    highest = np.concatenate([run.torque[:, 1] for run in log.runs.values()])
    light = identify(cut(float(np.quantile(highest, 0.995))), kr90)
    assert any("torque of joint2 is cut off at" in note for note in light.notes)
    shift = (light.estimate.value - found.estimate.value) / found.estimate.deviation
    assert np.abs(shift).max() < 6
    assert not any(saturated(run).any() for run in log.runs.values())
    with pytest.raises(InputError, match="saturated for"):
        identify(cut(float(np.quantile(highest, 0.7))), kr90)


def test_a_trajectory_or_too_short_a_log_is_refused(kr90: Robot, log: MotionLog) -> None:
    """No torque, or fewer rows than parameters: one line that says so."""
    run = log.runs["run1"]
    with pytest.raises(InputError, match="of a trajectory alone nothing"):
        identify(MotionLog({"run1": replace(run, torque=None)}), kr90)
    short = MotionRun("run1", run.time[:500], run.position[:500], RATE, run.torque[:500])
    with pytest.raises(InputError, match="too few"):
        identify(MotionLog({"run1": short}), kr90)


def test_known_torque_is_not_fitted(kr90: Robot, fourier: list[Fourier]) -> None:
    """A described payload is taken off before the fit, so that the links stay what they are."""
    data = kr90.model_dump(mode="json")
    data["physics"].append({"effect": "payload", "site": "flange", "mass": 40.0, "com": [1.7, 0.0, 0.1]})
    loaded = parse_robot(data)
    result = identify(recorded(loaded, fourier), loaded)
    true = result.estimate.base.combine @ Regressor(kr90, offsets=True).described
    k = result.estimate.base.names.index("link3.mcx")
    assert result.estimate.value[k] == pytest.approx(true[k], rel=1e-3)
    motion = fourier[0].motion(np.arange(10.0))
    assert isinstance(motion, Motion)


def rewritten(key: str, values: object) -> Callable[[h5py.Group], None]:
    def edit(run: h5py.Group) -> None:
        del run[key]
        run[key] = values

    return edit


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (rewritten("position", np.full((20, 3), b"x")), "runs/a/position: expected real numbers, found |S1"),
        (rewritten("torque", np.ones((20, 3)) * 1j), "runs/a/torque: expected real numbers, found complex128"),
        (
            lambda run: run.attrs.update(sample_rate_hz="fast"),
            "runs/a: sample_rate_hz: expected a number, found 'fast'",
        ),
        (lambda run: run.file.attrs.update(version="one"), "version: expected a number, found 'one'"),
        (lambda run: run["position"].attrs.update(unit="deg"), "runs/a/position: unit: expected rad or m, found 'deg'"),
        (rewritten("position", np.zeros((20, 0))), "runs/a/position: expected at least one axis, found shape (20, 0)"),
        (lambda run: run.file.create_dataset("runs/b", data=0.0), "runs/b: expected a group, found a dataset"),
    ],
)
def test_files_made_by_hand_are_read_or_refused_in_one_line(
    tmp_path: Path, edit: Callable[[h5py.Group], None], says: str
) -> None:
    """Text or complex data, wrong attributes, units: one line with file and field; nine samples are read."""
    path = tmp_path / "log.h5"
    short = MotionRun("a", np.arange(20) / RATE, np.linspace([0, 0, 0], [1, 1, 1], 20), RATE, np.ones((20, 3)))
    for count in (2, 9, 20):
        series = {key: getattr(short, key)[:count] for key in ("time", "position", "torque")}
        write_motion_log(path, MotionLog({"a": replace(short, **series)}))
        assert read_motion_log(path).runs["a"].position.shape == (count, 3)
    with h5py.File(path, "r+") as file:
        edit(file["runs/a"])
    with pytest.raises(InputError) as raised:
        read_motion_log(path)
    assert str(raised.value) == f"{path}: {says}"


def test_a_csv_may_carry_a_byte_order_mark_but_must_be_text(tmp_path: Path) -> None:
    """As spreadsheets write it; what is no UTF-8 text, or no table of numbers, is refused in one line."""
    path = tmp_path / "log.csv"
    rows = "".join(f"{k / RATE},{0.01 * k},1.5\n" for k in range(20))
    path.write_bytes(b"\xef\xbb\xbf" + f"time,q1,tau1\n{rows}".encode())
    assert read_motion_log(path).runs["log"].torque.shape == (20, 1)
    for content in (
        b"time,q1,tau\xb9\n0,1,2\n",
        b"",
        b"time,q1,tau1\n",
        b"time;q1;tau1\n0;1;2\n",
        b"time,q1,tau1\n0,1\n",
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match="expected"):
            read_motion_log(path)


def test_a_run_without_a_usable_row_is_left_out(kr90: Robot, log: MotionLog) -> None:
    """Half a second is less than the low-pass needs at its ends: a note, not a failure of the whole log."""
    run = log.runs["run1"]
    brief = replace(run, **{key: getattr(run, key)[:125] for key in ("time", "position", "torque")})
    result = identify(MotionLog({**log.runs, "brief": replace(brief, name="brief")}), kr90)
    assert any("runs/brief: 0.5 s are too short" in note for note in result.notes)
    with pytest.raises(InputError, match=r"log\.h5: runs: 0\.5 s are too short"):
        identify(MotionLog({"brief": brief}, source="log.h5"), kr90)


@pytest.mark.parametrize(("seconds", "wider"), [(4.0, True), (12.0, False)])
def test_a_short_log_is_identified_through_the_low_pass_that_predicts_best(
    seconds: float, wider: bool, kr90: Robot, fourier: list[Fourier]
) -> None:
    """Four runs of 4 s below 4 Hz have 160 rows of a joint; four of 12 s are not short."""
    log = recorded(kr90, fourier, noise=5.0, seconds=seconds)
    found = identify(log, kr90)
    assert (found.bands != Bands()) is wider
    assert any("are short: the low-pass" in note for note in found.notes) is wider
    usual = identify(log, kr90, bands=Bands())
    assert not any("are short" in note for note in usual.notes)
    judged = [
        rows_of(found.regressor, joint_run(kr90, log.runs[rows.name]), Bands(fit=LOW_PASSES[0]))
        for rows in found.split.held_out
    ]
    error, plain = (np.mean(relative_error(judged, one.parameters)[0] ** 2) for one in (found, usual))
    assert error < plain if wider else error == plain


def test_a_coupled_drives_friction_survives_the_file(tmp_path: Path, fourier: list[Fourier]) -> None:
    """What a coupling takes over is left out of the YAML or null in it: the columns are the same."""
    data = load_robot("kr90").model_dump(mode="json")
    data["drives"][2]["coupling"] = {"joint2": 0.5}
    data["physics"].append({"effect": "joint_coupling", "site": "joint2", "from": "joint3", "ratio": 0.5})
    robot = parse_robot(data)
    save_robot(tmp_path / "robot.yaml", robot)
    motion = fourier[0].motion(np.linspace(0, 10, 30))
    written, given = (Regressor(r).evaluate(motion) for r in (load_robot(tmp_path / "robot.yaml"), robot))
    np.testing.assert_array_equal(written, given)


def test_a_rigid_linear_axis_is_replayed() -> None:
    """95 kg on 1 g of rotor: servos tuned to all that moves follow 2 Hz, and draw the force of the record to 1 %."""
    axis = {"type": "prismatic", "alpha_deg": 90, "limits": {"position": [-0.1, 0.4], "velocity": 1}}
    data = {
        "name": "carriage", "axes": [axis], "drives": [{"gear_ratio": 1, "rotor_inertia": 1e-3}],
        "links": [{"mass": 95, "com": [0, 0, 0], "inertia": [1, 1, 1, 0, 0, 0]}],
        "physics": [{"effect": "viscous_friction", "site": "joint1", "coefficient": 200}],
    }  # fmt: skip
    carriage = parse_robot(data)
    time, w = np.arange(1500) / 250, 4 * np.pi
    q = 0.15 + 0.05 * np.stack([np.sin(w * time)], axis=1)
    force = 95.001 * -(w**2) * (q - 0.15) + 200 * 0.05 * w * np.stack([np.cos(w * time)], axis=1)
    found = compare_log(MotionLog({"a": MotionRun("a", time, q, RATE, force)}), carriage, stepped=True)
    assert found.parts[0]["error"] < 5e-3
    assert found.parts[0]["stepped_error"] < 0.01


def test_what_coupled_drives_recorded_in_the_simulation_is_their_own(kr90: Robot) -> None:
    """A log holds motors: compared and followed again, what joint3's drive does to joint2 is no error."""
    data = kr90.model_dump(mode="json")
    data["drives"][2]["coupling"] = {"joint2": 0.5}
    robot, time = parse_robot(data), np.arange(750) / RATE
    q = np.array([0.0, 1.3, -1.5]) + 0.3 * np.sin(3.0 * time[:, None] + np.arange(3))
    path = MotionLog({"a": MotionRun("a", time, q, RATE)})
    log = simulate(np.rad2deg(q[0]), robot=robot, hammer=False, trajectory=path).log
    assert np.abs(log.runs["a"].position - q)[:, 2].max() > 0.1
    found = compare_log(log, robot, as_is=True, stepped=True)
    assert max(part["error"] for part in found.parts) < 0.01
    assert max(part["stepped_error"] for part in found.parts) < 0.02
    again = simulate(np.rad2deg(q[0]), robot=robot, hammer=False, trajectory=log).log
    np.testing.assert_allclose(again.runs["a"].position, log.runs["a"].position, atol=2e-3)


def test_the_nearest_robot_that_can_exist(kr90: Robot) -> None:
    """A link of negative mass becomes a body; towards no robot that can exist does the distance fall any further."""
    regressor, rng = Regressor(kr90), np.random.default_rng(3)
    size = len(regressor.described)
    step = np.diag(np.maximum(np.abs(regressor.described), 0.1))
    root = rng.normal(size=(size, size))
    H, x = root @ root.T / size, regressor.described.copy()
    rotor = next(k for k, column in enumerate(regressor.columns) if column.group == "rotor")
    x[10], x[rotor] = -50.0, -x[rotor]
    d = nearest_possible(regressor, H, np.zeros(size), x, step)
    found = x + step @ d
    assert found[rotor] > 0.9e-3 * regressor.described[rotor]
    for i in range(kr90.axis_count):
        assert np.linalg.eigvalsh(pseudo_inertia(found[10 * i : 10 * i + 10]))[0] > 0
    for share in (0.5, 1.0, 2.0):
        other = np.linalg.solve(step, share * regressor.described - x)
        assert d @ H @ (other - d) > -1e-5 * float(d @ H @ d)


def test_a_description_without_friction_is_told(kr90: Robot) -> None:
    log = read_motion_log(EXAMPLES / "cell" / "log.h5")
    bare = kr90.without(["coulomb_friction", "viscous_friction", "presliding", "hysteresis"])
    (note,) = (note for note in identify(log, bare).notes if "has no friction" in note)
    assert note.startswith("joint1, joint2, joint3:")
    assert not any("has no friction" in note for note in identify(log, kr90).notes)


def test_a_long_log_is_read_in_parts(saved: Path, log: MotionLog, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sample in four, without the noise beyond; below that nothing is changed."""
    whole = log.runs["run1"]
    for limit, count in (("LONG", 1000), ("COARSE_HZ", RATE / 4)):
        monkeypatch.setattr(motion_log, limit, count)
    found = read_motion_log(saved)
    run = found.runs["run1"]
    assert "as one in 4" in found.notes[0]
    assert run.sample_rate_hz == pytest.approx(RATE / 4)
    np.testing.assert_allclose(run.time, whole.time[::4])
    np.testing.assert_allclose(run.position, whole.position[::4], atol=1e-4 * np.ptp(whole.position))
    few = motion_log._in_parts  # blocks of any length give the same
    monkeypatch.setattr(motion_log, "_in_parts", lambda *given: few(*given, block=37))
    np.testing.assert_allclose(read_motion_log(saved).runs["run1"].torque, run.torque, rtol=1e-12, atol=1e-9)


def test_rows_of_parts_are_those_of_the_whole(kr90: Robot, log: MotionLog) -> None:
    run, regressor = log.runs["run1"], Regressor(kr90)
    whole = rows_of(regressor, run, Bands())
    parts = rows_of(regressor, run, Bands(), part=1700)
    np.testing.assert_allclose(parts.time, whole.time)
    for key in ("position", "torque", "matrix"):
        one, other = (getattr(rows, key)[whole.valid] for rows in (whole, parts))
        assert np.abs(one - other).max() < 2e-3 * np.abs(one).max()
    np.testing.assert_array_equal(parts.valid, whole.valid)


def test_torque_of_the_motors_is_asked_about(kr90: Robot, log: MotionLog) -> None:
    runs = {name: replace(run, torque=run.torque / 100) for name, run in log.runs.items() if run.torque is not None}
    (note,) = [n for n in identify(replace(log, runs=runs), kr90).notes if "is it the torque at the motor" in n]
    assert "needs 100 times" in note
    assert not [n for n in identify(log, kr90).notes if "unit" in n]


def test_an_assumed_rotor_is_as_uncertain_as_the_law_it_is_from(kr90: Robot, fourier: list[Fourier]) -> None:
    """The robot that is written has the rotor that the log shows, not the assumption."""
    log = recorded(kr90, fourier, 1000.0)
    rotor = kr90.drives[2].rotor_inertia
    drives = [*kr90.drives[:2], kr90.drives[2].model_copy(update={"rotor_inertia": 4 * rotor})]
    wrong = kr90.model_copy(update={"drives": drives})
    item = Assumed(field="drives[2].rotor_inertia", value=4 * rotor, tolerance=4.0, source="assumed: a law")
    assumed = wrong.model_copy(update={"assumed": [item]})
    off = [abs(identify(log, robot).robot.drives[2].rotor_inertia / rotor - 1) for robot in (wrong, assumed)]
    assert off[1] < 0.5 * off[0], off


def test_axes_that_need_no_torque_tell_no_unit() -> None:
    """Two of three axes stand still, and the sensor has noise there."""
    recorded, described = np.tile([50.0, 0.1, 0.1], (20, 1)), np.tile([50.0, 0.0, 0.0], (20, 1))
    assert unit_note(described, recorded) is None
    assert unit_note(0 * described, recorded) is None
    assert "is 20 times what the robot" in str(unit_note(described, 20 * recorded))


def test_axes_that_stand_still_bring_no_parameters_of_their_own(kr90: Robot) -> None:
    """Noise of their encoders passed for motion: a rotor of 2.5e6 kg·m², ± 4e6, and a link of 2.7e5 kg·m²."""
    time, rng = np.arange(0, 12, 1 / 250), np.random.default_rng(2)
    turn = 2 * np.pi * 0.4
    q, still = 1.2 + 0.4 * np.sin(turn * time), np.zeros_like(time)
    position = np.column_stack([still + 0.3, q, still - 1.4])
    velocity = np.column_stack([still, 0.4 * turn * np.cos(turn * time), still])
    acceleration = np.column_stack([still, -0.4 * turn**2 * np.sin(turn * time), still])
    torque = inverse_dynamics(kr90, Motion(time, position, velocity, acceleration))
    noisy = position + 1e-5 * rng.normal(size=position.shape)
    log = MotionLog({"one": MotionRun("one", time, noisy, 250.0, torque + rng.normal(size=torque.shape))})
    found = identify(log, kr90)
    (told,) = (note for note in found.notes if "still throughout" in note)
    assert told.startswith("joint1, joint3 stand still")
    base = found.estimate.base
    names = [base.columns[k].name for k in base.kept]
    assert not any(name.startswith(("drive1.", "drive3.", "viscous_friction@joint1")) for name in names)
    assert np.abs(found.estimate.value).max() < 1e4


def test_a_log_that_no_parameters_predict_is_told(kr90: Robot, log: MotionLog, found: Identification) -> None:
    assert not any("Do not rely on them" in note for note in found.notes)
    rng, runs = np.random.default_rng(0), {}
    for name, run in log.runs.items():
        slow = lowpass(rng.normal(size=run.torque.shape), run.sample_rate_hz, 1.0, 1.5)
        slow *= 0.6 * run.torque.std(axis=0) / slow.std(axis=0)
        runs[name] = replace(run, torque=run.torque + slow * [0, 1, 0])
    (told,) = (n for n in identify(replace(log, runs=runs), kr90).notes if "Do not rely on them" in n)
    assert "missed by joint2 " in told


def test_dry_friction_keeps_its_sign_at_rest() -> None:
    """A stop rings, as the low-pass does, and the axis moves on the same way."""
    time = np.arange(0, 3, 0.01)[:, None]
    rest = (time > 1) & (time < 2)
    speed = np.where(rest, 1e-3 * np.sin(60 * time), -1.0)
    motion = Motion(time[:, 0], np.cumsum(speed, axis=0) / 100, speed, np.zeros_like(speed))
    held = holding(motion, rest)
    assert not held.velocity[rest].any()
    assert np.all(held.sign(held.velocity) == -1)


@pytest.mark.parametrize(("jitter", "told"), [(0.0, False), (1e-4, True)])
def test_rounded_stamps_that_count_from_1970_are_no_jitter(jitter: float, told: bool) -> None:
    """A number that large is exact to 0.24 µs only: a tenth of a millisecond is no round number in it."""
    k = np.arange(3000)
    stamps = 1.7e9 + np.round((0.00163 * k + jitter * np.sin(1.7 * k)) / 1e-4) * 1e-4
    assert motion_log._jitters(stamps, 0.00163) is told
