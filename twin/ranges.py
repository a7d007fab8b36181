"""What is plausible: the range of every number that enters, by unit, and the sizes of files and requests.

Generous, by physics: the smallest watch spring to the largest machine tool, and then some decades. What lies outside is
a slip of unit or of the keyboard, and no calculation in double precision survives it.
"""

import re
import reprlib

import numpy as np

from twin.errors import InputError

RANGES = {  # unit → least of what is a scale (a mass, a spring), largest magnitude
    "kg": (1e-6, 1e6),  # to the heaviest gantries of machine tools
    "m": (1e-12, 1e3),  # to the longest tracks
    "kg·m²": (1e-15, 1e10),
    "N·m/rad": (1e-6, 1e15),
    "N·m·s/rad": (1e-12, 1e12),
    "N·m": (1e-12, 1e9),
    "N": (1e-12, 1e9),
    "m/s²": (1e-15, 1e8),
    "Hz": (1e-6, 1e8),
    "1/s": (1e-9, 1e4),
    "rad/s": (1e-6, 1e4),
    "°/s, m/s on a linear axis": (1e-5, 1e5),
    "rad/s²": (1e-15, 1e9),
    "s": (1e-12, 1e10),
    "rad": (1e-15, 1e7),
    "°": (1e-13, 6e8),
    "%": (1e-12, 1e4),
    "motor turns per turn, rad/m on a linear axis": (1e-2, 1e7),  # from a rack alone to a screw behind a gear
    "1": (1e-18, 1e18),
}
ANY = (1e-30, 1e18)  # of a unit that is not listed

MOST_VALUES = 2**28  # of one data set: 2 GiB
SEARCHED = 3 << 18  # lines of all FRFs that a diagnosis searches: 14 postures of 69 FRFs × 800 lines
MOST_NODES = 1_000_000  # values in a text file, counted as often as anchors repeat them
MOST_NESTED = 60  # levels of a text file
MOST_PARTS = 400  # links or joints of a drawing
MOST_AXES = 30
MOST_CHARACTERS = 20_000  # of a text
SLOWEST_RPM, FASTEST_RPM = 5.0, 3e5  # of a spindle: boring mills, and those of dentists
FARTHEST_M = 50.0  # of what is fixed to a body from the body's frame: tells millimetres from metres
FARTHEST_TIP_M = 5.0  # of a tool's tip from the flange, likewise
HEAVIEST_TOOL_KG = 2000.0  # spindle and tool: half as much again as the strongest robot carries (FANUC M-2000iA/1700L)
HEAVIEST_ROTOR = 1e3  # kg·m² of a motor alone: that of a megawatt
STRONGEST_GRAVITY = 100.0  # m/s²: four times Jupiter's
FREE_TURNS = 10  # of an axis without limits, either way from its zero
LARGEST_RELATIVE = 100.0  # of a tolerance that is relative
LONGEST_SPACING_M = 100.0  # of points along a tool path
LEAST_FORCE_N, LARGEST_FORCE_N = 1e-3, 1e5  # peak of a blow: a miniature hammer's least, thrice the largest sledge's
NODE_APART_M = 0.5  # between two places of one node: a blow beside its sensor, not at another point
LONGEST_LABEL = 16  # characters: node numbers of universal files have ten digits
MOST_SAMPLES = 20_000_000  # of a trajectory: two hours of six axes at 1 kHz, twice over

COUNTS = {  # smallest and largest of what is asked for
    "count": (1, 100),
    "harmonics": (1, 30),
    "periods": (1, 10_000),
    "base_hz": (1e-4, 100.0),
    "sample_rate_hz": (1.0, 1e5),
    "max_order": (2, 500),
    "starts": (1, 1000),
    "draws": (0, 100_000),
    "in_time": (0, 1000),
    "lobes": (0, 10_000),
    "random": (1, 10_000_000),
}

FASTEST_HZ = COUNTS["sample_rate_hz"][1] / 2  # of a mode or an FRF: no faster sampling is known here

UNSEEN = r"\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"  # control, direction of writing, no width
NAME = rf"^[^/\\${UNSEEN}]*[^/\\${UNSEEN}.\s][^/\\${UNSEEN}]*$"
"""Of a posture or run: it becomes a file's name and a figure's title, where \\ and $ would be TeX."""
LONGEST_NAME = 100


def implausible(value: float, unit: str = "", scale: bool = False) -> str | None:
    """What was expected, where a finite number is out of the range of its unit; a ``scale`` may be too small also."""
    low, high = RANGES.get(unit, ANY)
    what = f"expected a plausible number{f' [{unit}]' if unit else ''}"
    if abs(value) > high:
        return f"{what}, at most {high:g}, found {value:g}"
    return f"{what}, at least {low:g}, found {value:g}" if scale and 0 < value < low else None


def ill_named(name: str) -> str | None:
    """What was expected, where a posture or run cannot be called so."""
    if len(name) <= LONGEST_NAME and re.fullmatch(NAME, name):
        return None
    return f"expected names of 1 to {LONGEST_NAME} characters without / \\ $ or hidden ones, found {reprlib.repr(name)}"


def illegible(text: str) -> str | None:
    """What was expected, where a name cannot be read: of a robot, a link, an axis."""
    if len(text.strip()) > 0 and len(text) <= LONGEST_NAME and not re.search(f"[{UNSEEN}]", text):
        return None
    return f"expected a name of 1 to {LONGEST_NAME} characters without hidden ones, found {reprlib.repr(text)}"


def check_array(source: object, field: str, values: np.ndarray, unit: str = "") -> None:
    """Raise :class:`InputError` where the largest finite magnitude of an array is out of the range of its unit."""
    finite = values[np.isfinite(values)]
    high = RANGES.get(unit, ANY)[1]
    if finite.size and max(abs(finite.max()), abs(finite.min())) > high:
        found = max(finite.max(), finite.min(), key=abs)
        raise InputError(str(source), field, f"expected {unit or 'numbers'} up to {high:g}, found {found:g}")


def check_size(source: object, field: str, count: int) -> None:
    """Raise :class:`InputError` for an array that is larger than what is read at once."""
    if count > MOST_VALUES:
        raise InputError(str(source), field, f"expected at most {MOST_VALUES} values, found {count}")


def check_band(option: str, band: tuple[float, float]) -> None:
    """Raise :class:`InputError` unless a band in Hz has a lower and an upper end."""
    low, high = band
    if not 0 <= low < high <= RANGES["Hz"][1]:
        raise InputError(option, f"{low:g} {high:g}", f"expected Hz, 0 ≤ low < high ≤ {RANGES['Hz'][1]:g}")


def check_count(name: str, value: float) -> None:
    """Raise :class:`InputError` for an option out of its range in ``COUNTS``."""
    low, high = COUNTS[name]
    if not low <= value <= high:
        found = f"{value:g}" if isinstance(value, float) else reprlib.repr(value)
        raise InputError(f"--{name.replace('_', '-')}", found, f"expected {low:g} to {high:g}")
