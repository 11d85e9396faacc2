"""Shrinkage estimators as penalties of the canonical components: generalised ridge, Stein, and both combined.

With ``A = U S V^T``, ``beta = U^T l`` and the variance s0^2 of unit weight, least squares
are ``V (beta / s)``. Each estimator is ``V (s beta / (s^2 + r))`` with its own penalty r
of each component:

- *generalised ridge* (Hoerl & Kennard 1970): ``r = s0^2 / alpha^2`` with the estimate alpha itself. The fixed
  point is ``alpha = (beta / s) (1/2 + sqrt(1/4 - s0^2 / beta^2))``, and 0 for ``beta^2 <
  4 s0^2`` (Hemmerle 1975);
- *Stein* (James & Stein 1961; for regressions Judge & Bock 1978): all components are multiplied by the positive part of
  ``c = 1 - (u - 2) / (f + 2) |A x - l|^2 / |A x|^2``; ``r = s^2 (1 / c - 1)``;
- *combined* (Gui & Li 2002; Tao et al. 2004): ridge of the components with small singular values, ``s^2 < k``, with k
  of Hoerl, Kennard & Baldwin (1975); then Stein's factor for all components. These papers
  print no numbers; "small" is our interpretation.

The estimators minimise ``|A x - l|^2 + sum r_i (v_i^T x)^2``, a penalty of the total
deviation, so every backend can compute them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import unit_variance
from fg_orient.adjustment.linear.registry import register_solver
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem

#: Minimum factor of Stein's estimator. A factor of 0 would be an infinite penalty.
LEAST_FACTOR: Final = 1e-6

#: Function from singular values, beta (p,), variance of unit weight and degrees of
#: freedom to penalties (p,); inf holds a component fixed.
Penalties = Callable[[Array, Array, float, int], Array]


def generalised_ridge(values: Array, beta: Array, variance: float, freedom: int) -> Array:
    """Return the penalties of the generalised ridge at its fixed point; inf for components that it sets to zero."""
    ratio = variance / np.maximum(beta**2, np.finfo(float).tiny)
    kept = 0.5 + np.sqrt(np.maximum(0.25 - ratio, 0.0))
    return np.where(ratio <= 0.25, values**2 * (1.0 / kept - 1.0), np.inf)


def stein_factor(squares: float, unknowns: int, variance: float, freedom: int) -> float:
    """Return the factor c of Stein's estimator; ``squares`` are |A x|^2."""
    shrunk = (unknowns - 2) / (freedom + 2) * freedom * variance / squares if squares > 0.0 else 1.0
    return float(np.clip(1.0 - shrunk, LEAST_FACTOR, 1.0))


def stein(values: Array, beta: Array, variance: float, freedom: int) -> Array:
    """Return the penalties of Stein's estimator."""
    c = stein_factor(float(beta @ beta), len(values), variance, freedom)
    return np.asarray(values**2 * (1.0 / c - 1.0))


def ridge_stein(values: Array, beta: Array, variance: float, freedom: int) -> Array:
    """Return the penalties of the combined estimator."""
    kappa = len(values) * variance / float(np.sum((beta / values) ** 2))
    ridge = np.where(values**2 < kappa, kappa, 0.0)
    fitted = values**2 * beta / (values**2 + ridge)
    c = stein_factor(float(fitted @ fitted), len(values), variance, freedom)
    return np.asarray((values**2 + ridge) / c - values**2)


#: Estimators by name.
SHRINKAGE: Final[dict[str, Penalties]] = {
    "generalised_ridge": generalised_ridge, "stein": stein, "ridge_stein": ridge_stein,
}  # fmt: skip
_LABELS: Final = {
    "generalised_ridge": ("Generalised ridge", "Hoerl, Kennard 1970; Hemmerle 1975"),
    "stein": ("Stein", "James, Stein 1961; Judge, Bock 1978"),
    "ridge_stein": ("Ridge-Stein", "Gui, Li 2002; Tao et al. 2004"),
}


def shrinkage_penalties(name: str, system: LinearSystem) -> tuple[Array, Array, Array]:
    """Return the penalties (p,) of an estimator, with beta (p,) and V^T (p, u), of a system of full rank.

    InputError: A is not known, or the redundancy is not positive.
    """
    _, observed = system.require_design(name)
    left, values, right = system.decomposition
    beta = left.T @ observed
    variance = unit_variance(system, right.T @ (beta / values))
    return SHRINKAGE[name](values, beta, variance, system.redundancy), beta, right


def _solver(name: str) -> Callable[[LinearSystem, bool], LinearSolution]:
    def solve_shrunk(system: LinearSystem, as_run: bool) -> LinearSolution:
        penalties, beta, right = shrinkage_penalties(name, system)
        values = system.decomposition[1]
        return LinearSolution(right.T @ (values * beta / (values**2 + penalties)), rank=len(system))

    return solve_shrunk


for _name, (_label, _source) in _LABELS.items():
    register_solver(_name, _label, "tikhonov", source=_source)(_solver(_name))
