"""Rational function model (RFM, RPC): value and derivatives in normalised coordinates.

    l = f1/f2,  s = f3/f4         (Terlemezoğlu 2019, eqs. 2.55-2.57; NIMA 2000, STDI-0002 RPC00B)

Here l, s are the normalised line and sample, and f are cubic polynomials of the
normalised longitude x, latitude y and height z, with 20 terms in RPC00B order.
Coefficients are converted between orders by exponent triple (longitude, latitude,
height), never by index. RPC00A is the order of older NITF files; T 2.54 is the published
order (with X = longitude, Y = latitude). ``c`` (4, 20) contains the coefficients of line
numerator, line denominator, sample numerator and sample denominator; both denominators
have the constant 1. The model has a pole where a denominator changes its sign. If the
numerator has nearly the same zeros, as in some vendors' files, values are correct on both
sides of the pole but not near it. The functions return these values unchanged;
``fg_orient.sensors.rpc`` looks for sign changes inside the image.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Array, compiled
from factors._plain import plain
from factors.records import Record

#: Terms in RPC00B order: products of longitude x, latitude y and height z.
T: Final = Record(terms="one x y z xy xz yz xx yy zz xyz xxx xyy xzz xxy yyy yzz xxz yyz zzz")
N_TERMS: Final = T.size


def _triples(words: str) -> tuple[tuple[int, int, int], ...]:
    return tuple((int(w[0]), int(w[1]), int(w[2])) for w in words.split())


#: Orders in which files and papers list the terms: for each name the exponents of
#: (longitude, latitude, height) of the terms.
EXPONENTS: Final[dict[str, tuple[tuple[int, int, int], ...]]] = {
    "RPC00B": _triples("000 100 010 001 110 101 011 200 020 002 111 300 120 102 210 030 012 201 021 003"),
    "RPC00A": _triples("000 100 010 001 110 101 011 111 200 020 002 300 210 201 120 030 021 102 012 003"),
    "T2.54": _triples("000 100 010 001 110 011 101 200 020 002 111 030 210 012 120 300 102 021 201 003"),
}


@compiled
def cubic(c: Any, k: int, x: Any, y: Any, z: Any) -> Any:
    """Return polynomial ``k`` of ``c`` at one normalised ground point, in nested form."""
    return (
        c[k, T.one]
        + x * (c[k, T.x] + x * (c[k, T.xx] + x * c[k, T.xxx] + y * c[k, T.xxy] + z * c[k, T.xxz])
               + y * (c[k, T.xy] + y * c[k, T.xyy] + z * c[k, T.xyz]) + z * (c[k, T.xz] + z * c[k, T.xzz]))
        + y * (c[k, T.y] + y * (c[k, T.yy] + y * c[k, T.yyy] + z * c[k, T.yyz]) + z * (c[k, T.yz] + z * c[k, T.yzz]))
        + z * (c[k, T.z] + z * (c[k, T.zz] + z * c[k, T.zzz]))
    )  # fmt: skip


@compiled
def d_cubic(c: Any, k: int, x: Any, y: Any, z: Any) -> Any:
    """Return the derivatives of :func:`cubic` with respect to x, y, z."""
    d_x = (c[k, T.x] + x * (2.0 * c[k, T.xx] + 3.0 * x * c[k, T.xxx] + 2.0 * (y * c[k, T.xxy] + z * c[k, T.xxz]))
           + y * (c[k, T.xy] + y * c[k, T.xyy] + z * c[k, T.xyz]) + z * (c[k, T.xz] + z * c[k, T.xzz]))  # fmt: skip
    d_y = (c[k, T.y] + y * (2.0 * c[k, T.yy] + 3.0 * y * c[k, T.yyy] + 2.0 * (z * c[k, T.yyz] + x * c[k, T.xyy]))
           + x * (c[k, T.xy] + x * c[k, T.xxy] + z * c[k, T.xyz]) + z * (c[k, T.yz] + z * c[k, T.yzz]))  # fmt: skip
    d_z = (c[k, T.z] + z * (2.0 * c[k, T.zz] + 3.0 * z * c[k, T.zzz] + 2.0 * (x * c[k, T.xzz] + y * c[k, T.yzz]))
           + x * (c[k, T.xz] + x * c[k, T.xxz] + y * c[k, T.xyz]) + y * (c[k, T.yz] + y * c[k, T.yyz]))  # fmt: skip
    return d_x, d_y, d_z


@compiled
def value(c: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the normalised line and sample of one point; not finite if a denominator is zero."""
    return cubic(c, 0, x, y, z) / cubic(c, 1, x, y, z), cubic(c, 2, x, y, z) / cubic(c, 3, x, y, z)


@compiled
def ground_derivatives(c: Any, x: float, y: float, z: float, l: float, s: float) -> Any:  # noqa: E741
    """Return the derivatives of (l, s) by x, y, z: two triples; ``l``, ``s`` are the values at the point."""
    d_l, d_s = cubic(c, 1, x, y, z), cubic(c, 3, x, y, z)
    a, b = d_cubic(c, 0, x, y, z), d_cubic(c, 1, x, y, z)
    e, f = d_cubic(c, 2, x, y, z), d_cubic(c, 3, x, y, z)
    return (
        ((a[0] - l * b[0]) / d_l, (a[1] - l * b[1]) / d_l, (a[2] - l * b[2]) / d_l),
        ((e[0] - s * f[0]) / d_s, (e[1] - s * f[1]) / d_s, (e[2] - s * f[2]) / d_s),
    )


def values(c: Array, ground: Array) -> Array:
    """Return normalised lines and samples (N, 2) from coefficients (4, 20) and normalised ground points (N, 3)."""
    return np.stack(plain(value)(c, *ground.T), axis=1)


def denominators(c: Array, ground: Array) -> Array:
    """Return both denominators at N normalised ground points: (N, 3) -> (N, 2)."""
    return np.stack([plain(cubic)(c, k, *ground.T) for k in (1, 3)], axis=1)


def permutation(source: str, target: str) -> npt.NDArray[np.intp]:
    """Return ``p`` (20,) with ``coefficients_target = coefficients_source[p]``.

    Raises
    ------
    KeyError
        An order is unknown.
    """
    position = {triple: k for k, triple in enumerate(EXPONENTS[source])}
    return np.array([position[triple] for triple in EXPONENTS[target]], dtype=np.intp)


def terms(ground: Array) -> Array:
    """Return the monomials of N normalised ground points in RPC00B order: (N, 3) -> (N, 20)."""
    power = np.asarray(ground, float)[:, :, None] ** np.arange(4)  # (N, 3, 4): computes each power once
    return np.ascontiguousarray(power[:, np.arange(3), np.array(EXPONENTS["RPC00B"])].prod(axis=2))
