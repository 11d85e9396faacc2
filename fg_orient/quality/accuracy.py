"""Accuracy at control and check points: differences adjusted minus measured.

Root mean square, mean (bias), standard deviation and maximum are computed for each axis,
in East, North, Up of the point and in ECEF. CE90 and LE90 are 90 % quantiles of the
horizontal length and of |Up|. They are also computed from the RMSE, for normal errors
(NSSDA, FGDC-STD-007.3-1998, appendix 3-A). Circular values require that the smaller of
the East and North RMSE is at least 0.6 of the larger. The difference at a check point is
compared with ``sqrt(predicted + own variance)``, both in prior scale. Source:
Terlemezoğlu 2019, eqs. 2.72-2.73 (ECEF RMSE); the other quantities are common practice.

The predicted accuracy is tested. With e the differences of n check points (adjusted minus
measured) and C the joint covariance of both, in prior scale, ``T = e^T C^-1 e`` is
chi2(3n) distributed if model and sigmas are correct (normalised estimation error squared:
Bar-Shalom et al. 2001, 5.4). The errors of the orientation affect all check points, so C
is not block diagonal. A simpler sum, of the normalised errors of single points, also has
the mean 3n, but a larger variance. A test of this sum by chi2(3n) would reject correct
predictions. Four image coordinates of a point in two images determine three ground
coordinates; the quantity that remains is the y-parallax, in pixels. It replaces the
accuracy in a relative adjustment, which has no control points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.resection import locate_points
from fg_orient.model.distributions import (
    chi_square_interval,
    chi_square_limit,
    chi_square_tail,
    normal_probability,
    sidak,
)
from fg_orient.model.errors import NoSolutionError
from fg_orient.quality.check_tests import (
    RATIO_LIMIT,
    TRENDS,
    number_statistic,
    numbers_by_chance,
    probability_of_number,
    trend_squares,
)
from fg_orient.quality.cofactors import PointCofactors

AXES = ("east", "north", "up", "ecef_x", "ecef_y", "ecef_z")
#: Probability that the size of a normal difference is above this limit.
BEYOND: Final = math.erfc(RATIO_LIMIT / math.sqrt(2.0))
#: Probability that the number or the largest of correct check coordinates exceeds its limit by chance.
CHANCE: Final = 0.001
#: Maximum number of check points in tests with the joint covariance. If there are more, an even selection is used.
MAX_JOINT: Final = 60
#: Tests with the joint covariance require that the smallest eigenvalue of the correlations of
#: check coordinates is above this.
POSITIVE: Final = 1e-12
#: Minimum number of check points of ASPRS edition 2 (2023).
ASPRS_MINIMUM = 30
#: Factors from the RMSE of one axis to the radius or half-length of 90 or 95 % of normal errors (NSSDA, appendix 3-A).
CIRCULAR_90, CIRCULAR_95, LINEAR_90, LINEAR_95 = 2.1460, 2.4477, 1.6449, 1.9600
#: Smallest ratio of East and North RMSE for which the circular factors are valid (NSSDA, appendix 3-A).
CIRCULAR_RATIO = 0.6


@dataclass(frozen=True)
class Beyond:
    """Number of check coordinates above ``RATIO_LIMIT`` standard deviations, and its probability by chance.

    Common errors of the images make several coordinates large at once. Therefore the
    number is compared with its distribution under the joint covariance
    (:func:`numbers_by_chance`). Sidak's limit of the largest of n is also valid for
    correlated coordinates.

    Parameters
    ----------
    n : int
        Number of coordinates with a standard deviation.
    count : int
        Number of these coordinates beyond the limit.
    expected : float
        Expected number for normal differences.
    probability : float or None
        Probability of this number or more. None (not tested) for the number 0 and without a joint covariance.
    largest_limit : float
        Standard deviations that the largest of n normal differences exceeds with
        probability ``CHANCE`` at most; nan for n = 0.
    largest : float
        Largest ratio; 0 for n = 0.
    far : tuple of str
        Ids of points with a coordinate beyond ``largest_limit``, worst first.
    """

    n: int
    count: int
    expected: float
    probability: float | None
    largest_limit: float
    largest: float
    far: tuple[str, ...]

    @property
    def many(self) -> bool:
        """True if such a large number hardly ever occurs by chance."""
        return self.probability is not None and self.probability <= CHANCE

    @property
    def by_chance(self) -> bool:
        """True if chance explains the number of large differences and the size of the largest difference."""
        return not self.many and not self.far

    @property
    def sentence(self) -> str:
        """State number and expected number in one sentence; "" if no coordinate is above the limit."""
        if not self.count:
            return ""
        p = "" if self.probability is None else f", probability of this number or more {100.0 * self.probability:.2g} %"
        if not self.by_chance:
            return f"{self.count} of {self.n} check coordinates, {self.expected:.1f} expected by chance{p}"
        verb = "lies" if self.count == 1 else "lie"
        return f"{self.count} of {self.n} check coordinates {verb} beyond 3 standard deviations of the difference: " \
               f"as many as chance gives ({self.expected:.1f} expected{p})"  # fmt: skip

    def as_dict(self) -> dict[str, object]:
        """Return plain values for ``result.json`` (docs/results.md)."""
        return {
            "n_coordinates": self.n, "n_beyond": self.count, "expected": self.expected, "probability": self.probability,
            "largest_limit": self.largest_limit, "by_chance": self.by_chance, "sentence": self.sentence,
        }  # fmt: skip


@dataclass(frozen=True)
class Joint:
    """Joint cofactors of the adjusted coordinates of points that are all unknowns.

    Parameters
    ----------
    cofactors : PointCofactors
    index : (n,) int array, rows in the block's ground points
    axes : (n, 3, 3) array
        East, North, Up of each point.
    place_km : (n, 2) array
        East, North relative to the origin of the problem.
    """

    cofactors: PointCofactors
    index: Index
    axes: Array
    place_km: Array

    def of(self, rows: Index) -> Array:
        """Return the cofactors East, North, Up (3k, 3k) of these points, m^2, prior scale."""
        k, turn = len(rows), self.axes[rows]
        q = self.cofactors.joint((), tuple(self.index[rows].tolist())).reshape(k, 3, k, 3)
        return np.asarray(np.einsum("aij,ajbk,blk->aibl", turn, q, turn).reshape(3 * k, -1))


@dataclass(frozen=True)
class PointDifferences:
    """Adjusted minus measured coordinates of one role.

    Parameters
    ----------
    ids : tuple of str
    index : (n,) int array, rows in the block's ground points
    enu_m, ecef_m : (n, 3) arrays
        Differences.
    cofactors_enu_m2 : (n, 3, 3) array
        Cofactors of the adjusted points, prior scale; nan if unavailable.
    own_sigma_enu_m : (n, 3) array
        Standard deviations of the measured coordinates.
    n_fixed : int
        Number of fixed control points. They are constants without differences and are not counted in n.
    joint : Joint or None
        None without a covariance, or if a point is not an unknown.
    """

    ids: tuple[str, ...]
    index: Index
    enu_m: Array
    ecef_m: Array
    cofactors_enu_m2: Array
    own_sigma_enu_m: Array
    n_fixed: int = 0
    joint: Joint | None = None

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def predicted_sigma_enu_m(self) -> Array:
        """Standard deviations (n, 3) from the adjustment, prior scale; nan if unavailable."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("nii->ni", self.cofactors_enu_m2), 0.0)))

    @property
    def ratio(self) -> Array:
        """|difference| / sqrt(predicted + own variance) per axis (n, 3); check points only."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.abs(self.enu_m) / np.hypot(self.predicted_sigma_enu_m, self.own_sigma_enu_m))

    def statistics(self) -> dict[str, float | int]:
        """Compute the statistics of the differences by the keys of the record.

        Keys: n, n_fixed, rmse_*, mean_*, sd_*, max_*, ce90*, le90*, ce95*, le95*.

        In the keys ``horizontal`` means East and North together (2-D), ``3d`` all three
        axes. Statistics that need more points (sd, CE90 and LE90 need two) are absent.
        """
        out: dict[str, float | int] = {"n": len(self), "n_fixed": self.n_fixed}
        if not len(self):
            return out
        for axis, d in zip(AXES, np.hstack([self.enu_m, self.ecef_m]).T, strict=True):
            out[f"rmse_{axis}_m"] = float(np.sqrt(np.mean(d**2)))
            out[f"mean_{axis}_m"] = float(d.mean())
            if len(d) > 1:
                out[f"sd_{axis}_m"] = float(d.std(ddof=1))
            out[f"max_{axis}_m"] = float(np.abs(d).max())
        for name, axes in (("horizontal", 2), ("3d", 3)):
            squares = (self.enu_m[:, :axes] ** 2).sum(axis=1)
            out[f"rmse_{name}_m"], out[f"max_{name}_m"] = float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))
        return out | self._ninety_percent() if len(self) > 1 else out

    def _ninety_percent(self) -> dict[str, float]:
        """Return radii (CE) and half-lengths (LE) that contain 90 and 95 % of the errors: observed, and by the RMSE."""
        east, north, up = np.sqrt(np.mean(self.enu_m**2, axis=0)).tolist()
        out = {
            "ce90_m": float(np.quantile(np.hypot(self.enu_m[:, 0], self.enu_m[:, 1]), 0.9)),
            "le90_m": float(np.quantile(np.abs(self.enu_m[:, 2]), 0.9)),
            "le90_rmse_m": LINEAR_90 * up,
            "le95_rmse_m": LINEAR_95 * up,
        }
        if min(east, north) >= CIRCULAR_RATIO * max(east, north):
            out |= {f"ce{p}_rmse_m": k * 0.5 * (east + north) for p, k in ((90, CIRCULAR_90), (95, CIRCULAR_95))}
        return out

    def suspicious(self) -> list[tuple[str, str, float, float]]:
        """Return check coordinates above the limit: (id, axis, difference m, ratio), worst first."""
        ratio = self.ratio
        rows = [(self.ids[i], AXES[k], float(self.enu_m[i, k]), float(ratio[i, k]))
                for i, k in zip(*np.nonzero(ratio > RATIO_LIMIT), strict=True)]  # fmt: skip
        return sorted(rows, key=lambda row: -row[3])

    @property
    def selected(self) -> Index:
        """Rows of at most ``MAX_JOINT`` points for tests with the joint covariance, evenly selected."""
        return np.unique(np.linspace(0, len(self) - 1, min(len(self), MAX_JOINT)).astype(np.intp))

    @cached_property
    def covariance_m2(self) -> Array | None:
        """Return the joint covariance (3k, 3k) of the selected differences; None if it is not available."""
        rows = self.selected
        if self.joint is None or not len(rows):
            return None
        c = self.joint.of(rows) + np.diag(self.own_sigma_enu_m[rows].ravel() ** 2)
        sigma = np.sqrt(np.diag(c))
        positive = np.isfinite(c).all() and np.linalg.eigvalsh(c / np.outer(sigma, sigma))[0] > POSITIVE
        return c if positive else None

    @cached_property
    def beyond(self) -> Beyond:
        """Compute the number of check coordinates above the limit, and its probability by chance."""
        n, rows = int(np.count_nonzero(~np.isnan(self.ratio))), self.suspicious()
        farthest = math.sqrt(float(chi_square_limit(1, sidak(CHANCE, n)))) if n else float("nan")
        far = tuple(dict.fromkeys(name for name, _, _, ratio in rows if ratio > farthest))
        p, mine = None, self.ratio[self.selected]
        if (mine > RATIO_LIMIT).any() and self.covariance_m2 is not None:
            p = float(probability_of_number(number_statistic(mine.ravel()), numbers_by_chance(self.covariance_m2)))
        return Beyond(n, len(rows), n * BEYOND, p, farthest, rows[0][3] if rows else 0.0, far)

    def largest(self, count: int = 5) -> list[tuple[str, float, float, float]]:
        """Return the points with the largest differences in metres: (id, east, north, up)."""
        order = np.argsort(-np.linalg.norm(self.enu_m, axis=1))[:count]
        return [(self.ids[i], *(float(v) for v in self.enu_m[i])) for i in order]


@dataclass(frozen=True)
class Accuracy:
    """Differences at control and check points."""

    control: PointDifferences
    check: PointDifferences


def differences(
    ids: tuple[str, ...],
    index: Index,
    adjusted_m: Array,
    measured_m: Array,
    own_sigma_enu_m: Array,
    cofactors_m2: Array,
    enu_from_ecef: Array,
) -> PointDifferences:
    """Compute the differences of one role; ``cofactors_m2`` (n, 3, 3) in ECEF axes, prior scale."""
    d = adjusted_m - measured_m
    enu = np.einsum("nij,nj->ni", enu_from_ecef, d)
    q = enu_from_ecef @ cofactors_m2 @ np.swapaxes(enu_from_ecef, 1, 2)
    return PointDifferences(ids, index, enu, d, q, own_sigma_enu_m)


# --- check of the predicted accuracy --------------------------------------------------------------

#: Probability of the interval of T, and of the tests of bias, drift and tilt.
CONFIDENCE: Final = 0.95


@dataclass(frozen=True)
class PredictionTest:
    """Result of :func:`prediction_test`.

    Parameters
    ----------
    n : int
        Number of check points.
    n_joint : int
        Number of check points in the joint test.
    within : (3, 3) int array
        Numbers of differences East, North, Up (rows) within 1, 2, 3 standard deviations.
    statistic : float
        T.
    interval : (float, float)
        95 % interval of T for a correct prediction.
    """

    n: int
    n_joint: int
    within: Index
    statistic: float
    interval: tuple[float, float]

    @property
    def degrees(self) -> int:
        """Degrees of freedom of T."""
        return 3 * self.n_joint

    @property
    def factor(self) -> float:
        """Ratio of the errors to the predicted errors."""
        return float(np.sqrt(self.statistic / self.degrees))

    @property
    def honest(self) -> bool:
        """True if T is in its interval."""
        return self.interval[0] <= self.statistic <= self.interval[1]

    def sentence(self) -> str:
        """Describe the result of the test in one sentence."""
        size = f"errors at check points are {self.factor:.2f} times as large as predicted"
        if self.honest:
            return f"the predicted accuracy holds: {size}"
        return f"the predicted accuracy is too {'optimistic' if self.factor > 1.0 else 'pessimistic'}: {size}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the record."""
        names = ("within_1_sigma", "within_2_sigma", "within_3_sigma")
        counts = {axis: dict(zip(names, row.tolist(), strict=True))
                  for axis, row in zip(AXES[:3], self.within, strict=True)}  # fmt: skip
        expected = dict(zip(names, (2.0 * normal_probability([1.0, 2.0, 3.0]) - 1.0).tolist(), strict=True))
        return {
            "n": self.n, "n_joint": self.n_joint, **counts, "expected_share": expected, "nees": self.statistic,
            "degrees_of_freedom": self.degrees, "interval_95": list(self.interval), "factor": self.factor,
            "honest": self.honest, "sentence": self.sentence(),
        }  # fmt: skip


def prediction_test(check: PointDifferences) -> PredictionTest:
    """Test the predicted covariance of the check points of a solution.

    NoSolutionError: there are no check points, or they are not unknowns (``check_points =
    "exclude"``) and have no joint covariance.
    """
    if not len(check):
        raise NoSolutionError.of("accuracy.no_check")
    c, rows = check.covariance_m2, check.selected
    if c is None:
        raise NoSolutionError.of("accuracy.check_excluded")
    e = check.enu_m[rows].ravel()
    within = np.stack([(check.ratio <= k).sum(axis=0) for k in (1.0, 2.0, 3.0)], axis=1)
    return PredictionTest(len(check), len(rows), within, float(e @ np.linalg.solve(c, e)),
                          chi_square_interval(len(e), 1.0 - CONFIDENCE))  # fmt: skip


def trend_tests(check: PointDifferences) -> dict[str, dict[str, Any]] | None:
    """Test bias, drift and tilt by :func:`trend_squares`, with a joint level of 5 % (Sidak).

    None without a joint covariance. ``mean_enu_m`` of the bias is the mean by generalised least squares.
    """
    c = check.covariance_m2
    if c is None or check.joint is None:
        return None
    e = check.enu_m[check.selected].ravel()
    squares, degrees = trend_squares(c, check.joint.place_km[check.selected], e[:, None])
    level = sidak(1.0 - CONFIDENCE, sum(d > 0 for d in degrees))
    out: dict[str, dict[str, Any]] = {}
    for name, (square,), d in zip(TRENDS, squares.tolist(), degrees, strict=True):
        if d:
            p = float(chi_square_tail(d, square))
            out[name] = {"chi2": square, "degrees": d, "probability": p, "significant": p <= level}
    weights = np.linalg.solve(c, np.tile(np.eye(3), (len(c) // 3, 1)))
    q = np.linalg.inv(weights.reshape(-1, 3, 3).sum(axis=0))
    out["bias"] |= {"mean_enu_m": (q @ (weights.T @ e)).tolist(), "sd_enu_m": np.sqrt(np.diag(q)).tolist()}
    return out


# --- y-parallax of a relative adjustment ----------------------------------------------------------


def y_parallaxes(problem: Problem, state: State) -> tuple[Index, Array]:
    """Compute the parallaxes of tie and check points with exactly two image points, for the orientation of a state.

    Each point is located again from its two rays; measured coordinates are not used.

    Parameters
    ----------
    problem : Problem
    state : State
        Its image unknowns are used; ``problem.start`` is the metadata orientation.

    Returns
    -------
    points : (n,) int array
        Ground points.
    parallax_px : (n,) array, not negative
        Parallax in one image with the other image held fixed: the root of twice the sum
        of squares of the four residuals.
    """
    o = problem.observations
    rays = np.bincount(o.point, minlength=len(problem.active))
    wanted = np.flatnonzero((rays == 2) & problem.active & ~problem.observed)
    ground = state.ground.copy()
    if len(wanted):
        located = locate_points(problem, state, problem.start.ground + problem.origin_m, wanted)
        ground[wanted] = located.state.ground[wanted]
    v = problem.pixel_residuals(State(state.image, ground))
    squares = np.bincount(o.point, (v**2).sum(axis=1), minlength=len(problem.active))
    return wanted, np.sqrt(2.0 * squares[wanted])


def rms_px(parallax_px: Array) -> float:
    """Return the root mean square of parallaxes; nan without parallaxes."""
    return float(np.sqrt(np.mean(parallax_px**2))) if len(parallax_px) else float("nan")
