"""From the base model to the few hypotheses that explain a hammer test: converge, screen, halve, refit.

All finalists end on the same lines with the same residual, each from several starts, so that their evidence compares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.diagnose.hypotheses import Hypothesis, companions
from twin.diagnose.objective import Objective, Sample
from twin.diagnose.refit import NONE, Fitted, descend, minimise
from twin.diagnose.screen import FAR, Promise, Setting, inflation, screen
from twin.identify.parameters import Parameters
from twin.measure.campaign import FloatArray
from twin.robot.description import Robot

SCREEN_LINES, REFIT_LINES = 25, 50
CANDIDATES, FINALISTS, FEWEST = 16, 8, 3
RACE = 0.08  # of the best gain: less promises nothing
REACH, SETTLED = 40.0, 4  # in ln evidence on thinned lines: what is fitted to all lines

Progress = Callable[[str, int], Callable[[int], None]]


@dataclass
class Search:
    """What was fitted.

    Attributes:
        base: the base model's optimum; ``others`` its other starts, best first.
        robust: (n,) the base model's optimum of the logarithmic residual.
        promises: every suspect, most promising first.
        finalists: refitted hypotheses, most evidence first.
    """

    base: Fitted
    others: list[Fitted]
    robust: FloatArray
    error: float
    promises: list[Promise] = field(default_factory=list)
    finalists: list[Fitted] = field(default_factory=list)


def converge(robot: Robot, parameters: Parameters, sample: Sample, starts: int = 2, seed: int = 0) -> Search:
    """The base model from the description and from springs and dampers drawn from their prior."""
    rng = np.random.default_rng(seed)
    elastic = np.array([p.kind in ("spring", "entry") for p in parameters])
    few, more = sample.thin(SCREEN_LINES), sample.thin(REFIT_LINES)
    robust, ends = np.zeros(len(parameters)), []
    best = np.inf
    for number in range(starts):
        z = np.zeros(len(parameters))
        if number:
            z[elastic] = rng.normal(size=np.count_nonzero(elastic))
        z, cost, _, _ = minimise(Objective(robot, parameters, few, logarithmic=True), z, 25, 0.5)
        if cost < best:
            best, robust = cost, z
        ends.append(descend(robot, NONE, parameters, more, z, tempered=8, linear=15))
    ends.sort(key=lambda fit: fit.cost)
    return Search(ends[0], ends[1:], robust, inflation(robot, ends[0], more))


def explain(
    robot: Robot,
    search: Search,
    sample: Sample,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress | None = None,
) -> Search:
    """Screen the suspects and refit those that promise most."""
    progress = progress or (lambda description, total: lambda count: None)
    parameters = search.base.parameters
    few, more = sample.thin(SCREEN_LINES), sample.thin(REFIT_LINES)
    far = search.error > FAR
    few = few if far else more  # the base model is converged on these
    z = search.robust if far else search.base.z
    z, *_ = minimise(Objective(robot, parameters, few, search.error, far), z, 8, 0.05)
    setting = Setting(robot, parameters, z, few, search.error, far)
    search.promises = screen(setting, suspects, progress("screen", len(suspects)))
    least = RACE * search.promises[0].gain
    candidates = [p for k, p in enumerate(_varied(search.promises, CANDIDATES)) if k < FEWEST or p.gain > least]
    tick = progress("refit", len(candidates))
    before = setting.objective(NONE, parameters).cost(z)
    halved: list[tuple[float, Promise, FloatArray]] = []
    for promise in candidates:
        objective = setting.objective(promise.hypothesis, promise.parameters)
        end, cost, _, _ = minimise(objective, promise.start, 10, 0.3)
        halved.append((before - cost, promise, end))
        tick(1)
    halved.sort(key=lambda item: -item[0])
    kept = [item for k, item in enumerate(halved[:FINALISTS]) if k < FEWEST or item[0] > RACE * halved[0][0]]
    tick = progress("finalists", len(kept))
    for _, promise, end in kept:
        search.finalists.append(
            descend(
                robot, promise.hypothesis, promise.parameters, more, end,
                tempered=6 if search.error > 0 else 0, linear=12,
            )
        )  # fmt: skip
        tick(1)
    search.finalists.sort(key=lambda fit: -fit.evidence())
    _accompany(robot, search, more)
    return search


def _accompany(robot: Robot, search: Search, sample: Sample) -> None:
    """Judge the best finalist's companions beside it."""
    best, parameters = search.finalists[0], search.base.parameters
    if best.evidence() - search.base.evidence() < -REACH:
        return
    fitted = {fit.hypothesis.key for fit in search.finalists}
    postures = [r.setup.q for r in sample.recordings]
    for hypothesis in companions(best.hypothesis, robot, parameters, postures):
        if hypothesis.key in fitted:
            continue
        own = hypothesis.parameters(parameters)
        z = best.z[: len(parameters)]
        if hypothesis.scale:
            z = np.asarray(np.linalg.solve(own.root, parameters.root @ z))
        elif [p.quantity for p in hypothesis.own] == [p.quantity for p in best.hypothesis.own]:
            z = best.z
        else:
            z = np.concatenate([z, np.zeros(len(hypothesis.own))])
        search.finalists.append(descend(robot, hypothesis, own, sample, z, tempered=4, linear=12))
    search.finalists.sort(key=lambda fit: -fit.evidence())


def settle(robot: Robot, search: Search, sample: Sample) -> list[Fitted]:
    """The base model and the hypotheses still in reach, fitted to all lines; most evidence first, base last."""
    best = search.finalists[0].evidence() if search.finalists else -np.inf
    near = [fit for fit in search.finalists[:SETTLED] if best - fit.evidence() < REACH]
    fits = [*near, search.base]
    found = []
    for fit in fits:
        steps = 25 if best - fit.evidence() < 10 * REACH else 3
        found.append(
            descend(robot, fit.hypothesis, fit.parameters, sample, fit.z, tempered=0, linear=steps, tolerance=0.02)
        )
    return [*sorted(found[:-1], key=lambda fit: -fit.evidence()), found[-1]]


def _varied(promises: Sequence[Promise], count: int) -> list[Promise]:
    """The most promising, at most a third of them from one effect."""
    kept: list[Promise] = []
    for promise in promises:
        same = sum(other.hypothesis.effect == promise.hypothesis.effect for other in kept)
        if same < max(2, count // 3):
            kept.append(promise)
        if len(kept) == count:
            break
    return kept
