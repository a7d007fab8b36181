"""Excitation trajectories: limits that hold at every moment, the criterion, files a controller can run."""

from pathlib import Path

import numpy as np
import pytest

from twin.commands.compare import compare
from twin.commands.excite import krl_program, trajectory_run
from twin.commands.identify import identify
from twin.errors import InputError
from twin.identify import excitation
from twin.identify.excitation import Fourier, Problem, excite, violation
from twin.measure.motion_log import MotionLog, MotionRun, read_motion_log, write_motion_log
from twin.model.regressor import flange_path
from twin.model.replay import inverse_dynamics
from twin.robot.description import Robot, load_robot

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="module")
def found(kr90: Robot) -> list[excitation.Excitation]:
    """Two quick trajectories: one start each, no further search."""
    quick = excitation.Settings(draws=15, starts=1, hops=0)
    result = excite(kr90, 1, starts=2, workers=1, iterations=40, settings=quick)
    return result + excite(kr90, 1, starts=1, workers=1, iterations=25, rest=True, seed=2, settings=quick)


def test_extremes_are_those_of_a_dense_sampling() -> None:
    """Roots on the unit circle find every maximum: 1e5 samples of a period reach it to 1e-6 and never exceed it."""
    rng = np.random.default_rng(0)
    f = Fourier(*rng.normal(0, 0.3, (2, 4, 5)), rng.normal(size=4))
    motion = f.motion(np.linspace(0, f.period_s, 100_001))
    for exact, dense in zip(f.extremes(), (motion.position, motion.velocity, motion.acceleration), strict=True):
        assert (dense.max(axis=0) <= exact[:, 1] + 1e-9).all()
        assert (dense.min(axis=0) >= exact[:, 0] - 1e-9).all()
        np.testing.assert_allclose(dense.max(axis=0), exact[:, 1], atol=1e-6)


def test_a_series_is_the_integral_of_its_velocity() -> None:
    """Eqs. 8–10: central differences of position and velocity."""
    rng = np.random.default_rng(1)
    f = Fourier(*rng.normal(0, 0.3, (2, 3, 5)), np.zeros(3))
    time, h = np.linspace(0, 10, 50), 1e-5
    middle, before, after = f.motion(time), f.motion(time - h), f.motion(time + h)
    np.testing.assert_allclose((after.position - before.position) / (2 * h), middle.velocity, atol=1e-8)
    np.testing.assert_allclose((after.velocity - before.velocity) / (2 * h), middle.acceleration, atol=1e-8)


def test_no_limit_is_left_between_samples(kr90: Robot, found: list[excitation.Excitation]) -> None:
    """Joint limits by exact extremes, the flange's box on a grid of 0.1 ms, ten times finer than the check's."""
    for e in found:
        assert violation(kr90, e.fourier) <= 0
        motion = e.fourier.motion(np.arange(0, 10, 1e-4))
        path = flange_path(kr90, motion.position)
        for k, box in enumerate((kr90.workspace.x, kr90.workspace.y, kr90.workspace.z)):
            assert path[:, k].min() >= box[0]
            assert path[:, k].max() <= box[1]
        for i, axis in enumerate(kr90.axes):
            assert np.abs(motion.velocity[:, i]).max() <= axis.limits.velocity
            assert np.abs(motion.acceleration[:, i]).max() <= axis.limits.acceleration


def test_even_a_quick_search_beats_the_papers_average(found: list[excitation.Excitation]) -> None:
    """28 is the paper's mean condition number on Appendix B's fifteen inertial columns."""
    assert found[0].condition < 20


def test_gradients_are_those_of_central_differences(kr90: Robot) -> None:
    """Of both criteria, at rest and not, and of the flange's room, in ten directions to 1e-4."""
    rng = np.random.default_rng(0)
    for criterion, rest in (("condition", False), ("d-optimal", True)):
        problem = Problem(kr90, 5, 0.1, rest, criterion)
        z, h = problem.draw(rng, 0.5), 1e-5
        _, gradient = problem.value_and_gradient(z)
        room, jacobian = problem.workspace(z)
        assert room.shape == (6 * problem.settings.guards,)
        for _ in range(5):
            step = rng.normal(size=z.shape)
            ahead, behind = z + h * step, z - h * step
            slope = (problem.value_and_gradient(ahead)[0] - problem.value_and_gradient(behind)[0]) / (2 * h)
            assert gradient @ step == pytest.approx(slope, rel=1e-4, abs=1e-4)
            walls = (problem.workspace(ahead)[0] - problem.workspace(behind)[0]) / (2 * h)
            np.testing.assert_allclose(jacobian @ step, walls, atol=1e-4)


def test_a_trajectory_at_rest_stands_at_both_ends(found: list[excitation.Excitation]) -> None:
    """Position is periodic; velocity and acceleration vanish at the start of every period."""
    motion = found[1].fourier.motion(np.array([0.0, 10.0]))
    np.testing.assert_allclose(motion.velocity, 0, atol=1e-9)
    np.testing.assert_allclose(motion.acceleration, 0, atol=1e-9)
    np.testing.assert_allclose(motion.position[0], motion.position[1], atol=1e-9)


def test_the_criterion_is_the_condition_number(kr90: Robot, found: list[excitation.Excitation]) -> None:
    """From the singular values of the fifteen columns over one period; sampling it differently changes nothing."""
    kept = Problem(kr90, 5, 0.1, False, "condition").kept
    assert len(kept) == 15
    e = found[0]
    from twin.model.regressor import link_regressor

    Y = link_regressor(kr90, e.fourier.motion(np.arange(1237) * 10 / 1237))[:, :, kept].reshape(-1, 15)
    assert np.linalg.cond(Y) == pytest.approx(e.condition, rel=1e-6)


def test_limits_are_needed(kr90: Robot) -> None:
    """A robot without speed limits cannot be planned for: one line."""
    bare = kr90.model_copy(update={"axes": [axis.model_copy(update={"limits": None}) for axis in kr90.axes]})
    with pytest.raises(InputError, match=r"axes\[0\]\.limits"):
        excite(bare, 1, workers=1)


def test_a_spline_program_goes_through_the_trajectory(found: list[excitation.Excitation]) -> None:
    """KUKA's angles are the negative joint angles in degrees; the block takes one period."""
    text = krl_program("excite1", found[1], 3)
    points = [line for line in text.splitlines() if line.strip().startswith("SPTP")]
    first = np.rad2deg(-found[1].fourier.motion(np.array([0.0])).position[0])
    assert len(points) == 100
    assert f"A1 {first[0]:.5f}" in points[-1]
    assert "TIME_BLOCK END = 10" in text
    assert "FOR K = 1 TO 3" in text


def test_log_to_robot_and_back(kr90: Robot, found: list[excitation.Excitation], tmp_path: Path) -> None:
    """identify writes a robot.yaml that compare finds as good as identify said, better than the robot before."""
    data = kr90.model_dump(mode="json")
    data["links"][2]["mass"] *= 1.05
    heavier = Robot.model_validate(data)
    rng = np.random.default_rng(0)
    runs = {}
    for k, e in enumerate(found):
        run = trajectory_run(f"run{k + 1}", e, 2, 250.0)
        motion = e.fourier.motion(run.time)
        noise = 5 * rng.normal(size=run.position.shape)
        runs[run.name] = MotionRun(run.name, run.time, run.position, 250.0, inverse_dynamics(heavier, motion) + noise)
    path = tmp_path / "log.h5"
    write_motion_log(path, MotionLog(runs, "kr90"))
    result = identify(path, out=tmp_path / "out", hold_out=["run2"])
    data = result.data()
    assert {"parameters", "error", "model"} <= set(data)
    assert all({"value", "unit", "interval90"} <= set(entry) for entry in data["parameters"].values())
    assert len(data["error"]["train"]) == len(data["error"]["held_out"]) == 3
    assert load_robot(data["model"]["robot"]).name == "kr90"
    assert Path(data["model"]["mjcf"]).is_file()
    before, after = (compare([path], robot=robot).data() for robot in ("kr90", str(tmp_path / "out" / "robot.yaml")))
    held = [part["error"] for part in after["parts"] if part["run"] == "run2"]
    np.testing.assert_allclose(held, data["error"]["held_out"], rtol=0.2)
    assert after["error"] < 0.5 * before["error"]


def test_trajectories_are_read_back(found: list[excitation.Excitation], tmp_path: Path) -> None:
    """HDF5 holds position, velocity and acceleration, no torque: format trajectory."""
    run = trajectory_run("excitation1", found[0], 1, 250.0)
    write_motion_log(tmp_path / "t.h5", MotionLog({"excitation1": run}, "kr90"))
    back = read_motion_log(tmp_path / "t.h5")
    assert back.runs["excitation1"].torque is None
    np.testing.assert_array_equal(back.runs["excitation1"].position, run.position)
