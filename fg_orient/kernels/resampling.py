"""Resampling of rasters: position of a map pixel in the image, and the grey value there.

Pixels are (line, sample) or (row, column), (0, 0) = centre of the first pixel. Nodata is nan. The kernel of cubic
convolution is eq. 4 of Keys (1981) with his a = -1/2, and with a = -1 of Simon (1975) and Rifman (1973).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Array, compiled, inlined
from factors.records import Record

NEAREST, BILINEAR, CUBIC = 0, 1, 2
#: Numbers of a knot: DEM row and column; line and sample as c0 + c1 t + c2 t^2 of the scaled height t.
KNOT = Record(row=1, column=1, line="line_0 line_1 line_2", sample="sample_0 sample_1 sample_2")
SCALING = Record(offset=1, scale=1)
#: Part of a raster of heights: its first row and column.
PART = Record(row=1, column=1)
LIMITS = Record(first_line=1, last_line=1, first_sample=1, last_sample=1)
#: Largest distance, in pixels, of values that a kernel uses.
REACH = 2


@inlined
def surface_height(heights: Any, row: float, column: float) -> Any:
    """Return the height of a raster at one place, bilinear between centres; nan outside or next to nodata."""
    rows, columns = heights.shape
    if not (0.0 <= row <= rows - 1.0 and 0.0 <= column <= columns - 1.0):
        return np.nan
    i, j = min(int(row), rows - 2), min(int(column), columns - 2)
    u, v = row - i, column - j
    above = heights[i, j] * (1.0 - v) + heights[i, j + 1] * v
    below = heights[i + 1, j] * (1.0 - v) + heights[i + 1, j + 1] * v
    return above * (1.0 - u) + below * u


@compiled
def pixel_positions(
    first_row: int,
    first_column: int,
    step: int,
    knots: Array,
    heights: Array,
    part: Array,
    scaling: Array,
    limits: Array,
    line: Array,
    sample: Array,
) -> tuple[int, int, int]:
    """Fill line and sample (R, C) of the map pixels of a window; nan if there is no height or no image.

    Parameters
    ----------
    first_row, first_column : int
        First pixel of the window in the map.
    step : int
        Map pixels between two knots, for rows and columns; the first knot is map pixel (0, 0).
    knots : (M, N, 8) array
        Numbers ``KNOT`` of each knot, interpolated bilinearly.
    heights : (P, Q) array
        DEM, m: all its cells that the window needs.
    part : (2,) array
        First row and column of ``heights`` in the DEM, ``PART``.
    scaling : (2,) array
        Offset and scale of the height, ``SCALING``: t = (height - offset) / scale.
    limits : (4,) array
        First and last line, first and last sample of the image: ``LIMITS``.
    line, sample : (R, C) arrays
        Results.

    Returns
    -------
    tuple of int
        Number of pixels that lie inside the DEM without a height but in the image at t = 0; row and column of the
        first.
    """
    holes, hole_row, hole_column = 0, -1, -1
    a, b, k = np.empty(KNOT.size), np.empty(KNOT.size), np.empty(KNOT.size)
    for r in range(line.shape[0]):
        i, u = (first_row + r) // step, ((first_row + r) % step) / step
        cell = -1
        for c in range(line.shape[1]):
            j, v = (first_column + c) // step, ((first_column + c) % step) / step
            if j != cell:
                cell = j
                for m in range(KNOT.size):
                    a[m] = knots[i, j, m] * (1.0 - u) + knots[i + 1, j, m] * u
                    b[m] = knots[i, j + 1, m] * (1.0 - u) + knots[i + 1, j + 1, m] * u
            for m in range(KNOT.size):
                k[m] = a[m] * (1.0 - v) + b[m] * v
            # part is a whole number, so the difference is exact
            row, column = k[KNOT.row] - part[PART.row], k[KNOT.column] - part[PART.column]
            h = surface_height(heights, row, column)
            t = 0.0 if np.isnan(h) else (h - scaling[SCALING.offset]) / scaling[SCALING.scale]
            x = k[KNOT.line_0] + t * (k[KNOT.line_1] + t * k[KNOT.line_2])
            y = k[KNOT.sample_0] + t * (k[KNOT.sample_1] + t * k[KNOT.sample_2])
            inside = limits[LIMITS.first_line] <= x <= limits[LIMITS.last_line]
            inside = inside and limits[LIMITS.first_sample] <= y <= limits[LIMITS.last_sample]
            if np.isnan(h):
                covered = 0.0 <= row <= heights.shape[0] - 1.0
                covered = covered and 0.0 <= column <= heights.shape[1] - 1.0
                if covered and inside:
                    holes += 1
                    if hole_row < 0:
                        hole_row, hole_column = first_row + r, first_column + c
                inside = False
            line[r, c] = x if inside else np.nan
            sample[r, c] = y if inside else np.nan
    return holes, hole_row, hole_column


@inlined
def _weights(kind: int, a: float, x: float, w: Any) -> int:
    """Write the weights of the pixels near a place, and return the first pixel minus the pixel before the place.

    ``x``, 0 to 1, is the distance of the place from that pixel.
    """
    if kind == NEAREST:
        w[0] = 1.0
        return 1 if x >= 0.5 else 0
    if kind == BILINEAR:
        w[0], w[1] = 1.0 - x, x
        return 0
    y = 1.0 - x
    w[0] = a * x * y * y
    w[1] = 1.0 + x * x * ((a + 2.0) * x - (a + 3.0))
    w[2] = 1.0 + y * y * ((a + 2.0) * y - (a + 3.0))
    w[3] = a * y * x * x
    return -1


@compiled
def resample(
    image: Array, first_line: int, first_sample: int, line: Array, sample: Array, kind: int, a: float, out: Array
) -> int:
    """Fill grey values (R, C) at the places; nan if the place is nan, or a pixel with a nonzero weight is nan.

    Parameters
    ----------
    image : (P, Q) array
        Window of the image; its border pixels are repeated outside.
    first_line, first_sample : int
        First pixel of the window in the image.
    line, sample : (R, C) arrays
    kind : int
        NEAREST, BILINEAR or CUBIC.
    a : float
        Slope of the cubic kernel at distance 1.
    out : (R, C) array
        Result.

    Returns
    -------
    int
        Number of places that have a value.
    """
    taps = 1 if kind == NEAREST else 2 if kind == BILINEAR else 4
    rows, columns, n = image.shape[0], image.shape[1], 0
    wl, ws = np.empty(4), np.empty(4)
    for r in range(line.shape[0]):
        for c in range(line.shape[1]):
            if np.isnan(line[r, c]):
                out[r, c] = np.nan
                continue
            i, j = int(np.floor(line[r, c])), int(np.floor(sample[r, c]))
            p = i - first_line + _weights(kind, a, line[r, c] - i, wl)
            q = j - first_sample + _weights(kind, a, sample[r, c] - j, ws)
            total = 0.0
            for m in range(taps):
                if wl[m] != 0.0:
                    y = min(max(p + m, 0), rows - 1)
                    across = 0.0
                    for k in range(taps):
                        if ws[k] != 0.0:
                            across += ws[k] * image[y, min(max(q + k, 0), columns - 1)]
                    total += wl[m] * across
            out[r, c] = total
            n += 0 if np.isnan(total) else 1
    return n
