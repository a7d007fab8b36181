"""Friction that grows with the torque through the gear: μ |τ_load| sgn q̇."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class LoadDependentFriction(Effect):
    """Written as a passive force."""

    name = "load_dependent_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficient", "1"),)
    seen_in = frozenset({"log"})
    at_drive = True
    role = "friction"
    refers = True
    log_tests = ("load", "speeds")

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def suspected(self, view: LogView) -> list[Suspected]:
        size = Prior("coefficient", view.size({"coefficient": 1.0}))
        return [Suspected({"coefficient": 0.0}, [size], [[0.0]], passive=True)]

    def turning_under(self, values: Values, motion: "Motion", site: str, dry: float) -> np.ndarray:
        return np.asarray(values["coefficient"] * np.abs(motion.load[:, axis_of(site)]))

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["coefficient"] * np.abs(motion.load[:, i]) * motion.sign(motion.velocity[:, i])}
