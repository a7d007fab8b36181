"""A spring or gas cylinder that relieves a joint: Σ B_k cos(k q), k = 1, 2, 3, added to the recorded drive torque."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import DESCRIBED, LogView, Prior, Suspected

SERIES = 0.003  # of the largest coefficient: what a compensator's series is off by
SHAPE, SHAPE_ORDERS = 1e-3, 6  # of the largest coefficient, in every order up to: no compensator is a series of three

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class GravityCompensator(Effect):
    """Natively: three cogging elements on the motor's joint, cos(k q) = sin(k q + π/2). B₁ < 0 unloads the motor."""

    name = "gravity_compensator"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficients", "N·m", length=3),)
    seen_in = frozenset({"log"})
    role = "load"
    steps = False
    linear_in = ("coefficients",)
    leaning = doubted = True
    doubt = DESCRIBED
    log_tests = ("sweep",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.motor(axis_of(site)):
            for order, coefficient in enumerate(values["coefficients"], start=1):
                mechanism.passive_motor(
                    f"{site}.compensator{order}", motor.name, cogging=(-coefficient, order, np.pi / 2)
                )

    def suspected(self, view: LogView) -> list[Suspected]:
        if view.robot.axes[view.axis].type == "prismatic":
            return []
        unit = np.eye(3).tolist()
        own = [Prior(f"coefficients[{k}]", view.size({"coefficients": unit[k]})) for k in range(3)]
        return [Suspected({"coefficients": [0.0, 0.0, 0.0]}, own, [[0.0, 0.0, 0.0]], (0, 1, 2))]

    def described_deviation(self, value: float, largest: float) -> float:
        return float(np.hypot(self.doubt * value, SERIES * largest))

    def departure(self, values: Values, orders: int) -> np.ndarray:
        return np.where(np.arange(orders) < SHAPE_ORDERS, SHAPE * float(np.abs(values["coefficients"]).max()), 0.0)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        orders = np.arange(1, 4)
        return {i: np.cos(np.outer(motion.position[:, i], orders)) @ np.array(values["coefficients"], float)}
