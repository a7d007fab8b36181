"""Wrong-world cases: robots and recordings that are not as described, alone and with a concealed effect on top.

Drawn, recorded and sealed as ordinary cases are; what the ways of being wrong are is in `tools.truth.wrong`.
"""

import hashlib
import secrets
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import h5py
import numpy as np

from tools.trials import ask
from tools.trials.store import ROOT, read, sha256, write
from tools.trials.visible import LogSignal, hammer_signal, multiple_of_visible, shows
from tools.truth.chain import Array, Link
from tools.truth.effects import Effect, draw
from tools.truth.motion import Log, Run, draw_fourier
from tools.truth.recording import HammerTest, Truth, average, draw_truth, plain, streams
from tools.truth.robots import Machine, machines, write_description
from tools.truth.wrong import LACKING_NOTHING, WAYS, Cause, World, record

MULTIPLE = 4.0  # of the smallest visible size: of what is concealed on top
ON_TOP = 1 / 3  # share of cases with an effect concealed on top
SHARES = {"hammer": 0.59, "log": 0.39, "both": 0.02}
ATTEMPTS = 20
NUDGE = 1e-5  # share of the way to a wrong robot, for derivatives
OWN, POSTURE = "own_simulation", ROOT / "mjcf" / "postures" / "milling.yaml"
ARMS = ("six", "light", "seven")
NOT_IN_TIME = ("servo_compliance", "structural_damping")
TOP: dict[str, dict[str, tuple[str, ...]]] = {
    "hammer": {
        "payload": ("flange", "link2"),
        "attached_resonator": ("link2", "link3"),
        "base_compliance": ("base.rx", "base.ry"),
        "link_flexibility": ("link3.y", "link3.z"),
        "servo_compliance": ("joint1", "joint2", "joint3"),
        "structural_damping": ("joint2.z", "joint3.z"),
        "transverse_compliance": ("joint2.x", "joint3.x"),
    },
    "log": {
        "payload": ("flange",),
        "asymmetric_friction": ("joint1", "joint2", "joint3"),
        "stribeck_friction": ("joint1", "joint2", "joint3"),
        "load_dependent_friction": ("joint3",),
        "cable_stiffness": ("joint2", "joint3"),
        "torque_ripple": ("joint1", "joint2", "joint3"),
        "friction_drift": ("joint1", "joint2", "joint3"),
        "joint_coupling": ("joint2", "joint3"),
    },
}
IN_THE_ROBOT = (
    "mass", "com", "com_all", "inertia", "inertia_all", "axis_length", "axis_offset", "axis_twist", "joint_zero",
    "springs", "dampers", "sensor_position", "blow_position", "blows_scattered", "sensor_direction", "postures_off",
    "gravity_tilt", "rotor_inertia",
)  # fmt: skip
REGRESSIONS: tuple[tuple[str, str, str, int], ...] = (
    # (way, recording, robot, seed): what was tried on the engine of 357aac5 and told wrongly
    ("com_all", "hammer", "kr90", 1), ("com_all", "hammer", "kr90", 2), ("joint_zero", "hammer", "kr90", 1),
    ("postures_off", "hammer", "kr90", 1), ("own_simulation", "hammer", "kr90", 1),
    ("mass", "log", "kr90", 1), ("other_robot", "both", "kr90", 1), ("unit_g_all", "hammer", "kr90", 1),
    ("unit_g_channel", "hammer", "kr90", 1), ("torque_filter", "log", "kr90", 1),
    ("noise_understated", "hammer", "kr90", 1), ("hum", "hammer", "kr90", 1), ("leakage", "hammer", "kr90", 1),
    ("floor_mode", "hammer", "kr90", 1), ("roving_mass", "hammer", "kr90", 1), ("sensor_position", "hammer", "kr90", 1),
    ("inertia_all", "hammer", "kr90", 1), ("torque_warmup", "log", "kr90", 1), ("slow_run", "log", "kr90", 1),
    ("torque_gain", "log", "kr90", 1), ("dampers", "hammer", "kr90", 1), ("thinned", "hammer", "kr90", 1),
    ("nothing", "hammer", "kr90", 1), ("nothing", "hammer", "kr90", 2), ("nothing", "log", "kr90", 1),
)  # fmt: skip


def prepare(split: Path, count: int, seed: int | None, world: str = "wrong") -> list[tuple[str, dict[str, Any]]]:
    """(id, plan) of every case; drawn once, then read back. Descriptions of the robots are written beside."""
    for machine in machines().values():
        path = split / "robots" / f"{machine.name}.yaml"
        if not path.exists():
            write_description(machine, path)
    path = split / "answers" / "plan.json"
    if not path.exists():
        secret = secrets.randbits(60) if seed is None else seed
        drawn = (
            regressions() if world == "regression" else arms(count, secret) if world == "arms" else plan(count, secret)
        )
        write(path, {"seed": secret, "world": world, "cases": drawn, "salt": secrets.token_hex(16)})
    content = read(path)
    return [
        (hashlib.sha256(f"{content['salt']}/{n}".encode()).hexdigest()[:12], drawn)
        for n, drawn in enumerate(content["cases"])
    ]


def regressions() -> list[dict[str, Any]]:
    return [
        {"way": way, "recording": recording, "robot": robot, "seed": seed, "on_top": False}
        for way, recording, robot, seed in REGRESSIONS
    ]


def arms(count: int, seed: int) -> list[dict[str, Any]]:
    """`count` cases of whole arms as described, a quarter of each robot's with nothing concealed; robots come round."""
    rng, recordings = np.random.default_rng(seed), ("log", "hammer")
    return [
        {"way": "nothing", "recording": recordings[k // len(ARMS) % 2], "robot": ARMS[k % len(ARMS)],
         "seed": int(rng.integers(1, 2**31)), "on_top": bool(k // (2 * len(ARMS)) % 4)}
        for k in range(count)
    ]  # fmt: skip


def plan(count: int, seed: int) -> list[dict[str, Any]]:
    """`count` cases in the shares of `SHARES`; the ways come round in turn, and so do the robots.

    From a way's second case on, every other one has an effect on top; and as many of the others as `ON_TOP` asks for.
    """
    rng = np.random.default_rng(seed)
    numbers = np.diff(np.round(np.cumsum(list(SHARES.values())) * count).astype(int), prepend=0)
    found: list[dict[str, Any]] = []
    for recording, number in zip(SHARES, numbers, strict=True):
        ways = [name for name, way in WAYS.items() if recording in way.recordings]
        ways = [ways[k] for k in rng.permutation(len(ways))]
        robots = [list(machines())[k] for k in rng.permutation(3)]
        for k in range(int(number)):
            way, turn = ways[k % len(ways)], k // len(ways)
            alone = way in LACKING_NOTHING or recording == "both"
            on_top = not alone and (turn % 2 == 1 or (turn == 0 and rng.random() < ON_TOP / 2))
            robot = robots[(k + turn) % 3]
            found.append(
                {"way": way, "recording": recording, "robot": robot, "seed": int(rng.integers(1, 2**31)),
                 "on_top": bool(on_top)}
            )  # fmt: skip
    return [found[k] for k in rng.permutation(len(found))]


def make(split: Path, name: str, drawn: dict[str, Any]) -> dict[str, Any]:
    """Write one case unless it is there, and return its line of the manifest."""
    answer, room = split / "answers" / f"{name}.json", split / "recordings" / name
    if not answer.exists():
        for later in range(ATTEMPTS):
            try:
                content = _made(room, {**drawn, "seed": drawn["seed"] + later})
                break
            except ValueError:  # an effect that shows nowhere, a robot that cannot stand
                if later == ATTEMPTS - 1:
                    raise
        write(answer, content)
    files = {path.name: sha256(path) for path in sorted(room.glob("*.h5"))}
    robot = None if drawn["robot"] == "kr90" else f"robots/{drawn['robot']}.yaml"
    line = {"id": name, "without": read(answer)["without"], "robot": robot, "files": files, "answer": sha256(answer)}
    return line if robot is None else {**line, "description": sha256(split / robot)}


def _made(room: Path, drawn: dict[str, Any]) -> dict[str, Any]:
    """Draw and record a case; its answer."""
    if drawn["way"] == OWN:
        own_simulation(room, np.random.default_rng(drawn["seed"]))
        none = {"without": [], "cause": plain(Cause(size="own")), "effects": [], "shown": None}
        return {**drawn, "world": "wrong", **none}
    world, top, without, cause = case(**drawn)
    record(world, room, np.random.default_rng([drawn["seed"], 3]))
    return {
        **drawn, "world": "wrong", "without": without, "cause": plain(cause), "shown": shown(**drawn),
        "effects": [{"effect": e.kind, "site": e.site, "parameters": plain(e.parameters), "multiple": MULTIPLE}
                    for e in top],
        "truth": {"hammer": plain(world.hammer), "log": plain(world.log)},
    }  # fmt: skip


def shown(way: str, recording: str, robot: str, seed: int, **_: Any) -> float | None:
    """How far it shows that the robot is not as described, after all tolerances: ln of a likelihood ratio.

    By the derivative on the way from the robot within tolerance to the wrong one. `None` for faults of the file, which
    no robot has.
    """
    if way not in IN_THE_ROBOT or recording == "both":
        return None
    machine = machines()[robot]
    sound, *_ = case("nothing", recording, robot, seed, False)
    world, *_ = case(way, recording, robot, seed, False)
    truth = sound.hammer or sound.log
    end = world.hammer or world.log
    assert truth is not None
    assert end is not None
    signal: Any = LogSignal(sound.runs[:2], sound.how)
    if recording == "hammer":
        signal = hammer_signal(sound.postures, sound.test, sound.points)

    def at(share: float) -> Array:
        near = toward(truth, end, share)
        if recording == "hammer":
            return np.asarray(signal(near))
        runs = (_between(a, b, share) for a, b in zip(sound.runs[:2], world.runs[:2], strict=True))
        return LogSignal(tuple(runs), sound.how)(near)

    return shows(truth, signal, slope(at), machine.chain, machine.tolerances)


def slope(at: Callable[[float], Array]) -> Array:
    """Derivative at 0 to fourth order: what hides in a resonance is a millionth of what moves it."""
    return (8 * (at(NUDGE) - at(-NUDGE)) - (at(2 * NUDGE) - at(-2 * NUDGE))) / (12 * NUDGE)


def toward(truth: Truth, end: Truth, share: float) -> Truth:
    """A share of the way from one robot to another; springs, dampers and rotors by ratios."""

    def mean(a: Any, b: Any) -> Any:
        return a + share * (b - a)

    def ratio(name: str) -> Array:
        a, b = getattr(truth.chain, name), getattr(end.chain, name)
        return np.asarray(a * (b / a) ** share)

    links = tuple(
        Link(mean(a.mass, b.mass), mean(a.com, b.com), mean(a.inertia, b.inertia))
        for a, b in zip(truth.chain.links, end.chain.links, strict=True)
    )
    numbers = {name: mean(getattr(truth.chain, name), getattr(end.chain, name)) for name in ("dh", "gravity")}
    numbers |= {name: ratio(name) for name in ("stiffness", "damping", "rotor_inertia")}
    turned = tuple(replace(e, parameters={"angles": (share * e.array("angles")).tolist()}) for e in end.effects)
    return replace(
        truth,
        chain=replace(truth.chain, links=links, **numbers),
        effects=turned,
        posture_error={k: mean(v, end.posture_error[k]) for k, v in truth.posture_error.items()},
        moved={k: share * v for k, v in end.moved.items()},
    )


def _between(run: Run, end: Run, share: float) -> Run:
    """A share of the way from one run to another."""

    def path(t: Array) -> tuple[Array, Array, Array]:
        parts = zip(run.trajectory(t), end.trajectory(t), strict=True)
        q, v, a = (x + share * (y - x) for x, y in parts)
        return q, v, a

    return replace(run, trajectory=path)


def own_simulation(room: Path, rng: np.random.Generator) -> None:
    """The hammer test that `twin simulate` writes, one posture and 100 Hz, with a sensor's noise: nothing is wrong."""
    room.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        code, _, complaint = ask.run(["simulate", str(POSTURE), "--out", scratch], ask.LIMIT_S)
        if code:
            raise RuntimeError(complaint)
        aside = Path(scratch) / "hammer.h5"
        with h5py.File(aside, "r+") as file:
            file.attrs["robot"] = "kr90"
            for group in file["postures"].values():
                frequency = group["frequency"][()]
                test = HammerTest(
                    float(frequency[0]), float(frequency[1] - frequency[0]), len(frequency), scatter=0.0,
                    averages=int(group["coherence"].attrs["averages"]),
                )  # fmt: skip
                noisy = average(group["frf"][()][None], test, float(group.attrs["peak_force_n"]), rng)
                group["frf"][...], group["coherence"][...] = noisy
        shutil.move(aside, room / "frf.h5")


def case(way: str, recording: str, robot: str, seed: int, on_top: bool) -> tuple[World, list[Effect], list[str], Cause]:
    """The world, what is concealed on top of it, entries that the base model is to be without, the right answer."""
    machine, looks = machines()[robot], np.random.default_rng([seed, 2])
    world = World(machine)
    top = _concealed(way, recording, machine, seed) if on_top else []
    if recording in ("hammer", "both"):
        _struck(world, seed, looks, top)
    if recording in ("log", "both"):
        _moved(world, seed, looks)
    sound = replace(world)
    cause = WAYS[way].spoil(world, np.random.default_rng([seed, crc32(way.encode())]))
    if top:
        top = [_sized(replace(sound, test=world.test), top[0], machine)]
    if top and world.hammer:
        world.hammer = replace(world.hammer, effects=(*world.hammer.effects, *top))
    elif top and world.log:
        world.log = replace(world.log, effects=(*world.log.effects, *top))
    return world, top, [f"{e.kind}@{e.site}" for e in top if e.kind == "transverse_compliance"], cause


def _concealed(way: str, recording: str, machine: Machine, seed: int) -> list[Effect]:
    """One effect that the way leaves room for, as drawn."""
    hidden, spec = np.random.default_rng([seed, 1]), WAYS[way]
    fits = {
        kind: sites
        for kind, sites in TOP[recording].items()
        if kind not in spec.clash and not (spec.time and kind in NOT_IN_TIME)
    }
    kind = str(hidden.choice(list(fits)))
    sites = [*fits[kind]]
    for i in range(4, machine.chain.n + 1):  # the wrist's, too
        sites += [s.replace("joint3", f"joint{i}") for s in fits[kind] if s.startswith("joint3")]
    return [draw(Effect(kind, str(hidden.choice(sites))), machine.chain, hidden, log=recording == "log")]


def _sized(world: World, effect: Effect, machine: Machine) -> Effect:
    """The effect at `MULTIPLE` times its smallest visible size in the recording of a robot that is as described.

    The recording is the one that is asked: with its lines, its window and its noise, hum among that.

    What it leaves in the recording counts, and not the tension against the description: that never names.
    """
    known = {"described": machine.chain, "known": machine.tolerances, "tension": False}
    if world.hammer:
        signal: Any = hammer_signal(world.postures, world.test, world.points)
        return multiple_of_visible(effect, world.hammer, signal, MULTIPLE, **known)  # type: ignore[arg-type]
    assert world.log is not None
    return multiple_of_visible(effect, world.log, LogSignal(world.runs[:2], world.how), MULTIPLE, **known)  # type: ignore[arg-type]


def _struck(world: World, seed: int, looks: np.random.Generator, top: Sequence[Effect]) -> None:
    """A hammer test of a robot within its tolerances."""
    machine = world.machine
    brakes = str(looks.choice(["off", "off", "unknown", "on"]))
    if brakes == "on" and any(e.kind == "servo_compliance" for e in top):
        brakes = "off"
    postures = machine.postures(6, streams(seed)[1])
    world.postures = tuple(replace(p, brakes=None if brakes == "unknown" else brakes) for p in postures)
    world.test = HammerTest(
        machine.start_hz, machine.spacing_hz, machine.lines, averages=int(looks.integers(3, 9)), peak_n=machine.peak_n,
        noise=float(3e-5 * np.exp(looks.uniform(-0.7, 0.7))), scatter=float(looks.uniform(0.003, 0.008)),
        coherence=str(looks.choice(["expected", "estimated"])), pulse_s=float(looks.uniform(0.006, 0.010)),
    )  # fmt: skip
    others = looks.permutation(len(machine.hammer) - 3)[: int(looks.integers(6, 9))]
    own = range(len(machine.hammer) - 3, len(machine.hammer))
    world.points = (*sorted(int(k) for k in others), *own)
    truth = draw_truth(
        seed, (), world.postures, machine.tolerances, chain=machine.chain, sensors=machine.sensors,
        hammer=machine.hammer,
    )  # fmt: skip
    for e in top:
        if e.kind == "transverse_compliance":  # which the robot has only where it is concealed
            stiffness: Array = truth.chain.stiffness.copy()
            stiffness[e.joint, "zxy".index(e.axis)] = np.inf
            truth = replace(truth, chain=replace(truth.chain, stiffness=stiffness))
    world.hammer = truth


def _moved(world: World, seed: int, looks: np.random.Generator) -> None:
    """A motion log of a robot within its tolerances."""
    machine = world.machine
    world.log = draw_truth(seed, (), (), machine.tolerances, chain=machine.chain, log=True)
    world.how = Log(
        white=machine.torque * float(looks.uniform(5, 15)), coloured=machine.torque * float(looks.uniform(2, 10)),
        ripple=machine.torque * float(looks.uniform(0, 0.5)),
        friction=str(looks.choice(["coulomb", "coulomb", "lugre"])), compensator=str(looks.choice(["series", "gas"])),
    )  # fmt: skip
    runs, start = [], 0.0
    for k in range(int(looks.integers(3, 5))):
        seconds, dwells = float(looks.uniform(40, 55)), int(looks.integers(0, 3))
        time = np.arange(int(seconds * world.how.rate_hz)) / world.how.rate_hz
        runs.append(Run(f"run{k + 1}", draw_fourier(machine.chain, looks, seconds, dwells), time, start))
        start += seconds + float(looks.uniform(5, 60))
    world.runs = tuple(runs)
