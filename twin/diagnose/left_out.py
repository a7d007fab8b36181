"""Every posture of a hammer test left out in turn: whether an answer predicts postures that it was not fitted to.

What a faint thing adds to one posture that was kept aside may be less than noise there, and chance decides whether the
error falls. Left out in turn, every posture is predicted by a fit to the others, without and with the answer (Stone,
Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B 36, 111, 1974).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.refit import Fitted, descend, recorded_energy
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.model.recorded import Recorded
from twin.parallel import spread
from twin.robot.description import Robot


@dataclass(frozen=True)
class LeftOut:
    """What two models miss of postures that neither was fitted to.

    Attributes:
        names: the postures.
        error: (2,) RMS of residual over RMS of data, weighted, without and with the answer.
        gain: ½ χ² that the answer takes away.
    """

    names: tuple[str, ...]
    error: tuple[float, float]
    gain: float


def left_out(
    base: Robot, before: Fitted, after: Fitted, sample: Sample, kept: Sequence[Recorded], processes: int
) -> LeftOut | None:
    """Every posture of a sample left out in turn, and those that were kept aside; ``None`` where it has but one.

    Args:
        base: the description that the fits' hypotheses are added to.
        before, after: fitted to ``sample``, without and with the answer.
    """
    names = list(dict.fromkeys(r.setup.name for r in sample.recordings))
    if len(names) < 2:
        return None
    pairs = [(name, fit) for name in names for fit in (before, after)]

    def missed(number: int) -> FloatArray:
        name, fit = pairs[number]
        rest = tuple(r for r in sample.recordings if r.setup.name != name)
        again = descend(
            base, fit.hypothesis, fit.parameters, Sample(rest, sample.repeat), fit.z, tempered=0, tolerance=0.02
        )
        return np.array(recorded_energy(again.robot, [r for r in sample.recordings if r.setup.name == name])[:2])

    found = list(spread(missed, len(pairs), processes))
    each = [found[0::2], found[1::2]]
    if kept:
        for some, fit in zip(each, (before, after), strict=True):
            some.append(np.array(recorded_energy(fit.robot, kept)[:2]))
    residual, data = np.array(each).sum(axis=1).T
    told = dict.fromkeys([*names, *(r.setup.name for r in kept)])
    error = np.sqrt(residual / data)
    return LeftOut(
        tuple(told), (float(error[0]), float(error[1])), 0.5 * float(residual[0] - residual[1]) * sample.repeat
    )
