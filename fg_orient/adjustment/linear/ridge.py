"""Tikhonov solutions of a system: for one kappa with any penalty, and for all kappa with the penalty |x|.

One singular value decomposition gives the solutions for all kappa. With A = U S V^T and
beta = U^T l, x = V (s beta/(s^2 + kappa)); |x|^2 = X and |A x - l|^2 = R are sums over
the singular values. Curves and their derivatives are therefore exact, without
differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import Given, choose_kappa
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import Breakdown, LinearSolution, LinearSystem
from fg_orient.model.errors import InputError

GRID_POINTS = 240
#: The grid starts at the smallest singular value, but not below 16 times the rounding of the largest (Hansen 1998).
ROUNDINGS = 16.0


class RidgeCurves(ABC):
    """Functions of kappa of the Tikhonov solutions of a system with penalty |x|; ``rule`` is a name for messages."""

    rows: int
    rule: str

    @property
    @abstractmethod
    def grid(self) -> Array:
        """Return the kappas at which a rule searches first, in ascending order with equal ratios."""

    @property
    @abstractmethod
    def wide(self) -> Array:
        """Return kappas over a wide range.

        Beyond it, the residual changes only by rounding or cannot be computed.
        """

    @abstractmethod
    def norm2(self, kappa: float) -> float:
        """Return X = |x|^2."""

    @abstractmethod
    def norm2_slopes(self, kappa: float) -> tuple[float, float]:
        """Return the first and second derivative of X by kappa."""

    @abstractmethod
    def residual2(self, kappa: float) -> float:
        """Return R = |A x - l|^2; dR/dkappa = -kappa dX/dkappa."""

    @abstractmethod
    def trace(self, kappa: float) -> float:
        """Return the trace of the hat matrix."""

    @abstractmethod
    def change2(self, kappa: float) -> float:
        """Return |kappa dx/dkappa|^2, the quasi-optimality function (Tikhonov, Glasko 1965)."""

    @abstractmethod
    def change2_slope(self, kappa: float) -> float:
        """Return half the derivative of :meth:`change2` by log kappa."""

    def curvature(self, kappa: float) -> float:
        """Return the curvature of (log|A x - l|, log|x|) by log kappa (Hansen, O'Leary 1993)."""
        norm, residual = self.norm2(kappa), self.residual2(kappa)
        slope, second = self.norm2_slopes(kappa)
        eta = 0.5 * kappa * slope / norm
        rho = -0.5 * kappa**2 * slope / residual
        eta2 = 0.5 * (kappa * slope + kappa**2 * second) / norm - 2.0 * eta**2
        rho2 = -0.5 * (2.0 * kappa**2 * slope + kappa**3 * second) / residual - 2.0 * rho**2
        return float((rho * eta2 - rho2 * eta) / (rho**2 + eta**2) ** 1.5)

    def gcv(self, kappa: float) -> float:
        """Return the GCV function n |(I - H) l|^2/(tr(I - H))^2 (Golub, Heath, Wahba 1979)."""
        return self.rows * self.residual2(kappa) / (self.rows - self.trace(kappa)) ** 2


@dataclass(frozen=True)
class Ridge(RidgeCurves):
    """Tikhonov solutions of a system for all kappa.

    Fields: singular values (p,) of A, descending; beta = U^T l (p,); V^T (p, u); squared
    length of the part of l outside the range of A; number of rows of A; name of the rule
    for messages.
    """

    values: Array
    beta: Array
    right: Array
    outside: float
    rows: int
    rule: str

    @classmethod
    def of(cls, system: LinearSystem, rule: str) -> Ridge:
        """Decompose A.

        Raises
        ------
        InputError
            A is not known.
        Breakdown
            A is zero.
        """
        design, observed = system.require_design(f"kappa rule {rule}")
        left, values, right = system.decomposition
        if values[0] == 0.0:
            raise Breakdown.of("linear.no_kappa", place=f"kappa rule {rule}", value="A = 0")
        beta = left.T @ observed
        outside = float(np.sum((observed - left @ beta) ** 2)) + system.rest.squares
        return cls(values, beta, right, outside, len(design) + system.rest.rows, rule)

    @property
    def grid(self) -> Array:
        """Return kappas between the squares of the smallest and the largest singular value, with equal ratios."""
        least = max(self.values[-1], ROUNDINGS * np.finfo(np.float64).eps * self.values[0], np.finfo(np.float64).tiny)
        least = min(least, 0.1 * self.values[0])  # at least two decades of kappa
        return np.geomspace(least**2, self.values[0] ** 2, GRID_POINTS)

    @property
    def wide(self) -> Array:
        """See :class:`RidgeCurves`.

        The ends have the residual of kappa = 0 and of x = 0 within rounding.
        """
        eps = np.finfo(np.float64).eps
        return np.geomspace(self.values[0] ** 2 * eps**3, self.values[0] ** 2 / eps, GRID_POINTS)

    def solution(self, kappa: float) -> Array:
        """Return the solution (u,) for a kappa."""
        x: Array = self.right.T @ (self.values * self.beta / (self.values**2 + kappa))
        return x

    def norm2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        return float(np.sum((self.values * self.beta / (self.values**2 + kappa)) ** 2))

    def norm2_slopes(self, kappa: float) -> tuple[float, float]:
        """See :class:`RidgeCurves`."""
        weight, shifted = (self.values * self.beta) ** 2, self.values**2 + kappa
        return float(-2.0 * np.sum(weight / shifted**3)), float(6.0 * np.sum(weight / shifted**4))

    def residual2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        return float(np.sum((kappa * self.beta / (self.values**2 + kappa)) ** 2)) + self.outside

    def trace(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        return float(np.sum(self.values**2 / (self.values**2 + kappa)))

    def creso(self, kappa: float) -> float:
        """Return X + 2 kappa dX/dkappa = d(kappa X - R)/dkappa (Colli-Franzone et al. 1985)."""
        return self.norm2(kappa) + 2.0 * kappa * self.norm2_slopes(kappa)[0]

    def creso_slope(self, kappa: float) -> float:
        """Return the derivative of the CRESO function, free of cancellation where the function is flat."""
        weight, squares = (self.values * self.beta) ** 2, self.values**2
        return float(6.0 * np.sum(weight * (kappa - squares) / (squares + kappa) ** 4))

    def likelihood(self, kappa: float) -> float:
        """Return the log of the marginal likelihood without its constant, for the estimated sigma (Wahba 1985)."""
        shares = kappa / (self.values**2 + kappa)  # eigenvalues of I - H
        quadratic = float(np.sum(shares * self.beta**2)) + self.outside
        return 0.5 * float(np.sum(np.log(shares))) - 0.5 * self.rows * float(np.log(quadratic))

    def change2(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        return float(np.sum((kappa * self.values * self.beta / (self.values**2 + kappa) ** 2) ** 2))

    def change2_slope(self, kappa: float) -> float:
        """See :class:`RidgeCurves`."""
        squares = self.values**2
        terms = (kappa * self.values * self.beta / (squares + kappa) ** 2) ** 2
        return float(np.sum(terms * (squares - kappa) / (squares + kappa)))


# --- for one kappa --------------------------------------------------------------------------------

#: Default solver. It uses [A; sqrt(kappa) L], whose condition number is the root of the
#: condition number of the normal matrix.
MODERN_SOLVER = "svd"


def regularised_system(system: LinearSystem, kappa: float, penalty: Array | None = None) -> LinearSystem:
    """Return the system N + kappa L^T L; also [A; sqrt(kappa) L] and [l; 0] if A is known.

    Parameters
    ----------
    system : LinearSystem
    kappa : float
    penalty : (k, u) array, optional
        L; default: identity.

    Raises
    ------
    InputError
        Kappa is negative or not finite, or L does not fit.
    """
    if not (np.isfinite(kappa) and kappa >= 0.0):
        raise InputError.of("linear.kappa_value", place="kappa", value=kappa)
    matrix = np.eye(len(system)) if penalty is None else penalty
    if matrix.ndim != 2 or matrix.shape[1] != len(system) or not np.isfinite(matrix).all():
        raise InputError.of("linear.penalty", place="L", value=f"shape {matrix.shape}", unknowns=len(system))
    if kappa == 0.0:
        return system
    normal = system.normal + kappa * (matrix.T @ matrix)
    if system.design is None or system.observed is None:
        return LinearSystem(normal, system.rhs, limit=system.limit)
    design = np.vstack([system.design, np.sqrt(kappa) * matrix])
    observed = np.concatenate([system.observed, np.zeros(len(matrix))])
    return LinearSystem(normal, system.rhs, design, observed, system.rest, system.limit)


def regularised(
    system: LinearSystem, kappa: float, penalty: Array | None = None, *, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Return the Tikhonov solution: the x that minimises |A x - l|^2 + kappa |L x|^2.

    ``solver`` solves the :func:`regularised_system`; kappa 0 gives least squares.
    Breakdown if the solver fails.
    """
    solution = solve(solver, regularised_system(system, kappa, penalty))
    return LinearSolution(solution.x, inverse=solution.inverse, rank=solution.rank, kappa=kappa, notes=solution.notes)


def tikhonov(
    system: LinearSystem, rule: str, given: Given | None = None, *, clamp: bool = False, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Return the Tikhonov solution with the kappa of a rule.

    ``rule``, ``given`` and ``clamp``: see :func:`choose_kappa`; ``solver`` solves the
    :func:`regularised_system`.

    Returns
    -------
    LinearSolution
        Solution with ``kappa`` and ``rule``.

    Raises
    ------
    InputError
        The rule is unknown or an input is missing.
    Breakdown
        The rule finds no kappa, or a solver fails.
    """
    choice = choose_kappa(rule, system, given, clamp=clamp)
    solution = regularised(system, choice.kappa, solver=solver)
    return replace(solution, rule=rule, notes=(*choice.notes, *solution.notes))
