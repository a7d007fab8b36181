"""Motion logs and trajectories on disk: HDF5 (``motion-log``, ``trajectory``) and CSV, and their checks.

A trajectory is a motion log without torque. Positions are the motor encoder divided by the gear ratio, torques the
motor torque times the gear ratio, both at the gear output.
"""

from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from twin.errors import InputError
from twin.measure.campaign import FloatArray, replacing
from twin.yamlfile import atomic_write

VERSION = 1
SERIES = ("position", "torque", "velocity", "acceleration", "link_position")


@dataclass(frozen=True)
class MotionRun:
    """One uninterrupted run of n axes, nt samples.

    Attributes:
        time: (nt,) s, one clock over all runs of a campaign.
        position: (nt, n) rad (m).
        torque: (nt, n) N·m (N), or ``None`` in a trajectory.
        velocity, acceleration: (nt, n), where given.
        link_position: (nt, n) rad (m), a second encoder on the link side, where there is one.
        sample_rate_hz: nominal rate.
    """

    name: str
    time: FloatArray
    position: FloatArray
    sample_rate_hz: float
    torque: FloatArray | None = None
    velocity: FloatArray | None = None
    acceleration: FloatArray | None = None
    link_position: FloatArray | None = None


@dataclass(frozen=True)
class MotionLog:
    """Runs by name, and the robot they were made with, where the file says."""

    runs: dict[str, MotionRun] = field(default_factory=dict)
    robot: str | None = None
    source: str = "motion log"


def read_motion_log(path: str | Path) -> MotionLog:
    """Read a motion log or trajectory from HDF5 or CSV (header ``time,q1..qn,tau1..taun``).

    Raises:
        InputError: the file is missing or breaks the contract; one line names the field.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "", "no such file")
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    try:
        file = h5py.File(path)
    except OSError as error:
        raise InputError(path, "", "not an HDF5 file") from error
    with file:
        kind = _text(file.attrs.get("format"))
        if kind not in ("motion-log", "trajectory"):
            raise InputError(path, "format", f"expected 'motion-log' or 'trajectory', found {kind!r}")
        if int(file.attrs.get("version", VERSION)) != VERSION:
            raise InputError(path, "version", f"expected {VERSION}, found {file.attrs['version']}")
        if "runs" not in file or not len(file["runs"]):
            raise InputError(path, "runs", "expected at least one run")
        runs = {}
        for name, group in file["runs"].items():
            where = f"runs/{name}"
            series = {key: np.asarray(group[key], float) for key in SERIES if key in group}
            if "time" not in group:
                raise InputError(path, f"{where}/time", "missing")
            rate = group.attrs.get("sample_rate_hz")
            if rate is None:
                raise InputError(path, f"{where}/sample_rate_hz", "missing attribute")
            runs[name] = _checked(path, where, name, np.asarray(group["time"], float), series, float(rate))
            if kind == "motion-log" and runs[name].torque is None:
                raise InputError(path, f"{where}/torque", "missing")
        return MotionLog(runs, _text(file.attrs.get("robot")), str(path))


def write_motion_log(path: str | Path, log: MotionLog) -> None:
    """Write a log as HDF5, or as CSV where the name ends so (one run only), atomically."""
    path = Path(path)
    if path.suffix.lower() == ".csv":
        _write_csv(path, log)
        return
    with replacing(path) as aside, h5py.File(aside, "w") as file:
        torque = all(run.torque is not None for run in log.runs.values())
        file.attrs.update({"format": "motion-log" if torque else "trajectory", "version": VERSION})
        if log.robot:
            file.attrs["robot"] = log.robot
        for name, run in log.runs.items():
            group = file.create_group(f"runs/{name}")
            group.attrs["sample_rate_hz"] = run.sample_rate_hz
            group["time"] = run.time
            for key in SERIES:
                if (values := getattr(run, key)) is not None:
                    group[key] = values


def require_axes(log: MotionLog, axes: int) -> MotionLog:
    """The log itself.

    Raises:
        InputError: a run with another number of axes than the robot has.
    """
    for name, run in log.runs.items():
        if run.position.shape[1] != axes:
            raise InputError(
                log.source, f"runs/{name}/position", f"expected {axes} columns, found {run.position.shape[1]}"
            )
    return log


def _checked(
    path: Path, where: str, name: str, time: FloatArray, series: dict[str, FloatArray], rate: float
) -> MotionRun:
    if not rate > 0:
        raise InputError(path, f"{where}/sample_rate_hz", f"expected a number > 0, found {rate:g}")
    if time.ndim != 1 or len(time) < 2:
        raise InputError(path, f"{where}/time", f"expected at least two instants (nt,), found shape {time.shape}")
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InputError(path, f"{where}/time", "expected finite, increasing instants in s")
    if "position" not in series:
        raise InputError(path, f"{where}/position", "missing")
    shape = series["position"].shape
    for key, values in series.items():
        if values.ndim != 2 or len(values) != len(time) or values.shape != shape:
            expected = f"({len(time)}, {shape[1] if len(shape) == 2 else 'n'})"
            raise InputError(path, f"{where}/{key}", f"expected shape {expected}, found {values.shape}")
        if not np.isfinite(values).all():
            raise InputError(
                path, f"{where}/{key}", f"not finite at sample {int(np.argwhere(~np.isfinite(values))[0, 0])}"
            )
    return MotionRun(name, time, sample_rate_hz=rate, **series)


def _read_csv(path: Path) -> MotionLog:
    with path.open(encoding="utf-8") as stream:
        header = [word.strip() for word in stream.readline().split(",")]
        try:
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
        except ValueError as error:
            raise InputError(path, "", f"expected numbers separated by commas: {error}") from error
    n = sum(word.startswith("q") for word in header)
    torque = [f"tau{i + 1}" for i in range(n)]
    expected = ["time", *(f"q{i + 1}" for i in range(n))]
    if header not in (expected, expected + torque) or n == 0:
        raise InputError(path, "header", "expected time,q1..qn,tau1..taun")
    if table.shape[1] != len(header):
        raise InputError(path, "", f"expected {len(header)} columns, found {table.shape[1]}")
    series = {"position": table[:, 1 : n + 1]}
    if len(header) > n + 1:
        series["torque"] = table[:, n + 1 :]
    time = table[:, 0]
    rate = 1 / float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    return MotionLog({path.stem: _checked(path, "csv", path.stem, time, series, rate)}, None, str(path))


def _write_csv(path: Path, log: MotionLog) -> None:
    if len(log.runs) != 1:
        raise InputError(path, "", f"a CSV holds one run, not {len(log.runs)}; write .h5")
    (run,) = log.runs.values()
    n = run.position.shape[1]
    names = ["time", *(f"q{i + 1}" for i in range(n))]
    columns = [run.time[:, None], run.position]
    if run.torque is not None:
        names += [f"tau{i + 1}" for i in range(n)]
        columns.append(run.torque)
    with atomic_write(path) as stream:
        np.savetxt(stream, np.hstack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.12g")


def _text(value: object) -> str | None:
    return value.decode() if isinstance(value, bytes) else None if value is None else str(value)
