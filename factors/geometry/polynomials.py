"""Polynomials in the normalised line tau and the normalised sample s.

``tau = (line - c)/c`` with ``c = (n_lines - 1)/2``, ``s`` alike for samples: the first
pixel is -1, the last +1. EOP corrections are ``c0 + c1 tau + c2 tau^2`` (T 2.34, T-Table
4.1, with tau instead of the line number for conditioning). The published per-line form
``q0 + q1 l + q2 l^2``, ``l = line - c``, follows by a diagonal transformation.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array


def normalised(pixel: Array, count: int) -> Array:
    """Map pixel coordinates 0 .. count - 1 to -1 .. 1."""
    centre = (count - 1) / 2.0
    return np.asarray((np.asarray(pixel, float) - centre) / centre)


def evaluate(coefficients: Array, argument: Array) -> Array:
    """``sum_k coefficients[..., k] argument^k``: (c, k), (N,) -> (N, c)."""
    powers = np.asarray(argument, float)[:, None] ** np.arange(coefficients.shape[-1])
    return np.asarray(powers @ coefficients.T)


def fit(argument: Array, values: Array, degree: int) -> tuple[Array, Array]:
    """Least-squares polynomial through ``values`` (N, c).

    Returns
    -------
    coefficients : (c, degree + 1)
    residuals : (N, c), value minus polynomial
    """
    powers = np.asarray(argument, float)[:, None] ** np.arange(degree + 1)
    coefficients: Array = np.ascontiguousarray(np.linalg.lstsq(powers, values, rcond=None)[0].T, dtype=float)
    return coefficients, np.asarray(values - evaluate(coefficients, argument), dtype=float)


def per_line_from_tau(n_lines: int) -> Array:
    """Diagonal of the transformation of c0, c1, c2 of tau to q0, q1, q2 per line about the same line.

    ``q_k = c_k / c^k`` with ``c = (n_lines - 1)/2``; it is also its own Jacobian, so the
    covariance follows by scaling rows and columns.
    """
    centre = (n_lines - 1) / 2.0
    return np.asarray(centre ** -np.arange(3.0))
