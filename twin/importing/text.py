"""Tables as text: CSV and TSV of any separator, decimal comma, units in the header, times of day; UR RTDE, KRC."""

import csv
import re
from pathlib import Path

import numpy as np

from twin.errors import InputError, tell
from twin.importing.tables import Channel, Table

SEPARATORS = "\t;, "  # tried in this order: a comma may be a decimal mark, a blank may be part of a name
UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")  # "Kraft [N]", "q1 (deg)"
IN = re.compile(r"^(?P<name>.+) in (?P<unit>\S{1,8})$")  # "Lage 1 in °"
STAMP = re.compile(  # "12:03:04.015", "02.12.2026 12:03:04,015", "2026-12-02T12:03:04Z"
    r"^(?:\S+[ T])?(?P<h>[01]?\d|2[0-3]):(?P<m>[0-5]\d):(?P<s>[0-5]\d(?:[.,]\d+)?)"
    r" ?(?P<half>[AaPp][Mm])?(?:Z|[+-]\d{2}:?\d{2})?$"
)
DAY_S = 86400.0
ONE_POINT = re.compile(r"^[+-]?\d*\.\d+$")
THOUSAND = re.compile(r"^[+-]?[1-9]\d{0,2}\.\d{3}$")  # "1.004" beside decimal commas: may be 1004
GROUPED = re.compile(r"^[+-]?[1-9]\d{0,2}((\.\d{3})+,\d*|(\.\d{3}){2,})$")  # "1.004,5", "1.000.400"


def read(path: Path) -> list[Table]:
    """One table; the header is the last line before the numbers, a line of units may stand between."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")  # what Windows programs write in Western Europe
    numbered = [(n, s) for n, s in enumerate(text.splitlines(), 1) if s.strip() and not s.startswith("#")]
    lines = [line for _, line in numbered]
    separator = next((mark for mark in SEPARATORS if _columns(lines, mark) > 1), None)
    if separator is None:
        raise InputError(path, "", "expected columns of numbers, separated by commas, semicolons, tabs or blanks")
    rows = [_split(line, separator) for line in lines]
    decimal = "," if any("," in cell for row in rows[-3:] for cell in row) else "."
    if decimal == ",":
        rows = _without_thousands(path, numbered, rows)
    whole = len(rows[-1])
    stamps = [i for i in range(whole) if _is_clock([row[i] for row in rows[-3:] if len(row) == whole])]
    for i in stamps:
        _counted([row for row in rows if len(row) == whole], i, decimal)
    if words := [
        i for i, column in enumerate(zip(*rows[-3:], strict=False)) if _numbers(list(column), decimal) is None
    ]:
        named = next((row for row in rows if len(row) == whole), rows[-1])
        left = ", ".join(repr(named[i]) for i in words)
        tell(str(path), "columns", f"text, no numbers, and left out: {left}")
        rows = [[cell for i, cell in enumerate(row) if i not in words] if len(row) == whole else row for row in rows]
    first = next(i for i, row in enumerate(rows) if _numbers(row, decimal) is not None)
    width = len(rows[first])
    values = []
    for (number, _), row in zip(numbered[first:], rows[first:], strict=True):
        found = _numbers(row, decimal)
        if found is None or len(found) != width:
            bad = next((repr(cell) for cell in row if _numbers([cell], decimal) is None), f"{len(row)}")
            raise InputError(path, f"line {number}", f"expected {width} numbers, found {bad}")
        values.append(found)
    names, units = _header([row for row in rows[:first] if len(row) == width], width)
    table = np.array(values)
    taken = [i for i in range(whole) if i not in words]
    units = ["s" if taken[i] in stamps else unit for i, unit in enumerate(units)]
    channels = {name: Channel(table[:, i], units[i]) for i, name in enumerate(names)}
    return [Table(path.stem, channels)]


def _without_thousands(path: Path, numbered: list[tuple[int, str]], rows: list[list[str]]) -> list[list[str]]:
    """Rows of a file with decimal commas, whose columns may have points between thousands; others are left alone.

    Raises:
        InputError: every number of a column has three digits after a point, which says neither.
    """
    found = [list(row) for row in rows]
    for i in range(len(rows[-1])):
        cells = [(k, row[i]) for k, row in enumerate(rows) if len(row) == len(rows[-1])]
        pointed = [(k, cell) for k, cell in cells if ONE_POINT.match(cell)]
        if not pointed or not all(THOUSAND.match(cell) for _, cell in pointed):
            continue
        first, cell = pointed[0]
        whole = cell.replace(".", "")
        if not any(re.fullmatch(r"[+-]?\d+", other) for _, other in cells):
            comma = cell.replace(".", ",")
            expected = f"expected one decimal mark; beside decimal commas {cell!r} may be {whole} or {comma}"
            raise InputError(path, f"line {numbered[first][0]}", expected)
        tell(str(path), f"line {numbered[first][0]}", f"points are taken to part thousands: {cell!r} is {whole}")
        for k, other in pointed:
            found[k][i] = other.replace(".", "")
    return found


def _is_clock(cells: list[str]) -> bool:
    """Whether all cells are times of day, with or without a date."""
    return bool(cells) and all(STAMP.match(cell) for cell in cells)


def _counted(rows: list[list[str]], column: int, decimal: str) -> None:
    """Write clock times as seconds since midnight, in place; they go on counting over the next midnight."""
    before, days = 0.0, 0.0
    for row in rows:
        if found := STAMP.match(row[column]):
            hour = int(found["h"])
            if found["half"]:
                hour = hour % 12 + 12 * (found["half"].lower() == "pm")
            seconds = 3600.0 * hour + 60.0 * int(found["m"]) + float(found["s"].replace(",", "."))
            days += DAY_S if seconds < before - DAY_S / 2 else 0.0
            before = seconds
            row[column] = f"{days + seconds:.9f}".replace(".", decimal)


def _split(line: str, separator: str) -> list[str]:
    if '"' in line and separator != " ":
        return [cell.strip() for cell in next(csv.reader([line.rstrip(separator)], delimiter=separator))]
    cells = line.split() if separator == " " else line.rstrip(separator).split(separator)
    return [cell.strip().strip('"') for cell in cells]


def _columns(lines: list[str], separator: str) -> int:
    """Columns of numbers in the last lines, beside which few may be of text, as a date; else 0."""
    tail = [_split(line, separator) for line in lines[-3:]]
    most, ragged = 0, len({len(row) for row in tail}) > 1  # as where the last line is cut off: told by its number
    for decimal in (mark for mark in ".," if mark != separator or '"' in lines[-1]):
        numbers = sum(_numbers(list(column), decimal) is not None for column in zip(*tail, strict=False))
        words = min((len(row) for row in tail), default=0) - numbers
        few = separator != " " and not ragged and 2 * words <= numbers
        most = max(most, numbers if not words or few else 0)
    return most


def _numbers(row: list[str], decimal: str) -> list[float] | None:
    try:
        if decimal == ".":
            return [float(cell) for cell in row]
        return [float((c.replace(".", "") if GROUPED.match(c) else c).replace(",", ".")) for c in row]
    except ValueError:
        return None


def _header(rows: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns; without a header they are ``column.1`` …"""
    if not rows:
        return [f"column.{i + 1}" for i in range(width)], [""] * width
    names, units = rows[0], rows[1] if len(rows) > 1 else [""] * width
    for i, name in enumerate(names):
        if found := UNIT.match(name) or IN.match(name):
            names[i], units[i] = found["name"], found["unit"]
    return names, [unit.strip("[]()") for unit in units]
