"""The report of ``twin compare``: torque of motion logs, errors and FRFs of hammer tests."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from twin.identify.elastic_compare import Comparison
from twin.identify.rigid_compare import LogComparison
from twin.measure.campaign import QUANTITIES
from twin.report import fit_figures
from twin.report.fit_report import of_posture, overlay
from twin.report.html import Panel, Plot, Section
from twin.report.motion_figures import axis_units, prediction
from twin.report.plots import frf_plot, torque_panels, torque_plot

if TYPE_CHECKING:
    from twin.commands.compare import Compared


def draw(found: "Compared") -> dict[str, Figure]:
    """File name → figure."""
    drawn: dict[str, Figure] = {}
    for stem, source in _stems(found).items():
        compared = found.found[source]
        if isinstance(compared, LogComparison):
            title = f"{stem}, torque after the low-pass"
            drawn[f"{stem}-torque.png"] = prediction(found.robots[source], compared.rows, _curves(compared), title)
        elif isinstance(compared, Comparison):
            drawn[f"{stem}-errors.png"] = fit_figures.errors({stem: compared})
            for r, H in zip(compared.judged.recordings, compared.judged.predicted, strict=True):
                drawn[f"{stem}-frf-{r.group}.png"] = overlay(r, H)
    return drawn


def _stems(found: "Compared") -> dict[str, str]:
    """What the files about a recording begin with → the recording; those of one name in two folders are told apart."""
    stems: dict[str, str] = {}
    for source in found.found:
        stem = Path(source).stem
        same = sum(Path(other).stem == stem for other in stems.values())
        stems[f"{stem}-{same + 1}" if same else stem] = source
    return stems


def _curves(compared: LogComparison) -> dict[str, list[np.ndarray]]:
    stepped = {"time stepping": compared.stepped} if compared.stepped else {}
    return {"inverse dynamics": compared.predicted, **stepped}


def title(found: "Compared") -> str:
    """Of the page."""
    names = dict.fromkeys(robot.name for robot in found.robots.values())
    return f"{', '.join(names)} beside {', '.join(Path(source).name for source in found.found)}"


def lead(found: "Compared") -> str:
    """The error on every recording."""
    return "; ".join(f"{Path(source).name}: error {error:.2%}" for source, error in found.errors.items())


def sections(found: "Compared", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    parts = [Section("Errors", tables=found.tables())]
    for stem, source in _stems(found).items():
        begin = f"{stem}-"
        of = {Path(name).stem.removeprefix(begin): path for name, path in drawn.items() if name.startswith(begin)}
        figures = [(_caption(name), path) for name, path in of.items()]
        parts.append(Section(Path(source).name, figures=figures, plots=_plots(found, source)))
    return parts


def _caption(name: str) -> str:
    """What a figure shows; ``name``: of its file, without the recording's."""
    if name.startswith("frf-"):
        return f"FRFs in '{name.removeprefix('frf-')}', measured and modelled."
    return {"errors": "Error by posture and band of frequency; dotted, the noise floor."}.get(
        name, "Recorded and predicted torque after the low-pass, and their difference."
    )


def _plots(found: "Compared", source: str) -> list[Plot]:
    compared = found.found[source]
    panels: dict[str, Panel] = {}
    if isinstance(compared, Comparison):
        judged = compared.judged
        for r, H in zip(judged.recordings, judged.predicted, strict=True):
            panels |= of_posture(r, H)
        return [frf_plot(panels, QUANTITIES[judged.recordings[0].power])]
    if isinstance(compared, LogComparison):
        _, units = axis_units(found.robots[source])
        for k, run in enumerate(compared.rows):
            curves = {"recorded": run.torque + run.known} | {name: of[k] for name, of in _curves(compared).items()}
            panels |= torque_panels(run.name, run.time, curves, units, run.valid)
        return [torque_plot(panels, units)]
    return []
