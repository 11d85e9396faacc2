"""Coarse level: whole images are reduced to about a thousand lines and matched in the band of the priors.

The result is the trend of the y-parallax of each pair and the heights of the ground. Both restrict the search at full
resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.rasters import Raster
from fg_orient.orientation.match.consistency import Trend, fits_neighbours, trend_of
from fg_orient.orientation.match.epipolar import Pair
from fg_orient.orientation.match.features import Features, candidates, detect
from fg_orient.orientation.match.options import MatchOptions

#: Maximum number of lines or samples of a reduced image.
SIZE: Final = 1000
#: Expected difference between neighbours along the curve, caused by relief, reduced pixels.
RELIEF_PX: Final = 3.0
#: Largest ratio of the pixel sizes of two images, because least-squares matching needs nearly the same resolution.
SCALE: Final = 2.5
#: Limit of the ratio test on this level, where the band is not narrow.
RATIO: Final = 0.8
#: Smallest half width of the band at full resolution, px.
WIDTH_PX: Final = 6.0
#: Margin added to the range of the coarse level, reduced pixels, and smallest margin, px.
MARGIN: Final = 6.0
MARGIN_PX: Final = 20.0
#: Number of nearest coarse matches that give the heights of a block.
NEAREST: Final = 12


@dataclass(frozen=True, eq=False)
class Coarse:
    """Result of the coarse level of a pair: pixels (n, 2) of a, t (n,), trend, and numbers for the report.

    ``trend`` is None if the images do not match, for the reason in ``reason``.
    """

    pixel: Array
    t: Array
    half_px: float
    factor: int
    trend: Trend | None
    candidates: int
    reason: str = ""

    def width_px(self) -> float:
        """Return the half width of the band at full resolution."""
        assert self.trend is not None
        return max(WIDTH_PX, 4.0 * self.trend.scatter_px)

    def t_range(self, low: Array, high: Array) -> tuple[float, float]:
        """Return the range of t for a block of image a, from matches in and around it, with a margin."""
        size = high - low
        near = np.all((self.pixel >= low - 0.5 * size) & (self.pixel <= high + 0.5 * size), axis=1)
        near = np.asarray(near)
        distance = np.linalg.norm(self.pixel - 0.5 * (low + high), axis=1)
        near[np.argsort(distance)[:NEAREST]] = True
        t = self.t[near]
        margin = max(MARGIN * self.factor, MARGIN_PX) / self.half_px + 0.25 * float(np.ptp(t))
        return max(float(t.min()) - margin, -1.5), min(float(t.max()) + margin, 1.5)


def reduction(*rasters: Raster) -> int:
    """Return the factor by which the largest image is reduced."""
    return max(1, ceil(max(max(r.place.rows, r.place.columns) for r in rasters) / SIZE))


def _reduced(raster: Raster, factor: int, rotation_deg: float) -> Features:
    """Return the features of a reduced image, in pixels of the scene."""
    found = detect(raster.reduced(factor), rotation_deg)
    pixel = (found.pixel + 0.5) * factor - 0.5 + [raster.place.line, raster.place.sample]
    return found._replace(pixel=pixel, size=found.size * factor)


def match_coarse(raster_a: Raster, raster_b: Raster, pair: Pair, half_width_px: float, options: MatchOptions) -> Coarse:
    """Match the reduced images of a pair.

    Parameters
    ----------
    raster_a, raster_b : Raster
    pair : Pair
    half_width_px : float
        Half width of the band: three prior standard deviations of the y-parallax.
    options : MatchOptions
    """
    factor = reduction(raster_a, raster_b)
    matrix = pair.matrix(*raster_a.place.centre, 0.5 * (pair.low_m + pair.high_m))
    scale = float(np.sqrt(abs(np.linalg.det(matrix))))
    none = np.empty((0, 2)), np.empty(0), 1.0, factor
    if not 1.0 / SCALE <= scale <= SCALE:
        return Coarse(*none, None, 0, f"a pixel of the first image has {scale:.2g} times the edge of one of the second")
    rotation = float(np.degrees(np.arctan2(matrix[0, 1] - matrix[1, 0], matrix[0, 0] + matrix[1, 1])))
    a = _reduced(raster_a, factor, 0.0)
    b = _reduced(raster_b, factor, rotation)
    if len(a.pixel) < 12 or len(b.pixel) < 12:
        return Coarse(*none, None, 0, "an image has no features")
    curves = pair.curves(*a.pixel.T)
    whole = np.ones(len(a.pixel))
    half_width_px += 3.0 * factor
    found = candidates(
        a, b, curves, (-whole, whole), (0.0 * whole, half_width_px), min(RATIO, options.ratio), scale, 3.0 * factor
    )
    pixel, along = a.pixel[found.a], found.t * curves.half_px[found.a]
    good = np.flatnonzero(fits_neighbours(pixel, along, RELIEF_PX * factor))
    trend = trend_of(pixel[good], found.parallax_px[good], half_width_px)
    if trend is None:
        reason = f"{len(good)} of {len(found.a)} candidates agree with their neighbours, no more than by chance"
        return Coarse(*none, None, len(found.a), reason)
    rest = np.abs(found.parallax_px[good] - trend.at(pixel[good]))
    kept = good[rest <= 4.0 * max(trend.scatter_px, 0.25 * factor)]
    kept = kept[fits_neighbours(pixel[kept], along[kept], RELIEF_PX * factor)]
    if len(kept) < 8:
        return Coarse(*none, None, len(found.a), f"only {len(kept)} matches agree")
    return Coarse(
        pixel[kept], found.t[kept], float(np.median(curves.half_px[found.a[kept]])), factor, trend, len(found.a)
    )
