"""Figures of ``twin compare``: torque of motion logs, errors and FRFs of hammer tests."""

from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from twin.identify.elastic_compare import Comparison
from twin.identify.rigid_compare import LogComparison
from twin.report import fit_figures
from twin.report.fit_report import overlay
from twin.report.motion_figures import prediction

if TYPE_CHECKING:
    from twin.commands.compare import Compared


def draw(found: "Compared") -> dict[str, Figure]:
    """File name → figure."""
    drawn: dict[str, Figure] = {}
    stems: list[str] = []
    for source, compared in found.found.items():
        stem = Path(source).stem
        stems.append(stem)
        if stems.count(stem) > 1:  # files of one name in different folders
            stem = f"{stem}-{stems.count(stem)}"
        if isinstance(compared, LogComparison):
            curves = {"inverse dynamics": compared.predicted}
            if compared.stepped:
                curves["time stepping"] = compared.stepped
            title = f"{stem}, torque after the low-pass"
            drawn[f"{stem}-torque.png"] = prediction(found.robots[source], compared.rows, curves, title)
        elif isinstance(compared, Comparison):
            drawn[f"{stem}-errors.png"] = fit_figures.errors({stem: compared})
            for r, H in zip(compared.judged.recordings, compared.judged.predicted, strict=True):
                drawn[f"{stem}-frf-{r.group}.png"] = overlay(r, H, "measured")
    return drawn
