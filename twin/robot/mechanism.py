"""The robot in one posture as plain data: bodies, joints, springs, instruments — before it becomes MJCF.

``assemble`` lays out base → motor1 → link1 → motor2 → …; the physics entries then edit the mechanism, each through
the ``write`` of its effect. Nothing here knows MuJoCo's API.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any, Literal

import numpy as np

from twin.errors import InputError
from twin.physics import CATALOGUE
from twin.robot.bodies import Split, fuse
from twin.robot.description import Robot
from twin.robot.frames import IDENTITY, axis_placement, inertia_matrix, rotate

Drives = Literal["held", "free", "servo"]


@dataclass
class Joint:
    """A degree of freedom of a body. Hinges take rad, N·m; slides m, N.

    Attributes:
        axis: unit vector in the body's frame.
        position: a point of a hinge's axis, m in the body's frame.
        stiffness: k₁, k₂, k₃ of k₁x + k₂x² + k₃x³.
        damping: d₁, d₂, d₃ of d₁v + d₂v|v| + d₃v³.
        elastic: a deflection, whose rest position is chosen so that the commanded posture is the equilibrium;
            otherwise a motor's coordinate.
        springref: rest position of a motor's spring.
        loss_factor: η of structural damping, k₁(1 + iη); beyond MuJoCo, used in the frequency domain.
        integral_time: T of integral action, the spring's torque k₁(x + ∫x dt / T), s; in the frequency domain only too.
        dead_zone: total width of a gap in series with the spring, rad.
        range: lower and upper stop, or ``None``.
    """

    name: str
    axis: tuple[float, float, float]
    kind: Literal["hinge", "slide"] = "hinge"
    stiffness: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    damping: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    armature: float = 0.0
    frictionloss: float = 0.0
    elastic: bool = True
    springref: float = 0.0
    loss_factor: float = 0.0
    integral_time: float = inf
    dead_zone: float = 0.0
    range: tuple[float, float] | None = None
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def rest(self, torque: float) -> float:
        """Deflection (rad, m) at which the spring carries a torque: k₁x + k₂x² + k₃x³ = torque, the dead zone aside."""
        k1, k2, k3 = self.stiffness
        if k1 == 0:
            return 0.0
        rest = torque / k1
        if k2 or k3:
            roots = np.roots([k3, k2, k1, -torque])
            real = roots[np.abs(roots.imag) < 1e-9 * max(1.0, abs(rest))].real
            rest = float(real[np.argmin(np.abs(real - rest))])
        return rest


@dataclass
class Body:
    """A rigid body. ``position`` and ``quaternion`` (w, x, y, z) place it in its parent; inertia is at the com."""

    name: str
    parent: str
    position: np.ndarray
    quaternion: np.ndarray
    mass: float = 0.0
    com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    joints: list[Joint] = field(default_factory=list)
    mesh: str | None = None
    mesh_scale: float = 1.0
    kind: Literal["base", "motor", "link", "tip", "part"] = "part"


@dataclass
class Point:
    """A hammer or accelerometer point: position and direction (unit, sign included) in the body's frame."""

    label: str
    body: str
    position: np.ndarray
    direction: np.ndarray


@dataclass
class Tendon:
    """A linear combination of joint coordinates that carries a spring, inertia or friction."""

    name: str
    joints: dict[str, float]
    stiffness: float = 0.0
    springlength: tuple[float, float] = (0.0, 0.0)
    springyield: float = 0.0
    damping: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    armature: float = 0.0
    frictionloss: float = 0.0


@dataclass
class PassiveMotor:
    """A passive drive element: cogging (amplitude N·m, order, phase rad) or LuGre friction.

    Attributes:
        joint: it acts on, or the tendon of a coupled drive.
    """

    name: str
    joint: str
    cogging: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lugre: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PassiveForce:
    """A torque law MuJoCo does not have: ``effect.torque`` resists the motors at every step."""

    effect: str
    site: str
    values: Mapping[str, Any]


@dataclass
class Mechanism:
    """A robot in one posture, ready to be written as MJCF.

    Attributes:
        robot: the description it was made from.
        q: (n,) where the axes are commanded to be, rad (m): what their encoders say plus the offset of their zeros.
        drives: ``held`` rotors (brakes on, or a perfect servo), ``free`` rotors, or rotors driven by a ``servo``.
        bodies: name → body, parents before children.
        splits: link number (1-based) → how it is divided.
        accelerometers: labels of the response channels.
        sensor_delay: s, per accelerometer label.
        servo_gains: zero-based axis → position gain N·m/rad and velocity gain N·m·s/rad, where the description says so.
        crossed: two joints of a body → off-diagonal stiffness N·m/rad between them.
    """

    robot: Robot
    q: np.ndarray
    brakes: Literal["on", "off"]
    drives: Drives
    bodies: dict[str, Body] = field(default_factory=dict)
    tendons: list[Tendon] = field(default_factory=list)
    passive_motors: list[PassiveMotor] = field(default_factory=list)
    passive_forces: list[PassiveForce] = field(default_factory=list)
    splits: dict[int, Split] = field(default_factory=dict)
    accelerometers: tuple[str, ...] = ()
    sensor_delay: dict[str, float] = field(default_factory=dict)
    servo_gains: dict[int, tuple[float, float]] = field(default_factory=dict)
    crossed: dict[tuple[str, str], float] = field(default_factory=dict)

    def joint(self, name: str) -> Joint | None:
        """The joint of that name, or ``None`` where the model is rigid (or the rotor held)."""
        for body in self.bodies.values():
            for joint in body.joints:
                if joint.name == name:
                    return joint
        return None

    def motor(self, axis: int) -> Joint | None:
        """The rotor's coordinate of a zero-based axis, or ``None`` while it is held or rests on its servo's spring.

        Friction, ripple and the compensator act on moving drives: they matter for torque, not for the modes.
        """
        joint = next(iter(self.bodies[f"motor{axis + 1}"].joints), None)
        return joint if joint is not None and not joint.elastic else None

    def drive(self, axis: int) -> Joint | Tendon | None:
        """What turns with the rotor of a zero-based axis: its coordinate, or a tendon where other axes turn it too."""
        name = f"drive{axis + 1}"
        return next((tendon for tendon in self.tendons if tendon.name == name), None) or self.motor(axis)

    def turns(self, axis: int) -> dict[str, float]:
        """The motors' coordinates that turn the rotor of a zero-based axis, and by how much each."""
        coupling = self.robot.drives[axis].coupling
        return {f"motor{axis + 1}": 1.0} | {name.replace("joint", "motor"): ratio for name, ratio in coupling.items()}

    @property
    def joints(self) -> list[Joint]:
        """All joints, body by body."""
        return [joint for body in self.bodies.values() for joint in body.joints]

    @cached_property
    def points(self) -> list[Point]:
        """The test points, each in the frame of the body that carries it."""
        found = []
        for point in self.robot.test_points:
            position = np.array(point.position)
            carrier = self.carrier(point.body, position)
            found.append(Point(point.label, carrier, position - self.offset(carrier), np.array(point.direction)))
        return found

    def carrier(self, body: str, position: np.ndarray) -> str:
        """The body that carries a point given in ``body``'s frame: the outboard half where a link is split."""
        split = self.splits.get(int(body[4:])) if body.startswith("link") and body[4:].isdigit() else None
        outboard = split is not None and split.normal @ (np.asarray(position) - split.origin) > 0
        return f"{body}.tip" if outboard else body

    def axis_kind(self, axis: int) -> Literal["hinge", "slide"]:
        """Kind of the joint about (along) z of a zero-based axis."""
        return "slide" if self.robot.axes[axis].type == "prismatic" else "hinge"

    def spring(
        self,
        body: str,
        name: str,
        axis: tuple[float, float, float],
        stiffness: float,
        damping: float,
        kind: Literal["hinge", "slide"] = "hinge",
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Joint:
        """Give a body an elastic degree of freedom, a hinge's axis through ``position`` (m, in the body's frame)."""
        joint = Joint(name, axis, kind, [stiffness, 0.0, 0.0], [damping, 0.0, 0.0], position=position)
        self.bodies[body].joints.append(joint)
        return joint

    def part(self, link: str, position: np.ndarray, mass: float) -> str:
        """Add a small body of its own at a point of a link; returns its name."""
        carrier = self.carrier(link, position)
        name = f"{link}.part{sum(body.kind == 'part' for body in self.bodies.values()) + 1}"
        ball = np.eye(3) * max(mass * 1e-8, 1e-11)  # a point, as near as MuJoCo takes one
        self.bodies[name] = Body(name, carrier, position - self.offset(carrier), IDENTITY.copy(), mass, inertia=ball)
        return name

    def tendon(self, name: str, joints: dict[str, float], **options: Any) -> None:
        """Add a fixed tendon; options are the fields of :class:`Tendon`."""
        self.tendons.append(Tendon(name, joints, **options))

    def passive_motor(self, name: str, joint: str, **options: tuple[float, ...]) -> None:
        """Add cogging or LuGre friction to a joint; options are the fields of :class:`PassiveMotor`."""
        self.passive_motors.append(PassiveMotor(name, joint, **options))  # type: ignore[arg-type]

    def passive_force(self, effect: str, site: str, values: Mapping[str, Any]) -> None:
        """Leave a torque law to the stepping loop, because MuJoCo has no element for it."""
        self.passive_forces.append(PassiveForce(effect, site, values))

    def attach(self, body: str, mass: float, com: np.ndarray, inertia: np.ndarray) -> None:
        """Fuse a rigid mass (com and inertia at com in ``body``'s frame) into the body that carries it."""
        carrier = self.bodies[self.carrier(body, com)]
        carrier.mass, carrier.com, carrier.inertia = fuse(
            (carrier.mass, carrier.com, carrier.inertia),
            (mass, np.asarray(com) - self.offset(carrier.name), inertia),
        )

    def split(
        self,
        link: int,
        axis: tuple[float, float, float],
        name: str,
        stiffness: float,
        damping: float,
        mass_ratio: float | None = None,
        separation: float | None = None,
        moment_ratio: float | None = None,
    ) -> None:
        """Give a link a bending hinge half-way to the next joint (flange); a second call adds a second axis.

        The mass is divided by the plane through the hinge across the line to the next joint, see :class:`Split`.

        Args:
            link, axis: what bends, about what.
            name: of the hinge; ``stiffness`` N·m/rad, ``damping`` N·m·s/rad.
            mass_ratio, separation, moment_ratio: of the halves, see :func:`twin.robot.bodies.cut`; as first stated.

        Raises:
            InputError: the next joint (flange) lies in the link's origin, so that there is nothing to bend.
        """
        if link in self.splits:
            self.spring(f"link{link}.tip", name, axis, stiffness, damping)
            return
        body = self.bodies[f"link{link}"]
        child = self.bodies.get(f"motor{link + 1}")
        reach = child.position if child else np.array(self.robot.flange.position)
        length = np.linalg.norm(reach)
        if length < 1e-6:
            raise InputError(
                self.robot.name,
                f"link_flexibility@{name}",
                f"link{link} has no length: the next joint is in its origin",
            )
        origin = reach / 2
        split = self.splits[link] = Split(origin, reach / length, mass_ratio, separation, moment_ratio)
        inboard, outboard = split.parts((body.mass, body.com, body.inertia))
        body.mass, body.com, body.inertia = inboard
        mass, com, inertia = outboard
        tip = Body(f"link{link}.tip", body.name, origin, IDENTITY.copy(), mass, com - origin, inertia, kind="tip")
        bodies = dict(self.bodies)
        self.bodies.clear()
        for key, item in bodies.items():
            self.bodies[key] = item
            if key == body.name:
                self.bodies[tip.name] = tip
        self.spring(tip.name, name, axis, stiffness, damping)
        if child:
            child.parent, child.position = tip.name, child.position - origin

    def offset(self, body: str) -> np.ndarray:
        """Origin of a body's own frame, in the frame its points are given in (a link's tip starts half-way)."""
        return self.splits[int(body[4:-4])].origin if body.endswith(".tip") else np.zeros(3)


def assemble(
    robot: Robot,
    q: np.ndarray,
    *,
    brakes: Literal["on", "off"] = "on",
    drives: Drives = "held",
) -> Mechanism:
    """Lay out the robot in a posture and apply its physics entries.

    Args:
        robot: validated description.
        q: (n,) joint positions as encoders say them, rad (m).
        brakes: with ``"off"`` a ``servo_compliance`` frees the rotor it acts on; with ``"on"`` it cannot.
        drives: ``"held"`` for modes and hammer tests, ``"servo"`` for replay, ``"free"`` for unheld rotors.
    """
    q = robot.check_posture(q) + robot.encoder_zeros
    mechanism = Mechanism(robot, q, brakes, drives, accelerometers=tuple(robot.accelerometers))
    base = robot.base
    mechanism.bodies["base"] = Body(
        "base", "", np.zeros(3), IDENTITY.copy(), base.mass, np.array(base.com), inertia_matrix(base.inertia),
        mesh=base.mesh, kind="base",
    )  # fmt: skip
    parent = "base"
    for i, (link, axis, drive) in enumerate(zip(robot.links, robot.axes, robot.drives, strict=True)):
        prismatic = axis.type == "prismatic"
        kind: Literal["hinge", "slide"] = "slide" if prismatic else "hinge"
        z = (0.0, 0.0, 1.0)
        held = drives == "held"
        position, quaternion = axis_placement(axis, q[i] if held else 0.0)
        if i == 0:
            position = np.array(base.position) + rotate(np.array(base.quaternion), position)
            quaternion = _product(np.array(base.quaternion), quaternion)
        motor = Body(f"motor{i + 1}", parent, position, quaternion, drive.rotor_mass, kind="motor", mesh=drive.mesh)
        if not held:
            coupled = bool(drive.coupling)
            inertia = drive.gear_ratio**2 * drive.rotor_inertia
            limits = axis.limits.position if axis.limits else None
            motor.joints.append(
                Joint(motor.name, z, kind, elastic=False, range=limits, armature=0.0 if coupled else inertia)
            )
            if coupled:
                mechanism.tendons.append(Tendon(f"drive{i + 1}", mechanism.turns(i), armature=inertia))
        mass, com, inertia_at_com = link.inertial
        body = Body(
            f"link{i + 1}", motor.name, np.zeros(3), IDENTITY.copy(), mass, com, inertia_at_com,
            mesh=link.mesh, mesh_scale=link.mesh_scale, kind="link",
        )  # fmt: skip
        if axis.stiffness is not None:
            body.joints.append(Joint(f"joint{i + 1}.z", z, kind, [axis.stiffness, 0.0, 0.0], [axis.damping, 0.0, 0.0]))
        mechanism.bodies[motor.name], mechanism.bodies[body.name] = motor, body
        parent = body.name
    entries = sorted(robot.physics, key=lambda entry: CATALOGUE[entry.effect].order)
    for entry in entries:
        CATALOGUE[entry.effect].write(mechanism, entry.site, robot.values(entry))
    for body in mechanism.bodies.values():
        # preloaded coincident hinges do not quite commute: their order must not be that of the entries
        body.joints.sort(key=lambda joint: (joint.elastic, "zxy".find(joint.name[-1])))
    return mechanism


def assemble_all(
    robot: Robot, postures: Sequence[np.ndarray], *, brakes: Literal["on", "off"] = "on"
) -> list[Mechanism]:
    """The robot with held rotors in several postures: only where its motors stand differs, the rest is shared."""
    if any(axis.type == "prismatic" for axis in robot.axes):
        return [assemble(robot, q, brakes=brakes) for q in postures]
    first = assemble(robot, postures[0], brakes=brakes)
    found = [first]
    for q in postures[1:]:
        q, bodies = robot.check_posture(q) + robot.encoder_zeros, dict(first.bodies)
        for i, axis in enumerate(robot.axes):
            quaternion = axis_placement(axis, q[i])[1]
            if i == 0:
                quaternion = _product(np.array(robot.base.quaternion), quaternion)
            bodies[f"motor{i + 1}"] = replace(bodies[f"motor{i + 1}"], quaternion=quaternion)
        found.append(replace(first, q=q, bodies=bodies))
    return found


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Quaternion product, (w, x, y, z)."""
    (w, x, y, z), (k, p, q, r) = a.tolist(), b.tolist()
    return np.array(
        [
            w * k - x * p - y * q - z * r,
            w * p + k * x + y * r - z * q,
            w * q + k * y + z * p - x * r,
            w * r + k * z + x * q - y * p,
        ]
    )
