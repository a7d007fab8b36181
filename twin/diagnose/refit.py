"""Fits of a hypothesis: continuation from a robust logarithmic residual to the linear one, and Laplace's evidence.

With the prior standard normal in z, ln p(data) = −cost − ½ ln det(F + 1) up to a constant common to all hypotheses on
the same data (MacKay, Information Theory, Inference and Learning Algorithms, chapter 28). A parameter the data do not
hold costs nothing; one they hold costs the ratio of its posterior to its prior width.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.objective import Objective, Sample
from twin.identify.elastic import Recorded
from twin.identify.parameters import Parameters, recording_parameters
from twin.measure.campaign import FloatArray
from twin.robot.description import Robot

NONE = Hypothesis("none", "")
LARGEST_STEP = 2.0  # in prior deviations
TEMPERS = (0.1, 0.02)  # relative model error assumed on the way from logarithmic to linear residual


@dataclass(frozen=True)
class Fitted:
    """A hypothesis at its optimum.

    Attributes:
        parameters: free numbers; ``z`` (n,) the optimum in prior coordinates, ``values`` (n,) in units.
        robot: the description with the values that belong to it.
        cost: ½ χ² + ½ zᵀz; ``misfit`` is χ² over the number of real data.
        information: (n, n) Gauss–Newton matrix, prior included.
        data: number of real data.
        converged: the expected gain of the next step was within tolerance.
    """

    hypothesis: Hypothesis
    parameters: Parameters
    z: FloatArray
    values: FloatArray
    robot: Robot
    cost: float
    misfit: float
    information: FloatArray
    data: int
    converged: bool

    def evidence(self, scale: float = 1.0) -> float:
        """Logarithm of the evidence with the data's variance multiplied by ``scale`` (Birge's ratio)."""
        chi2 = self.misfit * self.data
        eye = np.eye(len(self.z))
        information = (self.information - eye) / scale + eye
        return float(-0.5 * (chi2 / scale + self.z @ self.z) - 0.5 * np.linalg.slogdet(information)[1])

    @property
    def own(self) -> list[int]:
        """Indices of the hypothesis' own parameters."""
        return list(range(len(self.parameters) - len(self.hypothesis.own), len(self.parameters)))


def minimise(objective: Objective, z: FloatArray, iterations: int, tolerance: float) -> tuple[
    FloatArray, float, FloatArray, bool
]:  # fmt: skip
    """Levenberg's method in prior coordinates: z, cost, Gauss–Newton matrix, and whether the expected gain fell below
    ``tolerance``.

    Damping is by the identity, the prior's metric: what holds steps back are parameters that the data hardly hold (the
    logarithm of a damper near zero), and those it shortens; directions the data hold well are left to Newton. The
    curvature of value = mean · eˣ itself, ∂²/∂x² = ∂/∂x, is added where it is positive.
    """
    damping = 1.0
    log = np.array([p.log for p in objective.parameters]) * np.diag(objective.parameters.root)
    cost, gradient, information = objective(z)
    for _ in range(iterations):
        if 0.5 * float(gradient @ np.linalg.solve(information, gradient)) < tolerance:
            return z, cost, information, True
        while True:
            bent = np.diag(damping + np.maximum(log * (gradient - z), 0))
            step = -np.linalg.solve(information + bent, gradient)
            step *= min(1.0, LARGEST_STEP / float(np.abs(step).max()))
            trial = objective.cost(z + step)
            if np.isfinite(trial) and trial < cost:
                break
            damping *= 8
            if damping > 1e9:
                return z, cost, information, False
        promised = -float(gradient @ step) - 0.5 * float(step @ information @ step)
        damping *= 1 / 8 if cost - trial > 0.5 * promised else 2
        damping = max(damping, 1e-3)
        z = z + step
        cost, gradient, information = objective(z)
    return z, cost, information, False


def descend(
    base: Robot,
    hypothesis: Hypothesis,
    parameters: Parameters,
    sample: Sample,
    z: FloatArray,
    *,
    logarithmic: int = 0,
    tempered: int = 8,
    linear: int = 20,
    tolerance: float = 0.05,
) -> Fitted:
    """Fit a hypothesis from z; the numbers are the largest iterations on each kind of residual."""
    robot = hypothesis.robot(base)
    if logarithmic:
        z, *_ = minimise(Objective(robot, parameters, sample, logarithmic=True), z, logarithmic, 0.1)
    for temper in TEMPERS if tempered else ():
        z, *_ = minimise(Objective(robot, parameters, sample, temper), z, tempered, 0.1)
    objective = Objective(robot, parameters, sample)
    z, cost, information, converged = minimise(objective, z, linear, tolerance)
    values = parameters.values(z)
    data = objective.data
    return Fitted(
        hypothesis, parameters, z, values, parameters.apply(robot, values), cost,
        (2 * cost - float(z @ z)) / max(data, 1), information, data, converged,
    )  # fmt: skip


def recorded_error(robot: Robot, recordings: Sequence[Recorded], *, again: bool = True) -> float:
    """RMS of residual over RMS of data, weighted, after re-estimating what belongs to the recordings themselves.

    Those are posture angles and channel gains within the description's tolerances; nothing of the robot is fitted.
    """
    postures = dict.fromkeys(r.setup.name for r in recordings)
    items = recording_parameters(robot, postures, recordings[0].setup.response.label)
    parameters = Parameters(tuple(items), np.diag([p.deviation**2 for p in items]).reshape(len(items), len(items)))
    z = np.zeros(len(items))
    whole = Sample(tuple(recordings))
    if again and len(items):
        few = whole.thin(50)
        z, *_ = minimise(Objective(robot, parameters, few, TEMPERS[-1]), z, 8, 0.1)
        z, *_ = minimise(Objective(robot, parameters, few), z, 8, 0.1)
    objective = Objective(robot, parameters, whole)
    residual = objective.residual(z)
    data = sum(float(np.sum(np.abs(r.frf * w) ** 2)) for r, w in zip(recordings, objective.weight, strict=True))
    return float(np.sqrt(residual @ residual / data))


def noise_floor(recordings: Sequence[Recorded]) -> float:
    """The same ratio for a residual that is all noise."""
    objective_weight = [1 / np.sqrt(r.variance) for r in recordings]
    data = sum(float(np.sum(np.abs(r.frf * w) ** 2)) for r, w in zip(recordings, objective_weight, strict=True))
    count = 2 * sum(int(np.count_nonzero(w)) for w in objective_weight)
    return float(np.sqrt(count / data))
