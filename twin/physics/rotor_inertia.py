"""Reflected inertia the description does not have: N²J q̈ at the gear output."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class RotorInertia(Effect):
    """Natively: ``armature`` of the motor's joint."""

    name = "rotor_inertia"
    sites = ("joint{i}",)
    parameters = (Parameter("inertia", "kg·m²"),)
    seen_in = frozenset({"log"})

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            motor.armature += values["inertia"]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["inertia"] * motion.acceleration[:, i]}
