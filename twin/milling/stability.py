"""Stability of milling: the delay equation solved by a spectral method, all modes, all multipliers.

The tip's motion under a cut of depth b obeys

    r(t) = ∫ h(t − s) F(s) ds,   F(s) = b A(s) [r(s) − r(s − τ)],   A(s + τ) = A(s),

with the impulse response h of :class:`twin.milling.tool_point.ToolModes`. Only where a tooth cuts is r needed. It is
collocated on Gauss–Legendre nodes there, and h is integrated against the nodes' polynomials. So free flight and modes
of any number cost nothing more and are exact. This is the integral equation of the mode-by-mode solution; compare
Butcher, Bobrenkov, Bueler and Nindujarla, J. Comput. Nonlinear Dyn. 4, 2009, for collocation of the differential
equation.

A multiplier μ (growth of the vibration from tooth to tooth) is a solution of det(I − b W(μ)) = 0, with

    W(μ) = (1 − 1/μ) [L + Σ_k α_k β_k/(μ − e^{λ_k τ})].

Process damping adds the force −b D(s) ṙ(s), and ṙ where a tooth cuts to what is collocated; it has no delay.

At the limit |μ| = 1. The eigenvalues 1/b of W(e^{iθ}) that are real and positive, 0 < θ ≤ π, are *all* limits in depth
at a speed, whatever lies below them. No depth is stepped through, so no island is missed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twin.errors import InputError
from twin.milling import forces
from twin.milling.cut import Cut
from twin.milling.tool_point import ToolModes
from twin.milling.zeroth_order import limiting_depth

NODES = 0.8  # per digit, beyond what the phase advance asks
DIGITS = 5.0  # decimal digits asked of the collocation
STEP = 0.5  # of θ, over the distance to the nearest pole of W
WIDEST = 0.15  # rad, of θ
ROUNDS = 12  # of bisection of θ at most
MOST_SWINGS = 150  # of a mode while a tooth cuts: nodes, of which memory takes the cube
POLISH = 8  # steps of regula falsi on a crossing, at most
REAL = 1e-8  # of an eigenvalue: an imaginary part that is none
DEEPER = 3.0  # times deeper, where no limit is found
FIRST_LOOK = 2.0  # times the depth above which the bound on eigenvalues allows a limit
REACH, FARTHER = 16.0, 8.0  # times the closed form that nodes resolve the motion for at first, and times deeper then
STILL = 1e-4  # of 1/depth: a mode that can add no more to the eigenvalues is static compliance
LIVE = 0.1  # of 1/depth: modes that can add as much set the fastest vibration that a cut feeds
LATE = 0.01  # of 1/depth: what a faster mode may add otherwise than static compliance, at the deepest looked at
PATIENCE = 150.0  # rad that the fastest motion may advance in a tooth period for all depths to be looked at together
AHEAD = 4.0  # times the closed form, the depth that is looked at first where it advances by more
CHUNK = 1_000_000  # elements of matrices whose eigenvalues are taken at a time


@dataclass(frozen=True)
class Nodes:
    """Where a tooth cuts, collocated: m nodes, p chip directions.

    Attributes:
        phase, weight: (m,) of the tooth period.
        element: (m,) number of the element that each lies in; ``start``, ``length`` (ne,) of the elements.
        chip: (m, p, 3) directions n that chips are measured along.
        force: (m, 3 axes, 3 coefficients, p) force per depth, chip and unit coefficient.
    """

    phase: np.ndarray
    weight: np.ndarray
    element: np.ndarray
    start: np.ndarray
    length: np.ndarray
    chip: np.ndarray
    force: np.ndarray


def collocate(cut: Cut, phase_advance: float, depth_m: float = 0.0, digits: float = DIGITS) -> Nodes:
    """Nodes for a cut, enough for vibrations that advance by at most ``phase_advance`` rad in a tooth period."""
    spans = forces.elements(cut, depth_m)
    pitch = 2 * np.pi / cut.tool.teeth
    phase, weight, element = [], [], []
    for number, (start, end) in enumerate(spans):
        turn = (end - start) * (phase_advance + 2 * pitch)  # of the fastest e^{iκt} inside the element
        if turn > 2 * np.pi * MOST_SWINGS:
            text = f"a mode swings {turn / 2 / np.pi:.0f} times while a tooth cuts"
            raise InputError(
                "spindle speed", "", f"{text}; expected a faster spindle, so that it is {MOST_SWINGS} or less"
            )
        count = int(np.ceil(0.5 * turn + digits * NODES))
        x, w = np.polynomial.legendre.leggauss(count)
        phase.append(start + (end - start) * (x + 1) / 2)
        weight.append((end - start) * w / 2)
        element.append(np.full(count, number))
    at = np.concatenate(phase)
    tensor = forces.periodic(cut, at, depth_m)
    if cut.tool.helix_deg * depth_m == 0 and forces.most_teeth(cut) == 1:
        angle = forces.tooth_angles(cut, at)
        angle = angle[np.arange(len(at)), np.argmax(angle < cut.arc[1], axis=1)]
        force, chip = forces.directions(angle)
        chip, force = chip[:, None, :], force[..., None]
    else:
        chip, force = np.broadcast_to(np.eye(3)[:2], (len(at), 2, 3)), tensor
    return Nodes(
        at, np.concatenate(weight), np.concatenate(element), spans[:, 0], spans[:, 1] - spans[:, 0], chip, force
    )


@dataclass(frozen=True)
class Operator:
    """The parts of W for a batch of S cuts (speeds, draws): nm poles, size m·p; p twice with process damping.

    Attributes:
        turn: (S, nm) e^{λτ}.
        alpha: (S, mp, nm), beta: (S, nm, mp); conjugate pairs are held once.
        volterra: (S, mp, mp) real, L.
        nodes: the collocation.
        force: (S, m, 3, p), of chips, then of their speeds times τ.
        delayed: (mp,) whether what a tooth period before was counts too: 1 for chips, 0 for speeds.
    """

    turn: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    volterra: np.ndarray
    nodes: Nodes
    force: np.ndarray
    delayed: np.ndarray

    def at(self, rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """W(e^{iθ}) (n, mp, mp) for batch rows (n,) at angles (n,)."""
        mu = np.exp(1j * theta)[:, None]
        turn, alpha, beta = self.turn[rows], self.alpha[rows], self.beta[rows]
        W = (alpha / (mu - turn)[:, None, :]) @ beta + (alpha / (mu.conj() - turn)[:, None, :] @ beta).conj()
        return (1 - mu.conj() * self.delayed)[:, :, None] * (W + self.volterra[rows])

    def monodromy(self, row: int, depth_m: float) -> np.ndarray:
        """Monodromy matrix over a tooth period on (modal states and conjugates, chips of the period before)."""
        alpha = np.concatenate([self.alpha[row], self.alpha[row].conj()], axis=1)
        beta = np.concatenate([self.beta[row], self.beta[row].conj()])
        turn = np.concatenate([self.turn[row], self.turn[row].conj()])
        L = depth_m * self.volterra[row]
        inverse = np.linalg.inv(np.eye(len(L)) - L)
        now = np.hstack([inverse @ alpha, -inverse @ L * self.delayed])  # chips from (states, chips before)
        before = np.hstack([np.zeros_like(alpha), np.diag(self.delayed)])
        later = np.hstack([np.diag(turn), np.zeros_like(beta)]) + depth_m * beta @ (now - before)
        return np.vstack([later, now])


def operator(modes: ToolModes, cut: Cut, tau: np.ndarray, shear: np.ndarray, nodes: Nodes) -> Operator:
    """Collocate the cut for a batch.

    Args:
        modes: in the cut frame, pole (S, nm) or (nm,).
        tau: (S,) tooth periods, s.
        shear: (S, 3) or (3,) N/m².
        nodes: from :func:`collocate`.
    """
    S = len(tau)
    pole = np.broadcast_to(modes.pole, (S, modes.pole.shape[-1]))
    u = np.broadcast_to(modes.shape, (S, *modes.shape.shape[-2:]))
    force = np.einsum("mfkp,sk->smfp", nodes.force, np.broadcast_to(shear, (S, 3)))
    z = pole * tau[:, None]
    t = nodes.phase
    felt = np.einsum("mpf,skf->smpk", nodes.chip, u)
    damped = bool(cut.coefficients.process_damping_n_per_m)
    if damped:
        rub = np.einsum("mfkp,sk->smfp", nodes.force, cut.flank(tau) / tau[:, None])
        felt, force = np.concatenate([felt, felt * z[:, None, None]], 2), np.concatenate([force, rub], 3)
    pushed = np.einsum("smfp,skf->skmp", force, u) * tau[:, None, None, None]
    alpha = felt * np.exp(z[:, None, :] * t[:, None])[:, :, None, :]
    beta = pushed * (nodes.weight * np.exp(z[:, :, None] * (1 - t)))[..., None]
    m, p = felt.shape[1:3]
    volterra = np.zeros((S, m, p, m, p))
    for number in range(len(nodes.start)):
        here = np.flatnonzero(nodes.element == number)
        earlier = np.flatnonzero(nodes.element < number)
        if len(earlier):
            late = np.exp(z[:, :, None] * (t[here] - t[here[0]]))
            soon = np.exp(z[:, :, None] * (t[here[0]] - t[earlier])) * nodes.weight[earlier]
            volterra[:, here[:, None], :, earlier] = (
                np.einsum(
                    "sipk,ski,skj,skjq->ijspq", felt[:, here], late, soon, pushed[:, :, earlier], optimize=True
                ).real.transpose(0, 1, 2, 3, 4)
                * 2
            )
        kernel = _within(z, nodes, number)
        block = np.einsum("sipk,skij,skjq->ijspq", felt[:, here], kernel, pushed[:, :, here], optimize=True)
        volterra[:, here[:, None], :, here[None, :]] = 2 * block.real
    if modes.residual is not None:
        residual = np.broadcast_to(modes.residual, (S, 3, 3))
        own = np.einsum("mpf,sfg,smgq->smpq", nodes.chip, residual, force)  # its speed is left out
        volterra[:, np.arange(m), : nodes.chip.shape[1], np.arange(m)] += own.transpose(1, 0, 2, 3)
    return Operator(
        np.exp(z), alpha.reshape(S, m * p, -1), beta.reshape(S, -1, m * p),
        volterra.reshape(S, m * p, m * p), nodes, force, np.tile(np.arange(p) < nodes.chip.shape[1], m).astype(float),
    )  # fmt: skip


def _within(z: np.ndarray, nodes: Nodes, number: int) -> np.ndarray:
    """∫ e^{z(t_i − s)} ℓ_j(s) ds from an element's start to its node i, per polynomial ℓ_j: (S, nm, me, me)."""
    length = nodes.length[number]
    x = (nodes.phase[nodes.element == number] - nodes.start[number]) / length
    y, w = np.polynomial.legendre.leggauss(len(x) + 4)
    y, w = (y + 1) / 2, w / 2
    polynomial = _lagrange(x, x[:, None] * y)  # (i, q, j)
    decay = np.exp(z[:, :, None, None] * (length * x[:, None] * (1 - y)))  # (S, k, i, q)
    return np.einsum("skiq,iqj->skij", decay, polynomial * (length * x[:, None] * w)[..., None], optimize=True)


def _lagrange(nodes: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Lagrange polynomials of nodes (m,) at points x (…): (…, m), by the barycentric formula."""
    difference = nodes[:, None] - nodes + np.eye(len(nodes))
    weight = 1 / np.prod(4 * difference, axis=1)
    gap = x[..., None] - nodes
    exact = np.abs(gap) < 1e-15
    ratio = weight / np.where(exact, 1, gap)
    out = ratio / ratio.sum(axis=-1, keepdims=True)
    hit = exact.any(axis=-1)
    out[hit] = exact[hit]
    return out


def multipliers(modes: ToolModes, cut: Cut, spindle_rpm: float, depth_m: float, digits: float = 12.0) -> np.ndarray:
    """All multipliers of a cut, largest first: stable where every |μ| < 1.

    Args:
        modes: in the cut frame.
        digits: decimal digits asked of the collocation.
    """
    tau = np.atleast_1d(cut.tooth_period(spindle_rpm))
    advance = fastest(modes, cut.coefficients.shear, depth_m) * tau
    nodes = collocate(cut, float(advance[0]), depth_m, digits)
    found = np.linalg.eigvals(operator(modes, cut, tau, cut.coefficients.shear, nodes).monodromy(0, depth_m))
    return found[np.argsort(-np.abs(found))]


@dataclass(frozen=True)
class Limits:
    """Every depth at which multipliers cross the unit circle, for a batch of S cuts; nc crossings, by row and depth.

    Attributes:
        count: S.
        row: (nc,) of the batch.
        depth_m: (nc,).
        angle: (nc,) θ of the multiplier e^{iθ}, in (0, π].
        change: (nc,) how many multipliers become unstable as the depth grows past it (negative: become stable).
        frequency_hz: (nc,) of the strongest part of the vibration at the tip.
        kind: (nc,) one of ``KINDS``.
    """

    count: int
    row: np.ndarray
    depth_m: np.ndarray
    angle: np.ndarray
    change: np.ndarray
    frequency_hz: np.ndarray
    kind: np.ndarray

    def first(self) -> np.ndarray:
        """Depth (S,) m up to which a cut is stable, infinite where it always is."""
        out = np.full(self.count, np.inf)
        np.minimum.at(out, self.row, self.depth_m)
        return out

    def unstable(self, depth_m: np.ndarray) -> np.ndarray:
        """Number of unstable multipliers (S, nd) at depths (nd,)."""
        out = np.zeros((self.count, len(depth_m)), int)
        np.add.at(out, self.row, self.change[:, None] * (self.depth_m[:, None] < depth_m))
        return out


def limits(
    modes: ToolModes,
    cut: Cut,
    spindle_rpm: np.ndarray,
    depth_max_m: float,
    *,
    shear: np.ndarray | None = None,
    lag_depth_m: float = 0.0,
    digits: float = DIGITS,
) -> Limits:
    """All limits in depth up to ``depth_max_m`` for a batch of cuts.

    Where the fastest motion at that depth advances by more than ``PATIENCE`` in a tooth period, it is looked about
    ``AHEAD`` times as deep as the closed form, then farther while the cut is stable there. Beyond a depth at which it
    is not, nothing is looked for.

    Args:
        modes: in the cut frame, pole (S, nm) or (nm,).
        spindle_rpm: (S,).
        shear: (S, 3) or (3,) cutting coefficients N/m², by default the cut's.
        lag_depth_m: depth for which the lag of a helix is taken.
        digits: decimal digits asked of the collocation.
    """
    rpm = np.asarray(spindle_rpm, float)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(rpm), 3))
    fast = fastest(modes, shear, depth_max_m) * np.asarray(cut.tooth_period(rpm), float) > PATIENCE

    def to(depth_m: float, rows: np.ndarray, reduced: bool) -> list[np.ndarray]:
        """Row, depth, angle, change, frequency and kind of the limits of some rows up to one depth."""
        own = modes.rows(rows)
        own = without_idle(own, cut, shear[rows], depth_m) if reduced else own
        parts = []
        for part, some, tau, op in _operators(own, cut, rpm[rows], depth_m, shear[rows], lag_depth_m, digits):
            row, *rest = _crossings(op, some, tau, depth_m)
            parts.append((rows[part[row]], *rest))
        return [np.concatenate(column) for column in zip(*parts, strict=True)]

    found = [to(depth_max_m, np.flatnonzero(~fast), False)] if not fast.all() else []
    least = np.broadcast_to(limiting_depth(modes, cut, shear=shear), len(rpm))
    reach_m = min(depth_max_m, AHEAD * float(least[fast].max(initial=0.0)))
    open_ = np.flatnonzero(fast)
    while len(open_):
        row, *rest = to(reach_m, open_, True)
        unstable = np.bincount(row, weights=rest[2], minlength=len(rpm))[open_] > 0  # at the deepest looked at
        done = open_ if reach_m >= depth_max_m else open_[unstable]
        kept = np.isin(row, done)  # the others are found again, and what lies below
        found.append([row[kept], *(column[kept] for column in rest)])
        open_ = open_[~np.isin(open_, done)]
        reach_m = min(depth_max_m, FARTHER * reach_m)
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    order = np.lexsort((columns[1], columns[0]))
    return Limits(len(rpm), *(column[order] for column in columns))


def first_limits(
    modes: ToolModes,
    cut: Cut,
    spindle_rpm: np.ndarray,
    depth_max_m: float,
    *,
    shear: np.ndarray | None = None,
    lag_depth_m: float = 0.0,
    digits: float = DIGITS,
) -> np.ndarray:
    """The first limit (S,) m alone, infinite where there is none up to ``depth_max_m``: :func:`limits` in less time.

    A norm bounds the eigenvalues at every angle. They are computed only where it allows a limit that is less deep than
    those sought, first the least depths, then deeper ones while nothing is found. Deep cuts move the tip fast and need
    many nodes. So each row is looked at about ``REACH`` times as deep as its closed form, then farther while nothing is
    found.
    """
    rpm = np.asarray(spindle_rpm, float)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(rpm), 3))
    least = np.broadcast_to(limiting_depth(modes, cut, shear=shear), rpm.shape)
    level = np.floor(np.log(np.maximum(depth_max_m / (REACH * least), 1.0)) / np.log(FARTHER)).astype(int)
    found = np.full(len(rpm), np.inf)
    while (open_ := np.flatnonzero((level >= 0) & np.isinf(found))).size:
        for number in np.unique(level[open_]):
            some = open_[level[open_] == number]
            reach_m = depth_max_m / FARTHER ** int(number)
            own = without_idle(modes.rows(some), cut, shear[some], reach_m)
            for rows, _, _, op in _operators(own, cut, rpm[some], reach_m, shear[some], lag_depth_m, digits):
                found[some[rows]] = _first(op, reach_m)
        level = level - 1
    return found


def without_idle(modes: ToolModes, cut: Cut, shear: np.ndarray, depth_m: float) -> ToolModes:
    """Modes, those that follow any row's cut of a depth, m, as static compliance turned into that.

    A mode adds at most a = 2b‖A‖|u|²/|Re λ| to an eigenvalue times b, teeth in cut together. It is static where that is
    less than ``STILL``. It is static, too, where it is faster than every mode that a cut of this depth can feed, and
    answers their vibrations, up to Ω, as at rest: a |Re λ| Ω/(|λ| max(|λ| − Ω, |Re λ|)) is then less than ``LATE``.
    """
    rate, damped = (np.atleast_2d(values) for values in (np.abs(modes.pole), np.abs(modes.pole.real)))
    push = np.linalg.norm(shear, axis=-1) * max(1, forces.most_teeth(cut)) * depth_m
    most = 4 * np.atleast_2d(np.linalg.norm(modes.shape, axis=-1) ** 2) / damped * push.reshape(-1, 1)
    fed = np.where(most >= LIVE, rate, 0.0).max(axis=-1, keepdims=True)
    late = most * damped * fed / (rate * np.maximum(rate - fed, damped))
    still = ((most < STILL) | ((rate > fed) & (late < LATE))).all(axis=0)
    if not still.any():
        return modes
    u, pole = modes.shape[..., still, :], modes.pole[..., still]
    static = 2 * np.einsum("...ki,...kj,...k->...ij", u, u, -1 / pole).real
    if modes.residual is not None:
        static = static + modes.residual
    return ToolModes(modes.pole[..., ~still], modes.shape[..., ~still, :], static)


def _operators(
    modes: ToolModes, cut: Cut, spindle_rpm: np.ndarray, depth_max_m: float, shear: np.ndarray | None,
    lag_depth_m: float, digits: float,
) -> Iterator[tuple[np.ndarray, ToolModes, np.ndarray, Operator]]:  # fmt: skip
    """Collocated cuts of a batch, those that need about as many nodes together: rows, modes, tooth periods, parts."""
    every = np.asarray(cut.tooth_period(spindle_rpm), float)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(every), 3))
    advance = fastest(modes, shear, depth_max_m) * every
    group = np.ceil(2 * np.log2(advance + 2.0)).astype(int)
    for number in np.unique(group):
        alike = np.flatnonzero(group == number)
        nodes = collocate(cut, float(advance[alike].max()), lag_depth_m, digits)
        each = modes.pole.shape[-1] * len(nodes.phase) * (len(nodes.phase) + 4)
        for rows in np.array_split(alike, -(-len(alike) * each // (4 * CHUNK))):
            some = modes.rows(rows)
            yield rows, some, every[rows], operator(some, cut, every[rows], shear[rows], nodes)


def fastest(modes: ToolModes, shear: np.ndarray, depth_m: float) -> np.ndarray:
    """Fastest angular frequency (…,) rad/s in a cut: of modes, and of the tip's free mass on the cut's stiffness."""
    light = 2 * np.einsum("...kf,...kg,...k->...fg", modes.shape, modes.shape, modes.pole).real  # h'(0), 1/kg
    stiff = depth_m * np.linalg.norm(shear, axis=-1)
    return np.sqrt((np.abs(modes.pole) ** 2).max(axis=-1) + stiff * np.linalg.norm(light, axis=(-2, -1)))


@dataclass(frozen=True)
class _Arcs:
    """Pieces (n,) of the unit circle with the r largest eigenvalues of W at both ends, those of one curve in a column.

    Attributes:
        row, start, end: batch row, angles.
        a, b: (n, r) eigenvalues at ``start`` and ``end``.
    """

    row: np.ndarray
    start: np.ndarray
    end: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def __getitem__(self, which: np.ndarray) -> "_Arcs":
        return _Arcs(self.row[which], self.start[which], self.end[which], self.a[which], self.b[which])


def _angles(turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and angles from 0 to π whose spacing is STEP of the distance to the nearest pole, for poles (S, nm)."""
    at, width = np.abs(np.angle(turn)), np.maximum(1 - np.abs(turn), 1e-9)
    reach = int(np.ceil(np.arcsinh(np.pi / width.min()) / STEP))
    theta = at[..., None] + width[..., None] * np.sinh(STEP * np.arange(-reach, reach + 1))
    inside = (theta > 0) & (theta < np.pi)
    row, mode, _ = np.nonzero(inside)
    theta = theta[inside]
    distance = np.hypot(theta[:, None] - at[row], width[row])
    row, theta = (values[np.argmin(distance, axis=1) == mode] for values in (row, theta))
    even = np.linspace(0, np.pi, int(np.pi / WIDEST) + 2)
    row = np.concatenate([row, np.repeat(np.arange(len(turn)), len(even))])
    theta = np.concatenate([theta, np.tile(even, len(turn))])
    order = np.lexsort((theta, row))
    return row[order], theta[order]


def _eigenvalues(op: Operator, row: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Eigenvalues (n, size) of W(e^{iθ}), largest magnitude first."""
    out = np.empty((len(row), op.volterra.shape[-1]), complex)
    size, poles = op.alpha.shape[1:]
    together = max(1, CHUNK // (size * (size + poles)))
    for start in range(0, len(row), together):
        part = slice(start, start + together)
        out[part] = np.linalg.eigvals(op.at(row[part], theta[part]))
    out = np.take_along_axis(out, np.argsort(-np.abs(out), axis=1), axis=1)
    out.imag[np.abs(out.imag) < 1e-12 * np.abs(out[:, :1])] = 0.0  # real at θ = π
    return out


def _paired(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """b (n, r) in the order that continues a (n, r): nearest pairs first."""
    distance = np.abs(a[:, :, None] - b[:, None, :])
    n, r = a.shape
    out, every = np.empty_like(b), np.arange(n)
    for _ in range(r):
        i, j = np.divmod(np.argmin(distance.reshape(n, -1), axis=1), r)
        out[every, i] = b[every, j]
        distance[every, i, :] = np.inf
        distance[every, :, j] = np.inf
    return out


def _crossings(op: Operator, modes: ToolModes, tau: np.ndarray, depth_max_m: float) -> tuple[np.ndarray, ...]:
    """Row, depth, angle, change, frequency and kind of all crossings."""
    least = 1 / depth_max_m
    row, theta = _angles(op.turn)
    low = _bounds(op, row, theta) < 0.5 * least  # no eigenvalue there, nor close by, is a limit
    follows = np.flatnonzero((row[1:] == row[:-1]) & ~(low[1:] & low[:-1]))
    wanted = np.unique(np.concatenate([follows, follows + 1, np.flatnonzero(theta == np.pi)]))
    value = np.zeros((len(row), op.volterra.shape[-1]), complex)
    value[wanted] = _eigenvalues(op, row[wanted], theta[wanted])
    kept = min(value.shape[1], 1 + int((np.abs(value) > 0.5 * least).sum(axis=1).max(initial=1)))
    value = value[:, :kept]
    arcs = _Arcs(row[follows], theta[follows], theta[follows + 1], value[follows], value[follows + 1])
    row_h, angle_h, value_h, change_h = _polished(op, _brackets(op, arcs, np.full(len(op.turn), least)))
    last = np.flatnonzero(theta == np.pi)
    row_f, value_f, change_f = _flips(op, row[last], value[last], least)
    row = np.concatenate([row_h, row_f])
    angle = np.concatenate([angle_h, np.full(len(row_f), np.pi)])
    value, change = np.concatenate([value_h, value_f]), np.concatenate([change_h, change_f])
    inside = value > least
    row, angle, value, change = row[inside], angle[inside], value[inside], change[inside]
    frequency = _frequency(op, modes, tau, row, angle, value)
    kind = np.where(angle == np.pi, "flip", np.where(frequency * tau[row] < 0.5, "mode_coupling", "hopf"))
    return row, 1 / value, angle, change, frequency, kind


def _first(op: Operator, depth_max_m: float) -> np.ndarray:
    """First limit (S,) m of a batch; infinite where there is none up to a depth."""
    count, deepest = len(op.turn), 1 / depth_max_m
    row, theta = _angles(op.turn)
    bound = _bounds(op, row, theta)
    most = np.zeros(count)
    np.maximum.at(most, row, bound)
    follows = np.flatnonzero(row[1:] == row[:-1])
    ends = np.maximum(bound[follows], bound[follows + 1])
    value = np.zeros((len(row), op.volterra.shape[-1]), complex)
    seen = np.zeros(len(row), bool)
    best = np.zeros(count)  # largest 1/b
    open_ = most > deepest
    least = np.maximum(most / FIRST_LOOK, deepest)
    while open_.any():
        near = follows[open_[row[follows]] & (ends > 0.5 * least[row[follows]])]
        wanted = np.unique(np.concatenate([near, near + 1]))
        wanted = wanted[~seen[wanted]]
        value[wanted] = _eigenvalues(op, row[wanted], theta[wanted])
        seen[wanted] = True
        large = np.abs(value[near]) > 0.5 * least[row[near], None]
        kept = min(value.shape[1], 1 + int(large.sum(axis=1).max(initial=1)))
        arcs = _Arcs(row[near], theta[near], theta[near + 1], value[near, :kept], value[near + 1, :kept])
        found = _brackets(op, arcs, least)
        # of a row's crossings, those that may be its largest
        where, high = found.row.astype(int), np.maximum(found.a.real, found.b.real)[:, 0]
        low, chord = np.minimum(found.a.real, found.b.real)[:, 0], np.abs(found.a - found.b)[:, 0]
        sure = np.zeros(count)
        np.maximum.at(sure, where, low - chord)
        at, _, real, _ = _polished(op, found[high + chord >= sure[where]])
        np.maximum.at(best, at, real)
        last = near[theta[near + 1] == np.pi] + 1
        flips = np.where(value[last].imag == 0, value[last].real, 0.0).max(axis=1, initial=0.0)
        np.maximum.at(best, row[last], flips)
        open_ &= (best < least) & (least > deepest)
        least = np.where(open_, np.maximum(least / DEEPER, deepest), least)
    return np.where(best > deepest, 1 / np.maximum(best, deepest), np.inf)


def _bounds(op: Operator, row: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Upper bounds (n,) of the magnitude of all eigenvalues of W(e^{iθ}): ‖W⁴‖^{1/4}, Frobenius."""
    out = np.empty(len(row))
    size, poles = op.alpha.shape[1:]
    together = max(1, CHUNK // (size * (size + poles)))
    for start in range(0, len(row), together):
        part = slice(start, start + together)
        W = op.at(row[part], theta[part])
        W = W @ W
        out[part] = np.linalg.norm(W @ W, axis=(1, 2)) ** 0.25
    return out


def _near_ray(arcs: _Arcs, least: np.ndarray) -> np.ndarray:
    """Arcs (n,) with a curve that may touch the ray of limits, real and at least ``least`` (n,), cheaply judged."""
    near = np.zeros(len(arcs.row), bool)
    for value in (arcs.a, arcs.b):
        near |= ((np.abs(value) > 0.5 * least[:, None]) & (value.real > -0.5 * np.abs(value.imag))).any(axis=1)
    return near


def _brackets(op: Operator, arcs: _Arcs, least_of: np.ndarray) -> _Arcs:
    """Arcs on which one curve crosses the ray of limits, that curve alone (n, 1); bisected until each is certain.

    The ray begins at ``least_of`` (S,) of the arc's batch row.

    A curve is taken to stay within a disc about the middle of its chord, the chord its radius. An arc is settled when
    no disc touches the ray, or when the curve is followed beyond doubt. Beyond doubt means that its chord is short
    against its size, and the next curve is farther than the chord. It also crosses the ray, or keeps away from it by a
    quarter of the chord.
    """
    found = []
    for round_ in range(ROUNDS):
        arcs = arcs[_near_ray(arcs, least_of[arcs.row])]
        if not len(arcs.row):
            break
        least = least_of[arcs.row, None]
        a, b = arcs.a, _paired(arcs.a, arcs.b)
        chord, middle = np.abs(a - b), 0.5 * (a + b)
        away = np.where(middle.real > least, np.abs(middle.imag), np.abs(middle - least))
        touches = (away <= chord) & (np.maximum(np.abs(a), np.abs(b)) > least)
        others = np.abs(a[:, :, None] - a[:, None, :]) + np.where(np.eye(a.shape[1], dtype=bool), np.inf, 0.0)
        short = (chord < 0.35 * np.maximum(np.abs(a), np.abs(b))) & (others.min(axis=2, initial=np.inf) > chord)
        crosses = a.imag * b.imag < 0
        ends = (arcs.end == np.pi)[:, None] & (b.imag == 0)
        certain = short & (crosses | ends | (away > 0.25 * chord))
        settled = (~touches | certain).all(axis=1) | (round_ == ROUNDS - 1)
        arc, curve = np.nonzero(touches & crosses & settled[:, None])
        one = a[arc, curve][:, None], b[arc, curve][:, None]
        found.append(_Arcs(arcs.row[arc], arcs.start[arc], arcs.end[arc], *one))
        arcs = arcs[~settled]
        half = 0.5 * (arcs.start + arcs.end)
        value = _eigenvalues(op, arcs.row, half)[:, : arcs.a.shape[1]]
        arcs = _joined([
            _Arcs(arcs.row, arcs.start, half, arcs.a, value), _Arcs(arcs.row, half, arcs.end, value, arcs.b),
        ])  # fmt: skip
    return _joined(found) if found else _Arcs(*(np.zeros(0),) * 3, *(np.zeros((0, 1), complex),) * 2)


def _joined(arcs: list[_Arcs]) -> _Arcs:
    fields = ("row", "start", "end", "a", "b")
    return _Arcs(*(np.concatenate([getattr(some, name) for some in arcs]) for name in fields))


def _polished(op: Operator, arcs: _Arcs) -> tuple[np.ndarray, ...]:
    """Row, angle, real eigenvalue and change of stability where bracketed curves (n, 1) cross the ray: Illinois."""
    row, start, end = arcs.row.astype(int), arcs.start.copy(), arcs.end.copy()
    a, b = arcs.a[:, 0].copy(), arcs.b[:, 0].copy()
    fa, fb = a.imag.copy(), b.imag.copy()
    change = np.where(fa > 0, 2, -2)
    theta, value, same = start.copy(), a.copy(), np.zeros(len(row), int)  # same: the end that was moved last
    for _ in range(POLISH):
        k = np.flatnonzero(np.abs(value.imag) > REAL * np.abs(value))
        if not len(k):
            break
        share = fa[k] / (fa[k] - fb[k])
        theta[k] = start[k] + share * (end[k] - start[k])
        linear = a[k] + share * (b[k] - a[k])
        every = _eigenvalues(op, row[k], theta[k])
        value[k] = here = every[np.arange(len(k)), np.argmin(np.abs(every - linear[:, None]), axis=1)]
        left = np.sign(here.imag) == np.sign(fa[k])
        fa[k], fb[k] = (
            np.where(left, here.imag, np.where(same[k] == -1, 0.5 * fa[k], fa[k])),
            np.where(left, np.where(same[k] == 1, 0.5 * fb[k], fb[k]), here.imag),
        )
        same[k] = np.where(left, 1, -1)
        start[k], end[k] = np.where(left, theta[k], start[k]), np.where(left, end[k], theta[k])
        a[k], b[k] = np.where(left, here, a[k]), np.where(left, b[k], here)
    return row, theta, value.real, change


def _flips(op: Operator, row: np.ndarray, value: np.ndarray, least: float) -> tuple[np.ndarray, ...]:
    """Row, real eigenvalue at θ = π, and change of stability of flips, from eigenvalues (S, r) there."""
    which, curve = np.nonzero((value.imag == 0) & (value.real > least))
    row, value = row[which], value[which, curve].real
    if not len(row):
        return row, value, np.zeros(0, int)
    turn = op.turn[row]
    before = np.pi - 1e-3 * np.abs(-1 - turn).min(axis=1)
    every = _eigenvalues(op, row, before)
    near = every[np.arange(len(row)), np.argmin(np.abs(every - value[:, None]), axis=1)]
    return row, value, np.where(near.imag > 0, 1, -1)


def _frequency(
    op: Operator, modes: ToolModes, tau: np.ndarray, row: np.ndarray, angle: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Frequency (nc,) Hz of the strongest harmonic of the vibration at the tip at each crossing."""
    if not len(row):
        return np.zeros(0)
    every, vectors = np.linalg.eig(op.at(row, angle))
    chips = np.take_along_axis(vectors, np.argmin(np.abs(every - value[:, None]), axis=1)[:, None, None], axis=2)
    m, _, p = op.force.shape[1:]
    push = np.einsum("smfp,smp->smf", op.force[row], chips.reshape(-1, m, p)) * op.nodes.weight[:, None]
    fastest = np.broadcast_to(np.abs(modes.pole).max(axis=-1), tau.shape) * tau
    order = np.arange(-(n := int(np.ceil(fastest.max() / (2 * np.pi))) + 1), n + 1)
    turn = angle[:, None] + 2 * np.pi * order
    force = np.einsum("shm,smf->shf", np.exp(-1j * turn[:, :, None] * op.nodes.phase), push)
    some = modes.rows(row)
    motion = np.einsum("shfg,shg->shf", some.receptance(turn / tau[row, None]), force)
    strongest = np.argmax(np.linalg.norm(motion, axis=2), axis=1)
    return np.abs(turn[np.arange(len(row)), strongest]) / (2 * np.pi * tau[row])
