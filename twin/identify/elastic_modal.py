"""Joint stiffness and damping from modal tables: maximum posterior, or the source paper's objective (Eq. 23).

Modes are paired by MAC where the table has shapes. Otherwise they are paired by frequency and by which deflections
dominate. Those are the ones that the measured modes are known to have. Where none is known, they are, from the second
round on, those of the model's mode that a measured mode was paired with. So a pair stays together when two frequencies
cross.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from twin.errors import InputError, tell
from twin.identify.descent import CRAWL, LACKING, Descended, minimise
from twin.identify.elastic import Fit, Start, agreement, drawn_starts
from twin.measure.campaign import Channels, ComplexArray, FloatArray
from twin.measure.modal_table import ModalTable
from twin.measure.shapes import mac
from twin.model.expansion import channels_of
from twin.model.parameters import Parameters, free_parameters
from twin.model.recorded import recorded_posture, without_limits
from twin.model.sensitivity import (
    Observed,
    Setup,
    Structure,
    contract,
    observe,
    observe_all,
    pole_slopes,
    poles,
    slopes,
)
from twin.robot.description import Robot

ModalObjective = Literal["posterior", "paper"]

FREQUENCY_SPREAD, DAMPING_SPREAD = 0.005, 0.10  # relative standard deviations where the table states none
PAPER_WEIGHTS = 100.0, 1.0  # W_f and W_ζ of Eq. 23
PAPER_SHARPNESS = 1e-2  # makes Eq. 23 outweigh the prior; of its many minima the one nearest the description is taken
UNPAIRED = np.log(2.0)  # frequencies farther apart than this factor are not paired
COOLING = (30.0, 10.0, 3.0)  # times these deviations: the first levels of a fit, on which few pairings are wrong
COOLED, SETTLED = 0.01, 1e-6  # in the cost: gains that are not waited for at a first level, and at the last
STEPS_OF_PAIRS = 3  # of a descent, before modes are paired again


@dataclass(frozen=True)
class ModalPosture:
    """Measured modes of one posture, nm of them.

    Attributes:
        setup: posture and the points of the shapes.
        frequency_hz, damping: (nm,); damping ratios, NaN where not stated.
        frequency_spread, damping_spread: (nm,) relative standard deviations.
        shape: (nm, points) complex, or ``None``.
        dominant: for every mode the sites known to hold most of its strain energy (``joint1.z``); may be empty.
    """

    setup: Setup
    frequency_hz: FloatArray
    damping: FloatArray
    frequency_spread: FloatArray
    damping_spread: FloatArray
    shape: ComplexArray | None
    dominant: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class PairedMode:
    """A measured mode and the model's, relative errors model over measured minus one; MAC where there are shapes."""

    posture: str
    measured_hz: float
    measured_damping: float
    frequency_hz: float | None
    damping: float | None
    mac: float | None
    dominant: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        said = "" if np.isnan(self.measured_damping) else f" {self.measured_damping:7.2%}"
        line = f"measured {self.measured_hz:7.2f} Hz{said}"
        if self.frequency_hz is None or self.damping is None:
            return f"{line}   no mode of the model"
        away = self.frequency_hz / self.measured_hz - 1
        line += f"   model {self.frequency_hz:7.2f} Hz {self.damping:7.2%}   {away:+7.1%}"
        return line if self.mac is None else f"{line}   MAC {self.mac:.0%}"


def modal_postures(table: ModalTable, robot: Robot, source: str = "table") -> dict[str, ModalPosture]:
    """The table as the fit uses it; shapes are where the table has its points, else at the robot's of the same labels.

    Labels that nobody places are not used, and told. So are all where a robot states no test points.

    Raises:
        InputError: a posture the robot does not have, or one without modes.
    """
    points = _placed(table, robot, source)
    found, known = {}, dict[tuple[str, ...], Channels]()
    for name, posture in table.postures.items():
        q = recorded_posture(robot, posture.q_deg, source, f"postures.{name}.q_deg")
        if not posture.modes:
            raise InputError(source, f"postures.{name}.modes", "expected at least one mode")
        modes = sorted(posture.modes, key=lambda mode: mode.frequency_hz)
        channels = points.only([k for k, x in enumerate(points.label) if all(x in mode.shape for mode in modes)])
        labels = channels.label
        channels = known.setdefault(channels.label, channels)  # postures that share them are assembled together
        f = np.array([mode.frequency_hz for mode in modes])
        zeta = np.array([np.nan if m.damping_percent is None else m.damping_percent / 100 for m in modes])
        f_std = np.array([np.nan if m.frequency_std_hz is None else m.frequency_std_hz for m in modes]) / f
        zeta_std = np.array([np.nan if m.damping_std_percent is None else m.damping_std_percent / 100 for m in modes])
        with np.errstate(divide="ignore", invalid="ignore"):
            zeta_spread = zeta_std / zeta
        found[name] = ModalPosture(
            Setup(name, q, None, channels, channels), f, zeta,
            np.where(np.isfinite(f_std), np.maximum(f_std, 1e-4), FREQUENCY_SPREAD),
            np.where(np.isfinite(zeta_spread), np.maximum(zeta_spread, 1e-3), DAMPING_SPREAD),
            np.array([[mode.shape[x] for x in labels] for mode in modes]) if len(labels) > 1 else None,
        )  # fmt: skip
    return found


def _placed(table: ModalTable, robot: Robot, source: str) -> Channels:
    """Where the shapes of a table are, as far as it or the robot says so."""
    bodies = {"base", *(f"link{i + 1}" for i in range(robot.axis_count))}
    if table.points is not None:
        points = table.points.only([k for k, body in enumerate(table.points.body) if body in bodies])
    else:
        points = channels_of(robot, [p.label for p in robot.test_points] if robot.states_points else [])
    labels = {label for posture in table.postures.values() for mode in posture.modes for label in mode.shape}
    if lost := sorted(labels - set(points.label)):
        where = "points" if table.points is not None else "robot"
        text = f"nothing says where on {robot.name} {', '.join(lost)} are; shapes are not used there"
        tell(source, where, text)
    return points


def fit_modes(
    robot: Robot,
    postures: Sequence[ModalPosture],
    parameters: Parameters | None = None,
    *,
    objective: ModalObjective = "posterior",
    starts: int = 4,
    seed: int = 0,
    guess: FloatArray | None = None,
    hopeless: float = np.inf,
) -> Fit:
    """Fit a robot to measured modes.

    A mode that no mode of the model is paired with costs as much as one that is a factor of two off. So dropping a mode
    is no way to agree.

    From the description the posterior is fitted in levels: with deviations of at least ``COOLING`` times the usual
    ones, then with its own. Few modes are then paired where they happen to be. The other starts, and the cost of Eq.
    23, are fitted as they are: other minima are to be found, too.

    Args:
        robot: the described robot, whose values are the prior means.
        postures: from :func:`modal_postures`.
        parameters: what is free; by default springs, dampers and links (no angles and gains).
        objective: ``posterior`` weighs by the modes' spread; ``paper`` is Eq. 23 with its weights, W_f 100 and W_ζ 1.
        starts: the first from the description, the others with springs and dampers drawn from the prior.
        guess: prior coordinates (n,) of the first start in place of the description's; from there no level is taken.
        seed: of the starts.
        hopeless: a descent that cannot be expected to get below this cost is given up (:func:`minimise`).
    """
    robot = without_limits(robot)
    if parameters is None:
        parameters = free_parameters(robot).only("spring", "entry", "link")
    ends = []
    for number, z in enumerate(drawn_starts(parameters, starts, seed)):
        levels = COOLING if not number and guess is None and objective == "posterior" else ()
        if guess is not None and not number:
            z = guess.copy()
        for warm in (_warmed(postures, times) for times in levels):
            if warm is not None:
                z = _descend(robot, warm, parameters, objective, z, tolerance=COOLED)[0]
        ends.append(_descend(robot, postures, parameters, objective, z, hopeless))
    ends.sort(key=lambda end: end[1])
    z, cost, information, converged = ends[0]
    data = _data(postures)
    values = parameters.values(z)
    reached = tuple(Start(end[1], end[0], end[2]) for end in ends)
    agreeing, rival = agreement(reached)
    return Fit(
        parameters, z, values, parameters.apply(robot, values), cost, (2 * cost - float(z @ z)) / max(data, 1),
        information - np.eye(len(z)), reached, agreeing, data, converged, True, rival,
    )  # fmt: skip


def _warmed(postures: Sequence[ModalPosture], times: float) -> list[ModalPosture] | None:
    """The postures with deviations of at least so many times the usual; ``None`` where they have such already."""
    least_f, least_zeta = times * FREQUENCY_SPREAD, times * DAMPING_SPREAD
    if all((p.frequency_spread >= least_f).all() for p in postures):
        return None
    return [
        replace(
            p,
            frequency_spread=np.maximum(p.frequency_spread, least_f),
            damping_spread=np.maximum(p.damping_spread, least_zeta),
        )
        for p in postures
    ]


def _descend(
    robot: Robot,
    postures: Sequence[ModalPosture],
    parameters: Parameters,
    objective: ModalObjective,
    z: FloatArray,
    hopeless: float = np.inf,
    tolerance: float = SETTLED,
) -> tuple[FloatArray, float, FloatArray, bool]:
    """Descent from z, modes paired again every few steps: where two of the model cross, another pairing goes on.

    A model that lacks something is given up where its descent crawls (see :func:`minimise`); not with Eq. 23, whose
    cost is no χ².
    """
    pairing: list[_Pairing] | None = None
    converged = stuck = False
    lacking = 0.5 * LACKING * _data(postures) if objective == "posterior" else np.inf
    best = z, np.inf, np.eye(len(z)), False
    ended: dict[bytes, float] = {}  # of pairs that were descended with: the last cost
    for _ in range(40):
        before, pairing = pairing, _pair(robot, postures, parameters, z, pairing)
        same = before and all(np.array_equal(a.model, b.model) for a, b in zip(before, pairing, strict=True))
        if stuck or (same and converged):
            break
        cost_of = _Modal(robot, postures, parameters, objective, pairing)
        z, cost, information, converged = minimise(
            cost_of, z, STEPS_OF_PAIRS, tolerance, hopeless, bound=parameters.bound, slack=0.0, reach=2.0
        )
        pairs = b"".join(p.model.tobytes() for p in pairing)
        least = ended.get(pairs, np.inf) - max(tolerance, STEPS_OF_PAIRS * CRAWL * (cost - lacking))
        stuck, ended[pairs] = bool(cost > least), cost  # no better with pairs that it had before: crawls or goes round
        for posture, paired in zip(postures, pairing, strict=True):
            cost += 0.5 * float(np.sum((UNPAIRED / posture.frequency_spread[paired.model < 0]) ** 2))
        if cost <= best[1]:
            best = z, cost, information, converged
        pairing = _signed(robot, postures, parameters, z, pairing)
    return best


@dataclass(frozen=True)
class _Pairing:
    """For every measured mode the index of the model's, −1 for none; strain shares (nm, nv) to follow them by."""

    model: np.ndarray
    share: FloatArray | None = None


def _pair(
    robot: Robot,
    postures: Sequence[ModalPosture],
    parameters: Parameters,
    z: FloatArray,
    before: list[_Pairing] | None,
) -> list[_Pairing]:
    values = parameters.values(z)
    changed = parameters.apply(robot, values)
    found = []
    observed = observe_all(changed, [p.setup for p in postures], parameters, values)
    for k, (posture, (seen, model)) in enumerate(zip(postures, observed, strict=True)):
        pole, shape = poles(seen)
        known = before[k] if before else None
        found.append(_assign(posture, np.abs(pole) / (2 * np.pi), shape, seen.J_r, model, known))
    return found


def _assign(
    posture: ModalPosture,
    frequency_hz: FloatArray,
    shape: ComplexArray,
    J: FloatArray,
    model: Structure,
    before: _Pairing | None,
) -> _Pairing:
    away = np.abs(np.log(frequency_hz[None, :] / posture.frequency_hz[:, None]))
    cost = away.copy()
    share = _shares(shape, model.strain)
    if posture.shape is not None:
        cost = 1 - mac(posture.shape, (J @ shape).T) + 0.1 * away
    elif any(posture.dominant):
        own = share / share.sum(axis=1, keepdims=True)
        for row, sites in enumerate(posture.dominant):
            named = [k for k, name in enumerate(model.coordinates) if name in sites]
            cost[row] += 1 - own[:, named].sum(axis=1) if sites else 0
    elif before is not None and before.share is not None:
        cost = away + 1 - before.share @ share.T
    cost = np.where(away > UNPAIRED, 1e3, cost)
    rows, columns = linear_sum_assignment(cost)
    paired = np.full(len(posture.frequency_hz), -1)
    for row, column in zip(rows, columns, strict=True):
        if cost[row, column] < 1e3:
            paired[row] = column
    return _Pairing(paired)


def _signed(
    robot: Robot, postures: Sequence[ModalPosture], parameters: Parameters, z: FloatArray, pairing: list[_Pairing]
) -> list[_Pairing]:
    """The pairing with the strain shares of its modes where the descent ended."""
    values = parameters.values(z)
    changed = parameters.apply(robot, values)
    found = []
    observed = observe_all(changed, [p.setup for p in postures], parameters, values)
    for pairs, (seen, model) in zip(pairing, observed, strict=True):
        share = _shares(poles(seen)[1], model.strain)
        there = (pairs.model >= 0) & (pairs.model < len(share))  # a mode may have been damped away on the way
        if len(share):
            share = np.where(there[:, None], share[np.where(there, pairs.model, 0)], 0)
        found.append(_Pairing(pairs.model, share if len(share) else np.zeros((len(there), len(model.strain)))))
    return found


def _shares(shape: ComplexArray, strain: FloatArray) -> FloatArray:
    """Strain energy shares (nm, nv), unit length."""
    energy = (strain[:, None] * np.abs(shape) ** 2).T
    return np.asarray(energy / np.linalg.norm(energy, axis=1, keepdims=True))


@dataclass(frozen=True)
class _Resonant:
    """A posture's modes (nm,) that are paired with measured ones.

    Attributes:
        seen, model: the posture's model; ``pole`` (nm,), rad/s, and ``shape`` (nv, nm) of the modes.
        residual: (2 nm,) of the sizes of the poles, then of damping ratios, in spreads.
        per_size, per_damping: (nm,) what it changes by with them.
    """

    seen: Observed
    model: Structure
    pole: ComplexArray
    shape: ComplexArray
    residual: FloatArray
    per_size: FloatArray
    per_damping: FloatArray


@dataclass
class _Modal(Descended):
    """The cost of a robot on modes that are paired with its own.

    Attributes:
        weighing: by the modes' spread (``posterior``) or as in the paper's Eq. 23 (``paper``).
    """

    robot: Robot
    postures: Sequence[ModalPosture]
    free: Parameters
    weighing: ModalObjective
    pairing: list[_Pairing]
    _last: tuple[bytes, Robot, list[_Resonant], float] | None = None

    @property
    def data(self) -> float:
        """Number of real data."""
        return _data(self.postures)

    def cost(self, z: FloatArray) -> float:
        """Prior included, without the slopes that a step which is not taken does not need."""
        return self._at(z)[3]

    def __call__(self, z: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Cost, gradient (n,) and Gauss–Newton matrix (n, n), prior included."""
        _, changed, resonant, cost = self._at(z)
        values = self.free.values(z)
        transform = self.free.transform(values)
        gradient, information = z.copy(), np.eye(len(z))
        for posture, one in zip(self.postures, resonant, strict=True):
            rate = contract(slopes(changed, posture.setup, self.free, values, one.seen, one.model), transform)
            dpole = pole_slopes(one.seen, rate, one.pole, one.shape)
            size, real = np.abs(one.pole), one.pole.real
            dsize = (one.pole.conj() * dpole).real / size
            dzeta = -dpole.real / size + real * dsize / size**2
            J = np.hstack([dsize * one.per_size, dzeta * one.per_damping])
            gradient += J @ one.residual
            information += J @ J.T
        return cost, gradient, information

    def _at(self, z: FloatArray) -> tuple[bytes, Robot, list[_Resonant], float]:
        """The robot, its modes that are paired, and the cost at z; where it was asked last, nothing is done again."""
        if self._last is None or self._last[0] != z.tobytes():
            values = self.free.values(z)
            changed = self.free.apply(self.robot, values)
            observed = observe_all(changed, [p.setup for p in self.postures], self.free, values)
            beside = zip(self.postures, self.pairing, observed, strict=True)
            found = [self._resonant(posture, pairs, *seen) for posture, pairs, seen in beside]
            cost = 0.5 * float(z @ z) + sum(0.5 * float(one.residual @ one.residual) for one in found)
            self._last = z.tobytes(), changed, found, cost
        return self._last

    def _resonant(self, posture: ModalPosture, pairs: _Pairing, seen: Observed, model: Structure) -> _Resonant:
        pole, shape = poles(seen)
        rows = np.flatnonzero((pairs.model >= 0) & (pairs.model < len(pole)))
        column = pairs.model[rows]
        size, real = np.abs(pole[column]), pole[column].real
        f_spread, zeta_spread = posture.frequency_spread[rows], posture.damping_spread[rows]
        if self.weighing == "paper":
            f_spread = np.full(len(rows), PAPER_SHARPNESS / np.sqrt(PAPER_WEIGHTS[0]))
            zeta_spread = np.full(len(rows), PAPER_SHARPNESS / np.sqrt(PAPER_WEIGHTS[1]))
        measured, zeta = 2 * np.pi * posture.frequency_hz[rows], posture.damping[rows]
        stated = np.isfinite(zeta) & (zeta > 0)
        per_size = 1 / (measured * f_spread)
        per_damping = np.where(stated, 1 / (np.where(stated, zeta, 1.0) * zeta_spread), 0)
        off = np.where(stated, -real / size - zeta, 0) * per_damping
        residual = np.concatenate([(size - measured) * per_size, off])
        return _Resonant(seen, model, pole[column], shape[:, column], residual, per_size, per_damping)


def _data(postures: Sequence[ModalPosture]) -> int:
    """Number of frequencies and damping ratios."""
    return sum(2 * len(p.frequency_hz) - int(np.isnan(p.damping).sum()) for p in postures)


def predict_modes(robot: Robot, postures: Mapping[str, ModalPosture], by_order: bool = False) -> list[PairedMode]:
    """The robot's modes beside measured ones.

    Args:
        robot: the description.
        postures: measured modes by posture.
        by_order: pair the lowest with the lowest, as the paper's tables do, instead of by MAC or nearest frequency.
    """
    robot = without_limits(robot)
    none = free_parameters(robot).select([])
    found = []
    for name, posture in postures.items():
        seen, model = observe(robot, posture.setup, none, np.zeros(0))
        pole, shape = poles(seen)
        frequency = np.abs(pole) / (2 * np.pi)
        pairs = _assign(posture, frequency, shape, seen.J_r, model, None).model
        if by_order:
            pairs = np.where(np.arange(len(pairs)) < len(pole), np.arange(len(pairs)), -1)
        likeness = None if posture.shape is None else mac(posture.shape, (seen.J_r @ shape).T)
        energy = model.strain[:, None] * np.abs(shape) ** 2
        energy = energy / energy.sum(axis=0)
        for k, column in enumerate(pairs):
            if column < 0:
                found.append(PairedMode(name, posture.frequency_hz[k], posture.damping[k], None, None, None, ()))
                continue
            order = [i for i in np.argsort(-energy[:, column]) if energy[i, column] >= 0.1]
            found.append(
                PairedMode(
                    name, float(posture.frequency_hz[k]), float(posture.damping[k]), float(frequency[column]),
                    float(-pole[column].real / np.abs(pole[column])),
                    None if likeness is None else float(likeness[k, column]),
                    tuple((model.coordinates[i], float(energy[i, column])) for i in order),
                )
            )  # fmt: skip
    return found


def frequency_error(modes: Sequence[PairedMode]) -> float:
    """RMS of relative frequency differences of paired modes; an unpaired one counts as 1."""
    return float(
        np.sqrt(np.mean([1.0 if m.frequency_hz is None else (m.frequency_hz / m.measured_hz - 1) ** 2 for m in modes]))
    )
