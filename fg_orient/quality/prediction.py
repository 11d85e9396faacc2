"""Test of excluded observations for consistency with the adjustment of the other observations.

The excluded observations are tested as if they were included again. v is their misclosure at
the solution of the other observations, J is their Jacobian in whitened rows, and Q are the
cofactors of the unknowns. E are the columns of the error in these rows. With
``S = I + J Q J^T`` the test value is::

    T = (E^T S^-1 v)^T (E^T S^-1 E)^+ (E^T S^-1 v)

T is equal to T of the outlier test in the adjustment that includes these observations. In that
adjustment ``S^-1 v`` are the whitened residuals and ``S^-1`` their cofactors (leave one out, Kok 1984).
If they are included again, v^T v increases by ``v^T S^-1 v``. A ground point that the other
observations do not determine is first intersected from the excluded observations; the test uses the
remaining combinations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised, side_by_side
from fg_orient.quality import hypotheses
from fg_orient.quality.cofactors import Cofactors

#: Maximum number of Gauss-Newton steps of an intersection, and the step in m at convergence.
MAX_STEPS: Final = 20
STEP_M: Final = 1e-6


@dataclass(frozen=True)
class ConsistencyTest:
    """Result of the consistency test of excluded observations.

    Parameters
    ----------
    quadratic : float
        T.
    dimension : int
        d; 0 if the other observations do not check the excluded ones.
    statistic : float or None
        w, tau, t, or T, T/m0^2, F (``fg_orient.quality.hypotheses``); None if d is 0.
    probability : float or None
        Probability of a larger statistic without a gross error.
    """

    quadratic: float
    dimension: int
    statistic: float | None
    probability: float | None

    @classmethod
    def of(cls, t: float, d: int, chi2: float, redundancy: float, test: str) -> ConsistencyTest:
        """Return the test of T, given v^T v and its degrees of freedom; see ``fg_orient.quality.hypotheses``."""
        given = np.array([t]), np.array([d])
        if not hypotheses.can_be_tested(given[1], redundancy, test)[0]:
            return cls(t, 0, None, None)
        laws = (hypotheses.statistics, hypotheses.probabilities)
        return cls(t, d, *(float(law(*given, chi2, redundancy, test)[0]) for law in laws))

    def with_freedom(self, freedom: float, test: str) -> ConsistencyTest:
        """Return the same test with these degrees of freedom instead of the redundancy."""
        t, d = self.quadratic, self.dimension
        return ConsistencyTest.of(t, d, freedom + t, freedom + d, test) if d else self


@dataclass(frozen=True)
class Excluded:
    """Excluded observations of one ground point; ``part`` or ``row`` states which of them has the suspected error.

    Parameters
    ----------
    point : int
    rows : tuple of int
        Image points of the full problem, all of this ground point.
    control : bool
        True if the measured coordinates of the point are excluded, too.
    part : str
        "image", "position", "height" or "point".
    row : int
        Image point of the full problem with the suspected error; -1 for other parts.
    """

    point: int
    rows: tuple[int, ...]
    control: bool
    part: str
    row: int = -1


@dataclass(frozen=True, eq=False)
class Misclosures:
    """Misclosures of excluded observations at the solution of the other observations, whitened.

    Parameters
    ----------
    v : (m,) array
    e : (m, k) array
        Columns of the suspected error.
    design : (m, u) array
        Jacobian to the unknowns of ``images``, then of ``points``.
    images, points : tuple of int
    """

    v: Array
    e: Array
    design: Array
    images: tuple[int, ...]
    points: tuple[int, ...]

    def consistency(self, cofactors: Cofactors, chi2: float, redundancy: float, test: str) -> ConsistencyTest:
        """Test with the adjustment of the other observations, given by its cofactors, v^T v and redundancy."""
        none = not self.images and not self.points  # only the coordinates of a point without rays are excluded
        q = np.zeros((0, 0)) if none else cofactors.joint(self.images, self.points)
        return _judged(self.v, self.e, np.eye(len(self.v)) + self.design @ q @ self.design.T, chi2, redundancy, test)


def misclosures(full: Problem, rest: Problem, state: State, excluded: Sequence[Excluded]) -> list[Misclosures | None]:
    """Return the misclosures of each group of excluded observations; None if they do not determine their ground point.

    Parameters
    ----------
    full : Problem
        Problem with these observations; it has the same images, options and ground points as ``rest``.
    rest, state
        Adjustment without these observations.
    excluded : sequence of Excluded
    """
    start = np.where(rest.active[:, None], state.ground, full.start.ground)
    out: list[Misclosures | None] = [None] * len(excluded)
    left = dict(enumerate(excluded))
    while left:  # each group of a ground point is intersected separately
        some = {k: left.pop(k) for k in {one.point: k for k, one in left.items()}.values()}
        at = State(state.image, start.copy())
        lost = {k for k, one in some.items() if full.active[one.point] and not rest.active[one.point]}
        open_ = lost - _intersect(full, at, {k: some[k] for k in lost})
        some = {k: one for k, one in some.items() if k not in open_}
        for k, (v, d_image, d_ground, images) in zip(some, _rows(full, at, list(some.values())), strict=True):
            e = _columns(full, some[k])
            # columns have length 1 before the projection; their length after it is the share that other
            # observations check
            e = e / np.linalg.norm(e, axis=0)
            points: tuple[int, ...] = ()
            if rest.active[some[k].point]:
                d_image, points = np.hstack([d_image, d_ground]), (some[k].point,)
            elif k in lost:
                free = np.linalg.qr(d_ground, mode="complete")[0][:, 3:].T
                v, d_image, e = free @ v, free @ d_image, free @ e
            out[k] = Misclosures(v, e, d_image, images, points)
    return out


def consistency_in_turn(
    groups: Sequence[Misclosures], levels: Sequence[float], rest: Problem, cofactors: Cofactors, chi2: float, test: str
) -> list[ConsistencyTest]:
    """Test groups one after the other; a group that fits counts as included in the tests of the next groups.

    After group a is included, the misclosures of the other groups and their cofactors are ``v' = v - S_a S_aa^-1 v_a``
    and ``S' = S - S_a S_aa^-1 S_a^T``. v^T v has increased by ``v_a^T S_aa^-1 v_a``.

    Parameters
    ----------
    groups : sequence of Misclosures
        Misclosures of different ground points.
    levels : sequence of float
        Level of each group; a group fits if its probability is larger.
    rest : Problem
    cofactors, chi2
        Cofactors and v^T v of the adjustment of ``rest``.
    test : str
    """
    images = tuple(sorted({k for one in groups for k in one.images}))
    points = tuple(j for one in groups for j in one.points)
    sizes = dict(zip(images, np.diff(rest.first)[np.array(images, np.intp)].tolist(), strict=True))
    names = [(True, k, size) for k, size in sizes.items()] + [(False, j, 3) for j in points]
    places = np.cumsum([0, *(size for _, _, size in names)])
    columns = {
        (is_image, k): np.arange(size) + begin
        for (is_image, k, size), begin in zip(names, places.tolist(), strict=False)
    }
    first = np.cumsum([0, *(len(one.v) for one in groups)])
    design, v = np.zeros((first[-1], places[-1])), np.concatenate([one.v for one in groups])
    for begin, one in zip(first.tolist(), groups, strict=False):
        mine = [columns[True, k] for k in one.images] + [columns[False, j] for j in one.points]
        design[begin : begin + len(one.v), np.concatenate(mine)] = one.design
    s = np.eye(len(v)) + design @ cofactors.joint(images, points) @ design.T
    f, out = rest.redundancy, list[ConsistencyTest]()
    for k, (one, level) in enumerate(zip(groups, levels, strict=True)):
        own = slice(first[k], first[k + 1])
        out.append(_judged(v[own], one.e, s[own, own], chi2, f, test))
        if (out[-1].probability or 0.0) > level:
            gain = np.linalg.solve(s[own, own], s[own])
            chi2, f = chi2 + float(v[own] @ np.linalg.solve(s[own, own], v[own])), f + len(one.v)
            v, s = v - gain.T @ v[own], s - s[:, own] @ gain
    return out


def _columns(full: Problem, one: Excluded) -> Array:
    """Return the columns E (m, k) of the suspected error in the rows of :func:`_rows`; their scale does not matter."""
    whole = np.eye(2 * len(one.rows) + 3 * one.control)
    if one.part == "point":
        return whole
    if one.part == "image":
        return whole[:, [k for i, r in enumerate(one.rows) if r == one.row for k in (2 * i, 2 * i + 1)]]
    axes = full.axes(full.control_records[None, one.point, POINT.place] + full.origin_m)[0]
    out = np.zeros((len(whole), 3))
    out[-3:] = full.control_weights(one.point) @ axes.T
    return out[:, :2] if one.part == "position" else out[:, 2:]


def _judged(v: Array, e: Array, s: Array, chi2: float, redundancy: float, test: str) -> ConsistencyTest:
    """Return the test in the adjustment that includes the observations: f and v^T v increase by their contributions."""
    residual, weighted = np.linalg.solve(s, v), np.linalg.solve(s, e)
    t, d, _ = hypotheses.quadratic(e.T @ residual, e.T @ weighted)
    return ConsistencyTest.of(float(t), int(d), chi2 + float(v @ residual), redundancy + len(v), test)


def _rows(
    full: Problem, at: State, excluded: Sequence[Excluded]
) -> Iterator[tuple[Array, Array, Array, tuple[int, ...]]]:
    """Yield whitened misclosures (m,), Jacobians (m, u) and (m, 3), and the images of u, for each group at a state."""
    first = np.cumsum([0, *(len(one.rows) for one in excluded)])
    taken = np.array([row for one in excluded for row in one.rows], np.intp)
    rays = linearised(full, at, taken)
    for one, begin, end in zip(excluded, first[:-1].tolist(), first[1:].tolist(), strict=True):
        own = slice(begin, end)
        j_image, _, images = side_by_side(full, full.observations.image[taken[own]], rays.image[own])
        v, j_ground = rays.residual[own].ravel(), rays.ground[own].reshape(-1, 3)
        if one.control:
            w = full.control_weights(one.point)
            v = np.concatenate([v, w @ (at.ground[one.point] - full.control_records[one.point, POINT.place])])
            j_image, j_ground = np.pad(j_image, ((0, 3), (0, 0))), np.vstack([j_ground, w])
        yield v, j_image, j_ground, images


def _intersect(full: Problem, at: State, lost: dict[int, Excluded]) -> set[int]:
    """Intersect ground points in ``at`` from their groups with fixed orientation; return the groups that converge."""
    left, done = dict(lost), set[int]()
    for _ in range(MAX_STEPS):
        if not left:
            break
        for (k, one), (v, _, d_ground, _) in zip(list(left.items()), _rows(full, at, list(left.values())), strict=True):
            step = np.linalg.lstsq(d_ground, -v)[0]
            at.ground[one.point] += step
            if np.abs(step).max() < STEP_M:
                done.add(k)
                del left[k]
    return done
