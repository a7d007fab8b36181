"""What a motion log says is missing from a robot description: the motion-log side of ``twin diagnose``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.diagnose.borne_out import falls, tension
from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision
from twin.diagnose.edit import check_replayed
from twin.diagnose.joint import followed, shared
from twin.diagnose.note import Note
from twin.diagnose.patience import Patience
from twin.diagnose.records import STAGES, FrfRecord, LogRecord, Stage, pooled_floor
from twin.diagnose.refit import Fitted
from twin.diagnose.sentences import sentence
from twin.diagnose.torque_faults import sound
from twin.diagnose.torque_fit import base_fit, profiled, worth
from twin.diagnose.torque_following import Following
from twin.diagnose.torque_left_out import left_out_runs
from twin.diagnose.torque_locate import disturbances, spots
from twin.diagnose.torque_nearest import nearest
from twin.diagnose.torque_next import next_log, smallest_visible
from twin.diagnose.torque_off import as_described, bare, far_off, numbers_of_answer, taken_back, told
from twin.diagnose.torque_play import Play, missing_play, plays, with_play
from twin.diagnose.torque_revise import at_once, seen_at_rest_only
from twin.diagnose.torque_search import Search, explain
from twin.diagnose.torque_states import RunStates
from twin.diagnose.torque_step import REFITTED, Step, left_out, possible
from twin.diagnose.torque_suspects import Suspect, log_suspects, not_sought, with_values
from twin.diagnose.torque_system import System, system_of
from twin.diagnose.verdict import Finding, Missing, Word, estimates_of, missing_of, off_descriptions
from twin.diagnose.verdict import judge as word_of
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.measure.motion_excerpt import excerpt
from twin.measure.motion_log import MotionLog
from twin.measure.recordings import Recording
from twin.measure.torque_unit import unit_note
from twin.model.torque_base import Base, base_of, with_whole_friction
from twin.model.torque_clock import clock_rates, described_torque, on_time
from twin.model.torque_laws import model_torque
from twin.model.torque_numbers import GAIN, number_columns, numbers_of
from twin.model.torque_robot import that_can_exist, with_presliding
from twin.model.torque_rows import Bands, in_joints
from twin.model.torque_signal import Prepared, Run, prepare
from twin.model.torque_stops import stops_of
from twin.parallel import Progress
from twin.physics import CATALOGUE, effect_named, effect_of
from twin.physics.effect import axis_of
from twin.robot.description import Entry, Robot

SHORT_S = 40.0  # of motion in all: 10 Hz of it have 800 rows of a joint, some ten for each number of a robot
LISTED = 3  # keys that a sentence lists; more are counted
TIMES_WIDER = (2.0, 4.0)  # times the low-pass, tried on what is shorter


def diagnose_log(
    log: MotionLog,
    robot: Robot,
    source: str = "motion log",
    *,
    hold_out: list[str] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    bands: Bands | None = None,
    processes: int = 1,
    patience: Patience | None = None,
) -> Finding:
    """What a motion log says.

    Args:
        log: as recorded.
        robot: the description, removals applied.
        source: the file, for messages.
        hold_out: runs not to use; chosen when ``None``.
        seed: kept for one signature with the hammer test's; nothing here is random.
        progress: makes progress bars.
        bands: low-passes; what the log allows by default. Of a short log that an answer misses wider ones are tried,
            and kept where the first is not adequate beside them.
        processes: what can be is spread over so many; what it finds does not depend on it.
        patience: how long to try wider bands; for ever by default.

    Raises:
        InputError: no torque, too short, or runs that are not there.
    """
    robot = with_whole_friction(robot)
    asked, prepared = log, prepare(log, robot, source, hold_out, bands)
    log, prepared, faults, rates = _on_one_clock(log, prepared, source, hold_out)
    log, hold_out, pieces = excerpt(log, hold_out, prepared.bands.fit[1])
    parts = [Note(text, severity="note") for text in pieces]
    if parts:
        prepared, faults = prepare(log, robot, source, hold_out, prepared.bands), [*faults, *parts]

    def again(largest: Sequence[str], notes: Sequence[str]) -> Finding:
        """The finding of the runs of one robot, with what was put right."""
        some = replace(log, runs={name: run for name, run in log.runs.items() if name in largest})
        held = [name for name in hold_out or [] if name in largest] or None
        finding = diagnose_log(
            some, robot, source, hold_out=held, progress=progress, bands=prepared.bands, processes=processes,
            patience=patience,
        )  # fmt: skip
        finding.warnings = [*notes, *faults, *_clocks(rates), *finding.warnings]
        return finding

    system = base_system(prepared, processes)
    states = RunStates(prepared, log_suspects(robot, prepared.used), processes)
    of_one, notes = states.largest() if states.mixed(system) else ([], [])
    if of_one:
        return again(of_one, notes)
    search, suspects = searched(system, prepared, progress, processes)
    if late := clock_rates(_runs(prepared), predicted_runs(prepared, search)):  # with what was found, it shows better
        rates = {name: rates.get(name, 0.0) + late.get(name, 0.0) for name in {**rates, **late}}
        log = on_time(log, late)
        prepared = prepare(log, robot, source, hold_out, prepared.bands)
        search, suspects = searched(base_system(prepared, processes), prepared, progress, processes)
    if not notes and (
        _answer(search)[0] == "unexplained" or search.held_out_misfit > calibration()["held_out_adequate"]
    ):
        of_one, notes = RunStates(prepared, suspects, processes).largest()
    if of_one:
        return again(of_one, notes)
    put = [*notes, *faults, *_clocks(rates)]
    finding = _borne_out(log, robot, source, prepared, search, suspects, put, processes)
    adequate = calibration()["held_out_adequate"]
    if bands is not None or max(search.held_out_misfit, search.after.misfit) <= adequate:
        return finding
    best = finding
    patience = patience or Patience()
    for wider in wider_bands(prepared, log):
        if patience.over("wider bands"):
            break
        other = diagnose_log(
            asked, robot, source, hold_out=hold_out, progress=progress, bands=wider, processes=processes
        )
        if other.error["after"]["held_out"] > best.error["after"]["held_out"]:
            break
        best = other
    better = adequate * best.error["after"]["held_out"] ** 2 < finding.error["after"]["held_out"] ** 2
    chosen = best if better else finding
    chosen.warnings = [*patience.notes(), *chosen.warnings]
    return chosen


def _borne_out(
    log: MotionLog, robot: Robot, source: str, prepared: Prepared, search: Search, suspects: list[Suspect],
    put: Sequence[str], processes: int,
) -> Finding:  # fmt: skip
    """The finding; without what does not lower the error of the runs kept aside, or of those left out in turn."""
    finding = _finding(log, robot, source, prepared, search, suspects, put, processes)
    if not finding.missing or falls(finding):
        return finding
    if back := taken_back(search):
        numbers = _finding(log, robot, source, prepared, back, suspects, put, processes)
        if falls(numbers):
            return numbers
    if search.law is None:  # another number of the base model may have moved, within noise
        as_likely = replace(search, after=nearest(search.system, search.after, as_described(search)))
        near = _finding(log, robot, source, prepared, as_likely, suspects, put, processes)
        if falls(near):
            return near
        if falls(in_turn := _left_out(finding, prepared, search, processes)):
            return in_turn
    refused = [missing for missing in finding.missing if effect_named(missing.first.effect).part != "play"]
    if len(refused) < len(finding.missing):  # the second encoder shows the play without them
        put = [*put, tension(refused)]
        return _finding(log, robot, source, prepared, bare(search), suspects, put, processes)
    return finding


def _left_out(finding: Finding, prepared: Prepared, search: Search, processes: int) -> Finding:
    """The finding with the error on every run left out in turn, where that is another one."""
    each = left_out_runs(
        prepared, search, lambda rest, some: log_records(rest, as_described(some), some)[0],
        lambda records, stage: pooled(records, stage)["held_out"], processes,
    )  # fmt: skip
    if each is None:
        return finding
    told = finding.with_each(each.names, each.error, each.gain)
    told.missing = with_evidence(told)
    return told


def _finding(
    log: MotionLog, robot: Robot, source: str, prepared: Prepared, search: Search, suspects: list[Suspect],
    notes: Sequence[str], processes: int,
) -> Finding:  # fmt: skip
    """What was found, beside the log as rows; ``notes`` on what was put right in it."""
    word, missing, none, other = _answer(search)
    base = as_described(search)
    records, errors = log_records(prepared, base, search)
    if errors["before"]["train"] > calibration()["worse"] * errors["as_given"]["train"]:  # the fit led astray
        base = replace(base, z=np.zeros(len(base.z)), described=robot)
        records, errors = log_records(prepared, base, search)
    after, _ = _after(search)
    robot_after = after.robot
    found_plays = _plays(search)
    gaps = [play for play in found_plays if play.seen]
    for play in gaps:
        robot_after = with_play(robot_after, play)
        missing.append(missing_play(play, robot_after))
        word, none = "named" if word in ("adequate", "unexplained") else word, min(none, 1 - play.probability)
    restless = disturbances(log, search, source, processes)
    finding = Finding(
        source, "motion-log", word, missing, none, other, robot, base.robot, robot_after, errors,
        list(prepared.held_out), records, spots(records, source, prepared.bands.fit[1]) + restless,
        {f"joint{j + 1}": float(gain) for j, gain in enumerate(search.free)},
        [*smallest_visible(search.plain, suspects, processes, search.after.misfit), *_visible(found_plays)],
        warnings=[
            *_still_off(records), *prepared.notes, *notes, *not_sought(robot), *map(_restless, restless),
            *_told_apart(search), *_resized(search), *_curved(search), *_narrow(search), *_strained(search),
            *_bodies(prepared, search, errors),
        ],
        fit=after, finalists=_finalists(search, found_plays), held_out_misfit=search.bare,
        written=with_presliding(search.system, after.z, search.system.entries(after.z), robot_after),
        following=Following(search.system, after, gaps), bare=Following(search.plain, base),
        bands=prepared.bands, content=log,
    )  # fmt: skip
    if word == "ambiguous":
        finding.next_test = next_log(next(m for m in missing if m.rivals))
    finding.apart = _slips(search) | _late(search)
    finding.missing = with_evidence(finding)
    return finding


def base_system(prepared: Prepared, processes: int = 1) -> System:
    """The base model on the rows used."""
    return system_of(prepared, log_suspects(prepared.regressor.robot, prepared.used), processes=processes)


def _clocks(rates: dict[str, float]) -> list[Note]:
    """A note on clocks that run apart, s/s, if any do."""
    told = ", ".join(f"{1e6 * rate:+.0f} ppm in '{name}'" for name, rate in rates.items())
    text = (
        f"the clock of torque runs apart from that of positions: torque falls behind by {told}; it was put back "
        "before the diagnosis"
    )
    return [Note(text, "clock", "fail", runs=tuple(rates))] if rates else []


def _runs(prepared: Prepared) -> list[Run]:
    """Every run once."""
    return [*{run.name: run for run in (*prepared.kept, *prepared.used)}.values()]


def _on_one_clock(
    log: MotionLog, prepared: Prepared, source: str, hold_out: list[str] | None
) -> tuple[MotionLog, Prepared, list[str], dict[str, float]]:
    """A log whose torque has the clock of its positions, its rows, a note on its unit, and rates of clocks, s/s."""
    robot, bands, runs = prepared.regressor.robot, prepared.bands, _runs(prepared)
    needed = [described_torque(prepared.regressor, run) for run in runs]
    told = unit_note(*(np.concatenate(some) for some in (needed, [run.torque for run in runs])))
    rates = clock_rates(runs, needed)
    if rates:
        punctual = prepare(on_time(log, rates), robot, source, hold_out, bands)
        if _cost(prepared) - _cost(punctual) > calibration()["first"]:
            log, prepared = on_time(log, rates), punctual
        else:  # numbers of the description that are a little off made torque late
            rates = {}
    return log, prepared, [told] if told else [], rates


def _cost(prepared: Prepared) -> float:
    """Of the base model fitted to all runs."""
    return base_fit(base_system(replace(prepared, used=_runs(prepared)))).cost


def searched(
    system: System, prepared: Prepared, progress: Progress | None, processes: int
) -> tuple[Search, list[Suspect]]:
    """What is missing, and what was suspected: what drives have, as the log shows it."""
    suspects = log_suspects(base_fit(system).robot, prepared.used)
    search = told(explain(system, prepared.kept, suspects, progress, processes))
    if search.found and not any(possible(search.system, step) for step in search.found):
        numbers = told(bare(search))  # numbers of the description may be what no effect can be: a link that is lighter
        search = numbers if numbers.found else search
    return search, suspects


def predicted_runs(prepared: Prepared, search: Search) -> list[FloatArray]:
    """Torque (m, n) of every run, with what was found."""
    after, entries = _after(search)
    runs = _runs(prepared)
    base, z = base_of(prepared.regressor, runs, search.plain.base.sliding), search.system.plain(after.z)
    return [predicted_torque(base, k, z, entries, run.valid) for k, run in enumerate(runs)]


def with_evidence(finding: Finding) -> list[Missing]:
    """The answers of a log, each with what it puts right at its joint and how far it can be told from what is alike.

    The encoders' step that shows a gap is told where it was found: the torque shows none.
    """
    return [
        m if effect_named(m.first.effect).part == "play" else replace(m, evidence=_evidence(m, finding))
        for m in finding.missing
    ]


def _evidence(missing: Missing, finding: Finding) -> str:
    first = missing.first
    joint = axis_of(first.site) if first.site.startswith("joint") else None
    name = first.phrase if len(finding.missing) == 1 else f"{first.phrase} and what else was found,"
    told = sentence(name, finding.records, finding.error, finding.held_out, joint, finding.in_turn)
    return " ".join([told, *finding.apart.get(first.key, ())])


def _restless(spot: dict[str, Any]) -> str:
    low, high = spot["band_hz"]
    return (
        f"run '{spot['run']}' is restless at {low:.0f}-{high:.0f} Hz on {spot['site']}, above the band of the fit, and "
        "another run is not. Nothing in the model explains that, and it is not named"
    )


def _narrow(search: Search) -> list[str]:
    """Of a description that allows too little: which numbers stay farthest from it."""
    if search.narrow == 1.0:
        return []
    described = np.arange(search.plain.base.spread.shape[1])
    z = search.system.plain(search.after.z)[described]
    far = ", ".join(search.plain.parameters.names[k] for k in np.argsort(-np.abs(z))[:3])
    return [
        "the description's tolerances are too narrow for this log. With the found effects in the model they were made "
        f"{search.narrow:.0f} times as wide ({far} are farthest from the description)"
    ]


def _resized(search: Search) -> list[Note]:
    """A note on described friction, of all joints, that is of another size than the log shows."""
    if search.resized is None:
        return []
    names, notes = search.plain.parameters.names, []
    values = search.plain.base.values(search.system.plain(_after(search)[0].z))
    for kind in dict.fromkeys(name.partition("@")[0] for name, _ in search.resized.scale):
        some = [name for name, _ in search.resized.scale if name.startswith(f"{kind}@")]
        means = {p.name: p.mean for p in search.plain.parameters}
        told = ", ".join(f"{n.partition('@')[2]} {means[n]:.3g} → {values[names.index(n)]:.3g}" for n in some)
        text = (
            f"{kind} of the description is of another size than the log shows at all joints ({told}). It may be in "
            "another unit, of the motors instead of the joints, or what a simulator was given"
        )
        notes.append(Note(text, "description", sites=tuple(some)))
    return notes


def _curved(search: Search) -> list[Note]:
    """A note on friction that is no straight line in speed at most joints."""
    if not search.plain.found:
        return []
    told = []
    for entry in search.system.entries(_after(search)[0].z)[: len(search.plain.found)]:
        told.append(f"{entry.site} {entry.values['coefficients'][0]:.3g}")
    text = (
        "friction of most joints is no straight line in speed. Beside dry and viscous friction it has the term "
        f"c |v| v, with c in N·m·s²/rad², of a slide N·s²/m² ({', '.join(told)}). Below zero, a gear needs less at "
        "high speed than viscous friction would. It is in the model before and after, and in robot.yaml under "
        "`discovered`. It is no answer"
    )
    return [Note(text, "description", "note", sites=tuple(suspect.hypothesis.site for suspect in search.plain.found))]


def _strained(search: Search) -> list[Note]:
    """A note on every number of the description that comes out far from it beside all that was found."""
    fit = search.law[2] if search.law else search.after
    return off_descriptions(fit, far_off(search, fit))


def _told_apart(search: Search) -> list[str]:
    """Of what would be the recording's, of all joints at once, and was not found though alone it would explain much."""
    found = {step.key for step in search.found}
    if not found:
        return []
    alone: dict[str, float] = {}
    for step in [search.first, *search.steps]:
        for fit in step.decision.ranked:
            trial = step.trials.get(fit.hypothesis.key)
            whole = trial is not None and len(trial.column.joints) > 1 and trial.suspect.effect.records_torque
            if whole and fit.hypothesis.key not in found:
                gain = fit.evidence() - step.base.evidence()
                alone[fit.hypothesis.key] = max(alone.get(fit.hypothesis.key, 0.0), gain)
    last, notes = search.steps[-1], []
    together = search.after.evidence() - base_fit(search.plain).evidence()
    for key, gain in alone.items():
        beside = {f.hypothesis.key: f.evidence() - last.base.evidence() for f in last.decision.ranked}.get(key, 0.0)
        if found and gain > calibration()["further"] and not last.accepted:
            names = ", ".join(sorted(found)) if len(found) <= LISTED else f"the {len(found)} effects of the search"
            if beside >= calibration()["further"]:
                verdict = f"{key} still gains {beside:.0f}, and was not taken in: a part of the error may be its"
            else:
                clear = gain < together - calibration()["further"]
                tells = "tells" if clear else "does not tell"
                verdict = f"{key} gains {max(beside, 0.0):.0f}: the log {tells} them apart"
            notes.append(
                f"{key} alone would gain {gain:.0f} in ln evidence; {names} together gain {together:.0f}. "
                f"With {names} in the model, {verdict}"
            )
    return notes


def _slips(search: Search) -> dict[str, list[str]]:
    """Of each slip found, what became of dry friction, and how far low-speed friction would do in its place."""
    notes: dict[str, list[str]] = {}
    for slip in search.found:
        if not slip.effect.memory:
            continue
        own = notes.setdefault(slip.key, [])
        site = slip.first.hypothesis.site.partition(".")[0]
        dry, low = f"{effect_of('dry').name}@{site}", f"{_fading()}@{site}"
        looks = [{f.hypothesis.key: f.evidence() - s.base.evidence() for f in s.decision.ranked} for s in search.steps]
        if (gain := max((look.get(dry, 0.0) for look in looks), default=0.0)) > calibration()["further"]:
            more = any(s.key == dry and not possible(search.system, s) for s in search.found)
            own.append(
                f"Coulomb friction at {site} came first, with a gain of {gain:.0f} in ln evidence. Slip is dry "
                "friction with memory, and now includes it."
                f"{' It holds more torque at rest than friction has in motion.' * more}"
            )
            notes[dry] = [
                f"It is the part of slip at {site} that changes its sign between two samples after nearly every "
                "reversal. It keeps its torque through a standstill, so the model has it as a slip element."
            ]
        both = [look for look in looks if low in look and slip.key in look]
        if both:
            tells = "tells" if both[-1][slip.key] - both[-1][low] > calibration()["further"] else "does not tell"
            own.append(
                f"Slip gained {both[-1][slip.key]:.0f} in ln evidence; low-speed friction in its place gained "
                f"{max(both[-1][low], 0.0):.0f}. The log {tells} them apart."
            )
        beside = next((s for s in search.found if s.key == low), None)
        if beside is not None and beside.trial is not None:
            now = worth(search.system, beside.trial.suspect)
            gains = f"gained {beside.gain:.0f} in ln evidence when it was found"
            text = f"Low-speed friction at {site} {gains}. With all that was found in the model it is worth {now:.0f}"
            if any(s is beside for s in _at_rest(search)):
                text += (
                    ". One sample after most reversals the axis is already faster than the speed over which this "
                    "friction falls. The log shows that friction is larger at rest than in motion. It does not show "
                    "how friction falls with speed. Slip may have the same effect: the log does not tell them apart"
                )
            own.append(f"{text}.")
            notes[low] = [own[-1]]
    return notes


def _late(search: Search) -> dict[str, list[str]]:
    """Of a delay found beside slip, how much of what it would have explained slip does: they are nearly alike."""
    slips = [step for step in search.found if step.effect.memory]
    notes: dict[str, list[str]] = {}
    for step in search.found:
        if not (step.effect.records_torque and "reversals" in step.effect.log_tests) or not slips:
            continue
        most = max(
            fit.evidence() - other.base.evidence()
            for other in search.steps
            for fit in other.decision.ranked
            if fit.hypothesis.key == step.key
        )
        lost = search.after.evidence() - base_fit(left_out(search.system, step, iterations=REFITTED)).evidence()
        told = "tells" if lost > calibration()["further"] else "does not tell"
        notes[step.key] = [
            f"Without slip in the model it gained up to {most:.0f} in ln evidence, beside slip it is worth {lost:.0f}: "
            f"the log {told} them apart, and slip does {max(0.0, 1 - lost / most):.0%} of what a delay would."
        ]
    return notes


def _plays(search: Search) -> list[Play]:
    """Gaps where the log has an encoder on the link side, loads as the fitted model has them."""
    z = search.system.plain(search.system.z)
    if search.aside is None:
        return plays(search.system, (), ())
    known = np.zeros(len(search.aside.parameters))
    known[: search.aside.lasting] = z[: search.aside.lasting]
    states = [search.aside.state(k, known) for k in range(len(search.aside.runs))]
    return plays(search.system, search.aside.runs, states)


def _finalists(search: Search, found: Sequence[Play]) -> tuple[dict[str, Any], ...]:
    """Fits to the torque, and gaps by what they take off the misfit of the encoders."""
    base = search.finalists[0]
    gaps = (
        {**base, "effect": effect_of("play").name, "site": p.site, "misfit": base["misfit"] - p.fall / base["data"],
         "own_parameters": 1}
        for p in found
    )  # fmt: skip
    return (*search.finalists, *gaps)


def _visible(found: Sequence[Play]) -> list[dict[str, Any]]:
    return [
        {"effect": effect_of("play").name, "site": play.site, "parameter": "gap", "value": play.visible, "unit": "rad"}
        for play in found
        if np.isfinite(play.visible)
    ]


def _answer(search: Search) -> tuple[Word, list[Missing], float, float]:
    """Verdict, what is missing, and the probabilities that nothing or something unnamed is."""
    first = search.first.decision
    _, other = search.other
    missing: list[Missing] = []
    settled = _inflated(search)
    for step in search.found:
        if not possible(search.system, step):  # a correction to a law beside it, and no effect of that name
            continue
        (found,) = missing_of(step.decision, step.base)
        if step.trial is not None:  # its numbers as they are with everything else in the model
            numbers = estimates_of(settled, search.system.own(step.trial.suspect))
            if name := step.effect.profiled:
                drop = 0.5 * NINETY**2 * _inflation(search)
                number = [p.quantity for p in step.trial.suspect.hypothesis.own].index(name)
                numbers[name]["interval90"] = list(profiled(search.system, step.trial.suspect, number, drop))
            if _may_be_none(step.trial.suspect, numbers):
                continue
            found = replace(found, first=replace(found.first, parameters=numbers))
        else:
            numbers = numbers_of_answer(search.system, settled, step.first.hypothesis)
            found = replace(found, first=replace(found.first, parameters=numbers))
        if step.effect.part == "law":
            found = _with_formula(found, step.first)
        missing += _with_coulomb(search, step, found, settled) if step.effect.memory else [found]
    missing = [_or_presliding(_or_slip(search, one, missing), settled) for one in missing]
    if search.law:
        _, _, fit = search.law
        (found,) = missing_of(Decision([fit], [other], 0.0, other), search.after)
        return "located", [*missing, _with_formula(found, fit)], 0.0, other
    if other > 0.5:
        return "unexplained", missing, 0.0, other
    if missing and (left := search.unexplained) > calibration()["mostly"]:
        return "unexplained", missing, 0.0, max(other, min(left, 0.99))
    if not missing and max(search.held_out_misfit, search.after.misfit) > calibration()["held_out_adequate"]:
        return "unexplained", [], 0.0, 1.0
    impossible = any(not possible(search.system, step) for step in search.found)
    if not missing and impossible:  # what predicts better has numbers that nothing of its name can have
        return "unexplained", [], 0.0, 1.0
    if not missing and word_of(first) not in ("adequate", "unexplained"):
        least = calibration()["least_other"]  # what was named first was taken back, and nothing lacks
        return "adequate", [], 1 - least, least
    if not missing:
        return word_of(first), [], first.none, first.other
    word: Word = "ambiguous" if any(m.rivals for m in missing) else "named"
    if any(effect_named(m.first.effect).part == "law" for m in missing):
        word = "located"
    return word, missing, first.none, max(first.other, other)


def _may_be_none(suspect: Suspect, numbers: dict[str, Any]) -> bool:
    """Whether the one size of something found may be none, what its data are missed by and the gain's doubt included.

    Friction that follows the load takes a part of a gain that is off, and is none of its own then.
    """
    if len(suspect.sizes) != 1:
        return False
    size = suspect.hypothesis.own[suspect.sizes[0]]
    name, _, index = size.quantity.partition("[")
    if size.log or name not in numbers:
        return False
    ends = numbers[name]["interval90"]
    low, high = ends[int(index[:-1])] if index else ends
    return bool(low <= size.mean <= high)


def _with_coulomb(search: Search, step: Step, slip: Missing, settled: Fitted) -> list[Missing]:
    """Slip found where no dry friction is described, and by its own name what of it turns round at once.

    That is Coulomb friction, which holds what it has at rest. Both together are the torque that is written as slip.
    """
    system, (joint,) = search.system, step.joints
    name = effect_of("dry").name
    key = f"{name}@joint{joint + 1}"
    described = any(f"{e.effect}@{e.site}" == key for e in system.base.regressor.robot.physics)
    dry = [s for s in search.found if s.key == key]
    if described or any(possible(system, s) for s in dry) or step.trial is None:
        return [slip]
    suspect = step.trial.suspect
    once, own = at_once(system, suspect), system.own(suspect)
    width = len(suspect.effect.elements)
    count = len(own) // width
    if len(once) == count and not dry:  # the longest stays what it is: all of the torque is told of one of both
        travel = np.divide(*(slip.first.parameters[name]["value"] for name in ("yield_torque", "stiffness")))
        once.remove(int(np.argmax(travel)))
    if not once:
        return [slip]
    at = [own[width * k] for k in once] + [k for s in dry if s.trial for k in system.own(s.trial.suspect)]
    deviations = np.array([settled.parameters[k].deviation for k in at])
    covariance = np.linalg.inv(settled.information)[np.ix_(at, at)]
    torque, spread = float(settled.values[at].sum()), float(np.sqrt(deviations @ covariance @ deviations))
    if torque <= 0:  # at rest only
        return [slip]
    if len(once) == count:  # all of slip that shows is that it holds more at rest than is left of it in motion
        once = []
    unit, dry_name = slip.first.parameters["yield_torque"]["unit"], effect_of("dry").parameters[0].name
    number = {"value": torque, "unit": unit, "interval90": [torque - NINETY * spread, torque + NINETY * spread]}
    left = [k for k in range(count) if k not in once]
    parameters = {
        name: {**item, "value": [item["value"][k] for k in left], "interval90": [item["interval90"][k] for k in left]}
        for name, item in slip.first.parameters.items()
    }
    coulomb = replace(slip.first, effect=name, site=f"joint{joint + 1}", parameters={dry_name: number})
    rest = replace(slip, first=replace(slip.first, parameters=parameters))
    return [Missing(coulomb, slip.probability, (), ""), rest]


def _or_slip(search: Search, found: Missing, missing: Sequence[Missing]) -> Missing:
    """Low-speed friction of which the log shows only what it adds at rest, beside slip that was found at its joint.

    Both hold more torque at rest than friction is in motion. How low-speed friction falls with speed lies between two
    samples. Neither law is exact, so the better fit of one does not tell which of them it is.
    """
    memory = [m for m in missing if effect_named(m.first.effect).memory]
    slips = [m for m in memory if m.first.site.partition(".")[0] == found.first.site]
    if found.first.key not in (step.key for step in _at_rest(search)) or not slips:
        return found
    slip = slips[0].first
    others = tuple((c, p) for c, p in found.alternatives if c.key != slip.key)
    half = 0.5 * (found.probability + sum(p for c, p in found.alternatives if c.key == slip.key))
    return replace(found, probability=half, alternatives=((slip, half), *others))


def _or_presliding(found: Missing, settled: Fitted) -> Missing:
    """Slip whose torque is a part of the dry friction that is described, beside presliding of another travel.

    Both are slip elements. Slip that is missing adds its torque to friction. If the sum of both is nearer to what is
    described than friction without slip, friction may only turn round over another travel here than at other joints.
    """
    effect, joint = effect_named(found.first.effect), found.first.site.partition(".")[0]
    dry, names = effect_of("dry"), settled.parameters.names
    level = f"{dry.name}@{joint}.{dry.parameters[0].name}"
    if not effect.memory or level not in names:
        return found
    described, fitted_level = (settled.parameters[names.index(level)].mean, settled.values[names.index(level)])
    whole = fitted_level + sum(found.first.parameters["yield_torque"]["value"])
    if abs(whole - described) >= abs(fitted_level - described):
        return found
    half = 0.5 * found.probability
    presliding = replace(found.first, effect=effect_of("slip").name, site=joint)
    return replace(found, probability=half, alternatives=((presliding, half), *found.alternatives))


def _at_rest(search: Search) -> list[Step]:
    """Low-speed friction that was found and shows at rest only."""
    low = (s for s in search.found if s.effect.fades_over and s.trial is not None)
    return [s for s in low if s.trial and seen_at_rest_only(search.system, s.trial.suspect)]


def _fading() -> str:
    """Name of the friction that is largest at rest and fades with speed."""
    return next(name for name, effect in CATALOGUE.items() if effect.fades_over)


def _with_formula(found: Missing, fit: Fitted) -> Missing:
    """What was found, a law without a name, with its formula."""
    (entry,) = fit.hypothesis.entries
    return replace(found, first=replace(found.first, formula=entry.values["formula"]))


def _inflated(search: Search) -> Fitted:
    """The fit with its data's variance multiplied by what they are missed by; priors stay as wide.

    That is Birge's ratio where the misfit is like the noise. What a model lacks lasts longer: the density of the
    whitened residual at low frequency (Newey, West, Econometrica 55, 1987) says how much less such rows tell.
    The gain of each joint's torque is in doubt beside: a mass is known no better than what it is weighed by.
    """
    scale, system = _inflation(search), search.system
    fit = base_fit(system)
    eye = np.eye(len(fit.z))
    information = (fit.information - eye) / scale + eye
    tolerance = system.base.regressor.robot.tolerances.torque_gain
    for joint in range(len(system.whitening) * bool(tolerance)):
        rows = tolerance * system.whitened(joint, [state.torque[:, joint] for state in system.state])
        across = system.A.across((joint,), rows)[0] / scale
        information = information - np.outer(across, across) / (1 + float(np.sum(rows**2)) / scale)
    return replace(fit, information=information, misfit=min(fit.misfit, 1.0))


def _inflation(search: Search, lasting: int = 2) -> float:
    """Factor on the data's variance; a misfit is like itself over ``lasting`` times the order of the autoregression.

    Of a short log a fit takes up much of what it misses. The runs kept aside show how much that is.
    """
    system, density = search.system, []
    for joint in range(len(system.whitening)):
        e = system.residual[system.rows(joint)]
        lags = np.arange(1, min(lasting * system.order, len(e) // 4))
        correlation = np.array([e[k:] @ e[:-k] for k in lags]) / len(e)
        density.append(e @ e / len(e) + 2 * float((1 - lags / (lags[-1] + 1)) @ correlation))
    return max(1.0, base_fit(system).misfit, float(np.mean(density)), search.held_out_misfit)


def log_records(prepared: Prepared, base: Fitted, search: Search) -> tuple[list[LogRecord], dict[str, Any]]:
    """Every run beside the three models, and the errors of a diagnosis; offsets of held-out runs are re-estimated."""
    first, last = search.plain, search.system
    noise = first.noise
    units = tuple("N·m" if axis.type == "revolute" else "N" for axis in prepared.regressor.robot.axes)
    after, entries = _after(search)
    stages: tuple[tuple[Stage, FloatArray, Sequence[Entry]], ...] = (
        ("as_given", np.zeros(len(first.base.parameters)), ()),
        ("before", base.z, first.entries(base.z)),
        ("after", last.plain(after.z), entries),
    )
    records = []
    for held, columns, runs in ((False, first.base, prepared.used), (True, search.aside, prepared.kept)):
        if columns is None:
            continue
        for k, run in enumerate(runs):
            settled = run.valid & _settled(run)
            predicted = {stage: predicted_torque(columns, k, z, found, settled) for stage, z, found in stages}
            records.append(
                LogRecord(
                    run.name, held, run.time, run.motion.position, run.motion.velocity, run.torque, settled,
                    predicted, noise, units,
                )
            )  # fmt: skip
    errors: dict[str, Any] = {}
    for stage in STAGES:
        errors[stage] = pooled(records, stage)
    judged = [r for r in records if r.held_out] or records  # the floor is what the error on runs not used is held to
    errors["noise_floor"] = pooled_floor(judged)
    return records, errors


def _after(search: Search) -> tuple[Fitted, list[Entry]]:
    """The fit with everything that was found, and what that is as entries."""
    after = search.law[2] if search.law else search.after
    return after, [*search.system.entries(after.z), *with_values(after.hypothesis, after.values[after.own])]


def _bodies(prepared: Prepared, search: Search, errors: dict[str, Any], worse: float = 1.05) -> list[str]:
    """What it costs that links must be bodies that can exist: a log holds combinations of their inertias alone.

    Up to ``worse`` times the error of the fit it may cost without a word.
    """
    last, (after, entries) = search.system, _after(search)
    z = that_can_exist(last, after.z)
    if z is after.z:
        return []
    rest, whole = 0.0, 0.0
    for k, run in enumerate(prepared.used):
        settled = run.valid & _settled(run)
        torque = run.torque[settled]
        missed = torque - predicted_torque(search.plain.base, k, last.plain(z), entries, settled)[settled]
        rest, whole = rest + np.sum(missed**2, axis=0), whole + np.sum(torque**2, axis=0)
    error = float(np.sqrt(np.mean(rest / np.maximum(whole, 1e-300))))
    if error < worse * errors["after"]["train"]:
        return []
    return [
        "the fitted combinations of inertias are not physically possible. robot.yaml has the nearest possible bodies. "
        f"With them the error on the data used is {error:.1%}, not {errors['after']['train']:.1%}. Something like "
        "weight or inertia may be missing from the description"
    ]


def wider_bands(prepared: Prepared, log: MotionLog) -> list[Bands]:
    """Low-passes that a short log may be fitted through as well.

    A few seconds below 10 Hz have fewer rows than a robot has numbers. A wider band has more, if the robot is rigid in
    it and its accelerations are less noisy than its torque; of a longer log it would only have more noise.
    """
    if not prepared.kept or sum(float(run.time[-1] - run.time[0]) for run in log.runs.values()) >= SHORT_S:
        return []
    rate = min(run.sample_rate_hz for run in log.runs.values())
    stops = [times * prepared.bands.fit[1] for times in TIMES_WIDER]
    return [Bands((0.8 * stop, stop), (1.2 * stop, 1.5 * stop)) for stop in stops if 1.5 * stop < 0.4 * rate]


def predicted_torque(base: Base, k: int, z: FloatArray, entries: Sequence[Entry], valid: np.ndarray) -> FloatArray:
    """Torque (m, n) of run k, its offsets estimated under their prior."""
    run = base.runs[k]
    known = np.zeros(len(base.parameters))
    known[: base.lasting] = z[: base.lasting]
    state = base.state(k, known)
    model_torque(run, state, entries)
    predicted = state.recorded(run)
    rest = (run.torque - predicted)[valid]
    weight = (base.offset[:, k] ** 2).sum(axis=1) * len(rest)
    level = np.var(rest, axis=0)
    return np.asarray(predicted + rest.mean(axis=0) * weight / (weight + level))


def _settled(run: Run, about_s: float = 0.15) -> np.ndarray:
    """Rows (m,) at which no axis is about to stop or start: there an encoder cannot tell creeping from standing."""
    out = np.ones(len(run.time), bool)
    for joint in range(run.torque.shape[1]):
        for sample in stops_of(run, joint):
            out &= np.abs(run.time - run.dense.time[min(sample, len(run.dense.time) - 1)]) > about_s
    return out


def _still_off(records: Sequence[LogRecord]) -> list[str]:
    """Joints whose torque the model misses in the end by clearly more than its noise, and by how much."""
    judged = [r for r in records if r.held_out] or list(records)
    rest = np.concatenate([(r.measured - r.predicted["after"])[r.valid] for r in judged])
    torque = np.concatenate([r.measured[r.valid] for r in judged])
    size = np.sqrt(np.maximum(np.mean(torque**2, axis=0), 1e-300))
    error, floor = np.sqrt(np.mean(rest**2, axis=0)) / size, judged[0].noise / size
    far = np.flatnonzero(error > np.sqrt(calibration()["held_out_adequate"]) * floor)
    if not far.size:
        return []
    told = ", ".join(f"joint{j + 1} by {error[j]:.1%} (noise {floor[j]:.1%})" for j in far)
    return [f"the torque that the model still misses: {told}"]


def pooled(records: Sequence[LogRecord], stage: Stage) -> dict[str, float | None]:
    """Error at a stage, on runs used and on those that were not: RMS over joints of residual RMS over torque RMS."""
    found: dict[str, float | None] = {"train": None, "held_out": None}
    for part, held in (("train", False), ("held_out", True)):
        if of := [r for r in records if r.held_out is held]:
            rest = np.concatenate([(r.measured - r.predicted[stage])[r.valid] for r in of])
            torque = np.concatenate([r.measured[r.valid] for r in of])
            ratio = np.mean(rest**2, axis=0) / np.maximum(np.mean(torque**2, axis=0), 1e-300)
            found[part] = float(np.sqrt(np.mean(ratio)))
    return found


def predicted_by(
    robot: Robot, log: MotionLog, finding: Finding, hold_out: list[str] | None, stage: Stage = "after"
) -> list[LogRecord]:
    """A log's records with the torque of a description as it is at a stage, beside what its fit held for ordinary.

    Ordinary ripple, the travel over which friction turns round, gear ratios and the gain of the record are as the log
    has them beside the description's links and axes. What was found of the recording acts on the torque, which is
    compared as it was recorded. Offsets are re-estimated.
    """
    new = [e for e in finding.robot.physics if e not in finding.given.physics]
    found_there = {
        (e.effect, e.site) for e in new if CATALOGUE[e.effect].records_torque
    }  # the numbers may have moved since
    recording = [e for e in robot.physics if (e.effect, e.site) in found_there]
    robot = robot.model_copy(update={"physics": [e for e in robot.physics if e not in recording]})
    hold_out = [name for name in hold_out or [] if name in log.runs] or None
    prepared = prepare(log, _geared(_smooth(robot, finding), finding.given), finding.recording, hold_out, finding.bands)
    own_fit = finding.bare if stage == "before" else finding.following
    fitted, found = own_fit.values(robot) if own_fit else {}, []
    records = {(r.name, r.held_out): r for r in finding.records if isinstance(r, LogRecord)}
    for held, runs in ((False, prepared.used), (True, prepared.kept)):
        if not runs:
            continue
        regressor = (
            own_fit.system.base.regressor if own_fit else prepared.regressor
        )  # a gain is of the described torque
        numbers = numbers_of(regressor.robot)
        base = base_of(prepared.regressor, runs, changes=[number_columns(regressor, run, numbers) for run in runs])
        own = [p.name.startswith("ordinary_") or p.name == GAIN or p.quantity == "gear_ratio" for p in base.parameters]
        off = [fitted.get(p.name, p.mean) - p.mean for p in base.parameters]
        z = np.where(own, off, 0.0) / [p.deviation for p in base.parameters]
        for k, run in enumerate(runs):
            record = records[run.name, held]
            torque = predicted_torque(base, k, z, recording, record.valid)
            found.append(replace(record, predicted={**record.predicted, stage: torque}))
    return found


def _geared(robot: Robot, given: Robot) -> Robot:
    """A description with the ratios that a log was recorded by: angles and torques of motors went through them."""
    drives = [
        drive.model_copy(update={"gear_ratio": told.gear_ratio})
        for drive, told in zip(robot.drives, given.drives, strict=True)
    ]
    return robot.model_copy(update={"drives": drives})


def _smooth(robot: Robot, finding: Finding) -> Robot:
    """A description whose dry friction turns round by the smooth law of fits, not by the elements it is written in."""
    slip, dry = effect_of("slip").name, effect_of("dry")
    there = {(e.effect, e.site) for e in finding.robot.physics}
    written = [e for e in robot.physics if e.effect == slip and (e.effect, e.site) not in there]
    given_up = {e.site: float(np.sum(e.values["yield_torque"])) for e in written}
    level, physics = dry.parameters[0].name, []
    for entry in robot.physics:
        if entry.effect == dry.name and entry.site in given_up:
            whole = {level: entry.values[level] + given_up[entry.site]}
            entry = Entry.model_validate({"effect": dry.name, "site": entry.site, **whole})
        if entry not in written:
            physics.append(entry)
    return robot.model_copy(update={"physics": physics})


@dataclass
class Log:
    """A motion log as evidence."""

    recording: Recording

    @property
    def names(self) -> tuple[str, ...]:
        """Runs."""
        return self.recording.names

    def explain(self, given: Robot, told_by: Finding | None, **options: Any) -> Finding:
        """See :class:`twin.diagnose.evidence.Evidence`."""
        log, notes = sound(self.recording.content, given)
        in_joints(log, given)  # axes, units and limits fit
        self.recording = replace(self.recording, content=log)
        finding = diagnose_log(log, told_by.robot if told_by else given, self.recording.source, **options)
        finding.warnings = [*notes, *finding.warnings]
        return finding

    def again(self, finding: Finding, robot: Robot, last: Finding, hold_out: list[str] | None) -> None:
        """What the log said, with the errors of the model that all end with, and what the last recording adds to it."""
        finding.records = predicted_by(robot, finding.content, finding, hold_out)
        if finding.bare and finding.missing and not any(shared(m.first.effect) for m in finding.missing):
            # the links that all recordings agree on, in both models: they cost the log more than a name may gain
            bare, finding.alone = finding.bare(last.robot), finding.error["after"]
            finding.records = predicted_by(bare, finding.content, finding, hold_out, "before")
        finding.error = {**finding.error, **{stage: pooled(finding.records, stage) for stage in ("before", "after")}}
        finding.missing = [followed(m, finding.model, robot) for m in finding.missing]
        finding.missing = [_seen_by(last, m) for m in with_evidence(finding)]

    def checks(self, written: Robot, finding: Finding, alone: bool) -> list[dict[str, Any]]:
        """A run under servos against its inverse dynamics."""
        name = next((name for name in self.names if name in finding.held_out), self.names[0])
        return [check_replayed(written, self.recording.content.runs[name], self.recording.source)]


def _seen_by(finding: Finding, missing: Missing) -> Missing:
    """Another recording's answer with a second sentence of evidence, of a hammer test that shows it too."""
    if not any(isinstance(r, FrfRecord) for r in finding.records) or not shared(missing.first.effect):
        return missing
    text = sentence(missing.first.phrase, finding.records, finding.error, finding.held_out)
    return replace(missing, evidence=f"{missing.evidence} In {Path(finding.recording).name}: {text}")
