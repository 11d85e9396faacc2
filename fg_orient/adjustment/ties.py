"""Unknowns shared by several images, such as the interior orientation of a camera or the drift of a strip.

Each image has a complete vector (the *wide* unknowns x, one image after the other), so that equations, rows and
cofactors do not depend on ties. The *free* unknowns z are the unknowns of the equations: first the
unknowns of single images, then the unknowns of each shared id. ``x = T z`` with a 0-1 matrix T. Hence J
becomes J T, the reduced camera system S becomes T^T S T, and cofactors of x are ``T Q T^T``:
block-invariant self-calibration without further equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import ImageParameters

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True, eq=False)
class Ties:
    """Matrix T and the order of the free unknowns.

    Parameters
    ----------
    of : (w,) int array
        Free unknown of each wide unknown.
    part : (M + G + 1,) int array
        First free unknown of each image and of each of the G shared ids, and the number of free unknowns.
    ids : tuple of str
        The G shared ids.
    """

    of: Index
    part: Index
    ids: tuple[str, ...]

    def __len__(self) -> int:
        return int(self.part[-1])

    @cached_property
    def place(self) -> Index:
        """First wide unknown (z,) of each free unknown."""
        out = np.empty(len(self), np.intp)
        out[self.of[::-1]] = np.arange(len(self.of))[::-1]
        return out

    @cached_property
    def matrix(self) -> sparse.csr_array:
        """T (w, z)."""
        from scipy import sparse

        ones = np.ones(len(self.of))
        return sparse.csr_array((ones, (np.arange(len(self.of)), self.of)), shape=(len(self.of), len(self)))

    @cached_property
    def own(self) -> npt.NDArray[np.bool_]:
        """Wide unknowns (w,) that are not shared."""
        return np.asarray(self.of < self.part[len(self.part) - 1 - len(self.ids)])

    def vectors(self, wide: slice) -> Index:
        """Return the number of the image or, after the images, of the shared id, for each of some wide unknowns."""
        return np.asarray(np.searchsorted(self.part, self.of[wide], side="right") - 1)

    def summed(self, wide: Array) -> Array:
        """Return ``T^T x`` of a gradient (w,)."""
        return np.bincount(self.of, weights=wide, minlength=len(self)).astype(np.float64, copy=False)

    def columns(self, wide: Array) -> Array:
        """Return ``J T`` of rows (n, w + p); the last p columns are unchanged."""
        w = len(self.of)
        return np.hstack([np.asarray(wide[:, :w] @ self.matrix), wide[:, w:]])

    def widened(self, free: Array) -> Array:
        """Return ``T z`` of a vector or columns (z + p, ...); the last p rows are unchanged."""
        return np.concatenate([free[self.of], free[len(self) :]])


def ties_of(parameters: Sequence[ImageParameters], names: Sequence[str]) -> Ties | None:
    """Return the ties of images with these ids; None if images share no unknowns.

    Raise InputError if a shared unknown has different prior sigmas.
    """
    own = [p.own for p in parameters]
    if all(mask.all() for mask in own):
        return None
    counts = [int(mask.sum()) for mask in own]
    known: dict[tuple[str, int], float] = {}
    first = np.concatenate([[0], np.cumsum(counts)])
    of = [first[k] + np.cumsum(mask) - 1 for k, mask in enumerate(own)]
    for p, name in zip(parameters, names, strict=True):
        for j in np.flatnonzero(~p.own):
            key, sigma = (p.shared[j], p.codes[j]), float(p.sigma[j])
            if known.setdefault(key, sigma) != sigma:
                raise InputError.of("frame.shared", place=f"image {name}, {p.names[j]}", value=sigma, id=p.shared[j])
    keys = sorted(known)
    number = {key: int(first[-1]) + n for n, key in enumerate(keys)}
    for k, p in enumerate(parameters):
        for j in np.flatnonzero(~p.own):
            of[k][j] = number[p.shared[j], p.codes[j]]
    ids, sizes = np.unique([key[0] for key in keys], return_counts=True)
    part = np.concatenate([first, first[-1] + np.cumsum(sizes)])
    return Ties(np.concatenate(of).astype(np.intp), part.astype(np.intp), tuple(ids.tolist()))
