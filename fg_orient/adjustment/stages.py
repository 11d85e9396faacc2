"""Stages before a robust loss: least squares, then Huber's loss, resections or a schedule of surrogates.

Metadata orientations have errors of many sigmas. At such residuals, a bounded loss has no
gradient. Therefore the first stage is least squares. A redescending loss has several
minima. It starts at the only minimum of Huber's loss (Huber 1981, ch. 7.8), or at
resections (:mod:`fg_orient.adjustment.resection`). Resections are accurate to a few
sigmas. Therefore the width of the loss is first eight times its final value, then four
times, twice and once. In this case, Huber's loss is not used, because it would move the solution away
from the resections to the only minimum of Huber's loss.

The scale of the residuals (``robust_scale = "mad"``) is measured at the end of each stage
and fixed during the next, so that every stage has a cost. Huber's stage is repeated until
the scale has converged. The last stage keeps this scale (as MM-estimators do, Yohai
1987): a scale that follows the residuals of a redescending loss could shrink with every
observation that is down-weighted.

Graduated non-convexity (Yang, Antonante, Tzoumas & Carlone 2020) replaces a bounded loss
by surrogates with a parameter mu. The first surrogate is so wide that it excludes no
residual of the least-squares stage. Each stage is steeper than the last by a factor of
1.4 and starts at its end. Yang et al. fix the weights within a stage; here weights change
with each step, which minimises the same cost. The limit between inliers and outliers is a
quantile of chi-square, so residuals must be in sigmas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np

from factors.arrays import Array
from factors.losses import Curve, Loss, losses
from factors.losses.standard import GEMAN_MCCLURE, HUBER
from fg_orient.adjustment.irls import RULES, find_loss
from fg_orient.adjustment.loop import STEP_TOLERANCE, Backend, Carried, LoopResult
from fg_orient.adjustment.resection import METHODS
from fg_orient.adjustment.robust import A_PRIORI, CONTROL, IMAGE, NONE, Robust, ScaledLoss, inlier_limit, scaled
from fg_orient.model.errors import InputError
from fg_orient.model.options import Options

Scale = tuple[float, float]
S = TypeVar("S")

#: Value of mu for least squares. Surrogates have values from 0.
PLAIN: Final = -1.0
#: Value of mu for the loss itself.
EXACT: Final = math.inf
#: Value of mu for the first stage with Huber's loss; it decreases by one for each further stage.
START: Final = -2.0
#: Maximum number of these stages.
START_STAGES: Final = 8
#: These stages end when the relative change of the scale is below this.
SETTLED: Final = 0.01
#: Values of mu after resections: at WIDE - k the width of the loss is multiplied by 2^k.
WIDE: Final = -100.0
FROM_RESECTIONS: Final = WIDE - 3.0
#: A stage before the last one ends when the scaled step is below this.
STAGE_STEP: Final = 1e-3
#: Maximum number of iterations of such stages.
PLAIN_ITERATIONS: Final = 5
START_ITERATIONS: Final = 30
WIDE_ITERATIONS: Final = 10
STAGE_ITERATIONS: Final = 5
#: Ratio of steepness between two surrogates (Yang et al. 2020, remark 5).
FACTOR: Final = 1.4
#: Above this value of mu, truncated least squares and the surrogate differ only for residuals within 1e-4 of the limit.
LARGEST_MU: Final = 1e4


@dataclass(frozen=True)
class Direct:
    """Stages before a loss: least squares and, if ``from_huber``, Huber's loss, or wider losses after resections."""

    loss: Loss
    from_huber: bool

    def robust(self, mu: float, scale: Scale = A_PRIORI) -> Robust:
        """Return the losses of a stage in units of these scales."""
        if mu == PLAIN:
            return Robust(*(ScaledLoss(np.ones_like, half_square, s) for s in scale))
        if mu < WIDE:
            image, control = scale
            return scaled(self.loss, (image * 2.0 ** (WIDE - mu), control * 2.0 ** (WIDE - mu)))
        return scaled(self.loss if mu == EXACT else HUBER, scale)

    def iterations(self, mu: float) -> int:
        """Return the maximum number of iterations of a stage before the last."""
        if mu < WIDE:
            return WIDE_ITERATIONS
        return PLAIN_ITERATIONS if mu == PLAIN else START_ITERATIONS

    def following(self, mu: float, squares: tuple[Array, Array], settled: bool = True) -> float:
        """Return mu after a stage, from the squared norms at its end and whether the scale has converged."""
        if mu == PLAIN:
            return START if self.from_huber else EXACT
        if mu < WIDE:
            return mu + 1.0 if mu + 1.0 < WIDE else EXACT
        return EXACT if settled or mu <= START - START_STAGES + 1.0 else mu - 1.0


class Schedule(NamedTuple):
    """Surrogates of a bounded loss as functions of u = residual / limit; ``excess`` (n,) are squares of u.

    Parameters
    ----------
    first : callable
        Function that returns the first mu, from the largest excess; EXACT if no surrogate is required.
    next : callable
        Function that returns mu after a stage, from its mu and the excesses at its end;
        EXACT for the loss itself.
    weight, cost : callable
        Weight and cost as functions of mu and u. They are functions of this module, so
        that worker processes can receive them.
    """

    first: Callable[[float], float]
    next: Callable[[float, Array], float]
    weight: Callable[[float, Array], Array]
    cost: Callable[[float, Array], Array]

    def curves(self, mu: float) -> tuple[Curve, Curve]:
        """Return the weight and cost of one surrogate."""
        return partial(self.weight, mu), partial(self.cost, mu)


def _geman_mcclure_weight(mu: float, u: Array) -> Array:
    return GEMAN_MCCLURE.weight(u / math.sqrt(mu))


def _geman_mcclure_cost(mu: float, u: Array) -> Array:
    """Return the cost ``mu u^2 / (2 (mu + u^2))`` (Yang et al. 2020, eq. 9).

    mu decreases from twice the largest excess to 1.
    """
    return mu * GEMAN_MCCLURE.cost(u / math.sqrt(mu))


def _band(mu: float) -> tuple[float, float, float]:
    """Return the two ends of the band in which weights decrease, and the constant of its slope."""
    return math.sqrt(mu / (mu + 1.0)), math.sqrt((mu + 1.0) / mu), math.sqrt(mu * (mu + 1.0))


def _truncated_weight(mu: float, u: Array) -> Array:
    """Return weights with a decreasing band that is narrower for larger mu (Yang et al. 2020, eqs. 11, 14)."""
    low, high, root = _band(mu)
    return np.asarray(np.where(u <= low, 1.0, np.where(u < high, root / np.maximum(u, low) - mu, 0.0)))


def _truncated_cost(mu: float, u: Array) -> Array:
    low, high, root = _band(mu)
    band = 2.0 * root * u - mu * (1.0 + u**2)
    return np.asarray(0.5 * np.where(u <= low, u**2, np.where(u < high, band, 1.0)))


def _truncated_next(mu: float, excess: Array) -> float:
    """Return the next mu.

    EXACT (the loss itself) if no residual lies between its quadratic and its constant part.
    """
    inside = (excess > mu / (mu + 1.0)) & (excess < (mu + 1.0) / mu)
    return mu * FACTOR if inside.any() and mu < LARGEST_MU else EXACT


#: Losses with surrogates.
SCHEDULES: Final = {
    "tls": Schedule(
        lambda largest: 1.0 / (2.0 * largest - 1.0) if largest > 1.0 else EXACT,
        _truncated_next, _truncated_weight, _truncated_cost,
    ),
    "geman_mcclure": Schedule(
        lambda largest: 2.0 * largest if 2.0 * largest > 1.0 else EXACT,
        lambda mu, excess: mu / FACTOR if mu > FACTOR else EXACT,
        _geman_mcclure_weight, _geman_mcclure_cost,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Graduated:
    """Graduated non-convexity for a loss.

    Parameters
    ----------
    loss : str
        A key of :data:`SCHEDULES`.
    image_limit, control_limit : float
        Whitened norms that separate inliers from outliers among image points and control points.
    """

    loss: str
    image_limit: float
    control_limit: float

    @classmethod
    def of(cls, options: Options) -> Graduated:
        """Return the limits from the inlier probability of the options."""
        limits = [inlier_limit(options.inlier_probability, d) for d in (IMAGE, CONTROL)]
        return cls(options.loss, *limits)

    def robust(self, mu: float, scale: Scale = A_PRIORI) -> Robust:
        """Return the losses of a stage; the limits are in sigmas."""
        if mu == EXACT:
            weight, cost = losses()[self.loss].weight, losses()[self.loss].cost
        elif mu == PLAIN:
            weight, cost = np.ones_like, half_square
        else:
            weight, cost = SCHEDULES[self.loss].curves(mu)
        return Robust(ScaledLoss(weight, cost, self.image_limit), ScaledLoss(weight, cost, self.control_limit))

    def iterations(self, mu: float) -> int:
        """See :class:`Direct`."""
        return STAGE_ITERATIONS

    def following(self, mu: float, squares: tuple[Array, Array], settled: bool = True) -> float:
        """See :class:`Direct`."""
        schedule, (image, control) = SCHEDULES[self.loss], squares
        excess = np.concatenate([image / self.image_limit**2, control / self.control_limit**2])
        return schedule.first(float(excess.max(initial=0.0))) if mu == PLAIN else schedule.next(mu, excess)


def half_square(u: Array) -> Array:
    """Return the cost of least squares."""
    return np.asarray(0.5 * u**2)


def stages_left(mus: Sequence[float]) -> int | None:
    """Estimate how many stages remain after stages with these values of mu; None with less than two surrogates."""
    different = list(dict.fromkeys(mu for mu in mus if mu >= 0.0))
    if len(different) < 2 or different[-1] == EXACT:
        return None
    last = different[-1]
    factor = LARGEST_MU / last if last > different[0] else last
    return max(math.ceil(math.log(factor) / math.log(FACTOR)), 1)


#: Stages before a loss, from PLAIN to EXACT.
Plan = Direct | Graduated


def plan_of(options: Options) -> Plan | None:
    """Return the stages before the loss of the options; None for least squares."""
    if options.loss == NONE:
        return None
    if options.gnc:
        return Graduated.of(options)
    loss = find_loss(options.loss)
    return Direct(loss, options.robust_scale != "prior" or (loss.redescending and options.robust_start == "huber"))


def require_possible(options: Options) -> None:
    """Raise InputError for unknown losses and options that exclude each other."""
    _require_robust(options)
    if options.gnc and options.loss not in SCHEDULES:
        raise InputError.of("adjust.gnc", option="gnc", value=options.loss, known=", ".join(SCHEDULES))
    if options.solver is not None and options.backend != "dense":
        raise InputError.of("adjust.solver_dense", option="solver", value=options.solver, backend=options.backend)


def _require_robust(options: Options) -> None:
    """Raise InputError for options of a robust adjustment that exclude each other."""
    mad, resections = options.robust_scale != "prior", options.robust_start in METHODS
    wish = "robust_scale" if mad else "robust_start"
    if options.loss == NONE:
        if mad or resections:
            raise InputError.of("adjust.needs_loss", option=wish, value=getattr(options, wish))
        return
    if options.loss not in RULES:
        find_loss(options.loss)
        if options.gnc and (mad or resections):
            raise InputError.of("adjust.gnc_start", option=wish, value=getattr(options, wish))
    elif options.gnc or mad or resections:
        raise InputError.of("adjust.cycles", option="loss", value=options.loss, known=", ".join(losses()))


class RobustBackend(Backend[S], Protocol[S]):
    """Backend that weights its rows."""

    robust: Robust | None

    def squares(self, state: S) -> tuple[Array, Array]:
        """Return the squared whitened norms of image points (n,) and control points (m,), in any order."""
        ...


def run_stages(
    backend: RobustBackend[S],
    optimise: Callable[[Carried[S], int, float], LoopResult[S]],
    plan: Plan,
    carried: Carried[S],
    max_iterations: int,
    keep: Callable[[Carried[S]], None],
    measure: Callable[[S], Scale],
    begin: Callable[[S, Scale], S],
) -> tuple[LoopResult[S], Scale]:
    """Run the stages, starting at ``carried.mu``.

    Parameters
    ----------
    optimise : callable
        Optimiser of the loop; it receives its input, the maximum number of iterations,
        and the step that ends it.
    max_iterations : int
        Maximum number of iterations of the last stage.
    keep : callable
        Function that receives the input of each further stage.
    measure : callable
        Function that returns the scale of the residuals at a state.
    begin : callable
        Function that returns the start of the last stage, from the end of the stage before and the scale.

    Returns
    -------
    Result of the last stage and its scale; the last stage decides on convergence.
    """
    while True:
        backend.robust, last = plan.robust(carried.mu, carried.scale), carried.mu == EXACT
        limits = (max_iterations, STEP_TOLERANCE) if last else (plan.iterations(carried.mu), STAGE_STEP)
        result = optimise(carried, *limits)
        if last or not math.isfinite(result.error):
            return result, carried.scale
        scale = measure(result.state)
        settled = all(abs(new / old - 1.0) <= SETTLED for new, old in zip(scale, carried.scale, strict=True))
        mu = plan.following(carried.mu, backend.squares(result.state), settled)
        carried = Carried(
            begin(result.state, scale) if mu == EXACT else result.state,
            log=result.log,
            begun_at=len(result.log),
            mu=mu,
            image_scale=scale[0],
            control_scale=scale[1],
        )
        keep(carried)
