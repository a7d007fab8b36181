"""``twin modal``: measured FRFs in; modes with deviations, tables, figures and shapes on robot or structure out."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError
from twin.measure.campaign import Campaign
from twin.measure.modal import Method, ModalResult, identify_modes, modal_report
from twin.measure.modal_table import ModalTable
from twin.measure.motion_log import MotionLog
from twin.measure.recordings import Given, Recording, read_one, traced
from twin.measure.spectra import Check, HitTable, driving_points, linearity, reciprocity
from twin.measure.wireframe import Wireframe, wireframe
from twin.model.expansion import on_robot
from twin.model.modes import Modes
from twin.parallel import Progress, silent
from twin.provenance import provenance, write_json
from twin.ranges import RANGES, check_count
from twin.result import Result, listed, written
from twin.robot.description import Robot
from twin.robot.mechanism import Mechanism
from twin.table import Table

if TYPE_CHECKING:
    from twin.measure.operational import Running


@dataclass
class ModalAnalysis(Result):
    """What ``twin modal`` found; prints itself, and is the JSON of the command.

    Attributes:
        campaign: the recording.
        results: posture → modes.
        checks: what a test engineer asks of the FRFs.
        hits: posture → which blows counted, where the recording holds time records alone.
        on_robot: posture → the robot there, and the measured shapes on it.
        frames: posture → the measured points and shapes, of what is not drawn on a robot.
        notes: what could not be done, and why.
        files: what was written.
    """

    campaign: Campaign
    results: dict[str, ModalResult]
    checks: dict[str, list[Check]] = field(default_factory=dict)
    hits: dict[str, HitTable] = field(default_factory=dict)
    on_robot: dict[str, tuple[Mechanism, Modes]] = field(default_factory=dict)
    frames: dict[str, Wireframe] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.modal_figures"

    @property
    def table(self) -> ModalTable:
        """The modes as a modal table, which ``twin.fit``, ``twin.compare`` and ``twin.diagnose`` take."""
        roving = {result.roving for result in self.results.values()}
        side = "response" if "response" in roving else "excitation"
        return ModalTable.of(self.results, self.campaign.robot, getattr(self.campaign, side))

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        checks = [
            {"posture": name, "kind": c.kind, "subject": c.subject, "value": c.value, "passed": c.passed}
            for name, found in self.checks.items()
            for c in found
        ]
        return {
            **modal_report(self.results),
            "checks": checks,
            "notes": self.notes,
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """Modes of every posture."""
        return [
            Table(
                ("mode", "frequency", "± σ", "damping", "± σ"),
                [
                    (
                        str(k + 1), f"{mode.frequency_hz:.2f} Hz", f"{mode.frequency_std_hz:.2g} Hz",
                        f"{mode.damping_percent:.2f} %", f"{mode.damping_std_percent:.2g} %",
                    )
                    for k, mode in enumerate(result.modes)
                ],
                (1, 2, 3, 4),
                title=name,
            )
            for name, result in self.results.items()
        ]  # fmt: skip

    def __str__(self) -> str:
        lines = []
        for name, result in self.results.items():
            if name in self.hits:
                lines.append(str(self.hits[name]))
            lines.append(str(result))
            lines += [f"  {check}" for check in self.checks.get(name, []) if not check.passed]
        lines += self.notes
        if self.files:
            lines.append(written(self.files))
        return "\n".join(lines)


def modal(
    recording: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    fmin: float | None = None,
    fmax: float | None = None,
    max_order: int = 60,
    method: Method = "plscf",
    operational: bool = False,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> ModalAnalysis:
    """Identify the modes of every posture of a hammer test, or of a structure that runs.

    Args:
        recording: a :class:`Campaign`, its file, or several hammer tests of the same points.
        robot: the robot shapes are drawn on; by default the recording's, else kr90 where the recording has axis
            positions. What is no robot is drawn as a wire frame.
        without: entries removed from it, ``EFFECT`` or ``EFFECT@SITE``.
        fmin: lowest frequency of the band, Hz; by default the band is all that is usable.
        fmax: highest, Hz.
        max_order: highest order of the stabilisation chart.
        method: ``plscf`` or ``lsce``.
        operational: the recording holds responses alone, see :func:`twin.measure.operational.read_running`; needs
            the extra ``twin[operational]``.
        out: folder for tables, figures and animations; ``None`` writes nothing.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    given, running = _read_running(recording) if operational else (read_one(recording, "frf-campaign", robot=robot), {})
    campaign: Campaign = given.content
    check_out(out)
    for option, end in (("--fmin", fmin), ("--fmax", fmax)):
        if end is not None and not 0 <= end <= RANGES["Hz"][1]:
            raise InputError(option, f"{end:g}", f"expected Hz from 0 to {RANGES['Hz'][1]:g}")
    check_count("max_order", max_order)
    if method not in ("plscf", "lsce"):
        raise InputError("--method", method, "expected plscf or lsce")
    described, unknown = _robot(given, robot, without)
    labels = campaign.response.label, campaign.excitation.label
    found = ModalAnalysis(campaign, {}, hits=given.hits)
    tick = (progress or silent)("modes", len(campaign.postures))
    for name, posture in campaign.postures.items():
        if operational:
            from twin.measure.operational import identify_running

            found.results[name] = identify_running(
                name, running[name], labels[0], fmin, fmax, max_order, source=given.source
            )
        else:
            found.results[name] = identify_modes(
                posture, fmin, fmax, max_order, method=method, labels=labels, source=given.source
            )
            found.checks[name] = [*driving_points(campaign, posture), *reciprocity(campaign, posture)]
        tick(1)
    if not operational and (levels := linearity(campaign)):
        found.checks.setdefault("force levels", []).extend(levels)
    if unknown:
        found.notes.append(f"shapes are not drawn on the robot: {unknown}")
    _place_shapes(found, described)
    options = {"fmin": fmin, "fmax": fmax, "max_order": max_order, "method": method, "operational": operational}
    found.origin = provenance(traced([given], robot), options | {"robot": robot, "without": without or []})
    if out is not None:
        with Outputs(out, "modal") as outputs:
            _write(found, given.named_in(out), outputs)
    return found


def _read_running(recording: Given) -> tuple[Recording, "dict[str, Running]"]:
    """Responses without excitation, from files."""
    from twin.measure.operational import read_running

    items = [recording] if isinstance(recording, str | Path) else recording
    if isinstance(items, Campaign | MotionLog | ModalTable) or not all(isinstance(x, str | Path) for x in items):
        raise TypeError("operational modes: expected the path of a recording")
    paths = [Path(str(x)) for x in items]
    for path in paths:
        if not path.is_file():
            raise InputError(path, "", "is a folder; expected a file" if path.is_dir() else "no such file")
    campaign, running = read_running(paths)
    return Recording("frf-campaign", str(paths[0]), campaign, tuple(paths)), running


def _robot(given: Recording, robot: Robot | str | Path | None, without: list[str] | None) -> tuple[Robot | None, str]:
    """The robot to draw shapes on, or why there is none; one that was asked for has to be there.

    Neither is there for a recording that says nothing of a robot.
    """
    recorded: Campaign = given.content
    if robot is None and recorded.robot is None and not any(p.q_deg.any() for p in recorded.postures.values()):
        return None, ""
    try:
        return given.described(robot, without), ""
    except InputError as error:
        if robot is not None:
            raise
        return None, str(error)


def _place_shapes(found: ModalAnalysis, robot: Robot | None) -> None:
    """Shapes on the robot, as far as the recording says where its points are on it; else as a wire frame."""
    told: dict[str, list[str]] = {}
    for name, result in found.results.items():
        if not result.modes:
            continue
        roving = found.campaign.response if result.roving == "response" else found.campaign.excitation
        if robot is not None:
            try:
                found.on_robot[name] = on_robot(robot, result, roving)
                continue
            except InputError as error:
                reason = ": ".join(part for part in (error.field, error.expected) if part)
                told.setdefault(f"shapes are not drawn on the robot: {reason}", []).append(name)
        frame = wireframe(roving, result.shapes, found.campaign.lines)
        if isinstance(frame, str):
            told.setdefault(f"shapes are not drawn: {frame}", []).append(name)
        else:
            found.frames[name] = frame
    found.notes += [f"{listed(names)}: {reason}" for reason, names in told.items()]


def _write(found: ModalAnalysis, robot: str | None, name: Outputs) -> None:
    from twin.measure.modal_table import write_modal_table
    from twin.measure.uff import write_uff_modes
    from twin.report import scene

    write_modal_table(name("modes.yaml"), replace(found.table, robot=robot))
    for key, result in found.results.items():
        if result.modes:
            write_uff_modes(name(f"{key}_modes.unv"), result)
    for key, shown in found.on_robot.items():
        scene.write_modes(name(f"{key}_modes.rrd"), *shown)
    for key, frame in found.frames.items():
        scene.write_wireframe(name(f"{key}_modes.rrd"), frame, found.results[key].titles, f"{key}: modes")
    name.report(found)
    path = name("modal.json")
    found.files = name.files
    write_json(path, found.data())
