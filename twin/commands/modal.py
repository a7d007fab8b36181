"""``twin modal``: measured FRFs in; modes with deviations, tables, figures and shapes on the robot out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError
from twin.measure.campaign import Campaign, read_campaign
from twin.measure.modal import Method, ModalResult, identify_modes, modal_report
from twin.measure.spectra import Check, driving_points, linearity, reciprocity, with_frfs
from twin.parallel import Progress
from twin.provenance import provenance, write_json
from twin.robot.description import Robot, load_robot

UFF = (".uff", ".unv", ".bunv", ".ufb", ".58")


@dataclass
class ModalAnalysis:
    """What ``twin modal`` found; prints itself, and is the JSON of the command.

    Attributes:
        campaign: the recording.
        results: posture → modes.
        checks: what a test engineer asks of the FRFs.
        tables: posture → which hits counted, where raw hits were given.
        notes: what could not be done, and why.
        files: what was written.
    """

    campaign: Campaign
    results: dict[str, ModalResult]
    checks: dict[str, list[Check]] = field(default_factory=dict)
    tables: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    origin: dict[str, Any] = field(default_factory=dict)

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

    def __str__(self) -> str:
        lines = []
        for name, result in self.results.items():
            if name in self.tables:
                lines.append(str(self.tables[name]))
            lines.append(str(result))
            lines += [f"  {check}" for check in self.checks.get(name, []) if not check.passed]
        lines += self.notes
        if self.files:
            lines.append("wrote " + ", ".join(self.files))
        return "\n".join(lines)


def read_recording(paths: Sequence[str | Path]) -> Campaign:
    """One ``frf-campaign`` file, or one or several universal files that belong together; FRFs from hits if need be.

    Raises:
        InputError: the files break the contract, or kinds are mixed.
    """
    return with_frfs(_read(paths), str(paths[0]))[0]


def _read(paths: Sequence[str | Path]) -> Campaign:
    """The files as they are.

    Raises:
        InputError: the files break the contract, or kinds are mixed.
    """
    files = [Path(path) for path in paths]
    for file in files:
        if not file.is_file():
            raise InputError(file, "", "no such file")
    if all(file.suffix.lower() in UFF for file in files):
        from twin.measure.uff import read_uff

        return read_uff(files)
    if len(files) > 1:
        raise InputError(files[1], "", "several files are taken only when all are universal files (.uff, .unv)")
    return read_campaign(files[0])


def modal(
    paths: Sequence[str | Path],
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    fmin: float | None = None,
    fmax: float | None = None,
    max_order: int = 60,
    method: Method = "plscf",
    out: Path | None = None,
    progress: Progress | None = None,
) -> ModalAnalysis:
    """Identify the modes of every posture of a hammer test.

    Args:
        paths: ``measured_frf.h5`` or universal files.
        robot: the robot shapes are drawn on; by default the file's, else kr90.
        without: entries removed from it.
        fmin, fmax: band, Hz; by default all that is usable.
        max_order: highest order of the stabilisation chart.
        method: ``plscf`` or ``lsce``.
        out: folder for tables, figures and animations; ``None`` writes nothing.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    progress = progress or (lambda description, total: lambda count: None)
    campaign, tables = with_frfs(_read(paths), str(paths[0]))
    check_out(out)
    if not (fmin is None or np.isfinite(fmin)) or not (fmax is None or np.isfinite(fmax)) or max_order < 2:
        raise InputError("--fmin, --fmax, --max-order", "", "expected finite frequencies and an order of 2 or more")
    described, unknown = _robot(campaign, robot, without or [], Path(paths[0]).parent)
    source = str(paths[0])
    labels = campaign.response.label, campaign.excitation.label
    found = ModalAnalysis(campaign, {}, tables=tables)
    tick = progress("modes", len(campaign.postures))
    for name, posture in campaign.postures.items():
        found.results[name] = identify_modes(
            posture, fmin, fmax, max_order, method=method, labels=labels, source=source
        )
        found.checks[name] = [*driving_points(campaign, posture), *reciprocity(campaign, posture)]
        tick(1)
    if levels := linearity(campaign):
        found.checks.setdefault("force levels", []).extend(levels)
    options = {"fmin": fmin, "fmax": fmax, "max_order": max_order, "method": method}
    found.origin = provenance(paths, options | {"robot": robot, "without": without or []})
    if out is not None:
        with Outputs(out) as outputs:
            if unknown:
                found.notes.append(f"shapes are not drawn on the robot: {unknown}")
            _write(found, described, outputs)
    return found


def _robot(campaign: Campaign, robot: str | None, without: list[str], folder: Path) -> tuple[Robot | None, str]:
    """The robot to draw shapes on, or why there is none; one that was asked for has to be there."""
    if robot is not None:
        return load_robot(robot).without(without), ""
    try:
        return load_robot(campaign.robot or "kr90", relative_to=folder).without(without), ""
    except InputError as error:
        return None, str(error)


def _write(found: ModalAnalysis, robot: Robot | None, name: Outputs) -> None:
    from twin.measure.modal_table import ModalTable, write_modal_table
    from twin.measure.uff import write_uff_modes
    from twin.report import modal_figures

    write_modal_table(name("modes.yaml"), ModalTable.of(found.results, found.campaign.robot))
    for key, result in found.results.items():
        if result.modes:
            write_uff_modes(name(f"{key}_modes.unv"), result)
            if robot is not None:
                _draw_shapes(found, key, result, robot, name)
    name.files += [str(name.out / path.name) for path in modal_figures.write_modal_figures(name.stage, found.results)]
    path = name("modal.json")
    found.files = name.files
    write_json(path, found.data())


def _draw_shapes(found: ModalAnalysis, key: str, result: ModalResult, robot: Robot, name: Outputs) -> None:
    """Shapes on the robot, as far as the recording says where its points are on it."""
    from twin.model.expansion import expand
    from twin.report import figures, scene

    roving = found.campaign.response if result.roving == "response" else found.campaign.excitation
    known = {"base", *(f"link{i + 1}" for i in range(robot.axis_count))}
    missing = ""
    if len(result.q_deg) != robot.axis_count:
        missing = f"{len(result.q_deg)} axis positions, robot {robot.name} has {robot.axis_count}"
    elif unknown := set(roving.body) - known:
        missing = f"points on {', '.join(sorted(unknown))}, which robot {robot.name} does not have"
    elif all(axis.stiffness is None for axis in robot.axes):
        missing = f"robot {robot.name} has no elastic axis"
    else:
        try:
            q = robot.check_posture(robot.angles(result.q_deg), key, "q_deg")
        except InputError as error:
            missing = str(error)
    if missing:
        found.notes.append(f"{key}: shapes are not drawn on the robot: {missing}")
        return
    ratio = np.array([mode.damping_percent / 100 for mode in result.modes])
    omega = 2 * np.pi * np.array([mode.frequency_hz for mode in result.modes])
    pole = omega * (-ratio + 1j * np.sqrt(1 - ratio**2))
    mechanism, shapes = expand(robot, q, roving, result.shapes, pole)
    figures.save(figures.mode_shapes(mechanism, shapes), name(f"{key}_shapes.png"))
    scene.write_modes(name(f"{key}_modes.rrd"), mechanism, shapes)
