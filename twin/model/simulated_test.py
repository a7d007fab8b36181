"""A hammer test of the twin as a campaign: FRFs of blows in time, at every test point, at one or several levels."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.measure.campaign import Campaign, PostureFRF
from twin.measure.spectra import posture_from_hits
from twin.model.expansion import channels_of
from twin.model.frf import frf, measurement_chain
from twin.model.hammer import HammerTest, simulate_hits, window_rate
from twin.model.linear import LinearModel
from twin.parallel import Progress, silent
from twin.robot.mechanism import Mechanism

FREQUENCY_SHARE = 0.8  # FRFs are kept up to this share of 1/pulse, where a half sine still excites
LARGE = 0.001  # of FRFs, a tenth of the noise of a careful test: more is told
SMALL = 0.0002  # of FRFs, with the force that is proposed: quiet channels differ by several times that


def simulated_test(
    mechanism: Mechanism,
    linear: LinearModel,
    test: HammerTest,
    force_n: Sequence[float],
    *,
    name: str = "posture",
    q_deg: Sequence[float] | None = None,
    raw_hits: bool = False,
    progress: Progress = silent,
) -> Campaign:
    """Hit a robot at all of its test points and record its accelerometers.

    Args:
        mechanism: the robot in its posture; ``linear`` its linearisation.
        test: how it is hit.
        force_n: peak force of every level, N.
        name: of the posture; several levels are named ``NAME@FORCEN``.
        q_deg: (n,) axis positions as they are recorded, degrees (m); by default the mechanism's.
        raw_hits: keep the time records.
        progress: makes progress bars.
    """
    robot = mechanism.robot
    excitations = [point.label for point in robot.test_points]
    responses = list(robot.accelerometers)
    rate = window_rate(linear, test.duration_s)
    tick = progress("hammer test", len(force_n) * len(excitations) * test.hits)
    postures = {}
    for level in force_n:
        group = name if len(force_n) == 1 else f"{name}@{level:g}N"
        hits = simulate_hits(mechanism, test, level, excitations, responses, progress=tick)
        posture, _ = posture_from_hits(
            group, np.array(robot.degrees(mechanism.q) if q_deg is None else q_deg), mechanism.brakes, hits,
            exponential_window_rate=rate, fmax=FREQUENCY_SHARE / test.pulse_s, source=f"{group}, simulated",
        )  # fmt: skip
        postures[group] = replace(
            posture,
            hits=posture.hits if raw_hits else None,
            pulse_s=test.pulse_s,
            record_s=test.duration_s,
            frf=posture.frf * _unstepped_share(linear, posture, mechanism, responses, excitations),
        )
    comment = "simulated by twin simulate" + (
        "; structural damping and integral action, which no time stepping has, put in by the ratio of the linear FRFs "
        "with them and with viscous dampers in their stead" if _unstepped(linear) else ""
    )  # fmt: skip
    sides = channels_of(mechanism.robot, responses), channels_of(mechanism.robot, excitations)
    return Campaign(*sides, postures, robot.name, comment, f"{name}, simulated")


def beyond_linear(mechanism: Mechanism, linear: LinearModel, test: HammerTest, force_n: float) -> float:
    """How far the FRFs of a blow are off those of small motion, because the robot moves so much: RMS over RMS.

    Of a blow without noise, on the test point that yields most; felt where the robot has accelerometers, or everywhere.
    """
    points = [point.label for point in mechanism.robot.test_points]
    responses = list(mechanism.robot.accelerometers) or points
    soft = np.linalg.pinv(linear.K)  # what only a damper holds does not count
    yields = [float(np.linalg.norm(J @ soft @ J.T)) for J in (linear.points[p][1] for p in points)]
    struck = [points[int(np.argmax(yields))]]
    quiet = replace(test, hits=1, force_spread=0.0, force_noise_n=0.0, response_noise=0.0, off_axis_deg=0.0)
    rate = window_rate(linear, test.duration_s)
    hits = simulate_hits(mechanism, quiet, force_n, struck, responses)
    posture, _ = posture_from_hits(
        "blow", mechanism.q, mechanism.brakes, hits, exponential_window_rate=rate, fmax=FREQUENCY_SHARE / test.pulse_s,
    )  # fmt: skip
    small = frf(
        linear.stepped, posture.frequency[1:], measurement_chain(linear, mechanism.robot, responses, struck),
        posture.quantity, exponential_window_rate=rate,
    )  # fmt: skip
    return float(np.linalg.norm(posture.frf[1:] - small) / np.linalg.norm(small))


def suited_force(force_n: float, off: float) -> float:
    """Peak force (N), one digit, that suits a robot whose FRFs of ``force_n`` are off by ``off``."""
    return float(f"{force_n * SMALL / off:.0e}")


def _unstepped(linear: LinearModel) -> bool:
    return bool(linear.loss.any() or linear.integral.any())


def _unstepped_share(
    linear: LinearModel, posture: PostureFRF, mechanism: Mechanism, responses: list[str], excitations: list[str]
) -> np.ndarray | float:
    """What complex stiffnesses, servos' integral action and roving sensors make of the FRFs that MuJoCo steps."""
    chain = measurement_chain(linear, mechanism.robot, responses, excitations)
    if not (_unstepped(linear) or chain.response_load.any()):
        return 1.0
    frequency, rate = np.maximum(posture.frequency, posture.frequency[1] / 2), posture.exponential_window_rate
    both = [
        frf(model, frequency, seen, exponential_window_rate=rate)
        for model, seen in ((linear, chain), (linear.stepped, replace(chain, response_load=0 * chain.response_load)))
    ]
    return both[0] / both[1]
