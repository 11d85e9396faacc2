"""Polynomials in the normalised line tau and the normalised sample s, and curves over tau.

``tau = (line - c)/c`` with ``c = (n_lines - 1)/2``: the first line is -1, the last +1.
``s`` is defined in the same way for samples. EOP corrections are ``c0 + c1 tau + c2
tau^2`` (T 2.34, T-Table 4.1, with tau instead of the line number for conditioning). The
published per-line form ``q0 + q1 l + q2 l^2``, ``l = line - c``, follows by a diagonal
transformation.

Smooth curves over an image are uniform cubic B-splines with a prior on their third
differences.

A curve of tau in [-1, 1] is ``B(tau) W x``. B are the ``k + 3`` cubic B-splines over ``k``
equal intervals, and x are the ``k`` unknowns, each N(0, 1). ``W`` is the pseudo-inverse of
the third differences D of the coefficients, so that x are these third differences. With
independent x the coefficients are a random walk of third order, as in penalised splines
(Eilers & Marx 1996). The curves contain no quadratics, whose third differences are zero; the
degree-2 coefficients represent them. W is scaled so that the prior standard deviation of a
curve is 1 in the mean square over the image.

Jitter has another prior. All ``k + 3`` coefficients are independent with equal variances,
so that the spectrum of the process is flat up to about ``k / 3`` cycles per image. Its k
unknowns are the coefficients without quadratics, in an orthonormal basis N. The degree-2
coefficients represent the quadratics, whose prior variances are added to their own.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from factors._contract import Array

#: Degree of the splines. A spline has this number of coefficients more than intervals. The penalty uses
#: differences of the coefficients of this order.
DEGREE: Final = 3
#: Smallest and largest number of intervals of a curve.
FEWEST, MOST = 2, 32


def normalised(pixel: Array, count: int) -> Array:
    """Convert pixel coordinates 0 .. count - 1 to -1 .. 1."""
    centre = (count - 1) / 2.0
    return np.asarray((np.asarray(pixel, float) - centre) / centre)


def evaluate(coefficients: Array, argument: Array) -> Array:
    """Return ``sum_k coefficients[..., k] argument^k``: (c, k), (N,) -> (N, c)."""
    powers = np.asarray(argument, float)[:, None] ** np.arange(coefficients.shape[-1])
    return np.asarray(powers @ coefficients.T)


def fit(argument: Array, values: Array, degree: int) -> tuple[Array, Array]:
    """Fit a least-squares polynomial to ``values`` (N, c).

    Returns
    -------
    coefficients : (c, degree + 1)
    residuals : (N, c), value minus polynomial
    """
    powers = np.asarray(argument, float)[:, None] ** np.arange(degree + 1)
    coefficients: Array = np.ascontiguousarray(np.linalg.lstsq(powers, values, rcond=None)[0].T, dtype=float)
    return coefficients, np.asarray(values - evaluate(coefficients, argument), dtype=float)


def per_line_from_tau(n_lines: int) -> Array:
    """Return the diagonal transformation from c0, c1, c2 of tau to q0, q1, q2 per line, about the same line.

    ``q_k = c_k / c^k`` with ``c = (n_lines - 1)/2``. This is also the Jacobian, so
    scaling rows and columns gives the covariance.
    """
    centre = (n_lines - 1) / 2.0
    return np.asarray(centre ** -np.arange(3.0))


def basis(tau: Array, n_intervals: int) -> Array:
    """Return the values (N, n_intervals + 3) of the B-splines at N times.

    The outer pieces continue beyond -1 and 1.
    """
    u = 0.5 * n_intervals * (np.asarray(tau, float) + 1.0)
    piece = np.clip(np.floor(u).astype(int), 0, n_intervals - 1)
    f = u - piece
    values = ((1.0 - f) ** 3, 3.0 * f**3 - 6.0 * f**2 + 4.0, 3.0 * f * (1.0 + f - f**2) + 1.0, f**3)
    out = np.zeros((len(u), n_intervals + DEGREE))
    for k, value in enumerate(values):
        out[np.arange(len(u)), piece + k] = value / 6.0
    return out


@cache
def _from_unknowns(n_intervals: int) -> Array:
    """Return W, which converts independent unknowns (n_intervals) to coefficients (n_intervals + 3)."""
    w: Array = np.asarray(np.linalg.pinv(np.diff(np.eye(n_intervals + DEGREE), n=DEGREE, axis=0)), dtype=float)
    curve = basis(np.linspace(-1.0, 1.0, 40 * n_intervals + 1), n_intervals) @ w
    w = np.asarray(w / np.sqrt(np.mean(np.sum(curve**2, axis=1))))
    w.setflags(write=False)
    return w


def curves(tau: Array, n_intervals: int) -> Array:
    """Return n_intervals curves at N times (N, n_intervals): in each, one unknown is 1 and the others are 0."""
    return np.asarray(basis(tau, n_intervals) @ _from_unknowns(n_intervals))


@cache
def _jitter(n_intervals: int) -> tuple[Array, Array]:
    """Return N (k + 3, k), scaled to jitter of unit mean square, and the standard deviations (3,) of c0, c1, c2."""
    tau = np.linspace(-1.0, 1.0, 40 * n_intervals + 1)
    values = basis(tau, n_intervals)
    # exact, because the splines contain these powers
    powers = np.linalg.lstsq(values, tau[:, None] ** np.arange(DEGREE), rcond=None)[0]
    q, r = np.linalg.qr(powers, mode="complete")
    scale = 1.0 / np.sqrt(np.mean(np.sum(values**2, axis=1)))
    out = np.asarray(q[:, DEGREE:] * scale), np.asarray(np.linalg.norm(np.linalg.inv(r[:DEGREE]), axis=1) * scale)
    for array in out:
        array.setflags(write=False)
    return out


def jitter_curves(tau: Array, n_intervals: int) -> Array:
    """Return jitter without quadratics at N times (N, n_intervals): in each column, one unknown is 1."""
    return np.asarray(basis(tau, n_intervals) @ _jitter(n_intervals)[0])


def jitter_quadratic(n_intervals: int) -> Array:
    """Return the standard deviations (3,) of c0, c1, c2 in jitter whose mean square over the image is 1."""
    return _jitter(n_intervals)[1]


@cache
def curves_from_jitter(n_intervals: int) -> Array:
    """Return the matrix (k, k) that converts unknowns of jitter to unknowns of :func:`curves` for the same curve."""
    return np.asarray(np.linalg.lstsq(_from_unknowns(n_intervals), _jitter(n_intervals)[0], rcond=None)[0])
