"""An accelerometer with a wrong calibration: recorded = gain × true."""

from typing import TYPE_CHECKING, Any

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.robot.description import Robot


class SensorGain(Effect):
    """Acts on one response channel."""

    name = "sensor_gain"
    sites = ("sensor:LABEL",)
    parameters = (Parameter("gain", "1", 1.0, spread=0.1),)
    seen_in = frozenset({"hammer"})

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        chain.response_gain[chain.responses(site)] *= values["gain"]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None at all: an error of either sign."""
        return {"gain": 1.0}
