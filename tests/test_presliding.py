"""How dry friction turns round in the base model of a motion log: bristles on positions as they are recorded."""

import numpy as np
import pytest

from twin.measure.motion_log import MotionRun
from twin.measure.signals import scatter
from twin.model.regressor import Regressor
from twin.model.torque_base import PRESLIDING, base_of, with_whole_friction
from twin.model.torque_laws import _bristles, entry_torque, reversals
from twin.model.torque_rows import Bands
from twin.model.torque_signal import Run, run_of
from twin.physics import CATALOGUE
from twin.robot.description import Entry, Robot, parse_robot

BANDS = Bands((8.0, 10.0), (12.0, 15.0))
TRAVELS = np.geomspace(3e-5, 5e-3, 5)
STOP_S, BACK_S = 2.0, 4.0


def stopping(robot: Robot, rate: float = 250.0, noise: float = 0.0, seed: int = 0) -> Run:
    """All axes move 0.5 rad, stop at once, stand still for two seconds and move back."""
    time = np.arange(0, 6, 1 / rate)
    path = 0.25 * (np.clip(time, 0, STOP_S) - np.clip(time - BACK_S, 0, STOP_S))
    position = path[:, None] * [1.0, -0.8, 0.5] + noise * np.random.default_rng(seed).normal(size=(len(time), 3))
    run = MotionRun("stop", time, position, rate, np.random.default_rng(1).normal(size=(len(time), 3)))
    return run_of(Regressor(robot), run, BANDS)


@pytest.mark.parametrize("noise", [0.0, 3e-6, 2e-5])
def test_friction_keeps_what_it_holds_through_a_standstill(kr90: Robot, noise: float) -> None:
    """The low-pass rings there by more than the shortest travels, and an encoder's noise never rests."""
    run = stopping(kr90, noise=noise)
    still = (run.dense.time > STOP_S) & (run.dense.time < BACK_S)
    assert np.ptp(run.dense.position[still, 0]) > TRAVELS[2]
    held = _bristles(run, {0: 1.0}, TRAVELS, np.eye(5))[0][still]
    np.testing.assert_allclose(held, 1.0, atol=1e-3)


@pytest.mark.parametrize("noise", [1e-6, 1e-5])
def test_an_axis_that_starts_slowly_has_turned_by_all_of_its_way(kr90: Robot, noise: float) -> None:
    """What it moves before it is told from noise turns its friction round, too: 1e-5 rad of noise hide 8e-5 rad."""
    rate, rng = 125.0, np.random.default_rng(3)
    time = np.arange(0, 6, 1 / rate)
    s = np.clip((time - 2.0) / 3.0, 0, 1)
    path = 0.4 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    position = path[:, None] * [1.0, -0.8, 0.5] + noise * rng.normal(size=(len(time), 3))
    run = run_of(Regressor(kr90), MotionRun("start", time, position, rate, rng.normal(size=(len(time), 3))), BANDS)
    middle = np.abs(run.dense.time - 3.5) < 0.2  # symmetric about half of the way
    assert run.turned[middle, 0].mean() - run.turned[run.dense.time < 1.5, 0].mean() == pytest.approx(0.2, abs=noise)


def test_what_is_recorded_before_the_first_motion_does_not_count(kr90: Robot) -> None:
    """Dry friction may then hold anything up to its size, in either direction."""
    time = np.arange(0, 8, 1 / 250)
    s = np.clip((time - 3.0) / 4.0, 0, 1)
    path = 0.4 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    noise = np.random.default_rng(4).normal(size=(2, len(time), 3))
    still, moving = path[:, None] * [1.0, -0.8, 0.5] + 3e-6 * noise[0], np.cumsum(np.full((len(time), 3), 1e-3), axis=0)
    begins = []
    for position in (still, moving):
        run = run_of(Regressor(kr90), MotionRun("run", time, position, 250.0, noise[1]), BANDS)
        begins.append(float(run.time[run.valid][0]))
    assert 3.0 < begins[0] < 3.8
    assert begins[1] < 0.5


def test_a_drive_that_turns_with_two_axes_turns_round_where_they_do_together(kr90: Robot) -> None:
    run = stopping(kr90, noise=3e-6)
    together, _ = _bristles(run, {2: 1.0, 1: 0.5}, TRAVELS, np.eye(5))
    moving = (run.dense.time > BACK_S + 1.0) & (run.dense.time < 5.9)
    np.testing.assert_allclose(
        together[moving, :4], -1.0, atol=1e-3
    )  # 0.5 q̇ of one and 0.4 of the other: still its own way
    other, _ = _bristles(run, {2: 1.0, 1: 1.0}, TRAVELS, np.eye(5))
    np.testing.assert_allclose(other[moving, :4], 1.0, atol=1e-3)


def test_friction_that_a_coupling_shares_is_felt_at_both_axes(kr90: Robot) -> None:
    """As described: columns of a log's base model, per N·m of the drive's dry friction."""
    data = kr90.model_dump(mode="json")
    data["physics"].append({"effect": "joint_coupling", "site": "joint2", "from": "joint3", "ratio": 0.5})
    run = stopping(kr90)
    assert run.valid.any()
    alone, coupled = base_of(Regressor(kr90), [run]), base_of(Regressor(parse_robot(data)), [run])
    dry = coupled.sliding[2]
    both = run.filtered(_shape(coupled.travels[2], run, {2: 1.0, 1: 0.5}))
    np.testing.assert_allclose(coupled.presliding[0][:, 2], dry * both, atol=1e-9 * dry)
    np.testing.assert_allclose(
        coupled.presliding[0][:, 1], alone.presliding[0][:, 1] + 0.5 * dry * both, atol=1e-9 * dry
    )


def _shape(travels: np.ndarray, run: Run, turns: dict[int, float]) -> np.ndarray:
    out, sign = _bristles(run, turns, travels, np.eye(len(travels)))
    return out - sign[:, None]


def test_the_scatter_of_an_encoder_is_told_from_motion() -> None:
    time = np.linspace(0, 10, 4001)
    noisy = np.sin(time) + 1e-4 * np.random.default_rng(1).normal(size=len(time))
    assert scatter(noisy[:, None])[0] == pytest.approx(1e-4, rel=0.1)
    way, found = reversals(np.sin(time))
    assert way == 1
    np.testing.assert_allclose(time[found], np.pi * np.array([0.5, 1.5, 2.5]), atol=0.005)
    assert reversals(np.zeros(9)) == (1, [])


def test_noise_is_told_from_motion_that_is_sampled_slowly() -> None:
    """At 50 Hz third differences of 2 Hz are a hundred times such noise."""
    time = np.arange(0, 20, 0.02)
    noise = 1e-5 * np.random.default_rng(2).normal(size=(len(time), 1))
    assert scatter(np.sin(4 * np.pi * time)[:, None] + noise)[0] < 5e-5


def test_friction_that_fades_turns_round_at_the_speed_it_has_then(kr90: Robot) -> None:
    """Stribeck's excess beside bristles: less of it is left when they have turned round. Bristles of the truth code."""
    from tools.truth.motion import _bristles as bristles

    time = np.arange(0, 12, 1 / 250.0)
    position = 0.3 * np.sin(2.0 * time)[:, None] * [1.0, 0.8, 0.6]
    torque = np.random.default_rng(1).normal(size=position.shape)
    run = run_of(Regressor(kr90), MotionRun("turns", time, position, 250.0, torque), BANDS)
    base = base_of(Regressor(kr90), [run])
    z, travel = np.zeros(len(base.parameters)), base.travels[0, 3]
    z[base.spread.shape[1] + 3] = 1 / PRESLIDING  # all of dry friction turns round over this travel
    values = {"static_excess": 40.0, "velocity": 0.03}
    entry = Entry.model_validate({"effect": "stribeck_friction", "site": "joint1", **values})
    found = entry_torque(run, base.state(0, z), entry, values)
    fine = np.arange(0, 12, 1e-4)
    turned = np.interp(run.dense.time, fine, bristles(0.3 * np.sin(2.0 * fine), travel))
    excess = 40.0 * np.exp(-((0.6 * np.cos(2.0 * run.dense.time) / 0.03) ** 2))
    sign = run.dense.sign(run.dense.velocity[:, 0])
    part = CATALOGUE["stribeck_friction"].part_of_dry(values, run.motion.velocity[:, 0])
    expected = run.filtered(excess * turned - part * (turned - sign))
    rms = np.sqrt(np.mean(expected[run.valid] ** 2))
    assert np.sqrt(np.mean((found[run.valid, 0] - expected[run.valid]) ** 2)) < 0.03 * rms
    at_once = run.filtered(excess * sign)  # what it were without bristles
    assert np.sqrt(np.mean((at_once[run.valid] - expected[run.valid]) ** 2)) > 0.3 * rms


def test_presliding_of_an_earlier_fit_is_dry_friction_again(kr90: Robot) -> None:
    """As elements it could not change: on the robot that a diagnosis had written, its own log had false names."""
    slip = {"effect": "presliding", "site": "joint1", "stiffness": [4e6, 2e6], "yield_torque": [20.0, 40.0]}
    alone = {**slip, "site": "joint2"}
    dry = {"effect": "coulomb_friction", "site": "joint1", "torque": 5.0}
    physics = [Entry.model_validate(one) for one in (dry, slip, alone)]
    whole = with_whole_friction(kr90.model_copy(update={"physics": physics}))
    assert {(e.effect, e.site): e.values["torque"] for e in whole.physics} == {
        ("coulomb_friction", "joint1"): 65.0, ("coulomb_friction", "joint2"): 60.0,
    }  # fmt: skip
    assert with_whole_friction(whole) is whole
