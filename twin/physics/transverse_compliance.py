"""Bearing tilt: a joint also gives way about x or y of its link's frame, torque k φ + d φ̇."""

from math import inf
from typing import TYPE_CHECKING

from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class TransverseCompliance(Effect):
    """Natively: a second or third hinge in the link's body, coincident with the joint's own."""

    name = "transverse_compliance"
    sites = ("joint{i}.x", "joint{i}.y")
    parameters = (
        Parameter("stiffness", "N·m/rad", inf, positive=True),
        Parameter("damping", "N·m·s/rad", nonnegative=True),
    )
    seen_in = frozenset({"hammer"})
    order = 1

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        body = f"link{axis_of(site) + 1}"
        mechanism.spring(body, site, UNIT_VECTORS[site[-1]], values["stiffness"], values["damping"])
