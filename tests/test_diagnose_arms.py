"""Hammer tests of whole small arms: what is concealed is named where it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tools.trials.wrong import case
from tools.truth.effects import Effect
from tools.truth.robots import machines, write_description
from tools.truth.wrong import record

HOSE = {"mass": 4e-4, "frequency_hz": 21.3, "damping_ratio": 0.007, "axis": "z", "position": [0.08, -0.07, 0.18]}


@pytest.mark.slow
def test_a_resonator_of_less_than_a_gram_is_named_on_its_link(tmp_path: Path) -> None:
    """An arm of 18 kg: all sizes are a hundredth of the KR90's."""
    world, *_ = case("nothing", "hammer", "light", 77, False)
    assert world.hammer is not None
    world.hammer = replace(world.hammer, effects=(Effect("attached_resonator", "link3", HOSE),))
    record(world, tmp_path, np.random.default_rng(77))
    write_description(machines()["light"], tmp_path / "robot.yaml")
    verdict = twin.diagnose(tmp_path / "frf.h5", robot=tmp_path / "robot.yaml")
    assert verdict.word == "named"
    (found,) = verdict.missing
    assert found.first.key == "attached_resonator@link3"
    assert found.first.parameters["frequency_hz"]["value"] == pytest.approx(HOSE["frequency_hz"], rel=0.01)
