"""``twin identify``: motion log in; base parameters with intervals, a consistent robot, errors and figures out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError
from twin.identify.rigid import Bands, Identification, identify, joint_run, relative_error
from twin.measure.motion_log import MotionLog, check_against, read_motion_log, require_axes
from twin.parallel import Progress
from twin.provenance import provenance, write_json
from twin.robot.description import Robot, load_robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, save_mjcf


@dataclass
class Identified:
    """What ``twin identify`` found; prints itself, and is the JSON of the command.

    Attributes:
        source: the log.
        found: estimate, consistent robot, split.
        log: the log, in joint coordinates.
        files: what was written.
    """

    source: str
    found: Identification
    log: MotionLog
    files: list[str] = field(default_factory=list)
    model: dict[str, str | None] = field(default_factory=lambda: {"robot": None, "mjcf": None})
    origin: dict[str, Any] = field(default_factory=dict)

    def errors(self) -> dict[str, dict[str, list[float]]]:
        """Relative error and RMS (N·m, N) per joint of the robot written, and of the unconstrained least squares."""
        parts = {"train": self.found.split.train, "held_out": self.found.split.held_out}
        sets = {"": self.found.parameters, "_least_squares": self.found.least_squares_parameters()}
        out: dict[str, dict[str, list[float]]] = {}
        for suffix, x in sets.items():
            judged = {name: relative_error(rows, x) for name, rows in parts.items()}
            out["error" + suffix] = {name: ratio.tolist() for name, (ratio, _) in judged.items()}
            out["rms" + suffix] = {name: rms.tolist() for name, (_, rms) in judged.items()}
        return out

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        found, estimate = self.found, self.found.estimate
        described = estimate.base.combine @ found.regressor.described
        consistent = estimate.base.combine @ found.parameters
        combinations = estimate.base.combinations(found.regressor.robot)
        parameters: dict[str, Any] = {}
        recording: dict[str, Any] = {}
        for k, name in enumerate(estimate.base.names):
            entry = {
                "value": float(estimate.value[k]), "unit": estimate.base.units[k],
                "interval90": [float(x) for x in estimate.interval90[k]],
                "identifiable": bool(estimate.identifiable[k]), "combination": combinations[k],
                "described": float(described[k]), "consistent": float(consistent[k]),
            }  # fmt: skip
            (recording if name.startswith("torque_offset@") else parameters)[name] = entry
        return {
            "robot": found.robot.name,
            "source": self.source,
            "parameters": parameters,
            "recording": recording,
            **self.errors(),
            "held_out": found.split.text,
            "low_pass_hz": list(found.bands.fit),
            "noise": found.estimate.noise.tolist(),
            "samples": found.estimate.samples.tolist(),
            "effective_samples": found.estimate.effective.tolist(),
            "not_excited": [found.regressor.columns[k].name for k in estimate.base.none],
            "notes": found.notes,
            "model": self.model,
            "files": self.files,
            "provenance": self.origin,
        }

    def __str__(self) -> str:
        found, estimate = self.found, self.found.estimate
        low, high = found.bands.fit
        lines = [f"{found.robot.name} · {self.source} · low-pass {low:g}–{high:g} Hz · held out: {found.split.text}"]
        lines += [f"  note: {note}" for note in found.notes]
        lines.append(
            "  parameter                                          value   ± 90 %      described     consistent"
        )
        described = estimate.base.combine @ found.regressor.described
        consistent = estimate.base.combine @ found.parameters
        half = estimate.interval90[:, 1] - estimate.value
        for k, name in enumerate(estimate.base.names):
            mark = "" if estimate.identifiable[k] else "   not identifiable from this log"
            lines.append(
                f"  {name:44s} {estimate.value[k]:12.5g} {half[k]:9.2g} {described[k]:14.5g} {consistent[k]:14.5g} "
                f"{estimate.base.units[k]}{mark}"
            )
        errors = self.errors()
        for part in ("train", "held_out"):
            shown = "  ".join(
                f"joint{i + 1} {ratio:.2%} ({rms:.3g})"
                for i, (ratio, rms) in enumerate(zip(errors["error"][part], errors["rms"][part], strict=True))
            )
            lines.append(f"  {part.replace('_', ' '):9s} {shown}")
        effective = ", ".join(f"{value:.0f}" for value in estimate.effective)
        lines.append(f"  {estimate.samples[0]} rows per joint, worth {effective} independent ones")
        if self.files:
            lines.append("  wrote " + ", ".join(self.files))
        return "\n".join(lines)


def identify_log(
    path: str | Path,
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    out: Path | None = None,
    hold_out: list[str] | None = None,
    low_pass: tuple[float, float] = (3.0, 4.0),
    weighting: str = "joint",
    progress: Progress | None = None,
) -> Identified:
    """Rigid-body, rotor, friction and compensator parameters from a motion log.

    Args:
        path: motion log, HDF5 or CSV.
        robot: shipped name, ``robot.yaml`` or URDF; wins over the log's.
        without: entries to remove.
        out: folder for robot.yaml, robot.xml, figures and identify.json; ``None`` writes nothing.
        hold_out: runs not to fit; chosen when empty.
        low_pass: pass and stop frequency for torque and columns, Hz.
        weighting: ``"joint"`` or ``"none"``.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_low_pass(low_pass)
    check_out(out)
    progress = progress or (lambda description, total: lambda step: None)
    log = read_motion_log(path)
    name, folder = (robot, None) if robot else (log.robot or "kr90", Path(path).parent)
    loaded = load_robot(name, folder).without(without or [])
    joints = in_joints(log, loaded)
    tick = progress("identify", 1)
    bands = Bands(fit=low_pass)
    found = identify(log, loaded, bands=bands, hold_out=hold_out or None, weighting=weighting)
    tick(1)
    result = Identified(str(path), found, joints)
    inputs = [str(path), *([name] if Path(name).is_file() else [])]
    options = {"robot": robot, "without": without or [], "hold_out": hold_out or [], "low_pass": list(low_pass)}
    result.origin = provenance(inputs, {**options, "weighting": weighting})
    if out is not None:
        with Outputs(out) as outputs:
            result.files = outputs.files
            _write(result, outputs)
    return result


def check_low_pass(low_pass: tuple[float, float]) -> None:
    """Raise unless the taper runs from a lower to a higher frequency.

    Raises:
        InputError: it does not.
    """
    if not 0 < low_pass[0] < low_pass[1]:
        raise InputError("--low-pass", "", f"expected 0 < pass < stop, found {low_pass[0]:g} {low_pass[1]:g}")


def in_joints(log: MotionLog, robot: Robot) -> MotionLog:
    """A log as recorded (motors) in joint coordinates, checked against the robot.

    Raises:
        InputError: number of axes, units or limits do not fit.
    """
    require_axes(log, robot.axis_count)
    turned = MotionLog(
        {name: joint_run(robot, run) for name, run in log.runs.items()}, log.robot, log.source, log.notes
    )
    check_against(turned, robot)
    return turned


def _write(result: Identified, name: Outputs) -> None:
    from twin.report import motion_figures
    from twin.report.figures import save

    found = result.found
    save_robot(name("robot.yaml"), found.robot)
    middle = np.mean([run.position.mean(axis=0) for run in result.log.runs.values()], axis=0)
    for i, axis in enumerate(found.robot.axes):
        if axis.limits and axis.limits.position:
            middle[i] = np.clip(middle[i], *axis.limits.position)
    save_mjcf(name("robot.xml"), build_spec(assemble(found.robot, middle)))
    result.model = {"robot": result.files[0], "mjcf": result.files[1]}
    robot, split = found.regressor.robot, found.split
    first = result.log.runs[split.train[0].name]
    save(motion_figures.signals(robot, first, found.bands), name("signals.png"))
    for rows, title, file in ((split.train, "fitted", "fitted"), (split.held_out, "held out", "held_out")):
        predicted = [r.matrix @ found.parameters + r.known for r in rows]
        save(motion_figures.prediction(robot, rows, {"predicted": predicted}, title), name(f"{file}.png"))
    save(motion_figures.residuals(robot, split.train, found.parameters), name("residuals.png"))
    path = name("identify.json")
    write_json(path, result.data())
