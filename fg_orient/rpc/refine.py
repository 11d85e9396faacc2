"""Refine an RPC with control points: compensation, its errors at check points, and the reasons not to use it."""

from __future__ import annotations

from typing import Any

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.model.errors import Finding, finding, judged
from fg_orient.model.names import Role
from fg_orient.rpc.compensate import Compensation, compensate, height_dependence, residuals
from fg_orient.rpc.doubts import of_check_points, of_compensation, prior_of_adjustment, suspicious_points
from fg_orient.rpc.points import MeasuredPoints, statistics
from fg_orient.sensors.rpc import RpcModel


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
        True: also use points outside the validity range.

    Returns
    -------
    dict
        status, warnings, compensation, terms (name, px, sd_px), covariance_px2, values_px
        (6), sigma0, redundancy, height_dependence, outliers, control and check (before,
        after), leave_one_out, check_suspicious, residuals.

    Raises
    ------
    InputError
        A denominator changes its sign inside the image, points are outside the validity range, or there are too few.
    NoSolutionError
        The points do not determine the terms.
    """
    model.require_no_pole()
    if not extrapolate:
        lon, lat, height_m = measured.ground.T
        model.require_valid(lon, lat, height_m, measured.ids)
    check = measured.check
    fit = compensate(model, measured.take(~check), kind)
    before, after = residuals(model, measured), residuals(model, measured, fit.values)
    suspicious = suspicious_points(model, measured.take(check), after[check], fit)
    height, used = height_dependence(model, fit.points), np.isin(measured.ids, fit.points.ids)

    def both(rows: Mask) -> dict[str, Any]:
        return {"before": statistics(before[rows]), "after": statistics(after[rows])}

    return {
        **judged(_findings(model, measured, fit, after[check], suspicious, height)),
        "compensation": kind,
        "terms": fit.terms(),
        "values_px": fit.values.tolist(),
        "covariance_px2": fit.covariance[np.ix_(fit.codes, fit.codes)].tolist(),
        "sigma0": fit.sigma0,
        "redundancy": fit.redundancy,
        "height_dependence": height,
        "outliers": list(fit.outliers),
        "control": both(used),
        "check": both(check) if check.any() else None,
        "leave_one_out": statistics(fit.left_out_px[np.isfinite(fit.left_out_px).all(axis=1)]),
        "check_suspicious": suspicious,
        "residuals": [
            {
                "id": name,
                "role": str(Role.CHECK if check[k] else Role.CONTROL),
                "used": bool(used[k]),
                "before_line_px": float(before[k, 0]),
                "before_sample_px": float(before[k, 1]),
                "after_line_px": float(after[k, 0]),
                "after_sample_px": float(after[k, 1]),
            }
            for k, name in enumerate(measured.ids)
        ],
    }


def _findings(
    model: RpcModel,
    measured: MeasuredPoints,
    fit: Compensation,
    v: Array,
    suspicious: list[str],
    height: dict[str, Any] | None,
) -> list[Finding]:
    """Return the findings on a compensation, doubts first; v (k, 2): residuals of the check points."""
    out = of_compensation(model, fit, measured.take(~measured.check), prior_of_adjustment())
    far = of_check_points(model, measured.take(measured.check), v, fit)
    out = [*[f for f in out if f.severity == "doubt"], *far, *[f for f in out if f.severity != "doubt"]]
    if fit.redundancy == 0:
        out.append(finding("rpc.no_redundancy"))
    if height is not None:
        line, sample = height["line_px_per_km"], height["sample_px_per_km"]
        out.append(finding("rpc.heights_system", line=line, sample=sample))
    if suspicious:
        out.append(finding("rpc.check_points", points=suspicious))
    return out
