"""A robot with a law of amplitude at one joint beside hammer tests: blows stepped, nothing of the robot fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from twin.identify.descent import minimise
from twin.identify.elastic_compare import Judged, recording_set, relative_error
from twin.identify.joint_reaction import PULSE_SPREAD, Stepped
from twin.identify.objective import Sample
from twin.measure.blows import Blow
from twin.measure.campaign import FloatArray
from twin.model.blow import COARSE_HZ
from twin.model.parameters import independent
from twin.model.recorded import Recorded, without_limits
from twin.physics import CATALOGUE
from twin.physics.joint_law import Law
from twin.robot.description import Entry, Robot

SETTLED_LINES, AGAIN = 25, 8  # lines and iterations of what belongs to the recordings themselves
LONGEST = 3.0  # prior deviations of the logarithm of a blow's length within which it is sought
EXACTLY = 0.02  # to which it is


def amplitude_entries(robot: Robot) -> list[Entry]:
    """The robot's entries that answer differently to different force levels."""
    return [entry for entry in robot.physics if CATALOGUE[entry.effect].amplitude_law]


def without_laws(robot: Robot) -> Robot:
    """The robot without these; itself, where it has none."""
    laws = amplitude_entries(robot)
    rest = [entry for entry in robot.physics if entry not in laws]
    return robot.model_copy(update={"physics": rest}) if laws else robot


def law_of(robot: Robot) -> tuple[Law, FloatArray, str, Robot]:
    """The law of a robot's last entry of amplitude, its sizes, its site, and the robot without it."""
    entry = amplitude_entries(robot)[-1]
    stated = CATALOGUE[entry.effect].amplitude_law
    assert stated is not None
    law, sizes = stated.described(entry.values)
    robot = robot.model_copy(update={"physics": [other for other in robot.physics if other is not entry]})
    return law, sizes, entry.site, robot


def settle(judged: Stepped) -> FloatArray:
    """Posture angles and channel gains (n,) in prior deviations that the recordings ask for."""
    z, few = np.zeros(len(judged.free)), judged.sample.thin(SETTLED_LINES)
    for temper in (0.1, 0.02):
        z, *_ = minimise(replace(judged, sample=few, temper=temper, rate_hz=COARSE_HZ), z, AGAIN, 0.1)
    return minimise(replace(judged, sample=few, closely=True), z, AGAIN, 0.1)[0]


def judge_struck(
    robot: Robot, recordings: Sequence[Recorded], blow: Mapping[str, Blow], *, as_is: bool = False
) -> Judged:
    """Predict recordings of a robot with one law of amplitude, see :func:`twin.identify.elastic_compare.judge`.

    The length of blows whose hits are not recorded belongs to the recording, too: with their peak it is their momentum.

    Args:
        robot: with one of :func:`amplitude_entries`.
        recordings: prepared hammer tests; ``blow``: how each group was hit.
        as_is: leave posture angles and channel gains as stated.
    """
    law, sizes, site, plain = law_of(without_limits(robot))
    free, sample = recording_set(plain, recordings), Sample(tuple(recordings))
    judged = Stepped(plain, free, sample, law=law, site=site, blow=dict(blow), fixed=sizes)
    if not all(each.known for each in blow.values()):
        judged = _long(judged)
    if as_is:
        judged = replace(judged, parameters=independent([]))
    z = np.zeros(0) if as_is else settle(judged)
    if not as_is and not all(each.known for each in blow.values()):
        judged = _long(judged, z)
        z = settle(judged)
    predicted = tuple(judged.predicted(z))
    return Judged(
        tuple(recordings), predicted, judged.free, judged.free.values(z), relative_error(recordings, predicted)
    )


def _long(judged: Stepped, z: FloatArray | None = None) -> Stepped:
    """With blows as long as explains the recordings best."""
    z, few = np.zeros(len(judged.free)) if z is None else z, judged.sample.thin(SETTLED_LINES)

    def of(longer: float) -> Stepped:
        blow = {group: replace(b, pulse_s=b.pulse_s * float(np.exp(longer))) for group, b in judged.blow.items()}
        return replace(judged, blow=blow)

    def cost(longer: float) -> float:
        return replace(of(longer), sample=few, rate_hz=COARSE_HZ).cost(z) + 0.5 * (longer / PULSE_SPREAD) ** 2

    reach = LONGEST * PULSE_SPREAD
    return of(float(minimize_scalar(cost, bounds=(-reach, reach), options={"xatol": EXACTLY}).x))
