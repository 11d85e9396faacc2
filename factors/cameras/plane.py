"""Transformations between two planes: polynomial (affine if of degree 1), Helmert, projective.

An observation is a point in both planes: source coordinates x, y and a third that planes do not use, target
coordinates U, V, and the upper triangle w11, w12, w22 of the whitening matrix. The residual is
``W (computed - given)``, the sign of İpbüker 1994. Coordinates should be centred and scaled to about 1: with the full
metres of a map projection the normal equations of degree 2 and 3 have no correct digit left.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.records import Record

RECORD: Final = Record(source="x y z", target="u v", w11=1, w12=1, w22=1)
#: Highest degree of the polynomial: that of İpbüker 1994.
MAX_DEGREE = 5


def polynomial_setup(degree: int) -> Array:
    """Exponents of x and y (2, p) in the order of İpbüker 1994, appendix EK 2: 1; y, x; y^2, xy, x^2; ..."""
    pairs = [(k, d - k) for d in range(degree + 1) for k in range(d + 1)]
    return np.ascontiguousarray(np.array(pairs, float).T)


@compiled
def whitened(record: Any, u: Any, v: Any) -> Any:
    """``W (computed - given)`` (2,) of a computed target u, v."""
    d_u, d_v = u - record[RECORD.u], v - record[RECORD.v]
    return np.array([record[RECORD.w11] * d_u + record[RECORD.w12] * d_v, record[RECORD.w22] * d_v])


@compiled
def whiten_rows(record: Array, jacobian: Array) -> Array:
    """W times a Jacobian (2, k), in place."""
    for j in range(jacobian.shape[1]):
        jacobian[0, j] = record[RECORD.w11] * jacobian[0, j] + record[RECORD.w12] * jacobian[1, j]
        jacobian[1, j] *= record[RECORD.w22]
    return jacobian


@compiled
def _power(base: float, exponent: int) -> float:
    out = 1.0
    for _ in range(exponent):
        out *= base
    return out


@compiled
def residual_polynomial(record: Any, setup: Any, c: Any) -> Any:
    """Polynomial of U and of V with the exponents of ``setup`` (2, p); c = p coefficients of U, then of V."""
    p = setup.shape[1]
    u, v = c[0] * 0.0, c[0] * 0.0
    for k in range(p):
        term = _power(record[RECORD.x], int(setup[0, k])) * _power(record[RECORD.y], int(setup[1, k]))
        u += c[k] * term
        v += c[p + k] * term
    return whitened(record, u, v)


@compiled
def kernel_polynomial(record: Array, setup: Array, c: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 2p)."""
    value = residual_polynomial(record, setup, c)
    if not want:
        return value, np.empty((0, 0))
    p = setup.shape[1]
    jacobian = np.zeros((2, 2 * p))
    for k in range(p):
        term = _power(record[RECORD.x], int(setup[0, k])) * _power(record[RECORD.y], int(setup[1, k]))
        jacobian[0, k] = term
        jacobian[1, p + k] = term
    return value, whiten_rows(record, jacobian)


@compiled
def residual_helmert(record: Any, setup: Any, x: Any) -> Any:
    """``U = c + a x - b y, V = d + b x + a y``; unknowns c, d, a, b."""
    u = x[0] + x[2] * record[RECORD.x] - x[3] * record[RECORD.y]
    v = x[1] + x[3] * record[RECORD.x] + x[2] * record[RECORD.y]
    return whitened(record, u, v)


@compiled
def kernel_helmert(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 4)."""
    value = residual_helmert(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    rows = np.array([[1.0, 0.0, record[RECORD.x], -record[RECORD.y]], [0.0, 1.0, record[RECORD.y], record[RECORD.x]]])
    return value, whiten_rows(record, rows)


@compiled
def residual_projective(record: Any, setup: Any, x: Any) -> Any:
    """``U = (a0 + a1 x + a2 y)/(1 + c1 x + c2 y)``, V alike; unknowns a0 a1 a2 b0 b1 b2 c1 c2."""
    s, t = record[RECORD.x], record[RECORD.y]
    below = 1.0 + x[6] * s + x[7] * t
    return whitened(record, (x[0] + x[1] * s + x[2] * t) / below, (x[3] + x[4] * s + x[5] * t) / below)


@compiled
def kernel_projective(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (2,) and Jacobian (2, 8)."""
    value = residual_projective(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    s, t = record[RECORD.x], record[RECORD.y]
    g = 1.0 / (1.0 + x[6] * s + x[7] * t)
    u, v = (x[0] + x[1] * s + x[2] * t) * g, (x[3] + x[4] * s + x[5] * t) * g
    jacobian = np.array([
        [g, s * g, t * g, 0.0, 0.0, 0.0, -u * s * g, -u * t * g],
        [0.0, 0.0, 0.0, g, s * g, t * g, -v * s * g, -v * t * g],
    ])  # fmt: skip
    return value, whiten_rows(record, jacobian)


def example_record(rng: np.random.Generator) -> Array:
    """Record of a normalised point with correlated coordinates."""
    w11, w12, w22 = rng.uniform(0.5, 2.0), rng.normal(), rng.uniform(0.5, 2.0)
    source, target = rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.0, 1.0, 2)
    return RECORD.pack(source=source, target=target, w11=w11, w12=w12, w22=w22)


def _example_polynomial(rng: np.random.Generator) -> Example:
    setup = polynomial_setup(int(rng.integers(1, MAX_DEGREE + 1)))
    return Example(example_record(rng), setup, (rng.normal(size=2 * setup.shape[1]),))


def _example_helmert(rng: np.random.Generator) -> Example:
    return Example(example_record(rng), np.zeros((2, 0)), (rng.normal(size=4),))


def _example_projective(rng: np.random.Generator) -> Example:
    x = np.concatenate([rng.normal(size=6), rng.uniform(-0.3, 0.3, 2)])
    return Example(example_record(rng), np.zeros((2, 0)), (x,))


POLYNOMIAL = register(Equation(
    "plane_polynomial", kernel_polynomial, residual_polynomial, (Argument("coefficients", "target unit"),),
    _example_polynomial, "İpbüker 1994, section 4.2.1 and appendix EK 2",
))  # fmt: skip
HELMERT = register(Equation(
    "plane_helmert", kernel_helmert, residual_helmert, (Argument("coefficients", "target unit"),), _example_helmert,
    "İpbüker 1994, section 7.2 (names the transformation; the equations are the usual ones)",
))  # fmt: skip
PROJECTIVE = register(Equation(
    "plane_projective", kernel_projective, residual_projective, (Argument("coefficients", "target unit"),),
    _example_projective, "the homography of two planes, its last element 1",
))  # fmt: skip
