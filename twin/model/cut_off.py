"""Recordings whose records end while the robot still rings: what such FRFs are of a model, and which modes ring."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from twin.measure.blows import record_length_s
from twin.measure.campaign import Campaign, ComplexArray, FloatArray, PostureFRF
from twin.model.leakage import leakage, leakage_later, leakage_slopes
from twin.model.parameters import independent
from twin.model.recorded import Recorded, fields_of
from twin.model.sensitivity import Observed, Structure, observe_all, poles
from twin.robot.description import Robot

LIGHTEST = 0.01  # damping ratio of the modes of robots, at least: descriptions know little of dampers


@dataclass(frozen=True)
class Leak:
    """How records leak.

    Attributes:
        share: of a record after the middle of the blow, whose second moment is ``spread_s``².
        earlier: of every group by how many s the blows on each point came earlier than that, (ne,).
        variance: of every group (nf, nr, ne), with what the model may be off by; without it the recording's own.
    """

    share: float
    spread_s: float
    earlier: Mapping[str, FloatArray] = field(default_factory=dict)
    variance: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class CutOff(Recorded):
    """A recording whose records ended ``record_s`` after the middle of the blows, while modes still rang."""

    exact: ClassVar[bool] = False
    record_s: float
    spread_s: float
    earlier_s: FloatArray

    @classmethod
    def of(cls, r: Recorded, posture: PostureFRF, how: "Leak") -> "CutOff":
        """A recording that leaks."""
        known = fields_of(r)
        if len(how.variance.get(r.group, ())) == len(r.s):
            known["variance"] = how.variance[r.group]
        earlier = how.earlier.get(r.group, np.zeros(r.frf.shape[2]))
        return cls(**known, record_s=how.share * record_length_s(posture), spread_s=how.spread_s, earlier_s=earlier)

    def respond(self, seen: Observed, model: Structure) -> ComplexArray:
        """FRFs (nf, nr, ne) of a model as they leak."""
        return np.asarray(super().respond(seen, model) - self.lacks(seen))

    def lacks(self, seen: Observed) -> ComplexArray:
        """What records lack of the FRFs of a model, (nf, nr, ne)."""
        lost = leakage(seen, self.s, self.power, self.record_s, self.spread_s)
        return np.asarray(lost + self.earlier_s * self.later(seen) if self.earlier_s.any() else lost)

    def later(self, seen: Observed) -> ComplexArray:
        """What records lack more per second by which blows come earlier, (nf, nr, ne)."""
        return leakage_later(seen, self.s, self.power, self.record_s, self.spread_s)

    def respond_slopes(self, seen: Observed, model: Structure, rate: Observed) -> tuple[ComplexArray, ComplexArray]:
        """The same and its derivatives (n, nf, nr, ne)."""
        H, dH = super().respond_slopes(seen, model, rate)
        L, dL = leakage_slopes(seen, rate, self.s, self.power, self.record_s, self.spread_s)
        earlier = self.earlier_s * self.later(seen) if self.earlier_s.any() else 0.0
        dH -= dL
        return np.asarray(H - L - earlier), dH

    def probed(self, count: int) -> Recorded:
        """What receptance is asked for with ``count`` more excitations: the structure's own, which leaks nothing."""
        return replace(Recorded(**fields_of(self)), power=0)


def ringing(robot: Robot, recordings: Sequence[Recorded], campaign: Campaign) -> Iterator[tuple[float, str, float]]:
    """Of every mode of the band the share of its swing at the end of a record, whose record, and rad/s."""
    for r in recordings:
        record_s, window = record_length_s(campaign.postures[r.group]), float(r.s[0].real)
        ((seen, _),) = observe_all(robot, [r.setup], independent([]), np.zeros(0))
        pole, _ = poles(seen)
        for one in pole[(np.abs(pole) > np.abs(r.s[0])) & (np.abs(pole) < np.abs(r.s[-1]))]:
            decay = max(-float(one.real), LIGHTEST * abs(one)) + window
            yield float(np.exp(-decay * record_s)), r.group, abs(one)


def rings_most(robot: Robot, recordings: Sequence[Recorded], campaign: Campaign) -> tuple[float, str, float]:
    """The largest share of its swing that a mode of the band has at the end of a record, whose, and its Hz."""
    left, group, rate = max(ringing(robot, recordings, campaign), default=(0.0, "", 0.0))
    return left, group, rate / 2 / np.pi
