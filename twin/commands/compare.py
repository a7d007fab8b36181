"""``twin compare``: a robot beside recordings, error per part; each kind of recording is judged by its own room."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.commands.outputs import Outputs, check_out
from twin.diagnose.compare import compare_hammer
from twin.diagnose.torque_faults import told_sound
from twin.errors import tell
from twin.identify.elastic_compare import Comparison, ModalComparison, compare_modes
from twin.identify.rigid_compare import LogComparison, compare_log
from twin.measure.recordings import Given, Recording, read_recordings, traced
from twin.model.parameters import require_springs
from twin.model.torque_rows import Bands
from twin.parallel import Progress
from twin.provenance import provenance, write_json
from twin.result import Result, written
from twin.robot.description import Robot
from twin.table import Table


@dataclass
class Compared(Result):
    """What ``twin compare`` found; prints itself, and is the JSON of the command.

    Attributes:
        robots: recording → the robot it was compared with.
        found: recording → the comparison, by posture or run, channel or joint, and band.
        files: what was written.
    """

    robots: dict[str, Robot]
    found: dict[str, Comparison | ModalComparison | LogComparison]
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.compare_figures"

    @property
    def errors(self) -> dict[str, float]:
        """Recording → RMS of residual over RMS of data; recordings of different kinds are never mixed."""
        return {source: found.error for source, found in self.found.items()}

    @property
    def parts(self) -> list[dict[str, Any]]:
        """Errors by posture or run, channel or joint, and band."""
        return [part for found in self.found.values() for part in found.parts]

    def data(self) -> dict[str, Any]:
        """The JSON of the command; ``error`` is a number for one recording, else recording → number."""
        errors = self.errors
        return {
            "robot": list(self.robots.values())[-1].name,
            "error": next(iter(errors.values())) if len(errors) == 1 else errors,
            "parts": self.parts,
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """Error per recording and posture or run."""
        rows, files = [], [Path(source).name for source in self.found]
        names = dict(zip(self.found, files if len(set(files)) == len(files) else self.found, strict=True))
        for source, found in self.found.items():
            rows.append((names[source], "all", "", f"{found.error:.2%}"))
            rows += [
                ("", str(part.get("posture") or part.get("run")), part.get("site") or "", f"{part['error']:.2%}")
                for part in found.parts
                if not (part.get("channel") or part.get("band_hz") or part.get("measured_hz"))
            ]
        modes = [_modes(found) for found in self.found.values() if isinstance(found, ModalComparison)]
        if not any(joint for *_, joint, _ in rows):
            rows_ = [(a, b, error) for a, b, _, error in rows]
            return [Table(("recording", "posture or run", "error"), rows_, (2,)), *modes]
        return [Table(("recording", "posture or run", "joint", "error"), rows, (3,)), *modes]

    def __str__(self) -> str:
        texts = [f"{source} · {found}" for source, found in self.found.items()]
        return "\n".join(texts + ([f"  {written(self.files)}"] if self.files else []))


def _modes(found: ModalComparison) -> Table:
    """Every measured mode beside the model's."""
    rows = []
    for mode in found.modes:
        model = (
            ("no mode", "") if mode.frequency_hz is None else (f"{mode.frequency_hz:.2f} Hz", _percent(mode.damping))
        )
        away = "" if mode.frequency_hz is None else f"{mode.frequency_hz / mode.measured_hz - 1:+.1%}"
        mac = "" if mode.mac is None else f"{mode.mac:.0%}"
        rows.append(
            (mode.posture, f"{mode.measured_hz:.2f} Hz", model[0], away, _percent(mode.measured_damping), model[1], mac)
        )
    header = ["posture", "measured", "model", "difference", "measured ζ", "model ζ", "MAC"]
    shown = len(header) - (not any(row[-1] for row in rows))
    return Table(header[:shown], [row[:shown] for row in rows], range(1, shown), title="Modes, measured and modelled")


def _percent(share: float | None) -> str:
    return "" if share is None or share != share else f"{share:.2%}"


def compare(
    recordings: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    as_is: bool = False,
    low_pass: tuple[float, float] = (3.0, 4.0),
    stepped: bool = False,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Compared:
    """Errors of a robot on recordings, after re-estimating only what belongs to a recording itself.

    Args:
        recordings: one or several of :class:`Campaign`, :class:`MotionLog`, :class:`ModalTable` or their files.
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the recordings'.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        as_is: re-estimate nothing, and put no channel right.
        low_pass: pass and stop frequency for torque, Hz.
        stepped: also replay motion logs in MuJoCo's time stepping under servo drives.
        out: folder for compare.json and figures; ``None`` writes nothing.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    bands = Bands(fit=low_pass)
    given = read_recordings(recordings)
    if bands.fit != Bands().fit and all(recording.kind != "motion-log" for recording in given):
        tell("--low-pass", "", "concerns motion logs, and none is given: not used")
    result = Compared({}, {})
    for recording in given:
        described = recording.described(robot, without)
        result.robots[recording.source] = described
        result.found[recording.source] = _compared(recording, described, as_is, bands, stepped, progress)
    options = {"robot": robot, "without": without or [], "as_is": as_is, "low_pass": list(low_pass)}
    result.origin = provenance(traced(given, robot), options)
    if out is not None:
        with Outputs(out, "compare") as name:
            name.report(result)
            path = name("compare.json")
            result.files = name.files
            write_json(path, result.data())
    return result


def _compared(
    recording: Recording, robot: Robot, as_is: bool, bands: Bands, stepped: bool, progress: Progress | None
) -> Comparison | ModalComparison | LogComparison:
    if recording.kind == "motion-log":
        log = recording.content if as_is else told_sound(recording.content, robot)
        return compare_log(log, robot, as_is, bands, stepped, progress)
    require_springs(robot)
    if recording.kind == "modal-table":
        return compare_modes(robot, recording.content, recording.source)
    return compare_hammer(robot, recording.content, recording.source, as_is)
