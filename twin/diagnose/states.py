"""Whether the postures of a hammer test are of one robot in one state: asked where no one model explains them all."""

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.search import SCREEN_LINES
from twin.identify.objective import Sample
from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameters
from twin.robot.description import Robot


def states(robot: Robot, parameters: Parameters, sample: Sample) -> list[Note]:
    """A note on groups of postures that one model explains each, where it does not explain them together.

    Args:
        robot: the description without limits; ``parameters`` what is free of it.
        sample: the recordings used.
    """
    few = sample.thin(SCREEN_LINES)
    groups: list[tuple[list[int], FloatArray]] = []
    for number in range(len(few.recordings)):
        alone = _fit(robot, parameters, few, [number], np.zeros(len(parameters)))
        if not _explained(alone):
            return []
        for k, (members, z) in enumerate(groups):
            beside = _fit(robot, parameters, few, [*members, number], z)
            if _explained(beside):
                groups[k] = ([*members, number], beside.z)
                break
        else:
            groups.append(([number], alone.z))
    if not 1 < len(groups) < len(few.recordings):
        return []
    told = "; ".join(", ".join(few.recordings[k].group for k in members) for members, _ in groups)
    text = (
        f"one model explains each of these groups of postures, none explains them together: {told}. They may be of "
        "different robots, of one robot in different states, or have angles that are written down wrongly"
    )
    return [Note(text, "other_robot", "fail")]


def _fit(robot: Robot, parameters: Parameters, few: Sample, members: list[int], z: FloatArray) -> Fitted:
    some = Sample(tuple(few.recordings[k] for k in members), few.repeat)
    rough = 0 if z.any() else 25
    return descend(robot, NONE, parameters, some, z, logarithmic=rough, tempered=8, linear=15)


def _explained(fit: Fitted) -> bool:
    return fit.misfit <= calibration()["held_out_adequate"]
