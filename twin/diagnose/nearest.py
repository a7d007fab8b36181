"""Of fits that are as likely as the best, the one whose predictions change least: the step to it.

A find changes numbers of the base model, also those that a recording hardly holds. They scatter within noise, and so
does the error on what was kept aside. A fit that is as likely, and leaves them where they were, shows the find alone.
"""

import numpy as np

from twin.diagnose.calibration import calibration
from twin.measure.campaign import FloatArray

HALVINGS = 60  # of the range in which the multiplier is looked for


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
