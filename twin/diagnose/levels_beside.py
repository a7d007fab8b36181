"""What linear physics is missing beside a law of amplitude: the linear search on a robot whose law is held.

The law's torque after every blow is held as stepping has it (:mod:`twin.diagnose.held_law`), and the search for one
linear omission runs as it does on a linear robot. What it finds moves the law's own numbers: the finalists
are fitted again with the law stepped, their law is held, and the decision is between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.decide import Decision, decide
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.joint_reaction import Stepped
from twin.diagnose.levels import LINEAR, Levels, fit_law, settled, with_law
from twin.diagnose.locate import free_laws
from twin.diagnose.objective import Sample
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.screen import inflation
from twin.diagnose.search import REFIT_LINES, Progress, Search, one_more
from twin.robot.description import Robot

LINES = 100  # of every recording
FINALISTS = 3  # fitted again with the law stepped
PROMISING = 0.8  # of the best one's gain


@dataclass(frozen=True)
class Beside:
    """What linear physics is missing beside a law.

    Attributes:
        decision: between the law alone and with something beside it, the law held.
        alone: the law alone there.
        fits: per ranked hypothesis, it and the law with the law stepped; ``objectives`` what predicts with them.
    """

    decision: Decision
    alone: Fitted
    fits: list[Fitted]
    objectives: list[Stepped]


def explain_beside(
    robot: Robot,
    base: Fitted,
    levels: Levels,
    suspects: Sequence[Sequence[Hypothesis]],
    progress: Progress | None = None,
) -> Beside | None:
    """Linear physics beside the law that force levels show best.

    Args:
        robot: the description, without limits; ``base`` its optimum without the law.
        levels: what they say.
        suspects: what else may be missing.

    Returns:
        ``None`` where nothing would be gained.
    """
    law, stepped = levels.fits[0], levels.objectives[0]
    n = len(base.parameters)
    lines = levels.whole.thin(LINES)
    whole = _held(stepped, law, lines, levels)
    alone = descend(robot, NONE, base.parameters, whole, law.z[:n], tempered=0, linear=LINEAR)
    search = Search(alone, [], alone.z, inflation(alone, robot, whole.thin(REFIT_LINES)))
    bars = progress or (lambda description, total: lambda count: None)
    found = one_more(robot, search, whole, suspects, bars)
    tried = {fit.hypothesis.key for fit in found}
    elsewhere = [v for v in suspects if v[0].effect == found[0].hypothesis.effect and v[0].key not in tried]
    if elsewhere:  # with the law's own numbers still to move, a site that promised less may be the right one
        one_more(robot, search, whole, elsewhere, bars)
    found = [fit for fit in search.finalists if fit.evidence() > alone.evidence()]
    if not found:
        return None
    best = found[0]
    least = alone.evidence() + PROMISING * (best.evidence() - alone.evidence())  # the law's own numbers still move
    found = [fit for fit in found if fit is best or (fit.evidence() > least and not _more(fit, best))]
    again: list[tuple[Fitted, Fitted, Stepped, Sample]] = []
    for fit in found[:FINALISTS]:
        objective, hypothesis = with_law(
            robot, base, stepped.law, stepped.site, stepped.sample, stepped.blow, fit.hypothesis
        )
        both = settled(objective, fit_law(objective, hypothesis, np.concatenate([fit.z, law.z[n:]]), 0))
        own = _held(objective, both, lines, levels)
        z = both.z[: len(fit.z)]
        linear = descend(robot, fit.hypothesis, fit.parameters, own, z, tempered=0, linear=LINEAR)
        again.append((linear, both, objective, own))
    by_fit = {id(linear): own for linear, _, _, own in again}
    decision = decide(
        [linear for linear, *_ in again], alone, suspects,
        unnamed=lambda fit: free_laws(fit, by_fit.get(id(fit), whole)),
    )  # fmt: skip
    order = [next(item for item in again if item[0] is fit) for fit in decision.ranked]
    return Beside(decision, alone, [item[1] for item in order], [item[2] for item in order])


def _more(fit: Fitted, than: Fitted) -> bool:
    """Whether a hypothesis holds everything that another does, and something that pays for nothing."""
    return than.hypothesis.identity < fit.hypothesis.identity


def _held(stepped: Stepped, fit: Fitted, sample: Sample, levels: Levels) -> Sample:
    """Recordings with the law held as it is in a fit."""
    return Sample(tuple(replace(stepped, sample=sample, blow=levels.blow).held(fit.z)), sample.repeat)
