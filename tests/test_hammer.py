"""Time stepping against the linear model: hammer tests, static load."""

import mujoco
import numpy as np
import pytest
from conftest import POSTURES

from twin.errors import InputError
from twin.measure.spectra import posture_from_hits
from twin.model.frf import frf
from twin.model.hammer import USUAL_STEPS, HammerTest, simulate_hits, steps_per_sample, usual_duration, window_rate
from twin.model.linear import linearise, posture_state
from twin.model.modes import modes
from twin.robot.description import Robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import compile_model


@pytest.mark.parametrize("posture", POSTURES)
def test_hammer_frfs_in_time_equal_the_linear_ones(kr90: Robot, posture: str) -> None:
    """Within 1 % at every resonance below 30 Hz and 0.1 % of the matrix norm over 4–100 Hz, window accounted for."""
    mechanism = assemble(kr90, kr90.angles(POSTURES[posture]))
    linear = linearise(mechanism)
    labels = kr90.accelerometers
    test = HammerTest(hits=1)
    rate = window_rate(linear, test.duration_s)
    hits = simulate_hits(mechanism, test, 300.0, [*labels, "5Z-"], labels)
    measured, _ = posture_from_hits(
        posture, np.array(POSTURES[posture], float), "on", hits, exponential_window_rate=rate, fmax=100
    )
    band = measured.frequency >= 4
    frequency, found = measured.frequency[band], measured.frf[band]
    exact = frf(linear, frequency, labels, [*labels, "5Z-"], "accelerance", rate)
    assert np.linalg.norm(found - exact) < 0.001 * np.linalg.norm(exact)
    for peak in modes(linear).frequency_hz[:4]:
        near = np.abs(frequency - peak) < 0.2
        height = np.abs(exact[near]).max(axis=0)
        clear = height > 0.05 * height.max()  # a channel on a node of the mode has no peak there
        assert (np.abs(np.abs(found[near]).max(axis=0) / height - 1)[clear] < 0.01).all()


def test_records_of_a_robot_with_very_fast_modes_are_shorter_unless_asked_for(kr90: Robot) -> None:
    """A light arm's springs want steps of 10 µs: sixteen seconds of them, which nobody asked for, were refused."""
    light = kr90.model_copy(deep=True)
    for axis in light.axes:
        assert axis.stiffness is not None
        axis.stiffness *= 1e4
    test, duration = HammerTest(hits=1), []
    for robot in (kr90, light):
        linear = linearise(assemble(robot, robot.angles(POSTURES["milling"])))
        duration.append(usual_duration(linear, test))
        steps = duration[-1] * test.sample_rate_hz * steps_per_sample(linear, test.sample_rate_hz)
        assert steps <= USUAL_STEPS
    assert duration[0] == 16.0
    assert 0.5 <= duration[1] <= 8.0
    with pytest.raises(InputError, match=r"hammer.duration_s.* times shorter.*hammer: false"):
        simulate_hits(
            assemble(light, light.angles(POSTURES["milling"])), HammerTest(duration_s=600.0), 1.0, ["21X+"], ["21X+"]
        )


def test_static_load_in_time_gives_the_linear_flexibility(kr90: Robot, milling: np.ndarray) -> None:
    """A force put on the flange over 2 s, then held: the deflection is J K⁻¹ Jᵀ f within 0.1 %."""
    mechanism = assemble(kr90, milling)
    linear = linearise(mechanism)
    J = linear.jacobian(kr90.accelerometers)
    flexibility = J @ np.linalg.solve(linear.K, J.T)
    model = compile_model(mechanism, visual=False, instruments=False)
    site = [model.site(label).id for label in kr90.accelerometers]
    for column, label in enumerate(kr90.accelerometers):
        data = posture_state(model, mechanism)
        before = data.site_xpos[site].copy()
        body = model.site_bodyid[site[column]]
        axis = data.xmat[body].reshape(3, 3) @ linear.directions[label]
        force = 50.0 * axis
        for k in range(12000):
            ramp = 0.5 - 0.5 * np.cos(np.pi * min(1.0, k / 4000))
            data.qfrc_applied[:] = ramp * 50.0 * J[column]
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        moved = data.site_xpos[site] - before
        axes = np.array([data.xmat[body].reshape(3, 3) @ linear.directions[name] for name in kr90.accelerometers])
        found = np.einsum("ij,ij->i", moved, axes) / np.linalg.norm(force)
        np.testing.assert_allclose(found, flexibility[:, column], atol=1e-3 * np.abs(flexibility).max())


def test_noise_off_axis_blows_and_levels_are_reproducible(kr90: Robot, milling: np.ndarray) -> None:
    mechanism = assemble(kr90, milling)
    test = HammerTest(
        hits=2, duration_s=0.5, force_spread=0.1, force_noise_n=0.1, response_noise=0.01, off_axis_deg=2.0, seed=3
    )
    first, again = (simulate_hits(mechanism, test, 100.0, ["21Y+"], ["21Y+"]) for _ in range(2))
    np.testing.assert_array_equal(first.response, again.response)
    assert not np.array_equal(first.force[0, 0], first.force[0, 1])
    quiet = simulate_hits(mechanism, HammerTest(hits=1, duration_s=0.5), 100.0, ["21Y+"], ["21Y+"])
    loud = simulate_hits(mechanism, HammerTest(hits=1, duration_s=0.5), 200.0, ["21Y+"], ["21Y+"])
    np.testing.assert_allclose(loud.response, 2 * quiet.response, atol=2e-3 * np.abs(loud.response).max())


def test_recorded_blow_has_the_pulse_s_impulse(kr90: Robot, milling: np.ndarray) -> None:
    """The half sine carries 2/π of peak × length, filter or not."""
    hits = simulate_hits(assemble(kr90, milling), HammerTest(hits=1, duration_s=0.5), 300.0, ["21X+"], ["21X+"])
    assert hits.force.sum() / hits.sample_rate_hz == pytest.approx(2 / np.pi * 300 * 0.008, rel=2e-3)
