"""Figures of ``twin excite``: every trajectory in the workspace and over time."""

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.report import motion_figures

if TYPE_CHECKING:
    from twin.commands.excite import Excitations


def draw(result: "Excitations") -> dict[str, Figure]:
    """File name → figure."""
    drawn = {}
    for k, e in enumerate(result.found, start=1):
        title = f"{result.robot.name}, trajectory {k}: condition number {e.condition:.1f}"
        drawn[f"excitation{k}.png"] = motion_figures.excitation(result.robot, e, title)
    return drawn
