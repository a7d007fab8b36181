"""A torque constant that is off, or falls as magnets warm: recorded = gain (1 + w (1 − exp(−t/T))) × true."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain


class TorqueConstant(Effect):
    """Acts on the recorded torque of one axis; t is the campaign's clock."""

    name = "torque_constant"
    sites = ("joint{i}",)
    parameters = (
        Parameter("gain", "1", 1.0),
        Parameter("warm_up", "1", optional=True),
        Parameter("time_constant", "s", np.inf, optional=True, positive=True),
    )
    seen_in = frozenset({"log"})
    steps = False
    refers = True
    log_tests = ("mass", "sweep")

    def suspected(self, view: LogView) -> list[Suspected]:
        warming = [Prior("warm_up", 0.05), scale("time_constant", 300.0, 3.0)]
        starts = [[0.0, T] for T in (30.0, 100.0, 250.0, 600.0, 1500.0)]
        return [
            Suspected({"gain": 1.0}, [Prior("gain", 0.05, 1.0)], [[1.0]]),
            Suspected({"gain": 1.0, "warm_up": 0.0, "time_constant": 300.0}, warming, starts),
        ]

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        axis = axis_of(site)
        chain.torque_gain[axis] *= values["gain"]
        if values["warm_up"]:
            chain.torque_warming[axis] = values["warm_up"], values["time_constant"]
