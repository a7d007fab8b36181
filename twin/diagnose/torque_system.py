"""The base model of a log and the entries found so far, on whitened rows: linearised, extended, and without some."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.torque_suspects import Suspect, with_values
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, independent, join
from twin.model.torque_base import DIFFERENCES, base_of, with_sliding
from twin.model.torque_laws import model_torque
from twin.model.torque_noise import dry_friction, noise_order, plain_fit, whitening
from twin.model.torque_robot import robot_of
from twin.model.torque_signal import Prepared, Run
from twin.model.torque_whitened import Columns, Whitened
from twin.parallel import spread
from twin.physics import CATALOGUE
from twin.robot.description import Entry, Robot

FARTHEST_SHAPE = 3.0  # prior deviations of a shape (a speed, an order, a travel)
CONVERGED = 0.02  # of ½ χ²: less is no gain


@dataclass
class System(Whitened):
    """Whitened rows of a log, and on them the base model with the entries found so far.

    Attributes:
        found: entries that belong to the base model beyond the description's.
        slopes: of what was found, by name: numbers they depend on, and whitened slopes there.
        screened: whitened columns of the suspects' starts, which stay the same when something is found.
        recording: what slopes and starts were :attr:`recorded_through`, where there are any.
    """

    found: tuple[Suspect, ...] = ()
    slopes: dict[str, tuple[FloatArray, Columns]] = field(default_factory=dict)
    screened: dict[str, Columns] = field(default_factory=dict)
    recording: FloatArray = field(default_factory=lambda: np.zeros(0))

    def entries(self, z: FloatArray, without: Suspect | None = None) -> list[Entry]:
        """What was found so far, at z."""
        at, out = len(self.base.parameters), []
        for suspect in self.found:
            own = suspect.hypothesis.own
            if suspect is not without:
                out += with_values(suspect.hypothesis, own_values(own, z[at : at + len(own)]))
            at += len(own)
        return out

    def own(self, suspect: Suspect) -> list[int]:
        """Indices in z of the numbers of something found."""
        at = len(self.base.parameters)
        for found in self.found:
            if found.name == suspect.name:
                break
            at += len(found.hypothesis.own)
        return list(range(at, at + len(suspect.hypothesis.own)))

    def robot(self, z: FloatArray, entries: Sequence[Entry] = ()) -> Robot:
        """The description at the nearest to z that can exist, with what was found and more entries."""
        return robot_of(self, z, (*self.entries(z), *entries))


def refer(system: System, z: FloatArray, alike: float = 1e-3) -> list[FloatArray]:
    """Let laws that act on other torques see the model at z: what was found adds (m, n) to the recorded torque.

    Through a recording whose gains, and delay in rows, are so much ``alike``, columns are what they were.
    """
    added = _refer(system, z, system.entries(z))
    now = system.recorded_through
    if len(system.recording) and np.abs(now - system.recording).max() > alike:
        system.screened, system.slopes, system.recording = {}, {}, now
    elif not len(system.recording):
        system.recording = now
    return added


def _refer(system: System, z: FloatArray, entries: Sequence[Entry]) -> list[FloatArray]:
    runs = system.base.runs
    system.state = [system.base.state(k, system.plain(z)) for k in range(len(runs))]
    return [model_torque(run, state, entries) for run, state in zip(runs, system.state, strict=True)]


def unshrunk(trial: "Trial") -> "Trial":
    """The trial with priors on its sizes as wide as these came out: what is not described may have any size.

    How probable it is was decided before; the usual size would only draw the numbers towards it.
    """
    own = trial.suspect.hypothesis.own
    return rescaled(trial, np.array([1.0 if p.log else max(1.0, abs(u)) for p, u in zip(own, trial.u, strict=True)]))


def rescaled(trial: "Trial", scale: FloatArray) -> "Trial":
    """The trial with the priors of its numbers so many times (m,) as wide."""
    hypothesis = trial.suspect.hypothesis
    own = tuple(replace(p, deviation=p.deviation * s) for p, s in zip(hypothesis.own, scale, strict=True))
    slopes = replace(trial.slopes, rows=trial.slopes.rows * scale)
    suspect = replace(trial.suspect, hypothesis=replace(hypothesis, own=own))
    return replace(trial, suspect=suspect, u=trial.u / scale, slopes=slopes)


def extended(system: System, trial: "Trial") -> System:
    """The same rows with an entry in the base model: its numbers are nuisances from now on.

    It is linear as the trial has it until it is :func:`relinearised`.
    """
    return replace(
        system,
        found=(*system.found, trial.suspect),
        parameters=join(system.parameters, independent(trial.suspect.hypothesis.own)),
        A=system.A.beside((trial.slopes.joints, trial.slopes.rows)),
        y=system.y - system.full(trial.column)[:, 0] + system.full(trial.slopes) @ trial.u,
        slopes={**system.slopes, trial.suspect.name: (trial.u, trial.slopes)},
    )


def without(system: System, suspect: Suspect) -> System:
    """The same rows with something found left out, all else linear as it is until it is :func:`relinearised`."""
    at = system.own(suspect)
    column, slopes = whitened_entry(system, suspect, system.z[at])
    return replace(
        system,
        found=tuple(s for s in system.found if s.name != suspect.name),
        parameters=system.parameters.select(k for k in range(len(system.parameters)) if k not in at),
        A=system.A.without(at),
        y=system.y + system.full(column)[:, 0] - system.full(slopes) @ system.z[at],
        slopes={name: kept for name, kept in system.slopes.items() if name != suspect.name},
    )


def relinearised(system: System, iterations: int = 8, exact: float = 1e-5) -> System:
    """The same rows with all that was found linearised at its numbers as they are beside all else.

    Gauss–Newton on all numbers at once: each was linearised where it was found, before the others were. It ends where a
    step gains less than ``CONVERGED`` and ``exact`` times the cost.
    """
    z = _bounded(system, _taken(system))
    here, cost = linearised(system, z)
    for _ in range(iterations):
        step = _bounded(system, here.z) - z
        ahead, reached = linearised(system, at := z + step)
        if reached >= cost:
            bend = _bent(here, ahead, at)
            for share in (1.0, 0.5, 0.2, 0.05):
                at = _bounded(system, z + share * step + share**2 * bend)
                ahead, reached = linearised(system, at)
                if reached < cost:
                    break
        gained = cost - reached
        if gained <= 0:
            break
        z, here, cost = at, ahead, reached
        if gained < CONVERGED + exact * cost:
            break
    return here


def _bent(here: System, ahead: System, at: FloatArray) -> FloatArray:
    """What to add to a step (z,) that ends at ``at``, for the slopes change along it.

    A mass and its lever change together along a curved valley: their product is known far better than either. What the
    rows at the end differ by from the linear model is put right to first order (geodesic acceleration: Transtrum,
    Sethna, arXiv:1201.5885, equation 13, over a whole step).
    """
    beyond = (ahead.y - ahead.A.times(at)) - (here.y - here.A.times(at))
    return np.asarray(np.linalg.solve(here.information, here.A.transposed(beyond)))


def _taken(system: System) -> FloatArray:
    """Where the slopes of what was found were taken (z,), all else as it is best there: the linear optimum may be far.

    Of a law that steps, or along a valley, the first step from there must be worth it as any other must.
    """
    z, fixed = system.z.copy(), np.zeros(len(system.z), bool)
    for suspect in system.found:
        at = system.own(suspect)
        u = system.slopes[suspect.name][0] if suspect.name in system.slopes else z[:0]
        if not suspect.effect.refers and len(u) == len(at):
            z[at], fixed[at] = u, True
    if fixed.any():
        pull = system.A.transposed(system.y) - system.information[:, fixed] @ z[fixed]
        z[~fixed] = np.linalg.solve(system.information[np.ix_(~fixed, ~fixed)], pull[~fixed])
    return z


def with_doubts(system: System, mistimed: float = 0.02) -> System:
    """The same with friction in doubt where and when what was found puts it, and refitted.

    A drive may turn with other axes, too. Its dry friction then steps where the drive turns back, not where its axis
    does. The encoder cannot time these steps; if they counted as exact, the ratio would seem known far too well. Torque
    that is recorded late steps late. A doubt in the wrong place leaves a part of a reversal, which looks like low-speed
    friction. A delay that changes by less than ``mistimed`` rows is left as it was.
    """
    turning, late = np.eye(len(system.whitening)), system.state[0].delay + system.state[0].lag
    for entry in system.entries(system.z):
        drive, axis, ratio = CATALOGUE[entry.effect].spins(entry.site, entry.values)
        turning[drive, axis] += ratio
    still = turning if np.any(turning != np.eye(len(turning))) else system.turning[:0]
    if np.array_equal(still, system.turning) and abs(late - system.late) * system.base.runs[0].rate_hz < mistimed:
        return system
    here = replace(system, turning=still, late=late)
    here.assemble()
    slopes = (system.slopes[suspect.name][1] for suspect in system.found)
    A = here.recorded().beside(*((columns.joints, columns.rows) for columns in slopes))
    return relinearised(replace(here, A=A, y=system.y + here.data - system.data, slopes={}, screened={}))


def linearised(
    system: System, z: FloatArray, doubt: FloatArray | None = None, near: float = 0.01
) -> tuple[System, float]:
    """The system with what was found linearised at z, and ½ χ² + ½ zᵀz there; ``doubt`` (z,) deviations, as it has z.

    They are those of the system's own fit by default. Slopes taken within ``near`` of their numbers are kept.
    """
    size = len(system.base.parameters)
    doubt = np.sqrt(np.diag(system.inverse)) if doubt is None else doubt
    plain = system.design.scaled(system.widened)
    here = replace(system, A=plain, slopes=dict(system.slopes))
    added = here.full(here.whiten(refer(here, z)))[:, 0]
    rest = here.data - added - plain.times(z[:size])
    here.A = here.recorded()
    system.through = here.through
    here.y = rest + here.A.times(z[:size])
    beside = []
    for suspect in here.found:
        at = here.own(suspect)
        now = z if suspect.effect.refers else z[at]  # it depends on all numbers, or on its own
        u, slopes = here.slopes.get(suspect.name, (now, None))
        if slopes is None or len(u) != len(now) or np.any(np.abs(now - u) > near * (1 + np.abs(u))):
            slopes = _slopes(here, suspect, z, doubt[at])
            here.slopes[suspect.name] = now, slopes
        for part, j in enumerate(slopes.joints):
            here.y[here.rows(j)] += slopes.rows[part * here.count : (part + 1) * here.count] @ z[at]
        beside.append((slopes.joints, slopes.rows))
    here = replace(here, A=here.A.beside(*beside))
    return here, 0.5 * float(rest @ rest) + 0.5 * float(z @ z)


def _slopes(system: System, suspect: Suspect, z: FloatArray, doubt: FloatArray) -> Columns:
    """Of something found, beside all else at z."""
    aside = system
    if suspect.effect.refers:
        aside = copy(system)
        _refer(aside, z, system.entries(z, without=suspect))
    return whitened_entry(aside, suspect, z[system.own(suspect)], doubt=doubt)[1]


def within_reach(system: System) -> bool:
    """Whether all shapes of what was found are where they are looked for; else the fit has left its slopes."""
    return bool(np.abs(_bounded(system, system.z) - system.z).max(initial=0.0) < 1.0)


def _bounded(system: System, z: FloatArray) -> FloatArray:
    """z with shapes where they are looked for."""
    out = z.copy()
    for suspect in system.found:
        at = system.own(suspect)
        log = np.array([p.log for p in suspect.hypothesis.own])
        out[at] = np.where(log, np.clip(z[at], -FARTHEST_SHAPE, FARTHEST_SHAPE), z[at])
    return out


def with_wider(system: System, hypothesis: Hypothesis) -> System:
    """The same rows with some numbers of the base model free beyond what the description allows."""
    names = system.parameters.names
    factors = {names.index(name): factor for name, factor in hypothesis.scale}
    widened = {k: system.widened.get(k, 1.0) * factor for k, factor in factors.items()}
    return replace(
        system,
        A=system.A.scaled(factors),
        parameters=hypothesis.parameters(system.parameters),
        widened={k: factor for k, factor in {**system.widened, **widened}.items() if abs(factor - 1) > 1e-9},
    )


def system_of(prepared: Prepared, rich: Sequence[Suspect], runs: list[Run] | None = None, processes: int = 1) -> System:
    """The used runs of a log, whitened by the residual of the richest model there is."""
    base = base_of(prepared.regressor, prepared.used if runs is None else runs)
    for _ in range(2 * bool(base.sliding.any())):  # the second time beside its own presliding, if none was described
        base = with_sliding(base, dry_friction(base))
    n = prepared.regressor.robot.axis_count
    system = System(base, np.zeros((n, noise_order(base.runs) + 1)), base.parameters)
    refer(system, np.zeros(len(base.parameters)))
    for _ in range(2):  # the second time with friction, load and torque as fitted
        z = plain_fit(base)
        refer(system, z)
    extra = _richest(system, rich, processes)
    system.whitening, system.level, system.noise = whitening(base, extra, system.order, processes)
    system.assemble()
    refer(system, system.z)
    return system


def _richest(system: System, rich: Sequence[Suspect], processes: int) -> list[list[FloatArray]]:
    """Per joint columns (m,) over all runs that span what suspects could add."""
    extra: list[list[FloatArray]] = [[] for _ in system.whitening]
    for shapes in spread(lambda k: _shapes(system, rich[k]), len(rich), processes):
        for column in shapes:
            for j, own in enumerate(extra):
                if any(part[:, j].any() for part in column):
                    own.append(np.concatenate([part[:, j] for part in column]))
    return extra


def _shapes(system: System, suspect: Suspect) -> list[list[FloatArray]]:
    """A few columns that span what a suspect could add, run by run (m, n); of starts of either sign one."""
    starts = suspect.starts
    if len(starts) > 40:
        return []
    size = np.abs(starts)
    few = [start for k, start in enumerate(starts) if not any(np.array_equal(size[k], x) for x in size[:k])]
    return [column for start in few for column in start_columns(system, suspect, start)]


def start_columns(system: System, suspect: Suspect, start: FloatArray) -> list[list[FloatArray]]:
    """The entry's torque (m, n) per run at a start, if any, and what a prior deviation of every size adds."""
    own = suspect.hypothesis.own
    here = [] if suspect.vanishes else [system.torque(with_values(suspect.hypothesis, start), at_once=True)]
    columns = list(here)
    for k in suspect.sizes:
        shifted = start.copy()
        shifted[k] += DIFFERENCES[1] * own[k].deviation
        moved = system.torque(with_values(suspect.hypothesis, shifted), at_once=True)
        for still in here:
            moved = [a - b for a, b in zip(moved, still, strict=True)]
        columns.append([part / DIFFERENCES[1] for part in moved])
    return columns


def own_prior(own: Sequence[Parameter], values: FloatArray) -> FloatArray:
    """Own values in prior deviations (m,)."""
    return np.array(
        [
            (np.log(max(v, 1e-300) / p.mean) if p.log else v - p.mean) / p.deviation
            for p, v in zip(own, values, strict=True)
        ]
    )


def own_values(own: Sequence[Parameter], u: FloatArray) -> FloatArray:
    """Values (m,) of own parameters in prior deviations."""
    return np.array([p.value(p.deviation * x) for p, x in zip(own, u, strict=True)])


@dataclass(frozen=True)
class Trial:
    """A suspect somewhere: own numbers u in prior deviations, the fall of the cost, whitened torque and slopes."""

    suspect: Suspect
    u: FloatArray
    gain: float
    column: Columns
    slopes: Columns


def whitened_entry(
    system: System, suspect: Suspect, u: FloatArray, slopes: bool = True, doubt: FloatArray | None = None
) -> tuple[Columns, Columns]:
    """The suspect's torque at own numbers u, and its slopes, over as much as the rows leave in doubt of each number.

    Over more a wave turns round, or a step passes another; over much less a law that steps is jagged.
    """
    own = suspect.hypothesis.own
    if slopes and doubt is None:
        doubt = doubt_of(system, whitened_entry(system, suspect, u, doubt=np.full(len(u), DIFFERENCES[1]))[1])
    steps = np.clip(np.zeros(len(u)) if doubt is None else doubt, *DIFFERENCES)

    def torque(at: FloatArray) -> list[FloatArray]:
        return system.torque(with_values(suspect.hypothesis, own_values(own, at)))

    here = torque(u)
    parts = [here]
    for k in range(len(u) if slopes else 0):
        moved = u.copy()
        moved[k] += steps[k]
        parts.append([(a - b) / steps[k] for a, b in zip(torque(moved), here, strict=True)])
    together = system.whiten(*parts)
    return Columns(together.joints, together.rows[:, :1]), Columns(together.joints, together.rows[:, 1:])


def doubt_of(system: System, slopes: Columns) -> FloatArray:
    """Deviations (m,) of numbers that have such slopes, in those of their priors."""
    information, _ = system.projected(slopes)
    held, vectors = np.linalg.eigh(information)  # of a record without noise rounding leaves some below zero
    return np.asarray(np.sqrt(vectors**2 @ (1 / (1 + np.maximum(held, 0)))))
