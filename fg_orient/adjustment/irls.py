"""Reweighted least squares with weights that belong to no loss: original Danish method, least absolute values.

Each cycle solves the least-squares problem with the weights of the last cycle, and
computes new weights from the whitened norms t of the residuals. Priors and extra
observations keep weight 1.

Danish method (Krarup, Juhl & Kubik 1980), with r = t / sigma0 (a posteriori, at least 1).
If r exceeds its limit, a weight is multiplied by ``exp(-0.05 r^4.4)`` in the first three
cycles and by ``exp(-0.05 r^3)`` afterwards. The exponent depends on the cycle and weights
never increase again. The method therefore has no cost function, and the result depends on
the sequence of cycles. :mod:`factors.losses.standard` has the form with a cost function.

Least absolute values: ``w = 1 / max(t, eps)`` minimises the sum of t (Schlossmacher 1973;
for 2 and 3 numbers the sum of lengths, Weiszfeld 1937). It has no tuning constant. Its
efficiency at the normal distribution is 2/pi, pi/4 and 8/(3 pi) in 1, 2 and 3 dimensions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from factors.arrays import Array
from factors.losses import ALIASES, Loss, find, losses
from fg_orient.adjustment.loop import OPTIMIZERS, Callback, Carried
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import (
    CONTROL,
    FLOOR,
    IMAGE,
    NONE,
    FixedWeights,
    Weights,
    inlier_limit,
    squares,
)
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.distributions import chi_square_probability
from fg_orient.model.errors import InputError

S = TypeVar("S")


def find_loss(name: str) -> Loss:
    """Return the loss with this name; raise InputError if it does not exist."""
    loss = find(name)
    if loss is None:
        known = ", ".join((NONE, *losses(), *ALIASES, *RULES))
        raise InputError.of("adjust.loss", option="loss", value=name, known=known)
    return loss


#: Limit of the Danish method in one dimension, in sigmas. In other dimensions, the limit has the same probability.
DANISH_LIMIT: Final = 2.5
DANISH_FACTOR: Final = 0.05
DANISH_EXPONENTS: Final = (4.4, 3.0)
#: Number of cycles with the first exponent.
DANISH_FIRST: Final = 3
#: Lower bound of the norms for least absolute values, in sigmas.
EPSILON: Final = 1e-3
#: Largest change of a whitened norm at the end. Weiszfeld's steps shrink slowly, so more digits are expensive.
TOLERANCE: Final = 1e-2
CYCLES: Final = 200


class Rule(Protocol):
    """Function that computes new weights of one group from the last weights and the norms of whitened residuals.

    ``cycle`` counts from 1; ``dimension`` is the number of residuals of a norm; ``sigma0`` is a posteriori.
    """

    def __call__(self, last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:  # noqa: D102
        ...


def danish_limit(dimension: int) -> float:
    """Return the norm with the same probability as 2.5 sigmas in one dimension."""
    return inlier_limit(float(chi_square_probability(1.0, DANISH_LIMIT**2)), dimension)


def danish_original(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """Return the weights of the Danish method; see the module docstring."""
    exponent, r = DANISH_EXPONENTS[0 if cycle <= DANISH_FIRST else 1], norm / max(sigma0, 1.0)
    factor = np.exp(-DANISH_FACTOR * np.where(r > danish_limit(dimension), r, 0.0) ** exponent)
    return np.maximum(last * factor, FLOOR)


def least_absolute(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """Return the weights of least absolute values; see the module docstring."""
    return np.asarray(1.0 / np.maximum(norm, EPSILON))


#: Rules without a cost function, which are iterated in cycles, by the value of the option ``loss``.
RULES: Final[dict[str, Rule]] = {"danish_original": danish_original, "lad": least_absolute}
#: Dimensions of the norms of :func:`norms_at`.
DIMENSIONS: Final = (IMAGE, CONTROL)


class Reweighted(NamedTuple, Generic[S]):
    """End of the cycles: last fit and its weights, number of cycles, and whether the norms have converged."""

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
        Least squares with weights, one array per group of observations; it starts at the
        last fit. At the first call the fit is None and there are no weights, which means
        1.
    norms : callable
        Whitened norms of the residuals, one array per group.
    sigma0 : callable
        A posteriori standard deviation of unit weight of a fit.
    rule : Rule
    dimensions : tuple of int
        Number of residuals of each norm, by group.
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
    """Return the whitened norms that determine the weights of image points (n,) and observed control points (m,)."""
    image, control = squares(problem, state)
    return np.sqrt(image), np.sqrt(control)


def weights_of(problem: Problem, groups: tuple[Array, ...]) -> Weights:
    """Return the weights of the problem from weights of image points and observed control points.

    By default 1.
    """
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
    """Run weighted least squares on the graph of images or the Schur backend for :func:`reweight`.

    The problem is compiled only once, because this takes many times as long as the two or
    three iterations of a cycle. The weights multiply the rows, like the weights of a
    loss. ``callback`` receives each iteration.
    """
    from fg_orient.adjustment.graph import GraphBackend
    from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
    from fg_orient.adjustment.schur import SchurBackend

    options = problem.block.options
    as_graph = options.backend == "graph"
    backend: Any = GraphBackend(problem, grouped=False) if as_graph else SchurBackend(problem)
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
