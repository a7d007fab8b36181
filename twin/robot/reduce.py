"""A tree made a serial chain with possible masses: branches welded, loops and followers reduced, inertias repaired.

Whatever is changed is told as an :class:`~twin.robot.description.Assumed`, so that nothing is repaired in silence.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from twin.errors import InputError
from twin.robot.description import Assumed, check_inertia
from twin.robot.frames import inertia_six
from twin.robot.tree import Chain, Group, Joint, Part, Tree, ball_inertia, gather

THINNEST = 1e-3
"""Least second moment of mass of a repaired link along any axis, over its largest: a rod 30 times as long as thick."""


@dataclass
class Reduced:
    """A serial chain, what was assumed on the way, and which drives also turn with other axes.

    ``coupling``: joint name → {joint name: ratio}, as ``Drive.coupling`` has it. ``massless``: 1-based numbers of
    links whose mass the file does not give.
    """

    chain: Chain
    assumed: list[Assumed] = field(default_factory=list)
    coupling: dict[str, dict[str, float]] = field(default_factory=dict)
    massless: list[int] = field(default_factory=list)


def reduce_tree(tree: Tree, tip: str | None = None) -> Reduced:
    """The serial chain from the root to the tip; side branches move with the link that carries them.

    Without ``tip`` the branch with the most movable joints is followed. Where several have as many, the chain ends (the
    fingers of a hand), unless those have more joints than the chain up to there. A joint of the chain that follows
    another stays an axis whose motor turns with that other one. In a parallelogram, a lever beside an axis drives the
    next axis: the lever's drive is kept.

    Raises:
        InputError: no such tip, no axis, two parents, or several arms and no tip.
    """
    found = Reduced(Chain(tree, [], []))
    tree.root()
    path = _path_to(tree, tip) if tip is not None else _longest_path(tree)
    kept = {joint.name for joint in path}
    found.coupling = _parallelograms(tree, path, found.assumed)
    joints = []
    for joint in tree.joints:
        if joint.name in kept:
            if joint.follows is not None and joint.follows[0] in kept:
                leader, ratio = joint.follows
                found.coupling.setdefault(joint.name, {})[leader] = -ratio
                found.assumed.append(_said(f"axis {joint.name}", f"follows {leader} at {ratio:g}", "mimic in the file"))
            joints.append(replace(joint, follows=None))
        else:
            if joint.kind != "fixed":
                carrier = joint.parent
                found.assumed.append(_said(f"joint {joint.name}", f"welded at 0 to {carrier}", "a side branch"))
            joints.append(replace(joint, kind="fixed", follows=None))
    tree.joints = joints
    _repair_parts(tree, found.assumed)
    found.chain = gather(tree)
    for number, group in enumerate(found.chain.groups[1:], start=1):
        if group.inertial[0] <= 0:
            found.massless.append(number)
        else:
            _repair_group(group, number, found.assumed)
    return found


def possible(inertia: np.ndarray) -> np.ndarray:
    """The nearest inertia (3, 3) that a body can have: its second moments ½ tr(I) 1 − I clipped from below.

    Sousa & Cortesão, Int. J. Robotics Research 33 (2014): an inertia is possible where those are positive.
    """
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    values, vectors = np.linalg.eigh((second + second.T) / 2)
    clipped = np.maximum(values, THINNEST * np.abs(values).max())
    second = (vectors * clipped) @ vectors.T
    return np.trace(second) * np.eye(3) - second


def _longest_path(tree: Tree) -> list[Joint]:
    """The movable joints from the root along the branch with most, until two branches have as many."""
    path: list[Joint] = []
    part = tree.root()
    while True:
        ways = sorted(_movable(tree, part), key=lambda joint: _depth(tree, joint), reverse=True)
        if not ways:
            return path
        if len(ways) > 1 and _depth(tree, ways[0]) == _depth(tree, ways[1]):
            if _depth(tree, ways[0]) > len(path):  # two arms; fingers have fewer joints than what carries them
                names = ", ".join(joint.name for joint in ways)
                told = f"branches into {names}; name the last link in a data sheet (tip: …, --sheet)"
                raise InputError(tree.path, f"link {part}", told)
            return path
        path.append(ways[0])
        part = ways[0].child


def _path_to(tree: Tree, tip: str) -> list[Joint]:
    if tip not in tree.parts and tip in tree.sites:
        carrier, place = tree.sites[tip]
        tree.parts[tip] = Part()
        tree.joints.append(Joint(f"{tip} fixed", "fixed", carrier, tip, place, np.eye(3)[2]))
    if tip not in tree.parts:
        raise InputError(tree.path, "tip", f"no such link: {tip!r}; there are {', '.join(tree.parts)}")
    above = {joint.child: joint for joint in tree.joints}
    path = []
    while tip in above:
        path.append(above[tip])
        tip = above[tip].parent
    return [joint for joint in reversed(path) if joint.kind != "fixed"]


def _movable(tree: Tree, part: str) -> list[Joint]:
    """Movable joints that leave a part or what is fixed to it."""
    found = []
    for joint in tree.leaving(part):
        found += _movable(tree, joint.child) if joint.kind == "fixed" else [joint]
    return found


def _depth(tree: Tree, joint: Joint) -> int:
    return 1 + max((_depth(tree, after) for after in _movable(tree, joint.child)), default=0)


def _parallelograms(tree: Tree, path: list[Joint], assumed: list[Assumed]) -> dict[str, dict[str, float]]:
    """Drives that a closed loop puts on another axis.

    A lever beside axis j, on the same carrier, moves the link behind axis j+1 through a rod: its drive's angle is
    q_j + q_{j+1}. The rod and the lever are rigid parts of what carries them, which keeps their mass.
    """
    coupling: dict[str, dict[str, float]] = {}
    for ends in tree.loops:
        side = next((found for end in ends for found in _branch(tree, path, end)), None)
        behind = next((k for k, joint in enumerate(path) if joint.child in ends), None)
        if side is None or behind is None or behind == 0 or side.parent != path[behind - 1].parent:
            assumed.append(_said(f"loop {ends[0]}–{ends[1]}", "opened", "not a parallelogram beside two axes"))
            continue
        first, second = path[behind - 1], path[behind]
        coupling[second.name] = {first.name: 1.0}
        path[behind] = replace(second, effort=side.effort or second.effort, inertia=side.inertia or second.inertia)
        tree.joints = [path[behind] if joint.name == second.name else joint for joint in tree.joints]
        text = f"driven through a parallelogram by {side.name}: its motor turns with {first.name}, too"
        assumed.append(_said(f"axis {second.name}", text, f"the loop {ends[0]}–{ends[1]} closed at zero"))
    return coupling


def _branch(tree: Tree, path: list[Joint], part: str) -> list[Joint]:
    """The first movable joint of the side branch that a part belongs to, if it does."""
    above = {joint.child: joint for joint in tree.joints}
    names, first = {joint.name for joint in path}, []
    while part in above and above[part].name not in names:
        if above[part].kind != "fixed":
            first = [above[part]]
        part = above[part].parent
    return first


def _repair_parts(tree: Tree, assumed: list[Assumed]) -> None:
    for name, part in tree.parts.items():
        mass, com, inertia = part.inertial
        if mass < 0:
            assumed.append(_repaired(f"link {name} mass", -mass, "kg", f"{mass:g} in the file"))
            mass, inertia = -mass, -inertia if np.trace(inertia) < 0 else inertia
        if mass > 0 and inertia.any():
            try:
                check_inertia(inertia_six(inertia))
            except ValueError as error:
                inertia = possible(inertia)
                assumed.append(_repaired(f"link {name} inertia", inertia_six(inertia), "kg·m²", str(error)))
        part.inertial = mass, com, inertia


def _repair_group(group: Group, number: int, assumed: list[Assumed]) -> None:
    """A link whose parts together have no inertia gets a steel ball's."""
    mass, com, inertia = group.inertial
    if not inertia.any():
        group.inertial = mass, com, ball_inertia(mass)
        text = f"zero for {group.link} in the file; that of a steel ball"
        assumed.append(_repaired(f"links[{number - 1}].inertia", inertia_six(group.inertial[2]), "kg·m²", text))


def _repaired(what: str, value: float | list[float], unit: str, why: str) -> Assumed:
    return Assumed(field=what, value=value, unit=unit, source=f"repaired: {why}", settled_by="torque log")


def _said(what: str, value: str, why: str) -> Assumed:
    return Assumed(field=what, value=value, unit="", source=f"assumed: {why}", settled_by="drawing")
