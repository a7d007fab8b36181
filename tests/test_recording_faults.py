"""Faults of a recording that are put right before the diagnosis, and told: units, signs, order, clocks."""

from pathlib import Path

import numpy as np
import pytest

import twin
from tools.trials.wrong import case
from tools.truth.robots import machines, write_description
from tools.truth.wrong import record


@pytest.mark.parametrize(
    ("way", "recording", "seed", "kind"),
    [
        ("unit_g_channel", "hammer", 411, "unit"),
        ("swapped_channels", "hammer", 441, "swapped_channels"),
        ("clock", "log", 313, "clock"),
        ("reversed_torque", "log", 314, "reversed_channel"),
    ],
)
def test_a_fault_is_told_and_put_right(way: str, recording: str, seed: int, kind: str, tmp_path: Path) -> None:
    world, *_ = case(way, recording, "arm", seed, False)
    record(world, tmp_path, np.random.default_rng(seed))
    write_description(machines()["arm"], tmp_path / "robot.yaml")
    (file,) = tmp_path.glob("*.h5")
    verdict = twin.diagnose(file, robot=tmp_path / "robot.yaml")
    told = [note["kind"] for note in verdict.data()["triage"] if note["severity"] == "fail"]
    assert told == [kind]
    assert verdict.word == "adequate"
