"""A foundation that is a body of its own: a slab under the robot's foot, on springs along and about the base's axes."""

from itertools import product
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import UNIT_VECTORS, Companion, Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
SEARCHED = ("z", "rx", "ry")
"""Directions that a search frees: a slab on soil bounces and rocks; it neither slides nor turns freely."""
CONCRETE = 2400.0  # kg/m³


TYPICAL_HZ = {"z": 20.0, "rx": 15.0, "ry": 15.0}
PER_BAND, APART = 7, 0.3  # frequencies from which a search starts, in each direction, and how near in logarithm


class FloorMode(Effect):
    """Natively: slides and hinges of the base body, and its mass. Directions that are left out are rigid."""

    name = "floor_mode"
    sites = ("base",)
    parameters = (
        Parameter("mass", "kg", nonnegative=True, spread=1.0),
        Parameter("inertia", "kg·m²", nonnegative=True, length=3, spread=1.5),
        *(Parameter(d, "N/m", inf, positive=True, optional=True, spread=1.6) for d in DIRECTIONS[:3]),
        *(Parameter(d, "N·m/rad", inf, positive=True, optional=True, spread=1.6) for d in DIRECTIONS[3:]),
        Parameter("damping_ratio", "1", nonnegative=True, spread=1.0),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    adds_mode = True

    def check(self, values: Values) -> str | None:
        if all(not np.isfinite(values.get(d, inf)) for d in DIRECTIONS):
            return f"expected a stiffness in at least one of {', '.join(DIRECTIONS)}"
        moments = sorted(_of_a_body(np.array(values["inertia"], float), values))
        if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            return f"inertia: expected no moment above the sum of the two others, found {values['inertia']}"
        return None

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mass, inertia = values["mass"], np.array(values["inertia"], float)
        for d in DIRECTIONS:
            if not np.isfinite(values[d]):
                continue
            turns = d.startswith("r")
            moved = inertia["xyz".index(d[-1])] if turns else mass
            damping = 2 * values["damping_ratio"] * float(np.sqrt(values[d] * moved))
            axis, kind = UNIT_VECTORS[d[-1]], "hinge" if turns else "slide"
            mechanism.spring("base", f"floor.{d}", axis, values[d], damping, kind)  # type: ignore[arg-type]
        mechanism.attach("base", mass, np.zeros(3), np.diag(_of_a_body(inertia, values)))

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """A foundation without a mass of its own."""
        return [Companion("base_compliance", f"base.{d}") for d in SEARCHED]

    def parts(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """Springs alone: what a slab of little mass, or far below its resonance, comes to."""
        free = [d for d in DIRECTIONS if np.isfinite(values.get(d, inf))]
        return [Companion("base_compliance", f"base.{d}", {"stiffness": values[d]}) for d in free]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """Three times the robot's mass, as a slab of its reach; rocks and bounces with it at ``TYPICAL_HZ``.

        A robot whose links have no length, as one of a single axis, stands on a cube of concrete.
        """
        own, slab = sum(link.inertial[0] for link in robot.links), 3 * sum(link.inertial[0] for link in robot.links)
        reach = sum(float(np.hypot(axis.a, axis.d)) for axis in robot.axes) / 2 or np.cbrt(slab / CONCRETE)
        turn = slab * reach**2 / 3
        rocks = (turn + own * reach**2) * (2 * np.pi * TYPICAL_HZ["rx"]) ** 2
        return {
            "mass": slab, "inertia": [turn, turn, 2 * turn], "z": (slab + own) * (2 * np.pi * TYPICAL_HZ["z"]) ** 2,
            "rx": rocks, "ry": rocks, "damping_ratio": 0.03,
        }  # fmt: skip

    def variants(self, robot: "Robot", site: str, band_hz: tuple[float, float]) -> list[dict[str, Any]]:
        """The typical slab; springs with which it rocks and bounces at every choice of ``PER_BAND`` frequencies."""
        typical = self.typical(robot, site) or {}
        count = min(PER_BAND, int(np.ceil(np.log(band_hz[1] / band_hz[0]) / APART)) + 1)
        tuned = [(np.geomspace(*band_hz, count) / TYPICAL_HZ[d]) ** 2 for d in SEARCHED]
        return [
            typical,
            *({**typical, **{d: typical[d] * float(s) for d, s in zip(SEARCHED, scale, strict=True)}}
              for scale in product(*tuned)),
        ]  # fmt: skip


def _of_a_body(inertia: np.ndarray, values: Values) -> np.ndarray:
    """Moments (3,) that a body can have: about rigid directions they move nothing, and follow the others."""
    free = [bool(np.isfinite(values.get(d, inf))) for d in DIRECTIONS[3:]]
    known = inertia[free]
    if 0 < len(known) < 3:
        inertia = inertia.copy()
        inertia[np.logical_not(free)] = 0.999 * known.sum() if len(known) == 2 else known[0]
    return inertia
