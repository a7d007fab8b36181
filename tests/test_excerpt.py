"""Of a long motion log some minutes are looked at: spread over it, where its axes move, on its own clock."""

import numpy as np

from twin.measure.motion_excerpt import LOG_ENOUGH, OF_A_PIECE, excerpt
from twin.measure.motion_log import MotionLog, MotionRun

HZ = 10.0  # where the low-pass of torque ends


def run(name: str, seconds: float, moving: tuple[float, float], rate: float = 50.0) -> MotionRun:
    """Two axes that rest but for a while; the second moves a hundredth as far."""
    time = 7.0 + np.arange(0, seconds, 1 / rate)
    inside = (time > moving[0]) & (time < moving[1])
    angle = np.cumsum(inside / rate)
    position = np.stack([np.sin(angle), 0.01 * np.cos(angle)], axis=1)
    return MotionRun(name, time, position, rate, torque=position + 1)


def test_a_log_of_some_minutes_is_taken_whole() -> None:
    log = MotionLog({"run": run("run", LOG_ENOUGH / 10, (0, 1e3))})
    same, held, notes = excerpt(log, ["run"], HZ)
    assert same is log
    assert held == ["run"]
    assert not notes


def test_pieces_lie_where_the_axes_move() -> None:
    """Of an hour in which a robot works ten minutes: a piece of each of 12 segments, two of which lie in it."""
    log = MotionLog({"run": run("run", 3600.0, (1500.0, 2100.0))})
    some, held, (note,) = excerpt(log, None, HZ)
    pieces = list(some.runs.values())
    assert len(pieces) == LOG_ENOUGH / OF_A_PIECE
    assert held is None
    assert all(len(p.time) == len(p.torque) == OF_A_PIECE / 10 * 50 for p in pieces)
    assert sum((p.time[0] >= 1499) & (p.time[-1] <= 2101) for p in pieces) == 2
    for piece in pieces:  # on the log's clock, and the samples that were there
        first = np.searchsorted(log.runs["run"].time, piece.time[0])
        np.testing.assert_array_equal(piece.position, log.runs["run"].position[first : first + len(piece.time)])
    assert "240 s of 3600 s" in note


def test_what_is_held_out_stays_so() -> None:
    log = MotionLog({name: run(name, 600.0, (0, 1e3)) for name in ("a", "b")})
    some, held, _ = excerpt(log, ["b"], HZ)
    assert held == [name for name in some.runs if name.startswith("b")]
    assert len(some.runs) == 12
    assert len(held) == 6


def test_of_many_short_runs_some_are_taken_whole() -> None:
    log = MotionLog({f"run{k}": run(f"run{k}", 30.0, (0, 1e3)) for k in range(60)})
    some, _, _ = excerpt(log, None, HZ)
    assert list(some.runs)[::11] == ["run0", "run59"]
    assert len(some.runs) == 12
    assert some.runs["run0"] is log.runs["run0"]


def test_a_run_that_is_held_out_is_among_the_pieces() -> None:
    log = MotionLog({f"run{k}": run(f"run{k}", 30.0, (0, 1e3)) for k in range(60)})
    some, held, _ = excerpt(log, ["run7"], HZ)
    assert held == ["run7"]
    assert "run7" in some.runs
    assert len(some.runs) == 13
