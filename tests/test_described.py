"""Numbers of a description that are wrong: found, with their values, where nothing else is the matter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tools.trials.wrong import case
from tools.truth.effects import Effect
from tools.truth.robots import machines, write_description
from tools.truth.wrong import record
from twin.diagnose.described import described, geometry
from twin.measure.campaign import Channels
from twin.model.parameters import axis_parameters, direction_parameters, free_parameters, independent, point_parameters
from twin.model.sensitivity import Setup, observe, slopes
from twin.robot.description import Entry, Robot, load_robot

Q = np.deg2rad([10.0, 70.0, -100.0])


def channels(robot: Robot, labels: tuple[str, ...]) -> Channels:
    points = {point.label: point for point in robot.test_points}
    some = [points[label] for label in labels]
    return Channels(
        labels, tuple(p.body for p in some), np.array([p.position for p in some]), np.array([p.direction for p in some])
    )


@pytest.fixture(scope="module")
def setup() -> Setup:
    robot = load_robot("kr90")
    return Setup("here", Q, "on", channels(robot, ("21X+", "21Y+", "21Z+")), channels(robot, ("2Y-", "9Y+", "21Z+")))


def test_lengths_twists_places_and_directions_have_the_slopes_of_differences(setup: Setup) -> None:
    robot = load_robot("kr90")
    turned = Entry(effect="sensor_misalignment", site="sensor:21", angles=[0.05, -0.1, 0.2])
    robot = robot.model_copy(update={"physics": [*robot.physics, turned]})
    sensors, blows = setup.response, setup.excitation
    parameters = independent(
        [
            *axis_parameters(robot),
            *point_parameters(robot, sensors, "response"),
            *point_parameters(robot, blows, "excitation"),
            *point_parameters(robot, blows, "position"),
            *direction_parameters(robot, sensors, "response"),
            *direction_parameters(robot, blows, "excitation"),
        ]
    )
    values = parameters.values(np.random.default_rng(0).normal(size=len(parameters)))
    moved = parameters.apply(robot, values)
    seen, model = observe(moved, setup, parameters, values)
    rate = slopes(moved, setup, parameters, values, seen, model)
    for k, parameter in enumerate(parameters):
        step = 1e-3 * parameter.deviation
        sides = []
        for side in (values[k] + step, values[k] - step):
            shifted = np.where(np.arange(len(values)) == k, side, values)
            sides.append(observe(parameters.apply(robot, shifted), setup, parameters, shifted)[0].arrays())
        for name, high, low, slope in zip(("M", "C", "K", "", "", "J_r", "J_e"), *sides, rate.arrays(), strict=False):
            expected = (high - low) / (2 * step)
            scale = max(float(np.abs(expected).max()), 1e-3 * float(np.abs(high).max()))
            assert np.abs(slope[k] - expected).max() <= 2e-2 * scale, (parameter.name, name)


def test_a_moved_node_moves_what_is_there_and_nothing_else(setup: Setup) -> None:
    robot = load_robot("kr90")
    for side, sensors_move, blows_move in (
        ("position", True, True), ("response", True, False), ("excitation", False, True),
    ):  # fmt: skip
        some = setup.response if side == "response" else setup.excitation
        parameters = independent(p for p in point_parameters(robot, some, side) if p.name.startswith("node:21"))  # type: ignore[arg-type]
        placed = setup.placed(parameters, parameters.values(np.ones(3)))
        assert np.allclose(placed.response.position - setup.response.position, 0.005 * sensors_move)
        at_node = np.array([[False], [False], [blows_move]])
        assert np.allclose(placed.excitation.position - setup.excitation.position, 0.005 * at_node)


def test_every_number_of_a_description_is_a_suspect(setup: Setup) -> None:
    robot = load_robot("kr90")
    free = free_parameters(robot, ["here"], setup.response.label)
    sites = {h.site for h in described(free)}
    assert {"joint1.z.stiffness", "joint3.y.damping", "link2.mass", "link2.com", "link2.inertia", "posture"} <= sites
    assert {"link*.mass", "link*.com", "link*.inertia", "joint*.stiffness", "joint*.damping"} <= sites
    freed = {variants[0].site: variants for variants in geometry(robot, setup.response, setup.excitation)}
    assert {"axis2.a", "axis3.d", "axis3.alpha", "node:2.position", "node:21.position"} <= set(freed)
    assert {"node:*.position", "node:*.direction"} <= set(freed)
    assert len(freed["node:2.position"]) == 1
    assert len(freed["node:21.position"]) == 3  # the node, its sensor, its blow


@pytest.mark.parametrize("name", ["direction_deg", "position", "length", "angle_deg"])
def test_what_has_no_tolerance_is_no_suspect(setup: Setup, name: str) -> None:
    """A number that is known exactly is not freed: its prior would be singular."""
    robot = load_robot("kr90")
    robot = robot.model_copy(update={"tolerances": robot.tolerances.model_copy(update={name: 0.0})})
    free = free_parameters(robot, ["here"], setup.response.label)
    some = [h for variants in geometry(robot, setup.response, setup.excitation) for h in variants]
    assert some
    assert all(np.isfinite(h.parameters(free).root).all() for h in some)


@pytest.mark.slow
def test_a_blow_off_by_its_tolerance_is_told_and_no_finding(tmp_path: Path) -> None:
    """7 mm off where 5 mm is one standard deviation."""
    world, _, _, cause = case("blow_position", "hammer", "kr90", 112, False)
    record(world, tmp_path, np.random.default_rng(112))
    write_description(machines()["kr90"], tmp_path / "robot.yaml")
    verdict = twin.diagnose(tmp_path / "frf.h5", robot=tmp_path / "robot.yaml")
    assert verdict.word == "adequate"
    assert cause.names == ("parameter@node:5.position",)
    assert any("node:*.position" in note and "no finding" in note for note in verdict.findings[0].warnings)


@pytest.mark.slow
def test_a_wrong_number_is_named_with_its_value(tmp_path: Path) -> None:
    world, _, _, cause = case("axis_offset", "hammer", "kr90", 106, False)
    record(world, tmp_path, np.random.default_rng(106))
    write_description(machines()["kr90"], tmp_path / "robot.yaml")
    verdict = twin.diagnose(tmp_path / "frf.h5", robot=tmp_path / "robot.yaml")
    first = verdict.missing[0].first
    assert verdict.word == "named"
    assert f"{first.effect}@{first.site}" in cause.names
    assert verdict.error["after"]["held_out"] < 0.6 * verdict.error["before"]["held_out"]
    for name, item in first.parameters.items():
        values, ranges = np.atleast_1d(item["value"]), np.reshape(item["interval90"], (-1, 2))
        true = [value for key, value in cause.values.items() if key.partition(".")[0] == name]
        assert len(true) == len(values)
        off = np.abs(values - true) / np.maximum((ranges[:, 1] - ranges[:, 0]) / 3.29, 1e-12)
        assert (off < 4).all(), (name, values, true)


@pytest.mark.parametrize(
    ("way", "recording", "robot", "seed", "key"),
    [
        ("joint_zero", "hammer", "arm", 961, "joint_offset@joint"),
        ("gravity_tilt", "log", "arm", 962, "gravity_direction@base"),
    ],
)
@pytest.mark.slow
def test_a_zero_and_a_leaning_foot_are_entries(
    way: str, recording: str, robot: str, seed: int, key: str, tmp_path: Path
) -> None:
    """Named as effects and as nothing else, written as entries, and gone without them."""
    world, _, _, cause = case(way, recording, robot, seed, False)
    record(world, tmp_path, np.random.default_rng(seed))
    write_description(machines()[robot], tmp_path / "robot.yaml")
    verdict = twin.diagnose(next(tmp_path.glob("*.h5")), robot=tmp_path / "robot.yaml")
    (missing,) = verdict.missing
    assert missing.first.key.startswith(key)
    assert missing.first.key in cause.names
    assert not any(rival.effect == "parameter" and "offset" in rival.site for rival, _ in missing.rivals)
    (entry,) = (e for e in verdict.robot.physics if e.effect == missing.first.effect)
    assert len(verdict.robot.without([entry.effect]).physics) == len(verdict.robot.physics) - 1
    if world.log:
        felt = world.log.chain.gravity
        np.testing.assert_allclose(verdict.robot.felt_gravity, felt, atol=9.81 * 3 * np.deg2rad(0.1))
    else:
        assert entry.values["angle"] == pytest.approx(cause.values["angle"], abs=2 * np.deg2rad(0.1))


@pytest.mark.slow
def test_a_bearing_that_couples_its_tilts_is_named(tmp_path: Path) -> None:
    """Concealed as a bearing with oblique principal axes."""
    world, *_ = case("nothing", "hammer", "kr90", 951, False)
    assert world.hammer is not None
    concealed = Effect("cross_stiffness", "joint2", {"stiffness": 1.5e6})
    world.hammer = replace(world.hammer, effects=(concealed,))
    record(world, tmp_path, np.random.default_rng(951))
    verdict = twin.diagnose(tmp_path / "frf.h5", robot="kr90")
    (missing,) = verdict.missing
    assert missing.first.key == "cross_stiffness@joint2"
    assert missing.first.parameters["stiffness"]["value"] == pytest.approx(1.5e6, rel=0.02)
    assert verdict.error["after"]["held_out"] < 1.2 * verdict.error["noise_floor"]
