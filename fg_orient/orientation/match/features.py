"""Detection of features in a window of an image, and selection of candidate matches in another window.

Features are SIFT features (Lowe 2004), computed by OpenCV. Descriptors are upright: the sensor models
give the rotation between the images. A candidate lies in the band of the epipolar curve and has about
the same size. It is used if both features are each other's best match and clearly better than the
second best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.rasters import Grey
from fg_orient.model.errors import InputError
from fg_orient.orientation.match.epipolar import Curves

#: Contrast of features: a quarter of OpenCV's default, for shadows and snow.
CONTRAST: Final = 0.01
#: Grey values between these percentiles of a window are stretched to the 8 bits of the detector.
STRETCH: Final = (0.5, 99.5)
#: Features closer than this, px, count as one. A second best candidate must be farther away from the best one.
SAME_PX: Final = 0.5
SECOND_PX: Final = 3.0
#: Largest difference of the sizes of two features, octaves.
OCTAVES: Final = 0.8
#: Maximum number of features of a window; the strongest are kept.
MOST: Final = 6000
#: Number of pairs of features in memory at the same time.
AT_ONCE: Final = 2_000_000


class Features(NamedTuple):
    """Features of a window.

    Parameters
    ----------
    pixel : (n, 2) array
        Line and sample relative to the window's first pixel.
    size, response : (n,) arrays
        Diameter, px, and strength.
    descriptor : (n, d) array
        Unit vectors.
    """

    pixel: Array
    size: Array
    response: Array
    descriptor: Any

    def take(self, rows: Any) -> Features:
        """Return some of the features."""
        return Features(*(part[rows] for part in self))


class Candidates(NamedTuple):
    """Pairs of features that may match.

    Parameters
    ----------
    a, b : (n,) int arrays
        Rows of the features of a and of b.
    t, parallax_px : (n,) arrays
        Height parameter and y-parallax (px) of the features of b.
    """

    a: Index
    b: Index
    t: Array
    parallax_px: Array


def cv2_of() -> Any:
    """Import OpenCV, with one thread; InputError if it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise InputError.of("match.no_opencv") from error
    cv2.setNumThreads(1)
    return cv2


def detect(grey: Grey, rotation_deg: float = 0.0, chosen: Callable[[Array, Array], Index] | None = None) -> Features:
    """Return the features of a window.

    Parameters
    ----------
    grey : (P, Q) float array
        Grey values; nan: nodata.
    rotation_deg : float
        Direction of the descriptors, from the sample axis to the line axis.
    chosen : callable, optional
        Function that returns the rows of the requested features, from their pixels (n, 2) and responses (n,).
    """
    cv2 = cv2_of()
    valid = np.isfinite(grey)
    empty = Features(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty((0, 1), np.float32))
    if valid.mean() < 0.02:
        return empty
    low, high = np.percentile(grey[valid][:: max(1, valid.sum() // 100_000)], STRETCH)
    if not high > low:
        return empty
    picture = np.clip((np.where(valid, grey, low) - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    engine = cv2.SIFT_create(nfeatures=0, contrastThreshold=CONTRAST)
    inner = None
    if not valid.all():
        inner = cv2.erode(valid.astype(np.uint8) * 255, np.ones((9, 9), np.uint8))
    points = _distinct(list(engine.detect(picture, inner)))
    if points and chosen is not None:
        points = [points[k] for k in chosen(*_places(points)).tolist()]
    for point in points:
        point.angle = rotation_deg % 360.0
    points, descriptors = engine.compute(picture, points)
    if not points:
        return empty
    pixel, response = _places(points)
    return Features(pixel, np.array([p.size for p in points]), response, _unit(descriptors))


def _places(points: Sequence[Any]) -> tuple[Array, Array]:
    """Return the pixels (n, 2) and responses (n,)."""
    return np.array([(p.pt[1], p.pt[0]) for p in points]), np.array([p.response for p in points])


def _distinct(points: list[Any]) -> list[Any]:
    """Return one feature per position, at most the strongest ``MOST`` (SIFT repeats a position per orientation)."""
    kept: dict[tuple[int, int], Any] = {}
    for point in sorted(points, key=lambda p: (-p.response, p.pt)):
        kept.setdefault((round(point.pt[0] / SAME_PX), round(point.pt[1] / SAME_PX)), point)
    return list(kept.values())[:MOST]


def _unit(descriptors: Any) -> Any:
    """Return descriptors of length 1: the roots of the normalised values (Arandjelovic & Zisserman 2012)."""
    return np.asarray(np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)), np.float32)


def candidates(
    a: Features,
    b: Features,
    curves: Curves,
    t_range: tuple[Array, Array],
    band: tuple[Array, float],
    ratio: float,
    scale: float,
    margin_px: float,
) -> Candidates:
    """Find candidates for the features of a among the features of b.

    Parameters
    ----------
    a, b : Features
    curves : Curves
        Curves of the features of a, in the pixels of the features of b.
    t_range : two (n,) arrays
        Smallest and largest t.
    band : (n,) array, float
        Expected y-parallax and half width, px.
    ratio : float
        Largest ratio of the distances of the best and the second best descriptor.
    scale : float
        Size of a pixel of a in pixels of b.
    margin_px : float
        Tolerance along the curve.
    """
    n, m = len(a.pixel), len(b.pixel)
    if not n or not m:
        return Candidates(*(np.empty(0, np.intp),) * 2, np.empty(0), np.empty(0))
    best, second = np.full(n, np.inf), np.full(n, np.inf)
    index = np.full(n, -1)
    best_of_b, index_of_b = np.full(m, np.inf), np.full(m, -1)
    size_a, size_b = np.log2(a.size * scale), np.log2(b.size)
    slack = margin_px / curves.half_px
    order = np.argsort(b.pixel[:, 0])  # lines of b are sorted, so only features that a curve can meet are compared
    lines = b.pixel[order, 0]
    ends = np.stack([curves.at(t_range[0] - slack)[:, 0], curves.at(t_range[1] + slack)[:, 0]])
    reach = np.abs(band[0]) + band[1] + 1.0
    first, last = np.searchsorted(lines, ends.min(axis=0) - reach), np.searchsorted(lines, ends.max(axis=0) + reach)
    sequence = np.argsort(first)
    step = max(1, AT_ONCE // m)
    for begin in range(0, n, step):
        rows = sequence[begin : begin + step]
        columns = order[first[rows].min() : max(last[rows].max(), first[rows].min())]
        if not len(columns):
            continue
        away = b.pixel[columns][None] - curves.c0[rows][:, None]
        t = np.einsum("abi,ai->ab", away, curves.along[rows]) / curves.half_px[rows][:, None]
        across = np.einsum("abi,ai->ab", away, curves.across[rows])
        bend = np.einsum("ai,ai->a", curves.c2[rows], curves.across[rows])[:, None]
        off = across - bend * t * t - band[0][rows][:, None]
        good = (np.abs(off) <= band[1]) & (np.abs(size_a[rows][:, None] - size_b[columns][None]) <= OCTAVES)
        good &= (t >= (t_range[0] - slack)[rows][:, None]) & (t <= (t_range[1] + slack)[rows][:, None])
        squares = np.where(good, 2.0 - 2.0 * (a.descriptor[rows] @ b.descriptor[columns].T), np.inf)
        k = squares.argmin(axis=1)
        best[rows], index[rows] = squares[np.arange(len(rows)), k], columns[k]
        far = np.abs(b.pixel[columns][None] - b.pixel[columns[k]][:, None]).max(axis=2) > SECOND_PX
        second[rows] = np.where(far, squares, np.inf).min(axis=1)
        nearest = squares.argmin(axis=0)
        value = squares[nearest, np.arange(len(columns))]
        better = value < best_of_b[columns]
        best_of_b[columns[better]], index_of_b[columns[better]] = value[better], rows[nearest[better]]
    limit = ratio**2 * np.minimum(second, WORST)
    rows = np.flatnonzero(np.isfinite(best) & (best <= limit))
    rows = rows[index_of_b[index[rows]] == rows]
    t, parallax = curves.take(rows).coordinates(b.pixel[index[rows]])
    return Candidates(rows, index[rows], t, parallax)


#: If a candidate has no second best, the squared distance of its descriptors must be below this.
WORST: Final = 0.6
