"""An image rendered by rays: ground points of pixel corners on a DEM, and a texture of the ground averaged over pixels.

A ray is given by its map coordinates as polynomials of the height (bent by map projection and curvature alone). It is
followed from the highest DEM value down, in steps of half a cell, to its first meeting with the bilinear surface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Array, compiled, inlined
from factors.resampling import surface_height

#: Values of a knot: DEM row and column as c0 + c1 t + c2 t^2 of the scaled height t in [-1, 1].
RAY_SIZE = 6
#: Halvings of the step in which a ray meets the surface: half a cell of 30 m to 0.01 mm.
HALVINGS = 21
#: Texture samples along each side of a pixel.
SAMPLES = 4
#: Grey values: disc, ring about it, ground.
DISC, RING, GROUND = 240.0, 15.0, 110.0
#: Edges (m) and amplitudes of the two octaves of the ground's texture.
EDGES_M, AMPLITUDES = (130.0, 17.0), (45.0, 30.0)


@inlined
def _noise(i: int, j: int) -> float:
    """A number in [-1, 1] that belongs to a knot of the texture (mixing as in MurmurHash3's finalizer)."""
    h = (np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F))
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    h = (h ^ (h >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return float((h ^ (h >> np.uint64(33))) >> np.uint64(40)) / 8388607.5 - 1.0


@compiled
def ground_grey(x: float, y: float) -> float:
    """Grey value of the ground at map coordinates (m): smooth random relief of two sizes."""
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


@compiled
def _meet(k: Array, heights: Array, scaling: Array, out: Array) -> None:
    """DEM row and column where a ray first meets the surface; nan where it finds no height before."""
    rows, columns = 2.0 * k[1], 2.0 * k[4]  # cells that the ray passes
    n = int(2.0 * np.sqrt(rows * rows + columns * columns)) + 2
    above, below = 1.0, np.nan
    for m in range(n + 1):
        t = 1.0 - 2.0 * m / n
        h = surface_height(heights, k[0] + t * (k[1] + t * k[2]), k[3] + t * (k[4] + t * k[5]))
        if np.isnan(h) or h >= scaling[0] + t * scaling[1]:
            below = np.nan if np.isnan(h) else t
            break
        above = t
    for _ in range(HALVINGS):
        t = 0.5 * (above + below)
        h = surface_height(heights, k[0] + t * (k[1] + t * k[2]), k[3] + t * (k[4] + t * k[5]))
        if h < scaling[0] + t * scaling[1]:
            above = t
        else:
            below = t
    t = 0.5 * (above + below)
    out[0], out[1] = k[0] + t * (k[1] + t * k[2]), k[3] + t * (k[4] + t * k[5])


@compiled
def corners(first_line: int, first_sample: int, step: Array, knots: Array, heights: Array, scaling: Array,
            out: Array) -> None:  # fmt: skip
    """Fill DEM row and column (R + 1, C + 1, 2) where the rays of pixel corners meet the surface.

    Parameters
    ----------
    first_line, first_sample : int
        First pixel; its first corner lies at minus half a pixel.
    step : (2,) array
        Lines and samples between knots, the first knot at the outer corner of pixel (0, 0).
    knots : (M, N, 6) array
        See ``RAY_SIZE``; bilinear between knots.
    heights : (P, Q) array
        DEM, m.
    scaling : (2,) array
        t = (height - scaling[0]) / scaling[1]; t = 1 is not below any height.
    out : (R + 1, C + 1, 2) array
        Result.
    """
    k = np.empty(RAY_SIZE)
    for r in range(out.shape[0]):
        u = (first_line + r) / step[0]
        i = min(int(u), knots.shape[0] - 2)
        u -= i
        for c in range(out.shape[1]):
            v = (first_sample + c) / step[1]
            j = min(int(v), knots.shape[1] - 2)
            v -= j
            for m in range(RAY_SIZE):
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


@compiled
def expose(corner: Array, to_map: Array, targets: Array, radii: Array, out: Any) -> None:
    """Fill grey values (R, C), 1 to 254, each the mean of 4 x 4 places of its pixel; 0 where a corner saw no ground.

    Parameters
    ----------
    corner : (R + 1, C + 1, 2) array
        DEM row and column of pixel corners.
    to_map : (3,) array
        x = to_map[0] + column to_map[2], y = to_map[1] - row to_map[2]: centres of DEM cells.
    targets : (T, 2) array
        Map coordinates of the targets' centres.
    radii : (2,) array
        Of the disc and of the ring about it, m.
    out : (R, C) uint8 array
        Result.
    """
    near = np.empty(len(targets), np.int64)
    for r in range(out.shape[0]):
        for c in range(out.shape[1]):
            p, q, s, t = corner[r, c], corner[r, c + 1], corner[r + 1, c], corner[r + 1, c + 1]
            if np.isnan(p[0] + q[0] + s[0] + t[0]):
                out[r, c] = 0
                continue
            x0, y0 = to_map[0] + p[1] * to_map[2], to_map[1] - p[0] * to_map[2]
            reach = radii[1] + to_map[2] * (abs(t[0] - p[0]) + abs(t[1] - p[1]) + abs(q[0] - s[0]) + abs(q[1] - s[1]))
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
                    row = (p[0] * (1.0 - v) + q[0] * v) * (1.0 - u) + (s[0] * (1.0 - v) + t[0] * v) * u
                    column = (p[1] * (1.0 - v) + q[1] * v) * (1.0 - u) + (s[1] * (1.0 - v) + t[1] * v) * u
                    x, y = to_map[0] + column * to_map[2], to_map[1] - row * to_map[2]
                    total += _grey(x, y, targets, near, n, radii[0], radii[1])
            out[r, c] = np.uint8(min(max(total / SAMPLES**2, 1.0), 254.0) + 0.5)
