"""What linear physics is missing beside a law of amplitude: the linear search on a robot whose law is held.

The law's torque after every blow is held as stepping has it (:mod:`twin.model.held_law`), and the search for one
linear omission runs as it does on a linear robot. What it finds moves the law's own numbers: the finalists are fitted
again with the law stepped, their law is held, and the decision is between them. A law of few numbers is not exactly the
robot's, and a partner may explain what it leaves. Two things keep such a partner out. Where one seems worth it and the
law has more numbers to settle (the deflections at which slip yields), they are settled and it is sought anew. And every
blow may have a further stiffness of its own at the law's joint, with a partner and without. Only what a partner gains
beside that counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.decide import Decision, decide
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.levels import FAR_OFF, LINEAR_STEPS, Levels, fit_law, settled, with_law
from twin.diagnose.locate import free_blows, free_laws
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.screen import inflation
from twin.diagnose.search import REFIT_LINES, WORTH, Search, one_more
from twin.identify.joint_reaction import Stepped
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.parallel import Progress
from twin.robot.description import Robot

BESIDE_LINES = 40  # of every recording
STEPPED_AGAIN = 2  # fitted again with the law stepped
BESIDE_SHARE = 0.8  # of the best one's gain
STEP_DOUBT = 0.02  # of the noise's variance: less that hangs on the length of steps is not looked at


@dataclass(frozen=True)
class Beside:
    """What linear physics is missing beside a law.

    Attributes:
        law: the law alone, settled, and fitted again from where it ended beside something else; ``stepped`` what
            predicts with it.
        decision: between it and with something beside it, the law held; ``None`` where nothing would be gained.
        fits: per ranked hypothesis, it and the law with the law stepped; ``objectives`` what predicts with them.
    """

    law: Fitted
    stepped: Stepped
    decision: Decision | None
    fits: list[Fitted]
    objectives: list[Stepped]


def explain_beside(
    robot: Robot,
    base: Fitted,
    levels: Levels,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress | None = None,
) -> Beside:
    """Linear physics beside the law that force levels show best.

    Args:
        robot: the description, without limits; ``base`` its optimum without the law.
        levels: what they say.
        suspects: what else may be missing.
    """
    law, stepped, given = levels.fits[0], levels.objectives[0], levels
    if law.misfit > FAR_OFF:
        return Beside(law, stepped, None, [], [])
    whole = _doubted(replace(stepped, sample=levels.whole, blow=levels.blow), law.z)
    if whole is not levels.whole:
        levels, law = replace(levels, whole=whole), fit_law(stepped, law.hypothesis, law.z)
    n = len(base.parameters)
    found = _found(robot, base, levels, law, suspects, progress)
    if not found:
        return Beside(law, stepped, None, [], [])
    first, objective = _both(robot, base, stepped, law, found[0])

    def worth() -> bool:
        return first.evidence() - law.evidence() >= WORTH * max(1.0, law.misfit)

    if worth() and not law.converged:  # fitted again from where the richer ended: that is no discovery
        simpler = fit_law(stepped, law.hypothesis, np.concatenate([first.z[:n], first.z[len(found[0].z) :]]))
        law = simpler if simpler.cost < law.cost else law
    if not worth():
        return Beside(law, stepped, None, [], [])
    if stepped.law.settling() is not stepped.law:  # what few numbers leave is no sign of a partner
        law, stepped = settled(levels, law, stepped, levels.whole, levels.blow)
        levels = replace(given, fits=[law, *given.fits[1:]], objectives=[stepped, *given.objectives[1:]])
        return explain_beside(robot, base, levels, suspects, progress)
    both = [(found[0], first, objective)]
    both += [(fit, *_both(robot, base, stepped, law, fit)) for fit in found[1:STEPPED_AGAIN]]
    lines = levels.whole.thin(BESIDE_LINES)
    whole = _held(stepped, law, lines, levels)
    alone = descend(robot, NONE, base.parameters, whole, law.z[:n], tempered=0, linear=LINEAR_STEPS)
    again: list[tuple[Fitted, Fitted, Stepped, Sample]] = []
    for fit, stepping, objective in both:
        own = _held(objective, stepping, lines, levels)
        z = stepping.z[: len(fit.z)]
        linear = descend(robot, fit.hypothesis, fit.parameters, own, z, tempered=0, linear=LINEAR_STEPS)
        again.append((linear, stepping, objective, own))
    held = {id(fit): own for fit, _, _, own in again} | {id(alone): whole}
    beside = [fit for fit, *_ in again]
    another = {id(fit): free_blows(fit, held[id(fit)], stepped.site) for fit in (alone, *beside)}
    misfit = max(1.0, min(fit.misfit for fit in (alone, *beside)))
    handicap = [(another[id(alone)][0] - another[id(fit)][0]) / misfit for fit in beside]

    def unnamed(fit: Fitted) -> dict[str, float]:
        """At other joints, beside another law at this one."""
        gains = free_laws(fit, held[id(fit)], another[id(fit)][1])
        return {site: gain for site, gain in gains.items() if site != stepped.site}

    decision = decide(beside, alone, suspects, handicap=handicap, unnamed=unnamed)
    order = [next(item for item in again if item[0] is fit) for fit in decision.ranked]
    return Beside(law, stepped, decision, [item[1] for item in order], [item[2] for item in order])


def _doubted(stepped: Stepped, z: FloatArray) -> Sample:
    """The recordings with what steps twice as long change added to their noise, where that is no small part of it.

    An open gap makes the end of a decay erratic. A partner would then explain errors of the steps.
    """
    fine, coarse = (replace(stepped, rate_hz=rate).predicted(z) for rate in (stepped.rate_hz, stepped.rate_hz / 2))
    error = [np.abs(a - b) ** 2 for a, b in zip(fine, coarse, strict=True)]
    recordings = stepped.sample.recordings
    if max(float(np.mean(e / r.variance)) for e, r in zip(error, recordings, strict=True)) < STEP_DOUBT:
        return stepped.sample
    louder = tuple(replace(r, variance=r.variance + e) for r, e in zip(recordings, error, strict=True))
    return Sample(louder, stepped.sample.repeat)


def _both(robot: Robot, base: Fitted, stepped: Stepped, law: Fitted, fit: Fitted) -> tuple[Fitted, Stepped]:
    """Something linear and the law beside it, fitted with the law stepped, and what predicts with them."""
    objective, hypothesis = with_law(
        robot, base, stepped.law, stepped.site, stepped.sample, stepped.blow, fit.hypothesis
    )
    objective, n = replace(objective, processes=stepped.processes), len(base.parameters)
    places = [np.concatenate([start, fit.z[n:], law.z[n:]]) for start in (law.z[:n], fit.z[:n])]
    return fit_law(objective, hypothesis, places[int(np.argmin(objective.costs(places)))]), objective


def _found(
    robot: Robot,
    base: Fitted,
    levels: Levels,
    law: Fitted,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress | None,
) -> list[Fitted]:
    """What promises to be missing with the law held as it is in a fit, most evidence first."""
    whole = _held(levels.objectives[0], law, levels.whole.thin(BESIDE_LINES), levels)
    n = len(base.parameters)
    alone = descend(robot, NONE, base.parameters, whole, law.z[:n], tempered=0, linear=LINEAR_STEPS)
    error = inflation(alone, robot, whole.thin(REFIT_LINES))
    search = Search(alone, [], alone.z, error, processes=levels.objectives[0].processes)
    bars = progress or (lambda description, total: lambda count: None)
    found = one_more(robot, search, whole, suspects, bars)
    tried = {fit.hypothesis.key for fit in found}
    elsewhere = [v for v in suspects if v[0].effect == found[0].hypothesis.effect and v[0].key not in tried]
    if elsewhere:  # with the law's own numbers still to move, a site that promised less may be the right one
        one_more(robot, search, whole, elsewhere, bars)
    found = [fit for fit in search.finalists if fit.evidence() > alone.evidence()]
    if not found:
        return []
    best = found[0]
    least = alone.evidence() + BESIDE_SHARE * (best.evidence() - alone.evidence())  # the law's own numbers still move
    return [fit for fit in found if fit is best or (fit.evidence() > least and not _more(fit, best))]


def _more(fit: Fitted, than: Fitted) -> bool:
    """Whether a hypothesis holds everything that another does, and something that pays for nothing."""
    return than.hypothesis.identity < fit.hypothesis.identity


def _held(stepped: Stepped, fit: Fitted, sample: Sample, levels: Levels) -> Sample:
    """Recordings with the law held as it is in a fit."""
    return Sample(tuple(replace(stepped, sample=sample, blow=levels.blow).held(fit.z)), sample.repeat)
