"""Hammer blows in time: the structure with its nonlinear joints, stepped from rest to the end of the record.

Between steps the linear part is propagated exactly (matrix exponential, inputs linear over a step); only the
nonlinear joint torque is approximated, implicit and of second order. Deflections of a blow are below a
milliradian, so geometry and M stay those of the posture.
"""

from dataclasses import replace

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
    _check(structure)
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


def _check(structure: Structure) -> None:
    if structure.dynamic:
        raise TruthError("blows in time: expected effects with a law in time; one here is defined in frequency only")


def nonlinear_frf(
    structures: list[Structure],
    responses: list[Array],
    excitations: list[Array],
    force: Array,
    rate_hz: float,
    samples: int,
    frequency: Array,
    decay: float,
) -> list[Complex]:
    """Receptances (nf, nr, nb) of nonlinear structures, one per posture, each struck by the same forces (nt, nb).

    Response = linear response to the blow + linear response to the nonlinear joint torques g(t). Only g needs time
    stepping, in the modes of the linear part and for all postures at once; the rest is done in frequency. Stepping
    ends with the record, where motion lingers: so what a law adds to its spring at rest belongs to the linear part,
    and what a slip or a play has shifted at the end stays shifted.
    """
    linear = [_at_rest(structure) for structure in structures]
    together = max(1, 400 // len(excitations[0]))  # columns that fit in the cache, and in memory as time goes
    g: list[Array] = []
    for i in range(0, len(structures), together):
        chosen = slice(i, i + together)
        g += joint_torques(structures[chosen], linear[chosen], excitations[chosen], force, rate_hz, samples)
    s = decay + 2j * np.pi * frequency
    blow = transform(force, rate_hz, frequency, decay)[:, None, :]
    found = []
    for structure, response, excitation, torque in zip(linear, responses, excitations, g, strict=True):
        joints = np.eye(len(structure.names))[list(structure.laws)]
        shifted = torque[-1] * (np.exp(-s * samples / rate_hz) / (1 - np.exp(-s / rate_hz)) / rate_hz)[:, None, None]
        reaction = (transform(torque, rate_hz, frequency, decay) + shifted) / blow
        plain = structure.receptance(s, response, excitation)
        found.append(plain - structure.receptance(s, response, joints) @ reaction)
    return found


def _at_rest(structure: Structure) -> Structure:
    """With the stiffness that laws add at vanishing amplitude, where they add any; a free play takes some away."""
    k = structure.stiffness.copy()
    for joint, law in structure.laws.items():
        k[joint, joint] += max(0.0, law.tangent(structure.preload[joint])[0])
    return replace(structure, stiffness=k)


def joint_torques(
    structures: list[Structure],
    linear: list[Structure],
    excitations: list[Array],
    force: Array,
    rate_hz: float,
    samples: int,
) -> list[Array]:
    """Torques (samples, nlaw, nb) that nonlinear joints add to the springs of each linear part after a blow."""
    parts = [_modal(structure, rows, rate_hz) for structure, rows in zip(linear, excitations, strict=True)]
    modes = max(part[0].shape[0] for part in parts)

    def side_by_side(index: int) -> Array:
        columns = [part[index] for part in parts]
        pads = [((0, modes - c.shape[0]), *((0, 0),) * (c.ndim - 1)) for c in columns]
        return np.concatenate([np.pad(c, pad) for c, pad in zip(columns, pads, strict=True)], axis=-1)

    # (mode, column): decay over a step, blow and torque inputs at its start and end, reading of φ and φ̇.
    fade, push_early, push_late = (side_by_side(i) for i in range(3))
    torque_early, torque_late, read = (side_by_side(i) for i in range(3, 6))
    columns = fade.shape[1]
    waves = np.tile(force, (1, len(structures)))
    each = np.repeat(np.arange(len(structures)), [len(rows) for rows in excitations])
    laws, rest, states, offset, added = [], [], [], [], []
    for m in range(len(structures[0].laws)):
        by_posture = [list(structure.laws.items())[m] for structure in structures]
        laws.append(replace(by_posture[0][1], k=np.array([law.k for _, law in by_posture])[each]))
        rest.append(
            np.array([law.rest(s.preload[j]) for s, (j, law) in zip(structures, by_posture, strict=True)])[each]
        )
        value, state = laws[m].extra(rest[m], np.zeros(columns), laws[m].start((columns,)))
        offset.append(value)
        states.append(state)
        joint = [j for j, _ in by_posture]
        stiffer = [b.stiffness[j, j] - a.stiffness[j, j] for a, b, j in zip(structures, linear, joint, strict=True)]
        added.append(np.array(stiffer)[each])

    count = len(laws)
    # φ and φ̇ of joint a answer a torque at joint b at the end of the same step, (2, a, b, column).
    own = np.einsum("mxac,mbc->xabc", read, torque_late).real
    z, g = np.zeros(fade.shape, complex), np.zeros((count, columns))
    out = np.empty((samples, count, columns))
    for k in range(samples):
        out[k] = g
        z *= fade
        for b in range(count):
            z += torque_early[:, b] * g[b]
        if k < len(waves):
            z += push_early * waves[k]
            if k + 1 < len(waves):
                z += push_late * waves[k + 1]
        free = (
            np.einsum("mxac,mc->xac", read, z).real if count > 1 else (read[:, :, 0] * z[:, None]).sum(0).real[:, None]
        )
        for _ in range(2):
            x, v = free + np.einsum("xabc,bc->xac", own, g)
            new = [law.extra(rest[m] + x[m], v[m], states[m]) for m, law in enumerate(laws)]
            g = np.array([value - offset[m] - added[m] * x[m] for m, (value, _) in enumerate(new)])
        states = [state for _, state in new]
        for b in range(count):
            z += torque_late[:, b] * g[b]
    return np.split(out, np.cumsum([len(rows) for rows in excitations])[:-1], axis=-1)


def _modal(structure: Structure, excitation: Array, rate_hz: float) -> tuple[Array, ...]:
    """Modal propagation of the linear part over a step, inputs linear in between; last axis: blows.

    Conjugate pairs are kept once and read twice.
    """
    _check(structure)
    n, blows, joints = len(structure.names), len(excitation), list(structure.laws)
    inverse = np.linalg.inv(structure.mass)
    drift = -inverse @ np.hstack([structure.stiffness, structure.damping])
    roots, vectors = np.linalg.eig(np.vstack([np.eye(2 * n)[n:], drift]))
    into = np.linalg.inv(vectors)[:, n:] @ inverse
    keep = roots.imag >= 0
    roots, vectors, into = roots[keep], vectors[:, keep] * np.where(roots[keep].imag > 0, 2, 1), into[keep]
    w = roots / rate_hz
    # ∫ e^{λ(h−t)} (1 − t/h) dt and ∫ e^{λ(h−t)} t/h dt
    late = (np.exp(w) - 1 - w) / (w * roots)
    early = (np.exp(w) - 1) / roots - late
    push, torque = into @ excitation.T, -into[:, joints]
    read = np.stack([vectors[joints], vectors[[n + j for j in joints]]]).transpose(2, 0, 1)
    return (
        np.repeat(np.exp(w)[:, None], blows, 1),
        early[:, None] * push,
        late[:, None] * push,
        np.repeat((early[:, None] * torque)[:, :, None], blows, 2),
        np.repeat((late[:, None] * torque)[:, :, None], blows, 2),
        np.repeat(read[..., None], blows, 3),
    )


def transform(signal: Array, rate_hz: float, frequency: Array, decay: float = 0.0) -> Complex:
    """∫ x e^{−st} dt at s = decay + 2πif, along axis 0, for evenly spaced `frequency` (nf,) Hz."""
    t = np.arange(len(signal)) / rate_hz
    windowed = signal * np.exp(-decay * t).reshape(-1, *(1,) * (signal.ndim - 1))
    if len(frequency) == 1:
        return np.tensordot(np.exp(-2j * np.pi * frequency[:, None] * t), windowed, 1) / rate_hz
    band = [frequency[0], frequency[-1]]
    return zoom_fft(windowed, band, m=len(frequency), fs=rate_hz, endpoint=True, axis=0) / rate_hz
