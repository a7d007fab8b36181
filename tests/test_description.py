"""The robot description: what is wrong gets one line that names the field; what is right survives a round trip."""

import copy
import inspect
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from twin.errors import InputError
from twin.physics import CATALOGUE
from twin.robot.description import (
    SHIPPED,
    Assumed,
    Axis,
    Base,
    Drive,
    Limits,
    Link,
    Prior,
    Robot,
    TestPoint,
    Tolerances,
    load_robot,
    parse_robot,
    save_robot,
)
from twin.robot.mechanism import assemble
from twin.yamlfile import read_yaml

MINIMAL = """
name: bench
links:
  - {mass: 10, com: [0.1, 0, 0], inertia: [0.1, 0.2, 0.2, 0, 0, 0]}
axes:
  - {stiffness: %s, limits: {position: [-1, 1]}}
"""


@pytest.fixture(scope="module")
def plain() -> dict[str, Any]:
    return read_yaml(SHIPPED / "kr90.yaml")


def changed(data: dict[str, Any], path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """A copy of plain data with one field set; ``...`` removes it."""
    data = holder = copy.deepcopy(data)
    for key in path[:-1]:
        holder = holder[key]
    if value is ...:
        del holder[path[-1]]
    else:
        holder[path[-1]] = value
    return data


def line_for(data: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        parse_robot(data, "robot.yaml")
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith("robot.yaml: ")
    return text.removeprefix("robot.yaml: ")


NAN, INF = float("nan"), float("inf")
FLAT = [1, 1, 3, 0, 0, 0]


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        # numbers
        (("links", 0, "mass"), 0, "links[0].mass: input should be greater than 0, found 0"),
        (("links", 0, "mass"), -5, "links[0].mass: input should be greater than 0, found -5"),
        (("links", 0, "mass"), "512", "links[0].mass: expected a number, found '512'"),
        (("links", 0, "mass"), True, "links[0].mass: expected a number, found True"),
        (("axes", 0, "stiffness"), NAN, "axes[0].stiffness: input should be a finite number, found nan"),
        (("axes", 0, "stiffness"), INF, "axes[0].stiffness: input should be a finite number, found inf"),
        (("axes", 0, "damping"), -1, "axes[0].damping: input should be greater than or equal to 0, found -1"),
        (("total_mass",), 0, "total_mass: input should be greater than 0, found 0"),
        (("links", 2, "com"), [0, NAN, 0], "links[2].com[1]: input should be a finite number, found nan"),
        # what no body can have
        (("links", 1, "inertia"), FLAT, "links[1]: inertia violates the triangle inequality: 1 + 1 < 3 kg·m²"),
        (
            ("links", 1, "inertia"), [1, 1, 1, 2, 0, 0],
            "links[1]: inertia must be positive definite; its principal moments are -1, 1, 3 kg·m²",
        ),
        (("base", "inertia"), FLAT, "base: inertia violates the triangle inequality: 1 + 1 < 3 kg·m²"),
        # lengths and shapes
        (("links", 1, "com"), [0, 0], "links[1].com[2]: missing"),
        (("links", 1, "com"), [0, 0, 0, 0], "links[1].com: expected at most 3, found 4"),
        (("links", 1, "com"), 0.5, "links[1].com: expected a list, found 0.5"),
        (("links", 1), 249, "links[1]: expected a mapping, found 249"),
        (("links",), [], "links: expected at least 1, found 0"),
        (("drives",), [{}], "needs one link and one drive per axis, found 3 links, 3 axes, 1 drives"),
        (("axes",), [{}], "needs one link and one drive per axis, found 3 links, 1 axes, 3 drives"),
        (("physics", 6, "coefficients"), [1, 2], "physics[6].coefficients: expected 3 numbers, found 2"),
        (("physics", 6, "coefficients"), 1, "physics[6].coefficients: expected a list of numbers, found 1"),
        # names
        (("colour",), "orange", "colour: unknown field"),
        (("axes", 1, "stifness"), 1e6, "axes[1].stifness: unknown field"),
        (("name",), ..., "name: missing"),
        (("axes", 0, "type"), "ball", "axes[0].type: input should be 'revolute' or 'prismatic', found 'ball'"),
        (
            ("links", 0, "inertia"), ...,
            "links[0]: give mass, com and inertia together, or a mesh with a density or a mass",
        ),
        (("links", 0), {"mass": 3}, "links[0]: needs mass, com and inertia, or a mesh with either a density or a mass"),
        # physics entries
        (("physics", 0, "effect"), "magic", "physics[0]: unknown effect 'magic'; see docs/robot.md"),
        (
            ("physics", 0, "effect"), "transverse_complience",
            "physics[0]: unknown effect 'transverse_complience'; did you mean transverse_compliance?",
        ),
        (
            ("physics", 0, "site"), "joint4.x",
            "physics[0]: unknown site 'joint4.x'; transverse_compliance acts at joint{i}.x, joint{i}.y (i = 1 … 3)",
        ),
        (
            ("physics", 0, "stiffnes"), 1.0,
            "physics[0].stiffnes: unknown parameter; transverse_compliance takes stiffness, damping",
        ),
        (("physics", 0, "stiffness"), ..., "physics[0]: transverse_compliance needs stiffness [N·m/rad]"),
        (
            ("physics", 0, "stiffness"), "6.1e6",
            "physics[0].stiffness: expected a finite number [N·m/rad], found '6.1e6'",
        ),
        (("physics", 0, "stiffness"), NAN, "physics[0].stiffness: expected a finite number [N·m/rad], found nan"),
        (("physics", 0, "stiffness"), -1, "physics[0].stiffness: expected a number > 0 [N·m/rad], found -1"),
        (("physics", 1, "site"), "joint1.x", "physics[1]: transverse_compliance at joint1.x appears twice"),
        (
            ("physics", 0), {"effect": "joint_coupling", "site": "joint2", "from": "elbow", "ratio": 1},
            "physics[0].from: 'elbow' is not another joint of this robot",
        ),
        (
            ("physics", 0), {"effect": "payload", "site": "flange", "mass": 1, "com": [0, 0, 0], "inertia": [1, 1, 3]},
            "physics[0].inertia: no body of positive mass can have it (triangle inequality)",
        ),
        # frames, points, limits
        (("flange", "quaternion"), [1, 1, 0, 0], "flange: quaternion must have unit length, order w x y z"),
        (
            ("test_points", 0, "body"), "link4",
            "test_points[0].body: unknown body 'link4'; bodies are base, link1 … link3",
        ),
        (("test_points", 1, "label"), "1X+", "test_points[1].label: '1X+' appears twice"),
        (
            ("test_points", 0, "direction"), [1, 1, 0],
            "test_points[0]: direction must be a unit vector, its length is 1.414",
        ),
        (("accelerometers",), ["9X+"], "accelerometers: '9X+' is not the label of a test point"),
        (
            ("axes", 0, "limits", "position"), [1, -1],
            "axes[0].limits: position limits must increase, found [1.0, -1.0]",
        ),
        (("workspace", "y"), [1, -1], "workspace: y must increase, found [1.0, -1.0]"),
        (("drives", 0, "coupling"), {"joint9": 1}, "drives[0].coupling: 'joint9' is not another joint of this robot"),
        (("priors", 0, "factor"), 1, "priors[0].factor: input should be greater than 1, found 1"),
    ],
)  # fmt: skip
def test_bad_data_gets_one_line_that_names_the_field(
    plain: dict[str, Any], path: tuple[str | int, ...], value: Any, line: str
) -> None:
    assert line_for(changed(plain, path, value)) == line


@pytest.mark.parametrize(("text", "value"), [("6.1e6", 6.1e6), ("2e-4", 2e-4), ("on", None)])
def test_numbers_are_read_as_yaml_1_2_reads_them(tmp_path: Path, text: str, value: float | None) -> None:
    """``6.1e6`` and ``2e-4`` are numbers, which common readers take for words; ``on`` is a word and no truth value."""
    path = tmp_path / "bench.yaml"
    path.write_text(MINIMAL % text)
    if value is not None:
        assert load_robot(path).axes[0].stiffness == value
        return
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert str(caught.value) == f"{path}: axes[0].stiffness: expected a number, found {text!r}"


def test_broken_and_missing_files_get_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    for text, problem in (
        ("links: [1, 2", "not valid YAML"),
        ("- a list", "expected a mapping"),
        ("a: 1\na: 2", "not valid YAML"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=problem) as caught:
            load_robot(path)
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=r"kr91: no such robot; give a robot\.yaml, a URDF or one of: .*kr90"):
        load_robot("kr91")
    path.write_text(MINIMAL % "1e6" + "base: {mesh: nowhere.stl}\n")
    with pytest.raises(InputError, match=r"mesh: nowhere\.stl not found beside the description"):
        load_robot(path)


def test_the_kr90_survives_saving_and_loading_to_the_last_bit(tmp_path: Path, kr90: Robot) -> None:
    save_robot(tmp_path / "robot.yaml", kr90)
    assert load_robot(tmp_path / "robot.yaml") == kr90
    written = read_yaml(tmp_path / "robot.yaml")
    assert set(written) == set(Robot.model_fields)  # every documented key is there, null or [] when empty
    assert str(Path.home()) not in (tmp_path / "robot.yaml").read_text()


def test_a_description_that_cannot_be_written_leaves_the_old_file_alone(tmp_path: Path, kr90: Robot) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("old")
    broken = kr90.model_copy(deep=True)
    broken.physics[0].model_extra["stiffness"] = object()
    with pytest.raises(Exception):  # noqa: B017, PT011 - whatever the writer says
        save_robot(path, broken)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_without_hides_entries_by_effect_or_by_effect_and_site(kr90: Robot) -> None:
    def entries(robot: Robot) -> list[tuple[str, str]]:
        return [(entry.effect, entry.site) for entry in robot.physics]

    assert not {effect for effect, _ in entries(kr90.without(["transverse_compliance"]))} & {"transverse_compliance"}
    one = kr90.without(["transverse_compliance@joint1.x", "gravity_compensator"])
    assert set(entries(kr90)) - set(entries(one)) == {
        ("transverse_compliance", "joint1.x"), ("gravity_compensator", "joint2"),
    }  # fmt: skip
    assert kr90.without(["backlash", "payload@flange"]) == kr90, "a valid entry that is not there is no error"
    assert len(kr90.physics) == 13, "the robot itself is left alone"
    for removal, problem in (
        ("gremlins", "unknown effect 'gremlins'; see docs/robot.md"),
        ("payload@joint7", "unknown site 'joint7'; payload acts at flange, link{i} (i = 1 … 3)"),
    ):
        with pytest.raises(InputError) as caught:
            kr90.without([removal])
        assert str(caught.value) == f"--without: {removal}: {problem}"


def test_a_posture_is_checked_for_length_and_limits(kr90: Robot) -> None:
    for q, problem in (
        ([0, 1], "posture: q_deg: expected 3 values for robot kr90, found 2"),
        ([0, np.nan, 0], "posture: q_deg: expected finite numbers"),
        ([0, 0, 0], "posture: q_deg[1]: joint2 at 0° is outside its limits 5.15662 … 139.802°"),
    ):
        with pytest.raises(InputError) as caught:
            kr90.check_posture(q)
        assert str(caught.value) == problem


def test_degrees_and_radians_but_metres_on_linear_axes() -> None:
    robot = load_robot(Path(__file__).parent / "data" / "arm_linear.urdf")
    q = robot.angles([1.5, 90, 0.2, 0.4, -45])
    np.testing.assert_allclose(q, [1.5, np.pi / 2, 0.2, 0.4, -np.pi / 4])
    np.testing.assert_allclose(robot.degrees(q), [1.5, 90, 0.2, 0.4, -45])


def test_a_description_is_plain_data(kr90: Robot) -> None:
    assert parse_robot(json.loads(json.dumps(kr90.model_dump(mode="json")))) == kr90


def test_a_link_without_length_cannot_bend() -> None:
    """Roll and bend axes of a wrist that meet in a point leave no link between them."""
    data = load_robot(Path(__file__).parent / "data" / "arm_linear.urdf").model_dump(mode="json")
    data["flange"]["position"] = [0, 0, 0]
    data["physics"] = [{"effect": "link_flexibility", "site": "link5.y", "stiffness": 1e6, "damping": 0}]
    robot = parse_robot(data)
    with pytest.raises(InputError, match=r"link_flexibility@link5\.y: link5 has no length: the next joint is in its"):
        assemble(robot, np.array([1, 0, 0, 0.4, 0]))


DOCS = Path(__file__).parents[1] / "docs" / "robot.md"


def effects_table() -> str:
    """The vocabulary as Markdown: the law from each effect's file, how it is modelled from its class."""
    lines = ["| effect | sites | parameters | law | in the model |", "|---|---|---|---|---|"]
    for effect in CATALOGUE.values():
        law, model = (
            " ".join(inspect.getdoc(thing).split("\n\n")[0].split()).replace("``", "`").replace("|", "\\|")
            for thing in (inspect.getmodule(effect), type(effect))
        )
        parameters = []
        for p in effect.parameters:
            size = {0: "", -1: "[ ]"}.get(p.length, f"[{p.length}]")
            allowed = not p.word and p.length >= 0 and (p.null > 0 or not p.positive)
            null = "" if not allowed else f"; null {'∞' if p.null == np.inf else f'{p.null:g}'}"
            parameters.append(f"`{p.name}`{size} ({p.unit}{null}{'; optional' if p.optional else ''})")
        sites = ", ".join(f"`{site}`" for site in effect.sites)
        lines.append(f"| `{effect.name}` | {sites} | {', '.join(parameters)} | {law} | {model} |")
    return "\n".join(lines)


def test_the_documented_effects_are_those_of_the_catalogue() -> None:
    documented = DOCS.read_text().split("<!-- effects -->\n")[1].split("\n<!-- /effects -->")[0]
    assert documented == effects_table(), f"put this between the marks in {DOCS.name}:\n{effects_table()}"


def test_the_documentation_names_the_effects_that_may_repeat() -> None:
    repeatable = {effect.name for effect in CATALOGUE.values() if effect.repeatable}
    sentence = re.search(r"parameters may be left out.*?\.(.*?)may stand several times", DOCS.read_text(), re.S)
    assert set(re.findall(r"`(\w+)`", sentence.group(1))) == repeatable


@pytest.mark.parametrize(
    ("heading", "model"),
    [
        ("The robot", Robot), ("`base`", Base), ("`links`", Link), ("`axes`", Axis), ("`drives`", Drive),
        ("`assumed`", Assumed), ("`test_points`", TestPoint), ("`priors`", Prior), ("`tolerances`", Tolerances),
    ],
)  # fmt: skip
def test_every_key_is_documented_and_every_documented_key_exists(heading: str, model: type[BaseModel]) -> None:
    section = DOCS.read_text().split(f"### {heading}\n")[1].split("\n#")[0]
    rows = [line.split("|")[1:4] for line in section.splitlines() if line.startswith("| `")]
    documented = {name: default.strip() for keys, _, default in rows for name in re.findall(r"`(\w+)`", keys)}
    assert set(documented) == set(model.model_fields)
    for name, field in model.model_fields.items():
        if field.is_required():
            assert documented[name] == "needed"
        elif isinstance(field.default, int | float):
            assert float(documented[name]) == field.default
    if model is Axis:
        assert all(f"`{key}`" in section for key in Limits.model_fields)


def test_the_documented_example_loads(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(DOCS.read_text().split("```yaml\n")[1].split("```")[0])
    assert len(assemble(load_robot(path), np.zeros(2)).joints) == 3
