"""Numbers against what can be: a slip of units (degrees, g, mm, lbf …) is refused, and named as the likely cause.

FRFs are compared with the described robot's. Between its modes an accelerance follows the masses, which are known
within some tens of per cent. A slip is a factor of 4.4 or more. Torques are compared with the robot's weight at arm's
length, and with the torque that the described robot needs for the motion.
"""

import warnings
from dataclasses import replace

import numpy as np

from twin.errors import InputError, Told, tell
from twin.identify.rigid_compare import compare_log
from twin.measure.campaign import Campaign
from twin.measure.motion_log import MotionLog, MotionRun, check_against, torque_slip, weight_felt
from twin.measure.units import INCH_M, POUND_FORCE_N, STANDARD_GRAVITY, measure
from twin.model.parameters import can_vibrate
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
ANGLES = {"rad": 1.0, "degrees": np.pi / 180}  # what positions may be in by mistake
TORQUES = {"N·m": 1.0, "lbf·in": POUND_FORCE_N * INCH_M, "kgf·m": STANDARD_GRAVITY, "N·mm": 1e-3, "kN·m": 1e3}
LOOKED_AT_S = 30.0  # of a log
LOOKED_AT_HZ = 250.0  # samples of a log are averaged to about as many: a slip shows below 10 Hz
LEAST_TRAVEL = 0.1  # rad, of the axis that moves most, below which degrees were perhaps not degrees
UNLIKE = 0.5  # error of the described torque from which a slip is looked for; undone, it is less than half of that
LIKE = 0.5  # correlation, -1 to 1: below its negative, lines of opposite sign outweigh the others three to one
LIKE_A_SLIP = 1.8  # ratios within this factor of a slip, and farther than that from 1, are one


def check_log(log: MotionLog, robot: Robot | None, position: str = "rad", torque: str = "N·m") -> None:
    """Raise where a log cannot be in the units ``position`` and ``torque`` that were declared.

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
    if not weight_felt(robot).all():
        return
    if found := torque_slip(log, robot, torque):
        raise InputError(log.source, *found)
    _check_slips(log, robot, _slips(position, torque))
    _tell_travel(log, robot, position)


def _tell_travel(log: MotionLog, robot: Robot, position: str) -> None:
    """Tell where no axis moves as far as in a log that one would record: rad declared as degrees look so."""
    turns = [axis.type == "revolute" for axis in robot.axes]
    if not all(turns) or measure(position) == measure("rad"):
        return
    farthest = max(float(np.ptp(run.position, axis=0).max()) for run in log.runs.values())
    if farthest < LEAST_TRAVEL:
        told = f"no axis moves by more than {np.rad2deg(farthest):.2g}°; are these rad, declared {position}?"
        tell(log.source, "position", told)


def _thinned(run: MotionRun) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Time, position and torque of the first ``LOOKED_AT_S``, samples averaged to about ``LOOKED_AT_HZ``; the rate."""
    assert run.torque is not None
    every = max(1, int(run.sample_rate_hz / LOOKED_AT_HZ))
    count = min(round(LOOKED_AT_S * run.sample_rate_hz), len(run.time)) // every * every

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(values[:count].reshape(-1, every, *values.shape[1:]).mean(axis=1))

    return mean(run.time), mean(run.position), mean(run.torque), run.sample_rate_hz / every


def _slips(position: str, torque: str) -> dict[tuple[float, float], str]:
    """Factors of positions and of torques that undo a slip, and what it looks like."""
    found: dict[tuple[float, float], str] = {}
    (angle, turn), (moment, size) = measure(position), measure(torque)
    if angle == "angle":
        declared = {"deg": "degrees", "°": "degrees"}.get(position, position)
        for unit, value in ANGLES.items():
            found[value / turn, 1.0] = f"the positions look like {unit}, declared {declared}"
    if moment == "torque":
        for unit, value in TORQUES.items():
            found[1.0, value / size] = f"the torques look like {unit}, declared {torque}; currents need a `factor`"
    return {factors: text for factors, text in found.items() if not np.allclose(factors, 1.0)}


def _check_slips(log: MotionLog, robot: Robot, slips: dict[tuple[float, float], str]) -> None:
    """Raise where another unit brings the torques far nearer to what the described robot needs for the motion."""
    name, run = max(log.runs.items(), key=lambda item: len(item[1].time))
    if run.torque is None:
        return
    time, position, torque, rate = _thinned(run)

    def judged(turns: float, torques: float) -> tuple[float, tuple[str, ...]]:
        """Error, and what there is to say of it."""
        scaled = MotionRun(name, time, turns * position, rate, torques * torque)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Told)  # what is told is of units that nobody declared
            try:
                found = compare_log(replace(log, runs={name: scaled}, notes=()), robot)
            except InputError:  # too short to judge, or no motion of this robot
                return np.inf, ()
        return found.error, found.notes

    declared, notes = judged(1.0, 1.0)
    if not UNLIKE < declared < np.inf:
        return
    found = {factors: judged(*factors)[0] for factors in slips}
    likely = min(found, key=lambda factors: found[factors], default=None)
    if likely and found[likely] < UNLIKE * min(declared, 1.0):
        raise InputError(
            log.source, f"{name}: unit",
            f"torques miss those of {robot.name} as described by {declared:.0%}, otherwise by {found[likely]:.0%}: "
            f"{slips[likely]}",
        )  # fmt: skip
    for note in notes:
        tell(log.source, f"{name}: torque", note)


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
    if not can_vibrate(robot):
        return
    (low, ratio, high), alike = _over_described(campaign, robot)
    likely = min(SLIPS, key=lambda slip: abs(np.log(ratio / slip)))
    if likely / LIKE_A_SLIP < low and high < likely * LIKE_A_SLIP and not 1 / LIKE_A_SLIP < ratio < LIKE_A_SLIP:
        found = f"FRFs are {ratio:.3g} times those of {robot.name} as described"
        raise InputError(campaign.source, "unit", f"{found}: {SLIPS[likely]}")
    if alike < -LIKE:
        text = f"FRFs have the opposite sign of those of {robot.name} as described: is a factor -1 missing, or wrong?"
        tell(campaign.source, "factor", text)


def _over_described(campaign: Campaign, robot: Robot) -> tuple[tuple[float, float, float], float]:
    """Quartiles over all lines of measured over described FRF matrix, in the Frobenius norm; and their correlation.

    On recordings of robots near their description the median is within 1.02 of 1. Few channels that hardly move scatter
    widely, over the quartiles too, and then tell nothing.
    """
    from twin.identify.elastic_compare import judge
    from twin.model.recorded import prepare

    judged = judge(robot, list(prepare(campaign, robot, campaign.source).values()), as_is=True)
    ratios = [
        np.linalg.norm(r.frf, axis=(1, 2)) / np.linalg.norm(p, axis=(1, 2))
        for r, p in zip(judged.recordings, judged.predicted, strict=True)
    ]
    low, middle, high = np.quantile(np.concatenate(ratios), [0.25, 0.5, 0.75])
    alike = []
    for r, p in zip(judged.recordings, judged.predicted, strict=True):
        sizes = np.linalg.norm(p, axis=(1, 2)) * np.linalg.norm(r.frf, axis=(1, 2))
        alike.append(np.sum(np.conj(p) * r.frf, axis=(1, 2)).real / sizes)
    return (float(low), float(middle), float(high)), float(np.mean(np.concatenate(alike)))
