"""Results of the two-stage procedure, errors per ECEF axis as published, and intersection of two rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem


@dataclass(frozen=True)
class LookAngles:
    """Result of step 1.

    Parameters
    ----------
    adjusted_rad : (n, 2) array
        psi_x, psi_y of every image point; for check points from the polynomial.
    v_rad : (n, 2) array
        Adjusted minus file values; for check points the correction from the polynomial.
    cycles : int
    largest_misclosure : float
        Largest |F| at the control points after step 1.
    m0_rad : float
        ``sqrt(v^T v / n)`` over the control points; it depends on the input errors.
    """

    adjusted_rad: Array
    v_rad: Array
    cycles: int
    largest_misclosure: float
    m0_rad: float


@dataclass(frozen=True)
class PreAdjustment:
    """Result of step 2 for one image.

    Parameters
    ----------
    system : LinearSystem
        System in raw units; ``design`` is A, ``observed`` is -w.
    solution : LinearSolution
    dP : (k,) array
        EOP corrections in the order of ``eop_codes``; nan if the solver broke down.
    delta : (r,) array
        ``A dP + w``.
    repeats : int
    """

    system: LinearSystem
    solution: LinearSolution
    dP: Array
    delta: Array
    repeats: int = 1


@dataclass(frozen=True)
class TwoStageResult:
    """Result of the bundle adjustment.

    Parameters
    ----------
    system : LinearSystem or None
        System of the last iteration, with rows whitened by B; None if there are no unknowns.
    solution : LinearSolution
    v : (r,) array
        Residuals of the look angles psi_y, psi_x of each image point, rad.
    dP : (M, k) array
        Total EOP corrections of each image, in the order of ``eop_codes``.
    accuracy : AxisErrors
        Errors; nan if the solver broke down.
    n_observations, n_unknowns : int
    failure : str
        Reason why the solver broke down; "" if it did not.
    """

    system: LinearSystem | None
    solution: LinearSolution
    v: Array
    dP: Array
    accuracy: AxisErrors
    n_observations: int
    n_unknowns: int
    failure: str = ""


@dataclass(frozen=True)
class AxisErrors:
    """Measured minus computed coordinates, ECEF axes, m (Terlemezoğlu 2019, eq. 2.72).

    Parameters
    ----------
    gcp_m : (n, 3) array
        Errors of control points, intersected again; points in only one image are omitted.
    icp_m : (k, 3) array
        Errors of check points.
    gcp_ids, icp_ids : tuple of str
        Ids of these points.
    """

    gcp_m: Array
    icp_m: Array
    gcp_ids: tuple[str, ...]
    icp_ids: tuple[str, ...]

    @property
    def gcp_rmse(self) -> Array:
        """Errors m_X, m_Y, m_Z of the control points (3,); nan if there are none."""
        return rms(self.gcp_m)

    @property
    def icp_rmse(self) -> Array:
        """Errors m_X, m_Y, m_Z of the check points (3,); nan if there are none."""
        return rms(self.icp_m)

    @property
    def gcp_max(self) -> float:
        """Largest of m_X, m_Y, m_Z for the control points."""
        return float(self.gcp_rmse.max())

    @property
    def icp_max(self) -> float:
        """Largest of m_X, m_Y, m_Z for the check points."""
        return float(self.icp_rmse.max())


def rms(values_m: Array) -> Array:
    """Return the root mean square of each column; nan if there are no rows."""
    if not len(values_m):
        return np.full(values_m.shape[1], np.nan)
    largest = np.abs(values_m).max(axis=0)
    # scaled first, because squares of large values would overflow
    scale = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return np.asarray(np.sqrt(np.mean((values_m / scale) ** 2, axis=0)) * scale)


def from_two_rays(
    centre_m: Array, direction: Array, image: Index, point: Index, n_points: int, *, midpoint: bool = False
) -> Array:
    """Return the foot point on the first ray of the shortest connection of two rays (T 2.49-2.52 as corrected).

    Parameters
    ----------
    centre_m, direction : (n, 3) arrays
        Rays in ECEF.
    image, point : (n,) int arrays
        Image (0 or 1) and point of each ray.
    midpoint : bool
        True to return the middle of the connection, as in the authors' program, instead of its foot point on the first
        ray.

    Returns
    -------
    (n_points, 3) array
        Coordinates, ECEF m; nan for points in only one image and for parallel rays.
    """
    row = np.full((2, n_points), -1)
    row[image, point] = np.arange(len(image))
    both = np.flatnonzero((row >= 0).all(axis=0))
    (p1, u1), (p2, u2) = ((centre_m[row[k, both]], direction[row[k, both]]) for k in (0, 1))
    base, cos = p2 - p1, np.einsum("ni,ni->n", u1, u2)
    sin2 = np.sum(np.cross(u1, u2) ** 2, axis=1)  # 1 - cos^2 without cancellation
    sin2[sin2 == 0.0] = np.nan
    b1, b2 = np.einsum("ni,ni->n", u1, base), np.einsum("ni,ni->n", u2, base)
    out = np.full((n_points, 3), np.nan)
    out[both] = p1 + ((b1 - cos * b2) / sin2)[:, None] * u1
    if midpoint:
        out[both] = 0.5 * (out[both] + p2 + ((cos * b1 - b2) / sin2)[:, None] * u2)
    return out
