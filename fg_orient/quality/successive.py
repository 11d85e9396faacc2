"""Suspects that a search would exclude one after the other, computed from one adjustment.

Let e be the columns of the error of a suspect. In the linear model, residuals and cofactors of an
adjustment without this suspect follow from the adjustment with it (Kok 1984)::

    v' = v - Q e (e^T Q e)^+ e^T v,     Q' = Q - Q e (e^T Q e)^+ e^T Q,     v^T v' = v^T v - T,     f' = f - d

So the tests of the next rounds follow from the tests of this round. The search adjusts again with all of them excluded,
tests all observations again, and includes observations that fit.

Rays of a point with three or more rays may be *rivals*: each of them alone explains the residuals, with likelihoods
that differ by less than 1 to 100. The data do not show which ray is wrong, so all of them are excluded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

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

if TYPE_CHECKING:
    from scipy.sparse import csr_array

#: Suspects with the smallest probabilities are used. Minimum of their number; number for each
#: suspicious observation, because a gross error hides others; maximum.
LEAST: Final = 256
EACH: Final = 2
MOST: Final = 4096
#: Largest ratio of two gross errors in one round, because second-order effects of a large error may look like
#: a small error.
LINEAR: Final = 50.0
#: Number of changes of the cofactors for which memory is allocated at first.
FIRST: Final = 64
#: Controls of multiple tests in which the level of a single test does not depend on the results of other tests.
FIXED_LEVEL: Final = ("none", "bonferroni", "sidak")


@dataclass(frozen=True)
class Exclusion:
    """A suspect to exclude.

    Parameters
    ----------
    place : int
        Position among the tests.
    test : GroupTest
        Test of the suspect after exclusion of the suspects before it.
    number : int
        Number of the exclusion; rivals have the same number.
    """

    place: int
    test: GroupTest
    number: int = 0


def successive(known: ResidualCofactors, tests: OutlierTests, chi2: float, kind: Kind, most: int) -> list[Exclusion]:
    """Return suspects to exclude, the most suspicious first; only the first if the others cannot be predicted.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of the adjustment.
    tests : OutlierTests
        Tests of the adjustment.
    chi2 : float
        Weighted sum of squares of all residuals.
    kind : str
        Kind of the suspects.
    most : int
        Maximum number of suspects.
    """
    if not tests.n_suspicious or most < 1:
        return []
    first = [Exclusion(0, tests[0])]
    problem = known.problem
    wide = problem.n_image_unknowns > WHOLE_LIMIT
    if tests.control not in FIXED_LEVEL or kind == "points" or wide:
        return first
    candidates = _Candidates(known, tests, kind)
    of, scale = candidates.of_tests, candidates.scale
    rays = np.bincount(problem.observations.point, minlength=len(problem.active))
    f, largest, out = float(problem.redundancy), 0.0, list[Exclusion]()
    left = np.ones(len(of), bool)
    while len(out) < most:
        t, d, error = hypotheses.quadratic(candidates.v, candidates.own)
        t, d = np.where(left, t, 0.0), np.where(left, d, 0)
        tested = left & hypotheses.can_be_tested(d, f, tests.test)
        p = np.ones(len(of))
        p[tested] = hypotheses.probabilities(t[tested], d[tested], chi2, f, tests.test)
        k = int(np.lexsort((tests.row[of] < 0, -t, np.where(tested, p, np.inf)))[0])
        largest = max(largest, float(t[k]))
        if not tested[k] or p[k] > tests.level_each or LINEAR**2 * t[k] < largest:
            break
        same = tested & (tests.point[of] == tests.point[of[k]]) & (d == d[k]) & (t >= (1.0 - SAME) * t[k])
        # among inseparable suspects the first image point of the table is chosen, whatever the rounding
        k = int(np.lexsort((tests.row[of], tests.row[of] < 0, ~same))[0])
        going, point = [k], tests.point[of[k]]
        if tests.row[of[k]] >= 0 and rays[point] > 2:
            factor = 1.0 if tests.test == "baarda" else (chi2 - float(t[k])) / (f - float(d[k]))
            near = tested & (tests.point[of] == point) & (tests.row[of] >= 0) & (t > t[k] - RIVAL * factor)
            going += [i for i in np.flatnonzero(near).tolist() if tests.row[of[i]] != tests.row[of[k]]]
        found = [_test(tests, int(of[i]), t[i], d[i], error[i] / scale[i], p[i], chi2, f) for i in going]
        names = [test.name for test in found]
        out += [
            Exclusion(
                int(of[i]),
                test if len(going) == 1 else replace(test, inseparable=(*names[:n], *names[n + 1 :])),
                len(out),
            )
            for n, (i, test) in enumerate(zip(going, found, strict=True))
        ]
        rays[point] -= len(going)
        # the whole observation is excluded: line and sample, or position and height
        gone = (tests.point[of] == point) & np.isin(tests.row[of], tests.row[of[going]])
        for i in np.flatnonzero(gone).tolist():
            decrease, checked = candidates.leave_out(i)
            chi2, f, left[i] = chi2 - decrease, f - checked, False
    return out or first


def _test(
    tests: OutlierTests, place: int, t: float, d: int, error: Array, probability: float, chi2: float, f: float
) -> GroupTest:
    """Test a suspect after exclusion of the earlier suspects."""
    at = np.array([t]), np.array([d])
    return replace(
        tests[place],
        dimension=int(d),
        statistic=float(hypotheses.statistics(*at, chi2, f, tests.test)[0]),
        critical=float(hypotheses.limits(tests.level_each, at[1], f, tests.test)[0]),
        probability=float(probability),
        error=error[np.isfinite(error)],
    )


class _Candidates:
    """Suspects that are excluded one after the other.

    With the columns E of length 1 of all suspects, ``E^T Q E = B - A X A^T``: B between suspects of one ground point, A
    the Jacobian to the unknowns of the images, X their cofactors. A suspect i is left out in its checked directions W,
    ``W^T Q_ii W = I``. With ``b = B_i W``, ``a = W^T A_i`` and ``h = X a^T``, ``G = Q_i W = b - A h`` and::

        v' = v - G G_i^T v_i,   Q' = Q - G G^T,   X' = X + h h^T,
        B' = B - b M^-1 b^T,    A' = A - b M^-1 a,   M = W^T B_ii W

    B and A change only in the ground point of i.

    Parameters
    ----------
    known, tests, kind
        See :func:`successive`.

    Attributes
    ----------
    of_tests : (n,) int array
        Positions among the tests.
    v, scale : (n, 2) arrays
        ``E^T v``, and the original lengths of the columns of E. For an error of one coordinate the second is zero, its
        length nan.
    own : (n, 2, 2) array
        Cofactors of v of each suspect.
    """

    def __init__(self, known: ResidualCofactors, tests: OutlierTests, kind: Kind) -> None:
        from scipy.sparse import coo_array

        problem, named = known.problem, known.problem.named_points()
        of = np.arange(min(len(tests), MOST, max(LEAST, EACH * tests.n_suspicious)))
        self.of_tests = of = of[tests.dimension[of] > 0]
        n = len(of)
        self.v, self.scale, self.own = np.zeros((n, 2)), np.full((n, 2), np.nan), np.zeros((n, 2, 2))
        e, rows = np.zeros((n, 2, 3)), np.full((n, 3), -1)
        for number, s in enumerate(suspects(known, kind)):
            mine = np.flatnonzero(tests.part[of] == number)
            key, value = (s.row, tests.row) if (s.row >= 0).any() else (s.point, tests.point)
            k = np.searchsorted(key, value[of[mine]])  # suspects of a part are in ascending order
            (r, d), length = s.columns.shape[1:], np.linalg.norm(s.columns[k], axis=1)
            e[mine, :d, :r] = unit = np.swapaxes(s.columns[k] / length[:, None], 1, 2)
            rows[mine, :r], self.scale[mine, :d] = s.rows[k], length
            self.v[mine, :d] = np.einsum("ndr,nr->nd", unit, s.v[k])
            self.own[mine, :d, :d] = unit @ s.q[k] @ np.swapaxes(unit, 1, 2)
        points, self._of_point = np.unique(tests.point[of].astype(np.intp), return_inverse=True)
        members = np.split(np.argsort(self._of_point, kind="stable"), np.cumsum(np.bincount(self._of_point))[:-1])
        self._at = [(2 * mine[:, None] + np.arange(2)).ravel() for mine in members]
        self._blocks = [np.zeros((0, 0))] * len(points)
        rays, places, entries = linearised(problem, known.state), list[Index](), list[Array]()
        for part in eliminated_points(problem, rays, named, only=points, groups=1):
            numbers = np.searchsorted(points, part.point).tolist()
            for j, own, columns, design, free in zip(
                numbers, part.rows, part.columns, part.design, part.free, strict=True
            ):
                mine, at = members[j], self._at[j]
                wide = (e[mine] @ (rows[mine][:, :, None] == own)).reshape(len(at), -1)
                self._blocks[j] = wide @ free @ wide.T
                places.append(np.stack([np.repeat(at, len(columns)), np.tile(columns, len(at))]))
                entries.append((wide @ design).ravel())
        self._cofactors = free_cofactors(problem, known.cofactors.joint, named)
        shape = (2 * n, len(self._cofactors))
        self._design: csr_array = coo_array((np.concatenate(entries), np.hstack(places)), shape=shape).tocsr()
        self._more, self._used = np.empty((FIRST, len(self._cofactors))), 0

    def leave_out(self, i: int) -> tuple[float, int]:
        """Exclude a suspect; return the decrease of v^T v and of its degrees of freedom."""
        size, axes = hypotheses.eigen(self.own[i])
        checked = size > hypotheses.CHECKED
        w, d = axes[:, checked] / np.sqrt(size[checked]), int(checked.sum())
        at, block, data = self._at[self._of_point[i]], self._blocks[self._of_point[i]], self._design.data
        begin, end = self._design.indptr[at], self._design.indptr[at + 1]
        entry = begin[:, None] + np.arange(end[0] - begin[0])  # all suspects of a ground point have the same columns
        columns, mine = self._design.indices[entry[0]], np.flatnonzero(at // 2 == i)
        a, b = w.T @ data[entry[mine]], block[:, mine] @ w
        more = self._more[: self._used]
        h = self._cofactors[columns].T @ a.T + more.T @ (more[:, columns] @ a.T)
        gain = -(self._design @ h)
        gain[at] += b
        of_b = np.linalg.solve(w.T @ b[mine], b.T)
        block -= b @ of_b
        data[entry] -= of_b.T @ a
        while self._used + d > len(self._more):
            self._more = np.concatenate([self._more, np.empty_like(self._more)])
        self._more[self._used : self._used + d] = h.T
        self._used += d
        along = w.T @ self.v[i]
        self.v -= (gain @ along).reshape(-1, 2)
        pairs = gain.reshape(len(self.v), 2, d)
        self.own -= pairs @ np.swapaxes(pairs, 1, 2)
        return float(along @ along), d
