"""``map.yaml``: which channel of a foreign file becomes what, in which unit. Its fields, checked."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, model_validator

from twin.errors import InputError
from twin.measure.campaign import (
    FASTEST_SAMPLES_HZ,
    LABEL,
    LONGEST_PULSE_S,
    LONGEST_RECORD_S,
    MOST_AVERAGES,
    Brakes,
    PostureFRF,
)
from twin.measure.units import ASK
from twin.ranges import FASTEST_HZ, FREE_TURNS, LARGEST_FORCE_N, LEAST_FORCE_N, RANGES
from twin.robot.description import Data, Number, Position, first_problem
from twin.yamlfile import read_yaml


def _not_zero(value: float) -> float:
    if not 1e-12 <= abs(value) <= 1e12:
        raise ValueError(f"expected a factor of magnitude 1e-12 to 1e12, found {value:g}")
    return value


Factor = Annotated[Number, AfterValidator(_not_zero)]
Degrees = Annotated[Number, Field(ge=-360 * FREE_TURNS, le=360 * FREE_TURNS)]
Frequency = Annotated[Number, Field(ge=0, le=FASTEST_HZ)]
WindowRate = Annotated[Number, Field(ge=0, le=RANGES["1/s"][1])]
Rate = Annotated[Number, Field(ge=1e-3, le=FASTEST_SAMPLES_HZ)]


class Taken(Data):
    """Channels of one quantity, a list of names or one pattern with ``*``.

    ``factor``, then ``offset``, which is added, are applied before the unit. Rows of numbers are a matrix, axes by
    channels: of drives that turn with one another. ``unit`` is one word, or one per axis: hinges turn, slides move.
    """

    channels: str | list[str]
    unit: str | list[str] = ASK
    factor: Factor | list[Factor] | list[list[Number]] = 1.0
    offset: Number | list[Number] = 0.0

    @property
    def first_unit(self) -> str:
        """Of the first axis, where each has its own."""
        return self.unit if isinstance(self.unit, str) else next(iter(self.unit), ASK)


class LogMap(Data):
    """A motion log. Every table of every file is a run; ``sample_rate_hz`` serves where there is no clock.

    ``runs``: patterns for the tables of each run, where several files hold one run.
    """

    makes: Literal["motion-log"]
    robot: str | None = None
    runs: Annotated[dict[str, str | list[str]], Field(min_length=1)] | None = None
    time: Taken | None = None
    sample_rate_hz: Rate | None = None
    position: Taken
    torque: Taken
    velocity: Taken | None = None
    acceleration: Taken | None = None
    link_position: Taken | None = None


class Point(Data):
    """A node on the robot: the body it is fixed to and its place in that body's frame, m."""

    body: str = "base"
    position: Position = (0.0, 0.0, 0.0)


class Sensor(Point):
    """A response channel; ``channel`` is its name in the file. Universal files know their channels by label."""

    label: Annotated[str, Field(pattern=LABEL)]
    channel: str
    unit: str = ASK
    factor: Factor = 1.0


class Struck(Point):
    """A hammer point; ``files`` are patterns for the tables that hold its blows, one or several per table."""

    label: Annotated[str, Field(pattern=LABEL)]
    files: str | list[str] = "*"


class Stance(Data):
    """A posture: degrees (m), and patterns for its tables."""

    q_deg: tuple[Degrees, ...] = ()
    brakes: Brakes | None = None
    files: str | list[str] = "*"


class HitsMap(Data):
    """A hammer test from time records: blows are found in the force, cut out and made FRFs of.

    ``time`` is the file's clock. One whose unit the file states is found without; ``sample_rate_hz`` must agree.
    """

    makes: Literal["frf-campaign"]
    robot: str | None = None
    postures: dict[str, Stance]
    force: Taken
    response: Annotated[list[Sensor], Field(min_length=1)]
    excitation: Annotated[list[Struck], Field(min_length=1)]
    time: Taken | None = None
    sample_rate_hz: Rate | None = None
    trigger_n: Annotated[Number, Field(ge=LEAST_FORCE_N, le=LARGEST_FORCE_N)] = 20.0
    pretrigger_s: Annotated[Number, Field(ge=0, le=LONGEST_RECORD_S)] = 0.05
    record_s: Annotated[Number, Field(gt=0, le=LONGEST_RECORD_S)]
    exponential_window_rate: WindowRate | None = None
    band_hz: tuple[Frequency, Frequency] | None = None


class Level(Stance):
    """A posture and the peak force (N) of its blows. One posture at two forces is two entries of the same ``q_deg``."""

    peak_force_n: Annotated[Number, Field(ge=LEAST_FORCE_N, le=LARGEST_FORCE_N)] | None = None


class Averaged(Data):
    """What FRFs do not say of the blows they are of, where the file does not.

    Blows of a coherence, the exponential window that is still in the FRFs (1/s), length of pulse and record (s).
    """

    makes: Literal["frf-campaign"]
    robot: str | None = None
    postures: dict[str, Level]
    averages: Annotated[int, Field(ge=1, le=MOST_AVERAGES)] | None = None
    exponential_window_rate: WindowRate | None = None
    pulse_s: Annotated[Number, Field(gt=0, le=LONGEST_PULSE_S)] | None = None
    record_s: Annotated[Number, Field(gt=0, le=LONGEST_RECORD_S)] | None = None

    def said_of(self, name: str, read: PostureFRF) -> PostureFRF:
        """A posture as read, and what the map says where the file does not."""
        level = self.postures[name]
        return replace(
            read, name=name, brakes=level.brakes,
            averages=self.averages if read.averages is None else read.averages,
            exponential_window_rate=read.exponential_window_rate or self.exponential_window_rate or 0.0,
            pulse_s=self.pulse_s if read.pulse_s is None else read.pulse_s,
            record_s=self.record_s if read.record_s is None else read.record_s,
            peak_force_n=level.peak_force_n if read.peak_force_n is None else read.peak_force_n,
        )  # fmt: skip


class FunctionsMap(Averaged):
    """A hammer test from FRFs as arrays (nf, nr, ne): one file or table per posture."""

    frequency: Taken
    frf: Taken
    coherence: str | None = None
    response: Annotated[list[Sensor], Field(min_length=1)]
    excitation: Annotated[list[Struck], Field(min_length=1)]

    @model_validator(mode="before")
    @classmethod
    def _unheard(cls, data: Any) -> Any:
        """Responses of an array have no channel of their own."""
        if isinstance(data, dict) and isinstance(data.get("response"), list):
            sensors = [{"channel": "", **s} if isinstance(s, dict) else s for s in data["response"]]
            return {**data, "response": sensors}
        return data


class UniversalMap(Averaged):
    """A hammer test from universal files: what data set 58 has no field for."""

    nodes: Annotated[dict[int, Point], Field(default_factory=dict)]
    unit: str = ASK

    @model_validator(mode="after")
    def _one(self) -> Self:
        if not self.postures:
            raise ValueError("postures: expected at least one")
        return self


Map = LogMap | HitsMap | FunctionsMap | UniversalMap


def read_map(path: Path, universal: bool) -> Map:
    """Read ``map.yaml``.

    Args:
        path: of the map.
        universal: it is for universal files.

    Raises:
        InputError: one line that names the field.
    """
    data = read_yaml(path)
    kind: type[Map]
    if data.get("makes") == "motion-log":
        kind = LogMap
    elif data.get("makes") == "frf-campaign":
        kind = UniversalMap if universal else FunctionsMap if "frf" in data else HitsMap
    else:
        raise InputError(path, "makes", f"expected motion-log or frf-campaign, found {data.get('makes')!r}")
    try:
        found: Map = TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        raise InputError(path, *first_problem(error)) from error
    return found
