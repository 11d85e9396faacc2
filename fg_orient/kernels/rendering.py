"""Rendering of a synthetic image: rays of pixel corners meet a DEM, and the ground texture is averaged over each pixel.

The map coordinates of a ray are polynomials of the height (only map projection and Earth curvature bend it).
The ray is followed from the highest DEM value downwards, in steps of half a cell, to its first intersection
with the bilinear surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Array, compiled, inlined
from factors.records import Record
from fg_orient.kernels.resampling import SCALING, surface_height

#: Numbers of a knot: DEM row and column as c0 + c1 t + c2 t^2 of the scaled height t in [-1, 1].
RAY = Record(row="row_0 row_1 row_2", column="column_0 column_1 column_2")
#: Centre of the first DEM cell, and size of a cell, m.
TO_MAP = Record(x=1, y=1, cell=1)
#: Radii of a target, m.
RADII = Record(disc=1, ring=1)
#: Lines and samples between knots.
STEP = Record(line=1, sample=1)
#: Position in the DEM.
CELL = Record(row=1, column=1)
#: Number of halvings of the step that crosses the surface: from half a cell of 30 m to 0.01 mm.
HALVINGS = 21
#: Number of texture samples along each side of a pixel.
SAMPLES = 4
#: Grey values of the disc, the ring around it, and the ground.
DISC, RING, GROUND = 240.0, 15.0, 110.0
#: Edge lengths (m) and amplitudes of the two scales of the ground's texture.
EDGES_M, AMPLITUDES = (130.0, 17.0), (45.0, 30.0)


@inlined
def _noise(i: int, j: int) -> float:
    """Return the pseudo-random number in [-1, 1] of a knot of the texture (mixing as in MurmurHash3's finalizer)."""
    h = (np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F))
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return float((h ^ (h >> np.uint64(33))) >> np.uint64(40)) / 8388607.5 - 1.0


@compiled
def ground_grey(x: float, y: float) -> float:
    """Return the grey value of the ground at map coordinates (m): smooth random relief of two sizes."""
    grey = GROUND
    for k in range(2):
        edge = EDGES_M[k]
        u, v = x / edge, y / edge
        i, j = int(np.floor(u)), int(np.floor(v))
        u, v = u - i, v - j
        u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
        low = _noise(i, j) * (1.0 - u) + _noise(i + 1, j) * u
        high = _noise(i, j + 1) * (1.0 - u) + _noise(i + 1, j + 1) * u
        grey += AMPLITUDES[k] * (low * (1.0 - v) + high * v)
    return grey


@inlined
def _at(k: Any, t: float) -> Any:
    """Return the DEM row and column of a ray at the scaled height t."""
    row = k[RAY.row_0] + t * (k[RAY.row_1] + t * k[RAY.row_2])
    return row, k[RAY.column_0] + t * (k[RAY.column_1] + t * k[RAY.column_2])


@compiled
def _meet(k: Array, heights: Array, scaling: Array, out: Array) -> None:
    """Return DEM row and column where a ray first meets the surface; nan if it leaves the range of heights before."""
    rows, columns = 2.0 * k[RAY.row_1], 2.0 * k[RAY.column_1]  # length of the ray in the DEM, cells
    n = int(2.0 * np.sqrt(rows * rows + columns * columns)) + 2
    above, below = 1.0, np.nan
    for m in range(n + 1):
        t = 1.0 - 2.0 * m / n
        h = surface_height(heights, *_at(k, t))
        if np.isnan(h) or h >= scaling[SCALING.offset] + t * scaling[SCALING.scale]:
            below = np.nan if np.isnan(h) else t
            break
        above = t
    for _ in range(HALVINGS):
        t = 0.5 * (above + below)
        h = surface_height(heights, *_at(k, t))
        if h < scaling[SCALING.offset] + t * scaling[SCALING.scale]:
            above = t
        else:
            below = t
    t = 0.5 * (above + below)
    out[CELL.row], out[CELL.column] = _at(k, t)


@compiled
def corners(
    first_line: int, first_sample: int, step: Array, knots: Array, heights: Array, scaling: Array, out: Array
) -> None:
    """Fill ``out`` with DEM row and column where the rays of pixel corners meet the surface.

    Parameters
    ----------
    first_line, first_sample : int
        First pixel; its first corner lies half a pixel before its centre.
    step : (2,) array
        Lines and samples between knots; the first knot is the outer corner of pixel (0, 0).
    knots : (M, N, 6) array
        Numbers ``RAY`` of each knot, interpolated bilinearly.
    heights : (P, Q) array
        DEM, m.
    scaling : (2,) array
        ``SCALING`` of t = (height - offset) / scale; no height is above t = 1.
    out : (R + 1, C + 1, 2) array
        Result.
    """
    k = np.empty(RAY.size)
    for r in range(out.shape[0]):
        u = (first_line + r) / step[STEP.line]
        i = min(int(u), knots.shape[0] - 2)
        u -= i
        for c in range(out.shape[1]):
            v = (first_sample + c) / step[STEP.sample]
            j = min(int(v), knots.shape[1] - 2)
            v -= j
            for m in range(RAY.size):
                a = knots[i, j, m] * (1.0 - u) + knots[i + 1, j, m] * u
                k[m] = a * (1.0 - v) + (knots[i, j + 1, m] * (1.0 - u) + knots[i + 1, j + 1, m] * u) * v
            _meet(k, heights, scaling, out[r, c])


@inlined
def _grey(x: float, y: float, targets: Any, near: Any, n: int, disc: float, ring: float) -> float:
    for m in range(n):
        dx, dy = x - targets[near[m], 0], y - targets[near[m], 1]
        square = dx * dx + dy * dy
        if square < disc * disc:
            return DISC
        if square < ring * ring:
            return RING
    return ground_grey(x, y)


@inlined
def _between(p: Any, q: Any, s: Any, t: Any, axis: int, u: float, v: float) -> Any:
    """Return the coordinate interpolated bilinearly between four corners."""
    return (p[axis] * (1.0 - v) + q[axis] * v) * (1.0 - u) + (s[axis] * (1.0 - v) + t[axis] * v) * u


@compiled
def expose(corner: Array, to_map: Array, targets: Array, radii: Array, out: Any) -> None:
    """Fill grey values (R, C), 1 to 254, each the mean of 4 x 4 places in its pixel; 0 if a corner has no ground point.

    Parameters
    ----------
    corner : (R + 1, C + 1, 2) array
        DEM row and column of pixel corners.
    to_map : (3,) array
        ``TO_MAP``: centres of DEM cells are x = x_0 + column cell, y = y_0 - row cell.
    targets : (T, 2) array
        Map coordinates of the targets' centres.
    radii : (2,) array
        ``RADII``: radii of the disc and of the ring around it, m.
    out : (R, C) uint8 array
        Result.
    """
    near, cell = np.empty(len(targets), np.int64), to_map[TO_MAP.cell]
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            p, q, s, t = corner[r, c], corner[r, c + 1], corner[r + 1, c], corner[r + 1, c + 1]
            if np.isnan(p[CELL.row] + q[CELL.row] + s[CELL.row] + t[CELL.row]):
                out[r, c] = 0
                continue
            x0, y0 = to_map[TO_MAP.x] + p[CELL.column] * cell, to_map[TO_MAP.y] - p[CELL.row] * cell
            spread = abs(t[CELL.row] - p[CELL.row]) + abs(t[CELL.column] - p[CELL.column])
            spread = spread + abs(q[CELL.row] - s[CELL.row]) + abs(q[CELL.column] - s[CELL.column])
            reach = radii[RADII.ring] + cell * spread
            n = 0
            for m in range(len(targets)):
                if abs(targets[m, 0] - x0) < reach and abs(targets[m, 1] - y0) < reach:
                    near[n] = m
                    n += 1
            total = 0.0
            for a in range(SAMPLES):
                u = (a + 0.5) / SAMPLES
                for b in range(SAMPLES):
                    v = (b + 0.5) / SAMPLES
                    row = _between(p, q, s, t, CELL.row, u, v)
                    column = _between(p, q, s, t, CELL.column, u, v)
                    x, y = to_map[TO_MAP.x] + column * cell, to_map[TO_MAP.y] - row * cell
                    total += _grey(x, y, targets, near, n, radii[RADII.disc], radii[RADII.ring])
            out[r, c] = np.uint8(min(max(total / SAMPLES**2, 1.0), 254.0) + 0.5)
