"""Milling with the true robot: the delay equation of a cut stepped in time, linear or with teeth that leave the work.

The tool's tip moves as the poles of the structure let it, of frequency-dependent laws too; between steps they are
propagated exactly. The cut pushes with what the chips cost: chips are as thick as the feed and what the tooth before
has left. Seen from the spindle the tool turns clockwise; x is the feed of the tool against the work, z points from
the tip to the spindle, and a tooth at φ from +y stands at (sin φ, cos φ).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from tools.truth.chain import Array
from tools.truth.elastic import Structure
from tools.truth.laws import Complex

FINE = 64  # places within a step at which teeth are looked for: where they enter and leave is averaged
GRID = 16  # depths in a round of the search for a limit
SLICES = 6  # of a helical tooth along its depth
RAMP_S = 0.5  # in which a cut is brought to its depth
QUIET = 1e-3  # of the feed per tooth: a motion that differs by less from tooth to tooth has settled
FADING = 0.7  # in ln amplitude over the last half of a cut: what fades less, where teeth leave the work, goes on


@dataclass(frozen=True)
class Cut:
    """What is cut how: `arc` rad where teeth are in the work; `coefficients` (kt, kr, ka) N/m² and `edge` the same N/m;
    directions in the base.

    `axis` points from the tip to the spindle, `feed` is how the tool moves against the work; `tip` (3,) m in the last
    link's frame; `helix` rad, `diameter` m.
    """

    tip: Array
    axis: Array
    feed: Array
    teeth: int
    arc: tuple[float, float]
    coefficients: Array
    spindle_rpm: float
    feed_per_tooth: float = 1e-4
    edge: Array = field(default_factory=lambda: np.zeros(3))
    helix: float = 0.0
    diameter: float = 0.02

    @property
    def period(self) -> float:
        """From tooth to tooth, s."""
        return 60 / self.spindle_rpm / self.teeth


def arc(immersion: float, up: bool) -> tuple[float, float]:
    """Where teeth are in the work: up milling begins with no chip at φ = 0."""
    swept = float(np.arccos(1 - 2 * immersion))
    return (0.0, swept) if up else (np.pi - swept, np.pi)


def last_link(structure: Structure) -> Array:
    """Rotation (3, 3) of the end of the last link."""
    return np.asarray(structure.zones[-1][-1].frame.turn)


def tip_rows(structure: Structure, cut: Cut) -> Array:
    """Displacement (3, n) of the tip along feed, normal and axis per unit of every coordinate."""
    z = cut.axis / np.linalg.norm(cut.axis)
    x = cut.feed - (cut.feed @ z) * z
    x = x / np.linalg.norm(x)
    turn, body = last_link(structure), f"link{len(structure.zones)}"
    return np.array([structure.row(body, cut.tip, turn.T @ d) for d in (x, np.cross(z, x), z)])


def poles(structure: Structure, rows: Array) -> tuple[Complex, Complex]:
    """λ (nm,) with Im > 0 and residue vectors (nm, 3): receptance Σ u uᵀ/(s − λ) + conjugates.

    Each is followed by Newton's method from where viscous damping alone puts it, through laws that depend on frequency.
    """
    frequency, ratio, shapes = structure.modes()
    start = 2 * np.pi * frequency * (-ratio + 1j * np.sqrt(1 - ratio**2))
    found, vectors = [], []
    for s, v in zip(start, shapes.T, strict=True):
        for _ in range(30):
            stiffness, slope = dynamic_stiffness(structure, s), _slope(structure, s)
            try:
                w = np.linalg.solve(stiffness, slope @ v)
            except np.linalg.LinAlgError:  # s is the pole, to the last digit
                break
            step = (v @ slope @ v) / (v @ slope @ w)
            v = w / np.linalg.norm(w)
            s = s - step
            if abs(step) < 1e-12 * abs(s):
                break
        slope = _slope(structure, s)
        found.append(s)
        vectors.append(rows @ v / np.sqrt(v @ slope @ v))
    return np.array(found), np.array(vectors)


def dynamic_stiffness(structure: Structure, s: complex) -> Complex:
    """Z(s), (n, n)."""
    z = structure.mass * s**2 + structure.damping * s + structure.stiffness
    for i, terms in structure.dynamic.items():
        z[i, i] += sum(term(np.array([s]))[0] for term in terms)
    return np.asarray(z)


def _slope(structure: Structure, s: complex) -> Complex:
    step = 1e-6 * abs(s)
    return (dynamic_stiffness(structure, s + step) - dynamic_stiffness(structure, s - step)) / (2 * step)


def directions(cut: Cut, steps: int, depth: float = 0.0) -> Array:
    """Force on the tip over depth and chip motion, (steps, 3, 3) N/m², at steps of a tooth period.

    `depth` m is what the lag of a helix is taken for.
    """
    phi, inside = _angles(cut, steps, depth)
    normal, push = _along(cut.coefficients, phi)
    return np.einsum("iapf,japf,apf->pij", push, normal, inside) * cut.teeth / inside.shape[0] / FINE


def _angles(cut: Cut, steps: int, depth: float) -> tuple[Array, Array]:
    """Angles (slots, steps, FINE) of pieces of teeth, slot by slot, and whether (1 or 0) each is in the work."""
    pieces = SLICES if cut.helix and depth else 1
    lag = 2 * np.tan(cut.helix) * depth / cut.diameter * (np.arange(pieces) + 0.5) / pieces
    place = (np.arange(steps)[:, None] + (np.arange(FINE) + 0.5) / FINE - 0.5) / steps
    pitch = 2 * np.pi / cut.teeth
    start = (np.arange(cut.teeth)[:, None] * pitch - lag).ravel()
    phi = (place[None] * pitch + start[:, None, None]) % (2 * np.pi)
    return phi, ((phi >= cut.arc[0]) & (phi <= cut.arc[1])).astype(float)


def _along(coefficients: Array, phi: Array) -> tuple[Array, Array]:
    """Chip normals and forces per coefficient, both (3, ...), at angles."""
    kt, kr, ka = coefficients
    s, c, o = np.sin(phi), np.cos(phi), np.zeros_like(phi)
    normal = np.stack([s, c, o])
    return normal, -kr * normal - kt * np.stack([c, -s, o]) + ka * np.stack([o, o, o + 1])


def periods(
    pole: Complex, residue: Complex, force: Array, depth: Array, period: Array, count: int, seed: int = 0
) -> Iterator[tuple[Array, Array]]:
    """Tooth period after tooth period of a cut that begins with a small disturbance.

    pole (nm, nc) and residue (nm, 3, nc) of the tip, force (steps, 3, 3, nc) from `directions`, depth (nc,) m,
    period (nc,) s between teeth. Yields the tip's motion (steps, 3, nc) over the size of the state at its end, and
    the logarithm (nc,) of that size.
    """
    steps, columns = len(force), depth.size
    w = pole * period / steps
    fade = np.exp(w)
    late = (np.exp(w) - 1 - w) / (w * pole)
    early = (np.exp(w) - 1) / pole - late
    early, late = residue * early[:, None], residue * late[:, None]  # (nm, 3, nc)
    own = 2 * np.einsum("kic,kjc->ijc", residue, late).real
    read = 2 * residue
    rng = np.random.default_rng(seed)
    z = rng.normal(size=pole.shape) + 1j * rng.normal(size=pole.shape)
    z /= np.abs(residue).max(axis=1) + 1e-3 * np.abs(residue).max()
    behind = np.zeros((steps, 3, columns))
    push, level, blade = np.zeros((3, columns)), np.zeros(columns), force * depth
    for _ in range(count):
        for k in range(steps):
            z = z * fade + (early * push).sum(axis=1)
            moved = np.stack([(read[:, axis] * z).sum(axis=0).real for axis in range(3)])
            chip = moved - behind[k]
            push = (blade[k] * chip).sum(axis=1)
            push = (blade[k] * (chip + (own * push).sum(axis=1))).sum(axis=1)
            z = z + (late * push).sum(axis=1)
            behind[k] = moved + (own * push).sum(axis=1)
        energy = np.sqrt((np.abs(z) ** 2 * np.abs(residue).max(axis=1) ** 2).sum(axis=0))
        level = level + np.log(energy)
        z, push, behind = z / energy, push / energy, behind / energy
        yield behind, level


def growth(
    pole: Complex, residue: Complex, force: Array, depth: Array, period: Array, seconds: float = 6.0, seed: int = 0
) -> Array:
    """Growth rate 1/s of a small disturbance in each column (see `periods`): below zero the cut is stable."""
    count = int(np.ceil(seconds / period.min()))
    size = np.array([level for _, level in periods(pole, residue, force, depth, period, count, seed)])
    half = count // 2
    time = np.arange(count - half)[:, None] * period
    away = time - time.mean(axis=0)
    return np.asarray((away * size[half:]).sum(axis=0) / (away**2).sum(axis=0))


def envelope(structure: Structure, cut: Cut, depth: float, seconds: float, steps: int = 60) -> tuple[Array, Array]:
    """Time (np,) s of tooth periods and the largest motion of the tip in each, (np,), over that in the first ones."""
    pole, residue = poles(structure, tip_rows(structure, cut))
    force, count = directions(cut, steps)[..., None], int(np.ceil(seconds / cut.period))
    found = periods(pole[:, None], residue[..., None], force, np.array([depth]), np.array([cut.period]), count)
    size = np.array([np.log(np.linalg.norm(moved, axis=1).max()) + level[0] for moved, level in found])
    return np.arange(count) * cut.period, np.exp(np.minimum(size - size[:5].mean(), 50.0))


def limits(
    cases: list[tuple[Structure, Cut]], deepest: float, steps: int = 60, seconds: float = 6.0, rounds: int = 3
) -> Array:
    """The least depth (m) that chatters in each case, `deepest` where none does: a grid, then finer ones in a cell.

    Grids are even in the logarithm; the first goes down to `deepest` / 3000, and its shallowest unstable depth counts.
    """
    low, high = np.full(len(cases), deepest / 3000), np.full(len(cases), deepest)
    at = np.arange(len(cases))
    for _ in range(rounds):
        depth = np.geomspace(low, high, GRID)
        unstable = growth_at(cases, depth, steps, seconds) > 0
        first = np.where(unstable.any(axis=0), unstable.argmax(axis=0), GRID - 1)
        low, high = depth[np.maximum(first - 1, 0), at], depth[first, at]
    return np.asarray(np.where(high >= deepest * (1 - 1e-9), deepest, np.sqrt(low * high)))


def growth_at(cases: list[tuple[Structure, Cut]], depth: Array, steps: int = 60, seconds: float = 6.0) -> Array:
    """Growth rates (nd, ncase) of a small disturbance at depths (nd, ncase), cases of similar tooth periods together.

    Teeth are taken to stay in the work, so that this is the linear limit.
    """
    out = np.empty(depth.shape)
    for some, pole, residue, period in _together(cases, len(depth), 400):
        plans = zip(_tiled(some, depth), depth[:, some].ravel(), strict=True)
        force = np.stack([directions(cases[i][1], steps, b) for i, b in plans], axis=-1)
        each = np.tile(np.arange(len(some)), len(depth))
        rate = growth(pole[:, each], residue[..., each], force, depth[:, some].ravel(), period[each], seconds)
        out[:, some] = rate.reshape(len(depth), len(some))
    return out


def chatters_at(cases: list[tuple[Structure, Cut]], depth: Array, steps: int = 60, seconds: float = 6.0) -> Array:
    """Whether (nd, ncase) cuts at depths (nd, ncase) chatter, with teeth that may leave the work: see `cut_in_time`."""
    out = np.empty(depth.shape, bool)
    for some, pole, residue, _ in _together(cases, len(depth), 160):
        each = np.tile(np.arange(len(some)), len(depth))
        plans = [cases[i][1] for i in _tiled(some, depth)]
        found = cut_in_time(pole[:, each], residue[..., each], plans, depth[:, some].ravel(), steps, seconds)
        out[:, some] = found.reshape(len(depth), len(some))
    return out


def _tiled(some: Array, depth: Array) -> list[int]:
    return [int(i) for i in np.tile(some, len(depth))]


def _together(
    cases: list[tuple[Structure, Cut]], depths: int, columns: int
) -> Iterator[tuple[Array, Complex, Complex, Array]]:
    """Groups of cases of similar tooth periods: indices, poles (nm, nc), residues (nm, 3, nc), tooth periods."""
    order = np.argsort([cut.period for _, cut in cases])
    for some in np.array_split(order, max(1, -(-len(cases) * depths // columns))):
        found = [poles(cases[i][0], tip_rows(*cases[i])) for i in some]
        most = max(len(p) for p, _ in found)
        pole = np.full((most, len(some)), -1.0 + 1j)
        residue = np.zeros((most, 3, len(some)), complex)
        for k, (p, u) in enumerate(found):
            pole[: len(p), k], residue[: len(p), :, k] = p, u
        yield some, pole, residue, np.array([cases[i][1].period for i in some])


# --- teeth that may leave the work ------------------------------------------------------------------------------------


def cut_in_time(
    pole: Complex, residue: Complex, cuts: list[Cut], depth: Array, steps: int = 60, seconds: float = 6.0
) -> Array:
    """Whether each of nc cuts chatters, from rest, brought to its depth (nc,) m within `RAMP_S`.

    A piece of a tooth cuts what the last that passed its angle has left, and nothing where it does not reach the work;
    then the work comes nearer by the feed. Chatter is a motion that differs from tooth to tooth and does not settle: it
    grows, or goes on bounded by teeth that leave the work.

    pole (nm, nc) and residue (nm, 3, nc) of the tip.
    """
    columns = len(cuts)
    period = np.array([cut.period for cut in cuts])
    normal, shear, edge, share = _blades(cuts, depth, steps)  # (steps, slots, 2 | 3 | 3 | -, nc)
    feed = normal[:, :, 0] * np.array([cut.feed_per_tooth for cut in cuts])  # sin φ
    w = pole * period / steps
    fade = np.exp(w)
    late = (np.exp(w) - 1 - w) / (w * pole)
    early = (np.exp(w) - 1) / pole - late
    early, late = residue * early[:, None], residue * late[:, None]
    own = 2 * np.einsum("kic,kjc->ijc", residue, late).real
    read = 2 * residue
    z = np.zeros(pole.shape, complex)
    left = np.zeros(feed.shape)  # where the last tooth left the work, by place and column
    push = np.zeros((3, columns))
    before, now = np.zeros((steps, 3, columns)), np.zeros((steps, 3, columns))
    farthest = 0.1 * np.array([cut.diameter for cut in cuts])
    count = int(np.ceil(seconds / period.min()))
    change, out, gone = np.zeros((count, columns)), np.zeros((count, columns), bool), np.zeros(columns, bool)
    for number in range(count):
        for k in range(steps):
            held = np.minimum(1.0, (number + k / steps) * period / RAMP_S)
            z = z * fade + (early * push).sum(axis=1)
            moved = np.stack([(read[:, axis] * z).sum(axis=0).real for axis in range(3)])
            for _ in range(2):  # the force at the end of the step moves the tip there
                at = moved + (own * push).sum(axis=1)
                reach = normal[k, :, 0] * at[0] + normal[k, :, 1] * at[1]
                chip = reach - left[k] + feed[k]
                cuts_now = (chip > 0) & (share[k] > 0)
                size = np.where(cuts_now, chip, 0.0) * held
                push = np.einsum("pic,pc->ic", shear[k], size) + np.einsum("pic,pc->ic", edge[k], cuts_now * held)
            left[k] = np.where(cuts_now, reach, left[k] - feed[k])
            out[number] |= ((share[k] > 0) & ~cuts_now).any(axis=0)
            z = z + (late * push).sum(axis=1)
            now[k] = moved + (own * push).sum(axis=1)
        wild = np.abs(now).max(axis=(0, 1)) > farthest
        gone |= wild
        z[:, gone], push[:, gone], left[..., gone], now[..., gone] = 0, 0, 0, 0  # no chatter need be followed farther
        shear[..., gone], edge[..., gone] = 0, 0
        change[number] = np.sqrt(((now - before) ** 2).sum(axis=1).mean(axis=0))
        before, now = now, before
    return gone | _goes_on(change, out, np.array([cut.feed_per_tooth for cut in cuts]))


def _goes_on(change: Array, out: Array, feed: Array) -> Array:
    """Whether (nc,) the change from tooth to tooth (np, nc), m, did not settle; `out` (np, nc): teeth left the work."""
    count = len(change)
    half, last = change[count // 2 :], change[-max(2, count // 10) :]
    time = np.arange(len(half), dtype=float)
    time -= time.mean()
    slope = (time[:, None] * np.log(np.maximum(half, 1e-300))).sum(axis=0) / (time**2).sum()
    left = out[count // 2 :].any(axis=0)
    fades = np.where(left, slope * len(half) < -FADING, slope < 0)
    return np.asarray((np.sqrt((last**2).mean(axis=0)) > QUIET * feed) & ~fades)


def _blades(cuts: list[Cut], depth: Array, steps: int) -> tuple[Array, Array, Array, Array]:
    """Pieces of teeth at steps of a tooth period: chip normals (steps, slots, 2, nc), forces (steps, slots, 3, nc) per
    chip and of the edge alone, and the share (steps, slots, nc) of the step that each is in the work."""
    found = [_angles(cut, steps, b) for cut, b in zip(cuts, depth, strict=True)]
    slots = max(phi.shape[0] for phi, _ in found)
    normal, share = np.zeros((steps, slots, 2, len(cuts))), np.zeros((steps, slots, len(cuts)))
    shear, edge = np.zeros((steps, slots, 3, len(cuts))), np.zeros((steps, slots, 3, len(cuts)))
    for c, (cut, b, (phi, inside)) in enumerate(zip(cuts, depth, found, strict=True)):
        part = inside.mean(axis=2)
        middle = (phi * inside).sum(axis=2) / np.maximum(inside.sum(axis=2), 1)
        own = part * b * cut.teeth / len(phi)
        n = len(phi)
        unit, force = _along(cut.coefficients, middle)
        normal[:, :n, :, c] = unit[:2].transpose(2, 1, 0)
        shear[:, :n, :, c] = (force * own).transpose(2, 1, 0)
        edge[:, :n, :, c] = (_along(cut.edge, middle)[1] * own).transpose(2, 1, 0)
        share[:, :n, c] = part.T
    return normal, shear, edge, share
