"""Reference solutions of small least-squares problems with 256 bits, with which solvers are compared.

The elements of the matrix are exact binary numbers. FLINT (Johansson 2017) forms and
solves the normal equations with :data:`BITS` bits; quadruple precision has 113 bits. For
condition numbers of N up to 1e30, the result then has more correct digits than a double.
If a matrix is singular in double precision, there is no reference. Ball arithmetic gives
a proven bound for the residual of the solution, which is tested. The module needs
python-flint (extra "reference").
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.system import numerical_rank, singular_values, unit_columns

#: Number of bits of the mantissa.
BITS: Final = 256
#: A reference is computed for a set up to this number of unknowns (0.7 s for 400).
LIMIT: Final = 400
#: A reference is computed for each row up to this number of unknowns (0.1 s for 150).
LIMIT_OF_ROW: Final = 150
#: Maximum element of the residual, relative to the largest element of the right-hand side.
RESIDUAL: Final = 1e-50


def available() -> bool:
    """Return whether python-flint is installed."""
    return find_spec("flint") is not None


def exact(design: Array, observed: Array, limit: int = LIMIT) -> Array | None:
    """Compute the x (u,) that minimises ``|A x - l|``, rounded to doubles; None if A is singular or too large.

    Parameters
    ----------
    design : (r, u) array
        A; its elements are taken as exact.
    observed : (r,) array
        l.
    limit : int
        Largest u.
    """
    rows, u = design.shape
    if not (available() and 0 < u <= limit):
        return None
    values = singular_values(unit_columns(design))
    if numerical_rank(values, max(rows, u)) < u:
        return None
    import flint

    before = flint.ctx.prec
    flint.ctx.prec = BITS
    try:
        matrix = flint.arb_mat(design.tolist())
        transposed = matrix.transpose()
        normal, right = transposed * matrix, transposed * flint.arb_mat(observed[:, None].tolist())
        x = normal.solve(right, algorithm="approx")
        residual = normal * x - right
        largest = [max(abs(float(m[k, 0].abs_upper())) for k in range(u)) for m in (residual, right)]
        solution = np.array([float(x[k, 0].mid()) for k in range(u)])
    finally:
        flint.ctx.prec = before
    return solution if largest[0] <= RESIDUAL * largest[1] else None


def forward_error(x: Array, reference: Array | None) -> float:
    """Return the relative error ``|x - x_ref| / |x_ref|`` in the Euclidean norm; nan without a reference."""
    if reference is None or not np.isfinite(x).all():
        return float("nan")
    length = float(np.linalg.norm(reference))
    return float(np.linalg.norm(x - reference)) / length if length else float("nan")
