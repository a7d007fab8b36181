"""A triaxial accelerometer turned on its node: recorded = Rz(c) Ry(b) Rx(a) true."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.robot.description import Robot


class SensorMisalignment(Effect):
    """Acts on all channels of a node; the angles are about the axes of the body's frame."""

    name = "sensor_misalignment"
    sites = ("sensor:NODE",)
    parameters = (Parameter("angles", "rad", length=3, spread=0.05),)
    seen_in = frozenset({"hammer"})

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        (ca, cb, cc), (sa, sb, sc) = np.cos(values["angles"]), np.sin(values["angles"])
        turn_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
        turn_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
        turn_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
        rows = chain.node_responses(site)
        # a channel reads dᵀ R a, so its effective direction is Rᵀ d
        chain.response_direction[rows] = chain.response_direction[rows] @ (turn_z @ turn_y @ turn_x)

    def tolerances(self, robot: "Robot") -> dict[str, float]:
        return {"angles": float(np.deg2rad(robot.tolerances.direction_deg))}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None at all: an error of either sign."""
        return {"angles": [0.0, 0.0, 0.0]}
