"""The numbers a fit may change, as data: name, unit, prior; and a robot with them changed.

Names read like the description: ``joint1.z.stiffness``, ``joint1.x.damping``, ``link3.mass``, ``link3.com.x``,
``link3.inertia.xx``, ``axis2.a`` (m), ``axis2.alpha`` and ``axis2.theta``, the joint's zero (rad). Any other number of
a physics entry is ``EFFECT@SITE.name`` (``.name[k]`` in a list).

Some numbers belong to a recording and not to the robot. ``posture.NAME.q1`` is the error of an angle, ``gain.21Z+`` a
channel's gain. ``node:7.position.x`` is the place of all that is at a node, in its link's frame (``node:7.response.x``
of its sensor, ``node:7Z+.excitation.x`` of one blow). ``node:7Z+.response.rx`` is a channel's direction turned about
its link's x axis (``node:7Z+.excitation.rx`` that of a blow). ``posture.sag`` is the share of their deflection under
the weight by which springs sag from the stated angles. It is 0 where those are the links', 1 where they are the
motors'.

Optimisation runs in z, in which the prior is the standard normal. x = L z with the prior covariance L Lᵀ. A value is
mean · eˣ (log-normal) or mean + x.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.measure.campaign import Channels, FloatArray
from twin.physics import CATALOGUE
from twin.physics.chain import node_of
from twin.robot.description import Entry, Robot
from twin.robot.frames import inertia_six

Kind = Literal["spring", "entry", "link", "axis", "posture", "sag", "gain", "point", "direction"]
Side = Literal["response", "excitation"]

SATURATED = 4.0
"""Prior deviations at which masses, inertias, angles and gains stop: more is not tolerance but missing physics."""

DEFAULT_FACTOR = {"stiffness": 2.0, "damping": 5.0}
"""One standard deviation, ×/÷, where the description states no prior."""

ASSUMED_DAMPING_RATIO, ASSUMED_HZ = 0.01, 15.0  # prior of a damper described as zero: this ratio on its own spring
SIX = ("xx", "yy", "zz", "xy", "xz", "yz")
_SCALES = ("stiffness", "damping", "loss_factor", "frequency_hz", "damping_ratio")


@dataclass(frozen=True)
class Parameter:
    """One free number.

    Attributes:
        kind: ``spring`` (of a joint), ``entry`` (of other physics), ``link``, ``axis``, ``posture``, ``sag``, ``gain``,
            ``point`` or ``direction``.
        log: value = mean · eˣ; otherwise mean + x.
        mean: prior mean (median, where ``log``), in ``unit``.
        deviation: prior standard deviation of x.
        source: where the prior comes from.
    """

    name: str
    unit: str
    kind: Kind
    log: bool
    mean: float
    deviation: float
    source: str = ""

    @property
    def site(self) -> str:
        """What the parameter belongs to: ``joint1.z`` of ``joint1.z.stiffness``."""
        return self.name.rpartition(".")[0]

    @property
    def quantity(self) -> str:
        """What it is there: ``stiffness`` of ``joint1.z.stiffness``."""
        return self.name.rpartition(".")[2]

    @property
    def axis(self) -> int:
        """Zero-based, of the error of a posture's angle: 0 of ``posture.p1.q1``."""
        return int(self.quantity[1:]) - 1

    @property
    def linear_power(self) -> int:
        """Of the value, in which FRFs are linear: −1 for a stiffness, as springs in series add compliances; else 1."""
        return -1 if self.quantity == "stiffness" else 1

    def value(self, x: FloatArray | float) -> Any:
        """Value at x, in ``unit``."""
        return self.mean * np.exp(x) if self.log else self.mean + x

    def step(self, value: float) -> float:
        """A step for central differences."""
        return 1e-4 * (abs(value) if self.log else self.deviation)


@dataclass(frozen=True)
class Parameters:
    """An ordered set of free numbers with a normal prior on x, mean zero and ``covariance`` (n, n)."""

    items: tuple[Parameter, ...]
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.items)

    def __getitem__(self, index: int) -> Parameter:
        return self.items[index]

    @cached_property
    def names(self) -> list[str]:
        """Names in order."""
        return [parameter.name for parameter in self.items]

    @cached_property
    def parts(self) -> list[tuple[str, str]]:
        """Site and quantity of every name."""
        return [(parameter.site, parameter.quantity) for parameter in self.items]

    @cached_property
    def _turns(self) -> dict[str, list[int]]:
        """Posture name → indices of its angles' errors."""
        found: dict[str, list[int]] = {}
        for k, parameter in enumerate(self.items):
            if parameter.kind == "posture":
                found.setdefault(parameter.site.partition(".")[2], []).append(k)
        return found

    def seen_in(self, posture: str) -> list[int]:
        """Indices of what can change the recording of a posture: all but the angles of others."""
        own = set(self._turns.get(posture, ()))
        return [k for k, parameter in enumerate(self.items) if parameter.kind != "posture" or k in own]

    @cached_property
    def _scaled(self) -> tuple[NDArray[np.bool_], FloatArray]:
        """(n,) which are logarithmic, and the means."""
        return np.array([p.log for p in self.items], bool), np.array([p.mean for p in self.items], float)

    @cached_property
    def bound(self) -> FloatArray:
        """Largest |z| (n,): tolerances end where they become implausible, springs and dampers nowhere."""
        open_ = [parameter.kind in ("spring", "entry", "axis", "point", "direction") for parameter in self.items]
        return np.where(open_, np.inf, SATURATED)

    @cached_property
    def root(self) -> FloatArray:
        """L (n, n), lower, with L Lᵀ the prior covariance of x."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    def select(self, keep: Iterable[int]) -> "Parameters":
        """The parameters at some indices."""
        keep = list(keep)
        return Parameters(tuple(self.items[k] for k in keep), self.covariance[np.ix_(keep, keep)])

    def only(self, *kinds: Kind) -> "Parameters":
        """The parameters of some kinds."""
        return self.select(k for k, parameter in enumerate(self.items) if parameter.kind in kinds)

    def values(self, z: FloatArray) -> FloatArray:
        """Values (n,) in their units."""
        x, (log, mean) = self.root @ z, self._scaled
        with np.errstate(over="ignore"):  # a step too far is seen by what it costs
            return np.where(log, mean * np.exp(np.where(log, x, 0.0)), mean + x)

    def transform(self, values: FloatArray) -> FloatArray:
        """∂ value / ∂ z, (n, n)."""
        with np.errstate(invalid="ignore"):  # of a step too far, too
            return np.asarray(np.where(self._scaled[0], values, 1.0)[:, None] * self.root)

    @cached_property
    def _levers(self) -> list[tuple[int, list[int]]]:
        """Index of every free mass of an entry, and those of where it hangs."""
        found = []
        for k, name in enumerate(self.names):
            key, _, quantity = name.rpartition(".")
            lever = CATALOGUE[key.partition("@")[0]].lever if "@" in key else ""
            if lever and quantity == "mass":
                found.append((k, [j for j, other in enumerate(self.names) if other.startswith(f"{key}.{lever}[")]))
        return found

    def moved(self, z: FloatArray, step: FloatArray) -> FloatArray:
        """z (n,) after a step (n,), to second order along a curve that keeps an entry's m c² if the step does.

        Often a moment of inertia is all that shows of a mass m at c. The valley that all such masses lie in is bent in
        m and c, and straight in ln m and √m c.
        """
        end = z + step
        if not self._levers:
            return end
        before, x, mean = self.root @ z, self.root @ end, self._scaled[1]
        for mass, lever in self._levers:
            grown, c = float(np.clip(x[mass] - before[mass], -20, 20)), mean[lever] + before[lever]
            x[lever] = (mean[lever] + x[lever] + 0.5 * grown * c) * np.exp(-0.5 * grown) - mean[lever]
        return np.asarray(np.linalg.solve(self.root, x))

    def along(self, z: FloatArray, gradient: FloatArray) -> FloatArray:
        """A gradient (n,) at z, an entry's mass m taken at constant √m c, where :meth:`moved` has valleys straight."""
        if not self._levers:
            return gradient
        x, slope, out = self.root @ z, np.linalg.solve(self.root.T, gradient), gradient.copy()
        for mass, lever in self._levers:
            c = self._scaled[1][lever] + x[lever]
            out[mass] -= 0.5 * self.root[mass, mass] * float(c @ slope[lever])
        return out

    def coordinates(self, values: FloatArray) -> FloatArray:
        """z (n,) of given values."""
        x = [np.log(v / p.mean) if p.log else v - p.mean for p, v in zip(self.items, values, strict=True)]
        return np.linalg.solve(self.root, np.array(x))

    def posture_error(self, name: str, values: FloatArray, axes: int) -> FloatArray:
        """Errors (axes,) of a posture's angles, rad (m)."""
        error = np.zeros(axes)
        for k in self._turns.get(name, ()):
            error[self.items[k].axis] = values[k]
        return error

    @cached_property
    def _channels(self) -> dict[tuple[tuple[str, ...], Side], list[tuple[int, list[int], int]]]:
        """What :meth:`moving` found, by labels and side."""
        return {}

    def moving(self, labels: tuple[str, ...], side: Side) -> list[tuple[int, list[int], int]]:
        """What moves or turns channels of a side: index of the parameter, rows of the channels, axis of their link."""
        if (labels, side) not in self._channels:
            own = [k for k, parameter in enumerate(self.items) if parameter.kind in ("point", "direction")]
            found = [(k, rows_of(self.items[k], labels, side), "xyz".index(self.parts[k][1][-1])) for k in own]
            self._channels[labels, side] = [(k, rows, axis) for k, rows, axis in found if rows]
        return self._channels[labels, side]

    def placed(self, channels: Channels, side: Side, values: FloatArray) -> Channels:
        """Channels of one side where the values have their nodes, and turned as they have them."""
        moving = self.moving(channels.label, side)
        if not moving:
            return channels
        position = channels.position.copy()
        for k, rows, axis in moving:
            if self.items[k].kind == "point":
                position[rows, axis] += values[k] - self.items[k].mean
        channels = replace(channels, position=position)
        turned = any(self.items[k].kind == "direction" for k, _, _ in moving)
        return replace(channels, direction=self._turned(channels, side, values)) if turned else channels

    def _turned(self, channels: Channels, side: Side, values: FloatArray) -> FloatArray:
        """Unit directions (n, 3) turned by small angles θ, (d + θ × d) / |d + θ × d|."""
        angle = np.zeros_like(channels.direction)
        for k, rows, axis in self.moving(channels.label, side):
            if self.items[k].kind == "direction":
                angle[rows, axis] += values[k] - self.items[k].mean
        turned = channels.direction + np.cross(angle, channels.direction)
        return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))

    def turning(self, channels: Channels, side: Side, values: FloatArray) -> dict[int, tuple[list[int], FloatArray]]:
        """Index of every angle → rows that it turns, and the rate (m, 3) of their directions, per rad.

        Args:
            channels: as stated.
        """
        turned, found = self._turned(channels, side, values), {}
        along = np.sum(turned * channels.direction, axis=1, keepdims=True)  # 1 / |d + θ × d|, as θ × d is across d
        rate = np.stack([np.cross(e, channels.direction) for e in np.eye(3)])
        rate = along * (rate - np.sum(rate * turned, axis=-1, keepdims=True) * turned)
        for k, rows, axis in self.moving(channels.label, side):
            if self.items[k].kind == "direction":
                found[k] = (rows, rate[axis, rows])
        return found

    def gains(self, labels: Sequence[str], values: FloatArray) -> FloatArray:
        """Gains (nr,) of response channels."""
        gain = {p.name: v for p, v in zip(self.items, values, strict=True) if p.kind == "gain"}
        return np.array([gain.get(f"gain.{label}", 1.0) for label in labels])

    def sag(self, values: FloatArray) -> float | None:
        """How far springs sag, 0 to 1; ``None`` where that is not free."""
        return next((float(v) for p, v in zip(self.items, values, strict=True) if p.kind == "sag"), None)

    def apply(self, robot: Robot, values: FloatArray) -> Robot:
        """The robot with the values that belong to it."""
        return _changed(robot, {p.name: float(v) for p, v in zip(self.items, values, strict=True)})

    def apply_one(self, robot: Robot, index: int, value: float) -> Robot:
        """The robot with one value changed."""
        return _changed(robot, {self.items[index].name: float(value)})


@dataclass(frozen=True)
class Sprung(Parameters):
    """Parameters whose springs are named after their coordinate, so that their derivatives are closed forms.

    Attributes:
        written: the same under the names of the description, through which values enter a robot.
    """

    written: Parameters

    def select(self, keep: Iterable[int]) -> "Sprung":
        """The parameters at some indices."""
        keep = list(keep)
        some = super().select(keep)
        return Sprung(some.items, some.covariance, self.written.select(keep))

    def apply(self, robot: Robot, values: FloatArray) -> Robot:
        """The robot with the values that belong to it."""
        return self.written.apply(robot, values)

    def apply_one(self, robot: Robot, index: int, value: float) -> Robot:
        """The robot with one value changed."""
        return self.written.apply_one(robot, index, value)


def can_vibrate(robot: Robot) -> bool:
    """Whether something of a robot is soft: an axis with a stiffness, or an entry with one."""
    return bool(free_parameters(robot, tolerances=False).items)


def require_springs(robot: Robot) -> None:
    """Raise for a robot that is rigid, as one from a drawing.

    Raises:
        InputError: what fills the stiffness in.
    """
    if not can_vibrate(robot):
        text = "no axis has a stiffness, so nothing can vibrate; `twin describe` fills it in, for a drawing"
        raise InputError(robot.name, "axes", text)


def written_names(parameters: Parameters) -> Parameters:
    """Parameters under the names of the description."""
    return parameters.written if isinstance(parameters, Sprung) else parameters


# --- which parameters there are -------------------------------------------------------------------------------------


def elastic_parameters(robot: Robot) -> list[Parameter]:
    """Stiffness and damping of every spring of the description: joints, their transverse hinges, other entries."""
    found = []
    for i, axis in enumerate(robot.axes):
        if axis.stiffness is not None:
            per = "rad" if axis.type == "revolute" else "m"
            force = "N·m" if per == "rad" else "N"
            damping = axis.damping or _assumed_damping(axis.stiffness)
            name = f"joint{i + 1}.z"
            found.append(_scale(robot, f"{name}.stiffness", f"{force}/{per}", "spring", axis.stiffness))
            found.append(_scale(robot, f"{name}.damping", f"{force}·s/{per}", "spring", damping))
    for key, entry in _entries(robot):
        effect = CATALOGUE[entry.effect]
        if "hammer" not in effect.seen_in:
            continue
        values = robot.values(entry)
        for item in effect.parameters:
            if item.name not in _SCALES or item.length:
                continue
            value = float(values[item.name])
            if value == 0 and item.name == "damping":
                value = _assumed_damping(values["stiffness"])
            if value <= 0:
                continue
            name = f"{entry.site}.{item.name}" if effect.hinge else f"{key}.{item.name}"
            unit = effect.unit(item.name, entry.site, robot)
            found.append(_scale(robot, name, unit, "spring" if effect.hinge else "entry", value, item.spread))
    return found


def entry_parameter(robot: Robot, name: str, deviation: float | None = None) -> Parameter:
    """Any number of a physics entry of the robot, ``EFFECT@SITE.parameter`` or ``….parameter[k]``, as a parameter.

    A number that cannot be negative gets a log-normal prior about its value, any other a normal one. ``deviation`` is
    that of x, by default the description's prior or what the effect says is usual.
    """
    key, quantity, index = _parse(name)
    entry = dict(_entries(robot))[key]
    item = next(p for p in CATALOGUE[entry.effect].parameters if p.name == quantity)
    value = robot.values(entry)[quantity]
    value = float(value if index is None else value[index])
    unit = CATALOGUE[entry.effect].unit(name.rpartition(".")[2], entry.site, robot)
    if item.log and value > 0:
        scale = _scale(robot, name, unit, "entry", value, item.spread)
        return scale if deviation is None else replace(scale, deviation=deviation)
    return Parameter(name, unit, "entry", False, value, deviation or item.spread or abs(value) or 1.0, "usual")


def link_parameters(robot: Robot) -> tuple[list[Parameter], FloatArray]:
    """Mass, centre of mass and inertia of every link within the description's tolerances; prior covariance of x.

    The second moments Σ = tr(I)/2 − I of a link vary as Σ^½ (1 + tolerance·G) Σ^½. G is a random symmetric matrix
    without preferred directions. So mass moves, in whatever frame, and bodies stay bodies.
    """
    found: list[Parameter] = []
    blocks: list[FloatArray] = []
    tolerance = robot.tolerances
    for i, link in enumerate(robot.links):
        name = f"link{i + 1}"
        mass, com, inertia = link.inertial
        if tolerance.mass:
            width = tolerance.mass
            found.append(Parameter(f"{name}.mass", "kg", "link", True, mass, width, "tolerance"))
            blocks.append(np.array([[width**2]]))
        if tolerance.com:
            width = tolerance.com
            for letter, value in zip("xyz", com, strict=True):
                found.append(Parameter(f"{name}.com.{letter}", "m", "link", False, float(value), width, "tolerance"))
                blocks.append(np.array([[width**2]]))
        if tolerance.inertia:
            block = _inertia_covariance(inertia, tolerance.inertia)
            for k, (key, value) in enumerate(zip(SIX, inertia_six(inertia), strict=True)):
                width = float(np.sqrt(block[k, k]))
                found.append(Parameter(f"{name}.inertia.{key}", "kg·m²", "link", False, value, width, "tolerance"))
            blocks.append(block)
    return found, _block_diagonal(blocks)


def recording_parameters(robot: Robot, postures: Iterable[str], labels: Iterable[str]) -> list[Parameter]:
    """Errors of posture angles, sag, and gains of response channels, within the description's tolerances."""
    found = []
    if robot.tolerances.posture_deg:
        width = float(np.deg2rad(robot.tolerances.posture_deg))
        for name in postures:
            for i, axis in enumerate(robot.axes):
                unit = "rad" if axis.type == "revolute" else "m"
                found.append(
                    Parameter(f"posture.{name}.q{i + 1}", unit, "posture", False, 0.0, width, "tolerance")
                )  # a linear axis: the same number in metres
        found.append(Parameter("posture.sag", "1", "sag", False, 0.5, 0.5, "unknown"))
    if robot.tolerances.channel_gain:
        width = robot.tolerances.channel_gain
        found += [Parameter(f"gain.{label}", "1", "gain", True, 1.0, width, "tolerance") for label in labels]
    return found


def axis_parameters(robot: Robot) -> list[Parameter]:
    """Lengths, offsets, twists and zeros of the axes beyond the first, which the base carries.

    The prior is the description's tolerance, from the described value.
    """
    length, angle = robot.tolerances.length, float(np.deg2rad(robot.tolerances.angle_deg))
    found = []
    for i, axis in enumerate(robot.axes[1:], 2):
        found.append(Parameter(f"axis{i}.a", "m", "axis", False, axis.a, length, "tolerance"))
        found.append(Parameter(f"axis{i}.d", "m", "axis", False, axis.d, length, "tolerance"))
        found.append(Parameter(f"axis{i}.alpha", "rad", "axis", False, np.deg2rad(axis.alpha_deg), angle, "tolerance"))
        if axis.type == "revolute":  # the zero of a linear axis is its offset d
            theta = np.deg2rad(axis.theta_deg)
            found.append(Parameter(f"axis{i}.theta", "rad", "axis", False, theta, angle, "tolerance"))
    return found


def point_parameters(robot: Robot, channels: Channels, side: Literal["position"] | Side) -> list[Parameter]:
    """Coordinates of the nodes of channels, in the frames of their links.

    Args:
        side: ``response``, a sensor; ``excitation``, each blow by itself; ``position``, whatever is at a node.
    """
    found: dict[str, Parameter] = {}
    for label, position in zip(channels.label, channels.position, strict=True):
        for letter, value in zip("xyz", position, strict=True):
            name = f"node:{label if side == 'excitation' else node_of(label)}.{side}.{letter}"
            width = robot.tolerances.position
            found.setdefault(name, Parameter(name, "m", "point", False, float(value), width, "tolerance"))
    return list(found.values())


def direction_parameters(robot: Robot, channels: Channels, side: Side) -> list[Parameter]:
    """Angles by which channels of a side are turned, each about the two axes of its link's frame most across it.

    A triaxial sensor's channels are not quite square to each other (its transverse sensitivity): each turns by itself.
    """
    width, found = float(np.deg2rad(robot.tolerances.direction_deg)), []
    for label, direction in zip(channels.label, channels.direction, strict=True):
        for k in np.sort(np.argsort(np.abs(direction), kind="stable")[:2]):
            name = f"node:{label}.{side}.r{'xyz'[k]}"
            found.append(Parameter(name, "rad", "direction", False, 0.0, width, "tolerance"))
    return found


def free_parameters(
    robot: Robot, postures: Iterable[str] = (), labels: Iterable[str] = (), *, tolerances: bool = True
) -> Parameters:
    """All springs and dampers and, with ``tolerances``, links, posture angles and channel gains."""
    elastic = elastic_parameters(robot)
    blocks = [np.diag([p.deviation**2 for p in elastic])]
    found = list(elastic)
    if tolerances:
        links, block = link_parameters(robot)
        recording = recording_parameters(robot, postures, labels)
        found += links + recording
        blocks += [block, np.diag([p.deviation**2 for p in recording])]
    return Parameters(tuple(found), _block_diagonal(blocks))


def join(*sets: Parameters) -> Parameters:
    """Several sets as one; their priors are independent."""
    return Parameters(tuple(p for s in sets for p in s), _block_diagonal([s.covariance for s in sets]))


def independent(items: Iterable[Parameter]) -> Parameters:
    """A set with independent priors."""
    items = tuple(items)
    return Parameters(items, np.diag([p.deviation**2 for p in items]).reshape(len(items), len(items)))


def _scale(robot: Robot, name: str, unit: str, kind: Kind, value: float, usual: float = 0.0) -> Parameter:
    """A parameter with a log-normal prior: the description's, else as wide as is ``usual``."""
    deviation, source = usual or float(np.log(DEFAULT_FACTOR.get(name.rpartition(".")[2], 2.0))), "usual"
    for prior in robot.priors:
        if fnmatchcase(name, prior.parameter):
            deviation, source = float(np.log(prior.factor)), prior.source
    return Parameter(name, unit, kind, True, value, deviation, source)


def _assumed_damping(stiffness: float) -> float:
    return 2 * ASSUMED_DAMPING_RATIO * stiffness / (2 * np.pi * ASSUMED_HZ)


def _inertia_covariance(inertia: FloatArray, tolerance: float) -> FloatArray:
    moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    values, vectors = np.linalg.eigh(moments)
    root = vectors @ np.diag(np.sqrt(np.maximum(values, 1e-6 * values[-1]))) @ vectors.T
    columns = []
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        unit = np.zeros((3, 3))
        unit[i, j] = unit[j, i] = tolerance if i == j else tolerance / np.sqrt(2)
        change = root @ unit @ root
        columns.append(inertia_six(np.trace(change) * np.eye(3) - change))
    rate = np.array(columns).T
    return rate @ rate.T


def _block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    size = sum(len(block) for block in blocks)
    out = np.zeros((size, size))
    at = 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return out


# --- writing values into a description ------------------------------------------------------------------------------


def _entries(robot: Robot) -> list[tuple[str, Entry]]:
    """Entries by ``EFFECT@SITE``; a second one at the same site is ``EFFECT@SITE#2``."""
    seen: dict[str, int] = {}
    keyed = []
    for entry in robot.physics:
        key = f"{entry.effect}@{entry.site}"
        seen[key] = seen.get(key, 0) + 1
        keyed.append((key if seen[key] == 1 else f"{key}#{seen[key]}", entry))
    return keyed


def rows_of(point: Parameter, labels: Sequence[str], side: Side) -> list[int]:
    """The channels of a side that a coordinate moves or an angle turns: of its node, or the one of its label."""
    where, _, of = point.site.removeprefix("node:").partition(".")
    if of not in (side, "position"):
        return []
    return [k for k, label in enumerate(labels) if where in (label, node_of(label))]


def _parse(name: str) -> tuple[str, str, int | None]:
    found = re.fullmatch(r"(.+@.+)\.([a-z_]+)(?:\[(\d+)\])?", name)
    if not found:
        raise ValueError(f"{name!r} names no number of a physics entry")
    return found[1], found[2], None if found[3] is None else int(found[3])


def _changed(robot: Robot, values: dict[str, float]) -> Robot:
    axes, links = list(robot.axes), list(robot.links)
    described = dict(_entries(robot))
    hinges = {entry.site: key for key, entry in described.items() if CATALOGUE[entry.effect].hinge}
    entries = {key: dict(entry.model_extra or {}) for key, entry in described.items()}
    touched: set[str] = set()
    frames: dict[int, dict[str, float]] = {}
    bodies: dict[int, tuple[float, FloatArray, list[float]]] = {}
    for name, value in values.items():
        if name.startswith(("posture.", "gain.", "node:")):
            continue
        if "@" in name:
            key, quantity, index = _parse(name)
            if index is not None:
                items = list(entries[key].get(quantity, robot.values(described[key])[quantity]))
                items[index] = value
            entries[key][quantity] = value if index is None else items
            touched.add(key)
        elif name.startswith("joint"):
            site, _, quantity = name.rpartition(".")
            if site.endswith(".z"):
                i = int(site[5:-2]) - 1
                axes[i] = axes[i].model_copy(update={quantity: value})
            else:
                entries[hinges[site]][quantity] = value
                touched.add(hinges[site])
        elif name.startswith("axis"):
            site, _, quantity = name.partition(".")
            i = int(site[4:]) - 1
            turned = quantity in ("alpha", "theta")
            change = {f"{quantity}_deg": float(np.rad2deg(value))} if turned else {quantity: float(value)}
            frames.setdefault(i, {}).update(change)
        else:
            link, _, quantity = name.partition(".")
            i = int(link[4:]) - 1
            if i not in bodies:
                mass, com, inertia = links[i].inertial
                bodies[i] = mass, com, inertia_six(inertia)
            if quantity == "mass":
                bodies[i] = value, *bodies[i][1:]
            elif quantity.startswith("com."):
                bodies[i][1]["xyz".index(quantity[-1])] = value
            else:
                bodies[i][2][SIX.index(quantity.partition(".")[2])] = value
    for i, frame in frames.items():
        axes[i] = axes[i].model_copy(update=frame)
    for i, (mass, com, six) in bodies.items():
        links[i] = links[i].model_copy(update={"mass": mass, "com": tuple(map(float, com)), "inertia": tuple(six)})
    physics = [
        Entry(effect=entry.effect, site=entry.site, **entries[key]) if key in touched else entry
        for key, entry in described.items()
    ]
    return robot.model_copy(update={"axes": axes, "links": links, "physics": physics})
