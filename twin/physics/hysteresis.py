"""Slip that remembers: elastic–perfectly-plastic elements in parallel (Maxwell slip), beside the spring.

On the deflection φ while the rotor is held (hammer tests); on q when it moves (motion logs).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.joint_law import USUAL_DEFLECTION, FloatArray, Law
from twin.physics.statements import LinearPart, LogView, Part, Prior, Suspected, scale

NO_STRENGTH = 1e-12  # N·m: stands for a slip element of none, whose yield travel must stay as described

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Joint, Mechanism

YIELDS = np.geomspace(0.01, 2.6, 13)
"""Deflections at which the elements sought in force levels yield, over one that one blow in ten exceeds."""


@dataclass(frozen=True)
class Slip(Law):
    """Elastic–perfectly-plastic elements in parallel (Maxwell slip) that yield at given deflections.

    With yields spread over the deflections that blows cause, only the stiffnesses are sought (Prandtl and Ishlinskii's
    model): sought freely, a yield that no blow reaches or that all exceed has no pull on it.

    Attributes:
        reach: rad (m), the deflection at which each element yields.
    """

    reach: tuple[float, ...] = tuple(USUAL_DEFLECTION * YIELDS)

    effect = "hysteresis"
    power = 0.0
    shown = "yield_torque"

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"stiffness[{i}]" for i in range(len(self.reach)))

    @property
    def units(self) -> tuple[str, ...]:
        return ("N·m/rad",) * len(self.reach)

    def described(self, values: Values) -> tuple[Law, FloatArray]:
        stiffness, torque = (np.array(values[name], float) for name in ("stiffness", "yield_torque"))
        return Slip(tuple(torque / np.maximum(stiffness, np.finfo(float).tiny))), stiffness

    def at(self, amplitude: float) -> "Slip":
        return Slip(tuple(amplitude * YIELDS))

    def settling(self) -> Law:
        return SlipAnywhere(self.reach)

    def tangent(self, rest: FloatArray, sizes: FloatArray) -> FloatArray:
        """All elements stick."""
        return np.asarray(sizes[: len(self.reach)].sum(axis=0))

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, Any]:
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

    @property
    def deviations(self) -> tuple[float, ...]:
        """A yield may lie half the way to the next."""
        return (*super().deviations[: len(self.reach)], *[0.25] * len(self.reach))

    def usual(self, k: float) -> FloatArray:
        return np.concatenate([super().usual(k), self.reach])

    def entry(self, sizes: FloatArray, larger: float = 1.0) -> dict[str, Any]:
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


class Hysteresis(Effect):
    """Natively: one fixed tendon with ``springyield`` per element; its slip is state, ``mjData.plastic``."""

    name = "hysteresis"
    sites = ("joint{i}.z",)
    parameters = (
        Parameter("stiffness", "N·m/rad", length=-1, nonnegative=True),
        Parameter("yield_torque", "N·m", length=-1, nonnegative=True),
    )
    seen_in = frozenset({"levels", "log"})
    at_drive = True
    amplitude_law: ClassVar[Law | None] = Slip()
    role = "friction"
    linear_in = ("yield_torque",)
    refines: ClassVar[Part] = "dry"
    memory = True
    elements = ("yield_torque", "stiffness")
    log_tests = ("reversals", "speeds")

    def check(self, values: Values) -> str | None:
        if len(values["stiffness"]) != len(values["yield_torque"]):
            return "stiffness and yield_torque: expected lists of one length"
        return None

    def joint(self, mechanism: "Mechanism", site: str) -> "Joint | None":
        """The joint that the elements act on, if there is one."""
        return mechanism.motor(axis_of(site)) or mechanism.joint(site)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        axis = axis_of(site)
        joint = self.joint(mechanism, site)
        if joint is None:
            return
        turns = {joint.name: 1.0} if joint.elastic else mechanism.turns(axis)
        start = 0.0 if joint.elastic else float((mechanism.robot.coupling @ mechanism.q)[axis])  # unslipped at first
        for number, (stiffness, torque) in enumerate(zip(values["stiffness"], values["yield_torque"], strict=True)):
            if stiffness > 0 and torque > 0:
                mechanism.tendon(
                    f"{site}.slip{number + 1}",
                    turns,
                    stiffness=stiffness,
                    springyield=torque / stiffness,
                    springlength=(start, start),
                )

    def suspected(self, view: LogView) -> list[Suspected]:
        usual = view.usual()
        _, half = view.middle()
        middle = usual / (1e-3 * max(half, 1e-3))
        own = [Prior("yield_torque[0]", usual), scale("stiffness[0]", middle, 10.0)]
        starts = [[usual, usual / (travel * max(half, 1e-3))] for travel in np.geomspace(3e-5, 3e-2, 7)]
        return [Suspected({"yield_torque": [usual], "stiffness": [middle]}, own, starts, ())]

    def part_of_dry(self, values: Values, velocity: np.ndarray) -> float:
        """All of it: slip is a part of dry friction that turns round in its own way."""
        return float(np.sum(values["yield_torque"]))

    def travel(self, elements: np.ndarray) -> np.ndarray:
        torque, stiffness = elements.T
        return np.asarray(2 * torque / stiffness)

    def another(self, elements: np.ndarray, factor: float) -> np.ndarray:
        """Of half the strongest's torque."""
        torque, stiffness = elements[np.argmax(elements[:, 0])]
        return np.array([0.5 * torque, 0.5 * stiffness / factor])

    def linear_parts(self, values: Values) -> list[LinearPart]:
        """Every element's yield torque, its travel as described."""
        limits = np.maximum(values["yield_torque"], NO_STRENGTH)
        travels = limits / np.maximum(values["stiffness"], NO_STRENGTH)
        return [
            LinearPart(
                f"yield_torque[{k + 1}]", "N·m", float(limits[k]),
                {"yield_torque": [1.0], "stiffness": [1.0 / travel]},
            )
            for k, travel in enumerate(travels)
        ]  # fmt: skip

    def with_linear(self, values: Values, found: list[float]) -> dict[str, Any]:
        limits = np.maximum(found, 0.0)
        described = np.maximum(values["yield_torque"], NO_STRENGTH)
        travel = described / np.maximum(values["stiffness"], NO_STRENGTH)
        return {"yield_torque": limits.tolist(), "stiffness": (limits / travel).tolist()}

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        axis = axis_of(site)
        x = motion.position[:, axis]
        step = np.diff(x)
        moves = np.flatnonzero(step)
        turns = moves[1:][step[moves[1:]] * step[moves[:-1]] < 0]  # between two an element loads one way
        ends = np.concatenate([[0], turns, [len(x) - 1]])
        lasting = np.diff(ends)  # samples from one turn to the next, the first of all with the first
        lasting[0] += 1
        passed = x - np.repeat(x[ends[:-1]], lasting)
        total = np.zeros_like(x)
        for stiffness, limit in zip(values["stiffness"], values["yield_torque"], strict=True):
            element, loads = 0.0, [0.0]
            for travel in (stiffness * np.diff(x[ends])).tolist():
                element = min(max(element + travel, -limit), limit)
                loads.append(element)
            torque = stiffness * passed
            torque += np.repeat(loads[:-1], lasting)
            total += np.clip(torque, -limit, limit, out=torque)
        return {axis: total}
