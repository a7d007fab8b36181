"""The rigid chain: description, kinematics, inverse dynamics and mass matrix, and its random perturbation.

Everything is written in the base frame (Kane's equations: forces on every body projected on its partial
velocities), vectorised over leading axes of `q`. SI and radians.
"""

from dataclasses import dataclass, field, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Link:
    """mass kg; com (3,) m in the link frame; inertia (3, 3) kg·m² at the centre of mass, link axes."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Chain:
    """A serial chain of revolute joints, placed by modified (Craig) Denavit–Hartenberg parameters.

    `dh` (n, 3): a_{i-1}, α_{i-1}, d_i. `stiffness`, `damping` (n, 3): hinges of joint i about z, x, y of link i's
    frame (infinite stiffness: no such hinge). `viscous`, `coulomb` (n,): friction at the gear output.
    `compensator` (n, 3): B_l of Σ B_l cos(l q). `limits` (n, 3): |q| bounds are `range_` (n, 2), speed and
    acceleration bounds (n,). `workspace` (3, 2): bounds of the flange point.
    `gravity` (3,) m/s² in the frame of the robot's foot.
    """

    dh: Array
    links: tuple[Link, ...]
    flange: Array
    gear_ratio: Array
    rotor_inertia: Array
    stiffness: Array
    damping: Array
    viscous: Array
    coulomb: Array
    compensator: Array
    range_: Array
    speed: Array
    acceleration: Array
    workspace: Array
    gravity: Array = field(default_factory=GRAVITY.copy)

    @property
    def n(self) -> int:
        return len(self.links)

    def ends(self) -> Array:
        """Point (n, 3) of each link, in its frame, where the next joint (for the last link, the flange) sits."""
        placements = [constant_transform(*row) for row in self.dh[1:]]
        return np.array([p for _, p in placements] + [self.flange])


def symmetric(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> Array:
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def kr90() -> Chain:
    """KUKA KR90 R3100, first three axes (Huynh et al. 2020, Tables 1, 2, 5, 6, A1).

    Table 5's inertias are at the centres of mass. Assumed, because the paper does not give them: N₃ = 250 and
    friction of Table A1 read as motor-side values times the gear ratio.
    """
    ratio = np.array([256.5, 266.6, 250.0])
    return Chain(
        dh=np.array([[0.0, 0.0, 0.675], [0.35, pi / 2, 0.0], [1.35, 0.0, 0.0]]),
        links=(
            Link(512.0, np.array([-0.02, 0.0, -0.21]), symmetric(15.4, 30.9, 30.2, 1.9, 0.9, 0.4)),
            Link(249.0, np.array([0.53, 0.0, 0.25]), symmetric(80.0, 150.6, 150.8, -1.1, 0.5, -0.1)),
            Link(223.0, np.array([0.42, 0.02, -0.02]), symmetric(45.9, 125.9, 125.9, -1.4, 0.1, -1.2)),
        ),
        flange=np.array([1.615, -0.041, 0.0]),
        gear_ratio=ratio,
        rotor_inertia=np.full(3, 0.0113),
        stiffness=np.array([[5.0e6, 6.1e6, 11.9e6], [6.9e6, 11.8e6, 8.1e6], [2.8e6, 5.2e6, 12.0e6]]),
        damping=np.array([[20.0, 40.0, 3100.0], [2400.0, 40.0, 9400.0], [200.0, 9200.0, 80.0]]),
        viscous=ratio * [5.4, 5.0, 3.7],
        coulomb=ratio * [1.2, 1.4, 0.9],
        compensator=np.array([[0.0, 0.0, 0.0], [-7938.0, -72.8, 257.1], [0.0, 0.0, 0.0]]),
        range_=np.array([[-3.23, 3.23], [0.09, 2.44], [-2.7, 2.1]]),
        speed=np.array([1.83, 1.76, 1.87]),
        acceleration=np.array([8.0, 8.0, 8.0]),
        workspace=np.array([[-1.5, 2.6], [-1.6, 1.4], [0.5, 2.5]]),
    )


POSTURES_DEG: dict[str, tuple[float, ...]] = {
    "milling": (0.0, 70.0, -100.0),
    "upright": (0.0, 135.0, -100.0),
    "rigid": (0.0, 135.0, -140.0),
}


def constant_transform(a: float, alpha: float, d: float) -> tuple[Array, Array]:
    """Rotation and origin of link i's frame in link i-1's at q_i = 0: Rot_x(α) Trans_x(a) Trans_z(d)."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]), np.array([a, -s * d, c * d])


def frames(chain: Chain, q: Array) -> tuple[Array, Array]:
    """Rotations (..., n, 3, 3) and origins (..., n, 3) of the link frames in the base frame, for q (..., n)."""
    q = np.asarray(q, float)
    rotation = np.empty((*q.shape, 3, 3))
    origin = np.empty((*q.shape, 3))
    r, p = np.eye(3), np.zeros(3)
    for i, row in enumerate(chain.dh):
        placement, offset = constant_transform(*row)
        p = p + r @ offset
        fixed = r @ placement
        c, s = np.cos(q[..., i, None]), np.sin(q[..., i, None])
        x, y = fixed[..., 0], fixed[..., 1]
        r = np.stack([c * x + s * y, c * y - s * x, np.broadcast_to(fixed[..., 2], (*q.shape[:-1], 3))], -1)
        rotation[..., i, :, :], origin[..., i, :] = r, p
    return rotation, origin


def flange_position(chain: Chain, q: Array) -> Array:
    rotation, origin = frames(chain, q)
    return origin[..., -1, :] + rotation[..., -1, :, :] @ chain.flange


def mass_matrix(chain: Chain, q: Array) -> Array:
    """Links' mass matrix (..., n, n), Σ_b m Jᵥᵀ Jᵥ + Jωᵀ I Jω; the rotors' N²J is not in it."""
    rotation, origin = frames(chain, q)
    axis = rotation[..., 2]
    m = np.zeros((*np.shape(q), chain.n))
    for b, link in enumerate(chain.links):
        turn = rotation[..., b, :, :]
        com = origin[..., b, :] + turn @ link.com
        jv = cross(axis[..., : b + 1, :], com[..., None, :] - origin[..., : b + 1, :])
        jw = axis[..., : b + 1, :] @ turn
        m[..., : b + 1, : b + 1] += link.mass * jv @ jv.swapaxes(-1, -2) + jw @ link.inertia @ jw.swapaxes(-1, -2)
    return m


def inverse_dynamics(chain: Chain, q: Array, v: Array, a: Array, gravity: Array = GRAVITY) -> Array:
    """Joint torques (..., n) of the links alone (no rotor, friction, compensator) for q, q̇, q̈ (..., n)."""
    rotation, origin = frames(chain, q)
    tau = np.zeros(np.shape(q))
    w = np.zeros((*np.shape(q)[:-1], 3))  # angular velocity, angular and origin's linear acceleration of link b
    dw, acc, previous = w, w, np.zeros(3)
    loads: list[tuple[Array, Array]] = []  # force on each link, and moment about its frame's origin
    for b, link in enumerate(chain.links):
        z, turn, p = rotation[..., b, :, 2], rotation[..., b, :, :], origin[..., b, :]
        acc = acc + accelerate(w, dw, p - previous)
        rate = z * v[..., b, None]
        dw = dw + z * a[..., b, None] + cross(w, rate)
        w = w + rate
        previous = p
        arm = turn @ link.com
        force = link.mass * (acc + accelerate(w, dw, arm) - gravity)
        turn_t = turn.swapaxes(-1, -2)
        w_body, dw_body = (turn_t @ w[..., None])[..., 0], (turn_t @ dw[..., None])[..., 0]
        moment_body = dw_body @ link.inertia + cross(w_body, w_body @ link.inertia)
        loads.append((force, (turn @ moment_body[..., None])[..., 0] + cross(arm, force)))
    force, moment = loads[-1]
    for j in range(chain.n - 1, -1, -1):
        tau[..., j] = (rotation[..., j, :, 2] * moment).sum(-1)
        if j:
            moment = moment + cross(origin[..., j, :] - origin[..., j - 1, :], force) + loads[j - 1][1]
            force = force + loads[j - 1][0]
    return tau


def cross(a: Array, b: Array) -> Array:
    """a × b over the last axis (..., 3): numpy's own takes ten times as long for short arrays."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0], out[..., 1], out[..., 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out


def skew(a: Array) -> Array:
    """The matrix (3, 3) of a ×."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def accelerate(w: Array, dw: Array, arm: Array) -> Array:
    """Acceleration of a point at `arm` relative to the frame's origin, ω̇ × r + ω × (ω × r)."""
    return cross(dw, arm) + cross(w, cross(w, arm))


@dataclass(frozen=True)
class Tolerances:
    """How far the truth lies from the description. Every draw is uniform (ratios: uniform in the logarithm).

    Ratios multiply or divide: stiffness 1.3 is a factor in [1/1.3, 1.3]. Dampings below `poor_damping` are known
    to `damping_poor` only. Inertia: the second moments at the centre of mass are stretched along three random
    directions, so that the body stays physical. `posture_deg` and `gain` belong to a recording.
    """

    stiffness: float = 1.3
    damping: float = 2.0
    damping_poor: float = 10.0
    poor_damping: float = 150.0
    mass: float = 0.03
    com: float = 0.01
    inertia: float = 0.03
    posture_deg: float = 0.2
    gain: float = 0.01
    rotor: float = 0.1
    compensator: float = 0.1
    friction: float = 1.3

    @classmethod
    def none(cls) -> "Tolerances":
        return cls(1, 1, 1, 150, 0, 0, 0, 0, 0, 0, 0, 1)


def perturb(chain: Chain, rng: np.random.Generator, tolerances: Tolerances) -> Chain:
    """The true chain: `chain` with every number drawn within `tolerances`."""
    t, n = tolerances, chain.n

    def ratio(limit: float | Array, shape: tuple[int, ...]) -> Array:
        return np.asarray(limit) ** rng.uniform(-1, 1, shape)

    poor = np.where(chain.damping < t.poor_damping, t.damping_poor, t.damping)
    return replace(
        chain,
        links=tuple(perturb_link(link, rng, t) for link in chain.links),
        stiffness=chain.stiffness * ratio(t.stiffness, (n, 3)),
        damping=chain.damping * ratio(poor, (n, 3)),
        rotor_inertia=chain.rotor_inertia * (1 + t.rotor * rng.uniform(-1, 1, n)),
        compensator=chain.compensator * (1 + t.compensator * rng.uniform(-1, 1, (n, 3))),
        viscous=chain.viscous * ratio(t.friction, (n,)),
        coulomb=chain.coulomb * ratio(t.friction, (n,)),
    )


def perturb_link(link: Link, rng: np.random.Generator, t: Tolerances) -> Link:
    mass = link.mass * (1 + t.mass * rng.uniform(-1, 1))
    com = link.com + t.com * rng.uniform(-1, 1, 3)
    directions, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    stretch = directions * np.sqrt(1 + t.inertia * rng.uniform(-1, 1, 3)) @ directions.T
    moments = stretch @ second_moments(link.inertia) @ stretch.T
    return Link(mass, com, inertia_from(moments))


def second_moments(inertia: Array) -> Array:
    """∫ r rᵀ dm from the inertia tensor, both at the same point."""
    return np.trace(inertia) / 2 * np.eye(3) - inertia


def inertia_from(moments: Array) -> Array:
    return np.trace(moments) * np.eye(3) - moments
