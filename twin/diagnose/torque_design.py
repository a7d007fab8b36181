"""The whitened design matrix of a motion log's base model, of each joint only the columns that act there.

Most numbers of a base model (ripple, presliding, offsets) act on one joint alone: dense, two thirds would be zeros.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.measure.campaign import FloatArray


@dataclass(frozen=True)
class Design:
    """A matrix A (N, z) of N = n · count rows, joint by joint.

    Attributes:
        count: rows per joint.
        columns: per joint, which of the z columns act there; ``blocks`` (count, c) their rows, ``scale`` (z,) apart.
    """

    count: int
    columns: tuple[np.ndarray, ...]
    blocks: tuple[FloatArray, ...]
    scale: FloatArray

    @property
    def width(self) -> int:
        """Number of columns z."""
        return len(self.scale)

    def rows(self, joint: int) -> slice:
        """Rows of a joint."""
        return slice(joint * self.count, (joint + 1) * self.count)

    def times(self, z: FloatArray) -> FloatArray:
        """A z (N,)."""
        x = self.scale * z
        return np.concatenate([block @ x[at] for at, block in zip(self.columns, self.blocks, strict=True)])

    def transposed(self, y: FloatArray) -> FloatArray:
        """Aᵀ y (z,)."""
        out = np.zeros(self.width)
        for joint, (at, block) in enumerate(zip(self.columns, self.blocks, strict=True)):
            out[at] += y[self.rows(joint)] @ block
        return self.scale * out

    def across(self, joints: Sequence[int], rows: FloatArray) -> FloatArray:
        """Cᵀ A (k, z) of columns C whose rows (len(joints) · count, k) are on some joints, zero elsewhere."""
        out = np.zeros((rows.shape[1], self.width))
        for part, joint in enumerate(joints):
            at = self.columns[joint]
            out[:, at] += rows[part * self.count : (part + 1) * self.count].T @ self.blocks[joint]
        return np.asarray(out * self.scale)

    @cached_property
    def gram(self) -> FloatArray:
        """Aᵀ A (z, z)."""
        out = np.zeros((self.width, self.width))
        for at, block in zip(self.columns, self.blocks, strict=True):
            out[np.ix_(at, at)] += block.T @ block
        return np.asarray(self.scale[:, None] * out * self.scale)

    def scaled(self, factors: Mapping[int, float]) -> "Design":
        """Some columns multiplied by a factor."""
        factor = np.ones(self.width)
        factor[list(factors)] = list(factors.values())
        other = Design(self.count, self.columns, self.blocks, self.scale * factor)
        other.__dict__["gram"] = factor[:, None] * self.gram * factor
        return other

    def first(self, count: int) -> "Design":
        """Only the first of the z columns."""
        keep = [int(np.count_nonzero(at < count)) for at in self.columns]  # they are in order, what was added is last
        columns = tuple(at[:k] for at, k in zip(self.columns, keep, strict=True))
        blocks = tuple(block[:, :k] for block, k in zip(self.blocks, keep, strict=True))
        other = Design(self.count, columns, blocks, self.scale[:count])
        other.__dict__["gram"] = self.gram[:count, :count]
        return other

    def without(self, left_out: Sequence[int]) -> "Design":
        """All but some of the z columns, the others numbered anew."""
        kept = np.setdiff1d(np.arange(self.width), left_out)
        inside = [np.isin(at, kept) for at in self.columns]
        columns = tuple(np.searchsorted(kept, at[use]) for at, use in zip(self.columns, inside, strict=True))
        blocks = tuple(block[:, use] for block, use in zip(self.blocks, inside, strict=True))
        other = Design(self.count, columns, blocks, self.scale[kept])
        other.__dict__["gram"] = self.gram[np.ix_(kept, kept)]
        return other

    def beside(self, joints: Sequence[int], rows: FloatArray) -> "Design":
        """With more columns (len(joints) · count, k) on some joints, last."""
        columns, blocks = list(self.columns), list(self.blocks)
        new = np.arange(self.width, self.width + rows.shape[1])
        for part, joint in enumerate(joints):
            columns[joint] = np.concatenate([columns[joint], new])
            blocks[joint] = np.column_stack([blocks[joint], rows[part * self.count : (part + 1) * self.count]])
        other = Design(self.count, tuple(columns), tuple(blocks), np.concatenate([self.scale, np.ones(len(new))]))
        across = self.across(joints, rows)
        other.__dict__["gram"] = np.block([[self.gram, across.T], [across, rows.T @ rows]])
        return other
