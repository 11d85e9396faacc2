"""Statistics of small blocks with every kind of observation are computed from full matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from factors.conditions.control import CONTROL_POINT, POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.model.block import Block, ExtraObservation, ImagePoints
from fg_orient.model.names import Role
from tests.support.states import largest


@dataclass(frozen=True)
class Full:
    """Whitened residuals v, design A, its scaled SVD: Q of unknowns and of residuals as full matrices."""

    v: np.ndarray
    design: np.ndarray
    unknowns: np.ndarray
    residuals: np.ndarray
    problem: Problem

    @classmethod
    def of(cls, problem: Problem, state: State) -> Full:
        v, design = assemble(problem, state)
        scale = np.linalg.norm(design, axis=0)
        u, s, vt = np.linalg.svd(design / scale, full_matrices=False)
        half = vt.T / s / scale[:, None]
        return cls(v, design, half @ half.T, np.eye(len(v)) - u @ u.T, problem)


@dataclass(frozen=True)
class DenseCofactors:
    """Cofactors of all unknowns of all images, a shared one in each of its images, and of the unknown points."""

    problem: Problem
    matrix: np.ndarray

    def image(self, k: int) -> np.ndarray:
        part = self.problem.image_slice(k)
        return self.matrix[part, part]

    def points(self, index: np.ndarray) -> np.ndarray:
        parts = [self.problem.point_slice(j) for j in index]
        return np.array([self.matrix[part, part] for part in parts])


@dataclass(frozen=True)
class Dense:
    """Least squares by numpy alone, from the rows of a problem, with the names of a solution."""

    problem: Problem
    state: State
    chi2: float
    redundancy: int
    cofactors: DenseCofactors

    @classmethod
    def of(cls, problem: Problem) -> Dense:
        """Iterate Gauss-Newton from the start of the problem until the steps are rounding errors."""
        state = problem.start
        for _ in range(30):
            last, state = state, after_numpy(problem, state)
            if max(largest(problem, state, last)) < 1e-7:
                break
        else:
            raise AssertionError("no convergence")
        v, design = assemble(problem, state)
        ties = problem.ties
        design = design if ties is None else ties.columns(design)
        scale = np.linalg.norm(design, axis=0)
        _, s, vt = np.linalg.svd(design / scale, full_matrices=False)
        half = vt.T / s / scale[:, None]
        half = half if ties is None else ties.widened(half)
        redundancy = len(v) - int((s > 1e-12 * s[0]).sum())
        return cls(problem, state, float(v @ v), redundancy, DenseCofactors(problem, half @ half.T))

    @property
    def block(self) -> Block:
        return self.problem.block

    @property
    def ground_m(self) -> np.ndarray:
        return self.state.ground + self.problem.origin_m


def after_numpy(problem: Problem, state: State, robust: Robust | None = None) -> State:
    """Return the state after a Gauss-Newton step by numpy's least squares, with the weights of a loss at the state."""
    v, design = assemble(problem, state)
    if robust is not None:
        n, m = 2 * len(problem.observations), 3 * int(problem.observed.sum())
        image, control = (np.linalg.norm(part.reshape(-1, k), axis=1) for part, k in ((v[:n], 2), (v[n : n + m], 3)))
        image = of_pairs(problem, image)
        weights = [np.repeat(robust.image.weights(image), 2), np.repeat(robust.control.weights(control), 3)]
        root = np.sqrt(np.concatenate([*weights, np.ones(len(v) - n - m)]))
        v, design = root * v, root[:, None] * design
    design = design if problem.ties is None else problem.ties.columns(design)
    scale = np.linalg.norm(design, axis=0)
    step = np.linalg.lstsq(design / scale, -v, rcond=None)[0] / scale
    return stepped(problem, state, step if problem.ties is None else problem.ties.widened(step))


def of_pairs(problem: Problem, norm: np.ndarray) -> np.ndarray:
    """Return the norms of image points; both rays of a tie point that has only these two share one."""
    out = norm.copy()
    for j in np.flatnonzero(problem.active & ~problem.observed):
        rays = np.flatnonzero(problem.observations.point == j)
        if len(rays) == 2:
            out[rays] = np.hypot(*norm[rays]) / np.sqrt(2.0)
    return out


def stepped(problem: Problem, state: State, step: np.ndarray) -> State:
    """Add a step (u,) of all unknowns, images before points, a shared unknown in each of its images."""
    image, ground = state.image.copy(), state.ground.copy()
    for k, parameters in enumerate(problem.parameters):
        image[k, : len(parameters)] += step[problem.image_slice(k)]
    ground[problem.active] += step[problem.n_image_unknowns :].reshape(-1, 3)
    return State(image, ground)


def damped_of_numpy(problem: Problem, v: np.ndarray, design: np.ndarray, damping: float) -> np.ndarray:
    """Return the step by numpy's least squares.

    The damping is added to the images' diagonal, and is a share of the points'.
    """
    roots = np.full(design.shape[1], np.sqrt(damping))
    roots[problem.n_image_unknowns :] *= np.linalg.norm(design[:, problem.n_image_unknowns :], axis=0)
    rows, scale = np.vstack([design, np.diag(roots)]), np.hypot(np.linalg.norm(design, axis=0), roots)
    return np.linalg.lstsq(rows / scale, np.concatenate([-v, 0.0 * roots]), rcond=None)[0] / scale


def dogleg_of_numpy(problem: Problem, v: np.ndarray, design: np.ndarray, radius: float) -> np.ndarray:
    """Return Powell's step within the radius.

    It goes along steepest descent to its minimum and from there to Gauss-Newton's step.
    """
    newton, gradient = damped_of_numpy(problem, v, design, 0.0), design.T @ v
    steepest = -gradient * (gradient @ gradient) / np.sum((design @ gradient) ** 2)
    if np.linalg.norm(newton) <= radius:
        return newton
    if np.linalg.norm(steepest) >= radius:
        return steepest * radius / np.linalg.norm(steepest)
    across = newton - steepest
    share = brentq(lambda t: np.linalg.norm(steepest + t * across) - radius, 0.0, 1.0, xtol=1e-15)
    return steepest + share * across


def step_of_numpy(problem: Problem, state: State, robust: Robust | None = None) -> tuple[float, float]:
    """Return the largest part of that step: image unknowns (sigmas), points (m). None is left at the minimum."""
    return largest(problem, after_numpy(problem, state, robust), state)


def turned_design(problem: Problem, state: State) -> np.ndarray:
    """Return the whitened Jacobian with the rows of control points in East, North, Up, in sigmas.

    Shared unknowns once.
    """
    return turned_rows(problem, state)[1]


def turned_rows(problem: Problem, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals and Jacobian of :func:`turned_design`."""
    v, a = assemble(problem, state)
    a, n = a if problem.ties is None else problem.ties.columns(a), 2 * len(problem.observations)
    for k, j in enumerate(np.flatnonzero(problem.observed)):
        rows, record = slice(n + 3 * k, n + 3 * k + 3), problem.control_records[j]
        axes = problem.axes(record[None, POINT.place] + problem.origin_m)[0]
        sigma = problem.block.points.known.sigma_enu_m[j]
        turn = axes / sigma[:, None] @ np.linalg.inv(record[POINT.whitening].reshape(3, 3))
        v[rows], a[rows] = turn @ v[rows], turn @ a[rows]
    return v, a


def options(block: Block, **given: object) -> Block:
    return replace(block, options=replace(block.options, **given))


def fixed(block: Block, count: int) -> Block:
    """Make the first control points constants."""
    known = block.points.known
    is_fixed = known.fixed.copy()
    is_fixed[block.points.where(Role.CONTROL)[:count]] = True
    return replace(block, points=replace(block.points, known=replace(known, fixed=is_fixed)))


def measured_twice(block: Block, count: int) -> Block:
    """Measure the first image points a second time, a quarter of a pixel off."""
    o = block.observations
    again = o.take(np.arange(len(o)) < count)
    both = (np.concatenate(pair) for pair in zip(
        (o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px),
        (again.image, again.point, again.line + 0.25, again.sample - 0.25, again.sigma_line_px,
         2.0 * again.sigma_sample_px), strict=True,
    ))  # fmt: skip
    return replace(block, observations=ImagePoints(*both))


def own_observations(block: Block) -> Block:
    """Observe a tie or check point and a control point once more."""
    record = np.concatenate([np.diag([2.0, 3.0, 4.0]).ravel(), [1.0, -2.0, 0.5]])
    other = Role.TIE if len(block.points.where(Role.TIE)) else Role.CHECK
    names = [block.points.ids[int(block.points.where(role)[-1])] for role in (other, Role.CONTROL)]
    return replace(block, extra=tuple(
        ExtraObservation(CONTROL_POINT, (f"point:{name}",), record, np.zeros((2, 0)), 3, f"own {name}")
        for name in names
    ))  # fmt: skip
