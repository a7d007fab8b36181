"""Figures of a modal test: stabilisation chart, measured against synthesised FRFs, MAC and auto-MAC."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from twin.measure.campaign import ComplexArray
from twin.measure.modal import ModalResult
from twin.measure.shapes import mac, summation
from twin.report.figures import mode_shapes

if TYPE_CHECKING:
    from twin.commands.modal import ModalAnalysis

SYMBOLS = {"o": "new pole", "f": "frequency", "d": "frequency, damping", "v": "frequency, vector", "s": "stable"}
COLOURS = {"o": "0.75", "f": "0.5", "d": "tab:blue", "v": "tab:orange", "s": "tab:red"}
MOST_PANELS = 6


def stabilisation_figure(result: ModalResult) -> Figure:
    """Poles of every order by their symbol over the sum of all FRFs; lines mark the identified modes."""
    figure = Figure(figsize=(10, 5.5), layout="constrained")
    below = figure.add_subplot()
    below.semilogy(result.frequency, summation(result.measured), color="0.3", lw=1)
    below.set(xlabel="frequency [Hz]", ylabel="sum of |accelerance| [(m/s²)/N]")
    below.set_xlim(result.frequency[0], result.frequency[-1])
    above = below.twinx()
    above.set_ylabel("model order")
    for chart in result.charts:
        for found, marks in zip(chart.poles, chart.symbols, strict=True):
            for symbol in SYMBOLS:
                at = found.frequency[[mark == symbol for mark in marks]]
                at = at[(at >= result.frequency[0]) & (at <= result.frequency[-1])]
                above.plot(
                    at, np.full(at.size, found.order), ls="", marker=f"${symbol}$", ms=5, mew=0.2, c=COLOURS[symbol]
                )
    for mode in result.modes:
        below.axvline(mode.frequency_hz, color="tab:green", lw=0.8, ls="--", zorder=0)
    handles = [
        above.plot([], [], ls="", marker=f"${symbol}$", ms=6, c=COLOURS[symbol], label=meaning)[0]
        for symbol, meaning in SYMBOLS.items()
    ]
    handles.append(below.plot([], [], color="tab:green", lw=0.8, ls="--", label="identified")[0])
    figure.legend(handles=handles, loc="outside upper center", ncols=6, fontsize=8, title=result.name, frameon=False)
    return figure


def overlay_figure(result: ModalResult) -> Figure:
    """Amplitude and phase of the strongest FRFs, measured and synthesised, with their FRAC."""
    energy = np.sum(np.abs(result.measured) ** 2, axis=0)
    order = np.argsort(energy, axis=None)[::-1][:MOST_PANELS]
    pairs = [tuple(int(n) for n in np.unravel_index(k, energy.shape)) for k in order]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4 * columns, 3.4 * rows), layout="constrained")
    figure.suptitle(f"{result.name}: measured and synthesised accelerance")
    axes = figure.subplots(2 * rows, columns, sharex=True, squeeze=False, height_ratios=[2, 1] * rows)
    for n, (r, e) in enumerate(pairs):
        size, phase = axes[2 * (n // columns)][n % columns], axes[2 * (n // columns) + 1][n % columns]
        for frf, style in (
            (result.measured, {"color": "0.3", "lw": 1.2}),
            (result.synthesised, {"color": "tab:red", "lw": 0.8}),
        ):
            size.semilogy(result.frequency, np.abs(frf[:, r, e]), **style)
            phase.plot(result.frequency, np.degrees(np.angle(frf[:, r, e])), **style)
        size.set_title(f"{_pair(result, r, e)}, FRAC {result.frac[r, e]:.3f}", fontsize=9)
        phase.set(ylim=(-190, 190), yticks=(-180, 0, 180))
        if n % columns == 0:
            size.set_ylabel("(m/s²)/N")
            phase.set_ylabel("phase [°]")
        if n >= len(pairs) - columns:
            phase.set_xlabel("frequency [Hz]")
    for n in range(len(pairs), rows * columns):
        axes[2 * (n // columns)][n % columns].set_axis_off()
        axes[2 * (n // columns) + 1][n % columns].set_axis_off()
    figure.legend(axes[0][0].lines[:2], ["measured", "synthesised"], loc="outside lower center", ncols=2, frameon=False)
    return figure


def _pair(result: ModalResult, r: int, e: int) -> str:
    if result.response_label and result.excitation_label:
        return f"{result.response_label[r]}/{result.excitation_label[e]}"
    return f"{r}/{e}"


def mac_figure(
    shapes: ComplexArray,
    names: list[str],
    other: ComplexArray | None = None,
    other_names: list[str] | None = None,
    title: str = "",
) -> Figure:
    """MAC matrix between two sets of shapes in rows, or the auto-MAC of one."""
    values = mac(shapes, other)
    across = names if other_names is None else other_names
    figure = Figure(figsize=(2.2 + 0.55 * len(across), 1.8 + 0.5 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(values, vmin=0, vmax=1, cmap="Blues")
    axes.set_xticks(range(len(across)), across, rotation=60)
    axes.set_yticks(range(len(names)), names)
    for (row, column), value in np.ndenumerate(values):
        axes.text(
            column, row, f"{value:.2f}", ha="center", va="center", fontsize=7, color="white" if value > 0.6 else "black"
        )
    axes.set_title(title, fontsize=10)
    figure.colorbar(image, shrink=0.8)
    return figure


def draw(found: "ModalAnalysis") -> dict[str, Figure]:
    """File name → figure."""
    shapes = {f"{name}_shapes.png": mode_shapes(*shown) for name, shown in found.on_robot.items()}
    return shapes | drawn(found.results)


def drawn(results: Mapping[str, ModalResult]) -> dict[str, Figure]:
    """File name → figure of every posture, and the MAC between the first posture and the others."""
    figures = {}
    for name, result in results.items():
        figures[f"{name}_stabilisation.png"] = stabilisation_figure(result)
        figures[f"{name}_frf.png"] = overlay_figure(result)
        if result.modes:
            figures[f"{name}_automac.png"] = mac_figure(result.shapes, _names(result), title=f"{name}: auto-MAC")
    first, *others = results.values()
    for result in others:
        if result.modes and first.modes and result.shapes.shape[1] == first.shapes.shape[1]:
            title = f"MAC: {first.name} (down) and {result.name} (across)"
            figure = mac_figure(first.shapes, _names(first), result.shapes, _names(result), title)
            figures[f"{first.name}_{result.name}_mac.png"] = figure
    return figures


def _names(result: ModalResult) -> list[str]:
    return [f"{mode.frequency_hz:.1f} Hz" for mode in result.modes]
