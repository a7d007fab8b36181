"""What an effect says to a search through a motion log: the prior of its numbers, where to start, its linear parts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

if TYPE_CHECKING:
    from twin.robot.description import Robot

Part = Literal["", "dry", "viscous", "inertia", "slip", "play", "mass", "law", "tilt"]
"""What an effect is to a drive: dry or viscous friction, the rotor's inertia, how dry friction turns round, play in
the gear, mass on a link, a law without a name, a bearing that gives way."""

Test = Literal["clock", "load", "jerk", "reversals", "speeds", "mass", "acceleration", "sweep"]
"""A recording that shows an effect: the same motion later; with another load; short moves at the largest jerk; short
reversals and standstills; constant speeds; a known mass at the flange; one axis at a time at its largest acceleration;
one slow sweep."""

DESCRIBED = 0.1 * (1 / np.sqrt(3))  # relative standard deviation of a number that is described to ±10 %


@dataclass(frozen=True)
class Prior:
    """Of one number of a suspect.

    Attributes:
        name: as in the description; ``stiffness[0]`` for an item of a list.
        deviation: standard deviation, in the parameter's unit; of the logarithm with ``log``.
        mean: in the parameter's unit.
    """

    name: str
    deviation: float
    mean: float = 0.0
    log: bool = False


def scale(name: str, mean: float, factor: float) -> Prior:
    """A number above zero that is known up to a factor."""
    return Prior(name, float(np.log(factor)), mean, log=True)


@dataclass(frozen=True)
class Suspected:
    """One way in which an effect may be missing at a site.

    Attributes:
        values: the entry's parameters, its sizes at no effect.
        own: prior of the (m,) numbers that are fitted.
        starts: (k, m) values of these numbers from which a search starts.
        sizes: which of them the torque is in proportion to, or nearly so; of elements none: it is to all together.
        passive: the first, below zero, would be friction that drives.
    """

    values: dict[str, Any]
    own: Sequence[Prior]
    starts: Sequence[Sequence[float]]
    sizes: tuple[int, ...] = (0,)
    passive: bool = False


class LogView(Protocol):
    """What an effect may ask of the log in which it is looked for, and of the site where it is."""

    @property
    def robot(self) -> "Robot":
        """The description."""

    @property
    def site(self) -> str:
        """Where the effect is looked for."""

    @property
    def axis(self) -> int:
        """Zero-based axis of the site."""

    @property
    def highest_hz(self) -> float:
        """Where the low-pass of torque ends, Hz."""

    @property
    def rate_hz(self) -> float:
        """Rows per second."""

    @property
    def sample_hz(self) -> float:
        """Samples of the log per second: rows are fewer."""

    def usual(self, axis: int | None = None) -> float:
        """The torque that a missing effect ordinarily adds at the site's axis or another, N·m (N)."""

    def speed(self, axis: int | None = None) -> float:
        """RMS speed of the axis, rad/s (m/s)."""

    def acceleration(self, axis: int | None = None) -> float:
        """RMS acceleration of the axis, rad/s² (m/s²)."""

    def middle(self) -> tuple[float, float]:
        """Mean and half range of the axis' position, rad (m)."""

    def size(self, values: dict[str, Any]) -> float:
        """How many times an entry with these values makes a usual torque."""


@dataclass(frozen=True)
class LinearPart:
    """One number in which an entry's torque is linear: a column of the regressor.

    Attributes:
        name, unit: of the number; the column is torque per that unit.
        value: as described.
        values: parameters of an entry whose torque is the column.
        nonnegative: no real robot has it below zero.
    """

    name: str
    unit: str
    value: float
    values: dict[str, Any]
    nonnegative: bool = False
