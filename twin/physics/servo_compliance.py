"""A servo that does not hold the rotor: a spring to the previous link, in series with the gear, and the rotor's N²J."""

from math import inf
from typing import TYPE_CHECKING

from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class ServoCompliance(Effect):
    """Natively: a sprung hinge of the motor body with ``armature``; under servo drive, the gains of its actuator.

    Brakes that are on hold the rotor: the entry then has no effect.
    """

    name = "servo_compliance"
    sites = ("joint{i}",)
    parameters = (
        Parameter("stiffness", "N·m/rad", inf, positive=True),
        Parameter("damping", "N·m·s/rad", nonnegative=True),
        Parameter("inertia", "kg·m²", nonnegative=True, optional=True),
    )
    seen_in = frozenset({"hammer"})
    order = 1

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        i = axis_of(site)
        if mechanism.drives == "servo":
            mechanism.servo_gains[i] = (values["stiffness"], values["damping"])
        elif mechanism.drives == "held" and mechanism.brakes == "off":
            drive = mechanism.robot.drives[i]
            rotor = mechanism.spring(
                f"motor{i + 1}",
                site,
                UNIT_VECTORS["z"],
                values["stiffness"],
                values["damping"],
                mechanism.axis_kind(i),
            )
            rotor.armature = values["inertia"] or drive.gear_ratio**2 * drive.rotor_inertia
