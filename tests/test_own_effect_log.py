"""A user's own effect with a torque law, defined here only: suspected, fitted, named, written, loaded and simulated."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tools.truth.__main__ import main as truth
from twin.diagnose.torque import diagnose_log
from twin.diagnose.torque_suspects import not_sought
from twin.measure.motion_log import MotionLog, MotionRun, read_motion_log
from twin.model.replay import inverse_dynamics, motion_of, replay
from twin.physics import CATALOGUE, register
from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.motion import Motion
from twin.robot.description import Robot, load_robot


class WornStretch(Effect):
    """Dry friction of a stretch that is worn: ½ F (1 + sin(2 q + phase)) sgn q̇."""

    name = "worn_stretch"
    sites = ("joint{i}",)
    parameters = (Parameter("torque", "N·m"), Parameter("phase", "rad", spread=1.8))
    seen_in = frozenset({"log"})
    role = "friction"

    def torque(self, motion: Motion, site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        level = 0.5 * values["torque"] * (1 + np.sin(2 * motion.position[:, i] + values["phase"]))
        return {i: level * motion.sign(motion.velocity[:, i])}

    def typical(self, robot: Robot, site: str) -> dict[str, Any]:
        return {"torque": 20.0, "phase": 0.0}


class LeaningDrag(Effect):
    """A seal that drags the more the farther it leans: c |q̇| sin q. All that has to be stated, and no more."""

    name = "leaning_drag"
    sites = ("joint{i}",)
    parameters = (Parameter("coefficient", "N·m·s/rad"),)
    seen_in = frozenset({"log"})

    def torque(self, motion: Motion, site: str, values: Values) -> dict[int, np.ndarray]:
        i = axis_of(site)
        return {i: values["coefficient"] * np.abs(motion.velocity[:, i]) * np.sin(motion.position[:, i])}

    def typical(self, robot: Robot, site: str) -> dict[str, Any]:
        return {"coefficient": 50.0}


@pytest.fixture
def own() -> Iterator[None]:
    """Both among the effects, as long as a test lasts."""
    for effect in (WornStretch(), LeaningDrag()):
        register(effect)
    yield
    for name in (WornStretch.name, LeaningDrag.name):
        del CATALOGUE[name]


def recorded(path: Path, *options: str) -> Path:
    """Three runs of 30 s by the truth code, which shares nothing with the twin."""
    file = path / "log.h5"
    base = ["log", "--out", str(file), "--seed", "3", "--runs", "3", "--seconds", "30", "--dwells", "1"]
    assert truth([*base, *options]) == 0
    return file


def test_a_law_of_ones_own_is_named_written_and_simulated(
    tmp_path: Path, twin: Callable[..., SimpleNamespace], own: None
) -> None:
    """The truth code conceals its ``position_friction`` at joint 2, 3 % of that joint's torque."""
    log = recorded(tmp_path, "--effect", "position_friction@joint2:torque=90,order=2,phase=0.7")
    out = tmp_path / "out"
    found = twin("diagnose", log, "--out", out, "--json").json
    assert found["verdict"] == "named"
    (first,) = found["effects"]
    assert (first["effect"], first["site"]) == ("worn_stretch", "joint2")
    assert first["probability"] > 0.9
    assert first["parameters"]["torque"]["value"] == pytest.approx(90, rel=0.1)
    assert first["parameters"]["phase"]["value"] == pytest.approx(0.7, abs=0.15)
    assert "worn_stretch at joint2" in (out / "diagnosis.html").read_text()
    written = load_robot(out / "robot.yaml")
    (entry,) = [e for e in written.physics if e.effect == "worn_stretch"]
    assert entry.values["torque"] == pytest.approx(first["parameters"]["torque"]["value"])
    again = diagnose_log(read_motion_log(log), written)  # described, it is not missing
    assert again.word == "adequate"


def test_a_law_of_ones_own_is_stepped_in_time(kr90: Robot, own: None) -> None:
    """Without a `write` of its own it becomes a passive force: the replay has the torque of the law."""
    data = kr90.model_dump(mode="json")
    data["physics"] = [{"effect": "leaning_drag", "site": "joint2", "coefficient": 300.0}]
    robot, plain = (type(kr90).model_validate({**data, "physics": entries}) for entries in (data["physics"], []))
    rate = 250.0
    time = np.arange(0, 2, 1 / rate)
    angle = 2 * np.pi * 0.5 * time[:, None] + np.array([0.0, 0.7, 1.4])
    position = np.array([0.0, 1.3, -1.5]) + np.array([0.2, 0.25, 0.2]) * np.sin(angle)
    run = MotionRun("sine", time, position, rate)
    for description in (robot, plain):
        for axis in description.axes:
            axis.__dict__.update(stiffness=None)
    motion = motion_of(run)
    law = inverse_dynamics(robot, motion)[:, 1] - inverse_dynamics(plain, motion)[:, 1]
    stepped = replay(robot, run).torque[:, 1] - replay(plain, run).torque[:, 1]
    expected = 300 * np.abs(motion.velocity[:, 1]) * np.sin(position[:, 1])
    np.testing.assert_allclose(law, expected, atol=1e-9)
    assert np.sqrt(np.mean((stepped - expected)[50:] ** 2)) < 0.03 * np.sqrt(np.mean(expected**2))


@pytest.mark.slow
def test_an_effect_that_states_its_torque_alone_is_found(tmp_path: Path, kr90: Robot, own: None) -> None:
    """200 |q̇| sin q added to joint 1 of a recording, by another formula than the effect's."""
    log = read_motion_log(recorded(tmp_path))
    runs = {}
    for name, run in log.runs.items():
        assert run.torque is not None
        torque = run.torque.copy()
        speed = np.hypot(np.gradient(run.position[:, 0], run.time), 0)
        torque[:, 0] += 200 * speed * np.cos(run.position[:, 0] - np.pi / 2)
        runs[name] = MotionRun(name, run.time, run.position, run.sample_rate_hz, torque=torque)
    found = diagnose_log(MotionLog(runs), kr90)
    (missing,) = found.missing
    assert (found.word, missing.first.key) == ("named", "leaning_drag@joint1")
    assert missing.first.parameters["coefficient"]["value"] == pytest.approx(200, rel=0.03)


def test_an_effect_that_cannot_be_looked_for_is_refused_or_said(kr90: Robot) -> None:
    class Silent(Effect):
        name = "silent"
        sites = ("joint{i}",)
        parameters = (Parameter("torque", "N·m"),)
        seen_in = frozenset({"log"})

    with pytest.raises(ValueError, match="expected a method torque"):
        register(Silent())

    class Untypical(LeaningDrag):
        name = "untypical"
        parameters = (Parameter("coefficient", "N·m·s/rad"), Parameter("speed", "rad/s", spread=1.0))

        def typical(self, robot: Robot, site: str) -> None:  # type: ignore[override]
            return None

    register(Untypical())
    try:
        notes = not_sought(kr90)
    finally:
        del CATALOGUE["untypical"]
    assert notes == ["untypical is not looked for at joint1, joint2, joint3: its `typical` states no entry there"]
    assert not_sought(kr90) == []
