"""A drive that also acts on another axis, as in a coupled wrist.

Rotor j turns with q_j + ratio · q_i instead of q_j alone: its inertia and friction load axis j, and axis i ratio times.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import InputError
from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Part, Prior, Suspected, scale

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


RATIOS = (0.003, 0.12, 0.25, 0.5, 1.0)  # from which a search starts: it finds its way from within a factor of 1.5


class JointCoupling(Effect):
    """Natively: a fixed tendon over both motors takes over the inertia and friction of motor j's joint.

    ``inertia`` and ``friction`` (F_v in N·m·s/rad, F_c in N·m) say how much of the drive turns with both; left out,
    all that the description gives drive j.
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
    linear = False
    profiled = "ratio"
    log_tests = ("acceleration",)

    def complete(self, robot: "Robot", site: str, given: Values) -> Values:
        j = axis_of(given["from"])
        sums = {"rotor_inertia": 0.0, "viscous_friction": 0.0, "coulomb_friction": 0.0}
        names = {"rotor_inertia": "inertia", "viscous_friction": "coefficient", "coulomb_friction": "torque"}
        for entry in robot.physics:
            if entry.effect in sums and entry.site == given["from"]:
                sums[entry.effect] += entry.values[names[entry.effect]]
        drive = robot.drives[j]
        inertia = drive.gear_ratio**2 * drive.rotor_inertia + sums["rotor_inertia"]
        return {"inertia": inertia, "friction": [sums["viscous_friction"], sums["coulomb_friction"]]} | dict(given)

    def nearest(self, robot: "Robot", site: str, values: dict[str, Any]) -> dict[str, Any]:
        """No more of the drive turns with both axes than there is of it."""
        whole = self.complete(robot, site, {"from": values["from"]})
        given = {**whole, **values}
        friction = [min(part, all_) for part, all_ in zip(given["friction"], whole["friction"], strict=True)]
        # a rotor without inertia of its own cannot be stepped
        return {**values, "inertia": min(given["inertia"], 0.99 * whole["inertia"]), "friction": friction}

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        driven, driving = mechanism.motor(axis_of(site)), mechanism.motor(axis_of(values["from"]))
        if driven and driving:
            viscous, coulomb = values["friction"]
            rotor = mechanism.drive(axis_of(values["from"])) or driving
            own = (rotor.armature, rotor.damping[0], rotor.frictionloss)
            if any(
                part > whole * (1 + 1e-9)
                for part, whole in zip((values["inertia"], viscous, coulomb), own, strict=True)
            ):
                message = f"{values['from']} has less inertia or friction than turns with {site} too"
                raise InputError(mechanism.robot.name, f"joint_coupling@{site}", message)
            rotor.armature = max(0.0, own[0] - values["inertia"])
            rotor.damping[0], rotor.frictionloss = max(0.0, own[1] - viscous), max(0.0, own[2] - coulomb)
            number = 1 + sum(tendon.name.startswith(f"{site}.coupling") for tendon in mechanism.tendons)
            mechanism.tendon(
                f"{site}.coupling{number}",
                {driving.name: 1.0, driven.name: values["ratio"]},
                armature=values["inertia"],
                damping=[viscous, 0.0, 0.0],
                frictionloss=coulomb,
            )

    def suspected(self, view: LogView) -> list[Suspected]:
        """From every other drive; dry friction turns round elsewhere already at a small ratio, and elsewhere again at
        one of the other sign, or of another size."""
        robot, found = view.robot, []
        for j, axis in enumerate(robot.axes):
            if j == view.axis or axis.type == "prismatic" or robot.axes[view.axis].type == "prismatic":
                continue
            drive = f"joint{j + 1}"
            described = self.complete(robot, view.site, {"from": drive})
            usual = view.usual(j)
            inertia = described["inertia"] or usual / max(view.acceleration(j), 1e-9)
            # a fit that lacks the coupling may have next to no friction at the drive: no less than the usual
            friction = np.maximum(described["friction"], [usual / view.speed(j), usual]).tolist()
            own = [
                Prior("ratio", 0.5), scale("inertia", inertia, 1.5 if described["inertia"] else 6.0),
                scale("friction[0]", friction[0], 2.0), scale("friction[1]", friction[1], 2.0),
            ]  # fmt: skip
            starts = [[sign * ratio, inertia, *friction] for ratio in RATIOS for sign in (-1, 1)]
            found.append(
                Suspected({"from": drive, "ratio": 0.0, "inertia": inertia, "friction": friction}, own, starts)
            )
        return found

    def carried(
        self, motion: "Motion", site: str, values: Values, given: Values, drive: str, part: Part, amount: float
    ) -> dict[int, np.ndarray]:
        """Where the entry leaves it to the rest of the description how much turns with both axes."""
        name = "inertia" if part == "inertia" else "friction"
        if part not in ("inertia", "viscous", "dry") or values["from"] != drive or given.get(name) is not None:
            return {}
        friction = [amount * (part == "viscous"), amount * (part == "dry")]
        return self.torque(motion, site, {**values, "inertia": amount * (part == "inertia"), "friction": friction})

    def spins(self, site: str, values: Values) -> tuple[int, int, float]:
        return axis_of(values["from"]), axis_of(site), values["ratio"]

    def shared_dry(self, values: Values) -> tuple[str, float]:
        return values["from"], values["friction"][1]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        i, j, ratio = axis_of(site), axis_of(values["from"]), values["ratio"]
        viscous, coulomb = values["friction"]

        def elements(speed: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
            return values["inertia"] * acceleration + viscous * speed + coulomb * motion.sign(speed)

        speed, acceleration = motion.velocity, motion.acceleration
        both = elements(speed[:, j] + ratio * speed[:, i], acceleration[:, j] + ratio * acceleration[:, i])
        return {i: ratio * both, j: both - elements(speed[:, j], acceleration[:, j])}
