"""The physics that a recording can conceal: names, sites, parameters and the usual range of their sizes.

An effect is written `kind@site` or `kind@site:name=value,name=value` (a list's items are joined by `|`);
parameters not given are drawn, log-uniform over the range in `EFFECTS`. The names, sites and parameters are
those of robot descriptions; the last group lies outside them on purpose.
"""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tools.truth.chain import Array, Chain

Value = float | str | list[float]


class TruthError(ValueError):
    """A request that the truth code cannot meet; the message says what it expected."""


@dataclass(frozen=True)
class Effect:
    kind: str
    site: str
    parameters: dict[str, Value] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        return self.parameters[name]  # type: ignore[return-value]

    def array(self, name: str) -> Array:
        return np.atleast_1d(np.asarray(self.parameters[name], float))

    @property
    def joint(self) -> int:
        """Index from 0 of the joint or link in the site."""
        found = re.match(r"(?:joint|link)(\d+)", self.site)
        if not found:
            raise TruthError(f"{self.kind}@{self.site}: expected a joint or link site")
        return int(found[1]) - 1

    @property
    def axis(self) -> str:
        return self.site.split(".")[-1]


class Kind(NamedTuple):
    """`site` a pattern; `ranges` of the parameters (log-uniform; negative: sign drawn too); where it shows."""

    site: str
    ranges: dict[str, tuple[float, float]]
    shows: str  # "frf", "levels" (FRFs over force levels, simulated in time), "chain" (measurement), "log", "both"
    optional: tuple[str, ...] = ()


JOINT, JOINT_Z, JOINT_XYZ = r"joint\d+", r"joint\d+\.z", r"joint\d+\.[xyz]"
SIGNED = -1.0  # as lower bound: magnitude in [upper/10, upper], sign drawn

EFFECTS: dict[str, Kind] = {
    "transverse_compliance": Kind(r"joint\d+\.[xy]", {"stiffness": (4e6, 4e7), "damping": (5e1, 1e4)}, "frf"),
    "base_compliance": Kind(r"base\.(r?[xyz])", {"stiffness": (1e7, 2e8), "damping": (1e3, 1e4)}, "frf"),
    "link_flexibility": Kind(r"link\d+\.[yz]", {"stiffness": (5e6, 5e7), "damping": (5e1, 5e3)}, "frf", ("segments",)),
    "servo_compliance": Kind(
        JOINT, {"stiffness": (1e7, 1e8), "damping": (3e3, 3e4)}, "frf", ("inertia", "integral_time")
    ),
    "payload": Kind(r"flange|link\d+", {"mass": (3, 60)}, "both", ("com", "inertia")),
    "attached_resonator": Kind(
        r"link\d+",
        {"mass": (5, 30), "frequency_hz": (8, 28), "damping_ratio": (0.005, 0.03)},
        "frf",
        ("axis", "position"),
    ),
    "structural_damping": Kind(JOINT_XYZ, {"loss_factor": (0.005, 0.05)}, "frf", ("damping",)),
    "hardening_stiffness": Kind(JOINT_Z, {"cubic": (3e12, 1e14)}, "levels"),
    "backlash": Kind(JOINT_Z, {"gap": (1e-5, 1.5e-4)}, "both"),
    "hysteresis": Kind(JOINT_Z, {"stiffness": (3e5, 2e6), "yield_torque": (8, 80)}, "both"),
    "viscous_friction": Kind(JOINT, {"coefficient": (5, 300)}, "log"),
    "coulomb_friction": Kind(JOINT, {"torque": (3, 100)}, "log"),
    "asymmetric_friction": Kind(JOINT, {"torque_difference": (SIGNED, 60), "viscous_difference": (SIGNED, 60)}, "log"),
    "stribeck_friction": Kind(JOINT, {"static_excess": (8, 150), "velocity": (0.02, 0.2)}, "log"),
    "load_dependent_friction": Kind(JOINT, {"coefficient": (0.005, 0.08)}, "log"),
    "friction_drift": Kind(JOINT, {"amplitude": (0.03, 0.5), "time_constant": (60, 600)}, "log"),
    "gravity_compensator": Kind(JOINT, {"coefficients": (SIGNED, 600)}, "log"),
    "cable_stiffness": Kind(JOINT, {"stiffness": (4, 100), "rest": (SIGNED, 1.0)}, "log"),
    "torque_ripple": Kind(JOINT, {"amplitude": (2, 40), "order": (4, 60), "phase": (SIGNED, 3.1)}, "log"),
    "joint_coupling": Kind(JOINT, {"from": (1, 3), "ratio": (SIGNED, 0.3)}, "log", ("inertia", "friction", "coulomb")),
    "rotor_inertia": Kind(JOINT, {"inertia": (20, 300)}, "log"),
    "torque_constant": Kind(JOINT, {"gain": (1.01, 1.1)}, "log"),
    "time_delay": Kind(r"log|sensor:\S+", {"delay": (1e-4, 4e-3)}, "chain"),
    "sensor_gain": Kind(r"sensor:\S+", {"gain": (1.02, 1.2)}, "chain"),
    "sensor_misalignment": Kind(r"sensor:\d+", {"angles": (SIGNED, 0.1)}, "chain"),
    "hammer_misalignment": Kind(r"hammer:\S+", {"angles": (SIGNED, 0.2)}, "chain"),
    "floor_mode": Kind(  # springs by name, N/m and N·m/rad; moments of inertia of the slab about x, y, z
        "base",
        {"mass": (1e3, 1e4), "inertia": (5e2, 1e4), "damping_ratio": (0.01, 0.05)},
        "frf",
        ("x", "y", "z", "rx", "ry", "rz"),
    ),
    "cross_stiffness": Kind(JOINT, {"stiffness": (SIGNED, 3e6)}, "frf"),
    "joint_offset": Kind(JOINT, {"angle": (SIGNED, 0.02)}, "both"),
    "gravity_direction": Kind("base", {"angles": (SIGNED, 0.03)}, "log"),  # tilt of the foot about its x, then its y
    # Outside the catalogue: what a diagnosis must locate and must not misname.
    "eddy_current_damper": Kind(JOINT_Z, {"coefficient": (3e5, 1e7)}, "levels"),
    "posture_stiffness": Kind(JOINT_Z, {"amplitude": (0.1, 0.4), "phase": (SIGNED, 3.1)}, "frf"),
    "fractional_damper": Kind(JOINT_XYZ, {"coefficient": (1e4, 1e5), "order": (0.3, 0.7)}, "frf"),
    "quadratic_friction": Kind(JOINT, {"coefficient": (5, 300)}, "log"),  # c q̇|q̇|: churned oil
    "position_friction": Kind(JOINT, {"torque": (5, 100), "order": (1, 4), "phase": (SIGNED, 3.1)}, "log"),
}
# A blow deflects a joint by 1e-5 to 2e-4 rad, a motion log sees travel of 1e-4 rad and more.
LOG_RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "backlash": {"gap": (1e-4, 2e-3)},
    "hysteresis": {"stiffness": (3e4, 1e6), "yield_torque": (8, 200)},
}
LENGTHS = {  # parameters that are lists
    ("gravity_compensator", "coefficients"): 3,
    ("sensor_misalignment", "angles"): 3,
    ("hammer_misalignment", "angles"): 2,
    ("gravity_direction", "angles"): 2,
    ("payload", "com"): 3,
    ("floor_mode", "inertia"): 3,
    ("attached_resonator", "position"): 3,
}


def parse(text: str) -> Effect:
    """Effect from `kind@site[:name=value,…]`."""
    kind, _, rest = text.partition("@")
    # A measurement-chain site holds a colon of its own: `sensor:21Z+:gain=1.1`.
    found = re.fullmatch(r"((?:sensor:|hammer:)?[^:]+)(?::(.*))?", rest)
    if kind not in EFFECTS:
        raise TruthError(f"effect {kind!r}: expected one of {', '.join(EFFECTS)}")
    spec = EFFECTS[kind]
    if not found or not re.fullmatch(spec.site, found[1]):
        raise TruthError(f"{text}: expected {kind}@SITE[:name=value,…] with SITE like {spec.site}")
    parameters: dict[str, Value] = {}
    for item in filter(None, (found[2] or "").split(",")):
        name, _, value = item.partition("=")
        if name not in (*spec.ranges, *spec.optional):
            raise TruthError(f"{kind}: no parameter {name!r}; it has {', '.join((*spec.ranges, *spec.optional))}")
        try:
            numbers = [float(v) for v in value.split("|")]
        except ValueError:
            if name != "axis":
                raise TruthError(f"{kind}: {name}={value!r}: expected a number or numbers joined by |") from None
            parameters[name] = value
        else:
            parameters[name] = numbers if "|" in value else numbers[0]
    return Effect(kind, found[1], parameters)


def draw(effect: Effect, chain: Chain, rng: np.random.Generator, *, log: bool = False) -> Effect:
    """The effect with every parameter not given drawn over its usual range (in a motion log: `LOG_RANGES`)."""
    spec, given = EFFECTS[effect.kind], dict(effect.parameters)
    ranges = LOG_RANGES.get(effect.kind, spec.ranges) if log else spec.ranges
    if re.match(r"joint|link", effect.site) and not 0 <= effect.joint < chain.n:
        raise TruthError(f"{effect.kind}@{effect.site}: the chain has joints 1 to {chain.n}")
    if effect.kind == "hysteresis" and not given:
        return Effect(effect.kind, effect.site, many_slip_elements(ranges, rng))
    for name, (low, high) in ranges.items():
        length = LENGTHS.get((effect.kind, name))
        size = () if length is None else (length,)
        size_drawn: Array = np.exp(rng.uniform(np.log(high / 10 if low < 0 else low), np.log(high), size))
        if low < 0:
            size_drawn = size_drawn * rng.choice([-1.0, 1.0], size)
        given.setdefault(name, size_drawn.tolist())
    if effect.kind == "base_compliance" and len(effect.axis) == 1 and "stiffness" not in effect.parameters:
        given["stiffness"] = float(np.exp(rng.uniform(np.log(1e7), np.log(2e8))))  # N/m, not N·m/rad
    if effect.kind == "gravity_compensator" and "coefficients" not in effect.parameters:
        given["coefficients"] = (np.asarray(given["coefficients"]) * [1, 0.5, 0.3]).tolist()
    if effect.kind == "joint_coupling" and "from" not in effect.parameters:
        given["from"] = float(rng.choice([j for j in range(1, chain.n + 1) if j != effect.joint + 1]))
    if effect.kind == "payload":
        tip = chain.flange if effect.site == "flange" else chain.ends()[effect.joint]
        given.setdefault("com", (tip + rng.uniform(-0.1, 0.1, 3)).tolist())
    if effect.kind == "attached_resonator":
        along = rng.uniform(0.2, 0.9) * chain.ends()[effect.joint] + rng.uniform(-0.15, 0.15, 3)
        given.setdefault("axis", str(rng.choice(["x", "y", "z"])))
        given.setdefault("position", along.tolist())
    for name, value in given.items():
        found, length = np.size(value), LENGTHS.get((effect.kind, name), 1)
        if found != length and effect.kind != "hysteresis" and name != "inertia":
            raise TruthError(
                f"{effect.kind}@{effect.site}: {name}: expected {length} numbers joined by |, found {found}"
            )
    if effect.kind == "hysteresis" and np.size(given["stiffness"]) != np.size(given["yield_torque"]):
        raise TruthError(f"hysteresis@{effect.site}: expected as many yield_torque as stiffness")
    return Effect(effect.kind, effect.site, given)


def many_slip_elements(
    ranges: dict[str, tuple[float, float]], rng: np.random.Generator, count: int = 15
) -> dict[str, Value]:
    """Iwan's distribution: equal stiffnesses whose yield torques grow as a power of the index."""
    stiffness, torque = (np.exp(rng.uniform(*np.log(ranges[n]))) for n in ("stiffness", "yield_torque"))
    share = ((np.arange(count) + 0.5) / count) ** rng.uniform(1, 2.5)
    return {
        "stiffness": np.full(count, stiffness / count).tolist(),
        "yield_torque": (torque * share / share.sum()).tolist(),
    }
