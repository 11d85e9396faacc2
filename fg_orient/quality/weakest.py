"""Directions of a block that its observations determine least, from the border of the normal equations.

Inverse iteration with the border finds the space of the weakest directions. Singular values and directions
within this space are computed from the rows themselves, without squares. Therefore values down to 1e-12 of
the largest one are accurate. This takes much less time than a decomposition of all rows
(``fg_orient.quality.elimination``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular

from factors.arrays import Array
from fg_orient.adjustment.border_matrix import BorderMatrix
from fg_orient.adjustment.schur_reduced import Singular

#: This number is added to the diagonal of the scaled matrix. It is above the rounding error and far below the
#: eigenvalues of weak directions.
SHIFT: Final = 1e-11
#: Number of start directions in addition to seven for each part of the block; number of steps of the
#: inverse iteration; number of corrections by the observation equations.
BESIDE: Final = 9
STEPS: Final = 3
CORRECTIONS: Final = 2
#: A smaller singular value of a motion is rounding noise, which corrections do not change.
EXACT: Final = 1e-11
#: Directions with singular values up to this multiple of the limit are corrected by the rows.
BESIDES: Final = 10.0


@dataclass(frozen=True)
class Weakest:
    """Weakest directions of a block.

    Parameters
    ----------
    border : BorderMatrix
    values : (d,) array
        Singular values, ascending: length of the whitened residuals per unit of the image unknowns in prior sigmas.
    directions : (b, d) array
        Of the border; orthonormal in the image unknowns.
    ground : (N, 3, d) array
        Movements of the ground points with them, m.
    """

    border: BorderMatrix
    values: Array
    directions: Array
    ground: Array


def weakest(border: BorderMatrix, limit: float, parts: int = 1, start: Array | None = None) -> Weakest:
    """Return the directions with a singular value below a limit.

    Parameters
    ----------
    border : BorderMatrix
    limit : float
    parts : int
        Parts of the block, each with seven motions at most.
    start : (b, d) array, optional
        Directions at a neighbouring state: these are only corrected, and no other directions are
        searched for.

    Raises
    ------
    Singular
        Rounding has left no positive definite matrix.
    """
    n, count = len(border), 7 * parts + BESIDE
    most = min(n, border.problem.n_free_unknowns)
    scaled = border.matrix * np.outer(border.scale, border.scale)
    scaled[np.arange(n), np.arange(n)] += SHIFT
    factor, info = lapack.dpotrf(scaled, lower=1, clean=0, overwrite_a=1)
    if info != 0:
        raise Singular("the reduced normal equations are not positive semidefinite")

    def solved(right: Array) -> Array:
        return np.asarray(lapack.dpotrs(factor, right, lower=1)[0])

    def corrected(found: _ByRows) -> _ByRows:
        for _ in range(CORRECTIONS):
            wanted = found.values < BESIDES * limit
            if (start is None and (found.values[wanted] <= EXACT).all()) or (found.values <= EXACT).all():
                break
            change = solved(found.gradient * border.scale[:, None])
            found = _by_rows(border, found.directions - change * border.scale[:, None])
        return found

    if start is not None:
        found = corrected(_by_rows(border, start))
        return Weakest(border, found.values, found.directions, found.ground)
    while True:
        count = min(count, most)
        space = np.random.default_rng(0).standard_normal((n, count))
        for _ in range(STEPS):
            space = np.asarray(qr(solved(space), mode="economic")[0], float)
        found = corrected(_by_rows(border, space * border.scale[:, None]))
        below = found.values < limit
        if not below.all() or count == most:
            return Weakest(border, found.values[below], found.directions[:, below], found.ground[:, :, below])
        count *= 2


class _ByRows(NamedTuple):
    """Singular values (d,), ascending, directions (b, d), their gradient (b, d) and ground (N, 3, d), from all rows."""

    values: Array
    directions: Array
    gradient: Array
    ground: Array


def _by_rows(border: BorderMatrix, space: Array) -> _ByRows:
    """Compute singular values and directions of the observation equations within a space (b, d) of movements."""
    r = np.linalg.qr(border.images_of(space), mode="r")
    own = np.asarray(solve_triangular(r, space.T, trans="T").T)
    followed = border.follow(own)
    effect = followed.effect
    _, s, vt = np.linalg.svd(effect, full_matrices=len(effect) < effect.shape[1])
    s = np.append(s, np.zeros(effect.shape[1] - len(s)))
    turn = vt.T[:, np.argsort(s)]
    return _ByRows(np.sort(s), own @ turn, followed.gradient @ turn, followed.ground @ turn)
