"""Tables as text: CSV and TSV of any separator, decimal comma, units in the header, times of day; UR RTDE, KRC."""

import re
from pathlib import Path

import numpy as np

from twin.errors import InputError, tell
from twin.importing.tables import Channel, Table

SEPARATORS = "\t;, "  # tried in this order: a comma may be a decimal mark, a blank may be part of a name
UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")  # "Kraft [N]", "q1 (deg)"
STAMP = re.compile(  # "12:03:04.015", "02.12.2026 12:03:04,015", "2026-12-02T12:03:04Z"
    r"^(?:\S+[ T])?(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2}(?:[.,]\d+)?) ?(?P<half>[AaPp][Mm])?(?:Z|[+-]\d{2}:?\d{2})?$"
)
DAY_S = 86400.0


def read(path: Path) -> list[Table]:
    """One table; the header is the last line before the numbers, a line of units may stand between."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")  # what Windows programs write in Western Europe
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    separator = next((mark for mark in SEPARATORS if _columns(lines, mark) > 1), None)
    if separator is None:
        raise InputError(path, "", "expected columns of numbers, separated by commas, semicolons, tabs or blanks")
    decimal = "," if separator != "," and any("," in line for line in lines[-3:]) else "."
    rows = [_split(line, separator) for line in lines]
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
    for number, row in enumerate(rows[first:], first + 1):
        found = _numbers(row, decimal)
        if found is None or len(found) != width:
            raise InputError(path, f"line {number} of those with text", f"expected {width} numbers")
        values.append(found)
    names, units = _header([row for row in rows[:first] if len(row) == width], width)
    table = np.array(values)
    numbered = [i for i in range(whole) if i not in words]
    units = ["s" if numbered[i] in stamps else unit for i, unit in enumerate(units)]
    channels = {name: Channel(table[:, i], units[i]) for i, name in enumerate(names)}
    return [Table(path.stem, channels)]


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
    cells = line.split() if separator == " " else line.rstrip(separator).split(separator)
    return [cell.strip().strip('"') for cell in cells]


def _columns(lines: list[str], separator: str) -> int:
    """Columns of numbers in the last lines, beside which few may be of text, as a date; else 0."""
    tail = [_split(line, separator) for line in lines[-3:]]
    most, ragged = 0, len({len(row) for row in tail}) > 1  # as where the last line is cut off: told by its number
    for decimal in (mark for mark in ".," if mark != separator):
        numbers = sum(_numbers(list(column), decimal) is not None for column in zip(*tail, strict=False))
        words = min((len(row) for row in tail), default=0) - numbers
        few = separator != " " and not ragged and 2 * words <= numbers
        most = max(most, numbers if not words or few else 0)
    return most


def _numbers(row: list[str], decimal: str) -> list[float] | None:
    try:
        return [float(cell.replace(decimal, ".") if decimal == "," else cell) for cell in row]
    except ValueError:
        return None


def _header(rows: list[list[str]], width: int) -> tuple[list[str], list[str]]:
    """Names and units of the columns; without a header they are ``column.1`` …"""
    if not rows:
        return [f"column.{i + 1}" for i in range(width)], [""] * width
    names, units = rows[0], rows[1] if len(rows) > 1 else [""] * width
    for i, name in enumerate(names):
        if found := UNIT.match(name):
            names[i], units[i] = found["name"], found["unit"]
    return names, [unit.strip("[]()") for unit in units]
