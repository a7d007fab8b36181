"""Where an axis stops, starts or turns back: rows in which its friction is unknown, as directions of their own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from twin.measure.campaign import FloatArray
from twin.measure.signals import lowpass
from twin.model.torque_base import NOISE_ORDER, Base
from twin.model.torque_signal import Run

RINGING = 16  # rows that the low-pass rings before and after a step


@dataclass(frozen=True)
class Stop:
    """The moment at which an axis stops, starts or turns back, which encoder and sampling hide.

    Attributes:
        span: whitened rows of the joint; ``directions`` (rows, d) orthonormal, in which its friction is unknown.
        share: (d,) of each that is taken off: the prior on it is the joint's friction.
    """

    span: slice
    directions: FloatArray
    share: FloatArray


def stops_in(
    base: Base, whitening: FloatArray, masks: Sequence[np.ndarray], turning: FloatArray, late: float, held: float = 0.1
) -> list[list[Stop]]:
    """Where an axis stops, starts or turns back: directions of the whitened rows, with the prior of its friction.

    Args:
        whitening: (n, order + 1) filters of the joints; ``masks`` (m,) rows of each run that stay after them.
        turning: (n, n) speeds of the drives per speed of the axes; empty where each drive turns its axis alone.
        late: s by which torque is recorded late.
        held: share of dry friction that presliding holds through a standstill: doubt, how the axis crept to it.
    """
    out: list[list[Stop]] = []
    for j, own in enumerate(whitening):
        found: list[Stop] = []
        at = 0
        for run, mask in zip(base.runs, masks, strict=True):
            place = at + np.cumsum(mask) - 1
            events = stop_columns(run, j, held * bool(base.sliding[j]), late)
            if len(turning) and np.count_nonzero(turning[j]) > 1:  # where its drive turns back, too
                state = replace(run.dense, velocity=run.dense.velocity @ turning.T)
                drive = stop_columns(replace(run, dense=state), j, recorded_late=late)
                events = sorted([*events, *drive], key=_begins)
            for near, columns in events:
                inside = mask[near]
                if not inside.any():
                    continue
                W = lfilter(own, [1.0], base.friction[j] * columns, axis=0)[inside]
                first = int(place[near][np.argmax(inside)])
                start, end = first, first + len(W)
                near_by: list[Stop] = [earlier for earlier in found[-6:] if earlier.span.stop > start]
                start = max(first - 2 * RINGING - len(W), min([start, *(earlier.span.start for earlier in near_by)]))
                wide = np.zeros((end - start, W.shape[1]))
                wide[first - start :] = W
                for earlier in near_by:  # what they take off this one too
                    skip = max(0, start - earlier.span.start)
                    part = wide[earlier.span.start + skip - start : earlier.span.stop - start]
                    U = earlier.directions[skip : skip + len(part)]
                    part -= U @ (earlier.share[:, None] * (U.T @ part))
                U, size, _ = np.linalg.svd(wide, full_matrices=False)
                keep = size > 1e-3
                found.append(Stop(slice(start, end), U[:, keep], 1 - 1 / np.sqrt(1 + size[keep] ** 2)))
            at += int(mask.sum())
        out.append(found)
    return out


def stop_columns(
    run: Run, joint: int, held: float = 0.0, recorded_late: float = 0.0, creep_s: float = 0.16, inexact: float = 7e-4
) -> list[tuple[slice, FloatArray]]:
    """Moments at which friction is in doubt, in order: rows, and low-passed torque (rows, b) per unit of friction.

    At a stop or start: boxes of half a row or less, which together leave friction there undetermined. At a reversal:
    two boxes or more. The sign changes between two samples of the log, so the time of the step is uncertain by 1/√12 of
    their distance. An error of the speed adds to this at a slow reversal. Both move the middle of the step, too. An
    axis that nearly stops and goes on may have turned back: while its speed is below that error, within ``creep_s`` of
    the minimum. ``held`` is the share of friction that may be held through a standstill. It adds one box for the time
    between stop and start. ``recorded_late`` (s) shifts all boxes, because the torque is recorded that late.

    Near a stop the encoder hardly counts for ``creep_s``, or for the time that :func:`_creeping` gives, and the axis
    may creep. At a reversal, encoder and low-pass leave a speed error of ``inexact`` times the largest speed.
    """
    step = (len(run.dense.time) - 1) // (len(run.time) - 1)
    dense_hz = run.rate_hz * step
    count = len(run.time)
    stops = stops_of(run, joint)
    rests = dict(zip(stops[::2], stops[1::2], strict=True)) if held else {}
    speed, moving = run.dense.velocity[:, joint], np.ones(len(run.dense.time), bool)
    events = []
    before, after = [0, *stops[1::2]], [*stops[2::2], len(speed)]  # samples between which the axis moves
    for number, (first, last) in enumerate(zip(stops[::2], stops[1::2], strict=True)):
        moves = speed[before[number] : first][::-1], speed[last : after[number]]
        crept = [max(creep_s, _creeping(outside) / dense_hz) for outside in moves]
        events += [(float(first), crept[0], 1.0), (float(last), crept[1], 1.0)]
        before_it, after_it = (max(1, int(np.ceil(late * run.rate_hz))) * step for late in crept)
        moving[max(0, first - before_it) : last + after_it + 1] = False
    error = inexact * float(np.abs(speed).max())
    for at, late in _turns(speed, error):
        if moving[round(at)]:
            late = np.hypot(1 / (np.sqrt(12) * run.sample_hz), min(late / dense_hz, creep_s))
            events.append((at, float(late), float(np.sqrt(2))))  # both boxes: twice friction for so long
    found = []
    shift = recorded_late * dense_hz
    for at, late, size in sorted(events):
        lasting = rests.get(round(at), round(at)) - round(at) if size == 1 else 0
        at += shift
        end = round(at) + lasting
        reach = max(1, int(np.ceil(max(late, creep_s) * run.rate_hz)))
        first, last = round(at) // step - reach - RINGING, end // step + reach + RINGING + NOISE_ORDER
        near = slice(max(0, first), min(count - 1, last))
        if near.start >= near.stop:
            continue
        here, wide = at - near.start * step, max(1, int(np.ceil(2 * late * run.rate_hz)))
        ends = here + np.arange(-wide, wide + 1) * late * dense_hz / wide
        samples = np.arange((near.stop - near.start) * step + 1)[:, None]
        boxes = size * np.diff(_before(ends - samples), axis=1)
        if end > round(at):
            boxes = np.column_stack([boxes, held * ((samples >= here) & (samples < end - near.start * step))])
        columns = lowpass(boxes, dense_hz, *run.bands.fit, every=step)
        found.append((slice(near.start, near.stop + 1), columns))
    return found


def _creeping(outside: FloatArray, most: float = 8.0) -> int:
    """Samples for which an axis moves on after its speed is too low to be told from rest.

    Where the jerk, too, ends at zero, the speed falls with the cube of the time left. So it is ``most`` times as high
    twice as long before the axis rests. None of a motion that is never so fast.

    Args:
        outside: speeds from the edge of the standstill outwards to the next one, rad/s (m/s).
    """
    fast = np.flatnonzero(np.abs(outside) > most * np.abs(outside[:1]))
    return int(fast[0]) if fast.size else 0


def _before(x: FloatArray) -> FloatArray:
    """Share of a unit impulse that lies before x samples of its middle, spread as a line between samples spreads it.

    What lies between two ends so keeps its area and its middle, however short it is.
    """
    x = np.clip(x, -1, 1)
    return np.asarray(0.5 + x - 0.5 * x * np.abs(x))


def _turns(speed: FloatArray, error: float) -> Iterator[tuple[float, float]]:
    """Where an axis turns back, or may have, and how long its speed is within an error of zero there, in samples."""
    k = np.flatnonzero(np.sign(speed[1:]) * np.sign(speed[:-1]) < 0)
    rise = np.abs(speed[k + 1] - speed[k])
    late = error / rise
    edges = np.diff(np.concatenate([[0], np.abs(speed) < error, [0]]).astype(int))
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        within = (k + 1 >= first) & (k < last)
        late[within] = np.maximum(late[within], 0.5 * (last - first))
        if not within.any():
            yield float(first + np.argmin(np.abs(speed[first:last]))), 0.5 * float(last - first)
    yield from zip((k + np.abs(speed[k]) / rise).tolist(), late.tolist(), strict=True)


def _begins(event: tuple[slice, FloatArray]) -> int:
    return int(event[0].start)


def stops_of(run: Run, joint: int, shortest_s: float = 0.12) -> list[int]:
    """Dense samples at which a joint comes to rest or starts to move; a shorter standstill is a reversal."""
    speed = run.dense.velocity[:, joint]
    still = (run.dense.sign(speed) == 0).astype(int)
    edges = np.diff(np.concatenate([[0], still, [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    least = shortest_s * len(speed) / (run.dense.time[-1] - run.dense.time[0])
    found: list[int] = []
    for first, last in zip(starts, ends, strict=True):
        if last - first > least:
            found += [int(first), int(last)]
    return found
