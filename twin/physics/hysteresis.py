"""Slip that remembers: elastic–perfectly-plastic elements in parallel (Maxwell slip), beside the spring.

On the deflection φ while the rotor is held (hammer tests); on q when it moves (motion logs).
"""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


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

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        axis = axis_of(site)
        joint = mechanism.motor(axis) or mechanism.joint(site)
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
        stiffness, limit = np.array(values["stiffness"], float), np.array(values["yield_torque"], float)
        x = motion.position[:, axis]
        direction = np.sign(np.diff(x))
        turns = np.flatnonzero(direction[1:] * direction[:-1] < 1) + 1  # between two an element loads one way
        element = np.zeros_like(stiffness)
        total = np.zeros_like(x)
        for first, last in zip([0, *turns], [*turns, len(x) - 1], strict=True):
            loaded = np.clip(element + np.outer(x[first + 1 : last + 1] - x[first], stiffness), -limit, limit)
            total[first + 1 : last + 1] = loaded.sum(axis=1)
            element = loaded[-1] if len(loaded) else element
        return {axis: total}
