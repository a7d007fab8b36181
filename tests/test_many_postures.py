"""A hammer test in more postures than a search can work on: which it takes, and that the others judge."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tools.large import hammer_test, tilting
from twin.diagnose.many_postures import apart, judged
from twin.identify import covering
from twin.measure.campaign import Campaign
from twin.robot.description import Robot, load_robot


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return hammer_test(14, lines=40, blows=3)


@pytest.fixture(scope="module")
def kr90_six() -> Robot:
    return load_robot("kr90_six")


def test_few_postures_are_searched_whole(campaign: Campaign, kr90_six: Robot) -> None:
    assert apart(campaign, kr90_six) == (campaign, None)


def test_a_search_takes_postures_that_cover_the_others(
    campaign: Campaign, kr90_six: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = campaign.postures["p000"].frf.size
    monkeypatch.setattr(covering, "SEARCHED", 8 * size + 1)
    hit_twice = dict(campaign.postures)
    hit_twice["p000@600"] = replace(campaign.postures["p000"], name="p000@600")
    both = replace(campaign, postures=hit_twice)
    few, rest = apart(both, kr90_six, ["p003"])
    assert rest is not None
    assert not set(few.postures) & set(rest.postures)
    assert {*few.postures, *rest.postures} == set(hit_twice)
    assert "p003" in few.postures
    assert ("p000" in few.postures) == ("p000@600" in few.postures)  # force levels stay together
    assert sum(p.frf.size for p in few.postures.values()) <= 8 * size
    q = {name: np.deg2rad(p.q_deg) for name, p in hit_twice.items()}
    far = max(min(np.linalg.norm(q[a] - q[b]) for b in few.postures) for a in rest.postures)
    rng = np.random.default_rng(0)
    names = sorted(campaign.postures)
    random = [rng.permutation(names)[: len(few.postures)] for _ in range(50)]
    drawn = [max(min(np.linalg.norm(q[a] - q[b]) for b in some) for a in names) for some in random]
    assert far < np.median(drawn)


def test_what_a_search_did_not_see_judges_it(campaign: Campaign, kr90_six: Robot) -> None:
    finding = SimpleNamespace(given=kr90_six, base=kr90_six, robot=tilting())
    rest = replace(campaign, postures={name: campaign.postures[name] for name in ("p001", "p002")})
    note = judged(cast(Any, finding), rest, "campaign.h5", 12)
    assert note.kind == "postures_chosen"
    assert "worked on 12 postures" in note
    assert "the 2 others" in note
    given, before, after = [float(word.rstrip("%")) for word in note.split() if word.endswith("%")][:3]
    assert given == before
    assert after < 0.1 * before
