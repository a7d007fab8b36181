"""Before any physics: can the recording be believed, and which postures are kept aside to judge by."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from twin.diagnose.frf_faults import understated
from twin.diagnose.note import Note
from twin.errors import InputError
from twin.measure.campaign import Campaign, PostureFRF, frf_variance
from twin.measure.frf_noise import ANALYSER, perfect
from twin.measure.spectra import Check, driving_points, linearity, reciprocity
from twin.model.recorded import Recorded, base_name, believed
from twin.robot.description import Robot

POOLED_LINES = 5  # lines over which disagreement is pooled
INDEPENDENT_LINES = 25  # of a record whose error is not noise
HOMOGENEOUS = 2.0  # linear robots reach 1.4
OF_LINEAR = ("driving point", "reciprocity")  # checks that hold for a linear robot alone
REPEAT = "repeat"  # the name of a check of a posture recorded again, nobody knows how hard


@dataclass(frozen=True)
class Triage:
    """A recording as a diagnosis uses it.

    Attributes:
        recordings: by group name, variance pooled over lines.
        held_out: names of postures (without force level) kept aside.
        checks: what was looked at; ``warnings`` what failed.
        nonlinear: force levels disagree by more than their noise.
        shared: lines that carry the noise of one independent line.
        assumed: what the recording does not state and was taken for granted, one sentence each.
    """

    recordings: dict[str, Recorded]
    held_out: tuple[str, ...]
    checks: tuple[Check, ...]
    nonlinear: bool
    shared: float = 1.0
    assumed: tuple[str, ...] = ()

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
        """Failed checks, one line for all postures, and what was assumed."""
        failed: dict[tuple[str, str], list[Check]] = {}
        for check in self.checks:
            if not check.passed:
                failed.setdefault((check.kind, check.subject), []).append(check)
        linear = [key for key in failed if key[0] in OF_LINEAR]
        notes = [] if self.nonlinear else [_note(failed[key]) for key in linear]
        if linear and self.nonlinear:
            text = (
                f"{len(linear)} checks that hold for linear robots fail: {', '.join(' '.join(key) for key in linear)}. "
                "That is ordinary where FRFs depend on the force. A fault of a sensor shows at the lowest force, too"
            )
            notes.append(Note(text, "reciprocity", "warning"))
        return [*notes, *(_note(some) for key, some in failed.items() if key not in linear), *self.assumed]


def _note(some: Sequence[Check]) -> Note:
    return Note(_told(some), some[0].kind.replace(" ", "_"), "fail")


def _told(some: Sequence[Check]) -> str:
    """The worst of some failed checks of one subject, and of how many."""
    worst = min(some, key=lambda check: check.value if check.kind == "driving point" else -check.value)
    told = worst.told
    if worst.kind == "linearity":
        told = f"{worst.kind} {worst.subject}: the FRFs differ beyond noise, so they depend on the force"
    return told if len(some) == 1 else f"{told} in the worst of {len(some)} postures where this fails"


def triage(campaign: Campaign, robot: Robot, source: str, hold_out: list[str] | None) -> Triage:
    """Check a campaign and divide its postures.

    Raises:
        InputError: the recording does not fit the robot, or names to hold out are not there.
    """
    recordings, shared = believed(campaign, robot, source)
    times = understated(recordings.values()) if shared == 1 else 1.0  # lines that share noise are smooth
    recordings = {group: replace(r, variance=times * r.variance) for group, r in recordings.items()}
    names = list(dict.fromkeys(r.setup.name for r in recordings.values()))
    groups = {group: base_name(campaign, group) for group in campaign.postures}
    checks: list[Check] = []
    for posture in campaign.postures.values():
        checks += [*driving_points(campaign, posture), *reciprocity(campaign, posture)]
    levels = _linear(campaign, recordings)
    if hold_out is None:
        held: list[str] = _spared(names, recordings)
    else:
        for name in hold_out:
            if name not in names and name not in groups:
                raise InputError("--hold-out", name, f"no such posture in {source}; it has {', '.join(names)}")
        held = [groups.get(name, name) for name in hold_out]
        if set(held) >= set(names):
            raise InputError("--hold-out", ", ".join(hold_out), "nothing is left to fit to")
    noiseless = [name for name, posture in campaign.postures.items() if perfect(posture)]
    if noiseless:  # what an analyser or a simulation is off by is smooth over lines
        lines = float(np.median([len(campaign.postures[name].frequency) for name in noiseless]))
        shared = max(shared, lines / INDEPENDENT_LINES)
    assumed = [
        f"{', '.join(noiseless)}: the coherence is one, so the recording states no noise. An error of {ANALYSER:.1%} "
        "of the response is assumed, as between the channels of an analyser"
    ]
    nonlinear = any(check.kind == "linearity" and not check.passed for check in levels)
    unknown = (
        "recordings of the same posture disagree, and no peak_force_n states how hard it was hit: no law of amplitude "
        "is searched for"
    )
    forceless = any(check.kind == REPEAT and not check.passed for check in levels)
    louder = (
        f"neighbouring lines differ by {times**0.5:.1f} times the noise that the coherence states. The stated noise is "
        "too small; the estimated noise is used"
    )
    notes = [
        *([Note(louder, "noise_understated")] if times > 1 else ()),
        *(Note(text, "noise_unstated", "note") for text in assumed if noiseless),
        *([Note(unknown, "force_unstated", "note")] if forceless else ()),
    ]
    return Triage(recordings, tuple(held), (*checks, *levels), nonlinear, shared, tuple(notes))


def _linear(campaign: Campaign, recordings: dict[str, Recorded]) -> list[Check]:
    """Homogeneity over force levels where it is worst: |H_hi − H_lo|² over its variance, mean of all channels and of
    ``POOLED_LINES`` neighbouring lines, 1 for a linear structure.

    A small cubic spring moves a resonance and nothing else: the mean over a whole band hides it.
    """
    if any(frf_variance(posture) is None for posture in campaign.postures.values()):
        return linearity(campaign)
    checks = []
    for group in _repeated(campaign):
        for low, high in combinations(group, 2):
            a, b = recordings.get(low.name), recordings.get(high.name)
            if a is None or b is None:
                continue
            _, one, two = np.intersect1d(a.frequency.round(6), b.frequency.round(6), return_indices=True)
            if not len(one):
                continue
            variance = 2 * (a.variance[one] + b.variance[two])
            live = np.isfinite(variance) & (variance > 0)
            ratio = np.divide(np.abs(b.frf[two] - a.frf[one]) ** 2, variance, out=np.zeros(live.shape), where=live)
            count = np.convolve(live.sum(axis=(1, 2)), np.ones(POOLED_LINES), "same")
            value = float(
                np.max(np.convolve(ratio.sum(axis=(1, 2)), np.ones(POOLED_LINES), "same") / np.maximum(count, 1))
            )
            known = low.peak_force_n is not None and high.peak_force_n is not None
            names = [f"{p.name} ({p.peak_force_n:.0f} N)" if known else p.name for p in (low, high)]
            checks.append(Check("linearity" if known else REPEAT, " and ".join(names), value, value < HOMOGENEOUS))
    return checks


def _repeated(campaign: Campaign) -> list[list[PostureFRF]]:
    """Postures recorded more than once, whatever their lines; the lowest force first."""
    groups: list[list[PostureFRF]] = []
    for posture in campaign.postures.values():
        for group in groups:
            if np.allclose(group[0].q_deg, posture.q_deg) and group[0].brakes == posture.brakes:
                group.append(posture)
                break
        else:
            groups.append([posture])
    return [sorted(group, key=lambda p: p.peak_force_n or 0.0) for group in groups if len(group) > 1]


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
