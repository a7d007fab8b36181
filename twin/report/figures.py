"""Figures for people: FRF matrices, drawn mode shapes, torques of a replay, trajectories. Built without pyplot."""

import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from twin.model.frf import Quantity
from twin.model.modes import Modes
from twin.report import scene
from twin.robot.mechanism import Mechanism

UNITS = {"receptance": "m/N", "mobility": "m/(s·N)", "accelerance": "m/(s²·N)"}
PALETTE = ("#1f4e9c", "#e8590c", "#1098ad", "#7048a8", "#f0a202", "#846358", "#343a40", "#c77dbb")
"""Curves of one kind, told apart without red against green."""
WHITE_ON = 0.7  # of a scale of blues: below, black letters are told better

_CURVES: tuple[dict[str, Any], ...] = (
    {"color": "#1f4e9c", "linewidth": 2.0},
    {"color": "#e8590c", "linewidth": 1.0},
    {"color": "#111111", "linewidth": 0.8, "linestyle": "--"},
    {"color": "#7048a8", "linewidth": 1.0, "linestyle": "-."},
)
_TORQUES: dict[str, dict[str, Any]] = {
    "measured": {"color": "#111111", "linewidth": 1.8},
    "simulated": {"color": "#e8590c", "linewidth": 1.0},
    "inverse dynamics": {"color": "#1f4e9c", "linewidth": 1.0, "linestyle": "--"},
}
_PHASE_FROM = {"receptance": -270, "mobility": -180, "accelerance": -90}
"""Where phases are wrapped, degrees: as far as can be from those between resonances."""
_GREY = "#8a8f98"
_DPI = 150


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG; the file is replaced only when all is written."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, aside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        os.fchmod(handle, 0o644)
        with os.fdopen(handle, "wb") as stream:
            figure.dpi = _DPI
            # draws once, savefig twice; a tenth larger than need be, in two thirds of the time
            FigureCanvasAgg(figure).print_png(stream, pil_kwargs={"compress_level": 3})
        os.replace(aside, path)
    except BaseException:
        os.unlink(aside)
        raise


def frf_matrix(
    frequency_hz: np.ndarray,
    frfs: Mapping[str, np.ndarray],
    response_labels: Sequence[str],
    excitation_labels: Sequence[str],
    quantity: Quantity = "accelerance",
    modes_hz: Sequence[float] | np.ndarray | None = None,
    coherence: np.ndarray | None = None,
    phase: bool = False,
) -> Figure:
    """Grid of FRF amplitudes, one panel per response and excitation (paper, Figs. 10 and 12), on common axes.

    Args:
        frequency_hz: (nf,) Hz.
        frfs: legend → (nf, nr, ne) complex, SI; drawn in this order.
        response_labels: (nr,).
        excitation_labels: (ne,).
        quantity: which names the unit.
        modes_hz: natural frequencies to mark.
        coherence: (nf, nr, ne), drawn in a strip of its own.
        phase: with a strip of phases.
    """
    nr, ne = len(response_labels), len(excitation_labels)
    strips = ["amplitude", *(["phase"] if phase else []), *(["coherence"] if coherence is not None else [])]
    ratios = [{"amplitude": 4.0, "phase": 1.6, "coherence": 1.0}[strip] for strip in strips]
    figure = Figure(figsize=(max(6.5, 1.2 + 3.4 * ne), 1.5 + nr * 0.62 * sum(ratios)), layout="constrained")
    axes = figure.subplots(
        nr * len(strips), ne, sharex=True, sharey=False, squeeze=False, gridspec_kw={"height_ratios": ratios * nr}
    )
    positive = np.asarray(frequency_hz) > 0
    frequency = np.asarray(frequency_hz)[positive]
    largest = max((float(np.abs(H[positive]).max()) for H in frfs.values()), default=1.0)
    smallest = min((float(np.abs(H[positive]).min()) for H in frfs.values()), default=1e-3)
    limits = (max(smallest, 1e-6 * largest) / 2, largest * 2)
    for i, response in enumerate(response_labels):
        for j, excitation in enumerate(excitation_labels):
            for k, strip in enumerate(strips):
                ax: Axes = axes[i * len(strips) + k, j]
                ax.set_xscale("log")
                ax.set_xlim(frequency[0], frequency[-1])
                ax.grid(True, which="major", color="#d5d8dd", linewidth=0.5)
                ax.tick_params(which="both", direction="in", labelsize=8, labelleft=j == 0)
                for f in () if modes_hz is None else modes_hz:
                    ax.axvline(f, color=_GREY, linewidth=0.7, linestyle=":", zorder=1)
                if strip == "coherence" and coherence is not None:
                    ax.plot(frequency, coherence[positive, i, j], color="#444444", linewidth=0.7)
                    ax.set_ylim(0, 1.05)
                    ax.set_yticks([0, 1])
                    continue
                for style, H in zip(cycle(_CURVES), frfs.values(), strict=False):
                    value = H[positive, i, j]
                    drawn = _phase(value, quantity) if strip == "phase" else np.abs(value)
                    ax.plot(frequency, drawn, **style)
                if strip == "phase":
                    ax.set_ylim(_PHASE_FROM[quantity] - 10, _PHASE_FROM[quantity] + 370)
                    ax.set_yticks(_PHASE_FROM[quantity] + np.array([90, 270]))
                    continue
                ax.set_yscale("log")
                ax.set_ylim(*limits)
                ax.text(
                    0.98, 0.05, f"{response}/{excitation}", transform=ax.transAxes, ha="right", fontsize=9,
                    weight="bold", bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.5},
                )  # fmt: skip
                if i == 0 and modes_hz is not None:
                    _mark_modes(ax, np.asarray(modes_hz, float), frequency)
    for ax in axes[-1]:
        ax.xaxis.set_major_locator(_frequency_ticks(frequency))
        ax.xaxis.set_major_formatter(ScalarFormatter())
        ax.xaxis.set_minor_formatter(NullFormatter())
    for row, ax in enumerate(axes[:, 0]):
        strip = strips[row % len(strips)]
        label = {"amplitude": UNITS[quantity], "phase": "phase, °", "coherence": "γ²"}[strip]
        ax.set_ylabel(label, fontsize=8)
    figure.supxlabel("frequency, Hz", fontsize=10)
    figure.supylabel(f"{quantity} amplitude, response/excitation", fontsize=10)
    handles = [Line2D([], [], **style, label=name) for style, name in zip(cycle(_CURVES), frfs, strict=False)]
    if modes_hz is not None:
        handles.append(Line2D([], [], color=_GREY, linewidth=0.9, linestyle=":", label="natural frequencies"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, fontsize=9)
    return figure


def standing(mechanism: Mechanism) -> Figure:
    """The robot at rest in its posture."""
    stage = scene.stage(mechanism)
    width = 4.4  # inches: whole on a telephone
    figure = Figure(figsize=(width, width), layout="constrained")
    ax = figure.subplots()
    ax.set_axis_off()
    at = scene.poses(stage, stage.rest[None])
    _draw(ax, stage, at, _camera(scene.sight(stage)), dict.fromkeys(stage.bodies, "#b8bcc4"), 1.0)
    _same_limits([ax])
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    figure.set_figheight(
        float(np.clip(width * (high - low) / (right - left), 0.4 * width, width))
    )  # no wider frame than it needs
    return figure


def mode_shapes(mechanism: Mechanism, modes: Modes, count: int = 4, phase: float | None = None) -> Figure:
    """The lowest modes drawn at their largest motion: undeformed grey, deformed in the colour of the energy share.

    Robots without meshes are drawn by the lines through their joints. Arrows: motion of the test points.

    Args:
        mechanism: the robot in the posture the modes belong to.
        modes: its modes.
        count: how many, the lowest first.
        phase: of the motion, rad from where it is largest; drawn there by default.
    """
    stage = scene.stage(mechanism)
    number = min(count, len(modes))
    columns = min(2, max(1, number))
    rows = -(-max(1, number) // columns)
    figure = Figure(figsize=(3.4 * columns + 0.8, 2.8 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    camera = _camera(scene.sight(stage))
    rest = scene.poses(stage, stage.rest[None])
    if not number:
        _draw(axes[0], stage, rest, camera, dict.fromkeys(stage.bodies, "#b8bcc4"), 1.0)
        _same_limits(axes)
        axes[0].set_title("no elastic joint, no mode", fontsize=9)
        return figure
    for k, ax in zip(range(number), axes, strict=False):
        size = scene.drawn(stage, modes, k)
        motion = scene.modal_motion(stage, modes, k)
        largest = -0.5 * np.angle(np.sum(motion**2))  # of a complex shape
        at_phase = np.array([largest + (phase or 0.0)])
        deformed = scene.poses(stage, scene.modal_coordinates(stage, modes, k, size.amplitude, at_phase))
        share = scene.energy_share(stage, modes, k)
        colours = {name: _hex(scene.share_colour(share.get(name))) for name in stage.bodies}
        _draw(ax, stage, rest, camera, dict.fromkeys(stage.bodies, "#c3c7cf"), 0.75)
        _draw(ax, stage, deformed, camera, colours, 1.0)
        points = [(point.body, point.position) for point in mechanism.points]
        if points and phase is None:
            tail, head = (scene.locate(stage, at, points)[0] @ camera[:, :2] for at in (rest, deformed))
            ax.quiver(
                *tail.T, *(head - tail).T, angles="xy", scale_units="xy", scale=1, width=0.004,
                color="#1f4e9c", edgecolor="white", linewidth=0.4, zorder=5,
            )  # fmt: skip
        dominant = ", ".join(f"{name} {100 * value:.0f} %" for name, value in modes.dominant(k))
        ax.set_title(f"{scene.mode_title(modes, k)}; drawn ± {1e3 * size.motion:.0f} mm\n{dominant}", fontsize=8)
    _same_limits(axes[:number], wide=1.35)  # as wide as the titles
    shown = list(axes[:number])
    map_ = LinearSegmentedColormap.from_list("share", [np.array(colour) / 255 for colour in scene.SHARE_COLOURS])
    bar = figure.colorbar(
        ScalarMappable(Normalize(0, 100), map_), ax=shown, shrink=0.6, aspect=30, location="right"
    )  # fmt: skip
    bar.set_label("share of strain energy, %", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    figure.supxlabel(
        f"{mechanism.robot.name}; grey: at rest; colour: strain energy in the springs that carry the link"
        + ("; arrows: motion of the test points" if phase is None else ""),
        fontsize=8,
    )
    return figure


def replay(
    time: np.ndarray,
    measured: np.ndarray | None,
    simulated: np.ndarray,
    inverse_dynamics: np.ndarray,
    axis_names: Sequence[str],
    units: Sequence[str] | None = None,
) -> Figure:
    """Torques per axis, and below each what remains.

    Residuals are against the measurement where there is one, otherwise of the simulation against inverse dynamics.

    Args:
        time: (nt,) s.
        measured: (nt, n) at the gears' outputs, or ``None``.
        simulated: (nt, n), of the robot driven by its servos.
        inverse_dynamics: (nt, n), of the rigid robot.
        axis_names: (n,).
        units: (n,) of each axis; N·m by default.
    """
    n = len(axis_names)
    curves = zip(_TORQUES, (measured, simulated, inverse_dynamics), strict=True)
    given = {name: np.asarray(value) for name, value in curves if value is not None}
    reference, *others = given
    if measured is None:
        reference, others = "inverse dynamics", ["simulated"]
    figure = Figure(figsize=(9, 0.9 + 2.7 * n), layout="constrained")
    axes = figure.subplots(2 * n, 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [3, 1] * n})[:, 0]
    for i, name in enumerate(axis_names):
        torque, residual = axes[2 * i], axes[2 * i + 1]
        unit = units[i] if units is not None else "N·m"
        for curve, value in given.items():
            torque.plot(time, value[:, i], **_TORQUES[curve])
        scale = float(np.sqrt(np.mean(given[reference][:, i] ** 2)))
        texts = []
        for curve in others:
            difference = given[curve][:, i] - given[reference][:, i]
            residual.plot(time, difference, **_TORQUES[curve])
            rms = float(np.sqrt(np.mean(difference**2)))
            texts.append(f"{curve}: {rms:.3g} {unit} rms" + (f", {100 * rms / scale:.1f} %" if scale else ""))
        torque.set_ylabel(f"{name}, {unit}", fontsize=9)
        residual.set_ylabel(f"residual, {unit}", fontsize=9)
        residual.set_title("   ".join(texts), loc="right", fontsize=8, pad=2)
        for ax in (torque, residual):
            _tidy(ax)
    axes[-1].set_xlabel("time, s", fontsize=9)
    axes[-1].set_xlim(float(time[0]), float(time[-1]))
    handles = [Line2D([], [], **_TORQUES[name], label=name) for name in given]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), frameon=False, fontsize=9,
        title=f"residuals: curve − {reference}", title_fontsize=8,
    )  # fmt: skip
    return figure


def trajectory(
    time: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    axis_names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
) -> Figure:
    """Position and velocity of every axis over time.

    Args:
        time: (nt,) s.
        position: (nt, n) rad (m).
        velocity: (nt, n) rad/s (m/s).
        axis_names: (n,); joint1 … by default.
        units: (n,) ``rad`` or ``m``; rad by default.
    """
    n = position.shape[1]
    figure = Figure(figsize=(10, 0.7 + 1.7 * n), layout="constrained")
    axes = figure.subplots(n, 2, sharex=True, squeeze=False)
    for i in range(n):
        unit = units[i] if units is not None else "rad"
        name = axis_names[i] if axis_names is not None else f"joint{i + 1}"
        for ax, values, of in zip(axes[i], (position, velocity), (unit, f"{unit}/s"), strict=True):
            ax.plot(time, values[:, i], color="#1f4e9c", linewidth=1.2)
            ax.set_ylabel(f"{name}, {of}", fontsize=9)
            _tidy(ax)
    for ax, title in zip(axes[0], ("position", "velocity"), strict=True):
        ax.set_title(title, fontsize=10)
    for ax in axes[-1]:
        ax.set_xlabel("time, s", fontsize=9)
        ax.set_xlim(float(time[0]), float(time[-1]))
    figure.align_ylabels()
    return figure


def _tidy(ax: Axes) -> None:
    ax.grid(True, color="#d5d8dd", linewidth=0.5)
    ax.tick_params(direction="in", labelsize=8)


def _frequency_ticks(frequency: np.ndarray) -> FixedLocator:
    nice = np.array([a * 10.0**b for b in range(-2, 5) for a in (1, 2, 5)])
    return FixedLocator(nice[(nice >= frequency[0]) & (nice <= frequency[-1])])


def _phase(value: np.ndarray, quantity: Quantity) -> np.ndarray:
    return phase_deg(value, _PHASE_FROM[quantity])


def phase_deg(value: np.ndarray, start: float = -180.0) -> np.ndarray:
    """Phase in degrees from ``start`` on, with gaps where it wraps."""
    phase = np.mod(np.rad2deg(np.angle(value)) - start, 360) + start
    phase[1:][np.abs(np.diff(phase)) > 180] = np.nan
    return phase


def _same_limits(axes: Iterable[Axes], wide: float = 0.0) -> None:
    """Show the same part of the plane, in the same scale, in every panel; at least so ``wide`` for its height."""
    axes = list(axes)
    for ax in axes:
        ax.autoscale_view()
    limits = np.array([[*ax.get_xlim(), *ax.get_ylim()] for ax in axes])
    left, right, low, high = limits[:, 0].min(), limits[:, 1].max(), limits[:, 2].min(), limits[:, 3].max()
    more = max(0.0, wide * (high - low) - (right - left)) / 2
    for ax in axes:
        ax.set_xlim(left - more, right + more)
        ax.set_ylim(low, high)
        ax.set_aspect("equal")


def _mark_modes(ax: Axes, modes_hz: np.ndarray, frequency: np.ndarray) -> None:
    """Frequencies above the panel, pushed apart where they would overlap, each led to from its line."""
    shown = modes_hz[(modes_hz >= frequency[0]) & (modes_hz <= frequency[-1])]
    span = np.log(frequency[-1] / frequency[0])
    place = np.log(shown / frequency[0]) / span
    lines = place.copy()
    for k in range(1, len(place)):
        place[k] = max(place[k], place[k - 1] + 0.045)
    for line, x, f in zip(lines, place, shown, strict=True):
        ax.plot([line, x], [1.0, 1.04], transform=ax.transAxes, color=_GREY, linewidth=0.7, clip_on=False)
        ax.text(
            x,
            1.05,
            f"{f:.1f}",
            transform=ax.transAxes,
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=7,
            color="#555b66",
        )


def _camera(sight: np.ndarray) -> np.ndarray:
    """Columns right, up and towards the eye (3, 3) of an orthographic view along −sight."""
    right = np.cross([0.0, 0.0, 1.0], sight)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(sight, right), sight])


def _hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _draw(
    ax: Axes, stage: scene.Scene, at: scene.Poses, camera: np.ndarray, colours: Mapping[str, str], alpha: float
) -> None:
    """Draw the robot in one pose: shaded triangles that face the eye, back to front; lines where it has no surface."""
    corners, shades = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    light = camera @ np.array([-0.4, 0.5, 0.77])
    for k, name in enumerate(stage.bodies):
        R, x = at.rotation[0, k], at.position[0, k]
        colour = np.array([int(colours[name][i : i + 2], 16) / 255 for i in (1, 3, 5)])
        if (skin := stage.skins.get(name)) is not None:
            vertices, normals = skin.vertices @ R.T + x, skin.normals @ R.T
            triangles = (vertices @ camera)[skin.triangles]
            edge1, edge2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
            front = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0] > 0
            brightness = 0.55 + 0.45 * np.clip(normals[skin.triangles].mean(axis=1) @ light, 0, 1)
            corners.append(triangles[front])
            shades.append(brightness[front, None] * colour)
        elif len(bones := stage.bones.get(name, np.zeros((0, 2, 3)))):
            lines = (bones @ R.T + x) @ camera[:, :2]
            ax.add_collection(
                LineCollection(list(lines), colors=[colour], linewidths=5, capstyle="round", alpha=alpha, zorder=2)
            )
        elif stage.mechanism.bodies[name].kind == "part":
            ax.plot(*(x @ camera[:, :2]), "o", color=colour, markersize=10, alpha=alpha, zorder=4)
    triangles, shade = np.concatenate(corners), np.concatenate(shades)
    order = np.argsort(triangles[:, :, 2].mean(axis=1))
    faces = PolyCollection(list(triangles[order][:, :, :2]), facecolors=shade[order], linewidths=0.2, zorder=3)
    faces.set_edgecolor("face")  # closes the hairlines between triangles
    if len(order):
        ax.add_collection(faces)
    joints = scene.locate(stage, at, stage.chain)[0] @ camera[:, :2]
    if any(name not in stage.skins for name in stage.bones):
        ax.plot(*joints.T, "o-", color="#333333", linewidth=0.8, markersize=3.5, alpha=alpha, zorder=4)
    ax.update_datalim(joints)
