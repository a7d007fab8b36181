"""The report of ``twin diagnose``: its figures, and the sections of its page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import (
    FixedLocator,
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    ScalarFormatter,
)

from twin.diagnose.records import STAGES, FrfRecord, LogRecord, ModalRecord, Record, Stage, pooled_floor
from twin.diagnose.sentences import Spot, best_spot, off_by
from twin.diagnose.verdict import MEANING, Finding, Verdict, parameter_rows
from twin.measure.campaign import QUANTITIES
from twin.physics import CATALOGUE
from twin.report.figures import UNITS
from twin.report.html import Grid, Map, Panel, Plot, Section, Table, pick
from twin.report.motion_figures import axis_units
from twin.report.plots import frf_panels, frf_plot, torque_panels, torque_plot
from twin.result import listed
from twin.robot.description import Robot

COLOURS: dict[Stage, str] = {"as_given": "#8a8f98", "before": "#e8590c", "after": "#1f4e9c"}
NAMES: dict[Stage, str] = {"as_given": "as given", "before": "before: refitted", "after": "after: with the answer"}
_INK, _GRID = "#222222", "#e3e6ea"
RIM = 2.5  # points by which before is larger, to be seen where after is the same
NARROW = 0.015  # of an axis: an interval that a dot hides
_BANDS, _FINE_BANDS = 48, 96  # of frequency, in the picture and in the map one can zoom
_ROWS = 40  # channels at most of a posture's map: those that miss most
_COLOURS, _DARKEST = 32, 0.8  # darker colours would be lost on a dark page
FREED = {
    "frf-campaign": "gain in ln evidence, if this spring may have any law",
    "motion-log": "gain in ln evidence, if this joint has any torque over position and velocity",
    "modal-table": "expected fall of ½χ² with this site free",
}
"""What the picture of sites says of each kind of recording."""
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
CAPTIONS = {
    "probabilities.png": "Probability of each answer.",
    "errors.png": "Error of every posture or run under each model. The bar is the noise.",
    "overlay.png": "FRF where the answer shows best, used and held out; below, phase and residual.",
    "torque.png": "Torque where the answer shows best: recorded, before and after, and the residuals.",
    "modes.png": "Frequency and damping of every mode, measured, before and after.",
    "mismatch.png": "Residual over noise, before and after, by posture, channel and frequency.",
    "residual.png": "Residual over time, position and speed.",
    "sites.png": "Where more freedom of the model would help most.",
    "smallest_visible.png": "Size from which an effect would have shown, over its usual size. A dot is a site.",
}
BOTH = {
    "overlay.png": "FRF that the model misses most, used and held out; below, phase and residual.",
    "torque.png": "Torque, recorded and predicted, and the residuals.",
}
"""Of a recording that the answer does not change, or where there is none."""

PARTS = (("used", "train", False), ("held out", "held_out", True))
"""What a row says, its key in the errors, and whether its records were held out."""
_DOTS = 3000  # drawn at most per cloud
_ANSWERS = 10  # listed at most


def draw(verdict: Verdict) -> dict[str, Figure]:
    """File name → figure."""
    drawn: dict[str, Figure] = {}
    for k, finding in enumerate(verdict.findings):
        prefix = f"{Path(finding.recording).stem}-" if len(verdict.findings) > 1 else ""
        if prefix and f"{prefix}errors.png" in drawn:
            prefix = f"{prefix}{k + 1}-"
        for name, figure in _draw_finding(finding).items():
            drawn[prefix + name] = figure
    drawn["probabilities.png"] = probabilities(verdict)
    if any(_over_usual(item, verdict.base) is not None for item in verdict.smallest_visible):
        drawn["smallest_visible.png"] = smallest_visible(verdict.smallest_visible, verdict.base)
    return drawn


def _draw_finding(finding: Finding) -> dict[str, Figure]:
    drawn = {"errors.png": errors(finding)}
    frfs = [r for r in finding.records if isinstance(r, FrfRecord)]
    logs = [r for r in finding.records if isinstance(r, LogRecord)]
    tables = [r for r in finding.records if isinstance(r, ModalRecord)]
    if frfs:
        drawn["mismatch.png"] = mismatch(frfs)
        drawn["overlay.png"] = overlay(frfs)
    if max(finding.sites.values(), default=0.0) > 0:
        drawn["sites.png"] = sites(finding.sites, FREED[finding.source])
    if logs:
        drawn["residual.png"] = residual(logs, finding.robot)
        drawn["torque.png"] = torque(logs, finding.robot)
    if tables:
        drawn["modes.png"] = modal(tables)
    return drawn


# --- figures of any recording -----------------------------------------------------------------------------------------


def errors(finding: Finding) -> Figure:
    """Error of every posture or run under the three models, against its noise floor; pooled rows on top."""
    groups = [(title, part, [r for r in finding.records if r.held_out == held]) for title, part, held in PARTS]
    rows: list[tuple[str, dict[Stage, float], float | None, bool]] = []
    for title, part, records in groups:
        if finding.error["before"][part] is not None:
            pooled = {stage: finding.error[stage][part] for stage in STAGES}
            rows.append((f"all {title}", pooled, _floor(finding, records or finding.records), True))
            rows += [(r.name, {stage: r.error(stage) for stage in STAGES}, r.floor, False) for r in records]
    figure = Figure(figsize=(7.2, 1.5 + 0.3 * len(rows)), layout="constrained")
    ax = figure.subplots()
    stages = _stages(finding.records)
    for y, (_, values, floor, pooled_row) in enumerate(rows):
        size = 9.0 if pooled_row else 6.0
        ax.plot([100 * values["before"], 100 * values["after"]], [y, y], color="#c9ced6", linewidth=1.2, zorder=1)
        for stage in (s for s in stages if values[s] is not None):
            hollow = stage == "as_given"
            ax.plot(
                100 * values[stage], y, "o", markersize=size + RIM * (stage == "before"), color=COLOURS[stage],
                zorder=2 if hollow else 3,
                markerfacecolor="white" if hollow else COLOURS[stage],
            )  # fmt: skip
        if floor is not None and np.isfinite(floor):
            ax.plot([100 * floor] * 2, [y - 0.36, y + 0.36], color=_INK, linewidth=1.6, zorder=4)
    ax.set_yticks(range(len(rows)), [row[0] for row in rows], fontsize=8.5)
    for label, row in zip(ax.get_yticklabels(), rows, strict=True):
        label.set_fontweight("bold" if row[3] else "normal")
    for y, row in enumerate(rows):
        if row[3] and y:
            ax.axhline(y - 0.5, color="#9aa1ab", linewidth=0.7)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    _percent_axis(ax)
    ax.set_xlabel("error: RMS of residual over RMS of data", fontsize=9)
    handles = [
        Line2D([], [], marker="o", linestyle="", color=COLOURS[s], label=NAMES[s],
               markerfacecolor="white" if s == "as_given" else COLOURS[s]) for s in stages
    ]  # fmt: skip
    if any(floor is not None and np.isfinite(floor) for _, _, floor, _ in rows):
        handles.append(Line2D([], [], color=_INK, linewidth=1.6, label="noise floor"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=8.5)
    return figure


def _stages(records: Sequence[Record]) -> tuple[Stage, ...]:
    """What is drawn of the models: not that with the answer, where the answer is nothing."""
    same = all(np.array_equal(r.predicted["before"], r.predicted["after"], equal_nan=True) for r in records)
    return STAGES[:-1] if same else STAGES


def _floor(finding: Finding, records: Sequence[Record]) -> float | None:
    """The noise floor of these records together, where the noise is known; a table's postures take turns."""
    return None if finding.error["noise_floor"] is None else pooled_floor(records)


def probabilities(verdict: Verdict) -> Figure:
    """Who is left: the first answer of each thing missing, its alternatives, nothing, and something without a name."""
    panels: list[tuple[str, list[tuple[str, float, str]]]] = []
    others = [("nothing missing", verdict.none), ("something else", verdict.other)]
    if verdict.unclear:
        others.insert(1, ("something known,\nbut not clear", verdict.unclear))
    rest = [(name, p, "#8a8f98") for name, p in others]
    certain: list[tuple[str, float, str]] = []  # without alternatives: one panel for all of them
    for number, missing in enumerate(verdict.missing):
        first = (f"{missing.first.effect}\n{missing.first.site}", missing.probability, COLOURS["after"])
        shown = [(c, p) for c, p in missing.alternatives if p >= 1e-4][: _ANSWERS - 3]
        if shown:
            bars = [first, *((f"{c.effect}\n{c.site}", p, "#7fa3d6") for c, p in shown)]
            panels.append((f"{number + 1}." if len(verdict.missing) > 1 else "", bars + rest))
        else:
            certain.append(first)
    if certain:
        panels.insert(0, ("without alternatives" if panels else "", certain + rest))
    panels = panels or [("", rest)]
    counts = [len(bars) for _, bars in panels]  # one below the other: beside each other letters would be tiny
    figure = Figure(figsize=(6.2, 0.9 * len(panels) + 0.46 * sum(counts)), layout="constrained")
    for ax, (title, bars) in zip(
        figure.subplots(len(panels), 1, squeeze=False, height_ratios=counts)[:, 0], panels, strict=True
    ):
        for y, (_, p, colour) in enumerate(bars):
            ax.barh(y, p, color=colour, height=0.62)
            text = f"{p:.2f}" if p >= 0.005 or p == 0 else "below 0.01"
            ax.text(p + 0.012, y, text, va="center", fontsize=8.5)
        ax.set_yticks(range(len(bars)), [name for name, *_ in bars], fontsize=8.5)
        ax.set_ylim(len(bars) - 0.4, -0.6)
        ax.set_xlim(0, 1.1)
        ax.set_xticks([0, 0.25, 0.5, 0.75, 1])
        ax.set_xlabel("probability", fontsize=9)
        if title:
            ax.set_title(title, fontsize=9, loc="left")
        _plain(ax, "x")
    return figure


def smallest_visible(items: Sequence[dict[str, Any]], robot: Robot) -> Figure:
    """The smallest size of each effect these recordings would have shown, over its usual size; a dot per site."""
    shown: dict[str, list[tuple[float, str]]] = {}
    for item in items:
        if (ratio := _over_usual(item, robot)) is not None:
            shown.setdefault(f"{item['effect']}: {item['parameter']}", []).append((ratio, item["site"]))
    rows = sorted(shown, key=lambda name: min(ratio for ratio, _ in shown[name]))
    figure = Figure(figsize=(8.6, 1.3 + 0.33 * max(1, len(rows))), layout="constrained")
    ax = figure.subplots()
    for y, name in enumerate(rows):
        ratios = np.array([ratio for ratio, _ in shown[name]])
        ax.plot([ratios.min(), ratios.max()], [y, y], color="#c9ced6", linewidth=1.2, zorder=1)
        ax.plot(ratios, np.full(len(ratios), y), "o", markersize=4.5, color=COLOURS["after"], alpha=0.75)
        ends = [(max(shown[name]), 6, "left"), (min(shown[name]), -6, "right")]
        for (ratio, site), aside, side in ends[: len(shown[name])]:
            ax.annotate(
                site, (ratio, y), (aside, 0), textcoords="offset points", va="center", ha=side, fontsize=7,
                color="#51606f", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
            )  # fmt: skip
    ax.axvline(1, color=_INK, linewidth=0.9, zorder=0)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.set_xlim(low / 30, high * 6)
    _decades(ax.xaxis)
    ax.set_yticks(range(len(rows)), rows, fontsize=8.5)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_xlabel(
        "smallest visible size over usual size (springs: compliance); left of 1 an ordinary effect shows", fontsize=9
    )
    _plain(ax, "x")
    return figure


def _visible_table(items: Sequence[dict[str, Any]], robot: Robot) -> list[Table]:
    """The effects that have no usual size, which the picture therefore lacks: site by site, the size itself."""
    rows: dict[tuple[str, str, str], list[str]] = {}
    for item in items:
        if _over_usual(item, robot) is None:
            key = (item["effect"], item["parameter"], item["unit"])
            rows.setdefault(key, []).append(f"{float(format(item['value'], '.2g')):g} at {item['site']}")
    cells = [(effect, parameter, ", ".join(sizes), unit) for (effect, parameter, unit), sizes in rows.items()]
    return [Table(("effect", "parameter", "shows from", "unit"), cells)] if cells else []


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _over_usual(item: Mapping[str, Any], robot: Robot) -> float | None:
    """Smallest visible size relative to what the entry would ordinarily be."""
    effect = CATALOGUE.get(item["effect"])
    if effect is None or not item["value"] > 0:
        return None
    parameter = next((p for p in effect.parameters if p.name == item["parameter"]), None)
    usual = (effect.typical(robot, item["site"]) or {}).get(item["parameter"])
    if parameter is None or usual is None:
        return None
    if not parameter.log:
        return float(item["value"] / parameter.spread) if parameter.spread else None
    usual = float(np.max(usual))
    return (
        float(usual / item["value"] if item["parameter"] == "stiffness" else item["value"] / usual) if usual else None
    )


def sites(found: Mapping[str, float], label: str) -> Figure:
    """Joint by joint: what the misfit would lose if something more were free there; ``label`` says what."""
    names = list(found)[:_ANSWERS]
    figure = Figure(figsize=(6.2, 0.9 + 0.32 * len(names)), layout="constrained")
    ax = figure.subplots()
    ax.barh(range(len(names)), [found[name] for name in names], color=COLOURS["before"], height=0.6)
    ax.set_yticks(range(len(names)), names, fontsize=8.5)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlim(left=0)
    ax.xaxis.set_major_formatter(_Powers())
    ax.set_xlabel(label, fontsize=8.5)
    _plain(ax, "x")
    return figure


# --- hammer tests -----------------------------------------------------------------------------------------------------


def mismatch(records: Sequence[FrfRecord]) -> Figure:
    """Residual over noise before and after: posture × frequency, and sensor × hammer point pooled over postures.

    Colour: RMS of the residual in standard deviations of the noise; one is noise alone.
    """
    stages, first = _told_apart(records), records[0]
    low, high = (f(r.frequency[i] for r in records) for f, i in ((min, 0), (max, -1)))
    edges = _edges(low, high, max(len(r.frequency) for r in records), _BANDS)
    over_bands = {s: np.array([_banded(r, s, edges) for r in records]) for s in stages}
    over_pairs = {s: _by_pair(records, s) for s in stages}
    top = max(float(np.nanmax(x)) for x in (*over_bands.values(), *over_pairs.values()))
    norm = LogNorm(0.7, max(10.0, top))
    nr, ne = first.measured.shape[1:]
    ratio = [max(2.2, 0.36 * len(records)), max(1.4, 0.3 * nr)]
    figure = Figure(figsize=(11.5, 2.0 + sum(ratio)), layout="constrained")
    axes = figure.subplots(2, len(stages), gridspec_kw={"height_ratios": ratio}, squeeze=False)
    for column, stage in enumerate(stages):
        ax = axes[0, column]
        image = ax.pcolormesh(edges, np.arange(len(records) + 1), over_bands[stage], norm=norm, cmap="magma_r")
        ax.set_yticks(
            np.arange(len(records)) + 0.5, [r.name + (" *" if r.held_out else "") for r in records], fontsize=8
        )
        ax.invert_yaxis()
        ax.set_xlabel("frequency, Hz", fontsize=8.5)
        ax.set_title(NAMES[stage], fontsize=10, loc="left", color=COLOURS[stage])
        ax = axes[1, column]
        ax.pcolormesh(np.arange(ne + 1), np.arange(nr + 1), over_pairs[stage], norm=norm, cmap="magma_r")
        ax.set_yticks(np.arange(nr) + 0.5, first.response.label, fontsize=8)
        ax.set_xticks(np.arange(ne) + 0.5, first.excitation.label, fontsize=7.5, rotation=90)
        ax.invert_yaxis()
        ax.set_xlabel("hammer point", fontsize=8.5)
        for each in axes[:, column]:
            each.tick_params(length=2)
            if column:
                each.set_yticklabels([])
    axes[0, 0].set_ylabel("posture (* held out)", fontsize=8.5)
    axes[1, 0].set_ylabel("sensor", fontsize=8.5)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, aspect=32, pad=0.01)
    bar.set_label("residual over noise (RMS); 1 is noise alone", fontsize=8.5)
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    bar.ax.tick_params(labelsize=8)
    return figure


def mismatch_map(records: Sequence[FrfRecord]) -> Map:
    """The same to zoom: all postures, every posture by channel, and sensor × hammer point; before and after."""
    stages = _told_apart(records)
    panels: dict[str, Grid] = {}
    frequency, noise = "frequency, Hz", "residual over noise"

    def add(name: str, stage: Stage, grid: Grid) -> None:
        panels[f"{name}, {NAMES[stage]}"] = grid

    low, high = (f(r.frequency[i] for r in records) for f, i in ((min, 0), (max, -1)))
    edges = _edges(low, high, max(len(r.frequency) for r in records))
    for stage in stages:
        rows = np.array([_banded(r, stage, edges) for r in records])
        add("all postures", stage, Grid([_named(r) for r in records], edges, rows, frequency, "posture"))
    ne = records[0].measured.shape[2]
    responses, excitations = records[0].response.label, records[0].excitation.label
    for stage in stages:
        pairs = _by_pair(records, stage)
        add(
            "channels over all postures", stage,
            Grid(responses, np.arange(ne + 1.0), pairs, "hammer point", "sensor", excitations),
        )  # fmt: skip
    for record in records:
        own = _edges(record.frequency[0], record.frequency[-1], len(record.frequency))
        ne = record.measured.shape[2]
        missed = np.nansum(record.energy("before"), axis=0).ravel()
        kept = np.sort(np.argsort(missed)[::-1][:_ROWS])
        labels = [f"{record.response.label[k // ne]}/{record.excitation.label[k % ne]}" for k in kept]
        for stage in stages:
            rows = np.array([_banded(record, stage, own, divmod(int(k), ne)) for k in kept])
            add(_named(record), stage, Grid(labels, own, rows, frequency, "channel"))
    top = max(float(np.nanmax(grid.values)) for grid in panels.values() if np.isfinite(grid.values).any())
    caption = (
        "Residual over noise (RMS), before and after, in one scale of colours; 1 is noise alone. Of a posture the "
        f"{_ROWS} channels at most that miss most. Arrow keys move from cell to cell."
    )
    colours = [to_hex(colormaps["magma_r"](_DARKEST * k / (_COLOURS - 1))) for k in range(_COLOURS)]
    return Map(caption, noise, panels, (0.7, max(10.0, top)), colours)


def _told_apart(records: Sequence[FrfRecord]) -> tuple[Stage, ...]:
    """Before and after; before alone where nothing was found."""
    same = all(np.array_equal(r.predicted["before"], r.predicted["after"]) for r in records)
    return ("before",) if same else ("before", "after")


def _edges(low: float, high: float, lines: int, bands: int = _FINE_BANDS) -> np.ndarray:
    """Edges (nb + 1,) of bands that hold a line or more each."""
    return np.linspace(low, high * (1 + 1e-9), min(bands, lines) + 1)


def _banded(record: FrfRecord, stage: Stage, edges: np.ndarray, pair: tuple[int, int] | None = None) -> np.ndarray:
    """RMS residual over noise per band (nb,), of all channels or of one; NaN where a band has no line."""
    energy, used = record.energy(stage), np.isfinite(record.variance)
    if pair is not None:
        energy, used = (array[:, pair[0], pair[1], None, None] for array in (energy, used))
    band = np.clip(np.searchsorted(edges, record.frequency, side="right") - 1, 0, len(edges) - 2)
    top = np.bincount(band, energy.sum(axis=(1, 2)), len(edges) - 1)
    count = np.bincount(band, used.sum(axis=(1, 2)).astype(float), len(edges) - 1)
    return np.sqrt(np.divide(top, 2 * count, out=np.full_like(top, np.nan), where=count > 0))


def _by_pair(records: Sequence[FrfRecord], stage: Stage) -> np.ndarray:
    """RMS residual over noise (nr, ne), postures and lines pooled; NaN on channels that are not used."""
    top = np.sum([r.energy(stage).sum(axis=0) for r in records], axis=0)
    count = np.sum([np.isfinite(r.variance).sum(axis=0) for r in records], axis=0).astype(float)
    return np.asarray(np.sqrt(np.divide(top, 2 * count, out=np.full_like(top, np.nan), where=count > 0)))


def overlay(records: Sequence[FrfRecord]) -> Figure:
    """Measured FRF and both models where the answer shows best, in a used and in a held-out posture, and residuals."""
    columns: list[tuple[FrfRecord, int, Spot | None]] = []
    for held in (False, True):
        of = [r for r in records if r.held_out == held]
        if of:
            spot = best_spot(of)
            columns.append((spot.record, spot.channel, spot) if spot else (*_worst(of), None))
    figure = Figure(figsize=(0.6 + 5.3 * len(columns), 6.0), layout="constrained")
    axes = figure.subplots(3, len(columns), squeeze=False, sharex="col", gridspec_kw={"height_ratios": [3.2, 1.2, 1.6]})
    stages = _stages(records)[1:]
    for column, (record, pair, spot) in enumerate(columns):
        _overlay_column(axes[:, column], record, pair, spot, stages)
    handles = [
        Line2D([], [], color=_INK, linewidth=2.4, alpha=0.45, label="measured"),
        *(Line2D([], [], color=COLOURS[s], linewidth=1.3, label=NAMES[s]) for s in stages),
        Line2D([], [], color="#c9ced6", linewidth=5, label="noise (RMS)"),
    ]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=8.5, columnspacing=1.2,
        handlelength=1.6,
    )  # fmt: skip
    figure.align_ylabels()
    return figure


def _overlay_column(axes: Any, record: FrfRecord, pair: int, spot: Spot | None, stages: Sequence[Stage]) -> None:
    flat = record.channel(pair)
    f, H, sigma = record.frequency, record.measured[flat], np.sqrt(2 * record.variance[flat])
    amplitude, phase, rest = axes
    amplitude.plot(f, np.abs(H), color=_INK, linewidth=2.4, alpha=0.45)
    start = -270 + 90 * QUANTITIES.index(record.quantity)  # far from the phases between resonances
    phase.plot(f, _wrapped(H, start), ".", color=_INK, markersize=3.2, alpha=0.45)
    rest.fill_between(f, 0, np.where(np.isfinite(sigma), sigma, 0), color="#c9ced6", linewidth=0)
    for stage in stages:
        model = record.predicted[stage][flat]
        style: dict[str, Any] = {"color": COLOURS[stage], "linewidth": 1.3}
        amplitude.plot(f, np.abs(model), **style)
        phase.plot(f, _unbroken(_wrapped(model, start)), **style)
        rest.plot(f, np.abs(H - model), **style)
    for ax in (amplitude, rest):
        ax.set_yscale("log")
        _decades(ax.yaxis)
    finite = np.abs(H[np.abs(H) > 0])
    amplitude.set_ylim(finite.min() / 2, max(finite.max(), np.abs(record.predicted["after"][flat]).max()) * 3)
    floor = np.nanmedian(np.where(np.isfinite(sigma), sigma, np.nan))
    rest.set_ylim(floor / 10, None)
    held = "held out" if record.held_out else "used"
    amplitude.set_title(f"{record.pairs[pair]} in '{record.name}' ({held})", fontsize=10, loc="left")
    amplitude.set_ylabel(f"|H|, {UNITS[record.quantity]}", fontsize=9)
    phase.set_ylabel("phase, °", fontsize=9)
    phase.set_ylim(start - 10, start + 370)
    phase.yaxis.set_major_locator(FixedLocator(list(range(start, start + 361, 90))))
    rest.set_ylabel(f"|residual|,\n{UNITS[record.quantity]}", fontsize=9)
    rest.set_xlabel("frequency, Hz", fontsize=9)
    for ax in axes:
        _plain(ax, "both")
        ax.set_xlim(f[0], f[-1])
    if spot:
        _mark(amplitude, spot)


def _mark(ax: Axes, spot: Spot) -> None:
    """Arrow from the peak of the model before to the measured one, with the difference in words."""
    f, height = spot.measured
    ax.axvline(f, color=_INK, linewidth=0.7, linestyle=":")
    top = ax.get_ylim()[1]
    if not np.isfinite(spot.before[0]):
        text = f"{f:.2f} Hz: no such peak in 'before'"
    elif spot.by_height:
        text = f"{f:.2f} Hz: 'before' is {off_by(spot.before[1], height)} in amplitude"
    else:
        text = f"{f:.2f} Hz: 'before' is {off_by(spot.before[0], f)}"
    right = f > np.mean(ax.get_xlim())
    ax.set_ylim(top=3 * top)  # a strip of its own: no peak runs through the words
    ax.text(f, 1.6 * top, f" {text} ", fontsize=8.5, ha="right" if right else "left", va="center")


def _worst(records: Sequence[FrfRecord]) -> tuple[FrfRecord, int]:
    """Record and pair whose residual after is largest over its noise."""
    found = []
    for record in records:
        energy = record.energy("before").sum(axis=0).ravel()
        found.append((float(energy.max()), record, int(energy.argmax())))
    _, record, pair = max(found, key=lambda item: item[0])
    return record, pair


def _wrapped(H: np.ndarray, start: float) -> np.ndarray:
    """Phases in degrees from ``start`` to a turn more."""
    return np.asarray((np.rad2deg(np.angle(H)) - start) % 360 + start)


def _unbroken(phase: np.ndarray) -> np.ndarray:
    """Phases with the jumps of a turn not drawn."""
    broken = phase.copy()
    broken[1:][np.abs(np.diff(phase)) > 180] = np.nan
    return broken


# --- motion logs and modal tables -------------------------------------------------------------------------------------


def residual(records: Sequence[LogRecord], robot: Robot) -> Figure:
    """Residual torque of every joint over time, position and velocity, before and after; all runs."""
    n = records[0].measured.shape[1]
    positions, torques = axis_units(robot)
    figure = Figure(figsize=(11, 0.9 + 1.55 * n), layout="constrained")
    axes = figure.subplots(n, 3, squeeze=False, gridspec_kw={"width_ratios": [1.7, 1, 1]})
    stages = _stages(records)[1:]
    for i in range(n):
        for stage in stages:
            for k, values in enumerate(("time", "position", "velocity")):
                for r in records:
                    x = getattr(r, values)
                    x = x if x.ndim == 1 else x[:, i]
                    rest = (r.measured - r.predicted[stage])[:, i]
                    keep = np.flatnonzero(r.valid)[:: max(1, int(r.valid.sum()) * len(records) // _DOTS)]
                    style: dict[str, Any] = {"color": COLOURS[stage], "alpha": 0.55, "linewidth": 0}
                    axes[i, k].plot(x[keep], rest[keep], ".", markersize=1.6, **style)
        noise = records[0].noise[i]
        for ax in axes[i]:
            if np.isfinite(noise):
                ax.axhspan(-noise, noise, color="#c9ced6", alpha=0.6, linewidth=0, zorder=0)
            _plain(ax, "both")
        axes[i, 0].set_ylabel(f"joint{i + 1}, {torques[i]}", fontsize=9)
        axes[i, 1].set_xlabel(f"position, {positions[i]}", fontsize=8)
        axes[i, 2].set_xlabel(f"velocity, {positions[i]}/s", fontsize=8)
        for ax in axes[i, 1:]:
            ax.xaxis.set_major_locator(MaxNLocator(5))
            ax.set_ylim(*axes[i, 0].get_ylim())
            ax.set_yticklabels([])
    axes[-1, 0].set_xlabel("time, s", fontsize=8)
    for ax, title in zip(axes[0], ("over time", "over position", "over velocity"), strict=True):
        ax.set_title(f"residual torque {title}", fontsize=9.5, loc="left")
    handles = [Line2D([], [], marker="o", markersize=4, linestyle="", color=COLOURS[s], label=NAMES[s]) for s in stages]
    handles.append(Line2D([], [], color="#c9ced6", linewidth=6, label="noise, ± one standard deviation"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    figure.align_ylabels(axes[:, 0])
    return figure


def torque(records: Sequence[LogRecord], robot: Robot) -> Figure:
    """Measured torque and both models, on the joint where the answer shows best, in a used and in a held-out run."""
    _, units = axis_units(robot)
    columns = []
    for held in (False, True):
        of = [r for r in records if r.held_out == held]
        if of:
            columns.append(max(((*_joint(r), r) for r in of), key=lambda item: item[1]))
    figure = Figure(figsize=(0.6 + 5.3 * len(columns), 4.4), layout="constrained")
    axes = figure.subplots(2, len(columns), squeeze=False, sharex="col", gridspec_kw={"height_ratios": [2, 1]})
    stages = _stages(records)[1:]
    for column, (i, _, r) in enumerate(columns):
        top, bottom = axes[:, column]
        time = r.time - r.time[0]
        hidden = np.where(r.valid, 0.0, np.nan)
        top.plot(time, r.measured[:, i] + hidden, color=_INK, linewidth=2.4, alpha=0.45)
        for stage in stages:
            model = r.predicted[stage][:, i] + hidden
            top.plot(time, model, color=COLOURS[stage], linewidth=1.0)
            bottom.plot(time, r.measured[:, i] - model, color=COLOURS[stage], linewidth=0.8)
        if np.isfinite(r.noise[i]):
            bottom.axhspan(-r.noise[i], r.noise[i], color="#c9ced6", alpha=0.6, linewidth=0, zorder=0)
        top.set_title(f"joint{i + 1} in '{r.name}' ({'held out' if r.held_out else 'used'})", fontsize=10, loc="left")
        top.set_ylabel(f"torque, {units[i]}", fontsize=9)
        bottom.set_ylabel(f"residual, {units[i]}", fontsize=9)
        bottom.set_xlabel("time, s", fontsize=9)
        for ax in (top, bottom):
            _plain(ax, "both")
    handles = [
        Line2D([], [], color=_INK, linewidth=2.4, alpha=0.45, label="recorded"),
        *(Line2D([], [], color=COLOURS[s], linewidth=1.3, label=NAMES[s]) for s in stages),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    figure.align_ylabels()
    return figure


def _joint(record: LogRecord) -> tuple[int, float]:
    """The joint whose relative residual falls most, and by how much."""
    power = [np.mean((record.measured - record.predicted[s])[record.valid] ** 2, axis=0) for s in ("before", "after")]
    fall = (np.sqrt(power[0]) - np.sqrt(power[1])) / np.sqrt(np.mean(record.measured[record.valid] ** 2, axis=0))
    return int(np.argmax(fall)), float(fall.max())


def modal(records: Sequence[ModalRecord]) -> Figure:
    """Modelled over measured frequency and damping of every mode, before and after, with measured uncertainty."""
    rows, stages = [(r, k) for r in records for k in range(len(r.measured))], _stages(records)
    figure = Figure(figsize=(9, 1.3 + 0.27 * len(rows)), layout="constrained")
    axes, narrow = figure.subplots(1, 2, sharey=True), True
    for column, ax in enumerate(axes):
        for y, (r, k) in enumerate(rows):
            reference = r.measured[k, column]
            width = 164.5 * r.deviation[k, column]
            ax.plot([-width, width], [y, y], color="#c9ced6", linewidth=6, solid_capstyle="butt", zorder=0)
            for stage in stages:
                ax.plot(
                    100 * (r.predicted[stage][k, column] / reference - 1), y, "o", color=COLOURS[stage],
                    markersize=5 + RIM * (stage == "before"),
                    markerfacecolor="white" if stage == "as_given" else COLOURS[stage],
                )  # fmt: skip
        ax.axvline(0, color=_INK, linewidth=0.8)
        low, high = ax.get_xlim()
        narrow &= 329 * max(float(np.nanmax(r.deviation[:, column])) for r in records) < NARROW * (high - low)
        ax.set_xlabel(f"{('frequency', 'damping ratio')[column]}, model against measured, %", fontsize=9)
        _plain(ax, "x")
    names = [f"{r.name}{' *' if r.held_out else ''}  {r.measured[k, 0]:.2f} Hz" for r, k in rows]
    axes[0].set_yticks(range(len(rows)), names, fontsize=8.5)
    axes[0].set_ylim(len(rows) - 0.4, -0.6)
    handles = [
        Line2D([], [], marker="o", linestyle="", color=COLOURS[s], label=NAMES[s],
               markerfacecolor="white" if s == "as_given" else COLOURS[s]) for s in stages
    ]  # fmt: skip
    if narrow:
        figure.supxlabel("90 % intervals of what was measured are narrower than the dots", fontsize=8.5)
    else:
        handles.append(Line2D([], [], color="#c9ced6", linewidth=6, label="measured, 90 %"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False, fontsize=8.5)
    return figure


def _plain(ax: Axes, grid: str) -> None:
    ax.grid(True, axis=grid, color=_GRID, linewidth=0.6)  # type: ignore[arg-type]
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8, length=3)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _percent_axis(ax: Axes) -> None:
    """A logarithmic axis of per cent with plain numbers at 1, 2, 5."""
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ticks = [m * 10.0**e for e in range(-4, 5) for m in (1, 2, 5) if low <= m * 10.0**e <= high]
    ax.xaxis.set_major_locator(FixedLocator(ticks))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g} %"))
    ax.xaxis.set_minor_locator(NullLocator())
    _plain(ax, "x")


class _Powers(ScalarFormatter):
    """Numbers with a power of ten that they share written at the axis' end."""

    def __init__(self) -> None:
        super().__init__(useOffset=False)
        self.set_powerlimits((-2, 4))

    def get_offset(self) -> str:
        """``×10⁷``; nothing for ordinary numbers."""
        written = super().get_offset().replace("\N{MINUS SIGN}", "-").removeprefix("1e")
        return f"×{_power(int(written))}" if written else ""


def _power(exponent: int) -> str:
    return "10" + str(exponent).translate(_RAISED)


def _decades(axis: Axis) -> None:
    """A logarithmic axis with numbers at 1, in plain text, and ticks at 2 and 5.

    What is laid out is measured six times: mathematics, and ticks at every digit with their empty labels, would take
    half the time of it all.
    """
    axis.set_major_formatter(FuncFormatter(lambda value, _: _power(round(np.log10(value)))))
    axis.set_minor_locator(LogLocator(subs=(2, 5)))
    axis.set_minor_formatter(NullFormatter())
    axis.set_tick_params(which="minor", label1On=False)


# --- the page ---------------------------------------------------------------------------------------------------------


def title(verdict: Verdict) -> str:
    """Heading of the page."""
    return f"{verdict.robot.name}: what the model leaves out"


def lead(verdict: Verdict) -> str:
    """The result in a sentence."""
    if not verdict.missing:
        return MEANING[verdict.word]
    names = "; ".join(f"{m.first.title} (probability {m.probability:.2f})" for m in verdict.missing)
    rivals = [c.title for m in verdict.missing for c, _ in m.rivals]
    return f"{verdict.word}: {names}" + (f"; or {', '.join(rivals)}" if rivals else "")


def sections(verdict: Verdict, drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    first = f", likeliest {verdict.likeliest}" if verdict.likeliest else ""
    unclear = f" Something known but not clear: {verdict.unclear:.2f}{first}." if verdict.unclear else ""
    probable = [
        f"Nothing missing: {verdict.none:.2f}.{unclear} Something without a name here: {verdict.other:.2f}. "
        "Probabilities are calibrated on development cases: of answers given 0.9, nine in ten are right."
    ]
    found = [
        Section(
            "Answer", [m.evidence for m in verdict.missing] + probable, tables=_answers(verdict),
            figures=pick(drawn, "probabilities.png", CAPTIONS["probabilities.png"]),
        ),
    ]  # fmt: skip
    if verdict.next_test:
        found.append(Section("Next test", [_sentence(verdict.next_test["description"])]))
    for finding in verdict.findings:
        found += _of_recording(verdict, finding, drawn)
    checks = [f"{check['description']}." for check in verdict.checks if check["passed"]]
    failed = [f"failed: {check['description']}" for check in verdict.checks if not check["passed"]]
    edit, tables = verdict.payload_edit, []
    if edit:
        checks.append(f"Edit test: {edit['description']}.")
        tables.append(_edit_table(edit))
    found.append(Section("The new model", checks, failed, tables))
    if verdict.smallest_visible:
        text = (
            "The smallest size of an effect that these recordings would have shown, although all free numbers of the "
            "model may move to hide it."
        )
        figures = pick(drawn, "smallest_visible.png", CAPTIONS["smallest_visible.png"])
        tables = _visible_table(verdict.smallest_visible, verdict.base)
        if figures and tables:
            text += " The picture has the effects that have a usual size, the table the others."
        found.append(Section("What could have been seen", [text], tables=tables, figures=figures))
    return found


def _of_recording(verdict: Verdict, finding: Finding, drawn: Mapping[str, Path]) -> list[Section]:
    """Errors of one recording, where they show, and where the model misses most."""
    several = f" · {Path(finding.recording).name}" if len(verdict.findings) > 1 else ""
    of = {name: path for name, path in drawn.items() if not several or name.startswith(Path(finding.recording).stem)}
    error_text = _error_text(finding, bool(verdict.missing))
    notes = [text for text in finding.warnings if getattr(text, "severity", "") == "note"]
    found = [
        Section(
            f"Errors{several}", [error_text, *(_sentence(note) for note in notes)],
            [text for text in finding.warnings if text not in notes], [_error_table(finding)],
            pick(of, "errors.png", CAPTIONS["errors.png"]),
        )
    ]  # fmt: skip
    frfs = [r for r in finding.records if isinstance(r, FrfRecord)]
    shown = bool(verdict.missing) and _changes(finding)
    captions = CAPTIONS if shown else CAPTIONS | BOTH
    for heading, text, names, plots in (
        (
            "Where it shows" if shown else "Recorded and predicted",
            "",
            ("overlay.png", "torque.png", "modes.png"),
            _plots(finding),
        ),
        (
            "What the refitted model misses" if shown else "Where the model misses most",
            _location_text(finding),
            ("mismatch.png", "residual.png", "sites.png"),
            [mismatch_map(frfs)] if frfs else [],
        ),
    ):
        figures = [pair for name in names for pair in pick(of, name, captions[name])]
        if figures:
            found.append(Section(heading + several, [text] if text else [], figures=figures, plots=plots))
    return found


def _changes(finding: Finding) -> bool:
    """Whether the answer changes the error of this recording by more than a hundredth."""
    errors = [(finding.error["before"][part], finding.error["after"][part]) for part in ("train", "held_out")]
    return any(None not in pair and abs(pair[1] - pair[0]) > 0.01 * pair[0] for pair in errors)


def _plots(finding: Finding) -> list[Plot]:
    """What was recorded, and both models, of every posture or run, to zoom."""
    frfs: dict[str, Panel] = {}
    torques: dict[str, Panel] = {}
    quantity, (_, units) = QUANTITIES[-1], axis_units(finding.robot)
    stages = _stages(finding.records)[1:]
    for r in finding.records:
        name = f"{r.name}, {'held out' if r.held_out else 'used'}"
        if isinstance(r, FrfRecord):
            curves = {"measured": r.measured} | {NAMES[s]: r.predicted[s] for s in stages}
            frfs |= frf_panels(name, r.frequency, curves, r.response.label, r.excitation.label)
            quantity = r.quantity
        elif isinstance(r, LogRecord):
            torque = {"recorded": r.measured} | {NAMES[s]: r.predicted[s] for s in stages}
            torques |= torque_panels(name, r.time, torque, r.units or units[: r.measured.shape[1]], r.valid)
    return ([frf_plot(frfs, quantity)] if frfs else []) + ([torque_plot(torques, units)] if torques else [])


def _answers(verdict: Verdict) -> list[Table]:
    tables = []
    for missing in verdict.missing:
        rows = [(row.split(" ", 1)[0], *_split(row)) for row in parameter_rows(missing.first.parameters)]
        if missing.first.formula:
            rows.append(("torque", missing.first.formula, ""))
        tables.append(Table((missing.first.title, "value", "90 % interval"), rows, (1, 2)))
        others = [(c.title, f"{p:.3f}") for c, p in missing.alternatives if p >= 1e-3][:_ANSWERS]
        if others:
            tables.append(Table(("alternative", "probability"), others, (1,)))
    return tables


def _split(row: str) -> tuple[str, str]:
    value, _, interval = row.split(" ", 1)[1].partition("   90 %: ")
    return value, interval


def _error_text(finding: Finding, answered: bool) -> str:
    held = listed(finding.held_out) or "nothing"
    turn = ", each in turn" if finding.in_turn else ""
    after = "with the answer" if answered else "the same, because nothing is added"
    return (
        f"Held out{turn}: {held}. As given: the description as it came. "
        f"Before: refitted to what was used, nothing added. After: {after}. "
        "On what was held out only posture angles, channel gains and torque offsets are re-estimated."
    )


def _error_table(finding: Finding) -> Table:
    def cell(value: float | None) -> str:
        return "" if value is None or not np.isfinite(value) else f"{value:.2%}"

    rows = []
    for title, part, held in PARTS:
        if finding.error["before"][part] is None:
            continue
        floor = _floor(finding, [r for r in finding.records if r.held_out == held] or finding.records)
        rows.append((f"all {title}", *(cell(finding.error[s][part]) for s in STAGES), cell(floor)))
    rows += [(_named(r), *(cell(r.error(s)) for s in STAGES), cell(r.floor)) for r in finding.records]
    return Table(("", "as given", "before", "after", "noise floor"), rows, (1, 2, 3, 4))


def _named(record: Record) -> str:
    return f"{record.name} (held out)" if record.held_out else record.name


def _location_text(finding: Finding) -> str:
    if not finding.location:
        return ""
    spot = finding.location[0]
    where = spot.get("posture") or spot.get("run") or ""
    band = spot.get("band_hz")
    at = f" at {band[0]:.3g}–{band[1]:.3g} Hz" if band else ""
    channels = f", mostly on {', '.join(spot['channels'])}" if spot.get("channels") else ""
    there = f"{spot['share']:.0%} of its weighted misfit"
    return f"Of the data used, the refitted model misses most in '{where}'{at}{channels}: {there} is there."


def _edit_table(edit: Mapping[str, Any]) -> Table:
    def shift(pair: Sequence[float]) -> str:
        return f"{100 * (pair[1] / pair[0] - 1):+.1f} %"

    rows = []
    for m in edit["modes"]:
        before, after = m["before_hz"], m["after_hz"]
        cells = (f"{f:.2f}" for f in (*before, *after))
        rows.append((f"mode {m['mode']}", *cells, shift(before), shift(after)))
    header = ("Hz", "before", "with payload", "after", "with payload", "shift before", "shift after")
    return Table(header, rows, (1, 2, 3, 4, 5, 6))
