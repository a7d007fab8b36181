"""What could be missing from a motion log's torque: every effect at every joint, its size as yet unknown.

Everything that is particular to an effect comes from its file in ``twin/physics``: its torque, the prior of its numbers
and where a search starts. A size that can have either sign, or vanish, has a normal prior about no effect. Its width is
``USUAL_SHARE`` of the joint's recorded torque. Shapes (a speed, an order, a travel) have a log-normal prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter
from twin.model.torque_laws import USUAL_SHARE, State, entry_torque, on_dense
from twin.model.torque_signal import Run
from twin.physics import CATALOGUE
from twin.physics.effect import Effect, Values, axis_of
from twin.physics.statements import Prior, Suspected
from twin.robot.description import Entry, Robot


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

    @property
    def form(self) -> str:
        """The same and its own numbers: an effect may be suspected in several forms."""
        return " ".join([self.name, *(p.name for p in self.hypothesis.own)])

    @property
    def effect(self) -> Effect:
        """What is suspected."""
        return CATALOGUE[self.hypothesis.effect]

    @cached_property
    def vanishes(self) -> bool:
        """Whether the entry adds nothing at its starts: sizes are where they have no effect."""
        means = [self.hypothesis.own[k].mean for k in self.sizes]
        return bool(self.sizes) and bool(np.all(self.starts[:, list(self.sizes)] == means))


def canonical(hypothesis: Hypothesis, values: FloatArray) -> FloatArray:
    """Values (m,) that mean the same in the form in which the effect tells them."""
    return CATALOGUE[hypothesis.effect].canonical(values)


def log_suspects(robot: Robot, runs: Sequence[Run]) -> list[Suspect]:
    """Every entry that a motion log could show and the description does not have."""
    present = {(entry.effect, entry.site) for entry in robot.physics}
    found = []
    for name, effect in CATALOGUE.items():
        if not sought(effect):
            continue
        for site in effect.fixed_sites(robot.axis_count):
            if (name, site) not in present or effect.repeatable:
                look = Look(robot, runs, name, site)
                found += [suspect for s in effect.suspected(look) if (suspect := look.suspect(s)) is not None]
    return [suspect for suspect in found if suspect.starts.size]


def sought(effect: Effect) -> bool:
    """Whether an effect is looked for in torque."""
    return "log" in effect.seen_in and not effect.ordinary and effect.part != "play" and effect.unstated() is None


def not_sought(robot: Robot) -> list[str]:
    """Effects that a log could show but that cannot be looked for, with the reason."""
    notes = [f"{name} is not looked for: {why}" for name, e in CATALOGUE.items() if (why := e.unstated())]
    for name, effect in CATALOGUE.items():
        default = sought(effect) and type(effect).suspected is Effect.suspected
        if default and len(effect.parameters) > 1:
            sites = [site for site in effect.fixed_sites(robot.axis_count) if effect.typical(robot, site) is None]
            if sites:
                notes.append(f"{name} is not looked for at {', '.join(sites)}: its `typical` states no entry there")
    return notes


@dataclass(frozen=True)
class Look:
    """A log and a site, as an effect that is looked for there may ask about them (:class:`LogView`)."""

    robot: Robot
    runs: Sequence[Run]
    effect: str
    site: str

    @property
    def axis(self) -> int:
        """Zero-based axis of the site."""
        return axis_of(self.site)

    @property
    def highest_hz(self) -> float:
        """Where the low-pass of torque ends, Hz."""
        return self.runs[0].bands.fit[1]

    @property
    def rate_hz(self) -> float:
        """Rows per second."""
        return self.runs[0].rate_hz

    @property
    def sample_hz(self) -> float:
        """Samples of the log per second."""
        return self.runs[0].sample_hz

    def usual(self, axis: int | None = None) -> float:
        """The torque that a missing effect ordinarily adds, N·m (N)."""
        return USUAL_SHARE * _rms([r.torque[r.valid, self._axis(axis)] for r in self.runs])

    def speed(self, axis: int | None = None) -> float:
        """RMS, rad/s (m/s)."""
        return max(_rms([r.motion.velocity[r.valid, self._axis(axis)] for r in self.runs]), 1e-9)

    def acceleration(self, axis: int | None = None) -> float:
        """RMS, rad/s² (m/s²)."""
        return _rms([r.motion.acceleration[r.valid, self._axis(axis)] for r in self.runs])

    def middle(self) -> tuple[float, float]:
        """Mean and half range of the axis' position."""
        q = np.concatenate([r.motion.position[:, self.axis] for r in self.runs])
        return float(q.mean()), float(0.5 * np.ptp(q))

    def size(self, values: Values) -> float:
        """How many times an entry with these values makes a usual torque; at the site's axis, or where it acts most."""
        parts = []
        for run in self.runs[:2]:
            state = State(run.torque, on_dense(run, run.torque), np.ones_like(run.dense.position))
            torque = entry_torque(run, state, Entry(effect=self.effect, site=self.site), values)
            parts.append(torque[run.valid])
        try:
            axes = [self.axis]
        except ValueError:
            axes = list(range(self.robot.axis_count))
        return min(self.usual(axis) / max(_rms([part[:, axis] for part in parts]), 1e-300) for axis in axes)

    def suspect(self, suspected: Suspected) -> Suspect | None:
        """With names and units; ``None`` where it would never be felt."""
        effect = CATALOGUE[self.effect]
        entry = Entry(effect=self.effect, site=self.site, **suspected.values)
        hypothesis = Hypothesis(self.effect, self.site, (entry,), tuple(map(self._named, suspected.own)))
        known = {p.name: p for p in effect.parameters}
        least = np.array([known[p.name.partition("[")[0]].log for p in suspected.own])
        least[0] |= suspected.passive
        widths = np.array([p.deviation for p in suspected.own])
        if not (np.isfinite(widths) & (widths > 0) & (widths < 1e12)).all():
            return None
        return Suspect(hypothesis, np.array(suspected.starts, float), suspected.sizes, least)

    def _named(self, prior: Prior) -> Parameter:
        unit = CATALOGUE[self.effect].unit(prior.name, self.site, self.robot)
        key = f"{self.effect}@{self.site}.{prior.name}"
        return Parameter(key, unit, "entry", prior.log, prior.mean, prior.deviation, "usual size")

    def _axis(self, axis: int | None) -> int:
        return self.axis if axis is None else axis


def _rms(parts: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


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
