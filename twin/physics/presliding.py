"""Dry friction that turns round over a travel when its drive does: slip elements beside ``coulomb_friction``.

It acts between rotor and housing. A rotor that a brake or its servo holds does not slide, so a hammer test, which winds
up the gear behind it, shows nothing of it. Slip of the gear itself is ``hysteresis``.
"""

from typing import TYPE_CHECKING

from twin.physics.effect import axis_of
from twin.physics.hysteresis import Hysteresis

if TYPE_CHECKING:
    from twin.robot.mechanism import Joint, Mechanism


class Presliding(Hysteresis):
    """Natively: one fixed tendon with ``springyield`` per element, on the motor's joint; none while it is held."""

    name = "presliding"
    sites = ("joint{i}",)
    seen_in = frozenset({"log"})
    amplitude_law = None  # a rotor that is held does not slide
    part = "slip"
    refines = ""
    memory = False
    ordinary = "friction turns round over a travel at every joint, and the base model fits it as a tolerance"

    def joint(self, mechanism: "Mechanism", site: str) -> "Joint | None":
        return mechanism.motor(axis_of(site))
