"""Differences of points from their reference: sums of squares and RMS per axis, control points separately."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.closerange.fitting import as_points, plain_rms


@dataclass(frozen=True)
class Measures:
    """Differences of some points from their reference.

    Parameters
    ----------
    n : int
    sums_cm2 : (4,) list
        [Fxx], [Fyy], [Fzz] and their sum [Fpp], cm^2 (Ayhan 1996, eqs. 187-188).
    rms_mm : (4,) list
        sqrt([F]/n), mm; None without points.
    worst_mm : (3,) list
        Largest difference per axis; None without points.
    """

    n: int
    sums_cm2: list[float]
    rms_mm: list[float | None]
    worst_mm: list[float | None]


@dataclass(frozen=True)
class Comparison:
    """Differences of all points, of control points, and of the others.

    Only the others measure the accuracy of a method, because it uses the control points.
    """

    every: Measures
    control: Measures
    other: Measures


def compare_points(reference_m: npt.ArrayLike, points_m: npt.ArrayLike, control: npt.ArrayLike) -> Comparison:
    """Compare points with their reference, ``F = reference - points``.

    Parameters
    ----------
    reference_m, points_m : (n, 3) arrays
    control : (n,) bool array
        Points used by the compared method.

    Raises
    ------
    InputError
        Arrays of other shapes.
    """
    reference = as_points(reference_m, 3, "reference")
    difference = reference - as_points(points_m, 3, "points")
    used = np.asarray(control, bool)
    return Comparison(*(_measures(difference[rows]) for rows in (used | True, used, ~used)))


def _measures(difference: Array) -> Measures:
    axes, n = (1e4 * np.sum(difference**2, axis=0)).tolist(), len(difference)
    radial = float(np.sqrt(100.0 * sum(axes) / n)) if n else None
    worst = np.abs(1e3 * difference).max(axis=0).tolist() if n else [None] * 3
    return Measures(n, [*axes, sum(axes)], [*plain_rms(1e3 * difference), radial], worst)
