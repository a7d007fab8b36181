"""The closed form: the cut's force averaged over a tooth period, at any number of postures at once.

With the mean matrix A₀ the limit is det(I − b (1 − e^{−iωτ}) G(iω) A₀) = 0. An eigenvalue Λ(ω) of G A₀ with a positive
real part gives

    b = 1/(2 Re Λ),   ωτ = 2 arg(Λ) + π (mod 2π)

(Altintas and Budak, Annals of the CIRP 44, 1995, with all terms of G). Good where teeth are many and immersion is
large; blind to flip.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from twin.milling import forces
from twin.milling.cut import Cut
from twin.milling.tool_point import ToolModes

SPREAD = 4  # widths of a resonance on either side that are sampled closely
PER_MODE = 16  # frequencies for each mode
BISECTIONS = 24
FINER = 3


def eigenvalues(G: np.ndarray, average: np.ndarray) -> np.ndarray:
    """Λ (…, 2), 1/m, of receptances (…, 3, 3) under mean matrices (…, 3, 3), whose third column is zero."""
    P = G[..., :2, :] @ average[..., :2]  # chips do not depend on z: the other eigenvalue is 0
    half = 0.5 * (P[..., 0, 0] + P[..., 1, 1])
    root = np.sqrt(half**2 - (P[..., 0, 0] * P[..., 1, 1] - P[..., 0, 1] * P[..., 1, 0]))
    return np.stack([half + root, half - root], axis=-1)


def sampled_frequencies(modes: ToolModes) -> np.ndarray:
    """Angular frequencies (…, nm · PER_MODE) rad/s that resolve every resonance, within and between them."""
    at, width = np.abs(modes.pole)[..., None], -modes.pole.real[..., None]
    close = np.linspace(-SPREAD, SPREAD, PER_MODE - 5)
    far = np.array([0.85, 0.93, 1.07, 1.15, 1.3])
    both = np.concatenate([at + width * close, at * far], axis=-1)
    return np.maximum(both, 1e-3 * at).reshape(*modes.pole.shape[:-1], -1)


def limiting_depth(
    modes: ToolModes, cut: Cut, *, spindle_rpm: float | None = None, shear: np.ndarray | None = None
) -> np.ndarray:
    """Largest depth (…,) m that is stable at every spindle speed, or at one; infinite where any depth is.

    Args:
        modes: in the cut frame, any leading axes.
        spindle_rpm: the speed; ``None``: the smallest limit of all speeds.
        shear: (…, 3) cutting coefficients N/m², by default the cut's.
    """
    mean = forces.average(cut, shear)
    if spindle_rpm is not None:
        tau = float(cut.tooth_period(spindle_rpm))
        return _least_crossing(modes, mean, lambda w: 1 - np.exp(-1j * w * tau), np.pi / tau)
    w = np.sort(sampled_frequencies(modes), axis=-1)
    for _ in range(FINER):  # between the neighbours of the largest, more closely each time
        growth = eigenvalues(modes.receptance(w), mean[..., None, :, :]).real.max(axis=-1)
        top = np.clip(np.argmax(growth, axis=-1), 1, w.shape[-1] - 2)[..., None]
        ends = [np.take_along_axis(np.broadcast_to(w, growth.shape), top + side, axis=-1) for side in (-1, 1)]
        w = ends[0] + (ends[1] - ends[0]) * np.linspace(0, 1, 9)
    growth = eigenvalues(modes.receptance(w), mean[..., None, :, :]).real.max(axis=-1)
    return _inverse(2 * growth.max(axis=-1))


def low_frequency_depth(modes: ToolModes, cut: Cut, spindle_rpm: float, shear: np.ndarray | None = None) -> np.ndarray:
    """Limit (…,) m where vibration is slow against the teeth: the delay acts as a damping matrix, b τ A₀.

    r(t) − r(t − τ) ≈ τ ṙ, so that the cut adds −bτA₀ to the damping at the tip. The limit is the least b at which an
    eigenvalue of iωτ G(iω) A₀ is real and equals 1/b. What is neglected is of the order of ωτ.
    """
    tau = float(cut.tooth_period(spindle_rpm))
    return _least_crossing(modes, forces.average(cut, shear), lambda w: 1j * w * tau, np.inf)


def _least_crossing(
    modes: ToolModes, mean: np.ndarray, factor: Callable[[np.ndarray], np.ndarray], period: float
) -> np.ndarray:
    """Least b (…,) at which an eigenvalue of factor(ω) G(iω) A₀ is 1/b; the factor changes over ``period`` rad/s."""
    lead = np.broadcast_shapes(modes.pole.shape[:-1], mean.shape[:-2])
    flat = ToolModes(
        np.broadcast_to(modes.pole, (*lead, modes.pole.shape[-1])).reshape(-1, modes.pole.shape[-1]),
        np.broadcast_to(modes.shape, (*lead, *modes.shape.shape[-2:])).reshape(-1, *modes.shape.shape[-2:]),
        None if modes.residual is None else np.broadcast_to(modes.residual, (*lead, 3, 3)).reshape(-1, 3, 3),
    )
    mean = np.broadcast_to(mean, (*lead, 3, 3)).reshape(-1, 3, 3)
    w = sampled_frequencies(flat)
    even = max(2, int(np.ceil(8 * w.max() / period)))
    w = np.sort(np.concatenate([w, w.max(axis=1, keepdims=True) * np.arange(1, even) / even], axis=1), axis=1)

    def curves(row: Any, w: np.ndarray) -> np.ndarray:
        some = ToolModes(flat.pole[row], flat.shape[row], None if flat.residual is None else flat.residual[row])
        return eigenvalues(some.receptance(w), mean[row][:, None]) * factor(w)[..., None]

    values = _followed(curves(slice(None), w))
    row, at, curve = np.nonzero((values.imag[:, :-1] * values.imag[:, 1:] <= 0) & (values.real[:, 1:] > 0))
    low, high = w[row, at], w[row, at + 1]
    a, b = values[row, at, curve], values[row, at + 1, curve]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        both = curves(row, middle[:, None])[:, 0]
        value = both[np.arange(len(row)), np.argmin(np.abs(both - 0.5 * (a + b)[:, None]), axis=1)]
        left = (value.imag > 0) == (a.imag > 0)
        low, high = np.where(left, middle, low), np.where(left, high, middle)
        a, b = np.where(left, value, a), np.where(left, b, value)
    largest = np.zeros(len(mean))
    np.maximum.at(largest, row, 0.5 * (a + b).real)
    return _inverse(largest.reshape(lead))


def _inverse(values: np.ndarray) -> np.ndarray:
    return np.divide(1.0, values, out=np.full(np.shape(values), np.inf), where=np.asarray(values) > 0)


def _followed(values: np.ndarray) -> np.ndarray:
    """The two eigenvalues (…, nf, 2) as two curves: swapped where that makes them continue."""
    a, b = values[..., :-1, :], values[..., 1:, :]
    stay = np.abs(b - a).sum(axis=-1)
    swap = np.abs(b[..., ::-1] - a).sum(axis=-1)
    turned = np.cumsum(swap < stay, axis=-1) % 2 == 1
    turned = np.concatenate([np.zeros_like(turned[..., :1]), turned], axis=-1)[..., None]
    return np.where(turned, values[..., ::-1], values)
