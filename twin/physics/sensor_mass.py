"""A sensor that goes from node to node and loads the one it sits on, and only while it sits there."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.robot.description import Robot


class SensorMass(Effect):
    """Acts on all channels of a node, along their directions; at ``sensor:*`` the same mass on every node in turn.

    Its inertia counts, not its weight, which `twin diagnose` takes off the FRFs.
    """

    name = "sensor_mass"
    sites = ("sensor:NODE", "sensor:*")
    parameters = (Parameter("mass", "kg", nonnegative=True, spread=1.5),)
    seen_in = frozenset({"hammer"})
    nodes = 2  # where there is one, what sits on it always sits there, and is a part of the robot

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        for rows in chain.nodes().values() if site == "sensor:*" else [chain.node_responses(site)]:
            chain.response_load[np.ix_(rows, rows)] += values["mass"]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """0.2 % of the links' mass."""
        return {"mass": 0.002 * sum(link.inertial[0] for link in robot.links)}
