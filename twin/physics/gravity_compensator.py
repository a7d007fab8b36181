"""A spring or gas cylinder that relieves a joint: Σ B_l cos(l q), l = 1, 2, 3, added to the recorded drive torque."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class GravityCompensator(Effect):
    """Natively: three cogging elements on the motor's joint, cos(l q) = sin(l q + π/2). B₁ < 0 unloads the motor."""

    name = "gravity_compensator"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficients", "N·m", length=3),)
    seen_in = frozenset({"log"})
    role = "load"

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            for order, coefficient in enumerate(values["coefficients"], start=1):
                mechanism.passive_motor(
                    f"{site}.compensator{order}", motor.name, cogging=(-coefficient, order, np.pi / 2)
                )

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        orders = np.arange(1, 4)
        return {i: np.cos(np.outer(motion.position[:, i], orders)) @ np.array(values["coefficients"], float)}
