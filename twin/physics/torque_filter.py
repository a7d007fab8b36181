"""The recorder's own low-pass on torque, of first order: recorded = true / (1 + s/(2π f_c))."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values
from twin.physics.statements import LogView, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain

USUAL_HZ = (4.0, 7.0, 12.0, 20.0, 40.0)  # cutoffs from which a search starts


class TorqueFilter(Effect):
    """Acts on the record of all joints alike. Far below its cutoff it is a delay of 1/(2π f_c)."""

    name = "torque_filter"
    sites = ("log",)
    parameters = (Parameter("cutoff_hz", "Hz", np.inf, positive=True),)
    seen_in = frozenset({"log"})
    steps = linear = False
    refers = True
    log_tests = ("reversals", "speeds")

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.torque_lag += 1 / (2 * np.pi * values["cutoff_hz"])

    def suspected(self, view: LogView) -> list[Suspected]:
        middle = USUAL_HZ[len(USUAL_HZ) // 2]
        own = [scale("cutoff_hz", middle, 3.0)]
        return [Suspected({"cutoff_hz": middle}, own, [[hz] for hz in USUAL_HZ], sizes=())]
