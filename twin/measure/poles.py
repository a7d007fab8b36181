"""From frequency response functions to poles of every model order: pLSCF and LSCE, one and many references.

Both fit G(s) = B(z) A(z)⁻¹ with matrix polynomials in z = e^{sΔt}: pLSCF on the frequency lines, LSCE on the impulse
response. A₀ = I sends the roots that only fit noise outside the unit circle, where they are recognised by their
negative damping. Shapes and participation factors are the null vectors of A at its roots.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from twin.measure.campaign import ComplexArray, FloatArray

CONJUGATE_BAND = 0.3  # a band that starts below this share of its end is treated as conjugate-symmetric about 0 Hz
ARC = 0.8  # share of the unit circle a shifted band is spread over: the gap takes up what lies outside the band
BEYOND = 0.2  # of the band: poles this far outside it are kept, as they bend what is inside
RIDGE = 1e-14  # of the trace: keeps the normal equations of a noise-free recording solvable


@dataclass(frozen=True)
class Poles:
    """What one model order holds inside the band, n poles with positive frequency and damping.

    Attributes:
        order: order of the matrix polynomial A.
        poles: (n,) λ in rad/s.
        shape: (n, no) over the outputs, unit norm.
        participation: (n, ni) over the references, unit norm.
    """

    order: int
    poles: ComplexArray
    shape: ComplexArray
    participation: ComplexArray

    @property
    def frequency(self) -> FloatArray:
        """(n,) undamped natural frequency |λ|/2π in Hz."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping(self) -> FloatArray:
        """(n,) damping ratio −Re λ/|λ|."""
        return -self.poles.real / np.abs(self.poles)


@dataclass(frozen=True)
class _Circle:
    """How a band is laid on the unit circle: z = exp(i (ω − origin) Δt), real coefficients where it starts near 0."""

    origin: float
    dt: float
    real: bool

    @classmethod
    def of(cls, frequency: FloatArray) -> "_Circle":
        low, high = 2 * np.pi * frequency[0], 2 * np.pi * (2 * frequency[-1] - frequency[-2])
        if low <= CONJUGATE_BAND * high:
            return cls(0.0, np.pi / high, True)
        return cls(low, ARC * 2 * np.pi / (high - low), False)

    def z(self, frequency: FloatArray) -> ComplexArray:
        return np.exp(1j * (2 * np.pi * frequency - self.origin) * self.dt)

    def poles(self, z: ComplexArray) -> ComplexArray:
        """Inverse of :meth:`z`; a shifted band takes the whole circle, cut in the middle of its gap."""
        turn = 0.0 if self.real else np.pi * ARC
        s = np.log(z * np.exp(-1j * turn)) + 1j * turn
        return np.asarray(s / self.dt + 1j * self.origin)


def plscf(
    frf: ComplexArray, frequency: FloatArray, orders: Iterable[int], weight: FloatArray | None = None
) -> list[Poles]:
    """Poly-reference least-squares complex frequency-domain estimates (Peeters et al., Shock and Vibration 11, 2004).

    The numerator polynomials carry the residual terms of modes outside the band.

    Args:
        frf: (nf, no, ni) with the references last.
        frequency: (nf,) in Hz, evenly spaced.
        orders: polynomial orders; order p has p·ni roots.
        weight: (nf, no) one over the standard deviation of each line.
    """
    nf, no, ni = frf.shape
    orders = sorted(orders)
    top = orders[-1]
    circle = _Circle.of(frequency)
    w2 = np.ones((nf, no)) if weight is None else weight**2
    w2 = w2 / np.sum(w2[:, :, None] * np.abs(frf) ** 2, axis=(0, 2)).mean()
    lag = np.arange(-top, top + 1)
    basis = circle.z(frequency)[:, None] ** lag  # (nf, lag)
    part = np.real if circle.real else np.asarray
    r = part(basis.T @ w2)  # (lag, no)
    s = part(basis.T @ (-w2[:, :, None] * frf).reshape(nf, -1)).reshape(-1, no, ni)
    t = part(basis.T @ np.einsum("fo,foi,foj->fij", w2, frf.conj(), frf).reshape(nf, -1)).reshape(-1, ni, ni)
    toeplitz = np.arange(top + 1)[None, :] - np.arange(top + 1)[:, None] + top  # lag l − k at row k, column l
    r_full = np.moveaxis(r[toeplitz], 2, 0)  # (no, k, l)
    s_full = np.transpose(s[toeplitz], (2, 0, 1, 3))  # (no, k, l, ni)
    t_full = np.transpose(t[toeplitz], (0, 2, 1, 3))  # (k, i, l, j)

    result = []
    for p in orders:
        n = p + 1
        r_p = r_full[:, :n, :n]
        trace = np.trace(r_p, axis1=1, axis2=2)[:, None, None]
        ridge = np.where(trace > 0, RIDGE * trace, 1) * np.eye(n)  # 1: an output without weight takes no part
        s_p = s_full[:, :n, :n].reshape(no, n, n * ni)
        numerator = -np.linalg.solve(r_p + ridge, s_p)  # coefficients of B per unit of A
        m = t_full[:n, :, :n].reshape(n * ni, n * ni) + np.einsum("oka,okb->ab", s_p.conj(), numerator, optimize=True)
        a = _denominator(m, ni)
        b = numerator @ a.reshape(n * ni, ni)  # (no, n, ni)
        result.append(_roots(a, b, circle, frequency, p))
    return result


def _denominator(m: ComplexArray | FloatArray, ni: int) -> ComplexArray | FloatArray:
    """(p+1, ni, ni) coefficients A_k minimising tr(Aᴴ M A) with A₀ = I."""
    free = m[ni:, ni:]
    ridge = RIDGE * np.trace(free).real * np.eye(free.shape[0])
    rest = -np.linalg.solve(free + ridge, m[ni:, :ni])
    return np.concatenate([np.eye(ni, dtype=m.dtype), rest]).reshape(-1, ni, ni)


def _roots(
    a: ComplexArray | FloatArray,
    b: ComplexArray | FloatArray | None,
    circle: _Circle,
    frequency: FloatArray,
    order: int,
) -> Poles:
    """Roots of det A inside the band, with their null vectors; ``b`` (no, p+1, ni) maps them to shapes."""
    n, ni = a.shape[0] - 1, a.shape[1]
    companion = np.zeros((n * ni, n * ni), dtype=a.dtype)
    companion[:ni] = -np.concatenate(list(a[1:]), axis=1)
    companion[ni:, :-ni] = np.eye((n - 1) * ni)
    w = np.linalg.eigvals(companion)  # of the reversed polynomial: 1/z, monic because A₀ = I
    w = w[np.abs(w) > 1e-3]
    z = np.asarray(1 / w, dtype=np.complex128)
    poles = circle.poles(z)
    keep = (poles.real < 0) & (poles.imag > 0)
    edge = BEYOND * (frequency[-1] - frequency[0])
    hertz = np.abs(poles) / (2 * np.pi)
    keep &= (hertz >= frequency[0] - edge) & (hertz <= frequency[-1] + edge)
    keep[keep] = -poles[keep].real < 0.5 * np.abs(poles[keep])
    z, poles = z[keep], poles[keep]
    rank = np.argsort(np.abs(poles))
    z, poles = z[rank], poles[rank]
    power = z[:, None] ** np.arange(n + 1)
    u, _, vh = np.linalg.svd(np.einsum("rk,kij->rij", power, a))
    participation = u[:, :, -1].conj()
    right = vh[:, -1, :].conj()
    shape = right if b is None else np.einsum("rk,oki,ri->ro", power, b, right, optimize=True)
    norm = np.linalg.norm(shape, axis=1, keepdims=True)
    return Poles(order, poles, np.asarray(shape / np.where(norm > 0, norm, 1), dtype=np.complex128), participation)


def impulse_response(frf: ComplexArray, frequency: FloatArray) -> tuple[ComplexArray | FloatArray, float, float]:
    """Impulse responses (nt, no, ni) of a band, their Δt in s and the frequency in rad/s that the band starts from.

    A band that starts near 0 Hz gives real responses with Δt = 1/(2 f_hi). Any other is shifted to start at 0, which
    gives complex responses with Δt = 1/(f_hi − f_lo): no mirror image, so no bias in frequency.
    """
    step = (frequency[-1] - frequency[0]) / (frequency.size - 1)
    if frequency[0] <= CONJUGATE_BAND * frequency[-1]:
        missing = round(frequency[0] / step)
        full = np.concatenate([np.zeros((missing, *frf.shape[1:]), dtype=complex), frf])
        response = np.fft.irfft(full, axis=0)
        return response, 1 / (2 * step * (full.shape[0] - 1)), 0.0
    return np.fft.ifft(frf, axis=0), 1 / (step * frequency.size), 2 * np.pi * frequency[0]


def lsce(frf: ComplexArray, frequency: FloatArray, orders: Iterable[int]) -> list[Poles]:
    """Least-squares complex exponential estimates, poly-reference when ni > 1 (Brown et al. 1979, Vold et al. 1982).

    The first samples, which carry the residual terms, and the last quarter, which carries their wrap-around, are left
    out. LSCE has no numerator: ``shape`` is the participation's counterpart over the references.

    Args:
        frf: (nf, no, ni) with the references last.
        frequency: (nf,) in Hz, evenly spaced.
        orders: polynomial orders; order p has p·ni roots.
    """
    orders = sorted(orders)
    response, dt, origin = impulse_response(frf, frequency)
    nt, _, ni = response.shape
    response = response[2 : nt * 3 // 4]
    circle = _Circle(origin, dt, not np.iscomplexobj(response))
    response = response / np.linalg.norm(response)
    result = []
    for p in orders:
        rows = response.shape[0] - p
        blocks = np.stack([response[k : k + rows] for k in range(p + 1)], axis=2)  # (row, no, k, ni)
        h = blocks.reshape(-1, (p + 1) * ni)
        result.append(_roots(_denominator(np.asarray(h.conj().T @ h), ni), None, circle, frequency, p))
    return result
