"""Pieces of a fit with numbers that what they are called cannot have, and what is tried instead."""

import numpy as np
import pytest

from twin.diagnose.cannot_be import cannot_be, may_be
from twin.diagnose.hypotheses import Hypothesis, entry_hypothesis, together
from twin.diagnose.refit import Fitted
from twin.model.parameters import free_parameters
from twin.physics import CATALOGUE
from twin.robot.description import Robot
from twin.robot.frames import between_links

BAND_HZ = (5.0, 80.0)
Q = np.array([0.3, -0.7, 0.9])


def fitted(robot: Robot, hypothesis: Hypothesis, **numbers: float) -> Fitted:
    """A hypothesis as described but for some numbers; a dot in their names is written as two underscores."""
    parameters = hypothesis.parameters(free_parameters(robot, ["p"], ["21Z+"]))
    values = parameters.values(np.zeros(len(parameters)))
    for name, value in numbers.items():
        values[parameters.names.index(name.replace("__", "."))] = value
    return Fitted(
        hypothesis, parameters, parameters.coordinates(values), values, robot, 1.0, 1.0, np.eye(len(values)), 100, True
    )


def payload(robot: Robot, place: list[float]) -> Fitted:
    one = entry_hypothesis(robot, "payload", "flange", CATALOGUE["payload"].typical(robot, "flange") or {})
    fit = fitted(robot, one)
    values = fit.values.copy()
    values[-4:] = [40.0, *place]
    return Fitted(
        one, fit.parameters, fit.parameters.coordinates(values), values, robot, 1.0, 1.0, fit.information, 100, True
    )


def test_a_mass_at_the_elbow_is_none_at_the_flange(kr90: Robot) -> None:
    """What hangs 1.4 m from the flange is tried on the other links, at the same place in space."""
    fit = payload(kr90, [0.02, 0.01, 0.0])
    assert cannot_be(fit, fit.hypothesis, BAND_HZ)
    found = may_be(kr90, fit, fit.hypothesis, free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ)
    assert [hypothesis.key for hypothesis, _ in found] == ["payload@link2", "payload@link1"]
    hypothesis, z = found[0]
    parameters = hypothesis.parameters(free_parameters(kr90, ["p"], ["21Z+"]))
    known = dict(zip(parameters.names, parameters.values(z), strict=True))
    assert known["payload@link2.mass"] == pytest.approx(40.0)
    there = between_links(kr90, Q, 2, 1, np.array([0.02, 0.01, 0.0]))
    assert [known[f"payload@link2.com[{k}]"] for k in range(3)] == pytest.approx(list(there))


def test_what_swings_keeps_its_direction_on_another_link(kr90: Robot) -> None:
    usual = CATALOGUE["attached_resonator"].typical(kr90, "link3") or {}
    one = entry_hypothesis(kr90, "attached_resonator", "link3", {**usual, "axis": [1.0, 0.0, 0.0]})
    fit = fitted(kr90, one, **{f"{one.key}.position[2]": 9.0})
    found = may_be(kr90, fit, one, free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ)
    assert {hypothesis.site for hypothesis, _ in found} == {"link1", "link2"}
    assert all(hypothesis.entries[0].values["axis"] == [1.0, 0.0, 0.0] for hypothesis, _ in found)


def test_a_mass_near_the_flange_stays_there(kr90: Robot) -> None:
    end = CATALOGUE["payload"].typical(kr90, "flange")
    assert end
    fit = payload(kr90, [x + 0.1 for x in end["com"]])
    assert not cannot_be(fit, fit.hypothesis, BAND_HZ)
    assert may_be(kr90, fit, fit.hypothesis, free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ) == []


def test_nothing_is_tried_that_the_answer_has_already(kr90: Robot) -> None:
    fit = payload(kr90, [0.02, 0.01, 0.0])
    other = entry_hypothesis(kr90, "payload", "link2", CATALOGUE["payload"].typical(kr90, "link2") or {})
    both = together(fit.hypothesis, other)
    numbers = {name: float(x) for name, x in zip(fit.parameters.names, fit.values, strict=True)}
    two = fitted(kr90, both, **numbers)
    found = may_be(kr90, two, both.pieces[0], free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ)
    assert [hypothesis.identity for hypothesis, _ in found] == [{"payload@link1", "payload@link2"}]


@pytest.mark.parametrize("site", ["joint1.x.damping", "joint*.damping"])
def test_a_damper_that_outweighs_its_spring_is_a_rigid_axis(kr90: Robot, site: str) -> None:
    """It is told as a spring that is stiffer than described; the dampers go back to where they were."""
    names = [n for n in free_parameters(kr90, ["p"], ["21Z+"]).names if n.endswith(".damping")]
    freed = names if "*" in site else [site]
    piece = Hypothesis("parameter", site, scale=tuple((name, 10.0) for name in freed))
    fit = fitted(kr90, piece, joint1__x__damping=1e9)
    assert cannot_be(fit, piece, BAND_HZ)
    ((hypothesis, z),) = may_be(kr90, fit, piece, free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ)
    assert hypothesis.key == "parameter@joint1.x.stiffness"
    parameters = hypothesis.parameters(free_parameters(kr90, ["p"], ["21Z+"]))
    known = dict(zip(parameters.names, parameters.values(z), strict=True))
    assert known["joint1.x.stiffness"] == pytest.approx(2 * np.pi * 20.0 * 1e9)
    described = dict(zip(fit.parameters.names, (p.mean for p in fit.parameters), strict=True))
    assert known["joint1.x.damping"] == pytest.approx(described["joint1.x.damping"])


def test_a_damper_ten_times_as_strong_is_a_damper(kr90: Robot) -> None:
    piece = Hypothesis("parameter", "joint1.x.damping", scale=(("joint1.x.damping", 10.0),))
    fit = fitted(kr90, piece)
    described = float(fit.values[fit.parameters.names.index("joint1.x.damping")])
    strong = fitted(kr90, piece, joint1__x__damping=10 * described)
    assert not cannot_be(strong, piece, BAND_HZ)
    assert may_be(kr90, strong, piece, free_parameters(kr90, ["p"], ["21Z+"]), Q, BAND_HZ) == []
