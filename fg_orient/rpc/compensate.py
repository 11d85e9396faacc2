"""Bias compensation of one RPC image from control points: least squares in the image, with covariance and tests.

    line   - line of the model   = c0 + c2 l + c4 s + v        (Grodecki & Dial 2003, eqs. 4-5)
    sample - sample of the model = c1 + c3 l + c5 s + v

l, s are the model's own normalised coordinates. Ground coordinates are held; their errors in pixels belong to the
sigmas of line and sample. Each point is tested as in ``fg_orient.quality.outliers``, both coordinates together.
:func:`refine` is the work of the command ``rpc refine``: compensation, then its errors at check points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from factors._contract import Array
from factors.cameras import rfm
from factors.cameras.rfm_equation import COMPENSATION, COMPENSATIONS
from factors.cameras.rfm_project import RANGE
from fg_orient.model.distributions import f_quantile
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding, judged
from fg_orient.quality.hypotheses import f_statistics
from fg_orient.quality.rejection import MOST, reject
from fg_orient.rpc.points import MeasuredPoints, statistics
from fg_orient.sensors.rpc import RpcModel, span

#: Kinds as users name them, in the terms of the equation.
KINDS: Final = {"shift": "shift", "shift_drift": "drift", "affine": "affine"}
NAMES: Final = ("line_0", "sample_0", "line_l1", "sample_l1", "line_s1", "sample_s1")
#: Probability to suspect one good point (Baarda's usual choice).
LEVEL: Final = 0.001
#: Below this ratio of singular values, columns of unit length, the points do not determine the terms.
RANK: Final = 1e-8
#: Redundancy number below which the other points do not check a coordinate.
CHECKED: Final = 1e-6


@dataclass(frozen=True)
class Suspect:
    """A grossly wrong point: statistic F, its limit, estimated error of line and sample (px)."""

    id: str
    statistic: float
    limit: float
    error_px: tuple[float, float]

    def finding(self) -> Finding:
        """Name the point, its error and the test."""
        line, sample = self.error_px
        return finding("rpc.gross_error", point=self.id, line_px=line, sample_px=sample, statistic=self.statistic,
                       limit=self.limit)  # fmt: skip

    def record(self) -> dict[str, Any]:
        """As JSON."""
        line, sample = self.error_px
        return {"id": self.id, "statistic": self.statistic, "limit": self.limit, "error_line_px": line,
                "error_sample_px": sample}  # fmt: skip


@dataclass(frozen=True)
class Compensation:
    """An adjusted compensation.

    Parameters
    ----------
    kind : str
        Of ``KINDS``.
    values : (6,) array
        Pixels; zero where the kind has no term.
    cofactors : (6, 6) array
        Zero likewise.
    sigma0 : float
        Root of the variance of unit weight: pixels if no sigmas were given; nan without redundancy.
    redundancy : int
    residuals_px : (n, 2) array
        Adjusted minus observed, line and sample, of the points that took part.
    left_out_px : (n, 2) array
        The same with the compensation of the other points; nan where they do not determine it.
    suspects : tuple of Suspect
        Left out as grossly wrong, in the order in which they were found.
    complete : bool
        False if there are too many suspects to be gross errors.
    used : tuple of str
        Ids of the points that took part.
    """

    kind: str
    values: Array
    cofactors: Array
    sigma0: float
    redundancy: int
    residuals_px: Array
    left_out_px: Array
    suspects: tuple[Suspect, ...]
    complete: bool
    used: tuple[str, ...]

    @property
    def codes(self) -> tuple[int, ...]:
        """Elements of ``values`` that the kind has."""
        return COMPENSATIONS[KINDS[self.kind]]

    @property
    def covariance(self) -> Array:
        """Covariance matrix (6, 6) px^2; nan without redundancy."""
        return np.asarray(self.cofactors * self.sigma0**2)

    def terms(self) -> list[dict[str, Any]]:
        """Name, value and standard deviation (px) of each term."""
        sd = np.sqrt(np.diag(self.covariance))
        return [{"name": NAMES[k], "px": float(self.values[k]), "sd_px": float(sd[k])} for k in self.codes]


def compensate(model: RpcModel, control: MeasuredPoints, kind: str = "shift", *, level: float = LEVEL) -> Compensation:
    """Adjust, test, leave out the worst point, again, until none is suspicious.

    Parameters
    ----------
    model : RpcModel
    control : MeasuredPoints
        All take part.
    kind : str
        "shift" (1 point at least), "shift_drift" (2) or "affine" (3).
    level : float
        Probability of a false alarm per point and round.

    Returns
    -------
    Compensation

    Raises
    ------
    InputError
        No such kind, or too few points.
    NoSolutionError
        The points do not determine the terms: they lie on one line of the image.
    """
    if kind not in KINDS:
        raise InputError.of("rpc.compensation_kind", option="compensation", value=kind, known=", ".join(KINDS))

    def adjusted(out: Sequence[Suspect], _: object) -> tuple[dict[str, Any], Suspect | None]:
        gone = {suspect.id for suspect in out}
        return _adjusted(model, control.take(np.array([name not in gone for name in control.ids], bool)), kind, level)

    end = reject(adjusted((), None), adjusted, lambda found, _: found[1], int(MOST * len(control)))
    return Compensation(**end.fit[0], suspects=end.out, complete=end.worst is None)


def misclosures(model: RpcModel, measured: MeasuredPoints) -> Array:
    """Right-hand side of the adjustment, observed minus projected pixels, line and sample: (n, 2)."""
    return -residuals(model, measured)


def residuals(model: RpcModel, measured: MeasuredPoints, values: Array | None = None) -> Array:
    """Projected minus observed pixels, line and sample: (n, 2); ``values`` (6,) compensate the model."""
    lon, lat, height = measured.ground.T
    return np.stack(model.project(lon, lat, height, values), axis=1) - measured.image


def normalised(model: RpcModel, ground: Array) -> Array:
    """Normalised longitude, latitude, height (n, 3), longitudes within half a turn of the model's."""
    out = (ground - model.offsets[RANGE.ground]) / model.scales[RANGE.ground]
    out[:, 0] -= np.round(out[:, 0] * model.scales[RANGE.lon] / 360.0) * 360.0 / model.scales[RANGE.lon]
    return np.ascontiguousarray(out)


def design(model: RpcModel, measured: MeasuredPoints, kind: str) -> Array:
    """Columns 1, l, s of the kind, the same for line and sample: (n, k)."""
    ground = normalised(model, measured.ground)
    columns = np.column_stack([np.ones(len(ground)), rfm.values(model.coefficients, ground)])
    return columns[:, : len(COMPENSATIONS[KINDS[kind]]) // 2]


def _adjusted(
    model: RpcModel, measured: MeasuredPoints, kind: str, level: float
) -> tuple[dict[str, Any], Suspect | None]:
    """Fields of the compensation from these points, and the most suspicious of them."""
    a, l = design(model, measured, kind), misclosures(model, measured)  # noqa: E741
    n, k = a.shape
    if n < k:
        raise InputError.of("rpc.few_control", place=f"<compensation> {kind}", value=n, least=k)
    values, cofactors = np.zeros(COMPENSATION.size), np.zeros((COMPENSATION.size,) * 2)
    free = np.empty((n, 2))
    for axis in (0, 1):
        codes = np.arange(axis, 2 * k, 2)
        values[codes], cofactors[np.ix_(codes, codes)], free[:, axis] = _least_squares(
            a, l[:, axis], measured.sigma_px[:, axis], kind
        )
    v = a @ values.reshape(-1, 2)[:k] - l
    redundancy = 2 * (n - k)
    square = float(np.sum((v / measured.sigma_px) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        left_out = np.where(free > CHECKED, v / free, np.nan)
    fields = {
        "kind": kind, "values": values, "cofactors": cofactors, "redundancy": redundancy, "residuals_px": v,
        "sigma0": float(np.sqrt(square / redundancy)) if redundancy else float("nan"), "left_out_px": left_out,
        "used": measured.ids,
    }  # fmt: skip
    return fields, _worst(measured, -left_out, free, square, redundancy, level)


def _least_squares(a: Array, l: Array, sigma: Array, kind: str) -> tuple[Array, Array, Array]:  # noqa: E741
    """Unknowns (k,), cofactors (k, k) and redundancy numbers (n,) of one axis."""
    rows = a / sigma[:, None]
    length = np.linalg.norm(rows, axis=0)
    left, size, right = np.linalg.svd(rows / length, full_matrices=False)
    if size[-1] < RANK * size[0]:
        raise NoSolutionError.of("rpc.control_spread", place=f"<compensation> {kind}", value=f"{len(a)} points")
    inverse = right.T / size / length[:, None]
    return inverse @ (left.T @ (l / sigma)), inverse @ inverse.T, 1.0 - np.sum(left**2, axis=1)


def _worst(
    measured: MeasuredPoints, error: Array, free: Array, square: float, redundancy: int, level: float
) -> Suspect | None:
    """The point with the largest F, if it is beyond its limit.

    T = (v_l/sigma_l)^2/r_l + (v_s/sigma_s)^2/r_s with redundancy numbers r, because line and sample have no unknown in
    common; F(2, f - 2) with the scale of the others.
    """
    if redundancy <= 2 or not np.isfinite(error).all():
        return None
    t = np.sum((error / measured.sigma_px) ** 2 * free, axis=1)
    i = int(t.argmax())
    statistic = float(f_statistics(t[i], 2, square, redundancy))
    limit = float(f_quantile(2, redundancy - 2, 1.0 - level))
    if statistic <= limit:
        return None
    return Suspect(measured.ids[i], statistic, limit, (float(error[i, 0]), float(error[i, 1])))


#: Largest sigma0, pixels or given sigmas: what is worse is no measurement of points in this image.
LARGEST_SIGMA0: Final = 5.0


def refine(model: RpcModel, measured: MeasuredPoints, kind: str, *, extrapolate: bool = False) -> dict[str, Any]:
    """Adjust the compensation of a model.

    Parameters
    ----------
    model : RpcModel
    measured : MeasuredPoints
        Control and check points.
    kind : str
        "shift", "shift_drift" or "affine".
    extrapolate : bool
        Take points outside the validity range.

    Returns
    -------
    dict
        status, warnings, compensation, terms (name, px, sd_px), covariance_px2, values_px (6), sigma0, redundancy,
        height_dependence, outliers, control and check (before, after), leave_one_out, check_suspicious, residuals.

    Raises
    ------
    InputError
        A denominator changes its sign inside the image, points outside the validity range, too few points.
    NoSolutionError
        The points do not determine the terms.
    """
    model.require_no_pole()
    if not extrapolate:
        require_inside(model, measured)
    control, check = measured.take(~measured.check), measured.take(measured.check)
    found = compensate(model, control, kind)
    used = control.take(np.isin(control.ids, found.used))
    suspicious, height = _suspicious(model, used, check, found), height_dependence(model, used)
    return {
        **judged(_doubts(found) + _remarks(found, suspicious, height)),
        "compensation": kind, "terms": found.terms(), "values_px": found.values.tolist(),
        "covariance_px2": found.covariance[np.ix_(found.codes, found.codes)].tolist(),
        "sigma0": found.sigma0, "redundancy": found.redundancy, "height_dependence": height,
        "outliers": [suspect.record() for suspect in found.suspects],
        "control": _both(model, used, found), "check": _both(model, check, found),
        "leave_one_out": statistics(found.left_out_px[np.isfinite(found.left_out_px).all(axis=1)]),
        "check_suspicious": suspicious,
        "residuals": _residuals(model, measured, found),
    }  # fmt: skip


def require_inside(model: RpcModel, measured: MeasuredPoints) -> None:
    """Refuse points outside the validity range by name.

    Raises
    ------
    InputError
    """
    bad = np.flatnonzero(~model.inside(*measured.ground.T))
    if len(bad):
        v, (lon, lat, height) = model.validity, measured.ground[bad[0]]
        raise InputError.of(
            "rpc.outside", file=model.file, place=f"point {measured.ids[bad[0]]}",
            value=f"longitude {lon:.6f}, latitude {lat:.6f}, height {height:.1f}; {len(bad)} such point(s)",
            lon=span(v.lon_deg), lat=span(v.lat_deg), height=span(v.height_m),
        )  # fmt: skip


def _both(model: RpcModel, points: MeasuredPoints, found: Compensation) -> dict[str, Any] | None:
    """Statistics before and after."""
    if not len(points):
        return None
    return {
        "before": statistics(residuals(model, points)),
        "after": statistics(residuals(model, points, found.values)),
    }


def _suspicious(model: RpcModel, used: MeasuredPoints, check: MeasuredPoints, found: Compensation) -> list[str]:
    """Check points whose residuals the compensation does not explain: F(2, f) of the predicted residuals."""
    if not len(check) or found.redundancy == 0:
        return []
    a = design(model, check, found.kind)
    v = residuals(model, check, found.values)
    t = np.zeros(len(check))
    for axis in (0, 1):
        codes = np.arange(axis, 2 * a.shape[1], 2)
        q = check.sigma_px[:, axis] ** 2 + np.einsum("ni,ij,nj->n", a, found.cofactors[np.ix_(codes, codes)], a)
        t += v[:, axis] ** 2 / q
    limit = 2.0 * float(f_quantile(2, found.redundancy, 1.0 - LEVEL)) * found.sigma0**2
    return [name for name, bad in zip(check.ids, t > limit, strict=True) if bad]


def _residuals(model: RpcModel, measured: MeasuredPoints, found: Compensation) -> list[dict[str, Any]]:
    """One record per point: role, whether it took part, residuals before and after."""
    before, after = residuals(model, measured), residuals(model, measured, found.values)
    used = set(found.used)
    return [
        {"id": name, "role": "check" if check else "control", "used": name in used,
         "before_line_px": float(b[0]), "before_sample_px": float(b[1]),
         "after_line_px": float(a[0]), "after_sample_px": float(a[1])}
        for name, check, b, a in zip(measured.ids, measured.check, before, after, strict=True)
    ]  # fmt: skip


def _doubts(found: Compensation) -> list[Finding]:
    """Findings that make a compensation unfit for use."""
    out = [] if found.complete else [finding("rpc.too_many_left_out", n=len(found.suspects))]
    return [*out, finding("rpc.no_fit", sigma0=found.sigma0)] if found.sigma0 > LARGEST_SIGMA0 else out


def height_dependence(model: RpcModel, used: MeasuredPoints) -> dict[str, Any] | None:
    """Change of the misclosures with the height in addition to an affine compensation, px per 1000 m.

    No compensation has such a term: it is a sign of a wrong height system, or of the RPC of another image. F(2, f) of
    one more column for each coordinate, f the redundancy with it; None where it is not significant or not determined.
    """
    a = np.column_stack([design(model, used, "affine"), used.ground[:, 2] / 1000.0])
    n, k = a.shape
    if n <= k or np.linalg.matrix_rank(a / np.linalg.norm(a, axis=0), tol=RANK) < k:
        return None
    rows = a[None] / used.sigma_px.T[:, :, None]
    observed = (misclosures(model, used) / used.sigma_px).T
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


def _remarks(found: Compensation, suspicious: list[str], height: dict[str, Any] | None) -> list[Finding]:
    """Further findings for the user."""
    out = [suspect.finding() for suspect in found.suspects]
    if found.redundancy == 0:
        out.append(finding("rpc.no_redundancy"))
    if height is not None:
        line, sample = height["line_px_per_km"], height["sample_px_per_km"]
        out.append(finding("rpc.heights_system", line=line, sample=sample))
    if suspicious:
        out.append(finding("rpc.check_points", points=suspicious))
    return out
