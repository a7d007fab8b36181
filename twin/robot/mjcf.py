"""A mechanism written as MJCF with MjSpec, compiled, and saved in menagerie style."""

import ctypes
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from twin.errors import InputError
from twin.files import writing
from twin.robot.frames import inertia_six, quaternion_of
from twin.robot.mechanism import Body, Joint, Mechanism, Tendon
from twin.robot.mesh import drawn_by_mujoco, read_mesh, thinned

TIMESTEP_S = 0.001
EQUIVALENT_HZ = 15.0
"""Structural damping is written as the viscous damper that dissipates as much at this frequency."""

ROTOR_MASS = 1e-9  # kg: MuJoCo refuses moving bodies without mass; a link's mass already holds its motor's
FLAT = 1e-9  # of the largest moment: MuJoCo finds principal axes to less
FOOT_INERTIA = (
    0.1  # kg·m²: without any, base yaw and the collinear torsion of joint 1 would share a singular mass matrix
)
STICKING = 0.001, 1.0
"""Time constant (s) and damping ratio of dry friction's constraint. MuJoCo's own 20 ms let it give way 10 ms before an
axis turns back."""
SERVO_HZ = 30.0  # bandwidth of the position servo where the description gives no gains
SERVO_DAMPING = 0.7

_COLOURS = {"base": (0.25, 0.25, 0.27, 1), "link": (0.95, 0.45, 0.08, 1), "motor": (0.16, 0.16, 0.18, 1)}


def compile_model(mechanism: Mechanism, *, visual: bool = True, instruments: bool = True) -> mujoco.MjModel:
    """The mechanism as a compiled model whose commanded posture is the equilibrium under gravity.

    Args:
        mechanism: from :func:`twin.robot.mechanism.assemble`.
        visual: with meshes.
        instruments: with hammer actuators and accelerometers; without them stepping is faster.
    """
    spec = build_spec(mechanism, visual=visual, instruments=instruments)
    return spec.compile()


def build_spec(
    mechanism: Mechanism, *, visual: bool = True, instruments: bool = True, balanced: bool = True
) -> mujoco.MjSpec:
    """The mechanism as an MjSpec.

    Args:
        mechanism: from :func:`twin.robot.mechanism.assemble`.
        visual: with meshes.
        instruments: with hammer actuators and accelerometers.
        balanced: springs referenced so that the commanded posture is the equilibrium; otherwise they rest at zero
            deflection and the robot sags, as a moving robot does.

    Raises:
        ValueError: MuJoCo refuses the model.
    """
    mechanism = _with_tendons(mechanism)
    spec = mujoco.MjSpec()
    spec.modelname = mechanism.robot.name
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    spec.option.timestep = TIMESTEP_S
    spec.option.gravity = mechanism.robot.felt_gravity
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # the sparse Cholesky of mujoco-core 4.0.0 is wrong
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.stat.center, spec.stat.extent = (0.8, 0.0, 1.0), 3.0
    _defaults(spec)
    bodies = {"": spec.worldbody}
    for body in mechanism.bodies.values():
        bodies[body.name] = _add_body(spec, bodies[body.parent], body, visual)
    for point in mechanism.points:
        z = np.asarray(point.direction)
        x = np.eye(3)[np.argmin(np.abs(z))]
        y = np.cross(z, x) / np.linalg.norm(np.cross(z, x))
        frame = np.column_stack([np.cross(y, z), y, z])
        bodies[point.body].add_site(
            spec.find_default("point"), name=point.label, pos=point.position, quat=quaternion_of(frame)
        )
    for tendon in mechanism.tendons:
        fixed = spec.add_tendon(name=tendon.name)
        for name, coefficient in tendon.joints.items():
            fixed.wrap_joint(name, coefficient)
        fixed.stiffness, fixed.damping = [tendon.stiffness, 0, 0], tendon.damping
        fixed.springlength, fixed.springyield = tendon.springlength, tendon.springyield
        fixed.armature, fixed.frictionloss = tendon.armature, tendon.frictionloss
        if tendon.frictionloss:
            fixed.solref_friction = STICKING
    for joint in mechanism.joints:
        if joint.dead_zone:
            _add_dead_band(spec, joint)
    _add_drives(spec, mechanism)
    if instruments:
        _add_instruments(spec, mechanism)
    if balanced:
        _balance(spec, mechanism)
    return spec


def lit(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """The spec with a sky, a light and, where gravity points down, a floor; nothing of it touches the robot."""
    scene = spec.copy()
    scene.visual.headlight.ambient = scene.visual.headlight.diffuse = (0.4, 0.4, 0.4)
    scene.visual.headlight.specular = (0, 0, 0)
    scene.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.75, 0.82, 0.9), rgb2=(0.3, 0.38, 0.48), width=256, height=1536,
    )  # fmt: skip
    scene.worldbody.add_light(
        name="sun", pos=(1, -2, 5), dir=(-0.2, 0.4, -1), type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=True
    )
    x, y, z = scene.option.gravity
    if z < 0 and not (x or y):
        scene.add_texture(
            name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=(0.72, 0.74, 0.77), rgb2=(0.66, 0.68, 0.71), width=256, height=256,
        )  # fmt: skip
        material = scene.add_material(name="floor", texuniform=True, texrepeat=(1, 1), reflectance=0.1)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
        scene.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=(0, 0, 0.05),
            material="floor",
            contype=0,
            conaffinity=0,
        )
    return scene


def save_mjcf(path: str | Path, spec: mujoco.MjSpec, *, copy_meshes: bool = True) -> None:
    """Write the spec as an XML file that any MuJoCo loads, at 12 significant digits.

    Args:
        path: the file.
        spec: from :func:`build_spec`.
        copy_meshes: into ``assets`` beside the file, so that the folder can be moved; otherwise they are referenced
            where they lie, relative to the file.
    """
    path = Path(path).resolve()
    with _xml_precision(17):
        text = spec.to_xml()

    def numbers(found: re.Match[str]) -> str:
        name, value = found.groups()
        if name not in _NAMES:
            value = re.sub(r"(?<!\S)-?\d+\.?\d*(?:e[-+]?\d+)?(?!\S)", lambda n: _short(float(n.group())), value)
        return f'{name}="{value}"'

    def mesh(found: re.Match[str]) -> str:
        name, between, file = found.groups()
        target = Path(file)
        if copy_meshes:
            target = path.parent / "assets" / f"{name}{target.suffix}"
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        return f'<mesh name="{name}"{between} file="{os.path.relpath(target, path.parent)}"'

    text = re.sub(r'(\w+)="([^"]*)"', numbers, text)
    text = re.sub(r'<mesh name="([^"]*)"([^>]*) file="([^"]*)"', mesh, text)
    with writing(path) as stream:
        stream.write(text)


_NAMES = {
    "name",
    "model",
    "class",
    "childclass",
    "site",
    "joint",
    "mesh",
    "target",
    "objname",
    "tendon",
    "body",
    "file",
}


def _short(value: float) -> str:
    """A number at 12 significant digits; what MuJoCo holds in single precision (colours) at the digits that has."""
    if abs(value) < 1e-14:
        return "0"
    single = np.float32(value)
    return f"{single:.7g}" if abs(float(single) - value) < 1e-15 * abs(value) else f"{value:.12g}"


@contextmanager
def _xml_precision(digits: int) -> Iterator[None]:
    # MuJoCo prints six digits by default, too few for lightly damped modes; its own tests use these two functions.
    library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))
    before = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(digits)
    try:
        yield
    finally:
        library._mjPRIVATE__set_xml_precision(before)


def _defaults(spec: mujoco.MjSpec) -> None:
    visual = spec.add_default("visual", spec.default)
    visual.geom.type = mujoco.mjtGeom.mjGEOM_MESH
    visual.geom.contype = visual.geom.conaffinity = 0
    visual.geom.density = 0
    visual.geom.group = 2
    for kind, colour in _COLOURS.items():
        spec.add_default(kind, visual).geom.rgba = colour
    point = spec.add_default("point", spec.default)
    point.site.type = mujoco.mjtGeom.mjGEOM_CYLINDER
    point.site.size = [0.012, 0.02, 0.012]
    point.site.rgba = (0.1, 0.6, 0.9, 1)
    point.site.group = 3
    hammer = spec.add_default("hammer", spec.default)
    hammer.actuator.gear = [0, 0, 1, 0, 0, 0]  # ctrl is the force along the site's z, N


def _rounding(inertia: np.ndarray) -> float:
    """What is added to each moment (kg·m²) of a body so flat that rounding lets one exceed the sum of the others."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    return float(max(high * (1 + FLAT) - low - middle, 0.0))


def _add_body(spec: mujoco.MjSpec, parent: mujoco.MjsBody, body: Body, visual: bool) -> mujoco.MjsBody:
    item = parent.add_body(name=body.name, pos=body.position, quat=body.quaternion)
    if body.mass > 0 or body.joints:
        item.explicitinertial = True
        item.mass = max(body.mass, ROTOR_MASS)
        item.ipos = body.com
        if np.trace(body.inertia) > 0:
            item.fullinertia = inertia_six(body.inertia + _rounding(body.inertia) * np.eye(3))
        else:
            item.inertia = [FOOT_INERTIA if body.kind == "base" else item.mass * 1e-3] * 3
    for joint in body.joints:
        damping = list(joint.damping)
        damping[0] += joint.loss_factor * joint.stiffness[0] / (2 * np.pi * EQUIVALENT_HZ)
        added = item.add_joint(
            name=joint.name,
            type=mujoco.mjtJoint.mjJNT_SLIDE if joint.kind == "slide" else mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            pos=joint.position,
            stiffness=[0, 0, 0] if joint.dead_zone else joint.stiffness,
            damping=damping,
            armature=joint.armature,
            frictionloss=joint.frictionloss,
            springref=joint.springref,
        )
        if joint.frictionloss:
            added.solref_friction = STICKING
        if joint.range is not None:
            added.range = joint.range
    if body.mesh and visual:
        mesh = spec.add_mesh(name=body.name, scale=[body.mesh_scale] * 3)
        if drawn_by_mujoco(body.mesh):
            mesh.file = body.mesh
        else:
            shape = thinned(read_mesh(body.mesh, body.mesh, ""))
            mesh.uservert, mesh.userface = shape.vertices.ravel(), shape.faces.ravel()
        item.add_geom(spec.find_default(body.kind), meshname=body.name)
    return item


def _with_tendons(mechanism: Mechanism) -> Mechanism:
    """A mechanism whose crossed stiffnesses are tendons, k (a x ± y/a)², with a⁴ the ratio of the two springs.

    The springs give up k a² and k/a², which is less than they have wherever the two together hold.
    """
    if not mechanism.crossed:
        return mechanism
    bodies, tendons = dict(mechanism.bodies), list(mechanism.tendons)
    for (one, other), stiffness in mechanism.crossed.items():
        name, body = next((n, b) for n, b in bodies.items() if any(joint.name == one for joint in b.joints))
        own = {joint.name: joint for joint in body.joints}
        ratio = (own[one].stiffness[0] / own[other].stiffness[0]) ** 0.5
        for joint, share in ((one, ratio), (other, 1 / ratio)):
            given, (k, *higher), (d, *drag) = abs(stiffness) * share, own[joint].stiffness, own[joint].damping
            d += own[joint].loss_factor * given / (2 * np.pi * EQUIVALENT_HZ)
            own[joint] = replace(own[joint], stiffness=[k - given, *higher], damping=[d, *drag])
        bodies[name] = replace(body, joints=list(own.values()))
        pull = {one: ratio**0.5, other: float(np.sign(stiffness)) / ratio**0.5}
        tendons.append(Tendon(f"{one}{other[-1]}", pull, stiffness=abs(stiffness)))
    return replace(mechanism, bodies=bodies, tendons=tendons)


def _add_drives(spec: mujoco.MjSpec, mechanism: Mechanism) -> None:
    for passive in mechanism.passive_motors:
        if any(passive.lugre) and mechanism.drives != "servo":
            continue  # bristles are states: they are for stepping, and would keep a model from being linearised
        coupled = any(tendon.name == passive.joint for tendon in mechanism.tendons)
        kind = mujoco.mjtTrn.mjTRN_TENDON if coupled else mujoco.mjtTrn.mjTRN_JOINT
        motor = spec.add_actuator(name=passive.name, target=passive.joint, trntype=kind)
        motor.set_to_dcmotor(
            motorconst=[1e-9, 0.0],
            resistance=1.0,
            cogging=passive.cogging,
            lugre=passive.lugre,
            ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_NONE),
        )  # the motor constant must be positive: 1e-9 brakes the joint by 1e-18 N·m·s/rad
    if mechanism.drives != "servo":
        return
    inertia = _tuned_inertia(spec, mechanism)
    for i, axis in enumerate(mechanism.robot.axes):
        omega = 2 * np.pi * SERVO_HZ
        if not inertia[i] > 0:
            raise InputError(mechanism.robot.name, f"drives[{i}]", "an inertia above zero is needed for the servo")
        kp, kv = mechanism.servo_gains.get(i, (inertia[i] * omega**2, 2 * SERVO_DAMPING * inertia[i] * omega))
        actuator = spec.add_actuator(name=f"motor{i + 1}", target=f"motor{i + 1}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=kp, kv=kv)
        if axis.limits and axis.limits.position:
            actuator.ctrlrange = axis.limits.position


def _tuned_inertia(spec: mujoco.MjSpec, mechanism: Mechanism) -> np.ndarray:
    """Inertia (n,) the servos are tuned to: the rotor's behind an elastic gear, all that moves with a rigid one."""
    robot = mechanism.robot
    rotors = np.array([drive.gear_ratio**2 * drive.rotor_inertia for drive in robot.drives])
    rigid = [i for i, axis in enumerate(robot.axes) if axis.stiffness is None or not rotors[i]]
    if rigid:
        model = spec.compile()
        data = mujoco.MjData(model)
        for i, value in enumerate(mechanism.q):
            data.qpos[model.joint(f"motor{i + 1}").qposadr[0]] = value
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        for i in rigid:
            dof = model.joint(f"motor{i + 1}").dofadr[0]
            rotors[i] = mass[dof, dof]
    return rotors


def _add_instruments(spec: mujoco.MjSpec, mechanism: Mechanism) -> None:
    for point in mechanism.points:
        spec.add_actuator(
            spec.find_default("hammer"), name=f"hammer {point.label}", target=point.label,
            trntype=mujoco.mjtTrn.mjTRN_SITE,
        )  # fmt: skip
    for label in mechanism.accelerometers:
        # framelinacc, since the accelerometer sensor also feels gravity turn with the tilt
        sensor = spec.add_sensor(
            name=label, type=mujoco.mjtSensor.mjSENS_FRAMELINACC, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=label,
        )  # fmt: skip
        if delay := mechanism.sensor_delay.get(label):
            sensor.delay, sensor.nsample = delay, int(np.ceil(delay / TIMESTEP_S)) + 1
    for i in range(mechanism.robot.axis_count):
        for joint in (f"motor{i + 1}", f"joint{i + 1}.z"):
            if mechanism.joint(joint):
                spec.add_sensor(
                    name=f"position {joint}", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                    objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint,
                )  # fmt: skip


def _balance(spec: mujoco.MjSpec, mechanism: Mechanism) -> None:
    """Set every spring's rest position so that the commanded posture carries gravity; write it as a keyframe."""
    springs = [joint for joint in mechanism.joints if joint.elastic]
    model = spec.compile()
    data = mujoco.MjData(model)
    addresses = {joint.name: model.joint(joint.name).qposadr[0] for joint in mechanism.joints}
    qpos = np.zeros(model.nq)
    for i, value in enumerate(mechanism.q):
        if (motor := mechanism.motor(i)) is not None:
            qpos[addresses[motor.name]] = value
    data.qpos[:] = qpos
    if mechanism.drives == "servo":
        for i, value in enumerate(mechanism.q):
            data.ctrl[model.actuator_ctrladr[model.actuator(f"motor{i + 1}").id]] = value
    mujoco.mj_forward(model, data)
    missing = data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator
    for joint in springs:
        # what else is passive there (cable, compensator on a freed rotor) carries its share
        torque = float(missing[model.joint(joint.name).dofadr[0]])
        rest, half = joint.rest(torque), joint.dead_zone / 2
        if joint.dead_zone:
            centre = rest + np.sign(torque) * half
            spec.tendon(f"{joint.name}.gap").springlength = (centre - half, centre + half)
        else:
            spec.joint(joint.name).springref = rest
    if mechanism.drives == "servo":
        ctrl = np.zeros(model.nu)
        for i, value in enumerate(mechanism.q):
            servo = model.actuator(f"motor{i + 1}").id
            error = missing[model.joint(f"motor{i + 1}").dofadr[0]] / model.actuator_gainprm[servo, 0]
            ctrl[model.actuator_ctrladr[servo]] = value + error
        spec.add_key(name="posture", qpos=qpos, ctrl=ctrl)


def _add_dead_band(spec: mujoco.MjSpec, joint: Joint) -> None:
    """The hinge's spring as a fixed tendon with a dead band; the damper stays on the hinge."""
    tendon = spec.add_tendon(name=f"{joint.name}.gap")
    tendon.wrap_joint(joint.name, 1.0)
    tendon.stiffness = joint.stiffness
    tendon.springlength = (-joint.dead_zone / 2, joint.dead_zone / 2)
