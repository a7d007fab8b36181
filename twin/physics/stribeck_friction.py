"""Friction that falls as a film builds up: (F_s − F_c) exp(−(q̇/v_s)²) sgn q̇."""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class StribeckFriction(Effect):
    """Natively: LuGre friction of a passive motor, which takes over the joint's Coulomb friction (0.1 % of the excess
    where there is none); its bristles are stiff enough to break away within 1e-5 rad (m).
    """

    name = "stribeck_friction"
    sites = ("joint{i}",)
    parameters = (Parameter("static_excess", "N·m"), Parameter("velocity", "rad/s", positive=True))
    seen_in = frozenset({"log"})
    at_drive = True
    order = 3
    role = "friction"
    linear_in = ("static_excess",)
    refines = "dry"
    fades_over = "velocity"
    log_tests = ("speeds",)

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        motor = mechanism.drive(axis_of(site))
        if motor is None or values["static_excess"] == 0:
            return
        coulomb = motor.frictionloss or 1e-3 * abs(values["static_excess"])
        static = coulomb + values["static_excess"]
        motor.frictionloss = 0.0
        stiffness = max(static, coulomb) / 1e-5
        mechanism.passive_motor(
            f"{site}.stribeck", motor.name, lugre=(stiffness, 0.0, coulomb, static, values["velocity"])
        )

    def suspected(self, view: LogView) -> list[Suspected]:
        middle = 0.1 * view.speed()
        own = [Prior("static_excess", view.usual()), scale("velocity", middle, 3.0)]
        starts = [[0.0, factor * middle] for factor in (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)]
        return [Suspected({"static_excess": 0.0, "velocity": middle}, own, starts, passive=True)]

    def part_of_dry(self, values: Values, velocity: np.ndarray) -> float:
        """What a parabola in speed has of the excess at rest."""
        speed = np.abs(velocity)
        fastest = float(speed.max(initial=0.0))
        speed = speed[speed > 0.01 * fastest]  # slower rows tell nothing of how friction depends on it
        if len(speed) < 4:
            return float(values["static_excess"])
        excess = np.exp(-((speed / values["velocity"]) ** 2))
        return float(values["static_excess"] * np.polynomial.polynomial.polyfit(speed / fastest, excess, 2)[0])

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        speed = motion.velocity[:, i]
        return {i: values["static_excess"] * np.exp(-((speed / values["velocity"]) ** 2)) * motion.sign(speed)}
