"""Where the tool is, and the joint positions that bring it there: forward and inverse kinematics over many postures.

Up to four axes the position of the tool is asked for, from five on the direction of its axis too. What is left free is
swept, or stays as near to the start as it can. That is the turn about the tool's axis from six axes on, and what a
seventh axis adds. The solver is that of Levenberg and Marquardt with the damping of Sugihara (IEEE Trans. Robotics 27
(2011) 984–991, doi:10.1109/TRO.2011.2148230). It ends near the target also where the target is out of reach.
"""

from dataclasses import dataclass

import numpy as np

from twin.errors import InputError
from twin.robot.description import Robot
from twin.robot.frames import axis_placement, matrix_of

REACHED_M = 1e-6  # and rad: nearer than this the target is reached
DAMPING = 1e-9  # beside half the squared error, m²
ROUNDS = 60
STARTS = 24  # where the first does not lead there
LEAST_AXES = 5  # that can hold the tool's axis in a direction
LARGEST_TURN = 0.5  # rad (m) in a round


@dataclass(frozen=True)
class ToolPlace:
    """The tool on the robot: ``position`` (3,) of its tip, m, and unit ``axis`` (3,), both in the last link's frame."""

    position: np.ndarray
    axis: np.ndarray


@dataclass(frozen=True)
class Reached:
    """Joint positions (N, n), rad (m); how far from the target the tool is, m (and rad); whether it is there."""

    q: np.ndarray
    distance: np.ndarray
    reached: np.ndarray


def tool_frames(robot: Robot, q: np.ndarray, tool: ToolPlace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tip (…, 3), rotation (…, 3, 3) of the last link and Jacobian (…, 6, n; linear above angular), in the base frame.

    Args:
        q: (…, n) joint positions, rad (m).
    """
    q = np.asarray(q, float) + robot.encoder_zeros
    lead = q.shape[:-1]
    base = matrix_of(np.array(robot.base.quaternion))
    turn = np.broadcast_to(base, (*lead, 3, 3))
    place = np.broadcast_to(np.array(robot.base.position), (*lead, 3))
    axes, points = [], []
    for i, axis in enumerate(robot.axes):
        position, quaternion = axis_placement(axis, 0.0)
        place = place + turn @ position
        turn = turn @ matrix_of(quaternion)
        axes.append(turn[..., 2])
        if axis.type == "prismatic":
            place = place + q[..., i, None] * turn[..., 2]
        else:
            c, s = np.cos(q[..., i, None]), np.sin(q[..., i, None])
            x, y = turn[..., 0], turn[..., 1]
            turn = np.stack([c * x + s * y, c * y - s * x, turn[..., 2]], axis=-1)
        points.append(place)
    tip = place + turn @ tool.position
    jacobian = np.zeros((*lead, 6, robot.axis_count))
    for i, (z, point) in enumerate(zip(axes, points, strict=True)):
        if robot.axes[i].type == "prismatic":
            jacobian[..., :3, i] = z
        else:
            jacobian[..., :3, i] = np.cross(z, tip - point)
            jacobian[..., 3:, i] = z
    return tip, turn, jacobian


def inverse_kinematics(
    robot: Robot,
    position: np.ndarray,
    tool: ToolPlace,
    *,
    axis: np.ndarray | None = None,
    turn: np.ndarray | None = None,
    start: np.ndarray | None = None,
    seed: int = 0,
) -> Reached:
    """Joint positions that bring the tool's tip to positions, within the axes' limits.

    Args:
        position: (N, 3) of the tip, m, base frame.
        tool: where tip and axis are on the last link.
        axis: (3,) or (N, 3) unit directions of the tool's axis in the base frame; only robots of five axes or more
            can hold one.
        turn: (N,) rad about the tool's axis, from :func:`upright_frame`; only with six axes or more.
        start: (n,) posture that solutions should be near, rad (m); the middle by default. Others are tried
            only for targets that are not reached from it.
        seed: of the other starts.

    Raises:
        InputError: a direction asked of a robot that cannot hold one.
    """
    position = np.atleast_2d(np.asarray(position, float))
    count, n = len(position), robot.axis_count
    if axis is not None and n < LEAST_AXES:
        raise InputError(robot.name, "axis", f"a robot of {n} axes cannot hold the tool's axis: leave it out")
    target = _targets(position, axis, turn, tool)
    low, high = limits(robot)
    first = 0.5 * (low + high) if start is None else np.asarray(start, float)
    q = np.clip(np.tile(first, (count, 1)), low, high)
    q, distance = _descend(robot, q, target, tool, low, high)
    left = np.flatnonzero(distance > REACHED_M)
    if left.size:
        rng = np.random.default_rng(seed)
        others = rng.uniform(low, high, (STARTS, n))
        others = others[np.argsort(np.abs(others - first).sum(axis=1))]
        for other in others:
            tried, error = _descend(robot, np.tile(other, (left.size, 1)), _some(target, left), tool, low, high)
            better = error < distance[left] - REACHED_M
            q[left[better]], distance[left[better]] = tried[better], error[better]
            left = left[distance[left] > REACHED_M]
            if not left.size:
                break
    return Reached(q, distance, distance <= REACHED_M)


Target = tuple[np.ndarray, np.ndarray | None, np.ndarray | None]
"""Tip (N, 3), the tool's axis (N, 3), and where the direction beside it points (N, 3)."""


def _targets(position: np.ndarray, axis: np.ndarray | None, turn: np.ndarray | None, tool: ToolPlace) -> Target:
    if axis is None:
        return position, None, None
    axis = np.broadcast_to(np.asarray(axis, float), position.shape)
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    if turn is None:
        return position, axis, None
    frame = upright_frame(axis)
    turn = np.broadcast_to(turn, len(position))[:, None]
    return position, axis, np.cos(turn) * frame[..., 0] + np.sin(turn) * frame[..., 1]


def upright_frame(axis: np.ndarray) -> np.ndarray:
    """Rotations (…, 3, 3) whose z is a direction (…, 3) and whose x lies as near to the base frame's x as it can."""
    z = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    x, y = np.broadcast_to([1.0, 0.0, 0.0], z.shape), np.broadcast_to([0.0, 1.0, 0.0], z.shape)
    guide = np.where(np.abs(z[..., :1]) < 0.9, x, y)
    x = guide - (guide * z).sum(axis=-1, keepdims=True) * z
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def limits(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest joint positions (n,); a turn to both sides, or a metre, where none are described."""
    found = [
        axis.limits.position if axis.limits and axis.limits.position else
        ((-np.pi, np.pi) if axis.type == "revolute" else (-1.0, 1.0))
        for axis in robot.axes
    ]  # fmt: skip
    low, high = np.array(found, float).T
    return low, high


def _some(target: Target, rows: np.ndarray) -> Target:
    position, axis, beside = target
    return position[rows], None if axis is None else axis[rows], None if beside is None else beside[rows]


def _descend(
    robot: Robot, q: np.ndarray, target: Target, tool: ToolPlace, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (N, n) at the end, and distances (N,) from the target."""
    q, distance = q.copy(), np.full(len(q), np.inf)
    best = q.copy()
    active = np.arange(len(q))
    for _ in range(ROUNDS):
        error, jacobian = _error(robot, q[active], _some(target, active), tool)
        size = np.linalg.norm(error, axis=1)
        nearer = size < distance[active]
        best[active[nearer]], distance[active[nearer]] = q[active[nearer]], size[nearer]
        going = size > 1e-12
        active, error, jacobian = active[going], error[going], jacobian[going]
        if not active.size:
            break
        # joints at their limits that would be pushed beyond them stay
        slope = np.einsum("nij,ni->nj", jacobian, error)
        stuck = ((q[active] <= low) & (slope < 0)) | ((q[active] >= high) & (slope > 0))
        jacobian = np.where(stuck[:, None, :], 0.0, jacobian)
        damping = 0.5 * np.sum(error**2, axis=1) + DAMPING * np.minimum(1.0, np.sum(error**2, axis=1))
        normal = jacobian.swapaxes(1, 2) @ jacobian + (damping + 1e-14)[:, None, None] * np.eye(q.shape[1])
        step = np.linalg.solve(normal, np.einsum("nij,ni->nj", jacobian, error)[..., None])[..., 0]
        step *= np.minimum(1.0, LARGEST_TURN / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        q[active] = np.clip(q[active] + step, low, high)
    return best, distance


def _error(robot: Robot, q: np.ndarray, target: Target, tool: ToolPlace) -> tuple[np.ndarray, np.ndarray]:
    """What is missing to the target (N, m), and its Jacobian (N, m, n); turns count one metre a radian."""
    position, axis, beside = target
    tip, turn, jacobian = tool_frames(robot, q, tool)
    rows, parts = [position - tip], [jacobian[:, :3]]
    frame = upright_frame(tool.axis)
    for wanted, own in ((axis, frame[:, 2]), (beside, frame[:, 0])):
        if wanted is not None:
            has = turn @ own
            rows.append(wanted - has)
            # d(has) = ω × has
            parts.append(np.cross(jacobian[:, 3:].swapaxes(1, 2), has[:, None, :]).swapaxes(1, 2))
    return np.concatenate(rows, axis=1), np.concatenate(parts, axis=1)
