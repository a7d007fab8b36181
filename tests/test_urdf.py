"""URDF import: frames, names, limits and friction it must find, and the lines it answers to what it cannot take."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from twin.errors import InputError
from twin.robot.description import load_robot, save_robot
from twin.robot.frames import axis_placement, matrix_of
from twin.robot.urdf import import_urdf

DATA = Path(__file__).parent / "data"
SOLID = '<inertial><mass value="5"/><inertia ixx="0.2" iyy="0.3" izz="0.25" ixy="0" ixz="0" iyz="0"/></inertial>'


def joint(
    name: str, parent: str, child: str, xyz: str = "0 0 0", rpy: str = "0 0 0", axis: str = "0 0 1",
    kind: str = "revolute", more: str = "",
) -> str:  # fmt: skip
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{more}</joint>\n'
    )


def link(name: str, inside: str = SOLID) -> str:
    return f'<link name="{name}">{inside}</link>\n'


def write(folder: Path, *elements: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="test">\n{"".join(elements)}</robot>')
    return path


def flange(robot, q: np.ndarray) -> np.ndarray:
    """The flange in the base frame, (4, 4), from the description alone."""

    def matrix(position, quaternion) -> np.ndarray:
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = matrix_of(np.array(quaternion)), position
        return frame

    frame = matrix(robot.base.position, robot.base.quaternion)
    for axis, value in zip(robot.axes, q, strict=True):
        frame = frame @ matrix(*axis_placement(axis, value))
    return frame @ matrix(robot.flange.position, robot.flange.quaternion)


def test_the_kr90s_geometry_gives_back_its_published_dh_parameters(tmp_path: Path) -> None:
    """A URDF drawn with other frames than Craig's (axis 2 about y, mid-air origins) has the axes of mjcf/kr90.yaml."""
    path = write(
        tmp_path, link("foot"), link("shoulder"), link("arm"), link("forearm"),
        joint("A1", "foot", "shoulder", xyz="0 0 0.2", kind="continuous"),
        joint("A2", "shoulder", "arm", xyz="0.35 0 0.475", axis="0 -1 0", kind="continuous"),
        joint("A3", "arm", "forearm", xyz="1.35 0.1 0", axis="0 -1 0", kind="continuous"),
    )  # fmt: skip
    robot, kr90 = import_urdf(path), load_robot("kr90")
    for ours, published in zip(robot.axes, kr90.axes, strict=True):
        for key in ("alpha_deg", "a", "theta_deg", "d"):
            assert getattr(ours, key) == pytest.approx(getattr(published, key), abs=1e-10)
    assert robot.base.position == kr90.base.position
    assert robot.base.quaternion == kr90.base.quaternion
    assert [axis.name for axis in robot.axes] == ["A1", "A2", "A3"]
    assert [part.name for part in robot.links] == ["shoulder", "arm", "forearm"]


def test_arm6_keeps_limits_masses_and_names() -> None:
    robot = import_urdf(DATA / "arm6.urdf")
    assert [axis.name for axis in robot.axes] == ["waist", "shoulder", "elbow", "roll", "bend", "twist"]
    assert [axis.limits.position for axis in robot.axes if axis.limits] == [
        None, (-1.9, 2.2), (-2.4, 2.4), (-3.0, 3.0), (-2.0, 2.0), (-6.0, 6.0),
    ]  # fmt: skip
    assert [axis.limits.velocity for axis in robot.axes if axis.limits] == [2.1, 1.8, 2.0, 3.5, 3.5, 5.0]
    # the hose and the spindle are welded to what carries them, the forearm hangs on a massless flange
    np.testing.assert_allclose([part.mass for part in robot.links], [42, 30.5, 18, 7.2, 3.1, 6.3])
    assert robot.base.mass == 60
    np.testing.assert_allclose(
        robot.base.com,
        [0.10, -0.20, 0.05] + pin.rpy.rpyToMatrix(0.02, -0.03, 0.4) @ [0.01, 0.02, 0.10], atol=1e-12,
    )  # fmt: skip


def test_linear_axes_keep_metres_and_their_friction() -> None:
    robot = import_urdf(DATA / "arm_linear.urdf")
    assert [axis.type for axis in robot.axes] == ["prismatic", "revolute", "prismatic", "prismatic", "revolute"]
    assert {(e.effect, e.site): v for e in robot.physics for v in e.values.values()} == {
        ("viscous_friction", "joint1"): 450, ("coulomb_friction", "joint1"): 120,
        ("viscous_friction", "joint2"): 30, ("coulomb_friction", "joint3"): 60,
    }  # fmt: skip


def test_an_imported_robot_survives_robot_yaml(tmp_path: Path) -> None:
    robot = load_robot(DATA / "arm6.urdf")
    save_robot(tmp_path / "arm6.yaml", robot)
    assert load_robot(tmp_path / "arm6.yaml") == robot


def test_any_chain_of_axes_puts_the_flange_where_pinocchio_does(tmp_path: Path) -> None:
    """Forward kinematics agree to 1e-9 m for 40 random chains rich in parallel, coincident and intersecting axes."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        n = rng.integers(1, 8)
        elements = [link("l0")]
        for i in range(n):
            xyz = rng.choice([0.0, 0.3, -0.2], 3) if rng.random() < 0.6 else rng.normal(0, 0.3, 3)
            rpy = rng.choice([0, np.pi / 2, -np.pi / 2, np.pi], 3) if rng.random() < 0.7 else rng.uniform(-3, 3, 3)
            axis = rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)] if rng.random() < 0.8 else rng.normal(0, 1, 3)
            words = (" ".join(repr(float(v)) for v in values) for values in (xyz, rpy, axis))
            elements += [link(f"l{i + 1}")]
            elements += [joint(f"j{i}", f"l{i}", f"l{i + 1}", *words, kind=str(rng.choice(["continuous", "prismatic"])),
                               more='<limit lower="-9" upper="9" effort="1" velocity="1"/>')]  # fmt: skip
        path = write(tmp_path, *elements)
        robot = import_urdf(path)
        reference = pin.buildModelFromUrdf(str(path))
        workspace = reference.createData()
        tip = reference.getFrameId(f"l{n}")
        for _ in range(3):
            q = rng.uniform(-2, 2, n)
            pin.framesForwardKinematics(reference, workspace, pin.integrate(reference, pin.neutral(reference), q))
            np.testing.assert_allclose(flange(robot, q), workspace.oMf[tip].homogeneous, atol=1e-9)


def test_right_angles_written_with_four_decimals_still_give_parallel_axes(tmp_path: Path) -> None:
    """1.5708 and 1.57079 are 8e-6 rad apart: taken literally, the common normal would lie tens of kilometres away."""
    path = write(
        tmp_path, link("a"), link("b"), link("c"), link("d"),
        joint("pan", "a", "b", kind="continuous"),
        joint("lift", "b", "c", "0.1 0 0", "1.5708 0 0", kind="continuous"),
        joint("lower", "c", "d", "0 0 0.2", "-1.57079 0 0", kind="continuous"),
        joint("tool", "d", "e", "0.5 0 0", kind="fixed"), link("e", ""),
    )  # fmt: skip
    robot = import_urdf(path)
    assert max(abs(value) for axis in robot.axes for value in (axis.a, axis.d)) < 0.3
    path = write(
        tmp_path, link("a"), link("b"), link("c"),
        joint("pan", "a", "b", "0.3 0 0", kind="continuous"),
        joint("tilt", "b", "c", "0.1 0.2 0", "3.14159 0 0", kind="continuous"),
    )  # fmt: skip
    assert import_urdf(path).axes[1].alpha_deg == 180
    assert max(abs(axis.d) for axis in import_urdf(path).axes) < 0.3


def test_axes_a_little_off_parallel_are_refused_with_their_angle(tmp_path: Path) -> None:
    path = write(
        tmp_path, link("a"), link("b"), link("c"),
        joint("pan", "a", "b", kind="continuous"), joint("lift", "b", "c", "0.4 0.3 0", "3.141 0 0", kind="continuous"),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"joint lift: 0\.034° from parallel to pan, .* write parallel axes with more"):
        import_urdf(path)


def test_an_inertia_written_as_zero_becomes_a_steel_balls_and_is_said_so(tmp_path: Path) -> None:
    zero = '<inertial><mass value="0.2"/><inertia ixx="0" iyy="0" izz="0"/></inertial>'
    robot = import_urdf(write(tmp_path, link("a"), link("b", zero), joint("j", "a", "b", kind="continuous")))
    radius = (0.2 / 7850 / (4 / 3 * np.pi)) ** (1 / 3)
    np.testing.assert_allclose(robot.links[0].inertia[:3], 0.4 * 0.2 * radius**2, rtol=1e-12)
    assert "inertia of b, zero in the URDF" in robot.description


TWO = link("a") + link("b")
FOUR = TWO + link("c") + link("d")
NO_TYPE = "expected revolute, continuous, prismatic or fixed, found"
PRINCIPAL = "inertia must be positive definite; its principal moments are"


def solid(old: str, new: str) -> str:
    """A chain of one axis, its moving link altered."""
    return link("a") + link("b", SOLID.replace(old, new)) + joint("j", "a", "b")


@pytest.mark.parametrize(
    ("elements", "line"),
    [
        (TWO + joint("j", "a", "b", kind="floating"), f"joint j: {NO_TYPE} 'floating'"),
        (TWO + joint("j", "a", "b", kind="planar"), f"joint j: {NO_TYPE} 'planar'"),
        (
            TWO + joint("j", "a", "b", more='<mimic joint="k"/>'),
            "joint j: follows another joint (<mimic>), which a serial chain of axes cannot hold",
        ),
        (
            TWO + link("c") + joint("j", "a", "b") + joint("k", "a", "c"),
            "link a: branches into the joints j, k; expected a serial chain",
        ),
        (  # a second movable joint behind a fixed one
            FOUR + link("e") + joint("j", "a", "b") + joint("k", "b", "c")
            + joint("f", "b", "d", kind="fixed") + joint("l", "d", "e"),
            "link b: branches into the joints k, l; expected a serial chain",
        ),
        (
            TWO + link("c") + joint("j", "a", "c") + joint("k", "b", "c"),
            "link c: is the child of two joints; expected a serial chain",
        ),
        (TWO + joint("j", "a", "b") + joint("k", "b", "a"), "expected one root link, found none (a closed loop)"),
        (TWO + link("c") + joint("j", "a", "b"), "expected one root link, found 2 (a, c)"),
        (link("a"), "has no movable joint"),
        (
            link("a") + link("b", "") + joint("j", "a", "b"),
            "link b: moves but has no <inertial> with a mass, nor has a link fixed to it",
        ),
        (solid('"5"', '"-5"'), "link b: mass must not be negative, found -5"),
        (solid("0.25", "0.75"), "link b: inertia violates the triangle inequality: 0.2 + 0.3 < 0.75 kg·m²"),
        (solid("0.25", "0"), f"link b: {PRINCIPAL} 0, 0.2, 0.3 kg·m²"),
        (solid("0.25", "nan"), "link b: izz: expected 1 finite number(s), found 'nan'"),
        (TWO + joint("j", "a", "b", xyz="0 1"), "joint j: xyz: expected 3 finite number(s), found '0 1'"),
        (
            TWO + joint("j", "a", "b", rpy="0 0 ${pi/2}"),
            "joint j: rpy: expected 3 finite number(s), found '0 0 ${pi/2}' (expand xacro first)",
        ),
        (TWO + joint("j", "a", "b", axis="0 0 0"), "joint j: axis must not be the zero vector"),
        (TWO + joint("j", "a", "c"), "joint j: no such link: 'c'"),
        (
            TWO + '<joint name="j" type="revolute"><parent link="a"/></joint>',
            "joint j: <child link=…> is missing",
        ),
        (TWO + '<joint type="revolute"/>', "joint: <joint> needs the attribute name"),
        (TWO + link("a"), "link a: appears twice"),
        (
            TWO + joint("j", "a", "b", more='<limit lower="1" upper="-1"/>'),
            "joint j: limits must increase, found lower 1 and upper -1",
        ),
        (
            TWO + joint("j", "a", "b", more='<dynamics friction="-1"/>'),
            "joint j: velocity limit, damping and friction must not be negative",
        ),
        ("<link>", "not well-formed XML: mismatched tag: line 2, column 8"),
    ],
)  # fmt: skip
def test_what_is_no_serial_chain_gets_one_line(tmp_path: Path, elements: str, line: str) -> None:
    path = write(tmp_path, elements)
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert str(caught.value) == f"{path}: {line}"


def test_other_xml_and_missing_files_get_one_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text("<mujoco/>")
    with pytest.raises(InputError, match=r"expected a URDF, whose top element is <robot>, found <mujoco>"):
        load_robot(path)
    with pytest.raises(InputError, match=r"nowhere\.urdf: cannot be read \(No such file or directory\)"):
        import_urdf(tmp_path / "nowhere.urdf")
