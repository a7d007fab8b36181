"""Modal tests of plates, rings and frames whose poles are known: closed forms and own beam elements, numpy alone.

A structure has undamped modes well past the band. Damping couples them, so that shapes are complex; poles come from the
eigenvalues of the coupled equations. A test adds what real ones have: noise, averages, bad and reversed channels, a
reference on a node, an exponential window, references and sensors whose frequencies differ by up to a tenth per cent.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.linalg import eig, eigh

from tools.truth.chain import Array
from tools.truth.laws import Complex

Kind = Literal["plate", "ring", "frame"]
SPLIT = 0.003  # relative distance of the frequencies of a pair
WIDEST = 12.0  # largest ratio of the ends of a band
MOST_LINES = 2400
BEYOND = 1.8  # modes up to this multiple of the band are in the truth


@dataclass(frozen=True)
class Structure:
    """Undamped modes of a structure, nm modes at np points.

    Attributes:
        frequency: (nm,) Hz.
        shapes: (np, nm), of unit modal mass up to one factor.
        position: (np, 3) m.
        axis: (np,) 0, 1 or 2: direction of the motion at a point.
    """

    frequency: Array
    shapes: Array
    position: Array
    axis: Array


@dataclass(frozen=True)
class ModalTest:
    """What the test recorded, and the truth.

    Attributes:
        frequency: (nf,) Hz.
        frf: (nf, nr, ne) accelerance.
        coherence, averages: as a recording states them, or ``None``.
        rate: of the exponential window, 1/s.
        position, axis: of the responses, as in :class:`Structure`.
        excited: (ne,) index of the responses that are driving points, or of points.
        poles: (nm,) of all modes of the truth, rad/s.
        residues: (nm, nr, ne) of receptance.
        noise: (nf, nr, ne) RMS of the complex noise.
    """

    frequency: Array
    frf: Complex
    coherence: Array | None
    averages: int | None
    rate: float
    position: Array
    axis: Array
    excited: Array
    poles: Complex
    residues: Complex
    noise: Array
    story: str

    @property
    def mode_frequency(self) -> Array:
        """(nm,) Hz."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def mode_damping(self) -> Array:
        """(nm,) ratio."""
        return -self.poles.real / np.abs(self.poles)

    @property
    def visibility(self) -> Array:
        """(nm,) of a mode's own response at its nearest line over the noise there, in its best channel; 0 outside."""
        line = np.argmin(np.abs(self.frequency[:, None] - self.mode_frequency), axis=0)
        s = (self.rate + 2j * np.pi * self.frequency[line])[:, None, None]
        p = self.poles[:, None, None]
        own = np.abs(s**2 * (self.residues / (s - p) + self.residues.conj() / (s - p.conj())))
        inside = (self.mode_frequency >= self.frequency[0]) & (self.mode_frequency <= self.frequency[-1])
        return np.where(inside, np.max(own / self.noise[line], axis=(1, 2)), 0.0)


# --- structures -------------------------------------------------------------------------------------------


def plate(rng: np.random.Generator, modes: int, points: int) -> Structure:
    """Simply supported plate, nearly square: f ∝ (m/a)² + (n/b)², shapes sin sin (Leissa 1969)."""
    side = np.array([1.0, 1 + rng.choice([SPLIT / 2, 0.02, 0.31])])
    m, n = (index.ravel() for index in np.meshgrid(np.arange(1, 26), np.arange(1, 26)))
    f = 20 * ((m / side[0]) ** 2 + (n / side[1]) ** 2)
    # A square's modes (m, n) and (n, m) are split by its sides; what is left together is parted by a stiffener.
    f = f * (1 + SPLIT / 2 * np.sign(m - n) * rng.uniform(0.8, 1.2, m.size))
    keep = np.argsort(f)[: _needed(np.sort(f), modes)]
    xy = rng.uniform(0.04, 0.96, (points, 2))
    shapes = np.sin(np.pi * xy[:, :1] * m[keep]) * np.sin(np.pi * xy[:, 1:] * n[keep])
    return Structure(f[keep], shapes, np.column_stack([xy * side, np.zeros(points)]), np.full(points, 2))


def ring(rng: np.random.Generator, modes: int, points: int) -> Structure:
    """Free ring bending in its plane: f ∝ n(n²−1)/√(n²+1), cos and sin parted by a small mass (Love 1944)."""
    n = np.repeat(np.arange(2, 60), 2)
    second = np.arange(n.size) % 2
    f = 15 * n * (n**2 - 1) / np.sqrt(n**2 + 1) * (1 + SPLIT * second * rng.uniform(0.8, 1.5, n.size))
    keep = np.arange(_needed(f, modes))
    angle = 2 * np.pi * (np.arange(points) + 0.4 * rng.uniform(-1, 1, points)) / points
    turn = np.pi / 2 * second[keep] / n[keep] + 0.1
    shapes = np.cos(n[keep] * (angle[:, None] - turn)) * n[keep] / np.sqrt(n[keep] ** 2 + 1)
    at = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(points)])
    return Structure(f[keep], shapes, at, np.where(np.abs(at[:, 0]) > np.abs(at[:, 1]), 0, 1))


def frame(rng: np.random.Generator, modes: int, points: int) -> Structure:
    """Tower of square storeys, three-dimensional Euler–Bernoulli beams; nearly symmetric, so that it sways in pairs."""
    storeys, pieces = int(rng.integers(2, 5)), 2
    height, width = rng.uniform(0.5, 0.8), np.array([0.6, 0.6 * (1 + 2 * SPLIT)])
    nodes: list[Array] = []
    bars: list[tuple[int, int]] = []

    def node(at: Array) -> int:
        for k, other in enumerate(nodes):
            if np.linalg.norm(other - at) < 1e-9:
                return k
        nodes.append(at)
        return len(nodes) - 1

    def bar(a: Array, b: Array) -> None:
        line = [node(a + (b - a) * k / pieces) for k in range(pieces + 1)]
        bars.extend(pairwise(line))

    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * width
    for level in range(storeys):
        for k in range(4):
            low, high = (np.append(corners[k], z * height) for z in (level, level + 1))
            bar(low, high)
            bar(high, np.append(corners[(k + 1) % 4], (level + 1) * height))
    mass, stiffness = _beams(np.array(nodes), bars, rng)
    free = np.repeat(np.array(nodes)[:, 2] > 1e-9, 6)
    value, vector = eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])
    f = np.sqrt(np.abs(value)) / (2 * np.pi)
    for k in range(1, f.size):  # sway in x and in y, parted as a joint that is a little softer would
        f[k] = max(f[k], f[k - 1] * (1 + SPLIT * rng.uniform(1.0, 1.3)))
    keep = np.arange(_needed(f, modes))
    full = np.zeros((free.size, keep.size))
    full[free] = vector[:, keep]
    moving = [6 * k + a for k in range(len(nodes)) if nodes[k][2] > 1e-9 for a in range(3)]
    chosen = np.sort(rng.choice(moving, min(points, len(moving)), replace=False))
    return Structure(f[keep], full[chosen], np.array(nodes)[chosen // 6], chosen % 6)


def _needed(f: Array, modes: int) -> int:
    """How many modes the truth needs for ``modes`` in the band."""
    return int(np.searchsorted(f, BEYOND * f[min(modes, f.size - 1)]))


def _beams(nodes: Array, bars: list[tuple[int, int]], rng: np.random.Generator) -> tuple[Array, Array]:
    """Consistent mass and stiffness of 12 × 12 beam elements (Przemieniecki 1968), steel box section."""
    young, shear, density = 2.1e11, 8.1e10, 7850.0
    area, inertia, torsion = 6e-4, 2.4e-7, 4e-7
    n = 6 * len(nodes)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for a, b in bars:
        along = nodes[b] - nodes[a]
        length = float(np.linalg.norm(along))
        bend = inertia * (1 + 0.01 * rng.normal())
        k, m = _beam(length, young * area, young * bend, shear * torsion, density * area, density * 2 * bend)
        x = along / length
        y = np.cross([0.0, 0, 1] if abs(x[2]) < 0.9 else [1.0, 0, 0], x)
        y /= np.linalg.norm(y)
        turn = np.kron(np.eye(4), np.array([x, y, np.cross(x, y)]))
        at = np.concatenate([6 * a + np.arange(6), 6 * b + np.arange(6)])
        mass[np.ix_(at, at)] += turn.T @ m @ turn
        stiffness[np.ix_(at, at)] += turn.T @ k @ turn
    return mass, stiffness


def _beam(length: float, ea: float, ei: float, gj: float, rho_a: float, rho_i: float) -> tuple[Array, Array]:
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    two = np.array([[1.0, -1], [-1, 1]])
    heavy = np.array([[2.0, 1], [1, 2]]) / 6
    k[np.ix_([0, 6], [0, 6])], m[np.ix_([0, 6], [0, 6])] = ea / length * two, rho_a * length * heavy
    k[np.ix_([3, 9], [3, 9])], m[np.ix_([3, 9], [3, 9])] = gj / length * two, rho_i * length * heavy
    for at, sign in (([1, 5, 7, 11], 1), ([2, 4, 8, 10], -1)):
        h = sign * length
        k[np.ix_(at, at)] = (
            ei
            / length**3
            * np.array(
                [
                    [12, 6 * h, -12, 6 * h],
                    [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                    [-12, -6 * h, 12, -6 * h],
                    [6 * h, 2 * h * h, -6 * h, 4 * h * h],
                ]
            )
        )
        m[np.ix_(at, at)] = (
            rho_a
            * length
            / 420
            * np.array(
                [
                    [156, 22 * h, 54, -13 * h],
                    [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                    [54, 13 * h, 156, -22 * h],
                    [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
                ]
            )
        )
    return k, m


# --- tests ------------------------------------------------------------------------------------------------


def damped(structure: Structure, damping: Array, coupling: float, rng: np.random.Generator) -> tuple[Complex, Complex]:
    """Poles (nm,) and modal vectors (np, nm) with H(s) = Σ v vᵀ/(s − λ) + conjugates; damping couples the modes."""
    w = 2 * np.pi * structure.frequency
    c = 2 * damping * w
    random = rng.uniform(-1, 1, (w.size, w.size))
    matrix = np.diag(c) + coupling * np.sqrt(c[:, None] * c) * (random + random.T) / 2 * (1 - np.eye(w.size))
    n = w.size
    roots, vectors = eig(np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(w**2), -matrix]]))
    keep = np.flatnonzero(roots.imag > 0)
    keep = keep[np.argsort(np.abs(roots[keep]))]
    roots, vectors = roots[keep], vectors[:n, keep]
    scale = np.einsum("ar,abr,br->r", vectors, 2 * roots * np.eye(n)[:, :, None] + matrix[:, :, None], vectors)
    return roots, structure.shapes @ (vectors / np.sqrt(scale.astype(complex)))


def synthesise(s: Complex, poles: Complex, residues: Complex) -> Complex:
    """Accelerance (nf, …) from poles (nm,) and residues (nm, …) of receptance."""
    flat = residues.reshape(poles.size, -1)
    frf = (1 / (s[:, None] - poles)) @ flat + (1 / (s[:, None] - poles.conj())) @ flat.conj()
    return np.asarray((s**2)[:, None] * frf).reshape(s.size, *residues.shape[1:])


def _noise(rng: np.random.Generator, lines: int, channels: int, rate: float, record: float) -> Complex:
    """(lines, channels) of unit RMS; an exponential window over the record correlates neighbouring lines."""
    if rate == 0:
        return np.asarray((rng.normal(size=(lines, channels)) + 1j * rng.normal(size=(lines, channels))) / np.sqrt(2))
    nt = 4 * lines
    window = np.exp(-rate * record * np.arange(nt) / nt)
    samples = rng.normal(size=(nt, channels)) * window[:, None]
    return np.asarray(np.fft.rfft(samples, axis=0)[lines // 2 : lines // 2 + lines] / np.sqrt(np.sum(window**2)))


def draw(seed: int) -> ModalTest:
    """One test of one structure; everything about it follows from the seed."""
    rng = np.random.default_rng([27, seed])
    kind: Kind = ("plate", "ring", "frame")[seed % 3]
    modes = int(rng.integers(10, 41))
    ne = int(rng.choice([1, 2, 3, 4], p=[0.15, 0.3, 0.4, 0.15]))
    nr = int(rng.integers(max(8, 2 * ne), 75))
    if ne == 1:
        modes = min(modes, 20)
    structure = {"plate": plate, "ring": ring, "frame": frame}[kind](rng, modes, nr)
    nr = structure.shapes.shape[0]
    # Where several dozen modes are in the band, their bands overlap without end at 8 %: light ones have many modes.
    level = np.exp(rng.uniform(np.log(0.001), np.log(0.08 if modes <= 15 else 0.02)))
    damping = np.clip(level * np.exp(0.4 * rng.normal(size=structure.frequency.size)), 0.001, 0.08)
    poles, vectors = damped(structure, damping, rng.choice([0.0, 0.15]), rng)
    excited = rng.choice(nr, ne, replace=False)
    node = ne > 1 and rng.random() < 0.3
    v_e = vectors[excited].copy()
    if node:
        blind = rng.choice(poles.size, poles.size // 4, replace=False)
        v_e[-1, blind] *= 0.01
    residues = np.einsum("or,er->roe", vectors, v_e)

    f = np.abs(poles) / (2 * np.pi)
    inside = min(modes, f.size - 2)
    top = (f[inside - 1] * 0.4 + f[inside] * 0.6) if f[inside] > 1.02 * f[inside - 1] else f[inside - 1] * 1.02
    first = int(np.searchsorted(f, top / WIDEST))
    low = f[first] * rng.choice([0.2, 0.5, 0.8]) if first == 0 else f[first] * 0.97
    # A tester takes lines that resolve the narrowest mode, or a shorter band.
    width = -2 * float(np.quantile(poles.real[first:inside], 0.9)) / (2 * np.pi)
    wanted = (top - low) / (width / rng.uniform(1, 4))
    if wanted > MOST_LINES:
        top = max(low + (top - low) * MOST_LINES / wanted, f[min(first + 9, inside - 1)] * 1.01)
    nf = int(np.clip(wanted, 400, MOST_LINES))
    frequency = np.linspace(low, top, nf)
    record = (nf - 1) / (top - low)
    rate = float(rng.uniform(1, 4) / record) if rng.random() < 0.25 else 0.0
    s = rate + 2j * np.pi * frequency

    inconsistent = rng.random() < 0.35 and ne > 1  # a single reference has nothing to differ from
    shift = rng.uniform(2e-4, 1e-3) * rng.normal(size=(poles.size, ne)) / 2 if inconsistent else np.zeros((1, ne))
    loaded = rng.uniform(0, 1e-3) * rng.normal(size=(poles.size, 4)) / 2 if rng.random() < 0.25 else np.zeros((1, 4))
    batch = np.arange(nr) * 4 // nr
    frf = np.empty((nf, nr, ne), dtype=complex)
    for e in range(ne):
        for b in range(4):
            moved = poles * (1 + shift[:, e] + loaded[:, b])
            frf[:, batch == b, e] = synthesise(s, moved, residues[:, batch == b, e])

    level_noise = float(np.exp(rng.uniform(np.log(0.001), np.log(0.05))))
    rms = np.sqrt(np.mean(np.abs(frf) ** 2, axis=0))
    size = level_noise * rms * np.ones((nf, 1, 1))
    size = size * np.sqrt(1 + 3 * np.exp(-((frequency - low) / (0.1 * (top - low))))[:, None, None])
    if rng.random() < 0.3:  # noise of the force: a share of the response itself
        size = np.sqrt(size**2 + (0.5 * level_noise * np.abs(frf)) ** 2)
    bad = rng.choice(nr, rng.integers(1, 1 + max(1, nr // 15)), replace=False) if rng.random() < 0.4 else []
    size[:, bad] = 20 * size[:, bad]
    averages = int(rng.integers(3, 11)) if rng.random() < 0.6 else None
    shape = (averages or 1, nf, nr * ne)
    each = np.stack([_noise(rng, nf, nr * ne, rate, record) for _ in range(shape[0])]).reshape(-1, nf, nr, ne)
    runs = frf + each * size * np.sqrt(averages or 1)
    measured = runs.mean(axis=0)
    coherence = np.abs(measured) ** 2 / np.mean(np.abs(runs) ** 2, axis=0) if averages else None
    turned_round = rng.choice(nr, rng.integers(1, 4), replace=False) if rng.random() < 0.3 else []
    measured[:, turned_round] *= -1
    residues = residues.copy()
    residues[:, turned_round] *= -1
    if rng.random() < 0.15:
        dead = int(rng.integers(nr))
        measured[:, dead] = 0
        size[:, dead] = np.inf
        if coherence is not None:
            coherence[:, dead] = 0
    story = (
        f"{kind} {np.count_nonzero((f > low) & (f < top))} modes, {nr}x{ne}x{nf}, "
        f"damping {100 * level:.2g} %, noise {100 * level_noise:.2g} %"
        + (f", {averages} averages" if averages else "")
        + (", window" if rate else "")
        + (", references differ" if inconsistent else "")
        + (", loaded" if loaded.any() else "")
        + (", node" if node else "")
        + (f", {len(bad)} bad" if len(bad) else "")
    )
    return ModalTest(
        frequency,
        measured,
        coherence,
        averages,
        rate,
        structure.position,
        structure.axis,
        excited,
        poles,
        residues,
        size,
        story,
    )
