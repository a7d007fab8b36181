"""From evidence to probabilities: none, a name, a set of names, or something that has no name here.

Prior: nothing is missing with probability ``none``. Otherwise every effect is equally likely, and every site of an
effect. So the many channels of the measurement chain do not win by their number. What evidence gains is divided by a
temperature found on development cases. What the best entry leaves of the misfit tells whether the truth is among the
names at all.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.cannot_be import cannot_be
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted, foreseen
from twin.diagnose.search import FIRST_ORDER, WITHIN, in_doubt, most_noise, scatter
from twin.diagnose.within import allowed, excused, singled_out
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.parallel import spread
from twin.robot.description import Robot

BREAKS_DOWN = 1e30  # ½ χ² of a prediction that breaks down


@dataclass(frozen=True)
class Decision:
    """Who is left.

    Attributes:
        ranked: hypotheses fitted to the end, most probable first; ``probability`` of each.
        none, other: probabilities that nothing, or something unnamed, is missing.
        nameless: what of ``other`` is a law without a name that was fitted.
        alike: probability of the first and of what differs from it by convention alone.
    """

    ranked: list[Fitted]
    probability: list[float]
    none: float
    other: float
    nameless: float = 0.0
    alike: float = 0.0

    @property
    def rivals(self) -> list[int]:
        """Indices of the alternatives to the first that cannot be dismissed."""
        least = calibration()["alternative"]
        return [k for k, p in enumerate(self.probability) if k and p >= least]


def decide(
    fits: Sequence[Fitted],
    base: Fitted,
    suspects: Sequence[Sequence[Hypothesis]],
    *,
    handicap: Sequence[float] | None = None,
    other: float | None = None,
    scale: float | None = None,
    kept: Sample | None = None,
    unnamed: Callable[[Fitted], Mapping[str, float]] | None = None,
    axes: Mapping[str, str] | None = None,
    processes: int = 1,
) -> Decision:
    """Probabilities of hypotheses fitted to the same lines as the base model.

    Args:
        fits: at their optimum, on all lines.
        base: the same for the base model.
        suspects: all that was looked at, which sets the prior.
        handicap: evidence taken off each fit, where a simpler one is within reach; by default what its laws may be
            off by (:func:`twin.diagnose.search.inexact`).
        other: probability that something unnamed is missing, where the engine has a better measure than the misfit.
        scale: factor on the data's variance (Birge's ratio); what the best fit leaves, by default.
        kept: hammer tests that were not fitted to; how well each fit predicts them counts in its evidence, and a name
            must hold there.
        unnamed: what a law without a name would gain beside a fit, site by site, in ln evidence.
        axes: what turns the robot about one axis (:func:`twin.diagnose.hypotheses.same_axes`).
        processes: what was not fitted to is predicted in so many.
    """
    numbers = calibration()
    sites: dict[str, int] = {}
    for variants in suspects:
        sites[variants[0].family] = sites.get(variants[0].family, 0) + 1
    best_misfit = min([base.misfit, *(fit.misfit for fit in fits)])
    scale = max(1.0, best_misfit) if scale is None else scale
    gains = _of_sites(fits, np.array([fit.evidence(scale) - base.evidence(scale) for fit in fits]), scale)
    unseen = _unseen([*fits, base], _near(gains), kept, processes) if kept else None
    later = _later(gains, scale, unseen) if unseen else np.zeros(len(fits))
    priors = np.array([_prior(fit.hypothesis, sites, numbers["none"]) for fit in fits])
    as_described = [not fit.hypothesis.own and gain <= 0 for fit, gain in zip(fits, gains, strict=True)]
    priors[as_described] = -np.inf
    beside = _beside(fits, base, scale) if handicap is None else np.asarray(handicap)
    used = _counted(gains - beside, numbers) + priors
    logs = _counted(gains - beside + later, numbers) + priors
    both, before = (np.logaddexp.reduce([*some, np.log(numbers["none"])]) for some in (logs, used))
    gained = max(float(both - before), 0.0)
    lawless = _lawless(fits, base, scale, logs, gained, unnamed, len(sites), numbers) if unnamed else -np.inf
    weights = np.array([*logs, np.log(numbers["none"]), lawless])
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()
    names, nothing, nameless = weights[:-2], weights[-2], float(weights[-1])
    names, together = _shared(names, fits, axes) if axes else (names, names)
    first = np.lexsort((-names, -together))[:1]  # what is likeliest on the axis that is
    order = np.concatenate([first, np.setdiff1d(np.argsort(-names, stable=True), first, assume_unique=True)])
    noise = most_noise(base)
    if other is None:
        left = _left(base.misfit, best_misfit, noise)
        if unseen and len(order) and nothing < 0.5:
            bare, named = (unseen(k) for k in (len(fits), int(order[0])))
            left = max(
                left, _left(misfit_unseen(bare), misfit_unseen(named), numbers["held_out_misfit"] + scatter(named))
            )
        other = _other(left, numbers)
    none, known, nameless = (1 - other) * float(nothing), (1 - other) * names, (1 - other) * nameless
    alike = (1 - other) * float(together[order[0]]) if len(order) else 0.0
    other += nameless
    if none > 0.5 and (
        base.misfit > 2 * noise or (unseen and misfit_unseen(unseen(len(fits))) > numbers["held_out_adequate"])
    ):  # a mismatch that nothing here explains
        none, other = 0.0, other + none
    return Decision([fits[k] for k in order], [float(known[k]) for k in order], none, float(other), nameless, alike)


def _of_sites(fits: Sequence[Fitted], gains: FloatArray, scale: float) -> FloatArray:
    """Evidence of fits, where sites of one effect differ by no more than the recordings and the description say.

    How unusual an effect's own numbers are, and how exactly they are held, tells whether there is such an effect. It
    does not tell where. Of what hangs at a link it does: its mass is of any size, and the evidence is that of the
    places where it may be (:func:`twin.diagnose.refit.of_its_size`).
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for k in np.flatnonzero(np.isfinite(gains)):
        pieces = fits[int(k)].hypothesis.pieces
        if pieces and all(piece.own and piece.law and not piece.law.lever for piece in pieces):
            groups.setdefault(tuple(sorted(f"{piece.effect} {len(piece.own)}" for piece in pieces)), []).append(int(k))
    out = gains.copy()
    for members in groups.values():
        if len(members) > 1:
            costs, first = np.array([_outside_own(fits[k], scale) for k in members]), int(np.argmax(gains[members]))
            out[members] = np.maximum(gains[members], gains[members[first]] + costs[first] - costs)
    return out


def _outside_own(fit: Fitted, scale: float) -> float:
    """½ χ² and the tension of the description, without what is the effects' own."""
    described = fit.z[: len(fit.z) - len(fit.hypothesis.own)]
    return float(0.5 * (fit.misfit * fit.data / scale + described @ described))


def _shared(names: FloatArray, fits: Sequence[Fitted], axes: Mapping[str, str]) -> tuple[FloatArray, FloatArray]:
    """Probabilities of fits, and those of everything that turns the robot about the same axes as each.

    Such fits share half of their joint probability equally. It is as likely that their hinges are where the vocabulary
    has them as that they are not. Recordings may tell them apart only in the first case.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for k, fit in enumerate(fits):
        groups.setdefault(fit.hypothesis.under(axes), []).append(k)
    shared, whole = names.copy(), names.copy()
    for members in groups.values():
        shared[members] = 0.5 * (names[members] + names[members].mean())
        whole[members] = names[members].sum()
    return shared, whole


def _prior(hypothesis: Hypothesis, sites: Mapping[str, int], none: float) -> float:
    """Logarithm of a prior: every effect alike, and every site of it."""
    pieces = hypothesis.pieces or (hypothesis,)
    return float(sum(np.log((1 - none) / (len(sites) + 1) / sites.get(p.family, 10)) for p in pieces))


def _counted(gains: FloatArray, numbers: Mapping[str, float]) -> FloatArray:
    """Differences in ln evidence from the base model as they count.

    A fit is over-confident in what it gains, for no model is exact. What it loses is the volume that its numbers may
    have and the data do not need (Occam's factor), which is as large where the model is wrong.
    """
    return np.where(gains > 0, gains / numbers["temperature"], gains)


def _near(gains: FloatArray) -> list[int]:
    """Indices of hypotheses that recordings which none was fitted to may bring to the front; the best is among them."""
    if not len(gains):
        return []
    best = int(np.argmax(gains))
    return [best, *(int(k) for k in np.flatnonzero(gains > max(gains[best], 0.0) - WITHIN) if k != best)]


def _unseen(some: Sequence[Fitted], near: Sequence[int], kept: Sample, processes: int) -> Callable[[int], Fitted]:
    """Of a fit's index how it predicts recordings that none was fitted to; the near ones and the last side by side."""
    first = [*near, len(some) - 1]
    told = spread(lambda k: _on_kept(some[first[k]], kept), len(first), processes)
    known = dict(zip(first, told, strict=True))

    def of(k: int) -> Fitted:
        if k not in known:
            known[k] = _on_kept(some[k], kept)
        return known[k]

    return of


def _on_kept(fit: Fitted, kept: Sample) -> Fitted:
    """:func:`foreseen`; a fit that breaks down there (a body at its limits) predicts nothing."""
    try:
        return foreseen(fit, kept)
    except np.linalg.LinAlgError:
        return replace(fit, cost=BREAKS_DOWN, misfit=2 * BREAKS_DOWN / max(fit.data, 1))


def _later(gains: FloatArray, scale: float, unseen: Callable[[int], Fitted]) -> FloatArray:
    """What ln evidence fits gain over the base model, the last of ``unseen``, by recordings that none was fitted to.

    Hypotheses far behind the best are given what the best one gains.
    """
    if not len(gains):
        return gains
    nothing = unseen(len(gains)).evidence(scale)
    later = np.full(len(gains), unseen(int(np.argmax(gains))).evidence(scale) - nothing)
    for k in _near(gains):
        later[k] = unseen(k).evidence(scale) - nothing
    return later


def _beside(fits: Sequence[Fitted], base: Fitted, scale: float) -> FloatArray:
    """Evidence taken off fits of several things: what the others of each may be off by, without any one of them.

    A fit is in doubt no less than those it goes on from.
    """
    known = {fit.hypothesis.identity: fit for fit in fits}
    taken: dict[frozenset[str], float] = {}
    for identity in sorted(known, key=len):
        simpler = [rest for key in identity if (rest := identity - {key}) in known]
        doubts = (max(taken[rest], in_doubt(known[rest], known[identity], base, known, scale)) for rest in simpler)
        taken[identity] = max(doubts, default=0.0)
    return np.array([taken[fit.hypothesis.identity] for fit in fits])


def misfit_unseen(unseen: Fitted) -> float:
    """χ² per datum of recordings that were not fitted to, doubt of the fit's parameters beside their noise."""
    return 2 * unseen.cost / unseen.data


def _lawless(
    fits: Sequence[Fitted],
    base: Fitted,
    scale: float,
    logs: FloatArray,
    gained: float,
    unnamed: Callable[[Fitted], Mapping[str, float]],
    effects: int,
    numbers: Mapping[str, float],
) -> float:
    """Logarithm of the weight of a law without a name, alone or beside the best answer: one effect more, at any site.

    Alone it is known to first order only, which holds near the truth. Recordings that were not fitted to it is taken to
    predict as well as nothing and the names together: ``gained``, over the base model. A share ``inexact`` of what the
    best name gained is taken off: no first order is exact, no test is as stated, and that takes no name back.
    """
    models, known = [(gained, base)] if base.misfit < FIRST_ORDER else [], 0.0
    if len(logs):
        best = int(np.argmax(logs))
        known = numbers["inexact"] * max(fits[best].evidence(scale) - base.evidence(scale), 0.0)
        models.append((logs[best], fits[best]))
    found = []
    for log, fit in models:
        gains = np.array(list(unnamed(fit).values())) - known
        if len(gains):
            found.append(log + np.logaddexp.reduce(_counted(gains, numbers)) - np.log(len(gains)))
    return float(np.logaddexp.reduce(found) + np.log((1 - numbers["none"]) / (effects + 1))) if found else -np.inf


def sifted(decision: Decision, robot: Robot) -> tuple[Decision, Fitted | None]:
    """A decision between answers alone, and the fit of the likeliest if it holds what the description allows, too.

    See :func:`allowed` and :func:`excused`. Hypotheses that differ in what is allowed are one. The likeliest of them
    that needs no excuse stands for them. One that holds nothing else says that nothing is missing. A group of nodes or
    axes of which one alone is off is that one (:func:`singled_out`).
    """
    groups: dict[frozenset[str], list[tuple[Fitted, float, bool]]] = {}
    for fit, p in zip(decision.ranked, decision.probability, strict=True):
        fit = singled_out(fit, decision.ranked, robot) or fit
        loose = allowed(fit, robot)
        off = [piece for piece in excused(fit, decision.ranked, robot) if piece not in loose]
        fit = replace(fit, allowed=(*loose, *off))
        groups.setdefault(fit.answers, []).append((fit, p, not off))
    if not any(fit.allowed for some in groups.values() for fit, *_ in some):
        return decision, None
    same = bool(next(iter(groups)))  # what is likeliest of all is an answer
    nothing = groups.pop(frozenset(), [])
    left = [(_excusing(some), sum(p for _, p, _ in some)) for some in groups.values()]
    none = decision.none + sum(p for _, p, _ in nothing)
    beside = _excusing(nothing) if nothing and none > max((p for _, p in left), default=0.0) else left[0][0]
    left[1:] = sorted(left[1:], key=lambda pair: -pair[1])
    alike = max(decision.alike, left[0][1]) if same else 0.0
    told = replace(decision, ranked=[f for f, _ in left], probability=[p for _, p in left], none=none, alike=alike)
    return told, beside if beside.allowed else None


def _excusing(some: Sequence[tuple[Fitted, float, bool]]) -> Fitted:
    """The likeliest of some fits all of whose pieces that are allowed are so in itself; else the likeliest."""
    return max(some, key=lambda one: one[2])[0]


def that_show(fits: Sequence[Fitted], robot: Robot, band_hz: tuple[float, float] = (0.0, np.inf)) -> list[Fitted]:
    """The fits without those of which a piece takes next to nothing off what the recordings are missed by.

    Beside the other answers it only relieves numbers far from their description, and tension alone names no second
    thing. Pieces that the description allows are no answers (:func:`allowed`). What adds a mode that is nowhere in the
    recorded band does not show either: it is a mass or a spring there, or an error. Nor may any be what it cannot be
    (:func:`cannot_be`).
    """
    known, least = {fit.hypothesis.identity: fit for fit in fits}, calibration()["seen"]

    def missed(fit: Fitted) -> float:
        """½ χ² of the recordings, angles of postures among them."""
        unrecorded = np.array([p.kind != "posture" for p in fit.parameters])
        return float(fit.cost - 0.5 * np.sum(fit.z[unrecorded] ** 2))

    def heard(fit: Fitted, piece: Hypothesis) -> bool:
        values = {p.quantity: x for p, x in zip(fit.parameters, fit.values, strict=True) if p.site == piece.key}
        if not piece.law or not piece.law.adds_mode or "frequency_hz" not in values:
            return True
        frequency, half_width = values["frequency_hz"], values["damping_ratio"] * values["frequency_hz"]
        return bool(frequency - half_width <= band_hz[1] and frequency + half_width >= band_hz[0])

    def possible(fit: Fitted, piece: Hypothesis) -> bool:
        return not cannot_be(fit, piece, band_hz)

    def shows(fit: Fitted, piece: Hypothesis) -> bool:
        rest = known.get(fit.hypothesis.identity - {piece.key})
        angles = any(name.startswith("posture.") for name, _ in piece.scale)  # recorded less exactly than was stated
        return angles or rest is None or missed(rest) - missed(fit) >= least

    dumb = set[int]()
    for fit in [fit for fit in fits if len(fit.hypothesis.pieces) > 1]:
        loose = allowed(fit, robot)
        answers = [piece for piece in fit.hypothesis.pieces if piece not in loose]
        if len(answers) > 1 and not all(shows(fit, piece) for piece in answers):
            dumb.add(id(fit))
    for said in (heard, possible):
        dumb |= {id(fit) for fit in fits if not all(said(fit, piece) for piece in fit.hypothesis.pieces)}
    return [fit for fit in fits if id(fit) not in dumb]


def half_unnamed(decision: Decision) -> Decision:
    """The decision of a search that was ended before it explained a recording: what it did not try is as likely."""
    half = [0.5 * p for p in decision.probability]
    return replace(decision, probability=half, other=decision.other + sum(half), alike=0.5 * decision.alike)


def in_doubt_beside(decision: Decision, base: Fitted, kept: Sample | None) -> Decision:
    """A decision that trusts its name no further than it explains what is left beside what the description allows.

    Args:
        base: the base model with that free, which may explain most of what the name was thought to.
        kept: hammer tests that were not fitted to.
    """
    if not decision.probability or decision.probability[0] <= max(decision.none, decision.other):
        return decision
    numbers, best = calibration(), decision.ranked[0]
    left = _left(base.misfit, best.misfit, most_noise(base))
    if kept:
        bare, named = (foreseen(fit, kept) for fit in (base, best))
        left = max(left, _left(misfit_unseen(bare), misfit_unseen(named), numbers["held_out_misfit"] + scatter(named)))
    other = _other(left, numbers)
    if other <= decision.other:
        return decision
    known = (1 - other) / (1 - decision.other)
    names = [known * p for p in decision.probability]
    return replace(decision, probability=names, none=known * decision.none, other=other, alike=known * decision.alike)


def finalists(base: Fitted, fits: Sequence[Fitted]) -> tuple[dict[str, Any], ...]:
    """What a selection was made from, for other rules to choose: the base model (effect ``none``) and every fit.

    ``misfit`` is χ² + zᵀz of the optimum over ``data``; ``own_parameters`` is how many numbers were added.
    """
    return tuple(
        {
            "effect": fit.hypothesis.effect, "site": fit.hypothesis.site, "misfit": 2 * fit.cost / max(fit.data, 1),
            "data": fit.data, "own_parameters": len(fit.hypothesis.own) or len(fit.hypothesis.scale),
            "ln_bayes_factor": fit.evidence() - base.evidence(),
        }
        for fit in (base, *fits)
    )  # fmt: skip


def unexplained(before: float, after: float, noise: float) -> float:
    """Probability that something without a name is missing, of misfits without and with the best hypothesis.

    Args:
        before, after: χ² per datum; ``noise`` what it would be of noise alone.
    """
    return _other(_left(before, after, noise), calibration())


def _left(before: float, after: float, noise: float) -> float:
    """Share of a misfit beyond noise that an answer leaves; one where it makes it worse."""
    return max(after - noise, 0.0) / max(before - noise, after - noise, 1e-9)


def _other(left: float, numbers: Mapping[str, float]) -> float:
    """Probability that what the best hypothesis leaves is a different physics."""
    odds = (left - numbers["unexplained_share"]) / numbers["unexplained_width"]
    return float(np.clip(1 / (1 + np.exp(-odds)), 0.01, 0.99))
