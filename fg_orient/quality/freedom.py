"""Degrees of freedom of tests with estimated variance components.

With components estimated from the residuals, the variance of a suspect's estimated error is a mixture of them::

    Var = sum_j c_j s_j^2,   c_j = tr((E^T R E)^+ E^T R E_j R E) / d,   sum_j c_j = 1

and is itself uncertain by ``c^T C c``, C the covariance of the s_j^2 (``fg_orient.quality.variance_components``). Its
degrees of freedom are ``nu = 2 / (c^T C c)`` (Satterthwaite 1946; of mixed models: Fai & Cornelius 1996). T of the
suspect is then judged as in ``fg_orient.quality.hypotheses`` with ``v^T v = f = nu``. Taking the redundancy of the
whole block instead is too strict, that of the suspect's own group too lax (docs/variance-components.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from fg_orient.adjustment.problem import Problem, State
from fg_orient.errors import NoSolutionError
from fg_orient.quality import hypotheses
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.observation_groups import groups_of
from fg_orient.quality.prediction import Fit
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import Suspects
from fg_orient.quality.variance_components import Residuals, VarianceComponents

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Stands for a variance that is known: the F distribution is the chi-square one then, to 1e-8.
KNOWN: Final = 1e8


def freedoms(residuals: Residuals, found: Sequence[Suspects], components: VarianceComponents) -> Array:
    """Degrees of freedom of all suspects, in their order.

    Parameters
    ----------
    residuals : Residuals
        Of the solution that the components belong to.
    found : sequence of Suspects
        Of the same.
    components : VarianceComponents

    Returns
    -------
    (n,) array
        Where the block is too large to form R, those of the suspect's own group.
    """
    covariance = _covariance(components)
    r, groups = residuals.projector(), _groups(residuals)
    select = np.eye(len(covariance))[groups]
    out = [np.zeros(0)]
    for s in found:
        rows, columns = residuals.rows_of(s), residuals.columns_of(s)
        share = _own(select, rows, columns) if r is None else _shares(select, r, rows, columns)
        out.append(_satterthwaite(share, covariance))
    return np.concatenate(out)


def _covariance(components: VarianceComponents) -> Array:
    """C of all groups, zero for what is held, and at the end for what belongs to no group: known."""
    names = [c.group for c in components.components]
    free = [k for k, c in enumerate(components.components) if not c.held]
    covariance = np.zeros((len(names) + 1, len(names) + 1))
    covariance[np.ix_(free, free)] = components.covariance
    return covariance


def _groups(residuals: Residuals) -> Index:
    """Groups of all rows, none being the last number."""
    return np.where(residuals.labels < 0, len(residuals.groups.names), residuals.labels)


def _satterthwaite(share: Array, covariance: Array) -> Array:
    """Degrees of freedom (n,) of shares (n, g)."""
    variance = np.einsum("ng,gh,nh->n", share, covariance, share)
    return np.asarray(np.minimum(KNOWN, 2.0 / np.maximum(variance, 2.0 / KNOWN)))


def _shares(select: Array, r: Array, rows: Index, columns: Array) -> Array:
    """Shares c (n, g): what each group contributes to the variance of an error, last what belongs to none."""
    effect = np.einsum("rnm,nmk->rnk", r[:, rows], columns)
    own = effect[rows, np.arange(len(rows))[:, None]]
    size, axes = np.linalg.eigh(np.swapaxes(columns, 1, 2) @ own)
    checked = size > 1e-6 * np.maximum(size[:, -1:], np.finfo(float).tiny)
    scaled = np.where(checked[:, None], axes / np.sqrt(np.where(checked, size, 1.0))[:, None], 0.0)
    weight = np.sum(np.einsum("rnk,nka->rna", effect, scaled) ** 2, axis=2) / np.maximum(checked.sum(axis=1), 1)
    return np.asarray(weight.T @ select)


def _own(select: Array, rows: Index, columns: Array) -> Array:
    """The same where R is not known: only the groups of the suspect's own rows."""
    found = np.einsum("nm,nmg->ng", np.sum(columns**2, axis=2), select[rows])
    return np.asarray(found / found.sum(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class UnknownFreedom:
    """Degrees of freedom of tests of image unknowns: their variance is a mixture of the components, too.

    ``x = H l`` with ``H = N^-1 A^T``, whitened, so of unknowns with cofactors ``Q = L L^T`` together
    ``c_j = tr(L^-1 H E_j H^T L^-T) / d``.

    Parameters
    ----------
    effect : (u, n) array
        H of the image unknowns, shared ones once.
    select : (n, g) array
        1 where a row belongs to a group.
    covariance : (g, g) array
    free : (w,) int array
        Row of ``effect`` of each place in ``problem.image_columns``.
    """

    effect: Array
    select: Array
    covariance: Array
    free: Index

    @classmethod
    def of(
        cls, problem: Problem, state: State, cofactors: Cofactors, components: VarianceComponents,
        known: ResidualCofactors,
    ) -> UnknownFreedom:  # fmt: skip
        """Take all that is needed of a solution with these components.

        Raises
        ------
        NoSolutionError
            The block is too large.
        """
        groups = groups_of(problem, problem.block.options.variance_components)
        residuals = Residuals(problem, state, cofactors, groups, known)
        if not residuals.small:
            raise NoSolutionError.of(
                "statistics.components_large", place=problem.block.name, value=len(residuals.labels)
            )
        q, r, length = residuals.factors
        u = problem.n_free_unknowns
        effect = solve_triangular(r, q.T)[:u] / length[:u, None]
        select = np.eye(len(components.components) + 1)[_groups(residuals)]
        free = np.arange(u) if problem.ties is None else problem.ties.of
        return cls(effect, select, _covariance(components), free)

    def each(self) -> Array:
        """Degrees of freedom (w,) of every unknown alone, in the order of ``problem.image_columns``."""
        share = self.effect**2 @ self.select
        return _satterthwaite(share / share.sum(axis=1, keepdims=True), self.covariance)[self.free]

    def together(self, index: Index) -> float:
        """Degrees of freedom of the F test of unknowns at these places."""
        basis = np.linalg.qr((self.effect[self.free[index]] / self._length[self.free[index], None]).T).Q
        share = np.sum(basis**2, axis=1) @ self.select / basis.shape[1]
        return float(_satterthwaite(share[None], self.covariance)[0])

    @property
    def _length(self) -> Array:
        return np.asarray(np.linalg.norm(self.effect, axis=1))


def least_freedom(components: VarianceComponents) -> float:
    """Degrees of freedom of the component that is known worst: of what was not in the adjustment."""
    variances = np.diag(components.covariance)
    return min(KNOWN, 2.0 / float(variances.max())) if len(variances) else KNOWN


def with_freedom(fit: Fit, freedom: float, test: str) -> Fit:
    """Judge what was predicted from the rest with degrees of freedom of its own."""
    if not fit.dimension:
        return fit
    t, d = np.array([fit.quadratic]), np.array([fit.dimension])
    f = freedom + fit.dimension
    statistic, p = (
        float(law(t, d, freedom + t, f, test)[0]) for law in (hypotheses.statistics, hypotheses.probabilities)
    )
    return replace(fit, statistic=statistic, probability=p)
