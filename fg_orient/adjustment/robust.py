"""Robust losses of an adjustment, and the weights of the rows.

The cost is the sum of rho(t) over image points (t: whitened norm of 2 residuals) and
control points (3), plus half the sum of squares of priors and extra observations. Rows
multiplied by the root of their weight give the Gauss-Newton steps of iteratively
reweighted least squares (Holland & Welsch 1977). Their gradient is the gradient of the
cost.

The two rays of a tie point without further observations contradict each other in one
residual, the y-parallax. The data do not show which ray is wrong. Both get the mean of
their squared norms (:func:`together`). A gross error in one of them then makes the point useless.
Otherwise the ray with the larger residual would be rejected, although it may be the right one.
Graduated non-convexity also gives rivals among three or more rays one weight
(``fg_orient.adjustment.best_rays.sharing``).

Each loss contains the share :data:`FLOOR` of the square. Therefore a ground point whose
image points have no other weight is still determined by the intersection of its rays.
With fixed weights the problem is an ordinary least-squares problem
(:func:`weighted_problem`); covariances under a loss are the covariances of that problem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from factors.conditions.control import POINT
from factors.losses import Curve, Loss, find
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, residuals, rows_by_image, whitened_records
from fg_orient.model.distributions import chi_square_median, chi_square_quantile

#: Share of the square in every loss: a residual of 1000 sigmas acts like 0.001 sigma.
#: With a smaller share, rounding would dominate the cofactors of a point with one good
#: ray (its pivots differ by this factor).
FLOOR: Final = 1e-6
#: An observation counts as down-weighted if its weight is below this.
DOWN: Final = 0.5
IMAGE, CONTROL = 2, 3
NONE: Final = "none"
#: Rules with weights 1/t, which may exceed 1 and do not measure the information of an observation.
UNWEIGHED: Final = ("lad",)
#: A priori scales of image points and control points: 1 sigma.
A_PRIORI: Final = (1.0, 1.0)


@dataclass(frozen=True)
class ScaledLoss:
    """A loss and its constant c: weight and cost of whitened norms t.

    Parameters
    ----------
    weight, cost : callables
        See :class:`factors.losses.Loss`.
    constant : float
        c, in sigmas.
    """

    weight: Curve
    cost: Curve
    constant: float

    def weights(self, norm: npt.ArrayLike) -> Array:
        """Return the weights of whitened norms, from FLOOR to 1."""
        return np.asarray(FLOOR + (1.0 - FLOOR) * self.weight(np.asarray(norm) / self.constant))

    def costs(self, norm: npt.ArrayLike) -> Array:
        """Return the integrals of ``t * weights(t)`` from 0."""
        u = np.asarray(norm) / self.constant
        return np.asarray(self.constant**2 * (0.5 * FLOOR * u**2 + (1.0 - FLOOR) * self.cost(u)))


@dataclass(frozen=True)
class Robust:
    """Losses of an adjustment: of image points and of control points."""

    image: ScaledLoss
    control: ScaledLoss

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """See :class:`Weighing`."""
        cost = float(sum(np.sum(costs) for costs in self.costs(image_squares, control_squares)))
        return self.image.weights(np.sqrt(image_squares)), self.control.weights(np.sqrt(control_squares)), cost

    def costs(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array]:
        """See :class:`Weighing`."""
        return self.image.costs(np.sqrt(image_squares)), self.control.costs(np.sqrt(control_squares))


class Weighing(Protocol):
    """Weights of the rows of a backend."""

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """Return weights of image points (n,) and control points (m,) from their squared norms, and cost of both."""
        ...

    def costs(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array]:
        """Return the costs of image points (n,) and control points (m,)."""
        ...


@dataclass(frozen=True)
class FixedWeights:
    """Weights that do not depend on the residuals; the cost is half the weighted sum of squares.

    ``image`` (n,) in the order of the backend, ``control`` (m,) in the order of the observed control points.
    """

    image: Array
    control: Array

    def weigh(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array, float]:
        """See :class:`Weighing`."""
        cost = 0.5 * float(np.vdot(self.image, image_squares) + np.vdot(self.control, control_squares))
        return self.image, self.control, cost

    def costs(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array]:
        """See :class:`Weighing`."""
        return 0.5 * self.image * image_squares, 0.5 * self.control * control_squares


@dataclass(frozen=True)
class Weights:
    """Weights at a state: of image points (n,), and of ground points (N,), which are 1 except at control points.

    ``scale``: units of the losses of image points and of control points, in sigmas.
    """

    image: Array
    control: Array
    scale: tuple[float, float] = A_PRIORI


def are_information(loss: str, weights: Weights) -> bool:
    """Return whether cofactors with these weights are meaningful: no weight may exceed 1."""
    largest = max(float(weights.image.max(initial=0.0)), float(weights.control.max(initial=0.0)))
    return loss not in UNWEIGHED and largest <= 1.0 + 1e-12


def scaled(loss: Loss, scale: tuple[float, float] = A_PRIORI) -> Robust:
    """Return losses of image points and control points for 95 % efficiency, with constants in units of these scales."""
    constants = (loss.constant(d) * s for d, s in zip((IMAGE, CONTROL), scale, strict=True))
    return Robust(*(ScaledLoss(loss.weight, loss.cost, c) for c in constants))


def inlier_limit(probability: float, dimension: int) -> float:
    """Return the whitened norm that a good observation does not exceed with this probability: root of the quantile."""
    return float(np.sqrt(chi_square_quantile(dimension, probability)))


def control_squares(problem: Problem, state: State) -> Array:
    """Return the squared whitened norms (m,) of the observed control points, in their order."""
    return np.asarray(np.sum(problem.control_residuals(state, np.flatnonzero(problem.observed)) ** 2, axis=1))


def squares(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return squares that determine the weights of image points (n,) and observed control points (m,), in order."""
    image = np.sum(residuals(problem, state) ** 2, axis=1)
    return together(image, two_ray_rows(problem)), control_squares(problem, state)


def two_ray_rows(problem: Problem) -> Index:
    """Return the rows (p, 2) of the two rays of each unknown point that has no other observation."""
    point = problem.observations.point
    two = (np.bincount(point, minlength=len(problem.active)) == 2) & problem.active & ~problem.observed
    two[problem.named_points()] = False
    rows = np.flatnonzero(two[point])
    return rows[np.argsort(point[rows], kind="stable")].reshape(-1, 2)


def together(image_squares: Array, pairs: Index) -> Array:
    """Return the squared norms (n,) of image points, with the mean of both rows of each pair (p, 2)."""
    out = image_squares.copy()
    out[pairs] = image_squares[pairs].mean(axis=1, keepdims=True)
    return out


def weights_at(problem: Problem, state: State, robust: Robust) -> tuple[Weights, float]:
    """Return the weights at a state, in the order of problem, and the cost minus half the weighted sum of squares."""
    image_squares, observed_squares = squares(problem, state)
    image, observed, cost = robust.weigh(image_squares, observed_squares)
    control = np.ones(len(problem.observed))
    control[problem.observed] = observed
    return Weights(image, control), cost - 0.5 * float(image @ image_squares + observed @ observed_squares)


def weighted_problem(problem: Problem, weights: Weights) -> Problem:
    """Return the least-squares problem with these weights: sigmas are divided by their roots."""
    o, root = problem.observations, np.sqrt(weights.image)
    weighted = replace(o, sigma_line_px=o.sigma_line_px / root, sigma_sample_px=o.sigma_sample_px / root)
    control = problem.control_records.copy()
    control[:, POINT.whitening] *= np.sqrt(weights.control)[:, None]
    records = whitened_records(problem.models, weighted, problem.start.ground + problem.origin_m, problem.origin_m)
    return replace(problem, observations=weighted, records=records, control_records=control)


#: Directions in which a residual contains less than this share of the error are excluded
#: from the scale, because the scale is approximate.
CHECKED: Final = 0.1
#: Number of residuals below which the scale is 1.
LEAST: Final = 10
#: Lower bound of the scale: residuals of zero would down-weight every other observation.
LOWEST: Final = 0.01


def robust_scale(problem: Problem, state: State) -> tuple[float, float]:
    """Return scales of image points and control points at a state, in sigmas; 1 with fewer than :data:`LEAST` ratios.

    A scale is the ratio of residuals to sigmas. It is computed from a median, so that gross errors do
    not affect it. A residual is smaller than its error, because the unknowns absorb a part. With ground
    points free and the orientation of each image free (the others held fixed), image point i keeps
    ``Q_i = Q_g - Q_g B N_k^-1 B^T Q_g``, ``Q_g = I - C M_j^-1 C^T`` (B, C: whitened Jacobians of image
    and point; M_j, N_k: their normal matrices). Without gross errors ``T_i = v^T Q_i^+ v`` is nearly
    chi-square of rank d, and::

        scale^2 = median over i of T_i / median(chi2_d)

    For d = 1 this is the square of 1.4826 median|v| (Hampel 1974); for two dimensions the
    factor is 0.8493, for three 0.6501.
    """
    blocks = [
        (rows, *image_rows(problem, state, k, rows, jacobian=True)) for k, rows in enumerate(rows_by_image(problem))
    ]
    ground = _ground_cofactors(problem, [(rows, c) for rows, _, _, c in blocks])
    squares = [_of_image(problem, ground, *block) for block in blocks if len(block[0])]
    return _scale(np.concatenate(squares)), _scale(_of_control(problem, state, ground))


def scale_at(problem: Problem, state: State) -> tuple[float, float]:
    """Return the scales of image points and control points that the options request, at a state, in sigmas.

    With ``robust_scale`` quantile the constant of the loss for image points is a quantile
    of their whitened norms, as for the M-estimators of ISIS jigsaw. Control points keep
    the constant for 95 % efficiency.
    """
    options = problem.block.options
    loss = find(options.loss)
    if options.robust_scale == "quantile" and loss is not None:
        size = np.linalg.norm(residuals(problem, state), axis=1)
        return max(float(np.quantile(size, options.loss_quantile)) / loss.constant(IMAGE), LOWEST), A_PRIORI[1]
    return robust_scale(problem, state) if options.robust_scale == "mad" else A_PRIORI


def _ground_cofactors(problem: Problem, blocks: list[tuple[npt.NDArray[np.intp], Array]]) -> Array:
    """Return the cofactors (N, 3, 3) of the unknown ground points, orientation held fixed.

    Zero for all others.
    """
    rows, c = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    normal = problem.point_normals(problem.observations.point[rows], c)
    out = np.zeros_like(normal)
    out[problem.active] = np.linalg.pinv(normal[problem.active], rcond=1e-14, hermitian=True)
    return out


def _of_image(problem: Problem, ground: Array, rows: npt.NDArray[np.intp], v: Array, b: Array, c: Array) -> Array:
    """Return T over the median of its chi-square distribution, for each image point of one image."""
    q = np.eye(2) - np.einsum("nri,nij,nsj->nrs", c, ground[problem.observations.point[rows]], c)
    kept = np.einsum("nrs,nsu->nru", q, b)
    prior = np.eye(b.shape[2]) if problem.block.options.priors else 0.0
    orientation = np.linalg.pinv(np.einsum("nru,nrw->uw", b, kept) + prior, rcond=1e-14, hermitian=True)
    return _ratios(v, q - np.einsum("nru,uw,nsw->nrs", kept, orientation, kept))


def _of_control(problem: Problem, state: State, ground: Array) -> Array:
    """Return the ratios of the control points."""
    rows = np.flatnonzero(problem.observed)
    w, v = problem.control_weights(rows), problem.control_residuals(state, rows)
    return _ratios(v, np.eye(3) - np.einsum("nij,njk,nlk->nil", w, ground[rows], w))


def _ratios(v: Array, q: Array) -> Array:
    """Return the ratios of ``v^T Q^+ v`` to the median of chi-square(rank Q), where the rank is not zero."""
    size, axes = np.linalg.eigh(q)
    checked = size > CHECKED
    part = np.einsum("nij,ni->nj", axes, v)
    t = np.sum(np.where(checked, part**2 / np.where(checked, size, 1.0), 0.0), axis=1)
    d = checked.sum(axis=1)
    return np.asarray(t[d > 0] / chi_square_median(d[d > 0]))


def _scale(ratios: Array) -> float:
    return 1.0 if len(ratios) < LEAST else max(float(np.sqrt(np.median(ratios))), LOWEST)
