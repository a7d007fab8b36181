"""Maximum-likelihood refinement of a modal model, its covariance, and what the data say of each mode.

    G_oi(s) = s² [ Σ_r ψ_or L_ri/(s − λ_r) + conj(ψ_or L_ri)/(s − λ_r*) + lower_oi/s² + upper_oi + s² curvature_oi ]

is fitted to accelerance. Poles λ and participation factors L are found by Gauss–Newton on the variable projection
(Golub & Pereyra 1973) that eliminates shapes ψ and residual terms, which are linear. s = rate + iω puts the poles of
exponentially windowed records back where they were.

The variance of a line is a course over the band times a level per channel. Every channel then shares one Gram matrix of
the functions of s, and a step costs what the modes cost, not what channels times lines cost. A real 2 × 2 block acts on
a complex number as z → α z + β z*. All normal equations are written in such pairs (α, β).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import ComplexArray, FloatArray

RESIDUAL_TERMS = 6  # real coefficients per channel: lower, upper and curvature, each complex
RIDGE = 1e-13  # of the diagonal of the linear normal equations
OUTPUTS_AT_ONCE = 64  # keeps the memory of a step independent of the number of channels
LARGEST_STEP = 0.3  # of a pole, in one iteration


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

    @property
    def residues(self) -> ComplexArray:
        """(nm, no, ni) of receptance, m/(N s)."""
        return np.asarray(self.shape[:, :, None] * self.participation[:, None, :])

    def synthesise(self, s: ComplexArray) -> ComplexArray:
        """Accelerance (nf, no, ni) on the Laplace points s."""
        residue = self.residues.reshape(-1, self.lower.size)
        receptance = (1 / (s[:, None] - self.poles)) @ residue + (1 / (s[:, None] - self.poles.conj())) @ residue.conj()
        s2 = (s**2)[:, None, None]
        return s2 * (receptance.reshape(s.size, *self.lower.shape) + self.upper + s2 * self.curvature) + self.lower


@dataclass(frozen=True)
class Variance:
    """Variance of the real, and of the imaginary, part of a line: ``course[f] channel[o, i]``.

    Attributes:
        course: (nf,) over the band, around 1.
        channel: (no, ni) in (m/s²/N)²; infinite where a channel says nothing.
    """

    course: FloatArray
    channel: FloatArray

    @classmethod
    def of(cls, variance: FloatArray) -> "Variance":
        """The nearest such product of a variance (nf, no, ni): medians over the lines, then over the channels."""
        channel = np.median(variance, axis=0)
        live = np.isfinite(channel) & (channel > 0)
        if not live.any():
            return cls(np.ones(variance.shape[0]), channel)
        return cls(np.median(variance[:, live] / channel[live], axis=1), channel)

    @property
    def weight(self) -> FloatArray:
        """(no, ni) one over the channel's variance."""
        return np.where(np.isfinite(self.channel) & (self.channel > 0), 1 / self.channel, 0.0)

    def whitened(self, frf: ComplexArray) -> ComplexArray:
        """FRFs (nf, no, ni) over the deviation of their real part."""
        return np.asarray(frf / np.sqrt(self.course)[:, None, None] * np.sqrt(self.weight))


@dataclass(frozen=True)
class ModalFit:
    """A fitted model with what the data say about it.

    Attributes:
        model: the fitted modes and residual terms.
        chi2: weighted sum of squared residuals; ``dof`` its degrees of freedom.
        covariance: (nm, 2, 2) of (Re λ, Im λ) for noise of the stated variance.
        wald: (nm,) rise of chi2 when the mode's shape is set to zero and all other shapes are fitted again.
        shift: (nm, no, ni) by how much each channel alone would move the pole, rad/s, to first order.
        shift_weight: (nm, no, ni) one over the noise variance of its real, and of its imaginary, part.
    """

    model: ModalModel
    chi2: float
    dof: int
    covariance: FloatArray
    wald: FloatArray
    shift: ComplexArray
    shift_weight: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """(nm,) Hz."""
        return np.abs(self.model.poles) / (2 * np.pi)

    @property
    def damping(self) -> FloatArray:
        """(nm,) ratio."""
        return -self.model.poles.real / np.abs(self.model.poles)

    @property
    def scale(self) -> float:
        """Chi2 over its degrees of freedom: 1 where the variance is right and the model complete."""
        return self.chi2 / self.dof


class FitData:
    """Accelerance on the lines s, weighted and freed of residual terms; what every fit of a band shares.

    Attributes:
        s: (nf,) Laplace points.
        root: (nf,) one over the deviation of a line.
        residual: (2 nf, 6) orthonormal residual terms over stacked real and imaginary parts.
        g: (2 nf, no·ni) data without what residual terms explain.
        weight: (no, ni).
    """

    def __init__(self, frf: ComplexArray, s: ComplexArray, variance: Variance) -> None:
        nf, self.no, self.ni = frf.shape
        self.s, self.root, self.weight = s, 1 / np.sqrt(variance.course), variance.weight
        self.far = float(np.abs(s**2).max())
        one, far = np.ones((nf, 1)), (s**2)[:, None] / self.far
        terms = self.stacked(np.concatenate([one, 1j * one, far, 1j * far, far**2, 1j * far**2], axis=1))
        self.residual, self.terms = np.linalg.qr(terms)
        whole = self.stacked(frf.reshape(nf, -1))
        self.offset = self.residual.T @ whole
        self.g = whole - self.residual @ self.offset
        self.energy = np.sum(self.g**2, axis=0).reshape(self.no, self.ni)
        self.lines = int(np.count_nonzero(np.isfinite(variance.course)))

    def stacked(self, functions: ComplexArray) -> FloatArray:
        """Weighted functions (nf, k) as real rows (2 nf, k)."""
        weighted = functions * self.root[:, None]
        return np.concatenate([weighted.real, weighted.imag])

    def freed(self, functions: ComplexArray) -> FloatArray:
        """The same without what residual terms explain."""
        rows = self.stacked(functions)
        return rows - self.residual @ (self.residual.T @ rows)


@dataclass(frozen=True)
class _Pair:
    """Real matrices of 2 × 2 blocks as z → α z + β z*; α and β (…, n, m)."""

    alpha: ComplexArray
    beta: ComplexArray

    @classmethod
    def of(cls, matrix: FloatArray) -> "_Pair":
        """From (2n, 2m) with real parts before imaginary parts."""
        n, m = matrix.shape[0] // 2, matrix.shape[1] // 2
        a, b, c, d = (part.astype(complex) for part in (matrix[:n, :m], matrix[:n, m:], matrix[n:, :m], matrix[n:, m:]))
        return cls(np.asarray(((a + d) + 1j * (c - b)) / 2), np.asarray(((a - d) + 1j * (c + b)) / 2))

    def times(self, alpha: ComplexArray, beta: ComplexArray) -> FloatArray:
        """Element by element, as a real matrix (…, 2n, 2m)."""
        a, b = self.alpha * alpha, self.beta * beta
        return np.concatenate(
            [
                np.concatenate([(a + b).real, (b - a).imag], axis=-1),
                np.concatenate([(a + b).imag, (a - b).real], axis=-1),
            ],
            axis=-2,
        )


@dataclass(frozen=True)
class _State:
    """Everything at one set of poles and participation factors."""

    chi2: float
    shape: ComplexArray  # (no, nm)
    inverse: FloatArray  # (no, 2 nm, 2 nm)
    aa: _Pair
    ad: _Pair
    dd: _Pair
    left_a: ComplexArray  # (no, ni, nm): functions times residual
    left_d: ComplexArray
    gram: FloatArray  # (4 nm, 4 nm)


def _functions(poles: ComplexArray, s: ComplexArray) -> ComplexArray:
    """(nf, 4 nm): accelerance of unit real and of unit imaginary residues, and the derivatives of both by the pole."""
    s2 = (s**2)[:, None]
    p, c = 1 / (s[:, None] - poles), 1 / (s[:, None] - poles.conj())
    z, zc = s2 * p, s2 * c
    d, dc = z * p, zc * c
    return np.concatenate([z + zc, 1j * (z - zc), d + dc, 1j * (d - dc)], axis=1)


def _complex(rows: FloatArray) -> ComplexArray:
    """(2n, …) real parts before imaginary parts as (n, …)."""
    n = rows.shape[0] // 2
    return np.asarray(rows[:n] + 1j * rows[n:])


def _linear(data: FitData, poles: ComplexArray, participation: ComplexArray) -> _State:
    """Shapes for given poles (nm,) and participation factors (nm, ni)."""
    nm, no, ni, u = poles.size, data.no, data.ni, data.weight
    h = data.freed(_functions(poles, data.s))
    gram, moment = h.T @ h, h.T @ data.g
    ma = _complex(moment[: 2 * nm]).reshape(nm, no, ni)
    aa = _Pair.of(gram[: 2 * nm, : 2 * nm])
    conj = participation.conj()
    over = u @ (conj[:, None, :] * participation).reshape(nm * nm, ni).T
    mirrored = u @ (conj[:, None, :] * conj).reshape(nm * nm, ni).T
    normal = aa.times(over.reshape(no, nm, nm), mirrored.reshape(no, nm, nm))
    size = np.sqrt(np.einsum("oaa->oa", normal))
    size = np.where(size > 0, size, 1)
    scaled = normal / (size[:, :, None] * size[:, None, :]) + RIDGE * np.eye(2 * nm)
    inverse = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
    rhs = np.einsum("roi,oi,ri->or", ma, u, conj)
    c = np.einsum("oab,ob->oa", inverse, np.concatenate([rhs.real, rhs.imag], axis=1))
    shape = c[:, :nm] + 1j * c[:, nm:]
    residue = (shape[:, None, :] * participation.T).reshape(no * ni, nm)
    x = np.concatenate([residue.real, residue.imag], axis=1)
    left = moment - gram[:, : 2 * nm] @ x.T  # (4 nm, no·ni)
    explained = np.sum(x * (moment + left)[: 2 * nm].T, axis=1).reshape(no, ni)
    chi2 = float(np.sum(u * (data.energy - explained)))
    left_a, left_d = (_complex(half).T.reshape(no, ni, nm) for half in (left[: 2 * nm], left[2 * nm :]))
    ad, dd = _Pair.of(gram[: 2 * nm, 2 * nm :]), _Pair.of(gram[2 * nm :, 2 * nm :])
    return _State(max(chi2, 0.0), shape, inverse, aa, ad, dd, left_a, left_d, gram)


def _wald(state: _State, modes: int) -> FloatArray:
    """(nm,) rise of chi2 without each mode, poles and participation factors of the others held."""
    r = np.arange(modes)
    pair = np.stack([r, modes + r], axis=1)
    block = state.inverse[:, pair[:, :, None], pair[:, None, :]]  # (no, nm, 2, 2)
    both = np.stack([state.shape.real, state.shape.imag], axis=2)
    a, b, d = block[..., 0, 0], block[..., 0, 1], block[..., 1, 1]
    determinant = a * d - b * b
    scale = np.divide(1, determinant, out=np.zeros_like(determinant), where=determinant > 0)
    form = d * both[..., 0] ** 2 - 2 * b * both[..., 0] * both[..., 1] + a * both[..., 1] ** 2
    return np.asarray(np.sum(form * scale, axis=0))


def _normal_equations(data: FitData, state: _State, participation: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Gauss–Newton matrix and gradient over θ = Re λ, Im λ, then Re and Im of every L_ri (Kaufman's projection).

    θ is laid out by complex parameters: λ (nm), L_·1 (nm), …, each with its real before its imaginary parts.
    """
    (nm, ni), u, psi = participation.shape, data.weight, state.shape
    n = 2 * nm
    hessian = np.zeros((n * (1 + ni), n * (1 + ni)))
    residue = psi[:, None, :] * participation.T  # (no, ni, nm)
    flat = (residue * np.sqrt(u)[:, :, None]).reshape(-1, nm)
    hessian[:n, :n] = state.dd.times(flat.conj().T @ flat, flat.conj().T @ flat.conj())
    da = _Pair(state.ad.alpha.conj().T, state.ad.beta.T)
    for i in range(ni):
        at = slice(n * (1 + i), n * (2 + i))
        one, own = residue[:, i].conj().T * u[:, i], psi.conj().T * u[:, i]
        hessian[:n, at] = da.times(one @ psi, one @ psi.conj())
        hessian[at, :n] = hessian[:n, at].T
        hessian[at, at] = state.aa.times(own @ psi, own @ psi.conj())
    over = (u @ (participation.conj()[:, None, :] * participation).reshape(nm * nm, ni).T).reshape(-1, nm, nm)
    mirrored = (u @ (participation.conj()[:, None, :] * participation.conj()).reshape(nm * nm, ni).T).reshape(
        -1, nm, nm
    )
    for start in range(0, data.no, OUTPUTS_AT_ONCE):
        some = slice(start, start + OUTPUTS_AT_ONCE)
        p = psi[some, None, :]
        parts = [state.ad.times(over[some] * p, mirrored[some] * p.conj())]
        for i in range(ni):
            left = u[some, i, None, None] * participation.conj()[None, :, i, None]
            parts.append(state.aa.times(left * p, left * p.conj()))
        cross = np.concatenate(parts, axis=2)  # (outputs, 2 nm, θ)
        solved = state.inverse[some] @ cross
        hessian -= cross.reshape(-1, hessian.shape[0]).T @ solved.reshape(-1, hessian.shape[0])
    slope = [np.einsum("oir,oir,oi->r", residue.conj(), state.left_d, u)]
    slope += [np.einsum("or,or,o->r", psi.conj(), state.left_a[:, i], u[:, i]) for i in range(ni)]
    gradient = np.concatenate([part for z in slope for part in (z.real, z.imag)])
    return (hessian + hessian.T) / 2, gradient


def _free(participation: ComplexArray) -> NDArray[np.intp]:
    """Indices into θ without the largest participation of every mode, which sets the scale."""
    nm, ni = participation.shape
    keep = np.ones((1 + ni, 2, nm), dtype=bool)
    keep[1 + np.argmax(np.abs(participation), axis=1), :, np.arange(nm)] = False
    return np.flatnonzero(keep)


def normalised(participation: ComplexArray) -> ComplexArray:
    """Every row divided by its largest entry."""
    largest = np.take_along_axis(participation, np.argmax(np.abs(participation), axis=1)[:, None], axis=1)
    return np.asarray(participation / np.where(largest == 0, 1, largest))


def _scale(hessian: FloatArray) -> FloatArray:
    """Root of the diagonal; 1 where a parameter moves nothing."""
    diagonal = np.diag(hessian)
    return np.sqrt(np.where(diagonal > 0, diagonal, 1))


def fit_modes(data: FitData, poles: ComplexArray, participation: ComplexArray, iterations: int = 30) -> ModalFit:
    """Fit the modal model from starting poles and participation factors.

    Args:
        data: weighted accelerance.
        poles: (nm,) in rad/s.
        participation: (nm, ni).
        iterations: of Levenberg–Marquardt at most; 0 solves for shapes and residual terms alone.
    """
    nm, ni = poles.size, data.ni
    participation = normalised(participation)
    state = _linear(data, poles, participation)
    damp = 1e-3
    for _ in range(iterations if nm else 0):
        hessian, gradient = _normal_equations(data, state, participation)
        free = _free(participation)
        h, g = hessian[np.ix_(free, free)], gradient[free]
        size = _scale(h)
        h = h / size[:, None] / size
        improved = False
        for _ in range(8):
            step = np.zeros(hessian.shape[0])
            step[free] = np.linalg.solve(h + damp * np.eye(free.size), g / size) / size
            parts = step.reshape(1 + ni, 2, nm)
            change = parts[:, 0] + 1j * parts[:, 1]
            new_poles, new_participation = poles + change[0], normalised(participation + change[1:].T)
            small = np.abs(change[0]) < LARGEST_STEP * np.abs(poles)
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


def _result(data: FitData, poles: ComplexArray, participation: ComplexArray, state: _State) -> ModalFit:
    nm, ni, no = poles.size, data.ni, data.no
    residues = state.shape[:, None, :] * participation.T
    lower, upper, curvature = _residual_terms(data, poles, residues.reshape(no * ni, nm))
    model = ModalModel(poles, participation, state.shape.T, lower, upper / data.far, curvature / data.far**2)
    free = _free(participation)
    live = data.weight > 0
    outputs = int(np.count_nonzero(live.any(axis=1)))
    taken = outputs * 2 * nm + RESIDUAL_TERMS * int(live.sum()) + free.size
    dof = max(2 * data.lines * int(live.sum()) - taken, 1)
    covariance = np.zeros((nm, 2, 2))
    if nm:
        hessian = _normal_equations(data, state, participation)[0][np.ix_(free, free)]
        size = _scale(hessian)
        inverse = np.linalg.pinv(hessian / size[:, None] / size, hermitian=True, rcond=1e-13) / size[:, None] / size
        pair = np.stack([np.arange(nm), nm + np.arange(nm)], axis=1)
        covariance = inverse[pair[:, :, None], pair[:, None, :]]
    shift, weight = _shifts(state, residues, data.weight)
    return ModalFit(model, state.chi2, dof, covariance, _wald(state, nm), shift, weight)


def _residual_terms(
    data: FitData, poles: ComplexArray, residues: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Residual terms (no, ni) left once the modes with residues (no·ni, nm) are taken off."""
    functions = data.stacked(_functions(poles, data.s)[:, : 2 * poles.size])
    explained = functions @ np.concatenate([residues.real, residues.imag], axis=1).T
    found = np.linalg.solve(data.terms, data.offset - data.residual.T @ explained)
    terms = found.T.reshape(data.no, data.ni, RESIDUAL_TERMS)
    lower, upper, curvature = (terms[:, :, n] + 1j * terms[:, :, n + 1] for n in (0, 2, 4))
    return lower, upper, curvature


def _shifts(state: _State, residues: ComplexArray, u: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """By how much each channel alone would move each pole, its own residues free, and the weight of that.

    First order: the residual of a channel regressed on the derivative of the mode by its pole, freed of all modes.
    """
    nm = residues.shape[2]
    n = 2 * nm
    gram = state.gram
    size = _scale(gram)
    scaled = gram / size[:, None] / size
    aa = scaled[:n, :n] + RIDGE * np.eye(n)
    back = np.linalg.solve(aa, scaled[:n, n:]) if nm else np.zeros((0, 0))
    sizes = size[n:]
    information = np.diag(scaled[n:, n:] - scaled[n:, :n] @ back) * sizes**2
    kappa = np.maximum((information[:nm] + information[nm:]) / 2, 1e-300)
    left_a = np.concatenate([state.left_a.real, state.left_a.imag], axis=2) / size[:n]
    pull = (left_a @ back) * sizes
    moment = state.left_d - (pull[..., :nm] + 1j * pull[..., nm:])
    power = np.abs(residues) ** 2
    shift = np.divide(moment * residues.conj(), kappa * power, out=np.zeros_like(moment), where=power > 0)
    return np.moveaxis(shift, 2, 0), np.moveaxis(kappa * power * u[:, :, None], 2, 0)


def channel_shifts(data: FitData, fit: ModalFit, known: FloatArray, spread: FloatArray) -> FloatArray:
    """By how much each channel's poles lie apart from the fitted ones along the imaginary axis, (nm, no, ni) in rad/s.

    Best linear unbiased prediction of random effects (Henderson, Biometrics 31, 1975): all modes of a channel
    together, its residues free.

    Args:
        data: already freed of ``known``.
        fit: of ``data``.
        known: (nm, no, ni) shifts so far.
        spread: (nm,) their deviation from channel to channel, rad/s.
    """
    state, nm = _linear(data, fit.model.poles, fit.model.participation), fit.model.poles.size
    n, size = 2 * nm, _scale(state.gram)
    scaled = state.gram / size[:, None] / size
    back = np.linalg.solve(scaled[:n, :n] + RIDGE * np.eye(n), scaled[:n, n:])
    freed = (scaled[n:, n:] - scaled[n:, :n] @ back) * size[n:, None] * size[n:]
    left_a = np.concatenate([state.left_a.real, state.left_a.imag], axis=2).reshape(-1, n) / size[:n]
    left_d = np.concatenate([state.left_d.real, state.left_d.imag], axis=2).reshape(-1, n)
    moment = left_d - (left_a @ back) * size[n:]
    residues = fit.model.residues.reshape(nm, -1).T
    along = np.stack([-residues.imag, residues.real], axis=1)  # (channels, 2, nm)
    information = np.einsum("cpr,prqs,cqs->crs", along, freed.reshape(2, nm, 2, nm), along, optimize=True)
    pull = np.einsum("cpr,cpr->cr", along, moment.reshape(-1, 2, nm))
    u, prior = data.weight.ravel()[:, None], 1 / spread**2
    before = known.reshape(nm, -1).T
    matrix = u[:, :, None] * information + np.diag(prior)
    step = np.linalg.solve(matrix, (u * pull - prior * before)[..., None])[..., 0]
    return np.asarray((before + step).T.reshape(known.shape))


def deviations(poles: ComplexArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(nm,) standard deviations of frequency in Hz and of the damping ratio, for (nm, 2, 2) of (Re λ, Im λ)."""
    re, im, size = poles.real, poles.imag, np.abs(poles)
    by_f = np.stack([re, im], axis=1) / size[:, None] / (2 * np.pi)
    by_z = np.stack([-(im**2), re * im], axis=1) / size[:, None] ** 3
    f, z = (np.einsum("ra,rab,rb->r", by, covariance, by) for by in (by_f, by_z))
    return np.sqrt(np.maximum(f, 0)), np.sqrt(np.maximum(z, 0))
