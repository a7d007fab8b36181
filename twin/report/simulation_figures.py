"""The report of ``twin simulate``: modes, FRFs of the hammer test beside the linear model's, torques of a replay."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from twin.measure.campaign import ComplexArray
from twin.model.frf import frf, measurement_chain
from twin.report import figures
from twin.report.html import Section, pick
from twin.report.motion_figures import axis_units
from twin.report.plots import frf_panels, frf_plot, torque_panels, torque_plot

if TYPE_CHECKING:
    from twin.commands.simulate import Simulation

LOWEST_HZ = 4.0  # below, FRFs are those of a rigid robot


def draw(found: "Simulation") -> dict[str, Figure]:
    """File name → figure."""
    drawn = {}
    if len(found.modes):
        drawn["modes.png"] = figures.mode_shapes(found.mechanism, found.modes)
    if found.campaign:
        drawn["frf.png"] = hammer_frfs(found)
    _, units = axis_units(found.robot)
    for key, item in found.replays.items():
        r = item.replay
        drawn[f"{found.stem(key)}.png"] = figures.replay(
            r.time, item.run.torque, r.torque, item.inverse, found.robot.joint_names, units
        )
    return drawn


def hammer_frfs(found: "Simulation") -> Figure:
    """FRFs between up to three accelerometers and the hammer points at them: linear model and hammer test."""
    return figures.frf_matrix(*_shown(found), "accelerance", modes_hz=found.modes.frequency_hz)


def _shown(found: "Simulation") -> tuple[np.ndarray, dict[str, ComplexArray], list[str], list[str]]:
    """Lines (nf,) Hz, FRFs (nf, nr, ne) of the linear model and of every hammer test, their responses and blows."""
    assert found.campaign is not None
    robot, excitation = found.robot, found.campaign.excitation.label
    responses = robot.accelerometers[:3]
    struck = [label for label in robot.accelerometers if label in excitation][:3]
    columns = [excitation.index(label) for label in struck]
    first = next(iter(found.campaign.postures.values()))
    band = first.frequency >= LOWEST_HZ
    chain = measurement_chain(found.linear, robot, responses, struck)
    shown = {
        "linear model": frf(
            found.linear, first.frequency[band], chain, exponential_window_rate=first.exponential_window_rate
        )
    } | {
        f"hammer test {key}": p.frf[band][:, : len(responses)][:, :, columns]
        for key, p in found.campaign.postures.items()
    }
    return first.frequency[band], shown, responses, struck


def title(found: "Simulation") -> str:
    """Of the page."""
    return f"{found.robot.name} simulated: {found.case.name}"


def lead(found: "Simulation") -> str:
    """The posture."""
    return str(found).partition("\n")[0]


def sections(found: "Simulation", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    parts = []
    if len(found.modes):
        caption = "Mode shapes, enlarged; colour is the share of strain energy in each joint."
        parts.append(Section("Modes", tables=found.tables(), figures=pick(drawn, "modes.png", caption)))
    if found.campaign:
        caption = "FRFs of the hammer test, stepped in time, over those of the linear model."
        plots = [frf_plot(frf_panels(found.case.name, *_shown(found)))]
        parts.append(Section("Hammer test", figures=pick(drawn, "frf.png", caption), plots=plots))
    _, units = axis_units(found.robot)
    for key, item in found.replays.items():
        recorded = {} if item.run.torque is None else {"recorded": item.run.torque}
        curves = recorded | {"twin, stepped in time": item.replay.torque, "inverse dynamics": item.inverse}
        caption = "Torque of the replay in time, of inverse dynamics, and as recorded where the log holds it."
        figures_ = pick(drawn, f"{found.stem(key)}.png", caption)
        panels = torque_panels(key, item.replay.time, curves, units)
        parts.append(Section(f"Replay {key}", figures=figures_, plots=[torque_plot(panels, units)]))
    return parts
