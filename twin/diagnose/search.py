"""From the base model to the few hypotheses that explain a hammer test, one missing thing after the other.

A round takes what is believed so far, screens what else could be missing, and refits what promises most. Rounds go on
as long as the evidence grows. Then every thing found is taken out in turn, and the round is repeated with the others in
place. One thing may have been found instead of another. All finalists end on all lines, at convergence.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.cannot_be import carrier_at, may_be
from twin.diagnose.departures import far_off
from twin.diagnose.described import described
from twin.diagnose.hypotheses import Hypothesis, companions, entry_hypothesis, fuller, merged, same_axes, together
from twin.diagnose.locate import free_laws
from twin.diagnose.parted import divided, on_a_described_link
from twin.diagnose.patience import Patience
from twin.diagnose.refit import CRAWLING, NONE, Fitted, descend, of_its_size
from twin.diagnose.screen import FAR, SLIGHT, Promise, Setting, inflation, model_error, screen
from twin.diagnose.sensor_weight import weightless
from twin.diagnose.within import allowed, members, turned
from twin.identify.descent import LACKING, minimise
from twin.identify.elastic import AGREEMENT
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, Parameters, written_names
from twin.model.sensitivity import observe_all, poles
from twin.parallel import Progress, spread
from twin.physics import CATALOGUE
from twin.robot.description import Robot
from twin.robot.frames import between_links

SCREEN_LINES, REFIT_LINES, NEAR_LINES = 25, 50, 100
COMPARED, REFITTED_BEST, FEWEST = 12, 6, 3
RACE = 0.08  # of the best gain: less promises nothing
WITHIN = 40.0  # in ln evidence: what is worth converging
MISSING_AT_ONCE = 3  # things missing at once
THINNED_COST = 1.05  # on few lines a cost differs from that on all by so much
SHORT = 0.2  # of what another has gained: less promised is not refitted
ABREAST = 2  # refits side by side, on however many cores: what is found must not depend on them
WORTH = 8.0  # ln evidence that a further thing must bring for the search to go on
FIRST_ORDER = 1.3  # χ² per datum up to which a first-order model holds to the precision of the noise
TO_THE_END = 60  # iterations for what a long valley has held up
HELD_LINKS = 2.0  # deviations, within which 19 in 20 numbers are that are as described
FURTHER = "further effects"  # left out where the time is up before no effect gains more
LIKELY = 16.0  # ln evidence behind the best within which a fit may be a rival
TUNING = ("frequency_hz", "damping_ratio")  # how something swings, wherever it hangs


@dataclass
class Search:
    """What was fitted.

    Attributes:
        base: the base model's optimum; ``others`` where other starts end elsewhere.
        robust: (n,) the base model's optimum of the logarithmic residual.
        error: relative error of the base model beyond noise.
        fits: every hypothesis fitted to all lines, by what it says is missing.
        processes: the work is spread over so many.
        laws: what a law without a name would gain beside a fit, of the fits asked.
        weighed: the fit of which the sensors' weight was taken off the recordings (:func:`weightless`).
        patience: when what is left of the search is left out.
    """

    base: Fitted
    others: list[Fitted]
    robust: FloatArray
    error: float
    fits: dict[frozenset[str], Fitted] = field(default_factory=dict)
    processes: int = 1
    laws: list[tuple[Fitted, dict[str, float]]] = field(default_factory=list)
    weighed: Fitted | None = None
    patience: Patience = field(default_factory=Patience)

    def lawless(self, fit: Fitted, sample: Sample) -> dict[str, float]:
        """:func:`free_laws` of a fit on all lines, computed once."""
        for known, gains in self.laws:
            if known is fit:
                return gains
        self.laws.append((fit, free_laws(fit, sample, processes=self.processes)))
        return self.laws[-1][1]

    @property
    def finalists(self) -> list[Fitted]:
        """Refitted hypotheses that can be, most evidence first."""
        return sorted((fit for fit in self.fits.values() if not fit.too_heavy), key=lambda fit: -fit.evidence())


def converge(
    robot: Robot,
    parameters: Parameters,
    sample: Sample,
    starts: int = 4,
    seed: int = 0,
    processes: int = 1,
    near: FloatArray | None = None,
) -> Search:
    """The base model from the description and from springs and dampers drawn from their prior.

    One more start is at ``near``. Starts that springs and dampers alone bring to one robust cost are at one optimum.
    """
    rng = np.random.default_rng(seed)
    elastic = NONE.coarse(parameters)
    few, more = sample.thin(SCREEN_LINES), sample.thin(REFIT_LINES)
    places = np.zeros((starts, len(parameters)))
    places[1:, elastic] = rng.normal(size=(starts - 1, len(elastic)))
    if near is not None:
        places = np.vstack([places, near[: len(parameters)]])
    robustly = Objective(robot, parameters, few, logarithmic=True, sagging=False)

    def roughly(number: int) -> tuple[FloatArray, float]:
        coarse = robustly.within(places[number], elastic)
        z, cost, _, _ = minimise(coarse, coarse.part(places[number]), 25, 0.5)
        return coarse.whole(z), cost

    def closely(number: int) -> tuple[FloatArray, float]:
        return minimise(robustly, apart[number][0], 25, 0.5)[:2]

    def end(number: int) -> Fitted:
        return descend(robot, NONE, parameters, more, found[number][0], tempered=8, linear=3 if far else 15)

    def on_all(fit: Fitted) -> Fitted:
        steps = 3 if error > FAR else 15  # the end may be near though the robust optimum was not
        return descend(robot, NONE, parameters, sample, fit.z, tempered=0, linear=steps, tolerance=0.02)

    apart: list[tuple[FloatArray, float]] = []
    for z, cost in sorted(spread(roughly, len(places), processes), key=lambda start: start[1]):
        if not apart or cost - apart[-1][1] > AGREEMENT:
            apart.append((z, cost))
    found = sorted(spread(closely, len(apart), processes), key=lambda start: start[1])
    robust, plain = found[0][0], Objective(robot, parameters, more)
    far = model_error(plain, robust) > FAR  # which optimum of a wrong model is the better, its last digit say nothing
    ends = sorted(spread(end, 1 if far else len(found), processes), key=lambda fit: fit.cost)
    error = model_error(plain, ends[0].z)
    base, *others = sorted([on_all(fit) for fit in ends], key=lambda fit: fit.cost)
    away = [fit.z - base.z for fit in others]
    others = [fit for fit, d in zip(others, away, strict=True) if 0.5 * d @ base.information @ d > AGREEMENT]
    return Search(base, others, robust, error, processes=processes)


def explain(
    robot: Robot,
    search: Search,
    sample: Sample,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress | None = None,
) -> Search:
    """Everything that may be missing, alone and together."""
    progress = progress or (lambda description, total: lambda count: None)
    best = _within_tolerances(robot, search, sample, suspects)
    best, sample = _one_by_one(robot, search, best, sample, suspects, progress)
    richest = max([best, *search.finalists], key=lambda fit: fit.evidence())
    best = _needed(robot, search, richest, sample)
    best = _rivals_without(robot, search, richest, best, sample)
    if not search.patience.over("more effects at the joint that gains most"):
        there = _where_it_is(robot, search, best, sample, suspects, progress)
        if worth(best, there, search):
            _needed(robot, search, there, sample)
    if not given_up(search, best):
        _in_its_stead(robot, search, sample, suspects)
        ahead = search.finalists[0] if search.finalists else best
        if worth(best, ahead, search) and not search.patience.over("effects beside what took the place of others"):
            best, sample = _one_by_one(robot, search, ahead, sample, suspects, progress)
            _needed(robot, search, best, sample)
        _fuller(robot, search, sample)
    if not search.patience.over("sensors and axes elsewhere beside each other"):
        _beside_each_other(robot, search, sample, suspects)
    return search


def _one_by_one(
    robot: Robot, search: Search, best: Fitted, sample: Sample, suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress,
) -> tuple[Fitted, Sample]:  # fmt: skip
    """The best with one missing thing after the other, and the recordings, without the weight of a sensor found."""
    answers = len(best.hypothesis.pieces) - len(allowed(best, robot))
    for number in range(answers, 2 * MISSING_AT_ONCE):
        if number - len(allowed(best, robot)) >= MISSING_AT_ONCE:
            break
        if number and search.patience.over(FURTHER):
            break
        if not search.weighed:
            best, sample = _without_weight(robot, search, best, sample)
        found = _round(robot, search, best, sample, suspects, progress)
        if best is search.base and _strained(best) and (not found or _stands_in(found[0])):
            springs = [variants for variants in suspects if variants[0].law and variants[0].law.sprung]
            more = _round(robot, search, best, sample, springs, progress, held=True)
            found = sorted([*found, *more], key=lambda fit: -fit.evidence())
        if found and found[0].evidence() <= best.evidence():  # no one thing helps: a whole kind may be missing
            everywhere = _everywhere(robot, search, found, sample, suspects)
            found = sorted([*found, *everywhere], key=lambda fit: -fit.evidence())
        if not found or found[0].evidence() <= best.evidence():
            break
        before, best = best, _without_last(robot, search, best, found[0], sample)
        if not worth(before, found[0], search):  # recordings that are not fitted to may yet bear it out
            break
        if not worth(best, found[0], search):  # it had only not converged
            continue
        first = _all_at_once(robot, search, found, sample, suspects)
        everywhere = _everywhere(robot, search, [first, *found], sample, suspects)
        best = max([first, *everywhere], key=lambda fit: fit.evidence())
        if _stand_ins(robot, search, best, sample):
            break
        small = len(best.hypothesis.pieces) <= 2 * MISSING_AT_ONCE  # not a whole kind, found together
        again = number == 1 or best.hypothesis.pieces[-1] not in allowed(best, robot)
        if number and small and again and not search.patience.over("a second look for what was found first"):
            best = _reconsider(robot, search, best, sample, suspects, progress)
    return best, sample


def given_up(search: Search, best: Fitted) -> bool:
    """Whether the time is up and a fit misses by what no further effect was tried for: that moves all its numbers.

    Where every round was made, nothing that was tried explains more: only a fit that is ``LACKING`` is given up then.
    """
    least = most_noise(best) if FURTHER in search.patience.left else LACKING
    return best.misfit > least and search.patience.over("rivals of a fit that still misses")


def most_noise(fit: Fitted) -> float:
    """χ² per datum up to which noise alone may be what a fit misses."""
    return calibration()["noise_misfit"] + scatter(fit)


def scatter(fit: Fitted) -> float:
    """Two standard deviations of χ² per datum, of noise alone."""
    return 2 * float(np.sqrt(2 / max(fit.data, 1)))


def _strained(fit: Fitted) -> bool:
    """Whether a fit has numbers of links farther off than a description allows."""
    return any(fit.parameters[k].kind == "link" for k, _, _ in far_off(fit))


def _stands_in(fit: Fitted) -> bool:
    """Whether a fit needs numbers of the description off: they may stand for what is missing."""
    return _strained(fit) or any(piece.law is None for piece in fit.hypothesis.pieces)


def _beside_each_other(robot: Robot, search: Search, sample: Sample, suspects: Sequence[Sequence[Hypothesis]]) -> None:
    """Fits the likely answers that have all nodes or all axes off with every other such group free, too.

    One group takes up what the others leave that are off by no more than is allowed: nodes off by millimetres pass for
    sensors turned by a degree. What is off has to be off beside the others (:func:`twin.diagnose.within.excused`).
    """
    least = max((fit.evidence() for fit in search.finalists), default=0.0) - LIKELY
    off = [
        fit
        for fit in search.finalists
        if fit.evidence() > least
        and any(_everything(p) and p not in allowed(fit, robot) for p in fit.hypothesis.pieces)
    ]
    _refits(robot, search, _loosened(search, off, suspects), sample)


def _without_weight(robot: Robot, search: Search, best: Fitted, sample: Sample) -> tuple[Fitted, Sample]:
    """The best fit, and those it has not left far behind, on recordings without what the weight of its sensors does."""
    recordings = weightless(sample.recordings, best)
    if recordings is sample.recordings:
        return best, sample
    search.weighed, lighter = best, replace(sample, recordings=recordings)
    near = [key for key, fit in search.fits.items() if fit.cost < best.cost + 10 * WITHIN * max(1.0, best.misfit)]

    def again(number: int) -> Fitted:
        fit = search.fits[near[number]]
        return descend(robot, fit.hypothesis, fit.parameters, lighter, fit.z, tempered=0, tolerance=0.02)

    search.fits |= dict(zip(near, spread(again, len(near), search.processes), strict=True))
    return search.fits[best.hypothesis.identity], lighter


def _stand_ins(robot: Robot, search: Search, best: Fitted, sample: Sample, several: int = 2) -> bool:
    """Whether several things found stand for something without a name: a law that has none would explain more.

    Beside them it would gain more than they have gained together. Each further thing would stand for it, too.
    """
    if len(best.hypothesis.pieces) - len(allowed(best, robot)) < several:
        return False
    nameless = max(search.lawless(best, sample).values(), default=0.0)
    return nameless > best.evidence() - search.base.evidence()


def one_more(
    robot: Robot, search: Search, sample: Sample, suspects: Sequence[Sequence[Hypothesis]], progress: Progress
) -> list[Fitted]:
    """The base model and one thing more, most evidence first."""
    return _round(robot, search, search.base, sample, suspects, progress)


def _where_it_is(
    robot: Robot,
    search: Search,
    best: Fitted,
    sample: Sample,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress,
) -> Fitted:
    """The best with what acts at the joint where a law without a name would still gain much, in its stead or beside it.

    Screening may have passed it over, or a bent valley have held it up, which the robust logarithmic residual leaves.
    """
    site, gain = next(iter(search.lawless(best, sample).items()), ("", 0.0))
    joint = site.partition(".")[0]
    there = [variants for variants in suspects if variants[0].site.partition(".")[0] == joint]
    if gain <= max(WORTH, inexact(best, search.base, search.fits)) or not there:
        return best
    held_up = [
        fit
        for fit in _round(robot, search, search.base, sample, there, progress, every=True)
        if not fit.converged and len(fit.hypothesis.pieces) == 1
    ]
    fewer = sample.thin(REFIT_LINES)

    def left(number: int) -> Fitted:
        fit = held_up[number]
        z = descend(robot, fit.hypothesis, fit.parameters, fewer, fit.z, logarithmic=10, tempered=0, linear=15).z
        return descend(robot, fit.hypothesis, fit.parameters, sample, z, tempered=0, tolerance=0.02)

    for fit, again in zip(held_up, spread(left, len(held_up), search.processes), strict=True):
        if again.cost < fit.cost:
            search.fits[fit.hypothesis.identity] = again
    present = {piece.key for piece in best.hypothesis.pieces}
    others = [variants for variants in there if variants[0].key not in present]
    if not present or not others or best.misfit < FIRST_ORDER:  # so near the truth, screening passed nothing over
        return best
    few = sample.thin(SCREEN_LINES)

    def roughly(number: int) -> _Place:
        hypothesis = together(best.hypothesis, others[number][0])
        parameters = hypothesis.parameters(search.base.parameters)
        z = np.concatenate([best.z, np.zeros(len(others[number][0].own))])
        objective = Objective(hypothesis.robot(robot), parameters, few, logarithmic=True)
        return _Place(hypothesis, parameters, (minimise(objective, z, 15, 0.1)[0],))

    places = list(spread(roughly, len(others), search.processes))
    return max([best, *_refits(robot, search, places, sample)], key=lambda fit: fit.evidence())


def worth(simpler: Fitted, richer: Fitted, search: Search) -> bool:
    """Whether what a hypothesis has more than a simpler one pays for the search to go on."""
    gain = richer.evidence() - simpler.evidence()
    return gain >= WORTH * max(1.0, richer.misfit) and gain > in_doubt(simpler, richer, search.base, search.fits)


def in_doubt(
    simpler: Fitted, richer: Fitted, base: Fitted, fits: Mapping[frozenset[str], Fitted], scale: float = 1.0
) -> float:
    """ln evidence of a hypothesis that may be the error of a simpler one's laws: none where the data do not move.

    Or a part of what nothing explains: where a good deal of the misfit stays, a thing that takes little of it away has
    no name.
    """
    moved = 0.5 * (simpler.misfit * simpler.data - richer.misfit * richer.data) / scale
    doubt, numbers = inexact(simpler, base, fits, scale), calibration()
    if simpler.hypothesis is not NONE:
        stays = 0.5 * max(richer.misfit - numbers["noise_misfit"], 0.0) * richer.data / scale
        doubt += numbers["unexplained_share"] * stays
    return min(doubt, max(moved, 0.0))


def inexact(fit: Fitted, base: Fitted, fits: Mapping[frozenset[str], Fitted], scale: float = 1.0) -> float:
    """ln evidence that the laws of a fit may be off by: a share of what they gain over the base model.

    A structure that is not exactly the named one leaves that much unexplained. But what it leaves is misfit, and a true
    second thing takes more than a part of the misfit. A turned sensor, a gain or a number of the description has no law
    that could be off. Where ``fits`` have a fit of those alone, the gain of the others counts from there. For a
    recording that no model predicts exactly, it is all that may hide in the misfit.
    """
    base = fits.get(frozenset(piece.key for piece in fit.hypothesis.pieces if piece.exact), base)
    share = calibration()["inexact_linear"] * max(fit.evidence(scale) - base.evidence(scale), 0.0)
    if not fit.exact:
        share = np.inf
    beyond = max(fit.misfit - 1, 0.0) + 2 * np.sqrt(2 / max(fit.data, 1))  # of χ² per datum, with its own scatter
    return min(share, calibration()["unexplained_share"] * 0.5 * float(beyond) * fit.data / scale)


def _without_last(robot: Robot, search: Search, simpler: Fitted, richer: Fitted, sample: Sample) -> Fitted:
    """The simpler hypothesis fitted again from where the richer one ended: a valley may not have been followed out."""
    place = _Place(simpler.hypothesis, simpler.parameters, (richer.z[: len(simpler.z)],))
    near = richer.cost + WITHIN * max(1.0, richer.misfit)
    lines = SCREEN_LINES if simpler is search.base and search.error > FAR else REFIT_LINES
    roughly = _nearly(robot, place, sample.thin(lines), THINNED_COST * near)
    fit = _fully(robot, roughly, sample, near) if roughly.cost < THINNED_COST * near else simpler
    if fit.cost >= simpler.cost:
        return simpler
    if simpler.hypothesis is NONE:
        search.base = fit
    else:
        search.fits[simpler.hypothesis.identity] = fit
    return fit


def _reconsider(
    robot: Robot,
    search: Search,
    best: Fitted,
    sample: Sample,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress,
) -> Fitted:
    """Every thing found but the last taken out and looked for again beside the others; not what is no finding."""
    for piece in best.hypothesis.pieces[:-1]:
        if piece not in best.hypothesis.pieces or piece in allowed(best, robot):
            continue
        rest, z = _taken_out(search, best, {piece.key})
        current = search.fits.get(rest.identity)
        if current is None:
            parameters = rest.parameters(search.base.parameters)
            starts = (z, np.concatenate([search.base.z, z[len(search.base.z) :]]))
            (current,) = _refits(robot, search, [_Place(rest, parameters, starts)], sample)
        found = _round(robot, search, current, sample, suspects, progress)
        best = max([best, *found], key=lambda fit: fit.evidence())
    return best


def _taken_out(search: Search, fit: Fitted, gone: Container[str]) -> tuple[Hypothesis, FloatArray]:
    """The other things of a hypothesis than those of some keys, and where they are in the fit of all."""
    rest = together(*(p for p in fit.hypothesis.pieces if p.key not in gone))
    names = set(rest.parameters(search.base.parameters).names)
    return rest, fit.z[[k for k, p in enumerate(fit.parameters) if p.name in names]]


def _loosened(
    search: Search, fits: Sequence[Fitted], suspects: Sequence[Sequence[Hypothesis]], far: bool = False
) -> list["_Place"]:
    """Fits with all positions of nodes, all directions and all axes free that are not: where they go on.

    Every node is somewhat elsewhere than a file says, and turned, and so is every axis. What that leaves would pass for
    a kind of spring, or for a wrong mass. All at once, as one without the others makes up for them.
    """
    groups, places = [variants[0] for variants in suspects if _everything(variants[0])], []
    for fit in fits:
        freed = {p.name for p in fit.hypothesis.own}
        more = [replace(one, own=tuple(p for p in one.own if p.name not in freed)) for one in groups]
        more = [one for one in more if one.own and one.key not in fit.hypothesis.identity]
        if more:
            hypothesis = together(fit.hypothesis, *more)
            start = np.concatenate([fit.z, np.zeros(len(hypothesis.own) - len(fit.hypothesis.own))])
            parameters = hypothesis.parameters(search.base.parameters)
            places.append(_Place(hypothesis, parameters, (start,), far))
    return places


def _everything(one: Hypothesis) -> bool:
    """Whether a suspect is all nodes or all axes."""
    return one.law is None and bool(one.own) and "*" in one.site


def _within_tolerances(
    robot: Robot, search: Search, sample: Sample, suspects: Sequence[Sequence[Hypothesis]]
) -> Fitted:
    """The base model, or that with all nodes and axes free if so it predicts the recordings and all are allowed."""
    few = sample.thin(REFIT_LINES)
    for place in _loosened(search, [search.base], suspects, far=True) if search.error else ():
        near = _nearly(robot, place, few, np.inf)
        if inflation(near, robot, few):
            continue  # something else is missing
        (fit,) = _refits(robot, search, [replace(place, starts=(near.z,), far=False)], sample)
        if worth(search.base, fit, search) and len(allowed(fit, robot)) == len(fit.hypothesis.pieces):
            return fit
    return search.base


def _all_at_once(
    robot: Robot, search: Search, found: Sequence[Fitted], sample: Sample, suspects: Sequence[Sequence[Hypothesis]]
) -> Fitted:
    """The best of some fits, or if it misses by more than noise the best of them :func:`_loosened`, if that pays.

    Fits come with most evidence first; rivals of the first are loosened with it.
    """
    best = found[0]
    if not inflation(best, robot, sample.thin(REFIT_LINES)):
        return best
    near = best.evidence() - WITHIN * max(1.0, best.misfit)
    places = _loosened(search, [fit for fit in found if fit.evidence() > near], suspects)
    fits = _refits(robot, search, places, sample) if places else []
    richer = max([best, *fits], key=lambda fit: fit.evidence())
    return richer if worth(best, richer, search) else best


def _everywhere(
    robot: Robot, search: Search, found: Sequence[Fitted], sample: Sample, suspects: Sequence[Sequence[Hypothesis]]
) -> list[Fitted]:
    """A model that one thing leaves far off may lack a kind of spring, not one: those found, at all their sites.

    The one that the recorded modes strain most comes first.
    """
    few, more, free = sample.thin(SCREEN_LINES), sample.thin(REFIT_LINES), search.base.parameters
    if inflation(found[0], robot, more) <= FAR:
        return []
    places = []
    for family in dict.fromkeys(fit.hypothesis.pieces[-1].family for fit in found):
        sites = [variants[0] for variants in suspects if variants[0].family == family]
        if len(sites) < 2 or not (sites[0].law and sites[0].law.sprung):
            continue
        hypothesis = together(*sites)
        parameters = hypothesis.parameters(free)
        fit = descend(robot, hypothesis, parameters, few, np.zeros(len(parameters)), logarithmic=40)
        energy = _strain(fit, few)
        ordered = together(*sorted(sites, key=lambda one: -energy.get(one.site, 0.0)))
        parameters = ordered.parameters(free)
        z = fit.z[[fit.parameters.names.index(name) for name in parameters.names]]
        places.append(_Place(ordered, parameters, (z,), far=True))
    return _refits(robot, search, places, sample)


def _strain(fit: Fitted, sample: Sample) -> dict[str, float]:
    """Coordinate → share of its spring in the strain energy of a mode in the band, summed over modes and postures."""
    total: dict[str, float] = {}
    setups = [r.setup for r in sample.recordings]
    for r, (seen, model) in zip(
        sample.recordings, observe_all(fit.robot, setups, fit.parameters, fit.values), strict=True
    ):
        pole, shape = poles(seen)
        shape = shape[:, (np.abs(pole) > abs(r.s[0])) & (np.abs(pole) < abs(r.s[-1]))]
        energy = np.diag(seen.K)[:, None] * np.abs(shape) ** 2
        for name, share in zip(model.coordinates, (energy / energy.sum(axis=0)).sum(axis=1), strict=True):
            total[name] = total.get(name, 0.0) + float(share)
    return total


def _needed(robot: Robot, search: Search, best: Fitted, sample: Sample) -> Fitted:
    """The hypothesis without what the others can do without: a bent valley may have been followed further beside it."""
    pieces = best.hypothesis.pieces if len(best.hypothesis.pieces) > 1 else ()
    near = best.cost + WITHIN

    def left(number: int) -> Fitted:
        rest, z = _taken_out(search, best, {pieces[number].key})
        parameters = rest.parameters(search.base.parameters)
        return descend(robot, rest, parameters, sample, z, tempered=0, linear=20, tolerance=0.02, hopeless=near)

    for fit in spread(left, len(pieces), search.processes):
        known = search.fits.get(fit.hypothesis.identity)
        if known is None or fit.cost < known.cost:
            search.fits[fit.hypothesis.identity] = known = fit
        if not worth(known, best, search):
            return _needed(robot, search, known, sample)
    return best


def _rivals_without(robot: Robot, search: Search, richest: Fitted, best: Fitted, sample: Sample) -> Fitted:
    """The best of a fit that does without some of its pieces, and of its rivals without the same.

    Each piece costs evidence. Rivals that keep what the best was relieved of would all be out of the race.
    """
    gone = richest.hypothesis.identity - best.hypothesis.identity
    places = []
    for fit in search.finalists if gone else ():
        if fit is richest or fit.evidence() < richest.evidence() - WITHIN or not gone < fit.hypothesis.identity:
            continue
        rest, z = _taken_out(search, fit, gone)
        places.append(_Place(rest, rest.parameters(search.base.parameters), (z,), far=True))
    return max([best, *_refits(robot, search, places, sample)], key=lambda fit: fit.evidence())


def _round(
    robot: Robot,
    search: Search,
    current: Fitted,
    sample: Sample,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress,
    every: bool = False,
    held: bool = False,
) -> list[Fitted]:
    """Current hypothesis and one thing more, most evidence first.

    Args:
        every: whatever little it promises.
        held: screened and begun where links are within ``HELD_LINKS`` tolerances, with a residual tempered at first. In
            a band of frequencies a link that is off moves as one behind a spring that is missing. It leaves too little
            for the spring to explain, and a fit that begins there does not find its way back.
    """
    free, hypothesis = search.base.parameters, current.hypothesis
    error = search.error if hypothesis is NONE else inflation(current, robot, sample.thin(REFIT_LINES))
    far = error > FAR
    lines = sample.thin(SCREEN_LINES if far else REFIT_LINES if error > 0 else NEAR_LINES)
    z = search.robust if hypothesis is NONE and far else current.z
    setting = Setting(robot, free, hypothesis, z, lines, sample.thin(SCREEN_LINES), error, far)
    if error > 0 or held:
        own = hypothesis.parameters(free)
        bound = np.array([HELD_LINKS if p.kind == "link" and held else np.inf for p in own])
        z = np.clip(z, -bound, bound)
        z, *_ = minimise(setting.objective(hypothesis), z, 30 if held else 8, 0.05, bound=bound if held else None)
        setting = replace(setting, z=z)
    if error > 0:  # all nodes would outrun the one of them that is off: they are tried by themselves
        suspects = [variants for variants in suspects if not _everything(variants[0])]
    promises = screen(setting, suspects, progress("screen", len(suspects)), search.processes)
    thinned = lines.repeat / sample.repeat  # fewer lines promise as many times the noise
    least = max(SLIGHT * thinned, RACE * promises[0].gain)
    if error > 0:
        likely = _varied(promises, COMPARED)
        likely = [p for k, p in enumerate(likely) if k < REFITTED_BEST or p.gain > RACE * promises[0].gain]
        starts = _halve(setting, likely, progress, search.processes)
    else:
        likely = _varied(promises, REFITTED_BEST)
        # what has no size, as a gain, is promised what it brings: it must be worth something
        kept = [
            p for k, p in enumerate(likely) if every or k == 0 or p.gain > (least if p.sized else max(least, WORTH))
        ]
        starts = [(p, [p.fallback] if held else [p.start, p.fallback]) for p in kept]
    found: list[Fitted] = []
    tick = progress("refit", len(starts))
    for number in range(0, len(starts), ABREAST):
        gained = max((current.cost - fit.cost for fit in found), default=0.0)
        places = [
            _Place(promise.hypothesis, promise.parameters, tuple(places), far or held, current.cost - SLIGHT)
            for k, (promise, places) in enumerate(starts[number : number + ABREAST], number)
            if k < FEWEST or promise.gain >= SHORT * gained or every
        ]
        found += _refits(robot, search, places, sample)
        tick(len(places))
    found.sort(key=lambda fit: -fit.evidence())
    led: set[frozenset[str]] = set()
    least = current.evidence() + (SLIGHT if current.hypothesis.pieces else 0.0)  # beside an answer, less is noise
    while found[0].evidence() > least and found[0].hypothesis.identity not in led:
        led.add(found[0].hypothesis.identity)
        found += _accompany(robot, search, found[0], sample)
        found = [search.fits[identity] for identity in dict.fromkeys(fit.hypothesis.identity for fit in found)]
        found.sort(key=lambda fit: -fit.evidence())
    return found


def _halve(
    setting: Setting, candidates: Sequence[Promise], progress: Progress, processes: int
) -> list[tuple[Promise, list[FloatArray]]]:
    """Candidates at their optimum on the screening's residual, best first: a few steps for all, all for the best."""
    tick = progress("compare", len(candidates))

    def near(number: int) -> tuple[float, FloatArray]:
        objective = setting.objective(candidates[number].hypothesis)
        start = min((candidates[number].start, candidates[number].fallback), key=objective.cost)
        inner = setting.coarse(candidates[number].hypothesis, objective, start)
        z, cost, _, _ = minimise(inner, inner.part(start), 8, 0.5)
        return cost, inner.whole(z)

    ends = []
    for promise, (cost, z) in zip(candidates, spread(near, len(candidates), processes), strict=True):
        ends.append((cost, promise, z))
        tick(1)
    before = setting.objective(setting.current).cost(setting.z)
    least = min(cost for cost, _, _ in ends)
    behind = max(WITHIN, (1 - SHORT) * (before - least))  # gained much less than another
    ends = [end for end in sorted(ends, key=lambda end: end[0])[:REFITTED_BEST] if end[0] - least < behind]

    def at(number: int) -> tuple[FloatArray, float, FloatArray, bool]:
        return minimise(setting.objective(ends[number][1].hypothesis), ends[number][2], 20, 0.3)

    found = zip(ends, spread(at, len(ends), processes), strict=True)
    converged = sorted(((cost, promise, z) for (_, promise, _), (z, cost, _, _) in found), key=lambda end: end[0])
    best = converged[0][0]
    return [(promise, [z]) for k, (cost, promise, z) in enumerate(converged) if k < 2 or cost - best < WITHIN]


@dataclass(frozen=True)
class _Place:
    """Where the refit of a hypothesis starts: at the best of some places.

    Attributes:
        far: on a tempered residual first.
        worth: it is given up where it will not come below this cost, or near the best so far.
    """

    hypothesis: Hypothesis
    parameters: Parameters
    starts: tuple[FloatArray, ...]
    far: bool = False
    worth: float = np.inf


def _in_its_stead(robot: Robot, search: Search, sample: Sample, suspects: Sequence[Sequence[Hypothesis]]) -> None:
    """Fits what turns the robot about the same axis as a piece of a likely answer, in its stead, to convergence.

    What still lacks something on a few lines (``LACKING``) is not followed to its end on all. Pieces of the best
    answer are also replaced by simpler ones that they contain, as a foundation without a mass of its own. Beside what
    was found after that piece, the simpler may do as well. So may one node that is far astray and was freed with all
    others, or one blow that points far elsewhere. What cannot be what it is called gives way to what may be there.
    """
    free, postures, few = search.base.parameters, [r.setup.q for r in sample.recordings], sample.thin(REFIT_LINES)
    axes, finalists = same_axes(robot, postures), search.finalists
    if not finalists:
        return
    best, *others = finalists
    likely = [best, *(fit for fit in others if len(fit.hypothesis.pieces) <= len(best.hypothesis.pieces))]
    least = max(search.base.evidence(), best.evidence() - LIKELY)
    behind = best.cost + WITHIN * max(1.0, best.misfit)
    lacking = max(behind, 0.5 * LACKING * best.data)
    places = []
    for fit in [fit for fit in likely if fit.evidence() > least]:
        for piece in fit.hypothesis.pieces:
            instead = companions(piece, robot, described(free), postures)
            hopeless = np.inf
            if piece.key not in axes:
                instead = [c for c in instead if fit is best and c.law and len(c.own) < len(piece.own)]
                hopeless = behind
            rest = [other for other in fit.hypothesis.pieces if other is not piece]
            there = {other.key for other in rest}  # both may be missing, but neither twice
            if fit is best:
                instead += [*members(fit, piece), *turned(fit, piece, suspects, robot)]
            for companion in [c for c in instead if c.key not in there]:
                hypothesis = together(*rest, companion)
                known, parameters = search.fits.get(hypothesis.identity), hypothesis.parameters(free)
                starts = [_taken_over(fit, [piece], companion, parameters)]
                starts += [_brought(fit, one, parameters) for one in _with(search, companion)]
                if known and known.parameters.names == parameters.names:
                    starts.append(known.z)
                places.append(_Place(hypothesis, parameters, tuple(starts), worth=hopeless))
            places += _in_parts(robot, best, piece, free, behind) if fit is best else []
            possible = may_be(robot, fit, piece, free, postures[0], sample.band_hz)
            places += [_Place(hypothesis, hypothesis.parameters(free), (z,)) for hypothesis, z in possible]

    def found(number: int) -> Fitted:
        one = places[number]
        return _fully(robot, _nearly(robot, one, few, THINNED_COST * one.worth), sample, min(one.worth, lacking))

    for fit in spread(found, len(places), search.processes):
        known = search.fits.get(fit.hypothesis.identity)
        if known is None or fit.cost < known.cost:
            search.fits[fit.hypothesis.identity] = fit


def _fuller(robot: Robot, search: Search, sample: Sample) -> None:
    """Fits likely answers with a fuller form of a piece, alone or instead of another piece that may be a part of it.

    A mass on a link was tried as a point. The inertia of a real body then passes for that of its link.
    """
    places, finalists = [], search.finalists
    for fit in [fit for fit in finalists if fit.evidence() > finalists[0].evidence() - LIKELY]:
        pieces = fit.hypothesis.pieces
        instead = [([piece], one) for piece in pieces for one in fuller(piece, robot)]
        instead += [([*pair], one) for pair in combinations(pieces, 2) for one in merged(*pair, robot)]
        for gone, companion in instead:
            rest = [piece for piece in pieces if piece not in gone]
            if companion.key in {piece.key for piece in rest}:
                continue
            hypothesis = together(*rest, companion)
            parameters = hypothesis.parameters(search.base.parameters)
            start = _taken_over(fit, gone, companion, parameters)
            parted = divided(robot, parameters, start, companion, present=any(piece.entries for piece in gone))
            places.append(_Place(hypothesis, parameters, (start, *([parted[0]] if parted else []))))
    _refits(robot, search, places, sample)


def _in_parts(robot: Robot, best: Fitted, piece: Hypothesis, free: Parameters, behind: float) -> list[_Place]:
    """The best with simpler things in the stead of a piece that they are parts of: two of them or more.

    A slab whose mass no recording shows is its springs, and not all of those need show.
    """
    if not piece.law or not piece.entries:
        return []
    fitted = dict(zip(written_names(best.parameters).names, best.values, strict=True))
    own = {p.quantity: float(fitted[p.name]) for p in piece.own}
    parts = piece.law.parts(robot, piece.site, {**robot.values(piece.entries[0]), **own})
    rest = [other for other in best.hypothesis.pieces if other is not piece]
    places = []
    for count in range(2, len(parts) + 1):
        for some in combinations(parts, count):
            typical = [(c, CATALOGUE[c.effect].typical(robot, c.site)) for c in some]
            pieces = [entry_hypothesis(robot, c.effect, c.site, dict(v)) for c, v in typical if v]
            hypothesis = together(*rest, *pieces)
            parameters = hypothesis.parameters(free)
            known = {f"{c.effect}@{c.site}.{name}": value for c in some for name, value in (c.values or {}).items()}
            means = {p.name: p.mean for piece in pieces for p in piece.own}
            names = written_names(parameters).names
            start = np.array([known.get(name, fitted.get(name, means.get(name))) for name in names], float)
            places.append(_Place(hypothesis, parameters, (parameters.coordinates(start),), worth=behind))
    return places


def _with(search: Search, piece: Hypothesis) -> list[Fitted]:
    """The fit with most evidence that has a piece, if there is one."""
    return [fit for fit in search.finalists if piece.key in fit.hypothesis.identity][:1]


def _brought(fit: Fitted, other: Fitted, parameters: Parameters) -> FloatArray:
    """Where a hypothesis starts whose numbers are those of a fit, and of another what that has not."""
    values: dict[str, float] = {}
    for one in (other, fit):
        values |= dict(zip(written_names(one.parameters).names, one.values, strict=True))
    return parameters.coordinates(np.array([values[name] for name in written_names(parameters).names], float))


def _refits(robot: Robot, search: Search, places: Sequence[_Place], sample: Sample) -> list[Fitted]:
    """Hypotheses at their optimum on all lines, the better of it and what was known of each; side by side."""
    reach, few = _reach(search), sample.thin(REFIT_LINES)
    thinned = THINNED_COST if few.repeat > sample.repeat else 1.0
    worth = min((one.worth for one in places), default=np.inf)

    def near(number: int) -> Fitted:
        return _nearly(robot, places[number], few, thinned * min(places[number].worth, reach))

    nearly = _best_of_each(spread(near, len(places), search.processes))
    ahead = [fit for fit in nearly if not fit.too_heavy]  # what cannot be puts nothing out of the race
    best = min((thinned * fit.cost + WITHIN * max(1.0, fit.misfit) for fit in ahead), default=np.inf)

    def end(number: int) -> Fitted:
        return _fully(robot, nearly[number], sample, min(worth, reach, best))

    for fit in spread(end, len(nearly), search.processes):
        known = search.fits.get(fit.hypothesis.identity)
        if known is None or _better(fit, known):
            search.fits[fit.hypothesis.identity] = fit
    return [search.fits[identity] for identity in dict.fromkeys(one.hypothesis.identity for one in places)]


def _better(fit: Fitted, known: Fitted) -> bool:
    """Whether a fit of the same things is to replace one: further numbers have to pay for themselves."""
    more = len(fit.hypothesis.own) > len(known.hypothesis.own)
    return fit.evidence() > known.evidence() if more else fit.cost < known.cost


def _best_of_each(fits: Iterable[Fitted]) -> list[Fitted]:
    """One fit of every hypothesis: of its variants, the one that is ahead."""
    best: dict[frozenset[str], Fitted] = {}
    for fit in fits:
        known = best.get(fit.hypothesis.identity)
        if known is None or fit.cost < known.cost:
            best[fit.hypothesis.identity] = fit
    return list(best.values())


def _nearly(robot: Robot, one: _Place, few: Sample, hopeless: float) -> Fitted:
    """A hypothesis at its optimum on a few lines."""
    z = one.starts[0]
    if len(one.starts) > 1 and not one.far:
        z = min(one.starts, key=Objective(one.hypothesis.robot(robot), one.parameters, few).cost)
    tempered = 8 if one.far else 0
    return descend(robot, one.hypothesis, one.parameters, few, z, tempered=tempered, linear=15, hopeless=hopeless)


def _fully(robot: Robot, near: Fitted, sample: Sample, hopeless: float) -> Fitted:
    """The same on all lines; a mass and its link also from where they are divided with the least tension, or anew."""

    def end(z: FloatArray) -> Fitted:
        return descend(
            robot, near.hypothesis, near.parameters, sample, z,
            tempered=0, linear=20, tolerance=0.02, hopeless=hopeless,
        )  # fmt: skip

    fit = end(near.z)
    for piece in fit.hypothesis.pieces:
        for found in (
            divided(robot, fit.parameters, fit.z, piece, present=True),
            on_a_described_link(robot, fit.parameters, fit.z, piece),
        ):
            if found and found[1] > SLIGHT:
                fit = min(fit, end(found[0]), key=lambda one: one.cost)
    return fit


def _reach(search: Search) -> float:
    """The cost above which a hypothesis is out of the race."""
    return min((fit.cost + WITHIN for fit in search.finalists), default=np.inf)


def _accompany(robot: Robot, search: Search, best: Fitted, sample: Sample) -> list[Fitted]:
    """What the last thing in a hypothesis is hard to tell from, alone or with another of them, in their stead."""
    free = search.base.parameters
    *others, last = best.hypothesis.pieces
    postures = [r.setup.q for r in sample.recordings]
    instead = [(others, companion, [last]) for companion in companions(last, robot, described(free), postures)]
    for other in others:
        rest = [piece for piece in others if piece is not other]
        instead += [(rest, companion, [last, other]) for companion in merged(last, other, robot)]
    places = []
    for rest, companion, gone in instead:
        hypothesis = together(*rest, companion)
        known = search.fits.get(hypothesis.identity)
        alike = any(_alike(companion, piece) for piece in gone)
        if companion.key in {piece.key for piece in rest}:
            continue
        turned = companion.key in {piece.key for piece in gone}
        fuller = known is not None and len(hypothesis.own) > len(known.hypothesis.own)  # a body where a point was tried
        if known is not None and not turned and not fuller and not (alike and known.cost > best.cost + SLIGHT):
            continue  # an alias may have been fitted worse
        parameters, starts = hypothesis.parameters(free), list[FloatArray]()
        if companion.scale:
            simpler = search.fits.get(together(*rest).identity, search.base)
            held = simpler.z[[free.names.index(name) for name, _ in companion.scale]]
            if simpler.evidence() + 0.5 * float(held @ held) < best.evidence() - WITHIN:
                continue  # more than the price of its prior cannot be gained
            starts.append(np.asarray(np.linalg.solve(parameters.root, simpler.parameters.root @ simpler.z)))
        elif alike and gone == [last]:
            z, n = best.z.copy(), len(best.z) - len(companion.own)
            if _lever(companion) and companion.site != last.site:  # usual mass and place, or the same ones in space
                starts.append(_where_it_was(robot, best, last, companion, parameters, postures[0]))
                z[n:] *= [p.quantity in TUNING for p in companion.own]
            starts.append(z)
        elif turned and all(_alike(companion, piece) for piece in gone):
            starts.append(_retuned(best, gone, companion, parameters))
        else:
            starts.append(_taken_over(best, gone, companion, parameters))
            if last.scale and (parted := divided(robot, parameters, starts[0], companion, present=False)):
                starts.append(parted[0])  # it is what makes the link's own numbers seem off
        places.append(_Place(hypothesis, parameters, tuple(starts)))
    found = []
    for number in range(0, len(places), ABREAST):
        found += _refits(robot, search, places[number : number + ABREAST], sample)
    return found


def _where_it_was(
    robot: Robot, best: Fitted, last: Hypothesis, companion: Hypothesis, parameters: Parameters, q: FloatArray
) -> FloatArray:
    """Where a companion on another link starts: what the last thing was, at the same place in space."""
    values, n = best.values.copy(), len(best.values) - len(companion.own)
    lever = [n + k for k, p in enumerate(companion.own) if p.quantity.startswith(_lever(companion))]
    here, there = (carrier_at(piece, robot, piece.site) for piece in (last, companion))
    values[lever] = between_links(robot, q, here, there, values[lever])
    return parameters.coordinates(values)


def _taken_over(best: Fitted, gone: Sequence[Hypothesis], companion: Hypothesis, parameters: Parameters) -> FloatArray:
    """Where a companion starts: what stays is as it is; its own numbers are those of what it stands for.

    If several of those have a number (mass and place of what hangs), it is that of the simpler one.
    """
    fitted = dict(zip(written_names(best.parameters).names, best.values, strict=True))
    known: dict[str, float] = {}
    for piece in sorted(gone, key=lambda piece: -len(piece.own)):
        known |= {_role(piece, p): fitted[p.name] for p in piece.own}
    own = {p.name: fitted.get(p.name, known.get(_role(companion, p), p.mean)) for p in companion.own}
    names = written_names(parameters).names
    return parameters.coordinates(np.array([own.get(name, fitted.get(name)) for name in names], float))


def _retuned(best: Fitted, gone: Sequence[Hypothesis], companion: Hypothesis, parameters: Parameters) -> FloatArray:
    """Where one starts that stands for two alike: what hangs there as at its site, swinging as the other does."""
    fitted = dict(zip(written_names(best.parameters).names, best.values, strict=True))
    (other,) = (piece for piece in gone if piece.key != companion.key)
    for p in companion.own:
        if p.quantity in TUNING:
            fitted[p.name] = fitted[f"{other.key}.{p.quantity}"]
    return parameters.coordinates(np.array([fitted[name] for name in written_names(parameters).names], float))


def _lever(piece: Hypothesis) -> str:
    """The number that says where a mass hangs; empty where nothing hangs."""
    return piece.law.lever if piece.law else ""


def _role(piece: Hypothesis, parameter: Parameter) -> str:
    """What a number is to a mass: how heavy it is, where it hangs."""
    lever = _lever(piece)
    return parameter.quantity.replace(lever, "lever") if lever else parameter.quantity


def _alike(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether two entries have the same parameters."""
    return bool(one.own) and [p.quantity for p in one.own] == [p.quantity for p in other.own]


def settle(robot: Robot, search: Search, sample: Sample) -> list[Fitted]:
    """Every hypothesis in reach of the best, and what turns the robot about its axes, most evidence first, near ones of
    their size; the base model last."""
    fits, free = search.finalists, search.base.parameters
    axes = same_axes(robot, [r.setup.q for r in sample.recordings])
    near = [fit for fit in fits if fits[0].evidence() - fit.evidence() < WITHIN]

    def at_size(number: int) -> Fitted:
        fit = near[number]
        if given_up(search, fit):
            return fit
        own = fit.z[len(fit.z) - len(fit.hypothesis.own) :]
        in_reach = fit.evidence() + 0.5 * float(own @ own) > fits[0].evidence() - LIKELY
        sized = of_its_size(robot, free, fit, sample) if in_reach and _may_be_seen(fit, search) else fit
        fit = fit if sized.too_heavy else sized  # under a wider prior a mass may grow
        return fit if fit.converged else _to_its_end(robot, fit, sample)

    sized = list(spread(at_size, len(near), search.processes))
    far = [
        fit
        for k, fit in enumerate(fits[len(near) :], len(near))
        if k < FEWEST
        or fits[0].evidence() - fit.evidence() < 10 * WITHIN
        or any(fit.hypothesis.under(axes) == other.hypothesis.under(axes) for other in near)
    ]
    sized = [fit for fit in sized if not fit.too_heavy]
    return [*sorted(sized, key=lambda fit: -fit.evidence()), *far, search.base]


def _to_its_end(robot: Robot, fit: Fitted, sample: Sample) -> Fitted:
    """A fit that a long valley has held up, followed on: 19 in ln evidence and the truth lay along one of them."""
    return descend(
        robot, fit.hypothesis, fit.parameters, sample, fit.z,
        tempered=0, linear=TO_THE_END, tolerance=0.02, patience=CRAWLING,
    )  # fmt: skip


def _may_be_seen(fit: Fitted, search: Search) -> bool:
    """Whether every piece of a fit could gain what it takes to be named, if its size cost nothing.

    A size drawn far from its usual value has a tension, and that is all another width of its prior takes away.
    """
    least, at = calibration()["seen"], len(fit.z) - len(fit.hypothesis.own)
    for piece in fit.hypothesis.pieces:
        rest = search.fits.get(fit.hypothesis.identity - {piece.key}) if len(fit.hypothesis.pieces) > 1 else search.base
        tension = 0.5 * float(fit.z[at]) ** 2 if piece.own and piece.own[0].log else 0.0
        if rest is not None and rest.cost - fit.cost + tension < least:
            return False
        at += len(piece.own)
    return True


def _varied(promises: Sequence[Promise], count: int) -> list[Promise]:
    """The most promising, at most half of them from one effect, variants of one entry counted once."""
    kept: list[Promise] = []
    for promise in promises:
        same = len({other.suspect.site for other in kept if other.suspect.effect == promise.suspect.effect})
        if same < count // 2:
            kept.append(promise)
        if len(kept) == count:
            break
    return kept
