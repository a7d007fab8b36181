"""Every effect: null is the model without it, native MuJoCo elements do what the law says, sites hold."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from twin.diagnose.verdict import parameter_rows
from twin.measure.motion_log import MotionRun
from twin.measure.signals import lowpass
from twin.model.frf import frf, measurement_chain
from twin.model.linear import linearise, posture_state
from twin.model.modes import modes
from twin.model.regressor import Regressor
from twin.model.replay import inverse_dynamics, motion_of, replay
from twin.model.sensitivity import structure
from twin.physics import CATALOGUE
from twin.physics.motion import Motion
from twin.robot.bodies import cut
from twin.robot.description import Robot, load_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, compile_model

STRUCTURE = {
    "transverse_compliance": ("joint1.x", {"stiffness": 6.1e6, "damping": 40}),
    "base_compliance": ("base.ry", {"stiffness": 2e7, "damping": 1e3}),
    "floor_mode": ("base", {"mass": 3000, "inertia": [900, 900, 1500], "z": 5e7, "rx": 3e7, "damping_ratio": 0.03}),
    "link_flexibility": ("link3.y", {"stiffness": 5e6, "damping": 100}),
    "servo_compliance": ("joint1", {"stiffness": 2e7, "damping": 1e4}),
    "payload": ("flange", {"mass": 40, "com": [1.7, 0, 0]}),
    "attached_resonator": (
        "link2",
        {"mass": 15, "frequency_hz": 14, "damping_ratio": 0.03, "axis": "y", "position": [0.9, 0.1, 0.2]},
    ),
    "structural_damping": ("joint2.z", {"loss_factor": 0.05}),
    "cross_stiffness": ("joint1", {"stiffness": 1.5e6}),
    "joint_offset": ("joint3", {"angle": 0.05}),
}


def linear_of(robot: Robot, q: np.ndarray, brakes: str = "on"):  # type: ignore[no-untyped-def]
    return linearise(assemble(robot, q, brakes=brakes))  # type: ignore[arg-type]


@pytest.mark.parametrize("effect", STRUCTURE)
def test_structural_effects_change_the_modes_and_vanish_when_removed(
    kr90: Robot, with_entry: Callable[..., Robot], milling: np.ndarray, effect: str
) -> None:
    site, values = STRUCTURE[effect]
    base = kr90.without([f"{effect}@{site}"])
    robot = with_entry(effect, site, **values) if base is not kr90 and effect != "transverse_compliance" else kr90
    brakes = "off" if effect == "servo_compliance" else "on"
    before, after = modes(linear_of(base, milling, brakes)), modes(linear_of(robot, milling, brakes))
    assert abs(after.pole[:4] / before.pole[:4] - 1).max() > 1e-3
    again = modes(linear_of(robot.without([f"{effect}@{site}"]), milling, brakes))
    np.testing.assert_allclose(again.pole, before.pole, rtol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("base_compliance", {"stiffness": 1e14, "damping": 0}),
        ("link_flexibility", {"stiffness": 1e14, "damping": 0}),
        ("floor_mode", {"mass": 0, "inertia": [0, 0, 0], "z": 1e14, "damping_ratio": 0}),
        ("servo_compliance", {"stiffness": 1e14, "damping": 0}),
        ("payload", {"mass": 0, "com": [0, 0, 0]}),
        ("attached_resonator", STRUCTURE["attached_resonator"][1] | {"mass": 1e-7}),
        ("structural_damping", {"loss_factor": 0}),
        ("cross_stiffness", {"stiffness": 0}),
        ("joint_offset", {"angle": 0}),
    ],
)
def test_towards_the_null_value_the_model_is_the_one_without(
    kr90: Robot, with_entry: Callable[..., Robot], milling: np.ndarray, effect: str, values: dict[str, object]
) -> None:
    robot = with_entry(effect, STRUCTURE[effect][0], **values)
    frequency = np.linspace(5, 60, 50)
    labels = [point.label for point in kr90.test_points]
    plain = frf(linear_of(kr90, milling), frequency, labels, labels)
    found = frf(linear_of(robot, milling, "off"), frequency, labels, labels)
    assert np.linalg.norm(found - plain) < 1e-5 * np.linalg.norm(plain)


def test_brakes_that_are_on_rule_the_servo_out(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    robot = with_entry("servo_compliance", "joint1", stiffness=2e7, damping=1e4)
    assert len(linear_of(robot, milling, "on").coordinates) == 9
    assert len(linear_of(robot, milling, "off").coordinates) == 10


def test_base_yaw_is_an_alias_of_joint_1_torsion(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    """Springs in series about one axis: 1/k = 1/k₁ + 1/k₂, but for the foot's own small inertia."""
    k1 = 5.0e6
    serial = with_entry("base_compliance", "base.rz", stiffness=2 * k1, damping=0)
    softer = with_entry("payload", "link1", mass=0, com=[0, 0, 0])
    softer.axes[0].__dict__.update(stiffness=k1 * 2 / 3)
    frequency = np.linspace(5, 30, 100)
    a, b = (frf(linear_of(r, milling), frequency, ["21Z+"], ["21Z+"], "receptance") for r in (serial, softer))
    assert np.linalg.norm(np.abs(a) - np.abs(b)) < 0.1 * np.linalg.norm(b)


def test_a_resonator_puts_its_own_mode_beside_the_robot_s(
    with_entry: Callable[..., Robot], milling: np.ndarray
) -> None:
    """A light one rings at its own frequency and damping ratio, and pulls on the link it sits on."""
    light = STRUCTURE["attached_resonator"][1] | {"mass": 0.01}
    found = modes(linear_of(with_entry("attached_resonator", "link2", **light), milling))
    assert len(found) == 10
    own = int(np.argmin(abs(found.frequency_hz - 14)))
    assert found.frequency_hz[own] == pytest.approx(14, rel=1e-3)
    assert found.damping_percent[own] == pytest.approx(3, rel=1e-2)


@pytest.mark.parametrize("stated", [(), (3.0,), (0.5, 0.3), (1.2, 0.9, 2.0), (1.0, 5.0, 0.1)])
def test_cut_halves_add_up_and_are_physically_consistent(kr90: Robot, stated: tuple[float, ...]) -> None:
    link = kr90.links[1]
    whole = link.inertial
    inboard, outboard = cut(whole, np.array([0.675, 0, 0]), np.array([1.0, 0, 0]), *stated)
    assert inboard[0] + outboard[0] == pytest.approx(whole[0])
    moment = sum(mass * com for mass, com, _ in (inboard, outboard))
    np.testing.assert_allclose(moment, whole[0] * whole[1], atol=1e-9)
    about_origin = sum(
        inertia + mass * (com @ com * np.eye(3) - np.outer(com, com)) for mass, com, inertia in (inboard, outboard)
    )
    expected = whole[2] + whole[0] * (whole[1] @ whole[1] * np.eye(3) - np.outer(whole[1], whole[1]))
    np.testing.assert_allclose(about_origin, expected, rtol=1e-9)
    assert inboard[1][0] < 0.675 < outboard[1][0]
    ratio, separation, moments, *_ = (*stated, *[None] * 3)
    if ratio:
        assert outboard[0] / inboard[0] == pytest.approx(ratio)
    if separation and separation < 1.0:  # 5 m apart each half would be thinner than nothing
        assert np.linalg.norm(outboard[1] - inboard[1]) == pytest.approx(separation)
    if moments:
        along = (outboard[1] - inboard[1]) / np.linalg.norm(outboard[1] - inboard[1])
        second = [0.5 * np.trace(inertia) - along @ inertia @ along for _, _, inertia in (inboard, outboard)]
        assert second[1] / second[0] == pytest.approx(moments, rel=5e-3)  # the line of the centres is no principal axis
    for _, _, inertia in (inboard, outboard):
        principal = np.linalg.eigvalsh(inertia)
        assert principal[0] > 0
        assert principal[0] + principal[1] > principal[2]


def torque_at(robot: Robot, q: np.ndarray, joint: str, deflection: float) -> float:
    """Passive torque of the compiled model on one deflection, gravity's share at zero deflection taken off."""
    robot = robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    mechanism = assemble(robot, q)
    model = compile_model(mechanism, visual=False)
    data = posture_state(model, mechanism)
    data.qpos[model.joint(joint).qposadr[0]] = deflection
    mujoco.mj_forward(model, data)
    return float(-data.qfrc_passive[model.joint(joint).dofadr[0]])


def test_hardening_is_the_native_cubic(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    robot = with_entry("hardening_stiffness", "joint2.z", cubic=4e12)
    for phi in (-1e-3, 5e-4):
        assert torque_at(robot, milling, "joint2.z", phi) == pytest.approx(6.9e6 * phi + 4e12 * phi**3, rel=1e-9)


def test_backlash_is_a_dead_zone_of_the_total_gap(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    robot = with_entry("backlash", "joint2.z", gap=2e-4)
    for phi, expected in ((0.5e-4, 0), (-0.9e-4, 0), (3e-4, 6.9e6 * 2e-4), (-3e-4, -6.9e6 * 2e-4)):
        assert torque_at(robot, milling, "joint2.z", phi) == pytest.approx(expected, abs=1e-6)


def test_gravity_preloads_the_gap(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    """The commanded posture is the equilibrium on the loaded flank: the linear model is the one without a gap."""
    plain = modes(linear_of(with_entry("payload", "link1", mass=0, com=[0, 0, 0]), milling))
    gap = modes(linear_of(with_entry("backlash", "joint2.z", gap=2e-4), milling))
    np.testing.assert_allclose(gap.pole, plain.pole, rtol=1e-6)


def test_slip_elements_are_springs_until_they_yield_and_remember(
    with_entry: Callable[..., Robot], milling: np.ndarray
) -> None:
    """Maxwell slip natively: loading to twice the yield deflection and back leaves −k·yield at zero."""
    robot = with_entry("hysteresis", "joint2.z", stiffness=[1e6], yield_torque=[100.0])
    mechanism = assemble(robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)}), milling)
    model = compile_model(mechanism, visual=False)
    model.opt.timestep = 1e-7  # the step that updates the slip hardly moves the joint
    data = posture_state(model, mechanism)
    address, dof = model.joint("joint2.z").qposadr[0], model.joint("joint2.z").dofadr[0]
    torque = []
    for phi in (0.5e-4, 2e-4, 0.0):
        data.qpos[:], data.qvel[:] = 0, 0
        data.qpos[address] = phi
        mujoco.mj_step(model, data)
        data.qpos[:], data.qvel[:] = 0, 0
        data.qpos[address] = phi
        mujoco.mj_forward(model, data)
        torque.append(float(-data.qfrc_passive[dof]) - 6.9e6 * phi)
    np.testing.assert_allclose(torque, [50, 100, -100], rtol=1e-6)


DRIVE = {
    "viscous_friction": ("joint1", {"coefficient": 500}),
    "coulomb_friction": ("joint1", {"torque": 200}),
    "asymmetric_friction": ("joint1", {"torque_difference": 80, "viscous_difference": 60}),
    "stribeck_friction": ("joint1", {"static_excess": 100, "velocity": 0.1}),
    "load_dependent_friction": ("joint2", {"coefficient": 0.05}),
    "gravity_compensator": ("joint2", {"coefficients": [-3000, 200, 100]}),
    "cable_stiffness": ("joint2", {"stiffness": 300, "rest": 0.5}),
    "torque_ripple": ("joint1", {"amplitude": 60, "order": 12, "phase": 0.4}),
    "rotor_inertia": ("joint1", {"inertia": 300}),
    "joint_coupling": ("joint2", {"from": "joint3", "ratio": 0.5, "inertia": 200, "friction": [100, 0]}),
    "friction_drift": ("joint1", {"amplitude": 0.5, "time_constant": 2}),
    "hysteresis": ("joint1.z", {"stiffness": [1e6], "yield_torque": [150]}),
    "presliding": ("joint1", {"stiffness": [1e6], "yield_torque": [150]}),
}


@pytest.fixture(scope="module")
def run() -> MotionRun:
    rate, w = 250.0, 2 * np.pi * 0.25
    t = np.arange(0, 4, 1 / rate)
    amplitude, phase, centre = np.array([0.4, 0.25, 0.35]), np.array([0.0, 0.7, 1.4]), np.array([0.0, 1.3, -1.5])
    angle = w * t[:, None] + phase
    return MotionRun(
        "sine", t, centre + amplitude * np.sin(angle), rate,
        velocity=amplitude * w * np.cos(angle), acceleration=-amplitude * w**2 * np.sin(angle),
    )  # fmt: skip


UPRIGHT = "gravity_compensator", "joint2", {"coefficients": [-3000, 200, 100], "zero": -1.4}


@pytest.mark.parametrize(("effect", "site", "values"), [*((name, *entry) for name, entry in DRIVE.items()), UPRIGHT])
def test_replay_shows_the_torque_of_the_law(
    with_entry: Callable[..., Robot], run: MotionRun, effect: str, site: str, values: dict[str, Any]
) -> None:
    """The change an entry makes to the drive torque in MuJoCo's time stepping is the law's, away from reversals."""
    keep = ("viscous_friction",) if effect in ("friction_drift", "joint_coupling") else ()
    plain = with_entry("payload", "link1", keep=keep, mass=0, com=[0, 0, 0])
    robot = with_entry(effect, site, keep=keep, **values)
    for description in (plain, robot):
        for axis in description.axes:  # rigid joints: what remains is the law
            axis.__dict__.update(stiffness=None)
    law = inverse_dynamics(robot, motion_of(run)) - inverse_dynamics(plain, motion_of(run))
    stepped = replay(robot, run).torque - replay(plain, run).torque
    steady = (np.abs(run.velocity) > 0.15 * np.abs(run.velocity).max(axis=0)).all(axis=1)
    steady[:50] = False
    error = np.sqrt(np.mean((stepped - law)[steady] ** 2))
    assert np.abs(law).max() > 10
    assert error < 0.03 * np.sqrt(np.mean(law[steady] ** 2)) + 0.5


def test_a_replay_has_the_torque_of_its_own_motion(kr90: Robot) -> None:
    """Reversals included: dry friction holds until an axis turns back, and torque belongs to the instant it is told at.

    MuJoCo's own time constant of friction and a torque half a sample late left 0.9 to 1.6 %. What stays is of springs.
    """
    time = np.arange(0, 8, 0.004)
    position = np.deg2rad([0, 80, -100]) + 0.3 * np.sin(np.outer(time, [1.3, 1.9, 1.6]))
    moved = replay(kr90, MotionRun("sway", time, position, 250.0))
    rigid = inverse_dynamics(kr90, motion_of(MotionRun("moved", time, moved.position, 250.0)))
    low = [lowpass(torque, 250.0, 8.0, 10.0)[125:-125] for torque in (moved.torque, rigid)]
    off = np.sqrt(np.mean((low[0] - low[1]) ** 2, axis=0) / np.mean(low[1] ** 2, axis=0))
    assert (off < 0.006).all()


def test_measurement_effects_act_on_the_recording(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    frequency = np.linspace(5, 50, 20)
    response, excitation = ["21X+", "21Y+", "21Z+"], ["21Y+", "5Z-"]

    def recorded(effect: str, site: str, **values: object) -> np.ndarray:
        robot = with_entry(effect, site, **values)
        linear = linear_of(robot, milling)
        return frf(linear, frequency, measurement_chain(linear, robot, response, excitation))

    true = recorded("sensor_gain", "sensor:21Z+", gain=1.0)
    np.testing.assert_allclose(recorded("sensor_gain", "sensor:21Z+", gain=1.1)[:, 2], 1.1 * true[:, 2])
    late = recorded("time_delay", "sensor:21X+", delay=1e-3)
    np.testing.assert_allclose(late[:, 0], true[:, 0] * np.exp(-2j * np.pi * frequency * 1e-3)[:, None])
    turned = recorded("sensor_misalignment", "sensor:21", angles=[0, 0, np.pi / 2])
    np.testing.assert_allclose(turned[:, 0], -true[:, 1], atol=1e-12)
    np.testing.assert_allclose(turned[:, 1], true[:, 0], atol=1e-12)
    linear = linear_of(with_entry("sensor_gain", "sensor:21Z+", gain=1.0), milling)
    across = frf(linear, frequency, response, ["21X+", "21Z+"])
    about_z = recorded("hammer_misalignment", "hammer:21Y+", angles=[0, np.pi / 2])
    np.testing.assert_allclose(about_z[:, :, 0], -across[:, :, 0], atol=1e-12)
    about_x = recorded("hammer_misalignment", "hammer:21Y+", angles=[np.pi / 2, 0])
    np.testing.assert_allclose(about_x[:, :, 0], across[:, :, 1], atol=1e-12)


def test_sensor_delay_is_native(with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    spec = build_spec(assemble(with_entry("time_delay", "sensor:21X+", delay=3e-3), milling), visual=False)
    assert spec.sensor("21X+").delay == pytest.approx(3e-3)
    spec.compile()


@pytest.mark.parametrize("stiffness", [1.5e6, -3e6])
def test_a_bearing_couples_its_tilts_in_mujoco_as_in_closed_form(
    with_entry: Callable[..., Robot], kr90: Robot, milling: np.ndarray, stiffness: float
) -> None:
    """The tendon and what the hinges' own springs give up leave k_xy off the diagonal, and nothing on it."""
    plain, robot = linear_of(kr90, milling), with_entry("cross_stiffness", "joint2", stiffness=stiffness)
    x, y = (plain.coordinates.index(f"joint2.{axis}") for axis in "xy")
    added = linear_of(robot, milling).K - plain.K
    expected = np.zeros_like(added)
    expected[x, y] = expected[y, x] = stiffness
    np.testing.assert_allclose(added, expected, atol=1e-6 * abs(stiffness))
    closed = structure(assemble(robot, milling))
    order = [closed.coordinates.index(name) for name in plain.coordinates]
    np.testing.assert_allclose(closed.K[np.ix_(order, order)] - plain.K, expected, atol=1e-5 * abs(stiffness))


def test_an_axis_stands_off_its_encoder(kr90: Robot, with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    """The robot with an offset is the one commanded to where its axis stands; torques and laws of position follow."""
    robot, there = with_entry("joint_offset", "joint2", angle=0.02), milling + np.array([0.0, 0.02, 0.0])
    np.testing.assert_array_equal(linear_of(robot, milling).K, linear_of(kr90, there).K)
    rng = np.random.default_rng(1)
    v, a, t = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), np.arange(5.0)
    recorded, true = Motion(t, milling + 0.1 * v, v, a), Motion(t, there + 0.1 * v, v, a)
    np.testing.assert_allclose(inverse_dynamics(robot, recorded), inverse_dynamics(kr90, true), rtol=1e-12)
    one, other = Regressor(robot), Regressor(kr90)
    np.testing.assert_allclose(one.evaluate(recorded), other.evaluate(true), rtol=1e-12)
    np.testing.assert_allclose(one.known_torque(recorded), other.known_torque(true), rtol=1e-12)


def test_a_leaning_foot_turns_the_weight(kr90: Robot, with_entry: Callable[..., Robot], milling: np.ndarray) -> None:
    """Tilted about x by a, the foot's y leans down: gravity there has the part -g sin a along it."""
    robot = with_entry("gravity_direction", "base", angles=[0.03, 0.0])
    np.testing.assert_allclose(robot.felt_gravity, 9.81 * np.array([0.0, -np.sin(0.03), -np.cos(0.03)]), rtol=1e-12)
    still = Motion(np.zeros(1), milling[None], np.zeros((1, 3)), np.zeros((1, 3)))
    leans = kr90.model_copy(update={"gravity": tuple(robot.felt_gravity)})
    np.testing.assert_allclose(inverse_dynamics(robot, still), inverse_dynamics(leans, still), rtol=1e-12)
    assert abs(inverse_dynamics(robot, still) - inverse_dynamics(kr90, still)).max() > 10.0


def test_the_catalogue_has_the_vocabulary_s_identifiers() -> None:
    assert len(CATALOGUE) == 34  # 32 of the vocabulary, how its dry friction turns round, and laws found in data
    for effect in CATALOGUE.values():
        assert effect.__doc__
        assert effect.seen_in <= {"hammer", "levels", "log"}
        assert list(effect.fixed_sites(3)) or all("LABEL" in s or "NODE" in s for s in effect.sites)


def test_a_joint_that_slides_has_units_that_slide(kr90: Robot) -> None:
    """A force over a speed at a linear axis, a torque about it at any other; each number of a list has its own."""
    linear = load_robot(Path(__file__).parent / "data" / "emps.yaml")
    dry, uneven = CATALOGUE["coulomb_friction"], CATALOGUE["asymmetric_friction"]
    assert [dry.unit("torque", "joint1", robot) for robot in (kr90, linear)] == ["N·m", "N"]
    assert uneven.unit("viscous_difference", "joint1", linear) == "N·s/m"
    assert CATALOGUE["hysteresis"].unit("stiffness[1]", "joint1.z", linear) == "N/m"
    assert CATALOGUE["transverse_compliance"].unit("stiffness", "joint1.x", linear) == "N·m/rad"
    assert CATALOGUE["base_compliance"].unit("damping", "base.z", kr90) == "N·s/m"
    coupling = CATALOGUE["joint_coupling"]
    assert [coupling.unit(f"friction[{k}]", "joint3", kr90) for k in (0, 1)] == ["N·m·s/rad", "N·m"]
    friction = {"value": [0.8, 2.7], "unit": "N·m·s/rad, N·m", "interval90": [[0.7, 0.9], [2.6, 2.8]]}
    assert [row.split("   ")[0] for row in parameter_rows({"friction": friction})] == [
        "friction[0] 0.8 N·m·s/rad",
        "friction[1] 2.7 N·m",
    ]
    columns = {
        column.name: column.unit for column in Regressor(linear.without(["asymmetric_friction"]), offsets=True).columns
    }
    assert [columns[name] for name in ("coulomb_friction@joint1.torque", "torque_offset@joint1")] == ["N", "N"]


def test_a_payload_beside_its_links_inertia_may_be_one_body() -> None:
    """It was named beside `parameter` at that link; a payload that has an inertia, or another link, is left alone."""
    robot, law = load_robot("kr90_six"), CATALOGUE["payload"]
    point = law.typical(robot, "flange")
    (one,) = law.merged(robot, "flange", point, "parameter", "link6.inertia")
    assert (one.effect, one.site) == ("payload", "flange")
    assert one.values is not None
    assert one.values["mass"] == point["mass"]
    assert min(one.values["inertia"]) > 0
    assert (
        law.merged(robot, "flange", point, "parameter", "link*.inertia") == law.fuller(robot, "flange", point) == [one]
    )
    assert law.merged(robot, "flange", dict(one.values), "parameter", "link6.inertia") == []
    assert law.fuller(robot, "flange", dict(one.values)) == []
    assert law.merged(robot, "flange", point, "parameter", "link5.inertia") == []


def test_no_more_inertia_is_taken_off_a_rotor_than_it_has(kr90: Robot) -> None:
    """A fit of a robot's log took 648 of 583 kg·m²; MuJoCo refused the servo's gains, with a traceback."""
    drive = kr90.drives[1]
    whole = drive.gear_ratio**2 * drive.rotor_inertia
    effect = CATALOGUE["rotor_inertia"]
    assert effect.nearest(kr90, "joint2", {"inertia": -2 * whole})["inertia"] == pytest.approx(-0.99 * whole)
    assert effect.nearest(kr90, "joint2", {"inertia": -0.5 * whole})["inertia"] == -0.5 * whole
