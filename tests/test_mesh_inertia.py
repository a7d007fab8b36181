"""Inertia from meshes against the closed forms of boxes, and rebalancing to a total mass."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from twin.errors import InputError
from twin.robot.description import Link, Robot, load_robot, save_robot
from twin.robot.frames import inertia_matrix
from twin.robot.mechanism import assemble
from twin.robot.mesh import MOST_FACES, drawn_by_mujoco
from twin.robot.mjcf import compile_model
from twin.yamlfile import write_yaml

SIZE = np.array([0.2, 0.3, 0.7])
TURN = Rotation.from_euler("ZX", [0.4, -0.9]).as_matrix()
PLACE = np.array([0.5, -0.1, 0.25])


def box(size: np.ndarray = SIZE, turned: bool = True) -> trimesh.Trimesh:
    """A box standing askew in the link's frame."""
    frame = np.eye(4)
    if turned:
        frame[:3, :3], frame[:3, 3] = TURN, PLACE
    return trimesh.creation.box(size, frame)


def box_inertia(mass: float, size: np.ndarray = SIZE) -> np.ndarray:
    squares = size**2
    return TURN @ np.diag(mass / 12 * (squares.sum() - squares)) @ TURN.T


def robot_of(folder: Path, *links: dict[str, Any], **more: Any) -> Path:
    path = folder / "robot.yaml"
    write_yaml(path, {"name": "test", "links": list(links), "axes": [{} for _ in links]} | more)
    return path


def only_link(folder: Path, **link: Any) -> Link:
    return load_robot(robot_of(folder, link)).links[0]


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae"])
def test_a_box_has_its_closed_form_inertia_in_every_format(tmp_path: Path, suffix: str) -> None:
    box().export(tmp_path / f"box.{suffix}")
    link = only_link(tmp_path, mesh=f"box.{suffix}", density=2700)
    mass = 2700 * SIZE.prod()
    assert link.mass == pytest.approx(mass, rel=1e-6)  # STL holds single precision
    np.testing.assert_allclose(link.com, PLACE, atol=1e-7)
    np.testing.assert_allclose(inertia_matrix(link.inertia), box_inertia(mass), rtol=0, atol=1e-6 * mass)


def test_a_mass_in_place_of_a_density_scales_the_same_shape(tmp_path: Path) -> None:
    box().export(tmp_path / "box.obj")
    link = only_link(tmp_path, mesh="box.obj", mass=12.5)
    assert link.mass == pytest.approx(12.5, rel=1e-12)
    np.testing.assert_allclose(inertia_matrix(link.inertia), box_inertia(12.5), atol=1e-7)


def test_mesh_scale_turns_millimetres_into_metres(tmp_path: Path) -> None:
    drawing = box()
    drawing.apply_scale(1000)
    drawing.export(tmp_path / "box.stl")
    link = only_link(tmp_path, mesh="box.stl", mesh_scale=0.001, density=1000)
    assert link.mass == pytest.approx(1000 * SIZE.prod(), rel=1e-6)
    np.testing.assert_allclose(link.com, PLACE, atol=1e-7)


def test_a_mesh_in_millimetres_without_a_scale_gets_one_line(tmp_path: Path) -> None:
    box().apply_scale(1000).export(tmp_path / "box.stl")
    with pytest.raises(InputError, match=r"links\[0\]\.mesh: box\.stl is .* m large .* mesh_scale: 0\.001"):
        only_link(tmp_path, mesh="box.stl", density=2700)


def test_a_collada_file_in_millimetres_says_so_itself(tmp_path: Path) -> None:
    drawing = box()
    drawing.apply_scale(1000)
    drawing.export(tmp_path / "box.dae")
    text = (tmp_path / "box.dae").read_text()
    (tmp_path / "box.dae").write_text(text.replace("<up_axis>", '<unit name="millimeter" meter="0.001"/><up_axis>'))
    link = only_link(tmp_path, mesh="box.dae", density=1000)
    assert link.mass == pytest.approx(1000 * SIZE.prod(), rel=1e-6)


def test_a_cavity_wound_inwards_weighs_nothing(tmp_path: Path) -> None:
    """A casting of 2 cm walls has the outer box's inertia less the inner one's."""
    inner = SIZE - 0.04
    hole = box(inner)
    hole.invert()
    trimesh.util.concatenate([box(), hole]).export(tmp_path / "casting.stl")
    link = only_link(tmp_path, mesh="casting.stl", density=7200)
    outside, inside = 7200 * SIZE.prod(), 7200 * inner.prod()
    assert link.mass == pytest.approx(outside - inside, rel=1e-5)
    expected = box_inertia(outside) - box_inertia(inside, inner)
    np.testing.assert_allclose(inertia_matrix(link.inertia), expected, atol=1e-5 * np.abs(expected).max())


def test_a_mesh_inside_out_is_turned_right(tmp_path: Path) -> None:
    drawing = box()
    drawing.invert()
    drawing.export(tmp_path / "box.stl")
    assert only_link(tmp_path, mesh="box.stl", density=1000).mass == pytest.approx(1000 * SIZE.prod(), rel=1e-6)


def test_a_mesh_without_a_volume_gets_one_line(tmp_path: Path) -> None:
    drawing = box()
    lid_off = trimesh.Trimesh(drawing.vertices, drawing.faces[2:])
    lid_off.export(tmp_path / "open.stl")
    flipped = drawing.faces.copy()
    flipped[0] = flipped[0, ::-1]
    trimesh.Trimesh(drawing.vertices, flipped, process=False).export(tmp_path / "flipped.stl")
    (tmp_path / "empty.stl").write_text("solid x\nendsolid x\n")
    for mesh, problem in (
        ("open.stl", "open.stl is not closed (watertight), so that it encloses no volume"),
        ("flipped.stl", "flipped.stl has neighbouring triangles that face opposite ways"),
        ("empty.stl", "empty.stl holds no triangles"),
    ):
        path = robot_of(tmp_path, {"mesh": mesh, "density": 1000})
        with pytest.raises(InputError) as caught:
            load_robot(path)
        assert str(caught.value) == f"{path}: links[0].mesh: {problem}"


def test_links_are_rebalanced_to_the_total_mass_the_base_stays(tmp_path: Path) -> None:
    """One factor on all links, meshed or stated, masses and inertias; density ratios are kept."""
    box().export(tmp_path / "box.obj")
    stated = {"mass": 100, "com": [0.1, 0, 0], "inertia": [2, 3, 4, 0.1, 0, 0]}
    robot = load_robot(
        robot_of(tmp_path, {"mesh": "box.obj", "density": 1000}, stated, total_mass=500, base={"mass": 80})
    )
    meshed = 1000 * SIZE.prod()
    factor = (500 - 80) / (100 + meshed)
    assert robot.base.mass == 80
    assert sum(link.mass for link in robot.links) == pytest.approx(420, rel=1e-12)
    assert robot.links[1].mass == pytest.approx(100 * factor, rel=1e-7)
    np.testing.assert_allclose(robot.links[1].inertia, factor * np.array(stated["inertia"]), rtol=1e-7)
    np.testing.assert_allclose(inertia_matrix(robot.links[0].inertia), box_inertia(meshed * factor), rtol=1e-6)
    assert robot.links[1].com == (0.1, 0, 0)


@pytest.mark.parametrize("kind", ["text", "fine", "millimetres"])
def test_meshes_that_mujoco_does_not_read_are_drawn_all_the_same(tmp_path: Path, kind: str) -> None:
    """STL in text, more triangles than MuJoCo takes, Collada in its own unit."""
    ball = trimesh.creation.icosphere(7 if kind == "fine" else 3, radius=0.3)
    mesh = tmp_path / ("ball.dae" if kind == "millimetres" else "ball.stl")
    if kind == "text":
        mesh.write_text(trimesh.exchange.stl.export_stl_ascii(ball))
    elif kind == "fine":
        assert len(ball.faces) > MOST_FACES
        ball.export(mesh)
    else:
        ball.apply_scale(1000).export(mesh)
        unit = '<unit name="millimeter" meter="0.001"/><up_axis>'
        mesh.write_text(mesh.read_text().replace("<up_axis>", unit))
    assert not drawn_by_mujoco(mesh)
    robot = load_robot(robot_of(tmp_path, {"mesh": mesh.name, "density": 2700}))
    model = compile_model(assemble(robot, np.zeros(1)))
    assert 0 < model.nmeshface <= MOST_FACES
    reach = np.linalg.norm(model.mesh_vert, axis=1)
    assert reach.max() == pytest.approx(0.3, rel=5e-3)


def test_only_meshes_that_mujoco_reads_are_taken(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a mesh")
    with pytest.raises(InputError, match=r"notes\.txt: expected an STL, OBJ or DAE file"):
        load_robot(robot_of(tmp_path, {"mesh": "notes.txt", "density": 1000}))


def test_what_is_saved_is_complete_and_not_scaled_again(tmp_path: Path) -> None:
    box().export(tmp_path / "box.obj")
    robot = load_robot(robot_of(tmp_path, {"mesh": "box.obj", "density": 1000}, total_mass=50))
    robot.links[0].mass = 60.0  # as a fit would
    save_robot(tmp_path / "fitted.yaml", robot)
    assert load_robot(tmp_path / "fitted.yaml") == robot


def test_a_total_mass_below_the_bases_gets_one_line(tmp_path: Path) -> None:
    stated = {"mass": 1, "com": [0, 0, 0], "inertia": [1, 1, 1, 0, 0, 0]}
    path = robot_of(tmp_path, stated, total_mass=70, base={"mass": 80})
    with pytest.raises(InputError, match="total_mass: must exceed the base's 80 kg, found 70 kg"):
        load_robot(path)


def test_the_kr90s_own_shapes_weigh_what_the_paper_says(tmp_path: Path) -> None:
    """Section 5 of the paper: shapes and densities, rebalanced to 1129 kg in all; every link is then complete."""
    kr90 = load_robot("kr90")
    path = robot_of(
        tmp_path, *({"mesh": f"meshes/kr90/link{i}.stl", "density": 2700} for i in (1, 2, 3)),
        total_mass=1129, base={"mass": kr90.base.mass},
    )  # fmt: skip
    robot = load_robot(path)
    assert sum(link.mass for link in robot.links) + robot.base.mass == pytest.approx(1129, rel=1e-12)
    assert all(link.com is not None and link.inertia is not None for link in robot.links)
    assert isinstance(robot, Robot)


def test_a_description_without_meshes_to_weigh_does_not_import_trimesh() -> None:
    code = (
        "import sys; from twin.robot.description import load_robot; load_robot('kr90'); print('trimesh' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
