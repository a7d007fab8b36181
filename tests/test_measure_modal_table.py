"""The modal table: YAML 1.2 in, YAML 1.2 out."""

from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.measure.campaign import Channels
from twin.measure.modal_table import ModalTable, TableMode, TablePosture, read_modal_table, write_modal_table

PAPER = """
robot: kr90
postures:
  milling: {q_deg: [0, 70, -100], modes: [{frequency_hz: 10.0, damping_percent: 1.4}, {frequency_hz: 1.1e1, damping_percent: 1}]}
  on: {q_deg: [0, 135, 2e-4], modes: [{frequency_hz: 11, damping_percent: 0.7, shape: {21Z+: [1, 0], 4Y-: [-2e-1, 1.5e-3]}}]}
"""  # noqa: E501


def test_numbers_with_exponents_are_numbers_and_on_is_a_word(tmp_path: Path) -> None:
    (tmp_path / "t.yaml").write_text(PAPER)
    table = read_modal_table(tmp_path / "t.yaml")
    assert table.robot == "kr90"
    assert list(table.postures) == ["milling", "on"]
    assert table.postures["milling"].modes[1] == TableMode(11.0, 1.0)
    np.testing.assert_array_equal(table.postures["on"].q_deg, [0, 135, 2e-4])
    assert table.postures["on"].modes[0].shape == {"21Z+": 1 + 0j, "4Y-": -0.2 + 0.0015j}


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    modes = (TableMode(6.1e-5, 2e-4, 1e-9, 1e-12, {"21Z+": 1 + 0j, "4Y-": 1e-7 - 2j}), TableMode(4.5e4))
    postures = {"on": TablePosture(np.array([1e-9, -170.25]), modes), "none": TablePosture(np.zeros(1), ())}
    points = Channels(("21Z+", "4Y-"), ("link3", "base"), np.array([[0.1, 0, 2], [0, 0, 0]]), np.eye(3)[[2, 1]] * -1.0)
    table = ModalTable(postures, points=points)
    write_modal_table(tmp_path / "t.yaml", table)
    back = read_modal_table(tmp_path / "t.yaml")
    assert back.robot is None
    assert back.points is not None
    assert (back.points.label, back.points.body) == (points.label, points.body)
    np.testing.assert_array_equal(back.points.position, points.position)
    np.testing.assert_array_equal(back.points.direction, points.direction)
    assert back.postures["on"].modes == modes
    assert back.postures["none"].modes == ()
    np.testing.assert_array_equal(back.postures["on"].q_deg, table.postures["on"].q_deg)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("postures: [1]", "postures: expected a mapping"),
        ("robot: kr90", "postures: expected a mapping"),
        ("postures: {a: {modes: []}}", r"postures\.a\.q_deg: expected a list of numbers"),
        ("postures: {a: {q_deg: [0, yes], modes: []}}", "q_deg: expected a list of numbers"),
        ("postures: {a: {q_deg: [0]}}", r"modes: expected a list of modes"),
        ("postures: {a: {q_deg: [0], modes: [10.0]}}", r"modes\[0\]: expected frequency_hz"),
        ("postures: {a: {q_deg: [0], modes: [{frequency_hz: ten}]}}", "frequency_hz: expected a number, found 'ten'"),
        ("postures: {a: {q_deg: [0], modes: [{frequency_hz: -1}]}}", "frequency_hz: expected Hz above 0"),
        ("postures: {a: {q_deg: [0], modes: [{frequency_hz: 9, damping_percent: .nan}]}}", "damping_percent: expected"),
        ("postures: {a: {q_deg: [0], modes: [{frequency_hz: 9, shape: {21Z+: 1}}]}}", r"21Z\+: expected \[re, im\]"),
        ("points: [1]\npostures: {a: {q_deg: [0], modes: []}}", "points: expected a mapping of labels"),
        ("points: {21Z+: {body: link3}}\npostures: {a: {q_deg: [0], modes: []}}", "position: expected three numbers"),
        (
            "points: {21Z+: {body: link3, position: [0, 0, 0], direction: [0, 0, 2]}}\n"
            "postures: {a: {q_deg: [0], modes: []}}",
            "points/direction: expected unit vectors",
        ),
        ("postures: {a: ", "not valid YAML"),
    ],
)
def test_a_broken_table_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_modal_table(path)
    assert "\n" not in str(error.value)
