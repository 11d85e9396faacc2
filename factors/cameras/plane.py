"""Transformations determined by points: between planes, and from the ground to line-scanner images without orientation.

    plane_polynomial     U = sum a_jk x^j y^k, V alike                                          (İpbüker 1994)
    plane_helmert        U = c + a x - b y,  V = d + b x + a y
    plane_projective     U = (a0 + a1 x + a2 y)/(1 + c1 x + c2 y),  V = (b0 + b1 x + b2 y)/(the same)
    affine_projection    U = a0 + a1 x + a2 y + a3 z,  V = q = b0 + b1 x + b2 y + b3 z
    parallel_projection  U as affine,  V = q/(1 + t q)
    line_scanner_dlt     U as affine,  V = q/(1 + c1 x + c2 y + c3 z)

The source x, y, z is a plane, or the ground in a plane coordinate system; the target U, V is another plane,
or line and sample. A line scanner is a central projection only along its lines: the line is affine in the
ground coordinates. The residual is ``W (computed - given)`` with the upper triangle w11, w12, w22; it
has the sign of İpbüker 1994. Coordinates should be centred and scaled to about 1: with unreduced map
coordinates in metres, the normal equations of degrees 2 and 3 have no correct digit left. Such a
scaling does not change the form of these transformations, except for the polynomial.

The functions are plain numpy and accept one record (8,) or many (N, 8); nothing is compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, register
from factors.records import Record

RECORD: Final = Record(source="x y z", target="u v", w11=1, w12=1, w22=1)
#: Highest degree of the polynomial, as in İpbüker 1994.
MAX_DEGREE = 5
# Linear form: pairs of the place of an unknown and its factor. The factor is a number, or an array with one
# number per point.
_Form = list[tuple[int, Any]]
# Numerators of U and V, then denominators of U and V minus 1.
_Forms = tuple[_Form, _Form, _Form, _Form]


def polynomial_setup(degree: int) -> Array:
    """Return the exponents of x and y (2, p) in the order of İpbüker 1994, appendix EK 2: 1; y, x; y^2, xy, x^2; ..."""
    pairs = [(k, d - k) for d in range(degree + 1) for k in range(d + 1)]
    return np.ascontiguousarray(np.array(pairs, float).T)


def _linear(first: int, *factors: Any) -> _Form:
    """Return the form that starts with unknown ``first``."""
    return list(enumerate(factors, first))


def _power(base: Any, exponent: float) -> Any:
    out = 1.0
    for _ in range(int(exponent)):
        out = out * base
    return out


def value_of(form: _Form, c: Any, first: float = 0.0) -> Any:
    """Return ``first`` plus the sum of unknowns times factors."""
    total: Any = first
    for k, factor in form:
        total = total + c[k] * factor
    return total


def whitened(record: Any, u: Any, v: Any) -> Any:
    """Return ``W (computed - given)`` (..., 2) for a computed target u, v."""
    d_u, d_v = u - record[..., RECORD.u], v - record[..., RECORD.v]
    first = record[..., RECORD.w11] * d_u + record[..., RECORD.w12] * d_v
    return np.stack([first, record[..., RECORD.w22] * d_v], axis=-1)


def whiten_rows(record: Array, rows: Array) -> Array:
    """Multiply a Jacobian (..., 2, k) by W in place, and return it."""
    rows[..., 0, :] = record[..., [RECORD.w11]] * rows[..., 0, :] + record[..., [RECORD.w12]] * rows[..., 1, :]
    rows[..., 1, :] *= record[..., [RECORD.w22]]
    return rows


def _polynomial(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    terms = [_power(x, j) * _power(y, k) for j, k in setup.T]
    return _linear(0, *terms), _linear(len(terms), *terms), [], []


def _helmert(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    return [(0, 1.0), (2, x), (3, -y)], [(1, 1.0), (3, x), (2, y)], [], []


def _projective(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    below = _linear(6, x, y)
    return _linear(0, 1.0, x, y), _linear(3, 1.0, x, y), below, below


def _affine(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    return _linear(0, 1.0, x, y, z), _linear(4, 1.0, x, y, z), [], []


def _parallel(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    line, q = _linear(0, 1.0, x, y, z), _linear(4, 1.0, x, y, z)
    return line, q, [], [(8, value_of(q, c))]


def _line_scanner_dlt(x: Any, y: Any, z: Any, setup: Array, c: Any) -> _Forms:
    return _linear(0, 1.0, x, y, z), _linear(4, 1.0, x, y, z), [], _linear(8, x, y, z)


#: Forms of each transformation, by the name of its equation.
_FORMS: Final[dict[str, Callable[..., _Forms]]] = {
    "plane_polynomial": _polynomial, "plane_helmert": _helmert, "plane_projective": _projective,
    "affine_projection": _affine, "parallel_projection": _parallel, "line_scanner_dlt": _line_scanner_dlt,
}  # fmt: skip


def targets(name: str, source: Any, setup: Array, c: Any) -> tuple[Any, Any]:
    """Return target coordinates U, V (...,) of source coordinates (..., 3), by the transformation ``name``."""
    u, v, below_u, below_v = _FORMS[name](*np.moveaxis(source, -1, 0), setup, c)
    return value_of(u, c) / value_of(below_u, c, 1.0), value_of(v, c) / value_of(below_v, c, 1.0)


def _rows(name: str, source: Array, setup: Array, c: Array) -> Array:
    """Return the derivatives (..., 2, k) of the targets by the unknowns."""
    u, v, below_u, below_v = _FORMS[name](*np.moveaxis(source, -1, 0), setup, c)
    out = np.zeros((*source.shape[:-1], 2, len(c)))
    for row, (numerator, denominator) in enumerate(((u, below_u), (v, below_v))):
        g = 1.0 / value_of(denominator, c, 1.0)
        target = value_of(numerator, c) * g
        # the denominator of V of the parallel projection contains its numerator
        by_numerator = g * g if name == "parallel_projection" and row == 1 else g
        for k, factor in numerator:
            out[..., row, k] = factor * by_numerator
        for k, factor in denominator:
            out[..., row, k] = -target * factor * g
    return out


def _register(name: str, source: str, unit: str) -> Equation:
    """Register a transformation as an equation."""

    def residual(record: Any, setup: Any, c: Any) -> Any:
        return whitened(record, *targets(name, record[..., RECORD.source], setup, c))

    def kernel(record: Array, setup: Array, c: Array, want: bool) -> tuple[Array, Array]:
        rows = whiten_rows(record, _rows(name, record[..., RECORD.source], setup, c)) if want else np.empty((0, 0))
        return residual(record, setup, c), rows

    return register(Equation(name, kernel, residual, (Argument("coefficients", unit),), source, arrays=True))


POLYNOMIAL = _register("plane_polynomial", "İpbüker 1994, section 4.2.1 and appendix EK 2", "target unit")
HELMERT = _register(
    "plane_helmert", "İpbüker 1994, section 7.2 (names it; the equations are the usual ones)", "target unit"
)  # fmt: skip
PROJECTIVE = _register("plane_projective", "the homography of two planes, its last element 1", "target unit")
AFFINE_PROJECTION = _register("affine_projection", "Okamoto 1981; Fraser & Yamakawa 2004", "pixel")
PARALLEL_PROJECTION = _register(
    "parallel_projection", "Morgan 2004: parallel projection with the perspective-to-parallel term of the scan line",
    "pixel",
)  # fmt: skip
LINE_SCANNER_DLT = _register("line_scanner_dlt", "Gupta & Hartley 1997: the linear pushbroom camera", "pixel")
