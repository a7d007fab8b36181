"""A payload and its link move as one body: of all divisions the one that the prior finds least odd is taken."""

import numpy as np
import pytest

from twin.diagnose.hypotheses import entry_hypothesis
from twin.diagnose.parted import divided, on_a_described_link
from twin.model.parameters import free_parameters
from twin.robot.bodies import fuse
from twin.robot.description import load_robot

LOAD = 40.0, np.array([1.7, -0.25, 0.1])


def _setting():
    robot = load_robot("kr90")
    piece = entry_hypothesis(robot, "payload", "flange", {"mass": 40.0, "com": [1.615, -0.041, 0.0]})
    return robot, piece, piece.parameters(free_parameters(robot))


def _whole(robot, parameters, z, piece):
    written = parameters.apply(piece.robot(robot), parameters.values(z))
    own = {p.name: v for p, v in zip(parameters, parameters.values(z), strict=True) if p.name.startswith(piece.key)}
    mass, *com = own.values()
    return fuse(written.links[-1].inertial, (mass, np.array(com), np.zeros((3, 3))))


def _with(parameters, piece, robot, mass, com):
    """z of a payload, and of the link that together with it moves as the described link with ``LOAD``."""
    inertial = robot.links[-1].inertial
    whole = fuse(inertial, (LOAD[0], LOAD[1], np.zeros((3, 3))))
    left, centre, inertia = fuse(whole, (-mass, np.array(com), np.zeros((3, 3))))
    six = {pair: inertia["xyz".index(pair[0]), "xyz".index(pair[1])] for pair in ("xx", "yy", "zz", "xy", "xz", "yz")}
    values = dict(zip(parameters.names, parameters.values(np.zeros(len(parameters))), strict=True))
    values |= {"link3.mass": left} | {f"link3.com.{x}": c for x, c in zip("xyz", centre, strict=True)}
    values |= {f"link3.inertia.{pair}": value for pair, value in six.items()}
    values |= dict(zip([p.name for p in piece.own], [mass, *com], strict=True))
    return parameters.coordinates(np.array([values[name] for name in parameters.names]))


def test_a_payload_that_was_put_to_the_wrong_side_is_put_right():
    robot, piece, parameters = _setting()
    z = _with(parameters, piece, robot, 30.0, [1.4, 0.3, -0.1])
    assert 0.5 * z @ z > 50  # the link is far from its description
    found, fall = divided(robot, parameters, z, piece, present=True)
    assert fall == pytest.approx(0.5 * z @ z - 0.5 * found @ found, rel=1e-6)
    assert 0.5 * found @ found < 0.1 * (0.5 * z @ z)
    values = dict(zip(parameters.names, parameters.values(found), strict=True))
    own = [values[p.name] for p in piece.own]
    assert own[0] == pytest.approx(LOAD[0], rel=0.15)
    assert own[1:] == pytest.approx(LOAD[1], abs=0.1)


def test_the_whole_that_moves_stays_the_same():
    robot, piece, parameters = _setting()
    z = _with(parameters, piece, robot, 30.0, [1.4, 0.3, -0.1])
    found, _ = divided(robot, parameters, z, piece, present=True)
    for before, after in zip(_whole(robot, parameters, z, piece), _whole(robot, parameters, found, piece), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)


def test_all_that_a_link_is_off_by_may_be_the_payload():
    robot, piece, parameters = _setting()
    z = _with(parameters, piece, robot, 30.0, [1.4, 0.3, -0.1])
    found, fall = on_a_described_link(robot, parameters, z, piece)
    link = [k for k, name in enumerate(parameters.names) if name.startswith("link3.")]
    assert fall == pytest.approx(0.5 * z[link] @ z[link])
    np.testing.assert_array_equal(found[link], 0.0)
    own = parameters.values(found)[-len(piece.own) :]
    assert own[0] == pytest.approx(LOAD[0])
    assert own[1:] == pytest.approx(LOAD[1])


def test_a_link_that_weighs_less_than_described_leaves_no_payload():
    robot, piece, parameters = _setting()
    z = np.zeros(len(parameters))
    z[parameters.names.index("link3.mass")] = -15.0
    z[parameters.names.index("payload@flange.mass")] = -3.0
    assert on_a_described_link(robot, parameters, z, piece) is None


def test_what_is_no_part_of_a_link_is_left_alone():
    robot, _, _ = _setting()
    spring = entry_hypothesis(robot, "base_compliance", "base.rx", {"stiffness": 1e8, "damping": 1e4})
    parameters = spring.parameters(free_parameters(robot))
    assert divided(robot, parameters, np.zeros(len(parameters)), spring, present=True) is None
    assert on_a_described_link(robot, parameters, np.zeros(len(parameters)), spring) is None
