"""Measured mode shapes carried over to the whole robot, so that they can be drawn and animated on its links."""

from collections.abc import Sequence

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import Channels
from twin.measure.modal import ModalResult
from twin.model.linear import linearise
from twin.model.modes import Modes
from twin.robot.description import Robot, TestPoint
from twin.robot.mechanism import Mechanism, assemble


def with_channels(robot: Robot, *channels: Channels) -> Robot:
    """The robot with the channels of a recording as its test points."""
    points: dict[str, TestPoint] = {}
    for side in channels:
        for label, body, position, direction in zip(side.label, side.body, side.position, side.direction, strict=True):
            points[label] = TestPoint(label=label, body=body, position=tuple(position), direction=tuple(direction))
    return robot.model_copy(update={"test_points": list(points.values()), "accelerometers": []})


def channels_of(robot: Robot, labels: Sequence[str]) -> Channels:
    """Test points of a robot as channels."""
    points = {point.label: point for point in robot.test_points}
    chosen = [points[label] for label in labels]
    return Channels(
        tuple(labels),
        tuple(point.body for point in chosen),
        np.array([point.position for point in chosen]).reshape(-1, 3),
        np.array([point.direction for point in chosen]).reshape(-1, 3),
    )


def expand(
    robot: Robot, q: np.ndarray, roving: Channels, shapes: np.ndarray, pole: Sequence[complex] | np.ndarray
) -> tuple[Mechanism, Modes]:
    """Shapes at test points as deflections of the robot's elastic joints, by least squares.

    A small ridge (1e-6 of the mean square of the Jacobian) holds deflections that no point sees.

    Args:
        robot: with elastic joints.
        q: (n,) posture, rad (m).
        roving: the np channels that carry the shapes.
        shapes: (nm, np) complex.
        pole: (nm,) rad/s.

    Returns:
        The mechanism in that posture, with the channels as its points, and the expanded modes.
    """
    mechanism = assemble(with_channels(robot, roving), q)
    linear = linearise(mechanism)
    J = linear.jacobian(roving.label)
    ridge = 1e-6 * np.trace(J.T @ J) / max(1, J.shape[1])
    deflection = np.linalg.solve(J.T @ J + ridge * np.eye(J.shape[1]), J.T @ shapes.T)
    energy = linear.spring[:, None] * np.abs(deflection) ** 2
    share = energy / np.maximum(energy.sum(axis=0), np.finfo(float).tiny)
    return mechanism, Modes(np.asarray(pole), deflection, share, linear)


def on_robot(robot: Robot, result: ModalResult, roving: Channels) -> tuple[Mechanism, Modes]:
    """The measured shapes of one posture on a robot.

    Raises:
        InputError: the robot cannot carry them: other axes, points on bodies it does not have, no spring, its limits.
    """
    known = {"base", *(f"link{i + 1}" for i in range(robot.axis_count))}
    missing = ""
    if len(result.q_deg) != robot.axis_count:
        missing = f"{len(result.q_deg)} axis positions, robot {robot.name} has {robot.axis_count}"
    elif unknown := set(roving.body) - known:
        missing = f"points on {', '.join(sorted(unknown))}, which robot {robot.name} does not have"
    elif all(axis.stiffness is None for axis in robot.axes):
        missing = f"robot {robot.name} has no elastic axis"
    if missing:
        raise InputError(result.name, "", missing)
    q = robot.check_posture(robot.angles(result.q_deg), result.name, "q_deg")
    ratio = np.array([mode.damping_percent / 100 for mode in result.modes])
    omega = 2 * np.pi * np.array([mode.frequency_hz for mode in result.modes])
    pole = omega * (-ratio + 1j * np.sqrt(1 - ratio**2))
    return expand(robot, q, roving, result.shapes, pole)
