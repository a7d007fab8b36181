"""Force levels that disagree: blows stepped against MuJoCo and the truth code; joint, law and size are found."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tools.truth.__main__ import main as truth
from twin.commands.compare import compare_hammer
from twin.diagnose.edit import is_nonlinear
from twin.diagnose.hammer import diagnose_campaign
from twin.diagnose.levels import (
    Levels,
    _begun,
    _own,
    _race,
    _settling,
    decide_levels,
    explain_levels,
    fit_law,
    point,
    with_law,
)
from twin.diagnose.levels_beside import _doubted, explain_beside
from twin.diagnose.levels_finding import check_blows
from twin.diagnose.levels_next import next_blows, smallest_visible_laws
from twin.diagnose.locate import free_blows, free_laws
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.search import converge
from twin.diagnose.triage import triage
from twin.diagnose.verdict import Finding, estimates_of
from twin.identify.descent import minimise
from twin.identify.joint_reaction import Stepped
from twin.identify.objective import Objective, Sample
from twin.measure.blows import Blow, blows
from twin.measure.campaign import Campaign, read_campaign
from twin.model.blow import RATE_HZ, Strike, _drive, pulse_transform, torques, transform
from twin.model.held_law import UnderLaw
from twin.model.joint_laws import Drag
from twin.model.parameters import Parameter, free_parameters, independent, join
from twin.model.recorded import prepare, without_limits
from twin.model.sensitivity import Observed
from twin.physics import CATALOGUE, amplitude_laws, register
from twin.physics.backlash import Gap
from twin.physics.effect import Effect
from twin.physics.effect import Parameter as Play
from twin.physics.hardening_stiffness import Cubic
from twin.physics.hysteresis import Slip, SlipAnywhere
from twin.physics.joint_law import Law
from twin.robot.description import Entry, Robot


def recorded(folder: Path, effect: str, *options: str) -> Campaign:
    """Two force levels by the truth code."""
    file = folder / "c.h5"
    concealed = ["--effect", effect] if effect else []
    assert truth(["campaign", "--out", str(file), "--force-levels", "100", "600", *concealed, *options]) == 0
    return read_campaign(file)


SLIP = Slip((1e-6, 3e-6, 1e-5, 3e-5, 1e-4))
CASES = [
    ("hardening_stiffness@joint1.z:cubic=3e13", Cubic(), [3e13], 0.0005),
    ("hardening_stiffness@joint2.z:cubic=1e13", Cubic(), [1e13], 0.0005),  # stiffened by the weight it carries
    ("backlash@joint2.z:gap=5e-5", Gap(), [5e-5], 0.002),  # pressed shut by it
    ("backlash@joint1.z:gap=2e-5", Gap(), [2e-5], 0.1),  # open: the ends of decays hang on the least difference
    (
        "hysteresis@joint2.z:stiffness=1e5|1e5|1e5|1e5|1e5,yield_torque=0.1|0.3|1|3|10", SLIP, [1e5] * 5, 0.001,
    ),
    ("eddy_current_damper@joint2.z:coefficient=3e6", Drag(), [3e6], 0.005),  # which has no name
]  # fmt: skip


@pytest.mark.parametrize(("effect", "law", "sizes", "tolerance"), CASES, ids=[c[0].partition(":")[0] for c in CASES])
def test_stepped_blows_are_the_truth_codes(
    kr90: Robot, tmp_path: Path, effect: str, law: Law, sizes: list[float], tolerance: float
) -> None:
    """The law at a joint gives the FRFs of both force levels that an independent simulation of every blow gives."""
    campaign = recorded(tmp_path, effect, "--nominal", "--no-sag", "--noise", "0", "--scatter", "0", "--postures", "1")
    recordings = tuple(prepare(campaign, kr90).values())
    blow, site = blows(campaign), effect.partition("@")[2].partition(":")[0]
    assert blow is not None
    stepped = Stepped(
        without_limits(kr90), independent([]), Sample(recordings), law=law, site=site, blow=blow, fixed=np.array(sizes)
    )
    for r, H in zip(recordings, stepped.predicted(np.zeros(0)), strict=True):
        assert np.linalg.norm(H - r.frf) < tolerance * np.linalg.norm(r.frf)


def test_compare_strikes_a_robot_with_a_law_of_amplitude_in_time(kr90: Robot, tmp_path: Path) -> None:
    """Linearised it would miss by what the law does. A law half as hard under blows 1.4 times as long gives the same
    FRFs, and how long they were belongs to the recording."""
    campaign = recorded(tmp_path, "hardening_stiffness@joint1.z:cubic=3e13", "--nominal", "--no-sag", "--postures", "1")
    for cubic in (3e13, 1.5e13):
        law = Entry.model_validate({"effect": "hardening_stiffness", "site": "joint1.z", "cubic": cubic})
        robot = kr90.model_copy(update={"physics": [law, *kr90.physics]})  # wherever the entry stands
        found = compare_hammer(robot, campaign, "c.h5")
        assert found.noise_floor is not None
        assert found.error < 1.3 * found.noise_floor
    assert compare_hammer(kr90, campaign, "c.h5").error > 5 * found.noise_floor


@pytest.mark.parametrize(("law", "sizes"), [(Cubic(), [1e13]), (Gap(), [5e-5]), (SLIP, [1e5] * 5)])
def test_longer_blows_on_a_law_as_much_larger_give_the_same_frfs(
    kr90: Robot, tmp_path: Path, law: Law, sizes: list[float]
) -> None:
    """Deflections are in proportion to momentum: a law's size goes with the length of blows that nobody recorded."""
    campaign = recorded(tmp_path, "", "--nominal", "--no-sag", "--noise", "0", "--scatter", "0", "--postures", "1")
    robot, sample, blow = without_limits(kr90), Sample(tuple(prepare(campaign, kr90).values())), blows(campaign)
    assert blow is not None
    own = [Parameter(f"x.{n}", "", "entry", True, value, 1.0) for n, value in zip(law.names, sizes, strict=True)]
    pulse = Parameter("x.pulse", "s", "entry", True, 0.010, 0.2)
    usual = Stepped(robot, independent([*own, pulse]), sample, law=law, site="joint2.z", blow=blow)
    entry = law.entry(*usual.own(np.zeros(len(sizes) + 1)))
    longer = {name: replace(b, pulse_s=0.010) for name, b in blow.items()}
    if isinstance(law, Slip):
        larger: Law = Slip(tuple(np.divide(entry["yield_torque"], entry["stiffness"])))
        fixed = np.array(entry["stiffness"])
    else:
        larger, fixed = law, np.array([entry[law.names[0]]])
    other = Stepped(robot, independent([]), sample, law=larger, site="joint2.z", blow=longer, fixed=fixed)
    for one, two in zip(usual.predicted(np.zeros(len(sizes) + 1)), other.predicted(np.zeros(0)), strict=True):
        assert np.linalg.norm(one - two) < 1e-9 * np.linalg.norm(one)


def test_a_held_law_is_the_stepped_one_where_it_was_held(kr90: Robot, tmp_path: Path) -> None:
    """What a linear model predicts under the held torque is what stepping predicts; its slopes are differences."""
    campaign = recorded(tmp_path, "", "--nominal", "--no-sag", "--noise", "0", "--scatter", "0", "--postures", "1")
    robot, recordings = without_limits(kr90), prepare(campaign, kr90)
    free = free_parameters(robot, tolerances=False)
    own = (Parameter("hardening_stiffness@joint1.z.cubic", "N·m/rad³", "entry", True, 3e13, 1.0),)
    stepped = Stepped(
        robot, join(free, independent(own)), Sample(tuple(r.every(8) for r in recordings.values())),
        law=Cubic(), site="joint1.z", blow=blows(campaign) or {},
    )  # fmt: skip
    z = np.zeros(len(free) + 1)
    objective = Objective(robot, free, Sample(tuple(stepped.held(z))))
    for one, two in zip(stepped.predicted(z), objective.predicted(z[:-1]), strict=True):
        assert np.linalg.norm(one - two) < 1e-9 * np.linalg.norm(one)
    linear = Objective(robot, free, stepped.sample).predicted(z[:-1])
    assert np.linalg.norm(linear[1] - one) > 0.05 * np.linalg.norm(one)  # at 600 N the law shows
    _, slopes = objective.jacobian(z[:-1])
    k = free.names.index("joint1.z.stiffness")
    step = 1e-4 * np.eye(len(free))[k]
    change = (objective.residual(z[:-1] - step) - objective.residual(z[:-1] + step)) / 2e-4
    assert np.linalg.norm(change - slopes[k]) < 1e-4 * np.linalg.norm(change)


def test_what_another_law_explains_is_known_beside_a_held_one(kr90: Robot, tmp_path: Path) -> None:
    """Free stiffnesses of blows gain much where the law held is not the robot's, nothing where it is, and they leave
    what they explain to no other law."""
    campaign = recorded(tmp_path, "", "--nominal", "--no-sag", "--noise", "0", "--scatter", "0", "--postures", "1")
    robot = without_limits(kr90)
    recordings = [r.every(8) for r in prepare(campaign, kr90).values()]
    free, noise = free_parameters(robot, tolerances=False), np.random.default_rng(0)
    kappa = [3e3 * (1 + noise.random(r.frf.shape[2])) + 0 * r.s[:, None] for r in recordings]
    gains = []
    for share in (1.0, 0.0):  # of the true reaction that is known of
        held = [UnderLaw.of(r, "joint1.z", share * k, 0 * k) for r, k in zip(recordings, kappa, strict=True)]
        true = [replace(r, kappa=k) for r, k in zip(held, kappa, strict=True)]
        told = []
        for r, H in zip(held, Objective(robot, free, Sample(tuple(true))).predicted(np.zeros(len(free))), strict=True):
            deviation = 1e-3 * np.abs(H).mean()
            scatter = deviation / np.sqrt(2) * (noise.normal(size=H.shape) + 1j * noise.normal(size=H.shape))
            told.append(replace(r, frf=H + scatter, variance=np.full(H.shape, deviation**2 / 2)))
        sample = Sample(tuple(told))
        fit = descend(robot, NONE, free, sample, np.zeros(len(free)), tempered=0, linear=8)
        gain, columns = free_blows(fit, sample, "joint1.z")
        alone, beside = (free_laws(fit, sample, aside)["joint1.z"] for aside in (None, columns))
        gains.append((gain, alone, beside))
    assert gains[0][0] == 0.0
    assert gains[1][0] > 100.0
    assert gains[1][2] < 3.0 < 0.1 * gains[1][1]


def test_slopes_of_finely_stepped_blows_are_those_of_their_cost(kr90: Robot, tmp_path: Path) -> None:
    """Differences over coarse steps lead downhill, along every number of the law and the length of the blows."""
    campaign = recorded(tmp_path, "", "--nominal", "--no-sag", "--postures", "1")
    robot, recordings = without_limits(kr90), prepare(campaign, kr90)
    free = free_parameters(robot, tolerances=False)
    own = [*_own(SLIP, "hysteresis@joint1.z", SLIP.usual(5e6)), Parameter("x.pulse", "s", "entry", True, 0.008, 0.2)]
    stepped = Stepped(
        robot, join(free, independent(own)), Sample(tuple(r.every(8) for r in recordings.values())),
        law=SLIP, site="joint1.z", blow=blows(campaign) or {}, closely=True,
    )  # fmt: skip
    z = np.zeros(len(free) + len(own))
    _, gradient, information = stepped(z)
    for k in range(len(free), len(z)):
        step = 1e-3 * np.eye(len(z))[k]
        up, down = stepped.costs([z + step, z - step])
        assert (up - down) / 2e-3 == pytest.approx(
            gradient[k], abs=0.005 * abs(gradient[k]) + 0.3 * information[k, k] ** 0.5
        )


def test_a_blow_is_an_exact_half_sine() -> None:
    """Its transform is the integral, and what it adds to a mode is, whatever share of the last step it lasts."""
    pulse_s, pole = 0.0087, np.array([-3 + 120j])
    t = np.linspace(0, pulse_s, 20001)
    wave = np.sin(np.pi * t / pulse_s)
    s = 0.6 + 2j * np.pi * np.array([5.0, 20.0])
    assert pulse_transform(s, pulse_s) == pytest.approx(np.trapezoid(wave * np.exp(-s[:, None] * t), t), rel=1e-5)
    added = _drive(pole, pulse_s, 12)[:, 0]
    end = len(added) / RATE_HZ
    together = np.sum(added * np.exp(pole * (end - np.arange(1, len(added) + 1) / RATE_HZ)))
    assert together == pytest.approx(np.trapezoid(wave * np.exp(pole * (end - t)), t), rel=1e-6)


def test_a_blow_longer_than_any_hammers_is_not_stepped() -> None:
    """The length of blows is fitted: a trial may try one of hours, which would fill the memory."""
    strike = Strike(oscillator(60.0, 0.01), 0, 3600.0, 0.0, 1.0, 1e4, np.array([1.0]))
    ((g, largest),) = torques([strike], Cubic(), 2.0)
    assert g.shape == (round(2 * RATE_HZ), 1)
    assert np.isnan(g).all()
    assert np.isnan(largest).all()


def oscillator(omega: float, zeta: float) -> Observed:
    """One kilogram on a spring."""
    one = np.ones((1, 1))
    return Observed(
        one, 2 * zeta * omega * one, omega**2 * one, 0 * one, 0 * one, one, one, np.ones(1), np.zeros(1), 0 * one
    )


def test_duffings_frequency_rises_with_the_square_of_amplitude() -> None:
    """A free undamped oscillator with a cubic spring swings at ω²(1 + ¾ k₃A²/k) to first order (Nayfeh and Mook)."""
    omega, amplitude = 2 * np.pi * 10, 1e-4
    k3 = 0.04 * omega**2 / amplitude**2
    strike = Strike(oscillator(omega, 0.0), 0, omega**2, 0.0, 1.0, 0.002, np.array([k3]))
    momentum = pulse_transform(np.zeros(1, complex), 0.002)[0].real
    # the blow gives a velocity v; energy fixes the amplitude it leads to
    speed = np.sqrt(omega**2 * amplitude**2 + 0.5 * k3 * amplitude**4)
    strike = replace(strike, peak_n=speed / momentum)
    ((g, largest),) = torques([strike], Cubic(), 8.0)
    assert largest[0] == pytest.approx(amplitude, rel=3e-3)
    x = np.cbrt(g[:, 0] / k3)
    up = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    crossing = up - x[up] / (x[up + 1] - x[up])
    found = 2 * np.pi * RATE_HZ * (len(up) - 1) / (crossing[-1] - crossing[0])
    assert (found / omega) ** 2 - 1 == pytest.approx(0.75 * 0.04, rel=0.02)


def test_slip_dissipates_the_area_of_its_loop() -> None:
    """One Jenkins element swung to ±X beyond its yield takes 4 k δ (X − δ) per cycle."""
    law = Slip((1e-5,) * 5)
    sizes = np.array([[1e6], [0.0], [0.0], [0.0], [0.0]])
    x = 5e-5 * np.sin(np.linspace(0, 4 * np.pi, 40001))
    state, g = law.state(1), []
    for value in x:
        torque, state = law.torque(np.array([value]), np.ones(1), sizes, state)
        g.append(torque[0])
    last = slice(20000, None)
    assert np.trapezoid(np.array(g)[last], x[last]) == pytest.approx(4 * 1e6 * 1e-5 * 4e-5, rel=1e-3)


@pytest.mark.slow
def test_slip_is_settled_from_where_it_was_found(kr90: Robot, tmp_path: Path) -> None:
    """With the yields sought too it begins as what was found, and moving them is worth a step where they are wrong."""
    slip = "hysteresis@joint2.z:stiffness=1e5|1e5|1e5|1e5|1e5,yield_torque=0.1|0.3|1|3|10"
    campaign = recorded(tmp_path, slip, "--nominal", "--no-sag", "--postures", "1")
    recordings = tuple(r.every(8) for r in prepare(campaign, kr90).values())
    robot, free = without_limits(kr90), free_parameters(kr90, tolerances=False)
    base = descend(robot, NONE, free, Sample(recordings), np.zeros(len(free)), tempered=0, linear=0)
    wrong = Slip(tuple(1.2 * np.array(SLIP.reach)))
    stepped, hypothesis = with_law(robot, base, wrong, "joint2.z", Sample(recordings), blows(campaign) or {})
    z = point(stepped, free.values(np.zeros(len(free))), np.full(5, 1e5))
    fit = fit_law(stepped, hypothesis, z)
    law = wrong.settling()
    hypothesis, parameters, z = _settling(law, 5, fit, free)
    freed = replace(stepped, law=law, parameters=parameters, closely=True)
    assert freed.cost(z) == pytest.approx(fit.cost, rel=1e-9)
    assert [p.name for p in hypothesis.own][-2:] == ["hysteresis@joint2.z.reach[4]", "hysteresis@joint2.z.pulse"]
    end, cost, *_ = minimise(freed, z, 6, 0.1)
    assert fit.cost - cost > 20
    entry = law.entry(freed.own(end)[0])
    assert np.divide(entry["yield_torque"], entry["stiffness"])[2] < 0.95 * wrong.reach[2]


def test_a_partner_of_slip_whose_yields_are_wrong_is_sought_again(
    kr90: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a law of few numbers leaves is no sign of a partner: it is sought anew beside the law as it settles."""
    slip = "hysteresis@joint2.z:stiffness=1e5|1e5|1e5,yield_torque=0.3|1|3"
    brief = ["--postures", "1", "--spacing-hz", "0.25", "--lines", "90"]
    campaign = recorded(tmp_path, slip, "--nominal", "--no-sag", *brief)
    sample, blow = Sample(tuple(r.every(3) for r in prepare(campaign, kr90).values())), blows(campaign)
    assert blow is not None
    robot, free = without_limits(kr90), free_parameters(kr90, tolerances=False)
    base = descend(robot, NONE, free, sample, np.zeros(len(free)), tempered=0, linear=0)
    wrong = Slip((5e-6, 1.5e-5, 4.5e-5))  # a true one yields at 3e-6, 1e-5, 3e-5
    stepped, hypothesis = with_law(robot, base, wrong, "joint2.z", sample, blow)
    found = fit_law(stepped, hypothesis, point(stepped, free.values(np.zeros(len(free))), np.full(3, 1e5)))
    levels = Levels([], [found], base, 0.0, 0.0, [stepped], sample, blow)
    looked: list[tuple[float, list[float]]] = []

    def look(robot: Robot, base: Fitted, levels: Levels, law: Fitted, *others: object) -> list[Fitted]:
        objective = levels.objectives[0]
        entry = objective.law.entry(*objective.own(law.z))
        looked.append((law.misfit, np.divide(entry["yield_torque"], entry["stiffness"]).tolist()))
        return [base] if len(looked) == 1 else []

    def both(robot: Robot, base: Fitted, stepped: Stepped, law: Fitted, linear: Fitted) -> tuple[Fitted, Stepped]:
        return replace(law, misfit=1.0, converged=True), stepped

    module = sys.modules[explain_beside.__module__]
    monkeypatch.setattr(module, "_found", look)
    monkeypatch.setattr(module, "_both", both)
    beside = explain_beside(robot, base, levels, [])
    _, (misfit, reach) = looked
    assert beside.decision is None
    assert found.misfit > 1.5
    assert misfit < 1.1
    assert reach == pytest.approx([3e-6, 1e-5, 3e-5], rel=0.1)
    assert beside.stepped.cost(beside.law.z) == pytest.approx(beside.law.cost, rel=1e-6)


def test_steps_follow_a_smooth_torque_by_parabolas() -> None:
    """Twenty steps per cycle give what the finest give; straight lines between them are off by eight in a thousand."""
    strike = Strike(oscillator(2 * np.pi * 12, 0.01), 0, (2 * np.pi * 12) ** 2, 0.0, 1.0, 0.008, np.array([3e9]))
    s = 0.6 + 2j * np.pi * np.linspace(6, 30, 40)
    coarse, fine = (transform(s, torques([strike], Cubic(), 2.0, rate)[0][0], rate) for rate in (256.0, 8192.0))
    assert np.linalg.norm(coarse - fine) < 0.001 * np.linalg.norm(fine)


def test_transform_is_that_of_the_parabolas() -> None:
    """A decaying exponential through its samples has the transform 1/(s + a)."""
    s = 0.6 + 2j * np.pi * np.array([5.0, 20.0])
    t = np.arange(9000) / RATE_HZ
    assert transform(s, np.exp(-5 * t)[:, None])[:, 0] - 0.5 / RATE_HZ == pytest.approx(1 / (s + 5), rel=0.03)


def test_a_torque_stays_as_it_ended() -> None:
    """What a slip has shifted after the record's end is still shifted: however long it is stepped, the same is seen."""
    s = 2j * np.pi * np.array([5.0, 20.0])
    np.testing.assert_allclose(transform(s, np.ones((500, 1))), transform(s, np.ones((4000, 1))), rtol=1e-9)


@pytest.mark.parametrize("law", [Slip((1e-5, 1e-4)), SlipAnywhere((1e-5, 1e-4))])
def test_slip_sticks_at_rest(law: Slip) -> None:
    sizes = np.array([2e5, 3e5, 1e-5, 1e-4])[: len(law.names), None]
    little, k = np.array([1e-9]), np.array([1e6])
    torque, _ = law.torque(little, k, sizes, law.state(1))
    assert law.tangent(np.zeros(1), sizes) * little == pytest.approx(torque)


def test_laws_that_explain_what_is_asked_stay_in_the_race(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that begins six times behind the best, where a large model error is allowed, may be the right one."""

    @dataclass(frozen=True)
    class Runner:
        name: str
        sample: Sample
        data: float = 1000.0

    costs = {
        ("right", 0.1): 90.0,
        ("wrong", 0.1): 15.0,
        ("worst", 0.1): 2000.0,
        ("right", 0.0): 480.0,
        ("wrong", 0.0): 9e4,
    }
    monkeypatch.setattr(sys.modules["twin.diagnose.levels"], "_tempered", lambda sample, temper: temper)
    monkeypatch.setattr(
        sys.modules["twin.diagnose.levels"], "minimise", lambda o, z, *rest: (z, costs[o.name, o.sample])
    )
    begun = [(Runner(name, Sample(())), name, np.zeros(1)) for name in ("wrong", "right", "worst")]
    trials, reached = _race(begun, (0.1, 0.0), lambda count: None, 1)  # type: ignore[arg-type]
    assert [trial[1] for trial in trials] == ["right"]
    assert reached == 0.0


def test_whole_decays_begin_by_their_logarithmic_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hardening of 1.9e13 N·m/rad³ left its window at 3.2e13, from where a plain residual did not lead back."""

    @dataclass(frozen=True)
    class Runner:
        sample: str
        blow: dict[str, Blow]
        logarithmic: bool = False

    def descend(objective: Runner, z: np.ndarray, *rest: float) -> tuple[np.ndarray, float]:
        return (z - 1.0, 0.0) if objective.logarithmic and objective.sample == "whole" else (z, 1.0)

    monkeypatch.setattr(sys.modules["twin.diagnose.levels"], "minimise", descend)
    begun = [(Runner("window", {}), name, np.full(1, 3.0)) for name in ("one", "other")]
    trials = _begun(begun, "whole", {}, 1)  # type: ignore[arg-type]
    assert [(objective.sample, objective.logarithmic) for objective, *_ in trials] == [("whole", False)] * 2
    assert [z[0] for *_, z in trials] == [2.0, 2.0]


@pytest.mark.parametrize(("law", "size", "doubted"), [(Gap(), 3e-7, True), (Cubic(), 1e13, False)])
def test_an_open_play_is_doubted_by_what_longer_steps_change(
    kr90: Robot, tmp_path: Path, law: Law, size: float, doubted: bool
) -> None:
    campaign = recorded(tmp_path, "", "--postures", "1", "--spacing-hz", "0.25", "--lines", "90")
    sample, blow = Sample(tuple(prepare(campaign, kr90).values())), blows(campaign)
    assert blow is not None
    robot, none = without_limits(kr90), independent([])
    stepped = Stepped(robot, none, sample, law=law, site="joint1.z", blow=blow, fixed=np.array([size]))
    found = _doubted(stepped, np.zeros(0))
    assert (found is not sample) == doubted
    if doubted:
        louder = [
            float((a.variance / b.variance).mean()) for a, b in zip(found.recordings, sample.recordings, strict=True)
        ]
        assert louder[0] > louder[1] >= 1  # light blows hang in the play for longer
        assert found.weights(0.0, False)[0].sum() < sample.weights(0.0, False)[0].sum()


def found_in(campaign: Campaign, robot: Robot) -> tuple[list[str], dict[str, dict[str, object]], Levels, Sample]:
    """Names in the order of probability, the first one's parameters, and what they were chosen from."""
    base = without_limits(robot)
    checked = triage(campaign, base, "test", None)
    sample = Sample(tuple(checked.used))
    free = free_parameters(base, dict.fromkeys(r.setup.name for r in checked.used), campaign.response.label)
    free = free.select(k for k, p in enumerate(free) if p.kind != "sag")
    search = converge(base, free, sample)
    levels = explain_levels(campaign, base, search.base, sample, search.robust)
    assert levels is not None
    decision = decide_levels(levels)
    assert decision.none + decision.other + sum(decision.probability) == pytest.approx(1.0)
    first = decision.ranked[0]
    return [fit.hypothesis.key for fit in decision.ranked], estimates_of(first, first.own), levels, sample


@pytest.mark.slow
def test_hardening_is_found_with_its_size(kr90: Robot, tmp_path: Path) -> None:
    """A cubic spring at joint 1 of a robot with all tolerances is named, and its interval is about its true value."""
    brief = ["--postures", "3", "--spacing-hz", "0.25", "--lines", "90"]
    campaign = recorded(tmp_path, "hardening_stiffness@joint1.z:cubic=2e13", "--seed", "5", *brief)
    names, sizes, levels, sample = found_in(campaign, kr90)
    assert names[0] == "hardening_stiffness@joint1.z"
    assert sizes["cubic"]["value"] == pytest.approx(2e13, rel=0.03)
    test = next_blows(kr90, levels, levels.fits[0], None, sample, blows(campaign) or {})
    assert test is not None
    assert test["separates"] == ["hardening_stiffness@joint1.z", "none"]
    assert test["expected_ln_bayes_factor"] > 8


def test_what_would_just_have_been_seen_is_where_levels_begin_to_disagree(kr90: Robot, tmp_path: Path) -> None:
    """Half the smallest visible cubic spring passes the triage, twice as much fails it; a gap shut by weight never."""
    options = ["--nominal", "--no-sag", "--postures", "1"]
    campaign = recorded(tmp_path, "", *options)
    base = without_limits(kr90)
    sample = Sample(tuple(prepare(campaign, base).values()))
    free = free_parameters(base, tolerances=False)
    fit = descend(base, NONE, free, sample, np.zeros(len(free)), tempered=0, linear=2)
    seen = {(v["effect"], v["site"]): v for v in smallest_visible_laws(base, fit, sample, blows(campaign) or {})}
    assert ("backlash", "joint2.z") not in seen
    assert ("backlash", "joint1.z") in seen
    smallest = seen["hardening_stiffness", "joint1.z"]["value"]
    for factor, flagged in ((0.5, False), (2.0, True)):
        changed = recorded(tmp_path, f"hardening_stiffness@joint1.z:cubic={factor * smallest:g}", *options)
        assert triage(changed, base, "test", None).nonlinear is flagged


def test_mujoco_steps_the_same_blows(kr90: Robot, tmp_path: Path) -> None:
    """MuJoCo's native cubic spring under the same blows gives the FRFs of the search and the recorded level change."""
    effect = "hardening_stiffness@joint1.z:cubic=3e13"
    campaign = recorded(tmp_path, effect, "--nominal", "--no-sag", "--noise", "0", "--scatter", "0", "--postures", "1")
    entry = Entry(effect="hardening_stiffness", site="joint1.z", cubic=3e13)
    robot = kr90.model_copy(update={"physics": [*kr90.physics, entry]})
    check = check_blows(robot, campaign, prepare(campaign, kr90))
    assert check is not None
    assert check["value"] < 0.01


def test_levels_without_peak_forces_say_nothing(tmp_path: Path, kr90: Robot) -> None:
    """Amplitudes follow from peak forces: without them there is no law of amplitude to fit."""
    campaign = recorded(tmp_path, "", "--postures", "1")
    bare = {name: replace(p, peak_force_n=None) for name, p in campaign.postures.items()}
    assert blows(replace(campaign, postures=bare)) is None
    assert blows(campaign) == {
        "milling@100N": Blow(100.0, 0.008, 8.0),
        "milling@600N": Blow(600.0, 0.008, 8.0),
    }


def test_drag_takes_out_the_power_of_its_law() -> None:
    """c φ̇ |φ̇| along a sine takes 8/3 c ω² X³ out of it per cycle, at any fine rate of steps."""
    amplitude, omega, c = 3e-5, 2 * np.pi * 12, 2.0
    for rate in (4096.0, 8192.0):
        law = Drag().stepped(rate)
        time = np.arange(round(rate / 12 * 3) + 1) / rate
        x = amplitude * np.sin(omega * time)
        state, g = law.state(1), []
        for value in x:
            torque, state = law.torque(np.array([value]), np.ones(1), np.array([[c]]), state)
            g.append(torque[0])
        last = slice(-round(rate / 12) - 1, None)
        work = np.trapezoid(np.array(g)[last], x[last])
        assert work == pytest.approx(8 / 3 * c * omega**2 * amplitude**3, rel=5e-3)


def test_a_step_across_a_gap_keeps_mean_and_moment() -> None:
    """What is added to a step's line gives it the mean and the first moment of the gap's torque over the way."""
    half, k, x0, x1 = 1e-6, 1e9, -4e-6, 7e-6
    u = np.linspace(0, 1, 200001)
    g = -k * np.clip(x0 + (x1 - x0) * u, -half, half)
    at, torque = (np.array([x0]), np.array([x1])), (g[:1], g[-1:])
    bent = Gap().line(at, torque, np.array([k]), np.array([[2 * half]]))
    assert bent is not None
    start, end = g[0] + bent[1][0], g[-1] + bent[2][0]
    assert (start + end) / 2 == pytest.approx(np.trapezoid(g, u), rel=1e-6)
    assert start / 6 + end / 3 == pytest.approx(np.trapezoid(u * g, u), rel=1e-6)
    assert Gap().line((at[0], at[0] + 1e-7), torque, np.array([k]), np.array([[2 * half]])) is None


def test_a_law_is_hit_where_it_was_found_last(kr90: Robot) -> None:
    """Slip that a log found is followed by what else it holds: the blows' check is of the law that they found."""
    slip = Entry.model_validate({"effect": "hysteresis", "site": "joint1.z", "stiffness": [1e5], "yield_torque": [9.0]})
    dry = Entry.model_validate({"effect": "presliding", "site": "joint1", "stiffness": [1e5], "yield_torque": [9.0]})
    assert is_nonlinear(kr90.model_copy(update={"physics": [*kr90.physics, slip]}))
    assert not is_nonlinear(kr90.model_copy(update={"physics": [*kr90.physics, slip, dry]}))


@pytest.mark.slow
def test_a_law_that_is_described_is_no_answer_and_what_is_missing_beside_it_is(kr90: Robot, tmp_path: Path) -> None:
    """The robot that a diagnosis has written lacks nothing; another law than the robot has is said to go."""
    options = ("--nominal", "--no-sag", "--postures", "2", "--spacing-hz", "0.5", "--lines", "45")
    campaign = recorded(tmp_path, "hardening_stiffness@joint2.z:cubic=1e13", *options)

    def told(effect: str, site: str, **values: float) -> Finding:
        law = Entry.model_validate({"effect": effect, "site": site, **values})
        robot = kr90.model_copy(update={"physics": [*kr90.physics, law]})
        return diagnose_campaign(campaign, robot, "c.h5", hold_out=[])

    found = told("hardening_stiffness", "joint2.z", cubic=1e13)
    assert found.word == "adequate"
    assert not found.missing
    assert found.none > 0.9
    for stage in ("as_given", "before", "after"):
        assert found.error[stage]["train"] < 1.5 * found.error["noise_floor"]
    assert [entry.effect for entry in found.robot.physics][-1] == "hardening_stiffness"
    other = told("backlash", "joint1.z", gap=1e-6)
    assert [missing.first.key for missing in other.missing] == ["hardening_stiffness@joint2.z"]
    assert not [entry for entry in other.robot.physics if entry.effect == "backlash"]
    assert any("backlash@joint1.z, as described, is not borne out" in warning for warning in other.warnings)


def test_an_effect_that_shows_in_force_levels_states_its_law() -> None:
    """None of the vocabulary is skipped in silence; one without a law, or with another's, says what it lacks."""
    assert {law.effect for law in amplitude_laws()} == {n for n, e in CATALOGUE.items() if "levels" in e.seen_in}

    class Silent(Effect):
        name, sites, parameters, seen_in = "silent", ("joint{i}.z",), (Play("gap", "rad"),), frozenset({"levels"})

    class Borrowed(Silent):
        amplitude_law = Gap()

    for effect, lack in ((Silent(), "expected an amplitude_law"), (Borrowed(), "expected 'silent', found 'backlash'")):
        with pytest.raises(ValueError, match=lack):
            register(effect)
    assert "silent" not in CATALOGUE
