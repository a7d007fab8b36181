"""Warm-up: all friction of a joint × (1 + a exp(−t/T)), t the campaign's clock."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class FrictionDrift(Effect):
    """Written as a passive force."""

    name = "friction_drift"
    sites = ("joint{i}",)
    parameters = (Parameter("amplitude", "1"), Parameter("time_constant", "s", positive=True))
    seen_in = frozenset({"log"})
    at_drive = True
    refers = ages = True
    log_tests = ("clock",)
    order = 3

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def suspected(self, view: LogView) -> list[Suspected]:
        own = [Prior("amplitude", 0.2), scale("time_constant", 300.0, 3.0)]
        starts = [[0.0, T] for T in (30.0, 100.0, 250.0, 600.0, 1500.0)]
        return [Suspected({"amplitude": 0.0, "time_constant": 300.0}, own, starts)]

    def turning_under(self, values: Values, motion: "Motion", site: str, dry: float) -> np.ndarray:
        return np.asarray(values["amplitude"] * np.exp(-motion.time / values["time_constant"]) * dry)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["amplitude"] * np.exp(-motion.time / values["time_constant"]) * motion.friction[:, i]}
