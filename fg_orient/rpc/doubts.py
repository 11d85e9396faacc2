"""Reasons to doubt an RPC or its compensation, from measured points.

The tests are the same as in an adjustment (``fg_orient.quality.doubts``, ``verdict``, ``mix_ups``), for one image:
interval of sigma0, prior of the compensation, largest difference at check points, and another reading of the pixels.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from factors.cameras.rfm_project import COMPENSATION, RANGE
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.distributions import chi_square_limit, chi_square_tail, f_quantile, sidak
from fg_orient.model.errors import Finding, finding
from fg_orient.model.options import Options
from fg_orient.quality.doubts import BUDGET
from fg_orient.quality.mix_ups import BETTER, FAR_PX, GROUND_READINGS, LEAST_POINTS, READINGS
from fg_orient.quality.verdict import sigma0_interval
from fg_orient.rpc.compensate import LEVEL, NAMES, Compensation, compensate, predicted_squares
from fg_orient.rpc.points import MeasuredPoints
from fg_orient.sensors.rpc import RpcModel
from fg_orient.sensors.rpc_sensor import RpcSensor

#: Largest plausible sigma0 in pixels. If sigma0 is larger, the points were not measured in this image.
LARGEST_SIGMA0_PX: Final = 5.0
#: Step on the ground for the size of a pixel, degrees: about 10 m.
_STEP_DEG: Final = 1e-4


class Prior(NamedTuple):
    """Standard deviations (6,) of a compensation before it is estimated, pixels, and their source in words."""

    sigma_px: Array
    source: str


def prior_of_adjustment() -> Prior:
    """Return the prior that ``adjust`` gives the compensation of an RPC by default."""
    options = Options()
    sigma = np.full(COMPENSATION.size, options.rpc_linear_sigma_px)
    sigma[[COMPENSATION.line, COMPENSATION.sample]] = options.rpc_shift_sigma_px
    return Prior(sigma, "as in an adjustment")


def of_points(model: RpcModel, measured: MeasuredPoints) -> list[Finding]:
    """Return the findings on an RPC from points: one shift must explain their residuals.

    The prior of the shift is the vendor's ERR_BIAS if the file states it, otherwise the prior of an adjustment. The
    vendor's ERR_RAND is added to the sigmas of the points. Points without a pixel are not used.
    """
    projected = np.stack(model.project(*measured.ground.T), axis=1)
    points = measured.take(np.asarray(np.isfinite(projected).all(axis=1)))
    if not len(points):
        return []
    bias, rand = (np.array([0.0, 0.0]) if e is None or not e > 0.0 else e * _pixels_per_metre(model)
                  for e in (model.err_bias_m, model.err_rand_m))  # fmt: skip
    prior = prior_of_adjustment()
    if bias.all():
        sigma = prior.sigma_px.copy()
        sigma[[COMPENSATION.line, COMPENSATION.sample]] = bias
        prior = Prior(sigma, "ERR_BIAS of the file")
    fit = compensate(model, replace(points, sigma_px=np.hypot(points.sigma_px, rand)))
    return of_compensation(model, fit, points, prior)


def _pixels_per_metre(model: RpcModel) -> Array:
    """Return the standard deviations (2,) of line and sample for 1 m standard deviation in East and in North."""
    lon, lat, h = model.offsets[RANGE.ground]
    step = np.array([[0.0, 0.0], [_STEP_DEG, 0.0], [0.0, _STEP_DEG]])
    place = [np.ascontiguousarray(a) for a in (lon + step[:, 0], lat + step[:, 1], np.full(3, h))]
    ecef, pixel = geodetic_to_ecef(*place), np.stack(model.project(*place), axis=1)
    metres = np.linalg.norm(ecef[1:] - ecef[0], axis=1)
    return np.asarray(np.linalg.norm((pixel[1:] - pixel[0]) / metres[:, None], axis=0))


def of_compensation(model: RpcModel, fit: Compensation, given: MeasuredPoints, prior: Prior) -> list[Finding]:
    """Return the findings on a compensation, doubts first; ``given``: all its points, also gross errors."""
    out = [*mix_up(model, given), *misfit(fit), *beyond_prior(fit, prior)]
    out += [] if fit.complete else [finding("rpc.too_many_left_out", n=len(fit.outliers))]
    out.sort(key=lambda f: f.severity != "doubt")
    return out + [
        finding(
            "rpc.gross_error",
            point=one["id"],
            line_px=one["error_line_px"],
            sample_px=one["error_sample_px"],
            statistic=one["statistic"],
            limit=one["limit"],
        )
        for one in fit.outliers
    ]


def mix_up(model: RpcModel, measured: MeasuredPoints) -> list[Finding]:
    """Report the other reading of pixels or coordinates with which the points fit far better than as given."""
    if len(measured) < LEAST_POINTS:
        return []
    lon, lat, height = measured.ground.T
    line, sample = measured.image.T
    sensor = RpcSensor(model, poles=True)

    def away(lon: Array, lat: Array, pixels: Iterable[Array]) -> Array:
        d = np.hypot(*(p - q for p, q in zip(model.project(lon, lat, height), pixels, strict=True)))
        return np.where(np.isfinite(d), d, np.inf)

    given = away(lon, lat, (line, sample))
    if not np.median(given) > FAR_PX:
        return []
    found = {name: away(lon, lat, read(line, sample, sensor)) for name, read in READINGS.items()}
    found |= {name: away(*read(lon, lat), (line, sample)) for name, read in GROUND_READINGS.items()}
    name = min(found, key=lambda name: float(np.median(found[name])))
    best_px, given_px = float(np.median(found[name])), float(np.median(given))
    if not BETTER * best_px < given_px:
        return []
    return [
        finding(
            "solution.mix_up",
            image=Path(model.file).name,
            reading=name,
            n=int((found[name] < given).sum()),
            of=len(given),
            best_px=best_px,
            given_px=given_px,
            before="",
            after="",
            left="",
        )
    ]


def misfit(fit: Compensation) -> list[Finding]:
    """Report residuals that the sigmas do not allow: a doubt if the file states the sigmas or sigma0 is above 5 px.

    Without sigmas in the file, 1 px is only an assumption: then a smaller excess is a warning.
    """
    f = fit.redundancy
    if f <= 0 or not np.isfinite(fit.sigma0):
        return []
    limit = sigma0_interval(f)[1]
    if not fit.sigma0 > limit:
        return []
    # sigma0 in pixels, by the redundancy of the residuals
    rms_px = float(np.sqrt(np.sum(fit.residuals_px**2) / f))
    sigma_px = float(np.sqrt(np.mean(fit.points.sigma_px**2)))
    figures = {"sigma0": fit.sigma0, "limit": limit, "rms_px": rms_px, "sigma_px": sigma_px}
    if rms_px > LARGEST_SIGMA0_PX:
        return [finding("rpc.no_fit", **figures)]
    return [finding("rpc.sigma0" if fit.points.stated else "rpc.sigma0_assumed", **figures)]


def beyond_prior(fit: Compensation, prior: Prior) -> list[Finding]:
    """Report a doubt on the term that is farthest beyond its prior standard deviation.

    The variance of the value is the variance of the prior plus the variance of the estimate.
    """
    codes = np.array(fit.codes)
    variance = prior.sigma_px[codes] ** 2 + np.diag(fit.cofactors)[codes]
    size = np.abs(fit.values[codes]) / np.sqrt(variance)
    if not (chi_square_tail(1, size**2) <= sidak(BUDGET["beyond_prior"], len(codes))).any():
        return []
    k = int(size.argmax())
    code = int(codes[k])
    return [
        finding(
            "rpc.beyond_prior",
            place=NAMES[code],
            value_px=float(fit.values[code]),
            size=float(size[k]),
            sigma=float(prior.sigma_px[code]),
            source=prior.source,
        )
    ]


def of_check_points(model: RpcModel, check: MeasuredPoints, v: Array, fit: Compensation) -> list[Finding]:
    """Return the doubt on check points whose residuals v (n, 2) are too large for chance.

    The limit of the largest of n points follows from chi2(2) if the file states the sigmas and sigma0 allows them,
    otherwise from F(2, f) with the sigma0 of the control points. If 1 px is only assumed, the limit is at most the
    limit of chi2(2) with sigmas of 5 px.
    """
    if not len(check):
        return []
    level, f, scale = sidak(BUDGET["check_far"], len(check)), fit.redundancy, 1.0
    square = float(chi_square_limit(2, level))
    if f > 0 and (not check.stated or fit.sigma0 > sigma0_interval(f)[1]):
        scale, square = fit.sigma0, 2.0 * float(f_quantile(2, f, 1.0 - level))
    if not check.stated and not square * scale**2 < LARGEST_SIGMA0_PX**2 * chi_square_limit(2, level):
        scale, square = LARGEST_SIGMA0_PX, float(chi_square_limit(2, level))
    ratio = np.sqrt(predicted_squares(model, check, v, fit)) / scale
    far = np.flatnonzero(~(ratio <= np.sqrt(square)))
    if not len(far):
        return []
    far = far[np.argsort(-ratio[far], kind="stable")]
    worst = int(far[0])
    return [
        finding(
            "rpc.check_far",
            n=len(far),
            of=len(check),
            points=[check.ids[k] for k in far],
            worst=check.ids[worst],
            line_px=float(v[worst, 0]),
            sample_px=float(v[worst, 1]),
            size=float(ratio[worst]),
            limit=float(np.sqrt(square)),
        )
    ]


def suspicious_points(model: RpcModel, check: MeasuredPoints, v: Array, fit: Compensation) -> list[str]:
    """Return check points whose residuals v (n, 2) the compensation does not explain, by F(2, f)."""
    if not len(check) or fit.redundancy == 0:
        return []
    limit = 2.0 * float(f_quantile(2, fit.redundancy, 1.0 - LEVEL)) * fit.sigma0**2
    return [name for name, bad in zip(check.ids, predicted_squares(model, check, v, fit) > limit, strict=True) if bad]
