"""A motion of axes and of the drives that a coupling turns: kinematics kept, torques as they are when asked for."""

from dataclasses import replace

import numpy as np
import pytest

from twin.physics.motion import Motion, sliding

C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.2, -1.0, 1.0]])


@pytest.fixture
def axes() -> Motion:
    position, velocity, acceleration, load, friction = np.random.default_rng(0).normal(size=(5, 7, 3))
    return Motion(np.arange(7.0), position, velocity, acceleration, load, friction, coupling=C)


def test_power_is_the_same_on_either_side(axes: Motion) -> None:
    """τ_θᵀ θ̇ = τ_qᵀ q̇, and there and back is the same motion."""
    drives = axes.of_drives
    np.testing.assert_allclose((drives.load * drives.velocity).sum(1), (axes.load * axes.velocity).sum(1))
    back = drives.of_axes
    for name in ("position", "velocity", "acceleration", "load", "friction"):
        np.testing.assert_allclose(getattr(back, name), getattr(axes, name), atol=1e-12)
    assert drives.drives
    assert not back.drives


def test_what_is_replaced_is_not_taken_from_what_was_kept(axes: Motion) -> None:
    before = axes.of_drives.position
    moved = replace(axes, position=axes.position + 1)
    np.testing.assert_allclose(moved.of_drives.position, (axes.position + 1) @ C.T)
    np.testing.assert_allclose(axes.of_drives.position, before)
    np.testing.assert_allclose(replace(axes, coupling=np.eye(3)).of_drives.position, axes.position)
    loaded = replace(axes.of_drives, load=axes.load)
    np.testing.assert_allclose(loaded.of_axes.load, axes.load @ C)
    axes.load[...] = 3.0
    np.testing.assert_allclose(axes.of_drives.load, 3.0 * np.ones((7, 3)) @ np.linalg.inv(C))


def test_the_same_instants_are_turned_once(axes: Motion) -> None:
    heavier = replace(axes, load=2 * axes.load)
    assert heavier.of_drives.velocity is axes.of_drives.velocity


def test_an_axis_that_turns_back_does_not_rest() -> None:
    time, sign = np.arange(200) * 0.004, np.ones(200)
    sign[40:] = -1
    sign[38:42] = 0.6, 0.0, 0.0, -0.6  # slower than its noise for 8 ms
    assert np.all(sliding(time, sign) == 1)
    sign[100:150] = 0
    expected = np.ones(200)
    expected[100:150] = 0
    assert np.array_equal(sliding(time, sign), expected)
    assert sliding(time[:1], np.array([0.3])) == pytest.approx(0.09)
