"""The dynamics at the tool's tip in many postures at once: what :mod:`twin.milling.tool_point` makes of one.

Matrices come in closed form from :mod:`twin.model.sensitivity` (MuJoCo's within 1e-9), eigenvalue problems are
solved side by side.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin.milling.cut import Cut
from twin.milling.tool_point import ToolModes, clamped_modes, coupled, with_tool
from twin.model.modes import residues
from twin.model.recorded import without_limits
from twin.model.sensitivity import point_jacobians, structures
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
    return _joined(parts, np.concatenate)


def _block(robot: Robot, q: np.ndarray, cut: Cut, brakes: str | None) -> Tips:
    mechanisms = assemble_all(robot, list(q), brakes="off" if brakes == "off" else "on")
    models = structures(mechanisms)
    first, link = models[0], f"link{robot.axis_count}"
    place, jacobian = point_jacobians(models, link, cut.tool.tip(robot))
    axis = np.array([m.rotation[first.bodies[link]] for m in models]) @ cut.tool.axis(robot)
    M, K = (np.array([getattr(m, name) for m in models]) for name in ("M", "K"))
    C, loss, integral = first.C, first.loss, first.integral
    if cut.tool.modes or cut.tool.frf:
        M, C, K, jacobian = _with_own_modes(M, C, K, jacobian, axis, cut)
        pad = ((0, M.shape[-1] - len(loss)),) * 2
        loss, integral = np.pad(loss, pad), np.pad(integral, pad)
    modes = ToolModes(*residues(M, C, K, jacobian, loss, integral))
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


def _joined(parts: Sequence[Tips], join: Callable[[list[np.ndarray]], np.ndarray]) -> Tips:
    """Several as one, with modes that do nothing where one has fewer than another."""
    most = max(part.modes.pole.shape[1] for part in parts)
    lack = [((0, 0), (0, most - part.modes.pole.shape[1])) for part in parts]
    poles = [np.pad(part.modes.pole, pad, constant_values=-1.0) for part, pad in zip(parts, lack, strict=True)]
    shapes = [np.pad(part.modes.shape, (*pad, (0, 0))) for part, pad in zip(parts, lack, strict=True)]
    return Tips(
        ToolModes(join(poles), join(shapes)),
        *(join([getattr(part, name) for part in parts]) for name in ("position", "axis", "compliance")),
    )


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
    return _joined(parts, np.stack)
