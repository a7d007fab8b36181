"""URDF read into a tree of parts and joints.

It is read with ElementTree. MuJoCo's own URDF reader drops velocity limits and the inertia of the root link, and cannot
say which link or joint a fault is in.
"""

import reprlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from twin.errors import InputError, tell
from twin.ranges import FARTHEST_M, MOST_PARTS, implausible
from twin.robot.bodies import Inertial
from twin.robot.description import Robot
from twin.robot.frames import inertia_matrix
from twin.robot.mesh import read_mesh
from twin.robot.tree import Joint, Part, Shape, Tree, robot_of


def import_urdf(path: str | Path) -> Robot:
    """The kinematic and inertial part of a URDF's serial chain.

    The movable joints become joint1 … jointN from the root outwards, with the URDF's sign, zero and limits.
    ``Axis.name`` and ``Link.name`` keep the URDF's names. Links joined by fixed joints are merged. The root link is the
    base. The link at the end of the most fixed joints after the last axis is the flange. ``<dynamics>`` becomes
    ``viscous_friction`` and ``coulomb_friction``. Meshes, transmissions and sensors are left out. Some moving links
    have an inertia that is written as zero, rounded to three decimals. They get that of a steel ball of their mass, the
    least a machine part can have; ``description`` then says so.

    The link frames follow Craig: x_i is along the common normal of axes i and i+1. For intersecting axes it is along
    their cross product, on the side nearest to x_{i−1}. d_i = 0 where axes i and i+1 are parallel; θ_N = d_N = 0. Frame
    0 is the root link's where axis 1 is parallel to its z; otherwise it sits at the origin of joint 1, z along axis 1.

    Raises:
        InputError: not a URDF, or not one serial chain of revolute, continuous and prismatic joints. Also a moving link
            without mass or with an impossible inertia, or two axes too near to parallel for a common normal.
    """
    tree = read_urdf(path)
    for note in tree.notes:
        tell(path, "", note)
    return robot_of(tree)


def read_urdf(path: str | Path) -> Tree:
    """The links, joints and shapes of a URDF as they stand there; mesh files that are not found are told in ``notes``.

    Raises:
        InputError: not a URDF, or a number, name or joint type that makes no sense.
    """
    path = Path(path)
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(path, "", f"not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise InputError(path, "", f"expected a URDF, whose top element is <robot>, found <{root.tag}>")
    for tag in ("link", "joint"):
        if (count := len(root.findall(tag))) > MOST_PARTS:
            raise InputError(path, tag, f"expected at most {MOST_PARTS}, found {count}")
    if root.find("link") is None:
        raise InputError(path, "link", "the file has none, so it describes no robot")
    tree = Tree(path, root.get("name") or path.stem, {}, [])
    unknown: dict[str, list[str]] = {}
    _enter_unknown(unknown, root, "the robot")
    for element in root.findall("link"):
        link = _attribute(path, element, "name", "link")
        if link in tree.parts:
            raise InputError(path, f"link {link}", "appears twice")
        where = f"link {link}"
        _enter_unknown(unknown, element, where)
        tree.parts[link] = Part(
            _inertial(tree, where, _one(path, where, element, "inertial")),
            _shapes(tree, where, element.findall("visual")),
            _shapes(tree, where, element.findall("collision")),
        )
    for element in root.findall("joint"):
        joint = _joint(path, element)
        if joint.name in [one.name for one in tree.joints]:
            raise InputError(path, f"joint {joint.name}", "appears twice")
        _enter_unknown(unknown, element, f"joint {joint.name}")
        tree.joints.append(joint)
    tree.notes += [f"{what} of {_counted(places)} is not known: not read" for what, places in unknown.items()]
    tree.notes += _doubts(tree)
    return tree


def _enter_unknown(unknown: dict[str, list[str]], element: ElementTree.Element, where: str) -> None:
    """Enter elements and attributes that no reader of URDF knows: misspelt, they would be left out in silence."""
    attributes, children = KNOWN[element.tag]
    for key in element.attrib:
        if key not in attributes and not key.startswith("{"):  # of another program's name space
            unknown.setdefault(f"attribute {reprlib.repr(key)} of <{element.tag}>", []).append(where)
    if element.tag == "robot":
        for child in element:
            if child.tag not in children and not str(child.tag).startswith("{"):
                unknown.setdefault(f"element <{reprlib.repr(child.tag)[1:-1]}>", []).append(where)
        return
    for child in element:
        if child.tag in KNOWN:
            _enter_unknown(unknown, child, where)
        elif child.tag not in children and isinstance(child.tag, str) and not child.tag.startswith("{"):
            unknown.setdefault(f"element <{reprlib.repr(child.tag)[1:-1]}>", []).append(where)


def _counted(places: Sequence[str]) -> str:
    """``link a``, or ``link a and 6 more``."""
    return places[0] if len(places) == 1 else f"{places[0]} and {len(places) - 1} more"


def _doubts(tree: Tree) -> list[str]:
    """What to say of limits that are hardly in rad."""
    found = []
    for joint in tree.joints:
        if joint.kind == "revolute" and joint.position and max(map(abs, joint.position)) > LARGEST_LIMIT:
            low, high = joint.position
            found.append(f"joint {joint.name} turns from {low:g} to {high:g} rad: are these degrees?")
        if joint.kind == "revolute" and joint.velocity and not SLOWEST < joint.velocity < FASTEST:
            found.append(f"joint {joint.name} turns at up to {joint.velocity:g} rad/s: is it in another unit?")
    return found


LARGEST_LIMIT = 8 * np.pi  # rad: four turns
SLOWEST, FASTEST = 1e-3, 100.0  # rad/s at a joint
_SHAPE = (("name",), ("origin", "geometry", "material", "verbose", "contact_coefficients"))
KNOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    # tag → attributes, and children that are not in this table themselves: read over, not read, or of simulators
    "robot": (("name", "version"), ("link", "joint", "material", "transmission", "gazebo", "sensor", "ros2_control")),
    "link": (("name", "type"), ("contact", "sensor", "self_collision_checking", "inertial", "visual", "collision")),
    "inertial": (("name",), ()),
    "mass": (("value",), ()),
    "inertia": (("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), ()),
    "origin": (("xyz", "rpy"), ()),
    "visual": _SHAPE,
    "collision": _SHAPE,
    "geometry": ((), ("plane", "capsule", "ellipsoid")),  # of other dialects: noted where shapes are read
    "mesh": (("filename", "scale"), ()),
    "box": (("size",), ()),
    "cylinder": (("radius", "length"), ()),
    "sphere": (("radius",), ()),
    "joint": (("name", "type"), ("safety_controller", "calibration", "hardwareInterface", "mechanicalReduction")),
    "parent": (("link",), ()),
    "child": (("link",), ()),
    "axis": (("xyz",), ()),
    "limit": (("lower", "upper", "velocity", "effort"), ()),
    "dynamics": (("damping", "friction"), ()),
    "mimic": (("joint", "multiplier", "offset"), ()),
}


def _one(path: Path, where: str, element: ElementTree.Element, tag: str) -> ElementTree.Element | None:
    """The only child of that name; of two, neither is known to be meant."""
    found = element.findall(tag)
    if len(found) > 1:
        raise InputError(path, where, f"expected one <{tag}> in <{element.tag}>, found {len(found)}")
    return found[0] if found else None


def _inertial(tree: Tree, where: str, inertial: ElementTree.Element | None) -> Inertial:
    if inertial is None:
        return Part().inertial
    path = tree.path
    weight = _one(path, where, inertial, "mass")
    if weight is None:
        tree.notes.append(f"<inertial> of {where} has no <mass>: taken as 0")
    else:
        _attribute(path, weight, "value", where)
    mass = float(_numbers(path, where, weight, "value", [0.0], "kg")[0])
    placement = _origin(path, where, inertial)
    terms = _one(path, where, inertial, "inertia")
    six = [
        float(_numbers(path, where, terms, f"i{ij}", [0.0], "kg·m²")[0]) for ij in ("xx", "yy", "zz", "xy", "xz", "yz")
    ]
    inertia = placement[:3, :3] @ inertia_matrix(six) @ placement[:3, :3].T
    return mass, placement[:3, 3], inertia


def _shapes(tree: Tree, where: str, elements: list[ElementTree.Element]) -> list[Shape]:
    found = []
    for element in elements:
        geometry = _one(tree.path, where, element, "geometry")
        if geometry is None or not len(geometry):
            tree.notes.append(f"<{element.tag}> of {where} has no geometry: not drawn")
        for solid in () if geometry is None else geometry:
            if solid.tag == "mesh":
                file = _mesh_file(tree.path, _attribute(tree.path, solid, "filename", where))
                if file is None:
                    tree.notes.append(f"mesh {solid.get('filename')} of {where} not found: not drawn")
                    continue
                scale = _numbers(tree.path, where, solid, "scale", [1.0, 1.0, 1.0])
                if not (scale.all() and 1e-6 <= np.abs(scale).max() <= 1e3):
                    raise InputError(tree.path, where, f"scale: expected 1e-6 to 1e3 of metres, found {scale.tolist()}")
                load = partial(_load_mesh, tree.path, where, file, scale)
            else:
                sizes = {"box": ("size", 3), "cylinder": ("radius", 1), "sphere": ("radius", 1)}
                if solid.tag not in sizes:
                    tree.notes.append(f"shape <{solid.tag}> of {where} not known: not drawn")
                    continue
                key, count = sizes[solid.tag]
                size = _numbers(tree.path, where, solid, key, [0.0] * count)
                if solid.tag == "cylinder":
                    size = np.append(size, _numbers(tree.path, where, solid, "length", [0.0]))
                if min(size) <= 0 or max(size) > FARTHEST_M:
                    expected = f"<{solid.tag}> must have positive sizes in m, up to {FARTHEST_M:g}"
                    raise InputError(tree.path, where, f"{expected}, found {size.tolist()}")
                load = partial(_primitive, solid.tag, size)
            found.append(Shape(_origin(tree.path, where, element), load))
    return found


def _mesh_file(path: Path, name: str) -> Path | None:
    """Where a mesh lies: ``package://NAME/…`` is looked up in every folder above the URDF, with and without NAME."""
    name = name.removeprefix("file://")
    if not name.startswith("package://"):
        file = path.parent / name
        return file if file.is_file() else None
    whole = Path(name.removeprefix("package://"))
    for folder in path.resolve().parents:
        for file in (folder / whole, folder.joinpath(*whole.parts[1:])):
            if file.is_file():
                return file
    return None


def _load_mesh(path: Path, where: str, file: Path, scale: np.ndarray) -> trimesh.Trimesh:
    return read_mesh(file, path, where).apply_scale(scale)


def _primitive(kind: str, size: np.ndarray) -> trimesh.Trimesh:
    if kind == "box":
        return trimesh.creation.box(size)
    if kind == "sphere":
        return trimesh.creation.icosphere(radius=size[0])
    return trimesh.creation.cylinder(radius=size[0], height=size[1])


def _joint(path: Path, element: ElementTree.Element) -> Joint:
    name = _attribute(path, element, "name", "joint")
    where = f"joint {name}"
    kind = _attribute(path, element, "type", where)
    if kind not in ("revolute", "continuous", "prismatic", "fixed"):
        raise InputError(path, where, f"expected revolute, continuous, prismatic or fixed, found {kind!r}")
    mimic = _one(path, where, element, "mimic")
    follows = None
    if mimic is not None:
        leader = _attribute(path, mimic, "joint", where)
        if _numbers(path, where, mimic, "offset", [0.0]).any():
            raise InputError(path, where, "<mimic> with an offset is not read: move the zero of the joint instead")
        follows = leader, float(_numbers(path, where, mimic, "multiplier", [1.0])[0])
    ends = []
    for tag in ("parent", "child"):
        end = _one(path, where, element, tag)
        if end is None:
            raise InputError(path, where, f"<{tag} link=…> is missing")
        ends.append(_attribute(path, end, "link", where))
    if ends[0] == ends[1]:
        raise InputError(path, where, f"expected two links, it leads from {ends[0]!r} to itself")
    stated = _one(path, where, element, "axis")
    if stated is not None:
        _attribute(path, stated, "xyz", where)
    axis = _numbers(path, where, stated, "xyz", [1.0, 0.0, 0.0])
    if kind == "fixed":
        axis = np.array([1.0, 0.0, 0.0])  # of no consequence; files write zeros
    elif norm(axis) < 1e-6:
        raise InputError(path, where, "axis must not be the zero vector")
    limit, dynamics = (_one(path, where, element, tag) for tag in ("limit", "dynamics"))
    position = None
    if kind in ("revolute", "prismatic") and limit is not None and {"lower", "upper"} & set(limit.keys()):
        low, high = (float(_numbers(path, where, limit, bound, [0.0])[0]) for bound in ("lower", "upper"))
        if low > high:
            raise InputError(path, where, f"limits must increase, found lower {low:g} and upper {high:g}")
        position = (low, high) if low < high else None  # files write zeros where they state none
    velocity, effort, damping, friction = (
        float(_numbers(path, where, tag, key, [0.0], unit)[0])
        for tag, key, unit in (
            (limit, "velocity", "rad/s"), (limit, "effort", "N·m"), (dynamics, "damping", "N·m·s/rad"),
            (dynamics, "friction", "N·m"),
        )
    )  # fmt: skip
    if min(velocity, damping, friction) < 0:
        raise InputError(path, where, "velocity limit, damping and friction must not be negative")
    return Joint(
        name, kind, ends[0], ends[1], _origin(path, where, element), axis / norm(axis), position,
        velocity or None, effort if effort > 0 else None, damping, friction, follows=follows,
    )  # fmt: skip


def _attribute(path: Path, element: ElementTree.Element, key: str, where: str) -> str:
    value = element.get(key)
    if not value:
        raise InputError(path, where, f"<{element.tag}> needs the attribute {key}")
    return value


def _numbers(
    path: Path, where: str, element: ElementTree.Element | None, key: str, default: list[float], unit: str = ""
) -> np.ndarray:
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
    for value in values:
        if problem := implausible(value, unit):
            raise InputError(path, where, f"{key}: {problem}")
    return values


def _origin(path: Path, where: str, element: ElementTree.Element) -> np.ndarray:
    origin = _one(path, where, element, "origin")
    placement = np.eye(4)
    turns, place = (_numbers(path, where, origin, key, [0.0] * 3) for key in ("rpy", "xyz"))
    if np.abs(turns).max() > LARGEST_LIMIT:
        raise InputError(path, where, f"rpy: expected rad, found {turns.tolist()}: are these degrees?")
    if np.abs(place).max() > FARTHEST_M:
        raise InputError(path, where, f"xyz: expected metres, up to {FARTHEST_M:g}, found {place.tolist()}")
    placement[:3, :3] = Rotation.from_euler("xyz", turns).as_matrix()
    placement[:3, 3] = place
    return placement
