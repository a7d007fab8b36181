"""Friction that depends on the direction: F_c and F_v for q̇ > 0 minus those for q̇ < 0."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class AsymmetricFriction(Effect):
    """Half of each difference is added in one direction and taken off in the other. Written as a passive force."""

    name = "asymmetric_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("torque_difference", "N·m"), Parameter("viscous_difference", "N·m·s/rad"))
    seen_in = frozenset({"log"})
    role = "friction"

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        speed, sign = motion.velocity[:, i], motion.sign(motion.velocity[:, i])
        return {i: 0.5 * (values["torque_difference"] * sign**2 + values["viscous_difference"] * speed * sign)}
