"""What force levels that disagree say, as a finding: the law at its joint, errors with blows stepped, MuJoCo's word."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from twin.diagnose.decide import finalists
from twin.diagnose.evidence import sentence
from twin.diagnose.joint_laws import LAWS, Law, Slip
from twin.diagnose.joint_reaction import Blow, Stepped, blows, minimise
from twin.diagnose.levels import Levels, decide_levels, explain_levels
from twin.diagnose.levels_next import next_blows, smallest_visible_laws
from twin.diagnose.objective import Sample
from twin.diagnose.physical import physical
from twin.diagnose.records import FrfRecord, frf_records
from twin.diagnose.refit import Fitted, noise_floor
from twin.diagnose.search import Search
from twin.diagnose.triage import Triage
from twin.diagnose.verdict import Finding, judge, missing_of, rival_of
from twin.identify.elastic import Recorded, without_limits
from twin.identify.elastic_compare import recording_set, relative_error
from twin.identify.parameters import independent
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import Campaign, ComplexArray, FloatArray
from twin.model.expansion import with_channels
from twin.model.hammer import HammerTest, simulate_hits
from twin.robot.description import Axis, Robot
from twin.robot.mechanism import assemble

JUDGED_LINES, AGAIN = 25, 6  # lines and iterations of what belongs to held-out recordings themselves
STEPPED = 0.1  # relative difference allowed between MuJoCo's blows and the search's


def levels_finding(
    campaign: Campaign,
    given: Robot,
    base: Robot,
    source: str,
    found: Triage,
    search: Search,
    progress: Callable[[int], None] | None = None,
) -> Finding | None:
    """The finding of a campaign whose force levels disagree.

    Args:
        campaign: as recorded.
        given: the description as it came; ``base`` the one that was fitted, without limits.
        source: the file.
        found: its triage.
        search: the base model, converged.
        progress: called with 1 after every fit.

    Returns:
        ``None`` where no law is better than none: the other hypotheses then have the word.
    """
    sample = Sample(tuple(found.used), 1 / found.shared)
    levels = explain_levels(campaign, base, search.base, sample, search.robust, progress)
    if levels is None:
        return None
    decision = decide_levels(levels)
    word = judge(decision)
    if word == "adequate":
        return None
    answered = word in ("named", "ambiguous")
    best = decision.ranked[0] if answered else search.base
    how = blows(campaign) or {}
    records, errors = frf_records(without_limits(given), search.base, search.base, found.used, found.kept)
    if answered:
        records, errors["after"] = _stepped_records(records, levels, best, found.used, found.kept, how)
    errors["noise_floor"] = noise_floor(sample.recordings)
    sites = {place.site: levels.places[-1].cost - place.cost for place in levels.places}
    missing = missing_of(decision, levels.base) if answered else []
    finding = Finding(
        source, "frf-campaign", word, missing, decision.none, decision.other, given,
        _limited(search.base.robot, given), _limited(best.robot, given), errors, list(found.held_out), records,
        _location(source, records, levels.places[0].site), sites,
        smallest_visible_laws(base, search.base, sample, how), warnings=found.warnings,
        finalists=finalists(levels.base, levels.fits),
    )  # fmt: skip
    finding.missing = [
        replace(
            item, first=replace(item.first, parameters=_as_entered(item.first.parameters, levels, best)),
            evidence=f"{levels_sentence(levels)} "
            + sentence(item.first.title, records, errors, finding.held_out),
        )
        for item in missing
    ]  # fmt: skip
    if word == "ambiguous":
        finding.next_test = next_blows(given, levels, best, rival_of(decision), sample, how)
    return finding


def levels_sentence(levels: Levels) -> str:
    """How the joint's stiffness and loss change from the lightest to the hardest blows: what a person can check."""
    best = levels.places[0]
    k = np.concatenate([u[0] for u in best.own])
    sure = np.concatenate([matrix[0, 0] for matrix in best.certainty])
    loud = sure > np.quantile(sure, 0.5)
    spread = float(np.ptp(np.quantile(k[loud], [0.05, 0.95])))
    joint = levels.base.values[levels.base.parameters.names.index(f"{best.site}.stiffness")]
    others = ", ".join(f"{place.site} {place.cost / best.cost:.1f} times" for place in levels.places[1:])
    return (
        f"Seen as a linear spring, {best.site} changes its stiffness by {spread / joint:.1%} from blow to blow; "
        f"left free at another joint instead, that leaves more unexplained ({others})."
    )


def _as_entered(parameters: dict[str, Any], levels: Levels, fit: Fitted) -> dict[str, Any]:
    """The law's own numbers for blows as long as these were, their uncertainty included, and not the blows'; slip's
    yield torques beside its stiffnesses, to which they are in proportion."""
    objective = levels.objectives[levels.fits.index(fit)]
    entry: dict[str, Any] = objective.law.entry(*objective.own(fit.z))
    if "yield_torque" in entry:
        item = parameters["stiffness"]
        ratio = np.divide(entry["yield_torque"], entry["stiffness"])
        yields = [[end * r for end in pair] for pair, r in zip(item["interval90"], ratio, strict=True)]
        return {
            "stiffness": item,
            "yield_torque": {"value": entry["yield_torque"], "unit": "N·m", "interval90": yields},
        }
    (name, value), *_ = entry.items()
    if "pulse" not in parameters:
        return parameters
    # logarithms add up: of the size at usual blows and, by its power, of the blows' length
    covariance = np.linalg.inv(fit.information)[np.ix_(fit.own, fit.own)] * max(1.0, fit.misfit)
    weight = np.array([1.0, objective.law.power]) * [fit.parameters[k].deviation for k in fit.own]
    spread = NINETY * float(np.sqrt(weight @ covariance @ weight))
    ends = [value * float(np.exp(side * spread)) for side in (-1, 1)]
    return {name: {**parameters[name], "value": value, "interval90": ends}}


def _limited(robot: Robot, given: Robot) -> Robot:
    robot = physical(robot)
    axes: list[Axis] = [a.model_copy(update={"limits": b.limits}) for a, b in zip(robot.axes, given.axes, strict=True)]
    return robot.model_copy(update={"axes": axes})


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


def law_of(robot: Robot) -> tuple[Law, FloatArray, Robot]:
    """The law of a robot's last entry, its sizes, and the robot without it."""
    *physics, entry = robot.physics
    values = entry.model_extra or {}
    robot = robot.model_copy(update={"physics": physics})
    if entry.effect == "hysteresis":
        sizes = np.array(values["stiffness"])
        return Slip(tuple(np.array(values["yield_torque"]) / sizes)), sizes, robot
    law = next(law for law in LAWS if law.effect == entry.effect)
    return law, np.array([values[law.names[0]]]), robot


def _stepped_records(
    records: Sequence[FrfRecord],
    levels: Levels,
    fit: Fitted,
    used: Sequence[Recorded],
    kept: Sequence[Recorded],
    blow: dict[str, Blow],
) -> tuple[list[FrfRecord], dict[str, float | None]]:
    """Records with the law's prediction as ``after``, and its errors; on held-out recordings posture angles and gains
    are estimated again, nothing else."""
    law, sizes, robot = law_of(fit.robot)
    site = fit.hypothesis.site
    objective = levels.objectives[levels.fits.index(fit)]
    own = objective.base
    longer = objective.own(fit.z)[1]
    blow = {group: replace(b, pulse_s=b.pulse_s * longer) for group, b in blow.items()}
    belongs = [k for k, p in enumerate(own) if p.kind in ("posture", "sag", "gain")]
    predicted = Stepped(
        robot, independent([own[k] for k in belongs]), Sample(tuple(used)), law=law, site=site, blow=blow, fixed=sizes
    ).predicted(np.array([fit.z[k] for k in belongs]))
    error: dict[str, float | None] = {"train": relative_error(used, predicted), "held_out": None}
    if kept:
        free = recording_set(robot, kept)
        judged = Stepped(robot, free, Sample(tuple(kept)), law=law, site=site, blow=blow, fixed=sizes)
        z = np.zeros(len(free))
        few = Sample(tuple(kept)).thin(JUDGED_LINES)
        for temper in (0.1, 0.02, 0.0):
            z, *_ = minimise(replace(judged, sample=few, temper=temper), z, AGAIN)
        rest = judged.predicted(z)
        error["held_out"] = relative_error(kept, rest)
        predicted = [*predicted, *rest]
    shown = [replace(r, predicted={**r.predicted, "after": H}) for r, H in zip(records, predicted, strict=True)]
    return shown, error


# --- MuJoCo -----------------------------------------------------------------------------------------------------------


def check_blows(robot: Robot, campaign: Campaign, recordings: dict[str, Recorded]) -> dict[str, Any] | None:
    """The written model hit in MuJoCo's time at two force levels, against the search's stepping and the recording.

    The blow whose FRFs differ most from level to level is taken, angles as recorded.

    Returns:
        A check: the larger relative difference of FRFs (nf, nr) from the search's, the change from level to level in
        MuJoCo and as recorded; ``None`` where no posture has two levels.
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
        return np.asarray(np.linalg.norm(b - a, axis=(0, 1)) / np.linalg.norm(a, axis=(0, 1)))

    low, high = max(pairs, key=lambda pair: float(np.median(change(pair[0].frf, pair[1].frf))))
    column = int(np.argmax(change(low.frf, high.frf)))
    law, sizes, plain = law_of(robot)
    site = robot.physics[-1].site
    none = independent([])
    expected = Stepped(
        without_limits(plain), none, Sample((low, high)), law=law, site=site, blow=blow, fixed=sizes
    ).predicted(np.zeros(0))
    stepped = [_in_mujoco(robot, r, column, blow[r.group]) for r in (low, high)]
    off = max(
        float(np.linalg.norm(H - e[:, :, column]) / np.linalg.norm(e[:, :, column]))
        for H, e in zip(stepped, expected, strict=True)
    )
    change_there = [
        float(np.linalg.norm(b - a) / np.linalg.norm(a))
        for a, b in (stepped, (low.frf[:, :, column], high.frf[:, :, column]))
    ]
    label = low.setup.excitation.label[column]
    return {
        "name": "time stepping", "value": off, "limit": STEPPED, "passed": off < STEPPED,
        "description": f"blows of {blow[low.group].peak_n:g} N and {blow[high.group].peak_n:g} N on {label} in "
        f"'{low.setup.name}', stepped in time by MuJoCo, give the FRFs of the search within {off:.1%} "
        f"(limit {STEPPED:.0%}); from one to the other they change by {change_there[0]:.1%}, as recorded by "
        f"{change_there[1]:.1%}",
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
