"""Arguments of an equation that are composed of several vectors of unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from factors._contract import Array

Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Split:
    """Vector argument composed of several GTSAM vectors: an image's own unknowns and shared unknowns.

    Parameters
    ----------
    keys : tuple of int
    columns : tuple of (k,) int arrays
        For each vector, the places in the argument that receive its elements ``places``.
    places : tuple of (k,) int arrays
    sizes : tuple of int
        Lengths of the vectors.
    """

    keys: tuple[int, ...]
    columns: tuple[Index, ...]
    places: tuple[Index, ...]
    sizes: tuple[int, ...]

    def gathered(self, values: Any, size: int) -> Array:
        """Return the argument (size,), composed of GTSAM's values."""
        out = np.empty(size)
        for key, columns, places in zip(self.keys, self.columns, self.places, strict=True):
            out[columns] = values.atVector(key)[places]
        return out

    def scattered(self, block: Array) -> list[Array]:
        """Return the Jacobian with respect to each vector."""
        out = []
        for columns, places, size in zip(self.columns, self.places, self.sizes, strict=True):
            part = np.zeros((len(block), size))
            part[:, places] = block[:, columns]
            out.append(part)
        return out
