"""``map.yaml``: which channel of a foreign file becomes what, in which unit. Its fields, checked."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from twin.errors import InputError
from twin.measure.campaign import LABEL, Brakes
from twin.measure.units import ASK
from twin.robot.description import Data, Number, Positive, Vector, first_problem
from twin.yamlfile import read_yaml


class Taken(Data):
    """Channels of one quantity, a list of names or one pattern with ``*``; ``factor`` is applied before the unit."""

    channels: str | list[str]
    unit: str = ASK
    factor: Number | list[Number] = 1.0


class LogMap(Data):
    """A motion log. Every table of every file is a run; ``sample_rate_hz`` serves where there is no clock."""

    makes: Literal["motion-log"]
    robot: str | None = None
    time: Taken | None = None
    sample_rate_hz: Positive | None = None
    position: Taken
    torque: Taken
    velocity: Taken | None = None
    acceleration: Taken | None = None
    link_position: Taken | None = None


class Point(Data):
    """A node on the robot: the body it is fixed to and its place in that body's frame, m."""

    body: str = "base"
    position: Vector = (0.0, 0.0, 0.0)


class Sensor(Point):
    """A response channel; ``channel`` is its name in the file. Universal files know their channels by label."""

    label: Annotated[str, Field(pattern=LABEL)]
    channel: str
    unit: str = ASK
    factor: Number = 1.0


class Struck(Point):
    """A hammer point; ``files`` are patterns for the tables that hold its blows, one or several per table."""

    label: Annotated[str, Field(pattern=LABEL)]
    files: str | list[str] = "*"


class Stance(Data):
    """A posture: degrees (m), and patterns for its tables."""

    q_deg: tuple[Number, ...] = ()
    brakes: Brakes | None = None
    files: str | list[str] = "*"


class HitsMap(Data):
    """A hammer test from time records: blows are found in the force, cut out and made FRFs of."""

    makes: Literal["frf-campaign"]
    robot: str | None = None
    postures: dict[str, Stance]
    force: Taken
    response: Annotated[list[Sensor], Field(min_length=1)]
    excitation: Annotated[list[Struck], Field(min_length=1)]
    sample_rate_hz: Positive | None = None
    trigger_n: Positive = 20.0
    pretrigger_s: Annotated[Number, Field(ge=0)] = 0.05
    record_s: Positive
    exponential_window_rate: Annotated[Number, Field(ge=0)] | None = None
    band_hz: tuple[Number, Positive] | None = None


class FunctionsMap(Data):
    """A hammer test from FRFs as arrays (nf, nr, ne): one file or table per posture."""

    makes: Literal["frf-campaign"]
    robot: str | None = None
    postures: dict[str, Stance]
    frequency: Taken
    frf: Taken
    coherence: str | None = None
    averages: Annotated[int, Field(ge=1)] | None = None
    exponential_window_rate: Annotated[Number, Field(ge=0)] = 0.0
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


class UniversalMap(Data):
    """A hammer test from universal files: what data set 58 has no field for."""

    makes: Literal["frf-campaign"]
    robot: str | None = None
    postures: dict[str, Stance]
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
