"""What a careful reader of a description would ask about: numbers that are possible one by one, and hardly together.

They are told and not refused: a fit or a diagnosis may write such numbers, and a pendulum on a bench is a robot too.
"""

import numpy as np

from twin.measure.units import STANDARD_GRAVITY
from twin.ranges import NODE_APART_M
from twin.robot.description import Robot

LEAST_SAG, MOST_SAG = 1e-8, 1.0  # rad, of a gear under the robot's weight at arm's length
SLOWEST_S = 0.3  # damping over stiffness: a damper that stops a spring within its first swing has less
FRICTION = 30.0  # times the robot's weight at arm's length, as torques of a log
DENSEST = 22_600.0  # kg/m³: osmium
SMALLER = 30.0  # times: how much less inertia than a ball of that is certainly a slip
FARTHER = 2.0  # times the reach, at which a link ends for certain
LARGEST_TURN = 8 * np.pi  # rad: four turns
FASTEST, SLOWEST = 100.0, 0.02  # rad/s of a joint: a degree a second
BRISKEST, SLUGGISH = 1e4, 0.02  # rad/s²: a degree a second, after one
STRONGEST, WEAKEST = 1e3, 1e-4  # times the weight at arm's length: a limit of torque; a wrist carries little of it
GEARS = (0.1, 5000.0)  # motor turns per joint turn
REFLECTED = 100.0  # times the inertia of all links at the robot's reach
HEAVY_FOOT = 100.0  # times the mass of all links: a foot on a slab of concrete
NO_LENGTH_M = 1e-9
WIDEST_PRIOR = 100.0  # a factor that says nothing any more


def doubts(robot: Robot) -> list[tuple[str, str]]:
    """Field and question, in the order of the description."""
    if any(link.inertia is None for link in robot.links):
        return []
    mass = sum(link.inertial[0] for link in robot.links)
    reach = sum(float(np.hypot(axis.a, axis.d)) for axis in robot.axes) + float(np.linalg.norm(robot.flange.position))
    reach += max(float(np.linalg.norm(link.inertial[1])) for link in robot.links)
    found = []
    if not 9.7 < float(np.linalg.norm(robot.gravity)) < 9.9 and any(robot.gravity):
        found.append(("gravity", f"{np.linalg.norm(robot.gravity):.4g} m/s² is not that of the earth"))
    for i, link in enumerate(robot.links):
        found += [(f"links[{i}].{name}", text) for name, text in _of_link(link.inertial, reach)]
    if robot.base.mass > HEAVY_FOOT * mass:
        found.append(("base.mass", f"{robot.base.mass:g} kg, and the robot's links weigh {mass:.4g} kg"))
    for i, (axis, before) in enumerate(zip(robot.axes[1:], robot.axes, strict=False), start=1):
        along = abs(axis.a) < NO_LENGTH_M and abs(np.sin(np.deg2rad(axis.alpha_deg))) < NO_LENGTH_M
        if along and axis.type == before.type == "revolute":
            found.append((f"axes[{i}]", f"turns about the same line as joint{i}: are alpha_deg and a missing?"))
    held = STANDARD_GRAVITY * mass * reach / 2
    for i, (axis, drive) in enumerate(zip(robot.axes, robot.drives, strict=True)):
        where, turns = f"axes[{i}]", axis.type == "revolute"
        if turns and axis.stiffness is not None:
            found += [(f"{where}.{name}", text) for name, text in _of_spring(axis.stiffness, axis.damping, held)]
        if axis.stiffness is None and axis.damping:
            found.append((f"{where}.damping", "is not used: an axis without a stiffness is rigid"))
        limits = axis.limits
        if turns and limits and limits.position and max(map(abs, limits.position)) > LARGEST_TURN:
            low, high = limits.position
            found.append((f"{where}.limits.position", f"{low:g} … {high:g} rad are more than four turns: degrees?"))
        if turns and limits and limits.velocity and not SLOWEST <= limits.velocity <= FASTEST:
            found.append((f"{where}.limits.velocity", f"{limits.velocity:g} rad/s: is it in another unit?"))
        if turns and limits and limits.acceleration and not SLUGGISH <= limits.acceleration <= BRISKEST:
            text = f"{limits.acceleration:g} rad/s²: is it in another unit?"
            found.append((f"{where}.limits.acceleration", text))
        if turns and limits and limits.torque and held and not WEAKEST * held <= limits.torque <= STRONGEST * held:
            slip = "is it in N·mm?" if limits.torque > held else "is it in kN·m, or a mass in g?"
            text = f"{limits.torque:g} N·m, and its weight at arm's length makes {held:.3g}: {slip}"
            found.append((f"{where}.limits.torque", text))
        if turns and not GEARS[0] <= abs(drive.gear_ratio) <= GEARS[1]:
            found.append((f"drives[{i}].gear_ratio", f"{drive.gear_ratio:g} motor turns per joint turn"))
        if turns and (felt := drive.rotor_inertia * drive.gear_ratio**2) > REFLECTED * mass * reach**2:
            text = f"{felt:.3g} kg·m² at the joint, and all links make {mass * reach**2:.3g} at most"
            found.append((f"drives[{i}].rotor_inertia", text))
    for k, point in enumerate(robot.test_points):
        first = next(p for p in robot.test_points if p.label[:-2] == point.label[:-2])
        apart = float(np.linalg.norm(np.subtract(point.position, first.position)))
        if first.body != point.body or apart > NODE_APART_M:
            found.append((f"test_points[{k}].position", f"is not that of {first.label}, which is the same node"))
        if (far := float(np.linalg.norm(point.position))) > FARTHER * reach + 1:
            text = f"{far:.3g} m from its body's frame; the robot reaches {reach:.3g} m"
            found.append((f"test_points[{k}].position", text))
    for k, entry in enumerate(robot.physics):
        where, values = f"physics[{k}]", entry.values
        turning = (
            entry.site.startswith("joint") and robot.axes[int(entry.site[5:].split(".")[0]) - 1].type == "revolute"
        )
        if turning and entry.effect == "transverse_compliance":
            spring = _of_spring(values["stiffness"], values["damping"], held)
            found += [(f"{where}.{name}", text) for name, text in spring]
        if turning and entry.effect == "coulomb_friction" and held and values["torque"] > FRICTION * held:
            text = f"{values['torque']:g} N·m, and its weight at arm's length makes {held:.3g}: is it in N·mm?"
            found.append((f"{where}.torque", text))
        if entry.effect == "payload" and values["mass"] > mass:
            found.append((f"{where}.mass", f"{values['mass']:g} kg, and the robot's links weigh {mass:.4g}"))
    for k, prior in enumerate(robot.priors):
        if prior.factor > WIDEST_PRIOR:
            found.append((f"priors[{k}].factor", f"×/÷ {prior.factor:g} says hardly anything"))
    return found


def _of_link(inertial: tuple[float, np.ndarray, np.ndarray], reach: float) -> list[tuple[str, str]]:
    mass, com, inertia = inertial
    largest = float(np.linalg.eigvalsh(inertia)[-1])
    ball = 0.4 * mass * (3 * mass / (4 * np.pi * DENSEST)) ** (2 / 3)
    found = []
    if largest < ball / SMALLER:
        found.append(("inertia", f"at most {largest:.3g} kg·m², and {mass:g} kg of the densest metal have {ball:.3g}"))
    if reach and (radius := float(np.sqrt(largest / mass))) > FARTHER * reach:
        found.append(("inertia", f"{mass:g} kg at {radius:.3g} m, and the robot reaches {reach:.3g} m"))
    if (far := float(np.linalg.norm(com))) > FARTHER * (reach - far) + 1:
        found.append(("com", f"{far:.3g} m from the link's frame"))
    return found


def _of_spring(stiffness: float, damping: float, held: float) -> list[tuple[str, str]]:
    found = []
    if held and np.isfinite(stiffness) and not LEAST_SAG <= (sag := held / stiffness) <= MOST_SAG:
        text = f"{stiffness:g} N·m/rad, and its weight at arm's length ({held:.3g} N·m) bends it by {sag:.2g} rad"
        found.append(("stiffness", text))
    if damping > SLOWEST_S * stiffness:
        found.append(
            ("damping", f"{damping:g} N·m·s/rad on {stiffness:g} N·m/rad: the joint creeps instead of ringing")
        )
    return found
