"""What a log knows of masses, as the prior of a hammer test: normal in moments, wherever the fit ends."""

import numpy as np
import pytest

from twin.diagnose.joint import _moment_slopes, _moments, _numbers, about
from twin.model.parameters import SIX, Parameter, Parameters, independent

BODY = np.array([34.0, 0.01, 0.02, 0.21, 0.42, 0.39, 0.30, 0.01, -0.02, 0.005])


def known(numbers: np.ndarray, covariance: np.ndarray, log: bool) -> Parameters:
    """A link's ten numbers, or a payload's four, with a covariance of x."""
    names = ["link6.mass", *(f"link6.com.{k}" for k in "xyz"), *(f"link6.inertia.{pair}" for pair in SIX)]
    if len(numbers) == 4:
        names = ["payload@flange.mass", *(f"payload@flange.com[{k}]" for k in range(3))]
    items = [
        Parameter(name, "", "link", log and k == 0, float(value), float(np.sqrt(covariance[k, k])))
        for k, (name, value) in enumerate(zip(names, numbers, strict=True))
    ]
    return Parameters(tuple(items), covariance)


@pytest.mark.parametrize("count", [4, 7, 10])
def test_numbers_of_a_body_come_back_from_its_moments(count: int) -> None:
    np.testing.assert_allclose(_numbers(_moments(BODY[:count]))[:4], BODY[:4], rtol=1e-12)
    if count == 10:
        np.testing.assert_allclose(_numbers(_moments(BODY)), BODY, rtol=1e-12)


@pytest.mark.parametrize("log", [False, True])
def test_a_moment_that_is_known_stays_known_where_the_mass_is_another(log: bool) -> None:
    """13 ± 2 kg at 0.25 m, m c known to 1e-3 kg·m. At 15 kg and the same m c, c = 0.2167 m costs nothing."""
    payload = np.array([13.0, 0.03, 0.02, 0.25])
    slopes = _moment_slopes(payload) * np.where([log, False, False, False], payload, 1.0)
    covariance = np.linalg.inv(slopes) @ np.diag([4.0, 1e-6, 1e-6, 1e-6]) @ np.linalg.inv(slopes).T
    prior = known(payload, covariance, log)
    there = np.array([15.0, *(payload[1:] * 13 / 15)])
    again = about(prior, there)
    assert 0.5 * np.sum(prior.coordinates(there) ** 2) > 100  # linear in m and c the old one forbids it
    z = again.coordinates(there)
    assert 0.5 * z @ z == pytest.approx(0.5 * (2 / 2) ** 2, rel=0.2)  # two kilograms are one deviation
    np.testing.assert_allclose(about(prior, payload).covariance, covariance, rtol=1e-6)  # where it was, it is the same


def test_all_ten_numbers_of_a_link_keep_their_moments() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(10, 10)) * np.abs(BODY)[:, None] * 0.01
    prior = known(BODY, root @ root.T, False)
    there = BODY * (1 + 0.05 * rng.normal(size=10))
    again = about(prior, there)
    was, now = _moment_slopes(BODY), _moment_slopes(there)
    np.testing.assert_allclose(now @ again.covariance @ now.T, was @ prior.covariance @ was.T, rtol=1e-4, atol=1e-12)


def test_moments_that_a_line_would_put_elsewhere_keep_what_was_known_of_them() -> None:
    """At a mass that a hammer test has found elsewhere, the moment about the payload's centre came out infinite."""
    names = ["mass", *(f"com[{k}]" for k in range(3)), *(f"inertia[{k}]" for k in range(3))]
    numbers, deviation = (2.5, 0.02, 0.02, 0.05, *[3.6e-3] * 3), (0.5, *[0.02] * 3, *[0.4] * 3)
    items = [
        Parameter(f"payload@flange.{name}", "", "entry", "com" not in name, value, spread, "assumed")
        for name, value, spread in zip(names, numbers, deviation, strict=True)
    ]
    prior = independent(items)
    far = np.array([3.1, 0.20, 0.05, 0.11, 4e-6, 4e-6, 4e-6])
    again = about(prior, far)
    assert np.isfinite([(item.mean, item.deviation) for item in again]).all()
    assert np.isfinite(again.coordinates(far)).all()
    np.testing.assert_array_equal(again.covariance, prior.covariance)
