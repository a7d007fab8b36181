"""What a hammer test says is missing from a robot description: the hammer-test side of ``twin diagnose``."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.diagnose.borne_out import all_predict, falls, gained
from twin.diagnose.calibration import calibration
from twin.diagnose.decide import (
    Decision,
    decide,
    finalists,
    half_unnamed,
    in_doubt_beside,
    misfit_unseen,
    sifted,
    that_show,
)
from twin.diagnose.departures import STRAINED
from twin.diagnose.described import described, geometry, nodes_within
from twin.diagnose.edit import check_linear, is_nonlinear, with_modes
from twin.diagnose.frf_faults import put_right, without_hum
from twin.diagnose.frf_leak import cut_off, cut_short, leaking, refined, rewindowed
from twin.diagnose.frf_off import data_cost, off_description
from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, same_axes, suspects, together
from twin.diagnose.joint import Knowledge, about, settled_with, shared
from twin.diagnose.large_motion import moved_far
from twin.diagnose.left_out import LeftOut, left_out, that_foretell
from twin.diagnose.levels_finding import check_blows, levels_finding
from twin.diagnose.levels_next import smallest_visible_laws
from twin.diagnose.locate import mismatch
from twin.diagnose.many_postures import apart, judged
from twin.diagnose.next_test import WEIGH, next_test, smallest_visible
from twin.diagnose.note import Note
from twin.diagnose.patience import Patience
from twin.diagnose.records import FrfRecord, frf_records, pooled_floor
from twin.diagnose.refit import CRAWLING, NONE, Fitted, descend, foreseen, in_doubt_of_size, recorded_error
from twin.diagnose.rigid_axes import rigid_axes
from twin.diagnose.screen import FAR, inflation
from twin.diagnose.search import REFIT_LINES, SCREEN_LINES, WITHIN, Search, converge, explain, given_up, settle
from twin.diagnose.sensor_weight import weightless
from twin.diagnose.sentences import sentence
from twin.diagnose.states import sorted_out
from twin.diagnose.triage import Triage, triage
from twin.diagnose.verdict import (
    Candidate,
    Finding,
    Missing,
    Word,
    elsewhere,
    estimates_of,
    judge,
    missing_of,
    moved_most,
    rival_of,
    strained,
)
from twin.diagnose.within import base_with, taken_in, without
from twin.identify.damping_transfer import misses_of_frf, transfer
from twin.identify.elastic_compare import noise_floor
from twin.identify.objective import Sample
from twin.identify.posterior import Posterior
from twin.identify.struck import without_laws
from twin.measure.blows import blows
from twin.measure.campaign import Campaign, FloatArray
from twin.measure.recordings import Recording
from twin.model.cut_off import Leak
from twin.model.parameters import Parameters, free_parameters, require_springs, written_names
from twin.model.recorded import Recorded, base_name, prepare, without_limits
from twin.parallel import Progress, ahead
from twin.physics import CATALOGUE
from twin.result import listed
from twin.robot.description import Robot
from twin.robot.physical import as_written, physical

ABOUT = 2  # times that knowledge of moments is made linear where a fit ends: the second moves it by little


@dataclass
class HammerTest:
    """A hammer test as evidence."""

    recording: Recording

    @property
    def names(self) -> list[str]:
        """What can be held out: all force levels of a posture together, or one by one."""
        campaign: Campaign = self.recording.content
        return list(dict.fromkeys([*(base_name(campaign, group) for group in campaign.postures), *campaign.postures]))

    def explain(self, given: Robot, told_by: Finding | None, **options: Any) -> Finding:
        """See :class:`twin.diagnose.evidence.Evidence`."""
        return diagnose_campaign(self.recording.content, given, self.recording.source, told_by=told_by, **options)

    def again(self, finding: Finding, robot: Robot, last: Finding, hold_out: list[str] | None) -> None:
        """Nothing: what comes after it starts from its model."""

    def checks(self, written: Robot, finding: Finding, alone: bool) -> list[dict[str, Any]]:
        """FRFs by MuJoCo; a law of amplitude stepped under two force levels, unless a log found it."""
        if is_nonlinear(written) and alone:
            campaign, source = self.recording.content, self.recording.source
            if hit := check_blows(written, campaign, prepare(campaign, written, source), finding.unsure):
                return [hit]
        return [check_linear(written, [r for r in finding.records if isinstance(r, FrfRecord)])]


def diagnose_campaign(
    campaign: Campaign,
    given: Robot,
    source: str = "recording",
    *,
    hold_out: list[str] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    told_by: Finding | None = None,
    processes: int = 1,
    patience: Patience | None = None,
) -> Finding:
    """What a campaign in memory says.

    Args:
        campaign: as recorded.
        given: the description, removals applied.
        source: the file, for messages.
        hold_out: postures not to fit to; chosen when ``None``.
        seed: of the starts.
        progress: makes progress bars.
        told_by: what another recording of the same robot said. Its answer is in the model. What it knows of links and
            payloads is their prior. This campaign changes the probabilities of its answers.
        processes: the search is spread over so many; what it finds does not depend on it.
        patience: how long to look for more; for ever by default.

    Raises:
        InputError: the robot has no springs, or the campaign does not fit it.
    """
    require_springs(given)
    campaign, leaks = rewindowed(campaign)
    campaign, faults = put_right(campaign, without_limits(given), source)
    few, rest = apart(campaign, given, hold_out or ())
    patience = patience or Patience()
    finding = _diagnosed(few, _Ask(given, source, hold_out, seed, progress, told_by, processes, patience))
    others = [judged(finding, rest, source, len(few.postures))] if rest else []
    finding.warnings = [*patience.notes(), *leaks, *faults, *others, *finding.warnings]
    return finding


@dataclass(frozen=True)
class _Ask:
    """What is asked, see :func:`diagnose_campaign`.

    ``sorted``: the postures are known to be of one robot. ``leak``: how records leak that end
    while modes ring, ``leak_settled``: that was found beside an answer, ``whole``: they are taken not to leak.
    ``start``: where the model that found it came to rest, its first coordinates those of the base model.
    """

    given: Robot
    source: str
    hold_out: list[str] | None
    seed: int
    progress: Progress | None
    told_by: Finding | None
    processes: int
    patience: Patience
    sorted: bool = False
    leak: Leak | None = None
    leak_settled: bool = False
    whole: bool = False
    start: FloatArray | None = None


def _diagnosed(campaign: Campaign, ask: _Ask) -> Finding:
    """What a campaign says whose channels are as stated."""
    given, source, told_by = ask.given, ask.source, ask.told_by
    found = triage(campaign, given, source, ask.hold_out)
    every = list(found.recordings.values())
    if ask.leak:
        leaky = leaking(Sample(tuple(every)), campaign, ask.leak)
        found = replace(found, recordings={r.group: r for r in leaky.recordings})
    base = without_limits(told_by.model if told_by else given)
    sample = Sample(tuple(found.used), 1 / found.shared)
    free = _free(base, found.used)
    if told_by and told_by.fit:
        free = Knowledge.of(told_by.fit).on(free, base)
    law = found.nonlinear and not told_by
    plain = without_laws(base) if law else base  # a law that is described is found again, or another
    known = free if plain is base else _free(plain, found.used)
    if law:  # no law holds in a model that has nodes elsewhere than they are
        known = nodes_within(plain, campaign.response, campaign.excitation).parameters(known)
    search = converge(plain, known, sample, seed=ask.seed, processes=ask.processes, near=ask.start)
    if law and (told := levels_finding(campaign, given, plain, source, found, search, ask.progress, ask.seed)):
        return told
    if known is not free:
        search = converge(base, free, sample, seed=ask.seed, processes=ask.processes, near=ask.start)
    far = _misses(search, found)
    if again := _leaking(campaign, base, search.base, sample, every, ask):
        return again
    if far and (again := _without_hum(campaign, search.base, sample, ask) or _sorted_out(campaign, found, ask)):
        return again
    looked_at = _suspects(campaign, base, free, found)
    search.patience = ask.patience
    explain(base, search, sample, looked_at, ask.progress)
    if search.weighed:
        every = list(weightless(tuple(every), search.weighed))
        found = replace(found, recordings={r.group: r for r in every})
        sample = Sample(tuple(found.used), 1 / found.shared)
    best = min([search.base, *search.finalists], key=lambda fit: fit.cost)
    if again := _without_hum(campaign, best, sample, ask):
        return again
    if not given_up(search, best) and (again := _leaking(campaign, base, best, sample, every, ask)):
        return again
    answer = _answered(base, search, sample, looked_at, found, bool(told_by and told_by.fit))
    before = _as_described(base, search, answer, sample)
    if told_by and told_by.missing:
        before = _weighed(told_by, without_limits(given), answer.base, sample, ask.seed)
        told_by.missing = [_borne_out(m, answer.best) for m in told_by.missing]
    finding = _finding(given, source, found, search, answer, before)
    if not found.kept or (finding.missing and not falls(finding) and not told_by):
        each = left_out(before, answer.best, sample)
        told = _judged(finding, each, answer) if each else finding
        if not found.kept or (each and each.gain >= calibration()["seen"] and falls(told)):
            finding = told
    unseen = Sample(tuple(found.kept), sample.repeat)
    finding.warnings = [*finding.warnings, *_not_known_well(finding, answer.best, unseen)]
    few, blow = sample.thin(SCREEN_LINES), blows(campaign)
    laws = smallest_visible_laws(base, search.base, sample, blow) if blow else []
    finding.smallest_visible = [*smallest_visible(answer.base.robot, answer.base, few, looked_at), *laws]
    finding.next_test = _next_test(given, answer, few, ask.seed)
    if answer.word == "unexplained":
        if not far and (again := _sorted_out(campaign, found, ask)):
            return again
        finding.warnings = [*_beyond_a_linear_model(campaign, found, ask), *finding.warnings]
    return finding


def _beyond_a_linear_model(campaign: Campaign, found: Triage, ask: _Ask) -> list[Note]:
    """What of a recording that nothing explains no linear model can: records cut short, joints that move far."""
    plain = without_limits(ask.given)
    short = [] if ask.leak else cut_short(plain, campaign, found.used)
    return [*short, *([] if found.nonlinear else moved_far(plain, campaign, found.used))]


def _judged(finding: Finding, each: LeftOut, answer: "_Answer") -> Finding:
    """The finding with what blows left out in turn are missed by as its held-out error."""
    told = finding.with_each(each.names, each.error, None)
    told.missing = [replace(m, evidence=_told(m, told, len(answer.missing))) for m in answer.missing]
    return told


def _not_known_well(finding: Finding, fit: Fitted, kept: Sample) -> list[Note]:
    """Why postures kept aside are missed by more than noise, where the doubt of a fit's numbers explains it."""
    unseen = [r for r in finding.records if r.held_out]
    if finding.in_turn or finding.word == "unexplained" or not unseen:
        return []
    error, floor, most = finding.error["after"]["held_out"], pooled_floor(unseen), calibration()["held_out_adequate"]
    if not floor or error**2 <= most * floor**2 or misfit_unseen(foreseen(fit, kept)) > most:
        return []
    text = (
        f"{listed(finding.held_out)}, not used, is missed by {error:.2%}, {error / floor:.1f} times the noise. The "
        "doubt of the fitted numbers explains that, and no physics need be missing. More postures would make it less"
    )
    return [Note(text, "held_out", "note")]


def _misses(search: Search, found: Triage) -> bool:
    """Whether the base model misses by much more than noise, or has postures elsewhere than the file says.

    What the model was fitted to counts, and what was kept aside.
    """
    if search.error > FAR or any(note.kind == "posture" for note in strained(search.base)):
        return True
    if not found.kept:
        return False
    error, off = recorded_error(search.base.robot, found.kept)
    return off > STRAINED or error**2 - noise_floor(found.kept) ** 2 > FAR**2


def _without_hum(campaign: Campaign, fit: Fitted, sample: Sample, ask: _Ask) -> Finding | None:
    """What a campaign says without the lines that mains hum into; ``None`` where a fit leaves no hum."""
    quiet, hum = without_hum(campaign, fit, sample)
    if not hum:
        return None
    finding = _diagnosed(quiet, ask)
    finding.warnings = [*hum, *finding.warnings]
    return finding


def _leaking(
    campaign: Campaign, base: Robot, fit: Fitted, sample: Sample, every: Sequence[Recorded], ask: _Ask
) -> Finding | None:
    """What a campaign says whose records end while modes ring; ``None`` where that does not show.

    How they leak is found again beside the best that is known: the base model alone has it wrong by what it lacks. A
    model that is far off may gain by leaking though no record does. If nothing explains the recordings then, they are
    taken as whole.
    """
    if ask.whole:
        return None
    if ask.leak is None:
        found = cut_off(campaign, base, fit, sample, every)
    elif fit.hypothesis.pieces and not ask.leak_settled:
        found = *refined(ask.leak, campaign, base, fit, sample, every), []
    else:
        return None
    if found is None:
        return None
    leak, near, notes = found
    finding = _diagnosed(campaign, replace(ask, leak=leak, leak_settled=ask.leak is not None, start=near.z))
    far = finding.error["after"]["train"] ** 2 - finding.error["noise_floor"] ** 2 > FAR**2
    if ask.leak is None and finding.word == "unexplained" and far:
        whole = _diagnosed(campaign, replace(ask, whole=True))
        if whole.word != "unexplained":
            return whole
    finding.warnings = [*notes, *finding.warnings]
    return finding


def _sorted_out(campaign: Campaign, found: Triage, ask: _Ask) -> Finding | None:
    """What the postures of one robot say, wrong angles put right; ``None`` where all are of one and stand as stated."""
    sample = Sample(tuple(found.recordings.values()), 1 / found.shared)
    alone = len({r.setup.name for r in sample.recordings}) == len(sample.recordings) > 2
    if ask.sorted or ask.leak or ask.told_by or found.nonlinear or not alone:
        return None
    some, notes = sorted_out(without_limits(ask.given), campaign, sample, ask.processes)
    if not notes:
        return None
    held = ask.hold_out and [name for name in ask.hold_out if name in some.postures]
    finding = _diagnosed(some, replace(ask, hold_out=held, sorted=True))
    finding.warnings = [*notes, *finding.warnings]
    return finding


@dataclass(frozen=True)
class _Answer:
    """What the search was decided to say.

    Attributes:
        fits: every hypothesis fitted to the end.
        base, best: the base model and the answer, with bodies that can exist.
        links: names of numbers of links that may be wrong in the answer's stead.
        doubts: what base model and answer have free because the recordings show it, and the description allows.
        told: the number of the description that is wrong beside them.
    """

    decision: Decision
    word: Word
    missing: list[Missing]
    fits: list[Fitted]
    base: Fitted
    best: Fitted
    links: frozenset[str] = frozenset()
    doubts: tuple[Hypothesis, ...] = ()
    told: Missing | None = None

    @property
    def answered(self) -> bool:
        """Something has a name."""
        return self.word in ("named", "ambiguous")


def _suspects(campaign: Campaign, base: Robot, free: Parameters, found: Triage) -> list[list[Hypothesis]]:
    band = float(found.used[0].frequency[0]), float(found.used[0].frequency[-1])
    brakes = [r.setup.brakes for r in found.recordings.values()]
    physics = suspects(base, campaign.response, campaign.excitation, brakes, band)
    numbers = [[one] for one in described(free)]
    return [*physics, *rigid_axes(base), *numbers, *geometry(base, campaign.response, campaign.excitation, free.names)]


def _answered(
    base: Robot, search: Search, sample: Sample, looked_at: Sequence[Sequence[Hypothesis]], found: Triage, told: bool
) -> _Answer:
    """The decision over everything that was fitted; ``told``: the prior of masses is another recording's."""
    with ahead(lambda: _possible(search.base, base, sample), search.processes) as possible_base:
        return _decided(base, search, sample, looked_at, found, told, possible_base)


def _decided(
    base: Robot, search: Search, sample: Sample, looked_at: Sequence[Sequence[Hypothesis]], found: Triage, told: bool,
    possible_base: Callable[[], Fitted],
) -> _Answer:  # fmt: skip
    *others, settled = settle(base, search, sample)
    fits = that_foretell(that_show(others, base, sample.band_hz), sample, WITHIN)
    unseen = Sample(tuple(found.kept), sample.repeat) if found.kept else None
    axes = same_axes(base, [r.setup.q for r in sample.recordings])
    likeliest = fits[0] if fits else settled
    with ahead(lambda: search.lawless(likeliest, sample), search.processes) as of_likeliest:

        def among(some: Sequence[Fitted]) -> Decision:
            return decide(
                some, settled, looked_at, kept=unseen, axes=axes, processes=search.processes,
                unnamed=lambda fit: of_likeliest() if fit is likeliest else search.lawless(fit, sample),
            )  # fmt: skip

        decision, left = among(fits), list(fits)
        while decision.ranked and not all_predict(decision.ranked[0], fits, base, found, search.processes):
            left = [fit for fit in left if fit.hypothesis.identity != decision.ranked[0].hypothesis.identity]
            decision = among(left)
    if decision.ranked and given_up(search, decision.ranked[0]):
        decision = half_unnamed(decision)
    decision, beside = sifted(decision, base)
    doubts = beside.allowed if beside else ()
    if beside:
        settled = base_with(base, search.base.parameters, settled, beside, sample, sample.thin(REFIT_LINES))
        decision = in_doubt_beside(decision, settled, unseen)
    links: frozenset[str] = frozenset()
    if judge(decision) in ("named", "ambiguous"):
        decision, links = _or_its_link(decision, settled, base)
    word = judge(decision)
    answered = word in ("named", "ambiguous")
    if answered:
        best, *rest = decision.ranked
        decision = replace(decision, ranked=[in_doubt_of_size(best), *rest])
    missing = missing_of(decision, settled) if answered else []
    ends = [settled, decision.ranked[0]] if answered else [settled]
    number = None
    if told:
        ends[-1] = _where_it_ends(ends[-1], base, sample)
    elif word in ("adequate", "named", "ambiguous"):
        number = off_description(base, search.base.parameters, ends[-1], settled, others, sample, found.kept)
    if number:
        ends = [settled, number.fit]
        missing = [*missing, number.missing]
        if not answered:
            decision = replace(decision, none=1 - decision.other - calibration()["told"])
        word = "ambiguous" if word == "ambiguous" or number.missing.rivals else "named"
    ends = [possible_base() if end is search.base else _possible(end, base, sample) for end in ends]
    return _Answer(
        decision, word, missing, fits, ends[0], _loosened(ends[-1]), links, doubts,
        number.missing if number else None,
    )  # fmt: skip


def _where_it_ends(fit: Fitted, base: Robot, sample: Sample) -> Fitted:
    """A fit under what another recording knows of masses there, see :func:`about`."""
    known = fit.parameters
    for _ in range(ABOUT):
        parameters = about(known, fit.values)
        z = parameters.coordinates(fit.values)
        again = descend(base, fit.hypothesis, parameters, sample, z, tempered=0, tolerance=0.02)
        fit = replace(again, allowed=fit.allowed)
    return fit


def _or_its_link(decision: Decision, settled: Fitted, base: Robot) -> tuple[Decision, frozenset[str]]:
    """A mass on a link beside that link, where FRFs do not tell them apart, and the names of the link's numbers.

    Vibrations show the whole that moves. Where a link's own numbers explain it as well, if further from the description
    than their tolerance, half of the probability of the mass is theirs: weighing tells. So it is the other way round.
    """
    first, *others = decision.ranked
    pieces, seen = first.hypothesis.pieces, calibration()["seen"]
    known: dict[frozenset[str], Fitted] = {frozenset(): settled}
    known |= {fit.answers: fit for fit in decision.ranked}
    for piece in pieces:
        rest, link = known.get(first.answers - {piece.key}), _carrier(piece, base)
        if link is None or rest is None or data_cost(rest) - data_cost(first) >= seen:
            continue
        name = f"{link}mass"
        number = Hypothesis("parameter", name, scale=((name, 1.0),))
        beside = together(*(p for p in pieces if p is not piece), number)
        rival = replace(rest, hypothesis=beside, allowed=first.allowed)
        return _halved(decision, rival), frozenset(p.name for p in rest.parameters if p.name.startswith(link))
    for fit in others:
        gone = [piece for piece in pieces if piece.key not in fit.hypothesis.identity]
        new = [piece for piece in fit.hypothesis.pieces if piece.key not in first.hypothesis.identity]
        link = _carrier(new[0], base) if len(new) == 1 else None
        of_it = gone and all(piece.law is None and piece.site.startswith(str(link)) for piece in gone)
        if link and of_it and data_cost(fit) - data_cost(first) < seen:
            return _halved(decision, fit), frozenset(p.name for p in fit.parameters if p.name.startswith(link))
    return decision, frozenset()


def _carrier(piece: Hypothesis, base: Robot) -> str | None:
    """How names of numbers of the link begin on which a mass hangs; ``None`` of what is no mass on a link."""
    link = piece.law.carrier(base, piece.site) if piece.law and piece.entries else None
    return None if link is None else f"link{link + 1}."


def _halved(decision: Decision, rival: Fitted) -> Decision:
    """A decision whose first answer shares its probability and that of a rival with it, in halves."""
    first = decision.ranked[0]
    same = {first.hypothesis.identity, rival.hypothesis.identity}
    told = list(zip(decision.ranked, decision.probability, strict=True))
    half = 0.5 * sum(p for fit, p in told if fit.hypothesis.identity in same)
    others = [(fit, p) for fit, p in told if fit.hypothesis.identity not in same]
    return replace(
        decision, ranked=[first, rival, *(fit for fit, _ in others)], probability=[half, half, *(p for _, p in others)]
    )


def _finding(given: Robot, source: str, found: Triage, search: Search, answer: _Answer, before: Fitted) -> Finding:
    """The answer beside the recording."""
    sample = Sample(tuple(found.used), 1 / found.shared)
    settled, best, decision = answer.base, answer.best, answer.decision
    recordings = found.used, found.kept, found.shared, search.processes

    known, shown = Posterior.of(best), physical(best.robot)
    with ahead(lambda: misses_of_frf(shown, known, found.kept), search.processes) as missed:
        records, errors = frf_records(without_limits(given), before, best, *recordings)
        misses = missed()
    free = records
    if _zeros(best):  # against free angles, too, the zero of an axis has to gain
        free, _ = frf_records(without_limits(given), settled, best, *recordings)
    records = with_modes(records, physical(before.robot), physical(best.robot))
    errors["noise_floor"] = noise_floor(sample.recordings)
    where = mismatch(settled, sample.thin(REFIT_LINES))
    doubts = {doubt.key for doubt in answer.doubts}
    site = "+".join(p.site for p in best.hypothesis.pieces if p.key not in doubts) or next(iter(where.sites), "")
    written = [as_written(without(fit.robot, answer.doubts), given) for fit in (before, best)]
    finding = Finding(
        source, "frf-campaign", answer.word, answer.missing, decision.none, decision.other,
        given, written[0], written[1], errors, list(found.held_out), records,
        [{"recording": source, "site": site, **spot} for spot in where.spots()], where.sites,
        warnings=[
            *found.warnings, *elsewhere(search.base, search.others), *strained(best),
            *moved_most(best), *taken_in(answer.doubts, answer.best),
        ],
        finalists=finalists(search.base, answer.fits), gain=gained(free),
        fits=(before, best), damping=transfer(misses),
    )  # fmt: skip
    finding.missing = [replace(m, evidence=_told(m, finding, len(answer.missing))) for m in answer.missing]
    return finding


def _as_described(base: Robot, search: Search, answer: _Answer, sample: Sample) -> Fitted:
    """The base model as it would be without the answer: numbers that are answered are held as described.

    Of an axis whose zero is answered, those are the angles of all postures; of a mass that stands for its link, this.
    """
    fit, parameters = answer.base, search.base.parameters
    held = {name for name, _ in answer.best.hypothesis.scale} | answer.links
    held |= {p.name for p in parameters if p.kind == "posture" and p.axis in _zeros(answer.best)}
    if not held:
        return fit
    free = parameters.select(k for k, name in enumerate(parameters.names) if name not in held)
    known = dict(zip(written_names(fit.parameters).names, fit.values, strict=True))
    z = free.coordinates(np.array([known.get(p.name, p.mean) for p in free]))
    few = descend(base, NONE, free, sample.thin(REFIT_LINES), z, linear=20)
    return descend(base, NONE, free, sample, few.z, tempered=0, linear=20)


def _zeros(fit: Fitted) -> set[int]:
    """Axes (zero-based) whose zero is said to be elsewhere."""
    entries = [entry for piece in fit.hypothesis.pieces for entry in piece.entries]
    return {axis for e in entries for axis in CATALOGUE[e.effect].encoder_zero(e.site, e.values)}


def _loosened(fit: Fitted) -> Fitted:
    """A fit whose robot says how far angles of postures are off, if that is more than described."""
    freed = {name for name, _ in fit.hypothesis.scale}
    angles = [v for p, v in zip(fit.parameters, fit.values, strict=True) if p.kind == "posture" and p.name in freed]
    if not angles:
        return fit
    spread = float(np.rad2deg(np.sqrt(np.mean(np.square(angles)))))
    tolerances = fit.robot.tolerances.model_copy(update={"posture_deg": spread})
    return replace(fit, described=fit.robot.model_copy(update={"tolerances": tolerances}))


def _next_test(given: Robot, answer: _Answer, few: Sample, seed: int) -> dict[str, Any] | None:
    """What would tell the first answer from its rival; where that has no name, what shows the first most."""
    decision = answer.decision
    if answer.told and answer.told.rivals:
        names = [answer.told.first.key, *(rival.key for rival, _ in answer.told.rivals)]
        return {"description": WEIGH, "separates": names, "posture_deg": None}
    likely = bool(decision.probability) and decision.probability[0] >= calibration()["alternative"]
    if answer.word != "ambiguous" and not (answer.word == "unexplained" and likely):
        return None
    rival = rival_of(decision) if answer.answered else None
    if rival and answer.links:
        names = [piece.key for fit in (decision.ranked[0], rival) for piece in fit.hypothesis.pieces]
        return {"description": WEIGH, "separates": names, "posture_deg": None}
    return next_test(given, decision.ranked[0], rival or answer.base, few, seed)


def _free(base: Robot, used: Sequence[Recorded]) -> Parameters:
    """Everything a base model has free on recordings; the sag of its springs turns blows and sensors by 1e-3."""
    return free_parameters(base, dict.fromkeys(r.setup.name for r in used), used[0].setup.response.label)


def _possible(fit: Fitted, base: Robot, sample: Sample) -> Fitted:
    """A fit whose links are bodies that can exist: if they are not, the rest is fitted again with links that are.

    Those are the nearest to the fitted ones or the described ones, whichever explain the recordings better. For a fit
    that is far off they are the described ones.
    """
    robot = physical(fit.robot)
    if robot is fit.robot:
        return fit
    written = written_names(fit.parameters)
    free = written.only("spring", "entry", "axis", "posture", "sag", "gain", "point", "direction")
    values = np.array([fit.values[written.names.index(name)] for name in free.names])
    described = robot.model_copy(update={"links": base.links})
    few, fits = sample.thin(REFIT_LINES), []
    starts = [(described, np.zeros(len(free)), 25)]
    if inflation(fit, base, few) <= FAR:
        starts.append((robot, free.coordinates(values), 0))
    for start, z, logarithmic in starts:
        fits.append((descend(start, NONE, free, few, z, logarithmic=logarithmic, linear=5), start))
    best, start = min(fits, key=lambda pair: pair[0].cost)
    ended = descend(start, NONE, free, sample, best.z, tempered=0, linear=25, patience=CRAWLING)
    return replace(ended, hypothesis=fit.hypothesis)


def _weighed(told_by: Finding, given: Robot, settled: Fitted, sample: Sample, seed: int) -> Fitted:
    """The base model without what another recording found, whose probabilities change by what is said of them here.

    Every answer that can be seen here is fitted, starting where both recordings together have it (``settled``).
    """
    free = _free(given, sample.recordings)
    search = converge(given, free, sample, seed=seed)
    plain = settle(given, search, sample)[-1]
    gains: dict[str, float] = {}
    for missing in told_by.missing:
        if not shared(missing.first.effect):
            continue
        for answer in (missing.first, *(rival for rival, _ in missing.rivals)):
            for hypothesis in _hypotheses(answer, given, free):
                parameters = hypothesis.parameters(free)
                fit = descend(given, hypothesis, parameters, sample, _start(answer, parameters, settled), linear=20)
                gains[answer.key] = max(gains.get(answer.key, -np.inf), fit.evidence() - plain.evidence())
    told_by.missing, told_by.none = settled_with(told_by.missing, gains, told_by.none, told_by.other)
    return plain


def _hypotheses(rival: Candidate, base: Robot, free: Parameters) -> list[Hypothesis]:
    """A rival as a hypothesis about a hammer test; none where a hammer test cannot show it."""
    if rival.effect == "parameter":
        return [h for h in described(free) if h.site == rival.site]
    if not shared(rival.effect):
        return []
    values = CATALOGUE[rival.effect].typical(base, rival.site)
    return [entry_hypothesis(base, rival.effect, rival.site, values)] if values else []


def _start(answer: Candidate, parameters: Parameters, settled: Fitted) -> np.ndarray:
    """Where a search for an answer starts: what a fit with it has, then the answer's own numbers as they are known."""
    known = dict(zip(settled.parameters.names, settled.values, strict=True))
    for entry in answer.robot.physics:
        if (entry.effect, entry.site) == (answer.effect, answer.site):
            for name, given in (entry.model_extra or {}).items():
                items = {f"[{k}]": v for k, v in enumerate(given)} if isinstance(given, list) else {"": given}
                for index, value in items.items():
                    known.setdefault(f"{answer.key}.{name}{index}", value)
    values = np.array([float(known.get(p.name, p.mean)) for p in parameters])
    least = np.array([1e-3 * p.mean if p.log else -np.inf for p in parameters])
    return parameters.coordinates(np.maximum(values, least))


def _borne_out(missing: Missing, fit: Fitted) -> Missing:
    """Another recording's answer with its numbers fitted to both, where this one shows it too."""
    if not shared(missing.first.effect):
        return missing
    at = [k for k, p in enumerate(fit.parameters) if p.name.startswith(f"{missing.first.key}.")]
    return replace(missing, first=replace(missing.first, parameters=estimates_of(fit, at))) if at else missing


def _told(missing: Missing, finding: Finding, count: int) -> str:
    """The sentence of evidence, where the engine has not written one; of several answers, what all do together."""
    if missing.evidence:
        return missing.evidence
    of, name = (finding.error, finding.held_out), missing.first.phrase if count == 1 else "all that was found"
    return sentence(name, finding.records, *of, in_turn=finding.in_turn)
