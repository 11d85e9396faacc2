"""Joint cofactors of some unknowns of the images, as a matrix or as the sum of blocks of the images and few columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import lapack

from factors.arrays import Array, Index


class UnknownCofactors(Protocol):
    """Joint cofactors Q (d, d) of d unknowns."""

    @property
    def matrix(self) -> Array:
        """Q."""
        ...

    def square(self, x: Array) -> float:
        """``x^T Q^-1 x``."""
        ...


@dataclass(frozen=True)
class DenseUnknowns:
    """Cofactors as a matrix."""

    matrix: Array

    def square(self, x: Array) -> float:
        """See :class:`UnknownCofactors`; scaled to correlations, as unknowns of very different size are together."""
        length = np.sqrt(np.diag(self.matrix))
        scaled = self.matrix / np.outer(length, length)
        _, solved, info = lapack.dposv(scaled, x / length, lower=1)
        return float((x / length) @ (np.linalg.solve(scaled, x / length) if info else solved))


@dataclass(frozen=True)
class SpreadUnknowns:
    """Cofactors ``D + G K G^T``: D has a block for each image, G few columns.

    Parameters
    ----------
    own : (M, k, k) array
        Blocks of D, those of unknowns that are not wanted included.
    image, place : (d,) int arrays
        Image of each unknown, ascending, and its place in the block.
    factor : (d, c) array
        G.
    core : (c, c) array
        K, symmetric; it need not be definite.
    """

    own: Array
    image: Index
    place: Index
    factor: Array
    core: Array

    @cached_property
    def matrix(self) -> Array:
        """See :class:`UnknownCofactors`."""
        out = self.factor @ self.core @ self.factor.T
        row, column = np.nonzero(self.image[:, None] == self.image)
        out[row, column] += self.own[self.image[row], self.place[row], self.place[column]]
        return np.asarray(0.5 * (out + out.T))

    def square(self, x: Array) -> float:
        """See :class:`UnknownCofactors`.

        With ``M = G^T D^-1 G`` and ``u = G^T D^-1 x`` it is ``x^T D^-1 x - u^T (I + K M)^-1 K u`` (Woodbury 1950).
        """
        if not (self.own[self.image, self.place, self.place] > 0.0).all():
            return DenseUnknowns(self.matrix).square(x)
        wide = np.column_stack([x, self.factor])
        solved = self._by_blocks(wide)
        products = wide.T @ solved
        scale = 1.0 / np.sqrt(np.maximum(np.diag(products)[1:], np.finfo(float).tiny))
        m, k = products[1:, 1:] * np.outer(scale, scale), self.core / np.outer(scale, scale)
        u = products[1:, 0] * scale
        return float(products[0, 0] - u @ np.linalg.solve(np.eye(len(k)) + k @ m, k @ u))

    def _by_blocks(self, right: Array) -> Array:
        """``D^-1`` times columns (d, c)."""
        images, first, count = np.unique(self.image, return_index=True, return_counts=True)
        rank = np.arange(len(self.image)) - np.repeat(first, count)
        number, most = np.repeat(np.arange(len(images)), count), int(count.max())
        places, exists = np.zeros((len(images), most), np.intp), np.zeros((len(images), most), bool)
        places[number, rank], exists[number, rank] = self.place, True
        blocks = self.own[images[:, None, None], places[:, :, None], places[:, None]]
        blocks = np.where(exists[:, :, None] & exists[:, None], blocks, np.eye(most))
        columns = np.zeros((len(images), most, right.shape[1]))
        columns[number, rank] = right
        return np.asarray(np.linalg.solve(blocks, columns)[number, rank])

    def changed(self, factor: Array, core: Array) -> SpreadUnknowns:
        """Cofactors with ``F C F^T`` added."""
        c = len(self.core)
        joined = np.zeros((c + len(core),) * 2)
        joined[:c, :c], joined[c:, c:] = self.core, core
        return SpreadUnknowns(self.own, self.image, self.place, np.hstack([self.factor, factor]), joined)
