"""Numbers against what can be: a slip of units (degrees, g, mm, lbf …) is refused, and named as the likely cause.

FRFs are held against the described robot's: between its modes an accelerance follows the masses, which are known within
some tens of per cent, while a slip is a factor of 4.4 or more. Torques are held against the robot's weight at arm's
length.
"""

import numpy as np

from twin.errors import InputError
from twin.measure.campaign import Campaign
from twin.measure.motion_log import MotionLog, check_against
from twin.measure.units import INCH_M, POUND_FORCE_N, STANDARD_GRAVITY
from twin.robot.description import Robot

FARTHEST_M = 20.0  # no point of a robot is farther from its body's frame
MOST_TURNS = 4.0  # revolutions beyond which a joint angle is hardly one in rad; 57 lie between the units
SLIPS = {  # measured over predicted accelerance → what was declared, and what it looks like
    1 / STANDARD_GRAVITY: "the response looks like g, declared m/s²",
    STANDARD_GRAVITY: "the response looks like m/s², declared g",
    1e3: "the response looks like mm (mm/s²), declared m (m/s²)",
    1e-3: "the response looks like m (m/s²), declared mm (mm/s²)",
    POUND_FORCE_N: "the force looks like lbf, declared N",
    1 / POUND_FORCE_N: "the force looks like N, declared lbf",
    1 / INCH_M: "the response looks like inches (in/s²), declared m (m/s²)",
}
LIKE_A_SLIP = 1.8  # ratios within this factor of a slip, and farther than that from 1, are one


def check_log(log: MotionLog, robot: Robot | None) -> None:
    """Raise where a log cannot be in the units that were declared.

    Raises:
        InputError: the likely slip by name.
    """
    for name, run in log.runs.items():
        largest = float(np.abs(run.position).max())
        if robot is None and largest > 2 * np.pi * MOST_TURNS:
            raise InputError(
                log.source, f"{name}: position", f"reaches {largest:.4g} rad; expected rad, these look like degrees"
            )
    if robot is None:
        return
    check_against(log, robot)
    weight = _weight_moment(robot)
    for name, run in log.runs.items():
        if run.torque is None:
            continue
        largest = float(np.abs(run.torque).max())
        if largest > 30 * weight:
            expected = f"the robot's weight at arm's length makes {weight:.3g}; these look like N·mm"
        elif largest < weight / 1000:
            expected = (
                f"the robot's weight at arm's length makes {weight:.3g}; these look like kN·m, or like torque at "
                "the motor (factor: the gear ratio)"
            )
        else:
            continue
        raise InputError(log.source, f"{name}: torque", f"reaches {largest:.4g} N·m; {expected}")


def _weight_moment(robot: Robot) -> float:
    """Moment, N·m, of the moving links' weight held out at half the sum of the links' lengths."""
    mass = sum(link.mass or 0.0 for link in robot.links)
    reach = sum(float(np.hypot(axis.a, axis.d)) for axis in robot.axes)
    return max(mass * STANDARD_GRAVITY * reach / 2, 1e-6)


def check_campaign_units(campaign: Campaign, robot: Robot | None) -> None:
    """Raise where a hammer test cannot be in the units that were declared.

    Raises:
        InputError: the likely slip by name.
    """
    for side, channels in (("response", campaign.response), ("excitation", campaign.excitation)):
        farthest = float(np.abs(channels.position).max())
        if farthest > FARTHEST_M:
            raise InputError(
                campaign.source, f"{side}: position", f"{farthest:.4g} m from its body; these look like mm"
            )
    if robot is None or any(posture.q_deg.size == 0 for posture in campaign.postures.values()):
        return
    low, ratio, high = _over_described(campaign, robot)
    likely = min(SLIPS, key=lambda slip: abs(np.log(ratio / slip)))
    if likely / LIKE_A_SLIP < low and high < likely * LIKE_A_SLIP and not 1 / LIKE_A_SLIP < ratio < LIKE_A_SLIP:
        found = f"FRFs are {ratio:.3g} times those of {robot.name} as described"
        raise InputError(campaign.source, "unit", f"{found}: {SLIPS[likely]}")


def _over_described(campaign: Campaign, robot: Robot) -> tuple[float, float, float]:
    """Quartiles over all lines of measured over described FRF matrix, in the Frobenius norm.

    On recordings of robots near their description the median is within 1.02 of 1. Few channels that hardly move scatter
    widely, over the quartiles too, and then tell nothing.
    """
    from twin.identify.elastic_compare import judge
    from twin.identify.recorded import prepare

    judged = judge(robot, list(prepare(campaign, robot, campaign.source).values()), as_is=True)
    ratios = [
        np.linalg.norm(r.frf, axis=(1, 2)) / np.linalg.norm(p, axis=(1, 2))
        for r, p in zip(judged.recordings, judged.predicted, strict=True)
    ]
    low, middle, high = np.quantile(np.concatenate(ratios), [0.25, 0.5, 0.75])
    return float(low), float(middle), float(high)
