"""The robot linearised about a posture: M, C, K from ``mjd_transitionFD``, and the Jacobians of its test points.

``mjd_transitionFD`` differentiates one step of the discrete simulation. For MuJoCo's Euler and implicit integrators the
continuous matrices follow from it exactly, without a matrix logarithm. With the velocity rows of the transition matrix
A = [[·, ·], [A_vq, A_vv]] and the step h,

    M⁻¹C = (A_vv⁻¹ − I) / h,    M⁻¹K = −A_vv⁻¹ A_vq / h.

With slip elements, whose state it mixes up, the same differences are taken of ``mj_step``.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from twin.robot.mechanism import Mechanism
from twin.robot.mjcf import EQUIVALENT_HZ, compile_model

FD_EPSILON = 1e-6


@dataclass(frozen=True)
class LinearModel:
    """M ẍ + C ẋ + (K + i·loss) x + integral ∫x dt = Jᵀ f about an equilibrium, x the nv free coordinates.

    Attributes:
        coordinates: (nv,) joint names, as in the MJCF; those of elastic joints are sites of the vocabulary.
        M: (nv, nv) mass matrix, kg·m² (kg, kg·m for slides).
        C: (nv, nv) viscous damping.
        K: (nv, nv) stiffness, of springs and gravity.
        loss: (nv, nv) structural damping, the imaginary part of the stiffness for ω > 0.
        integral: (nv, nv) integral action of servos, N·m/(rad·s).
        spring: (nv,) stiffness of the spring on each coordinate, 0 where there is none.
        points: label → (body, point Jacobian (3, nv) in that body's frame).
        directions: label → unit direction (3,) in the body's frame.
    """

    coordinates: tuple[str, ...]
    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    loss: np.ndarray
    integral: np.ndarray
    spring: np.ndarray
    points: dict[str, tuple[str, np.ndarray]]
    directions: dict[str, np.ndarray]

    def jacobian(self, labels: Iterable[str]) -> np.ndarray:
        """Displacement of points along their directions per unit of the coordinates, (n, nv)."""
        return np.array([self.directions[label] @ self.points[label][1] for label in labels]).reshape(
            -1, len(self.coordinates)
        )

    def hold(self, coordinates: Iterable[str]) -> "LinearModel":
        """The model with some coordinates held still (rotors by brakes or a perfect servo)."""
        held = set(coordinates)
        keep = [k for k, name in enumerate(self.coordinates) if name not in held]
        grid = np.ix_(keep, keep)
        return replace(
            self,
            coordinates=tuple(self.coordinates[k] for k in keep),
            M=self.M[grid], C=self.C[grid], K=self.K[grid], loss=self.loss[grid], integral=self.integral[grid],
            spring=self.spring[keep],
            points={label: (body, jacobian[:, keep]) for label, (body, jacobian) in self.points.items()},
        )  # fmt: skip

    @property
    def stepped(self) -> "LinearModel":
        """What MuJoCo steps: viscous dampers for structural damping, no integral action."""
        none = np.zeros_like(self.loss)
        return replace(self, C=self.C + self.loss / (2 * np.pi * EQUIVALENT_HZ), loss=none, integral=none)


def state_matrix(M: np.ndarray, C: np.ndarray, K: np.ndarray, loss: np.ndarray, integral: np.ndarray) -> np.ndarray:
    """A of ẏ = A y with y = (x, ẋ, ∫x dt of the coordinates under integral action), from matrices (nv, nv).

    M and K, and with them A, may have further axes in front; the others may have them, too, but for ``integral``.
    """
    nv, front = M.shape[-1], M.shape[:-2]
    K = K + 1j * loss if loss.any() else K
    kept = np.flatnonzero(integral.any(axis=0))
    forces = [K, C, integral[:, kept]]
    if front:
        forces = [np.broadcast_to(part, (*front, *part.shape[-2:])) for part in forces]
    A = np.zeros((*front, 2 * nv + len(kept), 2 * nv + len(kept)), K.dtype)
    A[..., :nv, nv : 2 * nv] = np.eye(nv)
    A[..., nv : 2 * nv, :] = -np.linalg.solve(M, np.concatenate(forces, axis=-1))
    A[..., 2 * nv + np.arange(len(kept)), kept] = 1.0
    return A


def transition_matrices(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """M⁻¹C and M⁻¹K (nv, nv) at the state in ``data``, exactly recovered from ``mjd_transitionFD``.

    Friction and limits are constraints in MuJoCo, regularised so that they would wreck the linearisation; they are
    disabled while it is made.

    Raises:
        ValueError: an integrator for which the recovery does not hold, or a model with activations.
    """
    exact = (
        mujoco.mjtIntegrator.mjINT_EULER,
        mujoco.mjtIntegrator.mjINT_IMPLICIT,
        mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    )
    if model.opt.integrator not in exact:
        raise ValueError("linearisation needs integrator Euler, implicit or implicitfast")
    if model.na:
        raise ValueError("linearisation needs a model without activations")
    nv, h = model.nv, model.opt.timestep
    flags = model.opt.disableflags
    model.opt.disableflags = flags | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    try:
        A = np.zeros((2 * nv, 2 * nv))
        mujoco.mj_forward(model, data)
        if model.nplastic:
            _stepped_differences(model, data, A)
        else:
            mujoco.mjd_transitionFD(model, data, FD_EPSILON, 1, A, None, None, None)
        mujoco.mj_forward(model, data)  # derived fields are stale after the differences
        if data.nefc:
            raise ValueError("linearisation needs a state without active constraints")
    finally:
        model.opt.disableflags = flags
    inverse = np.linalg.inv(A[nv:, nv:])
    return (inverse - np.eye(nv)) / h, -inverse @ A[nv:, :nv] / h


def _stepped_differences(model: mujoco.MjModel, data: mujoco.MjData, A: np.ndarray) -> None:
    """What ``mjd_transitionFD`` makes of A (2nv, 2nv), no slip element yielding.

    With more than four of them MuJoCo 4.0 mixes their state (``mjData.plastic``) up with the velocities.
    """
    everything, nv = mujoco.mjtState.mjSTATE_INTEGRATION, model.nv
    state = np.empty(mujoco.mj_stateSize(model, everything))
    mujoco.mj_getState(model, data, state, everything)
    yields = model.tendon_springyield.copy()
    model.tendon_springyield[yields > 0] = np.inf
    try:
        for k in range(2 * nv):
            ends = []
            for side in (FD_EPSILON, -FD_EPSILON):
                mujoco.mj_setState(model, data, state, everything)
                (data.qpos if k < nv else data.qvel)[k % nv] += side  # hinges and slides: nq = nv
                mujoco.mj_step(model, data)
                ends.append(np.concatenate([data.qpos, data.qvel]))
            A[:, k] = (ends[0] - ends[1]) / (2 * FD_EPSILON)
    finally:
        model.tendon_springyield[:] = yields
        mujoco.mj_setState(model, data, state, everything)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Joint-space mass matrix (nv, nv), armature included, at the state of the last ``mj_forward``."""
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M


def posture_state(model: mujoco.MjModel, mechanism: Mechanism, data: mujoco.MjData | None = None) -> mujoco.MjData:
    """The commanded posture at rest, deflections zero; rotors that are free are held up by applied torques.

    ``data`` is used again where it is given: making one takes as long as all the rest of a linearisation.
    """
    if data is None:
        data = mujoco.MjData(model)
    else:
        mujoco.mj_resetData(model, data)
    rotors = [i for i in range(len(mechanism.q)) if mechanism.motor(i) is not None]
    data.qpos[[model.joint(f"motor{i + 1}").qposadr[0] for i in rotors]] = mechanism.q[rotors]
    mujoco.mj_forward(model, data)
    dof = [model.joint(f"motor{i + 1}").dofadr[0] for i in rotors]
    data.qfrc_applied[dof] = (data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator)[dof]
    mujoco.mj_forward(model, data)
    return data


def linearise(mechanism: Mechanism, model: mujoco.MjModel | None = None) -> LinearModel:
    """Linearise a mechanism about its commanded posture.

    Args:
        mechanism: from :func:`twin.robot.mechanism.assemble`, with drives ``"held"`` or ``"free"``.
        model: its compiled form, where that is at hand.
    """
    if model is None:
        model = compile_model(mechanism, visual=False, instruments=False)
    data = posture_state(model, mechanism, _spare(model))
    nv = model.nv
    order = sorted(mechanism.joints, key=lambda joint: int(model.joint(joint.name).dofadr[0]))
    M = mass_matrix(model, data)
    if nv:
        damping, stiffness = transition_matrices(model, data)
        C, K = symmetric(M @ damping), symmetric(M @ stiffness)
    else:
        C = K = np.zeros((0, 0))
    loss = np.diag([joint.loss_factor * joint.stiffness[0] for joint in order])
    integral = np.diag([joint.stiffness[0] / joint.integral_time for joint in order])
    C = C - loss / (2 * np.pi * EQUIVALENT_HZ)  # the viscous stand-in that the MJCF carries
    return LinearModel(
        coordinates=tuple(joint.name for joint in order),
        M=M, C=C, K=K, loss=loss, integral=integral,
        spring=_springs(model, data),
        points=_points(mechanism, model, data),
        directions={point.label: np.asarray(point.direction) for point in mechanism.points},
    )  # fmt: skip


_KEPT = threading.local()


def _spare(model: mujoco.MjModel) -> mujoco.MjData:
    """The state that this thread linearised the model with last, or a new one."""
    if getattr(_KEPT, "model", None) is not model:
        _KEPT.model, _KEPT.data = model, mujoco.MjData(model)
    data: mujoco.MjData = _KEPT.data
    return data


def _points(mechanism: Mechanism, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, tuple[str, np.ndarray]]:
    """Label → body, and displacement (3, nv) in that body's frame per unit of the coordinates."""
    ids = {name: model.body(name).id for name in dict.fromkeys(point.body for point in mechanism.points)}
    moved = {name: np.zeros((2, 3, model.nv)) for name in ids}  # shift and turn, in the world's frame
    for name, body in ids.items():
        mujoco.mj_jac(model, data, *moved[name], data.xpos[body], body)
    moved = {name: data.xmat[body].reshape(3, 3).T @ moved[name] for name, body in ids.items()}
    count = len(mechanism.points)
    shift, turn = np.reshape([moved[p.body] for p in mechanism.points], (count, 2, 3, model.nv)).swapaxes(0, 1).copy()
    x, y, z = np.reshape([point.position for point in mechanism.points], (count, 3)).T
    across = np.zeros((len(x), 3, 3))  # turn × position = across · turn
    across[:, 0, 1], across[:, 1, 2], across[:, 2, 0] = z, x, y
    shift += (across - across.swapaxes(1, 2)) @ turn
    return {p.label: (p.body, jacobian) for p, jacobian in zip(mechanism.points, shift, strict=True)}


def _springs(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Stiffness (nv,) of what is elastic along each coordinate at the state in ``data``, joints and tendons."""
    if not model.ntendon and not model.jnt_stiffnesspoly.any():  # hinges and slides: joints are in the order of nv
        return np.maximum(model.jnt_stiffness, 0.0)
    rest, step = data.qpos.copy(), 1e-7
    stiffness = np.zeros(model.nv)
    for joint in range(model.njnt):
        address, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        force = []
        for side in (step, -step):
            data.qpos[:] = rest
            data.qpos[address] += side
            mujoco.mj_forward(model, data)
            force.append(data.qfrc_passive[dof])
        stiffness[dof] = (force[1] - force[0]) / (2 * step)
    data.qpos[:] = rest
    mujoco.mj_forward(model, data)
    return np.maximum(stiffness, 0.0)


def symmetric(A: np.ndarray) -> np.ndarray:
    """The symmetric part: what is skew in a covariance, or in what derives from a potential, is rounding."""
    return 0.5 * (A + A.T)
