"""Posterior of a base model and of one more entry on the torque of a motion log, linear in all but the entry's shape.

An entry's own numbers are found by Gauss–Newton with the base model's z eliminated (variable projection; Golub,
Pereyra, SIAM J. Numer. Anal. 10, 1973).
"""

from copy import copy
from functools import partial

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.torque_suspects import Suspect, canonical, with_values
from twin.diagnose.torque_system import (
    CONVERGED,
    FARTHEST_SHAPE,
    System,
    Trial,
    doubt_of,
    own_prior,
    own_values,
    refer,
    start_columns,
    unshrunk,
    whitened_entry,
    without,
)
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters, independent, join
from twin.model.torque_whitened import Columns

LEAST_SLIP = 0.01  # of a usual torque: what pulls the other way is looked for as little


def worth(system: System, suspect: Suspect) -> float:
    """Evidence lost when something found is left out and all else is refitted, at once: no less than that after."""
    return base_fit(system).evidence() - base_fit(without(system, suspect)).evidence()


def base_fit(system: System, hypothesis: Hypothesis = NONE) -> Fitted:
    """The base model at its optimum; with numbers freed by a hypothesis, on the system that has them wider."""
    return _fitted(system, hypothesis, system.parameters, system.z, system.residual, system.information)


def fit_at(system: System, z: FloatArray) -> Fitted:
    """The base model, and what was found, at other numbers than their best."""
    return _fitted(system, NONE, system.parameters, z, system.y - system.A.times(z), system.information)


def _fitted(
    system: System, hypothesis: Hypothesis, parameters: Parameters, z: FloatArray, residual: FloatArray,
    information: FloatArray,
) -> Fitted:  # fmt: skip
    chi2, data = float(residual @ residual), int(system.count * system.level.sum())
    values = np.array([p.value(x) for p, x in zip(parameters, parameters.root @ z, strict=True)])
    entries = with_values(hypothesis, values[len(values) - len(hypothesis.own) :]) if hypothesis.own else []
    return Fitted(
        hypothesis, parameters, z, values, partial(system.robot, z, entries), 0.5 * (chi2 + float(z @ z)),
        chi2 / max(data, 1), information, data, True,
    )  # fmt: skip


def evaluate(
    system: System, suspect: Suspect, u: FloatArray, slopes: bool = True, doubt: FloatArray | None = None
) -> Trial:
    """The suspect's torque at own numbers u, the base model refitted beside it; ``doubt`` is their deviations."""
    column, along = whitened_entry(system, suspect, u, slopes, doubt)
    return Trial(suspect, u, _gain(system, column, u), column, along)


def _gain(system: System, column: Columns, u: FloatArray) -> float:
    information, pull = system.projected(column)
    return float(pull[0] - 0.5 * information[0, 0] - 0.5 * u @ u)


def start(system: System, suspect: Suspect, largest_kept: int = 20_000_000) -> Trial:
    """The best of a suspect's starts, sizes solved for where it has any; without slopes, to be settled.

    Up to ``largest_kept`` numbers of its columns are kept from one search to the next.
    """
    own, sizes = suspect.hypothesis.own, list(suspect.sizes)
    first = int(not suspect.vanishes)
    width = first + len(sizes)
    whitened = system.screened.get(suspect.form)
    if whitened is None:
        columns = [column for values in suspect.starts for column in start_columns(system, suspect, values)]
        whitened = system.whiten(*columns)
        if whitened.rows.size < largest_kept and not suspect.effect.refers:
            system.screened[suspect.form] = whitened
    across = system.across(whitened)
    pulls = whitened.rows.T @ system.on(system.residual, whitened)
    promised: list[tuple[float, int, FloatArray, FloatArray]] = []
    for number, values in enumerate(suspect.starts):
        part = slice(number * width, (number + 1) * width)
        C = whitened.rows[:, part]
        information = C.T @ C - across[part] @ system.inverse @ across[part].T
        u, weight = own_prior(own, values), np.ones(first)
        if sizes:
            pull = pulls[part][first:] - information[first:, :first].sum(axis=1) - u[sizes]
            before = u[sizes]
            u[sizes] += np.linalg.solve(information[first:, first:] + np.eye(len(sizes)), pull)
            u = _inside(suspect, u)
            weight = np.concatenate([np.ones(first), u[sizes] - before])
        elif suspect.effect.elements:  # torque goes with all of their numbers together
            weight = np.maximum(pulls[part] / np.maximum(np.diag(information), 1e-300), LEAST_SLIP)
            u = _inside(suspect, own_prior(own, weight * values))
        gain = float(weight @ pulls[part] - 0.5 * weight @ information @ weight - 0.5 * u @ u)
        promised.append((gain, number, u, weight))
    promised.sort(key=lambda item: -item[0])
    if suspect.effect.linear:
        gain, number, u, weight = promised[0]
        rows = whitened.rows[:, number * width : (number + 1) * width] @ weight[:, None]
        return Trial(suspect, u, gain, Columns(whitened.joints, rows), Columns(whitened.joints, rows[:, :0]))
    found: list[Trial] = []
    for gain, _, u, _ in promised[:3]:
        found.append(evaluate(system, suspect, u, slopes=False))
        if found[-1].gain > 0.7 * gain:  # a law that is not linear keeps its promise only near where it started
            break
    return max(found, key=lambda trial: trial.gain)


def _inside(suspect: Suspect, u: FloatArray) -> FloatArray:
    """u with sizes that cannot be negative at zero or above, and shapes where they are looked for."""
    own = suspect.hypothesis.own
    bounded = zip(own, suspect.nonnegative, strict=True)
    least = [-FARTHEST_SHAPE if p.log else -p.mean / p.deviation if bound else -np.inf for p, bound in bounded]
    return np.clip(u, least, [FARTHEST_SHAPE if p.log else np.inf for p in own])


def reach(system: System, trial: Trial, iterations: int = 2, usual: float = 0.3) -> Trial:
    """A started trial after a few steps of all its own numbers: of a law that is not linear in them, its promise.

    A mass where the search starts says little of what it explains elsewhere on its link. From a size of nothing no
    other number can be told: a ``usual`` one, in prior deviations, is tried there.
    """
    suspect, u = trial.suspect, trial.u
    if len(suspect.sizes) == len(u):
        return trial
    if not trial.column.rows.any():
        u = u.copy()
        u[list(suspect.sizes)] += usual
    reached = refine(system, evaluate(system, suspect, u), iterations)
    return max(trial, reached, key=lambda t: t.gain)


def settle(system: System, trial: Trial) -> Trial:
    """Refined, at last under priors as wide as its own sizes came out: a usual size draws one that is not usual.

    An entry that acts on other torques is refined again, once these are what they are with it in the model.
    """
    trial = refine(system, evaluate(system, trial.suspect, trial.u))
    own = trial.suspect.hypothesis.own
    values = own_values(own, trial.u)
    if np.any((same := canonical(trial.suspect.hypothesis, values)) != values):
        trial = refine(system, evaluate(system, trial.suspect, own_prior(own, same)))
    wide = unshrunk(trial)
    if wide.suspect.hypothesis.own != trial.suspect.hypothesis.own:
        trial = refine(system, evaluate(system, wide.suspect, wide.u))
    for _ in range(2 if trial.suspect.effect.refers else 0):
        again = copy(system)
        refer(again, eliminated(system, trial))
        trial = refine(again, evaluate(again, trial.suspect, trial.u))
    return trial


def from_every_start(system: System, trial: Trial, few: int = 10) -> Trial:
    """The best of a settled trial and of its few starts, refined: where steps meet, a law has more than one optimum."""
    suspect = trial.suspect
    if len(suspect.starts) > few or suspect.effect.refers:
        return trial
    starts = [own_prior(suspect.hypothesis.own, values) for values in suspect.starts]
    return max([trial, *(refine(system, evaluate(system, suspect, u)) for u in starts)], key=lambda t: t.gain)


def profiled(system: System, suspect: Suspect, own: int, drop: float) -> tuple[float, float]:
    """Values of a number of something found at which all else fits worse by ``drop`` in ln likelihood and prior.

    Some rows tell little but the product of a ratio and a torque. They leave a bent valley, and steps make it rough.
    Slopes at its floor do not tell its length.
    """
    at, rest = system.own(suspect), without(system, suspect)
    best = evaluate(rest, suspect, system.z[at])
    covariance = np.linalg.inv(rest.projected(best.slopes)[0] + np.eye(len(at)))
    deviation = float(np.sqrt(covariance[own, own]))
    ends = []
    for side in (-1, 1):
        inside, here, fell = best.u[own], best, 0.0
        for far in (1.0, 1.6, 2.5, 4.0, 6.0, 9.0, 13.0):  # deviations
            there = best.u[own] + side * far * deviation
            u = here.u + covariance[own] / covariance[own, own] * (there - here.u[own])
            here = refine(rest, evaluate(rest, suspect, _inside(suspect, u)), 4, own)
            lost = best.gain - here.gain
            if lost > drop:
                inside += (there - inside) * (drop - fell) / (lost - fell)
                break
            inside, fell = there, lost
        ends.append(inside)
    low, high = (own_values(suspect.hypothesis.own, np.where(np.arange(len(at)) == own, x, 0.0))[own] for x in ends)
    return float(low), float(high)


def eliminated(system: System, trial: Trial) -> FloatArray:
    """The base model's numbers (z,) beside a trial."""
    return np.asarray(system.inverse @ system.A.transposed(system.y - system.full(trial.column)[:, 0]))


def refine(system: System, trial: Trial, iterations: int = 8, fixed: int | None = None) -> Trial:
    """Gauss–Newton on the own numbers (but one), the base model's eliminated, with Marquardt's damping.

    That is a share of what the data hold of every number: a mass and where it hangs multiply, and a log holds their
    product to a thousandth of its prior (J. SIAM 11, 431, 1963).
    """
    damping, free = 1e-3, np.arange(len(trial.u)) != fixed
    for _ in range(iterations):
        information, pull = system.projected(trial.slopes)
        held, here = information + np.eye(len(pull)), system.across(trial.column)
        pull = pull - trial.u - trial.slopes.rows.T @ trial.column.rows[:, 0]
        pull += (system.across(trial.slopes) @ system.inverse @ here.T)[:, 0]
        ahead = trial
        for _ in range(6):
            step = np.zeros(len(pull))
            step[free] = np.linalg.solve((held + damping * np.diag(np.diag(held)))[np.ix_(free, free)], pull[free])
            step *= min(1.0, 1.5 / max(float(np.abs(step).max()), 1e-12)) if damping > 1e-2 else 1.0
            ahead = evaluate(system, trial.suspect, _inside(trial.suspect, trial.u + step), slopes=False)
            if ahead.gain > trial.gain:
                break
            damping = max(8 * damping, 1e-1)
        gained = ahead.gain - trial.gain
        if gained <= 0:
            return trial
        trial = evaluate(system, trial.suspect, ahead.u, doubt=doubt_of(system, trial.slopes))
        damping = max(damping / 8, 1e-6)
        if gained < CONVERGED:
            return trial
    return trial


def fitted(system: System, trial: Trial) -> Fitted:
    """A refined suspect as a fit of all numbers."""
    own = trial.suspect.hypothesis.own
    parameters = join(system.parameters, independent(own))
    column = system.full(trial.column)[:, 0]
    z = eliminated(system, trial)
    residual = system.y - column - system.A.times(z)
    across = system.across(trial.slopes)
    within = trial.slopes.rows.T @ trial.slopes.rows + np.eye(len(own))
    information = np.block([[system.information, across.T], [across, within]])
    return _fitted(system, trial.suspect.hypothesis, parameters, np.concatenate([z, trial.u]), residual, information)
