"""Points that lie off what the others agree on, in results without redundancy numbers: all kinds but the bundle.

A residual over its given standard deviation, or over the one that the others show where that is larger or none is
given: externally studentised (Cook and Weisberg 1982, section 2.2.1), its redundancy number taken as 1. That makes the
ratio too small, never too large. Points of an intersection do not depend on each other: each is judged as a whole.
The tests of ``fg_orient.quality.hypotheses`` need the cofactors that a record does not hold. Nothing is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.model.distributions import chi_square_limit, f_quantile, sidak
from fg_orient.report.words import number

#: What is smaller is rounding: a point of exact data stands out by it, in metres or image units.
ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Group:
    """Residuals of one adjustment.

    Parameters
    ----------
    redundancy : int
    absolute : bool
        Standard deviations were given.
    residuals : list of (float, float, int, str)
        Size; the same over its given standard deviation, or again the size without any; its redundancy; what it is.
    """

    redundancy: int
    absolute: bool
    residuals: list[tuple[float, float, int, str]]


def outlying(group: Group, level: float) -> list[tuple[float, str]]:
    """Ratios and words of what chance hardly leaves as the largest of a group, worst first.

    Parameters
    ----------
    group : Group
    level : float
        Probability of any among good residuals.
    """
    if not group.residuals:
        return []
    ratio, own = np.array([row[1:3] for row in group.residuals], float).T
    chance, f = sidak(level, len(ratio)), group.redundancy - own
    squares = ratio**2 * own
    others = np.sqrt(np.maximum(squares.sum() - squares, 0.0) / np.maximum(f, 1.0))
    out = []
    for (size, w, n, what), scatter, left in zip(group.residuals, others.tolist(), f.tolist(), strict=True):
        given = group.absolute and scatter <= 1.0
        found = w if given else w / scatter if scatter > 0.0 else math.inf
        limit = chi_square_limit(n, chance) / n if given else f_quantile(n, max(left, 1.0), 1.0 - chance)
        if left >= 1.0 and size > ROUNDING and found**2 > float(limit):
            over = "its standard deviation" if given else "the standard deviation that the others show"
            out.append((found, f"look at {what} is {number(found, 1)} times {over}"))
    return sorted(out, key=lambda row: -row[0])
