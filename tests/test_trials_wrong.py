"""Worlds that are not as described: what the ways do is what they say, and answers are judged for what they are."""

import json
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.signal import csd, welch

from tools.trials import __main__ as trials
from tools.trials import arms_score, store, wrong
from tools.trials.visible import hammer_signal, shows
from tools.trials.wrong_score import by_number, headline, judged
from tools.truth.chain import inverse_dynamics, kr90
from tools.truth.effects import Effect
from tools.truth.elastic import assemble
from tools.truth.recording import accelerance
from tools.truth.robots import machines, write_description
from tools.truth.wrong import LACKING_NOTHING, WAYS, World, record
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.robot.description import load_robot
from twin.robot.mechanism import assemble as mechanism

SEED = 7


def made(room: Path, way: str, recording: str, robot: str = "arm") -> World:
    """A short case of a way, recorded, with the random numbers of any other way's."""
    world, _, _, _ = wrong.case(way, recording, robot, SEED, False)
    if recording == "log":
        world.runs = tuple(replace(run, time=run.time[:2000]) for run in world.runs[:2])
    record(world, room, np.random.default_rng(SEED))
    return world


def read(path: Path) -> dict[str, Any]:
    """Every dataset of a file by its path."""
    found: dict[str, Any] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


@pytest.mark.parametrize("name", ["arm", "column"])
def test_the_other_robots_are_described_as_they_are(tmp_path: Path, name: str) -> None:
    """The twin, from the description alone, has the modes that the truth code has."""
    machine = machines()[name]
    write_description(machine, tmp_path / "robot.yaml")
    robot = load_robot(str(tmp_path / "robot.yaml"))
    q = np.deg2rad(machine.postures(1, np.random.default_rng(3))[0].q_deg)
    true, *_ = assemble(machine.chain, q, brakes_on=True, sag=False).modes()
    found = modes(linearise(mechanism(robot, q)))
    np.testing.assert_allclose(found.frequency_hz, true, rtol=1e-6)


def test_the_kr90_described_is_the_shipped_one(tmp_path: Path) -> None:
    shipped = load_robot("kr90")
    write_description(machines()["kr90"], tmp_path / "robot.yaml")
    ours = load_robot(str(tmp_path / "robot.yaml"))
    for one, other in zip(ours.links, shipped.links, strict=True):
        assert (one.mass, one.com) == (other.mass, other.com)
    assert {(e.effect, e.site) for e in ours.physics} == {(e.effect, e.site) for e in shipped.physics}
    assert ours.tolerances == shipped.tolerances


def test_gravity_may_lean() -> None:
    """A foot tilted about x is a first axis tilted by that angle: torques and stiffness by another way."""
    chain, tilt = kr90(), 0.03
    chain = replace(chain, compensator=np.zeros((3, 3)))
    leaning = replace(chain, gravity=9.81 * np.array([0.0, -np.sin(tilt), -np.cos(tilt)]))
    dh = chain.dh.copy()
    dh[0, 1] = tilt
    turned = replace(chain, dh=dh)
    q = np.array([[0.4, 1.3, -1.2]])
    still = np.zeros_like(q)
    a = inverse_dynamics(leaning, q, still, still, leaning.gravity)
    np.testing.assert_allclose(a, inverse_dynamics(turned, q, still, still), rtol=1e-12)
    np.testing.assert_allclose(assemble(leaning, q[0]).modes()[0], assemble(turned, q[0]).modes()[0], rtol=1e-10)


def test_a_slab_on_springs_bounces_as_a_mass_does() -> None:
    chain = kr90()
    chain = replace(chain, stiffness=np.full((3, 3), np.inf))
    own = sum(link.mass for link in chain.links)
    slab = Effect("floor_mode", "base", {"mass": 3e3, "inertia": [1e3] * 3, "damping_ratio": 0.03, "z": 5e7})
    (frequency,), (ratio,), _ = assemble(chain, np.zeros(3), (slab,), brakes_on=True).modes()
    assert frequency == pytest.approx(np.sqrt(5e7 / (3e3 + own)) / (2 * np.pi))
    assert ratio == pytest.approx(0.03 * np.sqrt(3e3 / (3e3 + own)))


def test_units_signs_and_labels_are_what_they_say(tmp_path: Path) -> None:
    sound = {}
    made(tmp_path / "sound", "nothing", "hammer")
    sound = read(tmp_path / "sound" / "frf.h5")
    key = next(k for k in sound if k.endswith("/frf"))
    for way, ratio in (("unit_g_all", 1 / 9.80665), ("unit_mm", 1e3)):
        made(tmp_path / way, way, "hammer")
        np.testing.assert_allclose(read(tmp_path / way / "frf.h5")[key], ratio * sound[key])
    for way, ratio in (("reversed_channel", -1.0), ("unit_g_channel", 1 / 9.80665)):
        made(tmp_path / way, way, "hammer")
        channel = read(tmp_path / way / "frf.h5")[key] / sound[key]
        assert sorted(np.round(channel.real.mean((0, 2)), 6)) == sorted(np.round([ratio, 1, 1], 6))
    made(tmp_path / "swapped", "swapped_channels", "hammer")
    swapped = read(tmp_path / "swapped" / "frf.h5")[key]
    same = [[np.array_equal(swapped[:, i], sound[key][:, j]) for j in range(3)] for i in range(3)]
    assert np.sum(same) == 3
    assert np.trace(np.array(same)) == 1


def test_noise_understated_is_a_ninth_of_the_variance(tmp_path: Path) -> None:
    variance = []
    for way in ("nothing", "noise_understated"):
        made(tmp_path / way, way, "hammer")
        found = read(tmp_path / way / "frf.h5")
        gamma = next(v for k, v in found.items() if k.endswith("/coherence"))
        variance.append(1 / gamma - 1)
    np.testing.assert_allclose(variance[0] / variance[1], 9.0, rtol=1e-6)


def test_a_sensor_without_mass_may_rove(tmp_path: Path) -> None:
    """Roving it is the same as having many; with its block on, the FRFs are of a heavier robot."""
    world, _, _, cause = wrong.case("roving_mass", "hammer", "arm", SEED, False)
    assert world.hammer is not None
    assert cause.triage == ("roving_mass",)
    world.test = replace(world.test, noise=0.0, scatter=0.0)
    heavy = world.roving
    for mass in (1e-9, heavy):
        world.roving = mass
        record(world, tmp_path / f"{mass:.0e}", np.random.default_rng(0))
    light = read(tmp_path / "1e-09" / "frf.h5")
    key = f"postures/{world.postures[0].name}/frf"
    plain = accelerance(replace(world.hammer, hammer=world.machine.hammer[-3:]), world.postures[:1], world.test)[0]
    np.testing.assert_allclose(light[key][:, -3:], plain[0, 0], rtol=1e-6)
    loaded = read(tmp_path / f"{heavy:.0e}" / "frf.h5")[key]
    assert np.linalg.norm(loaded - light[key]) > 0.01 * np.linalg.norm(light[key])


def test_a_log_of_a_joint_whose_zero_is_off(tmp_path: Path) -> None:
    """Torques are those of the angles recorded plus the angle that the answer states."""
    world, _, _, cause = wrong.case("joint_zero", "log", "column", SEED, False)
    world.how = replace(world.how, white=0.0, coloured=0.0, ripple=0.0)
    world.runs = tuple(replace(run, time=run.time[:1000]) for run in world.runs[:1])
    record(world, tmp_path, np.random.default_rng(0))
    found = read(tmp_path / "log.h5")
    joint = int(cause.names[0][-1]) - 1
    q, v, a = world.runs[0].trajectory(world.runs[0].time)
    step = cause.values["angle"] * np.eye(3)[joint]
    np.testing.assert_allclose(found["runs/run1/position"] + step, q, atol=1e-5)
    assert world.log is not None
    chain = world.log.chain
    expected = inverse_dynamics(chain, q, v, a) + chain.gear_ratio**2 * chain.rotor_inertia * a
    moving = np.abs(v).min(1) > 0.05
    rest = (found["runs/run1/torque"] - expected - chain.viscous * v)[moving]
    np.testing.assert_allclose(np.abs(rest), np.tile(chain.coulomb, (len(rest), 1)), rtol=0.05)


def test_a_clock_slips_and_a_filter_has_its_corner(tmp_path: Path) -> None:
    """The slip grows along a run; at its corner a first-order filter leaves 1/√2, 45° late."""
    torque = {}
    for way in ("nothing", "clock", "torque_filter"):
        made(tmp_path / way, way, "log")
        torque[way] = read(tmp_path / way / "log.h5")["runs/run1/torque"]
    _, _, _, cause = wrong.case("clock", "log", "arm", SEED, False)
    slip = float(cause.size.split()[0]) * 1e-6 * 2000
    index = 1990 - round(slip * 1990 / 2000)
    assert np.array_equal(torque["clock"][1990], torque["nothing"][index])
    _, _, _, cause = wrong.case("torque_filter", "log", "arm", SEED, False)
    x, y = torque["nothing"][:, 1], torque["torque_filter"][:, 1]
    frequency, cross = csd(x, y, 250, nperseg=500)
    gain = np.interp(cause.values["cutoff_hz"], frequency, cross / welch(x, 250, nperseg=500)[1])
    assert np.abs(gain) == pytest.approx(np.sqrt(0.5), rel=0.1)
    assert np.rad2deg(np.angle(gain)) == pytest.approx(-45, abs=6)


def test_part_of_a_recording_may_be_of_another_robot(tmp_path: Path) -> None:
    world = made(tmp_path / "a", "other_robot", "hammer")
    made(tmp_path / "b", "nothing", "hammer")
    other, sound = (read(tmp_path / room / "frf.h5") for room in "ab")
    for posture in world.postures:
        key = f"postures/{posture.name}/frf"
        off = np.linalg.norm(other[key] - sound[key]) / np.linalg.norm(sound[key])
        assert (off > 0.2) == (posture.name in world.apart)


def test_every_way_says_what_is_right() -> None:
    assert len(WAYS) - len(LACKING_NOTHING) >= 20
    for name, way in WAYS.items():
        for recording in way.recordings:
            world, top, without, cause = wrong.case(name, recording, "arm", SEED, False)
            assert cause.size
            assert bool(cause.names or cause.triage) == (name not in LACKING_NOTHING)
            assert not top
            assert not without
            assert bool(world.log) == (recording != "hammer")


def test_the_plan_meets_all_ways_and_robots_and_leaves_room_on_top() -> None:
    drawn = wrong.plan(240, 3)
    assert drawn == wrong.plan(240, 3)
    assert {(c["way"], c["recording"]) for c in drawn} >= {
        (name, r) for name, way in WAYS.items() for r in way.recordings if r != "both"
    }
    robots = Counter(c["robot"] for c in drawn)
    assert min(robots.values()) > 60
    assert 0.2 < np.mean([c["on_top"] for c in drawn]) < 0.45
    assert not any(c["on_top"] for c in drawn if c["way"] in LACKING_NOTHING)
    for c in drawn[:80]:
        if c["on_top"]:
            (effect,) = wrong._concealed(c["way"], c["recording"], machines()[c["robot"]], c["seed"])
            assert effect.kind not in WAYS[c["way"]].clash


CAUSE = {
    "names": ["parameter@link2.com"], "triage": [], "fair": ["payload@link2", "parameter@link2.*"],
    "values": {"com.x": 0.5, "com.y": 0.0, "com.z": 0.2}, "size": "link2 40 mm",
}  # fmt: skip


def answer(cause: dict[str, Any] = CAUSE, *top: str) -> dict[str, Any]:
    effects = [dict(zip(("effect", "site"), t.split("@"), strict=True), parameters={}, multiple=4.0) for t in top]
    return {"way": "com", "recording": "hammer", "robot": "arm", "cause": cause, "effects": effects}


def said(
    verdict: str, *names: tuple[str, float], after: float = 0.1, floor: float = 0.1, triage: tuple[Any, ...] = ()
) -> dict[str, Any]:
    effects = [
        {
            **dict(zip(("effect", "site"), name.split("@"), strict=True)), "probability": p, "alternatives": [],
            "parameters": {"com": {"value": [0.5, 0.0, 0.2], "unit": "m",
                                   "interval90": [[0.45, 0.55], [-0.01, 0.01], [0.3, 0.4]]}},
        }
        for name, p in names
    ]  # fmt: skip
    error = {"before": {"held_out": 0.2}, "after": {"held_out": after}, "noise_floor": floor}
    diagnosis = {"verdict": verdict, "effects": effects, "error": error, "triage": list(triage)}
    return {"id": "00", "engine": "e", "code": 0, "diagnosis": diagnosis, "wall_s": 1.0, "cpu_s": 1.0}


UNIT = {"names": [], "triage": ["unit"], "fair": ["sensor_gain@sensor:21X+"], "values": {}, "size": "all in g"}
SOUND = {"names": [], "triage": [], "fair": [], "values": {}, "size": "nothing"}
FAULT = {"kind": "unit", "severity": "fail", "text": "accelerations look as if in g"}


@pytest.mark.parametrize(
    ("cause", "result", "outcome"),
    [
        (CAUSE, said("named", ("parameter@link2.com", 0.9)), "right"),
        (CAUSE, said("named", ("payload@link2", 0.9)), "near"),
        (CAUSE, said("named", ("attached_resonator@link1", 0.9)), "wrong name"),
        (CAUSE, said("ambiguous", ("attached_resonator@link1", 0.4)), "doubtful"),
        (CAUSE, said("named", ("parameter@link2.com", 0.9), ("payload@flange", 0.8)), "wrong name"),
        (CAUSE, said("named", ("parameter@link3.com", 0.9)), "wrong name"),
        (CAUSE, said("located", ("discovered@joint2", 0.99)), "honest"),
        (CAUSE, said("unexplained"), "honest"),
        (CAUSE, said("adequate", after=0.12), "honest"),
        (CAUSE, said("adequate", after=0.3), "adequate above its floor"),
        (UNIT, said("unexplained", triage=(FAULT,)), "right"),
        (UNIT, said("named", ("sensor_gain@sensor:21X+", 0.9)), "near"),
        (UNIT, said("named", ("payload@flange", 0.9), triage=(FAULT,)), "wrong name"),
        (UNIT, said("unexplained", triage=("FAIL reciprocity 21X+/21Y+: 3",)), "honest"),
        (UNIT, said("unexplained", triage=("accelerations are in g",)), "right"),
        (UNIT, said("unexplained", triage=({**FAULT, "severity": "note"},)), "honest"),
        (UNIT, {**said("adequate"), "code": 2, "diagnosis": None, "complaint": "frf.h5: unit: expected m/s²"}, "right"),
        (UNIT, {**said("adequate"), "code": 124, "diagnosis": None, "complaint": "no answer"}, "no answer"),
        (SOUND, said("adequate"), "right"),
        (SOUND, said("unexplained"), "doubtful"),
        (SOUND, said("named", ("payload@flange", 0.9)), "wrong name"),
    ],
)
def test_an_answer_is_judged(cause: dict[str, Any], result: dict[str, Any], outcome: str) -> None:
    assert judged(answer(cause), result).outcome == outcome


def test_an_error_that_does_not_fall_is_told() -> None:
    assert judged(answer(), said("named", ("payload@link2", 0.9))).fallen
    assert not judged(answer(), said("named", ("payload@link2", 0.9), after=0.2)).fallen
    assert judged(answer(), said("adequate", after=0.2)).fallen


@pytest.mark.parametrize(
    ("sites", "severity", "told", "misled"),
    [
        (["link2.com.z", "link2.com.x"], "warning", True, False),
        (["link3.com.z", "link2.com.x"], "warning", False, True),
        (["link2.mass"], "warning", False, False),  # hardly differs
        (["payload@flange"], "warning", False, False),  # what is on top
        (["link2.com.z"], "note", False, False),
        ([], "warning", False, False),
    ],
)
def test_a_warning_tells_a_number_without_making_an_answer_right(
    sites: list[str], severity: str, told: bool, misled: bool
) -> None:
    line = {"kind": "description", "severity": severity, "text": "", "sites": sites}
    found = judged(answer(CAUSE, "payload@flange"), said("adequate", triage=(line,)))
    assert (found.cause_told, found.misled) == (told, misled)
    assert not found.cause_first
    assert found.outcome == "honest"
    assert str(headline([found])["true cause first, or told as farthest off its description"])[0] == str(int(told))


def test_what_is_on_top_is_no_wrong_name_and_must_be_named() -> None:
    both = said("named", ("parameter@link2.com", 0.9), ("payload@link3", 0.6))
    found = judged(answer(CAUSE, "payload@flange"), both)
    assert (found.outcome, found.top_named) == ("right", True)
    missed = judged(answer(CAUSE, "payload@flange"), said("named", ("parameter@link2.com", 0.9)))
    assert (missed.outcome, missed.top_named) == ("right", False)


def test_intervals_of_numbers_of_the_description() -> None:
    found = judged(answer(), said("named", ("parameter@link2.com", 0.9)))
    inside = {key.rpartition(".")[2]: good for key, good in found.inside.items()}
    assert inside == {"x": True, "y": True, "z": False}
    assert str(headline([found])["90 % intervals hold the truth"]).startswith("2/3")
    head, _, *rows = by_number([found, replace(found, inside={"payload@link3.mass": True})])
    assert head.startswith("| number")
    assert [row.split("=")[0].strip("| ") for row in rows] == [
        "parameter linkN.com.z | 0/1",
        "parameter linkN.com.x | 1/1",
        "parameter linkN.com.y | 1/1",
        "payload mass | 1/1",
    ]


def test_a_split_is_sealed_and_has_a_page_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with ThreadPoolExecutor(1) as pool:
        same = {"recording": "hammer", "seed": 1, "on_top": False}
        drawn = [
            ("00", {**same, "way": "nothing", "robot": "arm"}),
            ("01", {**same, "way": "com", "robot": "kr90"}),
        ]
        store.write(tmp_path / "answers" / "plan.json", {"cases": [d for _, d in drawn], "salt": ""})
        assert wrong.prepare(tmp_path, 9, None)[1][1] == drawn[1][1]  # what was drawn stays
        lines = trials.every("record", pool, wrong.make, [(tmp_path, *d) for d in drawn])
    assert [line["robot"] for line in lines] == ["robots/arm.yaml", None]
    store.write(tmp_path / "manifest.json", {"world": "wrong", "cases": lines})
    for line in lines:
        store.write(tmp_path / "results" / f"{line['id']}.json", {**said("adequate"), "id": line["id"]})
    trials._score(tmp_path, tmp_path / "wrong.md")
    text = (tmp_path / "wrong.md").read_text()
    assert text.startswith("# Proof: wrong descriptions and recordings")
    assert "| wrong name at 0.5 or more | 0/2" in text
    robot = tmp_path / "robots" / "arm.yaml"
    described = robot.read_text()
    robot.write_text(described.replace("arm", "other"))
    with pytest.raises(SystemExit, match="sealed"):
        trials._score(tmp_path, tmp_path / "wrong.md")
    robot.write_text(described)
    sealed = tmp_path / "answers" / "01.json"
    sealed.write_text(json.dumps({**store.read(sealed), "way": "mass"}))
    with pytest.raises(SystemExit, match="sealed"):
        trials._score(tmp_path, tmp_path / "wrong.md")


def test_what_a_tolerance_explains_does_not_show() -> None:
    """One deviation of a mass costs half at most, by the prior, five of a spring half of 25; a sensor moved shows."""
    world, *_ = wrong.case("nothing", "hammer", "arm", SEED, False)
    truth, machine = world.hammer, world.machine
    assert truth is not None
    postures, coarse = world.postures[:1], replace(world.test, lines=20, spacing_hz=2.0)
    signal = hammer_signal(postures, coarse, world.points[-3:])
    truth = replace(truth, posture_error={p.name: truth.posture_error[p.name] for p in postures})
    links = (*truth.chain.links[:2], replace(truth.chain.links[2], mass=truth.chain.links[2].mass * 1.03))
    heavier = replace(truth, chain=replace(truth.chain, links=links))
    beside = replace(truth, moved={f"sensor:{machine.node}": np.array([0.0, 0.0, 0.05])})
    stiffness = truth.chain.stiffness * [[1.3**5, 1, 1], [1, 1, 1], [1, 1, 1]]
    stiffer = replace(truth, chain=replace(truth.chain, stiffness=stiffness))
    found = []
    for end in (truth, heavier, stiffer, beside):
        change = wrong.slope(lambda share, end=end: signal(wrong.toward(truth, end, share)))  # type: ignore[misc]
        found.append(shows(truth, signal, change, machine.chain, machine.tolerances))
    assert found[0] == pytest.approx(0, abs=1e-9)
    assert 0.01 < found[1] < 0.501
    assert 5 < found[2] < 12.6
    assert found[3] > 20


def test_a_page_of_whole_arms_counts_what_comes_first_and_lists_the_rest() -> None:
    top, named = "stribeck_friction@joint3", ("stribeck_friction@joint3", 0.9)
    answers = [said("named", named), said("named", ("payload@flange", 0.9), named), said("adequate")]
    cases = [judged(answer(SOUND, top), one) for one in answers] + [judged(answer(SOUND), said("adequate"))]
    scores = arms_score.headline(cases)
    assert (scores["named first"].k, scores["named first"].n) == (1, 3)
    assert (scores["named"].k, scores["false alarms"].k, scores["false alarms"].n) == (2, 0, 1)
    text = arms_score.page(Path("proof-arms.md"), cases, 4, {"a": {"engine": "e"}}, [])
    assert text.count("stribeck_friction@joint3") == 3  # of two that are not right: concealed twice, said once


@pytest.mark.parametrize("step", ["run", "score", "calibrate"])
def test_a_split_that_was_not_made_is_told_in_one_line(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["trials", step, "--split", "nothere", "--out", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        trials.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
