"""A gear that stiffens with wind-up: torque k φ + k₃ φ³."""

from typing import TYPE_CHECKING

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class HardeningStiffness(Effect):
    """Natively: the third coefficient of the hinge's polynomial ``stiffness``."""

    name = "hardening_stiffness"
    sites = ("joint{i}.z",)
    parameters = (Parameter("cubic", "N·m/rad³"),)
    seen_in = frozenset({"levels"})

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if joint := mechanism.joint(site):
            joint.stiffness[2] = values["cubic"]
