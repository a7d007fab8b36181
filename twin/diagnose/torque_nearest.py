"""Of all fits of a log with what was found, the one that changes least of what the base model says of everything else.

A find changes numbers of the base model, also those that a recording hardly holds: where a wrist's torque is mostly
noise, they scatter within it. The error on runs kept aside may rise there by more than it falls where something was
found. A fit that is as likely, and leaves such numbers where they were, shows the find alone.
"""

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import fit_at
from twin.diagnose.torque_system import System
from twin.measure.campaign import FloatArray

HALVINGS = 60  # of the range in which the multiplier is looked for


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


def step_nearer(information: FloatArray, shown: FloatArray, away: FloatArray) -> FloatArray:
    """The step (n,) from an optimum that loses ``tie`` of ln probability at most and is then nearest in what shows.

    Args:
        information: (n, n) of what is known at the optimum, prior included.
        shown: (n, n) the square of a change as it shows in predictions.
        away: (n,) where predictions would be those aimed at, from the optimum.
    """
    scale = 1 / np.sqrt(np.diag(information))
    held, axes = np.linalg.eigh(scale[:, None] * information * scale)
    held = np.sqrt(np.maximum(held, np.finfo(float).eps * held.max(initial=0.0)))  # rounding takes it below
    turn = scale[:, None] * axes / held
    size, along = np.linalg.eigh(turn.T @ shown @ turn)
    step = _within(np.maximum(size, 0.0), along.T @ (held * (axes.T @ (away / scale))), calibration()["tie"])
    return np.asarray(turn @ along @ step)


def _within(size: FloatArray, away: FloatArray, most: float) -> FloatArray:
    """The step (n,) of least Σ size (away − step)² with ½ Σ step² at most ``most``."""
    shown = size > np.finfo(float).eps * size.max(initial=0.0)
    if 0.5 * float(away[shown] @ away[shown]) <= most:
        return np.where(shown, away, 0.0)
    low, high = np.log(size[shown].min()) - 20.0, np.log(size.max()) + 20.0
    step = np.zeros(len(away))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        trial = size / (size + np.exp(middle)) * away
        if 0.5 * float(trial @ trial) > most:
            low = middle
        else:
            high, step = middle, trial
    return step
