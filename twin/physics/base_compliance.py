"""A foundation that gives way: one spring and damper at the base frame, about (rx, ry, rz) or along (x, y, z)."""

from math import inf
from typing import TYPE_CHECKING

from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class BaseCompliance(Effect):
    """Natively: a hinge or slide of the base body. Units are N·m/rad about, N/m along an axis."""

    name = "base_compliance"
    sites = ("base.rx", "base.ry", "base.rz", "base.x", "base.y", "base.z")
    parameters = (
        Parameter("stiffness", "N·m/rad or N/m", inf, positive=True),
        Parameter("damping", "N·m·s/rad or N·s/m", nonnegative=True),
    )
    seen_in = frozenset({"hammer"})
    order = 1

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
