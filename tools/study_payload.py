"""`python -m tools.study_payload --draws 10`: is a payload found in one run of some ten seconds, and how exactly?

A payload of random mass (0.5 to 5 % of the links) and centre of mass is added: to the torque that was recorded of a
real arm (TX40, six axes, from its URDF through ``twin describe``; KR300, six axes, 10 Hz), or to the robot of the
truth code (six and seven axes, numbers within the tolerances of their description). ``twin diagnose`` is asked each
time.

Printed: how many were found, of all and of those heavier than the ``smallest_visible`` of the same report, how many
90 % intervals hold the mass, and CPU seconds; ``TWIN_RECORDINGS`` is the folder of real recordings. ``--from 50`` goes
on after 50 draws.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.interpolate import CubicSpline

import twin
from tools import public_logs
from tools.public_logs import DESCRIBED, RECORDINGS, need
from tools.truth.effects import Effect
from tools.truth.motion import Log, Run, draw_fourier, record
from tools.truth.recording import draw_truth
from tools.truth.robots import machines, write_description
from twin.diagnose.verdict import Candidate
from twin.measure.motion_log import MotionLog, MotionRun
from twin.model.regressor import Regressor, weight_vector
from twin.model.torque_rows import Bands, motion_of_run
from twin.robot.description import Robot, load_robot

SHARES = (0.005, 0.05)  # of the links' mass
SECONDS = 10.0


@dataclass(frozen=True)
class Load:
    """What was added at the flange: kg, and metres in the frame of the last link."""

    mass: float
    com: tuple[float, float, float]


def drawn(robot: Robot, rng: np.random.Generator) -> Load:
    """A body on the flange, up to a tenth of a reach of one metre further out."""
    mass = sum(link.inertial[0] for link in robot.links) * np.exp(rng.uniform(*np.log(SHARES)))
    reach = sum(np.hypot(axis.a, axis.d) for axis in robot.axes)
    x, y, z = np.array(robot.flange.position) + reach * np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.0, 0.1)])
    return Load(float(mass), (float(x), float(y), float(z)))


def with_load(robot: Robot, run: MotionRun, load: Load, stop_hz: float = 20.0) -> MotionRun:
    """A run with the torque of a load added; its accelerations are those below ``stop_hz``."""
    assert run.torque is not None
    stop = min(stop_hz, 0.3 * run.sample_rate_hz)
    motion = motion_of_run(run, Bands((0.8 * stop, stop), (1.2 * stop, 1.5 * stop)), 1)
    every = max(1, int(run.sample_rate_hz / (10 * stop)))
    at = slice(None, None, every)
    few = replace(
        motion, time=motion.time[at], position=motion.position[at], velocity=motion.velocity[at],
        acceleration=motion.acceleration[at],
    )  # fmt: skip
    link, vector = weight_vector("flange", {"mass": load.mass, "com": list(load.com)}, robot.axis_count)
    torque = Regressor(robot).bodies(few)[:, :, 10 * link : 10 * link + 10] @ vector
    return replace(run, torque=run.torque + CubicSpline(few.time, torque)(np.clip(run.time, few.time[0], few.time[-1])))


def tx40(room: Path, _: np.random.Generator) -> tuple[Robot, MotionLog]:
    """The whole record, and the arm from its URDF alone."""
    room.mkdir(exist_ok=True)
    if not (room / "robot.yaml").exists():
        twin.save_robot(room / "robot.yaml", twin.describe(RECORDINGS / "tx40" / "tx40.urdf").robot)
    return load_robot(room / "robot.yaml"), public_logs.tx40()


def kr300(room: Path, rng: np.random.Generator) -> tuple[Robot, MotionLog]:
    """The arm as the description of the tests has it; a stretch of a minute, as it moves slowly."""
    train = public_logs.kr300().runs["train"]
    assert train.torque is not None
    first, count = int(rng.integers(0, 3000)), 600
    q, torque = (x[first : first + count] for x in (train.position, train.torque))
    run = MotionRun("run", np.arange(count) / 10, q, 10.0, torque=torque)
    return load_robot(DESCRIBED / "kr300.yaml"), MotionLog({"run": run})


def simulated(name: str, room: Path, rng: np.random.Generator, load: Load | None) -> tuple[Robot, MotionLog]:
    """One run of a robot of the truth code that carries the load."""
    machine, path = machines()[name], room / f"{name}.yaml"
    if not path.exists():
        write_description(machine, path)
    effects = (Effect("payload", "flange", {"mass": load.mass, "com": list(load.com)}),) if load else ()
    truth = draw_truth(int(rng.integers(1 << 31)), (), (), machine.tolerances, chain=machine.chain, log=True)
    truth = replace(truth, effects=effects)
    how = Log(white=10 * machine.torque, coloured=5 * machine.torque, friction=str(rng.choice(["coulomb", "lugre"])))
    clock = np.arange(int(SECONDS * how.rate_hz)) / how.rate_hz
    found = record(truth, Run("run", draw_fourier(machine.chain, rng, SECONDS), clock, 0.0), how, rng)
    run = MotionRun("run", clock, found.position, how.rate_hz, torque=found.torque)
    return load_robot(path), MotionLog({"run": run})


def cases(name: str, room: Path, draws: range, seed: int) -> Iterator[tuple[Robot, MotionLog, Load]]:
    for number in draws:
        rng = np.random.default_rng([seed, number])
        if name in ("tx40", "kr300"):
            robot, log = {"tx40": tx40, "kr300": kr300}[name](room / name, rng)
            load = drawn(robot, rng)
            yield robot, MotionLog({k: with_load(robot, run, load) for k, run in log.runs.items()}), load
        else:
            load = drawn(simulated(name, room, np.random.default_rng(0), None)[0], rng)
            yield (*simulated(name, room, rng, load), load)


def main() -> None:
    parser = argparse.ArgumentParser(prog="tools.study_payload", description=__doc__)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--of", nargs="+", default=["tx40", "six", "seven"], choices=["tx40", "kr300", "six", "seven"])
    asked = parser.parse_args()
    if asked.draws < 1:
        parser.error(f"--draws: expected 1 or more, found {asked.draws}")
    need(*(name for name in asked.of if name in ("tx40", "kr300")))
    with TemporaryDirectory() as scratch:
        for name in asked.of:
            rows = []
            draws = range(asked.first, asked.first + asked.draws)
            for robot, log, load in cases(name, Path(scratch), draws, asked.seed):
                begin = time.process_time()
                verdict = twin.diagnose(log, robot=robot)
                seconds = time.process_time() - begin
                answers = [m.first for m in verdict.missing]
                found = next((one for one in answers if one.effect == "payload"), None)
                rows.append((load.mass, found, visible(verdict), seconds))
                print(line(name, load, found, verdict, seconds), flush=True)
            inside = [holds(found, mass) for mass, found, *_ in rows if found]
            heavy = [found is not None for mass, found, least, _ in rows if mass > least]
            seconds = [row[-1] for row in rows]
            print(
                f"{name}: found {len(inside)} of {len(rows)}, {sum(heavy)} of {len(heavy)} of those heavier than the "
                f"smallest visible; the interval holds {sum(inside)} of {len(inside)}; "
                f"CPU {np.median(seconds):.0f} s in the median, {max(seconds):.0f} s at most"
            )


def visible(verdict: "twin.Verdict") -> float:
    """Smallest mass (kg) at the flange that the report says can be seen; 0 where it says none, as one is found."""
    some = verdict.data()["smallest_visible"]
    return next((row["value"] for row in some if row["effect"] == "payload" and row["site"] == "flange"), 0.0)


def holds(found: Candidate, mass: float) -> bool:
    """Whether the 90 % interval of a payload holds its mass."""
    low, high = found.parameters["mass"]["interval90"]
    return bool(low <= mass <= high)


def line(name: str, load: Load, found: Candidate | None, verdict: "twin.Verdict", seconds: float) -> str:
    said = ", ".join(m.first.key for m in verdict.missing) or "nothing"
    error = verdict.error["after"]["held_out"]
    if found is None:
        return (
            f"{name} {load.mass:.3f} kg: not found, visible from {visible(verdict):.3f} kg ({verdict.word}: {said}; "
            f"held out {error:.1%}) {seconds:.0f} s"
        )
    mass = found.parameters["mass"]
    low, high = mass["interval90"]
    inside = "holds" if holds(found, load.mass) else "misses"
    return (
        f"{name} {load.mass:.3f} kg: {mass['value']:.3f} [{low:.3f}, {high:.3f}] {inside} ({verdict.word}: {said}; "
        f"held out {error:.1%}) {seconds:.0f} s"
    )


if __name__ == "__main__":
    main()
