"""Posterior of a base model and of one more entry on the torque of a motion log, linear in all but the entry's shape.

The base model's numbers are masses, centres of mass, inertias, rotors, friction, compensator and offsets of the runs.
They enter as z with a standard normal prior about the description: y = A z + e. Torque noise is coloured. So rows are
whitened, joint by joint, with an autoregression of the residual that the richest model leaves. That model has the base,
every suspect and a free function of each joint's state. What such a rich fit has taken out of the noise is put back
line by line (leverage). An entry's own numbers are found by Gauss–Newton with z eliminated (variable projection; Golub,
Pereyra, SIAM J. Numer. Anal. 10, 1973).
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import scipy.fft
import scipy.linalg
from scipy.optimize import nnls
from scipy.signal import lfilter

from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import NONE, Fitted
from twin.diagnose.torque_design import Block, Design
from twin.diagnose.torque_laws import (
    USUAL_SHARE,
    State,
    Suspect,
    canonical,
    delayed,
    entry_torque,
    model_torque,
    on_dense,
    presliding_columns,
    smooth_columns,
    with_values,
)
from twin.diagnose.torque_numbers import corrected, number_columns, numbers_of
from twin.diagnose.torque_signal import Prepared, Run
from twin.identify.rigid import MOST_TAKEN, nearest_possible
from twin.measure.campaign import FloatArray
from twin.measure.signals import lowpass
from twin.model.parameters import Parameter, Parameters, independent, join, link_parameters
from twin.model.regressor import Column, Regressor, body_of, inertial_vector, pseudo_inertia
from twin.parallel import spread
from twin.physics import CATALOGUE, effect_named, effect_of
from twin.physics.effect import axis_of
from twin.robot.description import Entry, Robot
from twin.robot.frames import inertia_matrix, inertia_six

FARTHEST_SHAPE = 3.0  # prior deviations of a shape (a speed, an order, a travel)
NOISE_ORDER = 30  # of the autoregression, less where runs are short
RIPPLE_ORDERS = 14  # up to which any gear and motor adds waves of the joint's angle
MUCH_TAKEN = 0.2  # share of the rows of a log that the richest model fits by itself
ROUNDED = 8 / 4096 / 12**0.5  # of a torque's RMS: noise of a 12-bit converter whose range is four times that RMS
CONVERGED = 0.02  # of ½ χ²: less is no gain
DIFFERENCES = (1e-3, 0.02)  # of a prior deviation, for differences: as far as the rows tell a number, within
RINGING = 16  # rows that the low-pass rings before and after a step
INWARDS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # shares of the way to the described robot, whose links are bodies
PRESLIDING_TRAVELS = {"revolute": np.geomspace(3e-5, 1e-3, 7), "prismatic": np.geomspace(3e-6, 1e-4, 7)}
"""rad or m: over which dry friction ordinarily turns round when an axis does (presliding), a basis."""
PRESLIDING = 0.5  # share of dry friction that does, per travel, common to all joints
APART = 5e-4  # and of one joint alone, of the kind (hinge or slide) that most of them are; another kind has its own
ZERO = 0.005  # of its range: deviation of a current sensor's zero (0.2 to 1 % in data sheets of Hall sensors)
DRIFT = 0.01  # of a joint's RMS torque: deviation of that zero from run to run


@dataclass(frozen=True)
class Base:
    """The base model's columns and prior.

    Attributes:
        runs: fitted or held out; ``matrix`` (m, n, p) per run, torque per unit of the regressor's columns.
        known: (m, n) per run, torque of what has no column.
        described: (p,) values of the regressor's columns. After them come zeros, for the changes of numbers that the
            regressor takes as given. ``spread`` (p, z): their change per prior deviation.
        parameters: (z + ripple + offsets) free numbers, offsets of the runs last.
        ripple: (m, n, 2 RIPPLE_ORDERS) per run, sines and cosines of each joint's angle, of ordinary size.
        offset: (n, runs, runs) torque of every run per unit of the offsets of all, N·m (N), see :func:`_offsets`.
            ``friction`` (n,): a joint's dry friction as described, N·m (N).
        sliding: (n,) N·m (N), dry friction whose presliding is ordinary: alike at all joints it is a tolerance of
            sgn q̇, at one joint it is ``hysteresis``.
        presliding: (m, n, travels) per run, torque of a bristle that turns round less its sign, times ``sliding``;
            ``uneven`` the same of its size, per unit.
    """

    regressor: Regressor
    runs: list[Run]
    matrix: list[FloatArray]
    known: list[FloatArray]
    described: FloatArray
    spread: FloatArray
    parameters: Parameters
    offset: FloatArray
    friction: FloatArray
    ripple: list[FloatArray]
    sliding: FloatArray
    presliding: list[FloatArray]
    uneven: list[FloatArray]

    @property
    def rest(self) -> list[FloatArray]:
        """Recorded less described torque (m, n) of every run."""
        return [
            r.torque - known - m @ self.described
            for r, known, m in zip(self.runs, self.known, self.matrix, strict=True)
        ]

    @property
    def links(self) -> int:
        """Number of link parameters, which come first."""
        return sum(p.kind == "link" for p in self.parameters)

    def values(self, z: FloatArray) -> FloatArray:
        """Parameters (p,) of the regressor."""
        return np.asarray(self.described + self.spread @ z[: self.spread.shape[1]])

    def acting(self, joint: int) -> np.ndarray:
        """Which of the free numbers can act on a joint: those of the robot, then its own."""
        n, shared = self.regressor.robot.axis_count, self.spread.shape[1]
        orders, travels = self.ripple[0].shape[2], self.presliding[0].shape[2]
        first = shared + travels
        return np.concatenate(
            [
                np.arange(first),
                first + joint * orders + np.arange(orders),
                first + n * orders + joint * travels + np.arange(travels),
                first + n * (orders + travels) + np.arange(len(self.runs)) * n + joint,
            ]
        )

    @cached_property
    def apart(self) -> FloatArray:
        """Prior deviation (n,) of the share of a joint's dry friction that turns round otherwise than that of all."""
        return _apart(self.regressor.robot)

    @cached_property
    def even(self) -> FloatArray:
        """Described friction (n,), N·m (N), that has one sign in both directions: it is held at rest, too."""
        found = np.zeros(self.regressor.robot.axis_count)
        for entry in self.regressor.robot.physics:
            if even := CATALOGUE[entry.effect].uneven(entry.values):
                found[axis_of(entry.site)] += even
        return found

    def design(self, k: int, joint: int, state: State | None = None) -> FloatArray:
        """Torque (m, a) of a joint in run k per unit of the numbers that can act on it, as a recording has it."""
        presliding = self.presliding[k][:, joint] + self.even[joint] * self.uneven[k][:, joint]
        ripple = self.ripple[k][:, joint]
        offsets = np.broadcast_to(self.offset[joint, k], (len(presliding), len(self.runs)))
        rows = self.matrix[k][:, joint] @ self.spread
        if state is not None:
            gain = np.atleast_2d(state.gain)[:, joint, None]
            rows, ripple = gain * rows, gain * ripple
        robot = np.concatenate([rows, PRESLIDING * presliding, ripple, self.apart[joint] * presliding], axis=1)
        if state is not None and (state.delay or state.lag):
            robot = delayed(robot, self.runs[k], state.delay, state.lag)
        return np.concatenate([robot, offsets], axis=1)

    @property
    def lasting(self) -> int:
        """Numbers that belong to the robot: all but the offsets of the runs."""
        return len(self.parameters) - len(self.offset) * len(self.runs)

    def state(self, k: int, z: FloatArray) -> State:
        """What laws that act on other torques see of run k; of the base model alone."""
        run, values = self.runs[k], self.values(z)
        links = 10 * self.regressor.robot.axis_count
        torque = self.matrix[k] @ values + self.known[k]
        n, orders, travels = torque.shape[1], self.ripple[k].shape[2], self.presliding[k].shape[2]
        common, own, alone = np.split(z[self.spread.shape[1] :][: travels + n * (orders + travels)],
                                      [travels, travels + n * orders])  # fmt: skip
        torque += np.einsum("mjo,jo->mj", self.ripple[k], own.reshape(n, orders))
        shares = PRESLIDING * common + self.apart[:, None] * alone.reshape(n, travels)
        turning, uneven = (np.einsum("mjt,jt->mj", part[k], shares) for part in (self.presliding, self.uneven))
        torque += turning + self.even * uneven
        load = on_dense(run, run.bodies[:, :, :links] @ (values[:links] + self.regressor.weights))
        friction = np.zeros_like(load)
        roles = [effect_named(c.name.partition("@")[0]).role for c in self.regressor.columns]
        for column, axis, law in self.regressor.laws(run.dense):
            if roles[column] == "load":
                load[:, axis] += values[column] * law
            elif roles[column] == "friction":
                friction[:, axis] += values[column] * law
        return State(torque, load, friction, turning, self.sliding, self._excess(values), uneven, np.ones(n))

    def _excess(self, values: FloatArray) -> FloatArray:
        """Dry friction (n,) of the regressor's values (p,) less ``sliding``; none where the description has none."""
        dry = np.full(len(self.sliding), np.nan)
        for column, value in zip(self.regressor.columns, values, strict=False):
            name, _, place = column.name.partition("@")
            if column.group == "entry" and effect_named(name).part == "dry":
                dry[axis_of(place.partition(".")[0])] = value
        return np.where(np.isnan(dry) | (self.sliding == 0), 0.0, dry - self.sliding)


def base_of(
    regressor: Regressor, runs: Sequence[Run], sliding: FloatArray | None = None,
    changes: Sequence[FloatArray] | None = None,
) -> Base:  # fmt: skip
    """Columns of the base model on runs, and the prior its description states.

    Args:
        regressor: of the description.
        runs: with their rows.
        sliding: (n,) see :class:`Base`; as described by default.
        changes: of each run, :func:`number_columns`; computed by default.
    """
    robot = regressor.robot
    scale = np.sqrt(np.mean(np.concatenate([r.torque[r.valid] for r in runs]) ** 2, axis=0))
    offset = _offsets(robot, runs)
    matrices, known = _matrices(regressor, runs)
    links, covariance = link_parameters(robot)
    numbers = numbers_of(robot)
    others = [*_other_parameters(regressor, runs, matrices, scale), *numbers]
    for k, change in enumerate(changes or [number_columns(regressor, run, numbers) for run in runs]):
        matrices[k] = np.concatenate([matrices[k], change], axis=2)
    inertial = _link_spread(robot, links) @ np.linalg.cholesky(covariance)
    spread = scipy.linalg.block_diag(inertial, np.diag([p.deviation for p in others]))
    described = np.zeros(robot.axis_count)
    for entry in robot.physics:
        if CATALOGUE[entry.effect].part == "dry":
            described[axis_of(entry.site)] += dry_level(entry)
    if sliding is None:
        sliding = described * (np.count_nonzero(described) > 1)
    sizes = _wave_sizes(robot, scale)
    ripple, none = [], []
    for run in runs:
        none.append(np.zeros((*run.torque.shape, len(PRESLIDING_TRAVELS["revolute"]))))
        angle = run.smooth.position[:, :, None] * np.arange(1, RIPPLE_ORDERS + 1)
        ripple.append(run.filtered(np.concatenate([np.sin(angle), np.cos(angle)], axis=2)) * np.tile(sizes, 2))
    own = [*others, *_ordinary(runs, sizes, offset, _apart(robot))]
    parameters = join(_linear(links, covariance), independent(own))
    base = Base(
        regressor, list(runs), matrices, known, np.pad(regressor.described, (0, len(numbers))), spread, parameters,
        offset, np.maximum(USUAL_SHARE * scale, described), ripple, np.zeros(robot.axis_count), none, none,
    )  # fmt: skip
    return _sliding(base, sliding)


def _offsets(robot: Robot, runs: Sequence[Run]) -> FloatArray:
    """Prior of the zeros of the joints' current sensors, as factors (n, runs, runs) of its covariance, N·m (N).

    A sensor has one zero, known to ``ZERO`` of its range. Every run adds ``DRIFT`` of the joint's RMS torque. So a
    constant of all runs does not pass for friction that depends on the direction.
    """
    torque = np.concatenate([r.torque[r.valid] for r in runs])
    limits = [axis.limits.torque if axis.limits else None for axis in robot.axes]
    reached = np.abs(torque).max(axis=0)
    common = ZERO * np.array([limit or most for limit, most in zip(limits, reached, strict=True)])
    own = DRIFT * np.sqrt(np.mean(torque**2, axis=0))
    least = np.maximum(own, 1e-12)  # of an axis without torque
    covariance = common[:, None, None] ** 2 + least[:, None, None] ** 2 * np.eye(len(runs))
    return np.asarray(np.linalg.cholesky(covariance))


def _matrices(regressor: Regressor, runs: Sequence[Run]) -> tuple[list[FloatArray], list[FloatArray]]:
    """Columns (m, n, p) of every run, and the torque (m, n) of what has none."""
    matrices, known, n = [], [], regressor.robot.axis_count
    for run in runs:
        matrix = np.zeros((*run.torque.shape, len(regressor.columns)))
        matrix[:, :, : 11 * n] = run.bodies
        for column, axis, law in regressor.laws(run.dense):
            matrix[:, axis, column] += run.filtered(law)
        matrices.append(matrix)
        complete = regressor.complete
        known.append(np.zeros_like(run.torque) if complete else run.filtered(regressor.known_torque(run.dense)))
    return matrices, known


def _other_parameters(
    regressor: Regressor, runs: Sequence[Run], matrices: Sequence[FloatArray], scale: FloatArray
) -> list[Parameter]:
    """Rotors and entries, with the prior that the description states; of zeros what a joint's torque allows."""
    found, n = [], regressor.robot.axis_count
    for k, other in enumerate(regressor.columns[10 * n :], 10 * n):
        rms = np.sqrt(
            np.mean(np.concatenate([m[r.valid][:, :, k] for m, r in zip(matrices, runs, strict=True)]) ** 2, axis=0)
        )
        share = 1.0 if other.group == "rotor" else 0.1  # of a joint's torque, that an entry described as zero may be
        unknown = share * float(np.max(scale / np.maximum(rms, 1e-300), where=rms > 0, initial=0.0))
        deviation = _deviation(regressor.robot, regressor.columns, k) or unknown or 1.0
        found.append(Parameter(other.name, other.unit, "entry", False, other.value, deviation, "description"))
    return found


def _apart(robot: Robot) -> FloatArray:
    """See :attr:`Base.apart`."""
    types = [axis.type for axis in robot.axes]
    usual = max(dict.fromkeys(types), key=types.count)
    return np.array([APART if one == usual else PRESLIDING for one in types])


def _ordinary(runs: Sequence[Run], waves: FloatArray, offset: FloatArray, apart: FloatArray) -> list[Parameter]:
    """What every drive and recording has: presliding alike at all joints, waves, presliding of one joint, offsets."""
    joints = range(1, len(offset) + 1)
    slides = [
        Parameter(f"ordinary_presliding{where}.travel{k + 1}", "1", "gain", False, 0.0, width)
        for where, width in (("", PRESLIDING), *((f"@joint{j}", float(apart[j - 1])) for j in joints))
        for k in range(len(PRESLIDING_TRAVELS["revolute"]))
    ]
    ripple = [
        Parameter(f"ordinary_ripple@joint{j}.{name}{k + 1}", "N·m", "gain", False, 0.0, float(waves[j - 1, k]))
        for j in joints
        for name in ("sin", "cos")
        for k in range(waves.shape[1])
    ]
    offsets = [
        Parameter(
            f"torque_offset@joint{j}.{run.name}", "N·m", "gain", False, 0.0, float(np.linalg.norm(offset[j - 1, k]))
        )
        for k, run in enumerate(runs)
        for j in joints
    ]
    common = len(PRESLIDING_TRAVELS["revolute"])
    return [*slides[:common], *ripple, *slides[common:], *offsets]


def dry_level(entry: Entry) -> float:
    """Of an entry that is dry friction, N·m (N)."""
    return float(entry.values[CATALOGUE[entry.effect].parameters[0].name])


def _sliding(base: Base, sliding: FloatArray) -> Base:
    """The same with another dry friction (n,) of which presliding is ordinary."""
    axes = base.regressor.robot.axes
    presliding, uneven = [p.copy() for p in base.presliding], [u.copy() for u in base.uneven]
    for j, (before, now) in enumerate(zip(base.sliding, sliding, strict=True)):
        for k, run in enumerate(base.runs):
            if before > 0:
                presliding[k][:, j] *= now / before
                uneven[k][:, j] *= now > 0
            elif now > 0:
                turning, uneven[k][:, j] = presliding_columns(run, j, PRESLIDING_TRAVELS[axes[j].type])
                presliding[k][:, j] = now * turning
    return replace(base, sliding=sliding, presliding=presliding, uneven=uneven)


def _wave_sizes(robot: Robot, scale: FloatArray, ripple: float = 1e-3) -> FloatArray:
    """Prior deviation (n, RIPPLE_ORDERS) of sines and cosines of a joint's angle that any drive or series adds."""
    sizes = np.tile(ripple * scale[:, None] / np.sqrt(RIPPLE_ORDERS), RIPPLE_ORDERS)
    for entry in robot.physics:
        waves = CATALOGUE[entry.effect].departure(entry.values, RIPPLE_ORDERS)
        if np.any(waves):
            sizes[axis_of(entry.site)] += waves
    turning = np.array([axis.type == "revolute" for axis in robot.axes])
    return np.maximum(sizes * turning[:, None], 1e-12)


def _deviation(robot: Robot, columns: Sequence[Column], k: int) -> float:
    """Of a rotor or a number of an entry as described; of one that was assumed, as far as what it is from scatters."""
    column = columns[k]
    if column.group == "rotor":
        number = k - 10 * robot.axis_count
        described = effect_of("inertia").described_deviation(robot.drives[number].rotor_inertia, 0.0)
        drive = f"drives[{number}]"  # torque holds the inertia times the square of the ratio
        assumed = np.hypot(robot.scatter(f"{drive}.rotor_inertia"), 2 * robot.scatter(f"{drive}.gear_ratio"))
    else:
        key = column.name.rpartition(".")[0]
        largest = max(abs(c.value) for c in columns if c.name.startswith(key))
        described = CATALOGUE[column.name.partition("@")[0]].described_deviation(column.value, largest)
        assumed = robot.scatter(column.name)
    return max(described, float(np.expm1(assumed)) * abs(column.value))


def _link_spread(robot: Robot, items: Sequence[Parameter]) -> FloatArray:
    """∂ (ten parameters of every link) / ∂ x of the link parameters, (10 n, items)."""
    out = np.zeros((10 * robot.axis_count, len(items)))
    for k, parameter in enumerate(items):
        i = int(parameter.name.partition(".")[0][4:]) - 1
        sides = []
        for sign in (1, -1):
            mass, com, inertia = robot.links[i].inertial
            quantity = parameter.name.partition(".")[2]
            h = sign * 1e-4 * (1.0 if quantity == "mass" else max(parameter.deviation, 1e-9))
            if quantity == "mass":
                mass *= np.exp(h)
            elif quantity.startswith("com."):
                com["xyz".index(quantity[-1])] += h
            else:
                six = inertia_six(inertia)
                six[("xx", "yy", "zz", "xy", "xz", "yz").index(quantity.partition(".")[2])] += h
                inertia = inertia_matrix(six)
            sides.append(inertial_vector(mass, com, inertia))
        out[10 * i : 10 * i + 10, k] = (sides[0] - sides[1]) / (2 * abs(h))
    return out


def _linear(items: Sequence[Parameter], covariance: FloatArray) -> Parameters:
    """The same with masses themselves in the place of their logarithms: torque is linear in them, however far off."""
    width = np.array([p.mean if p.log else 1.0 for p in items])
    some = (replace(p, log=False, deviation=p.deviation * w) for p, w in zip(items, width, strict=True))
    return Parameters(tuple(some), covariance * np.outer(width, width))


@dataclass(frozen=True)
class Columns:
    """Whitened columns (N_active, k), zero on every joint that is not in ``joints``."""

    joints: tuple[int, ...]
    rows: FloatArray


@dataclass(frozen=True)
class Stop:
    """The moment at which an axis stops, starts or turns back, which encoder and sampling hide.

    Attributes:
        span: whitened rows of the joint; ``directions`` (rows, d) orthonormal, in which its friction is unknown.
        share: (d,) of each that is taken off: the prior on it is the joint's friction.
    """

    span: slice
    directions: FloatArray
    share: FloatArray


@dataclass
class System:
    """Whitened rows of a log and the base model on them; N rows, joint by joint, run by run.

    Attributes:
        whitening: (n, order + 1) prediction-error filter per joint over the noise's deviation.
        parameters: the base model's numbers; ``found`` entries that belong to it, beyond the description's.
        design: whitened torque per prior deviation of the description's numbers, as (N, z).
        A: the same and what was found, as the recording has it at the tolerances in force. ``data`` (N,): whitened
            torque less the description's. ``y`` (N,): the same less what A is not linear in.
        state: per run, what laws that act on other torques see.
        level: (n,) mean square of whitened noise: below one, for the low-pass leaves rows dependent.
        noise: (n,) RMS of the noise at the rows, N·m (N).
        widened: number in z → factor on the prior deviation its description gives it.
        slopes: of what was found, by name: numbers they depend on, and whitened slopes there.
        screened: whitened columns of the suspects' starts, which stay the same when something is found.
        recording: (1 + n,) delay in rows and gains through which slopes and starts were recorded, where there are any.
            ``through``: the design as such a recording has it.
        stops: per joint, what is left out of every judgement where the axis comes to rest or starts.
        turning: (n, n) speeds of the drives per speed of the axes, where drives were found to turn with other axes too.
        late: s by which the stops are late, where the torque was found to be recorded late.
    """

    base: Base
    whitening: FloatArray
    parameters: Parameters
    found: tuple[Suspect, ...] = ()
    A: Design = field(default_factory=lambda: Design(0, 0, (), np.zeros(0)))
    design: Design = field(default_factory=lambda: Design(0, 0, (), np.zeros(0)))
    data: FloatArray = field(default_factory=lambda: np.zeros(0))
    y: FloatArray = field(default_factory=lambda: np.zeros(0))
    state: list[State] = field(default_factory=list)
    level: FloatArray = field(default_factory=lambda: np.ones(0))
    noise: FloatArray = field(default_factory=lambda: np.ones(0))
    stops: list[list[Stop]] = field(default_factory=list)
    screened: dict[str, Columns] = field(default_factory=dict)
    widened: dict[int, float] = field(default_factory=dict)
    slopes: dict[str, tuple[FloatArray, Columns]] = field(default_factory=dict)
    recording: FloatArray = field(default_factory=lambda: np.zeros(0))
    through: tuple[FloatArray, Design] | None = None
    turning: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    late: float = 0.0

    @property
    def order(self) -> int:
        """Of the autoregression."""
        return self.whitening.shape[1] - 1

    @cached_property
    def masks(self) -> list[np.ndarray]:
        """Rows (m,) of each run whose whitened residual rests on valid rows only."""
        return [_whole(run.valid, self.order) for run in self.base.runs]

    @property
    def count(self) -> int:
        """Rows per joint."""
        return int(sum(mask.sum() for mask in self.masks))

    def rows(self, joint: int) -> slice:
        """Rows of a joint."""
        return slice(joint * self.count, (joint + 1) * self.count)

    def whiten(self, *columns: Sequence[FloatArray]) -> Columns:
        """Columns, each the torque (m, n) of every run, whitened; joint by joint, for most act on one."""
        acting = np.any([part.any(axis=0) for column in columns for part in column], axis=0)
        joints, runs = tuple(np.flatnonzero(acting).tolist()), range(len(self.base.runs))
        out = [self.whitened(j, [np.stack([c[k][:, j] for c in columns]).T for k in runs]) for j in joints]
        return Columns(joints, np.concatenate(out) if out else np.zeros((0, len(columns))))

    def whitened(self, joint: int, parts: Sequence[FloatArray]) -> FloatArray:
        """Torque (m,) or (m, k) of a joint in every run, whitened (count, k)."""
        filtered = [
            lfilter(self.whitening[joint], [1.0], part, axis=0)[mask]
            for part, mask in zip(parts, self.masks, strict=True)
        ]
        rows = np.concatenate(filtered)
        rows = rows.reshape(len(rows), -1)
        for stop in self.stops[joint] if self.stops else ():
            part = rows[stop.span]
            part -= stop.directions @ (stop.share[:, None] * (stop.directions.T @ part))
        return rows

    def full(self, columns: Columns) -> FloatArray:
        """Columns on all rows (N, k)."""
        out = np.zeros((len(self.whitening) * self.count, columns.rows.shape[1]))
        for part, j in enumerate(columns.joints):
            out[self.rows(j)] = columns.rows[part * self.count : (part + 1) * self.count]
        return out

    def on(self, rows: FloatArray, columns: Columns) -> FloatArray:
        """Those of N rows where columns act (N_active, …)."""
        joints = columns.joints
        if joints and joints[-1] - joints[0] == len(joints) - 1:
            return rows[joints[0] * self.count : (joints[-1] + 1) * self.count]
        return np.concatenate([rows[self.rows(j)] for j in joints]) if joints else rows[:0]

    def assemble(self) -> None:
        """Whiten design and data."""
        base = self.base
        self.stops, self.through = _stops(self), None
        self.A = self.design = self._designed([None] * len(base.runs))
        self.data = self.y = self.full(self.whiten(base.rest))[:, 0]

    def _designed(self, states: Sequence[State | None]) -> Design:
        """The base model's columns whitened, as the states' recordings have them."""
        base, axes = self.base, range(len(self.whitening))
        parts = ([base.design(k, j, state) for k, state in enumerate(states)] for j in axes)
        blocks = tuple(Block(j, base.acting(j), self.whitened(j, part)) for j, part in zip(axes, parts, strict=True))
        return Design(self.count, len(axes), blocks, np.ones(len(base.parameters)))

    def recorded(self, alike: float = 0.01) -> Design:
        """The base model's columns as the recording has them, at the tolerances in force.

        Through a recording whose gains, and delay in rows, are so much ``alike``, they are what they were.
        """
        now = recording_of(self)
        if not np.any(now[0]) and np.all(now[1:] == 1):
            return self.design.scaled(self.widened)
        if self.through is None or np.abs(self.through[0] - now).max() > alike:
            self.through = now, self._designed(self.state)
        return self.through[1].scaled(self.widened)

    @cached_property
    def information(self) -> FloatArray:
        """Gauss–Newton matrix (z, z), prior included."""
        return self.A.gram + np.eye(self.A.width)

    @cached_property
    def inverse(self) -> FloatArray:
        """Of the information."""
        return np.asarray(np.linalg.inv(self.information))

    @cached_property
    def z(self) -> FloatArray:
        """The base model's optimum."""
        return np.asarray(np.linalg.solve(self.information, self.A.transposed(self.y)))

    @cached_property
    def residual(self) -> FloatArray:
        """y − A z (N,)."""
        return self.y - self.A.times(self.z)

    def plain(self, z: FloatArray) -> FloatArray:
        """z in the deviations of the description."""
        out = z.copy()
        for k, factor in self.widened.items():
            out[k] *= factor
        return out

    def entries(self, z: FloatArray, without: Suspect | None = None) -> list[Entry]:
        """What was found so far, at z."""
        at, out = len(self.base.parameters), []
        for suspect in self.found:
            own = suspect.hypothesis.own
            if suspect is not without:
                out += with_values(suspect.hypothesis, own_values(own, z[at : at + len(own)]))
            at += len(own)
        return out

    def own(self, suspect: Suspect) -> list[int]:
        """Indices in z of the numbers of something found."""
        at = len(self.base.parameters)
        for found in self.found:
            if found.name == suspect.name:
                break
            at += len(found.hypothesis.own)
        return list(range(at, at + len(suspect.hypothesis.own)))

    def torque(self, entries: Sequence[Entry]) -> list[FloatArray]:
        """What entries add (m, n), run by run."""
        out = []
        for run, state in zip(self.base.runs, self.state, strict=True):
            parts = [entry_torque(run, state, e, e.values) for e in entries]
            out.append(parts[0] if len(parts) == 1 else sum(parts, np.zeros_like(run.torque)))
        return out

    def across(self, columns: Columns) -> FloatArray:
        """CᵀA (k, z)."""
        return self.A.across(columns.joints, columns.rows)

    def projected(self, columns: Columns) -> tuple[FloatArray, FloatArray]:
        """CᵀPC (k, k) and CᵀPy (k,), the base model's numbers eliminated."""
        across = self.across(columns)
        pull = columns.rows.T @ self.on(self.residual, columns)
        return columns.rows.T @ columns.rows - across @ self.inverse @ across.T, pull


def _stops(system: System, held: float = 0.1) -> list[list[Stop]]:
    """Where an axis stops, starts or turns back: directions of the whitened rows, with the prior of its friction.

    ``held`` is the share of dry friction that presliding holds through a standstill: doubt, how the axis crept to it.
    """
    out: list[list[Stop]] = []
    for j, whitening in enumerate(system.whitening):
        found: list[Stop] = []
        at = 0
        for run, mask in zip(system.base.runs, system.masks, strict=True):
            place = at + np.cumsum(mask) - 1
            events = stop_columns(run, j, held * bool(system.base.sliding[j]), system.late)
            if len(system.turning) and np.count_nonzero(system.turning[j]) > 1:  # where its drive turns back, too
                state = replace(run.dense, velocity=run.dense.velocity @ system.turning.T)
                drive = stop_columns(replace(run, dense=state), j, recorded_late=system.late)
                events = sorted([*events, *drive], key=_begins)
            for near, columns in events:
                inside = mask[near]
                if not inside.any():
                    continue
                W = lfilter(whitening, [1.0], system.base.friction[j] * columns, axis=0)[inside]
                first = int(place[near][np.argmax(inside)])
                start, end = first, first + len(W)
                near_by: list[Stop] = [earlier for earlier in found[-6:] if earlier.span.stop > start]
                start = max(first - 2 * RINGING - len(W), min([start, *(earlier.span.start for earlier in near_by)]))
                wide = np.zeros((end - start, W.shape[1]))
                wide[first - start :] = W
                for earlier in near_by:  # what they take off this one too
                    skip = max(0, start - earlier.span.start)
                    part = wide[earlier.span.start + skip - start : earlier.span.stop - start]
                    U = earlier.directions[skip : skip + len(part)]
                    part -= U @ (earlier.share[:, None] * (U.T @ part))
                U, size, _ = np.linalg.svd(wide, full_matrices=False)
                keep = size > 1e-3
                found.append(Stop(slice(start, end), U[:, keep], 1 - 1 / np.sqrt(1 + size[keep] ** 2)))
            at += int(mask.sum())
        out.append(found)
    return out


def stop_columns(
    run: Run, joint: int, held: float = 0.0, recorded_late: float = 0.0, creep_s: float = 0.16, inexact: float = 7e-4
) -> list[tuple[slice, FloatArray]]:
    """Moments at which friction is in doubt, in order: rows, and low-passed torque (rows, b) per unit of friction.

    At a stop or start: boxes of half a row or less, which together leave friction there undetermined. At a reversal:
    two boxes or more. The sign changes between two samples of the log, so the time of the step is uncertain by 1/√12 of
    their distance. An error of the speed adds to this at a slow reversal. Both move the middle of the step, too. An
    axis that nearly stops and goes on may have turned back: while its speed is below that error, within ``creep_s`` of
    the minimum. ``held`` is the share of friction that may be held through a standstill. It adds one box for the time
    between stop and start. ``recorded_late`` (s) shifts all boxes, because the torque is recorded that late.

    Near a stop the encoder hardly counts for ``creep_s``, or for the time that :func:`_creeping` gives, and the axis
    may creep. At a reversal, encoder and low-pass leave a speed error of ``inexact`` times the largest speed.
    """
    step = (len(run.dense.time) - 1) // (len(run.time) - 1)
    dense_hz = run.rate_hz * step
    count = len(run.time)
    stops = stops_of(run, joint)
    rests = dict(zip(stops[::2], stops[1::2], strict=True)) if held else {}
    speed, moving = run.dense.velocity[:, joint], np.ones(len(run.dense.time), bool)
    events = []
    for first, last in zip(stops[::2], stops[1::2], strict=True):
        crept = [max(creep_s, _creeping(outside) / dense_hz) for outside in (speed[:first][::-1], speed[last:])]
        events += [(float(first), crept[0], 1.0), (float(last), crept[1], 1.0)]
        before_it, after_it = (max(1, int(np.ceil(late * run.rate_hz))) * step for late in crept)
        moving[max(0, first - before_it) : last + after_it + 1] = False
    error = inexact * float(np.abs(speed).max())
    for at, late in _turns(speed, error):
        if moving[round(at)]:
            late = np.hypot(1 / (np.sqrt(12) * run.sample_hz), min(late / dense_hz, creep_s))
            events.append((at, float(late), float(np.sqrt(2))))  # both boxes: twice friction for so long
    found = []
    shift = recorded_late * dense_hz
    for at, late, size in sorted(events):
        lasting = rests.get(round(at), round(at)) - round(at) if size == 1 else 0
        at += shift
        end = round(at) + lasting
        reach = max(1, int(np.ceil(max(late, creep_s) * run.rate_hz)))
        first, last = round(at) // step - reach - RINGING, end // step + reach + RINGING + NOISE_ORDER
        near = slice(max(0, first), min(count - 1, last))
        if near.start >= near.stop:
            continue
        here, wide = at - near.start * step, max(1, int(np.ceil(2 * late * run.rate_hz)))
        ends = here + np.arange(-wide, wide + 1) * late * dense_hz / wide
        samples = np.arange((near.stop - near.start) * step + 1)[:, None]
        boxes = size * np.diff(_before(ends - samples), axis=1)
        if end > round(at):
            boxes = np.column_stack([boxes, held * ((samples >= here) & (samples < end - near.start * step))])
        columns = lowpass(boxes, dense_hz, *run.bands.fit)[::step]
        found.append((slice(near.start, near.stop + 1), columns))
    return found


def _creeping(outside: FloatArray, most: float = 8.0) -> int:
    """Samples for which an axis moves on after its speed is too low to be told from rest.

    Where the jerk, too, ends at zero, the speed falls with the cube of the time left. So it is ``most`` times as high
    twice as long before the axis rests.

    Args:
        outside: speeds from the edge of the standstill outwards, rad/s (m/s).
    """
    fast = np.flatnonzero(np.abs(outside) > most * np.abs(outside[:1]))
    return int(fast[0]) if fast.size else 0


def _before(x: FloatArray) -> FloatArray:
    """Share of a unit impulse that lies before x samples of its middle, spread as a line between samples spreads it.

    What lies between two ends so keeps its area and its middle, however short it is.
    """
    x = np.clip(x, -1, 1)
    return np.asarray(0.5 + x - 0.5 * x * np.abs(x))


def _turns(speed: FloatArray, error: float) -> Iterator[tuple[float, float]]:
    """Where an axis turns back, or may have, and how long its speed is within an error of zero there, in samples."""
    k = np.flatnonzero(np.sign(speed[1:]) * np.sign(speed[:-1]) < 0)
    rise = np.abs(speed[k + 1] - speed[k])
    late = error / rise
    edges = np.diff(np.concatenate([[0], np.abs(speed) < error, [0]]).astype(int))
    for first, last in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        within = (k + 1 >= first) & (k < last)
        late[within] = np.maximum(late[within], 0.5 * (last - first))
        if not within.any():
            yield float(first + np.argmin(np.abs(speed[first:last]))), 0.5 * float(last - first)
    yield from zip((k + np.abs(speed[k]) / rise).tolist(), late.tolist(), strict=True)


def _begins(event: tuple[slice, FloatArray]) -> int:
    return int(event[0].start)


def stops_of(run: Run, joint: int, shortest_s: float = 0.12) -> list[int]:
    """Dense samples at which a joint comes to rest or starts to move; a shorter standstill is a reversal."""
    speed = run.dense.velocity[:, joint]
    still = (run.dense.sign(speed) == 0).astype(int)
    edges = np.diff(np.concatenate([[0], still, [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    least = shortest_s * len(speed) / (run.dense.time[-1] - run.dense.time[0])
    found: list[int] = []
    for first, last in zip(starts, ends, strict=True):
        if last - first > least:
            found += [int(first), int(last)]
    return found


def refer(system: System, z: FloatArray, alike: float = 1e-3) -> list[FloatArray]:
    """Let laws that act on other torques see the model at z: what was found adds (m, n) to the recorded torque.

    Through a recording whose gains, and delay in rows, are so much ``alike``, columns are what they were.
    """
    added = _refer(system, z, system.entries(z))
    now = recording_of(system)
    if len(system.recording) and np.abs(now - system.recording).max() > alike:
        system.screened, system.slopes, system.recording = {}, {}, now
    elif not len(system.recording):
        system.recording = now
    return added


def recording_of(system: System) -> FloatArray:
    """(1 + n,) delay in rows, and gains, through which a system's torque is recorded."""
    state = system.state[0]
    rows = (state.delay + state.lag) * system.base.runs[0].rate_hz
    return np.array([rows, *np.atleast_2d(state.gain).mean(axis=0)])


def _refer(system: System, z: FloatArray, entries: Sequence[Entry]) -> list[FloatArray]:
    runs = system.base.runs
    system.state = [system.base.state(k, system.plain(z)) for k in range(len(runs))]
    return [model_torque(run, state, entries) for run, state in zip(runs, system.state, strict=True)]


def unshrunk(trial: "Trial") -> "Trial":
    """The trial with priors on its sizes as wide as these came out: what is not described may have any size.

    How probable it is was decided before; the usual size would only draw the numbers towards it.
    """
    hypothesis = trial.suspect.hypothesis
    scale = np.array([1.0 if p.log else max(1.0, abs(u)) for p, u in zip(hypothesis.own, trial.u, strict=True)])
    own = tuple(replace(p, deviation=p.deviation * s) for p, s in zip(hypothesis.own, scale, strict=True))
    slopes = replace(trial.slopes, rows=trial.slopes.rows * scale)
    suspect = replace(trial.suspect, hypothesis=replace(hypothesis, own=own))
    return replace(trial, suspect=suspect, u=trial.u / scale, slopes=slopes)


def extended(system: System, trial: "Trial") -> System:
    """The same rows with an entry in the base model: its numbers are nuisances from now on.

    It is linear as the trial has it until it is :func:`relinearised`.
    """
    return replace(
        system,
        found=(*system.found, trial.suspect),
        parameters=join(system.parameters, independent(trial.suspect.hypothesis.own)),
        A=system.A.beside((trial.slopes.joints, trial.slopes.rows)),
        y=system.y - system.full(trial.column)[:, 0] + system.full(trial.slopes) @ trial.u,
        slopes={**system.slopes, trial.suspect.name: (trial.u, trial.slopes)},
    )


def without(system: System, suspect: Suspect) -> System:
    """The same rows with something found left out, all else linear as it is until it is :func:`relinearised`."""
    at = system.own(suspect)
    column, slopes = _whitened(system, suspect, system.z[at])
    return replace(
        system,
        found=tuple(s for s in system.found if s.name != suspect.name),
        parameters=system.parameters.select(k for k in range(len(system.parameters)) if k not in at),
        A=system.A.without(at),
        y=system.y + system.full(column)[:, 0] - system.full(slopes) @ system.z[at],
        slopes={name: kept for name, kept in system.slopes.items() if name != suspect.name},
    )


def worth(system: System, suspect: Suspect) -> float:
    """Evidence lost when something found is left out and all else is refitted, at once: no less than that after."""
    return base_fit(system).evidence() - base_fit(without(system, suspect)).evidence()


def relinearised(system: System, iterations: int = 8, exact: float = 1e-5) -> System:
    """The same rows with all that was found linearised at its numbers as they are beside all else.

    Gauss–Newton on all numbers at once: each was linearised where it was found, before the others were. It ends where a
    step gains less than ``CONVERGED`` and ``exact`` times the cost.
    """
    z = _taken(system)
    here, cost = linearised(system, z)
    for _ in range(iterations):
        step = _bounded(system, here.z) - z
        for share in (1.0, 0.5, 0.2, 0.05):
            ahead, reached = linearised(system, z + share * step)
            if reached < cost:
                break
        gained = cost - reached
        if gained <= 0:
            break
        z, here, cost = z + share * step, ahead, reached
        if gained < CONVERGED + exact * cost:
            break
    return here


def _taken(system: System) -> FloatArray:
    """Where the slopes of what was found were taken (z,), all else as it is best there: the linear optimum may be far.

    Of a law that steps, or along a valley, the first step from there must be worth it as any other must.
    """
    z, fixed = system.z.copy(), np.zeros(len(system.z), bool)
    for suspect in system.found:
        at = system.own(suspect)
        u = system.slopes[suspect.name][0] if suspect.name in system.slopes else z[:0]
        if not suspect.effect.refers and len(u) == len(at):
            z[at], fixed[at] = u, True
    if fixed.any():
        pull = system.A.transposed(system.y) - system.information[:, fixed] @ z[fixed]
        z[~fixed] = np.linalg.solve(system.information[np.ix_(~fixed, ~fixed)], pull[~fixed])
    return z


def with_doubts(system: System, mistimed: float = 0.02) -> System:
    """The same with friction in doubt where and when what was found puts it, and refitted.

    A drive may turn with other axes, too. Its dry friction then steps where the drive turns back, not where its axis
    does. The encoder cannot time these steps; if they counted as exact, the ratio would seem known far too well. Torque
    that is recorded late steps late. A doubt in the wrong place leaves a part of a reversal, which looks like low-speed
    friction. A delay that changes by less than ``mistimed`` rows is left as it was.
    """
    turning, late = np.eye(len(system.whitening)), system.state[0].delay + system.state[0].lag
    for entry in system.entries(system.z):
        drive, axis, ratio = CATALOGUE[entry.effect].spins(entry.site, entry.values)
        turning[drive, axis] += ratio
    still = turning if np.any(turning != np.eye(len(turning))) else system.turning[:0]
    if np.array_equal(still, system.turning) and abs(late - system.late) * system.base.runs[0].rate_hz < mistimed:
        return system
    here = replace(system, turning=still, late=late)
    here.assemble()
    slopes = (system.slopes[suspect.name][1] for suspect in system.found)
    A = here.recorded().beside(*((columns.joints, columns.rows) for columns in slopes))
    return relinearised(replace(here, A=A, y=system.y + here.data - system.data, slopes={}, screened={}))


def linearised(
    system: System, z: FloatArray, doubt: FloatArray | None = None, near: float = 0.01
) -> tuple[System, float]:
    """The system with what was found linearised at z, and ½ χ² + ½ zᵀz there; ``doubt`` (z,) deviations, as it has z.

    They are those of the system's own fit by default. Slopes taken within ``near`` of their numbers are kept.
    """
    size = len(system.base.parameters)
    doubt = np.sqrt(np.diag(system.inverse)) if doubt is None else doubt
    plain = system.design.scaled(system.widened)
    here = replace(system, A=plain, slopes=dict(system.slopes))
    added = here.full(here.whiten(refer(here, z)))[:, 0]
    rest = here.data - added - plain.times(z[:size])
    here.A = here.recorded()
    system.through = here.through
    here.y = rest + here.A.times(z[:size])
    beside = []
    for suspect in here.found:
        at = here.own(suspect)
        now = z if suspect.effect.refers else z[at]  # it depends on all numbers, or on its own
        u, slopes = here.slopes.get(suspect.name, (now, None))
        if slopes is None or len(u) != len(now) or np.any(np.abs(now - u) > near * (1 + np.abs(u))):
            slopes = _slopes(here, suspect, z, doubt[at])
            here.slopes[suspect.name] = now, slopes
        for part, j in enumerate(slopes.joints):
            here.y[here.rows(j)] += slopes.rows[part * here.count : (part + 1) * here.count] @ z[at]
        beside.append((slopes.joints, slopes.rows))
    here = replace(here, A=here.A.beside(*beside))
    return here, 0.5 * float(rest @ rest) + 0.5 * float(z @ z)


def _slopes(system: System, suspect: Suspect, z: FloatArray, doubt: FloatArray) -> Columns:
    """Of something found, beside all else at z."""
    aside = system
    if suspect.effect.refers:
        aside = copy(system)
        _refer(aside, z, system.entries(z, without=suspect))
    return _whitened(aside, suspect, z[system.own(suspect)], doubt=doubt)[1]


def _bounded(system: System, z: FloatArray) -> FloatArray:
    """z with shapes where they are looked for."""
    out = z.copy()
    for suspect in system.found:
        at = system.own(suspect)
        log = np.array([p.log for p in suspect.hypothesis.own])
        out[at] = np.where(log, np.clip(z[at], -FARTHEST_SHAPE, FARTHEST_SHAPE), z[at])
    return out


def with_wider(system: System, hypothesis: Hypothesis) -> System:
    """The same rows with some numbers of the base model free beyond what the description allows."""
    names = system.parameters.names
    factors = {names.index(name): factor for name, factor in hypothesis.scale}
    widened = {k: system.widened.get(k, 1.0) * factor for k, factor in factors.items()}
    return replace(
        system,
        A=system.A.scaled(factors),
        parameters=hypothesis.parameters(system.parameters),
        widened={k: factor for k, factor in {**system.widened, **widened}.items() if abs(factor - 1) > 1e-9},
    )


def base_fit(system: System, hypothesis: Hypothesis = NONE) -> Fitted:
    """The base model at its optimum; with numbers freed by a hypothesis, on the system that has them wider."""
    return _fitted(system, hypothesis, system.parameters, system.z, system.residual, system.information)


def _fitted(
    system: System, hypothesis: Hypothesis, parameters: Parameters, z: FloatArray, residual: FloatArray,
    information: FloatArray,
) -> Fitted:  # fmt: skip
    chi2, data = float(residual @ residual), int(system.count * system.level.sum())
    values = np.array([p.value(x) for p, x in zip(parameters, parameters.root @ z, strict=True)])
    entries = with_values(hypothesis, values[len(values) - len(hypothesis.own) :]) if hypothesis.own else []
    return Fitted(
        hypothesis, parameters, z, values, partial(robot_of, system, z, entries), 0.5 * (chi2 + float(z @ z)),
        chi2 / max(data, 1), information, data, True,
    )  # fmt: skip


def robot_of(system: System, z: FloatArray, entries: Sequence[Entry] = ()) -> Robot:
    """The description at the nearest to z that can exist, with entries."""
    base, z = system.base, that_can_exist(system, z)
    values = base.values(system.plain(z))
    columns = base.regressor.columns
    values, changes = values[: len(columns)], values[len(columns) :]
    floor = [column.nonnegative and column.group != "link" for column in columns]
    fitted = base.regressor.robot_with(np.where(floor, np.maximum(values, 0.0), values))
    numbers = numbers_of(base.regressor.robot)
    told = {system.parameters.names[k] for k in system.widened}
    fitted = corrected(fitted, numbers, [p.mean + x for p, x in zip(numbers, changes, strict=True)], told)
    added = [_rounded(entry, fitted) for entry in (*system.entries(z), *entries)]
    return fitted.model_copy(update={"physics": [*fitted.physics, *added]})


def with_presliding(system: System, z: FloatArray, robot: Robot, slight: float = 1e-3) -> Robot:
    """The description at z with the fit's ordinary ``presliding``, which its Coulomb friction gives up.

    After a reversal a bristle of travel t has turned round by 1 − exp(−x/t). An element of yield torque Y and stiffness
    K has turned by min(K x/(2 Y), 1). Elements of all travels together turn as the fitted bristles do: a least-squares
    fit on a logarithmic grid, none below zero (Masing's rule; Iwan, J. Appl. Mech. 33, 1966). An element of less than a
    ``slight`` share of dry friction is left out.
    """
    base = system.base
    travels, first = base.presliding[0].shape[2], base.spread.shape[1]
    z = system.plain(z)
    alone = first + travels + base.regressor.robot.axis_count * base.ripple[0].shape[2]
    found = [entry for entry in system.entries(z) if entry.site.startswith("joint")]
    dry_name, slip_name = effect_of("dry").name, effect_of("slip").name
    physics = list(robot.physics)
    for j in np.flatnonzero(base.sliding).tolist():
        site = f"joint{j + 1}"
        dry = next((k for k, e in enumerate(physics) if (e.effect, e.site) == (dry_name, site)), None)
        if dry is None:
            continue
        own = z[alone + j * travels : alone + (j + 1) * travels]
        moved = np.concatenate([r.motion.velocity[:, j] for r in base.runs])
        here = [e for e in found if axis_of(e.site) == j]
        level = base.sliding[j] + sum(CATALOGUE[e.effect].turning(e.values, moved) for e in here)
        share = max(level, 0.0) * (PRESLIDING * z[first : first + travels] + base.apart[j] * own)
        ends, torque = _slip_elements(PRESLIDING_TRAVELS[base.regressor.robot.axes[j].type], share)
        coulomb = dry_level(physics[dry])
        turned = (CATALOGUE[e.effect].shared_dry(robot.values(e)) for e in physics)
        free = max(coulomb - sum(shared for drive, shared in turned if drive == site), 0.0)  # else it turns with two
        torque *= min(1.0, free / max(float(torque.sum()), 1e-300))
        some = torque > slight * coulomb
        if not some.any():
            continue
        level_name = CATALOGUE[dry_name].parameters[0].name
        left = {level_name: max(coulomb - float(torque[some].sum()), 0.0)}
        physics[dry] = Entry.model_validate({"effect": dry_name, "site": site, **left})
        slip = {"yield_torque": torque[some].tolist(), "stiffness": (2 * torque / ends)[some].tolist()}
        at = next((k for k, e in enumerate(physics) if (e.effect, e.site) == (slip_name, site)), len(physics))
        if at < len(physics):
            slip = {name: [*physics[at].values[name], *items] for name, items in slip.items()}
        physics[at : at + 1] = [Entry.model_validate({"effect": slip_name, "site": site, **slip})]
    return robot.model_copy(update={"physics": physics})


def _slip_elements(travels: FloatArray, share: FloatArray, count: int = 10) -> tuple[FloatArray, FloatArray]:
    """Travels of elements, rad (m), and their yield torques: together they turn round as bristles of ``share`` do."""
    x = np.geomspace(travels[0] / 10, 10 * travels[-1], 80)
    ends = np.geomspace(travels[0] / 3, 5 * travels[-1], count)
    torque, _ = nnls(np.minimum(x[:, None] / ends, 1), (1 - np.exp(-x[:, None] / travels)) @ share)
    return ends, torque


def that_can_exist(system: System, z: FloatArray) -> FloatArray:
    """The nearest to z (n,), as the fit measures it, whose links are bodies and whose friction is not below zero.

    What the data do not hold gives way; what was found stays as it is.
    """
    base, size, shared = system.base, len(system.base.parameters), system.base.spread.shape[1]
    regressor = base.regressor
    values = base.values(system.plain(z))[: len(regressor.columns)]
    links = values[: 10 * regressor.robot.axis_count].reshape(-1, 10)
    others = [v for v, column in zip(values, regressor.columns, strict=True) if column.nonnegative]
    if min(others, default=0.0) >= 0 and all(_possible(link) for link in links):
        return z
    step = base.spread[: len(values)] * system.plain(np.ones(len(z)))[:shared]
    A = system.information[:size, :size]
    follow = np.linalg.solve(A[shared:, shared:], A[shared:, :shared])
    H = A[:shared, :shared] - A[shared:, :shared].T @ follow  # of the links, all else where it fits best
    described = -z[:shared]
    try:
        d = nearest_possible(regressor, 0.5 * (H + H.T), np.zeros(shared), values, step)
    except ArithmeticError:
        d = described
    for share in (0.0, *INWARDS, 1.0):  # the solver's last digits may leave a link just outside
        inside = (1 - share) * d + share * described
        out = z.copy()
        out[:shared] += inside
        out[shared:size] -= follow @ inside
        links = base.values(system.plain(out))[: links.size].reshape(links.shape)
        if all(_possible(link) for link in links):
            break
    return out


def _possible(vector: FloatArray) -> bool:
    if vector[0] <= 0 or np.linalg.eigvalsh(pseudo_inertia(vector))[0] <= 0:
        return False
    principal = np.linalg.eigvalsh(body_of(vector)[2])
    return bool(principal[0] > 0 and principal[0] + principal[1] > principal[2] * (1 + 1e-9))


def _rounded(entry: Entry, robot: Robot) -> Entry:
    """An entry whose numbers are in the range that its effect allows.

    What slip that holds more at rest than friction is in motion takes back of dry friction is a law without a name.
    """
    values, effect = dict(entry.model_extra or {}), CATALOGUE[entry.effect]
    if effect.part == "dry" and (level := dry_level(entry)) < 0:
        law = {"formula": f"c1*sign(v{axis_of(entry.site) + 1})", "coefficients": [level]}
        return Entry.model_validate({"effect": effect_of("law").name, "site": entry.site, **law})
    for parameter in effect.parameters:
        if parameter.nonnegative and parameter.name in values and not parameter.word:
            given = values[parameter.name]
            values[parameter.name] = [max(x, 0.0) for x in given] if isinstance(given, list) else max(given, 0.0)
    return Entry(effect=entry.effect, site=entry.site, **effect.nearest(robot, entry.site, values))


# --- noise ------------------------------------------------------------------------------------------------------------


def system_of(prepared: Prepared, rich: Sequence[Suspect], runs: list[Run] | None = None, processes: int = 1) -> System:
    """The used runs of a log, whitened by the residual of the richest model there is."""
    base = base_of(prepared.regressor, prepared.used if runs is None else runs)
    for _ in range(2 * bool(base.sliding.any())):  # the second time beside its own presliding, if none was described
        base = _sliding(base, _dry_friction(base))
    n = prepared.regressor.robot.axis_count
    system = System(base, np.zeros((n, _order(base.runs) + 1)), base.parameters)
    refer(system, np.zeros(len(base.parameters)))
    for _ in range(2):  # the second time with friction, load and torque as fitted
        z = _plain_fit(system)
        refer(system, z)
    system.whitening, system.level, system.noise = _whitening(system, rich, processes)
    system.assemble()
    refer(system, system.z)
    return system


def _order(runs: Sequence[Run]) -> int:
    """Order of the autoregression that uninterrupted rows allow."""
    lengths: list[int] = []
    for run in runs:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], run.valid.astype(int), [0]])))
        lengths += (edges[1::2] - edges[::2]).tolist()
    return int(np.clip(np.median(lengths) / 6, 2, NOISE_ORDER)) if lengths else 2


def _plain_fit(system: System) -> FloatArray:
    """z by least squares with white noise at the level of the residual."""
    base = system.base
    y = np.concatenate([rest[r.valid] for rest, r in zip(base.rest, base.runs, strict=True)])
    noise = 0.05 * np.sqrt(np.mean(y**2, axis=0)) + 1e-9
    blocks = tuple(_rows(base, j)[np.concatenate([r.valid for r in base.runs])] for j in range(y.shape[1]))
    for _ in range(3):
        scaled = tuple(Block(j, base.acting(j), rows / noise[j]) for j, rows in enumerate(blocks))
        W = Design(len(y), len(scaled), scaled, np.ones(len(base.parameters)))
        z = np.asarray(np.linalg.solve(W.gram + np.eye(W.width), W.transposed((y / noise).T.ravel())), float)
        rest = y - noise * W.times(z).reshape(y.shape[1], -1).T
        noise = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), 1e-9 * np.abs(y).max(axis=0) + 1e-300)
    return z


def _rows(base: Base, joint: int) -> FloatArray:
    """Torque of a joint per unit of the numbers that can act on it, runs together."""
    return np.concatenate([base.design(k, joint) for k in range(len(base.runs))])


def _dry_friction(base: Base) -> FloatArray:
    """A joint's dry friction (n,), N·m (N), as least squares find it, also where none is described.

    At rest, of a parabola in speed: friction that rises and bends with speed else passes for some of it. What else the
    description lacks, a payload, is slow beside a step: rows are weighted by the spectrum of what a first fit leaves.
    """
    found = np.zeros_like(base.friction)
    order, valid = _order(base.runs), [r.valid for r in base.runs]
    dry = effect_of("dry")
    for j, scale in enumerate(base.friction):
        level = f"{dry.name}@joint{j + 1}.{dry.parameters[0].name}"
        described = [k for k, p in enumerate(base.parameters) if p.name == level]
        fastest = span_of(base.runs, j)[2]
        parts = []
        for k, (run, rest) in enumerate(zip(base.runs, base.rest, strict=True)):
            speed = run.dense.velocity[:, j]
            v = speed / fastest
            own = run.filtered(np.stack([run.dense.sign(speed), v, v * np.abs(v)], -1))
            parts.append(np.column_stack([scale * own, base.design(k, j), rest[:, j]]))
        rows = np.concatenate([part[use] for part, use in zip(parts, valid, strict=True)])
        x = _ridged(rows, 0.05**2 * np.mean(rows[:, -1] ** 2))
        left = [use * (part[:, -1] - part[:, :-1] @ x) for part, use in zip(parts, valid, strict=True)]
        none = [np.zeros((len(e), 1)) for e in left]
        whitening = prediction_filter(_correlation(left, none, valid, order))
        white = (
            lfilter(whitening, [1.0], part, axis=0)[_whole(use, order)] for part, use in zip(parts, valid, strict=True)
        )
        x = _ridged(np.concatenate(list(white)), 1.0)
        found[j] = scale * x[0] + sum(
            base.parameters[k].value(base.parameters[k].deviation * x[3 + k]) for k in described
        )
    return np.maximum(found, 0.0)


def _ridged(rows: FloatArray, ridge: float) -> FloatArray:
    """Least squares of the last column on the others, their numbers held to zero by a ridge."""
    columns = rows[:, :-1]
    return np.asarray(np.linalg.solve(columns.T @ columns + ridge * np.eye(columns.shape[1]), columns.T @ rows[:, -1]))


def _whole(valid: np.ndarray, order: int) -> np.ndarray:
    """Rows (m,) whose whitened residual rests on valid rows only."""
    bad = np.cumsum(np.concatenate([np.ones(order + 1, int), ~valid]))
    return valid & (bad[order + 1 :] - bad[: -order - 1] == 0)


def _whitening(
    system: System, rich: Sequence[Suspect], processes: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    base, n = system.base, len(system.whitening)
    extra: list[list[FloatArray]] = [[] for _ in range(n)]  # per joint, columns over all runs
    for suspect in rich:
        for column in _shapes(system, suspect):
            for j in range(n):
                if any(part[:, j].any() for part in column):
                    extra[j].append(np.concatenate([part[:, j] for part in column]))
    data = np.concatenate(base.rest)
    found = spread(lambda j: _noise(base, j, data[:, j], extra[j], system.order), n, processes)
    filters, level, noise = zip(*found, strict=True)
    return np.array(filters), np.array(level), np.array(noise)


def _noise(
    base: Base, j: int, data: FloatArray, extra: Sequence[FloatArray], order: int
) -> tuple[FloatArray, float, float]:
    """Prediction-error filter (order + 1,) of a joint's noise, its level when filtered so, and its RMS.

    Args:
        base, j: of a joint, ``data`` (m,) its recorded less described torque, runs together.
        extra: columns (m,) that a model may have beside those of the base.
        order: of the filter.
    """
    valid = np.concatenate([r.valid for r in base.runs])
    ends = np.cumsum([len(r.time) for r in base.runs])[:-1]
    free = np.concatenate([smooth_columns(r, j, *span_of(base.runs, j)) for r in base.runs])
    stops = []
    for k, run in enumerate(base.runs):
        doubts = [(near, boxes) for near, boxes in stop_columns(run, j) if boxes.shape[1] > 2]  # not a step's alone
        for near, boxes in doubts[:60]:  # enough of a long run
            stops.append(np.zeros((len(valid), boxes.shape[1])))
            stops[-1][(ends[k - 1] if k else 0) :][near] = boxes
    y = data * valid
    recorded = np.concatenate([r.torque for r in base.runs])[:, j]
    usual = USUAL_SHARE * np.sqrt(np.mean(data[valid] ** 2) + np.mean(recorded**2))
    B = np.column_stack([free, *extra, *stops]) * valid[:, None]
    scale, extras = np.sqrt(np.mean(B**2, axis=0)), B.shape[1]
    B = np.column_stack([_rows(base, j) * valid[:, None], usual * (B / np.where(scale > 0, scale, 1))])
    size, turn = np.linalg.eigh(B.T @ B)
    keep = size > 1e-9 * size[-1]
    Q = B @ (turn[:, keep] / np.sqrt(size[keep]))
    size, along = size[keep], Q.T @ y
    variance = 1e-2 * float(np.mean(y**2))
    least = _ridge(size, 0.4 * float(valid.sum()))  # what is left of a short log tells its noise
    for _ in range(6):  # of the noise, and how far the data hold each direction against its prior
        share = size / (size + max(variance, least))
        e = y - Q @ (share * along)
        variance = max(float(e @ e) / max(valid.sum() - float(share.sum()), 0.1 * valid.sum()), 1e-300)
    Q = Q * np.sqrt(1 - (1 - share) ** 2)
    correlation = _correlation(np.split(e, ends), np.split(Q, ends), np.split(valid, ends), order)
    rounded = ROUNDED**2 * float(np.mean(recorded[valid] ** 2))
    correlation[0] += rounded
    whitening = prediction_filter(correlation)
    white = np.concatenate([lfilter(whitening, [1.0], part)[order:] for part in np.split(e, ends)])
    taken = float(np.sum(Q**2)) / valid.sum()
    level = float(white @ white) / max(1 - taken, 0.1) / valid.sum() + rounded * float(whitening @ whitening)
    found = whitening, level, float(np.sqrt(correlation[0]))
    if taken < MUCH_TAKEN:
        return found
    other = _likeliest_noise(base, B[:, :-extras], B[:, -extras:], y, valid, order, rounded)  # either is too low
    return max(found, other, key=lambda noise: noise[2])


def _likeliest_noise(
    base: Base, B: FloatArray, C: FloatArray, y: FloatArray, valid: np.ndarray, order: int, rounded: float,
    most: int = 400,
) -> tuple[FloatArray, float, float]:  # fmt: skip
    """As :func:`_noise`, for a short log: the noise that makes the data likeliest, all columns under their prior.

    In a short log the columns of a rich model span everything slow. Their share does not tell how much noise they took.
    So the noise is white noise and an autoregression of first order, as the low-pass leaves them. Their sizes maximise
    the marginal likelihood (Patterson, Thompson, Biometrika 58, 1971). So does the size of what may be missing: all of
    it at its usual size, or one effect of it.

    Args:
        base: of the runs.
        B, C: (m, k) columns of the base and of what may be missing, per prior deviation. Like the data y (m,), they are
            zero where a row does not count.
        valid: (m,) rows that count; ``most`` of them are enough.
        order: of the filter.
        rounded: power of white noise that is there at least, (N·m)² or N².
    """
    rows = np.flatnonzero(valid)[:most]
    run = np.repeat(np.arange(len(base.runs)), [len(r.time) for r in base.runs])[rows]
    apart, together = np.abs(rows[:, None] - rows), run[:, None] == run
    y, own, more = y[rows], B[rows] @ B[rows].T, C[rows] @ C[rows].T
    best, found, power = -np.inf, np.zeros(1), np.geomspace(1e-8, 1.0, 90) * float(np.mean(y**2))
    models = [own + share * more for share in np.geomspace(1 / C.shape[1], 1.0, 4)]
    for correlation in _noises(base.runs[0], int(apart.max()) + 1):
        L = np.linalg.cholesky(together * correlation[apart] + 1e-4 * np.eye(len(rows)))
        inverse = scipy.linalg.solve_triangular(L, np.eye(len(rows)), lower=True)
        white, rest = inverse @ y, np.sum(np.log(np.diag(L)))
        for model in models:
            held, U = np.linalg.eigh(inverse @ model @ inverse.T)
            variance = np.maximum(held, 0.0) + power[:, None]
            likely = -0.5 * np.sum(np.log(variance) + (U.T @ white) ** 2 / variance, axis=1) - rest
            k = int(np.argmax(likely))
            if likely[k] > best:
                best, found = float(likely[k]), power[k] * correlation
    found = found + rounded * np.eye(1, len(found))[0]
    whitening = prediction_filter(found[: order + 1])
    level = float(whitening @ scipy.linalg.toeplitz(found[: order + 1]) @ whitening)
    return whitening, level, float(np.sqrt(found[0]))


def _noises(run: Run, lags: int) -> Iterator[FloatArray]:
    """Autocorrelations (lags,) at the rows of noise that is white and of such that fades, through the low-pass."""
    size = scipy.fft.next_fast_len(2 * lags, real=True)
    f = np.fft.rfftfreq(size, 1 / run.rate_hz)
    low, high = run.bands.fit
    gain = 0.5 * (1 + np.cos(np.pi * np.clip((f - low) / (high - low), 0, 1)))
    for fades_s in (0.05, 0.2, 0.8):
        fading = 1 / (1 + (2 * np.pi * f * fades_s) ** 2)
        fading *= np.sum(gain**2) / np.sum(gain**2 * fading)
        for share in (0.0, 0.3, 0.7, 0.95) if fades_s == 0.05 else (0.3, 0.7, 0.95):
            correlation = scipy.fft.irfft(gain**2 * (1 - share + share * fading), size)[:lags]
            yield correlation / correlation[0]


def _ridge(size: FloatArray, most: float) -> float:
    """The variance from which columns of such squared sizes take no more than ``most`` rows out of the noise."""
    if len(size) <= most:
        return 0.0
    low, high = np.log(size[size > 0].min()) - 10.0, np.log(size.max()) + 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sum(size / (size + np.exp(middle))) > most else (low, middle)
    return float(np.exp(high))


def _shapes(system: System, suspect: Suspect) -> list[list[FloatArray]]:
    """A few columns that span what a suspect could add, run by run (m, n); of starts of either sign one."""
    starts = suspect.starts
    if len(starts) > 40:
        return []
    size = np.abs(starts)
    few = [start for k, start in enumerate(starts) if not any(np.array_equal(size[k], x) for x in size[:k])]
    return [column for start in few for column in _start_columns(system, suspect, start)]


def _start_columns(system: System, suspect: Suspect, start: FloatArray) -> list[list[FloatArray]]:
    """The entry's torque (m, n) per run at a start, if any, and what a prior deviation of every size adds."""
    own = suspect.hypothesis.own
    here = [] if suspect.vanishes else [system.torque(with_values(suspect.hypothesis, start))]
    columns = list(here)
    for k in suspect.sizes:
        shifted = start.copy()
        shifted[k] += DIFFERENCES[1] * own[k].deviation
        moved = system.torque(with_values(suspect.hypothesis, shifted))
        for still in here:
            moved = [a - b for a, b in zip(moved, still, strict=True)]
        columns.append([part / DIFFERENCES[1] for part in moved])
    return columns


def span_of(runs: Sequence[Run], j: int) -> tuple[float, float, float]:
    q = np.concatenate([r.motion.position[:, j] for r in runs])
    v = np.concatenate([r.motion.velocity[:, j] for r in runs])
    half = max(0.5 * float(np.ptp(q)), 1e-9)
    return float(q.min()) + half, half, max(float(np.abs(v).max()), 1e-9)


def _correlation(residual: list[FloatArray], Q: list[FloatArray], valid: list[np.ndarray], order: int) -> FloatArray:
    """Autocovariance (order + 1,) of the noise under a residual; Q (m, k) is what a fit took out of it."""
    size = scipy.fft.next_fast_len(max(len(e) for e in residual) + 16 * order, real=True)
    power, taken, count = np.zeros(size // 2 + 1), np.zeros(size // 2 + 1), 0
    for e, q, use in zip(residual, Q, valid, strict=True):
        power += np.abs(scipy.fft.rfft(e, size)) ** 2
        taken += np.sum(np.abs(scipy.fft.rfft(q, size, axis=0)) ** 2, axis=1)
        count += int(use.sum())
    lags = 8 * order
    window = np.hanning(2 * lags + 1)[lags:]

    def smooth(density: FloatArray) -> FloatArray:
        correlation = scipy.fft.irfft(density, size)[: lags + 1] * window
        circle = np.zeros(size)
        circle[: lags + 1] = correlation
        circle[-lags:] = correlation[:0:-1]
        return np.maximum(scipy.fft.rfft(circle).real, 0.0)

    left = 1 - np.clip(smooth(taken) / max(count, 1), 0.0, MOST_TAKEN)
    correlation = scipy.fft.irfft(smooth(power) / left, size)[: order + 1] / max(count, 1)
    return correlation if correlation[0] > 0 else np.eye(1, order + 1)[0]


def prediction_filter(correlation: FloatArray, ridge: float = 1e-4) -> FloatArray:
    """Prediction-error filter (order + 1,) over the innovation's deviation (Levinson).

    White noise of ``ridge`` times the noise's power is added, so that stop bands are not amplified.
    """
    correlation = correlation.copy()
    correlation[0] *= 1 + ridge
    coefficients = scipy.linalg.solve_toeplitz(correlation[:-1], correlation[1:])
    innovation = correlation[0] - coefficients @ correlation[1:]
    return np.concatenate([[1.0], -coefficients]) / np.sqrt(max(innovation, 1e-12 * correlation[0]))


# --- entries ----------------------------------------------------------------------------------------------------------


def own_prior(own: Sequence[Parameter], values: FloatArray) -> FloatArray:
    """Own values in prior deviations (m,)."""
    return np.array(
        [
            (np.log(max(v, 1e-300) / p.mean) if p.log else v - p.mean) / p.deviation
            for p, v in zip(own, values, strict=True)
        ]
    )


def own_values(own: Sequence[Parameter], u: FloatArray) -> FloatArray:
    """Values (m,) of own parameters in prior deviations."""
    return np.array([p.value(p.deviation * x) for p, x in zip(own, u, strict=True)])


@dataclass(frozen=True)
class Trial:
    """A suspect somewhere: own numbers u in prior deviations, the fall of the cost, whitened torque and slopes."""

    suspect: Suspect
    u: FloatArray
    gain: float
    column: Columns
    slopes: Columns


def evaluate(
    system: System, suspect: Suspect, u: FloatArray, slopes: bool = True, doubt: FloatArray | None = None
) -> Trial:
    """The suspect's torque at own numbers u, the base model refitted beside it; ``doubt`` is their deviations."""
    column, along = _whitened(system, suspect, u, slopes, doubt)
    return Trial(suspect, u, _gain(system, column, u), column, along)


def _whitened(
    system: System, suspect: Suspect, u: FloatArray, slopes: bool = True, doubt: FloatArray | None = None
) -> tuple[Columns, Columns]:
    """The suspect's torque at own numbers u, and its slopes, over as much as the rows leave in doubt of each number.

    Over more a wave turns round, or a step passes another; over much less a law that steps is jagged.
    """
    own = suspect.hypothesis.own
    if slopes and doubt is None:
        doubt = _doubt(system, _whitened(system, suspect, u, doubt=np.full(len(u), DIFFERENCES[1]))[1])
    steps = np.clip(np.zeros(len(u)) if doubt is None else doubt, *DIFFERENCES)

    def torque(at: FloatArray) -> list[FloatArray]:
        return system.torque(with_values(suspect.hypothesis, own_values(own, at)))

    here = torque(u)
    parts = [here]
    for k in range(len(u) if slopes else 0):
        moved = u.copy()
        moved[k] += steps[k]
        parts.append([(a - b) / steps[k] for a, b in zip(torque(moved), here, strict=True)])
    together = system.whiten(*parts)
    return Columns(together.joints, together.rows[:, :1]), Columns(together.joints, together.rows[:, 1:])


def _doubt(system: System, slopes: Columns) -> FloatArray:
    """Deviations (m,) of numbers that have such slopes, in those of their priors."""
    information, _ = system.projected(slopes)
    held, vectors = np.linalg.eigh(information)  # of a record without noise rounding leaves some below zero
    return np.asarray(np.sqrt(vectors**2 @ (1 / (1 + np.maximum(held, 0)))))


def _gain(system: System, column: Columns, u: FloatArray) -> float:
    information, pull = system.projected(column)
    return float(pull[0] - 0.5 * information[0, 0] - 0.5 * u @ u)


def start(system: System, suspect: Suspect, largest_kept: int = 20_000_000) -> Trial:
    """The best of a suspect's starts, sizes solved for; without slopes, to be settled.

    Up to ``largest_kept`` numbers of its columns are kept from one search to the next.
    """
    own, sizes = suspect.hypothesis.own, list(suspect.sizes)
    first = int(not suspect.vanishes)
    width = first + len(sizes)
    whitened = system.screened.get(suspect.name)
    if whitened is None:
        columns = [column for values in suspect.starts for column in _start_columns(system, suspect, values)]
        whitened = system.whiten(*columns)
        if whitened.rows.size < largest_kept and not suspect.effect.refers:
            system.screened[suspect.name] = whitened
    across = system.across(whitened)
    pulls = whitened.rows.T @ system.on(system.residual, whitened)
    promised: list[tuple[float, int, FloatArray, FloatArray]] = []
    for number, values in enumerate(suspect.starts):
        part = slice(number * width, (number + 1) * width)
        C = whitened.rows[:, part]
        information = C.T @ C - across[part] @ system.inverse @ across[part].T
        u = own_prior(own, values)
        if sizes:
            pull = pulls[part][first:] - information[first:, :first].sum(axis=1) - u[sizes]
            before = u[sizes]
            u[sizes] += np.linalg.solve(information[first:, first:] + np.eye(len(sizes)), pull)
            u = _inside(suspect, u)
            weight = np.concatenate([np.ones(first), u[sizes] - before])
        else:  # its numbers in proportion
            weight = np.clip(pulls[part] / information[0], 0.01, 10.0)
            u = own_prior(own, weight[0] * values)
        gain = float(weight @ pulls[part] - 0.5 * weight @ information @ weight - 0.5 * u @ u)
        promised.append((gain, number, u, weight))
    promised.sort(key=lambda item: -item[0])
    if suspect.effect.linear:
        gain, number, u, weight = promised[0]
        rows = whitened.rows[:, number * width : (number + 1) * width] @ weight[:, None]
        return Trial(suspect, u, gain, Columns(whitened.joints, rows), Columns(whitened.joints, rows[:, :0]))
    found: list[Trial] = []
    for gain, _, u, _ in promised[:3]:
        found.append(evaluate(system, suspect, u, slopes=False))
        if found[-1].gain > 0.7 * gain:  # a law that is not linear keeps its promise only near where it started
            break
    return max(found, key=lambda trial: trial.gain)


def _inside(suspect: Suspect, u: FloatArray) -> FloatArray:
    """u with sizes that cannot be negative at zero or above, and shapes where they are looked for."""
    own = suspect.hypothesis.own
    bounded = zip(own, suspect.nonnegative, strict=True)
    least = [-FARTHEST_SHAPE if p.log else -p.mean / p.deviation if bound else -np.inf for p, bound in bounded]
    return np.clip(u, least, [FARTHEST_SHAPE if p.log else np.inf for p in own])


def reach(system: System, trial: Trial, iterations: int = 2, usual: float = 0.3) -> Trial:
    """A started trial after a few steps of all its own numbers: of a law that is not linear in them, its promise.

    A mass where the search starts says little of what it explains elsewhere on its link. From a size of nothing no
    other number can be told: a ``usual`` one, in prior deviations, is tried there.
    """
    suspect, u = trial.suspect, trial.u
    if not suspect.sizes or len(suspect.sizes) == len(u):
        return trial
    if not trial.column.rows.any():
        u = u.copy()
        u[list(suspect.sizes)] += usual
    reached = refine(system, evaluate(system, suspect, u), iterations)
    return max(trial, reached, key=lambda t: t.gain)


def settle(system: System, trial: Trial) -> Trial:
    """Refined; an entry that acts on other torques again, once these are what they are with it in the model."""
    trial = refine(system, evaluate(system, trial.suspect, trial.u))
    own = trial.suspect.hypothesis.own
    values = own_values(own, trial.u)
    if np.any((same := canonical(trial.suspect.hypothesis, values)) != values):
        trial = refine(system, evaluate(system, trial.suspect, own_prior(own, same)))
    for _ in range(2 if trial.suspect.effect.refers else 0):
        again = copy(system)
        refer(again, eliminated(system, trial))
        trial = refine(again, evaluate(again, trial.suspect, trial.u))
    return trial


def from_every_start(system: System, trial: Trial, few: int = 10) -> Trial:
    """The best of a settled trial and of its few starts, refined: where steps meet, a law has more than one optimum."""
    suspect = trial.suspect
    if len(suspect.starts) > few or suspect.effect.refers:
        return trial
    starts = [own_prior(suspect.hypothesis.own, values) for values in suspect.starts]
    return max([trial, *(refine(system, evaluate(system, suspect, u)) for u in starts)], key=lambda t: t.gain)


def profiled(system: System, suspect: Suspect, own: int, drop: float) -> tuple[float, float]:
    """Values of a number of something found at which all else fits worse by ``drop`` in ln likelihood and prior.

    Some rows tell little but the product of a ratio and a torque. They leave a bent valley, and steps make it rough.
    Slopes at its floor do not tell its length.
    """
    at, rest = system.own(suspect), without(system, suspect)
    best = evaluate(rest, suspect, system.z[at])
    covariance = np.linalg.inv(rest.projected(best.slopes)[0] + np.eye(len(at)))
    deviation = float(np.sqrt(covariance[own, own]))
    ends = []
    for side in (-1, 1):
        inside, here, fell = best.u[own], best, 0.0
        for far in (1.0, 1.6, 2.5, 4.0, 6.0, 9.0, 13.0):  # deviations
            there = best.u[own] + side * far * deviation
            u = here.u + covariance[own] / covariance[own, own] * (there - here.u[own])
            here = refine(rest, evaluate(rest, suspect, _inside(suspect, u)), 4, own)
            lost = best.gain - here.gain
            if lost > drop:
                inside += (there - inside) * (drop - fell) / (lost - fell)
                break
            inside, fell = there, lost
        ends.append(inside)
    low, high = (own_values(suspect.hypothesis.own, np.where(np.arange(len(at)) == own, x, 0.0))[own] for x in ends)
    return float(low), float(high)


def eliminated(system: System, trial: Trial) -> FloatArray:
    """The base model's numbers (z,) beside a trial."""
    return np.asarray(system.inverse @ system.A.transposed(system.y - system.full(trial.column)[:, 0]))


def refine(system: System, trial: Trial, iterations: int = 8, fixed: int | None = None) -> Trial:
    """Gauss–Newton on the own numbers (but one), the base model's eliminated, with Levenberg's damping."""
    damping, free = 1e-3, np.arange(len(trial.u)) != fixed
    for _ in range(iterations):
        information, pull = system.projected(trial.slopes)
        here = system.across(trial.column)
        pull = pull - trial.u - trial.slopes.rows.T @ trial.column.rows[:, 0]
        pull += (system.across(trial.slopes) @ system.inverse @ here.T)[:, 0]
        ahead = trial
        for _ in range(6):
            step = np.zeros(len(pull))
            step[free] = np.linalg.solve(
                (information + (1 + damping) * np.eye(len(pull)))[np.ix_(free, free)], pull[free]
            )
            step *= min(1.0, 1.5 / max(float(np.abs(step).max()), 1e-12)) if damping > 1e-2 else 1.0
            ahead = evaluate(system, trial.suspect, _inside(trial.suspect, trial.u + step), slopes=False)
            if ahead.gain > trial.gain:
                break
            damping = max(8 * damping, 1e-1)
        gained = ahead.gain - trial.gain
        if gained <= 0:
            return trial
        trial = evaluate(system, trial.suspect, ahead.u, doubt=_doubt(system, trial.slopes))
        damping = max(damping / 8, 1e-6)
        if gained < CONVERGED:
            return trial
    return trial


def fitted(system: System, trial: Trial) -> Fitted:
    """A refined suspect as a fit of all numbers."""
    own = trial.suspect.hypothesis.own
    parameters = join(system.parameters, independent(own))
    column = system.full(trial.column)[:, 0]
    z = eliminated(system, trial)
    residual = system.y - column - system.A.times(z)
    across = system.across(trial.slopes)
    within = trial.slopes.rows.T @ trial.slopes.rows + np.eye(len(own))
    information = np.block([[system.information, across.T], [across, within]])
    return _fitted(system, trial.suspect.hypothesis, parameters, np.concatenate([z, trial.u]), residual, information)
