"""Record of a mistake that was tested with a block, and common functions of these tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from fg_orient.adjustment.problem import Problem
from fg_orient.model.block import Block

#: Function that corrects a mistake in a block.
Mend = Callable[[Block], Block]

#: Number of points with the largest errors that are searched for exchanged and repeated ids.
PAIRED: Final = 12


@dataclass(frozen=True)
class Cause:
    """A mistake in the input that was tested as explanation of the residuals.

    Parameters
    ----------
    what, cure : str
        Description with its estimated size, and remedy.
    gain : float
        Decrease of the weighted sum of squares, or twice the logarithm of the likelihood ratio.
    free : int
        Number of estimated parameters; 0 if the mistake has none.
    score : float
        ``gain`` minus the penalty of the free parameters (BIC); causes are ranked by it.
    kind : str
        Causes of one kind include each other, so only the best one is kept. "single": an error of one point,
        which the outlier tests report.
    mend : callable, optional
        Function that returns the block without the mistake.
    volume : float
        Twice the logarithm of the factor by which the mistake changes the volume of the distribution of the residuals.
    point : str
        Point of a single error, or point whose single errors include this mistake.
    detail : callable, optional
        Function that returns additional text if the cause is named.
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
        """Description, with the additional text."""
        return self.what + ("" if self.detail is None else self.detail())


class Supposed(NamedTuple):
    """Mistake that is confirmed or withdrawn by a further adjustment.

    Parameters
    ----------
    mend : callable
        Function that returns the block without the mistake.
    least : float or None
        Least decrease of the weighted sum of squares of observations and check points that confirms the mistake; None:
        any decrease of sigma0.
    whole : bool
        True if the mistake must explain sigma0 and all gross errors. This applies to sigmas that are wrong by
        a factor.
    """

    mend: Mend
    least: float | None
    whole: bool = False


def penalty_of(problem: Problem) -> float:
    """Return the penalty of an estimated parameter: the logarithm of the number of observations."""
    return float(np.log(2 * len(problem.observations) + 3 * problem.observed.sum()))


def without_parameter(what: str, gain: float, cure: str, kind: str, mend: Mend, point: str = "") -> Cause:
    """Return a cause whose error is known; its gain is twice the logarithm of the likelihood ratio."""
    return Cause(what, cure, gain, 0, gain, kind, mend, point=point)
