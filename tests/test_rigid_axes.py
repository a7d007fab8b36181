"""An axis that a description calls rigid, of a robot whose gears give way."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tools.truth.__main__ import main
from tools.truth.chain import kr90 as true_kr90
from tools.truth.recording import HammerTest, draw_postures, draw_truth, streams, write_campaign
from twin.diagnose.hypotheses import together
from twin.diagnose.rigid_axes import rigid_axes
from twin.identify.fitting import _of_rigid_axes
from twin.model.parameters import free_parameters, written_names
from twin.robot.description import Robot


def with_rigid(robot: Robot, *axes: int) -> Robot:
    given = robot.model_copy(deep=True)
    for axis in axes:
        given.axes[axis].stiffness, given.axes[axis].damping = None, 0.0
    return given


def test_a_gear_is_written_as_its_axis_own_number(kr90: Robot) -> None:
    given = with_rigid(kr90, 1, 2)
    (second,), (third,) = rigid_axes(given)
    assert (second.key, third.key) == ("parameter@joint2.z.stiffness", "parameter@joint3.z.stiffness")
    both = together(second, third)
    robot, parameters = both.robot(given), both.parameters(free_parameters(given))
    assert robot.physics == given.physics
    assert all(axis.stiffness for axis in robot.axes)
    own = [p.name for p in written_names(parameters)][-4:]
    assert own == ["joint2.z.stiffness", "joint2.z.damping", "joint3.z.stiffness", "joint3.z.damping"]
    values = parameters.values(np.zeros(len(parameters)))
    values[-4] = 1.25e6
    assert parameters.apply(robot, values).axes[1].stiffness == pytest.approx(1.25e6)


def test_an_axis_with_a_gear_is_no_suspect(kr90: Robot) -> None:
    assert rigid_axes(kr90) == []


def test_a_slide_starts_from_what_it_carries(kr90: Robot) -> None:
    """What all it carries weighs decides; units are those of a slide."""
    given = with_rigid(kr90, 0)
    given.axes[0].type = "prismatic"
    ((slide,),) = rigid_axes(given)
    carried = sum(link.inertial[0] for link in given.links)
    assert slide.own[0].mean == pytest.approx(carried * (2 * np.pi * 40.0) ** 2)
    assert [p.unit for p in slide.own] == ["N/m", "N·s/m"]


def test_a_fit_says_which_axes_it_takes_as_rigid(kr90: Robot) -> None:
    assert _of_rigid_axes(kr90) == ""
    assert "gear of joint2, joint3 is as rigid" in _of_rigid_axes(with_rigid(kr90, 1, 2))


def recorded(folder: Path, *options: str) -> Path:
    path, short = folder / "frf.h5", ("--postures", "4", "--spacing-hz", "0.5", "--lines", "48")
    assert main(["campaign", "--out", str(path), *short, *options]) == 0
    return path


@pytest.mark.slow
def test_a_gear_that_the_description_lacks_is_found_and_written(tmp_path: Path, kr90: Robot) -> None:
    path = recorded(tmp_path, "--seed", "2", "--postures", "3", "--lines", "32")
    verdict = twin.diagnose(path, robot=with_rigid(kr90, 1))
    assert verdict.word == "named"
    (missing,) = verdict.missing
    assert missing.first.key == "parameter@joint2.z.stiffness"
    assert verdict.robot.axes[1].stiffness == pytest.approx(missing.first.parameters["stiffness"]["value"])
    error = verdict.findings[0].error
    assert error["after"]["held_out"] < 0.05 * error["before"]["held_out"]


@pytest.mark.slow
def test_two_gears_and_a_bearing_are_found_together(tmp_path: Path, kr90: Robot) -> None:
    given = with_rigid(kr90, 1, 2).without(["transverse_compliance@joint2.x"])
    verdict = twin.diagnose(recorded(tmp_path, "--seed", "3"), robot=given)
    found = {missing.first.key for missing in verdict.missing}
    assert found == {
        "parameter@joint2.z.stiffness", "parameter@joint3.z.stiffness", "transverse_compliance@joint2.x",
    }  # fmt: skip


@pytest.mark.slow
def test_an_axis_that_is_rigid_stays_so(tmp_path: Path, kr90: Robot) -> None:
    """The description is right: the axis has no gear that gives way."""
    chain = true_kr90()
    stiffness = chain.stiffness.copy()
    stiffness[2, 0] = np.inf
    postures = draw_postures(4, streams(5)[1])
    truth = draw_truth(5, (), postures, chain=replace(chain, stiffness=stiffness))
    write_campaign(tmp_path / "frf.h5", truth, postures, HammerTest(spacing_hz=0.5, lines=48), streams(5)[3])
    verdict = twin.diagnose(tmp_path / "frf.h5", robot=with_rigid(kr90, 2))
    assert verdict.word == "adequate"


@pytest.mark.slow
def test_a_search_that_is_ended_names_nothing_beside_what_it_misses(tmp_path: Path, kr90: Robot) -> None:
    """After the first thing found, what is left of the error passes for sensors that point elsewhere."""
    given = with_rigid(kr90, 2).without(["transverse_compliance@joint2.x"])
    verdict = twin.diagnose(recorded(tmp_path, "--seed", "1", "--postures", "5"), robot=given, minutes=0.0)
    assert verdict.word == "unexplained"
    (note,) = [note for note in verdict.findings[0].warnings if getattr(note, "kind", "") == "search_ended"]
    assert "It left out: further effects" in note
