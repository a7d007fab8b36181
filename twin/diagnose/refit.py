"""Fits of a hypothesis: continuation from a robust logarithmic residual to the linear one, and Laplace's evidence.

The prior is standard normal in z. Then ln p(data) = −cost − ½ ln det(F + 1), up to a constant common to all hypotheses
on the same data. See MacKay, Information Theory, Inference and Learning Algorithms, chapter 28. A parameter the data do
not determine costs nothing. One they determine costs the ratio of its posterior to its prior width. How large an entry
is that nobody described is known least of all: its prior has heavy tails.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from twin.diagnose.hypotheses import Hypothesis, Sprung, together
from twin.identify.descent import ASTRAY, minimise
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters, independent, join, recording_parameters
from twin.model.recorded import Recorded, placed
from twin.robot.description import Robot

NONE = Hypothesis("none", "")
ENOUGH = 3.0  # in ln evidence: nearer the optimum on a few lines is no nearer that on all
SMALLER = tuple(np.geomspace(1e-4, 1.0, 19))
LEVELS = 5  # widths over which a tolerance may be too narrow
WIDTHS = (1.0, 2.0, 4.0)
ANY_SIZE = 16.0  # times the usual width, of the logarithm of a mass: from a speck of dust to a house
FIXED = 1e-3  # times the usual width: a mass that is held where it is
STRIDE, STRIDES = 4.0, 12  # between masses that are tried, and how many: lever and mass twice and a quarter, and so on
SETBACKS = 1  # times in a row that the evidence may fall before a walk ends
LOST = 40.0  # in ln evidence below the best: a mass that is so well known lies in no valley
HELD_MASS = 1e-3  # of a prior's variance: a mass known to 4 % lies in no valley
CRAWLING = 4  # steps in turn that hardly lower a cost far above noise: a model that lacks something is not at its end
SILENT = 1e-9  # of a prior's variance: data that take less of it say nothing
REFIT_TEMPERS = (0.1, 0.02)  # relative model error assumed on the way from logarithmic to linear residual


@dataclass(frozen=True)
class Fitted:
    """A hypothesis at its optimum.

    Attributes:
        parameters: free numbers; ``z`` (n,) the optimum in prior coordinates, ``values`` (n,) in units.
        described: the description with the values that belong to it, or what makes it: few fits are asked for theirs.
        cost: ½ χ² + ½ zᵀz; ``misfit`` is χ² over the number of real data.
        information: (n, n) Gauss–Newton matrix, prior included.
        data: number of real data.
        converged: the expected gain of the next step was within tolerance.
        allowed: those of the hypothesis' pieces that are off by no more than the description allows.
        exact: what it was fitted to is predicted but for noise by a model that is right.
    """

    hypothesis: Hypothesis
    parameters: Parameters
    z: FloatArray
    values: FloatArray
    described: Robot | Callable[[], Robot]
    cost: float
    misfit: float
    information: FloatArray
    data: float
    converged: bool
    allowed: tuple[Hypothesis, ...] = ()
    exact: bool = True

    @property
    def answers(self) -> frozenset[str]:
        """Keys of the pieces that are not ``allowed``."""
        return self.hypothesis.identity - {piece.key for piece in self.allowed}

    @cached_property
    def robot(self) -> Robot:
        """The description with the values that belong to it."""
        return self.described if isinstance(self.described, Robot) else self.described()

    def __getstate__(self) -> dict[str, Any]:
        """A fit that goes to another process takes its robot along, not what makes it."""
        return {**self.__dict__, "described": self.robot}

    @cached_property
    def covariance(self) -> FloatArray:
        """Posterior (n, n) of x, the data's variance multiplied by a misfit above one.

        By factors: what recordings hold to a millionth of a deviation would else round to less than nothing. The widest
        prior gives every direction some information at least. Rounding may take it away beside a very large one.
        """
        size, axes = self._spectrum
        factor = self.parameters.root @ (axes / np.sqrt(np.maximum(size, WIDTHS[-1] ** -2)))
        return np.asarray(factor @ factor.T) * max(1.0, self.misfit)

    @cached_property
    def _spectrum(self) -> tuple[FloatArray, FloatArray]:
        """Eigenvalues (n,) and eigenvectors (n, n) of the information: they bear what no factor of it would."""
        size, axes = np.linalg.eigh(self.information)
        return size, axes

    def evidence(self, scale: float = 1.0) -> float:
        """Logarithm of the evidence with the data's variance multiplied by ``scale`` (Birge's ratio)."""
        known: dict[float, float] = self.__dict__.setdefault("_evidence", {})  # it is asked for many times
        if scale not in known:
            known[scale] = self._evidence_at(scale)
        return known[scale]

    @property
    def too_heavy(self) -> bool:
        """Whether something is said to hang on the robot that is heavier than it: the ground, not a part."""
        hanging = {f"{p.key}.mass" for p in self.hypothesis.pieces if p.law and p.law.lever}
        heaviest = max((v for p, v in zip(self.parameters, self.values, strict=True) if p.name in hanging), default=0.0)
        return bool(heaviest > 0 and heaviest > sum(link.inertial[0] for link in self.robot.links))

    def _evidence_at(self, scale: float) -> float:
        if self.too_heavy:
            return -np.inf
        chi2, (information, axes) = self.misfit * self.data, self._spectrum
        rounding = len(information) * np.finfo(float).eps * information[-1]
        size = np.where(information > rounding, np.maximum((information - 1) / scale + 1, 1.0), 1.0)  # the prior's
        laplace = float(-0.5 * (chi2 / scale + self.z @ self.z) - 0.5 * np.sum(np.log(size)))
        return laplace + self._of_any_size(axes / np.sqrt(size))

    def _of_any_size(self, root: FloatArray) -> float:
        """What the evidence gains when sizes may be far from the usual one: prior widths averaged over their scale.

        The prior of an angle, gain or delay of either sign may be as narrow as ``SMALLER`` of its usual width; all
        these scales are alike. The same holds for a number of the description, down to its tolerance. The logarithm of
        a size may be ``WIDTHS`` times as far off, but it stays where it is. A wider prior would move it along a bent
        valley, and no Gaussian tells how far. The likelihood is Gaussian in the own parameters, the others integrated
        out. ``root`` (n, n): of the posterior's covariance.
        """
        gained, at = 0.0, len(self.z) - len(self.hypothesis.own)
        if self.hypothesis is NONE:
            return gained
        silent = max(SILENT, float(np.finfo(float).eps * self._spectrum[0][-1]))  # more than that is rounding
        for piece in self.hypothesis.pieces:
            block = list(range(at, at + len(piece.own)))
            at += len(piece.own)
            signed, smaller = not any(p.log for p in piece.own), SMALLER
            if piece.scale:
                block = [self.parameters.names.index(name) for name, _ in piece.scale]
                smaller = tuple(np.geomspace(1 / piece.scale[0][1], 1.0, LEVELS))
            block = block if signed else block[:1]
            size, axes = np.linalg.eigh(root[block] @ root[block].T)
            if size[-1] > 1 - silent:
                continue  # the recording says nothing of it
            held = 1 / np.maximum(size, np.finfo(float).tiny) - 1  # what the data add to a precision of one
            if signed:
                estimate, spread = axes.T @ self.z[block] * (1 + 1 / held), 1 / held
                logs = [_normal(estimate, spread + s**2) for s in (*smaller, 1.0)]
            else:
                logs = [*_of_widths(float(self.z[block[0]]), float(held[0])), 0.0]
            *logs, usual = logs
            gained += float(np.logaddexp.reduce(logs) - np.log(len(logs)) - usual)
        return gained

    @property
    def own(self) -> list[int]:
        """Indices of the hypothesis' own parameters."""
        return list(range(len(self.parameters) - len(self.hypothesis.own), len(self.parameters)))


def _of_widths(size: float, held: float, widths: tuple[float, ...] = WIDTHS) -> list[float]:
    """What ln evidence gains by each of the widths, of a size in prior deviations and the precision the data add."""
    return [-0.5 * size**2 * (1 / w**2 - 1) - 0.5 * np.log((1 + held * w**2) / (1 + held)) for w in widths]


def of_its_size(base: Robot, free: Parameters, fit: Fitted, sample: Sample) -> Fitted:
    """A fit again under the width of the priors on its sizes that it makes likeliest: the usual one draws them to it.

    What is usual for a thing of that size is the centre of the priors of its other numbers. A mass that recordings
    hardly hold is also tried along its valley, see :func:`_along_its_valley`.

    Args:
        free: the base model's parameters.
    """
    variance, at, pieces = np.diag(np.linalg.inv(fit.information)), len(fit.z) - len(fit.hypothesis.own), []
    for piece in fit.hypothesis.pieces:
        own = piece.own
        if own and any(p.log for p in own):
            held = 1 / float(variance[at]) - 1
            width = WIDTHS[int(np.argmax(_of_widths(float(fit.z[at]), held)))] if held > 1e-9 else 1.0
            usual = piece.law.given_size(base, piece.site, float(fit.values[at])) if piece.law else {}
            own = (replace(own[0], deviation=own[0].deviation * width), *own[1:])
            own = tuple(replace(p, mean=usual.get(p.quantity, p.mean)) for p in own)
        pieces.append(replace(piece, own=own))
        at += len(own)
    hypothesis, found = together(*pieces), fit
    if hypothesis != fit.hypothesis:
        parameters = hypothesis.parameters(free)
        z = parameters.coordinates(fit.values)
        found = descend(base, hypothesis, parameters, sample, z, tempered=0, linear=20, tolerance=0.02)
    elsewhere = _along_its_valley(base, free, fit, sample, variance)
    return found if elsewhere is None or elsewhere.evidence() <= found.evidence() else elsewhere


def _along_its_valley(
    base: Robot, free: Parameters, fit: Fitted, sample: Sample, variance: FloatArray
) -> Fitted | None:
    """A fit whose masses may be of any size, where each is likeliest along its valley; none where masses are held.

    A mass near a hinge moves as a hundredth of it does ten times as far out. Along that valley a usual size draws the
    mass towards the hinge. There its place is held to millimetres, and few places are so near: most of the probability
    lies where the lever is usual and the mass is what it must be. So the valley is walked, with the evidence of all
    other numbers at each mass.

    Args:
        variance: (n,) of the fit's z.
    """
    at, values, loose, few = len(fit.z) - len(fit.hypothesis.own), fit.values.copy(), {}, sample.thin(50)
    for number, piece in enumerate(fit.hypothesis.pieces):
        own, lever = piece.own, piece.law.lever if piece.law else ""
        if own and own[0].log and lever and variance[at] > HELD_MASS:
            place = [at + k for k, p in enumerate(own) if p.quantity.startswith(lever)]
            values = _walked(base, free, fit.hypothesis, number, values, at, place, few)
            loose[number] = float(values[at])
        at += len(own)
    if not loose:
        return None
    hypothesis = fit.hypothesis
    for number, mass in loose.items():
        hypothesis = _with_mass(hypothesis, number, mass, ANY_SIZE)
    parameters = hypothesis.parameters(free)
    return descend(
        base, hypothesis, parameters, sample, parameters.coordinates(values), tempered=0, linear=20, tolerance=0.02
    )


def _walked(
    base: Robot, free: Parameters, hypothesis: Hypothesis, number: int, values: FloatArray, mass: int,
    place: list[int], few: Sample,
) -> FloatArray:  # fmt: skip
    """Values (n,) with the mass of a piece, and all else for it, where the evidence of all else is greatest."""

    def held(*starts: FloatArray) -> tuple[float, FloatArray]:
        fixed = _with_mass(hypothesis, number, float(starts[0][mass]), FIXED)
        parameters = fixed.parameters(free)
        at = [parameters.coordinates(start) for start in starts]
        z = min(at, key=Objective(fixed.robot(base), parameters, few).cost) if len(at) > 1 else at[0]
        fit = descend(base, fixed, parameters, few, z, tempered=0, linear=10)
        return float(-fit.cost - 0.5 * np.sum(np.log(np.maximum(fit._spectrum[0], 1.0)))), fit.values

    usual = [p.mean for p in hypothesis.parameters(free)]
    start, first = held(values)
    best, found = start, first
    for factor in (1 / STRIDE, STRIDE):
        at, before, falls = first, start, 0
        for _ in range(STRIDES):
            there = at.copy()
            there[mass] *= factor
            elsewhere = there.copy()
            there[place] /= np.sqrt(factor)
            elsewhere[place] = [usual[k] for k in place]
            evidence, at = held(there, elsewhere)
            falls = falls + 1 if evidence < before else 0
            if falls > SETBACKS or evidence < best - LOST:
                break
            before = evidence
            best, found = max((best, found), (evidence, at), key=lambda end: end[0])
    return found


def _with_mass(hypothesis: Hypothesis, number: int, mass: float, times: float) -> Hypothesis:
    """A hypothesis with the prior of one piece's mass about a value, so many times as wide as it is."""
    pieces = list(hypothesis.pieces)
    own = pieces[number].own
    first = replace(own[0], mean=mass, deviation=own[0].deviation * times)
    pieces[number] = replace(pieces[number], own=(first, *own[1:]))
    return together(*pieces)


def in_doubt_of_size(fit: Fitted) -> Fitted:
    """A fit with its sizes in doubt as they are under all widths of their priors, each as likely as the fit makes it.

    A mass that shows by its moment of inertia alone has hardly more than its prior.
    """
    information, at = fit.information.copy(), len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        if piece.law and piece.own and any(p.log for p in piece.own):
            usual = next(p.spread for p in piece.law.parameters if p.name == piece.own[0].quantity)
            width = piece.own[0].deviation / usual
            rest = np.arange(len(fit.z)) != at
            across = information[at, rest] @ np.linalg.solve(information[np.ix_(rest, rest)], information[rest, at])
            precision = float(information[at, at] - across)
            held = max(precision - 1, 1e-9)
            widths = WIDTHS if width <= WIDTHS[-1] else (*WIDTHS, width)
            likely = np.exp(_of_widths(float(fit.z[at]) * width, held / width**2, widths))
            wide = float(likely / likely.sum() @ [1 / (held + (width / w) ** 2) for w in widths])
            information[at, at] += 1 / wide - precision  # which takes all that goes with the size along
        at += len(piece.own)
    return replace(fit, information=information)


def _normal(x: FloatArray, variance: FloatArray) -> float:
    """Logarithm of a normal density at x (n,) about zero, its numbers independent, without 2π."""
    return float(-0.5 * np.sum(x**2 / variance) - 0.5 * np.sum(np.log(variance)))


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
    hopeless: float = np.inf,
    patience: int | None = None,
) -> Fitted:
    """Fit a hypothesis from z; the numbers are the largest iterations on each kind of residual.

    ``hopeless`` and ``patience`` are those of :func:`minimise`, on the linear residual.
    """
    robot = hypothesis.robot(base)
    if logarithmic:
        z, *_ = minimise(Objective(robot, parameters, sample, logarithmic=True), z, logarithmic, 0.1)
    for temper in REFIT_TEMPERS if tempered else ():
        z, *_ = minimise(Objective(robot, parameters, sample, temper), z, tempered, 0.1)
    objective = Objective(robot, parameters, sample)
    z, cost, information, converged = minimise(objective, z, linear, tolerance, hopeless, patience=patience)
    values = parameters.values(z)
    data = objective.data
    return Fitted(
        hypothesis, parameters, z, values, parameters.apply(robot, values), cost,
        (2 * cost - float(z @ z)) / max(data, 1), information, data, converged,
        exact=all(r.exact for r in sample.recordings),
    )  # fmt: skip


def recorded_error(robot: Robot, recordings: Sequence[Recorded]) -> tuple[float, float]:
    """RMS of residual over RMS of data, weighted, and the largest error of a posture angle, in its tolerances.

    See :func:`recorded_energy`.
    """
    residual, data, off = recorded_energy(robot, recordings)
    return float(np.sqrt(residual / data)), off


def recorded_energy(robot: Robot, recordings: Sequence[Recorded]) -> tuple[float, float, float]:
    """Sums of squares of residual and data over the noise, and the largest error of a posture angle, in tolerances.

    Before, what belongs to the recordings themselves is re-estimated: posture angles and channel gains within the
    description's tolerances. Nothing of the robot is fitted.
    """
    postures = dict.fromkeys(r.setup.name for r in recordings)
    items = recording_parameters(robot, postures, recordings[0].setup.response.label)
    parameters, z = independent(items), np.zeros(len(items))
    whole = Sample(tuple(recordings))
    if len(items):
        few = whole.thin(50)
        z, *_ = minimise(Objective(robot, parameters, few, REFIT_TEMPERS[-1]), z, 8, 0.1)
        z, *_ = minimise(Objective(robot, parameters, few), z, 8, 0.1)
    objective = Objective(robot, parameters, whole)
    residual = objective.residual(z)
    data = sum(float(np.sum(np.abs(r.frf * w) ** 2)) for r, w in zip(recordings, objective.weight, strict=True))
    off = max((abs(float(x)) for p, x in zip(items, z, strict=True) if p.kind == "posture"), default=0.0)
    return float(residual @ residual), data, off


def foreseen(fit: Fitted, kept: Sample) -> Fitted:
    """How a fit predicts recordings it has not seen; the doubt of its parameters counts beside their noise.

    The posterior of the fit, of covariance C, is the prior of its parameters. So the least cost is ½ rᵀ(Σ + J C Jᵀ)⁻¹r.
    The evidence is that of the recordings, given what the fit has seen. With the fit's own evidence it makes that of
    all recordings (the chain rule of probability), and nothing is fitted to both. Angles of the postures are their own.
    """
    stay = [k for k, p in enumerate(fit.parameters) if p.kind != "posture"]
    covariance = _within_a_bend(fit).covariance
    kept = replace(kept, recordings=placed(kept.recordings, fit.parameters, fit.values))
    own = recording_parameters(fit.robot, dict.fromkeys(r.setup.name for r in kept.recordings), ())
    own = [p for p in own if p.kind == "posture"]

    def after(parameters: Parameters) -> Parameters:
        items = [replace(parameters[k], mean=fit.values[k], deviation=np.sqrt(covariance[k, k])) for k in stay]
        return join(Parameters(tuple(items), covariance[np.ix_(stay, stay)]), independent(own))

    known = after(fit.parameters)
    if isinstance(fit.parameters, Sprung):
        known = Sprung(known.items, known.covariance, after(fit.parameters.written))
    steps = 8 if fit.misfit < ASTRAY else 2
    z, thin = np.zeros(len(known)), kept.thin(50)
    few = descend(fit.robot, NONE, known, thin, z, tempered=0, linear=steps, tolerance=ENOUGH)
    return descend(fit.robot, NONE, known, kept, few.z, tempered=0, linear=steps, tolerance=0.1)


def _within_a_bend(fit: Fitted) -> Fitted:
    """A fit whose masses of any size are in doubt by the usual width: further the valley bends, and no line follows."""
    information, at = fit.information.copy(), len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        if piece.law and piece.own and piece.own[0].log:
            usual = next(p.spread for p in piece.law.parameters if p.name == piece.own[0].quantity)
            information[at, at] += max((piece.own[0].deviation / usual) ** 2, 1.0) - 1.0
        at += len(piece.own)
    return replace(fit, information=information)
