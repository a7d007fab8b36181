"""Which physics is concealed in which recording: the mix, the sizes, the nuisances, all from one seed per case.

What a case conceals and what it looks like are drawn apart: number of postures, noise, windows, averages, a base model
that lacks a spring, friction with memory and dwells come alike with and without an effect, so that nothing but the
physics tells. All that a null robot differs by from its description lies within what the description says of itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from tools.trials.visible import LogSignal, hammer_signal, kept, level_signal, multiple_of_visible, overlap
from tools.truth.chain import Tolerances, kr90
from tools.truth.effects import EFFECTS, Effect, draw
from tools.truth.motion import Log, Run, draw_fourier
from tools.truth.recording import HAMMER, SENSORS, HammerTest, Posture, Truth, draw_postures, draw_truth, streams

Recording = Literal["hammer", "levels", "log", "both"]
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
    "both": {
        "payload": ("flange", "link2", "link3"),
        "base_compliance": tuple(f"base.{a}" for a in ("rx", "ry", "rz", "x", "y", "z")),
        "asymmetric_friction": JOINTS,
        "transverse_compliance": tuple(f"{j}.{a}" for j in JOINTS for a in "xy"),
        "gravity_compensator": JOINTS,
        "attached_resonator": ("link1", "link2", "link3"),
    },
}  # fmt: skip
OUTSIDE: dict[Recording, dict[str, tuple[str, ...]]] = {
    "hammer": {
        "posture_stiffness": tuple(f"{j}.z" for j in JOINTS),
        "fractional_damper": tuple(f"{j}.{a}" for j in JOINTS for a in "zxy"),
    },
    "levels": {"eddy_current_damper": tuple(f"{j}.z" for j in JOINTS)},
    "log": {"quadratic_friction": JOINTS, "position_friction": JOINTS},
    "both": {"posture_stiffness": tuple(f"{j}.z" for j in JOINTS), "quadratic_friction": JOINTS},
}
CHAIN: dict[Recording, tuple[str, ...]] = {
    "hammer": ("sensor_gain", "sensor_misalignment", "hammer_misalignment", "time_delay"),
    "log": ("torque_constant", "time_delay"),
}
ENTRIES = (
    *((kind, j) for j in JOINTS for kind in ("viscous_friction", "coulomb_friction")),
    ("gravity_compensator", "joint2"),
)  # what the base model knows of friction and compensator
MIX = {"none": 0.25, "single": 0.40, "pair": 0.20, "outside": 0.10, "chain": 0.05}
RECORDINGS = {"hammer": 0.42, "levels": 0.10, "log": 0.38, "both": 0.10}
SIZES = (1.0, 30.0)  # multiples of the smallest visible size, uniform in the logarithm
CANCELLING = 1 / 3  # share of pairs whose second effect hides the first as well as any of `CANDIDATES` drawn does
CANDIDATES = 6
SAME_Q1 = 0.12  # share of hammer tests with one q₁ in all postures: base and joint 1 tilt alike
BAD_CHANNELS = 0.15  # share of hammer tests with one blow point whose FRFs are noise
RAW = 0.3  # share of hammer tests whose FRFs come from simulated time signals
SPACING_HZ = 0.25  # of FRF lines
BEAM_SEGMENTS = (4, 9)  # of a link that bends as a beam rather than in one hinge


@dataclass(frozen=True)
class Campaign:
    """A hammer test: the truth that is struck, at which of the points, how; all that `dead` of them gives is noise."""

    truth: Truth
    postures: tuple[Posture, ...]
    test: HammerTest
    points: tuple[int, ...]
    dead: int | None = None

    @property
    def live(self) -> tuple[int, ...]:
        """The points whose FRFs tell something."""
        return tuple(k for k in self.points if k != self.dead)


@dataclass(frozen=True)
class Motion:
    """A motion log: the truth that moves, along which runs, how recorded."""

    truth: Truth
    log: Log
    runs: tuple[Run, ...]


@dataclass(frozen=True)
class Case:
    """What is recorded of which robot.

    Attributes:
        kind: none, single, pair, outside or chain.
        effects: what is concealed; ``multiples`` their sizes over the smallest visible.
        overlap: cosine between the signatures of a pair's effects, negative where one hides the other.
        kept: of a single effect, ln of a likelihood ratio that the recording itself keeps of it, without tension
            against the description; ``None`` where that was not computed.
        without: entries the base model is to be without.
        campaign, motion: the recordings.
    """

    seed: int
    kind: str
    recording: Recording
    effects: tuple[Effect, ...]
    multiples: tuple[float, ...]
    overlap: float | None
    without: tuple[str, ...]
    campaign: Campaign | None = None
    motion: Motion | None = None
    kept: float | None = None

    @property
    def circumstances(self) -> dict[str, Any]:
        """What the recording is like, whatever it conceals."""
        found: dict[str, Any] = {}
        if self.campaign:
            q1 = {p.q_deg[0] for p in self.campaign.postures}
            test = self.campaign.test
            kind = "time signals" if test.hits else "force levels" if test.levels_n else "FRFs"
            found |= {"postures": len(self.campaign.postures), "same_q1": len(q1) == 1, "measured": kind}
        if self.motion:
            found |= {"friction": self.motion.log.friction, "compensator": self.motion.log.compensator}
        return found


def plan(
    count: int, seed: int, recordings: Sequence[str] = tuple(RECORDINGS), each: int = 0
) -> list[tuple[str, Recording, int, int]]:
    """(kind, recording, seed, number) of `count` cases in the shares of `MIX`, in random order.

    With `each`, every effect of every recording so many times alone, and the other kinds in their shares beside them.
    The numbers of one kind and recording count on from a random start: they go round the effects.
    """
    rng = np.random.default_rng(seed)
    found: list[tuple[str, Recording, int, int]] = []
    mix = {k: share for k, share in MIX.items() if k != "chain" or any(r in CHAIN for r in recordings)}
    for kind, number in zip(mix, _shares(mix, count), strict=True):
        start = int(rng.integers(1000))
        for recording, n in _met(kind, number, recordings, each).items():
            found += [(kind, recording, int(rng.integers(1, 2**31)), start + k) for k in range(n)]
    return [found[k] for k in rng.permutation(len(found))]


def _met(kind: str, number: int, recordings: Sequence[str], each: int) -> dict[Recording, int]:
    """How many cases of a kind there are of each recording."""
    shares = {r: s for r, s in RECORDINGS.items() if r in recordings}
    if each:  # the measurement chain is met among the effects
        alone = MIX["single"] + MIX["chain"]
        share = 1.0 if kind == "single" else 0.0 if kind == "chain" else MIX[kind] / alone
        return {r: round(each * len(SITES[r]) * share) for r in shares}
    if kind == "chain":
        shares = {r: 1.0 for r in shares if r in CHAIN}
    return dict(zip(shares, _shares(shares, number), strict=True))


def _shares(shares: Mapping[Any, float], count: int) -> list[int]:
    """`count` in parts as the shares, which need not add up to one."""
    ends = np.round(np.cumsum(list(shares.values())) / sum(shares.values()) * count).astype(int)
    return np.diff(ends, prepend=0).tolist()


def case(kind: str, recording: Recording, seed: int, number: int, sizes: tuple[float, float] = SIZES) -> Case:
    """One case; `number` chooses the effect, so that consecutive numbers meet all of them.

    `sizes`: least and largest multiple of the smallest visible size.
    """
    hidden = np.random.default_rng([seed, 1])
    candidates = _candidates(kind, recording, number, hidden)
    campaign, motion, without = _recorded(recording, seed, candidates)
    effects, multiples, hiding, keeps = _sized(candidates, campaign, motion, sizes, hidden)
    if campaign:
        shown = tuple(e for e in effects if EFFECTS[e.kind].shows != "log")
        campaign = replace(campaign, truth=replace(campaign.truth, effects=shown))
    if motion:
        shown = tuple(e for e in effects if recording == "log" or EFFECTS[e.kind].shows in ("log", "both"))
        motion = replace(motion, truth=replace(motion.truth, effects=shown))
    return Case(seed, kind, recording, effects, multiples, hiding, tuple(without), campaign, motion, keeps)


def usual(kind: str, recording: Recording, seed: int, number: int) -> Case:
    """One case whose effects are of any usual size, seen or not; `multiples` are not known."""
    hidden = np.random.default_rng([seed, 1])
    candidates = _candidates(kind, recording, number, hidden)[:2]
    campaign, motion, without = _recorded(recording, seed, candidates)
    effects = tuple(_drawn(draw(e, kr90(), hidden, log=campaign is None), hidden) for e in candidates)
    if campaign:
        campaign = replace(campaign, truth=replace(campaign.truth, effects=effects))
    return Case(seed, kind, recording, effects, (np.nan,) * len(effects), None, tuple(without), campaign, motion)


def struck(kind: str, recording: Recording, seed: int, number: int) -> HammerTest:
    """How the robot of a case with a hammer test is struck, of whatever size its effects are."""
    campaign, *_ = _recorded(recording, seed, _candidates(kind, recording, number, np.random.default_rng([seed, 1])))
    assert campaign is not None
    return campaign.test


def _recorded(
    recording: Recording, seed: int, candidates: Sequence[Effect]
) -> tuple[Campaign | None, Motion | None, list[str]]:
    """What is recorded of the robot without its effects, and entries that its base model is to be without."""
    looks = np.random.default_rng([seed, 2])
    hits = looks.random() < RAW and recording == "hammer" and not any(e.kind in NOT_IN_TIME for e in candidates)
    campaign = motion = None
    without: list[str] = []
    if recording != "log":
        campaign, missing = _campaign(recording, seed, candidates, looks, hits)
        without += missing
    if recording in ("log", "both"):
        motion, missing = _motion(seed, candidates, looks)
        without += missing
    return campaign, motion, without


NOT_IN_TIME = ("structural_damping", "fractional_damper", "time_delay", "servo_compliance")
"""Laws and delays in frequency only."""
NEEDS_ABSENCE = ("transverse_compliance", "viscous_friction", "coulomb_friction", "gravity_compensator")
"""Effects that the base model may already have."""


def _candidates(kind: str, recording: Recording, number: int, rng: np.random.Generator) -> list[Effect]:
    """Nothing, one effect, or one and those that may come second; without parameters."""
    if kind == "none":
        return []
    table = (OUTSIDE if kind == "outside" else SITES)[recording]
    if kind == "chain":
        table = {name: table[name] for name in CHAIN[recording]}
    names = list(table)
    first = names[number % len(names)]
    found = [Effect(first, str(rng.choice(table[first])))]
    if kind != "pair":
        return found
    if recording == "levels":  # a second one that every hammer test shows, and that has a law in time
        table = {k: v for k, v in SITES["hammer"].items() if k not in (*NOT_IN_TIME, *CHAIN["hammer"])}
    table = {name: sites for name, sites in table.items() if name not in NEEDS_ABSENCE}
    seconds = CANDIDATES if rng.random() < CANCELLING else 1
    while len(found) < 1 + seconds:
        other = str(rng.choice(list(table)))
        effect = Effect(other, str(rng.choice(table[other])))
        if all(effect.site != e.site or (effect.kind != e.kind and "." not in e.site) for e in found):
            found.append(effect)
    return found


def _sized(
    candidates: Sequence[Effect],
    campaign: Campaign | None,
    motion: Motion | None,
    sizes: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[tuple[Effect, ...], tuple[float, ...], float | None, float | None]:
    """The effects, each at a log-uniform multiple of its smallest visible size, a pair's overlap, and `Case.kept`."""
    if not candidates:
        return (), (), None, None
    chain = kr90()
    drawn = [_drawn(draw(e, chain, rng, log=campaign is None), rng) for e in candidates]
    struck = hammer_signal(campaign.postures, campaign.test, campaign.live) if campaign else None
    moved = LogSignal(motion.runs[:2], motion.log) if motion else None

    def where(e: Effect) -> tuple[Truth, Any]:
        if campaign and EFFECTS[e.kind].shows != "log":
            return campaign.truth, struck
        assert motion is not None
        return motion.truth, moved

    hiding = None
    if len(drawn) > 1:
        truth, signal = where(drawn[0])
        same = [e for e in drawn[1:] if where(e)[1] is signal] if not _by_level(drawn[0]) else []
        cosines = [overlap(drawn[0], e, truth, signal) for e in same]
        if cosines:
            hiding = min(cosines)
            drawn = [drawn[0], same[int(np.argmin(cosines))]]
        drawn = drawn[:2]
    effects, multiples = [], []
    for e in drawn:
        multiple = float(np.exp(rng.uniform(*np.log(sizes))))
        truth, signal = where(e)
        if campaign and _by_level(e):
            signal = level_signal(campaign.postures, campaign.test, campaign.live)
        projected = not (campaign and _by_level(e))
        effects.append(multiple_of_visible(e, truth, signal, multiple, project=projected))
        multiples.append(multiple)
    alone = kept(effects[0], truth, signal) if len(effects) == 1 and projected else None
    return tuple(effects), tuple(multiples), hiding, alone


def _by_level(e: Effect) -> bool:
    return EFFECTS[e.kind].shows == "levels" or e.kind in ("backlash", "hysteresis")


def _drawn(e: Effect, rng: np.random.Generator) -> Effect:
    """Half of the links bend as beams, half of the servos are cascades: laws that no catalogue of one spring has."""
    if e.kind == "link_flexibility" and rng.random() < 0.5:
        return Effect(e.kind, e.site, {**e.parameters, "segments": int(rng.integers(*BEAM_SEGMENTS))})
    if e.kind == "servo_compliance" and rng.random() < 0.5:
        return Effect(e.kind, e.site, {**e.parameters, "integral_time": float(rng.uniform(0.1, 0.5))})
    return e


def _campaign(
    recording: Recording, seed: int, effects: Sequence[Effect], looks: np.random.Generator, hits: bool
) -> tuple[Campaign, list[str]]:
    """A hammer test of the robot without the effects, and entries that its base model is to be without."""
    levels = recording == "levels"
    brakes = str(looks.choice(["off", "off", "unknown", "on"]))
    if brakes == "on" and any(e.kind == "servo_compliance" for e in effects):
        brakes = "off"  # rotors held by brakes have no servo
    postures = draw_postures(int(looks.integers(3, 5) if levels else looks.choice([6, 6, 7])), streams(seed)[1])
    same_q1 = looks.random() < SAME_Q1
    postures = tuple(
        replace(p, brakes=None if brakes == "unknown" else brakes, q_deg=(0.0 if same_q1 else p.q_deg[0], *p.q_deg[1:]))
        for p in postures
    )
    averages = int(looks.integers(3, 9))
    test = HammerTest(
        start_hz=float(looks.choice([4.0, 5.0, 6.0])), spacing_hz=SPACING_HZ,
        lines=80 if levels else int(looks.choice([80, 90, 100])), averages=averages,
        noise=float(3e-5 * np.exp(looks.uniform(-0.7, 0.7))), scatter=float(looks.uniform(0.003, 0.008)),
        coherence=str(looks.choice(["expected", "estimated"])), pulse_s=float(looks.uniform(0.006, 0.010)),
        levels_n=(100.0, 250.0, 600.0) if levels else (),
        window=_window(levels, hits, looks),
        hits=averages if hits else 0, double_hits=0.2,
    )  # fmt: skip
    labels = [c.label for c in HAMMER]
    own = [i for i, c in enumerate(HAMMER) if c.node == "21"]
    others = [int(i) for i in looks.permutation([i for i in range(len(HAMMER)) if i not in own])]
    named = [labels.index(e.site.partition(":")[2]) for e in effects if e.site.startswith("hammer:")]
    others = [*(i for i in named if i not in own), *(i for i in others if i not in named)]
    points = tuple(sorted([*own, *others[: int(looks.integers(6, 9))]]))
    truth = draw_truth(seed, (), postures, Tolerances())
    # Every other base model is without a transverse spring; the robot has it only where that is what is concealed.
    missing = [e.site for e in effects if e.kind == "transverse_compliance"]
    unused, lacking = str(looks.choice(SITES["hammer"]["transverse_compliance"])), looks.random() < 0.5
    if lacking and not missing and unused not in [e.site for e in effects]:
        missing = [unused]
    stiffness = truth.chain.stiffness.copy()
    for site in missing:
        stiffness[int(site[5]) - 1, "zxy".index(site[-1])] = np.inf
    truth = replace(truth, chain=replace(truth.chain, stiffness=stiffness))
    bad = np.random.default_rng([seed, 3])
    dead = int(bad.choice(points)) if bad.random() < BAD_CHANNELS else None
    return Campaign(truth, postures, test, points, dead), [f"transverse_compliance@{site}" for site in missing]


def _window(levels: bool, hits: bool, looks: np.random.Generator) -> float | None:
    """Rate 1/s of the exponential window. Time signals: ten per record, else their ends leak more than noise."""
    chosen = float(looks.uniform(0.1, 0.5)) if looks.random() < 0.4 else None
    return 10 * SPACING_HZ if hits else None if levels else chosen


def _motion(seed: int, effects: Sequence[Effect], looks: np.random.Generator) -> tuple[Motion, list[str]]:
    """A log of the robot without the effects, and entries that its base model is to be without."""
    chain = kr90()
    truth = draw_truth(seed, (), (), Tolerances(), log=True)
    # Every other base model is without an entry it usually has; the robot has it only where that is what is concealed.
    missing = [(e.kind, e.site) for e in effects if (e.kind, e.site) in ENTRIES]
    unused, lacking = ENTRIES[int(looks.integers(len(ENTRIES)))], looks.random() < 0.5
    if lacking and not missing:
        missing = [unused]
    columns = {"viscous_friction": "viscous", "coulomb_friction": "coulomb", "gravity_compensator": "compensator"}
    for kind, site in missing:
        values = getattr(truth.chain, columns[kind]).copy()
        values[int(site[5]) - 1] = 0.0
        truth = replace(truth, chain=replace(truth.chain, **{columns[kind]: values}))
    encoder = looks.random() < 0.4 or any(e.kind == "backlash" for e in effects)
    log = Log(
        white=float(looks.uniform(5, 15)), coloured=float(looks.uniform(2, 10)), ripple=float(looks.uniform(0, 0.5)),
        friction=str(looks.choice(["coulomb", "coulomb", "lugre"])), compensator=str(looks.choice(["series", "gas"])),
        link_encoder=bool(encoder),
    )  # fmt: skip
    runs, start = [], 0.0
    for k in range(int(looks.integers(3, 6))):
        seconds, dwells = float(looks.uniform(40, 60)), int(looks.integers(0, 4))
        time = np.arange(int(seconds * log.rate_hz)) / log.rate_hz
        runs.append(Run(f"run{k + 1}", draw_fourier(chain, looks, seconds, dwells), time, start))
        start += seconds + float(looks.uniform(5, 60))
    return Motion(truth, log, tuple(runs)), [f"{kind}@{site}" for kind, site in missing]
