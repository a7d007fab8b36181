"""The trial itself: its mix, its seals and its scorer, on answers written by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.trials import make, score, store
from tools.trials.cases import MIX, case, plan
from tools.trials.score import Rate, Scored
from tools.trials.visible import scaled
from tools.truth.effects import Effect

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


def test_the_mix_is_as_promised() -> None:
    cases = plan(240, 1)
    for kind, share in MIX.items():
        assert abs(sum(k == kind for k, _, _ in cases) - 240 * share) <= 1
    assert plan(240, 1) == cases != plan(240, 2)


def test_what_a_recording_looks_like_does_not_depend_on_what_it_conceals() -> None:
    null, single = (case(kind, "log", 5, 3) for kind in ("none", "single"))
    assert null.truth.effects == ()
    assert len(single.truth.effects) == 1
    assert replace(null.log, link_encoder=False) == replace(single.log, link_encoder=False)  # type: ignore[type-var]
    assert [len(r.time) for r in null.runs] == [len(r.time) for r in single.runs]


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
    name, kind, recording, seed, number = drawn[0]
    line = make.record(tmp_path, name, kind, "log" if recording == "log" else "hammer", seed, number)
    assert set(line) == {"id", "without", "recording", "answer"}
    sealed = tmp_path / "answers" / f"{name}.json"
    assert store.sha256(sealed) == line["answer"]
    sealed.write_text(json.dumps({**store.read(sealed), "kind": "none"}))
    assert store.sha256(sealed) != line["answer"]
    assert len(store.opened(tmp_path, "first")) == 1
    assert len(store.opened(tmp_path, "second")) == 2


def test_probabilities_not_stated_are_nothing() -> None:
    found = one(answer("single", PAYLOAD), result("named", [("payload", "link1", 1.0)]))
    assert score.log_score(found) == pytest.approx(np.log(1000))
    assert score.brier(found) == 2.0
