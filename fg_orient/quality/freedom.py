"""Degrees of freedom of outlier tests with estimated variance components.

With components estimated from the residuals, the variance of a suspect's estimated error is a mixture of them::

    Var = sum_j c_j s_j^2,   c_j = tr((E^T R E)^+ E^T R E_j R E) / d,   sum_j c_j = 1

and is itself uncertain by ``c^T C c``, C the covariance of the s_j^2 (``fg_orient.quality.variance_components``). Its
degrees of freedom are ``nu = 2 / (c^T C c)`` (Satterthwaite 1946; of mixed models: Fai & Cornelius 1996). T of the
suspect is then judged as in ``fg_orient.quality.hypotheses`` with ``v^T v = f = nu``. Taking the redundancy of the
whole block instead is too strict, that of the suspect's own group too lax (docs/variance-components.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.quality import hypotheses
from fg_orient.quality.prediction import Fit
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
    names = [c.group for c in components.components]
    free = [names.index(c.group) for c in components.components if not c.held]
    covariance = np.zeros((len(names) + 1, len(names) + 1))  # the last is what belongs to no group: known
    covariance[np.ix_(free, free)] = components.covariance
    r = residuals.projector()
    out = []
    for s in found:
        for k in range(len(s.point)):
            rows = residuals.rows_of(int(s.point[k]), int(s.row[k]), s.v.shape[1])
            columns = residuals.turned(rows, s.columns[k])
            share = _own(residuals, rows, columns) if r is None else _shares(residuals, r, rows, columns)
            variance = float(share @ covariance @ share)
            out.append(min(KNOWN, 2.0 / variance) if variance > 0.0 else KNOWN)
    return np.array(out)


def _shares(residuals: Residuals, r: Array, rows: Index, columns: Array) -> Array:
    """Shares c of one suspect: what each group contributes to the variance of its error, last what belongs to none."""
    effect = r[:, rows] @ columns
    size, axes = np.linalg.eigh(columns.T @ effect[rows])
    checked = size > 1e-6 * max(float(size[-1]), np.finfo(float).tiny)
    weight = np.sum((effect @ (axes[:, checked] / np.sqrt(size[checked]))) ** 2, axis=1) / max(int(checked.sum()), 1)
    return np.asarray(np.bincount(_positive(residuals), weight, len(residuals.groups.names) + 1))


def _own(residuals: Residuals, rows: Index, columns: Array) -> Array:
    """The same where R is not known: only the groups of the suspect's own rows."""
    weight = np.sum(columns**2, axis=1)
    found = np.bincount(_positive(residuals)[rows], weight, len(residuals.groups.names) + 1)
    return np.asarray(found / found.sum())


def _positive(residuals: Residuals) -> Index:
    """Groups of all rows, none being the last number."""
    labels = residuals.labels
    return np.where(labels < 0, len(residuals.groups.names), labels)


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
