"""A hammer blow on a robot with one nonlinear joint, in time: what the joint adds to its spring.

The robot is linear but for one torque g(φ) at joint coordinate j. So its response to a force F(s) is

    H(s) = H_lin(s) − G_j(s) T(s)/F(s),    T the transform of g along the decay,

with G_j the linear response to a torque at j. Only g needs stepping, less its tangent at rest, which belongs to the
linear part there. Over a step g is the parabola through its last three values, or a straight line where it has a kink
(:meth:`Law.line`). What the modes of the linear part make of it, and of the force's half sine, is exact. φ at the end
of a step depends on g there. Two fixed-point iterations settle this: g changes φ within a step by ω²h²/6 of itself at
most.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from twin.measure.campaign import ComplexArray, FloatArray
from twin.model.linear import state_matrix
from twin.model.sensitivity import Observed
from twin.physics.joint_law import Law

RATE_HZ, COARSE_HZ = 512.0, 256.0  # of stepping: what it leaves of a smooth law is 1e-4, 5e-4 of an FRF
SETTLED = -10.0  # a mode that decays by e to this over a step follows g
LARGEST_DEFLECTION = 0.01  # rad (m): no blow deflects a joint further
LONGEST = 0.1  # of what is recorded: a trial's blow may take longer, and is not stepped
COLUMNS = 1200  # stepped together: more no longer fit in the cache


@dataclass(frozen=True)
class Strike:
    """Blows of one peak force on one posture.

    Attributes:
        seen: the linear part; ``joint`` the coordinate with the law, ``k`` its spring, ``load`` (N·m) the weight on it.
        peak_n: peak of the half sine, N; ``pulse_s`` its length.
        sizes: (m,) parameters of the law.
    """

    seen: Observed
    joint: int
    k: float
    load: float
    peak_n: float
    pulse_s: float
    sizes: FloatArray

    def tangent(self, law: Law) -> float:
        """What the law adds to the spring for small motions about rest, N·m/rad (N/m)."""
        k, load, sizes = np.array([self.k]), np.array([self.load]), self.sizes[:, None]
        return float(law.tangent(law.rest(k, load, sizes), sizes)[0])


def pulse_transform(s: ComplexArray, pulse_s: float) -> ComplexArray:
    """Laplace transform (nf,) of a half sine of height 1 and length ``pulse_s``."""
    omega = np.pi / pulse_s
    s = s + 1e-6 * omega  # off the removable pole
    return np.asarray(omega * (1 + np.exp(-s * pulse_s)) / (s**2 + omega**2))


def _drive(pole: ComplexArray, pulse_s: float, steps: int, rate_hz: float = RATE_HZ) -> ComplexArray:
    """What a half sine of height 1 adds to modes over each of some steps, (steps, m): ∫ e^{λ(h−t)} sin πt/T dt."""
    omega = np.pi / pulse_s
    start = np.minimum(np.arange(steps) / rate_hz, pulse_s)[:, None]
    end = (1 + np.arange(steps)[:, None]) / rate_hz

    def primitive(t: FloatArray) -> ComplexArray:
        wave = pole * np.sin(omega * t) + omega * np.cos(omega * t)
        return np.asarray(-np.exp(pole * (end - t)) * wave / (pole**2 + omega**2))

    return primitive(np.minimum(end, pulse_s)) - primitive(start)


def transform(s: ComplexArray, g: FloatArray, rate_hz: float = RATE_HZ) -> ComplexArray:
    """Transform (nf, ne) of the parabolas through samples g (nt, ne), which stays as it ends: a play, a slip shifts."""
    real, imaginary = _transform(s.tobytes(), len(g), rate_hz)
    return np.asarray(real @ g + 1j * (imaginary @ g))


@lru_cache(maxsize=8)
def _transform(line: bytes, samples: int, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Real and imaginary part (nf, nt): products of real matrices take half the time."""
    s = np.frombuffer(line, complex)
    half = s / (2 * rate_hz)
    hold = (np.sinh(half) / half) ** 2 / (1 + half**2 / 3) / rate_hz
    matrix = np.exp(-s[:, None] * (np.arange(samples) / rate_hz))
    matrix[:, -1] /= 1 - np.exp(-s / rate_hz)
    matrix *= hold[:, None]
    return np.ascontiguousarray(matrix.real), np.ascontiguousarray(matrix.imag)


def torques(
    strikes: Sequence[Strike], law: Law, length_s: float, rate_hz: float = RATE_HZ
) -> list[tuple[FloatArray, FloatArray]]:
    """What the law adds after every blow, strike by strike; NaN for blows that no hammer gives.

    The first result is g (samples, ne) in N·m about its value and tangent at rest. The second is the largest deflection
    (ne,) of the joint from rest.
    """
    if max(strike.pulse_s for strike in strikes) > LONGEST * length_s:
        nothing = [np.full(strike.seen.J_e.shape[0], np.nan) for strike in strikes]
        return [(np.tile(one, (round(length_s * rate_hz), 1)), one) for one in nothing]
    law = law.stepped(rate_hz)
    ends = np.cumsum([strike.seen.J_e.shape[0] for strike in strikes])
    found: list[tuple[FloatArray, FloatArray]] = []
    while (start := len(found)) < len(strikes):
        before = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + COLUMNS, side="right")))
        found += _torques(strikes[start:stop], law, round(length_s * rate_hz), rate_hz)
    return found


def _torques(strikes: Sequence[Strike], law: Law, samples: int, rate_hz: float) -> list[tuple[FloatArray, FloatArray]]:
    slopes = [strike.tangent(law) for strike in strikes]
    blows = [strike.seen.J_e.shape[0] for strike in strikes]
    fade, kick, early, late, own, push = _columns(strikes, _modal(strikes, slopes, rate_hz), blows, rate_hz)
    driven, modes, total = push.shape
    k, load = (np.repeat([getattr(strike, name) for strike in strikes], blows) for name in ("k", "load"))
    tangent = np.repeat(slopes, blows)
    sizes = np.repeat(np.array([strike.sizes for strike in strikes]).T, blows, axis=1)
    z, moved = np.zeros_like(fade), np.empty_like(fade)
    rest = law.rest(k, load, sizes)
    state = law.state(total)
    if len(state):
        state[-1] = rest
    torque, state = law.torque(rest, k, sizes, state)
    offset, bends = torque - tangent * rest, bool(tangent.any())
    z[-2] = rest
    most, least = rest + LARGEST_DEFLECTION, rest - LARGEST_DEFLECTION  # a size far off must not let a trial overflow
    x, g, free = rest, np.zeros(total), np.empty(total)
    pushed = np.zeros(total, complex)  # g as z is: numpy converts it for every mode else, which takes longer
    highest, lowest = rest.copy(), rest.copy()
    out, kinks = np.zeros((samples, total)), []

    def beside(torque: FloatArray, x: FloatArray) -> FloatArray:
        """What the law adds about its value and tangent at rest."""
        g = torque - offset
        if bends:
            g -= tangent * x
        return g

    for step in range(1, samples):
        z *= fade
        pushed.real = g
        np.multiply(kick, pushed, out=moved)
        z += moved
        if step <= driven:
            z[:modes] += push[step - 1]
        np.add.reduce(z.real, axis=0, out=free)
        left, was = x, torque
        x = free + own * g
        x = free + own * beside(law.torque(x, k, sizes, state)[0], x)
        np.minimum(x, most, out=x)
        np.maximum(x, least, out=x)
        torque, state = law.torque(x, k, sizes, state)
        g = beside(torque, x)
        out[step] = g
        bent = law.line((left, x), (was, torque), k, sizes)
        if bent is not None:
            across, start, end = bent
            z[:modes, across] += early.take(across, 1) * start + late.take(across, 1) * end
            kinks.append((np.full(len(across), step), across, start, end))
        np.maximum(highest, x, out=highest)
        np.minimum(lowest, x, out=lowest)
    if kinks:
        at_step, across, start, end = (np.concatenate(part) for part in zip(*kinks, strict=True))
        out[at_step - 1, across] += start / 3 + end / 6
        out[at_step, across] += start / 6 + end / 3
    largest = np.maximum(highest - rest, rest - lowest)
    edges = np.cumsum(blows)[:-1]
    return list(zip(np.split(out, edges, axis=1), np.split(largest, edges), strict=True))


def _columns(
    strikes: Sequence[Strike], parts: "Sequence[_Modal]", blows: Sequence[int], rate_hz: float
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, FloatArray, ComplexArray]:
    """Propagation of every blow's modes over a step (modes, c), each in units of what it adds to φ.

    The results are the modes' decay and what g adds to them a step later, both with two rows more. Those rows are what
    φ is at rest, and what it has less a step after g. Next are what g adds to the modes at the start and at the end of
    its line. Last are what g adds to φ at once (c,), and the blows' push (steps, modes, c).
    """
    modes, total = max(len(part.fade) for part in parts), sum(blows)
    fade, kick = (np.zeros((modes + 2, total), complex) for _ in range(2))
    early, late = (np.zeros((modes, total), complex) for _ in range(2))
    driven = max(int(np.ceil(strike.pulse_s * rate_hz)) for strike in strikes)
    push = np.zeros((driven, modes, total), complex)
    at = 0
    for strike, part, count in zip(strikes, parts, blows, strict=True):
        span, m = slice(at, at + count), len(part.fade)
        fade[:m, span] = part.fade[:, None]
        early[:m, span], late[:m, span] = (part.read * part.early_g)[:, None], (part.read * part.late_g)[:, None]
        kick[:m, span] = (part.read * part.next_g)[:, None]
        kick[-1, span] = -float((part.read * part.once_g).sum().real)
        drive = strike.peak_n * _drive(part.pole, strike.pulse_s, driven, rate_hz)
        push[:, :m, span] = drive[:, :, None] * (part.read[:, None] * part.into)
        at += count
    fade[-2] = 1.0
    own = np.repeat([float((part.read * part.now_g).sum().real) for part in parts], blows)
    return fade, kick, early, late, own, push


@dataclass(frozen=True)
class _Modal:
    """Propagation of the modes over one step (m,).

    Attributes:
        pole, fade: poles and decay; ``read`` reading of φ.
        early_g, late_g: input of a torque's line at its start and end.
        now_g, next_g: input of the torque's samples to φ at their own time, and to the modes a step later.
        once_g: what φ has less of then.
        into: (m, ne) input of the blows.
    """

    pole: ComplexArray
    fade: ComplexArray
    read: ComplexArray
    early_g: ComplexArray
    late_g: ComplexArray
    now_g: ComplexArray
    next_g: ComplexArray
    once_g: ComplexArray
    into: ComplexArray


def _modal(strikes: Sequence[Strike], tangents: Sequence[float], rate_hz: float) -> list[_Modal]:
    modes: dict[tuple[Any, ...], tuple[ComplexArray, ComplexArray]] = {}
    known: dict[tuple[Any, ...], _Modal] = {}
    found = []
    for strike, slope in zip(strikes, tangents, strict=True):
        seen = strike.seen
        matrices = seen.M, seen.C, seen.K, seen.loss, seen.integral
        free = *(id(one) for one in matrices), strike.joint, slope
        if free not in modes:  # blows elsewhere move the same modes
            modes[free] = _free(seen, strike.joint, slope)
        if (*free, id(seen.J_e)) not in known:
            known[*free, id(seen.J_e)] = _modes(seen, strike.joint, *modes[free], rate_hz)
        found.append(known[*free, id(seen.J_e)])
    return found


def _free(seen: Observed, joint: int, tangent: float) -> tuple[ComplexArray, ComplexArray]:
    """Poles (m,) of the linear part and the law's tangent, and their shapes (·, m)."""
    K = seen.K + tangent * np.diag(np.eye(len(seen.M))[joint])
    pole, vector = np.linalg.eig(state_matrix(seen.M, seen.C, K, seen.loss, seen.integral))
    return pole, vector


def _modes(seen: Observed, joint: int, pole: ComplexArray, vector: ComplexArray, rate_hz: float) -> _Modal:
    nv = len(seen.M)
    lossy = bool(seen.loss.any())  # of conjugate poles only the one above the real axis is then the robot's
    into = np.zeros((len(pole), 1 + len(seen.J_e)), complex)
    into[nv : 2 * nv] = np.linalg.solve(seen.M, np.column_stack([-np.eye(nv)[joint], seen.J_e.T]))
    inputs = np.asarray(np.linalg.solve(vector, into), complex)
    keep = np.flatnonzero(pole.imag > 0 if lossy else pole.imag >= 0)  # the conjugates give twice the real part
    pole, inputs = pole[keep], inputs[keep]
    read = vector[joint, keep] * np.where(pole.imag > 0, 2.0, 1.0)
    w = pole / rate_hz
    fade = np.exp(w)
    late = (fade - 1 - w) / (w * pole)  # ∫ e^{λ(h−t)} t/h dt
    early = (fade - 1) / pole - late
    # The parabola adds its bow times the second difference: to φ one, minus two and one steps' worth. All but that of
    # the step after g's own are the modes' decay, so that g enters them once.
    bow = np.where(w.real > SETTLED, -0.5 * _bow(np.asarray(w, complex)) / rate_hz, 0)
    once = np.where(w.real > SETTLED, bow / fade, 0)
    now = late + bow
    following = fade * now + early - 2 * bow + once
    g = inputs[:, 0]
    return _Modal(pole, fade, read, early * g, late * g, now * g, following * g, once * g, inputs[:, 1:])


def _bow(w: ComplexArray) -> ComplexArray:
    """∫ e^{w(1−t)} t (1 − t) dt over a step."""
    slow = np.abs(w) < 1
    near, far = np.where(slow, w, 0), np.where(slow, 1, w)
    series, term = np.zeros_like(w), np.full_like(w, 1 / 6)
    for k in range(18):
        series = series + (k + 1) * term
        term = term * near / (k + 4)
    return np.where(slow, series, ((far - 2) * np.exp(far) + far + 2) / far**3)
