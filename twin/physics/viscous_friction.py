"""Friction of oil and seals: F_v q̇."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class ViscousFriction(Effect):
    """Natively: ``damping`` of the motor's joint."""

    name = "viscous_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficient", "N·m·s/rad"),)
    seen_in = frozenset({"log"})
    at_drive = True
    role = "friction"
    part = "viscous"
    steps = False
    linear_in = least_zero = ("coefficient",)
    log_tests = ("speeds",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.drive(axis_of(site)):
            motor.damping[0] += values["coefficient"]

    def suspected(self, view: LogView) -> list[Suspected]:
        size = Prior("coefficient", view.size({"coefficient": 1.0}))
        return [Suspected({"coefficient": 0.0}, [size], [[0.0]], passive=True)]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["coefficient"] * motion.velocity[:, i]}
