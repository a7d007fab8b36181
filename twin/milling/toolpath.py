"""Tool paths: CSV, a subset of G-code, APT; as points of the tip with the feed's direction and the tool's axis.

* CSV: a header with ``x_m,y_m,z_m`` (or ``x_mm`` …) and, if the tool tilts, its direction from tip to spindle
  ``i,j,k``. A column ``rapid`` (0 or 1) marks moves without cutting.
* G-code (RS274/NGC): G0, G1, G2, G3 with I J K or R in the plane of G17, G18, G19; G20, G21, G90, G91. Comments, line
  numbers, F, S, T and M words are read over. Anything that would move the tool otherwise is refused.
* APT (cutter location data): GOTO/ x, y, z [, i, j, k], FROM/, GODLTA/, RAPID, UNITS/ MM or INCHES, MULTAX.
"""

import csv
import re
import reprlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.errors import InputError, tell

MM, INCH = 1e-3, 25.4e-3
UNITS = {"MM": MM, "INCHES": INCH, "INCH": INCH, "IN": INCH, "M": 1.0, "CM": 1e-2}
FINEST_ARC = np.deg2rad(5.0)  # between points that stand for an arc
FARTHEST_M = 100.0  # from the origin: more is a wrong unit
GCODE = (".nc", ".ngc", ".gcode", ".tap", ".cnc")
APT = (".apt", ".cls", ".clsf", ".cl")
IGNORED = {"F", "S", "T", "M", "N", "H", "D", "P", "O"}
NO_MOVE = {0, 1, 2, 3, 17, 18, 19, 20, 21, 40, 49, 50, 54, 61, 64, 80, 90, 91, 94, 95, 97}
MODAL = ({0, 1, 2, 3}, {17, 18, 19}, {20, 21}, {90, 91})  # of each, one counts in a line
SILENT = {  # APT words that move nothing: what CAM systems write between GOTO points
    "PARTNO", "MACHIN", "PPRINT", "LOADTL", "LOAD", "TOOL PATH", "TLDATA", "PAINT", "MULTAX", "SPINDL", "FEDRAT",
    "COOLNT", "CUTTER", "CUTCOM", "DELAY", "DWELL", "END", "END-OF-PATH", "FINI", "INTOL", "OUTTOL", "INSERT",
    "MODE", "OPSTOP", "STOP", "PREFUN", "AUXFUN", "SEQNO", "REMARK", "RETRCT", "SELECT", "TOLER", "TURRET", "TOOLNO",
    "UNLOAD", "CLEARP", "DISPLY", "NOPOST", "RESERV", "SET", "TLAXIS", "THICK", "CLAMP", "ARCSLP", "LINTOL", "PITCH",
}  # fmt: skip
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}


@dataclass(frozen=True)
class Toolpath:
    """N points of a tool's tip.

    Attributes:
        position: (N, 3) m, in the path's own frame until it is placed.
        axis: (N, 3) unit vectors from tip to spindle, or ``None`` where the path does not state them.
        cutting: (N,) false where the move that ends there is rapid.
        line: (N,) line of the file, for messages.
    """

    position: np.ndarray
    axis: np.ndarray | None
    cutting: np.ndarray
    line: np.ndarray

    @property
    def feed(self) -> np.ndarray:
        """Unit directions (N, 3) of the motion that leads to each point (away from it, at the first)."""
        move = np.diff(self.position, axis=0)
        length = np.linalg.norm(move, axis=1)
        unit = move / np.maximum(length, 1e-300)[:, None]
        for k in np.flatnonzero(length < 1e-12):  # a dwell keeps the direction
            unit[k] = unit[k - 1] if k else unit[np.argmax(length > 1e-12)]
        return np.vstack([unit[:1], unit])

    @property
    def along(self) -> np.ndarray:
        """Length of the path (N,) up to every point, m."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.position, axis=0), axis=1))])

    def placed(self, position: np.ndarray, rotation: np.ndarray) -> "Toolpath":
        """In the robot's base frame, the path's own frame standing at a position (3,) m with a rotation (3, 3)."""
        axis = None if self.axis is None else self.axis @ rotation.T
        return Toolpath(self.position @ rotation.T + position, axis, self.cutting, self.line)

    def every(self, spacing: float) -> "Toolpath":
        """Cutting moves only, with points at most ``spacing`` m apart."""
        position, axis, line = [], [], []
        for k in range(len(self.position)):
            if not self.cutting[k]:
                continue
            start = max(k - 1, 0)
            away = self.position[k] - self.position[start]
            parts = max(1, int(np.ceil(np.linalg.norm(away) / spacing - 1e-9)))
            first = 0 if k == 0 or not self.cutting[start] else 1
            for share in np.arange(first, parts + 1) / parts:
                position.append(self.position[start] + share * away)
                line.append(self.line[k])
                if self.axis is not None:
                    turned = (1 - share) * self.axis[start] + share * self.axis[k]
                    axis.append(turned / np.linalg.norm(turned))
        return Toolpath(
            np.array(position).reshape(-1, 3), np.array(axis) if axis else None, np.ones(len(position), bool),
            np.array(line, int),
        )  # fmt: skip


def read_toolpath(path: str | Path) -> Toolpath:
    """Read a tool path by the ending of its name.

    Raises:
        InputError: one line that names file, line and what was expected.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error
    suffix = path.suffix.lower()
    if suffix == ".csv":
        found = _csv(text, path)
    elif suffix in GCODE:
        found = _gcode(text, path)
    elif suffix in APT:
        found = _apt(text, path)
    else:
        raise InputError(path, "", f"expected a tool path: .csv, {', '.join(GCODE)} (G-code) or {', '.join(APT)} (APT)")
    if len(found.position) < 2 or not found.along[-1] > 0:
        raise InputError(path, "", "expected a path of at least two different points")
    far = np.flatnonzero(np.abs(found.position).max(axis=1) > FARTHEST_M)
    if far.size:
        k = int(far[0])
        reach = np.abs(found.position[k]).max()
        raise InputError(path, f"line {found.line[k]}", f"{reach:g} m from the origin: is the unit right?")
    if not found.cutting.any():
        raise InputError(path, "", "all moves are rapid: nothing is cut")
    return found


def _csv(text: str, path: Path) -> Toolpath:
    rows = list(csv.reader(text.splitlines()))
    header = [name.strip().lower() for name in rows[0]] if rows else []
    unit = next((u for u in ("m", "mm") if all(f"{a}_{u}" in header for a in "xyz")), None)
    if unit is None:
        raise InputError(path, "line 1", f"expected a header with x_m,y_m,z_m or x_mm,y_mm,z_mm, found {header}")
    tilted = [a in header for a in "ijk"]
    if any(tilted) and not all(tilted):
        raise InputError(path, "line 1", "expected all of i,j,k or none")
    columns = [*(f"{a}_{unit}" for a in "xyz"), *("ijk" if all(tilted) else ())]
    columns += ["rapid"] if "rapid" in header else []
    if twice := next((name for name in columns if header.count(name) > 1), None):
        raise InputError(path, "line 1", f"expected every column once, {twice} is there twice")
    if unit == "m" and any(f"{a}_mm" in header for a in "xyz"):
        raise InputError(path, "line 1", "expected one unit, found columns in m and in mm")
    if other := [name for name in header if name not in columns]:
        tell(
            path,
            "line 1",
            f"columns that are not read: {reprlib.repr(', '.join(other))}; read are {', '.join(columns)}",
        )
    data, line = [], []
    for number, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            values = [float(row[header.index(name)]) for name in columns]
        except (ValueError, IndexError) as error:
            raise InputError(path, f"line {number}", f"expected numbers for {', '.join(columns)} ({error})") from error
        if not np.isfinite(values).all():
            raise InputError(path, f"line {number}", "expected finite numbers")
        if "rapid" in columns and values[-1] not in (0.0, 1.0):
            raise InputError(path, f"line {number}", f"rapid: expected 0 or 1, found {values[-1]:g}")
        if any(cell.strip() for cell in row[len(header) :]):
            raise InputError(
                path, f"line {number}", f"expected {len(header)} values as in the header, found {len(row)}"
            )
        data.append(values)
        line.append(number)
    if not data:
        raise InputError(path, "line 2", "expected points below the header")
    table = np.array(data)
    axis = _unit(table[:, 3:6], path, line) if all(tilted) else None
    cutting = table[:, -1] == 0 if "rapid" in header else np.ones(len(table), bool)
    return Toolpath(table[:, :3] * (MM if unit == "mm" else 1.0), axis, cutting, np.array(line))


def _unit(axis: np.ndarray, path: Path, line: list[int]) -> np.ndarray:
    length = np.linalg.norm(axis, axis=1)
    if (length < 1e-6).any():
        raise InputError(path, f"line {line[int(np.argmin(length))]}", "i, j, k: expected a direction, found zero")
    return np.asarray(axis / length[:, None])


class _Points:
    """Collects the points of a path."""

    def __init__(self) -> None:
        self.position: list[np.ndarray] = []
        self.axis: list[np.ndarray] = []
        self.cutting: list[bool] = []
        self.line: list[int] = []

    def add(self, position: np.ndarray, cutting: bool, line: int, axis: np.ndarray | None = None) -> None:
        self.position.append(np.array(position, float))
        self.cutting.append(cutting)
        self.line.append(line)
        if axis is not None:
            self.axis.append(axis)

    def path(self) -> Toolpath:
        axis = np.array(self.axis) if self.axis else None
        return Toolpath(np.array(self.position).reshape(-1, 3), axis, np.array(self.cutting, bool), np.array(self.line))


def _gcode(text: str, path: Path) -> Toolpath:
    found, unit, relative, plane, motion = _Points(), MM, False, PLANES[17], 0
    here, known, stated = np.zeros(3), False, False
    for number, raw in enumerate(text.splitlines(), 1):
        block = re.sub(r"\([^)]*\)", "", raw.split(";")[0]).replace(" ", "").upper().strip("%\t\r")
        if not block or block.startswith("/"):
            continue
        words = re.findall(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))", block)
        if "".join(a + b for a, b in words) != block:
            raise InputError(path, f"line {number}", f"expected words such as G1 X10, found {raw.strip()!r}")
        values = {letter: float(value) for letter, value in words if letter != "G"}
        letters = [letter for letter, _ in words if letter not in ("G", "M")]
        if again := next((letter for letter in letters if letters.count(letter) > 1), None):
            raise InputError(path, f"line {number}", f"{again}: expected once in a line, found {letters.count(again)}")
        codes = {float(value) for letter, value in words if letter == "G"}
        stated = stated or bool(codes & {20, 21})
        for group in MODAL:
            if len(both := sorted(codes & group)) > 1:
                raise InputError(path, f"line {number}", f"expected one of G{both[0]:g} and G{both[1]:g}, found both")
        for letter in values:
            if letter not in IGNORED and letter not in "XYZIJKR":
                raise InputError(path, f"line {number}", f"{letter}: only X, Y, Z, I, J, K and R move the tool here")
        for letter, value in words:
            if letter != "G":
                continue
            code = float(value)
            if code not in NO_MOVE:
                raise InputError(path, f"line {number}", f"G{code:g} is not read; expected G0 to G3 and settings")
            motion = int(code) if code in (0, 1, 2, 3) else motion
            if code in (20, 21) and len(found.line) and unit != (INCH, MM)[int(code) - 20]:
                tell(path, f"line {number}", f"the unit changes to {('inches', 'mm')[int(code) - 20]} in the midst")
            unit = {20: INCH, 21: MM}.get(int(code), unit)
            relative = {90: False, 91: True}.get(int(code), relative)
            plane = PLANES.get(int(code), plane)
        if not any(a in values for a in "XYZIJ"):
            continue
        if motion not in (2, 3) and (astray := [letter for letter in values if letter in "IJKR"]):
            raise InputError(path, f"line {number}", f"{astray[0]}: belongs to an arc (G2 or G3), found G{motion}")
        target = here.copy()
        for k, letter in enumerate("XYZ"):
            if letter in values:
                target[k] = unit * values[letter] + (here[k] if relative else 0.0)
        if motion in (2, 3):
            if not known:
                raise InputError(path, f"line {number}", "an arc needs a point to start from")
            for point in _arc(here, target, values, unit, plane, motion == 2, path, number):
                found.add(point, True, number)
        else:
            found.add(target, motion == 1 and known, number)
        here, known = target, True
    if not stated:
        _tell_no_unit(path, "G20 or G21")
    return found.path()


def _arc(
    here: np.ndarray, target: np.ndarray, values: dict[str, float], unit: float, plane: tuple[int, int, int],
    clockwise: bool, path: Path, line: int,
) -> list[np.ndarray]:  # fmt: skip
    """Points of a helix from here to the target."""
    a, b, _ = plane
    start, end = here[[a, b]], target[[a, b]]
    if "R" in values:
        radius, chord = unit * values["R"], end - start
        half = float(np.linalg.norm(chord)) / 2
        if not 0 < half <= abs(radius) * (1 + 1e-6):
            raise InputError(path, f"line {line}", f"R{values['R']:g} reaches no arc to the target")
        height = np.sqrt(max(radius**2 - half**2, 0.0)) * (1 if (radius > 0) != clockwise else -1)
        centre = start + chord / 2 + height * np.array([-chord[1], chord[0]]) / (2 * half)
    else:
        offset = np.array([values.get("IJK"[k], 0.0) for k in (a, b)]) * unit
        centre = start + offset
        first, last = np.linalg.norm(offset), np.linalg.norm(end - centre)
        if first == 0 or abs(first - last) > 1e-5 + 1e-3 * first:
            raise InputError(path, f"line {line}", "the arc's ends are at different distances from its centre")
    away, other = start - centre, end - centre
    angle = np.arctan2(away[0] * other[1] - away[1] * other[0], away @ other)
    if clockwise and angle >= -1e-9:
        angle -= 2 * np.pi
    elif not clockwise and angle <= 1e-9:
        angle += 2 * np.pi
    count = max(1, int(np.ceil(abs(angle) / FINEST_ARC)))
    points = []
    for share in np.arange(1, count + 1) / count:
        turn = share * angle
        point = here + share * (target - here)
        point[[a, b]] = centre + np.array(
            [np.cos(turn) * away[0] - np.sin(turn) * away[1], np.sin(turn) * away[0] + np.cos(turn) * away[1]]
        )
        points.append(point)
    return points


def _tell_no_unit(path: Path, words: str) -> None:
    tell(path, "", f"states no unit ({words}): taken in mm")


def _apt(text: str, path: Path) -> Toolpath:
    found, unit, rapid, here = _Points(), None, False, np.zeros(3)
    upright = np.array([0.0, 0.0, 1.0])
    axis, tilted = upright, False
    pending, first = "", 1
    unread: dict[str, int] = {}
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.split("$$")[0].strip().upper()
        if not pending:
            first = number
        pending += line
        if pending.endswith(("$", ",")):  # continued
            pending = pending.rstrip("$").strip()
            continue
        statement, pending = pending, ""
        word, _, rest = statement.partition("/")
        word = word.strip()
        if word == "UNITS":
            found_unit = rest.strip()
            if found_unit not in UNITS:
                raise InputError(path, f"line {first}", f"UNITS: expected {' or '.join(UNITS)}, found {rest.strip()!r}")
            unit = UNITS[found_unit]
        elif word == "RAPID":
            rapid = True
        elif word in ("GOTO", "FROM", "GODLTA"):
            try:
                values = [float(value) for value in rest.split(",") if value.strip()]
            except ValueError as error:
                raise InputError(path, f"line {first}", f"{word}: expected numbers ({error})") from error
            if not np.isfinite(values).all():
                raise InputError(path, f"line {first}", f"{word}: expected finite numbers")
            if len(values) not in (3, 6):
                raise InputError(path, f"line {first}", f"{word}: expected x, y, z and, if it tilts, i, j, k")
            step = (MM if unit is None else unit) * np.array(values[:3])
            here = here + step if word == "GODLTA" else step
            if len(values) == 6:
                axis, tilted = _unit(np.array([values[3:]]), path, [first])[0], True
            found.add(here, not rapid and word != "FROM", first, axis)
            rapid = False
        elif word in ("CIRCLE", "CYLNDR", "GOFWD", "GOLFT", "GORGT", "GOBACK", "CYCLE", "MOVARC"):
            raise InputError(path, f"line {first}", f"{word} is not read; let the CAM system write GOTO points only")
        elif word and word not in SILENT:
            unread.setdefault(word, first)
    if unit is None:
        _tell_no_unit(path, "UNITS/")
    if unread:
        some = ", ".join(f"{reprlib.repr(word)} (line {line})" for word, line in list(unread.items())[:3])
        tell(path, "", f"{len(unread)} words are not known and were not read: {some}")
    made = found.path()
    return made if tilted else Toolpath(made.position, None, made.cutting, made.line)
