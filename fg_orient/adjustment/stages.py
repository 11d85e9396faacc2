"""The way to a robust loss in stages: from least squares, over Huber's loss or a schedule, to the loss itself.

Metadata are off by many sigmas, where bounded losses see nothing: the first stage is plain least squares. A loss whose
influence falls again has several minima; it starts from the minimum of Huber's, which has one (Huber 1981, ch. 7.8), or
from resections (:mod:`fg_orient.adjustment.resection`). Resections are good to some sigmas, so the loss is eight
times as wide at first, then four, two times and as it is: Huber's in between would forget them, since it ends at its
only minimum wherever it begins.

A scale of the residuals (``robust_scale = "mad"``) is taken at the end of each stage and fixed while the next one runs,
so that every stage has a cost. Huber's stage is repeated until the scale has settled; the last stage keeps that scale
(as MM-estimators do, Yohai 1987): were it to follow the residuals of a redescending loss, it could shrink with every
observation that is turned down.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from factors.losses import Loss
from factors.losses.standard import HUBER
from fg_orient.adjustment.gnc import EXACT, PLAIN, Graduated, half_square
from fg_orient.adjustment.loop import STEP_TOLERANCE, Backend, Carried, LoopResult
from fg_orient.adjustment.robust import A_PRIORI, NONE, Robust, RobustBackend, ScaledLoss, find_loss, scaled
from fg_orient.model.options import Options

Array = npt.NDArray[np.float64]
Scale = tuple[float, float]
S = TypeVar("S")

#: Stages with Huber's loss: the first, the one after it, ... (PLAIN is -1, surrogates count from 0).
START: Final = -2.0
#: At most so many, until the scale changes by less than this share.
START_STAGES: Final = 8
SETTLED: Final = 0.01
#: Iterations of one of them: it need not be gone to the end of.
START_ITERATIONS: Final = 30
#: A stage before the last ends at this scaled step.
STAGE_STEP: Final = 1e-3
PLAIN_ITERATIONS: Final = 5
#: Stages after resections: WIDE - k has the loss 2^k times as wide.
WIDE: Final = -100.0
FROM_RESECTIONS: Final = WIDE - 3.0
WIDE_ITERATIONS: Final = 10


class Plan(Protocol):
    """Stages on the way to a loss, from PLAIN to EXACT."""

    def robust(self, mu: float, scale: Scale = A_PRIORI) -> Robust:
        """Losses of a stage in units of these scales."""
        ...

    def iterations(self, mu: float) -> int:
        """Iterations of a stage other than the last."""
        ...

    def following(self, mu: float, squares: tuple[Array, Array], settled: bool = True) -> float:
        """Stage after the one that ended with these squared norms, and a scale that has settled or not."""
        ...


@dataclass(frozen=True)
class Direct:
    """A loss after plain least squares and, if it begins there, Huber's.

    Parameters
    ----------
    loss : Loss
    from_huber : bool
    """

    loss: Loss
    from_huber: bool

    def robust(self, mu: float, scale: Scale = A_PRIORI) -> Robust:
        """See :class:`Plan`."""
        if mu == PLAIN:
            return Robust(*(ScaledLoss(np.ones_like, half_square, s) for s in scale))
        if mu < WIDE:
            image, control = scale
            return scaled(self.loss, (image * 2.0 ** (WIDE - mu), control * 2.0 ** (WIDE - mu)))
        return scaled(self.loss if mu == EXACT else HUBER, scale)

    def iterations(self, mu: float) -> int:
        """See :class:`Plan`."""
        if mu < WIDE:
            return WIDE_ITERATIONS
        return PLAIN_ITERATIONS if mu == PLAIN else START_ITERATIONS

    def following(self, mu: float, squares: tuple[Array, Array], settled: bool = True) -> float:
        """See :class:`Plan`."""
        if mu == PLAIN:
            return START if self.from_huber else EXACT
        if mu < WIDE:
            return mu + 1.0 if mu + 1.0 < WIDE else EXACT
        return EXACT if settled or mu <= START - START_STAGES + 1.0 else mu - 1.0


def plan_of(options: Options) -> Plan | None:
    """How the loss of the options is approached; None for least squares."""
    if options.loss == NONE:
        return None
    if options.gnc:
        return Graduated.of(options)
    loss = find_loss(options.loss)
    return Direct(loss, options.robust_scale == "mad" or (loss.redescending and options.robust_start == "huber"))


class StagedBackend(Backend[S], RobustBackend[S], Protocol[S]):
    """What the stages need of a backend."""


def run_stages(
    backend: StagedBackend[S],
    optimise: Callable[[Carried[S], int, float], LoopResult[S]],
    plan: Plan,
    carried: Carried[S],
    max_iterations: int,
    keep: Callable[[Carried[S]], None],
    measure: Callable[[S], Scale] | None = None,
) -> tuple[LoopResult[S], Scale]:
    """Run the stages from the one that ``carried.mu`` names; the last one's convergence is that of the whole.

    ``optimise`` is an optimiser of the loop: from what is carried, at most so many iterations, to this step;
    ``max_iterations`` bounds the last stage; ``keep`` is called with what is carried from stage to stage; ``measure``
    gives the scale at a state, None: it is that of the sigmas. Given back: the end, and the scale of the last stage.
    """
    while True:
        backend.robust, last = plan.robust(carried.mu, carried.scale), carried.mu == EXACT
        limits = (max_iterations, STEP_TOLERANCE) if last else (plan.iterations(carried.mu), STAGE_STEP)
        result = optimise(carried, *limits)
        if last or not math.isfinite(result.error):
            return result, carried.scale
        scale = carried.scale if measure is None else measure(result.state)
        settled = all(abs(new / old - 1.0) <= SETTLED for new, old in zip(scale, carried.scale, strict=True))
        mu = plan.following(carried.mu, backend.squares(result.state), settled)
        carried = Carried(
            result.state, log=result.log, begun_at=len(result.log), mu=mu, image_scale=scale[0], control_scale=scale[1]
        )
        keep(carried)
