"""Which of many hypotheses deserve a refit: the gain that one Gauss–Newton step from a typical size promises.

Every entry in turn is put into the current model at a few sizes of its prior. The secant shows what a tangent at no
effect cannot: to first order a servo is collinear with gear stiffness. The step frees the entry's own parameters and,
under their priors, everything the current model has free: stiffness, damping, masses, posture angles, gains. That is
the projection of nuisance parameters, with unfitted tolerances as part of the covariance. An implausible size pays for
itself.

Near the truth all this is linear algebra on every line, with the nuisance derivatives of the current model. Where there
are ridges between the sizes of an entry, it is followed a few steps beyond them. Where the current model misses by much
more than noise, no first-order model holds to the precision of that noise. The promise is then taken on the robust
logarithmic residual of a few lines, with derivatives at every place that is tried.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, together
from twin.diagnose.parted import divided
from twin.diagnose.refit import WIDTHS, Fitted
from twin.identify.descent import minimise
from twin.identify.objective import Objective, Sample, factors
from twin.measure.campaign import Channels, ComplexArray, FloatArray
from twin.model.parameters import Parameters
from twin.model.sensitivity import observe
from twin.parallel import spread
from twin.physics import CATALOGUE
from twin.robot.description import Robot

SIZES = (-0.5, 1.0)
"""Where a search starts: prior deviations of the first scale, towards null; linear steps reach little."""
FAR_STARTS = 2  # of an effect's ``sizes`` where the current model is far off
SPARSE = 0.2  # of the lines: fewer are taken by themselves
YIELDING = 5  # iterations in which springs make room for an entry
YIELDING_POSTURES = 4
NO_START = 1.5  # times the least cost of other sizes: with more, a size is no start
SLIGHT = 3.0  # ln likelihood that a refit must promise
ROOM = 1.01  # of the least cost that is left then
BEYOND = 6  # iterations after which such an entry near the truth promises what it has gained
TRACED = 4  # iterations after which any size that promises something shows what it reaches
IN_SERIES = (3.0, 2.0, 1.0, 0.0, -1.0)  # prior deviations of a stiffness, from nearly rigid: little room at a time
SCANNED = 12  # more variants than this are scanned by their secant alone first
FOLLOWED = 25  # iterations from the description where the current model is far off
SCANNED_KEPT = 3
PLACED = 0.15  # m between the places of a light mass, half a prior deviation of its position
TANGENT_SIZE = 1e-6  # of the usual size, where the derivative with respect to it is taken
PEAKS_KEPT = 40  # light resonators of one axis for which the room that the current model makes is counted
IMITATED = 1e-9  # share of a change's square: so much is left of what the current model can imitate, and of rounding
LEAST_SIZE = 1e-6  # of the usual size: less is nothing
NEARLY = 0.5  # of its best variant's gain: a variant of an entry (another axis) is looked at beside it
LONGEST = 3.0  # prior deviations that a promised step may take
FAR = 0.03  # relative misfit of the current model above which residuals are taken logarithmic


@dataclass(frozen=True)
class Promise:
    """What one step promises.

    Attributes:
        hypothesis: the current one and the suspect together.
        suspect: what is new in it.
        gain: expected fall of the cost, prior of the own parameters included.
        start: (n + m,) where a refit starts, in prior deviations: the end of the step; ``fallback`` where it began.
    """

    hypothesis: Hypothesis
    suspect: Hypothesis
    parameters: Parameters
    gain: float
    start: FloatArray
    fallback: FloatArray

    @property
    def sized(self) -> bool:
        """Whether the suspect has a size that is never zero: its promise is to first order about a size, not null."""
        return any(p.log for p in self.suspect.own)


@dataclass(frozen=True)
class Setting:
    """Where a screening stands.

    Attributes:
        base, free: the description and the base model's parameters.
        current: what is already believed to be missing; ``z`` (n,) its optimum of the residual in use.
        few: fewer lines.
        error: relative model error assumed beside the noise.
    """

    base: Robot
    free: Parameters
    current: Hypothesis
    z: FloatArray
    sample: Sample
    few: Sample
    error: float
    logarithmic: bool

    def objective(self, hypothesis: Hypothesis, sample: Sample | None = None) -> Objective:
        """The cost of a hypothesis on this residual."""
        parameters, robot = hypothesis.parameters(self.free), hypothesis.robot(self.base)
        return Objective(
            robot, parameters, sample or self.sample, self.error, self.logarithmic, sagging=not self.logarithmic
        )

    def coarse(self, hypothesis: Hypothesis, objective: Objective, z: FloatArray) -> Objective:
        """The same with what does not matter far off held at z; the whole where the current model is near."""
        return objective.within(z, hypothesis.coarse(objective.parameters)) if self.logarithmic else objective

    @cached_property
    def linear(self) -> "Linear":
        """Derivatives at z of the linear residual on all postures."""
        return Linear(replace(self.objective(self.current), logarithmic=False), self.z)

    @cached_property
    def floor(self) -> float:
        """Cost of the current model on the few lines, which it fits better than all."""
        return minimise(self.objective(self.current, self.few), self.z, BEYOND, 0.5)[1]

    def overfit(self, count: int) -> float:
        """How much more noise a count of numbers fits on the few lines than on the others."""
        return 0.5 * count * (self.few.repeat - self.sample.repeat)


class Linear:
    """An objective to first order about z: ½ ‖ρ − A δ‖², ρ = [residual; −z], A = [Jᵀ; 1] = Q R.

    What is left of a payload once links may move is 1e-5 of it, 1e-10 squared: orthogonal factors leave five digits of
    that, normal equations none.
    """

    def __init__(self, objective: Objective, z: FloatArray) -> None:
        self.residual, J = objective.jacobian(z)
        self.Q, self.R = factors(J)
        self.offset = z @ self.Q[len(self.residual) :]  # what the prior holds back
        self.own = self.share(self.residual) - self.offset
        self.gain = 0.5 * float(self.own @ self.own)

    def share(self, vectors: FloatArray) -> FloatArray:
        """What the step can make of vectors (data,) or (m, data): (n,) or (n, m)."""
        if vectors.ndim > 1:
            touched = np.flatnonzero(vectors.any(axis=0))  # of one channel, a few: little of Q is read
            if len(touched) < SPARSE * vectors.shape[-1]:
                return np.asarray((vectors[:, touched] @ self.Q[touched]).T)
        return np.asarray((vectors @ self.Q[: vectors.shape[-1]]).T)

    def step(self, share: FloatArray) -> FloatArray:
        """δ (n,) that makes a share (n,)."""
        return np.asarray(np.linalg.solve(self.R, share))


def inflation(fit: Fitted, base: Robot, sample: Sample) -> float:
    """:func:`model_error` of a fit."""
    return model_error(Objective(fit.hypothesis.robot(base), fit.parameters, sample), fit.z)


def model_error(plain: Objective, z: FloatArray) -> float:
    """Relative error τ beside noise with which a model's χ² per datum is one at z, from 0 (noise is all) to 1."""
    sample = plain.sample
    power = [np.abs(r.frf - H) ** 2 for r, H in zip(sample.recordings, plain.predicted(z), strict=True)]

    def chi2(temper: float) -> float:
        total = sum(
            float(np.sum(p / (r.variance + temper**2 * np.abs(r.frf) ** 2)))
            for p, r in zip(power, sample.recordings, strict=True)
        )
        return sample.repeat * total / max(plain.data, 1)

    if chi2(0.0) < 1.3:
        return 0.0
    low, high = 1e-4, 1.0
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if chi2(middle) > 1 else (low, middle)
    return high


def screen(
    setting: Setting,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Callable[[int], None] | None = None,
    processes: int = 1,
) -> list[Promise]:
    """The most promising size of every suspect not in the current hypothesis, and of its rival variants, best first."""
    present = {piece.key for piece in setting.current.pieces}
    freed = {p.name for p in setting.current.own}
    before = setting.objective(setting.current).cost(setting.z)
    if not setting.error:
        before -= setting.linear.gain
    missing = [
        some for some in suspects if some[0].key not in present and freed.isdisjoint(p.name for p in some[0].own)
    ]
    scan = _Scan(setting) if any(_hangs(variants) for variants in missing) else None
    if not setting.logarithmic:
        setting.linear  # noqa: B018 – once, before the work is spread
    if not setting.error:
        setting.floor  # noqa: B018

    def best(number: int) -> list[Promise]:
        variants = missing[number]
        if len(variants) > SCANNED and setting.logarithmic and not _hangs(variants):
            return [max((_followed(setting, h, before) for h in _nearest(setting, variants)), key=lambda p: p.gain)]
        if scan and _hangs(variants):
            variants = scan.best(variants)
        elif len(variants) > SCANNED:  # near the truth first order reaches the others from the first
            variants = variants[:1]
        found = [max(_promises(setting, h, before), key=lambda promise: promise.gain) for h in variants]
        if setting.logarithmic and not present and _on_a_link(setting, variants[0]):
            found.append(_carried(setting, variants, before))
        if not setting.error:
            found = [_traced(setting, promise) for promise in found]
        if not present:  # beside what was found, it would rather let masses in that swing in the noise
            found = [_of_any_size(promise) for promise in found]
        most = max(promise.gain for promise in found)
        return [promise for promise in found if promise.gain >= most - (1 - NEARLY) * abs(most)]

    found = []
    for promises in spread(best, len(missing), processes):
        found += promises
        if progress:
            progress(1)
    return sorted(found, key=lambda promise: -promise.gain)


def _hangs(variants: Sequence[Hypothesis]) -> bool:
    """Whether a suspect has many variants that differ in where and how a mass hangs."""
    return len(variants) > SCANNED and bool(variants[0].law and variants[0].law.lever)


def _nearest(setting: Setting, variants: Sequence[Hypothesis]) -> Sequence[Hypothesis]:
    """Of many variants those with the least robust cost on a few lines, the base model as described."""

    def cost(variant: Hypothesis) -> float:
        objective = setting.objective(together(setting.current, variant), setting.few)
        return float(objective.cost(_as_described(setting, objective)))

    return sorted(variants, key=cost)[:SCANNED_KEPT]


def _as_described(setting: Setting, objective: Objective) -> FloatArray:
    """z of a hypothesis with the base model as described, what was found as it is, what is new of its usual size."""
    z = np.zeros(len(objective.parameters))
    z[len(setting.free) : len(setting.z)] = setting.z[len(setting.free) :]
    return z


def _followed(setting: Setting, suspect: Hypothesis, before: float) -> Promise:
    """What a suspect promises whose robust cost is followed down from the description: fits without it lead astray."""
    hypothesis = together(setting.current, suspect)
    objective = setting.objective(hypothesis)
    z, cost, *_ = minimise(objective, _as_described(setting, objective), FOLLOWED, 0.5)
    return Promise(hypothesis, suspect, objective.parameters, before - cost, z, z)


def _on_a_link(setting: Setting, suspect: Hypothesis) -> bool:
    """Whether a suspect is a mass that is rigidly a part of a link."""
    return suspect.law is not None and suspect.law.carrier(setting.base, suspect.site) is not None


def _carried(setting: Setting, variants: Sequence[Hypothesis], before: float) -> Promise:
    """What a mass on a link promises, of whatever size, whose robust cost is followed down from the description.

    A tool may weigh a tenth of the robot. Springs that make up for it lead a search that begins with them astray.
    """
    starts = []
    for suspect in variants:
        hypothesis = together(setting.current, suspect)
        objective = setting.objective(hypothesis)
        z, n = _as_described(setting, objective), len(setting.z)
        for size in suspect.law.sizes if suspect.law else ():
            own = np.eye(len(suspect.own))[0] * -size
            mass = suspect.own[0].mean * float(np.exp(-size * suspect.own[0].deviation))
            usual = suspect.law.given_size(setting.base, suspect.site, mass) if suspect.law else {}
            for k, p in enumerate(suspect.own):
                own[k] += np.log(usual[p.quantity] / p.mean) / p.deviation if p.quantity in usual else 0.0
            start = np.concatenate([z[:n], own])
            starts.append((objective.cost(start), suspect, hypothesis, objective, start))
    ends = []
    for _, suspect, hypothesis, objective, start in sorted(starts, key=lambda one: one[0])[:SCANNED_KEPT]:
        inner = setting.coarse(hypothesis, objective, start)
        end, cost, *_ = minimise(inner, inner.part(start), FOLLOWED, 0.5)
        ends.append((cost, suspect, hypothesis, objective, inner.whole(end)))
    _, suspect, hypothesis, objective, start = min(ends, key=lambda one: one[0])
    z, cost, *_ = minimise(objective, start, FOLLOWED, 0.5)
    return Promise(hypothesis, suspect, objective.parameters, before - cost, z, z)


def _of_any_size(promise: Promise) -> Promise:
    """A promise with its size under the width of its prior that makes it likeliest, as evidence has it."""
    own = promise.suspect.own
    if not any(p.log for p in own):
        return promise
    size = float(promise.start[-len(own)])
    return replace(promise, gain=promise.gain + max(0.5 * size**2 * (1 - 1 / w**2) - np.log(w) for w in WIDTHS))


def _promises(setting: Setting, suspect: Hypothesis, before: float) -> list[Promise]:
    """One promise for every place a search may start from."""
    hypothesis = together(setting.current, suspect)
    objective = setting.objective(hypothesis)
    if suspect.scale:
        return [_widened_promise(setting, hypothesis, suspect, objective, before)]
    law = suspect.law
    if law is None:
        return [_freed_promise(setting, hypothesis, suspect, objective, before)]
    size = next((k for k, p in enumerate(suspect.own) if p.log), None)
    found = []
    starts: list[tuple[float, FloatArray]] = []
    sizes = (0.0,) if size is None else law.sizes if setting.error > 0 else SIZES
    for deviation in sorted(sizes, reverse=True):  # from the smallest
        own = np.zeros(len(suspect.own))
        if size is not None:
            own[size] = deviation if law.sprung else -deviation
        z = np.concatenate([setting.z, own])
        if setting.error > 0 and size is not None:
            least = min((cost for cost, _ in starts), default=np.inf)
            starts.append(_yielding(setting, objective, z, NO_START * least))
        elif setting.logarithmic:  # at null: there is nothing to make room for
            starts.append((0.0, z))
        else:
            found.append(_near_promise(setting, hypothesis, suspect, objective, z, before))
    starts = [start for start in starts if start[0] <= NO_START * min(cost for cost, _ in starts)]
    for _, z in sorted(starts, key=lambda start: start[0])[:FAR_STARTS]:
        found.append(_full_promise(setting, hypothesis, suspect, objective, z, before))
    bent = False
    if size is not None and not setting.logarithmic:
        tangent = _Tangent.of(setting, suspect, objective)
        bent = law.sprung and not setting.current.pieces and tangent.bent
        found += _part_promise(setting, hypothesis, suspect, objective.parameters) or _tangent_promise(
            setting, hypothesis, suspect, objective, tangent
        )
    if (law.ridged or bent) and not setting.error and max(promise.gain for promise in found) <= SLIGHT:
        found.append(_beyond_promise(setting, hypothesis, suspect, objective))
    if setting.logarithmic and size is not None:  # springs make up for what is missing: from the description too
        z = np.zeros(len(objective.parameters))
        found.append(_full_promise(setting, hypothesis, suspect, objective, z, before))
    return found


def _widened_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective, before: float
) -> Promise:
    """What numbers of the description gain if their tolerance is w times wider.

    To first order the cost is that of now, ½ δᵀA δ about its optimum, less ½ (1 − 1/w²) of the squares of what widens.
    """
    at = [setting.free.names.index(name) for name, _ in suspect.scale]
    width = np.ones(len(setting.z))
    width[at] = [factor for _, factor in suspect.scale]
    if setting.logarithmic:
        return _full_promise(setting, hypothesis, suspect, objective, setting.z / width, before)
    linear, less = setting.linear, 1 - 1 / width**2
    z = setting.z + linear.step(linear.own)
    gradient = -less * z
    step = -np.linalg.solve(linear.R.T @ linear.R - np.diag(less), gradient)
    gain = 0.5 * float(less @ z**2) - 0.5 * float(gradient @ step)
    return Promise(hypothesis, suspect, objective.parameters, gain, (z + step) / width, setting.z / width)


def _freed_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective, before: float
) -> Promise:
    """What numbers that the fit takes as described gain if they are free."""
    z = np.concatenate([setting.z, np.zeros(len(suspect.own))])
    promise = _full_promise if setting.logarithmic else _near_promise
    return promise(setting, hypothesis, suspect, objective, z, before)


def _yielding(
    setting: Setting, objective: Objective, z: FloatArray, hopeless: float = np.inf
) -> tuple[float, FloatArray]:
    """Cost and z after the springs have made room for an entry, its size held: a servo shares its joint with the gear.

    It is given up where the cost will not come below ``hopeless``.
    The robust logarithmic residual of few lines and postures serves from any distance.
    """
    some = replace(
        setting.few, recordings=setting.few.recordings[:: -(-len(setting.few.recordings) // YIELDING_POSTURES)]
    )
    robust = replace(objective, sample=some, temper=0.0, logarithmic=True, sagging=False)
    inner = robust.within(z, [k for k, p in enumerate(setting.free) if p.kind == "spring"])
    end, cost, _, _ = minimise(inner, inner.part(z), YIELDING, 0.5, hopeless)
    return cost, inner.whole(end)


def _beyond_promise(setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective) -> Promise:
    """A few steps from a size of an entry for which the springs make room.

    Where there are ridges between sizes that is the largest: the smallest has no slope. In a bent valley it is the one
    that leaves least.
    """
    law, own, n = suspect.law, np.eye(len(suspect.own))[0], len(setting.z)
    assert law is not None
    place, ends = setting.z, []
    for size in sorted(law.sizes, reverse=True) if law.ridged else IN_SERIES:  # from the smallest
        ends.append(_yielding(setting, objective, np.concatenate([place[:n], (size if law.sprung else -size) * own])))
        place = ends[-1][1]
    room = ROOM if law.ridged else 1.0
    least = min(cost for cost, _ in ends)
    z = next(z for cost, z in reversed(ends) if cost <= room * least)
    few, enough = setting.objective(hypothesis, setting.few), setting.floor - setting.overfit(len(own))
    z, cost, _, _ = minimise(few, z, BEYOND, 0.5, hopeless=enough - SLIGHT)
    gain = enough - cost
    return Promise(hypothesis, suspect, objective.parameters, gain, z, z)


def _traced(setting: Setting, promise: Promise) -> Promise:
    """A promise after a few steps on few lines, if they reach further.

    First order sees the valley that the current model lies in. A tilt that its springs and links imitate promised 15 in
    ln likelihood and reached 175.
    """
    if not promise.sized or promise.gain <= SLIGHT:
        return promise
    z, cost, *_ = minimise(setting.objective(promise.hypothesis, setting.few), promise.start, TRACED, 0.5)
    gain = setting.floor - cost - setting.overfit(len(promise.suspect.own))
    return replace(promise, gain=gain, start=z, fallback=promise.start) if gain > promise.gain else promise


@dataclass(frozen=True)
class _Tangent:
    """The derivative of the residual with respect to an entry's size, in its usual one, where there is none of it.

    Attributes:
        share: what a step of the current model can make of it, (n,).
        along: fall of the cost per size, the current model following; ``across``: what is left of the square.
        steepest: the largest step of the current model per size, prior deviations times their width.
    """

    share: FloatArray
    along: float
    across: float
    steepest: float

    @classmethod
    def of(cls, setting: Setting, suspect: Hypothesis, objective: Objective) -> "_Tangent":
        base, n, first = setting.linear, len(setting.z), suspect.own[0]
        small = suspect.of_size(setting.z, TANGENT_SIZE)
        _, (row,) = replace(objective, logarithmic=False).within(small, [n]).jacobian(small[n:][:1])
        tangent = row * (-1 if first.quantity == "stiffness" else 1) / (TANGENT_SIZE * first.deviation)
        share = base.share(tangent)
        along, across = float(tangent @ base.residual - share @ base.own), float(tangent @ tangent - share @ share)
        widths = np.array([p.deviation for p in setting.free] + [0.0] * (n - len(setting.free)))
        springs = np.array([p.log and p.kind == "spring" for p in setting.free] + [False] * (n - len(setting.free)))
        steps = np.abs(base.step(share) * widths)[springs]
        return cls(share, along, across, float(steps.max(initial=0.0)))

    @property
    def bent(self) -> bool:
        """Whether the current model imitates the entry along a valley that is bent by more than what is left of it.

        Springs in series add compliances. Where the logarithm of one moves by x, ½ x² of what was imitated stays. That
        is compared at the size whose gain is ``SLIGHT``.
        """
        visible = np.sqrt(2 * SLIGHT / max(self.across, 1e-300))
        imitated = float(self.share @ self.share)
        return 0.25 * imitated * (self.steepest * visible) ** 2 > self.across


def _tangent_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective, tangent: "_Tangent"
) -> list[Promise]:
    """The size at which an entry promises most to first order, the current model making room for it.

    That finds what hides in the tension of the prior: a payload as a forearm with its centre of mass 10 cm off.
    """
    base, n, share = setting.linear, len(setting.z), tangent.share
    along, across = tangent.along, tangent.across
    size = along / max(across, 1e-300)
    if not LEAST_SIZE < size < 1 / LEAST_SIZE:
        return []
    own = suspect.of_size(setting.z, size)[n:]
    gain = 0.5 * size * along - 0.5 * float(own @ own)
    start, fallback = (np.concatenate([z, own]) for z in (setting.z + base.step(base.own - size * share), setting.z))
    return [Promise(hypothesis, suspect, objective.parameters, gain, start, fallback)]


def _part_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, parameters: Parameters
) -> list[Promise]:
    """A mass that is a part of a link: what the tension of the link's prior falls by if the link gives it up.

    All else stays as it is, exactly: the whole that moves is the same.
    """
    none = np.concatenate([setting.z, np.zeros(len(suspect.own))])
    found = divided(setting.base, parameters, none, suspect, present=False)
    if found is None or found[1] <= 0:
        return []
    start, gain = found
    return [Promise(hypothesis, suspect, parameters, gain, start, start)]


def _near_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective, z: FloatArray, before: float
) -> Promise:
    base, n, m = setting.linear, len(setting.z), len(suspect.own)
    residual, D = objective.within(z, range(n, n + m)).jacobian(z[n:])
    shares = base.share(np.vstack([D, residual - base.residual]))  # at once: they may read all of Q
    own, share, rho, along = z[n:], shares[:, :m], shares[:, m] + base.own, D @ residual
    change = np.linalg.solve(D @ D.T - share.T @ share + np.eye(m), along - share.T @ rho - own)
    step = np.asarray(np.concatenate([base.step(rho - share @ change), change]), float)
    loss = 0.5 * float(residual @ residual + z @ z) - before
    slope = -float(rho @ (base.R @ step[:n])) + float((own - along) @ change)
    return _promise(setting, hypothesis, suspect, objective.parameters, z, loss, slope, step)


def _full_promise(
    setting: Setting, hypothesis: Hypothesis, suspect: Hypothesis, objective: Objective, z: FloatArray, before: float
) -> Promise:
    inner = setting.coarse(hypothesis, objective, z)
    cost, gradient, information = inner(inner.part(z))
    part = -np.linalg.solve(information, gradient)
    slope, step = float(gradient @ part), inner.whole(inner.part(z) + part) - z
    promise = _promise(setting, hypothesis, suspect, objective.parameters, z, cost - before, slope, step)
    return promise if objective.cost(promise.start) < cost else replace(promise, start=z)


def _promise(
    setting: Setting,
    hypothesis: Hypothesis,
    suspect: Hypothesis,
    parameters: Parameters,
    z: FloatArray,
    loss: float,
    slope: float,
    step: FloatArray,
) -> Promise:
    """The step from z, where the cost is ``loss`` above the current model's, and its gradient times the step."""
    n = len(setting.z)
    reach = min(1.0, LONGEST / max(float(np.abs(step[n:]).max(initial=0.0)), 1e-9))
    gain = -loss - (reach - 0.5 * reach**2) * slope
    end = z + reach * min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-9)) * step
    return Promise(hypothesis, suspect, parameters, gain, end, z)


class _Scan:
    """Secants of many resonators against the projected residual, the amplitude free.

    A mass on a spring at a point p takes the force D u_p. Its axis is e: D⁻¹ = 1/(m s²) + δ eeᵀ with δ = 1/(c s + k).
    So H′ − H = −H_rp (D⁻¹ + H_pp)⁻¹ H_pe. With B that inverse for δ = 0, a mass without a spring,

        H′ − H = −H_rp B H_pe + a H_rp B e eᵀB H_pe,    a = δ/(1 + δ eᵀB e).

    One prediction serves all frequencies and axes. Only the factor a, line by line, depends on the resonator's
    frequency.
    """

    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.sample = setting.sample
        # linear in H, with the model's error as large as it is: the secant of a resonator is local in frequency
        temper = max(setting.error, 1e-9)
        parameters = setting.current.parameters(setting.free)
        self.objective = Objective(setting.current.robot(setting.base), parameters, self.sample, temper)
        self.linear = Linear(self.objective, setting.z)
        self.seen: dict[tuple[str, tuple[float, ...]], list[ComplexArray]] = {}
        self.columns, at = [], 0  # residual and Q (nf, nr ne, 1 + n), conjugated
        for r in self.sample.recordings:
            data = slice(at, at + 2 * r.frf.size)
            at = data.stop
            rows = np.column_stack([self.linear.residual[data], self.linear.Q[data]])  # real, imaginary part in turn
            self.columns.append((rows[0::2] - 1j * rows[1::2]).reshape(len(r.s), r.frf[0].size, -1))

    def best(self, variants: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The most promising variants, one for every word (an axis) among the parameters."""
        alike: dict[tuple[Any, ...], list[Hypothesis]] = {}
        for hypothesis in variants:
            values = hypothesis.entries[0].values
            own = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items() if key != "frequency_hz"}
            alike.setdefault(tuple(own.items()), []).append(hypothesis)
        scores: dict[str, tuple[float, Hypothesis]] = {}
        for some in alike.values():
            gains = self._gains(some)
            words, k = some[0].entries[0].values["axis"], int(np.argmax(gains))
            if words not in scores or gains[k] > scores[words][0]:
                scores[words] = float(gains[k]), some[k]
        box = np.array([h.entries[0].values["position"] for h in variants])
        for words in scores:
            some = next(group for group in alike.values() if group[0].entries[0].values["axis"] == words)
            scores[words] = max(scores[words], self._light(some, box), key=lambda item: item[0])
        ranked = sorted(scores.values(), key=lambda item: -item[0])
        return [hypothesis for _, hypothesis in ranked[:SCANNED_KEPT]]

    def _light(self, variants: Sequence[Hypothesis], box: FloatArray) -> tuple[float, Hypothesis]:
        """The best of resonators that are too light to load the robot, anywhere in a box around places (k, 3).

        Such a one changes H by −m s² (2ζω s + ω²)/(s² + 2ζω s + ω²) H_re H_ee′. How its point moves along its axis is
        linear in the point, u = u₀ + t₁ u₁ + t₂ u₂: six products of receptances hold every place. Lightly damped ones
        answer in a line or two, so frequencies are half a width apart. Most are judged without the room that the
        current model makes. That room is counted for the best of them, and for those of usual damping.

        Args:
            variants: that differ in frequency alone; of them and of all places, frequencies between and dampings the
                best is returned, with its gain.
        """
        low, high = box.min(axis=0), box.max(axis=0)
        values = variants[0].entries[0].values
        e = "xyz".index(values["axis"])
        across_e = [k for k in range(3) if k != e]
        size = np.maximum((high - low)[across_e], PLACED)
        steps = [np.linspace(0, 1, 1 + int(np.ceil(d / PLACED))) for d in size]
        t1, t2 = (t.ravel() for t in np.meshgrid(*steps))
        form = np.stack([np.ones_like(t1), 2 * t1, 2 * t2, t1**2, 2 * t1 * t2, t2**2], axis=1)  # (places, 6)
        squares = (form[:, :, None] * form[:, None]).reshape(len(form), 36).T
        corners = [low, *(low + d * np.eye(3)[k] for k, d in zip(across_e, size, strict=True))]
        zeta, frequency = self._peaks(variants)
        flat = [self._products(variants[0].site, corners, e, k) for k in range(len(self.columns))]  # (nf, 6, nr ne)
        seen = [one @ columns for one, columns in zip(flat, self.columns, strict=True)]  # (nf, 6, 1 + n)
        rest = [one[:, :, 0] - one[:, :, 1:] @ self.linear.own for one in seen]
        both = [(one.conj() @ one.swapaxes(1, 2)).real.reshape(len(one), 36) for one in flat]

        def factors_of(some: NDArray[np.intp]) -> list[ComplexArray]:
            omega, width = 2 * np.pi * frequency[some, None], zeta[some, None]
            give = [2 * width * omega * r.s + omega**2 for r in self.sample.recordings]
            return [-(r.s**2) * g / (r.s**2 + g) for r, g in zip(self.sample.recordings, give, strict=True)]

        def sums(factor: Sequence[ComplexArray]) -> tuple[FloatArray, FloatArray]:
            along = sum((f @ one).real for f, one in zip(factor, rest, strict=True))
            across = sum(np.abs(f) ** 2 @ one for f, one in zip(factor, both, strict=True))
            return np.asarray(along @ form.T), np.asarray(across)

        along, across = sums(factors_of(np.arange(len(zeta))))
        whole = across @ squares
        crude = _signed_gain(along, whole, whole).max(axis=1)
        kept = np.union1d(np.argsort(-crude)[:PEAKS_KEPT], np.arange(len(variants)))
        shares = np.zeros((len(kept), 6, len(self.linear.own)))
        for one, f in zip(seen, factors_of(kept), strict=True):
            shares += (f @ one[:, :, 1:].reshape(len(one), -1)).real.reshape(shares.shape)
        room = (shares @ shares.swapaxes(1, 2)).reshape(len(kept), 36)
        gain = _signed_gain(along[kept], whole[kept], (across[kept] - room) @ squares)  # (m, places)
        best, place = np.unravel_index(int(np.argmax(gain)), gain.shape)
        position = low + 0.5 * (high - low)
        position[across_e] = low[across_e] + size * (t1[place], t2[place])
        at = kept[best]
        there = {"frequency_hz": float(frequency[at]), "damping_ratio": float(zeta[at]), "position": position.tolist()}
        first = variants[0]
        found = entry_hypothesis(self.setting.base, first.effect, first.site, {**values, **there})
        return float(gain[best, place]), found

    def _peaks(self, variants: Sequence[Hypothesis]) -> tuple[FloatArray, FloatArray]:
        """Damping ratios and frequencies, Hz, of light resonators: those of the variants first, then every half width.

        Dampings are the usual one and a prior deviation less or more.
        """
        values, law = variants[0].entries[0].values, CATALOGUE[variants[0].effect]
        given = np.array([h.entries[0].values["frequency_hz"] for h in variants])
        spread_of = next(p.spread for p in law.parameters if p.name == "damping_ratio")
        zeta, frequency = [np.full(len(given), values["damping_ratio"])], [given]
        for deviation in (-1.0, 0.0, 1.0):
            width = values["damping_ratio"] * float(np.exp(deviation * spread_of))
            frequency.append(np.geomspace(given[0], given[-1], 1 + int(np.ceil(np.log(given[-1] / given[0]) / width))))
            zeta.append(np.full(len(frequency[-1]), width))
        return np.concatenate(zeta), np.concatenate(frequency)

    def _products(self, site: str, corners: Sequence[FloatArray], e: int, k: int) -> ComplexArray:
        """Weighted products (nf, 6, nr ne) of how three corners move along an axis: of u₀, u₁ and u₂ in pairs."""
        r, weight = self.sample.recordings[k], self.objective.weight[k]
        nr, ne = len(r.setup.response.label), len(r.setup.excitation.label)
        moved = [self._at(site, tuple(corner))[k] for corner in corners]
        out = np.stack([X[:, :nr, ne + e] for X in moved])
        into = np.stack([X[:, nr + e, :ne] for X in moved])
        out[1:] -= out[0]
        into[1:] -= into[0]
        pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        found = [
            0.5 * (out[i][:, :, None] * into[j][:, None] + out[j][:, :, None] * into[i][:, None]) for i, j in pairs
        ]
        scale = weight * (r.s**r.power)[:, None, None]
        return np.stack([scale * one for one in found], axis=1).reshape(len(r.s), 6, -1)

    def _at(self, site: str, place: tuple[float, ...]) -> list[ComplexArray]:
        """Receptances with a point's axes, kept."""
        if (site, place) not in self.seen:
            self.seen[site, place] = self._receptance(site, place)
        return self.seen[site, place]

    def _gains(self, variants: Sequence[Hypothesis]) -> FloatArray:
        """What each promises (m,), its amplitude free and signed: resonators that differ in frequency alone."""
        own = self.linear.own
        along, across = np.zeros(len(variants)), np.zeros(len(variants))
        shares = np.zeros((len(variants), len(own)))
        for k, columns in enumerate(self.columns):
            held, sprung, factor = self._secants(variants, k)
            flat = np.stack([held, sprung], axis=1).reshape(len(held), 2, -1)
            seen = flat @ columns  # (nf, 2, 1 + n)
            products = flat.conj() @ flat.swapaxes(1, 2)  # (nf, 2, 2)
            found = seen[:, 0].sum(axis=0).real + (factor @ seen[:, 1]).real
            along += found[:, 0]
            shares += found[:, 1:]
            across += products[:, 0, 0].real.sum() + 2 * (factor @ products[:, 0, 1]).real
            across += np.abs(factor) ** 2 @ products[:, 1, 1].real
        along -= shares @ own
        return _signed_gain(along, across, across - np.sum(shares**2, axis=1))

    def _secants(self, variants: Sequence[Hypothesis], k: int) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Change of the weighted FRFs of a recording by resonators of their usual mass.

        It is the first result (nf, nr, ne), common to all, plus the second (nf, nr, ne) times the third (m, nf), each
        one's own.
        """
        values = variants[0].entries[0].values
        mass, place = values["mass"], tuple(values["position"])
        r, X, weight = self.sample.recordings[k], self._at(variants[0].site, place)[k], self.objective.weight[k]
        nr, ne = len(r.setup.response.label), len(r.setup.excitation.label)
        out, into, own = X[:, :nr, ne:], X[:, nr:, :ne], X[:, nr:, ne:]
        free = (1 / (mass * r.s**2))[:, None, None] * np.eye(3)
        held = np.linalg.inv(free + own)  # B
        e = "xyz".index(values["axis"])
        omega = 2 * np.pi * np.array([h.entries[0].values["frequency_hz"] for h in variants])[:, None]
        give = 1 / (mass * (2 * values["damping_ratio"] * omega * r.s + omega**2))  # δ
        sprung = (out @ held[:, :, [e]]) @ (held[:, [e]] @ into)
        scale = weight * (r.s**r.power)[:, None, None]
        return -scale * (out @ held @ into), scale * sprung, np.asarray(give / (1 + give * held[:, e, e]))

    def _receptance(self, body: str, place: tuple[float, ...]) -> list[ComplexArray]:
        """Receptances with the point's three axes as further responses and excitations."""
        found = []
        values = self.objective.parameters.values(self.setting.z)
        robot = self.objective.parameters.apply(self.objective.robot, values)
        for r in self.sample.recordings:
            setup = replace(
                r.setup, response=_with_point(r.setup.response, body, place),
                excitation=_with_point(r.setup.excitation, body, place),
            )  # fmt: skip
            seen, model = observe(robot, setup, self.objective.parameters, values)
            found.append(r.probed(3).respond(seen, model))
        return found


def _signed_gain(along: FloatArray, whole: FloatArray, left: FloatArray) -> FloatArray:
    """χ² that a change gains at its best amplitude, negative where that is; none where little of the whole is left.

    Nor where the whole is next to nothing beside the largest: a point on a joint's axis, which does not move.
    """
    shown = left > IMITATED * np.maximum(whole, np.max(whole, initial=0.0) * IMITATED)
    return np.where(shown, along * np.abs(along) / np.where(shown, left, 1.0), 0.0)


def _with_point(channels: Channels, body: str, place: Sequence[float]) -> Channels:
    return replace(
        channels,
        label=(*channels.label, *(f"0{axis}+" for axis in "XYZ")),
        body=(*channels.body, body, body, body),
        position=np.vstack([channels.position, np.tile(place, (3, 1))]),
        direction=np.vstack([channels.direction, np.eye(3)]),
    )
