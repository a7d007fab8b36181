"""Hammer blows in time: the structure with its nonlinear joints, stepped from rest to the end of the record.

Between steps the linear part is propagated exactly (matrix exponential, inputs linear over a step); only the
nonlinear joint torque is approximated, implicit and of second order. Deflections of a blow are below a
milliradian, so geometry and M stay those of the posture.
"""

import numpy as np
from scipy.linalg import expm
from scipy.signal import zoom_fft

from tools.truth.chain import Array
from tools.truth.effects import TruthError
from tools.truth.elastic import Structure
from tools.truth.laws import Complex


def half_sine(peak: Array, width_s: float, rate_hz: float) -> Array:
    """Force of a soft-tipped hammer, (nt, nb) N: half sines of given peaks (nb,)."""
    t = np.arange(int(np.ceil(width_s * rate_hz)) + 1) / rate_hz
    return np.where(t < width_s, np.sin(np.pi * t / width_s), 0.0)[:, None] * np.asarray(peak)


def strike(
    structure: Structure, response: Array, excitation: Array, force: Array, rate_hz: float, samples: int
) -> Array:
    """Accelerations (samples, nr, nb) at rows `response` (nr, n) after nb blows from rest.

    Blow b pushes along row `excitation[b]` with `force[:, b]` N, sampled at `rate_hz` and zero afterwards.
    """
    if structure.dynamic:
        raise TruthError("blows in time: expected effects with a law in time; one here is defined in frequency only")
    n, blows = len(structure.names), len(excitation)
    inverse = np.linalg.inv(structure.mass)
    drift = -inverse @ np.hstack([structure.stiffness, structure.damping])
    # Inputs: accelerations from the blows and from each nonlinear joint torque.
    joints = list(structure.laws)
    unit = np.zeros((2 * n, n))
    unit[n:] = np.eye(n)
    a = np.zeros((4 * n, 4 * n))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n] = drift
    a[: 2 * n, 2 * n : 3 * n] = unit
    a[2 * n : 3 * n, 3 * n :] = np.eye(n) * rate_hz
    step = expm(a / rate_hz)
    forward, total, late = step[: 2 * n, : 2 * n], step[: 2 * n, 2 * n : 3 * n], step[: 2 * n, 3 * n :]
    early = total - late
    push = inverse @ excitation.T
    push_early, push_late = early @ push, late @ push
    torque = -inverse[:, joints]
    torque_early, torque_late = early @ torque, late @ torque
    laws = [structure.laws[j] for j in joints]
    rest = [law.rest(structure.preload[j]) for law, j in zip(laws, joints, strict=True)]
    states = [law.start((blows,)) for law in laws]
    offset = []
    for m, law in enumerate(laws):
        value, states[m] = law.extra(np.full(blows, rest[m]), np.zeros(blows), states[m])
        offset.append(value)

    x, g = np.zeros((2 * n, blows)), np.zeros((len(joints), blows))
    out = np.empty((samples, len(response), blows))
    read, read_torque = response @ drift, response @ torque
    ends = len(force)
    for k in range(samples):
        out[k] = read @ x + read_torque @ g
        x = forward @ x + torque_early @ g
        if k < ends:
            x += push_early * force[k]
            if k + 1 < ends:
                x += push_late * force[k + 1]
        if not joints:
            continue
        for _ in range(2):
            y = [x[j] + torque_late[j] @ g for j in joints], [x[n + j] + torque_late[n + j] @ g for j in joints]
            new = [law.extra(rest[m] + y[0][m], y[1][m], states[m]) for m, law in enumerate(laws)]
            g = np.array([value - offset[m] for m, (value, _) in enumerate(new)])
        states = [state for _, state in new]
        x += torque_late @ g
    out[:ends] += (response @ push) * force[:samples, None, :]
    return out


def transform(signal: Array, rate_hz: float, frequency: Array, decay: float = 0.0) -> Complex:
    """∫ x e^{−st} dt at s = decay + 2πif, along axis 0, for evenly spaced `frequency` (nf,) Hz."""
    t = np.arange(len(signal)) / rate_hz
    windowed = signal * np.exp(-decay * t).reshape(-1, *(1,) * (signal.ndim - 1))
    if len(frequency) == 1:
        return np.tensordot(np.exp(-2j * np.pi * frequency[:, None] * t), windowed, 1) / rate_hz
    band = [frequency[0], frequency[-1]]
    return zoom_fft(windowed, band, m=len(frequency), fs=rate_hz, endpoint=True, axis=0) / rate_hz
