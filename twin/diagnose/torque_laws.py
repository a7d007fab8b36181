"""What could be missing from a motion log's torque: every effect at every joint, its size as yet unknown.

The torque of an entry comes from its effect's own law in ``twin/physics``; here stand only the prior of its numbers and
from where a search starts. A size that can have either sign, or vanish, has a normal prior about no effect, as wide as
``USUAL`` of the joint's recorded torque; shapes (a speed, an order, a travel) a log-normal one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.torque_signal import Run
from twin.measure.campaign import FloatArray
from twin.measure.signals import lowpass
from twin.model.parameters import Parameter
from twin.model.regressor import inertial_vector
from twin.physics import CATALOGUE
from twin.physics.chain import MeasurementChain
from twin.physics.effect import Values, axis_of
from twin.robot.description import Entry, Robot
from twin.robot.frames import inertia_matrix

STILL = 0.01  # of the largest speed: slower rows tell nothing of how friction depends on it
USUAL = 0.1  # of a joint's RMS torque: what a missing effect would ordinarily add
STEPPING = frozenset(
    {
        "coulomb_friction", "asymmetric_friction", "stribeck_friction", "load_dependent_friction", "friction_drift",
        "joint_coupling", "hysteresis", "discovered",
    }
)  # fmt: skip
"""Effects whose torque may step where an axis turns back."""

TURNING = frozenset({"hysteresis", "stribeck_friction"})
"""Effects that change how much dry friction turns round as it ordinarily does."""

REFERRING = frozenset({"load_dependent_friction", "friction_drift", "torque_constant", "time_delay"})
"""Effects whose torque is made of the other torques."""

RECORDING = frozenset({"time_delay", "torque_constant"})
"""Of these, what acts on the recorded torque as a whole, whichever laws it is the sum of."""

BENT = frozenset({"joint_coupling", "time_delay"})
"""Effects whose torque is linear in their size near a start only."""


@dataclass
class State:
    """What laws that act on other torques need of one run, as the model has it.

    Attributes:
        torque: (m, n) of the joints at the rows, before it is recorded.
        load, friction: (nt, n) on the dense clock.
        turning: (m, n) of the torque, how ordinary friction turns round; in proportion to friction as it was recorded.
        sliding: (n,) N·m (N), dry friction that does so.
        uneven: (m, n) the same of what friction has alike in both directions, per unit: at rest it holds, too.
        gain, delay: (n,) and s, of the recording.
    """

    torque: FloatArray
    load: FloatArray
    friction: FloatArray
    turning: FloatArray = field(default_factory=lambda: np.zeros(1))
    sliding: FloatArray = field(default_factory=lambda: np.zeros(1))
    uneven: FloatArray = field(default_factory=lambda: np.zeros(1))
    gain: FloatArray = field(default_factory=lambda: np.ones(1))
    delay: float = 0.0

    def recorded(self, run: Run, torque: FloatArray | None = None) -> FloatArray:
        """The torque (m, n), or another, as it is recorded."""
        if torque is None:
            torque = self.gain * (self.torque - self.turning) + self.turning
        elif np.any(self.gain != 1):
            torque = self.gain * torque
        return np.asarray(delayed(torque, run, self.delay) if self.delay else torque)


@dataclass(frozen=True)
class Suspect:
    """A hypothesis and where its search starts.

    Attributes:
        starts: (k, m) values of the own parameters.
        sizes: indices of the own parameters in which the torque is linear, solved for at every start; with none, it
            is linear in all of them together.
        nonnegative: (m,) which own values cannot be below zero.
    """

    hypothesis: Hypothesis
    starts: FloatArray
    sizes: tuple[int, ...]
    nonnegative: np.ndarray

    @property
    def name(self) -> str:
        """``EFFECT@SITE`` and the joint a coupling comes from."""
        words = [str(v) for entry in self.hypothesis.entries for v in entry.values.values() if isinstance(v, str)]
        return " ".join([self.hypothesis.key, *words])

    @cached_property
    def vanishes(self) -> bool:
        """Whether the entry adds nothing at its starts: sizes are where they have no effect."""
        means = [self.hypothesis.own[k].mean for k in self.sizes]
        return bool(self.sizes) and bool(np.all(self.starts[:, list(self.sizes)] == means))


def add(run: Run, state: State, entry: Entry) -> None:
    """Let laws that act on other torques, and the recording, see an entry as part of the model."""
    effect = CATALOGUE[entry.effect]
    if entry.effect in RECORDING:
        state.gain, state.delay = _recording(state, entry, entry.values)
        return
    extra = _law_torque(run, state, entry, entry.values)
    if entry.effect == "payload":
        state.load[...] += on_dense(run, extra)
    elif effect.role != "drive":
        part = state.load if effect.role == "load" else state.friction
        motion = replace(run.dense, load=state.load, friction=state.friction)
        for axis, torque in effect.torque(motion, entry.site, entry.values).items():
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
    return ("load", "drive", "friction").index(CATALOGUE[entry.effect].role) + 2 * (entry.effect in REFERRING)


def entry_torque(run: Run, state: State, entry: Entry, values: Values) -> FloatArray:
    """What one more entry adds to the recorded torque (m, n), low-passed."""
    if entry.effect in RECORDING:
        gain, delay = _recording(state, entry, values)
        return replace(state, gain=gain, delay=delay).recorded(run) - state.recorded(run)
    return state.recorded(run, _law_torque(run, state, entry, values))


def _recording(state: State, entry: Entry, values: Values) -> tuple[FloatArray, float]:
    """Gain (n,) and delay of the recording, s, with one more entry."""
    n = state.torque.shape[1]
    chain = MeasurementChain((), np.zeros((0, 3)), (), np.zeros((0, 3)), torque_gain=np.ones(n))
    CATALOGUE[entry.effect].record(chain, entry.site, values)
    return state.gain * chain.torque_gain, state.delay + chain.torque_delay


def _law_torque(run: Run, state: State, entry: Entry, values: Values) -> FloatArray:
    """Torque (m, n) of an entry's law at the joints, low-passed."""
    out = np.zeros_like(run.torque)
    n = out.shape[1]
    if entry.effect == "payload":
        link = n - 1 if entry.site == "flange" else axis_of(entry.site)
        six = [*(values["inertia"] or []), *[0.0] * 6][:6]
        vector = inertial_vector(values["mass"], np.array(values["com"], float), inertia_matrix(six))
        return np.asarray(run.bodies[:, :, 10 * link : 10 * link + 10] @ vector)
    motion = run.smooth
    if entry.effect in STEPPING:
        motion = replace(run.dense, load=state.load, friction=state.friction)
    for axis, torque in CATALOGUE[entry.effect].torque(motion, entry.site, values).items():
        out[:, axis] += run.filtered(torque)
    if entry.effect in TURNING and np.any(state.sliding):
        axis = axis_of(entry.site)
        level = turning_level(entry.effect, values, run.motion.velocity[:, axis])
        out[:, axis] += level * state.turning[:, axis] / max(state.sliding[axis], 1e-300)
    if entry.effect == "asymmetric_friction" and np.any(state.sliding):
        axis = axis_of(entry.site)
        out[:, axis] += 0.5 * values["torque_difference"] * state.uneven[:, axis]
    return out


def turning_level(effect: str, values: Values, velocity: FloatArray) -> float:
    """Dry friction, N·m (N), that turns round as the other joints' does with an entry more than without it.

    Without it, that is what friction is at rest by a parabola in speed. Slip is a part of it that turns round in its
    own way; a static excess adds what such a parabola misses of it.

    Args:
        effect: one of ``TURNING``, with its ``values``.
        velocity: (m,) of the joint, rad/s (m/s).
    """
    if effect == "hysteresis":
        return -float(np.sum(values["yield_torque"]))
    speed = np.abs(velocity)
    fastest = float(speed.max(initial=0.0))
    speed = speed[speed > STILL * fastest]
    if len(speed) < 4:
        return 0.0
    excess = np.exp(-((speed / values["velocity"]) ** 2))
    return float(values["static_excess"] * (1 - np.polynomial.polynomial.polyfit(speed / fastest, excess, 2)[0]))


def delayed(torque: FloatArray, run: Run, delay: float) -> FloatArray:
    """A low-passed torque (m, n) as a channel shows it that is late by ``delay`` s."""
    out, moved = np.zeros_like(torque), np.any(torque != 0, axis=0)
    out[:, moved] = lowpass(torque[:, moved], run.rate_hz, 0.45 * run.rate_hz, 0.5 * run.rate_hz, delay_s=delay)
    return out


def canonical(hypothesis: Hypothesis, values: FloatArray) -> FloatArray:
    """Values (m,) that mean the same with a wave's amplitude above zero and its phase within half a turn of zero."""
    if hypothesis.effect != "torque_ripple":
        return values
    amplitude, order, phase = values
    phase = (phase + (np.pi if amplitude < 0 else 0.0) + np.pi) % (2 * np.pi) - np.pi
    return np.array([abs(amplitude), order, phase])


def with_values(hypothesis: Hypothesis, values: FloatArray) -> list[Entry]:
    """The entries of a hypothesis with the values (m,) of its own parameters."""
    entries = [(entry, dict(entry.model_extra or {})) for entry in hypothesis.entries]
    for parameter, value in zip(hypothesis.own, values, strict=True):
        key, _, quantity = parameter.name.rpartition(".")
        name, _, index = quantity.partition("[")
        for entry, found in entries:
            if key == f"{entry.effect}@{entry.site}":
                if index:
                    items = list(found[name])
                    items[int(index[:-1])] = float(value)
                    found[name] = items
                else:
                    found[name] = float(value)
                break
    return [Entry(effect=entry.effect, site=entry.site, **found) for entry, found in entries]


def log_suspects(robot: Robot, runs: Sequence[Run]) -> list[Suspect]:
    """Every entry that a motion log could show and the description does not have."""
    present = {(entry.effect, entry.site) for entry in robot.physics}
    found = []
    for name, effect in CATALOGUE.items():
        if "log" not in effect.seen_in or name not in _BUILDERS:
            continue
        for site in effect.fixed_sites(robot.axis_count):
            if (name, site) not in present or effect.repeatable:
                found += _BUILDERS[name](_Setting(robot, runs, name, site))
    return [suspect for suspect in found if suspect.starts.size]


@dataclass(frozen=True)
class _Setting:
    robot: Robot
    runs: Sequence[Run]
    effect: str
    site: str

    @property
    def axis(self) -> int:
        return axis_of(self.site)

    def torque(self) -> float:
        """RMS torque of the joint, N·m (N)."""
        return _rms([r.torque[r.valid, self.axis] for r in self.runs])

    def speed(self) -> float:
        return max(_rms([r.motion.velocity[r.valid, self.axis] for r in self.runs]), 1e-9)

    def middle(self) -> tuple[float, float]:
        """Mean and half range of the joint's position."""
        q = np.concatenate([r.motion.position[:, self.axis] for r in self.runs])
        return float(q.mean()), float(0.5 * np.ptp(q))

    def size(self, values: Values) -> float:
        """How much of an entry of unit size makes a usual torque."""
        parts = []
        for run in self.runs[:2]:
            state = State(run.torque, on_dense(run, run.torque), np.ones_like(run.dense.position))
            torque = entry_torque(run, state, Entry(effect=self.effect, site=self.site), values)
            parts.append(torque[run.valid][:, self.axis])
        return USUAL * self.torque() / max(_rms(parts), 1e-300)

    def suspect(
        self, values: Values, own: list[Parameter], starts: Sequence[Sequence[float]],
        sizes: tuple[int, ...] = (0,), passive: bool = False,
    ) -> list[Suspect]:  # fmt: skip
        """``passive``: the first size, below zero, would be friction that drives."""
        entry = Entry(effect=self.effect, site=self.site, **values)
        named = tuple(replace(p, name=f"{self.effect}@{self.site}.{p.name}") for p in own)
        hypothesis = Hypothesis(self.effect, self.site, (entry,), named)
        known = {p.name: p for p in CATALOGUE[self.effect].parameters}
        least = np.array([known[p.name.partition("[")[0]].log for p in own])
        least[0] |= passive
        widths = np.array([p.deviation for p in own])
        if not (np.isfinite(widths) & (widths > 0) & (widths < 1e12)).all():  # it would never be felt
            return []
        return [Suspect(hypothesis, np.array(starts, float), sizes, least)]

    def unit(self, name: str) -> str:
        unit = next(p.unit for p in CATALOGUE[self.effect].parameters if p.name == name)
        return unit.split(",")[0]

    def normal(self, name: str, deviation: float, mean: float = 0.0) -> Parameter:
        return Parameter(name, self.unit(name.partition("[")[0]), "entry", False, mean, deviation, "usual size")

    def scale(self, name: str, mean: float, factor: float) -> Parameter:
        unit = self.unit(name.partition("[")[0])
        return Parameter(name, unit, "entry", True, mean, float(np.log(factor)), "usual size")


def _rms(parts: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def on_dense(run: Run, rows: FloatArray) -> FloatArray:
    """Rows (m, n) of a smooth signal on the dense clock."""
    step = (len(run.dense.time) - 1) // (len(run.time) - 1)
    return lowpass(rows, run.rate_hz, 0.4 * run.rate_hz, 0.5 * run.rate_hz, upsample=step)


def _one(name: str, passive: bool = False):  # type: ignore[no-untyped-def]
    def build(s: _Setting) -> list[Suspect]:
        return s.suspect({name: 0.0}, [s.normal(name, s.size({name: 1.0}))], [[0.0]], passive=passive)

    return build


def _asymmetric(s: _Setting) -> list[Suspect]:
    names = ("torque_difference", "viscous_difference")
    none = dict.fromkeys(names, 0.0)
    own = [s.normal(name, s.size({**none, name: 1.0})) for name in names]
    return s.suspect(none, own, [[0.0, 0.0]], (0, 1))


def _stribeck(s: _Setting) -> list[Suspect]:
    middle = 0.1 * s.speed()
    own = [s.normal("static_excess", USUAL * s.torque()), s.scale("velocity", middle, 3.0)]
    starts = [[0.0, factor * middle] for factor in (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)]
    return s.suspect({"static_excess": 0.0, "velocity": middle}, own, starts, passive=True)


def _drift(s: _Setting) -> list[Suspect]:
    own = [s.normal("amplitude", 0.2), s.scale("time_constant", 300.0, 3.0)]
    return s.suspect(
        {"amplitude": 0.0, "time_constant": 300.0}, own, [[0.0, T] for T in (30.0, 100.0, 250.0, 600.0, 1500.0)]
    )


def _compensator(s: _Setting) -> list[Suspect]:
    if s.robot.axes[s.axis].type == "prismatic":
        return []
    own = [s.normal(f"coefficients[{k}]", s.size({"coefficients": np.eye(3)[k].tolist()})) for k in range(3)]
    return s.suspect({"coefficients": [0.0, 0.0, 0.0]}, own, [[0.0, 0.0, 0.0]], (0, 1, 2))


def _cable(s: _Setting) -> list[Suspect]:
    middle, half = s.middle()
    own = [s.normal("stiffness", s.size({"stiffness": 1.0, "rest": middle})), s.normal("rest", half + 0.5, middle)]
    return s.suspect(
        {"stiffness": 0.0, "rest": middle}, own, [[0.0, middle], [0.0, middle + half], [0.0, middle - half]]
    )


def _ripple(s: _Setting) -> list[Suspect]:
    if s.robot.axes[s.axis].type == "prismatic":
        return []
    _, half = s.middle()
    highest = 2 * np.pi * s.runs[0].bands.fit[1] / s.speed()  # beyond, the low-pass takes it
    orders = np.arange(2.0, min(highest, 80.0), min(0.7 / max(half, 1e-3), 4.0))
    own = [
        s.normal("amplitude", USUAL * s.torque()), s.scale("order", 12.0, 3.0), s.normal("phase", np.pi / np.sqrt(3)),
    ]  # fmt: skip
    starts = [[0.0, order, phase] for order in orders for phase in (0.0, np.pi / 2)]
    return s.suspect({"amplitude": 0.0, "order": 12.0, "phase": 0.0}, own, starts)


def _hysteresis(s: _Setting) -> list[Suspect]:
    usual = USUAL * s.torque()
    _, half = s.middle()
    middle = usual / (1e-3 * max(half, 1e-3))
    own = [s.normal("yield_torque[0]", usual), s.scale("stiffness[0]", middle, 10.0)]
    starts = [[usual, usual / (travel * max(half, 1e-3))] for travel in np.geomspace(3e-5, 3e-2, 7)]
    return s.suspect({"yield_torque": [usual], "stiffness": [middle]}, own, starts, ())


def _coupling(s: _Setting) -> list[Suspect]:
    found = []
    for j, axis in enumerate(s.robot.axes):
        if j == s.axis or axis.type == "prismatic" or s.robot.axes[s.axis].type == "prismatic":
            continue
        entry = Entry(effect=s.effect, site=s.site, **{"from": f"joint{j + 1}", "ratio": 1.0})
        values = s.robot.values(entry)
        other = replace(s, site=f"joint{j + 1}")
        viscous, coulomb = values["friction"]
        acceleration = _rms([r.motion.acceleration[r.valid, j] for r in s.runs])
        usual = USUAL * other.torque()
        inertia = values["inertia"] or usual / max(acceleration, 1e-9)
        friction = [viscous or usual / other.speed(), coulomb or usual]
        own = [
            s.normal("ratio", 0.5), s.scale("inertia", inertia, 1.5 if values["inertia"] else 6.0),
            s.scale("friction[0]", friction[0], 2.0), s.scale("friction[1]", friction[1], 2.0),
        ]  # fmt: skip
        # dry friction turns round elsewhere already at a small ratio, and elsewhere again at one of the other sign
        starts = [[sign * ratio, inertia, *friction] for ratio in (0.003, 1.0) for sign in (-1, 1)]
        found += s.suspect(
            {"from": f"joint{j + 1}", "ratio": 0.0, "inertia": inertia, "friction": friction}, own, starts
        )
    return found


def _payload(s: _Setting) -> list[Suspect]:
    typical = CATALOGUE["payload"].typical(s.robot, s.site)
    if typical is None:
        return []
    own = [s.normal("mass", typical["mass"])]
    own += [s.normal(f"com[{k}]", 0.2, typical["com"][k]) for k in range(3)]
    return s.suspect({"mass": 0.0, "com": typical["com"]}, own, [[0.0, *typical["com"]]])


def _curved(s: _Setting) -> list[Suspect]:
    """Friction that rises the more the faster, as of churned oil: a nameless rival to what falls where it is slow."""
    v = f"v{s.axis + 1}"
    law = {"formula": f"c1*abs({v})*{v}"}
    usual = s.normal("coefficients[0]", s.size({**law, "coefficients": [1.0]}))
    return s.suspect({**law, "coefficients": [0.0]}, [usual], [[0.0]], passive=True)


def _gain(s: _Setting) -> list[Suspect]:
    return s.suspect({"gain": 1.0}, [s.normal("gain", 0.05, 1.0)], [[1.0]])


def _delay(s: _Setting) -> list[Suspect]:
    return s.suspect({"delay": 0.0}, [s.normal("delay", 0.1 / s.runs[0].rate_hz)], [[0.0]])


_BUILDERS = {
    "payload": _payload,
    "hysteresis": _hysteresis,
    "viscous_friction": _one("coefficient", passive=True),
    "coulomb_friction": _one("torque", passive=True),
    "asymmetric_friction": _asymmetric,
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _one("coefficient", passive=True),
    "friction_drift": _drift,
    "gravity_compensator": _compensator,
    "cable_stiffness": _cable,
    "torque_ripple": _ripple,
    "joint_coupling": _coupling,
    "rotor_inertia": _one("inertia"),
    "time_delay": _delay,
    "torque_constant": _gain,
    "discovered": _curved,
}


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


def presliding_columns(run: Run, axis: int, travels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What bristles (Dahl, 1968) of unit friction and given travels (t,) add to sgn q̇ and to its square (m, t).

    Low-passed. Between reversals z approaches the sense of motion s as z = s + (z₀ − s) exp(−|Δq| / travel); at rest
    it holds.
    """
    x = run.dense.position[:, axis]
    sense = np.sign(np.diff(x))
    turns = np.flatnonzero(sense[1:] != sense[:-1]) + 1
    z = np.zeros(len(travels))
    out = np.zeros((len(x), len(travels)))
    for first, last in pairwise([0, *turns, len(x) - 1]):
        passed = np.abs(x[first + 1 : last + 1, None] - x[first]) / travels
        out[first + 1 : last + 1] = sense[first] + (z - sense[first]) * np.exp(-passed)
        z = out[last]
    sign = run.dense.sign(run.dense.velocity[:, axis])[:, None]
    return run.filtered(out - sign), run.filtered(np.abs(out) - sign**2)
