"""What data hold of damping in a posture that was not recorded.

A damper fitted in some postures foretells the damping ratios of another. Where that posture was measured too,
e = ln(measured/foretold) tells how far off that is: by the posterior of the dampers (V), by the measurement (σ²), and
by what no constant damper says (τ²: friction, seals and cables that move with the robot). τ is of greatest likelihood
for e ~ N(0, V + σ² + τ²); known from m misses only, it foretells with the tails of Student's t, m degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from twin.identify.posterior import Posterior
from twin.model.linear import state_matrix
from twin.model.sensitivity import structures
from twin.robot.description import Robot
from twin.robot.mechanism import assemble_all

DRAWS = 60
WIDEST = 3.0  # of τ: a factor of twenty
UNKNOWN = 0.46, 12
"""τ and m where no posture tells: of the KR90's Table 7 (Huynh et al. 2020), each posture foretold from the two others
(tools/study_damping_transfer.py)."""


@dataclass(frozen=True)
class Miss:
    """A mode in a posture that was not fitted to: damping ratios, and relative deviations of both."""

    posture: str
    frequency_hz: float
    measured: float
    predicted: float
    measured_spread: float
    predicted_spread: float

    @property
    def ln_ratio(self) -> float:
        """ln measured over predicted."""
        return float(np.log(self.measured / self.predicted))

    @property
    def variance(self) -> float:
        """Of that, as far as measurement and posterior explain it."""
        return self.measured_spread**2 + self.predicted_spread**2


@dataclass(frozen=True)
class Transfer:
    """How well damping is foretold: τ, degrees of freedom, and the misses that say so (none: ``UNKNOWN``)."""

    scatter: float
    freedom: int
    misses: tuple[Miss, ...] = ()

    @property
    def factor90(self) -> float:
        """The factor within which a damping ratio lies with 90 % probability, beside what the posterior says."""
        return float(np.exp(self.scatter * student.ppf(0.95, self.freedom)))

    def data(self) -> dict[str, Any]:
        """For fit.json."""
        return {
            "scatter": self.scatter, "freedom": self.freedom, "factor90": self.factor90,
            "modes": [
                {"posture": m.posture, "frequency_hz": m.frequency_hz, "measured_percent": 100 * m.measured,
                 "predicted_percent": 100 * m.predicted, "predicted_spread": m.predicted_spread}
                for m in self.misses
            ],
        }  # fmt: skip

    def __str__(self) -> str:
        if not self.misses:
            return f"damping elsewhere: not tested; within a factor of {self.factor90:.2g}, as on the KR90 of Table 7"
        postures = ", ".join(dict.fromkeys(miss.posture for miss in self.misses))
        ratios = [miss.predicted / miss.measured for miss in self.misses]
        return (
            f"damping elsewhere: foretold at {min(ratios):.2g} to {max(ratios):.2g} of what was measured in "
            f"{postures}; within a factor of {self.factor90:.2g} (90 %)"
        )


def transfer(misses: Sequence[Miss]) -> Transfer:
    """τ of greatest likelihood, from modes in postures that were not fitted to."""
    if not misses:
        return Transfer(*UNKNOWN)
    square, variance = np.array([m.ln_ratio**2 for m in misses]), np.array([m.variance for m in misses])

    def cost(tau: float) -> float:
        total = variance + tau**2
        return float(np.sum(np.log(total) + square / total))

    found = minimize_scalar(cost, bounds=(0.0, WIDEST), method="bounded")
    tau = float(found.x) if found.fun < cost(0.0) else 0.0
    return Transfer(tau, len(misses), tuple(misses))


def foretold(posterior: Posterior, robot: Robot, q: np.ndarray, brakes: str, frequency_hz: np.ndarray) -> np.ndarray:
    """Deviation (nm,) of ln damping ratio of modes at given frequencies, as far as the posterior knows it.

    Args:
        robot: the fitted one, without limits; ``q`` (n,) rad (m).
        frequency_hz: (nm,) of the fitted robot's modes; in each draw the nearest is taken.
    """
    values: list[list[float]] = []
    for drawn in posterior.robots(robot, DRAWS):
        (model,) = structures(assemble_all(drawn, [q], brakes="off" if brakes == "off" else "on"))
        pole = np.linalg.eigvals(state_matrix(model.M, model.C, model.K, model.loss, model.integral))
        pole = pole[pole.imag > 1e-6 * np.abs(pole)]
        f, ratio = np.abs(pole) / (2 * np.pi), -pole.real / np.abs(pole)
        values.append([ratio[int(np.argmin(np.abs(np.log(f / wanted))))] for wanted in frequency_hz])
    return np.asarray(np.log(np.array(values)).std(axis=0)).reshape(len(frequency_hz))
