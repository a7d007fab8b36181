"""A link that bends: a hinge about y or z of its frame, half-way to the next joint (flange).

Points and mass inboard of the hinge stay behind. ``Mechanism.split`` says how the mass is divided.
"""

from math import inf
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


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
        """Three times a joint's stiffness."""
        stiffness = 3 * usual_stiffness(robot)
        return {"stiffness": stiffness, "damping": light_damping(stiffness)}
