"""Damping by hysteresis of the material or the joint: k (1 + iη) φ, a loss that does not grow with frequency."""

from typing import TYPE_CHECKING, Any

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class StructuralDamping(Effect):
    """Exact (a complex stiffness) in modes and FRFs; MuJoCo knows only viscous dampers, so the MJCF carries the one
    that dissipates as much at the frequency ``twin.robot.mjcf.EQUIVALENT_HZ``. On a rigid direction it does nothing.
    """

    name = "structural_damping"
    sites = ("joint{i}.x", "joint{i}.y", "joint{i}.z")
    parameters = (Parameter("loss_factor", "1", nonnegative=True, spread=1.2),)
    seen_in = frozenset({"hammer"})

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if joint := mechanism.joint(site):
            joint.loss_factor = values["loss_factor"]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """A loss factor of 2 %, where the description has a spring."""
        soft = {entry.site for entry in robot.physics if entry.effect == "transverse_compliance"}
        soft |= {f"joint{i + 1}.z" for i, axis in enumerate(robot.axes) if axis.stiffness is not None}
        return {"loss_factor": 0.02} if site in soft else None
