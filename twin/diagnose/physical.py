"""Fitted link inertias brought back to what a body of positive mass can have."""

import numpy as np

from twin.robot.description import Robot
from twin.robot.frames import inertia_six

LEAST_MOMENT = 2e-4  # of the sum of the others: the second moment put in place of a negative one
SMALLEST = 1e-3  # m, radius of gyration of the smallest body


def physical(robot: Robot) -> Robot:
    """The robot with inertias that a body can have: second moments ∫x²dm along principal axes not below zero.

    A fit under Gaussian priors may leave that set where the data push it. The nearest inertia in second moments is
    taken; a robot that is physical comes back as it is.
    """
    links = []
    for link in robot.links:
        mass, _, inertia = link.inertial
        moment, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
        if moment[0] >= 0:
            links.append(link)
            continue
        least = LEAST_MOMENT * np.maximum(moment, 0).sum() + SMALLEST**2 * mass
        second = (axes * np.maximum(moment, least)) @ axes.T
        six = inertia_six(np.trace(second) * np.eye(3) - second)
        links.append(link.model_copy(update={"inertia": tuple(six)}))
    unchanged = all(a is b for a, b in zip(links, robot.links, strict=True))
    return robot if unchanged else robot.model_copy(update={"links": links})
