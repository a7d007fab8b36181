"""From hammer hits to FRFs: rejection, windows, estimators, checks."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from twin.errors import InputError
from twin.measure.campaign import Campaign, Channels, FloatArray, Hits, PostureFRF, read_campaign, write_campaign
from twin.measure.modal import identify_modes
from twin.measure.spectra import (
    driving_points,
    judge_hits,
    linearity,
    needed_window_rate,
    posture_from_hits,
    reciprocity,
    spectra,
    with_frfs,
)

F, ZETA = np.array([10.0, 11.69, 11.83, 19.2, 23.7]), np.array([1.4, 0.9, 0.8, 0.5, 0.8]) / 100
PHI = np.random.default_rng(7).normal(size=(3, F.size)) / 20
RATE_HZ, PRETRIGGER_S = 512.0, 0.05


def hits(duration: float = 16.0, nh: int = 3, noise: float = 1e-3, force_noise: float = 0.05, seed: int = 0) -> Hits:
    """Half-sine blows of 8 ms on three directions of a five-mode structure, exact for the sampled force."""
    rng = np.random.default_rng(seed)
    nt = int(duration * RATE_HZ)
    t = np.arange(nt) / RATE_HZ
    force, response = np.zeros((3, nh, nt)), np.zeros((3, nh, 3, nt))
    for e in range(3):
        for h in range(nh):
            length = 0.008 * rng.uniform(0.9, 1.1)
            inside = (t > PRETRIGGER_S) & (t < PRETRIGGER_S + length)
            blow = np.where(inside, 300 * rng.uniform(0.8, 1.2) * np.sin(np.pi * (t - PRETRIGGER_S) / length), 0)
            modal = []
            for w, z in zip(2 * np.pi * F, ZETA, strict=True):
                state = [[0, 1], [-(w**2), -2 * z * w]], [[0], [1]], [[-(w**2), -2 * z * w]], [[1]]
                a, b, c, d, _ = cont2discrete([np.array(m, dtype=float) for m in state], 1 / RATE_HZ, "foh")
                denominator = np.poly(a)
                numerator = np.poly(a - b @ c) + (d[0, 0] - 1) * denominator
                modal.append(lfilter(numerator, denominator, blow))
            force[e, h] = blow + force_noise * rng.normal(size=nt)
            response[e, h] = (PHI * PHI[e]) @ np.array(modal) + noise * rng.normal(size=(3, nt))
    return Hits(force, response, RATE_HZ, PRETRIGGER_S)


def channels(labels: tuple[str, ...] = ("21X+", "21Y+", "21Z+")) -> Channels:
    sign = np.array([1 if label[-1] == "+" else -1 for label in labels])
    return Channels(labels, ("link3",) * 3, np.zeros((3, 3)), np.diag(sign).astype(float))


def campaign(*postures: PostureFRF, blows: tuple[str, ...] = ("21X+", "21Y+", "21Z+")) -> Campaign:
    return Campaign(channels(), channels(blows), {p.name: p for p in postures})


def modes(posture: PostureFRF) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    found = identify_modes(posture, 5, 35).modes
    rows = [(m.frequency_hz, m.damping_percent / 100, m.frequency_std_hz, m.damping_std_percent / 100) for m in found]
    f, zeta, df, dz = np.array(rows).reshape(-1, 4).T
    return f, zeta, df, dz


def test_the_modes_of_the_structure_come_back_from_its_hits() -> None:
    """0.3 % in frequency, 5 % in damping, the 11.69/11.83 Hz pair included, from sixteen-second records."""
    posture, table = posture_from_hits("test", np.zeros(3), "on", hits())
    assert str(table) == "9 of 9 hits accepted"
    assert posture.averages == 3
    assert posture.exponential_window_rate < 0.2  # the records are nearly long enough
    f, zeta, *_ = modes(posture)
    np.testing.assert_allclose(f, F, rtol=0.003)
    np.testing.assert_allclose(zeta, ZETA, rtol=0.05)


def test_windowed_and_plain_records_give_the_same_damping() -> None:
    """The same hits with no window and with one of 1 1/s, whose added damping would double the first mode's."""
    records = hits()
    plain, _ = posture_from_hits("plain", np.zeros(3), "on", records, exponential_window_rate=0.0)
    windowed, _ = posture_from_hits("windowed", np.zeros(3), "on", records, exponential_window_rate=1.0)
    assert windowed.exponential_window_rate == 1.0
    a, b = modes(plain), modes(windowed)
    np.testing.assert_array_less(np.abs(a[0] - b[0]), 3 * np.hypot(a[2], b[2]))
    np.testing.assert_array_less(np.abs(a[1] - b[1]), 3 * np.hypot(a[3], b[3]))
    np.testing.assert_allclose(b[1], ZETA, rtol=0.02)


def test_short_records_get_the_window_they_need() -> None:
    """At 0.5 Hz resolution the response has not decayed: without a window it leaks, with the default none is lost."""
    records = hits(duration=2.0)
    assert needed_window_rate(hits()) < 0.2
    rate = needed_window_rate(records)
    assert 0.5 < rate < 4
    posture, _ = posture_from_hits("short", np.zeros(3), "on", records)
    assert posture.exponential_window_rate == pytest.approx(rate)
    f, zeta, *_ = modes(posture)
    np.testing.assert_allclose(f, F, rtol=0.003)
    np.testing.assert_allclose(zeta, ZETA, rtol=0.05)


def test_records_that_come_windowed_are_left_alone_and_corrected() -> None:
    records = hits()
    t = np.arange(records.force.shape[-1]) / RATE_HZ
    w = np.exp(-0.8 * t)
    done = Hits(records.force * w, records.response * w, RATE_HZ, PRETRIGGER_S, True, 0.8)
    posture, _ = posture_from_hits("done", np.zeros(3), "on", done, exponential_window_rate=5.0)
    assert posture.exponential_window_rate == 0.8
    np.testing.assert_allclose(modes(posture)[1], ZETA, rtol=0.02)


def test_double_overloaded_and_quiet_hits_are_rejected_with_their_reason() -> None:
    records = hits(duration=4.0, nh=6)
    force, response = records.force.copy(), records.response.copy()
    force[0, 1] += 0.4 * np.roll(force[0, 1], int(0.06 * RATE_HZ))
    top = 0.6 * force[1, 2].max()
    force[1, 2] = np.minimum(force[1, 2], top)
    force[1, 2, force[1, 2].argmax() : force[1, 2].argmax() + 4] = top
    limit = 0.5 * np.abs(response[2, 3, 1]).max()
    response[2, 3, 1] = np.clip(response[2, 3, 1], -limit, limit)
    response[2, 3, 1, 40:46] = limit
    force[2, 5] *= 0.1
    response[2, 5] *= 0.1
    table = judge_hits(replace(records, force=force, response=response))
    bad = {(row.excitation, row.hit): row.reason for row in table.rows if row.reason}
    assert set(bad) == {(0, 1), (1, 2), (2, 3), (2, 5)}
    assert bad[0, 1].startswith("double hit: the second has 4")
    assert bad[1, 2] == "overload of the force"
    assert bad[2, 3] == "overload of response 1"
    assert bad[2, 5].startswith("quiet")
    assert str(table).startswith("14 of 18 hits accepted")
    assert spectra(replace(records, force=force, response=response)).averages == 4


def test_no_hit_left_is_an_error() -> None:
    records = hits(duration=2.0, nh=1)
    spoilt = records.force + 0.5 * np.roll(records.force, 40, axis=-1)
    with pytest.raises(InputError, match="hits of excitation 0: expected at least one hit"):
        spectra(replace(records, force=spoilt))


def test_h1_h2_and_coherence_are_those_of_pyfrf() -> None:
    """An independent package on the same records, no windows; Hv is the geometric mean of its H1 and H2.

    Its own Hv is an eigenvector that changes with the units of force and acceleration.
    """
    pyfrf = pytest.importorskip("pyFRF")
    records = replace(hits(duration=2.0, nh=5, noise=0.05, force_noise=0.5), windowed=True)
    size = {}
    for name in ("H1", "H2"):
        ours = spectra(records, name)
        theirs = pyfrf.FRF(
            int(RATE_HZ),
            exc=records.force[0][:, None],
            resp=records.response[0],
            exc_type="f",
            resp_type="a",
            window="none",
            frf_estimator=name,
        )
        h = theirs.get_FRF(frf_form="accelerance")[:, 0]
        lines = (ours.frequency > 3) & (ours.frequency < 60)
        np.testing.assert_allclose(ours.frf[lines, :, 0], h.T[lines], rtol=1e-8)
        np.testing.assert_allclose(ours.coherence[lines, :, 0], np.squeeze(theirs.get_coherence()).T[lines], rtol=1e-6)
        size[name] = np.abs(h.T[lines])
    hv = np.abs(spectra(records, "Hv").frf[lines, :, 0])
    np.testing.assert_allclose(hv**2, size["H1"] * size["H2"], rtol=1e-8)


def test_h1_is_below_and_h2_above_the_truth_and_hv_between() -> None:
    records = hits(nh=8, noise=0.2, force_noise=3.0)
    size = {name: np.abs(spectra(records, name, force_window=False).frf) for name in ("H1", "H2", "Hv")}
    assert (size["H1"] <= size["Hv"] * (1 + 1e-12)).all()
    assert (size["Hv"] <= size["H2"] * (1 + 1e-12)).all()


def test_a_blow_from_the_wrong_side_fails_the_driving_point_check() -> None:
    posture, _ = posture_from_hits("p", np.zeros(3), "on", hits(duration=8.0), fmax=60)
    good = driving_points(campaign(posture), posture)
    assert [c.subject for c in good] == ["21X+/21X+", "21Y+/21Y+", "21Z+/21Z+"]
    assert all(c.passed for c in good)
    flipped = replace(posture, frf=posture.frf * np.array([1, -1, 1]))
    assert [c.passed for c in driving_points(campaign(posture), flipped)] == [True, False, True]
    told = campaign(flipped, blows=("21X+", "21Y-", "21Z+"))
    assert all(c.passed for c in driving_points(told, flipped))


def test_reciprocity_fails_for_a_turned_channel_and_holds_for_signed_blows() -> None:
    posture, _ = posture_from_hits("p", np.zeros(3), "on", hits(duration=8.0), fmax=60)
    assert all(c.passed for c in reciprocity(campaign(posture), posture))
    assert len(reciprocity(campaign(posture), posture)) == 3
    signed = replace(posture, frf=posture.frf * np.array([1, -1, 1]))
    assert all(c.passed for c in reciprocity(campaign(signed, blows=("21X+", "21Y-", "21Z+")), signed))
    turned = replace(posture, frf=posture.frf[:, [0, 2, 1]])
    assert not all(c.passed for c in reciprocity(campaign(turned), turned))
    dead = replace(posture, frf=0 * posture.frf, coherence=None)
    assert all(c.passed for c in reciprocity(campaign(dead), dead))


def test_reciprocity_forgives_a_quiet_pair_its_noise_and_a_little_of_the_loud_direction() -> None:
    """A plate that moves along z: the sensor X is turned by an angle, so x under z is all z."""
    lines = np.linspace(5.0, 35.0, 301)
    loud = 1 / (1 - (lines / 20) ** 2 + 0.02j * lines / 20)
    truth = np.zeros((301, 3, 3), complex)
    for a, b, size in ((0, 0, 1e-2), (1, 1, 1e-2), (2, 2, 1.0), (0, 2, 5e-3), (1, 2, 2e-2)):
        truth[:, a, b] = truth[:, b, a] = size * loud
    rng = np.random.default_rng(1)

    def failed(angle: float, noise: float) -> list[str]:
        frf = truth.copy()
        frf[:, 0] += np.sin(angle) * truth[:, 2]
        size = noise * np.abs(loud)[:, None, None] * np.ones((3, 3))
        frf = frf + size * (rng.normal(size=frf.shape) + 1j * rng.normal(size=frf.shape))
        power = 2 * 5 * size**2  # of the noise, five averages
        coherence = np.abs(frf) ** 2 / (np.abs(frf) ** 2 + power)
        posture = PostureFRF("p", np.zeros(3), "on", lines, frf, "accelerance", coherence=coherence, averages=5)
        return [c.subject for c in reciprocity(campaign(posture), posture) if not c.passed]

    assert failed(0.0, 1e-4) == []
    assert failed(np.deg2rad(1), 1e-4) == []
    assert failed(0.0, 2e-3) == []
    assert failed(np.deg2rad(5), 1e-4) == ["21X+/21Z+ and 21Z+/21X+"]


@pytest.mark.parametrize("count", [2, 3, 5])
def test_noise_of_a_few_hits_fails_no_check(count: int) -> None:
    """Channels that hear nothing: half of a driving point's energy has the wrong sign, no pair is reciprocal."""
    lines, rng = np.linspace(5.0, 35.0, 301), np.random.default_rng(count)
    each = rng.normal(size=(count, 301, 3, 3)) + 1j * rng.normal(size=(count, 301, 3, 3))
    frf = each.mean(axis=0)
    coherence = np.abs(frf) ** 2 / np.mean(np.abs(each) ** 2, axis=0)
    posture = PostureFRF("p", np.zeros(3), "on", lines, frf, "accelerance", coherence=coherence, averages=count)
    checks = [*driving_points(campaign(posture), posture), *reciprocity(campaign(posture), posture)]
    assert [c.subject for c in checks if not c.passed] == []
    known = replace(posture, coherence=np.full_like(coherence, 0.999))
    checks = [*driving_points(campaign(known), known), *reciprocity(campaign(known), known)]
    assert not any(c.passed for c in checks)


def test_linearity_over_force_levels_is_one_for_a_linear_structure() -> None:
    def level(name: str, seed: int, peak: float) -> PostureFRF:
        posture, _ = posture_from_hits(
            name, np.zeros(3), "on", hits(nh=5, seed=seed), fmax=40, exponential_window_rate=0.3
        )
        return replace(posture, peak_force_n=peak)

    low, high = level("p@100N", 1, 100.0), level("p@600N", 2, 600.0)
    (check,) = linearity(campaign(high, low), (5, 35))
    assert check.passed
    assert 0.3 < check.value < 2
    assert check.subject == "p@100N (100 N) and p@600N (600 N)"
    stiffer = replace(high, frf=np.roll(high.frf, 1, axis=0))
    (check,) = linearity(campaign(stiffer, low), (5, 35))
    assert not check.passed
    assert check.value > 20
    assert linearity(campaign(low)) == []


def test_a_posture_of_hits_alone_is_read_and_gets_its_frfs(tmp_path: Path) -> None:
    posture, _ = posture_from_hits("test", np.zeros(3), "on", hits(duration=4))
    write_campaign(tmp_path / "hits.h5", campaign(posture))
    with h5py.File(tmp_path / "hits.h5", "r+") as file:
        for name in ("frf", "frequency", "coherence"):
            del file[f"postures/test/{name}"]
    found, tables = with_frfs(read_campaign(tmp_path / "hits.h5"))
    kept = len(found.postures["test"].frequency)
    assert found.postures["test"].frequency[-1] <= hits(duration=4).sample_rate_hz / 2.56
    np.testing.assert_array_equal(found.postures["test"].frf, posture.frf[:kept])
    assert str(tables["test"]) == "9 of 9 hits accepted"
