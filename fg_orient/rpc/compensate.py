"""Estimate the bias compensation of one RPC image from control points, with covariance matrix and tests.

    line   - line of the model   = c0 + c2 l + c4 s + v        (Grodecki & Dial 2003, eqs. 4-5)
    sample - sample of the model = c1 + c3 l + c5 s + v

l, s are the model's own normalised coordinates. Ground coordinates are held fixed; the
sigmas of line and sample must include their errors. Each point is tested with both
coordinates together, as in ``fg_orient.quality.outliers``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.cameras import rfm
from factors.cameras.rfm_equation import COMPENSATION, COMPENSATIONS
from factors.cameras.rfm_project import RANGE
from fg_orient.model.distributions import chi_square_limit, chi_square_median, f_quantile, sidak
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.quality.hypotheses import f_statistics
from fg_orient.quality.rejection import MOST, reject
from fg_orient.quality.verdict import sigma0_interval
from fg_orient.rpc.points import MeasuredPoints
from fg_orient.sensors.rpc import RpcModel

#: Names of the kinds for users and in the equation.
KINDS: Final = {"shift": "shift", "shift_drift": "drift", "affine": "affine"}
NAMES: Final = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
#: Probability of a false alarm for one point (Baarda's usual choice).
LEVEL: Final = 0.001
#: The points do not determine the terms if the ratio of singular values (columns of unit length) is below this.
RANK: Final = 1e-8
#: Reweighted fits of the robust start.
REWEIGHTED: Final = 50
#: If a redundancy number is below this, the other points do not check the coordinate.
CHECKED: Final = 1e-6


@dataclass(frozen=True)
class Compensation:
    """Adjusted bias compensation with its statistics.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    points : MeasuredPoints
        Points of the adjustment, n of them.
    values : (6,) array
        Values in pixels; zero for terms that the kind does not have.
    cofactors : (6, 6) array
        Cofactors; zero for terms that the kind does not have.
    residuals_px : (n, 2) array
        Adjusted minus observed, line and sample.
    redundancy_numbers : (n, 2) array
    outliers : tuple of dict
        Points that were left out as grossly wrong, in this order: id, statistic F, limit,
        error_line_px, error_sample_px.
    complete : bool
        False if there are too many suspects for all of them to be gross errors.
    """

    kind: str
    points: MeasuredPoints
    values: Array
    cofactors: Array
    residuals_px: Array
    redundancy_numbers: Array
    outliers: tuple[dict[str, Any], ...] = ()
    complete: bool = True

    @property
    def codes(self) -> tuple[int, ...]:
        """Elements of ``values`` that the kind has."""
        return COMPENSATIONS[KINDS[self.kind]]

    @property
    def redundancy(self) -> int:
        """Observations minus unknowns."""
        return 2 * len(self.points) - len(self.codes)

    @property
    def weighted_squares(self) -> float:
        """Sum of the squares of the residuals by their sigmas."""
        return float(np.sum((self.residuals_px / self.points.sigma_px) ** 2))

    @property
    def sigma0(self) -> float:
        """Root of the variance of unit weight: pixels if no sigmas were given; nan without redundancy."""
        return float(np.sqrt(self.weighted_squares / self.redundancy)) if self.redundancy else float("nan")

    @property
    def left_out_px(self) -> Array:
        """Residuals (n, 2) with the compensation of the other points; nan if these do not determine it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.redundancy_numbers > CHECKED, self.residuals_px / self.redundancy_numbers, np.nan)

    @property
    def covariance(self) -> Array:
        """Covariance matrix (6, 6) px^2; nan without redundancy."""
        return np.asarray(self.cofactors * self.sigma0**2)

    def terms(self) -> list[dict[str, Any]]:
        """Return the name, value and standard deviation (px) of each term."""
        sd = np.sqrt(np.diag(self.covariance))
        return [{"name": NAMES[k], "px": float(self.values[k]), "sd_px": float(sd[k])} for k in self.codes]


def compensate(model: RpcModel, control: MeasuredPoints, kind: str = "shift", *, level: float = LEVEL) -> Compensation:
    """Adjust and test; leave out the worst point and adjust again until no point is suspicious.

    If sigma0 is then above its interval, all points that are far from the fit of most points are left out together.

    Parameters
    ----------
    model : RpcModel
    control : MeasuredPoints
        Roles are ignored.
    kind : str
        "shift" (1 point at least), "shift_drift" (2) or "affine" (3).
    level : float
        Probability of a false alarm per point and round.

    Raises
    ------
    InputError
        The kind does not exist, or there are too few points.
    NoSolutionError
        The points do not determine the terms: they lie on one line of the image.
    """
    if kind not in KINDS:
        raise InputError.of("rpc.compensation_kind", option="compensation", value=kind, known=", ".join(KINDS))

    fit = _searched(model, control, kind, level, int(MOST * len(control)))
    if fit.redundancy > 0 and fit.sigma0 > sigma0_interval(fit.redundancy)[1]:
        other = _from_most(model, control, kind, level)
        return fit if other is None else other
    return fit


def _searched(model: RpcModel, control: MeasuredPoints, kind: str, level: float, most: int) -> Compensation:
    """Leave out the worst point and adjust again until no point is suspicious or ``most`` are left out."""

    def without(out: Sequence[dict[str, Any]], _: object) -> Compensation:
        return _adjusted(model, control.take(~np.isin(control.ids, [outlier["id"] for outlier in out])), kind)

    end = reject(without((), None), without, lambda fit, _: _worst(fit, level), most)
    return replace(end.fit, outliers=end.out, complete=end.worst is None)


def _from_most(model: RpcModel, control: MeasuredPoints, kind: str, level: float) -> Compensation | None:
    """Adjust without all points that are far from the fit of most points: equal errors hide each other.

    The robust fit minimises the sum of distances (iterative reweighting). Its scale is the median distance. The result
    is None if no point or more than ``MOST`` of the points are far, or if a point that is left out fits to the rest by
    F(2, f).
    """
    n, sigma = len(control), control.sigma_px
    a, l = design(model, control, kind), -residuals(model, control)  # noqa: E741
    weight = np.ones(n)
    for _ in range(REWEIGHTED):
        root = np.sqrt(weight)[:, None] / sigma
        x = np.stack([np.linalg.lstsq(a * r[:, None], y * r, rcond=None)[0] for r, y in zip(root.T, l.T, strict=True)])
        distance = np.linalg.norm((l - a @ x.T) / sigma, axis=1)
        weight = 1.0 / np.maximum(distance, 1e-3 * np.median(distance) + np.finfo(float).tiny)
    scale = np.median(distance**2) / float(chi_square_median(2))
    far = distance**2 > scale * float(chi_square_limit(2, sidak(level, n)))
    if not 0 < far.sum() <= MOST * n:
        return None
    fit = _searched(model, control.take(~far), kind, level, int(MOST * n) - int(far.sum()))
    aside = control.take(far)
    error = -residuals(model, aside, fit.values)
    statistic = predicted_squares(model, aside, error, fit) / (2.0 * fit.sigma0**2)
    limit = float(f_quantile(2, fit.redundancy, 1.0 - level)) if fit.redundancy else np.inf
    if not (statistic > limit).all():
        return None
    records = [
        {"id": aside.ids[k], "statistic": float(statistic[k]), "limit": limit, "error_line_px": float(error[k, 0]),
         "error_sample_px": float(error[k, 1])}
        for k in np.argsort(-statistic, kind="stable").tolist()
    ]  # fmt: skip
    return replace(fit, outliers=(*records, *fit.outliers))


def residuals(model: RpcModel, measured: MeasuredPoints, values: Array | None = None) -> Array:
    """Return the projected minus observed pixels, line and sample: (n, 2); ``values`` (6,) compensate the model."""
    lon, lat, height = measured.ground.T
    return np.stack(model.project(lon, lat, height, values), axis=1) - measured.image


def normalised(model: RpcModel, ground: Array) -> Array:
    """Return the normalised longitude, latitude, height (n, 3), longitudes within half a turn of the model's."""
    out = (ground - model.offsets[RANGE.ground]) / model.scales[RANGE.ground]
    out[:, 0] -= np.round(out[:, 0] * model.scales[RANGE.lon] / 360.0) * 360.0 / model.scales[RANGE.lon]
    return np.ascontiguousarray(out)


def design(model: RpcModel, measured: MeasuredPoints, kind: str) -> Array:
    """Return the columns (n, k) that ``kind`` uses of 1, l, s.

    They are the same for line and sample.
    """
    ground = normalised(model, measured.ground)
    columns = np.column_stack([np.ones(len(ground)), rfm.values(model.coefficients, ground)])
    return columns[:, : len(COMPENSATIONS[KINDS[kind]]) // 2]


def _adjusted(model: RpcModel, points: MeasuredPoints, kind: str) -> Compensation:
    """Compute the compensation from these points: line and sample have no common unknown."""
    a, l = design(model, points, kind), -residuals(model, points)  # noqa: E741
    n, k = a.shape
    if n < k:
        raise InputError.of("rpc.few_control", place=f"<compensation> {kind}", value=n, least=k)
    values, cofactors = np.zeros(COMPENSATION.size), np.zeros((COMPENSATION.size,) * 2)
    free = np.empty((n, 2))
    for axis in (0, 1):
        codes = np.arange(axis, 2 * k, 2)
        values[codes], cofactors[np.ix_(codes, codes)], free[:, axis] = _least_squares(
            a, l[:, axis], points.sigma_px[:, axis], kind
        )
    return Compensation(kind, points, values, cofactors, a @ values.reshape(-1, 2)[:k] - l, free)


def _least_squares(a: Array, l: Array, sigma: Array, kind: str) -> tuple[Array, Array, Array]:  # noqa: E741
    """Return the unknowns (k,), cofactors (k, k) and redundancy numbers (n,) of one axis."""
    rows = a / sigma[:, None]
    length = np.linalg.norm(rows, axis=0)
    left, size, right = np.linalg.svd(rows / length, full_matrices=False)
    if size[-1] < RANK * size[0]:
        raise NoSolutionError.of("rpc.control_spread", place=f"<compensation> {kind}", value=f"{len(a)} points")
    inverse = right.T / size / length[:, None]
    return inverse @ (left.T @ (l / sigma)), inverse @ inverse.T, 1.0 - np.sum(left**2, axis=1)


def _worst(fit: Compensation, level: float) -> list[dict[str, Any]]:
    """Return the point with the largest F if it exceeds its limit, else no point.

    T = (v_l/sigma_l)^2/r_l + (v_s/sigma_s)^2/r_s with redundancy numbers r, because line
    and sample have no unknown in common. F(2, f - 2) has the scale of the other points.
    """
    error, redundancy = -fit.left_out_px, fit.redundancy
    if redundancy <= 2 or not np.isfinite(error).all():
        return []
    t = np.sum((error / fit.points.sigma_px) ** 2 * fit.redundancy_numbers, axis=1)
    i = int(t.argmax())
    statistic = float(f_statistics(t[i], 2, fit.weighted_squares, redundancy))
    limit = float(f_quantile(2, redundancy - 2, 1.0 - level))
    line, sample = error[i].tolist()
    record = {
        "id": fit.points.ids[i],
        "statistic": statistic,
        "limit": limit,
        "error_line_px": line,
        "error_sample_px": sample,
    }
    return [record] if statistic > limit else []


def predicted_squares(model: RpcModel, points: MeasuredPoints, v: Array, fit: Compensation) -> Array:
    """Return squares (n,) of the residuals v (n, 2) of points outside the fit, by their variances for sigma0 = 1."""
    a, t = design(model, points, fit.kind), np.zeros(len(points))
    for axis in (0, 1):
        codes = np.arange(axis, 2 * a.shape[1], 2)
        q = points.sigma_px[:, axis] ** 2 + np.einsum("ni,ij,nj->n", a, fit.cofactors[np.ix_(codes, codes)], a)
        t += v[:, axis] ** 2 / q
    return t


def height_dependence(model: RpcModel, used: MeasuredPoints) -> dict[str, Any] | None:
    """Test whether observed minus projected pixels change with the height, px per 1000 m.

    The test is made in addition to an affine compensation. No compensation has this term.
    A significant term indicates a wrong height system or the RPC of another image. The
    test adds one column for each coordinate and uses F(2, f), where f is the redundancy
    with this column. The result is None if the term is not significant or not determined.
    """
    a = np.column_stack([design(model, used, "affine"), used.ground[:, 2] / 1000.0])
    n, k = a.shape
    if n <= k or np.linalg.matrix_rank(a / np.linalg.norm(a, axis=0), tol=RANK) < k:
        return None
    rows = a[None] / used.sigma_px.T[:, :, None]
    observed = (-residuals(model, used) / used.sigma_px).T
    slopes, squares = [], np.zeros(2)
    for design_px, l in zip(rows, observed, strict=True):  # noqa: E741
        fits = [np.linalg.lstsq(design_px[:, :m], l, rcond=None)[0] for m in (k - 1, k)]
        squares += [float(np.sum((l - design_px[:, : len(x)] @ x) ** 2)) for x in fits]
        slopes.append(float(fits[1][-1]))
    free = 2 * (n - k)
    statistic = (squares[0] - squares[1]) / 2.0 / max(squares[1] / free, np.finfo(float).tiny)
    if statistic <= float(f_quantile(2, free, 1.0 - LEVEL)):
        return None
    return {"line_px_per_km": slopes[0], "sample_px_per_km": slopes[1], "statistic": float(statistic)}
