"""The truth code's robot against Pinocchio, the paper's printed modes, closed forms and time integration."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from tools.truth.blows import half_sine, strike, transform
from tools.truth.chain import (
    POSTURES_DEG,
    Chain,
    Tolerances,
    inverse_dynamics,
    kr90,
    mass_matrix,
    perturb,
    second_moments,
)
from tools.truth.effects import Effect, TruthError, draw, parse
from tools.truth.elastic import AXES, assemble, slabs

# Table 7 recomputed by two independent codes from Tables 5 and 6, rotors held.
TABLE_7 = {
    "milling": ([9.96, 11.07, 18.73, 23.82], [1.07, 1.00, 0.58, 0.70]),
    "upright": ([11.69, 11.83, 18.28, 24.35], [1.73, 1.12, 0.35, 0.83]),
    "rigid": ([13.03, 13.56, 18.97, 22.03], [2.20, 1.25, 0.16, 0.68]),
}
KR90 = kr90()
MILLING = np.deg2rad(POSTURES_DEG["milling"])
FREQUENCY = np.arange(5.0, 30.0, 0.25)
S = 2j * np.pi * FREQUENCY


def pinocchio_chain(chain: Chain, hinges: str = "z") -> pin.Model:
    """One joint per letter of `hinges` and axis, coincident; the link's mass on the last."""
    model = pin.Model()
    parent = 0
    for i, (a, alpha, d) in enumerate(chain.dh):
        placement = pin.SE3(pin.utils.rotate("x", alpha), np.zeros(3)) * pin.SE3(np.eye(3), np.array([a, 0, d]))
        for letter in hinges:
            joint = {"z": pin.JointModelRZ(), "x": pin.JointModelRX(), "y": pin.JointModelRY()}[letter]
            parent = model.addJoint(parent, joint, placement, f"{letter}{i}")
            placement = pin.SE3.Identity()
        link = chain.links[i]
        model.appendBodyToJoint(parent, pin.Inertia(link.mass, link.com, link.inertia), pin.SE3.Identity())
    return model


def response_rows(structure, chain=KR90):
    return np.array([structure.row("link3", chain.flange, AXES[a]) for a in "xyz"])


def frf(effects=(), chain=KR90, q=MILLING, **options):
    """Accelerance (nf, 3, 3) at the flange."""
    structure = assemble(chain, q, tuple(effects), **options)
    rows = response_rows(structure)
    return structure.receptance(S, rows, rows) * (S**2)[:, None, None]


def apart(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def only(joint: int, axis: str = "z") -> Chain:
    """The KR90 with a single soft hinge."""
    stiffness = np.full((3, 3), np.inf)
    stiffness[joint, "zxy".index(axis)] = KR90.stiffness[joint, "zxy".index(axis)]
    return replace(KR90, stiffness=stiffness)


@pytest.mark.parametrize("chain", [KR90, perturb(KR90, np.random.default_rng(0), Tolerances())])
def test_mass_matrix_and_inverse_dynamics_are_pinocchios(chain):
    rng = np.random.default_rng(1)
    model = pinocchio_chain(chain)
    data = model.createData()
    q, v, a = rng.uniform(-3, 3, (3, 50, 3))
    tau, m = inverse_dynamics(chain, q, v, a), mass_matrix(chain, q)
    for k in range(50):
        np.testing.assert_allclose(tau[k], pin.rnea(model, data, q[k], v[k], a[k]), rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(m[k], pin.crba(model, data, q[k]), rtol=1e-9, atol=1e-9)


def test_nine_hinge_mass_and_gravity_stiffness_are_pinocchios():
    """Screw Jacobians and the potential's Hessian agree with a nine-joint tree, differentiated by Pinocchio."""
    model = pinocchio_chain(KR90, "zxy")
    data = model.createData()
    structure = assemble(KR90, MILLING, sag=False)
    q = np.zeros(9)
    q[::3] = MILLING
    np.testing.assert_allclose(structure.mass, pin.crba(model, data, q), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(structure.preload, -pin.computeGeneralizedGravity(model, data, q), rtol=1e-9, atol=1e-8)
    gravity = pin.computeGeneralizedGravityDerivatives(model, data, q)
    np.testing.assert_allclose(structure.stiffness, np.diag(KR90.stiffness.ravel()) + gravity, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("posture", TABLE_7)
def test_table_7_frequencies_and_damping(posture):
    for sag in (False, True):
        f, zeta, _ = assemble(KR90, np.deg2rad(POSTURES_DEG[posture]), sag=sag).modes()
        np.testing.assert_allclose(f[:4], TABLE_7[posture][0], atol=0.02)
        np.testing.assert_allclose(100 * zeta[:4], TABLE_7[posture][1], atol=0.02)


def test_frf_is_that_of_the_full_nonlinear_robot_in_time():
    """A small blow on the nine-joint robot, integrated in time with weight and sag, has the predicted FRF."""
    model = pinocchio_chain(KR90, "zxy")
    data = model.createData()
    flange = model.addFrame(pin.Frame("flange", 9, pin.SE3(np.eye(3), KR90.flange), pin.FrameType.OP_FRAME))
    data = model.createData()
    k, c = KR90.stiffness.ravel(), KR90.damping.ravel()
    command = np.zeros(9)
    command[::3] = MILLING
    rest = command.copy()
    for _ in range(5):
        rest = command - pin.computeGeneralizedGravity(model, data, rest) / k
    structure = assemble(KR90, MILLING)
    rows = response_rows(structure)
    push, decay, rate, duration = np.array([0.0, 30.0, 0.0]), 2.0, 5000.0, 4.0
    pin.framesForwardKinematics(model, data, rest)
    # The structure's flange axes are those of link 3 at rest; the blow is along its y.
    axes = data.oMf[flange].rotation
    start = data.oMf[flange].translation.copy()

    def acceleration(u, v, force):
        joint = pin.StdVec_Force(10, pin.Force.Zero())
        joint[9] = pin.Force(force_link := data_rotation(u) @ force, np.cross(KR90.flange, force_link))
        return pin.aba(model, data, u, v, k * (command - u) - c * v, joint)

    def data_rotation(u):
        if not pushing:
            return np.eye(3)
        pin.forwardKinematics(model, data, u)
        return data.oMi[9].rotation.T @ axes

    u, v = rest.copy(), np.zeros(9)
    steps, h = int(duration * rate), 1 / rate
    wave = half_sine(np.array([1.0]), 0.008, 2 * rate)[:, 0]
    moved = np.empty((steps, 3))
    for i in range(steps):
        pin.framesForwardKinematics(model, data, u)
        moved[i] = axes.T @ (data.oMf[flange].translation - start)
        pushing = 2 * i + 2 < len(wave)
        f = [push * wave[2 * i + j] if pushing else 0 * push for j in (0, 1, 2)]
        a1 = acceleration(u, v, f[0])
        a2 = acceleration(u + h / 2 * v, v + h / 2 * a1, f[1])
        a3 = acceleration(u + h / 2 * v + h**2 / 4 * a1, v + h / 2 * a2, f[1])
        a4 = acceleration(u + h * v + h**2 / 2 * a2, v + h * a3, f[2])
        u = u + h * v + h**2 / 6 * (a1 + a2 + a3)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    s = decay + S
    force = transform(push[1] * half_sine(np.array([1.0]), 0.008, rate), rate, FREQUENCY, decay)
    measured = transform(moved, rate, FREQUENCY, decay) / force
    assert apart(structure.receptance(s, rows, rows)[:, :, 1], measured) < 1e-3


def test_stepped_blows_have_the_frf_of_the_linear_structure():
    structure = assemble(KR90, MILLING)
    rows = response_rows(structure)
    force = half_sine(np.full(3, 300.0), 0.008, 4096.0)
    signal = strike(structure, rows, rows, force, 4096.0, 4096 * 8)
    measured = transform(signal, 4096.0, FREQUENCY, 1.0) / transform(force, 4096.0, FREQUENCY, 1.0)[:, None]
    s = 1.0 + S
    assert apart(measured, structure.receptance(s, rows, rows) * (s**2)[:, None, None]) < 5e-4


NULLS = [
    "base_compliance@base.rx:stiffness=1e16,damping=0",
    "base_compliance@base.z:stiffness=1e16,damping=0",
    "link_flexibility@link2.y:stiffness=1e16,damping=0",
    "link_flexibility@link3.z:stiffness=1e16,damping=0",
    "servo_compliance@joint2:stiffness=1e16,damping=0",
    "payload@flange:mass=0,com=1.7|0|0",
    "attached_resonator@link2:mass=1e-9,frequency_hz=50,damping_ratio=0.01",
    "structural_damping@joint1.z:loss_factor=0",
    "posture_stiffness@joint3.z:amplitude=0,phase=1",
    "fractional_damper@joint2.z:coefficient=0,order=0.5",
    "transverse_compliance@joint1.x:stiffness=6.1e6,damping=40",
    "hardening_stiffness@joint2.z:cubic=0",
    "backlash@joint1.z:gap=0",
    "hysteresis@joint2.z:stiffness=0,yield_torque=1",
    "eddy_current_damper@joint1.z:coefficient=0",
]


@pytest.mark.parametrize("text", NULLS)
def test_an_effect_at_its_null_value_is_the_robot_without_it(text):
    effect = draw(parse(text), KR90, np.random.default_rng(0))
    structure = assemble(KR90, MILLING, (effect,)).tangent()
    rows = response_rows(structure)
    found = structure.receptance(S, rows, rows) * (S**2)[:, None, None]
    assert apart(found, frf()) < 2e-6


def test_base_yaw_and_joint_1_torsion_are_springs_in_series():
    soft = frf([parse("base_compliance@base.rz:stiffness=2e7,damping=0")], replace(KR90, damping=0 * KR90.damping))
    stiffness = KR90.stiffness.copy()
    stiffness[0, 0] = 1 / (1 / 2e7 + 1 / stiffness[0, 0])
    assert apart(soft, frf((), replace(KR90, stiffness=stiffness, damping=0 * KR90.damping))) < 1e-9


def test_a_massless_servo_is_a_spring_in_series_with_the_gear():
    undamped = replace(KR90, damping=0 * KR90.damping)
    soft = frf([parse("servo_compliance@joint2:stiffness=1e7,damping=0,inertia=0")], undamped, sag=False)
    stiffness = KR90.stiffness.copy()
    stiffness[1, 0] = 1 / (1 / 1e7 + 1 / stiffness[1, 0])
    assert apart(soft, frf((), replace(undamped, stiffness=stiffness), sag=False)) < 1e-9


def test_brakes_hold_the_rotor_whatever_the_servo():
    assert apart(frf([parse("servo_compliance@joint2:stiffness=1e6,damping=10")], brakes_on=True), frf()) == 0


def test_a_stiff_resonator_is_a_payload():
    place = "0.9|0.1|0.2"
    stiff = frf([parse(f"attached_resonator@link3:mass=20,frequency_hz=1e5,damping_ratio=0,axis=y,position={place}")])
    assert apart(stiff, frf([parse(f"payload@link3:mass=20,com={place}")])) < 1e-5


def test_loss_factor_of_a_single_hinge_halves_into_its_damping_ratio():
    """One hinge k(1 + iη): at resonance |receptance| = 1/(kη), as Den Hartog's."""
    chain = replace(only(0), damping=0 * KR90.damping)
    structure = assemble(chain, MILLING, (parse("structural_damping@joint1.z:loss_factor=0.03"),))
    row = np.eye(1)
    resonance = 1j * np.sqrt(structure.stiffness[0, 0] / structure.mass[0, 0])
    peak = structure.receptance(np.array([resonance]), row, row)
    assert abs(peak[0, 0, 0]) == pytest.approx(1 / (KR90.stiffness[0, 0] * 0.03), rel=1e-9)


def test_a_resonator_stills_its_own_place_at_its_frequency():
    """An undamped absorber is an antiresonance of the point that carries it, along its axis."""
    place, axis = np.array([0.9, 0.1, 0.2]), "y"
    text = "attached_resonator@link3:mass=20,frequency_hz=14,damping_ratio=0,position=0.9|0.1|0.2,axis=y"
    structure = assemble(KR90, MILLING, (parse(text),), sag=False)
    row = structure.row("link3", place, AXES[axis])[None]
    s = 2j * np.pi * np.array([13.0, 14.0])
    near, at = np.abs(structure.receptance(s, row, row)[:, 0, 0])
    assert at < 0.01 * near  # gravity stiffness of the moving mass leaves a little


def test_a_bending_link_swings_its_far_half_alone():
    """With every joint rigid, M and the points' levers are the far part's about the hinge."""
    rigid = replace(KR90, stiffness=np.full((3, 3), np.inf))
    structure = assemble(rigid, MILLING, (parse("link_flexibility@link3.z:stiffness=1e7,damping=0"),), sag=False)
    middle = KR90.flange / 2
    length = float(np.linalg.norm(KR90.flange))
    _, far = slabs(KR90.links[2], [length / 2], KR90.flange / length)
    lever = far.com - middle
    inertia = far.inertia[2, 2] + far.mass * (lever[0] ** 2 + lever[1] ** 2)
    assert structure.mass[0, 0] == pytest.approx(inertia, rel=1e-12)
    assert structure.row("link3", np.array([0.5, 0.1, 0.0]), AXES["y"])[0] == 0
    assert structure.row("link3", np.array([1.2, 0.1, 0.0]), AXES["y"])[0] == pytest.approx(1.2 - middle[0], rel=1e-12)


def test_a_link_is_cut_across_the_way_to_its_next_joint():
    """A forearm whose next joint lies along y: what is beyond half that way swings, whatever its x."""
    side = replace(KR90, stiffness=np.full((3, 3), np.inf), flange=np.array([0.15, 0.84, 0.0]))
    structure = assemble(side, MILLING, (parse("link_flexibility@link3.z:stiffness=1e7,damping=0"),), sag=False)
    near, beyond = np.array([0.2, 0.2, 0.0]), np.array([-0.1, 0.7, 0.0])
    assert structure.row("link3", near, AXES["x"])[0] == 0
    assert structure.row("link3", beyond, AXES["x"])[0] == pytest.approx(-(0.7 - 0.42), rel=1e-12)


def test_a_link_of_many_segments_is_a_cantilever():
    """Weightless tip force: δ = F L³ / 3EI with EI = kL; the parts' masses add up to the link's."""
    rigid = replace(KR90, stiffness=np.full((3, 3), np.inf))
    text = "link_flexibility@link3.z:stiffness=1e7,damping=0,segments=20"
    structure = assemble(rigid, MILLING, (parse(text),), sag=False)
    length = KR90.flange[0]
    row = structure.row("link3", np.array([length, 0.0, 0.0]), AXES["y"])
    deflection = row @ np.linalg.solve(np.diag(np.full(20, 20 * 1e7)), row)
    assert deflection == pytest.approx(length**3 / (3 * 1e7 * length), rel=1e-3)
    heights = [length * (i + 0.5) / 20 for i in range(20)]
    parts = slabs(KR90.links[2], heights, AXES["x"])
    assert sum(part.mass for part in parts) == pytest.approx(KR90.links[2].mass, rel=1e-12)
    assert np.linalg.eigvalsh(structure.mass)[0] > 0


def test_a_base_on_springs_carries_the_whole_robot():
    rigid = replace(KR90, stiffness=np.full((3, 3), np.inf))
    structure = assemble(rigid, MILLING, (parse("base_compliance@base.z:stiffness=1e7,damping=0"),), sag=False)
    assert structure.mass[0, 0] == pytest.approx(512 + 249 + 223)


@pytest.mark.parametrize(
    ("text", "stiffness"),
    [
        ("fractional_damper@joint1.z:coefficient=5e4,order=0.5", lambda s, k, c: k + c * s + 5e4 * s**0.5),
        (
            "posture_stiffness@joint1.z:amplitude=0.2,phase=0.3",
            lambda s, k, c: k * (1 + 0.2 * np.sin(MILLING[1] + 0.3)) + c * s,
        ),
        (  # cascade servo: proportional and integral, in series with the gear
            "servo_compliance@joint1:stiffness=1e7,damping=2e3,inertia=0,integral_time=0.05",
            lambda s, k, c: 1 / (1 / (k + c * s) + 1 / (1e7 * (1 + 1 / (0.05 * s)) + 2e3 * s)),
        ),
    ],
)  # fmt: skip
def test_a_single_hinge_has_the_closed_form_of_its_law(text, stiffness):
    structure = assemble(only(0), MILLING, (parse(text),))
    row = structure.row("link3", KR90.flange, AXES["z"])[None]
    inertia = structure.mass[-1, -1]
    found = structure.receptance(S, row, row)[:, 0, 0]
    expected = row[0, -1] ** 2 / (inertia * S**2 + stiffness(S, KR90.stiffness[0, 0], KR90.damping[0, 0]))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.0, -0.6, 0.8)])
def test_a_cut_link_is_the_link_and_both_parts_are_bodies(normal):
    link, normal = KR90.links[1], np.array(normal)
    height = float(normal @ link.com) + 0.1
    near, far = slabs(link, [height], normal)
    points = np.random.default_rng(0).multivariate_normal(link.com, second_moments(link.inertia) / link.mass, 400_000)
    beyond = points[points @ normal > height]
    assert far.mass / link.mass == pytest.approx(len(beyond) / len(points), rel=0.01)
    np.testing.assert_allclose(far.com, beyond.mean(0), atol=0.005)
    np.testing.assert_allclose(second_moments(far.inertia) / far.mass, np.cov(beyond.T), atol=0.005)
    mass = near.mass + far.mass
    com = (near.mass * near.com + far.mass * far.com) / mass
    moments = sum(second_moments(p.inertia) + p.mass * np.outer(p.com - com, p.com - com) for p in (near, far))
    assert mass == pytest.approx(link.mass, rel=1e-12)
    np.testing.assert_allclose(com, link.com, atol=1e-12)
    np.testing.assert_allclose(moments, second_moments(link.inertia), atol=1e-10)


# Nonlinear joints: vanishing amplitude, and an oscillator integrated by scipy.

NONLINEAR = [
    ("hardening_stiffness@joint2.z:cubic=1e13", 1e-3),
    ("backlash@joint2.z:gap=1e-4", 1e-3),
    ("hysteresis@joint3.z:stiffness=3e5|2e5,yield_torque=20|60", 1e-3),
    ("eddy_current_damper@joint1.z:coefficient=1e7", 1e-3),
]


@pytest.mark.parametrize(("text", "peak"), NONLINEAR)
def test_a_nonlinear_joint_struck_gently_is_its_tangent(text, peak):
    structure = assemble(KR90, MILLING, (parse(text),))
    rows = response_rows(structure)
    force = half_sine(np.full(3, peak), 0.008, 4096.0)
    signal = strike(structure, rows, rows, force, 4096.0, 4096 * 6)
    measured = transform(signal, 4096.0, FREQUENCY, 1.5) / transform(force, 4096.0, FREQUENCY, 1.5)[:, None]
    s = 1.5 + S
    tangent = structure.tangent().receptance(s, rows, rows) * (s**2)[:, None, None]
    assert apart(measured, tangent) < 5e-4


@pytest.mark.parametrize(
    ("text", "torque"),
    [
        ("hardening_stiffness@joint1.z:cubic=1e14", lambda k, x, v: k * x + 1e14 * x**3),
        ("backlash@joint1.z:gap=4e-5", lambda k, x, v: k * (x - np.clip(x, -2e-5, 2e-5))),
        ("eddy_current_damper@joint1.z:coefficient=1e7", lambda k, x, v: k * x + 1e7 * v * abs(v)),
    ],
)
def test_a_struck_joint_follows_its_law(text, torque):
    """Joint 1 alone is an oscillator: its blow agrees with a high-order integration of the same law."""
    structure = assemble(only(0), MILLING, (parse(text),))
    inertia, k, c = structure.mass[0, 0], KR90.stiffness[0, 0], KR90.damping[0, 0]
    arm, width = 2.0, 0.008
    signal = strike(structure, np.eye(1), np.array([[arm]]), half_sine(np.array([500.0]), width, 4096.0), 4096.0, 4096)

    def rate(t, y):
        force = 500.0 * arm * np.sin(np.pi * t / width) if t < width else 0.0
        return [y[1], (force - torque(k, *y) - c * y[1]) / inertia]

    t = np.arange(4096) / 4096.0
    first = solve_ivp(rate, (0, width), [0, 0], method="DOP853", rtol=1e-10, atol=1e-14)
    later = t[t > width]
    y = solve_ivp(
        rate, (width, 1), first.y[:, -1], method="DOP853", rtol=1e-10, atol=1e-14, t_eval=later, max_step=1e-4
    ).y
    expected = [rate(1.0, state)[1] for state in y.T]
    assert apart(signal[t > width, 0, 0], np.array(expected)) < 0.01


def test_slip_elements_dissipate_the_textbook_loop():
    """A cycle of amplitude A over an element (k, y) costs 4 y (A − y/k)."""
    structure = assemble(KR90, MILLING, (parse("hysteresis@joint1.z:stiffness=1e5|1e5,yield_torque=5|10"),))
    law = structure.laws[0]
    amplitude = 4e-4
    x = amplitude * np.sin(np.linspace(0, 4 * np.pi, 4001))
    state, torque = law.start((1,)), np.empty(4001)
    for i, value in enumerate(x):
        extra, state = law.extra(np.array([value]), np.zeros(1), state)
        torque[i] = extra[0]
    loop = np.trapezoid(torque[2000:], x[2000:])
    assert loop == pytest.approx(4 * 5 * (amplitude - 5e-5) + 4 * 10 * (amplitude - 1e-4), rel=1e-3)


@pytest.mark.parametrize(
    "text",
    ["spring@joint1", "payload@joint1", "backlash@joint1.x", "payload@flange:weight=3", "payload@flange:mass=x"],
)
def test_an_effect_that_does_not_exist_is_named(text):
    with pytest.raises(TruthError, match=r"expected|no parameter"):
        parse(text)


def test_a_site_beyond_the_chain_is_refused():
    with pytest.raises(TruthError, match="joints 1 to 3"):
        draw(Effect("coulomb_friction", "joint4"), KR90, np.random.default_rng(0))
