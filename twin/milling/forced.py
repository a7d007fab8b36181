"""The vibration of a stable cut: forced by the teeth, with runout; and the error it leaves on the surface.

Teeth that are all alike force the tip with the period of the teeth. That motion repeats from tooth to tooth, so that
the chip does not feel it and the tip answers as the bare structure does. Runout ρ makes chips differ once a turn,
ρ (1 − e^{−2πi/N}) for tooth after tooth; this part the chip feels, at the multiplier e^{2πi/N}. Process damping is left
out.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.milling import forces
from twin.milling.cut import Cut
from twin.milling.stability import collocate, fastest, operator
from twin.milling.tool_point import ToolModes

HARMONICS = 64  # of the teeth, at least; forces fall off with the square of their number
HELIX_SLICES = 24
PHASES = 256  # of a turn of the spindle, at which the motion is looked at


@dataclass(frozen=True)
class Vibration:
    """Forced motion of a stable cut.

    Attributes:
        angle: (nt,) of the spindle over one turn, rad; motion (nt, 3) of the tip, m, cut frame.
        peak_to_peak_m: (3,) along feed, normal and axis.
        surface_error_m: deepest (positive: too much is cut) and shallowest place of the finished wall, m.
        force_n: (3,) largest magnitude of the mean-free force, cut frame.
    """

    angle: np.ndarray
    motion: np.ndarray
    peak_to_peak_m: np.ndarray
    surface_error_m: tuple[float, float]
    force_n: np.ndarray


def forced_vibration(modes: ToolModes, cut: Cut, spindle_rpm: float, depth_m: float) -> Vibration:
    """Motion of the tip in a stable cut of a depth, m, at a spindle speed; modes in the cut frame."""
    tau, teeth = float(cut.tooth_period(spindle_rpm)), cut.tool.teeth
    count = max(HARMONICS, int(np.ceil(2 * np.abs(modes.pole).max() * tau / (2 * np.pi))))
    phase = (np.arange(8 * count) + 0.5) / (8 * count)
    push = static_force(cut, phase, depth_m)
    order = np.arange(-count, count + 1)
    wave = np.fft.fft(push, axis=0)[order] / len(phase) * np.exp(-1j * np.pi * order / len(phase))[:, None]
    frequency = 2 * np.pi * order / tau
    motion = np.einsum("hfg,hg->hf", modes.receptance(frequency), wave)
    angle = 2 * np.pi * np.arange(PHASES) / PHASES
    time = angle / (2 * np.pi) * teeth  # in tooth periods
    path = (np.exp(2j * np.pi * time[:, None] * order) @ motion).real
    if cut.tool.runout_m and teeth > 1:
        path = path + _of_runout(modes, cut, tau, depth_m, time, order)
    outward = 1.0 if cut.milling == "up" else -1.0
    made = _surface_phases(cut, depth_m)
    places = np.interp((made + np.arange(teeth)[:, None]) % teeth, time, outward * path[:, 1], period=teeth)
    return Vibration(
        angle, path, np.ptp(path, axis=0), (float(places.max()), float(places.min())),
        np.abs(push - push.mean(axis=0)).max(axis=0),
    )  # fmt: skip


def static_force(cut: Cut, phase: np.ndarray, depth_m: float) -> np.ndarray:
    """Force (n, 3) N on a tool that does not vibrate, cut frame, at phases of the tooth period."""
    shear, edge = cut.coefficients.shear, cut.coefficients.edge
    return _teeth(cut, phase, depth_m, lambda angle: cut.feed_per_tooth_m * np.sin(angle)[..., None] * shear + edge)


def _teeth(cut: Cut, phase: np.ndarray, depth_m: float, load: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Force (n, 3) of all teeth in cut from what each feels per depth, ``load`` (n, teeth, 3), at its angle."""
    width = forces.lag(cut, depth_m)
    slices = 1 if width < 1e-9 else HELIX_SLICES
    total = 0.0
    for part in (np.arange(slices) + 0.5) / slices:
        angle = forces.tooth_angles(cut, phase) - part * width
        angle = np.where(angle < cut.arc[0], angle + 2 * np.pi, angle)
        inside = (angle >= cut.arc[0]) & (angle < cut.arc[1])
        direction, _ = forces.directions(angle)
        total = total + np.einsum("njfk,njk,nj->nf", direction, load(angle), inside * (depth_m / slices))
    return np.asarray(total)


def _surface_phases(cut: Cut, depth_m: float) -> np.ndarray:
    """Phases of the tooth period (np,) at which teeth finish the wall, from tip to top of the cut."""
    at = 0.0 if cut.milling == "up" else cut.arc[1] - cut.arc[0]
    lags = np.linspace(0, forces.lag(cut, depth_m), 9)
    return (at + lags) * cut.tool.teeth / (2 * np.pi)


def _of_runout(
    modes: ToolModes, cut: Cut, tau: float, depth_m: float, time: np.ndarray, order: np.ndarray
) -> np.ndarray:
    """Motion (nt, 3) m that runout adds, at times in tooth periods."""
    cut, shear = cut.without_process_damping(), cut.coefficients.shear
    nodes = collocate(cut, float(fastest(modes, shear, depth_m) * tau), depth_m)
    op = operator(modes, cut, np.array([tau]), shear, nodes)
    theta = 2 * np.pi / cut.tool.teeth
    g = 1 - np.exp(-1j * theta)
    turn = theta + 2 * np.pi * order
    wave = np.exp(-1j * turn[:, None] * nodes.phase)
    # the tooth that came l teeth before has the offset of l teeth before
    offset = cut.tool.runout_m * g * np.exp(-1j * theta * np.arange(cut.tool.teeth))
    push = _teeth(cut, nodes.phase, depth_m, lambda angle: offset[:, None] * shear + 0 * angle[..., None])
    G = modes.receptance(turn / tau)
    rigid = np.einsum("hfg,hg->hf", G, wave @ (push * nodes.weight[:, None]))
    m, p = nodes.chip.shape[:2]
    before = np.einsum("mpf,mf->mp", nodes.chip, wave.conj().T @ rigid).ravel()
    W = op.at(np.array([0]), np.array([theta]))[0]
    chips = np.linalg.solve(np.eye(m * p) - depth_m * W, before).reshape(m, p)
    push = push + depth_m * g * np.einsum("mfp,mp->mf", op.force[0], chips)
    motion = np.einsum("hfg,hg->hf", G, wave @ (push * nodes.weight[:, None]))
    return np.asarray((np.exp(1j * time[:, None] * turn) @ motion).real)
