"""Whether the postures of a hammer test are of one robot in one state: asked where no one model explains them all."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.search import SCREEN_LINES
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters
from twin.robot.description import Robot

Fit = TypeVar("Fit")


def states(robot: Robot, parameters: Parameters, sample: Sample) -> list[Note]:
    """A note on groups of postures that one model explains each, where it does not explain them together.

    Args:
        robot: the description without limits; ``parameters`` what is free of it.
        sample: the recordings used.
    """
    few, most = sample.thin(SCREEN_LINES), calibration()["held_out_adequate"]

    def fitted(members: Sequence[int], z: FloatArray) -> Fitted | None:
        some = Sample(tuple(few.recordings[k] for k in members), few.repeat)
        rough = 0 if z.any() else 25
        fit = descend(robot, NONE, parameters, some, z, logarithmic=rough, tempered=8, linear=15)
        return fit if fit.misfit <= most else None

    return grouped(
        [r.group for r in few.recordings],
        "postures",
        lambda number: fitted([number], np.zeros(len(parameters))),
        lambda members, known, number: fitted([*members, number], known.z),
    )


def grouped(
    names: Sequence[str],
    what: str,
    alone: Callable[[int], Fit | None],
    beside: Callable[[Sequence[int], Fit, int], Fit | None],
) -> list[Note]:
    """A note on groups of recordings, each explained by one model; none where one explains all, or not each alone.

    Args:
        names: of the recordings, ``what`` they are.
        alone: the fit to one of them, ``None`` where it is not explained.
        beside: the fit to the members of a group with one more, from the group's own.
    """
    groups: list[tuple[list[int], Fit]] = []
    for number in range(len(names)):
        own = alone(number)
        if own is None:
            return []
        for k, (members, known) in enumerate(groups):
            if (fit := beside(members, known, number)) is not None:
                groups[k] = ([*members, number], fit)
                break
        else:
            groups.append(([number], own))
    if not 1 < len(groups) < len(names):
        return []
    told = "; ".join(", ".join(names[k] for k in members) for members, _ in groups)
    text = (
        f"one model explains each of these groups of {what}, none explains them together: {told}. They may be of "
        "different robots, of one robot in different states, or have angles that are written down wrongly"
    )
    return [Note(text, "other_robot", "fail", runs=tuple(names) if what == "runs" else ())]
