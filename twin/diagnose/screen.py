"""Which of many hypotheses deserve a refit: the gain that one Gauss–Newton step from a typical size promises.

Every entry in turn is put into the base model at a few sizes of its prior: its secant carries what a tangent at no
effect cannot (a servo is collinear with gear stiffness to first order). The step frees the entry's own parameters and,
under their priors, everything the base model has free: stiffness, damping, masses, posture angles, gains. That is
the projection of nuisance parameters with unfitted tolerances as part of the covariance, and an implausible size pays
for itself.

Where the base model misses by much more than noise, no first-order model holds to the precision of that noise: the
promise is then taken on the robust logarithmic residual, at the optimum of that residual.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.objective import Objective, Sample
from twin.diagnose.refit import Fitted
from twin.identify.parameters import Parameters
from twin.measure.campaign import FloatArray
from twin.robot.description import Robot

SIZES = (-1.5, 0.5)  # where a search starts, in prior deviations of the first scale among the own parameters
SCANNED = 12  # more variants than this are scanned by their secant alone first
SCANNED_POSTURES = 3
SCANNED_KEPT = 3
LONGEST = 3.0  # prior deviations that a promised step may take
FAR = 0.03  # relative misfit of the base model above which residuals are taken logarithmic


@dataclass(frozen=True)
class Promise:
    """What one step promises.

    Attributes:
        gain: expected fall of the cost, prior of the own parameters included.
        start: (n + m,) where a refit starts, in prior deviations: the end of the step where that is better indeed.
    """

    hypothesis: Hypothesis
    parameters: Parameters
    gain: float
    start: FloatArray


@dataclass(frozen=True)
class Setting:
    """Where a screening stands: base model, its parameters, where in z, and on which residual.

    Attributes:
        z: (n,) the base model's optimum of the residual in use.
    """

    base: Robot
    parameters: Parameters
    z: FloatArray
    sample: Sample
    temper: float
    logarithmic: bool

    def objective(self, hypothesis: Hypothesis, parameters: Parameters, sample: Sample | None = None) -> Objective:
        """The cost of a hypothesis on this residual."""
        return Objective(hypothesis.robot(self.base), parameters, sample or self.sample, self.temper, self.logarithmic)


def inflation(base: Robot, fit: Fitted, sample: Sample) -> float:
    """Relative model error τ at which the base model's χ² per datum is one, from 0 (it is noise already) to 1."""
    plain = Objective(base, fit.parameters, sample)
    power = [np.abs(r.frf - H) ** 2 for r, H in zip(sample.recordings, plain.predicted(fit.z), strict=True)]

    def chi2(temper: float) -> float:
        total = sum(
            float(np.sum(p / (r.variance + temper**2 * np.abs(r.frf) ** 2)))
            for p, r in zip(power, sample.recordings, strict=True)
        )
        return sample.repeat * total / plain.data

    if chi2(0.0) < 1.3:
        return 0.0
    low, high = 1e-4, 1.0
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if chi2(middle) > 1 else (low, middle)
    return high


def screen(
    setting: Setting, suspects: Sequence[Sequence[Hypothesis]], progress: Callable[[int], None] | None = None
) -> list[Promise]:
    """The most promising variant and size of every suspect, best first."""
    before = setting.objective(Hypothesis("none", ""), setting.parameters).cost(setting.z)
    scan: _Scan | None = None
    found = []
    for variants in suspects:
        chosen = variants
        if len(variants) > SCANNED:
            scan = scan or _Scan(setting)
            chosen = scan.best(variants)
        promises = [promise for hypothesis in chosen for promise in _promises(setting, hypothesis, before)]
        found.append(max(promises, key=lambda promise: promise.gain))
        if progress:
            progress(1)
    return sorted(found, key=lambda promise: -promise.gain)


def _promises(setting: Setting, hypothesis: Hypothesis, before: float) -> list[Promise]:
    parameters = hypothesis.parameters(setting.parameters)
    objective = setting.objective(hypothesis, parameters)
    n = len(setting.z)
    z_base = setting.z
    # Where the base model is far off, its springs make up for what is missing: start from the description too.
    places = [(z_base, deviation) for deviation in SIZES] + [(np.zeros(n), 0.0)] * setting.logarithmic
    if hypothesis.scale:
        z_base = np.asarray(np.linalg.solve(parameters.root[:n, :n], setting.parameters.root @ setting.z))
    size = next((k for k, p in enumerate(hypothesis.own) if p.log), None)
    found = []
    for place, deviation in places if size is not None else [(z_base, 0.0)]:
        own = np.zeros(len(hypothesis.own))
        if size is not None:
            own[size] = deviation
        z = np.concatenate([place, own])
        cost, gradient, information = objective(z)
        step = -np.linalg.solve(information, gradient)
        reach = min(1.0, LONGEST / max(float(np.abs(step[n:]).max(initial=0.0)), 1e-9))
        after = cost + (reach - 0.5 * reach**2) * float(gradient @ step)
        end = z + reach * min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-9)) * step
        start = end if objective.cost(end) < cost else z
        found.append(Promise(hypothesis, parameters, before - after, start))
    return found


class _Scan:
    """Secants of many variants against the projected residual, the amplitude free."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.sample = setting.sample.first(SCANNED_POSTURES)
        # linear in H, with the model's error as large as it is: the secant of a resonator is local in frequency
        objective = Objective(setting.base, setting.parameters, self.sample, max(setting.temper, 1e-9))
        self.residual, self.J = objective.jacobian(setting.z)
        self.factor = np.linalg.inv(self.J @ self.J.T + np.eye(len(self.J)))
        self.pull = self.J @ self.residual

    def best(self, variants: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The most promising variants, one for every word (an axis) among the parameters."""
        scores: dict[str, tuple[float, Hypothesis]] = {}
        for hypothesis in variants:
            parameters = hypothesis.parameters(self.setting.parameters)
            robot = hypothesis.robot(self.setting.base)
            objective = Objective(robot, parameters, self.sample, max(self.setting.temper, 1e-9))
            z = np.concatenate([self.setting.z, np.zeros(len(hypothesis.own))])
            secant = self.residual - objective.residual(z)
            across = self.J @ secant
            along = float(secant @ self.residual - across @ self.factor @ self.pull)
            size = float(secant @ secant - across @ self.factor @ across)
            gain = along * abs(along) / max(size, 1e-12)
            words = "".join(str(v) for v in hypothesis.entries[0].values.values() if isinstance(v, str))
            if words not in scores or gain > scores[words][0]:
                scores[words] = gain, hypothesis
        ranked = sorted(scores.values(), key=lambda item: -item[0])
        return [hypothesis for _, hypothesis in ranked[:SCANNED_KEPT]]
