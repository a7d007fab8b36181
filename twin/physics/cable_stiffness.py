"""A hose pack that pulls back: k (q − q₀)."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class CableStiffness(Effect):
    """Natively: a spring on the motor's joint."""

    name = "cable_stiffness"
    sites = ("joint{i}",)
    parameters = (Parameter("stiffness", "N·m/rad"), Parameter("rest", "rad"))
    seen_in = frozenset({"log"})

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            motor.stiffness[0] += values["stiffness"]
            motor.springref = values["rest"]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["stiffness"] * (motion.position[:, i] - values["rest"])}
