"""``twin view``: open, or write, what can be looked at in the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.commands.outputs import check_out
from twin.errors import InputError
from twin.measure.motion_log import read_motion_log, require_axes
from twin.measure.recordings import read_recordings, recording_kind, robot_of
from twin.robot.description import Robot, load_robot
from twin.yamlfile import read_yaml


def view(
    path: str | Path, out: Path | None = None, *, robot: str | None = None, without: list[str] | None = None
) -> str:
    """Open an output folder, a ``.rrd``, a robot or a recording; with ``out`` write a ``.rrd`` instead.

    Returns:
        One line that says what was opened or written.

    Raises:
        InputError: nothing there to look at, or no viewer can be opened.
    """
    from twin.report import scene

    path = Path(path)
    if path.is_dir() or path.suffix == ".rrd":
        if out is not None:
            message = "is for robots and recordings; a folder and a .rrd are shown as they are, without --out"
            raise InputError("--out", str(out), message)
        return scene.view(path)
    target = out or Path("out") / f"{path.stem}.rrd"
    check_out(target.parent, alone=False)
    if target.is_dir():
        raise InputError("--out", str(target), "is a folder; expected a file name.rrd")
    if (path.suffix or path.name != str(path)) and not path.exists():
        raise InputError(path, "", "no such file or folder")
    if _is_robot(path):
        shown = load_robot(path).without(without or [])
        middle = [np.mean(axis.limits.position) if axis.limits and axis.limits.position else 0.0 for axis in shown.axes]
        _write_modes(shown, np.array(middle), target)
    elif _is_motion(path):
        _write_log(path, robot, without, target)
    else:
        (recording,) = read_recordings([path])
        posture = next(iter(recording.content.postures.values()))
        _write_posture(recording.described(robot, without), posture.q_deg, path, target)
    return f"wrote {target}" if out is not None else scene.view(target)


def _is_robot(path: Path) -> bool:
    """A description: YAML that is no modal table, a URDF, or the name of a shipped robot."""
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return not path.is_file() or "postures" not in read_yaml(path)
    return suffix in (".urdf", ".xml") or (suffix == "" and not path.is_file())


def _is_motion(path: Path) -> bool:
    """A motion log or a trajectory."""
    try:
        return recording_kind(path) == "motion-log"
    except InputError as error:
        if error.field == "format" and "trajectory" in error.expected:
            return True
        raise


def _write_modes(robot: Robot, q: np.ndarray, target: Path) -> None:
    from twin.model.linear import linearise
    from twin.model.modes import modes
    from twin.report import scene
    from twin.robot.mechanism import assemble

    target.parent.mkdir(parents=True, exist_ok=True)
    mechanism = assemble(robot, q)
    scene.write_modes(target, mechanism, modes(linearise(mechanism)))


def _write_posture(robot: Robot, q_deg: Sequence[float] | np.ndarray, path: Path, target: Path) -> None:
    """The robot of a recording in its first posture, moving in the model's modes."""
    if not len(q_deg):
        raise InputError(path, "q_deg", "expected axis positions of a robot; twin modal draws other structures")
    if len(q_deg) != robot.axis_count:
        raise InputError(
            path, "q_deg", f"expected {robot.axis_count} values for robot {robot.name}, found {len(q_deg)}"
        )
    _write_modes(robot, robot.check_posture(robot.angles(q_deg), str(path)), target)


def _write_log(path: Path, named: str | None, without: list[str] | None, target: Path) -> None:
    from twin.model.replay import replay
    from twin.report import scene
    from twin.robot.mechanism import assemble

    log = read_motion_log(path)
    robot = robot_of(path, log.robot, named).without(without or [])
    require_axes(log, robot.axis_count)
    target.parent.mkdir(parents=True, exist_ok=True)
    found = replay(robot, next(iter(log.runs.values())))
    mechanism = assemble(robot, found.position[0], brakes="off", drives="servo")
    scene.write_replay(target, mechanism, found.time, found.position, found.deflections, {"twin": found.torque})
