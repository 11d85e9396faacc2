"""Cycles of reweighted least squares on the Schur backend, compiled once.

The weights of a cycle (``fg_orient.adjustment.irls``) multiply the rows, as those of a loss do. To make a problem of
its own for each cycle would take many times as long as its two or three iterations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.irls import weights_of
from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.loop import OPTIMIZERS, Callback, Carried
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Given

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """End of a cycle: state, and the weighted sum of squares."""

    state: State
    chi2: float


def fits_on_arrays(problem: Problem, told: Callback) -> Callable[[tuple[Array, ...], Fit | None], Fit]:
    """Least squares with weights of image points and control points, as ``irls.reweight`` asks for it.

    ``told`` is called with each record of the iterations.
    """
    from fg_orient.adjustment.schur import SchurBackend

    backend, options = SchurBackend(problem), problem.block.options
    optimise, structure = OPTIMIZERS[options.optimizer], backend.structure

    def fit(groups: tuple[Array, ...], last: Fit | None) -> Fit:
        weights = weights_of(problem, groups)
        backend.robust = Given(weights.image[structure.row], weights.control[structure.observed])
        with one_blas_thread():
            start: Carried[State] = Carried(problem.start if last is None else last.state)
            result = optimise(backend, start, options.max_iterations, told)
        return Fit(result.state, 2.0 * result.error)

    return fit
