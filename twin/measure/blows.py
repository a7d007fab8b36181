"""How a hammer test was hit: peak force, length of the blows and of the records that followed."""

from dataclasses import dataclass

import numpy as np

from twin.measure.campaign import Campaign, PostureFRF

PULSE_S = 0.008  # of a rubber tip, where no raw hits tell
FADED = 7.0  # e-foldings after which a windowed decay is not stepped any further


@dataclass(frozen=True)
class Blow:
    """How one group of a campaign was hit: peak N, length of the half sine s, and of the decay s.

    ``known``: raw hits tell the length.
    """

    peak_n: float
    pulse_s: float
    length_s: float
    known: bool = False


def blows(campaign: Campaign) -> dict[str, Blow] | None:
    """By group; ``None`` where a peak force is not recorded.

    Where the record's length is not stated, it is taken to be one over the spacing of its lines.
    """
    found = {}
    for name, posture in campaign.postures.items():
        if posture.peak_force_n is None:
            return None
        length = record_length_s(posture)
        if posture.exponential_window_rate > 0:
            length = min(length, FADED / posture.exponential_window_rate)
        known = posture.hits is not None or posture.pulse_s is not None
        found[name] = Blow(posture.peak_force_n, _pulse_length(posture), length, known)
    return found


def _pulse_length(posture: PostureFRF) -> float:
    """Of the half sine with the momentum and peak of the recorded hits, else as stated, s."""
    if posture.hits is None:
        return posture.pulse_s or PULSE_S
    force = posture.hits.force - np.median(posture.hits.force, axis=-1, keepdims=True)
    peak = force.max(axis=-1)
    near = force > 0.05 * peak[..., None]
    momentum = np.sum(force * near, axis=-1) / posture.hits.sample_rate_hz
    return float(np.median(np.pi / 2 * momentum / peak))


def record_length_s(posture: PostureFRF) -> float:
    """Length of a posture's records: as stated, or as the spacing of its lines says, which may have been thinned."""
    return posture.record_s or 1 / float(np.median(np.diff(posture.frequency)))
