"""Figures of ``twin simulate``: modes, FRFs of the hammer test beside the linear model's, torques of a replay."""

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.model.frf import frf, measurement_chain
from twin.report import figures
from twin.report.motion_figures import axis_units

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
    return figures.frf_matrix(
        first.frequency[band], shown, responses, struck, "accelerance", modes_hz=found.modes.frequency_hz
    )
