"""Gross errors: each observation tested against all others, on the covariance of the residuals.

Suspected of an error of any size and direction are: an image point (line, sample), the position of a control point
(East, North), its height (Up). With whitened residuals v, their cofactors ``Q = I - J N^-1 J^T`` and the columns E of
the error in whitened rows::

    T = (E^T v)^T (E^T Q E)^-1 (E^T v)                      chi2(d) without a gross error      (Baarda 1968)
    F = (T / d) / ((v^T v - T) / (f - d))                   F(d, f - d), scale estimated without the suspect
                                                            (external studentisation, cf. Pope 1976)

The second does not need right sigmas, only right ratios of them, and is the one used. d is the rank of E^T Q E: what
the other observations do not check cannot be tested. Suspects of one point that one error cannot tell apart (position
of a control point and its only image point) are named together. The snooping loop is ``fg_orient.snooping``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import fdtrc, fdtri, gammaincinv

from fg_orient.adjustment.problem import Problem, State
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]

#: Probability to suspect one good observation: Baarda's usual choice.
LEVEL = 0.001
#: Directions below this share of a free observation are not checked by the others.
CHECKED = 1e-6
#: Two suspects are inseparable if their statistics agree to this ratio.
SAME = 1e-6
#: What is tested: the part of a point, its axes in words and unit.
PARTS: Final = {"image": "px line, sample", "position": "m East, North", "height": "m Up"}


@dataclass(frozen=True)
class GroupTest:
    """Test of one image point, or of the position or the height of one control point.

    Parameters
    ----------
    part : str
        "image", "position" or "height".
    image : str
        Image id; "" for position and height.
    point : str
    dimension : int
        d; 0 where the other observations do not check the group.
    statistic : float
        F.
    critical : float
        Limit of F; beyond it the group is suspicious.
    probability : float
        To find such an F without a gross error; it ranks suspects of different d.
    error : (d,) array
        Estimated gross error: line, sample in pixels; East, North or Up in m.
    inseparable : tuple of str
        Others that the same error could lie in.
    """

    part: str
    image: str
    point: str
    dimension: int
    statistic: float
    critical: float
    probability: float
    error: Array
    inseparable: tuple[str, ...] = ()

    @property
    def suspicious(self) -> bool:
        """Tell whether the statistic is beyond its limit."""
        return self.statistic > self.critical

    @property
    def name(self) -> str:
        """The suspect in words."""
        return f"point {self.point} in image {self.image}" if self.image else f"{self.part} of point {self.point}"

    def sentence(self) -> str:
        """Name the suspect, its error and the test."""
        error = ", ".join(f"{value:+.2f}" for value in self.error)
        also = f" (or {', '.join(self.inseparable)}: not to be told apart)" if self.inseparable else ""
        return (
            f"{self.name}{also}: gross error of about {error} {PARTS[self.part]}; F = {self.statistic:.1f}, "
            f"limit {self.critical:.1f}"
        )


def outlier_tests(
    problem: Problem, state: State, cofactors: Cofactors, chi2: float, *, level: float = LEVEL
) -> tuple[GroupTest, ...]:
    """Test every image point, and position and height of every weighted control point.

    Parameters
    ----------
    problem, state, cofactors, chi2
        Of a solution.
    level : float
        Probability of a false alarm, each.

    Returns
    -------
    tuple of GroupTest
        Least probable first, what nothing checks at the end. One millisecond per ground point.
    """
    tests = [_judge(problem, group, chi2, level) for group in residual_groups(problem, state, cofactors)]
    return tuple(sorted((_with_twins(test, tests) for test in tests), key=_rank))


def _rank(test: GroupTest) -> tuple[float, float, bool]:
    """Order of suspicion; inseparable suspects differ by rounding only, the image point goes first."""
    likelihood = np.log(test.probability) if test.probability > 0.0 else -np.inf
    return float(f"{likelihood:.6g}"), -float(f"{test.statistic * test.dimension:.6g}"), not test.image


def robust_scales(problem: Problem, state: State, cofactors: Cofactors) -> dict[str, float]:
    """What the sigmas of each part are too small by: root of the median of T over that of chi2(d).

    Half of the observations may be grossly wrong. Points with a single ray are left out: their T says the same
    for image and ground. A part that the others hardly check (heights of a flat pair) has no reliable scale.
    """
    rays = np.bincount(problem.observations.point, minlength=len(problem.active))
    found: dict[str, list[float]] = {}
    for group in residual_groups(problem, state, cofactors):
        if rays[group.point] > 1:
            t, d, _ = _quadratic(group)
            if d == group.columns.shape[1]:
                found.setdefault(group.part, []).append(t / (2.0 * float(gammaincinv(0.5 * d, 0.5))))
    return {part: float(np.sqrt(np.median(values))) for part, values in found.items()}


@dataclass(frozen=True)
class ResidualGroup:
    """Whitened residuals (m,), their cofactors (m, m) and the columns E (m, d) of an error in physical units.

    ``row`` is that of the image point, or -1.
    """

    part: str
    point: int
    row: int
    v: Array
    q: Array
    columns: Array


def residual_groups(problem: Problem, state: State, cofactors: Cofactors) -> list[ResidualGroup]:
    """Residuals of all image points and weighted control points with their cofactors."""
    rays = problem.image_residuals(state, jacobian=True)
    turn = np.full((len(problem.active), 3, 3), np.nan)
    seen = np.flatnonzero(problem.observed)
    turn[seen] = problem.axes(problem.control_records[seen, 9:] + problem.origin_m)
    out: list[ResidualGroup] = []
    for j, rows in problem.rows_by_point():
        joint, found = _image_groups(problem, cofactors, j, rows, rays)
        out += found
        if problem.observed[j]:
            w = problem.control_records[j, :9].reshape(3, 3)
            v, q = w @ (state.ground[j] - problem.control_records[j, 9:]), np.eye(3) - w @ joint[-3:, -3:] @ w.T
            columns = -w @ turn[j].T  # the residual is adjusted minus observed
            out.append(ResidualGroup("position", j, -1, v, q, columns[:, :2]))
            out.append(ResidualGroup("height", j, -1, v, q, columns[:, 2:]))
    return out


def _image_groups(
    problem: Problem, cofactors: Cofactors, j: int, rows: npt.NDArray[np.intp],
    rays: tuple[Array, list[Array], list[Array]],
) -> tuple[Array, list[ResidualGroup]]:  # fmt: skip
    """Joint cofactors of a ground point and the images that see it, and the groups of its image points."""
    values, j_image, j_ground = rays
    o = problem.observations
    images = tuple(dict.fromkeys(int(o.image[r]) for r in rows))
    first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
    free = 3 * int(problem.active[j])
    joint = cofactors.joint(images, (j,) if free else ())
    out = []
    for r in rows:
        at, design = images.index(int(o.image[r])), np.zeros((2, first[-1] + free))
        design[:, first[at] : first[at + 1]] = j_image[r]
        design[:, first[-1] :] = j_ground[r][:, :free]
        columns = np.diag([1.0 / o.sigma_line_px[r], 1.0 / o.sigma_sample_px[r]])
        out.append(ResidualGroup("image", j, int(r), values[r], np.eye(2) - design @ joint @ design.T, columns))
    return joint, out


def _judge(problem: Problem, group: ResidualGroup, chi2: float, level: float) -> GroupTest:
    """Statistic, limit and estimated error of one group."""
    o, point = problem.observations, problem.block.points.ids[group.point]
    image = "" if group.row < 0 else problem.block.images[int(o.image[group.row])].id
    t, d, error = _quadratic(group)
    f = problem.redundancy
    if d == 0 or f <= d:
        return GroupTest(group.part, image, point, 0, 0.0, np.inf, 1.0, np.full(len(error), np.nan))
    statistic = t / d / max((chi2 - t) / (f - d), np.finfo(float).tiny)
    critical, probability = float(fdtri(d, f - d, 1.0 - level)), float(fdtrc(d, f - d, statistic))
    return GroupTest(group.part, image, point, d, statistic, critical, probability, error)


def _quadratic(group: ResidualGroup) -> tuple[float, int, Array]:
    """T, its rank d and the estimated error in physical units."""
    length = np.linalg.norm(group.columns, axis=0)
    e = group.columns / length
    size, axes = np.linalg.eigh(e.T @ group.q @ e)
    checked = size > CHECKED
    error = axes[:, checked] @ ((axes[:, checked].T @ (e.T @ group.v)) / size[checked])
    return float((e.T @ group.v) @ error), int(checked.sum()), np.asarray(error / length)


def _with_twins(test: GroupTest, tests: list[GroupTest]) -> GroupTest:
    """Name the suspects of the same point that the same error could lie in."""
    if not test.suspicious:
        return test
    same = [
        other.name for other in tests
        if other is not test and other.point == test.point and other.dimension == test.dimension
        and abs(other.statistic - test.statistic) <= SAME * test.statistic
    ]  # fmt: skip
    return replace(test, inseparable=tuple(same))
