"""Matching of one block of an image with all other images that show it.

A block is a window of the first image. It contains one or more cells of the grid that distributes the points.
Features are detected, candidates are selected and refined by least-squares matching. Each block is a separate
task: its result depends only on the windows that it reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy import ndimage

from factors.arrays import Array, Index, Mask
from fg_orient.formats.rasters import Grey, Raster
from fg_orient.kernels.matching import AFFINE, CURVED, FIT, SHIFT, SLOPE, fit_windows
from fg_orient.orientation.match.consistency import Trend, fits_neighbours
from fg_orient.orientation.match.epipolar import Pair, inside
from fg_orient.orientation.match.features import Features, candidates, detect
from fg_orient.orientation.match.options import MatchOptions

MODELS: Final = {"slope": SLOPE, "curved": CURVED, "affine": AFFINE, "shift": SHIFT}
#: Maximum number of iterations of least-squares matching; largest distance from the feature's position, px.
ITERATIONS: Final = 15
REACH_PX: Final = 3.0
#: Forward and backward matching must agree within this, px.
BACKWARD_PX: Final = 0.5
#: Width of the second window of a match, relative to the first. An error that grows with the square of the
#: width is twice as large in the second window. Then the difference of both results equals the error in the
#: first window.
WIDER: Final = 2.0**0.5
#: Expected difference between neighbours along the curve, caused by relief, px.
RELIEF_PX: Final = 2.0
#: Number of features of image a that are compared, per feature that can be matched by least squares.
SPARE: Final = 3
#: Smallest response of a feature of b, relative to the weakest response in a. Weaker features of b cannot be
#: the same feature.
WEAKEST: Final = 0.3
#: Border of windows, px: features near a border have no descriptor.
BORDER: Final = 16


class Expected(NamedTuple):
    """Search range for a pair in a block, predicted by the coarse level.

    Parameters
    ----------
    t_low, t_high : float
        Range of the height parameter t along the epipolar curves.
    trend : Trend
        Expected y-parallax, px of b.
    width_px : float
        Half width of the band about the trend, px of b.
    """

    t_low: float
    t_high: float
    trend: Trend
    width_px: float


class Window(NamedTuple):
    """Part of a raster, in pixels of the raster.

    Parameters
    ----------
    row, column : int
        First pixel; may lie outside the raster.
    rows, columns : int
        Size.
    """

    row: int
    column: int
    rows: int
    columns: int


@dataclass(frozen=True, eq=False)
class Matches:
    """Matches of a pair in a block.

    Parameters
    ----------
    pixel_a : (n, 2) array
        Line and sample in the scene of image a.
    pixel_b : (n, 2) array
    covariance : (n, 3) array
        Covariance of least-squares matching, px^2 of b: line line, line sample, sample sample.
    t, parallax_px : (n,) arrays
        Height parameter, and y-parallax including the expected trend.
    direction : (n, 2) array
        Unit vector along the curve in b.
    wider_px, wider_variance : (n,) arrays
        Position along the curve by a window ``WIDER`` times as wide, minus the position by the window, and the variance
        of this difference. The difference shows relief that the geometric unknowns of a window do not follow.
    correlation, strength : (n,) arrays
        Correlation of the windows; strength of the features.
    """

    pixel_a: Array
    pixel_b: Array
    covariance: Array
    t: Array
    parallax_px: Array
    direction: Array
    half_px: Array
    wider_px: Array
    wider_variance: Array
    correlation: Array
    strength: Array

    def take(self, rows: Index | Mask) -> Matches:
        """Return some of the matches."""
        return Matches(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


class Counts(NamedTuple):
    """Numbers of candidates that pass each test.

    Parameters
    ----------
    candidates : int
        Number of pairs of features that are each other's best match.
    neighbours : int
        Number of candidates whose parallax agrees with the parallax of their neighbours.
    fitted : int
        Number of candidates refined by least-squares matching.
    backward : int
        Number of candidates for which matching back returns to the same pixel.
    """

    candidates: int = 0
    neighbours: int = 0
    fitted: int = 0
    backward: int = 0

    def plus(self, other: Counts) -> Counts:
        """Return the sum of both."""
        return Counts(*(x + y for x, y in zip(self, other, strict=True)))


def match_block(
    raster_a: Raster,
    window: Window,
    others: list[tuple[Pair, Raster, Expected]],
    options: MatchOptions,
    most: int,
) -> list[tuple[Matches, Counts]]:
    """Match a block of image a with other images; return one result of at most ``most`` matches for each of them.

    All results use the same features of a, so that the same pixel of a is one point in all images.

    Parameters
    ----------
    raster_a : Raster
        Pixels of image a.
    window : Window
        Block in the raster of a.
    others : list of (Pair, Raster, Expected)
        Each other image: pair with a, its pixels, and the prediction of the coarse level.
    options : MatchOptions
    most : int
        Maximum number of matches with each other image.

    Returns
    -------
    list of (Matches, Counts)
        Results in the order of ``others``; empty matches if the block has no features.
    """
    border = BORDER + round(WIDER * (options.window // 2))
    top, left = window.row - border, window.column - border
    grey = raster_a.window(top, left, window.rows + 2 * border, window.columns + 2 * border)
    size = np.array([window.rows, window.columns])

    def wanted(pixel: Array, response: Array) -> Index:
        own = np.flatnonzero(np.all((pixel >= border - 0.5) & (pixel < border - 0.5 + size), axis=1))
        return own[spread(pixel[own], response[own], 0.0, SPARE * most)]

    found = detect(grey, chosen=wanted)
    first = np.array([raster_a.place.line + top, raster_a.place.sample + left])
    out = []
    for pair, raster_b, expected in others:
        if not len(found.pixel):
            out.append((_none(), Counts()))
            continue
        out.append(_match_pair(grey, first, found, pair, raster_b, expected, options, most))
    return out


def joined(parts: list[Matches]) -> Matches:
    """Return all matches of several blocks."""
    if not parts:
        return _none()
    return Matches(*(np.concatenate([getattr(p, name) for p in parts]) for name in Matches.__dataclass_fields__))


def spread(pixel: Array, strength: Array, distance_px: float, most: int) -> Index:
    """Select at most ``most`` pixels with a distance ``distance_px``: first the strongest of each of ``most`` squares.

    Parameters
    ----------
    pixel : (n, 2) array
    strength : (n,) array
        Larger values are selected first.
    distance_px : float
        Smallest distance of two selected pixels; 0 for any distance.
    most : int
        Number of squares, and maximum number of pixels.

    Returns
    -------
    (m,) array of int
        Selected rows, m <= ``most``, strongest pixels of all squares first.
    """
    n = len(pixel)
    if not n:
        return np.empty(0, np.intp)
    low = pixel.min(axis=0)
    edge = max(float(np.sqrt(np.prod(np.ptp(pixel, axis=0) + 1.0) / most)), distance_px, 1.0)
    square = np.floor((pixel - low) / edge).astype(int)
    number = square[:, 0] * (square[:, 1].max() + 1) + square[:, 1]
    by_square = np.lexsort((-strength, number))
    rank = np.empty(n, int)
    starts = np.flatnonzero(np.r_[True, np.diff(number[by_square]) > 0])
    rank[by_square] = np.arange(n) - np.repeat(starts, np.diff(np.r_[starts, n]))
    return _apart(pixel, np.lexsort((-strength, rank)), distance_px, most)


def _apart(pixel: Array, order: Index, distance_px: float, most: int) -> Index:
    """Return at most ``most`` rows, taken in a given order, whose pixels are ``distance_px`` apart."""
    if not distance_px > 0.0:
        return order[:most]
    taken: dict[tuple[int, int], list[tuple[float, float]]] = {}
    kept = []
    for k in order.tolist():
        line, sample = pixel[k].tolist()
        i, j = int(line // distance_px), int(sample // distance_px)
        near = (p for di in (-1, 0, 1) for dj in (-1, 0, 1) for p in taken.get((i + di, j + dj), ()))
        if all((line - x) ** 2 + (sample - y) ** 2 >= distance_px**2 for x, y in near):
            taken.setdefault((i, j), []).append((line, sample))
            kept.append(k)
            if len(kept) == most:
                break
    return np.array(kept, np.intp)


def _none() -> Matches:
    return Matches(
        *(np.empty((0, 2)),) * 2, np.empty((0, 3)), *(np.empty(0),) * 2, np.empty((0, 2)), *(np.empty(0),) * 5
    )


def _match_pair(
    grey: Grey,
    first: Array,
    found: Features,
    pair: Pair,
    raster_b: Raster,
    expected: Expected,
    options: MatchOptions,
    most: int,
) -> tuple[Matches, Counts]:
    """Match the features of a window of a with image b."""
    place = raster_b.place
    pixel = found.pixel + first
    curves = pair.curves(*pixel.T)
    band = expected.trend.at(pixel)
    ends = [
        curves.at(np.full(len(pixel), t)) + band[:, None] * curves.across for t in (expected.t_low, expected.t_high)
    ]
    reach = expected.width_px + BORDER + options.window
    seen = inside(ends[0], place, -reach) | inside(ends[1], place, -reach)
    if not seen.any():
        return _none(), Counts()
    corners = np.concatenate([ends[0][seen], ends[1][seen]]) - [place.line, place.sample]
    low = np.maximum(np.floor(corners.min(axis=0) - reach), 0.0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0) + reach), [place.rows, place.columns]).astype(int)
    if (high - low < 2 * BORDER).any():
        return _none(), Counts()
    other = raster_b.window(low[0], low[1], high[0] - low[0], high[1] - low[1])
    origin_b = np.array([place.line + low[0], place.sample + low[1]])
    centre = pixel.mean(axis=0)
    matrix = pair.matrix(centre[0], centre[1], float(pair.height_m(np.array(0.5 * (expected.t_low + expected.t_high)))))
    rotation = float(np.degrees(np.arctan2(matrix[0, 1] - matrix[1, 0], matrix[0, 0] + matrix[1, 1])))
    weakest = WEAKEST * float(found.response.min())
    there = detect(other, rotation, lambda _, response: np.flatnonzero(response >= weakest))
    rows = np.flatnonzero(seen)
    moved = curves.take(rows)
    moved = moved._replace(c0=moved.c0 - origin_b)
    ranges = np.full(len(rows), expected.t_low), np.full(len(rows), expected.t_high)
    scale = float(np.sqrt(abs(np.linalg.det(matrix))))
    chosen = candidates(
        found.take(rows),
        there,
        moved,
        ranges,
        (band[rows], expected.width_px),
        options.ratio,
        scale,
        expected.width_px,
    )
    counts = Counts(candidates=len(chosen.a))
    a = rows[chosen.a]
    good = fits_neighbours(pixel[a], chosen.t * curves.half_px[a], RELIEF_PX)
    a, b = a[good], chosen.b[good]
    counts = counts._replace(neighbours=len(a))
    kept = spread(pixel[a], found.response[a], options.distance_px, most)
    a, b = a[kept], b[kept]
    if not len(a):
        return _none(), counts
    centre, direction = np.rint(found.pixel[a]), moved.along[np.searchsorted(rows, a)]
    start = _start(there.pixel[b] + (centre - found.pixel[a]) @ matrix.T, matrix)
    ways = Ways(grey, spline_of(grey), other, spline_of(other), MODELS[options.model], options.window // 2)
    fits, done = ways.forward(centre, start, direction)
    done &= fits[:, FIT.correlation] >= options.correlation
    a, centre, direction, fits = a[done], centre[done], direction[done], fits[done]
    counts = counts._replace(fitted=len(a))
    wide, done = ways.wider().forward(centre, np.hstack([fits[:, FIT.place], fits[:, FIT.affine]]), direction)
    done &= ways.returns(centre, fits, direction)
    a, direction, fits, wide = a[done], direction[done], fits[done], wide[done]
    counts = counts._replace(backward=len(a))
    if not len(a):
        return _none(), counts
    pixel_a = np.rint(found.pixel[a]) + first
    pixel_b = fits[:, FIT.place] + origin_b
    exact = pair.curves(*pixel_a.T)
    t, parallax = exact.coordinates(pixel_b)
    apart = np.einsum("ni,ni->n", wide[:, FIT.place] - fits[:, FIT.place], direction)
    return Matches(
        pixel_a,
        pixel_b,
        fits[:, FIT.covariance],
        t,
        parallax,
        exact.along,
        exact.half_px,
        apart,
        variance_along(wide[:, FIT.covariance], direction),
        fits[:, FIT.correlation],
        found.response[a],
    ), counts


def variance_along(covariance: Array, direction: Array) -> Array:
    """Compute variances along unit vectors.

    Parameters
    ----------
    covariance : (n, 3) array
        Line line, line sample, sample sample.
    direction : (n, 2) array
        Unit vectors: line, sample.

    Returns
    -------
    (n,) array
        Variances in the unit of ``covariance``.
    """
    (ll, ls, ss), (x, y) = covariance.T, direction.T
    return np.asarray(x * x * ll + 2.0 * x * y * ls + y * y * ss)


def _start(place: Array, matrix: Array) -> Array:
    """Return the approximate positions (n, 2) and matrices of windows: (n, 6)."""
    return np.hstack([place, np.broadcast_to(matrix.reshape(-1, 4), (len(place), 4))])


class Ways(NamedTuple):
    """Two windows with their splines, so that least-squares matching is possible in both directions."""

    grey: Grey
    grey_spline: Grey
    other: Grey
    other_spline: Grey
    kind: int
    half: int

    def wider(self) -> Ways:
        """Return the same settings with wider windows."""
        return self._replace(half=round(WIDER * self.half))

    def forward(self, centre: Array, start: Array, direction: Array) -> tuple[Array, Mask]:
        """Match windows of the first image about pixels (n, 2); return results (n, FIT.size) and convergence flags."""
        out, done = np.zeros((len(centre), FIT.size)), np.zeros(len(centre), bool)
        fit_windows(
            self.grey,
            self.other_spline,
            centre,
            start,
            np.ascontiguousarray(direction),
            self.kind,
            self.half,
            0.5 * self.half,
            ITERATIONS,
            REACH_PX,
            out,
            done,
        )
        return out, done

    def returns(self, centre: Array, fits: Array, direction: Array) -> Mask:
        """Return whether matching from the second image back to the first returns to the same pixel."""
        n = len(centre)
        if not n:
            return np.zeros(0, bool)
        there = np.rint(fits[:, FIT.place])
        back = np.linalg.inv(fits[:, FIT.affine].reshape(-1, 2, 2))
        expected = centre + np.einsum("nij,nj->ni", back, there - fits[:, FIT.place])
        along = np.einsum("nij,nj->ni", back, direction)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        reverse = self._replace(grey=self.other, other=self.grey, other_spline=self.grey_spline)
        out, done = reverse.forward(there, np.hstack([expected, back.reshape(n, 4)]), along)
        return np.asarray(done & (np.linalg.norm(out[:, FIT.place] - expected, axis=1) <= BACKWARD_PX))


def spline_of(grey: Grey) -> Grey:
    """Return the coefficients of the cubic B-spline of an image (Unser 1999); nan at and next to nodata."""
    empty = ~np.isfinite(grey)
    if not empty.any():
        return np.asarray(ndimage.spline_filter(grey, order=3, output=np.float32, mode="mirror"))
    filled = np.where(empty, np.float32(np.nanmedian(grey)), grey)
    out = ndimage.spline_filter(filled, order=3, output=np.float32, mode="mirror")
    out[ndimage.binary_dilation(empty, iterations=3)] = np.nan
    return np.asarray(out)
