"""What is mutated: one small valid file of every format, and the command lines that take it."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import mcap_ros2.writer
import nptdms
import numpy as np
import scipy.io
import scipy.io.wavfile

import twin
from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log
from twin.measure.uff import write_uff

ROBOT = """name: two
links:
  - {mass: 120, com: [0.1, 0, 0.2], inertia: [4, 5, 3, 0, 0.1, 0]}
  - {mass: 60, com: [0.4, 0, 0], inertia: [0.5, 6, 6, 0, 0, 0]}
axes:
  - {d: 0.5, stiffness: 2.0e6, damping: 900, limits: {position: [-3, 3], velocity: 2, acceleration: 6}}
  - {alpha_deg: 90, a: 0.2, stiffness: 1.5e6, damping: 700, limits: {position: [-2, 2], velocity: 2, acceleration: 6}}
drives: [{gear_ratio: 150, rotor_inertia: 2.0e-3}, {gear_ratio: 120, rotor_inertia: 2.0e-3, coupling: {joint1: 0.1}}]
flange: {position: [0.8, 0, 0]}
workspace: {x: [-3, 3], y: [-3, 3], z: [-2, 4]}
test_points:
  - {label: 1X+, body: link2, position: [0.8, 0, 0], direction: [1, 0, 0]}
  - {label: 1Z+, body: link2, position: [0.8, 0, 0], direction: [0, 0, 1]}
accelerometers: [1Z+]
physics:
  - {effect: transverse_compliance, site: joint1.x, stiffness: 3.0e6, damping: 900}
  - {effect: coulomb_friction, site: joint1, torque: 40}
  - {effect: discovered, site: joint2, formula: c1*sin(q2) + c2*v1, coefficients: [1.0, 0.2]}
priors: [{parameter: joint*.z.stiffness, factor: 2.0}]
tolerances: {mass: 0.03}
"""
POSTURE = """robot: two.yaml
posture: {name: bent, q_deg: [10, 40], brakes: "on"}
hammer: {force_n: [300], duration_s: 1, hits: 2, sample_rate_hz: 1024}
replay: log.h5
cut:
  tool: {diameter_m: 0.016, teeth: 2, helix_deg: 30, overhang_m: 0.25, mass_kg: 12}
  coefficients: aluminium_7075
  immersion: 0.5
  milling: down
  feed_per_tooth_m: 1.0e-4
  feed_direction: [1, 0, 0]
  spindle_rpm: [1000, 12000]
"""
CUT = """tool: {diameter_m: 0.016, teeth: 2, overhang_m: 0.25, mass_kg: 12}
coefficients: {kt_n_per_m2: 6.0e+8, kr_n_per_m2: 1.8e+8, deviation_percent: 10}
immersion: 0.5
milling: up
feed_direction: [0.3, 1, 0.2]
spindle_rpm: [1000, 6000]
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"><inertial><mass value="10"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 0.2" rpy="0 0 0"/><mass value="5"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><cylinder radius="0.05" length="0.4"/></geometry></visual></link>
  <link name="fore"><inertial><origin xyz="0 0 0.2" rpy="0 0 0"/><mass value="3"/>
    <inertia ixx="0.05" iyy="0.05" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="100"/>
    <dynamics damping="1" friction="2"/></joint>
  <joint name="a2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="100"/></joint>
</robot>
"""
SHEET = "payload: 5\nmax_speed: [120, 120]\nmax_torque: [330, 150]\ngears: [strain_wave, strain_wave]\n"
TOOL = "name: spindle\nmass: 4\ncom: [0, 0, 0.1]\n"
PATHS = {
    "path.csv": "x_mm,y_mm,z_mm\n800,0,500\n820,0,500\n840,10,500\n",
    "path.nc": "G21 G90\nG0 X800 Y0 Z500\nG1 X820 F600\nG2 X840 Y20 R20\nM30\n",
    "path.apt": "UNITS/MM\nGOTO/800,0,500\nGOTO/820,0,500\nFINI\n",
}
LOG_MAP = """makes: motion-log
robot: two.yaml
time: {channels: %s, unit: s}
position: {channels: %s, unit: rad}
torque: {channels: %s, unit: Nm}
"""
LOG_MAPS = {
    "csv": LOG_MAP % ("t", "q*", "tau*"),
    "mat": LOG_MAP % ("t", "q.*", "tau.*"),
    "tdms": LOG_MAP % ("t", "q*", "tau*"),
    "mcap": LOG_MAP % ("time", "position.*", "effort.*"),
}
WAV_MAP = """makes: frf-campaign
robot: two.yaml
postures: {bent: {q_deg: [10, 40], brakes: "on"}}
force: {channels: channel.1, unit: N, factor: 1000}
response: [{label: 1Z+, channel: channel.2, unit: m/s^2, factor: 10, body: link2, position: [0.8, 0, 0]}]
excitation: [{label: 1Z+, body: link2, position: [0.8, 0, 0]}]
record_s: 0.9
pretrigger_s: 0.0
"""
UNV_MAP = """makes: frf-campaign
robot: two.yaml
postures: {bent: {q_deg: [10, 40], brakes: "on"}}
nodes: {1: {body: link2, position: [0.8, 0, 0]}}
unit: (m/s^2)/N
"""
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


@dataclass(frozen=True)
class Target:
    """A command line: ``file`` is mutated, ``beside`` are left whole; ``options`` may be mutated in its stead."""

    command: str
    file: str
    beside: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    numbers: tuple[str, ...] = ()
    weight: int = 1

    def line(self, replaced: str | None = None) -> list[str]:
        """The arguments; options keep their order."""
        found = [self.command, *([replaced or self.file] if "{}" not in self.options else [])]
        return found + [(replaced or self.file) if word == "{}" else word for word in self.options]


EXCITE = ("--robot", "{}", "--count", "1", "--harmonics", "1")
TARGETS = (
    Target("simulate", "posture.yaml", ("two.yaml", "log.h5"), (), ("--seed",), 6),
    Target("simulate", "two.yaml", ("log.h5", "posture.yaml"), ("posture.yaml", "--robot", "{}"), (), 6),
    Target("view", "two.yaml", (), (), (), 2),
    Target("view", "log.h5", ("two.yaml",), (), (), 2),
    Target("view", "modes.yaml", ("two.yaml",), (), (), 2),
    Target("modal", "hammer.h5", ("two.yaml",), (), ("--fmin", "--fmax", "--max-order"), 4),
    Target("modal", "hits.h5", ("two.yaml",), (), ("--fmin", "--fmax", "--max-order"), 3),
    Target("modal", "hammer.unv", ("two.yaml",), ("--robot", "two.yaml"), ("--max-order",), 3),
    Target("compare", "hammer.h5", ("two.yaml",), ("--as-is",), ("--low-pass",), 4),
    Target("compare", "modes.yaml", ("two.yaml",), ("--as-is",), (), 4),
    Target("compare", "log.h5", ("two.yaml",), ("--as-is",), ("--low-pass",), 4),
    Target("compare", "log.csv", ("two.yaml",), ("--robot", "two.yaml", "--as-is"), ("--low-pass",), 4),
    Target("compare", "hammer.unv", ("two.yaml",), ("--robot", "two.yaml", "--as-is"), (), 3),
    Target("fit", "modes.yaml", ("two.yaml",), ("--starts", "1"), ("--starts", "--seed", "--band"), 2),
    Target("fit", "hammer.h5", ("two.yaml",), ("--starts", "1"), ("--starts", "--seed", "--band"), 1),
    Target("identify", "log.h5", ("two.yaml",), (), ("--low-pass", "--seed"), 4),
    Target("identify", "log.csv", ("two.yaml",), ("--robot", "two.yaml"), ("--low-pass",), 3),
    Target("identify", "two.yaml", ("log.h5",), ("log.h5", "--robot", "{}"), (), 3),
    Target(
        "excite", "two.yaml", (), EXCITE,
        ("--count", "--harmonics", "--base-hz", "--periods", "--sample-rate-hz", "--seed"), 3,
    ),
    Target("lobes", "posture.yaml", ("two.yaml", "log.h5"), ("--draws", "0"), ("--draws", "--in-time", "--rpm"), 3),
    Target("lobes", "cut.yaml", ("two.yaml",), ("two.yaml", "--cut", "{}"), ("--draws", "--in-time", "--rpm"), 3),
    Target(
        "map", "cut.yaml", ("two.yaml",), ("--robot", "two.yaml", "--random", "3", "--processes", "1"),
        ("--random", "--spacing", "--spindle-rpm", "--lobes", "--draws", "--place-turn-deg", "--seed"), 2,
    ),
    *(
        Target("map", name, ("cut.yaml",),  # two axes follow no path
               ("cut.yaml", "--path", "{}", "--robot", "kr90_six", "--place", "1.2", "0", "0.3", "--processes", "1"),
               ("--spacing",), 2)
        for name in PATHS
    ),
    Target("describe", "arm.urdf", ("sheet.yaml",), (), (), 6),
    Target("describe", "sheet.yaml", ("arm.urdf",), ("arm.urdf", "--sheet", "{}"), (), 3),
    Target("describe", "tool.yaml", ("arm.urdf",), ("arm.urdf", "--tool", "{}"), (), 3),
    *(
        Target("import", file, ("two.yaml", beside), ("{}", "--map", beside), (), 2)
        for file, beside in (*((f"foreign.{kind}", f"{kind}-map.yaml") for kind in LOG_MAPS),
                             ("blows.wav", "wav-map.yaml"), ("hammer.unv", "unv-map.yaml"))
    ),
    *(
        Target("import", f"{kind}-map.yaml", ("two.yaml", file), (file, "--map", "{}"), (), 1)
        for kind, file in (("csv", "foreign.csv"), ("wav", "blows.wav"), ("unv", "hammer.unv"))
    ),
    Target("import", "foreign.csv", (), ("--guess", "{}"), (), 1),
    Target("example", "tool.yaml", (), ("{}",), (), 1),
    Target("fit", "hammer.unv", ("two.yaml",), ("--robot", "two.yaml", "--starts", "1"), ("--band",), 1),
    Target("fit", "hits.h5", ("two.yaml",), ("--starts", "1"), (), 1),
    Target("compare", "hits.h5", ("two.yaml",), ("--as-is",), (), 1),
    Target("compare", "hammer.h5", ("two.yaml", "log.h5"), ("{}", "log.h5", "--as-is"), (), 1),
    Target("diagnose", "hammer.h5", ("two.yaml",), (), ("--seed",), 2),
    Target("diagnose", "two.yaml", ("hammer.h5",), ("hammer.h5", "--robot", "{}"), (), 1),
    Target("diagnose", "hammer.h5", ("two.yaml", "log.h5"), ("{}", "log.h5"), (), 1),
    Target("diagnose", "modes.yaml", ("two.yaml",), (), ("--seed",), 1),
    Target("diagnose", "log.h5", ("two.yaml",), (), ("--seed",), 1),
)  # fmt: skip


def make(folder: Path) -> None:
    """Write a valid file of every format, once."""
    if (folder / "blows.wav").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"two.yaml": ROBOT, "posture.yaml": POSTURE, "cut.yaml": CUT, "arm.urdf": URDF, "sheet.yaml": SHEET}
    for name, text in {**texts, "tool.yaml": TOOL, **PATHS}.items():
        (folder / name).write_text(text)
    time = np.arange(0, 12, 0.01)
    position = 0.5 * np.sin(2 * np.pi * np.outer(time, [0.2, 0.3]) + [0, 1])
    path = MotionLog({"path": MotionRun("path", time, position, 100.0)}, "two.yaml")
    write_motion_log(folder / "log.h5", path)
    found = twin.simulate(folder / "posture.yaml", out=folder / "made")
    (folder / "made" / "replay.h5").replace(folder / "log.h5")
    write_motion_log(folder / "log.csv", twin.read_log(folder / "log.h5"))
    (folder / "made" / "hammer.h5").replace(folder / "hammer.h5")
    twin.simulate(
        folder / "posture.yaml",
        hammer={"duration_s": 1, "hits": 2, "sample_rate_hz": 1024, "raw_hits": True},
        out=folder / "raw",
    )
    (folder / "raw" / "hammer.h5").replace(folder / "hits.h5")
    for name in ("log.h5", "hammer.h5", "hits.h5"):
        with h5py.File(folder / name, "r+") as file:
            file.attrs["robot"] = "two.yaml"
    numbers = list(zip(found.modes.frequency_hz, found.modes.damping_percent, strict=True))[:3]
    modes = ", ".join(f"{{frequency_hz: {f:.4f}, damping_percent: {d:.3f}}}" for f, d in numbers)
    (folder / "modes.yaml").write_text(f"robot: two.yaml\npostures:\n  bent: {{q_deg: [10, 40], modes: [{modes}]}}\n")
    write_uff(folder / "hammer.unv", twin.read_campaign(folder / "hammer.h5"))
    _foreign(folder)


def _foreign(folder: Path) -> None:
    """The same recordings as other programs write them, and the maps they are imported with."""
    run = next(iter(twin.read_log(folder / "log.h5").runs.values()))
    assert run.torque is not None
    for kind, text in {**{k: LOG_MAPS[k] for k in LOG_MAPS}, "wav": WAV_MAP, "unv": UNV_MAP}.items():
        (folder / f"{kind}-map.yaml").write_text(text)
    names = ["t", *(f"q{i}" for i in (1, 2)), *(f"tau{i}" for i in (1, 2))]
    columns = np.column_stack([run.time, run.position, run.torque])
    np.savetxt(folder / "foreign.csv", columns, "%.9g", ",", header=",".join(names), comments="")
    scipy.io.savemat(folder / "foreign.mat", {"t": run.time, "q": run.position, "tau": run.torque})
    with nptdms.TdmsWriter(folder / "foreign.tdms") as writer:
        for name, column in zip(names, columns.T, strict=True):
            writer.write_segment([nptdms.ChannelObject("log", name, np.ascontiguousarray(column))])
    with (folder / "foreign.mcap").open("wb") as stream:
        states = mcap_ros2.writer.Writer(stream)
        schema = states.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for t, q, torque in zip(run.time, run.position, run.torque, strict=True):
            ns = round(t * 1e9)
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}
            joints = {"name": ["a1", "a2"], "position": q.tolist(), "velocity": [], "effort": torque.tolist()}
            states.write_message("/joint_states", schema, {"header": header, **joints}, log_time=ns, publish_time=ns)
        states.finish()
    with h5py.File(folder / "hits.h5") as file:
        hits = next(iter(file["postures"].values()))["hits"]
        force, response = hits["force"][1], hits["response"][1]  # both along Z: along X nothing is heard
        rate = float(next(iter(file["postures"].values()))["hits"].attrs["sample_rate_hz"])
    record = np.column_stack([force.ravel(), response[:, 0].ravel()])
    scipy.io.wavfile.write(folder / "blows.wav", round(rate), (record / [1000, 10]).astype(np.float32))
