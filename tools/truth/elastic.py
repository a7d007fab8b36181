"""The flexible robot about a posture: M, C, K, modes and FRFs, with any structural effect in its truth.

A posture becomes a tree of rigid bodies on small coordinates u (hinges, slides), each a screw in the base frame:
a body moves with the screws on its path, M = Σ Jᵀ M_b J, and gravity stiffness is the exact Hessian of the
potential. Rotors are held unless the servo is soft.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig
from scipy.special import ndtr

from tools.truth.chain import (
    GRAVITY,
    Array,
    Chain,
    Link,
    constant_transform,
    inertia_from,
    second_moments,
    symmetric,
)
from tools.truth.effects import Effect, TruthError
from tools.truth.laws import Complex, JointLaw, frequency_term, joint_law

AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


@dataclass(frozen=True)
class Point:
    """A place on the robot: world position and direction, and the coordinates that move it (mask)."""

    position: Array
    direction: Array
    path: NDArray[np.bool_]


@dataclass(frozen=True)
class Structure:
    """The robot about one posture. n coordinates, `names` such as `joint1.z`; nb bodies.

    `screws` (n, 6): angular and linear velocity of the point at the world's origin, per unit rate. `path` (nb, n).
    `dynamic`: for each coordinate with a frequency-dependent stiffness, s ↦ stiffness added (s = σ + iω, ω > 0).
    `laws`: nonlinear joint torques by coordinate. `preload` (n,): torque that the spring carries at rest.
    """

    names: tuple[str, ...]
    screws: Array
    path: NDArray[np.bool_]
    mass: Array
    damping: Array
    stiffness: Array
    preload: Array
    locate: Callable[[str, Array, Array], Point]
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

    def row(self, point: Point) -> Array:
        """Displacement of a point along its direction per unit of every coordinate, (n,)."""
        moved = self.screws[:, 3:] + np.cross(self.screws[:, :3], point.position)
        return moved @ point.direction * point.path

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
        return Structure(self.names, self.screws, self.path, self.mass, c, k, self.preload, self.locate, self.dynamic)


class _Builder:
    """Collects coordinates and bodies along the chain, in world axes, at given rest deflections."""

    def __init__(self, rest: dict[str, float]) -> None:
        self.rest = rest
        self.names: list[str] = []
        self.screws: list[Array] = []
        self.k: list[float] = []
        self.c: list[float] = []
        self.armature: list[float] = []
        self.turn, self.origin = np.eye(3), np.zeros(3)
        self.path: list[int] = []
        self.bodies: list[tuple[float, Array, Array, list[int]]] = []

    def coordinate(
        self, name: str, axis: Array, k: float, c: float, *, at: Array | None = None, slide=False, armature=0.0
    ) -> int:
        """A hinge (or slide) about `axis` of the present frame through the point `at` of it."""
        direction = self.turn @ axis
        point = self.origin + self.turn @ (np.zeros(3) if at is None else at)
        screw = np.concatenate([np.zeros(3), direction] if slide else [direction, np.cross(point, direction)])
        u = self.rest.get(name, 0.0)
        if slide:
            self.origin = self.origin + direction * u
        elif u:
            r = rotation_about(direction, u)
            self.turn, self.origin = r @ self.turn, point + r @ (self.origin - point)
        self.path = [*self.path, len(self.names)]
        self.names.append(name)
        self.screws.append(screw)
        self.k.append(k)
        self.c.append(c)
        self.armature.append(armature)
        return len(self.names) - 1

    def body(self, link: Link) -> None:
        if link.mass > 0:
            inertia = self.turn @ link.inertia @ self.turn.T
            self.bodies.append((link.mass, self.origin + self.turn @ link.com, inertia, self.path))


def rotation_about(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def assemble(
    chain: Chain,
    q: Array,
    effects: tuple[Effect, ...] = (),
    *,
    brakes_on: bool = False,
    sag: bool = True,
) -> Structure:
    """The structure at commanded angles q (n,) rad.

    With `sag` the robot rests where its springs carry its weight; without, the commanded posture is the
    equilibrium (spring references adjusted) and the weight still enters the stiffness. Brakes rule the servo out.
    """
    structure = _assemble(chain, q, effects, brakes_on, {})
    if not sag:
        return structure
    deflection = np.linalg.solve(structure.stiffness, structure.preload)
    for i, law in structure.laws.items():
        deflection[i] = law.rest(structure.preload[i])
    return _assemble(chain, q, effects, brakes_on, dict(zip(structure.names, deflection, strict=True)))


def _assemble(
    chain: Chain, q: Array, effects: tuple[Effect, ...], brakes_on: bool, rest: dict[str, float]
) -> Structure:
    b = _Builder(rest)
    by_kind: dict[str, list[Effect]] = {}
    for e in effects:
        by_kind.setdefault(e.kind, []).append(e)
    stiffness, damping = joint_springs(chain, q, effects)

    for name in ("x", "y", "z", "rx", "ry", "rz"):
        for e in by_kind.get("base_compliance", []):
            if e.axis == name:
                slide = len(name) == 1
                b.coordinate(e.site, AXES[name[-1]], e["stiffness"], e["damping"], slide=slide)

    inboard: list[tuple[Array, Array, list[int]]] = []  # frame and path of each link's near and far part
    outboard: list[tuple[Array, Array, list[int]]] = []
    dynamic: dict[int, list[Callable[[Complex], Complex]]] = {}
    ends = chain.ends()
    for i in range(chain.n):
        placement, offset = constant_transform(*chain.dh[i])
        b.origin, b.turn = b.origin + b.turn @ offset, b.turn @ placement @ rotation_about(AXES["z"], q[i])
        for e in by_kind.get("servo_compliance", []):
            if e.joint == i and not brakes_on:
                rotor = e.parameters.get("inertia", chain.gear_ratio[i] ** 2 * chain.rotor_inertia[i])
                soft = b.coordinate(f"servo{i + 1}", AXES["z"], e["stiffness"], e["damping"], armature=float(rotor))
                if "integral_time" in e.parameters:  # cascade servo: PI in the loop, stiff when slow
                    dynamic.setdefault(soft, []).append(lambda s, k=e["stiffness"], t=e["integral_time"]: k / (t * s))
        for a, axis in enumerate("zxy"):
            if np.isfinite(stiffness[i, a]):
                b.coordinate(f"joint{i + 1}.{axis}", AXES[axis], stiffness[i, a], damping[i, a])
        link = loaded(chain.links[i], i, chain, by_kind.get("payload", []))
        bends = [e for e in by_kind.get("link_flexibility", []) if e.joint == i]
        middle = ends[i] / 2
        near, far = cut(link, AXES["x"], middle[0]) if bends else (link, link)
        inboard.append((b.turn, b.origin, b.path))
        b.body(near)
        if bends:
            for e in bends:
                b.coordinate(e.site, AXES[e.axis], e["stiffness"], e["damping"], at=middle)
            b.body(far)
        outboard.append((b.turn, b.origin, b.path))
        for e in by_kind.get("attached_resonator", []):
            if e.joint == i:
                position = e.array("position")
                trunk = (b.turn, b.origin, b.path)
                if bends and position[0] < middle[0]:
                    b.turn, b.origin, b.path = inboard[i]
                w = 2 * np.pi * e["frequency_hz"]
                b.coordinate(
                    f"resonator@{e.site}.{e.parameters['axis']}",
                    AXES[str(e.parameters["axis"])],
                    e["mass"] * w**2,
                    2 * e["damping_ratio"] * e["mass"] * w,
                    slide=True,
                )
                b.body(Link(e["mass"], position, np.zeros((3, 3))))
                b.turn, b.origin, b.path = trunk

    n = len(b.names)
    screws = np.array(b.screws).reshape(n, 6)
    path = np.zeros((len(b.bodies), n), bool)
    for row, (_, _, _, indices) in zip(path, b.bodies, strict=True):
        row[indices] = True
    masses = np.array([body[0] for body in b.bodies])
    coms = np.array([body[1] for body in b.bodies])
    inertias = np.array([body[2] for body in b.bodies])
    jw = screws[None, :, :3] * path[:, :, None]
    jv = (screws[None, :, 3:] + np.cross(screws[None, :, :3], coms[:, None])) * path[:, :, None]
    mass = np.einsum("b,bik,bjk->ij", masses, jv, jv) + np.einsum("bik,bkl,bjl->ij", jw, inertias, jw)
    mass += np.diag(b.armature)
    # Potential −Σ m g·p: its gradient is the load on the springs, its Hessian the gravity stiffness. For i at or
    # inboard of j on a path, ∂²p/∂u_i∂u_j = ω_i × ∂p/∂u_j.
    weight = masses[:, None] * GRAVITY
    load = np.einsum("bk,bjk->j", weight, jv)
    swing = np.cross(screws[None, :, None, :3], jv[:, None, :, :]) * path[:, :, None, None]
    upper = np.triu(-np.einsum("bk,bijk->ij", weight, swing))
    hessian = upper + np.triu(upper, 1).T

    index = {name: i for i, name in enumerate(b.names)}
    laws: dict[int, JointLaw] = {}
    for e in effects:
        term, law = frequency_term(e, stiffness), joint_law(e, stiffness)
        if (term or law) and e.site not in index:
            raise TruthError(f"{e.kind}@{e.site}: expected a site that is soft in this robot; {e.site} is rigid")
        if term:
            dynamic.setdefault(index[e.site], []).append(term)
        if law:
            if index[e.site] in laws:
                raise TruthError(f"{e.kind}@{e.site}: expected one nonlinear effect at a joint; this is the second")
            laws[index[e.site]] = law

    def locate(body: str, position: Array, direction: Array) -> Point:
        if body == "base":
            return Point(position, direction, np.zeros(n, bool))
        i = int(body.removeprefix("link")) - 1
        turn, origin, indices = (inboard if position[0] < ends[i][0] / 2 else outboard)[i]
        moved = np.zeros(n, bool)
        moved[indices] = True
        return Point(origin + turn @ position, turn @ direction, moved)

    return Structure(
        tuple(b.names),
        screws,
        path,
        mass,
        np.diag(b.c),
        np.diag(b.k) + hessian,
        load,
        locate,
        {i: tuple(terms) for i, terms in dynamic.items()},
        laws,
    )


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
    """The link with the payloads that it carries."""
    for e in payloads:
        if (chain.n - 1 if e.site == "flange" else e.joint) != i:
            continue
        own = np.zeros((3, 3))
        if "inertia" in e.parameters:
            own = symmetric(*np.pad(e.array("inertia"), (0, 6 - e.array("inertia").size)))
        link = merge(link, Link(e["mass"], e.array("com"), own))
    return link


def merge(a: Link, b: Link) -> Link:
    mass = a.mass + b.mass
    apart = a.com - b.com
    reduced = a.mass * b.mass / mass
    inertia = a.inertia + b.inertia + inertia_from(reduced * np.outer(apart, apart))
    return Link(mass, (a.mass * a.com + b.mass * b.com) / mass, inertia)


def cut(link: Link, normal: Array, height: float) -> tuple[Link, Link]:
    """The two parts of a link on either side of the plane normal·r = height.

    The link's mass is spread as the normal density with its mass, centre of mass and inertia, and cut there: the
    parts add up to the link exactly, and each is a physical body.
    """
    moments = second_moments(link.inertia) / link.mass
    along = moments @ normal
    variance = normal @ along
    depth = (height - normal @ link.com) / np.sqrt(variance)
    density = np.exp(-(depth**2) / 2) / np.sqrt(2 * np.pi)
    parts = []
    for sign in (-1.0, 1.0):
        share = ndtr(-sign * depth)
        mills = density / share
        com = link.com + sign * mills * along / np.sqrt(variance)
        spread = moments - np.outer(along, along) / variance * mills * (mills - sign * depth)
        parts.append(Link(share * link.mass, com, inertia_from(share * link.mass * spread)))
    return parts[0], parts[1]
