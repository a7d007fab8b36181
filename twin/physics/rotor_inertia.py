"""Reflected inertia the description does not have: N²J q̈ at the gear output."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import DESCRIBED, LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism

LEFT = 0.01  # of a rotor's described inertia, at least: one without inertia cannot be stepped


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

    def nearest(self, robot: "Robot", site: str, values: dict[str, Any]) -> dict[str, Any]:
        """No more inertia is taken off than the rotor has."""
        drive = robot.drives[axis_of(site)]
        return {**values, "inertia": max(values["inertia"], (LEFT - 1) * drive.gear_ratio**2 * drive.rotor_inertia)}

    def suspected(self, view: LogView) -> list[Suspected]:
        size = Prior("inertia", view.size({"inertia": 1.0}))
        return [Suspected({"inertia": 0.0}, [size], [[0.0]], passive=False)]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["inertia"] * motion.acceleration[:, i]}
