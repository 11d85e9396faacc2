"""Column scaling: unknowns in units that give every column of A the length 1."""

from __future__ import annotations

import numpy as np

from fg_orient.adjustment.linear.system import Array, LinearSystem


def column_lengths(system: LinearSystem) -> Array:
    """Lengths of the columns of A, or sqrt(n_ii) where A is not known; 1 for a column of zeros.

    Parameters
    ----------
    system : LinearSystem

    Returns
    -------
    (u,) array
    """
    if system.design is not None:
        return _lengths(system.design)
    lengths = np.sqrt(np.abs(system.normal.diagonal()))
    return np.where(lengths > 0.0, lengths, 1.0)


def _lengths(design: Array) -> Array:
    largest = np.abs(design).max(axis=0, initial=0.0)
    safe = np.where(largest > 0.0, largest, 1.0)  # squares of raw polynomial columns may overflow
    lengths = safe * np.sqrt(((design / safe) ** 2).sum(axis=0))
    return np.where(lengths > 0.0, lengths, 1.0)


def unit_columns(design: Array) -> Array:
    """Matrix (r, u) with columns of length 1; a column of zeros stays.

    Parameters
    ----------
    design : (r, u) array

    Returns
    -------
    (r, u) array
    """
    return np.asarray(design / _lengths(design))


def scaled(system: LinearSystem) -> tuple[LinearSystem, Array]:
    """System in unknowns z_i = d_i x_i whose columns have length 1, and d.

    Parameters
    ----------
    system : LinearSystem

    Returns
    -------
    system : LinearSystem
    lengths : (u,) array
        d; x = z / d.
    """
    lengths = column_lengths(system)
    if system.design is not None and system.observed is not None:
        return LinearSystem.from_design(system.design / lengths, system.observed), lengths
    return LinearSystem(system.normal / np.outer(lengths, lengths), system.rhs / lengths), lengths
