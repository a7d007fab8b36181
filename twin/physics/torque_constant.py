"""A motor's torque constant that is off: recorded = gain × true."""

from typing import TYPE_CHECKING

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain


class TorqueConstant(Effect):
    """Acts on the recorded torque of one axis."""

    name = "torque_constant"
    sites = ("joint{i}",)
    parameters = (Parameter("gain", "1", 1.0),)
    seen_in = frozenset({"log"})

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.torque_gain[axis_of(site)] *= values["gain"]
