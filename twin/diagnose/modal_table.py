"""What a modal table says beyond the base model: a few frequencies and damping ratios, and so rarely much.

Every mechanical entry that the description lacks is fitted beside everything the base model has free. A table states no
more than a handful of numbers, mostly without their uncertainty: the scatter is then what the base model leaves, a name
must have the evidence against that, and it must predict postures that it was not fitted to better than the base model
does, each left out in turn. Otherwise the table cannot tell, and the finding says so.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.decide import Decision, decide
from twin.diagnose.evidence import sentence
from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, sites
from twin.diagnose.physical import physical
from twin.diagnose.records import STAGES, ModalRecord, Stage
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.verdict import Finding, judge, missing_of
from twin.errors import InputError
from twin.identify.elastic import without_limits
from twin.identify.elastic_modal import (
    FARTHEST,
    ModalPosture,
    fit_modes,
    frequency_error,
    modal_postures,
    predict_modes,
)
from twin.identify.parameters import Parameters, free_parameters
from twin.measure.campaign import Channels, FloatArray
from twin.measure.modal_table import ModalTable
from twin.physics import CATALOGUE
from twin.robot.description import Axis, Robot

STARTS = 2  # of the base model and of contenders; one for all others
CONTENDERS = 3  # most evident hypotheses that are judged by leaving postures out
BETTER = 0.95  # of the base model's error on postures left out: a name must predict them better
HOPELESS = 1e3  # ln evidence taken off one that does not
UNKNOWN_SCATTER = 0.05  # probability of something else where the table does not state its uncertainty


@dataclass(frozen=True)
class LeftOut:
    """A hypothesis with every posture left out in turn: RMS relative frequency error there, by posture and pooled."""

    by_posture: dict[str, float]
    pooled: float


def diagnose_table(
    table: ModalTable,
    given: Robot,
    source: str = "table",
    *,
    hold_out: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str, int], Callable[[int], None]] | None = None,
) -> Finding:
    """What a modal table says.

    Args:
        table: frequencies and, where known, damping ratios by posture.
        given: the description, removals applied.
        source: the file, for messages.
        hold_out: postures not to use; without any, each is left out in turn and the finding's errors are of all.
        seed: of the starts.
        progress: makes progress bars.

    Raises:
        InputError: the robot has no springs, the table no modes, or nothing is left to fit to.
    """
    base = without_limits(given)
    free = free_parameters(base).only("spring", "entry", "link")
    if not free.items or not any(p.kind == "spring" for p in free):
        raise InputError(given.name, "axes", "expected at least one axis with a stiffness: nothing can vibrate")
    postures = {name: p for name, p in modal_postures(table, base).items() if len(p.frequency_hz)}
    kept = {name: p for name, p in postures.items() if name in (hold_out or ())}
    used = {name: p for name, p in postures.items() if name not in kept}
    if not used:
        raise InputError(source, "postures", "no posture with modes is left to fit to")
    looked_at = mechanical_suspects(base)
    tick = progress("modal table", len(looked_at)) if progress else (lambda count: None)
    used = scattered(used, scatter(fitted(base, NONE, free, used, seed), used))
    before = fitted(base, NONE, free, used, seed)
    fits = []
    for hypothesis in looked_at:
        fits.append(fitted(base, hypothesis, free, used, seed, starts=1))
        tick(1)
    fits.sort(key=lambda fit: -fit.evidence())
    again = [fitted(base, fit.hypothesis, free, used, seed) for fit in fits[:CONTENDERS]]
    fits = sorted([*again, *fits[CONTENDERS:]], key=lambda fit: -fit.evidence())
    plain = left_out(base, NONE, free, used, seed)
    crossed = {fit.hypothesis.key: left_out(base, fit.hypothesis, free, used, seed) for fit in fits[:CONTENDERS]}
    decision = decide_table(fits, before, looked_at, used, plain, crossed)
    word = judge(decision)
    answered = word in ("named", "ambiguous")
    best = decision.ranked[0] if answered else before
    robots = {"as_given": given, "before": _limited(before.robot, given), "after": _limited(best.robot, given)}
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
        error, list(kept) or ([f"{name} (left out in turn)" for name in used] if plain.by_posture else []), records,
        warnings=[told(fits, before, used, plain, crossed)],
    )  # fmt: skip
    finding.missing = [replace(m, evidence=sentence(m.first.title, records, error, finding.held_out)) for m in missing]
    return finding


def mechanical_suspects(base: Robot) -> list[Hypothesis]:
    """Entries that move modes and that the description does not have; a resonator, which adds one, is not among them:
    a table that lacks a mode does not say that there is none."""
    present = {(entry.effect, entry.site) for entry in base.physics}
    none = Channels((), (), np.zeros((0, 3)), np.zeros((0, 3)))
    found = []
    for name, effect in CATALOGUE.items():
        if "hammer" not in effect.seen_in or any("LABEL" in s or "NODE" in s for s in effect.sites):
            continue
        if name == "attached_resonator":
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
) -> Fitted:
    """A hypothesis at its optimum on a table; a mode the model lacks costs what one a factor of two off does."""
    robot, parameters = hypothesis.robot(base), hypothesis.parameters(free)
    fit = fit_modes(robot, list(postures.values()), parameters, starts=starts, seed=seed)
    spread = {name: float(np.median(p.frequency_spread)) for name, p in postures.items()}
    absent = sum(
        0.5 * (FARTHEST / spread[mode.posture]) ** 2
        for mode in predict_modes(fit.robot, postures)
        if mode.frequency_hz is None
    )
    cost = fit.cost + absent
    return Fitted(
        hypothesis, parameters, fit.z, fit.values, fit.robot, cost,
        (2 * cost - float(fit.z @ fit.z)) / max(fit.data, 1), fit.fisher + np.eye(len(fit.z)), fit.data, fit.converged,
    )  # fmt: skip


def left_out(
    base: Robot, hypothesis: Hypothesis, free: Parameters, postures: Mapping[str, ModalPosture], seed: int
) -> LeftOut:
    """Every posture predicted by a fit to the others; empty with fewer than two."""
    errors: dict[str, float] = {}
    counts = []
    for name in postures if len(postures) > 1 else ():
        others = {other: p for other, p in postures.items() if other != name}
        fit = fitted(base, hypothesis, free, others, seed, starts=1)
        errors[name] = _error(fit.robot, {name: postures[name]})
        counts.append(len(postures[name].frequency_hz))
    squares = np.array(list(errors.values())) ** 2
    return LeftOut(errors, float(np.sqrt(np.average(squares, weights=counts))) if errors else float("nan"))


def decide_table(
    fits: Sequence[Fitted],
    before: Fitted,
    looked_at: Sequence[Hypothesis],
    postures: Mapping[str, ModalPosture],
    plain: LeftOut,
    crossed: Mapping[str, LeftOut],
) -> Decision:
    """Probabilities; only what predicts postures left out better than the base model can be a name."""
    handicap = []
    for fit in fits:
        out = crossed.get(fit.hypothesis.key)
        handicap.append(0.0 if out is not None and out.pooled < BETTER * plain.pooled else HOPELESS)
    return decide(
        fits, before, [[hypothesis] for hypothesis in looked_at], handicap=handicap,
        other=UNKNOWN_SCATTER, scale=1.0,
    )  # fmt: skip


def scatter(before: Fitted, postures: Mapping[str, ModalPosture]) -> float:
    """Factor on the table's variances: what the base model leaves of the modes it has."""
    absent = sum(
        (FARTHEST / float(np.median(postures[mode.posture].frequency_spread))) ** 2
        for mode in predict_modes(before.robot, postures)
        if mode.frequency_hz is None
    )
    return max(1.0, before.misfit - absent / max(before.data, 1))


def scattered(postures: Mapping[str, ModalPosture], scale: float) -> dict[str, ModalPosture]:
    """The table with its variances multiplied: priors then count for as much as they should beside it."""
    return {
        name: replace(
            p, frequency_spread=p.frequency_spread * np.sqrt(scale), damping_spread=p.damping_spread * np.sqrt(scale)
        )
        for name, p in postures.items()
    }


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
) -> str:
    """What these numbers support, in one sentence a person can check."""
    frequencies = sum(len(p.frequency_hz) for p in postures.values())
    dampings = sum(int(np.isfinite(p.damping).sum()) for p in postures.values())
    text = (
        f"{frequencies} frequencies and {dampings} damping ratios for {len(before.parameters)} numbers with priors; "
        f"base model refitted {_error(before.robot, postures):.1%}"
    )
    if not plain.by_posture:
        return text + "; a single posture leaves nothing to judge a name by"
    text += f", each posture left out in turn {plain.pooled:.1%} ({_listed(plain)})"
    for fit in [fit for fit in fits if fit.hypothesis.key in crossed][:3]:
        gain = fit.evidence() - before.evidence()
        out = crossed[fit.hypothesis.key]
        text += (
            f"; with {fit.hypothesis.effect} at {fit.hypothesis.site} {_error(fit.robot, postures):.1%}, left out "
            f"{out.pooled:.1%} ({_listed(out)}), ln Bayes factor {gain:.1f}"
        )
    return text


def _listed(out: LeftOut) -> str:
    return ", ".join(f"{name} {error:.1%}" for name, error in out.by_posture.items())


def _error(robot: Robot, postures: Mapping[str, ModalPosture]) -> float:
    return frequency_error(predict_modes(robot, postures))


def _limited(robot: Robot, given: Robot) -> Robot:
    robot = physical(robot)
    axes: list[Axis] = [a.model_copy(update={"limits": b.limits}) for a, b in zip(robot.axes, given.axes, strict=True)]
    return robot.model_copy(update={"axes": axes})


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
