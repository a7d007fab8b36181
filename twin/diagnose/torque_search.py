"""From the base model to what a motion log says is missing: screen, refine, decide, go on with it in the model.

Each thing found must lower the error on runs that were not used. It gives way to a simpler one within reach: no law is
exact, so a richer one nearly always fits better. What is found at a joint must reach most of what a free function of
its state gains (``named_reach`` of the calibration). Otherwise something there may have no name.
"""

from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import finalists
from twin.diagnose.departures import STRAINED
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_discover import discover, unnamed
from twin.diagnose.torque_fit import base_fit, evaluate, fitted, from_every_start, refine, settle, start, worth
from twin.diagnose.torque_judge import Judge, free_gains, vibration
from twin.diagnose.torque_look import decided, look, nothing_of
from twin.diagnose.torque_revise import all_grown, bounded, foretelling, one_for_two, pruned, revised
from twin.diagnose.torque_step import REFITTED, Step, accepted, left_out, what_is_left, with_entries, with_step
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, Trial, extended, relinearised, unshrunk, with_doubts, with_wider
from twin.measure.campaign import FloatArray
from twin.model.torque_base import Base
from twin.model.torque_signal import Run
from twin.parallel import Progress
from twin.physics import effect_of
from twin.physics.effect import axis_of
from twin.physics.statements import Part

FRICTION: tuple[Part, ...] = ("viscous", "dry")  # kinds that every joint has
WIDENED = 6  # times that its tolerances are widened, each time by what the fit then shows
ANOTHER_SIZE = 30.0  # times the described: a degree for a radian is 57 times; less is a number that is wrong


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
        held_out_misfit: χ² per datum of the rows kept aside under all that was found, doubt of its numbers beside their
            noise; ``bare`` the same under the base model.
        missed: share of the squares of the base model's error there, beyond noise, that is left.
        narrow: times as wide as described the tolerances of the description were taken in the end.
        stand_ins: numbers of the description that explain as much as what was found, if they are far off.
        resized: described friction that is of another size than the log shows.
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
    judge: Judge | None = None
    held_out_misfit: float = 0.0
    bare: float = 0.0
    missed: float = 0.0
    narrow: float = 1.0
    stand_ins: tuple[Hypothesis, ...] = ()
    resized: Hypothesis | None = None

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

    @property
    def unexplained(self) -> float:
        """Share of what runs kept aside are missed by that names leave, where they leave too much of it; else zero.

        By χ², where doubt of many numbers is an excuse, or by the error itself, whichever is more.
        """
        left = max(self.held_out_misfit, self.after.misfit)
        if not self.bare or left < calibration()["held_out_adequate"]:
            return 0.0
        return float(min(max(self.held_out_misfit / self.bare, self.missed), 1.0))

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
    progress = progress or (lambda description, total: lambda count: None)
    judge = Judge(system, kept) if kept else None
    free = free_gains(system, processes)
    lacking = _lacking_kinds(system, suspects)
    if resized := _of_another_size(lacking[1]):
        system = relinearised(with_wider(system, resized))
        lacking = _lacking_kinds(system, suspects)

    def found(plain: System, free: FloatArray, lacking: tuple[list[Step], System]) -> Search:
        search = _found(plain, free, lacking, suspects, judge, progress, processes, rounds)
        return replace(search, resized=resized)

    def beside(curved: System) -> Search:
        return found(curved, free_gains(curved, processes), _lacking_kinds(curved, suspects))

    if curved := _with_curved_friction(system, lacking[1], suspects, judge):
        return beside(curved)
    search = found(system, free, lacking)
    if max(search.held_out_misfit, search.after.misfit) > calibration()["held_out_adequate"]:
        curved = _with_curved_friction(system, search.system, suspects, judge)  # it shows better beside what was found
        return beside(curved) if curved else search
    return search


def _with_curved_friction(
    system: System, whole: System, suspects: Sequence[Suspect], judge: Judge | None
) -> System | None:
    """The model with friction that bends with speed at most joints, alike; ``None`` where it does not.

    Lubricated gears need less torque at high speed than viscous friction would have, cycloidal or harmonic ones often
    more (Bittencourt, Gunnarsson, J. Dyn. Sys. Meas. Control 134, 2012). A description has dry and viscous friction.
    What bends alike at most joints is how its drives are; what bends at one joint alone is a suspect as any other.

    Args:
        system: base model; ``whole`` with the friction that all joints lack.
        suspects: the law without a name that each joint may have is what bends.
        judge: runs not used, which such a model must predict better.
    """
    turning = system.base.regressor.robot.coupling != 0  # a drive that turns with several axes bends with all of them
    alone = np.flatnonzero((turning.sum(axis=0) == 1) & (turning.sum(axis=1) == 1))
    laws = [s for s in suspects if s.effect.part == "law" and axis_of(s.hypothesis.site) in alone]
    if len(laws) < 2:
        return None
    here = whole
    for law in laws:
        here = extended(here, unshrunk(settle(whole, start(whole, law))))
    here = relinearised(here)
    before, after = base_fit(whole), base_fit(here)
    off = _bends(here, laws)
    strongest = int(np.argmax(np.abs(off)))
    alike = off * np.sign(off[strongest]) > STRAINED
    gained = after.evidence() - before.evidence()
    if np.delete(alike, strongest).mean() <= 0.5 or gained < calibration()["further"] * len(laws):
        return None
    if judge is not None and judge.density(here, after) <= judge.density(whole, before):
        return None
    added = here.found[len(whole.found) :]
    return with_entries(system, here, [law for law, bent in zip(added, alike, strict=True) if bent])


def _bends(system: System, laws: Sequence[Suspect]) -> FloatArray:
    """Deviations (n,) that each law's size is off zero; a joint that is missed by more than noise tells less."""
    found = []
    for law in laws:
        (own,) = system.own(law)
        joint = axis_of(law.hypothesis.site)
        rest = system.residual[system.rows(joint)]
        misfit = max(1.0, float(rest @ rest) / (system.count * float(system.level[joint])))
        found.append(float(system.z[own]) / np.sqrt(system.inverse[own, own] * misfit))
    return np.array(found)


def _found(
    plain: System, free: FloatArray, lacking: tuple[list[Step], System], suspects: Sequence[Suspect],
    judge: Judge | None, progress: Progress, processes: int, rounds: int,
) -> Search:  # fmt: skip
    """What is missing from a base model: see :func:`explain`.

    Args:
        free: evidence (n,) gained by a free function of each joint's state.
        lacking: friction that all joints may lack, and the model with it.
    """
    steps, system = _whole_kinds(plain, *lacking, judge)
    for number in range(rounds):
        known = {s.name for s in system.found}
        open_ = [s for s in suspects if s.name not in known]
        step = look(system, open_, progress("screen" if not number else "look for more", len(open_)), processes)
        step = _first_borne_out(step, steps, open_, judge)
        steps.append(step)
        if not step.accepted:
            break
        system = accepted(system, step)
        for beside in _elsewhere(step, system, open_):
            if _borne_out(beside, steps, judge):
                steps.append(beside)
                system = accepted(system, beside)
        system = one_for_two(steps, pruned(steps, system), suspects, judge, processes)
        system = with_doubts(all_grown(steps, system, judge))
    first = steps[0]  # beside the base model alone; what takes its place later stands beside other finds
    system = pruned(steps, revised(steps, system, suspects, judge), last=True)
    system = with_doubts(bounded(steps, all_grown(steps, system, judge)))
    system = foretelling(steps, system, judge)
    left = free_gains(system, processes, judge)
    search = Search(plain, first, steps, system, base_fit(system), free, left, judge=judge)
    if judge:
        search.held_out_misfit, search.bare = judge.misfit(system, search.after), judge.misfit(plain, first.base)
        search.missed = judge.left(plain, first.base, system, search.after)
    unnamed_there = [search.unreached(), *_outdone(search, judge), *_too_many(search)]
    search.other = max(unnamed_there, key=lambda found: found[1])
    joint, other = search.other
    if other > 0.5:
        _locate(search, joint, judge)
    return search


def _lacking_kinds(system: System, suspects: Sequence[Suspect]) -> tuple[list[Step], System]:
    """Friction of all joints at once where the description has none of a kind at several, and the model with it.

    While most of it is missing no joint's friction alone predicts a run: what the other joints lack goes into links
    and rotors.
    """
    lacking: list[Suspect] = []
    for part in FRICTION:
        kind = [s for s in suspects if s.effect.part == part]
        lacking += kind if len(kind) > 1 else []
    steps: list[Step] = []
    here = system
    for suspect in lacking:
        trial = settle(here, start(here, suspect))
        step = decided(here, {suspect.hypothesis.key: trial}, [fitted(here, trial)], suspects)
        if not trial.u.any():
            continue
        step.trials[step.key], step.accepted = unshrunk(trial), True
        steps.append(step)
        here = with_step(here, step)
    return steps, relinearised(here) if steps else system


def _of_another_size(system: System) -> Hypothesis | None:
    """Described friction of a kind that is of another size than the log shows at most joints, with its width.

    It is in another unit, the motor's, or what a simulator was given. Held near it, the fit puts the rest into links.
    """
    scale: dict[str, float] = {}
    here = system
    for _ in range(WIDENED):  # the first time what it stands for is still in other numbers
        if not (wider := _far_off(here)):
            break
        scale |= {name: factor * scale.get(name, 1.0) for name, factor in wider.items()}
        found = Hypothesis("parameter", "friction", scale=tuple(scale.items()))
        here = relinearised(with_wider(system, found))
    known = {p.name: p.deviation / abs(p.mean) for p in system.parameters if p.name in scale and p.mean}
    if not known or np.median([scale[name] * share for name, share in known.items()]) < ANOTHER_SIZE:
        return None
    gained = base_fit(here).evidence() - base_fit(system).evidence()
    return found if scale and gained > calibration()["further"] * len(scale) else None


def _far_off(system: System) -> dict[str, float]:
    """Described friction of a kind that the log without its description puts elsewhere: by how many tolerances.

    With z the fit and s² its variance, both in tolerances, the log alone has z/(1 − s²), and z/√(1 − s²) is how many
    deviations this and the description differ. The median over the joints counts: one joint may lack something.
    """
    fit, far = base_fit(system), dict[str, float]()
    names = fit.parameters.names
    held = np.maximum(1 - np.diag(np.linalg.inv(fit.information)), 1e-12)
    for part in FRICTION:
        kind = [k for k, name in enumerate(names) if name.startswith(f"{effect_of(part).name}@")]
        off = np.abs(fit.z[kind])
        if len(kind) > 1 and np.median(off / np.sqrt(held[kind])) > calibration()["far"]:
            width = float(np.sqrt(np.mean((off / held[kind]) ** 2)))
            far |= dict.fromkeys((names[k] for k in kind), width)
    return far


def _whole_kinds(system: System, steps: list[Step], whole: System, judge: Judge | None) -> tuple[list[Step], System]:
    """The model with the friction that all joints lack, if it predicts better. What proves needless is out again."""
    if not steps:
        return [], system
    before, after = base_fit(system), base_fit(whole)
    predicted = judge is None or judge.density(whole, after) > judge.density(system, before)
    if not predicted or after.evidence() - before.evidence() < calibration()["further"] * len(steps):
        return [], system
    return steps, with_doubts(pruned(steps, whole))


def _outdone(search: Search, judge: Judge | None) -> list[tuple[int, float]]:
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


def _too_many(search: Search) -> list[tuple[int, float]]:
    """Joints where so many names were found as are needed to stand for a law that has none, with its probability.

    Waves, springs and compensators are terms of a series: three of them follow any function of a joint's angle. That
    three effects were left out at one joint is less likely than one that nobody has named.
    """
    numbers = calibration()
    names = [step.joints for step in search.found if len(step.joints) == 1 and step.effect.part not in FRICTION]
    return [(joints[0], numbers["series_other"]) for joints in set(names) if names.count(joints) >= numbers["series"]]


def _first_borne_out(
    step: Step, earlier: Sequence[Step], suspects: Sequence[Suspect], judge: Judge | None, tried: int = 5
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
        answer = decided(step.system, step.trials, list(left), suspects)
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
    fallen = system.residual**2 - what_is_left(system, trial) ** 2
    by_joint = np.array([fallen[system.rows(j)].sum() for j in range(system.base.regressor.robot.axis_count)])
    total = float(by_joint.sum())
    return 1 - float(by_joint[list(joints)].sum()) / total if total > 0 else 0.0


def _borne_out(step: Step, earlier: Sequence[Step], judge: Judge | None) -> bool:
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
        step.decision = nothing_of(step.decision)
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
        found = decided(system, trials, [fitted(system, t) for t in trials.values()], suspects)
        yield found
        if found.accepted:
            system = accepted(system, found)


def _locate(search: Search, joint: int, judge: Judge | None) -> None:
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
    elif not _leaves_most(search, extended(system, trial), fit, judge):
        search.law = joint, trial, fit


def _leaves_most(search: Search, whole: System, fit: Fitted, judge: Judge | None) -> bool:
    """Whether runs kept aside are still missed by most of what the base model misses, with a law at one joint.

    What is missing is not at that joint alone then.
    """
    numbers = calibration()
    if judge is None or judge.misfit(search.system, search.after) < numbers["held_out_adequate"]:
        return False
    return judge.left(search.plain, search.first.base, whole, fit) > numbers["mostly"]
