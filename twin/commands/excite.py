"""``twin excite``: robot in; excitation trajectories, as files a controller can run, and their figures out."""

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError, tell
from twin.files import writing
from twin.identify.excitation import Criterion, Excitation, Limits, room_in_workspace, used, violation
from twin.identify.excitation import excite as optimise
from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log
from twin.measure.recordings import traced
from twin.parallel import Progress, silent
from twin.provenance import provenance, write_json
from twin.ranges import MOST_SAMPLES, check_count
from twin.result import Result, written
from twin.robot.description import SHIPPED, Robot, load_robot
from twin.table import Table

LIMITED = ("position", "speed", "acceleration")  # of a joint
USED = "share of the joints' limits that is used; 100 % is at a limit, not beyond"

SPLINE_POINTS = 100  # of a KRL spline block, per period


@dataclass
class Excitations(Result):
    """What ``twin excite`` found; prints itself, and is the JSON of the command.

    Attributes:
        robot: description, removals applied.
        found: trajectories, best first.
        room: least distance from any limit per trajectory (rad, m and their rates), never negative.
        files: what was written.
    """

    robot: Robot
    found: list[Excitation]
    room: list[float]
    rest: bool
    criterion: Criterion
    periods: int = 1
    sample_rate_hz: float = 250.0
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.excite_figures"

    @property
    def trajectory(self) -> MotionLog:
        """The trajectories sampled, a run each: what ``twin.simulate`` replays."""
        runs = {
            name: trajectory_run(name, e, self.periods, self.sample_rate_hz)
            for name, e in ((f"excitation{k}", e) for k, e in enumerate(self.found, start=1))
        }
        return MotionLog(runs, self.robot.name, "trajectory")

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        return {
            "robot": self.robot.name,
            "condition_numbers": [e.condition for e in self.found],
            "log_determinants": [e.log_det for e in self.found],
            "least_room": self.room,
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """Condition number of every trajectory, and how near it comes to the limits."""
        header = ["trajectory", "condition number", *LIMITED]
        limits = Limits.of(self.robot)
        walls = bool(np.isfinite(limits.workspace).any())
        rows = []
        for k, e in enumerate(self.found, start=1):
            cells = [f"{share:.0%}" if share else "no limit" for share in used(e.fourier, limits)]
            if walls:
                cells.append(f"{1e3 * room_in_workspace(self.robot, e.fourier, limits):.1f} mm")
            rows.append((str(k), f"{e.condition:.2f}", *cells))
        walled = ["flange to wall"] * walls
        return [
            Table(
                (*header, *walled), rows, range(1, len(header) + walls), title=f"Position, speed, acceleration: {USED}"
            )
        ]

    def __str__(self) -> str:
        first = self.found[0].fourier
        what = "trajectory" if len(self.found) == 1 else "trajectories"
        (table,) = self.tables()
        wide = [max(map(len, column)) for column in zip(table.header, *table.rows, strict=True)]
        lines = [
            f"{self.robot.name} · {len(self.found)} {what} of {first.period_s:g} s, "
            f"{first.sine.shape[1]} harmonics of {first.base_hz:g} Hz"
            + (", at rest at both ends" if self.rest else ""),
            *(
                "  " + "   ".join(cell.rjust(width) for cell, width in zip(row, wide, strict=True))
                for row in (table.header, *table.rows)
            ),
            f"  position, speed, acceleration: {USED}",
        ]
        lines.append(f"  mean condition number {np.mean([e.condition for e in self.found]):.2f}")
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def excite(
    robot: Robot | str | Path | None = None,
    *,
    without: list[str] | None = None,
    count: int = 6,
    harmonics: int = 5,
    base_hz: float = 0.1,
    rest: bool = False,
    criterion: Criterion = "condition",
    periods: int = 1,
    sample_rate_hz: float = 250.0,
    krl: bool = False,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Excitations:
    """Optimised excitation trajectories of a robot, within its limits at all times.

    Args:
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; kr90 by default.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        count: how many.
        harmonics: of the Fourier series.
        base_hz: its fundamental, Hz.
        rest: start and end at rest.
        criterion: ``"condition"`` number or ``"d-optimal"``.
        periods: how often a period is repeated in the files.
        sample_rate_hz: of the files.
        krl: write KUKA spline programs too (A_i = −q_i in degrees); the trajectories then start and end at rest.
        out: folder for trajectory.h5, CSV, KRL, figures and JSON; ``None`` writes nothing.
        seed: of the random starts.
        progress: makes progress bars.

    Raises:
        InputError: bad input, or no trajectory within the limits.
    """
    check_out(out)
    for name in ("count", "harmonics", "base_hz", "periods", "sample_rate_hz"):
        check_count(name, locals()[name])
    if (samples := periods / base_hz * sample_rate_hz) > MOST_SAMPLES:
        raise InputError("--periods", str(periods), f"expected at most {MOST_SAMPLES} samples, found {samples:g}")
    rest = rest or krl  # a spline block starts and ends at a standstill
    loaded = load_robot(robot or "kr90").without(without or [])
    if krl and loaded.assumed:  # as twin describe leaves a robot, its signs are the file's
        tell(
            loaded.name,
            "--krl",
            "programs hold A = -q, as in the shipped robots; compare one posture first",
        )
    limits = Limits.of(loaded)
    starts = count + 1
    tick = (progress or silent)("trajectories", starts)
    found = optimise(
        loaded, count, harmonics=harmonics, base_hz=base_hz, rest=rest, criterion=criterion, seed=seed, starts=starts,
        progress=tick,
    )  # fmt: skip
    room = [-violation(loaded, e.fourier, limits) for e in found]
    result = Excitations(loaded, found, room, rest, criterion, periods, sample_rate_hz)
    options = {
        "robot": robot, "without": without or [], "count": count, "harmonics": harmonics, "base_hz": base_hz,
        "rest": rest, "criterion": criterion, "periods": periods, "sample_rate_hz": sample_rate_hz, "seed": seed,
    }  # fmt: skip
    result.origin = provenance(traced([], robot), options)
    if out is not None:
        with Outputs(out, "excite") as outputs:
            result.files = outputs.files
            _write(result, outputs, krl)
    return result


def trajectory_run(name: str, found: Excitation, periods: int, sample_rate_hz: float) -> MotionRun:
    """A trajectory as a run, ``periods`` times over, the last sample at the end of the last period."""
    samples = round(periods * found.fourier.period_s * sample_rate_hz) + 1
    motion = found.fourier.motion(np.arange(samples) / sample_rate_hz)
    return MotionRun(
        name, motion.time, motion.position, sample_rate_hz, velocity=motion.velocity, acceleration=motion.acceleration
    )


def krl_program(name: str, found: Excitation, periods: int) -> str:
    """A KUKA program: a point-to-point spline block through one period, timed part by part, run ``periods`` times.

    A_i = −q_i in degrees: KUKA's axes turn against the modified-DH ones. Axes not named keep where they are. A block
    starts and ends at a standstill, so the trajectory has to.
    """
    time = np.linspace(0, found.fourier.period_s, SPLINE_POINTS + 1)
    angles = -np.rad2deg(found.fourier.motion(time).position)

    def point(row: np.ndarray) -> str:
        return "{" + ", ".join(f"A{i + 1} {value:.5f}" for i, value in enumerate(row)) + "}"

    lines = [
        f"DEF {name}()",
        f"  ; A_i = -q_i, degrees; {SPLINE_POINTS} points in {found.fourier.period_s:g} s",
        "  INT K",
    ]
    lines += [f"  PTP {point(angles[0])}", f"  FOR K = 1 TO {periods}", "    PTP_SPLINE", "      TIME_BLOCK START"]
    for row in angles[1:]:
        lines += [f"      SPTP {point(row)}", "      TIME_BLOCK PART = 1"]
    lines += [f"      TIME_BLOCK END = {found.fourier.period_s:g}", "    ENDSPLINE", "  ENDFOR", "END", ""]
    return "\n".join(lines)


def _write(result: Excitations, name: Outputs, krl: bool) -> None:
    trajectory = result.trajectory
    for e, (stem, run) in zip(result.found, trajectory.runs.items(), strict=True):
        write_motion_log(name(f"{stem}.csv"), MotionLog({stem: run}))
        if krl:
            with writing(name(f"{stem}.src")) as stream:
                stream.write(krl_program(stem, e, result.periods))
    name.report(result)
    described, robot = result.robot.path, result.robot.name
    if described is not None and described.parent != SHIPPED:
        robot = os.path.relpath(described, name.out)
    write_motion_log(name("trajectory.h5"), replace(trajectory, robot=robot))
    write_json(name("excite.json"), result.data())
