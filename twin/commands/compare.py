"""``twin compare``: a robot beside recordings, error per part; each kind of recording is judged by its own module."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from twin.commands.identify import check_low_pass, in_joints
from twin.commands.modal import UFF, read_recording
from twin.commands.outputs import Outputs, check_out
from twin.diagnose.joint_reaction import blows
from twin.diagnose.struck import amplitude_entries, judge_struck
from twin.diagnose.triage import believed
from twin.errors import InputError
from twin.identify.elastic_compare import Comparison, compare_modes, comparison, judge
from twin.identify.rigid import TOO_SHORT, Bands, Rows, motion_of_run, rows_of
from twin.measure.campaign import Campaign
from twin.measure.hdf5 import Node
from twin.measure.modal_table import read_modal_table
from twin.measure.motion_log import MotionLog, MotionRun, read_motion_log
from twin.measure.signals import advance, lowpass
from twin.model.regressor import Regressor
from twin.parallel import Progress
from twin.provenance import provenance, write_json
from twin.robot.description import Robot, load_robot

TABLES = (".yaml", ".yml")
OFFSET_TOLERANCE = 0.1  # a recording's constant torque may be this share of a joint's RMS torque


@dataclass
class Compared:
    """What ``twin compare`` found; prints itself, and is the JSON of the command.

    ``errors`` holds one number per recording: recordings of different kinds are never mixed.
    """

    robot: str
    errors: dict[str, float]
    parts: list[dict[str, Any]]
    texts: list[str]
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """The JSON of the command; ``error`` is a number for one recording, else recording → number."""
        single = next(iter(self.errors.values())) if len(self.errors) == 1 else None
        return {
            "robot": self.robot,
            "error": single if single is not None else self.errors,
            "parts": self.parts,
            "files": self.files,
            "provenance": self.origin,
        }

    def __str__(self) -> str:
        return "\n".join(self.texts + (["  wrote " + ", ".join(self.files)] if self.files else []))


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


def compare(
    recordings: list[Path],
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    out: Path | None = None,
    as_is: bool = False,
    low_pass: tuple[float, float] = (3.0, 4.0),
    stepped: bool = False,
    progress: Progress | None = None,
) -> Compared:
    """Errors of a robot on recordings, after re-estimating only what belongs to a recording itself.

    Args:
        recordings: motion logs, hammer tests and modal tables.
        robot: shipped name, ``robot.yaml`` or URDF; wins over the recordings'.
        without: entries to remove.
        out: folder for compare.json and figures; ``None`` writes nothing.
        as_is: re-estimate nothing.
        low_pass: pass and stop frequency for torque, Hz.
        stepped: also replay motion logs in MuJoCo's time stepping under servo drives.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    check_low_pass(low_pass)
    progress = progress or (lambda description, total: lambda step: None)
    errors: dict[str, float] = {}
    parts: list[dict[str, Any]] = []
    texts, logs, tests, name = [], [], [], robot or ""
    for path in recordings:
        kind, named = recording_kind(path)
        loaded = load_robot(robot) if robot else load_robot(named or "kr90", Path(path).parent)
        loaded = loaded.without(without or [])
        name = loaded.name
        if kind == "motion-log":
            log = read_motion_log(path)
            found: Any = compare_log(log, loaded, as_is, Bands(fit=low_pass), stepped, progress)
            logs.append((path, loaded, found))
        elif kind == "modal-table":
            found = compare_modes(loaded, read_modal_table(path), str(path))
        else:
            found = compare_hammer(loaded, read_recording([path]), str(path), as_is)
            tests.append((path, found))
        errors[str(path)] = found.error
        parts += list(found.parts)
        texts.append(f"{path} · {found}")
    result = Compared(name, errors, parts, texts)
    options = {"robot": robot, "without": without or [], "as_is": as_is, "low_pass": list(low_pass)}
    result.origin = provenance(recordings, options)
    if out is not None:
        with Outputs(out) as outputs:
            result.files = outputs.files
            for path, loaded, found in logs:
                _draw_log(found, loaded, outputs, Path(path).stem)
            for path, found in tests:
                _draw_frfs(found, outputs, Path(path).stem)
            write_json(outputs("compare.json"), result.data())
    return result


def compare_hammer(robot: Robot, campaign: Campaign, source: str, as_is: bool = False) -> Comparison:
    """Compare a robot with a hammer test as a diagnosis does: channels without coherence left out; linearised, or the
    blows stepped in time where the robot has one law of amplitude and the recording says how hard they were."""
    recordings = list(believed(campaign, robot, source)[0].values())
    laws, how = amplitude_entries(robot), blows(campaign)
    struck = judge_struck(robot, recordings, how, as_is=as_is) if len(laws) == 1 and how else None
    return comparison(robot, struck or judge(robot, recordings, as_is=as_is), source)


def recording_kind(path: str | Path) -> tuple[str, str | None]:
    """``"motion-log"``, ``"frf-campaign"`` or ``"modal-table"``, and the robot a recording names.

    Raises:
        InputError: no such file, or another kind.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return "motion-log", None
    if suffix in UFF:
        return "frf-campaign", None
    if suffix in TABLES:
        return "modal-table", read_modal_table(path).robot
    try:
        with h5py.File(path) as file:
            root = Node(path, file)
            kind, robot = root.text("format"), root.text("robot")
    except OSError as error:
        raise InputError(
            path, "", "expected a hammer test (HDF5, UFF), a modal table (YAML) or a motion log (HDF5, CSV)"
        ) from error
    if kind not in ("motion-log", "frf-campaign"):
        raise InputError(path, "format", f"expected 'motion-log' or 'frf-campaign', found {kind!r}")
    return kind, robot


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
    return LogComparison(robot.name, pooled, parts, offsets, rows, predictions, replays, log.notes)


def _stepped(robot: Robot, run: MotionRun, bands: Bands, rows: Rows, progress: Progress | None) -> np.ndarray:
    """Low-passed torque of the twin's servos along a run in joint coordinates, at the rows' instants."""
    from twin.model.replay import replay

    tick: Callable[[int], None] | None = progress(f"replay {run.name}", len(run.time)) if progress else None
    ideal = robot.without(["torque_constant", "time_delay"])  # which have been taken out of the record
    motion = motion_of_run(run, bands)  # the same as inverse dynamics is given
    smooth_run = replace(
        run, position=motion.position, velocity=motion.velocity, acceleration=motion.acceleration, torque=None
    )
    torque = replay(ideal, smooth_run, progress=tick).torque
    torque = advance(torque, run.sample_rate_hz, 0.5 / run.sample_rate_hz)  # a mean over the sample before is late
    smooth = lowpass(torque, run.sample_rate_hz, *bands.within(run.sample_rate_hz).fit)
    return smooth[:: round(run.sample_rate_hz / rows.rate_hz)]


def _draw_log(found: LogComparison, robot: Robot, name: Outputs, stem: str) -> None:
    from twin.report.figures import save
    from twin.report.motion_figures import prediction

    curves = {"inverse dynamics": found.predicted} | ({"time stepping": found.stepped} if found.stepped else {})
    title = f"{stem}, torque after the low-pass"
    save(prediction(robot, found.rows, curves, title), name(f"{stem}-torque.png"))


def _draw_frfs(found: Comparison, name: Outputs, stem: str) -> None:
    from twin.report import fit_figures
    from twin.report.figures import save
    from twin.report.fit_report import overlay

    save(fit_figures.errors({stem: found}), name(f"{stem}-errors.png"))
    for r, H in zip(found.judged.recordings, found.judged.predicted, strict=True):
        save(overlay(r, H, "measured"), name(f"{stem}-frf-{r.group}.png"))
