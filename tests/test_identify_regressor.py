"""The regressor and its base parameters against the paper's Appendix B, Pinocchio and MuJoCo."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from tests.test_pinocchio import rigid_model
from twin.errors import NumericalError
from twin.measure.motion_log import MotionRun
from twin.model.base_parameters import structural_base
from twin.model.regressor import (
    Regressor,
    body_of,
    inertial_vector,
    link_regressor,
    link_torque,
    pseudo_inertia,
    rotor_body_regressor,
)
from twin.model.replay import inverse_dynamics, motion_of, replay, rigid_torque
from twin.physics.motion import Motion
from twin.robot.description import Entry, Robot, load_robot, parse_robot
from twin.robot.frames import matrix_of

DATA = Path(__file__).parent / "data"
ROBOTS = [DATA / "arm6.urdf", DATA / "arm_linear.urdf", "kr90"]
FIFTEEN = (
    "link1.Izz", "link2.Izz", "link2.mcx", "link2.mcy", "link2.Ixx", "link2.Ixz", "link2.Ixy", "link2.Iyz", "link3.Izz",
    "link3.mcx", "link3.mcy", "link3.Ixx", "link3.Ixz", "link3.Ixy", "link3.Iyz",
)  # fmt: skip
A1, A2, G = 0.35, 1.35, -9.81  # m, m, m/s²; with g = −9.81 the printed rows are torques of the drives


def random_motion(robot: Robot, samples: int = 30, seed: int = 3) -> Motion:
    rng = np.random.default_rng(seed)
    n = robot.axis_count
    return Motion(
        np.arange(samples, dtype=float), rng.uniform(-1.5, 1.5, (samples, n)), rng.normal(0, 1, (samples, n)),
        rng.normal(0, 3, (samples, n)),
    )  # fmt: skip


def appendix_b(motion: Motion, n2: float, n3: float) -> np.ndarray:
    """Columns 1–18 of the paper's Appendix B, (nt, 3, 18); products of inertia there are +Σ m x y.

    Damaged in the scan, resolved by mechanics: the placement of dots and indices in B.5–B.11 and B.19; in B.14 the
    middle line is the second half of the first; B.40 and B.41 hold + a2 q̇2² (centripetal), as printed.
    """
    s, c = np.sin, np.cos
    (q1, q2, q3), (v1, v2, v3), (d1, d2, d3) = motion.position.T, motion.velocity.T, motion.acceleration.T
    Y = np.zeros((len(q1), 3, 18))
    q23, q223 = q2 + q3, 2 * q2 + q3
    v23, d23 = v2 + v3, d2 + d3
    Y[:, 0, 0] = d1
    Y[:, 0, 2] = 2 * A1 * (d1 * c(q2) - v1 * v2 * s(q2))
    Y[:, 0, 3] = -2 * A1 * (d1 * s(q2) + v1 * v2 * c(q2))
    Y[:, 0, 4] = d1 / 2 - d1 * c(2 * q2) / 2 + v1 * v2 * s(2 * q2)
    Y[:, 0, 5] = -c(q2) * v2**2 - d2 * s(q2)
    Y[:, 0, 6] = -d1 * s(2 * q2) - 2 * v1 * v2 * c(2 * q2)
    Y[:, 0, 7] = v2**2 * s(q2) - d2 * c(q2)
    Y[:, 0, 9] = (
        A2 * d1 * (c(q3) + c(q223)) + 2 * A1 * d1 * c(q23) - 2 * A1 * v1 * v23 * s(q23) - A2 * v1 * v3 * s(q3)
        - 2 * A2 * v1 * v2 * s(q223) - A2 * v1 * v3 * s(q223)
    )  # fmt: skip
    Y[:, 0, 10] = (
        -A2 * d1 * (s(q3) + s(q223)) - 2 * A1 * d1 * s(q23) - 2 * A1 * v1 * v23 * c(q23) - A2 * v1 * v3 * c(q3)
        - 2 * A2 * v1 * v2 * c(q223) - A2 * v1 * v3 * c(q223)
    )  # fmt: skip
    Y[:, 0, 11] = d1 / 2 - d1 * c(2 * q23) / 2 + v1 * v23 * s(2 * q23)
    Y[:, 0, 12] = -c(q23) * v23**2 - d23 * s(q23)
    Y[:, 0, 13] = -d1 * s(2 * q23) - 2 * v1 * v23 * c(2 * q23)
    Y[:, 0, 14] = s(q23) * v23**2 - d23 * c(q23)
    Y[:, 0, 16] = d1 / 2 - d1 * c(2 * n2 * q2) / 2 + n2 * v1 * v2 * s(2 * n2 * q2)
    turned = 2 * q2 + 2 * n3 * q3
    Y[:, 0, 17] = d1 / 2 - d1 * c(turned) / 2 + v1 * (v2 + n3 * v3) * s(turned)
    Y[:, 1, 1] = d2
    Y[:, 1, 2] = A1 * v1**2 * s(q2) - G * c(q2)
    Y[:, 1, 3] = A1 * c(q2) * v1**2 + G * s(q2)
    Y[:, 1, 4] = -(v1**2) * s(2 * q2) / 2
    Y[:, 1, 5] = -d1 * s(q2)
    Y[:, 1, 6] = v1**2 * c(2 * q2)
    Y[:, 1, 7] = -d1 * c(q2)
    Y[:, 1, 8] = d23
    Y[:, 1, 9] = (
        2 * A2 * d2 * c(q3) - G * c(q23) + A2 * d3 * c(q3) + A1 * v1**2 * s(q23) - A2 * v3**2 * s(q3)
        + A2 * v1**2 * s(q223) - 2 * A2 * v2 * v3 * s(q3)
    )  # fmt: skip
    Y[:, 1, 10] = (
        G * s(q23) - 2 * A2 * d2 * s(q3) - A2 * d3 * s(q3) + A1 * v1**2 * c(q23) - A2 * v3**2 * c(q3)
        + A2 * v1**2 * c(q223) - 2 * A2 * v2 * v3 * c(q3)
    )  # fmt: skip
    Y[:, 1, 15] = d2 + n3 * d3
    Y[:, 1, 16] = -n2 * v1**2 * s(2 * n2 * q2) / 2
    Y[:, 1, 17] = -(v1**2) * s(turned) / 2
    Y[:, 2, 8] = d23
    Y[:, 2, 9] = (
        A2 * d2 * c(q3) - G * c(q23) + A1 * v1**2 * s(q23) + A2 * v1**2 * s(q3) / 2 + A2 * v2**2 * s(q3)
        + A2 * v1**2 * s(q223) / 2
    )  # fmt: skip
    Y[:, 2, 10] = (
        G * s(q23) - A2 * d2 * s(q3) + A1 * v1**2 * c(q23) + A2 * v1**2 * c(q3) / 2 + A2 * v2**2 * c(q3)
        + A2 * v1**2 * c(q223) / 2
    )  # fmt: skip
    Y[:, 2, 15] = n3 * (d2 + n3 * d3)
    Y[:, 2, 17] = -n3 * v1**2 * s(turned) / 2
    for row in (1, 2):
        Y[:, row, 11] = -(v1**2) * s(2 * q23) / 2
        Y[:, row, 12] = -d1 * s(q23)
        Y[:, row, 13] = v1**2 * c(2 * q23)
        Y[:, row, 14] = -d1 * c(q23)
    return Y


def test_the_columns_are_those_of_appendix_b(kr90: Robot) -> None:
    """Fifteen inertial columns and three of the rotors as spinning bodies, to 1e-9 of the largest."""
    motion = random_motion(kr90)
    ratios = [drive.gear_ratio for drive in kr90.drives]
    printed = appendix_b(motion, ratios[1], ratios[2])
    columns = [column.name for column in Regressor(kr90).columns]
    sign = np.array([-1.0 if name.endswith(("Ixy", "Ixz", "Iyz")) else 1.0 for name in FIFTEEN])
    ours = link_regressor(kr90, motion)[:, :, [columns.index(name) for name in FIFTEEN]] * sign
    np.testing.assert_allclose(ours, printed[:, :, :15], atol=1e-9 * np.abs(printed[:, :, :15]).max())
    rotors = rotor_body_regressor(kr90, motion)[:, :, [4 * 2 + 3, 4 * 1 + 1, 4 * 2 + 1]]  # Izz3, Ixx2, Ixx3
    # N2 q̇2 in a sine of 2 N2 q2: the rounding of an angle of 1e3 rad
    np.testing.assert_allclose(rotors, printed[:, :, 15:], atol=1e-9 * np.abs(printed[:, :, 15:]).max())


def test_base_parameters_are_the_papers(kr90: Robot) -> None:
    """Table A1's combinations, with rotors as reflected inertia: fifteen of the links and the third rotor's."""
    base = structural_base(Regressor(kr90))
    written = dict(zip(base.names, base.combinations(kr90), strict=True))
    assert set(base.names[:15]) == set(FIFTEEN)
    assert base.names[15] == "drive3.rotor_inertia"
    assert written["link2.mcx"] == "link2.mcx + a2 link3.mass"
    assert written["link2.Ixx"] == "link2.Ixx − link2.Iyy − a2² link3.mass"
    assert written["link2.Ixz"] == "link2.Ixz − a2 link3.mcz"  # matrix elements: the paper's +Σ m x z with its sign
    K = base.combine[base.names.index("link1.Izz")]
    columns = [column.name for column in base.columns]
    for name, value in (("link2.mass", A1**2), ("link3.mass", A1**2 + A2**2), ("link2.Iyy", 1), ("link3.Iyy", 1)):
        assert K[columns.index(name)] == pytest.approx(value, abs=1e-9)
    assert K[columns.index("drive1.rotor_inertia")] == pytest.approx(256.5**2, rel=1e-9)


def from_description(robot: Robot) -> pin.Model:
    """Pinocchio's model of the same modified-DH chain, joints about (along) z."""
    model = pin.Model()
    model.gravity.linear = np.array(robot.gravity)
    R, x = matrix_of(np.array(robot.base.quaternion)), np.array(robot.base.position)
    parent = 0
    for i, (axis, link) in enumerate(zip(robot.axes, robot.links, strict=True)):
        A = Rotation.from_euler("XZ", [axis.alpha_deg, axis.theta_deg], degrees=True).as_matrix()
        p = np.array([axis.a, 0, 0]) + Rotation.from_euler("X", axis.alpha_deg, degrees=True).apply([0, 0, axis.d])
        joint = pin.JointModelPZ() if axis.type == "prismatic" else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(R @ A, x + R @ p), f"joint{i + 1}")
        model.appendBodyToJoint(
            parent, pin.Inertia(link.inertial[0], link.inertial[1], link.inertial[2]), pin.SE3.Identity()
        )
        R, x = np.eye(3), np.zeros(3)
    return model


@pytest.mark.parametrize("name", ROBOTS, ids=lambda p: Path(p).stem)
def test_the_link_columns_are_pinocchios(name: str | Path) -> None:
    """Every one of the ten columns per link, on revolute and prismatic chains, to 1e-9."""
    robot = load_robot(name)
    model = from_description(robot)
    data = model.createData()
    motion = random_motion(robot)
    order = [0, 1, 2, 3, 4, 6, 9, 5, 7, 8]  # theirs: m, mc, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
    for ours, q, v, a in zip(
        link_regressor(robot, motion), motion.position, motion.velocity, motion.acceleration, strict=True
    ):
        theirs = pin.computeJointTorqueRegressor(model, data, q, v, a)
        theirs = theirs.reshape(len(q), -1, 10)[:, :, order].reshape(len(q), -1)
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("name", ROBOTS, ids=lambda p: Path(p).stem)
def test_links_and_rotors_give_mujocos_inverse_dynamics(name: str | Path) -> None:
    """Regressor times described parameters is mj_inverse of the bare chain with armature, to 1e-9."""
    robot = load_robot(name)
    robot = robot.model_copy(
        update={"axes": [a.model_copy(update={"stiffness": None, "limits": None}) for a in robot.axes]}
    )
    model = rigid_model(robot)
    data = mujoco.MjData(model)
    motion = random_motion(robot)
    regressor = Regressor(robot.model_copy(update={"physics": []}))
    ours = regressor.evaluate(motion) @ regressor.described + regressor.known_torque(motion)
    for torque, q, v, a in zip(ours, motion.position, motion.velocity, motion.acceleration, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(torque, data.qfrc_inverse, atol=1e-9 * np.abs(ours).max())


def test_entries_add_the_laws_of_their_effects(kr90: Robot) -> None:
    """Columns of entries times described values are the torque laws, linear or not, of the whole description."""
    data = kr90.model_dump(mode="json")
    data["physics"] += [
        {"effect": "asymmetric_friction", "site": "joint1", "torque_difference": 12.0, "viscous_difference": -30.0},
        {"effect": "stribeck_friction", "site": "joint2", "static_excess": 80.0, "velocity": 0.2},
        {"effect": "cable_stiffness", "site": "joint3", "stiffness": 40.0, "rest": -0.7},
        {"effect": "torque_ripple", "site": "joint1", "amplitude": 9.0, "order": 7.0, "phase": 0.4},
        {"effect": "hysteresis", "site": "joint2.z", "stiffness": [2e3, 5e2], "yield_torque": [30.0, 60.0]},
        {"effect": "load_dependent_friction", "site": "joint2", "coefficient": 0.02},
        {"effect": "payload", "site": "flange", "mass": 25.0, "com": [1.7, 0.1, -0.1], "inertia": [1.0, 2.0, 2.5]},
    ]
    robot = parse_robot(data)
    motion = random_motion(robot)
    regressor = Regressor(robot)
    ours = regressor.evaluate(motion) @ regressor.described + regressor.known_torque(motion)
    theirs = inverse_dynamics(robot, motion)
    np.testing.assert_allclose(ours, theirs, atol=1e-8 * np.abs(theirs).max())  # motors weigh 1 mg in MuJoCo
    back = regressor.robot_with(regressor.described)
    np.testing.assert_allclose(inverse_dynamics(back, motion), theirs, atol=1e-8 * np.abs(theirs).max())


def test_numbers_that_no_robot_has_are_told_as_the_calculation_s(kr90: Robot) -> None:
    regressor = Regressor(kr90)
    with pytest.raises(NumericalError, match=r"links\[0\].mass: what the log asks for is no robot .*at most 1e\+06"):
        regressor.robot_with(regressor.described * 1e6)


def test_a_coupled_motor_turns_with_both_axes(kr90: Robot) -> None:
    """θ = C q and power is the same in both coordinates: τ_qᵀ q̇ = τ_θᵀ θ̇."""
    drives = [drive.model_copy() for drive in kr90.drives]
    drives[2] = drives[2].model_copy(update={"coupling": {"joint2": 0.5}})
    C = kr90.model_copy(update={"drives": drives}).coupling
    np.testing.assert_array_equal(C, [[1, 0, 0], [0, 1, 0], [0, 0.5, 1]])


def test_a_coupled_drive_s_friction_loads_both_axes(kr90: Robot) -> None:
    """F sgn θ̇₃ at the motor is as much on axis 3 and half of it on axis 2: in dynamics, columns and a replay."""
    drives = [drive.model_copy() for drive in kr90.drives]
    drives[2] = drives[2].model_copy(update={"coupling": {"joint2": 0.5}})
    bare = kr90.model_copy(update={"drives": drives, "physics": []})
    dry = [Entry(effect="coulomb_friction", site="joint3", torque=30.0)]
    robot = bare.model_copy(
        update={"physics": [*dry, Entry(effect="viscous_friction", site="joint3", coefficient=20.0)]}
    )
    t = np.linspace(0, 2, 401)
    q = np.deg2rad([0.0, 60.0, -80.0]) + 0.2 * np.sin(2 * np.pi * np.outer(t, [0.5, 0.7, 1.1]))
    motion = motion_of(MotionRun("run", t, q, 200.0))
    speed = motion.velocity[:, 2] + 0.5 * motion.velocity[:, 1]
    at_motor = 30.0 * np.sign(speed) + 20.0 * speed
    friction = inverse_dynamics(robot, motion) - inverse_dynamics(bare, motion)
    np.testing.assert_allclose(friction, np.outer(at_motor, [0, 0.5, 1]), atol=1e-9)
    regressor = Regressor(robot)
    matrix = regressor.evaluate(motion) @ regressor.described
    np.testing.assert_allclose(matrix, inverse_dynamics(robot, motion), atol=1e-6 * np.abs(matrix).max())
    drives_bear = regressor.evaluate(motion.coupled(robot).of_drives) @ regressor.described  # as a log holds them
    np.testing.assert_allclose(drives_bear @ robot.coupling, matrix, atol=1e-9 * np.abs(matrix).max())
    moved = replay(robot, MotionRun("run", t, q, 200.0)).torque @ robot.coupling
    still = replay(bare, MotionRun("run", t, q, 200.0)).torque @ robot.coupling
    stepped = moved - still  # springs ring where the motor turns back
    assert np.corrcoef(stepped[:, 2], friction[:, 2])[0, 1] > 0.99
    assert np.corrcoef(stepped[:, 1], friction[:, 1])[0, 1] > 0.95
    assert stepped[:, 1] @ friction[:, 2] == pytest.approx(0.5 * friction[:, 2] @ friction[:, 2], rel=0.03)


def test_ten_parameters_and_a_body_are_the_same_thing() -> None:
    """Shifting to the frame's origin and back; the pseudo-inertia of two masses is their second moment."""
    mass, com, inertia = 3.0, np.array([0.1, -0.2, 0.4]), np.diag([0.2, 0.3, 0.4])
    back = body_of(inertial_vector(mass, com, inertia))
    assert back[0] == mass
    np.testing.assert_allclose(back[1], com, atol=1e-15)
    np.testing.assert_allclose(back[2], inertia, atol=1e-14)
    points = np.array([[0.3, 0.1, -0.2, 1.0], [-0.5, 0.2, 0.7, 1.0]])
    weights = np.array([2.0, 5.0])
    moment = (points * weights[:, None]).T @ points
    vector = sum(inertial_vector(w, p[:3], np.zeros((3, 3))) for w, p in zip(weights, points, strict=True))
    np.testing.assert_allclose(pseudo_inertia(np.asarray(vector)), moment, atol=1e-13)


def test_what_has_no_column_goes_through_the_gears_too(kr90: Robot) -> None:
    """Links, rotor masses and a payload are MuJoCo's torque of the rigid robot, which friction may follow."""
    payload = Entry(effect="payload", site="flange", mass=30.0, com=[0.1, 0.0, 0.2])
    drives = [drive.model_copy(update={"rotor_mass": 20.0}) for drive in kr90.drives]
    robot = kr90.model_copy(update={"drives": drives, "physics": [payload]})
    motion, regressor = random_motion(robot), Regressor(robot)
    links = regressor.described[regressor.select("link")] + regressor.weights
    ours = link_regressor(robot, motion) @ links
    # a rotor's mass is a small ball to MuJoCo and a point here
    np.testing.assert_allclose(ours, rigid_torque(robot, motion), atol=1e-4 * np.abs(ours).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_torque_of_links_at_once_is_that_by_columns(name: str | Path) -> None:
    """Outward and back, over hinges and slides; the columns are Pinocchio's."""
    robot = load_robot(name)
    motion = random_motion(robot)
    links = np.random.default_rng(0).normal(size=(robot.axis_count, 10))
    expected = link_regressor(robot, motion) @ links.ravel()
    np.testing.assert_allclose(link_torque(robot, motion, links), expected, atol=1e-9)
