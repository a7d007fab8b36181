"""Residuals of FRFs: the robust one against its definition in complex logarithms, both against their own slopes."""

import numpy as np
import pytest

from twin.identify.residual import LOG_SPREAD, loss, pull, weights


def some() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    frf, H = (rng.normal(size=(20, 3, 4)) + 1j * rng.normal(size=(20, 3, 4)) for _ in range(2))
    variance = rng.uniform(0.01, 0.1, frf.shape)
    variance[:, 1, 2] = np.inf  # not used
    frf[3, 0, 0] = 0  # has no logarithm
    return frf, H, variance


def test_the_robust_sum_is_that_of_complex_logarithms() -> None:
    frf, H, variance = some()
    used = np.isfinite(variance) & (frf != 0)
    size = np.abs(np.log(frf[used] / H[used])) ** 2 / (LOG_SPREAD**2 + variance[used] / np.abs(frf[used]) ** 2)
    weight = weights(frf, variance, logarithmic=True)
    assert loss(frf, H, weight, True) == pytest.approx(0.5 * np.sum(np.log1p(size)), rel=1e-12)
    # a line that stands for four is as four lines are
    assert loss(frf, H, 2 * weight, True, repeat=4) == pytest.approx(4 * loss(frf, H, weight, True), rel=1e-12)


@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize("repeat", [1.0, 4.0])
def test_what_pulls_is_the_slope_of_the_sum(logarithmic: bool, repeat: float) -> None:
    frf, H, variance = some()
    weight = np.sqrt(repeat) * weights(frf, variance, 0.02, logarithmic)
    cost, e, factor = pull(frf, H, weight, logarithmic, repeat)
    assert cost == pytest.approx(loss(frf, H, weight, logarithmic, repeat), rel=1e-12)
    toward = np.random.default_rng(4).normal(size=H.shape) * np.exp(1j)
    h = 1e-6
    up, down = (loss(frf, H + side * toward, weight, logarithmic, repeat) for side in (h, -h))
    assert np.sum((e.conj() * factor * toward).real) == pytest.approx((up - down) / (2 * h), rel=1e-6)
