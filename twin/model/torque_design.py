"""The whitened design matrix of a motion log's base model, of each joint only the columns that act there.

Most numbers of a base model (ripple, presliding, offsets) act on one joint alone: dense, two thirds would be zeros.
Columns of what is found stand beside those of the base model, which all models that are compared share and none copies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.measure.campaign import FloatArray


@dataclass(frozen=True)
class Block:
    """Some columns on one joint: ``columns`` (c,) which of the z they are, ``rows`` (count, c)."""

    joint: int
    columns: np.ndarray
    rows: FloatArray


@dataclass(frozen=True)
class Design:
    """A matrix A (N, z) of N = n · count rows, joint by joint.

    Attributes:
        count: rows per joint.
        joints: their number n.
        blocks: which together are the matrix; ``scale`` (z,) of the columns, apart.
    """

    count: int
    joints: int
    blocks: tuple[Block, ...]
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
        x, out = self.scale * z, np.zeros(self.joints * self.count)
        for block in self.blocks:
            out[self.rows(block.joint)] += block.rows @ x[block.columns]
        return out

    def transposed(self, y: FloatArray) -> FloatArray:
        """Aᵀ y (z,)."""
        out = np.zeros(self.width)
        for block in self.blocks:
            out[block.columns] += y[self.rows(block.joint)] @ block.rows
        return self.scale * out

    def across(self, joints: Sequence[int], rows: FloatArray) -> FloatArray:
        """Cᵀ A (k, z) of columns C whose rows (len(joints) · count, k) are on some joints, zero elsewhere."""
        out = np.zeros((rows.shape[1], self.width))
        place = {joint: self.rows(part) for part, joint in enumerate(joints)}
        for block in self.blocks:
            if block.joint in place:
                out[:, block.columns] += rows[place[block.joint]].T @ block.rows
        return np.asarray(out * self.scale)

    @cached_property
    def gram(self) -> FloatArray:
        """Aᵀ A (z, z)."""
        out = np.zeros((self.width, self.width))
        for a in self.blocks:
            for b in self.blocks:
                if a.joint == b.joint:
                    out[np.ix_(a.columns, b.columns)] += a.rows.T @ b.rows
        return np.asarray(self.scale[:, None] * out * self.scale)

    def scaled(self, factors: Mapping[int, float]) -> "Design":
        """Some columns multiplied by a factor."""
        factor = np.ones(self.width)
        factor[list(factors)] = list(factors.values())
        other = Design(self.count, self.joints, self.blocks, self.scale * factor)
        other.__dict__["gram"] = factor[:, None] * self.gram * factor
        return other

    def first(self, count: int) -> "Design":
        """Only the first of the z columns."""
        return self.without(range(count, self.width))

    def without(self, left_out: Sequence[int]) -> "Design":
        """All but some of the z columns, the others numbered anew."""
        stays = np.ones(self.width, bool)
        stays[list(left_out)] = False
        number, blocks = np.cumsum(stays) - 1, []
        for block in self.blocks:
            use = stays[block.columns]
            if use.any():
                rows = block.rows if use.all() else block.rows[:, use]
                blocks.append(Block(block.joint, number[block.columns[use]], rows))
        other = Design(self.count, self.joints, tuple(blocks), self.scale[stays])
        other.__dict__["gram"] = self.gram[np.ix_(stays, stays)]
        return other

    def beside(self, *more: tuple[Sequence[int], FloatArray]) -> "Design":
        """With more columns last, each of ``more`` (len(joints) · count, k) on some joints."""
        blocks, at = list(self.blocks), self.width
        for joints, rows in more:
            new = np.arange(at, at + rows.shape[1])
            blocks += [Block(j, new, rows[self.rows(part)]) for part, j in enumerate(joints)]
            at = int(at + rows.shape[1])
        other = Design(self.count, self.joints, tuple(blocks), np.concatenate([self.scale, np.ones(at - self.width)]))
        gram = np.zeros((at, at))
        gram[: self.width, : self.width] = self.gram
        at = self.width
        for joints, rows in more:
            here = slice(at, at + rows.shape[1])
            gram[here] = other.across(joints, rows)
            gram[:, here] = gram[here].T
            at = here.stop
        other.__dict__["gram"] = gram
        return other
