"""``twin describe``: what it keeps of a URDF or MJCF, what it assumes and says, what it reduces and repairs."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from ruamel.yaml import YAML
from scipy.linalg import eigh

import twin
from twin.errors import InputError
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.replay import inverse_dynamics
from twin.physics.motion import Motion
from twin.robot.description import load_robot, parse_robot
from twin.robot.frames import inertia_six
from twin.robot.mechanism import assemble
from twin.robot.mjcf_tree import read_mjcf
from twin.robot.reduce import possible, reduce_tree
from twin.robot.scaling import estimate
from twin.robot.tree import robot_of

DATA = Path(__file__).parent / "data"

MJCF = """
<mujoco model="leaning">
  <compiler angle="radian"/>
  <worldbody>
    <body name="foot" pos="0.1 -0.2 0.3" euler="0 0 0.4">
      <inertial pos="0 0 0.1" mass="9" diaginertia="1 1 1"/>
      <body name="a" pos="0 0.1 0.2" euler="0.3 0.2 0">
        <joint name="j1" axis="0 0.2 1" pos="0.05 0.1 0" ref="0.3" range="-2 2" armature="0.7" frictionloss="3"/>
        <inertial pos="0.1 0.02 0.05" mass="5" fullinertia="0.2 0.3 0.25 0.01 0 0.02"/>
        <geom type="box" size="0.1 0.05 0.2"/>
        <body name="b" pos="0.4 0 0" euler="1.1 0 0">
          <joint name="j2" axis="1 0 0.3" range="-1 1" damping="2"/>
          <joint name="j3" type="slide" axis="0 1 0" pos="0 0 0.1" ref="-0.1" range="-0.5 0.5"/>
          <inertial pos="0 0.2 0" mass="2" diaginertia="0.05 0.02 0.06"/>
        </body>
      </body>
    </body>
    <body name="ball"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <actuator><general joint="j1" gear="50" forcerange="-4 3" forcelimited="true"/></actuator>
</mujoco>
"""


def urdf(folder: Path, *elements: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="test">\n{"".join(elements)}</robot>')
    return path


def link(name: str, mass: float = 5.0, inertia: str = 'ixx="0.2" iyy="0.3" izz="0.25"', more: str = "") -> str:
    inertial = f'<inertial><origin xyz="0.2 0 0"/><mass value="{mass}"/><inertia {inertia}/></inertial>' if mass else ""
    return f'<link name="{name}">{inertial}{more}</link>\n'


def joint(name: str, parent: str, child: str, more: str = "", kind: str = "revolute", axis: str = "0 1 0") -> str:
    limit = "" if "<limit" in more else '<limit lower="-2" upper="2" velocity="2" effort="100"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.5 0 0.1"/><axis xyz="{axis}"/>{limit}{more}</joint>\n'
    )


ARM = link("foot", 20) + link("a") + link("b") + joint("j1", "foot", "a", axis="0 0 1") + joint("j2", "a", "b")


def sheet(folder: Path, name: str = "sheet.yaml", **values: object) -> Path:
    YAML(typ="safe", pure=True).dump(values, folder / name)
    return folder / name


def test_an_mjcf_s_chain_moves_and_weighs_as_mujoco_says(tmp_path: Path) -> None:
    """Torques of random motions equal MuJoCo's inverse dynamics: anchors, references and two joints in a body too."""
    path = tmp_path / "leaning.xml"
    path.write_text(MJCF)
    tree = read_mjcf(path)
    reduced = reduce_tree(tree)
    robot = robot_of(reduced.chain.tree)
    assert tree.notes == ["body ball floats: left out"]
    model = mujoco.MjModel.from_xml_path(str(path))
    model.dof_armature[:], model.dof_damping[:], model.dof_frictionloss[:] = 0, 0, 0
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    q, v, a = rng.uniform(-0.5, 0.5, (5, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    ours = inverse_dynamics(robot.model_copy(update={"physics": []}), Motion(np.zeros(5), q, v, a))
    for k in range(5):
        data.qpos[:3], data.qvel[:3], data.qacc[:3] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(ours[k], data.qfrc_inverse[:3], rtol=1e-4, atol=1e-4)
    axis = reduced.chain.axes[0][0]
    assert (axis.effort, axis.inertia, axis.friction, axis.position) == (200.0, 0.7, 3.0, (-2.0, 2.0))


def test_what_the_file_lacks_is_assumed_with_source_tolerance_and_the_test_that_settles_it(tmp_path: Path) -> None:
    found = twin.describe(urdf(tmp_path, ARM), out=tmp_path / "out")
    robot = load_robot(tmp_path / "out" / "robot.yaml")
    assert robot.assumed == found.assumed
    assert all(item.source.startswith("assumed: ") and item.settled_by for item in robot.assumed)
    places = ("com", "bearing")  # a factor says nothing of them
    assert all(item.tolerance or item.field.endswith((*places, "torque_gain")) for item in robot.assumed)
    fields = {item.field for item in robot.assumed}
    for field in (
        "axes[0].stiffness",
        "drives[1].gear_ratio",
        "drives[0].rotor_inertia",
        "axes[1].limits.acceleration",
    ):
        assert field in fields
    assert "axes[0].limits.torque" not in fields  # the file's effort
    assert robot.axes[0].limits is not None
    assert robot.axes[0].limits.torque == 100
    assert "settled by a hammer test" in str(found)
    modes = twin.simulate(np.zeros(2), robot=robot).modes
    assert len(modes) == 6


def test_what_a_file_may_be_off_by_goes_with_the_size_of_the_robot(tmp_path: Path) -> None:
    """With the KR90's 1 cm on a robot of half a metre, links took a half of every payload in a real log."""
    found = twin.describe(urdf(tmp_path, ARM))
    length = sum(float(np.hypot(axis.a, axis.d)) for axis in found.robot.axes)
    length += float(np.linalg.norm(found.robot.flange.position))
    assert found.robot.tolerances.com == pytest.approx(0.01 * length / 3.99, rel=0.03)
    assert found.robot.tolerances.torque_gain == 0.05
    assert found.robot.tolerances == load_robot(tmp_path / "robot.urdf").tolerances
    assert "tolerances.com" in str(found)


def test_a_sheet_wins_over_laws_and_is_not_assumed(tmp_path: Path) -> None:
    given = sheet(
        tmp_path, payload=10, mass=50, max_speed=[120, 90], max_torque=[500, 300], gear_ratio=[100, -80],
        rotor_inertia=[1e-4, 2e-4], stiffness=[2e5, 1e5], coupling={"j2": {"j1": 0.5}},
    )  # fmt: skip
    robot = twin.describe(urdf(tmp_path, ARM), sheet=given).robot
    assert robot.base.mass + sum(part.mass or 0 for part in robot.links) == pytest.approx(50)
    assert [axis.limits.velocity for axis in robot.axes if axis.limits] == pytest.approx(np.deg2rad([120, 90]))
    assert [drive.gear_ratio for drive in robot.drives] == [100, -80]
    assert robot.drives[1].coupling == {"joint1": 0.5}
    assert [axis.stiffness for axis in robot.axes] == [2e5, 1e5]
    fields = " ".join(item.field for item in robot.assumed)
    for word in ("payload", "gear_ratio", "rotor_inertia", "axes[0].stiffness", "velocity", "limits.torque"):
        assert word not in fields


def test_impossible_inertias_are_repaired_and_said(tmp_path: Path) -> None:
    path = urdf(
        tmp_path, link("foot"), link("a", 5, 'ixx="0.1" iyy="0.2" izz="0.5"'), link("b", -4), link("c", 0),
        joint("j1", "foot", "a"), joint("j2", "a", "b"), joint("j3", "b", "c"),
    )  # fmt: skip
    found = twin.describe(path)
    assert [part.mass for part in found.robot.links][:2] == [5, 4]
    said = {item.field: item.source for item in found.assumed}
    assert "triangle inequality: 0.1 + 0.2 < 0.5" in said["link a inertia"]
    assert said["link b mass"] == "repaired: -4 in the file"
    assert said["links[2].mass"].startswith("assumed: the file gives none")


@pytest.mark.parametrize("name", ["robot.xml", "robot.yaml"])
def test_what_the_twin_wrote_is_not_described_again(name: str, tmp_path: Path) -> None:
    path = urdf(tmp_path, link("foot"), link("a", 5), link("b", 4), joint("j1", "foot", "a"), joint("j2", "a", "b"))
    twin.describe(path, out=tmp_path / "out")
    with pytest.raises(InputError, match=r"as --robot"):
        twin.describe(tmp_path / "out" / name)


def test_what_was_assumed_of_a_link_is_what_is_written(tmp_path: Path) -> None:
    """The sheet's mass scales a repaired inertia, too."""
    zero = 'ixx="0" iyy="0" izz="0"'
    path = urdf(
        tmp_path, link("foot"), link("a", 5), link("b", 4, zero), joint("j1", "foot", "a"), joint("j2", "a", "b")
    )
    (tmp_path / "sheet.yaml").write_text("mass: 20\n")
    plain, found = twin.describe(path), twin.describe(path, sheet=tmp_path / "sheet.yaml")
    told = [next(i.value for i in one.assumed if i.field == "links[1].inertia") for one in (plain, found)]
    written = inertia_six(found.robot.links[1].inertial[2])
    np.testing.assert_allclose(told[1], written, rtol=1e-9)
    assert told[1][0] > 1.1 * told[0][0] > 0


def test_the_nearest_possible_inertia_is_the_inertia_itself_where_it_is_possible() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        points = rng.normal(size=(10, 3)) * [1.0, 0.6, 0.3]
        inertia = np.sum(points**2) * np.eye(3) - points.T @ points
        np.testing.assert_allclose(possible(inertia), inertia, rtol=1e-9)
        low, middle, high = np.linalg.eigvalsh(possible(inertia - np.trace(inertia) * np.diag([0.9, 0, 0])))
        assert low > 0
        assert low + middle >= high


def test_followers_side_branches_and_hands(tmp_path: Path) -> None:
    """A follower in the chain turns with its leader; fingers are welded, and their mass stays."""
    mimic = '<mimic joint="j1" multiplier="-1"/>'
    path = urdf(
        tmp_path, ARM, link("c"), link("left", 1), link("right", 1), joint("j3", "b", "c", mimic),
        joint("f1", "c", "left"), joint("f2", "c", "right", '<mimic joint="f1"/>'),
    )  # fmt: skip
    robot = twin.describe(path).robot
    assert [axis.name for axis in robot.axes] == ["j1", "j2", "j3"]
    assert robot.drives[2].coupling == {"joint1": 1.0}
    assert robot.links[2].mass == 7
    assert [item.field for item in robot.assumed if item.settled_by == "drawing" and not item.unit] == [
        "axis j3", "joint f1", "joint f2",
    ]  # fmt: skip
    named = twin.describe(path, sheet=sheet(tmp_path, tip="right")).robot
    assert [axis.name for axis in named.axes] == ["j1", "j2", "j3", "f2"]


def test_a_torso_with_two_arms_is_no_robot_of_one_axis(tmp_path: Path) -> None:
    path = urdf(
        tmp_path, link("foot"), link("torso"), joint("lift", "foot", "torso"),
        *(link(f"{side}{k}") for side in "lr" for k in (1, 2)),
        *(joint(f"{side}_{k}", "torso" if k == 1 else f"{side}1", f"{side}{k}") for side in "lr" for k in (1, 2)),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"torso: branches into l_1, r_1; name the last link in a data sheet"):
        twin.describe(path)
    named = twin.describe(path, sheet=sheet(tmp_path, tip="r2")).robot
    assert [axis.name for axis in named.axes] == ["lift", "r_1", "r_2"]


def test_limits_that_are_both_zero_are_none(tmp_path: Path) -> None:
    still = joint("j1", "foot", "a", '<limit lower="0" upper="0" effort="0" velocity="0"/>')
    robot = twin.describe(urdf(tmp_path, link("foot", 20), link("a"), still)).robot
    assert robot.axes[0].limits.position == pytest.approx((-np.pi, np.pi))
    assert "axes[0].limits.position" in [item.field for item in robot.assumed]


def test_a_file_without_links_describes_no_robot(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="link: the file has none, so it describes no robot"):
        twin.describe(urdf(tmp_path))


PARALLELOGRAM = """
<mujoco model="palletiser"><compiler angle="radian"/>
  <default><geom type="capsule" size="0.03"/></default>
  <worldbody><body name="column"><joint name="yaw" axis="0 0 1"/><geom fromto="0 0 0 0 0 0.5"/>
    <body name="arm" pos="0 0 0.5"><joint name="lift" axis="0 -1 0"/><geom fromto="0 0 0 0 0 1"/>
      <body name="forearm" pos="0 0 1"><joint name="reach" axis="0 -1 0"/><geom fromto="-0.3 0 0 1 0 0"/>
        <body name="hand" pos="1 0 0"><joint name="turn" axis="0 0 1"/><geom fromto="0 0 0 0 0 -0.1"/></body>
      </body></body>
    <body name="lever" pos="0 0 0.5"><joint name="crank" axis="0 -1 0" armature="8"/><geom fromto="0 0 0 -0.3 0 0"/>
      <body name="rod" pos="-0.3 0 0"><joint name="rod" axis="0 -1 0"/><geom fromto="0 0 0 0 0 1"/></body></body>
  </body></worldbody>
  <equality><connect body1="rod" body2="forearm" anchor="0 0 1"/></equality>
</mujoco>
"""


def test_a_parallelogram_becomes_a_coupled_drive(tmp_path: Path) -> None:
    """The crank beside the lift axis turns the forearm: its drive's angle is the sum of both."""
    path = tmp_path / "palletiser.xml"
    path.write_text(PARALLELOGRAM)
    robot = twin.describe(path).robot
    assert [axis.name for axis in robot.axes] == ["yaw", "lift", "reach", "turn"]
    assert robot.drives[2].coupling == {"joint2": 1.0}
    assert robot.drives[2].gear_ratio ** 2 * robot.drives[2].rotor_inertia == pytest.approx(8)
    total = mujoco.MjModel.from_xml_path(str(path)).body_mass.sum()
    assert sum(part.mass or 0 for part in robot.links) == pytest.approx(total)


def test_a_track_a_changer_and_a_tool_by_mesh(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.2, 0.4)).export(tmp_path / "spindle.stl")
    tool = sheet(
        tmp_path, "tool.yaml",
        tools=[
            {"name": "changer", "mass": 3.0, "com": [0, 0, 0.02], "tip": {"position": [0, 0, 0.05]}},
            {"name": "spindle", "mesh": "spindle.stl", "mass": 10.0, "position": [0, 0, 0.2],
             "tip": {"position": [0, 0, 0.3]}},
        ],
    )  # fmt: skip
    track = [{"type": "prismatic", "axis": [1, 0, 0], "mass": 300, "position": [0, 4], "velocity": 1, "torque": 900}]
    rubs = [{**track[0], "friction": 120, "damping": 40}]
    path = urdf(tmp_path, ARM)
    with pytest.warns(match="joint1: a linear axis without friction"):
        twin.describe(path, sheet=sheet(tmp_path, "still.yaml", mount=track))
    entries = twin.describe(path, sheet=sheet(tmp_path, "rubs.yaml", mount=rubs)).robot.physics
    values = {e.effect: next(iter(e.values.values())) for e in entries if e.site == "joint1"}
    assert values == {"coulomb_friction": 120, "viscous_friction": 40}
    bare = twin.describe(path).robot
    robot = twin.describe(path, sheet=sheet(tmp_path, mount=track), tool=tool, out=tmp_path / "out").robot
    assert [axis.type for axis in robot.axes] == ["prismatic", "revolute", "revolute"]
    assert robot.links[0].mass == pytest.approx(320)  # the carriage carries the robot's foot
    assert robot.axes[0].stiffness is None
    assert robot.links[2].mass == pytest.approx((bare.links[1].mass or 0) + 13)
    offset = np.array(robot.flange.position) - np.array(bare.flange.position)
    assert np.linalg.norm(offset) == pytest.approx(0.05 + 0.2 + 0.3)
    assert robot.links[2].mesh
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "robot.xml"))
    assert model.nmesh == 1


def test_a_tool_heavier_than_its_robot_is_refused(tmp_path: Path) -> None:
    tool = sheet(tmp_path, "tool.yaml", tools=[{"name": "spindle", "mass": 4000.0, "com": [0, 0, 0.1]}])
    with pytest.raises(InputError, match=r"mass: expected kg, no more than the robot's links weigh .*found 4000"):
        twin.describe(urdf(tmp_path, ARM), tool=tool)


def test_shapes_are_kept_in_the_links_frames(tmp_path: Path) -> None:
    """A sphere about a known point of a link is about that point in the file written, in the link's own frame."""
    shape = '<geometry><sphere radius="0.1"/></geometry>'
    more = f'<visual><origin xyz="0.3 0.1 0"/>{shape}</visual><collision><origin xyz="0.3 0.1 0"/>{shape}</collision>'
    path = urdf(tmp_path, ARM.replace(link("b"), link("b", more=more)))
    robot = twin.describe(path, out=tmp_path / "out").robot
    com = np.array(robot.links[1].com)  # at 0.2 0 0 in the URDF
    for file in (robot.links[1].mesh, robot.links[1].collision):
        assert file is not None
        centre = trimesh.load_mesh(file).centroid
        assert np.linalg.norm(centre - com) == pytest.approx(np.hypot(0.1, 0.1), abs=1e-6)


def test_a_law_through_points_on_a_power_gives_that_power_back() -> None:
    """The catalogue's rigidities grow as the rated torque does, and a law is never trusted closer than 20 %."""
    low, high = estimate("cycloidal_torsion", 100.0), estimate("cycloidal_torsion", 1000.0)
    assert np.log10(high.value / low.value) == pytest.approx(0.95, abs=0.1)
    assert low.within >= 1.2
    product = low.times(high)
    assert product.within == pytest.approx(np.exp(np.hypot(np.log(low.within), np.log(high.within))))


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"max_speed": [100]}, "max_speed: expected 2 values, one per axis, found 1"),
        ({"tip": "nowhere"}, "tip: no such link: 'nowhere'"),
        ({"weight": 3}, "weight: unknown field; there are name, tip, payload, payload_com"),
        ({"paylod": 3}, "paylod: unknown field: payload?"),
        ({"reach": 2200}, "it is in m"),
        ({"gears": "worm"}, "gears: input should be 'cycloidal' or 'strain_wave', found 'worm'"),
        (
            {"mount": [{"type": "prismatic", "axis": [0, 0, 0], "mass": 8}]},
            "mount[0].axis: must not be the zero",
        ),
        ({"mass": 10}, "mass: expected kg of the whole robot, more than its base's 20, found 10"),
        ({"coupling": {"j2": {"j2": 1.0}}}, "coupling.j2: expected other axes; a motor turns with j2 anyway"),
        ({"payload": "heavy"}, "payload: expected a number, found 'heavy'"),
    ],
)
def test_a_wrong_sheet_gets_one_line_and_nothing_is_written(tmp_path: Path, values: dict, line: str) -> None:
    with pytest.raises(InputError) as caught:
        twin.describe(urdf(tmp_path, ARM), sheet=sheet(tmp_path, **values), out=tmp_path / "out")
    assert line in str(caught.value)
    assert "sheet.yaml" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_track_and_a_tool_leave_the_robot_as_it_is(tmp_path: Path) -> None:
    """Payload, gears and friction of the robot's own axes are those of the robot alone."""
    path = urdf(tmp_path, ARM)
    alone = twin.describe(path).robot
    track = [{"type": "prismatic", "axis": [0, 1, 0], "mass": 800, "position": [0, 6]}]
    on_track = twin.describe(path, sheet=sheet(tmp_path, "track.yaml", mount=track)).robot
    spindle = tmp_path / "tool.yaml"
    spindle.write_text("{name: spindle, mass: 2, com: [0, 0, 0.1], tip: {position: [0, 0, 0.3]}}")
    with_tool = twin.describe(path, tool=spindle).robot
    for robot, first in ((on_track, 1), (with_tool, 0)):
        for axis, same in zip(robot.axes[first:], alone.axes, strict=True):
            assert axis.limits == same.limits
            assert (axis.stiffness, axis.damping) == (same.stiffness, same.damping)
        for drive, same_drive in zip(robot.drives[first:], alone.drives, strict=True):
            assert drive == same_drive
    payload, same_payload = (
        next(item.value for item in robot.assumed if item.field == "payload") for robot in (alone, on_track)
    )
    assert isinstance(payload, float)
    assert same_payload == pytest.approx(payload, rel=0.01)
    assert with_tool.links[-1].inertial[0] == pytest.approx(alone.links[-1].inertial[0] + 2)
    assert np.linalg.norm(np.subtract(with_tool.flange.position, alone.flange.position)) == pytest.approx(0.3)
    assert any(item.field == "spindle.inertia" for item in with_tool.assumed)
    slide = on_track.axes[0].limits
    assert slide is not None
    assert slide.acceleration is not None
    moved = 800 + sum(link.inertial[0] for link in alone.links) + 20 + payload
    assert slide.torque == pytest.approx(moved * slide.acceleration * estimate("torque_margin").value, rel=0.01)
    units = {item.field: item.unit for item in on_track.assumed}
    assert units["axes[0].limits.velocity"] == "m/s"


def test_a_sheet_in_other_units_and_a_mass_that_is_not_used_are_told(tmp_path: Path) -> None:
    path = urdf(tmp_path, ARM)
    turntable = [{"type": "revolute", "axis": [0, 0, 1], "mass": 80, "velocity": 60}]
    for values, text in (
        ({"max_speed": [2.6, 2.6]}, "is it in rad/s?"),
        ({"mass": 90, "link_masses": [5, 5]}, "mass: 90 kg is not used: link_masses and the base make 30 kg"),
        ({"mount": turntable}, "60 rad/s: is it in °/s?"),
    ):
        with pytest.warns(UserWarning, match=re.escape(text)):
            twin.describe(path, sheet=sheet(tmp_path, **values))
    heavy = sheet(tmp_path, "tool.yaml", mass=4, com=[0, 0, 0.1])
    with pytest.warns(UserWarning, match="4 kg, and the robot carries 3 kg"):
        twin.describe(path, sheet=sheet(tmp_path, payload=3), tool=heavy)


def test_a_sheet_may_be_empty_have_gaps_and_one_kind_of_gear(tmp_path: Path) -> None:
    path, empty = urdf(tmp_path, ARM), tmp_path / "empty.yaml"
    empty.write_text("")
    assert twin.describe(path, sheet=empty).robot.axis_count == 2
    robot = twin.describe(path, sheet=sheet(tmp_path, stiffness=[1e5, None], gears="cycloidal")).robot
    each = twin.describe(path, sheet=sheet(tmp_path, gears=["cycloidal", "cycloidal"])).robot
    assert (robot.axes[0].stiffness, robot.axes[1].stiffness) == (1e5, each.axes[1].stiffness)


def test_a_negative_mass_leaves_a_possible_inertia(tmp_path: Path) -> None:
    found = twin.describe(urdf(tmp_path, ARM.replace('<mass value="5.0"/>', '<mass value="-5.0"/>', 1)))
    np.testing.assert_allclose(np.trace(found.robot.links[0].inertial[2]), 0.75)
    assert "(repaired: -5 in the file)" in str(found)


def test_an_mjcf_tells_springs_and_takes_sites_and_ranges_of_control(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(
        MJCF.replace('<joint name="j2"', '<joint name="j2" stiffness="500"')
        .replace('<inertial pos="0 0.2 0"', '<site name="tcp" pos="0 0 0.4"/><inertial pos="0 0.2 0"')
        .replace("<actuator>", '<actuator><motor joint="j2" gear="50" ctrlrange="-1 1" ctrllimited="true"/>')
    )
    with_tip = twin.describe(path, sheet=sheet(tmp_path, tip="tcp"))
    assert any("its spring of 500" in note for note in with_tip.notes)
    limits = with_tip.robot.axes[1].limits
    assert limits is not None
    assert limits.torque == 50
    without = twin.describe(path).robot
    moved = np.subtract(with_tip.robot.flange.position, without.flange.position)
    assert np.linalg.norm(moved) == pytest.approx(np.hypot(0.3, 0.1))  # from the anchor of j3, at whose zero b is off


def test_the_printed_list_says_which_axes(tmp_path: Path) -> None:
    text = str(twin.describe(urdf(tmp_path, ARM), sheet=sheet(tmp_path, max_acceleration=[None, 90])))
    assert "axis1.limits.acceleration = " in text
    assert "axis1-2.stiffness = " in text
    assert "*" not in text.replace("m*", "")


def test_bearings_tilt_where_the_file_has_its_joints(tmp_path: Path) -> None:
    """Modes of a described URDF are those of MuJoCo's own reading of it, with three springs put at each joint."""
    turned = '<origin xyz="0.2 0.1 0.4" rpy="0.3 -0.2 0.5"/>'
    second = joint("j2", "a", "b", axis="0 1 0").replace('<origin xyz="0.5 0 0.1"/>', turned)
    third = joint("j3", "b", "c", axis="0.6 0 0.8").replace('<origin xyz="0.5 0 0.1"/>', turned)
    whole = 'ixx="0.2" iyy="0.3" izz="0.25" ixy="0.02" ixz="0" iyz="-0.03"'
    parts = [link(name, inertia=whole) for name in "abc"]
    path = urdf(tmp_path, link("foot", 20, whole), *parts, joint("j1", "foot", "a", axis="0 0 1"), second, third)
    k = 3e4
    data = twin.describe(path, sheet=sheet(tmp_path, stiffness=[k] * 3)).robot.model_dump(mode="json")
    data["gravity"] = [0, 0, 0]
    for entry in data["physics"]:
        if entry["effect"] == "transverse_compliance":
            entry |= {"stiffness": 2 * k, "damping": 0.0}
    for axis in data["axes"]:
        axis["damping"] = 0.0
    robot = parse_robot(data)
    assert any(abs(axis.bearing) > 0.05 for axis in robot.axes)

    spec = mujoco.MjSpec.from_file(str(path))
    for hinge in list(spec.joints):
        z = np.array(hinge.axis)
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        for name, across in (("x", x), ("y", np.cross(z, x))):
            hinge.parent.add_joint(name=hinge.name + name, axis=across, stiffness=[2 * k, 0, 0])
        hinge.stiffness = [k, 0, 0]
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, state, mass)
    expected = np.sqrt(eigh(np.diag(model.jnt_stiffness), mass, eigvals_only=True)) / (2 * np.pi)
    found = np.abs(modes(linearise(assemble(robot, np.zeros(3)))).pole) / (2 * np.pi)
    np.testing.assert_allclose(np.sort(found), expected, rtol=1e-6)
