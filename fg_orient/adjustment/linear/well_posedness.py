"""Well-posedness in Hadamard's sense of a finite system with noise: existence, uniqueness, stability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fg_orient.adjustment.linear.conditioning import numerical_rank
from fg_orient.adjustment.linear.system import Array, LinearSystem
from fg_orient.model.distributions import chi_square_tail
from fg_orient.model.errors import InputError

#: A residual that noise exceeds less often than this contradicts the model.
SIGNIFICANCE = 1e-3


@dataclass(frozen=True)
class WellPosedness:
    """Verdict on A x = l.

    Parameters
    ----------
    existence : bool
        l lies in the range of A within the noise.
    uniqueness : bool
        rank(A) = u.
    stability : bool
        The expected error of the (minimum-norm) solution is smaller than the solution.
    rank, order : int
    residual : float
        |A x - l| of the least-squares solution.
    relative_error : float
        sqrt(sum_i 1/s_i^2) noise/|x| over the singular values that are not rounding.
    """

    existence: bool
    uniqueness: bool
    stability: bool
    rank: int
    order: int
    residual: float
    relative_error: float

    @property
    def well_posed(self) -> bool:
        """All three hold."""
        return self.existence and self.uniqueness and self.stability

    def __str__(self) -> str:
        reasons = [
            text
            for holds, text in (
                (self.existence, "no solution: the residual exceeds the noise"),
                (self.uniqueness, f"not unique: rank {self.rank} of {self.order}"),
                (self.stability, f"unstable: noise changes the solution by {self.relative_error:.2g} of its size"),
            )
            if not holds
        ]
        return "ill posed: " + "; ".join(reasons) if reasons else "well posed"


def well_posedness(design: Array, observed: Array, noise: float = 0.0) -> WellPosedness:
    """Judge whether A x = l has a solution, only one, and one that noise does not drown.

    Every finite system of full rank is continuous, so stability is judged by size: it fails where the noise, or at
    least the rounding of l, moves the solution by its own length.

    Parameters
    ----------
    design : (r, u) array
        A.
    observed : (r,) array
        l.
    noise : float
        Standard deviation of one observation.

    Returns
    -------
    WellPosedness

    Raises
    ------
    InputError
        A and l do not fit, or the noise is negative or not finite.

    Notes
    -----
    Hadamard 1902; Terlemezoğlu 2019, section 3.1, T(3.1).
    """
    if not (np.isfinite(noise) and noise >= 0.0):
        raise InputError.of("linear.noise", place="noise", value=noise)
    system = LinearSystem.from_design(design, observed)
    rows, u = design.shape
    left, values, right = np.linalg.svd(design, full_matrices=False)
    rank = numerical_rank(values, max(rows, u))
    beta = left[:, :rank].T @ observed
    x = right[:rank].T @ (beta / values[:rank])
    residual = float(np.linalg.norm(observed - left[:, :rank] @ beta))
    eps = np.finfo(np.float64).eps
    error = max(noise, eps * float(np.abs(observed).max())) * float(np.sqrt(np.sum(values[:rank] ** -2.0)))
    length = float(np.linalg.norm(x))
    relative = 0.0 if error == 0.0 else error / length if length > 0.0 else float("inf")
    rounding = max(rows, u) * eps * float(values[0] * length + np.linalg.norm(observed))  # of A x and of l
    existence = _explained(residual, noise, rows - rank, rounding)
    return WellPosedness(existence, rank == u, relative < 1.0, rank, len(system), residual, relative)


def _explained(residual: float, noise: float, freedom: int, rounding: float) -> bool:
    """Whether noise (chi-square with its degrees of freedom) or rounding explains a residual."""
    if freedom == 0 or residual <= rounding:  # as many directions as observations: every l is in the range of A
        return True
    if noise == 0.0:
        return False
    return bool(chi_square_tail(freedom, (residual / noise) ** 2) >= SIGNIFICANCE)
