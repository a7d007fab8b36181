"""A torque that repeats with the joint angle: A sin(order·q + phase), order per joint turn."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LinearPart, LogView, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism

HIGHEST = 80.0  # order looked for


class TorqueRipple(Effect):
    """Natively: a cogging element on the motor's joint."""

    name = "torque_ripple"
    sites = ("joint{i}",)
    parameters = (Parameter("amplitude", "N·m"), Parameter("order", "1"), Parameter("phase", "rad"))
    seen_in = frozenset({"log"})
    at_drive = True
    steps = False
    waves = True
    linear_in = ("amplitude",)
    log_tests = ("sweep",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if motor := mechanism.drive(axis_of(site)):
            amplitude, order, phase = values["amplitude"], values["order"], values["phase"]
            mechanism.passive_motor(f"{site}.ripple", motor.name, cogging=(-amplitude, order, phase))

    def suspected(self, view: LogView) -> list[Suspected]:
        """Orders as far apart as the joint's range tells them, from half a wave over that range to where the low-pass
        takes the wave. Less than half a wave over all that the joint moves need not turn back."""
        if view.robot.axes[view.axis].type == "prismatic":
            return []
        _, half = view.middle()
        lowest = max(1.0, np.pi / 2 / max(half, 1e-3))
        if lowest >= HIGHEST:
            return []
        highest = 2 * np.pi * view.highest_hz / view.speed()
        orders = np.arange(max(2.0, lowest), min(highest, HIGHEST), min(0.7 / max(half, 1e-3), 4.0))
        middle, factor = np.sqrt(lowest * HIGHEST), (HIGHEST / lowest) ** (1 / 6)  # three deviations to either end
        own = [Prior("amplitude", view.usual()), scale("order", middle, factor), Prior("phase", np.pi / np.sqrt(3))]
        starts = [[0.0, order, phase] for order in orders for phase in (0.0, np.pi / 2)]
        return [Suspected({"amplitude": 0.0, "order": middle, "phase": 0.0}, own, starts)]

    def canonical(self, values: np.ndarray) -> np.ndarray:
        """The amplitude above zero and the phase within half a turn of zero."""
        amplitude, order, phase = values
        phase = (phase + (np.pi if amplitude < 0 else 0.0) + np.pi) % (2 * np.pi) - np.pi
        return np.array([abs(amplitude), order, phase])

    def linear_parts(self, values: Values) -> list[LinearPart]:
        """Cosine and sine of the phase."""
        amplitude, phase = values["amplitude"], values["phase"]
        return [
            LinearPart(
                "amplitude·cos", "N·m", float(amplitude * np.cos(phase)), {**values, "amplitude": 1.0, "phase": 0.0}
            ),
            LinearPart(
                "amplitude·sin", "N·m", float(amplitude * np.sin(phase)),
                {**values, "amplitude": 1.0, "phase": np.pi / 2},
            ),
        ]  # fmt: skip

    def with_linear(self, values: Values, found: list[float]) -> dict[str, Any]:
        cosine, sine = found
        return {"amplitude": float(np.hypot(cosine, sine)), "phase": float(np.arctan2(sine, cosine))}

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        angle = values["order"] * motion.position[:, i] + values["phase"]
        return {i: values["amplitude"] * np.sin(angle)}
