"""A torque that repeats with the joint angle: A sin(order·q + phase), order per joint turn."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class TorqueRipple(Effect):
    """Natively: a cogging element on the motor's joint."""

    name = "torque_ripple"
    sites = ("joint{i}",)
    parameters = (Parameter("amplitude", "N·m"), Parameter("order", "1"), Parameter("phase", "rad"))
    seen_in = frozenset({"log"})

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            amplitude, order, phase = values["amplitude"], values["order"], values["phase"]
            mechanism.passive_motor(f"{site}.ripple", motor.name, cogging=(-amplitude, order, phase))

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        angle = values["order"] * motion.position[:, i] + values["phase"]
        return {i: values["amplitude"] * np.sin(angle)}
