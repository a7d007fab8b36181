"""A number of the description that is wrong is an answer where the model that has it as described misses the data."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_diagnose_hammer import recorded as hammer_test
from test_diagnose_logs import recorded as log_of

from twin.commands.diagnose import diagnose
from twin.diagnose import hammer
from twin.diagnose.borne_out import falls
from twin.diagnose.decide import Decision
from twin.diagnose.departures import far_off
from twin.diagnose.frf_off import off_description
from twin.diagnose.hammer import diagnose_campaign
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.next_test import WEIGH
from twin.diagnose.refit import NONE, descend
from twin.diagnose.torque import (
    _answer,
    _finding,
    _may_be_none,
    _or_presliding,
    base_system,
    diagnose_log,
    searched,
)
from twin.diagnose.torque_fit import base_fit
from twin.diagnose.torque_look import look
from twin.diagnose.torque_next import next_log
from twin.diagnose.torque_off import numbers_of_answer, taken_back, told
from twin.diagnose.torque_search import Search
from twin.diagnose.torque_suspects import log_suspects
from twin.diagnose.torque_system import with_wider
from twin.diagnose.verdict import Candidate, Finding, Missing
from twin.measure.motion_log import MotionLog
from twin.model.parameters import Parameter, independent
from twin.model.torque_signal import prepare
from twin.robot.description import Robot, load_robot


def answers(finding: Finding) -> list[str]:
    return [missing.first.key for missing in finding.missing]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> MotionLog:
    return log_of(tmp_path_factory.mktemp("log"))


def test_a_log_names_the_mass_that_is_wrong(log: MotionLog, kr90: Robot) -> None:
    """Half the forearm's: the error falls from that of the model with the described mass; its value is told."""
    given, true = kr90.model_copy(deep=True), kr90.links[2].mass
    assert true is not None
    given.links[2].mass = 0.5 * true
    finding = diagnose_log(log, given, "log.h5")
    assert (finding.word, answers(finding)) == ("named", ["parameter@link3.mass"])
    assert falls(finding)
    number = finding.missing[0].first.parameters["mass"]
    assert number["value"] == pytest.approx(true, rel=kr90.tolerances.mass)
    assert finding.robot.links[2].mass == pytest.approx(number["value"], rel=0.02)


def test_a_log_names_the_rotor_that_is_wrong(log: MotionLog, kr90: Robot) -> None:
    """A number that the base model has free: no prediction becomes better with its prior wider."""
    given, true = kr90.model_copy(deep=True), kr90.drives[0].rotor_inertia
    given.drives[0].rotor_inertia = 0.5 * true
    finding = diagnose_log(log, given, "log.h5")
    assert answers(finding) == ["rotor_inertia@joint1"]
    assert falls(finding)
    added = [entry for entry in finding.robot.physics if entry.effect == "rotor_inertia"]
    drive = finding.robot.drives[0]
    rotor = drive.rotor_inertia + sum(entry.values["inertia"] for entry in added) / drive.gear_ratio**2
    assert rotor == pytest.approx(true, rel=0.15)


@pytest.mark.slow
def test_a_log_whose_torque_has_a_gain_names_no_rotors(log: MotionLog, kr90: Robot) -> None:
    """Torque that turns the rotors is recorded with the same gain as that of the links."""
    runs = {name: replace(run, torque=0.85 * np.asarray(run.torque)) for name, run in log.runs.items()}
    finding = diagnose_log(replace(log, runs=runs), kr90, "log.h5")
    assert answers(finding) == ["parameter@torque_gain"]
    gain = finding.missing[0].first.parameters["torque_gain"]
    low, high = gain["interval90"]
    assert low < 0.85 < high
    turned = [drive.rotor_inertia for drive in finding.robot.drives]
    np.testing.assert_allclose(turned, [drive.rotor_inertia for drive in kr90.drives], rtol=0.05)


@pytest.mark.slow
def test_a_load_that_makes_no_prediction_better_is_one_of_two(tmp_path: Path, kr90: Robot) -> None:
    """It or the link that it is on: neither is more than half likely, and weighing tells."""
    log = log_of(tmp_path, "--effect", "payload@flange:mass=190,com=1.2|-0.1|0.1")
    prepared = prepare(log, kr90, "log.h5")
    search, suspects = searched(base_system(prepared), prepared, None, 1)
    assert [step.key for step in search.found] == ["payload@flange"]
    back = taken_back(search)
    assert back is not None
    finding = _finding(log, kr90, "log.h5", prepared, back, suspects, (), 1)
    (missing,) = finding.missing
    assert finding.word == "ambiguous"
    assert [missing.first.key, *(rival.key for rival, _ in missing.rivals)] == [
        "payload@flange",
        "parameter@link3.mass",
    ]
    assert max(missing.probability, *(p for _, p in missing.rivals)) < 0.5
    assert missing.first.parameters["mass"]["value"] == pytest.approx(190, rel=0.05)
    assert finding.next_test is not None
    assert "weigh" in finding.next_test["description"]
    assert falls(finding)


def test_a_load_with_more_evidence_comes_before_the_numbers_of_its_link(tmp_path: Path, kr90: Robot) -> None:
    """Runs kept aside may refuse the load, and numbers stand in for it: what is told is a body that can exist."""
    log = log_of(tmp_path, "--effect", "payload@flange:mass=190,com=1.2|-0.1|0.1")
    system = base_system(prepare(log, kr90, "log.h5"))
    some = [s for s in log_suspects(kr90, system.base.runs) if s.name == "payload@flange"]
    step = look(system, some, lambda count: None, 1)
    refused = Search(system, step, [step], system, base_fit(system), np.zeros(3), np.zeros(3))
    assert not step.accepted
    search = told(refused)
    (first,) = search.found
    load, numbers = first.decision.ranked
    assert (load.hypothesis.key, numbers.hypothesis.key) == ("payload@flange", "parameter@link3.mass")
    assert load.evidence() > numbers.evidence()
    assert search.stand_ins == (numbers.hypothesis,)
    (missing,) = _answer(search)[1]
    assert missing.first.parameters["mass"]["value"] == pytest.approx(190, rel=0.05)


@pytest.mark.parametrize("turned", [False, True])
def test_a_load_is_weighed_whichever_of_it_and_its_link_comes_first(kr90: Robot, turned: bool) -> None:
    """Not where both are loads: weighing does not tell on which link one hangs."""
    load, link, other = (
        Candidate(effect, site, 1.0, kr90, {})
        for effect, site in (("payload", "link2"), ("parameter", "link2.mass"), ("payload", "link3"))
    )
    first, rival = (link, load) if turned else (load, link)
    assert next_log(Missing(first, 0.5, ((rival, 0.5),), ""))["description"] == WEIGH
    assert next_log(Missing(load, 0.5, ((other, 0.5),), ""))["description"] != WEIGH


def test_loads_that_show_nothing_else_are_asked_beside_an_answer(monkeypatch: pytest.MonkeyPatch, kr90: Robot) -> None:
    """What only relieves the tension of a link is no answer, and stays the rival of that link's numbers."""
    shows, relieves, bare = (SimpleNamespace(robot=kr90) for _ in range(3))
    search = SimpleNamespace(base=bare, processes=1, lawless=lambda fit, sample: {})
    asked: list[object] = []

    def off_description(*arguments: object) -> None:
        asked.append(arguments[4])
        raise InterruptedError

    for name, stub in {
        "settle": [shows, relieves, bare], "that_show": [], "that_foretell": [shows], "missing_of": [],
        "in_doubt_of_size": shows, "all_predict": True, "given_up": False,
        "decide": Decision([shows], [0.98], 0.01, 0.01), "same_axes": {}, "judge": "named",  # type: ignore[list-item]
    }.items():  # fmt: skip
        monkeypatch.setattr(hammer, name, lambda *_, _told=stub, **__: _told)
    monkeypatch.setattr(hammer, "sifted", lambda decision, base: (decision, None))
    monkeypatch.setattr(hammer, "_or_its_link", lambda decision, settled, base: (decision, frozenset()))
    monkeypatch.setattr(hammer, "off_description", off_description)
    found, sample = SimpleNamespace(kept=[]), SimpleNamespace(recordings=[], repeat=1.0, band_hz=(5.0, 100.0))
    search.base.parameters = None
    with pytest.raises(InterruptedError):
        hammer._decided(kr90, search, sample, [], found, False, lambda: bare)  # type: ignore[arg-type]
    assert asked == [[shows, relieves]]


@pytest.mark.slow
def test_hammer_tests_name_the_spring_that_is_wrong(tmp_path: Path) -> None:
    """By five of its deviations; the warning is an answer now."""
    case = hammer_test(tmp_path)
    width = next(p.deviation for p in case.free if p.name == "joint3.z.stiffness")
    given = load_robot("kr90")
    assert given.axes[2].stiffness is not None
    given.axes[2].stiffness *= float(np.exp(5 * width))
    finding = diagnose_campaign(case.campaign, given, "c.h5", processes=2)
    assert (finding.word, answers(finding)) == ("named", ["parameter@joint3.z.stiffness"])
    assert falls(finding)
    assert not [note for note in finding.warnings if getattr(note, "sites", ()) == ("joint3.z.stiffness",)]


def test_two_springs_that_are_off_are_no_answer(tmp_path: Path) -> None:
    """Warnings tell both; neither, if it is free, brings the other back."""
    case = hammer_test(tmp_path)
    names = ("joint2.z.stiffness", "joint3.z.stiffness")
    items = tuple(replace(p, mean=p.mean * float(np.exp(6 * p.deviation))) if p.name in names else p for p in case.free)
    free = replace(case.free, items=items)
    z = free.coordinates(case.free.values(np.zeros(len(free))))
    fit = descend(case.base, NONE, free, case.sample, z)
    assert {free.names[k] for k, _, _ in far_off(fit)} == set(names)
    assert off_description(case.base, free, fit, fit, [], case.sample, case.found.kept) is None


def test_a_rotor_is_told_as_its_joint_feels_it(log: MotionLog, kr90: Robot) -> None:
    """By its effect's name: the inertia behind the gear that the description lacks."""
    given, true = kr90.model_copy(deep=True), kr90.drives[0].rotor_inertia
    given.drives[0].rotor_inertia = 0.5 * true
    system = base_system(prepare(log, given, "log.h5"))
    scale = (("drive1.rotor_inertia", 10.0),)
    hypothesis = Hypothesis("rotor_inertia", "joint1", scale=scale)
    wide = with_wider(system, hypothesis)
    numbers = numbers_of_answer(wide, base_fit(wide), hypothesis)["inertia"]
    assert numbers["value"] == pytest.approx(0.5 * true * kr90.drives[0].gear_ratio ** 2, rel=0.2)
    assert numbers["interval90"][0] < numbers["value"] < numbers["interval90"][1]


def test_a_filter_and_a_delay_differ_in_fast_torque(kr90: Robot) -> None:
    """Slow reversals, which tell memory from a delay, show both alike."""
    sites = (("torque_filter", "log"), ("time_delay", "log"), ("hysteresis", "joint1.z"))
    first, rival, slip = (Candidate(effect, site, 1.0, kr90, {}) for effect, site in sites)
    assert "jerk" in next_log(Missing(first, 0.7, ((rival, 0.3),), ""))["description"]
    assert "jerk" not in next_log(Missing(slip, 0.7, ((rival, 0.3),), ""))["description"]


def test_no_log_tells_slip_of_a_gear_from_presliding(kr90: Robot) -> None:
    """A brake does: it holds the rotor, and the gear still slips."""
    slip, rival = (
        Candidate(e, site, 1.0, kr90, {}) for e, site in (("hysteresis", "joint1.z"), ("presliding", "joint1"))
    )
    assert "brake" in next_log(Missing(slip, 0.5, ((rival, 0.5),), ""))["description"]


@pytest.mark.parametrize(("friction", "ambiguous"), [(60.0, True), (102.0, False)])
def test_slip_that_is_a_part_of_described_friction_may_be_presliding(
    kr90: Robot, friction: float, ambiguous: bool
) -> None:
    """100 N·m are described: 60 beside 38 of slip are as much; 102 beside 38 are more than that."""
    numbers = {"yield_torque": {"value": [38.0], "unit": "N·m", "interval90": [[35.0, 41.0]]}}
    slip = Missing(Candidate("hysteresis", "joint2.z", 500.0, kr90, numbers), 0.99, (), "")
    described = Parameter("coulomb_friction@joint2.torque", "N·m", "entry", False, 100.0, 20.0)
    settled: Any = SimpleNamespace(parameters=independent([described]), values=np.array([friction]))
    found = _or_presliding(slip, settled)
    assert [(c.key, p) for c, p in found.rivals] == ([("presliding@joint2", 0.495)] if ambiguous else [])
    assert found.probability == (0.495 if ambiguous else 0.99)
    assert _or_presliding(replace(slip, first=replace(slip.first, site="joint3.z")), settled).rivals == []


@pytest.mark.slow
def test_links_that_stand_for_a_missing_bearing_do_not_hide_it(tmp_path: Path) -> None:
    """A six-axis arm without a bearing: the base model has link 1 seven tolerances off, and two things are told for it.

    Screened where links are as described, the bearing comes fourth, and alone explains more than those two.
    """
    from tools.trials import wrong
    from tools.truth.wrong import record

    seed = 965412364  # of a case that was opened
    world, (effect,), without, _ = wrong.case("nothing", "hammer", "light", seed, True)
    record(world, tmp_path, np.random.default_rng([seed, 3]))
    wrong.write_description(world.machine, tmp_path / "light.yaml")
    found = diagnose(tmp_path / "frf.h5", robot=tmp_path / "light.yaml", without=without)
    assert [f"{e['effect']}@{e['site']}" for e in found.data()["effects"]] == [f"{effect.kind}@{effect.site}"]
    stiffness = found.data()["effects"][0]["parameters"]["stiffness"]
    assert stiffness["interval90"][0] < effect.parameters["stiffness"] < stiffness["interval90"][1]


@pytest.mark.slow
def test_rivals_are_relieved_of_what_the_best_does_without(tmp_path: Path) -> None:
    """A bearing that alone is likelier than a link that bends alone, which is likelier beside all nodes.

    The link had been relieved of the nodes and named with 0.99, and the bearing kept what they cost.
    """
    from tools.trials.cases import case
    from tools.trials.make import write_case

    found = case("single", "hammer", 1196373522, 253)  # of a split that was opened
    write_case(found, tmp_path)
    (effect,) = found.effects
    told = diagnose(tmp_path / "frf.h5", without=found.without).data()["effects"]
    assert [f"{e['effect']}@{e['site']}" for e in told] == [f"{effect.kind}@{effect.site}"]
    assert told[0]["probability"] > 0.9


@pytest.mark.parametrize(("low", "none"), [(-5e-4, True), (1e-4, False)])
def test_a_size_whose_interval_holds_none_has_no_name(kr90: Robot, low: float, none: bool) -> None:
    """Friction that follows the load stood with 0.99 beside a payload, its coefficient between -0.0005 and 0.0019."""
    size = Parameter("load_dependent_friction@joint2.coefficient", "1", "entry", False, 0.0, 0.1)
    suspect: Any = SimpleNamespace(sizes=(0,), hypothesis=SimpleNamespace(own=(size,)))
    numbers = {"coefficient": {"value": 7e-4, "unit": "1", "interval90": [low, 1.9e-3]}}
    assert _may_be_none(suspect, numbers) is none
