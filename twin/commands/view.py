"""``twin view``: open, or write, what can be looked at in the rerun viewer."""

from pathlib import Path

import numpy as np

from twin.errors import InputError
from twin.robot.description import Robot, load_robot


def view(path: str | Path, out: Path | None = None) -> str:
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
            raise InputError(path, "--out", "is already a rerun recording; --out is for robots and logs")
        return scene.view(path)
    target = out or Path("out") / f"{path.stem}.rrd"
    if path.suffix == ".csv" or (path.suffix == ".h5" and _is_log(path)):
        _write_log(path, target)
    elif path.suffix == ".h5":
        _write_campaign(path, target)
    else:
        robot = load_robot(path)
        middle = [np.mean(axis.limits.position) if axis.limits and axis.limits.position else 0.0 for axis in robot.axes]
        _write_modes(robot, np.array(middle), target)
    return f"wrote {target}" if out is not None else scene.view(target)


def _is_log(path: Path) -> bool:
    import h5py

    try:
        with h5py.File(path) as file:
            return file.attrs.get("format") in ("motion-log", "trajectory")
    except OSError as error:
        raise InputError(path, "", "no such file, or not HDF5") from error


def _write_modes(robot: Robot, q: np.ndarray, target: Path) -> None:
    from twin.model.linear import linearise
    from twin.model.modes import modes
    from twin.report import scene
    from twin.robot.mechanism import assemble

    target.parent.mkdir(parents=True, exist_ok=True)
    mechanism = assemble(robot, q)
    scene.write_modes(target, mechanism, modes(linearise(mechanism)))


def _write_campaign(path: Path, target: Path) -> None:
    """The robot of a hammer test in its first posture, moving in the model's modes."""
    from twin.measure.campaign import read_campaign

    campaign = read_campaign(path)
    robot = load_robot(campaign.robot or "kr90", relative_to=path.parent)
    first = next(iter(campaign.postures.values()))
    _write_modes(robot, robot.check_posture(robot.angles(first.q_deg), str(path), f"postures/{first.name}"), target)


def _write_log(path: Path, target: Path) -> None:
    from twin.measure.motion_log import read_motion_log, require_axes
    from twin.model.replay import replay
    from twin.report import scene
    from twin.robot.mechanism import assemble

    log = read_motion_log(path)
    robot = load_robot(log.robot or "kr90", relative_to=path.parent)
    require_axes(log, robot.axis_count)
    target.parent.mkdir(parents=True, exist_ok=True)
    found = replay(robot, next(iter(log.runs.values())))
    mechanism = assemble(robot, found.position[0], brakes="off", drives="servo")
    scene.write_replay(target, mechanism, found.time, found.position, found.deflections, {"twin": found.torque})
