"""Before any physics: can the recording be believed, and which postures are kept aside to judge by."""

from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.noise import pooled_variance
from twin.errors import InputError
from twin.identify.elastic import Recorded, base_name, prepare
from twin.measure.campaign import Campaign
from twin.measure.spectra import Check, driving_points, linearity, reciprocity
from twin.robot.description import Robot


@dataclass(frozen=True)
class Triage:
    """A recording as a diagnosis uses it.

    Attributes:
        recordings: by group name, variance pooled over lines.
        held_out: names of postures (without force level) kept aside.
        checks: what was looked at; ``warnings`` what failed.
        nonlinear: force levels disagree by more than their noise.
    """

    recordings: dict[str, Recorded]
    held_out: tuple[str, ...]
    checks: tuple[Check, ...]
    nonlinear: bool

    @property
    def used(self) -> list[Recorded]:
        """What is fitted to."""
        return [r for r in self.recordings.values() if r.setup.name not in self.held_out]

    @property
    def kept(self) -> list[Recorded]:
        """What is judged on."""
        return [r for r in self.recordings.values() if r.setup.name in self.held_out]

    @property
    def warnings(self) -> list[str]:
        """Failed checks, one line each."""
        return [str(check) for check in self.checks if not check.passed]


def triage(campaign: Campaign, robot: Robot, source: str, hold_out: list[str] | None) -> Triage:
    """Check a campaign and divide its postures.

    Raises:
        InputError: the recording does not fit the robot, or names to hold out are not there.
    """
    recordings = {}
    for name, recorded in prepare(campaign, robot, source).items():
        variance = pooled_variance(campaign.postures[name])
        lines = np.isin(campaign.postures[name].frequency, recorded.frequency)
        recordings[name] = recorded if variance is None else replace(recorded, variance=variance[lines])
    names = list(dict.fromkeys(r.setup.name for r in recordings.values()))
    groups = {group: base_name(campaign, group) for group in campaign.postures}
    checks: list[Check] = []
    for posture in campaign.postures.values():
        checks += [*driving_points(campaign, posture), *reciprocity(campaign, posture)]
    levels = linearity(campaign)
    if hold_out is None:
        held: list[str] = _spared(names, recordings)
    else:
        for name in hold_out:
            if name not in names and name not in groups:
                raise InputError("--hold-out", name, f"no such posture in {source}; it has {', '.join(names)}")
        held = [groups.get(name, name) for name in hold_out]
        if set(held) >= set(names):
            raise InputError("--hold-out", ", ".join(hold_out), "nothing is left to fit to")
    return Triage(recordings, tuple(held), (*checks, *levels), any(not check.passed for check in levels))


def _spared(names: list[str], recordings: dict[str, Recorded]) -> list[str]:
    """Postures the others cover best: one in every six, of three or more."""
    if len(names) < 3:
        return []
    q = {r.setup.name: r.setup.q for r in recordings.values()}
    held: list[str] = []
    for _ in range(max(1, len(names) // 6)):
        left = [name for name in names if name not in held]
        gap = {a: min(float(np.linalg.norm(q[a] - q[b])) for b in left if b != a) for a in left}
        held.append(min(left, key=lambda name: gap[name]))
    return held
