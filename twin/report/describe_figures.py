"""The report of ``twin describe``: the robot as described, and what was assumed of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.report import figures
from twin.report.html import Section

if TYPE_CHECKING:
    from twin.commands.describe import Described


def draw(found: "Described") -> dict[str, Figure]:
    """File name → figure."""
    return {"robot.png": figures.standing(found.mechanism)}


def title(found: "Described") -> str:
    """Of the page."""
    return f"{found.robot.name}, described"


def lead(found: "Described") -> str:
    """How many axes, how much is assumed."""
    return str(found).partition("\n")[0]


def sections(found: "Described", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    pictures = [("The robot half-way between its limits.", path) for path in drawn.values()]
    return [
        Section("Robot", warnings=found.notes, figures=pictures),
        Section("What nobody measured", tables=found.tables()),
    ]
