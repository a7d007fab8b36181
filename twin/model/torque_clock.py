"""Whether the clock of a log's torque runs apart from that of its positions, and the log put right."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun
from twin.model.regressor import Regressor
from twin.model.torque_signal import Run

UNLIKE = 0.5  # gain of a described torque below which a joint tells nothing of time
BLOCKS = 8  # of a run, in which its lateness is measured
DRIFTING = 6.0  # deviations of a slope of lateness over time
REPEATED = 3  # measurements of lateness
DRIFTED = 0.5  # samples of the log over a run: less is a clock's ordinary jitter
CLOCKS = 0.01  # s/s: quartz is off by 1e-4, stamps of a busy computer by some 1e-3; what is off by more is no clock


def clock_rates(runs: Sequence[Run], torque: Sequence[FloatArray]) -> dict[str, float]:
    """By how much recorded torque falls behind a model's (m, n) per second, s/s, of the runs where it does."""
    rates = {run.name: _clock(run, model) for run, model in zip(runs, torque, strict=True)}
    return {name: rate for name, rate in rates.items() if rate}


def on_time(log: MotionLog, rates: Mapping[str, float]) -> MotionLog:
    """A log with its torque where it belongs."""
    return replace(log, runs={name: _on_time(run, rates.get(name, 0.0)) for name, run in log.runs.items()})


def described_torque(regressor: Regressor, run: Run) -> FloatArray:
    """Torque (m, n) of the description along a run, at its rows."""
    values = regressor.described
    torque = np.asarray(run.bodies @ values[: run.bodies.shape[2]])
    for column, axis, law in regressor.laws(run.dense):
        torque[:, axis] += run.filtered(values[column] * law)
    if not regressor.complete:
        torque += run.filtered(regressor.known_torque(run.dense))
    return torque


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
