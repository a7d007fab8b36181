"""The report of ``twin excite``: every trajectory in the workspace and over time."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.report import motion_figures
from twin.report.html import Section

if TYPE_CHECKING:
    from twin.commands.excite import Excitations

NUMBERS = (
    "The condition number says how evenly a motion shows the parameters: the lower, the better. "
    "The other columns say how near it comes to the limits at the worst moment."
)


def draw(result: "Excitations") -> dict[str, Figure]:
    """File name → figure."""
    drawn = {}
    for k, e in enumerate(result.found, start=1):
        title = f"{result.robot.name}, trajectory {k}: condition number {e.condition:.1f}"
        drawn[f"excitation{k}.png"] = motion_figures.excitation(result.robot, e, title)
    return drawn


def title(result: "Excitations") -> str:
    """Of the page."""
    return f"Excitation of {result.robot.name}"


def lead(result: "Excitations") -> str:
    """How many, how long."""
    return str(result).partition("\n")[0]


def sections(result: "Excitations", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    caption = "Trajectory {}: the flange's path in the workspace; position, velocity and acceleration of every joint."
    return [
        Section("Trajectories", [NUMBERS], tables=result.tables()),
        Section("Motion", figures=[(caption.format(k), path) for k, path in enumerate(drawn.values(), start=1)]),
    ]
