"""A joint's law of amplitude, held as what it was to every blow: how linear models are fitted to a nonlinear robot.

After a blow F the law adds a torque T at joint j of a robot that is linear otherwise (:mod:`twin.model.blow`):

    H = H_lin − G_j T/F,    T/F = κ φ/F + rest.

φ is the joint's rotation. κ = k + s c is the complex stiffness that comes closest to what the law did after that blow.
The rest is what is left of the law's torque. κ and the rest are held at what stepping gave. Then H, law included, is a
closed form of the linear model, and T follows the rotation as the model changes.
"""

from dataclasses import dataclass, replace

import numpy as np

from twin.measure.campaign import ComplexArray
from twin.model.recorded import Recorded, fields_of
from twin.model.sensitivity import Observed, Structure, frf, frf_slopes

CACHED = 8  # parameters at a time: their derivatives stay in the cache of a core


@dataclass(frozen=True)
class UnderLaw(Recorded):
    """A recording of a robot with a law at one joint.

    Attributes:
        site: ``joint2.z``.
        kappa, rest: (nf, ne) of the law's torque over the blow.
    """

    site: str
    kappa: ComplexArray
    rest: ComplexArray

    @classmethod
    def of(cls, r: Recorded, site: str, kappa: ComplexArray, rest: ComplexArray) -> "UnderLaw":
        """A recording with a law held."""
        return cls(**fields_of(r), site=site, kappa=kappa, rest=rest)

    def respond(self, seen: Observed, model: Structure) -> ComplexArray:
        """FRFs (nf, nr, ne) of a model where and as they were recorded, the law included."""
        joint = receptances(seen, model.coordinates.index(self.site), self.s, self.power)
        return joint.reacting(joint.reaction(self.kappa, self.rest))

    def respond_slopes(self, seen: Observed, model: Structure, rate: Observed) -> tuple[ComplexArray, ComplexArray]:
        """The same and its derivatives (n, nf, nr, ne)."""
        joint = receptances(seen, model.coordinates.index(self.site), self.s, self.power, rate)
        reaction = joint.reaction(self.kappa, self.rest)
        return joint.reacting(reaction), joint.slopes(reaction, joint.reaction_slopes(self.kappa, reaction))

    def probed(self, count: int) -> "UnderLaw":
        """What receptance is asked for with ``count`` more excitations; to them the law is what it is to blows on
        average."""
        mean = np.tile(self.kappa.mean(axis=1, keepdims=True), count)
        rest = np.zeros((len(self.s), count))
        return replace(self, power=0, kappa=np.hstack([self.kappa, mean]), rest=np.hstack([self.rest, rest]))

    def every(self, step: int) -> "UnderLaw":
        """Every ``step``-th line."""
        keep = slice(step // 2, None, step)
        thin = Recorded(**fields_of(self)).every(step)
        return UnderLaw.of(thin, self.site, self.kappa[keep], self.rest[keep])


@dataclass
class Receptances:
    """A linear model seen from one joint: receptances between channels and a torque (rotation) there.

    Attributes:
        H: (nf, nr, ne) as recorded, without the law. ``out`` (nf, nr): response per torque at the joint. ``into`` (nf,
            ne): the joint's rotation per force. ``own`` (nf,): the joint's rotation per torque there.
        rates: derivatives of the same with respect to the parameters, first axis n.
    """

    H: ComplexArray
    out: ComplexArray
    into: ComplexArray
    own: ComplexArray
    rates: tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray] | None = None

    def reaction(self, kappa: ComplexArray, rest: ComplexArray | float = 0.0) -> ComplexArray:
        """T/F (nf, ne), by the rank-one update of the inverse."""
        return np.asarray((kappa * self.into + rest) / (1 + kappa * self.own[:, None]))

    def reacting(self, reaction: ComplexArray) -> ComplexArray:
        """FRFs (nf, nr, ne) with that torque at the joint."""
        return np.asarray(self.H - self.out[:, :, None] * reaction[:, None, :])

    def reaction_slopes(self, kappa: ComplexArray, reaction: ComplexArray) -> ComplexArray:
        """Derivatives (n, nf, ne) of a reaction with κ and the rest held."""
        assert self.rates is not None
        dinto, down = self.rates[2:]
        return np.asarray(kappa / (1 + kappa * self.own[:, None]) * (dinto - down[:, :, None] * reaction))

    def slopes(self, reaction: ComplexArray, change: ComplexArray) -> ComplexArray:
        """Derivatives (n, nf, nr, ne) of :meth:`reacting` where the reaction's are ``change`` (n, nf, ne)."""
        assert self.rates is not None
        dH, dout = self.rates[:2]
        found = np.empty(dH.shape, complex)
        for some in (slice(at, at + CACHED) for at in range(0, len(found), CACHED)):
            np.subtract(dH[some], dout[some, :, :, None] * reaction[:, None, :], out=found[some])
            found[some] -= self.out[:, :, None] * change[some, :, None, :]
        return found


def receptances(seen: Observed, index: int, s: ComplexArray, power: int, rate: Observed | None = None) -> Receptances:
    """A model seen from coordinate ``index``; with the derivatives ``rate`` of :class:`Observed` also theirs."""
    unit = np.eye(len(seen.M))[index][None]
    wide = replace(
        seen, J_r=np.vstack([seen.J_r, unit]), J_e=np.vstack([seen.J_e, unit]),
        gain=np.append(seen.gain, 1.0), delay=np.append(seen.delay, 0.0), load=np.pad(seen.load, (0, 1)), sag=None,
    )  # fmt: skip
    back = s[:, None] ** -power
    if rate is None:
        H, rates = frf(wide, s, power), None
    else:
        n, nv = len(rate.M), len(seen.M)
        row, one = np.zeros((n, 1, nv)), np.zeros((n, 1))
        rate = replace(
            rate, J_r=np.concatenate([rate.J_r, row], axis=1), J_e=np.concatenate([rate.J_e, row], axis=1),
            gain=np.hstack([rate.gain, one]), delay=np.hstack([rate.delay, one]),
            load=np.pad(rate.load, ((0, 0), (0, 1), (0, 1))),
        )  # fmt: skip
        H, dH = frf_slopes(wide, rate, s, power)
        rates = dH[:, :, :-1, :-1], dH[:, :, :-1, -1], dH[:, :, -1, :-1] * back, dH[:, :, -1, -1] * back[:, 0]
    return Receptances(H[:, :-1, :-1], H[:, :-1, -1], H[:, -1, :-1] * back, H[:, -1, -1] * back[:, 0], rates)
