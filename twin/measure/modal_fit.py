"""Maximum-likelihood refinement of a modal model, its covariance, and the test whether the data hold each mode.

    G_oi(s) = s² [ Σ_r ψ_or L_ri/(s − λ_r) + conj(ψ_or L_ri)/(s − λ_r*) + lower_oi/s² + upper_oi + s² curvature_oi ]

is fitted to accelerance with every line weighted by one over its variance. Poles λ and participation factors L are
found by Gauss–Newton on the variable projection (Golub & Pereyra 1973) that eliminates shapes ψ and residual terms,
which are linear. s = rate + iω puts the poles of exponentially windowed records back where they were.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import ComplexArray, FloatArray

RESIDUAL_TERMS = 6  # real coefficients per channel: lower, upper and curvature, each complex
BEYOND = 1.3  # how far past the ends of the band, as a ratio, modes are looked for
SCAN_DAMPINGS = (0.003, 0.01, 0.03, 0.08)
RIDGE = 1e-13  # of the diagonal of the linear normal equations


@dataclass(frozen=True)
class ModalModel:
    """Modes r = 1 … nm over no outputs and ni references, in receptance.

    Attributes:
        poles: (nm,) rad/s.
        participation: (nm, ni), largest entry 1.
        shape: (nm, no): residues are ``shape[r, o] participation[r, i]``.
        lower, upper, curvature: (no, ni) residual terms in 1/kg, m/N and m s²/N.
    """

    poles: ComplexArray
    participation: ComplexArray
    shape: ComplexArray
    lower: ComplexArray
    upper: ComplexArray
    curvature: ComplexArray

    def synthesise(self, s: ComplexArray) -> ComplexArray:
        """Accelerance (nf, no, ni) on the Laplace points s."""
        residue = np.einsum("ro,ri->roi", self.shape, self.participation).reshape(-1, self.lower.size)
        receptance = (1 / (s[:, None] - self.poles)) @ residue + (1 / (s[:, None] - self.poles.conj())) @ residue.conj()
        s2 = (s**2)[:, None, None]
        return s2 * (receptance.reshape(s.size, *self.lower.shape) + self.upper + s2 * self.curvature) + self.lower


@dataclass(frozen=True)
class ModalFit:
    """A fitted model with what the data say about it.

    Attributes:
        model: the fitted modes and residual terms.
        chi2: weighted sum of squared residuals; ``dof`` its degrees of freedom.
        covariance: (nm, 2, 2) of (Re λ, Im λ), scaled by chi2/dof.
        wald: (nm,) rise of chi2 when the mode's shape is set to zero and everything linear refitted.
    """

    model: ModalModel
    chi2: float
    dof: int
    covariance: FloatArray
    wald: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """(nm,) Hz."""
        return np.abs(self.model.poles) / (2 * np.pi)

    @property
    def damping(self) -> FloatArray:
        """(nm,) ratio."""
        return -self.model.poles.real / np.abs(self.model.poles)

    def deviations(self) -> tuple[FloatArray, FloatArray]:
        """(nm,) standard deviations of frequency in Hz and of the damping ratio."""
        re, im, size = self.model.poles.real, self.model.poles.imag, np.abs(self.model.poles)
        by_f = np.stack([re, im], axis=1) / size[:, None] / (2 * np.pi)
        by_z = np.stack([-(im**2), re * im], axis=1) / size[:, None] ** 3
        f, z = (np.einsum("ra,rab,rb->r", by, self.covariance, by) for by in (by_f, by_z))
        return np.sqrt(np.maximum(f, 0)), np.sqrt(np.maximum(z, 0))


@dataclass(frozen=True)
class _Data:
    """Weighted accelerance on the lines s: ``w2`` (nf, no·ni) is one over the variance of the real part."""

    s: ComplexArray
    g: ComplexArray  # (nf, no·ni)
    w2: FloatArray
    no: int
    ni: int
    common: FloatArray | None  # (nf,) profile when all channels share it up to a factor

    @classmethod
    def of(cls, frf: ComplexArray, s: ComplexArray, variance: FloatArray) -> "_Data":
        nf, no, ni = frf.shape
        w2 = (1 / variance).reshape(nf, -1)
        total = w2.mean(axis=0)
        profile = w2 / np.where(total > 0, total, 1)
        live = profile[:, total > 0]
        common = live[:, 0] if live.size and np.allclose(live, live[:, :1], rtol=1e-9) else None
        return cls(s, frf.reshape(nf, -1), w2, no, ni, common)

    def gram(self, h: ComplexArray) -> FloatArray:
        """(no, ni, K, K) of Σ w² Re(h_a* h_b) over the lines, h (nf, K)."""
        stacked = np.concatenate([h.real, h.imag])
        if self.common is not None:
            w2 = np.concatenate([self.common, self.common])
            scale = self.w2.mean(axis=0).reshape(self.no, self.ni)
            return scale[:, :, None, None] * ((stacked * w2[:, None]).T @ stacked)
        w2 = np.concatenate([self.w2, self.w2])
        k = h.shape[1]
        gram = np.empty((self.w2.shape[1], k, k))
        for a in range(k):
            gram[:, a, a:] = w2.T @ (stacked[:, a : a + 1] * stacked[:, a:])
            gram[:, a:, a] = gram[:, a, a:]
        return gram.reshape(self.no, self.ni, k, k)

    def moment(self, h: ComplexArray) -> FloatArray:
        """(no, ni, K) of Σ w² Re(h_a* g)."""
        wg = self.w2 * self.g
        return (wg.real.T @ h.real + wg.imag.T @ h.imag).reshape(self.no, self.ni, -1)

    def energy(self) -> float:
        return float(np.sum(self.w2 * np.abs(self.g) ** 2))


def _pair(poles: ComplexArray, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Accelerance (nf, nm) of unit real and of unit imaginary residues."""
    s2 = (s**2)[:, None]
    z, zc = s2 / (s[:, None] - poles), s2 / (s[:, None] - poles.conj())
    return z + zc, 1j * (z - zc)


def _functions(poles: ComplexArray, s: ComplexArray) -> ComplexArray:
    """(nf, 4 nm + 6) real-coefficient functions: modes (Re, Im), their pole derivatives, residual terms."""
    s2 = (s**2)[:, None]
    z, zc = s2 / (s[:, None] - poles), s2 / (s[:, None] - poles.conj())
    d, dc = z / (s[:, None] - poles), zc / (s[:, None] - poles.conj())
    one = np.ones_like(s2)
    far = s2 / np.abs(s2).max()
    return np.concatenate(
        [z + zc, 1j * (z - zc), d + dc, 1j * (d - dc), one, 1j * one, far, 1j * far, far**2, 1j * far**2], axis=1
    )


@dataclass(frozen=True)
class _State:
    """Everything at one set of poles and participation factors."""

    chi2: float
    coefficients: FloatArray  # (no, 2 nm + 4 ni)
    shape: ComplexArray
    normal: FloatArray
    gram: FloatArray
    gradient_data: FloatArray  # (no, ni, K): moment − gram · solution
    basis: FloatArray  # (ni, K, 2 nm + 4 ni)
    wald: FloatArray


def _linear(data: _Data, poles: ComplexArray, participation: ComplexArray) -> _State:
    """Shapes and residual terms for given poles and participation factors."""
    nm, ni = poles.size, data.ni
    h = _functions(poles, data.s)
    k, columns = h.shape[1], 2 * nm + RESIDUAL_TERMS * ni
    gram, moment = data.gram(h), data.moment(h)
    basis = np.zeros((ni, k, columns))
    r, i = np.arange(nm), np.arange(ni)[:, None]
    p, q = participation.real.T, participation.imag.T  # (ni, nm)
    basis[i, r, r], basis[i, nm + r, r] = p, q
    basis[i, r, nm + r], basis[i, nm + r, nm + r] = -q, p
    t = np.arange(RESIDUAL_TERMS)
    basis[i, 4 * nm + t, 2 * nm + RESIDUAL_TERMS * i + t] = 1
    normal = np.einsum("ika,oikl,ilb->oab", basis, gram, basis, optimize=True)
    rhs = np.einsum("ika,oik->oa", basis, moment, optimize=True)
    size = np.sqrt(np.einsum("oaa->oa", normal))
    size = np.where(size > 0, size, 1)
    scaled = normal / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(columns)
    inverse = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
    c = np.einsum("oab,ob->oa", inverse, rhs)
    solution = np.einsum("ika,oa->oik", basis, c)
    left = moment - np.einsum("oikl,oil->oik", gram, solution)
    chi2 = data.energy() - float(np.sum(solution * (moment + left)))
    pair = np.stack([r, nm + r], axis=1)
    block = inverse[:, pair[:, :, None], pair[:, None, :]]  # (no, nm, 2, 2)
    both = c[:, pair]
    wald = np.einsum("ora,orab,orb->r", both, _inverse2(block), both)
    return _State(max(chi2, 0.0), c, (c[:, :nm] + 1j * c[:, nm : 2 * nm]).T, inverse, gram, left, basis, wald)


def _inverse2(m: FloatArray) -> FloatArray:
    """Inverse of symmetric 2 × 2 matrices (…, 2, 2), zero where there is none."""
    a, b, d = m[..., 0, 0], m[..., 0, 1], m[..., 1, 1]
    determinant = a * d - b * b
    scale = np.divide(1, determinant, out=np.zeros_like(determinant), where=determinant > 0)
    return scale[..., None, None] * np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)


def _normal_equations(state: _State, ni: int) -> tuple[FloatArray, FloatArray]:
    """Gauss–Newton matrix and gradient over θ = Re λ, Im λ, then Re and Im of every L_ri (Kaufman's projection)."""
    psi = state.shape  # (nm, no)
    nm, no = psi.shape
    k = state.gram.shape[-1]
    a, b = psi.real.T, psi.imag.T  # (no, nm)
    v = np.zeros((no, ni, k, 2 * nm + 2 * nm * ni))
    r = np.arange(nm)
    p = state.basis[:, r, r]  # (ni, nm): participation
    q = state.basis[:, nm + r, r]
    u = a[:, None] * p - b[:, None] * q  # (no, ni, nm): Re and Im of the residue
    w = a[:, None] * q + b[:, None] * p
    v[:, :, 2 * nm + r, r], v[:, :, 3 * nm + r, r] = u, w
    v[:, :, 2 * nm + r, nm + r], v[:, :, 3 * nm + r, nm + r] = -w, u
    for i in range(ni):
        re, im = 2 * nm + i * nm + r, 2 * nm + (ni + i) * nm + r
        v[:, i, r, re], v[:, i, nm + r, re] = a, b
        v[:, i, r, im], v[:, i, nm + r, im] = -b, a
    gv = state.gram @ v
    cross = np.einsum("ika,oikt->oat", state.basis, gv, optimize=True)
    hessian = np.einsum("oiks,oikt->st", v, gv, optimize=True) - np.einsum(
        "oas,oab,obt->st", cross, state.normal, cross, optimize=True
    )
    return hessian, np.einsum("oikt,oik->t", v, state.gradient_data, optimize=True)


def _free(participation: ComplexArray) -> NDArray[np.intp]:
    """Indices into θ without the largest participation of every mode, which sets the scale."""
    nm, ni = participation.shape
    keep = np.ones((2, ni, nm), dtype=bool)
    keep[:, np.argmax(np.abs(participation), axis=1), np.arange(nm)] = False
    return np.concatenate([np.arange(2 * nm), 2 * nm + np.flatnonzero(keep)])


def normalised(participation: ComplexArray) -> ComplexArray:
    """Every row divided by its largest entry."""
    largest = np.take_along_axis(participation, np.argmax(np.abs(participation), axis=1)[:, None], axis=1)
    return np.asarray(participation / np.where(largest == 0, 1, largest))


def _scale(hessian: FloatArray) -> FloatArray:
    """Root of the diagonal; 1 where a parameter moves nothing."""
    diagonal = np.diag(hessian)
    return np.sqrt(np.where(diagonal > 0, diagonal, 1))


def fit_modes(
    frf: ComplexArray,
    s: ComplexArray,
    variance: FloatArray,
    poles: ComplexArray,
    participation: ComplexArray,
    iterations: int = 30,
) -> ModalFit:
    """Fit the modal model from starting poles and participation factors.

    Args:
        frf: (nf, no, ni) accelerance.
        s: (nf,) Laplace points.
        variance: (nf, no, ni) of the real, and of the imaginary, part; infinite where a line says nothing.
        poles: (nm,) in rad/s.
        participation: (nm, ni).
        iterations: of Levenberg–Marquardt at most; 0 solves for shapes and residual terms alone.
    """
    data = _Data.of(frf, s, variance)
    nm, ni = poles.size, data.ni
    participation = normalised(participation)
    state = _linear(data, poles, participation)
    damp = 1e-3
    for _ in range(iterations if nm else 0):
        hessian, gradient = _normal_equations(state, ni)
        free = _free(participation)
        h, g = hessian[np.ix_(free, free)], gradient[free]
        size = _scale(h)
        h = h / size[:, None] / size
        improved = False
        for _ in range(8):
            step = np.zeros(hessian.shape[0])
            step[free] = np.linalg.solve(h + damp * np.eye(free.size), g / size) / size
            new_poles = poles + step[:nm] + 1j * step[nm : 2 * nm]
            change = step[2 * nm :].reshape(2, ni, nm)
            new_participation = normalised(participation + (change[0] + 1j * change[1]).T)
            small = np.abs(new_poles - poles) < 0.3 * np.abs(poles)
            if (new_poles.real < 0).all() and (new_poles.imag > 0).all() and small.all():
                new = _linear(data, new_poles, new_participation)
                if new.chi2 < state.chi2:
                    improved = True
                    break
            damp = max(damp * 8, 1e-6)
        if not improved:
            break
        gain, moved = state.chi2 - new.chi2, np.max(np.abs(new_poles - poles) / np.abs(poles))
        poles, participation, state, damp = new_poles, new_participation, new, damp / 10
        if gain < 1e-3 * state.chi2 / data.g.size or moved < 1e-10:  # a thirtieth of a deviation
            break
    return _result(data, poles, participation, state)


def _result(data: _Data, poles: ComplexArray, participation: ComplexArray, state: _State) -> ModalFit:
    nm, ni, no = poles.size, data.ni, data.no
    terms = state.coefficients[:, 2 * nm :].reshape(no, ni, RESIDUAL_TERMS)
    lower, upper, curvature = (terms[:, :, n] + 1j * terms[:, :, n + 1] for n in (0, 2, 4))
    far = np.abs(data.s**2).max()
    model = ModalModel(poles, participation, state.shape, lower, upper / far, curvature / far**2)
    free = _free(participation)
    lines = 2 * int(np.count_nonzero(data.w2))
    dof = max(lines - no * (2 * nm + RESIDUAL_TERMS * ni) - free.size, 1)
    covariance = np.zeros((nm, 2, 2))
    if nm:
        hessian = _normal_equations(state, ni)[0][np.ix_(free, free)]
        size = _scale(hessian)
        inverse = np.linalg.pinv(hessian / size[:, None] / size, hermitian=True, rcond=1e-13) / size[:, None] / size
        pair = np.stack([np.arange(nm), nm + np.arange(nm)], axis=1)
        covariance = inverse[pair[:, :, None], pair[:, None, :]] * state.chi2 / dof
    return ModalFit(model, state.chi2, dof, covariance, state.wald)


def without(fit: ModalFit, mode: int) -> tuple[ComplexArray, ComplexArray]:
    """Poles and participation factors of a fit with one mode left out."""
    return np.delete(fit.model.poles, mode), np.delete(fit.model.participation, mode, axis=0)


def strongest_missing(
    residual: ComplexArray, s: ComplexArray, variance: FloatArray, frequency: FloatArray
) -> tuple[complex, ComplexArray, ComplexArray, float]:
    """The mode that would explain most of a residual: pole, shape (no,), participation factors (ni,), drop of chi2.

    A generalised likelihood ratio test on a grid of frequencies and dampings, with a free residue per channel.
    """
    nf, no, ni = residual.shape
    w2 = (1 / variance).reshape(nf, -1)
    wg = w2 * residual.reshape(nf, -1)
    step = (frequency[-1] - frequency[0]) / (nf - 1)
    low, high = frequency[0] / BEYOND, frequency[-1] * BEYOND
    best = (0j, np.zeros(no, dtype=complex), np.zeros(ni, dtype=complex), 0.0)
    for damping in SCAN_DAMPINGS:
        ratio = 1 + max(damping / 2, step / frequency[-1] / 4)
        grid = low * ratio ** np.arange(int(np.log(high / low) / np.log(ratio)) + 1)
        grid = grid[np.concatenate([[True], np.diff(np.floor(2 * grid / step)) > 0])]  # two per line are enough
        for some in np.array_split(grid, max(1, grid.size // 32)):
            reach = 10 * (damping * some[-1] + step)  # a mode is seen on the lines around it
            lines = (frequency >= some[0] - reach) & (frequency <= some[-1] + reach)
            found = _best_of(
                2 * np.pi * some * (-damping + 1j * np.sqrt(1 - damping**2)), s[lines], w2[lines], wg[lines]
            )
            if found is not None and found[2] > best[3]:
                pole, residue, gain = found
                u, _, vh = np.linalg.svd(residue.reshape(no, ni), full_matrices=False)
                best = pole, u[:, 0], vh[0], gain
    return best


def _best_of(
    poles: ComplexArray, s: ComplexArray, w2: FloatArray, wg: ComplexArray
) -> tuple[complex, ComplexArray, float] | None:
    """The pole that explains most of weighted residuals wg (nf, channels), its residues and its gain."""
    if not s.size:
        return None
    u, v = _pair(poles, s)
    uu, vv, uv = (np.abs(u) ** 2).T @ w2, (np.abs(v) ** 2).T @ w2, (u.conj() * v).real.T @ w2
    gu, gv = (u.real.T @ wg.real + u.imag.T @ wg.imag), (v.real.T @ wg.real + v.imag.T @ wg.imag)
    determinant = uu * vv - uv**2
    live = determinant > 1e-12 * uu * vv
    inverse = np.divide(1, determinant, out=np.zeros_like(determinant), where=live)
    gains = np.sum((vv * gu**2 - 2 * uv * gu * gv + uu * gv**2) * inverse, axis=1)
    top = int(np.argmax(gains))
    a, b = (vv * gu - uv * gv)[top] * inverse[top], (uu * gv - uv * gu)[top] * inverse[top]
    return complex(poles[top]), np.asarray(a + 1j * b), float(gains[top])
