"""A fit to many postures: starts on some of them, Gauss–Newton matrices of some lines, the optimum of all."""

import numpy as np
import pytest

from tools.large import TILT, hammer_test
from twin.identify import covering
from twin.identify.elastic import fit_frf
from twin.identify.objective import Objective, Sample
from twin.model.parameters import free_parameters
from twin.model.recorded import Recorded, prepare, without_limits
from twin.robot.description import Entry, Robot, load_robot

POSTURES = 8


@pytest.fixture(scope="module")
def described() -> Robot:
    """The robot of the recordings, the spring of its foundation twice as stiff."""
    robot, tilt = load_robot("kr90_six"), {**TILT, "stiffness": 2 * TILT["stiffness"]}
    return without_limits(robot.model_copy(update={"physics": [*robot.physics, Entry.model_validate(tilt)]}))


@pytest.fixture(scope="module")
def recordings(described: Robot) -> list[Recorded]:
    return list(prepare(hammer_test(POSTURES, lines=200, blows=4), described).values())


@pytest.mark.parametrize("loaded", [False, True])
def test_a_gradient_needs_no_derivatives_of_frfs_and_a_matrix_not_all_lines(
    recordings: list[Recorded], described: Robot, loaded: bool
) -> None:
    robot, some = described, recordings[:2]
    if loaded:
        mass = {"effect": "sensor_mass", "site": "sensor:*", "mass": 2.0}
        robot = robot.model_copy(update={"physics": [*robot.physics, Entry.model_validate(mass)]})
    free = free_parameters(robot, [r.setup.name for r in some], some[0].setup.response.label)
    z = np.random.default_rng(0).normal(0, 0.3, len(free))
    whole = Objective(robot, free, Sample(tuple(some)), exact=True)
    drawn = Objective(robot, free, Sample(tuple(some)), exact=True, lines=150)
    (cost, gradient, information), (same, also, alike) = whole(z), drawn(z)
    assert same == pytest.approx(cost, rel=1e-12)
    np.testing.assert_allclose(also, gradient, atol=1e-9 * np.abs(gradient).max())
    ratio = np.linalg.eigvals(np.linalg.solve(information, alike)).real
    assert 0.2 < ratio.min() < ratio.max() < 5
    assert abs(ratio - 1).max() > 1e-3  # of some lines


@pytest.mark.slow
def test_many_postures_end_where_a_fit_that_starts_on_all_ends(
    recordings: list[Recorded], described: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    all_at_once = fit_frf(described, recordings, starts=1)
    monkeypatch.setattr(covering, "SEARCHED", 6 * recordings[0].frf.size)
    many = fit_frf(described, recordings, starts=1)
    assert len(many.starts[0].z) == len(all_at_once.starts[0].z) - 2 * described.axis_count
    assert all_at_once.converged
    assert many.converged
    assert many.misfit < 1.1
    assert many.cost == pytest.approx(all_at_once.cost, abs=0.01)
    spread = np.sqrt(np.diag(np.linalg.inv(all_at_once.fisher + np.eye(len(many.z)))))
    assert np.abs((many.z - all_at_once.z) / spread).max() < 0.1
    also = np.sqrt(np.diag(np.linalg.inv(many.fisher + np.eye(len(many.z)))))
    np.testing.assert_allclose(also, spread, rtol=0.05)
