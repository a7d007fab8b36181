"""Figures of a fit: parameter intervals against the prior, errors by posture and band, MAC, profiles."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from twin.identify.elastic_compare import Comparison
from twin.identify.uncertainty import NINETY, Estimate
from twin.measure.campaign import FloatArray
from twin.report.figures import PALETTE, WHITE_ON

_DATA, _PRIOR, _PALE = "#1f4e9c", "#dde1e6", "#7d8ea3"


def intervals(estimates: Sequence[Estimate]) -> Figure:
    """90 % intervals of springs and dampers over those of their priors, relative to the prior's median.

    Blue: the data hold the parameter; grey: they do not, and what is shown is mostly the prior.
    """
    shown = [e for e in estimates if e.parameter.kind in ("spring", "entry") and e.parameter.log]
    groups = [
        (title, [e for e in shown if (e.parameter.quantity == "stiffness") == stiff])
        for title, stiff in (("stiffness", True), ("damping and other", False))
    ]
    rows = max((len(found) for _, found in groups), default=1)
    figure = Figure(figsize=(11, 1.6 + 0.3 * max(rows, 3)), layout="constrained")
    axes = figure.subplots(1, 2, squeeze=False)[0]
    for ax, (title, found) in zip(axes, groups, strict=True):
        for row, e in enumerate(found):
            mean, width = e.parameter.mean, NINETY * e.parameter.deviation
            ax.plot([np.exp(-width), np.exp(width)], [row, row], color=_PRIOR, linewidth=7, solid_capstyle="butt")
            low, high = e.interval90
            colour = _DATA if e.identifiable else _PALE
            ax.plot([low / mean, high / mean], [row, row], color=colour, linewidth=2.5, solid_capstyle="butt")
            ax.plot(e.value / mean, row, "o", color=colour, markersize=4)
        ax.set_xscale("log")
        names = [e.parameter.name.removesuffix(".stiffness").removesuffix(".damping") for e in found]
        ax.set_yticks(range(len(found)), names, fontsize=8)
        ax.invert_yaxis()
        ax.axvline(1, color="#444444", linewidth=0.6)
        ax.grid(True, axis="x", which="both", color="#e3e6ea", linewidth=0.5)
        ax.set_title(f"{title} over the prior's median; wide bar: prior, 90 %", fontsize=9, loc="left")
        low, high = ax.get_xlim()
        if high < 1e3 * low:
            ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            ax.xaxis.set_minor_formatter(NullFormatter())
        ax.tick_params(labelsize=8)
    return figure


def errors(comparisons: Mapping[str, Comparison]) -> Figure:
    """Error by posture and frequency band, one panel per role (``fitted``, ``held out``)."""
    figure = Figure(figsize=(max(10.4, 5.2 * len(comparisons)), 3.4), layout="constrained")
    axes = figure.subplots(1, len(comparisons), squeeze=False, sharey=True)[0]
    for ax, (role, comparison) in zip(axes, comparisons.items(), strict=True):
        postures = dict.fromkeys(part["posture"] for part in comparison.parts)
        for posture, colour in zip(postures, cycle(PALETTE), strict=False):
            bands = [part for part in comparison.parts if part["posture"] == posture and part["band_hz"]]
            edges = [part["band_hz"][0] for part in bands] + [bands[-1]["band_hz"][1]]
            ax.stairs(
                [100 * part["error"] for part in bands],
                edges,
                baseline=None,
                label=posture,
                color=colour,
                linewidth=1.6,
            )
        if comparison.noise_floor is not None:
            ax.axhline(100 * comparison.noise_floor, color="#444444", linestyle=":", linewidth=1, label="noise floor")
        ax.set_axisbelow(True)
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_title(f"{role}: {100 * comparison.error:.2f} %", fontsize=10, loc="left")
        ax.set_xlabel("frequency, Hz")
        ax.grid(True, which="both", color="#e3e6ea", linewidth=0.5)
        ax.legend(
            fontsize=8, frameon=False, ncols=1 + len(ax.patches) // 13, loc="center left", bbox_to_anchor=(1.0, 0.5)
        )
    axes[0].set_ylabel("error, %")
    return figure


def mac_matrices(
    matrices: Mapping[str, FloatArray], measured: Mapping[str, Sequence[float]], model: Mapping[str, Sequence[float]]
) -> Figure:
    """MAC of measured (rows) and model's (columns) modes, one panel per posture, frequencies in Hz on the axes."""
    axes, figure = _panels(len(matrices), 3, (3.6, 3.3))
    for ax, (posture, matrix) in zip(axes, matrices.items(), strict=True):
        ax.imshow(matrix, vmin=0, vmax=1, cmap="Blues")
        for i, j in np.ndindex(matrix.shape):
            colour = "white" if matrix[i, j] > WHITE_ON else "#111111"
            ax.text(j, i, f"{100 * matrix[i, j]:.0f}", ha="center", va="center", fontsize=8, color=colour)
        ax.set_xticks(range(matrix.shape[1]), [f"{f:.1f}" for f in model[posture]], fontsize=8)
        ax.set_yticks(range(matrix.shape[0]), [f"{f:.1f}" for f in measured[posture]], fontsize=8)
        ax.set_xlabel("model, Hz", fontsize=9)
        ax.set_title(posture, fontsize=10)
    axes[0].set_ylabel("measured, Hz", fontsize=9)
    figure.suptitle("MAC, %", fontsize=10)
    return figure


def profiles(found: Mapping[str, tuple[FloatArray, FloatArray]], units: Mapping[str, str]) -> Figure:
    """Profiles: twice the cost above its minimum when one parameter is held and everything else refitted.

    The dotted line at 2.71 cuts a 90 % interval.
    """
    axes, figure = _panels(len(found), 2, (4.6, 2.6))
    figure.supylabel("rise of 2 × cost, everything else refitted", fontsize=9)
    for ax, (name, (value, drop)) in zip(axes, found.items(), strict=True):
        ax.plot(value, drop, "o-", color=_DATA, markersize=3, linewidth=1.2)
        ax.axhline(2.71, color="#444444", linestyle=":", linewidth=1, label="2.71: below lies the 90 % interval")
        ax.set_ylim(0, 8)
        if value[0] > 0 and value[-1] > 10 * value[0]:
            ax.set_xscale("log")
        ax.set_title(f"{name}, {units[name]}".removesuffix(", 1"), fontsize=9)
        ax.tick_params(labelsize=8)
    if axes:
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", frameon=False, fontsize=8)
    return figure


def _panels(count: int, columns: int, size: tuple[float, float]) -> tuple[list[Axes], Figure]:
    """``count`` axes in rows of ``columns``, each of a size in inches."""
    columns = min(columns, max(1, count))
    rows = -(-max(1, count) // columns)
    figure = Figure(figsize=(size[0] * columns, size[1] * rows + 0.4), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes[count:]:
        ax.set_axis_off()
    return axes[:count], figure
