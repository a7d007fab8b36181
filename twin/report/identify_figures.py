"""The report of ``twin identify``: signals, torque that was fitted and held out, residuals."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.report import motion_figures
from twin.report.html import Panel, Section, pick
from twin.report.plots import torque_panels, torque_plot

if TYPE_CHECKING:
    from twin.commands.identify import Identified


def draw(result: "Identified") -> dict[str, Figure]:
    """File name → figure."""
    found = result.found
    robot, split = found.regressor.robot, found.split
    first = result.log.runs[split.train[0].name]
    drawn = {"signals.png": motion_figures.signals(robot, first, found.bands)}
    for rows, title, file in ((split.train, "fitted", "fitted"), (split.held_out, "held out", "held_out")):
        predicted = [r.matrix @ found.parameters + r.known for r in rows]
        drawn[f"{file}.png"] = motion_figures.prediction(robot, rows, {"predicted": predicted}, title)
    drawn["residuals.png"] = motion_figures.residuals(robot, split.train, found.parameters)
    return drawn


def title(result: "Identified") -> str:
    """Of the page."""
    return f"{result.found.robot.name} identified from {Path(result.source).name}"


def lead(result: "Identified") -> str:
    """What was used."""
    return str(result).partition("\n")[0]


def sections(result: "Identified", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    found = result.found
    _, units = motion_figures.axis_units(found.regressor.robot)
    parts = [Section("Numbers", warnings=found.notes, tables=result.tables())]
    for rows, role, file in ((found.split.train, "fitted", "fitted"), (found.split.held_out, "held out", "held_out")):
        panels: dict[str, Panel] = {}
        for r in rows:
            curves = {"recorded": r.torque + r.known, "predicted": r.matrix @ found.parameters + r.known}
            panels |= torque_panels(r.name, r.time, curves, units, r.valid)
        plots = [torque_plot(panels, units)] if panels else []
        caption = f"Recorded and predicted torque, {role}, after the low-pass, and their difference."
        parts.append(Section(f"Torque, {role}", figures=pick(drawn, f"{file}.png", caption), plots=plots))
    caption = "What is left over time, position and speed, with its mean: a law that is left out shows."
    parts.append(Section("Residual", figures=pick(drawn, "residuals.png", caption)))
    caption = "The first run: torque and position, recorded and low-passed, and the acceleration that follows."
    return [*parts, Section("Signals", figures=pick(drawn, "signals.png", caption))]
