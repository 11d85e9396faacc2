"""Suspects that a search would leave out one after the other, from one adjustment.

After a suspect with the columns e of its error is left out, the residuals of the others and their cofactors are in the
linear model those of the adjustment without it (Kok 1984)::

    v' = v - Q e (e^T Q e)^+ e^T v,     Q' = Q - Q e (e^T Q e)^+ e^T Q,     v^T v' = v^T v - T,     f' = f - d

so that the tests of the next rounds follow from those of this round. The search adjusts again with all of them left
out, tests all observations anew, and takes back what fits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.rows import linearised
from fg_orient.quality import hypotheses
from fg_orient.quality.elimination import eliminated_points, free_cofactors
from fg_orient.quality.outlier_records import GroupTest, OutlierTests
from fg_orient.quality.outliers import SAME
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import Kind, suspects

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Suspects with the smallest probabilities that take part: matrices of twice this size.
CANDIDATES: Final = 256
#: Controls of multiple tests whose level of a single test does not depend on the other tests.
FIXED_LEVEL: Final = ("none", "bonferroni", "sidak")


@dataclass(frozen=True)
class Exclusion:
    """A suspect to leave out: its place among the tests, and its test without those before it."""

    place: int
    test: GroupTest


def successive(known: ResidualCofactors, tests: OutlierTests, chi2: float, kind: Kind, most: int) -> list[Exclusion]:
    """Suspects to leave out, the most suspicious first; only the first where the others cannot be predicted.

    Parameters
    ----------
    known : ResidualCofactors
        Of the adjustment.
    tests : OutlierTests
        Its tests.
    chi2 : float
        Weighted sum of squares of all residuals.
    kind : str
        Of the suspects.
    most : int
        Largest number.
    """
    if not tests.n_suspicious or most < 1:
        return []
    first = [Exclusion(0, tests[0])]
    problem = known.problem
    wide = problem.n_image_unknowns > WHOLE_LIMIT
    if tests.control not in FIXED_LEVEL or most == 1 or tests.n_suspicious == 1 or kind == "points" or wide:
        return first
    e_v, q, scale, of = _candidates(known, tests, kind)
    f, out = float(problem.redundancy), list[Exclusion]()
    left = np.ones(len(of), bool)
    while len(out) < most:
        t, d, error = _quadratics(e_v, q, left)
        tested = left & hypotheses.can_be_tested(d, f, tests.test)
        p = np.ones(len(of))
        p[tested] = hypotheses.probabilities(t[tested], d[tested], chi2, f, tests.test)
        k = int(np.lexsort((tests.row[of] < 0, -t, np.where(tested, p, np.inf)))[0])
        if not tested[k] or p[k] > tests.level_each:
            break
        same = tested & (tests.point[of] == tests.point[of[k]]) & (d == d[k]) & (t >= (1.0 - SAME) * t[k])
        k = int(np.lexsort((tests.row[of] < 0, ~same))[0])  # of inseparable ones an image point, the first
        statistic = float(hypotheses.statistics(t[k : k + 1], d[k : k + 1], chi2, f, tests.test)[0])
        limit = float(hypotheses.limits(tests.level_each, d[k : k + 1], f, tests.test)[0])
        size = error[k] / scale[k]
        test = replace(
            tests[int(of[k])], dimension=int(d[k]), statistic=statistic, critical=limit, probability=float(p[k]),
            error=size[np.isfinite(size)],
        )  # fmt: skip
        out.append(Exclusion(int(of[k]), tests[0] if not out else test))
        # the whole observation goes: line and sample, or position and height
        for i in np.flatnonzero((tests.point[of] == tests.point[of[k]]) & (tests.row[of] == tests.row[of[k]])).tolist():
            size, axes = np.linalg.eigh(q[i, :, i])
            checked = size > hypotheses.CHECKED
            inverse = (axes[:, checked] / size[checked]) @ axes[:, checked].T
            chi2, f, left[i] = chi2 - float(e_v[i] @ inverse @ e_v[i]), f - int(checked.sum()), False
            gain = q[:, :, i] @ inverse
            e_v, q = e_v - gain @ e_v[i], q - np.einsum("iab,bjc->iajc", gain, q[i])
    return out or first


def _quadratics(e_v: Array, q: Array, left: npt.NDArray[np.bool_]) -> tuple[Array, Index, Array]:
    """T, d and estimated error of each suspect."""
    own = q[np.arange(len(q)), :, np.arange(len(q))]
    t, d, error = hypotheses.quadratic(e_v, own)
    return np.where(left, t, 0.0), np.where(left, d, 0), error


def _candidates(known: ResidualCofactors, tests: OutlierTests, kind: Kind) -> tuple[Array, Array, Array, Index]:
    """``E^T v`` (n, 2), ``E^T Q E`` (n, 2, n, 2), lengths (n, 2) of E, and the place of each suspect among the tests.

    The columns of E have length 1; the second is zero, and its length nan, for an error of one coordinate.
    """
    problem, of = known.problem, np.arange(min(len(tests), CANDIDATES))
    of = of[tests.dimension[of] > 0]
    place = {
        (s.part, int(j), int(r)): (s, k)
        for s in suspects(known, kind) for k, (j, r) in enumerate(zip(s.point, s.row, strict=True))
    }  # fmt: skip
    parts = [place[tests.parts[tests.part[k]], int(tests.point[k]), int(tests.row[k])] for k in of.tolist()]
    n, named = len(of), problem.named_points()
    e_v, scale, q = np.zeros((n, 2)), np.full((n, 2), np.nan), np.zeros((n, 2, n, 2))
    by_unknowns = np.zeros((n, 2, problem.n_free_unknowns + 3 * len(named)))
    rays, points = linearised(problem, known.state), tests.point[of]
    for group in eliminated_points(problem, rays, named, only=np.unique(points), groups=1):
        for j, rows, columns, design, free in zip(
            group.point, group.rows, group.columns, group.design, group.free, strict=True
        ):
            mine = np.flatnonzero(points == j)
            e = np.zeros((len(mine), 2, len(rows)))
            for own, i in enumerate(mine.tolist()):
                s, k = parts[i]
                length = np.linalg.norm(s.columns[k], axis=0)
                e[own][: len(length), np.searchsorted(rows, s.rows[k])] = (s.columns[k] / length).T
                e_v[i, : len(length)], scale[i, : len(length)] = s.v[k] @ (s.columns[k] / length), length
            np.add.at(by_unknowns, (mine[:, None, None], np.arange(2)[:, None], columns), e @ design)
            q[mine[:, None], :, mine[None]] = np.einsum("iar,rs,jbs->ijab", e, free, e)
    flat = by_unknowns.reshape(2 * n, -1)
    q -= (flat @ free_cofactors(problem, known.cofactors.joint, named) @ flat.T).reshape(q.shape)
    return e_v, q, scale, of
