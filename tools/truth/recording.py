"""Hammer-test campaigns: what accelerometers and hammer record of the true robot, written as `frf-campaign`.

The chain of measurement is part of the truth: off-axis blows, turned, mis-scaled and late sensors, pulse
spectrum, sensor noise, averaging, coherence, windows. The answer goes into a JSON file of its own.
"""

import json
import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import h5py
import numpy as np
from scipy.signal import butter, sosfilt

from tools.truth.blows import half_sine, nonlinear_frf, strike, transform
from tools.truth.chain import POSTURES_DEG, Array, Chain, Tolerances, cross, flange_position, kr90, perturb
from tools.truth.effects import EFFECTS, Effect, TruthError, draw
from tools.truth.elastic import AXES, Structure, assemble, rotation_about
from tools.truth.laws import Complex

ANTI_ALIAS = 0.4  # of the sampling rate: the filter that force and response go through
MAINS_HZ = 50.0
STEP_HZ = 4096.0  # time step of simulated blows: 1e-4 of a smooth FRF, with a gap too
HIT_STEP_HZ = 4 * STEP_HZ  # of blows recorded in time: a force linear over a step is off by (πf/rate)²/3, 1e-4


@dataclass(frozen=True)
class Channel:
    """A hammer or sensor point: label node-axis-sign, body, position (3,) m and axis in the body's frame."""

    label: str
    body: str
    position: tuple[float, float, float]

    @property
    def direction(self) -> Array:
        return AXES[self.label[-2].lower()] * (-1.0 if self.label[-1] == "-" else 1.0)

    @property
    def node(self) -> str:
        return self.label[:-2]


FLANGE = (1.615, -0.041, 0.0)
HAMMER = (  # Places that a hammer reaches; the paper gives no coordinates.
    Channel("1X+", "link1", (-0.42, 0.0, -0.10)),
    Channel("2Y+", "link1", (0.0, -0.40, -0.15)),
    Channel("3Y-", "link1", (0.25, 0.36, 0.02)),
    Channel("4Y+", "link1", (0.32, -0.36, 0.05)),
    Channel("5Z-", "link1", (-0.30, 0.12, 0.16)),
    Channel("6Y+", "link2", (0.25, -0.16, 0.22)),
    Channel("7Z-", "link2", (0.30, 0.04, 0.44)),
    Channel("8Y+", "link2", (0.72, -0.13, 0.25)),
    Channel("9Z-", "link2", (0.72, 0.05, 0.42)),
    Channel("10Y-", "link2", (1.10, 0.13, 0.22)),
    Channel("11Z-", "link2", (1.15, 0.0, 0.40)),
    Channel("12X-", "link2", (1.54, 0.0, 0.20)),
    Channel("13Z+", "link2", (1.30, 0.06, 0.04)),
    Channel("14Y+", "link3", (0.20, -0.22, -0.05)),
    Channel("15Z+", "link3", (0.22, 0.0, -0.24)),
    Channel("16Y-", "link3", (0.60, 0.15, 0.0)),
    Channel("17Z-", "link3", (0.66, -0.02, 0.18)),
    Channel("18Y-", "link3", (1.00, 0.11, 0.0)),
    Channel("19Z-", "link3", (1.05, -0.03, 0.15)),
    Channel("20Z+", "link3", (1.36, -0.04, -0.12)),
    Channel("21X-", "link3", FLANGE),
    Channel("21Y+", "link3", FLANGE),
    Channel("21Z+", "link3", FLANGE),
)
SENSORS = tuple(Channel(f"21{axis}+", "link3", FLANGE) for axis in "XYZ")


@dataclass(frozen=True)
class Posture:
    """`brakes`: "on" (rotors held whatever the servo), "off", or None: off and not recorded."""

    name: str
    q_deg: tuple[float, ...]
    brakes: str | None = "off"


@dataclass(frozen=True)
class HammerTest:
    """How the campaign is measured.

    Lines at start + k·spacing Hz; the record lasts 1/spacing s. `noise` is the sensors' one-sided amplitude density,
    m/s²/√Hz, `scatter` the relative spread of one hit's FRF. Coherence is either the one that the noise level
    implies ("expected") or what an analyser estimates from the averages ("estimated": scattered, and its variance
    too small by (n−1)/n). `levels_n`: peak forces, one group of the file each; empty: one level, `peak_n`, and no
    level recorded. `spread`: relative difference (±) in force of the blows averaged, which
    a nonlinear robot answers with scatter. `window` 1/s: rate of the exponential window left in the
    FRFs; by default none, or five per record where blows are simulated in time, whose ends would leak. `hum` m/s²: RMS
    over the sensors of the amplitude of a tone at `MAINS_HZ`, whose phase differs from blow to blow; needs a window.
    """

    start_hz: float = 5.0
    spacing_hz: float = 0.125
    lines: int = 200
    averages: int = 5
    noise: float = 3e-5
    scatter: float = 0.005
    coherence: str = "expected"
    peak_n: float = 300.0
    pulse_s: float = 0.008
    levels_n: tuple[float, ...] = ()
    window: float | None = None
    spread: float = 0.0
    hits: int = 0
    hit_rate_hz: float = 1024.0
    double_hits: float = 0.0
    hum: float = 0.0

    @property
    def frequency(self) -> Array:
        return self.start_hz + self.spacing_hz * np.arange(self.lines)

    @property
    def peaks(self) -> tuple[float, ...]:
        return self.levels_n or (self.peak_n,)

    @property
    def decay(self) -> float:
        return (5 * self.spacing_hz if self.levels_n or self.hits else 0.0) if self.window is None else self.window


@dataclass(frozen=True)
class Truth:
    """The robot as it is: the chain, the concealed effects, and what belongs to this recording alone.

    `sensors`, `hammer`: the channels as the recording states them. `moved`: by site (`sensor:NODE`, `hammer:LABEL`)
    how far (3,) m a point is from where it is stated. `turned`: by the same, small angles (3,) rad of its direction.
    """

    chain: Chain
    effects: tuple[Effect, ...] = ()
    posture_error: dict[str, Array] = field(default_factory=dict)
    gain: dict[str, float] = field(default_factory=dict)
    sag: bool = True
    seed: int | None = None
    sensors: tuple[Channel, ...] = SENSORS
    hammer: tuple[Channel, ...] = HAMMER
    moved: dict[str, Array] = field(default_factory=dict)
    turned: dict[str, Array] = field(default_factory=dict)

    @property
    def nonlinear(self) -> bool:
        return any(EFFECTS[e.kind].shows == "levels" or e.kind in ("backlash", "hysteresis") for e in self.effects)


def draw_truth(
    seed: int,
    effects: tuple[Effect, ...],
    postures: tuple[Posture, ...],
    tolerances: Tolerances | None = None,
    *,
    chain: Chain | None = None,
    sag: bool = True,
    log: bool = False,
    sensors: tuple[Channel, ...] = SENSORS,
    hammer: tuple[Channel, ...] = HAMMER,
) -> Truth:
    """A truth near `chain` (default KR90). Robot, recording and each effect have a random stream of their own.

    So the same seed is the same robot in a campaign and in a log, and an effect's size does not depend on what is
    beside it.
    """
    tolerances, chain = tolerances or Tolerances(), chain or kr90()
    robot, _, recording = streams(seed)[:3]
    true = perturb(chain, robot, tolerances)
    return Truth(
        true,
        tuple(
            draw(e, chain, np.random.default_rng([seed, crc32(f"{e.kind}@{e.site}".encode())]), log=log)
            for e in effects
        ),
        {p.name: np.deg2rad(tolerances.posture_deg) * recording.uniform(-1, 1, chain.n) for p in postures},
        {c.label: 1 + tolerances.gain * recording.uniform(-1, 1) for c in sensors},
        sag,
        seed,
        sensors,
        hammer,
    )


def streams(seed: int) -> list[np.random.Generator]:
    """Independent generators: robot, postures, recording, noise, trajectories."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]


def draw_postures(count: int, rng: np.random.Generator, chain: Chain | None = None) -> tuple[Posture, ...]:
    """The paper's three postures, then random ones: in the joint ranges, the flange in the workspace, q₁ spread."""
    chain = chain or kr90()
    found = [Posture(name, q) for name, q in POSTURES_DEG.items()][:count]
    low, high = np.rad2deg(chain.range_.T)
    low[0], high[0] = -90.0, 90.0
    while len(found) < count:
        q = np.round(rng.uniform(low + 5, high - 5))
        tip = flange_position(chain, np.deg2rad(q))
        if np.all((tip > chain.workspace[:, 0]) & (tip < chain.workspace[:, 1])) and abs(q[2] + 40) > 15:
            found.append(Posture(f"posture{len(found) + 1}", tuple(float(x) for x in q)))
    return tuple(found)


def rows(truth: Truth, structure: Structure) -> tuple[Array, Array]:
    """Sensitive directions of the sensors (nr, n) and of the blows (ne, n), misalignments included."""
    turned: dict[str, Array] = {}
    for e in truth.effects:
        if e.kind == "sensor_misalignment":
            a, b, c = e.array("angles")
            turn = rotation_about(AXES["z"], c) @ rotation_about(AXES["y"], b) @ rotation_about(AXES["x"], a)
            turned[e.site] = turn.T
        elif e.kind == "hammer_misalignment":
            others = [axis for axis in "xyz" if axis != e.site[-2].lower()]
            turns = [rotation_about(AXES[x], v) for x, v in zip(others, e.array("angles"), strict=True)]
            turned[e.site] = turns[1] @ turns[0]

    def felt(channels: Sequence[Channel], sites: Sequence[str]) -> Array:
        position = np.array([c.position for c in channels], float)
        direction = np.array([c.direction for c in channels])
        for k, site in enumerate(sites):
            if site in turned:
                direction[k] = turned[site] @ direction[k]
            if site in truth.turned:
                direction[k] += cross(truth.turned[site], direction[k])
            if site in truth.moved:
                position[k] += truth.moved[site]
        return structure.rows([c.body for c in channels], position, direction)

    return (
        felt(truth.sensors, [f"sensor:{c.node}" for c in truth.sensors]),
        felt(truth.hammer, [f"hammer:{c.label}" for c in truth.hammer]),
    )


def channel_factor(truth: Truth, s: Complex) -> Complex:
    """What each sensor channel multiplies its signal with, (nf, nr): gains and delays."""
    factor = np.tile([truth.gain.get(c.label, 1.0) for c in truth.sensors], (len(s), 1)).astype(complex)
    for i, c in enumerate(truth.sensors):
        for e in truth.effects:
            if e.site == f"sensor:{c.label}" and e.kind == "sensor_gain":
                factor[:, i] *= e["gain"]
            elif e.site == f"sensor:{c.label}" and e.kind == "time_delay":
                factor[:, i] *= np.exp(-s * e["delay"])
    return factor


def structure_at(truth: Truth, posture: Posture) -> Structure:
    q = np.deg2rad(posture.q_deg) + truth.posture_error.get(posture.name, 0.0)
    return assemble(truth.chain, q, truth.effects, brakes_on=posture.brakes == "on", sag=truth.sag)


def accelerance(
    truth: Truth,
    postures: tuple[Posture, ...],
    test: HammerTest,
    rng: np.random.Generator | None = None,
    structures: Sequence[Structure] | None = None,
) -> list[Complex]:
    """Noise-free FRFs of each posture, (nlevel, nhit, nf, nr, ne), (m/s²)/N; its `structures`, where they are known.

    One hit is enough for a linear truth; a nonlinear one has `averages` when the test's blows differ in force, drawn
    from `rng`.
    """
    structures = structures or [structure_at(truth, posture) for posture in postures]
    directions = [rows(truth, structure) for structure in structures]
    s = test.decay + 2j * np.pi * test.frequency
    if structures[0].laws:
        shape = (len(test.peaks), test.averages if test.spread else 1, len(truth.hammer))
        spread = test.spread * (rng or np.random.default_rng(0)).uniform(-1, 1, shape)
        peaks = np.asarray(test.peaks)[:, None, None] * (1 + spread)
        force = half_sine(peaks.ravel(), test.pulse_s, STEP_HZ)
        response, blows = [r for r, _ in directions], [np.tile(e, (shape[0] * shape[1], 1)) for _, e in directions]
        samples = round(STEP_HZ / test.spacing_hz)
        flat = nonlinear_frf(structures, response, blows, force, STEP_HZ, samples, test.frequency, test.decay)
        receptance = [f.reshape(*f.shape[:2], *shape).transpose(2, 3, 0, 1, 4) for f in flat]
    else:
        linear = [x.receptance(s, *d) for x, d in zip(structures, directions, strict=True)]
        receptance = [np.tile(f, (len(test.peaks), 1, 1, 1, 1)) for f in linear]
    factor = ((s**2)[:, None] * channel_factor(truth, s))[:, :, None]
    return [frf * factor for frf in receptance]


def average(frf: Complex, test: HammerTest, peak_n: float, rng: np.random.Generator) -> tuple[Complex, Array]:
    """H1 estimate and coherence (nf, nr, ne) from the FRFs (nhit or 1, nf, nr, ne) of the hits, noise added."""
    variance = hit_variance(test, frf, peak_n, test.frequency)
    shape = (test.averages, *frf.shape[1:])
    single = frf + np.sqrt(variance / 2) * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    mean = single.mean(0)
    if test.coherence == "estimated":
        power = (np.abs(single) ** 2).mean(0)
        return mean, np.divide(np.abs(mean) ** 2, power, out=np.ones(power.shape), where=power > 0)
    # A channel without signal or noise has no coherence to speak of: 1 there, as without noise.
    signal, total = np.abs(frf.mean(0)) ** 2, (np.abs(frf) ** 2 + variance).mean(0)
    return mean, np.divide(signal, total, out=np.ones(total.shape), where=total > 0)


def hit_variance(test: HammerTest, frf: Complex, peak_n: float, frequency: Array) -> Array:
    """Variance of the FRF (..., nf, nr, ne) of one hit, both parts together: of the sensors' noise and hum under the
    window and of what blows differ by."""
    pulse = transform(half_sine(np.array([peak_n]), test.pulse_s, 8 * STEP_HZ), 8 * STEP_HZ, frequency)
    duration = 1 / test.spacing_hz
    seen = -np.expm1(-2 * test.decay * duration) / (2 * test.decay) if test.decay else duration
    power = np.full((len(frequency), 1, 1), test.noise**2 * seen / 2)
    if test.hum:
        apart = test.decay + 2j * np.pi * (frequency - MAINS_HZ)
        power[:, 0, 0] += test.hum**2 / 4 * np.abs(np.expm1(-apart * duration) / apart) ** 2
    return power / np.abs(pulse[:, None, :]) ** 2 + (test.scatter * np.abs(frf)) ** 2


def raw_hits(
    truth: Truth, posture: Posture, test: HammerTest, peak_n: float, rng: np.random.Generator
) -> tuple[Array, Array, float]:
    """Force (ne, nh, nt), responses (ne, nh, nr, nt) and the pretrigger: blows differ, some bounce."""
    structure = structure_at(truth, posture)
    if any(e.kind == "time_delay" for e in truth.effects):
        raise TruthError("time_delay: expected FRFs (no --hits); a delay is written into FRFs only")
    response, excitation = rows(truth, structure)
    ne, nh = len(excitation), test.hits
    each = np.repeat(excitation, nh, 0)
    every = round(HIT_STEP_HZ / test.hit_rate_hz)
    samples = round(test.hit_rate_hz / test.spacing_hz)
    columns = []
    for _ in range(ne * nh):
        peak, width = peak_n * rng.uniform(0.8, 1.2), test.pulse_s * rng.uniform(0.9, 1.1)
        pulse = half_sine(np.array([peak]), width, HIT_STEP_HZ)[:, 0]
        second = int(rng.uniform(0.03, 0.08) * HIT_STEP_HZ) if rng.random() < test.double_hits else 0
        wave = np.zeros(int(0.1 * HIT_STEP_HZ))
        wave[: len(pulse)] = pulse
        if second:
            wave[second : second + len(pulse)] += rng.uniform(0.2, 0.5) * pulse
        columns.append(wave)
    force = np.array(columns).T
    before = samples // 64
    steps = (samples - before) * every
    signal = strike(structure, response, each, force, HIT_STEP_HZ, steps)
    filtered = butter(8, ANTI_ALIAS * test.hit_rate_hz, fs=HIT_STEP_HZ, output="sos")
    signal = sosfilt(filtered, signal, axis=0)[::every]
    signal *= channel_factor(truth, np.zeros(1))[0].real[None, :, None]
    out_force, out = np.zeros((samples, ne * nh)), np.zeros((samples, len(response), ne * nh))
    out[before:] = signal
    out_force[before:] = sosfilt(filtered, np.pad(force, ((0, steps - len(force)), (0, 0))), axis=0)[::every]
    out += rng.normal(scale=test.noise * np.sqrt(test.hit_rate_hz / 2), size=out.shape)
    return (
        out_force.T.reshape(ne, nh, samples),
        out.transpose(2, 1, 0).reshape(ne, nh, len(response), samples),
        before / test.hit_rate_hz,
    )


def h1(force: Array, response: Array, test: HammerTest, pretrigger_s: float) -> tuple[Complex, Array]:
    """H1 and coherence (nf, nr, ne) of raw hits, window of rate `decay` from the trigger on both channels."""
    before = round(pretrigger_s * test.hit_rate_hz)
    f = transform(force[..., before:].transpose(2, 0, 1), test.hit_rate_hz, test.frequency, test.decay)
    x = transform(response[..., before:].transpose(3, 0, 1, 2), test.hit_rate_hz, test.frequency, test.decay)
    cross = (x * f.conj()[..., None]).mean(2).transpose(0, 2, 1)
    own, other = (np.abs(f) ** 2).mean(2)[:, None, :], (np.abs(x) ** 2).mean(2).transpose(0, 2, 1)
    return cross / own, np.abs(cross) ** 2 / (own * other)


def write_campaign(
    path: Path,
    truth: Truth,
    postures: tuple[Posture, ...],
    test: HammerTest,
    rng: np.random.Generator,
    *,
    robot: str | None = "kr90",
    answer: Path | None = None,
) -> None:
    """Record the campaign into `path`, and the truth into `answer` when given; nothing is half-written."""
    check(truth, test)
    aside = path.with_name(path.name + ".part")
    try:
        with h5py.File(aside, "w") as file:
            file.attrs.update(format="frf-campaign", version=1, comment="hammer test, roving hammer")
            if robot:
                file.attrs["robot"] = robot
            for name, channels in (("response", truth.sensors), ("excitation", truth.hammer)):
                group = file.create_group(name)
                group["label"] = [c.label for c in channels]
                group["body"] = [c.body for c in channels]
                group["position"] = np.array([c.position for c in channels])
                group["direction"] = np.array([c.direction for c in channels])
            frfs = [None] * len(postures) if test.hits else accelerance(truth, postures, test, rng)
            for posture, exact in zip(postures, frfs, strict=True):
                for i, level in enumerate(test.peaks):
                    name = posture.name + (f"@{level:g}N" if test.levels_n else "")
                    group = file.create_group(f"postures/{name}")
                    group.attrs.update(q_deg=np.array(posture.q_deg), exponential_window_rate=test.decay)
                    if posture.brakes:
                        group.attrs["brakes"] = posture.brakes
                    if test.levels_n:
                        group.attrs["peak_force_n"] = level
                    _fill(group, truth, posture, test, level, None if exact is None else exact[i], rng)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    if answer:
        write_answer(answer, {"truth": truth, "postures": postures, "test": test})


def _fill(
    group: h5py.Group,
    truth: Truth,
    posture: Posture,
    test: HammerTest,
    peak_n: float,
    exact: Complex | None,
    rng: np.random.Generator,
) -> None:
    if exact is None:
        force, response, pretrigger = raw_hits(truth, posture, test, peak_n, rng)
        frf, coherence = h1(force, response, test, pretrigger)
        raw = group.create_group("hits")
        raw.attrs.update(sample_rate_hz=test.hit_rate_hz, pretrigger_s=pretrigger)
        raw.attrs.update(windowed=False, exponential_window_rate=0.0)
        raw.create_dataset("force", data=force, dtype="f4")
        raw.create_dataset("response", data=response, dtype="f4")
    else:
        frf, coherence = average(exact, test, peak_n, rng)
    group["frequency"] = test.frequency
    group["frf"], group["coherence"] = frf, coherence
    group["frf"].attrs.update(quantity="accelerance", unit="(m/s^2)/N")
    group["coherence"].attrs["averages"] = test.hits or test.averages


def check(truth: Truth, test: HammerTest) -> None:
    labels = {f"sensor:{c.label}" for c in truth.sensors} | {f"hammer:{c.label}" for c in truth.hammer}
    labels |= {f"sensor:{c.node}" for c in truth.sensors}
    for e in truth.effects:
        if EFFECTS[e.kind].shows == "log" or e.site == "log":
            raise TruthError(f"{e.kind}@{e.site}: expected an effect that a hammer test shows; this one is for `log`")
        if re.match("sensor:|hammer:", e.site) and e.site not in labels:
            raise TruthError(f"{e.kind}@{e.site}: expected one of {', '.join(sorted(labels))}")
    if truth.nonlinear and not (test.levels_n or test.hits):
        raise TruthError("a nonlinear effect: expected force levels (--force-levels 100 600), or raw hits (--hits 3)")


def write_answer(path: Path, content: dict[str, Any]) -> None:
    """Everything concealed, as JSON."""
    aside = path.with_name(path.name + ".part")
    aside.write_text(json.dumps(plain(content), indent=1), encoding="utf-8")
    os.replace(aside, path)


def plain(value: Any) -> Any:
    """Dataclasses, arrays and tuples as JSON holds them; infinite stiffness as null."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
