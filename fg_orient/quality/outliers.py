"""Outlier tests: each observation is tested against all others with the covariance of the residuals.

Suspects and their T: ``fg_orient.quality.suspects``. Tests and control of multiple tests:
``fg_orient.quality.hypotheses``. Inseparable suspects (for example the position of a control point and its only image
point) are one hypothesis and are named together. The search that excludes observations is
``fg_orient.orientation.outlier_search``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.problem import Problem
from fg_orient.model.errors import InputError
from fg_orient.quality import hypotheses
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.outlier_records import OutlierTests
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import KINDS, Kind, Suspects, suspects
from fg_orient.quality.variance_components import VarianceComponents, freedoms

#: Two suspects are inseparable if the relative difference of their T is smaller than this.
SAME: Final = 1e-6


def outlier_tests(
    known: ResidualCofactors,
    chi2: float,
    *,
    level: float,
    test: str,
    control: str,
    kind: Kind = "groups",
    components: VarianceComponents | None = None,
) -> OutlierTests:
    """Test all suspects of a kind at a least-squares solution.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of the solution, with their cofactors.
    chi2 : float
        Weighted sum of squares of all residuals.
    level, test, control, kind
        See ``fg_orient.quality.hypotheses`` and :func:`suspects`; InputError for an unknown name or invalid level.
    components : VarianceComponents, optional
        Variance components in the sigmas of the problem. The degrees of freedom then differ from test to test
        (``fg_orient.quality.variance_components``).
    """
    hypotheses.require_names(test, control, level)
    if kind not in KINDS:
        raise InputError.of("options.value", place="kind", value=repr(kind), expected=", ".join(KINDS))
    problem = known.problem
    if components is None:
        return assess_suspects(problem, suspects(known, kind), chi2, level=level, test=test, control=control)
    families, groups = suspects(known, kind), groups_of(problem, problem.block.options.variance_components)
    freedom = freedoms(GroupedResiduals(known, groups), families, components)
    return assess_suspects(problem, families, chi2, level=level, test=test, control=control, freedom=freedom)


def assess_suspects(
    problem: Problem,
    families: Sequence[Suspects],
    chi2: float,
    *,
    level: float,
    test: str,
    control: str,
    freedom: Array | None = None,
) -> OutlierTests:
    """Test suspects and sort them; see :func:`outlier_tests`.

    ``freedom`` (n,) replaces both v^T v and f of each suspect.
    """
    sizes = [len(s.point) for s in families]
    results = [s.quadratic() for s in families]
    t, d = np.concatenate([r[0] for r in results]), np.concatenate([r[1] for r in results])
    error = np.full((len(t), 2), np.nan)
    for end, s, (_, _, own) in zip(np.cumsum(sizes), families, results, strict=True):
        if s.unit:
            error[end - len(own) : end, : own.shape[1]] = own
    part, point, row = np.repeat(np.arange(len(families)), sizes), _column(families, "point"), _column(families, "row")
    parts, units = tuple(s.part for s in families), tuple(s.unit for s in families)
    del families, results  # freed now, which halves the memory of the tests
    f: Array = np.asarray(float(problem.redundancy) if freedom is None else freedom)
    squares: Array = np.asarray(chi2 if freedom is None else freedom)
    tested = hypotheses.can_be_tested(d, f, test)
    f, squares = (values if values.ndim == 0 else values[tested] for values in (f, squares))
    d = np.where(tested, d, 0)
    error[~tested] = np.nan
    classes, of_class = _classes(point, d, t, tested)
    probability, statistic, critical = np.ones(len(t)), np.full(len(t), np.nan), np.full(len(t), np.nan)
    probability[tested] = hypotheses.probabilities(t[tested], d[tested], squares, f, test)
    each = hypotheses.level_of_each(probability[classes], level, control)
    statistic[tested] = hypotheses.statistics(t[tested], d[tested], squares, f, test)
    critical[tested] = hypotheses.limits(each, d[tested], f, test)
    first = np.arange(len(t))
    first[tested] = classes[of_class[tested]]
    order = np.lexsort((row < 0, -t[first], np.where(tested, probability[first], np.inf)))
    in_part, of_point, at, rank, group = (values[order].astype(np.int32) for values in (part, point, row, d, of_class))
    return OutlierTests(
        problem,
        test,
        control,
        level,
        each,
        len(classes),
        parts,
        units,
        in_part,
        of_point,
        at,
        rank,
        t[order],
        statistic[order],
        critical[order],
        probability[order],
        error[order],
        group,
    )


def _column(families: Sequence[Suspects], name: str) -> Index:
    """Return one column of all suspects."""
    return np.concatenate([getattr(s, name) for s in families])


def _classes(point: Index, d: Index, t: Array, tested: Mask) -> tuple[Index, Index]:
    """Return the first member of each class of inseparable suspects, and the class (n,) of each; -1: not tested.

    Suspects of one point are inseparable if they have the same d and, apart from rounding, the same T.
    """
    of_class = np.full(len(t), -1, np.intp)
    order = np.flatnonzero(tested)
    order = order[np.lexsort((t[order], point[order] * (d.max(initial=0) + 1) + d[order]))]
    if not len(order):
        return order, of_class
    after, before = order[1:], order[:-1]
    new = (point[after] != point[before]) | (d[after] != d[before]) | (t[after] - t[before] > SAME * t[after])
    starts = np.concatenate([[True], new])
    of_class[order] = np.cumsum(starts) - 1
    return order[starts], of_class
