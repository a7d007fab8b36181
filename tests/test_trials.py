"""The trial itself: its mix, its seals and its scorer, on answers written by hand."""

import json
import re
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from tools.trials import __main__ as trials
from tools.trials import ask, cases, make, real, reference, score, store, visible
from tools.trials.baselines import metadata
from tools.trials.cases import CANDIDATES, MIX, RECORDINGS, SITES, Case, _campaign, _candidates, case, plan, struck
from tools.trials.naive import best_correlated
from tools.trials.score import Rate, Scored
from tools.trials.visible import (
    SEEN,
    LogSignal,
    hammer_signal,
    kept,
    level_signal,
    multiple_of_visible,
    overlap,
    scaled,
)
from tools.truth import chain
from tools.truth.chain import Tolerances, flange_position, kr90
from tools.truth.effects import Effect
from tools.truth.recording import HammerTest, Posture, Truth, draw_postures, draw_truth, plain, write_campaign
from twin.identify.objective import Objective, Sample
from twin.measure.recordings import read_campaign
from twin.model.parameters import free_parameters
from twin.model.recorded import prepare, without_limits
from twin.robot.description import load_robot

ERROR = {
    "before": {"train": 0.2, "held_out": 0.2}, "after": {"train": 0.1, "held_out": 0.11}, "noise_floor": 0.1,
}  # fmt: skip


def answer(kind: str = "single", *effects: tuple[str, str, float]) -> dict:  # type: ignore[type-arg]
    listed = [{"effect": e, "site": s, "parameters": {"mass": 10.0}, "multiple": m} for e, s, m in effects]
    return {"kind": kind, "recording": "hammer", "effects": listed}


def result(verdict: str, *groups: list[tuple[str, str, float]], none: float = 0.0, other: float = 0.0) -> dict:  # type: ignore[type-arg]
    effects = [
        {
            "effect": g[0][0], "site": g[0][1], "probability": g[0][2],
            "alternatives": [{"effect": e, "site": s, "probability": p} for e, s, p in g[1:]],
            "parameters": {"mass": {"value": 9.0, "unit": "kg", "interval90": [8.0, 11.0]}},
        }
        for g in groups
    ]  # fmt: skip
    diagnosis = {"verdict": verdict, "effects": effects, "probabilities": {"none": none, "other": other},
                 "error": ERROR, "location": [{"site": "joint2.z"}]}  # fmt: skip
    return {"id": "x", "diagnosis": diagnosis, "edit_error": None, "wall_s": 1.0}


def one(truth: dict, said: dict) -> Scored:  # type: ignore[type-arg]
    return score.scored(truth, said)


PAYLOAD = ("payload", "flange", 3.0)


def test_the_right_name_first() -> None:
    found = one(answer("single", PAYLOAD), result("named", [("payload", "flange", 0.9), ("payload", "link2", 0.05)]))
    assert found.top1
    assert found.top3
    assert found.exact
    assert found.credible == ["payload@flange"]
    assert found.intervals == {"payload@flange.mass": (8.0, 11.0)}
    assert score.headline([found])["held-out gain over the true model's"] == pytest.approx(0.9)


def test_a_payload_on_the_last_link_is_one_at_the_flange() -> None:
    found = one(answer("single", ("payload", "link3", 3.0)), result("named", [("payload", "flange", 0.9)]))
    assert found.top1
    assert found.intervals


def test_an_alias_counts_only_with_the_truth_beside_it() -> None:
    truth = answer("single", PAYLOAD)
    alone = one(truth, result("named", [("parameter", "link3.mass", 0.9)]))
    beside = one(truth, result("ambiguous", [("parameter", "link3.mass", 0.5), ("payload", "flange", 0.45)]))
    stranger = one(truth, result("ambiguous", [("payload", "link1", 0.5), ("payload", "flange", 0.45)]))
    assert not alone.top1
    assert beside.top1
    assert not stranger.top1
    assert stranger.top3


def test_a_name_on_a_null_is_a_false_alarm_and_a_crash_says_nothing() -> None:
    null = answer("none")
    quiet = one(null, result("adequate", none=0.98, other=0.02))
    alarm = one(null, result("named", [("payload", "flange", 0.9)], none=0.1))
    crash = one(null, {"id": "y", "diagnosis": None, "wall_s": 1.0})
    found = score.headline([quiet, alarm, crash])
    assert (found["false alarms"].k, found["false alarms"].n, found["failed"].k) == (1, 3, 1)
    assert score.claim(quiet) == (True, 0.98)
    assert score.claim(alarm) == (False, 0.9)


def test_sets_are_exact_or_not() -> None:
    both = answer("pair", PAYLOAD, ("base_compliance", "base.rx", 4.0))
    groups = [("base_compliance", "base.rx", 0.9)], [("payload", "flange", 0.8)]
    assert one(both, result("named", *groups)).exact
    assert not one(both, result("named", groups[0])).exact
    assert not one(both, result("named", *groups, [("payload", "link1", 0.7)])).exact


def test_base_and_joint_1_tilt_alike_only_with_one_q1() -> None:
    truth = answer("single", ("base_compliance", "base.rx", 5.0))
    said = result("ambiguous", [("transverse_compliance", "joint1.x", 0.5), ("base_compliance", "base.rx", 0.45)])
    assert not one(truth, said).top1
    assert one({**truth, "circumstances": {"same_q1": True}}, said).top1


def test_every_wrong_answer_has_its_class() -> None:
    single, null, pair = answer("single", PAYLOAD), answer("none"), answer("pair", PAYLOAD, ("x", "joint1", 4.0))
    name = [("payload", "link1", 0.9)]
    assert score.fault(one(single, result("named", name))) == "right effect, wrong site"
    assert score.fault(one(single, result("named", [("x", "joint1", 0.9)]))) == "wrong name"
    assert score.fault(one(single, result("adequate"))) == "not seen"
    assert score.fault(one(null, result("named", name))) == "false alarm"
    assert score.fault(one(null, result("adequate"))) == ""
    assert score.fault(one(pair, result("named", [("payload", "flange", 0.9)]))) == "pair: one missed"
    assert score.fault(one(answer("outside", ("y", "joint1", 3.0)), result("located"))) == ""


def test_an_error_for_each_of_two_recordings() -> None:
    error = {"before": {"held_out": {"a": 0.2, "b": 0.1}}, "after": {"held_out": {"a": 0.1, "b": 0.1}},
             "noise_floor": {"a": 0.1, "b": 0.1}}  # fmt: skip
    said = result("named", [("payload", "flange", 0.9)])
    said["diagnosis"]["error"] = error
    assert score.headline([one(answer("single", PAYLOAD), said)])["held-out gain over the true model's"] == 1.0


def test_faint_effects_do_not_count_against_the_rates() -> None:
    faint = one(answer("single", ("payload", "flange", 1.5)), result("adequate", none=0.9))
    found = score.headline([faint])
    assert found["top-1 (above twice visible)"].n == 0
    assert [r.n for _, r, _ in score.power([faint])] == [1, 0, 0, 0, 0]


def test_rates_and_calibration_by_hand() -> None:
    low, high = Rate(0, 60).interval
    assert low == 0
    assert high == pytest.approx(0.0602, abs=1e-4)
    error, curve = score.calibration([(True, 0.9)] * 9 + [(False, 0.9)])
    assert error == pytest.approx(0, abs=1e-9)
    assert curve[0][1].n == 10
    assert score.calibration([(False, 0.95)] * 4)[0] == pytest.approx(0.95)
    assert score.by_chance([0.9] * 10) == pytest.approx(0.2)  # at most two wrong in 93 % of splits, three in 99 %


def test_the_mix_is_as_promised() -> None:
    cases = plan(240, 1)
    for kind, share in MIX.items():
        assert abs(sum(k == kind for k, *_ in cases) - 240 * share) <= 1
    for recording in RECORDINGS:
        assert any(r == recording for k, r, *_ in cases if k == "none")
        met = {_candidates(k, recording, n, np.random.default_rng(s))[0].kind
               for k, r, s, n in cases if (k, r) == ("single", recording)}  # fmt: skip
        assert met == set(SITES[recording])  # all effects
    assert plan(240, 1) == cases != plan(240, 2)


def test_every_effect_so_often_alone_and_the_rest_in_proportion() -> None:
    cases = plan(1, 3, ("hammer", "levels"), each=6)
    for recording in ("hammer", "levels"):
        alone = [_candidates(k, recording, n, np.random.default_rng(s))[0].kind
                 for k, r, s, n in cases if (k, r) == ("single", recording)]  # fmt: skip
        assert {kind: alone.count(kind) for kind in SITES[recording]} == dict.fromkeys(SITES[recording], 6)
    assert {r for _, r, *_ in cases} == {"hammer", "levels"}
    assert sum(k == "none" for k, *_ in cases) == pytest.approx(len(cases) / 4, abs=1)


@pytest.mark.slow
def test_sizes_are_those_asked_for() -> None:
    found = [case("single", "log", seed, seed, (2.0, 2.5)).multiples[0] for seed in range(40, 44)]
    assert all(2.0 <= multiple <= 2.5 for multiple in found)


def test_the_temperature_undoes_what_was_claimed_too_surely() -> None:
    """Probabilities of 0.9 of which nine in ten are right, sharpened by the power three and softened again."""
    claimed = 0.9**3 / (0.9**3 + 0.1**3)
    sure = result("named", [("payload", "flange", claimed)], none=1 - claimed)
    cases = [one(answer("single", PAYLOAD), sure)] * 9 + [one(answer("none"), sure)]
    factor, losses, errors = score.temperature(cases)
    assert factor == pytest.approx(3.0, rel=0.05)
    assert losses[1] < losses[0]
    assert errors[1] < 0.02 < errors[0]


def test_pairs_are_two_effects_that_a_recording_can_show_together() -> None:
    rng = np.random.default_rng(0)
    for number in range(60):
        found = _candidates("pair", "hammer", number, rng)
        assert len(found) in (2, 1 + CANDIDATES)
        assert all(e.site != found[0].site or "." not in e.site for e in found[1:])


def test_a_null_lies_within_what_the_description_states() -> None:
    """Else an alarm would be the trial's fault."""
    stated, drawn = load_robot("kr90").tolerances, Tolerances()
    for name in ("mass", "com", "inertia", "posture_deg"):
        assert getattr(drawn, name) <= getattr(stated, name)
    assert drawn.gain <= stated.channel_gain
    chain = kr90()
    for kind in ("none", "single"):
        found = case(kind, "log", 11, 0).motion
        assert found is not None
        for link, true in zip(chain.links, found.truth.chain.links, strict=True):
            assert abs(true.mass / link.mass - 1) <= stated.mass
            assert np.abs(true.com - link.com).max() <= stated.com


def test_postures_are_reached_and_differ() -> None:
    chain, q1 = kr90(), []
    for seed in range(30):
        campaign, _ = _campaign("hammer", seed, [], np.random.default_rng([seed, 2]), False)
        q = np.deg2rad([p.q_deg for p in campaign.postures])
        assert np.all((q > chain.range_[:, 0]) & (q < chain.range_[:, 1]))
        tip = np.array([flange_position(chain, x) for x in q])
        own = tip[3:, 2]  # after the three of the paper
        assert np.all((own > chain.workspace[2, 0]) & (own < chain.workspace[2, 1]))
        assert len(np.unique(q, axis=0)) == len(q) >= 6
        q1.append(np.ptp(q[:, 0]) > 0)
    assert 0.5 < np.mean(q1) < 1  # now and then one q₁ for all


def test_what_a_recording_looks_like_does_not_depend_on_what_it_conceals() -> None:
    null, single = (case(kind, "log", 5, 3).motion for kind in ("none", "single"))
    assert null is not None
    assert single is not None
    assert null.truth.effects == ()
    assert len(single.truth.effects) == 1
    assert replace(null.log, link_encoder=False) == replace(single.log, link_encoder=False)
    assert [len(r.time) for r in null.runs] == [len(r.time) for r in single.runs]


def test_an_effect_hides_itself_and_half_of_it_doubles() -> None:
    campaign, _ = _campaign("hammer", 3, [], np.random.default_rng(1), False)
    campaign = replace(campaign, postures=(Posture("a", (10.0, 80.0, -90.0)),),
                       truth=replace(campaign.truth, posture_error={"a": np.zeros(3)}))  # fmt: skip
    signal = hammer_signal(campaign.postures, campaign.test, campaign.points)
    load = Effect("payload", "flange", {"mass": 10.0, "com": [1.6, 0.0, 0.0]})
    less = Effect("payload", "flange", {"mass": -5.0, "com": [1.6, 0.0, 0.0]})
    assert overlap(load, load, campaign.truth, signal) == pytest.approx(1)
    assert overlap(load, less, campaign.truth, signal) == pytest.approx(-1, abs=1e-3)


def test_sizes_scale_as_their_signature_does() -> None:
    soft = scaled(Effect("base_compliance", "base.rx", {"stiffness": 1e8, "damping": 1e4}), 4.0)
    assert soft.parameters == {"stiffness": 2.5e7, "damping": 2.5e3}
    assert scaled(Effect("sensor_gain", "sensor:21X+", {"gain": 1.02}), 5.0)["gain"] == pytest.approx(1.1)


def test_answers_are_sealed_and_openings_counted(tmp_path: Path) -> None:
    drawn = make.prepare(tmp_path, 4, None)
    assert make.prepare(tmp_path, 4, None) == drawn  # an interrupted run goes on with the same cases
    again = make.prepare(tmp_path / "other", 4, None)
    assert {c[0] for c in drawn}.isdisjoint(c[0] for c in again)
    assert drawn != again
    name, kind, _, seed, number, _ = drawn[0]
    line = make.record(tmp_path, name, kind, "log", seed, number)
    assert set(line) == {"id", "without", "files", "answer"}
    assert set(line["files"]) == {"log.h5"}
    sealed = tmp_path / "answers" / f"{name}.json"
    assert store.sha256(sealed) == line["answer"]
    sealed.write_text(json.dumps({**store.read(sealed), "kind": "none"}))
    assert store.sha256(sealed) != line["answer"]
    assert len(store.entered(tmp_path, "first")) == 1
    assert len(store.entered(tmp_path, "second")) == 2


def test_a_beam_has_no_stiffness_of_a_hinge() -> None:
    hinge = answer("single", ("payload", "flange", 3.0))
    beam = answer("single", ("payload", "flange", 3.0))
    beam["effects"][0]["parameters"]["segments"] = 5
    said = result("named", [("payload", "flange", 0.9)])
    assert score.scored(hinge, said).intervals
    assert not score.scored(beam, said).intervals


def test_probabilities_not_stated_are_nothing() -> None:
    found = one(answer("single", PAYLOAD), result("named", [("payload", "link1", 1.0)]))
    assert score.log_score(found) == pytest.approx(np.log(1000))
    assert score.brier(found) == 2.0


def small(kind: str, recording: str, seed: int, number: int, sizes: tuple[float, float]) -> Case:
    """A case as the trial's, but short."""
    found = case(kind, recording, seed, number, sizes)  # type: ignore[arg-type]
    if found.campaign:
        c = found.campaign
        test = replace(c.test, lines=48)
        found = replace(found, campaign=replace(c, postures=c.postures[:3], points=c.points[:5], test=test))
    if found.motion:
        runs = tuple(replace(r, time=r.time[: 15 * 250]) for r in found.motion.runs[:2])
        found = replace(found, motion=replace(found.motion, runs=runs))
    return found


@pytest.mark.slow
def test_two_cases_from_recording_to_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command, asked blindly about a null of each kind, names nothing, and the page tells it."""
    monkeypatch.setattr(make, "case", small)
    lines = [make.record(tmp_path, f"0{k}", "none", kind, 40 + k, 0) for k, kind in enumerate(("hammer", "log"))]
    store.write(tmp_path / "manifest.json", {"format": "twin-trials", "version": 2, "sizes": [1, 30], "cases": lines})
    assert not ask.ask(tmp_path, "00", [], deadline=0.0)  # no time left
    assert all(ask.ask(tmp_path, line["id"], line["without"]) for line in lines)
    trials._score(tmp_path, tmp_path / "proof.md")
    text = (tmp_path / "proof.md").read_text()
    assert "| false alarms | 0/2" in text
    assert "| failed | 0/2" in text
    assert len(store.read(tmp_path / "ledger.json")) == 1
    assert metadata(tmp_path / "recordings" / "00")[0] == 1
    assert "@" in best_correlated(tmp_path / "recordings" / "01", lines[1]["without"])


def test_a_command_that_crashes_or_hangs_is_an_answer(tmp_path: Path) -> None:
    (tmp_path / "recordings" / "00").mkdir(parents=True)
    (tmp_path / "recordings" / "00" / "log.h5").write_bytes(b"nothing")
    assert ask.ask(tmp_path, "00", [])
    said = store.read(tmp_path / "results" / "00.json")
    assert said["code"] != 0
    assert "log.h5" in said["complaint"]
    assert one(answer("none"), said).verdict == "failed"
    code, _, complaint = ask.run(["diagnose", "--help"], 0.05)
    assert code == 124
    assert "no answer within" in complaint


def test_measured_recordings_are_told_without_their_paths(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time,q1\n0,0\n")
    (tmp_path / "list.yaml").write_text("- {name: A log, recordings: [log.csv], known: nothing}\n")
    said = real.asked(tmp_path / "list.yaml", 60)
    text = real.page(said)
    assert "## A log" in text
    assert "No answer" in text
    assert str(tmp_path) not in text
    effects = result("named", [("payload", "flange", 0.9), ("payload", "link2", 0.05)])["diagnosis"]["effects"]
    filled = {"verdict": "named", "probabilities": {"none": 0.01, "other": 0.02}, "error": ERROR, "effects": effects}
    said["rows"][0]["diagnosis"] = filled
    text = real.page(said)
    assert "payload@flange 90 %" in text
    assert "| with the answer | 0.1 | 0.11 |" in text


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "expected a list of recordings"),
        ("- {name: [", "not valid YAML"),
        ("name: A log", "expected a list of items"),
        ("- {name: A log}", r"\[0\]"),
        ("- {name: A log, recordings: log.csv}", r"\[0\].recordings"),
        ("- {name: A log, recordings: [log.csv], robots: x}", r"\[0\].robots"),
    ],
)
def test_a_list_that_is_none_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, told: str
) -> None:
    listed = tmp_path / "list.yaml"
    if content is not None:
        listed.write_text(content)
    with pytest.raises(SystemExit) as stopped:
        trials.main(["real", str(listed), "--page", str(tmp_path / "real.md")])
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert said.count("\n") == 1
    assert "list.yaml" in said
    assert re.search(told, said)
    assert not (tmp_path / "real.md").exists()


@pytest.mark.parametrize(
    "words",
    [["make", "--cases", "-3"], ["run", "--limit", "0"], ["run", "--processes", "x"], ["real"], ["run", "list"]],
)
def test_options_out_of_range_are_refused_by_the_parser(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        trials.main(words)
    assert stopped.value.code == 2
    assert "expected" in capsys.readouterr().err


def test_out_of_memory_is_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A case that wants more than it may have has failed, with a reason, and the next one is asked."""
    (tmp_path / "recordings" / "00").mkdir(parents=True)
    monkeypatch.setattr(ask, "MEMORY_BYTES", 2**27)
    assert ask.ask(tmp_path, "00", [])
    said = store.read(tmp_path / "results" / "00.json")
    assert said["code"] != 0
    found = one(answer("none"), said)
    assert found.verdict == "failed"
    assert found.complaint


def test_results_of_another_engine_are_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(tmp_path / "manifest.json", {"cases": [{"id": f"0{k}", "without": [], "files": {}} for k in range(3)]})
    store.write(tmp_path / "results" / "00.json", {"engine": store.engine_hash()})
    store.write(tmp_path / "results" / "01.json", {"engine": "older"})
    asked: list[str] = []
    monkeypatch.setattr(ask, "ask", lambda split, name, *_: asked.append(name) or True)
    with ThreadPoolExecutor(1) as pool:
        trials._run(tmp_path, 1.0, None, pool)
    assert sorted(asked) == ["01", "02"]


def test_the_error_left_is_told_over_the_noise_floor() -> None:
    found = score.headline([one(answer("single", PAYLOAD), result("named", [("payload", "flange", 0.9)]))])
    assert found["held-out error over its noise floor, median"] == pytest.approx(1.1)
    assert str(found["held-out error ≤ 1.25 × its noise floor"]).startswith("1/1")


def test_the_error_left_is_told_over_the_true_models() -> None:
    found = result("named", [("payload", "flange", 0.9)])
    cases = [score.scored(answer("single", PAYLOAD), found, reference) for reference in (None, 0.02, 0.005)]
    after = found["diagnosis"]["error"]["after"]["held_out"]
    assert score.over_reference(cases[0]) is None
    assert score.over_reference(cases[1]) == pytest.approx(after / 0.02)
    assert score.headline(cases)["held-out error ≤ 1.25 × the true model's"].n == 2


def test_a_true_model_is_what_the_vocabulary_can_say() -> None:
    known = {"effect": "backlash", "site": "joint1.z", "parameters": {"gap": 1e-5}}
    beam = {"effect": "link_flexibility", "site": "link1.y", "parameters": {"stiffness": 1e7, "segments": 5}}
    drag = {"effect": "eddy_current_damper", "site": "joint1.z", "parameters": {"coefficient": 1.0}}
    assert [(e.effect, e.site, e.values) for e in reference.described([known], {}) or []] == [
        ("backlash", "joint1.z", {"gap": 1e-5})
    ]
    assert reference.described([], {}) == []
    assert reference.described([beam], {}) is None
    assert reference.described([known, drag], {}) is None


def test_a_reference_starts_at_the_robot_that_was_struck(tmp_path: Path) -> None:
    postures = draw_postures(3, np.random.default_rng(1))
    hidden = (
        Effect("transverse_compliance", "joint2.y", {"stiffness": 2e7, "damping": 50.0}),
        Effect("servo_compliance", "joint2", {"stiffness": 2e6, "damping": 80.0}),
    )
    truth = draw_truth(11, (), postures, Tolerances())
    truth.chain.stiffness[1, 2] = np.inf
    truth = replace(truth, effects=hidden)
    exact = HammerTest(lines=40, noise=1e-9, scatter=1e-7)
    write_campaign(tmp_path / "frf.h5", truth, postures, exact, np.random.default_rng(2))
    robot = load_robot("kr90").without(["transverse_compliance@joint2.y"])
    entries = reference.described(
        [{"effect": e.kind, "site": e.site, "parameters": e.parameters} for e in hidden], plain(truth.chain)
    )
    robot = without_limits(robot.model_copy(update={"physics": [*robot.physics, *(entries or [])]}))
    used = list(prepare(read_campaign(tmp_path / "frf.h5"), robot, "").values())
    free = free_parameters(robot, [p.name for p in postures], used[0].setup.response.label)
    values = reference.true_values(free, plain(truth))
    predicted = Objective(robot, free, Sample(tuple(used))).predicted(free.coordinates(values))
    for r, H in zip(used, predicted, strict=True):
        np.testing.assert_allclose(H, r.frf, atol=1e-5 * float(np.abs(r.frf).max()))


def test_how_a_case_is_struck_is_known_without_sizing_its_effects() -> None:
    drawn = case("none", "levels", 5, 0).campaign
    assert drawn is not None
    assert struck("none", "levels", 5, 0) == drawn.test


def test_what_was_written_by_hand_stays_and_tells_its_engine(tmp_path: Path) -> None:
    page = tmp_path / "proof.md"
    assert store.reading(page, ["a" * 16]) == store.before(page) == []
    store.write_text(tmp_path / "proof" / "reading.md", f"<!-- engine {'a' * 16}, commit abc -->\nNulls are noisy.\n")
    store.write_text(tmp_path / "proof" / "before.md", "What was.\n")
    same, older = ("\n".join(store.reading(page, [engine * 16])) for engine in "ab")
    assert same.startswith(f"## Reading of the failures: engine {'a' * 16}, commit abc\n\nNulls are noisy.")
    assert "\n".join(store.before(page)) == "## Engines before\n\nWhat was.\n"
    assert "another engine" in older
    assert "Nulls are noisy." in older


def test_play_that_gravity_presses_to_one_side_has_no_size() -> None:
    """Such a case is drawn again; play in a joint about the vertical shows, and twice the smallest shows more."""
    campaign, _ = _campaign("levels", 5, [], np.random.default_rng([5, 2]), False)
    postures = campaign.postures[:1]
    test = replace(campaign.test, lines=20, spacing_hz=1.0, levels_n=(100.0, 600.0))
    signal, truth = level_signal(postures, test, campaign.points[:3]), campaign.truth
    shut, loose = (Effect("backlash", f"joint{i}.z", {"gap": 5e-5}) for i in (2, 1))
    with pytest.raises(ValueError, match="some size"):
        multiple_of_visible(shut, truth, signal, 2.0, project=False)
    seen = multiple_of_visible(loose, truth, signal, 1.0, project=False)
    energy = 0.5 * float(np.sum(signal(replace(truth, effects=(seen,))) ** 2))
    assert SEEN <= energy < 1.5 * SEEN


def test_a_way_to_a_size_that_needs_too_many_steps_is_given_up() -> None:
    """Such an effect is drawn again: one whose refits show as the sixth power of its size took a quarter of an hour."""
    asked: list[float] = []

    def fit(factor: float, starts: Sequence[np.ndarray]) -> visible._Fit:
        asked.append(factor)
        return visible._Fit(factor, starts[0], 1e12 * factor**6, 0.0)

    start = visible._Fit(visible.STEP, np.zeros(1), SEEN * visible.STEP**2, 0.0)
    with pytest.raises(ValueError, match="fewer steps"):
        visible._Path(fit, np.zeros(1), [start]).to(50.0)
    assert len(asked) == visible.MOST_FITS


def test_what_a_softer_neighbour_imitates_shows_by_its_tolerance_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring c in series with one of k: data tell 1/k + c alone. What shows is ½ (log(1 + kc)/w)², of which the
    derivative would make ½ (kc/w)²."""
    width, multiple = np.log(1.3), 1.5
    truth = draw_truth(3, (), (Posture("a", (0.0, 80.0, -90.0)),))

    def soften(truth: Truth, z: float) -> Truth:
        stiffness = truth.chain.stiffness * np.exp(width * z)
        return replace(truth, chain=replace(truth.chain, stiffness=stiffness))

    def signal(truth: Truth) -> np.ndarray:
        compliance = 1 / truth.chain.stiffness[0, 0] + sum(1 / e["stiffness"] for e in truth.effects)
        return np.array([1e4 * np.log(compliance), 0.0])

    monkeypatch.setattr(visible, "_nuisances", lambda *_: [visible.Nuisance(soften, width)])
    k = float(truth.chain.stiffness[0, 0])
    seen = multiple_of_visible(
        Effect("base_compliance", "base.rz", {"stiffness": k, "damping": 0.0}), truth, signal, multiple
    )
    shown = 0.5 * (np.log1p(k / seen["stiffness"]) / width) ** 2
    assert shown == pytest.approx(SEEN * multiple**2, rel=visible.NEAR - 1)
    assert k / seen["stiffness"] > 2 * np.sqrt(2 * SEEN) * multiple * width


def test_what_a_refit_leaves_is_what_scipy_leaves_with_fewer_derivatives() -> None:
    """Springs in series, seen through noise: bent, and far from the start."""
    rng = np.random.default_rng(5)
    A, seen = rng.normal(size=(60, 8)), 30 * rng.normal(size=60)
    asked = []

    def residual(z: np.ndarray) -> np.ndarray:
        return np.concatenate([40 * np.tanh(A @ np.exp(0.6 * z) / 8) - seen, z])

    def slopes(z: np.ndarray) -> np.ndarray:
        asked.append(z)
        inside = A @ np.exp(0.6 * z) / 8
        bent = 40 * (1 / np.cosh(inside) ** 2)[:, None] * A * 0.6 * np.exp(0.6 * z) / 8
        return np.vstack([bent, np.eye(8)])

    (_, found), mine = visible._least(residual, slopes, np.zeros(8)), len(asked)
    asked.clear()
    known = least_squares(residual, np.zeros(8), slopes, ftol=1e-10)
    assert float(found @ found) == pytest.approx(2 * known.cost, rel=2 * visible.FITTED)
    assert mine < len(asked)


def test_a_resonance_is_followed_beyond_its_width() -> None:
    """An effect moves a peak by thirty times its width, a spring moves it back: only the spring's tolerance shows."""
    f, width = np.linspace(2.0, 12.0, 2001), 0.1

    def peak(squared: float) -> np.ndarray:
        return np.asarray(20 / (100 * squared - f**2 + 0.2j * f))

    def fit(factor: float, starts: Sequence[np.ndarray]) -> visible._Fit:
        def residual(z: np.ndarray) -> np.ndarray:
            left = peak(np.exp(width * z[0])) - peak((1 + factor) ** -2)
            return np.concatenate([left.view(float), z])

        def slopes(z: np.ndarray) -> np.ndarray:
            return (residual(z + 1e-6) - residual(z - 1e-6))[:, None] / 2e-6

        z, r = visible._least(residual, slopes, min(starts, key=lambda z: float(np.sum(residual(z) ** 2))))
        return visible._Fit(factor, z, 0.5 * float(r @ r), 0.0)

    small = fit(1e-6, [np.zeros(1)])
    path = visible._Path(fit, np.array([width]), [small])
    shown = 0.5 * (2 * np.log(2.5) / width) ** 2
    assert path.to(1.5).shown == pytest.approx(shown, rel=0.05)
    assert fit(1.5, [path._grown(small.z, 1.5 / 1e-6)]).shown > 2 * shown  # in one step from its beginning


def test_a_size_that_no_fit_reaches_is_refused() -> None:
    def stuck(factor: float, starts: Sequence[np.ndarray]) -> visible._Fit:
        return visible._Fit(factor, starts[0], SEEN * (1 if factor < 0.3 else 1e6) * (factor / 0.1) ** 2, 0.0)

    small = visible._Fit(1e-6, np.zeros(1), SEEN * 1e-10, 0.0)
    path = visible._Path(stuck, np.zeros(1), [small])
    assert path.to(0.2).shown == pytest.approx(4 * SEEN)
    with pytest.raises(ValueError, match="follow"):
        path.to(1.0)


def test_cross_products_are_numpys() -> None:
    rng = np.random.default_rng(0)
    for a, b in (((3,), (3,)), ((7, 3), (3,)), ((4, 1, 3), (5, 3))):
        x, y = rng.normal(size=a), rng.normal(size=b)
        assert np.allclose(chain.cross(x, y), np.cross(x, y), rtol=0, atol=1e-14)
    x, y = rng.normal(size=(2, 3))
    assert np.allclose(chain.skew(x) @ y, np.cross(x, y), rtol=0, atol=1e-14)


def test_no_size_is_drawn_from_a_channel_that_tells_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = (_campaign("hammer", seed, [], np.random.default_rng([seed, 2]), False)[0] for seed in range(40))
    campaign = next(c for c in drawn if c.dead is not None)
    assert set(campaign.live) == set(campaign.points) - {campaign.dead}
    asked: list[tuple[int, ...]] = []
    monkeypatch.setattr(cases, "hammer_signal", lambda postures, test, points: asked.append(tuple(points)))
    monkeypatch.setattr(cases, "multiple_of_visible", lambda effect, *_, **__: effect)
    monkeypatch.setattr(cases, "kept", lambda *_: 0.0)
    load = Effect("payload", "flange", {})
    cases._sized([load], campaign, None, (2.0, 6.0), np.random.default_rng(0))
    assert asked == [campaign.live]
    brief = replace(campaign, postures=campaign.postures[:1])
    make._strike(brief, 1, tmp_path / "frf.h5", np.random.default_rng(0))
    (posture,) = read_campaign(tmp_path / "frf.h5").postures.values()
    size = np.median(np.abs(posture.frf), axis=(0, 1))  # a blow across the arm's plane gives noise there, too: faint
    noise = (np.max(posture.coherence, axis=(0, 1)) < 0.31) & (size > 0.1 * np.median(size))
    assert [campaign.points[k] for k in np.flatnonzero(noise)] == [campaign.dead]


@pytest.mark.slow
def test_a_recording_keeps_less_of_a_load_than_its_description_betrays() -> None:
    """Mass, centre and inertia of a forearm make up for most of a load on it, if they may be as far off."""
    drawn = cases.case("single", "log", 101, 8, (2.0, 6.0))
    assert drawn.kept == pytest.approx(SEEN * drawn.multiples[0] ** 2, rel=0.1)  # ripple, which nothing makes up for
    assert drawn.motion is not None
    truth = replace(drawn.motion.truth, effects=())
    signal = LogSignal(drawn.motion.runs[:2], drawn.motion.log)
    load = multiple_of_visible(Effect("payload", "flange", {"mass": 20.0, "com": [0.1, 0.0, 0.1]}), truth, signal, 3.0)
    assert 0 <= kept(load, truth, signal) < 0.5 * SEEN * 3.0**2


def test_a_constant_torque_while_an_axis_moves_is_taken_for_an_offset() -> None:
    """What a motor has at rest nobody knows, so a constant while it moves is the offset of a current sensor."""
    drawn = cases.case("single", "log", 101, 8, (2.0, 6.0))
    assert drawn.motion is not None
    signal = LogSignal(drawn.motion.runs[:2], drawn.motion.log)
    sound = replace(drawn.motion.truth, effects=())

    def shown(**values: float) -> float:
        effect = Effect(
            "asymmetric_friction", "joint2", {"torque_difference": 0.0, "viscous_difference": 0.0, **values}
        )
        change = signal(replace(sound, effects=(effect,))) - signal(sound)
        return 0.5 * float(change @ change)

    assert shown(torque_difference=40.0) < 0.01 * shown(viscous_difference=40.0)  # axes turn at about 1 rad/s


def test_a_cluster_without_dask_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit, match="expected Dask"), trials.executor(1, "tcp://localhost:8786"):
        pass
