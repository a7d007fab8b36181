"""What people look at: recordings read back, and figures, against shapes, closed forms and what was put in."""

import subprocess
import sys

import numpy as np
import pytest
import rerun as rr
from PIL import Image

from twin.commands.view import view
from twin.errors import InputError
from twin.model.frf import frf
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.report import figures, movie, scene
from twin.robot.description import load_robot, parse_robot
from twin.robot.mechanism import assemble

FLANGE = ["21X+", "21Y+", "21Z+"]
SLIDER = {  # a linear axis along y of the base, then a boom of 2 m that turns about z; no meshes
    "name": "slider",
    "links": [
        {"mass": 50, "com": [0, 0, 0], "inertia": [2, 2, 2, 0, 0, 0]},
        {"mass": 20, "com": [1, 0, 0], "inertia": [0.1, 7, 7, 0, 0, 0]},
    ],
    "axes": [
        {"type": "prismatic", "alpha_deg": -90, "stiffness": 4e6, "damping": 100},
        {"alpha_deg": 90, "stiffness": 1e6, "damping": 20},
    ],
    "flange": {"position": [2, 0, 0]},
    "test_points": [{"label": "1Y+", "body": "link2", "position": [2, 0, 0], "direction": [0, 1, 0]}],
}


@pytest.fixture(autouse=True)
def strict():
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def milling():
    robot = load_robot("kr90")
    mechanism = assemble(robot, robot.angles([0, 70, -100]))
    return mechanism, modes(linearise(mechanism))


@pytest.fixture(scope="module")
def recorded(milling, tmp_path_factory):
    path = tmp_path_factory.mktemp("modes") / "modes.rrd"
    scene.write_modes(path, *milling)
    return read_back(path)


def read_back(path):
    """What a recording holds: entity → component (``Transform3D:translation``, …) → values.

    Values over time are (nt, …), with the times (nt,) in s under ``time``; static values have no ``time``.
    """
    out = {}
    for chunk in rr.chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        entity = out.setdefault(str(chunk.entity_path), {})
        for field, column in zip(batch.schema, batch.columns, strict=True):
            if field.name in chunk.timeline_names:
                if str(field.type).startswith("duration"):
                    entity.setdefault("time", []).extend(column.cast("int64").to_numpy() * 1e-9)
            elif ":" in field.name and not field.name.startswith("rerun"):
                entity.setdefault(field.name, []).extend(column.to_pylist())
    result = {}
    for name, columns in out.items():
        order = np.argsort(columns["time"], kind="stable") if "time" in columns else None
        result[name] = {}
        for key, rows in columns.items():
            if order is None:
                result[name][key] = np.array(rows[-1])
            elif key == "time":
                result[name][key] = np.array(rows)[order]
            elif len(rows) == len(order):
                values = [row[0] if isinstance(row, list) and len(row) == 1 else row for row in rows]
                result[name][key] = np.array(values)[order]
    return result


def slider():
    robot = parse_robot(SLIDER)
    mechanism = assemble(robot, robot.angles([0.3, 40]))
    return mechanism, modes(linearise(mechanism))


def world(entity, point):
    """Positions (nt, 3) of a point of a body, from its recorded translation and quaternion (x, y, z, w)."""
    q = entity["Transform3D:quaternion"].astype(float)
    v, w = q[:, :3], q[:, 3:]
    turned = 2 * np.cross(v, np.cross(v, point) + w * point) + point
    return entity["Transform3D:translation"] + turned


def test_recorded_motion_of_every_mode_is_its_complex_shape(milling, recorded):
    """The first harmonic of the recorded motion at the 23 test points is amplitude × shape, phase included."""
    mechanism, found = milling
    assert len(found) == 9
    stage = scene.stage(mechanism)
    rotation = dict(zip(stage.bodies, scene.poses(stage, stage.rest[None]).rotation[0], strict=True))
    phase = 2 * np.pi * np.arange(48) / 48
    most_complex = 0.0
    for k in range(len(found)):
        amplitude = scene.drawn(stage, found, k).amplitude
        harmonic, shape = [], []
        for point in mechanism.points:
            entity = recorded[f"/mode{k + 1}/{point.body}"]
            assert entity["time"] == pytest.approx(np.arange(49) / 48, abs=1e-6)
            x = world(entity, point.position)[:-1]
            harmonic.append(np.exp(-1j * phase) @ x * 2 / 48)  # of Re(s·e^{iφ}) it is s
            shape.append(rotation[point.body] @ found.linear.points[point.label][1] @ found.shape[:, k] * amplitude)
        size = np.linalg.norm(shape)
        assert np.linalg.norm(np.array(harmonic) - shape) < 0.01 * size  # third order in the turns
        most_complex = max(most_complex, np.linalg.norm(np.imag(shape)) / size)
    assert most_complex > 0.1  # so that a lost or mirrored phase would show


def test_links_move_in_every_mode_and_the_base_stands(recorded):
    for k in range(1, 10):
        for link in ("link2", "link3"):
            assert np.ptp(recorded[f"/mode{k}/{link}"]["Transform3D:quaternion"], axis=0).max() > 1e-3
        assert np.ptp(recorded[f"/mode{k}/base"]["Transform3D:translation"], axis=0).max() == 0


def test_meshes_are_static_and_coloured_by_energy_share(milling, recorded):
    _, found = milling
    for k in range(9):
        for i in (1, 2, 3):
            mesh = recorded[f"/mode{k + 1}/link{i}/mesh"]
            assert "time" not in mesh
            share = sum(
                s for name, s in zip(found.linear.coordinates, found.share[:, k], strict=True) if f"joint{i}." in name
            )
            rgba = int(np.ravel(mesh["Mesh3D:albedo_factor"])[0])
            assert ((rgba >> 24) & 255, (rgba >> 16) & 255, (rgba >> 8) & 255) == scene.share_colour(share)
    assert [scene.share_colour(s) for s in (0, 0.25, 0.5, 0.75, 1)] == list(scene.SHARE_COLOURS)
    text = str(recorded["/about"]["TextDocument:text"])
    for part in ("9.96", "23.82", "joint3.z 90%", "100 % dark red", "mm"):
        assert part in text
    labels = [str(s) for i in (1, 2, 3) for s in np.ravel(recorded[f"/mode1/link{i}/test_points"]["Arrows3D:labels"])]
    assert len(labels) == 23


def test_meshes_hold_the_compiled_surfaces(milling, recorded):
    """As many triangles as the STL, and vertices on the STL's own: the surface encloses the same volume."""
    import trimesh

    mechanism, _ = milling
    for i in (1, 2, 3):
        mesh = recorded[f"/mode1/link{i}/mesh"]
        drawn = trimesh.Trimesh(mesh["Mesh3D:vertex_positions"], mesh["Mesh3D:triangle_indices"])
        file = trimesh.load(mechanism.bodies[f"link{i}"].mesh)
        assert drawn.volume == pytest.approx(file.volume, rel=1e-4)
        assert drawn.bounds == pytest.approx(file.bounds, abs=1e-5)


def test_a_box_is_drawn_with_sharp_edges_and_a_ball_round():
    import trimesh

    box = trimesh.creation.box((1, 2, 3))
    skin = scene._skin(box.vertices, box.faces)
    assert len(skin.vertices) == 24  # every corner three times
    corner = skin.vertices[skin.triangles]
    facet = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    assert skin.normals[skin.triangles] == pytest.approx(np.repeat(facet[:, None], 3, axis=1))
    ball = trimesh.creation.icosphere(subdivisions=3)
    skin = scene._skin(ball.vertices, ball.faces)
    assert len(skin.vertices) == len(ball.vertices)
    assert skin.normals == pytest.approx(skin.vertices, abs=5e-3)


def test_no_drawn_turn_is_wild(milling):
    mechanism, found = milling
    stage = scene.stage(mechanism)
    for k in range(9):
        size = scene.drawn(stage, found, k)
        assert 0.01 < size.motion <= scene.DRAWN_MOTION * stage.length * (1 + 1e-9)
        assert size.deflection <= scene.DRAWN_TURN_RAD * (1 + 1e-9)


def test_a_split_link_bends_its_own_mesh(milling):
    """The two halves of a flexible link hold all triangles of the whole and lie where it lay."""
    robot = load_robot("kr90")
    entry = {"effect": "link_flexibility", "site": "link2.y", "stiffness": 4e6, "damping": 100}
    bent = parse_robot(robot.model_dump() | {"physics": [e.model_dump() for e in robot.physics] + [entry]})
    mechanism = assemble(bent, bent.angles([0, 70, -100]))
    split, whole = scene.stage(mechanism), scene.stage(milling[0])
    halves = [split.skins["link2"], split.skins["link2.tip"]]
    assert sum(len(half.triangles) for half in halves) == len(whole.skins["link2"].triangles)
    at = scene.poses(split, split.rest[None])
    corners = np.vstack(
        [
            half.vertices @ at.rotation[0, k].T + at.position[0, k]
            for half, k in zip(halves, map(split.bodies.index, ("link2", "link2.tip")), strict=True)
        ]
    )
    at, k = scene.poses(whole, whole.rest[None]), whole.bodies.index("link2")
    before = whole.skins["link2"].vertices @ at.rotation[0, k].T + at.position[0, k]
    assert corners.min(axis=0) == pytest.approx(before.min(axis=0), abs=1e-9)
    assert corners.max(axis=0) == pytest.approx(before.max(axis=0), abs=1e-9)


def test_an_attached_part_is_drawn_no_larger_than_the_rest():
    """In its own mode a 10 kg part on a soft spring moves far more than the robot; it sets the amplitude."""
    robot = load_robot("kr90")
    entry = {"effect": "attached_resonator", "site": "link3", "mass": 10, "frequency_hz": 5.0}
    entry |= {"damping_ratio": 0.02, "axis": "z", "position": [0.5, 0, 0.2]}
    loaded = parse_robot(robot.model_dump() | {"physics": [entry]})
    mechanism = assemble(loaded, loaded.angles([0, 70, -100]))
    found, stage = modes(linearise(mechanism)), scene.stage(mechanism)
    part = next(name for name in stage.bodies if "part" in name)
    qpos = scene.modal_coordinates(stage, found, 0, scene.drawn(stage, found, 0).amplitude, np.array([0, np.pi]))
    moved = scene.locate(stage, scene.poses(stage, qpos), [(part, np.zeros(3))])[:, 0]
    travel = np.linalg.norm(moved[0] - moved[1]) / 2
    assert travel == pytest.approx(scene.DRAWN_MOTION * stage.length, rel=0.02)


def test_robot_without_meshes_is_drawn_by_its_bones(tmp_path):
    mechanism, found = slider()
    scene.write_modes(tmp_path / "slider.rrd", mechanism, found)
    back = read_back(tmp_path / "slider.rrd")
    assert not any("Mesh3D:vertex_positions" in entity for entity in back.values())
    assert back["/mode1/link2/bone"]["Capsules3D:lengths"] == pytest.approx([2.0])
    for k in range(1, len(found) + 1):
        skeleton = back[f"/mode{k}/skeleton"]["LineStrips3D:strips"]
        assert np.ptp(skeleton[..., -1, :], axis=0).max() > 0.01


def test_rigid_robot_stands_still_in_its_recording(tmp_path):
    data = SLIDER | {
        "axes": [{key: v for key, v in axis.items() if key in ("type", "alpha_deg")} for axis in SLIDER["axes"]]
    }
    robot = parse_robot(data)
    mechanism = assemble(robot, robot.angles([0.3, 40]))
    scene.write_modes(tmp_path / "rigid.rrd", mechanism, modes(linearise(mechanism)))
    back = read_back(tmp_path / "rigid.rrd")
    assert "/posture/link2" in back
    assert "no mode" in str(back["/about"]["TextDocument:text"])


def test_replay_draws_the_closed_form_motion_and_the_torques_given(tmp_path):
    """Flange of slide and boom: (2 cos φ, s + 2 sin φ) with s, φ the drive's position plus the magnified deflection."""
    mechanism, _ = slider()
    time = np.arange(0, 2, 0.001)
    q = np.column_stack([0.5 * np.sin(2 * time), time])
    bend = 1e-4 * np.cos(5 * time)
    torque = np.column_stack([100 * np.sin(time), 20 * np.cos(time)])
    path = tmp_path / "replay.rrd"
    scene.write_replay(path, mechanism, time, q, {"joint2.z": bend}, {"simulated": torque}, magnification=500)
    back = read_back(path)
    boom = back["/robot/link2"]
    t = boom["time"]
    assert len(t) == 101
    phi = t + 500 * 1e-4 * np.cos(5 * t)
    expected = np.column_stack([2 * np.cos(phi), 0.5 * np.sin(2 * t) + 2 * np.sin(phi), 0 * t])
    assert world(boom, np.array([2.0, 0, 0])) == pytest.approx(expected, abs=1e-5)
    for i in (1, 2):
        curve = back[f"/torque/joint{i}/simulated"]
        assert curve["time"] == pytest.approx(time, abs=1e-8)
        assert curve["Scalars:scalars"] == pytest.approx(torque[:, i - 1])
    assert "×500" in str(back["/about"]["TextDocument:text"])


def test_replay_chooses_a_round_magnification(tmp_path):
    mechanism, _ = slider()
    time = np.linspace(0, 1, 11)
    q = np.zeros((11, 2))
    scene.write_replay(tmp_path / "a.rrd", mechanism, time, q, {"joint2.z": 1e-5 * time})
    text = str(read_back(tmp_path / "a.rrd")["/about"]["TextDocument:text"])
    drawn = float(text.split("×")[1].split(";")[0])
    assert drawn in (2000, 5000)


@pytest.mark.parametrize(
    ("q", "deflections", "torque", "name"),
    [
        (np.zeros((10, 2)), {}, {}, "q"),
        (np.zeros((11, 2)), {"joint2.z": np.zeros(10)}, {}, "joint2.z"),
        (np.zeros((11, 2)), {"joint2.x": np.zeros(11)}, {}, "joint2.x"),
        (np.zeros((11, 2)), {}, {"measured": np.zeros((11, 3))}, "measured"),
    ],
)
def test_replay_of_arrays_that_do_not_fit_writes_nothing(tmp_path, q, deflections, torque, name):
    mechanism, _ = slider()
    with pytest.raises(ValueError, match=name):
        scene.write_replay(tmp_path / "a.rrd", mechanism, np.linspace(0, 1, 11), q, deflections, torque)
    assert not list(tmp_path.iterdir())


def test_a_failing_recording_leaves_the_old_one(tmp_path, monkeypatch):
    mechanism, found = slider()
    path = tmp_path / "modes.rrd"
    path.write_bytes(b"old")

    def fail(*_):
        raise RuntimeError("disk full")

    monkeypatch.setattr(scene, "_send_poses", fail)
    with pytest.raises(RuntimeError):
        scene.write_modes(path, mechanism, found)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_view_says_in_one_line_why_it_opens_nothing(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(InputError, match=r"no \.rrd recording"):
        scene.view(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        scene.view(tmp_path / "gone.rrd")
    with pytest.raises(InputError, match="no such robot"):
        view("kr91")
    line = view("kr90", tmp_path / "kr90.rrd")
    assert line == f"wrote {tmp_path / 'kr90.rrd'}"
    assert "no display" in scene.view(tmp_path)
    assert "\n" not in scene.view(tmp_path)
    moving = read_back(tmp_path / "kr90.rrd")["/mode1/link3"]["Transform3D:translation"]
    assert np.ptp(moving, axis=0).max() > 1e-3


def test_figures_load_neither_pyplot_nor_rerun():
    code = "import sys, twin.report.figures; print(*[m in sys.modules for m in ('matplotlib.pyplot', 'rerun')])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False", "False"]


def test_frf_matrix_draws_every_pair_on_common_axes(milling, tmp_path):
    _, found = milling
    f = np.arange(4.0, 60.0, 0.25)
    H = frf(found.linear, f, FLANGE, FLANGE)
    figure = figures.frf_matrix(
        f, {"linear model": H, "hammer test": 1.1 * H}, FLANGE, FLANGE, modes_hz=found.frequency_hz[:4]
    )
    assert len(figure.axes) == 9
    for k, ax in enumerate(figure.axes):
        curves = [line for line in ax.lines if len(line.get_xdata()) == len(f)]
        assert curves[0].get_ydata() == pytest.approx(np.abs(H[:, k // 3, k % 3]))
        assert curves[1].get_ydata() == pytest.approx(1.1 * np.abs(H[:, k // 3, k % 3]))
        assert ax.get_ylim() == figure.axes[0].get_ylim()
        assert ax.get_xscale() == ax.get_yscale() == "log"
    assert figure.axes[0].get_ylabel() == "m/(s²·N)"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "linear model",
        "hammer test",
        "natural frequencies",
    ]
    figures.save(figure, tmp_path / "frf.png")
    assert (tmp_path / "frf.png").read_bytes()[:4] == b"\x89PNG"
    tall = figures.frf_matrix(f, {"model": H}, FLANGE, FLANGE, "receptance", coherence=np.ones(H.shape), phase=True)
    assert len(tall.axes) == 27


def test_mode_shapes_name_frequency_damping_and_dominant_joints(milling, tmp_path):
    """Table 7's milling column as recomputed by two codes: 9.96, 11.07, 18.72, 23.82 Hz; mode 4 is joint 3."""
    mechanism, found = milling
    figure = figures.mode_shapes(mechanism, found)
    panels = figure.axes[:4]
    titles = [ax.get_title() for ax in panels]
    for title, frequency in zip(titles, ("9.96", "11.07", "18.72", "23.82"), strict=True):
        assert f"{frequency} Hz" in title
    assert "joint3.z 90 %" in titles[3]
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in panels}) == 1
    figures.save(figure, tmp_path / "shapes.png")


def test_mode_shapes_of_a_robot_without_meshes(tmp_path):
    mechanism, found = slider()
    figure = figures.mode_shapes(mechanism, found, 5)
    assert sum("Hz" in ax.get_title() for ax in figure.axes) == len(found) == 2
    figures.save(figure, tmp_path / "slider.png")


def test_replay_states_the_residual(tmp_path):
    time = np.linspace(0, 1, 501)
    rigid = np.column_stack([100 * np.sin(7 * time), 10 * np.cos(7 * time)])
    figure = figures.replay(time, rigid + 3.0, rigid + 1.0, rigid, ["joint1", "joint2"], ["N", "N·m"])
    residual = figure.axes[1]
    assert residual.lines[0].get_ydata() == pytest.approx(-2.0)
    assert "simulated: 2 N rms" in residual.get_title(loc="right")
    assert "inverse dynamics: 3 N rms" in residual.get_title(loc="right")
    assert figure.axes[0].get_ylabel() == "joint1, N"
    simulated = figures.replay(time, None, rigid + 1.0, rigid, ["joint1", "joint2"])
    assert "simulated: 1 N·m rms" in simulated.axes[1].get_title(loc="right")
    figures.save(figures.trajectory(time, rigid, np.gradient(rigid, time, axis=0)), tmp_path / "trajectory.png")


def test_a_failing_figure_leaves_the_old_one(tmp_path, monkeypatch):
    figure = figures.trajectory(np.arange(3.0), np.zeros((3, 1)), np.zeros((3, 1)))
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def fail(*_, **__):
        raise RuntimeError("disk full")

    monkeypatch.setattr(figures.FigureCanvasAgg, "print_png", fail)
    with pytest.raises(RuntimeError):
        figures.save(figure, path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_movie_moves_and_returns_to_where_it_began(tmp_path):
    movie.write_movie(tmp_path / "modes.gif", *slider())
    with Image.open(tmp_path / "modes.gif") as found:
        assert found.n_frames == movie.FRAMES
        frames = []
        for k in range(found.n_frames):
            found.seek(k)
            frames.append(np.asarray(found.convert("L"), float))
    change = [np.abs(frame - frames[0]).sum() for frame in frames]
    half = movie.FRAMES // 2
    assert max(change) == max(change[half - 1 : half + 2])  # opposite to where it began
    np.testing.assert_allclose(change[1:half], change[:half:-1], rtol=0.05)  # there and back by the same way
