"""Numbers of a description that a log shows to be wrong, as answers of their own beside what is missing.

Every fit has these numbers free within their tolerance, so no prediction becomes better with a hypothesis that widens
one. What counts is the model that has the number as described and all others free: does it miss the runs kept aside?
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision
from twin.diagnose.departures import STRAINED
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import base_fit
from twin.diagnose.torque_look import in_its_link, number_groups
from twin.diagnose.torque_revise import pruned
from twin.diagnose.torque_search import Search
from twin.diagnose.torque_step import Step, accepted, possible, too_narrow
from twin.diagnose.torque_system import System, relinearised, with_wider
from twin.diagnose.verdict import estimates
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.model.regressor import body_of
from twin.physics import CATALOGUE, effect_of
from twin.physics.effect import axis_of
from twin.robot.frames import inertia_six

PARAMETER, ROTOR = "parameter", ".rotor_inertia"
AS_DESCRIBED = 1e-6  # times its tolerance: as far off as a number is that is held as described


def far_off(search: Search, fit: Fitted | None = None) -> list[tuple[int, float]]:
    """Numbers of the description that come out far from it beside all that was found, farthest first.

    Index and standard deviations. Left out is what was named, or told with all tolerances that are too narrow.

    Args:
        fit: with a law that has no name; that of all names by default.
    """
    system, fit = search.system, fit or search.after
    root = fit.parameters.root
    off = np.abs(root @ fit.z) / np.maximum(np.linalg.norm(root, axis=1), 1e-300)
    for k, factor in system.widened.items():
        off[k] = 0.0 if search.narrow == 1.0 else off[k] * factor
    described = np.arange(system.base.spread.shape[1])
    return [(int(k), float(off[k])) for k in described[np.argsort(-off[described])] if off[k] > STRAINED]


def as_described(search: Search) -> Fitted:
    """The base model as it would be without the answer: numbers that are answered are held as described."""
    base, plain = search.first.base, search.plain
    answers = [step.first.hypothesis for step in search.found if step.trial is None]
    names = {name for numbers in [*answers, *search.stand_ins] for name, _ in numbers.scale}
    if not names:
        return base
    held = _held(plain, sorted(names))
    z = held.plain(base_fit(held).z)
    return replace(base, z=z, described=plain.robot(z))


def told(search: Search, refused: Sequence[Fitted] = ()) -> Search:
    """A search with the one number, or numbers of one body, that come out far from the description, as an answer.

    Where several come out far, and none of them brings the others back, which is wrong is not clear. They are warnings
    then, as they are where other numbers make up for one that is held as described, and where the log stays unexplained
    with them: numbers make up for physics that is missing.

    Args:
        refused: effects that explain no more than these numbers do. A load is a rival, see :func:`_loads`. One that has
            more evidence than the numbers comes first, and they stand for it.
    """
    if search.other[1] > 0.5:
        return search
    hypothesis = _one_thing(search)
    if hypothesis is None or not _shows(search, hypothesis):
        return _wider(search)
    system = search.system
    fit = base_fit(with_wider(system, hypothesis), hypothesis)
    rivals = _loads(search, hypothesis, fit, refused)
    chance = calibration()["told"]
    share = chance / (1 + len(rivals))
    other = calibration()["least_other"]
    trials = {key: trial for last in search.steps[-1:] if last.system is system for key, trial in last.trials.items()}
    load = next((r for r in rivals if r.hypothesis.key in trials and r.evidence() > fit.evidence()), None)
    ranked = [load, fit, *(r for r in rivals if r is not load)] if load else [fit, *rivals]
    decision = Decision(ranked, [share] * len(ranked), 1 - chance - other, other)
    step = Step(system, base_fit(system), decision, trials if load else {}, accepted=True)
    steps = [*search.found, step, *(s for s in search.steps if not s.accepted)]
    after = accepted(system, step)
    first = search.first if search.found else step
    numbers = (hypothesis,) if load else ()
    found = replace(search, first=first, steps=steps, system=after, after=base_fit(after), stand_ins=numbers)
    if search.judge is not None:
        found.held_out_misfit = search.judge.misfit(after, found.after)
    if found.held_out_misfit > calibration()["held_out_adequate"]:
        return _wider(search)
    return found


def numbers_of_answer(system: System, fit: Fitted, hypothesis: Hypothesis) -> dict[str, Any]:
    """Value, unit and 90 % interval of the numbers of the description that a hypothesis frees, as a fit has them.

    Of a link the numbers of the body: torque is linear in its moments, of which centre and inertia are ratios.
    """
    if hypothesis.effect == effect_of("inertia").name:
        return _at_joint(system, fit, hypothesis)
    link, _, quantity = hypothesis.site.partition(".")
    if hypothesis.effect != PARAMETER or not link.startswith("link"):
        return estimates(replace(fit, hypothesis=hypothesis), (hypothesis.effect, hypothesis.site))
    base, at = system.base, slice(10 * (int(link[4:]) - 1), 10 * int(link[4:]))
    plain = system.plain(np.ones(len(fit.z)))[: base.links]
    moments = base.values(system.plain(fit.z))[at]
    root = base.spread[at, : base.links] * plain
    covariance = root @ np.linalg.inv(fit.information)[: base.links, : base.links] @ root.T
    step = 1e-5 * np.maximum(np.abs(moments), 1e-3 * np.abs(moments).max())
    rows = [(_body(moments + h) - _body(moments - h)) / (2 * h.sum()) for h in np.diag(step)]
    value, slopes = _body(moments), np.stack(rows, axis=1)
    half = NINETY * np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
    whole = len(hypothesis.scale) > 9  # of the link
    found: dict[str, Any] = {}
    for name, unit, some in (("mass", "kg", slice(1)), ("com", "m", slice(1, 4)), ("inertia", "kg·m²", slice(4, 10))):
        if whole or name == quantity:
            ends = [[float(v - h), float(v + h)] for v, h in zip(value[some], half[some], strict=True)]
            numbers = [float(v) for v in value[some]]
            one = name == "mass"
            found[name] = {
                "value": numbers[0] if one else numbers, "unit": unit, "interval90": ends[0] if one else ends
            }  # fmt: skip
    return found


def _at_joint(system: System, fit: Fitted, hypothesis: Hypothesis) -> dict[str, Any]:
    """By how much a rotor's inertia is not as described, as its joint feels it through the gear."""
    number = estimates(replace(fit, hypothesis=hypothesis), (hypothesis.effect, hypothesis.site))
    squared = system.base.regressor.robot.drives[axis_of(hypothesis.site)].gear_ratio ** 2
    ((name, one),) = number.items()
    ends = [squared * end for end in one["interval90"]]
    return {name: {**one, "value": squared * one["value"], "interval90": ends}}


def _body(moments: FloatArray) -> FloatArray:
    """Mass, centre of mass and inertia about it, (10,), of the moments (10,) of a link."""
    mass, com, inertia = body_of(moments)
    return np.array([mass, *com, *inertia_six(inertia)])


def _wider(search: Search) -> Search:
    """A search with all tolerances as wide as they turn out, where they are far too narrow; else as it is."""
    narrow = too_narrow(search.system, search.after)
    if not narrow.scale:
        return search
    system = pruned(search.steps, relinearised(with_wider(search.system, narrow)))
    return replace(search, system=system, after=base_fit(system), narrow=narrow.scale[0][1])


def taken_back(search: Search) -> Search | None:
    """The search without effects that make no prediction better, where one thing of the description stands for them.

    A load that has more evidence than the numbers that stand for it stays, and they are its rival.
    """
    effects = [step for step in search.found if step.trial is not None and possible(search.system, step)]
    refused = [fit for step in effects for fit in step.decision.ranked]
    back = told(bare(search), refused)
    if not back.found:
        return None
    (answer,) = back.found
    numbers, *loads = answer.decision.ranked
    ranked = sorted(loads, key=lambda load: -load.evidence())
    if len(effects) != 1 or effects[0].first is not next(iter(ranked), None):
        return back
    if effects[0].first.evidence() < numbers.evidence():
        return back
    decision = replace(answer.decision, ranked=[*ranked, numbers])
    steps = [replace(effects[0], decision=decision) if step is effects[0] else step for step in search.steps]
    return replace(search, steps=steps, stand_ins=(numbers.hypothesis,))


def bare(search: Search) -> Search:
    """The search without anything that it found."""
    return replace(
        search, steps=[], system=search.plain, after=base_fit(search.plain), left=search.free, narrow=1.0,
        held_out_misfit=search.bare,
    )  # fmt: skip


def _one_thing(search: Search) -> Hypothesis | None:
    """The fewest numbers of one kind, or of one link, that bring all that is far off back if they are free."""
    far = dict(far_off(search))
    groups = number_groups(search.system)
    off = [(key, members) for key, members in groups.items() if any(k in far for k in members)]
    if len(off) > 1:  # all of a link, under the name of its mass
        for link in sorted({site.partition(".")[0] for (_, site), _ in off if site.startswith("link")}):
            members = [k for (_, site), some in groups.items() if site.startswith(f"{link}.") for k in some]
            off.append(((PARAMETER, f"{link}.mass"), members))
    names = search.system.parameters.names
    for (effect, site), members in sorted(off, key=lambda one: len(one[1])):
        width = max(calibration()["far"], *(far.get(k, 0.0) for k in members))
        if site.endswith(ROTOR):  # a rotor's inertia is told as the effect of that name
            effect, site = effect_of("inertia").name, f"joint{site[5:].removesuffix(ROTOR)}"
        hypothesis = Hypothesis(effect, site, scale=tuple((names[k], width) for k in members))
        system = relinearised(with_wider(search.system, hypothesis))
        fit = base_fit(system, hypothesis)
        if in_its_link(system, fit) and not far_off(replace(search, system=system, after=fit)):
            return hypothesis
    return None


def _shows(search: Search, hypothesis: Hypothesis) -> bool:
    """Whether a model that has these numbers as described misses the runs, all other numbers fitted."""
    held = _held(search.system, [name for name, _ in hypothesis.scale])
    without = base_fit(held)
    fall = 0.5 * (without.misfit * without.data - search.after.misfit * search.after.data)
    numbers = calibration()
    if fall < numbers["first"] * max(1.0, search.after.misfit):
        return False
    if search.judge is None:
        return True
    before, after = search.judge.rest(held, without)[0], search.judge.rest(search.system, search.after)[0]
    return 0.5 * float(before @ before - after @ after) > numbers["tie"] * max(1.0, search.after.misfit)


def _held(system: System, names: Sequence[str]) -> System:
    """The same rows with some numbers as described, all else fitted."""
    scale = tuple((name, AS_DESCRIBED) for name in names)
    return relinearised(with_wider(system, Hypothesis(PARAMETER, "", scale=scale)))


def _loads(search: Search, hypothesis: Hypothesis, fit: Fitted, refused: Sequence[Fitted]) -> list[Fitted]:
    """The best load on the link whose numbers these are, where it does most of what they do.

    And loads on other links that have no less evidence than the numbers: a mass at a joint is as well on either link.
    """
    link = hypothesis.site.partition(".")[0]
    gain = fit.evidence() - base_fit(search.system).evidence()
    looked_at = [f for step in search.steps[-1:] for f in step.decision.ranked if _gain(step, f) > gain / 2]
    loads = _carried(search, [*refused, *looked_at])
    here = [load for load, carrier in loads if carrier == link][:1]
    enough = fit.evidence() - calibration()["tie"]
    return here + [load for load, carrier in loads if carrier != link and load.evidence() > enough]


def _gain(step: Step, fit: Fitted) -> float:
    return fit.evidence() - step.base.evidence()


def _carried(search: Search, some: Sequence[Fitted]) -> list[tuple[Fitted, str]]:
    """Of fits, those of loads, each with the link that carries it."""
    robot = search.plain.base.regressor.robot
    found = []
    for fit in some:
        law = CATALOGUE.get(fit.hypothesis.effect)
        carrier = law.carrier(robot, fit.hypothesis.site) if law else None
        if carrier is not None:
            found.append((fit, f"link{carrier + 1}"))
    return found
