"""A structure as points and lines, and its mode shapes as motions of the points: what a drawing needs, nothing drawn.

Points are nodes of a recording in one frame. Lines are the recording's own; where it has none, every point is joined to
its nearest neighbours and the whole to one piece.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import LABEL, Channels, ComplexArray, FloatArray

NEAR = 1.3  # times the distance to the nearest point: lines drawn where the recording has none
DRAWN = 0.12  # largest motion drawn, as a share of the structure's extent


@dataclass(frozen=True)
class Wireframe:
    """A structure with nn points and nl lines, moving in nm shapes.

    Attributes:
        node: (nn,) numbers.
        position: (nn, 3) m.
        lines: (nl, 2) indices of points.
        motion: (nm, nn, 3) complex, largest of each shape 1; zero in directions that were not measured.
    """

    node: NDArray[np.intp]
    position: FloatArray
    lines: NDArray[np.intp]
    motion: ComplexArray

    @property
    def extent(self) -> float:
        """Diagonal of the box around the points, m."""
        return float(np.linalg.norm(np.ptp(self.position, axis=0)))

    def displaced(self, mode: int, phase_rad: float) -> FloatArray:
        """(nn, 3) where the points are in a mode, drawn ``DRAWN`` times the extent large."""
        return np.asarray(self.position + DRAWN * self.extent * (self.motion[mode] * np.exp(1j * phase_rad)).real)


def wireframe(channels: Channels, shapes: ComplexArray, lines: Sequence[Sequence[int]] = ()) -> Wireframe | str:
    """The structure of channels with shapes (nm, n), or in words why there is none.

    Args:
        channels: n, all on one body.
        shapes: over the channels.
        lines: polylines over node numbers.
    """
    if len(set(channels.body)) > 1:
        return f"points are in the frames of {len(set(channels.body))} bodies"
    number = np.array([int(found[1]) if (found := LABEL.fullmatch(x)) else 0 for x in channels.label])
    node, first, which = np.unique(number, return_index=True, return_inverse=True)
    position = channels.position[first]
    if node.size < 2 or np.ptp(position, axis=0).max() == 0:
        return "the recording does not say where its points are (data sets 15 or 2411, or response/position)"
    motion = np.zeros((shapes.shape[0], node.size, 3), dtype=complex)
    for k, direction in enumerate(channels.direction):
        motion[:, which[k]] += shapes[:, k, None] * direction
    largest = np.linalg.norm(motion, axis=2).max(axis=1, initial=0.0)
    motion /= np.where(largest > 0, largest, 1)[:, None, None]
    at = {int(n): k for k, n in enumerate(node)}
    given = [(at[a], at[b]) for line in lines for a, b in pairwise(line) if a in at and b in at and a != b]
    edges = np.array(given, dtype=np.intp) if given else _neighbours(position)
    return Wireframe(node, position, edges, motion)


def _neighbours(position: FloatArray) -> NDArray[np.intp]:
    """(nl, 2): the shortest lines that hold all points together, and each point's nearest neighbours."""
    from scipy.sparse.csgraph import minimum_spanning_tree
    from scipy.spatial.distance import cdist

    apart = cdist(position, position)
    tree = np.argwhere(minimum_spanning_tree(apart + 1e-9 * (apart.max() or 1.0)).toarray() > 0)
    away = apart + np.where(np.eye(len(position), dtype=bool), np.inf, 0)
    near = np.argwhere(away <= NEAR * np.minimum(away.min(axis=1)[:, None], away.min(axis=0)))
    return np.unique(np.sort(np.concatenate([tree, near]), axis=1), axis=0).astype(np.intp)
