"""Bearing tilt: a joint also gives way about x or y of its link's frame, at the bearing, torque k φ + d φ̇."""

from math import inf
from typing import TYPE_CHECKING, Any

from twin.physics.doubt import Weight, of_spring
from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values, axis_of, light_damping, usual_stiffness

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class TransverseCompliance(Effect):
    """Natively: a second or third hinge in the link's body, which meets the joint's own axis at the bearing."""

    name = "transverse_compliance"
    sites = ("joint{i}.x", "joint{i}.y")
    parameters = (
        Parameter("stiffness", "N·m/rad", inf, positive=True, spread=1.6),
        Parameter("damping", "N·m·s/rad", nonnegative=True, spread=2.3),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    part = "tilt"
    sprung = True
    hinge = True

    def doubts(self, robot: "Robot", site: str, values: Values, weight: Weight) -> list[tuple[str, str]]:
        turns = robot.axes[axis_of(site)].type == "revolute"
        return of_spring(values["stiffness"], values["damping"], weight.torque) if turns else []

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        number = axis_of(site)
        bearing = (0.0, 0.0, mechanism.robot.axes[number].bearing)
        sizes = values["stiffness"], values["damping"]
        mechanism.spring(f"link{number + 1}", site, UNIT_VECTORS[site[-1]], *sizes, position=bearing)

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Twice a joint's stiffness."""
        if robot.axes[axis_of(site)].type == "prismatic":
            return None
        stiffness = 2 * usual_stiffness(robot)
        return {"stiffness": stiffness, "damping": light_damping(stiffness)}
