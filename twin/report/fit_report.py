"""The HTML report and figures of ``twin fit``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from twin.identify.uncertainty import Estimate
from twin.measure.campaign import QUANTITIES, ComplexArray
from twin.model.recorded import Recorded
from twin.report import figures, fit_figures
from twin.report.html import Panel, Plot, Section, Table, pick
from twin.report.plots import frf_panels, frf_plot
from twin.result import listed

if TYPE_CHECKING:
    from twin.commands.fit import FitResult

PARAMETERS = "Stiffness and damping with 90 % intervals, and the prior; grey is what the prior holds alone."
PROFILES = (
    "Misfit over a number, everything else refitted: the flatter, the less the data know. Below the dotted line (2.71) "
    "lies the 90 % interval."
)
BOUNDED = 0.75  # share of the prior's variance above which what the data give is a bound
WORST_HELD = 6  # combinations shown


def draw(found: "FitResult") -> dict[str, Figure]:
    """File name → figure."""
    drawn = {"parameters.png": fit_figures.intervals(found.estimates)}
    for role, judged in found.comparisons.items():
        for r, H in zip(judged.judged.recordings, judged.judged.predicted, strict=True):
            drawn[f"frf-{r.group}.png"] = overlay(r, H, role)
    if found.comparisons:
        drawn["errors.png"] = fit_figures.errors(found.comparisons)
    macs = {k: np.array(v["mac"]) for k, v in found.postures.items() if v.get("mac")}
    if macs:
        drawn["mac.png"] = fit_figures.mac_matrices(
            macs,
            {k: found.postures[k]["measured_hz"] for k in macs},
            {k: [mode["frequency_hz"] for mode in found.postures[k]["modes"]] for k in macs},
        )
    if found.profiles:
        units = {e.parameter.name: e.parameter.unit for e in found.estimates}
        drawn["profiles.png"] = fit_figures.profiles(found.profiles, units)
    return drawn


def overlay(r: Recorded, predicted: ComplexArray, role: str = "") -> Figure:
    """Measured and modelled FRFs between up to three responses and the hammer points at their nodes."""
    response, excitation = r.setup.response, r.setup.excitation
    rows = np.arange(min(3, len(response.label)))
    at_node = [j for i in rows for j, label in enumerate(excitation.label) if label[:-1] == response.label[i][:-1]]
    columns = np.array(at_node or range(min(3, len(excitation.label))))
    pick = np.ix_(np.arange(len(r.s)), rows, columns)
    return figures.frf_matrix(
        r.frequency,
        {f"measured in '{r.group}'{role and f' ({role})'}": r.frf[pick], "model": predicted[pick]},
        [response.label[i] for i in rows],
        [excitation.label[j] for j in columns],
        QUANTITIES[r.power],
    )


def title(found: "FitResult") -> str:
    """Of the page."""
    return f"{found.robot.name} fitted to {Path(found.source).name}"


def lead(found: "FitResult") -> str:
    """The result in a sentence."""
    parts = [f"error {found.error['train']:.2%} on what was fitted"]
    if found.error["held_out"] is not None:
        unused = "each left out in turn" if found.in_turn else "not used"
        parts.append(f"{found.error['held_out']:.2%} on {listed(found.held_out or found.in_turn)}, {unused}")
    held = sum(e.identifiable for e in found.estimates)
    return "; ".join(parts) + f"; {held} of {len(found.estimates)} numbers held by the data"


def sections(found: "FitResult", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    springs = [e for e in found.estimates if e.parameter.kind in ("spring", "entry")]
    others = [e for e in found.estimates if e.parameter.kind not in ("spring", "entry")]
    fit = found.fit
    errors = [f"{fit.told[:1].upper()}{fit.told[1:]} over {fit.data} real numbers."]
    if explained := found.expected.get("held_out"):
        errors.append(f"Noise and what the tolerances leave open explain {explained:.2%} on what was held out.")
    left_out = Table(("posture left out", "error"), [(k, f"{v:.2%}") for k, v in found.left_out.items()], (1,))
    text = "Combinations of springs and dampers, in prior deviations, of which the data know least."
    return [
        Section(
            "Errors",
            errors,
            found.warnings,
            [left_out] if found.left_out else [],
            pick(drawn, "errors.png", "Error by posture and band of frequency; dotted, the noise floor."),
        ),
        Section("Springs and dampers", tables=[_numbers(springs)], figures=pick(drawn, "parameters.png", PARAMETERS)),
        Section("FRFs", figures=_frfs(drawn), plots=_plots(found)),
        Section(
            "Modes",
            tables=[_modes(found)],
            figures=pick(drawn, "mac.png", "Likeness (MAC) of measured and modelled shapes."),
        ),
        Section(
            "What the data do not hold",
            [text],
            tables=[_combinations(found)],
            figures=pick(drawn, "profiles.png", PROFILES),
        ),
        Section("Tolerances", tables=[_numbers(others)] if others else []),
    ]


def _frfs(drawn: Mapping[str, Path]) -> list[tuple[str, Path]]:
    caption = "FRFs in '{}', measured and modelled."
    return [
        (caption.format(Path(name).stem.removeprefix("frf-")), path)
        for name, path in drawn.items()
        if name.startswith("frf-")
    ]


def of_posture(r: Recorded, predicted: ComplexArray, role: str = "") -> dict[str, Panel]:
    """Measured and modelled FRFs of a posture, for a reader to zoom."""
    name = f"{r.group}, {role}" if role else r.group
    curves = {"measured": r.frf, "model": predicted}
    return frf_panels(name, r.frequency, curves, r.setup.response.label, r.setup.excitation.label)


def _plots(found: "FitResult") -> list[Plot]:
    panels: dict[str, Panel] = {}
    quantity = QUANTITIES[-1]
    for role, compared in found.comparisons.items():
        for r, H in zip(compared.judged.recordings, compared.judged.predicted, strict=True):
            panels |= of_posture(r, H, role)
            quantity = QUANTITIES[r.power]
    return [frf_plot(panels, quantity)] if panels else []


def _numbers(shown: Sequence[Estimate]) -> Table:
    rows = [
        (
            e.parameter.name,
            *_with_interval(e.value, *e.interval90),
            e.parameter.unit,
            f"{e.share:.1%}",
            f"{e.drift:+.2f}",
            "data" if e.identifiable else "data, a bound" if e.share > BOUNDED else "prior",
        )
        for e in shown
    ]
    header = ("parameter", "value", "90 % interval", "unit", "data's share", "drift, prior σ", "held by")
    return Table(header, rows, (1, 2, 4, 5), [k for k, e in enumerate(shown) if not e.identifiable])


def _with_interval(value: float, low: float, high: float) -> tuple[str, str]:
    """Value and interval; what is next to nothing beside the interval's width is 0."""
    least = 1e-4 * (high - low)
    value, low, high = (0.0 if abs(v) < least else v for v in (value, low, high))
    return f"{value:.4g}", f"{low:.4g} … {high:.4g}"


def _modes(found: "FitResult") -> Table:
    rows = []
    for name, posture in found.postures.items():
        for m in posture["modes"]:
            measured, damping, alike = m.get("measured_hz"), m.get("measured_damping_percent"), m.get("mac")
            rows.append(
                (
                    name,
                    posture["role"],
                    f"{m['frequency_hz']:.2f}",
                    f"{m['damping_percent']:.2f}",
                    "" if measured is None else f"{measured:.2f}",
                    "" if damping is None else f"{damping:.2f}",
                    "" if alike is None else f"{alike:.0%}",
                    ", ".join(f"{d['site']} {d['share']:.0%}" for d in m["dominant"]),
                )
            )
    header = ("posture", "", "Hz", "ζ %", "measured Hz", "measured ζ %", "MAC", "deflections that dominate")
    return Table(header, rows, (2, 3, 4, 5, 6))


def _combinations(found: "FitResult") -> Table:
    rows = []
    for c in found.combinations[::-1][:WORST_HELD]:
        terms = sorted(c.weights.items(), key=lambda item: -abs(item[1]))[:4]
        written = [f"{'+−'[weight < 0]} {abs(weight):.2f} {name}" for name, weight in terms if abs(weight) >= 0.005]
        rows.append((f"{c.share:.1%}", " ".join(written).removeprefix("+ ")))
    return Table(("data's share", "combination"), rows, (0,))
