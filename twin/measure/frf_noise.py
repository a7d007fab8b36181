"""The variance of measured FRFs as a diagnosis uses it: what coherence says, pooled until it can be believed.

Coherence from n hits gives a variance with 2(n − 1) degrees of freedom at every line. With five hits it scatters by a
factor of two. Weights that scatter with the noise they weigh make a true model look wrong. A blow's noise has two
parts, v = a(f) + b |H|². One does not depend on the response (sensor, background). One is in proportion to it (force
calibration, blows that differ). a is pooled over neighbouring lines of a channel pair, b over all that a blow excites.
"""

from collections.abc import Sequence
from math import comb

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import ComplexArray, FloatArray, PostureFRF, as_quantity, dead_channels, frf_variance

NEIGHBOURS = 25  # lines over which the additive part is pooled, and more
DEGREES = 150  # of freedom, to have so many: what scatters itself makes χ² too large
NOISE_STEPS = 10  # the first ones fit the noise, later ones its scatter
LOUDEST_LINES = (
    0.98  # quantile of |H|² over the lines and responses of a blow, from where on its noise is in proportion to it
)
POOLED_FROM = 0.1  # noise over signal, in power, where |H|² is pooled as well, over the NEAREST lines
NEAREST = 7
BROKEN_CHANNEL = 30.0  # times the usual variance of channels: noise that is not a sensor's
LEAST_VARIANCE = 1e-100  # of a variance whose square is still a number
BEST_KNOWN = 5e-4  # of |H|: no FRF is known better
PERFECT = 1e-7  # incoherence below which no hammer test lies: 0.03 % of noise
ANALYSER = 3e-3  # of |H|: what the channels of an analyser agree to, where a recording states no noise at all
RANGE = 3e-4  # of the RMS accelerance: 70 dB below it an analyser's lines leak into each other
USUAL = 0.01  # of |H|, where nothing tells how blows differ
SENSOR = 1e-4  # of the median RMS accelerance: what a sensor cannot resolve
ROUGH_ORDER, SMOOTH_ORDER = 3, 5  # order of differences over lines: noise and no more; noise even where it is smooth
QUIETEST = 0.1  # quantile of channels whose roughness is noise
TIED = 1.2  # lines that share noise, from where on coherence is smooth though it was estimated
LIGHT = 0.03  # σT of a window that ties no lines together


def pooled_variance(posture: PostureFRF, shared: float = 1.0) -> FloatArray:
    """Variance (nf, nr, ne) of real and imaginary part in the unit of ``frf`` squared; infinite on dead channels.

    Where the recording holds no coherence over two averages or more, from its own roughness. ``shared`` is how many
    lines carry the noise of one (:func:`shared_lines`): pooling needs as many times more.
    """
    if frf_variance(posture) is None or posture.coherence is None or posture.averages is None:
        return _roughness(posture)
    accelerance = as_quantity(posture, "accelerance").frf
    n = posture.averages
    power = np.abs(accelerance) ** 2
    if perfect(posture):
        return _accurate(posture)
    coherence = np.clip(posture.coherence, 1e-6, 1.0)
    noise = (1 - coherence) / (n * coherence)  # of the mean's power
    scattered = shared > TIED or _scattered(power * noise, power)
    # A variance about the mean of its own n hits; or a stated one, a share of |H|², which is signal and noise.
    single = 0.5 * power * noise * (n / (n - 1) if scattered else 1 / (1 + noise))
    # Where noise rules, |H|² is noise itself: a line that happens to come out small is not known better for it.
    share = noise**2 / (noise**2 + POOLED_FROM**2)
    width = min(len(power), NEAREST)
    power = (1 - share) * power + share * _smooth(power, width) / _smooth(np.ones_like(power), width)
    dead = dead_channels(posture)
    rms = np.sqrt(np.mean(power, axis=0))
    floor = (SENSOR * np.median(rms[~dead])) ** 2 if not dead.all() else 0.0
    b = _at_peaks(single, power)
    a = np.broadcast_to(np.median(single, axis=0), single.shape)
    a, b = np.where(a > 0, a, floor), np.where(b > 0, b, BEST_KNOWN**2)  # steps that multiply never leave zero
    lines = max(NEIGHBOURS, DEGREES / (n - 1)) if scattered else NEIGHBOURS
    kernel = min(round(lines * shared), len(single))
    # Likelihood of gamma-distributed variances, by multiplicative steps that keep both parts positive (Févotte and
    # Idier 2011, Itakura–Saito divergence): one part is not explained away by the other's error. a is a running mean.
    weight = a / kernel
    for _ in range(NOISE_STEPS):
        model = np.maximum(a + b * power, LEAST_VARIANCE)
        b = b * np.sqrt(_of_blow(power * single / model**2) / np.maximum(_of_blow(power / model), 1e-300))
        model = np.maximum(a + b * power, LEAST_VARIANCE)
        weight = weight * np.sqrt(_smooth(single / model**2, kernel) / np.maximum(_smooth(1 / model, kernel), 1e-300))
        a = _smooth(weight, kernel)
    variance = np.maximum(a + b * power, np.maximum(floor, BEST_KNOWN**2 * power))
    loud = np.median(variance, axis=0) > BROKEN_CHANNEL * np.median(a[:, ~dead]) if not dead.all() else dead
    if posture.quantity != "accelerance":
        variance *= np.abs(posture.frf) ** 2 / np.maximum(np.abs(accelerance) ** 2, 1e-300)
    variance[:, dead | (loud & _incoherent(posture.coherence, n))] = np.inf
    return variance


def perfect(posture: PostureFRF) -> bool:
    """Whether a recording states that it has no noise: nine lines of ten are coherent to ``PERFECT``."""
    return posture.coherence is not None and bool(np.quantile(1 - posture.coherence, 0.9) < PERFECT)


def _accurate(posture: PostureFRF) -> FloatArray:
    """Variance (nf, nr, ne) where none is stated: ``ANALYSER`` of a line's response and of its mean over channels, and
    ``RANGE`` of the whole record."""
    accelerance = as_quantity(posture, "accelerance").frf
    power = np.abs(accelerance) ** 2
    variance = 0.5 * (ANALYSER**2 * (power + power.mean(axis=(1, 2), keepdims=True)) + RANGE**2 * power.mean())
    if posture.quantity != "accelerance":
        variance *= np.abs(posture.frf) ** 2 / np.maximum(power, 1e-300)
    variance[:, dead_channels(posture)] = np.inf
    return np.asarray(variance)


def _incoherent(coherence: FloatArray, averages: int) -> NDArray[np.bool_]:
    """Channel pairs (nr, ne) with at most a tenth of their lines above what noise alone gives, 1 − 0.05^(1/(n−1)).

    Broken are those louder than the others' noise; else a blow is hardly answered there, and that tells, too.
    """
    return np.asarray(np.quantile(coherence, 0.9, axis=0) < 1 - 0.05 ** (1 / max(averages - 1, 1)))


def shared_lines(postures: Sequence[PostureFRF]) -> float:
    """Lines that carry the noise of one independent line, 1 or more.

    For a record of T = 1/spacing under a window e^{−σt} the number is Σ_k |ρ_k|² = σT coth σT. ρ_k = 1/(1 − ikπ/σT) is
    the correlation of noise k lines apart. The number is 1 where the noise is rougher than that: lines that were made
    one by one.
    """
    decay = float(np.mean([_decay(posture) for posture in postures]))
    if decay < LIGHT:
        return 1.0
    seen, expected = [], []
    for posture in postures:
        if posture.coherence is not None and len(posture.frequency) > SMOOTH_ORDER:
            variance = np.median(pooled_variance(posture), axis=0)
            live = np.isfinite(variance)
            seen.append(np.median(_rough(posture.frf, SMOOTH_ORDER), axis=0)[live] / np.log(2) / variance[live])
            expected.append(_kept(_decay(posture), SMOOTH_ORDER))
    # The quietest channels: in the others the roughness is the FRF's own.
    if seen and np.quantile(np.concatenate(seen), QUIETEST) > np.sqrt(np.mean(expected)):
        return 1.0
    return decay / float(np.tanh(decay))


def _decay(posture: PostureFRF) -> float:
    """σT of the exponential window in a posture's record."""
    return float(posture.exponential_window_rate / np.median(np.diff(posture.frequency)))


def _rough(frf: ComplexArray, order: int) -> FloatArray:
    """Squared differences (nf − order, nr, ne) over lines, as the variance of one part if lines were independent."""
    return np.abs(np.diff(frf, order, axis=0)) ** 2 / comb(2 * order, order) / 2


def _kept(decay: float, order: int) -> float:
    """Share of its variance that noise keeps in such differences where a window σT = ``decay`` ties lines together."""
    t = (np.arange(1000) + 0.5) / 1000
    share = (2 * np.sin(np.pi * t)) ** (2 * order) / comb(2 * order, order)
    return float(np.average(share, weights=np.exp(-2 * decay * t)))


def _roughness(posture: PostureFRF) -> FloatArray:
    """The additive part as what third differences from line to line leave, in the median over neighbours.

    Peaks are as rough as noise: what a blow adds in proportion cannot be told from them and is taken as usual.
    """
    power = np.abs(posture.frf) ** 2
    usual = (USUAL**2 / 2) * power + (SENSOR**2 * np.mean(power, axis=0))
    if len(power) < 8:
        variance = np.asarray(usual)
    else:
        rough = _rough(posture.frf, ROUGH_ORDER) / _kept(_decay(posture), ROUGH_ORDER)
        window = min(NEIGHBOURS, len(rough))
        median = np.median(np.lib.stride_tricks.sliding_window_view(rough, window, axis=0), axis=-1) / np.log(2)
        left = (len(power) - len(median)) // 2
        variance = usual + np.pad(median, ((left, len(power) - len(median) - left), (0, 0), (0, 0)), mode="edge")
    variance[:, dead_channels(posture)] = np.inf
    return variance


def _at_peaks(single: FloatArray, power: FloatArray) -> FloatArray:
    """Relative variance (ne,) where a blow is answered loudest: what begins above b takes long to come down."""
    loud = power >= np.quantile(power, LOUDEST_LINES, axis=(0, 1))
    relative = np.where(loud, single / np.maximum(power, 1e-300), np.nan)
    return np.asarray(np.nanmedian(relative, axis=(0, 1)))


def _of_blow(values: FloatArray) -> FloatArray:
    """Sum (ne,) over lines and responses, and as much again of an average blow: few lines at peaks tell of b."""
    total = np.sum(values, axis=(0, 1))
    return np.asarray(total + total.mean())


def _scattered(single: FloatArray, power: FloatArray) -> bool:
    """Whether coherence was estimated from the hits (it scatters from line to line) or states what is expected."""
    relative = single / np.maximum(power, 1e-300)
    middle = np.maximum(0.5 * (relative[2:] + relative[:-2]), 1e-300)
    return bool(np.median(np.abs(relative[1:-1] / middle - 1)) > 0.15)


def _smooth(values: FloatArray, kernel: int) -> FloatArray:
    """Running sum over lines (first axis)."""
    half = kernel // 2
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    index = np.arange(len(values))
    return np.asarray(total[np.minimum(index + half + 1, len(values))] - total[np.maximum(index - half, 0)])
