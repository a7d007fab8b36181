"""Modes of a linear model: poles, shapes at joints and test points, which deflections dominate, MAC."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from twin.model.linear import LinearModel, state_matrix


class Poles:
    """What poles λ in rad/s say, ``pole`` (…, nm)."""

    pole: np.ndarray

    @property
    def frequency_hz(self) -> np.ndarray:
        """Natural frequencies |λ|/2π (paper, Eq. 21), Hz."""
        return np.abs(self.pole) / (2 * np.pi)

    @property
    def damping_percent(self) -> np.ndarray:
        """Damping ratios −Re λ/|λ|, percent of critical."""
        return -100 * self.pole.real / np.abs(self.pole)


@dataclass(frozen=True)
class Modes(Poles):
    """Oscillating modes in the order of frequency; overdamped (real) poles are left out.

    Attributes:
        pole: (nm,) λ in rad/s, imaginary part positive.
        shape: (nv, nm) complex, in the model's coordinates, largest displacement of the coordinates scaled to 1.
        share: (nv, nm) each coordinate's share of the strain energy of the springs.
        linear: the model they belong to.
        growth: largest growth rate of any pole, 1/s; above zero the posture is not a stable equilibrium.
    """

    pole: np.ndarray
    shape: np.ndarray
    share: np.ndarray
    linear: LinearModel
    growth: float = 0.0

    def __len__(self) -> int:
        return len(self.pole)

    def at(self, labels: Iterable[str]) -> np.ndarray:
        """Shapes at test points along their directions, (n, nm) complex."""
        return self.linear.jacobian(labels) @ self.shape

    def dominant(self, mode: int, least: float = 0.1) -> list[tuple[str, float]]:
        """The deflections that hold at least ``least`` of a mode's strain energy, largest first."""
        order = np.argsort(-self.share[:, mode])
        return [(self.linear.coordinates[k], float(self.share[k, mode])) for k in order if self.share[k, mode] >= least]


def state_matrix_poles(linear: LinearModel) -> np.ndarray:
    """All poles of the linear model, rad/s, oscillating or not."""
    return np.linalg.eigvals(_state_matrix(linear)) if linear.coordinates else np.zeros(0, complex)


def _state_matrix(linear: LinearModel) -> np.ndarray:
    return state_matrix(linear.M, linear.C, linear.K, linear.loss, linear.integral)


def modes(linear: LinearModel) -> Modes:
    """Complex modes from the state-space form of the linear model (paper, Eqs. 19–22)."""
    nv = len(linear.coordinates)
    pole, vector = np.linalg.eig(_state_matrix(linear)) if nv else (np.zeros(0, complex), np.zeros((0, 0), complex))
    growth = float(pole.real.max(initial=0.0))
    keep = np.flatnonzero(pole.imag > 1e-6 * np.abs(pole))
    keep = keep[np.argsort(np.abs(pole[keep]))]
    pole, shape = pole[keep], vector[:nv, keep]
    if len(keep):
        largest = np.argmax(np.abs(shape), axis=0)
        shape = shape / shape[largest, np.arange(len(keep))]
    energy = linear.spring[:, None] * np.abs(shape) ** 2
    return Modes(pole, shape, energy / np.maximum(energy.sum(axis=0), np.finfo(float).tiny), linear, growth)


def same_modes(modes: Modes, some: np.ndarray, others: Modes) -> tuple[np.ndarray, np.ndarray]:
    """Of another model of the same robot, the modes (k,) that some modes (k,) of the first are, and how alike (k,).

    Each of the other's is taken once. Likeness, zero to one, is the modal assurance criterion of the motion of the test
    points that both models have, in all three directions, times the ratio of the lower natural frequency to the higher
    one: a resonator moves the robot as a mode near it does.
    """
    labels = [label for label in modes.linear.points if label in others.linear.points]
    one, other = (
        np.concatenate([m.linear.points[label][1] for label in labels]) @ m.shape if labels else m.shape[:0]
        for m in (modes, others)
    )
    one = one[:, some]
    size = np.linalg.norm(one, axis=0)[:, None] * np.linalg.norm(other, axis=0)
    ratio = modes.frequency_hz[some][:, None] / others.frequency_hz
    like = (np.abs(one.conj().T @ other) / np.maximum(size, np.finfo(float).tiny)) ** 2 * np.minimum(ratio, 1 / ratio)
    own, theirs = linear_sum_assignment(-like)
    return np.asarray(theirs), np.asarray(like[own, theirs])


def residues(
    M: np.ndarray,
    C: np.ndarray,
    K: np.ndarray,
    jacobian: np.ndarray,
    loss: np.ndarray | None = None,
    integral: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """All poles of M ẍ + C ẋ + (K + i·loss) x + integral ∫x dt = Jᵀf, and their shapes at n points.

    With Z(s) symmetric the residue of a pole is u uᵀ, u = J v/√(vᵀ Z′(λ) v); a real pole is held with half of it.

    Args:
        M, K: (…, nv, nv); C (nv, nv) or (…, nv, nv); ``jacobian`` (…, n, nv); ``loss`` and ``integral`` (nv, nv).

    Returns:
        Poles (…, nm) in rad/s in the order of their size, imaginary part not negative, and shapes (…, nm, n), m/√(N·s).
        A system with fewer poles than another has more at −1 with a shape of zero.
    """
    nv = M.shape[-1]
    loss, integral = (np.zeros((nv, nv)) if part is None else part for part in (loss, integral))
    pole, vector = np.linalg.eig(state_matrix(M, C, K, loss, integral))
    pole, vector = pole.astype(complex), vector.astype(complex)
    size = np.abs(pole)
    real = np.abs(pole.imag) <= 1e-9 * size
    used = (pole.imag > 0) | real
    most = int(used.sum(axis=-1).max())
    order = np.argsort(np.where(used, size, np.inf), axis=-1, kind="stable")[..., :most]
    pole, real, used = (np.take_along_axis(array, order, axis=-1) for array in (pole, real, used))
    v = np.take_along_axis(vector[..., :nv, :], order[..., None, :], axis=-1)
    slope = (v * (2 * pole[..., None, :] * (M @ v) + C @ v)).sum(axis=-2)
    if integral.any():
        slope = slope - (v * (integral @ v)).sum(axis=-2) / pole**2
    scale = np.where(used, 1 / np.sqrt(slope * np.where(real, 2, 1)), 0)
    shape = (jacobian @ v * scale[..., None, :]).swapaxes(-1, -2)
    return np.where(used, np.where(real, pole.real, pole), -1.0), shape
