"""The cut as data: tool, cutting coefficients, immersion, feed, spindle speeds; read from YAML, checked for units."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, field_validator, model_validator

from twin.errors import InputError, tell
from twin.physics.payload import Payload
from twin.ranges import FARTHEST_TIP_M, FASTEST_HZ, FASTEST_RPM, HEAVIEST_TOOL_KG, SLOWEST_RPM
from twin.robot.description import (
    Data,
    Distance,
    Entry,
    NonNegative,
    Number,
    Place,
    Position,
    Positive,
    Robot,
    Vector,
    first_problem,
)
from twin.robot.frames import matrix_of
from twin.yamlfile import read_yaml

# Plausible magnitudes: from plastic foam to nickel alloys. The same numbers in N/mm² or N/mm lie below them.
SHEAR_RANGE = (5e6, 2e10)  # N/m²
EDGE_RANGE = (200.0, 1e6)  # N/m
FLANK_RANGE = (5e3, 1e8)  # N/m, of process damping
PUBLISHED_PERCENT = 15.0  # by which published shear coefficients differ: the least that ``coefficients.yaml`` states


class ToolMode(Data):
    """A mode of tool and spindle with the flange clamped, along the first (x) or second (y) direction across the axis.

    The first direction is the feed's.
    """

    frequency_hz: Annotated[Number, Field(ge=1, le=FASTEST_HZ)]
    damping_percent: Annotated[Number, Field(gt=0, lt=100)]
    stiffness_n_per_m: Annotated[Number, Field(ge=1e4, le=1e12)]
    direction: Literal["x", "y"]


class Tool(Data):
    """Geometry and mass of the tool. Lengths in m.

    Attributes:
        overhang_m: from the flange to the tip, along ``direction``.
        direction: unit vector flange → tip in the flange frame; left out: the flange's axis nearest to the line
            from the last joint to the flange.
        tip_m: place of the tip in the flange frame, where it is not on that line; wins over the overhang.
        mass_kg, com_m: of spindle and tool together, centre of mass at that distance from the flange towards the tip.
        modes: of the tool on a clamped flange, beyond the robot's.
        frf: a hammer test (``frf-campaign``) of the tip with the flange clamped, instead of ``modes``.
    """

    diameter_m: Annotated[Number, Field(ge=1e-4)] = 0.016
    teeth: Annotated[int, Field(ge=1, le=100, strict=True)] = 2
    helix_deg: Annotated[Number, Field(ge=0, le=75)] = 0.0
    runout_m: Annotated[Number, Field(ge=0, le=1e-3)] = 0.0
    overhang_m: NonNegative = 0.2
    direction: Vector | None = None
    tip_m: Position | None = None
    mass_kg: Annotated[Number, Field(ge=0, le=HEAVIEST_TOOL_KG)] = 0.0
    com_m: Distance | None = None
    modes: tuple[ToolMode, ...] = ()
    frf: str | None = None

    @field_validator("diameter_m", "overhang_m")
    @classmethod
    def _metres(cls, value: float) -> float:
        if value > 2.0:
            raise ValueError(f"expected metres, found {value:g}; is it in mm?")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.diameter_m > 0.5:
            raise ValueError(f"diameter_m: expected metres, found {self.diameter_m:g}; is it in mm?")
        if self.direction is not None and abs(np.linalg.norm(self.direction) - 1) > 1e-3:
            raise ValueError(f"direction: expected a unit vector, its length is {np.linalg.norm(self.direction):.4g}")
        away = float(np.linalg.norm(self.tip_m)) if self.tip_m is not None else self.overhang_m
        if self.tip_m is not None and away > FARTHEST_TIP_M:
            raise ValueError(f"tip_m: expected metres, up to {FARTHEST_TIP_M:g} from the flange; are they in mm?")
        if self.com_m is not None and self.com_m > away:
            raise ValueError(
                f"com_m: expected no more than from the flange to the tip ({away:g} m), found {self.com_m:g}"
            )
        if self.modes and self.frf:
            raise ValueError("frf: give modes or frf, not both")
        return self

    def axis(self, robot: Robot) -> np.ndarray:
        """Unit vector flange → tip (3,) along the tool's axis, in the frame of the last link."""
        flange = matrix_of(np.array(robot.flange.quaternion))
        if self.direction is not None:
            return flange @ (np.array(self.direction) / np.linalg.norm(self.direction))
        line = np.array(robot.flange.position)
        if np.linalg.norm(line) < 1e-9:
            return flange[:, 2]
        along = flange.T @ line
        nearest = int(np.argmax(np.abs(along)))
        return flange[:, nearest] * np.sign(along[nearest])

    def tip(self, robot: Robot) -> np.ndarray:
        """Place of the tip (3,) m in the frame of the last link."""
        reach = self.overhang_m * self.axis(robot)
        if self.tip_m is not None:
            reach = matrix_of(np.array(robot.flange.quaternion)) @ np.array(self.tip_m)
        return np.array(robot.flange.position) + reach

    def payload(self, robot: Robot) -> Entry | None:
        """Spindle and tool as a physics entry at the flange, or ``None`` without mass."""
        if not self.mass_kg:
            return None
        flange = np.array(robot.flange.position)
        reach = self.tip(robot) - flange
        length = float(np.linalg.norm(reach))
        share = 0.5 if self.com_m is None or not length else self.com_m / length
        com = [float(value) for value in flange + share * reach]
        return Entry.model_validate({"effect": Payload.name, "site": "flange", "mass": self.mass_kg, "com": com})


class Coefficients(Data):
    """Cutting coefficients: shear (force per chip area) and edge (force per length of edge).

    Attributes:
        kt_n_per_m2, kr_n_per_m2, ka_n_per_m2: tangential, radial (away from the work), axial (tip → spindle), N/m².
        kte_n_per_m, kre_n_per_m, kae_n_per_m: the same of the edge, N/m.
        process_damping_n_per_m: force of the flank against motion into the work, N/m. It is per depth and per ratio of
            that motion's speed to the cutting speed. ``process_friction``: tangential over radial part of it.
        deviation_percent: standard deviation of each shear coefficient; edge coefficients do not move the limit.
            Published ones' where it is not stated.
        source: where they come from.
    """

    kt_n_per_m2: Number
    kr_n_per_m2: Number
    ka_n_per_m2: Number = 0.0
    kte_n_per_m: Number = 0.0
    kre_n_per_m: Number = 0.0
    kae_n_per_m: Number = 0.0
    process_damping_n_per_m: NonNegative = 0.0
    process_friction: Annotated[Number, Field(ge=0, le=1)] = 0.0
    deviation_percent: Annotated[Number, Field(ge=0, le=100)] = PUBLISHED_PERCENT
    source: str = ""

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if self.kt_n_per_m2 <= 0:
            raise ValueError(f"kt_n_per_m2: expected a positive number, found {self.kt_n_per_m2:g}")
        for kind, (low, high), unit, wrong, factor in (
            ("_n_per_m2", SHEAR_RANGE, "N/m²", "N/mm²", "1e6"),
            ("e_n_per_m", EDGE_RANGE, "N/m", "N/mm", "1e3"),
            ("damping_n_per_m", FLANK_RANGE, "N/m", "N/mm", "1e3"),
        ):
            for name in (field for field in type(self).model_fields if field.endswith(kind)):
                value = abs(getattr(self, name))
                floor = low / 10 if name[:2] in ("kr", "ka") else low
                if value and not floor <= value <= high:
                    hint = f"; if it is in {wrong}, multiply it by {factor}" if value < floor else ""
                    raise ValueError(f"{name}: expected {unit}, plausibly {floor:g} to {high:g}, found {value:g}{hint}")
        return self

    @property
    def shear(self) -> np.ndarray:
        """(kt, kr, ka), N/m²."""
        return np.array([self.kt_n_per_m2, self.kr_n_per_m2, self.ka_n_per_m2])

    @property
    def edge(self) -> np.ndarray:
        """(kte, kre, kae), N/m."""
        return np.array([self.kte_n_per_m, self.kre_n_per_m, self.kae_n_per_m])

    @property
    def flank(self) -> np.ndarray:
        """Process damping (tangential, radial, axial), N/m."""
        return self.process_damping_n_per_m * np.array([self.process_friction, 1.0, 0.0])

    def draw(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Shear coefficients (count, 3) N/m², each log-normal about its value with the stated deviation."""
        deviation = np.sqrt(np.log1p((self.deviation_percent / 100) ** 2))
        return self.shear * np.exp(deviation * rng.standard_normal((count, 3)))


@cache
def published_coefficients() -> dict[str, Coefficients]:
    """The shipped table of published coefficients, by name."""
    path = Path(__file__).with_name("coefficients.yaml")
    return {name: Coefficients.model_validate(values) for name, values in read_yaml(path).items()}


def _by_name(value: Any) -> Any:
    if isinstance(value, str):
        table = published_coefficients()
        if value not in table:
            raise ValueError(f"no published coefficients {value!r}; give numbers or one of: {', '.join(sorted(table))}")
        return table[value]
    return value


class Cut(Data):
    """What is cut, how.

    Attributes:
        immersion: radial depth of cut over the tool's diameter, 1e-4 to 1.
        milling: ``up`` (conventional) or ``down`` (climb).
        feed_per_tooth_m: advance of the tool from tooth to tooth, m.
        feed_direction: of the tool against the work, in the robot's base frame; made perpendicular to the tool's axis.
        spindle_rpm: lowest and highest spindle speed of interest.
        depth_max_m: deepest axial depth of interest.
        table_z_m: height of the table in the base frame, which the tip must be above; ``None`` for no table.
    """

    tool: Tool = Tool()
    coefficients: Annotated[Coefficients, BeforeValidator(_by_name)] = Field(
        default="aluminium_7075", validate_default=True
    )
    immersion: Annotated[Number, Field(ge=1e-4, le=1)] = 0.5
    milling: Literal["up", "down"] = "down"
    feed_per_tooth_m: Annotated[Number, Field(ge=1e-8, le=5e-3)] = 1e-4
    feed_direction: Vector = (1.0, 0.0, 0.0)
    spindle_rpm: tuple[Positive, Positive] = (1000.0, 12000.0)
    depth_max_m: Annotated[Number, Field(ge=1e-6, le=1.0)] = 0.01
    table_z_m: Place | None = 0.0
    _source: str = PrivateAttr("cut")
    _folder: Path | None = PrivateAttr(None)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        low, high = self.spindle_rpm
        if low >= high:
            raise ValueError(f"spindle_rpm: expected a lowest and a highest speed, found {[low, high]}")
        if low < SLOWEST_RPM or high > FASTEST_RPM:
            expected = f"expected {SLOWEST_RPM:g} to {FASTEST_RPM:g} rpm, found {[low, high]}"
            raise ValueError(f"spindle_rpm: {expected}; is it in revolutions per second?")
        if np.linalg.norm(self.feed_direction) < 1e-9:
            raise ValueError("feed_direction: expected a direction, found a zero vector")
        return self

    @property
    def source(self) -> str:
        """The file that it was read from, for messages."""
        return self._source

    @property
    def folder(self) -> Path | None:
        """The folder that relative paths are looked up in."""
        return self._folder

    @property
    def arc(self) -> tuple[float, float]:
        """Angles at which a tooth enters and leaves the work, rad, from the side where the chip begins at zero.

        Up milling leaves at arccos(1 − 2 aD), aD the immersion; down milling enters at π minus that.
        """
        swept = float(np.arccos(1 - 2 * self.immersion))
        return (0.0, swept) if self.milling == "up" else (np.pi - swept, np.pi)

    def tooth_period(self, spindle_rpm: Any) -> Any:
        """Time between two teeth, s."""
        return 60.0 / (np.asarray(spindle_rpm, float) * self.tool.teeth)

    def flank(self, tooth_period: Any) -> np.ndarray:
        """Process damping (…, 3) tangential, radial, axial, N·s/m² at tooth periods (…) s: over the cutting speed."""
        speed = np.pi * self.tool.diameter_m / (np.asarray(tooth_period, float) * self.tool.teeth)
        return self.coefficients.flank / speed[..., None]

    def without_process_damping(self) -> "Cut":
        """The same cut with sharp teeth."""
        return self.model_copy(
            update={"coefficients": self.coefficients.model_copy(update={"process_damping_n_per_m": 0.0})}
        )

    def frame(self, axis: np.ndarray, feed: np.ndarray | None = None) -> np.ndarray:
        """The cut frame in the base frame for tool axes (…, 3) flange → tip, see :func:`cut_frame`.

        Raises:
            InputError: the feed is along the tool's axis.
        """
        feed = np.asarray(self.feed_direction if feed is None else feed, float)
        across = feed - np.sum(feed * axis, -1, keepdims=True) * axis
        if np.any(np.linalg.norm(across, axis=-1) < 1e-6 * np.linalg.norm(feed, axis=-1)):
            raise InputError(self.source, "feed_direction", "is along the tool's axis; a tool mills across it")
        return cut_frame(-np.asarray(axis), feed)


def cut_frame(axis: np.ndarray, feed: np.ndarray) -> np.ndarray:
    """Rotations (…, 3, 3) base → cut frame, whose rows are feed, normal and axis.

    Args:
        axis: (…, 3) unit vector from the tip to the spindle.
        feed: (…, 3) direction in which the tool moves against the work; its part across the axis counts.
    """
    z = np.asarray(axis, float)
    x = feed - np.sum(feed * z, -1, keepdims=True) * z
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    z = np.broadcast_to(z, x.shape)
    return np.stack([x, np.cross(z, x), z], axis=-2)


def read_cut(content: Mapping[str, Any] | str | Path, source: str | Path = "cut", folder: Path | None = None) -> Cut:
    """A cut from a file ``cut.yaml`` (with or without a top key ``cut``), or from the mapping of a posture file.

    Args:
        content: mapping, or path of a file.
        source: file that a mapping comes from, for messages.
        folder: that relative paths are looked up in.

    Raises:
        InputError: one line that names the file, the field and what was expected.
    """
    field = "cut"
    if isinstance(content, str | Path):
        path = Path(content)
        if folder is not None and not path.is_absolute() and (folder / path).is_file():
            path = folder / path
        data = read_yaml(path)
        source, folder = path, path.parent
        content = data["cut"] if isinstance(data.get("cut"), Mapping) else data
        field = "cut" if content is not data else ""
        if "axes" in data and "links" in data:
            raise InputError(path, "", "is a robot, not a cut: give it as --robot")
        if "posture" in data and content is data:
            raise InputError(path, "cut", "missing: this is a posture file, and none is cut there")
    try:
        cut = Cut.model_validate(content)
    except ValidationError as error:
        where, message = first_problem(error)
        raise InputError(source, ".".join(part for part in (field, where) if part), message) from error
    cut._source, cut._folder = str(source), folder
    missing = [f"{name} {value}" for name, value in _usual(cut) if not _given(content, name)]
    if missing:
        tell(source, field, f"does not state all; usual values are taken: {', '.join(missing)}")
    return cut


def _usual(cut: Cut) -> list[tuple[str, str]]:
    """What decides a cut, with its value."""
    known = published_coefficients().items()
    name = next((name for name, values in known if values == cut.coefficients), "")
    found = [("coefficients", name), ("immersion", f"{cut.immersion:g}"), ("milling", cut.milling)]
    found += [("coefficients.deviation_percent", f"{cut.coefficients.deviation_percent:g}")]
    found += [("tool.diameter_m", f"{cut.tool.diameter_m:g}"), ("tool.teeth", f"{cut.tool.teeth}")]
    return found + ([] if cut.tool.tip_m is not None else [("tool.overhang_m", f"{cut.tool.overhang_m:g}")])


def _given(content: Mapping[str, Any], name: str) -> bool:
    """Whether a mapping holds a field, as ``tool.teeth``."""
    first, _, rest = name.partition(".")
    if first not in content or not rest:
        return first in content
    return not isinstance(content[first], Mapping) or _given(content[first], rest)
