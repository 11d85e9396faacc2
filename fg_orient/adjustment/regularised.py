"""Record of a regularisation: method, parameter, rank and rows.

Method, parameter and rank are determined once, at the start values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from factors.arrays import Array
from fg_orient.adjustment.linear.system import LinearSystem

if TYPE_CHECKING:
    from fg_orient.adjustment.linear.kappa import KappaChoice


@dataclass(frozen=True, eq=False)
class Regularisation:
    """Regularisation of a problem: its method, its parameter and its rows.

    Parameters
    ----------
    method : str
        "tikhonov", "truncated", "minimum_norm", "generalised_ridge", "stein" or "ridge_stein".
    kappa : float or None
        Regularisation parameter; None for other methods.
    rule : str
        Rule that chose kappa, "" if it was given.
    choice : KappaChoice or None
        Choice with the curve of the rule and its remarks.
    singular_values : (z,) array
        Singular values of the reduced Jacobian in the units of the norm, descending,
        without priors; empty for a large system.
    rank : int
        Number of singular values above the cut.
    gap : float
        Ratio of the singular values above and below the cut; inf if there is no value below, or if it is zero.
    units : (z,) array
        Factors that convert deviations in prior sigmas to the units of the norm.
    rows : (k, z) array, or sparse array of a large system
        Rows R of the penalty: ``R x = 0`` was added, with x in prior sigmas.
    null : (z, d) array
        Orthonormal basis, in the units of the norm, of the directions below the rank cut and of all held ones.
    standard : LinearSystem or None
        Reduced system in standard form, to which the rules of kappa are applied (penalty
        |y|^2); None for a large system.
    condition : float
        Condition of the reduced Jacobian with priors and penalty.
    determined : float
        Number of image unknowns that the rows determine: trace of ``R Q R^T`` at the start.
    n_rows : int
        Number of rows among the observations; fewer than k if they were compressed.
    """

    method: str
    kappa: float | None
    rule: str
    choice: KappaChoice | None
    singular_values: Array
    rank: int
    gap: float
    units: Array
    rows: Any
    null: Array
    standard: LinearSystem | None
    condition: float
    determined: float
    n_rows: int = 0

    @property
    def redundancy(self) -> float:
        """Sum of the redundancy numbers of the rows; 0 for directions that are held fixed.

        It is not a redundancy of the observations.

        With Q of all rows it is the trace of ``I - R Q R^T``. Without the penalty, the redundancy of a
        problem is the number of its observations minus the trace of their hat matrix.
        """
        return self.n_rows - self.determined if self.method not in ("truncated", "minimum_norm") else 0.0

    @property
    def held(self) -> int:
        """Number of directions that stay at the metadata."""
        return 0 if self.method == "tikhonov" else self.null.shape[1]
