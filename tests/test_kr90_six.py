"""The six-axis KR90: with its wrist locked it is the paper's robot, and the wrist is the maker's."""

from types import SimpleNamespace

import numpy as np
import pytest

from tools import make_six
from twin.model.linear import linearise
from twin.model.modes import Modes, modes
from twin.model.regressor import flange_path
from twin.model.replay import inverse_dynamics
from twin.physics import CATALOGUE
from twin.physics.motion import Motion
from twin.robot.description import Robot, load_robot
from twin.robot.mechanism import assemble

POSTURES = ([0, 70, -100], [0, 135, -100], [0, 135, -140])


def locked() -> Robot:
    """Without its spindle, and rigid from axis 4 on."""
    six = load_robot("kr90_six")
    tilts = [f"transverse_compliance@joint{i}.{axis}" for i in (4, 5, 6) for axis in "xy"]
    six = six.without(["payload", *tilts])
    wrist = [axis.model_copy(update={"stiffness": None}) for axis in six.axes[3:]]
    return six.model_copy(update={"axes": [*six.axes[:3], *wrist]})


def modes_at(robot: Robot, q_deg: list[float]) -> Modes:
    return modes(linearise(assemble(robot, robot.angles(q_deg))))


@pytest.mark.parametrize("q_deg", POSTURES)
def test_with_axes_4_to_6_locked_the_paper_s_modes_come_out(q_deg: list[float]) -> None:
    """Damping differs by a tenth of a per cent at most: two of three coincident hinges change places under gravity."""
    ours, paper = modes_at(locked(), [*q_deg, 0, 0, 0]), modes_at(load_robot("kr90"), q_deg)
    np.testing.assert_allclose(ours.frequency_hz, paper.frequency_hz, rtol=1e-4)
    np.testing.assert_allclose(ours.damping_percent, paper.damping_percent, rtol=2e-3)


def test_with_axes_4_to_6_at_rest_the_torques_are_the_three_axis_robot_s() -> None:
    rng = np.random.default_rng(4)
    q, v, a = rng.uniform([-1, 0.5, -2], [1, 2, 1], (20, 3)), rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    rest = np.zeros((20, 3))
    six, kr90 = load_robot("kr90_six").without(["payload"]), load_robot("kr90")
    ours = inverse_dynamics(six, Motion(np.zeros(20), *(np.hstack([x, rest]) for x in (q, v, a))))
    paper = inverse_dynamics(kr90, Motion(np.zeros(20), q, v, a))
    np.testing.assert_allclose(ours[:, :3], paper, rtol=1e-6, atol=1e-3)


def test_the_flange_and_the_test_points_are_where_they_were() -> None:
    q = np.deg2rad([10, 70, -100])
    six, kr90 = load_robot("kr90_six"), load_robot("kr90")
    here, there = flange_path(six, np.array([[*q, 0, 0, 0]])), flange_path(kr90, q[None])
    np.testing.assert_allclose(here, there, atol=1e-9)
    ours = linearise(assemble(locked(), np.array([*q, 0, 0, 0])))
    paper = linearise(assemble(kr90, q))
    labels = [point.label for point in kr90.test_points]
    for label in labels:
        left, right = ours.jacobian([label]), paper.jacobian([label])
        assert np.sort(np.abs(left)) == pytest.approx(np.sort(np.abs(right)), abs=1e-6)


def test_the_wrist_s_own_modes_lie_above_thirty_hertz() -> None:
    """As the paper has it: below are the first three axes', above the wrist's, whatever the posture."""
    six = load_robot("kr90_six").without(["payload"])
    for q_deg in POSTURES:
        found = modes_at(six, [*q_deg, 0, 0, 0])
        for k in range(len(found)):
            name, _ = found.dominant(k)[0]
            if name[:6] in ("joint4", "joint5", "joint6"):
                assert found.frequency_hz[k] > 30


def test_the_committed_description_is_what_the_command_makes() -> None:
    made, committed = make_six.six(load_robot("kr90")), load_robot("kr90_six")
    assert [axis.model_dump() for axis in made.axes] == [axis.model_dump() for axis in committed.axes]
    assert [entry.model_dump() for entry in made.physics] == [
        {key: value for key, value in entry.model_dump().items() if value is not None} for entry in committed.physics
    ]
    for ours, theirs in zip(made.links, committed.links, strict=True):
        np.testing.assert_allclose(ours.inertial[2], theirs.inertial[2])
    assert all(item.source.startswith("assumed") for item in committed.assumed)


def test_a_link_without_length_is_no_suspect_of_bending() -> None:
    """The wrist's axes meet: nothing of links 4 and 5 can bend, and diagnoses need not try."""
    six, bending = load_robot("kr90_six"), CATALOGUE["link_flexibility"]
    can = [link for link in range(1, 7) if bending.typical(six, f"link{link}.y") is not None]
    assert can == [1, 2, 3, 6]


def test_a_payload_in_a_log_has_an_inertia_of_its_own_where_its_link_has_little() -> None:
    """On a light wrist a spindle's own shows; on the column it is less than what is not known of the column."""
    six, payload = load_robot("kr90_six"), CATALOGUE["payload"]
    for site, extended in (("flange", True), ("link1", False)):
        (suspected,) = payload.suspected(SimpleNamespace(robot=six, site=site))
        assert ("inertia[2]" in {prior.name for prior in suspected.own}) is extended
        assert len(suspected.starts[0]) == len(suspected.own)
    odd = payload.nearest(six, "flange", {"mass": 5.0, "com": [0, 0, 0], "inertia": [0.0, 0.3, 0.0]})
    assert payload.check(odd) is None
