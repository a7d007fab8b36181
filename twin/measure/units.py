"""Units that files are in: what each measures, and the factor to SI. One that is not here is refused, not guessed."""

import math
import re

STANDARD_GRAVITY = 9.80665  # m/s², exact (CGPM 1901)
POUND_FORCE_N = 4.4482216152605  # exact: 0.45359237 kg · 9.80665 m/s²
INCH_M = 0.0254
ASK = "ask"

UNITS: dict[str, tuple[str, float]] = {
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180),
    "°": ("angle", math.pi / 180),
    "rev": ("angle", 2 * math.pi),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "um": ("length", 1e-6),
    "in": ("length", INCH_M),
    "rad/s": ("angular velocity", 1.0),
    "deg/s": ("angular velocity", math.pi / 180),
    "°/s": ("angular velocity", math.pi / 180),
    "rpm": ("angular velocity", 2 * math.pi / 60),
    "m/s": ("velocity", 1.0),
    "mm/s": ("velocity", 1e-3),
    "in/s": ("velocity", INCH_M),
    "rad/s2": ("angular acceleration", 1.0),
    "deg/s2": ("angular acceleration", math.pi / 180),
    "°/s2": ("angular acceleration", math.pi / 180),
    "m/s2": ("acceleration", 1.0),
    "mm/s2": ("acceleration", 1e-3),
    "in/s2": ("acceleration", INCH_M),
    "g": ("acceleration", STANDARD_GRAVITY),
    "gn": ("acceleration", STANDARD_GRAVITY),
    "mg": ("acceleration", 1e-3 * STANDARD_GRAVITY),
    "N": ("force", 1.0),
    "kN": ("force", 1e3),
    "mN": ("force", 1e-3),
    "lbf": ("force", POUND_FORCE_N),
    "kgf": ("force", STANDARD_GRAVITY),
    "Nm": ("torque", 1.0),
    "kNm": ("torque", 1e3),
    "Nmm": ("torque", 1e-3),
    "lbfin": ("torque", POUND_FORCE_N * INCH_M),
    "lbfft": ("torque", POUND_FORCE_N * 12 * INCH_M),
    "s": ("time", 1.0),
    "sec": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "Hz": ("frequency", 1.0),
    "kHz": ("frequency", 1e3),
}
QUANTITY = {"acceleration": "accelerance", "velocity": "mobility", "length": "receptance"}
_SPELT = str.maketrans({"²": "2", "^": "", "*": "", "·": "", "⋅": "", " ": "", "µ": "u", "μ": "u", "(": "", ")": ""})


def factor(unit: str, *expected: str) -> float:
    """What a number in ``unit`` is multiplied by to be SI.

    Raises:
        ValueError: the unit is not known, or measures none of the quantities ``expected``.
    """
    measures, value = measure(unit, *expected)
    if measures not in expected:
        raise ValueError(f"expected a unit of {' or '.join(expected)}, found {unit!r}, which is one of {measures}")
    return value


def measure(unit: str, *expected: str) -> tuple[str, float]:
    """What a unit measures, and its factor to SI.

    Raises:
        ValueError: the unit is not known, or is still to be stated; those that measure ``expected`` are listed.
    """
    those = ", ".join(sorted(name for name, (measures, _) in UNITS.items() if not expected or measures in expected))
    if unit.strip().lower() in (ASK, ""):
        raise ValueError(f"state the unit; it is never guessed (one of {those})")
    if not known(unit):
        raise ValueError(f"unknown unit {unit!r}; expected one of {those}")
    return UNITS[_named(unit)]


def known(unit: str) -> bool:
    """Whether a spelling is that of a unit."""
    return _named(unit) in UNITS


def _named(unit: str) -> str:
    return re.sub(r"(?i)^(lb)(?=in|ft|$)", "lbf", _spelt(unit))


def frf_factor(unit: str) -> tuple[str, float]:
    """Quantity (``accelerance`` …) and factor to SI of an FRF in ``unit``, as ``g/lbf`` or ``(m/s²)/N``.

    Raises:
        ValueError: the unit is not response over force.
    """
    if unit.strip().lower() in (ASK, ""):
        raise ValueError("state the unit, as (m/s²)/N or g/lbf; it is never guessed")
    above, _, below = unit.rpartition("/")
    response, up = measure(above)
    if response not in QUANTITY:
        raise ValueError(f"expected acceleration, velocity or displacement over force, found {unit!r}")
    return QUANTITY[response], up / factor(below, "force")


def same(one: str, other: str) -> bool:
    """Whether two spellings are one unit; spellings that are not known are compared as they stand."""
    try:
        return measure(one) == measure(other)
    except ValueError:
        return _spelt(one) == _spelt(other)


def _spelt(unit: str) -> str:
    return unit.translate(_SPELT).replace("degrees", "deg").replace("degree", "deg")
