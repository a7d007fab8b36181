"""PRESS of a hammer test: every blow left out in turn, and predicted by a fit to the others.

One or two postures are too few to keep one aside. So every blow's FRFs are predicted by a fit to those of all others
(Stone, Cross-validatory choice and assessment of statistical predictions, J. R. Stat. Soc. B 36, 111, 1974). Where
sensors rove instead of blows, every sensor is left out.
"""

import numpy as np

from twin.identify.objective import Objective, Sample, channels
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters
from twin.robot.description import Robot

FEW = 3  # blows: of fewer none is left out
OF_RECORDINGS = ("posture", "gain", "point", "direction")  # kinds of parameters that say nothing of the robot


def blows_of(sample: Sample) -> tuple[str, ...]:
    """Labels of all blows, or sensors, that can be left out; none where there are fewer than ``FEW``."""
    names = tuple(dict.fromkeys(label for r in sample.recordings for label in channels(r)[1]))
    return names if len(names) >= FEW else ()


def press(robot: Robot, parameters: Parameters, z: FloatArray, sample: Sample) -> tuple[float, float]:
    """χ² of all blows, each predicted by a fit to the others, and the sum of squares of their data over the noise.

    A fit moves by so little without one of them that it is linear. With residual r, slopes J of the prediction and
    A = JᵀJ + 1, a fit to all but part k misses that part by r_k + J_k (A − J_kᵀJ_k)⁻¹ J_kᵀ r_k: Allen's prediction sum
    of squares (Technometrics 16, 125, 1974), by blocks. What belongs to the recordings themselves, as angles of
    postures and places of nodes, stays as all blows have it.

    Args:
        robot: with the fitted values.
        z: (n,) the fit, at its optimum on the sample.
    """
    data, n = 0.0, len(z)
    pull, held, energy = dict[str, FloatArray](), dict[str, FloatArray](), dict[str, float]()
    for name, felt in Objective(robot, parameters, sample).by_channel(z):
        own = held.setdefault(name, np.zeros((n, n)))
        own[np.ix_(felt.moves, felt.moves)] += felt.slopes @ felt.slopes.T
        pull.setdefault(name, np.zeros(n))[felt.moves] += felt.slopes @ felt.rest
        energy[name] = energy.get(name, 0.0) + float(felt.rest @ felt.rest)
        data += felt.data
    of_robot = [k for k, p in enumerate(parameters) if p.kind not in OF_RECORDINGS]
    some = np.ix_(of_robot, of_robot)
    whole = np.eye(len(of_robot)) + sum(own[some] for own in held.values())
    missed = 0.0
    for name, own in held.items():
        g = pull[name][of_robot]
        step = np.linalg.solve(whole - own[some], g)
        missed += energy[name] + 2 * float(g @ step) + float(step @ own[some] @ step)
    return missed, data
