"""The motion of all axes over time, as the torque laws of the effects read it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass
class Motion:
    """States of n axes at nt instants; laws are added one after the other.

    Attributes:
        time: (nt,) s, the campaign's clock.
        position: (nt, n) rad (m), as encoders say it, or of the axes themselves: :meth:`of_axes`.
        velocity: (nt, n) rad/s (m/s).
        acceleration: (nt, n) rad/s² (m/s²).
        load: (nt, n) N·m (N), torque through the gears: rigid body and compensator.
        friction: (nt, n) N·m (N), sum of the friction laws evaluated so far.
        sign: signum of a velocity; time stepping replaces it by a continuous one.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    load: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    friction: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    sign: Callable[[np.ndarray], np.ndarray] = np.sign

    def __post_init__(self) -> None:
        if not self.load.size:
            self.load = np.zeros_like(self.position)
        if not self.friction.size:
            self.friction = np.zeros_like(self.position)

    def of_axes(self, zeros: np.ndarray) -> "Motion":
        """The motion of axes whose encoders' zeros (n,) are off: what bodies and laws of position feel."""
        return replace(self, position=self.position + zeros) if zeros.any() else self
