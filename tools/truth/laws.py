"""Constitutive laws of a joint beyond a linear spring and damper: in frequency, and in time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.truth.chain import Array
from tools.truth.effects import Effect

Complex = NDArray[Any]


@dataclass(frozen=True)
class JointLaw:
    """A joint torque beside the linear spring `k` of its hinge, as a function of deflection, rate and history.

    `k` N·m/rad may be an array, one for each of the motions stepped together.
    """

    k: Any

    def rest(self, torque: float) -> float:
        """Deflection that carries a static torque, spring included."""
        return torque / float(self.k)

    def tangent(self, torque: float) -> tuple[float, float]:
        """Stiffness and damping added to the spring at vanishing amplitude about that rest."""
        return 0.0, 0.0

    def start(self, shape: tuple[int, ...]) -> Array:
        """State of the law at rest, for motions of this shape."""
        return np.zeros((0, *shape))

    def extra(self, x: Array, v: Array, state: Array) -> tuple[Array, Array]:
        """Torque added to the spring's, and the new state, when deflection and rate become x, v."""
        raise NotImplementedError


def frequency_term(effect: Effect, stiffness: Array) -> Callable[[Complex], Complex] | None:
    """s ↦ stiffness added at the effect's hinge, if it depends on frequency; `stiffness` (n, 3) z, x, y."""
    if effect.kind == "structural_damping":
        loss = 1j * effect["loss_factor"] * stiffness[effect.joint, "zxy".index(effect.axis)]
        return lambda s: np.full(s.shape, loss)
    if effect.kind == "fractional_damper":
        return lambda s: effect["coefficient"] * s ** effect["order"]
    return None


def joint_law(effect: Effect, stiffness: Array) -> JointLaw | None:
    """The nonlinear law of an effect at its hinge, beside the linear spring there."""
    if effect.kind == "hardening_stiffness":
        return Hardening(stiffness[effect.joint, 0], effect["cubic"])
    if effect.kind == "backlash":
        return Backlash(stiffness[effect.joint, 0], effect["gap"])
    if effect.kind == "hysteresis":
        return Slip(stiffness[effect.joint, 0], effect.array("stiffness"), effect.array("yield_torque"))
    if effect.kind == "eddy_current_damper":
        return QuadraticDrag(stiffness[effect.joint, 0], effect["coefficient"])
    return None


@dataclass(frozen=True)
class Hardening(JointLaw):
    """kφ + k₃φ³, φ from the unloaded spring."""

    cubic: float

    def rest(self, torque: float) -> float:
        bound = abs(torque) / self.k + 1e-12
        return float(brentq(lambda x: self.k * x + self.cubic * x**3 - torque, -bound, bound, xtol=1e-16))

    def tangent(self, torque: float) -> tuple[float, float]:
        return 3 * self.cubic * self.rest(torque) ** 2, 0.0

    def extra(self, x: Array, v: Array, state: Array) -> tuple[Array, Array]:
        return self.cubic * x**3, state


@dataclass(frozen=True)
class Backlash(JointLaw):
    """k · dead zone of φ, total width `gap`; the damper stays beside it."""

    gap: float

    def rest(self, torque: float) -> float:
        """On the flank that the torque presses; in the middle of the gap when there is none (below 1e-6 N·m)."""
        return torque / float(self.k) + float(np.sign(round(torque, 6))) * self.gap / 2

    def tangent(self, torque: float) -> tuple[float, float]:
        return (0.0 if round(torque, 6) or not self.gap else -float(self.k)), 0.0

    def extra(self, x: Array, v: Array, state: Array) -> tuple[Array, Array]:
        half = self.gap / 2
        return -self.k * np.minimum(np.maximum(x, -half), half), state


@dataclass(frozen=True)
class Slip(JointLaw):
    """Elastic–perfectly-plastic elements beside the spring, relaxed at rest."""

    stiffness: Array
    yield_torque: Array

    def tangent(self, torque: float) -> tuple[float, float]:
        return float(self.stiffness.sum()), 0.0

    def start(self, shape: tuple[int, ...]) -> Array:
        """Element torques and, last, the deflection they were reached at (NaN before the first step)."""
        return np.concatenate([np.zeros((self.stiffness.size, *shape)), np.full((1, *shape), np.nan)])

    def extra(self, x: Array, v: Array, state: Array) -> tuple[Array, Array]:
        lead = (slice(None), *(None,) * x.ndim)
        moved = np.where(np.isnan(state[-1]), 0.0, x - state[-1])
        limit = self.yield_torque[lead]
        new = np.empty_like(state)
        new[:-1] = np.minimum(np.maximum(state[:-1] + self.stiffness[lead] * moved, -limit), limit)
        new[-1] = x
        return new[:-1].sum(0), new


@dataclass(frozen=True)
class QuadraticDrag(JointLaw):
    """c φ̇|φ̇|, as of an eddy-current damper."""

    coefficient: float

    def extra(self, x: Array, v: Array, state: Array) -> tuple[Array, Array]:
        return self.coefficient * v * np.abs(v), state
