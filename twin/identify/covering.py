"""Which postures cover the others best, where a hammer test has more than a search can work on."""

from collections.abc import Sequence

import numpy as np

from twin.measure.campaign import FloatArray
from twin.ranges import SEARCHED

FEWEST_POSTURES = 6  # postures that are worked on, however large


def many(sizes: Sequence[int]) -> bool:
    """Whether postures with so many lines of FRFs are more than a search can work on."""
    return sum(sizes) > SEARCHED and len(sizes) > FEWEST_POSTURES


def covering(sizes: Sequence[int], angles: FloatArray, first: Sequence[int] = ()) -> list[int]:
    """Indices of the postures that a search works on, of :func:`many`.

    The first is the one nearest to the middle of all. Each next is the one farthest from those chosen.

    Args:
        sizes: lines of all FRFs of every posture.
        angles: (n, axes) rad (m).
        first: postures that are worked on in any case, in place of the middle one.
    """
    chosen = list(first) or [int(np.argmin(np.linalg.norm(angles - angles.mean(axis=0), axis=1)))]
    gap = np.min([np.linalg.norm(angles - angles[k], axis=1) for k in chosen], axis=0)
    while len(chosen) < len(sizes):
        k = int(np.argmax(gap))
        if len(chosen) >= FEWEST_POSTURES and sum(sizes[j] for j in (*chosen, k)) > SEARCHED:
            break
        chosen.append(k)
        gap = np.minimum(gap, np.linalg.norm(angles - angles[k], axis=1))
    return chosen
