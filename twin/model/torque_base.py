"""The base model of a motion log, linear in its numbers: y = A z + e.

The numbers are masses, centres of mass, inertias, rotors, friction, compensator and offsets of the runs. They enter as
z with a standard normal prior about the description.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from twin.measure.campaign import FloatArray
from twin.model.parameters import Parameter, Parameters, independent, join, link_parameters
from twin.model.regressor import Column, Regressor, inertial_vector
from twin.model.torque_laws import USUAL_SHARE, State, delayed, on_dense, presliding_columns
from twin.model.torque_numbers import number_columns, numbers_of
from twin.model.torque_signal import Run
from twin.physics import CATALOGUE, effect_named, effect_of
from twin.physics.effect import axis_of
from twin.robot.description import Entry, Robot
from twin.robot.frames import inertia_matrix, inertia_six

NOISE_ORDER = 30  # of the autoregression, less where runs are short
RIPPLE_ORDERS = 14  # up to which any gear and motor adds waves of the joint's angle
DIFFERENCES = (1e-3, 0.02)  # of a prior deviation, for differences: as far as the rows tell a number, within
PRESLIDING_TRAVELS = {"revolute": np.geomspace(3e-5, 5e-3, 9), "prismatic": np.geomspace(3e-6, 5e-4, 9)}
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
            ``uneven`` the same of its size, per unit. ``bristles``: by drive, see :func:`_presliding_felt`.
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
    bristles: list[dict[int, tuple[dict[int, FloatArray], FloatArray]]]

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
    def travels(self) -> FloatArray:
        """Travels (n, t), rad or m, over which a joint's dry friction may turn round."""
        return np.array([PRESLIDING_TRAVELS[axis.type] for axis in self.regressor.robot.axes])

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
        for part, laws in zip((load, friction), self._laws[k], strict=True):
            for column, axis, law in laws:
                part[:, axis] += values[column] * law
        return State(
            torque, load, friction, turning, self.sliding, self._excess(values), uneven,
            travels=self.travels, shares=shares, gain=np.ones(n),
        )  # fmt: skip

    @cached_property
    def _laws(self) -> list[tuple[list[tuple[int, int, FloatArray]], ...]]:
        """Of every run on the dense clock, laws of position that go through the gears, and of friction."""
        return [tuple(self.regressor.laws(run.dense, role) for role in ("load", "friction")) for run in self.runs]

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
    described = _described_dry(robot)
    if sliding is None:
        sliding = described * (np.count_nonzero(described) > 1)
    sizes = _wave_sizes(robot, scale)
    ripple = []
    for run in runs:
        angle = run.smooth.position[:, :, None] * np.arange(1, RIPPLE_ORDERS + 1)
        ripple.append(run.filtered(np.concatenate([np.sin(angle), np.cos(angle)], axis=2)) * np.tile(sizes, 2))
    own = [*others, *_ordinary(runs, sizes, offset, _apart(robot))]
    parameters = join(_linear(links, covariance), independent(own))
    base = Base(
        regressor, list(runs), matrices, known, np.pad(regressor.described, (0, len(numbers))), spread, parameters,
        offset, np.maximum(USUAL_SHARE * scale, described), ripple, sliding, [], [], [{} for _ in runs],
    )  # fmt: skip
    return with_sliding(base, sliding)


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


def with_whole_friction(robot: Robot) -> Robot:
    """The description with its ``presliding`` as a part of Coulomb friction again.

    Over which travel friction turns round, a fit to a log finds for itself. Elements of an earlier fit beside it would
    hold what that one had.
    """
    dry, slip = effect_of("dry"), effect_of("slip")
    held: dict[str, float] = {}
    for entry in robot.physics:
        if entry.effect == slip.name:
            held[entry.site] = held.get(entry.site, 0.0) + slip.part_of_dry(entry.values, np.zeros(1))
    if not held:
        return robot
    level, physics = dry.parameters[0].name, []
    for entry in robot.physics:
        if entry.effect == dry.name and entry.site in held:
            entry = Entry.model_validate({**entry.model_dump(), level: dry_level(entry) + held.pop(entry.site)})
        if entry.effect != slip.name:
            physics.append(entry)
    physics += [Entry.model_validate({"effect": dry.name, "site": s, level: torque}) for s, torque in held.items()]
    return robot.model_copy(update={"physics": physics})


def dry_level(entry: Entry) -> float:
    """Of an entry that is dry friction, N·m (N)."""
    return float(entry.values[CATALOGUE[entry.effect].parameters[0].name])


def with_sliding(base: Base, sliding: FloatArray) -> Base:
    """The same with another dry friction (n,) of which presliding is ordinary."""
    shared = _shared_friction(base.regressor.robot)
    presliding, uneven = [], []
    for run, bristles in zip(base.runs, base.bristles, strict=True):
        turning, even = np.zeros((2, *run.torque.shape, base.travels.shape[1]))
        for j in np.flatnonzero(sliding > 0).tolist():
            if j not in bristles:
                bristles[j] = _presliding_felt(run, j, base.travels[j], shared.get(j, ()))
            felt, even[:, j] = bristles[j]
            for axis, columns in felt.items():
                turning[:, axis] += sliding[j] * columns
        presliding.append(turning)
        uneven.append(even)
    return replace(base, sliding=sliding, presliding=presliding, uneven=uneven)


def _presliding_felt(
    run: Run, drive: int, travels: FloatArray, shared: Sequence[tuple[int, float, float]]
) -> tuple[dict[int, FloatArray], FloatArray]:
    """Presliding (m, t) of a drive per unit of its dry friction, by the axes that feel it; and of its size."""
    own, uneven = presliding_columns(run, {drive: 1.0}, travels)
    felt = {drive: own}
    for axis, ratio, share in shared:
        both, _ = presliding_columns(run, {drive: 1.0, axis: ratio}, travels)
        felt[drive] = felt[drive] + share * (both - own)
        felt[axis] = felt.get(axis, 0.0) + ratio * share * both
    return felt, uneven


def _shared_friction(robot: Robot) -> dict[int, list[tuple[int, float, float]]]:
    """By drive: axes that it turns with as described, the ratios, and the shares of its dry friction that do so."""
    dry = _described_dry(robot)
    found: dict[int, list[tuple[int, float, float]]] = {}
    for entry in robot.physics:
        drive, axis, ratio = CATALOGUE[entry.effect].spins(entry.site, entry.values)
        if ratio:
            shared = CATALOGUE[entry.effect].shared_dry(robot.values(entry))[1]
            share = min(shared / dry[drive], 1.0) if dry[drive] else 1.0
            found.setdefault(drive, []).append((axis, ratio, share))
    return found


def _described_dry(robot: Robot) -> FloatArray:
    """Dry friction (n,) of the joints, N·m (N)."""
    found = np.zeros(robot.axis_count)
    for entry in robot.physics:
        if CATALOGUE[entry.effect].part == "dry":
            found[axis_of(entry.site)] += dry_level(entry)
    return found


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
        assumed = robot.rotor_scatter(number)
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
