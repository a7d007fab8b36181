"""Every blow of a hammer test left out in turn: whether an answer predicts FRFs that it was not fitted to.

One or two postures are too few to keep one aside. What a faint thing adds to one that was kept aside may be less than
what is in doubt there: noise, and numbers of the robot that the other postures hardly hold. Then chance would decide
whether the error falls. So every blow's FRFs are predicted by a fit to those of all others, without and with the answer
(Stone, Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B 36, 111, 1974). Where
sensors rove instead of blows, every sensor is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.refit import Fitted
from twin.identify.objective import Objective, Sample, channels
from twin.measure.campaign import FloatArray

FEW = 3  # blows: of fewer none is left out
OF_RECORDINGS = ("posture", "gain", "point", "direction")  # kinds of parameters that say nothing of the robot


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
    """Every blow of a sample left out in turn, in all postures; ``None`` where there are fewer than ``FEW``.

    The fits move by so little without one of them that they are linear. With residual r, slopes J of the prediction and
    A = JᵀJ + 1, a fit to all but part k misses that part by r_k + J_k (A − J_kᵀJ_k)⁻¹ J_kᵀ r_k: Allen's prediction sum
    of squares (Technometrics 16, 125, 1974), by blocks. What belongs to the recordings themselves, as angles of
    postures and places of nodes, stays as all blows have it.

    Args:
        before, after: fitted to ``sample``, without and with the answer.
    """
    names = _names(sample)
    if len(names) < FEW:
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

    return [fit for fit in fits if not worse(fit)] if len(_names(sample)) >= FEW else list(fits)


def _names(sample: Sample) -> tuple[str, ...]:
    """Labels of all blows, or sensors."""
    return tuple(dict.fromkeys(label for r in sample.recordings for label in channels(r)[1]))


def _missed(fit: Fitted, sample: Sample) -> tuple[float, float]:
    """χ² of all blows, each predicted by a fit to the others, and the sum of squares of their data."""
    n, data = len(fit.z), 0.0
    pull, held, energy = dict[str, FloatArray](), dict[str, FloatArray](), dict[str, float]()
    for name, felt in Objective(fit.robot, fit.parameters, sample).by_channel(fit.z):
        own = held.setdefault(name, np.zeros((n, n)))
        own[np.ix_(felt.moves, felt.moves)] += felt.slopes @ felt.slopes.T
        pull.setdefault(name, np.zeros(n))[felt.moves] += felt.slopes @ felt.rest
        energy[name] = energy.get(name, 0.0) + float(felt.rest @ felt.rest)
        data += felt.data
    robot = [k for k, p in enumerate(fit.parameters) if p.kind not in OF_RECORDINGS]
    some = np.ix_(robot, robot)
    whole = np.eye(len(robot)) + sum(own[some] for own in held.values())
    missed = 0.0
    for name, own in held.items():
        g = pull[name][robot]
        step = np.linalg.solve(whole - own[some], g)
        missed += energy[name] + 2 * float(g @ step) + float(step @ own[some] @ step)
    return missed, data
