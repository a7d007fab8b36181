"""Scaling laws over published robots, drives and gears: what a data sheet leaves out, and within what factor."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from twin.yamlfile import read_yaml

LEAST_SCATTER = 1.2
"""No law is trusted closer than ×/÷ this, however well its few points lie on a line."""


@dataclass(frozen=True)
class Estimate:
    """A number from a law: ``value``, one standard deviation as a factor ``within``, and where the points are from."""

    value: float
    within: float
    source: str

    def times(self, other: "Estimate") -> "Estimate":
        """The product of two estimates whose errors have nothing to do with each other."""
        within = float(np.exp(np.hypot(np.log(self.within), np.log(other.within))))
        return Estimate(self.value * other.value, within, f"{self.source}; {other.source}")


@cache
def _published() -> dict[str, Any]:
    return read_yaml(Path(__file__).with_name("published.yaml"))


def estimate(law: str, *x: float) -> Estimate:
    """What a law of ``published.yaml`` gives at ``x`` (as many numbers as its points have, in its units).

    log y is a straight line in log x by least squares, or the mean of log y. ``within`` is e to the power of the
    residuals' standard deviation, the fitted coefficients taken off the degrees of freedom.
    """
    points = _published()[law]
    y = np.log(points["y"])
    given = np.log(np.reshape(points["x"], (len(y), -1))) if points["x"] else np.zeros((len(y), 0))
    if given.shape[1] != len(x):
        raise ValueError(f"{law}: expected {given.shape[1]} numbers, found {len(x)}")
    line = np.column_stack([np.ones(len(y)), given])
    coefficients = np.linalg.lstsq(line, y, rcond=None)[0]
    spread = np.sqrt(np.sum((y - line @ coefficients) ** 2) / max(len(y) - len(coefficients), 1))
    value = np.exp(coefficients @ np.array([1.0, *np.log(x)]))
    return Estimate(float(value), max(float(np.exp(spread)), LEAST_SCATTER), points["source"])
