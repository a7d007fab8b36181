"""Milling stability against published radii, an independent time simulation, closed forms, and what bad input says."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import twin
from tools.study_milling import (
    AMPLITUDE_Q,
    AMPLITUDE_RPM,
    NONLINEAR,
    RADII,
    amplitude_cut,
    benchmark_cut,
    benchmark_modes,
    kr90_point,
    linear_limit,
    nonlinear_robot,
    simulated_limits,
    thirteen_modes,
)
from twin.errors import InputError
from twin.measure.campaign import Campaign, Channels, PostureFRF
from twin.milling import forces
from twin.milling.cut import Cut, published_coefficients, read_cut
from twin.milling.forced import forced_vibration, static_force
from twin.milling.in_time import CutStepper
from twin.milling.lobes import first_at, limits_at, lobes_of
from twin.milling.stability import Limits, first_limits, limits, multipliers, without_idle
from twin.milling.tool_point import (
    ToolModes,
    coupled,
    measured_point,
    real_modes,
    tool_point,
)
from twin.milling.zeroth_order import limiting_depth, low_frequency_depth
from twin.model.frf import frf
from twin.model.linear import linearise
from twin.model.modes import residues
from twin.robot.description import load_robot
from twin.robot.mechanism import assemble

Q = np.deg2rad([0, 70, -100])


@pytest.mark.parametrize(("depth_mm", "radius"), RADII.items())
def test_spectral_radii_of_the_published_slot(depth_mm: float, radius: float) -> None:
    found = abs(multipliers(benchmark_modes(), benchmark_cut(1.0, "up"), 5000, 1e-3 * depth_mm)[0])
    assert found == pytest.approx(radius, abs=1e-7)


@pytest.mark.parametrize(("immersion", "milling"), [(0.1, "up"), (0.1, "down"), (1.0, "up")])
def test_first_limits_are_those_of_an_independent_time_simulation(immersion: float, milling: str) -> None:
    cut = benchmark_cut(immersion, milling)
    speeds = np.array([7000.0, 12500.0])
    first = limits(benchmark_modes(), cut, speeds, 0.05).first()
    simulated, below = simulated_limits(benchmark_modes(), cut, speeds, first, 240, 0.25)
    assert np.allclose(first, simulated, rtol=0.01)
    assert (below < 0).all()


def test_thirteen_modes_with_cross_terms_against_the_time_simulation() -> None:
    cut, speeds = benchmark_cut(0.5, "down"), np.array([3000.0, 9000.0])
    first = limits(thirteen_modes(), cut, speeds, 0.1).first()
    simulated, below = simulated_limits(thirteen_modes(), cut, speeds, first, 60, 2.0)
    assert np.allclose(first, simulated, rtol=0.02)
    assert (below < 0).all()
    direct = limits(thirteen_modes().without_cross_terms(), cut, speeds, 5.0).first()
    assert np.abs(direct / first - 1).max() > 0.5  # cross terms matter here


def unstable_by_multipliers(modes: ToolModes, cut: Cut, rpm: float, depths: np.ndarray) -> list[int]:
    return [int((np.abs(multipliers(modes, cut, rpm, depth, 10)) > 1).sum()) for depth in depths]


@pytest.mark.parametrize(("immersion", "milling", "teeth"), [(1.0, "up", 2), (0.05, "up", 2), (0.7, "down", 3)])
def test_no_limit_is_lost_whatever_lies_below_it(immersion: float, milling: str, teeth: int) -> None:
    cut, modes = benchmark_cut(immersion, milling, teeth), benchmark_modes()
    speeds, depths = np.linspace(5000, 25000, 12), np.geomspace(1e-4, 5.9e-3, 12)
    found: Limits = limits(modes, cut, speeds, 0.006)
    counted = [unstable_by_multipliers(modes, cut, rpm, depths) for rpm in speeds]
    assert (found.unstable(depths) == counted).all()
    if immersion == 0.05:
        assert "flip" in found.kind


@pytest.mark.parametrize(("immersion", "milling", "helix"), [(0.05, "up", 0), (0.7, "down", 0), (0.1, "down", 40)])
def test_the_first_limit_alone_is_the_first_of_all(immersion: float, milling: str, helix: float) -> None:
    cut, speeds = benchmark_cut(immersion, milling, 3), np.linspace(5000, 25000, 6 if helix else 40)
    cut = cut.model_copy(update={"tool": cut.tool.model_copy(update={"helix_deg": helix}), "depth_max_m": 0.006})
    for modes in (benchmark_modes(), thirteen_modes()):
        every = limits_at(modes, cut, speeds).first()
        assert np.allclose(first_at(modes, cut, speeds), every, rtol=1e-4)
        shallow = np.min(every, initial=0.006) * 0.5
        assert np.isinf(first_limits(modes, cut, speeds, shallow)).all()  # none is made up


def with_a_stiff_mode(rad_s: float = 2e4) -> ToolModes:
    """The benchmark's modes and a fast, well damped one of a hundredth of their compliance, as light arms have."""
    slow = benchmark_modes()
    pole = rad_s * (-0.7 + 1j * np.sqrt(1 - 0.7**2))
    fast = 0.1 * np.abs(slow.shape).max(axis=0) * np.sqrt(rad_s / np.abs(slow.pole).min()) * np.exp(0.25j * np.pi)
    return ToolModes(np.append(slow.pole, pole), np.vstack([slow.shape, fast]))


def test_a_fast_mode_of_a_light_arm_costs_no_nodes_and_moves_no_limit() -> None:
    """At slow speeds it would swing more than a hundred times from tooth to tooth. Against multipliers of all modes."""
    modes, speeds = with_a_stiff_mode(), np.array([1100.0, 1900.0, 3100.0])
    cut = benchmark_cut(0.5, "down")
    first = limits(modes, cut, speeds, 0.02).first()
    assert np.isfinite(first).all()
    for rpm, depth in zip(speeds, first, strict=True):
        below, above = (np.abs(multipliers(modes, cut, rpm, share * depth, 6)[0]) for share in (0.99, 1.01))
        assert below < 1 < above
    cut = cut.model_copy(update={"immersion": 0.05})  # islands: what is stable above a limit is followed to its end
    every = limits(modes, cut, speeds, 0.02)
    assert (every.unstable(np.array([0.0199])) > 0).all()
    slow = without_idle(modes, cut, cut.coefficients.shear, float(first.max()))
    assert len(slow.pole) == len(benchmark_modes().pole)
    assert slow.residual is not None


def test_coefficients_of_titanium_and_steel_are_those_of_their_sources() -> None:
    table = published_coefficients()
    ratio = 1.755 * 0.05**0.331  # of chip thicknesses, at a rake of 0°
    shear, friction = np.arctan(ratio), np.deg2rad(19.1)
    force = 613e6 / (np.sin(shear) * np.cos(shear + friction))
    titanium, steel = table["titanium_ti6al4v"], table["steel_s235"]
    assert titanium.kt_n_per_m2 == pytest.approx(force * np.cos(friction), rel=2e-3)
    assert titanium.kr_n_per_m2 == pytest.approx(force * np.sin(friction), rel=2e-3)
    law = 1780e6 * 0.1**-0.17
    assert steel.kt_n_per_m2 == pytest.approx(0.83 * law, rel=2e-3)
    assert steel.kte_n_per_m == pytest.approx(0.17 * law * 1e-4, rel=2e-3)


def test_lobes_hold_between_their_speeds_islands_too() -> None:
    cut = benchmark_cut(0.05, "up").model_copy(update={"depth_max_m": 0.01, "spindle_rpm": (9000.0, 15000.0)})
    found = lobes_of(benchmark_modes(), cut)
    dense = np.linspace(9000, 15000, 501)
    exact = np.minimum(limits(benchmark_modes(), cut, dense, 0.01).first(), 0.01)
    off = np.abs(np.interp(dense, found.spindle_rpm, found.depth_m) / exact - 1)
    assert np.quantile(off, 0.99) < 2e-3
    assert not found.unresolved


def test_a_limit_with_helix_is_where_a_multiplier_has_the_size_of_one() -> None:
    cut = benchmark_cut(0.3, "up")
    cut = cut.model_copy(update={"tool": cut.tool.model_copy(update={"helix_deg": 40.0})})
    at = lobes_of(benchmark_modes(), cut, speeds=np.array([9000.0, 12000.0]))
    for rpm, depth in zip(at.spindle_rpm, at.depth_m, strict=True):
        assert abs(multipliers(benchmark_modes(), cut, rpm, depth)[0]) == pytest.approx(1, abs=2e-3)


def test_helix_spreads_the_force_and_keeps_its_mean() -> None:
    cut = benchmark_cut(0.6, "down", 3)
    cut = cut.model_copy(update={"tool": cut.tool.model_copy(update={"helix_deg": 30.0})})
    phase = (np.arange(4000) + 0.5) / 4000
    mean = np.einsum("nfkc,k->fc", forces.periodic(cut, phase, 0.004), cut.coefficients.shear) / len(phase)
    assert np.allclose(mean, forces.average(cut)[:, :2], rtol=1e-3, atol=1e4)


def test_closed_forms_are_reached_in_their_limits() -> None:
    modes, cut = kr90_point()
    fast = cut.model_copy(update={"depth_max_m": 1.0})
    exact = limits(modes, fast, np.array([12000.0, 400e3]), 1.0).first()
    assert limiting_depth(modes, cut, spindle_rpm=12000.0) == pytest.approx(exact[0], rel=2e-3)
    assert low_frequency_depth(modes, cut, 400e3) == pytest.approx(exact[1], rel=0.01)
    # one degree of freedom: −1/(2 K min Re G)
    one, slot = benchmark_modes(), benchmark_cut(1.0, "up", 8)
    G = one.receptance(2 * np.pi * np.linspace(900, 960, 60001))[:, 0, 0]
    assert limiting_depth(one, slot) == pytest.approx(1 / (2 * (G.real * forces.average(slot)[0, 0]).max()), rel=5e-3)


def test_a_clamped_tool_is_coupled_as_receptances_are() -> None:
    rng = np.random.default_rng(0)
    M = np.diag([300.0, 200.0, 150.0])
    K, C, J = M * 5e3, M * 2.0, rng.standard_normal((3, 3))
    w, zeta, shape = np.array([400.0]), np.array([0.02]), np.array([[0.6, 0.8, 0.0]]) / np.sqrt(2.0)  # 2 kg
    modes = ToolModes(*residues(*coupled(M, C, K, J, w, zeta, shape)))
    at = np.array([60.0, 390.0, 420.0])
    s, mass = 1j * at, 1 / np.sum(shape**2)
    unit = shape[0] * np.sqrt(mass)
    for k, value in enumerate(s):
        # the robot with the rigid part of the tool, in series with the mode's spring, beside the mode's free mass
        rest = M - mass * np.outer(unit @ J, unit @ J)
        robot = unit @ J @ np.linalg.solve(value**2 * rest + value * C + K, J.T @ unit)
        base = robot + 1 / (mass * (w[0] ** 2 + 2 * zeta[0] * w[0] * value))
        free = 1 / (mass * value**2)
        assert unit @ modes.receptance(at)[k] @ unit == pytest.approx(free * base / (free + base), rel=1e-9)


def rubbing(cut: Cut, n_per_m: float, friction: float = 0.0) -> Cut:
    """The cut with process damping."""
    more = {"process_damping_n_per_m": n_per_m, "process_friction": friction}
    return cut.model_copy(update={"coefficients": cut.coefficients.model_copy(update=more)})


@pytest.mark.parametrize("rpm", [400.0, 1000.0, 3000.0])
def test_process_damping_is_that_of_the_closed_form(rpm: float) -> None:
    """In a slot four teeth push evenly: m ẍ + (c + b C/v) ẋ + k x = −b kr (x − x(t − τ)), one equation at the limit."""
    mass, w, zeta, C = 2.0, 2 * np.pi * 200, 0.02, 5e4
    cut = rubbing(benchmark_cut(1.0, "up", 4), C, 0.3)
    c, k, kr = 2 * zeta * w * mass, w**2 * mass, cut.coefficients.kr_n_per_m2
    tau, speed = float(cut.tooth_period(rpm)), np.pi * cut.tool.diameter_m * rpm / 60

    def depth(omega: np.ndarray) -> np.ndarray:
        return -omega * c / (kr * np.sin(omega * tau) + omega * C / speed)

    def rest(omega: np.ndarray) -> np.ndarray:
        return k - mass * omega**2 + kr * depth(omega) * (1 - np.cos(omega * tau))

    grid = np.linspace(0.9 * w, 3 * w, 200_000)
    b, f = depth(grid), rest(grid)
    at = np.flatnonzero((f[1:] * f[:-1] < 0) & (b[1:] > 0) & (b[:-1] > 0) & (np.abs(b[1:] / b[:-1] - 1) < 0.1))
    expected = min(
        (float(depth(np.array(brentq(lambda x: float(rest(np.array(x))), grid[i], grid[i + 1])))) for i in at),
        default=np.inf,  # so slow that it damps more than regeneration can feed
    )
    modes = real_modes([200.0], [2.0], [[mass**-0.5, 0.0, 0.0]])
    found = limits(modes, cut, np.array([rpm]), 0.05).first()[0]
    assert found == pytest.approx(expected, rel=1e-4)
    sharp = limits(modes, benchmark_cut(1.0, "up", 4), np.array([rpm]), 0.05).first()[0]
    assert found > 1.05 * sharp


def test_process_damping_of_a_robot_with_a_helix_counts_multipliers_as_limits_do() -> None:
    modes, cut = kr90_point()
    cut = rubbing(cut, 1e6, 0.3)
    speeds, depths = np.array([1200.0, 4000.0]), np.geomspace(2e-4, 9e-3, 8)
    counted = [[int((np.abs(multipliers(modes, cut, rpm, b, 10)) > 1).sum()) for b in depths] for rpm in speeds]
    assert (limits(modes, cut, speeds, 0.01).unstable(depths) == counted).all()


def test_the_stepped_cut_feels_process_damping_as_its_lobes_do() -> None:
    cut = rubbing(read_cut({"tool": {"overhang_m": 0.25, "mass_kg": 12}, "coefficients": "benchmark"}), 2e6, 0.3)
    robot = load_robot("kr90")
    point = tool_point(robot, Q, "on", cut)
    modes = point.modes.turned(cut.frame(point.axis))
    first = limits(modes, cut, np.array([2500.0]), 0.05).first()[0]
    assert first > 1.3 * limits(modes, cut.without_process_damping(), np.array([2500.0]), 0.05).first()[0]
    stepper = CutStepper(robot, Q, "on", cut, 2500.0)
    assert not stepper.run(0.9 * first, 4.0).chatter
    assert stepper.run(1.1 * first, 4.0).chatter


def test_forced_motion_of_a_soft_slow_tool_is_its_static_deflection() -> None:
    cut = benchmark_cut(0.5, "down")
    modes = real_modes([5000.0], [5.0], [[0.0, 1.0, 0.0]])
    found = forced_vibration(modes, cut, 1200.0, 1e-3)
    phase = (np.arange(20000) + 0.5) / 20000
    push = static_force(cut, phase, 1e-3)[:, 1] / (2 * np.pi * 5000) ** 2
    assert found.peak_to_peak_m[1] == pytest.approx(np.ptp(push), rel=0.15)  # rings where teeth leave


def test_the_stepped_cut_of_a_linear_robot_chatters_where_its_lobes_say() -> None:
    cut = read_cut({"tool": {"overhang_m": 0.25, "mass_kg": 12}, "coefficients": "benchmark"})
    robot = load_robot("kr90")
    point = tool_point(robot, Q, "on", cut)
    first = limits(point.modes.turned(cut.frame(point.axis)), cut, np.array([2500.0]), 0.05).first()[0]
    stepper = CutStepper(robot, Q, "on", cut, 2500.0)
    assert not stepper.run(0.93 * first, 3.0).chatter
    assert stepper.run(1.07 * first, 3.0).chatter


GAP, SLIP, HARDENING = tuple(NONLINEAR)[1:]


def chatters(name: str, depth_m: float, blow_n_s: float = 0.0) -> bool:
    """Whether the KR90 with a nonlinear joint chatters in the cut of the study."""
    stepper = CutStepper(nonlinear_robot(NONLINEAR[name]), AMPLITUDE_Q, "on", amplitude_cut(), AMPLITUDE_RPM)
    return stepper.run(depth_m, kick_n_s=blow_n_s).chatter


def test_a_blow_that_throws_teeth_out_of_the_work_lowers_the_limit_of_a_linear_robot() -> None:
    limit = linear_limit(nonlinear_robot(None), amplitude_cut())
    assert not chatters("as described", 0.93 * limit)
    assert chatters("as described", 1.07 * limit)
    assert chatters("as described", 0.6 * limit, blow_n_s=6.0)


def test_the_mean_force_closes_a_gap_where_linear_lobes_miss_the_spring() -> None:
    linear, closed = (linear_limit(nonlinear_robot(NONLINEAR[name]), amplitude_cut()) for name in (GAP, "as described"))
    assert linear < 0.7 * closed
    assert not chatters(GAP, 0.93 * closed)
    assert chatters(GAP, 1.07 * closed)


def test_slip_is_stuck_in_linear_lobes_and_slides_in_the_cut() -> None:
    """Beyond its yield an element adds no stiffness: where all slides, the limit is that of the robot without it."""
    stuck, sliding = (
        linear_limit(nonlinear_robot(NONLINEAR[name]), amplitude_cut()) for name in (SLIP, "as described")
    )
    assert stuck < 0.3 * sliding
    assert chatters(SLIP, 1.4 * stuck)
    assert not chatters(SLIP, 0.8 * sliding)
    assert chatters(SLIP, 0.8 * sliding, blow_n_s=6.0)  # as the robot without it: teeth leave the work


def test_the_mean_force_stiffens_a_hardening_joint_until_the_cut_chatters() -> None:
    """Linearised about the mean force k + 3k₃φ², the limit is where the depth that loads the joint equals it."""
    cut, entry, robot = amplitude_cut(), NONLINEAR[HARDENING], load_robot("kr90")
    assert entry is not None
    point = tool_point(robot, AMPLITUDE_Q, "on", cut)
    assert point.linear is not None
    force = static_force(cut, (np.arange(2000) + 0.5) / 2000, 1.0).mean(axis=0) @ cut.frame(point.axis)
    arm = np.cross([0, 0, 1], point.position)  # joint 1 turns about the base's vertical
    k, cubic = float(robot.axes[0].stiffness or 0), float(entry["cubic"])

    def loaded(depth: float) -> float:
        angle = next(r.real for r in np.roots([cubic, 0, k, -depth * (arm @ force)]) if abs(r.imag) < 1e-12)
        first = robot.axes[0].model_copy(update={"stiffness": k + 3 * cubic * angle**2})
        return linear_limit(robot.model_copy(update={"axes": [first, *robot.axes[1:]]}), cut) - depth

    expected = brentq(loaded, 1e-3, 4e-3, xtol=1e-5)
    assert expected < 0.7 * linear_limit(nonlinear_robot(entry), cut)
    assert not chatters(HARDENING, 0.85 * expected)
    assert chatters(HARDENING, 1.15 * expected)


def test_lobes_say_where_a_blow_leaves_chatter_beside_the_linear_limit() -> None:
    cut = amplitude_cut().model_copy(update={"spindle_rpm": (2490.0, 2510.0), "depth_max_m": 0.05})
    robot = nonlinear_robot(NONLINEAR[HARDENING])
    found = twin.lobes([0, 70, -100], robot=robot, cut=cut, draws=0, in_time=1, blow_n_s=1.0)
    (at,) = found.data()["in_time"]
    assert at["blow_n_s"] == 1.0
    assert at["depth_mm"] < 0.7 * found.data()["depth_limit_mm"][0]
    assert "after a blow of 1 N·s, at 2500 rpm: chatter from" in str(found)


def test_a_soft_servo_lowers_lobes_of_a_posture_file_whose_hammer_test_had_brakes_on() -> None:
    servo = {"effect": "servo_compliance", "site": "joint2", "stiffness": 2e6, "damping": 1e3}
    soft = nonlinear_robot(servo)
    cut = amplitude_cut().model_copy(update={"spindle_rpm": (2490.0, 2510.0), "depth_max_m": 0.05})
    posture = {"posture": {"q_deg": [0, 70, -100], "brakes": "on"}}
    found = twin.lobes(posture, robot=soft, cut=cut, draws=0)
    held = twin.lobes(posture, robot=soft, cut=cut, draws=0, brakes="on").data()["depth_limit_mm"][0]
    stiff = twin.lobes(posture, robot="kr90", cut=cut, draws=0)
    assert any(note.startswith("brakes: off") for note in found.data()["notes"])
    assert not any(note.startswith("brakes") for note in stiff.data()["notes"])
    assert held == stiff.data()["depth_limit_mm"][0] != pytest.approx(found.data()["depth_limit_mm"][0], rel=0.05)
    with pytest.raises(InputError, match="expected 'on' or 'off'"):
        twin.lobes(posture, robot="kr90", cut=cut, brakes="maybe")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "line"), [({"blow_n_s": 3.0}, "--in-time N"), ({"in_time": 1, "blow_n_s": -1.0}, "0 to 100 N·s")]
)
def test_a_blow_that_cannot_be_is_told(options: dict[str, float], line: str) -> None:
    with pytest.raises(InputError, match=line):
        twin.lobes([0, 70, -100], robot="kr90", **options)  # type: ignore[arg-type]


def campaign(noise: float) -> Campaign:
    robot = load_robot("kr90")
    labels, frequency = ["21X+", "21Y+", "21Z+"], np.arange(4, 150, 0.125)
    H = frf(linearise(assemble(robot, Q)), frequency, labels, labels)
    rng = np.random.default_rng(0)
    H = H * (1 + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)))
    there = Channels(tuple(labels), ("link3",) * 3, np.tile(robot.flange.position, (3, 1)), np.eye(3))
    return Campaign(there, there, {"p": PostureFRF("p", np.array([0, 70, -100.0]), "on", frequency, H, "accelerance")})


def test_a_measured_frf_gives_the_limits_of_the_robot_that_was_measured() -> None:
    robot, cut = load_robot("kr90"), read_cut({"tool": {"overhang_m": 0}, "coefficients": "benchmark"})
    measured, _ = measured_point(campaign(0.01), "p", robot, cut, "test")
    true = tool_point(robot, Q, "on", cut)
    speeds = np.geomspace(1500, 12000, 6)
    frame = cut.frame(true.axis)
    expected, found = (limits(p.modes.turned(frame), cut, speeds, 0.05).first() for p in (true, measured))
    assert np.allclose(found, expected, rtol=0.03)


def test_lobes_say_how_sure_they_are_only_where_it_is_known(tmp_path: Path) -> None:
    cut = {"tool": {"overhang_m": 0}, "coefficients": "aluminium_7075", "spindle_rpm": [9000, 12000]}
    plain = twin.lobes([0, 70, -100], robot="kr90", cut=cut, out=tmp_path / "plain")
    assert set(plain.data()["depth_safe90_mm"]) == {None}
    assert sorted(path.name for path in (tmp_path / "plain").iterdir()) == [
        ".twin-lobes", "lobes.html", "lobes.json", "lobes.png"
    ]  # fmt: skip
    measured = twin.lobes(campaign(0.01), cut=cut, draws=10)
    data = measured.data()
    assert len(data["spindle_rpm"]) == len(data["depth_limit_mm"]) == len(data["kind"]) == len(data["depth_safe90_mm"])
    assert (np.array(data["depth_safe90_mm"]) < data["depth_limit_mm"]).all()
    assert "safe 90 %" in str(measured)
    assert len(measured.tables()[0].rows) > 2


SHEAR = {"kt_n_per_m2": 6e8, "kr_n_per_m2": 1.8e8}


@pytest.mark.parametrize(
    ("cut", "line"),
    [
        ({"depth_max_m": -0.001}, "depth_max_m: input should be greater than or equal to"),
        ({"coefficients": {"kt_n_per_m2": 600, "kr_n_per_m2": 200}}, "kt_n_per_m2: expected N/m².*multiply it by 1e6"),
        ({"coefficients": {"kt_n_per_m2": 6e8}}, "coefficients.kr_n_per_m2: missing"),
        ({"coefficients": {**SHEAR, "kte_n_per_m": 12}}, "kte_n_per_m: expected N/m, .*multiply it by 1e3"),
        ({"coefficients": {**SHEAR, "process_damping_n_per_m": 600}}, "g_n_per_m: expected N/m, .*1e3"),
        ({"coefficients": {**SHEAR, "process_damping_n_per_m": -1}}, "g_n_per_m: input should"),
        ({"coefficients": "unobtainium"}, "no published coefficients 'unobtainium'"),
        ({"tool": {"diameter_m": 16}}, "diameter_m: expected metres, found 16; is it in mm"),
        ({"tool": {"overhang_m": 1.9, "direction": [0, -1, 0]}}, "below the table"),
        ({"immersion": 1.2}, "immersion"),
        ({"feed_direction": [0.8660254037844386, 0, -0.5]}, "is along the tool's axis"),
        ({"spindle_rpm": [9000, 3000]}, "spindle_rpm: expected a lowest and a highest speed"),
        ({"tool": {"theeth": 3}}, "tool.theeth: unknown field"),
        ({"tool": {"frf": "nowhere.h5"}}, "nowhere.h5"),
        ({"tool": {"modes": [{"frequency_hz": 40, "damping_percent": 2, "stiffness_n_per_m": 1e9, "direction": "x"}]}},
         "is lighter than the tool's modes"),
    ],
)  # fmt: skip
def test_a_fault_of_the_cut_is_told_in_one_line(cut: dict[str, object], line: str) -> None:
    with pytest.raises(InputError, match=line) as error:
        twin.lobes([0, 70, -100], robot="kr90", cut=cut)
    assert "\n" not in str(error.value)


def test_a_cut_in_the_place_of_a_posture_is_told(tmp_path: Path) -> None:
    (tmp_path / "cut.yaml").write_text("tool: {teeth: 2}\n")
    with pytest.raises(InputError, match="is a cut: give it as --cut"):
        twin.lobes(tmp_path / "cut.yaml")
