"""One round of the estimation of variance components, from one solution.

Formulas: ``fg_orient.quality.variance_components``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fg_orient.model.arrays import Array, Index, Mask
from fg_orient.quality.grouped_residuals import GroupedResiduals
from fg_orient.quality.hypotheses import CHECKED

Method = Literal["helmert", "median"]


@dataclass(frozen=True, eq=False)
class Round:
    """Result of one round.

    Parameters
    ----------
    variance : (g,) array
        Factors of the variances; 1 if the component is held.
    negative : (g,) bool array
        Groups without a positive variance from Helmert's equations.
    held : tuple of str
        Reasons why components are held, one per group.
    covariance : (g, g) array
        Of the variances; nan in rows and columns of held components.
    count, redundancy : (g,) arrays
    exact : bool
    """

    variance: Array
    negative: Mask
    held: tuple[str, ...]
    covariance: Array
    count: Index
    redundancy: Array
    exact: bool


def one_round(
    residuals: GroupedResiduals, method: Method = "helmert", *, keep: Sequence[bool] = (), judge: bool = True
) -> Round:
    """Estimate the components from one solution.

    Parameters
    ----------
    residuals : GroupedResiduals
    method : str
    keep : sequence of bool
        Components that are held in any case.
    judge : bool
        False: hold only groups that no observation checks. Helmert's equations are unbiased for any weights and
        correct sigmas that are wrong by orders of magnitude, even if a group has no redundancy with these sigmas.
    """
    q, r, count = residuals.sums()
    shared = None if residuals.parts is None else residuals.parts.shared
    s = np.diag(np.append(r, 0.0)) if shared is None else shared
    medians = residuals.medians() if method == "median" else np.ones(len(r))
    nothing = (r <= CHECKED) | np.isnan(medians)
    held = ["nothing checks them" if none else "" for none in nothing]
    free, inverse = _hold(s[:-1, :-1], r, held, keep, judge)
    variance, negative = np.ones(len(r)), np.zeros(len(r), bool)
    if free.any():
        known = s[:-1][:, [*np.flatnonzero(~free), len(r)]].sum(axis=1)[free]
        helmert = inverse @ (q[free] - known)
        negative[free] = (helmert <= 0.0) & judge & (shared is not None)
        positive = np.where((helmert > 0.0) & (shared is not None), helmert, q[free] / r[free])
        variance[free] = medians[free] if method == "median" else positive
    covariance = np.full((len(r), len(r)), np.nan)
    covariance[np.ix_(free, free)] = 2.0 * inverse
    return Round(variance, negative & (method == "helmert"), tuple(held), covariance, count, r, shared is not None)


def _hold(s: Array, r: Array, held: list[str], keep: Sequence[bool], judge: bool) -> tuple[Mask, Array]:
    """Hold components, the worst first, until each estimate is larger than its standard deviation.

    Adds the reasons to ``held``; returns the free components and the inverse of their S.
    """
    kept = np.array(keep or [False] * len(r), bool)
    while True:
        free = np.array([not text for text in held], bool)
        scale = np.sqrt(np.outer(r[free], r[free]))  # redundancies may differ by orders of magnitude
        inverse = np.linalg.pinv(s[np.ix_(free, free)] / scale, rcond=1e-10, hermitian=True) / scale
        sd = np.zeros(len(r))
        # 1 / r: the least possible variance, for a singular S
        sd[free] = np.sqrt(2.0 * np.maximum(np.diag(inverse), 1.0 / r[free]))
        worst = int(np.argmax(np.where(kept & free, np.inf, sd)))
        if not (kept & free).any() and (sd[worst] < 1.0 or not judge):
            return free, inverse
        held[worst] = f"a redundancy of {r[worst]:.1f} leaves its variance uncertain by {100.0 * sd[worst]:.0f} %"
        if kept[worst]:  # redundancy and uncertainty are those at the given sigma
            held[worst] = (
                f"estimated it would leave itself too little redundancy; at the given sigma it is {r[worst]:.1f}"
            )
