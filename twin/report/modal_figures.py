"""The report of a modal test: stabilisation chart, indicators, measured against synthesised FRFs, MAC, wire frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from twin.measure.campaign import ComplexArray, FloatArray
from twin.measure.modal import ModalResult
from twin.measure.shapes import cmif, mac, mode_indicator, summation
from twin.measure.wireframe import Wireframe
from twin.report.figures import PALETTE, WHITE_ON, mode_shapes, phase_deg
from twin.report.html import Section, pick
from twin.report.plots import frf_panels, frf_plot

if TYPE_CHECKING:
    from twin.commands.modal import ModalAnalysis

SYMBOLS = {"o": "new pole", "f": "frequency", "d": "frequency, damping", "v": "frequency, vector", "s": "stable"}
COLOURS = {"o": "0.75", "f": "0.35", "d": "tab:blue", "v": "tab:cyan", "s": "#e8590c"}
MARKERS = {"o": "o", "f": "^", "d": "d", "v": "v", "s": "s"}
MOST_PANELS = 6
MOST_SHAPES = 12
MOST_WRITTEN = 16  # modes whose MAC is written into its square


def stabilisation_figure(result: ModalResult) -> Figure:
    """Poles of every order by their symbol over the sum of all FRFs; lines mark the identified modes."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    below = figure.add_subplot()
    below.semilogy(result.frequency, summation(result.measured), color="0.3", lw=1)
    below.set(xlabel="frequency, Hz", ylabel=f"sum of |{result.quantity[0]}|, {result.quantity[1]}")
    below.set_xlim(result.frequency[0], result.frequency[-1])
    above = below.twinx()
    above.set_ylabel("model order")
    pole = np.concatenate([found.frequency for chart in result.charts for found in chart.poles])
    order = np.concatenate([np.full(f.poles.size, f.order) for chart in result.charts for f in chart.poles])
    marks = np.array([mark for chart in result.charts for marks in chart.symbols for mark in marks])
    inside = (pole >= result.frequency[0]) & (pole <= result.frequency[-1])
    for symbol, meaning in SYMBOLS.items():
        chosen = inside & (marks == symbol)
        (drawn,) = above.plot(pole[chosen], order[chosen], ls="", label=meaning, c=COLOURS[symbol])
        drawn.set(marker=MARKERS[symbol], markersize=3, markeredgewidth=0.5)
    for mode in result.modes:
        style = "--" if mode.orders > 0 else ":"
        below.axvline(mode.frequency_hz, lw=0.9, zorder=0, color="tab:purple", ls=style)
    handles = [*above.lines]
    handles.append(below.plot([], [], color="tab:purple", lw=0.9, ls="--", label="mode")[0])
    if any(mode.orders == 0 for mode in result.modes):
        handles.append(below.plot([], [], color="tab:purple", lw=0.9, ls=":", label="mode without a column")[0])
    figure.legend(handles=handles, loc="outside upper center", ncols=7, fontsize=8, title=result.name, frameon=False)
    return figure


def indicator_figure(result: ModalResult) -> Figure:
    """Complex mode indicator functions; of FRFs also the normal mode indicator and, where recorded, the coherence."""
    curves = [] if result.operational else [("mode indicator", mode_indicator(result.measured), "0.3", 1.0)]
    curves += [] if result.coherence is None else [("median coherence", result.coherence, "tab:blue", 1.02)]
    rows = 1 + len(curves)
    figure = Figure(figsize=(10, 1.7 * max(rows, 2) + 0.8), layout="constrained")
    figure.suptitle(f"{result.name}: where the recording shows modes")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=[2, 1, 1][:rows])[:, 0]
    values = cmif(result.measured)
    for k in range(min(4, values.shape[1])):
        axes[0].semilogy(result.frequency, values[:, k], color=PALETTE[k], lw=0.9, label=f"singular value {k + 1}")
    axes[0].set_ylabel(f"CMIF, {result.quantity[1]}")
    axes[0].legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    for below, (name, values, colour, top) in zip(axes[1:], curves, strict=True):
        below.plot(result.frequency, values, color=colour, lw=0.9)
        below.set(ylabel=name, ylim=(0, top))
    for ax in axes:
        for mode in result.modes:
            ax.axvline(mode.frequency_hz, color="tab:purple", lw=0.7, ls="--", zorder=0)
    axes[-1].set(xlabel="frequency, Hz", xlim=(result.frequency[0], result.frequency[-1]))
    return figure


def wireframe_figure(frame: Wireframe, titles: Sequence[str]) -> Figure:
    """Up to ``MOST_SHAPES`` modes of a structure at their largest motion, blue to red by it; at rest in grey."""
    number = min(len(titles), MOST_SHAPES)
    columns = min(3, number)
    rows = -(-number // columns)
    right, up = _view(frame.position)
    wide, high = (float(np.ptp(frame.position @ axis)) for axis in (right, up))
    figure = Figure(figsize=(4 * columns, rows * (0.5 + 3.4 * float(np.clip(high / max(wide, 1e-9), 0.3, 1)))))
    figure.set_layout_engine("constrained")
    for k in range(rows * columns):
        axes = figure.add_subplot(rows, columns, k + 1)
        axes.set_axis_off()
        if k >= number:
            continue
        phase = -0.5 * float(np.angle(np.sum(frame.motion[k] ** 2)))
        rest, moved = (at @ np.column_stack([right, up]) for at in (frame.position, frame.displaced(k, phase)))
        size = np.linalg.norm((frame.motion[k] * np.exp(1j * phase)).real, axis=1)
        axes.add_collection(LineCollection(list(rest[frame.lines]), colors="0.6", linewidths=0.9))
        coloured = LineCollection(list(moved[frame.lines]), cmap="coolwarm", linewidths=1.6)
        coloured.set_array(size[frame.lines].mean(axis=1))
        coloured.set_clim(0, 1)
        axes.add_collection(coloured)
        axes.scatter(moved[:, 0], moved[:, 1], c=size, cmap="coolwarm", vmin=0, vmax=1, s=9, zorder=3)
        axes.set_title(titles[k], fontsize=9)
        axes.set_aspect("equal")
        axes.autoscale_view()
    return figure


def _view(position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right and up (3,) of a picture that sees the structure from 30° above and 35° beside its broad side."""
    _, _, axes = np.linalg.svd(position - position.mean(axis=0), full_matrices=False)
    normal = axes[2] if np.linalg.matrix_rank(position - position.mean(axis=0), tol=1e-9) > 1 else axes[1]
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.7 else np.array([0.0, 1.0, 0.0])
    across = np.cross(up, normal)
    across /= np.linalg.norm(across)
    lifted = np.cross(normal, across)
    eye = normal + 0.55 * across + 0.7 * lifted
    eye /= np.linalg.norm(eye)
    right = np.cross(lifted, eye)
    right /= np.linalg.norm(right)
    return right, np.cross(eye, right)


def overlay_figure(result: ModalResult) -> Figure:
    """Amplitude and phase of the strongest FRFs, measured and synthesised, with their FRAC."""
    energy = np.sum(np.abs(result.measured) ** 2, axis=0)
    order = np.argsort(energy, axis=None)[::-1][:MOST_PANELS]
    pairs = [tuple(int(n) for n in np.unravel_index(k, energy.shape)) for k in order]
    columns = min(3, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4 * columns, 2.6 * rows + 0.6), layout="constrained")
    figure.suptitle(f"{result.name}: measured and synthesised {result.quantity[0]}")
    axes = figure.subplots(2 * rows, columns, sharex=True, squeeze=False, height_ratios=[2, 1] * rows)
    for n, (r, e) in enumerate(pairs):
        size, phase = axes[2 * (n // columns)][n % columns], axes[2 * (n // columns) + 1][n % columns]
        for frf, style in (
            (result.measured, {"color": "0.3", "lw": 1.2}),
            (result.synthesised, {"color": "#e8590c", "lw": 0.8}),
        ):
            size.semilogy(result.frequency, np.abs(frf[:, r, e]), **style)
            phase.plot(result.frequency, phase_deg(frf[:, r, e]), **style)
        size.set_title(f"{_pair(result, r, e)}, FRAC {result.frac[r, e]:.3f}", fontsize=9)
        phase.set(ylim=(-190, 190), yticks=(-180, 0, 180))
        if n % columns == 0:
            size.set_ylabel(result.quantity[1])
            phase.set_ylabel("phase, °")
        if n >= len(pairs) - columns:
            phase.set_xlabel("frequency, Hz")
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
    size = 0.5 if max(values.shape) <= MOST_WRITTEN else 0.25
    figure = Figure(figsize=(2.2 + 1.1 * size * len(across), 1.8 + size * len(names)), layout="constrained")
    axes = figure.add_subplot()
    image = axes.imshow(values, vmin=0, vmax=1, cmap="Blues")
    axes.set_xticks(range(len(across)), across, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for (row, column), value in np.ndenumerate(values if max(values.shape) <= MOST_WRITTEN else np.zeros((0, 0))):
        axes.text(
            column,
            row,
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=7,
            color="white" if value > WHITE_ON else "black",
        )
    axes.set_title(title, fontsize=10)
    figure.colorbar(image, shrink=0.8).set_label("MAC", fontsize=9)
    return figure


CAPTIONS = {
    "shapes": "Mode shapes, enlarged.",
    "frf": "Strongest FRFs, measured and synthesised from the modes, with their likeness (FRAC).",
    "stabilisation": "Stabilisation chart: stable poles stand in columns.",
    "indicators": "Mode indicator functions: modes stand at peaks and dips.",
    "automac": "How alike each two shapes are (MAC): off the diagonal it should be low.",
}
FRAME = {"shapes": "Mode shapes, enlarged: red moves most, blue least; grey is at rest."}
RUNNING = {
    "frf": "Strongest spectra, measured and synthesised from the modes, with their likeness (FRAC). "
    "Steps are where one octave ends and the next begins.",
}


def draw(found: "ModalAnalysis") -> dict[str, Figure]:
    """File name → figure."""
    shapes = {f"{name}_shapes.png": mode_shapes(*shown) for name, shown in found.on_robot.items()}
    shapes |= {
        f"{name}_shapes.png": wireframe_figure(at, found.results[name].titles) for name, at in found.frames.items()
    }
    return shapes | drawn(found.results)


def drawn(results: Mapping[str, ModalResult]) -> dict[str, Figure]:
    """File name → figure of every posture, and the MAC between the first posture and the others."""
    figures = {}
    for name, result in results.items():
        figures[f"{name}_stabilisation.png"] = stabilisation_figure(result)
        figures[f"{name}_indicators.png"] = indicator_figure(result)
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


def title(found: "ModalAnalysis") -> str:
    """Of the page."""
    return f"Modes: {', '.join(found.results)}"


def lead(found: "ModalAnalysis") -> str:
    """How many, where."""
    return "; ".join(f"{name}: {len(result.modes)} modes" for name, result in found.results.items())


def sections(found: "ModalAnalysis", drawn: Mapping[str, Path]) -> list[Section]:
    """The parts of the page; ``drawn``: file name → PNG."""
    parts = [Section("Modes", warnings=found.notes, tables=found.tables())]
    for name, result in found.results.items():
        checks = [str(check) for check in found.checks.get(name, []) if not check.passed]
        checks += [result.complaint] if result.complaint else []
        captions = CAPTIONS | (RUNNING if result.operational else {}) | (FRAME if name in found.frames else {})
        figures = [
            (caption, drawn[f"{name}_{kind}.png"])
            for kind, caption in captions.items()
            if f"{name}_{kind}.png" in drawn
        ]
        curves = {"measured": result.measured, "synthesised": result.synthesised}
        labels = result.response_label or [str(r) for r in range(result.measured.shape[1])]
        blows = result.excitation_label or [str(e) for e in range(result.measured.shape[2])]
        plots = [frf_plot(frf_panels(name, result.frequency, curves, labels, blows), *result.quantity)]
        parts.append(Section(f"Posture '{name}'", warnings=checks, figures=figures, plots=plots))
    across = pick(drawn, "_mac.png", "How alike the shapes of two postures are (MAC).")
    return [*parts, Section("Between postures", figures=across)]
