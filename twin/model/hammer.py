"""A hammer test of the twin in time: MuJoCo stepped under a blow, recorded as an instrumented test would be.

The pulse of a rubber tip is a half sine. MuJoCo holds a force constant over a step, so the force that acts is known
exactly. Force and acceleration both pass the same anti-alias filter (the mean over two samples) before they are
sampled. That leaves their ratio untouched. Runge–Kutta steps of fourth order keep lightly damped modes where they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from twin.errors import InputError
from twin.measure.campaign import Hits
from twin.model.frf import measurement_chain
from twin.model.linear import LinearModel, linearise
from twin.model.modes import modes, state_matrix_poles
from twin.ranges import MOST_VALUES
from twin.robot.mechanism import Mechanism
from twin.robot.mjcf import build_spec

PRETRIGGER_S = 0.02
USUAL_STEPS = 2**18  # of a record that nobody asked for: a light arm's springs want steps of 10 µs
LEAST_PULSES = 4  # of a record, in pulses
FASTEST = 0.4  # |pole| × step at most: Runge–Kutta then misses a frequency by 0.02 %
DECAY = 1e-3  # what may be left of a vibration at the end of a record before an exponential window is called for


@dataclass(frozen=True)
class HammerTest:
    """How the robot is hit. Noise is off by default, so that the recording can be held against the linear model.

    Attributes:
        pulse_s: length of the half sine, s.
        duration_s: length of a record, s.
        sample_rate_hz: of the recording.
        hits: blows per excitation and level.
        force_spread: relative standard deviation of the peak from blow to blow.
        force_noise_n: RMS noise of the force channel, N.
        response_noise: RMS noise of the accelerometers, m/s².
        off_axis_deg: standard deviation of the blow's direction about each of the two other axes.
        seed: of all of these.
    """

    pulse_s: float = 0.008
    duration_s: float = 16.0
    sample_rate_hz: float = 2048.0
    hits: int = 3
    force_spread: float = 0.0
    force_noise_n: float = 0.0
    response_noise: float = 0.0
    off_axis_deg: float = 0.0
    seed: int = 0


def usual_duration(linear: LinearModel, test: HammerTest) -> float:
    """Length of a record where none is asked for, s: the test's, halved until it takes ``USUAL_STEPS`` or fewer."""
    steps = test.duration_s * test.sample_rate_hz * steps_per_sample(linear, test.sample_rate_hz)
    halvings = max(0, int(np.ceil(np.log2(steps / USUAL_STEPS))))
    return max(test.duration_s / 2**halvings, LEAST_PULSES * test.pulse_s)


def window_rate(linear: LinearModel, duration_s: float) -> float:
    """Rate of the exponential window (1/s) that brings the slowest mode to ``DECAY`` by the end of a record, or 0."""
    pole = modes(linear).pole
    slowest = float(-pole.real.max()) if len(pole) else 0.0
    return max(0.0, -np.log(DECAY) / duration_s - slowest)


def simulate_hits(
    mechanism: Mechanism,
    test: HammerTest,
    force_n: float,
    excitations: Sequence[str],
    responses: Sequence[str],
    *,
    progress: Callable[[int], None] | None = None,
    threads: int = 2,
) -> Hits:
    """Hit the robot at every excitation and record the accelerometers.

    Args:
        mechanism: with drives ``"held"``.
        test: how it is hit.
        force_n: peak force of this level, N.
        excitations: (ne,) labels of the points hit.
        responses: (nr,) labels of the accelerometers.
        progress: called with the number of records finished since the last call.
        threads: records stepped at the same time.

    Returns:
        Raw hits without windows.
    """
    linear = linearise(mechanism)
    substeps = steps_per_sample(linear, test.sample_rate_hz)
    _check_steps(mechanism, linear, substeps * round(test.duration_s * test.sample_rate_hz), threads)
    model = stepping_model(mechanism, 1 / (test.sample_rate_hz * substeps))
    step = model.opt.timestep
    chain = measurement_chain(linear, mechanism.robot, responses, excitations)
    sense = np.array(
        [d @ linear.points[label][1] for d, label in zip(chain.response_direction, responses, strict=True)]
    )
    rng = np.random.default_rng(test.seed)
    ne, nh, nr = len(excitations), test.hits, len(responses)
    samples = round(test.duration_s * test.sample_rate_hz)
    steps = samples * substeps
    # forces act over whole steps: their values are taken at the middle of each
    time = (np.arange(steps) + 0.5) * step - PRETRIGGER_S
    pulse = np.where((time > 0) & (time < test.pulse_s), np.sin(np.pi * time / test.pulse_s), 0.0)
    force, response = np.empty((ne, nh, samples)), np.empty((ne, nh, nr, samples))
    peak = force_n * (1 + test.force_spread * rng.standard_normal((ne, nh)))
    tilt = np.deg2rad(test.off_axis_deg) * rng.standard_normal((ne, nh, 2))
    data = [mujoco.MjData(model) for _ in range(threads)]
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, mujoco.MjData(model), state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    # without scatter all blows on a point are one: MuJoCo would repeat itself to the last digit
    alike = test.force_spread == 0 and test.off_axis_deg == 0
    jobs = [(e, h) for e in range(ne) for h in range(1 if alike else nh)]
    velocity = slice(1 + model.nq, 1 + model.nq + model.nv)
    with rollout.Rollout(nthread=threads) as pool:
        for start in range(0, len(jobs), threads):
            batch = jobs[start : start + threads]
            control = np.zeros((len(batch), steps, model.nv))
            for row, (e, h) in enumerate(batch):
                direction = _turned(chain.excitation_direction[e], tilt[e, h])
                control[row] = np.outer(peak[e, h] * pulse, direction @ linear.points[excitations[e]][1])
            states, _ = pool.rollout(
                model, data, np.tile(state, (len(batch), 1)), control,
                control_spec=mujoco.mjtState.mjSTATE_QFRC_APPLIED.value,
            )  # fmt: skip
            if not np.isfinite(states).all() or any(w.number for item in data for w in item.warning):
                raise InputError(
                    mechanism.robot.name, "hammer", f"the simulation diverges under a blow of {force_n:g} N"
                )
            for row, (e, h) in enumerate(batch):
                speed = np.vstack([np.zeros(nr), states[row, :, velocity] @ sense.T])  # at the step boundaries
                force[e, h] = _filtered(peak[e, h] * pulse, substeps)
                blow = np.linalg.solve(linear.M, control[row].T)  # what moves at once
                response[e, h] = _filtered(_sharpened(np.diff(speed, axis=0).T / step, sense @ blow), substeps)
            if progress:
                progress(len(batch) * (nh if alike else 1))
    if alike:
        force[:, 1:], response[:, 1:] = force[:, :1], response[:, :1]
    for k in range(nr):
        response[:, :, k] = chain.response_gain[k] * _delayed(
            response[:, :, k], chain.response_delay[k] * test.sample_rate_hz
        )
    force += test.force_noise_n * rng.standard_normal(force.shape)
    response += test.response_noise * rng.standard_normal(response.shape)
    return Hits(force, response, test.sample_rate_hz, PRETRIGGER_S)


def _check_steps(mechanism: Mechanism, linear: LinearModel, steps: int, threads: int) -> None:
    """Raise where the states of all records stepped at a time would not fit.

    Raises:
        InputError: a pole too fast, or records too long.
    """
    width = 4 * len(linear.M)  # positions, velocities, forces and what is made of them
    if threads * steps * width > MOST_VALUES:
        shorter = 2 ** int(np.ceil(np.log2(threads * steps * width / MOST_VALUES)))
        fastest = np.abs(state_matrix_poles(linear)).max(initial=1.0)
        raise InputError(
            mechanism.robot.name, "hammer.duration_s", f"a pole of {fastest:.1e} rad/s asks for {steps:.1e} steps in a "
            f"record: expected records {shorter} times shorter, less stiffness and damping over the inertia, "
            "or hammer: false for modes only",
        )  # fmt: skip


def steps_per_sample(linear: LinearModel, sample_rate_hz: float) -> int:
    """How many steps make a sample so that the fastest pole is resolved."""
    fastest = np.abs(state_matrix_poles(linear)).max(initial=1.0)
    return max(1, int(np.ceil(fastest / FASTEST / sample_rate_hz)))


def stepping_model(mechanism: Mechanism, step_s: float) -> mujoco.MjModel:
    """A lean model for stepping by Runge–Kutta of fourth order: no contacts, constraints, sensors or drives."""
    model = build_spec(mechanism, visual=False, instruments=False).compile()
    model.opt.timestep = step_s
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= int(
        mujoco.mjtDisableBit.mjDSBL_CONTACT
        | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        | mujoco.mjtDisableBit.mjDSBL_SENSOR
        | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    )
    return model


def _filtered(cells: np.ndarray, substeps: int) -> np.ndarray:
    """Mean over the sample before and the sample after each sampling instant of values given per step (…, steps)."""
    means = cells.reshape(*cells.shape[:-1], -1, substeps).mean(axis=-1)
    before = np.concatenate([np.zeros_like(means[..., :1]), means[..., :-1]], axis=-1)
    return 0.5 * (before + means)


def _sharpened(mean: np.ndarray, at_once: np.ndarray) -> np.ndarray:
    """Accelerations (nr, steps) as of a force that is not held over a step, from their means over steps.

    A force held over steps of length T, and means over them, weaken what a mode at ω answers by sinc²(ωT/2), which is 1
    − (ωT)²/12. A second difference undoes that up to (ωT)⁴/240. What moves at once with the force is left as it is: it
    has every frequency.
    """
    late = np.pad(mean - at_once, ((0, 0), (1, 1)))
    return np.asarray(mean - (late[:, 2:] - 2 * late[:, 1:-1] + late[:, :-2]) / 12)


def _turned(direction: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """A unit direction tilted by two small angles (rad) towards the axes across it."""
    across = np.linalg.svd(direction[None])[2][1:]
    tilted = direction + np.tan(angles) @ across
    return tilted / np.linalg.norm(tilted)


def _delayed(signal: np.ndarray, samples: float) -> np.ndarray:
    """A signal (…, nt) late by a fractional number of samples, by the shift theorem on a zero-padded record."""
    if samples == 0:
        return signal
    count = 2 * signal.shape[-1]
    turn = np.exp(-2j * np.pi * np.fft.rfftfreq(count) * samples)
    return np.fft.irfft(np.fft.rfft(signal, count) * turn, count)[..., : signal.shape[-1]]
