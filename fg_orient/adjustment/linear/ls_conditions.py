"""Usability of a linear system: the four conditions of least squares, and well-posedness in Hadamard's sense.

The conditions are given as published and free of scale (Terlemezoğlu 2019, section 3.5): n > u and (1) [v] = 0,
(2) [vv] minimal, (3) N dP = b, (4) rank(A) = u. A finite system with noise is well posed if it has a solution, only
one, and a stable one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.conditioning import numerical_rank, singular_values
from fg_orient.adjustment.linear.system import Array, LinearSystem, scaled
from fg_orient.model.distributions import chi_square_tail
from fg_orient.model.errors import InputError

#: Backward stable solvers leave about u eps = 1e-14; what is above has lost a third of its digits for other reasons.
TOLERANCE: Final = 1e-10
#: A residual that noise exceeds less often than this contradicts the model.
SIGNIFICANCE = 1e-3


@dataclass(frozen=True)
class LsConditions:
    """The conditions of a solved system.

    Parameters
    ----------
    n_observations, n_unknowns : int
    sum_v : float
        [v], condition 1 as published; it is 0 only if a constant lies in the column space of A.
    sum_vv : float
        [vv], condition 2 as published; minimal is what no other solver undercuts.
    normal_min, normal_max : float
        Smallest and largest |N dP - b|, condition 3 as published.
    rank : int
        Of N, condition 4 as published.
    orthogonality : float
        |A^T v|/(|A||v|), condition 1 (and 2) free of scale; 0 if v is rounding.
    normal_residual : float
        |N dP - b|/(|N||dP| + |b|), condition 3 free of scale, in unit-length columns.
    rank_scaled : int
        Of A with unit-length columns.
    """

    n_observations: int
    n_unknowns: int
    sum_v: float
    sum_vv: float
    normal_min: float
    normal_max: float
    rank: int
    orthogonality: float
    normal_residual: float
    rank_scaled: int

    @property
    def holds(self) -> tuple[bool, bool, bool, bool]:
        """Conditions 1-4 free of scale; 2 is 1 again, for A^T v = 0 is what makes [vv] minimal."""
        orthogonal = self.orthogonality <= TOLERANCE
        return orthogonal, orthogonal, self.normal_residual <= TOLERANCE, self.rank_scaled == self.n_unknowns


def ls_conditions(system: LinearSystem, x: Array, residuals: Array | None = None) -> LsConditions:
    """Evaluate the conditions.

    Parameters
    ----------
    system : LinearSystem
        With A and l.
    x : (u,) array
        Solution dP.
    residuals : (n,) array, optional
        What [v] and [vv] are taken of, if not v = A dP - l: Delta of the pre-adjustment, unwhitened v.

    Returns
    -------
    LsConditions

    Raises
    ------
    InputError
        A is not known, x or v does not fit or is not finite, or there is no redundancy.
    """
    design, observed = system.require_design("least-squares conditions")
    u = len(system)
    if system.redundancy <= 0:
        raise InputError.of("linear.redundancy", place="n > u", value=f"{len(design)} rows, {u} unknowns")
    if x.shape != (u,) or not np.isfinite(x).all():
        raise InputError.of("linear.solution", place="dP", value=f"shape {x.shape}", unknowns=u)
    if residuals is not None and (residuals.shape != observed.shape or not np.isfinite(residuals).all()):
        raise InputError.of("linear.residuals", place="v", value=f"shape {residuals.shape}")
    v = design @ x - observed
    shown = v if residuals is None else residuals
    misfit = np.abs(system.normal @ x - system.rhs)
    unit, lengths = scaled(system)
    values = singular_values(unit.require_design("rank")[0])
    return LsConditions(
        n_observations=len(design),
        n_unknowns=u,
        sum_v=float(shown.sum()),
        sum_vv=float(shown @ shown),
        normal_min=float(misfit.min()),
        normal_max=float(misfit.max()),
        rank=numerical_rank(singular_values(system.normal), u),
        orthogonality=_orthogonality(unit, x * lengths),
        normal_residual=_normal_residual(unit, x * lengths),
        rank_scaled=numerical_rank(values, len(design)),
    )


def _orthogonality(system: LinearSystem, x: Array) -> float:
    """|A^T v|/(|A||v|), or 0 where v is rounding of its two terms."""
    design, observed = system.require_design("A^T v")
    v = design @ x - observed
    length, size = float(np.linalg.norm(v)), float(np.linalg.norm(design, 2))
    rounding = max(design.shape) * np.finfo(np.float64).eps * (size * np.linalg.norm(x) + np.linalg.norm(observed))
    return 0.0 if length <= rounding else float(np.linalg.norm(design.T @ v)) / (size * length)


def _normal_residual(system: LinearSystem, x: Array) -> float:
    """|N dP - b|/(|N||dP| + |b|); 0 for 0/0."""
    size = float(np.linalg.norm(system.normal, 2) * np.linalg.norm(x) + np.linalg.norm(system.rhs))
    return float(np.linalg.norm(system.normal @ x - system.rhs)) / size if size > 0.0 else 0.0


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
