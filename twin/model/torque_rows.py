"""A motion log as rows of torque beside all columns of the regressor, both through one low-pass.

The same low-pass goes over the torque and over every column. So laws that are not smooth (friction) stay exact.
Positions are differentiated in a wider band.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun, check_against, require_axes, saturated
from twin.measure.signals import advance, differentiate, first_motion, lowpass, resting
from twin.model.regressor import Regressor, rotor_body_regressor
from twin.physics import CATALOGUE
from twin.physics.chain import MeasurementChain
from twin.physics.motion import TURNING, Motion, gradual_sign
from twin.ranges import check_band, implausible
from twin.robot.description import Robot

TURNINGS = (TURNING, TURNING / 10)  # of the largest speed: one alone leaves tanh(q̇ / 0.2 %) 1 to 2 % off
PASSED = 0.3  # share of a column's amplitude the low-pass must leave for its parameter to be called identifiable
TOO_SHORT = "{:.2g} s are too short: the ends of the low-pass take up all of it"


@dataclass(frozen=True)
class Bands:
    """Cosine tapers (pass, stop) in Hz: of the encoder before it is differentiated, and of torque and columns."""

    fit: tuple[float, float] = (3.0, 4.0)
    motion: tuple[float, float] = (10.0, 12.0)

    def __post_init__(self) -> None:
        check_band("--low-pass", self.fit)
        if not self.fit[0] > 0 or implausible(self.fit[0], "Hz", True):
            raise InputError("--low-pass", "", f"expected 1e-6 Hz ≤ pass < stop, found {self.fit[0]:g} {self.fit[1]:g}")

    def within(self, rate_hz: float) -> "Bands":
        """The same with the motion's band below half the sampling rate, and not below that of the fit."""
        stop = min(max(self.motion[1], 1.5 * self.fit[1]), 0.45 * rate_hz)
        return replace(self, motion=(min(self.motion[0] / self.motion[1], 0.85) * stop, stop))


@dataclass(frozen=True)
class Rows:
    """One run as rows of the least-squares problem, at m instants after the low-pass.

    Attributes:
        time: (m,) s.
        position, velocity, acceleration: (m, n) of the joints, rad (m).
        torque: (m, n) of the joints, N·m (N), less what has no column.
        known: (m, n) of what has no column.
        matrix: (m, n, p) torque per unit of every column.
        turning: (m, n, w) signum of the velocity less :func:`gradual_sign` of it, over each of ``TURNINGS``.
        valid: (m,) rows that count; those near the ends or a saturated torque do not.
        passed: (p,) amplitude of each column after the low-pass over that before.
        rate_hz: rows per second.
    """

    name: str
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    known: FloatArray
    matrix: FloatArray
    turning: FloatArray
    valid: np.ndarray
    passed: FloatArray
    rate_hz: float

    def only(self, valid: np.ndarray) -> "Rows":
        """The same rows, of which only those where ``valid`` (m,) also count."""
        return replace(self, valid=self.valid & valid)


def joint_run(robot: Robot, run: MotionRun) -> MotionRun:
    """A recorded run in joint coordinates, torque constants and delays of the measurement put right.

    The record holds motors: θ = C q, so that q = C⁻¹ θ and τ_q = Cᵀ τ_θ, where a drive also turns with other axes.
    """
    n = robot.axis_count
    chain = MeasurementChain((), np.zeros((0, 3)), (), np.zeros((0, 3)), torque_gain=np.ones(n))
    for entry in robot.physics:
        CATALOGUE[entry.effect].record(chain, entry.site, entry.values)
    C = robot.coupling
    to_joint = np.linalg.inv(C).T
    torque = run.torque
    if torque is not None:
        torque = torque / chain.gain_at(run.time)
        if chain.torque_lag:  # what the recorder's low-pass has taken, τ + T dτ/dt
            torque = torque + chain.torque_lag * np.gradient(torque, 1 / run.sample_rate_hz, axis=0)
        torque = advance(torque, run.sample_rate_hz, chain.torque_delay) @ C
    return replace(
        run,
        position=run.position @ to_joint,
        torque=torque,
        velocity=None if run.velocity is None else run.velocity @ to_joint,
        acceleration=None if run.acceleration is None else run.acceleration @ to_joint,
    )


def in_joints(log: MotionLog, robot: Robot) -> MotionLog:
    """A log as recorded (motors) in joint coordinates, checked against the robot.

    Raises:
        InputError: number of axes, units or limits do not fit.
    """
    require_axes(log, robot.axis_count)
    turned = replace(log, runs={name: joint_run(robot, run) for name, run in log.runs.items()})
    check_against(turned, robot)
    return turned


def motion_of_run(run: MotionRun, bands: Bands, upsample: int = 1, slowest: float = 4.0) -> Motion:
    """Position, velocity and acceleration of a run in joint coordinates, low-passed, ``upsample`` times as dense.

    An axis slower than ``slowest`` standard deviations of its velocity's noise stands still: its friction has no sign.
    """
    rate = run.sample_rate_hz
    band = bands.within(rate).motion
    q, v, a = differentiate(run.position, rate, *band, upsample)
    if run.velocity is not None:
        v = lowpass(run.velocity, rate, *band, 0, upsample)
    if run.acceleration is not None:
        a = lowpass(run.acceleration, rate, *band, 0, upsample)
    still = np.ptp(run.position, axis=0) == 0
    v, a = np.where(still, 0.0, v), np.where(still, 0.0, a)
    noise = np.std(run.position - q[::upsample], axis=0)
    slow = slowest * float(np.max(noise)) * 2 * np.pi * band[1] * np.sqrt(2 * band[1] / (3 * rate))
    time = run.time[0] + np.arange(len(q)) / (rate * upsample)
    return Motion(time, q, v, a, sign=lambda speed: np.where(np.abs(speed) > slow, np.sign(speed), 0.0))


def rows_of(regressor: Regressor, run: MotionRun, bands: Bands, rows_per_hz: float = 5.0, part: int = 100_000) -> Rows:
    """A run in joint coordinates as rows: torque and all columns through the same low-pass, then thinned out.

    ``rows_per_hz`` are kept per second and hertz of the low-pass. Links' columns are evaluated at eight times the
    motion's band. A log of 80 Hz and more is taken to hold samples of the torque. A slower one is taken to be filtered
    before it was thinned out; laws that step are then evaluated at 200 Hz. Longer runs are taken in parts of so many
    samples, which overlap by the memory of the low-pass; ten times longer ones keep half the rows.
    """
    run, rate, count = parked(run), run.sample_rate_hz, len(run.time)
    bands, rows_per_hz = bands.within(rate), rows_per_hz / (1 if count <= 10 * part else 2)
    step = max(1, int(rate / (rows_per_hz * bands.fit[1])))
    cut, rest = run.time[saturated(run).any(axis=1)], resting(run.position, rate)
    begin = float(run.time[first_motion(rest)])
    if count <= part:
        return _rows_of(regressor, run, bands, step, begin, cut, rest)
    block, overlap = part // step * step, int(np.ceil(10 * rate / (bands.fit[1] - bands.fit[0]) / step)) * step
    rows: list[Rows] = []
    for first in range(0, count, block):
        low, high = max(first - overlap, 0), min(first + block + overlap, count)
        some: dict[str, Any] = {f.name: getattr(run, f.name) for f in fields(run)}
        some = {key: x[low:high] if isinstance(x, np.ndarray) else x for key, x in some.items()}
        here = _rows_of(regressor, MotionRun(**some), bands, step, begin, cut, rest[low:high])
        keep = slice((first - low) // step, (min(first + block, count) - low - 1) // step + 1)
        series = ("time", "position", "velocity", "acceleration", "torque", "known", "matrix", "turning", "valid")
        rows.append(replace(here, **{key: getattr(here, key)[keep].copy() for key in series}))
    together: dict[str, Any] = {key: np.concatenate([getattr(r, key) for r in rows]) for key in series}
    return replace(rows[0], **together, passed=np.mean([r.passed for r in rows], axis=0))


def _rows_of(
    regressor: Regressor, run: MotionRun, bands: Bands, step: int, begin: float, cut: FloatArray, rest: np.ndarray
) -> Rows:  # fmt: skip
    """Every ``step``-th sample as a row. Axes ``rest`` (nt, n).

    None counts before the first motion begins, s, nor near where torque was ``cut`` off, s: what dry friction holds
    before is unknown.
    """
    assert run.torque is not None
    rate = run.sample_rate_hz

    def thinned(values: FloatArray, upsample: int) -> FloatArray:
        flat = values.reshape(len(values), -1)
        used = np.flatnonzero(np.any(flat != 0, axis=0))
        out = np.zeros((len(flat[:: upsample * step]), flat.shape[1]))
        out[:, used] = lowpass(flat[:, used], rate * upsample, *bands.fit)[:: upsample * step]
        return out.reshape(-1, *values.shape[1:])

    coarse = max(1, int(np.ceil(8.0 * bands.motion[1] / rate)))
    fine = 1 if rate >= 80.0 else int(np.ceil(200.0 / rate))
    motion = motion_of_run(run, bands, coarse)
    dense = motion if fine == coarse else motion_of_run(run, bands, fine)
    dense = holding(dense, np.repeat(rest, fine, axis=0)[: len(dense.time)])
    bodies = regressor.bodies(motion)
    n, p = regressor.robot.axis_count, len(regressor.columns)
    before = np.zeros(p)
    before[: 11 * n] = np.sqrt(np.mean(bodies**2, axis=(0, 1)))
    smooth = thinned(bodies, coarse)
    matrix = np.zeros((len(smooth), n, p))
    matrix[:, :, : 11 * n] = smooth
    for column, axis, law in regressor.laws(dense):
        matrix[:, axis, column] += thinned(law[:, None], fine)[:, 0]
        before[column] = np.hypot(before[column], np.sqrt(np.mean(law**2) / n))
    after = np.sqrt(np.mean(matrix**2, axis=(0, 1)))
    known = thinned(regressor.known_torque(dense), fine)
    turned = np.stack([gradual_sign(dense.velocity, over) for over in TURNINGS], axis=2)
    turning = thinned(dense.sign(dense.velocity)[:, :, None] - turned, fine)
    torque = thinned(run.torque, 1)
    at = slice(None, None, coarse * step)
    time = motion.time[at]
    trim = 6 / bands.motion[1]
    valid = (time > max(time[0], begin) + trim) & (time < time[-1] - trim)
    for instant in cut:
        valid &= np.abs(time - instant) > 1 / (bands.fit[1] - bands.fit[0])
    return Rows(
        run.name, time, motion.position[at], motion.velocity[at], motion.acceleration[at], torque - known, known,
        matrix, turning, valid, after / np.where(before > 0, before, 1), rate / step,
    )  # fmt: skip


def parked(run: MotionRun) -> MotionRun:
    """A run in which axes that never move stand where they do in the mean: an encoder's noise is no motion."""
    still = resting(run.position, run.sample_rate_hz).all(axis=0)
    if not still.any():
        return run
    return replace(run, position=np.where(still, run.position.mean(axis=0), run.position))


def holding(motion: Motion, rest: np.ndarray) -> Motion:
    """A motion whose axes do not move where they ``rest`` (nt, n); dry friction keeps the sign there that it had.

    The low-pass rings where an axis stops. What holds it at rest is unknown by nature, and in a stiff drive it is what
    friction had when it stopped.
    """

    def sign(speed: FloatArray) -> FloatArray:
        now = motion.sign(speed)
        index = np.arange(len(now)).reshape(-1, *[1] * (now.ndim - 1))
        last = np.maximum.accumulate(np.where(now != 0, index, 0), axis=0)
        return np.where(speed == 0, np.take_along_axis(now, last, axis=0), now)

    return replace(motion, velocity=np.where(rest, 0.0, motion.velocity), sign=sign)


def lost_rotor_terms(robot: Robot, run: MotionRun, bands: Bands) -> dict[str, float]:
    """Rotors' terms in sin 2Nq (unequal transverse inertias) → share of their amplitude that the low-pass leaves.

    They need no columns where that is little: they turn hundreds of times as fast as the joint. Runs in joint
    coordinates; only uncoupled revolute drives with a gear have such terms.
    """
    if any(axis.type == "prismatic" for axis in robot.axes) or any(drive.coupling for drive in robot.drives):
        return {}
    motion = motion_of_run(parked(run), bands)
    Y = rotor_body_regressor(robot, motion)
    left = {}
    for i, drive in enumerate(robot.drives):
        column = Y[:, :, 4 * i + 1]
        before = float(np.sqrt(np.mean(column**2)))
        # a rotor about a fixed axis has no such term
        if abs(drive.gear_ratio) > 10 and before > 1e-9 * float(np.abs(Y).max()):
            after = lowpass(column, run.sample_rate_hz, *bands.within(run.sample_rate_hz).fit)
            left[f"drive{i + 1}.Ixx − drive{i + 1}.Iyy"] = float(np.sqrt(np.mean(after**2))) / before
    return left


def relative_error(rows: list[Rows], predict: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Per joint (n,): RMS of residual over RMS of torque, and RMS of residual, of the parameters ``predict`` (p,)."""
    residual = np.concatenate([(r.torque - r.matrix @ predict)[r.valid] for r in rows])
    torque = np.concatenate([(r.torque + r.known)[r.valid] for r in rows])
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return rms / np.sqrt(np.mean(torque**2, axis=0)), rms


@dataclass(frozen=True)
class Split:
    """Rows to fit and rows held out, and in words how they were chosen."""

    train: list[Rows]
    held_out: list[Rows]
    text: str


def split(rows: list[Rows], hold_out: list[str] | None, bands: Bands, source: str = "log") -> Split:
    """Hold out whole runs; of a single run contiguous blocks, with a gap of the filter's memory between.

    Without names every third run is held out (the paper: two of six), or the second and fifth of six blocks.

    Raises:
        InputError: a name that is no run, or nothing left to fit.
    """
    names = [r.name for r in rows]
    for name in hold_out or []:
        if name not in names:
            raise InputError(source, f"--hold-out {name}", f"no such run; runs are {', '.join(names)}")
    if hold_out:
        train = [r for r in rows if r.name not in hold_out]
        if not train:
            raise InputError(source, "--hold-out", "every run is held out; nothing is left to fit")
        return Split(train, [r for r in rows if r.name in hold_out], ", ".join(hold_out) + " (as asked)")
    if len(rows) > 1:
        chosen = names[2::3] or names[-1:]
        return Split(
            [r for r in rows if r.name not in chosen], [r for r in rows if r.name in chosen], ", ".join(chosen)
        )
    (run,) = rows
    place = 6 * (run.time - run.time[0]) / (run.time[-1] - run.time[0])
    block = np.minimum(place.astype(int), 5)
    inside = np.isin(block, (1, 4))
    memory = min(1 / (bands.fit[1] - bands.fit[0]), 0.1 * (run.time[-1] - run.time[0]) / 6)
    edges = run.time[np.flatnonzero(np.diff(inside.astype(int)))]
    clear = np.all(np.abs(run.time[:, None] - edges[None, :]) > memory / 2, axis=1)
    text = f"blocks 2 and 5 of six of {run.name}, with gaps of {memory:.2g} s"
    return Split([run.only(clear & ~inside)], [run.only(clear & inside)], text)
