"""What is wrong with a log itself, before physics: degrees, torques reversed or exchanged, a clock that runs apart.

Each test compares the recorded torque with that of the description. It asks for sign, order and time alone, so that a
description may be far off. A fault that is found is put right, with a note.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import linear_sum_assignment

from twin.diagnose.note import Note
from twin.errors import InputError
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun
from twin.model.regressor import Regressor
from twin.model.torque_rows import in_joints
from twin.model.torque_signal import Run, prepare
from twin.physics.motion import gradual_sign
from twin.robot.description import Robot

ALIKE = 0.9  # correlation of a recorded torque with a described one that is taken for the same
UNLIKE = 0.5  # less is not
EXCHANGED = (
    1.0  # fall of ln variance per channel from which channels are exchanged; of 107 logs none came to 0 by chance
)
BLOCKS = 8  # of a run, in which its lateness is measured
DRIFTING = 6.0  # deviations of a slope of lateness over time
REPEATED = 3  # measurements of lateness
DRIFTED = 0.5  # samples of the log over a run: less is a clock's ordinary jitter
CLOCKS = 0.01  # s/s: quartz is off by 1e-4, stamps of a busy computer by some 1e-3; what is off by more is no clock


def put_right(log: MotionLog, runs: Sequence[Run], described: Sequence[FloatArray]) -> tuple[MotionLog, list[Note]]:
    """A log with its torque channels in order and of the right sign, and a note on each fault.

    Args:
        log: in the coordinates of the motors.
        runs: of the log, as rows.
        described: (m, n) torque of the description, of each.
    """
    order, sign = _channels(runs, described)
    notes = [Note(note, kind, "fail") for kind, note in _told(order, sign)]
    if notes:
        torque = {name: sign * run.torque[:, order] for name, run in log.runs.items() if run.torque is not None}
        log = replace(log, runs={name: replace(run, torque=torque.get(name)) for name, run in log.runs.items()})
    return log, notes


def clock_rates(runs: Sequence[Run], torque: Sequence[FloatArray]) -> dict[str, float]:
    """By how much recorded torque falls behind a model's (m, n) per second, s/s, of the runs where it does."""
    rates = {run.name: _clock(run, model) for run, model in zip(runs, torque, strict=True)}
    return {name: rate for name, rate in rates.items() if rate}


def on_time(log: MotionLog, rates: Mapping[str, float]) -> MotionLog:
    """A log with its torque where it belongs."""
    return replace(log, runs={name: _on_time(run, rates.get(name, 0.0)) for name, run in log.runs.items()})


def clock_note(rates: Mapping[str, float]) -> Note:
    """That clocks run apart, s/s by run."""
    told = ", ".join(f"{1e6 * rate:+.0f} ppm in '{name}'" for name, rate in rates.items())
    text = (
        f"the clock of torque runs apart from that of positions: torque falls behind by {told}; it was put back "
        "before the diagnosis"
    )
    return Note(text, "clock", "fail", runs=tuple(rates))


def in_radians(log: MotionLog, robot: Robot) -> tuple[MotionLog, list[Note]]:
    """A log whose positions are in degrees in radians, and a note; any other as it is.

    Positions fit the axes' limits as degrees alone, and with them the description's torque goes as the recorded one.
    """
    try:
        in_joints(log, robot)
        return log, []
    except InputError:
        pass
    turned = replace(log, runs={name: _turned(run, robot) for name, run in log.runs.items()})
    try:
        in_joints(turned, robot)
        prepared = prepare(turned, robot, log.source)
    except InputError:  # the log as it is will be refused, with the cause
        return log, []
    runs = [*{r.name: r for r in (*prepared.kept, *prepared.used)}.values()]
    alike, _ = _likeness(runs, [described_torque(prepared.regressor, run) for run in runs])
    if np.abs(alike).max() < ALIKE:
        return log, []
    text = "positions are in degrees: as radians they leave the axes' limits; they were taken as degrees"
    return turned, [Note(text, "unit", "fail")]


def _turned(run: MotionRun, robot: Robot) -> MotionRun:
    """A run from degrees to radians; what slides stays."""
    unit = np.where([axis.type == "revolute" for axis in robot.axes], np.pi / 180, 1.0)
    names = ("position", "velocity", "acceleration", "link_position")
    return replace(
        run, **{n: x * unit for n in names if (x := getattr(run, n)) is not None and x.shape[1] == len(unit)}
    )


def described_torque(regressor: Regressor, run: Run) -> FloatArray:
    """Torque (m, n) of the description along a run, at its rows."""
    values = regressor.described
    torque = np.asarray(run.bodies @ values[: run.bodies.shape[2]])
    for column, axis, law in regressor.laws(run.dense):
        torque[:, axis] += run.filtered(values[column] * law)
    if not regressor.complete:
        torque += run.filtered(regressor.known_torque(run.dense))
    return torque


def _channels(runs: Sequence[Run], described: Sequence[FloatArray]) -> tuple[NDArray[np.intp], FloatArray]:
    """Which recorded torque (n,) is that of each joint, and its sign (n,)."""
    alike, recorded = _likeness(runs, described)
    left = _left(runs, described, recorded)
    order, sign = np.arange(len(left)), np.ones(len(left))
    taken, of = linear_sum_assignment(left)
    order[of] = taken
    moved = np.flatnonzero(order != np.arange(len(order)))
    if left[moved, moved].sum() - left[order[moved], moved].sum() < EXCHANGED * len(moved):
        order = np.arange(len(order))
    for j in range(len(order)):
        if alike[order[j], j] < -ALIKE:
            sign[j] = -1.0
    return order, sign


def _likeness(runs: Sequence[Run], described: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Correlation (n, n) of recorded torques with described ones; the recorded ones (m, n) without their means."""
    recorded, model = (
        np.concatenate([part[run.valid] - part[run.valid].mean(axis=0) for part, run in zip(parts, runs, strict=True)])
        for parts in ([run.torque for run in runs], described)
    )
    size = np.maximum(np.linalg.norm(recorded, axis=0)[:, None] * np.linalg.norm(model, axis=0), 1e-300)
    return (recorded.T @ model) / size, recorded


def _left(runs: Sequence[Run], described: Sequence[FloatArray], recorded: FloatArray) -> FloatArray:
    """ln share (n, n) of a recorded torque's variance that each joint's own motion leaves: (recorded, joint).

    By its described torque, dry and viscous friction and inertia, each of any size: a description may be far off.
    """
    out = np.empty((recorded.shape[1],) * 2)
    for j in range(len(out)):
        rows = []
        for run, torque in zip(runs, described, strict=True):
            speed = run.motion.velocity[:, j]
            columns = [torque[:, j], gradual_sign(speed), speed, run.motion.acceleration[:, j]]
            rows.append(np.stack(columns, axis=1)[run.valid])
        X = np.concatenate(rows)
        X = X - X.mean(axis=0)
        X = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        rest = recorded - X @ np.linalg.lstsq(X, recorded, rcond=None)[0]
        out[:, j] = np.log(
            np.maximum(np.sum(rest**2, axis=0), 1e-300) / np.maximum(np.sum(recorded**2, axis=0), 1e-300)
        )
    return out


def _told(order: NDArray[np.intp], sign: FloatArray) -> list[tuple[str, str]]:
    """Kind and text of what is wrong with the order and the signs of channels."""
    found = []
    if moved := [int(j) for j in np.flatnonzero(order != np.arange(len(order)))]:
        names = ", ".join(f"joint{j + 1} has that of joint{int(order[j]) + 1}" for j in moved)
        found.append(("swapped_channels", f"torque channels are exchanged: the one of {names}; they were put in order"))
    if turned := [f"joint{j + 1}" for j in np.flatnonzero(sign < 0)]:
        found.append(
            ("reversed_channel", f"the torque of {', '.join(turned)} has the opposite sign; it was turned round")
        )
    return found


def _clock(run: Run, described: FloatArray) -> float:
    """By how much torque falls behind positions per second, s/s; zero where it does not.

    The slope of lateness over time has the deviation of its scatter about a straight line. Lateness is taken to first
    order, so it is measured again with the torque put back.
    """
    rate, torque = 0.0, run.torque
    for _ in range(REPEATED):
        t, late = _lateness(run, described, torque)
        if len(t) < BLOCKS // 2:
            return 0.0
        t, y = t - t.mean(), late - late.mean()
        slope = float(t @ y / (t @ t))
        deviation = float(np.linalg.norm(y - slope * t) / np.sqrt(max(len(y) - 2, 1) * (t @ t)))
        rate += slope
        torque = CubicSpline(run.time, run.torque)(_there(run.time, rate))
    if abs(rate) > CLOCKS:  # lateness that physics makes: friction that changes, a load that is missing
        return 0.0
    seconds = float(np.ptp(run.time[run.valid]))
    return rate if abs(rate) > max(DRIFTED / (run.sample_hz * seconds), DRIFTING * deviation) else 0.0


def _lateness(run: Run, described: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """When (b,) and by how much (b,) torque is late, s, block by block.

    Torque that is late by τ misses the described one y by −τ dy/dt; level and scale are free.
    """
    rate, when, late = np.gradient(described, run.time, axis=0), [], []
    for block in np.array_split(np.flatnonzero(run.valid), BLOCKS):
        pull = power = 0.0
        for j in range(described.shape[1]):
            columns = np.stack([described[block, j], rate[block, j], np.ones(len(block))], axis=1)
            scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            x, *_ = np.linalg.lstsq(columns / scale, torque[block, j], rcond=None)
            gain, slope = x[0] / scale[0], x[1] / scale[1]
            rest = torque[block, j] - columns / scale @ x
            own = scale[1] ** 2 / max(float(rest @ rest), 1e-300)
            if gain > UNLIKE:
                pull, power = pull - own * slope / gain, power + own
        if power:
            late.append(pull / power)
            when.append(float(run.time[block].mean()))
    return np.array(when), np.array(late)


def _there(time: FloatArray, rate: float) -> FloatArray:
    """When torque is told that belongs to a time: it falls behind by ``rate`` from the run's beginning on."""
    return np.asarray(time[0] + (time - time[0]) * (1 + rate))


def _on_time(run: MotionRun, rate: float) -> MotionRun:
    """A run with its torque where it belongs."""
    if not rate or run.torque is None:
        return run
    there = _there(run.time, rate)
    return replace(run, torque=np.stack([np.interp(there, run.time, column) for column in run.torque.T], axis=1))
