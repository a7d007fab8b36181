"""A drive that also acts on another axis, as in a coupled wrist.

The elements of drive j turn with q_j + ratio · q_i: their inertia and friction load axis j, and axis i ratio times.
"""

from typing import TYPE_CHECKING

import numpy as np

from twin.physics.effect import Effect, Parameter, Values, axis_of

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism


class JointCoupling(Effect):
    """Natively: a fixed tendon over both motors that carries ``armature``, ``damping`` and ``frictionloss``.

    ``friction`` holds F_v (N·m·s/rad) and F_c (N·m) of what turns with both axes.
    """

    name = "joint_coupling"
    sites = ("joint{i}",)
    parameters = (
        Parameter("from", "joint", word=True),
        Parameter("ratio", "1"),
        Parameter("inertia", "kg·m²", nonnegative=True, optional=True),
        Parameter("friction", "N·m·s/rad, N·m", length=2, nonnegative=True, optional=True),
    )
    seen_in = frozenset({"log"})
    order = 3
    repeatable = True

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        driven, driving = mechanism.motor(axis_of(site)), mechanism.motor(axis_of(values["from"]))
        if driven and driving:
            viscous, coulomb = values["friction"]
            mechanism.tendon(
                f"{site}.coupling",
                {driving.name: 1.0, driven.name: values["ratio"]},
                armature=values["inertia"],
                damping=viscous,
                frictionloss=coulomb,
            )

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i, j, ratio = axis_of(site), axis_of(values["from"]), values["ratio"]
        viscous, coulomb = values["friction"]
        speed = motion.velocity[:, j] + ratio * motion.velocity[:, i]
        acceleration = motion.acceleration[:, j] + ratio * motion.acceleration[:, i]
        torque = values["inertia"] * acceleration + viscous * speed + coulomb * motion.sign(speed)
        return {j: torque, i: ratio * torque}
