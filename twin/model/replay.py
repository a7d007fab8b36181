"""Motion of the twin: inverse dynamics along a trajectory, and replay in MuJoCo's time stepping under servo drives."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from twin.errors import InputError
from twin.measure.motion_log import MotionRun
from twin.measure.signals import lowpass
from twin.model.linear import linearise
from twin.model.modes import state_matrix_poles
from twin.physics import CATALOGUE, effect_of
from twin.physics.chain import MeasurementChain
from twin.physics.motion import Motion
from twin.ranges import MOST_VALUES
from twin.robot.description import Entry, Robot
from twin.robot.mechanism import Joint, Mechanism, assemble
from twin.robot.mjcf import build_spec, compile_model

STEP_S = 0.0005
FASTEST = 1e6  # rad/s: a pole that no robot has, and that nobody waits for
SMOOTH_HZ = (8.0, 10.0)  # taper for positions recorded without velocity and acceleration
SLIDING = 1e-3  # rad/s (m/s): a passive friction law changes sign over this speed in time stepping
_ROLES = {"load": 0, "friction": 1, "drive": 2}


@dataclass(frozen=True)
class Replay:
    """What the twin did along a trajectory, at the trajectory's instants.

    Attributes:
        time: (nt,) s.
        position: (nt, n) axes before their springs, rad (m); where drives are coupled, motors turn by ``C q``.
        link_position: (nt, n) motor plus the deflection about z, rad (m).
        torque: (nt, n) of the drives at the gear output, N·m (N), mean over one sample about each instant.
        deflections: elastic joint → (nt,) deflection, rad (m).
    """

    time: np.ndarray
    position: np.ndarray
    link_position: np.ndarray
    torque: np.ndarray
    deflections: dict[str, np.ndarray]


def motion_of(run: MotionRun) -> Motion:
    """Positions, velocities and accelerations of a run; those it does not hold are differentiated.

    A trajectory is exact and is differentiated as a spline; a recording is noisy and is low-passed with it.
    """
    velocity, acceleration = run.velocity, run.acceleration
    if velocity is None or acceleration is None:
        if run.torque is None:
            spline = make_interp_spline(run.time, run.position, k=min(5, len(run.time) - 1))
            first, second = spline.derivative(1)(run.time), spline.derivative(2)(run.time)
        else:
            stop = min(SMOOTH_HZ[1], 0.4 * run.sample_rate_hz)
            even = run.time[0] + np.arange(len(run.time)) / run.sample_rate_hz
            position = run.position
            if np.abs(run.time - even).max() > 0.1 / run.sample_rate_hz:
                position = CubicSpline(run.time, position)(even)
            first, second = (lowpass(position, run.sample_rate_hz, 0.8 * stop, stop, k) for k in (1, 2))
        velocity = first if velocity is None else velocity
        acceleration = second if acceleration is None else acceleration
    return Motion(run.time, run.position, velocity, acceleration)


def rigid_torque(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque (nt, n) through the gears of the rigid robot, without rotors and friction, from mj_inverse."""
    bodies = []
    for entry in robot.physics:
        if (weight := CATALOGUE[entry.effect].weight(entry.values)) is not None:
            bodies.append(Entry.model_validate({"effect": effect_of("mass").name, "site": entry.site, **weight}))
    rigid = robot.model_copy(
        update={
            "axes": [axis.model_copy(update={"stiffness": None, "limits": None}) for axis in robot.axes],
            "drives": [drive.model_copy(update=dict(rotor_inertia=0.0, coupling={})) for drive in robot.drives],
            "physics": bodies,
            "gravity": tuple(map(float, robot.felt_gravity)),
        }
    )
    model = compile_model(assemble(rigid, motion.position[0], drives="free"), visual=False, instruments=False)
    data = mujoco.MjData(model)
    torque = np.empty_like(motion.position)
    for k in range(len(torque)):
        data.qpos, data.qvel, data.qacc = motion.position[k], motion.velocity[k], motion.acceleration[k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


def inverse_dynamics(robot: Robot, motion: Motion) -> np.ndarray:
    """Drive torque (nt, n) at the gear output: rigid body, rotors, and every entry's law (paper, Eq. 4).

    ``motion.load`` and ``motion.friction`` are filled on the way, for laws that depend on them.
    """
    motion.load = rigid_torque(robot, motion.on(robot))
    motion.friction = np.zeros_like(motion.load)
    total = motion.load + _rotor_torque(robot, motion)
    there = motion.on(robot)  # load and friction are one with the motion's: they fill as laws add
    entries = [(CATALOGUE[entry.effect], entry) for entry in robot.physics]
    for effect, entry in sorted(entries, key=lambda pair: (_ROLES[pair[0].role], pair[0].order)):
        for axis, torque in effect.felt(there, entry.site, robot.values(entry)).items():
            total[:, axis] += torque
            if effect.role == "load":
                motion.load[:, axis] += torque
            elif effect.role == "friction":
                motion.friction[:, axis] += torque
    return total


def _rotor_torque(robot: Robot, motion: Motion) -> np.ndarray:
    torque = np.zeros_like(motion.acceleration)
    for i, drive in enumerate(robot.drives):
        turns = {i: 1.0} | {robot.joint_names.index(name): ratio for name, ratio in drive.coupling.items()}
        spin = sum(ratio * motion.acceleration[:, axis] for axis, ratio in turns.items())
        for axis, ratio in turns.items():
            torque[:, axis] += ratio * drive.gear_ratio**2 * drive.rotor_inertia * spin
    return torque


def replay(
    robot: Robot, run: MotionRun, *, progress: Callable[[int], None] | None = None, source: str = "motion log"
) -> Replay:
    """Track a trajectory with servo actuators on the motor bodies and record torque and link motion.

    The servo is a position and velocity loop with the inverse dynamics fed forward, as in a robot controller. It starts
    at the trajectory's first state, with the springs wound up by the load of that instant.

    Args:
        robot: description.
        run: trajectory or motion log; its torque is not used.
        progress: called with the number of samples finished since the last call.
        source: the file named in errors.

    Raises:
        InputError: the trajectory leaves the axes' limits, or the simulation diverges.
    """
    motion = motion_of(run)
    for extreme in (np.argmax, np.argmin):
        for k in extreme(motion.position, axis=0):
            robot.check_posture(motion.position[k], source, f"runs/{run.name}/position")
    feedforward = inverse_dynamics(robot, motion)
    mechanism = assemble(robot, motion.position[0], brakes="off", drives="servo")
    model, steps, inner = _stepped_model(robot, mechanism, run.sample_rate_hz)
    zeros = robot.encoder_zeros
    torque, qpos = _track(model, mechanism, motion.on(robot), feedforward, steps, inner, progress)
    if not (np.isfinite(torque).all() and np.isfinite(qpos).all()):
        message = "the simulation diverges: stiffness, inertia or motion is beyond reason"
        raise InputError(robot.name, f"replay of {run.name}", message)
    motor = [model.joint(f"motor{i + 1}").qposadr[0] for i in range(robot.axis_count)]
    elastic = [joint.name for joint in mechanism.joints if joint.elastic]
    deflections = {name: qpos[:, model.joint(name).qposadr[0]] for name in elastic}
    recorded_position = qpos[:, motor] - zeros
    link_position = recorded_position.copy()
    for i in range(robot.axis_count):
        link_position[:, i] += deflections.get(f"joint{i + 1}.z", 0.0)
    recorded = recorded_torque(robot, run.time, torque)
    return Replay(run.time, recorded_position, link_position, recorded, deflections)


def _stepped_model(robot: Robot, mechanism: Mechanism, sample_rate_hz: float) -> tuple[mujoco.MjModel, int, int]:
    """The model with its time step, the intervals per sample, at most ``STEP_S`` long, and the steps in each.

    A step is as short as the fastest pole.

    Raises:
        InputError: an elastic axis without a rotor's inertia, or a pole too fast to step.
    """
    model = build_spec(mechanism, instruments=False, balanced=False).compile()
    for i, axis in enumerate(robot.axes):
        rotor = model.dof_armature[model.joint(f"motor{i + 1}").dofadr[0]]
        coupled = robot.drives[i].coupling and robot.drives[i].rotor_inertia > 0  # it has no joint of its own
        if axis.stiffness is not None and rotor <= 0 and not coupled:
            where = f"drives[{i}].rotor_inertia"
            raise InputError(robot.name, where, "an elastic axis needs its rotor's inertia in a replay")
    free = linearise(assemble(robot, mechanism.q - robot.encoder_zeros, drives="free"))
    fastest = np.abs(state_matrix_poles(free)).max(initial=0.0)
    if not fastest < FASTEST:
        message = f"a pole of {fastest:.1e} rad/s: stiffness over inertia is beyond reason"
        raise InputError(robot.name, "axes, links", message)
    steps = max(1, int(np.ceil(1 / STEP_S / sample_rate_hz)))
    inner = max(1, int(np.ceil(fastest / (sample_rate_hz * steps))))
    model.opt.timestep = 1 / (sample_rate_hz * steps * inner)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model, steps, inner


def _track(
    model: mujoco.MjModel, mechanism: Mechanism, motion: Motion, feedforward: np.ndarray, steps: int, inner: int,
    progress: Callable[[int], None] | None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Torque (nt, n) of the servos, mean over one sample about each instant, and ``qpos`` (nt, nq); NaN if it diverges.

    Of the first and last instant it is that of the half sample there is. Torques that MuJoCo does not have keep their
    value over ``inner`` steps.
    """
    data = mujoco.MjData(model)
    nt, n = motion.position.shape
    if (values := nt * steps * inner * 3 * n) > MOST_VALUES:
        message = f"{nt} samples of {steps * inner} steps each are {values:.1e} values: replay a shorter run"
        raise InputError(mechanism.robot.name, "replay", message)
    names = [f"motor{i + 1}" for i in range(n)]
    servo = np.array([model.actuator(name).id for name in names])
    control = model.actuator_ctrladr[servo]
    motor = np.array([model.joint(name).qposadr[0] for name in names])
    motor_dof = np.array([model.joint(name).dofadr[0] for name in names])
    kp, kv = model.actuator_gainprm[servo, 0], -model.actuator_biasprm[servo, 2]
    reference = CubicSpline(motion.time, np.hstack([motion.position, motion.velocity, feedforward]))
    substeps = steps * inner
    instants = motion.time[0] + np.arange((nt - 1) * substeps + 1) * model.opt.timestep
    q, qd, torque_ff = np.split(reference(instants), 3, axis=1)
    data.time = motion.time[0]
    data.qpos[motor], data.qvel[motor_dof] = q[0], qd[0]
    _wind_up(model, data, mechanism.joints, motion.acceleration[0], motor_dof)
    qpos = np.empty((nt, model.nq))
    resisted = bool(mechanism.passive_forces)
    if resisted:
        felt = CubicSpline(motion.time, np.hstack([motion.load, motion.friction]))(instants[::inner])
    after = np.clip(np.arange(1, substeps + 1) - 0.5 * substeps, 0, 1)  # of each step, the share after mid-interval
    halves = np.zeros((nt, 2, n))  # torque of the half interval before each instant, and after it
    for k in range(nt):
        if progress:
            progress(1)
        for part, step in enumerate(range((k - 1) * substeps, k * substeps) if k else ()):
            # implicitfast takes the velocity loop at the end of the step
            data.ctrl[control] = q[step] + (kv * qd[step + 1] + torque_ff[step]) / kp
            if resisted and step % inner == 0:
                here = felt[step // inner][None]
                state = Motion(
                    np.array([data.time]), data.qpos[motor][None], data.qvel[motor_dof][None],
                    np.zeros((1, n)), here[:, :n], here[:, n:], lambda v: np.tanh(v / SLIDING), motion.coupling,
                )  # fmt: skip
                data.qfrc_applied[motor_dof] = -passive_torque(mechanism.passive_forces, state)
            speed = data.qvel[motor_dof]
            mujoco.mj_step(model, data)
            drive = data.actuator_force[servo] - kv * (data.qvel[motor_dof] - speed)
            halves[k - 1, 1] += (1 - after[part]) * drive
            halves[k, 0] += after[part] * drive
        qpos[k] = data.qpos
    torque = halves.sum(axis=1) / substeps
    torque[[0, -1]] *= 2
    if any(warning.number for warning in data.warning):
        torque[:] = np.nan
    return torque, qpos


def recorded_torque(robot: Robot, time: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Torque (nt, n) of the axes as the controller records it.

    It is that of the motors, which a coupling turns with other axes (τ_q = Cᵀ τ_θ). The torque constants, filter and
    delay of the robot's entries are applied.
    """
    torque = torque @ np.linalg.inv(robot.coupling)
    chain = MeasurementChain((), np.zeros((0, 3)), (), np.zeros((0, 3)), torque_gain=np.ones(robot.axis_count))
    for entry in robot.physics:
        CATALOGUE[entry.effect].record(chain, entry.site, robot.values(entry))
    if chain.torque_lag:
        from scipy.signal import lfilter  # a third of what there is to import, for few

        step = float(time[1] - time[0]) / chain.torque_lag
        keep, mean = np.exp(-step), -np.expm1(-step) / step  # of torque that goes straight from sample to sample
        torque = lfilter([1 - mean, mean - keep], [1, -keep], torque, axis=0, zi=mean * torque[:1])[0]
    if chain.torque_delay:
        torque = np.column_stack([np.interp(time - chain.torque_delay, time, column) for column in torque.T])
    return torque * chain.gain_at(time)


def passive_torque(forces: list, state: Motion) -> np.ndarray:
    """The torque (n,) by which laws that MuJoCo does not have resist the motors at one instant.

    This is the passive-force hook: any effect whose ``write`` calls ``Mechanism.passive_force`` is evaluated here at
    every step, with the same law that explains recorded torque.
    """
    total = np.zeros(state.position.shape[1])
    for force in forces:
        for axis, torque in CATALOGUE[force.effect].felt(state, force.site, force.values).items():
            total[axis] += float(torque[0])
    return total


def _wind_up(
    model: mujoco.MjModel, data: mujoco.MjData, joints: list[Joint], acceleration: np.ndarray, motor_dof: np.ndarray
) -> None:
    """Deflect the springs so that the motion starts without ringing: static balance, load of the first instant."""
    springs = [(joint, model.joint(joint.name)) for joint in joints if joint.elastic and joint.stiffness[0] > 0]
    for _ in range(5):
        data.qacc[:] = 0
        data.qacc[motor_dof] = acceleration
        mujoco.mj_inverse(model, data)
        load = data.qfrc_inverse + data.qfrc_passive  # what the springs have to carry
        for joint, place in springs:
            carried = -float(load[place.dofadr[0]])
            deflection = joint.rest(carried)
            data.qpos[place.qposadr[0]] = deflection + np.sign(deflection) * joint.dead_zone / 2
