"""A link that bends: a hinge about y or z of its frame, half-way to the next joint (flange).

Points and mass inboard of the hinge stay behind. ``Mechanism.split`` says how the mass is divided.
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
    usual_stiffness,
)
from twin.robot.frames import axis_placement

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
    )
    seen_in = frozenset({"hammer"})
    order = 0
    sprung = True

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.split(axis_of(site) + 1, UNIT_VECTORS[site[-1]], site, values["stiffness"], values["damping"])

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """Softness of the joint that carries the link."""
        joint = axis_of(site) + 1
        return [Companion("parameter", f"joint{joint}.{letter}.stiffness") for letter in "yz"]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Three times a joint's stiffness; nothing where the next joint lies in the link's origin, as in a wrist."""
        link = axis_of(site)
        last = link + 1 == robot.axis_count
        end = robot.flange.position if last else axis_placement(robot.axes[link + 1], 0.0)[0]
        if np.linalg.norm(end) < SHORTEST_M:
            return None
        stiffness = 3 * usual_stiffness(robot)
        return {"stiffness": stiffness, "damping": light_damping(stiffness)}
