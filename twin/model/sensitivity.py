"""M, C, K and rows of test points about a posture in closed form, with their derivatives; FRFs and modes with theirs.

The robot about a posture is a tree of rigid bodies on small coordinates. Each coordinate is a screw (ω, v) in world
axes. Per unit rate, ω is the angular velocity and v the velocity of the point at the world's origin. With 𝓜_b the
spatial inertia of body b about that origin and S_b the screws on its path,

    M = Σ_b S_bᵀ 𝓜_b S_b,    (K_g)_jk = −g · (ω_j × W_k),  W_k = Σ_b (m_b v_k + ω_k × h_b),  j inboard of k,

h_b the first moment. Springs, dampers and inertial parameters enter linearly, and turning a commanded angle q_i, or
displacing an axis, moves everything outboard by one screw. So all their derivatives are exact. Parameters of other
physics entries are differentiated by central differences of these small matrices. ``twin.model.linear`` gives the same
matrices by MuJoCo.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import Brakes, Channels, ComplexArray, FloatArray
from twin.model.linear import state_matrix
from twin.model.parameters import Parameter, Parameters, Side
from twin.physics import CATALOGUE
from twin.physics.chain import MeasurementChain
from twin.physics.effect import Effect
from twin.robot.description import Robot
from twin.robot.frames import matrix_of
from twin.robot.mechanism import Joint, Mechanism, assemble, assemble_all
from twin.robot.mjcf import FOOT_INERTIA

CACHED = 64  # lines at a time: derivatives on more of them leave the cache of a core before they are used
TURN = 1e-6  # rad, of a direction for its derivative beyond what entries turn, in which that is linear


@dataclass(frozen=True)
class Structure:
    """A mechanism about its commanded posture; nv coordinates, nb bodies, n axes.

    Attributes:
        coordinates: (nv,) joint names, as in the MJCF.
        bodies: name → index.
        screw: (nv, 6) screws (ω, v) of the coordinates.
        inboard: (nv, nv) true where coordinate j is k or lies between the base and k.
        path: (nb, nv) the coordinates that move a body.
        rotation, origin: (nb, 3, 3) and (nb, 3), the bodies' own frames in the world.
        spatial: (nb, 6, 6) spatial inertia about the world's origin.
        command: (n, 6) screws of the commanded positions; ``moved`` (n, nb) and ``carried`` (n, nv) say which bodies
            and coordinates they move.
        load: (nv,) the weight's work per unit of every coordinate: what its spring carries at rest.
        M, C, K, loss, integral: (nv, nv) as in :class:`twin.model.linear.LinearModel`.
        strain: (nv,) stiffness of the spring on each coordinate; those of ``curved`` ones harden.
    """

    coordinates: tuple[str, ...]
    bodies: dict[str, int]
    screw: FloatArray
    inboard: FloatArray
    path: FloatArray
    rotation: FloatArray
    origin: FloatArray
    spatial: FloatArray
    command: FloatArray
    moved: FloatArray
    carried: FloatArray
    gravity: FloatArray
    load: FloatArray
    M: FloatArray
    C: FloatArray
    K: FloatArray
    loss: FloatArray
    integral: FloatArray
    strain: FloatArray
    curved: frozenset[str]
    mechanism: Mechanism

    def sag(self) -> dict[str, float]:
        """Rest deflections under the weight, rad (m); a servo holds its rotor where it should be."""
        deflection = np.linalg.solve(self.K, self.load) if self.coordinates else self.load
        return {name: float(u) for name, u in zip(self.coordinates, deflection, strict=True) if "." in name}

    def rows(self, channels: Channels, direction: FloatArray) -> FloatArray:
        """Displacement of points per unit of the coordinates, (n, nv), along directions (n, 3) in the links' frames."""
        return _rows([self], channels, direction)[0]

    def wrenches(self, channels: Channels, direction: FloatArray) -> tuple[list[int], FloatArray]:
        """The bodies of points, and unit forces (n, 6) on them along directions (n, 3) in the links' frames."""
        body, local = self.carried_points(channels)
        return body, _wrench(self.rotation[body], self.origin[body], local, direction)

    def row_slopes(self, wrenches: tuple[list[int], FloatArray], axes: Sequence[int], screws: FloatArray) -> FloatArray:
        """Derivatives (m, n, nv) of :meth:`rows` where all from zero-based axes (m,) on moves along screws (m, 6)."""
        body, wrench = wrenches
        moved = self.moved[np.ix_(axes, body)][:, :, None]
        return np.asarray(wrench @ self.turned(axes, screws).swapaxes(1, 2) * self.path[body] * moved)

    def carried_points(self, channels: Channels) -> tuple[list[int], FloatArray]:
        """The body that carries every point, and where it lies in that body's own frame (n, 3)."""
        carriers = [self.mechanism.carrier(*pair) for pair in zip(channels.body, channels.position, strict=True)]
        offset = np.array([self.mechanism.offset(carrier) for carrier in carriers]).reshape(-1, 3)
        return [self.bodies[carrier] for carrier in carriers], channels.position - offset

    def placement(self, axis: int, number: str) -> FloatArray:
        """The screw (6,) along which a number of a zero-based axis moves it: ``a``, ``alpha``, ``d`` or ``theta``.

        They place it by Rx(α) Tx(a) Rz(θ) Tz(d) in the frame of the link before.
        """
        motor = self.bodies[f"motor{axis + 1}"]
        before = self.mechanism.bodies[f"motor{axis + 1}"].parent
        if number in ("d", "theta"):
            along, through = self.rotation[motor][:, 2], self.origin[motor]
        else:
            along, through = self.rotation[self.bodies[before]][:, 0], self.origin[self.bodies[before]]
        if number in ("a", "d"):
            return np.concatenate([np.zeros(3), along])
        return np.concatenate([along, _cross(through, along)])

    def turned(self, axes: Sequence[int], screws: FloatArray) -> FloatArray:
        """Rates (m, nv, 6) of the screws inboard of axes (m,), seen from what moves along screws (m, 6) with them."""
        along = screws[:, None]
        omega = _cross(along[..., :3], self.screw[:, :3])
        v = _cross(along[..., :3], self.screw[:, 3:]) + _cross(along[..., 3:], self.screw[:, :3])
        return -np.concatenate([omega, v], axis=-1) * (1 - self.carried[axes])[:, :, None]

    def placed_slopes(self, axes: Sequence[int], screws: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of M and K (m, nv, nv) where all from zero-based axes (m,) on moves along screws (m, 6)."""
        turned = self.turned(axes, screws)
        S = self.screw * self.path[:, :, None]
        inertial = self.spatial @ S.swapaxes(1, 2)  # (nb, 6, nv)
        reached = turned[:, None] * self.path[:, :, None] * self.moved[axes][:, :, None, None]  # (m, nb, nv, 6)
        m, nb, nv, _ = reached.shape
        dM = reached.swapaxes(1, 2).reshape(m * nv, nb * 6) @ inertial.reshape(nb * 6, nv)
        dM = dM.reshape(m, nv, nv)
        momentum = np.tensordot(self.moved[axes], inertial[:, 3:], 1)
        momentum_rate = (self.spatial[:, 3:] @ reached.swapaxes(2, 3)).sum(axis=1)
        omega, omega_rate = self.screw[:, :3], turned[..., :3]
        turned_gravity = -_cross(screws[:, None, :3], self.gravity)
        dK = (
            _hessian(omega, momentum, turned_gravity, self.inboard)
            + _hessian(omega_rate, momentum, self.gravity, self.inboard)
            + _hessian(omega, momentum_rate, self.gravity, self.inboard)
        )
        return dM + dM.swapaxes(1, 2), dK

    def inertial_slopes(self, body: str, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """∂M and ∂K (n, nv, nv) for changes (n, 6, 6) of a body's spatial inertia about, and in, its own frame."""
        index = self.bodies[body]
        S = (_to_body(self.rotation[index], self.origin[index]) @ self.screw.T).T * self.path[index][:, None]
        inertial = local @ S.T
        gravity = self.gravity @ self.rotation[index]
        return S @ inertial, _hessian(S[:, :3], inertial[:, 3:], gravity, self.inboard)


def _hessian(omega: FloatArray, momentum: FloatArray, gravity: FloatArray, inboard: FloatArray) -> FloatArray:
    """Gravity stiffness (…, nv, nv), from its inboard half; ``momentum`` (…, 3, nv) holds W_k in its columns."""
    half = -(_cross(gravity, omega) @ momentum) * inboard
    return half + half.swapaxes(-1, -2) - half * np.eye(omega.shape[-2])


def structure(mechanism: Mechanism, deflection: Mapping[str, float] | None = None) -> Structure:
    """The closed-form model of a mechanism with held rotors.

    Args:
        mechanism: from :func:`twin.robot.mechanism.assemble`.
        deflection: rest deflections by joint, rad (m): where the springs sag; zero by default.
    """
    return structures([mechanism], None if deflection is None else [deflection])[0]


def structures(
    mechanisms: Sequence[Mechanism], deflections: Sequence[Mapping[str, float]] | None = None
) -> list[Structure]:
    """The models of one robot in several postures: see :func:`structure`. Arrays carry the postures on a first axis.

    Args:
        mechanisms: from :func:`twin.robot.mechanism.assemble_all`, alike but for where the motors stand.
    """
    mechanism = mechanisms[0]
    layout = _layout(mechanism)
    rotation, origin, screw, command = _placed(mechanisms, layout, deflections)
    inertia = np.array([body.inertia for body in mechanism.bodies.values()])
    for index, body in enumerate(mechanism.bodies.values()):
        if body.kind == "base" and body.joints and not body.inertia.any():
            inertia[index] = FOOT_INERTIA * np.eye(3)
    X = _to_body(rotation, origin)
    mass = np.array([body.mass for body in mechanism.bodies.values()])
    com = np.array([body.com for body in mechanism.bodies.values()])
    spatial = X.swapaxes(-1, -2) @ spatial_inertia(mass, com, inertia) @ X
    gravity = mechanism.robot.felt_gravity
    S = screw[:, None] * layout.path[:, :, None]
    inertial = spatial @ S.swapaxes(-1, -2)
    momentum = inertial[..., 3:, :].sum(axis=1)
    load = gravity @ momentum
    strain = np.array([joint.stiffness[0] for joint in layout.joints])
    M = (S @ inertial).sum(axis=1) + _diagonal(joint.armature for joint in layout.joints)
    C = _diagonal(joint.damping[0] for joint in layout.joints)
    K = _hessian(screw[..., :3], momentum, gravity, layout.inboard)
    curved = {joint.name: k for k, joint in enumerate(layout.joints) if any(joint.stiffness[1:])}
    every = np.arange(len(layout.joints))
    K[:, every, every] += strain
    for k in curved.values():
        K[:, k, k] += [_tangent(layout.joints[k].stiffness, force) - strain[k] for force in load[:, k]]
    for tendon in mechanism.tendons:
        pull = np.array([tendon.joints.get(joint.name, 0.0) for joint in layout.joints])
        M = M + tendon.armature * np.outer(pull, pull)
        C = C + tendon.damping[0] * np.outer(pull, pull)
        K = K + tendon.stiffness * np.outer(pull, pull)
    names = tuple(joint.name for joint in layout.joints)
    for (one, other), stiffness in mechanism.crossed.items():
        i, j = names.index(one), names.index(other)
        K[:, [i, j], [j, i]] += stiffness
    loss = _diagonal(joint.loss_factor * joint.stiffness[0] for joint in layout.joints)
    integral = _diagonal(joint.stiffness[0] / joint.integral_time for joint in layout.joints)
    return [
        Structure(
            names, layout.bodies, screw[p], layout.inboard, layout.path, rotation[p], origin[p], spatial[p], command[p],
            layout.moved, layout.carried, gravity, load[p], M[p], C, K[p], loss, integral, strain, frozenset(curved),
            posed,
        )
        for p, posed in enumerate(mechanisms)
    ]  # fmt: skip


def _placed(
    mechanisms: Sequence[Mechanism], layout: "_Layout", deflections: Sequence[Mapping[str, float]] | None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of every posture the bodies' frames (p, nb, 3, 3) and (p, nb, 3), and the screws of coordinates and commands."""
    mechanism = mechanisms[0]
    eye = np.broadcast_to(np.eye(3), (len(mechanisms), 3, 3))
    turns, places = [eye], [np.zeros((len(mechanisms), 3))]  # the world, then the bodies
    axes: list[FloatArray] = []
    points: list[FloatArray] = []
    commands: list[tuple[FloatArray, FloatArray]] = []
    for body in mechanism.bodies.values():
        parent = 1 + layout.bodies[body.parent] if body.parent else 0
        turn, place = turns[parent], places[parent]
        moves = body.kind == "motor"
        position = np.array([m.bodies[body.name].position for m in mechanisms]) if moves else body.position
        place = place + (turn @ position[..., None])[..., 0]
        if moves:
            turn = turn @ matrix_of(np.array([m.bodies[body.name].quaternion for m in mechanisms]))
            commands.append((turn[..., 2], place))
        elif body.quaternion[0] != 1:
            turn = turn @ matrix_of(body.quaternion)
        for joint in body.joints:
            axis = turn @ np.asarray(joint.axis)
            anchor = turn @ np.asarray(joint.position)
            axes.append(axis)
            points.append(place + anchor)
            if deflections is not None:
                amount = np.array([rest.get(joint.name, 0.0) for rest in deflections])
                if joint.kind == "slide":
                    place = place + amount[:, None] * axis
                elif amount.any():
                    turned = _rodrigues(axis, amount)
                    place = place + anchor - (turned @ anchor[..., None])[..., 0]
                    turn = turned @ turn
        turns.append(turn)
        places.append(place)
    n = len(commands)
    rotation, origin = np.stack(turns[1:], axis=1), np.stack(places[1:], axis=1)
    screw = _screws(axes, points, [joint.kind == "slide" for joint in layout.joints], len(mechanisms))
    command = _screws(
        [z for z, _ in commands],
        [place for _, place in commands],
        [mechanism.axis_kind(i) == "slide" for i in range(n)],
        len(mechanisms),
    )
    return rotation, origin, screw, command


@dataclass(frozen=True)
class _Layout:
    """What of a structure no posture changes; its fields are those of :class:`Structure`."""

    bodies: dict[str, int]
    joints: list[Joint]
    path: FloatArray
    inboard: FloatArray
    moved: FloatArray
    carried: FloatArray


def _layout(mechanism: Mechanism) -> _Layout:
    bodies: dict[str, int] = {}
    paths: list[list[int]] = []
    joints: list[Joint] = []
    inboard: list[list[int]] = []
    for body in mechanism.bodies.values():
        path = list(paths[bodies[body.parent]]) if body.parent else []
        for joint in body.joints:
            path = [*path, len(joints)]
            inboard.append(path)
            joints.append(joint)
        bodies[body.name] = len(paths)
        paths.append(path)
    nb, nv, n = len(bodies), len(joints), mechanism.robot.axis_count
    on_path, mask, moved, carried = np.zeros((nb, nv)), np.zeros((nv, nv)), np.zeros((n, nb)), np.zeros((n, nv))
    for row, path in zip(on_path, paths, strict=True):
        row[path] = 1
    for k, path in enumerate(inboard):
        mask[path, k] = 1
    index = {joint.name: k for k, joint in enumerate(joints)}
    for i in range(n):
        outboard = {f"motor{i + 1}"}
        for body in mechanism.bodies.values():
            if body.name in outboard or body.parent in outboard:
                outboard.add(body.name)
                moved[i, bodies[body.name]] = 1
                carried[i, [index[joint.name] for joint in body.joints]] = 1
    return _Layout(bodies, joints, on_path, mask, moved, carried)


def _diagonal(values: Iterable[float]) -> FloatArray:
    return np.diag(np.array(list(values), float))


def spatial_inertia(mass: float | FloatArray, com: FloatArray, inertia: FloatArray) -> FloatArray:
    """Spatial inertia (…, 6, 6) about the frame's origin, rows and columns (ω, v).

    Args:
        mass: (…), kg; ``com`` (…, 3) m; ``inertia`` (…, 3, 3) at the com, kg·m².
    """
    mass = np.asarray(mass)[..., None, None]
    skew = _skew(com)
    out = np.zeros((*com.shape[:-1], 6, 6))
    out[..., :3, :3] = inertia - mass * skew @ skew
    out[..., :3, 3:], out[..., 3:, :3], out[..., 3:, 3:] = mass * skew, -mass * skew, mass * np.eye(3)
    return out


def _tangent(stiffness: Sequence[float], load: float) -> float:
    """Slope of k₁x + k₂x² + k₃x³ where it carries a load."""
    k1, k2, k3 = stiffness
    if not (k2 or k3):
        return k1
    roots = np.roots([k3, k2, k1, -load])
    real = roots[np.abs(roots.imag) < 1e-9 * max(1.0, abs(load / k1))].real
    x = real[np.argmin(np.abs(real - load / k1))]
    return float(k1 + 2 * k2 * x + 3 * k3 * x**2)


def _screws(
    axes: Sequence[FloatArray], points: Sequence[FloatArray], slides: Sequence[bool], postures: int
) -> FloatArray:
    """Twists (np, n, 6) of joints, (ω, v) at the world's origin, from n axes and points (np, 3)."""
    if not slides:
        return np.zeros((postures, 0, 6))
    axis, slide = np.stack(axes, axis=1), np.array(slides)[:, None]
    return np.concatenate(
        [np.where(slide, 0.0, axis), np.where(slide, axis, _cross(np.stack(points, axis=1), axis))], axis=-1
    )


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b over the last axis; numpy's own is ten times slower on arrays this small."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0], out[..., 1], out[..., 2] = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return out


def _skew(v: FloatArray) -> FloatArray:
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return out - out.swapaxes(-1, -2)


def _rodrigues(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) about axes (n, 3) by angles (n,), rad."""
    cross, angle = _skew(axis), angle[:, None, None]
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _to_body(rotation: FloatArray, origin: FloatArray) -> FloatArray:
    """(…, 6, 6) that takes a twist about the world's origin to a body's frame (…, 3, 3), (…, 3)."""
    turned = rotation.swapaxes(-1, -2)
    out = np.zeros((*origin.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = turned
    out[..., 3:, :3] = -turned @ _skew(origin)
    return out


# --- what a recording sees, and its derivatives -------------------------------------------------------------------


@dataclass(frozen=True)
class Setup:
    """One posture of a recording: what the model needs to know to predict it.

    Attributes:
        name: base name of the posture, shared by its force levels; its angles are ``posture.NAME.q1`` ….
        q: (n,) commanded positions as recorded, rad (m).
        brakes: ``None`` where unknown; the servo may then give way.
        response, excitation: the recording's channels.
    """

    name: str
    q: FloatArray
    brakes: Brakes | None
    response: Channels
    excitation: Channels

    @cached_property
    def alike(self) -> tuple[Any, ...]:
        """The same for setups of which every model is the same: the force levels of a posture."""
        sides = (
            (c.label, c.body, c.position.tobytes(), c.direction.tobytes()) for c in (self.response, self.excitation)
        )
        return self.name, self.q.tobytes(), self.brakes, *sides

    def placed(self, parameters: Parameters, values: FloatArray) -> "Setup":
        """The same with the channels where parameters have their nodes."""
        response = parameters.placed(self.response, "response", values)
        excitation = parameters.placed(self.excitation, "excitation", values)
        same = response is self.response and excitation is self.excitation
        return self if same else replace(self, response=response, excitation=excitation)


@dataclass(frozen=True)
class Observed:
    """A structure seen through a recording's channels.

    Attributes:
        J_r, J_e: (nr, nv) and (ne, nv) displacement along the channels per unit of the coordinates.
        gain, delay: (nr,) of the response channels; delay in s.
        load: (nr, nr) kg, of the sensor that channels share, on the robot only while they record.
        sag: what full sag adds to M … J_e, where the sag is free.
    """

    M: FloatArray
    C: FloatArray
    K: FloatArray
    loss: FloatArray
    integral: FloatArray
    J_r: FloatArray
    J_e: FloatArray
    gain: FloatArray
    delay: FloatArray
    load: FloatArray
    sag: "Observed | None" = None

    @classmethod
    def of(cls, arrays: Iterable[FloatArray], sag: "Observed | None" = None) -> "Observed":
        """From the ten arrays in the order of the fields."""
        M, C, K, loss, integral, J_r, J_e, gain, delay, load = arrays
        return cls(M, C, K, loss, integral, J_r, J_e, gain, delay, load, sag)

    def arrays(self) -> tuple[FloatArray, ...]:
        """The ten arrays in the order of the fields."""
        structure = self.M, self.C, self.K, self.loss, self.integral
        return *structure, self.J_r, self.J_e, self.gain, self.delay, self.load


def observe(
    robot: Robot, setup: Setup, parameters: Parameters, values: FloatArray, *, sagging: bool = True
) -> tuple[Observed, Structure]:
    """The model of a posture at parameter values (n,); ``robot`` already carries the values that belong to it.

    Without ``sagging``, as if the springs did not give way under the weight: what a difference of two models needs.
    """
    return observe_all(robot, [setup], parameters, values, sagging=sagging)[0]


def observe_all(
    robot: Robot, setups: Sequence[Setup], parameters: Parameters, values: FloatArray, *, sagging: bool = True
) -> list[tuple[Observed, Structure]]:
    """:func:`observe` for several postures; those with the same brakes and channels in one go."""
    alike: dict[tuple[Any, ...], list[int]] = {}
    for k, setup in enumerate(setups):
        alike.setdefault((setup.brakes or "off", id(setup.response), id(setup.excitation)), []).append(k)
    found: dict[int, tuple[Observed, Structure]] = {}
    for (brakes, *_), group in alike.items():
        seen = _observe_alike(robot, [setups[k] for k in group], brakes, parameters, values, sagging)
        found |= zip(group, seen, strict=True)
    return [found[k] for k in range(len(setups))]


def _observe_alike(
    robot: Robot, setups: Sequence[Setup], brakes: Brakes, parameters: Parameters, values: FloatArray, sagging: bool
) -> list[tuple[Observed, Structure]]:
    postures = [s.q + parameters.posture_error(s.name, values, len(s.q)) for s in setups]
    models = structures(assemble_all(robot, postures, brakes=brakes))
    first = setups[0]
    first = first.placed(parameters, values)
    chain = recording_chain(robot, first.response, first.excitation)
    gain = chain.response_gain * parameters.gains(first.response.label, values)
    seen = _seen(models, first, chain, gain)
    share = parameters.sag(values) if sagging else None
    if share is None:
        return list(zip(seen, models, strict=True))
    # deflections are below 1e-3 rad: what they change is linear in them
    low = _seen(structures([m.mechanism for m in models], [m.sag() for m in models]), first, chain, gain)
    found = []
    for plain, sunk, model in zip(seen, low, models, strict=True):
        with np.errstate(invalid="ignore"):  # no spring left: infinite, which a search steps back from
            sag = Observed.of(a - b for a, b in zip(sunk.arrays(), plain.arrays(), strict=True))
        blended = (a + share * b for a, b in zip(plain.arrays(), sag.arrays(), strict=True))
        found.append((Observed.of(blended, sag), model))
    return found


def _seen(models: Sequence[Structure], setup: Setup, chain: MeasurementChain, gain: FloatArray) -> list[Observed]:
    J_r = _rows(models, setup.response, chain.response_direction)
    J_e = _rows(models, setup.excitation, chain.excitation_direction)
    return [
        Observed(m.M, m.C, m.K, m.loss, m.integral, r, e, gain, chain.response_delay, chain.response_load)
        for m, r, e in zip(models, J_r, J_e, strict=True)
    ]


def _rows(models: Sequence[Structure], channels: Channels, direction: FloatArray) -> FloatArray:
    """:meth:`Structure.rows` (np, n, nv) of models alike but for their posture."""
    first = models[0]
    body, local = first.carried_points(channels)
    turn, origin, screw = (np.stack([getattr(m, name) for m in models]) for name in ("rotation", "origin", "screw"))
    return _wrench(turn[:, body], origin[:, body], local, direction) @ screw.swapaxes(-1, -2) * first.path[body]


def point_jacobians(models: Sequence[Structure], body: str, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a point of a link (3,) lies, (p, 3) in the world, and its Jacobian (p, 3, nv); models alike but for q."""
    first = models[0]
    carrier = first.mechanism.carrier(body, position)
    index = first.bodies[carrier]
    turn, origin, screw = (np.stack([getattr(m, name) for m in models]) for name in ("rotation", "origin", "screw"))
    place = origin[:, index] + turn[:, index] @ (position - first.mechanism.offset(carrier))
    moved = screw[..., 3:] + _cross(screw[..., :3], place[:, None, :])
    return place, np.asarray((moved * first.path[index][:, None]).swapaxes(1, 2))


def _wrench(turn: FloatArray, origin: FloatArray, local: FloatArray, direction: FloatArray) -> FloatArray:
    """Unit forces at points of bodies as wrenches (moment about the world's origin, force) (…, n, 6)."""
    point = origin + (turn @ local[:, :, None])[..., 0]
    force = (turn @ direction[:, :, None])[..., 0]
    return np.concatenate([_cross(point, force), force], axis=-1)


def recording_chain(robot: Robot, response: Channels, excitation: Channels) -> MeasurementChain:
    """The measurement chain of a recording, as the robot's measurement entries make it."""
    chain = MeasurementChain(
        response.label,
        response.direction,
        excitation.label,
        excitation.direction,
        torque_gain=np.ones(robot.axis_count),
    )
    for entry in robot.physics:
        effect = CATALOGUE[entry.effect]
        if type(effect).record is not Effect.record:
            effect.record(chain, entry.site, robot.values(entry))
    return chain


def slopes(
    robot: Robot,
    setup: Setup,
    parameters: Parameters,
    values: FloatArray,
    seen: Observed,
    model: Structure,
    changes: "dict[tuple[Any, ...], Any] | None" = None,
    among: Iterable[int] | None = None,
) -> Observed:
    """Derivatives of :func:`observe` with respect to the parameters' values, stacked on a first axis (n, …).

    Those by springs, dampers, links, axes, postures and channels are in closed form, without what sag changes in them,
    see :func:`sag_slopes`. Where :func:`_curved` says that there is none (entries, links that bend), derivatives come
    through what a parameter changes in the mechanism, or by central differences.

    Args:
        changes: of the mechanism, kept by the caller for the other postures of the same robot and values.
        among: indices of the parameters asked for; all of them by default.
    """
    stated, changes, setup = setup, {} if changes is None else changes, setup.placed(parameters, values)
    among = range(len(parameters)) if among is None else list(among)
    out = Observed.of(np.zeros((len(among), *array.shape)) for array in seen.arrays())
    index = {name: k for k, name in enumerate(model.coordinates)}
    links: dict[str, list[tuple[int, int]]] = {}
    moves: list[tuple[int, int, FloatArray]] = []
    turns: list[tuple[int, int]] = []
    points: dict[int, int] = {}
    for row, p in enumerate(among):
        parameter, (site, what) = parameters[p], parameters.parts[p]
        if _curved(parameter, site, setup, model):
            key = p, setup.brakes, setup.response.label, setup.excitation.label
            if key not in changes:
                changes[key] = _change(robot, setup, parameters, values, p) if parameter.kind == "entry" else None
            change = changes[key]
            if change is not None and not model.curved:
                _apply_change(out, row, change, model, setup, parameters.gains(setup.response.label, values))
                continue
            for target, rate in zip(out.arrays(), _difference(robot, stated, parameters, values, p), strict=True):
                target[row] = rate
        elif parameter.kind == "link":
            links.setdefault(site.partition(".")[0], []).append((row, p))
        elif parameter.kind == "spring" and site in index:
            _apply_spring(out, row, what, index[site], model)
        elif parameter.kind == "axis" or (parameter.kind == "posture" and site == f"posture.{setup.name}"):
            axis = int((what if parameter.kind == "posture" else site).lstrip("axisq")) - 1
            screw = model.command[axis] if parameter.kind == "posture" else model.placement(axis, what)
            moves.append((row, axis, screw))
        elif parameter.kind == "sag" and seen.sag is not None:
            for target, rate in zip(out.arrays(), seen.sag.arrays(), strict=True):
                target[row] = rate
        elif parameter.kind == "point":
            points[p] = row
        elif parameter.kind == "direction":
            turns.append((row, p))
        elif parameter.kind == "gain":
            rows_of = [k for k, label in enumerate(setup.response.label) if parameter.name == f"gain.{label}"]
            out.gain[row, rows_of] = seen.gain[rows_of] / values[p]
    for body, own in links.items():
        block = (body, *own)
        if block not in changes:
            inertial = robot.links[int(body[4:]) - 1].inertial
            changes[block] = np.array([_link_slope(inertial, parameters[p].name) for _, p in own])
        rows = [row for row, _ in own]
        out.M[rows], out.K[rows] = model.inertial_slopes(body, changes[block])
    if moves or points:
        chain = recording_chain(robot, setup.response, setup.excitation)
        _apply_points(out, points, parameters, chain, setup, model)
    if moves:
        _apply_moves(out, moves, chain, setup, model)
    if turns:
        _apply_turns(out, turns, parameters, values, robot, stated, setup, model)
    return out


def _apply_spring(out: Observed, row: int, what: str, k: int, model: Structure) -> None:
    """Of the stiffness or damping of coordinate k."""
    if what == "stiffness":
        out.K[row, k, k] = 1.0
        out.loss[row, k, k] = model.loss[k, k] / model.strain[k]
        out.integral[row, k, k] = model.integral[k, k] / model.strain[k]
    else:
        out.C[row, k, k] = 1.0


def _apply_moves(
    out: Observed, moves: Sequence[tuple[int, int, FloatArray]], chain: MeasurementChain, setup: Setup, model: Structure
) -> None:
    """Of axes that stand elsewhere or at another angle: rows, zero-based axes and the screws (6,) they move along."""
    rows, axes, screws = [row for row, _, _ in moves], [axis for _, axis, _ in moves], np.array([s for *_, s in moves])
    out.M[rows], out.K[rows] = model.placed_slopes(axes, screws)
    out.J_r[rows] = model.row_slopes(model.wrenches(setup.response, chain.response_direction), axes, screws)
    out.J_e[rows] = model.row_slopes(model.wrenches(setup.excitation, chain.excitation_direction), axes, screws)


def sag_slopes(
    robot: Robot, setups: Sequence[Setup], parameters: Parameters, values: FloatArray, models: Sequence[Structure]
) -> list[Observed]:
    """What :func:`slopes` leaves out: derivatives of what sag changes, by central differences, for every posture.

    They are 1e-3 of the others and hardly vary: one evaluation serves a whole descent. Rows are those parameters that
    the posture sees, :meth:`Parameters.seen_in`. What no spring moves, as damping, is zero and takes no memory.
    """
    share, seen = parameters.sag(values) or 0.0, observe_all(robot, setups, parameters, values)
    rows = [{p: row for row, p in enumerate(parameters.seen_in(setup.name))} for setup in setups]
    found = [
        [np.broadcast_to(0.0, (len(own), *a.shape)) for a in one.arrays()]
        for own, (one, _) in zip(rows, seen, strict=True)
    ]
    for p, parameter in enumerate(parameters if share else ()):
        moves = parameter.kind == "link" or (parameter.kind == "spring" and parameter.quantity == "stiffness")
        some = [
            k
            for k, (setup, model) in enumerate(zip(setups, models, strict=True))
            if moves
            or parameter.kind == "axis"
            or (parameter.kind == "posture" and parameter.site == f"posture.{setup.name}")
            or _curved(parameter, parameter.site, setup, model)
        ]
        changes = _differences(robot, [setups[k] for k in some], parameters, values, p, True) if some else []
        for k, change in zip(some, changes, strict=True):
            for field, array in enumerate(change):
                if array.any():
                    if not found[k][field].flags.writeable:
                        found[k][field] = np.zeros(found[k][field].shape)
                    found[k][field][rows[k][p]] = share * array
    return [Observed.of(arrays) for arrays in found]


def _curved(parameter: Parameter, site: str, setup: Setup, model: Structure) -> bool:
    """Whether there is no closed form: other entries, links that bend, what moves hardening springs' working points."""
    if parameter.kind == "spring":
        return site in model.curved
    if parameter.kind == "link":
        return bool(model.curved) or int(site.partition(".")[0][4:]) in model.mechanism.splits
    if parameter.kind == "posture":
        return bool(model.curved) and site == f"posture.{setup.name}"
    if parameter.kind == "axis":  # a link that bends is cut in two of its length
        return bool(model.curved or model.mechanism.splits)
    return parameter.kind == "entry"


def _difference(
    robot: Robot, setup: Setup, parameters: Parameters, values: FloatArray, p: int, sag: bool = False
) -> list[FloatArray]:
    """Central differences of :func:`observe`, or of what sag adds to it, with respect to one parameter's value."""
    return _differences(robot, [setup], parameters, values, p, sag)[0]


def _differences(
    robot: Robot, setups: Sequence[Setup], parameters: Parameters, values: FloatArray, p: int, sag: bool = False
) -> list[list[FloatArray]]:
    """:func:`_difference` for several postures."""
    step = parameters[p].step(values[p])

    def at(value: float) -> list[Observed]:
        shifted = values.copy()
        shifted[p] = value
        moved = observe_all(parameters.apply_one(robot, p, value), setups, parameters, shifted, sagging=sag)
        return [seen.sag or seen for seen, _ in moved]

    above, below = values[p] + step, values[p] - step
    high, low = at(above), at(below)
    if high[0].M.shape != low[0].M.shape:  # on one side what it belongs to has vanished, and its coordinate
        here = at(values[p])
        high, above = (high, above) if high[0].M.shape == here[0].M.shape else (here, values[p])
        low, below = (low, below) if low[0].M.shape == here[0].M.shape else (here, values[p])
    return [
        [(a - b) / (above - below) for a, b in zip(up.arrays(), down.arrays(), strict=True)]
        for up, down in zip(high, low, strict=True)
    ]


@dataclass(frozen=True)
class Change:
    """What one value of an entry changes in a mechanism and its measurement chain, per unit of the value.

    Attributes:
        inertial: body → spatial inertia (6, 6) about, and in, its own frame.
        joints: name → armature, damping, stiffness, loss factor times stiffness, stiffness over integral time.
        chain: directions of responses (nr, 3) and excitations (ne, 3), gains (nr,), delays (nr,), loads (nr, nr).
    """

    inertial: dict[str, FloatArray]
    joints: dict[str, FloatArray]
    chain: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _change(robot: Robot, setup: Setup, parameters: Parameters, values: FloatArray, p: int) -> Change | None:
    """By central differences of what the posture does not touch; ``None`` where the value changes the geometry."""
    step = parameters[p].step(values[p])
    sides = [parameters.apply_one(robot, p, values[p] + sign * step) for sign in (-1.0, 1.0)]
    low, high = (assemble(side, setup.q, brakes=setup.brakes or "off") for side in sides)
    if list(low.bodies) != list(high.bodies) or low.tendons != high.tendons or low.crossed != high.crossed:
        return None
    inertial, joints = {}, {}
    parents = {body.parent for body in low.bodies.values()}
    for name, one in low.bodies.items():
        two = high.bodies[name]
        shift = two.position - one.position
        # a leaf on slides: where it hangs is where its mass is
        leaf = name not in parents and all(joint.kind == "slide" for joint in one.joints) and one.quaternion[0] == 1
        if [j.name for j in one.joints] != [j.name for j in two.joints] or (shift.any() and not leaf):
            return None
        if (one.quaternion != two.quaternion).any():
            return None
        a, b = (spatial_inertia(x.mass, x.com + k * shift, x.inertia) for x, k in ((one, -0.5), (two, 0.5)))
        if (a != b).any():
            inertial[name] = (b - a) / (2 * step)
        for old, new in zip(one.joints, two.joints, strict=True):
            was, now = (
                np.array([j.armature, j.damping[0], k, j.loss_factor * k, k / j.integral_time])
                for j in (old, new)
                for k in (j.stiffness[0],)
            )
            if old.axis != new.axis:
                return None
            if (was != now).any():
                joints[old.name] = (now - was) / (2 * step)
    before, after = (recording_chain(side, setup.response, setup.excitation) for side in sides)
    names = ("response_direction", "excitation_direction", "response_gain", "response_delay", "response_load")
    response, excitation, gain, delay, load = ((getattr(after, n) - getattr(before, n)) / (2 * step) for n in names)
    return Change(inertial, joints, (response, excitation, gain, delay, load))


def _apply_change(
    out: Observed, p: int, change: Change, model: Structure, setup: Setup, calibration: FloatArray
) -> None:
    """Write a change into row p of derivatives; ``calibration`` (nr,) are the gains fitted beside the description's."""
    for body, local in change.inertial.items():
        dM, dK = model.inertial_slopes(body, local[None])
        out.M[p] += dM[0]
        out.K[p] += dK[0]
    for name, rates in change.joints.items():
        k = model.coordinates.index(name)
        for target, rate in zip((out.M, out.C, out.K, out.loss, out.integral), rates, strict=True):
            target[p, k, k] += rate
    response, excitation, gain, delay, load = change.chain
    if response.any():
        out.J_r[p] = model.rows(setup.response, response)
    if excitation.any():
        out.J_e[p] = model.rows(setup.excitation, excitation)
    out.gain[p], out.delay[p], out.load[p] = gain * calibration, delay, load


def _apply_points(
    out: Observed,
    points: Mapping[int, int],
    parameters: Parameters,
    chain: MeasurementChain,
    setup: Setup,
    model: Structure,
) -> None:
    """Write what coordinates of nodes change into rows of derivatives: from the parameter to its row."""
    sides: tuple[tuple[Side, FloatArray, Channels, FloatArray], ...] = (
        ("response", out.J_r, setup.response, chain.response_direction),
        ("excitation", out.J_e, setup.excitation, chain.excitation_direction),
    )
    for side, target, channels, direction in sides:
        moving = parameters.moving(channels.label, side)
        moved = [(points[p], k, axis) for p, rows, axis in moving if p in points for k in rows]
        if moved:
            row, k, axis = np.array(moved).T
            body = np.array(model.carried_points(channels)[0])[k]
            along, force = model.rotation[body, :, axis], model.rotation[body] @ direction[k][:, :, None]
            moment = _cross(along, force[..., 0])
            target[row, k] = (model.screw[:, :3] @ moment[..., None])[..., 0] * model.path[body]


def _apply_turns(
    out: Observed,
    turns: Sequence[tuple[int, int]],
    parameters: Parameters,
    values: FloatArray,
    robot: Robot,
    stated: Setup,
    setup: Setup,
    model: Structure,
) -> None:
    """Write what directions of channels change into rows of derivatives: pairs of a row and a parameter.

    A turned sensor or blow that is an entry of the robot turns the rate as it turns the direction.
    """
    plain = recording_chain(robot, setup.response, setup.excitation)
    sides: tuple[tuple[Side, FloatArray, Channels, Channels], ...] = (
        ("response", out.J_r, stated.response, setup.response),
        ("excitation", out.J_e, stated.excitation, setup.excitation),
    )
    for side, target, before, channels in sides:
        at: list[tuple[int, int]] = []
        rates: list[FloatArray] = []
        turning = parameters.turning(before, side, values)
        recorded = plain.response_direction if side == "response" else plain.excitation_direction
        for row, p in turns:
            if p not in turning:
                continue
            change = np.zeros_like(recorded)
            change[turning[p][0]] = turning[p][1]
            if recorded is not channels.direction and (recorded != channels.direction).any():
                moved = replace(channels, direction=channels.direction + TURN * change)
                pair = (moved, setup.excitation) if side == "response" else (setup.response, moved)
                chain = recording_chain(robot, *pair)
                after = chain.response_direction if side == "response" else chain.excitation_direction
                change = (after - recorded) / TURN
            touched = np.flatnonzero(change.any(axis=1))
            at += [(row, int(k)) for k in touched]
            rates += list(change[touched])
        if at:
            body, local = model.carried_points(channels)
            here = [body[k] for _, k in at]
            wrench = _wrench(model.rotation[here], model.origin[here], local[[k for _, k in at]], np.array(rates))
            target[tuple(np.array(at).T)] = wrench @ model.screw.T * model.path[here]


def _link_slope(inertial: tuple[float, FloatArray, FloatArray], name: str) -> FloatArray:
    """∂ spatial inertia (6, 6), in the link's frame, with respect to its mass, com or inertia."""
    mass, com, _ = inertial
    _, what, *rest = name.split(".")
    if what == "mass":
        return spatial_inertia(1.0, com, np.zeros((3, 3)))
    if what == "com":
        unit = np.eye(3)["xyz".index(rest[0])]
        moment = mass * (2 * com @ unit * np.eye(3) - np.outer(com, unit) - np.outer(unit, com))
        change = np.zeros((6, 6))
        change[:3, :3], change[:3, 3:], change[3:, :3] = moment, mass * _skew(unit), -mass * _skew(unit)
        return change
    i, j = ("xyz".index(letter) for letter in rest[0])
    change = np.zeros((6, 6))
    change[i, j] = change[j, i] = 1.0
    return change


def moving(rate: Observed) -> NDArray[np.intp]:
    """Indices of the parameters that change anything: not the postures of other recordings."""
    return np.flatnonzero(np.any([array.reshape(len(array), -1).any(axis=1) for array in rate.arrays()], axis=0))


def contract(slopes_: Observed, transform: FloatArray) -> Observed:
    """Derivatives along other coordinates: ``transform`` (n, m) holds ∂ value / ∂ coordinate.

    Every array is moved by some values only, and those by some coordinates: the rest stays zero.
    """
    found = []
    for array in slopes_.arrays():
        out = np.zeros((transform.shape[1], *array.shape[1:]))
        rows = np.flatnonzero(array.any(axis=tuple(range(1, array.ndim))))
        columns = np.flatnonzero(transform[rows].any(axis=0))
        if columns.size:
            out[columns] = np.tensordot(transform[np.ix_(rows, columns)].T, array[rows], 1)
        found.append(out)
    return Observed.of(found)


def frf(seen: Observed, s: ComplexArray, power: int) -> ComplexArray:
    """H(s) = sᵖ R J_r Z(s)⁻¹ J_eᵀ, (nf, nr, ne), R the channels' gains and delays; with loads see :func:`_loaded`."""
    if seen.load.any():
        H, B = _split(frf(_bare(seen, seen), s, 0), len(seen.J_e))
        return _record(seen, s, power) * (_loaded(seen, s, B) @ H)
    X_r = np.linalg.solve(_dynamic(seen, s), np.broadcast_to(seen.J_r.T, (len(s), *seen.J_r.T.shape)))
    return _record(seen, s, power) * (X_r.swapaxes(1, 2) @ seen.J_e.T)


def frf_slopes(seen: Observed, rate: Observed, s: ComplexArray, power: int) -> tuple[ComplexArray, ComplexArray]:
    """H (nf, nr, ne) and its derivatives (n, nf, nr, ne).

    ∂H = sᵖR [∂J_r Z⁻¹J_eᵀ + J_r Z⁻¹∂J_eᵀ − J_r Z⁻¹ ∂Z Z⁻¹J_eᵀ] + H ∂R/R.
    """
    if seen.load.any() or rate.load.any():
        return _loaded_slopes(seen, rate, s, power)
    nf, nv, ne = len(s), seen.M.shape[0], len(seen.J_e)
    inverse = np.linalg.inv(_dynamic(seen, s))
    X_r, X_e = seen.J_r @ inverse, (inverse.reshape(-1, nv) @ seen.J_e.T).reshape(nf, nv, ne)
    record = _record(seen, s, power)
    H, pull = record * (X_r @ seen.J_e.T), -record * X_r
    slope = _stiffness_slopes(rate, s, pull, X_e)
    for p in np.flatnonzero(rate.J_r.any(axis=(1, 2))):
        slope[p] += record * (rate.J_r[p] @ X_e)
    some, blow = np.nonzero(rate.J_e.any(axis=2))  # a node is that of one blow
    slope[some, :, :, blow] -= np.moveaxis(pull @ rate.J_e[some, blow].T, 2, 0)
    for p in np.flatnonzero(rate.gain.any(axis=1) | rate.delay.any(axis=1)):
        slope[p] += H * (rate.gain[p] / seen.gain - s[:, None] * rate.delay[p])[:, :, None]
    return H, slope


def frf_pull(seen: Observed, rate: Observed, s: ComplexArray, power: int, pull: ComplexArray) -> FloatArray:
    """Re Σ pull ∂H (n,) over lines and channels, ∂H of :func:`frf_slopes` and ``pull`` (nf, nr, ne).

    What multiplies ∂Z is summed over the lines first: that takes a thirtieth of the time of the derivatives themselves.
    """
    if seen.load.any() or rate.load.any():
        return np.asarray(np.tensordot(_loaded_slopes(seen, rate, s, power)[1], pull, 3).real)
    X_r, X_e = _receptances(seen, s, power)
    felt, along = pull @ X_e.swapaxes(1, 2), pull * (X_r @ seen.J_e.T)
    stiff = np.tensordot(_factors(s), X_r.swapaxes(1, 2) @ felt, 1).real
    gain, delay = along.sum(axis=(0, 2)).real / seen.gain, np.einsum("f,fre->r", s, along).real
    J_r, J_e = (_record(seen, s, power) * felt).sum(axis=0).real, (pull.swapaxes(1, 2) @ X_r).sum(axis=0).real
    out = rate.gain @ gain - rate.delay @ delay
    for slope, by in ((rate.J_r, J_r), (rate.J_e, J_e), *zip(_matrices(rate), -stiff, strict=True)):
        out += slope.reshape(len(slope), -1) @ by.reshape(-1)
    return np.asarray(out)


def telling(seen: Observed, s: ComplexArray, power: int, weight: FloatArray) -> FloatArray:
    """How much every line (nf,) says of stiffness between any two coordinates: Σ |weight X_r X_e|²."""
    X_r, X_e = _receptances(seen, s, power)
    return np.einsum("fre,fr,fe->f", weight**2, (np.abs(X_r) ** 2).sum(axis=2), (np.abs(X_e) ** 2).sum(axis=1))


def _receptances(seen: Observed, s: ComplexArray, power: int) -> tuple[ComplexArray, ComplexArray]:
    """From forces on the coordinates to what is recorded (nf, nr, nv), and from blows to coordinates (nf, nv, ne)."""
    inverse = np.linalg.inv(_dynamic(seen, s))
    return _record(seen, s, power) * (seen.J_r @ inverse), inverse @ seen.J_e.T


def _stiffness_slopes(rate: Observed, s: ComplexArray, pull: ComplexArray, X_e: ComplexArray) -> ComplexArray:
    """pull ∂Z X_e (n, nf, nr, ne), pull (nf, nr, nv), X_e (nf, nv, ne).

    A spring or damper of one coordinate makes a product of two vectors; else ∂Z first meets the side with fewer
    channels.
    """
    (nf, nr, nv), ne = pull.shape, X_e.shape[2]
    out, matrices = np.zeros((len(rate.M), nf, nr, ne), complex), np.stack(_matrices(rate), axis=1)
    entries = np.count_nonzero(matrices.reshape(len(matrices), -1), axis=1)  # none of channels' own numbers
    one = (entries == 1) & matrices.diagonal(axis1=2, axis2=3).any(axis=(1, 2))
    for k in range(nv):
        along = matrices[:, :, k, k] * one[:, None]
        if (springs := np.flatnonzero(along.any(axis=1))).size:
            product = pull[:, :, k, None] * X_e[:, None, k, :]
            for p, factor in zip(springs, along[springs] @ _factors(s), strict=True):
                np.multiply(factor[:, None, None], product, out=out[p])
    felt = np.flatnonzero((entries > 0) & ~one)
    parts = [
        (m, factor[:, None, None])
        for m, factor in zip(matrices[felt].swapaxes(0, 1), _factors(s), strict=True)
        if m.any()
    ]
    if not parts:
        return out
    n = len(felt)
    if nr <= ne:
        by = np.concatenate([m.transpose(1, 0, 2).reshape(nv, -1) for m, _ in parts])
    else:
        by = np.concatenate([m for m, _ in parts], axis=2).reshape(n * nv, -1)
    for some in (slice(at, at + CACHED) for at in range(0, nf, CACHED)):
        left, right = pull[some], X_e[some]
        if nr <= ne:
            flat = np.concatenate([factor[some] * left for _, factor in parts], axis=2).reshape(len(left) * nr, -1)
            found = (flat @ by).reshape(len(left), nr * n, nv) @ right
        else:
            flat = np.concatenate([factor[some] * right for _, factor in parts], axis=1).transpose(1, 0, 2)
            moved = by @ np.ascontiguousarray(flat.reshape(-1, len(left) * ne)).view(float)
            found = left @ moved.view(complex).reshape(n, nv, -1, ne).transpose(2, 1, 0, 3).reshape(-1, nv, n * ne)
        out[felt, some] = found.reshape(-1, nr, n, ne).transpose(2, 0, 1, 3)
    return out


def _loaded(seen: Observed, s: ComplexArray, B: ComplexArray) -> ComplexArray:
    """(1 + s² L ∘ B)⁻¹ (nf, nr, nr): what sensors of mass L leave of motion, B the receptance between their channels.

    A channel's own sensor alone is on the robot while it records: the force −m s² u at its node (D. J. Ewins, Modal
    Testing, 2nd ed., 2000, section 3.3).
    """
    return np.asarray(np.linalg.inv(np.eye(len(seen.load)) + s[:, None, None] ** 2 * seen.load * B))


def _loaded_slopes(seen: Observed, rate: Observed, s: ComplexArray, power: int) -> tuple[ComplexArray, ComplexArray]:
    """:func:`frf_slopes` with loads: ∂(T H) = T (∂H − s² (∂L ∘ B + L ∘ ∂B) T H)."""
    every, slope = frf_slopes(_bare(seen, seen), _bare(rate, seen), s, 0)
    (H, B), (dH, dB) = _split(every, len(seen.J_e)), _split(slope, len(seen.J_e))
    T, record = _loaded(seen, s, B), _record(seen, s, power)
    moved = T @ H
    change = s[:, None, None] ** 2 * (rate.load[:, None] * B + seen.load * dB)
    out = record * (T @ (dH - change @ moved))
    for p in np.flatnonzero(rate.gain.any(axis=1) | rate.delay.any(axis=1)):
        out[p] += record * moved * (rate.gain[p] / seen.gain - s[:, None] * rate.delay[p])[:, :, None]
    return record * moved, out


def _bare(some: Observed, seen: Observed) -> Observed:
    """A model, or its derivatives, also driven at the response channels, and as ideal channels would see it."""
    unit = np.ones_like(some.gain) if some is seen else np.zeros_like(some.gain)
    J_e = np.concatenate([some.J_e, some.J_r], axis=-2)
    return replace(some, J_e=J_e, gain=unit, delay=0 * some.delay, load=0 * some.load, sag=None)


def _split(every: ComplexArray, ne: int) -> tuple[ComplexArray, ComplexArray]:
    return every[..., :ne], every[..., ne:]


def _dynamic(seen: Observed, s: ComplexArray) -> ComplexArray:
    """Z = s²M + sC + K + i·loss + integral/s, (nf, nv, nv)."""
    line = s[:, None, None]
    Z = line**2 * seen.M + line * seen.C + (seen.K + 1j * seen.loss)
    return np.asarray(Z + seen.integral / line if seen.integral.any() else Z)


def _matrices(seen: Observed) -> tuple[FloatArray, ...]:
    return seen.M, seen.C, seen.K, seen.loss, seen.integral


def _factors(s: ComplexArray) -> ComplexArray:
    """What multiplies each of :func:`_matrices` in the dynamic stiffness, (5, nf)."""
    return np.array([s**2, s, np.ones(len(s)), np.full(len(s), 1j), 1 / s])


def _record(seen: Observed, s: ComplexArray, power: int) -> ComplexArray:
    return np.asarray((s[:, None] ** power * seen.gain * np.exp(-s[:, None] * seen.delay))[:, :, None])


# --- modes ----------------------------------------------------------------------------------------------------------


def poles(seen: Observed) -> tuple[ComplexArray, ComplexArray]:
    """Poles (nm,) rad/s of the oscillating modes, by frequency, and shapes (nv, nm)."""
    nv = len(seen.M)
    pole, vector = np.linalg.eig(state_matrix(*_matrices(seen)))
    keep = np.flatnonzero(pole.imag > 1e-6 * np.abs(pole))
    keep = keep[np.argsort(np.abs(pole[keep]))]
    return pole[keep], vector[:nv, keep]


def pole_slopes(seen: Observed, rate: Observed, pole: ComplexArray, shape: ComplexArray) -> ComplexArray:
    """Derivatives (n, nm) of the poles: ∂λ = −φᵀ ∂Z(λ) φ / φᵀ Z'(λ) φ, Z being symmetric."""
    out = np.empty((len(rate.M), len(pole)), complex)
    for k, (value, phi) in enumerate(zip(pole, shape.T, strict=True)):
        change = value**2 * rate.M + value * rate.C + rate.K + 1j * rate.loss + rate.integral / value
        out[:, k] = -(phi @ change @ phi) / (phi @ (2 * value * seen.M + seen.C - seen.integral / value**2) @ phi)
    return out
