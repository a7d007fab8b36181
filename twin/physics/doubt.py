"""What makes a possible number doubtful beside the robot that it belongs to: a spring and a weight to measure it by."""

from dataclasses import dataclass

import numpy as np

LEAST_SAG, MOST_SAG = 1e-8, 1.0  # rad, of a gear under the robot's weight at arm's length
SLOWEST_S = 0.3  # damping over stiffness: a damper that stops a spring within its first swing has less


@dataclass(frozen=True)
class Weight:
    """What a robot weighs: ``mass`` kg of its links, ``torque`` N·m of them at arm's length."""

    mass: float
    torque: float


def of_spring(stiffness: float, damping: float, held: float) -> list[tuple[str, str]]:
    """Field and question about a spring N·m/rad and its damper N·m·s/rad that bear ``held`` N·m."""
    found = []
    if held and np.isfinite(stiffness) and not LEAST_SAG <= (sag := held / stiffness) <= MOST_SAG:
        text = f"{stiffness:g} N·m/rad, and its weight at arm's length ({held:.3g} N·m) bends it by {sag:.2g} rad"
        found.append(("stiffness", text))
    if damping > SLOWEST_S * stiffness:
        text = f"{damping:g} N·m·s/rad on {stiffness:g} N·m/rad: the joint creeps instead of ringing"
        found.append(("damping", text))
    return found
