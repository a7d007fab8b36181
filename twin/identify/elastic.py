"""Joint stiffness and damping from measured FRFs or modal tables, by maximum posterior probability.

Minimised over z, in which the prior is the standard normal, is ½ Σ |H − H(z)|²/σ² + ½ zᵀz, with σ² the measured
variance per real and imaginary part. Model tolerances (masses, centres of mass, inertias, posture angles, channel
gains) are free under their priors. From afar a linear residual has false minima wherever peaks do not overlap: every
start goes through the robust residual of the complex logarithm first, then a linear one whose tolerance shrinks, on
every eighth line; the best ends on all lines.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.identify.residual import pull, weights
from twin.measure.campaign import (
    QUANTITIES,
    Campaign,
    ComplexArray,
    FloatArray,
    PostureFRF,
    dead_channels,
    frf_variance,
    laplace,
)
from twin.model.parameters import Parameters, free_parameters
from twin.model.sensitivity import (
    Observed,
    Setup,
    contract,
    frf,
    frf_slopes,
    moving,
    observe,
    observe_all,
    sag_slopes,
    slopes,
)
from twin.robot.description import Robot

COARSE = 8  # starts see every eighth line, and at least COARSE_LINES
COARSE_LINES = 25
TEMPERS = (0.1, 0.01)  # relative model error assumed on the way from logarithmic to linear residual
UNKNOWN_NOISE = 0.02  # of a channel's RMS: variance where the recording states none; the fit then scales it
LIMIT_SLACK = 0.02  # rad (m): an encoder's zero is not that of the limits
LARGEST_STEP = 2.0  # in prior deviations
LEAST_DAMPING = 0.1  # of a step that did not lower the cost
LEAST_FALL = 0.2  # of the damping, after a step that did as expected
AGREEMENT = 4.0  # starts agree whose costs differ by less (2Δ = 8), by themselves and in the best one's quadratic model

Objective = Callable[[FloatArray], tuple[float, FloatArray, FloatArray]]
"""z (n,) → cost, gradient (n,), Gauss–Newton matrix (n, n), prior included."""


@dataclass(frozen=True)
class Recorded:
    """FRFs of one posture and force level as the fit uses them.

    Attributes:
        group: name of the recording's group; ``setup.name`` is the posture's, without the force level.
        s: (nf,) Laplace points; ``power`` of s in the quantity over receptance.
        frf: (nf, nr, ne), SI per newton.
        variance: (nf, nr, ne) of real and imaginary part; infinite where a line is not used.
        stated: the variance is the recording's; where it states none, a share of the channel's RMS.
    """

    group: str
    setup: Setup
    frequency: FloatArray
    s: ComplexArray
    power: int
    frf: ComplexArray
    variance: FloatArray
    stated: bool

    def every(self, step: int) -> "Recorded":
        """Every ``step``-th line."""
        keep = slice(step // 2, None, step)
        return replace(
            self, frequency=self.frequency[keep], s=self.s[keep], frf=self.frf[keep], variance=self.variance[keep]
        )


@dataclass(frozen=True)
class Start:
    """Where one start ended: its cost on the coarse lines, its z, and the Gauss–Newton matrix there."""

    cost: float
    z: FloatArray
    information: FloatArray


@dataclass(frozen=True)
class Fit:
    """A maximum-posterior fit.

    Attributes:
        parameters: the free numbers and their prior.
        z: (n,) optimum in prior coordinates, ``values`` (n,) in units.
        robot: the description with the values that belong to it.
        cost: ½ χ² + ½ zᵀz at the optimum; ``misfit`` is χ² over the number of real data.
        fisher: (n, n) information of the data in z, before any scaling by the misfit.
        starts: where the starts ended, best first; ``agreeing`` of them reached the same minimum, and ``rival`` is the
            cost of the best of the others above it, ``None`` when there is none.
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


# --- recordings -------------------------------------------------------------------------------------------------------


def base_name(campaign: Campaign, group: str) -> str:
    """Name of a posture without its force level: the first group with the same angles, up to ``@``."""
    q = campaign.postures[group].q_deg
    first = next(name for name, posture in campaign.postures.items() if np.array_equal(posture.q_deg, q))
    return first.partition("@")[0]


def prepare(
    campaign: Campaign, robot: Robot, source: str = "recording", band_hz: tuple[float, float] | None = None
) -> dict[str, Recorded]:
    """The groups of a campaign as the fit uses them.

    Raises:
        InputError: channels on bodies the robot does not have, or postures it cannot take.
    """
    _check_bodies(campaign, robot, source)
    found = {}
    for name, posture in campaign.postures.items():
        q = recorded_posture(robot, posture.q_deg, source, f"postures/{name}: q_deg")
        setup = Setup(base_name(campaign, name), q, posture.brakes, campaign.response, campaign.excitation)
        low, high = band_hz or (0.0, np.inf)
        lines = (posture.frequency > 0) & (posture.frequency >= low) & (posture.frequency <= high)
        if np.count_nonzero(lines) < 2:
            raise InputError(source, f"postures/{name}/frequency", f"no lines from {low:g} to {high:g} Hz")
        variance, stated = measured_variance(posture)
        found[name] = Recorded(
            name, setup, posture.frequency[lines],
            laplace(posture.frequency[lines], posture.exponential_window_rate),
            QUANTITIES.index(posture.quantity), posture.frf[lines], variance[lines], stated,
        )  # fmt: skip
    return found


def recorded_posture(robot: Robot, q_deg: FloatArray, source: str, field: str) -> FloatArray:
    """Joint positions (n,), rad (m), of a recording; no more than ``LIMIT_SLACK`` beyond the axes' limits.

    Raises:
        InputError: positions this robot cannot take, as when their sign or unit is another.
    """
    if q_deg.size != robot.axis_count:
        raise InputError(
            source, field, f"expected {robot.axis_count} values for robot {robot.name}, found {q_deg.size}"
        )
    q = np.asarray(robot.angles(q_deg))
    near = within_limits(robot, q)
    robot.check_posture(np.where(np.abs(q - near) <= LIMIT_SLACK, near, q), source, field)
    return q


def measured_variance(posture: PostureFRF) -> tuple[FloatArray, bool]:
    """Variance (nf, nr, ne) of real and imaginary part, and whether the recording states it.

    From coherence and averages; without them, a share of the channel's RMS.
    """
    variance = frf_variance(posture)
    if variance is not None:
        return variance, True
    power = np.mean(np.abs(posture.frf) ** 2, axis=0)
    variance = np.broadcast_to(UNKNOWN_NOISE**2 * power, posture.frf.shape).copy()
    variance[:, dead_channels(posture)] = np.inf
    return variance, False


def noise_stated(recordings: Sequence[Recorded]) -> bool:
    """Every recording states its variance."""
    return all(r.stated for r in recordings)


def _check_bodies(campaign: Campaign, robot: Robot, source: str) -> None:
    bodies = {"base", *(f"link{i + 1}" for i in range(robot.axis_count))}
    for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
        for label, body in zip(channels.label, channels.body, strict=True):
            if body not in bodies:
                raise InputError(
                    source,
                    f"{side}/body",
                    f"{label} is on {body!r}; {robot.name} has base, link1 … {sorted(bodies)[-1]}",
                )


# --- residuals --------------------------------------------------------------------------------------------------------


def model_frf(robot: Robot, recorded: Recorded, parameters: Parameters, values: FloatArray) -> ComplexArray:
    """Predicted FRFs (nf, nr, ne) at parameter values; ``robot`` is the description before they are applied."""
    seen, _ = observe(parameters.apply(robot, values), recorded.setup, parameters, values)
    return frf(seen, recorded.s, recorded.power)


def linear_objective(
    robot: Robot, parameters: Parameters, recordings: Sequence[Recorded], temper: float = 0.0, exact: bool = False
) -> Objective:
    """½ Σ |H − H(z)|²/(σ² + (temper |H|)²) + ½ zᵀz; ``exact`` where the last digits of the optimum count."""
    return _objective(robot, parameters, recordings, temper, False, exact)


def log_objective(robot: Robot, parameters: Parameters, recordings: Sequence[Recorded]) -> Objective:
    """The robust sum of logarithms, see :mod:`twin.identify.residual`."""
    return _objective(robot, parameters, recordings, 0.0, True)


def _objective(
    robot: Robot,
    parameters: Parameters,
    recordings: Sequence[Recorded],
    temper: float,
    logarithmic: bool,
    exact: bool = False,
) -> Objective:
    weight = [weights(r.frf, r.variance, temper, logarithmic) for r in recordings]
    setups = {(r.setup.name, r.setup.q.tobytes(), r.setup.brakes): r.setup for r in recordings}
    slow: dict[tuple[str, bytes, str | None], Observed] = {}  # what sag adds to the slopes, from the first evaluation

    def evaluate(z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        values = parameters.values(z)
        changed = parameters.apply(robot, values)
        transform = parameters.transform(values)
        cost, gradient, information = 0.5 * float(z @ z), z.copy(), np.eye(len(z))
        changes: dict[tuple[Any, ...], Any] = {}
        found = {}
        models = observe_all(changed, list(setups.values()), parameters, values)
        for (key, setup), (seen, model) in zip(setups.items(), models, strict=True):
            some = np.array(parameters.seen_in(setup.name))
            rate = slopes(changed, setup, parameters, values, seen, model, changes, some)
            if exact:
                if key not in slow:
                    slow[key] = sag_slopes(changed, setup, parameters, values, model)
                rate = Observed.of(a + b[some] for a, b in zip(rate.arrays(), slow[key].arrays(), strict=True))
            columns = np.flatnonzero(transform[some].any(axis=0))
            rate = contract(rate, transform[np.ix_(some, columns)])
            felt = moving(rate)
            found[key] = seen, Observed.of(array[felt] for array in rate.arrays()), columns[felt]
        for k, r in enumerate(recordings):
            seen, rate, moves = found[r.setup.name, r.setup.q.tobytes(), r.setup.brakes]
            H, dH = frf_slopes(seen, rate, r.s, r.power)
            own, pulled, factor = pull(r.frf, H, weight[k], logarithmic)
            cost += own
            G = np.multiply(dH, factor, order="C").reshape(len(moves), -1).view(float)
            gradient[moves] += G @ np.ascontiguousarray(pulled).reshape(-1).view(float)
            information[np.ix_(moves, moves)] += G @ G.T
        return cost, gradient, information

    return evaluate


def minimise(
    objective: Objective,
    z: FloatArray,
    iterations: int = 30,
    tolerance: float = 1e-3,
    bound: FloatArray | float = np.inf,
) -> tuple[FloatArray, float, FloatArray, bool]:
    """Levenberg's damped Gauss–Newton within |z| ≤ bound; the damping is in the prior's metric, the identity in z.

    It follows the ratio of the cost's fall to the expected one (Nielsen, IMM-REP-1999-05): narrow curved valleys, in
    which tenfold steps of damping crawl, are what several parameters of almost the same effect make.

    Returns:
        z, cost and Gauss–Newton matrix at the end; and whether the gain left is below tolerance.
    """
    damping, growth = 0.0, 2.0
    cost, gradient, information = objective(z)
    for _ in range(iterations):
        step = bounded_step(gradient, information, z, bound)
        gain = -float(step @ gradient + 0.5 * step @ information @ step)
        if gain < tolerance:
            return z, cost, information, True
        while True:
            if damping:
                step = bounded_step(gradient, information + damping * np.eye(len(z)), z, bound)
            step = step * min(1.0, LARGEST_STEP / float(np.abs(step).max()))
            trial = objective(z + step)
            if np.isfinite(trial[0]) and trial[0] < cost:
                break
            damping, growth = max(growth * damping, LEAST_DAMPING), 2 * growth
            if damping > LEAST_DAMPING * 1e12:
                return z, cost, information, gain < 10 * tolerance
        ratio = (trial[0] - cost) / float(step @ gradient + 0.5 * step @ information @ step)
        damping, growth = damping * max(LEAST_FALL, 1 - (2 * min(ratio, 1.0) - 1) ** 3), 2.0
        if damping < LEAST_DAMPING / 2:
            damping = 0.0
        z, (cost, gradient, information) = z + step, trial
    return z, cost, information, False


def bounded_step(gradient: FloatArray, curvature: FloatArray, z: FloatArray, bound: FloatArray | float) -> FloatArray:
    """Step (n,) of Newton's method on the faces of the box |z| ≤ bound that it reaches.

    A coordinate that would leave the box stops at its face and the others are solved for again: clipping alone can
    point uphill.
    """
    step = np.zeros_like(z)
    free = ~((np.abs(z) >= bound) & (gradient * z < 0))
    while free.any():
        held = curvature[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], gradient[free] + held)
        beyond = free & (np.abs(z + step) > bound)
        if not beyond.any():
            break
        step = np.where(beyond, np.clip(z + step, -bound, bound) - z, step)
        free &= ~beyond
    return step


# --- the fit ----------------------------------------------------------------------------------------------------------


def coarse(recordings: Sequence[Recorded]) -> list[Recorded]:
    """Every eighth line, of short recordings as many as there must be."""
    return [r.every(max(1, min(COARSE, len(r.s) // COARSE_LINES))) for r in recordings]


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
    few, bound = coarse(recordings), parameters.bound
    rng = np.random.default_rng(seed)
    elastic = np.array([p.kind in ("spring", "entry") for p in parameters])
    ends = []
    for number in range(max(1, starts)):
        z = np.zeros(len(parameters))
        if number:
            z[elastic] = rng.normal(size=np.count_nonzero(elastic))
        z, *_ = minimise(log_objective(robot, parameters, few), z, 25, 0.1, bound)
        for temper in TEMPERS:
            z, *_ = minimise(linear_objective(robot, parameters, few, temper), z, 10, 0.1, bound)
        z, cost, information, _ = minimise(linear_objective(robot, parameters, few), z, 15, 0.05, bound)
        ends.append(Start(cost, z, information))
        if progress:
            progress(1)
    ends.sort(key=lambda end: end.cost)
    agreeing, rival = agreement(ends)
    objective = linear_objective(robot, parameters, recordings, exact=True)
    misfit = 2 * ends[0].cost / max(1, _data(few))
    z, cost, information, converged = minimise(objective, ends[0].z, 60, 1e-3 * max(1.0, misfit), bound)
    if progress:
        progress(1)
    data = _data(recordings)
    values = parameters.values(z)
    return Fit(
        parameters, z, values, parameters.apply(robot, values), cost, (2 * cost - float(z @ z)) / max(data, 1),
        information - np.eye(len(z)), tuple(ends), agreeing, data, converged, noise_stated(recordings),
        rival,
    )  # fmt: skip


def agreement(starts: Sequence[Start]) -> tuple[int, float | None]:
    """How many of some starts, best first, reached the minimum of the best; and the cost of the best rival above it."""
    best, count, rival = starts[0], 0, None
    for start in starts:
        away = start.z - best.z
        if max(start.cost - best.cost, 0.5 * float(away @ best.information @ away)) < AGREEMENT:
            count += 1
        elif rival is None:
            rival = start.cost - best.cost
    return count, rival


def _data(recordings: Sequence[Recorded]) -> int:
    """Number of real data."""
    return 2 * sum(int(np.isfinite(r.variance).sum()) for r in recordings)


def within_limits(robot: Robot, q: FloatArray) -> FloatArray:
    """Joint positions (n,) moved to the nearest within the axes' limits."""
    limits = [axis.limits.position if axis.limits else None for axis in robot.axes]
    return np.array(
        [value if limit is None else np.clip(value, *limit) for value, limit in zip(q, limits, strict=True)]
    )


def without_limits(robot: Robot) -> Robot:
    """A copy whose angles may leave their limits: the error of a posture at a limit is free to either side."""
    return robot.model_copy(update={"axes": [axis.model_copy(update={"limits": None}) for axis in robot.axes]})
