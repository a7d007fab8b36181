"""Play in the gear: a dead zone of total width ``gap`` in series with the spring."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.physics.effect import Effect, Parameter, Values
from twin.physics.joint_law import NO_LOAD, USUAL_DEFLECTION, FloatArray, Law

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class Gap(Law):
    """−k · clip(φ, ±gap/2)."""

    effect, names, units, power = "backlash", ("gap",), ("rad",), 1.0
    finer = 2

    def rest(self, k: FloatArray, load: FloatArray, sizes: FloatArray) -> FloatArray:
        side = np.where(np.abs(load) > NO_LOAD, np.sign(load), 0.0)
        return np.asarray(load / k + side * sizes[0] / 2)

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        half = 0.5 * sizes[0]
        return -k * np.minimum(np.maximum(x, -half), half), state

    def line(
        self, x: tuple[FloatArray, FloatArray], g: tuple[FloatArray, FloatArray], k: FloatArray, sizes: FloatArray
    ) -> tuple[NDArray[np.intp], FloatArray, FloatArray] | None:
        """A step may cross the whole gap: the line gets the mean of the torque over the way, and its first moment."""
        half = 0.5 * sizes[0]
        (across,) = (((x[0] > half) != (x[1] > half)) | ((x[0] < -half) != (x[1] < -half))).nonzero()
        if not len(across):
            return None
        k, ends = k[across], np.array([x[0][across], x[1][across]])
        V, W = _primitives(ends, half[across])
        way = ends[1] - ends[0]
        per = k / way
        mean = per * (V[1] - V[0])
        moment = 6 * per * (V[1] - (W[1] - W[0]) / way)
        return across, moment - 4 * mean - g[0][across], 2 * mean - moment - g[1][across]

    def usual(self, k: float) -> FloatArray:
        return np.array([USUAL_DEFLECTION])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (amplitude * np.geomspace(1e-3, 3.0, 14))[:, None]


def _primitives(x: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second integral of clip(x, ±half)."""
    c = np.minimum(np.maximum(x, -half), half)
    V = c * (x - c / 2)
    return V, 0.5 * (x * V + c * c * (c / 3 - x / 2))


class Backlash(Effect):
    """Natively: the spring moves from the hinge to a fixed tendon with a dead band; the damper stays on the hinge."""

    name = "backlash"
    sites = ("joint{i}.z",)
    parameters = (Parameter("gap", "rad", nonnegative=True),)
    seen_in = frozenset({"levels", "log"})
    part = "play"
    log_tests = ("speeds",)
    amplitude_law = Gap()

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if joint := mechanism.joint(site):
            joint.dead_zone = values["gap"]
