"""Records that end while the structure rings: what FRFs then lack, and how a diagnosis takes it into account."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from tools.trials.wrong import case
from tools.truth.recording import ANTI_ALIAS, HammerTest
from tools.truth.robots import machines, write_description
from tools.truth.wrong import record
from twin.diagnose import hammer
from twin.diagnose.frf_leak import _step, cut_off, leaking, refined, rewindowed
from twin.diagnose.patience import Patience
from twin.diagnose.refit import Fitted
from twin.diagnose.search import converge
from twin.diagnose.triage import triage
from twin.identify.objective import Sample
from twin.measure.campaign import Campaign, Channels, Hits, PostureFRF, read_campaign
from twin.measure.spectra import spectra
from twin.model.cut_off import Leak
from twin.model.leakage import leakage, leakage_later, leakage_slopes
from twin.model.linear import state_matrix
from twin.model.parameters import free_parameters
from twin.model.recorded import Recorded, without_limits
from twin.model.sensitivity import Observed, frf
from twin.robot.description import Robot, load_robot

RECORD_S, PULSE_S, RATE_HZ = 1.0, 0.008, 32768
SPREAD_S = PULSE_S * np.sqrt(0.25 - 2 / np.pi**2)  # of a half-sine
M = np.diag([2.0, 1.0, 0.5])
K = 3e3 * np.array([[3.0, -1, 0], [-1, 2, -1], [0, -1, 1.5]])
C = 2e-4 * K + 0.3 * M
NONE = np.zeros((3, 3))
LINES_HZ = np.arange(5, 40) / RECORD_S


def structure(rng: np.random.Generator, loss: np.ndarray = NONE, integral: np.ndarray = NONE) -> Observed:
    J_r, J_e = rng.normal(size=(2, 3)), rng.normal(size=(4, 3))
    return Observed(M, C, K, loss, integral, J_r, J_e, np.array([1.0, 1.1]), np.array([0.0, 1e-3]), np.zeros((2, 2)))


def struck(seen: Observed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (nt,), a half-sine (nt,) N at its start and accelerations (nt, nr, ne) after it on every point."""
    nv, ne = len(seen.M), len(seen.J_e)
    t = np.arange(int(RECORD_S * RATE_HZ)) / RATE_HZ
    force = np.where(t < PULSE_S, np.sin(np.pi * t / PULSE_S), 0.0)
    A = np.asarray(state_matrix(seen.M, seen.C, seen.K, seen.loss, seen.integral))
    B = np.zeros((len(A), ne))
    B[nv : 2 * nv] = np.linalg.solve(seen.M, seen.J_e.T)
    step = expm(A / RATE_HZ)
    held = np.linalg.solve(A, (step - np.eye(len(A))) @ B)  # constant over a step, so in its middle half a step late
    y, out = np.zeros((len(A), ne)), np.empty((len(t), len(seen.J_r), ne))
    for k, f in enumerate(force):
        out[k] = seen.J_r @ (A @ y + B * f)[nv : 2 * nv]
        y = step @ y + held * (f + (force[k + 1] if k + 1 < len(force) else 0.0)) / 2
    return t, force, out


@pytest.mark.parametrize("window", [0.0, 2.0])
def test_a_record_lacks_what_rings_after_it(window: float) -> None:
    """Stepped in time; of 30 % that a record of a second lacks (3 % under a window) the formula leaves 0.3 %."""
    seen = replace(structure(np.random.default_rng(0)), gain=np.ones(2), delay=np.zeros(2))
    t, force, x = struck(seen)
    s = window + 2j * np.pi * LINES_HZ
    kernel = np.exp(-s[:, None] * t)
    recorded = np.tensordot(kernel, x, 1) / (kernel @ force)[:, None, None]
    H = frf(seen, s, 2)
    lacks = np.linalg.norm(H - recorded)
    assert lacks > (0.25 if window == 0 else 0.03) * np.linalg.norm(H)
    predicted = H - leakage(seen, s, 2, RECORD_S - PULSE_S / 2, SPREAD_S)
    assert np.linalg.norm(predicted - recorded) < 3e-3 * np.linalg.norm(H)


def test_slopes_of_leakage_are_differences() -> None:
    """Of masses, dampers, springs, their losses, integral action, channels, gains and delays; and of the time."""
    rng = np.random.default_rng(1)
    seen = structure(rng, np.diag([5.0, 0, 3]), np.diag([500.0, 0, 0]))

    def symmetric(size: float) -> np.ndarray:
        part = size * rng.normal(size=(3, 3))
        return part + part.T

    moves = Observed(
        symmetric(0.1), symmetric(1), symmetric(100), symmetric(1), np.diag([30.0, 0, 0]), rng.normal(size=(2, 3)),
        rng.normal(size=(4, 3)), 0.1 * rng.normal(size=2), 1e-4 * rng.normal(size=2), np.zeros((2, 2)),
    )  # fmt: skip
    s, how = 1.0 + 2j * np.pi * LINES_HZ, (2, RECORD_S, SPREAD_S)
    rate = Observed.of(array[None] for array in moves.arrays())

    def at(h: float) -> np.ndarray:
        there = (a + h * b for a, b in zip(seen.arrays(), moves.arrays(), strict=True))
        return leakage(Observed.of(there), s, *how)

    (slope,) = leakage_slopes(seen, rate, s, *how)[1]
    np.testing.assert_allclose((at(1e-5) - at(-1e-5)) / 2e-5, slope, atol=1e-6 * np.abs(slope).max())
    later = [leakage(seen, s, 2, RECORD_S + h, SPREAD_S) for h in (1e-5, -1e-5)]
    np.testing.assert_allclose((later[0] - later[1]) / 2e-5, leakage_later(seen, s, *how), atol=1e-4 * abs(slope).max())


def test_nothing_leaks_where_no_mode_rings_any_more() -> None:
    rng = np.random.default_rng(2)
    seen = structure(rng, np.diag([5.0, 0, 3]), np.diag([500.0, 0, 0]))
    rate = Observed.of(rng.normal(size=(2, *array.shape)) for array in seen.arrays())
    s = 1.0 + 2j * np.pi * LINES_HZ
    L, slopes = leakage_slopes(seen, rate, s, 2, 1e6, SPREAD_S)
    assert not L.any()
    assert slopes.shape == (2, *L.shape)
    assert not slopes.any()


def test_a_coordinate_without_a_spring_leaks_nothing_more() -> None:
    """Its two poles have one vector: the formula is that of a neighbour."""
    seen = structure(np.random.default_rng(2))
    loose = replace(seen, C=np.zeros((3, 3)), K=K - K.sum(axis=1, keepdims=True) * np.eye(3))
    found = leakage(loose, 2j * np.pi * LINES_HZ, 2, RECORD_S, SPREAD_S)
    softly = leakage(replace(loose, K=loose.K + 1e-3 * np.eye(3)), 2j * np.pi * LINES_HZ, 2, RECORD_S, SPREAD_S)
    np.testing.assert_allclose(found, softly, atol=1e-4 * np.abs(softly).max())


def leaking_campaign(folder: Path, machine: str, seed: int) -> tuple[HammerTest, Campaign, Robot]:
    """Records of one or two seconds by the truth code, and the robot as described."""
    world, *_ = case("leakage", "hammer", machine, seed, False)
    record(world, folder, np.random.default_rng(seed))
    write_description(machines()[machine], folder / "robot.yaml")
    assert world.test is not None
    return world.test, read_campaign(folder / "frf.h5"), without_limits(load_robot(str(folder / "robot.yaml")))


def fitted(campaign: Campaign, robot: Robot) -> tuple[Fitted, Sample, list[Recorded]]:
    """The base model without leakage, the sample it was fitted to, and all recordings."""
    found = triage(campaign, robot, "frf.h5", None)
    free = free_parameters(robot, dict.fromkeys(r.setup.name for r in found.used), campaign.response.label)
    sample = Sample(tuple(found.used), 1 / found.shared)
    return converge(robot, free, sample, processes=2).base, sample, list(found.recordings.values())


def cut_off_s(test: HammerTest) -> float:
    """When a record ends after the middle of a blow: blows are a 64th of it late, and a filter holds them up."""
    record_s, poles = 1 / test.spacing_hz, np.arange(1, 9)
    late_s = np.sum(np.sin(np.pi * (2 * poles - 1) / 16)) / (2 * np.pi * ANTI_ALIAS * test.hit_rate_hz)
    return float(record_s * 63 / 64 - late_s - test.pulse_s / 2)


@pytest.mark.slow
def test_a_campaign_whose_records_leak_is_fitted_by_a_model_that_does(tmp_path: Path) -> None:
    test, campaign, robot = leaking_campaign(tmp_path, "arm", 11)
    base, sample, every = fitted(campaign, robot)
    found = cut_off(campaign, robot, base, sample, every)
    assert found is not None
    leak, _, (note,) = found
    assert note.kind == "leakage"
    assert leak.share / test.spacing_hz == pytest.approx(cut_off_s(test), abs=1e-3)
    assert max(np.abs(shift).max() for shift in leak.earlier.values()) < 1e-3
    leaky = leaking(sample, campaign, leak)
    again, _ = refined(leak, campaign, robot, base, leaky, every)
    assert not _step(lambda _: sample, leak, base, robot, np.ones(2)).any()  # of records that lack nothing
    for r in every:  # doubt of what leaks is added once
        doubt = [one.variance[r.group] - r.variance for one in (leak, again)]
        assert np.nanmedian(doubt[1] / doubt[0]) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_leakage_is_seen_where_it_is_larger_than_the_response(tmp_path: Path) -> None:
    """Between the peaks. The base model misses by more than is left of any mode, and takes the leak at a wrong time."""
    test, campaign, robot = leaking_campaign(tmp_path, "kr90", 2)
    base, sample, every = fitted(campaign, robot)
    found = cut_off(campaign, robot, base, sample, every)
    assert found is not None
    leak, near, _ = found
    assert base.misfit > 1e4
    assert near.misfit < 2
    assert leak.share / test.spacing_hz == pytest.approx(cut_off_s(test), abs=1e-3)


def test_raw_hits_that_leak_are_windowed() -> None:
    """As of H(σ + iω) of the structure itself; hits that do not leak are left alone."""
    seen = replace(structure(np.random.default_rng(3)), gain=np.ones(2), delay=np.zeros(2))
    _, force, x = struck(seen)
    every = RATE_HZ // 1024
    hits = Hits(
        np.tile(force[::every], (4, 2, 1)), np.tile(x[::every].transpose(2, 1, 0)[:, None], (1, 2, 1, 1)), 1024.0
    )
    made = spectra(hits, exponential_window_rate=0.0, fmax=40.0)
    posture = PostureFRF(
        "one", np.zeros(3), "on", made.frequency[5:], made.frf[5:], "accelerance", coherence=made.coherence[5:],
        averages=2, hits=hits,
    )  # fmt: skip
    channels = [
        Channels(tuple(f"{k}X+" for k in range(1, n + 1)), ("link1",) * n, *np.zeros((2, n, 3))) for n in (2, 4)
    ]
    campaign = Campaign(*channels, {"one": posture})
    whole, (note,) = rewindowed(campaign)
    again = whole.postures["one"]
    assert note.kind == "leakage"
    assert again.exponential_window_rate > 4
    s = again.exponential_window_rate + 2j * np.pi * again.frequency
    H = frf(seen, s, 2)
    assert again.frequency[0] == posture.frequency[0]
    assert np.linalg.norm(again.frf - H) < 0.01 * np.linalg.norm(H)
    assert rewindowed(whole) == (whole, [])
    clipped = replace(hits, force=np.minimum(hits.force, 0.5))  # the FRFs came from other hits than these
    given = replace(campaign, postures={"one": replace(posture, hits=clipped)})
    assert rewindowed(given) == (given, [])


@pytest.mark.parametrize(
    ("after", "word", "whole", "told"),
    [
        (1.0, "unexplained", "named", "whole"),  # the leak was a mistake of a model that was far off
        (1.0, "unexplained", "unexplained", "leaking"),
        (0.01, "unexplained", "named", "leaking"),  # near the noise it was none
        (1.0, "named", "named", "leaking"),
    ],
)
def test_a_leak_that_explains_nothing_is_taken_back(
    monkeypatch: pytest.MonkeyPatch, after: float, word: str, whole: str, told: str
) -> None:
    note, ask = object(), hammer._Ask(load_robot("kr90"), "", None, 0, None, None, 1, Patience())
    leak, fit = Leak(1.0, 1e-3), SimpleNamespace(z=np.zeros(1))

    def diagnosed(campaign: object, asked: hammer._Ask) -> SimpleNamespace:
        error = {"after": {"train": after}, "noise_floor": 0.003}
        return SimpleNamespace(word=whole if asked.whole else word, error=error, warnings=[], whole=asked.whole)

    monkeypatch.setattr(hammer, "cut_off", lambda *_: (leak, fit, [note]))
    monkeypatch.setattr(hammer, "_diagnosed", diagnosed)
    found: Any = hammer._leaking(None, None, fit, None, [], ask)  # type: ignore[arg-type]
    assert found.whole == (told == "whole")
    assert found.warnings == ([] if told == "whole" else [note])
    assert hammer._leaking(None, None, fit, None, [], replace(ask, whole=True)) is None  # type: ignore[arg-type]
