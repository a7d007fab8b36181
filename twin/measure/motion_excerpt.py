"""Of a long motion log the pieces that are fitted: spread evenly over it, where its axes move most."""

from dataclasses import fields, replace

import numpy as np

from twin.measure.motion_log import MotionLog, MotionRun

# Seconds times hertz of the low-pass, six thousand rows of a joint: a little more than logs of the proof.
LOG_ENOUGH = 2400.0
OF_A_PIECE = 200.0  # the same of a piece


def excerpt(log: MotionLog, hold_out: list[str] | None, hz: float) -> tuple[MotionLog, list[str] | None, list[str]]:
    """A log of no more than ``LOG_ENOUGH``, the names in it of what is held out, and a sentence; a short log as it is.

    ``hz`` is where the low-pass of its torque ends.

    A search takes time in proportion to the log, and what it finds in some minutes of motion an hour tells no better.
    Every piece keeps its time, so that what drifts over the log still does.
    """
    seconds = _seconds(log)
    if seconds * hz <= LOG_ENOUGH:
        return log, hold_out, []
    length, count = OF_A_PIECE / hz, LOG_ENOUGH / OF_A_PIECE
    usual = np.sqrt(np.mean(np.concatenate([_speed(run) ** 2 for run in log.runs.values()]), axis=0))
    pieces: dict[str, tuple[str, MotionRun]] = {}
    for name, run in log.runs.items():
        own = float(run.time[-1] - run.time[0])
        if own < 2 * length:
            pieces[name] = name, run
            continue
        for k, segment in enumerate(np.array_split(np.arange(len(run.time)), max(1, round(count * own / seconds)))):
            piece = f"{name} piece {k + 1}"
            pieces[piece] = name, _where_it_moves(run, segment, length, usual, piece)
    held = [name for name, (run, _) in pieces.items() if run in (hold_out or [])]
    kept: set[str] = set()
    for group in (held, [name for name in pieces if name not in held]):  # neither part is left without a piece
        share = min(len(group), max(1, round(count * len(group) / len(pieces))))
        kept |= {group[k] for k in np.linspace(0, len(group) - 1, share).astype(int)} if group else set()
    some = replace(log, runs={name: piece for name, (_, piece) in pieces.items() if name in kept})
    held = [name for name in held if name in kept]
    text = (
        f"{_seconds(some):.0f} s of {seconds:.0f} s are looked at, in {len(some.runs)} pieces spread over the log, "
        "where the axes move most"
    )
    return some, held or None, [text]


def _seconds(log: MotionLog) -> float:
    return sum(float(run.time[-1] - run.time[0]) for run in log.runs.values())


def _speed(run: MotionRun) -> np.ndarray:
    """How far the axes move from sample to sample (nt - 1, n), in rad (m) per second."""
    return np.asarray(np.diff(run.position, axis=0) * run.sample_rate_hz)


def _where_it_moves(run: MotionRun, segment: np.ndarray, length: float, usual: np.ndarray, name: str) -> MotionRun:
    """The piece of a segment, so many seconds long, in which the axes are fastest for what is usual of each."""
    samples = min(len(segment), max(2, round(length * run.sample_rate_hz)))
    motion = np.abs(_speed(run)[segment[0] : segment[-1]]) / np.maximum(usual, 1e-12)
    moved = np.concatenate([[0.0], np.cumsum(np.sqrt(motion).sum(axis=1))])  # all axes at once, not one very fast
    first = segment[0] + int(np.argmax(moved[samples - 1 :] - moved[: len(moved) - samples + 1]))
    at = slice(first, first + samples)
    cut = {f.name: getattr(run, f.name)[at] for f in fields(run) if isinstance(getattr(run, f.name), np.ndarray)}
    return replace(run, name=name, **cut)
