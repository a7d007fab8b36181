"""The truth code's files: what the contract asks, what the noise is, what each concealed effect does to a recording."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pinocchio as pin
import pytest

from tools.truth.__main__ import main
from tools.truth.blows import half_sine, nonlinear_frf, strike, transform
from tools.truth.chain import kr90
from tools.truth.effects import parse
from tools.truth.elastic import assemble
from tools.truth.motion import Fourier, Log, Run, compensator, draw_fourier, motor_torque, record, sampled, slip
from tools.truth.recording import (
    SENSORS,
    HammerTest,
    Posture,
    Truth,
    accelerance,
    average,
    draw_postures,
    draw_truth,
    rows,
    streams,
)

KR90 = kr90()
MILLING = Posture("milling", (0.0, 70.0, -100.0))


def apart(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


def campaign(path, *arguments):
    assert main(["campaign", "--out", str(path), *arguments]) == 0
    return h5py.File(path), json.loads(path.with_suffix(".truth.json").read_text())


def test_a_campaign_has_every_field_of_the_contract_and_keeps_its_truth_apart(tmp_path):
    file, answer = campaign(tmp_path / "c.h5", "--effect", "payload@flange:mass=25,com=1.7|0|0.1")
    assert file.attrs["format"] == "frf-campaign"
    assert file.attrs["version"] == 1
    for group, count in (("response", 3), ("excitation", 23)):
        assert file[group]["label"].shape == file[group]["body"].shape == (count,)
        np.testing.assert_allclose(np.linalg.norm(file[group]["direction"][:], axis=1), 1)
        for label, direction in zip(file[group]["label"].asstr()[:], file[group]["direction"][:], strict=True):
            sign = -1 if label.endswith("-") else 1
            assert direction["XYZ".index(label[-2])] == sign
    assert set(file["postures"]) == {"milling", "upright", "rigid"}
    for posture in file["postures"].values():
        assert posture["frf"].shape == posture["coherence"].shape == (200, 3, 23)
        assert posture["frf"].attrs["quantity"] == "accelerance"
        assert np.all((posture["coherence"][:] >= 0) & (posture["coherence"][:] <= 1))
        assert posture["coherence"].attrs["averages"] == 5
    assert "payload" not in str(list(file.attrs.items()))
    assert answer["truth"]["effects"][0]["parameters"]["mass"] == 25


def test_force_levels_are_groups_of_one_posture_with_their_level(tmp_path):
    file, _ = campaign(
        tmp_path / "c.h5", "--postures", "1", "--effect", "backlash@joint1.z:gap=3e-5", "--force-levels", "100", "600"
    )
    low, high = file["postures/milling@100N"], file["postures/milling@600N"]
    assert (low.attrs["peak_force_n"], high.attrs["peak_force_n"]) == (100, 600)
    np.testing.assert_array_equal(low.attrs["q_deg"], high.attrs["q_deg"])
    assert low.attrs["exponential_window_rate"] > 0
    assert apart(low["frf"][:], high["frf"][:]) > 0.1  # a gap does not scale


def test_levels_of_a_linear_robot_agree_with_the_simulation_in_time():
    """A gap too small to matter goes through time stepping and gives the FRF computed in frequency."""
    test = HammerTest(levels_n=(300.0,))
    stepped = accelerance(Truth(KR90, (parse("backlash@joint1.z:gap=1e-15"),)), (MILLING,), test)[0]
    assert apart(stepped, accelerance(Truth(KR90), (MILLING,), test)[0]) < 1e-6


@pytest.mark.parametrize("coherence", ["expected", "estimated"])
def test_coherence_tells_the_variance_of_the_frf(coherence):
    """|H|²(1−γ²)/(2nγ²) is the scatter of repeated campaigns; estimated coherence lacks the known (n−1)/n."""
    test = HammerTest(averages=8, coherence=coherence)
    exact = accelerance(Truth(KR90), (MILLING,), test)[0][0]
    rng = np.random.default_rng(0)
    repeats = [average(exact, test, 300.0, rng) for _ in range(40)]
    strong = np.mean([c for _, c in repeats], 0) > 0.9
    scatter = np.mean([np.abs(h - exact) ** 2 / 2 for h, _ in repeats], 0)[0][strong]
    told = np.mean([np.abs(h) ** 2 * (1 - c) / (2 * 8 * c) for h, c in repeats], 0)[strong]
    expected = 7 / 8 if coherence == "estimated" else 1.0
    assert np.median(told / scatter) == pytest.approx(expected, rel=0.03)


def test_blows_that_differ_scatter_on_a_gap_and_coherence_shows_it():
    truth = Truth(KR90, (parse("backlash@joint1.z:gap=5e-5"),))
    test = HammerTest(noise=0, scatter=0, levels_n=(300.0,), spread=0.15)
    rng = np.random.default_rng(0)
    frf = accelerance(truth, (MILLING,), test, rng)[0][0]
    assert frf.shape == (5, 200, 3, 23)
    _, coherence = average(frf, test, 300.0, rng)
    # A blow in the arm's plane (21X, 21Y) barely turns joint 1; one across it (21Z) throws it through its gap.
    assert np.median(coherence[:, 1, 21]) > 0.999
    assert np.median(coherence[:, 2, 22]) < 0.98
    linear = accelerance(Truth(KR90), (MILLING,), test, rng)[0][0]
    np.testing.assert_allclose(average(linear, test, 300.0, rng)[1], 1)


def test_two_ways_through_time_agree():
    """Stepping only the joint's torque, in modes, gives what stepping the whole robot by matrix exponential gives."""
    texts = ("hysteresis@joint1.z:stiffness=3e5|3e5,yield_torque=5|15", "hardening_stiffness@joint3.z:cubic=1e14")
    structure = assemble(KR90, np.deg2rad(MILLING.q_deg), tuple(parse(t) for t in texts))
    response, excitation = rows(Truth(KR90), structure)
    force, frequency = half_sine(np.full(23, 500.0), 0.008, 4096.0), HammerTest().frequency
    frf = nonlinear_frf([structure], [response], [excitation], force, 4096.0, 16384, frequency, 1.5)[0]
    signal = strike(structure, response, excitation, force, 4096.0, 16384)
    whole = transform(signal, 4096.0, frequency, 1.5) / transform(force, 4096.0, frequency, 1.5)[:, None]
    s = 1.5 + 2j * np.pi * frequency
    assert apart(frf * (s**2)[:, None, None], whole) < 1e-3
    plain = structure.receptance(s, response, excitation)
    assert apart(plain, frf) > 0.02  # the laws do act


@pytest.mark.slow
def test_what_a_law_does_after_the_record_is_not_cut_off():
    """The torque of a stiffer or shifted joint goes on; where its record ends is nothing that an FRF knows of."""
    texts = ("hysteresis@joint1.z:stiffness=3e5|3e5,yield_torque=5|15", "hardening_stiffness@joint3.z:cubic=1e14")
    structure = assemble(KR90, np.deg2rad(MILLING.q_deg), tuple(parse(t) for t in texts))
    response, excitation = rows(Truth(KR90), structure)
    force, frequency = half_sine(np.full(23, 500.0), 0.008, 4096.0), HammerTest().frequency
    longer, shorter = (
        nonlinear_frf([structure], [response], [excitation], force, 4096.0, samples, frequency, 0.0)[0]
        for samples in (4 * 4096 * 8, 4096 * 8)
    )
    assert apart(longer, shorter) < 1e-6  # without the law's tangent in the linear part 4e-3


def test_raw_hits_hold_the_frf_they_came_from(tmp_path):
    file, _ = campaign(tmp_path / "c.h5", "--nominal", "--posture", "milling=0,70,-100", "--hits", "2")
    group = file["postures/milling"]
    raw = group["hits"]
    assert raw["force"].shape == (23, 2, 8192)
    assert raw["response"].shape == (23, 2, 3, 8192)
    test = HammerTest(hits=2)
    assert group.attrs["exponential_window_rate"] == test.decay
    rate, before = raw.attrs["sample_rate_hz"], round(raw.attrs["pretrigger_s"] * raw.attrs["sample_rate_hz"])
    window = np.exp(-test.decay * np.arange(8192 - before) / rate)
    force = np.fft.rfft(raw["force"][:, 0, before:] * window, 8192)
    response = np.fft.rfft(raw["response"][:, 0, :, before:] * window, 8192)
    frequency = np.fft.rfftfreq(8192, 1 / rate)
    band = (frequency >= 5) & (frequency < 30)
    exact = accelerance(Truth(KR90), (MILLING,), replace(test, start_hz=frequency[band][0], lines=band.sum()))[0][0, 0]
    assert apart((response / force[:, None])[:, :, band].transpose(2, 1, 0), exact) < 0.01
    assert apart(group["frf"][:], accelerance(Truth(KR90), (MILLING,), test)[0][0, 0]) < 0.01


def test_the_measurement_chain_turns_scales_and_delays():
    clean = accelerance(Truth(KR90), (MILLING,), HammerTest())[0][0, 0]

    def measured(text):
        return accelerance(Truth(KR90, (parse(text),)), (MILLING,), HammerTest())[0][0, 0]

    np.testing.assert_allclose(measured("sensor_gain@sensor:21Y+:gain=1.1")[:, 1], 1.1 * clean[:, 1])
    turned = measured(f"sensor_misalignment@sensor:21:angles=0|0|{np.pi / 2}")
    np.testing.assert_allclose(turned[:, 0], -clean[:, 1], atol=1e-9)  # Rz(90°): recorded x is −y, recorded y is x
    np.testing.assert_allclose(turned[:, 1], clean[:, 0], atol=1e-9)
    off = measured(f"hammer_misalignment@hammer:21X-:angles=0|{np.pi / 2}")  # the blow turns about z: −x to −y
    np.testing.assert_allclose(off[:, :, 20], -clean[:, :, 21], atol=1e-9)
    late = measured("time_delay@sensor:21Z+:delay=1e-3")
    phase = np.exp(-2j * np.pi * HammerTest().frequency * 1e-3)[:, None]
    np.testing.assert_allclose(late[:, 2], clean[:, 2] * phase)


def test_the_flange_frfs_are_reciprocal():
    clean = accelerance(Truth(KR90), (MILLING,), HammerTest())[0][0, 0][:, :, 20:]
    clean = clean * [-1, 1, 1]  # the blow at 21X is along −x
    np.testing.assert_allclose(clean, clean.swapaxes(1, 2), rtol=1e-9, atol=1e-12)


def test_truths_stay_within_the_stated_tolerances_and_repeat():
    postures = draw_postures(8, streams(0)[1])
    truths = [draw_truth(seed, (), postures) for seed in range(30)]
    assert len({p.q_deg[0] for p in postures}) >= 5  # q₁ differs, which is what tells base from joint 1
    stiffness = np.array([t.chain.stiffness for t in truths]) / KR90.stiffness
    assert 1 / 1.3 <= stiffness.min() < 0.8
    assert 1.25 < stiffness.max() <= 1.3
    damping = np.array([t.chain.damping for t in truths]) / KR90.damping
    poor = KR90.damping < 150
    assert damping[:, ~poor].max() <= 2 < 5 < damping[:, poor].max() <= 10
    masses = np.array([[link.mass for link in t.chain.links] for t in truths]) / [512, 249, 223]
    assert np.abs(masses - 1).max() <= 0.03
    for truth in truths:
        assert all(
            np.linalg.eigvalsh(np.trace(x.inertia) / 2 * np.eye(3) - x.inertia)[0] > 0 for x in truth.chain.links
        )
        assert max(np.abs(e).max() for e in truth.posture_error.values()) <= np.deg2rad(0.2)
        assert all(abs(truth.gain[c.label] - 1) <= 0.01 for c in SENSORS)
    again = draw_truth(3, (), postures)
    np.testing.assert_array_equal(again.chain.stiffness, truths[3].chain.stiffness)


def test_the_same_seed_is_the_same_robot_and_payload_in_both_recordings(tmp_path):
    _, frf = campaign(tmp_path / "c.h5", "--seed", "5", "--effect", "payload@flange")
    out = tmp_path / "l.h5"
    assert main(["log", "--out", str(out), "--seed", "5", "--seconds", "10", "--effect", "coulomb_friction@joint2",
                 "--effect", "payload@flange"]) == 0  # fmt: skip
    log = json.loads(out.with_suffix(".truth.json").read_text())
    assert log["truth"]["chain"] == frf["truth"]["chain"]
    assert log["truth"]["effects"][1] == frf["truth"]["effects"][0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["campaign", "--effect", "backlash@joint1.z"], "--force-levels"),
        (["campaign", "--effect", "coulomb_friction@joint1"], "for `log`"),
        (["campaign", "--effect", "sensor_gain@sensor:22X+"], "sensor:21X+"),
        (["campaign", "--effect", "payload@flange:com=1"], "expected 3 numbers"),
        (["campaign", "--posture", "a=1,2"], "degrees"),
        (["campaign", "--hinges", "1", "--effect", "structural_damping@joint1.x"], "rigid"),
        (
            [
                "campaign",
                "--force-levels",
                "9",
                "--effect",
                "backlash@joint1.z",
                "--effect",
                "structural_damping@joint2.z",
            ],
            "frequency only",
        ),
        (["campaign", "--hits", "1", "--effect", "fractional_damper@joint1.z"], "frequency only"),
        (["campaign", "--hits", "1", "--effect", "time_delay@sensor:21X+"], "no --hits"),
        (["log", "--effect", "base_compliance@base.rx"], "for `campaign`"),
    ],
)
def test_a_bad_request_is_one_line_and_writes_nothing(tmp_path, capsys, arguments, says):
    assert main([arguments[0], "--out", str(tmp_path / "x.h5"), *arguments[1:]]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


# Motion logs


def run_of(seconds=10.0, dwells=0, seed=0, rate=250.0):
    trajectory = draw_fourier(KR90, np.random.default_rng(seed), seconds, dwells)
    return Run("run1", trajectory, np.arange(int(seconds * rate)) / rate, 0.0)


def torque(*texts, run=None, log=None, chain=KR90):
    run = run or run_of()
    _, _, parts = motor_torque(Truth(chain, tuple(parse(t) for t in texts)), run, log or Log())
    return sum(parts.values())


def test_motor_torque_is_pinocchios_with_rotors_as_armature_and_friction():
    model, parent = pin.Model(), 0
    for i, (a, alpha, d) in enumerate(KR90.dh):
        placement = pin.SE3(pin.utils.rotate("x", alpha), np.zeros(3)) * pin.SE3(np.eye(3), np.array([a, 0, d]))
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, str(i))
        link = KR90.links[i]
        model.appendBodyToJoint(parent, pin.Inertia(link.mass, link.com, link.inertia), pin.SE3.Identity())
    model.armature = KR90.gear_ratio**2 * KR90.rotor_inertia
    data = model.createData()
    run = run_of()
    q, v, a = run.trajectory(run.time)
    expected = np.array([pin.rnea(model, data, *state) for state in zip(q, v, a, strict=True)])
    expected += KR90.viscous * v + KR90.coulomb * np.sign(v)
    expected[:, 1] += sum(b * np.cos(k * q[:, 1]) for k, b in zip((1, 2, 3), KR90.compensator[1], strict=True))
    np.testing.assert_allclose(torque(run=run), expected, rtol=1e-9, atol=1e-8)


def test_a_trajectory_is_smooth_stays_in_its_limits_and_stands_still():
    trajectory = draw_fourier(KR90, np.random.default_rng(1), 30.0, 2)
    t = np.linspace(0, 30, 30001)
    q, v, a = trajectory(t)
    assert np.all((q > KR90.range_[:, 0]) & (q < KR90.range_[:, 1]))
    assert np.all(np.abs(v) < KR90.speed)
    assert np.all(np.abs(a) < KR90.acceleration)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[2:-2], v[2:-2], atol=1e-4)
    np.testing.assert_allclose(np.gradient(v, t, axis=0)[2:-2], a[2:-2], atol=1e-3)
    np.testing.assert_array_equal(v[[0, -1]], 0)
    for dwell in trajectory.dwells:
        assert np.abs(v[(t > dwell + 1.01) & (t < dwell + 1.99)]).max() < 1e-9


EFFECT_LAWS = [
    ("viscous_friction@joint1:coefficient=50", lambda q, v, a: 50 * v[:, 0], 0),
    ("coulomb_friction@joint2:torque=20", lambda q, v, a: 20 * np.sign(v[:, 1]), 1),
    (
        "asymmetric_friction@joint1:torque_difference=10,viscous_difference=6",
        lambda q, v, a: np.where(v[:, 0] > 0, 5 + 3 * v[:, 0], np.where(v[:, 0] < 0, 5 - 3 * v[:, 0], 0)),
        0,
    ),
    (
        "stribeck_friction@joint3:static_excess=30,velocity=0.1",
        lambda q, v, a: 30 * np.exp(-((v[:, 2] / 0.1) ** 2)) * np.sign(v[:, 2]),
        2,
    ),
    ("cable_stiffness@joint1:stiffness=10,rest=0.3", lambda q, v, a: 10 * (q[:, 0] - 0.3), 0),
    ("torque_ripple@joint2:amplitude=7,order=20,phase=0.5", lambda q, v, a: 7 * np.sin(20 * q[:, 1] + 0.5), 1),
    ("rotor_inertia@joint3:inertia=100", lambda q, v, a: 100 * a[:, 2], 2),
    ("gravity_compensator@joint3:coefficients=50|5|-2",
     lambda q, v, a: 50 * np.cos(q[:, 2]) + 5 * np.cos(2 * q[:, 2]) - 2 * np.cos(3 * q[:, 2]), 2),
]  # fmt: skip


@pytest.mark.parametrize(("text", "law", "joint"), EFFECT_LAWS)
def test_an_effect_adds_its_law_to_the_torque(text, law, joint):
    run = run_of()
    added = torque(text, run=run) - torque(run=run)
    expected = np.zeros(added.shape)
    expected[:, joint] = law(*run.trajectory(run.time))
    np.testing.assert_allclose(added, expected, atol=1e-8)


def test_friction_warms_up_on_the_campaigns_clock():
    cold = run_of()
    warm = replace(cold, start=1000.0)
    effect = "friction_drift@joint2:amplitude=0.5,time_constant=100"
    part = {run.start: motor_torque(Truth(KR90, (parse(effect),)), run, Log())[2]["friction"] for run in (cold, warm)}
    ratio = part[0.0][1:, 1] / part[1000.0][1:, 1]
    moving = np.isfinite(ratio)
    expected = (1 + 0.5 * np.exp(-cold.time / 100)) / (1 + 0.5 * np.exp(-(cold.time + 1000) / 100))
    np.testing.assert_allclose(ratio[moving], expected[1:][moving])


def test_torque_constant_scales_and_delay_shifts():
    run = run_of()
    plain = torque(run=run)
    np.testing.assert_allclose(torque("torque_constant@joint2:gain=1.05", run=run)[:, 1], 1.05 * plain[:, 1])
    late = torque("time_delay@log:delay=0.004", run=run)
    np.testing.assert_allclose(late[1:], plain[:-1], atol=1e-6 * np.abs(plain).max())  # one sample at 250 Hz


NULLS = [
    "payload@flange:mass=0,com=1.7|0|0",
    "joint_coupling@joint2:from=3,ratio=0",
    "hysteresis@joint1.z:stiffness=0,yield_torque=10",
    "load_dependent_friction@joint2:coefficient=0",
    "friction_drift@joint1:amplitude=0,time_constant=100",
    "torque_constant@joint1:gain=1",
    "time_delay@log:delay=0",
    "backlash@joint2.z:gap=0",
]


@pytest.mark.parametrize("text", NULLS)
def test_an_effect_at_its_null_value_leaves_the_torque(text):
    run, log = run_of(), Log(link_encoder=True)
    np.testing.assert_allclose(torque(text, run=run, log=log), torque(run=run, log=log), atol=1e-9)


@pytest.mark.parametrize("law", ["lugre", "slip"])
def test_friction_with_memory_is_coulombs_once_sliding_and_holds_at_standstill(law):
    run = run_of(30.0, 2)
    _, v, _ = run.trajectory(run.time)
    memory = torque(run=run, log=Log(friction=law)) - torque(run=run)
    sliding = np.abs(v) > 0.3
    assert np.abs(memory[sliding]).max() < 0.05 * KR90.coulomb.min()
    still = np.all(np.abs(v) < 1e-9, axis=1) & (run.time > 1)
    assert np.abs(memory[still]).max() > 0.5 * KR90.coulomb.min()  # sgn 0 is 0; bristles remember


def test_slip_elements_dissipate_the_textbook_loop():
    x = 2e-3 * np.sin(np.linspace(0, 4 * np.pi, 8001))
    out = slip(x, np.array([1e5, 2e5]), np.array([20.0, 50.0]))
    loop = np.trapezoid(out[4000:], x[4000:])
    assert loop == pytest.approx(4 * 20 * (2e-3 - 2e-4) + 4 * 50 * (2e-3 - 2.5e-4), rel=1e-3)


def test_the_gas_spring_is_the_papers_compensator_to_a_few_newton_metres():
    q = np.linspace(*KR90.range_[1], 300)[:, None] * np.ones(3)
    series, gas = (compensator(KR90, q, law)[:, 1] for law in ("series", "gas"))
    assert np.std(gas - series) < 18


def test_a_gap_parts_link_and_motor_by_its_width():
    run = run_of(30.0)
    truth = Truth(KR90, (parse("backlash@joint3.z:gap=1e-3"),))
    log = Log(counts=2**20)
    found = record(truth, run, log, np.random.default_rng(0))
    elastic = record(Truth(KR90), run, replace(log, link_encoder=True), np.random.default_rng(0))
    lost = (found.position - found.link_position) - (elastic.position - elastic.link_position)
    assert np.abs(lost[:, 2]).max() == pytest.approx(5e-4, abs=1e-6)
    assert np.abs(lost[:, :2]).max() < 1e-6


def test_recorded_noise_and_quantisation_are_the_stated_ones():
    run, log = run_of(60.0), Log(white=8.0, coloured=6.0, colour_s=0.05)
    found = record(Truth(KR90), run, log, np.random.default_rng(0))
    noise = found.torque - torque(run=run, log=log)
    assert np.std(noise) == pytest.approx(10.0, rel=0.03)
    lag = np.mean(noise[12:] * noise[:-12]) / 36  # 48 ms: e^{−0.96} of the coloured part
    assert lag == pytest.approx(np.exp(-12 / 250 / 0.05), abs=0.1)
    step = 2 * np.pi / (KR90.gear_ratio * log.counts)
    error = found.position - run.trajectory(run.time)[0]
    assert np.all(np.abs(error) <= step / 2 + 1e-12)
    np.testing.assert_allclose(np.std(error, axis=0), step / np.sqrt(12), rtol=0.05)


def test_a_log_follows_given_positions_and_has_the_contracts_fields(tmp_path):
    t = np.arange(0, 8, 0.02)
    q = np.stack([0.3 * np.sin(t), 1.2 + 0.2 * np.cos(t), -1.5 + 0.1 * t], -1)
    table = tmp_path / "given.csv"
    np.savetxt(table, np.column_stack([t, q]), delimiter=",", header="time,q1,q2,q3", comments="")
    out = tmp_path / "l.h5"
    assert (
        main(["log", "--out", str(out), "--positions", str(table), "--nominal", "--white", "0", "--coloured", "0"]) == 0
    )
    with h5py.File(out) as file:
        assert file.attrs["format"] == "motion-log"
        run = file["runs/run1"]
        assert run.attrs["sample_rate_hz"] == 250
        nt = len(run["time"])
        assert run["position"].shape == run["torque"].shape == (nt, 3)
        np.testing.assert_allclose(run["position"][:, 0], 0.3 * np.sin(run["time"][:]), atol=1e-5)
        exact = lambda s: (  # noqa: E731
            np.stack([0.3 * np.sin(s), 1.2 + 0.2 * np.cos(s), -1.5 + 0.1 * s], -1),
            np.stack([0.3 * np.cos(s), -0.2 * np.sin(s), 0.1 + 0 * s], -1),
            np.stack([-0.3 * np.sin(s), -0.2 * np.cos(s), 0 * s], -1),
        )
        expected = torque(run=Run("run1", exact, run["time"][:], 0.0))
        assert apart(run["torque"][5:-5], expected[5:-5]) < 1e-3


def test_a_coupled_rotor_does_its_work_on_both_axes():
    """Power of the coupling torque is that of rotor 3 turning with q̇₃ + r q̇₂ less that of turning with q̇₃."""
    run, ratio = run_of(), 0.2
    _, v, a = run.trajectory(run.time)
    added = torque(f"joint_coupling@joint2:from=3,ratio={ratio}", run=run) - torque(run=run)
    inertia = (KR90.gear_ratio**2 * KR90.rotor_inertia)[2]
    both, rate = v[:, 2] + ratio * v[:, 1], a[:, 2] + ratio * a[:, 1]

    def rotor(speed, acceleration):
        return inertia * acceleration + KR90.viscous[2] * speed + KR90.coulomb[2] * np.sign(speed)

    power = rotor(both, rate) * both - rotor(v[:, 2], a[:, 2]) * v[:, 2]
    np.testing.assert_allclose((added * v).sum(1), power, rtol=1e-9, atol=1e-8)


def test_a_trajectory_through_its_own_samples_is_itself():
    fourier = run_of(10.0).trajectory
    assert isinstance(fourier, Fourier)
    t = np.arange(0, 10, 0.01)
    inner = np.linspace(1.5, 8.5, 500)
    for own, splined in zip(fourier(inner), sampled(t, fourier(t)[0])(inner), strict=True):
        np.testing.assert_allclose(splined, own, atol=1e-5)
