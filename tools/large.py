"""`python -m tools.large --out out/large`: peak memory and time of commands on large recordings of the six-axis KR90.

Two hours of six axes at 1 kHz, of a KR90 with one-sided friction, and a hammer test of 200 postures × 69 FRFs × 800
lines, of a KR90 on a base that tilts. A command that exceeds its memory limit, or ``--timeout``, is told as such.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from twin.identify.objective import Objective, Sample
from twin.measure.campaign import Campaign, Channels, PostureFRF, write_campaign
from twin.model.parameters import free_parameters, independent
from twin.model.recorded import prepare
from twin.model.replay import inverse_dynamics, recorded_torque
from twin.physics.motion import Motion
from twin.robot.description import Entry, Robot, load_robot

RATE_HZ, HOURS = 1000.0, 2.0
PERIOD_S, HARMONICS = 20.0, 5
MIDDLE_DEG, SWING = (0, 80, -60, 0, 30, 0), 0.18  # rad of each harmonic
ENCODER, TORQUE_NOISE = 1e-6, 0.01  # rad; of the RMS of an axis
ONE_SIDED = {"effect": "asymmetric_friction", "site": "joint2", "torque_difference": 80.0, "viscous_difference": 60.0}
POSTURES, LINES, SENSORS, BLOWS = 200, 800, 3, 23
NOISE = 3e-3  # of the RMS of an FRF
SPRINGS = 0.3  # prior deviations that springs and dampers are off
TILT = {"effect": "base_compliance", "site": "base.ry", "stiffness": 3e7, "damping": 1e4}
GIB = 1 << 30
JOBS = (  # command, recording, options, limit in GiB
    ("compare", "log.h5", ("--as-is",), 4),
    ("identify", "log.h5", (), 4),
    ("compare", "campaign.h5", ("--as-is",), 4),
    ("compare", "campaign.h5", (), 4),
    ("fit", "campaign.h5", ("--starts", "1"), 4),
    ("diagnose", "campaign.h5", (), 8),
    ("diagnose", "log.h5", (), 8),
)


def write_log(path: Path, hours: float) -> None:
    """Multisines on every axis, and torque of a KR90 whose friction differs by direction; one period over and over."""
    rng = np.random.default_rng(0)
    count, period = round(hours * 3600 * RATE_HZ), round(PERIOD_S * RATE_HZ)
    described = load_robot("kr90_six")
    robot = described.model_copy(update={"physics": [*described.physics, Entry.model_validate(ONE_SIDED)]})
    turns = 2 * np.pi / PERIOD_S * np.arange(1, HARMONICS + 1)[:, None]
    time = np.arange(period) / RATE_HZ
    angle = turns * time[:, None, None] + rng.uniform(0, 2 * np.pi, (HARMONICS, robot.axis_count))
    position = np.deg2rad(MIDDLE_DEG) + SWING * np.sin(angle).sum(1)
    velocity, acceleration = (turns * np.cos(angle)).sum(1), -(turns**2 * np.sin(angle)).sum(1)
    torque = inverse_dynamics(robot, Motion(time, position, SWING * velocity, SWING * acceleration))
    torque = recorded_torque(robot, time, torque)
    exact = {"position": position @ robot.coupling.T, "torque": torque}
    noise = {"position": ENCODER, "torque": TORQUE_NOISE * np.sqrt(np.mean(torque**2, axis=0))}
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "motion-log", "version": 1, "robot": "kr90_six"})
        run = file.create_group("runs/long")
        run.attrs["sample_rate_hz"] = RATE_HZ
        run["time"] = np.arange(count) / RATE_HZ
        for name, unit in (("position", "rad"), ("torque", "N·m")):
            data = run.create_dataset(name, (count, robot.axis_count), "f8")
            data.attrs["unit"] = unit
            for first in range(0, count, period):
                some = exact[name][: count - first]
                data[first : first + period] = some + noise[name] * rng.normal(size=some.shape)


def tilting() -> Robot:
    """The KR90 on a base that tilts, its springs a little off."""
    described = load_robot("kr90_six")
    free = free_parameters(described, tolerances=False)
    robot = free.apply(described, free.values(np.random.default_rng(1).normal(0, SPRINGS, len(free))))
    return robot.model_copy(update={"physics": [*robot.physics, Entry.model_validate(TILT)]})


def hammer_test(postures: int, lines: int = LINES, blows: int = BLOWS) -> Campaign:
    """FRFs of that robot with 0.3 % of noise."""
    rng, robot = np.random.default_rng(2), tilting()
    labels = tuple(f"{n}Z+" for n in range(1, blows + 1))
    place, up = rng.uniform(-0.2, 0.2, (blows, 3)), np.tile([0.0, 0.0, 1.0], (blows, 1))
    bodies = tuple(f"link{1 + n % 3}" for n in range(blows))
    sensors = Channels(("1X+", "1Y+", "1Z+"), ("link1",) * 3, np.repeat(place[:1], 3, 0), np.eye(3))
    struck, frequency = Channels(labels, bodies, place, up), 200 / lines * np.arange(8, 8 + lines)
    empty, found = np.zeros((lines, SENSORS, blows), complex), {}
    for k in range(postures):
        q = np.array([rng.uniform(-90, 90), rng.uniform(60, 120), rng.uniform(-120, -80), 0, rng.uniform(20, 60), 0])
        name = f"p{k:03d}"
        posture = PostureFRF(name, q, "off", frequency, empty, "accelerance", None, 5, 300.0, 0.0)
        one = tuple(prepare(Campaign(sensors, struck, {name: posture}), robot).values())
        (exact,) = Objective(robot, independent([]), Sample(one)).predicted(np.zeros(0))
        noise = NOISE * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0))
        frf = exact + noise * (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)) / np.sqrt(2)
        coherence = 1 / (1 + 5 * noise**2 / np.abs(exact) ** 2)
        found[name] = replace(posture, frf=frf, coherence=coherence)
    return Campaign(sensors, struck, found, robot="kr90_six")


def write_hammer(path: Path, postures: int) -> None:
    """A hammer test of the full size."""
    write_campaign(path, hammer_test(postures))


def held(session: int) -> int:
    """Bytes that the processes of a session hold together: what they share is counted once."""
    total = 0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(folder.name)) == session:
                line = next(line for line in (folder / "smaps_rollup").read_text().splitlines() if line[:4] == "Pss:")
                total += 1024 * int(line.split()[1])
        except (OSError, StopIteration):  # ended meanwhile
            continue
    return total


def measure(command: str, path: Path, options: tuple[str, ...], limit: float, timeout: float) -> str:
    """One row: exit code, seconds, peak memory of all its processes together and what was said."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    before = used.ru_utime + used.ru_stime

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (int(limit * GIB), int(limit * GIB)))

    line = [sys.executable, "-m", "twin", command, str(path), *options, "--json", "--timeout", str(timeout)]
    begin, peak = time.monotonic(), 0
    with tempfile.TemporaryFile("w+") as errors:
        child = subprocess.Popen(
            line, stdout=subprocess.DEVNULL, stderr=errors, preexec_fn=bounded, start_new_session=True
        )
        while child.poll() is None:
            peak = max(peak, held(child.pid))
            time.sleep(0.2)
        errors.seek(0)
        said = errors.read().strip().splitlines()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    row = f"{command:9s} {path.name:12s} exit {child.returncode:4d} {time.monotonic() - begin:7.1f} s"
    cpu = used.ru_utime + used.ru_stime - before
    return f"{row} ({cpu:.0f} s CPU)  {peak / GIB:5.2f} GiB of {limit:g}  {' | '.join(one[:150] for one in said)}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="tools.large", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/large"))
    parser.add_argument("--timeout", type=float, default=3600.0)
    parser.add_argument("--hours", type=float, default=HOURS)
    parser.add_argument("--postures", type=int, default=POSTURES)
    parser.add_argument("--jobs", type=int, nargs="*", default=range(len(JOBS)))
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for name, write, size in (("log.h5", write_log, asked.hours), ("campaign.h5", write_hammer, asked.postures)):
        if not (asked.out / name).exists():
            write(asked.out / name, size)
    for number in asked.jobs:
        command, name, options, limit = JOBS[number]
        print(measure(command, asked.out / name, options, limit, asked.timeout), flush=True)


if __name__ == "__main__":
    main()
