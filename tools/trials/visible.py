"""How large an effect has to be to be seen: its signature after everything a modeller would refit has moved to hide it.

Both recordings are turned into vectors in units of their noise, y(truth). What nobody knows exactly (springs,
dampers, masses, posture, gains, places, friction) is fitted to the recording with the effect, each under its tolerance
as a prior; half the squared length of what that leaves, prior included, is how far the effect shows, in logarithms of a
likelihood ratio. The smallest visible size is where that is `SEEN`, by derivatives; at a multiple of it what shows is
`SEEN` times the multiple's square, by a fit: what a softer neighbour or a damper imitates far beyond its derivative
would else pass for visible. All of it by the truth code alone.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tools.truth.chain import Array, Chain, Link, Tolerances, kr90
from tools.truth.effects import Effect
from tools.truth.elastic import Structure
from tools.truth.motion import Log, Run, motor_torque
from tools.truth.recording import HammerTest, Posture, Truth, accelerance, hit_variance, structure_at

SEEN = 8.0
HIGHEST_HZ = 10.0  # of a torque: above, the low-pass of any identification has the word
TRANSMISSION_RAD = 2e-5  # RMS: what a gear's own error leaves of the difference between two encoders
REPEATABLE = 0.05  # relative, near resonances: of FRFs at two force levels
SETTLED_RAD = 1e-3  # from a reversal, within which nobody knows the friction: `Log.friction` has up to 2e-3
PLACED_M = 5e-3  # one standard deviation of where a file says that sensors and blows are
TURNED_RAD = np.deg2rad(0.1)  # the same of their directions
EVERY = 5  # samples of a motion log, of which one is taken
SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 100.0  # of sizes as drawn, between which one is sought that shows
STEP = 1e-4  # of derivatives: in deviations of a nuisance, in sizes of an effect as drawn
FITS = 30  # steps of a refit, those that do not help among them
FITTED = 1e-3  # share of what is left that one step more would gain, below which a refit ends
LEAST_SHARE = 0.1  # of what the derivatives promise, which a step that helps gains
IMPOSSIBLE = 1e9  # deviations: what a robot that cannot be answers
FARTHEST = 100.0  # deviations of a nuisance: one more would itself show more than any effect that is drawn
FASTER = 2.0  # than as the square of a size may what shows grow; beyond, the refit is taken to have got stuck
LEAST_RATIO = 1.2  # of two sizes, between which a refit takes no step more
MOST_FITS = 8  # on the way to a size; nearly all effects need one to three, a few would need hundreds
KEPT = 1000  # FRFs of a posture, some 50 MB
NEAR = 1.15  # what shows over what is to show, from which on a size is not drawn in or out again,
CORRECTIONS = 8  # as often

Signal = Callable[[Truth], Array]


@dataclass(frozen=True)
class Nuisance:
    """A number that a modeller does not know: `change`(truth, deviations), `width` of its logarithm or 0."""

    change: Callable[[Truth, float], Truth]
    width: float = 0.0


def scaled(effect: Effect, factor: float) -> Effect:
    """The effect `factor` times as large: a spring in series so much softer, any other so much stronger."""
    p = dict(effect.parameters)
    kind = effect.kind
    if kind in ("transverse_compliance", "base_compliance", "link_flexibility", "servo_compliance"):
        p = {**p, "stiffness": effect["stiffness"] / factor, "damping": effect["damping"] / factor}
    elif kind in ("sensor_gain", "torque_constant"):
        p["gain"] = 1 + (effect["gain"] - 1) * factor
    elif kind == "hysteresis":
        p = {name: (effect.array(name) * factor).tolist() for name in ("stiffness", "yield_torque")}
    elif kind == "asymmetric_friction":
        p = {name: effect[name] * factor for name in p}
    else:
        first = {"cable_stiffness": "stiffness", "torque_ripple": "amplitude", "joint_coupling": "ratio"}
        name = first.get(kind, next(iter(p)))
        p[name] = (effect.array(name) * factor).tolist() if isinstance(p[name], list) else effect[name] * factor
    return Effect(kind, effect.site, p)


def multiple_of_visible(
    effect: Effect,
    truth: Truth,
    signal: Signal,
    multiple: float,
    project: bool = True,
    *,
    described: Chain | None = None,
    known: Tolerances | None = None,
    tension: bool = True,
) -> Effect:
    """The effect at so many times its smallest visible size on the recording of `truth`, which is without it.

    `described`: the robot as its description has it (default: KR90), `known` how well it knows it. `tension`: what
    shows as numbers far from their description counts, too; without it what the recording itself keeps.

    Raises:
        ValueError: the recording shows no usual size of it, less of that multiple than of the smallest, or more than a
            refit can follow.
    """
    base = signal(truth)

    def changed(factor: float) -> Array:
        return signal(_with(truth, scaled(effect, factor))) - base

    if not project:
        smallest = _visible_factor(changed)
        if 0.5 * float(np.sum(changed(smallest * multiple) ** 2)) < SEEN:
            raise ValueError(f"{effect.kind}@{effect.site}: expected more of it to show more")
        return scaled(effect, smallest * multiple)
    every = _nuisances(truth, described or kr90(), known or Tolerances())
    nuisances = [n for n in every if not np.array_equal(signal(n.change(truth, STEP)), base)]  # blows of other points
    small = _hidden(signal, truth, nuisances, _tangent(changed))
    if not (left := small.shown if tension else small.kept) > 0:
        raise ValueError(f"{effect.kind}@{effect.site}: expected an effect that this recording shows")
    factor, asked = float(np.sqrt(SEEN / left) * multiple), SEEN * multiple**2
    too_small: tuple[float, float] | None = None  # logarithms of a size and of what it shows
    too_large: tuple[float, float] | None = None
    path = _path(signal, truth, nuisances, changed, small)
    for _ in range(CORRECTIONS):
        if factor > LARGEST_FACTOR:  # as a gap in a joint whose load never changes sign
            break
        found = path.to(factor)
        shown = found.shown if tension else found.kept
        if asked / NEAR < shown < asked * NEAR:
            return scaled(effect, factor)
        point = float(np.log(factor)), float(np.log(max(shown, 1e-12) / asked))
        too_small, too_large = (point, too_large) if shown < asked else (too_small, point)
        if too_small and too_large:
            share = np.clip(-too_small[1] / (too_large[1] - too_small[1]), 0.1, 0.9)
            factor = float(np.exp(too_small[0] + share * (too_large[0] - too_small[0])))
        else:
            factor *= float(np.clip(np.exp(-0.5 * point[1]), 0.3, 3.0))
    raise ValueError(f"{effect.kind}@{effect.site}: expected an effect that this recording shows at a usual size")


def shows(truth: Truth, signal: Signal, change: Array, described: Chain, known: Tolerances) -> float:
    """How far a change of the recording, in units of its noise, shows: ln of a likelihood ratio, to first order.

    What nobody knows exactly has moved to explain it, each number paying for its deviations as the description states.
    """
    return _hidden(signal, truth, list(_nuisances(truth, described, known)), change).shown


def kept(effect: Effect, truth: Truth, signal: Signal) -> float:
    """What the recording itself keeps of an effect, ½ |·|² over its noise, after all that nobody knows has moved.

    Numbers far from their description do not count, see `tension` of `multiple_of_visible`.
    """
    base = signal(truth)

    def changed(factor: float) -> Array:
        return signal(_with(truth, scaled(effect, factor))) - base

    every = [
        n for n in _nuisances(truth, kr90(), Tolerances()) if not np.array_equal(signal(n.change(truth, STEP)), base)
    ]
    small = _hidden(signal, truth, every, _tangent(changed))
    return _path(signal, truth, every, changed, small).to(1.0).kept


def _tangent(changed: Callable[[float], Array]) -> Array:
    """Slope of a signature where the effect begins, one-sided: a size has a sign."""
    return (4 * changed(STEP) - changed(2 * STEP)) / (2 * STEP)


@dataclass(frozen=True)
class _Fit:
    """An effect `factor` times as drawn and the deviations `z` that hide it best.

    `shown` is what is left, ½ |·|² over noise and tolerances; `kept` is the recording's part of it.
    """

    factor: float
    z: Array
    shown: float
    kept: float


def _hidden(signal: Signal, truth: Truth, nuisances: Sequence[Nuisance], change: Array) -> _Fit:
    """What hides a change of the recording, to first order."""
    ends = ((n.change(truth, STEP), n.change(truth, -STEP)) for n in nuisances)
    J = np.array([(signal(up) - signal(down)) / (2 * STEP) for up, down in ends]).T
    # by orthogonal factors: what is left may be 1e-5 of the signature, which normal equations lose
    Q, R = np.linalg.qr(np.vstack([J, np.eye(J.shape[1])]))
    whole = np.concatenate([change, np.zeros(J.shape[1])])
    left = 0.5 * (whole - Q @ (Q.T @ whole)) ** 2
    return _Fit(1.0, np.linalg.solve(R, Q.T @ whole), float(np.sum(left)), float(np.sum(left[: len(change)])))


def overlap(first: Effect, second: Effect, truth: Truth, signal: Signal) -> float:
    """Cosine between the signatures of two effects: −1 where one hides the other."""
    base = signal(truth)
    a, b = (signal(_with(truth, scaled(e, STEP))) - base for e in (first, second))
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def _with(truth: Truth, effect: Effect) -> Truth:
    return replace(truth, effects=(*truth.effects, effect))


@dataclass
class _Path:
    """Fits of what hides an effect, followed from its smallest size up.

    A resonance that has moved by more than its width no longer tells a fit where it was. From a size somewhat smaller,
    whose fit is known, it has not. So what shows grows about as the square of a size; where it seems to grow faster,
    smaller steps are taken.
    """

    fit: Callable[[float, Sequence[Array]], _Fit]
    width: Array
    fits: list[_Fit]
    count: int = 0

    def to(self, factor: float) -> _Fit:
        """The fit at a size.

        Raises:
            ValueError: however small the steps, a fit gets stuck on the way; or the way is too long.
        """
        low = max((f for f in self.fits if f.factor <= factor), key=lambda f: f.factor, default=self.fits[0])
        ratio = factor / low.factor
        self.count += 1
        if self.count > MOST_FITS:
            raise ValueError("expected an effect that a refit can follow to this size in fewer steps")
        found = self.fit(factor, (self._grown(low.z, ratio), low.z, 0 * low.z))
        if found.shown > FASTER * max(low.shown * ratio**2, SEEN):
            if ratio < LEAST_RATIO:
                raise ValueError("expected an effect that a refit can follow to this size")
            self.to(float(np.sqrt(low.factor * factor)) if low is not self.fits[0] else factor / LEAST_RATIO**4)
            return self.to(factor)
        self.fits.append(found)
        return found

    def _grown(self, z: Array, ratio: float) -> Array:
        """Deviations at a size so many times as large.

        A spring in series makes the logarithm of a neighbour's stiffness move as log(1 + size).
        """
        safe = np.where(self.width > 0, self.width, 1.0)
        size = np.expm1(safe * np.abs(z)) / safe * ratio
        return np.where(self.width > 0, np.sign(z) * np.log1p(safe * size) / safe, z * ratio)


def _path(
    signal: Signal, truth: Truth, nuisances: Sequence[Nuisance], changed: Callable[[float], Array], slope: _Fit
) -> _Path:  # fmt: skip
    """From a size so small that derivatives hold: `slope` is what they make of the effect as drawn."""
    base = signal(truth)

    def moved(z: Array) -> Truth:
        out = truth
        for nuisance, value in zip(nuisances, z, strict=True):
            out = nuisance.change(out, float(value))
        return out

    def slopes(z: Array) -> Array:
        there = moved(z)
        known = signal(there)
        ahead = [(signal(n.change(there, STEP)) - known) / STEP for n in nuisances]
        return np.vstack([np.array(ahead).T, np.eye(len(z))])

    def fit(factor: float, starts: Sequence[Array]) -> _Fit:
        seen = base + changed(factor)

        def residual(z: Array) -> Array:
            if not np.abs(z).max() < FARTHEST:
                return np.full(len(seen) + len(z), IMPOSSIBLE)
            return np.nan_to_num(np.concatenate([signal(moved(z)) - seen, z]), nan=IMPOSSIBLE)

        with np.errstate(invalid="ignore"):
            z, r = _least(residual, slopes, min(starts, key=lambda z: float(np.sum(residual(z) ** 2))))
        return _Fit(factor, z, 0.5 * float(r @ r), 0.5 * float(np.sum(r[: len(seen)] ** 2)))

    small = _Fit(STEP, STEP * slope.z, slope.shown * STEP**2, slope.kept * STEP**2)
    return _Path(fit, np.array([n.width for n in nuisances]), [small])


def _least(residual: Callable[[Array], Array], slopes: Callable[[Array], Array], z: Array) -> tuple[Array, Array]:
    """Deviations by the steps of Levenberg and Marquardt, and the least residuals (m,) that derivatives there promise.

    Derivatives cost as much as a hundred residuals. They are kept up by Broyden's update, and computed again where a
    step does not help, and at the end: there another step would gain less than `FITTED`. Along a curved valley a
    hundred noises deep, steps are short and the end is far. Derivatives on its floor say how deep it is.
    """
    r, J, exact, held = residual(z), slopes(z), True, 0.0
    for _ in range(FITS):
        step = np.linalg.solve(J.T @ J + held * np.eye(len(z)), -J.T @ r)
        promised = float(r @ r - np.sum((r + J @ step) ** 2))
        if promised > FITTED * float(r @ r):
            there = residual(z + step)
            if r @ r - there @ there > LEAST_SHARE * promised:
                z, J, exact = z + step, J + np.outer(there - r - J @ step, step) / (step @ step), False
                r, held = there, held / 10 if held > 1 else 0.0
                continue
        elif exact:
            break
        if exact:
            held = max(10 * held, 1.0)
        else:
            J, exact = slopes(z), True
    J = J if exact else slopes(z)
    return z, r + J @ np.linalg.solve(J.T @ J, -J.T @ r)


def _visible_factor(changed: Callable[[float], Array]) -> float:
    """The smallest size at which a signature that nothing else makes, and that is no multiple of the size, is seen.

    Walked up from where nothing shows: a spring that hardens until it is rigid, or slip that never yields, differ from
    level to level less again.

    Raises:
        ValueError: no size shows, as play in a joint that gravity presses to one side.
    """

    def energy(factor: float) -> float:
        return 0.5 * float(np.sum(changed(factor) ** 2))

    low = SMALLEST_FACTOR
    while (faint := energy(low)) >= SEEN:
        low /= 10
    while low < LARGEST_FACTOR:
        factor = low * float(np.clip(np.sqrt(SEEN / max(faint, 1e-12)), 1.5, 4.0))
        found = energy(factor)
        if found >= SEEN:
            share = np.log(SEEN / max(faint, 1e-12)) / np.log(found / max(faint, 1e-12))
            return float(low * (factor / low) ** share)
        low, faint = factor, found
    raise ValueError("expected an effect of which some size shows in this recording")


def _nuisances(truth: Truth, described: Chain, known: Tolerances) -> Iterator[Nuisance]:
    """What a modeller does not know, in deviations."""
    chain, log = truth.chain, not truth.posture_error

    def of_chain(name: str, index: tuple[int, ...], width: float) -> Nuisance:
        def change(truth: Truth, z: float) -> Truth:
            values = getattr(truth.chain, name).copy()
            values[index] *= np.exp(width * z)
            return replace(truth, chain=replace(truth.chain, **{name: values}))

        return Nuisance(change, width)

    def of_link(i: int, edit: Callable[[Link, float], Link]) -> Nuisance:
        def change(truth: Truth, z: float) -> Truth:
            links = list(truth.chain.links)
            links[i] = edit(links[i], z)
            return replace(truth, chain=replace(truth.chain, links=tuple(links)))

        return Nuisance(change)

    def of_posture(name: str, i: int) -> Nuisance:
        def change(truth: Truth, z: float) -> Truth:
            error = truth.posture_error[name] + np.deg2rad(0.2) * z * np.eye(chain.n)[i]
            return replace(truth, posture_error={**truth.posture_error, name: error})

        return Nuisance(change)

    def of_gain(label: str) -> Nuisance:
        def change(truth: Truth, z: float) -> Truth:
            return replace(truth, gain={**truth.gain, label: truth.gain.get(label, 1.0) * (1 + 0.01 * z)})

        return Nuisance(change)

    def of_channel(which: str, width: float, site: str, k: int) -> Nuisance:
        def change(truth: Truth, z: float) -> Truth:
            known = getattr(truth, which)
            return replace(truth, **{which: {**known, site: known.get(site, np.zeros(3)) + width * z * np.eye(3)[k]}})

        return Nuisance(change)

    for i in range(chain.n):
        yield of_link(i, lambda link, z: replace(link, mass=link.mass * (1 + 0.03 * z)))
        for k in range(3):
            yield of_link(i, lambda link, z, k=k: replace(link, com=link.com + known.com * z * np.eye(3)[k]))
            for j in range(k + 1):
                yield of_link(i, lambda link, z, j=j, k=k: replace(link, inertia=_changed(link.inertia, j, k, z)))
    if log:
        for i in range(chain.n):
            yield of_chain("stiffness", (i, 0), np.log(known.stiffness))  # between two encoders
            for name, width in (("viscous", 0.3), ("coulomb", 0.3), ("rotor_inertia", 0.1)):
                if getattr(chain, name)[i]:
                    yield of_chain(name, (i,), width)
        for index in zip(*np.nonzero(chain.compensator), strict=True):
            yield of_chain("compensator", index, 0.1)
        return
    for index in np.ndindex(chain.stiffness.shape):
        if np.isfinite(chain.stiffness[index]):
            poor = described.damping[index] < known.poor_damping  # as the robot was drawn
            yield of_chain("stiffness", index, np.log(known.stiffness))
            yield of_chain("damping", index, np.log(known.damping_poor if poor else known.damping))
    for name in truth.posture_error:
        for i in range(chain.n):
            yield of_posture(name, i)
    for channel in truth.sensors:
        yield of_gain(channel.label)
    nodes = [f"sensor:{node}" for node in dict.fromkeys(c.node for c in truth.sensors)]
    for site in (*nodes, *(f"hammer:{c.label}" for c in truth.hammer)):
        for k in range(3):
            yield of_channel("moved", PLACED_M, site, k)
            yield of_channel("turned", TURNED_RAD, site, k)


def _changed(inertia: Array, j: int, k: int, z: float) -> Array:
    out = inertia.copy()
    out[j, k] += 0.03 * z * np.sqrt(inertia[j, j] * inertia[k, k])
    out[k, j] = out[j, k]
    return out


def hammer_signal(postures: tuple[Posture, ...], test: HammerTest, points: Sequence[int]) -> Signal:
    """FRFs of a linear truth at the blow points `points` in units of their noise, at every line.

    A resonance may be as narrow as the spacing of the lines: fewer of them would miss it, or give it too much weight.
    Without sag, which moves no signature by much. A posture whose angles have not changed is not computed again.
    """
    smooth = replace(test, window=test.decay, levels_n=(), hits=0)
    deviation: dict[str, Array] = {}
    known: dict[tuple[str, int], tuple[Truth, Array]] = {}
    stands: dict[str, tuple[Truth, Structure]] = {}  # of a posture the last one: channels change none

    def structure(truth: Truth, posture: Posture) -> Structure:
        name = posture.name
        if name in stands:
            before, found = stands[name]
            same = before.chain is truth.chain and before.effects == truth.effects
            if same and np.array_equal(before.posture_error[name], truth.posture_error[name]):
                return found
        stands[name] = truth, structure_at(truth, posture)
        return stands[name][1]

    def frf(truth: Truth, posture: Posture) -> Array:
        key = posture.name, id(truth.chain)
        if key in known:
            before, found = known[key]
            same = before.chain is truth.chain and before.effects == truth.effects and before.gain == truth.gain
            same = same and before.moved is truth.moved and before.turned is truth.turned
            if same and np.array_equal(before.posture_error[posture.name], truth.posture_error[posture.name]):
                return found
        upright = replace(truth, sag=False)
        stiff = [structure(upright, posture)]
        found = accelerance(upright, (posture,), smooth, structures=stiff)[0][0, 0][:, :, list(points)]
        if key not in known:
            if len(known) >= KEPT:
                known.clear()
            known[key] = truth, found
        return found

    def signal(truth: Truth) -> Array:
        parts = []
        for posture in postures:
            found = frf(truth, posture)
            if posture.name not in deviation:
                deviation[posture.name] = _deviation(found, test, test.peak_n, test.frequency)
            parts.append((found / deviation[posture.name]).astype(complex).ravel().view(float))
        return np.concatenate(parts)

    return signal


def level_signal(postures: tuple[Posture, ...], test: HammerTest, points: Sequence[int]) -> Signal:
    """Difference between the highest and the lowest force level in units of its noise: zero for a linear truth.

    However many lines there are, a difference of less than `REPEATABLE`, RMS, is not taken for one.
    """
    coarse = replace(test, levels_n=(min(test.levels_n), max(test.levels_n)), spread=0.0, hits=0)

    def signal(truth: Truth) -> Array:
        parts = []
        for frf in accelerance(truth, postures, coarse):
            low, high = frf[0, 0][:, :, list(points)], frf[1, 0][:, :, list(points)]
            pairs = zip((low, high), coarse.peaks, strict=True)
            noise = [_deviation(f, test, p, test.frequency) for f, p in pairs]
            floor = REPEATABLE * np.abs(low) * np.sqrt(low.size / SEEN)
            parts.append(((high - low) / np.sqrt(noise[0] ** 2 + noise[1] ** 2 + floor**2)).ravel().view(float))
        return np.concatenate(parts)

    return signal


def _deviation(frf: Array, test: HammerTest, peak_n: float, frequency: Array) -> Array:
    """Standard deviation of real and imaginary part of an averaged FRF, as of lines that are independent.

    Recorded in time, σT coth σT lines share the noise of one under a window of rate σ.
    """
    tied = test.decay / test.spacing_hz if test.hits else 0.0
    shared = tied / np.tanh(tied) if tied else 1.0
    return np.sqrt(hit_variance(test, frf, peak_n, frequency) / 2 / test.averages * shared)


def _sliding(q: Array) -> Array:
    """How far the friction of axes q (nt, n) can be known, 0 to 1: nothing where an axis rests, starts or turns round.

    By its sign alone the friction of a coupled drive would show in which sample it turned round.
    """
    known = np.empty(q.shape)
    for j, one in enumerate(q.T):
        step = np.diff(one)
        travel = np.concatenate([[0.0], np.cumsum(np.abs(step))])
        turns = travel[np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.sign(step))), [len(step)]])]
        known[:, j] = 1 - np.exp(-np.abs(travel[:, None] - turns).min(1) / SETTLED_RAD)
    return known


@dataclass(frozen=True)
class LogSignal:
    """Torques in units of their coloured noise, up to `HIGHEST_HZ`, offsets free; and what a second encoder adds.

    However many samples there are, a twist of less than `TRANSMISSION_RAD`, RMS, is not seen.
    """

    runs: tuple[Run, ...]
    log: Log

    def __call__(self, truth: Truth) -> Array:
        parts, rate = [], self.log.rate_hz / EVERY
        plain = replace(self.log, friction="coulomb")  # which memory friction has matters to its size by little
        samples = sum(len(run.time[::EVERY]) for run in self.runs)
        for run in self.runs:
            link, motor, torque = motor_torque(truth, replace(run, time=run.time[::EVERY]), plain)
            known = _sliding(motor)
            total = np.sum(list(torque.values()), axis=0) * known
            spectrum, offset = (np.fft.rfft(x, axis=0) / np.sqrt(len(total) / 2) for x in (total, known))
            frequency = np.fft.rfftfreq(len(total), 1 / rate)
            kept = (frequency > 0) & (frequency <= HIGHEST_HZ)
            keep = np.exp(-1 / (self.log.colour_s * rate))
            shape = (1 - keep**2) / np.abs(1 - keep * np.exp(-2j * np.pi * frequency / rate)) ** 2
            density = self.log.white**2 / EVERY + self.log.coloured**2 * shape
            white, offset = (x[kept] / np.sqrt(density[kept])[:, None] for x in (spectrum, offset))
            like = np.sum(offset.conj() * white, axis=0).real / np.maximum(np.sum(np.abs(offset) ** 2, axis=0), 1e-300)
            parts.append((white - offset * like).ravel().view(float))
            if self.log.link_encoder:
                twist = motor - link
                parts.append(((twist - twist.mean(0)) / (TRANSMISSION_RAD * np.sqrt(samples / (2 * SEEN)))).ravel())
        return np.concatenate(parts)
