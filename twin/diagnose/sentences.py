"""One sentence a person can check by eye: which curve, in which posture, is off by how much without what was found."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.diagnose.records import STAGES, FrfRecord, LogRecord, ModalRecord, Record, pooled_floor
from twin.measure.campaign import FloatArray
from twin.result import listed

PROMINENCE = np.log(2.0)  # of a peak above the valleys beside it
SHOULDER = np.log(1.25)  # of a measured peak that a model's may belong to, though it is not one to be told
SAME_PEAK = np.log(1.4)  # between a measured peak and the model's
NOWHERE = 0.1  # what a peak counts that the model does not have near: as if it were off by 10 %
SHIFT = 0.004  # of a peak's frequency: less is told by its height
BETWEEN = 0.25  # lines, to which a peak between them is interpolated
LOUD_PEAK = 0.005  # of the loudest line: less is hard to see
HEIGHT = np.log(1.05)


@dataclass(frozen=True)
class Spot:
    """Where before and after differ most for the eye.

    Attributes:
        channel: flat index of the pair; ``line`` of the measured peak.
        measured, before, after: frequency (Hz) and height of the peak; NaN where the model has none near.
        by_height: the height tells more than the frequency; ``score`` how plainly it tells.
    """

    record: FrfRecord
    channel: int
    line: int
    measured: tuple[float, float]
    before: tuple[float, float]
    after: tuple[float, float]
    by_height: bool
    score: float

    @property
    def pair(self) -> str:
        """``21Z+/4Y+``."""
        return self.record.pairs[self.channel]


def best_spot(records: Sequence[FrfRecord], channel: int | None = None) -> Spot | None:
    """The peak whose place or height the answer puts right most plainly, ``None`` where nothing moves visibly."""
    found: list[Spot] = []
    for record in records:
        loudest = float(np.abs(np.where(np.isfinite(record.variance), record.measured, 0)).max())
        for pair in range(len(record.pairs)) if channel is None else [channel]:
            found += _spots(record, pair, loudest)
    return max(found, key=lambda spot: spot.score, default=None)


def _spots(record: FrfRecord, pair: int, loudest: float) -> list[Spot]:
    """Candidates on one channel pair: every prominent measured peak; loud ones tell more."""
    flat = record.channel(pair)
    if not np.isfinite(record.variance[flat]).any():
        return []
    measured, before, after = (
        np.abs(H[flat]) for H in (record.measured, record.predicted["before"], record.predicted["after"])
    )
    peaks = _peaks(record.frequency, measured)
    if not peaks:
        return []
    models = [_peaks(record.frequency, H) for H in (before, after)]
    places = [frequency for _, _, frequency in _peaks(record.frequency, measured, SHOULDER)]
    found = []
    for line, height, frequency in peaks:
        noise = np.sqrt(2 * record.variance[flat][line])
        if height < LOUD_PEAK * loudest or height < 5 * noise:
            continue
        (f0, h0), (f1, h1) = (_own(model, frequency, places) for model in models)
        if not np.isfinite(f1):
            continue
        weight = np.log1p(10 * height / loudest)
        off = [abs(np.log(f / frequency)) if np.isfinite(f) else NOWHERE for f in (f0, f1)]
        spacing = float(record.frequency[1] - record.frequency[0]) / frequency
        gain = off[0] - off[1] - BETWEEN * spacing
        heights = [min(abs(np.log(h / height)), 1.0) if np.isfinite(h) else 1.0 for h in (h0, h1)]
        taller = 0.1 * (heights[0] - heights[1]) if np.isfinite(f0) else 0.0
        by_height = off[0] < max(SHIFT, 2 * BETWEEN * spacing) and heights[0] > HEIGHT
        score = weight * (taller if by_height else gain)
        if score > 0:
            found.append(Spot(record, pair, line, (frequency, height), (f0, h0), (f1, h1), by_height, float(score)))
    return found


def _peaks(frequency: FloatArray, H: FloatArray, prominence: float = PROMINENCE) -> list[tuple[int, float, float]]:
    """Line, height and interpolated frequency of the prominent peaks of |H|."""
    level = np.log(np.maximum(H, 1e-300))
    found = []
    for k in _summits(level.tolist(), prominence):
        left, middle, right = level[k - 1 : k + 2]
        bend = left - 2 * middle + right
        shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
        step = frequency[k + 1] - frequency[k]
        found.append((k, float(H[k]), float(frequency[k] + shift * step)))
    return found


def _summits(level: Sequence[float], prominence: float = PROMINENCE) -> list[int]:
    """Where a curve is highest between two valleys of which both lie ``prominence`` lower.

    One pass; ``scipy.signal.find_peaks`` says the same, but importing it takes a third of a second.
    """
    found, rising, at, extreme = [], False, 0, level[0]
    for k, value in enumerate(level):
        if (value > extreme) if rising else (value < extreme):
            at, extreme = k, value
        elif abs(value - extreme) >= prominence:
            if rising:
                found.append(at)
            rising, at, extreme = not rising, k, value
    return found


def _own(model: Sequence[tuple[int, float, float]], frequency: float, places: Sequence[float]) -> tuple[float, float]:
    """Frequency and height of the model's peak nearest to a measured one; NaN where it is another measured peak's."""
    near = [(abs(np.log(f / frequency)), f, height) for _, height, f in model]
    distance, f, height = min(near, default=(np.inf, np.nan, np.nan))
    if distance < SAME_PEAK and all(distance <= abs(np.log(f / place)) for place in places):
        return f, height
    return float("nan"), float("nan")


def sentence(
    name: str, records: Sequence[Record], errors: dict[str, Any], held_out: Sequence[str], joint: int | None = None,
    in_turn: bool = False,
) -> str:  # fmt: skip
    """The evidence for an answer.

    Args:
        name: as ``backlash at joint2.z``.
        records: beside the models before and after.
        errors: ``before`` and ``after`` → ``train``, ``held_out``; ``noise_floor``, ``None`` where not known.
        held_out: names of postures or runs not used.
        joint: zero-based, on whose torque it acts; the one that is put right most by default.
        in_turn: each of them was left out in turn.
    """
    told = ""
    frfs = [r for r in records if isinstance(r, FrfRecord)]
    if frfs:
        told = _frf_sentence(name, frfs)
    elif logs := [r for r in records if isinstance(r, LogRecord)]:
        told = _log_sentence(name, logs, joint)
    elif tables := [r for r in records if isinstance(r, ModalRecord)]:
        told = _modal_sentence(name, tables)
    judged = [r for r in records if r.held_out] or records
    floor = None if errors["noise_floor"] is None else pooled_floor(judged)
    return f"{told} {fall(errors, held_out, floor, in_turn)}".strip()


def fall(errors: dict[str, Any], held_out: Sequence[str], floor: float | None = None, in_turn: bool = False) -> str:
    """How the error falls from before to after; ``floor``: what noise alone gives on what is told last."""
    before, after = errors["before"], errors["after"]
    held = ""
    if before["held_out"] is not None:
        was, now = percents(before["held_out"], after["held_out"], 2)
        unused = "each left out in turn" if in_turn else "not used"
        held = f", and on {listed(held_out)}, {unused}, {was} → {now}"
    noise = "" if floor is None else f" (noise alone {floor:.2%})"
    was, now = percents(before["train"], after["train"], 2)
    verb = "falls" if after["train"] < before["train"] else "does not fall:"
    return f"The error on what was used {verb} {was} → {now}{held}{noise}."


def percents(one: float, other: float, digits: int) -> tuple[str, str]:
    """Two shares in percent, with up to two digits more where they would read the same."""
    tried = [(f"{one:.{digits + more}%}", f"{other:.{digits + more}%}") for more in range(3)]
    return next((told for told in tried if told[0] != told[1]), tried[0])


def off_by(value: float, reference: float) -> str:
    """``8 % too high``."""
    ratio = value / reference - 1
    size = abs(100 * ratio)
    digits = 0 if size >= 3 else 1 if size >= 0.3 else 2
    return f"{size:.{digits}f} % {'too high' if ratio > 0 else 'too low'}"


def _frf_sentence(name: str, records: Sequence[FrfRecord]) -> str:
    spot = best_spot(records)
    if spot is None:
        return _residual_sentence(name, records)
    record = spot.record
    frequency, height = spot.measured
    mode = _mode_number(record, frequency)
    what = f"the peak of {spot.pair} at {frequency:.2f} Hz"
    if mode is not None:
        what = f"mode {mode} at {frequency:.2f} Hz (peak of {spot.pair})"
    peak = f"{what} in '{record.name}'{', not used,' if record.held_out else ''}"
    if not np.isfinite(spot.before[0]):
        return (
            f"Without {name} the refitted model has no peak of its own for {peak.rstrip(',')}; "
            f"with it, at {spot.after[0]:.2f} Hz."
        )
    if spot.by_height:
        return (
            f"Without {name} {peak} comes out {off_by(spot.before[1], height)} in amplitude in the refitted model; "
            f"with it {off_by(spot.after[1], height)}."
        )
    return (
        f"Without {name} {peak} comes out {off_by(spot.before[0], frequency)} in the refitted model, "
        f"at {spot.before[0]:.2f} Hz; with it at {spot.after[0]:.2f} Hz."
    )


def _mode_number(record: FrfRecord, frequency: float) -> int | None:
    """Number of the new model's mode at a measured peak, from one."""
    modes = record.modes_hz.get("after")
    if modes is None or not len(modes):
        return None
    k = int(np.argmin(np.abs(np.log(modes / frequency))))
    return k + 1 if abs(np.log(modes[k] / frequency)) < 0.05 else None


def _residual_sentence(name: str, records: Sequence[FrfRecord]) -> str:
    """Where no peak moves visibly: the channel and band in which the residual falls most."""
    best: tuple[float, str] | None = None
    for record in records:
        size = np.abs(record.measured)
        seen = (size > 5 * np.sqrt(record.variance)) & (size > LOUD_PEAK * size[np.isfinite(record.variance)].max())
        weight = size**2 / record.variance
        fallen = np.where(seen, record.energy("before") - record.energy("after"), 0.0)
        edges = np.array_split(np.arange(len(record.frequency)), 6)
        total = np.array([fallen[lines].sum(axis=0).ravel() for lines in edges])
        b, c = np.unravel_index(int(np.argmax(total)), total.shape)
        if total[b, c] <= 0:
            continue
        lines, (_, i, j) = edges[b], record.channel(int(c))
        told = lines[seen[lines, i, j]]  # in their weights, as what falls was summed
        ratio = [np.sqrt(record.energy(stage)[told, i, j].sum() / weight[told, i, j].sum()) for stage in STAGES[1:]]
        low, high = record.frequency[lines[0]], record.frequency[lines[-1]]
        without, with_it = percents(ratio[0], ratio[1], 1)
        text = (
            f"Without {name} the refitted model misses {record.pairs[int(c)]} in '{record.name}' at "
            f"{low:.1f}–{high:.1f} Hz by {without} of its amplitude, with it by {with_it}."
        )
        if best is None or total[b, c] > best[0]:
            best = float(total[b, c]), text
    return best[1] if best else ""


def _log_sentence(name: str, records: Sequence[LogRecord], only: int | None = None) -> str:
    """The joint (or ``only`` this) and run whose residual torque falls most, relative to its torque."""
    best: tuple[float, str] | None = None
    for record in records:
        rms = [
            np.sqrt(np.mean((record.measured - record.predicted[stage])[record.valid] ** 2, axis=0))
            for stage in ("before", "after")
        ]
        size = np.sqrt(np.mean(record.measured[record.valid] ** 2, axis=0))
        joint = int(np.argmax((rms[0] - rms[1]) / size)) if only is None else only
        unit = f" {record.units[joint]}" if record.units else ""
        text = (
            f"Without {name} the torque of joint{joint + 1} in run '{record.name}'"
            f"{', not used,' if record.held_out else ''} is missed by {rms[0][joint]:.3g}{unit} RMS "
            f"({rms[0][joint] / size[joint]:.1%}), with it by {rms[1][joint]:.3g}{unit} "
            f"({rms[1][joint] / size[joint]:.1%})."
        )
        score = float(((rms[0] - rms[1]) / size)[joint])
        if best is None or score > best[0]:
            best = score, text
    return best[1] if best else ""


def _modal_sentence(name: str, records: Sequence[ModalRecord]) -> str:
    """The mode whose frequency the answer puts right most."""
    best: tuple[float, str] | None = None
    for record in records:
        f, before, after = (x[:, 0] for x in (record.measured, record.predicted["before"], record.predicted["after"]))
        gain = np.abs(before / f - 1) - np.abs(after / f - 1)
        if not np.isfinite(gain).any():
            continue
        k = int(np.nanargmax(gain))
        text = (
            f"Without {name} mode {k + 1} at {f[k]:.2f} Hz in '{record.name}'"
            f"{', not used,' if record.held_out else ''} comes out {off_by(before[k], f[k])} in the "
            f"refitted model, with it {off_by(after[k], f[k])}."
        )
        if best is None or gain[k] > best[0]:
            best = float(gain[k]), text
    return best[1] if best else ""
