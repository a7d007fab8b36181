"""The robot as a scene: what each body looks like, how it stands in a mode or a motion, recorded for the Rerun viewer.

The only module that imports Rerun, and only where a recording is written, read or opened.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

import mujoco
import numpy as np

from twin.errors import InputError
from twin.files import replacing
from twin.model.linear import posture_state
from twin.model.modes import Modes
from twin.robot.frames import matrix_of
from twin.robot.mechanism import Mechanism, assemble
from twin.robot.mjcf import compile_model

if TYPE_CHECKING:
    from collections.abc import Iterator

    from twin.measure.wireframe import Wireframe

SHARE_COLOURS = ((255, 243, 214), (253, 200, 130), (245, 130, 60), (215, 45, 30), (150, 0, 40))
"""sRGB of a strain energy share of 0, 25, 50, 75 and 100 %."""
SHARE_COLOUR_NAMES = ("cream", "sand", "orange", "red", "dark red")
RIGID_COLOUR = (128, 130, 134)
"""sRGB of a body that no spring carries."""

FRAMES_PER_CYCLE = 48
FRAME_RATE_HZ = 50.0
DRAWN_MOTION = 0.06
"""Largest motion drawn in a mode, as a share of the robot's length …"""
DRAWN_TURN_RAD = 0.2
"""… unless a joint would have to turn by more than this."""
_CREASE_RAD = 0.5  # facets that meet at less are shaded as one smooth surface
_VIEWS_PER_TAB = 4


@dataclass(frozen=True)
class Skin:
    """A body's surface in the body's frame: vertices (nv, 3) m, normals (nv, 3), triangles (nf, 3)."""

    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class Scene:
    """A mechanism as it is drawn.

    Attributes:
        mechanism: what is drawn.
        model: its compiled form, meshes included.
        rest: (nq,) coordinates of the commanded posture.
        bodies: (nb,) names of the bodies, parents first.
        skins: body → surface, for the bodies that have one.
        bones: body → (n, 2, 3) lines in the body's frame from its origin to the next joints or the flange.
        chain: joint origins from the foot to the flange, each a body and a point (3,) in its frame.
        length: of the chain, m.
    """

    mechanism: Mechanism
    model: mujoco.MjModel
    rest: np.ndarray
    bodies: tuple[str, ...]
    skins: dict[str, Skin]
    bones: dict[str, np.ndarray]
    chain: tuple[tuple[str, np.ndarray], ...]
    length: float

    @property
    def markers(self) -> list[tuple[str, np.ndarray]]:
        """Body and point (3,) of the joint origins, the flange, attached parts and test points."""
        parts = [(body.name, np.zeros(3)) for body in self.mechanism.bodies.values() if body.kind == "part"]
        return [*self.chain, *parts, *((point.body, point.position) for point in self.mechanism.points)]


class Poses(NamedTuple):
    """Where bodies stand: position (nt, nb, 3) m, quaternion (nt, nb, 4) w x y z, rotation (nt, nb, 3, 3)."""

    position: np.ndarray
    quaternion: np.ndarray
    rotation: np.ndarray


def stage(mechanism: Mechanism) -> Scene:
    """Compile a mechanism and lay out how its bodies are drawn."""
    model = compile_model(mechanism, instruments=False)
    rest = posture_state(model, mechanism).qpos.copy()
    last = mechanism.robot.axis_count
    flange = np.array(mechanism.robot.flange.position)
    tip = mechanism.carrier(f"link{last}", flange)
    ends = {tip: [flange - mechanism.offset(tip)]}
    chain = []
    for body in mechanism.bodies.values():
        if body.kind != "part":
            if body.kind != "motor":
                chain.append((body.name, np.zeros(3)))
            if body.parent:
                ends.setdefault(body.parent, []).append(body.position)
    chain.append((tip, ends[tip][0]))
    bones = {
        name: np.array([[np.zeros(3), end] for end in ends.get(name, []) if np.linalg.norm(end) > 1e-9])
        for name, body in mechanism.bodies.items()
        if body.kind != "motor"
    }
    scene = Scene(
        mechanism, model, rest, tuple(mechanism.bodies), _skins(mechanism, model), bones, tuple(chain), 1.0
    )  # fmt: skip
    joints = locate(scene, poses(scene, rest[None]), scene.chain)[0]
    return replace(scene, length=float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()) or 1.0)


def poses(scene: Scene, qpos: np.ndarray) -> Poses:
    """Poses of all bodies for coordinates (nt, nq), by MuJoCo's kinematics."""
    data = mujoco.MjData(scene.model)
    ids = [scene.model.body(name).id for name in scene.bodies]
    out = Poses(*(np.zeros((len(qpos), len(ids), *shape)) for shape in ((3,), (4,), (3, 3))))
    for k, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(scene.model, data)
        out.position[k], out.quaternion[k] = data.xpos[ids], data.xquat[ids]
        out.rotation[k] = data.xmat[ids].reshape(-1, 3, 3)
    return out


def locate(scene: Scene, at: Poses, points: Sequence[tuple[str, np.ndarray]]) -> np.ndarray:
    """World positions (nt, np, 3) of points given in bodies' frames."""
    index = [scene.bodies.index(body) for body, _ in points]
    local = np.array([point for _, point in points]).reshape(-1, 3)
    return at.position[:, index] + np.einsum("tpij,pj->tpi", at.rotation[:, index], local)


def modal_motion(scene: Scene, found: Modes, mode: int) -> np.ndarray:
    """Complex displacement (np, 3) of the scene's markers per unit of a mode's shape."""
    step = 1e-6
    address = [scene.model.joint(name).qposadr[0] for name in found.linear.coordinates]
    qpos = np.repeat(scene.rest[None], 4, axis=0)
    shape = found.shape[:, mode]
    for row, delta in enumerate((shape.real, -shape.real, shape.imag, -shape.imag)):
        qpos[row, address] += step * delta
    x = locate(scene, poses(scene, qpos), scene.markers)
    return ((x[0] - x[1]) + 1j * (x[2] - x[3])) / (2 * step)


class Drawn(NamedTuple):
    """How large a mode is drawn: factor on its shape, largest motion of a marker (m), the joint that deflects most."""

    amplitude: float
    motion: float
    joint: str
    deflection: float


def drawn(scene: Scene, found: Modes, mode: int) -> Drawn:
    """The amplitude that shows a mode well, by ``DRAWN_MOTION`` and ``DRAWN_TURN_RAD``."""
    shape = np.abs(found.shape[:, mode])
    largest = float(np.linalg.norm(modal_motion(scene, found, mode), axis=1).max())
    limits = [DRAWN_MOTION * scene.length / largest] if largest > 0 else []
    limits += [
        DRAWN_TURN_RAD / value
        for name, value in zip(found.linear.coordinates, shape, strict=True)
        if value > 0 and _unit(scene.mechanism, name) == "rad"
    ]
    amplitude = float(min(limits, default=1.0))
    k = int(np.argmax(shape))
    return Drawn(amplitude, amplitude * largest, found.linear.coordinates[k], float(amplitude * shape[k]))


def modal_coordinates(scene: Scene, found: Modes, mode: int, amplitude: float, phase: np.ndarray) -> np.ndarray:
    """Coordinates (nt, nq) of a mode at phases (nt,) rad: rest + amplitude·Re(shape·e^{iφ})."""
    address = [scene.model.joint(name).qposadr[0] for name in found.linear.coordinates]
    qpos = np.repeat(scene.rest[None], len(phase), axis=0)
    qpos[:, address] += amplitude * (np.exp(1j * phase)[:, None] * found.shape[:, mode]).real
    return qpos


def energy_share(scene: Scene, found: Modes, mode: int) -> dict[str, float]:
    """Each sprung body's share of a mode's strain energy: the sum over the springs that carry it."""
    share = dict(zip(found.linear.coordinates, found.share[:, mode], strict=True))
    return {
        body.name: float(sum(share.get(joint.name, 0.0) for joint in body.joints))
        for body in scene.mechanism.bodies.values()
        if any(joint.elastic for joint in body.joints)
    }


def share_colour(share: float | None) -> tuple[int, int, int]:
    """sRGB of a strain energy share 0 … 1; ``None`` for a body without springs."""
    if share is None:
        return RIGID_COLOUR
    stops = np.linspace(0, 1, len(SHARE_COLOURS))
    r, g, b = (round(float(np.interp(share, stops, channel))) for channel in zip(*SHARE_COLOURS, strict=True))
    return r, g, b


def sight(scene: Scene) -> np.ndarray:
    """Unit vector (3,) from the robot to the eye: 55° off the plane of the arm, 20° above it."""
    joints = locate(scene, poses(scene, scene.rest[None]), scene.chain)[0]
    reach = joints[-1, :2] - joints[0, :2]
    azimuth = (np.arctan2(reach[1], reach[0]) if np.linalg.norm(reach) > 0.05 * scene.length else 0.0) - np.deg2rad(55)
    elevation = np.deg2rad(20)
    return np.array([*(np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.sin(elevation)])


def mode_title(found: Modes, mode: int) -> str:
    """``mode 1 · 9.96 Hz · 1.07 %``."""
    return f"mode {mode + 1} · {found.frequency_hz[mode]:.2f} Hz · {found.damping_percent[mode]:.2f} %"


def write_modes(path: str | Path, mechanism: Mechanism, found: Modes, count: int | None = None) -> None:
    """Record the robot moving in each of its modes, one entity tree ``/mode1`` … and one view per mode.

    The bodies' colour is their springs' share of the strain energy, arrows are the test points, the phase of complex
    shapes is kept. The timeline ``cycle`` runs 1 s per cycle, whatever the frequency.

    Args:
        path: of the ``.rrd``; replaced only when all is written.
        mechanism: the robot in the posture the modes belong to.
        found: its modes.
        count: how many modes, the lowest first; all of them by default.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    scene = stage(mechanism)
    number = len(found) if count is None else min(count, len(found))
    phase = np.linspace(0, 2 * np.pi, FRAMES_PER_CYCLE + 1)
    views = []
    sizes = [drawn(scene, found, k) for k in range(number)]
    with _recording(path, f"{mechanism.robot.name} {_posture_text(mechanism)}: modes") as (stream, finish):
        for k, size in enumerate(sizes):
            root = f"/mode{k + 1}"
            share = energy_share(scene, found, k)
            _log_robot(stream, scene, root, {name: share_colour(share.get(name)) for name in scene.bodies})
            _log_marks(stream, scene, root)
            at = poses(scene, modal_coordinates(scene, found, k, size.amplitude, phase))
            _send_poses(stream, scene, root, at, rr.TimeColumn("cycle", duration=phase / (2 * np.pi)))
            flange = locate(scene, at, scene.chain[-1:])[:, 0]
            orbit = rr.LineStrips3D([flange], colors=[(90, 170, 255)], radii=-1.5)
            stream.log(f"{root}/flange_path", orbit, static=True)
            views.append(_view(scene, root, mode_title(found, k)))
        if not number:
            _log_robot(stream, scene, "/posture", dict.fromkeys(scene.bodies, RIGID_COLOUR))
            _log_marks(stream, scene, "/posture")
            still = rr.TimeColumn("cycle", duration=[0.0])
            _send_poses(stream, scene, "/posture", poses(scene, scene.rest[None]), still)
            views.append(_view(scene, "/posture", "posture"))
        text = _modes_text(scene, found, sizes)
        stream.log("/about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        about = rrb.TextDocumentView(origin="/about", name="about")
        picture = rrb.Horizontal(rrb.Tabs(*_tabs(views), active_tab=0), about, column_shares=[2, 1])
        finish(_blueprint(picture, "cycle", speed=0.5))


def write_wireframe(path: str | Path, frame: "Wireframe", titles: Sequence[str], name: str) -> None:
    """Record a structure of points and lines moving in each of its modes, as :func:`write_modes` does a robot.

    Args:
        path: of the ``.rrd``; replaced only when all is written.
        frame: the structure and its shapes.
        titles: one per mode.
        name: of the recording.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    phase = np.linspace(0, 2 * np.pi, FRAMES_PER_CYCLE + 1)
    cycle = rr.TimeColumn("cycle", duration=phase / (2 * np.pi))
    views = []
    with _recording(path, name) as (stream, finish):
        for k, title in enumerate(titles):
            root = f"/mode{k + 1}"
            stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            rest = rr.LineStrips3D(list(frame.position[frame.lines]), colors=[(110, 110, 110)], radii=-1.0)
            stream.log(f"{root}/rest", rest, static=True)
            moved = np.stack([frame.displaced(k, float(angle)) for angle in phase])
            strips = moved[:, frame.lines].reshape(-1, 2, 3)
            lengths = [len(frame.lines)] * phase.size
            stream.log(f"{root}/lines", rr.LineStrips3D.from_fields(colors=[(90, 170, 255)], radii=-1.5), static=True)
            stream.send_columns(
                f"{root}/lines", [cycle], rr.LineStrips3D.columns(strips=list(strips)).partition(lengths)
            )
            stream.log(f"{root}/points", rr.Points3D.from_fields(colors=[(255, 150, 50)], radii=-3.0), static=True)
            columns = rr.Points3D.columns(positions=moved.reshape(-1, 3)).partition([len(frame.node)] * phase.size)
            stream.send_columns(f"{root}/points", [cycle], columns)
            views.append(rrb.Spatial3DView(origin=root, name=title, background=(32, 34, 38)))
        finish(_blueprint(rrb.Tabs(*_tabs(views), active_tab=0), "cycle", speed=0.5))


def _tabs(views: Sequence[Any]) -> list[Any]:
    """Views four to a tab."""
    import rerun.blueprint as rrb

    tabs = []
    for first in range(0, len(views), _VIEWS_PER_TAB):
        some = views[first : first + _VIEWS_PER_TAB]
        name = f"modes {first + 1}–{first + len(some)}" if len(some) > 1 else str(some[0].name)
        tabs.append(rrb.Grid(*some, name=name, grid_columns=2) if len(some) > 1 else some[0])
    return tabs


def write_replay(
    path: str | Path,
    mechanism: Mechanism,
    time: np.ndarray,
    q: np.ndarray,
    deflections: Mapping[str, np.ndarray] | None = None,
    torque: Mapping[str, np.ndarray] | None = None,
    magnification: float | None = None,
) -> None:
    """Record a motion of the robot with its torque curves, on the timeline ``t``.

    Args:
        path: of the ``.rrd``; replaced only when all is written.
        mechanism: the robot in any posture.
        time: (nt,) s, increasing.
        q: (nt, n) joint positions at the gears' outputs, rad (m).
        deflections: elastic joint such as ``joint2.z`` → (nt,) deflection, rad (m); the rest are drawn rigid.
        torque: name of a curve → (nt, n) torques at the gears' outputs, N·m (N).
        magnification: factor with which deflections are drawn; by default a round number that makes them visible.

    Raises:
        ValueError: arrays that do not fit together, or a deflection the robot does not have.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    robot = mechanism.robot
    deflections, torque = dict(deflections or {}), dict(torque or {})
    time, q = np.asarray(time, float), np.asarray(q, float)
    for name, array, shape in (
        ("q", q, (len(time), robot.axis_count)),
        *((name, value, (len(time),)) for name, value in deflections.items()),
        *((name, value, (len(time), robot.axis_count)) for name, value in torque.items()),
    ):
        if np.shape(array) != shape:
            raise ValueError(f"{name}: expected an array of shape {shape}, found {np.shape(array)}")
    moving = assemble(robot, mechanism.q, brakes=mechanism.brakes, drives="free")
    for name in deflections:
        if (joint := moving.joint(name)) is None or not joint.elastic:
            raise ValueError(f"{name}: the robot has no such elastic joint")
    scene = stage(moving)
    frames = _frames(time)
    qpos = np.repeat(scene.rest[None], len(frames), axis=0)
    qpos[:, [scene.model.joint(f"motor{i + 1}").qposadr[0] for i in range(robot.axis_count)]] = q[frames]
    if magnification is None:
        magnification = _round_magnification(scene, deflections)
    for name, value in deflections.items():
        qpos[:, scene.model.joint(name).qposadr[0]] = magnification * np.asarray(value)[frames]
    at = poses(scene, qpos)
    with _recording(path, f"{robot.name}: replay") as (stream, finish):
        colours = {name: (235, 120, 40) if name.startswith("link") else RIGID_COLOUR for name in scene.bodies}
        _log_robot(stream, scene, "/robot", colours)
        _send_poses(stream, scene, "/robot", at, rr.TimeColumn("t", duration=time[frames]))
        title = f"deflections drawn ×{magnification:g}" if deflections else "rigid motion"
        largest = ", ".join(
            f"{name} {np.abs(value).max():.3g} {_unit(moving, name)}" for name, value in deflections.items()
        )
        text = f"{robot.name}: {title}{'; largest: ' if largest else ''}{largest}. Torques at the gears' outputs.\n"
        stream.log("/about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        curves = []
        for i, axis in enumerate(robot.axes):
            unit = "N" if axis.type == "prismatic" else "N·m"
            for number, (name, value) in enumerate(torque.items()):
                entity = rr.new_entity_path(["torque", f"joint{i + 1}", name])
                line = rr.SeriesLines(names=name, colors=_CURVES[number % len(_CURVES)], widths=1.5)
                stream.log(entity, line, static=True)
                columns = rr.Scalars.columns(scalars=np.asarray(value, float)[:, i])
                stream.send_columns(entity, [rr.TimeColumn("t", duration=time)], columns)
            title_of_axis = f"joint{i + 1}" + (f" ({axis.name})" if axis.name else "") + f", {unit}"
            curves.append(rrb.TimeSeriesView(origin=f"/torque/joint{i + 1}", name=title_of_axis))
        about = rrb.TextDocumentView(origin="/about", name="about")
        robot_view = _view(scene, "/robot", f"{robot.name} · {title}")
        picture = rrb.Vertical(robot_view, about, row_shares=[6, 1])
        finish(_blueprint(rrb.Horizontal(picture, rrb.Vertical(*curves)) if torque else picture, "t"))


def write_points(
    path: str | Path,
    mechanism: Mechanism,
    points: np.ndarray,
    colours: np.ndarray,
    labels: Sequence[str],
    text: str,
    strip: np.ndarray | None = None,
) -> None:
    """Record coloured points around a robot at rest.

    Args:
        path: file to write (.rrd), whole or not at all.
        mechanism: the robot in its posture.
        points: (n, 3) m, base frame; ``colours`` (n, 3) sRGB; ``labels`` n, shown where one points.
        text: Markdown beside the picture.
        strip: (m, 3) a line through the points, or ``None``.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    scene = stage(mechanism)
    with _recording(path, f"{mechanism.robot.name} map") as (stream, send_blueprint):
        _log_robot(stream, scene, "robot", dict.fromkeys(scene.bodies, RIGID_COLOUR))
        at = poses(scene, scene.rest[None])
        for k, name in enumerate(scene.bodies):
            pose = rr.Transform3D(
                translation=at.position[0, k], quaternion=rr.Quaternion(xyzw=at.quaternion[0, k][[1, 2, 3, 0]])
            )
            stream.log(f"robot/{name}", pose, static=True)
        radius = 0.006 * scene.length
        cloud = rr.Points3D(points, colors=colours, radii=radius, labels=labels, show_labels=False)
        stream.log("robot/map", cloud, static=True)
        if strip is not None:
            stream.log("robot/path", rr.LineStrips3D([strip], colors=[(170, 170, 170)], radii=-1.0), static=True)
        stream.log("text", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        content = rrb.Vertical(
            _view(scene, "robot", "map"), rrb.TextDocumentView(origin="text", name="what it shows"), row_shares=[5, 1]
        )
        send_blueprint(_blueprint(content, "t"))


def view(path: str | Path) -> str:
    """Open recordings in the Rerun viewer, or say why that cannot be.

    Args:
        path: an ``.rrd``, or a folder that holds some.

    Returns:
        One line that says what was opened, or where the recording lies and how to open it on a machine with a screen.

    Raises:
        InputError: nothing there that can be shown.
    """
    path = Path(path)
    files = sorted(path.rglob("*.rrd")) if path.is_dir() else [path]
    if not files:
        raise InputError(path, "", "no .rrd recording in this folder")
    if not files[0].is_file():
        raise InputError(path, "", "no such file")
    names = " ".join(str(file) for file in files)
    remedy = f"copy the recording to a machine with a screen and open it there: rerun {names}"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return f"no display here; {remedy}"
    with tempfile.TemporaryFile() as log:
        viewer = subprocess.Popen(
            [sys.executable, "-m", "rerun", *map(str, files)], stdout=log, stderr=log, start_new_session=True
        )
        try:
            failed = viewer.wait(timeout=3) != 0  # 0: handed to a viewer that was open already
        except subprocess.TimeoutExpired:
            failed = False
    return f"the viewer does not start here; {remedy}" if failed else f"opened {names}"


_CURVES = ((240, 240, 240), (90, 170, 255), (255, 150, 50), (120, 220, 130))


@contextmanager
def _recording(path: str | Path, name: str) -> "Iterator[tuple[Any, Any]]":
    """A recording stream whose content becomes ``path``, and the function that closes it with its blueprint.

    It is kept in memory until it is whole: the library that writes streams waits for ever on a full disk.
    """
    import rerun as rr

    stream = rr.RecordingStream("twin", recording_id=uuid4())
    kept = stream.memory_recording()
    try:
        stream.send_recording_name(name)
        yield stream, stream.send_blueprint
        with replacing(path) as aside:
            aside.write_bytes(kept.drain_as_bytes() or b"")
    finally:
        stream.disconnect()


def _log_robot(stream: Any, scene: Scene, root: str, colours: Mapping[str, tuple[int, int, int]]) -> None:
    """Everything of the robot that does not change in the bodies' frames: surfaces or bones."""
    import rerun as rr

    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    radius = 0.02 * scene.length
    for name in scene.bodies:
        entity = f"{root}/{name}"
        if (skin := scene.skins.get(name)) is not None:
            mesh = rr.Mesh3D(
                vertex_positions=skin.vertices, vertex_normals=skin.normals, triangle_indices=skin.triangles,
                albedo_factor=colours[name],
            )  # fmt: skip
            stream.log(f"{entity}/mesh", mesh, static=True)
        elif len(bones := scene.bones.get(name, np.zeros((0, 2, 3)))):
            vectors = bones[:, 1] - bones[:, 0]
            capsules = rr.Capsules3D(
                lengths=np.linalg.norm(vectors, axis=1), radii=radius, translations=bones[:, 0],
                quaternions=[rr.Quaternion(xyzw=_from_z(vector)) for vector in vectors], colors=[colours[name]],
                fill_mode="solid",
            )  # fmt: skip
            stream.log(f"{entity}/bone", capsules, static=True)
        elif scene.mechanism.bodies[name].kind == "part":
            stream.log(f"{entity}/part", rr.Points3D([[0, 0, 0]], radii=radius, colors=[colours[name]]), static=True)


def _log_marks(stream: Any, scene: Scene, root: str) -> None:
    """Test points as arrows that end where the hammer hits, and the joints' polyline at rest."""
    import rerun as rr

    for name in scene.bodies:
        points = [point for point in scene.mechanism.points if point.body == name]
        if points:
            vectors = 0.05 * scene.length * np.array([point.direction for point in points])
            accelerometers = scene.mechanism.accelerometers
            arrows = rr.Arrows3D(
                vectors=vectors, origins=np.array([point.position for point in points]) - vectors,
                radii=0.003 * scene.length, labels=[point.label for point in points], show_labels=False,
                colors=[(120, 220, 130) if point.label in accelerometers else (90, 170, 255) for point in points],
            )  # fmt: skip
            stream.log(f"{root}/{name}/test_points", arrows, static=True)
    rest = locate(scene, poses(scene, scene.rest[None]), scene.chain)[0]
    stream.log(f"{root}/posture", rr.LineStrips3D([rest], colors=[(170, 170, 170)], radii=-1.0), static=True)


def _send_poses(stream: Any, scene: Scene, root: str, at: Poses, times: Any) -> None:
    """The bodies' poses over time; where some lack a surface also the joints' polyline, which spans linear axes too."""
    import rerun as rr

    for k, name in enumerate(scene.bodies):
        columns = rr.Transform3D.columns(
            translation=at.position[:, k], quaternion=at.quaternion[:, k][:, [1, 2, 3, 0]]
        )  # fmt: skip
        stream.send_columns(f"{root}/{name}", [times], columns)
    if any(name not in scene.skins for name in scene.bones):
        entity = f"{root}/skeleton"
        stream.log(entity, rr.LineStrips3D.from_fields(colors=[(255, 255, 255)], radii=-1.0), static=True)
        strips = rr.LineStrips3D.columns(strips=list(locate(scene, at, scene.chain)))
        stream.send_columns(entity, [times], strips)


def _blueprint(content: Any, timeline: str, speed: float = 1.0) -> Any:
    """The picture alone, playing in a loop."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        content,
        rrb.TimePanel(
            timeline=timeline, play_state="playing", loop_mode="all", playback_speed=speed, state="collapsed"
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _view(scene: Scene, root: str, name: str) -> Any:
    import rerun.blueprint as rrb

    rest = locate(scene, poses(scene, scene.rest[None]), scene.markers)[0]
    centre = 0.5 * (rest.min(axis=0) + rest.max(axis=0))
    extent = float(np.linalg.norm(np.ptp(rest, axis=0))) or scene.length
    eye = rrb.EyeControls3D(position=centre + 0.95 * extent * sight(scene), look_target=centre, eye_up=(0, 0, 1))
    return rrb.Spatial3DView(origin=root, name=name, eye_controls=eye, background=(32, 34, 38))


def _modes_text(scene: Scene, found: Modes, sizes: Sequence[Drawn]) -> str:
    mechanism = scene.mechanism
    head = f"# {mechanism.robot.name}, {_posture_text(mechanism)}\n\n"
    if not sizes:
        return f"{head}This model has no elastic joint, hence no mode.\n"
    rows = "".join(
        f"| {k + 1} | {found.frequency_hz[k]:.2f} | {found.damping_percent[k]:.2f} "
        f"| {', '.join(f'{name} {share:.0%}' for name, share in found.dominant(k))} |\n"
        for k in range(len(sizes))
    )
    amplitudes = "".join(
        f"| {k + 1} | ± {1e3 * size.motion:.0f} mm "
        f"| {size.joint} ± {size.deflection:.3g} {_unit(mechanism, size.joint)} |\n"
        for k, size in enumerate(sizes)
    )
    key = ", ".join(f"{25 * k} % {name}" for k, name in enumerate(SHARE_COLOUR_NAMES))
    return (
        f"{head}| mode | Hz | damping, % | strain energy |\n|---|---|---|---|\n{rows}\n"
        f"**Amplitude.** Modes have no size of their own. Drawn are, at most, these motions of the robot and "
        f"these deflections of a joint:\n\n| mode | motion | deflection |\n|---|---|---|\n{amplitudes}\n"
        f"**Colour.** A link's colour is the share of the mode's strain energy in the springs that carry it: {key}. "
        f"Grey bodies have no spring of their own.\n\n"
        f"**Time.** One cycle per second of the timeline, whatever the frequency; damping does not act, phases do.\n\n"
        f"**Lines.** Blue arrows: test points, in the direction of the blow; green: accelerometers. "
        f"Blue line: path of the flange. Grey line: the robot at rest.\n"
    )


def _unit(mechanism: Mechanism, joint: str) -> str:
    found = mechanism.joint(joint)
    return "m" if found is not None and found.kind == "slide" else "rad"


def _posture_text(mechanism: Mechanism) -> str:
    values = zip(mechanism.robot.degrees(mechanism.q), mechanism.robot.axes, strict=True)
    return "[" + ", ".join(f"{v:.4g}{' m' if axis.type == 'prismatic' else '°'}" for v, axis in values) + "]"


def _frames(time: np.ndarray) -> np.ndarray:
    """Indices of the samples that are drawn, about ``FRAME_RATE_HZ`` of them per second."""
    wanted = np.arange(time[0], time[-1], 1 / FRAME_RATE_HZ)
    return np.unique(np.append(np.searchsorted(time, wanted), len(time) - 1))


def _round_magnification(scene: Scene, deflections: Mapping[str, np.ndarray]) -> float:
    """1, 2 or 5 × 10ⁿ, such that the largest deflection alone moves the flange by about ``DRAWN_MOTION``."""
    largest = max(
        (
            float(np.abs(value).max(initial=0.0)) * (scene.length if _unit(scene.mechanism, name) == "rad" else 1.0)
            for name, value in deflections.items()
        ),
        default=0.0,
    )
    if largest == 0:
        return 1.0
    wanted = max(1.0, DRAWN_MOTION * scene.length / largest)
    decade = 10 ** np.floor(np.log10(wanted))
    return float(decade * max(step for step in (1, 2, 5) if step <= wanted / decade * (1 + 1e-9)))


def _skins(mechanism: Mechanism, model: mujoco.MjModel) -> dict[str, Skin]:
    """Surfaces from the compiled model's arrays; a link that is split in two shares its mesh with its tip."""
    skins = {}
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[geom]
        vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]].astype(float)
        triangles = model.mesh_face[face : face + model.mesh_facenum[mesh]]
        vertices = vertices @ matrix_of(model.geom_quat[geom]).T + model.geom_pos[geom]
        name = model.body(model.geom_bodyid[geom]).name
        if f"{name}.tip" in mechanism.bodies:
            split = mechanism.splits[int(name[4:])]
            outboard = (vertices[triangles].mean(axis=1) - split.origin) @ split.normal > 0
            if outboard.any():
                skins[f"{name}.tip"] = _skin(vertices - split.origin, triangles[outboard])
            triangles = triangles[~outboard]
        if len(triangles):
            skins[name] = _skin(vertices, triangles)
    return skins


def _skin(vertices: np.ndarray, triangles: np.ndarray) -> Skin:
    """Vertices split along creases, so that edges look sharp and round surfaces smooth."""
    import trimesh

    smooth = trimesh.graph.smooth_shade(
        trimesh.Trimesh(vertices, triangles, process=False), angle=_CREASE_RAD, facet_minarea=None
    )  # fmt: skip
    return Skin(np.asarray(smooth.vertices), np.asarray(smooth.vertex_normals), np.asarray(smooth.faces))


def _from_z(vector: np.ndarray) -> np.ndarray:
    """Quaternion (x, y, z, w) that turns z into the direction of a vector."""
    unit = vector / np.linalg.norm(vector)
    if unit[2] < -1 + 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([-unit[1], unit[0], 0.0, 1.0 + unit[2]])
    return quaternion / np.linalg.norm(quaternion)
