"""What a modal table says beyond the base model: a few frequencies and damping ratios, and so rarely much.

Every mechanical entry that the description lacks is fitted beside everything the base model has free, and to the best
of them a second and a third. A table states no more than a handful of numbers, mostly without their uncertainty. A
model with that many free numbers can always be made to agree with them, so agreement is no evidence. What is named must
predict postures that it was not fitted to; each is left out in turn. Its error there must be half that of the model
without it, and in no posture more than 10 % larger. Otherwise the table cannot tell, and the finding says so.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.diagnose.decide import Decision, decide
from twin.diagnose.described import described
from twin.diagnose.hypotheses import Hypothesis, companions, entry_hypothesis, sites, together
from twin.diagnose.next_test import WEIGH
from twin.diagnose.note import Note
from twin.diagnose.patience import Patience
from twin.diagnose.records import STAGES, ModalRecord, Stage
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.rigid_axes import rigid_axes
from twin.diagnose.search import FURTHER, WORTH, most_noise
from twin.diagnose.sentences import sentence
from twin.diagnose.verdict import Finding, judge, missing_of, parts
from twin.errors import InputError
from twin.identify.descent import LACKING
from twin.identify.elastic_modal import (
    ModalPosture,
    fit_modes,
    frequency_error,
    modal_postures,
    predict_modes,
)
from twin.measure.campaign import Channels, FloatArray
from twin.measure.modal_table import ModalTable
from twin.measure.recordings import Recording
from twin.model.parameters import Parameters, free_parameters, require_springs
from twin.model.recorded import without_limits
from twin.parallel import spread
from twin.physics import CATALOGUE
from twin.robot.description import Robot
from twin.robot.physical import as_written

STARTS = 4  # of the base model
COARSE_SCATTER = 10.0  # times the deviations: of every entry first, with the links as described
REFITTED_ENTRIES = 12  # the most evident, which are fitted with everything free
CONTENDERS = 4  # most evident hypotheses of a round that are judged by leaving postures out
ENTRIES_AT_ONCE = 3  # entries at once
WIDER_INERTIA = 10.0  # times its tolerances: the inertia of a link that is not as described
BETTER = 0.5  # of the error on postures left out, set by eye: many an entry brings it to 0.7
WORSE = 1.1  # of the error on any one posture left out
HOPELESS = 1e6  # ln evidence taken off one that does not predict
NAMELESS_LEFT, DOUBTED = 0.05, 0.3  # probability of something else beside a name; where the table gives no deviations
UNSTATED = 3.0  # times the usual deviations: what the scatter of a table without deviations may be


@dataclass(frozen=True)
class LeftOut:
    """A hypothesis with every posture left out in turn: RMS relative frequency error there, by posture and pooled."""

    by_posture: dict[str, float]
    pooled: float


@dataclass
class Table:
    """A modal table as evidence."""

    recording: Recording

    @property
    def names(self) -> tuple[str, ...]:
        """Postures."""
        return self.recording.names

    def explain(self, given: Robot, told_by: Finding | None, *, processes: int, **options: Any) -> Finding:
        """See :class:`twin.diagnose.evidence.Evidence`."""
        start = told_by.model if told_by else given
        return diagnose_table(self.recording.content, start, self.recording.source, processes=processes, **options)

    def again(self, finding: Finding, robot: Robot, last: Finding, hold_out: list[str] | None) -> None:
        """Nothing: what comes after it starts from its model."""

    def checks(self, written: Robot, finding: Finding, alone: bool) -> list[dict[str, Any]]:
        """Nothing beside what every written model is checked for."""
        return []


def diagnose_table(
    table: ModalTable,
    given: Robot,
    source: str = "table",
    *,
    hold_out: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str, int], Callable[[int], None]] | None = None,
    patience: Patience | None = None,
    processes: int = 1,
) -> Finding:
    """What a modal table says.

    Args:
        table: frequencies and, where known, damping ratios by posture.
        given: the description, removals applied.
        source: the file, for messages.
        hold_out: postures not to use; without any, each is left out in turn and the finding's errors are of all.
        seed: of the starts.
        progress: makes progress bars.
        patience: how long to look for more; for ever by default.
        processes: the work is spread over so many; what it finds does not depend on it.

    Raises:
        InputError: the robot has no springs, the table no modes, or nothing is left to fit to.
    """
    base = without_limits(given)
    free = free_parameters(base).only("spring", "entry", "link")
    require_springs(given)
    postures = {name: p for name, p in modal_postures(table, given, source).items() if len(p.frequency_hz)}
    kept = {name: p for name, p in postures.items() if name in (hold_out or ())}
    used = {name: p for name, p in postures.items() if name not in kept}
    if not used:
        raise InputError(source, "postures", "no posture with modes is left to fit to")
    springs = [h for h in described(free) if h.site.endswith("stiffness") and "*" not in h.site]
    rigid = [one for variants in rigid_axes(base) for one in variants]
    looked_at = [*mechanical_suspects(base), *rigid, *springs, *heavier(free)]
    tick = progress("modal table", len(looked_at)) if progress else (lambda count: None)
    ask = Fits(base, free, used, seed, processes)
    before = fitted(base, NONE, free, used, seed)
    [plain] = left_out(ask, [before])
    patience = patience or Patience()
    rounds = search(ask, before, plain, looked_at, tick, patience)
    fits, crossed = [fit for fit, _ in rounds], {fit.hypothesis.key: out for fit, out in rounds if out}
    decision = decide_table(
        rounds, before, plain, looked_at, base, free, [p.setup.q for p in used.values()], states_scatter(table)
    )
    word = judge(decision)
    if word == "unexplained" and sum(decision.probability) > decision.other:
        word = "ambiguous"  # aliases share what one name would have
    if decision.ranked and FURTHER in patience.left and states_scatter(table):
        best = decision.ranked[0]
        word = "unexplained" if best.misfit > most_noise(best) else word
    answered = word in ("named", "ambiguous")
    best = decision.ranked[0] if answered else before
    robots = {"as_given": given, "before": as_written(before.robot, given), "after": as_written(best.robot, given)}
    records = _records({**used, **kept}, list(kept), robots)  # type: ignore[arg-type]
    rest = {"before": plain, "after": crossed.get(best.hypothesis.key, plain) if answered else plain}
    error: dict[str, object] = {}
    for stage in STAGES:
        turned = rest[stage].pooled if stage in rest and plain.by_posture else None
        held = _error(robots[stage], kept) if kept else turned
        error[stage] = {"train": _error(robots[stage], used), "held_out": held}
    stated = [p.frequency_spread for p in used.values()] if states_scatter(table) else []
    error["noise_floor"] = float(np.sqrt(np.mean(np.concatenate(stated) ** 2))) if stated else None
    missing = missing_of(decision, before) if answered else []
    finding = Finding(
        source, "modal-table", word, missing, decision.none, decision.other, given, robots["before"], robots["after"],
        error, list(kept) or (["each posture in turn"] if plain.by_posture else []), records,
        warnings=[*patience.notes(), *told(fits, before, used, plain, crossed, word)],
    )  # fmt: skip
    if word == "ambiguous":
        finding.next_test = next_test(finding)
    finding.missing = [replace(m, evidence=sentence(m.first.phrase, records, error, finding.held_out)) for m in missing]
    return finding


def mechanical_suspects(base: Robot) -> list[Hypothesis]:
    """Entries that move modes and that the description does not have. What adds a mode is not among them: a table that
    lacks a mode does not say that there is none."""
    present = {(entry.effect, entry.site) for entry in base.physics}
    none = Channels((), (), np.zeros((0, 3)), np.zeros((0, 3)))
    found = []
    for name, effect in CATALOGUE.items():
        of_channels = any("LABEL" in s or "NODE" in s for s in effect.sites)
        if "hammer" not in effect.seen_in or of_channels or effect.adds_mode:
            continue
        for site in sites(name, base.axis_count, none, none):
            values = effect.typical(base, site)
            if values and ((name, site) not in present or effect.repeatable):
                found.append(entry_hypothesis(base, name, site, values))
    return found


def fitted(
    base: Robot,
    hypothesis: Hypothesis,
    free: Parameters,
    postures: Mapping[str, ModalPosture],
    seed: int,
    starts: int = STARTS,
    near: Fitted | None = None,
    hopeless: float = np.inf,
) -> Fitted:
    """A hypothesis at its optimum on a table; the first start is where ``near`` is in the parameters they share.

    What cannot be expected to get below the cost ``hopeless`` is given up on the way.
    """
    robot, parameters = hypothesis.robot(base), hypothesis.parameters(free)
    guess = None
    if near is not None:
        known = dict(zip(near.parameters.names, near.values, strict=True))
        values = zip(parameters.names, parameters.values(np.zeros(len(parameters))), strict=True)
        guess = parameters.coordinates(np.array([known.get(name, value) for name, value in values]))
    fit = fit_modes(
        robot, list(postures.values()), parameters, starts=starts, seed=seed, guess=guess, hopeless=hopeless
    )
    return Fitted(
        hypothesis, parameters, fit.z, fit.values, fit.robot, fit.cost, fit.misfit, fit.fisher + np.eye(len(fit.z)),
        fit.data, fit.converged,
    )  # fmt: skip


@dataclass(frozen=True)
class Fits:
    """What every fit of a search shares: the description, what is free in it, postures, seed and processes."""

    base: Robot
    free: Parameters
    postures: Mapping[str, ModalPosture]
    seed: int
    processes: int

    def nearest(self, hypothesis: Hypothesis, near: Fitted, postures: Mapping[str, ModalPosture]) -> Fitted:
        """The better of two fits of everything: from an earlier fit, and from the description."""
        starts = near, None
        ends = [fitted(self.base, hypothesis, self.free, postures, self.seed, starts=1, near=start) for start in starts]
        return min(ends, key=lambda end: end.cost)

    def beside(self, chosen: Fitted, hypotheses: Sequence[Hypothesis], patience: Patience) -> list[Fitted]:
        """Each hypothesis beside what was chosen, as far as the time allows."""
        both = [together(chosen.hypothesis, h) for h in hypotheses if not h.identity <= chosen.hypothesis.identity]

        def one(k: int) -> Fitted | None:
            if patience.is_up():
                return None
            return fitted(
                self.base, both[k], self.free, self.postures, self.seed, starts=1, near=chosen, hopeless=chosen.cost
            )

        fits = list(spread(one, len(both), self.processes))
        if None in fits:
            patience.over(FURTHER)
        return [fit for fit in fits if fit]


def left_out(ask: Fits, fits: Sequence[Fitted]) -> list[LeftOut]:
    """Of each fit, every posture predicted by the same hypothesis at the others; empty with fewer than two."""
    names = list(ask.postures) if len(ask.postures) > 1 else []

    def error(k: int) -> float:
        fit, name = fits[k // len(names)], names[k % len(names)]
        others = {other: p for other, p in ask.postures.items() if other != name}
        again = ask.nearest(fit.hypothesis, fit, others)
        return _error(again.robot, {name: ask.postures[name]})

    errors = list(spread(error, len(fits) * len(names), ask.processes))
    if not names:
        return [LeftOut({}, float("nan"))] * len(fits)
    counts = [len(ask.postures[name].frequency_hz) for name in names]
    each = np.reshape(errors, (len(fits), len(names)))
    pooled = np.sqrt(np.average(each**2, weights=counts, axis=1))
    return [
        LeftOut(dict(zip(names, some.tolist(), strict=True)), float(p)) for some, p in zip(each, pooled, strict=True)
    ]


Judged = tuple[Fitted, LeftOut | None]


def search(
    ask: Fits,
    before: Fitted,
    plain: LeftOut,
    looked_at: Sequence[Hypothesis],
    tick: Callable[[int], None],
    patience: Patience,
) -> list[Judged]:
    """Hypotheses fitted, one entry, then a second and a third beside the best, as long as each predicts what it was not
    fitted to. The most evident of every round come with their errors on postures left out."""
    found: list[Judged] = []
    chosen, error = before, plain
    first, likeliest = promising(ask, looked_at, tick)
    for depth in range(ENTRIES_AT_ONCE):
        if depth and (0.5 * chosen.misfit * chosen.data < WORTH or patience.over(FURTHER)):
            break
        fits = ask.beside(chosen, likeliest, patience) if depth else list(first)
        fits.sort(key=lambda fit: -fit.evidence())
        contenders = [fit for fit in fits[:CONTENDERS] if fit.evidence() > chosen.evidence()]
        judged: list[Judged] = list(zip(contenders, left_out(ask, contenders), strict=True))
        found += [*judged, *((fit, None) for fit in fits[len(contenders) :])]
        best = next(((fit, out) for fit, out in judged if out is not None and predicts(out, error)), None)
        if best is None:
            break
        chosen, error = best
    return found


def promising(
    ask: Fits, looked_at: Sequence[Hypothesis], tick: Callable[[int], None]
) -> tuple[list[Fitted], list[Hypothesis]]:
    """Single entries fitted, and the most evident of all.

    Those that miss a rough table are not fitted closely where one of them agrees with it.
    """
    rough = scattered(ask.postures, COARSE_SCATTER)

    def roughly(k: int) -> Fitted:
        widened_too = [name for name, _ in looked_at[k].scale]
        few = ask.free.select(n for n, p in enumerate(ask.free) if p.kind != "link" or p.name in widened_too)
        return fitted(ask.base, looked_at[k], few, rough, ask.seed, starts=1)

    coarse = []
    for fit in spread(roughly, len(looked_at), ask.processes):
        coarse.append(fit)
        tick(1)
    coarse.sort(key=lambda fit: -fit.evidence())
    likeliest = [fit.hypothesis for fit in coarse[:REFITTED_ENTRIES]]
    agreeing = [fit for fit in coarse[:REFITTED_ENTRIES] if fit.misfit < LACKING] or coarse[:REFITTED_ENTRIES]

    def closely(k: int) -> Fitted:
        near = agreeing[k]
        return ask.nearest(near.hypothesis, near, ask.postures)

    return list(spread(closely, len(agreeing), ask.processes)), likeliest


def heavier(free: Parameters) -> list[Hypothesis]:
    """Links whose inertia is not as described, mass, centre and moments together: the alias of a payload on them."""
    links = dict.fromkeys(p.name.partition(".")[0] for p in free if p.kind == "link")
    return [
        Hypothesis(
            "parameter", f"{link}.mass",
            scale=tuple((p.name, WIDER_INERTIA) for p in free if p.kind == "link" and p.name.startswith(f"{link}.")),
        )
        for link in links
    ]  # fmt: skip


def scattered(postures: Mapping[str, ModalPosture], times: float) -> dict[str, ModalPosture]:
    """The table with so many times its deviations: a fit to it is drawn into fewer of the wrong pairings."""
    return {
        name: replace(p, frequency_spread=p.frequency_spread * times, damping_spread=p.damping_spread * times)
        for name, p in postures.items()
    }


def predicts(out: LeftOut | None, plain: LeftOut) -> bool:
    """Whether postures left out are predicted so much better that it is not by chance."""
    if out is None or not out.by_posture:
        return False
    worse = any(error > WORSE * plain.by_posture[name] for name, error in out.by_posture.items())
    return out.pooled < BETTER * plain.pooled and not worse


def decide_table(
    rounds: Sequence[Judged],
    before: Fitted,
    plain: LeftOut,
    looked_at: Sequence[Hypothesis],
    base: Robot,
    free: Parameters,
    postures_q: Sequence[FloatArray],
    stated: bool,
) -> Decision:
    """Probabilities; only what predicts postures left out can be a name, and several only if each of them helps.

    Args:
        rounds: from :func:`search`.
        before: the base model; ``plain`` its errors on postures left out.
        looked_at: single entries.
        base, free: the description and what is free in it.
        postures_q: (n,) of every posture, which decide what mechanics cannot tell apart.
        stated: the table gives the deviations of its numbers.
    """
    errors = {frozenset[str](): plain} | {fit.hypothesis.identity: out for fit, out in rounds if out}

    def helps(fit: Fitted, out: LeftOut | None) -> bool:
        whole = fit.hypothesis.identity
        fewer = [error for some, error in errors.items() if some < whole and len(some) == len(whole) - 1]
        return bool(fewer) and all(predicts(out, error) for error in fewer)

    good = [fit.hypothesis for fit, out in rounds if helps(fit, out)]
    same = {alias.key for h in good for alias in companions(h, base, described(free), postures_q)}
    scale = max(1.0, min(fit.misfit for fit, _ in rounds))
    most = max((fit.evidence(scale) for fit, _ in rounds if fit.hypothesis in good), default=0.0)

    def less(fit: Fitted) -> float:
        """A link's own inertia is as probable as a payload on it: a table does not decide between tolerances."""
        if fit.hypothesis.key in same:
            return fit.evidence(scale) - most if fit.hypothesis.effect == "parameter" else 0.0
        return 0.0 if fit.hypothesis in good else HOPELESS

    handicap = [less(fit) for fit, _ in rounds]
    decision = decide(
        [fit for fit, _ in rounds], before, [[h] for h in looked_at], handicap=handicap, scale=scale,
        other=NAMELESS_LEFT if stated else DOUBTED,
    )  # fmt: skip
    if not good:
        beyond = before.misfit > (2.0 if stated else UNSTATED**2)
        none = 0.0 if beyond else 1 - NAMELESS_LEFT
        return replace(decision, probability=[0.0] * len(rounds), none=none, other=1 - none)
    return decision


def states_scatter(table: ModalTable) -> bool:
    """Whether the table gives the uncertainty of its frequencies."""
    modes = [mode for posture in table.postures.values() for mode in posture.modes]
    return all(mode.frequency_std_hz is not None for mode in modes)


def told(
    fits: Sequence[Fitted],
    before: Fitted,
    postures: Mapping[str, ModalPosture],
    plain: LeftOut,
    crossed: Mapping[str, LeftOut],
    word: str,
) -> list[str]:
    """What these numbers support, in sentences a person can check."""
    frequencies = sum(len(p.frequency_hz) for p in postures.values())
    dampings = sum(int(np.isfinite(p.damping).sum()) for p in postures.values())
    text = (
        f"{frequencies} frequencies and {dampings} damping ratios for {len(before.parameters)} numbers with priors; "
        f"frequency error of the base model refitted {_error(before.robot, postures):.1%}"
    )
    if not plain.by_posture:
        return [f"{text}; a single posture leaves nothing to judge a name by"]
    notes: list[str] = [
        Note(f"{text}, each posture left out in turn {plain.pooled:.1%} ({_listed(plain)})", "note", "note")
    ]
    notes += [
        Note(
            f"with {' and '.join(f'{effect} at {site}' for effect, site in parts(fit))}: "
            f"{_error(fit.robot, postures):.1%}, left out {out.pooled:.1%} ({_listed(out)})",
            "note",
            "note",
        )
        for fit in fits
        if (out := crossed.get(fit.hypothesis.key))
    ]
    if word in ("adequate", "unexplained"):
        notes.append(
            "none halves the error on postures left out: agreement with those fitted to is bought, and the table "
            "cannot tell what, if anything, is missing"
        )
    return notes


def next_test(finding: Finding) -> dict[str, object]:
    """What would tell the alternatives apart; between a payload and its link nothing short of weighing does."""
    names = [c.key for m in finding.missing for c in (m.first, *(rival for rival, _ in m.rivals))]
    if all(name.startswith("payload@") or name.endswith(".mass") for name in names):
        text = WEIGH
    else:
        text = (
            "a hammer test in these postures, each also with joint 1 turned by 60°: responses at several points tell "
        )
        text += "what frequencies and damping ratios alone do not"
    return {"description": text, "separates": names, "posture_deg": None}


def _listed(out: LeftOut) -> str:
    return ", ".join(f"{name} {error:.1%}" for name, error in out.by_posture.items())


def _error(robot: Robot, postures: Mapping[str, ModalPosture]) -> float:
    return frequency_error(predict_modes(robot, postures))


def _records(
    postures: Mapping[str, ModalPosture], kept: Sequence[str], robots: Mapping[Stage, Robot]
) -> list[ModalRecord]:
    """Every posture of the table beside the three models."""
    records = []
    for name, posture in postures.items():
        predicted = {stage: _paired(robot, name, posture) for stage, robot in robots.items()}
        records.append(
            ModalRecord(
                name, name in kept, posture.setup.q,
                np.column_stack([posture.frequency_hz, 100 * posture.damping]),
                np.column_stack([posture.frequency_spread, posture.damping_spread]), predicted,
            )
        )  # fmt: skip
    return records


def _paired(robot: Robot, name: str, posture: ModalPosture) -> FloatArray:
    """Frequencies (Hz) and damping (percent) (nm, 2) of the model's modes paired with a posture's."""
    modes = predict_modes(robot, {name: posture})
    return np.array(
        [[np.nan, np.nan] if m.frequency_hz is None else [m.frequency_hz, 100 * (m.damping or 0.0)] for m in modes]
    )
