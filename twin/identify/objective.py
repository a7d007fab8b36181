"""Posterior cost of a robot's free numbers on measured FRFs, with its derivatives: what every fit to FRFs evaluates."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.identify.descent import Descended
from twin.identify.residual import loss, pull, weights
from twin.measure.campaign import ComplexArray, FloatArray
from twin.model.parameters import Parameters
from twin.model.rates import Changes, rates
from twin.model.recorded import Recorded
from twin.model.sensitivity import (
    Observed,
    Structure,
    contract,
    frf_pull,
    frf_slopes,
    moving,
    observe_all,
    sag_slopes,
    telling,
)
from twin.parallel import side_by_side
from twin.robot.description import Robot

ROWS = 1 << 30  # bytes of derivatives that are kept for the bend of a valley; of more it is not known
FACTORED = 1 << 14  # data that a thread factors at once: they stay in its cache
_Sloping = tuple[Recorded, FloatArray, Callable[[], tuple[ComplexArray, ComplexArray]], NDArray[np.intp]]
"""Of one recording: itself, its weight, what returns prediction and derivatives, and by which coordinates these are."""


@dataclass(frozen=True)
class Sample:
    """Recordings as a fit sees them: each line stands for ``repeat`` lines, less than one where lines share noise."""

    recordings: tuple[Recorded, ...]
    repeat: float = 1.0
    _weights: dict[tuple[float, bool], list[FloatArray]] = field(
        init=False, default_factory=dict, compare=False, repr=False
    )  # a copy with other recordings begins with none

    def weights(self, temper: float, logarithmic: bool) -> list[FloatArray]:
        """√repeat/σ per recording (nf, nr, ne), see :func:`twin.identify.residual.weights`; computed once."""
        if (temper, logarithmic) not in self._weights:
            some = (weights(r.frf, r.variance, temper, logarithmic) for r in self.recordings)
            self._weights[temper, logarithmic] = [np.sqrt(self.repeat) * w for w in some]
        return self._weights[temper, logarithmic]

    @property
    def band_hz(self) -> tuple[float, float]:
        """The lowest and the highest line."""
        return min(float(r.frequency[0]) for r in self.recordings), max(float(r.frequency[-1]) for r in self.recordings)

    def thin(self, lines: int) -> "Sample":
        """About so many lines of every recording, with the weight of all."""
        step = max(1, min(len(r.s) for r in self.recordings) // lines)
        return Sample(tuple(r.every(step) for r in self.recordings), self.repeat * step)

    def first(self, count: int) -> "Sample":
        """The first recordings."""
        return Sample(self.recordings[:count], self.repeat)


@dataclass
class Cost(Descended):
    """½ Σ |H − H(z)|²/(σ² + (temper |H|)²) + ½ zᵀz; with ``logarithmic`` the robust
    sum of :mod:`twin.identify.residual`.

    Attributes:
        robot: the description before values are applied.
        weight: 1/σ per recording (nf, nr, ne); zero where a line is not used.
        free: the parameters that z stands for.
    """

    robot: Robot
    parameters: Parameters
    sample: Sample
    temper: float = 0.0
    logarithmic: bool = False
    weight: list[FloatArray] = field(init=False)
    free: Parameters = field(init=False)

    def __post_init__(self) -> None:
        self.weight, self.free = self.sample.weights(self.temper, self.logarithmic), self.parameters

    @property
    def data(self) -> float:
        """Number of real data that the lines stand for."""
        return 2 * self.sample.repeat * sum(int(np.count_nonzero(w)) for w in self.weight)

    def loss(self, predicted: Sequence[ComplexArray]) -> float:
        """The cost of predictions, without the prior."""
        return sum(
            loss(r.frf, H, w, self.logarithmic, self.sample.repeat)
            for r, H, w in zip(self.sample.recordings, predicted, self.weight, strict=True)
        )

    def pull(
        self, r: Recorded, H: ComplexArray, w: FloatArray
    ) -> tuple[float, ComplexArray, ComplexArray | FloatArray]:
        """Of one recording: cost, residual as it pulls on the parameters, and its derivative ∂/∂H."""
        return pull(r.frf, H, w, self.logarithmic, self.sample.repeat)


@dataclass
class Objective(Cost):
    """The cost of a robot that is linear.

    Attributes:
        exact: derivatives include what sag adds, as of where the cost was evaluated first: to the optimum's last digit.
        sagging: whether springs give way under the weight, by 1e-3 rad; roughly right without, at half the work.
        lines: the Gauss–Newton matrix is of so many lines drawn from every recording, by what they say, with the weight
            of all. Cost and gradient are of all lines.
        held, among: with ``among``, z holds those coordinates alone and the others are as in ``held``.
        rows: residual, its derivatives and by what, where a linear one was evaluated last; recording by recording, none
            where that is more than ``ROWS``.
    """

    exact: bool = False
    sagging: bool = True
    lines: int | None = None
    held: FloatArray | None = None
    among: tuple[int, ...] | None = None
    rows: list[tuple[FloatArray, FloatArray, NDArray[np.intp]]] = field(default_factory=list)
    _slow: list[Observed] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.free = self.parameters if self.among is None else self.parameters.select(self.among)

    def within(self, z: FloatArray, among: Sequence[int]) -> "Objective":
        """The same with everything but some coordinates held at z; those must be independent of the others a priori.

        Central differences are then taken at the angles as recorded: that changes a slope by less than a thousandth.
        """
        return replace(self, held=z, among=tuple(among), rows=[], _slow=[])

    def whole(self, z: FloatArray) -> FloatArray:
        """Coordinates of all parameters."""
        if self.among is None:
            return z
        out = np.array(self.held)
        out[list(self.among)] = z
        return out

    def part(self, z: FloatArray) -> FloatArray:
        """What of all coordinates is free."""
        return z if self.among is None else z[list(self.among)]

    def predicted(self, z: FloatArray) -> list[ComplexArray]:
        """FRFs (nf, nr, ne) per recording."""
        models = self._along(z) if self._linear else self._observed(*self._described(z))
        return [r.respond(*one) for r, one in zip(self.sample.recordings, models, strict=True)]

    def _described(self, z: FloatArray) -> tuple[Robot, FloatArray]:
        """The robot at z, and all values (n,)."""
        values = self.parameters.values(self.whole(z))
        return self.parameters.apply(self.robot, values), values

    def _observed(self, robot: Robot, values: FloatArray) -> list[tuple[Observed, Structure]]:
        own = {r.setup.alike: r.setup for r in self.sample.recordings}
        models = observe_all(robot, list(own.values()), self.parameters, values, sagging=self.sagging)
        found = dict(zip(own, models, strict=True))
        return [found[r.setup.alike] for r in self.sample.recordings]

    def residual(self, z: FloatArray) -> FloatArray:
        """Weighted linear residual (2 Σ nf nr ne,), measured minus predicted."""
        parts = [
            np.asarray((r.frf - H) * w, complex)
            for r, H, w in zip(self.sample.recordings, self.predicted(z), self.weight, strict=True)
        ]
        return np.concatenate([part.reshape(-1).view(float) for part in parts])

    def jacobian(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted residual (data,) and derivatives (n, data) of the weighted prediction with respect to z."""

        ends = np.cumsum([0, *(2 * w.size for w in self.weight)])
        rest, rows = np.empty(ends[-1]), np.zeros((len(z), ends[-1]))

        def fill(part: tuple[int, _Sloping]) -> None:
            number, (r, w, slopes, moves) = part
            own = slice(ends[number], ends[number + 1])
            H, dH = slopes()
            dH *= w
            rest[own] = ((r.frf - H) * w).reshape(-1).view(float)
            rows[moves, own] = dH.reshape(len(moves), w.size).view(float)

        for _ in side_by_side(fill, enumerate(self._sloping(z))):
            pass
        return rest, rows

    def cost(self, z: FloatArray) -> float:
        """Prior included; infinite where a value is."""
        if not np.isfinite(self.parameters.values(self.whole(z))).all():
            return np.inf
        whole = self.whole(z)
        return 0.5 * float(whole @ whole) + self.loss(self.predicted(z))

    def __call__(self, z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient (n,) and Gauss–Newton matrix (n, n), prior included."""
        if self.lines:
            return self._drawn(z, self.lines)
        cost, gradient, information = 0.5 * float(self.whole(z) @ self.whole(z)), z.copy(), np.eye(len(z))
        self.rows.clear()
        held = 0
        for own, e, G, moves, square in side_by_side(self._felt, self._sloping(z)):
            cost += own
            gradient[moves] += G @ e
            information[np.ix_(moves, moves)] += square
            held += G.nbytes
            if held > ROWS:
                self.rows.clear()
            elif self.bends and not self.logarithmic:
                self.rows.append((e, G, moves))
        return cost, gradient, information

    def _felt(self, sloping: _Sloping) -> tuple[float, FloatArray, FloatArray, NDArray[np.intp], FloatArray]:
        """Of one recording: cost, residual e, its derivatives G, by what, and G Gᵀ."""
        r, w, slopes, moves = sloping
        H, dH = slopes()
        own, pulled, factor = self.pull(r, H, w)
        dH *= factor
        G = dH.reshape(len(moves), w.size).view(float)
        return own, np.ascontiguousarray(pulled).reshape(-1).view(float), G, moves, G @ G.T

    def _drawn(self, z: FloatArray, count: int) -> tuple[float, FloatArray, FloatArray]:
        """The same, the matrix of ``count`` draws from the lines of every recording."""
        cost, gradient, information = 0.5 * float(self.whole(z) @ self.whole(z)), z.copy(), np.eye(len(z))
        for r, w, (seen, model, rate, moves) in zip(self.sample.recordings, self.weight, self._rates(z), strict=True):
            own, pulled, factor = self.pull(r, r.respond(seen, model), w)
            cost += own
            gradient[moves] += frf_pull(seen, rate, r.s, r.power, pulled.conj() * factor)
            some, share = drawn(telling(seen, r.s, r.power, np.abs(factor)), count)
            _, dH = frf_slopes(seen, rate, r.s[some], r.power)
            G = np.multiply(dH, factor[some] * share[:, None, None], order="C").reshape(len(moves), -1).view(float)
            information[np.ix_(moves, moves)] += G @ G.T
        return cost, gradient, information

    def by_channel(self, z: FloatArray) -> Iterator[tuple[str, "Felt"]]:
        """What every channel of every recording says at z: channels are blows, or sensors where there are more."""
        for r, w, sloping, moves in self._sloping(z):
            side, labels = channels(r)
            H, dH = sloping()
            dH *= w
            for k, label in enumerate(labels):
                e = np.ascontiguousarray(((r.frf - H) * w).take(k, side)).reshape(-1).view(float)
                G = np.ascontiguousarray(dH.take(k, side + 1)).reshape(len(moves), -1).view(float)
                data = float(np.sum(np.abs((r.frf * w).take(k, side)) ** 2))
                yield label, Felt(moves, e, G, data)

    def bend(self, z: FloatArray, step: FloatArray) -> FloatArray | None:
        """Gᵀ ∂²e/∂step² (n,) of the linear residual e at z, where this was called last; ``None`` if it is not known."""
        if not self.rows:
            return None
        h, total = 0.1, np.zeros(len(z))
        ahead, behind = (self.predicted(self.free.moved(z, side * step)) for side in (h, -h))
        for r, *sides, w, (e, G, moves) in zip(
            self.sample.recordings, ahead, behind, self.weight, self.rows, strict=True
        ):
            # both sides: slopes leave the sag of springs out, which along a valley is most of what changes
            plus, minus = (np.ascontiguousarray((r.frf - H) * w).reshape(-1).view(float) for H in sides)
            total[moves] += G @ ((plus - 2 * e + minus) / h**2)
        return total

    def _sloping(self, z: FloatArray) -> Iterator[_Sloping]:
        """Every recording with its derivatives (m, …) by the m coordinates that move it, yet to be computed."""
        if self._linear:
            transform, every = self.free.transform(self.free.values(z)), np.arange(len(z))
            parts = zip(self.sample.recordings, self.weight, self._along(z), self._linear, strict=True)
            for r, w, one, (_, _, rate) in parts:
                yield r, w, partial(r.respond_slopes, *one, contract(rate, transform)), every
            return
        for r, w, (seen, model, felt, moves) in zip(self.sample.recordings, self.weight, self._rates(z), strict=True):
            yield r, w, partial(r.respond_slopes, seen, model, felt), moves

    def _rates(self, z: FloatArray) -> Iterator[tuple[Observed, Structure, Observed, NDArray[np.intp]]]:
        """Of every recording the model, its derivatives by the m coordinates that move it, and which those are."""
        robot, values = self._described(z)
        transform, own = self.parameters.transform(values), values
        if self.among is not None:
            transform, own = transform[np.ix_(self.among, self.among)], values[list(self.among)]
        changes, observed = Changes(), self._observed(robot, values)
        if self.exact and not self._slow:
            setups, models = [r.setup for r in self.sample.recordings], [model for _, model in observed]
            self._slow.extend(sag_slopes(robot, setups, self.free, own, models))
        known: dict[tuple[Any, ...], tuple[Observed, Structure, Observed, NDArray[np.intp]]] = {}
        for k, (r, (seen, model)) in enumerate(zip(self.sample.recordings, observed, strict=True)):
            if r.setup.alike in known:
                yield known[r.setup.alike]
                continue
            some = np.array(self.free.seen_in(r.setup.name))
            columns = np.flatnonzero(transform[some].any(axis=0))
            rate = rates(robot, r.setup, self.free, own, seen, model, changes, some)
            if self.exact:
                slow = self._slow[k].arrays()
                rate = Observed.of(a + b for a, b in zip(rate.arrays(), slow, strict=True))
            rate = contract(rate, transform[np.ix_(some, columns)])
            moves = moving(rate)
            felt = Observed.of(array[moves] for array in rate.arrays())
            known[r.setup.alike] = seen, model, felt, columns[moves]
            yield known[r.setup.alike]

    @cached_property
    def _linear(self) -> list[tuple[Observed, Structure, Observed]]:
        """Every recording at ``held`` with its derivatives by the free values, where those tell all; else nothing.

        They tell all of springs and dampers, which enter a model linearly, but for what their sag changes.
        """
        if self.held is None or self.sagging or any(p.kind != "spring" for p in self.free):
            return []
        robot, values = self._described(self.part(self.held))
        models = self._observed(robot, values)
        if any(model.curved for _, model in models):
            return []
        own, changes = values[list(self.among or ())], Changes()
        return [
            (seen, model, rates(robot, r.setup, self.free, own, seen, model, changes))
            for r, (seen, model) in zip(self.sample.recordings, models, strict=True)
        ]

    def _along(self, z: FloatArray) -> list[tuple[Observed, Structure]]:
        """The models at z, from those at ``held`` and their derivatives."""
        change = self.free.values(z) - self.free.values(self.part(np.asarray(self.held)))
        found = []
        for seen, model, rate in self._linear:
            pairs = zip(seen.arrays()[:5], rate.arrays()[:5], strict=True)  # M, C, K, loss, integral
            moved = [one + (change @ slope.reshape(len(slope), -1)).reshape(one.shape) for one, slope in pairs]
            found.append((Observed.of((*moved, *seen.arrays()[5:])), model))
        return found


@dataclass(frozen=True)
class Felt:
    """What one channel of a recording says of the parameters.

    Attributes:
        moves: (m,) the coordinates that move it.
        rest: (d,) weighted residual, measured minus predicted; ``slopes`` (m, d) of the prediction.
        data: sum of squares of the weighted data.
    """

    moves: NDArray[np.intp]
    rest: FloatArray
    slopes: FloatArray
    data: float


def channels(r: Recorded) -> tuple[int, tuple[str, ...]]:
    """Axis of the FRFs (nf, nr, ne) along which a test roves, and its labels: blows, or sensors if they are more."""
    roving_sensors = r.frf.shape[1] > r.frf.shape[2]
    return (1, r.setup.response.label) if roving_sensors else (2, r.setup.excitation.label)


def drawn(says: FloatArray, count: int) -> tuple[NDArray[np.intp], FloatArray]:
    """Lines drawn by what they say (nf,), at most ``count``, and the root of how many lines each stands for.

    Half of the draws are even over the lines: none then stands for many more than it may.
    """
    chance = says / says.sum() + 1 / len(says)
    ends = np.cumsum(chance) / chance.sum()
    some, times = np.unique(np.searchsorted(ends, (np.arange(count) + 0.5) / count), return_counts=True)
    return some, np.sqrt(times * chance.sum() / (count * chance[some]))


def factors(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Q (data + n, n) and R (n, n) of columns (n, data) of prior deviation one and that prior: [columnsᵀ; 1] = Q R.

    Cholesky's factors, twice, in a sixth of Householder's time. They are as orthogonal as long as no singular value is
    1e8 times the least, which is one (Yamamoto, Nakatsukasa, Yanagisawa and Fukaya, ETNA 44, 306, 2015).
    """
    rows, R = np.hstack([columns, np.eye(len(columns))]), np.eye(len(columns))  # Qᵀ, as it lies in memory
    parts = [rows[:, at : at + FACTORED] for at in range(0, rows.shape[1], FACTORED)]

    def turn(part: FloatArray) -> None:
        part[:] = inverse @ part

    try:
        for _ in range(2):
            upper = np.linalg.cholesky(sum(side_by_side(lambda part: part @ part.T, parts), np.zeros(R.shape))).T
            inverse = np.linalg.inv(upper).T
            for _ in side_by_side(turn, parts):
                pass
            R = upper @ R
    except np.linalg.LinAlgError:
        return np.linalg.qr(np.vstack([columns.T, np.eye(len(columns))]))
    return rows.T, R
