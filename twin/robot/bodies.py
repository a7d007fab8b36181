"""Rigid bodies as mass, centre of mass and inertia: welded together, or divided by a plane."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

THINNEST = 0.05
"""Of the variance that a half has in a Gaussian cloud: the least that is left to it where the halves lie far apart."""
LEAST_KG = 1e-9
"""Less than this on one side of a plane is nothing: MuJoCo wants some mass in every body that moves."""

Inertial = tuple[float, np.ndarray, np.ndarray]
"""Mass kg, centre of mass (3,) m, inertia at it (3, 3) kg·m²."""


def fuse(first: Inertial, second: Inertial) -> Inertial:
    """The inertial of two rigid bodies welded together, all in one frame."""
    mass = first[0] + second[0]
    if mass == 0:
        return 0.0, first[1], first[2] + second[2]
    com = (first[0] * first[1] + second[0] * second[1]) / mass
    inertia = sum(part[2] + part[0] * _steiner(part[1] - com) for part in (first, second))
    return mass, com, np.asarray(inertia)


def cut(
    inertial: Inertial,
    origin: np.ndarray,
    normal: np.ndarray,
    mass_ratio: float | None = None,
    separation: float | None = None,
) -> tuple[Inertial, Inertial]:
    """Divide an inertial by a plane as if it were a Gaussian cloud; returns the parts (behind, in front).

    Moments of a normal distribution truncated at the plane, from its mass, mean and covariance.

    Args:
        inertial: of the whole.
        origin, normal: a point of the plane, and its unit normal.
        mass_ratio: mass in front over mass behind: the plane that cuts the cloud lies where it is so.
        separation: of the two centres of mass, m: farther than in the cloud, each part is the narrower for it, so that
            the parts still add up to the whole. A part is never narrower than ``THINNEST`` of what it is in the cloud.
    """
    mass, com, inertia = inertial
    covariance = (0.5 * np.trace(inertia) * np.eye(3) - inertia) / mass
    # a search may try inertias that no body has: the cloud then is a thin one
    spread = np.sqrt(max(float(normal @ covariance @ normal), 1e-6 * float(np.abs(covariance).max())))
    depth = normal @ (com - origin) / spread
    if mass_ratio is not None:
        depth = -float(ndtri(1 / (1 + mass_ratio)))
    toward = covariance @ normal / spread
    if min(shares := [float(ndtr(side * depth)) for side in (-1.0, 1.0)]) * mass < LEAST_KG:
        empty = (LEAST_KG, origin.copy(), np.eye(3) * 1e-12)
        return (empty, inertial) if shares[0] < shares[1] else (inertial, empty)
    hazard = [np.exp(-0.5 * depth**2) / np.sqrt(2 * np.pi) / share for share in shares]
    narrower = [h * (h + side * depth) for h, side in zip(hazard, (-1.0, 1.0), strict=True)]  # 0 to 1, of the variance
    apart = sum(hazard) * float(np.linalg.norm(toward))
    farther = 1.0
    if separation is not None:
        room = (1 - THINNEST) * (1 - max(narrower))
        between = shares[0] * shares[1] * sum(hazard) ** 2
        farther = min(separation / apart, float(np.sqrt(1 + room / between)))
        narrower = [n + between * (farther**2 - 1) for n in narrower]
    parts = []
    for side, share, h, n in zip((-1.0, 1.0), shares, hazard, narrower, strict=True):
        second = covariance - np.outer(toward, toward) * n
        inertia = mass * share * (np.trace(second) * np.eye(3) - second)
        parts.append((mass * share, com + side * farther * h * toward, inertia))
    return parts[0], parts[1]


@dataclass(frozen=True)
class Split:
    """A plane that divides a link: ``origin`` (3,) m and ``normal`` (3,) in its frame; the rest as in :func:`cut`."""

    origin: np.ndarray
    normal: np.ndarray
    mass_ratio: float | None = None
    separation: float | None = None

    def parts(self, inertial: Inertial) -> tuple[Inertial, Inertial]:
        """The halves (behind, in front) of a link."""
        return cut(inertial, self.origin, self.normal, self.mass_ratio, self.separation)


def _steiner(r: np.ndarray) -> np.ndarray:
    return float(r @ r) * np.eye(3) - np.outer(r, r)
