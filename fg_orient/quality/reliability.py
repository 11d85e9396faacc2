"""Reliability: how far the observations check each other (Baarda 1968; Förstner 1985; Luhmann et al. 2019, 2.4.4).

A bias b of one observation (sigma s, redundancy number r) moves its residual by r b and the test statistic
``w = v / (s sqrt(r))`` by ``b sqrt(r) / s``. The test of size alpha finds it with the given power if the square of that
is the non-centrality delta; hence the *minimal detectable bias* (internal reliability) and its effect (external)::

    mdb = s sqrt(delta / r),   dx = N^-1 A^T e mdb / s,   delta_bar = sqrt(dx^T Q^-1 dx)

An image point as a whole has two coordinates that are tested together (delta of 2 degrees of freedom); the bias that
is just found depends on its direction then. Where the others do not check a direction (two rays: along the epipolar
line; the ground point follows) r is 0 and nothing finds an error, however large.

Cofactors of the residuals, ``Q_vv = I - A N^-1 A^T``, of all observations; their traces are redundancy numbers.

Everything is whitened: residuals are divided by their a priori sigmas, so that without unknowns Q_vv = I. Formed point
by point from the cofactors of the images (``fg_orient.adjustment.cofactors``); where own observations name a
ground point, from joint cofactors. The sum of all redundancy numbers is the redundancy (Baarda 1968).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from fg_orient.adjustment.cofactors import RayCofactors, blocks_of_images, cofactors_of_rays, inverse_roots
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, residuals
from fg_orient.model.block import ExtraObservation
from fg_orient.model.distributions import chi_square_limit, chi_square_noncentrality
from fg_orient.model.errors import InputError
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]

#: Baarda's usual choice: probability of a false alarm, and of finding the minimal detectable bias.
ALPHA, POWER = 0.001, 0.80
#: Below this redundancy number an observation is called not checkable: its minimal detectable bias exceeds 41 sigmas
#: (Förstner 1985 calls 0.01 the limit of local redundancy).
CHECKABLE: Final = 0.01
#: Below this one a redundancy number is rounding of zero: what follows from it is not given.
ROUNDING: Final = 1e-6


@cache
def noncentrality(alpha: float = ALPHA, power: float = POWER, dimension: int = 1) -> float:
    """Non-centrality delta of chi-square by which a test of this size rejects with this power.

    17.075 for 0.001, 0.80 and one dimension (Baarda 1968).

    Parameters
    ----------
    alpha : float
        Size of the test.
    power : float
        Probability to find the bias, above alpha and below 1.
    dimension : int
        Coordinates that are tested together.
    """
    return chi_square_noncentrality(dimension, chi_square_limit(dimension, alpha), power)


@dataclass(frozen=True)
class Reliability:
    """Of observations in coordinates of their own: n observations of d coordinates; nan where there is no such figure.

    Parameters
    ----------
    redundancy : (n, d) array
        Redundancy numbers, 0 to 1: the share of an error that shows in its own residual.
    least : (n,) array
        Redundancy number of the direction that is checked least.
    direction : (n, d) array
        That direction, a unit vector in the unit of the coordinates, its largest component positive.
    normalised : (n, d) array
        Normalised residuals w, adjusted minus observed, N(0, 1) with right sigmas.
    minimal_detectable_bias : (n, d) array
        Of each coordinate, in its unit.
    smallest, largest : (n,) arrays
        Minimal detectable bias of the coordinates tested together, in the directions that are checked best and least
        (unit of the coordinates).
    ground_m : (n, d) array
        External reliability: shift of the ground point by the minimal detectable bias, m.
    ground : (n, d) array
        The same in the point's own sigmas, delta-bar.
    eop : (n, d) array
        Change of the unknowns of the image in their own sigmas, delta-bar; nan for control points.
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
    def not_checkable(self) -> npt.NDArray[np.bool_]:
        """Observations (n,) with a direction that the others do not check."""
        return np.asarray(self.least < CHECKABLE)


@dataclass(frozen=True)
class BlockReliability:
    """Reliability of all observations of a block.

    Parameters
    ----------
    alpha, power : float
        Of the test that the minimal detectable biases belong to.
    image : Reliability
        Image points, in the order of ``problem.observations``: line, sample; pixels.
    control : Reliability
        Control points ``np.flatnonzero(problem.observed)``: East, North, Up (X, Y, Z in a local system); m.
    prior, extra : array, tuple of arrays
        Redundancy numbers of priors and own observations; see ``ResidualCofactors``.
    redundancy_sum : float
        Sum of all redundancy numbers; but for rounding the redundancy.
    """

    alpha: float
    power: float
    image: Reliability
    control: Reliability
    prior: Array
    extra: tuple[Array, ...]
    redundancy_sum: float


def reliability(
    problem: Problem, state: State, cofactors: ResidualCofactors, *, alpha: float = ALPHA, power: float = POWER
) -> BlockReliability:
    """Redundancy numbers, normalised residuals, internal and external reliability of all observations.

    Parameters
    ----------
    problem, state
        Of a solution, without a loss.
    cofactors : ResidualCofactors
        See ``fg_orient.quality.reliability``.
    alpha, power : float
        Of the test; 0 < alpha < power < 1.

    Raises
    ------
    InputError
        The two probabilities are no such numbers.
    """
    if not 0.0 < alpha < power < 1.0:
        raise InputError.of("statistics.power", place="alpha, power", value=f"{alpha}, {power}")
    o, rays = problem.observations, cofactors.rays
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    eop = rays.on_image
    image = _reliability(
        cofactors.image, residuals(problem, state), sigma, rays.response, rays.points[o.point], eop, alpha, power
    )
    q, whitened, own, response, points = _control(problem, state, cofactors)
    control = _reliability(q, whitened, own, response, points, np.full(own.shape, np.nan), alpha, power)
    return BlockReliability(
        alpha, power, image, control, cofactors.prior, cofactors.extra, cofactors.redundancy_sum
    )  # fmt: skip


def _control(problem: Problem, state: State, cofactors: ResidualCofactors) -> tuple[Array, Array, Array, Array, Array]:
    """Cofactors, residuals (adjusted minus observed) and sigmas of control points in their axes; effects on them."""
    rows = np.flatnonzero(problem.observed)
    w = problem.control_weights(rows)
    measured = problem.control_records[rows, POINT.place]
    columns = w @ np.swapaxes(problem.axes(measured + problem.origin_m), 1, 2)  # errors of 1 m in whitened rows
    length = np.linalg.norm(columns, axis=1)
    turn = columns / length[:, None]  # orthogonal: the measured coordinates are uncorrelated in their axes
    back = np.swapaxes(turn, 1, 2)
    residual = np.einsum("nij,nj->ni", back @ w, state.ground[rows] - measured)
    points = cofactors.rays.points[rows]
    response = points @ np.swapaxes(w, 1, 2) @ turn
    return back @ cofactors.control @ turn, residual, 1.0 / length, response, points


def _reliability(
    q: Array, v: Array, sigma: Array, response: Array, points: Array, eop: Array, alpha: float, power: float
) -> Reliability:
    """Figures of n observations of d coordinates from whitened cofactors (n, d, d) and residuals (n, d).

    ``response`` (n, 3, d): effect of a whitened unit error on the ground point, of cofactors ``points`` (n, 3, 3);
    ``eop`` (n, d): on the image, in its sigmas.
    """
    d = q.shape[1]
    r = np.einsum("nii->ni", q).copy()
    size, axes = np.linalg.eigh(q)
    known = np.where(r > ROUNDING, r, np.nan)
    bias = np.sqrt(noncentrality(alpha, power) / known)
    together = np.einsum("ni,nij,nj->nij", 1.0 / sigma, q, 1.0 / sigma)  # in the unit of the coordinates
    spread = np.linalg.eigvalsh(together)
    checked = size[:, 0] > ROUNDING
    group = noncentrality(alpha, power, d)
    least, most = (np.where(np.isfinite(s) & (s > 0.0), s, np.nan) for s in (spread[:, 0], spread[:, -1]))
    return Reliability(
        r, size[:, 0], _direction(axes[:, :, 0] * sigma), v / np.sqrt(known), bias * sigma,
        np.where(size[:, -1] > ROUNDING, np.sqrt(group / most), np.nan),
        np.where(checked, np.sqrt(group / least), np.nan),
        bias * np.linalg.norm(response, axis=1), bias * _in_own_sigmas(points, response), bias * eop,
    )  # fmt: skip


def _direction(axis: Array) -> Array:
    """Unit vectors (n, d) whose largest component is positive."""
    largest = np.take_along_axis(axis, np.abs(axis).argmax(axis=1)[:, None], axis=1)
    return np.asarray(axis / np.where(largest < 0.0, -1.0, 1.0) / np.linalg.norm(axis, axis=1, keepdims=True))


def _in_own_sigmas(points: Array, response: Array) -> Array:
    """Roots of ``x^T Q^-1 x`` (n, d) of the columns (n, 3, d); nan for points that are no unknowns."""
    out = np.full((len(points), response.shape[2]), np.nan)
    free = np.einsum("nii->n", points) > 0.0
    solved = np.linalg.solve(points[free], response[free])
    out[free] = np.sqrt(np.maximum(np.einsum("nij,nij->nj", response[free], solved), 0.0))
    return out


# --- cofactors of residuals -----------------------------------------------------------------------


@dataclass(frozen=True)
class ResidualCofactors:
    """Cofactors of the residuals, whitened; prior scale.

    Parameters
    ----------
    image : (n, 2, 2) array
        Blocks of the image points, in the order of ``problem.observations``.
    control : (m, 3, 3) array
        Blocks of the control points ``np.flatnonzero(problem.observed)``, in the rows of their factor
        ``W (G - G_0)``.
    prior : (u,) array
        Redundancy numbers of the prior observations, in the order of ``problem.image_vector``: one for an unknown that
        images have in common; empty without priors.
    extra : tuple of (m_e,) arrays
        Redundancy numbers of the rows of each own observation.
    rays : RayCofactors
        What they were made of: cofactors of adjusted image points, points and images.
    """

    image: Array
    control: Array
    prior: Array
    extra: tuple[Array, ...]
    rays: RayCofactors

    @property
    def redundancy_sum(self) -> float:
        """Sum of all redundancy numbers; but for rounding ``problem.redundancy``."""
        blocks = sum(float(np.einsum("nii->", block)) for block in (self.image, self.control))
        return blocks + sum(float(np.sum(numbers)) for numbers in (self.prior, *self.extra))


def residual_cofactors(problem: Problem, state: State, cofactors: Cofactors) -> ResidualCofactors:
    """Cofactors of all residuals at a solution.

    Parameters
    ----------
    problem : Problem
        Under a loss the one with the weights at the solution (``fg_orient.adjustment.robust.weighted_problem``).
    state : State
        The solution.
    cofactors : Cofactors
        Of any backend.

    Returns
    -------
    ResidualCofactors
    """
    rays = cofactors_of_rays(
        problem, state, lambda pairs: blocks_of_images(problem, lambda images: cofactors.joint(images, ()), pairs)
    )
    if problem.block.extra:
        _through_own_observations(problem, state, cofactors, rays)
    w = problem.control_weights(problem.observed)
    return ResidualCofactors(
        np.eye(2) - rays.fitted,
        np.eye(3) - w @ rays.points[problem.observed] @ np.swapaxes(w, 1, 2),
        1.0 - _variances(problem, rays) if problem.block.options.priors else np.zeros(0),
        tuple(_of_extra(problem, state, cofactors, extra) for extra in problem.block.extra),
        rays,
    )


def _variances(problem: Problem, rays: RayCofactors) -> Array:
    """Cofactors (u,) of the image unknowns, those in common once."""
    sizes = np.diff(problem.first).tolist()
    wide = np.concatenate([np.diag(q)[:size] for q, size in zip(rays.images, sizes, strict=True)])
    return wide if problem.ties is None else wide[problem.ties.place]


def _through_own_observations(problem: Problem, state: State, cofactors: Cofactors, rays: RayCofactors) -> None:
    """Replace what concerns ground points that own observations name: more than their rays determines them."""
    arguments = (a for extra in problem.block.extra for a in problem.extra_arguments(extra))
    named = sorted({a.index for a in arguments if not a.is_image and a.constant is None})
    o, rays_of = problem.observations, dict(problem.rows_by_point())
    for j in named:
        images = tuple(np.unique(o.image[rays_of[j]]).tolist())
        q = cofactors.joint(images, (j,))
        first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
        rays.points[j] = q[-3:, -3:]
        for at, k in enumerate(images):
            rows = rays_of[j][o.image[rays_of[j]] == k]
            _, d_image, d_ground = image_rows(problem, state, k, rows, jacobian=True)
            columns = np.r_[first[at] : first[at + 1], first[-1] : first[-1] + 3]
            design = np.concatenate([d_image, d_ground], axis=2)
            effect = q[:, columns] @ np.swapaxes(design, 1, 2)
            rays.fitted[rows] = design @ effect[:, columns]
            rays.response[rows] = effect[:, -3:]
            root = inverse_roots(rays.images[k : k + 1], np.diff(first[at : at + 2]))[0, : first[at + 1] - first[at]]
            own = root[:, : len(root)] @ effect[:, first[at] : first[at + 1]]
            rays.on_image[rows] = np.linalg.norm(own, axis=1)


def _of_extra(problem: Problem, state: State, cofactors: Cofactors, extra: ExtraObservation) -> Array:
    """Redundancy numbers of the rows of an own observation."""
    _, blocks = extra_blocks(problem, extra, state, jacobian=True)
    parts: dict[tuple[bool, int], Array] = {}
    for a, block in blocks:
        parts[a.is_image, a.index] = parts.get((a.is_image, a.index), 0.0) + block
    images, points = (tuple(index for is_image, index in parts if is_image is kind) for kind in (True, False))
    q = cofactors.joint(images, points)
    design = np.hstack([parts[True, k] for k in images] + [parts[False, j] for j in points])
    return np.asarray(1.0 - np.einsum("ri,ij,rj->r", design, q, design))
