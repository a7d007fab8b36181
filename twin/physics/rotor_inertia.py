"""Reflected inertia the description does not have: N²J q̈ at the gear output."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import DESCRIBED, LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class RotorInertia(Effect):
    """Natively: ``armature`` of the motor's joint."""

    name = "rotor_inertia"
    sites = ("joint{i}",)
    parameters = (Parameter("inertia", "kg·m²"),)
    seen_in = frozenset({"log"})
    at_drive = True
    part = "inertia"
    steps = False
    linear_in = least_zero = ("inertia",)
    doubt = DESCRIBED
    log_tests = ("acceleration", "sweep")

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.drive(axis_of(site)):
            motor.armature += values["inertia"]

    def suspected(self, view: LogView) -> list[Suspected]:
        size = Prior("inertia", view.size({"inertia": 1.0}))
        return [Suspected({"inertia": 0.0}, [size], [[0.0]], passive=False)]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["inertia"] * motion.acceleration[:, i]}
