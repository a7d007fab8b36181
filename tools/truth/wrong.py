"""Ways in which a description or a recording is wrong, beyond what either says of itself.

A `World` is a robot and how it is recorded; a way changes it and says what the right answer is. What belongs to the
robot is changed before anything is recorded, what belongs to the recording in the file. `record` writes the files.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.signal import lfilter

from tools.truth.chain import Array, Chain, Link, Tolerances, perturb
from tools.truth.effects import Effect
from tools.truth.motion import Log, Run, Trajectory, write_log
from tools.truth.recording import MAINS_HZ, Channel, HammerTest, Posture, Truth, h1, write_campaign
from tools.truth.robots import Machine

Spoil = Callable[[h5py.File, np.random.Generator], None]


@dataclass
class World:
    """A robot and its recording: `hammer` the truth that is struck, `log` the one that moves; `None`: not recorded.

    `points`: of the blows, those that are struck. `apart`: truths that part of the recording comes from instead: names
    of postures or runs. `roving`: mass kg of a sensor that goes from node to node. `raw`: what happens to time signals
    before FRFs are made of them; `spoilt`: to the written campaign and log.
    """

    machine: Machine
    postures: tuple[Posture, ...] = ()
    test: HammerTest = field(default_factory=HammerTest)
    points: tuple[int, ...] = ()
    hammer: Truth | None = None
    log: Truth | None = None
    how: Log = field(default_factory=Log)
    runs: tuple[Run, ...] = ()
    apart: dict[str, Truth] = field(default_factory=dict)
    roving: float = 0.0
    raw: list[Spoil] = field(default_factory=list)
    spoilt: dict[str, list[Spoil]] = field(default_factory=lambda: {"hammer": [], "log": []})

    def change(self, edit: Callable[[Chain], Chain]) -> None:
        """The robot's chain, in whatever is recorded of it."""
        if self.hammer:
            self.hammer = replace(self.hammer, chain=edit(self.hammer.chain))
        if self.log:
            self.log = replace(self.log, chain=edit(self.log.chain))

    def change_link(self, i: int, edit: Callable[[Link], Link]) -> None:
        """Link i, from 0."""

        def edited(chain: Chain) -> Chain:
            return replace(chain, links=tuple(edit(k) if j == i else k for j, k in enumerate(chain.links)))

        self.change(edited)

    def change_array(self, name: str, index: tuple[int, ...], edit: Callable[[float], float]) -> None:
        """One number of an array of the chain."""

        def edited(chain: Chain) -> Chain:
            values = getattr(chain, name).copy()
            values[index] = edit(float(values[index]))
            return replace(chain, **{name: values})

        self.change(edited)


@dataclass(frozen=True)
class Cause:
    """The right answer.

    `names`: hypotheses EFFECT@SITE, `*` for anything, any of which is right; `triage`: kinds of fault of the recording,
    likewise. `fair`: names that are not the cause, but not wrong either. None of names and triage: nothing is wrong.
    `values`: numbers that the answer holds, by name. `size`: how far off, for people.
    """

    names: tuple[str, ...] = ()
    triage: tuple[str, ...] = ()
    fair: tuple[str, ...] = ()
    values: dict[str, float] = field(default_factory=dict)
    size: str = ""


@dataclass(frozen=True)
class Way:
    """A way of being wrong: what it does to a world, where it is met, and effects that must not be concealed beside."""

    spoil: Callable[[World, np.random.Generator], Cause]
    recordings: tuple[str, ...]
    clash: tuple[str, ...] = ()
    time: bool = False


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _direction(rng: np.random.Generator, *, flat: bool = False) -> Array:
    """A random unit vector; `flat`: at right angles to z."""
    v = rng.normal(size=3) * [1, 1, 0 if flat else 1]
    return np.asarray(v / np.linalg.norm(v))


def _outer(world: World, rng: np.random.Generator) -> int:
    """A link from 0; in a log one whose weight or swing the motors feel."""
    return int(rng.integers(1 if world.log else 0, world.machine.chain.n))


# --- the description ------------------------------------------------------------------------------------------------


def mass(world: World, rng: np.random.Generator) -> Cause:
    i, factor = _outer(world, rng), 1 + _sign(rng) * rng.uniform(0.12, 0.25)
    world.change_link(i, lambda link: replace(link, mass=link.mass * factor))
    return _link_cause(world, i, "mass", f"{factor - 1:+.0%}")


def com(world: World, rng: np.random.Generator) -> Cause:
    """Three to five tolerances off, of one link; at right angles to the axis in a log, which feels nothing else."""
    i = _outer(world, rng)
    step = rng.uniform(3, 5) * world.machine.tolerances.com * _direction(rng, flat=world.log is not None)
    world.change_link(i, lambda link: replace(link, com=link.com + step))
    return _link_cause(world, i, "com", f"{1e3 * np.linalg.norm(step):.0f} mm")


def com_all(world: World, rng: np.random.Generator) -> Cause:
    for i in range(world.machine.chain.n):
        step = rng.uniform(3, 5) * world.machine.tolerances.com * _direction(rng)
        world.change_link(i, lambda link, step=step: replace(link, com=link.com + step))  # type: ignore[misc]
    return Cause(("parameter@link*.com",), fair=("parameter@link*",), size="all links, 3 to 5 tolerances")


def inertia(world: World, rng: np.random.Generator) -> Cause:
    i, factor = _outer(world, rng), 1 + _sign(rng) * rng.uniform(0.12, 0.3)
    world.change_link(i, lambda link: replace(link, inertia=link.inertia * factor))
    return _link_cause(world, i, "inertia", f"{factor - 1:+.0%}")


def inertia_all(world: World, rng: np.random.Generator) -> Cause:
    factor = 1 + _sign(rng) * rng.uniform(0.12, 0.3)
    for i in range(world.machine.chain.n):
        world.change_link(i, lambda link: replace(link, inertia=link.inertia * factor))
    return Cause(("parameter@link*.inertia",), fair=("parameter@link*",), size=f"all links {factor - 1:+.0%}")


def _link_cause(world: World, i: int, group: str, size: str) -> Cause:
    """A link's number; its other numbers, and a load on it, say nearly the same."""
    last = i == world.machine.chain.n - 1
    loads = ("payload@flange",) if last else ()
    truth = world.hammer or world.log
    assert truth is not None
    link, values = truth.chain.links[i], {}
    if group == "mass":
        values = {"mass": link.mass}
    elif group == "com":
        values = {f"com.{axis}": float(x) for axis, x in zip("xyz", link.com, strict=True)}
    fair = (f"payload@link{i + 1}", *loads, f"parameter@link{i + 1}.*")
    return Cause((f"parameter@link{i + 1}.{group}",), fair=fair, values=values, size=f"link{i + 1} {size}")


def axis_length(world: World, rng: np.random.Generator) -> Cause:
    return _axis(world, rng, 0, "a", _sign(rng) * rng.uniform(0.010, 0.025) * world.machine.size)


def axis_offset(world: World, rng: np.random.Generator) -> Cause:
    return _axis(world, rng, 2, "d", _sign(rng) * rng.uniform(0.010, 0.025) * world.machine.size)


def axis_twist(world: World, rng: np.random.Generator) -> Cause:
    return _axis(world, rng, 1, "alpha", np.deg2rad(_sign(rng) * rng.uniform(0.7, 1.5)))


def _axis(world: World, rng: np.random.Generator, column: int, name: str, step: float) -> Cause:
    i = int(rng.integers(1, world.machine.chain.n))
    world.change_array("dh", (i, column), lambda x: x + step)
    truth = world.hammer or world.log
    assert truth is not None
    size = f"{np.rad2deg(step):+.1f}°" if name == "alpha" else f"{1e3 * step:+.0f} mm"
    return Cause(
        (f"parameter@axis{i + 1}.{name}",), fair=(f"parameter@axis{i + 1}.*",),
        values={name: float(truth.chain.dh[i, column])}, size=f"axis{i + 1} {size}",
    )  # fmt: skip


def joint_zero(world: World, rng: np.random.Generator) -> Cause:
    """Half a degree to one, in every posture and run."""
    i, angle = int(rng.integers(1, world.machine.chain.n)), np.deg2rad(_sign(rng) * rng.uniform(0.5, 1.0))
    step = angle * np.eye(world.machine.chain.n)[i]
    if world.hammer:
        error = {name: e + step for name, e in world.hammer.posture_error.items()}
        world.hammer = replace(world.hammer, posture_error=error)
    if world.log:
        world.runs = tuple(replace(run, trajectory=_shifted(run.trajectory, step)) for run in world.runs)
        world.spoilt["log"].append(_each_run(lambda run, _: _add(run, "position", -step)))
    names = (f"joint_offset@joint{i + 1}", f"parameter@joint{i + 1}.offset", f"parameter@axis{i + 1}.theta")
    return Cause(names, values={"angle": angle}, size=f"joint{i + 1} {np.rad2deg(angle):+.2f}°")


def _shifted(trajectory: Trajectory, step: Array) -> Trajectory:
    def moved(t: Array) -> tuple[Array, Array, Array]:
        q, v, a = trajectory(t)
        return q + step, v, a

    return moved


def springs(world: World, rng: np.random.Generator) -> Cause:
    """Three to ten deviations stiffer, or three to five softer."""
    i, a = int(rng.integers(world.machine.chain.n)), int(rng.integers(3))
    sigma = rng.uniform(3, 10) if rng.random() < 0.6 else -rng.uniform(3, 5)
    return _spring_cause(world, "stiffness", i, a, world.machine.tolerances.stiffness**sigma, sigma)


def dampers(world: World, rng: np.random.Generator) -> Cause:
    """Three to five deviations off, of a damper that the description does not call poorly known."""
    known = np.argwhere(world.machine.chain.damping >= world.machine.tolerances.poor_damping)
    i, a = (int(k) for k in known[rng.integers(len(known))])
    sigma = _sign(rng) * rng.uniform(3, 5)
    return _spring_cause(world, "damping", i, a, world.machine.tolerances.damping**sigma, sigma)


def _spring_cause(world: World, name: str, i: int, a: int, factor: float, sigma: float) -> Cause:
    described = float(getattr(world.machine.chain, name)[i, a])
    world.change_array(name, (i, a), lambda _: described * factor)
    site = f"joint{i + 1}.{'zxy'[a]}"
    soft = (f"servo_compliance@joint{i + 1}",) if a == 0 else (f"link_flexibility@link{i + 1}.{'zxy'[a]}",)
    yaw = ("base_compliance@base.rz",) if (i, a) == (0, 0) else ()
    fair = (f"structural_damping@{site}",) if name == "damping" else (*soft, *yaw, f"transverse_compliance@{site}")
    return Cause(
        (f"parameter@{site}.{name}",), fair=fair, values={name: described * factor}, size=f"{site} {sigma:+.1f} σ"
    )


def gravity_tilt(world: World, rng: np.random.Generator) -> Cause:
    """The foot leans one to two degrees."""
    angle, lean = np.deg2rad(rng.uniform(1, 2)), rng.uniform(0, 2 * np.pi)
    g = 9.81 * np.array([np.sin(angle) * np.cos(lean), np.sin(angle) * np.sin(lean), -np.cos(angle)])
    world.change(lambda chain: replace(chain, gravity=g))
    return Cause(("gravity_direction@base", "parameter@gravity*", "parameter@base*"), size=f"{np.rad2deg(angle):.1f}°")


def gear_ratio(world: World, rng: np.random.Generator) -> Cause:
    """Position is the motor's over the described ratio, torque the motor's times it."""
    i, factor = int(rng.integers(world.machine.chain.n)), 1 + _sign(rng) * rng.uniform(0.02, 0.05)

    def spoil(run: h5py.Group, _: np.random.Generator) -> None:
        turned = np.where(np.arange(world.machine.chain.n) == i, factor, 1.0)
        run["position"][...] *= turned
        run["torque"][...] /= turned

    world.spoilt["log"].append(_each_run(spoil))
    true = float(world.machine.chain.gear_ratio[i]) * factor
    site = f"joint{i + 1}"
    return Cause(
        (f"parameter@drive{i + 1}.gear_ratio",), fair=(f"torque_constant@{site}",), values={"gear_ratio": true},
        size=f"{site} {factor - 1:+.1%}",
    )  # fmt: skip


def rotor_inertia(world: World, rng: np.random.Generator) -> Cause:
    i, factor = int(rng.integers(world.machine.chain.n)), rng.uniform(1.4, 2.0)
    world.change_array("rotor_inertia", (i,), lambda x: x * factor)
    names = (f"rotor_inertia@joint{i + 1}", f"parameter@drive{i + 1}.rotor_inertia")
    fair = ("parameter@link1.inertia",) if i == 0 else ()
    return Cause(names, fair=fair, size=f"joint{i + 1} {factor - 1:+.0%}")


# --- the measurement ------------------------------------------------------------------------------------------------


def torque_gain(world: World, rng: np.random.Generator) -> Cause:
    gain = 1 + _sign(rng) * rng.uniform(0.05, 0.15)
    world.spoilt["log"].append(_each_run(lambda run, _: _scale(run, "torque", gain)))
    return Cause(
        ("parameter@torque_gain",), fair=("torque_constant@joint*",), values={"torque_gain": gain, "gain": gain},
        size=f"{gain - 1:+.0%}",
    )  # fmt: skip


def torque_drift(world: World, rng: np.random.Generator) -> Cause:
    """A torque constant that falls steadily over the campaign, at one joint."""
    i, slope = int(rng.integers(1, world.machine.chain.n)), rng.uniform(0.04, 0.10)
    end = world.runs[-1].start + float(world.runs[-1].time[-1])
    return _fading(world, [i], lambda t: 1 + slope * t / end, f"joint{i + 1} {slope:.0%} over the campaign")


def torque_warmup(world: World, rng: np.random.Generator) -> Cause:
    """Magnets warm and torque constants fall at all joints: more current for the same torque."""
    rise, constant = rng.uniform(0.03, 0.08), rng.uniform(60, 200)
    joints = list(range(world.machine.chain.n))
    return _fading(world, joints, lambda t: 1 + rise * (1 - np.exp(-t / constant)), f"all {rise:.0%}, {constant:.0f} s")


def _fading(world: World, joints: list[int], gain: Callable[[Array], Array], size: str) -> Cause:
    def spoil(run: h5py.Group, _: np.random.Generator) -> None:
        torque = run["torque"][()]
        torque[:, joints] *= gain(run["time"][()])[:, None]
        run["torque"][...] = torque

    world.spoilt["log"].append(_each_run(spoil))
    names = tuple(f"torque_constant@joint{i + 1}" for i in joints)
    return Cause((*names, "parameter@torque_gain"), ("torque_drift", "drift", "warm_up"), size=size)


def torque_filter(world: World, rng: np.random.Generator) -> Cause:
    cutoff = rng.uniform(5, 15)
    keep = np.exp(-2 * np.pi * cutoff / world.how.rate_hz)

    def spoil(run: h5py.Group, _: np.random.Generator) -> None:
        torque = run["torque"][()]
        run["torque"][...] = lfilter([1 - keep], [1, -keep], torque, axis=0, zi=keep * torque[:1])[0]

    world.spoilt["log"].append(_each_run(spoil))
    return Cause(("torque_filter@log",), values={"cutoff_hz": cutoff}, size=f"{cutoff:.0f} Hz")


def clock(world: World, rng: np.random.Generator) -> Cause:
    """Torque is sampled by a clock that runs slow against that of positions: samples slip."""
    rate = _sign(rng) * rng.uniform(3e-4, 1.5e-3)

    def spoil(run: h5py.Group, _: np.random.Generator) -> None:
        torque = run["torque"][()]
        index = np.round(np.arange(len(torque)) * (1 - rate)).astype(int)
        run["torque"][...] = torque[np.clip(index, 0, len(torque) - 1)]

    world.spoilt["log"].append(_each_run(spoil))
    return Cause((), ("clock",), fair=("time_delay@log",), size=f"{1e6 * rate:+.0f} ppm")


def reversed_torque(world: World, rng: np.random.Generator) -> Cause:
    i = int(rng.integers(world.machine.chain.n))
    world.spoilt["log"].append(_each_run(lambda run, _: _scale(run, "torque", np.where(np.arange(3) == i, -1.0, 1.0))))
    return Cause((), ("reversed_channel",), fair=(f"torque_constant@joint{i + 1}",), size=f"torque {i + 1}")


def swapped_torques(world: World, rng: np.random.Generator) -> Cause:
    i, j = sorted(int(k) for k in rng.choice(world.machine.chain.n, 2, replace=False))

    def spoil(run: h5py.Group, _: np.random.Generator) -> None:
        torque = run["torque"][()]
        torque[:, [i, j]] = torque[:, [j, i]]
        run["torque"][...] = torque

    world.spoilt["log"].append(_each_run(spoil))
    return Cause((), ("swapped_channels", "label"), size=f"torques {i + 1} and {j + 1}")


def degrees(world: World, rng: np.random.Generator) -> Cause:
    world.spoilt["log"].append(_each_run(lambda run, _: _scale(run, "position", 180 / np.pi)))
    return Cause((), ("unit",), size="positions in degrees")


def slow_run(world: World, rng: np.random.Generator) -> Cause:
    """One run at a quarter of the speed, of a robot that lacks nothing."""
    slow, run = 4.0, world.runs[0]
    world.runs = (replace(run, trajectory=_slowed(run.trajectory, slow)),)
    return Cause(size="one run, a quarter of the speed")


def _slowed(trajectory: Trajectory, factor: float) -> Trajectory:
    def slow(t: Array) -> tuple[Array, Array, Array]:
        q, v, a = trajectory(t / factor)
        return q, v / factor, a / factor**2

    return slow


def other_robot(world: World, rng: np.random.Generator) -> Cause:
    """Part of the recordings is of another robot of the type: half of the postures, the last run, or the log."""
    wide = Tolerances(
        stiffness=2.0, mass=0.3, com=0.08 * world.machine.size, inertia=0.3, rotor=0.5, compensator=0.3, friction=2.0,
        poor_damping=world.machine.tolerances.poor_damping,
    )  # fmt: skip
    other = perturb(world.machine.chain, rng, wide)
    if world.hammer and world.log:
        world.log = replace(world.log, chain=other)
        return Cause((), ("other_robot",), size="the log")
    truth = world.hammer or world.log
    assert truth is not None
    names = [p.name for p in world.postures] if world.hammer else [r.name for r in world.runs]
    chosen = names[len(names) // 2 :] if world.hammer else names[-1:]
    world.apart = dict.fromkeys(chosen, replace(truth, chain=other))
    return Cause((), ("other_robot",), size=", ".join(chosen))


def mislabelled(world: World, rng: np.random.Generator) -> Cause:
    """One posture's angles are written down wrongly."""
    name, i = str(rng.choice([p.name for p in world.postures])), int(rng.integers(1, world.machine.chain.n))
    step = _sign(rng) * float(rng.integers(3, 11))

    def spoil(file: h5py.File, _: np.random.Generator) -> None:
        group = file[f"postures/{name}"]
        q = group.attrs["q_deg"].copy()
        q[i] += step
        group.attrs["q_deg"] = q

    world.spoilt["hammer"].append(spoil)
    fair = ("parameter@posture",)  # names what is wrong, where triage does not
    return Cause((), ("posture", "label", "mislabelled_posture"), fair, size=f"{name} q{i + 1} {step:+.0f}°")


def postures_off(world: World, rng: np.random.Generator) -> Cause:
    """Every angle of every posture is off by four to six tolerances."""
    assert world.hammer is not None
    width, n = np.deg2rad(world.machine.tolerances.posture_deg), world.machine.chain.n
    error = {p.name: width * rng.uniform(4, 6, n) * rng.choice([-1.0, 1.0], n) for p in world.postures}
    world.hammer = replace(world.hammer, posture_error=error)
    return Cause(("parameter@posture*",), ("posture", "postures", "label"), size="all angles, 0.8 to 1.2°")


def sensor_position(world: World, rng: np.random.Generator) -> Cause:
    node, step = world.machine.node, rng.uniform(0.005, 0.010) * _direction(rng)
    return _point(world, f"sensor:{node}", node, world.machine.sensors[0], step)


def blow_position(world: World, rng: np.random.Generator) -> Cause:
    """One blow lands two to four centimetres beside the point, on the same face."""
    blow = world.machine.hammer[int(rng.choice(world.points[:-3]))]
    step = rng.uniform(0.02, 0.04) * world.machine.size * _direction(rng)
    step = step - (step @ blow.direction) * blow.direction
    return _point(world, f"hammer:{blow.label}", blow.node, blow, step)


def _point(world: World, site: str, node: str, point: Channel, step: Array) -> Cause:
    assert world.hammer is not None
    world.hammer = replace(world.hammer, moved={**world.hammer.moved, site: step})
    true = {f"position.{a}": float(x) for a, x in zip("xyz", point.position + step, strict=True)}
    size = f"{site} {1e3 * np.linalg.norm(step):.0f} mm"
    return Cause((f"parameter@node:{node}.position",), ("position",), values=true, size=size)


def blows_scattered(world: World, rng: np.random.Generator) -> Cause:
    """Every blow lands five to ten millimetres from where it should."""
    assert world.hammer is not None
    struck = [world.machine.hammer[k] for k in world.points]
    moved = {f"hammer:{c.label}": rng.uniform(0.005, 0.010) * _direction(rng) for c in struck}
    world.hammer = replace(world.hammer, moved={**world.hammer.moved, **moved})
    return Cause(("parameter@node:*.position",), ("position", "points"), size="all blows, 5 to 10 mm")


def sensor_direction(world: World, rng: np.random.Generator) -> Cause:
    assert world.hammer is not None
    angles = np.deg2rad(rng.uniform(2, 6)) * _direction(rng)
    effect = Effect("sensor_misalignment", f"sensor:{world.machine.node}", {"angles": angles.tolist()})
    world.hammer = replace(world.hammer, effects=(*world.hammer.effects, effect))
    size = f"{np.rad2deg(np.linalg.norm(angles)):.1f}°"
    return Cause((f"{effect.kind}@{effect.site}", f"parameter@node:{world.machine.node}.direction"), size=size)


def unit_g_channel(world: World, rng: np.random.Generator) -> Cause:
    k = int(rng.integers(3))
    return _gained(world, [k], 1 / 9.80665, "unit", "in g")


def unit_g_all(world: World, rng: np.random.Generator) -> Cause:
    return _gained(world, [0, 1, 2], 1 / 9.80665, "unit", "all in g")


def unit_mm(world: World, rng: np.random.Generator) -> Cause:
    return _gained(world, [0, 1, 2], 1e3, "unit", "all in mm/s²")


def reversed_channel(world: World, rng: np.random.Generator) -> Cause:
    return _gained(world, [int(rng.integers(3))], -1.0, "reversed_channel", "reversed")


def _gained(world: World, channels: list[int], gain: float, kind: str, size: str) -> Cause:
    labels = [world.machine.sensors[k].label for k in channels]
    world.spoilt["hammer"].append(_each_posture(lambda group, _: _scale_channels(group, channels, gain)))
    fair = tuple(f"sensor_gain@sensor:{label}" for label in labels)
    return Cause((), (kind,), fair=fair, size=size if len(labels) > 1 else f"{labels[0]} {size}")


def _scale_channels(group: h5py.Group, channels: list[int], gain: float) -> None:
    frf = group["frf"][()]
    frf[:, channels] *= gain
    group["frf"][...] = frf


def swapped_channels(world: World, rng: np.random.Generator) -> Cause:
    i, j = sorted(int(k) for k in rng.choice(3, 2, replace=False))

    def spoil(group: h5py.Group, _: np.random.Generator) -> None:
        for key in ("frf", "coherence"):
            values = group[key][()]
            values[:, [i, j]] = values[:, [j, i]]
            group[key][...] = values

    world.spoilt["hammer"].append(_each_posture(spoil))
    labels = [world.machine.sensors[k].label for k in (i, j)]
    fair = (f"sensor_misalignment@sensor:{world.machine.node}",)
    return Cause((), ("swapped_channels", "label"), fair=fair, size=" and ".join(labels))


def noise_understated(world: World, rng: np.random.Generator) -> Cause:
    """Coherence states a third of the noise."""

    def spoil(group: h5py.Group, _: np.random.Generator) -> None:
        odds = (1 / np.clip(group["coherence"][()], 1e-9, 1) - 1) / 9
        group["coherence"][...] = 1 / (1 + odds)

    world.spoilt["hammer"].append(_each_posture(spoil))
    return Cause((), ("noise_understated",), size="3 times")


HUM_SHARE = 0.3, 1.0  # of the largest, sensor by sensor


def hum(world: World, rng: np.random.Generator) -> Cause:
    """Mains at 50 Hz in the sensors' cables, in the band; its phase is whatever it is at every blow."""
    machine = world.machine
    world.test = replace(
        world.test, hits=world.test.averages, coherence="estimated", window=10 * world.test.spacing_hz,
        lines=int((60 - world.test.start_hz) / machine.spacing_hz),
    )  # fmt: skip
    size = rng.uniform(0.005, 0.03)
    world.test = replace(world.test, hum=size * np.sqrt(np.mean(np.square(np.linspace(*HUM_SHARE)))))

    def spoil(file: h5py.File, rng: np.random.Generator) -> None:
        for group in file["postures"].values():
            raw = group["hits"]
            force, response = raw["force"][()].astype(float), raw["response"][()].astype(float)
            t = np.arange(response.shape[-1]) / raw.attrs["sample_rate_hz"]
            phase = rng.uniform(0, 2 * np.pi, response.shape[:2])[:, :, None, None]
            share = rng.uniform(*HUM_SHARE, response.shape[2])[None, None, :, None]
            response += size * share * np.sin(2 * np.pi * MAINS_HZ * t + phase)
            frf, coherence = h1(force, response, world.test, float(raw.attrs["pretrigger_s"]))
            group["frf"][...], group["coherence"][...] = frf, coherence

    world.raw.append(spoil)
    return Cause((), ("hum",), size=f"{size:.3f} m/s²")


def leakage(world: World, rng: np.random.Generator) -> Cause:
    """A second of record, no window: the robot still rings at its end."""
    spacing = float(rng.choice([0.5, 1.0]))
    band = world.test.lines * world.test.spacing_hz
    world.test = replace(
        world.test, hits=world.test.averages, coherence="estimated", window=0.0, spacing_hz=spacing,
        lines=int(band / spacing), double_hits=0.0,
    )  # fmt: skip
    return Cause((), ("leakage",), size=f"record of {1 / spacing:g} s")


def floor_mode(world: World, rng: np.random.Generator) -> Cause:
    """The robot stands on a slab of its own that rocks and bounces in the band."""
    assert world.hammer is not None
    s = world.machine.size
    own = sum(link.mass for link in world.machine.chain.links)
    slab, side = own * rng.uniform(2.5, 5), 2.2 * s
    turn = slab * side**2 / 12
    low, high = world.test.start_hz + 5, world.test.start_hz + 0.8 * world.test.lines * world.test.spacing_hz
    with_robot = turn + own * (1.1 * s) ** 2
    parameters: dict[str, Any] = {"mass": slab, "inertia": [turn, turn, 2 * turn], "damping_ratio": 0.03}
    for name in ("rx", "ry"):
        parameters[name] = with_robot * (2 * np.pi * rng.uniform(low, high)) ** 2
    parameters["z"] = (slab + own) * (2 * np.pi * rng.uniform(low, high)) ** 2
    world.hammer = replace(world.hammer, effects=(*world.hammer.effects, Effect("floor_mode", "base", parameters)))
    values = {"mass": slab}
    return Cause(("floor_mode@base",), fair=("base_compliance@base.*",), values=values, size=f"slab of {slab:.0f} kg")


def roving_mass(world: World, rng: np.random.Generator) -> Cause:
    """The hammer stays at the flange, a heavy block with the sensor goes round."""
    total = sum(link.mass for link in world.machine.chain.links)
    world.roving = total * rng.uniform(0.003, 0.008)
    return Cause(("sensor_mass@sensor:*",), ("roving_mass",), size=f"{world.roving:.1f} kg")


# --- nothing wrong --------------------------------------------------------------------------------------------------


def nothing(world: World, rng: np.random.Generator) -> Cause:
    return Cause(size="nothing")


def one_posture(world: World, rng: np.random.Generator) -> Cause:
    world.postures = world.postures[:1]
    return Cause(size="one posture")


def narrow_band(world: World, rng: np.random.Generator) -> Cause:
    world.test = replace(world.test, lines=world.test.lines // 3)
    world.points = world.points[-5:]
    return Cause(size="a third of the band, five blows")


def thinned(world: World, rng: np.random.Generator) -> Cause:
    """Every fourth line is kept: the record is longer than the spacing tells."""

    def spoil(group: h5py.Group, _: np.random.Generator) -> None:
        for key in ("frequency", "frf", "coherence"):
            values, attributes = group[key][()][::4], dict(group[key].attrs)
            del group[key]
            group[key] = values
            group[key].attrs.update(attributes)

    world.spoilt["hammer"].append(_each_posture(spoil))
    return Cause(size="one line in four")


BOTH = ("hammer", "log")
TURNED = ("sensor_misalignment", "sensor_gain")
WAYS: dict[str, Way] = {
    "mass": Way(mass, BOTH, ("payload",)),
    "com": Way(com, BOTH, ("payload",)),
    "com_all": Way(com_all, ("hammer",), ("payload",)),
    "inertia": Way(inertia, BOTH, ("payload",)),
    "inertia_all": Way(inertia_all, ("hammer",), ("payload",)),
    "axis_length": Way(axis_length, BOTH),
    "axis_offset": Way(axis_offset, ("hammer",)),
    "axis_twist": Way(axis_twist, BOTH),
    "joint_zero": Way(joint_zero, BOTH),
    "springs": Way(springs, ("hammer",), ("servo_compliance", "link_flexibility", "transverse_compliance")),
    "dampers": Way(dampers, ("hammer",), ("structural_damping", "transverse_compliance")),
    "sensor_position": Way(sensor_position, ("hammer",)),
    "blow_position": Way(blow_position, ("hammer",)),
    "blows_scattered": Way(blows_scattered, ("hammer",)),
    "sensor_direction": Way(sensor_direction, ("hammer",), TURNED),
    "unit_g_channel": Way(unit_g_channel, ("hammer",), TURNED),
    "unit_g_all": Way(unit_g_all, ("hammer",), TURNED),
    "unit_mm": Way(unit_mm, ("hammer",), TURNED),
    "reversed_channel": Way(reversed_channel, ("hammer",), TURNED),
    "swapped_channels": Way(swapped_channels, ("hammer",), TURNED),
    "postures_off": Way(postures_off, ("hammer",)),
    "mislabelled": Way(mislabelled, ("hammer",)),
    "noise_understated": Way(noise_understated, ("hammer",)),
    "hum": Way(hum, ("hammer",), time=True),
    "leakage": Way(leakage, ("hammer",), time=True),
    "floor_mode": Way(floor_mode, ("hammer",), ("base_compliance",), time=True),
    "roving_mass": Way(roving_mass, ("hammer",), ("payload", *TURNED)),
    "gravity_tilt": Way(gravity_tilt, ("log",), ("payload", "gravity_compensator", "cable_stiffness")),
    "gear_ratio": Way(gear_ratio, ("log",), ("torque_constant",)),
    "rotor_inertia": Way(rotor_inertia, ("log",), ("joint_coupling",)),
    "torque_gain": Way(torque_gain, ("log",), ("torque_constant", "payload")),
    "torque_drift": Way(torque_drift, ("log",), ("torque_constant", "friction_drift")),
    "torque_warmup": Way(torque_warmup, ("log",), ("torque_constant", "friction_drift")),
    "torque_filter": Way(torque_filter, ("log",), ("time_delay",)),
    "clock": Way(clock, ("log",), ("time_delay",)),
    "reversed_torque": Way(reversed_torque, ("log",)),
    "swapped_torques": Way(swapped_torques, ("log",)),
    "degrees": Way(degrees, ("log",)),
    "other_robot": Way(other_robot, ("hammer", "log", "both")),
    "slow_run": Way(slow_run, ("log",)),
    "one_posture": Way(one_posture, ("hammer",)),
    "narrow_band": Way(narrow_band, ("hammer",)),
    "thinned": Way(thinned, ("hammer",)),
    "nothing": Way(nothing, ("hammer", "log")),
}
LACKING_NOTHING = ("slow_run", "one_posture", "narrow_band", "thinned", "nothing")


# --- recording ------------------------------------------------------------------------------------------------------


def _each_posture(spoil: Callable[[h5py.Group, np.random.Generator], None]) -> Spoil:
    def every(file: h5py.File, rng: np.random.Generator) -> None:
        for group in file["postures"].values():
            spoil(group, rng)

    return every


def _each_run(spoil: Callable[[h5py.Group, np.random.Generator], None]) -> Spoil:
    def every(file: h5py.File, rng: np.random.Generator) -> None:
        for group in file["runs"].values():
            spoil(group, rng)

    return every


def _scale(group: h5py.Group, key: str, factor: float | Array) -> None:
    group[key][...] = group[key][()] * factor


def _add(group: h5py.Group, key: str, step: Array) -> None:
    group[key][...] = group[key][()] + step


def record(world: World, room: Path, rng: np.random.Generator) -> None:
    """Write frf.h5, log.h5 or both into the folder `room`; only the KR90 is named in them."""
    room.mkdir(parents=True, exist_ok=True)
    robot = "kr90" if world.machine.name == "kr90" else None
    if world.hammer:
        _whole(room / "frf.h5", lambda aside: _strike(world, aside, rng, robot), world.spoilt["hammer"], rng)
    if world.log:
        _whole(room / "log.h5", lambda aside: _move(world, aside, rng, robot), world.spoilt["log"], rng)


def _whole(path: Path, write: Callable[[Path], None], spoilt: Sequence[Spoil], rng: np.random.Generator) -> None:
    aside = path.with_suffix(".part")
    try:
        write(aside)
        with h5py.File(aside, "r+") as file:
            for spoil in spoilt:
                spoil(file, rng)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
        for left in path.parent.glob("*.piece*"):
            left.unlink()


def _move(world: World, path: Path, rng: np.random.Generator, robot: str | None) -> None:
    assert world.log is not None
    own = tuple(run for run in world.runs if run.name not in world.apart)
    write_log(path, world.log, own, world.how, rng, robot=robot)
    for k, run in enumerate(r for r in world.runs if r.name in world.apart):
        piece = path.with_suffix(f".piece{k}")
        write_log(piece, world.apart[run.name], (run,), world.how, rng, robot=robot)
        with h5py.File(piece) as source, h5py.File(path, "r+") as target:
            source.copy(f"runs/{run.name}", target["runs"])


def _strike(world: World, path: Path, rng: np.random.Generator, robot: str | None) -> None:
    assert world.hammer is not None
    if world.roving:
        _rove(world, path, rng, robot)
        return
    own = tuple(p for p in world.postures if p.name not in world.apart)
    pieces = [(world.hammer, own), *((world.apart[p.name], (p,)) for p in world.postures if p.name in world.apart)]
    with h5py.File(path, "w") as target:
        for k, (truth, postures) in enumerate(pieces):
            piece = path.with_suffix(f".piece{k}")
            write_campaign(piece, truth, postures, world.test, rng, robot=robot)
            with h5py.File(piece, "r+") as source:
                for spoil in world.raw:
                    spoil(source, rng)
                _kept(source, target, list(world.points))


def _kept(source: h5py.File, target: h5py.File, points: list[int]) -> None:
    """The FRFs at the points struck, as an analyser keeps them: time signals dropped."""
    if "response" not in target:
        target.attrs.update(source.attrs)
        source.copy("response", target)
        for key, values in source["excitation"].items():
            target[f"excitation/{key}"] = values[()][points]
    for name, posture in source["postures"].items():
        group = target.create_group(f"postures/{name}")
        group.attrs.update(posture.attrs)
        group["frequency"] = posture["frequency"][()]
        for key in ("frf", "coherence"):
            group[key] = posture[key][()][:, :, points]
            group[key].attrs.update(posture[key].attrs)


def _rove(world: World, path: Path, rng: np.random.Generator, robot: str | None) -> None:
    """Sensors at five nodes in turn, each with its block on the robot; blows at the flange."""
    assert world.hammer is not None
    truth, machine = world.hammer, world.machine
    blows = machine.hammer[-3:]
    others = [machine.hammer[k] for k in world.points[:-3]]
    nodes = [(c.node, c.body, c.position) for c in others[:: max(1, len(others) // 4)][:4]]
    nodes.append((machine.node, machine.sensors[0].body, machine.sensors[0].position))
    pieces = []
    for k, (node, body, position) in enumerate(nodes):
        block = Effect("payload", body, {"mass": world.roving, "com": list(position)})
        sensors = tuple(Channel(f"{node}{axis}+", body, position) for axis in "XYZ")
        here = replace(truth, effects=(*truth.effects, block), sensors=sensors, hammer=blows)
        pieces.append(path.with_suffix(f".piece{k}"))
        write_campaign(pieces[-1], here, world.postures, world.test, rng, robot=robot)
    files = [h5py.File(piece) for piece in pieces]
    with h5py.File(path, "w") as target:
        target.attrs.update(files[0].attrs)
        files[0].copy("excitation", target)
        for key in files[0]["response"]:
            target[f"response/{key}"] = np.concatenate([file[f"response/{key}"][()] for file in files])
        for name, posture in files[0]["postures"].items():
            group = target.create_group(f"postures/{name}")
            group.attrs.update(posture.attrs)
            group["frequency"] = posture["frequency"][()]
            for key in ("frf", "coherence"):
                group[key] = np.concatenate([file[f"postures/{name}/{key}"][()] for file in files], axis=1)
                group[key].attrs.update(posture[key].attrs)
    for file in files:
        file.close()
