"""A law of amplitude: what a joint adds to the torque k φ of its spring, as a diagnosis steps and fits it.

An effect that shows in force levels states one (:attr:`twin.physics.effect.Effect.amplitude_law`). Laws act on many
blows at a time. φ counts from the unloaded spring, so that the weight a joint carries presses a gap shut and shifts the
working point of a cubic spring.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.physics.effect import Values

FloatArray = NDArray[np.float64]

USUAL_DEFLECTION = 5e-5  # rad: of a joint under a blow
NO_LOAD = 1e-6  # N·m: a vertical axis carries none


class Law:
    """How one effect's torque depends on amplitude and history; c blows side by side.

    Attributes:
        effect: identifier of the effect whose law it is; of a law without an entry, what it is called.
        power: of the deflection, to which sizes that act alike are in proportion.
        finer: steps it takes in the time of one of a smooth law.
        shown: the entry's parameter that tells how large it is, a list by its sum; by default the first size.
    """

    effect: str
    power: float
    finer = 1
    shown = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the sizes a fit seeks, m of them."""
        raise NotImplementedError

    @property
    def units(self) -> tuple[str, ...]:
        """Of the sizes."""
        raise NotImplementedError

    @property
    def deviations(self) -> tuple[float, ...]:
        """Prior deviation of the logarithm of every size."""
        return (1.5,) * len(self.names)

    def usual(self, k: float) -> FloatArray:
        """Sizes (m,) in the centre of the prior, for a joint of stiffness k."""
        raise NotImplementedError

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, Any]:
        """The values of an entry that acts on deflections so many times larger as the sizes do on these."""
        return {self.names[0]: float(sizes[0] * larger**self.power)}

    def described(self, values: Values) -> tuple["Law", FloatArray]:
        """The law that an entry describes, and its sizes (m,)."""
        return self, np.array([float(values[self.names[0]])])

    def rest(self, k: FloatArray, load: FloatArray, sizes: FloatArray) -> FloatArray:
        """φ (c,) at which spring (c,) and law (m, c) carry a load (c,)."""
        return load / k

    def tangent(self, rest: FloatArray, sizes: FloatArray) -> FloatArray:
        """What the law adds to the spring (c,) for small motions about rest (c,), where that is most of it."""
        return np.zeros_like(rest)

    def state(self, blows: int) -> FloatArray:
        """Memory at rest."""
        return np.zeros((0, blows))

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Torque (c,) beside k φ when φ becomes x (c,), and the new memory."""
        raise NotImplementedError

    def line(
        self, x: tuple[FloatArray, FloatArray], g: tuple[FloatArray, FloatArray], k: FloatArray, sizes: FloatArray
    ) -> tuple[NDArray[np.intp], FloatArray, FloatArray] | None:
        """Which blows go over a kink in a step from x[0] to x[1], torques g there, and what is then added to the start
        and the end of the torque's line in time; ``None`` for a law that is smooth over a step."""
        return None

    def stepped(self, rate_hz: float) -> "Law":
        """The law as it acts on φ at steps of 1/rate."""
        return self

    def at(self, amplitude: float) -> "Law":
        """The law as it is sought where blows deflect the joint by ``amplitude``."""
        return self

    def settling(self) -> "Law":
        """The law as it is settled, once it is found: with more sizes after its own, if it has such."""
        return self

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        """Sizes (ns, m) worth starting from, for a joint of stiffness k that blows deflect by ``amplitude``."""
        raise NotImplementedError
