"""The report of a map: the workspace coloured by depth of cut, depth along a path, modes over postures; rerun."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from twin.model.recorded import without_limits
from twin.report.figures import PALETTE
from twin.report.html import Section
from twin.robot.mechanism import assemble

if TYPE_CHECKING:
    from twin.commands.map import Map

COLOURS = colormaps["viridis"]
_GREY, _BLUE, _ORANGE = "#8a8f98", "#1f4e9c", "#e8590c"
MODES = (*PALETTE[:3], PALETTE[7])
NARROW = 0.015  # of an axis: an interval that a dot hides
RAPID = 2.5  # times the usual spacing of points: the tool was lifted between them
_VIEWS = ((0, 2, "from the side"), (0, 1, "from above"))


CAPTIONS = {
    "workspace.png": "Depth over the workspace, from the side and from above.",
    "modes.png": "Frequency and damping of the first modes over the map.",
    "path.png": "Depth and first frequencies along the path; the mark is the shallowest point.",
    "lobes.png": "Lobes of all postures: quantiles over the map at each speed.",
}


def draw(found: "Map") -> dict[str, Figure]:
    """File name → figure."""
    figures = {"workspace.png": workspace(found), "modes.png": modes(found)}
    if found.path is not None:
        figures["path.png"] = along(found)
    if found.speeds is not None:
        figures["lobes.png"] = over_speed(found)
    return figures


def _norm(found: "Map") -> LogNorm:
    low, high = np.quantile(1e3 * found.ranked, (0.02, 0.98))
    return LogNorm(max(low, 1e-9), max(high, low * 1.01, 1.01e-9))


def _label(found: "Map") -> str:
    return "limiting depth, mm" if found.safe is None else "depth stable with 90 % probability, mm"


def _title(found: "Map") -> str:
    said = "least over all spindle speeds" if found.spindle_rpm is None else f"{found.spindle_rpm:g} rpm"
    if found.speeds is not None:
        said = f"least from {found.speeds[0]:.0f} to {found.speeds[-1]:.0f} rpm"
    return f"{found.robot.name}, {len(found.places)} postures: {_label(found).split(',')[0]}, {said}"


def workspace(found: "Map") -> Figure:
    """The tip's places from the side and from above; the least sure on top, so that no bad place is hidden."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    norm, order = _norm(found), np.argsort(-found.ranked)
    tip, depth = found.result["tip_m"][order], 1e3 * found.ranked[order]
    size = float(np.clip(6000 / len(tip), 3, 40))
    for ax, (a, b, name) in zip(axes, _VIEWS, strict=True):
        ax.scatter(tip[:, a], tip[:, b], c=depth, s=size, cmap=COLOURS, norm=norm, linewidths=0, rasterized=True)
        ax.plot(0, 0, "^", color="#111111", markersize=8)
        ax.annotate(
            "foot", (0, 0), textcoords="offset points", xytext=(8, -4), fontsize=8, zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel(f"{'xyz'[a]}, m")
        ax.set_ylabel(f"{'xyz'[b]}, m")
        ax.set_title(name, fontsize=10)
        _tidy(ax)
    bar = figure.colorbar(ScalarMappable(norm, COLOURS), ax=list(axes), label=_label(found), extend="both")
    _plain(bar.ax.yaxis)
    figure.suptitle(_title(found), fontsize=11)
    return figure


def modes(found: "Map") -> Figure:
    """Frequencies and damping ratios of the lowest modes over the postures, those of least depth first."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    order = np.argsort(found.ranked)
    share = 100 * np.arange(len(order)) / max(1, len(order) - 1)
    size, seen = float(np.clip(600 / len(order), 2, 5)), False
    for ax, name, label in zip(
        axes, ("frequency_hz", "damping_percent"), ("frequency, Hz", "damping ratio, %"), strict=True
    ):
        values = found.result[name][order]
        band, widest = found.result.get(f"{name}_interval90"), 0.0
        for k in range(min(len(MODES), values.shape[1])):
            if np.isnan(values[:, k]).all():
                continue
            colour = MODES[k]
            if band is not None and len(order) <= 2000:
                low, high = band[order, k].T
                ax.vlines(share, low, high, color=colour, alpha=0.5, linewidth=1.2)
                widest = max(widest, float(np.nanmedian(np.log(high / low))))
            ax.plot(share, values[:, k], ".", markersize=size, color=colour, label=f"mode {k + 1}")
        ax.set_yscale("log")
        seen |= widest > NARROW * float(np.log(np.divide(*ax.get_ylim()[::-1])))
        ax.set_xlabel("postures from the shallowest to the deepest cut, %")
        ax.set_ylabel(label)
        _plain(ax.yaxis)
        _tidy(ax)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(
                fontsize=8, markerscale=8 / size, ncols=4, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0)
            )
    figure.suptitle(f"{found.robot.name}: modes over the map" + (", 90 % intervals" if seen else ""))
    return figure


def along(found: "Map") -> Figure:
    """Depth and first frequencies along a path, with the file's lines."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    at = found.places.along
    gaps = np.flatnonzero(np.diff(at) > RAPID * np.median(np.diff(at))) + 1  # rapid moves: nothing is drawn across

    def broken(values: np.ndarray) -> np.ndarray:
        return np.insert(np.asarray(values, float), gaps, np.nan)

    upper.semilogy(broken(at), broken(1e3 * found.depth), color=_GREY, linewidth=1.2, label="limit of the model")
    if found.safe is not None:
        upper.semilogy(
            broken(at), broken(1e3 * found.safe), color=_BLUE, linewidth=2, label="stable with 90 % probability"
        )
    k = int(np.argmin(found.ranked))
    upper.plot(at[k], 1e3 * found.ranked[k], "o", color=_ORANGE)
    right = at[k] > 0.5 * (at[0] + at[-1])
    upper.annotate(
        f"line {found.places.line[k]}: {1e3 * found.ranked[k]:.3g} mm", (at[k], 1e3 * found.ranked[k]),
        textcoords="offset points", xytext=(-8 if right else 8, -14), ha="right" if right else "left", va="top",
        fontsize=9, color=_ORANGE, annotation_clip=False,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
    )  # fmt: skip
    upper.margins(y=0.25)
    upper.set_ylabel("depth, mm")
    _plain(upper.yaxis)
    upper.legend(fontsize=9, ncols=2, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    for mode, colour in enumerate(MODES[:3]):
        frequency = broken(found.result["frequency_hz"][:, mode])
        lower.plot(broken(at), frequency, color=colour, linewidth=1.2, label=f"mode {mode + 1}")
    lower.set_ylabel("frequency, Hz")
    lower.set_xlabel("along the path, m")
    lower.legend(fontsize=8, ncols=3, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    for ax in (upper, lower):
        _tidy(ax)
    figure.suptitle(f"{found.robot.name}: how deep along the path")
    return figure


def over_speed(found: "Map") -> Figure:
    """Lobes of all postures: quantiles over the map at each speed."""
    assert found.speeds is not None
    figure = Figure(figsize=(9, 5), layout="constrained")
    ax = figure.subplots()
    depth = 1e3 * found.result.get("depth_safe90_m", found.result["depth_m"])
    low, middle, high = np.quantile(depth, (0.05, 0.5, 0.95), axis=0)
    ax.fill_between(found.speeds, low, high, color=_BLUE, alpha=0.2, label="90 % of the postures")
    ax.plot(found.speeds, middle, color=_BLUE, label="median posture")
    ax.plot(found.speeds, depth.min(axis=0), color=_ORANGE, linewidth=1, label="worst posture")
    ax.set_yscale("log")
    ax.set_xscale("log")
    ax.set_xlabel("spindle speed, rpm")
    ax.set_ylabel(_label(found))
    _plain(ax.xaxis)
    _plain(ax.yaxis)
    ax.legend(fontsize=9)
    _tidy(ax)
    ax.set_title(f"{found.robot.name}: lobes over {len(found.places)} postures", fontsize=11)
    return figure


def write_scene(path: str | Path, found: "Map") -> None:
    """The workspace around the robot in rerun, the robot in the best posture of the map."""
    from twin.report.scene import write_points

    best = int(np.argmax(found.ranked))
    mechanism = assemble(without_limits(found.robot), found.places.q[best])
    colours = (255 * COLOURS(_norm(found)(1e3 * found.ranked))[:, :3]).astype(np.uint8)
    labels = [
        f"{1e3 * depth:.3g} mm · {frequency:.1f} Hz · q {', '.join(f'{v:.0f}' for v in found.robot.degrees(q))}°"
        for depth, frequency, q in zip(
            found.ranked, found.result["frequency_hz"][:, 0], found.places.q, strict=True
        )
    ]  # fmt: skip
    low, high = 1e3 * np.quantile(found.ranked, (0.02, 0.98))
    text = (
        f"# {_title(found)}\n\nDark violet {low:.3g} mm or less, yellow {high:.3g} mm or more. "
        "Point at a place to read its depth, first mode and posture. The robot stands in the best posture."
    )
    strip = None if found.path is None else found.result["tip_m"]
    write_points(path, mechanism, found.result["tip_m"], colours, labels, text, strip)


def _tidy(ax: Axes) -> None:
    ax.set_axisbelow(True)
    ax.grid(True, color="#d5d8dd", linewidth=0.5)
    ax.tick_params(direction="in", labelsize=8)


def _plain(axis: Any) -> None:
    """1, 2 and 5 of every decade, or even steps where that leaves few, as people write them."""
    low, high = axis.get_view_interval()
    wide = high > 8 * low
    axis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0), numticks=20) if wide else MaxNLocator(7, steps=[1, 2, 5, 10])
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def title(found: "Map") -> str:
    """Of the page."""
    return f"How deep {found.robot.name} may cut, and where"


def lead(found: "Map") -> str:
    """What is mapped."""
    return _title(found)


def sections(found: "Map", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    return [
        Section("Depth", tables=found.tables()),
        Section("Maps", figures=[(CAPTIONS[name], path) for name, path in drawn.items()]),
    ]
