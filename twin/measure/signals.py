"""Motion signals of a controller trace: tapered low-pass, differentiation, resampling, alignment, noise and rests."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.special
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from twin.measure.campaign import FloatArray


def lowpass(
    signal: FloatArray, sample_rate_hz: float, pass_hz: float, stop_hz: float, derivative: int = 0, upsample: int = 1,
    delay_s: float = 0.0, lag_s: float = 0.0, every: int = 1,
) -> FloatArray:  # fmt: skip
    """Low-pass with a cosine taper from ``pass_hz`` to ``stop_hz``, zero phase, and differentiate in the same step.

    The record is extended at both ends by its point reflection (removed again), so that neither its level nor its
    slope jumps where the transform closes the circle.

    Args:
        signal: (nt, …) evenly sampled.
        sample_rate_hz: samples per second.
        pass_hz, stop_hz: gain one below, zero above.
        derivative: 0, 1 or 2 times by time.
        upsample: samples returned per sample given; every ``upsample``-th is at the time of one given.
        delay_s: by which what is returned is late.
        lag_s: time constant of a low-pass of first order that what is returned has passed.
        every: samples given per sample returned, which hold all of the band; nt − 1 is a multiple of it.

    Returns:
        (nt, …), or (``upsample`` (nt − 1) / ``every`` + 1, …).
    """
    signal = np.asarray(signal, float)
    last = len(signal) - 1
    circle = _circle(last, sample_rate_hz, pass_hz, stop_hz, every)
    extended = np.empty((circle.count, *signal.shape[1:]))
    ahead, behind = extended[: circle.before], extended[circle.before + last + 1 :]
    np.subtract(2 * signal[0], signal[circle.before : 0 : -1], out=ahead)
    extended[circle.before : circle.before + last + 1] = signal
    np.subtract(2 * signal[-1], signal[last - 1 : last - 1 - len(behind) : -1], out=behind)
    # without a straight line from its first sample to the one that would come next, the extended record is periodic
    start = extended[0].copy()
    rise = 2 * signal[-1] - signal[last - len(behind) - 1] - start
    spectrum = scipy.fft.rfft(extended, axis=0)[: len(circle.gain)]
    broad = (-1, *[1] * (signal.ndim - 1))
    spectrum[0] -= circle.count * start
    spectrum -= rise * circle.ramp.reshape(broad)
    gain = circle.gain
    if derivative or delay_s or lag_s:
        s = 2j * np.pi * circle.frequency
        gain = gain * s**derivative * np.exp(-s * delay_s) / (1 + s * lag_s)
    spectrum *= (upsample / every * gain).reshape(broad)
    filtered = scipy.fft.irfft(spectrum, circle.count * upsample // every, axis=0)
    middle = filtered[circle.before * upsample // every :][: last * upsample // every + 1]
    slope = rise / circle.count  # per sample
    if derivative == 1:
        middle += slope * sample_rate_hz
    elif derivative == 0:
        passed = circle.before + np.arange(len(middle)) * (every / upsample) - delay_s * sample_rate_hz
        middle += start + slope * passed.reshape(broad)
    return np.asarray(middle)


@dataclass(frozen=True)
class _Circle:
    """The period of ``count`` samples on which a signal is low-passed, ``before`` of them ahead of it.

    Of the lines that pass: ``frequency`` Hz, ``gain``, and the spectrum ``ramp`` of a line that rises by one.
    """

    count: int
    before: int
    frequency: FloatArray
    gain: FloatArray
    ramp: NDArray[np.complex128]


@lru_cache(maxsize=64)
def _circle(last: int, rate_hz: float, pass_hz: float, stop_hz: float, every: int) -> _Circle:
    """For a signal of ``last`` intervals; the filter's memory is a few 1/(stop − pass), the rest makes it fast."""
    memory = min(last, int(np.ceil(10 * rate_hz / (stop_hz - pass_hz) / every)) * every)
    length = every * scipy.fft.next_fast_len((last + 2 * memory) // every, real=True)
    count = last + memory + min(last, length - last - memory)
    lines = np.arange(min(count // 2, int(stop_hz * count / rate_hz)) + 1)
    frequency = lines * rate_hz / count
    gain = 0.5 * (1 + np.cos(np.pi * np.clip((frequency - pass_hz) / (stop_hz - pass_hz), 0, 1)))
    ramp = np.concatenate([[(count - 1) / 2], 1 / np.expm1(-2j * np.pi * lines[1:] / count)])
    return _Circle(count, memory, frequency, gain, ramp)


def resample(time: FloatArray, signal: FloatArray, instants: FloatArray) -> FloatArray:
    """A signal (nt, …) at other instants, by a cubic spline; the record must be smooth between its samples."""
    return CubicSpline(time, signal)(instants)


def advance(signal: FloatArray, sample_rate_hz: float, delay_s: float) -> FloatArray:
    """A channel (nt, …) that is late by ``delay_s``, put right: its value at t + delay, the ends held."""
    if delay_s == 0:
        return signal
    time = np.arange(len(signal)) / sample_rate_hz
    return CubicSpline(time, signal)(np.clip(time + delay_s, 0, time[-1]))


def differentiate(
    position: FloatArray, sample_rate_hz: float, pass_hz: float, stop_hz: float, upsample: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Low-passed position, velocity and acceleration of an encoder, also where a run starts or ends in motion.

    The extension by point reflection has a kink in the second and fourth derivative at either end, which would ring.
    A local function with these derivatives (from a polynomial fit) is taken off before :func:`lowpass` and put back.

    Args:
        position: (nt, …) evenly sampled.
        sample_rate_hz: samples per second.
        pass_hz, stop_hz: of the taper.
        upsample: as in :func:`lowpass`.

    Returns:
        Three arrays as :func:`lowpass` returns.
    """
    rest = np.array(position, float)
    count, shape = len(rest), rest.shape[1:]
    window = min(count, max(12, int(np.ceil(4 * sample_rate_hz / stop_hz))))
    width = 4 / stop_hz
    coarse, fine = (np.arange((count - 1) * m + 1) / (sample_rate_hz * m) for m in (1, upsample))
    put_back = [np.zeros((len(fine), *shape)) for _ in range(3)]
    for start in (True, False):
        end = slice(None, window) if start else slice(None, -window - 1, -1)
        x = np.arange(window) / window
        fit = np.polynomial.Polynomial.fit  # well conditioned on a scaled window
        columns = np.asarray(position, float)[end].reshape(window, -1)
        for m, column in enumerate(columns.T):
            series = fit(x, column, min(5, window - 1)).convert().coef
            A, B = (series[k] * (sample_rate_hz / window) ** k if k < len(series) else 0.0 for k in (2, 4))
            law = np.polynomial.Polynomial([0, 0, A, 0, B + A / width**2])
            at = np.unravel_index(m, shape) if shape else ()
            for k in range(3):
                for time, sums in ((coarse, rest), (fine, put_back[k])):
                    if sums is rest and k:
                        continue
                    t = time if start else time[-1] - time
                    near = t < 6 * width
                    value = law(t[near]) * np.exp(-((t[near] / width) ** 2)) * (1 if start or k != 1 else -1)
                    sums[(near, *at)] += -value if sums is rest else value
                law = law.deriv() - np.polynomial.Polynomial([0, 2 / width**2]) * law
    q, v, a = (lowpass(rest, sample_rate_hz, pass_hz, stop_hz, k, upsample) + put_back[k] for k in range(3))
    return q, v, a


def scatter(signal: FloatArray) -> FloatArray:
    """Standard deviation (n,) of the white noise of a signal (nt, n) that is smooth otherwise.

    By the median of its differences: of orders 3 to 8 the one that holds least of the signal.
    """
    found, difference = np.full(signal.shape[1], np.inf), signal
    for order in range(1, min(9, len(signal))):
        difference = np.diff(difference, axis=0)
        if order > 2:
            scale = 1.4826 / np.sqrt(scipy.special.comb(2 * order, order))
            found = np.minimum(found, scale * np.median(np.abs(difference), axis=0))
    return np.where(np.isfinite(found), found, 0.0)


def stillness(position: FloatArray, noise: FloatArray | None = None) -> FloatArray:
    """By how much (n,) recorded positions (nt, n) change in an axis that does not move, rad (m).

    That is four deviations of ``noise`` (n,), by default :func:`scatter`, either way, or a step of the encoder.
    """
    steps = np.abs(np.diff(position, axis=0))
    step = np.min(steps, axis=0, initial=1.0, where=steps > 1e-9)  # smaller ones are rounding
    noise = scatter(position) if noise is None else noise
    return np.asarray(np.maximum(8 * noise, np.where(step < 1.0, 1.01 * step, 0.0)))


def resting(position: FloatArray, rate_hz: float, about_s: float = 0.1, least: FloatArray | None = None) -> np.ndarray:
    """Samples (nt, n) of positions in which an axis does not move, for ``about_s`` and two samples at least.

    It moves by no more than ``least`` (n,) there, by default :func:`stillness`.
    """
    around = max(2 * round(0.5 * about_s * rate_hz) + 1, 3)
    high, low = (f(position, around, axis=0) for f in (maximum_filter1d, minimum_filter1d))
    least = stillness(position) if least is None else least
    return np.asarray(maximum_filter1d(high - low <= least, around, axis=0))


def first_motion(rest: np.ndarray) -> int:
    """The sample from which some axis moves; the last where none does. ``rest`` (nt, n) is where each does not.

    What dry friction holds before that is unknown: up to its size, in either direction.
    """
    moves = ~rest.all(axis=1)
    return int(np.argmax(moves)) if moves.any() else len(rest) - 1
