"""`python -m tools.large --out out/large`: peak memory and time of commands on large recordings of the six-axis KR90.

Two hours of six axes at 1 kHz, of a pendulum's torques, and a hammer test of 200 postures × 69 FRFs × 800 lines, of a
KR90 on a base that tilts. A command that exceeds its memory limit, or ``--timeout``, is told as such.
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
from twin.identify.recorded import prepare
from twin.measure.campaign import Campaign, Channels, PostureFRF, write_campaign
from twin.model.parameters import free_parameters, independent
from twin.robot.description import Entry, Robot, load_robot

RATE_HZ, HOURS = 1000.0, 2.0
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
    """Multisines on every axis, and torque of a pendulum with friction; written in parts."""
    rng = np.random.default_rng(0)
    count, axes = round(hours * 3600 * RATE_HZ), 6
    phase, rate = rng.uniform(0, 6, (5, axes)), 2 * np.pi * 0.05 * np.arange(1, 6)[:, None]
    middle = np.deg2rad([0, 100, -100, 0, 30, 0])
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "motion-log", "version": 1, "robot": "kr90_six"})
        run = file.create_group("runs/long")
        run.attrs["sample_rate_hz"] = RATE_HZ
        run["time"] = np.arange(count) / RATE_HZ
        sets = {name: run.create_dataset(name, (count, axes), "f8") for name in ("position", "torque")}
        for first in range(0, count, 1 << 18):
            t = np.arange(first, min(first + (1 << 18), count)) / RATE_HZ
            angle = rate * t[:, None, None] + phase
            q, v, a = (0.06 * part.sum(1) for part in (np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)))
            sets["position"][first : first + len(t)] = middle + q
            torque = 300 * a + 2000 * np.sin(middle + q) + 200 * np.tanh(v / 0.01) + rng.normal(0, 20, q.shape)
            sets["torque"][first : first + len(t)] = torque
        sets["position"].attrs["unit"], sets["torque"].attrs["unit"] = "rad", "N·m"


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
