"""L-curve of a system, with the kappas of all rules as points on it.

The curve consists of |A x - l| and |x| of the Tikhonov solutions for all kappa (Hansen,
O'Leary 1993). The kappa of any rule, also of a rule that does not use this curve, is a
point on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.kappa import Given, KappaRule, choose_kappa, kappa_rules
from fg_orient.adjustment.linear.ridge import Ridge
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.errors import FgOrientError

#: Number of kappas of a recorded curve. Their ratios are equal.
CURVE_POINTS: Final = 121


@dataclass(frozen=True)
class Choice:
    """Kappa of one rule, and its point on the curve: |A x - l| and |x|.

    If the rule fails, the numbers are nan, and ``failure`` contains the reason. ``notes``
    are remarks, for example on clamping, or on a kappa at the end of the range.
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
        Kappas of the rules whose inputs are known.
    """

    kappa: Array
    residual_norm: Array
    solution_norm: Array
    curvature: Array
    choices: tuple[Choice, ...]

    def place(self, kappa: float) -> tuple[float, float]:
        """Return the norms of residuals and solution at a kappa: exact for the kappa of a rule, else interpolated.

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


def l_curve_of(system: LinearSystem, given: Given | None = None) -> LCurve:
    """Return the L-curve of a system with the kappas of all rules whose inputs are known.

    Parameters
    ----------
    system : LinearSystem
        Its design matrix is required.
    given : Given, optional
        Additional inputs. If they are missing, the kappas of the published rules are clamped, as in the
        published solvers.

    Returns
    -------
    LCurve
        L-curve; its range contains every positive kappa that a rule chose.

    Raises
    ------
    InputError
        A is not known.
    Breakdown
        A is zero.
    """
    ridge = Ridge.of(system, "l_curve")
    known = [r for r in kappa_rules().values() if all(getattr(given or Given(), n) is not None for n in r.needs)]
    choices = tuple(_choice(rule, system, ridge, given) for rule in known)
    chosen = [c.kappa for c in choices if c.kappa > 0.0]
    kappa = np.geomspace(min(ridge.grid[0], *chosen), max(ridge.grid[-1], *chosen), CURVE_POINTS)
    with np.errstate(all="ignore"):  # the curvature is not defined where the residual is zero
        curvature = np.array([ridge.curvature(k) for k in kappa])
    residual, solution = (np.sqrt([norm(k) for k in kappa]) for norm in (ridge.residual2, ridge.norm2))
    return LCurve(kappa, residual, solution, curvature, choices)


def _choice(rule: KappaRule, system: LinearSystem, ridge: Ridge, given: Given | None) -> Choice:
    """Apply a rule; see :func:`l_curve_of`."""
    try:
        choice = choose_kappa(rule.name, system, given, clamp=rule.published and given is None)
    except FgOrientError as error:
        nan = float("nan")
        return Choice(rule.name, rule.label, nan, nan, nan, failure="; ".join(p.message for p in error.problems))
    with np.errstate(all="ignore"):  # a singular system has no unique solution for kappa = 0
        norms = np.sqrt(ridge.residual2(choice.kappa)), np.sqrt(ridge.norm2(choice.kappa))
    return Choice(rule.name, rule.label, choice.kappa, float(norms[0]), float(norms[1]), choice.notes)
