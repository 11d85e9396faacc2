"""Findings on a fit that a reader of its figures must know."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import area_of_use, to_geographic
from fg_orient.model.distributions import f_tail
from fg_orient.model.errors import Finding, finding
from fg_orient.rectification.outliers import PointTests, Pruning
from fg_orient.rectification.points import DIRECTIONS, PointFit

Array = npt.NDArray[np.float64]

#: Condition number of the scaled design beyond which the points hardly determine a transformation: 50 times the median
#: of random layouts with three points more than terms, by degree of a polynomial, in general for all others.
TYPICAL_CONDITION: Final = {1: 1.5, 2: 8.0, 3: 25.0, 4: 125.0, 5: 500.0}
WEAK_FACTOR: Final = 50.0
WEAK_CONDITION: Final = 1e4
#: Redundancy number below which an error of a point hardly shows in its own residual.
HARDLY_CHECKED: Final = 0.1
#: Probability below which check points are worse than the control points say.
WORSE: Final = 0.001
#: m0 of weighted points outside this range: the sigmas are not those of the points.
SIGMA_FACTOR: Final = 100.0
#: Ratio of sigmas beyond which the points of the larger ones have no say.
NO_SAY: Final = 1e4
#: Distance from the area of use of a map projection, by its width, that is called far: half a zone of UTM.
FAR: Final = 0.5


def findings_on(
    found: PointFit, tests: PointTests, checks: PointTests | None, pruning: Pruning | None
) -> list[Finding]:  # fmt: skip
    """Give what a reader of the figures must know.

    Parameters
    ----------
    found : PointFit
    tests, checks : PointTests
        Of the control points, and of the check points if there are any.
    pruning : Pruning, optional
        If points were left out.
    """
    out = _suspicious("point", found.fit.points.ids, tests, found.unit)
    out += _layout(found) + _sigmas(found) + _far_from_zone(found)
    if pruning is not None and pruning.dropped:
        out.append(finding("rectify.rmse_after_pruning"))
    if found.check is None or checks is None:
        return [*out, finding("rectify.no_check")]
    return out + _suspicious("check point", found.check.ids, checks, found.unit) + _worse(found)


def _suspicious(kind: str, ids: tuple[str, ...], tests: PointTests, unit: str) -> list[Finding]:
    """Each point beyond its limit, with the size of its error."""
    return [
        finding("rectify.gross_error", kind=kind, point=ids[k], error=list(tests.error[k]), unit=unit,
                statistic=tests.statistic[k], limit=tests.critical[k])
        for k in np.flatnonzero(tests.suspicious)
    ]  # fmt: skip


def _layout(found: PointFit) -> list[Finding]:
    """Points that nothing checks, and directions in which the points hardly reach."""
    fit, out = found.fit, list[Finding]()
    weak = [name for name, r in zip(fit.points.ids, fit.redundancy_numbers.mean(axis=1), strict=True)
            if r < HARDLY_CHECKED]  # fmt: skip
    if weak:
        out.append(finding("rectify.hardly_checked", limit=HARDLY_CHECKED, points=weak))
    names, spatial = fit.transformation.source_names, fit.model.dimension == 3
    for reach in fit.reaches:
        # heights always reach less far than the plan: there only what they fail to determine is worth a word
        if reach.is_unknown or (reach.is_weak and not spatial):
            out.append(finding("rectify.little_reach", direction=reach.words(names), ratio=reach.ratio,
                               percent=100.0 * reach.sigma))  # fmt: skip
    typical = TYPICAL_CONDITION.get(fit.model.degree, WEAK_CONDITION / WEAK_FACTOR)
    if fit.condition > WEAK_FACTOR * typical and not out[bool(weak) :]:
        out.append(finding("rectify.hardly_determined", condition=fit.condition, typical=typical,
                           what="a surface" if spatial else "a curve"))  # fmt: skip
    return out


def _sigmas(found: PointFit) -> list[Finding]:
    """Sigmas that the residuals contradict by orders of magnitude, or that leave points without a say."""
    sigma, m0, out = found.fit.points.sigma, found.fit.m0, list[Finding]()
    if not (sigma != 1.0).any():
        return out
    if m0 > SIGMA_FACTOR or m0 < 1.0 / SIGMA_FACTOR:
        out.append(finding("rectify.sigma_size", m0=m0))
    span = float(sigma.max() / sigma.min())
    if span > NO_SAY:
        out.append(finding("rectify.sigma_span", span=span))
    return out


def _far_from_zone(found: PointFit) -> list[Finding]:
    """Points far outside the area for which the map projection was made."""
    t, fit = found.fit.transformation, found.fit
    area = area_of_use(t.crs) if t.crs else None
    if area is None:
        return []
    plane = fit.points.target if found.direction == DIRECTIONS[0] else fit.points.source[:, :2]
    west, south, east, north = area
    lon, lat = to_geographic(t.crs, *plane.T)
    width = (east - west) % 360.0 or 360.0
    off = (lon - (west + 0.5 * width) + 180.0) % 360.0 - 180.0  # from the middle of the area
    beyond = np.maximum(np.abs(off) / width - 0.5, np.maximum(south - lat, lat - north) / max(north - south, width))
    far = ~(beyond <= FAR)  # nan: outside the domain of the projection
    if not far.any():
        return []
    k = int(np.argmax(np.where(np.isnan(beyond), np.inf, beyond)))
    where = f"longitude {lon[k]:.1f}, latitude {lat[k]:.1f}" if np.isfinite(lon[k] + lat[k]) else "no place on Earth"
    return [finding("rectify.far_from_zone", n=far.sum(), crs=t.crs, west=west, east=east, south=south, north=north,
                    point=fit.points.ids[k], where=where)]  # fmt: skip


def _worse(found: PointFit) -> list[Finding]:
    """F test of the check points' squares, with the variance of the prediction, against m0."""
    fit, check = found.fit, found.check
    assert check is not None
    variance = (fit.m0 * check.sigma) ** 2 + fit.prediction_sigma(check.source[:, : fit.model.dimension]) ** 2
    n = 2 * len(check)
    statistic = float(np.sum(found.check_residuals**2 / variance)) / n
    if f_tail(n, fit.redundancy, statistic) >= WORSE:
        return []
    return [finding("rectify.check_worse", ratio=np.sqrt(statistic))]
