"""Play in the gear: a dead zone of total width ``gap`` in series with the spring."""

from typing import TYPE_CHECKING

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class Backlash(Effect):
    """Natively: the spring moves from the hinge to a fixed tendon with a dead band; the damper stays on the hinge."""

    name = "backlash"
    sites = ("joint{i}.z",)
    parameters = (Parameter("gap", "rad", nonnegative=True),)
    seen_in = frozenset({"levels", "log"})
    part = "play"
    log_tests = ("speeds",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if joint := mechanism.joint(site):
            joint.dead_zone = values["gap"]
