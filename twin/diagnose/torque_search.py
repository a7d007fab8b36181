"""From the base model to what a motion log says is missing: screen, refine, decide, go on with it in the model.

Each thing found must lower the error on runs that were not used. It gives way to a simpler one within reach: no law is
exact, so a richer one nearly always fits better. What is found at a joint must reach most of what a free function of
its state gains (``named_reach`` of the calibration). Otherwise something there may have no name.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np
import scipy.fft

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision, decide, finalists
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_discover import discover, unnamed
from twin.diagnose.torque_fit import (
    Base,
    Columns,
    System,
    Trial,
    base_fit,
    base_of,
    eliminated,
    evaluate,
    extended,
    fitted,
    from_every_start,
    linearised,
    own_prior,
    own_values,
    reach,
    refer,
    refine,
    relinearised,
    settle,
    span_of,
    start,
    unshrunk,
    with_doubts,
    with_wider,
    without,
    worth,
)
from twin.diagnose.torque_laws import USUAL_SHARE, Suspect, smooth_columns
from twin.diagnose.torque_numbers import GAIN, effect_of_number
from twin.diagnose.torque_signal import Run
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.parallel import Progress, spread
from twin.physics import effect_named, effect_of
from twin.physics.effect import Effect, axis_of
from twin.physics.payload import Payload
from twin.ranges import implausible
from twin.robot.description import Entry

REFITTED = 3  # steps of all numbers beside what is judged or left out: all were refined before


@dataclass
class Step:
    """One thing looked for with all found before it in the model.

    Attributes:
        system: the base model then; ``base`` its fit.
        decision: who explains what it misses.
        trials: of the ranked hypotheses, by key; a number of the base model has none.
        held: rise of the ln predictive density of the rows kept aside, with the first of the ranked.
        accepted: it goes into the model.
        grown: its slip has as many elements as the rows bear.
    """

    system: System
    base: Fitted
    decision: Decision
    trials: dict[str, Trial]
    held: float = 0.0
    accepted: bool = False
    grown: bool = False

    @property
    def first(self) -> Fitted:
        """The most probable."""
        return self.decision.ranked[0]

    @property
    def trial(self) -> Trial | None:
        """Of the first, ``None`` where it is a number of the base model."""
        return self.trials.get(self.key)

    @property
    def effect(self) -> Effect:
        """What the first is."""
        return effect_named(self.first.hypothesis.effect)

    @property
    def key(self) -> str:
        """``EFFECT@SITE`` of the first."""
        return self.first.hypothesis.key

    @property
    def joints(self) -> tuple[int, ...]:
        """Zero-based, on which the first acts; none where it is a number of the base model."""
        return self.trial.column.joints if self.trial else ()

    @property
    def misfit(self) -> float:
        """χ² per datum that the first leaves on the joints it acts on: above one, where no law here is exact."""
        if self.trial is None:
            return self.first.misfit
        system, rest = self.system, _left(self.system, self.trial)
        energy = sum(float(np.sum(rest[system.rows(j)] ** 2)) for j in self.joints)
        return energy / (system.count * float(system.level[list(self.joints)].sum()))

    @property
    def gain(self) -> float:
        """Evidence of the first over the model before it."""
        return self.first.evidence() - self.base.evidence()

    @property
    def borne(self) -> float:
        """The same with the description's tolerances as wide as they turn out beside the first.

        Birge's ratio, applied to priors. Numbers may stay far from their description, whatever is missing: the
        tolerances are then too narrow. An effect that makes up for numbers held back, or relieves their tension, then
        counts less by this factor.
        """
        strained = too_narrow(self.system, self.first)
        if not strained.scale:
            return self.gain
        wide = with_wider(self.system, strained)
        if self.trial is None:
            fit = base_fit(with_wider(wide, self.first.hypothesis), self.first.hypothesis)
        else:
            fit = fitted(wide, refine(wide, evaluate(wide, self.trial.suspect, self.trial.u), REFITTED))
        return fit.evidence() - base_fit(wide).evidence()


def too_narrow(system: System, fit: Fitted) -> Hypothesis:
    """The description's tolerances as wide as a fit of a system shows them to be, where they are far too narrow."""
    described = np.arange(system.base.spread.shape[1])
    held = float(np.sum(1 - np.diag(np.linalg.inv(fit.information))[described]))
    tension = float(np.sum(fit.z[described] ** 2)) / max(held, 1.0)
    far = calibration()["far"] ** 2
    names = [system.parameters.names[k] for k in described] if tension > far else []
    return Hypothesis("parameter", "description", scale=tuple((name, float(np.sqrt(tension))) for name in names))


@dataclass
class Search:
    """What was found.

    Attributes:
        plain: the base model; ``first`` what was looked for first.
        steps: in order; the last was not accepted, or was the last allowed.
        system: with all that was accepted; ``after`` its fit.
        free, left: per joint, evidence gained by a free function of its state, before and after.
        other: the joint where something without a name is likeliest, and the probability that it is there.
        law: what was discovered there, with the joint it is at.
        judge: the rows kept aside, where there are any.
        foretold: χ² per datum of the rows kept aside under all that was found, doubt of its numbers beside their noise;
            ``bare`` the same under the base model.
        narrow: times as wide as described the tolerances of the description were taken in the end.
        stand_ins: numbers of the description that explain as much as what was found, if they are far off.
    """

    plain: System
    first: Step
    steps: list[Step]
    system: System
    after: Fitted
    free: FloatArray
    left: FloatArray
    other: tuple[int, float] = (0, 0.0)
    law: tuple[int, Trial, Fitted] | None = None
    judge: "Judge | None" = None
    foretold: float = 0.0
    bare: float = 0.0
    narrow: float = 1.0
    stand_ins: tuple[Hypothesis, ...] = ()

    @property
    def finalists(self) -> tuple[dict[str, Any], ...]:
        """What the first selection was made from."""
        return finalists(self.first.base, self.first.decision.ranked)

    @property
    def aside(self) -> Base | None:
        """The base model's columns on the rows kept aside, where there are any."""
        return self.judge.base if self.judge else None

    @property
    def found(self) -> list[Step]:
        """Those whose first answer is in the model."""
        return [step for step in self.steps if step.accepted]

    def reached(self, joint: int) -> float:
        """Share of what a free function would gain at a joint that names reach."""
        named = sum(step.gain for step in self.found if step.trial is None or joint in step.trial.column.joints)
        named = max(named, self.free[joint] - self.left[joint])  # of what a later find made needless, the gain remains
        return float(named / max(named + max(self.left[joint], 0.0), 1e-9))

    def unreached(self) -> tuple[int, float]:
        """The joint where names explain least of what is missing, and the probability that it has no name here."""
        numbers = calibration()
        worst, most = 0, numbers["least_other"]
        least = max(numbers["first"], numbers["unnamed_share"] * sum(step.gain for step in self.found))
        for joint, left in enumerate(self.left):
            if left > least:
                short = (numbers["named_reach"] - self.reached(joint)) / numbers["unexplained_width"]
                p = float(np.clip(1 / (1 + np.exp(-short)), numbers["least_other"], 0.99))
                if p > most:
                    worst, most = joint, p
        return worst, most


def explain(
    system: System, kept: Sequence[Run], suspects: Sequence[Suspect], progress: Progress | None = None,
    processes: int = 1, rounds: int = 5,
) -> Search:  # fmt: skip
    """Look for what is missing, one thing after the other; where names do not reach, for a law.

    Args:
        system: base model on the rows used.
        kept: runs (or blocks) not used.
        suspects: all that could be missing.
        processes: what can be is spread over so many.
        rounds: of looking for more with what was found in the model, at most.
    """
    plain = system
    progress = progress or (lambda description, total: lambda count: None)
    judge = Judge(system, kept) if kept else None
    free = free_gains(system, processes)
    steps, system = _whole_kinds(system, suspects, judge)
    for number in range(rounds):
        known = {s.name for s in system.found}
        open_ = [s for s in suspects if s.name not in known]
        step = _look(system, open_, progress("screen" if not number else "look for more", len(open_)), processes)
        step = _first_borne_out(step, steps, open_, judge)
        steps.append(step)
        if not step.accepted:
            break
        system = accepted(system, step)
        for beside in _elsewhere(step, system, open_):
            if _borne_out(beside, steps, judge):
                steps.append(beside)
                system = accepted(system, beside)
        system = _one_for_two(steps, pruned(steps, system), suspects, judge, processes)
        system = with_doubts(_all_grown(steps, system, judge))
    first = steps[0]  # beside the base model alone; what takes its place later stands beside other finds
    system = pruned(steps, _revised(steps, system, suspects, judge))
    system = with_doubts(_all_grown(steps, system, judge))
    left = free_gains(system, processes, judge)
    search = Search(plain, first, steps, system, base_fit(system), free, left, judge=judge)
    if judge:
        search.foretold, search.bare = judge.misfit(system, search.after), judge.misfit(plain, first.base)
    search.other = max(search.unreached(), *_outdone(search, judge), key=lambda found: found[1])
    joint, other = search.other
    if other > 0.5:
        _locate(search, joint, judge)
    return search


def _whole_kinds(system: System, suspects: Sequence[Suspect], judge: "Judge | None") -> tuple[list[Step], System]:
    """Friction of all joints at once where the description has none of a kind at several, and the model with it.

    While most of it is missing no joint's friction alone foretells a run: what the other joints lack goes into links
    and rotors. What turns out needless is taken out again.
    """
    lacking: list[Suspect] = []
    for part in ("viscous", "dry"):
        kind = [s for s in suspects if s.effect.part == part]
        lacking += kind if len(kind) > 1 else []
    steps: list[Step] = []
    here = system
    for suspect in lacking:
        trial = settle(here, start(here, suspect))
        step = _decided(here, {suspect.hypothesis.key: trial}, [fitted(here, trial)], suspects)
        if not trial.u.any():
            continue
        step.trials[step.key], step.accepted = unshrunk(trial), True
        steps.append(step)
        here = _with(here, step)
    if not steps:
        return [], system
    here = relinearised(here)
    before, after = base_fit(system), base_fit(here)
    foretold = judge is None or judge.density(here, after) > judge.density(system, before)
    if not foretold or after.evidence() - before.evidence() < calibration()["further"] * len(steps):
        return [], system
    return steps, with_doubts(pruned(steps, here))


def _outdone(search: Search, judge: "Judge | None") -> list[tuple[int, float]]:
    """Joints where a law that has no name explains more than what was named there, with no more numbers.

    With the probability that it is the truth: names and laws are alike likely, and so are all terms of the library.
    The names there lose that much of theirs.
    """
    numbers = calibration()
    found = [(0, numbers["least_other"])]
    alone = [step for step in search.found if len(step.joints) == 1]
    for joint in sorted({step.joints[0] for step in alone}):
        names = [step for step in alone if step.joints == (joint,)]
        rest = left_out(search.system, *names)
        discovered = discover(rest, joint, sum(len(s.first.hypothesis.own) for s in names))
        if discovered is None:
            continue
        law, count = discovered
        if not unnamed(law):
            continue
        fit = fitted(rest, law)
        if judge is not None and (judge.density(extended(rest, law), fit) < judge.density(search.system, search.after)):
            continue
        named = search.after.evidence() - base_fit(rest).evidence()
        lead = fit.evidence() - search.after.evidence() - numbers["inexact"] * named
        odds = lead / numbers["temperature"] - len(fit.hypothesis.own) * np.log(count)
        other = float(np.clip(1 / (1 + np.exp(-odds)), numbers["least_other"], 0.99))
        found.append((joint, other))
        for step in names:
            step.decision = replace(step.decision, probability=[(1 - other) * p for p in step.decision.probability])
    return found


def _first_borne_out(
    step: Step, earlier: Sequence[Step], suspects: Sequence[Suspect], judge: "Judge | None", tried: int = 5
) -> Step:
    """The step with the first of its answers that goes into the model; as it is where none of those ``tried`` does.

    A rival that explains most of what a refused answer does is tried, and what shows at other joints. The rest may
    stand for what was refused.
    """
    answer, refused = step, set[int]()
    for _ in range(tried):
        if _borne_out(answer, earlier, judge):
            return answer
        refused |= set(answer.joints) if len(answer.joints) == 1 else set()
        left = deque(fit for fit in answer.decision.ranked if fit.hypothesis.key != answer.key)
        while left and not (_rivals(step, left[0]) or _apart(step, left[0], refused) > calibration()["mostly"]):
            left.popleft()
        if not left:
            break
        answer = _decided(step.system, step.trials, list(left), suspects)
    return step


def _rivals(step: Step, fit: Fitted) -> bool:
    """Whether an effect explains most of what the first answer of a step does."""
    return fit.evidence() - step.base.evidence() >= calibration()["mostly"] * step.gain


def _apart(step: Step, fit: Fitted, joints: Collection[int]) -> float:
    """The share of what an effect explains that lies at other joints than some."""
    trial = step.trials.get(fit.hypothesis.key)
    if trial is None or not joints:
        return 0.0
    system = step.system
    fallen = system.residual**2 - _left(system, trial) ** 2
    by_joint = np.array([fallen[system.rows(j)].sum() for j in range(system.base.regressor.robot.axis_count)])
    total = float(by_joint.sum())
    return 1 - float(by_joint[list(joints)].sum()) / total if total > 0 else 0.0


def _left(system: System, trial: Trial) -> FloatArray:
    """What a trial leaves of the rows, the base model's numbers following."""
    return np.asarray(system.y - system.full(trial.column)[:, 0] - system.A.times(eliminated(system, trial)))


def _borne_out(step: Step, earlier: Sequence[Step], judge: "Judge | None") -> bool:
    """Whether the first answer of a step goes into the model; the runs not used have their say."""
    if not step.decision.ranked or step.decision.probability[0] < step.decision.none:
        return False
    gained, numbers = sum(other.gain for other in earlier), calibration()
    least = numbers["further"] if earlier else numbers["first"]
    needed = max(numbers["inexact"] * gained, least * max(1.0, step.misfit))
    gain = step.borne
    enough = gain > (min(needed, numbers["first"]) if judge is not None else needed)
    if enough and judge is not None:  # what runs not used say counts as what those used do
        step.held, enough = judge.gain(step.system, step.first, step.trial)
        enough = enough and gain + max(step.held, 0.0) > needed
    if enough and step.effect.waves:  # over the angle, not in time
        enough = max(vibration(step.system, j) for j in step.joints) < numbers["mostly"] * step.gain
    if not enough:
        step.decision = _nothing(step.decision)
    elif step.trial is not None:
        step.trials = {**step.trials, step.key: unshrunk(from_every_start(step.system, step.trial))}
    step.accepted = enough
    return enough


def _elsewhere(step: Step, system: System, suspects: Sequence[Suspect]) -> Iterator[Step]:
    """What the same look found at joints that its first answer does not touch, strongest first."""
    taken = set(step.trial.column.joints if step.trial else ())
    joints: dict[int, float] = {}
    for fit in step.decision.ranked:
        trial = step.trials.get(fit.hypothesis.key)
        if trial is not None and len(trial.column.joints) == 1:
            joint = trial.column.joints[0]
            joints[joint] = max(joints.get(joint, 0.0), fit.evidence() - step.base.evidence())
    for joint in sorted(joints, key=lambda j: -joints[j]):
        if joint in taken or joints[joint] < calibration()["further"]:
            continue
        again = {k: t for k, t in step.trials.items() if t.column.joints == (joint,)}
        trials = {k: refine(system, evaluate(system, t.suspect, t.u), 3) for k, t in again.items()}
        found = _decided(system, trials, [fitted(system, t) for t in trials.values()], suspects)
        yield found
        if found.accepted:
            system = accepted(system, found)


def _one_for_two(
    steps: list[Step], system: System, suspects: Sequence[Suspect], judge: "Judge | None", processes: int
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
        step = _look(rest, there, lambda count: None, processes)
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


def _likely(system: System, judge: "Judge | None") -> float:
    """ln evidence of all rows, those kept aside among them."""
    fit = base_fit(system)
    return fit.evidence() + (judge.density(system, fit) if judge is not None else 0.0)


def _revised(steps: list[Step], system: System, suspects: Sequence[Suspect], judge: "Judge | None") -> System:
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
        again = _decided(others, trials, fits, suspects)
        if again.key == step.key or again.trial is None:
            continue
        other = accepted(others, again)
        if _likely(other, judge) > _likely(system, judge) + calibration()["tie"] and possible(other, again):
            again.trials[again.key] = unshrunk(again.trial)
            again.accepted, again.held = True, step.held
            steps[number], system = again, other
    return system


def _as_suspected(trial: Trial, suspects: Sequence[Suspect]) -> Trial:
    """A trial with the priors that its suspect had before it was found, those of its first element for every one."""
    first = next(s for s in suspects if s.name == trial.suspect.name).hypothesis.own
    hypothesis = trial.suspect.hypothesis
    own = tuple(replace(p, deviation=q.deviation) for p, q in zip(hypothesis.own, cycle(first), strict=False))
    suspect = replace(trial.suspect, hypothesis=replace(hypothesis, own=own))
    return replace(trial, suspect=suspect, u=own_prior(own, own_values(hypothesis.own, trial.u)))


def accepted(system: System, *steps: Step) -> System:
    """The model with the first answers of steps in it, all fitted together."""
    for step in steps:
        system = _with(system, step)
    return relinearised(system)


def _with(system: System, step: Step) -> System:
    """The model with a step's first answer."""
    if step.trial is not None:
        system = extended(system, step.trial)
    return with_wider(system, _freed(system, step))


def left_out(system: System, *steps: Step, iterations: int = 8) -> System:
    """The model without what steps brought into it, all else fitted again from where it is."""
    for step in steps:
        if step.trial is not None:
            system = without(system, step.trial.suspect)
        freed = _freed(system, step)
        system = with_wider(system, replace(freed, scale=tuple((name, 1 / factor) for name, factor in freed.scale)))
    return relinearised(system, iterations)


def _freed(system: System, step: Step, unlike_others: float = 20.0) -> Hypothesis:
    """Numbers of the base model that a step's first answer frees; a joint whose friction slips is like no other.

    How it turns round may be ``unlike_others`` times as far from the other joints' as a joint's without slip.
    """
    hypothesis = step.first.hypothesis
    if not step.effect.memory:
        return Hypothesis("parameter", hypothesis.site, scale=hypothesis.scale)
    own = tuple(f"ordinary_presliding@joint{j + 1}." for j in step.joints)
    numbers = tuple((n, unlike_others) for n in system.base.parameters.names if n.startswith(own))
    return Hypothesis("parameter", hypothesis.site, scale=numbers)


def _all_grown(steps: Sequence[Step], system: System, judge: "Judge | None") -> System:
    """The model with slip of as many elements as the rows bear, before another law is sought for what one leaves."""
    for step in steps:
        if step.accepted and step.effect.elements and not step.grown:
            system, step.grown = _grown(step, system, judge), True
    return system


def _grown(step: Step, system: System, judge: "Judge | None", most: int = 3) -> System:
    """The model with as many slip elements at a joint as the rows bear, up to ``most``: one is a first guess only."""

    def likely(model: System) -> tuple[float, float]:
        fit = base_fit(model)
        return fit.evidence(), judge.density(model, fit) if judge is not None else 0.0

    others = left_out(system, step)
    wide = with_wider(others, _freed(others, step))
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
    values, doubt = _own(system, suspect)
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


def pruned(steps: Sequence[Step], system: System, doubtful: float = 10.0) -> System:
    """The model without the finds that later finds have made needless, least needed first. Those are accepted no more.

    Leaving a find out may lose at once ``doubtful`` times what it needs: the model is then not tried without it. Finds
    that act on the same joint, or on the recording, as the last find does, are tried in any case.
    """
    further = calibration()["further"]
    while True:
        found = [s for s in steps if s.accepted]
        shorter = {
            k: left_out(system, step, iterations=REFITTED)
            for k, step in enumerate(found[:-1])
            if step.trial is None
            or _side_by_side(step, found[-1])
            or worth(system, step.trial.suspect) < doubtful * further
        }
        if not shorter:
            return system
        needless = max(shorter, key=lambda k: base_fit(shorter[k]).evidence())
        if base_fit(system).evidence() - base_fit(shorter[needless]).evidence() > further:
            return system
        found[needless].accepted, system = False, relinearised(shorter[needless])


def _side_by_side(one: Step, other: Step) -> bool:
    """Whether two finds act on the same joint, or both on the recording, which is at all joints."""
    if one.effect.records_torque and other.effect.records_torque:
        return True
    return len(other.joints) < 3 and bool(set(one.joints) & set(other.joints))


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


def possible(system: System, step: Step) -> bool:
    """Whether the numbers of something found may be what they can be, beside all else in the model.

    A payload that is nearly a point has moments of inertia about zero, of either sign.
    """
    if step.trial is None:
        return True
    suspect = step.trial.suspect
    values, doubt = _own(system, suspect)
    return bool((values + NINETY * doubt >= 0)[suspect.nonnegative].all())


def _own(system: System, suspect: Suspect) -> tuple[FloatArray, FloatArray]:
    """The numbers (m,) of something found, beside all else in the model, and their deviations; of a scale, no doubt."""
    own, at = suspect.hypothesis.own, system.own(suspect)
    doubt = np.sqrt(np.diag(np.linalg.inv(system.information))[at])
    return own_values(own, system.z[at]), doubt * [0.0 if p.log else p.deviation for p in own]


def _locate(search: Search, joint: int, judge: "Judge | None") -> None:
    """Take names off a joint that they do not explain, and look for a law there."""
    for step in search.found:
        if step.joints == (joint,):  # what acts on others too is no law of this joint
            step.accepted = False
    system = with_doubts(accepted(search.plain, *search.found))
    search.system, search.after = system, base_fit(system)
    discovered = discover(system, joint)
    if discovered is None:
        return
    trial, _ = discovered
    fit = fitted(system, trial)
    if judge is not None and not (judge.gain(system, fit, trial)[1] and judge.moves(system, fit, trial, joint)):
        return
    beside = relinearised(extended(system, trial), REFITTED)
    needless = [
        s for s in search.found if s.trial is not None and worth(beside, s.trial.suspect) < calibration()["further"]
    ]
    if needless:  # they made up for what the law does
        for step in needless:
            step.accepted = False
        _locate(search, joint, judge)
    else:
        search.law = joint, trial, fit


def _look(system: System, suspects: Sequence[Suspect], tick: Callable[[int], None], processes: int) -> Step:
    started, kept = [], set(system.screened)
    _ = system.residual  # once, for all processes

    def begin(number: int) -> tuple[Trial, Columns | None]:
        """Of a suspect, and its columns where they are new: a process that keeps them keeps them for itself."""
        trial = start(system, suspects[number])
        name = trial.suspect.name
        return trial, None if name in kept else system.screened.get(name)

    for trial, columns in spread(begin, len(suspects), processes):
        if columns is not None:
            system.screened[trial.suspect.name] = columns
        started.append(trial)
        tick(1)
    started = list(spread(lambda number: reach(system, started[number]), len(started), processes))
    started.sort(key=lambda trial: -trial.gain)
    trials: dict[str, Trial] = {}
    best_of: dict[str, Fitted] = {}
    promising = _varied(started)
    for trial in spread(lambda number: settle(system, promising[number]), len(promising), processes):
        fit = fitted(system, trial)
        key = fit.hypothesis.key
        if key not in best_of or fit.evidence() > best_of[key].evidence():
            best_of[key], trials[key] = fit, trial
    return _decided(system, trials, [*best_of.values(), *widened_fits(system, suspects)], suspects)


def _decided(system: System, trials: dict[str, Trial], fits: Sequence[Fitted], suspects: Sequence[Suspect]) -> Step:
    """Probabilities of fits to one system, simpler ones preferred within reach."""
    base = base_fit(system)
    fits = _outermost(system, fits)
    gains = np.array([fit.evidence() for fit in fits]) - base.evidence()
    later = {k: first for k, first in [*_ladder(system, fits, gains), *_composed(fits, gains, trials)]}
    best = max((gain for k, gain in enumerate(gains) if k not in later), default=0.0)
    numbers = [_numbers(f.hypothesis) for f in fits]
    simpler, further = calibration()["simpler"], calibration()["further"]
    near = [
        m for k, (m, gain) in enumerate(zip(numbers, gains, strict=True)) if gain > simpler * best and k not in later
    ]
    handicap = [(1 - simpler) * max(best, 0.0) * (m > min(near, default=0)) for m in numbers]
    for k, first in later.items():
        handicap[k] = max(0.0, gains[k] - gains[first] + handicap[first] + further)
    hypotheses, other = [[s.hypothesis] for s in suspects], calibration()["least_other"]
    return Step(system, base, decide(fits, base, hypotheses, handicap=handicap, other=other, scale=1.0), trials)


def _outermost(system: System, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits without masses that the rows cannot tell from the same mass further out: one site has one name."""
    robot = system.base.regressor.robot

    def outward(fit: Fitted) -> tuple[int, bool]:
        site = fit.hypothesis.site
        return Payload().carrier(robot, site), not site.startswith("link")

    masses = [fit for fit in fits if effect_named(fit.hypothesis.effect).part == "mass"]
    gone = {
        id(inner) for inner in masses for outer in masses
        if outward(outer) > outward(inner) and outer.evidence() > inner.evidence() - calibration()["tie"]
    }  # fmt: skip
    return [fit for fit in fits if id(fit) not in gone]


def _numbers(hypothesis: Hypothesis) -> int:
    """How many a hypothesis has to be fitted; that a law without a name was chosen counts as one."""
    return max(len(hypothesis.own), len(hypothesis.scale)) + (effect_named(hypothesis.effect).part == "law")


def _ladder(system: System, fits: Sequence[Fitted], gains: FloatArray) -> list[tuple[int, int]]:
    """Laws that refine a plain one (dry friction) where the model has none, each with the plain one before it."""
    refined = {effect_named(fit.hypothesis.effect).refines for fit in fits} - {""}
    found = []
    for part in sorted(refined):
        name = effect_of(part).name
        present = {entry.site for entry in system.base.regressor.robot.physics if entry.effect == name}
        present |= {s.hypothesis.site for s in system.found if s.hypothesis.effect == name}
        plain = {f.hypothesis.site: k for k, f in enumerate(fits) if f.hypothesis.effect == name}
        for k, fit in enumerate(fits):
            site = fit.hypothesis.site.partition(".")[0]
            first = plain.get(site)
            refines = effect_named(fit.hypothesis.effect).refines == part and site not in present
            if refines and first is not None and gains[first] > calibration()["mostly"] * gains[k]:
                found.append((k, first))
    return found


def _composed(fits: Sequence[Fitted], gains: FloatArray, trials: dict[str, Trial]) -> list[tuple[int, int]]:
    """Entries that act on several joints where one law at each of several gains more, each with the first of those.

    A delay of the whole log beats slip at any one joint, and loses to slip at all.
    """
    best: dict[str, dict[int, int]] = {}
    further = calibration()["further"]
    for k, fit in enumerate(fits):
        trial = trials.get(fit.hypothesis.key)
        if trial is not None and len(trial.column.joints) == 1 and gains[k] > further:
            own = best.setdefault(fit.hypothesis.effect, {})
            joint = trial.column.joints[0]
            own[joint] = max(own.get(joint, k), k, key=lambda i: gains[i])
    sums = {effect: sum(gains[k] for k in own.values()) for effect, own in best.items() if len(own) > 1}
    if not sums:
        return []
    strongest = max(sums, key=lambda effect: sums[effect])
    first = max(best[strongest].values(), key=lambda k: gains[k])
    several = (k for k, f in enumerate(fits) if (t := trials.get(f.hypothesis.key)) and len(t.column.joints) > 1)
    return [(k, first) for k in several if sums[strongest] > gains[k] + further]


def _varied(started: Sequence[Trial]) -> list[Trial]:
    """The most promising, at most half of them from one effect; and the three best that act on each joint alone."""
    numbers = calibration()
    least, most = max(numbers["race"] * started[0].gain, 1.0), int(numbers["finalists"])
    kept: list[Trial] = []
    for trial in started:
        same = sum(other.suspect.hypothesis.effect == trial.suspect.hypothesis.effect for other in kept)
        if same < most // 2 and trial.gain > least:
            kept.append(trial)
        if len(kept) == most:
            break
    for joint in {trial.column.joints[0] for trial in started if len(trial.column.joints) == 1}:
        own = [trial for trial in started if trial.column.joints == (joint,) and trial.gain > numbers["further"]]
        kept += [trial for trial in own[:3] if not any(trial is other for other in kept)]
    return kept


def _nothing(decision: Decision) -> Decision:
    """A decision that runs not used do not bear out."""
    left = 1 - decision.none - decision.other
    return replace(decision, probability=[0.1 * p for p in decision.probability], none=decision.none + 0.9 * left)


def free_gains(system: System, processes: int = 1, judge: "Judge | None" = None) -> FloatArray:
    """Evidence (n,) gained by a free smooth function of each joint's position and velocity.

    It counts for nothing where it does not foretell the rows kept aside: it has fitted the noise.
    """
    _ = system.residual  # once, for all processes
    free = list(spread(lambda j: free_function(system, j), len(system.whitening), processes))
    least = calibration()["first"]
    return np.array([
        0.0 if judge is not None and f.gain > least and not judge.bears_out(system, f) else f.gain for f in free
    ])  # fmt: skip


def vibration(system: System, joint: int) -> float:
    """ln evidence gained by the vibration at a joint, of a fixed frequency, that explains most of what a model misses.

    Its amplitude and phase are each run's own. For white residuals the periodogram is what a sine of that frequency
    takes off ½ χ². Amplitude and phase together cost ln N (Schwarz, Annals of Statistics 6, 1978).
    """
    rest, at = system.residual[system.rows(joint)], 0
    longest = scipy.fft.next_fast_len(2 * max(len(mask) for mask in system.masks))
    gain = np.zeros(longest // 2 + 1)
    for mask in system.masks:
        count = int(mask.sum())
        signal = np.zeros(len(mask))
        signal[mask] = rest[at : at + count]
        at += count
        power = np.abs(scipy.fft.rfft(signal, longest)) ** 2 / max(count, 1)
        gain += np.maximum(power - np.log(max(count, 1)), 0.0)
    return float(gain[1:].max())


@dataclass(frozen=True)
class FreeFunction:
    """A smooth function of a joint's position and velocity, fitted beside the base model.

    Attributes:
        joint: zero-based; ``gain`` ln evidence over the base model.
        span: middle and half of the joint's range, and its largest speed, in rad and rad/s (m, m/s).
        coefficients: (b,) of :func:`smooth_columns`, N·m (N).
        moved: (z,) what it changes the base model's numbers by.
    """

    joint: int
    gain: float
    span: tuple[float, float, float]
    coefficients: FloatArray
    moved: FloatArray


def free_function(system: System, joint: int) -> FreeFunction:
    """The smooth function of a joint's position and velocity that explains most of what a model misses."""
    runs, span = system.base.runs, span_of(system.base.runs, joint)
    scale = USUAL_SHARE * np.sqrt(np.mean(np.concatenate([r.torque[r.valid, joint] for r in runs]) ** 2))
    rows = system.whitened(joint, [scale * smooth_columns(run, joint, *span) for run in runs])
    whitened = Columns((joint,), rows)
    information, pull = system.projected(whitened)
    inside = information + np.eye(len(pull))
    c = np.linalg.solve(inside, pull)
    gain = float(0.5 * pull @ c - 0.5 * np.linalg.slogdet(inside)[1])
    moved = -np.asarray(system.inverse @ (system.across(whitened).T @ c))
    return FreeFunction(joint, gain, span, scale * c, moved)


def number_groups(system: System, turning: Collection[str] = ()) -> dict[tuple[str, str], list[int]]:
    """Numbers of the description that are one answer each: effect and site → their indices.

    Args:
        turning: joints whose rotor's inertia is left to the effect of that name.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(system.parameters.names):
        owner, _, quantity = name.partition(".")
        link, rotor = owner.startswith("link"), owner.removeprefix("drive")
        drive = owner.startswith("drive") and (rotor not in turning or quantity == "gear_ratio")
        if (key := effect_of_number(name)) is not None:
            groups.setdefault(key, []).append(k)
        elif drive or owner.startswith("axis") or name == GAIN:
            groups["parameter", name] = [k]
        elif link:
            groups.setdefault(("parameter", f"{owner}.{quantity.partition('.')[0]}"), []).append(k)
        elif "@" in name and effect_named(name.partition("@")[0]).doubted:
            groups.setdefault(("parameter", name.partition("[")[0]), []).append(k)
    return groups


def widened_fits(system: System, suspects: Sequence[Suspect]) -> list[Fitted]:
    """Numbers of the base model that may be off beyond what the description allows, each in turn.

    A rotor's inertia is one thing with two names: where its effect is a suspect, it is that.
    """
    names = system.parameters.names
    turning = {s.hypothesis.site[5:] for s in suspects if s.effect.part == "inertia"}
    found = []
    for (effect, site), members in number_groups(system, turning).items():
        if not any(k in system.widened for k in members):
            hypothesis = Hypothesis(effect, site, scale=tuple((names[k], calibration()["far"]) for k in members))
            found.append(base_fit(with_wider(system, hypothesis), hypothesis))
    return found


# --- runs not used ----------------------------------------------------------------------------------------------------


class Judge:
    """Rows kept aside, whitened as those used; the offsets of their runs are their own.

    A fit is judged by how likely it made them (the posterior predictive): what it does not know of its numbers is no
    merit and no fault.
    """

    def __init__(self, system: System, kept: Sequence[Run]) -> None:
        self.base: Base = base_of(system.base.regressor, kept, system.base.sliding)
        self.system = System(self.base, system.whitening, self.base.parameters, level=system.level, noise=system.noise)
        refer(self.system, np.zeros(len(self.base.parameters)))
        self.system.assemble()
        self.before: tuple[System, tuple[FloatArray, float]] | None = None

    def _align(self, system: System) -> None:
        """Friction is in doubt where and when it is in the system that is judged."""
        if not np.array_equal(self.system.turning, system.turning) or self.system.late != system.late:
            self.system = replace(self.system, turning=system.turning, late=system.late)
            self.system.assemble()

    def rest(self, system: System, fit: Fitted) -> tuple[FloatArray, float]:
        """Whitened residual (N,) of a fit of a system's numbers, its own offsets estimated, and ln predictive density.

        Without what is common to all models.
        """
        residual, _, density = self._foretold(system, fit)
        return residual, density

    def bears_out(self, system: System, free: FreeFunction) -> bool:
        """Whether a free function, as it was fitted to the rows used, lowers the misfit of those kept aside enough."""
        fit, joint = base_fit(system), free.joint
        torque = [smooth_columns(run, joint, *free.span) @ free.coefficients[:, None] for run in self.base.runs]
        beside = self.system.full(Columns((joint,), self.system.whitened(joint, torque)))[:, 0]
        before = self.rest(system, fit)[0]
        after = self._foretold(system, replace(fit, z=fit.z + free.moved), beside)[0]
        fall = 0.5 * float(before @ before - after @ after)
        return fall > calibration()["foretold"] * free.gain * self.system.count / max(system.count, 1)

    def misfit(self, system: System, fit: Fitted) -> float:
        """χ² per datum of the rows kept aside, what the fit does not know of its numbers beside their noise."""
        return self._foretold(system, fit)[1] / (self.system.count * float(self.system.level.sum()))

    def _foretold(
        self, system: System, fit: Fitted, beside: FloatArray | float = 0.0
    ) -> tuple[FloatArray, float, float]:
        """Residual as in :meth:`rest`, χ² under the posterior predictive, and its ln density.

        ``beside`` (N,) is whitened torque that acts beside the model.
        """
        self._align(system)
        shared, width = self.base.lasting, len(self.base.parameters)
        own = len(fit.z) - len(system.base.parameters)
        lasting = np.r_[:shared, len(fit.z) - own : len(fit.z)]
        here = replace(
            self.system, found=system.found, parameters=system.parameters, widened=system.widened,
        )  # fmt: skip
        z = np.concatenate([fit.z[:shared], np.zeros(width - shared), fit.z[len(fit.z) - own :]])
        prior, covariance, doubt = (
            np.eye(len(z)),
            np.linalg.inv(fit.information)[np.ix_(lasting, lasting)],
            np.ones(len(z)),
        )
        at = np.r_[:shared, width : len(z)]
        prior[np.ix_(at, at)] = np.linalg.inv(covariance)
        doubt[at] = np.sqrt(np.diag(covariance))
        here, _ = linearised(here, z, doubt)
        residual = here.y - here.A.times(z) - beside
        posterior = prior + here.A.gram
        pull = here.A.transposed(residual)
        energy = float(residual @ residual - pull @ np.linalg.solve(posterior, pull))
        density = -0.5 * (energy + np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(prior)[1])
        offsets = np.arange(shared, width)
        moved = np.zeros(len(z))
        moved[offsets] = np.linalg.solve(posterior[np.ix_(offsets, offsets)], pull[offsets])
        return residual - here.A.times(moved), energy, float(density)

    def gain(self, system: System, fit: Fitted, trial: Trial | None) -> tuple[float, bool]:
        """Rise of the ln predictive density over Birge's ratio, and whether it is enough to believe the fit."""
        base = base_fit(system)
        wide, settled = with_wider(system, fit.hypothesis) if fit.hypothesis.scale else system, fit
        if trial is not None:
            wide = extended(system, trial)
        if trial is not None and (system.found or trial.suspect.effect.refers):
            wide = relinearised(wide, REFITTED)  # what was found before, or the torques it is made of, beside the new
            settled = base_fit(wide)
        if self.before is None or self.before[0] is not system:  # several are put to one model
            self.before = system, self.rest(system, base)
        before, density = self.before[1]
        after, reached = self.rest(wide, settled)
        data = self.system.count * float(self.system.level.sum())
        rise, scale = reached - density, max(1.0, float(after @ after) / data)
        joints = trial.column.joints if trial is not None else tuple(range(len(system.whitening)))
        power = sum(0.5 * float(np.sum(before[self.system.rows(j)] ** 2)) for j in joints)
        trained = 0.5 * (base.misfit * base.data - settled.misfit * settled.data)
        expected = trained * self.system.count / max(system.count, 1)
        if effect_named(fit.hypothesis.effect).ages:
            expected = min(expected, 0.5 * float(np.sum((before - after) ** 2)))
        # What only relieves the tension of numbers against their priors cannot show here: it must do no harm.
        numbers = calibration()
        if trained < numbers["mostly"] * (fit.evidence() - base.evidence()):
            return rise / scale, bool(rise > -numbers["tie"] * scale - 0.01 * power)
        return rise / scale, bool(rise > max(numbers["foretold"] * expected, numbers["least_foretold"] * power))

    def moves(self, system: System, fit: Fitted, trial: Trial, joint: int) -> bool:
        """Whether a joint's residual on the rows kept aside falls as anybody can see, with a law fitted beside all."""
        rows = self.system.rows(joint)
        before = float(np.sum(self.rest(system, base_fit(system))[0][rows] ** 2))
        after = float(np.sum(self.rest(extended(system, trial), fit)[0][rows] ** 2))
        return after < (1 - calibration()["moves"]) ** 2 * before

    def density(self, system: System, fit: Fitted) -> float:
        """ln predictive density of a fit of all numbers of a system."""
        return self.rest(system, fit)[1]


def smallest_visible(system: System, suspects: Sequence[Suspect], processes: int = 1) -> list[dict[str, Any]]:
    """The size of each suspect from which it would be named: its evidence then outweighs that nothing is missing.

    Other numbers of the entry are free beside it; a list's are taken in proportion. A slip element is given by the
    torque it yields at. One that no size a robot can have would show is left out. The work is spread over
    ``processes``.
    """
    suspects = [s for s in suspects if s.effect.part != "law"]
    sizes = spread(lambda number: _visible_size(system, suspects, number), len(suspects), processes)
    return [size for size in sizes if implausible(size["value"], size["unit"], False) is None]


def _visible_size(system: System, suspects: Sequence[Suspect], number: int) -> dict[str, Any]:
    numbers, effects = calibration(), {s.hypothesis.effect for s in suspects}
    suspect = suspects[number]
    hypothesis, own = suspect.hypothesis, suspect.hypothesis.own
    values = suspect.starts[len(suspect.starts) // 2].copy()
    u = own_prior(own, values)
    u[list(suspect.sizes)] += 0.3
    first = suspect.sizes[0] if suspect.sizes else 0
    others = [k for k in range(len(own)) if k != first and k not in suspect.sizes]
    trial = evaluate(system, suspect, u, slopes=bool(others))
    information, _ = system.projected(trial.column)
    energy = max(float(information[0, 0]), 1e-300)  # of the entry as it is
    if others:
        joint = Columns(trial.slopes.joints, np.column_stack([trial.column.rows, trial.slopes.rows[:, others]]))
        whole, _ = system.projected(joint)
        inner = whole[1:, 1:] + np.eye(len(others))
        energy = max(float(whole[0, 0] - whole[0, 1:] @ np.linalg.solve(inner, whole[1:, 0])), 0.05 * energy)
    sites = sum(s.hypothesis.effect == hypothesis.effect for s in suspects)
    occam = 0.5 * np.log1p(energy) * max(1, len(own) - 1)
    needed = numbers["temperature"] * np.log(2 * (len(effects) + 1) * sites) + max(occam, 2.0)
    ratio = float(np.sqrt(2 * needed / energy))
    null = suspect.effect.parameters[0].null
    parameter, value = own[first], own_values(own, u)[first]
    size = abs(value - null) * ratio if suspect.sizes else abs(value) * ratio
    return {
        "effect": hypothesis.effect, "site": hypothesis.site, "parameter": parameter.quantity.partition("[")[0],
        "value": float(size), "unit": parameter.unit,
    }  # fmt: skip
