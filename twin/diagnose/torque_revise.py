"""What was found, looked at again beside all that came later: grown, exchanged, put together or taken out."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import cycle

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.torque_fit import base_fit, evaluate, fitted, refine, settle, worth
from twin.diagnose.torque_judge import Judge
from twin.diagnose.torque_look import decided, look, widened_fits
from twin.diagnose.torque_step import REFITTED, Step, accepted, freed_by, left_out, own_rows, possible
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import (
    System,
    Trial,
    own_prior,
    own_values,
    relinearised,
    rescaled,
    unshrunk,
    with_doubts,
    with_wider,
    within_reach,
)
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.physics.effect import axis_of
from twin.robot.description import Entry


def one_for_two(
    steps: list[Step], system: System, suspects: Sequence[Suspect], judge: Judge | None, processes: int
) -> System:
    """The model with one thing at a joint instead of two, where one explains as much.

    An effect may have two forms, as a torque constant that is off or falls. The first look may have taken the wrong
    one, and the next what that lacks.
    """
    found = [s for s in steps if s.accepted and len(s.joints) == 1]
    for joint in {s.joints for s in found}:
        both = [s for s in found if s.joints == joint][-2:]
        if len(both) < 2 or any(s.effect.memory for s in both):
            continue
        rest = left_out(system, *both)
        there = [s for s in suspects if s.hypothesis.site.partition(".")[0] == f"joint{joint[0] + 1}"]
        step = look(rest, there, lambda count: None, processes)
        if step.trial is None or step.joints != joint:
            continue
        step.trials[step.key] = unshrunk(step.trial)
        one = accepted(rest, step)
        if _likely(one, judge) > _likely(system, judge) - calibration()["tie"] and possible(one, step):
            for other in both:
                other.accepted = False
            step.accepted, system = True, one
            steps.append(step)
    return system


def _likely(system: System, judge: Judge | None) -> float:
    """ln evidence of all rows, those kept aside among them."""
    fit = base_fit(system)
    return fit.evidence() + (judge.density(system, fit) if judge is not None else 0.0)


def revised(steps: list[Step], system: System, suspects: Sequence[Suspect], judge: Judge | None) -> System:
    """The model with each find put to its rivals once more, all other finds beside it.

    What was found first was the best of all without the others. Where another now makes all rows more likely, those
    kept aside among them, it takes its place.
    """
    if sum(step.accepted for step in steps) < 2:
        return system
    for number, step in enumerate(steps):
        gains = {fit.hypothesis.key: fit.evidence() - step.base.evidence() for fit in step.decision.ranked}
        rivals = [
            trial for key, trial in step.trials.items() if gains.get(key, 0.0) > calibration()["mostly"] * step.gain
        ]
        if not step.accepted or step.trial is None or len(rivals) < 2:
            continue
        others = left_out(system, step, iterations=REFITTED)
        trials = {t.suspect.hypothesis.key: settle(others, _as_suspected(t, suspects)) for t in rivals}
        fits = [*(fitted(others, t) for t in trials.values()), *widened_fits(others, suspects)]
        again = decided(others, trials, fits, suspects)
        if again.key == step.key or again.trial is None or _refines(again, step):
            continue
        other = accepted(others, again)
        if _likely(other, judge) > _likely(system, judge) + calibration()["tie"] and possible(other, again):
            again.trials[again.key] = unshrunk(again.trial)
            again.accepted, again.held = True, step.held
            steps[number], system = again, other
    return system


def _refines(step: Step, plain: Step) -> bool:
    """Whether a find is the law of another at the same joint, refined: it may stand beside it, not in its place."""
    return step.joints == plain.joints and step.effect.refines == plain.effect.part != ""


def _as_suspected(trial: Trial, suspects: Sequence[Suspect]) -> Trial:
    """A trial with the priors that its suspect had before it was found, those of its first element for every one."""
    same = [s for s in suspects if s.name == trial.suspect.name]
    first = next((s for s in same if s.form == trial.suspect.form), same[0]).hypothesis.own
    hypothesis = trial.suspect.hypothesis
    own = tuple(replace(p, deviation=q.deviation) for p, q in zip(hypothesis.own, cycle(first), strict=False))
    suspect = replace(trial.suspect, hypothesis=replace(hypothesis, own=own))
    return replace(trial, suspect=suspect, u=own_prior(own, own_values(hypothesis.own, trial.u)))


def all_grown(steps: Sequence[Step], system: System, judge: Judge | None) -> System:
    """The model with slip of as many elements as the rows bear, before another law is sought for what one leaves."""
    for step in steps:
        if step.accepted and step.effect.elements and not step.grown:
            system, step.grown = _grown(step, system, judge), True
    return system


def _grown(step: Step, system: System, judge: Judge | None, most: int = 3) -> System:
    """The model with as many slip elements at a joint as the rows bear, up to ``most``: one is a first guess only."""

    def likely(model: System) -> tuple[float, float]:
        fit = base_fit(model)
        return fit.evidence(), judge.density(model, fit) if judge is not None else 0.0

    others = left_out(system, step)
    wide = with_wider(others, freed_by(others, step))
    before = likely(system)
    for _ in range(most - 1):
        trial = step.trials[step.key]
        trial = replace(trial, u=system.z[system.own(trial.suspect)])
        starts = [evaluate(wide, *_with_element(trial, factor), slopes=False) for factor in (0.1, 10.0)]
        best = max(starts, key=lambda t: t.gain)
        longer = replace(step, trials={step.key: refine(wide, evaluate(wide, best.suspect, best.u), 4)})
        grown = accepted(others, longer)
        after = likely(grown)
        numbers = calibration()
        if after[0] - before[0] < max(numbers["further"], numbers["inexact"] * step.gain) or after[1] < before[1]:
            break
        if not _clear(grown, longer):
            break
        step.trials[step.key] = longer.trials[step.key]
        system, before = grown, after
    return system


def _clear(system: System, step: Step) -> bool:
    """Whether what cannot be negative of something found is so beyond doubt."""
    suspect = step.trials[step.key].suspect
    values, doubt = own_rows(system, suspect)
    sizes = suspect.nonnegative & ~np.array([p.log for p in suspect.hypothesis.own])
    return bool((values > calibration()["far"] * doubt)[sizes].all())


def _with_element(trial: Trial, factor: float) -> tuple[Suspect, FloatArray]:
    """A slip suspect with one element more, of half the strongest's torque and ``factor`` of its travel."""
    suspect, hypothesis, names = trial.suspect, trial.suspect.hypothesis, trial.suspect.effect.elements
    width = len(names)
    values = own_values(hypothesis.own, trial.u).reshape(-1, width)
    new = suspect.effect.another(values, factor)
    count = len(values)
    (entry,) = hypothesis.entries
    first = hypothesis.own[:width]
    own = [*hypothesis.own, *(replace(p, name=p.name.replace("[0]", f"[{count}]")) for p in first)]
    lists = {name: [*entry.values[name], entry.values[name][0]] for name in names}
    longer = Entry.model_validate({"effect": entry.effect, "site": entry.site, **lists})
    grown = replace(
        suspect, hypothesis=replace(hypothesis, entries=(longer,), own=tuple(own)),
        nonnegative=np.concatenate([suspect.nonnegative, suspect.nonnegative[:width]]),
    )  # fmt: skip
    return grown, own_prior(own, np.concatenate([values.ravel(), new]))


def pruned(steps: Sequence[Step], system: System, doubtful: float = 10.0, last: bool = False) -> System:
    """The model without the finds that later finds have made needless, least needed first. Those are accepted no more.

    Leaving a find out may lose at once ``doubtful`` times what it needs: the model is then not tried without it. Finds
    that act on the same joint, or on the recording, as the last find does, are tried in any case. The ``last`` find is
    looked at where the search is over: what it gained may have come from numbers that settled when it was taken in.
    """
    further = calibration()["further"]
    while True:
        found = [s for s in steps if s.accepted]
        shorter = {
            k: left_out(system, step, iterations=REFITTED)
            for k, step in enumerate(found if last else found[:-1])
            if step.trial is None
            or _side_by_side(step, found[-1])
            or worth(system, step.trial.suspect) < doubtful * further
        }
        evidence = base_fit(system).evidence()
        lost = {k: evidence - base_fit(rest).evidence() for k, rest in shorter.items()}
        # of what was found last the runs kept aside had their say: it is out where next to nothing is there
        least = {k: further if k < len(found) - 1 else calibration()["first"] for k in lost}
        needless = min((k for k in lost if lost[k] <= least[k]), key=lambda k: lost[k], default=None)
        if needless is None:
            return system
        found[needless].accepted, system = False, relinearised(shorter[needless])


def _side_by_side(one: Step, other: Step) -> bool:
    """Whether two finds act on the same joint, or both on the recording, which is at all joints."""
    if one.effect.records_torque and other.effect.records_torque:
        return True
    return len(other.joints) < 3 and bool(set(one.joints) & set(other.joints))


def bounded(steps: Sequence[Step], system: System) -> System:
    """The model with those moments of inertia of loads held near zero that come out below it beyond doubt.

    No body has such a moment. Friction of a joint that gives way before it slips passes for less inertia about its
    axis. Left free, that would draw the mass and its place along. A held moment has the prior deviation doubt²/|value|:
    so wide is the part above zero of a normal density whose mean lies far below.
    """
    for step in steps:
        if not step.accepted or step.trial is None or step.effect.part != "mass":
            continue
        for _ in step.trial.suspect.nonnegative.nonzero()[0][1:]:  # the first is the mass; holding one moves the others
            values, doubt = own_rows(system, step.trial.suspect)
            below = step.trial.suspect.nonnegative & (values < -NINETY * doubt)
            if below[0] or not below.any():
                break
            scale = np.ones(len(values))
            deviation = np.array([p.deviation for p in step.trial.suspect.hypothesis.own])
            scale[below] = doubt[below] ** 2 / (-values[below] * deviation[below])
            rest = left_out(system, step)
            step.trials[step.key] = rescaled(step.trial, scale)
            system = accepted(rest, step)
    return system


def foretelling(steps: Sequence[Step], system: System, judge: Judge | None) -> System:
    """The model without what does not predict the rows kept aside, beside all else that was found.

    Each was borne out when it was found. What was found after it may do its work, or have drawn its numbers along.
    Of those that fail, the one that the rows kept aside hold least is out first, and the others are asked again. Where
    what is left cannot be fitted alone, there is nothing to compare with.
    """
    while judge is not None:
        failed: list[tuple[float, Step, System]] = []
        for step in steps:
            if step.accepted:
                rest = left_out(system, step, iterations=REFITTED)
                if not (within_reach(rest) and within_reach(system)):
                    continue
                told = judge.keeps(rest, system, step)
                if not (told.enough and told.falls):
                    failed.append((told.rise, step, rest))
        if not failed:
            break
        _, worst, rest = min(failed, key=lambda one: one[0])
        worst.accepted, system = False, with_doubts(relinearised(rest))
    return system


def at_once(system: System, suspect: Suspect, otherwise: float = 0.05) -> list[int]:
    """Which slip elements (their numbers) turn round between two samples of the record after nearly every reversal.

    ``otherwise`` is the share of reversals after which the axis may move less.

    Of their travel a log shows nothing but what creeps at rest.
    """
    moved, _ = _after_reversals(system, axis_of(suspect.hypothesis.site))
    if not moved.size:
        return []
    effect = suspect.effect
    values = own_values(suspect.hypothesis.own, system.z[system.own(suspect)]).reshape(-1, len(effect.elements))
    return np.flatnonzero(effect.travel(values) < np.quantile(moved, otherwise)).tolist()


def seen_at_rest_only(system: System, suspect: Suspect) -> bool:
    """Whether an axis is past the speed over which its friction falls one sample after most of its reversals.

    Of how friction falls with speed such a record shows nothing, only that more is held at rest than in motion.
    """
    _, speed = _after_reversals(system, axis_of(suspect.hypothesis.site))
    own = suspect.hypothesis.own
    values = dict(zip((p.quantity for p in own), own_values(own, system.z[system.own(suspect)]), strict=True))
    return bool(speed.size and np.median(speed) > values[suspect.effect.fades_over])


def _after_reversals(system: System, joint: int) -> tuple[FloatArray, FloatArray]:
    """How far a joint has moved one sample of the record after each reversal, and its speed then."""
    moved, speed = [], []
    for run in system.base.runs:
        x, v = run.dense.position[:, joint], run.dense.velocity[:, joint]
        sign = run.dense.sign(v)
        later = max(1, round(1 / (run.sample_hz * (run.dense.time[1] - run.dense.time[0]))))
        turns = np.flatnonzero(sign[1:] * sign[:-1] < 0)
        turns = turns[turns + later < len(x)]
        moved.append(np.abs(x[turns + later] - x[turns]))
        speed.append(np.abs(v[turns + later]))
    return np.concatenate(moved), np.concatenate(speed)
