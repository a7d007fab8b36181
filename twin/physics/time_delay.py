"""A channel that is late; in a motion log, torque late against position."""

from typing import TYPE_CHECKING, Any

from twin.physics.effect import Effect, Parameter, Values
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class TimeDelay(Effect):
    """Natively: the ``delay`` of the accelerometer's sensor; in a log it acts on the record."""

    name = "time_delay"
    sites = ("sensor:LABEL", "log")
    parameters = (Parameter("delay", "s", spread=1e-3),)
    seen_in = frozenset({"hammer", "log"})
    steps = linear = False
    refers = True
    log_tests = ("jerk", "reversals", "speeds")

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if site != "log" and values["delay"] > 0:
            mechanism.sensor_delay[site.removeprefix("sensor:")] = values["delay"]

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        if site == "log":
            chain.torque_delay += values["delay"]
        else:
            chain.response_delay[chain.responses(site)] += values["delay"]

    def suspected(self, view: LogView) -> list[Suspected]:
        return [Suspected({"delay": 0.0}, [Prior("delay", 0.1 / view.rate_hz)], [[0.0]])]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None at all: an error of either sign."""
        return None if site == "log" else {"delay": 0.0}
