"""A servo that does not hold the rotor: a spring to the previous link, in series with the gear, and the rotor's N²J.
A cascade with integral action is k + d s + k/(T s), T its integral time.
"""

from collections.abc import Iterable
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import InputError
from twin.physics.effect import UNIT_VECTORS, Companion, Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class ServoCompliance(Effect):
    """Natively: a sprung hinge of the motor body with ``armature``; under servo drive, the gains of its actuator.
    Integral action is exact in modes and FRFs and left out of the MJCF.

    Brakes that are on hold the rotor: the entry then has no effect.
    """

    name = "servo_compliance"
    sites = ("joint{i}",)
    parameters = (
        Parameter("stiffness", "N·m/rad", inf, positive=True, spread=1.6),
        Parameter("damping", "N·m·s/rad", nonnegative=True, spread=2.3),
        Parameter("inertia", "kg·m²", nonnegative=True, optional=True, spread=0.1),
        Parameter("integral_time", "s", inf, positive=True, optional=True, spread=1.5),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    sprung = True
    sizes = tuple(np.arange(-3.0, 1.6, 0.5))
    ridged = True  # its peaks pass others as it grows soft

    def complete(self, robot: "Robot", site: str, given: Values) -> Values:
        drive = robot.drives[axis_of(site)]
        return {"inertia": drive.gear_ratio**2 * drive.rotor_inertia} | dict(given)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        i = axis_of(site)
        rotor = mechanism.motor(i)
        if mechanism.drives == "servo":
            mechanism.servo_gains[i] = (values["stiffness"], values["damping"])
        elif mechanism.drives == "held" and mechanism.brakes == "off":
            stiffness, damping, kind = values["stiffness"], values["damping"], mechanism.axis_kind(i)
            rotor = mechanism.spring(f"motor{i + 1}", site, UNIT_VECTORS["z"], stiffness, damping, kind)
            rotor.integral_time = values["integral_time"]
        if rotor:
            if values["inertia"] <= 0:
                where = f"drives[{i}].rotor_inertia"
                raise InputError(mechanism.robot.name, where, f"servo_compliance at {site} needs the rotor's inertia")
            rotor.armature = values["inertia"]

    def shown_by(self, brakes: Iterable[str | None]) -> bool:
        """Brakes known to be on in every posture rule the servo out."""
        return not all(state == "on" for state in brakes)

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """The gear's own spring, with which it is in series."""
        return [Companion("parameter", f"{site}.z.stiffness")]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Five times the gear's stiffness, 5 % damped on the rotor, integral time 1 s. Needs a rotor's inertia."""
        drive, axis = robot.drives[axis_of(site)], robot.axes[axis_of(site)]
        rotor = drive.gear_ratio**2 * drive.rotor_inertia
        if rotor == 0 or axis.stiffness is None:
            return None
        stiffness = 5 * axis.stiffness
        damping = 2 * 0.05 * float(np.sqrt(stiffness * rotor))
        return {"stiffness": stiffness, "damping": damping, "inertia": rotor, "integral_time": 1.0}
