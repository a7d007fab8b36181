"""The flexible robot about a posture: M, C, K, modes and FRFs, with any structural effect in its truth.

A posture becomes a tree of rigid bodies on small coordinates u (hinges, slides), each a screw in the base frame:
a body moves with the screws on its path, M = Σ Jᵀ M_b J, and gravity stiffness is the exact Hessian of the
potential. Rotors are held unless the servo is soft.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import eig
from scipy.special import ndtr

from tools.truth.chain import (
    Array,
    Chain,
    Link,
    constant_transform,
    cross,
    inertia_from,
    second_moments,
    skew,
    symmetric,
)
from tools.truth.effects import Effect, TruthError
from tools.truth.laws import Complex, JointLaw, frequency_term, joint_law

AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


@dataclass(frozen=True)
class Structure:
    """The robot about one posture. n coordinates, `names` such as `joint1.z`; nb bodies.

    `screws` (n, 6): angular and linear velocity of the point at the world's origin, per unit rate. `zones`: the
    parts of each link that move as one, from its near end.
    `dynamic`: for each coordinate with a frequency-dependent stiffness, s ↦ stiffness added (s = σ + iω, ω > 0).
    `laws`: nonlinear joint torques by coordinate. `preload` (n,): torque that the spring carries at rest.
    """

    names: tuple[str, ...]
    screws: Array
    mass: Array
    damping: Array
    stiffness: Array
    preload: Array
    zones: tuple[tuple["Zone", ...], ...]
    dynamic: dict[int, tuple[Callable[[Complex], Complex], ...]] = field(default_factory=dict)
    laws: dict[int, JointLaw] = field(default_factory=dict)

    def modes(self) -> tuple[Array, Array, Complex]:
        """Undamped-order frequencies Hz (n,), damping ratios (n,) and shapes (n, n) of the oscillatory modes."""
        n = len(self.names)
        inverse = np.linalg.inv(self.mass)
        zero, one = np.zeros((n, n)), np.eye(n)
        roots, vectors = eig(np.block([[zero, one], [-inverse @ self.stiffness, -inverse @ self.damping]]))
        keep = np.flatnonzero(roots.imag > 0)
        keep = keep[np.argsort(abs(roots[keep]))]
        return abs(roots[keep]) / (2 * np.pi), -roots[keep].real / abs(roots[keep]), vectors[:n, keep]

    def row(self, body: str, position: Array, direction: Array) -> Array:
        """Displacement (n,) of one point along a direction, as `rows` has it."""
        return self.rows([body], np.asarray(position)[None], np.asarray(direction)[None])[0]

    def rows(self, bodies: Sequence[str], positions: Array, directions: Array) -> Array:
        """Displacement (m, n) of points along directions (m, 3), both in their body's frame, per unit of coordinate."""
        felt = np.zeros((len(bodies), len(self.names)))
        on = [k for k, body in enumerate(bodies) if body != "base"]
        if not on:
            return felt
        parts = [self.zones[int(bodies[k].removeprefix("link")) - 1] for k in on]
        frames = [_carrier(zones, positions[k]) for k, zones in zip(on, parts, strict=True)]
        turn, origin = np.array([f.turn for f in frames]), np.array([f.origin for f in frames])
        place = origin + np.einsum("mij,mj->mi", turn, positions[on])
        along = np.einsum("mij,mj->mi", turn, directions[on])
        carried = np.zeros((len(on), len(self.names)))
        for row, frame in zip(carried, frames, strict=True):
            row[list(frame.path)] = 1
        # (v + ω × r)·d = v·d + ω·(r × d)
        felt[on] = carried * (along @ self.screws[:, 3:].T + cross(place, along) @ self.screws[:, :3].T)
        return felt

    def receptance(self, s: Complex, response: Array, excitation: Array) -> Complex:
        """Displacement per force (nf, nr, ne) at s = σ + iω (nf,), for rows (nr, n) and (ne, n)."""
        z = self.mass * s[:, None, None] ** 2 + self.damping * s[:, None, None] + self.stiffness
        for i, terms in self.dynamic.items():
            z[:, i, i] += sum(term(s) for term in terms)
        # Z is symmetric, so that three responses cost three right-hand sides, whatever the number of hits.
        return np.linalg.solve(z, response.T[None]).swapaxes(-1, -2) @ excitation.T

    def tangent(self) -> "Structure":
        """The linear structure that the nonlinear one becomes at vanishing amplitude."""
        k, c = self.stiffness.copy(), self.damping.copy()
        for i, law in self.laws.items():
            dk, dc = law.tangent(self.preload[i])
            k[i, i] += dk
            c[i, i] += dc
        return replace(self, damping=c, stiffness=k, laws={})


class Frame(NamedTuple):
    """A body's axes (3, 3) and origin in the base frame, and the coordinates on its path."""

    turn: Array
    origin: Array
    path: tuple[int, ...]


class Zone(NamedTuple):
    """The part of a link up to `end` along a unit vector of its frame that moves as one body."""

    end: float
    frame: Frame
    along: Array


def _carrier(zones: Sequence[Zone], position: Array) -> Frame:
    """What carries a point of a link."""
    return next(zone.frame for zone in zones if position @ zone.along < zone.end)


class _Builder:
    """Collects coordinates and bodies along the chain, in base axes, at given rest deflections."""

    def __init__(self, rest: dict[str, float]) -> None:
        self.rest = rest
        self.names: list[str] = []
        self.screws: list[Array] = []
        self.springs: list[tuple[float, float, float]] = []  # stiffness, damping, armature
        self.bodies: list[tuple[Link, Frame]] = []
        self.dynamic: dict[int, list[Callable[[Complex], Complex]]] = {}
        self.drag: dict[tuple[int, int], float] = {}

    def hinge(
        self,
        frame: Frame,
        name: str,
        axis: Array,
        k: float,
        c: float,
        *,
        at: Array | None = None,
        armature: float = 0.0,
    ) -> Frame:
        """The frame behind a hinge about `axis` of `frame` through the point `at` of it."""
        direction = frame.turn @ axis
        point = frame.origin if at is None else frame.origin + frame.turn @ at
        path = self._add(frame, name, np.concatenate([direction, cross(point, direction)]), (k, c, armature))
        if not self.rest.get(name):
            return Frame(frame.turn, frame.origin, path)
        turn = rotation_about(direction, self.rest[name])
        return Frame(turn @ frame.turn, point + turn @ (frame.origin - point), path)

    def slide(self, frame: Frame, name: str, axis: Array, k: float, c: float) -> Frame:
        """The frame behind a slide along `axis` of `frame`."""
        direction = frame.turn @ axis
        path = self._add(frame, name, np.concatenate([np.zeros(3), direction]), (k, c, 0.0))
        return Frame(frame.turn, frame.origin + direction * self.rest.get(name, 0.0), path)

    def _add(self, frame: Frame, name: str, screw: Array, spring: tuple[float, float, float]) -> tuple[int, ...]:
        self.names.append(name)
        self.screws.append(screw)
        self.springs.append(spring)
        return (*frame.path, len(self.names) - 1)

    def matrices(self, g: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Screws (n, 6), M, C, K (n, n) and the load on the springs (n,) under gravity g (3,)."""
        n = len(self.names)
        screws, springs = np.array(self.screws).reshape(n, 6), np.array(self.springs).reshape(n, 3)
        path = np.zeros((len(self.bodies), n, 1))
        for row, (_, frame) in zip(path, self.bodies, strict=True):
            row[list(frame.path)] = 1
        masses = np.array([link.mass for link, _ in self.bodies])
        coms = np.array([frame.origin + frame.turn @ link.com for link, frame in self.bodies])
        inertias = np.array([frame.turn @ link.inertia @ frame.turn.T for link, frame in self.bodies])
        jw = screws[None, :, :3] * path
        jv = (screws[None, :, 3:] + cross(screws[None, :, :3], coms[:, None])) * path
        mass = np.einsum("b,bik,bjk->ij", masses, jv, jv) + np.einsum("bik,bkl,bjl->ij", jw, inertias, jw)
        # Potential −Σ m g·p: its gradient is the load on the springs, its Hessian the gravity stiffness. For i at
        # or inboard of j on a path, ∂²p/∂u_i∂u_j = ω_i × ∂p/∂u_j.
        weight = masses[:, None] * g
        swing = cross(jw[:, :, None], jv[:, None])
        upper = np.triu(-np.einsum("bk,bijk->ij", weight, swing))
        gravity = upper + np.triu(upper, 1).T
        k, c, armature = (np.diag(column) for column in springs.T)
        for (i, j), drag in self.drag.items():
            c[[i, j], [j, i]] = drag
        return screws, mass + armature, c, k + gravity, np.einsum("bk,bjk->j", weight, jv)


def rotation_about(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    if not angle:
        return np.eye(3)
    turning = skew(axis)
    return np.eye(3) + np.sin(angle) * turning + (1 - np.cos(angle)) * turning @ turning


def assemble(
    chain: Chain,
    q: Array,
    effects: tuple[Effect, ...] = (),
    *,
    brakes_on: bool = False,
    sag: bool = True,
) -> Structure:
    """The structure at commanded angles q (n,) rad.

    With `sag` the robot rests where its springs carry its weight (rotors where the controller put them); without,
    the commanded posture is the equilibrium (spring references adjusted) and the weight still enters the stiffness.
    Brakes rule the servo out.
    """
    structure = _assemble(chain, q, effects, brakes_on, {})
    if not sag:
        return structure
    deflection = np.linalg.solve(structure.stiffness, structure.preload)
    for i, law in structure.laws.items():
        deflection[i] = law.rest(structure.preload[i])
    rest = {name: u for name, u in zip(structure.names, deflection, strict=True) if not name.startswith("servo")}
    return _assemble(chain, q, effects, brakes_on, rest)


def _assemble(
    chain: Chain, q: Array, effects: tuple[Effect, ...], brakes_on: bool, rest: dict[str, float]
) -> Structure:
    builder = _Builder(rest)
    stiffness, damping = joint_springs(chain, q, effects)
    frame, ends = _base(builder, effects), chain.ends()
    zones: list[list[Zone]] = []
    for i in range(chain.n):
        placement, offset = constant_transform(*chain.dh[i])
        zero = sum(e["angle"] for e in effects if e.kind == "joint_offset" and e.joint == i)
        turn = frame.turn @ placement @ rotation_about(AXES["z"], q[i] + zero)
        frame = Frame(turn, frame.origin + frame.turn @ offset, frame.path)
        if not brakes_on:
            frame = _servo(builder, frame, chain, i, effects)
        cross = sum(e["stiffness"] for e in effects if e.kind == "cross_stiffness" and e.joint == i)
        for a, axis in enumerate("zxy"):
            if np.isfinite(stiffness[i, a]) and not (a and cross):
                frame = builder.hinge(frame, f"joint{i + 1}.{axis}", AXES[axis], stiffness[i, a], damping[i, a])
        if cross:
            frame = _oblique(builder, frame, i, stiffness[i, 1:], damping[i, 1:], cross)
        zones.append(_link(builder, frame, chain, i, effects, ends[i]))
        frame = zones[i][-1].frame
        _resonators(builder, zones[i], i, effects)

    index = {name: i for i, name in enumerate(builder.names)}
    laws: dict[int, JointLaw] = {}
    for e in effects:
        term, law = frequency_term(e, stiffness), joint_law(e, stiffness)
        if (term or law) and e.site not in index:
            raise TruthError(f"{e.kind}@{e.site}: expected a site that is soft in this robot; {e.site} is rigid")
        if term:
            builder.dynamic.setdefault(index[e.site], []).append(term)
        if law:
            if index[e.site] in laws:
                raise TruthError(f"{e.kind}@{e.site}: expected one nonlinear effect at a joint; this is the second")
            laws[index[e.site]] = law

    screws, m, c, k, load = builder.matrices(chain.gravity)
    dynamic = {i: tuple(terms) for i, terms in builder.dynamic.items()}
    return Structure(tuple(builder.names), screws, m, c, k, load, tuple(tuple(z) for z in zones), dynamic, laws)


def _base(builder: _Builder, effects: tuple[Effect, ...]) -> Frame:
    frame = Frame(np.eye(3), np.zeros(3), ())
    for name in ("x", "y", "z", "rx", "ry", "rz"):
        for e in effects:
            if e.kind == "base_compliance" and e.axis == name:
                joint = builder.slide if len(name) == 1 else builder.hinge
                frame = joint(frame, e.site, AXES[name[-1]], e["stiffness"], e["damping"])
    for e in effects:
        if e.kind == "floor_mode":
            frame = _floor(builder, frame, e)
    return frame


def _floor(builder: _Builder, frame: Frame, e: Effect) -> Frame:
    """A slab under the robot's foot, a body of its own on springs; every spring has the same damping ratio."""
    for name in ("x", "y", "z", "rx", "ry", "rz"):
        if name in e.parameters:
            moved = e["mass"] if len(name) == 1 else e.array("inertia")["xyz".index(name[1])]
            c = 2 * e["damping_ratio"] * np.sqrt(e[name] * moved)
            joint = builder.slide if len(name) == 1 else builder.hinge
            frame = joint(frame, f"floor.{name}", AXES[name[-1]], e[name], c)
    builder.bodies.append((Link(e["mass"], np.zeros(3), np.diag(e.array("inertia"))), frame))
    return frame


def _oblique(builder: _Builder, frame: Frame, i: int, k: Array, c: Array, cross: float) -> Frame:
    """A bearing that tilts about two principal axes, oblique to the link's x and y: k (2,), c (2,) about those."""
    own, axes = np.linalg.eigh(np.diag(k) + cross * np.array([[0.0, 1.0], [1.0, 0.0]]))
    if not own[0] > 0:
        raise TruthError(f"cross_stiffness@joint{i + 1}: expected less than what both springs hold, {cross:g}")
    drag = axes.T @ np.diag(c) @ axes
    for name, value, axis, d in zip("xy", own, axes.T, np.diag(drag), strict=True):
        frame = builder.hinge(frame, f"joint{i + 1}.{name}", np.append(axis, 0.0), value, d)
    builder.drag[frame.path[-2], frame.path[-1]] = drag[0, 1]
    return frame


def _servo(builder: _Builder, frame: Frame, chain: Chain, i: int, effects: tuple[Effect, ...]) -> Frame:
    """A rotor on its servo spring, N²J about the joint's axis; with `integral_time` a PI loop, stiff when slow."""
    for e in effects:
        if e.kind != "servo_compliance" or e.joint != i:
            continue
        rotor = e["inertia"] if "inertia" in e.parameters else chain.gear_ratio[i] ** 2 * chain.rotor_inertia[i]
        frame = builder.hinge(frame, f"servo{i + 1}", AXES["z"], e["stiffness"], e["damping"], armature=rotor)
        if "integral_time" in e.parameters:
            rate = e["stiffness"] / e["integral_time"]
            builder.dynamic.setdefault(frame.path[-1], []).append(lambda s, rate=rate: rate / s)  # type: ignore[misc]
    return frame


def _link(builder: _Builder, frame: Frame, chain: Chain, i: int, effects: tuple[Effect, ...], end: Array) -> list[Zone]:
    """The link's bodies: one, or the parts between its bending hinges, each with the payloads placed on it.

    A link bends in one hinge half-way to the next joint, or as a beam in `segments` equal ones, each in the middle of
    a segment and as many times stiffer: a moment turns the end by the same angle. It is cut across that way.
    """
    bends: dict[float, list[tuple[Effect, int, int]]] = {}
    for e in effects:
        if e.kind == "link_flexibility" and e.joint == i:
            count = int(e.parameters.get("segments", 1))  # type: ignore[arg-type]
            for number in range(count):
                bends.setdefault((number + 0.5) / count, []).append((e, count, number))
    length = float(np.linalg.norm(end))
    if bends and not length:
        raise TruthError(f"link_flexibility@link{i + 1}: expected a length; the next joint is in its origin")
    along = end / length if length else AXES["x"]
    places = sorted(bends)
    limits = [-np.inf, *(length * place for place in places), np.inf]
    zones: list[Zone] = []
    parts = slabs(chain.links[i], limits[1:-1], along)
    for part, place, (start, stop) in zip(parts, [0.0, *places], pairwise(limits), strict=True):
        for e, count, number in bends.get(place, []):
            name = e.site + (f"#{number + 1}" if count > 1 else "")
            k, c = count * e["stiffness"], count * e["damping"]
            frame = builder.hinge(frame, name, AXES[e.axis], k, c, at=place * end)
        zones.append(Zone(stop, frame, along))
        here = [e for e in effects if e.kind == "payload" and start <= e.array("com") @ along < stop]
        builder.bodies.append((loaded(part, i, chain, here), frame))
    return zones


def _resonators(builder: _Builder, zones: list[Zone], i: int, effects: tuple[Effect, ...]) -> None:
    for e in effects:
        if e.kind == "attached_resonator" and e.joint == i:
            position, axis = e.array("position"), str(e.parameters["axis"])
            trunk = _carrier(zones, position)
            w = 2 * np.pi * e["frequency_hz"]
            k, c = e["mass"] * w**2, 2 * e["damping_ratio"] * e["mass"] * w
            frame = builder.slide(trunk, f"resonator@{e.site}.{axis}", AXES[axis], k, c)
            builder.bodies.append((Link(e["mass"], position, np.zeros((3, 3))), frame))


def joint_springs(chain: Chain, q: Array, effects: tuple[Effect, ...]) -> tuple[Array, Array]:
    """Hinge stiffness and damping (n, 3), in the order z, x, y, with the effects that are mere numbers."""
    k, c = chain.stiffness.copy(), chain.damping.copy()
    for e in effects:
        if e.kind == "transverse_compliance":
            place = e.joint, "zxy".index(e.axis)
            k[place], c[place] = e["stiffness"], e["damping"]
        elif e.kind == "posture_stiffness":
            k[e.joint, 0] *= 1 + e["amplitude"] * np.sin(q[1] + e["phase"])
        elif e.kind == "structural_damping" and "damping" in e.parameters:
            c[e.joint, "zxy".index(e.axis)] = e["damping"]
    return k, c


def loaded(link: Link, i: int, chain: Chain, payloads: list[Effect]) -> Link:
    """Link i (or its part) with the payloads that it carries."""
    for e in payloads:
        if (chain.n - 1 if e.site == "flange" else e.joint) == i:
            own = e.array("inertia") if "inertia" in e.parameters else np.zeros(6)
            own = symmetric(*np.pad(own, (0, 6 - own.size)))
            link = body_of(moments_of(link) + moments_of(Link(e["mass"], e.array("com"), own)))
    return link


def moments_of(link: Link) -> Array:
    """∫ (1, r)(1, r)ᵀ dm, (4, 4), about the frame's origin: bodies add by it."""
    r = np.append(1.0, link.com)
    moments = link.mass * np.outer(r, r)
    moments[1:, 1:] += second_moments(link.inertia)
    return moments


def body_of(moments: Array) -> Link:
    mass, com = moments[0, 0], moments[0, 1:] / moments[0, 0]
    return Link(mass, com, inertia_from(moments[1:, 1:] - mass * np.outer(com, com)))


def slabs(link: Link, heights: list[float], normal: Array) -> list[Link]:
    """The parts of a link between planes at heights (rising) along their normal, from the near end.

    The link's mass is spread as the normal density with its mass, centre of mass and inertia, and cut there: the
    parts add up to the link exactly, and each is a physical body.
    """
    if not heights:
        return [link]
    beyond = [moments_of(link)]
    spread = second_moments(link.inertia) / link.mass
    deviation = float(np.sqrt(normal @ spread @ normal))
    along = spread @ normal / deviation
    for height in heights:
        depth = (height - normal @ link.com) / deviation
        share = ndtr(-depth)
        mills = np.exp(-(depth**2) / 2) / np.sqrt(2 * np.pi) / share
        second = spread - np.outer(along, along) * mills * (mills - depth)
        beyond.append(
            moments_of(Link(share * link.mass, link.com + mills * along, inertia_from(share * link.mass * second)))
        )
    return [body_of(near - far) for near, far in pairwise([*beyond, np.zeros((4, 4))])]
