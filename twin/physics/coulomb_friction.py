"""Dry friction: F_c sgn q̇."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.doubt import Weight
    from twin.physics.motion import Motion
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism

MOST_FRICTION = 30.0  # times the robot's weight at arm's length, as torques of a log


class CoulombFriction(Effect):
    """Natively: ``frictionloss`` of the motor's joint (a regularised constraint; disabled for modes)."""

    name = "coulomb_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("torque", "N·m", nonnegative=True),)
    seen_in = frozenset({"log"})
    at_drive = True
    role = "friction"
    part = "dry"
    linear_in = least_zero = ("torque",)
    log_tests = ("speeds",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.drive(axis_of(site)):
            motor.frictionloss += values["torque"]

    def doubts(self, robot: "Robot", site: str, values: Values, weight: "Weight") -> list[tuple[str, str]]:
        torque, turns = values["torque"], robot.axes[axis_of(site)].type == "revolute"
        if not turns or not weight.torque or torque <= MOST_FRICTION * weight.torque:
            return []
        text = f"{torque:g} N·m, and its weight at arm's length makes {weight.torque:.3g}: is it in N·mm?"
        return [("torque", text)]

    def suspected(self, view: LogView) -> list[Suspected]:
        size = Prior("torque", view.size({"torque": 1.0}))
        return [Suspected({"torque": 0.0}, [size], [[0.0]], passive=True)]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["torque"] * motion.sign(motion.velocity[:, i])}
