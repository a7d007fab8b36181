"""A mass on a spring along one axis of a link's frame: hose pack, cover, counterbalance."""

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values

if TYPE_CHECKING:
    from twin.robot.mechanism import Mechanism


class AttachedResonator(Effect):
    """Natively: a body on a sprung slide."""

    name = "attached_resonator"
    sites = ("link{i}",)
    parameters = (
        Parameter("mass", "kg", nonnegative=True),
        Parameter("frequency_hz", "Hz", positive=True),
        Parameter("damping_ratio", "1", nonnegative=True),
        Parameter("axis", "x, y or z", word=True),
        Parameter("position", "m", length=3),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    repeatable = True

    def check(self, values: Values) -> str | None:
        return None if values["axis"] in UNIT_VECTORS else f"axis: expected x, y or z, found {values['axis']!r}"

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mass, omega = values["mass"], 2 * pi * values["frequency_hz"]
        if mass == 0:
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
