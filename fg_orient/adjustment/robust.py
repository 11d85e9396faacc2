"""Robust losses of an adjustment: weights of the rows and the scale of the residuals.

The cost is the sum of rho(t) over image points (t: whitened norm of 2 residuals) and control points (3), plus half the
sum of squares of priors and extra observations. Rows multiplied by the root of their weight give the Gauss-Newton steps
of iteratively reweighted least squares (Holland & Welsch 1977). Their gradient is the gradient of the cost.

Each loss contains the share :data:`FLOOR` of the square. Therefore the intersection of its rays still determines a
ground point whose image points have no other weight. With fixed weights the problem is an ordinary least-squares
problem (:func:`weighted_problem`); covariances under a loss are the covariances of that problem.

:func:`robust_scale` gives the ratio of residuals to sigmas from their median. A residual is smaller than its error,
because the unknowns absorb a part. With ground points free and the orientation of each image
free (the others held fixed), image point i keeps ``Q_i = Q_g - Q_g B N_k^-1 B^T Q_g``, ``Q_g = I - C M_j^-1 C^T``
(B, C: whitened Jacobians of image and point; M_j, N_k: their normal matrices). Without gross errors
``T_i = v^T Q_i^+ v`` is nearly chi-square of rank d, and::

    scale^2 = median over i of T_i / median(chi2_d)

For d = 1 this is the square of 1.4826 median|v| (Hampel 1974); for two dimensions the factor is 0.8493, for three
0.6501. Image points and control points have one scale each.

Two rules have weights that belong to no loss: original Danish method and least absolute values (:data:`RULES`). Each
cycle solves the least-squares problem with the weights of the last cycle, and computes new weights from the whitened
norms t of the residuals. Priors and extra observations keep weight 1.

Danish method (Krarup, Juhl & Kubik 1980): with r = t / sigma0 (a posteriori, 1 at least) a weight is multiplied by
``exp(-0.05 r^4.4)`` in the first three cycles and by ``exp(-0.05 r^3)`` afterwards where r exceeds its limit. The
exponent depends on the cycle and weights never increase again. The method therefore has no cost function, and the
result depends on the sequence of cycles. :mod:`factors.losses.standard` has the form with a cost function.

Least absolute values: ``w = 1 / max(t, eps)`` minimises the sum of t (Schlossmacher 1973; for 2 and 3 numbers the sum
of lengths, Weiszfeld 1937). It has no tuning constant. Its efficiency at the normal distribution is 2/pi, pi/4 and 8/(3
pi) in 1, 2 and 3 dimensions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from factors.losses import ALIASES, Curve, Loss, find, losses
from fg_orient.adjustment.loop import OPTIMIZERS, Callback, Carried
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, residuals, rows_by_image, whitened_records
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.distributions import chi_square_median, chi_square_probability, chi_square_quantile
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]
S = TypeVar("S")

#: Share of the square in every loss: a residual of 1000 sigmas has the effect of 0.001 sigma. With a smaller share,
#: rounding dominates the cofactors of a point with one good ray (its pivots differ by this factor).
FLOOR: Final = 1e-6
IMAGE, CONTROL = 2, 3
NONE: Final = "none"
#: Rules with weights 1/t, which may exceed 1 and are not shares of the information of an observation.
UNWEIGHED: Final = ("lad",)
#: Scales of image points and control points: 1 sigma.
A_PRIORI: Final = (1.0, 1.0)
#: Directions with a smaller share of their error in the residual are excluded from the scale: it is approximate.
CHECKED: Final = 0.1
#: With fewer residuals the scale is 1.
LEAST: Final = 10
#: Lower bound of the scale: residuals of zero would down-weight every other observation.
LOWEST: Final = 0.01


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
        """Weights of whitened norms, from FLOOR to 1."""
        return np.asarray(FLOOR + (1.0 - FLOOR) * self.weight(np.asarray(norm) / self.constant))

    def costs(self, norm: npt.ArrayLike) -> Array:
        """Integrals of ``t * weights(t)`` from 0."""
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
        """Weights of image points (n,) and control points (m,) from their squared norms, and the cost of both."""
        ...

    def costs(self, image_squares: Array, control_squares: Array) -> tuple[Array, Array]:
        """Costs of image points (n,) and control points (m,)."""
        ...


@dataclass(frozen=True)
class FixedWeights:
    """Weights that do not depend on the residuals; the cost is half the weighted sum of squares.

    ``image`` (n,) in the order of the backend, ``control`` (m,) of the observed control points.
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
    """Weights at a state, of image points (n,) and of ground points (N,), which are 1 except at control points.

    ``scale``: units of the losses of image points and of control points, in sigmas.
    """

    image: Array
    control: Array
    scale: tuple[float, float] = A_PRIORI


def are_information(loss: str, weights: Weights) -> bool:
    """Whether cofactors with these weights have a meaning: no weight may exceed 1."""
    largest = max(float(weights.image.max(initial=0.0)), float(weights.control.max(initial=0.0)))
    return loss not in UNWEIGHED and largest <= 1.0 + 1e-12


def find_loss(name: str) -> Loss:
    """Find a loss; InputError if there is no loss of this name."""
    loss = find(name)
    if loss is None:
        known = ", ".join((NONE, *losses(), *ALIASES, *RULES))
        raise InputError.of("adjust.loss", option="loss", value=name, known=known)
    return loss


def scaled(loss: Loss, scale: tuple[float, float] = A_PRIORI) -> Robust:
    """Losses of image points and control points for 95 % efficiency, with constants in units of these scales."""
    constants = (loss.constant(d) * s for d, s in zip((IMAGE, CONTROL), scale, strict=True))
    return Robust(*(ScaledLoss(loss.weight, loss.cost, c) for c in constants))


def inlier_limit(probability: float, dimension: int) -> float:
    """Whitened norm that a good observation does not exceed with this probability: root of the chi-square quantile."""
    return float(np.sqrt(chi_square_quantile(dimension, probability)))


def control_squares(problem: Problem, state: State) -> Array:
    """Squared whitened norms (m,) of the observed control points, in their order."""
    return np.asarray(np.sum(problem.control_residuals(state, np.flatnonzero(problem.observed)) ** 2, axis=1))


def squares(problem: Problem, state: State) -> tuple[Array, Array]:
    """Squared whitened norms of the image points (n,) and of the observed control points (m,), in their order."""
    return np.sum(residuals(problem, state) ** 2, axis=1), control_squares(problem, state)


def weights_at(problem: Problem, state: State, robust: Robust) -> tuple[Weights, float]:
    """Weights at a state, in the order of the problem; cost minus half the weighted sum of squares."""
    image_squares, observed_squares = squares(problem, state)
    image, observed, cost = robust.weigh(image_squares, observed_squares)
    control = np.ones(len(problem.observed))
    control[problem.observed] = observed
    return Weights(image, control), cost - 0.5 * float(image @ image_squares + observed @ observed_squares)


def weighted_problem(problem: Problem, weights: Weights) -> Problem:
    """Least-squares problem with these weights: sigmas are divided by their roots."""
    o, root = problem.observations, np.sqrt(weights.image)
    weighted = replace(o, sigma_line_px=o.sigma_line_px / root, sigma_sample_px=o.sigma_sample_px / root)
    control = problem.control_records.copy()
    control[:, POINT.whitening] *= np.sqrt(weights.control)[:, None]
    records = whitened_records(problem.models, weighted, problem.start.ground + problem.origin_m, problem.origin_m)
    return replace(problem, observations=weighted, records=records, control_records=control)


def robust_scale(problem: Problem, state: State) -> tuple[float, float]:
    """Scales of image points and of control points at a state, in sigmas; 1 with fewer than :data:`LEAST` ratios."""
    blocks = [
        (rows, *image_rows(problem, state, k, rows, jacobian=True)) for k, rows in enumerate(rows_by_image(problem))
    ]
    ground = _ground_cofactors(problem, [(rows, c) for rows, _, _, c in blocks])
    squares = [_of_image(problem, ground, *block) for block in blocks if len(block[0])]
    return _scale(np.concatenate(squares)), _scale(_of_control(problem, state, ground))


def _ground_cofactors(problem: Problem, blocks: list[tuple[npt.NDArray[np.intp], Array]]) -> Array:
    """Cofactors (N, 3, 3) of the unknown ground points, orientation held fixed; zero for all others."""
    rows, c = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    normal = problem.point_normals(problem.observations.point[rows], c)
    out = np.zeros_like(normal)
    out[problem.active] = np.linalg.pinv(normal[problem.active], rcond=1e-14, hermitian=True)
    return out


def _of_image(problem: Problem, ground: Array, rows: npt.NDArray[np.intp], v: Array, b: Array, c: Array) -> Array:
    """Ratios of T to the median of its chi-square, of the image points of one image."""
    q = np.eye(2) - np.einsum("nri,nij,nsj->nrs", c, ground[problem.observations.point[rows]], c)
    kept = np.einsum("nrs,nsu->nru", q, b)
    prior = np.eye(b.shape[2]) if problem.block.options.priors else 0.0
    orientation = np.linalg.pinv(np.einsum("nru,nrw->uw", b, kept) + prior, rcond=1e-14, hermitian=True)
    return _ratios(v, q - np.einsum("nru,uw,nsw->nrs", kept, orientation, kept))


def _of_control(problem: Problem, state: State, ground: Array) -> Array:
    """Ratios of the control points."""
    rows = np.flatnonzero(problem.observed)
    w, v = problem.control_weights(rows), problem.control_residuals(state, rows)
    return _ratios(v, np.eye(3) - np.einsum("nij,njk,nlk->nil", w, ground[rows], w))


def _ratios(v: Array, q: Array) -> Array:
    """Ratios of ``v^T Q^+ v`` to the median of chi-square of the rank of Q, where the rank is not zero."""
    size, axes = np.linalg.eigh(q)
    checked = size > CHECKED
    part = np.einsum("nij,ni->nj", axes, v)
    t = np.sum(np.where(checked, part**2 / np.where(checked, size, 1.0), 0.0), axis=1)
    d = checked.sum(axis=1)
    return np.asarray(t[d > 0] / chi_square_median(d[d > 0]))


def _scale(ratios: Array) -> float:
    return 1.0 if len(ratios) < LEAST else max(float(np.sqrt(np.median(ratios))), LOWEST)


#: Limit of the Danish method in one dimension. In other dimensions the limit has the same probability.
DANISH_LIMIT: Final = 2.5
DANISH_FACTOR: Final = 0.05
DANISH_EXPONENTS: Final = (4.4, 3.0)
#: Cycles with the first exponent.
DANISH_FIRST: Final = 3
#: Lower bound of the norms of the least absolute values, in sigmas.
EPSILON: Final = 1e-3
#: Largest change of a whitened norm at the end. Weiszfeld's steps shrink slowly: further digits are expensive.
TOLERANCE: Final = 1e-2
CYCLES: Final = 200


class Rule(Protocol):
    """New weights of one group from the last weights and the norms of whitened residuals.

    ``cycle`` counts from 1; ``dimension`` is the number of residuals of a norm; ``sigma0`` is a posteriori.
    """

    def __call__(self, last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:  # noqa: D102
        ...


def danish_limit(dimension: int) -> float:
    """Norm with the probability of 2.5 sigmas in one dimension."""
    return inlier_limit(float(chi_square_probability(1.0, DANISH_LIMIT**2)), dimension)


def danish_original(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """Weights of the Danish method; see the module docstring."""
    exponent, r = DANISH_EXPONENTS[0 if cycle <= DANISH_FIRST else 1], norm / max(sigma0, 1.0)
    factor = np.exp(-DANISH_FACTOR * np.where(r > danish_limit(dimension), r, 0.0) ** exponent)
    return np.maximum(last * factor, FLOOR)


def least_absolute(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """Weights of least absolute values; see the module docstring."""
    return np.asarray(1.0 / np.maximum(norm, EPSILON))


#: Rules without a cost function, iterated in cycles, by the value of the option ``loss``.
RULES: Final[dict[str, Rule]] = {"danish_original": danish_original, "lad": least_absolute}
#: Dimensions of the norms of :func:`norms_at`.
DIMENSIONS: Final = (IMAGE, CONTROL)


class Reweighted(NamedTuple, Generic[S]):
    """End of the cycles: last fit and its weights, number of cycles, whether the norms have converged."""

    fit: S
    weights: tuple[Array, ...]
    cycles: int
    settled: bool


def reweight(
    fit: Callable[[tuple[Array, ...], S | None], S],
    norms: Callable[[S], tuple[Array, ...]],
    sigma0: Callable[[S], float],
    rule: Rule,
    dimensions: tuple[int, ...],
    max_cycles: int = CYCLES,
) -> Reweighted[S]:
    """Run the cycles.

    Parameters
    ----------
    fit : callable
        Least squares with weights, one array per group of observations, starting at the last fit. The first call
        receives None as fit and no weights, which means 1.
    norms : callable
        Whitened norms of the residuals, one array per group.
    sigma0 : callable
        A posteriori standard deviation of unit weight of a fit.
    rule : Rule
    dimensions : tuple of int
        Residuals of each norm, by group.
    """
    last_fit = fit((), None)
    norm = norms(last_fit)
    weights = tuple(np.ones_like(t) for t in norm)
    for cycle in range(1, max_cycles + 1):
        groups, before = zip(weights, norm, dimensions, strict=True), norm
        unit = sigma0(last_fit)
        weights = tuple(rule(w, t, cycle, d, unit) for w, t, d in groups)
        last_fit = fit(weights, last_fit)
        norm = norms(last_fit)
        if all(np.abs(a - b).max(initial=0.0) < TOLERANCE for a, b in zip(norm, before, strict=True)):
            return Reweighted(last_fit, weights, cycle, settled=True)
    return Reweighted(last_fit, weights, max_cycles, settled=False)


def norms_at(problem: Problem, state: State) -> tuple[Array, Array]:
    """Whitened norms of image points (n,) and observed control points (m,)."""
    return np.linalg.norm(residuals(problem, state), axis=1), np.sqrt(control_squares(problem, state))


def weights_of(problem: Problem, groups: tuple[Array, ...]) -> Weights:
    """Weights of the problem from weights of image points and observed control points; by default 1."""
    control = np.ones(len(problem.observed))
    if not groups:
        return Weights(np.ones(len(problem.observations)), control)
    control[problem.observed] = groups[1]
    return Weights(groups[0], control)


class CycleResult(NamedTuple):
    """End of a cycle: state and weighted sum of squares."""

    state: State
    chi2: float


def cycles_on_arrays(
    problem: Problem, callback: Callback
) -> Callable[[tuple[Array, ...], CycleResult | None], CycleResult]:
    """Weighted least squares on the graph of images or the Schur backend for :func:`reweight`.

    The problem is compiled once, which takes many times as long as the two or three iterations of a cycle. The weights
    multiply the rows, like the weights of a loss. ``callback`` receives each iteration.
    """
    from fg_orient.adjustment.graph import GraphBackend
    from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
    from fg_orient.adjustment.schur import SchurBackend

    options = problem.block.options
    as_graph = options.backend == "graph"
    backend: Any = GraphBackend(problem) if as_graph else SchurBackend(problem)
    optimise = (GTSAM_OPTIMIZERS if as_graph else OPTIMIZERS)[options.optimizer]
    structure = backend.elimination.backend.structure if as_graph else backend.structure

    def fit(groups: tuple[Array, ...], last: CycleResult | None) -> CycleResult:
        weights = weights_of(problem, groups)
        backend.robust = FixedWeights(weights.image[structure.row], weights.control[structure.observed])
        start: Carried[State] = Carried(problem.start if last is None else last.state)
        with one_blas_thread():
            result = optimise(backend, start, options.max_iterations, callback)
        return CycleResult(result.state, 2.0 * result.error)

    return fit
