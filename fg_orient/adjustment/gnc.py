"""Graduated non-convexity: from a convex loss to a bounded one in stages (Yang, Antonante, Tzoumas & Carlone 2020).

The surrogate of a bounded loss has a parameter mu. It starts so wide that no residual of the plain least squares is
left out, and each stage makes it steeper by a factor of 1.4, starting from the state of the last. Yang et al. hold
the weights of a stage fixed while its unknowns are solved for; here they follow each step, which lowers the
same cost. The limit between good and bad observations is a quantile of chi-square, so residuals must be in sigmas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from factors.losses import Curve, losses
from factors.losses.standard import GEMAN_MCCLURE
from fg_orient.adjustment.robust import A_PRIORI, CONTROL, IMAGE, Robust, ScaledLoss, inlier_limit
from fg_orient.model.block import Options

Array = npt.NDArray[np.float64]

#: By how much a stage is steeper than the one before (Yang et al. 2020, remark 5).
FACTOR: Final = 1.4
#: A stage ends after so many iterations: only the last one is gone to the end of.
STAGE_ITERATIONS: Final = 5
#: Beyond, the truncated least squares and their surrogate differ for residuals within 1e-4 of the limit only.
LARGEST_MU: Final = 1e4
#: Stages: plain least squares, surrogates (mu from 0), the loss itself.
PLAIN: Final = -1.0
EXACT: Final = math.inf


class Schedule(Protocol):
    """How a bounded loss is approached; ``excess`` is the square of the residuals over their limits (n,)."""

    def first(self, largest: float) -> float:
        """First mu, for the largest excess; EXACT if there is nothing to do."""
        ...

    def next(self, mu: float, excess: Array) -> float:
        """The mu after a stage that ended with these excesses; EXACT for the loss itself."""
        ...

    def curves(self, mu: float) -> tuple[Curve, Curve]:
        """Weight and cost of the surrogate, of u = residual over limit."""
        ...


class GemanMcClure:
    """Surrogate ``mu u^2 / (2 (mu + u^2))``, mu from twice the largest excess down to 1 (Yang et al. 2020, eq. 9)."""

    def first(self, largest: float) -> float:
        """See :class:`Schedule`."""
        return 2.0 * largest if 2.0 * largest > 1.0 else EXACT

    def next(self, mu: float, excess: Array) -> float:
        """See :class:`Schedule`."""
        return mu / FACTOR if mu > FACTOR else EXACT

    def curves(self, mu: float) -> tuple[Curve, Curve]:
        """See :class:`Schedule`."""
        return partial(_geman_mcclure_weight, mu), partial(_geman_mcclure_cost, mu)


class TruncatedLeastSquares:
    """Surrogate with a band of falling weights, narrower as mu grows (Yang et al. 2020, eqs. 11, 14)."""

    def first(self, largest: float) -> float:
        """See :class:`Schedule`."""
        return 1.0 / (2.0 * largest - 1.0) if largest > 1.0 else EXACT

    def next(self, mu: float, excess: Array) -> float:
        """See :class:`Schedule`; the loss itself once no residual lies in the band."""
        inside = (excess > mu / (mu + 1.0)) & (excess < (mu + 1.0) / mu)
        return mu * FACTOR if inside.any() and mu < LARGEST_MU else EXACT

    def curves(self, mu: float) -> tuple[Curve, Curve]:
        """See :class:`Schedule`."""
        return partial(_truncated_weight, mu), partial(_truncated_cost, mu)


#: Losses that can be approached.
SCHEDULES: Final[dict[str, Schedule]] = {"tls": TruncatedLeastSquares(), "geman_mcclure": GemanMcClure()}


@dataclass(frozen=True)
class Graduated:
    """Graduated non-convexity for a loss.

    Parameters
    ----------
    loss : str
        A key of :data:`SCHEDULES`.
    image_limit, control_limit : float
        Whitened norms that divide good from bad image points and control points.
    """

    loss: str
    image_limit: float
    control_limit: float

    @classmethod
    def of(cls, options: Options) -> Graduated:
        """With limits from the inlier probability of the options."""
        limits = [inlier_limit(options.inlier_probability, d) for d in (IMAGE, CONTROL)]
        return cls(options.loss, *limits)

    def robust(self, mu: float, scale: tuple[float, float] = A_PRIORI) -> Robust:
        """The losses of a stage; the limits are in sigmas."""
        if mu == EXACT:
            weight, cost = losses()[self.loss].weight, losses()[self.loss].cost
        elif mu == PLAIN:
            weight, cost = np.ones_like, half_square
        else:
            weight, cost = SCHEDULES[self.loss].curves(mu)
        return Robust(ScaledLoss(weight, cost, self.image_limit), ScaledLoss(weight, cost, self.control_limit))

    def excess(self, squares: tuple[Array, Array]) -> Array:
        """Squared norms over squared limits, of image points, then control points."""
        image, control = squares
        return np.concatenate([image / self.image_limit**2, control / self.control_limit**2])

    def iterations(self, mu: float) -> int:
        """Iterations of a stage other than the last."""
        return STAGE_ITERATIONS

    def following(self, mu: float, squares: tuple[Array, Array], settled: bool = True) -> float:
        """Give the mu after a stage, from the squared norms at its end."""
        schedule, excess = SCHEDULES[self.loss], self.excess(squares)
        return schedule.first(float(excess.max(initial=0.0))) if mu == PLAIN else schedule.next(mu, excess)


# curves are functions of this module with their mu bound: workers in other processes receive them


def _geman_mcclure_weight(mu: float, u: Array) -> Array:
    return GEMAN_MCCLURE.weight(u / math.sqrt(mu))


def _geman_mcclure_cost(mu: float, u: Array) -> Array:
    return mu * GEMAN_MCCLURE.cost(u / math.sqrt(mu))


def _band(mu: float) -> tuple[float, float, float]:
    """Ends of the band of falling weights, and the slope's constant."""
    return math.sqrt(mu / (mu + 1.0)), math.sqrt((mu + 1.0) / mu), math.sqrt(mu * (mu + 1.0))


def _truncated_weight(mu: float, u: Array) -> Array:
    low, high, root = _band(mu)
    return np.asarray(np.where(u <= low, 1.0, np.where(u < high, root / np.maximum(u, low) - mu, 0.0)))


def _truncated_cost(mu: float, u: Array) -> Array:
    low, high, root = _band(mu)
    band = 2.0 * root * u - mu * (1.0 + u**2)
    return np.asarray(0.5 * np.where(u <= low, u**2, np.where(u < high, band, 1.0)))


def half_square(u: Array) -> Array:
    """Cost of least squares."""
    return np.asarray(0.5 * u**2)


def stages_left(mus: Sequence[float]) -> int | None:
    """Stages to come after those of these mus, at most; None before two surrogates show which way they go."""
    different = list(dict.fromkeys(mu for mu in mus if mu >= 0.0))
    if len(different) < 2 or different[-1] == EXACT:
        return None
    last = different[-1]
    factor = LARGEST_MU / last if last > different[0] else last
    return max(math.ceil(math.log(factor) / math.log(FACTOR)), 1)
