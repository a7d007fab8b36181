"""Faults of a recording that are put right before the diagnosis, and told: units, signs, order, clocks."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import twin
from tools.trials.wrong import case
from tools.truth.__main__ import main as truth
from tools.truth.robots import machines, write_description
from tools.truth.wrong import record
from twin.diagnose.frf_faults import IN_PHASE, _alike, _order, put_right
from twin.diagnose.states import sorted_out
from twin.diagnose.triage import Triage, triage
from twin.diagnose.verdict import Verdict
from twin.identify.objective import Sample
from twin.measure.campaign import read_campaign
from twin.measure.spectra import Check
from twin.measure.units import POUND_FORCE_N, STANDARD_GRAVITY
from twin.model.recorded import without_limits
from twin.robot.description import load_robot


@pytest.mark.parametrize(
    ("way", "recording", "seed", "kind"),
    [
        pytest.param("unit_g_channel", "hammer", 411, "unit", marks=pytest.mark.slow),
        pytest.param("swapped_channels", "hammer", 441, "swapped_channels", marks=pytest.mark.slow),
        pytest.param("clock", "log", 313, "clock", marks=pytest.mark.slow),
        pytest.param("reversed_torque", "log", 314, "reversed_channel", marks=pytest.mark.slow),
        pytest.param("degrees", "log", 315, "unit", marks=pytest.mark.slow),
    ],
)
def test_a_fault_is_told_and_put_right(way: str, recording: str, seed: int, kind: str, tmp_path: Path) -> None:
    verdict = _diagnosed(way, recording, "arm", seed, tmp_path)
    told = [note["kind"] for note in verdict.data()["triage"] if note["severity"] == "fail"]
    assert told == [kind]
    assert verdict.word == "adequate"


@pytest.mark.parametrize(("own", "swapped"), [(-0.3, True), (0.4, False), (-0.9, False)])
def test_channels_are_exchanged_where_the_other_order_fits_and_theirs_does_not(own: float, swapped: bool) -> None:
    """Half out of phase is no channel of that place; fully out of phase is one with the opposite sign."""
    phase = np.array([[own, 0.6, 0.1], [0.6, own, 0.1], [0.0, 0.1, 0.8]])
    order, sign = _order(phase)
    assert order.tolist() == ([1, 0, 2] if swapped else [0, 1, 2])
    assert sign.tolist() == ([-1, -1, 1] if own < -0.5 else [1, 1, 1])


@pytest.mark.slow
def test_hum_is_told_and_gets_no_other_name(tmp_path: Path) -> None:
    verdict = _diagnosed("hum", "hammer", "arm", 901, tmp_path)
    assert [note["kind"] for note in verdict.data()["triage"] if note["severity"] == "fail"] == ["hum"]
    assert not verdict.missing


@pytest.mark.parametrize(("way", "told"), [("other_robot", ["other_robot"]), ("nothing", [])])
def test_postures_of_two_robots_are_told_apart(way: str, told: list[str], tmp_path: Path) -> None:
    world, *_ = case(way, "hammer", "kr90", 941, False)
    record(world, tmp_path, np.random.default_rng(941))
    campaign, robot = read_campaign(tmp_path / "frf.h5"), without_limits(load_robot("kr90"))
    every = triage(campaign, robot, "frf.h5", None).recordings.values()
    sound, notes = sorted_out(robot, campaign, Sample(tuple(every)))
    assert [note.kind for note in notes] == told
    assert all("milling, rigid, upright; posture4, posture5, posture6" in note for note in notes)
    assert set(sound.postures) == ({"milling", "rigid", "upright"} if told else set(campaign.postures))


@pytest.mark.parametrize("step_deg", [-6.0, 17.0])
def test_an_angle_that_is_written_down_wrongly_is_put_right(step_deg: float, tmp_path: Path) -> None:
    world, *_ = case("nothing", "hammer", "arm", 942, False)
    record(world, tmp_path, np.random.default_rng(942))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    campaign, robot = read_campaign(tmp_path / "frf.h5"), without_limits(load_robot(str(tmp_path / "robot.yaml")))
    name, posture = list(campaign.postures.items())[-1]
    wrong = replace(posture, q_deg=posture.q_deg + step_deg * np.eye(3)[2])
    spoilt = replace(campaign, postures={**campaign.postures, name: wrong})
    every = triage(spoilt, robot, "frf.h5", None).recordings.values()
    right, (note,) = sorted_out(robot, spoilt, Sample(tuple(every)))
    assert (note.kind, note.severity) == ("posture", "fail")
    assert list(right.postures) == list(campaign.postures)
    np.testing.assert_allclose(right.postures[name].q_deg, posture.q_deg, atol=4 * robot.tolerances.posture_deg)


@pytest.mark.slow
def test_a_wrong_angle_is_found_where_it_was_kept_aside(tmp_path: Path) -> None:
    """Its own angle is estimated again before a posture is predicted: that must not hide that it is 8° elsewhere."""
    world, *_ = case("nothing", "hammer", "arm", 942, False)
    record(world, tmp_path, np.random.default_rng(942))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    campaign = read_campaign(tmp_path / "frf.h5")
    name, posture = list(campaign.postures.items())[-1]
    wrong = replace(posture, q_deg=posture.q_deg + 8.0 * np.eye(3)[2])
    spoilt = replace(campaign, postures={**campaign.postures, name: wrong})
    verdict = twin.diagnose(spoilt, robot=str(tmp_path / "robot.yaml"), hold_out=[name])
    (note,) = (note for note in verdict.data()["triage"] if note["severity"] == "fail")
    assert note["kind"] == "posture"
    assert name in note["text"]
    assert verdict.word == "adequate"


@pytest.mark.slow
def test_a_run_of_another_robot_is_told(tmp_path: Path) -> None:
    """The run kept aside is of another robot: the others are diagnosed alone."""
    verdict = _diagnosed("other_robot", "log", "arm", 931, tmp_path)
    (note,) = (note for note in verdict.data()["triage"] if note["severity"] == "fail")
    assert note["kind"] == "other_robot"
    assert note["runs"]
    assert "is diagnosed" in note["text"]
    assert verdict.word == "adequate"


@pytest.mark.slow
def test_a_slab_under_the_robot_is_named(tmp_path: Path) -> None:
    verdict = _diagnosed("floor_mode", "hammer", "column", 920, tmp_path)
    assert [missing.first.key for missing in verdict.missing] == ["floor_mode@base"]
    assert verdict.error["after"]["held_out"] < 1.2 * verdict.error["noise_floor"]


@pytest.mark.slow
def test_hits_alone_say_what_their_frfs_say(tmp_path: Path) -> None:
    """FRFs made of hits are off by more than their noise; that is small beside what is missing and gets no name."""
    twin.example("cell", tmp_path / "cell")
    with h5py.File(tmp_path / "cell" / "campaign.h5", "r+") as file:
        for group in file["postures"].values():
            for name in ("frf", "coherence", "frequency"):
                del group[name]
    verdict = twin.diagnose(tmp_path / "cell" / "campaign.h5")
    (missing,) = verdict.missing
    assert missing.first.key == "base_compliance@base.rx"
    assert missing.probability > 0.8
    assert {rival.key for rival, _ in missing.rivals} <= {"floor_mode@base"}  # a slab on one soft side is nearly that


@pytest.mark.slow
def test_what_is_missing_is_named_though_records_leak(tmp_path: Path) -> None:
    """A third of the swing is left at their end. A model that does not leak misses by 13 %."""
    verdict = _diagnosed("leakage", "hammer", "arm", 1728633453, tmp_path, on_top=True)
    assert [note["kind"] for note in verdict.data()["triage"] if note["severity"] == "fail"] == ["leakage"]
    assert [missing.first.key for missing in verdict.missing] == ["base_compliance@base.ry"]
    assert verdict.error["after"]["held_out"] < 1.2 * verdict.error["noise_floor"]


def _diagnosed(way: str, recording: str, robot: str, seed: int, folder: Path, on_top: bool = False) -> Verdict:
    """The verdict on a recording of the wrong world."""
    world, *_ = case(way, recording, robot, seed, on_top)
    record(world, folder, np.random.default_rng(seed))
    (file,) = folder.glob("*.h5")
    if robot != "kr90":
        write_description(machines()[robot], folder / "robot.yaml")
    return twin.diagnose(file, robot="kr90" if robot == "kr90" else folder / "robot.yaml")


@pytest.mark.slow
def test_a_sensor_that_goes_from_node_to_node_is_named_with_its_mass(tmp_path: Path) -> None:
    verdict = _diagnosed("roving_mass", "hammer", "column", 947, tmp_path)
    (missing,) = verdict.missing
    assert missing.first.key == "sensor_mass@sensor:*"
    assert verdict.error["after"]["held_out"] < 1.2 * verdict.error["noise_floor"]


@pytest.mark.parametrize(("channels", "told"), [([0], []), ([0, 1, 2], ["unit"])])
def test_a_hammer_in_another_unit_is_seen_in_all_channels(channels: list[int], told: list[str], tmp_path: Path) -> None:
    world, *_ = case("nothing", "hammer", "arm", 942, False)
    record(world, tmp_path, np.random.default_rng(942))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    with h5py.File(tmp_path / "frf.h5", "r+") as file:
        for group in file["postures"].values():
            for k in channels:
                group["frf"][:, k] = 4.4482216 * group["frf"][:, k]
    campaign, robot = read_campaign(tmp_path / "frf.h5"), without_limits(load_robot(tmp_path / "robot.yaml"))
    assert len(campaign.response.label) == 3
    _, notes = put_right(campaign, robot, "frf.h5")
    assert [note.kind for note in notes] == told


@pytest.mark.parametrize(
    ("times", "kind", "said"),
    [
        (-1.0, "reversed_channel", "struck the other way"),
        (POUND_FORCE_N, "unit", "in lbf"),
        (STANDARD_GRAVITY, "unit", "in kgf"),
    ],
)
def test_one_blow_in_another_unit_or_from_the_other_side_is_put_right(
    times: float, kind: str, said: str, tmp_path: Path
) -> None:
    world, *_ = case("nothing", "hammer", "arm", 942, False)
    record(world, tmp_path, np.random.default_rng(942))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    campaign, robot = read_campaign(tmp_path / "frf.h5"), without_limits(load_robot(tmp_path / "robot.yaml"))
    untouched, notes = put_right(campaign, robot, "frf.h5")
    assert notes == []
    factor = np.ones(len(campaign.excitation.label))
    factor[2] = times
    wrong = {name: replace(p, frf=p.frf * factor) for name, p in campaign.postures.items()}
    right, (note,) = put_right(replace(campaign, postures=wrong), robot, "frf.h5")
    assert (note.kind, note.channels) == (kind, campaign.excitation.label[2:3])
    assert said in note
    for name, posture in right.postures.items():
        np.testing.assert_allclose(posture.frf, untouched.postures[name].frf, rtol=1e-12)


def test_blows_that_a_soft_foundation_answers_more_are_not_in_another_unit(tmp_path: Path) -> None:
    """Four blows on the first links had FRFs 3.5 to 5.4 times as large as described: the base tilts."""
    effect, file = "base_compliance@base.rx:stiffness=1.5e8,damping=500", tmp_path / "test.h5"
    places = ("--posture", "milling=0,70,-100", "--posture", "upright=50,135,-100", "--posture", "rigid=-40,135,-140")
    assert truth(["campaign", "--out", str(file), "--seed", "11", "--lines", "50", "--effect", effect, *places]) == 0
    campaign = read_campaign(file)
    same, notes = put_right(campaign, without_limits(load_robot("kr90")), "test.h5")
    assert notes == []
    assert same is campaign


def test_sensors_share_their_unit_where_the_phase_of_one_is_not_plain(tmp_path: Path) -> None:
    """All in mm/s²; the described modes of one direction are elsewhere, so that its phase says little."""
    world, *_ = case("nothing", "hammer", "arm", 942, False)
    record(world, tmp_path, np.random.default_rng(942))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    with h5py.File(tmp_path / "frf.h5", "r+") as file:
        for group in file["postures"].values():
            group["frf"][...] = 1e3 * np.exp([[[1.2j]], [[0j]], [[0j]]]).reshape(1, 3, 1) * group["frf"][...]
    campaign, robot = read_campaign(tmp_path / "frf.h5"), without_limits(load_robot(tmp_path / "robot.yaml"))
    phase, _ = _alike(campaign, robot, "frf.h5")
    assert abs(phase[0, 0]) < IN_PHASE < min(phase[1, 1], phase[2, 2])
    _, (note,) = put_right(campaign, robot, "frf.h5")
    assert (note.kind, note.channels) == ("unit", campaign.response.label)


def test_a_failed_check_is_told_once_for_all_postures() -> None:
    """Eighteen lines of three pairs told a user nothing more than three."""
    pair = "21X+/21Z+ and 21Z+/21X+"
    checks = [Check("reciprocity", pair, value, False) for value in (0.2, 0.334, 0.3)]
    found = Triage({}, (), (*checks, Check("driving point", "7Z+/7Z+", 0.4, False)), False)
    levels = Check("linearity", "a (100 N) and a (600 N)", 9.0, False)
    one, other = replace(found, checks=(*found.checks, levels), nonlinear=True).warnings
    assert "driving point 7Z+/7Z+" in one  # a robot with play is not reciprocal: no channel is blamed
    assert (one.severity, other.severity) == ("warning", "fail")
    assert "depend on the force" in other
    assert found.warnings == [
        f"reciprocity {pair}: the two differ by 33% of their mean in the worst of 3 postures where this fails",
        "driving point 7Z+/7Z+: 60% of its energy has the wrong sign",
    ]


def test_a_channel_in_g_is_told_and_put_right_before_it_is_compared_or_fitted(tmp_path: Path) -> None:
    world, *_ = case("unit_g_channel", "hammer", "arm", 411, False)
    record(world, tmp_path, np.random.default_rng(411))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    campaign, robot = read_campaign(tmp_path / "frf.h5"), load_robot(tmp_path / "robot.yaml")
    with pytest.warns(UserWarning, match="recorded in g, it seems"):
        right = twin.compare(campaign, robot=robot)
    stated = twin.compare(campaign, robot=robot, as_is=True)
    (one,), (other,) = right.errors.values(), stated.errors.values()
    assert one < 0.9 * other
    with pytest.warns(UserWarning, match="recorded in g, it seems"):
        fitted = twin.fit(campaign, robot=robot, starts=1)
    assert fitted.error["train"] < 0.05
