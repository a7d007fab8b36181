"""From FRFs to modes, on a published milling robot and on what breaks other packages."""

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
        (m.frequency_hz, m.damping_percent / 100, m.frequency_std_hz, m.damping_std_percent / 100) for m in result.modes
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


@pytest.mark.slow
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


# A robot in a milling posture: a pair 0.14 Hz apart, which one reference and 0.5 Hz resolution cannot part.
ROBOT_F = np.array([10.0, 11.69, 11.83, 19.2, 23.7, 38.0])
ROBOT_ZETA = np.array([1.4, 0.9, 0.8, 0.5, 0.8, 2.0]) / 100


def test_a_peak_that_no_mode_explains_is_said_to_be_none() -> None:
    """Lines about a resonance that scatter by all of it, as in a test with hardly any coherence."""
    frequency, rng = np.linspace(1.0, 200.0, 800), np.random.default_rng(0)
    s = 2j * np.pi * frequency
    peak = (s**2 / (s**2 + 0.004 * 2 * np.pi * 100 * s + (2 * np.pi * 100) ** 2))[:, None, None]
    result = identify_modes(posture(frequency, peak * (rng.normal(size=peak.shape) + 1j * rng.normal(size=peak.shape))))
    assert result.missed_hz == pytest.approx(100.0, abs=2.0)
    assert "no mode explains the largest response" in str(result)
    sound = identify_modes(posture(frequency, noisy(peak, 1)))
    assert (sound.missed_hz, sound.complaint) == (None, "")


def robot(frequency: FloatArray, no: int = 23, rate: float = 0.0) -> tuple[ComplexArray, FloatArray]:
    phi = np.random.default_rng(7).normal(size=(no, ROBOT_F.size)) / 20
    return accelerance(frequency, ROBOT_F, ROBOT_ZETA, phi, phi[:3], rate), phi


@pytest.mark.parametrize("turned", [False, True])
def test_a_pair_closer_than_a_line_is_parted_by_three_references(turned: bool) -> None:
    """11.69 and 11.83 Hz at 0.5 Hz resolution, 1 % noise: 0.3 % in f, 5 % in ζ, MAC 0.98; roving hammer or sensor."""
    frequency = np.arange(4, 121) * 0.5
    frf, phi = robot(frequency)
    frf = noisy(frf, 0)
    result = identify_modes(posture(frequency, frf.swapaxes(1, 2) if turned else frf), 5, 50)
    f, zeta, *_ = found(result)
    assert result.roving == ("excitation" if turned else "response")
    np.testing.assert_allclose(f, ROBOT_F, rtol=0.003)
    np.testing.assert_allclose(zeta, ROBOT_ZETA, rtol=0.05)
    assert np.diag(mac(result.shapes, phi.T.astype(complex))).min() > 0.98
    assert result.frac.min() > 0.98


def test_mobility_and_receptance_give_the_modes_of_the_same_accelerance() -> None:
    frequency = np.arange(4, 121) * 0.5
    frf, _ = robot(frequency)
    given = posture(frequency, noisy(frf, 0))
    expected = found(identify_modes(given, 5, 50))
    for quantity in ("mobility", "receptance"):
        np.testing.assert_allclose(found(identify_modes(as_quantity(given, quantity), 5, 50)), expected, rtol=1e-6)


def test_the_damping_of_an_exponential_window_is_removed() -> None:
    """The same structure with and without a window of 2 1/s, which adds 3.2 % of damping at 10 Hz."""
    frequency = np.arange(4, 121) * 0.5
    plain = found(identify_modes(posture(frequency, noisy(robot(frequency)[0], 0)), 5, 50))
    windowed = found(identify_modes(posture(frequency, noisy(robot(frequency, rate=2.0)[0], 1), rate=2.0), 5, 50))
    forgotten = found(identify_modes(posture(frequency, noisy(robot(frequency, rate=2.0)[0], 1)), 5, 50))
    for n in (0, 1):
        spread = np.hypot(plain[n + 2], windowed[n + 2])
        np.testing.assert_array_less(np.abs(plain[n] - windowed[n]), 3 * spread)
    np.testing.assert_allclose(windowed[1], ROBOT_ZETA, rtol=0.05)
    assert forgotten[1][0] > 3 * ROBOT_ZETA[0]


@pytest.mark.parametrize("limits", [(2.0, 60.0), (8.0, 30.0), (9.0, 26.0)])
def test_a_lower_limit_above_zero_biases_nothing(limits: tuple[float, float]) -> None:
    frequency = np.arange(1, 481) * 0.25
    frf, _ = robot(frequency)
    f, zeta, *_ = found(identify_modes(posture(frequency, frf), *limits))
    low, high = limits
    inside = (low < ROBOT_F) & (high > ROBOT_F)
    np.testing.assert_allclose(f, ROBOT_F[inside], rtol=1e-4)
    np.testing.assert_allclose(zeta, ROBOT_ZETA[inside], rtol=1e-2)


def test_coherence_weights_lines_and_bad_lines_do_no_harm() -> None:
    """Mains hum on a few lines with the low coherence that goes with it leaves the modes where they were."""
    frequency = np.arange(4, 241) * 0.25
    frf = noisy(robot(frequency)[0], 0, 0.002)
    coherence = np.full(frf.shape, 0.999)
    hum = np.abs(frequency - 16.67) < 0.3
    rng = np.random.default_rng(0)
    frf[hum] += 3 * np.abs(frf).max() * rng.normal(size=frf[hum].shape)
    coherence[hum] = 1e-4
    result = identify_modes(replace(posture(frequency, frf), coherence=coherence, averages=5), 5, 50)
    f, zeta, *_ = found(result)
    np.testing.assert_allclose(f, ROBOT_F, rtol=0.003)
    np.testing.assert_allclose(zeta, ROBOT_ZETA, rtol=0.05)


def test_a_damping_the_data_do_not_hold_is_said_to_be_so() -> None:
    """A weak mode of 0.05 % on 0.5 Hz lines: a frequency but no damping in noise, both with 50 times less noise."""
    frequency, f = np.arange(4, 121) * 0.5, np.array([15.24, 31.0])
    zeta = np.array([0.0005, 0.02])
    frf = accelerance(frequency, f, zeta, np.array([[0.3, 1.0], [0.2, -1]]), np.array([[1.0, 1.0]]))
    (first, second) = identify_modes(posture(frequency, noisy(frf, 1, 0.05)), 5, 55).modes
    assert abs(first.frequency_hz - f[0]) < 0.1
    assert not first.damping_held
    assert "do not hold this damping" in first.remark
    assert second.damping_held
    assert all(m.damping_held for m in identify_modes(posture(frequency, noisy(frf, 1, 0.001)), 5, 55).modes)


def test_the_report_and_the_printed_table_hold_every_mode() -> None:
    frequency = np.arange(4, 121) * 0.5
    result = identify_modes(posture(frequency, noisy(robot(frequency)[0], 0)), 5, 50)
    report = modal_report({"milling": result})["postures"]["milling"]["modes"]
    assert [m["frequency_hz"] for m in report] == [m.frequency_hz for m in result.modes]
    assert {"frequency_hz", "damping_percent", "frequency_std_hz", "damping_std_percent"} <= set(report[0])
    assert str(result).count("\n") == 1 + len(result.modes)


def test_a_silent_recording_and_an_empty_band_are_refused() -> None:
    frequency = np.arange(4, 121) * 0.5
    frf, _ = robot(frequency)
    with pytest.raises(InputError, match="every channel is zero"):
        identify_modes(posture(frequency, frf * 0))
    with pytest.raises(InputError, match="16 lines or more"):
        identify_modes(posture(frequency, frf), 30, 31)


def test_a_dead_sensor_changes_nothing() -> None:
    frequency = np.arange(4, 121) * 0.5
    frf = noisy(robot(frequency)[0], 0)
    frf[:, 5] = 0
    result = identify_modes(posture(frequency, frf), 5, 50)
    np.testing.assert_allclose(found(result)[0], ROBOT_F, rtol=0.003)
    assert np.abs(result.shapes[:, 5]).max() < 1e-9


def test_the_chart_of_a_large_test_is_read() -> None:
    """74 points × 3 references, 1600 lines, order 60; the benchmark says how long it takes."""
    frequency = np.arange(1, 1601) * 0.125
    rng = np.random.default_rng(0)
    f, zeta = np.sort(rng.uniform(6, 190, 20)), rng.uniform(0.005, 0.03, 20)
    phi = rng.normal(size=(74, 20))
    frf = noisy(accelerance(frequency, f, zeta, phi, phi[:3]), 0)
    physical = clusters(chart(plscf(frf, frequency, range(1, 61))))
    near = np.min(np.abs(np.array([abs(c.pole) for c in physical])[:, None] / (2 * np.pi) / f - 1), axis=0)
    assert np.count_nonzero(near < 0.01) >= 17


# --- beside other packages --------------------------------------------------------------------------------

SOUND_F, SOUND_ZETA = np.array([40.0, 62.0, 95.0, 140.0]), np.array([1.0, 1.5, 0.8, 1.2]) / 100


def sound() -> tuple[FloatArray, ComplexArray]:
    """One reference, well-parted modes: what other packages are made for."""
    frequency = np.arange(801) * 0.25
    phi = np.random.default_rng(0).normal(size=(6, 4))
    return frequency, accelerance(frequency, SOUND_F, SOUND_ZETA, phi, phi[:1])


def sdypy(
    frequency: FloatArray, frf: ComplexArray, lower: float, method: str, f: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Poles of sdypy-EMA at its highest order, nearest to ``f``."""
    ema = pytest.importorskip("sdypy.EMA")
    stacked = frf.reshape(frequency.size, -1).T
    upper = frequency[-1]
    model = ema.Model(stacked, frequency, lower=lower, upper=upper, pol_order_high=20, frf_form="accelerance")
    model.get_poles(method=method, show_progress=False)
    near = np.argmin(np.abs(np.array(model.pole_freq[-1])[:, None] - f), axis=0)
    return np.array(model.pole_freq[-1])[near], np.array(model.pole_xi[-1])[near]


def nearest(poles: list, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    near = np.argmin(np.abs(poles[-1].frequency[:, None] - f), axis=0)
    return poles[-1].frequency[near], poles[-1].damping[near]


def test_where_sdypy_ema_is_sound_we_agree_with_it() -> None:
    """Its LSCE from 0 Hz and its LSCF from 20 Hz."""
    frequency, frf = sound()
    above = frequency >= 20
    for theirs, ours in (
        (sdypy(frequency, frf, 0, "lsce", SOUND_F), nearest(lsce(frf, frequency, [20]), SOUND_F)),
        (sdypy(frequency, frf, 20, "lscf", SOUND_F), nearest(plscf(frf[above], frequency[above], [20]), SOUND_F)),
    ):
        np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-4)
        np.testing.assert_allclose(ours[1], theirs[1], rtol=1e-2)


def test_lsce_with_a_lower_limit_is_right_where_sdypy_ema_is_biased() -> None:
    """Theirs is lower + (f − lower) fmax/(fmax − lower), 1.8 Hz off at 40 Hz."""
    frequency, frf = sound()
    above = frequency >= 30
    theirs, _ = sdypy(frequency, frf, 30, "lsce", SOUND_F[:1])
    assert theirs[0] == pytest.approx(30 + 10 * 200 / 170, abs=0.1)
    for estimator in (lsce, plscf):
        f, zeta = nearest(estimator(frf[above], frequency[above], [20]), SOUND_F)
        np.testing.assert_allclose(f, SOUND_F, rtol=1e-4)
        np.testing.assert_allclose(zeta, SOUND_ZETA, rtol=1e-2)


def test_lscf_from_zero_is_right_where_sdypy_ema_has_negative_damping() -> None:
    frequency, frf = sound()
    _, theirs = sdypy(frequency, frf, 0, "lscf", SOUND_F)
    assert (theirs < 0).all()
    _, ours = nearest(plscf(frf, frequency, [20]), SOUND_F)
    np.testing.assert_allclose(ours, SOUND_ZETA, rtol=1e-2)


def test_the_close_pair_is_right_where_sdypy_ema_loses_it() -> None:
    frequency = np.arange(4, 121) * 0.5
    frf = noisy(robot(frequency, 3)[0], 0)
    pair, damping = ROBOT_F[1:3], ROBOT_ZETA[1:3]
    f, zeta = sdypy(frequency, frf, 5, "lscf", pair)
    theirs = np.abs(zeta / damping - 1)
    assert f[0] == f[1] or theirs.max() > 0.2
    result = identify_modes(posture(frequency, frf), 5, 50)
    f, zeta = nearest_modes(result, pair)
    np.testing.assert_allclose(f, pair, rtol=0.003)
    np.testing.assert_allclose(zeta, damping, rtol=0.1)


def nearest_modes(result: ModalResult, f: FloatArray) -> tuple[FloatArray, FloatArray]:
    have, zeta, *_ = found(result)
    near = np.argmin(np.abs(have[:, None] - f), axis=0)
    return have[near], zeta[near]


def test_lsce_as_in_the_source_paper_finds_the_robot_modes() -> None:
    """Single- and poly-reference LSCE charts, then the same automatic choice and refinement."""
    frequency = np.arange(1, 241) * 0.25
    frf, _ = robot(frequency)
    for references in (1, 3):
        result = identify_modes(posture(frequency, frf[:, :, :references]), 5, 50, method="lsce")
        np.testing.assert_allclose(found(result)[0], ROBOT_F, rtol=0.003)


# --- criteria and indicators ------------------------------------------------------------------------------


def test_mac_mpc_and_frac_know_what_they_do_not_depend_on() -> None:
    """Scale and phase of a shape or a function change none of them; a phase that differs from point to point does."""
    rng = np.random.default_rng(0)
    real = rng.normal(size=(2, 8)).astype(complex)
    turned = real * np.array([[2 * np.exp(1j)], [0.1j]])
    np.testing.assert_allclose(np.diag(mac(real, turned)), 1)
    np.testing.assert_allclose(mpc(turned), 1)
    circle = np.exp(2j * np.pi * np.arange(8) / 8)[None]
    np.testing.assert_allclose(mpc(circle), 0, atol=1e-12)
    np.testing.assert_allclose(mac(circle, circle.conj()), 0, atol=1e-12)
    h = rng.normal(size=(50, 2)) + 1j * rng.normal(size=(50, 2))
    np.testing.assert_allclose(frac(h, h * 3j), 1)


def test_indicators_point_at_the_modes() -> None:
    """Sums and CMIF peak at modes, the mode indicator dips there, and two CMIF peak at a double mode."""
    frequency = np.arange(1, 1601) * 0.02
    f, zeta = np.array([10.0, 20.0, 20.0]), np.array([0.005, 0.005, 0.005])
    phi = np.random.default_rng(0).normal(size=(5, 3))
    frf = accelerance(frequency, f, zeta, phi, phi[:3])
    single, double = np.argmin(np.abs(frequency - 10)), np.argmin(np.abs(frequency - 20))
    for curve in (summation(frf), cmif(frf)[:, 0]):
        assert abs(int(np.argmax(curve[single - 50 : single + 50])) - 50) <= 1
    assert mode_indicator(frf)[single] < 0.05
    assert mode_indicator(frf)[(single + double) // 2] > 0.9
    second = cmif(frf)[:, 1]
    assert second[double] > 20 * second[single]


def test_hits_that_disagree_make_no_false_modes() -> None:
    """69 blows, each with frequencies 0.1 % off the others', as on a robot that is re-servoed between hits."""
    frequency, rng = np.arange(1, 241) * 0.25, np.random.default_rng(1)
    phi = np.random.default_rng(3).normal(size=(69, ROBOT_F.size)) / 20
    columns = [
        accelerance(frequency, ROBOT_F * (1 + 1e-3 * rng.normal()), ROBOT_ZETA, phi[:3], phi[e : e + 1])
        for e in range(69)
    ]
    frf = np.concatenate(columns, axis=2)
    repeats = np.stack([noisy(frf, seed, 0.02) for seed in range(4)])
    mean = repeats.mean(axis=0)
    coherence = np.abs(mean) ** 2 / np.mean(np.abs(repeats) ** 2, axis=0)
    f, zeta, *_ = found(identify_modes(replace(posture(frequency, mean), coherence=coherence, averages=4), 5, 50))
    np.testing.assert_allclose(f, ROBOT_F, rtol=0.003)
    np.testing.assert_allclose(zeta, ROBOT_ZETA, rtol=0.05)
