"""Axes that a description calls rigid, as hypotheses: each may have a gear that gives way.

A URDF has no gears, and a description by hand often has those of the large axes alone. Such a gear is a number that the
description does not have. It is told as ``parameter`` at ``joint4.z.stiffness``, and written as that axis' own.
"""

from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.model.parameters import Parameter
from twin.physics.effect import Effect, axis_of, light_damping, usual_stiffness
from twin.physics.effect import Parameter as Quantity

if TYPE_CHECKING:
    from twin.robot.description import Robot

USUAL_HZ = 40.0  # of a slide's spring under all that it carries; by eye: a factor of 50 either way is searched


class _Gear(Effect):
    """The spring and damper of a gear, which has no entry: they are numbers of its axis."""

    name = "parameter"
    sites = ("joint{i}.z",)
    parameters = (
        Quantity("stiffness", "N·m/rad", inf, positive=True, spread=1.6),
        Quantity("damping", "N·m·s/rad", nonnegative=True, spread=2.3),
    )
    seen_in = frozenset({"hammer"})
    sprung = True
    hinge = True
    sizes = (-2.5, -1.0, 0.0, 1.0, 2.5)  # nobody has said how soft it is: the search starts on both sides

    def typical(self, robot: "Robot", site: str) -> dict[str, Any]:
        """What the other joints have in the mean; on a slide, what lets all it carries swing at ``USUAL_HZ``."""
        stiffness, axis = usual_stiffness(robot), axis_of(site)
        if robot.axes[axis].type == "prismatic":
            stiffness = sum(link.inertial[0] for link in robot.links[axis:]) * (2 * np.pi * USUAL_HZ) ** 2
        return {"stiffness": stiffness, "damping": light_damping(stiffness)}


_GEAR = _Gear()


def rigid_axes(base: "Robot") -> list[list[Hypothesis]]:
    """One hypothesis for every axis without a stiffness: that it has one."""
    return [[_soft(base, k)] for k, axis in enumerate(base.axes) if axis.stiffness is None]


def _soft(base: "Robot", axis: int) -> Hypothesis:
    site = f"joint{axis + 1}.z"
    usual, own = _GEAR.typical(base, site), []
    for q in _GEAR.parameters:
        unit, width = _GEAR.unit(q.name, site, base), _GEAR.deviation(base, site, q, 0)
        own.append(Parameter(f"{site}.{q.name}", unit, "spring", q.log, usual[q.name], width, "usual size"))
    gear = axis, float(usual["stiffness"]), float(usual["damping"])
    return Hypothesis("parameter", f"{site}.stiffness", own=tuple(own), gears=(gear,), of_number=_GEAR)
