"""The torque of entries on a run, as the model and the recording have it: laws, and the chain that records them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from twin.measure.campaign import FloatArray
from twin.measure.signals import lowpass
from twin.model.regressor import weight_vector
from twin.model.torque_signal import Run
from twin.physics import CATALOGUE
from twin.physics.chain import MeasurementChain
from twin.physics.effect import Effect, Values, axis_of
from twin.robot.description import Entry

TURNED = 14.0  # travels after which a bristle has turned round, but for 1e-6
KEPT = 12  # ratios of coupled drives whose presliding is kept: the slopes at one ratio need it at one more
USUAL_SHARE = 0.1  # of a joint's RMS torque: what a missing effect would ordinarily add


@dataclass
class State:
    """What laws that act on other torques need of one run, as the model has it.

    Attributes:
        torque: (m, n) of the joints at the rows, before it is recorded.
        load, friction: (nt, n) on the dense clock.
        turning: (m, n) of the torque, how ordinary friction turns round; in proportion to friction as it was recorded.
        sliding: (n,) N·m (N), dry friction that does so.
        excess: (n,) N·m (N), dry friction of the model less that, of which no law that varies with load or time knows.
        uneven: (m, n) the same of what friction has alike in both directions, per unit: at rest it holds, too.
        travels: (n, t) rad or m, over which bristles of a joint's drive turn round; ``shares`` (n, t) of dry friction.
        both: by drive, axis and ratio, how that turns round (m,) where the two meet, per N·m of the drive's;
            ``at_once``: it does so at once.
        late: by drive, how dry friction turns round (nt,) on the dense clock, less the sign, per N·m.
        gain, delay, lag: of the recording: torque constants (n,), or (m, n) of motors that warm; lateness s; time
            constant of a low-pass of first order, s.
    """

    torque: FloatArray
    load: FloatArray
    friction: FloatArray
    turning: FloatArray = field(default_factory=lambda: np.zeros(1))
    sliding: FloatArray = field(default_factory=lambda: np.zeros(1))
    excess: FloatArray = field(default_factory=lambda: np.zeros(1))
    uneven: FloatArray = field(default_factory=lambda: np.zeros(1))
    travels: FloatArray = field(default_factory=lambda: np.ones((1, 0)))
    both: dict[tuple[int, int, float], FloatArray] = field(default_factory=dict)
    at_once: bool = False
    late: dict[int, FloatArray] = field(default_factory=dict)
    shares: FloatArray = field(default_factory=lambda: np.zeros((1, 0)))
    gain: FloatArray = field(default_factory=lambda: np.ones(1))
    delay: float = 0.0
    lag: float = 0.0

    def recorded(self, run: Run, torque: FloatArray | None = None) -> FloatArray:
        """The torque (m, n), or another, as it is recorded."""
        if torque is None:
            torque = self.gain * (self.torque - self.turning) + self.turning
        elif np.any(self.gain != 1):
            torque = self.gain * torque
        return np.asarray(delayed(torque, run, self.delay, self.lag) if self.delay or self.lag else torque)


def add(run: Run, state: State, entry: Entry) -> None:
    """Let laws that act on other torques, and the recording, see an entry as part of the model."""
    effect = CATALOGUE[entry.effect]
    if effect.records_torque:
        state.gain, state.delay, state.lag = _recording(run, state, entry, entry.values)
        return
    extra = _law_torque(run, state, entry, entry.values)
    if _varies(effect):
        state.excess[axis_of(entry.site)] = 0.0
    if effect.weight(entry.values) is not None:
        state.load[...] += on_dense(run, extra)
    elif effect.role != "drive":
        part = state.load if effect.role == "load" else state.friction
        motion = replace(run.dense, load=state.load, friction=state.friction)
        for axis, torque in effect.felt(motion, entry.site, entry.values).items():
            part[:, axis] += torque
    state.torque[...] += extra


def model_torque(run: Run, state: State, entries: Sequence[Entry]) -> FloatArray:
    """What entries add to the recorded torque (m, n) together; the state has them afterwards."""
    before = state.recorded(run)
    for entry in sorted(entries, key=_depth):
        add(run, state, entry)
    return state.recorded(run) - before


def _depth(entry: Entry) -> int:
    """Laws that are made of others come after them."""
    effect = CATALOGUE[entry.effect]
    return ("load", "drive", "friction").index(effect.role) + 2 * effect.refers


def entry_torque(run: Run, state: State, entry: Entry, values: Values) -> FloatArray:
    """What one more entry adds to the recorded torque (m, n), low-passed."""
    if CATALOGUE[entry.effect].records_torque:
        gain, delay, lag = _recording(run, state, entry, values)
        return replace(state, gain=gain, delay=delay, lag=lag).recorded(run) - state.recorded(run)
    return state.recorded(run, _law_torque(run, state, entry, values))


def _recording(run: Run, state: State, entry: Entry, values: Values) -> tuple[FloatArray, float, float]:
    """Gain (n,) or (m, n), delay and lag of the recording, s, with one more entry."""
    n = state.torque.shape[1]
    chain = MeasurementChain((), np.zeros((0, 3)), (), np.zeros((0, 3)), torque_gain=np.ones(n))
    CATALOGUE[entry.effect].record(chain, entry.site, values)
    return state.gain * chain.gain_at(run.time), state.delay + chain.torque_delay, state.lag + chain.torque_lag


def _law_torque(run: Run, state: State, entry: Entry, values: Values) -> FloatArray:
    """Torque (m, n) of an entry's law at the joints, low-passed."""
    out, effect = np.zeros_like(run.torque), CATALOGUE[entry.effect]
    weight = effect.weight(values)
    if weight is not None:
        link, vector = weight_vector(entry.site, weight, out.shape[1])
        return np.asarray(run.bodies[:, :, 10 * link : 10 * link + 10] @ vector)
    motion = replace(run.dense, load=state.load, friction=state.friction) if effect.steps else run.smooth
    for axis, torque in effect.felt(motion, entry.site, values).items():
        out[:, axis] += run.filtered(torque)
    if not np.any(state.sliding):
        return out
    level: float | FloatArray = 0.0
    if _varies(effect):
        axis = axis_of(entry.site)
        rows = replace(run.motion, load=run.filtered(state.load))
        dry = float(state.sliding[axis] + state.excess[axis])
        level = state.excess[axis] + effect.turning_under(values, rows, entry.site, dry)
    elif effect.role == "friction":
        axis = axis_of(entry.site)
        level = -effect.part_of_dry(values, run.motion.velocity[:, axis])
        if effect.fades_over:  # it has faded in part before an axis has turned round
            late = _late(run, state, axis)
            for k, torque in effect.felt(replace(motion, sign=lambda _: late), entry.site, values).items():
                out[:, k] += run.filtered(torque)
        if even := effect.uneven(values):
            out[:, axis] += even * state.uneven[:, axis]
    elif effect.role == "drive":
        _turn_with_both(out, run, state, *effect.spins(entry.site, values), effect.shared_dry(values)[1])
    if np.any(level):
        out[:, axis] += level * state.turning[:, axis] / max(state.sliding[axis], 1e-300)
    return out


def _late(run: Run, state: State, drive: int) -> FloatArray:
    """How a drive's dry friction turns round (nt,) on the dense clock, less the sign of its speed, per N·m."""
    if drive not in state.late:
        shares = state.shares[drive]
        bristles, sign = _bristles(run, {drive: 1.0}, state.travels[drive], shares[:, None])
        state.late[drive] = bristles[:, 0] - shares.sum() * sign
    return state.late[drive]


def _turn_with_both(
    out: FloatArray, run: Run, state: State, drive: int, axis: int, ratio: float, dry: float
) -> None:  # fmt: skip
    """Add to a torque (m, n) how dry friction turns round that a drive has where its axis and another meet, N·m."""
    if state.at_once or not (ratio and dry and state.sliding[drive] and np.any(shares := state.shares[drive])):
        return
    if (drive, axis, ratio) not in state.both:
        if len(state.both) >= KEPT:
            state.both.clear()
        bristles, sign = _bristles(run, {drive: 1.0, axis: ratio}, state.travels[drive], shares[:, None])
        state.both[drive, axis, ratio] = run.filtered(bristles[:, 0] - shares.sum() * sign)
    both = state.both[drive, axis, ratio]
    out[:, axis] += ratio * dry * both
    out[:, drive] += dry * (both - state.turning[:, drive] / state.sliding[drive])


def _varies(effect: Effect) -> bool:
    """Whether dry friction that turns round differs with load or time by an effect."""
    return type(effect).turning_under is not Effect.turning_under


def delayed(torque: FloatArray, run: Run, delay: float, lag: float = 0.0) -> FloatArray:
    """A low-passed torque (m, n) as a channel shows it that is late by ``delay`` s, through a low-pass of first order
    with the time constant ``lag`` s."""
    out, moved = np.zeros_like(torque), np.any(torque != 0, axis=0)
    out[:, moved] = lowpass(
        torque[:, moved], run.rate_hz, 0.45 * run.rate_hz, 0.5 * run.rate_hz, delay_s=delay, lag_s=lag
    )
    return out


def on_dense(run: Run, rows: FloatArray) -> FloatArray:
    """Rows (m, n) of a smooth signal on the dense clock."""
    step = (len(run.dense.time) - 1) // (len(run.time) - 1)
    return lowpass(rows, run.rate_hz, 0.4 * run.rate_hz, 0.5 * run.rate_hz, upsample=step)


def smooth_columns(run: Run, axis: int, middle: float, half: float, speed: float) -> FloatArray:
    """Basis (m, b) of a free function f(q_j, q̇_j), which may step where q̇_j changes sign; low-passed.

    Args:
        run: whose motion.
        axis: zero-based joint.
        middle, half: of the joint's range over all runs; ``speed`` its largest speed.
    """
    motion = run.dense
    q = np.clip((motion.position[:, axis] - middle) / half, -1, 1)
    v = motion.velocity[:, axis] / speed
    sign = motion.sign(motion.velocity[:, axis])
    along, rate = np.polynomial.legendre.legvander(q, 5), np.polynomial.legendre.legvander(np.clip(v, -1, 1), 4)
    smooth = [along[:, a] * rate[:, b] for a in range(6) for b in range(5) if a + b and a + b < 7]
    stepping = [sign * along[:, a] * np.abs(v) ** b for a in range(4) for b in (0, 2)]
    stepping += [sign * np.exp(-((v / width) ** 2)) for width in (0.03, 0.1, 0.3)]
    return run.filtered(np.stack([*smooth, *stepping], -1))


def play_columns(
    parts: Sequence[tuple[Run, State]], joint: int, scale: float, share: float
) -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray]:
    """Twist of a gear with play: free smooth columns (m, c), the gap's per unit, as recorded, and which rows count.

    Args:
        parts: runs with both encoders, and what laws see of them; they are put together.
        joint: zero-based; ``scale`` of its load, and ``share`` of that over which the gap is crossed.
    """
    free, step, twist = [], [], []
    for k, (run, state) in enumerate(parts):
        assert run.twist is not None
        load = state.load[:, joint] / scale
        zero = np.zeros((len(run.time), len(parts)))
        zero[:, k] = 1.0
        speed = run.dense.velocity[:, joint]
        smooth = np.stack([load, load * np.abs(load), load**3, speed, run.dense.sign(speed)], -1)
        free.append(np.column_stack([run.filtered(smooth), zero]))
        step.append(0.5 * run.filtered(np.tanh(load / share)))
        twist.append(run.twist[:, joint])
    X = np.concatenate(free)
    X = X / np.maximum(np.sqrt(np.mean(X**2, axis=0)), 1e-300)
    X = X[:, np.any(X != 0, axis=0)]
    return X, np.concatenate(step), np.concatenate(twist), np.concatenate([run.valid for run, _ in parts])


def presliding_columns(run: Run, turns: Mapping[int, float], travels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What bristles of unit friction and given travels (t,) add to the sign of ẋ and to its square (m, t).

    Low-passed. x is what turns: a sum of axes' positions, each times a factor, ``turns``.
    """
    out, sign = _bristles(run, turns, travels, np.eye(len(travels)))
    return run.filtered(out - sign[:, None]), run.filtered(np.abs(out) - sign[:, None] ** 2)


def _bristles(
    run: Run, turns: Mapping[int, float], travels: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Torque of bristles (Dahl, 1968) on the dense clock, (nt, k) for ``shares`` (t, k) of them, and the sign of ẋ.

    Between reversals z approaches the sense of motion s as z = s + (z₀ − s) exp(−|Δx| / travel); at rest it holds.
    """
    axes, factors = list(turns), np.array(list(turns.values()))
    x, speed = run.turned[:, axes] @ factors, run.dense.velocity[:, axes] @ factors
    s, turned = reversals(x)
    z, whole, far = np.zeros(len(travels)), shares.sum(axis=0), TURNED * float(travels.max())
    out = np.zeros((len(x), shares.shape[1]))
    for first, last in pairwise([0, *turned, len(x) - 1]):
        passed = np.abs(x[first + 1 : last + 1] - x[first])
        near = int(np.searchsorted(passed, far))
        left = np.exp(-passed[:near, None] / travels)
        out[first + 1 : first + 1 + near] = s * whole + left @ ((z - s)[:, None] * shares)
        out[first + 1 + near : last + 1] = s * whole
        z, s = np.full_like(z, s) if near < len(passed) else s + (z - s) * left[-1], -s
    return out, run.dense.sign(speed)


def reversals(x: FloatArray) -> tuple[int, list[int]]:
    """The sense in which x (nt,) first moves, and the samples from which it goes back."""
    step = np.diff(x)
    moving = np.flatnonzero(step)
    sense = np.sign(step[moving])
    return int(sense[0]) if len(sense) else 1, moving[1:][sense[1:] != sense[:-1]].tolist()
