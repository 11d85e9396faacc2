"""The linear form without its affine part: what the choice of kappa and of coefficients works on.

The unknowns that are never in doubt (constant and linear terms of the numerators) are eliminated by QR. What is left is
an ordinary regression A x = l in the coefficients that make the model more than affine, with rows orthogonal to the
affine columns, so that a penalty |x| is in standard form (Eldén 1977).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.rpc.estimate import linear_system
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.rfm_points import ControlPoints, Scaling

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Reduced:
    """Regression of the coefficients in doubt.

    Parameters
    ----------
    design : (r, q) array
        Columns orthogonal to the affine ones.
    observed : (r,) array
        Alike.
    unknowns : (q,) array of int
        Their numbers in the form.
    always : (k,) array of int
        Unknowns that stay.
    affine : (r, k) array
        Orthonormal basis of their columns.
    """

    design: Array
    observed: Array
    unknowns: Indices
    always: Indices
    affine: Array

    @classmethod
    def of(cls, points: ControlPoints, form: RfmForm) -> Reduced:
        """Eliminate the affine part.

        Raises
        ------
        InputError
            A coordinate without extent.
        """
        system = linear_system(points, form, Scaling.of(points))
        a, observed = system.require_design("reduced system")
        doubtful = form.beyond_affine
        q = np.linalg.qr(a[:, ~doubtful])[0]
        rest = a[:, doubtful]
        rest = rest - q @ (q.T @ rest)
        rest = rest - q @ (q.T @ rest)  # twice is enough (Kahan, Parlett 1980)
        left = observed - q @ (q.T @ observed)
        return cls(rest, left - q @ (q.T @ left), np.flatnonzero(doubtful), np.flatnonzero(~doubtful), q)

    @property
    def system(self) -> LinearSystem:
        """As a linear system, for the rules of :mod:`fg_orient.adjustment.linear.kappa`."""
        return LinearSystem.from_design(self.design, self.observed)

    @property
    def freedom(self) -> int:
        """Rows minus affine unknowns: the redundancy if no coefficient in doubt is taken."""
        return len(self.design) - len(self.always)

    def fit(self, chosen: Indices) -> tuple[Array, float, Array]:
        """Least squares with some columns: x (k,), sum of squared residuals, diagonal of (A^T A)^-1 (k,)."""
        if not len(chosen):
            return np.zeros(0), float(self.observed @ self.observed), np.zeros(0)
        columns = self.design[:, chosen]
        length = np.linalg.norm(columns, axis=0)
        left, values, right = np.linalg.svd(columns / length, full_matrices=False)
        keep = values > len(columns) * np.finfo(np.float64).eps * values[0]
        inverse = right[keep].T / values[keep]
        x = inverse @ (left[:, keep].T @ self.observed)
        v = self.observed - columns @ (x / length)
        return x / length, float(v @ v), np.sum(inverse**2, axis=1) / length**2

    def kept(self, chosen: Indices, form: RfmForm) -> tuple[int, ...]:
        """Numbers of unknowns of the complete form: the affine ones and the chosen."""
        numbers = np.sort(np.concatenate([self.always, self.unknowns[chosen]]))
        return tuple(int(k) if form.kept is None else form.kept[int(k)] for k in numbers)
