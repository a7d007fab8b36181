"""Robots besides the KR90, and the description of any: other sizes, masses and axes, and points to strike and to sense.

Nothing of the other robots is real but their proportions. A description is what a workshop would have: the chain's
numbers, before a truth is drawn near them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from tools.truth.chain import Array, Chain, Link, Tolerances, flange_position, kr90, symmetric
from tools.truth.recording import HAMMER, SENSORS, Channel, Posture, draw_postures


@dataclass(frozen=True)
class Machine:
    """A robot as described, and how it is tested.

    `size`, `torque`: of lengths and torques, over the KR90's. `start_hz`, `spacing_hz`, `lines` of its FRFs;
    `peak_n` of its blows, N, as a hammer for its mass gives them. `tolerances`: what the description says of itself.
    """

    name: str
    chain: Chain
    sensors: tuple[Channel, ...] = SENSORS
    hammer: tuple[Channel, ...] = HAMMER
    size: float = 1.0
    torque: float = 1.0
    start_hz: float = 5.0
    spacing_hz: float = 0.25
    lines: int = 90
    peak_n: float = 300.0
    tolerances: Tolerances = field(default_factory=Tolerances)

    @property
    def node(self) -> str:
        """Node number of the sensor."""
        return self.sensors[0].node

    def postures(self, count: int, rng: np.random.Generator) -> tuple[Posture, ...]:
        """Postures in the joint ranges, the flange in the workspace, the arm not stretched."""
        if self.name == "kr90":
            return draw_postures(count, rng)
        low, high = np.rad2deg(self.chain.range_.T)
        low[0], high[0] = max(low[0], -90.0), min(high[0], 90.0)
        found: list[Posture] = []
        while len(found) < count:
            q = np.round(rng.uniform(low + 5, high - 5))
            tip = flange_position(self.chain, np.deg2rad(q))
            inside = np.all((tip > self.chain.workspace[:, 0]) & (tip < self.chain.workspace[:, 1]))
            if inside and np.all(np.abs(q[1:]) > 10):
                found.append(Posture(f"posture{len(found) + 1}", tuple(float(x) for x in q)))
        return tuple(found)


def machines() -> dict[str, Machine]:
    """The KR90, an arm half its size with its axes the other way round, a column whose second axis is vertical, too.

    Then whole arms: one of six axes with a spherical wrist, one of seven as collaborative robots are, and a light one
    of six whose second to fourth axes are parallel.
    """
    arm, column, six, seven, light = _arm(), _column(), _six(), _seven(), _light()
    return {
        "kr90": Machine("kr90", kr90()),
        "arm": Machine(
            "arm", arm, *_points(arm, 0.5), 0.5, 0.06, start_hz=8.0, spacing_hz=0.5, lines=80,
            tolerances=Tolerances(com=0.005, poor_damping=0.0),
        ),
        "column": Machine(
            "column", column, *_points(column, 0.8), 0.8, 0.3, start_hz=5.0,
            tolerances=Tolerances(com=0.008, poor_damping=0.0),
        ),
        "six": Machine(
            "six", six, *_points(six, 0.6), 0.6, 0.1, start_hz=6.0, spacing_hz=0.5, peak_n=100.0,
            tolerances=Tolerances(com=0.005, poor_damping=0.0),
        ),
        "seven": Machine(
            "seven", seven, *_points(seven, 0.3), 0.3, 0.02, start_hz=5.0, spacing_hz=0.5, peak_n=30.0,
            tolerances=Tolerances(com=0.004, poor_damping=0.0),
        ),
        "light": Machine(
            "light", light, *_points(light, 0.3), 0.3, 0.02, start_hz=5.0, spacing_hz=0.5, peak_n=30.0,
            tolerances=Tolerances(com=0.005, poor_damping=0.0),
        ),
    }  # fmt: skip


def _arm() -> Chain:
    """An arm for 10 kg; joint 2 turns about +y at q₁ = 0, so that it is raised at negative angles."""
    return Chain(
        dh=np.array([[0.0, 0.0, 0.40], [0.16, -pi / 2, 0.0], [0.58, 0.0, 0.05]]),
        links=(
            Link(62.0, np.array([0.05, 0.01, -0.12]), symmetric(1.6, 1.7, 1.3, 0.05, 0.1, -0.02)),
            Link(27.0, np.array([0.27, 0.0, -0.08]), symmetric(0.35, 1.35, 1.30, 0.02, 0.05, -0.01)),
            Link(24.0, np.array([0.19, 0.01, 0.015]), symmetric(0.20, 0.85, 0.85, 0.0, 0.02, 0.0)),
        ),
        flange=np.array([0.66, 0.03, -0.02]),
        gear_ratio=np.array([120.0, 130.0, 101.0]),
        rotor_inertia=np.array([3e-4, 3e-4, 1.5e-4]),
        stiffness=np.array([[2.2e5, 4.5e5, 6.0e5], [2.4e5, 5.0e5, 3.6e5], [6.0e4, 1.5e5, 2.2e5]]),
        damping=np.array([[76.0, 120.0, 140.0], [80.0, 130.0, 110.0], [15.0, 40.0, 50.0]]),
        viscous=np.array([40.0, 45.0, 20.0]),
        coulomb=np.array([18.0, 22.0, 12.0]),
        compensator=np.zeros((3, 3)),
        range_=np.array([[-2.9, 2.9], [-2.5, -0.1], [-1.9, 2.2]]),
        speed=np.array([2.6, 2.4, 2.8]),
        acceleration=np.array([12.0, 12.0, 14.0]),
        workspace=np.array([[-1.3, 1.4], [-1.3, 1.3], [0.05, 1.7]]),
    )


def _column() -> Chain:
    """Two parallel vertical axes and an arm that lifts about the third."""
    return Chain(
        dh=np.array([[0.0, 0.0, 0.95], [0.60, 0.0, 0.25], [0.70, pi / 2, 0.12]]),
        links=(
            Link(390.0, np.array([0.22, 0.0, -0.10]), symmetric(14.0, 28.0, 30.0, 0.5, 1.0, 0.3)),
            Link(160.0, np.array([0.33, 0.02, 0.05]), symmetric(4.0, 12.0, 13.0, 0.2, -0.4, 0.1)),
            Link(85.0, np.array([0.35, -0.01, 0.02]), symmetric(2.0, 7.0, 7.0, 0.1, 0.1, -0.05)),
        ),
        flange=np.array([0.85, 0.0, 0.04]),
        gear_ratio=np.array([180.0, 160.0, 120.0]),
        rotor_inertia=np.full(3, 2.5e-3),
        stiffness=np.array([[1.6e6, 3.6e6, 5.0e6], [9.0e5, 2.0e6, 2.6e6], [3.0e5, 8.0e5, 1.1e6]]),
        damping=np.array([[800.0, 1200.0, 1500.0], [340.0, 600.0, 700.0], [80.0, 220.0, 260.0]]),
        viscous=np.array([300.0, 160.0, 80.0]),
        coulomb=np.array([110.0, 60.0, 35.0]),
        compensator=np.zeros((3, 3)),
        range_=np.array([[-2.8, 2.8], [-2.3, 2.3], [-1.1, 1.2]]),
        speed=np.array([1.9, 2.2, 2.4]),
        acceleration=np.array([8.0, 9.0, 10.0]),
        workspace=np.array([[-2.3, 2.4], [-2.3, 2.3], [0.3, 2.4]]),
    )


def _six() -> Chain:
    """An arm for 20 kg with 1.8 m reach: three axes as usual, and a spherical wrist."""
    return Chain(
        dh=np.array([
            [0.0, 0.0, 0.50], [0.15, -pi / 2, 0.0], [0.79, 0.0, 0.0], [0.15, -pi / 2, 0.84], [0.0, pi / 2, 0.0],
            [0.0, -pi / 2, 0.0],
        ]),
        links=(
            Link(95.0, np.array([0.06, 0.02, -0.10]), symmetric(3.0, 3.4, 2.6, 0.1, 0.2, -0.05)),
            Link(42.0, np.array([0.36, 0.01, -0.12]), symmetric(0.5, 3.1, 3.0, 0.03, 0.1, -0.02)),
            Link(36.0, np.array([0.08, 0.04, 0.02]), symmetric(0.8, 0.7, 0.9, 0.02, -0.03, 0.01)),
            Link(16.0, np.array([0.0, 0.01, -0.38]), symmetric(0.75, 0.74, 0.08, 0.0, 0.01, 0.01)),
            Link(6.5, np.array([0.0, 0.03, 0.01]), symmetric(0.03, 0.02, 0.03, 0.0, 0.0, 0.001)),
            Link(1.8, np.array([0.01, 0.0, 0.09]), symmetric(0.004, 0.004, 0.003, 0.0, 0.0, 0.0)),
        ),
        flange=np.array([0.0, 0.0, 0.12]),
        gear_ratio=np.array([145.0, 160.0, 148.0, 101.0, -88.0, 76.0]),
        rotor_inertia=np.array([1.1e-3, 1.1e-3, 6e-4, 1.2e-4, 1.0e-4, 8e-5]),
        stiffness=np.array([
            [4.6e5, 1.1e6, 1.4e6], [5.2e5, 1.2e6, 0.9e6], [2.4e5, 5.4e5, 7.0e5], [6.0e4, 1.6e5, 1.9e5],
            [4.5e4, 1.3e5, 1.1e5], [2.2e4, 8.0e4, 9.0e4],
        ]),
        damping=np.array([
            [130.0, 220.0, 300.0], [150.0, 260.0, 210.0], [60.0, 120.0, 160.0], [12.0, 28.0, 34.0],
            [8.0, 22.0, 18.0], [3.0, 10.0, 11.0],
        ]),
        viscous=np.array([95.0, 110.0, 55.0, 14.0, 10.0, 5.0]),
        coulomb=np.array([45.0, 52.0, 30.0, 9.0, 7.0, 4.0]),
        compensator=np.zeros((6, 3)),
        range_=np.array([[-2.9, 2.9], [-2.4, 0.3], [-1.9, 2.2], [-3.1, 3.1], [-2.1, 2.1], [-3.1, 3.1]]),
        speed=np.array([2.9, 2.6, 2.9, 5.2, 5.2, 7.0]),
        acceleration=np.array([11.0, 10.0, 12.0, 24.0, 24.0, 32.0]),
        workspace=np.array([[-1.7, 1.8], [-1.7, 1.7], [-0.4, 2.2]]),
    )  # fmt: skip


def _seven() -> Chain:
    """A collaborative arm for 10 kg: seven axes, each across the one before."""
    n = 7
    return Chain(
        dh=np.array([
            [0.0, 0.0, 0.34], [0.0, -pi / 2, 0.0], [0.0, pi / 2, 0.40], [0.0, pi / 2, 0.0], [0.0, -pi / 2, 0.40],
            [0.0, -pi / 2, 0.0], [0.0, pi / 2, 0.0],
        ]),
        links=tuple(
            Link(mass, np.array(com), symmetric(*inertia))
            for mass, com, inertia in (
                (6.2, (0.0, -0.03, -0.06), (0.05, 0.045, 0.02, 0.0, 0.0, 0.004)),
                (5.6, (0.0, -0.07, 0.03), (0.06, 0.02, 0.055, 0.0, 0.0, 0.006)),
                (4.3, (0.0, 0.03, -0.13), (0.05, 0.048, 0.015, 0.0, 0.0, -0.005)),
                (4.0, (0.0, 0.07, 0.03), (0.04, 0.013, 0.038, 0.0, 0.0, 0.004)),
                (3.1, (0.0, 0.02, -0.12), (0.03, 0.028, 0.009, 0.0, 0.0, -0.003)),
                (2.6, (0.0, 0.01, 0.01), (0.009, 0.008, 0.008, 0.0, 0.0, 0.0)),
                (0.9, (0.005, 0.0, 0.08), (0.002, 0.002, 0.0012, 0.0, 0.0, 0.0)),
            )
        ),
        flange=np.array([0.0, 0.0, 0.126]),
        gear_ratio=np.array([160.0, 160.0, 160.0, 160.0, 100.0, 100.0, 100.0]),
        rotor_inertia=np.array([5e-5, 5e-5, 4e-5, 4e-5, 2e-5, 1.5e-5, 1.5e-5]),
        stiffness=np.array([2.8e4, 2.8e4, 1.9e4, 1.9e4, 1.2e4, 7e3, 7e3])[:, None] * [1.0, 3.6, 4.1],
        damping=np.array([9.0, 9.0, 5.0, 5.0, 2.5, 1.2, 1.2])[:, None] * [1.0, 2.2, 2.6],
        viscous=np.array([12.0, 12.0, 8.0, 8.0, 4.0, 2.5, 2.5]),
        coulomb=np.array([7.0, 7.5, 5.0, 5.0, 3.0, 2.0, 2.0]),
        compensator=np.zeros((n, 3)),
        range_=np.array([2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 3.0])[:, None] * [-1.0, 1.0],
        speed=np.array([1.7, 1.7, 1.7, 2.3, 2.4, 3.1, 3.1]),
        acceleration=np.array([7.0, 7.0, 7.0, 9.0, 10.0, 13.0, 13.0]),
        workspace=np.array([[-0.9, 0.9], [-0.9, 0.9], [0.0, 1.3]]),
    )  # fmt: skip


def _light() -> Chain:
    """An arm for 5 kg with 0.9 m reach: no spherical wrist, axes 2 to 4 parallel."""
    n = 6
    return Chain(
        dh=np.array([
            [0.0, 0.0, 0.16], [0.0, -pi / 2, 0.0], [0.42, 0.0, 0.0], [0.39, 0.0, 0.13], [0.0, -pi / 2, 0.10],
            [0.0, pi / 2, 0.10],
        ]),
        links=tuple(
            Link(mass, np.array(com), symmetric(*inertia))
            for mass, com, inertia in (
                (3.8, (0.0, -0.03, -0.01), (0.013, 0.011, 0.012, 0.0, 0.0, 0.001)),
                (8.4, (0.21, 0.0, 0.12), (0.022, 0.16, 0.155, 0.0, 0.01, 0.0)),
                (2.4, (0.19, 0.0, 0.02), (0.005, 0.048, 0.047, 0.0, 0.001, 0.0)),
                (1.3, (0.0, -0.01, 0.0), (0.0022, 0.0020, 0.0021, 0.0, 0.0, 0.0)),
                (1.3, (0.0, 0.01, 0.0), (0.0022, 0.0020, 0.0021, 0.0, 0.0, 0.0)),
                (0.4, (0.0, 0.0, 0.03), (0.0003, 0.0003, 0.0002, 0.0, 0.0, 0.0)),
            )
        ),
        flange=np.array([0.0, 0.0, 0.08]),
        gear_ratio=np.full(n, 101.0),
        rotor_inertia=np.array([5e-5, 5e-5, 3e-5, 1e-5, 1e-5, 1e-5]),
        stiffness=np.array([2.6e4, 2.6e4, 1.8e4, 6e3, 6e3, 5e3])[:, None] * [1.0, 3.4, 4.0],
        damping=np.array([9.0, 9.0, 5.0, 1.2, 1.2, 1.0])[:, None] * [1.0, 2.2, 2.6],
        viscous=np.array([11.0, 11.0, 8.0, 2.4, 2.2, 2.0]),
        coulomb=np.array([7.0, 7.5, 5.0, 2.0, 1.8, 1.6]),
        compensator=np.zeros((n, 3)),
        range_=np.array([3.0, 2.8, 2.6, 3.0, 3.0, 3.0])[:, None] * [-1.0, 1.0],
        speed=np.full(n, 2.6),
        acceleration=np.array([9.0, 9.0, 10.0, 14.0, 14.0, 16.0]),
        workspace=np.array([[-1.0, 1.0], [-1.0, 1.0], [-0.2, 1.2]]),
    )  # fmt: skip


def _points(chain: Chain, size: float) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Sensor at the flange; blows there, and on all sides of every link, a third and two thirds of its way."""
    blows: list[Channel] = []
    last, flange = f"link{chain.n}", tuple(float(x) for x in chain.flange)
    for i, end in enumerate(chain.ends()):
        for share in (0.35, 0.7):
            for axis, side in (("y", 1.0), ("z", -1.0), ("y", -1.0)):
                place = share * end + side * 0.16 * size * np.eye(3)["xyz".index(axis)]
                label = f"{len(blows) + 1}{axis.upper()}{'-' if side > 0 else '+'}"
                blows.append(Channel(label, f"link{i + 1}", tuple(float(x) for x in place)))
    node = len(blows) + 1
    blows += [Channel(f"{node}{axis}", last, flange) for axis in ("X-", "Y+", "Z+")]
    return tuple(Channel(f"{node}{axis}+", last, flange) for axis in "XYZ"), tuple(blows)


def described(machine: Machine) -> dict[str, Any]:
    """The content of the robot's `robot.yaml`."""
    chain, t = machine.chain, machine.tolerances
    axes, physics = [], []
    for i in range(chain.n):
        a, alpha, d = chain.dh[i]
        axes.append({
            "alpha_deg": float(np.rad2deg(alpha)), "a": float(a), "theta_deg": 0.0, "d": float(d),
            "stiffness": float(chain.stiffness[i, 0]), "damping": float(chain.damping[i, 0]),
            "limits": {
                "position": _floats(chain.range_[i]), "velocity": float(chain.speed[i]),
                "acceleration": float(chain.acceleration[i]),
            },
        })  # fmt: skip
        for k, axis in ((1, "x"), (2, "y")):
            spring = {"stiffness": float(chain.stiffness[i, k]), "damping": float(chain.damping[i, k])}
            physics.append({"effect": "transverse_compliance", "site": f"joint{i + 1}.{axis}", **spring})
    for i in range(chain.n):
        site = {"site": f"joint{i + 1}"}
        physics.append({"effect": "viscous_friction", **site, "coefficient": float(chain.viscous[i])})
        physics.append({"effect": "coulomb_friction", **site, "torque": float(chain.coulomb[i])})
        if np.any(chain.compensator[i]):
            physics.append({"effect": "gravity_compensator", **site, "coefficients": _floats(chain.compensator[i])})
    points = {c.label: c for c in (*machine.hammer, *machine.sensors)}
    return {
        "name": machine.name,
        "gravity": _floats(chain.gravity),
        "links": [
            {
                "mass": link.mass, "com": _floats(link.com),
                "inertia": _floats([link.inertia[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
            }
            for link in chain.links
        ],
        "axes": axes,
        "drives": [
            {"gear_ratio": float(n), "rotor_inertia": float(j)}
            for n, j in zip(chain.gear_ratio, chain.rotor_inertia, strict=True)
        ],
        "flange": {"position": _floats(chain.flange)},
        "workspace": {axis: _floats(bounds) for axis, bounds in zip("xyz", chain.workspace, strict=True)},
        "test_points": [
            {"label": c.label, "body": c.body, "position": _floats(c.position), "direction": _floats(c.direction)}
            for c in points.values()
        ],
        "accelerometers": [c.label for c in machine.sensors],
        "physics": physics,
        "priors": [
            {"parameter": "joint*.stiffness", "factor": t.stiffness, "source": "spread between robots of a type"},
            {"parameter": "joint*.damping", "factor": t.damping, "source": "repeatability of damping estimates"},
        ],
        "tolerances": {
            "mass": t.mass, "com": t.com, "inertia": t.inertia, "posture_deg": t.posture_deg, "channel_gain": t.gain,
        },
    }  # fmt: skip


def write_description(machine: Machine, path: Path) -> None:
    """Write the robot's `robot.yaml`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    YAML(typ="safe", pure=True).dump(described(machine), path)


def _floats(values: Array | Sequence[float]) -> list[float]:
    return [float(x) for x in values]
