"""A spring or gas cylinder that relieves a joint: Σ B_k cos(k (q − zero)), k = 1, 2, 3, added to the drive torque.

``zero`` is the joint's angle at which the link is level; 0 as KUKA counts angles, ±π/2 where the zero is upright.
"""

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
    """Natively: three cogging elements on the motor's joint, cos x = sin(x + π/2). B₁ < 0 unloads the motor."""

    name = "gravity_compensator"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficients", "N·m", length=3), Parameter("zero", "rad", optional=True))
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
                    f"{site}.compensator{order}", motor.name,
                    cogging=(-coefficient, order, np.pi / 2 - order * values["zero"]),
                )  # fmt: skip

    def suspected(self, view: LogView) -> list[Suspected]:
        """As KUKA counts angles; and with another zero, from an eighth or a quarter of a turn to either side."""
        if view.robot.axes[view.axis].type == "prismatic":
            return []
        unit = np.eye(3).tolist()
        own = [Prior(f"coefficients[{k}]", view.size({"coefficients": unit[k], "zero": 0.0})) for k in range(3)]
        none, zeros = [0.0, 0.0, 0.0], np.pi * np.array([-0.5, -0.25, 0.25, 0.5])
        elsewhere = [*own, Prior("zero", np.pi / np.sqrt(12))]  # anywhere within a quarter of a turn
        return [
            Suspected({"coefficients": none}, own, [none], (0, 1, 2)),
            Suspected({"coefficients": none, "zero": 0.0}, elsewhere, [[*none, zero] for zero in zeros], (0, 1, 2)),
        ]

    def canonical(self, values: np.ndarray) -> np.ndarray:
        """The zero within a quarter of a turn: half a turn changes the signs of the first and the third wave."""
        if len(values) == 3:
            return values
        turns = np.round(values[3] / np.pi)
        return np.array([*(values[:3] * (-1.0) ** (turns * np.arange(1, 4))), values[3] - np.pi * turns])

    def described_deviation(self, value: float, largest: float) -> float:
        return float(np.hypot(self.doubt * value, SERIES * largest))

    def departure(self, values: Values, orders: int) -> np.ndarray:
        return np.where(np.arange(orders) < SHAPE_ORDERS, SHAPE * float(np.abs(values["coefficients"]).max()), 0.0)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        orders = np.arange(1, 4)
        angle = np.outer(motion.position[:, i] - values["zero"], orders)
        return {i: np.cos(angle) @ np.array(values["coefficients"], float)}
