"""Motion logs and trajectories on disk: HDF5 (``motion-log``, ``trajectory``) and CSV, their checks and repairs.

A trajectory is a motion log without torque. Positions are the motor encoder divided by the gear ratio, torques the
motor torque times the gear ratio, both at the gear output.
"""

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.errors import InputError, tell
from twin.files import writing
from twin.measure.campaign import FloatArray, twice
from twin.measure.hdf5 import Node, created, opened
from twin.measure.signals import resample
from twin.measure.units import STANDARD_GRAVITY
from twin.ranges import check_array, ill_named, implausible

if TYPE_CHECKING:
    from twin.robot.description import Axis, Robot

VERSION = 1
LONG = 1_500_000  # samples of a run, beyond which it is read in parts: 25 minutes at 1 kHz
COARSE_HZ = 250.0  # rate it is then read at, at least: as the shipped recordings have
LONGEST_GAP_S = 0.05  # longer ones are not bridged: a spline knows nothing of what a robot did in them
NO_JITTER = 0.005  # of a sample: an axis at 2 rad/s, recorded at 250 Hz, moves by 0.04 mrad meanwhile
DIGITS_S = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)  # to which stamps may be rounded
LONGEST_PERIOD_S = 0.5  # a move from point to point takes a second or two: nothing of it shows in slower samples
FLAT_S = 0.02  # torque that stays at its largest value for so long while the axis moves was cut off
LEAVES = 0.1  # of an axis's range, by which a log may leave it
LEAST_MOTION = 1e-3  # rad (m)
NO_MOTION = f"no axis moves by {LEAST_MOTION:g} rad (m)"
LONE = 20.0  # times the 99 % quantile of the steps between samples: friction that turns steps, and does not come back
HEADER = "time,q1..qn,tau1..taun (`twin import` reads other names, separators and units)"
LEAST_HELD, MOST_HELD = 1e-3, 30.0  # largest torque over what the weight asks for: outside, it has another unit
WIND_UP = 0.2  # rad (m): more than a gear twists
SERIES = {  # units, where a file states them: revolute or linear axis
    "position": ("rad", "m"),
    "torque": ("N·m", "N"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "link_position": ("rad", "m"),
}


@dataclass(frozen=True)
class MotionRun:
    """One uninterrupted run of n axes, nt samples.

    Attributes:
        time: (nt,) s, one clock over all runs of a campaign.
        position: (nt, n) rad (m).
        torque: (nt, n) N·m (N), or ``None`` in a trajectory.
        velocity: (nt, n) rad/s (m/s), where given.
        acceleration: (nt, n) rad/s² (m/s²), where given.
        link_position: (nt, n) rad (m), a second encoder on the link side, where there is one.
        sample_rate_hz: nominal rate.
    """

    name: str
    time: FloatArray
    position: FloatArray
    sample_rate_hz: float
    torque: FloatArray | None = None
    velocity: FloatArray | None = None
    acceleration: FloatArray | None = None
    link_position: FloatArray | None = None

    def __repr__(self) -> str:
        """One line: the arrays are long."""
        series = [name for name in SERIES if getattr(self, name) is not None]
        seconds = f"{self.time[-1] - self.time[0]:.4g} s at {self.sample_rate_hz:.4g} Hz" if len(self.time) else "empty"
        return f"{self.name}: {self.position.shape[1]} axes; {seconds}; {', '.join(series)}"


@dataclass(frozen=True)
class MotionLog:
    """Runs by name, the robot they were made with, where the file says, and what was repaired on reading."""

    runs: dict[str, MotionRun] = field(default_factory=dict)
    robot: str | None = None
    source: str = "motion log"
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """One line per run, and what was repaired."""
        count = f"{len(self.runs)} run{'s' * (len(self.runs) != 1)}"
        head = f"motion log {self.source}{f' of {self.robot}' if self.robot else ''}: {count}"
        return "\n  ".join([head, *map(repr, self.runs.values()), *self.notes])


def read_motion_log(path: str | Path) -> MotionLog:
    """Read a motion log or trajectory from HDF5 or CSV (header ``time,q1..qn,tau1..taun``).

    Samples come out evenly spaced: repeated stamps are dropped, jitter and short gaps resampled, each with a note.

    Raises:
        InputError: the file is missing, breaks the contract, or its clock cannot be repaired; one line names the field.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file")
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    with opened(path) as file:
        root = Node(path, file)
        kind = root.text("format")
        if kind not in ("motion-log", "trajectory"):
            raise InputError(path, "format", f"expected 'motion-log' or 'trajectory', found {kind!r}")
        if root.number("version", VERSION) != VERSION:
            raise InputError(path, "version", f"expected {VERSION}, found {root.attribute('version')!r}")
        root.tell_unknown("runs")
        groups = root.group("runs")
        if not len(groups.item):
            raise InputError(path, "runs", "expected at least one run")
        runs, notes = {}, []
        for name in groups.item:
            if problem := ill_named(name):
                raise InputError(path, "runs", problem)
            group = groups.group(name)
            if (rate := group.number("sample_rate_hz")) is None:
                raise InputError(path, f"{group.field}/sample_rate_hz", "missing attribute")
            group.tell_unknown("time", *SERIES)
            time = group.real("time", "s")
            if (factor := _coarser(time, rate)) > 1:
                series = {key: _in_parts(group, key, unit, factor) for key, unit in SERIES.items() if group.has(key)}
                notes.append(
                    f"{group.field}: {len(time)} samples are read in parts, as one in {factor}, "
                    f"low-passed at {0.4 * rate / factor:.3g} Hz"
                )
                time, rate = time[::factor], rate / factor
            else:
                series = {key: group.real(key, *unit) for key, unit in SERIES.items() if group.has(key)}
            runs[name], repairs = even_run(path, group.field, name, time, series, rate)
            notes += repairs
            if kind == "motion-log" and runs[name].torque is None:
                raise InputError(path, f"{group.field}/torque", "missing")
        told = [(name, (run.time, run.position, run.torque)) for name, run in runs.items() if run.torque is not None]
        if again := twice(told):
            problem = f"expected every run once, the same recording is also there as {again[1]!r}"
            raise InputError(path, f"runs/{again[0]}", problem)
        return MotionLog(runs, root.text("robot"), str(path), tuple(notes))


def _coarser(time: FloatArray, rate: float) -> int:
    """As one in how many samples a run is read: one, unless it is long, fast and evenly sampled."""
    factor = int(rate / COARSE_HZ) if rate > 0 and np.isfinite(rate) else 1
    if factor < 2 or len(time) <= LONG or time.ndim != 1 or not np.isfinite(time).all():
        return 1
    even = time[0] + np.arange(len(time)) / rate
    return factor if np.abs(time - even).max() < 0.1 / rate else 1


def _in_parts(group: Node, key: str, unit: tuple[str, ...], factor: int, block: int = 1 << 14) -> FloatArray:
    """Every ``factor``-th sample of a series after a low-pass of linear phase; at its ends it is point-symmetric."""
    from scipy.signal import firwin, upfirdn  # a third of what there is to import, for few

    taps = firwin(16 * factor + 1, 0.8 / factor)
    count, half = len(group.dataset(key).item), 8 * factor
    rows = -(-count // factor)
    out: FloatArray | None = None
    for first in range(0, rows, block):
        last = min(first + block, rows)
        low, high = first * factor - half, (last - 1) * factor + half + 1
        values = group.real(key, *unit, part=slice(max(low, 0), min(high, count)))
        ends = (max(-low, 0), max(high - count, 0))
        values = np.pad(values, (ends, *((0, 0),) * (values.ndim - 1)), "reflect", reflect_type="odd")
        if out is None:
            out = np.empty((rows, *values.shape[1:]))
        out[first:last] = upfirdn(taps, values, 1, factor, axis=0)[16 : 16 + last - first]
    assert out is not None
    return out


def write_motion_log(path: str | Path, log: MotionLog) -> None:
    """Write a log as HDF5, or as CSV where the name ends so (one run only), atomically."""
    path = Path(path)
    if path.suffix.lower() == ".csv":
        _write_csv(path, log)
        return
    with created(path) as file:
        torque = all(run.torque is not None for run in log.runs.values())
        file.attrs.update({"format": "motion-log" if torque else "trajectory", "version": VERSION})
        if log.robot:
            file.attrs["robot"] = log.robot
        for name, run in log.runs.items():
            group = file.create_group(f"runs/{name}")
            group.attrs["sample_rate_hz"] = run.sample_rate_hz
            group["time"] = run.time
            for key in SERIES:
                if (values := getattr(run, key)) is not None:
                    group[key] = values


def require_axes(log: MotionLog, axes: int) -> MotionLog:
    """The log itself.

    Raises:
        InputError: a run with another number of axes than the robot has.
    """
    for name, run in log.runs.items():
        if run.position.shape[1] != axes:
            raise InputError(
                log.source, f"runs/{name}/position", f"expected {axes} columns, found {run.position.shape[1]}"
            )
    return log


def even_run(
    path: Path, where: str, name: str, time: FloatArray, series: dict[str, FloatArray], rate: float
) -> tuple[MotionRun, list[str]]:
    """A checked run on an even clock, and what was repaired, one sentence each.

    Args:
        path, where: file and field that messages name.
        name: of the run.
        time: (nt,) s.
        series: quantity → (nt, n), SI; ``position`` at least.
        rate: nominal, Hz.

    Raises:
        InputError: shapes that disagree, numbers that are not finite, a clock that cannot be repaired.
    """
    if not rate > 0:
        raise InputError(path, f"{where}/sample_rate_hz", f"expected a number > 0, found {rate:g}")
    if time.ndim != 1 or len(time) < 2:
        raise InputError(path, f"{where}/time", f"expected at least two instants (nt,), found shape {time.shape}")
    if not np.isfinite(time).all() or (np.diff(time) < 0).any():
        raise InputError(path, f"{where}/time", "expected finite, increasing instants in s")
    if "position" not in series:
        raise InputError(path, f"{where}/position", "missing")
    shape = series["position"].shape
    if not series["position"].size:
        raise InputError(path, f"{where}/position", f"expected at least one axis, found shape {shape}")
    for key, values in series.items():
        if values.ndim != 2 or len(values) != len(time) or values.shape != shape:
            expected = f"({len(time)}, {shape[1] if len(shape) == 2 else 'n'})"
            raise InputError(path, f"{where}/{key}", f"expected shape {expected}, found {values.shape}")
        if not np.isfinite(values).all():
            sample, axis = np.argwhere(~np.isfinite(values))[0]
            text = f"is no number at sample {sample} (from 0) of axis {axis + 1}; leave such samples out"
            raise InputError(path, f"{where}/{key}", text)
        check_array(path, f"{where}/{key}", values, SERIES[key][0])
    if "torque" in series and (problem := implausible(float(np.abs(series["torque"]).max()), "N·m", scale=True)):
        raise InputError(path, f"{where}/torque", problem)
    _refuse_other_velocity(path, where, time, series)
    doubts = [*_lone_samples(where, time, series), *_link_encoders(where, series)]
    time, series, rate, notes = _even(path, where, time, series, rate)
    return MotionRun(name, time, sample_rate_hz=rate, **series), doubts + notes


def _lone_samples(where: str, time: FloatArray, series: dict[str, FloatArray]) -> list[str]:
    """What to say of samples that leap away from both neighbours, to one side: a recorder's slip, no motion."""
    found = []
    for key, values in series.items():
        step = np.diff(values, axis=0)
        usual = np.quantile(np.abs(step), 0.99, axis=0)
        away, back = step[:-1], -step[1:]
        leap = np.where(away * back > 0, np.minimum(np.abs(away), np.abs(back)), 0.0)
        alone = (leap > LONE * usual) & (usual > 0)
        if count := int(alone.sum()):
            at, axis = np.unravel_index(
                int(np.argmax(np.where(alone, leap / np.maximum(usual, 1e-300), 0))), leap.shape
            )
            found.append(
                f"{where}/{key}: {count} samples leap away from their neighbours, the farthest of joint{axis + 1} at "
                f"{time[at + 1]:.3f} s ({values[at + 1, axis]:.4g} beside {values[at, axis]:.4g}): look at the recorder"
            )
    return found


def _link_encoders(where: str, series: dict[str, FloatArray]) -> list[str]:
    """What to say of second encoders that do not move as their axes do."""
    if "link_position" not in series:
        return []
    own, link = series["position"], series["link_position"]
    moved, off = np.ptp(own, axis=0), np.ptp(link - own, axis=0)
    still = (np.ptp(link, axis=0) == 0) & (moved > WIND_UP / 10)
    notes = []
    if (wrong := ~still & (off > WIND_UP + 0.1 * moved)).any():
        i = int(np.argmax(wrong))
        notes.append(
            f"{where}/link_position: joint{i + 1} differs from its motor's position by {off[i]:.3g} rad (m), more than "
            "a gear winds up: is it in another unit, or of another axis?"
        )
    if still.any():
        names = ", ".join(f"joint{i + 1}" for i in np.flatnonzero(still))
        notes.append(f"{where}/link_position: that of {names} never moves while the axis does: is there an encoder?")
    return notes


def _refuse_other_velocity(path: Path, where: str, time: FloatArray, series: dict[str, FloatArray]) -> None:
    """Raise unless a velocity that is given adds up to the positions, but for a constant of each axis.

    Raises:
        InputError: it does not.
    """
    if "velocity" not in series:
        return
    own, velocity = series["position"], series["velocity"]
    part = np.diff(time)[:, None] * (velocity[1:] + velocity[:-1]) / 2
    off = np.concatenate([np.zeros((1, own.shape[1])), np.cumsum(part, axis=0)]) - own
    if (span := float(time[-1] - time[0])) > 0:
        off = off - np.outer((time - time[0]) / span, off[-1] - off[0])
    far, moved = np.ptp(off, axis=0), np.ptp(own, axis=0)
    if (wrong := far > WIND_UP + moved / 2).any():
        i = int(np.argmax(wrong))
        raise InputError(
            path, f"{where}/velocity",
            f"expected the derivative of the positions in rad/s (m/s); the integral of joint{i + 1}'s is {far[i]:.3g} "
            "rad (m) off its position: is it in another unit?",
        )  # fmt: skip


def _even(
    path: Path, where: str, time: FloatArray, series: dict[str, FloatArray], rate: float
) -> tuple[FloatArray, dict[str, FloatArray], float, list[str]]:
    """The record on an even clock, and what that took."""
    notes = []
    fresh = np.concatenate([[True], np.diff(time) > 0])
    if told := _in_batches(time, series, rate, fresh):
        even = _line(time)
        return even, series, 1 / float(even[1] - even[0]), [f"{where}: {told}"]
    if repeated := int(np.sum(~fresh)):
        if repeated > 0.05 * len(time):
            text = f"{repeated} of {len(time)} time stamps are repeated: was this clock coarser than the samples?"
            raise InputError(path, f"{where}/time", f"{text} `twin import` takes `sample_rate_hz` instead of a clock")
        first = time[np.argmin(fresh)]
        notes.append(f"{where}: {repeated} repeated time stamps dropped, the first at {first:.3f} s")
        time, series = time[fresh], {key: values[fresh] for key, values in series.items()}
    period = float(np.median(np.diff(time)))
    if abs(period * rate - 1) > 0.02:
        raise InputError(
            path, f"{where}/time", f"stamps are {period:g} s apart, but sample_rate_hz is {rate:g}; expected seconds"
        )
    if period > LONGEST_PERIOD_S:
        text = f"stamps are {period:g} apart; expected seconds, and at most {LONGEST_PERIOD_S:g} between two samples"
        raise InputError(path, f"{where}/time", f"{text}: are these milliseconds?")
    held = _held(series)
    if held.any():
        where_held = time[np.argmax(held)]
        notes.append(
            f"{where}: {int(held.sum())} samples repeat the one before while the robot moves: dropped in recording, "
            f"the first at {where_held:.3f} s; taken as missing"
        )
        time, series = time[~held], {key: values[~held] for key, values in series.items()}
    missing = np.diff(_slots(time, 1 / rate)) - 1
    if missing.max() * period > LONGEST_GAP_S:
        k = int(np.argmax(missing))
        raise InputError(
            path, f"{where}/time",
            f"{missing[k]} samples are missing after {time[k]:.3f} s; split the run there (gaps up to "
            f"{LONGEST_GAP_S:g} s are bridged)",
        )  # fmt: skip
    count = len(time) + int(missing.sum())
    index = np.concatenate([[0], np.cumsum(1 + missing)])
    nominal = time[0] + index / rate
    if not missing.any() and np.abs(time - nominal).max() <= 0.1 / rate and not _jitters(time, period):
        return time, series, rate, notes
    slope, start = np.polyfit(index, time, 1)
    jitter = float(np.sqrt(np.mean((time - start - slope * index) ** 2)))
    even = time[0] + np.arange(count) * (time[-1] - time[0]) / (count - 1)
    if jitter > 0.5 * period:
        raise InputError(
            path, f"{where}/time", f"stamps jitter by {1e3 * jitter:.2g} ms RMS, half a sample or more: no usable clock"
        )
    if missing.any():
        notes.append(f"{where}: {int(missing.sum())} dropped samples in {int((missing > 0).sum())} gaps, interpolated")
    if jitter > NO_JITTER * period:
        notes.append(f"{where}: time stamps jitter by {1e3 * jitter:.2g} ms RMS; resampled to an even clock")
    rate = (count - 1) / float(time[-1] - time[0])
    return even, {key: resample(time, values, even) for key, values in series.items()}, rate, notes


def _jitters(time: FloatArray, period: float) -> bool:
    """Whether stamps lie off an even clock by more than their last digit, and by what a model would notice."""
    off = float(np.abs(time - _line(time)).max())
    exact = 2 * float(np.spacing(np.abs(time).max()))  # stamps may count from 1970
    digit = next((d for d in DIGITS_S if np.abs(np.round(time / d) * d - time).max() <= max(1e-3 * d, exact)), 0.0)
    return off > max(0.6 * digit, NO_JITTER * period)


def _in_batches(
    time: FloatArray, series: dict[str, FloatArray], rate: float, fresh: np.ndarray, off: float = 0.02
) -> str | None:
    """What to say of samples that are all there, but were stamped when several had come; ``None`` of any other record.

    Samples of one stamp then differ, as many come as the rate says, to ``off``, and stamps stay near an even clock.
    """
    period = float(np.median(np.diff(time[fresh]))) if fresh.sum() > 1 else 0.0
    if fresh.mean() > 0.95 and abs(period * rate - 1) < off:
        return None
    span = float(time[-1] - time[0])
    again = ~fresh & np.all([np.all(np.diff(v, axis=0, prepend=np.nan) == 0, axis=1) for v in series.values()], axis=0)
    if again.sum() > 0.05 * len(time) or not span > 0 or abs((len(time) - 1) / (span * rate) - 1) > off:
        return None
    early = float(np.abs(time - _line(time)).max())
    if early > LONGEST_GAP_S:
        return None
    return (
        f"{int((~fresh).sum())} of {len(time)} time stamps are repeated, and stamps are off by up to "
        f"{1e3 * early:.2g} ms; no sample is missing, and they were put on an even clock"
    )


def _line(time: FloatArray) -> FloatArray:
    """The even clock (nt,) nearest to stamps."""
    index = np.arange(len(time))
    return np.asarray(np.polyval(np.polyfit(index, time, 1), index))


def _slots(time: FloatArray, period: float) -> np.ndarray:
    """Sampling slot (nt,) of each stamp; the phase follows, so that neither jitter nor drift does harm."""
    plain = np.rint((time - time[0]) / period).astype(int)
    if np.abs(time - time[0] - plain * period).max() < 0.25 * period and np.diff(plain).min(initial=1) > 0:
        return plain
    slots = np.zeros(len(time), int)
    phase = time[0]
    for k in range(1, len(time)):
        ahead = max(1, round((time[k] - phase) / period))
        slots[k] = slots[k - 1] + ahead
        phase += ahead * period
        phase += 0.05 * (time[k] - phase)
    return slots


def _held(series: dict[str, FloatArray]) -> np.ndarray:
    """Samples (nt,) that are those before them, in every channel, while the robot moves."""
    if "torque" not in series:
        return np.zeros(len(series["position"]), bool)
    same = np.concatenate(
        [[False], np.all([np.all(np.diff(values, axis=0) == 0, axis=1) for values in series.values()], axis=0)]
    )
    step = np.abs(np.diff(series["position"], axis=0, prepend=series["position"][:1])).max(axis=1)
    window = min(11, len(step))
    pace = np.convolve(step, np.ones(window) / window, "same")  # standing still is not dropping samples
    return same & (pace > 0.2 * np.median(step[step > 0])) if np.any(step > 0) else np.zeros_like(same)


def saturated(run: MotionRun) -> np.ndarray:
    """Where (nt, n) the recorded torque was cut off: at its largest value, unchanged, while the axis moves."""
    if run.torque is None:
        return np.zeros(run.position.shape, bool)
    out = np.zeros(run.torque.shape, bool)
    least = max(3, int(np.ceil(FLAT_S * run.sample_rate_hz)))
    moving = np.abs(np.gradient(run.position, axis=0)) > 0
    for i, torque in enumerate(run.torque.T):
        for limit in (torque.max(), torque.min()):
            at = np.concatenate([[0], (np.abs(torque - limit) <= 1e-9 * abs(limit)).astype(int), [0]])
            starts, ends = np.flatnonzero(np.diff(at) == 1), np.flatnonzero(np.diff(at) == -1)
            for start, end in zip(starts, ends, strict=True):
                if end - start >= least and moving[start:end, i].mean() > 0.5:
                    out[start:end, i] = True
    return out


def refuse_saturated(run: MotionRun, source: str, most: float = 0.05) -> np.ndarray:
    """Where (nt, n) the recorded torque was cut off, of a run that may be used.

    Raises:
        InputError: it is for more than ``most`` of the run.
    """
    cut = saturated(run)
    if (share := cut.any(axis=1).mean()) > most:
        raise InputError(source, f"runs/{run.name}/torque", f"saturated for {share:.0%} of the run")
    return cut


def moves(log: MotionLog) -> bool:
    """Whether some axis moves at all."""
    return max(float(np.ptp(run.position, axis=0).max()) for run in log.runs.values()) >= LEAST_MOTION


def refuse_without_motion(log: MotionLog, source: str) -> None:
    """Raise unless some axis moves.

    Raises:
        InputError: none does.
    """
    if not moves(log):
        raise InputError(source, "runs", f"{NO_MOTION}: record a motion (`twin excite` plans one)")


def check_against(log: MotionLog, robot: "Robot") -> None:
    """Check a log, in joint coordinates, against what the robot can do.

    Positions may leave the described limits by a tenth of their range, as a robot's own may be wider.

    Raises:
        InputError: wrong number of axes; positions far outside the axes' limits, with the likely cause.
    """
    require_axes(log, robot.axis_count)
    for name, run in log.runs.items():
        for i, fits in enumerate(within_limits(run.position, run.sample_rate_hz, robot)):
            if fits:
                continue
            axis, q = robot.axes[i], run.position[:, i]
            low, high, margin, speed = _limits(axis)
            fastest = _fastest(q, run.sample_rate_hz)
            found = f"joint{i + 1} runs from {q.min():.4g} to {q.max():.4g} at up to {fastest:.3g} per s"
            if axis.type == "revolute" and np.abs(q).max() / max(abs(low), abs(high)) > 2:
                expected = "expected rad, these look like degrees"
            elif fastest > 4 * speed and q.min() >= low - margin and q.max() <= high + margin:
                expected = f"at most {speed:.3g} per s was expected: is the clock in s, and are these positions?"
            else:
                expected = f"its limits are {low:.4g} … {high:.4g}, {speed:.3g} per s (rad, m)"
            raise InputError(log.source, f"runs/{name}/position", f"{found}; {expected}")
    if told := torque_slip(log, robot):
        tell(log.source, *told)


def within_limits(position: FloatArray, rate_hz: float, robot: "Robot") -> list[bool]:
    """Of each axis, whether its positions (nt, n), rad (m), stay near its limits and at twice its speed at most.

    Where no limits are described, a revolute axis has four turns either way.
    """
    fits = []
    for q, axis in zip(position.T, robot.axes, strict=True):
        low, high, margin, speed = _limits(axis)
        fits.append(bool(q.min() >= low - margin and q.max() <= high + margin and _fastest(q, rate_hz) <= 2 * speed))
    return fits


def _limits(axis: "Axis") -> tuple[float, float, float, float]:
    """Lower and upper limit of an axis and by how much it may leave them, rad (m), and its largest speed per s."""
    given = axis.limits.position if axis.limits else None
    low, high = given or ((-8 * np.pi, 8 * np.pi) if axis.type == "revolute" else (-np.inf, np.inf))
    speed = (axis.limits.velocity if axis.limits else None) or np.inf
    return low, high, LEAVES * (high - low) if given else 0.0, speed


def _fastest(q: FloatArray, rate_hz: float) -> float:
    """The speed that an axis reaches, but for one sample in a hundred."""
    return float(np.percentile(np.abs(np.diff(q)), 99)) * rate_hz


def torque_slip(log: MotionLog, robot: "Robot", declared: str = "N·m") -> tuple[str, str] | None:
    """Field and text where a torque is far from what the robot's weight asks for, and what unit it looks like.

    Args:
        declared: the unit that the torques were said to be in.
    """
    held = weight_felt(robot)
    for name, run in log.runs.items():
        if run.torque is None or not held.all():
            continue
        largest = np.abs(run.torque).max(axis=0)
        worst = int(np.argmax(largest / held))
        unit, arm = ("N·m", " at arm's length") if robot.axes[worst].type == "revolute" else ("N", "")
        over = max(float(largest[worst] / held[worst]), 1e-12)
        if LEAST_HELD <= over <= MOST_HELD:
            continue
        units = {"N·mm": 1e-3, "N·m": 1.0, "kN·m": 1e3} if arm else {"mN": 1e-3, "N": 1.0, "kN": 1e3}
        size = units.get(declared, 1.0)
        like = min((u for u in units if units[u] != size), key=lambda u: abs(np.log(over * units[u] / size)))
        expected = f"the robot's weight{arm} makes {held[worst]:.3g}; these look like {like}"
        if size != 1.0:
            expected += f", declared {declared}"
        if over < LEAST_HELD:
            expected += ", or like torque at the motor (factor: the gear ratio)"
        return f"{name}: torque", f"reaches {largest[worst]:.4g} {unit}; {expected}"
    return None


def weight_felt(robot: "Robot") -> FloatArray:
    """What the moving links' weight would ask of each axis (n,): N on a slide; N·m on a hinge, at half the reach."""
    weight = STANDARD_GRAVITY * sum(link.inertial[0] for link in robot.links)
    reach = sum(float(np.hypot(axis.a, axis.d)) for axis in robot.axes)
    reach += float(np.linalg.norm(robot.flange.position))
    return np.array([weight * (reach / 2 if axis.type == "revolute" else 1.0) for axis in robot.axes])


def _read_csv(path: Path) -> MotionLog:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(path, "", "expected a text file in UTF-8") from error
    header = [word.strip() for word in lines[0].split(",")] if lines else []
    n = sum(word.startswith("q") for word in header)
    torque = [f"tau{i + 1}" for i in range(n)]
    expected = ["time", *(f"q{i + 1}" for i in range(n))]
    if header not in (expected, expected + torque) or n == 0:
        raise InputError(path, "header", f"expected {HEADER}, found {','.join(header)[:60]!r}")
    try:
        table = np.loadtxt(lines[1:], delimiter=",", ndmin=2) if any(map(str.strip, lines[1:])) else np.empty((0, 1))
    except ValueError as error:
        where, found = _no_row(lines[1:], len(header))
        raise InputError(path, where, f"expected {len(header)} numbers separated by commas, found {found}") from error
    if not len(table):
        raise InputError(path, "", "expected rows of numbers, found none")
    if table.shape[1] != len(header):
        raise InputError(path, "", f"expected {len(header)} columns, found {table.shape[1]}")
    series = {"position": table[:, 1 : n + 1]}
    if len(header) > n + 1:
        series["torque"] = table[:, n + 1 :]
    time = table[:, 0]
    steps = np.diff(time)
    rate = 1 / float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    run, notes = even_run(path, "csv", path.stem, time, series, rate)
    return MotionLog({path.stem: run}, None, str(path), tuple(notes))


def _no_row(lines: Sequence[str], width: int) -> tuple[str, str]:
    """Number and text of the first line below the header that is not ``width`` numbers."""
    for number, line in enumerate(lines, 2):
        try:
            words = [float(word) for word in line.partition("#")[0].split(",")]
        except ValueError:
            words = []
        if line.strip() and len(words) != width:
            return f"line {number}", reprlib.repr(line.strip())
    return "", "others"


def _write_csv(path: Path, log: MotionLog) -> None:
    if len(log.runs) != 1:
        raise InputError(path, "", f"a CSV holds one run, not {len(log.runs)}; write .h5")
    (run,) = log.runs.values()
    n = run.position.shape[1]
    names = ["time", *(f"q{i + 1}" for i in range(n))]
    columns = [run.time[:, None], run.position]
    if run.torque is not None:
        names += [f"tau{i + 1}" for i in range(n)]
        columns.append(run.torque)
    with writing(path) as stream:
        np.savetxt(stream, np.hstack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.12g")
