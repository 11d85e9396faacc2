"""Gross errors: each observation tested against all others, on the covariance of the residuals.

A group of rows g (an image point: 2, the coordinates of a control point: 3) is suspected to hold an error of any
size and direction. With whitened residuals v and their cofactors ``Q = I - J N^-1 J^T``::

    T = v_g^T Q_gg^-1 v_g                                   chi2(d) without a gross error   (Baarda 1968, d rows)
    F = (T / d) / ((v^T v - T) / (f - d))                   F(d, f - d), scale estimated without the group
                                                            (external studentisation, cf. Pope 1976)

The second does not need right sigmas, only right ratios of them, and is the one used. d is the rank of Q_gg: what the
other observations do not check cannot be tested. Groups that one error cannot tell apart (coordinates of a control
point and its only image point) are named together. The snooping loop is ``fg_orient.snooping``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import fdtri

from fg_orient.adjustment.problem import Problem, State, enu_from_ecef
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]

#: Probability to suspect any observation at all of a set without gross errors (Bonferroni over the groups).
LEVEL = 0.01
#: Directions of Q_gg below this share of a free observation are not checked by the others.
CHECKED = 1e-6
#: Two groups are inseparable if their statistics agree to this ratio.
SAME = 1e-6


@dataclass(frozen=True)
class GroupTest:
    """Test of one image point, or of the coordinates of one control point.

    Parameters
    ----------
    image : str
        Image id; "" for the coordinates of a control point.
    point : str
    dimension : int
        d; 0 where the other observations do not check the group.
    statistic : float
        F.
    critical : float
        Limit of F; beyond it the group is suspicious.
    error : (2,) or (3,) array
        Estimated gross error: line, sample in pixels; or East, North, Up in m.
    inseparable : tuple of str
        Other groups that the same error could lie in.
    """

    image: str
    point: str
    dimension: int
    statistic: float
    critical: float
    error: Array
    inseparable: tuple[str, ...] = ()

    @property
    def suspicious(self) -> bool:
        """Tell whether the statistic is beyond its limit."""
        return self.statistic > self.critical

    @property
    def name(self) -> str:
        """The group in words."""
        return f"point {self.point} in image {self.image}" if self.image else f"coordinates of point {self.point}"

    def sentence(self) -> str:
        """Name the group, its error and the test."""
        unit = "px line, sample" if self.image else "m East, North, Up"
        error = ", ".join(f"{value:+.2f}" for value in self.error)
        also = f" (or {', '.join(self.inseparable)}: not to be told apart)" if self.inseparable else ""
        return (
            f"{self.name}{also}: gross error of about {error} {unit}; F = {self.statistic:.1f}, "
            f"limit {self.critical:.1f}"
        )


def outlier_tests(
    problem: Problem, state: State, cofactors: Cofactors, chi2: float, *, level: float = LEVEL
) -> tuple[GroupTest, ...]:
    """Test every image point and the coordinates of every weighted control point.

    Parameters
    ----------
    problem, state, cofactors, chi2
        Of a solution.
    level : float
        Probability of a false alarm among all groups together.

    Returns
    -------
    tuple of GroupTest
        Largest ratio of statistic to limit first, groups that nothing checks at the end. One millisecond per
        ground point.
    """
    values, j_image, j_ground = problem.image_residuals(state, jacobian=True)
    groups: list[_Group] = []
    for j, rows in problem.rows_by_point():
        groups += _point_groups(problem, state, cofactors, j, rows, (values, j_image, j_ground))
    tests = [_judge(problem, group, chi2, level / len(groups)) for group in groups]
    tests = [_with_twins(test, tests) for test in tests]
    return tuple(sorted(tests, key=lambda test: (-test.statistic / test.critical, not test.image)))


@dataclass(frozen=True)
class _Group:
    """Whitened residuals and their cofactors of one group; ``row`` of the image point, or -1."""

    point: int
    row: int
    v: Array
    q: Array


def _point_groups(
    problem: Problem, state: State, cofactors: Cofactors, j: int, rows: npt.NDArray[np.intp],
    rays: tuple[Array, list[Array], list[Array]],
) -> list[_Group]:  # fmt: skip
    """Groups of one ground point, with the joint cofactors of it and the images that see it."""
    values, j_image, j_ground = rays
    images = tuple(dict.fromkeys(int(problem.observations.image[r]) for r in rows))
    first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
    free = 3 * int(problem.active[j])
    design = np.zeros((2 * len(rows), first[-1] + free))
    for i, r in enumerate(rows):
        at = images.index(int(problem.observations.image[r]))
        design[2 * i : 2 * i + 2, first[at] : first[at + 1]] = j_image[r]
        design[2 * i : 2 * i + 2, first[-1] :] = j_ground[r][:, :free]
    joint = cofactors.joint(images, (j,) if free else ())
    q = np.eye(len(design)) - design @ joint @ design.T
    out = [_Group(j, int(r), values[r], q[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]) for i, r in enumerate(rows)]
    if problem.observed[j]:
        w = problem.control_records[j, :9].reshape(3, 3)
        v = w @ (state.ground[j] - problem.control_records[j, 9:])
        out.append(_Group(j, -1, v, np.eye(3) - w @ joint[-3:, -3:] @ w.T))
    return out


def _judge(problem: Problem, group: _Group, chi2: float, level: float) -> GroupTest:
    """Statistic, limit and estimated error of one group."""
    o, point = problem.observations, problem.block.points.ids[group.point]
    image = "" if group.row < 0 else problem.block.images[int(o.image[group.row])].id
    size, axes = np.linalg.eigh(group.q)
    checked = size > CHECKED
    d, f = int(checked.sum()), problem.redundancy
    if d == 0 or f <= d:
        return GroupTest(image, point, 0, 0.0, np.inf, np.full(len(group.v), np.nan))
    whitened = axes[:, checked] @ ((axes[:, checked].T @ group.v) / size[checked])
    t = float(group.v @ whitened)
    rest = max((chi2 - t) / (f - d), np.finfo(float).tiny)
    statistic, critical = t / d / rest, float(fdtri(d, f - d, 1.0 - level))
    return GroupTest(image, point, d, statistic, critical, _physical(problem, group, whitened))


def _physical(problem: Problem, group: _Group, whitened: Array) -> Array:
    """Error of the observation: pixels, or East, North, Up in m."""
    o = problem.observations
    if group.row >= 0:
        sigma = np.array([o.sigma_line_px[group.row], o.sigma_sample_px[group.row]])
        return np.asarray(whitened * sigma)
    w = problem.control_records[group.point, :9].reshape(3, 3)
    turn = enu_from_ecef((problem.control_records[group.point, 9:] + problem.origin_m)[None])[0]
    return np.asarray(-turn @ np.linalg.solve(w, whitened))


def _with_twins(test: GroupTest, tests: list[GroupTest]) -> GroupTest:
    """Name the groups of the same point that the same error could lie in."""
    if not test.suspicious:
        return test
    same = [
        other.name for other in tests
        if other is not test and other.point == test.point and other.dimension == test.dimension
        and abs(other.statistic - test.statistic) <= SAME * test.statistic
    ]  # fmt: skip
    return replace(test, inseparable=tuple(same))
