"""What could be missing: one hypothesis per effect and site, each the base model plus one entry with its own prior.

Everything that is particular to an effect comes from its file in ``twin/physics``: its usual size, how well that is
known, and where a search has to start. A hypothesis may also be a number of the base model itself that is further from
its description than its tolerance says (effect ``parameter``).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.measure.campaign import Brakes, Channels, FloatArray
from twin.model.parameters import Kind, Parameter, Parameters, Sprung, independent, join, written_names
from twin.physics import CATALOGUE
from twin.physics.chain import node_of
from twin.physics.effect import Companion, Effect
from twin.physics.effect import Parameter as Quantity
from twin.robot.description import Entry, Robot
from twin.robot.frames import axis_placement, matrix_of

SAME_ANGLE = 0.05  # rad: angles of joint 1 that far apart are two


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be missing.

    Attributes:
        effect, site: as in a diagnosis.
        entries: what is added to the description, at the centre of its prior.
        own: (m,) parameters of the entries, or numbers that the base model takes as described; named as there.
        scale: base parameters whose prior is widened: name → factor on the deviation.
        parts: the single hypotheses of one that is several at once.
        gears: stiffness and damping, at the centre of their prior, of axes (zero-based) that are described as rigid.
        of_number: what :attr:`law` states of a number that the description does not have.
    """

    effect: str
    site: str
    entries: tuple[Entry, ...] = ()
    own: tuple[Parameter, ...] = ()
    scale: tuple[tuple[str, float], ...] = ()
    parts: tuple["Hypothesis", ...] = ()
    gears: tuple[tuple[int, float, float], ...] = ()
    of_number: Effect | None = None

    @property
    def identity(self) -> frozenset[str]:
        """The same for the same things in whatever order."""
        return frozenset(piece.key for piece in self.pieces)

    @property
    def pieces(self) -> tuple["Hypothesis", ...]:
        """Single hypotheses; none for the base model."""
        return self.parts or ((self,) if self.entries or self.scale or self.own else ())

    @property
    def key(self) -> str:
        """``EFFECT@SITE``."""
        return f"{self.effect}@{self.site}"

    @property
    def family(self) -> str:
        """What shares one prior among its sites: an effect, or numbers of one kind, as centres of mass."""
        if self.gears:
            return f"{self.effect}.gears"
        return self.effect if self.law else f"{self.effect}.{self.site.rpartition('.')[2]}"

    @property
    def law(self) -> Effect | None:
        """What the catalogue states of the effect; ``None`` of a number of the description, unless it has none."""
        return self.of_number or CATALOGUE.get(self.effect)

    @property
    def exact(self) -> bool:
        """Whether there is no law that could be off: a number of the description, or how motion is recorded."""
        return self.law is None or not self.law.changes_robot

    def under(self, axes: Mapping[str, str]) -> tuple[str, ...]:
        """Keys of the pieces, those that turn about the same axis (:func:`same_axes`) under that axis' name."""
        return tuple(sorted(axes.get(piece.key, piece.key) for piece in self.pieces))

    def robot(self, base: Robot) -> Robot:
        """The description with the entries, and with springs in axes that were rigid."""
        changed: dict[str, Any] = {"physics": [*base.physics, *self.entries]} if self.entries else {}
        if self.gears:
            axes = list(base.axes)
            for axis, stiffness, damping in self.gears:
                axes[axis] = axes[axis].model_copy(update={"stiffness": stiffness, "damping": damping})
            changed["axes"] = axes
        return base.model_copy(update=changed) if changed else base

    def parameters(self, base: Parameters) -> Parameters:
        """Everything that is free under this hypothesis: the base model's parameters, then its own."""
        written = written_names(base)
        if self.scale:
            width = np.ones(len(base))
            for name, factor in self.scale:
                width[base.names.index(name)] = factor
            items = tuple(replace(p, deviation=p.deviation * w) for p, w in zip(written, width, strict=True))
            written = Parameters(items, written.covariance * np.outer(width, width))
        if self.own:
            written = join(written, *(p._prior for p in self.parts or (self,)))
        elif not self.scale:
            return base
        return self._quick(written) if self.own or isinstance(base, Sprung) else written

    @property
    def _prior(self) -> Parameters:
        """The own parameters; what is known of a damper is its ratio to its spring."""
        own = independent(self.own)
        if self.law and self.law.sprung:
            ratio = np.eye(len(self.own))
            ratio[1, 0] = 1.0
            return Parameters(own.items, ratio @ own.covariance @ ratio.T)
        return own

    def coarse(self, parameters: Parameters) -> list[int]:
        """Indices of what matters far from the truth: springs, dampers, numbers of entries and those it widens.

        Tolerances of links, angles and gains change FRFs by less than that.
        """
        widened = {name for name, _ in self.scale}
        coarse = ("spring", "entry", "axis", "point", "direction")
        return [k for k, p in enumerate(parameters) if p.kind in coarse or p.name in widened]

    def _quick(self, written: Parameters) -> Parameters:
        items = list(written.items)
        for k, parameter in enumerate(items):
            if "@" in parameter.name:
                key, _, quantity = parameter.name.rpartition(".")
                effect, _, site = key.partition("@")
                if CATALOGUE[effect].sprung and quantity in ("stiffness", "damping"):
                    items[k] = replace(parameter, name=f"{site}.{quantity}", kind="spring")
        return Sprung(tuple(items), written.covariance, written)

    def of_size(self, z: FloatArray, size: float) -> FloatArray:
        """Prior coordinates z (n,) of a base model, then own ones that make the entry so many times its usual size.

        A spring's size is its compliance; a first parameter of either sign is so many deviations from null.
        """
        own, first = np.zeros(len(self.own)), self.own[0]
        own[0] = (-1 if first.quantity == "stiffness" else 1) * np.log(size) / first.deviation if first.log else size
        return np.concatenate([z, own])


def entry_hypothesis(base: Robot, effect: str, site: str, values: dict[str, Any]) -> Hypothesis:
    """The hypothesis of one entry, its prior centred on ``values``."""
    return _variants(base, effect, site, [values])[0]


def _variants(base: Robot, effect: str, site: str, some: Sequence[dict[str, Any]]) -> list[Hypothesis]:
    """The hypotheses of one entry, the prior of each centred on values of its own."""
    same = sum(other.effect == effect and other.site == site for other in base.physics)
    key = f"{effect}@{site}" + (f"#{same + 1}" if same else "")
    law = CATALOGUE[effect]
    kind: Kind = "spring" if law.hinge else "entry"
    known: dict[tuple[tuple[str, int], ...], list[tuple[str, str, bool, float]]] = {}

    def one(values: dict[str, Any]) -> Hypothesis:
        free = [p for p in law.parameters if not p.word and p.spread and p.name in values]
        means = [list(values[p.name]) if p.length else [values[p.name]] for p in free]
        shape = tuple((p.name, len(mean)) for p, mean in zip(free, means, strict=True))
        if shape not in known:
            known[shape] = [own(p, k) for p, mean in zip(free, means, strict=True) for k in range(len(mean))]
        flat = [float(x) for mean in means for x in mean]
        parameters = [
            Parameter(name, unit, kind, log, mean, width, "usual size")
            for (name, unit, log, width), mean in zip(known[shape], flat, strict=True)
        ]
        return Hypothesis(effect, site, (Entry(effect=effect, site=site, **values),), tuple(parameters))

    def own(quantity: Quantity, k: int) -> tuple[str, str, bool, float]:
        """Name, unit, whether the logarithm is sought, and prior deviation."""
        at = f"[{k}]" if quantity.length else ""
        name = f"{site if law.hinge else key}.{quantity.name}" + ("" if law.hinge else at)
        return name, law.unit(quantity.name + at, site, base), quantity.log, law.deviation(base, site, quantity, k)

    return [one(values) for values in some]


def sites(effect: str, axes: int, response: Channels, excitation: Channels) -> list[str]:
    """Where an effect can act on a robot tested through these channels."""
    found: list[str] = []
    nodes = list(dict.fromkeys(node_of(label) for label in response.label))
    if len(nodes) < CATALOGUE[effect].nodes:
        return found
    for pattern in CATALOGUE[effect].sites:
        if "LABEL" in pattern:
            labels = response.label if pattern.startswith("sensor") else excitation.label
            found += [pattern.replace("LABEL", label) for label in labels]
        elif "NODE" in pattern:
            found += [pattern.replace("NODE", node) for node in nodes]
    return found + list(CATALOGUE[effect].fixed_sites(axes))


def suspects(
    base: Robot,
    response: Channels,
    excitation: Channels,
    brakes: Iterable[Brakes | None],
    band_hz: tuple[float, float],
) -> list[list[Hypothesis]]:
    """Every entry that a hammer test could show and the description does not have; one list of variants for each."""
    present, brakes = {(entry.effect, entry.site) for entry in base.physics}, list(brakes)
    found: list[list[Hypothesis]] = []
    for name, effect in CATALOGUE.items():
        if "hammer" not in effect.seen_in or not effect.shown_by(brakes):
            continue
        for site in sites(name, base.axis_count, response, excitation):
            if (name, site) in present and not effect.repeatable:
                continue
            variants = effect.variants(base, site, band_hz)
            if variants:
                found.append(_variants(base, name, site, variants))
    return found


def together(*parts: Hypothesis) -> Hypothesis:
    """All at once; nothing beside something is that something alone."""
    flat = [piece for part in parts for piece in part.pieces]
    if len(flat) == 1:
        return flat[0]
    return Hypothesis(
        "+".join(p.effect for p in flat), "+".join(p.site for p in flat), tuple(e for p in flat for e in p.entries),
        tuple(q for p in flat for q in p.own), tuple(w for p in flat for w in p.scale), tuple(flat),
        tuple(gear for p in flat for gear in p.gears),
    )  # fmt: skip


def companions(
    hypothesis: Hypothesis, base: Robot, numbers: Sequence[Hypothesis], postures_q: Sequence[FloatArray]
) -> list[Hypothesis]:
    """What a hypothesis is known to be hard to tell from, by mechanics: judged beside it in any case.

    Args:
        numbers: those of the description that may be wrong.
    """
    axes = same_axes(base, postures_q)
    found = [
        Companion(key.partition("@")[0], key.partition("@")[2])
        for key, axis in axes.items()
        if axis == axes.get(hypothesis.key) and key != hypothesis.key
    ]
    if hypothesis.entries:
        (entry,) = hypothesis.entries
        found += CATALOGUE[hypothesis.effect].companions(base, hypothesis.site, base.values(entry))
    elif hypothesis.effect == "parameter":
        found += [behind for effect in CATALOGUE.values() for behind in effect.behind(base, hypothesis.site)]
    present = {(entry.effect, entry.site) for entry in base.physics}
    hypotheses: list[Hypothesis] = []
    for one in found:
        if one.effect == "parameter":
            hypotheses += [h for h in numbers if h.site == one.site]
        elif one.effect in CATALOGUE and ((one.effect, one.site) not in present or CATALOGUE[one.effect].repeatable):
            values = one.values or CATALOGUE[one.effect].typical(base, one.site)
            hypotheses += [entry_hypothesis(base, one.effect, one.site, dict(values))] if values else []
    return hypotheses


def same_axes(base: Robot, postures_q: Sequence[FloatArray]) -> dict[str, str]:
    """What turns the robot about one axis in every posture: keys of base and joint 1 → that axis of the base.

    Both turn the robot about the axis of joint 1 in all postures. While q₁ is the same, this holds for the other axes
    of joint 1, too: each counts as one with the nearest axis of the base. Then base and joint 1 differ in the height of
    a hinge and, by q₁, in its direction. The vocabulary sets both; it sets the height at the foot of the base and at
    the origin of link 1. A real foundation or bearing gives way elsewhere.
    """
    if base.axes[0].type == "prismatic":
        return {}
    turned = any(abs(q[0] - postures_q[0][0]) > SAME_ANGLE for q in postures_q)
    along = np.abs(matrix_of(axis_placement(base.axes[0], float(postures_q[0][0]))[1]))
    found: dict[str, str] = {}
    for number in (2,) if turned else (2, 0, 1):
        nearest = next(k for k in np.argsort(-along[:, number]) if f"base.r{'xyz'[k]}" not in found.values())
        axis, coordinate = f"base.r{'xyz'[nearest]}", f"joint1.{'xyz'[number]}"
        of_base, of_joint = (_springs(base, site) for site in (axis, coordinate))
        found |= dict.fromkeys([*of_base, f"parameter@{coordinate}.stiffness", *of_joint], axis)
    return found


def _springs(base: Robot, coordinate: str) -> list[str]:
    """Keys of the effects that are a spring on a coordinate."""
    n = base.axis_count
    return [f"{name}@{coordinate}" for name, e in CATALOGUE.items() if e.sprung and e.is_site(coordinate, n)]


def merged(one: Hypothesis, other: Hypothesis, base: Robot) -> list[Hypothesis]:
    """What two things may be as one."""
    found: list[Companion] = []
    of_one_link = one.site.partition(".")[0] == other.site.partition(".")[0]
    for piece, beside in ((one, other), (other, one)):
        if piece.entries:
            values, effect = base.values(piece.entries[0]), CATALOGUE[piece.effect]
            found += effect.merged(base, piece.site, values, beside.effect, beside.site)
        elif of_one_link and not beside.entries:
            found += [behind for effect in CATALOGUE.values() for behind in effect.behind(base, piece.site)]
    found = [one for k, one in enumerate(found) if one not in found[:k]]
    return [entry_hypothesis(base, c.effect, c.site, dict(c.values or {})) for c in found]


def fuller(one: Hypothesis, base: Robot) -> list[Hypothesis]:
    """The same thing with optional parameters that it has done without."""
    found = [c for e in one.entries for c in CATALOGUE[e.effect].fuller(base, e.site, base.values(e))]
    return [entry_hypothesis(base, c.effect, c.site, dict(c.values or {})) for c in found]
