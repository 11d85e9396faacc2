"""Reweighted least squares whose weights are no loss: the original Danish method, least absolute values.

Each cycle solves the least-squares problem with the weights of the last and gives new ones from the whitened norms t
of its residuals. Priors and own observations keep weight 1.

Danish method (Krarup, Juhl & Kubik 1980): with r = t / sigma0 (a posteriori, 1 at least) a weight is multiplied by
``exp(-0.05 r^4.4)`` in the first three cycles and by ``exp(-0.05 r^3)`` afterwards where r exceeds its limit. The
exponent depends on the cycle and weights never rise again, so no cost belongs to it: the result depends on the way.
:mod:`factors.losses.standard` has the form that has one.

Least absolute values: ``w = 1 / max(t, eps)`` minimises the sum of t (Schlossmacher 1973; for 2 and 3 numbers the sum
of lengths, Weiszfeld 1937). There is no constant to choose: its efficiency at the normal distribution is 2/pi, pi/4
and 8/(3 pi) in 1, 2 and 3 dimensions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import CONTROL, FLOOR, IMAGE, Weights, control_squares, inlier_limit
from fg_orient.adjustment.rows import residuals
from fg_orient.model.distributions import chi_square_probability

Array = npt.NDArray[np.float64]
S = TypeVar("S")

#: Limit of the Danish method in one dimension; others keep its probability.
DANISH_LIMIT: Final = 2.5
DANISH_FACTOR: Final = 0.05
DANISH_EXPONENTS: Final = (4.4, 3.0)
#: Cycles with the first exponent.
DANISH_FIRST: Final = 3
#: Least absolute values: norms below this, in sigmas, count as this.
EPSILON: Final = 1e-3
#: Cycles end when no whitened norm has changed by more. Weiszfeld's steps shrink slowly: the last digits cost much.
TOLERANCE: Final = 1e-2
CYCLES: Final = 200


class Rule(Protocol):
    """New weights of one group from the last ones and the norms of whitened residuals.

    ``cycle`` counts from 1; ``dimension`` is the number of residuals behind a norm; ``sigma0`` is a posteriori.
    """

    def __call__(self, last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:  # noqa: D102
        ...


def danish_limit(dimension: int) -> float:
    """Norm that a good observation exceeds as seldom as one number exceeds 2.5 sigmas."""
    return inlier_limit(float(chi_square_probability(1.0, DANISH_LIMIT**2)), dimension)


def danish_original(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """See the head of the module."""
    exponent, r = DANISH_EXPONENTS[0 if cycle <= DANISH_FIRST else 1], norm / max(sigma0, 1.0)
    factor = np.exp(-DANISH_FACTOR * np.where(r > danish_limit(dimension), r, 0.0) ** exponent)
    return np.maximum(last * factor, FLOOR)


def least_absolute(last: Array, norm: Array, cycle: int, dimension: int, sigma0: float) -> Array:
    """See the head of the module."""
    return np.asarray(1.0 / np.maximum(norm, EPSILON))


#: By the name that the option ``loss`` takes (``fg_orient.adjustment.robust.IN_CYCLES``).
RULES: Final[dict[str, Rule]] = {"danish_original": danish_original, "lad": least_absolute}
#: Residuals behind the norms of :func:`norms_at`.
DIMENSIONS: Final = (IMAGE, CONTROL)


@dataclass(frozen=True)
class Reweighted(Generic[S]):
    """End of the cycles: last fit, the weights it was made with, number of cycles, whether they had settled."""

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
        Least squares with weights, one array per group of observations, beginning at the last fit (None: the first,
        whose weights are empty and mean 1).
    norms : callable
        Whitened norms of the residuals, one array per group.
    sigma0 : callable
        A posteriori standard deviation of unit weight of a fit.
    rule : Rule
    dimensions : tuple of int
        Residuals behind each norm, by group.
    """
    found = fit((), None)
    now = norms(found)
    weights = tuple(np.ones_like(t) for t in now)
    for cycle in range(1, max_cycles + 1):
        groups, unit, last = zip(weights, now, dimensions, strict=True), sigma0(found), now
        weights = tuple(rule(w, t, cycle, d, unit) for w, t, d in groups)
        found = fit(weights, found)
        now = norms(found)
        if all(np.abs(a - b).max(initial=0.0) < TOLERANCE for a, b in zip(now, last, strict=True)):
            return Reweighted(found, weights, cycle, settled=True)
    return Reweighted(found, weights, max_cycles, settled=False)


def norms_at(problem: Problem, state: State) -> tuple[Array, Array]:
    """Whitened norms of image points (n,) and observed control points (m,)."""
    return np.linalg.norm(residuals(problem, state), axis=1), np.sqrt(control_squares(problem, state))


def weights_of(problem: Problem, groups: tuple[Array, ...]) -> Weights:
    """Weights from those of image points and observed control points; none: 1."""
    control = np.ones(len(problem.observed))
    if not groups:
        return Weights(np.ones(len(problem.observations)), control)
    control[problem.observed] = groups[1]
    return Weights(groups[0], control)
