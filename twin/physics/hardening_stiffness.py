"""A gear that stiffens with wind-up: torque k φ + k₃ φ³."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values
from twin.physics.joint_law import USUAL_DEFLECTION, FloatArray, Law

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class Cubic(Law):
    """k₃ φ³."""

    effect, names, units, power = "hardening_stiffness", ("cubic",), ("N·m/rad³",), -2.0

    def rest(self, k: FloatArray, load: FloatArray, sizes: FloatArray) -> FloatArray:
        """Newton's method from the linear deflection, which lies beyond the root."""
        x = load / k
        for _ in range(20):
            x = x - (k * x + sizes[0] * x * x * x - load) / (k + 3 * sizes[0] * x * x)
        return x

    def tangent(self, rest: FloatArray, sizes: FloatArray) -> FloatArray:
        return np.asarray(3 * sizes[0] * rest * rest)

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        return sizes[0] * x * x * x, state

    def usual(self, k: float) -> FloatArray:
        return np.array([0.1 * k / USUAL_DEFLECTION**2])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (k / amplitude**2 * np.geomspace(1e-4, 10.0, 11))[:, None]


class HardeningStiffness(Effect):
    """Natively: the third coefficient of the hinge's polynomial ``stiffness``."""

    name = "hardening_stiffness"
    sites = ("joint{i}.z",)
    parameters = (Parameter("cubic", "N·m/rad³"),)
    seen_in = frozenset({"levels"})
    amplitude_law = Cubic()

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if joint := mechanism.joint(site):
            joint.stiffness[2] = values["cubic"]
