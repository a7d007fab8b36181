"""Joint stiffness and damping from measured FRFs or modal tables, by maximum posterior probability.

A fit minimises ½ Σ |H − H(z)|²/σ² + ½ zᵀz over z, in which the prior is the standard normal. σ² is the measured
variance per real and imaginary part. Model tolerances (masses, centres of mass, inertias, posture angles, channel
gains) are free under their priors. From afar a linear residual has false minima wherever peaks do not overlap. So every
start goes through the robust residual of the complex logarithm first. Then it goes through a linear one whose tolerance
shrinks. Both are on every eighth line; the best ends on all lines. Of many postures the starts see those that cover the
others best.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from twin.identify.covering import covering, many
from twin.identify.descent import minimise
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import Channels, FloatArray
from twin.model.parameters import (
    Parameter,
    Parameters,
    Side,
    direction_parameters,
    free_parameters,
    independent,
    join,
    point_parameters,
)
from twin.model.recorded import Recorded, noise_stated, without_limits
from twin.robot.description import Robot

EVERY_LINE = 8  # starts see every eighth line, and at least COARSE_LINES
COARSE_LINES = 25
LINES = 300  # drawn of every recording for the Gauss–Newton matrix of many: of 800 its eigenvalues are right to a half
FIT_TEMPERS = (0.1, 0.01)  # relative model error assumed on the way from logarithmic to linear residual
STATED = 2.0  # times a tolerance that nobody states more exactly: how all nodes scatter shows it to a tenth
RARE = 0.01  # share of numbers within their tolerance that are taken to be beyond it
SAME_END = 0.1  # prior deviations: starts that end nearer than that in every number agree, however exact the data are
AGREEMENT = 4.0  # starts agree whose costs differ by less (2Δ = 8), by themselves and in the best one's quadratic model


@dataclass(frozen=True)
class Start:
    """Where one start ended: its cost on the coarse lines, its z, and the Gauss–Newton matrix there.

    ``converged``: it came to rest there. Of many postures z leaves out the angles of those it did not see.
    """

    cost: float
    z: FloatArray
    information: FloatArray
    converged: bool = True


@dataclass(frozen=True)
class Fit:
    """A maximum-posterior fit.

    Attributes:
        parameters: the free numbers and their prior.
        z: (n,) optimum in prior coordinates, ``values`` (n,) in units.
        robot: the description with the values that belong to it.
        cost: ½ χ² + ½ zᵀz at the optimum; ``misfit`` is χ² over the number of real data.
        fisher: (n, n) information of the data in z, before any scaling by the misfit.
        starts: where the starts ended, best first. ``agreeing`` of them reached the same minimum. ``rival`` is the cost
            of the best of the others above it, ``None`` when there is none.
        data: number of real data.
        converged: the last step was within tolerance.
        noise_known: the recordings state their variance; else the misfit sets its scale.
    """

    parameters: Parameters
    z: FloatArray
    values: FloatArray
    robot: Robot
    cost: float
    misfit: float
    fisher: FloatArray
    starts: tuple[Start, ...]
    agreeing: int
    data: int
    converged: bool
    noise_known: bool

    rival: float | None

    @property
    def scale(self) -> float:
        """s², by which the variance of the data is multiplied (Birge's ratio): never below 1 where it was measured."""
        return max(1.0, self.misfit) if self.noise_known else self.misfit

    @property
    def told(self) -> str:
        """``4 of 4 starts agree · χ² per datum 1.02``."""
        tried = len(self.starts)
        agree = f"{self.agreeing} of {tried}" if self.agreeing > 1 or tried < 2 else f"no two of {tried}"
        return f"{agree} starts agree · χ² per datum {self.misfit:.{2 if self.misfit < 100 else 0}f}"


# --- the fit ----------------------------------------------------------------------------------------------------------


def coarse(recordings: Sequence[Recorded]) -> Sample:
    """Every eighth line, of short recordings as many as there must be."""
    return Sample(tuple(r.every(max(1, min(EVERY_LINE, len(r.s) // COARSE_LINES))) for r in recordings))


def nearby(recordings: Sequence[Recorded]) -> list[Recorded]:
    """Those of the postures that cover the others best: what the starts work on, springs being those of all."""
    sizes, angles = dict.fromkeys((r.setup.name for r in recordings), 0), {}
    for r in recordings:
        sizes[r.setup.name] += r.frf.size
        angles[r.setup.name] = r.setup.q
    if not many(list(sizes.values())):
        return list(recordings)
    chosen = {list(sizes)[k] for k in covering(list(sizes.values()), np.array(list(angles.values())))}
    return [r for r in recordings if r.setup.name in chosen]


def drawn_starts(parameters: Parameters, starts: int, seed: int) -> Iterator[FloatArray]:
    """Prior coordinates (n,) of each start: the description, then springs and dampers drawn from the prior."""
    rng = np.random.default_rng(seed)
    elastic = np.array([p.kind in ("spring", "entry") for p in parameters])
    for number in range(max(1, starts)):
        z = np.zeros(len(parameters))
        if number:
            z[elastic] = rng.normal(size=np.count_nonzero(elastic))
        yield z


def fit_frf(
    robot: Robot,
    recordings: Sequence[Recorded],
    parameters: Parameters | None = None,
    *,
    starts: int = 4,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Fit:
    """Fit a robot to recordings.

    Args:
        robot: the described robot, whose values are the prior means.
        recordings: what to fit to, from :func:`prepare`.
        parameters: what is free; by default everything of :func:`twin.model.parameters.free_parameters`.
        starts: the first from the description, the others from springs and dampers drawn from the prior.
        seed: of the starts.
        progress: called with 1 after every start and once at the end.
    """
    robot = without_limits(robot)
    if parameters is None:
        parameters = free_parameters(
            robot, dict.fromkeys(r.setup.name for r in recordings), recordings[0].setup.response.label
        )
    chosen = nearby(recordings)
    first = parameters.select(sorted({k for r in chosen for k in parameters.seen_in(r.setup.name)}))
    few = coarse(chosen)
    ends = []
    for z in drawn_starts(first, starts, seed):
        z, *_ = minimise(Objective(robot, first, few, logarithmic=True), z, 25, 0.1, bound=first.bound)
        for temper in FIT_TEMPERS:
            z, *_ = minimise(Objective(robot, first, few, temper), z, 10, 0.1, bound=first.bound)
        z, cost, information, converged = minimise(Objective(robot, first, few), z, 15, 0.05, bound=first.bound)
        ends.append(Start(cost, z, information, converged))
        if progress:
            progress(1)
    ends.sort(key=lambda end: end.cost)
    agreeing, rival = agreement(ends)
    misfit = 2 * ends[0].cost / max(1, _data(few.recordings))
    z = ends[0].z
    if not ends[0].converged:  # as of a model that lacks something: farther on few lines, an eighth of the time
        z, *_ = minimise(Objective(robot, first, few), z, 60, 0.05, bound=first.bound, patience=10)
    known = dict(zip(first.names, z, strict=True))
    z = np.array([known.get(name, 0.0) for name in parameters.names])
    found = _ended(robot, parameters, recordings, z, misfit, (tuple(ends), agreeing, rival))
    if progress:
        progress(1)
    return found


def _ended(
    robot: Robot, parameters: Parameters, recordings: Sequence[Recorded], z: FloatArray, misfit: float,
    starts: tuple[tuple[Start, ...], int, float | None],
) -> Fit:  # fmt: skip
    """The fit on all lines from z (n,), which misses by ``misfit`` or so; ``starts``, how many agree, and the rival."""
    whole, lines = Sample(tuple(recordings)), LINES if len(nearby(recordings)) < len(recordings) else None
    for finer, patience in ((0.1, 10), (1e-3, 4)):  # again from its end: the sag's slopes are of where it began
        objective = Objective(robot, parameters, whole, exact=True, lines=lines)
        z, cost, information, converged = minimise(
            objective, z, 60, finer * max(1.0, misfit), bound=parameters.bound, slack=0.0, patience=patience
        )
    if lines:
        objective.lines = None
        information = objective(z)[2]
    data = _data(recordings)
    values = parameters.values(z)
    return Fit(
        parameters, z, values, parameters.apply(robot, values), cost, (2 * cost - float(z @ z)) / max(data, 1),
        information - np.eye(len(z)), starts[0], starts[1], data, converged, noise_stated(recordings), starts[2],
    )  # fmt: skip


def with_nodes(described: Robot, recordings: Sequence[Recorded], fit: Fit) -> Fit:
    """The fit with nodes and directions of all sensors and blows free within their tolerances.

    They belong to the recordings, like angles of postures. It is the fit as it was where that has no less evidence, or
    where they would be farther off than tolerances allow: they stand for something that the model lacks.

    Args:
        described: the description that was fitted, whose values are the prior means.
        recordings: what was fitted to, their nodes as stated.
    """
    own, setup = list[Parameter](), recordings[0].setup
    sides: tuple[tuple[Channels, Side], ...] = (setup.response, "response"), (setup.excitation, "excitation")
    for channels, side in sides:
        own += point_parameters(described, channels, side) + direction_parameters(described, channels, side)
    own = [p for p in own if p.deviation > 0]
    if not own:
        return fit
    robot, parameters = without_limits(described), join(fit.parameters, independent(own))
    most = STATED**2 * 2 * gammaincinv(len(own) / 2, 1 - RARE)

    def allowed(z: FloatArray) -> bool:
        return bool(np.sum(z[len(fit.z) :] ** 2) <= most)

    z = np.concatenate([fit.z, np.zeros(len(own))])
    z, *_ = minimise(Objective(robot, parameters, coarse(nearby(recordings))), z, 30, 0.1, bound=parameters.bound)
    if not allowed(z):
        return fit
    found = _ended(robot, parameters, recordings, z, 1.0, (fit.starts, fit.agreeing, fit.rival))
    return found if allowed(found.z) and _energy(found) < _energy(fit) else fit


def _energy(fit: Fit) -> float:
    """Less the logarithm of a fit's evidence (Laplace)."""
    return fit.cost + 0.5 * float(np.linalg.slogdet(fit.fisher + np.eye(len(fit.z)))[1])


def agreement(starts: Sequence[Start]) -> tuple[int, float | None]:
    """How many of some starts, best first, reached the minimum of the best; and the cost of the best rival above it."""
    best, count, rival = starts[0], 0, None
    for start in starts:
        away = start.z - best.z
        apart = max(start.cost - best.cost, 0.5 * float(away @ best.information @ away))
        if apart < AGREEMENT or np.abs(away).max(initial=0.0) < SAME_END:
            count += 1
        elif rival is None:
            rival = start.cost - best.cost
    return count, rival


def _data(recordings: Sequence[Recorded]) -> int:
    """Number of real data."""
    return 2 * sum(int(np.isfinite(r.variance).sum()) for r in recordings)
