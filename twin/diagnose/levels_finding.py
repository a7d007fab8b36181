"""What force levels that disagree say, as a finding: the law at its joint, errors with blows stepped, MuJoCo's word."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from twin.diagnose.decide import Decision, finalists
from twin.diagnose.hypotheses import suspects
from twin.diagnose.levels import WINDOW, Levels, decide_levels, explain_levels, settled
from twin.diagnose.levels_beside import Beside, explain_beside
from twin.diagnose.levels_next import next_blows, smallest_visible_laws
from twin.diagnose.next_test import next_test
from twin.diagnose.records import FrfRecord, Stage, frf_records
from twin.diagnose.refit import Fitted
from twin.diagnose.search import SCREEN_LINES, Search
from twin.diagnose.sentences import sentence
from twin.diagnose.triage import Triage
from twin.diagnose.verdict import Finding, Missing, Word, estimates, judge, missing_of, rival_of, strained
from twin.identify.elastic_compare import noise_floor, recording_set, relative_error
from twin.identify.joint_reaction import Stepped
from twin.identify.objective import Sample
from twin.identify.struck import amplitude_entries, judge_struck, law_of, settle, without_laws
from twin.identify.uncertainty import NINETY
from twin.measure.blows import Blow, blows
from twin.measure.campaign import Campaign, ComplexArray, FloatArray
from twin.model.expansion import with_channels
from twin.model.hammer import HammerTest, simulate_hits
from twin.model.parameters import independent
from twin.model.recorded import Recorded, placed, without_limits
from twin.parallel import Progress, ahead, spread
from twin.physics import CATALOGUE
from twin.robot.description import Robot
from twin.robot.mechanism import assemble
from twin.robot.physical import as_written

FORM = 0.05
"""Deviation of the logarithm of a blow's momentum, its peak and spectrum known: a half sine has 1.06 times a
haversine's, and 1.2 times a triangle's."""
STEPPED = 0.1  # relative difference allowed between MuJoCo's blows and the search's
DOUBT_DRAWS = 4  # of a fit's numbers, to see how far their doubt moves its predictions


def levels_finding(
    campaign: Campaign,
    given: Robot,
    base: Robot,
    source: str,
    found: Triage,
    search: Search,
    progress: Progress | None = None,
    seed: int = 0,
) -> Finding | None:
    """The finding of a campaign whose force levels disagree.

    Args:
        campaign: as recorded.
        given: the description as it came; ``base`` the one that was fitted, without limits and laws of amplitude.
        source: the file.
        found: its triage.
        search: the base model, converged.
        progress: makes progress bars.
        seed: of candidates for a next test.

    Returns:
        ``None`` where no law is better than none: the other hypotheses then have the word.
    """
    sample = Sample(tuple(found.used), 1 / found.shared)
    tick = progress("force levels", 40) if progress else None
    levels = explain_levels(campaign, base, search.base, sample, search.robust, tick, search.processes)
    if levels is None:
        return None
    decision, how = decide_levels(levels), blows(campaign) or {}
    if judge(decision) == "adequate":
        return None
    with ahead(lambda: smallest_visible_laws(base, search.base, sample, how), search.processes) as visible:
        return _of_law(campaign, given, base, source, found, search, levels, decision, visible, progress, seed)


def _of_law(
    campaign: Campaign,
    given: Robot,
    base: Robot,
    source: str,
    found: Triage,
    search: Search,
    levels: Levels,
    decision: Decision,
    visible: Callable[[], list[dict[str, Any]]],
    progress: Progress | None,
    seed: int,
) -> Finding:
    """The finding of levels that a law explains; ``visible`` returns the smallest visible laws."""
    sample, how, unsure = Sample(tuple(found.used), 1 / found.shared), blows(campaign) or {}, 0.0
    word, answer = judge(decision), None
    if word in ("named", "ambiguous"):
        answer = _answer(campaign, base, found, search, levels, decision, progress)
        word = answer.word
    best, none, other = search.base, decision.none, decision.other
    if answer:
        best, none, other = answer.best, answer.none, answer.other
    plain = without_limits(without_laws(given))
    records, errors = frf_records(
        plain, search.base, search.base, found.used, found.kept, found.shared, search.processes
    )
    if answer:
        predicted, errors["after"] = whole_decays(answer.objective, answer.best, found, how)
        records = _with(records, "after", predicted)
        if levels.window:
            unsure = _unsure(answer, found.used, how, seed)
    errors["noise_floor"] = noise_floor(sample.recordings)
    missing, before, notes = list(answer.missing) if answer else [], search.base.robot, []
    if answer and amplitude_entries(given):
        described = {f"{entry.effect}@{entry.site}" for entry in amplitude_entries(given)}
        if len(described) == 1:
            records, errors["as_given"] = _struck_as_given(records, given, found, how)
        missing = [m for m in missing if not described & {m.first.key, *(rival.key for rival, _ in m.rivals)}]
        if len(missing) == len(answer.missing):
            notes = [f"{', '.join(sorted(described))}, as described, is not borne out and left out of the new model"]
        else:  # the law that is described is what was refitted, and no answer
            alone, objective = best, answer.objective
            if missing and answer.beside and answer.beside.decision:
                word, alone, objective = judge(answer.beside.decision), answer.beside.law, answer.beside.stepped
            else:
                word, none = "adequate", 1 - other
            predicted, errors["before"] = whole_decays(objective, alone, found, how)
            records = _with(records, "before", predicted)
            before = alone.robot
    sites = {place.site: levels.places[-1].cost - place.cost for place in levels.places}
    if unsure > errors["noise_floor"]:
        notes.append(_unsure_note(unsure))
    finding = Finding(
        source, "frf-campaign", word, [], none, other, given,
        as_written(before, given), as_written(best.robot, given), errors, list(found.held_out), records,
        _location(source, records, levels.places[0].site), sites,
        visible(), warnings=[*found.warnings, *notes, *strained(best)],
        finalists=finalists(levels.base, levels.fits), unsure=unsure,
    )  # fmt: skip
    for item in missing:
        seen = sentence(item.first.phrase, records, errors, finding.held_out)
        law = CATALOGUE[item.first.effect].amplitude_law if item.first.effect in CATALOGUE else None
        finding.missing.append(replace(item, evidence=f"{levels_sentence(levels)} {seen}" if law else seen))
    if answer and word == "ambiguous":
        finding.next_test = _next_test(given, levels, decision, answer, sample, how, seed)
    return finding


@dataclass(frozen=True)
class _Answer:
    """The law and what is missing beside it.

    Attributes:
        word: about both; ``none``, ``other`` too.
        best: their fit, the law stepped; ``objective`` predicts with it.
        beside: the linear search, where it named something.
    """

    word: Word
    missing: list[Missing]
    best: Fitted
    objective: Stepped
    none: float
    other: float
    beside: Beside | None


def _answer(
    campaign: Campaign,
    base: Robot,
    found: Triage,
    search: Search,
    levels: Levels,
    decision: Decision,
    progress: Progress | None,
) -> _Answer:
    word, best = judge(decision), decision.ranked[0]
    objective = levels.objectives[levels.fits.index(best)]
    sample, how = Sample(tuple(found.used), 1 / found.shared), blows(campaign) or {}
    if best is levels.fits[0]:
        band = float(found.used[0].frequency[0]), float(found.used[0].frequency[-1])
        brakes = [r.setup.brakes for r in found.recordings.values()]
        looked_at = suspects(base, campaign.response, campaign.excitation, brakes, band)
        beside = explain_beside(base, search.base, levels, looked_at, progress)
        best, objective = beside.law, beside.stepped
        if beside.decision and judge(beside.decision) in ("named", "ambiguous"):
            law = missing_of(replace(decision, ranked=[best, *decision.ranked[1:]]), levels.base)[0]
            objective = beside.objectives[0]
            both, objective = settled(levels, beside.fits[0], objective, sample, how)
            also = replace(beside.decision, ranked=[both, *beside.fits[1:]])
            others = [m for m in missing_of(also, best) if m.first.key != law.first.key]
            believed = (1 - also.other) / max(1 - decision.other, 1e-9)
            law = replace(
                law, probability=min(1.0, believed * law.probability),
                first=replace(
                    law.first, robot=both.robot,
                    parameters=_as_entered(estimates(both, (law.first.effect, law.first.site)), objective, both),
                ),
            )  # fmt: skip
            if judge(beside.decision) == "ambiguous":
                word = "ambiguous"
            return _Answer(word, [law, *others], both, objective, decision.none, also.other, beside)
    best, objective = settled(levels, best, objective, sample, how)
    law = missing_of(replace(decision, ranked=[best, *decision.ranked[1:]]), levels.base)[0]
    law = replace(law, first=replace(law.first, parameters=_as_entered(law.first.parameters, objective, best)))
    return _Answer(word, [law], best, objective, decision.none, decision.other, None)


def _next_test(
    given: Robot,
    levels: Levels,
    decision: Decision,
    answer: _Answer,
    sample: Sample,
    how: dict[str, Blow],
    seed: int,
) -> dict[str, Any] | None:
    """Blows where laws rival, else a posture that separates what rivals beside the law."""
    if judge(decision) == "ambiguous" or answer.beside is None or answer.beside.decision is None:
        return next_blows(given, levels, decision.ranked[0], rival_of(decision), sample, how, seed)
    rival = rival_of(answer.beside.decision)
    few = sample.thin(SCREEN_LINES)
    return next_test(given, answer.beside.decision.ranked[0], rival, few, seed) if rival else None


def _unsure(answer: _Answer, used: Sequence[Recorded], blow: dict[str, Blow], seed: int) -> float:
    """Relative error of whole decays between predictions of a fit and those with its numbers drawn from their doubt."""
    objective, fit = replace(answer.objective, sample=Sample(tuple(used)), blow=blow), answer.best
    rng = np.random.default_rng(seed)
    spread = np.linalg.cholesky(fit.covariance)
    moved = [spread @ rng.normal(size=len(fit.z)) for _ in range(DOUBT_DRAWS)]
    predicted, *drawn = objective.predicted_at([fit.z, *(fit.z + step for step in moved)])
    here = [replace(r, frf=H) for r, H in zip(used, predicted, strict=True)]
    return float(np.sqrt(np.mean([relative_error(here, H) ** 2 for H in drawn])))


def _unsure_note(unsure: float) -> str:
    return (
        f"the end of a decay hangs on the least of the law's numbers: their doubt moves the predicted FRFs by "
        f"{unsure:.0%}. An error of that size is no sign of something else"
    )


def levels_sentence(levels: Levels) -> str:
    """How the joint's stiffness and loss change from the lightest to the hardest blows: what a person can check."""
    best = levels.places[0]
    k = np.concatenate([u[0] for u in best.own])
    sure = np.concatenate([matrix[0, 0] for matrix in best.certainty])
    loud = sure > np.quantile(sure, 0.5)
    spread = float(np.ptp(np.quantile(k[loud], [0.05, 0.95])))
    joint = levels.base.values[levels.base.parameters.names.index(f"{best.site}.stiffness")]
    more = {place.site: f"{place.cost / best.cost:.1f}" for place in levels.places[1:]}
    others = ", ".join(f"{site} {times} times" for site, times in more.items() if times != "1.0")
    instead = f" If the stiffness varies at another joint instead, more stays unexplained ({others})." if others else ""
    varies = f"its stiffness varies by {spread / joint:.1%} from blow to blow"
    return f"If {best.site} is fitted as a linear spring, {varies}.{instead}"


def _as_entered(parameters: dict[str, Any], objective: Stepped, fit: Fitted) -> dict[str, Any]:
    """The law's own numbers as they are in its entry, for blows as long as these were; without those of the blows.

    Where raw hits do not tell the length of the blows, the intervals include what is not known of their momentum.
    """
    sizes, longer = objective.own(fit.z)
    entry: dict[str, Any] = objective.law.entry(sizes, longer)
    known = "pulse" not in parameters  # raw hits tell it
    first = len(objective.base)
    rows = [*range(first, first + len(sizes)), *([] if known else [len(fit.z) - 1])]
    covariance = fit.covariance[np.ix_(rows, rows)]
    little = 1e-6

    def numbers(name: str, moved: FloatArray, larger: float) -> FloatArray:
        return np.log(np.atleast_1d(objective.law.entry(moved, larger)[name]))

    found = {}
    for name, value in entry.items():
        at = numbers(name, sizes, longer)
        slopes = [numbers(name, sizes * (1 + little * one), longer) - at for one in np.eye(len(sizes))]
        power = (numbers(name, sizes, longer * (1 + little)) - at) / little
        weight = np.array(slopes).T / little
        weight = weight if known else np.column_stack([weight, power])
        variance = np.einsum("vp,pq,vq->v", weight, covariance, weight) + (0.0 if known else (power * FORM) ** 2)
        ends = np.exp(at[:, None] + np.outer(NINETY * np.sqrt(variance), [-1, 1])).tolist()
        unit = CATALOGUE[objective.law.effect].unit(name, fit.hypothesis.site, fit.robot)
        found[name] = {"value": value, "unit": unit, "interval90": ends if np.ndim(value) else ends[0]}
    return found


def _location(source: str, records: Sequence[FrfRecord], site: str) -> list[dict[str, Any]]:
    """Postures and levels where the linear model misses most."""
    energy = np.array([float(record.energy("before").sum()) for record in records])
    order = np.argsort(-energy)[:5]
    return [
        {
            "recording": source, "site": site, "posture": records[k].name, "run": None,
            "band_hz": [float(records[k].frequency[0]), float(records[k].frequency[-1])],
            "channels": [records[k].pairs[p] for p in np.argsort(-records[k].energy("before").sum(axis=0).ravel())[:3]],
            "share": float(energy[k] / energy.sum()),
        }
        for k in order
    ]  # fmt: skip


# --- the law on whole recordings --------------------------------------------------------------------------------------


def whole_decays(
    objective: Stepped, fit: Fitted, found: Triage, blow: dict[str, Blow]
) -> tuple[list[ComplexArray], dict[str, float | None]]:
    """The law's prediction of what was used, then of what was held out, and its errors.

    On held-out recordings posture angles and gains are estimated again, nothing else.
    """
    law, sizes, site, robot = law_of(fit.robot)
    # nodes lie where the fit has them
    used, kept = (placed(recordings, fit.parameters, fit.values) for recordings in (found.used, found.kept))
    own = objective.base
    longer = objective.own(fit.z)[1]
    blow = {group: replace(b, pulse_s=b.pulse_s * longer) for group, b in blow.items()}
    belongs = [k for k, p in enumerate(own) if p.kind in ("posture", "sag", "gain")]
    steps = Stepped(
        robot, independent([own[k] for k in belongs]), Sample(tuple(used)), law=law, site=site, blow=blow, fixed=sizes,
        processes=objective.processes,
    )  # fmt: skip

    def part(number: int) -> list[ComplexArray]:
        if number == 0:
            return steps.predicted(np.array([fit.z[k] for k in belongs]))
        judged = replace(steps, parameters=recording_set(robot, kept), sample=Sample(tuple(kept)))
        return judged.predicted(settle(judged))

    predicted, *rest = spread(part, 2 if kept else 1, objective.processes)
    error: dict[str, float | None] = {"train": relative_error(used, predicted), "held_out": None}
    for there in rest:
        error["held_out"] = relative_error(kept, there)
    predicted = [*predicted, *(H for there in rest for H in there)]
    return predicted, error


def _struck_as_given(
    records: Sequence[FrfRecord], given: Robot, found: Triage, blow: dict[str, Blow]
) -> tuple[list[FrfRecord], dict[str, float | None]]:
    """Records with the prediction of a description that has one law, and its errors."""
    parts = [judge_struck(given, some, blow) if some else None for some in (found.used, found.kept)]
    predicted = [H for part in parts if part for H in part.predicted]
    train, held_out = (part.error if part else None for part in parts)
    return _with(records, "as_given", predicted), {"train": train, "held_out": held_out}


def _with(records: Sequence[FrfRecord], stage: Stage, predicted: Sequence[ComplexArray]) -> list[FrfRecord]:
    return [replace(r, predicted={**r.predicted, stage: H}) for r, H in zip(records, predicted, strict=True)]


# --- MuJoCo -----------------------------------------------------------------------------------------------------------


def check_blows(
    robot: Robot, campaign: Campaign, recordings: dict[str, Recorded], unsure: float = 0.0
) -> dict[str, Any] | None:
    """The written model hit in MuJoCo's time at two force levels, against the search's stepping and the recording.

    The blow whose FRFs differ most from level to level is taken, with the angles as recorded. Where doubt of the law's
    own numbers moves the FRFs of whole decays further than the limit (``unsure``, relative), their beginnings count.

    Returns:
        A check. Its value is the larger relative difference of the FRFs (nf, nr) from the search's. Its description
        gives the change from level to level, in MuJoCo and as recorded. ``None`` where no posture has two levels, or a
        peak force is not recorded.
    """
    blow = blows(campaign)
    pairs = [
        (a, b)
        for a, b in combinations(recordings.values(), 2)
        if a.setup.name == b.setup.name and a.frf.shape == b.frf.shape
    ]
    if blow is None or not pairs:
        return None

    def change(a: ComplexArray, b: ComplexArray) -> FloatArray:
        size = np.linalg.norm(a, axis=(0, 1))  # nothing at a point that is held
        return np.asarray(np.divide(np.linalg.norm(b - a, axis=(0, 1)), size, out=np.zeros_like(size), where=size > 0))

    low, high = max(pairs, key=lambda pair: float(np.median(change(pair[0].frf, pair[1].frf))))
    column = int(np.argmax(change(low.frf, high.frf)))
    law, sizes, site, plain = law_of(robot)

    def compared(window: float) -> tuple[float, list[ComplexArray]]:
        """The larger relative difference under a further window, 1/s, and MuJoCo's FRFs (nf, nr)."""
        pair = tuple(replace(r, s=r.s + window) for r in (low, high))
        stepper = Stepped(
            without_limits(plain), independent([]), Sample(pair), law=law, site=site, blow=blow, fixed=sizes
        )
        expected = [H[:, :, column] for H in stepper.predicted(np.zeros(0))]
        stepped = [_in_mujoco(robot, r, column, blow[r.group]) for r in pair]
        apart = (np.linalg.norm(H - e) / np.linalg.norm(e) for H, e in zip(stepped, expected, strict=True))
        return float(max(apart)), stepped

    off, stepped = compared(0.0)
    beginning = ""
    if off >= STEPPED and unsure >= STEPPED:
        off, beginning = compared(WINDOW)[0], f" at the beginning of the decays (a window of {WINDOW:g} 1/s)"
    change_there = [
        float(np.linalg.norm(b - a) / np.linalg.norm(a))
        for a, b in (stepped, (low.frf[:, :, column], high.frf[:, :, column]))
    ]
    label = low.setup.excitation.label[column]
    return {
        "name": "time stepping", "value": off, "limit": STEPPED, "passed": off < STEPPED,
        "description": f"MuJoCo steps blows of {blow[low.group].peak_n:g} N and {blow[high.group].peak_n:g} N on "
        f"{label} in '{low.setup.name}' in time. Its FRFs agree with those of the search within {off:.1%}{beginning} "
        f"(limit {STEPPED:.0%}). From one blow to the other they change by {change_there[0]:.1%}; the recorded FRFs "
        f"change by {change_there[1]:.1%}",
    }  # fmt: skip


def _in_mujoco(robot: Robot, r: Recorded, column: int, blow: Blow) -> ComplexArray:
    """FRFs (nf, nr) of one blow on the robot, in the quantity of the recording."""
    tested = with_channels(without_limits(robot), r.setup.excitation, r.setup.response)
    mechanism = assemble(tested, r.setup.q, brakes=r.setup.brakes or "off")
    step = float(np.median(np.diff(r.frequency)))
    test = HammerTest(pulse_s=blow.pulse_s, duration_s=1 / step, sample_rate_hz=2048.0, hits=1)
    hits = simulate_hits(
        mechanism, test, blow.peak_n, [r.setup.excitation.label[column]], r.setup.response.label, threads=1
    )
    time = np.arange(hits.force.shape[-1]) / hits.sample_rate_hz - hits.pretrigger_s
    decay = np.exp(-r.s[:, None] * time)
    ratio = (decay @ hits.response[0, 0].T) / (decay @ hits.force[0, 0])[:, None]
    return np.asarray(ratio * r.s[:, None] ** (r.power - 2))
