"""The dynamics at the tool's tip: poles and shapes, from a robot's linear model, from a measured FRF, or coupled.

All that follows takes one type, :class:`ToolModes`. Axes are those of the base frame until they are turned into the
cut frame.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.measure.modal import ModalResult
from twin.milling.cut import Cut, ToolMode
from twin.model.linear import LinearModel, linearise, state_matrix
from twin.robot.description import Robot, TestPoint
from twin.robot.mechanism import assemble

LABELS = ("toolX+", "toolY+", "toolZ+")


@dataclass(frozen=True)
class ToolModes:
    """Receptance at the tool's tip as poles and shapes; leading axes, if any, are postures or draws.

        G(s) = Σ_k [u_k u_kᵀ/(s − λ_k) + conj(u_k u_kᵀ)/(s − λ_k*)] + residual

    Attributes:
        pole: (…, nm) λ in rad/s, imaginary part not negative; a real pole is held with half its residue.
        shape: (…, nm, 3) u, m/√(N·s) — its outer product is the residue, m/(N·s); complex for general damping.
        residual: (…, 3, 3) m/N, static compliance of what lies above, or ``None``.
    """

    pole: np.ndarray
    shape: np.ndarray
    residual: np.ndarray | None = None

    @property
    def frequency_hz(self) -> np.ndarray:
        """|λ|/2π, Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping_percent(self) -> np.ndarray:
        """−Re λ/|λ|, percent of critical."""
        return -100 * self.pole.real / np.abs(self.pole)

    def receptance(self, frequency_rad_s: np.ndarray) -> np.ndarray:
        """G(iω), (…, nf, 3, 3) m/N, at frequencies (…, nf) rad/s."""
        s = 1j * np.asarray(frequency_rad_s, float)[..., None]
        pole = self.pole[..., None, :]
        residue = self.shape[..., :, None] * self.shape[..., None, :]
        flat = residue.reshape(*residue.shape[:-2], 9)
        G = (1 / (s - pole)) @ flat + (1 / (s - pole.conj())) @ flat.conj()
        G = G.reshape(*G.shape[:-1], 3, 3)
        return G if self.residual is None else G + self.residual[..., None, :, :]

    def turned(self, rotation: np.ndarray) -> "ToolModes":
        """The same in another frame: rotations (…, 3, 3) from the present frame to the new one."""
        residual = self.residual
        if residual is not None:
            residual = rotation @ residual @ np.swapaxes(rotation, -1, -2)
        return replace(self, shape=self.shape @ np.swapaxes(rotation, -1, -2), residual=residual)

    def without_cross_terms(self) -> "ToolModes":
        """Every direction for itself: what lobes from direct FRFs alone would use."""
        pole = np.concatenate([self.pole] * 3, axis=-1)
        shape = np.concatenate([self.shape * np.eye(3)[k] for k in range(3)], axis=-2)
        residual = None if self.residual is None else self.residual * np.eye(3)
        return ToolModes(pole, shape, residual)


def real_modes(frequency_hz: Any, damping_percent: Any, shape: Any) -> ToolModes:
    """Modes with real shapes (…, nm, 3) normalised to unit modal mass, 1/√kg: G = Σ φφᵀ/(s² + 2ζωs + ω²)."""
    w = 2 * np.pi * np.asarray(frequency_hz, float)
    zeta = np.asarray(damping_percent, float) / 100
    damped = w * np.sqrt(1 - zeta**2)
    return ToolModes(-zeta * w + 1j * damped, np.asarray(shape) / np.sqrt(2j * damped)[..., None])


def matrix_modes(
    M: np.ndarray,
    C: np.ndarray,
    K: np.ndarray,
    jacobian: np.ndarray,
    loss: np.ndarray | None = None,
    integral: np.ndarray | None = None,
) -> ToolModes:
    """All poles of M ẍ + C ẋ + (K + i·loss) x + integral ∫x dt = Jᵀf at a point, its Jacobian (3, nv).

    With Z(s) symmetric the residue of a pole is u uᵀ, u = J v/√(vᵀ Z′(λ) v).
    """
    none = np.zeros_like(M)
    loss, integral = none if loss is None else loss, none if integral is None else integral
    nv = len(M)
    pole, vector = np.linalg.eig(state_matrix(M, C, K, loss, integral))
    real = np.abs(pole.imag) <= 1e-9 * np.abs(pole)
    keep = np.flatnonzero((pole.imag > 0) | real)
    keep = keep[np.argsort(np.abs(pole[keep]), kind="stable")]
    pole, real, v = pole[keep], real[keep], vector[:nv, keep]
    slope = 2 * pole * np.einsum("ik,ij,jk->k", v, M, v) + np.einsum("ik,ij,jk->k", v, C, v)
    if integral.any():
        slope = slope - np.einsum("ik,ij,jk->k", v, integral, v) / pole**2
    shape = (jacobian @ v / np.sqrt(slope * np.where(real, 2, 1) + 0j)).T
    return ToolModes(np.where(real, pole.real, pole), shape)


def with_tool(robot: Robot, cut: Cut) -> Robot:
    """The robot with spindle and tool fused to its flange, and test points ``toolX+ …`` at the tip."""
    payload = cut.tool.payload(robot)
    body, tip = f"link{robot.axis_count}", [float(value) for value in cut.tool.tip(robot)]
    directions = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    points = [
        TestPoint(label=label, body=body, position=(tip[0], tip[1], tip[2]), direction=direction)
        for label, direction in zip(LABELS, directions, strict=True)
    ]
    return robot.model_copy(
        update={
            "physics": [*robot.physics, *([payload] if payload else [])],
            "test_points": [*robot.test_points, *points],
        }
    )


@dataclass(frozen=True)
class ToolPoint:
    """The tip in a posture.

    Attributes:
        modes: in the base frame.
        position: (3,) of the tip, m, base frame.
        axis: (3,) unit vector flange → tip, base frame.
        linear: the model that they come from, or ``None`` for a measurement.
    """

    modes: ToolModes
    position: np.ndarray
    axis: np.ndarray
    linear: LinearModel | None = None


def tool_point(robot: Robot, q: np.ndarray, brakes: str, cut: Cut) -> ToolPoint:
    """The tip's dynamics from a robot's linear model in a posture q (n,) rad (m), the tool's own modes coupled.

    Raises:
        InputError: the tool is below the table, or the posture is no stable equilibrium.
    """
    equipped = with_tool(robot, cut)
    mechanism = assemble(equipped, q, brakes="off" if brakes == "off" else "on")
    linear = linearise(mechanism)
    if not linear.coordinates:
        raise InputError(robot.name, "axes", "no axis has a stiffness, so nothing limits the depth of cut")
    turn, position = _link_pose(robot, q, cut)
    axis = turn @ cut.tool.axis(robot)
    require_above_table(robot, cut, position)
    jacobian = turn @ linear.points[LABELS[0]][1]
    own = clamped_modes(cut, axis)
    M, C, K = linear.M, linear.C, linear.K
    loss, integral = linear.loss, linear.integral
    if own:
        M, C, K, jacobian = coupled(M, C, K, jacobian, *own, source=cut.source)
        pad = ((0, len(M) - len(loss)),) * 2
        loss, integral = np.pad(loss, pad), np.pad(integral, pad)
    modes = matrix_modes(M, C, K, jacobian, loss, integral)
    if modes.pole.real.max(initial=-1.0) > 1e-6 * np.abs(modes.pole).max():
        raise InputError(robot.name, "posture", "is not a stable equilibrium: a stiffness is too low")
    return ToolPoint(modes, position, axis, linear)


def require_above_table(robot: Robot, cut: Cut, position: np.ndarray) -> None:
    """Raise where a tip (3,) m lies below the table (robots on a floor; gravity down)."""
    if cut.table_z_m is not None and robot.gravity[2] < 0 and position[2] < cut.table_z_m:
        raise InputError(
            cut.source, "cut.table_z_m",
            f"the tool's tip is {cut.table_z_m - position[2]:.3g} m below the table at z = {cut.table_z_m:g} m of the "
            "base frame; change the posture, the tool or table_z_m (null: no table)",
        )  # fmt: skip


def _link_pose(robot: Robot, q: np.ndarray, cut: Cut) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) of the last link and place (3,) m of the tip, base frame, no deflection."""
    from twin.robot.frames import axis_placement, matrix_of

    turn, place = matrix_of(np.array(robot.base.quaternion)), np.array(robot.base.position)
    for axis, value in zip(robot.axes, q, strict=True):
        offset, quaternion = axis_placement(axis, float(value))
        place = place + turn @ offset
        turn = turn @ matrix_of(quaternion)
    return turn, place + turn @ cut.tool.tip(robot)


def clamped_modes(cut: Cut, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Modes of tool and spindle on a clamped flange: ω (m,) rad/s, ζ (m,), shapes (m, 3) 1/√kg in the base frame."""
    rotation = cut.frame(axis)
    if cut.tool.modes:
        given: list[ToolMode] = cut.tool.modes
        w = 2 * np.pi * np.array([mode.frequency_hz for mode in given])
        zeta = np.array([mode.damping_percent / 100 for mode in given])
        size = w / np.sqrt([mode.stiffness_n_per_m for mode in given])
        return w, zeta, np.array([s * rotation["xy".index(m.direction)] for s, m in zip(size, given, strict=True)])
    if cut.tool.frf:
        measured = measured_tool(cut)
        w = np.abs(measured.pole)
        # real shapes of unit modal mass: u = φ/√(2iω_d)
        shape = (measured.shape * np.sqrt(2j * measured.pole.imag)[:, None]).real @ rotation
        return w, -measured.pole.real / w, shape
    return None


def measured_tool(cut: Cut) -> ToolModes:
    """Modes of the measured tool FRF (``tool.frf``), directions as recorded: X and Y across the axis, X the feed's."""
    from pathlib import Path

    from twin.measure.campaign import read_campaign

    folder = cut._folder or Path()
    path = Path(str(cut.tool.frf))
    path = folder / path if (folder / path).is_file() else path
    campaign = read_campaign(path)
    return measured_modes(campaign, next(iter(campaign.postures)), str(path))


def coupled(
    M: np.ndarray,
    C: np.ndarray,
    K: np.ndarray,
    jacobian: np.ndarray,
    w: np.ndarray,
    zeta: np.ndarray,
    shape: np.ndarray,
    source: str = "cut",
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Receptance coupling of clamped tool modes: matrices and Jacobian with one coordinate η more for each.

    A mode moves the tip by φη beside the motion of the rigid tool, and the mass that it holds, 1/|φ|², taken at the
    tip, is driven by that motion: fixed-interface modes of Craig and Bampton (AIAA Journal 6, 1968). That mass is
    part of the rigid tool's.

    Raises:
        InputError: the tool's mass is less than its modes hold.
    """
    held = shape / np.sum(shape**2, axis=1, keepdims=True)  # (m, 3) √kg
    cross = held @ jacobian
    nv, m = len(M), len(w)
    full = np.block([[M, cross.T], [cross, np.eye(m)]])
    if np.linalg.eigvalsh(M - cross.T @ cross)[0] <= 0:
        heaviest = float((1 / np.sum(shape**2, axis=1)).max())
        raise InputError(
            source, "cut.tool.mass_kg", f"the robot with its tool is lighter than the tool's modes ({heaviest:.3g} kg)"
        )
    zero = np.zeros((nv, m))
    return (
        full,
        np.block([[C, zero], [zero.T, np.diag(2 * zeta * w)]]),
        np.block([[K, zero], [zero.T, np.diag(w**2)]]),
        np.hstack([jacobian, shape.T]),
    )


def measured_modes(campaign: Any, posture: str, source: str, result: ModalResult | None = None) -> ToolModes:
    """Modes at a point that was hit and measured in the same place, from a hammer test, axes as recorded.

    The point is the one with the most driving-point directions; directions that were not measured count as rigid.

    Raises:
        InputError: no point was hit where it was measured.
    """
    from twin.measure.modal import analyse  # heavy, and only here

    raise NotImplementedError(analyse)
