"""The L-curve of a system, and the kappas of the rules as places on it: what a choice of kappa is judged by.

The curve holds |A x - l| and |x| of the Tikhonov solutions for all kappa (Hansen, O'Leary 1993). A rule that reads
kappa off another function, or off no curve at all, still chooses one of these solutions and so a place on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.kappa import KappaRule, choose_kappa, kappa_rules
from fg_orient.adjustment.linear.kappa_graph import Ridge
from fg_orient.adjustment.linear.system import Array, LinearSystem
from fg_orient.model.errors import FgOrientError

#: Kappas of a recorded curve, in equal ratios.
CURVE_POINTS: Final = 121


@dataclass(frozen=True)
class Choice:
    """The kappa of one rule and its place on the curve.

    Parameters
    ----------
    rule, label : str
        "gcv", "Generalised cross-validation".
    kappa : float
        nan where the rule finds none.
    residual_norm, solution_norm : float
        |A x - l| and |x| of its solution; nan where there is none.
    notes : tuple of str
        Clamping, a choice at the end of the range.
    failure : str
        Why there is no kappa; "" if there is one.
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
        |A x - l|, rising with kappa, and |x|, falling.
    curvature : (n,) array
        Of (log residual_norm, log solution_norm); largest at the corner.
    choices : tuple of Choice
        Of the rules that need the system alone.
    """

    kappa: Array
    residual_norm: Array
    solution_norm: Array
    curvature: Array
    choices: tuple[Choice, ...]

    def place(self, kappa: float) -> tuple[float, float]:
        """Norms of residuals and solution at a kappa: of the rule that chose it, else interpolated; nan beyond."""
        for choice in self.choices:
            if choice.kappa == kappa:
                return choice.residual_norm, choice.solution_norm
        if not self.kappa[0] <= kappa <= self.kappa[-1]:
            return float("nan"), float("nan")
        at = np.log(kappa), np.log(self.kappa)
        found = (float(np.exp(np.interp(*at, np.log(norm)))) for norm in (self.residual_norm, self.solution_norm))
        return next(found), next(found)


def l_curve_of(system: LinearSystem) -> LCurve:
    """L-curve of a system with the choices of all rules that need nothing else.

    Parameters
    ----------
    system : LinearSystem
        With its design matrix.

    Returns
    -------
    LCurve
        Its range holds every kappa above zero that a rule chose.

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
    with np.errstate(all="ignore"):  # curvature has no value where the residual is zero
        curvature = np.array([ridge.curvature(k) for k in kappa])
    residual, solution = (np.sqrt([norm(k) for k in kappa]) for norm in (ridge.residual2, ridge.norm2))
    return LCurve(kappa, residual, solution, curvature, choices)


def _choice(rule: KappaRule, system: LinearSystem, ridge: Ridge) -> Choice:
    """Place of a rule; those of the publication are clamped as their solvers clamp them."""
    try:
        found = choose_kappa(rule.name, system, clamp=rule.published)
    except FgOrientError as error:
        nan = float("nan")
        return Choice(rule.name, rule.label, nan, nan, nan, failure="; ".join(p.message for p in error.problems))
    with np.errstate(all="ignore"):  # kappa 0 of a singular system has no solution of its own
        norms = np.sqrt(ridge.residual2(found.kappa)), np.sqrt(ridge.norm2(found.kappa))
    return Choice(rule.name, rule.label, found.kappa, float(norms[0]), float(norms[1]), found.notes)
