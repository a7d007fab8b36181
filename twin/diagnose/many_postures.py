"""A hammer test in more postures than a search can fit to: it takes those that cover the others best, and the others
judge what it found."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from twin.diagnose.edit import is_nonlinear
from twin.diagnose.note import Note
from twin.diagnose.verdict import Finding
from twin.identify.covering import covering, many
from twin.identify.elastic_compare import judge
from twin.measure.campaign import Campaign
from twin.model.recorded import base_name, prepare, without_limits
from twin.robot.description import Robot
from twin.robot.physical import physical

JUDGED_LINES = 50  # of every FRF of the other postures


def apart(campaign: Campaign, robot: Robot, named: Iterable[str] = ()) -> tuple[Campaign, Campaign | None]:
    """The postures a search works on, all force levels of each, and the others; ``None`` where there are none.

    Args:
        robot: whose axes say what near is.
        named: postures that are to be held out, by name: the search is shown them.
    """
    names = {group: base_name(campaign, group) for group in campaign.postures}
    size, q = dict.fromkeys(names.values(), 0), {}
    for group, posture in campaign.postures.items():
        size[names[group]] += posture.frf.size
        q[names[group]] = posture.q_deg
    if not many(list(size.values())):
        return campaign, None
    every, named = list(size), set(named)
    held = [k for k, name in enumerate(every) if name in named or any(names.get(one) == name for one in named)]
    chosen = covering(list(size.values()), np.array([robot.angles(q[name]) for name in every]), held)
    few = {every[k] for k in chosen}
    return _of(campaign, few, names), _of(campaign, set(every) - few, names)


def judged(finding: Finding, rest: Campaign, source: str, searched: int) -> Note:
    """What becomes of the error in postures that no fit and no decision has seen, one after the other.

    Args:
        rest: those postures, and ``searched`` how many the search worked on.
        source: the file, for messages.
    """
    text = f"the search worked on {searched} postures and force levels, which cover the others best"
    if is_nonlinear(finding.robot):  # FRFs of one force say nothing of its model
        return Note(f"{text}; the {len(rest.postures)} others were not looked at", "postures_chosen", "note")
    given = without_limits(finding.given)
    models = [physical(robot) for robot in (given, without_limits(finding.base), without_limits(finding.robot))]
    errors = np.zeros((len(rest.postures), len(models)))
    recordings = prepare(rest, given, source).values()
    for row, r in zip(errors, recordings, strict=True):
        few = r.every(max(1, len(r.s) // JUDGED_LINES))
        row[:] = [judge(robot, [few]).error for robot in models]
    worst = int(np.argmax(errors[:, -1]))
    as_given, before, after = np.median(errors, axis=0)
    text += (
        f"; in the {len(errors)} others, that nothing was fitted to, the median error is {as_given:.2%} as given, "
        f"{before:.2%} before and {after:.2%} after (about {JUDGED_LINES} lines of each FRF); the largest after is "
        f"{errors[worst, -1]:.2%}, in {list(rest.postures)[worst]}"
    )
    return Note(text, "postures_chosen", "note")


def _of(campaign: Campaign, few: set[str], names: dict[str, str]) -> Campaign:
    postures = {group: posture for group, posture in campaign.postures.items() if names[group] in few}
    return replace(campaign, postures=postures)
