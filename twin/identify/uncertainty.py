"""What a fit's data say and what its prior says: intervals, combinations, correlation, profiles, drift.

In z the prior is the standard normal, so the posterior covariance is (F/s² + 1)⁻¹ with F the Fisher information of the
data. s² ≥ 1 is the misfit χ² per datum (Birge's ratio): a model that misses the data by more than their noise does not
earn the noise's intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from twin.identify.elastic import Fit
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, Parameters
from twin.model.recorded import Recorded, without_limits
from twin.robot.description import Robot

HELD = 0.5  # posterior over prior deviation below which the data hold a parameter
SHARP = 0.35  # and, of a scale, the largest deviation of its logarithm
NOTHING = 1e-4  # share of a prior's deviation: what takes less off it tells nothing of the number
LARGE_DRIFT = 3.0  # prior deviations
DECADE = 10.0  # an interval wider than this is gone through by ratios
NINETY = float(ndtri(0.95))


@dataclass(frozen=True)
class Estimate:
    """One parameter after the fit.

    Attributes:
        value: in ``parameter.unit``; ``interval90`` its 5 % and 95 % quantiles.
        deviation: posterior standard deviation of x (of ln value, where the prior is log-normal).
        share: of the prior's variance that the data removed, 0 to 1.
        identifiable: the data hold it; where they do not, value and interval are mostly the prior's.
        drift: distance from the prior mean in prior deviations.
    """

    parameter: Parameter
    value: float
    interval90: tuple[float, float]
    deviation: float
    share: float
    identifiable: bool
    drift: float


@dataclass(frozen=True)
class Combination:
    """A combination of ln-parameters and how much of it is data: share 1 data, 0 prior; weights sum squared to 1."""

    share: float
    weights: dict[str, float]


def posterior(fit: Fit) -> FloatArray:
    """Posterior covariance of x (n, n)."""
    root = fit.parameters.root
    covariance = root @ np.linalg.inv(fit.fisher / fit.scale + np.eye(len(fit.z))) @ root.T
    return np.asarray(0.5 * (covariance + covariance.T))


def estimates(fit: Fit) -> list[Estimate]:
    """Every parameter with interval, share of the data, and drift."""
    covariance = posterior(fit)
    x = fit.parameters.root @ fit.z
    prior = np.sqrt(np.diag(fit.parameters.covariance))
    found = []
    for k, parameter in enumerate(fit.parameters):
        deviation = float(np.sqrt(covariance[k, k]))
        ratio = deviation / prior[k]
        held = bool(ratio < HELD) and (not parameter.log or deviation < SHARP)
        ends = interval(parameter, *beside_prior(fit.parameters, fit.z, covariance, k))
        drift = float(x[k] / prior[k])
        found.append(Estimate(parameter, float(fit.values[k]), ends, deviation, float(1 - ratio**2), held, drift))
    return found


def beside_prior(
    parameters: Parameters, z: FloatArray, covariance: FloatArray, k: int
) -> tuple[float, float, float, float]:
    """x of a number at the optimum z (n,), its posterior deviation, and slope and curvature of the prior there.

    The prior is ½ zᵀz where that x moves and all others follow it as the posterior ``covariance`` (n, n) of x has them.
    """
    follow = np.linalg.solve(parameters.root, covariance[:, k] / covariance[k, k])
    return float(parameters.root[k] @ z), float(np.sqrt(covariance[k, k])), float(follow @ z), float(follow @ follow)


def interval(parameter: Parameter, x: float, deviation: float, slope: float, held: float) -> tuple[float, float]:
    """5 % and 95 % quantiles of a value, from x, its posterior deviation, and slope and curvature of its prior there.

    A mass or a damper enters M or C linearly, so the data's likelihood is normal in the value, not in its logarithm.
    Where the data only know that a damper is small, the prior closes its interval from below. Springs are in series:
    FRFs are linear in the compliance. A fit may have ended where data and prior do not balance, far above the prior of
    a number it hardly shows. That contradicts this: then x is normal.
    """
    ends = x - NINETY * deviation, x + NINETY * deviation
    normal = float(parameter.value(ends[0])), float(parameter.value(ends[1]))
    prior = 1 / np.sqrt(held)
    nothing = deviation > (1 - NOTHING) * prior  # where a misfit is scaled up no slopes cancel: the prior is left
    if not parameter.log or deviation < 0.02 or nothing:
        return normal
    information = max(1 / deviation**2 - held, 1e-12)  # of the data about x, at the optimum
    reach = 10 * deviation if deviation < prior / 10 else 8 * prior
    moved = np.linspace(-reach, reach, 4001)
    turn = parameter.linear_power
    ratio = np.exp(turn * moved)  # of what enters linearly, over the fitted one
    likeliest = 1 + turn * slope / information  # of the data alone: there the two slopes cancel at the optimum
    energy = (
        0.5 * information * ((ratio - likeliest) ** 2 - (1 - likeliest) ** 2) + (slope + 0.5 * held * moved) * moved
    )
    density = np.exp(-(energy - energy.min()))
    low, high = np.interp([0.05, 0.95], (np.cumsum(density) - 0.5 * density) / density.sum(), moved)
    if turn * slope > 0 and not low < 0 < high:
        return normal
    return float(parameter.value(x + low)), float(parameter.value(x + high))


def combinations(fit: Fit, kinds: Sequence[str] = ("spring", "entry")) -> list[Combination]:
    """Which combinations of springs and dampers the data hold, the other parameters free under their priors.

    Eigenvectors of the prior-whitened marginal information, best held first.
    """
    covariance = posterior(fit)
    keep = [k for k, parameter in enumerate(fit.parameters) if parameter.kind in kinds]
    if not keep:
        return []
    prior = np.sqrt(np.diag(fit.parameters.covariance))[keep]
    whitened = covariance[np.ix_(keep, keep)] / np.outer(prior, prior)
    variance, vectors = np.linalg.eigh(whitened)
    found = []
    for value, vector in zip(variance, vectors.T, strict=True):
        vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
        weights = {fit.parameters.names[k]: float(w) for k, w in zip(keep, vector, strict=True)}
        found.append(Combination(float(1 - min(value, 1.0)), weights))
    return found


def correlation(fit: Fit) -> FloatArray:
    """Posterior correlation (n, n)."""
    covariance = posterior(fit)
    deviation = np.sqrt(np.diag(covariance))
    return covariance / np.outer(deviation, deviation)


def profile(
    robot: Robot, recordings: Sequence[Recorded], fit: Fit, estimate: Estimate, points: int = 9
) -> tuple[FloatArray, FloatArray]:
    """Profile of one parameter: values (points,) and 2Δ of posterior cost with everything else refitted.

    At each value the exact cost, less what one Gauss–Newton step of all other parameters takes off; over s², as are the
    intervals. The minimum is the lowest cost seen: a fit that was stopped early may not have reached it.
    """
    parameter = estimate.parameter
    index = fit.parameters.names.index(parameter.name)
    low, high = estimate.interval90
    objective = Objective(without_limits(robot), fit.parameters, Sample(tuple(recordings)), exact=True)
    direction = fit.parameters.root[index]  # of x in z
    alone = np.linalg.inv(fit.parameters.root)[:, index]  # moves x and no other
    along = np.linalg.solve(fit.fisher + np.eye(len(fit.z)), direction)  # moves x and the others' optimum with it
    along /= direction @ along
    across = np.linalg.svd(direction[None])[2][1:].T
    least = low - 0.4 * (high - low)
    value = np.linspace(max(least, 0.3 * low) if parameter.log else least, high + 0.4 * (high - low), points)
    if parameter.log and high > DECADE * low:
        value = np.geomspace(0.3 * low, 3 * high, points)
    cost = np.empty(points)
    for k, v in enumerate(value):
        # a scale enters M, C and K linearly: the others follow its value, not its logarithm
        move = v / estimate.value - 1 if parameter.log else v - estimate.value
        x = np.log(v / parameter.mean) if parameter.log else v - parameter.mean
        cost[k], gradient, information = objective(fit.z + along * move + alone * (x - direction @ fit.z - move))
        pull = across.T @ gradient
        cost[k] -= 0.5 * pull @ np.linalg.solve(across.T @ information @ across, pull)
    return value, np.asarray(2 * (cost - min(fit.cost, cost.min())) / fit.scale)
