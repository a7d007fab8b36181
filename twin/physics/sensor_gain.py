"""An accelerometer with a wrong calibration: recorded = gain × true."""

from typing import TYPE_CHECKING

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain


class SensorGain(Effect):
    """Acts on one response channel."""

    name = "sensor_gain"
    sites = ("sensor:LABEL",)
    parameters = (Parameter("gain", "1", 1.0),)
    seen_in = frozenset({"hammer"})

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.response_gain[chain.responses(site)] *= values["gain"]
