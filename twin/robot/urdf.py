"""A URDF's serial chain as a robot description: each axis is a line, and modified DH follows from successive lines.

Read with ElementTree rather than MuJoCo's own URDF reader, which drops velocity limits and the inertia of the root
link and cannot say which link or joint a fault is in.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from twin.errors import InputError
from twin.physics import effect_of
from twin.robot.description import Robot, check_inertia, parse_robot
from twin.robot.frames import inertia_matrix, inertia_six, quaternion_of
from twin.robot.mechanism import Inertial, fuse

PARALLEL_RAD = 1e-5
"""Axes nearer to parallel than this are parallel: URDFs write π/2 as 1.5708, which puts the common normal kilometres
away."""

SAME_POINT_M = 1e-6
"""Axes that miss each other by less than this intersect (coincide, if parallel)."""

STEEL = 7850.0  # kg/m³

_NO_MASS: Inertial = (0.0, np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    placement: np.ndarray  # (4, 4) child's frame in the parent's, at zero
    axis: np.ndarray  # (3,) unit vector in the child's frame
    position: tuple[float, float] | None
    velocity: float | None
    damping: float
    friction: float


@dataclass
class _Group:
    """A moving link (or the root) with all that is fixed to it; everything in the root's frame, joints at zero."""

    link: str
    inertial: Inertial
    joints: list[tuple[_Joint, np.ndarray]]  # movable joints that leave it, with the placement of their frame
    tip: tuple[int, np.ndarray]  # fixed joints on the way to the farthest link, and the placement of that link
    ball: bool = False  # its inertia stands in for one written as zero


def import_urdf(path: str | Path) -> Robot:
    """The kinematic and inertial part of a URDF's serial chain.

    The movable joints become joint1 … jointN from the root outwards, with the URDF's sign, zero and limits;
    ``Axis.name`` and ``Link.name`` keep the URDF's names. Links joined by fixed joints are merged; the root link is
    the base, and the link at the end of the most fixed joints after the last axis is the flange. ``<dynamics>``
    becomes ``viscous_friction`` and ``coulomb_friction``. Meshes, transmissions and sensors are left out. A moving
    link whose inertia is written as zero (some are, rounded to three decimals) gets that of a steel ball of its mass,
    the least a machine part can have; ``description`` then says so.

    The link frames follow Craig: x_i along the common normal of axes i and i+1 (for intersecting axes along their
    cross product, on the side nearest to x_{i−1}); d_i = 0 where axes i and i+1 are parallel; θ_N = d_N = 0. Frame 0 is
    the root link's where axis 1 is parallel to its z; otherwise it sits at the origin of joint 1, z along axis 1.

    Raises:
        InputError: not a URDF; not one serial chain of revolute, continuous and prismatic joints; a moving link
            without mass or with an impossible inertia; two axes too near to parallel for a common normal.
    """
    path = Path(path)
    name, links, joints = _read(path)
    groups, chain = _chain(path, links, joints)
    notes = [f"inertia of {group.link}, zero in the URDF, taken as a steel ball's" for group in groups if group.ball]
    lines = [(placement[:3, 3], placement[:3, :3] @ joint.axis) for joint, placement in chain]
    frames, parameters = _modified_dh(path, [joint.name for joint, _ in chain], lines)
    tip = np.linalg.inv(frames[-1]) @ groups[-1].tip[1]
    base_mass, base_com, base_inertia = groups[0].inertial
    data: dict[str, Any] = {
        "name": name,
        "description": "; ".join([f"imported from {path.name}", *notes]),
        "base": _placement(frames[0])
        | {"mass": base_mass, "com": _tidy(base_com), "inertia": inertia_six(base_inertia)},
        "links": [
            {"name": group.link} | _inertial_in(frame, group.inertial)
            for group, frame in zip(groups[1:], frames[1:], strict=True)
        ],
        "axes": [
            {
                "type": "prismatic" if joint.kind == "prismatic" else "revolute",
                "name": joint.name,
                **dh,
                "limits": {"position": joint.position, "velocity": joint.velocity},
            }
            for (joint, _), dh in zip(chain, parameters, strict=True)
        ],
        "flange": _placement(tip),
        "physics": [
            {"effect": effect.name, "site": f"joint{i + 1}", effect.parameters[0].name: value}
            for i, (joint, _) in enumerate(chain)
            for effect, value in ((effect_of("viscous"), joint.damping), (effect_of("dry"), joint.friction))
            if value > 0
        ],
    }
    return parse_robot(data, path)


# Reading


def _read(path: Path) -> tuple[str, dict[str, Inertial], list[_Joint]]:
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error
    except ElementTree.ParseError as error:
        raise InputError(path, "", f"not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise InputError(path, "", f"expected a URDF, whose top element is <robot>, found <{root.tag}>")
    links: dict[str, Inertial] = {}
    for element in root.findall("link"):
        link = _attribute(path, element, "name", "link")
        if link in links:
            raise InputError(path, f"link {link}", "appears twice")
        links[link] = _link(path, link, element)
    joints = [_joint(path, element) for element in root.findall("joint")]
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(path, f"joint {joint.name}", f"no such link: {link!r}")
    return root.get("name") or path.stem, links, joints


def _link(path: Path, name: str, element: ElementTree.Element) -> Inertial:
    where = f"link {name}"
    inertial = element.find("inertial")
    if inertial is None:
        return _NO_MASS
    mass = float(_numbers(path, where, inertial.find("mass"), "value", [0.0])[0])
    if mass < 0:
        raise InputError(path, where, f"mass must not be negative, found {mass:g}")
    placement = _origin(path, where, inertial)
    terms = inertial.find("inertia")
    six = [float(_numbers(path, where, terms, f"i{ij}", [0.0])[0]) for ij in ("xx", "yy", "zz", "xy", "xz", "yz")]
    inertia = placement[:3, :3] @ inertia_matrix(six) @ placement[:3, :3].T
    if mass > 0 and any(six):
        _check_inertia(path, where, inertia)
    return mass, placement[:3, 3], inertia


def _joint(path: Path, element: ElementTree.Element) -> _Joint:
    name = _attribute(path, element, "name", "joint")
    where = f"joint {name}"
    kind = _attribute(path, element, "type", where)
    if kind not in ("revolute", "continuous", "prismatic", "fixed"):
        raise InputError(path, where, f"expected revolute, continuous, prismatic or fixed, found {kind!r}")
    if element.find("mimic") is not None:
        raise InputError(path, where, "follows another joint (<mimic>), which a serial chain of axes cannot hold")
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise InputError(path, where, f"<{tag} link=…> is missing")
        ends.append(_attribute(path, end, "link", where))
    axis = _numbers(path, where, element.find("axis"), "xyz", [1.0, 0.0, 0.0])
    if norm(axis) < 1e-6:
        raise InputError(path, where, "axis must not be the zero vector")
    limit, dynamics = element.find("limit"), element.find("dynamics")
    position = None
    if kind in ("revolute", "prismatic") and limit is not None and {"lower", "upper"} & set(limit.keys()):
        low, high = (float(_numbers(path, where, limit, bound, [0.0])[0]) for bound in ("lower", "upper"))
        if low >= high:
            raise InputError(path, where, f"limits must increase, found lower {low:g} and upper {high:g}")
        position = (low, high)
    velocity, damping, friction = (
        float(_numbers(path, where, tag, key, [0.0])[0])
        for tag, key in ((limit, "velocity"), (dynamics, "damping"), (dynamics, "friction"))
    )
    if min(velocity, damping, friction) < 0:
        raise InputError(path, where, "velocity limit, damping and friction must not be negative")
    return _Joint(
        name, kind, ends[0], ends[1], _origin(path, where, element), axis / norm(axis),
        position, velocity or None, damping, friction,
    )  # fmt: skip


def _attribute(path: Path, element: ElementTree.Element, key: str, where: str) -> str:
    value = element.get(key)
    if not value:
        raise InputError(path, where, f"<{element.tag}> needs the attribute {key}")
    return value


def _numbers(path: Path, where: str, element: ElementTree.Element | None, key: str, default: list[float]) -> np.ndarray:
    text = None if element is None else element.get(key)
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if values.size != len(default) or not np.isfinite(values).all():
        hint = " (expand xacro first)" if "${" in text else ""
        raise InputError(path, where, f"{key}: expected {len(default)} finite number(s), found {text!r}{hint}")
    return values


def _origin(path: Path, where: str, element: ElementTree.Element) -> np.ndarray:
    origin = element.find("origin")
    placement = np.eye(4)
    placement[:3, :3] = Rotation.from_euler("xyz", _numbers(path, where, origin, "rpy", [0.0] * 3)).as_matrix()
    placement[:3, 3] = _numbers(path, where, origin, "xyz", [0.0] * 3)
    return placement


def _check_inertia(path: Path, where: str, inertia: np.ndarray) -> None:
    try:
        check_inertia(inertia_six(inertia))
    except ValueError as error:
        raise InputError(path, where, str(error)) from error


# The chain


def _chain(
    path: Path, links: dict[str, Inertial], joints: list[_Joint]
) -> tuple[list[_Group], list[tuple[_Joint, np.ndarray]]]:
    """The root's group and one per axis, and the movable joints with the placement of their frame in the root's."""
    leaving: dict[str, list[_Joint]] = {name: [] for name in links}
    children: set[str] = set()
    for joint in joints:
        if joint.child in children:
            raise InputError(path, f"link {joint.child}", "is the child of two joints; expected a serial chain")
        children.add(joint.child)
        leaving[joint.parent].append(joint)
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        found = f"{len(roots)} ({', '.join(roots)})" if roots else "none (a closed loop)"
        raise InputError(path, "", f"expected one root link, found {found}")
    groups = [_gather(links, leaving, roots[0], np.eye(4))]
    chain = []
    while groups[-1].joints:
        if len(groups[-1].joints) > 1:
            names = ", ".join(joint.name for joint, _ in groups[-1].joints)
            raise InputError(
                path, f"link {groups[-1].link}", f"branches into the joints {names}; expected a serial chain"
            )
        joint, placement = groups[-1].joints[0]
        chain.append((joint, placement))
        group = _gather(links, leaving, joint.child, placement)
        where = f"link {joint.child}"
        mass, com, inertia = group.inertial
        if mass <= 0:
            raise InputError(path, where, "moves but has no <inertial> with a mass, nor has a link fixed to it")
        if not inertia.any():
            radius = np.cbrt(3 * mass / (4 * np.pi * STEEL))
            group.inertial, group.ball = (mass, com, 0.4 * mass * radius**2 * np.eye(3)), True
        _check_inertia(path, where, group.inertial[2])
        groups.append(group)
    if not chain:
        raise InputError(path, "", "has no movable joint")
    return groups, chain


def _gather(
    links: dict[str, Inertial], leaving: dict[str, list[_Joint]], link: str, placement: np.ndarray, depth: int = 0
) -> _Group:
    rotation, origin = placement[:3, :3], placement[:3, 3]
    mass, com, inertia = links[link]
    inertial = mass, origin + rotation @ com, rotation @ inertia @ rotation.T
    group = _Group(link, inertial, [], (depth, placement))
    for joint in leaving[link]:
        outboard = placement @ joint.placement
        if joint.kind != "fixed":
            group.joints.append((joint, outboard))
            continue
        fixed = _gather(links, leaving, joint.child, outboard, depth + 1)
        group.inertial = fuse(group.inertial, fixed.inertial)
        group.joints += fixed.joints
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
