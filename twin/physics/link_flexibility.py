"""A link that bends: a hinge about y or z of its frame, half-way to the next joint (flange).

Points and mass inboard of the hinge stay behind. Three numbers say how the mass is divided: the outer mass over the
inner one, the distance of the two centres of mass, and the moment ∫x²dm along the line of the centres, outer over
inner. What an entry leaves out is as in a normal (Gaussian) cloud of the link's mass, centre of mass and inertia.
"""

from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import (
    UNIT_VECTORS,
    Companion,
    Effect,
    Parameter,
    Values,
    axis_of,
    light_damping,
    link_end,
    usual_stiffness,
)
from twin.robot.bodies import cut

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism

SHORTEST_M = 1e-6
"""A link shorter than this cannot bend."""


class LinkFlexibility(Effect):
    """Natively: the link becomes two bodies joined by a sprung hinge."""

    name = "link_flexibility"
    sites = ("link{i}.y", "link{i}.z")
    parameters = (
        Parameter("stiffness", "N·m/rad", inf, positive=True, spread=1.6),
        Parameter("damping", "N·m·s/rad", nonnegative=True, spread=2.3),
        Parameter("mass_ratio", "1", positive=True, optional=True, spread=0.5),
        Parameter("separation", "m", positive=True, optional=True, spread=0.3),
        Parameter("moment_ratio", "1", positive=True, optional=True, spread=0.5),
    )
    seen_in = frozenset({"hammer"})
    order = 0
    sprung = True

    def complete(self, robot: "Robot", site: str, given: Values) -> Values:
        """How a cloud of mass would be divided, see :func:`twin.robot.bodies.cut`."""
        end = np.array(link_end(robot, axis_of(site)))
        length = float(np.linalg.norm(end))
        if length < SHORTEST_M or {parameter.name for parameter in self.parameters} <= given.keys():
            return given
        stated = [given.get(name) for name in ("mass_ratio", "separation", "moment_ratio")]
        inner, outer = cut(robot.links[axis_of(site)].inertial, end / 2, end / length, *stated)
        apart = outer[1] - inner[1]
        separation = float(np.linalg.norm(apart))
        along = apart / separation
        moments = [0.5 * np.trace(part[2]) - along @ part[2] @ along for part in (inner, outer)]
        found = {"mass_ratio": outer[0] / inner[0], "moment_ratio": moments[1] / moments[0]}
        return {"separation": separation, **{name: float(value) for name, value in found.items()}} | dict(given)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        numbers = (values[parameter.name] for parameter in self.parameters)
        mechanism.split(axis_of(site) + 1, UNIT_VECTORS[site[-1]], site, *numbers)

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """Softness of the joint that carries the link."""
        joint = axis_of(site) + 1
        return [Companion("parameter", f"joint{joint}.{letter}.stiffness") for letter in "yz"]

    def leaves_open(self, robot: "Robot", site: str) -> dict[str, dict[str, float]]:
        """A body on the link, as heavy as the link may be off: three numbers do not say all of how it is divided."""
        link = axis_of(site)
        return {f"payload@link{link + 1}": {"mass": robot.tolerances.mass * robot.links[link].inertial[0]}}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Three times a joint's stiffness; nothing where the next joint lies in the link's origin, as in a wrist."""
        if np.linalg.norm(link_end(robot, axis_of(site))) < SHORTEST_M:
            return None
        stiffness = 3 * usual_stiffness(robot)
        return dict(self.complete(robot, site, {"stiffness": stiffness, "damping": light_damping(stiffness)}))
