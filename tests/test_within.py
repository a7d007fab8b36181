"""What is off by no more than the description allows is no finding, and stays in the fits."""

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.diagnose import decide
from twin.diagnose import search as search_module
from twin.diagnose.decide import Decision, in_doubt_beside, sifted, that_show
from twin.diagnose.described import geometry
from twin.diagnose.edit import predicted_by_algebra, predicted_by_mujoco
from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, together
from twin.diagnose.left_out import that_foretell
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.search import Search, _better, _may_be_seen, _stand_ins, inexact
from twin.diagnose.within import allowed, excused, members, taken_in, turned, without
from twin.identify.objective import Sample
from twin.measure.campaign import Channels
from twin.model.parameters import free_parameters
from twin.physics import CATALOGUE
from twin.robot.description import Entry, Robot
from twin.robot.physical import as_written

SENSORS = Channels(("21X+", "21Y+", "21Z+"), ("link3",) * 3, np.tile([1.5, 0.0, 0.1], (3, 1)), np.eye(3))
SERVO = {"stiffness": 1e7, "damping": 1e3, "inertia": 50.0, "integral_time": 0.5}
BLOWS = Channels(("21Z+", "7Y+"), ("link3", "link2"), np.array([[1.5, 0, 0.1], [0.6, 0.2, 0]]), np.eye(3)[[2, 1]])


def fitted(robot: Robot, hypothesis: Hypothesis, own: np.ndarray, known: float = 1e6) -> Fitted:
    """A hypothesis whose own numbers came out as given, ``known`` is the information that there is of each."""
    parameters = hypothesis.parameters(free_parameters(robot, ["p"], SENSORS.label))
    values = parameters.values(np.zeros(len(parameters)))
    values[len(values) - len(own) :] = own
    z = parameters.coordinates(values)
    return Fitted(hypothesis, parameters, z, values, robot, 1.0, 1.0, known * np.eye(len(z)), 100, True)


def nodes(robot: Robot, what: str = "position") -> Hypothesis:
    """All nodes elsewhere, or all channels turned."""
    return next(v[0] for v in geometry(robot, SENSORS, BLOWS) if v[0].site == f"node:*.{what}")


@pytest.mark.parametrize("what", ["position", "direction"])
@pytest.mark.parametrize(("times", "is_allowed"), [(1.0, True), (1.7, True), (5.0, False)])
def test_nodes_within_their_tolerance_are_no_finding(kr90: Robot, what: str, times: float, is_allowed: bool) -> None:
    """Nobody states a tolerance to better than a factor of two: off by 1.7 times it, numbers are ordinary."""
    group = nodes(kr90, what)
    tolerance = kr90.tolerances.position if what == "position" else np.deg2rad(kr90.tolerances.direction_deg)
    off = times * tolerance * np.resize([1.0, -1.0], len(group.own))
    fit = fitted(kr90, group, np.array([p.mean for p in group.own]) + off)
    assert (allowed(fit, kr90) == (group,)) is is_allowed


def test_one_blow_that_points_far_elsewhere_is_looked_at_as_the_effect_that_it_is(kr90: Robot) -> None:
    """Alone, and beside the directions of the others; two of them are tried together, too."""
    group = nodes(kr90, "direction")
    blow, sensor, gain = (
        entry_hypothesis(kr90, effect, site, CATALOGUE[effect].typical(kr90, site) or {})
        for effect, site in (
            ("hammer_misalignment", "hammer:7Y+"), ("sensor_misalignment", "sensor:21"), ("sensor_gain", "sensor:21Z+")
        )
    )  # fmt: skip
    suspects = [[blow], [sensor], [gain]]
    off = np.zeros(len(group.own))
    of_blow = np.array(["7Y+.excitation" in p.name for p in group.own])
    of_sensor = np.array([".response" in p.name for p in group.own])

    assert turned(fitted(kr90, group, off), group, suspects, kr90) == []
    assert turned(fitted(kr90, nodes(kr90), np.ones(len(nodes(kr90).own))), nodes(kr90), suspects, kr90) == []
    alone, beside = turned(fitted(kr90, group, 0.1 * of_blow), group, suspects, kr90)
    assert alone.identity == {blow.key}
    assert beside.identity == {blow.key, group.key}
    assert [p.name for p in beside.pieces[1].own] == [p.name for p, b in zip(group.own, of_blow, strict=True) if not b]
    several = turned(fitted(kr90, group, 0.1 * (of_blow | of_sensor)), group, suspects, kr90)
    assert {blow.key, sensor.key} in [one.identity for one in several]


def test_one_node_far_astray_is_looked_at_by_itself(kr90: Robot) -> None:
    """A blow 21 mm off is lost in the χ² of all nodes; alone, and beside the others, it is a hypothesis of its own."""
    group = nodes(kr90)
    at = np.array([p.mean for p in group.own])
    blow = np.array([p.name == "node:7Y+.excitation.z" for p in group.own])
    far, near = (fitted(kr90, group, at + step * blow) for step in (0.021, 0.007))
    alone, beside = members(far, group)
    assert alone.key == "parameter@node:7.position"
    assert {p.name for p in alone.own} == {f"node:7Y+.excitation.{x}" for x in "xyz"}
    assert beside.identity == {"parameter@node:7.position", "parameter@node:*.position"}
    assert len({p.name for p in beside.own}) == len(beside.own) == len(group.own)
    assert members(near, group) == []
    _, note = taken_in((group,), far)
    assert (note.kind, note.severity) == ("position", "warning")
    assert "tolerance of 5 mm per axis allows: blow 7Y+ by 21.0 mm;" in note
    assert len(taken_in((group,), near)) == 1  # of three coordinates, each as far off as its tolerance
    unknown = fitted(kr90, group, at + 0.021 * blow, known=1.02)
    assert members(unknown, group) == []
    directions = nodes(kr90, "direction")  # one blow off its axis is an effect
    assert members(fitted(kr90, directions, np.append(0.1, np.zeros(len(directions.own) - 1))), directions) == []


def test_one_twist_far_astray_is_looked_at_by_itself(kr90: Robot) -> None:
    group = next(v[0] for v in geometry(kr90, SENSORS, BLOWS) if v[0].site == "axis*")
    at = np.array([p.mean for p in group.own])
    twist = np.array([p.name == "axis3.alpha" for p in group.own]) * np.deg2rad(kr90.tolerances.angle_deg)
    far, near = (fitted(kr90, group, at + times * twist) for times in (6.0, 1.0))
    alone, beside = members(far, group)
    assert alone.key == "parameter@axis3.alpha"
    assert [p.name for p in alone.own] == ["axis3.alpha"]
    assert beside.identity == {"parameter@axis3.alpha", "parameter@axis*"}
    assert len({p.name for p in beside.own}) == len(beside.own) == len(group.own)
    assert members(near, group) == []
    (note,) = taken_in((group,), near)
    assert note.startswith("lengths and twists of axes (axis*): a little off")


def test_a_turn_that_the_data_hardly_know_is_no_finding(kr90: Robot) -> None:
    """It came out many tolerances off, known to as many: a seven-axis arm got a name for it beside its soft base."""
    group = nodes(kr90, "direction")
    tolerance = np.deg2rad(kr90.tolerances.direction_deg)
    at = np.array([p.mean for p in group.own])
    fit = fitted(kr90, group, at + tolerance * np.append(-16.6, np.resize([0.7, -0.7], len(at) - 1)))
    assert allowed(fit, kr90) == ()
    information = fit.information.copy()
    first = len(fit.z) - len(at)
    information[first, first] = (10 / 8.1) ** 2
    assert allowed(replace(fit, information=information), kr90) == (group,)
    information[first + 1 : first + 3, first + 1 : first + 3] += 1e30  # a record without noise knows their sum
    assert allowed(replace(fit, information=information), kr90) == (group,)


def test_a_group_that_is_off_alone_is_excused_beside_the_others(kr90: Robot) -> None:
    """Directions took up what nodes within their tolerance left: 5 tolerances off alone, 1 beside free positions."""
    turned, moved = nodes(kr90, "direction"), nodes(kr90)
    tolerance = np.deg2rad(kr90.tolerances.direction_deg) * np.resize([1.0, -1.0], len(turned.own))
    at = np.array([p.mean for p in turned.own])
    alone = fitted(kr90, turned, at + 5 * tolerance)
    both = fitted(kr90, together(turned, moved), np.concatenate([at + tolerance, [p.mean for p in moved.own]]))
    assert excused(alone, [alone], kr90) == ()
    assert excused(alone, [alone, both], kr90) == (turned,)
    assert excused(fitted(kr90, moved, np.array([p.mean + 1.0 for p in moved.own])), [alone], kr90) == ()
    decision, beside = sifted(Decision([alone, both], [0.9, 0.05], 0.04, 0.01), kr90)
    assert (decision.ranked, decision.none) == ([], pytest.approx(0.99))
    assert beside is not None
    assert beside.hypothesis is both.hypothesis


def test_a_group_with_one_node_astray_is_that_node(kr90: Robot) -> None:
    """A blow 250 mm off was named as thirty-six coordinates of all nodes, though the same model with that node in a
    piece of its own has the others within their tolerance. Where more is off than that node, the group stays."""
    group = nodes(kr90)
    at = np.array([p.mean for p in group.own])
    near, blow = 0.003 * np.resize([1.0, -1.0], len(at)), np.array(["node:7" in p.name for p in group.own])
    whole = fitted(kr90, group, at + np.where(blow, 0.25, near))
    _, split = members(whole, group)

    def parted(off: np.ndarray) -> Fitted:
        means = np.array([p.mean for p in split.own])
        alone = np.array(["node:7" in p.name for p in split.own])
        return fitted(kr90, split, means + np.where(alone, 0.25, off[: len(means)]))

    decision, _ = sifted(Decision([whole, parted(near)], [0.9, 0.05], 0.04, 0.01), kr90)
    assert [[piece.key for piece in fit.hypothesis.pieces] for fit in decision.ranked] == [
        [p.key for p in split.pieces]
    ]
    assert [piece.site for piece in decision.ranked[0].allowed] == ["node:*.position"]
    assert decision.probability == [pytest.approx(0.95)]
    both = [whole, parted(50 * near)]
    assert sifted(Decision(both, [0.9, 0.05], 0.04, 0.01), kr90)[0].ranked == both


@pytest.mark.parametrize(("gain", "deviations", "may"), [(5.0, 1.0, False), (9.0, 1.0, True), (-17.0, 7.1, True)])
def test_a_size_is_sought_where_it_could_get_a_name(kr90: Robot, gain: float, deviations: float, may: bool) -> None:
    """What a fit gains and the tension of its size are all that a wider prior could give: 8 in ln likelihood names."""
    soft = entry_hypothesis(kr90, "servo_compliance", "joint2", SERVO)
    bare, fit = fitted(kr90, NONE, np.zeros(0)), fitted(kr90, soft, np.array(list(SERVO.values())))
    z = fit.z.copy()
    z[len(z) - len(soft.own)] = deviations
    search: Any = SimpleNamespace(base=replace(bare, cost=100.0), fits={})
    assert _may_be_seen(replace(fit, z=z, cost=100.0 - gain), search) is may


def test_a_mass_that_outgrows_the_robot_under_a_wider_prior_keeps_the_size_it_had(
    monkeypatch: pytest.MonkeyPatch, kr90: Robot
) -> None:
    """The fit itself is no heavier than it was: dropped with its size, it left the answer to what had less evidence."""
    tool = entry_hypothesis(kr90, "payload", "flange", {"mass": 40.0, "com": [1.6, 0.0, 0.0]})
    light, heavy = (fitted(kr90, tool, np.array([mass, 1.6, 0.0, 0.0])) for mass in (40.0, 4000.0))
    assert heavy.too_heavy
    assert not light.too_heavy
    monkeypatch.setattr(search_module, "of_its_size", lambda *_: heavy)
    monkeypatch.setattr(search_module, "_may_be_seen", lambda *_: True)
    base = fitted(kr90, NONE, np.zeros(0))
    search = Search(base, [], base.z, 0.0, {tool.identity: light})
    sample = SimpleNamespace(recordings=[SimpleNamespace(setup=SimpleNamespace(q=np.zeros(3)))])
    assert search_module.settle(kr90, search, sample) == [light, base]  # type: ignore[arg-type]


@pytest.mark.parametrize(("gain", "better"), [(5.0, False), (200.0, True)])
def test_moments_of_a_payload_have_to_pay_for_themselves(kr90: Robot, gain: float, better: bool) -> None:
    """Three numbers that the data hold exactly cost more evidence than 5 in ln likelihood."""
    own = {"mass": 40.0, "com": [1.6, 0.0, 0.0]}
    point = entry_hypothesis(kr90, "payload", "flange", own)
    body = entry_hypothesis(kr90, "payload", "flange", {**own, "inertia": [1.0, 1.0, 1.0]})
    before = replace(fitted(kr90, point, np.array([40.0, 1.6, 0.0, 0.0])), cost=500.0, misfit=10.0)
    after = fitted(kr90, body, np.array([40.0, 1.6, 0.0, 0.0, 1.0, 1.0, 1.0]))
    after = replace(after, cost=500.0 - gain, misfit=10.0 - 2 * gain / before.data)
    assert _better(after, before) is better
    assert _better(replace(after, cost=after.cost - 1), after)  # the same numbers: the lower cost


def test_laws_that_cannot_be_off_cast_no_doubt(kr90: Robot) -> None:
    """What a turned sensor explains is exact; what a soft bearing explains may be off by a share of it."""
    turned, soft = nodes(kr90, "direction"), entry_hypothesis(kr90, "servo_compliance", "joint2", SERVO)
    bare = fitted(kr90, NONE, np.zeros(0))
    sensor, spring = fitted(kr90, turned, np.zeros(len(turned.own))), fitted(kr90, soft, np.array(list(SERVO.values())))
    fits, bare = {one.hypothesis.identity: one for one in (sensor, spring)}, replace(bare, misfit=1e5)
    assert inexact(fits[frozenset([turned.key])], bare, fits) == 0
    left = replace(fits[frozenset([soft.key])], misfit=3.0)
    assert inexact(left, bare, fits) > 5


def test_a_law_that_leaves_no_misfit_is_off_by_next_to_nothing(kr90: Robot) -> None:
    """However much it gains: of what it is off by, 0.15 of its misfit, a floor that gained 5e8 hid a soft bearing."""
    soft = entry_hypothesis(kr90, "servo_compliance", "joint2", SERVO)
    bare = replace(fitted(kr90, NONE, np.zeros(0)), misfit=1e7, data=20000)
    fit = replace(fitted(kr90, soft, np.array(list(SERVO.values()))), data=20000)
    assert inexact(fit, bare, {}) == pytest.approx(0.15 * 0.5 * 2 * np.sqrt(2 * 20000))
    assert inexact(replace(fit, misfit=1.4), bare, {}) == pytest.approx(0.15 * 0.5 * (0.4 * 20000 + 200 * 2))
    assert inexact(bare, bare, {}) == 0
    leaking = replace(bare, exact=False)  # no model predicts that recording exactly, the bare one neither
    assert inexact(leaking, leaking, {}) == pytest.approx(
        0.15 * 0.5 * (max(bare.misfit - 1, 0) * bare.data + 2 * np.sqrt(2 * bare.data))
    )


def test_a_prediction_that_breaks_down_speaks_against_its_fit(kr90: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Predicting a kept posture met a singular matrix, and the whole diagnosis ended with it."""

    def broken(*_: object) -> Fitted:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(decide, "foreseen", broken)
    fit = fitted(kr90, NONE, np.zeros(0))
    assert decide._on_kept(fit, Sample(())).evidence() < -1e20


def test_a_blow_off_its_axis_is_a_finding_beyond_its_tolerance_alone(kr90: Robot) -> None:
    turned = entry_hypothesis(kr90, "hammer_misalignment", "hammer:7Y+", {"angles": [0.0, 0.0]})
    small, large = (fitted(kr90, turned, np.deg2rad([angle, 0.0])) for angle in (0.1, 1.0))
    assert allowed(small, kr90) == (turned,)
    assert allowed(large, kr90) == ()
    written = kr90.model_copy(update={"physics": [*kr90.physics, *turned.entries]})
    assert without(written, (turned,)).physics == kr90.physics


def test_answers_that_differ_in_what_is_allowed_are_one(kr90: Robot) -> None:
    """Half of a gain's probability came with nodes moved: it is the gain's; nodes alone say that nothing is missing."""
    group, gain = nodes(kr90), entry_hypothesis(kr90, "sensor_gain", "sensor:21X+", {"gain": 1.0})
    other = entry_hypothesis(kr90, "sensor_gain", "sensor:21Y+", {"gain": 1.0})
    at = np.array([p.mean for p in group.own])
    ranked = [
        fitted(kr90, together(gain, group), np.array([1.2, *at])), fitted(kr90, gain, np.array([1.2])),
        fitted(kr90, other, np.array([1.2])), fitted(kr90, group, at),
    ]  # fmt: skip
    decision, beside = sifted(Decision(ranked, [0.5, 0.3, 0.1, 0.05], 0.04, 0.01, alike=0.5), kr90)
    assert beside is not None
    assert beside.allowed == (group,)
    assert decision.probability == pytest.approx([0.8, 0.1])
    assert decision.none == pytest.approx(0.09)
    assert decision.alike == pytest.approx(0.8)
    same = Decision(ranked[1:3], [0.6, 0.3], 0.05, 0.05)
    assert sifted(same, kr90) == (same, None)


@pytest.mark.parametrize(("missed", "stays"), [(99.0, True), (101.0, False)])
def test_a_second_effect_that_foretells_no_blow_is_no_answer(
    kr90: Robot, monkeypatch: pytest.MonkeyPatch, missed: float, stays: bool
) -> None:
    """One posture, three blows: a bending link stood at 0.98 beside the right loss factor, and foretold them worse."""
    lossy = entry_hypothesis(kr90, "structural_damping", "joint2.z", {"loss_factor": 0.1})
    soft, turned = entry_hypothesis(kr90, "servo_compliance", "joint2", SERVO), nodes(kr90, "direction")
    loss, spring, turn = [0.1], list(SERVO.values()), [0.1] * len(turned.own)
    fits = [
        fitted(kr90, together(lossy, soft), np.array(loss + spring)),
        fitted(kr90, together(lossy, turned), np.array(loss + turn)), fitted(kr90, lossy, np.array(loss)),
    ]  # fmt: skip
    both, beside, alone = fits
    energy, module = {id(both): missed, id(beside): 200.0, id(alone): 100.0}, sys.modules[that_foretell.__module__]
    monkeypatch.setattr(module, "_missed", lambda fit, sample: (energy[id(fit)], 1))
    monkeypatch.setattr(module, "blows_of", lambda sample: ("1", "2", "3"))
    kept = that_foretell(fits, Sample(()), 1e9)
    assert kept == ([both, beside, alone] if stays else [beside, alone])  # a turned sensor is of the test alone
    assert that_foretell([beside, both, alone], Sample(()), -1e9) == [beside, both, alone]
    monkeypatch.setattr(module, "blows_of", lambda sample: ())
    assert that_foretell(fits, Sample(()), 1e9) == fits  # too few to leave one out


@pytest.mark.parametrize(("takes_off", "stays"), [(2.0, False), (20.0, True)])
def test_tension_alone_names_nothing_beside_a_name(kr90: Robot, takes_off: float, stays: bool) -> None:
    """Beside a gain, a spring far from its description: an answer only where recordings are missed by less with it."""
    gain = entry_hypothesis(kr90, "sensor_gain", "sensor:21X+", {"gain": 1.0})
    spring = Hypothesis("parameter", "joint2.y.stiffness", scale=(("joint2.y.stiffness", 10.0),))
    one, two = (fitted(kr90, some, np.array([1.2])) for some in (gain, together(gain, spring)))
    k = two.parameters.names.index("joint2.y.stiffness")
    one.z[k], two.z[k] = 4.0, 0.4  # its tolerance is ten times as wide
    one, two = (
        replace(f, cost=0.5 * float(f.z @ f.z) + missed) for f, missed in ((one, 100.0), (two, 100 - takes_off))
    )
    assert that_show([two, one], kr90) == ([two, one] if stays else [one])
    assert that_show([two], kr90) == [two]  # nothing to compare it with


@pytest.mark.parametrize(("frequency_hz", "heard"), [(20.0, True), (101.0, True), (126.6, False), (1.0, False)])
def test_a_mode_that_no_line_holds_is_no_answer(kr90: Robot, frequency_hz: float, heard: bool) -> None:
    """What swings above the band moves FRFs as a mass does, or as errors of a recorder do."""
    hose = entry_hypothesis(
        kr90, "attached_resonator", "link2",
        {"mass": 1.0, "frequency_hz": 20.0, "damping_ratio": 0.02, "axis": "y", "position": [0.5, 0.0, 0.0]},
    )  # fmt: skip
    fit = fitted(kr90, hose, np.array([1.0, frequency_hz, 0.02, 0.5, 0.0, 0.0]))
    assert that_show([fit], kr90, (5.0, 100.0)) == ([fit] if heard else [])
    assert that_show([fit], kr90) == [fit]


@pytest.mark.parametrize(("place_m", "there"), [(0.2, True), (-3.5, False)])
def test_a_mass_metres_off_its_link_is_no_answer(kr90: Robot, place_m: float, there: bool) -> None:
    """A rotor of 6 kg·m² on a soft shaft, which has no name, was named as half a kilogram 3.5 m beside the link."""
    hose = entry_hypothesis(
        kr90, "attached_resonator", "link2",
        {"mass": 0.5, "frequency_hz": 15.0, "damping_ratio": 0.03, "axis": "x", "position": [0.5, 0.0, 0.0]},
    )  # fmt: skip
    fit = fitted(kr90, hose, np.array([0.5, 15.0, 0.03, 0.9, place_m, 0.0]))
    assert that_show([fit], kr90) == ([fit] if there else [])


def test_a_sensor_and_a_blow_of_one_label_may_be_apart(kr90: Robot, milling: np.ndarray) -> None:
    """MuJoCo predicts what the algebra does where a fit has moved and turned the one and not the other."""
    turned = np.array([[0.1, -0.05, 1.0], [0.0, 1.0, 0.2]])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    moved = Channels(BLOWS.label, BLOWS.body, BLOWS.position + np.array([[0.02, 0, 0], [0, 0, 0]]), turned)
    record = SimpleNamespace(
        posture="p", q=milling, brakes="on", response=SENSORS, excitation=moved, quantity="accelerance"
    )
    lines = np.array([8.0, 20.0, 40.0])
    H, expected = (predicted(kr90, record, lines) for predicted in (predicted_by_mujoco, predicted_by_algebra))  # type: ignore[operator]
    assert np.linalg.norm(H - expected) < 1e-6 * np.linalg.norm(expected)


def test_a_floor_whose_moments_no_body_has_is_written_with_as_many(kr90: Robot) -> None:
    """Its three moments stay three: six were no floor's."""
    floor = Entry(effect="floor_mode", site="base", mass=500.0, inertia=[10.0, 10.0, 90.0], rx=1e7, damping_ratio=0.03)
    written = as_written(kr90.model_copy(update={"physics": [*kr90.physics, floor]}), kr90).physics[-1]
    xx, yy, zz = written.values["inertia"]
    assert zz <= (xx + yy) * (1 + 1e-9)


@pytest.mark.parametrize(("after", "believed"), [(1.0, True), (1.2, True), (2.3, False)])
def test_a_name_that_explains_little_of_what_tolerances_leave_is_doubted(
    kr90: Robot, after: float, believed: bool
) -> None:
    """Of a misfit of 2.4 beside everything that is allowed, a name must take most to be one."""
    gain = entry_hypothesis(kr90, "sensor_gain", "sensor:21X+", {"factor": 1.2})
    base = replace(fitted(kr90, nodes(kr90), np.zeros(len(nodes(kr90).own))), misfit=2.4, data=10_000)
    best = replace(fitted(kr90, gain, np.array([1.2])), misfit=after, data=10_000)
    decision = in_doubt_beside(Decision([best], [0.99], 0.0, 0.01), base, None)
    assert (decision.probability[0] > 0.5) is believed
    assert sum(decision.probability) + decision.none + decision.other == pytest.approx(1.0)


@pytest.mark.parametrize(("mass", "heavy"), [(500.0, False), (3.3e7, True)])
def test_what_hangs_on_a_robot_is_no_heavier_than_it(kr90: Robot, mass: float, heavy: bool) -> None:
    """A resonator of 33 thousand tonnes on link 1 once stood for a damper that is not in the vocabulary."""
    values = {"mass": mass, "frequency_hz": 18.0, "damping_ratio": 1.0, "axis": "y", "position": [0.0, 0.0, 0.0]}
    piece = entry_hypothesis(kr90, "attached_resonator", "link1", values)
    parameters = piece.parameters(free_parameters(kr90))
    z = np.zeros(len(parameters))
    eye = np.eye(len(z))
    fit = Fitted(piece, parameters, z, parameters.values(z), kr90, 0.0, 1.0, eye, 1.0, True)
    assert fit.too_heavy is heavy
    assert np.isneginf(fit.evidence()) == heavy
    search = Search(fit, [], z, 0.0, {piece.identity: fit})
    assert search.finalists == ([] if heavy else [fit])  # a report cannot write its evidence


def test_a_node_far_off_is_a_site(kr90: Robot) -> None:
    """By its name, though a blow's label or a sensor's tells which point is meant."""
    group = nodes(kr90)
    at = np.array([p.mean for p in group.own])
    blow = np.array([p.name == "node:7Y+.excitation.z" for p in group.own])
    _, note = taken_in((group,), fitted(kr90, group, at + 0.02 * blow))
    assert "blow 7Y+ by 20.0 mm" in note
    assert note.sites == ("node:7.position",)


@pytest.mark.parametrize(("nameless", "ends"), [(40.0, True), (20.0, False)])
def test_things_that_gain_less_than_a_law_without_a_name_stand_for_it(
    monkeypatch: pytest.MonkeyPatch, kr90: Robot, nameless: float, ends: bool
) -> None:
    """Two of them, that is: beside one the second may be what is missing. What is allowed does not count."""
    monkeypatch.setattr(search_module, "allowed", lambda fit, robot: fit.hypothesis.pieces[2:])
    base = SimpleNamespace(evidence=lambda: -100.0)
    search = SimpleNamespace(base=base, lawless=lambda fit, sample: {"joint3.z": nameless, "joint1.z": 1.0})

    def best(pieces: int) -> SimpleNamespace:
        return SimpleNamespace(hypothesis=SimpleNamespace(pieces=tuple(range(pieces))), evidence=lambda: -70.0)

    assert _stand_ins(kr90, search, best(2), None) is ends  # type: ignore[arg-type]
    assert _stand_ins(kr90, search, best(3), None) is ends  # type: ignore[arg-type]
    assert not _stand_ins(kr90, search, best(1), None)  # type: ignore[arg-type]


@pytest.mark.parametrize(("mass", "is_allowed"), [(8.0, True), (80.0, False)])
def test_a_small_payload_on_a_link_that_bends_is_no_finding(kr90: Robot, mass: float, is_allowed: bool) -> None:
    """Three numbers do not say all of how a link's mass is divided at its hinge: a body of its tolerance's size may be
    that. A heavy one is a finding, and so is a light one where nothing bends."""
    bends = entry_hypothesis(kr90, "link_flexibility", "link2.z", {"stiffness": 1e7, "damping": 4e3})
    load = entry_hypothesis(kr90, "payload", "link2", {"mass": 20.0, "com": [0.5, 0.0, 0.1]})
    sizes = [*(p.mean for p in bends.own), mass, *(p.mean for p in load.own[1:])]
    assert allowed(fitted(kr90, together(bends, load), np.array(sizes)), kr90) == ((load,) if is_allowed else ())
    assert allowed(fitted(kr90, load, np.array(sizes[len(bends.own) :])), kr90) == ()
