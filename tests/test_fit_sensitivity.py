"""The closed-form matrices and their derivatives against MuJoCo's linearisation and finite differences of it."""

from dataclasses import replace

import numpy as np
import pytest

from twin.measure.campaign import Channels
from twin.model.frf import frf as reference_frf
from twin.model.frf import measurement_chain
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.parameters import (
    Parameters,
    axis_parameters,
    entry_parameter,
    free_parameters,
    independent,
    join,
    link_parameters,
)
from twin.model.sensitivity import (
    Observed,
    Setup,
    contract,
    frf,
    frf_slopes,
    observe,
    pole_slopes,
    poles,
    sag_slopes,
    slopes,
    structure,
    structures,
)
from twin.robot.description import Robot, load_robot, parse_robot
from twin.robot.mechanism import assemble, assemble_all

Q_DEG = (20.0, 70.0, -100.0)
S = 2j * np.pi * np.linspace(5.0, 30.0, 60) + 0.3  # an exponential window of 0.3 1/s is still in the FRFs

EXTRA = (
    {"effect": "base_compliance", "site": "base.rx", "stiffness": 3e7, "damping": 2e3},
    {"effect": "base_compliance", "site": "base.z", "stiffness": 2e8, "damping": 2e3},
    {"effect": "floor_mode", "site": "base", "mass": 900, "inertia": [400, 500, 800], "x": 9e7, "damping_ratio": 0.02},
    {"effect": "link_flexibility", "site": "link2.y", "stiffness": 2e7, "damping": 300},
    {"effect": "servo_compliance", "site": "joint3", "stiffness": 2e7, "damping": 5e3, "integral_time": 0.3},
    {"effect": "payload", "site": "flange", "mass": 20, "com": [1.7, 0.0, 0.1]},
    {
        "effect": "attached_resonator", "site": "link3", "mass": 12, "frequency_hz": 17, "damping_ratio": 0.02,
        "axis": "y", "position": [0.9, 0.1, 0.1],
    },
    {"effect": "structural_damping", "site": "joint2.z", "loss_factor": 0.02},
    {"effect": "hardening_stiffness", "site": "joint2.z", "cubic": 3e12},
    {"effect": "hysteresis", "site": "joint1.z", "stiffness": [4e5, 3e5], "yield_torque": [20, 40]},
    {"effect": "sensor_misalignment", "site": "sensor:21", "angles": [0.02, -0.03, 0.01]},
    {"effect": "sensor_mass", "site": "sensor:*", "mass": 3.0},
    {"effect": "hammer_misalignment", "site": "hammer:9Y+", "angles": [0.05, 0.02]},
    {"effect": "time_delay", "site": "sensor:21Y+", "delay": 4e-4},
)  # fmt: skip


@pytest.fixture(scope="module")
def full(kr90: Robot) -> Robot:
    """kr90 with one of everything a hammer test can show; bearings stand off the origins of the links' frames."""
    data = kr90.model_dump(mode="json")
    for axis, height in zip(data["axes"], (-0.4, 0.12, 0.3), strict=True):
        axis["bearing"] = height
    data["physics"] += [dict(entry) for entry in EXTRA]
    return parse_robot(data)


def channels(robot: Robot, labels: tuple[str, ...]) -> Channels:
    points = {point.label: point for point in robot.test_points}
    return Channels(
        labels, tuple(points[x].body for x in labels), np.array([points[x].position for x in labels]),
        np.array([points[x].direction for x in labels]),
    )  # fmt: skip


def setup_of(robot: Robot) -> Setup:
    labels = tuple(point.label for point in robot.test_points)
    return Setup("milling", robot.angles(Q_DEG), "off", channels(robot, labels[-3:]), channels(robot, labels[3::4]))


@pytest.mark.parametrize("deflected", [False, True])
def test_matrices_are_those_of_mujoco(full: Robot, deflected: bool) -> None:
    q = full.angles(Q_DEG) + (0.01 if deflected else 0)
    mechanism = assemble(full, q, brakes="off")
    expected, found = linearise(mechanism), structure(mechanism)
    assert found.coordinates == expected.coordinates
    for name in ("M", "C", "K", "loss", "integral"):
        reference = getattr(expected, name)
        np.testing.assert_allclose(getattr(found, name), reference, atol=2e-7 * np.abs(reference).max())


@pytest.mark.parametrize("urdf", [None, "arm_linear.urdf"])
def test_postures_laid_out_together_are_those_of_mujoco(
    full: Robot, urdf: str | None, request: pytest.FixtureRequest
) -> None:
    """One assembled and the others turned: every posture is what MuJoCo makes of it alone, sagging springs included."""
    robot, postures = full, [full.angles(q) for q in (Q_DEG, [40.0, 70.0, -100.0], [-20.0, 20.0, -80.0])]
    if urdf:
        robot = load_robot(request.path.parent / "data" / urdf)
        axes = [axis.model_copy(update={"stiffness": 1e6, "damping": 1e3}) for axis in robot.axes]
        robot = robot.model_copy(update={"axes": axes})
        middle = [np.mean(axis.limits.position) if axis.limits and axis.limits.position else 0.3 for axis in axes]
        postures = [np.array(middle) + shift for shift in (0.0, 0.05)]
    together = structures(assemble_all(robot, postures, brakes="off"))
    sunk = structures([model.mechanism for model in together], [model.sag() for model in together])
    for q, plain, low in zip(postures, together, sunk, strict=True):
        mechanism = assemble(robot, q, brakes="off")
        for found, expected in ((plain, linearise(mechanism)), (low, structure(mechanism, plain.sag()))):
            for name in ("M", "C", "K"):
                reference = getattr(expected, name)
                np.testing.assert_allclose(getattr(found, name), reference, atol=2e-7 * np.abs(reference).max())


@pytest.mark.parametrize("urdf", ["arm6.urdf", "arm_linear.urdf"])
def test_matrices_of_other_robots_are_those_of_mujoco(urdf: str, request: pytest.FixtureRequest) -> None:
    """Six axes and a linear one: nothing is made for three revolute axes."""
    robot = load_robot(request.path.parent / "data" / urdf)
    axes = [axis.model_copy(update={"stiffness": 1e6, "damping": 1e3}) for axis in robot.axes]
    robot = robot.model_copy(update={"axes": axes})
    q = [np.mean(axis.limits.position) if axis.limits and axis.limits.position else 0.3 for axis in axes]
    mechanism = assemble(robot, np.array(q))
    expected, found = linearise(mechanism), structure(mechanism)
    for name in ("M", "C", "K"):
        reference = getattr(expected, name)
        np.testing.assert_allclose(getattr(found, name), reference, atol=1e-7 * np.abs(reference).max())
    placed = independent(replace(p, deviation=1e-3) for p in axis_parameters(robot))
    parameters = join(free_parameters(robot, ["p"]).only("spring", "link", "posture"), placed)
    setup = Setup("p", np.array(q), "on", *[channels(robot, (robot.test_points[0].label,))] * 2)
    values = parameters.values(np.zeros(len(parameters)))
    seen, model = observe(robot, setup, parameters, values)
    rate = slopes(robot, setup, parameters, values, seen, model)
    for k in [k for k, parameter in enumerate(parameters) if parameter.kind in ("posture", "axis")]:
        sides = []
        for step in (1e-5, -1e-5):
            moved = values.copy()
            moved[k] += step
            sides.append(observe(parameters.apply(robot, moved), setup, parameters, moved)[0])
        for name in ("M", "K", "J_r"):
            difference = (getattr(sides[0], name) - getattr(sides[1], name)) / 2e-5
            scale = max(np.abs(difference).max(), 1e-3 * np.abs(getattr(seen, name)).max())
            np.testing.assert_allclose(getattr(rate, name)[k], difference, atol=1e-5 * scale)


def test_frfs_are_those_of_the_model(full: Robot) -> None:
    """Chain entries, window and quantity included."""
    setup = setup_of(full)
    none = free_parameters(full).select([])
    seen, _ = observe(full, setup, none, np.zeros(0))
    linear = linearise(assemble(full, setup.q, brakes="off"))
    chain = measurement_chain(linear, full, setup.response.label, setup.excitation.label)
    for power, quantity in enumerate(("receptance", "mobility", "accelerance")):
        expected = reference_frf(linear, S.imag / 2 / np.pi, chain, quantity=quantity, exponential_window_rate=0.3)
        np.testing.assert_allclose(frf(seen, S, power), expected, atol=1e-6 * np.abs(expected).max())


def test_nothing_free_has_no_slopes(full: Robot) -> None:
    """Derivatives along no coordinates of no parameters keep their shapes."""
    none = free_parameters(full).select([])
    seen, _ = observe(full, setup_of(full), none, np.zeros(0))
    empty = Observed.of(np.zeros((0, *array.shape)) for array in seen.arrays())
    assert [array.shape for array in contract(empty, np.zeros((0, 0))).arrays()] == [
        (0, *a.shape) for a in seen.arrays()
    ]


def everything(robot: Robot) -> Parameters:
    entries = [
        "payload@flange.mass", "payload@flange.com[2]", "attached_resonator@link3.mass",
        "sensor_misalignment@sensor:21.angles[1]", "sensor_mass@sensor:*.mass",
        "hammer_misalignment@hammer:9Y+.angles[0]",
        "time_delay@sensor:21Y+.delay", "attached_resonator@link3.position[0]",
        "servo_compliance@joint3.integral_time",
    ]  # fmt: skip
    return join(
        free_parameters(robot, ["milling"], [p.label for p in robot.test_points[-3:]]).only(
            "spring", "entry", "link", "posture", "sag", "gain"
        ),
        independent(entry_parameter(robot, name) for name in entries),
        independent(axis_parameters(robot)),
    )


@pytest.mark.parametrize("left_out", [[], ["hardening_stiffness"], ["hardening_stiffness", "link_flexibility"]])
def test_derivatives_of_frfs_are_finite_differences_of_the_model(full: Robot, left_out: list[str]) -> None:
    """Every parameter: springs, dampers, links (one split), axes, postures, sag, gains, entries, measurement chain."""
    full = full.without(left_out)
    setup, parameters = setup_of(full), everything(full)
    z = 0.3 * np.random.default_rng(1).normal(size=len(parameters))

    def at(z: np.ndarray) -> np.ndarray:
        values = parameters.values(z)
        return frf(observe(parameters.apply(full, values), setup, parameters, values)[0], S, 2)

    values = parameters.values(z)
    robot = parameters.apply(full, values)
    seen, model = observe(robot, setup, parameters, values)
    closed = slopes(robot, setup, parameters, values, seen, model)
    (slow,) = sag_slopes(robot, [setup], parameters, values, [model])
    rate = Observed.of(a + b for a, b in zip(closed.arrays(), slow.arrays(), strict=True))
    rate = contract(rate, parameters.transform(values))
    H, slope = frf_slopes(seen, rate, S, 2)
    scale = np.abs(H).max()
    for k, name in enumerate(parameters.names):
        step = np.zeros(len(parameters))
        step[k] = 2e-4
        difference = (8 * (at(z + step) - at(z - step)) - (at(z + 2 * step) - at(z - 2 * step))) / (12 * 2e-4)
        np.testing.assert_allclose(
            slope[k], difference, atol=1e-5 * np.abs(difference).max() + 1e-7 * scale, err_msg=name
        )


@pytest.mark.parametrize("servo", [False, True])
def test_derivatives_of_poles_are_finite_differences(kr90: Robot, servo: bool) -> None:
    if servo:
        data = kr90.model_dump(mode="json")
        data["physics"] += [entry for entry in EXTRA if entry["effect"] == "servo_compliance"]
        kr90 = parse_robot(data)
    setup = setup_of(kr90)
    parameters = free_parameters(kr90, ["milling"]).only("spring", "entry", "link", "posture")
    values = parameters.values(np.zeros(len(parameters)))
    seen, model = observe(kr90, setup, parameters, values)
    pole, shape = poles(seen)
    np.testing.assert_allclose(pole, modes(linearise(assemble(kr90, setup.q, brakes="off"))).pole, rtol=1e-8)
    rate = contract(slopes(kr90, setup, parameters, values, seen, model), parameters.transform(values))
    found = pole_slopes(seen, rate, pole, shape)
    for k, name in enumerate(parameters.names):
        step = np.zeros(len(parameters))
        step[k] = 1e-4
        sides = []
        for z in (step, -step):
            moved = parameters.values(z)
            sides.append(poles(observe(parameters.apply(kr90, moved), setup, parameters, moved)[0])[0])
        difference = (sides[0] - sides[1]) / 2e-4
        np.testing.assert_allclose(found[k], difference, rtol=1e-4, atol=1e-4, err_msg=name)


def test_prior_on_inertia_has_no_preferred_frame_and_keeps_bodies_bodies(kr90: Robot) -> None:
    """Links drawn from the tolerances are physical, and their second moments spread as the tolerance says."""
    items, covariance = link_parameters(kr90)
    parameters = Parameters(tuple(items), covariance)
    rng = np.random.default_rng(0)
    spread = []
    for _ in range(300):
        robot = parameters.apply(kr90, parameters.values(rng.normal(size=len(parameters))))
        for link, nominal in zip(robot.links, kr90.links, strict=True):
            inertia, reference = link.inertial[2], nominal.inertial[2]
            moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
            before = 0.5 * np.trace(reference) * np.eye(3) - reference
            assert np.linalg.eigvalsh(moments)[0] > 0
            direction = rng.normal(size=3)
            spread.append(direction @ moments @ direction / (direction @ before @ direction) - 1)
    assert np.std(spread) == pytest.approx(kr90.tolerances.inertia, rel=0.1)


@pytest.mark.parametrize("sag", [0.0, 1.0])
def test_sag_is_that_of_the_independent_truth(kr90: Robot, sag: float) -> None:
    """Springs that carry the weight turn the parts by up to 1e-3 rad; the other code rests them there exactly."""
    from tools.truth.chain import kr90 as chain
    from tools.truth.elastic import assemble as true_structure

    labels = tuple(point.label for point in kr90.test_points)
    seen_at = channels(kr90, labels)
    setup = Setup("milling", kr90.angles(Q_DEG), "on", seen_at, seen_at)
    parameters = free_parameters(kr90, ["milling"]).only("sag")
    seen, _ = observe(kr90, setup, parameters, np.array([sag]))
    true = true_structure(chain(), setup.q, sag=sag > 0)
    rows = [true.row(*point) for point in zip(seen_at.body, seen_at.position, seen_at.direction, strict=True)]
    expected = true.receptance(S, np.array(rows), np.array(rows))
    found = frf(seen, S, 0)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    other, _ = observe(kr90, setup, parameters, np.array([1 - sag]))
    assert np.abs(frf(other, S, 0) - expected).max() > 1e-4 * np.abs(expected).max()
