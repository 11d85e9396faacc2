"""Whether control points show more than a plane through the noise of the image: the determinant of a DLT.

Let the middle of the points be the origin and their plane Z = 0. A photo of the plane alone is a homography, whose
eight parameters leave the third column (L3, L7, L11) of the matrix open, and the noise of the image decides on it where
the heights are too small. With columns m1, m2, m3, m4 the projection centre lies at the height ``-D4 / D3``,
``D3 = det(m1, m2, m3)`` and ``D4 = det(m1, m2, m4)``: of all that noise may do to the third column, what it does to
``D3`` moves the centre, as the inverse of a number that may be nothing but noise. ``D3`` is the determinant of the left
part of the matrix in any axes, so the plane need not be known. It is 0 for a parallel projection as well.

A determinant that differs from 0 (q sigmas, q the quantile of ``LEVEL``) is not enough: the inverse of a number has the
standard deviation of its derivative only where the number is many sigmas from 0. Let the estimate be T sigmas from 0
and the truth t: the centre is then ``T (T - t) / t`` standard deviations off. It may be ``ALLOWED`` only where noise
exceeds q: T - t >= q at ``T (T - t) / t = ALLOWED`` needs ``T >= q ALLOWED / (ALLOWED - q)``, 8.1 = 2.6 q for known
sigmas. Where m0 stands for an unknown sigma q is Student's quantile, but at most ``ALLOWED``: with a redundancy below 7
honest coordinates are that far off more often than ``LEVEL``, too. A redundancy of 1 then lets one flat set of 15 pass.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import normal_quantile, t_quantile
from fg_orient.model.errors import Finding, InputError, finding

Array = npt.NDArray[np.float64]

#: Probability of a projection centre that is more than ``ALLOWED`` of its standard deviations off.
LEVEL: Final = 1e-3
ALLOWED: Final = 5.0


def limits(redundancy: int, *, known: bool) -> tuple[float, float]:
    """Standard deviations from 0 of a determinant that is no noise, and of one whose inverse has an honest sigma.

    Parameters
    ----------
    redundancy : int
        1 or more if sigmas are not known.
    known : bool
        Whether sigmas have a known size.
    """
    normal = float(-normal_quantile(LEVEL))
    noise = normal if known else min(float(t_quantile(redundancy, 1.0 - LEVEL)), ALLOWED)
    return noise, noise * ALLOWED / (ALLOWED - normal)


def require_depth(
    ground: Array, parameters: Array, cofactors: Array, m0: float | None, redundancy: int, *, known: bool
) -> Finding | None:
    """Refuse points that are flat, or a projection that is parallel, within the noise.

    Parameters
    ----------
    ground : (n, 3) array
        Control points, m.
    parameters : (11,) array
        L1 to L11 for coordinates about their middle, in any unit.
    cofactors : (u, u) array
        Of them and of the coefficients of the distortion.
    m0 : float or None
    redundancy : int
    known : bool
        Whether the sigmas given have a known size; m0 enlarges them all the same. Without them and without
        redundancy nothing tells the noise, and nothing is refused.

    Returns
    -------
    Finding or None
        Of a projection that is hardly central, whose centre has standard deviations that are too small.

    Raises
    ------
    InputError
        Says how many standard deviations the determinant has, and how many it needs.
    """
    if not known and m0 is None:
        return None
    unit = max(1.0, m0 or 0.0) if known else float(m0 or 0.0)
    matrix = np.append(parameters, 1.0).reshape(3, 4)[:, :3]
    slope = np.zeros((3, 4))
    slope[:, :3] = np.cross(matrix[[1, 2, 0]], matrix[[2, 0, 1]])  # derivatives of the determinant
    by_parameter = slope.ravel()[:11]
    deviation = unit * float(np.sqrt(np.maximum(by_parameter @ cofactors[:11, :11] @ by_parameter, 0.0)))
    determinant, (noise, honest) = abs(float(np.linalg.det(matrix))), limits(redundancy, known=known)
    if determinant >= honest * deviation:
        return None
    found, away = determinant / deviation, ground - ground.mean(axis=0)
    heights = np.linalg.svd(away, full_matrices=False)[2][2]
    shown = _heights_shown(heights, parameters, cofactors) / unit
    if shown < honest:
        rms = float(np.sqrt(np.mean((away @ heights) ** 2)))
        raise InputError.of("closerange.flat", place="DLT", height=f"{rms:.2g} m",
                            value=f"{found:.2g} sigmas from a plane, {honest:.3g} needed")  # fmt: skip
    if found < noise:
        raise InputError.of("closerange.parallel_noise", place="DLT",
                            value=f"{found:.2g} sigmas from parallel, {noise:.3g} needed")  # fmt: skip
    return finding("closerange.nearly_parallel", sigmas=found, honest=honest)


def _heights_shown(heights: Array, parameters: Array, cofactors: Array) -> float:
    """Sigmas from 0 of what the heights do in the image, the distortion known: root of a chi-square of three."""
    pick = np.zeros((3, 3, 4))
    pick[np.arange(3), np.arange(3), :3] = heights  # the matrix times their direction: its third column
    rows = pick.reshape(3, 12)[:, :11]
    both, own = cofactors[:11, 11:], cofactors[11:, 11:]
    given_distortion = cofactors[:11, :11] - both @ np.linalg.solve(own, both.T)
    column = rows @ parameters
    return float(np.sqrt(column @ np.linalg.solve(rows @ given_distortion @ rows.T, column)))
