"""A rigid mass beyond the description, on a link or at the flange. Its com is in the frame of that link. At `flange`
that is the last link's frame, and not the flange's.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Companion, Effect, Parameter, Values, axis_of, link_end
from twin.physics.statements import LogView, Prior, Suspected
from twin.robot.frames import inertia_six, nearest_body

if TYPE_CHECKING:
    from twin.physics.doubt import Weight
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


DENSITY = 3000.0  # kg/m³ of a spindle or a gripper: aluminium, or steel that is two thirds empty


class Payload(Effect):
    """Natively: mass and inertia fused into the link's ``inertial``.

    ``inertia`` at its own centre of mass: (xx, yy, zz) or (xx, yy, zz, xy, xz, yz), kg·m².
    """

    name = "payload"
    sites = ("flange", "link{i}")
    parameters = (
        Parameter("mass", "kg", nonnegative=True, spread=1.2),
        Parameter("com", "m", length=3, spread=0.2),
        Parameter("inertia", "kg·m²", length=-1, optional=True, scale=True, spread=1.5),
    )
    seen_in = frozenset({"hammer", "log"})
    order = 1
    repeatable = True
    lever = "com"
    part = "mass"
    steps = False
    log_tests = ("mass", "sweep")

    def check(self, values: Values) -> str | None:
        inertia = values["inertia"]
        if not inertia:
            return None
        if len(inertia) not in (3, 6):
            return f"inertia: expected 3 or 6 numbers, found {len(inertia)}"
        principal = np.linalg.eigvalsh(_matrix(inertia))
        if principal[0] < 0 or principal[0] + principal[1] < principal[2] * (1 - 1e-9):
            return "inertia: no body of positive mass can have it (triangle inequality)"
        return None

    def doubts(self, robot: "Robot", site: str, values: Values, weight: "Weight") -> list[tuple[str, str]]:
        if values["mass"] <= weight.mass:
            return []
        return [("mass", f"{values['mass']:g} kg, and the robot's links weigh {weight.mass:.4g}")]

    def carrier(self, robot: "Robot", site: str) -> int:
        return robot.axis_count - 1 if site == "flange" else axis_of(site)

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """The link's own mass. A payload on the last link is one at the flange, under whose name it is sought."""
        return [Companion("parameter", f"link{self.carrier(robot, site) + 1}.mass")]

    def behind(self, robot: "Robot", number: str) -> list[Companion]:
        """A point on a link whose mass or centre seems off, a body with an inertia of its own where that does."""
        link, _, what = number.partition(".")
        if link not in {f"link{i + 1}" for i in range(robot.axis_count)} or what not in ("mass", "com", "inertia"):
            return []
        site = "flange" if link == f"link{robot.axis_count}" else link
        point = self.typical(robot, site)
        cube, _ = self._cube(robot, site, point["mass"])
        return [Companion(self.name, site, {**point, "inertia": [cube] * 3} if what == "inertia" else point)]

    def merged(self, robot: "Robot", site: str, values: Values, other: str, place: str) -> list[Companion]:
        """Beside a link whose own inertia is off: a body with an inertia of its own, on a link as described."""
        off = (f"link{self.carrier(robot, site) + 1}.inertia", "link*.inertia")
        return self.fuller(robot, site, values) if other == "parameter" and place in off else []

    def fuller(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """A body with an inertia of its own, at first that of a cube, where there was a point."""
        if values.get("inertia"):
            return []
        cube, _ = self._cube(robot, site, values["mass"])
        return [Companion(self.name, site, {**values, "inertia": [cube] * 3})]

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if values["mass"] > 0:
            body = f"link{self.carrier(mechanism.robot, site) + 1}"
            mechanism.attach(
                body, values["mass"], np.array(values["com"]), nearest_body(_matrix(values["inertia"] or [0.0] * 3))
            )

    def weight(self, values: Values) -> dict[str, Any]:
        inertia = {"inertia": values["inertia"]} if values.get("inertia") else {}
        return {"mass": values["mass"], "com": values["com"], **inertia}

    def suspected(self, view: LogView) -> list[Suspected]:
        typical = self.typical(view.robot, view.site)
        place = next(p for p in self.parameters if p.name == "com")
        width = [self.deviation(view.robot, view.site, place, k) for k in range(3)]
        own = [Prior("mass", typical["mass"]), *(Prior(f"com[{k}]", width[k], typical["com"][k]) for k in range(3))]
        values, start = {"mass": 0.0, "com": typical["com"]}, [0.0, *typical["com"]]
        cube, shows = self._cube(view.robot, view.site, typical["mass"])
        if not shows:
            return [Suspected(values, own, [start])]
        spread = next(p for p in self.parameters if p.name == "inertia").spread
        own += [Prior(f"inertia[{k}]", float(np.exp(spread)) * cube) for k in range(3)]
        return [Suspected({**values, "inertia": [0.0] * 3}, own, [[*start, 0.0, 0.0, 0.0]], (0, 4, 5, 6))]

    def nearest(self, robot: "Robot", site: str, values: dict[str, Any]) -> dict[str, Any]:
        """The nearest body that can exist."""
        if not (inertia := values.get("inertia")):
            return values
        return {**values, "inertia": inertia_six(nearest_body(_matrix(inertia)))[: len(inertia)]}

    def variants(self, robot: "Robot", site: str, band_hz: tuple[float, float]) -> list[dict[str, Any]]:
        """A point; of a link whose own inertia is known better than a body's, also a cube of that mass.

        None for the last link, for which the flange stands.
        """
        if site == f"link{robot.axis_count}":
            return []
        point = self.typical(robot, site)
        cube, shows = self._cube(robot, site, point["mass"])
        return [point, {**point, "inertia": [cube] * 3}] if shows else [point]

    def _cube(self, robot: "Robot", site: str, mass: float) -> tuple[float, bool]:
        """Inertia of a cube of a mass, kg·m², and whether the link's own is known better than that."""
        own = 0.5 * np.trace(robot.links[self.carrier(robot, site)].inertial[2])  # no moment is larger
        cube = mass * (mass / DENSITY) ** (2 / 3) / 6
        return cube, bool(cube > robot.tolerances.inertia * own)

    def given_size(self, robot: "Robot", site: str, size: float) -> dict[str, float]:
        """Moments of inertia of a cube of that mass."""
        cube, _ = self._cube(robot, site, size)
        return {f"inertia[{k}]": cube for k in range(3)}

    def typical(self, robot: "Robot", site: str) -> dict[str, Any]:
        """2 % of the links' mass, at the flange or in the middle of the link."""
        mass, end = 0.02 * sum(link.inertial[0] for link in robot.links), link_end(robot, self.carrier(robot, site))
        return {"mass": mass, "com": end if site == "flange" else [0.5 * value for value in end]}

    def deviation(self, robot: "Robot", site: str, parameter: Parameter, item: int) -> float:
        """Of a place on a link: anywhere from joint to joint alike (a twelfth of the square), and as far beside it."""
        if parameter.name != "com" or site == "flange":
            return parameter.spread
        return float(np.hypot(parameter.spread, link_end(robot, self.carrier(robot, site))[item] / np.sqrt(12)))


def _matrix(inertia: list[float]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = [*inertia, *[0.0] * (6 - len(inertia))]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
