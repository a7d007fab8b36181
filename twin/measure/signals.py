"""Motion signals of a controller trace: tapered low-pass and differentiation in the frequency domain."""

import numpy as np

from twin.measure.campaign import FloatArray


def lowpass(
    signal: FloatArray, sample_rate_hz: float, pass_hz: float, stop_hz: float, derivative: int = 0
) -> FloatArray:
    """Low-pass with a cosine taper from ``pass_hz`` to ``stop_hz``, zero phase, and differentiate in the same step.

    The record is extended at both ends by its point reflection (removed again), so that neither its level nor its
    slope jumps where the transform closes the circle.

    Args:
        signal: (nt, …) evenly sampled.
        sample_rate_hz: samples per second.
        pass_hz, stop_hz: gain one below, zero above.
        derivative: 0, 1 or 2 times by time.

    Returns:
        (nt, …).
    """
    signal = np.asarray(signal, float)
    count = len(signal)
    extended = np.concatenate([2 * signal[:1] - signal[:0:-1], signal, 2 * signal[-1:] - signal[-2::-1]])
    # a straight line through the ends makes the extended record periodic
    ramp = np.linspace(0, 1, len(extended)).reshape(-1, *[1] * (signal.ndim - 1))
    line = extended[:1] + (extended[-1:] - extended[:1]) * ramp
    spectrum = np.fft.rfft((extended - line)[:-1], axis=0)
    frequency = np.fft.rfftfreq(len(extended) - 1, 1 / sample_rate_hz)
    phase = np.clip((frequency - pass_hz) / (stop_hz - pass_hz), 0, 1)
    gain = 0.5 * (1 + np.cos(np.pi * phase)) * (2j * np.pi * frequency) ** derivative
    filtered = np.fft.irfft(spectrum * gain.reshape(-1, *[1] * (signal.ndim - 1)), len(extended) - 1, axis=0)
    middle = filtered[count - 1 : 2 * count - 1]
    if derivative == 0:
        return middle + line[count - 1 : 2 * count - 1]
    if derivative == 1:
        return middle + (extended[-1] - extended[0]) / (len(extended) - 1) * sample_rate_hz
    return middle
