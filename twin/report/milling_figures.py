"""The report of ``twin lobes``: the stability chart, what vibrates at the limit, and the vibration of the safe cut."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.report.html import Panel, Plot, Section, pick

if TYPE_CHECKING:
    from twin.commands.lobes import StabilityLobes

KINDS = {"hopf": "#1f4e9c", "flip": "#e8590c", "mode_coupling": "#7048a8"}
TITLES = {"hopf": "Hopf", "flip": "flip", "mode_coupling": "mode coupling"}
_SAFE, _SHADE, _GREY = "#0b7285", "#e4e7eb", "#8a8f98"
DEPTHS = 240  # of the shaded chart
ROOM = 1.25  # of a chart, over the deepest cut that is stable or was found to chatter
VIEW = 4.0  # times the median limit that the chart shows, if there is that much


def draw(found: "StabilityLobes") -> dict[str, Figure]:
    """File name → figure."""
    return {"lobes.png": lobes_chart(found)}


def lobes_chart(found: "StabilityLobes") -> Figure:
    """Chart, frequency at the limit, and forced vibration at the safe depth, over spindle speed."""
    figure = Figure(figsize=(9.0, 8.4), layout="constrained")
    chart, frequency, forced = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 1.0, 1.2])
    _chart(chart, found)
    lobes = found.lobes
    for kind, color in KINDS.items():
        here = lobes.kind == kind
        frequency.plot(lobes.spindle_rpm[here], lobes.frequency_hz[here], ".", color=color, markersize=2.5)
    frequency.set_ylabel("vibrates at, Hz")
    frequency.set_ylim(0, 1.1 * float(np.nanmax(lobes.frequency_hz, initial=0.0)) or 1.0)
    _forced(forced, found)
    forced.set_xlabel("spindle speed, rpm")
    for ax in (chart, frequency, forced):
        ax.grid(True, color="#d5d8dd", linewidth=0.5)
        ax.tick_params(direction="in", labelsize=9)
    case = found.case
    who = case.robot.name if case.robot else "measured FRF"
    chart.set_title(
        f"{who}, {case.name}: {case.cut.milling} milling, immersion {case.cut.immersion:g}, "
        f"{case.cut.tool.teeth} teeth of {1e3 * case.cut.tool.diameter_m:g} mm",
        fontsize=10, loc="left",
    )  # fmt: skip
    return figure


def _chart(ax: Axes, found: "StabilityLobes") -> None:
    lobes = found.lobes
    rpm = lobes.spindle_rpm
    top = min(lobes.depth_max_m, VIEW * float(np.median(lobes.depth_m)))
    highest = float(lobes.depth_m[lobes.kind != "none"].max(initial=0.0))
    many = highest >= 2 * top  # white above what is shown would look stable there
    if lobes.depth_m.max() < 2 * top or many:
        top = max(top, 1.15 * (highest if many else float(lobes.depth_m.max())))
    bottom = 0.5 * float(lobes.depth_m.min()) if many else 0.0
    depth = (np.geomspace if many else np.linspace)(bottom, min(top, lobes.depth_max_m), DEPTHS)
    unstable = (lobes.limits.unstable(depth) > 0).T.astype(float)
    ax.contourf(rpm, 1e3 * depth, unstable, levels=[0.5, 1.5], colors=[_SHADE])
    deepest = [float(depth[(unstable < 0.5).any(axis=1)].max()), *(chatter for _, chatter in found.in_time)]
    if lobes.draws_m is not None:
        deepest.append(float(np.quantile(lobes.draws_m, 0.95, axis=0).max()))
    top = min(top, ROOM * max(deepest))  # nothing is stable above
    ax.plot([], [], color=_SHADE, linewidth=8, label="unstable")
    if lobes.draws_m is not None and lobes.draws_rpm is not None:
        low, high = np.quantile(lobes.draws_m, [0.05, 0.95], axis=0)
        ax.fill_between(
            lobes.draws_rpm, 1e3 * low, 1e3 * high, color=_SAFE, alpha=0.15, linewidth=0, label="limit, 90 % of draws"
        )
    for kind, color in KINDS.items():
        here = lobes.kind == kind
        if here.any():
            ax.plot(
                rpm, np.where(here, 1e3 * lobes.depth_m, np.nan), color=color, linewidth=1.6,
                label=f"limit: {TITLES[kind]}",
            )  # fmt: skip
    ax.plot(rpm, 1e3 * found.closed_form_m, "--", color=_GREY, linewidth=1.0, label="zeroth-order approximation")
    if lobes.safe_m is not None:
        ax.plot(rpm, 1e3 * lobes.safe_m, color=_SAFE, linewidth=2.0, label="stable with 90 % probability")
    if found.in_time:
        at, chatter = np.array(found.in_time).T
        ax.plot(at, 1e3 * chatter, "o", color="#111111", markersize=5, label="chatter in time, nonlinear joints")
    ax.set_ylabel("axial depth of cut, mm")
    ax.set_xlim(rpm[0], rpm[-1])
    ax.set_yscale("log" if many else "linear")
    ax.set_ylim(1e3 * bottom, 1e3 * top)
    columns = -(-len(ax.get_legend_handles_labels()[1]) // 2)
    ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.05), ncols=columns, frameon=False)


def _forced(ax: Axes, found: "StabilityLobes") -> None:
    rpm, _, shaken = found.forced
    peak = 1e6 * np.array([v.peak_to_peak_m for v in shaken])
    wall = 1e6 * np.array([v.surface_error_m for v in shaken])
    ax.plot(rpm, peak.max(axis=1), color="#111111", linewidth=1.2, label="tip, peak to peak")
    ax.fill_between(rpm, wall[:, 1], wall[:, 0], color="#f08c00", alpha=0.4, linewidth=0)
    ax.plot(rpm, wall.mean(axis=1), color="#f08c00", linewidth=1.2, label="surface location error (+: too deep)")
    where = "at the safe depth" if found.lobes.safe_m is not None else "at 90 % of the limit"
    ax.set_ylabel(f"{where}, µm", fontsize=9)
    ax.axhline(0, color=_GREY, linewidth=0.6)
    ax.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def title(found: "StabilityLobes") -> str:
    """Of the page."""
    case = found.case
    return f"How deep {case.robot.name if case.robot else 'the measured tool'} may cut: {case.name}"


def lead(found: "StabilityLobes") -> str:
    """The robot, the cut and the tool."""
    return str(found).partition("\n")[0]


def sections(found: "StabilityLobes", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    lobes = found.lobes
    curves = {"limit": 1e3 * lobes.depth_m, "zeroth-order approximation": 1e3 * found.closed_form_m}
    if lobes.safe_m is not None:
        curves["stable with 90 % probability"] = 1e3 * lobes.safe_m
    panels = {"depth of cut": Panel(lobes.spindle_rpm, curves)}
    chart = Plot("Depth of cut.", "spindle speed, rpm", "axial depth of cut, mm", panels)
    caption = "Stability chart, frequency at the limit, forced vibration and the error that it leaves."
    return [
        Section(
            "Depth of cut",
            [f"{line[0].upper()}{line[1:]}." for line in found.summary()],
            figures=pick(drawn, "lobes.png", caption),
            plots=[chart],
        ),
        Section("Limits", tables=found.tables()),
    ]
