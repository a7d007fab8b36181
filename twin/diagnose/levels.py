"""Force levels that disagree: at which joint, and by which law of amplitude.

In the decay after a blow, a nonlinear joint looks linear. Its stiffness and damping depend on how far that blow
deflects it. So every blow gets a complex stiffness of its own at one joint, k_b + iω c_b. Everything else is common to
all blows. The site is the joint for which that explains the recordings. k_b and c_b over the deflection show the law to
a person. Laws stepped in time (``twin.model.blow``) tell which law it is, and its numbers. They are fitted with
everything else free, and judged by the same evidence as linear hypotheses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision, decide, unexplained
from twin.diagnose.hypotheses import Hypothesis, together
from twin.diagnose.refit import NONE, Fitted, descend
from twin.identify.descent import minimise
from twin.identify.joint_reaction import PULSE_SPREAD, BlowByBlow, Stepped, inverse2
from twin.identify.objective import Sample
from twin.measure.blows import FADED, PULSE_S, Blow, blows
from twin.measure.campaign import Campaign, FloatArray
from twin.model.blow import COARSE_HZ, RATE_HZ
from twin.model.joint_laws import NAMELESS
from twin.model.parameters import Parameter, Parameters
from twin.model.recorded import Recorded
from twin.model.sensitivity import frf, observe
from twin.parallel import spread
from twin.physics import CATALOGUE, amplitude_laws
from twin.physics.joint_law import USUAL_DEFLECTION, Law
from twin.robot.description import Entry, Robot

RACE_LINES, FEW_BLOWS = 30, 6  # lines of locating and of the race of laws; excitations of the race
FINAL_LINES, BLOWS = 40, 12  # lines and excitations that finalists are fitted to
MOST_ALIKE = 3  # sizes whose equivalent stiffnesses are most like those seen: a law's start is one of them
SITES, SITE_REACH, LAW_REACH, NEAR_LAWS = 2, 1.3, 4.0, 1.5  # sites, laws racing and at their end, in reach of the best
FAR_OFF = 10.0  # χ² per datum above which the last digit of a wrong model says nothing
WINDOW = 5.0  # 1/s, exponential window put on recordings that are not smooth
ROUGH_TEMPERS, ROUGH_REACH = (0.3, 0.1, 0.03), 1.5
FALLING_ERRORS = (0.1, 0.03, 0.01, 0.0)  # relative model error, falling as long as something explains the recordings
EXPLAINS, SMOOTH_ERROR = (
    1.0,
    0.03,
)  # χ² per datum below which it does; model error at which recordings are smooth enough
WHOLE_TEMPERS, HOLDS = (0.1, 0.03, 0.01), 0.01  # of whole decays; the model error at which a law holds there
LOCATING, ROUGH_STEPS, RACING, LAST, CLOSE_STEPS, SETTLING_STEPS, LINEAR_STEPS = 8, 10, 4, 8, 5, 10, 15  # iterations
FIRST_STEPS = 3  # of the rough ones: those that are then out of reach of the best go no further
ROUGH_GAIN, COARSE_GAIN, FINE_GAIN = 0.3, 0.5, 0.1  # in ln likelihood: less is not waited for


@dataclass(frozen=True)
class Located:
    """One joint with a complex stiffness for every blow.

    Attributes:
        site: ``joint2.z``.
        cost: of the fit; ``z`` (n,) where the common parameters ended.
        own: per recording (2, ne) stiffness and damping beside the joint's; ``certainty`` (2, 2, ne).
    """

    site: str
    cost: float
    z: FloatArray
    own: list[FloatArray]
    certainty: list[FloatArray]


Trial = tuple[Stepped, Hypothesis, FloatArray]
"""A law at a joint, and where its fit is."""


@dataclass(frozen=True)
class Levels:
    """What force levels say.

    Attributes:
        places: joints tried with a complex stiffness per blow, best first.
        fits: laws refitted on the same data as ``base``, most evidence first.
        window: 1/s, exponential window put on those data; ``temper`` the relative model error allowed.
        objectives: per fit, what predicts with it.
        whole: all lines of all blows, as the data were taken from them; ``blow`` how they were hit.
        nameless: where the best leaves something, laws without a name at its joint, fitted to the same data.
        noise: share of noise in the variance of these data, the rest being model error.
    """

    places: list[Located]
    fits: list[Fitted]
    base: Fitted
    window: float
    temper: float
    objectives: list[Stepped]
    whole: Sample
    blow: dict[str, Blow]
    nameless: list[Fitted] = field(default_factory=list)
    noise: float = 1.0


@dataclass(frozen=True)
class View:
    """Recordings under an exponential window (1/s), and how they were hit."""

    window: float
    sample: Sample
    blow: dict[str, Blow]

    def telling(self, place: Located, count: int) -> tuple[Sample, list[int]]:
        """The excitations whose blows tell most about the joint, and their indices."""
        told = sum(matrix[0, 0] for matrix in place.certainty)
        index = sorted(np.argsort(-np.asarray(told))[:count].tolist())
        return Sample(tuple(excited(r, index) for r in self.sample.recordings), self.sample.repeat), index


def view(robot: Robot, base: Parameters, z: FloatArray, sample: Sample, blow: dict[str, Blow], window: float) -> View:
    """The recordings under a further exponential window, which leaves the beginning of every decay.

    With a rough law (a gap), the smallest change of a parameter greatly changes the end of a decay. The beginning is
    smooth in all parameters, and quickly stepped. The window is a convolution along the lines. The base model at z
    supplies what lies outside the band, so that only its error is cut off at the ends.
    """
    if not window:
        return View(window, sample, blow)
    values = base.values(z)
    changed = base.apply(robot, values)
    shown = []
    for r in sample.recordings:
        seen, _ = observe(changed, r.setup, base, values)
        step = float(np.median(np.diff(r.frequency)))
        spread = step / (window + 2j * np.pi * (r.frequency[:, None] - r.frequency))
        rest = np.tensordot(spread, r.frf - frf(seen, r.s, r.power), 1)
        variance = np.tensordot(np.abs(spread) ** 2, r.variance, 1)
        wide = replace(r, s=r.s + window, frf=frf(seen, r.s + window, r.power) + rest, variance=variance)
        shown.append(wide.every(max(1, round(window / np.pi / step))))  # lines nearer than that tell the same
    shorter = {}
    for r in sample.recordings:
        length = FADED / (window + float(r.s[0].real))
        shorter[r.group] = replace(blow[r.group], length_s=min(blow[r.group].length_s, length))
    return View(window, Sample(tuple(shown)), shorter)


def explain_levels(
    campaign: Campaign,
    robot: Robot,
    base: Fitted,
    sample: Sample,
    robust: FloatArray,
    progress: Callable[[int], None] | None = None,
    processes: int = 1,
) -> Levels | None:
    """Amplitude laws fitted to a campaign whose force levels disagree.

    Args:
        campaign: with peak forces.
        robot: the description, without limits.
        base: the base model's optimum on these recordings.
        sample: all lines of what is fitted to.
        robust: (n,) the base model's optimum of the logarithmic residual.
        progress: called with 1 after every joint located and every law fitted.
        processes: the work is spread over so many.

    Returns:
        ``None`` where peak forces are not recorded, or no joint has a spring.
    """
    blow = blows(campaign)
    sprung = [f"joint{i + 1}.z" for i, axis in enumerate(robot.axes) if axis.stiffness is not None]
    if blow is None or not sprung:
        return None
    tick = progress or (lambda count: None)
    starts = [base.z, robust, np.zeros(len(robust))]
    places, temper = locate(robot, base.parameters, starts, sample.thin(RACE_LINES), sprung, tick, processes)
    window = 0.0 if temper <= SMOOTH_ERROR else WINDOW
    seen = view(robot, base.parameters, robust, sample, blow, window)
    near = [place for place in places if place.cost < SITE_REACH * places[0].cost][:SITES]
    if window:
        trials, temper = _rough_race(robot, base, places if temper == 1 else near, seen, starts[1:], tick, processes)
        few = View(0.0, sample.thin(RACE_LINES), blow).telling(_at(trials, places), BLOWS)[0]
        whole, left = _race(_begun(trials, few, blow, processes), WHOLE_TEMPERS, tick, processes, LAST, hopeful=True)
        if left <= HOLDS:  # a law that holds to the ends of the decays tells more there
            trials, temper, window, seen = whole, 0.0, 0.0, View(0.0, sample.thin(FINAL_LINES), blow)
    else:
        short = replace(seen, sample=sample.thin(RACE_LINES))
        trials = [trial for place in near for trial in _starts(robot, base, place, short)]
        trials, temper = _race(trials, FALLING_ERRORS, tick, processes)
        seen, temper = replace(seen, sample=sample.thin(FINAL_LINES)), 0.0  # what a law leaves unexplained must show
    best = _at(trials, places)
    told = seen.telling(best, BLOWS)[0]
    data = _tempered(told, temper)
    objectives = [replace(t[0], sample=data, rate_hz=RATE_HZ, processes=processes) for t in trials]
    fits = _fitted_closely([(o, *trial[1:]) for o, trial in zip(objectives, trials, strict=True)], processes)
    least = min(fit.cost for fit in fits)
    order = sorted(range(len(fits)), key=lambda k: -fits[k].evidence())
    nameless = []
    if temper or fits[order[0]].misfit > calibration()["noise_misfit"]:
        rivals = _starts(robot, base, best, replace(seen, sample=seen.sample.thin(RACE_LINES)), NAMELESS)
        rivals = [(replace(t[0], sample=data, rate_hz=RATE_HZ, processes=processes), *t[1:]) for t in rivals]
        nameless = [
            fit_law(trial[0], fit.hypothesis, fit.z) if fit.cost < NEAR_LAWS * least and fit.misfit < FAR_OFF else fit
            for trial, fit in zip(rivals, _fitted_roughly(rivals, processes, LAW_REACH * least), strict=True)
            if np.isfinite(fit.cost)  # one that cannot be stepped is no rival
        ]
    tempered, begun = (15, starts[:2]) if window else (0, starts[:1])  # an optimum on all lines nearly is on some

    def base_again(number: int) -> Fitted:
        return descend(
            robot, base.hypothesis, base.parameters, data, begun[number],
            tempered=tempered, linear=LINEAR_STEPS, hopeless=LAW_REACH * least,
        )  # fmt: skip

    again = min(spread(base_again, len(begun), processes), key=lambda fit: fit.cost)
    everything, how = (seen.sample, seen.blow) if window else (sample, blow)
    return Levels(
        places, [fits[k] for k in order], again, window, temper, [objectives[k] for k in order],
        _tempered(everything, temper), how, nameless, _noise_share(told, data),
    )  # fmt: skip


def _at(trials: Sequence[Trial], places: Sequence[Located]) -> Located:
    """The joint of the best trial."""
    return next(place for place in places if place.site == trials[0][1].site)


def decide_levels(levels: Levels) -> Decision:
    """Probabilities of the laws, of nothing and of something else; every law at every joint was looked at.

    A law without a name has the prior of one with a name: a name is given only where it beats these.
    """
    looked_at = [[Hypothesis(law.effect, place.site)] for law in amplitude_laws() for place in levels.places]
    # where a model error had to be allowed, a law must explain more than that alone would
    other = unexplained(levels.base.misfit, levels.fits[0].misfit, levels.noise) if levels.temper else None
    decision = decide(levels.fits, levels.base, looked_at, other=other)
    if not (levels.nameless and decision.probability):
        return decision
    scale = max(1.0, min(fit.misfit for fit in (*levels.fits, *levels.nameless)))
    gain = max(fit.evidence(scale) for fit in levels.nameless) - decision.ranked[0].evidence(scale)
    odds = np.exp(np.clip(gain / calibration()["temperature"], -200, 200))
    weight = max(decision.probability[0], 1e-6) * odds
    share = float(1 / (1 + weight))
    return replace(
        decision, probability=[share * p for p in decision.probability], none=share * decision.none,
        other=1 - share * (1 - decision.other), nameless=1 - share,
    )  # fmt: skip


def locate(
    robot: Robot,
    parameters: Parameters,
    starts: Sequence[FloatArray],
    sample: Sample,
    sites: Sequence[str],
    tick: Callable[[int], None],
    processes: int = 1,
) -> tuple[list[Located], float]:
    """Joints, each tried with a complex stiffness for every blow, lowest cost first, and a model error.

    It is the least model error at which the best joint explains the recordings, 1 where it does not.
    """
    ends: dict[str, FloatArray] = {}
    for site in sites:
        rough = BlowByBlow(robot, parameters, sample, FALLING_ERRORS[0], site=site)
        ends[site] = min(starts, key=rough.cost)
    found: list[Located] = []
    reached, data = 1.0, BlowByBlow(robot, parameters, sample).data
    for temper in FALLING_ERRORS:

        def at(number: int, temper: float = temper) -> Located:
            site = sites[number]
            objective = BlowByBlow(robot, parameters, sample, temper, site=site)
            z, cost, _, _ = minimise(objective, ends[site], LOCATING, ROUGH_GAIN)
            objective(z)
            return Located(site, cost, z, objective.own, objective.certainty)

        here = []
        for place in spread(at, len(sites), processes):
            here.append(place)
            ends[place.site] = place.z
            tick(1)
        here.sort(key=lambda item: item.cost)
        if found and 2 * here[0].cost > EXPLAINS * data and temper:
            break
        found = here
        if 2 * here[0].cost > EXPLAINS * data:
            break
        reached = temper
    return found, reached


def _starts(robot: Robot, base: Fitted, place: Located, shown: View, laws: Sequence[Law] | None = None) -> list[Trial]:
    """Laws at a joint, with the sizes whose equivalent stiffnesses are most like those seen."""
    some, index = shown.telling(place, FEW_BLOWS)
    values, names = base.parameters.values(place.z), base.parameters.names
    row, damper = (names.index(f"{place.site}.{what}") for what in ("stiffness", "damping"))
    k, c = values[row], values[damper]
    seen = [u[:, index] for u in place.own]
    certainty = [matrix[:, :, index] for matrix in place.certainty]
    trials = []
    for law in amplitude_laws() if laws is None else laws:
        objective, hypothesis = with_law(robot, base, law, place.site, some, shown.blow)
        amplitude = _amplitude(objective, place.z)
        objective = replace(objective, law=law.at(amplitude), rate_hz=COARSE_HZ)
        sizes = law.sizes(k, amplitude)
        least = np.array([-0.8 * k, -0.9 * c])
        scored = [
            (*_likeness(seen, certainty, found, least), size)
            for size, found in zip(sizes, objective.equivalents(place.z, list(sizes)), strict=True)
        ]
        points = []
        for score, shift, size in sorted(scored, key=lambda item: item[0])[:MOST_ALIKE]:
            start = values.copy()
            start[[row, damper]] += shift if np.isfinite(score) else 0.0
            points.append(point(objective, start, size))
        # the joint's rest under its load, and with it the law, moves with the spring
        trials.append((objective, hypothesis, points[int(np.argmin(objective.costs(points)))]))
    return trials


def _amplitude(objective: Stepped, z: FloatArray) -> float:
    """How far blows deflect the joint, the usual way where they cannot be stepped there."""
    found = objective.deflection(z)
    return found if np.isfinite(found) else USUAL_DEFLECTION


def point(objective: Stepped, values: FloatArray, sizes: FloatArray) -> FloatArray:
    """Coordinates of a base model's values with a law of given sizes, blows of usual length."""
    rest = len(objective.parameters) - len(values) - len(sizes)
    return objective.parameters.coordinates(np.concatenate([values, sizes, [PULSE_S] * rest]))


def _rough_race(
    robot: Robot,
    base: Fitted,
    places: Sequence[Located],
    shown: View,
    starts: Sequence[FloatArray],
    tick: Callable[[int], None],
    processes: int,
) -> tuple[list[Trial], float]:
    """The same for blows that no complex stiffness fits: every law at every joint by its logarithmic residual."""
    few = {place.site: shown.telling(place, FEW_BLOWS)[0] for place in places}
    begun = [(law, place, z) for place in places for law in amplitude_laws() for z in (*starts, place.z)]

    def first(number: int) -> tuple[Law, FloatArray, float]:
        law, place, z = begun[number]
        objective, _ = with_law(robot, base, law, place.site, few[place.site], shown.blow)
        amplitude = _amplitude(objective, z)
        objective = replace(objective, law=law.at(amplitude), logarithmic=True, rate_hz=COARSE_HZ)
        values = base.parameters.values(z)
        k = values[base.parameters.names.index(f"{place.site}.stiffness")]
        points = [point(objective, values, size) for size in law.sizes(k, amplitude)]
        end, cost, _, _ = minimise(objective, points[int(np.argmin(objective.costs(points)))], FIRST_STEPS, ROUGH_GAIN)
        return objective.law, end, cost

    tried = []
    for (_, place, _), (law, z, cost) in zip(begun, spread(first, len(begun), processes), strict=True):
        objective, hypothesis = with_law(robot, base, law, place.site, few[place.site], shown.blow)
        tried.append((cost, (replace(objective, law=law, rate_hz=COARSE_HZ), hypothesis, z)))
        tick(1)
    least = min(cost for cost, _ in tried)
    near = [trial for cost, trial in tried if cost <= LAW_REACH * least]

    def further(number: int) -> tuple[FloatArray, float]:
        objective, _, z = near[number]
        return minimise(replace(objective, logarithmic=True), z, ROUGH_STEPS - FIRST_STEPS, ROUGH_GAIN)[:2]

    ends: list[tuple[float, Trial]] = []
    for trial, (z, cost) in zip(near, spread(further, len(near), processes), strict=True):
        ends.append((cost, (*trial[:2], z)))
    best: dict[str, tuple[float, Trial]] = {}
    for cost, trial in sorted(ends, key=lambda item: item[0]):
        best.setdefault(trial[1].key, (cost, trial))
    reach = ROUGH_REACH * min(cost for cost, _ in ends)
    trials = [trial for cost, trial in best.values() if cost <= reach]
    trials, temper = _race(trials, ROUGH_TEMPERS, tick, processes)
    return trials, min(temper, ROUGH_TEMPERS[0])


def _begun(trials: Sequence[Trial], sample: Sample, blow: dict[str, Blow], processes: int) -> list[Trial]:
    """Laws that were fitted under a window, for whole decays: they begin by the logarithmic residual of these.

    A window mixes lines that lie beside each other, and those beyond the band are not recorded. A fit that is closer
    than that allows has moved away from the truth, and the way back leads through a worse fit.
    """
    whole = [(replace(objective, sample=sample, blow=blow), law, z) for objective, law, z in trials]

    def begin(number: int) -> FloatArray:
        objective, _, z = whole[number]
        return minimise(replace(objective, logarithmic=True), z, ROUGH_STEPS, ROUGH_GAIN)[0]

    ends = spread(begin, len(whole), processes)
    return [(objective, law, z) for (objective, law, _), z in zip(whole, ends, strict=True)]


def with_law(
    robot: Robot, base: Fitted, law: Law, site: str, sample: Sample, blow: dict[str, Blow], beside: Hypothesis = NONE
) -> tuple[Stepped, Hypothesis]:
    """A base model with a law at a joint, ``beside`` something linear, and what that says is missing."""
    described = float(robot.axes[int(site[5:-2]) - 1].stiffness or 0.0)
    entry = Entry(effect=law.effect, site=site, **law.entry(law.usual(described)))
    key = f"{law.effect}@{site}" if law.effect in CATALOGUE else f"{law.effect} at {site}"  # no entry without a name
    own = _own(law, key, law.usual(described))
    if not all(b.known for b in blow.values()):
        own += (Parameter(f"{key}.pulse", "s", "entry", True, PULSE_S, PULSE_SPREAD, "a rubber tip"),)
    hypothesis = together(beside, Hypothesis(law.effect, site, (entry,), own))
    parameters = hypothesis.parameters(base.parameters)
    stepped = Stepped(beside.robot(robot), parameters, sample, law=law, site=site, blow=blow)
    return stepped, hypothesis


def _own(law: Law, key: str, usual: FloatArray) -> tuple[Parameter, ...]:
    """A law's sizes as parameters of an entry ``EFFECT@SITE``, their priors log-normal about the usual ones."""
    return tuple(
        Parameter(f"{key}.{name}", unit, "entry", True, float(mean), deviation, "usual size")
        for name, unit, mean, deviation in zip(law.names, law.units, usual, law.deviations, strict=True)
    )


def _race(
    trials: list[Trial],
    tempers: Sequence[float],
    tick: Callable[[int], None],
    processes: int,
    iterations: int = RACING,
    *,
    hopeful: bool = False,
) -> tuple[list[Trial], float]:
    """The laws that stay in reach of the best while the model error allowed falls, best first, and the least error.

    That is the least error at which one of the laws explains the recordings, 1 where none does. With ``hopeful``, only
    laws that explain them are of use: one that does not promise to is given up.
    """
    reached, enough = 1.0, 0.5 * EXPLAINS * trials[0][0].data
    for temper in tempers:

        def run(number: int, temper: float = temper, trials: list[Trial] = trials) -> tuple[FloatArray, float]:
            objective, _, z = trials[number]
            objective = replace(objective, sample=_tempered(objective.sample, temper))
            return minimise(objective, z, iterations, ROUGH_GAIN, enough if hopeful else np.inf)[:2]

        ends: list[tuple[float, Trial]] = []
        for trial, (z, cost) in zip(trials, spread(run, len(trials), processes), strict=True):
            if np.isfinite(cost):
                ends.append((cost, (*trial[:2], z)))
            tick(1)
        if not ends:  # none can be stepped
            break
        ends.sort(key=lambda item: item[0])
        explained = ends[0][0] < enough
        if explained or reached == 1:  # all that explain as much as is asked stay: they may only have begun
            trials = [trial for cost, trial in ends if cost < max(enough, LAW_REACH * ends[0][0])]
        if not explained:
            break
        reached = temper
    return trials, reached


def excited(r: Recorded, index: Sequence[int]) -> Recorded:
    """The recording of some excitations."""
    channels = r.setup.excitation
    keep = replace(
        channels, label=tuple(channels.label[k] for k in index), body=tuple(channels.body[k] for k in index),
        position=channels.position[index], direction=channels.direction[index],
    )  # fmt: skip
    setup = replace(r.setup, excitation=keep)
    return replace(r, setup=setup, frf=r.frf[:, :, index], variance=r.variance[:, :, index])


def _tempered(sample: Sample, temper: float) -> Sample:
    """The recordings with a model error added to their noise: relative, at antiresonances to the channel's mean."""
    if not temper:
        return sample
    shown = []
    for r in sample.recordings:
        power = np.abs(r.frf) ** 2
        shown.append(replace(r, variance=r.variance + 0.5 * temper**2 * (power + power.mean(axis=0))))
    return Sample(tuple(shown), sample.repeat)


def _noise_share(sample: Sample, tempered: Sample) -> float:
    """Mean share of the noise in a tempered variance, over lines that are used."""
    used = [np.isfinite(r.variance) for r in tempered.recordings]
    noise, allowed = (
        np.concatenate([r.variance[here] for r, here in zip(s.recordings, used, strict=True)])
        for s in (sample, tempered)
    )
    return float(np.mean(noise / allowed))


def _fitted_roughly(trials: Sequence[Trial], processes: int, hopeless: float = np.inf) -> list[Fitted]:
    """Laws after a few coarse iterations; given up where they do not promise a cost below ``hopeless``."""

    def run(number: int) -> Fitted:
        objective, hypothesis, z = trials[number]
        objective = replace(objective, processes=1)
        z, *_ = minimise(replace(objective, rate_hz=COARSE_HZ), z, LAST, COARSE_GAIN, hopeless)
        return _fitted(objective, hypothesis, *minimise(replace(objective, rate_hz=RATE_HZ), z, 0, 0))

    return list(spread(run, len(trials), processes))


def _fitted_closely(trials: Sequence[Trial], processes: int) -> list[Fitted]:
    """Laws, the most promising first: roughly, then the best and those near it closely."""
    fits = _fitted_roughly(trials[:1], processes)
    fits += _fitted_roughly(trials[1:], processes, LAW_REACH * fits[0].cost)
    least = min(fit.cost for fit in fits)
    return [
        fit_law(trial[0], fit.hypothesis, fit.z)
        if fit.cost == least or (fit.cost < NEAR_LAWS * least and fit.misfit < FAR_OFF)
        else fit
        for trial, fit in zip(trials, fits, strict=True)
    ]


def fit_law(objective: Stepped, hypothesis: Hypothesis, z: FloatArray) -> Fitted:
    """Fit a law from z, finely stepped."""
    fine = replace(objective, rate_hz=RATE_HZ, closely=True)
    return _fitted(objective, hypothesis, *minimise(fine, z, CLOSE_STEPS, COARSE_GAIN))


def settled(
    levels: Levels, fit: Fitted, objective: Stepped, sample: Sample, blow: dict[str, Blow]
) -> tuple[Fitted, Stepped]:
    """A fit carried on over all lines of its blows: what it says of recordings it has not seen hangs on every one.

    Args:
        levels: what it was found from; ``objective`` what predicts with it.
        sample: recordings as they are; ``blow`` how each was hit.

    Returns:
        The fit, and what predicts with it.

    Where the law was found under a window and does not hold to the ends of the decays, the window stays.
    """
    labels = {r.group: r.setup.excitation.label for r in objective.sample.recordings}
    hypothesis, z = fit.hypothesis, fit.z
    if (law := objective.law.settling()) is not objective.law:
        hypothesis, parameters, z = _settling(law, len(objective.law.names), fit, levels.base.parameters)
        objective = replace(objective, law=law, parameters=parameters)

    def all_of(sample: Sample, blow: dict[str, Blow], temper: float = 0.0) -> Stepped:
        told = [
            excited(r, [k for k, label in enumerate(r.setup.excitation.label) if label in labels[r.group]])
            for r in sample.recordings
        ]
        data = _tempered(Sample(tuple(told), sample.repeat), temper)
        return replace(objective, sample=data, blow=blow, rate_hz=RATE_HZ, closely=True)

    every = all_of(sample, blow)
    if levels.window:
        allowed = all_of(sample, blow, HOLDS)
        if not 2 * allowed.cost(z) <= EXPLAINS * allowed.data:
            every = all_of(levels.whole, levels.blow)
    return _fitted(every, hypothesis, *minimise(every, z, SETTLING_STEPS, FINE_GAIN)), every


def _settling(law: Law, known: int, fit: Fitted, free: Parameters) -> tuple[Hypothesis, Parameters, FloatArray]:
    """A fit's hypothesis, parameters and coordinates with those sizes of a law that come after the ``known`` ones."""
    *others, piece = fit.hypothesis.pieces
    added = _own(law, piece.own[0].name.rpartition(".")[0], law.usual(1.0))[known:]
    own = (*piece.own[:known], *added, *piece.own[known:])
    hypothesis, at = together(*others, replace(piece, own=own)), len(fit.z) - len(piece.own) + known
    parameters = hypothesis.parameters(free)
    values = np.concatenate([fit.values[:at], [p.mean for p in added], fit.values[at:]])
    return hypothesis, parameters, parameters.coordinates(values)


def _fitted(
    objective: Stepped, hypothesis: Hypothesis, z: FloatArray, cost: float, information: FloatArray, converged: bool
) -> Fitted:
    parameters, n = objective.parameters, len(objective.base)
    values, data = parameters.values(z), objective.data
    law = hypothesis.pieces[-1]
    entry = Entry(effect=law.effect, site=law.site, **objective.law.entry(*objective.own(z)))
    robot = objective.base.apply(objective.robot, values[:n])
    robot = robot.model_copy(update={"physics": [*robot.physics, entry]})
    return Fitted(
        hypothesis, parameters, z, values, robot, cost, (2 * cost - float(z @ z)) / max(data, 1), information, data,
        converged,
    )  # fmt: skip


def _likeness(
    seen: Sequence[FloatArray], certainty: Sequence[FloatArray], found: Sequence[FloatArray], least: FloatArray
) -> tuple[float, FloatArray]:
    """How far a law's equivalents are from those seen, and the best shift (2,) of the joint's own spring.

    The shift is no less than ``least``: a spring stays a spring, whatever a law adds at rest.
    """
    gap = np.concatenate([a - b for a, b in zip(seen, found, strict=True)], axis=1)
    spread = np.concatenate(list(seen), axis=1).std(axis=1)
    tolerance = np.diag((0.1 * spread + 1e-12) ** 2)
    matrices = np.concatenate([inverse2(matrix) for matrix in certainty], axis=2) + tolerance[:, :, None]
    weight = inverse2(matrices)
    shift = np.maximum(np.linalg.solve(weight.sum(axis=2), np.einsum("pqe,qe->p", weight, gap)), least)
    left = gap - shift[:, None]
    score = float(np.einsum("pe,pqe,qe->", left, weight, left))
    return (score if np.isfinite(score) else np.inf), shift
