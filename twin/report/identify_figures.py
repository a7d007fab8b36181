"""Figures of ``twin identify``: signals, torque that was fitted and held out, residuals."""

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.report import motion_figures

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
