"""Elimination of ground points, and computation of their steps from the steps of the images.

The image points of a ground point have the whitened Jacobians J (image) and G (ground). The block of the ground point
is ``H = sum G^T G + W^T W``; ``damping`` is the share by which its diagonal is increased. ``H^-1 = R^T R``, where R is
the inverse Cholesky factor, lower triangular. A solution x of the reduced system gives the point's step
``-H^-1 (g + sum G^T J x)``. For the arrays see ``fg_orient.kernels.batch``.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.conditions.control import POINT
from factors.records import Record
from fg_orient.kernels.batch_rows import Flags, Index, Small
from fg_orient.kernels.vectors import row_along

Block = tuple[float, float, float, float, float, float]  # elements of the lower triangle in the order 00 10 11 20 21 22
Gradient = tuple[float, float, float]

#: Names of fields: the lower triangle R of a ground point; for each ray, both rows of Z = G R^T and the
#: residuals reduced by the point.
ROOT: Final = Record(r00=1, r10=1, r11=1, r20=1, r21=1, r22=1)
SCALED: Final = Record(line="x0 x1 x2", sample="y0 y1 y2", residuals="r_line r_sample")
ZERO_BLOCK: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO_GRADIENT: Final = (0.0, 0.0, 0.0)
#: A point is undetermined if a pivot is smaller than this fraction of its diagonal element.
SINGULAR = 1e-14


@threaded
def point_blocks(
    lo: int,
    hi: int,
    first: Small,
    number: Small,
    free: Flags,
    control: Array,
    ground: Array,
    damping: float,
    base: int,
    value: Array,
    d_ground: Array,
    root: Array,
    gradient: Array,
    scaled: Array,
) -> int:
    """Write R (P, 6) as ``ROOT`` and the gradient (P, 3); for each ray Z = G R^T and reduced residuals, ``SCALED``.

    Parameters
    ----------
    first : (P + 1,) int array
        First observation of each point.
    number : (P,) int array
        Row of the point in ``control`` and ``ground``.
    free : (P,) int array
        0 for a constant, 1 for an unknown, 2 for an unknown that has a control-point equation.
    control : (N, 12) array
        Records of observed points, ``factors.conditions.control.POINT``.
    base : int
        Number of the observation in row 0 of ``value`` (n, 2), ``d_ground`` (n, 2, 3), ``scaled`` (n, 8: Z,
        ``residual - Z R g``).

    Returns
    -------
    int
        The first undetermined point, or -1.
    """
    bad = -1
    for p in range(lo, hi):
        h, g, found = ZERO_BLOCK, ZERO_GRADIENT, ZERO_BLOCK
        if free[p] > 0:
            if free[p] == 2:
                h, g = _with_control(control, ground, number[p], h, g)
            for a in range(first[p] - base, first[p + 1] - base):
                for r in range(2):
                    h, g = _with(h, g, d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2], value[a, r])
            more = 1.0 + damping
            regular, found = _inverse_root((h[0] * more, h[1], h[2] * more, h[3], h[4], h[5] * more))
            bad = p if bad < 0 and not regular else bad
        r0, r1, r2, r3, r4, r5 = found
        root[p, ROOT.r00], root[p, ROOT.r10], root[p, ROOT.r11] = r0, r1, r2
        root[p, ROOT.r20], root[p, ROOT.r21], root[p, ROOT.r22] = r3, r4, r5
        gradient[p, 0], gradient[p, 1], gradient[p, 2] = g
        u0, u1, u2 = r0 * g[0], r1 * g[0] + r2 * g[1], r3 * g[0] + r4 * g[1] + r5 * g[2]
        for a in range(first[p] - base, first[p + 1] - base):
            for r in range(2):
                x, y, z = d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2]
                z0, z1, z2 = r0 * x, r1 * x + r2 * y, r3 * x + r4 * y + r5 * z
                if r == 0:
                    scaled[a, SCALED.x0], scaled[a, SCALED.x1], scaled[a, SCALED.x2] = z0, z1, z2
                else:
                    scaled[a, SCALED.y0], scaled[a, SCALED.y1], scaled[a, SCALED.y2] = z0, z1, z2
                scaled[a, SCALED.residuals.start + r] = value[a, r] - (u0 * z0 + u1 * z1 + u2 * z2)
    return bad


@threaded
def _with_control(control: Array, ground: Array, j: int, h: Block, g: Gradient) -> tuple[Block, Gradient]:
    """Return block and gradient including the three equations of a control point."""
    x, y = ground[j, 0] - control[j, POINT.x], ground[j, 1] - control[j, POINT.y]
    z = ground[j, 2] - control[j, POINT.z]
    for w0, w1, w2 in (
        (control[j, POINT.w11], control[j, POINT.w12], control[j, POINT.w13]),
        (control[j, POINT.w21], control[j, POINT.w22], control[j, POINT.w23]),
        (control[j, POINT.w31], control[j, POINT.w32], control[j, POINT.w33]),
    ):
        h, g = _with(h, g, w0, w1, w2, w0 * x + w1 * y + w2 * z)
    return h, g


@threaded
def _with(h: Block, g: Gradient, x: float, y: float, z: float, residual: float) -> tuple[Block, Gradient]:
    """Return block and gradient after adding one equation."""
    return (
        (h[0] + x * x, h[1] + y * x, h[2] + y * y, h[3] + z * x, h[4] + z * y, h[5] + z * z),
        (g[0] + x * residual, g[1] + y * residual, g[2] + z * residual),
    )


@threaded
def _inverse_root(h: Block) -> tuple[bool, Block]:
    """Return the inverse Cholesky factor of a lower triangle, and True; zeros and False if it is singular."""
    if not h[0] > 0.0:
        return False, ZERO_BLOCK
    l00 = math.sqrt(h[0])
    l10, l20 = h[1] / l00, h[3] / l00
    d1 = h[2] - l10 * l10
    if not d1 > SINGULAR * h[2]:
        return False, ZERO_BLOCK
    l11 = math.sqrt(d1)
    l21 = (h[4] - l20 * l10) / l11
    d2 = h[5] - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * h[5]:
        return False, ZERO_BLOCK
    r00, r11, r22 = 1.0 / l00, 1.0 / l11, 1.0 / math.sqrt(d2)
    r20 = -(l20 * r00 - l21 * l10 * r00 * r11) * r22
    return True, (r00, -l10 * r00 * r11, r11, r20, -l21 * r11 * r22, r22)


#: Number of rays for which memory is reserved; more is allocated if a point has more rays.
MOST_RAYS = 64


@threaded
def _along(
    a: int, base: int, d_image: Array, basis: Array, i: int, wide: Array, n_basis: int, n_components: int
) -> tuple[float, float]:
    """Return the product of the image Jacobian of observation a with the wide unknowns of image i."""
    if n_basis == 3 and n_components == 9 and d_image.shape[2] == 9:
        return row_along(d_image, 18 * (a - base), basis, a * basis.shape[1], wide, i * wide.shape[1])
    y0, y1 = 0.0, 0.0
    for c in range(n_components):
        x = 0.0
        for b in range(n_basis):
            x += basis[a, b] * wide[i, b * n_components + c]
        y0 += d_image[a - base, 0, c] * x
        y1 += d_image[a - base, 1, c] * x
    return y0, y1


@threaded
def back_substitute(
    lo: int,
    hi: int,
    places: Small,
    first: Small,
    image: Small,
    n_basis: Index,
    n_components: Index,
    basis: Array,
    wide: Array,
    base: int,
    value: Array,
    d_image: Array,
    d_ground: Array,
    root: Array,
    gradient: Array,
    step: Array,
    squares: Array,
) -> None:
    """Write the steps (P, 3) of the points of chunks lo to hi, and the sums of squared linear residuals.

    ``places`` (N + 1,) gives the first point of each chunk; ``squares`` is (N,). For the other parameters see
    :func:`point_blocks`.
    """
    along = np.empty((MOST_RAYS, 2))
    for n in range(lo, hi):
        total = 0.0
        for p in range(places[n], places[n + 1]):
            t0, t1, t2 = gradient[p, 0], gradient[p, 1], gradient[p, 2]
            if first[p + 1] - first[p] > len(along):
                along = np.empty((first[p + 1] - first[p], 2))
            for a in range(first[p], first[p + 1]):
                k, i = a - base, image[a]
                y0, y1 = _along(a, base, d_image, basis, i, wide, n_basis[i], n_components[i])
                along[a - first[p], 0], along[a - first[p], 1] = y0, y1
                t0 += d_ground[k, 0, 0] * y0 + d_ground[k, 1, 0] * y1
                t1 += d_ground[k, 0, 1] * y0 + d_ground[k, 1, 1] * y1
                t2 += d_ground[k, 0, 2] * y0 + d_ground[k, 1, 2] * y1
            x0, x1, x2 = _newton(root, p, t0, t1, t2)
            step[p, 0], step[p, 1], step[p, 2] = x0, x1, x2
            for a in range(first[p], first[p + 1]):
                k = a - base
                for r in range(2):
                    after = value[k, r] + along[a - first[p], r]
                    after += d_ground[k, r, 0] * x0 + d_ground[k, r, 1] * x1 + d_ground[k, r, 2] * x2
                    total += after * after
        squares[n] = total


@threaded
def reduced_product(
    lo: int,
    hi: int,
    cuts: Index,
    first: Small,
    image: Small,
    n_basis: Index,
    n_components: Index,
    basis: Array,
    wide: Array,
    d_image: Array,
    d_ground: Array,
    root: Array,
    out: Array,
) -> None:
    """Write the products of the reduced matrix, from shares lo to hi of the points, with unknowns of the images.

    The product ``J^T (J x - G H^-1 sum G^T J x)`` is computed without forming the matrix. The whole product is the sum
    of all shares.

    Parameters
    ----------
    cuts : (N + 1,) int array
        First point of each share.
    wide : (M, w) array
    d_image, d_ground : (n, 2, c), (n, 2, 3) arrays
        Jacobians of all image points.
    out : (N, M, w) array
    """
    along = np.empty((MOST_RAYS, 2))
    for n in range(lo, hi):
        out[n] = 0.0
        for p in range(cuts[n], cuts[n + 1]):
            t0, t1, t2, start, end = 0.0, 0.0, 0.0, first[p], first[p + 1]
            if end - start > len(along):
                along = np.empty((end - start, 2))
            for a in range(start, end):
                i = image[a]
                y0, y1 = _along(a, 0, d_image, basis, i, wide, n_basis[i], n_components[i])
                along[a - start, 0], along[a - start, 1] = y0, y1
                t0 += d_ground[a, 0, 0] * y0 + d_ground[a, 1, 0] * y1
                t1 += d_ground[a, 0, 1] * y0 + d_ground[a, 1, 1] * y1
                t2 += d_ground[a, 0, 2] * y0 + d_ground[a, 1, 2] * y1
            x0, x1, x2 = _newton(root, p, t0, t1, t2)
            for a in range(start, end):
                i = image[a]
                y0 = along[a - start, 0] + d_ground[a, 0, 0] * x0 + d_ground[a, 0, 1] * x1 + d_ground[a, 0, 2] * x2
                y1 = along[a - start, 1] + d_ground[a, 1, 0] * x0 + d_ground[a, 1, 1] * x1 + d_ground[a, 1, 2] * x2
                for b in range(n_basis[i]):
                    at, z0, z1 = b * n_components[i], basis[a, b] * y0, basis[a, b] * y1
                    for c in range(n_components[i]):
                        out[n, i, at + c] += d_image[a, 0, c] * z0 + d_image[a, 1, c] * z1


@threaded
def _newton(root: Array, p: int, t0: float, t1: float, t2: float) -> Gradient:
    """Return the product of a point's ``-H^-1`` with a vector."""
    r0, r1, r2 = root[p, ROOT.r00], root[p, ROOT.r10], root[p, ROOT.r11]
    r3, r4, r5 = root[p, ROOT.r20], root[p, ROOT.r21], root[p, ROOT.r22]
    u0, u1, u2 = r0 * t0, r1 * t0 + r2 * t1, r3 * t0 + r4 * t1 + r5 * t2
    return -(r0 * u0 + r1 * u1 + r3 * u2), -(r2 * u1 + r4 * u2), -r5 * u2


@threaded
def product(
    lo: int,
    hi: int,
    places: Small,
    first: Small,
    free: Flags,
    image: Small,
    n_basis: Index,
    n_components: Index,
    basis: Array,
    wide: Array,
    base: int,
    share: float,
    value: Array,
    d_image: Array,
    d_ground: Array,
    step: Array,
    squares: Array,
) -> None:
    """Sum for each chunk the squares of ``share`` times the residuals, plus the Jacobian times a given step.

    ``wide`` is the step of the images, ``step`` (P, 3) the step of the points. For the other parameters see
    :func:`back_substitute`.
    """
    for n in range(lo, hi):
        total = 0.0
        for p in range(places[n], places[n + 1]):
            moves = 1.0 if free[p] > 0 else 0.0
            x0, x1, x2 = moves * step[p, 0], moves * step[p, 1], moves * step[p, 2]
            for a in range(first[p], first[p + 1]):
                k, i = a - base, image[a]
                y = _along(a, base, d_image, basis, i, wide, n_basis[i], n_components[i])
                for r in range(2):
                    after = share * value[k, r] + y[r]
                    after += d_ground[k, r, 0] * x0 + d_ground[k, r, 1] * x1 + d_ground[k, r, 2] * x2
                    total += after * after
        squares[n] = total


@threaded
def scale_rows(lo: int, hi: int, root: Array, value: Array, d_image: Array, d_ground: Array) -> None:
    """Apply weights: multiply the rows of image points lo to hi by ``root`` (n,)."""
    for a in range(lo, hi):
        factor = root[a]
        for r in range(2):
            value[a, r] *= factor
            for k in range(3):
                d_ground[a, r, k] *= factor
            for c in range(d_image.shape[2]):
                d_image[a, r, c] *= factor


@threaded
def control_squares(ground: Array, control: Array, observed: Index, out: Array) -> None:
    """Write the squared norms (m,) of the whitened residuals of observed ground points.

    Parameters
    ----------
    ground : (N, 3) array
    control : (N, 12) array
        Records of observed points, ``factors.conditions.control.POINT``.
    observed : (m,) int array
        Row of each observed point in both arrays.
    """
    for k in range(len(observed)):
        j = observed[k]
        x, y = ground[j, 0] - control[j, POINT.x], ground[j, 1] - control[j, POINT.y]
        z = ground[j, 2] - control[j, POINT.z]
        r1 = control[j, POINT.w11] * x + control[j, POINT.w12] * y + control[j, POINT.w13] * z
        r2 = control[j, POINT.w21] * x + control[j, POINT.w22] * y + control[j, POINT.w23] * z
        r3 = control[j, POINT.w31] * x + control[j, POINT.w32] * y + control[j, POINT.w33] * z
        out[k] = r1 * r1 + r2 * r2 + r3 * r3


@threaded
def move(number: Small, step: Array, ground: Array) -> None:
    """Add steps (P, 3) to the ground points (N, 3) with the numbers (P,)."""
    for p in range(len(number)):
        for k in range(3):
            ground[number[p], k] += step[p, k]


def newton_steps(root: Array, gradient: Array) -> Array:
    """Return the Newton steps (n, 3) ``-R^T R g`` of points while the images are held fixed."""
    r, (g0, g1, g2) = root.T, gradient.T
    u0, u1 = r[ROOT.r00] * g0, r[ROOT.r10] * g0 + r[ROOT.r11] * g1
    u2 = r[ROOT.r20] * g0 + r[ROOT.r21] * g1 + r[ROOT.r22] * g2
    out = np.empty((len(gradient), 3))
    out[:, 0] = -(r[ROOT.r00] * u0 + r[ROOT.r10] * u1 + r[ROOT.r20] * u2)
    out[:, 1] = -(r[ROOT.r11] * u1 + r[ROOT.r21] * u2)
    out[:, 2] = -r[ROOT.r22] * u2
    return out


def decreases(root: Array, gradient: Array) -> Array:
    """Return the squares (n,) of R g of points: twice the decrease predicted for a Newton step."""
    r, (g0, g1, g2) = root.T, gradient.T
    u2 = r[ROOT.r20] * g0 + r[ROOT.r21] * g1 + r[ROOT.r22] * g2
    return np.asarray((r[ROOT.r00] * g0) ** 2 + (r[ROOT.r10] * g0 + r[ROOT.r11] * g1) ** 2 + u2**2)
