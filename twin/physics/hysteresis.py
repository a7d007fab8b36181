"""Slip that remembers: elastic–perfectly-plastic elements in parallel (Maxwell slip), beside the spring.

On the deflection φ while the rotor is held (hammer tests); on q when it moves (motion logs).
"""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

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
