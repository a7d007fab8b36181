"""Evidence, errors and figures of a diagnosis on FRFs and torques written down by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import find_peaks

from twin.diagnose.joint import Knowledge, settled_with, together
from twin.diagnose.records import FrfRecord, LogRecord, ModalRecord, pooled_floor
from twin.diagnose.sentences import PROMINENCE, _summits, best_spot, fall, off_by, percents, sentence
from twin.diagnose.torque import pooled
from twin.diagnose.verdict import Candidate, Finding, Missing, Verdict
from twin.measure.campaign import Channels
from twin.model.parameters import free_parameters
from twin.report import diagnosis
from twin.robot.description import Robot, check_inertia
from twin.robot.physical import physical

F = np.arange(5.0, 30.0, 0.125)


def oscillators(*frequencies: float, gain: float = 1.0, damping: float = 0.01) -> np.ndarray:
    """Accelerance (nf, 1, 1) of masses on springs side by side: −ω²/(ω₀² − ω² + 2iζω₀ω) each."""
    s = 2j * np.pi * F
    parts = [s**2 / (w**2 + s**2 + 2 * damping * w * s) for w in 2 * np.pi * np.array(frequencies)]
    return gain * np.sum(parts, axis=0)[:, None, None]


def record(before: np.ndarray, after: np.ndarray, measured: np.ndarray, **changed: object) -> FrfRecord:
    channel = Channels(("21Z+",), ("link3",), np.zeros((1, 3)), np.array([[0, 0, 1.0]]))
    blow = Channels(("4Y+",), ("link1",), np.zeros((1, 3)), np.array([[0, 1.0, 0]]))
    values: dict[str, object] = {
        "name": "upright", "posture": "upright", "held_out": False, "q": np.zeros(3), "brakes": "off",
        "response": channel, "excitation": blow, "frequency": F, "quantity": "accelerance", "measured": measured,
        "variance": np.full(measured.shape, 1e-4), "predicted": {"as_given": before, "before": before, "after": after},
        "modes_hz": {"after": np.array([11.0, 20.0])},
    }  # fmt: skip
    return FrfRecord(**(values | changed))  # type: ignore[arg-type]


ERRORS = {
    "before": {"train": 0.2, "held_out": 0.3}, "after": {"train": 0.01, "held_out": 0.02}, "noise_floor": 0.009,
}  # fmt: skip


def test_the_sentence_names_mode_posture_channel_and_by_how_much_it_is_off() -> None:
    shifted = record(oscillators(11.0 * 1.08, 20.0), oscillators(11.0, 20.0), oscillators(11.0, 20.0))
    held = replace(shifted, name="rigid", held_out=True, variance=np.full(shifted.measured.shape, 4e-4))
    text = sentence("payload at flange", [shifted, held], ERRORS, ["rigid"])
    assert "mode 1 at 11.00 Hz (peak of 21Z+/4Y+) in 'upright' comes out 8 % too high" in text
    assert "with it at 11.00 Hz" in text
    assert held.floor == pytest.approx(2 * shifted.floor)
    assert f"20.00% → 1.00%, and on rigid, not used, 30.00% → 2.00% (noise alone {held.floor:.2%})" in text


def test_a_peak_of_the_right_place_and_wrong_height_is_told_by_its_height() -> None:
    damped = record(oscillators(11.0, 20.0, gain=0.8), oscillators(11.0, 20.0), oscillators(11.0, 20.0))
    assert "comes out 20 % too low in amplitude" in sentence("sensor_gain at sensor:21Z+", [damped], ERRORS, [])


def test_a_peak_the_model_does_not_have_is_said_to_be_missing() -> None:
    absent = record(oscillators(20.0), oscillators(11.0, 20.0), oscillators(11.0, 20.0))
    text = sentence("attached_resonator at link3", [absent], ERRORS, [])
    assert "no peak of its own for mode 1 at 11.00 Hz" in text


def test_a_peak_of_the_model_belongs_to_the_nearest_measured_one() -> None:
    """Without what was found the second peak is not there, and the first is not told in its place."""
    hidden = record(oscillators(10.0), oscillators(10.1, 13.0), oscillators(10.1, 13.0))
    text = sentence("base_compliance at base.ry", [hidden], ERRORS, [])
    assert "no peak of its own for the peak of 21Z+/4Y+ at 13.01 Hz" in text


def test_a_fall_is_told_with_the_digits_that_show_it() -> None:
    assert percents(0.2459, 0.0021, 2) == ("24.59%", "0.21%")
    assert percents(0.0037212, 0.0037078, 2) == ("0.372%", "0.371%")
    assert percents(0.01, 0.01, 2) == ("1.00%", "1.00%")
    same = {"before": ERRORS["before"], "after": ERRORS["before"], "noise_floor": None}
    assert "does not fall" in fall(same, ["rigid"])
    assert "does not fall" not in fall(ERRORS, ["rigid"])


def test_peaks_are_those_that_stand_out_on_both_sides() -> None:
    rng = np.random.default_rng(0)
    for size in (0.2, 0.5, 1.0, 3.0):
        for count in (2, 3, 20, 300):
            noise = size * rng.normal(size=count)
            for level in (noise, np.cumsum(noise)):
                assert _summits(level.tolist()) == find_peaks(level, prominence=PROMINENCE)[0].tolist()


def test_where_no_peak_moves_the_sentence_tells_the_residual() -> None:
    same = oscillators(11.0, 20.0)
    noisy = record(same * 1.03, same, same)
    assert best_spot([noisy]) is None
    assert "misses 21Z+/4Y+ in 'upright'" in sentence("sensor_gain at sensor:21Z+", [noisy], ERRORS, [])


@pytest.mark.parametrize(
    ("value", "text"), [(1.08, "8 % too high"), (0.985, "1.5 % too low"), (1.0012, "0.12 % too high")]
)
def test_differences_keep_two_digits_that_matter(value: float, text: str) -> None:
    assert off_by(value, 1.0) == text


def test_the_error_of_a_record_is_the_weighted_ratio_and_noise_alone_gives_its_floor() -> None:
    rng = np.random.default_rng(0)
    H = np.repeat(np.repeat(oscillators(11.0), 3, axis=1), 4, axis=2)
    noise = 0.01 * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    r = record(H * 1.1, H, H + noise, variance=np.full(H.shape, 1e-4))
    assert r.error("after") == pytest.approx(r.floor, rel=0.02)
    assert r.error("before") == pytest.approx(0.1, rel=0.01)


def test_every_row_of_the_errors_has_the_noise_of_its_own_recordings(kr90: Robot) -> None:
    H = oscillators(11.0, 20.0)
    used = record(1.1 * H, H, H)
    held = replace(used, name="rigid", held_out=True, variance=np.full(H.shape, 4e-4))
    assert pooled_floor([used]) == pytest.approx(used.floor)
    assert used.floor < (pooled_floor([used, held]) or 0) < held.floor
    errors = {**ERRORS, "as_given": ERRORS["before"]}
    finding = Finding(
        "a.h5", "frf-campaign", "adequate", [], 1.0, 0.0, kr90, kr90, kr90, errors, ["rigid"], [used, held]
    )
    floors = {row[0]: row[-1] for row in diagnosis._error_table(finding).rows}
    assert floors["all used"] == floors["upright"] == f"{used.floor:.2%}"
    assert floors["all held out"] == floors["rigid (held out)"] == f"{held.floor:.2%}"


def log_record(**changed: object) -> LogRecord:
    t = np.linspace(0, 10, 500)
    q = np.sin(t)[:, None] * [1.0, 0.5]
    v = np.gradient(q, t, axis=0)
    true = 100 * q + 20 * np.sign(v)
    values: dict[str, object] = {
        "name": "run1", "held_out": False, "time": t, "position": q, "velocity": v, "measured": true,
        "valid": np.ones(len(t), bool), "noise": np.ones(2),
        "predicted": {"as_given": 90 * q, "before": 100 * q, "after": true + 1.0},
    }  # fmt: skip
    return LogRecord(**(values | changed))  # type: ignore[arg-type]


def test_torque_errors_are_pooled_over_joints_after_taking_ratios() -> None:
    r = log_record()
    ratio = [np.sqrt(np.mean((20 * np.sign(r.velocity[:, i])) ** 2) / np.mean(r.measured[:, i] ** 2)) for i in (0, 1)]
    assert r.error("before") == pytest.approx(np.sqrt(np.mean(np.square(ratio))))
    assert pooled([r], "before") == {"train": pytest.approx(r.error("before")), "held_out": None}
    assert "torque of joint2 in run 'run1'" in sentence("coulomb_friction at joint2", [r], ERRORS, [])


def test_inertias_no_body_can_have_are_brought_back_and_others_left(kr90: Robot) -> None:
    assert physical(kr90) is kr90
    broken = kr90.links[1].model_copy(update={"inertia": (1.0, 10.0, 20.0, 0.0, 0.0, 0.0)})
    robot = physical(kr90.model_copy(update={"links": [kr90.links[0], broken, kr90.links[2]]}))
    assert robot.links[0] is kr90.links[0]
    assert robot.links[1].inertia is not None
    check_inertia(robot.links[1].inertia)
    # second moments (14.5, 5.5, −4.5): only the negative one is changed, to next to nothing
    assert robot.links[1].inertia == pytest.approx((5.5, 14.5, 20.0, 0.0, 0.0, 0.0), abs=0.01)


def candidate(effect: str, site: str, robot: Robot) -> Candidate:
    return Candidate(effect, site, 10.0, robot, {"mass": {"value": 30.0, "unit": "kg", "interval90": [28.0, 32.0]}})


def test_a_rival_that_the_other_recording_refuses_loses_its_probability(kr90: Robot) -> None:
    payload, mass = candidate("payload", "flange", kr90), candidate("parameter", "link3.mass", kr90)
    missing = [Missing(payload, 0.5, ((mass, 0.49),), "")]
    kept, none = settled_with(missing, {"payload@flange": 200.0, "parameter@link3.mass": 20.0}, 0.0, 0.01)
    assert kept[0].first.effect == "payload"
    assert kept[0].probability == pytest.approx(0.99, abs=1e-6)
    assert none < 1e-6
    swapped, _ = settled_with(missing, {"payload@flange": 20.0, "parameter@link3.mass": 200.0}, 0.0, 0.01)
    assert swapped[0].first.site == "link3.mass"


def test_knowledge_of_links_is_gaussian_and_its_own_prior_is_taken_out(kr90: Robot) -> None:
    """Prior σ², likelihood r²: the log's posterior is 1/(1/(3σ²) + 1/r²); the hammer's becomes 1/(1/σ² + 1/r²)."""
    free = free_parameters(kr90, ["a"], ["21Z+"])
    names = [name for name in free.names if name.startswith("link")]
    at = [free.names.index(name) for name in names]
    prior = free.covariance[np.ix_(at, at)]
    likelihood = 0.04 * prior
    posterior = np.linalg.inv(np.linalg.inv(3 * prior) + np.linalg.inv(likelihood))
    mean = np.array([free[k].mean for k in at])
    known = Knowledge(tuple(names), len(names), mean, posterior, 3 * prior, np.array([free[k].log for k in at]))
    told = known.on(free, kr90)
    expected = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(likelihood))
    np.testing.assert_allclose(told.covariance[np.ix_(at, at)], expected, rtol=1e-6, atol=1e-12)
    assert told.names == free.names


def finding(kr90: Robot, records: list, **changed: object) -> Finding:
    error = {"as_given": {"train": 0.4, "held_out": 0.5}, **ERRORS}
    missing = [Missing(candidate("payload", "flange", kr90), 0.6, ((candidate("payload", "link3", kr90), 0.39),), "…")]
    one = Finding("a.h5", "frf-campaign", "ambiguous", missing, 0.0, 0.01, kr90, kr90, kr90, error, ["rigid"], records)
    return replace(one, **changed)  # type: ignore[arg-type]


def test_mixed_recordings_have_one_error_each(kr90: Robot) -> None:
    hammer = finding(kr90, [])
    log = finding(kr90, [log_record()], recording="b.h5", source="motion-log", missing=[], word="adequate")
    verdict = together([log, hammer], kr90, kr90)
    assert verdict.word == "ambiguous"
    assert verdict.data()["error"]["after"]["train"] == {"b.h5": 0.01, "a.h5": 0.01}
    assert [part["kind"] for part in verdict.data()["recordings"]] == ["motion-log", "frf-campaign"]


def test_where_the_model_misses_is_told_first_of_what_it_does_not_do_for(kr90: Robot) -> None:
    """A log that the base model does for has its worst spots too, and they are those of noise."""
    hammer = finding(kr90, [], location=[{"site": "joint3.z"}], missing=[], word="unexplained")
    log = finding(kr90, [log_record()], location=[{"site": "joint1"}], missing=[], word="adequate")
    assert [spot["site"] for spot in together([log, hammer], kr90, kr90).location] == ["joint3.z", "joint1"]


def test_every_kind_of_recording_is_drawn_and_every_figure_is_in_the_page(kr90: Robot, tmp_path) -> None:
    measured = oscillators(11.0, 20.0)
    used = record(oscillators(12.0, 20.0), measured, measured)
    kept = record(oscillators(12.0, 20.0), measured, measured, name="rigid", held_out=True)
    table = ModalRecord(
        "milling", False, np.zeros(3), np.array([[10.0, 1.4], [11.0, 1.0]]), np.full((2, 2), 0.01),
        {stage: np.array([[10.2, 1.5], [11.1, 0.9]]) for stage in ("as_given", "before", "after")},
    )  # fmt: skip
    names = {
        "frf-campaign": ([used, kept], {"errors", "mismatch", "overlay"}),
        "motion-log": ([log_record(), log_record(held_out=True)], {"errors", "residual", "torque"}),
        "modal-table": ([table], {"errors", "modes"}),
    }
    for source, (records, expected) in names.items():
        verdict = Verdict.of(finding(kr90, records, source=source))
        drawn = diagnosis.draw(verdict)
        assert {name.removesuffix(".png") for name in drawn} >= expected | {"probabilities"}
        sections = diagnosis.sections(verdict, {name: tmp_path / name for name in drawn})
        shown = [path.name for section in sections for _, path in section.figures]
        assert sorted(shown) == sorted(drawn)
        assert "payload at flange" in diagnosis.lead(verdict)


def test_where_nothing_was_found_the_mismatch_is_drawn_once() -> None:
    """Two alike panels were titled before and after."""
    H = oscillators(11.0, 20.0)
    alike, found = record(1.1 * H, 1.1 * H, H), record(1.1 * H, H, H)
    for one, names in ((alike, {"before"}), (found, {"before", "after"})):
        assert len(diagnosis.mismatch([one]).axes) == 2 * len(names) + 1  # and a bar of colours
        drawn = {name.rpartition(", ")[2].partition(":")[0] for name in diagnosis.mismatch_map([one]).panels}
        assert drawn == names


def test_the_mismatch_map_is_one_where_the_residual_is_noise() -> None:
    rng = np.random.default_rng(1)
    H = np.repeat(oscillators(11.0), 30, axis=2)
    noise = 0.01 * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    blow = Channels(
        tuple(f"{k}Y+" for k in range(30)), ("link1",) * 30, np.zeros((30, 3)), np.tile([0, 1.0, 0], (30, 1))
    )
    r = record(H, H, H + noise, excitation=blow, variance=np.full(H.shape, 1e-4))
    over = diagnosis._banded(r, "after", np.linspace(5, 30, 11))
    assert over == pytest.approx(np.ones(10), abs=0.08)


def test_the_map_says_in_every_cell_how_far_the_model_misses_over_noise() -> None:
    shifted = record(oscillators(11.9, 20.0), oscillators(11.0, 20.0), oscillators(11.0, 20.0))
    drawn = diagnosis.mismatch_map([shifted])
    before, after = (drawn.panels[f"upright, {diagnosis.NAMES[s]}"] for s in ("before", "after"))
    assert before.rows == ["21Z+/4Y+"]
    assert np.isfinite(before.values).all()
    place = np.searchsorted(before.edges, 11.0) - 1
    of = (shifted.frequency >= before.edges[place]) & (shifted.frequency < before.edges[place + 1])
    wanted = np.sqrt(np.mean(np.abs(shifted.measured - shifted.predicted["before"])[of] ** 2 / 1e-4) / 2)
    assert before.values[0, place] == pytest.approx(wanted)
    assert drawn.range[1] == pytest.approx(before.values.max())
    assert not after.values.any()
    (pooled,) = drawn.panels["all postures, before: refitted"].values
    np.testing.assert_allclose(pooled, before.values[0])
    assert drawn.data()["panels"][2]["columns"] == ["4Y+"]


def test_sizes_without_a_usual_one_are_told_in_a_table(kr90: Robot) -> None:
    def item(effect: str, site: str, parameter: str, value: float, unit: str) -> dict[str, object]:
        return {"effect": effect, "site": site, "parameter": parameter, "value": value, "unit": unit}

    items = [
        item("payload", "flange", "mass", 10.3, "kg"),  # has a usual size: it is in the picture
        item("coulomb_friction", "joint1", "torque", 2.67, "N·m"),
        item("coulomb_friction", "joint2", "torque", 7.8, "N·m"),
    ]
    (table,) = diagnosis._visible_table(items, kr90)
    assert table.rows == [("coulomb_friction", "torque", "2.7 at joint1, 7.8 at joint2", "N·m")]
    assert diagnosis._visible_table(items[:1], kr90) == []
    alone = Verdict.of(finding(kr90, [log_record()], source="motion-log", smallest_visible=items[1:]))
    drawn = diagnosis.draw(alone)
    assert "smallest_visible.png" not in drawn  # it would be empty
    (section,) = [s for s in diagnosis.sections(alone, {}) if s.title == "What could have been seen"]
    assert "picture" not in " ".join(section.text)
    assert section.tables
