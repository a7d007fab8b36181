"""A blow off its axis: turned by two angles about the two other axes of the frame."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.robot.description import Robot


class HammerMisalignment(Effect):
    """Acts on one hammer degree of freedom; turned about the two other axes in the order x, y, z."""

    name = "hammer_misalignment"
    sites = ("hammer:LABEL",)
    parameters = (Parameter("angles", "rad", length=2, spread=0.1),)
    seen_in = frozenset({"hammer"})

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        for column in chain.excitations(site):
            direction = chain.excitation_direction[column]
            along = int(np.argmax(np.abs(direction)))
            others = np.delete(np.eye(3), along, axis=0)
            for axis, angle in zip(others, values["angles"], strict=True):
                direction = (
                    direction * np.cos(angle)
                    + np.cross(axis, direction) * np.sin(angle)
                    + axis * (axis @ direction) * (1 - np.cos(angle))
                )
            chain.excitation_direction[column] = direction

    def tolerances(self, robot: "Robot") -> dict[str, float]:
        return {"angles": float(np.deg2rad(robot.tolerances.direction_deg))}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """None at all: an error of either sign."""
        return {"angles": [0.0, 0.0]}
