"""Pairwise distance check (İpbüker 1994, appendix EK 3, program KEN.BAS): finds bad points without a transformation.

``d_ij = s_ij(image in metres) - s_ij(map)`` for i < j; their standard deviation measures the precision of both lists
together. A constant is removed, a scale error is not. With noise alone it is about 1.39 m0 for 30 points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PairDistances:
    """Differences of all pairs.

    Parameters
    ----------
    differences : (K,) array
        First minus second list, m, pairs in the order 01, 02, ..., 12, ...
    standard_deviation, mean : float
        Of the differences; K - 1 in the divisor. m.
    of_point : (n,) array
        Root mean square about the mean of the differences of each point's pairs: a bad point stands out.
    """

    differences: Array
    standard_deviation: float
    mean: float
    of_point: Array


def pair_distances(first: npt.ArrayLike, second: npt.ArrayLike) -> PairDistances:
    """Compare the distances of all pairs of points in two plane systems of one scale.

    Parameters
    ----------
    first, second : (n, 2) array_like
        The same points, both in metres.

    Raises
    ------
    InputError
        Fewer than three points (two pairs are needed), or lists that do not fit.
    """
    a, b = (finite("pair distances", values) for values in (first, second))
    if a.ndim != 2 or a.shape[1] != 2 or b.shape != a.shape or len(a) < 3:
        raise InputError.of("rectify.points", place="pair distances", value=f"{a.shape}, {b.shape}")
    n = len(a)
    i, j = np.triu_indices(n, 1)
    d = np.hypot(*(a[i] - a[j]).T) - np.hypot(*(b[i] - b[j]).T)
    mean = float(d.mean())
    squares = np.zeros((n, n))
    squares[i, j] = squares[j, i] = (d - mean) ** 2
    return PairDistances(d, float(d.std(ddof=1)), mean, np.sqrt(squares.sum(axis=1) / (n - 1)))
