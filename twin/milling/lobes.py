"""Stability lobes: the limit in depth over spindle speed, how it is reached, and the depth that is 90 % sure.

At each speed all limits in depth are found at once (:mod:`twin.milling.stability`), so that none hides below another.
Over the speed, a lobe or an island is as wide as the resonance that makes it, 2ζ of its speed. The speeds are spaced by
no more than half of that. A cell whose middle is not where its ends say is halved until it is.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from twin.milling.cut import Cut
from twin.milling.forces import lag
from twin.milling.stability import DIGITS, Limits, first_limits, limits
from twin.milling.tool_point import ToolModes
from twin.parallel import cores, spread

TOLERANCE = 1e-3  # of the limit, by which the middle of a cell may be off
COARSEST = 0.02  # of the speed, between two speeds
MOST_SPEEDS = 3000
PART = 64  # speeds whose limits are found together
ROUNDS = 6  # of halving cells
LAG, LAG_EVEN = 0.05, 0.5  # rad, to which the lag of a helix is rounded on the way; beyond so much, in its logarithm
LARGEST = 0.1  # of ln depth between two levels of lag, on one branch
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
        progress: called with the number of starting (or given) speeds done since the last call.
    """
    at = starting_speeds(modes, cut) if speeds is None else np.asarray(speeds, float)
    found = _by_parts(modes, cut, at, progress or _silent)
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
        new = _by_parts(modes, cut, middle, _silent)
        off = _off(found, new, cell, cut.depth_max_m)
        at, found, position = _merged(at, found, middle, new)
        fresh = np.zeros(len(at) - 1, bool)
        halves = position[off]  # the new speeds, on either side of which it goes on
        fresh[halves] = fresh[halves - 1] = True
    return _of(at, found, cut, unresolved)


def _silent(count: int) -> None:
    """Tells nobody: what a refinement adds was not counted."""


def _by_parts(modes: ToolModes, cut: Cut, speeds: np.ndarray, tell: Callable[[int], None]) -> Limits:
    """:func:`limits_at` of some speeds at a time, spread over processes."""
    parts = np.array_split(np.arange(len(speeds)), -(-len(speeds) // PART))
    found = []
    for part, some in zip(
        parts, spread(lambda k: limits_at(modes, cut, speeds[parts[k]]), len(parts), cores()), strict=True
    ):
        found.append((part, some))
        tell(len(part))
    empty = Limits(len(speeds), *(getattr(found[0][1], name)[:0] for name in _COLUMNS))
    return _replaced(empty, found)


def starting_speeds(modes: ToolModes, cut: Cut) -> np.ndarray:
    """Speeds (ns,) rpm spaced by half the width of the narrowest resonance that can make a lobe there.

    A mode makes lobes and islands where it turns by a quarter of a period or more from tooth to tooth. Slower ones only
    couple, and that changes with the speed itself.
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
    """Limits (S speeds) up to the cut's depth of interest; with a helix, its lag is that at the first limit."""
    rpm, deepest = np.asarray(spindle_rpm, float), cut.depth_max_m
    if not cut.tool.helix_deg:
        return limits(modes, cut, rpm, deepest, shear=shear, digits=digits)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(rpm), 3))
    kept: dict[int, Limits] = {}

    def first(rows: np.ndarray, number: int, lag_depth_m: float) -> np.ndarray:
        part = limits(
            modes.rows(rows), cut, rpm[rows], deepest, shear=shear[rows], lag_depth_m=lag_depth_m, digits=digits
        )
        empty = Limits(len(rpm), *(getattr(part, name)[:0] for name in _COLUMNS))
        kept[number] = _replaced(kept.get(number, empty), [(rows, part)])
        return part.first()

    level, _, share = _with_lag(first, cut, len(rpm))
    parts = []
    for number in np.unique(level):
        rows, known = np.flatnonzero(level == number), kept[number]
        own = np.isin(known.row, rows)
        parts.append((rows, Limits(len(rows), np.searchsorted(rows, known.row[own]),
                                   *(getattr(known, name)[own] for name in _COLUMNS[1:]))))  # fmt: skip
    empty = Limits(len(rpm), *(getattr(parts[0][1], name)[:0] for name in _COLUMNS))
    found = _replaced(empty, parts)
    return replace(found, depth_m=found.depth_m * share[found.row])


def first_at(
    modes: ToolModes, cut: Cut, spindle_rpm: np.ndarray, *, shear: np.ndarray | None = None, digits: float = DIGITS
) -> np.ndarray:
    """First limits (S,) m alone, infinite where there is none up to the cut's depth of interest; with the helix's lag.

    Args:
        modes: in the cut frame, pole (S, nm) or (nm,).
        shear: (S, 3) or (3,) N/m², by default the cut's.
    """
    rpm, deepest = np.asarray(spindle_rpm, float), cut.depth_max_m
    if not cut.tool.helix_deg:
        return first_limits(modes, cut, rpm, deepest, shear=shear, digits=digits)
    shear = np.broadcast_to(cut.coefficients.shear if shear is None else shear, (len(rpm), 3))

    def first(rows: np.ndarray, number: int, lag_depth_m: float) -> np.ndarray:
        return first_limits(
            modes.rows(rows), cut, rpm[rows], deepest, shear=shear[rows], lag_depth_m=lag_depth_m, digits=digits
        )

    _, depth, share = _with_lag(first, cut, len(rpm))
    return depth * share


def _with_lag(
    first: Callable[[np.ndarray, int, float], np.ndarray], cut: Cut, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First limits of a helix, whose lag depends on them.

    A helix spreads a tooth over an angle that grows with the depth. The limit is sought with straight teeth first. Then
    it is sought with the lag at the limit found, rounded to a level, until it stays. Between that level and the next,
    the depth whose own lag it is lies on the chord.

    Args:
        first: limits (n,) m of rows (n,) at a level of lag, and the depth m that this lag is of (0: straight).

    Returns:
        level (count,) of the last lag, limits (count,) m there, and the factor (count,) from them to the solution.
    """
    every, deepest, per_m = np.arange(count), cut.depth_max_m, lag(cut, 1.0)
    level, depth = np.zeros(count, int), first(np.arange(count), 0, 0.0)

    def levels(depth_m: np.ndarray) -> np.ndarray:
        angle = np.minimum(depth_m, deepest) * per_m
        return np.where(angle < LAG_EVEN, angle, LAG_EVEN * (1 + np.log(np.maximum(angle, LAG_EVEN) / LAG_EVEN))) / LAG

    def at(levels: np.ndarray, rows: np.ndarray) -> np.ndarray:
        out = np.empty(len(rows))
        for number in np.unique(levels[rows]):
            here, angle = levels[rows] == number, number * LAG
            angle = angle if angle < LAG_EVEN else LAG_EVEN * np.exp(angle / LAG_EVEN - 1)
            out[here] = first(rows[here], int(number), float(angle / per_m))
        return out

    for round_ in range(HELIX_ROUNDS):
        wanted = np.round(levels(depth)).astype(int)
        rows = np.flatnonzero(np.abs(wanted - level) > (1 if round_ else 0))  # no row is sent to and fro
        if not len(rows):
            break
        level[rows] = wanted[rows]
        depth[rows] = at(level, rows)
    second = np.maximum(level + np.where(levels(depth) >= level, 1, -1), 0)
    other = at(second, every)
    with np.errstate(invalid="ignore", divide="ignore"):  # where there is no limit
        change = np.log(other) - np.log(depth)
        sure = (np.abs(change) < LARGEST) & (second != level)
        off, other_off = levels(depth) - level, levels(other) - second
        share = np.where(sure, off / (off - other_off), 0.0)
    return level, depth, np.exp(np.where(sure, share * change, 0.0))


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
    parts = np.array_split(np.arange(len(rpm)), -(-len(rpm) * nd // BAND_BATCH))

    def some(number: int) -> np.ndarray:
        part = parts[number]
        rows = np.repeat(np.arange(nd), len(part))
        limit = first_at(draws.rows(rows), cut, np.tile(rpm[part], nd), shear=shear[rows], digits=BAND_DIGITS)
        return np.minimum(limit, cut.depth_max_m).reshape(nd, len(part))

    depth = np.empty((nd, len(rpm)))
    for part, values in zip(parts, spread(some, len(parts), cores()), strict=True):
        depth[:, part] = values
        if progress:
            progress(len(part))
    safe = np.quantile(depth, 1 - SAFE, axis=0)
    everywhere = np.exp(np.interp(np.log(found.spindle_rpm), np.log(rpm), np.log(safe)))
    return replace(found, safe_m=everywhere, draws_m=depth, draws_rpm=rpm)
