"""``twin view``: open, or write, what can be looked at in the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.commands.compare import recording_kind
from twin.commands.modal import read_recording
from twin.commands.outputs import check_out
from twin.errors import InputError
from twin.robot.description import Robot, load_robot
from twin.yamlfile import read_yaml


def view(
    path: str | Path, out: Path | None = None, *, robot: str | None = None, without: list[str] | None = None
) -> str:
    """Open an output folder, a ``.rrd``, a robot or a motion recording; with ``out`` write a ``.rrd`` instead.

    Returns:
        One line that says what was opened or written.

    Raises:
        InputError: nothing there to look at, or no viewer can be opened.
    """
    from twin.report import scene

    path = Path(path)
    if path.is_dir() or path.suffix == ".rrd":
        if out is not None:
            raise InputError("--out", str(out), "is for robots and recordings, which have to be drawn first")
        return scene.view(path)
    target = out or Path("out") / f"{path.stem}.rrd"
    check_out(target.parent)
    if target.is_dir():
        raise InputError("--out", str(target), "is a folder; expected a file name.rrd")
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml") and path.is_file() and "postures" in read_yaml(path):
        from twin.measure.modal_table import read_modal_table

        table = read_modal_table(path)
        _write_posture(table.robot, next(iter(table.postures.values())).q_deg, path, robot, without, target)
    elif suffix in (".yaml", ".yml", ".urdf", ".xml", ""):
        shown = load_robot(path).without(without or [])
        middle = [np.mean(axis.limits.position) if axis.limits and axis.limits.position else 0.0 for axis in shown.axes]
        _write_modes(shown, np.array(middle), target)
    elif recording_kind(path)[0] == "motion-log":
        _write_log(path, robot, without, target)
    else:
        campaign = read_recording([path])
        _write_posture(campaign.robot, next(iter(campaign.postures.values())).q_deg, path, robot, without, target)
    return f"wrote {target}" if out is not None else scene.view(target)


def _write_modes(robot: Robot, q: np.ndarray, target: Path) -> None:
    from twin.model.linear import linearise
    from twin.model.modes import modes
    from twin.report import scene
    from twin.robot.mechanism import assemble

    target.parent.mkdir(parents=True, exist_ok=True)
    mechanism = assemble(robot, q)
    scene.write_modes(target, mechanism, modes(linearise(mechanism)))


def _write_posture(
    named: str | None,
    q_deg: Sequence[float] | np.ndarray,
    path: Path,
    robot: str | None,
    without: list[str] | None,
    target: Path,
) -> None:
    """The robot of a recording in its first posture, moving in the model's modes."""
    shown = load_robot(robot) if robot else load_robot(named or "kr90", relative_to=path.parent)
    shown = shown.without(without or [])
    if len(q_deg) != shown.axis_count:
        raise InputError(
            path, "q_deg", f"expected {shown.axis_count} values for robot {shown.name}, found {len(q_deg)}"
        )
    _write_modes(shown, shown.check_posture(shown.angles(q_deg), str(path)), target)


def _write_log(path: Path, named: str | None, without: list[str] | None, target: Path) -> None:
    from twin.measure.motion_log import read_motion_log, require_axes
    from twin.model.replay import replay
    from twin.report import scene
    from twin.robot.mechanism import assemble

    log = read_motion_log(path)
    robot = load_robot(named) if named else load_robot(log.robot or "kr90", relative_to=path.parent)
    robot = robot.without(without or [])
    require_axes(log, robot.axis_count)
    target.parent.mkdir(parents=True, exist_ok=True)
    found = replay(robot, next(iter(log.runs.values())))
    mechanism = assemble(robot, found.position[0], brakes="off", drives="servo")
    scene.write_replay(target, mechanism, found.time, found.position, found.deflections, {"twin": found.torque})
