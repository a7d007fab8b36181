"""A user's own structural effect, defined here only: suspected, fitted, named, written, loaded and simulated."""

from collections.abc import Iterator
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tools.truth import elastic
from tools.truth.__main__ import main as truth
from twin.diagnose.decide import decide
from twin.diagnose.hypotheses import suspects
from twin.diagnose.locate import free_laws
from twin.diagnose.search import converge, explain, settle
from twin.diagnose.triage import triage
from twin.identify.objective import Sample
from twin.measure.campaign import read_campaign
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.parameters import free_parameters
from twin.model.recorded import without_limits
from twin.physics import CATALOGUE, register
from twin.physics.effect import UNIT_VECTORS, Effect, Parameter, Values, axis_of
from twin.robot.description import Robot, load_robot, save_robot
from twin.robot.mechanism import Mechanism, assemble

STIFFNESS, DAMPING = 2.5e7, 5e3  # N/m, N·s/m: concealed in the second bearing, along y of its link


class RadialCompliance(Effect):
    """A bearing that gives way across its axis: a spring along x or y of the link's frame."""

    name = "radial_compliance"
    sites = ("link{i}.x", "link{i}.y")
    parameters = (
        Parameter("stiffness", "N/m", inf, positive=True, spread=1.6),
        Parameter("damping", "N·s/m", nonnegative=True, spread=2.3),
    )
    seen_in = frozenset({"hammer"})
    order = 1
    sprung = True

    def write(self, mechanism: Mechanism, site: str, values: Values) -> None:
        body = f"link{axis_of(site) + 1}"
        mechanism.spring(body, site, UNIT_VECTORS[site[-1]], values["stiffness"], values["damping"], "slide")

    def typical(self, robot: Robot, site: str) -> dict[str, Any]:
        return {"stiffness": 1e8, "damping": 1e4}


@pytest.fixture
def own() -> Iterator[None]:
    """Among the effects, as long as a test lasts."""
    register(RadialCompliance())
    yield
    del CATALOGUE["radial_compliance"]


def concealed(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording of the truth code's robot with a slide behind its second bearing, which that code does not offer."""
    servo = elastic._servo

    def with_slide(builder: Any, frame: Any, chain: Any, i: int, effects: Any) -> Any:
        frame = servo(builder, frame, chain, i, effects)
        return builder.slide(frame, "slide", np.array([0.0, 1.0, 0.0]), STIFFNESS, DAMPING) if i == 1 else frame

    monkeypatch.setattr(elastic, "_servo", with_slide)
    options = ("--spacing-hz", "0.5", "--lines", "48", "--coherence", "estimated", "--seed", "14", "--postures", "4")
    assert truth(["campaign", "--out", str(path), *options]) == 0


def test_an_effect_of_ones_own_is_named_at_its_bearing(
    own: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    concealed(tmp_path / "c.h5", monkeypatch)
    campaign, given = read_campaign(tmp_path / "c.h5"), load_robot("kr90")
    found, base = triage(campaign, given, "c.h5", None), without_limits(given)
    sample, kept = Sample(tuple(found.used)), Sample(tuple(found.kept))
    names = dict.fromkeys(r.setup.name for r in found.used)
    search = converge(base, free_parameters(base, names, campaign.response.label), sample)
    among = [
        variants
        for variants in suspects(base, campaign.response, campaign.excitation, ["off"], (5.0, 29.0))
        if variants[0].effect in ("radial_compliance", "link_flexibility", "servo_compliance", "payload")
    ]
    *fits, plain = settle(base, explain(base, search, sample, among), sample)
    decision = decide(fits, plain, among, kept=kept, unnamed=lambda fit: free_laws(fit, sample))
    first = decision.ranked[0]
    assert first.hypothesis.key == "radial_compliance@link2.y"
    assert decision.probability[0] > 0.8
    assert first.misfit < 1.1 < plain.misfit
    assert first.values[first.own[0]] == pytest.approx(STIFFNESS, rel=0.1)

    save_robot(tmp_path / "robot.yaml", first.robot)
    written = load_robot(tmp_path / "robot.yaml")
    assert any(entry.effect == "radial_compliance" for entry in written.physics)
    q = np.deg2rad([0.0, 70.0, -100.0])
    poles = [modes(linearise(assemble(robot, q, brakes="on"))).pole for robot in (first.robot, written)]
    np.testing.assert_allclose(poles[0], poles[1], rtol=1e-9)


def test_what_an_effect_must_state_is_asked_for() -> None:
    class Silent(Effect):
        """States nothing that a hammer test could show."""

        name = "silent"
        sites = ("joint{i}",)
        parameters = (Parameter("size", "1"),)
        seen_in = frozenset({"hammer"})

    with pytest.raises(ValueError, match="seen_in hammer: expected a method write"):
        register(Silent())
    assert "silent" not in CATALOGUE

    class Payload(Effect):
        """Takes a name that there is."""

        name = "coulomb_friction"

    with pytest.raises(ValueError, match="the name is taken"):
        register(Payload())
