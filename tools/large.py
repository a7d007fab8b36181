"""`python -m tools.large --out out/large`: peak memory and time of commands on large recordings of the six-axis KR90.

Two hours of six axes at 1 kHz, and a hammer test of 200 postures × 69 FRFs × 800 lines. The numbers in them are made
up; sizes are what is measured. A command that exceeds its memory limit, or ``--timeout``, is told as such.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np

from twin.measure.campaign import Campaign, Channels, PostureFRF, write_campaign

RATE_HZ, HOURS = 1000.0, 2.0
POSTURES, LINES, SENSORS, BLOWS = 200, 800, 3, 23
GIB = 1 << 30
JOBS = (  # command, recording, options, limit in GiB
    ("compare", "log.h5", ("--as-is",), 4),
    ("identify", "log.h5", (), 4),
    ("compare", "campaign.h5", ("--as-is",), 4),
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


def write_hammer(path: Path, postures: int) -> None:
    """Three modes everywhere, a little noise."""
    rng = np.random.default_rng(1)
    frequency = 0.25 * np.arange(8, 8 + LINES)
    found = {}
    for k in range(postures):
        frf = np.zeros((LINES, SENSORS, BLOWS), dtype=complex)
        for f in (10.0, 15.0, 40.0):
            line = -(frequency**2) / (f**2 - frequency**2 + 0.04j * f * frequency)
            frf += 1e-3 * line[:, None, None] * rng.normal(size=(1, SENSORS, 1)) * rng.normal(size=(1, 1, BLOWS))
        frf += 1e-5 * (rng.normal(size=frf.shape) + 1j * rng.normal(size=frf.shape))
        q = np.array([rng.uniform(-90, 90), rng.uniform(60, 120), rng.uniform(-120, -80), 0, rng.uniform(20, 60), 0])
        coherence = np.full(frf.shape, 0.98)
        found[f"p{k:03d}"] = PostureFRF(f"p{k:03d}", q, "off", frequency, frf, "accelerance", coherence, 5, 300.0, 0.0)
    labels = tuple(f"{n}Z+" for n in range(1, BLOWS + 1))
    place, up = rng.uniform(-0.2, 0.2, (BLOWS, 3)), np.tile([0.0, 0.0, 1.0], (BLOWS, 1))
    bodies = tuple(f"link{1 + n % 3}" for n in range(BLOWS))
    sensors = Channels(("1X+", "1Y+", "1Z+"), ("link1",) * 3, np.repeat(place[:1], 3, 0), np.eye(3))
    write_campaign(path, Campaign(sensors, Channels(labels, bodies, place, up), found, robot="kr90_six"))


def measure(command: str, path: Path, options: tuple[str, ...], limit: float, timeout: float) -> str:
    """One row: exit code, seconds, peak memory and the last line said."""

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (int(limit * GIB), int(limit * GIB)))

    line = [sys.executable, "-m", "twin", command, str(path), *options, "--json", "--timeout", str(timeout)]
    begin = time.monotonic()
    child = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=bounded)
    assert child.stderr is not None
    said = child.stderr.read().strip().splitlines()
    _, status, used = os.wait4(child.pid, 0)
    row = f"{command:9s} {path.name:12s} exit {os.waitstatus_to_exitcode(status):4d} {time.monotonic() - begin:7.1f} s"
    return f"{row}  {used.ru_maxrss / (1 << 20):5.2f} GiB of {limit:g}  {said[-1][:150] if said else ''}"


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
