"""Which physics is concealed in which recording: the mix, the sizes, the nuisances, all from one seed per case.

What a case conceals and what it looks like are drawn apart: number of postures, noise, windows, averages, a base model
that lacks a spring, friction with memory and dwells come alike with and without an effect, so that nothing but the
physics tells.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tools.trials.visible import LogSignal, Signal, hammer_signal, level_signal, multiple_of_visible
from tools.truth.chain import Tolerances, kr90
from tools.truth.effects import Effect, draw
from tools.truth.motion import Log, Run, draw_fourier
from tools.truth.recording import HAMMER, SENSORS, HammerTest, Posture, Truth, draw_postures, draw_truth, streams

Recording = Literal["hammer", "levels", "log"]
JOINTS = ("joint1", "joint2", "joint3")
SITES: dict[Recording, dict[str, tuple[str, ...]]] = {
    "hammer": {
        "transverse_compliance": tuple(f"{j}.{a}" for j in JOINTS for a in "xy"),
        "base_compliance": tuple(f"base.{a}" for a in ("rx", "ry", "rz", "x", "y", "z")),
        "link_flexibility": tuple(f"link{i}.{a}" for i in (1, 2, 3) for a in "yz"),
        "servo_compliance": JOINTS,
        "payload": ("flange", "link1", "link2", "link3"),
        "attached_resonator": ("link1", "link2", "link3"),
        "structural_damping": tuple(f"{j}.{a}" for j in JOINTS for a in "xyz"),
        "sensor_gain": tuple(f"sensor:{c.label}" for c in SENSORS),
        "sensor_misalignment": ("sensor:21",),
        "hammer_misalignment": tuple(f"hammer:{c.label}" for c in HAMMER),
        "time_delay": tuple(f"sensor:{c.label}" for c in SENSORS),
    },
    "levels": {kind: tuple(f"{j}.z" for j in JOINTS) for kind in ("hardening_stiffness", "backlash", "hysteresis")},
    "log": {
        **{
            kind: JOINTS
            for kind in (
                "viscous_friction", "coulomb_friction", "asymmetric_friction", "stribeck_friction",
                "load_dependent_friction", "friction_drift", "gravity_compensator", "cable_stiffness",
                "torque_ripple", "joint_coupling", "rotor_inertia", "torque_constant",
            )
        },
        "payload": ("flange", "link2", "link3"),
        "hysteresis": tuple(f"{j}.z" for j in JOINTS),
        "backlash": tuple(f"{j}.z" for j in JOINTS),
        "time_delay": ("log",),
    },
}  # fmt: skip
OUTSIDE: dict[Recording, dict[str, tuple[str, ...]]] = {
    "hammer": {
        "posture_stiffness": tuple(f"{j}.z" for j in JOINTS),
        "fractional_damper": tuple(f"{j}.{a}" for j in JOINTS for a in "zxy"),
    },
    "levels": {"eddy_current_damper": tuple(f"{j}.z" for j in JOINTS)},
    "log": {"quadratic_friction": JOINTS, "position_friction": JOINTS},
}
CHAIN = ("sensor_gain", "sensor_misalignment", "hammer_misalignment", "time_delay")
ENTRIES = (
    *((kind, j) for j in JOINTS for kind in ("viscous_friction", "coulomb_friction")),
    ("gravity_compensator", "joint2"),
)  # what the base model knows of friction and compensator
MIX = {"none": 0.25, "single": 0.40, "pair": 0.20, "outside": 0.10, "chain": 0.05}
RECORDINGS = {"hammer": 0.5, "levels": 0.1, "log": 0.4}
MULTIPLES = {"hammer": (1, 100), "levels": (1, 30), "log": (1, 30)}  # of the smallest visible size


@dataclass(frozen=True)
class Case:
    """What is recorded of which truth.

    Attributes:
        kind: none, single, pair, outside or chain.
        truth: robot, effects and errors.
        multiples: size of each effect over the smallest visible.
        without: entries the base model is to be without.
        levels, postures, test, log, runs: what is done with the robot.
    """

    seed: int
    kind: str
    recording: Recording
    truth: Truth
    multiples: tuple[float, ...]
    without: tuple[str, ...] = ()
    postures: tuple[Posture, ...] = ()
    test: HammerTest | None = None
    log: Log | None = None
    runs: tuple[Run, ...] = ()


def plan(count: int, seed: int) -> list[tuple[str, Recording, int]]:
    """Kinds and recordings of `count` cases in exact shares, and a seed for each, in random order."""
    rng = np.random.default_rng(seed)
    kinds = _shares(MIX, count)
    rng.shuffle(kinds)
    found: list[tuple[str, Recording, int]] = []
    for kind in MIX:
        number = sum(k == kind for k in kinds)
        recordings = ["hammer", "log"] * number if kind == "chain" else _shares(RECORDINGS, number)
        found += [(kind, r, int(s)) for r, s in zip(recordings[:number], rng.integers(1, 2**31, number), strict=True)]  # type: ignore[misc]
    order = rng.permutation(len(found))
    return [found[k] for k in order]


def _shares(shares: dict[str, float], count: int) -> list[str]:
    ends = np.round(np.cumsum(list(shares.values())) * count).astype(int)
    return [name for name, n in zip(shares, np.diff(ends, prepend=0), strict=True) for _ in range(n)]


def case(kind: str, recording: Recording, seed: int, number: int) -> Case:
    """One case; `number` goes round the effects and their sites so that all are met."""
    hidden, looks = (np.random.default_rng([seed, k]) for k in (1, 2))
    effects = _effects(kind, recording, number, hidden)
    return _log(kind, seed, effects, hidden, looks) if recording == "log" else _hammer(
        kind, recording, seed, effects, hidden, looks
    )  # fmt: skip


def _effects(kind: str, recording: Recording, number: int, rng: np.random.Generator) -> list[Effect]:
    if kind == "none":
        return []
    if kind == "chain":
        table = {k: v for k, v in SITES[recording].items() if k in CHAIN}
    else:
        table = (OUTSIDE if kind == "outside" else SITES)[recording]
    names = list(table)
    first = names[number % len(names)]
    found = [Effect(first, table[first][(number // len(names)) % len(table[first])])]
    if kind == "pair":
        if recording == "levels":  # a second one that every hammer test shows, and that has a law in time
            table = {k: v for k, v in SITES["hammer"].items() if k not in ("structural_damping", *CHAIN)}
        while len(found) < 2:
            other = str(rng.choice(list(table)))
            site = str(rng.choice(table[other]))
            if (other, site) != (first, found[0].site):
                found.append(Effect(other, site))
    return found


def _sized(
    effects: list[Effect], low: float, high: float, truth: Truth, rng: np.random.Generator, signal: Signal,
    levels: Signal | None = None,
) -> tuple[Truth, tuple[float, ...]]:  # fmt: skip
    """The truth with its effects, each at a log-uniform multiple of its smallest visible size."""
    sized, multiples = [], []
    for effect in effects:
        drawn = draw(effect, truth.chain, rng, log=not truth.posture_error)
        alone = replace(truth, effects=(drawn,))
        multiple = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        if levels is not None and alone.nonlinear:
            sized.append(multiple_of_visible(drawn, alone, levels, multiple, project=False))
        else:
            sized.append(multiple_of_visible(drawn, alone, signal, multiple))
        multiples.append(multiple)
    return replace(truth, effects=tuple(sized)), tuple(multiples)


def _hammer(
    kind: str, recording: Recording, seed: int, effects: list[Effect], hidden: np.random.Generator,
    looks: np.random.Generator,
) -> Case:  # fmt: skip
    levels = recording == "levels"
    brakes = str(looks.choice(["off", "off", "unknown", "on"]))
    if brakes == "on" and any(e.kind == "servo_compliance" for e in effects):
        brakes = "off"  # rotors held by brakes have no servo
    postures = tuple(
        replace(p, brakes=None if brakes == "unknown" else brakes)
        for p in draw_postures(int(looks.integers(3, 5) if levels else looks.integers(6, 9)), streams(seed)[1])
    )
    test = HammerTest(
        start_hz=float(looks.choice([4.0, 5.0, 6.0])), spacing_hz=0.25 if levels else 0.125,
        lines=100 if levels else int(looks.choice([160, 200, 240])), averages=int(looks.integers(3, 9)),
        noise=float(3e-5 * np.exp(looks.uniform(-0.7, 0.7))), scatter=float(looks.uniform(0.003, 0.008)),
        coherence=str(looks.choice(["expected", "estimated"])), pulse_s=float(looks.uniform(0.006, 0.010)),
        levels_n=(100.0, 250.0, 600.0) if levels else (),
        window=None if levels or looks.random() < 0.6 else float(looks.uniform(0.1, 0.5)),
    )  # fmt: skip
    truth = draw_truth(seed, (), postures, Tolerances())
    # Every other base model is without a transverse spring; the robot has it only where that is what is concealed.
    missing = [e.site for e in effects if e.kind == "transverse_compliance"]
    unused, lacking = str(looks.choice(SITES["hammer"]["transverse_compliance"])), looks.random() < 0.5
    if lacking and not missing:
        missing = [unused]
    stiffness = truth.chain.stiffness.copy()
    for site in missing:
        stiffness[int(site[5]) - 1, "zxy".index(site[-1])] = np.inf
    truth = replace(truth, chain=replace(truth.chain, stiffness=stiffness))
    signals = hammer_signal(postures, test), level_signal(postures, test) if levels else None
    truth, multiples = _sized(effects, *MULTIPLES[recording], truth, hidden, *signals)
    without = tuple(f"transverse_compliance@{site}" for site in missing)
    return Case(seed, kind, recording, truth, multiples, without, postures, test)


def _log(kind: str, seed: int, effects: list[Effect], hidden: np.random.Generator, looks: np.random.Generator) -> Case:
    chain = kr90()
    truth = draw_truth(seed, (), (), Tolerances(inertia=0.05), log=True)
    # Every other base model is without an entry it usually has; the robot has it only where that is what is concealed.
    missing = [(e.kind, e.site) for e in effects if (e.kind, e.site) in ENTRIES]
    unused, lacking = ENTRIES[int(looks.integers(len(ENTRIES)))], looks.random() < 0.5
    if lacking and not missing:
        missing = [unused]
    for effect, site in missing:
        name = {"viscous_friction": "viscous", "coulomb_friction": "coulomb", "gravity_compensator": "compensator"}[
            effect
        ]
        values = getattr(truth.chain, name).copy()
        values[int(site[5]) - 1] = 0.0
        truth = replace(truth, chain=replace(truth.chain, **{name: values}))
    encoder = looks.random() < 0.3 or any(e.kind == "backlash" for e in effects)
    log = Log(
        white=float(looks.uniform(5, 15)), coloured=float(looks.uniform(2, 10)), ripple=float(looks.uniform(0, 3)),
        friction=str(looks.choice(["coulomb", "coulomb", "lugre"])), compensator=str(looks.choice(["series", "gas"])),
        link_encoder=bool(encoder),
    )  # fmt: skip
    runs, start = [], 0.0
    for k in range(int(looks.integers(3, 6))):
        seconds, dwells = float(looks.uniform(40, 80)), int(looks.integers(0, 4))
        time = np.arange(int(seconds * log.rate_hz)) / log.rate_hz
        runs.append(Run(f"run{k + 1}", draw_fourier(chain, looks, seconds, dwells), time, start))
        start += seconds + float(looks.uniform(5, 60))
    truth, multiples = _sized(effects, *MULTIPLES["log"], truth, hidden, LogSignal(tuple(runs[:2]), log))
    without = tuple(f"{effect}@{site}" for effect, site in missing)
    return Case(seed, kind, "log", truth, multiples, without, log=log, runs=tuple(runs))
