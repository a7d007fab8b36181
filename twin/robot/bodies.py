"""Rigid bodies as mass, centre of mass and inertia: welded together, or divided by a plane."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

THINNEST = 0.05
"""Of a link's variance along the line to the next joint: the least that is left to its halves themselves."""
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
    moment_ratio: float | None = None,
) -> tuple[Inertial, Inertial]:
    """Divide an inertial by a plane; returns the parts (behind, in front), which are bodies and add up to it.

    What is not stated is that of a Gaussian cloud with the mass, mean and covariance of the whole. Its normal
    distribution is cut off at the plane, or at one parallel to it where the mass divides as stated.

    Args:
        inertial: of the whole.
        origin, normal: a point of the plane, and its unit normal.
        mass_ratio: mass in front over mass behind.
        separation: of the two centres of mass, m; no more than leaves ``THINNEST`` to the parts.
        moment_ratio: ∫x²dm along the line of the centres, each about its own, in front over behind.
    """
    mass, com, inertia = inertial
    covariance = (0.5 * np.trace(inertia) * np.eye(3) - inertia) / mass
    # a search may try inertias that no body has: the cloud then is a thin one
    spread = np.sqrt(max(float(normal @ covariance @ normal), 1e-6 * float(np.abs(covariance).max())))
    depth = normal @ (com - origin) / spread if mass_ratio is None else -float(ndtri(1 / (1 + mass_ratio)))
    share = np.array([float(ndtr(side * depth)) for side in (-1.0, 1.0)])
    if share.min() * mass < LEAST_KG:
        empty = (LEAST_KG, origin.copy(), np.eye(3) * 1e-12)
        return (empty, inertial) if share[0] < share[1] else (inertial, empty)
    toward = covariance @ normal / spread
    variance = float(toward @ toward)
    hazard = np.exp(-0.5 * depth**2) / np.sqrt(2 * np.pi) / share
    if separation is None:
        separation = float(hazard.sum()) * variance**0.5
    if moment_ratio is None:
        own = share * (1 - hazard * (hazard + depth * np.array([-1.0, 1.0])))
        moment_ratio = float(own[1] / own[0])
    apart = min(share.prod() * separation**2, (1 - THINNEST) * variance)  # variance between the centres
    direction = toward / variance**0.5
    between = float(np.sqrt(apart / share.prod())) * direction
    left = (variance - apart) * np.array([1.0, moment_ratio]) / (1 + moment_ratio)
    across = covariance - np.outer(toward, toward)
    parts = []
    for part, where, along in zip(share, (com - share[1] * between, com + share[0] * between), left, strict=True):
        second = part * across + along * np.outer(direction, direction)
        parts.append((mass * float(part), where, mass * (np.trace(second) * np.eye(3) - second)))
    return parts[0], parts[1]


@dataclass(frozen=True)
class Split:
    """A plane that divides a link: ``origin`` (3,) m and ``normal`` (3,) in its frame; the rest as in :func:`cut`."""

    origin: np.ndarray
    normal: np.ndarray
    mass_ratio: float | None = None
    separation: float | None = None
    moment_ratio: float | None = None

    def parts(self, inertial: Inertial) -> tuple[Inertial, Inertial]:
        """The halves (behind, in front) of a link."""
        return cut(inertial, self.origin, self.normal, self.mass_ratio, self.separation, self.moment_ratio)


def _steiner(r: np.ndarray) -> np.ndarray:
    return float(r @ r) * np.eye(3) - np.outer(r, r)
