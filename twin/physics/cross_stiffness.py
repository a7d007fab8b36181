"""A bearing that couples its two tilts: it gives way most about an axis between x and y of its link's frame."""

from typing import TYPE_CHECKING, Any

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class CrossStiffness(Effect):
    """Torque k φ_y about x and k φ_x about y, beside the bearing's own springs; where one of them is rigid, nothing.

    Natively: a tendon over both hinges, whose own springs give up what it adds about each axis alone.
    """

    name = "cross_stiffness"
    sites = ("joint{i}",)
    parameters = (Parameter("stiffness", "N·m/rad", spread=1e6),)
    seen_in = frozenset({"hammer"})
    order = 3

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if mechanism.joint(f"{site}.x") and mechanism.joint(f"{site}.y"):
            mechanism.crossed[f"{site}.x", f"{site}.y"] = values["stiffness"]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None: of either sign, at a bearing that tilts about both axes."""
        tilting = {entry.site for entry in robot.physics if entry.effect == "transverse_compliance"}
        both = {f"{site}.x", f"{site}.y"} <= tilting and robot.axes[axis_of(site)].type == "revolute"
        return {"stiffness": 0.0} if both else None
