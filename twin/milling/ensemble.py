"""How sure a model is of what happens at the tool: the same tip for many robots that the recordings allow.

Each draw is a robot from the posterior beside ``robot.yaml`` (:mod:`twin.identify.posterior`). It stands in the posture
within the tolerance of its angles. Its dampings are those of an unseen posture (:mod:`twin.identify.damping_transfer`).
"""

from dataclasses import dataclass

import numpy as np

from twin.identify.posterior import Posterior, posterior_beside, without_entries
from twin.milling.cut import Cut
from twin.milling.postures import Tips, stacked, tips
from twin.milling.tool_point import ToolModes
from twin.robot.description import Robot
from twin.robot.physical import physical

MODES = 32  # whose dampings are drawn, each on its own
DRAWS = 100
"""Robots drawn: the 10 % quantile of a depth is then itself known to ±3 %-points."""


@dataclass(frozen=True)
class Ensemble:
    """Robots (count) that the recordings allow, and what else is drawn with each.

    Attributes:
        angle: (count, n) error of the posture, rad (m).
        coefficients: (count, 3) shear coefficients of the cut, N/m².
        damping: (count, modes) Student's t; ``scatter`` its scale, of ln damping in a posture not recorded.
    """

    robots: list[Robot]
    angle: np.ndarray
    coefficients: np.ndarray
    damping: np.ndarray
    scatter: float = 0.0

    def __len__(self) -> int:
        return len(self.robots)

    def tips(self, q: np.ndarray, cut: Cut, brakes: str | None = "on") -> Tips:
        """The tip in postures q (N, n), rad (m), draws on the first axis: poles (count, N, nm) and so on."""
        found = stacked([tips(robot, q + e, cut, brakes) for robot, e in zip(self.robots, self.angle, strict=True)])
        if not self.scatter:
            return found
        modes_there = found.modes.pole.shape[-1]
        factor = np.exp(self.scatter * self.damping[:, None, np.arange(modes_there) % self.damping.shape[1]])
        modes = more_damped(found.modes, factor)
        return Tips(modes, found.position, found.axis, found.compliance)


def more_damped(modes: ToolModes, factor: np.ndarray) -> ToolModes:
    """Modes with their damping ratios multiplied, frequencies |λ| and shapes kept; real poles stay."""
    size = np.abs(modes.pole)
    ratio = np.minimum(-modes.pole.real * factor / size, 0.999)
    pole = np.where(modes.pole.imag > 0, size * (-ratio + 1j * np.sqrt(1 - ratio**2)), modes.pole)
    return ToolModes(pole, modes.shape, modes.residual)


def ensemble(
    robot: Robot,
    cut: Cut,
    count: int = DRAWS,
    seed: int = 0,
    *,
    posterior: Posterior | None = None,
    scatter: float | None = None,
) -> Ensemble | None:
    """Draws of what the recordings allow; ``None`` where no posterior is known.

    Args:
        robot: as fitted; ``posterior.h5`` beside its file is read unless ``posterior`` is given.
        cut: whose coefficients are drawn.
        count: how many robots.
        scatter: deviation of ln damping in unseen postures; by default what the posterior states.
    """
    known = posterior or posterior_beside(robot)
    if known is None:
        return None
    known = without_entries(known, robot)
    rng = np.random.default_rng([seed, 1])
    width = np.deg2rad(robot.tolerances.posture_deg)
    return Ensemble(
        [physical(drawn) for drawn in known.robots(robot, count, seed)],
        width * rng.standard_normal((count, robot.axis_count)),
        cut.coefficients.draw(rng, count),
        rng.standard_t(known.damping_freedom, (count, MODES)),
        known.damping_scatter if scatter is None else scatter,
    )


def quantile_of_safe(depth: np.ndarray, probability: float = 0.9) -> np.ndarray:
    """The depth (…) that is stable with a probability, from limits (count, …) of the draws.

    Their lower quantile: Weibull's, below which another draw falls with the probability left, however few there are.
    """
    return np.quantile(depth, 1 - probability, axis=0, method="weibull")
