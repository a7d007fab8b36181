"""Tool paths: lengths by hand, what is refused."""

import numpy as np
import pytest

from twin.errors import InputError, Told
from twin.milling.toolpath import read_toolpath

POCKET = """%
(lines, two arcs, a full circle)
N10 G21 G90 G17
G0 X0 Y0 Z5
G1 Z-1 F500
X100
Y50
G3 X100 Y50 I-25 J0
G2 X50 Y0 R50
G91 G1 X-50
M30
"""


def _write(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_gcode_has_the_length_of_its_lines_and_arcs(tmp_path):
    path = read_toolpath(_write(tmp_path, "a.nc", POCKET))
    exact = 0.006 + 0.1 + 0.05 + 2 * np.pi * 0.025 + np.pi / 2 * 0.05 + 0.05
    assert path.along[-1] == pytest.approx(exact, rel=5e-4)  # chords of 5°
    np.testing.assert_allclose(path.position[-1], [0, 0, -0.001], atol=1e-12)
    fine = path.every(0.004)
    assert np.linalg.norm(np.diff(fine.position, axis=0), axis=1).max() <= 0.004 + 1e-12
    assert fine.along[-1] == pytest.approx(path.along[-1])


def test_apt_has_directions_and_continued_lines(tmp_path):
    text = "UNITS/MM\nFROM/0,0,100\nRAPID\nGOTO/0,0,10,0,0,1\nGOTO/100,0,0, $\n0,1,1\nGOTO/100,100,0\n"
    path = read_toolpath(_write(tmp_path, "a.apt", text))
    np.testing.assert_allclose(path.position[2], [0.1, 0, 0])
    np.testing.assert_allclose(path.axis[2], [0, 2**-0.5, 2**-0.5])
    assert path.cutting.tolist() == [False, False, True, True]


def test_csv_in_millimetres_and_metres_agree(tmp_path):
    a = read_toolpath(_write(tmp_path, "a.csv", "x_mm,y_mm,z_mm\n0,0,0\n100,0,0\n"))
    b = read_toolpath(_write(tmp_path, "b.csv", "x_m,y_m,z_m\n0,0,0\n0.1,0,0\n"))
    np.testing.assert_allclose(a.position, b.position)
    np.testing.assert_allclose(a.feed, [[1, 0, 0], [1, 0, 0]])


def test_a_unit_that_changes_in_the_midst_is_told(tmp_path):
    """`G2 0 Y20` is `G20 Y20`: blanks within a word mean nothing to a controller."""
    with pytest.warns(Told, match="line 3: the unit changes to inches"):
        read_toolpath(_write(tmp_path, "a.nc", "G21\nG1 X0 Y0\nG2 0 Y2\n"))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.nc", "G1 X1\nG5 X2\n", "line 2: G5 is not read"),
        ("a.nc", "G1 X1 Y\n", "line 1: expected words"),
        ("a.nc", "G21\nG1 X0\nG1 X10 R20\n", "line 3: R: belongs to an arc"),
        ("a.nc", "G0 X0 Y0\nG2 X10 Y0 I3 J0\n", "line 2: the arc's ends"),
        ("a.nc", "G0 X0\nG0 X10\n", "all moves are rapid"),
        ("a.csv", "x,y,z\n0,0,0\n", "line 1: expected a header"),
        ("a.csv", "x_m,y_m,z_m\n0,0,0\n500,0,0\n", "is the unit right"),
        ("a.apt", "GOTO/0,0,0\nCIRCLE/1,2,3\n", "line 2: CIRCLE is not read"),
        ("a.step", "", "expected a tool path"),
    ],
)
def test_what_cannot_be_followed_is_refused_in_one_line(tmp_path, name, text, said):
    with pytest.raises(InputError, match=said):
        read_toolpath(_write(tmp_path, name, text))
