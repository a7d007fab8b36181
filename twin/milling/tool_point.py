"""The dynamics at the tool's tip: poles and shapes, from a robot's linear model, from a measured FRF, or coupled.

All that follows takes one type, :class:`ToolModes`. Axes are those of the base frame until they are turned into the
cut frame.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import Campaign, Channels, as_quantity, laplace
from twin.measure.modal import identify_modes
from twin.measure.recordings import read_campaign
from twin.milling.cut import Cut, ToolMode
from twin.model.linear import LinearModel, linearise
from twin.model.modes import Poles, residues
from twin.robot.description import Robot, TestPoint
from twin.robot.frames import axis_placement, matrix_of
from twin.robot.mechanism import assemble

LABELS = ("toolX+", "toolY+", "toolZ+")


@dataclass(frozen=True)
class ToolModes(Poles):
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

    def rows(self, rows: np.ndarray) -> "ToolModes":
        """Some rows (n,) of a batch with one leading axis; modes without one serve all rows and stay as they are."""
        if self.pole.ndim == 1:
            return self
        residual = self.residual
        if residual is not None and residual.ndim > 2:
            residual = residual[rows]
        return ToolModes(self.pole[rows], self.shape[rows], residual)

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


def with_tool(robot: Robot, cut: Cut) -> Robot:
    """The robot with spindle and tool fused to its flange, and test points ``toolX+ …`` at the tip."""
    if cut.tool.mass_kg > (most := sum(link.inertial[0] for link in robot.links)):
        problem = f"expected kg, no more than the robot's links weigh ({most:.0f}), found {cut.tool.mass_kg:g}"
        raise InputError(cut.source, "tool.mass_kg", problem)
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
        deviation: (nm, 2) standard deviations of frequency, as a share of it, and of ln damping, where measured.
    """

    modes: ToolModes
    position: np.ndarray
    axis: np.ndarray
    linear: LinearModel | None = None
    deviation: np.ndarray | None = None

    def drawn(self, rng: np.random.Generator, count: int) -> ToolModes | None:
        """Modes (count, nm) as probable as the measured ones, base frame; ``None`` where no deviation is known."""
        if self.deviation is None:
            return None
        frequency, damping = np.exp(self.deviation.T[:, None] * rng.standard_normal((2, count, len(self.modes.pole))))
        size = np.abs(self.modes.pole) * frequency
        ratio = np.minimum(-self.modes.pole.real / np.abs(self.modes.pole) * damping, 0.999)
        shape = np.broadcast_to(self.modes.shape, (count, *self.modes.shape.shape))
        residual = self.modes.residual
        if residual is not None:
            residual = np.broadcast_to(residual, (count, 3, 3))
        return ToolModes(size * (-ratio + 1j * np.sqrt(1 - ratio**2)), shape, residual)


def tool_point(robot: Robot, q: np.ndarray, brakes: str, cut: Cut) -> ToolPoint:
    """The tip's dynamics from a robot's linear model in a posture q (n,) rad (m), the tool's own modes coupled.

    Raises:
        InputError: the tool is below the table, or the posture is no stable equilibrium.
    """
    equipped = with_tool(robot, cut)
    mechanism = assemble(equipped, q, brakes="off" if brakes == "off" else "on")
    linear = linearise(mechanism)
    if not linear.coordinates:
        raise InputError(
            robot.name,
            "axes",
            "no axis has a stiffness, so nothing limits the depth of cut; `twin describe` fills it in",
        )
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
    modes = ToolModes(*residues(M, C, K, jacobian, loss, integral))
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
    turn, place = matrix_of(np.array(robot.base.quaternion)), np.array(robot.base.position)
    for axis, value in zip(robot.axes, q + robot.encoder_zeros, strict=True):
        offset, quaternion = axis_placement(axis, float(value))
        place = place + turn @ offset
        turn = turn @ matrix_of(quaternion)
    return turn, place + turn @ cut.tool.tip(robot)


def clamped_modes(cut: Cut, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Modes of tool and spindle on a clamped flange: ω (m,) rad/s, ζ (m,), shapes (m, 3) 1/√kg in the base frame."""
    rotation = cut.frame(axis)
    if cut.tool.modes:
        given: tuple[ToolMode, ...] = cut.tool.modes
        w = 2 * np.pi * np.array([mode.frequency_hz for mode in given])
        zeta = np.array([mode.damping_percent / 100 for mode in given])
        size = w / np.sqrt([mode.stiffness_n_per_m for mode in given])
        return w, zeta, np.array([s * rotation["xy".index(m.direction)] for s, m in zip(size, given, strict=True)])
    if cut.tool.frf:
        measured = _measured_tool(cut)
        w = np.abs(measured.pole)
        # real shapes of unit modal mass: u = φ/√(2iω_d)
        shape = (measured.shape * np.sqrt(2j * measured.pole.imag)[:, None]).real
        return w, -measured.pole.real / w, shape @ rotation
    return None


def _measured_tool(cut: Cut) -> ToolModes:
    """Modes of the measured tool FRF (``tool.frf``); X and Y as recorded are the cut's feed and normal."""
    path = Path(str(cut.tool.frf))
    if cut.folder is not None and (cut.folder / path).is_file():
        path = cut.folder / path
    campaign = read_campaign(path)
    return measured_modes(campaign, next(iter(campaign.postures)), str(path))[0]


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

    A mode moves the tip by φη beside the motion of the rigid tool. The mass that it holds, 1/|φ|², taken at the tip, is
    driven by that motion. These are fixed-interface modes of Craig and Bampton (AIAA Journal 6, 1968). That mass is
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


def measured_point(
    campaign: Campaign, posture: str, robot: Robot | None, cut: Cut, source: str
) -> tuple[ToolPoint, list[str]]:
    """The tip's dynamics straight from a hammer test that hit the point where it was measured, and notes on it.

    Args:
        campaign: the hammer test.
        posture: group of it.
        robot: turns the channels' directions from their body's frame into the base frame; ``None``: as recorded.
        cut: whose tool gives the axis.

    Raises:
        InputError: no point was hit where it was measured.
    """
    frf = campaign.postures[posture]
    turn = np.eye(3)
    responses, excitations, body = driving_point(campaign, source)
    axis, position = np.array([0.0, 0.0, -1.0]), np.zeros(3)
    notes = [f"taken as the tool's tip: {campaign.response.label[responses[0]]} and its neighbours on {body}"]
    if robot is not None:
        q = robot.angles(frf.q_deg)
        last, position = _link_pose(robot, q, cut)
        axis = last @ cut.tool.axis(robot)
        turn = _body_turn(robot, q, body)
    modes, deviation, missing = measured_modes(campaign, posture, source, (responses, excitations), turn)
    if missing:
        notes.append(f"{missing} of 3 directions were not measured and count as rigid")
    return ToolPoint(modes, position, axis, deviation=deviation), notes


def driving_point(campaign: Campaign, source: str) -> tuple[list[int], list[int], str]:
    """Responses and excitations at the point that was hit and measured in most directions, and its body.

    Raises:
        InputError: no point was hit where it was measured.
    """

    def places(channels: Channels) -> dict[tuple[Any, ...], list[int]]:
        found: dict[tuple[Any, ...], list[int]] = {}
        for k, (body, position) in enumerate(zip(channels.body, channels.position, strict=True)):
            found.setdefault((body, *np.round(position, 3)), []).append(k)
        return found

    measured, hit = places(campaign.response), places(campaign.excitation)
    shared = [key for key in measured if key in hit]
    if not shared:
        raise InputError(
            source, "excitation", "no point was hit where it was measured; lobes need the FRFs of the tool's own point"
        )
    best = max(shared, key=lambda key: (min(len(measured[key]), len(hit[key])), key))
    return measured[best], hit[best], str(best[0])


def _body_turn(robot: Robot, q: np.ndarray, body: str) -> np.ndarray:
    """Rotation (3, 3) of a body (``base``, ``link1`` …) in the base frame."""
    number = int(body.removeprefix("link")) if body.startswith("link") else 0
    turn = matrix_of(np.array(robot.base.quaternion))
    for axis, value in zip(robot.axes[:number], (q + robot.encoder_zeros)[:number], strict=True):
        turn = turn @ matrix_of(axis_placement(axis, float(value))[1])
    return turn


def measured_modes(
    campaign: Campaign,
    posture: str,
    source: str,
    channels: tuple[list[int], list[int]] | None = None,
    turn: np.ndarray | None = None,
) -> tuple[ToolModes, np.ndarray, int]:
    """Modes at a measured point from the FRFs of its channels, their deviations, and how many directions are missing.

    Poles are those of :func:`twin.measure.modal.identify_modes` over all channels. Residues are fitted with a static
    and an inertial remainder, made symmetric, and reduced to one shape each (the nearest u uᵀ).

    Args:
        channels: responses and excitations of the point, by default :func:`driving_point`'s.
        turn: (3, 3) from the channels' frame to the one wanted.
    """
    responses, excitations = channels or driving_point(campaign, source)[:2]
    frf = campaign.postures[posture]
    labels = campaign.response.label, campaign.excitation.label
    result = identify_modes(frf, labels=labels, source=source)
    if not result.modes:
        raise InputError(source, f"postures/{posture}", "holds no mode")
    w = 2 * np.pi * np.array([mode.frequency_hz for mode in result.modes])
    zeta = np.array([mode.damping_percent for mode in result.modes]) / 100
    pole = w * (-zeta + 1j * np.sqrt(1 - zeta**2))
    lines = frf.frequency > 0
    s = laplace(frf.frequency[lines], frf.exponential_window_rate)
    part = replace(frf, frequency=frf.frequency[lines], frf=frf.frf[lines])
    H = as_quantity(part, "mobility").frf[:, responses][:, :, excitations]
    residue, static = _residues(H, s, pole)
    turn = np.eye(3) if turn is None else turn
    felt, hit = (np.linalg.pinv(side.direction[rows]) for side, rows in (
        (campaign.response, responses), (campaign.excitation, excitations)))  # fmt: skip
    whole = turn @ (felt @ residue @ hit.T) @ turn.T
    static = turn @ (felt @ static @ hit.T) @ turn.T
    rank = min(np.linalg.matrix_rank(felt, tol=1e-3), np.linalg.matrix_rank(hit, tol=1e-3))
    shape = np.array([_outer_root(matrix) for matrix in whole])
    deviation = np.array(
        [
            (m.frequency_std_hz / m.frequency_hz, min(1.0, m.damping_std_percent / m.damping_percent))
            for m in result.modes
        ]
    )
    return ToolModes(pole, shape, 0.5 * (static + static.T)), deviation, 3 - int(rank)


def _residues(mobility: np.ndarray, s: np.ndarray, pole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residues (nm, nr, ne) of receptance and a real static remainder (nr, ne) from mobility (nf, nr, ne)."""
    one, other = s[:, None] / (s[:, None] - pole), s[:, None] / (s[:, None] - pole.conj())
    rest = np.stack([s, 1 / s], axis=1)
    A = np.concatenate([one + other, 1j * (one - other), rest], axis=1)
    flat = mobility.reshape(len(s), -1)
    size = np.linalg.norm(A, axis=0)
    found = np.linalg.lstsq(
        np.concatenate([A.real, A.imag]) / size, np.concatenate([flat.real, flat.imag]), rcond=None
    )[0] / size[:, None]  # fmt: skip
    n = len(pole)
    residue = found[:n] + 1j * found[n : 2 * n]
    return residue.reshape(n, *mobility.shape[1:]), found[2 * n].reshape(mobility.shape[1:])


def _outer_root(residue: np.ndarray) -> np.ndarray:
    """u (3,) whose u uᵀ is nearest to a matrix's symmetric part (Takagi's factorisation, its largest term)."""
    symmetric = 0.5 * (residue + residue.T)
    v = np.linalg.svd(symmetric)[0][:, 0]
    return v * np.sqrt(v.conj() @ symmetric @ v.conj() + 0j)
