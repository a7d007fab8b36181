"""What people know of a robot beside its drawing: a data sheet of a few lines, what it stands on, and its tool."""

from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import trimesh
from pydantic import Field, ValidationError, model_validator

from twin.errors import InputError, tell
from twin.ranges import FARTHEST_M, HEAVIEST_ROTOR, ill_named
from twin.robot.bodies import Inertial, fuse
from twin.robot.description import (
    Acceleration,
    Assumed,
    Coupling,
    Damping,
    Data,
    Density,
    Inertia,
    Length,
    Mass,
    MassIfAny,
    Moment,
    Name,
    NonNegative,
    Placement,
    Position,
    Positive,
    Ratio,
    Scale,
    Speed,
    SpeedOfSheet,
    Stiffness,
    Torque,
    Vector,
    check_inertia,
    check_radius,
    first_problem,
)
from twin.robot.frames import inertia_matrix, inertia_six, matrix_of
from twin.robot.mesh_inertia import closed_mesh
from twin.robot.tree import Chain, Joint, Part, Shape, Tree, ball_inertia
from twin.yamlfile import read_yaml

Reach = Annotated[Positive, Field(ge=0.01, le=FARTHEST_M)]
RotorInertia = Annotated[Moment, Field(gt=0, le=HEAVIEST_ROTOR)]
FASTEST_TURNTABLE = 2 * np.pi  # rad/s: a turn a second is more than any that carries a robot
Gear = Literal["cycloidal", "strain_wave"]


class Mount(Data):
    """A linear track or a turntable that carries the robot: an axis before the first, and the mass that it moves.

    kg, m and N·m (N); ``position`` rad (m) and ``velocity`` rad/s (m/s). ``friction``, N·m (N), is dry, ``damping``
    viscous, N·m·s/rad (N·s/m).
    """

    type: Literal["prismatic", "revolute"]
    axis: Vector
    mass: Mass
    com: Position = (0.0, 0.0, 0.0)
    foot: Position = (0.0, 0.0, 0.0)
    position: tuple[Length, Length] | None = None
    velocity: Speed | None = None
    torque: Torque | None = None
    friction: NonNegative = 0.0
    damping: Damping = 0.0


class Sheet(Data):
    """A robot's data sheet: whatever is known, the rest is left out.

    Lists have one number, or null, per axis of the chain. kg, m, N·m (N) and °/s (m/s) as data sheets have them;
    ``gear_ratio`` and ``rotor_inertia`` (kg·m²) are the motor's; ``payload_com`` is in the flange's frame.
    ``coupling`` as ``Drive.coupling`` has it, by joint.
    """

    name: Name | None = None
    tip: str | None = None
    payload: MassIfAny | None = None
    payload_com: Position = (0.0, 0.0, 0.0)
    reach: Reach | None = None
    mass: Mass | None = None
    link_masses: list[Mass] | None = None
    max_speed: list[SpeedOfSheet | None] | None = None
    max_acceleration: list[Acceleration | None] | None = None
    max_torque: list[Torque | None] | None = None
    gear_ratio: list[Ratio | None] | None = None
    rotor_inertia: list[RotorInertia | None] | None = None
    stiffness: list[Stiffness | None] | None = None
    gears: Gear | list[Gear] | None = None
    coupling: dict[str, dict[str, Coupling]] = Field(default_factory=dict)
    mount: list[Mount] = Field(default_factory=list)

    def check(self, axes: list[str], path: str | Path) -> None:
        """Raise ``InputError`` where a list has not one number per axis, or a coupling names an axis that is not there.

        ``axes``: their names in the drawing.
        """
        for name, value in self:
            if isinstance(value, list) and name != "mount" and len(value) != len(axes):
                raise InputError(path, name, f"expected {len(axes)} values, one per axis, found {len(value)}")
        known = [*axes, *(f"joint{i + 1}" for i in range(len(axes)))]
        for name, turns in self.coupling.items():
            if strange := next((axis for axis in (name, *turns) if axis not in known), None):
                raise InputError(path, f"coupling.{name}", f"no such axis {strange!r}; there are {', '.join(known)}")
            if name in turns:
                raise InputError(path, f"coupling.{name}", f"expected other axes; a motor turns with {name} anyway")
        for k, mount in enumerate(self.mount):
            if mount.type == "revolute" and mount.velocity and mount.velocity > FASTEST_TURNTABLE:
                tell(path, f"mount[{k}].velocity", f"{mount.velocity:g} rad/s: is it in °/s?")


class Tool(Placement):
    """A tool (or a tool changer) on the flange; position and quaternion place its frame there, ``tip`` is in it.

    Mass kg, centre of mass m and inertia there kg·m², in its frame; or a closed ``mesh`` with a ``mass`` or a
    ``density`` kg/m³. Without an inertia it is that of a steel ball.
    """

    name: str = "tool"
    mass: Mass | None = None
    com: Position | None = None
    inertia: Inertia | None = None
    mesh: str | None = None
    mesh_scale: Scale = 1.0
    density: Density | None = None
    tip: Placement = Placement()

    @model_validator(mode="after")
    def _complete(self) -> "Tool":
        if wrong := ill_named(self.name):
            raise ValueError(f"name: {wrong}")
        if self.mesh is None and (self.mass is None or self.com is None):
            raise ValueError("give mass and com, or a mesh with a density or a mass")
        if self.mesh is not None and self.com is None and (self.mass is None) == (self.density is None):
            raise ValueError("needs either a density or a mass beside its mesh")
        if self.inertia is not None:
            check_inertia(self.inertia)
            if self.mass is not None:
                check_radius(self.mass, self.inertia)
        return self


class Tools(Data):
    """A ``tool.yaml`` with several pieces, each on the tip of the one before: a tool changer, then its tool."""

    tools: list[Tool] = Field(min_length=1)


def read_sheet(path: str | Path | None) -> Sheet:
    """The data sheet in a file; an empty one where there is none.

    Raises:
        InputError: one line that names file and field.
    """
    if path is None or (Path(path).is_file() and not Path(path).read_text(encoding="utf-8", errors="replace").strip()):
        return Sheet()
    return _valid(Sheet, read_yaml(path), path)


def read_tools(path: str | Path | None) -> list[Tool]:
    """The pieces on the flange, innermost first.

    Raises:
        InputError: one line that names file and field.
    """
    if path is None:
        return []
    data = read_yaml(path)
    return _valid(Tools, data, path).tools if "tools" in data else [_valid(Tool, data, path)]


def _valid(kind: type[Any], data: dict[str, Any], path: str | Path) -> Any:
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        where, message = first_problem(error)
        near = get_close_matches(where.rpartition(".")[2], kind.model_fields, 1)
        if message == "unknown field":
            message += f": {near[0]}?" if near else f"; there are {', '.join(kind.model_fields)}"
        if where == "reach" and "less than" in message:
            message += ": it is in m"
        raise InputError(path, where, message) from error


def stand_on(tree: Tree, mounts: list[Mount], path: str | Path) -> None:
    """Put the robot on its tracks and turntables, the lowest first: each is a part that moves, before the root.

    Raises:
        InputError: an axis without a direction, of the sheet at ``path``.
    """
    for k, mount in reversed(list(enumerate(mounts))):
        root, number = tree.root(), sum(name.startswith("mount") for name in tree.parts) + 1
        carriage, ground = f"mount{number}", f"mount{number} ground"
        tree.parts[carriage] = Part((mount.mass, np.array(mount.com), ball_inertia(mount.mass)))
        tree.parts[ground] = Part()
        axis = np.array(mount.axis)
        if not axis.any():
            raise InputError(path, f"mount[{k}].axis", "must not be the zero vector")
        tree.joints.append(
            Joint(
                carriage, mount.type if mount.position or mount.type == "prismatic" else "continuous", ground, carriage,
                np.eye(4), axis / np.linalg.norm(axis), mount.position, mount.velocity, mount.torque,
                mount.damping, mount.friction,
            )
        )  # fmt: skip
        foot = np.eye(4)
        foot[:3, 3] = mount.foot
        tree.joints.append(Joint(f"{carriage} foot", "fixed", carriage, root, foot, np.eye(3)[2]))


def fit_tools(chain: Chain, tools: list[Tool], path: str | Path) -> list[Inertial]:
    """Fix tools to the flange, innermost first: the last link gets their mass and shape, the flange moves to the tip.

    Returns:
        Their bodies in the frame of the last link.

    Raises:
        InputError: a mesh that cannot be read or encloses no volume, a tool heavier than all links.
    """
    last, links = chain.groups[-1], [group.inertial[0] for group in chain.groups[1:]]
    frame = chain.frames()[0][-1] if tools else np.eye(4)
    found: list[Inertial] = []
    for tool in tools:
        depth, flange = last.tip
        place = flange @ _matrix(tool)
        part = Part(_tool_inertial(tool, path))
        if tool.mesh is not None:
            part.visual = [Shape(np.eye(4), partial(_tool_shape, tool, path))]
            part.collision = part.visual
        mass, com, inertia = part.inertial
        if all(links) and mass > sum(links):
            expected = f"expected kg, no more than the robot's links weigh ({sum(links):.4g}), found {mass:.4g}"
            raise InputError(path, "mass", expected)
        rotation = place[:3, :3]
        moved = mass, place[:3, 3] + rotation @ com, rotation @ inertia @ rotation.T
        last.inertial = fuse(last.inertial, moved)
        last.parts.append((part, place))
        last.tip = depth + 1, place @ _matrix(tool.tip)
        into = frame[:3, :3].T
        found.append((moved[0], into @ (moved[1] - frame[:3, 3]), into @ moved[2] @ into.T))
    return found


def assumed_of(tools: list[Tool]) -> list[Assumed]:
    """Inertias of tools that nobody stated."""
    balls = [tool for tool in tools if tool.mass is not None and tool.com is not None and tool.inertia is None]
    return [
        Assumed(
            field=f"{tool.name}.inertia", value=inertia_six(ball_inertia(float(tool.mass or 0.0))), unit="kg·m²",
            source="assumed: that of a steel ball, the least", settled_by="drawing",
        )
        for tool in balls
    ]  # fmt: skip


def _tool_shape(tool: Tool, path: str | Path) -> trimesh.Trimesh:
    assert tool.mesh is not None
    return closed_mesh(str(Path(path).parent / tool.mesh), path, "mesh").apply_scale(tool.mesh_scale)


def _tool_inertial(tool: Tool, path: str | Path) -> Inertial:
    if tool.mass is not None and tool.com is not None:
        inertia = ball_inertia(tool.mass) if tool.inertia is None else inertia_matrix(tool.inertia)
        return tool.mass, np.array(tool.com), inertia
    shape = _tool_shape(tool, path)
    if (density := tool.density) is None:
        density = (tool.mass or 0.0) / shape.volume
    shape.density = density
    return float(shape.mass), np.array(shape.center_mass), np.array(shape.moment_inertia)


def _matrix(placement: Placement) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = matrix_of(np.array(placement.quaternion)), placement.position
    return frame
