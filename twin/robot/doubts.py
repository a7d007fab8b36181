"""What a careful reader of a description would ask about: numbers that are possible one by one, and hardly together.

They are told and not refused: a fit or a diagnosis may write such numbers, and a pendulum on a bench is a robot too.
"""

import numpy as np

from twin.measure.units import STANDARD_GRAVITY
from twin.physics import CATALOGUE
from twin.physics.doubt import Weight, of_spring
from twin.ranges import NODE_APART_M
from twin.robot.description import Axis, Drive, Robot

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
    weight = Weight(mass, STANDARD_GRAVITY * mass * reach / 2)
    for i, (axis, drive) in enumerate(zip(robot.axes, robot.drives, strict=True)):
        if axis.type == "revolute":
            found += [(f"axes[{i}].{name}", text) for name, text in _of_joint(axis, weight.torque)]
        if axis.stiffness is None and axis.damping:
            found.append((f"axes[{i}].damping", "is not used: an axis without a stiffness is rigid"))
        if axis.type == "revolute":
            found += [(f"drives[{i}].{name}", text) for name, text in _of_drive(drive, mass * reach**2)]
    found += _of_points(robot, reach)
    for k, entry in enumerate(robot.physics):
        asked = CATALOGUE[entry.effect].doubts(robot, entry.site, entry.values, weight)
        found += [(f"physics[{k}].{name}", text) for name, text in asked]
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


def _of_joint(axis: Axis, held: float) -> list[tuple[str, str]]:
    """Of an axis that turns; ``held``: N·m, the robot's weight at arm's length."""
    found = [] if axis.stiffness is None else of_spring(axis.stiffness, axis.damping, held)
    limits = axis.limits
    if limits is None:
        return found
    if limits.position and max(map(abs, limits.position)) > LARGEST_TURN:
        low, high = limits.position
        found.append(("limits.position", f"{low:g} … {high:g} rad are more than four turns: degrees?"))
    if limits.velocity and not SLOWEST <= limits.velocity <= FASTEST:
        found.append(("limits.velocity", f"{limits.velocity:g} rad/s: is it in another unit?"))
    if limits.acceleration and not SLUGGISH <= limits.acceleration <= BRISKEST:
        found.append(("limits.acceleration", f"{limits.acceleration:g} rad/s²: is it in another unit?"))
    if limits.torque and held and not WEAKEST * held <= limits.torque <= STRONGEST * held:
        slip = "is it in N·mm?" if limits.torque > held else "is it in kN·m, or a mass in g?"
        text = f"{limits.torque:g} N·m, and its weight at arm's length makes {held:.3g}: {slip}"
        found.append(("limits.torque", text))
    return found


def _of_drive(drive: Drive, largest: float) -> list[tuple[str, str]]:
    """Of a drive that turns an axis; ``largest``: kg·m², of all links at the robot's reach."""
    found = []
    if not GEARS[0] <= abs(drive.gear_ratio) <= GEARS[1]:
        found.append(("gear_ratio", f"{drive.gear_ratio:g} motor turns per joint turn"))
    if (felt := drive.rotor_inertia * drive.gear_ratio**2) > REFLECTED * largest:
        found.append(("rotor_inertia", f"{felt:.3g} kg·m² at the joint, and all links make {largest:.3g} at most"))
    return found


def _of_points(robot: Robot, reach: float) -> list[tuple[str, str]]:
    found = []
    for k, point in enumerate(robot.test_points):
        first = next(p for p in robot.test_points if p.label[:-2] == point.label[:-2])
        apart = float(np.linalg.norm(np.subtract(point.position, first.position)))
        if first.body != point.body or apart > NODE_APART_M:
            found.append((f"test_points[{k}].position", f"is not that of {first.label}, which is the same node"))
        if (far := float(np.linalg.norm(point.position))) > FARTHER * reach + 1:
            text = f"{far:.3g} m from its body's frame; the robot reaches {reach:.3g} m"
            found.append((f"test_points[{k}].position", text))
    return found
