"""A robot with one nonlinear joint on measured FRFs: blow by blow as a complex stiffness, or as a law stepped in time.

Both are costs over the base model's parameters, with derivatives, in prior coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin.identify.objective import Cost
from twin.measure.blows import PULSE_S, Blow
from twin.measure.campaign import Channels, ComplexArray, FloatArray
from twin.model.blow import COLUMNS, RATE_HZ, Strike, pulse_transform, torques, transform
from twin.model.held_law import Receptances, UnderLaw, receptances
from twin.model.parameters import Parameters
from twin.model.rates import Changes, rates
from twin.model.recorded import Recorded
from twin.model.sensitivity import Observed, Setup, Structure, contract, moving, observe, observe_all
from twin.parallel import spread
from twin.physics.joint_law import NO_LOAD, Law
from twin.robot.description import Robot

PULSE_SPREAD = 0.2  # prior deviation of the logarithm of ``PULSE_S``
OWN_STIFFNESS, OWN_LOSS = 0.5, 0.1  # prior deviations of a blow's own k and ωc (at 15 Hz), of the joint's stiffness
BLOW_STEPS = 6  # iterations of a blow's own stiffness
FINE_DIFFERENCE, ROUGH_DIFFERENCE, WIDE = 1e-4, 4e-3, 0.02  # prior deviations, of differences of stepped blows
STAYED = 2.0  # prior deviations, over which the law's torque keeps what its derivatives have beside those held
WORTH_SPREADING = 20  # strikes per recording: fewer are stepped by one process
WEIGHED = 0.1  # prior deviations, of differences of the load on a joint
ERRATIC = 4  # steps in turn: where 1/64 of one still raises the cost, decays are erratic (an open gap's)
BEND_AHEAD = 0.1  # of a step: where its bend is looked at


# --- a joint's reaction, blow by blow ---------------------------------------------------------------------------------


@dataclass
class _Joint:
    """A posture's model, the joint's coordinate in it, its spring and the load on it, and what is seen from there;
    derivatives of the model; which blows (ne,) are stepped, all by default."""

    seen: Observed
    index: int
    k: float
    load: float
    view: Receptances
    rate: Observed | None = None
    blows: NDArray[np.bool_] | None = None

    def hit(self, blows: NDArray[np.bool_]) -> "_Joint":
        """The same where only some of the blows (ne,) are stepped."""
        return replace(self, seen=replace(self.seen, J_e=self.seen.J_e[blows]), blows=blows)


class _Postures:
    """Joint models by posture at one place: levels of a posture share them, and all are observed in one go.

    Args:
        z: (n,) of ``parameters``, where the robot is.
        recordings: those that will be asked for.
    """

    def __init__(
        self, robot: Robot, parameters: Parameters, site: str, z: FloatArray, recordings: Sequence[Recorded]
    ) -> None:
        self.z, self.values = z, parameters.values(z)
        self.robot = parameters.apply(robot, self.values)
        self.parameters, self.site = parameters, site
        self.setups = _sharing({r.setup.name: r.setup for r in recordings})
        self.seen: dict[str, tuple[Observed, Structure]] = {}
        self.known: dict[tuple[str, bytes, int, bool], _Joint] = {}
        self.changes: Changes = {}
        self.loads: dict[str, tuple[list[int], FloatArray]] = {}
        self.apart: dict[int, dict[int, tuple[_Joint, NDArray[np.bool_]]]] = {}

    def of(self, r: Recorded, slopes: bool = False) -> _Joint:
        """The model of a recording's posture, seen along its lines; with ``slopes`` its derivatives, too."""
        key = r.setup.name, r.s.tobytes(), r.power
        if (*key, True) in self.known:
            return self.known[*key, True]
        if (*key, slopes) not in self.known:
            self.known[*key, slopes] = self._joint(r, slopes)
        return self.known[*key, slopes]

    def _joint(self, r: Recorded, slopes: bool) -> _Joint:
        if not self.seen:
            models = observe_all(self.robot, list(self.setups.values()), self.parameters, self.values)
            self.seen = dict(zip(self.setups, models, strict=True))
        seen, model = self.seen[r.setup.name]
        index, rate = model.coordinates.index(self.site), None
        if slopes:
            rate = rates(self.robot, r.setup, self.parameters, self.values, seen, model, self.changes)
            rate = contract(rate, self.parameters.transform(self.values))
        view = receptances(seen, index, r.s, r.power, rate)
        return _Joint(seen, index, float(model.strain[index]), float(model.load[index]), view, rate)

    def moved(self, r: Recorded, step: float) -> dict[int, tuple[_Joint, NDArray[np.bool_]]]:
        """The joint's model with every parameter that acts on its motion moved in turn, to first order, and the blows
        (ne,) for which that is another model: where a node lies is of no matter to blows elsewhere."""
        joint = self.of(r, True)
        if id(joint) in self.apart:
            return self.apart[id(joint)]
        rates = joint.view.rates
        assert joint.rate is not None
        assert rates is not None
        loads = np.zeros(len(self.z))
        if abs(joint.load) > NO_LOAD:
            loaded, rate = self.load_slopes(r)
            loads[loaded] = rate
        acting = replace(
            joint.rate,
            J_r=joint.rate.J_r[:, :0],
            gain=joint.rate.gain[:, :0],
            delay=joint.rate.delay[:, :0],
            load=joint.rate.load[:, :0],
        )
        view, found = joint.view, {}
        for p in sorted({*moving(acting).tolist(), *np.flatnonzero(loads).tolist()}):
            moves = zip(joint.seen.arrays(), joint.rate.arrays(), strict=True)
            seen = Observed.of(a + step * d[p] if d[p].any() else a for a, d in moves)
            dinto, down = rates[2][p], rates[3][p]
            there = replace(view, into=view.into + step * dinto, own=view.own + step * down, rates=None)
            everywhere = bool(loads[p]) or any(d[p].any() for d in joint.rate.arrays()[:5])
            here = _Joint(seen, joint.index, joint.k, joint.load + step * loads[p], there)
            found[p] = here, joint.rate.J_e[p].any(axis=1) | everywhere
        self.apart[id(joint)] = found
        return found

    def load_slopes(self, r: Recorded) -> tuple[list[int], FloatArray]:
        """Which parameters the weight on the joint depends on, and its derivatives (m,) with respect to their z."""
        if r.setup.name not in self.loads:
            index = self.of(r).index
            loaded = [
                k
                for k, p in enumerate(self.parameters)
                if (p.kind == "link" and ".inertia." not in p.name) or p.name.startswith(f"posture.{r.setup.name}.")
            ]
            changes = []
            for k in loaded:
                values = self.parameters.values(self.z + WEIGHED * np.eye(len(self.z))[k])
                _, model = observe(self.parameters.apply(self.robot, values), r.setup, self.parameters, values)
                changes.append((float(model.load[index]) - self.of(r).load) / WEIGHED)
            self.loads[r.setup.name] = loaded, np.array(changes)
        return self.loads[r.setup.name]


def _sharing(setups: dict[str, Setup]) -> dict[str, Setup]:
    """Postures hit at the same points share one object of channels: those are observed together."""
    known: dict[tuple[tuple[str, ...], bytes, bytes], Channels] = {}

    def one(channels: Channels) -> Channels:
        key = channels.label, channels.position.tobytes(), channels.direction.tobytes()
        return known.setdefault(key, channels)

    return {
        name: replace(setup, response=one(setup.response), excitation=one(setup.excitation))
        for name, setup in setups.items()
    }


@dataclass
class BlowByBlow(Cost):
    """Cost of a base model in which every blow has its own complex stiffness at one joint, settled inside.

    Attributes:
        own: per recording (2, ne) the blow's stiffness and damping beside the joint's.
        certainty: (2, 2, ne) their Gauss–Newton matrices, prior included.
    """

    site: str = ""
    own: list[FloatArray] = field(default_factory=list)
    certainty: list[FloatArray] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.models: _Postures | None = None
        self.own = [np.zeros((2, r.frf.shape[2])) for r in self.sample.recordings]
        self.certainty = list(self.own)

    def cost(self, z: FloatArray) -> float:
        postures = self._postures(z)
        own, cost = list(self.own), 0.5 * float(z @ z)
        for k, r in enumerate(self.sample.recordings):
            own[k], part, _, _, _ = self._settle(postures.of(r), r, k)
            cost += part
        return cost

    def __call__(self, z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        postures = self._postures(z)
        cost, gradient, information = 0.5 * float(z @ z), z.copy(), np.eye(len(z))
        for k, r in enumerate(self.sample.recordings):
            joint = postures.of(r, True)
            self.own[k], part, e, rate, matrix = self._settle(joint, r, k)
            self.certainty[k] = matrix
            cost += part
            kappa = self.own[k][0] + r.s[:, None] * self.own[k][1]
            R = joint.view.reaction(kappa)
            J = -joint.view.slopes(R, joint.view.reaction_slopes(kappa, R)) * self.weight[k]
            n = len(z)
            G = J.reshape(n, -1).view(float)
            gradient += G @ e.reshape(-1).view(float)
            information += G @ G.T
            # what the blow's own stiffness takes away: Schur's complement, blow by blow
            cross = np.einsum("nfre,pfre->npe", J.real, rate.real) + np.einsum("nfre,pfre->npe", J.imag, rate.imag)
            taken = np.einsum("npe,pqe->nqe", cross, inverse2(matrix))
            information -= np.einsum("nqe,mqe->nm", taken, cross)
        return cost, gradient, information

    def _postures(self, z: FloatArray) -> _Postures:
        """The models at z; those of the last call where it is the same."""
        if self.models is None or not np.array_equal(self.models.z, z):
            self.models = _Postures(self.robot, self.parameters, self.site, z, self.sample.recordings)
        return self.models

    def _settle(
        self, joint: _Joint, r: Recorded, k: int
    ) -> tuple[FloatArray, float, ComplexArray, ComplexArray, FloatArray]:
        """Each blow's own stiffness and damping at its optimum: values, cost, residual, rates (2, …), matrix."""
        w = self.weight[k]
        width = np.array([OWN_STIFFNESS * joint.k, OWN_LOSS * joint.k / (2 * np.pi * 15.0)])
        u = self.own[k] / width[:, None]
        line = np.stack([np.full(len(r.s), width[0], complex), width[1] * r.s])

        def look(u: FloatArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
            kappa = np.tensordot(line.T, u, 1)
            e = np.asarray((r.frf - joint.view.reacting(joint.view.reaction(kappa))) * w, complex)
            parts = 0.5 * np.sum(np.abs(e) ** 2, axis=(0, 1)) + 0.5 * np.sum(u**2, axis=0)
            return parts, e, kappa

        parts, e, kappa = look(u)
        damping = np.full(u.shape[1], 1e-3)
        for _ in range(BLOW_STEPS):
            rate = self._own_rate(joint, kappa, w, line)
            gradient = np.einsum("pfre,fre->pe", rate.conj(), e).real + u
            matrix = np.einsum("pfre,qfre->pqe", rate.conj(), rate).real + np.eye(2)[:, :, None]
            damped = matrix + damping * np.eye(2)[:, :, None] * matrix[[0, 1], [0, 1]].max(axis=0)
            step = -np.einsum("pqe,qe->pe", inverse2(damped), gradient)
            step /= np.maximum(1.0, np.abs(step).max(axis=0))
            trial, _, _ = look(u + step)
            better = trial < parts
            u = np.where(better, u + step, u)
            damping = np.where(better, damping / 10, damping * 10)
            gained = float(np.sum(np.where(better, parts - trial, 0.0)))
            parts, e, kappa = look(u)
            if gained < 0.01:
                break
        rate = self._own_rate(joint, kappa, w, line)
        matrix = np.einsum("pfre,qfre->pqe", rate.conj(), rate).real + np.eye(2)[:, :, None]
        scaled = np.asarray(matrix / (width[:, None] * width)[:, :, None])
        return u * width[:, None], float(parts.sum()), e, rate / width[:, None, None, None], scaled

    @staticmethod
    def _own_rate(joint: _Joint, kappa: ComplexArray, w: FloatArray, line: ComplexArray) -> ComplexArray:
        """∂ residual / ∂ (the blow's own coordinates), (2, nf, nr, ne)."""
        slope = joint.view.into / (1 + kappa * joint.view.own[:, None]) ** 2
        return np.asarray(line[:, :, None, None] * (joint.view.out[:, :, None] * slope[:, None, :] * w))


def inverse2(matrix: FloatArray) -> FloatArray:
    """Inverse of (2, 2, ne)."""
    (a, b), (c, d) = matrix
    return np.asarray(np.array([[d, -b], [-c, a]]) / (a * d - b * c))


# --- laws, stepped in time --------------------------------------------------------------------------------------------

Asked = tuple[_Joint, Recorded, FloatArray, float]
"""What is stepped: the blows of a recording on a joint's model, sizes of the law, and how much longer blows are."""


@dataclass
class Stepped(Cost):
    """Cost of a base model with a law at one joint; ``robot`` lacks its entry, ``parameters`` end with the law's own.

    Without raw hits, the last parameter is the length of the blows. At a known peak the momentum of a blow is in
    proportion to it, and so is the deflection. Blows twice as strong on a law with twice the gap give the same FRFs.
    Only the weight on the joint then counts half as much, and through it the length comes in. Sizes belong to blows of
    the usual length until they are written into an entry. With ``fixed`` sizes (m,) the parameters hold none.

    Derivatives of the linear part are in closed form. Those of the law's torque with respect to what acts on the law
    itself are differences of stepped blows. With respect to all else the law is held (:mod:`twin.model.held_law`),
    with an error of a tenth. With ``closely`` these are stepped, too, in ``processes`` processes.
    ``rows``: residual and derivatives of the last linear evaluation, recording by recording; ``latest``: reactions
    where blows were stepped last, and beside it; ``models``: those observed last.
    """

    law: Law = field(kw_only=True)
    setbacks: int = ERRATIC
    site: str = ""
    blow: dict[str, Blow] = field(default_factory=dict)
    fixed: FloatArray | None = None
    rate_hz: float = RATE_HZ
    closely: bool = False
    processes: int = 1
    rows: list[tuple[FloatArray, FloatArray]] = field(default_factory=list, init=False)
    beside: tuple[FloatArray, list[ComplexArray]] | None = field(default=None, init=False)
    latest: tuple[FloatArray, list[ComplexArray], list[list[ComplexArray]]] | None = field(default=None, init=False)
    models: _Postures | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        own = 0
        if self.fixed is None:
            own = len(self.law.names) + self._struck
        self.base = self.parameters.select(range(len(self.parameters) - own))

    def _postures(self, z: FloatArray) -> _Postures:
        """The models at z; those of the last call where only the law's own numbers differ."""
        base = z[: len(self.base)]
        if self.models is None or not np.array_equal(self.models.z, base):
            self.models = _Postures(self.robot, self.base, self.site, base, self.sample.recordings)
        return self.models

    @property
    def _struck(self) -> bool:
        """Whether the length of the blows is among the parameters, as their last."""
        return self.fixed is None and self.parameters.names[-1].endswith(".pulse")

    def own(self, z: FloatArray) -> tuple[FloatArray, float]:
        """Sizes (m,) of the law, and the length of the blows over ``PULSE_S``."""
        values = self.parameters.values(z)[len(self.base) :] if self.fixed is None else self.fixed
        sizes, pulse_s = np.split(values, [len(self.law.names)])
        return sizes, float(pulse_s[0]) / PULSE_S if len(pulse_s) else 1.0

    def predicted(self, z: FloatArray) -> list[ComplexArray]:
        """FRFs (nf, nr, ne) per recording."""
        return self.predicted_at([z])[0]

    def __call__(self, z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        n = len(self.base)
        joints = self._postures(z)
        cost, gradient, information = 0.5 * float(z @ z), z.copy(), np.eye(len(z))
        self.rows.clear()
        for r, w, (R, dR) in zip(self.sample.recordings, self.weight, self._reactions(z, joints), strict=True):
            view = joints.of(r, True).view
            dH = np.zeros((len(z), *r.frf.shape), complex)
            dH[:n] = view.slopes(R, dR[:n])
            dH[n:] = -view.out[:, :, None] * dR[n:, :, None, :]
            own, pulled, factor = self.pull(r, view.reacting(R), w)
            cost += own
            J = (dH * factor).reshape(len(z), -1).view(float)
            e = np.ascontiguousarray(pulled).reshape(-1).view(float)
            gradient += J @ e
            information += J @ J.T
            if not self.logarithmic:
                self.rows.append((e, J))
        return cost, gradient, information

    def _reactions(self, z: FloatArray, joints: _Postures) -> list[tuple[ComplexArray, ComplexArray]]:
        """Reactions (nf, ne) per recording and their derivatives (n, nf, ne), by differences of stepped blows.

        Blows a little longer, and somewhat longer, show whether a decay is smooth. In one that is not, the smallest
        difference changes its end. What acts on the law itself then takes a wide step; for all else the law is held.
        """
        n, recordings, near = len(self.base), self.sample.recordings, self._near
        every = range(len(recordings))
        at, found = self._looked(z, slopes=True)
        small, longer_ones = self._slopes(found[: len(near)], at, self._step, every), found[len(near) :]
        slopes: list[ComplexArray] = []
        for r, R, stepped in zip(recordings, at, small, strict=True):
            view = joints.of(r, True).view
            dR = np.zeros((len(z), *R.shape), complex)
            dR[:n] = view.reaction_slopes(_held(view, r.s, R)[0], R)
            dR[near] = np.where(np.isfinite(stepped), stepped, dR[near])
            slopes.append(dR)
        if not self.closely:
            return list(zip(at, slopes, strict=True))
        smooth = [_smooth(*there) for there in zip(*longer_ones, at, strict=True)]
        rough = [k for k in every if not smooth[k].all()]
        if rough:
            wide = self._react_each(self._moved(z, WIDE, near, joints, rough))
            for k, further in zip(rough, self._slopes(wide, at, WIDE, rough), strict=True):
                slopes[k][near] = np.where(~smooth[k] & np.isfinite(further), further, slopes[k][near])
        if self.beside is None or np.linalg.norm(z - self.beside[0]) > STAYED:
            self.beside = z, self._beside_held(z, joints, near, at, slopes, smooth)
        for dR, lag in zip(slopes, self.beside[1], strict=True):
            dR[:n] += lag
        return list(zip(at, slopes, strict=True))

    @property
    def _near(self) -> list[int]:
        """The parameters that act on the law itself."""
        beside = [k for k, p in enumerate(self.base) if p.site == self.site]
        return beside + list(range(len(self.base), len(self.parameters)))

    @property
    def _step(self) -> float:
        return FINE_DIFFERENCE if self.closely else ROUGH_DIFFERENCE

    def _looked(self, z: FloatArray, slopes: bool) -> tuple[list[ComplexArray], list[list[ComplexArray]]]:
        """Reactions per recording at z, and what derivatives are taken from: a step along each parameter near the law,
        then, ``closely``, of blows a little and somewhat longer. Without ``slopes`` these are stepped where they fit
        beside the others: stepping more blows at a time takes hardly longer, and a descent asks for them next."""
        if self.latest is None or not np.array_equal(self.latest[0], z):
            self.latest = z.copy(), [], []
        _, at, found = self.latest
        recordings, near = self.sample.recordings, self._near
        more = len(near) + 2 * self.closely
        fit = (1 + more) * sum(r.frf.shape[2] for r in recordings) <= COLUMNS
        asked: list[list[Asked]] = []
        joints, (sizes, longer) = self._postures(z), self.own(z)
        here = [(joints.of(r), r, sizes, longer) for r in recordings]
        if len(found) < more and (slopes or fit):
            asked = self._moved(z, self._step, near, joints, range(len(recordings)))
            lengths = [longer * (1 + h) for h in (FINE_DIFFERENCE, WIDE) if self.closely]
            asked += [[(joint, r, sizes, length) for joint, r, *_ in here] for length in lengths]
        *beside, last = self._react_each([*asked, [] if at else here])
        self.latest = self.latest[0], at or last, found or beside
        return self.latest[1:]

    def _moved(
        self, z: FloatArray, step: float, near: Sequence[int], joints: _Postures, chosen: Sequence[int]
    ) -> list[list[Asked]]:
        """The chosen recordings asked for a step further along each of some parameters."""
        asked = []
        for k in near:
            moved = z + step * np.eye(len(z))[k]
            recordings, base = [self.sample.recordings[i] for i in chosen], moved[: len(self.base)]
            own = k >= len(self.base)
            there = joints if own else _Postures(self.robot, self.base, self.site, base, recordings)
            asked.append([(there.of(r), r, *self.own(moved)) for r in recordings])
        return asked

    @staticmethod
    def _slopes(
        moved: Sequence[Sequence[ComplexArray]], at: Sequence[ComplexArray], step: float, chosen: Sequence[int]
    ) -> list[ComplexArray]:
        """Differences (m, nf, ne) over a step along each of m parameters, for each of the chosen recordings."""
        return [
            np.array([(there[c] - at[i]) / step for there in moved]).reshape(-1, *at[i].shape)
            for c, i in enumerate(chosen)
        ]

    def _beside_held(
        self,
        z: FloatArray,
        joints: _Postures,
        near: Sequence[int],
        reactions: Sequence[ComplexArray],
        slopes: Sequence[ComplexArray],
        smooth: Sequence[NDArray[np.bool_]],
    ) -> list[ComplexArray]:
        """What derivatives of reactions with respect to all but what is ``near`` the law have beside those held."""
        lags = [np.zeros_like(dR[: len(self.base)]) for dR in slopes]
        asked, where = [], []
        for k, r in enumerate(self.sample.recordings):
            for p, (joint, other) in joints.moved(r, FINE_DIFFERENCE).items() if smooth[k].any() else ():
                blows = other & smooth[k]
                if p not in near and blows.any():
                    asked.append((joint.hit(blows), r, *self.own(z)))
                    where.append((k, p, blows))
        for (k, p, blows), moved in zip(where, self._react(asked) if asked else [], strict=True):
            beside = (moved - reactions[k]) / FINE_DIFFERENCE - slopes[k][p]
            lags[k][p] = np.where(blows & np.isfinite(beside), beside, 0)
        return lags

    def _react_each(self, asked: Sequence[Sequence[Asked]]) -> list[list[ComplexArray]]:
        """The same for several lists, stepped side by side."""
        found = iter(self._react([one for some in asked for one in some]))
        return [[next(found) for _ in some] for some in asked]

    def _react(self, asked: Sequence[Asked]) -> list[ComplexArray]:
        """What the law does, T/F (nf, ne), in a model of each recording, of some sizes, to blows of some length."""
        rate_hz = self.rate_hz * self.law.finer
        processes = self.processes if len(asked) > WORTH_SPREADING * len(self.sample.recordings) else 1
        share = max(1, -(-len(asked) // processes))

        def some(number: int) -> list[ComplexArray]:
            here = asked[number * share : (number + 1) * share]
            if not here:
                return []
            strikes = [self._strike(*one) for one in here]
            with np.errstate(over="ignore", invalid="ignore"):  # a trial may diverge
                stepped = torques(strikes, self.law, self._length_s, rate_hz)
            return [
                self._reaction(joint, r, strike, g, rate_hz)
                for (joint, r, *_), strike, (g, _) in zip(here, strikes, stepped, strict=True)
            ]

        return [R for part in spread(some, processes, processes) for R in part]

    def bend(self, z: FloatArray, step: FloatArray) -> FloatArray | None:
        """Gᵀ ∂²e/∂step² (n,) of the linear residual e at z, where this was called last; ``None`` if it is not known."""
        if not self.rows:
            return None
        total = np.zeros(len(z))
        ahead = self.predicted(z + BEND_AHEAD * step)
        for r, H, w, (e, G) in zip(self.sample.recordings, ahead, self.weight, self.rows, strict=True):
            there = np.ascontiguousarray((r.frf - H) * w).reshape(-1).view(float)
            total += G @ (2 / BEND_AHEAD * ((there - e) / BEND_AHEAD - step @ G))
        return total if np.isfinite(total).all() else None

    def held(self, z: FloatArray) -> list[UnderLaw]:
        """The recordings with the law held as it is at z."""
        views, (reactions,) = self._stepped([z])
        return [
            UnderLaw.of(r, self.site, *_held(view, r.s, R))
            for r, view, R in zip(self.sample.recordings, views[0], reactions, strict=True)
        ]

    def cost(self, z: FloatArray) -> float:
        joints, (at, _) = self._postures(z), self._looked(z, slopes=False)
        predicted = [joints.of(r).view.reacting(R) for r, R in zip(self.sample.recordings, at, strict=True)]
        cost = 0.5 * float(z @ z) + self.loss(predicted)
        return cost if np.isfinite(cost) else np.inf

    def costs(self, points: Sequence[FloatArray]) -> list[float]:
        """Costs at several z, stepped side by side; infinite where a trial diverges."""
        found = []
        for z, predicted in zip(points, self.predicted_at(points), strict=True):
            cost = 0.5 * float(z @ z) + self.loss(predicted)
            found.append(cost if np.isfinite(cost) else np.inf)
        return found

    def deflection(self, z: FloatArray) -> float:
        """A large deflection of the joint under these blows, rad (m): exceeded by one in ten; NaN if they diverge."""
        postures = self._postures(z)
        none = np.full(len(self.law.names), 1e-9)
        strikes = [self._strike(postures.of(r), r, none) for r in self.sample.recordings]
        with np.errstate(over="ignore", invalid="ignore"):
            stepped = torques(strikes, self.law, 0.5, self.rate_hz * self.law.finer)
        return float(np.quantile(np.concatenate([largest for _, largest in stepped]), 0.9))

    def equivalents(self, z: FloatArray, sizes: Sequence[FloatArray]) -> list[list[FloatArray]]:
        """For each of several sizes, per recording: the stiffness and damping (2, ne) the law was to every blow."""
        postures = self._postures(z)
        joints = [(postures.of(r), r) for r in self.sample.recordings]
        found = iter(self._react([(joint, r, size, 1.0) for size in sizes for joint, r in joints]))
        return [[_equivalent(joint.view, r.s, next(found)) for joint, r in joints] for _ in sizes]

    @property
    def _length_s(self) -> float:
        return max(self.blow[r.group].length_s for r in self.sample.recordings)

    def _strike(self, joint: _Joint, r: Recorded, sizes: FloatArray, longer: float = 1.0) -> Strike:
        """Blows ``longer`` times as long as usual: their momentum scaled back, the weight counts less beside them."""
        blow = self.blow[r.group]
        load, peak, length = joint.load / longer, blow.peak_n / longer, blow.pulse_s * longer
        return Strike(joint.seen, joint.index, joint.k, load, peak, length, sizes)

    def _stepped(self, points: Sequence[FloatArray]) -> tuple[list[list[Receptances]], list[list[ComplexArray]]]:
        """Models and reactions, per recording, at several z, stepped side by side."""
        asked: list[list[Asked]] = []
        for z in points:
            postures = self._postures(z)
            asked.append([(postures.of(r), r, *self.own(z)) for r in self.sample.recordings])
        found = self._react_each(asked)
        return [[joint.view for joint, *_ in some] for some in asked], found

    def _reaction(self, joint: _Joint, r: Recorded, strike: Strike, g: FloatArray, rate_hz: float) -> ComplexArray:
        """The law's torque per force of the blow, T/F (nf, ne): of its tangent at rest, and the stepped g beside it."""
        if joint.blows is not None:  # as many columns as ever: a narrower product of arrays rounds otherwise
            stepped, g = g, np.zeros((len(g), len(joint.blows)))
            g[:, joint.blows] = stepped
        force = strike.peak_n * pulse_transform(r.s, strike.pulse_s)
        beside = transform(r.s, g, rate_hz) / force[:, None]
        return joint.view.reaction(np.full(beside.shape, strike.tangent(self.law), complex), beside)

    def predicted_at(self, points: Sequence[FloatArray]) -> list[list[ComplexArray]]:
        """The same at several z, stepped side by side."""
        return [
            [view.reacting(R) for view, R in zip(views, reactions, strict=True)]
            for views, reactions in zip(*self._stepped(points), strict=True)
        ]


def _smooth(little: ComplexArray, somewhat: ComplexArray, at: ComplexArray) -> NDArray[np.bool_]:
    """Blows (ne,) for which a small and a larger increase of the length tell about the same derivative.

    Also false where a step went over the edge of what can be stepped.
    """
    a, b = (little - at) / FINE_DIFFERENCE, (somewhat - at) / WIDE
    return np.asarray(np.sum(np.abs(a - b) ** 2, axis=0) < np.sum(np.abs(b) ** 2, axis=0))


def _equivalent(view: Receptances, s: ComplexArray, reaction: ComplexArray) -> FloatArray:
    """Stiffness and damping (2, ne) that come closest to a reaction: (k + s c) × rotation ≈ torque, over the lines."""
    rotation = view.into - view.own[:, None] * reaction
    columns = np.stack([rotation, s[:, None] * rotation])
    matrix = np.einsum("pfe,qfe->pqe", columns.conj(), columns).real
    right = np.einsum("pfe,fe->pe", columns.conj(), reaction).real
    return np.asarray(np.einsum("pqe,qe->pe", inverse2(matrix), right))


def _held(view: Receptances, s: ComplexArray, reaction: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """κ and the rest (nf, ne) that a reaction is, the robot seen like this."""
    k, c = _equivalent(view, s, reaction)
    kappa = np.asarray(k + s[:, None] * c)
    return kappa, np.asarray(reaction * (1 + kappa * view.own[:, None]) - kappa * view.into)
