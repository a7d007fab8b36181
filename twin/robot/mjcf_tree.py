"""MJCF read into a tree of parts and joints, by MuJoCo itself: what it compiles is what is taken."""

from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from twin.errors import InputError
from twin.robot.bodies import Inertial
from twin.robot.tree import Joint, Part, Shape, Tree, ball_inertia

BETWEEN = 1e-6  # mass of a part between two joints of one body, over the body's: chains have no massless links
# as integers: an array's element is not found in a tuple of MuJoCo's own enumerators
_FREE, _BALL, _SLIDE, _HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{kind}")) for kind in ("FREE", "BALL", "SLIDE", "HINGE")
)
_ENDLESS = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
_CLOSING = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


def read_mjcf(path: str | Path) -> Tree:
    """The bodies, joints, geoms and joint equalities of an MJCF as MuJoCo compiles them, joints at zero.

    The world is the root. A body with several joints becomes a row of parts, the last of which carries its mass.
    Bodies that float (free joints) are left out, and ``notes`` say so. An armature is kept as the rotor's inertia, a
    force range as the effort; springs and tendons are not read. Loops are the ``connect`` and ``weld`` equalities.

    Raises:
        InputError: MuJoCo refuses the file, or a ball joint.
    """
    path = Path(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        raise InputError(path, "", f"MuJoCo cannot read it: {str(error).splitlines()[0]}") from error
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        if model.jnt_type[joint] in (_HINGE, _SLIDE):
            data.qpos[model.jnt_qposadr[joint]] = 0.0
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    tree = Tree(path, Path(str(model.names[: model.names.index(b"\0")], "utf-8")).name or path.stem, {}, [])
    frames = {0: np.eye(4)}
    for body in range(model.nbody):
        _add_body(tree, model, data, body, frames)
    _add_equalities(tree, model)
    _add_sites(tree, model, data, frames)
    return tree


def _add_sites(tree: Tree, model: mujoco.MjModel, data: mujoco.MjData, frames: dict[int, np.ndarray]) -> None:
    """Places that a sheet may name as the tip."""
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), model.site(site).name
        if name and body in frames:
            pose = np.linalg.inv(frames[body]) @ _pose(data.site_xpos[site], data.site_xmat[site])
            tree.sites[name] = _body_name(model, body), pose


def _add_body(tree: Tree, model: mujoco.MjModel, data: mujoco.MjData, body: int, frames: dict[int, np.ndarray]) -> None:
    """The parts and joints of one body; ``frames`` holds where the last part of every body stands, (4, 4)."""
    name, before = _body_name(model, body), int(model.body_parentid[body])
    if before not in frames:
        return  # its parent floats
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    kinds = [model.jnt_type[joint] for joint in joints]
    if _FREE in kinds:
        tree.notes.append(f"body {name} floats: left out")
        return
    if _BALL in kinds:
        raise InputError(tree.path, f"body {name}", "expected hinge and slide joints, found a ball joint")
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
    parent, placed = _body_name(model, before), frames[before]
    for joint in joints:
        frame = frame.copy()
        frame[:3, 3] = data.xanchor[joint]
        child = name if joint == joints[-1] else f"{name}.{_joint_name(model, joint)}"
        tree.parts[child] = _between(float(model.body_mass[body]))
        tree.joints.append(_joint(tree, model, data, joint, parent, child, np.linalg.inv(placed) @ frame))
        parent, placed = child, frame
    if not joints and body > 0:
        weld = np.linalg.inv(placed) @ frame
        tree.joints.append(Joint(f"{name} fixed", "fixed", parent, name, weld, np.array([0.0, 0.0, 1.0])))
    visual, collision = _shapes(model, body, np.linalg.inv(frame) @ _pose(data.xpos[body], data.xmat[body]))
    tree.parts[name] = Part(_inertial(model, data, body, frame), visual, collision)
    frames[body] = frame


def _between(mass: float) -> Part:
    """The part between two joints of one body: a millionth of its mass."""
    return Part((BETWEEN * mass, np.zeros(3), ball_inertia(BETWEEN * mass)))


def _effort(model: mujoco.MjModel, k: int) -> float | None:
    """Largest force of an actuator at its joint, N·m (N), by its range of force or, of a motor, of control."""
    gear, found = abs(float(model.actuator_gear[k, 0])), []
    if model.actuator_forcelimited[k]:
        found.append(float(np.abs(model.actuator_forcerange[k]).max()))
    fixed = model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    if fixed and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE and model.actuator_ctrllimited[k]:
        found.append(abs(float(model.actuator_gainprm[k, 0])) * float(np.abs(model.actuator_ctrlrange[k]).max()))
    return gear * min(found) if found else None


def _joint(
    tree: Tree, model: mujoco.MjModel, data: mujoco.MjData, joint: int, parent: str, child: str, placement: np.ndarray
) -> Joint:
    dof, body = model.jnt_dofadr[joint], model.jnt_bodyid[joint]
    slide = model.jnt_type[joint] == _SLIDE
    limited = bool(model.jnt_limited[joint])
    drives = (k for k in range(model.nu) if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT)
    efforts = [effort for k in drives if model.actuator_trnid[k, 0] == joint and (effort := _effort(model, k))]
    if stiffness := float(np.ravel(model.jnt_stiffness[joint])[0]):
        unit = "N/m" if slide else "N·m/rad"
        tree.notes.append(
            f"joint {_joint_name(model, joint)}: its spring of {stiffness:g} {unit} is left out; add "
            "`cable_stiffness` if the robot has it"
        )
    if model.jnt_actfrclimited[joint]:
        efforts.append(float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return Joint(
        _joint_name(model, joint),
        "prismatic" if slide else "revolute" if limited else "continuous",
        parent, child, placement,
        data.xmat[body].reshape(3, 3).T @ data.xaxis[joint],
        position=(float(model.jnt_range[joint][0]), float(model.jnt_range[joint][1])) if limited else None,
        effort=min(efforts, default=None),
        damping=float(np.ravel(model.dof_damping[dof])[0]),
        friction=float(model.dof_frictionloss[dof]),
        inertia=float(model.dof_armature[dof]),
    )  # fmt: skip


def _inertial(model: mujoco.MjModel, data: mujoco.MjData, body: int, frame: np.ndarray) -> Inertial:
    rotation = frame[:3, :3].T @ data.ximat[body].reshape(3, 3)
    com = frame[:3, :3].T @ (data.xipos[body] - frame[:3, 3])
    return float(model.body_mass[body]), com, rotation @ np.diag(model.body_inertia[body]) @ rotation.T


def _shapes(model: mujoco.MjModel, body: int, offset: np.ndarray) -> tuple[list[Shape], list[Shape]]:
    """What a body shows and what it collides with; where nothing is only to be seen, both are the same."""
    visual: list[Shape] = []
    collision: list[Shape] = []
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        if model.geom_type[geom] in _ENDLESS:
            continue
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
        shape = Shape(offset @ _pose(model.geom_pos[geom], matrix), partial(_triangles, model, geom))
        (collision if model.geom_contype[geom] or model.geom_conaffinity[geom] else visual).append(shape)
    return visual or collision, collision


def _triangles(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
        faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
        return trimesh.Trimesh(model.mesh_vert[vertices].copy(), model.mesh_face[faces].copy())
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return trimesh.creation.capsule(height=2 * size[1], radius=size[0]).apply_translation([0, 0, -size[1]])
    radii = size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else np.full(3, size[0])
    return trimesh.creation.icosphere().apply_scale(radii)


def _add_equalities(tree: Tree, model: mujoco.MjModel) -> None:
    for k in range(model.neq):
        first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and second >= 0:
            follower, leader = _joint_name(model, first), _joint_name(model, second)
            if np.any(model.eq_data[k][2:5]):
                raise InputError(tree.path, f"joint {follower}", f"expected to follow {leader} in proportion")
            for i, joint in enumerate(tree.joints):
                if joint.name == follower:
                    tree.joints[i] = joint.following(leader, float(model.eq_data[k][1]))
        elif model.eq_type[k] in _CLOSING:
            if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                first, second = int(model.site_bodyid[first]), int(model.site_bodyid[second])
            tree.loops.append((_body_name(model, first), _body_name(model, second)))


def _pose(position: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = np.reshape(matrix, (3, 3)), position
    return frame


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body{body}"


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    return model.joint(joint).name or f"joint{joint}"
