"""Friction that depends on the direction: F_c and F_v for q̇ > 0 minus those for q̇ < 0."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.motion import sliding
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class AsymmetricFriction(Effect):
    """Half of each difference is added in one direction and taken off in the other. Written as a passive force."""

    name = "asymmetric_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("torque_difference", "N·m"), Parameter("viscous_difference", "N·m·s/rad"))
    seen_in = frozenset({"log"})
    at_drive = True
    role = "friction"
    linear_in = ("torque_difference", "viscous_difference")
    leaning = True
    log_tests = ("speeds",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def suspected(self, view: LogView) -> list[Suspected]:
        none = dict.fromkeys(self.linear_in, 0.0)
        own = [Prior(name, view.size({**none, name: 1.0})) for name in self.linear_in]
        return [Suspected(none, own, [[0.0, 0.0]], (0, 1))]

    def uneven(self, values: Values) -> float:
        return float(0.5 * values["torque_difference"])

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        speed, sign = motion.velocity[:, i], motion.sign(motion.velocity[:, i])
        dry = values["torque_difference"] * sliding(motion.time, sign)
        return {i: 0.5 * (dry + values["viscous_difference"] * speed * sign)}
