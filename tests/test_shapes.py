"""The KR90's drawn shapes: closed solids, reproducible, in the right frames, and read alike by MuJoCo."""

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

ROOT = Path(__file__).parents[1]
SCRIPT, COMMITTED = ROOT / "tools" / "make_shapes.py", ROOT / "mjcf" / "meshes" / "kr90"
spec = spec_from_file_location("make_shapes", SCRIPT)
shapes = module_from_spec(spec)
spec.loader.exec_module(shapes)

# Lowest and highest corner (m) of the room the joint geometry leaves each body, in its frame.
ENVELOPE = {
    "base": ((-0.5, -0.45, 0.0), (0.45, 0.45, 0.45)),
    "link1": ((-0.75, -0.45, -0.3), (0.65, 0.45, 0.3)),
    "link2": ((-0.3, -0.3, 0.1), (1.6, 0.3, 0.4)),
    "link3": ((-0.7, -0.25, -0.2), (1.6151, 0.25, 0.2)),
    "motor1": ((-0.33, 0.03, -0.05), (0.0, 0.3, 0.37)),
    "motor2": ((-0.15, -0.2, -0.5), (0.15, 0.2, -0.05)),
    "motor3": ((-0.2, -0.13, -0.52), (0.15, 0.13, -0.15)),
}


def test_the_committed_files_are_what_the_command_writes(tmp_path):
    preview = tmp_path / "preview.png"
    command = [sys.executable, SCRIPT, "--out", tmp_path / "stl", "--preview", preview]
    subprocess.run(command, check=True, capture_output=True)
    assert preview.read_bytes().startswith(b"\x89PNG")
    assert {p.name for p in (tmp_path / "stl").iterdir()} == {p.name for p in COMMITTED.iterdir()}
    folders = (COMMITTED, tmp_path / "stl")
    for file in COMMITTED.iterdir():
        ours, theirs = (trimesh.load(folder / file.name, process=False) for folder in folders)
        np.testing.assert_allclose(ours.triangles, theirs.triangles, atol=1e-6)


@pytest.mark.parametrize("body", ENVELOPE)
def test_every_solid_is_closed_and_turned_outwards(body):
    for solid in shapes.BODIES[body]():
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.volume > 0
        assert solid.area_faces.min() > 1e-8


@pytest.mark.parametrize("body", ENVELOPE)
def test_a_body_fills_its_envelope_and_no_more(body):
    bounds, envelope = shapes.mesh(body).bounds, np.array(ENVELOPE[body])
    assert (bounds[0] >= envelope[0]).all()
    assert (bounds[1] <= envelope[1]).all()
    assert (np.ptp(bounds, axis=0) > 0.7 * np.ptp(envelope, axis=0)).all()


@pytest.mark.parametrize("body", ENVELOPE)
def test_mujoco_finds_the_volume_the_solids_add_up_to(body):
    xml = f"""<mujoco><asset><mesh name="m" file="{COMMITTED / body}.stl" inertia="exact"/></asset>
      <worldbody><body><freejoint/><geom type="mesh" mesh="m" density="1000"/></body></worldbody></mujoco>"""
    mass = mujoco.MjModel.from_xml_string(xml).body_mass[1]
    assert mass == pytest.approx(1000 * sum(solid.volume for solid in shapes.BODIES[body]()), rel=1e-4)


def test_the_repository_stays_small():
    assert sum(file.stat().st_size for file in COMMITTED.iterdir()) < 1e6


def test_the_foremost_face_of_link_3_is_the_flange():
    vertices = shapes.mesh("link3").vertices
    face = vertices[vertices[:, 0] > vertices[:, 0].max() - 1e-9]
    np.testing.assert_allclose(face.mean(axis=0), shapes.FLANGE, atol=1e-9)


@pytest.mark.parametrize("q_deg", shapes.POSTURES.values(), ids=shapes.POSTURES)
def test_the_flange_is_where_plane_trigonometry_puts_it(q_deg):
    arm, forearm = np.radians([q_deg[1], q_deg[1] + q_deg[2]])
    x = 0.35 + 1.35 * np.cos(arm) + 1.615 * np.cos(forearm) + 0.041 * np.sin(forearm)
    z = 0.675 + 1.35 * np.sin(arm) + 1.615 * np.sin(forearm) - 0.041 * np.cos(forearm)
    flange = shapes.placements(q_deg)["link3"] @ [*shapes.FLANGE, 1]
    np.testing.assert_allclose(flange[:3], [x, 0, z], atol=1e-12)


@pytest.mark.parametrize("q_deg", shapes.POSTURES.values(), ids=shapes.POSTURES)
def test_the_assembled_robot_stands_on_the_floor(q_deg):
    poses = shapes.placements(q_deg)
    lowest = {b: trimesh.transform_points(shapes.mesh(b).vertices, poses[b])[:, 2].min() for b in ENVELOPE}
    assert lowest.pop("base") == pytest.approx(0, abs=1e-9)
    assert min(lowest.values()) > 0.35  # all that moves clears the foot plate


def test_neighbours_meet_at_their_joint_without_a_gap():
    """Along each axis the faces at the joint meet, but for bolt heads (12 mm): nothing floats or collides."""

    def along(body, frame, radius):
        """Coordinates along the axis of `frame` near it, on the side away from the counterbalance rod."""
        poses = shapes.placements((0, 0, 0))
        into = np.linalg.inv(poses[frame]) @ poses[body]
        x, y, z = trimesh.transform_points(shapes.mesh(body).vertices, into).T
        return z[(np.hypot(x, y) < radius) & (y > 0.04)]

    for below, above, frame, radius in [
        ("base", "link1", "link1", 0.40),
        ("link1", "link2", "link2", 0.24),
        ("motor2", "link1", "link2", 0.24),
        ("link3", "link2", "link3", 0.21),
        ("motor3", "link3", "link3", 0.21),
    ]:
        gap = along(above, frame, radius).min() - along(below, frame, radius).max()
        assert abs(gap) < 0.013
