"""Areas and lengths of outlines, and areas counted in pixels (İpbüker 1994, section 7.2).

A pixel belongs to an outline if its centre lies inside. Over random positions and orientations of
the grid the mean of the count is the area; its standard deviation is about
``sqrt(0.0728 L h^3)`` for a perimeter L and pixels of size h (Kendall's problem of lattice
points, for outlines without preferred direction).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive

#: Variance of a pixel-count area, divided by the perimeter and the cube of the pixel size.
PIXEL_VARIANCE = 0.0728


def outline(vertices: npt.ArrayLike) -> Array:
    """Checked vertices (n, 2) of a closed outline, without a last vertex equal to the first.

    Raises
    ------
    InputError
        Fewer than three vertices, or values that are not finite.
    """
    given = finite("vertices", vertices)
    if given.ndim == 2 and len(given) > 1 and np.array_equal(given[0], given[-1]):
        given = given[:-1]
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < 3:
        raise InputError.of("rectify.outline", value=f"shape {given.shape}")
    return given


def planar_area_m2(vertices: npt.ArrayLike) -> float:
    """Area of a polygon in a plane, ``|sum (x_i y_i+1 - x_i+1 y_i)|/2`` about its centre.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    x, y = (given - given.mean(axis=0)).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0)


def perimeter_m(vertices: npt.ArrayLike) -> float:
    """Sum of the chords of a closed outline, m.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    return float(np.hypot(*(np.roll(given, -1, axis=0) - given).T).sum())


def mean_spacing_m(length_m: float, n_vertices: float) -> float:
    """Mean distance of the vertices of a closed outline, m; InputError if an argument is not above 0."""
    return positive("length", length_m, "m") / positive("number of vertices", n_vertices, "vertices")


def pixel_area_m2(n_pixels: float, pixel_m: float) -> float:
    """Area of a number (0 or more) of square pixels of a size above 0; InputError for other arguments."""
    return number("number of pixels", n_pixels, "pixels", least=0.0) * positive("pixel size", pixel_m, "m") ** 2


def pixel_area_sigma_m2(perimeter: float, pixel_m: float) -> float:
    """Standard deviation of a pixel-count area over random positions and orientations of the grid, m2.

    Raises InputError if an argument is not above 0.
    """
    length, size = positive("perimeter", perimeter, "m"), positive("pixel size", pixel_m, "m")
    return float(np.sqrt(PIXEL_VARIANCE * length * size**3))


def count_pixels(vertices: npt.ArrayLike, pixel_m: float, offset_m: npt.ArrayLike = (0.0, 0.0)) -> int:
    """Number of pixels whose centres lie inside an outline.

    Parameters
    ----------
    vertices : (n, 2) array_like
        m.
    pixel_m : float
    offset_m : (2,) array_like
        Centre of any pixel.

    Raises
    ------
    InputError
        No outline, or a pixel size that is not above 0.
    """
    size, offset = positive("pixel size", pixel_m, "m"), finite("offset", offset_m)
    if offset.shape != (2,):
        raise InputError.of("rectify.numbers", place="offset", value=f"shape {offset.shape}")
    p = (outline(vertices) - offset) / size  # centres are whole numbers
    q = np.roll(p, -1, axis=0)
    q, p = np.where(q[:, 1:] < p[:, 1:], p, q), np.where(q[:, 1:] < p[:, 1:], q, p)  # every edge upwards
    first, last = np.ceil(p[:, 1]).astype(int), np.ceil(q[:, 1]).astype(int)  # rows crossed: first <= row < last
    edge = np.repeat(np.arange(len(p)), last - first)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[edge]
    slope = (q[edge, 0] - p[edge, 0]) / (q[edge, 1] - p[edge, 1])
    crossing = p[edge, 0] + (row - p[edge, 1]) * slope
    order = np.lexsort((crossing, row))
    columns = np.ceil(crossing[order]).astype(int)
    return int(np.sum(columns[1::2] - columns[::2]))
