"""The map that `twin import --guess` prints, from the names of channels: for the user to correct.

Units that the file does not state are left to ask.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError, tell
from twin.importing.tables import Table, joined, natural
from twin.measure.units import ASK, known, measure

CLOCK = re.compile(
    r"(?i)^((date)?[ _]?time([ _]?stamp)?|date|t|(uhr)?zeit(stempel)?|datum|.*\.(time|t))([_ ]?(s|sec|ms|us|ns))?$"
)
AXIS_CLOCK = re.compile(r"(?i)^(time|t|zeit)[ _]?(a|axis|achse|joint)?[ _]?\d+$")  # where every axis has its own
HAMMER = re.compile(r"(?i)hammer|force|kraft|impact")
FRF = re.compile(r"(?i)(^|\.)(frf|h|h1|hv|accelerance)$")
LINES = re.compile(r"(?i)(^|\.)(f|freq.*)$")
SERIES = {  # in the order they are looked for; what others call them: URScript's RTDE, KRC, ROS, German
    "torque": re.compile(r"(?i)tau|torque|trq|effort|moment|curr(ent|[_.])|strom"),
    "velocity": re.compile(r"(?i)vel|qd|speed|geschw|drehzahl"),
    "acceleration": re.compile(r"(?i)acc|qdd"),
    "position": re.compile(r"(?i)pos|(^|_|\.)q([_.]?\d+)?$|axis|angle|achs|winkel|lage"),
}
ENDING = re.compile(r"[_ ](s|ms|us|ns|deg|rad|mm|m|Nm|N|g)$")  # a unit as names end with it
MEASURED = {  # what an axis' channel is whose name does not tell, by its unit
    "angle": "position", "length": "position", "angular velocity": "velocity", "velocity": "velocity",
    "angular acceleration": "acceleration", "torque": "torque",
}  # fmt: skip
CURRENT = ("A", "mA")  # of a motor: its torque, once the user says how much it makes
OF_DRIVES = {"%": "the motor's rated torque over 100,", "A": "the torque constant, N·m/A,"}
"""What a drive records in place of a torque, and what it is multiplied by."""
POINT = re.compile(r"(?i)(\d+)[_ ]?([xyz])([+-]?)$")  # node and axis, as A3X, 12Y-, p1_h2Z
COMMANDED = re.compile(r"(?i)target|soll|command|cmd")


def guess_tables(tables: Sequence[Table]) -> dict[str, Any]:
    """A map for tables: a motion log, or a hammer test where a channel is a hammer's or FRFs are there.

    Raises:
        InputError: no channel has a name that tells.
    """
    together: dict[str, Any] = {}
    if len(tables) > 1 and not set.intersection(*(_kinds(table) for table in tables)):
        try:  # positions in one file, torques in another
            tables, names = [joined("run", tables)], [table.name for table in tables]
            together = {"runs": {"run": names}}
        except ValueError:
            pass
    first = tables[0]
    names = [name for name in first.channels if not COMMANDED.search(name)]
    if any(FRF.search(name) and first.channels[name].values.ndim == 3 for name in names):
        return _functions(first, tables)
    if hammers := [name for name in names if HAMMER.search(name)]:
        return _hits(first, tables, names, hammers[0])
    series: dict[str, list[str]] = {}
    for name in sorted((name for name in names if not CLOCK.match(name)), key=natural):
        if kind := _kind(first, name):
            series.setdefault(kind, []).append(name)
    if "position" not in series:
        raise InputError(first.name, "channels", f"no name tells a hammer or positions: {', '.join(names[:12])}")
    clock = next(iter(clocks(first)), None)
    of_axes = sorted((name for name in names if AXIS_CLOCK.match(name)), key=natural)
    found: dict[str, Any] = {"makes": "motion-log", "robot": ASK, **together}
    if of_axes and len(of_axes) == len(series["position"]):
        found["time"] = {"channels": of_axes, "unit": _stated(first, of_axes[0])}
    elif clock:
        found["time"] = {"channels": [clock], "unit": _stated(first, clock)}
    else:
        found["sample_rate_hz"] = first.sample_rate_hz or ASK
    for kind in ("position", "torque", "velocity", "acceleration"):
        if kind in series or kind == "torque":
            found[kind] = _taken(first, series.get(kind, [ASK]))
    _tell_drive(first, series.get("torque", []))
    return found


def _tell_drive(table: Table, names: Sequence[str]) -> None:
    """Tell what makes torques of what drives record in their stead: a share of the rated torque, or a current."""
    for unit, what in OF_DRIVES.items():
        if any(table.channels[name].unit.strip() == unit for name in names if name in table.channels):
            text = f"is stated in {unit}; give `unit: N·m` and a `factor` per axis: {what} times the gear ratio"
            tell(table.name, "torque", text)


def clocks(table: Table) -> list[str]:
    """Channels that are clocks by their names; the finest first, as seconds beside a date of whole seconds."""
    names = [name for name in table.channels if CLOCK.match(name)]
    return sorted(names, key=lambda name: -len(np.unique(table.channels[name].values)))


def _kind(table: Table, name: str) -> str | None:
    """Which series a channel is of, by its name, or else by its unit."""
    bare = ENDING.sub("", name)
    unit, kind = table.channels[name].unit, next((k for k, pattern in SERIES.items() if pattern.search(bare)), None)
    if kind or not unit or CLOCK.match(name):
        return kind
    if unit in CURRENT:
        return "torque"
    return MEASURED.get(measure(unit)[0]) if known(unit) else None


def _kinds(table: Table) -> set[str]:
    """Of which quantities a table has channels; blows and FRFs are ``other``, they belong to no run."""
    names = [name for name in table.channels if not COMMANDED.search(name)]
    other = {"other"} if any(HAMMER.search(name) or FRF.search(name) for name in names) else set[str]()
    return other | {kind for name in names if (kind := _kind(table, name))}


def _taken(table: Table, names: list[str]) -> dict[str, Any]:
    units = [_stated(table, name) for name in names if name in table.channels]
    alike: str | list[str] = ASK if ASK in units or not units else units
    return {"channels": names, "unit": units[0] if len(set(units)) == 1 else alike, "factor": 1.0}


def _stated(table: Table, name: str) -> str:
    """The unit of a channel as the file or the end of its name states it, if it is one."""
    unit = table.channels[name].unit
    if not unit and (ending := ENDING.search(name)):
        unit = ending[1]
    return unit if known(unit) else ASK


def _point(label: str) -> dict[str, Any]:
    return {"label": label, "body": ASK, "position": ASK}


def _labels(names: Sequence[str], usual: Sequence[str]) -> list[str]:
    """Labels of points as names tell them, node and axis; the ``usual`` ones where not all do, or two are alike."""
    found = [POINT.search(name) for name in names]
    told = [f"{int(m[1])}{m[2].upper()}{m[3] or '+'}" for m in found if m]
    return told if len(set(told)) == len(names) else list(usual)


def _hits(first: Table, tables: Sequence[Table], names: list[str], hammer: str) -> dict[str, Any]:
    heard = [name for name in names if name != hammer and not CLOCK.match(name)]
    clock = next(iter(clocks(first)), None)
    timed = {"time": {"channels": [clock], "unit": _stated(first, clock)}} if clock else {}
    labels = _labels(heard, [f"{i // 3 + 1}{'XYZ'[i % 3]}+" for i in range(len(heard))])
    blows = _labels([Path(table.name).stem for table in tables], [f"{i + 2}Z+" for i in range(len(tables))])
    sensors = [
        {"channel": name, "unit": _stated(first, name), "factor": 1.0, **_point(label)}
        for name, label in zip(heard, labels, strict=True)
    ]
    return {
        "makes": "frf-campaign",
        "robot": ASK,
        "postures": {"posture": {"q_deg": ASK, "files": "*"}},
        **(timed or {"sample_rate_hz": first.sample_rate_hz or ASK}),
        "record_s": ASK,
        "force": _taken(first, [hammer]),
        "response": sensors,
        "excitation": [{**_point(b), "files": table.name} for b, table in zip(blows, tables, strict=True)],
    }


def _functions(first: Table, tables: Sequence[Table]) -> dict[str, Any]:
    name = next(name for name in first.channels if FRF.search(name))
    lines = next((n for n in first.channels if LINES.search(n)), ASK)
    shape = list(first.channels[name].values.shape)
    if lines in first.channels and (count := first.channels[lines].values.size) in shape:
        shape.remove(count)
        responses, excitations = shape
    else:
        _, responses, excitations = shape
    return {
        "makes": "frf-campaign",
        "robot": ASK,
        "postures": {table.name: {"q_deg": ASK, "files": table.name} for table in tables},
        "frequency": {"channels": lines, "unit": ASK},
        "frf": {"channels": name, "unit": ASK},
        "response": [_point(f"{i + 1}Z+") for i in range(responses)],
        "excitation": [_point(f"{i + 1}Z+") for i in range(excitations)],
    }


def guess_universal(paths: Sequence[Path]) -> dict[str, Any]:
    """A map for universal files: their nodes, each still to be given its body.

    Files that belong together, one per hammer point, are one posture; else every file is one.

    Raises:
        InputError: the files hold no FRFs.
    """
    from twin.measure.uff import placed_nodes, read_uff, stated_unit

    unit = stated_unit(paths[0])
    try:  # one file per hammer point
        campaigns, together = [read_uff(paths, q_deg=None, unit=unit)], len(paths) > 1
    except InputError:  # every file a posture
        campaigns, together = [read_uff(path, q_deg=None, unit=unit) for path in paths], False
    sides = [side for campaign in campaigns for side in (campaign.response, campaign.excitation)]
    there = set[int]().union(*(placed_nodes(path) for path in paths))
    places = {int(label[:-2]): list(map(float, at)) for side in sides
              for label, at in zip(side.label, side.position, strict=True)}  # fmt: skip
    nodes = {node: at if node in there else ASK for node, at in places.items()}
    return {
        "makes": "frf-campaign",
        "robot": ASK,
        "postures": {"posture": {"q_deg": ASK, "files": "*"}}
        if together
        else {path.stem: {"q_deg": ASK, "files": path.name} for path in paths},
        "unit": unit or ASK,
        "nodes": {node: {"body": ASK, "position": at} for node, at in nodes.items()},
    }
