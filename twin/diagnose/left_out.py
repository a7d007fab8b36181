"""Blows of a hammer test left out in turn: whether an answer predicts FRFs that it was not fitted to.

What a faint thing adds to a posture that was kept aside may be less than what is in doubt there: noise, and numbers of
the robot that the other postures hardly hold. Then chance would decide whether the error falls. Blows that are left out
decide (:mod:`twin.identify.press`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.refit import Fitted
from twin.identify.objective import Sample
from twin.identify.press import blows_of, press


@dataclass(frozen=True)
class LeftOut:
    """What two models miss of blows that neither was fitted to.

    Attributes:
        names: labels of the blows, or of the sensors.
        error: (2,) RMS of residual over RMS of data, weighted, without and with the answer.
        gain: ½ χ² that the answer takes away.
    """

    names: tuple[str, ...]
    error: tuple[float, float]
    gain: float


def left_out(before: Fitted, after: Fitted, sample: Sample) -> LeftOut | None:
    """Every blow of a sample left out in turn, in all postures; ``None`` where there are too few.

    Args:
        before, after: fitted to ``sample``, without and with the answer.
    """
    if not (names := blows_of(sample)):
        return None
    missed, data = zip(*(_missed(fit, sample) for fit in (before, after)), strict=True)
    without, with_answer = (float(np.sqrt(energy / data[0])) for energy in missed)
    return LeftOut(names, (without, with_answer), 0.5 * (missed[0] - missed[1]))


def that_foretell(fits: Sequence[Fitted], sample: Sample, reach: float) -> list[Fitted]:
    """The fits without those of several effects of which one makes the prediction of blows that were left out worse.

    Such an effect relieves numbers far from their description, or follows noise. What belongs to the test alone, as the
    turn of one blow, is nothing that other blows could foretell.

    Args:
        fits: most evidence first.
        reach: ln evidence behind the first from which a fit is not looked at, and stays.
    """
    known, missed = {fit.hypothesis.identity: fit for fit in fits}, dict[int, float]()

    def of(fit: Fitted) -> float:
        if id(fit) not in missed:
            missed[id(fit)] = _missed(fit, sample)[0]
        return missed[id(fit)]

    def worse(fit: Fitted) -> bool:
        laws = [piece for piece in fit.hypothesis.pieces if not piece.exact]
        if len(laws) < 2 or fits[0].evidence() - fit.evidence() > reach:
            return False
        simpler = [known.get(fit.hypothesis.identity - {piece.key}) for piece in laws]
        return any(of(fit) > of(rest) for rest in simpler if rest)

    return [fit for fit in fits if not worse(fit)] if blows_of(sample) else list(fits)


def _missed(fit: Fitted, sample: Sample) -> tuple[float, float]:
    return press(fit.robot, fit.parameters, fit.z, sample)
