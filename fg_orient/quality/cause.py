"""A mistake that was tested with a block, and common functions of these tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from fg_orient.adjustment.problem import Problem
from fg_orient.model.block import Block

#: Undoes a mistake in a block.
Mend = Callable[[Block], Block]

#: Points with the largest errors, among which exchanged and repeated ids are looked for.
PAIRED: Final = 12


@dataclass(frozen=True)
class Cause:
    """A mistake that was tried.

    Parameters
    ----------
    what, cure : str
        Description with its estimated size, and remedy.
    gain : float
        Decrease of the weighted sum of squares, or twofold logarithm of the likelihood ratio.
    free : int
        Estimated parameters; 0 if the mistake has none.
    score : float
        ``gain`` less the penalty of the free parameters (BIC), by which causes are ranked.
    kind : str
        Causes of one kind contain each other; the best of them is kept. "single": an error of one point, named
        elsewhere.
    mend : callable, optional
        Gives the block without the mistake.
    volume : float
        Twofold logarithm of the factor by which the mistake changes the volume of the distribution of the residuals.
    point : str
        Point of a single error, or point whose single errors contain this mistake.
    detail : callable, optional
        Further words, if the cause is named.
    """

    what: str
    cure: str
    gain: float
    free: int
    score: float
    kind: str
    mend: Mend | None = None
    volume: float = 0.0
    point: str = ""
    detail: Callable[[], str] | None = None

    @property
    def words(self) -> str:
        """Description, with the further words."""
        return self.what + ("" if self.detail is None else self.detail())


class Supposed(NamedTuple):
    """A mistake for a confirming adjustment.

    Parameters
    ----------
    mend : callable
        Gives the block without the mistake.
    least : float or None
        Decrease of the weighted sum of squares of observations and check points that confirms it; None: any decrease
        of sigma0.
    whole : bool
        The mistake must explain sigma0 and all gross errors: sigmas that are wrong by a factor.
    """

    mend: Mend
    least: float | None
    whole: bool = False


def penalty_of(problem: Problem) -> float:
    """Penalty of an estimated parameter: logarithm of the number of observations."""
    return float(np.log(2 * len(problem.observations) + 3 * problem.observed.sum()))


def without_parameter(what: str, gain: float, cure: str, kind: str, mend: Mend, point: str = "") -> Cause:
    """Cause whose error is known, with its twofold logarithm of the likelihood ratio."""
    return Cause(what, cure, gain, 0, gain, kind, mend, point=point)
