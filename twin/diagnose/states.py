"""Whether the postures of a hammer test are of one robot in one state, and stand where the file says.

Asked where no one model explains them all. Postures that one model explains together are a group. The largest is
believed where its model is as described: what every posture lacks would strain that, or leave it unexplained.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from twin.diagnose.calibration import calibration
from twin.diagnose.departures import STRAINED
from twin.diagnose.note import Note
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.search import SCREEN_LINES
from twin.diagnose.verdict import strained
from twin.identify.objective import Objective, Sample
from twin.measure.campaign import Campaign, FloatArray
from twin.model.parameters import Parameters, free_parameters, independent
from twin.model.recorded import Recorded
from twin.parallel import spread
from twin.robot.description import Robot

Fit = TypeVar("Fit")
STEP_DEG, FURTHEST_DEG = 1.5, 20.0
"""How near to the right angle a posture's robust cost points at it, and how far off it may be written down."""
MEANS = "They may be of different robots, of one robot in different states, or have wrong angles in the file"


def sorted_out(robot: Robot, campaign: Campaign, sample: Sample, processes: int = 1) -> tuple[Campaign, list[Note]]:
    """A campaign with the postures that are of one robot, wrong angles put right, and a note on each fault.

    Args:
        robot: the description without limits.
        sample: all postures of the campaign, each at one force.
        processes: postures are fitted one by one by so many.
    """
    few = list(sample.thin(SCREEN_LINES).recordings)
    free = free_parameters(robot, [r.setup.name for r in few], few[0].setup.response.label)
    groups, lone = _groups(robot, free, few, sample.repeat, processes)
    sound = [group for group in groups if len(group[0]) > 1 and not _strained(group[1])]
    if not sound:
        return campaign, []
    members, fit = max(sound, key=lambda group: (len(group[0]), -group[1].cost))
    notes, postures = [], {few[k].group: campaign.postures[few[k].group] for k in members}
    apart = [k for k in range(len(few)) if k not in members]
    for k in apart if 2 * len(members) > len(few) else ():
        r, joint, step = _relabelled(fit.robot, few[k])
        if abs(step) < STRAINED * np.deg2rad(robot.tolerances.posture_deg):
            continue
        again = _explained(robot, free, Sample(tuple([*(few[m] for m in members), r]), sample.repeat), fit.z)
        if again is None:
            continue
        members, fit = [*members, k], again
        found = step + float(again.parameters.posture_error(r.setup.name, again.values, len(r.setup.q))[joint])
        revolute = robot.axes[joint].type == "revolute"
        q_deg = campaign.postures[r.group].q_deg.copy()
        q_deg[joint] += np.rad2deg(found) if revolute else found
        postures[r.group] = replace(campaign.postures[r.group], q_deg=q_deg)
        told = f"{np.rad2deg(found):+.2g}°" if revolute else f"{found:+.2g} m"
        text = (
            f"{r.group}: the model that explains the other postures has joint{joint + 1} {told} away from the file. "
            "The angle in the file is wrong, and was corrected"
        )
        notes.append(Note(text, "posture", "fail"))
    others = [group for group, _ in groups if not set(group) & set(members)]
    lone = [k for k in lone if k not in members]
    if others:
        others += [[k] for k in lone]
        told = _told([r.group for r in few], [sorted(members), *others])
        text = (
            f"no single model explains all postures. A model of its own explains each of these groups, or at least the "
            f"first: {told}. {MEANS}. Only the first group is diagnosed"
        )
        notes.append(Note(text, "other_robot", "fail"))
    else:  # what no model explains even alone is no other robot
        postures |= {few[k].group: campaign.postures[few[k].group] for k in lone}
    ordered = {name: postures[name] for name in campaign.postures if name in postures}
    return (replace(campaign, postures=ordered), notes) if notes else (campaign, [])


def _groups(
    robot: Robot, free: Parameters, few: Sequence[Recorded], repeat: float, processes: int
) -> tuple[list[tuple[list[int], Fitted]], list[int]]:
    """Postures that one model explains together, with its fit, and those that none explains.

    None at all where two are not explained each by itself: something else is missing.
    """
    alone: dict[int, Fitted] = {}

    def by_itself(k: int) -> Fitted | None:
        return _explained(robot, free, Sample((few[k],), repeat), np.zeros(len(free)))

    for k, fit in enumerate(spread(by_itself, len(few), processes)):
        if fit is not None:
            alone[k] = fit
        if k + 1 - len(alone) > 1:
            return [], []
    if all(_strained(fit) for fit in alone.values()):
        return [], []
    groups: list[tuple[list[int], Fitted]] = []
    for k, own in alone.items():
        for number, (members, known) in enumerate(groups):
            some = Sample(tuple(few[m] for m in (*members, k)), repeat)
            fit = _explained(robot, free, some, known.z)
            if fit is not None and not any(note.kind == "posture" for note in strained(fit)):
                groups[number] = ([*members, k], fit)
                break
        else:
            groups.append(([k], own))
    return groups, [k for k in range(len(few)) if k not in alone]


def _strained(fit: Fitted) -> bool:
    """Whether numbers other than dampers come out far from their description: to those all that is missing goes."""
    return any(not site.endswith(".damping") for note in strained(fit) for site in note.sites or ("",))


def _explained(robot: Robot, free: Parameters, sample: Sample, z: FloatArray) -> Fitted | None:
    """The base model fitted to postures from z, ``None`` where it does not explain each of them."""
    fit = descend(robot, NONE, free, sample, z, logarithmic=0 if z.any() else 25, tempered=8, linear=15)
    objective = Objective(fit.robot, fit.parameters, sample)
    ends = np.cumsum([2 * weight.size for weight in objective.weight])
    left = np.split(objective.residual(fit.z)[: ends[-1]], ends[:-1])
    worst = max(
        part @ part / (2 * sample.repeat * np.count_nonzero(weight))
        for part, weight in zip(left, objective.weight, strict=True)
    )
    return fit if worst <= calibration()["held_out_adequate"] else None


def _relabelled(robot: Robot, r: Recorded) -> tuple[Recorded, int, float]:
    """A posture with the one angle elsewhere that explains it best, which that is, and by how much, rad (m)."""

    def at(joint: int, step: float) -> Recorded:
        q = r.setup.q + step * np.eye(len(r.setup.q))[joint]
        return replace(r, setup=replace(r.setup, q=q))

    def cost(step: float, joint: int) -> float:
        some = Sample((at(joint, step),))
        return Objective(robot, independent([]), some, logarithmic=True).cost(np.zeros(0))

    width = np.deg2rad(STEP_DEG)
    steps = np.arange(-FURTHEST_DEG, FURTHEST_DEG + STEP_DEG, STEP_DEG)
    tried = [(cost(step, j), j, step) for j in range(len(r.setup.q)) for step in np.deg2rad(steps)]
    _, joint, step = min(tried)
    near = minimize_scalar(cost, bounds=(step - width, step + width), args=(joint,), options={"xatol": 1e-4})
    return at(joint, float(near.x)), joint, float(near.x)


def grouped(
    names: Sequence[str],
    what: str,
    alone: Callable[[int], Fit | None],
    beside: Callable[[Sequence[int], Fit, int], Fit | None],
) -> tuple[list[list[str]], list[Note]]:
    """Groups of recordings, each explained by one model, and a note; none where one explains all, or not each alone.

    Args:
        names: of the recordings, ``what`` they are.
        alone: the fit to one of them, ``None`` where it is not explained.
        beside: the fit to the members of a group with one more, from the group's own.
    """
    groups: list[tuple[list[int], Fit]] = []
    for number in range(len(names)):
        own = alone(number)
        if own is None:
            return [], []
        for k, (members, known) in enumerate(groups):
            if (fit := beside(members, known, number)) is not None:
                groups[k] = ([*members, number], fit)
                break
        else:
            groups.append(([number], own))
    if not 1 < len(groups) < len(names):
        return [], []
    told = _told(names, [members for members, _ in groups])
    some = [[names[k] for k in members] for members, _ in groups]
    text = f"a model of its own explains each of these groups of {what}, no model explains all: {told}. {MEANS}"
    return some, [Note(text, "other_robot", "fail", runs=tuple(names) if what == "runs" else ())]


def _told(names: Sequence[str], groups: Sequence[Sequence[int]]) -> str:
    return "; ".join(", ".join(names[k] for k in members) for members in groups)
