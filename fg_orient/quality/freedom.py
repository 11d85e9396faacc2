"""Degrees of freedom of tests with estimated variance components.

The variance of a suspect's estimated error is a sum of them ::

    Var = sum_j c_j s_j^2,   c_j = tr((E^T R E)^+ E^T R E_j R E) / d,   sum_j c_j = 1

with the variance ``c^T C c``, C the covariance of the s_j^2 (``fg_orient.quality.variance_components``). Its degrees of
freedom are ``nu = 2 / (c^T C c)`` (Satterthwaite 1946; of mixed models: Fai & Cornelius 1996). T of the suspect is then
tested as in ``fg_orient.quality.hypotheses`` with ``v^T v = f = nu``. The redundancy of the whole block would be too
strict, that of the suspect's group too lax (docs/variance-components.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.model.errors import NoSolutionError
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.variance_components import VarianceComponents

if TYPE_CHECKING:
    from fg_orient.quality.suspects import Suspects

#: Degrees of freedom of a known variance: the F distribution is that of chi-square to 1e-8.
KNOWN: Final = 1e8


def freedoms(residuals: GroupedResiduals, suspects: Sequence[Suspects], components: VarianceComponents) -> Array:
    """Degrees of freedom (n,) of all suspects; for too many unknowns and groups those of the suspect's group.

    Parameters
    ----------
    residuals : GroupedResiduals
        Of the solution with these components.
    suspects : sequence of Suspects
        Of the same solution.
    components : VarianceComponents
    """
    covariance, parts = _covariance(components), residuals.parts
    out = [np.zeros(0)]
    for s in suspects:
        share = _own(residuals, s) if parts is None else parts.shares(s.point, s.rows, s.columns)
        out.append(_satterthwaite(share, covariance))
    return np.concatenate(out)


def _covariance(components: VarianceComponents) -> Array:
    """C of all groups; zero for held components, and in the last row and column for ungrouped observations."""
    names = [c.group for c in components.components]
    free = [k for k, c in enumerate(components.components) if not c.held]
    covariance = np.zeros((len(names) + 1, len(names) + 1))
    covariance[np.ix_(free, free)] = components.covariance
    return covariance


def _satterthwaite(share: Array, covariance: Array) -> Array:
    """Degrees of freedom (n,) of shares (n, g)."""
    variance = np.einsum("ng,gh,nh->n", share, covariance, share)
    return np.asarray(np.minimum(KNOWN, 2.0 / np.maximum(variance, 2.0 / KNOWN)))


def _own(residuals: GroupedResiduals, s: Suspects) -> Array:
    """Shares (n, g) of the groups of the suspects' rows, if the contributions of all groups are not known."""
    select = np.eye(len(residuals.groups.names) + 1)[residuals.labels]  # -1 is the last
    share = np.einsum("nm,nmg->ng", np.sum(s.columns**2, axis=2), select[s.rows])
    return np.asarray(share / share.sum(axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class UnknownFreedom:
    """Degrees of freedom of tests of image unknowns: their variance is a sum of the components, too.

    Cofactors ``Q = sum_j W_j`` (``fg_orient.quality.residuals``), so of unknowns with cofactors ``Q = L L^T``
    together ``c_j = tr(L^-1 W_j L^-T) / d``.

    Parameters
    ----------
    parts : (g, u, u) array
        W_j of the image unknowns, shared ones once.
    covariance : (g, g) array
    free : (w,) int array
        Row of ``parts`` of each place in ``problem.image_columns``.
    """

    parts: Array
    covariance: Array
    free: Index

    @classmethod
    def of(cls, known: ResidualCofactors, components: VarianceComponents) -> UnknownFreedom:
        """Of a solution with these components; NoSolutionError if image unknowns and groups are too many."""
        problem = known.problem
        groups = groups_of(problem, problem.block.options.variance_components)
        parts = GroupedResiduals(known, groups).parts
        u = problem.n_free_unknowns
        if parts is None:
            raise NoSolutionError.of(
                "statistics.components_large", place=problem.block.name, value=u, groups=len(groups.names)
            )
        free = np.arange(u) if problem.ties is None else problem.ties.of
        return cls(parts.parts, _covariance(components), free)

    def each(self) -> Array:
        """Degrees of freedom (w,) of every unknown alone, in the order of ``problem.image_columns``."""
        share = np.einsum("guu->ug", self.parts)
        return _satterthwaite(share / share.sum(axis=1, keepdims=True), self.covariance)[self.free]

    def together(self, index: Index) -> float:
        """Degrees of freedom of the F test of unknowns at these places."""
        mine = self.free[index]
        parts = self.parts[:, mine[:, None], mine]
        q = parts.sum(axis=0)
        length = np.sqrt(np.diag(q))
        scaled = parts / np.outer(length, length)
        share = np.einsum("gii->g", np.linalg.solve(q / np.outer(length, length), scaled)) / len(mine)
        return float(_satterthwaite(share[None], self.covariance)[0])


def least_freedom(components: VarianceComponents) -> float:
    """Degrees of freedom of the least certain component, for observations that were not in the adjustment."""
    variances = np.diag(components.covariance)
    return min(KNOWN, 2.0 / float(variances.max())) if len(variances) else KNOWN
