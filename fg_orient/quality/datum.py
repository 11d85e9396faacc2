"""Datum of a free network: inner constraints and S-transformations.

A network without control has motions E (the null space of its Jacobian) that no observation feels. Constraints
``E^T D (x - x_0) = 0``, as many as motions, choose one of its solutions; D picks the unknowns that carry the datum.
All choices have the same residuals and the same shape, and each follows from any other by an S-transformation
(Baarda 1973)::

    S = I - E (E^T D E)^-1 E^T D,    x_D = x_0 + S (x - x_0),    Q_D = S Q S^T

With all unknowns in D this is the solution of the pseudo-inverse, with the trace of Q as small as it can be (Meissl
1962); with some of them, the trace of their part is (Koch 1999, 3.3).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: The unknowns of a datum fix the motions if these, restricted to them, have a condition below this.
FIXES: Final = 1e8


def s_matrix(null_space: Array, select: Mask) -> Array:
    """Matrix S (n, n) of the transformation to the datum that some unknowns carry.

    Parameters
    ----------
    null_space : (n, d) array
        The free motions, any basis.
    select : (n,) bool array
        Unknowns that carry the datum.

    Raises
    ------
    InputError
        These unknowns do not fix all motions.
    """
    return np.eye(len(null_space)) - null_space @ _coordinates(null_space, select)


def s_transform(cofactors: Array, null_space: Array, select: Mask) -> Array:
    """Cofactors ``S Q S^T`` (n, n) in the datum that some unknowns carry.

    Parameters
    ----------
    cofactors : (n, n) array
        In any datum: of a minimally constrained adjustment, or of another choice of inner constraints.
    null_space : (n, d) array
    select : (n,) bool array

    Raises
    ------
    InputError
        These unknowns do not fix all motions.
    """
    # Q - E (A Q) - (A Q)^T E^T + E (A Q A^T) E^T: cheaper than two products with S
    a = _coordinates(null_space, select)
    aq = a @ cofactors
    moved = null_space @ aq
    found = cofactors - moved - moved.T + null_space @ (aq @ a.T) @ null_space.T
    return np.asarray(0.5 * (found + found.T))


def datum_step(difference: Array, null_space: Array, select: Mask) -> Array:
    """Step ``(S - I) (x - x_0)`` (n,) along the motions that leads to the datum.

    Parameters
    ----------
    difference : (n,) array
        ``x - x_0``.
    null_space : (n, d) array
    select : (n,) bool array

    Raises
    ------
    InputError
        These unknowns do not fix all motions.
    """
    return np.asarray(-null_space @ (_coordinates(null_space, select) @ difference))


def _coordinates(null_space: Array, select: Mask) -> Array:
    """``(E^T D E)^-1 E^T D`` (d, n): how far each motion went, judged by the unknowns of the datum."""
    part = null_space[select]
    out = np.zeros(null_space.T.shape)
    if not null_space.shape[1]:
        return out
    s = np.linalg.svd(part, compute_uv=False) if len(part) >= part.shape[1] else np.zeros(1)
    if not len(s) or s[-1] * FIXES <= np.linalg.norm(null_space, 2):
        raise InputError.of("statistics.datum", option="datum", value=f"{int(select.sum())} unknowns",
                            count=null_space.shape[1])  # fmt: skip
    out[:, select] = np.linalg.pinv(part)
    return out
