"""Consistency of excluded observations with the adjustment of the others.

The excluded observations are tested as if they were included. With their misclosure v at the solution of the other
observations, their Jacobian J in whitened rows, the cofactors Q of the unknowns, ``S = I + J Q J^T`` and the columns E
of the error in these rows::

    T = (E^T S^-1 v)^T (E^T S^-1 E)^+ (E^T S^-1 v)

is the T of the outlier test in the adjustment with them (its residuals are ``S^-1 v``, weighted, with these cofactors;
leave one out, Kok 1984), and v^T v increases by ``v^T S^-1 v`` if they are included again. A ground point that the
other observations do not determine is first intersected from the excluded observations; the test uses the remaining
combinations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised, side_by_side
from fg_orient.quality import hypotheses
from fg_orient.quality.cofactors import Cofactors

#: Maximum number of Gauss-Newton steps of an intersection, and the step in m at convergence.
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
        d; 0 if the other observations do not check them.
    statistic : float or None
        w, tau, t, or T, T/m0^2, F (``fg_orient.quality.hypotheses``); None if d is 0.
    probability : float or None
        Probability of a larger statistic without a gross error.
    """

    quadratic: float
    dimension: int
    statistic: float | None
    probability: float | None

    @classmethod
    def of(cls, t: float, d: int, chi2: float, redundancy: float, test: str) -> ConsistencyTest:
        """Test of T with v^T v and its degrees of freedom; see ``fg_orient.quality.hypotheses``."""
        given = np.array([t]), np.array([d])
        if not hypotheses.can_be_tested(given[1], redundancy, test)[0]:
            return cls(t, 0, None, None)
        laws = (hypotheses.statistics, hypotheses.probabilities)
        return cls(t, d, *(float(law(*given, chi2, redundancy, test)[0]) for law in laws))

    def with_freedom(self, freedom: float, test: str) -> ConsistencyTest:
        """The same test with these degrees of freedom instead of the redundancy."""
        t, d = self.quadratic, self.dimension
        return ConsistencyTest.of(t, d, freedom + t, freedom + d, test) if d else self


@dataclass(frozen=True)
class Suspect:
    """Place of a suspected error: "image" with its row of the full problem, "position", "height" or "point"."""

    part: str
    row: int = -1


def prediction(
    full: Problem, rest: Problem, state: State, cofactors: Cofactors, chi2: float, test: str,
    point: int, rows: Sequence[int], control: bool, suspect: Suspect,
) -> ConsistencyTest:  # fmt: skip
    """Test a suspect among excluded observations of one ground point.

    Parameters
    ----------
    full : Problem
        With these observations; the same images, options and ground points as ``rest``.
    rest, state, cofactors, chi2
        Adjustment without these observations.
    test : str
        "baarda", "pope" or "t".
    point : int
    rows : sequence of int
        Image points of ``full``, all of this ground point.
    control : bool
        Whether the measured coordinates of the point are among them.
    suspect : Suspect
    """
    held = bool(rest.active[point] or not full.active[point])  # an unknown of the others, or a constant
    x = (state if rest.active[point] else full.start).ground[point]
    if not held:
        place = _intersected(full, state, point, rows, control)
        if place is None:
            return ConsistencyTest(0.0, 0, None, None)
        x = place
    v, d_image, d_ground, images = _rows(full, state, point, x, rows, control)
    e = _columns(full, point, rows, control, suspect)
    e = e / np.linalg.norm(e, axis=0)  # before the projection, so that its length after it is the checked share
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
    """Test in the adjustment with the observations: f increases by their number, v^T v by their sum."""
    residual, weighted = np.linalg.solve(s, v), np.linalg.solve(s, e)
    t, d, _ = hypotheses.quadratic(e.T @ residual, e.T @ weighted)
    return ConsistencyTest.of(float(t), int(d), chi2 + float(v @ residual), redundancy + len(v), test)


def _rows(
    full: Problem, state: State, point: int, x: Array, rows: Sequence[int], control: bool
) -> tuple[Array, Array, Array, tuple[int, ...]]:
    """Whitened misclosures (m,) at a place of the ground point, Jacobians (m, u) and (m, 3), and the images of u."""
    taken, ground = np.asarray(rows, np.intp), state.ground.copy()
    ground[point] = x
    rays = linearised(full, State(state.image, ground), taken)
    j_image, _, images = side_by_side(full, full.observations.image[taken], rays.image)
    v, j_ground = rays.residual.ravel(), rays.ground.reshape(-1, 3)
    if control:
        w = full.control_weights(point)
        v = np.concatenate([v, w @ (x - full.control_records[point, POINT.place])])
        j_image, j_ground = np.pad(j_image, ((0, 3), (0, 0))), np.vstack([j_ground, w])
    return v, j_image, j_ground, images


def _intersected(full: Problem, state: State, point: int, rows: Sequence[int], control: bool) -> Array | None:
    """Ground point from these observations with fixed orientation, local m; None without convergence."""
    x: Array = full.start.ground[point].copy()
    for _ in range(MAX_STEPS):
        v, _, d_ground, _ = _rows(full, state, point, x, rows, control)
        step = np.linalg.lstsq(d_ground, -v)[0]
        x += step
        if np.abs(step).max() < STEP_M:
            return x
    return None
