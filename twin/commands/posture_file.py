"""``posture.yaml``: which robot, in which posture, how it is hit, what it replays."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from twin.errors import InputError
from twin.robot.description import Data, NonNegative, Number, Positive, Robot, first_problem, load_robot
from twin.yamlfile import read_yaml

LONGEST_RECORD = 2e6  # samples


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _none_if_false(value: Any) -> Any:
    return {} if value is None else None if value is False else value


class Hammer(Data):
    """How the robot is hit; several ``force_n`` are several force levels. Noise is off unless asked for."""

    force_n: Annotated[list[Positive], BeforeValidator(_as_list), Field(min_length=1)] = Field(default=[300.0])
    pulse_s: Positive = 0.008
    duration_s: Positive = 16.0
    sample_rate_hz: Positive = 2048.0
    hits: Annotated[int, Field(ge=1, strict=True)] = 3
    force_spread: NonNegative = 0.0
    force_noise_n: NonNegative = 0.0
    response_noise: NonNegative = 0.0
    off_axis_deg: NonNegative = 0.0
    raw_hits: Annotated[bool, Field(strict=True)] = False

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len({f"{level:g}" for level in self.force_n}) < len(self.force_n):
            raise ValueError(f"force_n: expected different levels, found {self.force_n}")
        return self


class _Posture(Data):
    name: Annotated[str, Field(pattern=r"^[^/\\\x00]*[^/\\\x00.][^/\\\x00]*$", max_length=100)] = "posture"
    q_deg: list[Number]
    brakes: Literal["on", "off"] = "on"


class _File(Data):
    robot: str | None = None
    posture: _Posture
    hammer: Annotated[Hammer | None, BeforeValidator(_none_if_false)] = Hammer()
    replay: str | None = None


@dataclass(frozen=True)
class PostureFile:
    """The content of a posture file, robot loaded, units as the model takes them.

    Attributes:
        robot: description, removals applied.
        q: (n,) joint positions, rad (m); ``q_deg`` as the user wrote them.
        hammer: how it is hit, or ``None`` for modes only.
        replay: path of a trajectory or motion log to replay.
        inputs: the files that were read.
    """

    robot: Robot
    name: str
    q: np.ndarray
    q_deg: list[float]
    brakes: Literal["on", "off"]
    hammer: Hammer | None
    replay: Path | None
    inputs: list[Path]


def read_posture_file(path: str | Path, robot: str | None = None, without: list[str] | None = None) -> PostureFile:
    """Read and check a posture file.

    Args:
        path: the file.
        robot: wins over the robot named in the file, which wins over ``kr90``.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.

    Raises:
        InputError: one line that names the file, the field and what was expected.
    """
    path = Path(path)
    data: dict[str, Any] = read_yaml(path)
    try:
        content = _File.model_validate(data)
    except ValidationError as error:
        where, message = first_problem(error)
        raise InputError(path, where, message) from error
    loaded = load_robot(robot) if robot else load_robot(content.robot or "kr90", relative_to=path.parent)
    loaded = loaded.without(without or [])
    if len(content.posture.q_deg) != loaded.axis_count:
        raise InputError(
            path, "posture.q_deg",
            f"expected {loaded.axis_count} values for robot {loaded.name}, found {len(content.posture.q_deg)}",
        )  # fmt: skip
    q = loaded.check_posture(loaded.angles(content.posture.q_deg), str(path), "posture.q_deg")
    replay = None
    if content.replay is not None:
        replay = next((p for p in (path.parent / content.replay, Path(content.replay)) if p.is_file()), None)
        if replay is None:
            raise InputError(path, "replay", f"{content.replay}: no such file")
    if content.hammer:
        lines = 1 / content.hammer.pulse_s
        if content.hammer.sample_rate_hz < 4 * lines:
            raise InputError(
                path,
                "hammer.sample_rate_hz",
                f"a pulse of {content.hammer.pulse_s:g} s needs at least {4 * lines:g} Hz",
            )
        if content.hammer.duration_s * content.hammer.sample_rate_hz > LONGEST_RECORD:
            raise InputError(path, "hammer.duration_s", f"expected at most {LONGEST_RECORD:.0e} samples in a record")
        if content.hammer.duration_s < 4 * content.hammer.pulse_s:
            raise InputError(path, "hammer.duration_s", "expected a record much longer than the pulse")
    inputs = [path, *([loaded.path] if loaded.path else []), *([replay] if replay else [])]
    return PostureFile(
        loaded, content.posture.name, q, list(content.posture.q_deg), content.posture.brakes, content.hammer, replay,
        inputs,
    )  # fmt: skip
