"""Kappa rules that use a curve: L-curve, GCV, CRESO, discrepancy, CC and others, for the penalty |x|.

The published work names L-curve, GCV, CRESO, "maximum" and "CC" without formulas; these are the standard forms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import Given, KappaChoice, RuleFunction, register_kappa_rule
from fg_orient.adjustment.linear.ridge import Ridge, RidgeCurves
from fg_orient.adjustment.linear.system import Breakdown
from fg_orient.model.errors import InputError

Curve = Callable[[float], float]
#: Rules as functions of the solutions for all kappa.
_CURVES: dict[str, Callable[[Any, Given], KappaChoice]] = {}
#: Rules that need no singular value decomposition.
SAMPLED: Final = ("l_curve", "gcv", "discrepancy", "quasi_optimality", "zero_crossing")


def on_curves(name: str, curves: RidgeCurves, given: Given) -> KappaChoice:
    """Apply one of the rules :data:`SAMPLED`; Breakdown if it finds no kappa."""
    with np.errstate(all="ignore"):
        return _CURVES[name](curves, given)


def _lowest(ridge: RidgeCurves, function: Curve, *, sign: float = 1.0) -> KappaChoice:
    """Find the minimum of a curve, or its maximum if ``sign`` is -1: first on the grid, then between the neighbours."""
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


def _crossings(
    ridge: RidgeCurves, function: Curve, missing: str, *, upward: bool, grid: Array | None = None
) -> list[float]:
    """Return the kappas where a function changes its sign in this direction, ascending.

    If there is no such kappa, Breakdown is raised with the text ``missing``.
    """
    logs = np.log(ridge.grid if grid is None else grid)

    def at_log(t: float) -> float:
        return function(float(np.exp(t)))

    # brentq evaluates at exp(log(x)), which differs from x; the signs are therefore computed at the
    # same values
    signs = np.sign([at_log(t) for t in logs]) * (1.0 if upward else -1.0)
    starts = np.flatnonzero((signs[:-1] < 0.0) & (signs[1:] >= 0.0))
    if not len(starts):
        raise Breakdown.of("linear.no_kappa", place=f"kappa rule {ridge.rule}", value=missing)
    return [float(np.exp(brentq(at_log, logs[i], logs[i + 1]))) for i in starts]


def _along(function: Curve, grid: Array) -> Array:
    return np.array([function(kappa) for kappa in grid])


def _curve_rule(
    name: str, label: str, source: str, *, needs: tuple[str, ...] = ()
) -> Callable[[Callable[[Ridge, Given], KappaChoice]], RuleFunction]:
    """Register a rule that uses the singular value decomposition of a system."""

    def add(function: Callable[[Any, Given], KappaChoice]) -> RuleFunction:
        _CURVES[name] = function
        rule = register_kappa_rule(name, label, source=source, needs=needs)
        return rule(lambda system, given: function(Ridge.of(system, name), given))

    return add


@_curve_rule("l_curve", "L-curve", "Hansen, O'Leary 1993")
def l_curve(ridge: RidgeCurves, given: Given) -> KappaChoice:
    """Maximise the curvature of log|x| over log|A x - l|."""
    return _lowest(ridge, ridge.curvature, sign=-1.0)


@_curve_rule("gcv", "Generalised cross-validation", "Golub, Heath, Wahba 1979")
def gcv(ridge: RidgeCurves, given: Given) -> KappaChoice:
    """Minimise n |(I - H) l|^2/(tr(I - H))^2."""
    return _lowest(ridge, ridge.gcv)


@_curve_rule("creso", "CRESO", "Colli-Franzone et al. 1985")
def creso(ridge: Ridge, given: Given) -> KappaChoice:
    """Find the first local maximum of |x|^2 + 2 kappa d|x|^2/dkappa, from small kappa up.

    If the solution for small kappa contains only noise, this maximum belongs to the
    smallest singular values, and kappa is far too small.
    """
    kappas = _crossings(ridge, ridge.creso_slope, "no local maximum", upward=False)
    return KappaChoice(kappas[0], "creso", (), ridge.grid, _along(ridge.creso, ridge.grid))


@_curve_rule("maximum", "Maximum likelihood", "Wahba 1985; the published work names 'maximum' only")
def maximum(ridge: Ridge, given: Given) -> KappaChoice:
    """Maximise the likelihood of l = A x + e, x normal with variance sigma^2/kappa: our interpretation of "maximum"."""
    return _lowest(ridge, ridge.likelihood, sign=-1.0)


@_curve_rule("zero_crossing", "Zero crossing", "Johnston, Gulrajani 1997")
def zero_crossing(ridge: RidgeCurves, given: Given) -> KappaChoice:
    """Find the smallest kappa for which kappa |x|^2 = |A x - l|^2."""

    def balance(kappa: float) -> float:
        return kappa * ridge.norm2(kappa) - ridge.residual2(kappa)

    kappas = _crossings(ridge, balance, "no crossing", upward=True)
    return KappaChoice(kappas[0], "zero_crossing", (), ridge.grid, _along(balance, ridge.grid))


@_curve_rule("quasi_optimality", "Quasi-optimality", "Tikhonov, Glasko 1965")
def quasi_optimality(ridge: RidgeCurves, given: Given) -> KappaChoice:
    """Find the lowest local minimum of |kappa dx/dkappa|."""
    kappas = _crossings(ridge, ridge.change2_slope, "no local minimum", upward=True)
    curve = np.sqrt(_along(ridge.change2, ridge.grid))
    return KappaChoice(min(kappas, key=ridge.change2), "quasi_optimality", (), ridge.grid, curve)


@_curve_rule("discrepancy", "Discrepancy principle", "Morozov 1966", needs=("noise_norm",))
def discrepancy(ridge: RidgeCurves, given: Given) -> KappaChoice:
    """Find the kappa for which |A x - l| is the norm of the noise.

    The residual grows with kappa, so that there is at most one such kappa.
    """
    target, wide = float(given.noise_norm or 0.0), ridge.wide

    def excess(kappa: float) -> float:
        return float(np.sqrt(ridge.residual2(kappa))) - target

    low, high = excess(wide[0]) + target, excess(wide[-1]) + target
    reach = f"noise {target:.3g}, residuals {low:.3g} to {high:.3g}"
    kappas = _crossings(ridge, excess, reach, upward=True, grid=wide)
    return KappaChoice(kappas[0], "discrepancy", (), ridge.grid, _along(excess, ridge.grid))


@_curve_rule("cc", "CC", "named only in Terlemezoğlu 2019", needs=("truth",))
def cc(ridge: Ridge, given: Given) -> KappaChoice:
    """Maximise the correlation x^T t/(|x||t|) with the true solution t, which is known only in simulations."""
    truth, u = np.asarray(given.truth, dtype=np.float64), ridge.right.shape[1]
    if truth.shape != (u,) or not np.isfinite(truth).all():
        raise InputError.of("linear.truth", place="kappa rule cc", value=f"shape {truth.shape}", unknowns=u)

    def correlation(kappa: float) -> float:
        x = ridge.solution(kappa)
        return float(x @ truth / np.sqrt((x @ x) * (truth @ truth)))

    return _lowest(ridge, correlation, sign=-1.0)
