"""Suspects that a search would leave out one after the other, from one adjustment.

After a suspect with the columns e of its error is left out, the residuals of the others and their cofactors are in the
linear model those of the adjustment without it (Kok 1984)::

    v' = v - Q e (e^T Q e)^+ e^T v,     Q' = Q - Q e (e^T Q e)^+ e^T Q,     v^T v' = v^T v - T,     f' = f - d

so that the tests of the next rounds follow from those of this round. The search adjusts again with all of them left
out, tests all observations anew, and takes back what fits.

Rays of a point with three and more may be *rivals*: each alone explains the residuals, with likelihoods that differ by
less than 1 to 100. Nothing tells which one is wrong, so all go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.adjustment.best_rays import RIVAL
from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.rows import linearised
from fg_orient.quality import hypotheses
from fg_orient.quality.elimination import eliminated_points, free_cofactors
from fg_orient.quality.outlier_records import GroupTest, OutlierTests
from fg_orient.quality.outliers import SAME
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import Kind, suspects

#: Suspects with the smallest probabilities that take part: matrices of twice this size.
CANDIDATES: Final = 256
#: Controls of multiple tests whose level of a single test does not depend on the other tests.
FIXED_LEVEL: Final = ("none", "bonferroni", "sidak")


@dataclass(frozen=True)
class Exclusion:
    """A suspect to leave out.

    Parameters
    ----------
    place : int
        Among the tests.
    test : GroupTest
        Its test without those before it.
    number : int
        Equal for rivals.
    """

    place: int
    test: GroupTest
    number: int = 0


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
    if tests.control not in FIXED_LEVEL or most == 1 or kind == "points" or wide:
        return first
    e_v, q, scale, of = _candidates(known, tests, kind)
    rays = np.bincount(problem.observations.point, minlength=len(problem.active))
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
        going, point = [k], tests.point[of[k]]
        if tests.row[of[k]] >= 0 and rays[point] > 2:
            factor = 1.0 if tests.test == "baarda" else (chi2 - float(t[k])) / (f - float(d[k]))
            near = tested & (tests.point[of] == point) & (tests.row[of] >= 0) & (t > t[k] - RIVAL * factor)
            going += [i for i in np.flatnonzero(near).tolist() if tests.row[of[i]] != tests.row[of[k]]]
        found = [_test(tests, int(of[i]), t[i], d[i], error[i] / scale[i], p[i], chi2, f) for i in going]
        names = [test.name for test in found]
        out += [
            Exclusion(int(of[i]), test if len(going) == 1 else replace(test, inseparable=(*names[:n], *names[n + 1 :])),
                      len(out))
            for n, (i, test) in enumerate(zip(going, found, strict=True))
        ]  # fmt: skip
        rays[point] -= len(going)
        # the whole observation goes: line and sample, or position and height
        gone = (tests.point[of] == point) & np.isin(tests.row[of], tests.row[of[going]])
        for i in np.flatnonzero(gone).tolist():
            size, axes = np.linalg.eigh(q[i, :, i])
            checked = size > hypotheses.CHECKED
            inverse = (axes[:, checked] / size[checked]) @ axes[:, checked].T
            chi2, f, left[i] = chi2 - float(e_v[i] @ inverse @ e_v[i]), f - int(checked.sum()), False
            gain = q[:, :, i] @ inverse
            e_v, q = e_v - gain @ e_v[i], q - np.einsum("iab,bjc->iajc", gain, q[i])
    return out or first


def _test(
    tests: OutlierTests, place: int, t: float, d: int, error: Array, probability: float, chi2: float, f: float
) -> GroupTest:
    """Test of a suspect without those before it."""
    at = np.array([t]), np.array([d])
    return replace(
        tests[place], dimension=int(d), statistic=float(hypotheses.statistics(*at, chi2, f, tests.test)[0]),
        critical=float(hypotheses.limits(tests.level_each, at[1], f, tests.test)[0]), probability=float(probability),
        error=error[np.isfinite(error)],
    )  # fmt: skip


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
