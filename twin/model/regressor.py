"""The torque of a serial robot as a matrix times its parameters: τ = Y(q, q̇, q̈) π (paper, Eq. 5).

Columns are the ten inertial parameters of every link, the drives' rotor inertias, and the parameters of the physics
entries whose law is linear in them; the columns of an entry are the law of its effect, evaluated per unit.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from twin.physics import CATALOGUE
from twin.physics.motion import Motion
from twin.robot.description import Entry, Robot, parse_robot
from twin.robot.frames import inertia_matrix, inertia_six, matrix_of

INERTIAL = ("mass", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Parameters of a link: mass kg, first moments kg·m, inertia kg·m² about the origin of its frame, I_xy = −Σ m x y."""
_UNITS = ("kg", "kg·m", "kg·m", "kg·m", *["kg·m²"] * 6)
ROTOR_BODY = ("mass", "Ixx", "Iyy", "Izz")


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


@dataclass
class _Frame:
    """A frame's motion in its own axes: ω, ω̇, acceleration of its origin less gravity (nt, 3); joint twists (nt, 3)."""

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
    for i, frame in enumerate(_frames(robot, motion)):
        wrench = _wrench(frame)
        for j in range(i + 1):
            Y[:, j, 10 * i : 10 * i + 10] = _power(frame, j, wrench)
    return Y


def rotor_body_regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque per unit of the rotors' mass and principal inertias, as spinning bodies (nt, n, 4 n) (paper, Eq. 2).

    A rotor sits on the link before its axis, turns ``gear_ratio`` times as fast and has its mass on the axis. Besides
    N²J of the armature this holds gyroscopic terms, and terms in sin 2Nq of unequal transverse inertias.
    """
    nt, n = motion.position.shape
    Y = np.zeros((nt, n, 4 * n))
    frames = [_ground(robot, nt), *_frames(robot, motion)]
    for i, (axis, drive) in enumerate(zip(robot.axes, robot.drives, strict=True)):
        if axis.type == "prismatic" or drive.coupling:
            raise ValueError(f"drive {i + 1}: rotors as bodies are for uncoupled revolute axes")
        q, v, a = (drive.gear_ratio * x[:, i] for x in (motion.position, motion.velocity, motion.acceleration))
        rotor = _next(robot, frames[i], i, q, v, a)
        rotor.turn[i] = rotor.turn[i] * drive.gear_ratio
        wrench = _wrench(rotor)[:, :, [0, 4, 5, 6]]
        for j in range(i + 1):
            Y[:, j, 4 * i : 4 * i + 4] = _power(rotor, j, wrench)
    return Y


def flange_path(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Flange point (nt, 3) in the base frame, m, for joint positions (nt, n)."""
    R = np.broadcast_to(matrix_of(np.array(robot.base.quaternion)), (len(position), 3, 3))
    x = np.broadcast_to(np.array(robot.base.position), (len(position), 3))
    for i in range(robot.axis_count):
        A, p = _placement(robot, i, position[:, i])
        x, R = x + np.einsum("tab,tb->ta", R, p), R @ A
    return x + R @ np.array(robot.flange.position)


def _placement(robot: Robot, i: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (nt, 3, 3) and position (nt, 3) of frame i in the one before, Rx(α) Tx(a) Rz(θ) Tz(d)."""
    axis = robot.axes[i]
    slide = axis.type == "prismatic"
    alpha, theta = np.deg2rad(axis.alpha_deg), np.deg2rad(axis.theta_deg) + (0 * q if slide else q)
    d = axis.d + (q if slide else 0 * q)
    ca, sa, c, s = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    R = np.zeros((len(q), 3, 3))
    R[:, 0, 0], R[:, 0, 1] = c, -s
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = s * ca, c * ca, -sa
    R[:, 2, 0], R[:, 2, 1], R[:, 2, 2] = s * sa, c * sa, ca
    return R, np.stack([axis.a + 0 * d, -sa * d, ca * d], -1)


def _ground(robot: Robot, nt: int) -> _Frame:
    still = np.zeros((nt, 3))
    up = -matrix_of(np.array(robot.base.quaternion)).T @ np.array(robot.gravity)
    return _Frame(still, still, np.broadcast_to(up, (nt, 3)), [], [])


def _frames(robot: Robot, motion: Motion) -> Iterator[_Frame]:
    frame = _ground(robot, len(motion.position))
    for i in range(robot.axis_count):
        frame = _next(robot, frame, i, motion.position[:, i], motion.velocity[:, i], motion.acceleration[:, i])
        yield frame


def _next(robot: Robot, before: _Frame, i: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> _Frame:
    R, p = _placement(robot, i, q)

    def seen(x: np.ndarray) -> np.ndarray:
        return np.einsum("tba,tb->ta", R, x)

    def at(x: np.ndarray, turn: np.ndarray) -> np.ndarray:
        return seen(x + _cross(turn, p))

    z = np.zeros_like(p)
    z[:, 2] = 1
    spin, spin_rate = seen(before.spin), seen(before.spin_rate)
    acceleration = seen(before.acceleration + _cross(before.spin_rate, p) + _cross(before.spin, _cross(before.spin, p)))
    turn = [seen(t) for t in before.turn]
    shift = [at(s, t) for s, t in zip(before.shift, before.turn, strict=True)]
    rate, gain = v[:, None] * z, a[:, None] * z
    if robot.axes[i].type == "prismatic":
        acceleration = acceleration + 2 * _cross(spin, rate) + gain
        return _Frame(spin, spin_rate, acceleration, [*turn, 0 * z], [*shift, z])
    spin_rate = spin_rate + _cross(spin, rate) + gain
    return _Frame(spin + rate, spin_rate, acceleration, [*turn, z], [*shift, 0 * z])


def _wrench(frame: _Frame) -> np.ndarray:
    """Force and moment about the origin (nt, 6, 10) a body needs, per unit of its ten parameters."""
    w, dw, a = frame.spin, frame.spin_rate, frame.acceleration
    W = np.zeros((len(a), 6, 10))
    W[:, :3, 0] = a
    ww = w[:, :, None] * w[:, None, :]
    W[:, :3, 1:4] = _cross_matrix(dw) + ww - np.einsum("taa->t", ww)[:, None, None] * np.eye(3)
    W[:, 3:, 1:4] = -_cross_matrix(a)
    W[:, 3:, 4:] = _inertia_times(dw) + _cross_matrix(w) @ _inertia_times(w)
    return W


def _power(frame: _Frame, joint: int, wrench: np.ndarray) -> np.ndarray:
    """Torque of a joint that a wrench (nt, 6, m) on the frame's body asks for, by virtual power."""
    twist = np.concatenate([frame.shift[joint], frame.turn[joint]], -1)
    return np.einsum("tk,tkc->tc", twist, wrench)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b over the last axis; np.cross spends most of its time on shapes."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def _cross_matrix(x: np.ndarray) -> np.ndarray:
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return out - out.transpose(0, 2, 1)


def _inertia_times(x: np.ndarray) -> np.ndarray:
    """(nt, 3, 6): I x as a matrix times (Ixx, Iyy, Izz, Ixy, Ixz, Iyz)."""
    out = np.zeros((len(x), 3, 6))
    out[:, 0, 0], out[:, 0, 3], out[:, 0, 4] = x.T
    out[:, 1, 3], out[:, 1, 1], out[:, 1, 5] = x.T
    out[:, 2, 4], out[:, 2, 5], out[:, 2, 2] = x.T
    return out


def coupling_matrix(robot: Robot) -> np.ndarray:
    """C (n, n) of θ = C q: motor positions at the gear outputs from joint positions; then τ_q = Cᵀ τ_θ."""
    C = np.eye(robot.axis_count)
    for i, drive in enumerate(robot.drives):
        for name, ratio in drive.coupling.items():
            C[i, robot.joint_names.index(name)] = ratio
    return C


def rotor_regressor(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque per unit of rotor inertia J (nt, n, n): N²J on the motor's acceleration, which a coupling adds to."""
    C = coupling_matrix(robot)
    ratio = np.array([drive.gear_ratio for drive in robot.drives])
    spin = motion.acceleration @ C.T * ratio**2
    return spin[:, None, :] * C.T[None]


# Effects whose law is linear in some of their parameters; the others of the entry keep their described values.
LINEAR: dict[str, tuple[str, ...]] = {
    "viscous_friction": ("coefficient",),
    "coulomb_friction": ("torque",),
    "asymmetric_friction": ("torque_difference", "viscous_difference"),
    "stribeck_friction": ("static_excess",),
    "hysteresis": ("yield_torque",),
    "presliding": ("yield_torque",),
    "gravity_compensator": ("coefficients",),
    "cable_stiffness": ("stiffness", "stiffness·rest"),
    "torque_ripple": ("amplitude·cos", "amplitude·sin"),
    "rotor_inertia": ("inertia",),
}
_TAKEN_OVER: dict[
    str, tuple[str, Any]
] = {  # what a coupled drive does on both axes, as the coupling's own law takes it
    "viscous_friction": ("friction", [1.0, 0.0]),
    "coulomb_friction": ("friction", [0.0, 1.0]),
    "rotor_inertia": ("inertia", 1.0),
}
SINGULAR = 1e-12  # stands for a slip element of no strength, whose yield travel must stay as described


@dataclass(frozen=True)
class Regressor:
    """The columns of a robot's linear model, and the functions from motion to matrix and from values to robot.

    Attributes:
        robot: the description; entries that are not linear in their parameters and payloads keep described values.
        offsets: with one constant torque per joint, which belongs to the recording (current sensor's zero). A joint
            with ``asymmetric_friction`` gets none, because its torque difference is that constant, nor one with a
            ``gravity_compensator`` or a cable, which come near it wherever a joint turns less than once.
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
            columns += [column for column, _ in _units(entry)]
        if self.offsets:
            constant = ("asymmetric_friction", "gravity_compensator", "cable_stiffness")
            leaning = {entry.site for entry in self.entries if entry.effect in constant}
            columns += [
                Column(f"torque_offset@{name}", "N·m", "offset", 0.0)
                for name in self.robot.joint_names
                if name not in leaning
            ]
        return columns

    @property
    def entries(self) -> list[Entry]:
        """The physics entries that have columns."""
        return [entry for entry in self.robot.physics if entry.effect in LINEAR]

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
        rotors = rotor_regressor(self.robot, motion)
        for j, drive in enumerate(self.robot.drives):
            for axis, torque in self._coupled(motion, f"joint{j + 1}", "inertia", drive.gear_ratio**2).items():
                rotors[:, axis, j] += torque
        return np.concatenate([link_regressor(self.robot, motion), rotors], axis=2)

    def _coupled(self, motion: Motion, site: str, name: str, value: Any) -> dict[int, np.ndarray]:
        """What a drive's inertia or friction does beyond its own axis, where a coupling takes over whatever it is."""
        total: dict[int, np.ndarray] = {}
        for entry in self.robot.physics:
            if (
                entry.effect == "joint_coupling"
                and entry.values["from"] == site
                and (entry.model_extra or {}).get(name) is None
            ):
                values = {**entry.values, "inertia": 0.0, "friction": [0.0, 0.0], name: value}
                for axis, torque in CATALOGUE["joint_coupling"].torque(motion, entry.site, values).items():
                    total[axis] = total.get(axis, 0.0) + torque
        return total

    def laws(self, motion: Motion) -> list[tuple[int, int, np.ndarray]]:
        """Columns of entries and offsets, which step where an axis turns back: (column, axis, torque (nt,)) each."""
        out = []
        k = 11 * self.robot.axis_count
        for entry in self.entries:
            for _, unit in _units(entry):
                torques = CATALOGUE[entry.effect].torque(motion, entry.site, unit.values)
                out += [(k, axis, torque) for axis, torque in torques.items()]
                if entry.effect in _TAKEN_OVER:
                    coupled = self._coupled(motion, entry.site, *_TAKEN_OVER[entry.effect])
                    out += [(k, axis, torque) for axis, torque in coupled.items()]
                k += 1
        names = self.robot.joint_names
        for column in range(k, len(self.columns)):
            out.append((column, names.index(self.columns[column].name.partition("@")[2]), np.ones(len(motion.time))))
        return out

    def known_torque(self, motion: Motion) -> np.ndarray:
        """Torque (nt, n) of what has no column: payloads, rotor masses, and laws not linear in their parameters."""
        n = self.robot.axis_count
        payload = np.zeros(10 * n)
        payload[::10] = [drive.rotor_mass for drive in self.robot.drives]
        fixed = []
        for entry in self.robot.physics:
            if entry.effect == "payload":
                link = n - 1 if entry.site == "flange" else int(entry.site[4:]) - 1
                values = entry.values
                six = [*(values["inertia"] or []), *[0.0] * 6][:6]
                payload[10 * link : 10 * link + 10] += inertial_vector(
                    values["mass"], np.array(values["com"]), inertia_matrix(six)
                )
            elif entry.effect not in LINEAR:
                fixed.append((CATALOGUE[entry.effect], entry))
        total = np.zeros_like(motion.position)
        if payload.any():
            total += link_regressor(self.robot, motion) @ payload
        if any(effect.role != "drive" for effect, _ in fixed):  # such laws act on load and friction as described
            Y = self.evaluate(motion)
            load = self.select("link")
            sliding = np.zeros(len(self.columns), bool)
            k = 11 * n
            for entry in self.entries:
                width = len(_units(entry))
                load[k : k + width] |= CATALOGUE[entry.effect].role == "load"
                sliding[k : k + width] = CATALOGUE[entry.effect].role == "friction"
                k += width
            motion = replace(
                motion, load=total + Y[:, :, load] @ self.described[load],
                friction=Y[:, :, sliding] @ self.described[sliding],
            )  # fmt: skip
        for effect, entry in sorted(fixed, key=lambda pair: pair[0].order):
            for axis, torque in effect.torque(motion, entry.site, entry.values).items():
                total[:, axis] += torque
                if effect.role == "friction":
                    motion.friction[:, axis] += torque
        return total

    def robot_with(self, values: np.ndarray) -> Robot:
        """The description with the parameters (p,) in place of its own; its links must be physically possible."""
        found = {column.name: float(value) for column, value in zip(self.columns, values, strict=True)}
        data = self.robot.model_dump(mode="json")
        for i, link in enumerate(data["links"]):
            mass, com, inertia = body_of(values[10 * i : 10 * i + 10])
            link.update(mass=mass, com=[float(x) for x in com], inertia=inertia_six(inertia), density=None)
        data["total_mass"] = None
        for i, drive in enumerate(data["drives"]):
            drive["rotor_inertia"] = max(found[f"drive{i + 1}.rotor_inertia"], 0.0)
        for entry in data["physics"]:
            if entry["effect"] in LINEAR:
                entry.update(_written(Entry(**entry), found))
        return parse_robot(data, self.robot.name)


def _units(entry: Entry) -> list[tuple[Column, Entry]]:
    """Columns of an entry, each with the entry whose law is the column."""
    values, out = entry.values, []

    def add(name: str, unit: str, value: float, **parameters: Any) -> None:
        data = {**values, **parameters}
        column = Column(f"{entry.effect}@{entry.site}.{name}", unit, "entry", float(value), name in _NONNEGATIVE)
        out.append((column, Entry(effect=entry.effect, site=entry.site, **data)))

    none: dict[str, Any] = {}
    for parameter in CATALOGUE[entry.effect].parameters:
        if parameter.name in LINEAR[entry.effect]:
            none[parameter.name] = [0.0] * parameter.length if parameter.length > 0 else 0.0
    match entry.effect:
        case "cable_stiffness":
            add("stiffness", "N·m/rad", values["stiffness"], stiffness=1.0, rest=0.0)
            # −k q₀ has the law of a spring of no stiffness that pulls for ever: a limit taken exactly in binary numbers
            add("stiffness·rest", "N·m", values["stiffness"] * values["rest"], stiffness=2.0**-60, rest=2.0**60)
        case "torque_ripple":
            amplitude, phase = values["amplitude"], values["phase"]
            add("amplitude·cos", "N·m", amplitude * np.cos(phase), amplitude=1.0, phase=0.0)
            add("amplitude·sin", "N·m", amplitude * np.sin(phase), amplitude=1.0, phase=np.pi / 2)
        case "hysteresis" | "presliding":
            limits = np.maximum(values["yield_torque"], SINGULAR)
            stiffness = np.maximum(values["stiffness"], SINGULAR)
            for k, travel in enumerate(limits / stiffness):
                add(f"yield_torque[{k + 1}]", "N·m", limits[k], yield_torque=[1.0], stiffness=[1.0 / travel])
        case _:
            by_name = {parameter.name: parameter for parameter in CATALOGUE[entry.effect].parameters}
            for name in LINEAR[entry.effect]:
                parameter = by_name[name]
                units = [word.strip() for word in parameter.unit.split(",")]
                if not parameter.length:
                    add(name, units[0], values[name], **{**none, name: 1.0})
                for k in range(parameter.length):
                    unit = np.eye(parameter.length)[k].tolist()
                    add(f"{name}[{k + 1}]", units[min(k, len(units) - 1)], values[name][k], **{**none, name: unit})
    return out


_NONNEGATIVE = {"coefficient", "torque", "inertia"}


def _written(entry: Entry, found: dict[str, float]) -> dict[str, Any]:
    """The parameters of an entry from the values of its columns."""
    at = f"{entry.effect}@{entry.site}."
    match entry.effect:
        case "cable_stiffness":
            stiffness, pull = found[at + "stiffness"], found[at + "stiffness·rest"]
            return {"stiffness": stiffness, "rest": pull / stiffness if stiffness else 0.0}
        case "torque_ripple":
            cosine, sine = found[at + "amplitude·cos"], found[at + "amplitude·sin"]
            return {"amplitude": float(np.hypot(cosine, sine)), "phase": float(np.arctan2(sine, cosine))}
        case "hysteresis" | "presliding":
            limits = np.array([max(found[column.name], 0.0) for column, _ in _units(entry)])
            described = np.maximum(entry.values["yield_torque"], SINGULAR)
            travel = described / np.maximum(entry.values["stiffness"], SINGULAR)
            return {"yield_torque": limits.tolist(), "stiffness": (limits / travel).tolist()}
    out: dict[str, Any] = {}
    for parameter in CATALOGUE[entry.effect].parameters:
        if parameter.name in LINEAR[entry.effect]:
            names = [f"{at}{parameter.name}[{k + 1}]" for k in range(parameter.length)]
            listed = [found[name] for name in names]
            value = listed if names else found[at + parameter.name]
            if parameter.nonnegative:
                value = [max(x, 0.0) for x in listed] if names else max(found[at + parameter.name], 0.0)
            out[parameter.name] = value
    return out
