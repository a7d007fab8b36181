"""Of all fits of a hammer test with what was found, the one that changes least in postures that were kept aside.

The postures used hold some combinations of numbers hardly at all, and others show in a posture kept aside. There a fit
may lose more by noise than a faint thing gains.
"""

from dataclasses import replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.nearest import step_nearer
from twin.diagnose.refit import Fitted, placed
from twin.diagnose.search import REFIT_LINES
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters, Sprung, independent, join, recording_parameters, written_names

SHARES = 0.8 ** np.arange(16)  # of the step that are tried


def nearest(best: Fitted, before: Fitted, sample: Sample, kept: Sample) -> Fitted:
    """A fit as likely as the best, within ``tie``, that predicts what was kept aside nearest to the base model.

    What was found keeps its numbers. The angles of postures follow: those of the postures kept are estimated anew.

    Args:
        best: with what was found, fitted to ``sample``.
        before: the base model, fitted to it.
        kept: what was held out.
    """
    parameters, names = best.parameters, written_names(best.parameters).names
    known = dict(zip(written_names(before.parameters).names, before.values, strict=True))
    fixed = {name for name, _ in best.hypothesis.scale} | {names[k] for k in best.own}
    angle = [k for k, p in enumerate(parameters) if p.kind == "posture"]
    moved = [k for k, name in enumerate(names) if name in known and name not in fixed and k not in angle]
    values = best.values.copy()
    values[moved] = [known[names[k]] for k in moved]
    back = np.linalg.inv(parameters.root)
    x, target = (np.asarray(parameters.root @ parameters.coordinates(v)) for v in (best.values, values))
    information = back.T @ best.information @ back
    follow = -np.linalg.solve(information[np.ix_(angle, angle)], information[np.ix_(angle, moved)])
    held = information[np.ix_(moved, moved)] + information[np.ix_(moved, angle)] @ follow
    step = step_nearer(held, _as_shown(best, moved, kept), (target - x)[moved])
    whole = np.zeros(len(x))
    whole[moved], whole[angle] = step, follow @ step
    step = np.asarray(np.linalg.solve(parameters.root, whole))
    objective = Objective(best.robot, parameters, sample)
    z: FloatArray = best.z
    cost = objective.cost(z)
    for share in SHARES:  # valleys are bent: the quadratic has the whole step cost ``tie``
        if (reached := objective.cost(best.z + share * step)) <= cost + calibration()["tie"]:
            z, cost = np.asarray(best.z + share * step), reached
            break
    values = parameters.values(z)
    misfit = (2 * cost - float(z @ z)) / max(best.data, 1)
    return replace(best, z=z, values=values, described=parameters.apply(best.robot, values), cost=cost, misfit=misfit)


def _as_shown(fit: Fitted, moved: list[int], kept: Sample) -> FloatArray:
    """The square of a change of x of some numbers, over the noise of recordings that the fit was not made for."""
    kept = placed(fit, kept.thin(REFIT_LINES))
    own = independent(recording_parameters(fit.robot, dict.fromkeys(r.setup.name for r in kept.recordings), ()))
    own = own.only("posture")
    some: Parameters = fit.parameters.select(moved)
    free = join(some, own)
    if isinstance(some, Sprung):
        free = Sprung(free.items, free.covariance, join(some.written, own))
    z = free.coordinates(np.concatenate([fit.values[moved], [p.mean for p in own]]))
    _, rows = Objective(fit.robot, free, kept).jacobian(z)
    n = len(moved)
    of_x, angles = np.linalg.solve(some.root.T, rows[:n]), rows[n:]
    across = of_x @ angles.T
    return np.asarray(of_x @ of_x.T - across @ np.linalg.solve(angles @ angles.T + np.eye(len(own)), across.T))
