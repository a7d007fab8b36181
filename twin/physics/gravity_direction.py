"""A foot that leans: the robot stands tilted about x and y of its base, so that its weight pulls another way."""

import numpy as np

from twin.physics.effect import Effect, Parameter, Values


class GravityDirection(Effect):
    """Turns gravity in the frame of the base, by a tilt of the foot about its x and then its y (extrinsic)."""

    name = "gravity_direction"
    sites = ("base",)
    parameters = (Parameter("angles", "rad", length=2, spread=0.02),)
    seen_in = frozenset({"log"})
    ordinary = "every fit to a log leaves the direction of gravity free, and a leaning foot is answered by this name"

    def gravity(self, gravity: np.ndarray, site: str, values: Values) -> np.ndarray:
        (sa, sb), (ca, cb) = np.sin(values["angles"]), np.cos(values["angles"])
        foot = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
        foot = foot @ np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
        return np.asarray(foot.T @ gravity)
