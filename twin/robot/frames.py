"""Frames: modified (Craig) Denavit–Hartenberg placement, quaternions (w, x, y, z), inertia as six numbers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from twin.robot.description import Axis, Robot

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def rotation_z(angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about z by ``angle`` rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def axis_placement(axis: "Axis", q: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and quaternion (4,) of frame i in frame i−1: Rx(α) Tx(a) Rz(θ) Tz(d).

    Craig, Introduction to Robotics; ``q`` (rad or m) is added to θ of a revolute, to d of a prismatic axis.
    """
    alpha, theta, d = np.deg2rad(axis.alpha_deg), np.deg2rad(axis.theta_deg), axis.d
    if axis.type == "prismatic":
        d += q
    else:
        theta += q
    position = np.array([axis.a, -np.sin(alpha) * d, np.cos(alpha) * d])
    ca, sa, ct, st = np.cos(alpha / 2), np.sin(alpha / 2), np.cos(theta / 2), np.sin(theta / 2)
    return position, np.array([ca * ct, sa * ct, -sa * st, ca * st])


def between_links(robot: "Robot", q: np.ndarray, start: int, end: int, point: np.ndarray) -> np.ndarray:
    """Where a point (3,) m of one link's frame is in another's, the robot at angles ``q`` (n,); links from zero."""
    for i in range(start, end, -1):
        position, quaternion = axis_placement(robot.axes[i], float(q[i]))
        point = position + matrix_of(quaternion) @ point
    for i in range(start + 1, end + 1):
        position, quaternion = axis_placement(robot.axes[i], float(q[i]))
        point = matrix_of(quaternion).T @ (point - position)
    return point


def matrix_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (…, 3, 3) of unit quaternions (…, 4), (w, x, y, z)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    out = np.empty((*quaternion.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return out


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z) with w ≥ 0 of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)


def rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector (3,) turned by a unit quaternion."""
    return matrix_of(quaternion) @ vector


def inertia_matrix(six: Sequence[float]) -> np.ndarray:
    """Inertia (3, 3) from (xx, yy, zz, xy, xz, yz); products are matrix elements, I_xy = −Σ m x y."""
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], float)


def nearest_body(inertia: np.ndarray, least: float = 0.0) -> np.ndarray:
    """The inertia (3, 3) itself where a body can have it, else the nearest in second moments ∫x²dm.

    ``least``: what is put in place of a negative moment, as a share of the sum of the others.
    """
    moment, basis = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    if moment[0] >= 0:
        return inertia
    second = (basis * np.maximum(moment, least * np.maximum(moment, 0).sum())) @ basis.T
    return np.asarray(np.trace(second) * np.eye(3) - second)


def inertia_six(matrix: np.ndarray) -> list[float]:
    """(xx, yy, zz, xy, xz, yz) of an inertia matrix (3, 3)."""
    return [float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
