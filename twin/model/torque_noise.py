"""The noise of a log's torque, which is coloured.

Rows are whitened, joint by joint, with an autoregression of the residual that the richest model leaves. That model has
the base, every suspect and a free function of each joint's state. What such a rich fit has taken out of the noise is
put back line by line (leverage).
"""

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.fft
import scipy.linalg
from scipy.linalg.lapack import dormqr, dsytrd
from scipy.signal import lfilter

from twin.measure.campaign import FloatArray
from twin.model.torque_base import NOISE_ORDER, Base
from twin.model.torque_design import Block, Design
from twin.model.torque_laws import USUAL_SHARE, smooth_columns
from twin.model.torque_signal import Run
from twin.model.torque_stops import stop_columns
from twin.parallel import spread
from twin.physics import effect_of

MOST_TAKEN = 0.8  # share of the noise's power at a frequency that a fit is allowed to have explained away
ROUNDED = 8 / 4096 / 12**0.5  # of a torque's RMS: noise of a 12-bit converter whose range is four times that RMS
MUCH_TAKEN = 0.2  # share of the rows of a log that the richest model fits by itself


def noise_order(runs: Sequence[Run]) -> int:
    """Order of the autoregression that uninterrupted rows allow."""
    lengths: list[int] = []
    for run in runs:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], run.valid.astype(int), [0]])))
        lengths += (edges[1::2] - edges[::2]).tolist()
    return int(np.clip(np.median(lengths) / 6, 2, NOISE_ORDER)) if lengths else 2


def plain_fit(base: Base) -> FloatArray:
    """z by least squares with white noise at the level of the residual."""
    y = np.concatenate([rest[r.valid] for rest, r in zip(base.rest, base.runs, strict=True)])
    noise = 0.05 * np.sqrt(np.mean(y**2, axis=0)) + 1e-9
    blocks = tuple(_rows(base, j)[np.concatenate([r.valid for r in base.runs])] for j in range(y.shape[1]))
    for _ in range(3):
        scaled = tuple(Block(j, base.acting(j), rows / noise[j]) for j, rows in enumerate(blocks))
        W = Design(len(y), len(scaled), scaled, np.ones(len(base.parameters)))
        z = np.asarray(np.linalg.solve(W.gram + np.eye(W.width), W.transposed((y / noise).T.ravel())), float)
        rest = y - noise * W.times(z).reshape(y.shape[1], -1).T
        noise = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), 1e-9 * np.abs(y).max(axis=0) + 1e-300)
    return z


def _rows(base: Base, joint: int) -> FloatArray:
    """Torque of a joint per unit of the numbers that can act on it, runs together."""
    return np.concatenate([base.design(k, joint) for k in range(len(base.runs))])


def dry_friction(base: Base) -> FloatArray:
    """A joint's dry friction (n,), N·m (N), as least squares find it, also where none is described.

    At rest, of a parabola in speed: friction that rises and bends with speed else passes for some of it. What else the
    description lacks, a payload, is slow beside a step: rows are weighted by the spectrum of what a first fit leaves.
    """
    found = np.zeros_like(base.friction)
    order, valid = noise_order(base.runs), [r.valid for r in base.runs]
    dry = effect_of("dry")
    for j, scale in enumerate(base.friction):
        level = f"{dry.name}@joint{j + 1}.{dry.parameters[0].name}"
        described = [k for k, p in enumerate(base.parameters) if p.name == level]
        fastest = span_of(base.runs, j)[2]
        parts = []
        for k, (run, rest) in enumerate(zip(base.runs, base.rest, strict=True)):
            speed = run.dense.velocity[:, j]
            v = speed / fastest
            own = run.filtered(np.stack([run.dense.sign(speed), v, v * np.abs(v)], -1))
            parts.append(np.column_stack([scale * own, base.design(k, j), rest[:, j]]))
        rows = np.concatenate([part[use] for part, use in zip(parts, valid, strict=True)])
        x = _ridged(rows, 0.05**2 * np.mean(rows[:, -1] ** 2))
        left = [use * (part[:, -1] - part[:, :-1] @ x) for part, use in zip(parts, valid, strict=True)]
        none = [np.zeros((len(e), 1)) for e in left]
        whitening = prediction_filter(_correlation(left, none, valid, order))
        white = [
            lfilter(whitening, [1.0], part, axis=0)[whole_rows(use, order)]
            for part, use in zip(parts, valid, strict=True)
        ]
        x = _ridged(np.concatenate(white), 1.0)
        found[j] = scale * x[0] + sum(
            base.parameters[k].value(base.parameters[k].deviation * x[3 + k]) for k in described
        )
    return np.maximum(found, 0.0)


def _ridged(rows: FloatArray, ridge: float) -> FloatArray:
    """Least squares of the last column on the others, their numbers held to zero by a ridge."""
    columns = rows[:, :-1]
    return np.asarray(np.linalg.solve(columns.T @ columns + ridge * np.eye(columns.shape[1]), columns.T @ rows[:, -1]))


def whole_rows(valid: np.ndarray, order: int) -> np.ndarray:
    """Rows (m,) whose whitened residual rests on valid rows only."""
    bad = np.cumsum(np.concatenate([np.ones(order + 1, int), ~valid]))
    return valid & (bad[order + 1 :] - bad[: -order - 1] == 0)


def whitening(
    base: Base, extra: Sequence[Sequence[FloatArray]], order: int, processes: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of every joint: prediction-error filter (n, order + 1), level of the noise filtered so (n,), and its RMS (n,).

    ``extra`` are columns (m,) per joint, runs together, that the richest model has beside the base.
    """
    data = np.concatenate(base.rest)
    found = spread(lambda j: _noise(base, j, data[:, j], extra[j], order), len(extra), processes)
    filters, level, noise = zip(*found, strict=True)
    return np.array(filters), np.array(level), np.array(noise)


def _noise(
    base: Base, j: int, data: FloatArray, extra: Sequence[FloatArray], order: int
) -> tuple[FloatArray, float, float]:
    """Prediction-error filter (order + 1,) of a joint's noise, its level when filtered so, and its RMS.

    Args:
        base, j: of a joint, ``data`` (m,) its recorded less described torque, runs together.
        extra: columns (m,) that a model may have beside those of the base.
        order: of the filter.
    """
    valid = np.concatenate([r.valid for r in base.runs])
    ends = np.cumsum([len(r.time) for r in base.runs])[:-1]
    free = np.concatenate([smooth_columns(r, j, *span_of(base.runs, j)) for r in base.runs])
    stops = []
    for k, run in enumerate(base.runs):
        doubts = [(near, boxes) for near, boxes in stop_columns(run, j) if boxes.shape[1] > 2]  # not a step's alone
        for near, boxes in doubts[:60]:  # enough of a long run
            stops.append(np.zeros((len(valid), boxes.shape[1])))
            stops[-1][(ends[k - 1] if k else 0) :][near] = boxes
    y = data * valid
    recorded = np.concatenate([r.torque for r in base.runs])[:, j]
    usual = USUAL_SHARE * np.sqrt(np.mean(data[valid] ** 2) + np.mean(recorded**2))
    B = np.column_stack([free, *extra, *stops]) * valid[:, None]
    scale, extras = np.sqrt(np.mean(B**2, axis=0)), B.shape[1]
    B = np.column_stack([_rows(base, j) * valid[:, None], usual * (B / np.where(scale > 0, scale, 1))])
    size, turn = np.linalg.eigh(B.T @ B)
    keep = size > 1e-9 * size[-1]
    Q = B @ (turn[:, keep] / np.sqrt(size[keep]))
    size, along = size[keep], Q.T @ y
    variance = 1e-2 * float(np.mean(y**2))
    least = _ridge(size, 0.4 * float(valid.sum()))  # what is left of a short log tells its noise
    for _ in range(6):  # of the noise, and how far the data hold each direction against its prior
        share = size / (size + max(variance, least))
        e = y - Q @ (share * along)
        variance = max(float(e @ e) / max(valid.sum() - float(share.sum()), 0.1 * valid.sum()), 1e-300)
    Q = Q * np.sqrt(1 - (1 - share) ** 2)
    correlation = _correlation(np.split(e, ends), np.split(Q, ends), np.split(valid, ends), order)
    rounded = ROUNDED**2 * float(np.mean(recorded[valid] ** 2))
    correlation[0] += rounded
    whitening = prediction_filter(correlation)
    white = np.concatenate([lfilter(whitening, [1.0], part)[order:] for part in np.split(e, ends)])
    taken = float(np.sum(Q**2)) / valid.sum()
    level = float(white @ white) / max(1 - taken, 0.1) / valid.sum() + rounded * float(whitening @ whitening)
    found = whitening, level, float(np.sqrt(correlation[0]))
    if taken < MUCH_TAKEN:
        return found
    other = _likeliest_noise(base, B[:, :-extras], B[:, -extras:], y, valid, order, rounded)  # either is too low
    return max(found, other, key=lambda noise: noise[2])


def _likeliest_noise(
    base: Base, B: FloatArray, C: FloatArray, y: FloatArray, valid: np.ndarray, order: int, rounded: float,
    most: int = 400,
) -> tuple[FloatArray, float, float]:  # fmt: skip
    """As :func:`_noise`, for a short log: the noise that makes the data likeliest, all columns under their prior.

    In a short log the columns of a rich model span everything slow. Their share does not tell how much noise they took.
    So the noise is white noise and an autoregression of first order, as the low-pass leaves them. Their sizes maximise
    the marginal likelihood (Patterson, Thompson, Biometrika 58, 1971). So does the size of what may be missing: all of
    it at its usual size, or one effect of it.

    Args:
        base: of the runs.
        B, C: (m, k) columns of the base and of what may be missing, per prior deviation. Like the data y (m,), they are
            zero where a row does not count.
        valid: (m,) rows that count; ``most`` of them are enough.
        order: of the filter.
        rounded: power of white noise that is there at least, (N·m)² or N².
    """
    rows = np.flatnonzero(valid)[:most]
    run = np.repeat(np.arange(len(base.runs)), [len(r.time) for r in base.runs])[rows]
    apart, together = np.abs(rows[:, None] - rows), run[:, None] == run
    y, own, more = y[rows], B[rows] @ B[rows].T, C[rows] @ C[rows].T
    best, found, power = -np.inf, np.zeros(1), np.geomspace(1e-8, 1.0, 90) * float(np.mean(y**2))
    shares = np.geomspace(1 / C.shape[1], 1.0, 4)
    for correlation in _noises(base.runs[0], int(apart.max()) + 1):
        L = np.linalg.cholesky(together * correlation[apart] + 1e-4 * np.eye(len(rows)))
        inverse = scipy.linalg.solve_triangular(L, np.eye(len(rows)), lower=True)
        white, rest = inverse @ y, np.sum(np.log(np.diag(L)))
        least, beyond = (inverse @ model @ inverse.T for model in (own, more))
        likely = _likelihoods([least + share * beyond for share in shares], white, power).max(axis=0) - rest
        k = int(np.argmax(likely))
        if likely[k] > best:
            best, found = float(likely[k]), power[k] * correlation
    found = found + rounded * np.eye(1, len(found))[0]
    whitening = prediction_filter(found[: order + 1])
    level = float(whitening @ scipy.linalg.toeplitz(found[: order + 1]) @ whitening)
    return whitening, level, float(np.sqrt(found[0]))


def _likelihoods(covariances: Sequence[FloatArray], white: FloatArray, power: FloatArray) -> FloatArray:
    """Ln likelihoods (models, powers) of data (m,), but for a constant, under covariances (m, m) and white noise.

    Tridiagonal forms T = QᵀAQ take a quarter of the time of eigenvectors. T + power is factorised for all at once.
    """
    rows = len(white)
    diagonal, beside, data = np.empty((3, rows, len(covariances), 1))
    for k, covariance in enumerate(covariances):
        reflectors, diagonal[:, k, 0], beside[1:, k, 0], scales, _ = dsytrd(covariance, lower=1, lwork=64 * rows)
        turned, _, _ = dormqr("L", "T", np.asfortranarray(reflectors[1:, :-1]), scales, white[1:, None], 64)
        data[:, k, 0] = np.append(white[0], turned)
    pivot = np.maximum(diagonal[0] + power, power)
    left = np.broadcast_to(data[0], pivot.shape)
    twice = np.log(pivot) + left**2 / pivot
    for d, b, y in zip(diagonal[1:], beside[1:], data[1:], strict=True):
        ratio = b / pivot
        pivot = np.maximum(d + power - b * ratio, power)  # no variance is less than the white noise's
        left = y - ratio * left
        twice += np.log(pivot) + left**2 / pivot
    return np.asarray(-0.5 * twice)


def _noises(run: Run, lags: int) -> Iterator[FloatArray]:
    """Autocorrelations (lags,) at the rows of noise that is white and of such that fades, through the low-pass."""
    size = scipy.fft.next_fast_len(2 * lags, real=True)
    f = np.fft.rfftfreq(size, 1 / run.rate_hz)
    low, high = run.bands.fit
    gain = 0.5 * (1 + np.cos(np.pi * np.clip((f - low) / (high - low), 0, 1)))
    for fades_s in (0.05, 0.2, 0.8):
        fading = 1 / (1 + (2 * np.pi * f * fades_s) ** 2)
        fading *= np.sum(gain**2) / np.sum(gain**2 * fading)
        for share in (0.0, 0.3, 0.7, 0.95) if fades_s == 0.05 else (0.3, 0.7, 0.95):
            correlation = scipy.fft.irfft(gain**2 * (1 - share + share * fading), size)[:lags]
            yield correlation / correlation[0]


def _ridge(size: FloatArray, most: float) -> float:
    """The variance from which columns of such squared sizes take no more than ``most`` rows out of the noise."""
    if len(size) <= most:
        return 0.0
    low, high = np.log(size[size > 0].min()) - 10.0, np.log(size.max()) + 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sum(size / (size + np.exp(middle))) > most else (low, middle)
    return float(np.exp(high))


def span_of(runs: Sequence[Run], j: int) -> tuple[float, float, float]:
    q = np.concatenate([r.motion.position[:, j] for r in runs])
    v = np.concatenate([r.motion.velocity[:, j] for r in runs])
    half = max(0.5 * float(np.ptp(q)), 1e-9)
    return float(q.min()) + half, half, max(float(np.abs(v).max()), 1e-9)


def _correlation(residual: list[FloatArray], Q: list[FloatArray], valid: list[np.ndarray], order: int) -> FloatArray:
    """Autocovariance (order + 1,) of the noise under a residual; Q (m, k) is what a fit took out of it."""
    size = scipy.fft.next_fast_len(max(len(e) for e in residual) + 16 * order, real=True)
    power, taken, count = np.zeros(size // 2 + 1), np.zeros(size // 2 + 1), 0
    for e, q, use in zip(residual, Q, valid, strict=True):
        power += np.abs(scipy.fft.rfft(e, size)) ** 2
        taken += np.sum(np.abs(scipy.fft.rfft(q, size, axis=0)) ** 2, axis=1)
        count += int(use.sum())
    lags = 8 * order
    window = np.hanning(2 * lags + 1)[lags:]

    def smooth(density: FloatArray) -> FloatArray:
        correlation = scipy.fft.irfft(density, size)[: lags + 1] * window
        circle = np.zeros(size)
        circle[: lags + 1] = correlation
        circle[-lags:] = correlation[:0:-1]
        return np.maximum(scipy.fft.rfft(circle).real, 0.0)

    left = 1 - np.clip(smooth(taken) / max(count, 1), 0.0, MOST_TAKEN)
    correlation = scipy.fft.irfft(smooth(power) / left, size)[: order + 1] / max(count, 1)
    return correlation if correlation[0] > 0 else np.eye(1, order + 1)[0]


def prediction_filter(correlation: FloatArray, ridge: float = 1e-4) -> FloatArray:
    """Prediction-error filter (order + 1,) over the innovation's deviation (Levinson).

    White noise of ``ridge`` times the noise's power is added, so that stop bands are not amplified.
    """
    correlation = correlation.copy()
    correlation[0] *= 1 + ridge
    coefficients = scipy.linalg.solve_toeplitz(correlation[:-1], correlation[1:])
    innovation = correlation[0] - coefficients @ correlation[1:]
    return np.concatenate([[1.0], -coefficients]) / np.sqrt(max(innovation, 1e-12 * correlation[0]))
