"""Observations that took no part, predicted from those that did.

They are judged as if they were in: with their misclosure v at the solution of the rest, their Jacobian J in whitened
rows, the cofactors Q of the unknowns of the rest, ``S = I + J Q J^T`` and the columns E of the error in these rows::

    T = (E^T S^-1 v)^T (E^T S^-1 E)^+ (E^T S^-1 v)

is the T of the outlier test in the adjustment with them (its residuals are ``S^-1 v``, weighted, with these cofactors;
leave one out, Kok 1984), and v^T v rises by ``v^T S^-1 v`` when they come back. A ground point that the rest does not
hold is first intersected from the observations themselves, and they are judged by what is left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.quality import hypotheses
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.suspects import CHECKED, point_rows

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: Gauss-Newton steps of an intersection, and the step in m at which it ends.
MAX_STEPS: Final = 20
STEP_M: Final = 1e-6


@dataclass(frozen=True)
class ConsistencyTest:
    """Consistency test of excluded observations.

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


@dataclass(frozen=True)
class Suspect:
    """Where an error is suspected: "image" with its row of the full problem, "position", "height" or "point"."""

    part: str
    row: int = -1


def prediction(
    full: Problem, rest: Problem, state: State, cofactors: Cofactors, chi2: float, test: str,
    point: int, rows: Sequence[int], control: bool, suspect: Suspect,
) -> ConsistencyTest:  # fmt: skip
    """Judge a suspect among observations of one ground point that took no part.

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
    suspect : Suspect
        Where the error is suspected.
    """
    held = bool(rest.active[point] or not full.active[point])  # unknown there, or a constant
    x = (state if rest.active[point] else full.start).ground[point]
    if not held:
        found = _intersected(full, state, point, rows, control)
        if found is None:  # no place, so nothing to judge them by
            return ConsistencyTest(0.0, 0, None, None)
        x = found
    v, d_image, d_ground, images = _rows(full, state, point, x, rows, control)
    e = _columns(full, point, rows, control, suspect)
    e = e / np.linalg.norm(e, axis=0)  # before the projection: what it leaves of an error is its checked share
    if rest.active[point]:
        q = cofactors.joint(images, (point,)) if images else cofactors.point(point)
        design = np.hstack([d_image, d_ground])
    else:
        q, design = cofactors.joint(images, ()), d_image
        if not held:
            left = np.linalg.qr(d_ground, mode="complete")[0][:, 3:].T
            v, design, e = left @ v, left @ design, left @ e
    return _judged(v, e, np.eye(len(v)) + design @ q @ design.T, chi2, rest.redundancy, test)


def _columns(full: Problem, point: int, rows: Sequence[int], control: bool, suspect: Suspect) -> Array:
    """Columns E (m, k) of the suspected error in the rows of :func:`_rows`; their scale does not matter."""
    whole = np.eye(2 * len(rows) + 3 * control)
    if suspect.part == "point":
        return whole
    if suspect.part == "image":
        return whole[:, [k for i, r in enumerate(rows) if r == suspect.row for k in (2 * i, 2 * i + 1)]]
    axes = full.axes(full.control_records[None, point, POINT.place] + full.origin_m)[0]
    out = np.zeros((len(whole), 3))
    out[-3:] = full.control_weights(point) @ axes.T
    return out[:, :2] if suspect.part == "position" else out[:, 2:]


def _judged(v: Array, e: Array, s: Array, chi2: float, redundancy: int, test: str) -> ConsistencyTest:
    """Test in the adjustment with the observations: f grows by their number, v^T v by their own sum."""
    residual, weighted = np.linalg.solve(s, v), np.linalg.solve(s, e)
    size, axes = np.linalg.eigh(e.T @ weighted)
    checked = size > CHECKED
    along = axes[:, checked].T @ (e.T @ residual)
    t, d, f = np.array([along**2 @ (1.0 / size[checked])]), np.array([checked.sum()]), redundancy + len(v)
    if not hypotheses.can_be_tested(d, f, test)[0]:
        return ConsistencyTest(float(t[0]), 0, None, None)
    total = chi2 + float(v @ residual)
    statistic, p = (law(t, d, total, f, test)[0] for law in (hypotheses.statistics, hypotheses.probabilities))
    return ConsistencyTest(float(t[0]), int(d[0]), float(statistic), float(p))


def _rows(
    full: Problem, state: State, point: int, x: Array, rows: Sequence[int], control: bool
) -> tuple[Array, Array, Array, tuple[int, ...]]:
    """Whitened misclosures (m,) at a place of the ground point, Jacobians (m, u) and (m, 3), and the images of u."""
    taken, ground = np.asarray(rows, np.intp), state.ground.copy()
    ground[point] = x
    rays = linearised(full, State(state.image, ground), taken)
    given = full.control_weights(point) @ (x - full.control_records[point, POINT.place]) if control else None
    v, j_image, j_ground, _, images = point_rows(full, point, full.observations.image[taken], rays, given)
    return v, j_image, j_ground, images


def _intersected(full: Problem, state: State, point: int, rows: Sequence[int], control: bool) -> Array | None:
    """Ground point of the observations alone, local m, the orientation held; None where the steps do not end."""
    x: Array = full.start.ground[point].copy()
    for _ in range(MAX_STEPS):
        v, _, d_ground, _ = _rows(full, state, point, x, rows, control)
        step = np.linalg.lstsq(d_ground, -v)[0]
        x += step
        if np.abs(step).max() < STEP_M:
            return x
    return None
