"""From FRFs to modes, on a published milling robot and on what breaks other packages."""

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from twin.errors import InputError
from twin.measure.campaign import ComplexArray, FloatArray, PostureFRF, as_quantity
from twin.measure.modal import ModalResult, identify_modes, modal_report
from twin.measure.poles import lsce, plscf
from twin.measure.shapes import cmif, frac, mac, mode_indicator, mpc, summation
from twin.measure.stabilisation import chart, clusters

# Tool tip of a milling robot: published frequencies and dampings.
F = np.array([7.07, 10.29, 16.02, 18.49, 34.39, 37.81, 72.67, 107.81, 116.76, 121.93, 141.74, 193.88, 253.25])
ZETA = np.array([3.74, 2.21, 2.30, 3.32, 4.00, 3.84, 5.05, 4.84, 7.60, 3.44, 2.07, 3.67, 3.88]) / 100
LOW = F < 40


def accelerance(
    frequency: FloatArray, f: FloatArray, zeta: FloatArray, out: FloatArray, ref: FloatArray, rate: float = 0.0
) -> ComplexArray:
    """Closed form Σ φφᵀ s² / (s² + 2ζω s + ω²), out (no, nm) and ref (ni, nm) mass-normalised shapes."""
    s, w = (rate + 2j * np.pi * frequency)[:, None], 2 * np.pi * f
    return np.einsum("or,ir,fr->foi", out, ref, s**2 / (s**2 + 2 * zeta * w * s + w**2))


@cache
def milling_robot(nr: int, seed: int = 1) -> tuple[FloatArray, ComplexArray]:
    """nr × 3 FRFs at 0.25 Hz; modal masses fall from 200 kg at 7 Hz, where all of it moves, to 50 kg at 250 Hz."""
    frequency = np.arange(1, 1201) * 0.25
    mass = 200 * (F / F[0]) ** (np.log(0.25) / np.log(F[-1] / F[0]))
    phi = np.random.default_rng(seed).normal(size=(nr, F.size)) / np.sqrt(mass)
    return frequency, accelerance(frequency, F, ZETA, phi, phi[:3])


def noisy(frf: ComplexArray, seed: int, level: float = 0.01) -> ComplexArray:
    """With complex white noise of ``level`` times the RMS accelerance of each channel."""
    rng = np.random.default_rng(seed)
    size = level * np.sqrt(np.mean(np.abs(frf) ** 2, axis=0) / 2)
    return frf + size * (rng.normal(size=frf.shape) + 1j * rng.normal(size=frf.shape))


def posture(frequency: FloatArray, frf: ComplexArray, rate: float = 0.0) -> PostureFRF:
    return PostureFRF("test", np.zeros(3), None, frequency, frf, "accelerance", exponential_window_rate=rate)


def found(result: ModalResult) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Frequencies, dampings and their deviations."""
    rows = [
        (m.frequency_hz, m.damping_percent / 100, m.frequency_std_hz, m.damping_std_percent / 100)
        for m in result.modes
    ]
    f, zeta, df, dz = np.array(rows).reshape(-1, 4).T
    return f, zeta, df, dz


@pytest.mark.parametrize("nr", [3, 23])
def test_all_thirteen_modes_of_a_milling_robot_are_found_untold(nr: int) -> None:
    """Noise-free at 0.25 Hz: 1e-4 in frequency, 1e-2 in damping, nothing else."""
    f, zeta, *_ = found(identify_modes(posture(*milling_robot(nr))))
    assert f.size == F.size
    np.testing.assert_allclose(f, F, rtol=1e-4)
    np.testing.assert_allclose(zeta, ZETA, rtol=1e-2)


@pytest.mark.parametrize("nr", [3, 23])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_of_one_per_cent_rms_hides_no_mode_and_makes_none(nr: int, seed: int) -> None:
    frequency, frf = milling_robot(nr, seed)
    f, zeta, *_ = found(identify_modes(posture(frequency, noisy(frf, seed))))
    assert f.size == F.size
    np.testing.assert_allclose(f[LOW], F[LOW], rtol=0.005)
    np.testing.assert_allclose(zeta[LOW], ZETA[LOW], rtol=0.15)


def test_stated_deviations_cover_the_truth_as_often_as_they_say() -> None:
    """±1.645 deviations over 100 noise draws of 13 modes: between 85 and 95 in a hundred, f and ζ alike."""
    frequency, frf = milling_robot(3)
    inside = {"f": [], "zeta": []}
    for seed in range(100):
        f, zeta, df, dz = found(identify_modes(posture(frequency, noisy(frf, 1000 + seed)), 1, 60, max_order=24))
        near = np.argmin(np.abs(f[:, None] - F[LOW]), axis=0)
        inside["f"].append(np.abs(f[near] - F[LOW]) < 1.645 * df[near])
        inside["zeta"].append(np.abs(zeta[near] - ZETA[LOW]) < 1.645 * dz[near])
    for name, hits in inside.items():
        assert 0.85 <= np.mean(hits) <= 0.95, (name, np.mean(hits), np.mean(hits, axis=0))


def test_pure_noise_has_no_modes() -> None:
    for seed in range(5):
        noise = noisy(np.ones((300, 3, 3), dtype=complex), seed, 1.0) - 1
        assert identify_modes(posture(np.arange(1, 301) * 0.25, noise)).modes == ()
