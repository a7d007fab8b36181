"""Tables as text: CSV and TSV of any separator, decimal comma, units in the header; UR RTDE, exported KRC traces."""

import re
from pathlib import Path

import numpy as np

from twin.errors import InputError, tell
from twin.importing.tables import Channel, Table

SEPARATORS = "\t;, "  # tried in this order: a comma may be a decimal mark, a blank may be part of a name
UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")  # "Kraft [N]", "q1 (deg)"


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
    channels = {name: Channel(table[:, i], units[i]) for i, name in enumerate(names)}
    return [Table(path.stem, channels)]


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
