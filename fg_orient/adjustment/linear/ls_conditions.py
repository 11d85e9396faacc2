"""The four conditions of least-squares usability, as published and free of scale.

Source: Terlemezoğlu 2019, section 3.5: n > u and (1) [v] = 0, (2) [vv] minimal, (3) N dP = b, (4) rank(A) = u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.conditioning import numerical_rank, singular_values
from fg_orient.adjustment.linear.scaling import scaled
from fg_orient.adjustment.linear.system import Array, LinearSystem
from fg_orient.model.errors import InputError

#: Backward stable solvers leave about u eps = 1e-14; what is above has lost a third of its digits for other reasons.
TOLERANCE: Final = 1e-10


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
