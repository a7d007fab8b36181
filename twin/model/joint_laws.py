"""Laws of amplitude that may act at a joint and have no name in the vocabulary: rivals of those that have one."""

from dataclasses import dataclass

import numpy as np

from twin.measure.campaign import FloatArray
from twin.physics.joint_law import USUAL_DEFLECTION, Law

SWING = 2 * np.pi * 12.0  # rad/s: at which joints swing


@dataclass(frozen=True)
class Drag(Law):
    """c φ̇ |φ̇|: a loss that grows in proportion to amplitude. No law of the vocabulary does.

    Attributes:
        rate_hz: of the steps that φ̇ is taken from, by differences backwards of second order.
    """

    rate_hz: float = 1024.0

    effect, names, units, power = "quadratic damping", ("coefficient",), ("N·m·s²/rad²",), -1.0
    finer = 2

    def stepped(self, rate_hz: float) -> "Drag":
        return Drag(rate_hz)

    def state(self, blows: int) -> FloatArray:
        """The last step of φ, and φ."""
        return np.zeros((2, blows))

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        way = x - state[1]
        speed = (1.5 * way - 0.5 * state[0]) * self.rate_hz
        return sizes[0] * speed * np.abs(speed), np.array([way, x])

    def usual(self, k: float) -> FloatArray:
        return np.array([0.1 * k / (USUAL_DEFLECTION * SWING**2)])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (k / (amplitude * SWING**2) * np.geomspace(1e-4, 10.0, 11))[:, None]


class Progressive(Law):
    """k₂ φ |φ|: a stiffness that grows in proportion to amplitude. No law of the vocabulary does."""

    effect, names, units, power = "quadratic stiffness", ("coefficient",), ("N·m/rad²",), -1.0

    def rest(self, k: FloatArray, load: FloatArray, sizes: FloatArray) -> FloatArray:
        root = np.sqrt(k**2 + 4 * sizes[0] * np.abs(load))
        return np.asarray(2 * load / (k + root))

    def tangent(self, rest: FloatArray, sizes: FloatArray) -> FloatArray:
        return np.asarray(2 * sizes[0] * np.abs(rest))

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        return sizes[0] * x * np.abs(x), state

    def usual(self, k: float) -> FloatArray:
        return np.array([0.1 * k / USUAL_DEFLECTION])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (k / amplitude * np.geomspace(1e-4, 10.0, 11))[:, None]


NAMELESS: tuple[Law, ...] = (Drag(), Progressive())
"""Laws that may act at a joint but have no name: rivals of those that have one."""
