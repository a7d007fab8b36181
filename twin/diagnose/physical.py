"""Fitted numbers brought back to what a body of positive mass, or a damper, can have."""

import numpy as np

from twin.measure.campaign import FloatArray
from twin.robot.description import Axis, Entry, Robot
from twin.robot.frames import inertia_matrix, inertia_six

LEAST_MOMENT = 2e-4  # of the sum of the others: the second moment put in place of a negative one
SMALLEST = 1e-3  # m, radius of gyration of the smallest body
LOCKED = 1e10  # N·m·s/rad (N·s/m): at 10 Hz a thousand times any joint's spring; no more is held by MuJoCo's numbers


def as_written(robot: Robot, given: Robot) -> Robot:
    """A fitted robot with inertias that a body can have and the limits of the description, which the fit took away."""
    robot = physical(robot)
    axes: list[Axis] = [a.model_copy(update={"limits": b.limits}) for a, b in zip(robot.axes, given.axes, strict=True)]
    return robot.model_copy(update={"axes": axes})


def physical(robot: Robot) -> Robot:
    """The robot with inertias that a body can have: second moments ∫x²dm along principal axes not below zero.

    A fit under Gaussian priors may leave that set where the data push it. The nearest inertia in second moments is
    taken. A damper that has run away holds its joint, as one of ``LOCKED`` does. A robot that is physical comes back as
    it is.
    """
    links = []
    for link in robot.links:
        six = _of_a_body(*link.inertial[::2])
        links.append(link if six is None else link.model_copy(update={"inertia": tuple(six)}))
    axes = [a if (a.damping or 0) <= LOCKED else a.model_copy(update={"damping": LOCKED}) for a in robot.axes]
    physics = [_entry(e) for e in robot.physics]
    parts = [*zip(links, robot.links, strict=True), *zip(axes, robot.axes, strict=True)]
    unchanged = all(a is b for a, b in [*parts, *zip(physics, robot.physics, strict=True)])
    return robot if unchanged else robot.model_copy(update={"links": links, "axes": axes, "physics": physics})


def _of_a_body(mass: float, inertia: FloatArray) -> list[float] | None:
    """The nearest six moments and products that a body can have; ``None`` where these are."""
    moment, basis = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    if moment[0] >= 0:
        return None
    least = LEAST_MOMENT * np.maximum(moment, 0).sum() + SMALLEST**2 * mass
    second = (basis * np.maximum(moment, least)) @ basis.T
    return inertia_six(np.trace(second) * np.eye(3) - second)


def _entry(entry: Entry) -> Entry:
    values = entry.model_extra or {}
    damping, inertia = values.get("damping", 0.0), values.get("inertia")
    if isinstance(damping, float) and damping > LOCKED:
        return entry.model_copy(update={"damping": LOCKED})
    if isinstance(inertia, list | tuple) and len(inertia) in (3, 6):
        six = _of_a_body(values.get("mass", 0.0), inertia_matrix([*inertia, 0.0, 0.0, 0.0][:6]))
        return entry if six is None else entry.model_copy(update={"inertia": six})
    return entry
