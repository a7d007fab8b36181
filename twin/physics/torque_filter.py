"""The recorder's own low-pass on torque, of first order: recorded = true e^{s lead} / (1 + s/(2π f_c))."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values
from twin.physics.statements import LogView, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain

USUAL_HZ = (4.0, 7.0, 12.0, 20.0, 40.0)  # cutoffs from which a search starts


class TorqueFilter(Effect):
    """Acts on the record of all joints alike. Far below its cutoff it is a delay of 1/(2π f_c).

    ``lead`` is 0 for a filter of wires. One that computes y_k = a y_{k−1} + (1 − a) x_k answers half a sample sooner.
    """

    name = "torque_filter"
    sites = ("log",)
    parameters = (Parameter("cutoff_hz", "Hz", np.inf, positive=True), Parameter("lead", "s", optional=True))
    seen_in = frozenset({"log"})
    steps = linear = False
    refers = True
    log_tests = ("jerk", "reversals", "speeds")

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.torque_lag += 1 / (2 * np.pi * values["cutoff_hz"])
        chain.torque_delay -= values["lead"]

    def suspected(self, view: LogView) -> list[Suspected]:
        middle = USUAL_HZ[len(USUAL_HZ) // 2]
        quarter = 0.25 / view.sample_hz  # half-way between wires and numbers
        own = [scale("cutoff_hz", middle, 3.0), Prior("lead", quarter, quarter)]
        starts = [[hz, quarter] for hz in USUAL_HZ]
        return [Suspected({"cutoff_hz": middle, "lead": quarter}, own, starts, sizes=())]
