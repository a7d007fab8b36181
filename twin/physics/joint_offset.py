"""The encoder's zero: an axis stands at its recorded position plus an angle, in every posture and run."""

from typing import TYPE_CHECKING, Any

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.robot.description import Robot


class JointOffset(Effect):
    """Moves links, loads and laws of position to where the axis is; recorded positions stay as recorded.

    A mechanism and its MJCF carry the axis' own position as coordinate, a replay records the encoder's.
    """

    name = "joint_offset"
    sites = ("joint{i}",)
    parameters = (Parameter("angle", "rad", spread=0.02),)
    seen_in = frozenset({"hammer", "log"})
    ordinary = "every fit to a log leaves the zero of each axis free, and a wrong zero is answered by this name"

    def encoder_zero(self, site: str, values: Values) -> dict[int, float]:
        return {axis_of(site): float(values["angle"])}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None: of either sign. The base carries the first axis, and the zero of a linear one is its offset."""
        axis = axis_of(site)
        return {"angle": 0.0} if axis and robot.axes[axis].type == "revolute" else None
