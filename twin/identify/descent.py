"""The one descent of every nonlinear fit: Gauss–Newton within a trust region, in prior coordinates."""

import numpy as np

from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters

LARGEST_STEP = 5.0  # length of the first step, in prior deviations
TURN = 0.75  # of a step: its longest correction for the bend
STRAIGHT = 0.02  # of a step: a bend that corrects less is not asked for again,
KEPT = 0.9  # while steps keep so much of what they promise
HOPE = 5.0  # times the expected gain: more is not hoped for
SLACK = 0.003  # of the misfit beyond noise: gains below it are not waited for
LACKING = 10.0  # χ² per datum: a model that misses by more lacks something, whatever its numbers
ASTRAY = 100.0  # times the variance of noise: from here on nothing that a fit says of its numbers holds
PIVOTS = 10  # of all at once that may leave as many on the wrong side; as Júdice and Pires
SHORTENED = 100  # steps in turn that raise a cost: one is shorter than ``SHORTEST`` long before
SHORTEST = 1e-6  # of a step, in prior deviations: less is rounding
CRAWL = 3e-4  # of the misfit beyond that: a step that gains less hardly moves


class Descended:
    """A cost over prior coordinates z (n,) that :func:`minimise` descends.

    Attributes:
        free: the parameters that z stands for.
        bends: whether :meth:`bend` will be asked for; what it needs is then kept.
        setbacks: steps in turn, each a quarter of the last, that may raise the cost before the descent ends.
    """

    free: Parameters
    bends: bool = True
    setbacks: int = SHORTENED

    @property
    def data(self) -> float:
        """Number of real data."""
        raise NotImplementedError

    def __call__(self, z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient (n,) and Gauss–Newton matrix (n, n), prior included."""
        raise NotImplementedError

    def cost(self, z: FloatArray) -> float:
        """Prior included; infinite where nothing can be evaluated."""
        return self(z)[0]

    def bend(self, z: FloatArray, step: FloatArray) -> FloatArray | None:
        """Gᵀ ∂²e/∂step² (n,) of the residual e at z, where the cost was evaluated last; ``None`` if it is not known."""
        return None


def minimise(
    objective: Descended,
    z: FloatArray,
    iterations: int,
    tolerance: float,
    hopeless: float = np.inf,
    *,
    bound: FloatArray | None = None,
    slack: float = SLACK,
    reach: float = LARGEST_STEP,
    patience: int | None = None,
) -> tuple[FloatArray, float, FloatArray, bool]:
    """Gauss–Newton within a trust region in prior coordinates (Moré's step), following the bend of its valley.

    The bend is taken by geodesic acceleration (Transtrum and Sethna, arXiv:1201.5885). The results are z, cost,
    Gauss–Newton matrix, and whether the expected gain fell below ``tolerance``, or below a share ``slack`` of the
    misfit beyond noise. Where that misfit is large, the model lacks something. With ``bound`` (n,) z stays within |z| ≤
    bound.

    The descent is given up where ``HOPE`` times the expected gain does not bring the cost below ``hopeless``. With
    ``patience``, it is also given up where so many steps in turn gained less than ``CRAWL`` each, in the mean. That
    happens along the valley of a model that is ``LACKING``.

    The region is a ball in the prior's metric. So parameters that the data hardly determine (the logarithm of a damper
    near zero) hold steps back, and their part is shortened. Directions that the data determine well are left to Newton.
    The curvature of value = mean · eˣ itself, ∂²/∂x² = ∂/∂x, is added where it is positive. The region grows as long as
    the model keeps its promises: one that lacks something can want a nuisance at twenty prior deviations. It begins
    with the radius ``reach``.
    """
    data, bent = objective.data, True
    objective.bends = bound is None
    log = np.array([p.log for p in objective.free]) * np.diag(objective.free.root)
    cost, gradient, information = objective(z)
    costs = [cost]
    for _ in range(iterations):
        if not (np.isfinite(cost) and np.isfinite(information).all()):
            return z, np.inf, np.eye(len(z)), False
        expected = _expected(gradient, information, z, bound)
        if expected < max(tolerance, slack * (cost - 0.55 * data)):
            return z, cost, information, True
        if cost - HOPE * expected > hopeless:
            return z, cost, information, False
        least = CRAWL * (cost - 0.5 * LACKING * data)
        if patience and len(costs) > patience and costs[-1 - patience] - cost < patience * least:
            return z, cost, information, False
        slope = objective.free.along(z, gradient)
        curvature, axes = np.linalg.eigh(information + np.diag(np.maximum(log * (slope - z), 0)))
        along = axes.T @ gradient
        for _ in range(objective.setbacks):
            step, damping = _within(reach, curvature, axes, along)
            if bound is not None:
                bowl = axes @ ((curvature + damping)[:, None] * axes.T)
                step = bounded_step(gradient, bowl, z, bound)
            bend = objective.bend(z, step) if bent and bound is None else None
            if bend is not None:
                turn = -0.5 * axes @ ((axes.T @ bend) / (curvature + damping))
                bent = bool(np.linalg.norm(turn) > STRAIGHT * np.linalg.norm(step))
                if np.linalg.norm(turn) < TURN * np.linalg.norm(step):
                    step = step + turn
            end = objective.free.moved(z, step)
            trial = objective.cost(end)
            promised = -float(gradient @ step) - 0.5 * float(step @ information @ step)
            if np.isfinite(trial) and trial < cost:
                break
            reach, bent = 0.25 * min(reach, float(np.linalg.norm(step))), True
            if reach < SHORTEST:
                return z, cost, information, False
        else:
            return z, cost, information, False
        kept = (cost - trial) / max(promised, 1e-300)
        bent = bent or not KEPT < kept < 1 / KEPT
        if kept < 0.25:
            reach = 0.5 * float(np.linalg.norm(step))
        elif kept > 0.75 and damping > 0:
            reach *= 3
        z = end
        cost, gradient, information = objective(z)
        costs.append(cost)
    return z, cost, information, False


def _expected(gradient: FloatArray, information: FloatArray, z: FloatArray, bound: FloatArray | None) -> float:
    """By how much a whole Gauss–Newton step is expected to lower the cost."""
    if bound is None:
        return 0.5 * float(gradient @ np.linalg.solve(information, gradient))
    step = bounded_step(gradient, information, z, bound)
    return -float(step @ gradient + 0.5 * step @ information @ step)


def _within(reach: float, curvature: FloatArray, axes: FloatArray, along: FloatArray) -> tuple[FloatArray, float]:
    """The step of a quadratic model that is not longer than ``reach``, and the damping that keeps it so.

    Args:
        curvature, axes: eigenvalues (n,) and vectors (n, n); ``along`` (n,) the gradient on these axes.
    """
    damping = 0.0
    for _ in range(30):
        step = -along / (curvature + damping)
        length = float(np.linalg.norm(step))
        if length <= 1.1 * reach:
            break
        slope = -float(np.sum(step**2 / (curvature + damping))) / length
        damping -= (length / reach) * (length - reach) / slope  # Newton on 1/length, which is nearly linear
    return axes @ step, damping


def bounded_step(gradient: FloatArray, curvature: FloatArray, z: FloatArray, bound: FloatArray | float) -> FloatArray:
    """The step (n,) that minimises gradientᵀ s + ½ sᵀ curvature s within |z + s| ≤ bound.

    Block principal pivoting (Júdice and Pires, Computers and Operations Research 21, 587, 1994): coordinates that leave
    the box go to its faces. Those that a face holds back let go of it. All change at once, or the last alone where that
    has not helped.
    """
    bound = np.broadcast_to(bound, z.shape)
    low, high = -bound - z, bound - z
    face = np.where((np.abs(z) >= bound) & (gradient * z < 0), np.sign(z), 0)
    fewest, tries, least = len(z) + 1, PIVOTS, 1e-12 * float(np.abs(gradient).max(initial=0.0))
    for _ in range(4 * len(z)):
        free = face == 0
        step = np.where(free, 0.0, np.where(face > 0, high, low))
        if free.any():
            pull = gradient[free] + curvature[np.ix_(free, ~free)] @ step[~free]
            step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], pull)
        slope = gradient + curvature @ step
        leaves = (step > high + 1e-12).astype(int) - (step < low - 1e-12)
        turned = np.flatnonzero(np.where(free, leaves, slope * face > least))
        if not len(turned):
            break
        fewest, tries = (len(turned), PIVOTS) if len(turned) < fewest else (fewest, tries - 1)
        if tries < 0:
            turned = turned[-1:]
        face[turned] = np.where(free, leaves, 0)[turned]
    return np.asarray(np.clip(step, low, high))
