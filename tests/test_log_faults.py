"""Logs whose axes or torques are counted otherwise than the description does, of a six-axis arm of the truth code."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tools.study_payload import Load, simulated
from twin.diagnose.torque_faults import sound
from twin.errors import Told
from twin.identify.rigid_compare import LogComparison
from twin.measure.motion_log import MotionLog, MotionRun
from twin.robot.description import Robot

HEAVY = Load(12.0, (0.05, -0.04, 0.15))


@pytest.fixture(scope="module", params=[None, HEAVY], ids=["as described", "with a payload that nobody described"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, MotionLog]:
    return simulated("six", tmp_path_factory.mktemp("arm"), np.random.default_rng(3), request.param)


def counted(log: MotionLog, sense: list[int], zero_deg: list[float], torque: list[int], unit: float = 1.0) -> MotionLog:
    """The log as a controller records it that counts otherwise; ``torque`` is what cables have exchanged beside."""

    def run(a: MotionRun) -> MotionRun:
        assert a.torque is not None
        position = np.array(sense) * (a.position - np.deg2rad(zero_deg)) * unit
        return replace(a, position=position, torque=np.array(sense) * np.array(torque) * a.torque)

    return replace(log, runs={name: run(a) for name, a in log.runs.items()})


ONES, NONE = [1] * 6, [0.0] * 6


@pytest.mark.parametrize(
    ("sense", "zero_deg", "torque", "unit", "kinds"),
    [
        (ONES, NONE, ONES, 1.0, []),
        ([1, -1, 1, 1, 1, 1], NONE, ONES, 1.0, ["axis_reversed"]),
        ([1, 1, -1, 1, -1, 1], NONE, ONES, 1.0, ["axis_reversed"]),
        (ONES, [0, -90, 90, 0, 0, 0], ONES, 1.0, ["axis_zero"]),
        (ONES, NONE, [1, 1, -1, 1, 1, -1], 1.0, ["reversed_channel"]),
        ([1, -1, 1, 1, 1, 1], NONE, [1, 1, 1, 1, -1, 1], 1.0, ["axis_reversed", "reversed_channel"]),
        ([1, -1, 1, 1, 1, 1], NONE, ONES, 180 / np.pi, ["axis_reversed", "unit"]),
    ],
)  # fmt: skip
def test_axes_and_torques_are_counted_as_the_description_does(
    arm: tuple[Robot, MotionLog], sense: list[int], zero_deg: list[float], torque: list[int], unit: float,
    kinds: list[str],
) -> None:  # fmt: skip
    """An axis that was counted the other way round gave rotor inertia, friction and torque constants of 0.99."""
    robot, log = arm
    found, notes = sound(counted(log, sense, zero_deg, torque, unit), robot)
    assert sorted(note.kind for note in notes) == kinds
    for name, run in log.runs.items():
        np.testing.assert_allclose(found.runs[name].position, run.position, atol=1e-9)
        assert run.torque is not None
        np.testing.assert_allclose(np.asarray(found.runs[name].torque), run.torque, atol=1e-9)


def test_the_sense_of_a_last_axis_that_may_carry_anything_is_told_where_its_load_shows_it(
    arm: tuple[Robot, MotionLog], request: pytest.FixtureRequest
) -> None:
    robot, log = arm
    notes = sound(counted(log, [1, 1, 1, 1, 1, -1], NONE, ONES), robot)[1]
    assert len(notes) == ("payload" in request.node.name)


@pytest.mark.parametrize("moving", [[0], [1], [0, 1, 2, 3, 4]])
def test_axes_at_rest_tell_nothing(arm: tuple[Robot, MotionLog], moving: list[int]) -> None:
    """Nothing is left of the columns of such an axis, which ended the process in SciPy."""
    robot, log = arm
    share = np.isin(np.arange(6), moving)
    still = replace(log, runs={name: replace(run, position=share * run.position) for name, run in log.runs.items()})
    assert sound(still, robot)[1] == []


def test_a_trajectory_tells_nothing_of_torque(arm: tuple[Robot, MotionLog]) -> None:
    robot, log = arm
    bare = replace(log, runs={name: replace(run, torque=None) for name, run in log.runs.items()})
    assert sound(bare, robot) == (bare, [])


def test_compare_and_identify_tell_it_too(tmp_path: Path) -> None:
    robot, log = simulated("six", tmp_path, np.random.default_rng(3), None)
    wrong = counted(log, [1, -1, 1, 1, 1, 1], NONE, ONES)
    with pytest.warns(Told, match="joint2: position and torque"):
        again = twin.compare(wrong, robot=robot)
    right, again = (next(iter(result.found.values())) for result in (twin.compare(log, robot=robot), again))
    assert isinstance(right, LogComparison)
    assert isinstance(again, LogComparison)
    assert again.error == pytest.approx(right.error)
    with pytest.warns(Told, match="joint2: position and torque"):
        found = twin.identify(wrong, robot=robot)
    assert found.data()["error"] == twin.identify(log, robot=robot).data()["error"]
