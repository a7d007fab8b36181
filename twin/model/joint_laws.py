"""Laws by which a joint's torque depends on amplitude and history, as a diagnosis fits them: what each adds to k φ.

The laws are those of ``twin/physics``; here they act on many blows at a time. φ counts from the unloaded spring, so
that the weight a joint carries presses a gap shut and shifts the working point of a cubic spring. Slip elements are
relaxed at rest.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter

REACH = np.geomspace(0.01, 2.6, 13)  # deflections at which slip elements yield, over one that one blow in ten exceeds
NEXT = 0.25  # prior deviation of the logarithm of a yield: half the way to the next
SPREAD = 1.5  # prior deviation of the logarithm of every size
USUAL_DEFLECTION = 5e-5  # rad: of a joint under a blow
USUAL_OMEGA = 2 * np.pi * 12.0  # rad/s: at which it swings
NO_LOAD = 1e-6  # N·m: a vertical axis carries none


class Law:
    """One amplitude law at a joint; c blows side by side.

    Attributes:
        effect: as in the vocabulary; ``names`` of its parameters in the order of the sizes.
        power: of the deflection, to which sizes that act alike are in proportion.
        finer: steps it takes in the time of one of a smooth law.
    """

    effect: str
    power: float
    finer = 1

    @property
    def names(self) -> tuple[str, ...]:
        raise NotImplementedError

    @property
    def units(self) -> tuple[str, ...]:
        raise NotImplementedError

    def parameters(self, key: str, k: float) -> tuple[Parameter, ...]:
        """Log-normal priors about the usual sizes at a joint of stiffness k; ``key`` is ``EFFECT@SITE``."""
        return tuple(
            Parameter(f"{key}.{name}", unit, "entry", True, float(mean), SPREAD, "usual size")
            for name, unit, mean in zip(self.names, self.units, self.usual(k), strict=True)
        )

    def usual(self, k: float) -> FloatArray:
        """Sizes (m,) in the centre of the prior, for a joint of stiffness k."""
        raise NotImplementedError

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, float | list[float]]:
        """The parameters of an entry that acts on deflections so many times larger as the sizes do on these."""
        return {self.names[0]: float(sizes[0] * larger**self.power)}

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
        mean = k * (V[1] - V[0]) / way
        moment = (k * V[1] - k * (W[1] - W[0]) / way) / way
        return across, 6 * moment - 4 * mean - g[0][across], 2 * mean - 6 * moment - g[1][across]

    def usual(self, k: float) -> FloatArray:
        return np.array([USUAL_DEFLECTION])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (amplitude * np.geomspace(1e-3, 3.0, 14))[:, None]


def _primitives(x: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second integral of clip(x, ±half)."""
    c = np.minimum(np.maximum(x, -half), half)
    V = c * (x - c / 2)
    return V, 0.5 * (x * V + c * c * (c / 3 - x / 2))


@dataclass(frozen=True)
class Slip(Law):
    """Elastic–perfectly-plastic elements in parallel (Maxwell slip) that yield at given deflections.

    With yields spread over the deflections that blows cause, only the stiffnesses are sought (Prandtl and Ishlinskii's
    model): sought freely, a yield that no blow reaches or that all exceed has no pull on it.

    Attributes:
        reach: rad (m), the deflection at which each element yields.
    """

    reach: tuple[float, ...] = tuple(USUAL_DEFLECTION * REACH)

    effect = "hysteresis"
    power = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"stiffness[{i}]" for i in range(len(self.reach)))

    @property
    def units(self) -> tuple[str, ...]:
        return ("N·m/rad",) * len(self.reach)

    def at(self, amplitude: float) -> "Slip":
        return Slip(tuple(amplitude * REACH))

    def settling(self) -> Law:
        return SlipAnywhere(self.reach)

    def tangent(self, rest: FloatArray, sizes: FloatArray) -> FloatArray:
        """All elements stick."""
        return np.asarray(sizes[: len(self.reach)].sum(axis=0))

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, float | list[float]]:
        values = [float(v) for v in sizes]
        yields = [k * x * larger for k, x in zip(values, self.reach, strict=True)]
        return {"stiffness": values, "yield_torque": yields}

    def state(self, blows: int) -> FloatArray:
        """How far every element is strained, then the deflection they were strained at."""
        return np.zeros((len(self.reach) + 1, blows))

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        return _slipped(x, sizes, np.array(self.reach)[:, None], state)

    def usual(self, k: float) -> FloatArray:
        return np.full(len(self.reach), 0.15 * k / len(self.reach))

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        steps = np.arange(len(self.reach)) / (len(self.reach) - 1)
        shapes = [tilt**steps / np.sum(tilt**steps) for tilt in (0.1, 1.0, 10.0)]
        return np.array([share * k * shape for share in (0.01, 0.03, 0.1, 0.3) for shape in shapes])


@dataclass(frozen=True)
class SlipAnywhere(Slip):
    """The same with the yields sought too, from where stiffnesses were found: a few elements bend as many do only
    where they yield in the right places.

    The sizes are stiffnesses, then the deflections at which they yield.
    """

    @property
    def names(self) -> tuple[str, ...]:
        return (*super().names, *(f"reach[{i}]" for i in range(len(self.reach))))

    @property
    def units(self) -> tuple[str, ...]:
        return (*super().units, *["rad"] * len(self.reach))

    def settling(self) -> Law:
        return self

    def parameters(self, key: str, k: float) -> tuple[Parameter, ...]:
        found = super().parameters(key, k)
        start = len(self.reach)
        return (*found[:start], *(replace(p, deviation=NEXT) for p in found[start:]))

    def usual(self, k: float) -> FloatArray:
        return np.concatenate([super().usual(k), self.reach])

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, float | list[float]]:
        stiffness, reach = np.split(sizes, 2)
        return {"stiffness": stiffness.tolist(), "yield_torque": (stiffness * reach * larger).tolist()}

    def torque(
        self, x: FloatArray, k: FloatArray, sizes: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        stiffness, limit = np.split(sizes, 2)
        return _slipped(x, stiffness, limit, state)


def _slipped(
    x: FloatArray, stiffness: FloatArray, limit: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Torque of elements (m, c) that are strained no further than their limit, and the new memory."""
    new = np.empty_like(state)
    strained = new[:-1]
    np.add(state[:-1], x - state[-1], out=strained)
    np.minimum(strained, limit, out=strained)
    np.maximum(strained, -limit, out=strained)
    new[-1] = x
    return np.einsum("pe,pe->e", stiffness, strained), new


LAWS: tuple[Law, ...] = (Cubic(), Gap(), Slip())
AMPLITUDE = frozenset(law.effect for law in LAWS)
"""Effects that answer differently to different force levels."""


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
        return np.array([0.1 * k / (USUAL_DEFLECTION * USUAL_OMEGA**2)])

    def sizes(self, k: float, amplitude: float) -> FloatArray:
        return (k / (amplitude * USUAL_OMEGA**2) * np.geomspace(1e-4, 10.0, 11))[:, None]


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
