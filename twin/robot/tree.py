"""A robot's links and joints as a file draws them, and the serial chain of modified-DH axes that follows from them.

URDF and MJCF are read into a :class:`Tree`. Each movable joint is a line in space; modified DH follows from
successive lines. A tree that is no serial chain is refused here; ``twin.robot.reduce`` makes one of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import norm

from twin.errors import InputError
from twin.physics import effect_of
from twin.robot.bodies import Inertial, fuse
from twin.robot.description import Robot, check_inertia, parse_robot
from twin.robot.frames import inertia_six, quaternion_of

if TYPE_CHECKING:
    import trimesh

PARALLEL_RAD = 1e-5
"""Axes nearer to parallel than this are parallel: URDFs write π/2 as 1.5708, which puts the common normal kilometres
away."""

SAME_POINT_M = 1e-6
"""Axes that miss each other by less than this intersect (coincide, if parallel)."""

STEEL = 7850.0  # kg/m³

COM_SHARE = 0.0025  # of the robot's length along its axes: 1 cm of the KR90's 4 m, which its description states
ROUNDED_M = 1e-3  # files state centres of mass to a millimetre
TORQUE_GAIN = 0.05
"""Deviation of what torque is recorded in: motor data sheets state torque constants to ±10 %."""


@dataclass(frozen=True)
class Shape:
    """A surface fixed to a part: ``placement`` (4, 4) in its frame, and how to get its triangles (m)."""

    placement: np.ndarray
    load: "Callable[[], trimesh.Trimesh]"


@dataclass
class Part:
    """What a file calls a link or body: mass kg, centre (3,) m, inertia (3, 3) kg·m² in its frame, and its shapes."""

    inertial: Inertial = field(default_factory=lambda: (0.0, np.zeros(3), np.zeros((3, 3))))
    visual: list[Shape] = field(default_factory=list)
    collision: list[Shape] = field(default_factory=list)


@dataclass(frozen=True)
class Joint:
    """A joint between two parts; rad, N·m (m, N on a prismatic one).

    Attributes:
        kind: revolute, continuous, prismatic or fixed.
        placement: (4, 4) the child's frame in the parent's, at zero; the joint acts at its origin.
        axis: (3,) unit vector in the child's frame.
        position, velocity, effort: limits, ``None`` where the file states none.
        inertia: of the rotor, seen at the joint.
        follows: joint whose position times the second number (plus a constant) this one takes; ``None`` if it is free.
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: np.ndarray
    axis: np.ndarray
    position: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    inertia: float = 0.0
    follows: tuple[str, float] | None = None

    def following(self, leader: str, ratio: float) -> "Joint":
        """The joint, tied to another."""
        return replace(self, follows=(leader, ratio))


@dataclass
class Tree:
    """A file's parts and joints. ``loops``: pairs of parts that it holds together besides.

    ``sites``: named places, each with its part and the pose (4, 4) in it.
    """

    path: Path
    name: str
    parts: dict[str, Part]
    joints: list[Joint]
    loops: list[tuple[str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sites: dict[str, tuple[str, np.ndarray]] = field(default_factory=dict)

    def leaving(self, part: str) -> list[Joint]:
        """The joints of which a part is the parent."""
        return [joint for joint in self.joints if joint.parent == part]

    def root(self) -> str:
        """The part that is no other's child.

        Raises:
            InputError: none or several, or a part that is the child of two joints or of one that is not there.
        """
        children: set[str] = set()
        for joint in self.joints:
            for part in (joint.parent, joint.child):
                if part not in self.parts:
                    raise InputError(self.path, f"joint {joint.name}", f"no such link: {part!r}")
            if joint.child in children:
                raise InputError(
                    self.path, f"link {joint.child}", "is the child of two joints; expected a serial chain"
                )
            children.add(joint.child)
        roots = [name for name in self.parts if name not in children]
        if len(roots) != 1:
            found = f"{len(roots)} ({', '.join(roots)})" if roots else "none (a closed loop)"
            raise InputError(self.path, "", f"expected one root link, found {found}")
        return roots[0]


@dataclass
class Group:
    """A moving link (or the root) with all that is fixed to it; everything in the root's frame, joints at zero.

    Attributes:
        joints: movable joints that leave it, with the placement of their frame.
        tip: fixed joints on the way to the farthest part, and the placement of that part.
        parts: what is merged, with the placement of its frame.
        ball: its inertia stands in for one written as zero.
    """

    link: str
    inertial: Inertial
    joints: list[tuple[Joint, np.ndarray]]
    tip: tuple[int, np.ndarray]
    parts: list[tuple[Part, np.ndarray]]
    ball: bool = False


@dataclass
class Chain:
    """A tree as a serial chain: the root's group and one per axis, and the axes with their placement in the root."""

    tree: Tree
    groups: list[Group]
    axes: list[tuple[Joint, np.ndarray]]

    def frames(self) -> tuple[list[np.ndarray], list[dict[str, float]]]:
        """Modified-DH frames 0 … N in the root's frame, (4, 4) each, and the parameters of axes 1 … N."""
        lines = [(placement[:3, 3], placement[:3, :3] @ joint.axis) for joint, placement in self.axes]
        return _modified_dh(self.tree.path, [joint.name for joint, _ in self.axes], lines)


def chain_of(tree: Tree) -> Chain:
    """The serial chain that a tree is.

    Raises:
        InputError: it is none, or a moving link has no mass or an impossible inertia.
    """
    chain = gather(tree)
    for joint in tree.joints:
        if joint.follows is not None:
            raise InputError(
                tree.path, f"joint {joint.name}",
                "follows another joint (<mimic>), which a serial chain of axes cannot hold",
            )  # fmt: skip
    for name, part in tree.parts.items():
        _check_part(tree.path, f"link {name}", part)
    for group in chain.groups[1:]:
        where = f"link {group.link}"
        mass, com, inertia = group.inertial
        if mass <= 0:
            raise InputError(tree.path, where, "moves but has no <inertial> with a mass, nor has a link fixed to it")
        if not inertia.any():
            group.inertial, group.ball = (mass, com, ball_inertia(mass)), True
        _check_inertia(tree.path, where, group.inertial[2])
    return chain


def gather(tree: Tree) -> Chain:
    """The groups and axes of a tree whose movable joints do not branch, as they are drawn."""
    groups = [_gather(tree, tree.root(), np.eye(4))]
    axes = []
    while groups[-1].joints:
        if len(groups[-1].joints) > 1:
            names = ", ".join(joint.name for joint, _ in groups[-1].joints)
            raise InputError(
                tree.path, f"link {groups[-1].link}", f"branches into the joints {names}; expected a serial chain"
            )
        axes.append(groups[-1].joints[0])
        groups.append(_gather(tree, axes[-1][0].child, axes[-1][1]))
    if not axes:
        raise InputError(tree.path, "", "has no movable joint")
    return Chain(tree, groups, axes)


def robot_data(chain: Chain) -> dict[str, Any]:
    """The content of a ``robot.yaml`` as far as the chain gives it; the frames are explained in ``docs/robot.md``."""
    frames, parameters = chain.frames()
    tip = np.linalg.inv(frames[-1]) @ chain.groups[-1].tip[1]
    notes = [
        f"inertia of {group.link}, zero in the URDF, taken as a steel ball's" for group in chain.groups if group.ball
    ]
    base_mass, base_com, base_inertia = chain.groups[0].inertial
    return {
        "name": chain.tree.name,
        "description": "; ".join([f"imported from {chain.tree.path.name}", *notes]),
        "base": _placement(frames[0])
        | {"mass": base_mass, "com": _tidy(base_com), "inertia": inertia_six(base_inertia)},
        "links": [
            {"name": group.link} | _inertial_in(frame, group.inertial)
            for group, frame in zip(chain.groups[1:], frames[1:], strict=True)
        ],
        "axes": [
            {
                "type": "prismatic" if joint.kind == "prismatic" else "revolute",
                "name": joint.name,
                **dh,
                **_bearing(joint, frame, placement),
                "limits": {"position": joint.position, "velocity": joint.velocity},
            }
            for (joint, placement), dh, frame in zip(chain.axes, parameters, frames[1:], strict=True)
        ],
        "flange": _placement(tip),
        "physics": [
            {"effect": effect.name, "site": f"joint{i + 1}", effect.parameters[0].name: value}
            for i, (joint, _) in enumerate(chain.axes)
            for effect, value in ((effect_of("viscous"), joint.damping), (effect_of("dry"), joint.friction))
            if value > 0
        ],
        "tolerances": {"com": _com_tolerance(parameters, tip), "torque_gain": TORQUE_GAIN},
    }


def _bearing(joint: Joint, frame: np.ndarray, placement: np.ndarray) -> dict[str, float]:
    """Where the file has a turning joint on its axis, m from the origin of the link's modified-DH ``frame``."""
    height = round(float(frame[:3, 2] @ (placement[:3, 3] - frame[:3, 3])), 9)
    return {"bearing": height} if height and joint.kind != "prismatic" else {}


def _com_tolerance(parameters: list[dict[str, float]], tip: np.ndarray) -> float:
    """One standard deviation, m, of the centres of mass of a drawing: what it leaves out is a share of the robot."""
    length = sum(float(np.hypot(dh["a"], dh["d"])) for dh in parameters) + float(np.linalg.norm(tip[:3, 3]))
    return float(f"{max(COM_SHARE * length, ROUNDED_M):.2g}")


def robot_of(tree: Tree) -> Robot:
    """The rigid robot that a tree's serial chain is.

    Raises:
        InputError: as :func:`chain_of`; two axes too near to parallel for a common normal.
    """
    return parse_robot(robot_data(chain_of(tree)), tree.path)


def ball_inertia(mass: float) -> np.ndarray:
    """Inertia (3, 3) kg·m² of a steel ball of that mass: the least that a machine part can have."""
    radius = np.cbrt(3 * mass / (4 * np.pi * STEEL))
    return 0.4 * mass * radius**2 * np.eye(3)


def _check_part(path: Path, where: str, part: Part) -> None:
    mass, _, inertia = part.inertial
    if mass < 0:
        raise InputError(path, where, f"mass must not be negative, found {mass:g}")
    if mass > 0 and inertia.any():
        _check_inertia(path, where, inertia)


def _check_inertia(path: Path, where: str, inertia: np.ndarray) -> None:
    try:
        check_inertia(inertia_six(inertia))
    except ValueError as error:
        raise InputError(path, where, str(error)) from error


def _gather(tree: Tree, link: str, placement: np.ndarray, depth: int = 0) -> Group:
    rotation, origin = placement[:3, :3], placement[:3, 3]
    part = tree.parts[link]
    mass, com, inertia = part.inertial
    inertial = mass, origin + rotation @ com, rotation @ inertia @ rotation.T
    group = Group(link, inertial, [], (depth, placement), [(part, placement)])
    for joint in tree.leaving(link):
        outboard = placement @ joint.placement
        if joint.kind != "fixed":
            group.joints.append((joint, outboard))
            continue
        fixed = _gather(tree, joint.child, outboard, depth + 1)
        group.inertial = fuse(group.inertial, fixed.inertial)
        group.joints += fixed.joints
        group.parts += fixed.parts
        group.tip = max(group.tip, fixed.tip, key=lambda tip: tip[0])
    return group


# Modified DH


def _modified_dh(
    path: Path, names: list[str], lines: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[list[np.ndarray], list[dict[str, float]]]:
    """Link frames from axis lines (point, unit direction): (4, 4) of frames 0 … N, and the parameters of axes 1 … N.

    Craig, Introduction to Robotics, section 3.4.
    """
    x, z = np.eye(3)[[0, 2]]
    if norm(np.cross(z, lines[0][1])) < PARALLEL_RAD:
        lines = [(np.zeros(3), z), *lines]
    else:
        lines = [lines[0], *lines]
        z = lines[0][1]
        x = np.eye(3)[np.argmin(np.abs(z))]
        x = (x - z * (z @ x)) / norm(np.cross(x, z))
    reach = sum(float(norm(b[0] - a[0])) for a, b in pairwise(lines))
    frames: list[np.ndarray] = []
    parameters: list[dict[str, float]] = []
    foot, alpha, a = lines[0][0], 0.0, 0.0  # foot: where the common normal with the axis before meets this axis
    for i, (point, _) in enumerate(lines):
        before, origin, next_point, next_z = x, foot, point, z
        if i < len(lines) - 1:
            next_point, next_z = lines[i + 1]
            origin, x, next_z = _common_normal(foot, before, (point, z), (next_point, next_z))
            if norm(origin - foot) > 10 * max(reach, 0.1):
                raise InputError(
                    path, f"joint {names[i]}",
                    f"{np.rad2deg(norm(np.cross(z, next_z))):.2g}° from parallel to {names[i - 1]}, which puts their "
                    f"common normal {norm(origin - foot):.0f} m away; write parallel axes with more digits",
                )  # fmt: skip
        if i > 0:
            theta = np.arctan2(np.cross(before, x) @ z, before @ x)
            values = {"alpha_deg": np.rad2deg(alpha), "a": a, "theta_deg": np.rad2deg(theta), "d": z @ (origin - foot)}
            parameters.append({key: _round(value) for key, value in values.items()})
        frame = np.eye(4)
        frame[:3, :3] = np.column_stack([x, np.cross(z, x), z])
        frame[:3, 3] = origin
        frames.append(frame)
        alpha = np.arctan2(np.cross(z, next_z) @ x, z @ next_z)
        a = float(x @ (next_point - origin))
        foot, z = origin + a * x, next_z
    return frames, parameters


def _common_normal(
    foot: np.ndarray, before: np.ndarray, line: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the common normal with the next axis leaves this one, its unit direction, and the next axis's direction."""
    (point, z), (next_point, next_z) = line, after
    cross = np.cross(z, next_z)
    sine = norm(cross)
    if sine < PARALLEL_RAD:
        across = next_point - foot - z * (z @ (next_point - foot))
        gap = norm(across)
        return foot, across / gap if gap > SAME_POINT_M else before, z * np.sign(z @ next_z)
    origin = point + z * (np.cross(next_point - point, next_z) @ cross / sine**2)
    x = cross / sine
    gap = x @ (next_point - origin)
    toward = gap if abs(gap) > SAME_POINT_M else x @ before
    return origin, -x if toward < -1e-9 else x, next_z


def _round(value: float) -> float:
    return round(float(value), 12) + 0.0  # + 0.0: no minus zero


def _tidy(vector: np.ndarray) -> list[float]:
    return [_round(value) for value in vector]


def _placement(frame: np.ndarray) -> dict[str, list[float]]:
    return {"position": _tidy(frame[:3, 3]), "quaternion": _tidy(quaternion_of(frame[:3, :3]))}


def _inertial_in(frame: np.ndarray, inertial: Inertial) -> dict[str, Any]:
    mass, com, inertia = inertial
    rotation, origin = frame[:3, :3], frame[:3, 3]
    return {
        "mass": mass,
        "com": _tidy(rotation.T @ (com - origin)),
        "inertia": inertia_six(rotation.T @ inertia @ rotation),
    }
