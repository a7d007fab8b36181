"""``twin diagnose``: recordings in; what the model leaves out, how sure, and a new model out."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.diagnose.decide import calibration, decide, finalists
from twin.diagnose.edit import check_linear, check_replayed, check_xml, is_nonlinear, payload_edit, with_modes
from twin.diagnose.evidence import sentence
from twin.diagnose.hypotheses import Hypothesis, Sprung, entry_hypothesis, same_axes, suspects, widened
from twin.diagnose.joint import Knowledge, followed, pooled, predicted_by, settled_with, shared, together
from twin.diagnose.joint_reaction import blows
from twin.diagnose.levels_finding import check_blows, levels_finding
from twin.diagnose.levels_next import smallest_visible_laws
from twin.diagnose.locate import mismatch
from twin.diagnose.modal_table import diagnose_table
from twin.diagnose.next_test import next_test, smallest_visible
from twin.diagnose.physical import physical
from twin.diagnose.records import FrfRecord, LogRecord, frf_records
from twin.diagnose.refit import NONE, Fitted, descend, in_doubt_of_size, noise_floor
from twin.diagnose.screen import FAR, inflation
from twin.diagnose.search import REFIT_LINES, SCREEN_LINES, converge, explain, settle
from twin.diagnose.struck import without_laws
from twin.diagnose.triage import triage
from twin.diagnose.verdict import (
    Candidate,
    Finding,
    Missing,
    Verdict,
    elsewhere,
    estimates_of,
    judge,
    missing_of,
    rival_of,
    strained,
)
from twin.errors import InputError
from twin.identify.objective import Sample
from twin.identify.posterior import FILE, Posterior, save_posterior
from twin.identify.recorded import Recorded, base_name, prepare, without_limits
from twin.measure.campaign import Campaign
from twin.measure.recordings import Given, Recording, read_recordings, traced
from twin.memory import uncollected
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.parameters import Parameters, free_parameters
from twin.parallel import Progress, cores, silent, spread
from twin.physics import CATALOGUE
from twin.provenance import provenance, write_json
from twin.robot.description import Axis, Robot, load_robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, save_mjcf


def diagnose(
    recordings: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    hold_out: list[str] | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Verdict:
    """Diagnose recordings of one robot.

    Args:
        recordings: one or several of :class:`Campaign`, :class:`MotionLog`, :class:`ModalTable` or their files;
            universal files belong together.
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the recordings'.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        hold_out: postures or runs not fitted to, by name; by default those the others cover best.
        out: folder for the new model, report, figures and diagnosis.json; ``None`` writes nothing.
        seed: of the starts.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    progress = progress or silent
    order = ("motion-log", "frf-campaign", "modal-table")  # masses are known best from a log
    tests = sorted(read_recordings(recordings), key=lambda test: order.index(test.kind))
    given = _described(tests, robot).without(without or [])
    chosen = _shared_out(hold_out, tests)
    findings: list[Finding] = []
    for test, held in zip(tests, chosen, strict=True):
        told_by = findings[-1] if findings else None
        options: Any = {"hold_out": held, "seed": seed, "progress": progress}
        if test.kind == "motion-log":
            from twin.diagnose.torque import diagnose_log  # and SciPy's signals, a third of what there is to import
            from twin.identify.rigid import in_joints

            in_joints(test.content, given)  # axes, units and limits fit
            options |= {"processes": cores()}
            findings.append(diagnose_log(test.content, told_by.robot if told_by else given, test.source, **options))
        elif test.kind == "frf-campaign":
            options |= {"told_by": told_by, "processes": cores()}
            findings.append(diagnose_campaign(test.content, given, test.source, **options))
        else:
            findings.append(diagnose_table(test.content, told_by.model if told_by else given, test.source, **options))
    verdict = _settled(findings, tests, chosen)
    verdict.origin = provenance(
        traced(tests, robot), {"robot": robot, "without": without or [], "hold_out": hold_out, "seed": seed}
    )
    _finish(verdict, tests, out)
    return verdict


def _settled(findings: list[Finding], tests: Sequence[Recording], chosen: Sequence[list[str] | None]) -> Verdict:
    """The verdict on the one model that the last finding ends with; the others are judged on it.

    What a log said is said again with the errors of that model, and what the last recording adds to it.
    """
    if len(findings) == 1:
        return Verdict.of(findings[0])
    last = findings[-1]
    told_by = next((finding for finding in reversed(findings[:-1]) if finding.following), None)
    robot = told_by.following(last.robot) if told_by and told_by.following else last.robot
    if tests[-1].kind == "motion-log":  # it stands on what the others found, all numbers fitted
        robot = last.model
    for finding, test, held in zip(findings[:-1], tests, chosen, strict=False):
        if test.kind == "motion-log":
            from twin.diagnose.torque import with_evidence

            finding.records = predicted_by(robot, test.content, finding, held)
            finding.error = {**finding.error, "after": pooled(finding.records, "after")}
            finding.missing = [followed(m, finding.model, robot) for m in finding.missing]
            finding.missing = [_seen_by(last, m) for m in with_evidence(finding)]
    return together(findings, last.base, robot)


def _described(tests: Sequence[Recording], robot: Robot | str | Path | None) -> Robot:
    """The one robot of all recordings.

    Raises:
        InputError: the recordings name different robots.
    """
    named = {test.named: test for test in tests if test.named}
    if len(named) > 1 and not robot:
        first, second = list(named)[:2]
        raise InputError(
            str(named[second].source), "robot",
            f"is {second!r}, of {named[first].source} {first!r}; say which with --robot",
        )  # fmt: skip
    return next(iter(named.values()), tests[0]).described(robot)


def _shared_out(hold_out: list[str] | None, tests: Sequence[Recording]) -> list[list[str] | None]:
    """Names to hold out, each to the recordings that have it; a recording that none belongs to chooses itself.

    Raises:
        InputError: a name that no recording has.
    """
    has = [_names(test) for test in tests]
    for name in hold_out or []:
        if not any(name in names for names in has):
            known = "; ".join(f"{test.source} has {', '.join(names)}" for test, names in zip(tests, has, strict=True))
            raise InputError("--hold-out", name, f"no such posture or run: {known}")
    return [[name for name in hold_out or [] if name in names] or None for names in has]


def _names(test: Recording) -> list[str]:
    """Postures or runs that can be held out: all force levels of a posture together, or one by one."""
    if test.kind != "frf-campaign":
        return list(test.names)
    return list(dict.fromkeys([*(base_name(test.content, group) for group in test.names), *test.names]))


# --- hammer tests -----------------------------------------------------------------------------------------------------


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
) -> Finding:
    """What a campaign in memory says.

    Args:
        campaign: as recorded.
        given: the description, removals applied.
        source: the file, for messages.
        hold_out: postures not to fit to; chosen when ``None``.
        seed: of the starts.
        progress: makes progress bars.
        told_by: what another recording of the same robot said. Its answer is in the model, what it knows of links and
            payloads is their prior, and the probabilities of its answers change by what this campaign says of them.
        processes: the search is spread over so many; what it finds does not depend on it.

    Raises:
        InputError: the robot has no springs, or the campaign does not fit it.
    """
    if not free_parameters(given, tolerances=False).items:
        raise InputError(given.name, "axes", "expected at least one axis with a stiffness: nothing can vibrate")
    found = triage(campaign, given, source, hold_out)
    base = without_limits(told_by.model if told_by else given)
    sample, kept = Sample(tuple(found.used), 1 / found.shared), found.kept
    free = _free(base, found.used)
    if told_by and told_by.fit:
        free = Knowledge.of(told_by.fit).on(free, base)
    law = found.nonlinear and not told_by
    plain = without_laws(base) if law else base  # a law that is described is found again, or another
    known = free if plain is base else _free(plain, found.used)
    search = converge(plain, known, sample, seed=seed, processes=processes)
    if law and (answer := levels_finding(campaign, given, plain, source, found, search, progress, seed)):
        return answer
    if plain is not base:
        search = converge(base, free, sample, seed=seed, processes=processes)
    band = float(found.used[0].frequency[0]), float(found.used[0].frequency[-1])
    brakes = [r.setup.brakes for r in found.recordings.values()]
    looked_at = suspects(base, campaign.response, campaign.excitation, brakes, band)
    explain(base, search, sample, looked_at, progress)
    *fits, settled = settle(base, search, sample)
    unseen = Sample(tuple(kept), sample.repeat) if kept else None
    axes = same_axes(base, [r.setup.q for r in sample.recordings])
    decision = decide(fits, settled, looked_at, kept=unseen, unnamed=lambda fit: search.lawless(fit, sample), axes=axes)
    word = judge(decision)
    answered = word in ("named", "ambiguous")
    if answered:
        best, *others = decision.ranked
        decision = replace(decision, ranked=[in_doubt_of_size(best), *others])
    missing = missing_of(decision, settled) if answered else []
    ends = [settled, decision.ranked[0]] if answered else [settled]
    settled, *answers = spread(lambda number: _possible(ends[number], base, sample), len(ends), processes)
    before, best = settled, answers[0] if answers else settled
    if told_by and told_by.missing:
        before = _weighed(told_by, without_limits(given), settled, sample, seed)
    records, errors = frf_records(without_limits(given), before, best, found.used, kept)
    records = with_modes(records, physical(before.robot), physical(best.robot))
    errors["noise_floor"] = noise_floor(sample.recordings)
    where = mismatch(settled, sample.thin(REFIT_LINES))
    site = best.hypothesis.site or next(iter(where.sites), "")
    few = sample.thin(SCREEN_LINES)
    blow = blows(campaign)
    amplitude_laws = smallest_visible_laws(base, search.base, sample, blow) if blow else []
    finding = Finding(
        source, "frf-campaign", word, missing, decision.none, decision.other,
        given, _limited(before.robot, given), _limited(best.robot, given), errors, list(found.held_out), records,
        [{"recording": source, "site": site, **spot} for spot in where.spots()], where.sites,
        [*smallest_visible(settled.robot, settled, few, looked_at), *amplitude_laws],
        warnings=[*found.warnings, *elsewhere(search.base, search.others), *strained(best)],
        finalists=finalists(search.base, fits),
        fits=(before, best),
    )  # fmt: skip
    finding.missing = [replace(m, evidence=_told(m, finding)) for m in missing]
    if told_by:
        told_by.missing = [_borne_out(m, best) for m in told_by.missing]
    likely = bool(decision.probability) and decision.probability[0] >= calibration()["alternative"]
    if word == "ambiguous" or (word == "unexplained" and likely):
        # where the rival has no name, what shows the first most tells most
        rival = rival_of(decision) if answered else None
        finding.next_test = next_test(given, decision.ranked[0], rival or settled, few, seed)
    return finding


def _free(base: Robot, used: Sequence[Recorded]) -> Parameters:
    """Everything a base model has free on recordings; the sag of its springs turns blows and sensors by 1e-3."""
    return free_parameters(base, dict.fromkeys(r.setup.name for r in used), used[0].setup.response.label)


def _possible(fit: Fitted, base: Robot, sample: Sample) -> Fitted:
    """A fit whose links are bodies that can exist: if they are not, the rest is fitted again with links that are.

    Those are the nearest to the fitted ones, or the described ones, whichever explains the recordings better; of a fit
    that is far off they are the described ones.
    """
    robot = physical(fit.robot)
    if robot is fit.robot:
        return fit
    written = fit.parameters.written if isinstance(fit.parameters, Sprung) else fit.parameters
    free = written.only("spring", "entry", "posture", "sag", "gain")
    values = np.array([fit.values[written.names.index(name)] for name in free.names])
    described = robot.model_copy(update={"links": base.links})
    few, fits = sample.thin(REFIT_LINES), []
    starts = [(described, np.zeros(len(free)), 25)]
    if inflation(fit, base, few) <= FAR:
        starts.append((robot, free.coordinates(values), 0))
    for start, z, logarithmic in starts:
        fits.append((descend(start, NONE, free, few, z, logarithmic=logarithmic, linear=5), start))
    best, start = min(fits, key=lambda pair: pair[0].cost)
    return replace(descend(start, NONE, free, sample, best.z, tempered=0, linear=25), hypothesis=fit.hypothesis)


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
        return [h for h in widened(free) if h.site == rival.site]
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


def _seen_by(finding: Finding, missing: Missing) -> Missing:
    """Another recording's answer with a second sentence of evidence, of a hammer test that shows it too."""
    if finding.source != "frf-campaign" or not shared(missing.first.effect):
        return missing
    text = sentence(missing.first.title, finding.records, finding.error, finding.held_out)
    return replace(missing, evidence=f"{missing.evidence} In {Path(finding.recording).name}: {text}")


def _told(missing: Missing, finding: Finding) -> str:
    """The sentence of evidence, where the engine has not written one."""
    if missing.evidence:
        return missing.evidence
    return sentence(missing.first.title, finding.records, finding.error, finding.held_out)


def _limited(robot: Robot, given: Robot) -> Robot:
    """A fitted robot with inertias a body can have and the limits the fit took away."""
    robot = physical(robot)
    axes: list[Axis] = [
        axis.model_copy(update={"limits": old.limits}) for axis, old in zip(robot.axes, given.axes, strict=True)
    ]
    return robot.model_copy(update={"axes": axes})


# --- what is written --------------------------------------------------------------------------------------------------


def _finish(verdict: Verdict, tests: Sequence[Recording], out: str | Path | None) -> None:
    """Write the model, check it as written, and write what people look at; all of it or nothing."""
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            _check(verdict, tests, _write_model(verdict, Path(folder)))
        return
    with Outputs(out) as name:
        _write_model(verdict, name("robot.yaml").parent)
        name("robot.xml")
        if verdict.findings[-1].fits:
            name(FILE)
        _check(verdict, tests, name.stage)
        verdict.model = {"robot": "robot.yaml", "mjcf": "robot.xml"}
        with uncollected():
            _write_report(verdict, name)
        page = name("diagnosis.json")
        verdict.files = list(name.files)
        write_json(page, verdict.data())


def _write_model(verdict: Verdict, folder: Path) -> Path:
    save_robot(folder / "robot.yaml", verdict.robot)
    if fits := verdict.findings[-1].fits:
        save_posterior(folder / FILE, Posterior.of(fits[-1]))
    q, brakes = _posture(verdict)
    save_mjcf(folder / "robot.xml", build_spec(assemble(without_limits(verdict.robot), q, brakes=brakes)))
    return folder


def _posture(verdict: Verdict) -> tuple[np.ndarray, Any]:
    """Where robot.xml stands: the first posture of the recordings."""
    for finding in verdict.findings:
        for record in finding.records:
            if isinstance(record, FrfRecord):
                return record.q, record.brakes or "off"
            if isinstance(record, LogRecord):
                return record.position[0], "off"
            return record.q, "on"
    return np.zeros(verdict.robot.axis_count), "off"


def _check(verdict: Verdict, tests: Sequence[Recording], folder: Path) -> None:
    """The edit test: the written model, read again, in MuJoCo."""
    written = load_robot(folder / "robot.yaml")
    for finding, test in zip(verdict.findings, tests, strict=True):
        if test.kind == "motion-log":
            name = next((name for name in test.names if name in finding.held_out), test.names[0])
            verdict.checks.append(check_replayed(written, test.content.runs[name], test.source))
    frfs = [r for finding in verdict.findings for r in finding.records if isinstance(r, FrfRecord)]
    if frfs:
        verdict.checks += _hit(written, tests) or [check_linear(written, frfs)]
        verdict.payload_edit = payload_edit(verdict.base, verdict.robot, frfs)
    verdict.checks.append(check_xml(folder / "robot.xml", written, *_posture(verdict)))


def _hit(robot: Robot, tests: Sequence[Recording]) -> list[dict[str, Any]]:
    """A nonlinear answer stepped under the blows of a campaign with force levels; none where there is neither."""
    hit = is_nonlinear(robot) and all(test.kind != "motion-log" for test in tests)  # what a log found is not
    campaigns = [test for test in tests if test.kind == "frf-campaign"] if hit else []
    found = [check_blows(robot, test.content, prepare(test.content, robot, test.source)) for test in campaigns]
    return [check for check in found if check]


def _write_report(verdict: Verdict, name: Outputs) -> None:
    """Figures, the page and the modes before and after."""
    from twin.report import diagnosis
    from twin.report.html import write_html
    from twin.report.scene import write_modes

    q, brakes = _posture(verdict)
    for stage, shown in (("before", verdict.base), ("after", verdict.robot)):
        mechanism = assemble(without_limits(shown), q, brakes=brakes)
        found = modes(linearise(mechanism))
        if len(found):
            write_modes(name(f"modes-{stage}.rrd"), mechanism, found)
    images = name.draw(verdict)
    origin = verdict.origin
    footer = f"twin {origin['version']} · " + " · ".join(f"{k} {v[:12]}" for k, v in origin["inputs"].items())
    sections = diagnosis.sections(verdict, images)
    write_html(name("diagnosis.html"), diagnosis.title(verdict), diagnosis.lead(verdict), sections, footer)
