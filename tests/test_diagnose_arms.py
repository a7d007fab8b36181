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
from twin.diagnose.hypotheses import suspects
from twin.diagnose.refit import NONE
from twin.diagnose.screen import Setting, screen
from twin.diagnose.search import converge
from twin.diagnose.triage import triage
from twin.identify.objective import Sample
from twin.measure.campaign import read_campaign
from twin.model.parameters import free_parameters
from twin.model.recorded import without_limits
from twin.robot.description import load_robot

HOSE = {"mass": 4e-4, "frequency_hz": 21.3, "damping_ratio": 0.007, "axis": "z", "position": [0.08, -0.07, 0.18]}
CABLE = {"mass": 4e-4, "frequency_hz": 19.6, "damping_ratio": 0.009, "axis": "y", "position": [0.26, -0.14, -0.06]}


@pytest.mark.slow
@pytest.mark.parametrize(("site", "hung"), [("link3", HOSE), ("link2", CABLE)])
def test_a_resonator_of_less_than_a_gram_is_named_on_its_link(
    site: str, hung: dict[str, object], tmp_path: Path
) -> None:
    """An arm of 18 kg: all sizes are a hundredth of the KR90's. A kilogram near a hinge would swing alike."""
    world, *_ = case("nothing", "hammer", "light", 77, False)
    assert world.hammer is not None
    world.hammer = replace(world.hammer, effects=(Effect("attached_resonator", site, hung),))
    record(world, tmp_path, np.random.default_rng(77))
    write_description(machines()["light"], tmp_path / "robot.yaml")
    verdict = twin.diagnose(tmp_path / "frf.h5", robot=tmp_path / "robot.yaml")
    found = verdict.missing[0]
    assert found.first.key == f"attached_resonator@{site}"
    assert len(verdict.missing) == 1
    assert found.first.parameters["frequency_hz"]["value"] == pytest.approx(hung["frequency_hz"], rel=0.01)
    assert found.first.parameters["mass"]["value"] < 0.01  # not the kilogram


@pytest.mark.slow
def test_a_tilt_that_springs_and_links_imitate_promises_what_it_reaches(tmp_path: Path) -> None:
    """To first order it promised 15 in ln likelihood, seventeen others more; two of those stood for it then."""
    world, *_ = case("nothing", "hammer", "light", 396748954, False)
    assert world.hammer is not None
    tilt = Effect("transverse_compliance", "joint2.x", {"stiffness": 3.4767e5, "damping": 59.05})
    world.hammer = replace(world.hammer, effects=(tilt,))
    record(world, tmp_path, np.random.default_rng(396748954))
    write_description(machines()["light"], tmp_path / "robot.yaml")
    given = load_robot(tmp_path / "robot.yaml").without(["transverse_compliance@joint2.x"])
    campaign = read_campaign(tmp_path / "frf.h5")
    found, base = triage(campaign, given, "frf.h5", None), without_limits(given)
    sample = Sample(tuple(found.used), 1 / found.shared)
    free = free_parameters(base, [r.setup.name for r in found.used], found.used[0].setup.response.label)
    search = converge(base, free, sample, starts=1)
    setting = Setting(base, free, NONE, search.base.z, sample.thin(100), sample.thin(25), 0.0, False)
    brakes = [r.setup.brakes for r in found.used]
    looked_at = suspects(base, campaign.response, campaign.excitation, brakes, (2.0, 100.0))
    among = [v for v in looked_at if v[0].effect in ("transverse_compliance", "servo_compliance", "base_compliance")]
    first, second, *_ = screen(setting, among)
    assert first.suspect.key == "transverse_compliance@joint2.x"
    assert first.gain > 1.3 * second.gain
