"""The linear model against other routes through the mathematics."""

import mujoco
import numpy as np
import pytest
from conftest import POSTURES

from twin.model.frf import frf
from twin.model.linear import (
    FD_EPSILON,
    _stepped_differences,
    linearise,
    mass_matrix,
    posture_state,
    transition_matrices,
)
from twin.model.modes import modes, same_modes
from twin.robot.description import Entry, Robot, parse_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import compile_model


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("step", [1e-3, 2e-4])
def test_transition_matrix_holds_the_continuous_model_exactly(kr90: Robot, posture: str, step: float) -> None:
    """M⁻¹C and M⁻¹K from one discrete step equal those from the mass matrix and differences of forces."""
    mechanism = assemble(kr90, kr90.angles(POSTURES[posture]))
    model = compile_model(mechanism, visual=False)
    model.opt.timestep = step
    data = posture_state(model, mechanism)
    damping, stiffness = transition_matrices(model, data)
    M = mass_matrix(model, data)

    def resisting(qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_forward(model, data)
        return data.qfrc_bias - data.qfrc_passive

    small, rest = 1e-6 * np.eye(model.nv), np.zeros(model.nv)
    K = np.transpose([(resisting(e, rest) - resisting(-e, rest)) / 2e-6 for e in small])
    C = np.transpose([(resisting(rest, e) - resisting(rest, -e)) / 2e-6 for e in small])
    for found, expected in ((stiffness, np.linalg.solve(M, K)), (damping, np.linalg.solve(M, C))):
        assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)


def test_integrators_for_which_the_recovery_does_not_hold_are_refused(kr90: Robot, milling: np.ndarray) -> None:
    mechanism = assemble(kr90, milling)
    model = compile_model(mechanism, visual=False)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(ValueError, match="integrator"):
        transition_matrices(model, posture_state(model, mechanism))


def test_rotors_held_in_the_free_model_give_the_held_model(kr90: Robot, milling: np.ndarray) -> None:
    held = linearise(assemble(kr90, milling))
    free = linearise(assemble(kr90, milling, drives="free"))
    assert len(free.coordinates) == 12
    again = free.hold(["motor1", "motor2", "motor3"])
    np.testing.assert_allclose(modes(again).pole, modes(held).pole, rtol=1e-7)


def test_free_rotors_raise_the_gear_frequencies(kr90: Robot, milling: np.ndarray) -> None:
    """A free two-mass chain: three rotors at rest position become rigid-body motion, what is left swings faster."""
    robot = kr90.without(["transverse_compliance", "gravity_compensator"])
    held = modes(linearise(assemble(robot, milling)))
    free = modes(linearise(assemble(robot, milling, drives="free")))
    assert (free.frequency_hz[-3:] > held.frequency_hz).all()


def test_frf_equals_the_sum_over_modes(kr90: Robot, milling: np.ndarray) -> None:
    """Direct inversion of the dynamic stiffness against residues from the left and right state-space vectors."""
    linear = linearise(assemble(kr90, milling))
    labels = kr90.accelerometers
    frequency = np.linspace(5, 100, 200)
    nv = len(linear.coordinates)
    A = np.block([[np.zeros((nv, nv)), np.eye(nv)], [-np.linalg.solve(linear.M, np.hstack([linear.K, linear.C]))]])
    B = np.vstack([np.zeros((nv, len(labels))), np.linalg.solve(linear.M, linear.jacobian(labels).T)])
    pole, right = np.linalg.eig(A)
    gain = np.linalg.solve(right, B)
    s = 2j * np.pi * frequency
    output = linear.jacobian(labels) @ right[:nv]
    expected = np.einsum("rk,fk,ke->fre", output, 1 / (s[:, None] - pole), gain)
    np.testing.assert_allclose(frf(linear, frequency, labels, labels, "receptance"), expected, rtol=1e-8, atol=1e-16)
    mobility = frf(linear, frequency, labels, labels, "mobility")
    np.testing.assert_allclose(mobility, s[:, None, None] * expected, rtol=1e-8, atol=1e-14)


def test_exponential_window_shifts_the_line_of_evaluation(kr90: Robot, milling: np.ndarray) -> None:
    """e^{−at} on force and response adds a/ω to every damping ratio seen."""
    linear = linearise(assemble(kr90, milling))
    pole = modes(linear).pole[0]
    rate = 2.0
    window = frf(linear, np.array([abs(pole.imag) / (2 * np.pi)]), ["21Z+"], ["21Z+"], "receptance", rate)
    plain = frf(linear, np.array([abs(pole.imag) / (2 * np.pi)]), ["21Z+"], ["21Z+"], "receptance")
    assert abs(window / plain).item() == pytest.approx(-pole.real / (rate - pole.real), rel=0.05)


def test_structural_damping_halves_to_the_modal_ratio(with_entry, milling: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    """A loss factor η on the only spring of a one-axis model is a damping ratio of about η/2, at any frequency."""
    for site, scale in (("joint1.z", 1.0), ("joint1.z", 0.25)):
        robot = with_entry("structural_damping", site, keep=(), loss_factor=0.04)
        for axis in robot.axes:
            axis.__dict__.update(damping=0.0)
        robot.axes[0].__dict__.update(stiffness=robot.axes[0].stiffness * scale)
        for axis in robot.axes[1:]:
            axis.__dict__.update(stiffness=None)
        found = modes(linearise(assemble(robot, milling)))
        assert len(found) == 1
        assert found.damping_percent[0] == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize("elements", [1, 4, 5, 12])
@pytest.mark.parametrize("drives", ["held", "free"])
def test_slip_elements_that_stick_are_springs(kr90: Robot, elements: int, drives: str) -> None:
    """However many: for small motions they add their stiffness, and neither damping nor inertia."""
    data = kr90.model_dump(mode="json")
    plain = linearise(assemble(kr90, kr90.angles([0, 70, -100]), drives=drives))
    slip = {"effect": "hysteresis", "site": "joint1.z", "stiffness": [4e5] * elements, "yield_torque": [20] * elements}
    robot = parse_robot({**data, "physics": [*data["physics"], slip]})
    found = linearise(assemble(robot, robot.angles([0, 70, -100]), drives=drives))
    k = found.coordinates.index("joint1.z" if drives == "held" else "motor1")
    expected = plain.K.copy()
    expected[k, k] += 4e5 * elements
    np.testing.assert_allclose(found.K, expected, atol=2e-7 * np.abs(expected).max())
    np.testing.assert_allclose(found.C, plain.C, atol=1e-6 * np.abs(plain.C).max())


@pytest.mark.parametrize("drives", ["held", "free"])
def test_a_held_rotor_does_not_feel_how_its_friction_turns_round(kr90: Robot, drives: str) -> None:
    """Presliding is between rotor and housing: a hammer test winds up the gear behind a rotor that stands."""
    data = kr90.model_dump(mode="json")
    q = kr90.angles([0, 70, -100])
    plain = linearise(assemble(kr90, q, drives=drives))
    slip = {"effect": "presliding", "site": "joint1", "stiffness": [4e6, 2e6], "yield_torque": [20, 40]}
    found = linearise(assemble(parse_robot({**data, "physics": [*data["physics"], slip]}), q, drives=drives))
    expected = plain.K.copy()
    if drives == "free":
        k = found.coordinates.index("motor1")
        expected[k, k] += 6e6
    np.testing.assert_allclose(found.K, expected, atol=2e-7 * np.abs(expected).max())


def test_differences_of_steps_are_those_of_mujoco(kr90: Robot) -> None:
    mechanism = assemble(kr90, kr90.angles([0, 70, -100]))
    model = compile_model(mechanism, visual=False, instruments=False)
    data = posture_state(model, mechanism)
    found, expected = (np.zeros((2 * model.nv, 2 * model.nv)) for _ in range(2))
    _stepped_differences(model, data, found)
    mujoco.mjd_transitionFD(model, data, FD_EPSILON, 1, expected, None, None, None)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_modes_are_found_again_where_a_bearing_was_added(kr90: Robot, milling: np.ndarray) -> None:
    """The model without it has the same low modes, by other coordinates and up to a tenth away."""
    bearing = ("transverse_compliance", "joint1.x")
    rest = [entry for entry in kr90.physics if (entry.effect, entry.site) != bearing]
    assert len(rest) == len(kr90.physics) - 1
    stiff, soft = (modes(linearise(assemble(r, milling))) for r in (kr90.model_copy(update={"physics": rest}), kr90))
    own, alike = same_modes(stiff, np.arange(4), soft)
    np.testing.assert_array_equal(np.sort(own), np.arange(4))  # two pairs change places
    assert alike.min() > 0.5


def test_modes_are_found_again_among_those_of_a_body_that_was_added(kr90: Robot, milling: np.ndarray) -> None:
    """A resonator below the first mode puts a mode of its own first; the robot's are the ones after it."""
    lowest = modes(linearise(assemble(kr90, milling)))
    values = {"mass": 0.2, "frequency_hz": 0.7 * lowest.frequency_hz[0], "damping_ratio": 0.01, "axis": "x"}
    entry = Entry(effect="attached_resonator", site="link3", position=[0.3, 0.0, 0.1], **values)
    hung = kr90.model_copy(update={"physics": [*kr90.physics, entry]})
    more = modes(linearise(assemble(hung, milling)))
    assert more.frequency_hz[0] == pytest.approx(values["frequency_hz"], rel=0.02)
    np.testing.assert_array_equal(same_modes(lowest, np.arange(4), more)[0], np.arange(1, 5))
    own, alike = same_modes(lowest, np.array([2, 0]), lowest)
    np.testing.assert_array_equal(own, [2, 0])
    np.testing.assert_allclose(alike, 1)
