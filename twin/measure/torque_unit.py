"""Whether a log's torque may be in another unit, or at the motors: beside what the robot needs as it is described."""

import numpy as np

from twin.measure.campaign import FloatArray

OTHER_UNIT = 8.0  # times the described torque, most axes, from which a log is hardly the robot's in these units
STILL = 1e-3  # of the largest described torque: an axis that needs less stands still, and tells no unit


def unit_note(described: FloatArray, recorded: FloatArray) -> str | None:
    """What to say where described over recorded torque (m, n), RMS, is far from 1 at most axes; ``None`` where not."""
    needed, found = (np.sqrt(np.mean(torque**2, axis=0)) for torque in (described, recorded))
    telling = (needed > STILL * needed.max(initial=0.0)) & (found > 0)
    if not telling.any():
        return None
    middle = float(np.median(needed[telling] / found[telling]))
    if 1 / OTHER_UNIT < middle < OTHER_UNIT:
        return None
    if middle > 1:
        return (
            f"the robot as described needs {middle:.3g} times the recorded torque: is it the torque at the motor "
            "(factor: the gear ratio), or in another unit?"
        )
    return f"the recorded torque is {1 / middle:.3g} times what the robot as described needs: is it in another unit?"
