"""What an FRF lacks that was made from a record which ends while the structure still rings.

After a blow a mode answers with R e^{λt}. Cut off at T, its transform is R (1 − e^{(λ−s)T}) / (s − λ). After a short
blow the FRF lacks, per newton of the blow's own transform,

    L(s) = C g(A) B,    g(λ) = λᵖ e^{(λ−s)T + (λ²−s²)m/2} / (s − λ).

T counts from the middle of the blow. m is the blow's second moment about there: its transform is P e^{ms²/2} to second
order.

A is that of ẏ = A y, B the velocities after a unit blow, C the channels and p the power of s in what is recorded. Where
A changes, so does g(A). In the eigenvectors of A, ∂g(A)ᵢⱼ = ∂Aᵢⱼ (gᵢ − gⱼ)/(λᵢ − λⱼ), and ∂Aᵢᵢ g'(λᵢ) where i = j
(Higham, Functions of Matrices, 2008, theorem 3.11).
"""

import numpy as np

from twin.model.linear import state_matrix
from twin.model.sensitivity import ComplexArray, FloatArray, Observed

LARGEST = 0.0  # exponent: what an unstable model leaks does not grow
FADED = -20.0  # real part of a pole times the record: of a mode e^−20 is left, which no FRF shows
EQUAL = 1e-9  # of their size: poles that are closer have one function
MASSLESS = 1e-9  # of the largest inertia: what a coordinate without one is given, so that its pole is a number


def leakage(seen: Observed, s: ComplexArray, power: int, record_s: float, spread_s: float) -> ComplexArray:
    """L (nf, nr, ne), SI per newton: H(s) less what a record shows of it.

    Args:
        seen: the structure; channels that share a sensor's mass are taken to be without it.
        s: (nf,) Laplace points in 1/s; the rate of an exponential window is their real part.
        power: of s in the quantity over receptance.
        record_s: length of the record from the middle of the blow on, s.
        spread_s: root of the second moment of the blow about its middle, s; of a half-sine 0.218 of its length.
    """
    return leakage_slopes(seen, None, s, power, record_s, spread_s)[0]


def leakage_later(seen: Observed, s: ComplexArray, power: int, record_s: float, spread_s: float) -> ComplexArray:
    """∂L/∂T (nf, nr, ne), per second by which a blow came earlier in the record: of g(λ) it is (λ − s) g(λ)."""
    nv, M = len(seen.M), _with_mass(seen.M)
    pole, V, inverse = _vectors(state_matrix(M, seen.C, seen.K, seen.loss, seen.integral))
    C, B = seen.J_r @ V[:nv], inverse[:, nv : 2 * nv] @ np.linalg.solve(M, seen.J_e.T)
    g, _ = _left(pole, s, power, record_s, spread_s)
    return _gain(seen, s) * np.einsum("rk,fk,ke->fre", C, (pole - s[:, None]) * g, B, optimize=True)


def leakage_slopes(
    seen: Observed, rate: Observed | None, s: ComplexArray, power: int, record_s: float, spread_s: float
) -> tuple[ComplexArray, ComplexArray]:
    """L (nf, nr, ne) and its derivatives (n, nf, nr, ne); ``rate`` has those of ``seen``, ``None`` for none."""
    nv, M = len(seen.M), _with_mass(seen.M)
    A = state_matrix(M, seen.C, seen.K, seen.loss, seen.integral)
    pole, V, inverse = _vectors(A)
    inverse = inverse[:, nv : 2 * nv]  # of velocities
    struck = np.linalg.solve(M, seen.J_e.T)
    own = pole.real * record_s > FADED
    C, B = seen.J_r @ V[:nv, own], inverse[own] @ struck
    g, steeper = _left(pole[own], s, power, record_s, spread_s)
    gain = _gain(seen, s)
    mode = C.T[:, :, None] * B[:, None]  # (k, nr, ne)
    L = gain * (g @ mode.reshape(len(mode), C.shape[0] * B.shape[1])).reshape(len(s), *mode.shape[1:])
    if rate is None:
        return L, np.zeros((0, *L.shape), complex)
    kept = np.flatnonzero(seen.integral.any(axis=0))
    forces = np.concatenate([rate.K + 1j * rate.loss, rate.C, rate.integral[:, :, kept]], axis=2)
    pull = np.linalg.solve(M, rate.M @ A[nv : 2 * nv] + forces)
    change = -inverse @ (pull @ V)
    between = pole[:, None] - pole
    alone = np.abs(between) <= EQUAL * (np.abs(pole[:, None]) + np.abs(pole))
    tied = change * np.where(alone, 0.0, 1 / np.where(alone, 1.0, between))
    moved = np.diagonal(change, axis1=1, axis2=2)[:, own, None, None]  # poles
    kick = inverse[own] @ np.linalg.solve(M, rate.J_e.swapaxes(1, 2) - rate.M @ struck)
    dB = tied[:, own] @ (inverse @ struck) + kick
    dC = rate.J_r @ V[:nv, own] - seen.J_r @ V[:nv] @ tied[:, :, own]
    dmode = C.T[:, :, None] * dB[:, :, None] + dC.swapaxes(1, 2)[:, :, :, None] * B[:, None]
    parts = np.concatenate([dmode, moved * mode], axis=1)
    shape = len(parts), parts.shape[1], L[0].size  # none may ring still
    dL = (np.concatenate([g, steeper], axis=1) @ parts.reshape(shape)).reshape(len(parts), *L.shape)
    dL *= gain
    louder = rate.gain[:, None] / seen.gain - s[:, None] * rate.delay[:, None]
    some = louder.any(axis=(1, 2))
    dL[some] += L * louder[some][:, :, :, None]
    return L, dL


def _left(
    pole: ComplexArray, s: ComplexArray, power: int, record_s: float, spread_s: float
) -> tuple[ComplexArray, ComplexArray]:
    """g and g' (nf, n) of poles (n,)."""
    apart = s[:, None] - pole
    fast = (np.abs(pole) * spread_s > 1) & ((pole**2).real > 0)  # overdamped: faded long before
    second = np.where(fast, 0.0, spread_s**2)
    left = -apart * (record_s + 0.5 * second * (s[:, None] + pole))
    fade = np.exp(np.minimum(left.real, LARGEST) + 1j * left.imag) / apart
    steeper = power * pole ** max(power - 1, 0) + pole**power * (record_s + second * pole + 1 / apart)
    return pole**power * fade, fade * steeper


def _with_mass(M: FloatArray) -> FloatArray:
    return np.asarray(M + MASSLESS * np.diag(M).max() * np.eye(len(M)))


def _gain(seen: Observed, s: ComplexArray) -> ComplexArray:
    return np.asarray((seen.gain * np.exp(-s[:, None] * seen.delay))[:, :, None])


def _vectors(A: ComplexArray | FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles, eigenvectors and their inverse.

    A coordinate without a spring may have one eigenvector for two poles. Then they are those of a neighbour of A, whose
    poles lie ``EQUAL`` of the largest apart.
    """
    pole, V = np.linalg.eig(A)
    try:
        return pole, V, np.linalg.inv(V)
    except np.linalg.LinAlgError:
        pole, V = np.linalg.eig(A + np.diag(EQUAL * np.abs(pole).max(initial=1.0) * np.linspace(-1, 1, len(A))))
        return pole, V, np.linalg.inv(V)
