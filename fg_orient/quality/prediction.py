"""Observations that took no part, predicted from those that did.

With the misclosure v of the observations at the solution of the rest, their Jacobian J in whitened rows and the
cofactors Q of the unknowns of the rest, ``T = v^T (I + J Q J^T)^-1 v`` is what the weighted sum of squares would rise
by if they came back: the same T as that of the outlier test with them inside (leave one out; Kok 1984). A ground point
that the rest does not hold is first intersected from the observations themselves, and they are judged by what is left
over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.quality import hypotheses
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Gauss-Newton steps of an intersection, and the step in m at which it ends.
MAX_STEPS: Final = 20
STEP_M: Final = 1e-6


@dataclass(frozen=True)
class Fit:
    """How observations fit to the rest.

    Parameters
    ----------
    quadratic : float
        T.
    dimension : int
        d; 0 where the rest does not check them.
    statistic : float or None
        w, tau, t, or T, T/m0^2, F (``fg_orient.quality.hypotheses``); None where nothing checks them.
    probability : float or None
        Of a larger statistic without a gross error.
    """

    quadratic: float
    dimension: int
    statistic: float | None
    probability: float | None


def prediction(
    full: Problem, rest: Problem, state: State, cofactors: Cofactors, chi2: float, test: str,
    point: int, rows: Sequence[int], control: bool,
) -> Fit:  # fmt: skip
    """Judge observations of one ground point that took no part.

    Parameters
    ----------
    full : Problem
        With them; the same images, options and ground points as ``rest``.
    rest, state, cofactors, chi2
        The adjustment without them.
    test : str
        "baarda", "pope" or "t".
    point : int
    rows : sequence of int
        Image points of ``full``, all of this ground point.
    control : bool
        Whether the point's coordinates came back, too.
    """
    held = bool(np.isfinite(state.ground[point]).all()) or not full.active[point]
    x = (state if rest.active[point] else full.start).ground[point]
    if not held:
        x = _intersected(full, state, point, rows, control)
    v, d_image, d_ground, images = _rows(full, state, point, x, rows, control)
    if rest.active[point]:
        q = cofactors.joint(images, (point,)) if images else cofactors.point(point)
        design = np.hstack([d_image, d_ground])
    else:
        q, design = cofactors.joint(images, ()), d_image
        if not held:
            left = np.linalg.qr(d_ground, mode="complete")[0][:, 3:].T
            v, design = left @ v, left @ design
    return _judged(v, np.eye(len(v)) + design @ q @ design.T, chi2, rest.redundancy, test)


def _judged(v: Array, q: Array, chi2: float, redundancy: int, test: str) -> Fit:
    """Test in the adjustment with the observations: f grows by d, v^T v by T."""
    if not len(v):
        return Fit(0.0, 0, None, None)
    t, d = np.array([v @ np.linalg.solve(q, v)]), np.array([len(v)])
    f = redundancy + len(v)
    if not hypotheses.testable(d, f, test)[0]:
        return Fit(float(t[0]), 0, None, None)
    statistic = hypotheses.statistics(t, d, chi2 + t, f, test)
    return Fit(float(t[0]), len(v), float(statistic[0]), float(hypotheses.probabilities(t, d, chi2 + t, f, test)[0]))


def _rows(
    full: Problem, state: State, point: int, x: Array, rows: Sequence[int], control: bool
) -> tuple[Array, Array, Array, tuple[int, ...]]:
    """Whitened misclosures (m,) at a place of the ground point, Jacobians (m, u) and (m, 3), and the images of u."""
    taken = np.asarray(rows, np.intp)
    own = replace(full, observations=full.observations.take(taken), records=full.records[taken])
    ground = state.ground.copy()
    ground[point] = x
    values, j_image, j_ground = own.image_residuals(State(state.image, ground), jacobian=True)
    images = tuple(dict.fromkeys(own.observations.image.tolist()))
    first = np.concatenate([[0], np.cumsum([len(full.parameters[k]) for k in images], dtype=int)])
    m = 2 * len(taken) + 3 * control
    v, d_image, d_ground = np.zeros(m), np.zeros((m, first[-1])), np.zeros((m, 3))
    for i, k in enumerate(own.observations.image.tolist()):
        part, at = slice(2 * i, 2 * i + 2), images.index(k)
        v[part], d_ground[part] = values[i], j_ground[i]
        d_image[part, first[at] : first[at + 1]] = j_image[i]
    if control:
        w = full.control_records[point, :9].reshape(3, 3)
        v[-3:], d_ground[-3:] = w @ (x - full.control_records[point, 9:]), w
    return v, d_image, d_ground, images


def _intersected(full: Problem, state: State, point: int, rows: Sequence[int], control: bool) -> Array:
    """Ground point of the observations alone, local m, the orientation held."""
    x: Array = full.start.ground[point].copy()
    for _ in range(MAX_STEPS):
        v, _, d_ground, _ = _rows(full, state, point, x, rows, control)
        step = np.linalg.lstsq(d_ground, -v)[0]
        x += step
        if np.abs(step).max() < STEP_M:
            break
    return x
