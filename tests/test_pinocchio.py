"""The twin's MuJoCo models against Pinocchio, a rigid-body library that shares no code with MuJoCo."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from twin.model.linear import linearise, mass_matrix
from twin.robot.description import Robot, load_robot
from twin.robot.frames import inertia_matrix, matrix_of
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec

DATA = Path(__file__).parent / "data"
TX40 = Path(os.environ.get("TWIN_TX40_URDF", Path(__file__).parents[2] / "shared" / "data" / "tx40" / "tx40.urdf"))

needs_tx40 = pytest.mark.skipif(not TX40.is_file(), reason="no TX40 URDF: set TWIN_TX40_URDF to its path")
URDFS = [DATA / "arm6.urdf", DATA / "arm_linear.urdf", pytest.param(TX40, marks=needs_tx40)]
TIPS = ("tcp", "gripper", "tool0")  # of these three files


def rigid_model(robot: Robot) -> mujoco.MjModel:
    """The twin's model of the bare chain: no friction, rigid joints, and motors without even a token mass."""
    spec = build_spec(assemble(robot.model_copy(update={"physics": []}), middle(robot), drives="free"))
    for i in range(robot.axis_count):
        motor = spec.body(f"motor{i + 1}")
        motor.mass, motor.inertia = 0.0, np.zeros(3)
    return spec.compile()


def middle(robot: Robot) -> np.ndarray:
    return np.array([np.mean(a.limits.position) if a.limits and a.limits.position else 0.0 for a in robot.axes])


def random_positions(robot: Robot, rng: np.random.Generator) -> np.ndarray:
    limits = [a.limits.position if a.limits and a.limits.position else (-np.pi, np.pi) for a in robot.axes]
    return np.array([rng.uniform(low, high) for low, high in limits])


def configuration(model: pin.Model, q: np.ndarray) -> np.ndarray:
    return pin.integrate(model, pin.neutral(model), q)  # a continuous joint is a point on the circle there


def from_urdf(path: Path, robot: Robot) -> pin.Model:
    """Pinocchio's own reading of the URDF; with the inertia the twin states for a link that has none."""
    model = pin.buildModelFromUrdf(str(path))
    for joint, link in zip(list(model.inertias)[1:], robot.links, strict=True):
        if not joint.inertia.any():
            joint.inertia = inertia_matrix(link.inertia)
    return model


@pytest.mark.parametrize("path", URDFS, ids=lambda p: p.stem)
def test_an_imported_robot_has_the_dynamics_pinocchio_reads_from_the_urdf(path: Path) -> None:
    """Mass matrix, gravity and velocity torques and inverse dynamics agree to 1e-9 in any configuration."""
    robot = load_robot(path)
    model = rigid_model(robot)
    data = mujoco.MjData(model)
    reference = from_urdf(path, robot)
    workspace = reference.createData()
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, v, a = random_positions(robot, rng), rng.normal(0, 1.5, robot.axis_count), rng.normal(0, 4, robot.axis_count)
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        at = configuration(reference, q)
        M = pin.crba(reference, workspace, at)
        np.testing.assert_allclose(mass_matrix(model, data), M, atol=1e-9 * np.abs(M).max())
        for ours, theirs in (
            (data.qfrc_bias, pin.nonLinearEffects(reference, workspace, at, v)),
            (data.qfrc_inverse, pin.rnea(reference, workspace, at, v, a)),
        ):
            np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("path", URDFS, ids=lambda p: p.stem)
def test_an_imported_robot_stands_where_pinocchio_puts_it(path: Path) -> None:
    """The centre of mass of every link and the pose of the flange agree to 1e-10 m."""
    robot = load_robot(path)
    model = rigid_model(robot)
    data = mujoco.MjData(model)
    reference = from_urdf(path, robot)
    workspace = reference.createData()
    tip = next(reference.getFrameId(name) for name in TIPS if reference.existFrame(name))
    rng = np.random.default_rng(2)
    for _ in range(20):
        q = random_positions(robot, rng)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        pin.forwardKinematics(reference, workspace, configuration(reference, q))
        pin.updateFramePlacements(reference, workspace)
        for i in range(robot.axis_count):
            lever = workspace.oMi[i + 1].act(reference.inertias[i + 1].lever)
            np.testing.assert_allclose(data.body(f"link{i + 1}").xipos, lever, atol=1e-10)
        last = data.body(f"link{robot.axis_count}")
        rotation = last.xmat.reshape(3, 3)
        np.testing.assert_allclose(
            last.xpos + rotation @ robot.flange.position, workspace.oMf[tip].translation, atol=1e-10
        )
        np.testing.assert_allclose(
            rotation @ matrix_of(np.array(robot.flange.quaternion)), workspace.oMf[tip].rotation, atol=1e-10
        )


def elastic_chain(robot: Robot, q: np.ndarray) -> tuple[pin.Model, list[str]]:
    """A commanded posture with three coincident hinges z, x, y per axis, built from the description's numbers alone."""
    model = pin.Model()
    model.gravity.linear = np.array(robot.gravity)
    w, x, y, z = robot.base.quaternion
    parent, place = 0, pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(robot.base.position))
    names = []
    for i, (link, axis) in enumerate(zip(robot.links, robot.axes, strict=True)):
        turn, screw = pin.utils.rotate("x", np.deg2rad(axis.alpha_deg)), np.deg2rad(axis.theta_deg) + q[i]
        place = place * pin.SE3(turn, np.array([axis.a, 0, 0]))
        place = place * pin.SE3(pin.utils.rotate("z", screw), np.array([0, 0, axis.d]))
        for letter, hinge in (("z", pin.JointModelRZ()), ("x", pin.JointModelRX()), ("y", pin.JointModelRY())):
            names.append(f"joint{i + 1}.{letter}")
            parent = model.addJoint(parent, hinge, place, names[-1])
            place = pin.SE3.Identity()
        model.appendBodyToJoint(
            parent, pin.Inertia(link.mass, np.array(link.com), inertia_matrix(link.inertia)), pin.SE3.Identity()
        )
    return model, names


@pytest.mark.parametrize("q_deg", [(0, 70, -100), (0, 135, -100), (0, 135, -140), (37, 51, -23)])
def test_the_kr90_has_pinocchios_mass_matrix_of_nine_elastic_coordinates(q_deg: tuple[float, ...]) -> None:
    robot = load_robot("kr90")
    q = np.deg2rad(q_deg)
    reference, names = elastic_chain(robot, q)
    expected = pin.crba(reference, reference.createData(), np.zeros(9))
    linear = linearise(assemble(robot, q))
    order = [names.index(name) for name in linear.coordinates]
    assert sorted(order) == list(range(9))
    np.testing.assert_allclose(linear.M, expected[np.ix_(order, order)], rtol=1e-9, atol=1e-9 * expected.max())


@pytest.mark.parametrize("visual", [False, True])
def test_the_kr90_needs_pinocchios_torques_to_hold_still(visual: bool) -> None:
    """Gravity loads each of the nine hinges as in Pinocchio, whether or not meshes are shown; nothing then moves."""
    robot = load_robot("kr90")
    q = np.deg2rad([20, 70, -100])
    reference, names = elastic_chain(robot, q)
    expected = pin.computeGeneralizedGravity(reference, reference.createData(), np.zeros(9))
    model = build_spec(assemble(robot, q), visual=visual).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bias = [data.qfrc_bias[model.joint(name).dofadr[0]] for name in names]
    np.testing.assert_allclose(bias, expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(data.qacc, 0, atol=1e-9)
