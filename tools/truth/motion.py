"""Motion logs of the rigid robot: trajectories, motor torques, encoder and torque noise, written as `motion-log`.

Torque is the motor's times the gear ratio, position the motor encoder's over it. Friction may have a memory
(Dahl/LuGre bristles, many slip elements) and the compensator may be a gas spring, so that the constitutive laws
need not be those of the model that is to find them.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from tools.truth.chain import Array, Chain, flange_position, inverse_dynamics
from tools.truth.effects import EFFECTS, Effect, TruthError
from tools.truth.elastic import loaded
from tools.truth.recording import Truth, write_answer

Trajectory = Callable[[Array], tuple[Array, Array, Array]]  # t (nt,) → q, q̇, q̈ (nt, n)


@dataclass(frozen=True)
class Fourier:
    """Finite Fourier series (Eqs. 8–10), run along a slowed clock: at rest at both ends and at every dwell.

    `sine`, `cosine` (n, harmonics): a_l and b_l, rad/s; `centre` (n,). `dwells`: instants s of one-second
    standstills. Ramps of the clock last one second.
    """

    sine: Array
    cosine: Array
    centre: Array
    duration: float
    base_hz: float = 0.1
    dwells: tuple[float, ...] = ()

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        s, ds, dds = self.clock(np.asarray(t, float))
        w = 2 * np.pi * self.base_hz * np.arange(1, self.sine.shape[1] + 1)
        sin, cos = np.sin(s[:, None] * w), np.cos(s[:, None] * w)
        q = sin @ (self.sine / w).T - cos @ (self.cosine / w).T + self.centre
        v = cos @ self.sine.T + sin @ self.cosine.T
        a = cos @ (self.cosine * w).T - sin @ (self.sine * w).T
        return q, v * ds[:, None], a * ds[:, None] ** 2 + v * dds[:, None]

    def clock(self, t: Array) -> tuple[Array, Array, Array]:
        """Path time and its derivatives: quintic steps of the rate up at 0, down and up at dwells, down at the end."""
        steps = [(0.0, 1), (self.duration - 1, -1)]
        for instant in self.dwells:
            steps += [(instant, -1), (instant + 2, 1)]
        s, ds, dds = np.zeros((3, *t.shape))
        for start, sign in steps:
            x = np.clip(t - start, 0, 1)
            s += sign * (x**4 * (2.5 - 3 * x + x**2) + np.maximum(t - start - 1, 0))
            ds += sign * x**3 * (10 - 15 * x + 6 * x**2)
            dds += sign * 30 * x**2 * (1 - x) ** 2
        return s, ds, dds


def draw_fourier(
    chain: Chain, rng: np.random.Generator, duration: float = 60.0, dwells: int = 0, harmonics: int = 5
) -> Fourier:
    """A random trajectory as large as the joint limits and the flange's workspace allow, 90 % of speed at most."""
    # One period at the full rate bounds position and speed; the clock's ramps add at most 1.875 q̇ to q̈.
    t = np.arange(1, 11, 0.05)
    instants = tuple(
        float(x) for x in 3 + (duration - 8) * (np.arange(dwells) + rng.uniform(0.2, 0.8, dwells)) / max(dwells, 1)
    )
    for _ in range(300):
        centre = rng.uniform(*(chain.range_ * np.r_[0.15, np.ones(chain.n - 1)][:, None]).T)
        sine, cosine = rng.normal(size=(2, chain.n, harmonics))
        shape = Fourier(sine, cosine, np.zeros(chain.n), duration, dwells=instants)
        q, v, a = replace(shape, duration=1e3, dwells=())(t)
        a = np.abs(a) + 1.875 * np.abs(v)
        room = np.where(q > 0, chain.range_[:, 1] - centre, centre - chain.range_[:, 0])
        scale = np.min(
            [
                np.min(0.97 * room / np.maximum(np.abs(q), 1e-9), 0),
                0.9 * chain.speed / np.abs(v).max(0),
                0.9 * chain.acceleration / np.abs(a).max(0),
            ],
            0,
        )
        for shrink in np.geomspace(1, 0.35, 8):
            tip = flange_position(chain, centre + shrink * scale * q)
            inside = (tip > chain.workspace[:, 0]) & (tip < chain.workspace[:, 1])
            if inside.all() and np.all(shrink * scale * np.abs(v).max(0) > 0.25 * chain.speed):
                factor = (shrink * scale)[:, None]
                return replace(shape, sine=sine * factor, cosine=cosine * factor, centre=centre)
    raise TruthError("trajectory: found none within the limits in 300 draws; ask for fewer dwells or another seed")


def _bristles(q: Array, travel: float = 2e-4) -> Array:
    """Deflection (nt,) of bristles over their largest: from one reversal of q (nt,) to the next it fades."""
    step = np.diff(q, prepend=q[:1])
    sense, gone = np.sign(step), np.cumsum(np.abs(step))
    moving = np.flatnonzero(sense)
    turns = moving[np.flatnonzero(np.diff(sense[moving], prepend=0))]
    out, z = np.zeros(len(q)), 0.0
    for start, end in zip(turns, [*turns[1:], len(q)], strict=True):
        since = gone[start:end] - (gone[start - 1] if start else 0.0)
        out[start:end] = sense[start] + (z - sense[start]) * np.exp(-since / travel)
        z = out[end - 1]
    return out


def sampled(time: Array, q: Array) -> Trajectory:
    """Trajectory through given positions q (nt, n) at `time` (nt,) s, as a quintic spline."""
    spline = make_interp_spline(time, q, k=5)
    first, second = spline.derivative(1), spline.derivative(2)
    return lambda t: (spline(t), first(t), second(t))


@dataclass(frozen=True)
class Log:
    """How motion is recorded. Torque noise N·m at the gear output: white, and first-order coloured.

    `friction`: "coulomb" (sgn q̇), "lugre" (bristles without damping, exponential in travel) or "slip" (60 elements
    over two decades of presliding). `compensator`: "series" (Σ B_l cos lq) or "gas" (a gas spring fitted to it).
    `ripple` N·m: a nuisance at a low order per joint. `counts` of the encoder per motor turn.
    """

    rate_hz: float = 250.0
    white: float = 10.0
    coloured: float = 5.0
    colour_s: float = 0.1
    ripple: float = 0.0
    counts: int = 4096
    friction: str = "coulomb"
    compensator: str = "series"
    link_encoder: bool = False


@dataclass(frozen=True)
class Run:
    """One run of the log: `start` s on the campaign's clock; times (nt,) from 0."""

    name: str
    trajectory: Trajectory
    time: Array
    start: float
    text: str = ""


@dataclass(frozen=True)
class Record:
    """One recorded run, all (nt, n), and its noise-free parts by name."""

    position: Array
    torque: Array
    link_position: Array | None
    parts: dict[str, Array] = field(repr=False)


def motor_torque(truth: Truth, run: Run, log: Log) -> tuple[Array, Array, dict[str, Array]]:
    """Link and motor angles (nt, n) and the parts of the noise-free torque at the run's times."""
    late = sum(e["delay"] for e in truth.effects if e.site == "log")
    q, v, a = run.trajectory(run.time)
    twist, parts = _torque(truth, log, run, q, v, a)
    if late:  # the torque of a moment ago; before the start the robot stood
        _, parts = _torque(truth, log, run, *run.trajectory(np.maximum(run.time - late, 0)))
    return q - twist, q, parts


def _torque(truth: Truth, log: Log, run: Run, q: Array, v: Array, a: Array) -> tuple[Array, dict[str, Array]]:
    chain, clock = truth.chain, run.start + run.time
    of = {kind: [e for e in truth.effects if e.kind == kind] for kind in {e.kind for e in truth.effects}}
    carried = tuple(loaded(link, i, chain, of.get("payload", [])) for i, link in enumerate(chain.links))
    gravity = chain.gravity
    for e in of.get("gravity_direction", []):  # what a plumb line shows on a foot that leans
        (sa, sb), (ca, cb) = np.sin(e.array("angles")), np.cos(e.array("angles"))
        gravity = np.linalg.norm(gravity) * np.array([sb, -cb * sa, -cb * ca])
    parts = {
        "links": inverse_dynamics(replace(chain, links=carried), q, v, a, gravity),
        "compensator": compensator(chain, q, log.compensator),
    }
    for e in of.get("gravity_compensator", []):
        parts["compensator"][:, e.joint] += cosines(e.array("coefficients"), q[:, e.joint])
    load = parts["links"] + parts["compensator"]

    twist = np.zeros(q.shape)
    gap = np.zeros(chain.n)
    for e in of.get("backlash", []):
        gap[e.joint] = e["gap"]
    if log.link_encoder or gap.any():
        # The servo keeps the motor on its path; the link lags by what the gear's load twists it, quasi-statically.
        # It crosses the gap while the load is within ±30 N·m.
        twist = load / chain.stiffness[:, 0] + gap / 2 * np.tanh(load / 30)
    rotor = chain.gear_ratio**2 * chain.rotor_inertia
    for e in of.get("rotor_inertia", []):
        rotor[e.joint] += e["inertia"]
    parts["rotors"] = rotor * a

    parts["friction"] = friction(truth, log, of, q, v, load, clock)
    extra = np.zeros(q.shape)
    for e in of.get("cable_stiffness", []):
        extra[:, e.joint] += e["stiffness"] * (q[:, e.joint] - e["rest"])
    for e in of.get("torque_ripple", []):
        extra[:, e.joint] += e["amplitude"] * np.sin(e["order"] * q[:, e.joint] + e["phase"])
    for e in of.get("hysteresis", []):
        extra[:, e.joint] += slip(q[:, e.joint], e.array("stiffness"), e.array("yield_torque"))
    for e in of.get("joint_coupling", []):
        # Rotor j turns with its own axis and with `ratio` times axis i: its inertia and friction act on both.
        i, j, ratio = e.joint, int(e["from"]) - 1, e["ratio"]
        inertia = e.parameters.get("inertia", rotor[j])
        viscous, dry = e.parameters.get("friction", chain.viscous[j]), e.parameters.get("coulomb", chain.coulomb[j])
        both, both_v, both_a = (x[:, [j]] + ratio * x[:, [i]] for x in (q, v, a))
        torque = (inertia * both_a + viscous * both_v + dry * direction(both, both_v, log.friction))[:, 0]
        alone = dry * direction(q[:, [j]], v[:, [j]], log.friction)[:, 0]
        extra[:, i] += ratio * torque
        extra[:, j] += torque - (inertia * a[:, j] + viscous * v[:, j] + alone)
    if log.ripple:
        draw = np.random.default_rng([truth.seed or 0, 1])
        order, phase = draw.uniform(3, 12, chain.n), draw.uniform(0, 2 * np.pi, chain.n)
        extra += log.ripple * np.sin(order * q + phase)
    parts["extra"] = extra
    gain = np.ones(chain.n)
    for e in of.get("torque_constant", []):
        gain[e.joint] *= e["gain"]
    return twist, {name: part * gain for name, part in parts.items()}


def friction(
    truth: Truth, log: Log, of: dict[str, list[Effect]], q: Array, v: Array, load: Array, clock: Array
) -> Array:
    """Friction torque (nt, n) of the drives, with every friction effect of the truth."""
    chain = truth.chain
    level = np.tile(chain.coulomb, (len(q), 1))
    viscous = np.tile(chain.viscous, (len(q), 1))
    warm = np.ones(q.shape)
    tilt, lean = np.zeros(chain.n), np.zeros(chain.n)
    for e in of.get("coulomb_friction", []):
        level[:, e.joint] += e["torque"]
    for e in of.get("viscous_friction", []):
        viscous[:, e.joint] += e["coefficient"]
    for e in of.get("stribeck_friction", []):
        level[:, e.joint] += e["static_excess"] * np.exp(-((v[:, e.joint] / e["velocity"]) ** 2))
    for e in of.get("load_dependent_friction", []):
        level[:, e.joint] += e["coefficient"] * np.abs(load[:, e.joint])
    for e in of.get("quadratic_friction", []):
        viscous[:, e.joint] += e["coefficient"] * np.abs(v[:, e.joint])
    for e in of.get("position_friction", []):  # a worn stretch: never less than no friction at all
        level[:, e.joint] += e["torque"] * (1 + np.sin(e["order"] * q[:, e.joint] + e["phase"])) / 2
    for e in of.get("asymmetric_friction", []):
        tilt[e.joint] += e["torque_difference"] / 2
        lean[e.joint] += e["viscous_difference"] / 2
    for e in of.get("friction_drift", []):
        warm[:, e.joint] += e["amplitude"] * np.exp(-clock / e["time_constant"])
    sense = direction(q, v, log.friction)
    return warm * (level * sense + viscous * v + tilt * np.abs(sense) + lean * np.abs(v))


def direction(q: Array, v: Array, law: str) -> Array:
    """Normalised dry friction (nt, n), ±1 in steady sliding; with a memory its history starts relaxed."""
    if law == "coulomb":
        return np.sign(v)
    if law == "lugre":
        return np.stack([_bristles(one) for one in q.T], -1)
    if law == "slip":
        travel = np.geomspace(2e-5, 2e-3, 60)
        share = np.full(60, 1 / 60)
        return np.stack([slip(one, share / travel, share) for one in q.T], -1)
    raise TruthError(f"friction {law!r}: expected coulomb, lugre or slip")


def slip(x: Array, stiffness: Array, yield_torque: Array) -> Array:
    """Torque (nt,) of parallel elastic–perfectly-plastic elements along the path x (nt,), relaxed at its start."""
    push = np.diff(x, prepend=x[0])[:, None] * stiffness
    out, torque = np.empty(len(x)), np.zeros(len(stiffness))
    for k in range(len(x)):
        torque = np.minimum(np.maximum(torque + push[k], -yield_torque), yield_torque)
        out[k] = torque.sum()
    return out


def cosines(coefficients: Array, q: Array) -> Array:
    order = np.arange(1, len(coefficients) + 1)
    return np.cos(q[:, None] * order) @ coefficients


def compensator(chain: Chain, q: Array, law: str) -> Array:
    """Torque (nt, n) that the compensator adds to the motors'."""
    out = np.zeros(q.shape)
    for i in np.flatnonzero(np.any(chain.compensator, axis=1)):
        if law == "series":
            out[:, i] = cosines(chain.compensator[i], q[:, i])
        elif law == "gas":
            grid = np.linspace(chain.range_[i, 0], chain.range_[i, 1], 200)
            wanted, shape = cosines(chain.compensator[i], grid), gas_spring(grid)
            out[:, i] = gas_spring(q[:, i]) * (wanted @ shape) / (shape @ shape)
        else:
            raise TruthError(f"compensator {law!r}: expected series or gas")
    return out


def gas_spring(q: Array) -> Array:
    """Moment of a gas-charged cylinder between a foot on the shoulder, below joint 2, and a pin on the arm.

    The arm's fall stretches the cylinder and compresses the gas, F ∝ (1 − stretch/1.39 m)^−1.3; it unloads the motor.
    The lengths make its shape that of Table A1's series to 17 N·m RMS; scale is the caller's.
    """
    foot, pin, turned = 0.75, 0.209, 0.006
    length = np.sqrt(foot**2 + pin**2 - 2 * foot * pin * np.sin(q + turned))
    shortest = abs(foot - pin)
    force = (1 - (length - shortest) / 1.387) ** -1.3
    return -force * foot * pin * np.cos(q + turned) / length


def record(truth: Truth, run: Run, log: Log, rng: np.random.Generator) -> Record:
    """What the controller's trace holds of one run."""
    link, motor, parts = motor_torque(truth, run, log)
    for e in truth.effects:
        if e.kind == "joint_offset":  # the axis goes its way, its encoder says less
            link, motor = (x - e["angle"] * np.eye(truth.chain.n)[e.joint] for x in (link, motor))
    count = 2 * np.pi / (truth.chain.gear_ratio * log.counts)
    keep = np.exp(-1 / (log.colour_s * log.rate_hz))
    colour = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=link.shape), axis=0)
    noise = log.white * rng.normal(size=link.shape) + log.coloured * colour
    seen = log.link_encoder or any(e.kind == "backlash" for e in truth.effects)
    return Record(
        np.round(motor / count) * count,
        sum(parts.values(), noise),
        link if seen else None,
        parts,
    )


def write_log(
    path: Path,
    truth: Truth,
    runs: tuple[Run, ...],
    log: Log,
    rng: np.random.Generator,
    *,
    robot: str | None = "kr90",
    answer: Path | None = None,
) -> None:
    """Record the runs into `path` (`.h5`), and the truth into `answer` when given; nothing is half-written."""
    for e in truth.effects:
        if EFFECTS[e.kind].shows not in ("log", "both") and e.site != "log":
            raise TruthError(
                f"{e.kind}@{e.site}: expected an effect that a motion log shows; this one is for `campaign`"
            )
    aside = path.with_name(path.name + ".part")
    try:
        with h5py.File(aside, "w") as file:
            file.attrs.update(format="motion-log", version=1)
            if robot:
                file.attrs["robot"] = robot
            for run in runs:
                group = file.create_group(f"runs/{run.name}")
                group.attrs.update(sample_rate_hz=log.rate_hz, comment=run.text)
                found = record(truth, run, log, rng)
                group["time"] = run.start + run.time
                group["position"], group["torque"] = found.position, found.torque
                if found.link_position is not None:
                    group["link_position"] = found.link_position
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    if answer:
        write_answer(answer, {"truth": truth, "log": log, "runs": [(run.name, run.start) for run in runs]})


def read_positions(path: Path) -> list[tuple[str, Array, Array]]:
    """(name, time, q) of each run in a CSV (`time,q1..qn`) or an HDF5 with `runs/<name>/time, position`."""
    if path.suffix == ".csv":
        table = np.genfromtxt(path, delimiter=",", names=True)
        names = [n for n in table.dtype.names or () if n.startswith("q")]
        if "time" not in (table.dtype.names or ()) or not names:
            raise TruthError(f"{path}: expected a CSV with header time,q1,…,qn")
        return [("run1", table["time"], np.stack([table[n] for n in names], -1))]
    with h5py.File(path) as file:
        if "runs" not in file:
            raise TruthError(f"{path}: expected runs/<name>/time and position")
        return [(name, run["time"][:], run["position"][:]) for name, run in file["runs"].items()]
