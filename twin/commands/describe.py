"""``twin describe``: a URDF or MJCF and a data sheet in; a robot that can be simulated, fitted and diagnosed out."""

import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError, Told, tell
from twin.provenance import provenance, write_json
from twin.result import Result, written
from twin.robot.complete import complete, with_tools
from twin.robot.datasheet import assumed_of, fit_tools, read_sheet, read_tools, stand_on
from twin.robot.description import Assumed, Robot, load_robot, parse_robot, save_robot
from twin.robot.doubts import doubts
from twin.robot.mechanism import Mechanism, assemble
from twin.robot.mesh import thinned
from twin.robot.mjcf import build_spec, save_mjcf
from twin.robot.reduce import reduce_tree
from twin.robot.tree import Chain, Shape, Tree, robot_data
from twin.table import Table

SETTLED_BY = {
    "hammer test": "a hammer test: twin fit",
    "torque log": "a log along the trajectories of twin excite: twin identify",
    "data sheet": "the maker's data sheet, or the plate on the motor",
    "drawing": "a drawing of the robot",
}


@dataclass
class Described(Result):
    """What ``twin describe`` made; prints itself, and is the JSON of the command.

    Attributes:
        robot: the description.
        notes: what the file names and could not be read.
        files: what was written.
    """

    robot: Robot
    notes: list[str]
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.describe_figures"

    @property
    def assumed(self) -> list[Assumed]:
        """What nobody measured."""
        return self.robot.assumed

    @property
    def mechanism(self) -> Mechanism:
        """The robot in the middle of its limits."""
        return assemble(self.robot, middle(self.robot))

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        return {
            "robot": self.robot.name,
            "axes": [axis.name or f"joint{i}" for i, axis in enumerate(self.robot.axes, start=1)],
            "assumed": [item.model_dump() for item in self.assumed],
            "notes": self.notes,
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """What was assumed, by the test that would settle it."""
        tables = []
        for kind, test in SETTLED_BY.items():
            rows = _together([_row(item) for item in self.assumed if item.settled_by == kind])
            if rows:
                header = ("field", "value", "unit", "within", "source")
                tables.append(Table(header, rows, (3,), title=f"Assumed; settled by {test}"))
        return tables

    def __str__(self) -> str:
        robot = self.robot
        base, links = robot.base.mass, sum(link.inertial[0] for link in robot.links)
        mass = f"{base + links:.4g} kg" + (f", {base:.4g} kg of them the base" if base else "")
        lines = [f"{robot.name} · {robot.axis_count} axes · {mass} · {len(self.assumed)} numbers assumed"]
        for table in self.tables():
            lines.append(f"  {table.title}")
            for name, value, unit, within, source in table.rows:
                repaired = f"  ({source})" if source.startswith("repaired") else ""
                lines.append(f"    {name} = {value} {unit} {within}".rstrip() + repaired)
        lines += [f"  note: {note}" for note in self.notes]
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def describe(
    path: str | Path,
    *,
    sheet: str | Path | None = None,
    tool: str | Path | None = None,
    without: list[str] | None = None,
    out: str | Path | None = None,
) -> Described:
    """A robot from a drawing and a data sheet; what neither holds is assumed, and said to be.

    Args:
        path: a URDF or an MJCF.
        sheet: ``sheet.yaml``: payload, reach, masses, speeds, torques, gears, whatever is known.
        tool: ``tool.yaml``: what is on the flange.
        without: entries not to be written, ``EFFECT`` or ``EFFECT@SITE``.
        out: folder for robot.yaml, robot.xml, meshes, report and JSON; ``None`` writes nothing.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    given = read_sheet(sheet)
    tree = read_tree(path)
    stand_on(tree, given.mount, sheet or "sheet")
    if given.tip and given.tip not in {*tree.parts, *tree.sites}:
        raise InputError(sheet or "sheet", "tip", f"no such link: {given.tip!r}; there are {', '.join(tree.parts)}")
    reduced = reduce_tree(tree, given.tip)
    given.check([joint.name for joint, _ in reduced.chain.axes], sheet or "sheet")
    data = robot_data(reduced.chain)
    data["name"] = given.name or data["name"]
    robot = complete(data, reduced, given, sheet or "sheet")  # the robot alone: its drives do not depend on a tool
    if tools := read_tools(tool):
        bodies = fit_tools(reduced.chain, tools, tool or "tool")
        weight = sum(mass for mass, _, _ in bodies)
        if given.payload and weight > given.payload:
            tell(tool or "tool", "mass", f"{weight:g} kg, and the robot carries {given.payload:g} kg by its sheet")
        with_tools(data, bodies, robot_data(reduced.chain)["flange"])
        data["assumed"] += [item.model_dump() for item in assumed_of(tools)]
        robot = parse_robot(data, f"{data['name']} with its tool")
    notes = [*tree.notes]
    if any(drive.coupling for drive in robot.drives):
        notes.append("drives are coupled: a log of this robot must hold positions of motors over the gear ratio")
    found = Described(robot.without(without or []), list(dict.fromkeys(notes)))
    inputs = [Path(item) for item in (path, sheet, tool) if item is not None]
    found.origin = provenance(inputs, {"sheet": sheet, "tool": tool, "without": without or []})
    if out is not None:
        with Outputs(out, "describe") as outputs:
            _write(found, reduced.chain, outputs)
        found.robot = load_robot(Path(out) / "robot.yaml")  # which tells what it doubts
    else:
        for where, text in doubts(found.robot):
            tell(path, where, text)
    return found


def read_tree(path: str | Path) -> Tree:
    """The parts and joints of a URDF or an MJCF, told apart by their top element.

    Raises:
        InputError: the file is neither, or a robot that the twin wrote.
    """
    if Path(path).suffix.lower() in (".yaml", ".yml"):
        raise InputError(path, "", "expected a URDF or an MJCF; a robot.yaml is described already: use it as --robot")
    bodies: set[str | None] = set()
    try:
        root = ElementTree.parse(path).getroot()
        top, bodies = root.tag, {body.get("name") for body in root.iter("body")}
    except (OSError, ElementTree.ParseError, LookupError, ValueError):
        top = "robot"  # the reader of URDF says what is wrong
    if top == "mujoco" and {"motor1", "link1"} <= bodies:
        told = "written by the twin, with its motors and springs; use the robot.yaml beside it as --robot"
        raise InputError(path, "", told)
    if top == "mujoco":
        from twin.robot.mjcf_tree import read_mjcf

        return read_mjcf(path)
    if top == "robot":
        from twin.robot.urdf import read_urdf

        return read_urdf(path)
    raise InputError(path, "", f"expected a URDF (<robot>) or an MJCF (<mujoco>), found <{top}>")


def middle(robot: Robot) -> np.ndarray:
    """Joint positions (n,) half-way between the limits, rad (m)."""
    limits = [axis.limits.position if axis.limits else None for axis in robot.axes]
    return np.array([(ends[0] + ends[1]) / 2 if ends else 0.0 for ends in limits])


Row = tuple[str, str, str, str, str]  # field, value, unit, within, source


NUMBERED = re.compile(r"(?<=axis)\d+|(?<=drive)\d+|(?<=link)\d+|(?<=joint)\d+")  # of an axis, in a name
LISTED = {"axes": "axis", "drives": "drive", "links": "link"}  # lists of robot.yaml, and what one of them is called


def _together(rows: list[Row]) -> list[Row]:
    """One row for what differs by the number of its axis alone, as the stiffness of every axis."""
    kinds: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        kinds.setdefault((NUMBERED.sub("*", row[0]), row[2], row[3]), []).append(row)
    found = []
    for (name, unit, within), same in kinds.items():
        numbers = [int(match[0]) for row in same if (match := NUMBERED.search(row[0]))]
        title = name.replace("*", _ranges(numbers)) if numbers else name
        sources = "; ".join(dict.fromkeys(row[4] for row in same))
        found.append((title, ", ".join(row[1] for row in same), unit, within, sources))
    return found


def _ranges(numbers: list[int]) -> str:
    """``1-3, 6``."""
    found: list[list[int]] = []
    for number in numbers:
        if found and number == found[-1][-1] + 1:
            found[-1][1:] = [number]
        else:
            found.append([number])
    return ", ".join("-".join(map(str, ends)) for ends in found)


def _row(item: Assumed) -> Row:
    value = item.value
    if isinstance(value, list):
        text = "[" + ", ".join(f"{number:.3g}" for number in value) + "]"
    else:
        text = value if isinstance(value, str) else f"{value:.4g}"
    within = f"×/÷ {item.tolerance:g}" if item.tolerance else ""
    return _named(item.field), text, item.unit, within, item.source


def _named(field: str) -> str:
    """A place in ``robot.yaml`` as parameters are called: ``axes[0].stiffness`` is ``axis1.stiffness``."""
    return re.sub(rf"^({'|'.join(LISTED)})\[(\d+)\]", lambda at: f"{LISTED[at[1]]}{int(at[2]) + 1}", field)


def _write(found: Described, chain: Chain, name: Outputs) -> None:
    robot = found.robot
    holders = [robot.base, *robot.links]
    for holder, body, frame, group in zip(
        holders, ["base", *(f"link{i}" for i in range(1, len(holders)))],
        [np.eye(4), *chain.frames()[0][1:]], chain.groups, strict=True,
    ):  # fmt: skip
        for kind, file in (("visual", f"meshes/{body}.stl"), ("collision", f"meshes/{body}_collision.stl")):
            shapes = [(place, shape) for part, place in group.parts for shape in getattr(part, kind)]
            if shapes:
                _write_shapes(name(file), np.linalg.inv(frame), shapes)
                setattr(holder, "mesh" if kind == "visual" else kind, file)
    target = name("robot.yaml")
    save_robot(target, robot)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Told)  # told once, of the file where it ends
        found.robot = load_robot(target)
    save_mjcf(name("robot.xml"), build_spec(found.mechanism))
    name.report(found)
    path = name("describe.json")
    found.files = name.files
    write_json(path, found.data())


def _write_shapes(target: Path, into: np.ndarray, shapes: list[tuple[np.ndarray, Shape]]) -> None:
    """All surfaces of a link as one STL in the frame that ``into`` (4, 4) leads to from the root's."""
    import trimesh

    target.parent.mkdir(exist_ok=True)
    meshes = [shape.load().copy().apply_transform(into @ place @ shape.placement) for place, shape in shapes]
    whole = thinned(trimesh.util.concatenate(meshes))
    target.write_bytes(trimesh.exchange.stl.export_stl(whole))
