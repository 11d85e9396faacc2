"""``rpc refine``: compensation from control points, judged at check points, written back."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import f_quantile
from fg_orient.model.errors import Finding, InputError, finding, judged
from fg_orient.rpc.compensate import LEVEL, RANK, Compensation, compensate, design, misclosures, residuals
from fg_orient.rpc.points import MeasuredPoints, statistics
from fg_orient.sensors.rpc import RpcModel, span

Array = npt.NDArray[np.float64]

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
    """What makes a compensation unfit for use."""
    out = [] if found.complete else [finding("rpc.too_many_left_out", n=len(found.suspects))]
    return [*out, finding("rpc.no_fit", sigma0=found.sigma0)] if found.sigma0 > LARGEST_SIGMA0 else out


def height_dependence(model: RpcModel, used: MeasuredPoints) -> dict[str, Any] | None:
    """Change of the misclosures with the height beside an affine compensation, px per 1000 m.

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
    """What a user should know beside."""
    out = [suspect.finding() for suspect in found.suspects]
    if found.redundancy == 0:
        out.append(finding("rpc.no_redundancy"))
    if height is not None:
        line, sample = height["line_px_per_km"], height["sample_px_per_km"]
        out.append(finding("rpc.heights_system", line=line, sample=sample))
    if suspicious:
        out.append(finding("rpc.check_points", points=suspicious))
    return out
