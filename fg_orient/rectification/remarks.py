"""What a reader of a fit's figures must know, in sentences."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.distributions import f_tail
from fg_orient.geodesy import area_of_use, to_geographic
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


def warnings_of(found: PointFit, tests: PointTests, checks: PointTests | None, pruning: Pruning | None) -> list[str]:
    """Say in sentences what a reader of the figures must know.

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
        out.append("points were left out until the RMSE was small: it is no measure of accuracy any more")
    if found.check is None or checks is None:
        return [*out, "no check points: residuals of control points are smaller than errors elsewhere"]
    return out + _suspicious("check point", found.check.ids, checks, found.unit) + _worse(found)


def _suspicious(kind: str, ids: tuple[str, ...], tests: PointTests, unit: str) -> list[str]:
    """Each point beyond its limit, with the size of its error."""
    out = []
    for k in np.flatnonzero(tests.suspicious):
        error = ", ".join(f"{value:+.2f}" for value in tests.error[k])
        out.append(f"{kind} {ids[k]}: gross error of about {error} {unit}; F = {tests.statistic[k]:.1f}, limit "
                   f"{tests.critical[k]:.1f}")  # fmt: skip
    return out


def _layout(found: PointFit) -> list[str]:
    """Points that nothing checks, and directions in which the points hardly reach."""
    fit, out = found.fit, list[str]()
    weak = [name for name, r in zip(fit.points.ids, fit.redundancy_numbers.mean(axis=1), strict=True)
            if r < HARDLY_CHECKED]  # fmt: skip
    if weak:
        out.append(f"hardly checked by the others (redundancy below {HARDLY_CHECKED}): {', '.join(weak)}")
    names, spatial = fit.transformation.source_names, fit.model.dimension == 3
    for reach in fit.reaches:
        # heights always reach less far than the plan: there only what they fail to determine is worth a word
        if reach.is_unknown or (reach.is_weak and not spatial):
            out.append(
                f"the control points reach little along {reach.words(names)}: the scale there is known "
                f"{reach.ratio:.0f} times worse than along them, to {100.0 * reach.sigma:.2g} %"
            )
    typical = TYPICAL_CONDITION.get(fit.model.degree, WEAK_CONDITION / WEAK_FACTOR)
    if fit.condition > WEAK_FACTOR * typical and not out[bool(weak) :]:
        out.append(
            f"the points hardly determine the transformation: condition {fit.condition:.2g}, usual is {typical:g}: "
            f"they lie near {'a surface' if spatial else 'a curve'} of its form"
        )
    return out


def _sigmas(found: PointFit) -> list[str]:
    """Sigmas that the residuals contradict by orders of magnitude, or that leave points without a say."""
    sigma, m0, out = found.fit.points.sigma, found.fit.m0, list[str]()
    if not (sigma != 1.0).any():
        return out
    if m0 > SIGMA_FACTOR or m0 < 1.0 / SIGMA_FACTOR:
        out.append(f"the residuals are {m0:.2g} times what the sigmas say: sigmas of another unit or size?")
    span = float(sigma.max() / sigma.min())
    if span > NO_SAY:
        out.append(f"one sigma is {span:.1g} times another: points with large ones have no say")
    return out


def _far_from_zone(found: PointFit) -> list[str]:
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
    return [
        f"{int(far.sum())} control point(s) lie far outside the area of {t.crs} ({west:g} to {east:g} degrees east, "
        f"{south:g} to {north:g} north), such as {fit.points.ids[k]} ({where}): another zone, or swapped coordinates?"
    ]


def _worse(found: PointFit) -> list[str]:
    """F test of the check points' squares, with the variance of the prediction, against m0."""
    fit, check = found.fit, found.check
    assert check is not None
    variance = (fit.m0 * check.sigma) ** 2 + fit.prediction_sigma(check.source[:, : fit.model.dimension]) ** 2
    n = 2 * len(check)
    statistic = float(np.sum(found.check_residuals**2 / variance)) / n
    if f_tail(n, fit.redundancy, statistic) >= WORSE:
        return []
    ratio = np.sqrt(statistic)
    return [f"check points are {ratio:.1f} times worse than control points predict: too high a degree, or gross errors"]
