"""A motor's torque constant that is off: recorded = gain × true."""

from typing import TYPE_CHECKING

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain


class TorqueConstant(Effect):
    """Acts on the recorded torque of one axis."""

    name = "torque_constant"
    sites = ("joint{i}",)
    parameters = (Parameter("gain", "1", 1.0),)
    seen_in = frozenset({"log"})
    steps = False
    refers = True
    log_tests = ("mass", "sweep")

    def suspected(self, view: LogView) -> list[Suspected]:
        return [Suspected({"gain": 1.0}, [Prior("gain", 0.05, 1.0)], [[1.0]])]

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.torque_gain[axis_of(site)] *= values["gain"]
