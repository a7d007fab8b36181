"""The twin's effects against the independent truth code, which shares nothing with it: the same entry, the same FRFs.

Truth: screw Jacobians and a gravity Hessian in numpy. Twin: MuJoCo. Where the two state a law differently on purpose
(how a bent link's mass is divided; the little inertia a moving foot has in MuJoCo) the agreement asked for is looser.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.truth.__main__ import main
from tools.truth.chain import flange_position
from tools.truth.chain import inverse_dynamics as rigid_torque
from tools.truth.robots import described as written_out
from tools.truth.robots import machines
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.sensor_weight import weightless
from twin.measure.campaign import Campaign, read_campaign
from twin.measure.motion_log import read_motion_log
from twin.model.frf import frf, measurement_chain
from twin.model.linear import linearise
from twin.model.parameters import independent
from twin.model.recorded import prepare
from twin.model.regressor import flange_path
from twin.model.replay import inverse_dynamics, motion_of
from twin.model.sensitivity import observe, point_jacobians, structure
from twin.physics.motion import Motion
from twin.robot.description import Drive, Robot, parse_robot
from twin.robot.frames import between_links
from twin.robot.mechanism import assemble


def truth(*arguments: str | Path) -> None:
    assert main([*map(str, arguments)]) == 0


def described(kr90: Robot, effect: str, site: str, values: dict[str, object], points: list[dict[str, object]]) -> Robot:
    data = kr90.model_dump(mode="json")
    if points:
        data["test_points"], data["accelerometers"] = points, []
    if effect:
        entries = [e for e in data["physics"] if (e["effect"], e["site"]) != (effect, site)]
        data["physics"] = [*entries, {"effect": effect, "site": site, **values}]
    return parse_robot(data)


def written(values: dict[str, object]) -> str:
    def text(value: object) -> str:
        return "|".join(map(str, value)) if isinstance(value, list) else str(value)

    return ",".join(f"{name}={text(value)}" for name, value in values.items())


HAMMER = [
    ("", "", {}, 1e-6),
    ("transverse_compliance", "joint2.x", {"stiffness": 5e6, "damping": 300.0}, 1e-6),
    ("base_compliance", "base.rx", {"stiffness": 3e7, "damping": 2e3}, 1e-3),
    ("base_compliance", "base.y", {"stiffness": 1e8, "damping": 2e3}, 1e-3),
    (
        "floor_mode",
        "base",
        {"mass": 2000.0, "inertia": [900.0, 900.0, 1500.0], "z": 5e7, "rx": 3e7, "ry": 4e7, "damping_ratio": 0.03},
        1e-3,
    ),
    ("link_flexibility", "link2.z", {"stiffness": 8e6, "damping": 300.0}, 0.1),
    ("link_flexibility", "link3.y", {"stiffness": 5e6, "damping": 300.0}, 0.1),
    ("servo_compliance", "joint2", {"stiffness": 3e7, "damping": 1e4}, 1e-6),
    ("servo_compliance", "joint3", {"stiffness": 1e7, "damping": 1e4, "integral_time": 0.2}, 1e-6),
    ("payload", "flange", {"mass": 30.0, "com": [1.7, 0.0, 0.1]}, 1e-6),
    (
        "attached_resonator",
        "link2",
        {"mass": 15.0, "frequency_hz": 14.0, "damping_ratio": 0.03, "axis": "y", "position": [0.9, 0.1, 0.2]},
        1e-5,
    ),
    ("structural_damping", "joint2.z", {"loss_factor": 0.05}, 1e-6),
    ("cross_stiffness", "joint2", {"stiffness": -2e6}, 3e-3),
    ("joint_offset", "joint3", {"angle": 0.015}, 1e-6),
    ("sensor_gain", "sensor:21Z+", {"gain": 1.08}, 1e-6),
    ("sensor_misalignment", "sensor:21", {"angles": [0.05, -0.08, 0.1]}, 1e-6),
    ("hammer_misalignment", "hammer:21Y+", {"angles": [0.05, -0.1]}, 1e-6),
    ("time_delay", "sensor:21X+", {"delay": 2e-4}, 1e-6),
]


@pytest.mark.parametrize(("effect", "site", "values", "tolerance"), HAMMER, ids=[f"{e}@{s}" for e, s, *_ in HAMMER])
def test_hammer_effects(  # type: ignore[no-untyped-def]
    kr90: Robot, tmp_path: Path, effect: str, site: str, values: dict[str, object], tolerance: float
) -> None:
    concealed = ["--effect", f"{effect}@{site}:{written(values)}"] if effect else []
    file = tmp_path / "c.h5"
    truth("campaign", "--out", file, "--nominal", "--no-sag", "--noise", 0, "--scatter", 0, "--postures", 3, *concealed)
    campaign = read_campaign(file)
    robot = described(kr90, effect, site, values, points_of(campaign))
    compared(robot, campaign, tolerance)


def loaded(kr90: Robot, folder: Path, mass: float) -> Campaign:
    """The truth's FRFs without noise, a payload on the node of the sensors."""
    file, at = folder / "c.h5", next(point for point in kr90.test_points if point.label == "21X+")
    options = ["--nominal", "--no-sag", "--noise", 0, "--scatter", 0, "--postures", 3, "--effect"]
    truth("campaign", "--out", file, *options, f"payload@{at.body}:{written({'mass': mass, 'com': list(at.position)})}")
    campaign = read_campaign(file)
    assert set(map(tuple, campaign.response.position.tolist())) == {tuple(at.position)}
    return campaign


def test_a_sensor_s_mass_is_felt_where_it_sits(kr90: Robot, tmp_path: Path) -> None:
    """The truth hangs it at the node as a payload; the twin leaves out what its weight adds to the stiffness."""
    mass = 6.0
    campaign = loaded(kr90, tmp_path, mass)
    for site in ("sensor:21", "sensor:*"):
        compared(described(kr90, "sensor_mass", site, {"mass": mass}, points_of(campaign)), campaign, 2e-3)
    with pytest.raises(AssertionError):
        compared(described(kr90, "", "", {}, points_of(campaign)), campaign, 0.1)


def test_what_a_sensor_s_weight_does_is_taken_off(kr90: Robot, tmp_path: Path) -> None:
    """The truth hangs it at the node as a payload; without the rest of it, the twin's law is exact."""
    mass = 6.0
    campaign = loaded(kr90, tmp_path, mass)
    robot = described(kr90, "sensor_mass", "sensor:*", {"mass": mass}, points_of(campaign))
    none, at_rest = independent([]), np.zeros(0)
    fit = Fitted(NONE, none, at_rest, at_rest, robot, 0.0, 1.0, np.zeros((0, 0)), 1.0, True)
    recordings = tuple(prepare(campaign, robot).values())
    for before, after in zip(recordings, weightless(recordings, fit), strict=True):
        law = before.respond(*observe(robot, before.setup, none, at_rest, sagging=False))
        off = [np.linalg.norm(r.frf - law) / np.linalg.norm(law) for r in (before, after)]
        assert off[0] > 1e-4
        assert off[1] < 1e-6
    plain = described(kr90, "", "", {}, points_of(campaign))
    assert weightless(recordings, replace(fit, described=plain)) is recordings


@pytest.mark.parametrize(("start", "end"), [(0, 2), (2, 0), (1, 1)])
def test_a_point_of_one_link_is_found_in_the_frame_of_another(kr90: Robot, start: int, end: int) -> None:
    q, point = np.array([0.3, 1.1, 0.7]), np.array([0.4, -0.2, 0.1])
    models = [structure(assemble(kr90, q))]
    there = between_links(kr90, q, start, end, point)
    places = [point_jacobians(models, f"link{k + 1}", where)[0] for k, where in ((start, point), (end, there))]
    assert places[0] == pytest.approx(places[1], abs=1e-12)


def points_of(campaign: Campaign) -> list[dict[str, object]]:
    """Test points of a description at the campaign's channels."""
    points = {
        label: {"label": label, "body": body, "position": position.tolist(), "direction": direction.tolist()}
        for channels in (campaign.response, campaign.excitation)
        for label, body, position, direction in zip(
            channels.label, channels.body, channels.position, channels.direction, strict=True
        )
    }
    return list(points.values())


def compared(robot: Robot, campaign: Campaign, tolerance: float) -> None:
    for posture in campaign.postures.values():
        linear = linearise(assemble(robot, robot.angles(posture.q_deg), brakes="off"))
        chain = measurement_chain(linear, robot, campaign.response.label, campaign.excitation.label)
        found = frf(linear, posture.frequency, chain, exponential_window_rate=posture.exponential_window_rate)
        assert np.linalg.norm(found - posture.frf) < tolerance * np.linalg.norm(posture.frf)


LOG = [
    ("", "", {}),
    ("payload", "flange", {"mass": 30.0, "com": [1.7, 0.0, 0.1]}),
    ("asymmetric_friction", "joint2", {"torque_difference": 80.0, "viscous_difference": 60.0}),
    ("stribeck_friction", "joint1", {"static_excess": 100.0, "velocity": 0.1}),
    ("load_dependent_friction", "joint2", {"coefficient": 0.05}),
    ("friction_drift", "joint3", {"amplitude": 0.4, "time_constant": 20.0}),
    ("cable_stiffness", "joint2", {"stiffness": 300.0, "rest": 0.5}),
    ("torque_ripple", "joint1", {"amplitude": 60.0, "order": 12.0, "phase": 0.4}),
    ("rotor_inertia", "joint1", {"inertia": 300.0}),
    ("joint_offset", "joint2", {"angle": 0.1}),
    ("gravity_direction", "base", {"angles": [0.1, -0.1]}),
    ("joint_coupling", "joint2", {"from": 3, "ratio": 0.5, "inertia": 200.0, "friction": 100.0, "coulomb": 20.0}),
]


@pytest.mark.parametrize(("effect", "site", "values"), LOG, ids=[f"{e}@{s}" for e, s, _ in LOG])
def test_log_effects(kr90: Robot, tmp_path: Path, effect: str, site: str, values: dict[str, object]) -> None:
    concealed = ["--effect", f"{effect}@{site}:{written(values)}"] if effect else []
    file = tmp_path / "l.h5"
    truth(
        "log", "--out", file, "--nominal", "--white", 0, "--coloured", 0, "--counts", 10**9, "--seconds", 20, *concealed
    )
    (run,) = read_motion_log(file).runs.values()
    assert run.torque is not None
    if effect == "joint_coupling":
        values = {"from": "joint3", "ratio": 0.5, "inertia": 200.0, "friction": [100.0, 20.0]}
    torque = inverse_dynamics(described(kr90, effect, site, values, []), motion_of(run))
    inner = slice(100, -100)
    error = np.sqrt(np.mean((torque - run.torque)[inner] ** 2, axis=0))
    assert (error < 0.02 * np.sqrt(np.mean(run.torque**2, axis=0))).all(), error


@pytest.mark.parametrize("name", ["six", "seven"])
def test_whole_arms_stand_and_move_as_the_truth_has_them(name: str) -> None:
    """Flange and rigid-body torques of random states, by Kane's equations there and Newton–Euler here."""
    machine = machines()[name]
    robot = parse_robot(written_out(machine))
    bare = robot.model_copy(update={"physics": [], "drives": [Drive() for _ in robot.axes]})
    q, v, a = np.random.default_rng(5).normal(size=(3, 6, machine.chain.n))
    np.testing.assert_allclose(flange_path(robot, q), flange_position(machine.chain, q), atol=1e-12)
    ours = inverse_dynamics(bare, Motion(np.zeros(6), q, v, a))
    np.testing.assert_allclose(ours, rigid_torque(machine.chain, q, v, a), rtol=1e-9, atol=1e-9)
