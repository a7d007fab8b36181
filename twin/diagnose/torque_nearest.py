"""Of all fits of a log with what was found, the one that changes least of what the base model says of everything else.

Where a wrist's torque is mostly noise, numbers of the base model scatter within that noise. The error on runs kept
aside may rise there by more than it falls at the joint where something was found.
"""

import numpy as np

from twin.diagnose.nearest import step_nearer
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import fit_at
from twin.diagnose.torque_system import System
from twin.measure.campaign import FloatArray


def nearest(system: System, best: Fitted, before: Fitted) -> Fitted:
    """A fit as likely as the best of a system, within ``tie``, that predicts torque nearest to the base model's.

    What was found keeps its numbers. The distance is that of the diagnosis' error: the mean over joints of a
    difference's power over that of the torque, on the rows used.

    Args:
        system: with what was found.
        best: its fit.
        before: the base model, in the deviations of the description.
    """
    z, n = best.z.copy(), len(before.z)
    factor = np.array([system.widened.get(k, 1.0) for k in range(n)])
    z[:n] += step_nearer(best.information[:n, :n], _as_shown(system, n), before.z / factor - z[:n])
    return fit_at(system, z)


def _as_shown(system: System, n: int) -> FloatArray:
    """The square of a change of the base model's numbers (n, n), as the error of a diagnosis counts it."""
    power = np.mean(np.concatenate([run.torque[run.valid] for run in system.base.runs]) ** 2, axis=0)
    share = system.noise**2 / np.maximum(power, np.finfo(float).tiny)
    out, scale = np.zeros((n, n)), system.A.scale[:n]
    for a in system.A.blocks:
        for b in system.A.blocks:
            if a.joint == b.joint and a.columns.max() < n and b.columns.max() < n:
                out[np.ix_(a.columns, b.columns)] += share[a.joint] * (a.rows.T @ b.rows)
    return np.asarray(scale[:, None] * out * scale)
