"""The stabilisation chart and the automatic choice of its physical poles.

Symbols as in commercial test software: a pole is compared with the nearest one of the order before.
``o`` new, ``f`` frequency stable, ``d`` frequency and damping, ``v`` frequency and vector, ``s`` all three.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from twin.measure.campaign import ComplexArray, FloatArray
from twin.measure.poles import Poles
from twin.measure.shapes import mac

FREQUENCY_TOLERANCE, DAMPING_TOLERANCE, VECTOR_TOLERANCE = 0.01, 0.05, 0.02
DAMPING_RANGE = (1e-4, 0.25)  # hard criterion on the ratio
CLUSTER_DISTANCE = 0.02  # relative difference of poles plus this times what the shapes differ in
CLUSTER_SHARE = 0.15  # of the orders that a physical pole must appear in


@dataclass(frozen=True)
class Chart:
    """Poles of every order and, for each, its symbol.

    Attributes:
        poles: one entry per order.
        symbols: one string per order, a character per pole.
    """

    poles: tuple[Poles, ...]
    symbols: tuple[str, ...]


@dataclass(frozen=True)
class Cluster:
    """A physical pole found over several orders.

    Attributes:
        pole: mean, rad/s.
        participation: (ni,) of the member nearest to the mean.
        count: orders it was found in.
        frequency_spread, damping_spread: standard deviations over the orders, Hz and ratio.
    """

    pole: complex
    participation: ComplexArray
    count: int
    frequency_spread: float
    damping_spread: float


def chart(poles: Sequence[Poles]) -> Chart:
    """Symbols for the poles of rising orders."""
    symbols: list[str] = []
    for k, now in enumerate(poles):
        before = poles[k - 1] if k else None
        if before is None or not before.poles.size or not now.poles.size:
            symbols.append("o" * now.poles.size)
            continue
        nearest = np.argmin(np.abs(now.poles[:, None] - before.poles), axis=1)
        f = np.abs(now.frequency / before.frequency[nearest] - 1) < FREQUENCY_TOLERANCE
        d = np.abs(now.damping / before.damping[nearest] - 1) < DAMPING_TOLERANCE
        v = 1 - _vector_mac(now, before)[np.arange(now.poles.size), nearest] < VECTOR_TOLERANCE
        symbols.append("".join(np.select([f & d & v, f & v, f & d, f], ["s", "v", "d", "f"], "o")))
    return Chart(tuple(poles), tuple(symbols))


def _vector_mac(a: Poles, b: Poles) -> FloatArray:
    """MAC of the residue matrices: the product of those of shapes and participation factors."""
    return mac(a.shape, b.shape) * mac(a.participation, b.participation)


def column_share(stabilisation: Chart, pole: complex) -> float:
    """Share of the orders that have a stable pole within half a bandwidth, or the frequency tolerance, of ``pole``."""
    within = max(-pole.real, FREQUENCY_TOLERANCE * abs(pole) / 2)
    hit = [
        bool(np.any(np.abs(np.abs(found.poles) - abs(pole))[[c in "dvs" for c in marks]] < within))
        for found, marks in zip(stabilisation.poles, stabilisation.symbols, strict=True)
    ]
    return float(np.mean(hit)) if sum(hit) >= 3 else 0.0


def clusters(stabilisation: Chart) -> list[Cluster]:
    """Physical poles of a chart: hard criteria, then columns of like poles over the orders, then mean and spread.

    Kept are stable poles (all symbols but o and f) of plausible damping. From the highest order down each joins the
    nearest column, or starts one; columns that appear in a fair share of the orders are physical.
    """
    columns = _Columns()
    for found, marks in zip(reversed(stabilisation.poles), reversed(stabilisation.symbols), strict=True):
        keep = np.array([c in "dvs" for c in marks], dtype=bool)
        keep &= (found.damping > DAMPING_RANGE[0]) & (found.damping < DAMPING_RANGE[1])
        columns.join(found, np.flatnonzero(keep))
    least = max(3, CLUSTER_SHARE * len(stabilisation.poles))
    result = []
    for members in columns.members:
        if len(members) < least:
            continue
        poles = np.array([found.poles[n] for found, n in members])
        centre = np.median(poles.real) + 1j * np.median(poles.imag)
        near = np.argsort(np.abs(poles - centre))[: max(1, poles.size // 2)]
        found, n = members[near[0]]
        frequency, damping = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
        spread = float(np.std(frequency)), float(np.std(damping))
        result.append(Cluster(complex(poles[near].mean()), found.participation[n], len(members), *spread))
    return sorted(result, key=lambda cluster: abs(cluster.pole))


class _Columns:
    """Columns of like poles, as they grow from order to order.

    Attributes:
        members: of each column, the poles as (what the order holds, index into it).
    """

    def __init__(self) -> None:
        self.members: list[list[tuple[Poles, int]]] = []
        self._last: Poles | None = None

    def join(self, found: Poles, kept: NDArray[np.intp]) -> None:
        """Give every kept pole of one order to the nearest column, each column at most one."""
        if not kept.size:
            return
        new = Poles(found.order, found.poles[kept], found.shape[kept], found.participation[kept])
        free = np.ones(kept.size, dtype=bool)
        if self._last is not None:
            last = self._last
            apart = np.abs(new.poles[:, None] - last.poles)
            apart /= np.minimum(np.abs(new.poles[:, None]), np.abs(last.poles))
            apart += CLUSTER_DISTANCE * (1 - _vector_mac(new, last))
            rows, columns = linear_sum_assignment(np.minimum(apart, 2 * CLUSTER_DISTANCE))
            for row, column in zip(rows, columns, strict=True):
                if apart[row, column] < CLUSTER_DISTANCE:
                    free[row] = False
                    self.members[column].append((found, int(kept[row])))
        self.members += [[(found, int(n))] for n in kept[free]]
        heads = [column[-1] for column in self.members]
        self._last = Poles(
            found.order,
            np.array([one.poles[n] for one, n in heads]),
            np.array([one.shape[n] for one, n in heads]),
            np.array([one.participation[n] for one, n in heads]),
        )
