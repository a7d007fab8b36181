"""Fitted numbers brought back to what a body of positive mass, a spring or a damper can have."""

from typing import Any

import numpy as np

from twin.robot.description import Axis, Entry, Robot
from twin.robot.frames import inertia_matrix, inertia_six, nearest_body

LEAST_MOMENT = 2e-4  # of the sum of the others: the second moment put in place of a negative one
SMALLEST = 1e-3  # m, radius of gyration that is added then: no body is a point
LOCKED = 1e10  # N·m·s/rad (N·s/m): at 10 Hz a thousand times any joint's spring; no more is held by MuJoCo's numbers
RIGID = 1e13  # N·m/rad (N/m): a thousand times the stiffest foundation; no more is held by MuJoCo's numbers
HARDEST = {"stiffness": RIGID, "damping": LOCKED}


def as_written(robot: Robot, given: Robot) -> Robot:
    """A fitted robot with inertias that a body can have and the limits of the description, which the fit took away."""
    robot = physical(robot)
    axes: list[Axis] = [a.model_copy(update={"limits": b.limits}) for a, b in zip(robot.axes, given.axes, strict=True)]
    return robot.model_copy(update={"axes": axes, "physics": [_of_bodies(e) for e in robot.physics]})


def physical(robot: Robot) -> Robot:
    """The robot with inertias that a body can have: second moments ∫x²dm along principal axes not below zero.

    A fit under Gaussian priors may leave that set where the data push it. The nearest inertia in second moments is
    taken. A spring or damper that has run away holds its joint, as one of ``RIGID`` or ``LOCKED`` does. A robot that is
    physical comes back as it is.
    """
    links = []
    for link in robot.links:
        mass, _, inertia = link.inertial
        body = nearest_body(inertia, LEAST_MOMENT)
        if body is not inertia:
            body += SMALLEST**2 * mass * np.eye(3)
            link = link.model_copy(update={"inertia": tuple(inertia_six(body))})
        links.append(link)
    axes = [a.model_copy(update=most) if (most := _run_away(vars(a))) else a for a in robot.axes]
    physics = [e.model_copy(update=most) if (most := _run_away(e.model_extra or {})) else e for e in robot.physics]
    parts = [*zip(links, robot.links, strict=True), *zip(axes, robot.axes, strict=True)]
    unchanged = all(a is b for a, b in [*parts, *zip(physics, robot.physics, strict=True)])
    return robot if unchanged else robot.model_copy(update={"links": links, "axes": axes, "physics": physics})


def _of_bodies(entry: Entry) -> Entry:
    """An entry with an inertia that a body can have: a fit takes the nearest, whatever numbers it goes through."""
    inertia = (entry.model_extra or {}).get("inertia")
    if not isinstance(inertia, list | tuple) or len(inertia) not in (3, 6):
        return entry
    given = inertia_matrix([*inertia, 0.0, 0.0, 0.0][:6])
    body = nearest_body(given, LEAST_MOMENT)
    moments = [float(value) for value in inertia_six(body)[: len(inertia)]]  # without products stays without
    return entry if body is given else entry.model_copy(update={"inertia": moments})


def _run_away(numbers: dict[str, Any]) -> dict[str, float]:
    """The springs and dampers among some numbers that hold more than MuJoCo can, each with the most."""
    return {name: most for name, most in HARDEST.items() if isinstance(x := numbers.get(name), float) and x > most}
