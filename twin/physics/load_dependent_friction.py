"""Friction that grows with the torque through the gear: μ |τ_load| sgn q̇."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class LoadDependentFriction(Effect):
    """Written as a passive force."""

    name = "load_dependent_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficient", "1"),)
    seen_in = frozenset({"log"})
    role = "friction"

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["coefficient"] * np.abs(motion.load[:, i]) * motion.sign(motion.velocity[:, i])}
