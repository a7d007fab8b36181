"""``posture.yaml``: which robot, in which posture, how it is hit, what it replays, what it cuts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from twin.errors import InputError, tell
from twin.measure.campaign import FASTEST_SAMPLES_HZ, LONGEST_PULSE_S, LONGEST_RECORD_S
from twin.measure.motion_log import MotionLog, read_motion_log
from twin.milling.cut import Cut, read_cut
from twin.model.hammer import LEAST_PULSES
from twin.ranges import LARGEST_FORCE_N, LEAST_FORCE_N, LONGEST_NAME, NAME
from twin.robot.description import Data, Number, Robot, first_problem, load_robot
from twin.yamlfile import read_yaml

LONGEST_RECORD = 2e6  # samples


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _none_if_false(value: Any) -> Any:
    return {} if value is None else None if value is False else value


Force = Annotated[Number, Field(ge=LEAST_FORCE_N, le=LARGEST_FORCE_N)]


class Hammer(Data):
    """How the robot is hit; several ``force_n`` are several force levels. Noise is off unless asked for."""

    force_n: Annotated[list[Force], BeforeValidator(_as_list), Field(min_length=1, max_length=20)] = Field(
        default=[300.0]
    )
    pulse_s: Annotated[Number, Field(ge=1e-6, le=LONGEST_PULSE_S)] = 0.008
    duration_s: Annotated[Number, Field(gt=0, le=LONGEST_RECORD_S)] | None = None
    sample_rate_hz: Annotated[Number, Field(gt=0, le=FASTEST_SAMPLES_HZ)] = 2048.0
    hits: Annotated[int, Field(ge=1, le=1000, strict=True)] = 3
    force_spread: Annotated[Number, Field(ge=0, le=1)] = 0.0
    force_noise_n: Annotated[Number, Field(ge=0, le=LARGEST_FORCE_N)] = 0.0
    response_noise: Annotated[Number, Field(ge=0, le=1e4)] = 0.0
    off_axis_deg: Annotated[Number, Field(ge=0, le=90)] = 0.0
    raw_hits: Annotated[bool, Field(strict=True)] = False

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len({f"{level:g}" for level in self.force_n}) < len(self.force_n):
            raise ValueError(f"force_n: expected different levels, found {self.force_n}")
        return self


class _Posture(Data):
    name: Annotated[str, Field(pattern=NAME, max_length=LONGEST_NAME)] = "posture"
    q_deg: list[Number]
    brakes: Literal["on", "off"] = "on"


class _File(Data):
    robot: str | None = None
    posture: _Posture
    hammer: Annotated[Hammer | None, BeforeValidator(_none_if_false)] = Hammer()
    replay: str | None = None
    cut: dict[str, Any] | str | None = None


@dataclass(frozen=True)
class PostureFile:
    """The content of a posture file, robot loaded, units as the model takes them.

    Attributes:
        robot: description, removals applied.
        q: (n,) joint positions, rad (m); ``q_deg`` as the user wrote them.
        hammer: how it is hit, or ``None`` for modes only.
        trajectory: what is replayed, or ``None``.
        cut: what is milled how, or ``None``.
        inputs: the files that were read, and what was given in memory.
    """

    robot: Robot
    name: str
    q: np.ndarray
    q_deg: list[float]
    brakes: Literal["on", "off"]
    hammer: Hammer | None
    trajectory: MotionLog | None
    cut: Cut | None
    inputs: list[Any]


def read_posture_file(
    path: str | Path,
    robot: Robot | str | Path | None = None,
    without: Sequence[str] | None = None,
    **changes: Any,
) -> PostureFile:
    """Read and check a posture file.

    Args:
        path: the file.
        robot: wins over the robot named in the file, which wins over ``kr90``.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        changes: ``brakes``, ``hammer`` and ``trajectory`` that win over the file's, unless ``None``.

    Raises:
        InputError: one line that names the file, the field and what was expected.
    """
    return _checked(read_yaml(path), Path(path), robot, without, [Path(path)], **changes)


def posture_in_memory(
    posture: Mapping[str, Any] | Sequence[float] | np.ndarray,
    robot: Robot | str | Path | None = None,
    without: Sequence[str] | None = None,
    **changes: Any,
) -> PostureFile:
    """The content of a posture file, or axis positions (n,) in degrees (m) alone, which are not hit unless asked for.

    Raises:
        InputError: as :func:`read_posture_file`.
    """
    if isinstance(posture, Mapping):
        data: dict[str, Any] = dict(posture)
    else:
        data = {"posture": {"q_deg": np.asarray(posture, float).tolist()}, "hammer": False}
    return _checked(data, Path("posture"), robot, without, [], **changes)


def _checked(
    data: dict[str, Any],
    path: Path,
    robot: Robot | str | Path | None,
    without: Sequence[str] | None,
    inputs: list[Any],
    *,
    brakes: str | None = None,
    hammer: Mapping[str, Any] | bool | None = None,
    trajectory: MotionLog | str | Path | None = None,
) -> PostureFile:
    if brakes is not None and isinstance(data.get("posture", {}), Mapping):
        data = {**data, "posture": {**data.get("posture", {}), "brakes": brakes}}
    if hammer is not None:
        data = {**data, "hammer": {} if hammer is True else hammer}
    try:
        content = _File.model_validate(data)
    except ValidationError as error:
        where, message = first_problem(error)
        raise InputError(path, where, message) from error
    loaded = load_robot(robot or content.robot or "kr90", None if robot else path.parent)
    loaded = loaded.without(list(without or []))
    if len(content.posture.q_deg) != loaded.axis_count:
        raise InputError(
            path, "posture.q_deg",
            f"expected {loaded.axis_count} values for robot {loaded.name}, found {len(content.posture.q_deg)}",
        )  # fmt: skip
    q = loaded.check_posture(loaded.angles(content.posture.q_deg), str(path), "posture.q_deg")
    if _like_radians(loaded, content.posture.q_deg):
        tell(path, "posture.q_deg", "all angles are below 3.2 degrees: are they in radians?")
    if content.hammer:
        _check_hammer(path, content.hammer)
    log, source = _trajectory(path, trajectory if trajectory is not None else content.replay)
    cut = None if content.cut is None else read_cut(content.cut, path, path.parent)
    described = robot if isinstance(robot, Robot) else loaded.path
    inputs = [item for item in (*inputs, described, source) if item is not None]
    return PostureFile(
        loaded, content.posture.name, q, list(content.posture.q_deg), content.posture.brakes, content.hammer, log,
        cut, inputs,
    )  # fmt: skip


def _like_radians(robot: Robot, q_deg: Sequence[float]) -> bool:
    """Whether angles look like radians: several of them, none above π, and not whole degrees."""
    angles = [abs(v) for v, axis in zip(q_deg, robot.axes, strict=True) if axis.type == "revolute" and v]
    return len(angles) > 1 and max(angles) < 3.2 and any(v != round(v) for v in angles)


def _check_hammer(path: Path, hammer: Hammer) -> None:
    lines = 1 / hammer.pulse_s
    if hammer.sample_rate_hz < 4 * lines:
        raise InputError(
            path, "hammer.sample_rate_hz", f"a pulse of {hammer.pulse_s:g} s needs at least {4 * lines:g} Hz"
        )
    if hammer.duration_s is None:
        return
    if hammer.duration_s * hammer.sample_rate_hz > LONGEST_RECORD:
        raise InputError(path, "hammer.duration_s", f"expected at most {LONGEST_RECORD:.0e} samples in a record")
    if hammer.duration_s < LEAST_PULSES * hammer.pulse_s:
        raise InputError(path, "hammer.duration_s", "expected a record much longer than the pulse")


def _trajectory(path: Path, given: MotionLog | str | Path | None) -> tuple[MotionLog | None, Any]:
    """What is replayed, and its file or itself; a relative path is looked up beside the posture file first."""
    if given is None or isinstance(given, MotionLog):
        return given, given
    found = next((p for p in (path.parent / given, Path(given)) if p.is_file()), None)
    if found is None:
        raise InputError(path, "replay", f"{given}: no such file")
    return read_motion_log(found), found
