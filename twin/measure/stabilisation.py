"""The stabilisation chart and the automatic choice of its physical poles.

Symbols as in commercial test software: a pole is compared with the nearest one of the order before.
``o`` new, ``f`` frequency stable, ``d`` frequency and damping, ``v`` frequency and vector, ``s`` all three.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.measure.campaign import ComplexArray, FloatArray
from twin.measure.poles import Poles
from twin.measure.shapes import mac

FREQUENCY_TOLERANCE, DAMPING_TOLERANCE, VECTOR_TOLERANCE = 0.01, 0.05, 0.02
DAMPING_RANGE = (1e-4, 0.25)  # hard criterion on the ratio
CLUSTER_DISTANCE = 0.03  # relative difference of poles plus what the shapes differ in
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


def clusters(stabilisation: Chart) -> list[Cluster]:
    """Physical poles of a chart: hard criteria, then clustering over the orders, then mean and spread.

    Kept are stable poles (all symbols but o and f) of plausible damping; average-linkage groups of them that appear
    in a fair share of the orders are physical.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    keep = [
        (np.array([c in "dvs" for c in marks], dtype=bool))
        & (found.damping > DAMPING_RANGE[0])
        & (found.damping < DAMPING_RANGE[1])
        for found, marks in zip(stabilisation.poles, stabilisation.symbols, strict=True)
    ]
    pole = np.concatenate([p.poles[k] for p, k in zip(stabilisation.poles, keep, strict=True)])
    if pole.size < 2:
        return []
    shape = np.concatenate([p.shape[k] for p, k in zip(stabilisation.poles, keep, strict=True)])
    part = np.concatenate([p.participation[k] for p, k in zip(stabilisation.poles, keep, strict=True)])
    order = np.concatenate([np.full(int(k.sum()), p.order) for p, k in zip(stabilisation.poles, keep, strict=True)])
    difference = np.abs(pole[:, None] - pole) / np.minimum(np.abs(pole[:, None]), np.abs(pole))
    distance = difference + CLUSTER_DISTANCE * (1 - mac(shape) * mac(part))
    label = fcluster(linkage(distance[np.triu_indices(pole.size, 1)], "average"), CLUSTER_DISTANCE, "distance")
    result = []
    for one in np.unique(label):
        members = np.flatnonzero(label == one)
        count = np.unique(order[members]).size
        if count < max(3, CLUSTER_SHARE * len(stabilisation.poles)):
            continue
        centre = np.median(pole[members].real) + 1j * np.median(pole[members].imag)
        near = members[np.argsort(np.abs(pole[members] - centre))[: max(1, members.size // 2)]]
        mean = complex(pole[near].mean())
        frequency, damping = np.abs(pole[members]) / (2 * np.pi), -pole[members].real / np.abs(pole[members])
        result.append(Cluster(mean, part[near[0]], count, float(np.std(frequency)), float(np.std(damping))))
    return sorted(result, key=lambda cluster: abs(cluster.pole))
