"""Motion logs as a diagnosis uses them: low-passed rows of torque, and the same low-pass over any torque law.

Torque and every column go through one zero-phase low-pass at the band where the encoder is still above its noise. Laws
that step where an axis turns back are evaluated on a dense clock first, with the share of each interval spent on either
side of the reversal. So they are exact after filtering. Smooth laws are evaluated on a coarser clock. Rows are thinned
to what the band holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.interpolate
import scipy.ndimage
import scipy.signal

from twin.errors import InputError
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun, refuse_saturated, refuse_without_motion, saturated
from twin.measure.signals import first_motion, lowpass, resting, scatter, stillness
from twin.model.regressor import Regressor
from twin.model.torque_rows import Bands, joint_run, motion_of_run, split
from twin.model.torque_rows import Rows as _Rows
from twin.physics.motion import Motion
from twin.robot.description import Robot


@dataclass(frozen=True)
class Run:
    """One run, m rows of n joints.

    Attributes:
        time: (m,) s, the campaign's clock.
        motion: (m, n) the state of the drives at the rows; ``smooth`` and ``dense`` the same on denser clocks.
        turned: (nt, n) rad (m), how far drives have turned on the dense clock. A low-pass rings where one stops, and
            noise moves it at rest; friction would remember that.
        torque: (m, n) of the drives, N·m (N), low-passed.
        bodies: (m, n, 11 n) low-passed torque per unit of links' and rotors' parameters.
        twist: (m, n) motor minus link encoder, rad (m), low-passed, where the run has both.
        valid: (m,) rows that count.
        rate_hz: rows per second; ``sample_hz`` of the log.
        changes: what numbers of a description add to the torque, once asked for; copies of a run have it in common.
    """

    name: str
    time: FloatArray
    motion: Motion
    smooth: Motion
    dense: Motion
    turned: FloatArray
    torque: FloatArray
    bodies: FloatArray
    twist: FloatArray | None
    valid: np.ndarray
    bands: Bands
    rate_hz: float
    sample_hz: float
    changes: list[tuple[Regressor, FloatArray]] = field(default_factory=list)

    def filtered(self, law: FloatArray) -> FloatArray:
        """A law's torque (nt, …) on the dense or the smooth clock, low-passed at the rows (m, …)."""
        step = (len(law) - 1) // (len(self.time) - 1)
        return lowpass(law, self.rate_hz * step, *self.bands.fit, every=step)


def bands_of(
    log: MotionLog, largest_hz: float = 10.0, least_hz: float = 1.5, long_s: float = 600.0, recorded: float = 1e-5
) -> Bands:
    """The low-pass a log allows: 10 Hz, less where it is long, sampled slowly or its torque low-passed in recording.

    Args:
        log: with torque.
        largest_hz, least_hz: within which it ends, for its length's sake.
        long_s: a longer log has motion enough at lower frequencies.
        recorded: torque was low-passed in recording where its density falls below so much of its largest.
    """
    clear = 0.75  # of that frequency is clear of the recording's own low-pass
    seconds = sum(float(run.time[-1] - run.time[0]) for run in log.runs.values())
    stop = float(np.clip(largest_hz * long_s / seconds, least_hz, largest_hz))
    for run in log.runs.values():
        if run.torque is None:
            continue
        rate = run.sample_rate_hz
        stop = min(stop, 0.4 * rate)
        length = min(len(run.torque), int(max(20 * rate, 256)))
        frequency, power = scipy.signal.welch(run.torque, rate, nperseg=length, axis=0)
        share = np.max(power / np.maximum(power.max(axis=0), 1e-300), axis=1)
        held = np.flatnonzero(share > recorded)
        if held.size and frequency[held[-1]] < 0.4 * rate:
            stop = min(stop, max(clear * float(frequency[held[-1]]), 8 / (run.time[-1] - run.time[0])))
    return Bands((0.8 * stop, stop), (1.2 * stop, 1.5 * stop))


def run_of(
    regressor: Regressor, run: MotionRun, bands: Bands, rows_per_hz: float = 2.5, coarse: int = 2, fine: int = 8
) -> Run:
    """A run in joint coordinates as rows.

    Args:
        regressor: of the robot.
        run: in joint coordinates.
        bands: low-passes.
        rows_per_hz: rows per second and hertz of the low-pass.
        coarse, fine: instants per row of smooth laws, and at least of laws that step.
    """
    assert run.torque is not None
    rate = run.sample_rate_hz
    bands = bands.within(rate)
    stop = bands.fit[1]
    upsample = max(1, int(np.ceil(fine * rows_per_hz * stop / rate)))
    keep = max(1, int(rate / (2 * fine * rows_per_hz * stop)))
    wide = motion_of_run(run, bands, upsample).coupled(regressor.robot).of_drives
    step = max(1, int(rate * upsample / keep / (rows_per_hz * stop)))
    count = (len(wide.time) - 1) // (keep * step) + 1
    at = slice(0, (count - 1) * keep * step + 1, keep)
    dense = Motion(
        wide.time[at], wide.position[at], wide.velocity[at], wide.acceleration[at], sign=_mean_sign(wide.sign),
        coupling=wide.coupling, drives=wide.drives,
    )  # fmt: skip
    rows_hz = rate * upsample / (keep * step)

    def on(per_row: int) -> Motion:
        time = wide.time[0] + np.arange((count - 1) * per_row + 1) / (rows_hz * per_row)
        q, v, a = (_at(wide.time, x, time) for x in (wide.position, wide.velocity, wide.acceleration))
        return Motion(time, q, v, a, sign=_mean_sign(wide.sign), coupling=wide.coupling, drives=wide.drives)

    smooth, rows = on(coarse), on(1)

    def thin(signal: FloatArray) -> FloatArray:
        return _at(run.time, lowpass(signal, rate, *bands.fit), rows.time)

    bodies = regressor.bodies(smooth)
    flat = bodies.reshape(len(smooth.time), -1)
    used = np.flatnonzero(np.any(flat != 0, axis=0))
    thinned = np.zeros((count, flat.shape[1]))
    thinned[:, used] = lowpass(flat[:, used], rows_hz * coarse, *bands.fit, every=coarse)
    trim = 3 / stop
    turned, rest = _turned(run, dense)
    begin = run.time[first_motion(rest)]  # what dry friction holds before is unknown
    valid = (rows.time > begin + trim) & (rows.time < run.time[-1] - trim)
    cut = saturated(run).any(axis=1)
    for instant in run.time[cut]:
        valid &= np.abs(rows.time - instant) > 1 / (bands.fit[1] - bands.fit[0])
    twist = None if run.link_position is None else thin(run.position - run.link_position)
    return Run(
        run.name, rows.time, rows, smooth, dense, turned, wide.seen(thin(run.torque)),
        thinned.reshape(count, *bodies.shape[1:]), twist, valid, bands, rows_hz, rate,
    )  # fmt: skip


def _turned(run: MotionRun, dense: Motion) -> tuple[FloatArray, np.ndarray]:
    """How far drives have turned on the dense clock (nt, n), and at which samples of the run each rests (ns, n).

    They turn by the low-passed motion, and at a rest by what they :func:`_crept`.

    The low-pass rings where an axis stops, by more than friction turns round over.
    """
    drives = run.position if dense.coupling is None else run.position @ dense.coupling.T
    steps, noise = np.diff(dense.position, axis=0), scatter(drives)
    least = stillness(drives, noise)
    still = resting(drives, run.sample_rate_hz, least=least)
    least = np.where(8 * noise < least, least, 0.0)  # an encoder that is coarser than its noise tells nothing between
    for axis, position in enumerate(drives.T):
        edges = np.flatnonzero(np.diff(still[:, axis].astype(int), prepend=0, append=0))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            time = run.time[first:end]
            a, b = np.searchsorted(dense.time, time[0]), np.searchsorted(dense.time, time[-1], side="right")
            if b - a > 1:
                moved = _crept(position[first:end], run.sample_rate_hz, float(noise[axis]), float(least[axis]))
                x = np.interp(dense.time[a:b], time, moved)
                steps[a : b - 1, axis] = np.diff(x)
                if b <= len(steps):
                    steps[b - 1, axis] = dense.position[b, axis] - x[-1]
    turned = dense.position[0] + np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    return turned, still


def _crept(
    position: FloatArray, rate_hz: float, noise: float, least: float, about_s: float = 0.1, sure: float = 5.0
) -> FloatArray:
    """Where an axis is (nt,) while it seems to rest: at the median, but for what is more than the noise of a mean.

    An axis that starts slowly turns its friction round before a sample tells it from noise; the mean of a tenth of a
    second does. It may be off by ``least`` in any case, rad or m.
    """
    count, middle = min(max(1, round(about_s * rate_hz)), len(position)), float(np.median(position))
    off = scipy.ndimage.uniform_filter1d(position - middle, count, mode="nearest")
    hidden = max(sure * noise / np.sqrt(count), least)
    return np.asarray(middle + np.sign(off) * np.maximum(np.abs(off) - hidden, 0.0))


def _at(time: FloatArray, signal: FloatArray, instants: FloatArray) -> FloatArray:
    """A signal that is smooth between its samples, at other instants."""
    nearest = np.clip(np.searchsorted(time, instants), 1, len(time) - 1)
    nearest -= instants - time[nearest - 1] < time[nearest] - instants
    if np.abs(time[nearest] - instants).max() < 1e-9:
        return signal[nearest]
    return scipy.interpolate.CubicSpline(time, signal)(np.clip(instants, time[0], time[-1]))


def _mean_sign(sign: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
    """Mean over a sampling interval of the signum of a velocity: its reversals fall between samples."""

    def mean(speed: FloatArray) -> FloatArray:
        half = np.empty_like(speed)  # of what it changes by from one interval's middle to the next
        np.subtract(speed[2:], speed[:-2], out=half[1:-1])
        half[1:-1] *= 0.25
        half[[0, -1]] = 0.5 * (speed[1] - speed[0]), 0.5 * (speed[-1] - speed[-2])
        np.maximum(np.abs(half, out=half), 1e-300, out=half)
        np.clip(np.divide(speed, half, out=half), -1, 1, out=half)
        half[sign(speed) == 0] = 0.0
        return half

    return mean


@dataclass(frozen=True)
class Prepared:
    """A log divided into what is fitted and what is kept aside.

    Attributes:
        used, kept: rows count in one or the other; with a single run both hold it, with other rows valid.
        held_out: in words.
        notes: what was repaired or left out.
    """

    regressor: Regressor
    used: list[Run]
    kept: list[Run]
    held_out: list[str]
    bands: Bands
    notes: list[str]


def prepare(
    log: MotionLog, robot: Robot, source: str, hold_out: list[str] | None = None, bands: Bands | None = None
) -> Prepared:
    """Rows of every run, whole runs held out; of a single run contiguous blocks.

    Raises:
        InputError: no torque, torque cut off too often, a run too short, or a name to hold out that is not there.
    """
    refuse_without_motion(log, source)
    bands = bands or bands_of(log)
    shortest = 80.0  # seconds times hertz of the low-pass, over all runs; of one run half of it
    regressor = Regressor(robot)
    runs, notes = [], list(log.notes)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in log.runs.values())
    if seconds * bands.fit[1] < shortest:
        least = shortest / bands.fit[1]
        raise InputError(source, "runs", f"too short to judge: {seconds:.3g} s in all, expected {least:.3g} s or more")
    for name, run in log.runs.items():
        if run.torque is None:
            raise InputError(source, f"runs/{name}/torque", "missing: a trajectory cannot be diagnosed")
        if (run.time[-1] - run.time[0]) * bands.fit[1] < 0.5 * shortest:
            raise InputError(
                source, f"runs/{name}/time", f"shorter than {0.5 * shortest / bands.fit[1]:.2g} s: too short to judge"
            )
        refuse_saturated(run, source)
        runs.append(run_of(regressor, joint_run(robot, run), bands))
    none = np.zeros((0, 0))
    rows = [
        _Rows(r.name, r.time, none, none, none, r.torque, none, none, none, r.valid, none, r.rate_hz) for r in runs
    ]  # fmt: skip
    parts = split(rows, hold_out, bands, source)
    by_name = {r.name: r for r in runs}
    used = [replace(by_name[r.name], valid=r.valid) for r in parts.train]
    kept = [replace(by_name[r.name], valid=r.valid) for r in parts.held_out]
    held = [parts.text] if len(runs) == 1 else [r.name for r in kept]
    return Prepared(regressor, used, kept, held, bands, notes)
