"""Stability lobes: the limit in depth over spindle speed, how it is reached, and the depth that is 90 % sure.

At each speed all limits in depth are found at once (:mod:`twin.milling.stability`), so that none hides below another.
Between speeds, a lobe or an island is as wide as the resonance that makes it, 2ζ of its speed; the speeds are spaced by
no more than half of that, and a cell whose middle is not where its ends say is halved until it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from twin.milling.cut import Cut
from twin.milling.stability import DIGITS, Limits, limits
from twin.milling.tool_point import ToolModes
from twin.parallel import cores, spread

TOLERANCE = 1e-3  # of the limit, by which the middle of a cell may be off
COARSEST = 0.02  # of the speed, between two speeds
MOST_SPEEDS = 3000
ROUNDS = 6  # of halving cells
HELIX_STEP = 0.1  # of ln depth, to which the lag of a helix is rounded on the way
HELIX_ROUNDS = 6
BAND_ROWS = 12000  # draws times speeds of a band
BAND_DIGITS = 2.0
MOST_BAND_SPEEDS = 120
BAND_BATCH = 800  # of these rows taken together
SAFE = 0.9  # probability
_COLUMNS = ("row", "depth_m", "angle", "change", "frequency_hz", "kind")


@dataclass(frozen=True)
class Lobes:
    """Limits over spindle speed.

    Attributes:
        spindle_rpm: (ns,), rising.
        depth_m: (ns,) first limit; ``depth_max_m`` where there is none below.
        kind: (ns,) ``hopf``, ``flip``, ``mode_coupling``, or ``none``.
        frequency_hz: (ns,) of the vibration at the limit; NaN where there is none.
        limits: every limit up to ``depth_max_m`` at every speed.
        safe_m: (ns,) stable with 90 % probability, or ``None``.
        draws_m: (nd, nb) limits of the draws at ``draws_rpm`` (nb,), or ``None``.
        unresolved: cells that were still off when ``MOST_SPEEDS`` was reached.
    """

    spindle_rpm: np.ndarray
    depth_m: np.ndarray
    kind: np.ndarray
    frequency_hz: np.ndarray
    limits: Limits
    depth_max_m: float
    safe_m: np.ndarray | None = None
    draws_m: np.ndarray | None = None
    draws_rpm: np.ndarray | None = None
    unresolved: int = 0

    def best(self) -> int:
        """The speed of the deepest cut: index, by what is sure where that is known."""
        return int(np.argmax(self.depth_m if self.safe_m is None else self.safe_m))

    def productive(self) -> int:
        """The speed that removes most: index; depth times feed speed, by what is sure where that is known."""
        return int(np.argmax((self.depth_m if self.safe_m is None else self.safe_m) * self.spindle_rpm))


def lobes_of(
    modes: ToolModes, cut: Cut, *, speeds: np.ndarray | None = None, progress: Callable[[int], None] | None = None
) -> Lobes:
    """Trace the limits over the cut's spindle speeds, to ``TOLERANCE``, or at given ``speeds`` (ns,) rpm.

    Args:
        modes: in the cut frame, without leading axes.
        progress: called with the number of speeds done since the last call.
    """
    tell = progress or (lambda count: None)
    at = starting_speeds(modes, cut) if speeds is None else np.asarray(speeds, float)
    found = limits_at(modes, cut, at)
    tell(len(at))
    unresolved = 0
    fresh = np.ones(len(at) - 1, bool)
    for _ in range(ROUNDS if speeds is None else 0):
        cell = np.flatnonzero(fresh)
        if not len(cell):
            break
        if len(at) + len(cell) > MOST_SPEEDS:
            unresolved = len(cell)
            break
        middle = 0.5 * (at[cell] + at[cell + 1])
        new = limits_at(modes, cut, middle)
        tell(len(middle))
        off = _off(found, new, cell, cut.depth_max_m)
        at, found, position = _merged(at, found, middle, new)
        fresh = np.zeros(len(at) - 1, bool)
        halves = position[off]  # the new speeds, on either side of which it goes on
        fresh[halves] = fresh[halves - 1] = True
    return _of(at, found, cut, unresolved)


def starting_speeds(modes: ToolModes, cut: Cut) -> np.ndarray:
    """Speeds (ns,) rpm spaced by half the width of the narrowest resonance that can make a lobe there.

    A mode makes lobes and islands where it turns by a quarter of a period or more from tooth to tooth; slower ones
    only couple, which changes with the speed itself.
    """
    low, high = cut.spindle_rpm
    size = np.abs(modes.pole)
    narrow = np.maximum(-modes.pole.real / size, 1e-4)
    edges = np.geomspace(low, high, 40)
    out = [np.array([low])]
    for start, end in pairwise(edges):
        turning = size * float(cut.tooth_period(end)) >= np.pi / 2
        step = min(COARSEST, float(narrow[turning].min(initial=COARSEST)))
        out.append(np.geomspace(start, end, int(np.ceil(np.log(end / start) / step)) + 1)[1:])
    found = np.concatenate(out)
    if len(found) > MOST_SPEEDS // 2:
        found = np.geomspace(low, high, MOST_SPEEDS // 2)
    return found


def limits_at(
    modes: ToolModes,
    cut: Cut,
    spindle_rpm: np.ndarray,
    *,
    shear: np.ndarray | None = None,
    digits: float = DIGITS,
) -> Limits:
    """Limits (S speeds) up to the cut's depth of interest; with a helix, its lag is that at the first limit.

    A helix spreads a tooth over an angle that grows with the depth: the limit is sought again with the lag at the limit
    found, rounded to ``HELIX_STEP``, until it stays.
    """
    spindle_rpm = np.asarray(spindle_rpm, float)
    deepest = cut.depth_max_m
    if not cut.tool.helix_deg:
        return limits(modes, cut, spindle_rpm, deepest, shear=shear, digits=digits)
    straight = cut.model_copy(update={"tool": cut.tool.model_copy(update={"helix_deg": 0.0})})
    found = limits(modes, straight, spindle_rpm, deepest, shear=shear, digits=digits)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(spindle_rpm), 3))

    def at_level(level: np.ndarray, rows: np.ndarray) -> list[tuple[np.ndarray, Limits]]:
        parts = []
        for number in np.unique(level[rows]):
            here = rows[level[rows] == number]
            lag_depth = float(np.exp(number * HELIX_STEP))
            part = limits(
                modes.rows(here), cut, spindle_rpm[here], deepest,
                shear=shear[here], lag_depth_m=lag_depth, digits=digits,
            )  # fmt: skip
            parts.append((here, part))
        return parts

    level = np.full(len(spindle_rpm), np.iinfo(int).min // 2)
    for round_ in range(HELIX_ROUNDS):
        wanted = np.round(np.log(np.minimum(found.first(), deepest)) / HELIX_STEP).astype(int)
        rows = np.flatnonzero(np.abs(wanted - level) > (1 if round_ else 0))  # no row is sent to and fro
        if not len(rows):
            break
        level[rows] = wanted[rows]
        found = _replaced(found, at_level(level, rows))
    # the limit d(l) is known at the lag l of one level; with a second, d(l) = l is solved by the chord
    d1, l1 = np.log(found.first()), level * HELIX_STEP
    second = level + np.where(d1 >= l1, 1, -1)
    other = _replaced(found, at_level(second, np.arange(len(level))))
    d2, l2 = np.log(other.first()), second * HELIX_STEP
    with np.errstate(invalid="ignore"):  # where there is no limit
        sure = np.abs(d2 - d1) < 0.5 * HELIX_STEP
    slope = (np.where(sure, d2, 0.0) - np.where(sure, d1, 0.0)) / (l2 - l1)
    step = slope * (np.where(sure, d1, l1) - l1) / (1 - slope)
    return replace(found, depth_m=found.depth_m * np.exp(step)[found.row])


def _replaced(found: Limits, parts: list[tuple[np.ndarray, Limits]]) -> Limits:
    """Limits with some rows found anew."""
    gone = np.zeros(found.count, bool)
    for rows, _ in parts:
        gone[rows] = True
    kept = ~gone[found.row]
    columns = []
    for name in _COLUMNS:
        old = getattr(found, name)[kept]
        new = [rows[part.row] if name == "row" else getattr(part, name) for rows, part in parts]
        columns.append(np.concatenate([old, *new]))
    order = np.lexsort((columns[1], columns[0]))
    return Limits(found.count, *(column[order] for column in columns))


def _merged(at: np.ndarray, found: Limits, middle: np.ndarray, new: Limits) -> tuple[np.ndarray, Limits, np.ndarray]:
    """Speeds and limits of both, by speed, and where the new ones have gone."""
    both = np.concatenate([at, middle])
    order = np.argsort(both)
    place = np.empty(len(both), int)
    place[order] = np.arange(len(both))
    empty = Limits(len(both), *(getattr(found, name)[:0] for name in _COLUMNS))
    old, fresh = place[: len(at)], place[len(at) :]
    return both[order], _replaced(empty, [(old, found), (fresh, new)]), fresh


def _off(found: Limits, new: Limits, cell: np.ndarray, deepest: float) -> np.ndarray:
    """Cells (indices into ``cell``) in whose middle the first limit, or the number of limits, is not as at the ends."""
    first, middle = np.minimum(found.first(), deepest), np.minimum(new.first(), deepest)
    straight = 0.5 * (first[cell] + first[cell + 1])
    count = np.bincount(found.row, minlength=found.count)
    middle_count = np.bincount(new.row, minlength=new.count)
    differs = (middle_count != count[cell]) & (middle_count != count[cell + 1])
    return np.flatnonzero((np.abs(middle - straight) > TOLERANCE * middle) | differs)


def _of(at: np.ndarray, found: Limits, cut: Cut, unresolved: int) -> Lobes:
    depth = found.first()
    kind, frequency = np.full(len(at), "none", dtype="<U13"), np.full(len(at), np.nan)
    lowest = np.unique(found.row, return_index=True)[1]
    kind[found.row[lowest]], frequency[found.row[lowest]] = found.kind[lowest], found.frequency_hz[lowest]
    return Lobes(at, np.minimum(depth, cut.depth_max_m), kind, frequency, found, cut.depth_max_m, unresolved=unresolved)


def band_speeds(found: Lobes, draws: int) -> np.ndarray:
    """Indices (nb,) of the speeds at which the limits of so many draws are found; in between they are interpolated."""
    count = min(max(BAND_ROWS // draws, 16), MOST_BAND_SPEEDS, len(found.spindle_rpm))
    return np.unique(np.round(np.linspace(0, len(found.spindle_rpm) - 1, count)).astype(int))


def with_band(
    found: Lobes, draws: ToolModes, cut: Cut, shear: np.ndarray, *, progress: Callable[[int], None] | None = None
) -> Lobes:
    """Lobes with the depth that is stable with 90 % probability.

    Args:
        found: of the nominal model.
        draws: modes (nd, nm) in the cut frame, each as probable as the others.
        shear: (nd, 3) N/m², a draw of the coefficients for each.
        progress: called with the number of speeds done since the last call.
    """
    nd = len(draws.pole)
    pick = band_speeds(found, nd)
    rpm = found.spindle_rpm[pick]
    # a helix lags as at the nominal limit
    level = np.round(np.log(found.depth_m[pick]) / HELIX_STEP).astype(int) * (1 if cut.tool.helix_deg else 0)
    groups = [np.flatnonzero(level == number) for number in np.unique(level)]
    parts = [part for group in groups for part in np.array_split(group, -(-len(group) * nd // BAND_BATCH))]

    def some(number: int) -> np.ndarray:
        part = parts[number]
        lag_depth = float(np.exp(level[part[0]] * HELIX_STEP)) if cut.tool.helix_deg else 0.0
        rows = np.repeat(np.arange(nd), len(part))
        limit = limits(
            draws.rows(rows), cut, np.tile(rpm[part], nd), cut.depth_max_m,
            shear=shear[rows], lag_depth_m=lag_depth, digits=BAND_DIGITS,
        )  # fmt: skip
        return np.minimum(limit.first(), cut.depth_max_m).reshape(nd, len(part))

    depth = np.empty((nd, len(rpm)))
    for part, values in zip(parts, spread(some, len(parts), cores()), strict=True):
        depth[:, part] = values
        if progress:
            progress(len(part))
    safe = np.quantile(depth, 1 - SAFE, axis=0)
    everywhere = np.exp(np.interp(np.log(found.spindle_rpm), np.log(rpm), np.log(safe)))
    return replace(found, safe_m=everywhere, draws_m=depth, draws_rpm=rpm)
