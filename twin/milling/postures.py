"""The dynamics at the tool's tip in many postures at once: what :mod:`twin.milling.tool_point` makes of one.

Matrices come in closed form from :mod:`twin.model.sensitivity` (MuJoCo's within 1e-9), eigenvalue problems are
solved side by side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.identify.recorded import without_limits
from twin.milling.cut import Cut
from twin.milling.tool_point import ToolModes, clamped_modes, coupled, with_tool
from twin.model.sensitivity import structures
from twin.robot.description import Robot
from twin.robot.inverse_kinematics import ToolPlace
from twin.robot.mechanism import assemble_all

FASTEST_RAD_S = 6e4  # 10 kHz: above what tools and spindles vibrate at
BLOCK = 500  # postures whose arrays stay in the cache


@dataclass(frozen=True)
class Tips:
    """The tip in N postures, base frame.

    Attributes:
        modes: poles (N, nm) and shapes (N, nm, 3).
        position: (N, 3) m; ``axis`` (N, 3) unit vectors flange → tip.
        compliance: (N, 3, 3) static, m/N.
    """

    modes: ToolModes
    position: np.ndarray
    axis: np.ndarray
    compliance: np.ndarray


def tool_place(robot: Robot, cut: Cut) -> ToolPlace:
    """The tool's tip and axis on the last link, for inverse kinematics."""
    return ToolPlace(cut.tool.tip(robot), cut.tool.axis(robot))


def tips(robot: Robot, q: np.ndarray, cut: Cut, brakes: str | None = "on") -> Tips:
    """Modes of the robot with its tool in postures q (N, n), rad (m); a postures' limits are not looked at."""
    equipped = without_limits(with_tool(robot, cut))
    parts = [_block(equipped, q[k : k + BLOCK], cut, brakes) for k in range(0, len(q), BLOCK)]
    most = max(part.modes.pole.shape[1] for part in parts)
    modes = [_padded(part.modes, most) for part in parts]
    return Tips(
        ToolModes(np.concatenate([m.pole for m in modes]), np.concatenate([m.shape for m in modes])),
        np.concatenate([part.position for part in parts]),
        np.concatenate([part.axis for part in parts]),
        np.concatenate([part.compliance for part in parts]),
    )


def _block(robot: Robot, q: np.ndarray, cut: Cut, brakes: str | None) -> Tips:
    mechanisms = assemble_all(robot, list(q), brakes="off" if brakes == "off" else "on")
    models = structures(mechanisms)
    first, tip = models[0], cut.tool.tip(robot)
    link = f"link{robot.axis_count}"
    carrier = first.mechanism.carrier(link, tip)
    body, own = first.bodies[carrier], first.bodies[link]
    turn = np.array([m.rotation[body] for m in models])
    place = np.array([m.origin[body] for m in models]) + turn @ (tip - first.mechanism.offset(carrier))
    axis = np.array([m.rotation[own] for m in models]) @ cut.tool.axis(robot)
    screw = np.array([m.screw for m in models])
    moved = screw[..., 3:] + np.cross(screw[..., :3], place[:, None, :])
    jacobian = (moved * first.path[body][:, None]).swapaxes(1, 2)
    M, K = (np.array([getattr(m, name) for m in models]) for name in ("M", "K"))
    C, loss, integral = first.C, first.loss, first.integral
    if cut.tool.modes or cut.tool.frf:
        M, C, K, jacobian = _with_own_modes(M, C, K, jacobian, axis, cut)
        pad = ((0, M.shape[-1] - len(loss)),) * 2
        loss, integral = np.pad(loss, pad), np.pad(integral, pad)
    modes = batched_modes(M, C, K, jacobian, loss, integral)
    compliance = jacobian @ np.linalg.solve(K, jacobian.swapaxes(1, 2))
    return Tips(modes, place, axis, compliance)


def _with_own_modes(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, jacobian: np.ndarray, axis: np.ndarray, cut: Cut
) -> tuple[np.ndarray, ...]:
    """Matrices with the modes of the clamped tool, posture by posture."""
    found = []
    for k, direction in enumerate(axis):
        modes = clamped_modes(cut, direction)
        assert modes is not None
        found.append(coupled(M[k], C, K[k], jacobian[k], *modes, source=cut.source))
    return tuple(np.array(part) for part in zip(*found, strict=True))


def batched_modes(
    M: np.ndarray, C: np.ndarray, K: np.ndarray, jacobian: np.ndarray, loss: np.ndarray, integral: np.ndarray
) -> ToolModes:
    """All poles and shapes at a point of N systems, :func:`twin.milling.tool_point.matrix_modes` of each.

    Args:
        M, K: (N, nv, nv); C (nv, nv) or (N, nv, nv); ``jacobian`` (N, 3, nv); ``loss`` and ``integral`` (nv, nv).
    """
    nv, count = M.shape[-1], len(M)
    kept = np.flatnonzero(integral.any(axis=0))
    forces = [K + 1j * loss if loss.any() else K, np.broadcast_to(C, M.shape)]
    forces.append(np.broadcast_to(integral[:, kept], (count, nv, len(kept))))
    drift = -np.linalg.solve(M, np.concatenate(forces, axis=2))
    A = np.zeros((count, 2 * nv + len(kept), 2 * nv + len(kept)), drift.dtype)
    A[:, :nv, nv : 2 * nv] = np.eye(nv)
    A[:, nv : 2 * nv] = drift
    A[:, 2 * nv + np.arange(len(kept)), kept] = 1.0
    pole, vector = np.linalg.eig(A)
    pole, vector = pole.astype(complex), vector.astype(complex)
    size = np.abs(pole)
    real = np.abs(pole.imag) <= 1e-9 * size
    used = (pole.imag > 0) | real
    most = int(used.sum(axis=1).max())
    order = np.argsort(np.where(used, size, np.inf), axis=1, kind="stable")[:, :most]
    pole, real, used = (np.take_along_axis(array, order, axis=1) for array in (pole, real, used))
    v = np.take_along_axis(vector[:, :nv], order[:, None, :], axis=2)
    slope = (v * (2 * pole[:, None, :] * (M @ v) + C @ v)).sum(axis=1)
    if len(kept):
        slope = slope - (v * (integral @ v)).sum(axis=1) / pole**2
    scale = np.where(used, 1 / np.sqrt(slope * np.where(real, 2, 1)), 0)
    shape = (jacobian @ v * scale[:, None, :]).swapaxes(1, 2)
    return ToolModes(np.where(used, np.where(real, pole.real, pole), -1.0), shape)


def _padded(modes: ToolModes, count: int) -> ToolModes:
    """With modes that do nothing up to ``count`` of them."""
    lack = count - modes.pole.shape[1]
    if not lack:
        return modes
    pole = np.pad(modes.pole, ((0, 0), (0, lack)), constant_values=-1.0)
    return ToolModes(pole, np.pad(modes.shape, ((0, 0), (0, lack), (0, 0))))


def without_fast(modes: ToolModes, fastest_rad_s: float = FASTEST_RAD_S) -> ToolModes:
    """Modes (N, nm) with those faster than a rate as static compliance: they follow a cut at once.

    A damper that a fit has let run away, or a body without inertia, makes poles of any size, on which a spectral
    method would spend its nodes.
    """
    quick = np.abs(modes.pole) > fastest_rad_s
    if not quick.any():
        return modes
    part = np.where(quick[..., None], modes.shape, 0)
    static = 2 * np.einsum("...ki,...kj,...k->...ij", part, part, -1 / modes.pole).real
    if modes.residual is not None:
        static = static + modes.residual
    return ToolModes(np.where(quick, -1.0, modes.pole), np.where(quick[..., None], 0, modes.shape), static)


def stacked(parts: Sequence[Tips]) -> Tips:
    """Several robots' tips in the same postures, robots on a new first axis."""
    most = max(part.modes.pole.shape[1] for part in parts)
    modes = [_padded(part.modes, most) for part in parts]
    return Tips(
        ToolModes(np.array([m.pole for m in modes]), np.array([m.shape for m in modes])),
        np.array([part.position for part in parts]),
        np.array([part.axis for part in parts]),
        np.array([part.compliance for part in parts]),
    )
