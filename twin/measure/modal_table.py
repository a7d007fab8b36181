"""The modal table: frequencies, dampings and, where known, shapes per posture, as YAML 1.2."""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from twin.errors import InputError, tell
from twin.files import writing
from twin.measure.campaign import LABEL, Channels, FloatArray, check_channels, check_q_deg
from twin.measure.modal import ModalResult
from twin.ranges import FASTEST_HZ, LONGEST_LABEL, ill_named, implausible
from twin.yamlfile import read_yaml

LEAST_PERCENT = 0.05  # a bare steel bar has more
LEAP = 100.0  # between neighbours in a table
LARGEST_SHAPE = 1e12  # of any scaling, to unit modal mass in m/√kg or to unit displacement
CRITICAL = 100.0  # per cent: what is damped more does not oscillate and has no frequency


@dataclass(frozen=True)
class TableMode:
    """One mode; ``None`` and an empty shape where the table does not say."""

    frequency_hz: float
    damping_percent: float | None = None
    frequency_std_hz: float | None = None
    damping_std_percent: float | None = None
    shape: dict[str, complex] = field(default_factory=dict)


@dataclass(frozen=True)
class TablePosture:
    """Axis positions (degrees, metres for prismatic axes; none for what is no robot) and the modes there."""

    q_deg: FloatArray
    modes: tuple[TableMode, ...]


@dataclass(frozen=True)
class ModalTable:
    """Modes of one robot by posture.

    Attributes:
        robot: name or path.
        points: where the labels of the shapes are, if the table says so.
        source: for messages.
    """

    postures: dict[str, TablePosture]
    robot: str | None = None
    points: Channels | None = None
    source: str = "modal table"

    def __repr__(self) -> str:
        """One line per posture."""
        head = f"modal table {self.source}{f' of {self.robot}' if self.robot else ''}: {len(self.postures)} postures"
        told = (
            f"{name}: {', '.join(f'{m.frequency_hz:.4g}' for m in p.modes)} Hz" for name, p in self.postures.items()
        )
        return "\n  ".join([head, *told])

    @classmethod
    def of(
        cls, results: Mapping[str, ModalResult], robot: str | None = None, points: Channels | None = None
    ) -> "ModalTable":
        """The table of identified modes; ``points`` are those of the test, of which it keeps those in the shapes."""
        postures = {}
        for name, result in results.items():
            modes = tuple(
                TableMode(
                    mode.frequency_hz,
                    mode.damping_percent,
                    mode.frequency_std_hz,
                    mode.damping_std_percent,
                    {k: complex(v) for k, v in zip(result.shape_label, shape, strict=bool(result.shape_label))},
                )
                for mode, shape in zip(result.modes, result.shapes, strict=True)
            )
            postures[name] = TablePosture(result.q_deg, modes)
        labels = {label for result in results.values() if result.modes for label in result.shape_label}
        if points is not None:
            points = points.only([k for k, label in enumerate(points.label) if label in labels])
        return cls(postures, robot, points if points and points.label else None)


def read_modal_table(path: str | Path) -> ModalTable:
    """Read and check a modal table; :class:`InputError` says what it lacks."""
    path = Path(path)
    content = read_yaml(path)
    _tell_unknown(path, "", content, ("robot", "points", "postures"))
    if not isinstance(content.get("postures"), dict) or not content["postures"]:
        kinds = {"links": "a robot description", "posture": "a posture file", "coefficients": "a cut"}
        kind = next((f", found {what}" for key, what in kinds.items() if key in content), "")
        raise InputError(path, "postures", f"expected a mapping of posture names to q_deg and modes{kind}")
    for name in content["postures"]:
        if problem := ill_named(str(name)):
            raise InputError(path, "postures", problem)
    robot = content.get("robot")
    if robot is not None and not isinstance(robot, str):
        raise InputError(path, "robot", f"expected a name or a path, found {reprlib.repr(robot)}")
    return ModalTable(
        {str(name): _read_posture(path, f"postures.{name}", value) for name, value in content["postures"].items()},
        robot,
        _read_points(path, content["points"]) if content.get("points") is not None else None,
        str(path),
    )


def _read_points(path: Path, value: Any) -> Channels:
    """Where the labels of shapes are."""
    if not isinstance(value, dict) or not value:
        raise InputError(path, "points", "expected a mapping of labels to body, position and direction")
    for label, point in value.items():
        where = f"points.{label}"
        if not isinstance(point, dict):
            raise InputError(path, where, f"expected body, position and direction, found {reprlib.repr(point)}")
        _refuse_unknown(path, where, point, ("body", "position", "direction"))
        if not isinstance(point.get("body"), str):
            raise InputError(path, f"{where}.body", f"expected a body's name, found {reprlib.repr(point.get('body'))}")
        for name in ("position", "direction"):
            xyz = point.get(name)
            if not (isinstance(xyz, list) and len(xyz) == 3 and all(_is_number(x) for x in xyz)):
                raise InputError(path, f"{where}.{name}", f"expected three numbers, found {reprlib.repr(xyz)}")
    places, ways = (np.array([point[name] for point in value.values()], float) for name in ("position", "direction"))
    channels = Channels(tuple(map(str, value)), tuple(p["body"] for p in value.values()), places, ways)
    check_channels(path, "points", channels)
    return channels


def _read_posture(path: Path, where: str, value: Any) -> TablePosture:
    if not isinstance(value, dict):
        raise InputError(path, where, "expected q_deg and modes")
    _tell_unknown(path, where, value, ("q_deg", "modes"))
    q = value.get("q_deg")
    if not isinstance(q, list) or not all(_is_number(x) for x in q):
        raise InputError(path, f"{where}.q_deg", f"expected a list of numbers, found {reprlib.repr(q)}")
    check_q_deg(path, where, np.array(q, dtype=np.float64))
    modes = value.get("modes")
    if not isinstance(modes, list):
        raise InputError(path, f"{where}.modes", f"expected a list of modes, found {reprlib.repr(modes)}")
    read = tuple(_read_mode(path, f"{where}.modes[{n}]", mode) for n, mode in enumerate(modes))
    told = [(mode.frequency_hz, mode.damping_percent, mode.shape) for mode in read]
    if again := next((n for n, mode in enumerate(told) if mode in told[:n]), None):
        raise InputError(path, f"{where}.modes[{again}]", "expected every mode once, it is there twice")
    _tell_a_leap(path, where, [mode.frequency_hz for mode in read])
    return TablePosture(np.array(q, dtype=np.float64), read)


def _tell_unknown(path: Path, where: str, value: dict[Any, Any], known: Sequence[str]) -> None:
    """Tell of fields beside the table, such as a comment; a number of a mode that is not read is refused."""
    if strange := [key for key in value if key not in known]:
        tell(path, where, f"field {reprlib.repr(strange[0])} is not read; known are {', '.join(known)}")


def _refuse_unknown(path: Path, where: str, value: dict[Any, Any], known: Sequence[str]) -> None:
    if strange := [key for key in value if key not in known]:
        name = strange[0] if isinstance(strange[0], str) and strange[0].isidentifier() else reprlib.repr(strange[0])
        raise InputError(path, f"{where}.{name}", f"no such field; expected {', '.join(known)}")


def _tell_a_leap(path: Path, where: str, frequency: list[float]) -> None:
    """Tell of a mode far above the one before it: a slip of unit in one entry, not a gap in the table."""
    rising = sorted(frequency)
    for low, high in pairwise(rising):
        if high > LEAP * low:
            tell(path, f"{where}.modes", f"leap from {low:g} to {high:g} Hz: is one in another unit?")


def _read_mode(path: Path, where: str, value: Any) -> TableMode:
    if not isinstance(value, dict):
        raise InputError(path, where, f"expected frequency_hz and damping_percent, found {value!r}")
    _refuse_unknown(path, where, value, [one.name for one in fields(TableMode)])

    def number(name: str, unit: str) -> float | None:
        entry = value.get(name)
        if entry is not None and not _is_number(entry):
            raise InputError(path, f"{where}.{name}", f"expected a number, found {entry!r}")
        if entry is not None and (problem := implausible(entry, unit, scale="_std_" not in name)):
            raise InputError(path, f"{where}.{name}", problem)
        return None if entry is None else float(entry)

    frequency = number("frequency_hz", "Hz")
    if frequency is None or frequency <= 0:
        raise InputError(path, f"{where}.frequency_hz", f"expected Hz above 0, found {value.get('frequency_hz')!r}")
    if frequency > FASTEST_HZ:
        raise InputError(path, f"{where}.frequency_hz", f"expected a mode up to {FASTEST_HZ:g} Hz, found {frequency:g}")
    damping = number("damping_percent", "%")
    if damping is not None and not 0 <= damping < CRITICAL:
        expected = f"expected per cent of critical damping, 0 to below {CRITICAL:g}, found {damping:g}"
        raise InputError(path, f"{where}.damping_percent", expected)
    if damping is not None and damping < LEAST_PERCENT:
        question = "is it a ratio?" if damping else "leave it out where it is not known"
        tell(path, f"{where}.damping_percent", f"{damping:g} % of critical damping: {question}")
    shape = value.get("shape") or {}
    if not isinstance(shape, dict):
        raise InputError(path, f"{where}.shape", f"expected labels with [re, im], found {shape!r}")
    for label, pair in shape.items():
        here = f"{where}.shape.{label if isinstance(label, str) else reprlib.repr(label)}"
        if not (isinstance(label, str) and LABEL.fullmatch(label) and len(label) <= LONGEST_LABEL):
            raise InputError(path, here, "expected node number, axis, sign such as 21Z+")
        if not (isinstance(pair, list) and len(pair) == 2 and all(_is_number(x) for x in pair)):
            raise InputError(path, here, f"expected [re, im], found {reprlib.repr(pair)}")
        if max(map(abs, pair)) > LARGEST_SHAPE:
            raise InputError(path, here, f"expected numbers up to {LARGEST_SHAPE:g}, found {pair}")
    if shape and not any(any(pair) for pair in shape.values()):
        raise InputError(path, f"{where}.shape", "expected a shape that moves, every channel is zero")
    spread = {name: number(name, unit) for name, unit in (("frequency_std_hz", "Hz"), ("damping_std_percent", "%"))}
    for name, most in (("frequency_std_hz", frequency), ("damping_std_percent", 100.0)):
        std = spread[name]
        if std is not None and not 0 <= std <= most:
            raise InputError(path, f"{where}.{name}", f"expected 0 to {most:g}, found {std:g}")
    return TableMode(
        frequency,
        damping,
        spread["frequency_std_hz"],
        spread["damping_std_percent"],
        {str(label): complex(*pair) for label, pair in shape.items()},
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def write_modal_table(path: str | Path, table: ModalTable) -> None:
    """Write a modal table, one mode per line; the file appears whole or not at all."""
    content = CommentedMap({"robot": table.robot})
    if table.points is not None:
        content["points"] = CommentedMap()
        for k, label in enumerate(table.points.label):
            places = {name: [_short(x) for x in getattr(table.points, name)[k]] for name in ("position", "direction")}
            content["points"][label] = CommentedMap({"body": table.points.body[k], **places})
            content["points"][label].fa.set_flow_style()
    content["postures"] = CommentedMap()
    for name, posture in table.postures.items():
        q = CommentedSeq([_short(x) for x in posture.q_deg])
        q.fa.set_flow_style()
        modes = CommentedSeq([_row(mode) for mode in posture.modes])
        content["postures"][name] = CommentedMap({"q_deg": q, "modes": modes})
    yaml = YAML()
    yaml.width = 10**6
    with writing(path) as file:
        yaml.dump(content, file)


def _row(mode: TableMode) -> CommentedMap:
    row = CommentedMap(
        {
            "frequency_hz": _short(mode.frequency_hz),
            "damping_percent": None if mode.damping_percent is None else _short(mode.damping_percent),
        }
    )
    for name in ("frequency_std_hz", "damping_std_percent"):
        value = getattr(mode, name)
        if value is not None:
            row[name] = _short(value)
    if mode.shape:
        row["shape"] = CommentedMap({k: [_short(v.real), _short(v.imag)] for k, v in mode.shape.items()})
    row.fa.set_flow_style()
    return row


def _short(value: float) -> float:
    """Eight significant digits: more than any test resolves."""
    return float(f"{value:.8g}")
