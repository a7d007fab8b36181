"""The error of a robot on motion logs without fitting it: torque beside inverse dynamics, by run and joint.

Both pass the same low-pass. A constant torque per run and joint belongs to the recording and is taken off, within
``OFFSET_TOLERANCE``; ``as_is`` leaves even that.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.identify.rigid import other_unit
from twin.measure.motion_log import NO_MOTION, MotionLog, MotionRun, moves, refuse_saturated
from twin.measure.signals import lowpass
from twin.model.regressor import Regressor
from twin.model.torque_rows import TOO_SHORT, Bands, Rows, in_joints, motion_of_run, rows_of
from twin.parallel import Progress
from twin.physics import CATALOGUE
from twin.physics.effect import Effect
from twin.robot.description import Robot

OFFSET_TOLERANCE = 0.1  # a recording's constant torque may be this share of a joint's RMS torque


@dataclass(frozen=True)
class LogComparison:
    """A motion log beside the robot's inverse dynamics (and its time stepping, where asked for).

    Attributes:
        robot: name.
        error: RMS over joints of residual RMS over torque RMS, all runs pooled.
        parts: per run and joint; ``stepped_error`` is that of MuJoCo's time stepping under servos.
        offsets: constant torque (n,) per run that was taken off, belonging to the recording.
        rows: what was compared.
        predicted: (m, n) per run, by inverse dynamics; ``stepped`` by time stepping, empty where not asked for.
        notes: repairs of the log.
    """

    robot: str
    error: float
    parts: list[dict[str, Any]]
    offsets: dict[str, np.ndarray]
    rows: list[Rows]
    predicted: list[np.ndarray]
    stepped: list[np.ndarray]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{self.robot}: error {self.error:.2%}", *(f"  note: {note}" for note in self.notes)]
        for run in dict.fromkeys(part["run"] for part in self.parts):
            of = [part for part in self.parts if part["run"] == run]
            lines.append(f"  {run:20s} " + "  ".join(f"{part['site']} {part['error']:.2%}" for part in of))
            if of[0]["stepped_error"] is not None:
                shown = "  ".join(f"{part['site']} {part['stepped_error']:.2%}" for part in of)
                lines.append(f"  {'  in time stepping':20s} {shown}")
        return "\n".join(lines)


def compare_log(
    log: MotionLog,
    robot: Robot,
    as_is: bool = False,
    bands: Bands | None = None,
    stepped: bool = False,
    progress: Progress | None = None,
) -> LogComparison:
    """Torque of a log against the robot's inverse dynamics, both after the same low-pass.

    Args:
        log: as recorded (motor coordinates).
        robot: description.
        as_is: leave each run's constant torque as it is; otherwise it is re-estimated, up to 10 % of the RMS torque.
        bands: low-passes.
        stepped: also replay in MuJoCo's time stepping.
        progress: makes progress bars.

    Raises:
        InputError: no torque; units or limits do not fit the robot.
    """
    bands = bands or Bands()
    joints = in_joints(log, robot)
    regressor = Regressor(robot)
    parts: list[dict[str, Any]] = []
    offsets, rows, predictions, replays, squares = {}, [], [], [], np.zeros((2, robot.axis_count))
    for name, run in joints.runs.items():
        if run.torque is None:
            raise InputError(log.source, f"runs/{name}/torque", "missing: a trajectory has nothing to compare")
        refuse_saturated(run, log.source)
        r = rows_of(regressor, run, bands)
        if not r.valid.any():
            raise InputError(log.source, f"runs/{name}", TOO_SHORT.format(run.time[-1] - run.time[0]))
        measured = r.torque + r.known
        predicted = r.matrix @ regressor.described + r.known
        replayed = _stepped(robot, run, bands, r, progress) if stepped else None
        rms = np.sqrt(np.mean(measured[r.valid] ** 2, axis=0))

        def judged(candidate: np.ndarray, r: Rows = r, measured: np.ndarray = measured, rms: np.ndarray = rms) -> Any:
            shift = np.mean((measured - candidate)[r.valid], axis=0)
            shift = np.zeros_like(rms) if as_is else np.clip(shift, -OFFSET_TOLERANCE * rms, OFFSET_TOLERANCE * rms)
            return shift, np.sum((measured - candidate - shift)[r.valid] ** 2, axis=0)

        offset, residual = judged(predicted)
        total = np.sum(measured[r.valid] ** 2, axis=0)
        stepping: Any = [None] * robot.axis_count
        if replayed is not None:
            shift, left = judged(replayed)
            stepping = np.sqrt(left / total)
            replays.append(replayed + shift)
        squares += [residual, total]
        for i, (error, step) in enumerate(zip(np.sqrt(residual / total), stepping, strict=True)):
            parts.append(
                {
                    "recording": log.source, "run": name, "site": f"joint{i + 1}", "error": float(error),
                    "rms": float(np.sqrt(residual[i] / r.valid.sum())), "torque_offset": float(offset[i]),
                    "stepped_error": None if step is None else float(step),
                }
            )  # fmt: skip
        offsets[name] = offset
        rows.append(r)
        predictions.append(predicted + offset)
    pooled = float(np.sqrt(np.mean(squares[0] / squares[1])))
    told = other_unit(regressor, rows)
    notes = log.notes if moves(log) else (*log.notes, f"{NO_MOTION}: only weight and friction at rest are compared")
    notes = (*notes, told) if told else notes
    return LogComparison(robot.name, pooled, parts, offsets, rows, predictions, replays, notes)


def _stepped(robot: Robot, run: MotionRun, bands: Bands, rows: Rows, progress: Progress | None) -> np.ndarray:
    """Low-passed torque of the twin's servos along a run in joint coordinates, at the rows' instants."""
    from twin.model.replay import replay

    tick: Callable[[int], None] | None = progress(f"replay {run.name}", len(run.time)) if progress else None
    recording = [e.effect for e in robot.physics if type(CATALOGUE[e.effect]).record is not Effect.record]
    ideal = robot.without(recording)  # which has been taken out of the record
    motion = motion_of_run(run, bands)  # the same as inverse dynamics is given
    smooth_run = replace(
        run, position=motion.position, velocity=motion.velocity, acceleration=motion.acceleration, torque=None
    )
    torque = replay(ideal, smooth_run, progress=tick).torque @ robot.coupling
    smooth = lowpass(torque, run.sample_rate_hz, *bands.within(run.sample_rate_hz).fit)
    return smooth[:: round(run.sample_rate_hz / rows.rate_hz)]
