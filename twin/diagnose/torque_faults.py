"""What is wrong with a log itself, before physics, and the log put right.

Positions may be in degrees, torques reversed or exchanged, axes counted the other way round or from another zero. Each
test compares the recorded torque with that of the description. It asks for sign, order and shape alone, so that a
description may be far off. A fault that is found is put right, with a note.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, nnls

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.errors import tell
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun, moves, require_axes, within_limits
from twin.measure.signals import lowpass
from twin.model.regressor import Regressor
from twin.model.torque_rows import joint_run, motion_of_run
from twin.model.torque_signal import bands_of
from twin.physics.motion import Motion, gradual_sign
from twin.robot.description import Robot

ALIKE = 0.9  # correlation of a recorded torque with a described one that is taken for the same
INSTANTS = 500  # instants of a log, which tell signs as well as all
POOR = -2.0  # ln share of variance left at some joint: above, pairs of axes are tried, and a fault is only told
TRIED_AT_ONCE = 7  # axes whose senses are tried in all combinations
QUARTER = np.pi / 2  # rad: zeros of conventions differ by such turns
STATIC = 4  # mass and first moments, of the ten parameters of a body
NNLS_STEPS = 1000  # of least squares without negative sizes, of four columns
SAME = 1e-6  # share of a column below which what is left of it is rounding


def fault() -> float:
    """Fall of ln variance that a fault must bring; an axis outside its limits, refused otherwise, counts as two."""
    return calibration()["fault"]


def sound(log: MotionLog, robot: Robot) -> tuple[MotionLog, list[Note]]:
    """A log in radians, its torque channels in order and its axes counted as the description does; notes on faults.

    A log without torque or motion, which tells nothing of them, is returned as it is.

    Args:
        log: as recorded, in the coordinates of the motors.
        robot: the description.

    Raises:
        InputError: number of axes does not fit.
    """
    require_axes(log, robot.axis_count)
    if any(run.torque is None for run in log.runs.values()) or not moves(log):
        return log, []
    regressor = Regressor(robot)
    found = _put_right(log, regressor)
    if not _fits(log, robot):
        turned = replace(log, runs={name: _in_radians(run, robot) for name, run in log.runs.items()})
        other = _put_right(turned, regressor)
        if other.worth + fault() < found.worth:
            text = "positions are in degrees: as radians they leave the axes' limits; they were taken as degrees"
            found = replace(other, notes=[Note(text, "unit", "fail"), *other.notes])
    return found.log, found.notes


def told_sound(log: MotionLog, robot: Robot) -> MotionLog:
    """A log as :func:`sound` returns it; each fault is told as a warning."""
    log, notes = sound(log, robot)
    for note in notes:
        tell(log.source, "runs", note)
    return log


@dataclass(frozen=True)
class _Right:
    """A log put right, what its axes' count is worth, and notes."""

    log: MotionLog
    worth: float
    notes: list[Note] = field(default_factory=list)


def _put_right(log: MotionLog, regressor: Regressor) -> _Right:
    """A log with its torque in order and its axes as described."""
    few = _few(log, regressor)
    first, _ = _channels(few)
    few = [replace(run, torque=run.torque[:, first]) for run in few]
    count = _counted(few)
    axes = _told_axes(count, regressor.robot)
    sense, zero = np.ones_like(count.sense), np.zeros_like(count.zero)
    if not count.poor:
        sense, zero = count.sense, count.zero
    second, sign = _channels([run.counted(sense, zero) for run in few])  # weight tells more where the axes are right
    order, sign = first[second], sign * sense[second] * sense
    channels = _told(order, sign)
    notes = [*(Note(text, kind, "fail") for kind, text in channels), *axes]
    if not channels and (count.poor or not axes):
        return _Right(log, count.worth, notes)
    runs = {name: _turned(run, sense, zero, order, sign) for name, run in log.runs.items()}
    return _Right(replace(log, runs=runs), count.worth, notes)


def _turned(
    run: MotionRun, sense: FloatArray, zero: FloatArray, order: NDArray[np.intp], sign: FloatArray
) -> MotionRun:
    """A run whose torque has another order and sign, and whose axes another sense and zero."""
    assert run.torque is not None
    changed: dict[str, Any] = {"position": sense * run.position + zero, "torque": sense * sign * run.torque[:, order]}
    for name, shift in (("velocity", 0.0), ("acceleration", 0.0), ("link_position", zero)):
        if (values := getattr(run, name)) is not None:
            changed[name] = sense * values + shift
    return replace(run, **changed)


def _fits(log: MotionLog, robot: Robot) -> bool:
    """Whether positions lie within the limits of the axes."""
    return all(
        all(within_limits(joint_run(robot, run).position, run.sample_rate_hz, robot)) for run in log.runs.values()
    )


def _in_radians(run: MotionRun, robot: Robot) -> MotionRun:
    """A run from degrees to radians; what slides stays."""
    unit = np.where([axis.type == "revolute" for axis in robot.axes], np.pi / 180, 1.0)
    names = ("position", "velocity", "acceleration", "link_position")
    return replace(
        run, **{n: x * unit for n in names if (x := getattr(run, n)) is not None and x.shape[1] == len(unit)}
    )


@dataclass(frozen=True)
class _Few:
    """Some instants of a run, low-passed: its motion and torque (m, n) as the drives have them."""

    motion: Motion
    torque: FloatArray
    regressor: Regressor

    @cached_property
    def bodies(self) -> FloatArray:
        """Torque (m, n, 11 n) per unit of links' and rotors' parameters."""
        return self.regressor.bodies(self.motion)

    @cached_property
    def described(self) -> FloatArray:
        """Torque (m, n) of the description."""
        values = self.regressor.described
        torque = np.asarray(self.bodies @ values[: self.bodies.shape[2]])
        for column, axis, law in self.regressor.laws(self.motion):
            torque[:, axis] += values[column] * law
        return torque if self.regressor.complete else torque + self.regressor.known_torque(self.motion)

    def own(self, joint: int) -> FloatArray:
        """What a joint's torque is made of (m, 4), each of any size: the described one, friction, inertia."""
        speed = self.motion.velocity[:, joint]
        columns = [self.described[:, joint], gradual_sign(speed), speed, self.motion.acceleration[:, joint]]
        return np.stack(columns, axis=1)

    def loads(self, joint: int, *links: int) -> FloatArray:
        """A constant, and torque of a joint per unit of mass and first moments of links (m, 1 + 4 k)."""
        columns = [10 * link + k for link in dict.fromkeys(links) for k in range(STATIC)]
        return np.column_stack([np.ones(len(self.torque)), self.bodies[:, joint, columns]])

    def counted(self, sense: FloatArray, zero: FloatArray) -> "_Few":
        """The same instants with axes that have another sense and zero."""
        m = self.motion
        turned = Motion(
            m.time, sense * m.position + zero, sense * m.velocity, sense * m.acceleration,
            coupling=m.coupling, drives=m.drives,
        )  # fmt: skip
        return _Few(turned, sense * self.torque, self.regressor)


def _few(log: MotionLog, regressor: Regressor) -> list[_Few]:
    """Instants of every run of a log, spread evenly."""
    robot, bands, found = regressor.robot, bands_of(log), []
    step = max(1, sum(len(run.time) for run in log.runs.values()) // INSTANTS)
    for recorded in log.runs.values():
        run, rate = joint_run(robot, recorded), recorded.sample_rate_hz
        assert run.torque is not None
        fit = bands.within(rate).fit
        ends = min(int(3 / fit[1] * rate), (len(run.time) - 1) // 3)
        at = slice(ends, len(run.time) - ends, step)
        whole = motion_of_run(run, bands).coupled(robot).of_drives
        motion = Motion(
            whole.time[at], whole.position[at], whole.velocity[at], whole.acceleration[at],
            coupling=whole.coupling, drives=whole.drives,
        )  # fmt: skip
        found.append(_Few(motion, motion.seen(lowpass(run.torque, rate, *fit)[at]), regressor))
    return found


def _channels(few: Sequence[_Few]) -> tuple[NDArray[np.intp], FloatArray]:
    """Which recorded torque (n,) is that of each joint, and its sign (n,)."""
    recorded, described = (
        np.concatenate([values - values.mean(axis=0) for values in some])
        for some in ([run.torque for run in few], [run.described for run in few])
    )
    left = _left(few, recorded)
    order, sign = np.arange(len(left)), np.ones(len(left))
    taken, of = linear_sum_assignment(left)
    order[of] = taken
    moved = np.flatnonzero(order != np.arange(len(order)))
    if left[moved, moved].sum() - left[order[moved], moved].sum() < fault() * len(moved):
        order = np.arange(len(order))
    size = np.maximum(np.linalg.norm(recorded, axis=0)[:, None] * np.linalg.norm(described, axis=0), 1e-300)
    alike = recorded.T @ described / size
    for j in range(len(order)):
        gain = _gain_of_reversal(few, int(order[j]), j)
        if gain > fault() or (alike[order[j], j] < -ALIKE and gain > -fault()):
            sign[j] = -1.0
    return order, sign


def _left(few: Sequence[_Few], recorded: FloatArray) -> FloatArray:
    """ln share (n, n) of a recorded torque's variance that each joint's own motion leaves: (recorded, joint).

    By its described torque, dry and viscous friction and inertia, each of any size: a description may be far off.
    """
    out = np.empty((recorded.shape[1],) * 2)
    for j in range(len(out)):
        X = np.concatenate([run.own(j) for run in few])
        X = _of_unit_length(X - X.mean(axis=0))
        rest = recorded - X @ np.linalg.lstsq(X, recorded, rcond=None)[0]
        out[:, j] = np.log(
            np.maximum(np.sum(rest**2, axis=0), 1e-300) / np.maximum(np.sum(recorded**2, axis=0), 1e-300)
        )
    return out


def _gain_of_reversal(few: Sequence[_Few], channel: int, joint: int) -> float:
    """Fall of ln variance that a joint's motion leaves of a recorded torque when its sign is turned round.

    Friction takes power and no inertia is negative, whatever the description says. A weight at the joint's own or at
    the last link may pull either way: a payload that nobody described.
    """
    X, y = _with_loads(few, channel, joint, joint)
    as_is, turned = (_rest(X, sign * y) for sign in (1, -1))
    return float(2 * np.log(as_is / turned))


def _rest(X: FloatArray, y: FloatArray) -> float:
    """Norm of what columns (m, k) without negative sizes leave of y (m,); of an axis at rest there may be none."""
    left = nnls(X, y, maxiter=NNLS_STEPS)[1] if X.shape[1] else np.linalg.norm(y)
    return max(float(left), 1e-300)


def _with_loads(few: Sequence[_Few], channel: int, joint: int, *links: int) -> tuple[FloatArray, FloatArray]:
    """Columns (m, k) of a joint's own torque, and a recorded one (m,), less what loads at links may make of them.

    Any load at the last link is among them.
    """
    free = np.concatenate([run.loads(joint, *links, run.torque.shape[1] - 1) for run in few])
    taken = scipy.linalg.orth(_of_unit_length(free), rcond=SAME)
    X = _of_unit_length(np.concatenate([run.own(joint) for run in few]))
    y = np.concatenate([run.torque[:, channel] for run in few])
    X, y = (part - taken @ (taken.T @ part) for part in (X, y))
    return X[:, np.linalg.norm(X, axis=0) > SAME], y


def _of_unit_length(columns: FloatArray) -> FloatArray:
    """Columns (m, k) of norm one; empty ones stay zero."""
    return columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)


@dataclass(frozen=True)
class _Count:
    """How axes are counted: a sense (n,), and a zero (n,), rad; and what that is worth, the less the better.

    That is ln variance left, and as much per axis that is changed, or outside its limits, as this must bring.
    """

    sense: FloatArray
    zero: FloatArray
    worth: float
    poor: bool


def _counted(few: Sequence[_Few]) -> _Count:
    """How axes are counted.

    A torque is reversed with its axis: friction takes power either way. What tells is weight, and inertia between axes.
    """
    n = few[0].torque.shape[1]
    as_is = _count(few, np.ones(n), np.zeros(n))
    best = _best(few, as_is, _one_by_one(few, as_is))
    if best is not as_is and n <= TRIED_AT_ONCE:
        best = _best(few, best, ((np.array(sense), as_is.zero) for sense in product((1.0, -1.0), repeat=n)))
    if best.poor:  # two zeros may make up for one another in part
        best = _best(few, best, _two_by_two(few, best))
    while (again := _best(few, best, _one_by_one(few, best))) is not best:
        best = again
    return best


def _best(few: Sequence[_Few], so_far: _Count, ways: Iterator[tuple[FloatArray, FloatArray]]) -> _Count:
    """The best of some ways, or the one so far."""
    return min((so_far, *(_count(few, *way) for way in ways)), key=lambda count: count.worth)


def _count(few: Sequence[_Few], sense: FloatArray, zero: FloatArray) -> _Count:
    turned, robot = [run.counted(sense, zero) for run in few], few[0].regressor.robot
    inside = np.all([within_limits(run.motion.of_axes.position, 0.0, robot) for run in turned], axis=0)
    changed, left = np.sum((sense < 0) | (zero != 0)), _of_each(turned)
    worth = float(left.sum() + fault() * (changed + 2 * np.sum(~inside)))
    return _Count(sense, zero, worth, bool(left.max() > POOR))


def _one_by_one(few: Sequence[_Few], count: _Count) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Every other sense and zero of each axis."""
    for j in range(len(count.sense)):
        yield from _others(few, j, count.sense, count.zero)


def _two_by_two(few: Sequence[_Few], count: _Count) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Every other sense and zero of two axes that follow each other."""
    for j in range(len(count.sense) - 1):
        for sense, zero in _others(few, j, count.sense, count.zero):
            yield from _others(few, j + 1, sense, zero)


def _others(
    few: Sequence[_Few], joint: int, sense: FloatArray, zero: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Every other sense and zero of an axis; what slides has its zero anywhere, so that is not asked."""
    slides = few[0].regressor.robot.axes[joint].type == "prismatic"
    for turns, flip in product(range(1 if slides else 4), (1.0, -1.0)):
        if turns or flip < 0:
            other, shifted = sense.copy(), zero.copy()
            other[joint] *= flip
            shifted[joint] = _nearest_turn(few, joint, other[joint], flip * zero[joint] + turns * QUARTER)
            yield other, shifted


def _nearest_turn(few: Sequence[_Few], joint: int, sense: float, zero: float) -> float:
    """A zero of an axis, whole turns apart, that has its positions nearest to the middle of its limits, rad."""
    axis = few[0].regressor.robot.axes[joint]
    limits = axis.limits.position if axis.limits else None
    q = sense * np.concatenate([run.motion.position[:, joint] for run in few])
    turns = np.round((zero + 0.5 * (q.min() + q.max()) - np.mean(limits or (0.0, 0.0))) / (2 * np.pi))
    return float(zero - 2 * np.pi * turns) if axis.type == "revolute" else zero


def _of_each(few: Sequence[_Few]) -> FloatArray:
    """ln share (n,) of the variance of each joint's torque that its own motion leaves, and more if it is reversed."""
    left = np.empty(few[0].torque.shape[1])
    for j in range(len(left)):
        X, y = _with_loads(few, j, j)
        whole = np.concatenate([run.torque[:, j] for run in few])
        size = max(float(np.linalg.norm(whole - whole.mean())), 1e-300)
        as_is, turned = (2 * np.log(_rest(X, sign * y) / size) for sign in (1, -1))
        left[j] = min(as_is, turned + fault())
    return left


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


def _told_axes(count: _Count, robot: Robot) -> list[Note]:
    """What is told of axes that are counted otherwise than the description does."""
    found, names = [], robot.joint_names
    if turned := [names[j] for j in np.flatnonzero(count.sense < 0)]:
        seem = f"{', '.join(turned)}: position and torque {{}} counted in the opposite sense of the description"
        found.append(("axis_reversed", seem, "they were turned round"))
    if off := [f"{names[j]} by {np.rad2deg(count.zero[j]):+.0f}°" for j in np.flatnonzero(count.zero)]:
        seem = f"positions {{}} counted from another zero than that of the description: {', '.join(off)}"
        found.append(("axis_zero", seem, "this was added to them"))
    if not count.poor:
        return [Note(f"{seem.format('are')}; {done}", kind, "fail") for kind, seem, done in found]
    unsure = "no count explains the torque well enough to put that right. Check the sense and the zero of each axis"
    return [Note(f"{seem.format('seem to be')}; {unsure}", kind, "warning") for kind, seem, _ in found]
