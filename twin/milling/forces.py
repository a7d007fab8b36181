"""The cutting force on the tool, linear in chip thickness: directional matrices over a tooth period, their average.

Cut frame: x along the feed, z from tip to spindle. A tooth at angle φ lies at (sin φ, cos φ) from the tool's axis, and
turns from y towards x. It cuts the chip h = n·[r(t) − r(t − τ)] + c sin φ, n = (sin φ, cos φ, 0). c is the feed per
tooth. The tooth feels

    F = b (a(φ) h + e(φ)),   a = kt (−cos φ, sin φ, 0) + kr (−sin φ, −cos φ, 0) + ka (0, 0, 1)

(Altintas and Budak, Annals of the CIRP 44, 1995, Eqs. 1–8; axial force added). A(φ) = Σ a nᵀ over the teeth in cut.
With helix, A is the mean over the axial depth, along which a tooth lags by 2 tan β/D per metre.
"""

import numpy as np

from twin.milling.cut import Cut


def lag(cut: Cut, depth_m: float) -> float:
    """Angle by which the top of the cut lags behind the tip, rad."""
    return 2 * float(np.tan(np.deg2rad(cut.tool.helix_deg))) * depth_m / cut.tool.diameter_m


def tooth_angles(cut: Cut, phase: np.ndarray) -> np.ndarray:
    """Angles (n, teeth) rad, in [entry, entry + 2π), of the teeth's tips at phases (n,) of the tooth period.

    Phase 0 is where a tooth enters the work.
    """
    teeth = cut.tool.teeth
    turns = (np.asarray(phase, float)[:, None] + np.arange(teeth)) / teeth
    return cut.arc[0] + 2 * np.pi * (turns % 1.0)


def directions(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit forces (…, 3, 3), columns tangential, radial and axial, and chip directions n (…, 3) at angles (…)."""
    s, c, zero, one = np.sin(angle), np.cos(angle), np.zeros_like(angle), np.ones_like(angle)
    force = np.stack(
        [np.stack([-c, -s, zero], -1), np.stack([s, -c, zero], -1), np.stack([zero, zero, one], -1)], axis=-2
    )
    return force, np.stack([s, c, zero], -1)


def _tensor_integral(angle: np.ndarray) -> np.ndarray:
    """∫ (unit forces) ⊗ n dφ from 0: (…, 3 force axes, 3 coefficients, 2 chip axes), closed form."""
    s2, sc = np.sin(angle) ** 2 / 2, (angle + np.sin(angle) * np.cos(angle)) / 2  # ∫ sin cos, ∫ cos²
    ss = angle - sc  # ∫ sin²
    s, c = np.sin(angle), 1 - np.cos(angle)  # ∫ cos, ∫ sin
    out = np.zeros((*np.shape(angle), 3, 3, 2))
    out[..., 0, 0, 0], out[..., 0, 0, 1] = -s2, -sc
    out[..., 1, 0, 0], out[..., 1, 0, 1] = ss, s2
    out[..., 0, 1, 0], out[..., 0, 1, 1] = -ss, -s2
    out[..., 1, 1, 0], out[..., 1, 1, 1] = -s2, -sc
    out[..., 2, 2, 0], out[..., 2, 2, 1] = c, s
    return out


def average(cut: Cut, shear: np.ndarray | None = None) -> np.ndarray:
    """Mean of A over a tooth period (…, 3, 3) N/m², for shear coefficients (…, 3), by default the cut's.

    The closed form of Altintas and Budak; helix does not change it.
    """
    shear = cut.coefficients.shear if shear is None else np.asarray(shear, float)
    start, end = (np.asarray(angle) for angle in cut.arc)
    mean = (_tensor_integral(end) - _tensor_integral(start)) * cut.tool.teeth / (2 * np.pi)
    out = np.zeros((*shear.shape[:-1], 3, 3))
    out[..., :2] = np.einsum("fkn,...k->...fn", mean, shear)
    return out


def periodic(cut: Cut, phase: np.ndarray, depth_m: float = 0.0) -> np.ndarray:
    """A per unit of each shear coefficient at phases (n,) of the tooth period: (n, 3 force axes, 3 coefficients, 2).

    Args:
        depth_m: axial depth over which a helix spreads the force; 0 for a straight tooth.
    """
    angle = tooth_angles(cut, phase)
    start, end = cut.arc
    width = lag(cut, depth_m)
    if width < 1e-9:
        force, chip = directions(angle)
        inside = (angle >= start) & (angle < end)
        return np.einsum("nj,njfk,njc->nfkc", inside.astype(float), force, chip[..., :2])
    total = np.zeros((len(phase), 3, 3, 2))
    turns = int(np.ceil((end - start + width) / (2 * np.pi)))
    for turn in range(turns + 1):
        top = np.clip(angle + 2 * np.pi * turn, start, end)
        low = np.clip(angle + 2 * np.pi * turn - width, start, end)
        total += (_tensor_integral(top) - _tensor_integral(low)).sum(axis=1) / width
    return total


def elements(cut: Cut, depth_m: float = 0.0) -> np.ndarray:
    """Intervals (ne, 2) of the tooth period, as phases in [0, 1], in which A is smooth and a tooth cuts."""
    pitch = 2 * np.pi / cut.tool.teeth
    swept, width = cut.arc[1] - cut.arc[0], lag(cut, depth_m)
    ends = np.array([0.0, swept, width, swept + width]) / pitch % 1.0
    ends = np.unique(np.round(np.concatenate([ends, [0.0, 1.0]]), 12))
    ends = ends[np.concatenate([[True], np.diff(ends) > 1e-9])]
    middle = 0.5 * (ends[1:] + ends[:-1])
    active = np.abs(periodic(cut, middle, depth_m)).sum(axis=(1, 2, 3)) > 0
    return np.stack([ends[:-1], ends[1:]], axis=1)[active]


def most_teeth(cut: Cut) -> int:
    """Most straight teeth in cut at the same time."""
    return int(np.ceil((cut.arc[1] - cut.arc[0]) * cut.tool.teeth / (2 * np.pi) - 1e-9))
