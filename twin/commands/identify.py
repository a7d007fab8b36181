"""``twin identify``: motion log in; base parameters with intervals, a consistent robot, errors and figures out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out, check_spared
from twin.diagnose.torque_faults import told_sound
from twin.identify.rigid import Identification
from twin.identify.rigid import identify as estimate
from twin.measure.motion_log import MotionLog
from twin.measure.recordings import Given, read_one, traced
from twin.model.torque_rows import Bands, in_joints, relative_error
from twin.parallel import Progress, one_thread_each, silent
from twin.provenance import provenance, write_json
from twin.result import Result, no_model, written
from twin.robot.description import Robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf
from twin.table import Table

PARTS = ("train", "held_out")
ROUNDING = 1e-12  # kg, kg m, kg m², N·m: what cancels in a combination leaves as much


@dataclass
class Identified(Result):
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
    model: dict[str, str | None] = field(default_factory=no_model)
    origin: dict[str, Any] = field(default_factory=dict)

    drawn_by = "twin.report.identify_figures"

    @property
    def robot(self) -> Robot:
        """The physically consistent robot nearest to the description."""
        return self.found.robot

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
        described, consistent = self._combined()
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

    def _combined(self) -> list[np.ndarray]:
        """The base parameters (n,) as described, and of links that can exist; those that cancel are exactly zero."""
        combine, found = self.found.estimate.base.combine, self.found
        values = [combine @ x for x in (found.regressor.described, found.parameters)]
        return [np.where(np.abs(value) < ROUNDING, 0.0, value) for value in values]

    def tables(self) -> list[Table]:
        """Parameters with their intervals, and errors by joint."""
        found, errors = self.found.estimate, self.errors()
        described, consistent = self._combined()
        rows = [
            (
                name, *_as_sure(found.interval90[k], found.value[k], described[k], consistent[k]), found.base.units[k],
                "" if found.identifiable[k] else "not identifiable from this log",
            )
            for k, name in enumerate(found.base.names)
        ]  # fmt: skip
        dim = [k for k, held in enumerate(found.identifiable) if not held]
        units = self._units()
        joints = [
            (
                f"joint{i + 1}",
                *(f"{errors['error'][part][i]:.2%} ({errors['rms'][part][i]:.3g} {units[i]})" for part in PARTS),
            )
            for i in range(self.robot.axis_count)
        ]
        return [
            Table(
                ("parameter", "value", "90 % interval", "described", "consistent", "unit", ""), rows, (1, 2, 3, 4), dim
            ),
            Table(("torque error", "fitted", "held out"), joints, (1, 2)),
        ]

    def _units(self) -> list[str]:
        return ["N" if axis.type == "prismatic" else "N·m" for axis in self.found.robot.axes]

    def __str__(self) -> str:
        found, estimate = self.found, self.found.estimate
        low, high = found.bands.fit
        lines = [f"{found.robot.name} · {self.source} · low-pass {low:g}–{high:g} Hz · held out: {found.split.text}"]
        lines += [f"  note: {note}" for note in found.notes]
        lines.append(
            "  parameter                                          value   ± 90 %      described     consistent"
        )
        described, consistent = self._combined()
        half = [_two(half) for half in estimate.interval90[:, 1] - estimate.value]
        for k, name in enumerate(estimate.base.names):
            mark = "" if estimate.identifiable[k] else "   not identifiable from this log"
            lines.append(
                f"  {name:44s} {estimate.value[k]:12.5g} {half[k]:>9s} {described[k]:14.5g} {consistent[k]:14.5g} "
                f"{estimate.base.units[k]}{mark}"
            )
        errors, units = self.errors(), self._units()
        for part in PARTS:
            shown = "  ".join(
                f"joint{i + 1} {ratio:.2%} ({rms:.3g} {units[i]})"
                for i, (ratio, rms) in enumerate(zip(errors["error"][part], errors["rms"][part], strict=True))
            )
            lines.append(f"  {part.replace('_', ' '):9s} {shown}")
        effective = ", ".join(f"{value:.0f}" for value in estimate.effective)
        lines.append(f"  {estimate.samples[0]} rows per joint, worth {effective} independent ones")
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def _two(value: float) -> str:
    """Two digits, without a power of ten where plain digits do."""
    return f"{float(f'{value:.2g}'):g}"


def _as_sure(interval: np.ndarray, value: float, *others: float) -> tuple[str, ...]:
    """Value, interval and what stands beside them, to two digits of half of the interval's width, or of their own."""
    half = float(interval[1] - interval[0]) / 2

    def shown(number: float) -> str:
        if not number or not (np.isfinite(half) and half > 0):
            return f"{number:.5g}"
        digits = int(np.floor(np.log10(abs(number))) - np.floor(np.log10(half)))
        return f"{number:.{int(np.clip(2 + digits, 2, 5))}g}"

    return shown(value), " … ".join(map(shown, interval)), *map(shown, others)


@one_thread_each()
def identify(
    log: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    hold_out: list[str] | None = None,
    low_pass: tuple[float, float] | None = None,
    weighting: str = "joint",
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Identified:
    """Rigid-body, rotor, friction and compensator parameters from a motion log.

    Args:
        log: a :class:`MotionLog`, or its file, HDF5 or CSV.
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the log's.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        hold_out: runs not to fit; chosen when empty.
        low_pass: pass and stop frequency for torque and columns, Hz; 3 and 4 by default. For a log shorter than 40 s,
            those that predict the held-out torque best.
        weighting: ``"joint"`` or ``"none"``.
        out: folder for robot.yaml, robot.xml, figures and identify.json; ``None`` writes nothing.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    bands = Bands(fit=low_pass) if low_pass else None
    given = read_one(log, "motion-log")
    check_spared(out, [given])
    described = given.described(robot, without)
    content = told_sound(given.content, described)
    joints = in_joints(content, described)
    tick = (progress or silent)("identify", 1)
    found = estimate(content, described, bands=bands, hold_out=hold_out or None, weighting=weighting)
    tick(1)
    result = Identified(given.source, found, joints)
    options = {"robot": robot, "without": without or [], "hold_out": hold_out or [], "low_pass": list(found.bands.fit)}
    result.origin = provenance(traced([given], robot), {**options, "weighting": weighting})
    if out is not None:
        with Outputs(out, "identify") as outputs:
            result.files = outputs.files
            _write(result, outputs)
    return result


def _write(result: Identified, name: Outputs) -> None:
    found = result.found
    save_robot(name("robot.yaml"), found.robot)
    middle = np.mean([run.position.mean(axis=0) for run in result.log.runs.values()], axis=0)
    for i, axis in enumerate(found.robot.axes):
        if axis.limits and axis.limits.position:
            middle[i] = np.clip(middle[i], *axis.limits.position)
    save_mjcf(name("robot.xml"), lit(build_spec(assemble(found.robot, middle))))
    result.model = {"robot": result.files[0], "mjcf": result.files[1]}
    name.report(result)
    path = name("identify.json")
    write_json(path, result.data())
