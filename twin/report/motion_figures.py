"""Figures of trajectories and torque logs: the paper's Figures 2 to 5, and residuals against what may explain them."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twin.identify.excitation import Excitation
from twin.measure.motion_log import MotionRun
from twin.measure.signals import lowpass
from twin.model.regressor import flange_path
from twin.model.torque_rows import Bands, Rows, motion_of_run
from twin.report.figures import PALETTE
from twin.robot.description import Robot

_PREDICTED = (PALETTE[1], PALETTE[0])
_POINTS = 4000  # drawn at most per curve
_SIGNALS_S = 12.0  # of a run, in the figure of signals


def axis_units(robot: Robot) -> tuple[list[str], list[str]]:
    """Units of position and of torque per axis."""
    turning = [axis.type == "revolute" for axis in robot.axes]
    return ["rad" if t else "m" for t in turning], ["N·m" if t else "N" for t in turning]


def excitation(robot: Robot, found: Excitation, title: str) -> Figure:
    """A trajectory: the flange's path in the workspace, and joint positions, velocities, accelerations (Fig. 2)."""
    time = np.linspace(0, found.fourier.period_s, 1000)
    motion = found.fourier.motion(time)
    path = flange_path(robot, motion.position)
    units, _ = axis_units(robot)
    figure = Figure(figsize=(11, 6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[1.1, 1], wspace=0.12)
    space = figure.add_subplot(grid[:, 0], projection="3d")
    space.plot(*path.T, color=PALETTE[0], linewidth=1.4)
    if robot.workspace:
        box = np.array([robot.workspace.x, robot.workspace.y, robot.workspace.z])
        for k in range(3):
            for a in range(2):
                for b in range(2):
                    edge = np.empty((3, 2))
                    edge[k], edge[(k + 1) % 3], edge[(k + 2) % 3] = box[k], box[(k + 1) % 3, a], box[(k + 2) % 3, b]
                    space.plot(*edge, color="#8a8f98", linewidth=0.8)
        space.set_box_aspect(np.diff(box, axis=1)[:, 0], zoom=0.85)
    space.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    space.tick_params(labelsize=7)
    space.zaxis.labelpad = 8
    series = (
        (motion.position, "position", ""),
        (motion.velocity, "velocity", "/s"),
        (motion.acceleration, "acceleration", "/s²"),
    )
    for k, (values, name, per) in enumerate(series):
        ax = figure.add_subplot(grid[k, 1])
        for i in range(robot.axis_count):
            ax.plot(time, values[:, i], color=PALETTE[i % len(PALETTE)], linewidth=1.1, label=f"joint{i + 1}")
        ax.set_ylabel(f"{name}, {'/'.join(sorted(set(units)))}{per}", fontsize=9)
        _tidy(ax)
        if k == 0:
            ax.legend(fontsize=8, ncols=robot.axis_count, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.set_xlabel("time, s", fontsize=9)
    figure.suptitle(title, fontsize=10)
    return figure


def signals(robot: Robot, run: MotionRun, bands: Bands) -> Figure:
    """Torque and position of a run, raw and low-passed, and the acceleration differentiated from it (Fig. 3).

    Args:
        robot: description.
        run: in joint coordinates.
        bands: low-passes.
    """
    n = robot.axis_count
    units, forces = axis_units(robot)
    motion = motion_of_run(run, bands)
    figure = Figure(figsize=(11, 0.8 + 1.9 * n), layout="constrained")
    axes = figure.subplots(n, 3, sharex=True, squeeze=False)
    thin = slice(None, None, max(1, len(run.time) // _POINTS))
    smooth = (
        None if run.torque is None else lowpass(run.torque, run.sample_rate_hz, *bands.within(run.sample_rate_hz).fit)
    )
    for i in range(n):
        torque, position, acceleration = axes[i]
        if run.torque is not None and smooth is not None:
            torque.plot(run.time[thin], run.torque[thin, i], color="#b8bcc4", linewidth=0.6, label="recorded")
            torque.plot(run.time[thin], smooth[thin, i], color=PALETTE[0], linewidth=1.0, label="low-passed")
        position.plot(run.time[thin], run.position[thin, i], color="#b8bcc4", linewidth=2.0)
        position.plot(run.time[thin], motion.position[thin, i], color=PALETTE[0], linewidth=0.9)
        acceleration.plot(run.time[thin], motion.acceleration[thin, i], color=PALETTE[0], linewidth=0.9)
        labels = (f"joint{i + 1}, {forces[i]}", units[i], f"{units[i]}/s²")
        for ax, label in zip(axes[i], labels, strict=True):
            ax.set_ylabel(label, fontsize=9)
            _tidy(ax)
    for ax, text in zip(axes[0], ("torque", "position", "acceleration"), strict=True):
        ax.set_title(text, fontsize=10, loc="left")
    for ax in axes[-1]:
        ax.set_xlabel("time, s", fontsize=9)
    if run.torque is not None:
        axes[0, 0].legend(fontsize=8, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    figure.align_ylabels()
    return figure


def prediction(robot: Robot, rows: Sequence[Rows], curves: Mapping[str, Sequence[np.ndarray]], title: str) -> Figure:
    """Recorded and predicted torque of some runs, one after the other, and their difference (Figs. 4 and 5).

    Args:
        robot: description.
        rows: runs; only rows that count are drawn.
        curves: name of a prediction → torque (m, n) per run.
        title: of the figure.
    """
    n = robot.axis_count
    _, units = axis_units(robot)
    figure = Figure(figsize=(11, 0.9 + 2.4 * n), layout="constrained")
    axes = figure.subplots(2 * n, 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [3, 1.2] * n})[:, 0]
    styles = {name: {"color": colour, "linewidth": 0.9} for name, colour in zip(curves, _PREDICTED, strict=False)}
    start = 0.0
    squares = {name: np.zeros((2, n)) for name in curves}
    for k, r in enumerate(rows):
        time = np.where(r.valid, r.time - r.time[0] + start, np.nan)
        measured = r.torque + r.known
        for i in range(n):
            axes[2 * i].plot(time, measured[:, i], color="#111111", linewidth=1.8, label="recorded")
        for name, predicted in curves.items():
            error = measured - predicted[k]
            squares[name] += [np.sum(error[r.valid] ** 2, axis=0), np.sum(measured[r.valid] ** 2, axis=0)]
            for i in range(n):
                axes[2 * i].plot(time, predicted[k][:, i], label=name, **styles[name])
                axes[2 * i + 1].plot(time, error[:, i], **styles[name])
        axes[0].annotate(
            r.name, (start, 1.0), xycoords=("data", "axes fraction"), fontsize=8, va="bottom", annotation_clip=False
        )
        start += r.time[-1] - r.time[0]
        if r is not rows[-1]:
            for ax in axes:
                ax.axvline(start, color="#8a8f98", linewidth=0.8, linestyle=":")
    count = sum(r.valid.sum() for r in rows)
    for i in range(n):
        texts = []
        for name, (residual, total) in squares.items():
            rms, ratio = np.sqrt(residual[i] / max(count, 1)), np.sqrt(residual[i] / total[i]) if total[i] else np.nan
            texts.append(f"{name}: {rms:.3g} {units[i]} rms, {100 * ratio:.2f} %")
        axes[2 * i].set_ylabel(f"joint{i + 1}, {units[i]}", fontsize=9)
        axes[2 * i + 1].set_ylabel(f"error, {units[i]}", fontsize=9)
        axes[2 * i + 1].set_title("    ".join(texts), loc="right", fontsize=8, pad=2)
        for ax in axes[2 * i : 2 * i + 2]:
            _tidy(ax)
    axes[-1].set_xlabel("time, s", fontsize=9)
    axes[-1].set_xlim(0, start)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(
        handles[: 1 + len(curves)], names[: 1 + len(curves)], loc="outside upper right", ncols=1 + len(curves),
        frameon=False, fontsize=9, title=title, title_fontsize=10,
    )  # fmt: skip
    figure.align_ylabels()
    return figure


def residuals(robot: Robot, rows: Sequence[Rows], parameters: np.ndarray) -> Figure:
    """Residual torque against time, position and velocity, with the mean over forty classes: a law left out shows."""
    n = robot.axis_count
    units, forces = axis_units(robot)
    residual = np.concatenate([(r.torque - r.matrix @ parameters)[r.valid] for r in rows])
    states = [np.concatenate([getattr(r, name)[r.valid] for r in rows]) for name in ("time", "position", "velocity")]
    figure = Figure(figsize=(11, 0.8 + 2.2 * n), layout="constrained")
    axes = figure.subplots(n, 3, sharey="row", squeeze=False)
    thin = slice(None, None, max(1, len(residual) // _POINTS))
    for i in range(n):
        labels = ("time, s", f"position, {units[i]}", f"velocity, {units[i]}/s")
        for ax, state, label in zip(axes[i], states, labels, strict=True):
            x = state if state.ndim == 1 else state[:, i]
            ax.plot(x[thin], residual[thin, i], ".", color="#b8bcc4", markersize=2)
            edges = np.unique(np.quantile(x, np.linspace(0, 1, 41)))
            if len(edges) < 2:  # an axis that does not move
                edges = np.array([edges[0] - 0.5, edges[0] + 0.5])
            of = np.clip(np.digitize(x, edges) - 1, 0, len(edges) - 2)
            count = np.maximum(np.bincount(of, minlength=len(edges) - 1), 1)
            mean = np.bincount(of, residual[:, i], len(edges) - 1) / count
            if state.ndim == 1:  # no line across the pause between two runs
                mean[np.diff(edges) > 2.5 * np.median(np.diff(edges))] = np.nan
            ax.plot(0.5 * (edges[:-1] + edges[1:]), mean, color=PALETTE[1], linewidth=1.3)
            ax.set_xlabel(label, fontsize=8)
            _tidy(ax)
        axes[i, 0].set_ylabel(f"joint{i + 1}, {forces[i]}", fontsize=9)
    figure.suptitle("residual torque of the fitted runs; orange: mean over classes", fontsize=10)
    return figure


def _tidy(ax: Axes) -> None:
    ax.grid(True, color="#d5d8dd", linewidth=0.5)
    ax.tick_params(direction="in", labelsize=8)
