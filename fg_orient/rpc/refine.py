"""``rpc refine``: compensation from control points, judged at check points, written back."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.special import fdtri

from fg_orient.errors import InputError
from fg_orient.rpc.compensate import LEVEL, Compensation, compensate, design, misclosures
from fg_orient.rpc.points import MeasuredPoints, statistics
from fg_orient.sensors.rpc import RpcModel, span

Array = npt.NDArray[np.float64]

#: Redundancy that a compensation must have before its sigma0 says anything.
LEAST_REDUNDANCY: Final = 1


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
        outliers, control and check (before, after), leave_one_out, check_suspicious, residuals.

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
    suspicious = _suspicious(model, used, check, found)
    doubts = _doubts(found)
    return {
        "status": "not_trustworthy" if doubts else "good",
        "warnings": doubts + _remarks(found, suspicious),
        "compensation": kind, "terms": found.terms(), "values_px": found.values.tolist(),
        "covariance_px2": found.covariance[np.ix_(found.codes, found.codes)].tolist(),
        "sigma0": found.sigma0, "redundancy": found.redundancy,
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
        "before": statistics(misclosures(model, points)),
        "after": statistics(misclosures(model, points, found.values)),
    }


def _suspicious(model: RpcModel, used: MeasuredPoints, check: MeasuredPoints, found: Compensation) -> list[str]:
    """Check points whose residuals the compensation does not explain: F(2, f) of the predicted residuals."""
    if not len(check) or found.redundancy < LEAST_REDUNDANCY:
        return []
    a = design(model, check, found.kind)
    v = misclosures(model, check, found.values)
    t = np.zeros(len(check))
    for axis in (0, 1):
        codes = np.arange(axis, 2 * a.shape[1], 2)
        q = check.sigma_px[:, axis] ** 2 + np.einsum("ni,ij,nj->n", a, found.cofactors[np.ix_(codes, codes)], a)
        t += v[:, axis] ** 2 / q
    limit = 2.0 * float(fdtri(2, found.redundancy, 1.0 - LEVEL)) * found.sigma0**2
    return [name for name, bad in zip(check.ids, t > limit, strict=True) if bad]


def _residuals(model: RpcModel, measured: MeasuredPoints, found: Compensation) -> list[dict[str, Any]]:
    """One record per point: role, whether it took part, residuals before and after."""
    before, after = misclosures(model, measured), misclosures(model, measured, found.values)
    used = set(found.used)
    return [
        {"id": name, "role": "check" if check else "control", "used": name in used,
         "before_line_px": float(b[0]), "before_sample_px": float(b[1]),
         "after_line_px": float(a[0]), "after_sample_px": float(a[1])}
        for name, check, b, a in zip(measured.ids, measured.check, before, after, strict=True)
    ]  # fmt: skip


def _doubts(found: Compensation) -> list[str]:
    """What makes a compensation unfit for use."""
    if found.complete:
        return []
    return [
        f"{len(found.suspects)} control points were left out and more are suspicious: too many for gross errors; "
        "take another compensation, or check coordinates, heights and order of the file"
    ]


def _remarks(found: Compensation, suspicious: list[str]) -> list[str]:
    """What a user should know beside."""
    out = [suspect.sentence() for suspect in found.suspects]
    if found.redundancy < LEAST_REDUNDANCY:
        out.append("no redundancy: standard deviations are null and gross errors cannot be found")
    if suspicious:
        out.append(f"check points that do not fit: {', '.join(suspicious)}")
    return out
