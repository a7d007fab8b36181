"""A rigid mass beyond the description, on a link or at the flange; com in the frame of that (the last) link."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twin.physics.effect import Companion, Effect, Parameter, Values, axis_of, link_end
from twin.physics.statements import LogView, Prior, Suspected

if TYPE_CHECKING:
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism


class Payload(Effect):
    """Natively: mass and inertia fused into the link's ``inertial``.

    ``inertia`` at its own centre of mass: (xx, yy, zz) or (xx, yy, zz, xy, xz, yz), kg·m².
    """

    name = "payload"
    sites = ("flange", "link{i}")
    parameters = (
        Parameter("mass", "kg", nonnegative=True, spread=1.2),
        Parameter("com", "m", length=3, spread=0.2),
        Parameter("inertia", "kg·m²", length=-1, optional=True),
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

    def carrier(self, robot: "Robot", site: str) -> int:
        return robot.axis_count - 1 if site == "flange" else axis_of(site)

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """The flange for the last link and the other way round; the link's own mass."""
        last = f"link{robot.axis_count}"
        same = {"flange": last, last: "flange"}
        found = [Companion(self.name, same[site])] if site in same else []
        return [*found, Companion("parameter", f"{last if site == 'flange' else site}.mass")]

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        if values["mass"] > 0:
            body = f"link{self.carrier(mechanism.robot, site) + 1}"
            mechanism.attach(body, values["mass"], np.array(values["com"]), _matrix(values["inertia"] or [0.0] * 3))

    def weight(self, values: Values) -> dict[str, Any]:
        inertia = {"inertia": values["inertia"]} if values.get("inertia") else {}
        return {"mass": values["mass"], "com": values["com"], **inertia}

    def suspected(self, view: LogView) -> list[Suspected]:
        typical = self.typical(view.robot, view.site)
        own = [Prior("mass", typical["mass"]), *(Prior(f"com[{k}]", 0.2, typical["com"][k]) for k in range(3))]
        return [Suspected({"mass": 0.0, "com": typical["com"]}, own, [[0.0, *typical["com"]]])]

    def typical(self, robot: "Robot", site: str) -> dict[str, Any]:
        """2 % of the links' mass, where the next joint (the flange) is."""
        mass = 0.02 * sum(link.inertial[0] for link in robot.links)
        return {"mass": mass, "com": link_end(robot, self.carrier(robot, site))}


def _matrix(inertia: list[float]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = [*inertia, *[0.0] * (6 - len(inertia))]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
