"""Areas and lengths of outlines, and areas counted in pixels (İpbüker 1994, section 7.2).

A pixel belongs to an outline if its centre lies inside. Over random positions and orientations of the grid the count is
unbiased, with a standard deviation of about ``sqrt(0.0728 L h^3)`` for a perimeter L and pixels of size h (Kendall's
problem of lattice points, for outlines without preferred direction).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive, whole

Array = npt.NDArray[np.float64]

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
    """Area of a polygon in a plane, ``|sum (x_i y_i+1 - x_i+1 y_i)|/2`` about its centre."""
    given = outline(vertices)
    x, y = (given - given.mean(axis=0)).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0)


def perimeter_m(vertices: npt.ArrayLike) -> float:
    """Sum of the chords of a closed outline, m."""
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


def simulate_pixel_areas_m2(
    vertices: npt.ArrayLike, pixel_m: float, n_placements: int, seed: int, *, turn: bool = True
) -> Array:
    """Pixel-count areas (n_placements,) on grids at random positions and, with ``turn``, orientations, m2.

    The formula of :func:`pixel_area_sigma_m2` holds for all orientations. With a single orientation the standard
    deviation for the coast of an island is 0.8 to 1.25 times that value.

    Raises
    ------
    InputError
        See :func:`count_pixels`; no placement, or a negative seed.
    """
    given, rng = outline(vertices), np.random.default_rng(whole("seed", seed, 0))
    positive("pixel size", pixel_m, "m")
    whole("placements", n_placements, 1)
    angles = rng.uniform(0.0, 2.0 * np.pi, n_placements) if turn else np.zeros(n_placements)
    offsets = rng.uniform(0.0, pixel_m, (n_placements, 2))
    turns = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    counts = [count_pixels(given @ r, pixel_m, o) for r, o in zip(turns, offsets, strict=True)]
    return np.array([pixel_area_m2(n, pixel_m) for n in counts])


def synthetic_outline(area_m2: float, perimeter: float, n_vertices: int, seed: int) -> Array:
    """Random coast (n_vertices, 2) of a given area and perimeter: a circle whose radius has random harmonics, m.

    Raises
    ------
    InputError
        An area that is not above 0, fewer than three vertices, a negative seed; a perimeter shorter than the circle of
        this area, or too long for such an outline.
    """
    positive("area", area_m2, "m2")
    positive("perimeter", perimeter, "m")
    whole("seed", seed, 0)
    whole("vertices", n_vertices, 3)
    rng, angle = np.random.default_rng(seed), np.linspace(0.0, 2.0 * np.pi, n_vertices, endpoint=False)
    order = np.arange(2, 24)
    waves = np.cos(np.outer(angle, order) + rng.uniform(0.0, 2.0 * np.pi, len(order))) @ (
        rng.normal(size=len(order)) / order
    )
    waves /= np.abs(waves).max()

    def shape(size: float) -> Array:
        plane = (1.0 + size * waves)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(plane * np.sqrt(area_m2 / planar_area_m2(plane)))

    low, high = 0.0, 0.95
    if not perimeter_m(shape(low)) < perimeter < perimeter_m(shape(high)):
        raise InputError.of("rectify.outline", place="perimeter", value=f"{perimeter:g} m")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if perimeter_m(shape(middle)) < perimeter else (low, middle)
    return shape(0.5 * (low + high))
