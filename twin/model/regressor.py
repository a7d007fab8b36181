"""The torque of a serial robot as a matrix times its parameters: τ = Y(q, q̇, q̈) π (paper, Eq. 5).

Columns are the ten inertial parameters of every link, the drives' rotor inertias, and the parameters of the physics
entries whose law is linear in them. The columns of an entry are the law of its effect, evaluated per unit.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from twin.errors import InputError, NumericalError
from twin.physics import CATALOGUE
from twin.physics.effect import axis_of, unit_at
from twin.physics.motion import Motion
from twin.physics.statements import Part
from twin.robot.description import Entry, Robot, parse_robot
from twin.robot.frames import inertia_matrix, inertia_six, matrix_of

INERTIAL = ("mass", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Parameters of a link: mass kg, first moments kg·m, inertia kg·m² about the origin of its frame, I_xy = −Σ m x y."""
_UNITS = ("kg", "kg·m", "kg·m", "kg·m", *["kg·m²"] * 6)


@dataclass(frozen=True)
class Column:
    """One column of the regressor.

    Attributes:
        name: ``link2.mcx``, ``drive3.rotor_inertia``, ``coulomb_friction@joint1.torque``, ``torque_offset@joint1``.
        unit: of the parameter; the column is torque per that unit.
        group: what it belongs to; ``"offset"`` belongs to the recording, not to the robot.
        value: as described.
        nonnegative: no real robot has it below zero.
    """

    name: str
    unit: str
    group: Literal["link", "rotor", "entry", "offset"]
    value: float
    nonnegative: bool = False


def inertial_vector(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """The ten parameters (10,) about the frame's origin of a body given at its centre of mass."""
    moved = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    return np.array([mass, *(mass * com), *inertia_six(moved)])


def body_of(vector: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass (3,) and inertia at it (3, 3) of ten parameters; the inverse of ``inertial_vector``."""
    mass, com = float(vector[0]), vector[1:4] / vector[0]
    return mass, com, inertia_matrix(vector[4:].tolist()) - mass * (com @ com * np.eye(3) - np.outer(com, com))


def weight_vector(site: str, weight: dict[str, Any], axes: int) -> tuple[int, np.ndarray]:
    """Zero-based link that carries a body at a site, and the body's ten parameters (10,) about that link's frame.

    Args:
        site: ``flange`` (the last link) or ``link3``.
        weight: ``mass``, ``com`` and, if it has one, ``inertia``, as of a payload.
        axes: of the robot.
    """
    link = axes - 1 if site == "flange" else axis_of(site)
    six = [*weight.get("inertia", []), *[0.0] * 6][:6]
    return link, inertial_vector(weight["mass"], np.array(weight["com"], float), inertia_matrix(six))


def pseudo_inertia(vector: np.ndarray) -> np.ndarray:
    """[[Σ m r rᵀ, Σ m r], [Σ m rᵀ, m]] (4, 4): positive definite exactly where a body of positive density has it.

    Wensing, Kim, Slotine: Linear matrix inequalities for physically consistent inertial parameter identification,
    IEEE RA-L 3 (2018).
    """
    inertia = inertia_matrix(vector[4:].tolist())
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    P[:3, 3] = P[3, :3] = vector[1:4]
    P[3, 3] = vector[0]
    return P


@dataclass(frozen=True)
class _Placement:
    """A frame in the one before, Rx(α) Tx(a) Rz(θ) Tz(d): cosines and sines of α and of θ (nt,), position (3, nt)."""

    ca: float
    sa: float
    c: np.ndarray
    s: np.ndarray
    p: np.ndarray

    def inside(self, x: np.ndarray) -> np.ndarray:
        """A vector (3, nt) of the frame before, in this frame: Rᵀx."""
        y = self.ca * x[1] + self.sa * x[2]
        return np.array([self.c * x[0] + self.s * y, self.c * y - self.s * x[0], self.ca * x[2] - self.sa * x[1]])

    def outside(self, x: np.ndarray) -> np.ndarray:
        """A vector (3, nt) of this frame, in the frame before: Rx."""
        y = self.s * x[0] + self.c * x[1]
        return np.array([self.c * x[0] - self.s * x[1], self.ca * y - self.sa * x[2], self.sa * y + self.ca * x[2]])


@dataclass
class _Frame:
    """A frame's motion in its own axes: ω, ω̇, acceleration of its origin less gravity (3, nt); joint twists (3, nt)."""

    spin: np.ndarray
    spin_rate: np.ndarray
    acceleration: np.ndarray
    turn: list[np.ndarray]  # per joint, angular velocity per unit rate
    shift: list[np.ndarray]  # per joint, velocity of the origin per unit rate


def link_regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque through the gears per unit of every link's parameters (nt, n, 10 n), columns link by link.

    Recursive Newton–Euler with the parameters left out of the wrench (Atkeson, An, Hollerbach, IJRR 5, 1986),
    vectorised over samples.
    """
    nt, n = motion.position.shape
    Y = np.zeros((nt, n, 10 * n))
    for i, (_, frame) in enumerate(_frames(robot, motion)):
        for j in range(i + 1):
            Y[:, j, 10 * i : 10 * i + 10] = _per_parameter(frame, j).T
    return Y


def link_torque(robot: Robot, motion: Motion, links: np.ndarray) -> np.ndarray:
    """Torque (nt, n) of links with parameters (n, 10), through the gears: recursive Newton–Euler, outward and back."""
    frames = list(_frames(robot, motion, twists=False))
    torque = np.empty_like(motion.position)
    force = moment = np.zeros((3, len(torque)))
    for i in reversed(range(len(frames))):
        place, frame = frames[i]
        own_force, own_moment = _wrench(frame, links[i])
        force, moment = force + own_force, moment + own_moment
        torque[:, i] = (force if robot.axes[i].type == "prismatic" else moment)[2]
        force = place.outside(force)
        moment = place.outside(moment) + _cross(place.p, force)
    return torque


def rotor_body_regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque per unit of the rotors' mass and principal inertias, as spinning bodies (nt, n, 4 n) (paper, Eq. 2).

    A rotor sits on the link before its axis, turns ``gear_ratio`` times as fast and has its mass on the axis. Besides
    N²J of the armature this holds gyroscopic terms, and terms in sin 2Nq of unequal transverse inertias.
    """
    motion = motion.on(robot)
    nt, n = motion.position.shape
    Y = np.zeros((nt, n, 4 * n))
    frames = [_ground(robot, nt), *(frame for _, frame in _frames(robot, motion))]
    for i, (axis, drive) in enumerate(zip(robot.axes, robot.drives, strict=True)):
        if axis.type == "prismatic" or drive.coupling:
            raise ValueError(f"drive {i + 1}: rotors as bodies are for uncoupled revolute axes")
        q, v, a = (drive.gear_ratio * x[:, i] for x in (motion.position, motion.velocity, motion.acceleration))
        rotor = _next(frames[i], _placement(robot, i, q), False, v, a)
        rotor.turn[i] = rotor.turn[i] * drive.gear_ratio
        for j in range(i + 1):
            Y[:, j, 4 * i : 4 * i + 4] = _per_parameter(rotor, j)[[0, 4, 5, 6]].T
    return Y


def flange_path(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Flange point (nt, 3) in the base frame, m, for joint positions (nt, n)."""
    position = position + robot.encoder_zeros
    x = np.repeat(np.array(robot.flange.position)[:, None], len(position), axis=1)
    for i in reversed(range(robot.axis_count)):
        place = _placement(robot, i, position[:, i])
        x = place.p + place.outside(x)
    return np.array(robot.base.position) + x.T @ matrix_of(np.array(robot.base.quaternion)).T


def _placement(robot: Robot, i: int, q: np.ndarray) -> _Placement:
    axis = robot.axes[i]
    slide = axis.type == "prismatic"
    alpha, theta = np.deg2rad(axis.alpha_deg), np.deg2rad(axis.theta_deg) + (0 * q if slide else q)
    d = axis.d + (q if slide else 0 * q)
    ca, sa = float(np.cos(alpha)), float(np.sin(alpha))
    return _Placement(ca, sa, np.cos(theta), np.sin(theta), np.array([axis.a + 0 * d, -sa * d, ca * d]))


def _ground(robot: Robot, nt: int) -> _Frame:
    still = np.zeros((3, nt))
    up = -matrix_of(np.array(robot.base.quaternion)).T @ robot.felt_gravity
    return _Frame(still, still, np.repeat(up[:, None], nt, axis=1), [], [])


def _frames(robot: Robot, motion: Motion, twists: bool = True) -> Iterator[tuple[_Placement, _Frame]]:
    """Every frame, from the first, with its motion; ``twists`` of all joints before it, if asked for."""
    frame = _ground(robot, len(motion.position))
    for i, axis in enumerate(robot.axes):
        place = _placement(robot, i, motion.position[:, i])
        slides = axis.type == "prismatic"
        frame = _next(frame, place, slides, motion.velocity[:, i], motion.acceleration[:, i], twists)
        yield place, frame


def _next(
    before: _Frame, place: _Placement, slides: bool, v: np.ndarray, a: np.ndarray, twists: bool = True
) -> _Frame:  # fmt: skip
    spin, spin_rate, p = place.inside(before.spin), place.inside(before.spin_rate), place.p
    carried = before.acceleration + _cross(before.spin_rate, p) + _cross(before.spin, _cross(before.spin, p))
    acceleration = place.inside(carried)
    x, y = spin[0], spin[1]
    if slides:  # ω × z v = (ω_y, −ω_x, 0) v
        acceleration += np.array([2 * y * v, -2 * x * v, a])
    else:
        spin_rate += np.array([y * v, -x * v, a])
        spin = np.array([x, y, spin[2] + v])
    if not twists:
        return _Frame(spin, spin_rate, acceleration, [], [])
    turn = [place.inside(t) for t in before.turn]
    shift = [place.inside(s + _cross(t, p)) for s, t in zip(before.shift, before.turn, strict=True)]
    along, none = np.zeros((2, *p.shape))
    along[2] = 1
    return _Frame(
        spin, spin_rate, acceleration, [*turn, none if slides else along], [*shift, along if slides else none]
    )


def _wrench(frame: _Frame, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force, and moment about the origin, (3, nt) each, that a body with parameters (10,) needs."""
    w, dw, a = frame.spin, frame.spin_rate, frame.acceleration
    mc, inertia = np.repeat(body[1:4, None], w.shape[1], axis=1), inertia_matrix(body[4:].tolist())
    force = body[0] * a + _cross(dw, mc) + _cross(w, _cross(w, mc))
    return force, inertia @ dw + _cross(w, inertia @ w) + _cross(mc, a)


def _per_parameter(frame: _Frame, joint: int) -> np.ndarray:
    """Torque of a joint per unit of the ten parameters of a body on a frame (10, nt), by virtual power."""
    w, dw, a, s, t = frame.spin, frame.spin_rate, frame.acceleration, frame.shift[joint], frame.turn[joint]
    out, u = np.empty((10, w.shape[1])), _cross(t, w)
    out[0] = _dot(s, a)
    out[1:4] = _cross(s, dw) - _cross(t, a) + _dot(s, w) * w - _dot(w, w) * s
    out[4:7] = t * dw + u * w
    for k, (x, y) in enumerate(((0, 1), (0, 2), (1, 2)), 7):
        out[k] = t[x] * dw[y] + t[y] * dw[x] + u[x] * w[y] + u[y] * w[x]
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b over the first axis; np.cross spends most of its time on shapes."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rotor_regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque per unit of rotor inertia J (nt, n, n): N²J on the motor's acceleration, which a coupling adds to."""
    C = robot.coupling
    ratio = np.array([drive.gear_ratio for drive in robot.drives])
    spin = motion.acceleration @ C.T * ratio**2
    return spin[:, None, :] * C.T[None]


@dataclass(frozen=True)
class Regressor:
    """The columns of a robot's linear model, and the functions from motion to matrix and from values to robot.

    Attributes:
        robot: the description; entries that are not linear in their parameters and payloads keep described values.
        offsets: with one constant torque per joint, which belongs to the recording (current sensor's zero). A joint
            with an entry whose torque is or comes near that constant gets none.
    """

    robot: Robot
    offsets: bool = False

    @cached_property
    def columns(self) -> list[Column]:
        """All columns, in the order of :meth:`evaluate`."""
        columns = []
        for i, link in enumerate(self.robot.links):
            values = inertial_vector(*link.inertial)
            for name, unit, value in zip(INERTIAL, _UNITS, values, strict=True):
                columns.append(Column(f"link{i + 1}.{name}", unit, "link", float(value), name == "mass"))
        for i, drive in enumerate(self.robot.drives):
            columns.append(Column(f"drive{i + 1}.rotor_inertia", "kg·m²", "rotor", drive.rotor_inertia, True))
        for entry in self.entries:
            key = f"{entry.effect}@{entry.site}"
            columns += [
                Column(
                    f"{key}.{part.name}",
                    unit_at(part.unit, entry.site, self.robot),
                    "entry",
                    float(part.value),
                    part.nonnegative,
                )
                for part in CATALOGUE[entry.effect].linear_parts(entry.values)
            ]
        if self.offsets:
            leaning = {entry.site for entry in self.entries if CATALOGUE[entry.effect].leaning}
            columns += [
                Column(f"torque_offset@{name}", unit_at("N·m", name, self.robot), "offset", 0.0)
                for name in self.robot.joint_names
                if name not in leaning
            ]
        return columns

    @property
    def entries(self) -> list[Entry]:
        """The physics entries that have columns."""
        return [entry for entry in self.robot.physics if CATALOGUE[entry.effect].linear_in]

    @property
    def described(self) -> np.ndarray:
        """Described values (p,) of all columns."""
        return np.array([column.value for column in self.columns])

    def select(self, *groups: str) -> np.ndarray:
        """Which columns (p,) belong to the groups."""
        return np.array([column.group in groups for column in self.columns])

    def evaluate(self, motion: Motion) -> np.ndarray:
        """The matrix Y (nt, n, p): torque of every joint per unit of every parameter."""
        nt, n = motion.position.shape
        Y = np.zeros((nt, n, len(self.columns)))
        Y[:, :, : 11 * n] = self.bodies(motion)
        for column, axis, torque in self.laws(motion):
            Y[:, axis, column] += torque
        return Y

    def bodies(self, motion: Motion) -> np.ndarray:
        """The columns of links and rotors (nt, n, 11 n), smooth functions of the motion."""
        seen = motion.on(self.robot)
        motion = seen.of_axes
        rotors = rotor_regressor(self.robot, motion)
        for j, drive in enumerate(self.robot.drives):
            for axis, torque in self._carried(motion, f"joint{j + 1}", "inertia", drive.gear_ratio**2).items():
                rotors[:, axis, j] += torque
        return seen.seen(np.concatenate([link_regressor(self.robot, motion), rotors], axis=2))

    def carried_torque(self, motion: Motion) -> np.ndarray:
        """Torque (nt, n) of links, rotor masses and loads as described, through the gears."""
        seen = motion.on(self.robot)
        motion = seen.of_axes
        vectors = np.array([inertial_vector(*link.inertial) for link in self.robot.links])
        vectors += self.weights.reshape(vectors.shape)
        return seen.seen(link_torque(self.robot, motion, vectors))

    @property
    def weights(self) -> np.ndarray:
        """Inertial parameters (10 n,) of what has no column and moves with the links: rotor masses and payloads."""
        n = self.robot.axis_count
        total = np.zeros(10 * n)
        total[::10] = [drive.rotor_mass for drive in self.robot.drives]
        for entry in self.robot.physics:
            if (weight := CATALOGUE[entry.effect].weight(entry.values)) is not None:
                link, vector = weight_vector(entry.site, weight, n)
                total[10 * link : 10 * link + 10] += vector
        return total

    def _carried(self, motion: Motion, drive: str, part: Part, amount: float) -> dict[int, np.ndarray]:
        """What a drive's inertia or friction does beyond its own axis, where other entries take it over."""
        total: dict[int, np.ndarray] = {}
        for entry in self.robot.physics:
            effect, given = CATALOGUE[entry.effect], entry.model_extra or {}
            for axis, torque in effect.carried(motion, entry.site, entry.values, given, drive, part, amount).items():
                total[axis] = total.get(axis, 0.0) + torque
        return total

    def laws(self, motion: Motion, role: str = "") -> list[tuple[int, int, np.ndarray]]:
        """Columns of entries and offsets, which step where an axis turns back: (column, axis, torque (nt,)) each.

        With a ``role`` those of effects that have it alone.
        """
        motion = motion.on(self.robot)
        out = []
        k = 11 * self.robot.axis_count
        for entry in self.entries:
            effect = CATALOGUE[entry.effect]
            parts = effect.linear_parts(entry.values)
            if role and role != effect.role:
                k += len(parts)
                continue
            for part in parts:
                torques = effect.felt(motion, entry.site, part.values)
                out += [(k, axis, torque) for axis, torque in torques.items()]
                if effect.part:
                    carried = motion.spread(self._carried(motion.of_axes, entry.site, effect.part, 1.0), False)
                    out += [(k, axis, torque) for axis, torque in carried.items()]
                k += 1
        names = self.robot.joint_names
        for column in range(k, k if role else len(self.columns)):
            out.append((column, names.index(self.columns[column].name.partition("@")[2]), np.ones(len(motion.time))))
        return out

    @property
    def complete(self) -> bool:
        """Whether all torque has columns: then none is known beforehand."""
        fixed = (e for e in self.robot.physics if not CATALOGUE[e.effect].linear_in)
        laws = any(CATALOGUE[e.effect].has_torque or CATALOGUE[e.effect].weight(e.values) for e in fixed)
        return not laws and not any(drive.rotor_mass for drive in self.robot.drives)

    def known_torque(self, motion: Motion) -> np.ndarray:
        """Torque (nt, n) of what has no column: payloads, rotor masses, and laws not linear in their parameters."""
        n, weights, fixed = self.robot.axis_count, self.weights, []
        for entry in self.robot.physics:
            effect = CATALOGUE[entry.effect]
            if effect.weight(entry.values) is None and not effect.linear_in:
                fixed.append((effect, entry))
        recorded, motion = motion, motion.on(self.robot)
        total = np.zeros_like(motion.position)
        if weights.any():
            total += motion.seen(link_torque(self.robot, motion.of_axes, weights.reshape(n, 10)))
        if any(effect.role != "drive" for effect, _ in fixed):  # such laws act on load and friction as described
            Y = self.evaluate(recorded)
            load = self.select("link")
            sliding = np.zeros(len(self.columns), bool)
            k = 11 * n
            for entry in self.entries:
                width = len(CATALOGUE[entry.effect].linear_parts(entry.values))
                load[k : k + width] |= CATALOGUE[entry.effect].role == "load"
                sliding[k : k + width] = CATALOGUE[entry.effect].role == "friction"
                k += width
            motion = replace(
                motion, load=total + Y[:, :, load] @ self.described[load],
                friction=Y[:, :, sliding] @ self.described[sliding],
            )  # fmt: skip
        for effect, entry in sorted(fixed, key=lambda pair: pair[0].order):
            for axis, torque in effect.felt(motion, entry.site, entry.values).items():
                total[:, axis] += torque
                if effect.role == "friction":
                    motion.friction[:, axis] += torque
        return total

    def robot_with(self, values: np.ndarray) -> Robot:
        """The description with the parameters (p,) in place of its own; its links must be physically possible.

        Raises:
            NumericalError: a number is of a size that no robot has.
        """
        found = {column.name: float(value) for column, value in zip(self.columns, values, strict=True)}
        data = self.robot.model_dump(mode="json")
        for i, link in enumerate(data["links"]):
            mass, com, inertia = body_of(values[10 * i : 10 * i + 10])
            link.update(mass=mass, com=[float(x) for x in com], inertia=inertia_six(inertia), density=None)
        data["total_mass"] = None
        for i, drive in enumerate(data["drives"]):
            drive.update(rotor_inertia=max(found[f"drive{i + 1}.rotor_inertia"], 0.0))
        k = 11 * self.robot.axis_count
        for entry, written in zip(self.robot.physics, data["physics"], strict=True):
            effect = CATALOGUE[entry.effect]
            if effect.linear_in:
                width = len(effect.linear_parts(entry.values))
                written.update(effect.with_linear(entry.values, [float(x) for x in values[k : k + width]]))
                k += width
        try:
            return parse_robot(data, self.robot.name)
        except InputError as error:
            remedy = "look for torque in another unit, or of another robot"
            said = f"what the log asks for is no robot ({error.expected}); {remedy}"
            raise NumericalError(self.robot.name, error.field, said) from None
