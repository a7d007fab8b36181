"""Inverse kinematics against closed forms, and there and back."""

import numpy as np
import pytest

from twin.errors import InputError
from twin.robot.description import load_robot, parse_robot
from twin.robot.inverse_kinematics import ToolPlace, inverse_kinematics, limits, tool_frames

TOOL = ToolPlace(np.array([0.1, 0.05, 0.2]), np.array([0.0, 0.0, 1.0]))


def _planar(a=0.8, b=0.6):
    """Two revolute axes in a plane, the tip b beyond the second."""
    link = {"mass": 1, "com": [0, 0, 0], "inertia": [1, 1, 1, 0, 0, 0]}
    axes = [{"a": 0.0, "limits": {"position": [-3.1, 3.1]}}, {"a": a, "limits": {"position": [0.01, 3.1]}}]
    robot = parse_robot({"name": "planar", "links": [link, link], "axes": axes})
    return robot, ToolPlace(np.array([b, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))


def test_two_links_in_a_plane_follow_the_law_of_cosines():
    robot, tool = _planar()
    rng = np.random.default_rng(0)
    x, y = 0.9 * np.cos(t := rng.uniform(-2, 2, 50)), 0.9 * np.sin(t)
    found = inverse_kinematics(robot, np.stack([x, y, 0 * x], axis=1), tool)
    elbow = np.arccos((0.81 - 0.8**2 - 0.6**2) / (2 * 0.8 * 0.6))
    assert found.reached.all()
    np.testing.assert_allclose(found.q[:, 1], elbow, atol=1e-9)
    shoulder = t - np.arctan2(0.6 * np.sin(elbow), 0.8 + 0.6 * np.cos(elbow))
    np.testing.assert_allclose(found.q[:, 0], shoulder, atol=1e-9)


def test_out_of_reach_ends_at_the_nearest_point():
    robot, tool = _planar()
    found = inverse_kinematics(robot, np.array([[2.0, 0.0, 0.0]]), tool)
    assert not found.reached[0]
    assert found.distance[0] == pytest.approx(0.6, abs=1e-4)  # the arm is 1.4 m long


def test_three_axes_there_and_back():
    robot = load_robot("kr90")
    low, high = limits(robot)
    q = np.random.default_rng(1).uniform(low, high, (300, 3))
    tip, *_ = tool_frames(robot, q, TOOL)
    found = inverse_kinematics(robot, tip, TOOL)
    assert found.reached.all()
    again, *_ = tool_frames(robot, found.q, TOOL)
    np.testing.assert_allclose(again, tip, atol=1e-6)
    assert (found.q >= low).all()
    assert (found.q <= high).all()


def test_six_axes_hold_the_tools_direction():
    robot = load_robot("tests/data/arm6.urdf")
    low, high = limits(robot)
    q = np.random.default_rng(2).uniform(low, high, (40, 6))
    tip, turn, _ = tool_frames(robot, q, TOOL)
    found = inverse_kinematics(robot, tip, TOOL, axis=turn @ TOOL.axis)
    assert found.reached.mean() > 0.95
    again, turned, _ = tool_frames(robot, found.q, TOOL)
    there = found.reached
    np.testing.assert_allclose(again[there], tip[there], atol=1e-6)
    np.testing.assert_allclose((turned @ TOOL.axis)[there], (turn @ TOOL.axis)[there], atol=1e-6)


def test_a_robot_of_three_axes_cannot_hold_a_direction():
    with pytest.raises(InputError, match="3 axes cannot hold"):
        inverse_kinematics(load_robot("kr90"), np.array([[1.5, 0, 1]]), TOOL, axis=np.array([0, 0, 1.0]))
