"""Rules that read kappa off a curve: L-curve, GCV, CRESO, discrepancy, CC and others, for the penalty |x|.

With A = U S V^T, beta = U^T l: x = V (s beta/(s^2 + kappa)), |x|^2 = X and |A x - l|^2 = R are sums over the
singular values, so that curves and their derivatives are exact. The published work names L-curve, GCV,
CRESO, "maximum" and "CC" without formulas; these are the standard forms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from fg_orient.adjustment.linear.kappa import Given, KappaChoice, register_kappa_rule
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSystem
from fg_orient.model.errors import InputError

GRID_POINTS = 240
#: The grid starts where the smallest singular value is, but not below 16 roundings of the largest (Hansen 1998).
ROUNDINGS = 16.0

Curve = Callable[[float], float]


@dataclass(frozen=True)
class Ridge:
    """Tikhonov solutions of a system for all kappa.

    Parameters
    ----------
    values : (p,) array
        Singular values of A, descending.
    beta : (p,) array
        U^T l.
    right : (p, u) array
        V^T.
    outside : float
        Squared length of the part of l that no x can reach.
    rows : int
    """

    values: Array
    beta: Array
    right: Array
    outside: float
    rows: int

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
        return cls(values, beta, right, float(np.sum((observed - left @ beta) ** 2)), len(design))

    @property
    def grid(self) -> Array:
        """Kappas between the squares of the smallest and the largest singular value, in equal ratios."""
        least = max(self.values[-1], ROUNDINGS * np.finfo(np.float64).eps * self.values[0], np.finfo(np.float64).tiny)
        least = min(least, 0.1 * self.values[0])  # two decades of kappa at least
        return np.geomspace(least**2, self.values[0] ** 2, GRID_POINTS)

    def solution(self, kappa: float) -> Array:
        """Solution (u,) of a kappa."""
        x: Array = self.right.T @ (self.values * self.beta / (self.values**2 + kappa))
        return x

    def norm2(self, kappa: float) -> float:
        """X = |x|^2."""
        return float(np.sum((self.values * self.beta / (self.values**2 + kappa)) ** 2))

    def norm2_slopes(self, kappa: float) -> tuple[float, float]:
        """First and second derivative of X by kappa."""
        weight, shifted = (self.values * self.beta) ** 2, self.values**2 + kappa
        return float(-2.0 * np.sum(weight / shifted**3)), float(6.0 * np.sum(weight / shifted**4))

    def residual2(self, kappa: float) -> float:
        """R = |A x - l|^2; dR/dkappa = -kappa dX/dkappa."""
        return float(np.sum((kappa * self.beta / (self.values**2 + kappa)) ** 2)) + self.outside

    def curvature(self, kappa: float) -> float:
        """Curvature of (log|A x - l|, log|x|) by log kappa (Hansen, O'Leary 1993)."""
        norm, residual = self.norm2(kappa), self.residual2(kappa)
        slope, second = self.norm2_slopes(kappa)
        eta = 0.5 * kappa * slope / norm
        rho = -0.5 * kappa**2 * slope / residual
        eta2 = 0.5 * (kappa * slope + kappa**2 * second) / norm - 2.0 * eta**2
        rho2 = -0.5 * (2.0 * kappa**2 * slope + kappa**3 * second) / residual - 2.0 * rho**2
        return float((rho * eta2 - rho2 * eta) / (rho**2 + eta**2) ** 1.5)

    def gcv(self, kappa: float) -> float:
        """GCV function n |(I - H) l|^2/(tr(I - H))^2 (Golub, Heath, Wahba 1979)."""
        trace = self.rows - float(np.sum(self.values**2 / (self.values**2 + kappa)))
        return self.rows * self.residual2(kappa) / trace**2

    def creso(self, kappa: float) -> float:
        """X + 2 kappa dX/dkappa = d(kappa X - R)/dkappa (Colli-Franzone et al. 1985)."""
        return self.norm2(kappa) + 2.0 * kappa * self.norm2_slopes(kappa)[0]

    def creso_slope(self, kappa: float) -> float:
        """Derivative of the CRESO function, free of cancellation where the function is flat."""
        weight, squares = (self.values * self.beta) ** 2, self.values**2
        return float(6.0 * np.sum(weight * (kappa - squares) / (squares + kappa) ** 4))

    def likelihood(self, kappa: float) -> float:
        """Logarithm of the marginal likelihood but for a constant, sigma estimated (Wahba 1985)."""
        shares = kappa / (self.values**2 + kappa)  # eigenvalues of I - H
        quadratic = float(np.sum(shares * self.beta**2)) + self.outside
        return 0.5 * float(np.sum(np.log(shares))) - 0.5 * self.rows * float(np.log(quadratic))

    def change2(self, kappa: float) -> float:
        """|kappa dx/dkappa|^2, the quasi-optimality function (Tikhonov, Glasko 1965)."""
        return float(np.sum((kappa * self.values * self.beta / (self.values**2 + kappa) ** 2) ** 2))

    def change2_slope(self, kappa: float) -> float:
        """Half the derivative of :meth:`change2` by log kappa."""
        squares = self.values**2
        terms = (kappa * self.values * self.beta / (squares + kappa) ** 2) ** 2
        return float(np.sum(terms * (squares - kappa) / (squares + kappa)))


def _lowest(rule: str, function: Curve, grid: Array, *, sign: float = 1.0) -> KappaChoice:
    """Minimum of a curve (maximum for ``sign`` -1): on the grid, then between its neighbours."""
    curve = np.array([function(kappa) for kappa in grid])
    usable = np.where(np.isfinite(curve), sign * curve, np.inf)
    best = int(usable.argmin())
    if not np.isfinite(usable[best]):
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {rule}", value="curve not finite")
    if best in (0, len(grid) - 1):
        end = "lower" if best == 0 else "upper"
        return KappaChoice(float(grid[best]), rule, (f"kappa at the {end} end of its range",), grid, curve)
    bounds = (np.log(grid[best - 1]), np.log(grid[best + 1]))
    found = minimize_scalar(lambda t: sign * function(float(np.exp(t))), bounds=bounds, method="bounded")
    return KappaChoice(float(np.exp(found.x)), rule, (), grid, curve)


def _crossings(function: Curve, grid: Array, *, upward: bool) -> list[float]:
    """Kappas where a function changes sign, from below to above zero or the other way, ascending."""
    logs = np.log(grid)

    def at_log(t: float) -> float:
        return function(float(np.exp(t)))

    signs = np.sign([at_log(t) for t in logs]) * (1.0 if upward else -1.0)  # where brentq looks: exp(log(x)) is not x
    starts = np.flatnonzero((signs[:-1] < 0.0) & (signs[1:] >= 0.0))
    return [float(np.exp(brentq(at_log, logs[i], logs[i + 1]))) for i in starts]


def _required(rule: str, found: list[float], what: str) -> list[float]:
    """Refuse an empty list of candidates."""
    if not found:
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {rule}", value=what)
    return found


def _along(function: Curve, grid: Array) -> Array:
    return np.array([function(kappa) for kappa in grid])


@register_kappa_rule("l_curve", "L-curve", source="Hansen, O'Leary 1993")
def l_curve(system: LinearSystem, given: Given) -> KappaChoice:
    """Largest curvature of log|x| over log|A x - l|."""
    ridge = Ridge.of(system, "l_curve")
    return _lowest("l_curve", ridge.curvature, ridge.grid, sign=-1.0)


@register_kappa_rule("gcv", "Generalised cross-validation", source="Golub, Heath, Wahba 1979")
def gcv(system: LinearSystem, given: Given) -> KappaChoice:
    """Least n |(I - H) l|^2/(tr(I - H))^2."""
    ridge = Ridge.of(system, "gcv")
    return _lowest("gcv", ridge.gcv, ridge.grid)


@register_kappa_rule("creso", "CRESO", source="Colli-Franzone et al. 1985")
def creso(system: LinearSystem, given: Given) -> KappaChoice:
    """First local maximum of |x|^2 + 2 kappa d|x|^2/dkappa, from small kappa up.

    Where the solution is all noise at small kappa, that maximum belongs to the smallest singular values and the kappa
    is far too small.
    """
    ridge = Ridge.of(system, "creso")
    found = _required("creso", _crossings(ridge.creso_slope, ridge.grid, upward=False), "no local maximum")
    return KappaChoice(found[0], "creso", (), ridge.grid, _along(ridge.creso, ridge.grid))


@register_kappa_rule("maximum", "Maximum likelihood", source="Wahba 1985; the published work names 'maximum' only")
def maximum(system: LinearSystem, given: Given) -> KappaChoice:
    """Largest likelihood of l under l = A x + e, x normal with variance sigma^2/kappa: our reading of "maximum"."""
    ridge = Ridge.of(system, "maximum")
    return _lowest("maximum", ridge.likelihood, ridge.grid, sign=-1.0)


@register_kappa_rule("zero_crossing", "Zero crossing", source="Johnston, Gulrajani 1997")
def zero_crossing(system: LinearSystem, given: Given) -> KappaChoice:
    """Smallest kappa with kappa |x|^2 = |A x - l|^2."""
    ridge = Ridge.of(system, "zero_crossing")

    def balance(kappa: float) -> float:
        return kappa * ridge.norm2(kappa) - ridge.residual2(kappa)

    found = _required("zero_crossing", _crossings(balance, ridge.grid, upward=True), "no crossing")
    return KappaChoice(found[0], "zero_crossing", (), ridge.grid, _along(balance, ridge.grid))


@register_kappa_rule("quasi_optimality", "Quasi-optimality", source="Tikhonov, Glasko 1965")
def quasi_optimality(system: LinearSystem, given: Given) -> KappaChoice:
    """Lowest local minimum of |kappa dx/dkappa|."""
    ridge = Ridge.of(system, "quasi_optimality")
    found = _crossings(ridge.change2_slope, ridge.grid, upward=True)
    found = _required("quasi_optimality", found, "no local minimum")
    curve = np.sqrt(_along(ridge.change2, ridge.grid))
    return KappaChoice(min(found, key=ridge.change2), "quasi_optimality", (), ridge.grid, curve)


@register_kappa_rule("discrepancy", "Discrepancy principle", source="Morozov 1966", needs=("noise_norm",))
def discrepancy(system: LinearSystem, given: Given) -> KappaChoice:
    """Kappa with |A x - l| = the norm of the noise; the residual grows with kappa, so there is at most one."""
    ridge, target = Ridge.of(system, "discrepancy"), float(given.noise_norm or 0.0)
    # beyond these ends the residual is that of kappa = 0 and of x = 0 within rounding
    eps = np.finfo(np.float64).eps
    wide = np.geomspace(ridge.values[0] ** 2 * eps**3, ridge.values[0] ** 2 / eps, GRID_POINTS)

    def excess(kappa: float) -> float:
        return float(np.sqrt(ridge.residual2(kappa))) - target

    low, high = excess(wide[0]) + target, excess(wide[-1]) + target
    reach = f"noise {target:.3g}, residuals {low:.3g} to {high:.3g}"
    found = _required("discrepancy", _crossings(excess, wide, upward=True), reach)
    return KappaChoice(found[0], "discrepancy", (), ridge.grid, _along(excess, ridge.grid))


@register_kappa_rule("cc", "CC", source="named only in Terlemezoğlu 2019", needs=("truth",))
def cc(system: LinearSystem, given: Given) -> KappaChoice:
    """Largest correlation x^T t/(|x||t|) with the true solution t: only simulations know it."""
    ridge, truth = Ridge.of(system, "cc"), np.asarray(given.truth, dtype=np.float64)
    if truth.shape != system.rhs.shape or not np.isfinite(truth).all():
        raise InputError.of("linear.truth", place="kappa rule cc", value=f"shape {truth.shape}", unknowns=len(system))

    def correlation(kappa: float) -> float:
        x = ridge.solution(kappa)
        return float(x @ truth / np.sqrt((x @ x) * (truth @ truth)))

    return _lowest("cc", correlation, ridge.grid, sign=-1.0)
