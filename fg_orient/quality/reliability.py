"""Reliability: how well the observations check each other (Baarda 1968; Förstner 1985; Luhmann et al. 2019, 2.4.4).

A bias b of one observation (sigma s, redundancy number r) changes its residual by r b and the test statistic
``w = v / (s sqrt(r))`` by ``b sqrt(r) / s``. The test of size alpha detects it with the given power if the square of
this change is the non-centrality delta. Hence the *minimal detectable bias* (internal reliability) and its effect
(external)::

    mdb = s sqrt(delta / r),   dx = N^-1 A^T e mdb / s,   delta_bar = sqrt(dx^T Q^-1 dx)

The two coordinates of an image point are tested together (delta of 2 degrees of freedom), and the minimal bias depends
on its direction. In a direction that the other observations do not check r is 0, and no error is detected. (With two
rays this is the epipolar line: the ground point follows.)

Residuals and their cofactors: ``fg_orient.quality.residuals``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.model.distributions import chi_square_limit, chi_square_noncentrality
from fg_orient.model.errors import InputError
from fg_orient.quality.hypotheses import eigen
from fg_orient.quality.residuals import ResidualCofactors, by_parts, parts_of_rows

#: Baarda's usual choice of the probabilities of a false alarm, and of detecting the minimal detectable bias.
ALPHA, POWER = 0.001, 0.80
#: Smallest redundancy number of a checkable observation; below it the minimal detectable bias exceeds 41 sigmas
#: (Förstner 1985 calls 0.01 the limit of local redundancy).
CHECKABLE: Final = 0.01
#: Smaller redundancy numbers are rounding errors of zero; quantities derived from them are not given.
ROUNDING: Final = 1e-6
#: An error is called unseen if its delta-bar exceeds this: seven times the radius of the point's 95 % region.
#: Three rays in a plane count as two rays if the angle between two of them is less than 0.38 of their angle
#: to the third ray.
UNSEEN: Final = 20.0


@cache
def noncentrality(alpha: float = ALPHA, power: float = POWER, dimension: int = 1) -> float:
    """Return the non-centrality delta of chi-square with which a test of size alpha has this power.

    Delta is 17.075 for alpha = 0.001, a power of 0.80 and one dimension (Baarda 1968). ``dimension`` is
    the number of coordinates tested together.
    """
    return chi_square_noncentrality(dimension, chi_square_limit(dimension, alpha), power)


@dataclass(frozen=True)
class Reliability:
    """Reliability of n observations of d coordinates; nan where a quantity does not exist.

    Parameters
    ----------
    redundancy : (n, d) array
        Redundancy numbers, 0 to 1: the share of an observation error that appears in its residual.
    least : (n,) array
        Redundancy number of the least checked direction.
    direction : (n, d) array
        This direction, a unit vector in the unit of the coordinates, with a positive largest component.
    normalised : (n, d) array
        Normalised residuals w, adjusted minus observed; N(0, 1) if the sigmas are correct.
    minimal_detectable_bias : (n, d) array
        Minimal detectable bias of each coordinate, in its unit.
    smallest, largest : (n,) arrays
        Minimal detectable bias of the coordinates tested together, in the best and in the least checked direction (unit
        of the coordinates).
    ground_m : (n, d) array
        External reliability: shift of the ground point by the minimal detectable bias, m.
    ground : (n, d) array
        The same shift in sigmas of the point, delta-bar.
    eop : (n, d) array
        Change of the unknowns of the image in their sigmas, delta-bar; nan for control points.
    """

    redundancy: Array
    least: Array
    direction: Array
    normalised: Array
    minimal_detectable_bias: Array
    smallest: Array
    largest: Array
    ground_m: Array
    ground: Array
    eop: Array

    @property
    def not_checkable(self) -> Mask:
        """Observations (n,) with a direction that the other observations do not check."""
        return np.asarray(self.least < CHECKABLE)


@dataclass(frozen=True)
class BlockReliability:
    """Reliability of all observations of a block.

    Parameters
    ----------
    alpha, power : float
        Probabilities of the test of the minimal detectable biases.
    image : Reliability
        Image points, in the order of ``problem.observations``: line, sample; pixels.
    control : Reliability
        Control points ``np.flatnonzero(problem.observed)``: East, North, Up (X, Y, Z in a local system); m.
    cofactors : ResidualCofactors
        Cofactors of all residuals, with the redundancy numbers of priors and extra observations.
    """

    alpha: float
    power: float
    image: Reliability
    control: Reliability
    cofactors: ResidualCofactors


def reliability(cofactors: ResidualCofactors, *, alpha: float = ALPHA, power: float = POWER) -> BlockReliability:
    """Compute redundancy numbers, normalised residuals, internal and external reliability of all observations.

    Parameters
    ----------
    cofactors : ResidualCofactors
        Cofactors of a solution without a loss.
    alpha, power : float
        Probabilities of the test; 0 < alpha < power < 1.

    Raises
    ------
    InputError
        The probabilities are invalid.
    """
    if not 0.0 < alpha < power < 1.0:
        raise InputError.of("statistics.power", place="alpha, power", value=f"{alpha}, {power}")
    problem, rays, w = cofactors.problem, cofactors.rays, cofactors.control_rows
    o = problem.observations
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)

    def some(k: slice) -> list[Array]:
        of_rays = rays.points[o.point[k]]
        found = _reliability(
            cofactors.image[k],
            cofactors.v_image[k],
            sigma[k],
            rays.response[k],
            of_rays,
            rays.on_image[k],
            alpha,
            power,
        )
        return [getattr(found, f.name) for f in fields(found)]

    image = Reliability(*by_parts(len(o), some))
    points, sigma_m = rays.points[problem.observed], 1.0 / np.linalg.norm(w, axis=2)
    control = _reliability(
        cofactors.control,
        cofactors.v_control,
        sigma_m,
        points @ np.swapaxes(w, 1, 2),
        points,
        np.full(sigma_m.shape, np.nan),
        alpha,
        power,
    )
    return BlockReliability(alpha, power, image, control, cofactors)


def unseen_shifts(known: ResidualCofactors) -> Array:
    """Return the shift (N, 3) East, North, Up of points by an unseen error of one pixel; nan if there is none.

    An error of a ray along its least checked direction is unseen if the minimal detectable bias shifts
    the point by more than :data:`UNSEEN` sigmas of the point. Both coordinates are tested together. For
    a tie point with two rays this direction is the epipolar line. The result belongs to the ray with
    the largest shift. Under a loss the rays have their final weights. The error may have either sign;
    the largest component of the shift is positive.
    """
    problem, o, rays = known.problem, known.problem.observations, known.rays
    some, limit = [], UNSEEN / np.sqrt(noncentrality(dimension=2))
    for part in parts_of_rows(len(o)):
        size, axes = eigen(known.image[part])
        axis, point = axes[:, :, :1], o.point[part]
        moved = rays.response[part] @ axis  # shift of the ground point by a whitened image error of length 1
        effect = _in_own_sigmas(rays.points[point], moved)[:, 0]
        unseen = np.flatnonzero(effect > limit * np.sqrt(np.maximum(size[:, 0], ROUNDING)))
        sigma = np.stack([o.sigma_line_px[part], o.sigma_sample_px[part]], axis=1)[unseen]
        pixels = np.linalg.norm(axis[unseen, :, 0] * sigma, axis=1)
        some.append((point[unseen], moved[unseen, :, 0] / pixels[:, None]))
    point, shift = (np.concatenate(values) for values in zip(*some, strict=True))
    out = np.full((len(problem.active), 3), np.nan)
    order = np.argsort(np.linalg.norm(shift, axis=1), kind="stable")  # in ascending order: the last assignment wins
    out[point[order]] = shift[order]
    at = np.flatnonzero(np.isfinite(out[:, 0]))
    shift = np.einsum("nij,nj->ni", problem.axes(known.state.ground[at] + problem.origin_m), out[at])
    largest = np.take_along_axis(shift, np.abs(shift).argmax(axis=1)[:, None], axis=1)
    out[at] = np.where(largest < 0.0, -shift, shift)
    return out


def _reliability(
    q: Array, v: Array, sigma: Array, response: Array, points: Array, eop: Array, alpha: float, power: float
) -> Reliability:
    """Compute reliability of n observations of d coordinates from whitened cofactors (n, d, d) and residuals (n, d).

    ``response`` (n, 3, d): effect of a whitened unit error on the ground point, which has the cofactors ``points`` (n,
    3, 3); ``eop`` (n, d): effect on the image, in its sigmas.
    """
    d = q.shape[1]
    r = np.einsum("nii->ni", q).copy()
    size, axes = eigen(q)
    known = np.where(r > ROUNDING, r, np.nan)
    bias = np.sqrt(noncentrality(alpha, power) / known)
    together = np.einsum("ni,nij,nj->nij", 1.0 / sigma, q, 1.0 / sigma)  # now in the unit of the coordinates
    spread = eigen(together)[0]
    checked = size[:, 0] > ROUNDING
    group = noncentrality(alpha, power, d)
    least, most = (np.where(np.isfinite(s) & (s > 0.0), s, np.nan) for s in (spread[:, 0], spread[:, -1]))
    return Reliability(
        r,
        size[:, 0],
        _direction(axes[:, :, 0] * sigma),
        v / np.sqrt(known),
        bias * sigma,
        np.where(size[:, -1] > ROUNDING, np.sqrt(group / most), np.nan),
        np.where(checked, np.sqrt(group / least), np.nan),
        bias * np.linalg.norm(response, axis=1),
        bias * _in_own_sigmas(points, response),
        bias * eop,
    )


def _direction(axis: Array) -> Array:
    """Return unit vectors (n, d) whose largest component is positive."""
    largest = np.take_along_axis(axis, np.abs(axis).argmax(axis=1)[:, None], axis=1)
    return np.asarray(axis / np.where(largest < 0.0, -1.0, 1.0) / np.linalg.norm(axis, axis=1, keepdims=True))


def _in_own_sigmas(points: Array, response: Array) -> Array:
    """Return the roots of ``x^T Q^-1 x`` (n, d) for columns x (n, 3, d); nan for points that are not unknowns."""
    out = np.full((len(points), response.shape[2]), np.nan)
    free = np.einsum("nii->n", points) > 0.0
    q, x = (np.ascontiguousarray(each[free].transpose(1, 2, 0)) for each in (points, response))
    # Q = L D L^T, element by element: LAPACK takes four times as long for small matrices
    with np.errstate(all="ignore"):
        l1, l2 = q[1, 0] / q[0, 0], q[2, 0] / q[0, 0]
        d1 = q[1, 1] - l1 * q[1, 0]
        l3 = (q[2, 1] - l2 * q[1, 0]) / d1
        d2 = q[2, 2] - l2 * q[2, 0] - l3 * l3 * d1
        y1 = x[1] - l1 * x[0]
        y2 = x[2] - l2 * x[0] - l3 * y1
        out[free] = np.sqrt(np.maximum(x[0] * x[0] / q[0, 0] + y1 * y1 / d1 + y2 * y2 / d2, 0.0)).T
    return out
