"""A hose pack that pulls back: k (q − q₀)."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LinearPart, LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class CableStiffness(Effect):
    """Natively: a spring on the motor's joint."""

    name = "cable_stiffness"
    sites = ("joint{i}",)
    parameters = (Parameter("stiffness", "N·m/rad", nonnegative=True), Parameter("rest", "rad"))
    seen_in = frozenset({"log"})
    steps = False
    linear_in = ("stiffness",)
    leaning = True
    log_tests = ("sweep",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            motor.stiffness[0] += values["stiffness"]
            motor.springref = values["rest"]

    def suspected(self, view: LogView) -> list[Suspected]:
        middle, half = view.middle()
        own = [Prior("stiffness", view.size({"stiffness": 1.0, "rest": middle})), Prior("rest", half + 0.5, middle)]
        starts = [[0.0, middle], [0.0, middle + half], [0.0, middle - half]]
        return [Suspected({"stiffness": 0.0, "rest": middle}, own, starts)]

    def linear_parts(self, values: Values) -> list[LinearPart]:
        """Stiffness, and −k q₀.

        That has the law of a spring of no stiffness that pulls for ever: a limit taken exactly in binary numbers.
        """
        stiffness, rest = values["stiffness"], values["rest"]
        return [
            LinearPart("stiffness", "N·m/rad", stiffness, {"stiffness": 1.0, "rest": 0.0}),
            LinearPart("stiffness·rest", "N·m", stiffness * rest, {"stiffness": 2.0**-60, "rest": 2.0**60}),
        ]

    def with_linear(self, values: Values, found: list[float]) -> dict[str, Any]:
        stiffness, pull = found
        return {"stiffness": stiffness, "rest": pull / stiffness if stiffness else 0.0}

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["stiffness"] * (motion.position[:, i] - values["rest"])}
