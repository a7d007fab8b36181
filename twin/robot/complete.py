"""A rigid chain completed to a robot that can be fitted: limits, drives, friction, springs, from a sheet or from laws.

Each number that neither the file nor the sheet states comes from ``twin.robot.scaling`` and is listed as *assumed*.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError, tell
from twin.model.regressor import flange_path, inertial_vector, link_regressor
from twin.physics import effect_of
from twin.physics.motion import Motion
from twin.robot.bodies import Inertial, fuse
from twin.robot.datasheet import Sheet
from twin.robot.description import Assumed, Axis, Placement, Robot, parse_robot
from twin.robot.frames import axis_placement, inertia_matrix, inertia_six
from twin.robot.reduce import Reduced
from twin.robot.scaling import Estimate, estimate
from twin.robot.tree import ball_inertia

SHORTEST_M = 0.01  # reach below which no law of scale holds
POSTURES = 2000  # at random, in which the largest static torque and the reach are looked for
TURN = np.pi  # rad: range either way of an axis whose limits nobody states
TRAVEL_M = 1.0  # the same of a linear axis
SLIDES = Estimate(1.5, 2.0, "tracks of robots reach 1 to 2 m/s by their data sheets")  # m/s
LINK_SHARE = 0.5  # mass of a link over the one before it, where the file gives none
HEAVIER = 10.0  # times: drawings hold masses of solid bodies, or of shells
UNEQUAL = 0.01  # share by which two statements of one mass may differ
UNLIKE = 3.0  # times: sheet and drawing of one robot are nearer to each other
UNLOADED = 0.01  # of the largest static torque: below, gravity says nothing of a drive
LARGEST_STRAIN_WAVE = 400.0
"""N·m of rated torque above which a gear is taken for a cycloidal one; strain-wave gears of robots end there."""


class Filler:
    """The content of a ``robot.yaml`` being completed: ``data``, the sheet, and what had to be ``assumed``.

    ``source``: the sheet's file, for messages. ``carried``: how many axes, tracks and turntables, carry the robot.
    """

    def __init__(self, data: dict[str, Any], reduced: Reduced, sheet: Sheet, source: str | Path) -> None:
        self.data, self.sheet, self.source, self.carried = data, sheet, source, len(sheet.mount)
        self.assumed = list(reduced.assumed)
        self.massless = reduced.massless
        self.joints = [joint for joint, _ in reduced.chain.axes]
        self.turning = [joint.kind != "prismatic" for joint in self.joints]
        data["drives"] = [{} for _ in self.joints]
        data["priors"] = []
        for number in self.massless:  # until the masses are known
            link = data["links"][number - 1]
            link["mass"], link["inertia"] = 1.0, inertia_six(ball_inertia(1.0))
            link["com"] = [value / 2 for value in self._end(number)]

    def _end(self, number: int) -> Sequence[float]:
        """Where a link ends, in its frame: the next axis, or the flange."""
        if number == len(self.joints):
            return self.data["flange"]["position"]
        axis = {key: value for key, value in self.data["axes"][number].items() if key != "limits"}
        return axis_placement(Axis.model_validate(axis), 0.0)[0].tolist()

    def say(self, field: str, value: float, unit: str, found: Estimate, settled_by: str) -> float:
        """List a number as assumed; returns it rounded, as it will be written."""
        rounded = float(f"{value:.4g}")
        self.assumed.append(
            Assumed(
                field=field, value=rounded, unit=unit, tolerance=round(found.within, 2),
                source=f"assumed: {found.source}", settled_by=settled_by,
            )
        )  # fmt: skip
        return rounded

    def note(self, field: str, value: float | list[float], unit: str, source: str, settled_by: str) -> None:
        """List a number as assumed of which nobody can say how far off it may be."""
        told = Assumed(field=field, value=value, unit=unit, source=f"assumed: {source}", settled_by=settled_by)
        self.assumed.append(told)

    def as_written(self) -> None:
        """Masses and inertias that were assumed, as they are after the sheet's masses have scaled them."""
        for k, item in enumerate(self.assumed):
            if not (found := re.fullmatch(r"links\[(\d+)\]\.(mass|com|inertia)", item.field)):
                continue
            link, name = self.data["links"][int(found[1])], found[2]
            if name != "mass":  # what turning it into the frame leaves of zero
                least = 1e-12 * max(map(abs, link[name]))
                link[name] = [value if abs(value) > least else 0.0 for value in link[name]]
            self.assumed[k] = item.model_copy(update={"value": link[name]})

    def given(self, name: str) -> Sequence[float | None]:
        """A list of the sheet, one value per axis, ``None`` where it has none."""
        return getattr(self.sheet, name) or [None] * len(self.joints)

    def robot(self) -> Robot:
        """What is complete so far."""
        return parse_robot(self.data, f"{self.data['name']} as the sheet and scaling laws complete it")


def complete(data: dict[str, Any], reduced: Reduced, sheet: Sheet, source: str | Path = "sheet") -> Robot:
    """The robot that data of a chain and a sheet describe, the rest from scaling laws; ``data`` is completed, too.

    Order matters: masses before static torques, those before drives, those before springs. Reach and payload are of the
    robot alone, without a track that it stands on or a tool that it carries.

    Args:
        source: the sheet's file, for messages.

    Raises:
        InputError: a sheet that does not go with the drawing.
    """
    filler = Filler(data, reduced, sheet, source)
    _tolerances(filler)
    _limits(filler)
    reach, payload = _size(filler)
    _masses(filler, payload, reach)
    filler.as_written()
    _speeds(filler, reach)
    peak = _torques(filler, payload)
    ratio = _drives(filler, peak)
    _friction(filler, peak, ratio)
    _springs(filler, peak)
    for name, turns in (reduced.coupling | sheet.coupling).items():
        number = next((i for i, joint in enumerate(filler.joints) if name in (joint.name, f"joint{i + 1}")), None)
        if number is not None:
            names = {joint.name: f"joint{i + 1}" for i, joint in enumerate(filler.joints)}
            data["drives"][number]["coupling"] = {names.get(other, other): r for other, r in turns.items()}
    data["assumed"] = [item.model_dump() for item in filler.assumed]
    return filler.robot()


def _tolerances(filler: Filler) -> None:
    """List how far off the file's centres of mass and the recorded torque may be, where no description says so."""
    stated = filler.data["tolerances"]
    for name, unit, source, settled_by in (
        ("com", "m", "as the KR90's description: 1 cm of a robot 4 m long, at least a millimetre", "torque log"),
        ("torque_gain", "", "torque constants of motor data sheets, ±10 %", "data sheet"),
    ):
        filler.note(f"tolerances.{name}", stated[name], unit, source, settled_by)


def _limits(filler: Filler) -> None:
    for i, (axis, turning) in enumerate(zip(filler.data["axes"], filler.turning, strict=True)):
        if axis["limits"]["position"] is None:
            end, unit = (TURN, "rad") if turning else (TRAVEL_M, "m")
            axis["limits"]["position"] = (-end, end)
            filler.say(
                f"axes[{i}].limits.position", end, unit, Estimate(end, 2.0, "no limit in the file"), "data sheet"
            )


def _size(filler: Filler) -> tuple[float, float]:
    """Reach (m) and payload (kg)."""
    sheet, robot = filler.sheet, filler.robot()
    reach, payload = sheet.reach, sheet.payload
    first = filler.carried
    q, last = _postures(robot), robot.links[-1].com
    q[:, :first] = q[:1, :first]  # the robot stands somewhere on its track
    body = robot.model_copy(update={"flange": robot.flange.model_copy(update={"position": last})})
    foot = robot.model_copy(update={"axes": robot.axes[: first + 1], "flange": Placement()})
    middle = flange_path(foot, q[:, : first + 1])[:, :2]  # of the robot's own first axis
    ends = (flange_path(one, q)[:, :2] - middle for one in (robot, body))  # a chain may end in a joint's origin
    drawn = max(float(np.linalg.norm(tip, axis=1).max()) for tip in ends)
    if reach is not None and drawn > SHORTEST_M and not 1 / UNLIKE < reach / drawn < UNLIKE:
        tell(filler.source, "reach", f"{reach:g} m, and the drawing reaches {drawn:.3g} m: is it in another unit?")
    if reach is None:
        reach = drawn
        if reach < SHORTEST_M:
            raise InputError(
                filler.data["name"], "reach", "the flange stays above the foot in every posture: expected a reach in "
                "the sheet (`reach:`, m), from which masses and drives are scaled",
            )  # fmt: skip
    if payload is None:
        found = estimate("robot_payload", reach)
        payload = filler.say("payload", found.value, "kg", found, "data sheet")
    return reach, payload


def _masses(filler: Filler, payload: float, reach: float) -> None:
    """Masses of links without any: the robot's total split; the sheet's masses scale what the file gives."""
    links, base, sheet = filler.data["links"], filler.data["base"], filler.sheet
    known = [i for i in range(len(links)) if i + 1 not in filler.massless]
    weighed = sum(links[i]["mass"] for i in known)
    total_said = sum(sheet.link_masses) if sheet.link_masses else sheet.mass
    if sheet.mass and sheet.mass <= base["mass"]:
        expected = f"expected kg of the whole robot, more than its base's {base['mass']:.4g}, found {sheet.mass:g}"
        raise InputError(filler.source, "mass", expected)
    added = base["mass"] + sum(sheet.link_masses or ())
    if sheet.mass and sheet.link_masses and abs(sheet.mass - added) > UNEQUAL * sheet.mass:
        text = f"{sheet.mass:g} kg is not used: link_masses and the base make {added:.4g} kg"
        tell(filler.source, "mass", text)
    if len(known) == len(links) and total_said and not 1 / HEAVIER < total_said / (weighed + base["mass"]) < HEAVIER:
        text = f"{total_said:g} kg, and the drawing holds {weighed + base['mass']:.4g} kg: is it in another unit?"
        tell(filler.source, "link_masses" if sheet.link_masses else "mass", text)
    if (carried := sheet.payload) and total_said is None and carried > weighed > 0 and len(known) == len(links):
        tell(filler.source, "payload", f"{carried:g} kg, and the robot's links weigh {weighed:.4g} kg")
    if sheet.link_masses is not None:
        for link, mass in zip(links, sheet.link_masses, strict=True):
            _scale(link, mass)
        return
    total = sheet.mass
    if total is None and not known:
        found = estimate("robot_mass", payload, reach)
        total = filler.say("total mass", found.value, "kg", found, "data sheet")
    share = LINK_SHARE ** np.arange(len(links))
    if known:
        per_share = sum(links[i]["mass"] for i in known) / sum(share[i] for i in known)
    else:
        per_share = (total - base["mass"]) / (sum(share) + 1.0)  # the foot as heavy as the first link
    for number in filler.massless:
        text = f"the file gives none; links weigh {LINK_SHARE:g} of the one before, by those that have a mass"
        why = Estimate(0.0, 2.0, text if known else text.partition(", by")[0])
        mass = filler.say(f"links[{number - 1}].mass", per_share * share[number - 1], "kg", why, "torque log")
        _scale(links[number - 1], mass)
        for name, unit, source in (("com", "m", "half-way to the next joint"), ("inertia", "kg·m²", "a steel ball's")):
            filler.note(f"links[{number - 1}].{name}", links[number - 1][name], unit, source, "torque log")
    if sheet.mass is not None and known:
        held = sum(link["mass"] for link in links)
        factor = (sheet.mass - base["mass"]) / held
        if len(known) == len(links) and abs(factor - 1) > UNEQUAL:
            base_too = f", its base's {base['mass']:.4g} among them" if base["mass"] else ""
            text = f"links of {held:.4g} kg are made {factor:.3g} times as heavy: the sheet says {sheet.mass:g} kg"
            tell(filler.source, "mass", text + base_too)
        for link in links:
            _scale(link, factor * link["mass"])


def _scale(link: dict[str, Any], mass: float) -> None:
    """Give a link another mass; its inertia goes along."""
    link["inertia"] = [mass / link["mass"] * value for value in link["inertia"]]
    link["mass"] = mass


def _speeds(filler: Filler, reach: float) -> None:
    ramp, usual = estimate("ramp_time"), estimate("joint_speed", reach)
    own = [np.deg2rad(s) for s, turning in zip(filler.given("max_speed"), filler.turning, strict=True) if s and turning]
    if own and np.median(own) < usual.value * np.sqrt(np.deg2rad(1.0)):  # nearer to the usual speed in rad/s
        text = f"{np.rad2deg(np.median(own)):.3g} °/s, and such robots turn at {np.rad2deg(usual.value):.0f} °/s"
        tell(filler.source, "max_speed", f"{text}: is it in rad/s?")
    speeds, accelerations = filler.given("max_speed"), filler.given("max_acceleration")
    for i, (axis, turning) in enumerate(zip(filler.data["axes"], filler.turning, strict=True)):
        limits, unit = axis["limits"], np.deg2rad(1.0) if turning else 1.0
        if (speed := speeds[i]) is not None:
            limits["velocity"] = float(speed * unit)
        elif limits["velocity"] is None or not 0 < limits["velocity"] < np.inf:
            found, per_s = (usual, "rad/s") if turning else (SLIDES, "m/s")
            limits["velocity"] = filler.say(f"axes[{i}].limits.velocity", found.value, per_s, found, "data sheet")
        if (acceleration := accelerations[i]) is not None:
            limits["acceleration"] = float(acceleration * unit)
        else:
            field = f"axes[{i}].limits.acceleration"
            value = limits["velocity"] / ramp.value
            limits["acceleration"] = filler.say(field, value, "rad/s²" if turning else "m/s²", ramp, "data sheet")


def _torques(filler: Filler, payload: float) -> np.ndarray:
    """Largest drive torque of every axis, N·m (N)."""
    given = filler.given("max_torque")
    robot = filler.robot()
    static = static_torque(robot, payload, filler.sheet.payload_com)
    turning = np.flatnonzero(filler.turning)
    own = np.maximum.accumulate(static[turning][::-1])[::-1]  # what gravity does not load is as strong as the next
    for k in range(1, len(own)):
        if own[k] < UNLOADED * own.max():
            own[k] = own[k - 1]  # the last of a wrist as strong as the one before
    static[turning] = own
    for i in np.flatnonzero(~np.array(filler.turning)).tolist():  # N: holds what it moves, or accelerates it
        moved = payload + sum(link.inertial[0] for link in robot.links[i:])
        static[i] = max(static[i], moved * filler.data["axes"][i]["limits"]["acceleration"])
    margin, peak = estimate("torque_margin"), np.zeros(len(static))
    for i, joint in enumerate(filler.joints):
        stated = given[i] or joint.effort
        if stated is None:
            field = f"axes[{i}].limits.torque"
            stated = filler.say(
                field, margin.value * static[i], "N·m" if filler.turning[i] else "N", margin, "data sheet"
            )
        elif given[i] and not static[i] / 2 <= stated <= 1e3 * max(static[i], UNLOADED * static.max()):
            text = f"{stated:g}, and {static[i]:.3g} holds the robot and its payload: is it in another unit?"
            tell(filler.source, f"max_torque[{i}]", text)
        peak[i] = filler.data["axes"][i]["limits"]["torque"] = stated
    return peak


def with_tools(data: dict[str, Any], tools: Sequence[Inertial], flange: dict[str, Any]) -> None:
    """Add tools to completed ``data``: bodies in the frame of the last link, and where the flange then is."""
    link = data["links"][-1]
    body = link["mass"], np.array(link["com"]), inertia_matrix(link["inertia"])
    for tool in tools:
        body = fuse(body, tool)
    link["mass"], link["com"], link["inertia"] = float(body[0]), [float(x) for x in body[1]], inertia_six(body[2])
    data["flange"] = flange


def static_torque(robot: Robot, payload: float = 0.0, com: Sequence[float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Largest torque (n,) N·m (N) that holds a robot with a payload, over postures drawn within its limits.

    ``com``: of the payload, in the flange's frame.
    """
    q = _postures(robot)
    still = Motion(np.zeros(len(q)), q, np.zeros_like(q), np.zeros_like(q))
    bodies = [link.inertial for link in robot.links]
    if payload > 0:
        place = np.array(robot.flange.position) + np.array(com)
        bodies[-1] = fuse(bodies[-1], (payload, place, ball_inertia(payload)))
    torque = link_regressor(robot, still) @ np.concatenate([inertial_vector(*body) for body in bodies])
    return np.abs(torque).max(axis=0)


def _postures(robot: Robot) -> np.ndarray:
    limits = [axis.limits.position if axis.limits else None for axis in robot.axes]
    low, high = np.array([limit or (-TURN, TURN) for limit in limits]).T
    return np.random.default_rng(0).uniform(low, high, (POSTURES, len(low)))


def _drives(filler: Filler, peak: np.ndarray) -> np.ndarray:
    """Gear ratios; rotor inertias beside them."""
    ratios, inertias, speed = filler.given("gear_ratio"), filler.given("rotor_inertia"), estimate("motor_speed")
    found = np.ones(len(peak))
    for i, (joint, drive, turning) in enumerate(zip(filler.joints, filler.data["drives"], filler.turning, strict=True)):
        if (ratio := ratios[i]) is None:
            if not turning:
                continue  # a linear drive's pinion or spindle is not to be guessed
            value = speed.value / filler.data["axes"][i]["limits"]["velocity"]
            ratio = filler.say(f"drives[{i}].gear_ratio", value, "", speed, "data sheet")
        found[i] = drive["gear_ratio"] = ratio
        if (inertia := inertias[i]) is None:
            if joint.inertia > 0:
                inertia = joint.inertia / ratio**2  # the file states it at the joint
            else:
                law = estimate("rotor_inertia", peak[i] / abs(ratio))
                inertia = filler.say(f"drives[{i}].rotor_inertia", law.value, "kg·m²", law, "torque log")
        drive["rotor_inertia"] = inertia
    return np.abs(found)


def _friction(filler: Filler, peak: np.ndarray, ratio: np.ndarray) -> None:
    """Friction of the motors at the gears' outputs, where the file gives none. No values of linear axes were found."""
    laws = (("viscous", "motor_viscous", ratio**2), ("dry", "motor_coulomb", ratio))
    for i, (joint, turning) in enumerate(zip(filler.joints, filler.turning, strict=True)):
        if joint.damping > 0 or joint.friction > 0:
            continue
        if not turning:
            tell(filler.source, f"joint{i + 1}", "a linear axis without friction: state it, or record a motion log")
            continue
        for part, law, factor in laws:
            effect = effect_of("viscous" if part == "viscous" else "dry")
            name, unit = effect.parameters[0].name, effect.parameters[0].unit
            found = estimate(law, peak[i] / ratio[i])
            field = f"{effect.name}@joint{i + 1}.{name}"
            value = filler.say(field, factor[i] * found.value, unit, found, "torque log")
            filler.data["physics"].append({"effect": effect.name, "site": f"joint{i + 1}", name: value})


def _springs(filler: Filler, peak: np.ndarray) -> None:
    """Gear and bearing springs and dampers of the turning axes, with priors as wide as the laws scatter."""
    overload, lag = estimate("overload"), estimate("damping_time")
    tilt = effect_of("tilt")
    stiffness, gears = filler.given("stiffness"), filler.sheet.gears
    for i, turning in enumerate(filler.turning):
        if not turning:
            continue
        rated = peak[i] / overload.value
        stated = gears if isinstance(gears, str) else gears[i] if gears else None
        kind = stated or ("cycloidal" if rated > LARGEST_STRAIN_WAVE else "strain_wave")
        axis, site = filler.data["axes"][i], f"joint{i + 1}"
        gear = estimate(f"{kind}_torsion", rated)
        if (value := stiffness[i]) is None:
            value = filler.say(f"axes[{i}].stiffness", gear.value, "N·m/rad", gear, "hammer test")
            _prior(filler, f"{site}.z.stiffness", gear)
        axis["stiffness"] = value
        axis["damping"] = filler.say(f"axes[{i}].damping", lag.value * value, "N·m·s/rad", lag, "hammer test")
        bearing = estimate(f"{kind}_tilt", rated).times(estimate("tilt_share"))
        for letter in "xy":
            field = f"{tilt.name}@{site}.{letter}"
            k = filler.say(f"{field}.stiffness", bearing.value, "N·m/rad", bearing, "hammer test")
            d = filler.say(f"{field}.damping", lag.value * k, "N·m·s/rad", lag, "hammer test")
            entry = {"effect": tilt.name, "site": f"{site}.{letter}", "stiffness": k, "damping": d}
            filler.data["physics"].append(entry)
            _prior(filler, f"{site}.{letter}.stiffness", bearing)
        if place := axis.get("bearing"):
            filler.note(f"axes[{i}].bearing", place, "m", "at the joint's origin in the file", "drawing")
        _prior(filler, f"{site}.*.damping", lag)


def _prior(filler: Filler, parameter: str, found: Estimate) -> None:
    filler.data["priors"].append(
        {"parameter": parameter, "factor": round(found.within, 2), "source": f"assumed: {found.source}"}
    )
