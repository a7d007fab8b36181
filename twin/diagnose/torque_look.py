"""One look at all suspects beside what was found: which promise most, and the decision over their fits."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision, decide
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import base_fit, fitted, reach, settle, start
from twin.diagnose.torque_step import Step
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, Trial, with_wider
from twin.measure.campaign import FloatArray
from twin.model.regressor import body_of
from twin.model.torque_numbers import GAIN, effect_of_number
from twin.model.torque_whitened import Columns
from twin.parallel import spread
from twin.physics import effect_named, effect_of
from twin.physics.effect import link_end
from twin.physics.payload import Payload


def look(system: System, suspects: Sequence[Suspect], tick: Callable[[int], None], processes: int) -> Step:
    started, kept = [], set(system.screened)
    _ = system.residual  # once, for all processes

    def begin(number: int) -> tuple[Trial, Columns | None]:
        """Of a suspect, and its columns where they are new: a process that keeps them keeps them for itself."""
        trial = start(system, suspects[number])
        form = trial.suspect.form
        return trial, None if form in kept else system.screened.get(form)

    for trial, columns in spread(begin, len(suspects), processes):
        if columns is not None:
            system.screened[trial.suspect.form] = columns
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
        if key not in best_of or _plainly(fit) > _plainly(best_of[key]):
            best_of[key], trials[key] = fit, trial
    return decided(system, trials, [*best_of.values(), *widened_fits(system, suspects)], suspects)


def _plainly(fit: Fitted) -> float:
    """ln evidence of one form of an effect; a form with more numbers must have more of it by what decides anything."""
    return fit.evidence() - calibration()["tie"] * len(fit.hypothesis.own)


def decided(system: System, trials: dict[str, Trial], fits: Sequence[Fitted], suspects: Sequence[Suspect]) -> Step:
    """Probabilities of fits to one system, simpler ones preferred within reach."""
    base = base_fit(system)
    fits = _outermost(system, fits)
    gains = np.array([fit.evidence() for fit in fits]) - base.evidence()
    later = {k: first for k, first in [*_ladder(system, fits, gains), *_composed(fits, gains, trials)]}
    best = max((gain for k, gain in enumerate(gains) if k not in later), default=0.0)
    numbers = [_numbers(f.hypothesis) for f in fits]
    near = [k for k, gain in enumerate(gains) if gain > calibration()["simpler"] * best and k not in later]
    handicap = [_richer(k, fits, numbers, near) * max(best, 0.0) for k in range(len(fits))]
    for k, less in _recorded_alike(fits, gains, near, max(best, 0.0)):
        handicap[k] = max(handicap[k], less)
    further = calibration()["further"]
    for k, first in later.items():
        handicap[k] = max(0.0, gains[k] - gains[first] + handicap[first] + further)
    hypotheses, other = [[s.hypothesis] for s in suspects], calibration()["least_other"]
    return Step(system, base, decide(fits, base, hypotheses, handicap=handicap, other=other, scale=1.0), trials)


def _richer(k: int, fits: Sequence[Fitted], numbers: Sequence[int], near: Sequence[int]) -> float:
    """The share of the best gain that a fit must have more than those with fewer numbers near the best.

    Laws of the robot are not exact, and one more number fits what they are off by. How torque is recorded, late or
    low-passed, is exact.
    """
    fewer = [i for i in near if numbers[i] < numbers[k]]
    if not fewer or all(effect_named(fits[i].hypothesis.effect).records_torque for i in (k, *fewer)):
        return 0.0
    return 1 - calibration()["simpler"]


def _recorded_alike(
    fits: Sequence[Fitted], gains: FloatArray, near: Sequence[int], best: float
) -> list[tuple[int, float]]:
    """Index and handicap of ways in which torque may be recorded that differ by less than other laws may be off by.

    A delay and a low-pass above the motion's band differ in the third digit of what they explain. The robot's friction
    is not known so exactly: they are as likely then.
    """
    ways = [k for k in near if effect_named(fits[k].hypothesis.effect).records_torque]
    most = max((gains[k] for k in ways), default=0.0)
    alike = [k for k in ways if gains[k] >= most - calibration()["inexact"] * best]
    return [(k, float(gains[k] - min(gains[i] for i in alike))) for k in alike]


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


def nothing_of(decision: Decision) -> Decision:
    """A decision that runs not used do not bear out."""
    left = 1 - decision.none - decision.other
    return replace(decision, probability=[0.1 * p for p in decision.probability], none=decision.none + 0.9 * left)


def number_groups(system: System, turning: Collection[str] = ()) -> dict[tuple[str, str], list[int]]:
    """Numbers of the description that are one answer each: effect and site → their indices.

    What was found is no description: its numbers are free.

    Args:
        turning: joints whose rotor's inertia is left to the effect of that name.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for k, name in enumerate(system.base.parameters.names):
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
    return [fit for fit in found if in_its_link(system, fit)]


def in_its_link(system: System, fit: Fitted) -> bool:
    """Whether a freed mass or centre of a link leaves the centre where the link is; else another body is there.

    That is no further from the line between the link's joints than this is long, than the centre is as described, or
    than ``far`` tolerances.
    """
    link, _, quantity = fit.hypothesis.site.partition(".")
    if not link.startswith("link") or quantity not in ("mass", "com"):
        return True
    base, number = system.base, int(link[4:]) - 1
    mass, com, _ = body_of(base.values(system.plain(fit.z))[10 * number : 10 * number + 10])
    robot = base.regressor.robot
    end, described = np.array(link_end(robot, number)), np.array(robot.links[number].inertial[1])
    least = calibration()["far"] * robot.tolerances.com
    most = max(float(np.linalg.norm(end)), _beside(described, end), least)
    return mass > 0 and _beside(com, end) <= most


def _beside(point: FloatArray, end: FloatArray) -> float:
    """Distance, m, of a point from the line between a frame's origin and an end."""
    along = np.clip(float(point @ end) / max(float(end @ end), 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(point - along * end))
