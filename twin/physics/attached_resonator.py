"""A mass on a spring along one axis of a link's frame: hose pack, cover, counterbalance."""

from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import UNIT_VECTORS, Companion, Effect, Parameter, Values, axis_of, link_end
from twin.physics.payload import Payload

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


BESIDE = 0.15  # m: half a prior deviation of its position


class AttachedResonator(Effect):
    """Natively: a body on a sprung slide."""

    name = "attached_resonator"
    sites = ("link{i}",)
    parameters = (
        Parameter("mass", "kg", nonnegative=True, spread=1.2),
        Parameter("frequency_hz", "Hz", positive=True, spread=0.7),
        Parameter("damping_ratio", "1", nonnegative=True, spread=1.0),
        Parameter("axis", "x, y or z", word=True),
        Parameter("position", "m", length=3, spread=0.3),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    repeatable = True
    lever = "position"
    adds_mode = True

    def check(self, values: Values) -> str | None:
        return None if values["axis"] in UNIT_VECTORS else f"axis: expected x, y or z, found {values['axis']!r}"

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mass, omega = values["mass"], 2 * pi * values["frequency_hz"]
        if mass < 1e-10:  # kg: as good as none, and a body of MuJoCo needs a mass; derivatives are taken above that
            return
        body = mechanism.part(site, np.array(values["position"], float), mass)
        mechanism.spring(
            body,
            f"{body}.{values['axis']}",
            UNIT_VECTORS[values["axis"]],
            mass * omega**2,
            2 * values["damping_ratio"] * mass * omega,
            "slide",
        )

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """The same mass about other axes and on the next links, where it couples as well; a payload, which it is below
        its own frequency."""
        number, found = axis_of(site) + 1, []
        for other in range(max(1, number - 1), min(robot.axis_count, number + 1) + 1):
            link = f"link{other}"
            usual = values if link == site else self.typical(robot, link) or {}
            for axis in UNIT_VECTORS if usual else ():
                if (link, axis) != (site, values["axis"]):
                    there = {**usual, "frequency_hz": values["frequency_hz"], "axis": axis}
                    found.append(Companion(self.name, link, there))
        return [*found, Companion(Payload.name, site)]

    def merged(self, robot: "Robot", site: str, values: Values, other: str, place: str) -> list[Companion]:
        """A mass that hangs at a link and one that swings may be one: it hangs there and swings along any axis.

        So may two that swing: the one at a wrong place, the other at a wrong frequency.
        """
        if other == self.name:
            return [Companion(self.name, site, {**values, "axis": axis}) for axis in UNIT_VECTORS]
        if other != Payload.name:
            return []
        link = f"link{Payload().carrier(robot, place) + 1}"
        usual = {**(self.typical(robot, link) or {}), "frequency_hz": values["frequency_hz"]}
        return [Companion(self.name, link, {**usual, "axis": axis}) for axis in UNIT_VECTORS]

    def weight(self, values: Values) -> dict[str, Any]:
        """A mass at rest on its spring."""
        return {"mass": values["mass"], "com": values["position"]}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """1 % of the links' mass, 1.5 % damped, half-way along the link."""
        mass = 0.01 * sum(link.inertial[0] for link in robot.links)
        middle = [0.5 * value for value in link_end(robot, axis_of(site))]
        return {"mass": mass, "frequency_hz": 15.0, "damping_ratio": 0.015, "axis": "z", "position": middle}

    def variants(self, robot: "Robot", site: str, band_hz: tuple[float, float]) -> list[dict[str, Any]]:
        """Every axis; start, middle and end of the link, beside its middle; frequencies 3 % apart, as wide as a peak.

        What hangs beside a link takes part in how it turns, one corner of it in phase, the next in opposition.
        """
        typical = self.typical(robot, site) or {}
        end, along = np.array(link_end(robot, axis_of(site))), BESIDE * np.eye(3)
        steps = int(np.ceil(np.log(band_hz[1] / band_hz[0]) / 0.03))
        frequencies = np.geomspace(*band_hz, steps + 1)
        found = []
        for k, axis in enumerate(UNIT_VECTORS):
            corners = [a * along[k - 2] + b * along[k - 1] for a in (-1, 1) for b in (-1, 1)]  # across the axis
            for place in (0.0 * end, 0.5 * end, end, *(0.5 * end + corner for corner in corners)):
                values = {**typical, "axis": axis, "position": place.tolist()}
                found += [{**values, "frequency_hz": float(f)} for f in frequencies]
        return found
