"""Kappa rules that use a curve: L-curve, GCV, CRESO, discrepancy, CC and others, for the penalty |x|.

With A = U S V^T and beta = U^T l, x = V (s beta/(s^2 + kappa)); |x|^2 = X and |A x - l|^2 = R are sums over the
singular values. Curves and their derivatives are therefore exact. The published work names L-curve, GCV, CRESO,
"maximum" and "CC" without formulas; these are the standard forms.

The L-curve consists of |A x - l| and |x| of the Tikhonov solutions for all kappa (Hansen, O'Leary 1993). The kappa of
any rule, also of a rule without this curve, is a point on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from fg_orient.adjustment.linear.kappa import (
    Given,
    KappaChoice,
    KappaRule,
    RuleFunction,
    choose_kappa,
    kappa_rules,
    register_kappa_rule,
)
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSystem
from fg_orient.model.errors import FgOrientError, InputError

GRID_POINTS = 240
#: The grid starts at the smallest singular value, but not below 16 roundings of the largest (Hansen 1998).
ROUNDINGS = 16.0

Curve = Callable[[float], float]


@dataclass(frozen=True)
class Ridge:
    """Tikhonov solutions of a system for all kappa.

    Singular values (p,) of A, descending, beta = U^T l (p,), V^T (p, u), squared length of the part of l outside the
    range of A, number of rows of A, and the name of the rule for messages.
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
        return cls(values, beta, right, float(np.sum((observed - left @ beta) ** 2)), len(design), rule)

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


def _lowest(ridge: Ridge, function: Curve, *, sign: float = 1.0) -> KappaChoice:
    """Minimum of a curve (maximum for ``sign`` -1): on the grid, then between its neighbours."""
    grid, curve = ridge.grid, _along(function, ridge.grid)
    usable = np.where(np.isfinite(curve), sign * curve, np.inf)
    best = int(usable.argmin())
    if not np.isfinite(usable[best]):
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {ridge.rule}", value="curve not finite")
    if best in (0, len(grid) - 1):
        end = "lower" if best == 0 else "upper"
        return KappaChoice(float(grid[best]), ridge.rule, (f"kappa at the {end} end of its range",), grid, curve)
    bounds = (np.log(grid[best - 1]), np.log(grid[best + 1]))
    minimum = minimize_scalar(lambda t: sign * function(float(np.exp(t))), bounds=bounds, method="bounded")
    return KappaChoice(float(np.exp(minimum.x)), ridge.rule, (), grid, curve)


def _crossings(ridge: Ridge, function: Curve, missing: str, *, upward: bool, grid: Array | None = None) -> list[float]:
    """Kappas where a function changes sign in this direction, ascending; Breakdown with the text if there is none."""
    logs = np.log(ridge.grid if grid is None else grid)

    def at_log(t: float) -> float:
        return function(float(np.exp(t)))

    signs = np.sign([at_log(t) for t in logs]) * (1.0 if upward else -1.0)  # as brentq evaluates: exp(log(x)) is not x
    starts = np.flatnonzero((signs[:-1] < 0.0) & (signs[1:] >= 0.0))
    if not len(starts):
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {ridge.rule}", value=missing)
    return [float(np.exp(brentq(at_log, logs[i], logs[i + 1]))) for i in starts]


def _along(function: Curve, grid: Array) -> Array:
    return np.array([function(kappa) for kappa in grid])


def _curve_rule(
    name: str, label: str, source: str, *, needs: tuple[str, ...] = ()
) -> Callable[[Callable[[Ridge, Given], KappaChoice]], RuleFunction]:
    """Register a rule of the singular value decomposition of a system."""

    def add(function: Callable[[Ridge, Given], KappaChoice]) -> RuleFunction:
        rule = register_kappa_rule(name, label, source=source, needs=needs)
        return rule(lambda system, given: function(Ridge.of(system, name), given))

    return add


@_curve_rule("l_curve", "L-curve", "Hansen, O'Leary 1993")
def l_curve(ridge: Ridge, given: Given) -> KappaChoice:
    """Largest curvature of log|x| over log|A x - l|."""
    return _lowest(ridge, ridge.curvature, sign=-1.0)


@_curve_rule("gcv", "Generalised cross-validation", "Golub, Heath, Wahba 1979")
def gcv(ridge: Ridge, given: Given) -> KappaChoice:
    """Least n |(I - H) l|^2/(tr(I - H))^2."""
    return _lowest(ridge, ridge.gcv)


@_curve_rule("creso", "CRESO", "Colli-Franzone et al. 1985")
def creso(ridge: Ridge, given: Given) -> KappaChoice:
    """First local maximum of |x|^2 + 2 kappa d|x|^2/dkappa, from small kappa up.

    If the solution for small kappa is noise only, this maximum belongs to the smallest singular values, and the kappa
    is far too small.
    """
    kappas = _crossings(ridge, ridge.creso_slope, "no local maximum", upward=False)
    return KappaChoice(kappas[0], "creso", (), ridge.grid, _along(ridge.creso, ridge.grid))


@_curve_rule("maximum", "Maximum likelihood", "Wahba 1985; the published work names 'maximum' only")
def maximum(ridge: Ridge, given: Given) -> KappaChoice:
    """Largest likelihood of l under l = A x + e, x normal with variance sigma^2/kappa: our reading of "maximum"."""
    return _lowest(ridge, ridge.likelihood, sign=-1.0)


@_curve_rule("zero_crossing", "Zero crossing", "Johnston, Gulrajani 1997")
def zero_crossing(ridge: Ridge, given: Given) -> KappaChoice:
    """Smallest kappa with kappa |x|^2 = |A x - l|^2."""

    def balance(kappa: float) -> float:
        return kappa * ridge.norm2(kappa) - ridge.residual2(kappa)

    kappas = _crossings(ridge, balance, "no crossing", upward=True)
    return KappaChoice(kappas[0], "zero_crossing", (), ridge.grid, _along(balance, ridge.grid))


@_curve_rule("quasi_optimality", "Quasi-optimality", "Tikhonov, Glasko 1965")
def quasi_optimality(ridge: Ridge, given: Given) -> KappaChoice:
    """Lowest local minimum of |kappa dx/dkappa|."""
    kappas = _crossings(ridge, ridge.change2_slope, "no local minimum", upward=True)
    curve = np.sqrt(_along(ridge.change2, ridge.grid))
    return KappaChoice(min(kappas, key=ridge.change2), "quasi_optimality", (), ridge.grid, curve)


@_curve_rule("discrepancy", "Discrepancy principle", "Morozov 1966", needs=("noise_norm",))
def discrepancy(ridge: Ridge, given: Given) -> KappaChoice:
    """Kappa with |A x - l| = the norm of the noise; the residual grows with kappa, so there is at most one."""
    # beyond these ends the residual equals that of kappa = 0 and of x = 0 within rounding
    eps, target = np.finfo(np.float64).eps, float(given.noise_norm or 0.0)
    wide = np.geomspace(ridge.values[0] ** 2 * eps**3, ridge.values[0] ** 2 / eps, GRID_POINTS)

    def excess(kappa: float) -> float:
        return float(np.sqrt(ridge.residual2(kappa))) - target

    low, high = excess(wide[0]) + target, excess(wide[-1]) + target
    reach = f"noise {target:.3g}, residuals {low:.3g} to {high:.3g}"
    kappas = _crossings(ridge, excess, reach, upward=True, grid=wide)
    return KappaChoice(kappas[0], "discrepancy", (), ridge.grid, _along(excess, ridge.grid))


@_curve_rule("cc", "CC", "named only in Terlemezoğlu 2019", needs=("truth",))
def cc(ridge: Ridge, given: Given) -> KappaChoice:
    """Largest correlation x^T t/(|x||t|) with the true solution t, which only simulations provide."""
    truth, u = np.asarray(given.truth, dtype=np.float64), ridge.right.shape[1]
    if truth.shape != (u,) or not np.isfinite(truth).all():
        raise InputError.of("linear.truth", place="kappa rule cc", value=f"shape {truth.shape}", unknowns=u)

    def correlation(kappa: float) -> float:
        x = ridge.solution(kappa)
        return float(x @ truth / np.sqrt((x @ x) * (truth @ truth)))

    return _lowest(ridge, correlation, sign=-1.0)


#: Kappas of a recorded curve, in equal ratios.
CURVE_POINTS: Final = 121


@dataclass(frozen=True)
class Choice:
    """The kappa of one rule and its point on the curve: |A x - l| and |x|.

    The numbers are nan if the rule fails, for the reason in ``failure``. ``notes`` are remarks: clamping, kappa at the
    end of the range.
    """

    rule: str
    label: str
    kappa: float
    residual_norm: float
    solution_norm: float
    notes: tuple[str, ...] = ()
    failure: str = ""


@dataclass(frozen=True)
class LCurve:
    """Norms of the Tikhonov solutions of a system.

    Parameters
    ----------
    kappa : (n,) array
        Ascending, in equal ratios.
    residual_norm, solution_norm : (n,) array
        |A x - l|, which increases with kappa, and |x|, which decreases.
    curvature : (n,) array
        Curvature of (log residual_norm, log solution_norm); largest at the corner.
    choices : tuple of Choice
        Kappas of the rules that need no further inputs.
    """

    kappa: Array
    residual_norm: Array
    solution_norm: Array
    curvature: Array
    choices: tuple[Choice, ...]

    def place(self, kappa: float) -> tuple[float, float]:
        """Norms of residuals and solution at a kappa: those of a rule with this kappa, else interpolated.

        They are nan outside the range of the curve.
        """
        for choice in self.choices:
            if choice.kappa == kappa:
                return choice.residual_norm, choice.solution_norm
        if not self.kappa[0] <= kappa <= self.kappa[-1]:
            return float("nan"), float("nan")
        at = np.log(kappa), np.log(self.kappa)
        residual, solution = (np.interp(*at, np.log(norm)) for norm in (self.residual_norm, self.solution_norm))
        return float(np.exp(residual)), float(np.exp(solution))


def l_curve_of(system: LinearSystem) -> LCurve:
    """L-curve of a system with the kappas of all rules that need no further inputs.

    Parameters
    ----------
    system : LinearSystem
        Its design matrix is required.

    Returns
    -------
    LCurve
        Its range contains every positive kappa that a rule chose.

    Raises
    ------
    InputError
        A is not known.
    Breakdown
        A is zero.
    """
    ridge = Ridge.of(system, "l_curve")
    choices = tuple(_choice(rule, system, ridge) for rule in kappa_rules().values() if not rule.needs)
    chosen = [c.kappa for c in choices if c.kappa > 0.0]
    kappa = np.geomspace(min(ridge.grid[0], *chosen), max(ridge.grid[-1], *chosen), CURVE_POINTS)
    with np.errstate(all="ignore"):  # the curvature is not defined where the residual is zero
        curvature = np.array([ridge.curvature(k) for k in kappa])
    residual, solution = (np.sqrt([norm(k) for k in kappa]) for norm in (ridge.residual2, ridge.norm2))
    return LCurve(kappa, residual, solution, curvature, choices)


def _choice(rule: KappaRule, system: LinearSystem, ridge: Ridge) -> Choice:
    """Apply a rule; kappas of published rules are clamped, as in their solvers."""
    try:
        choice = choose_kappa(rule.name, system, clamp=rule.published)
    except FgOrientError as error:
        nan = float("nan")
        return Choice(rule.name, rule.label, nan, nan, nan, failure="; ".join(p.message for p in error.problems))
    with np.errstate(all="ignore"):  # a singular system has no unique solution for kappa = 0
        norms = np.sqrt(ridge.residual2(choice.kappa)), np.sqrt(ridge.norm2(choice.kappa))
    return Choice(rule.name, rule.label, choice.kappa, float(norms[0]), float(norms[1]), choice.notes)
