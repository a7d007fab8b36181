"""A foundation that gives way: one spring and damper at the base frame, about (rx, ry, rz) or along (x, y, z)."""

from math import inf
from typing import TYPE_CHECKING, Any

from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values, light_damping, usual_stiffness

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class BaseCompliance(Effect):
    """Natively: a hinge or slide of the base body. Units are N·m/rad about an axis, and N/m along one."""

    name = "base_compliance"
    sites = ("base.rx", "base.ry", "base.rz", "base.x", "base.y", "base.z")
    parameters = (
        Parameter("stiffness", "N·m/rad or N/m", inf, positive=True, spread=1.6),
        Parameter("damping", "N·m·s/rad or N·s/m", nonnegative=True, spread=2.3),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    sprung = True

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        about = site.removeprefix("base.").startswith("r")
        mechanism.spring(
            "base",
            site,
            UNIT_VECTORS[site[-1]],
            values["stiffness"],
            values["damping"],
            "hinge" if about else "slide",
        )

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Ten times a joint's stiffness; along an axis, as stiff as that at a metre's arm."""
        stiffness = 10 * usual_stiffness(robot)
        return {"stiffness": stiffness, "damping": light_damping(stiffness)}
