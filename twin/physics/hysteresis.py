"""Slip that remembers: elastic–perfectly-plastic elements in parallel (Maxwell slip), beside the spring.

On the deflection φ while the rotor is held (hammer tests); on q when it moves (motion logs).
"""

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LinearPart, LogView, Part, Prior, Suspected, scale

NO_STRENGTH = 1e-12  # N·m: stands for a slip element of none, whose yield travel must stay as described

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Joint, Mechanism


class Hysteresis(Effect):
    """Natively: one fixed tendon with ``springyield`` per element; its slip is state, ``mjData.plastic``."""

    name = "hysteresis"
    sites = ("joint{i}.z",)
    parameters = (
        Parameter("stiffness", "N·m/rad", length=-1, nonnegative=True),
        Parameter("yield_torque", "N·m", length=-1, nonnegative=True),
    )
    seen_in = frozenset({"levels", "log"})
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
        start = 0.0 if joint.elastic else float(mechanism.q[axis])  # unslipped where the motion begins
        for number, (stiffness, torque) in enumerate(zip(values["stiffness"], values["yield_torque"], strict=True)):
            if stiffness > 0 and torque > 0:
                mechanism.tendon(
                    f"{site}.slip{number + 1}",
                    {joint.name: 1.0},
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

    def turning(self, values: Values, velocity: np.ndarray) -> float:
        """Slip is a part of dry friction that turns round in its own way."""
        return -float(np.sum(values["yield_torque"]))

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
