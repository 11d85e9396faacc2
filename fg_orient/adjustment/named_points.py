"""Schur backend for blocks whose extra observations name ground points.

The named points remain unknowns together with the images, as in :mod:`fg_orient.adjustment.border`. Compiled kernels
eliminate all other points. With damping the border is ``S(damping) + J^T J + damping``, with J the rows of
:func:`border.explicit_rows`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from factors.arrays import Array
from fg_orient.adjustment.border import Border, bordered, eliminated_part, explicit_rows, small_enough
from fg_orient.adjustment.border_matrix import cholesky
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import (
    FixedWeights,
    Robust,
    Weights,
    squares,
    weighted_problem,
    weights_at,
)
from fg_orient.adjustment.schur import Blended, SchurBackend, SchurStep
from fg_orient.adjustment.schur_stages import half_extras
from fg_orient.model.errors import InputError


class NamedSystem(Blended):
    """One linearisation; see ``loop.System``. In its steps the border (b,) replaces the images.

    Parameters
    ----------
    backend : NamedBackend
    state : State
    """

    def __init__(self, backend: NamedBackend, state: State) -> None:
        self._backend, self.state, self._excess = backend, state, 0.0
        problem = backend.problem
        if backend.robust is not None:
            weights, self._excess = weights_at(problem, state, backend.robust)
            problem = weighted_problem(problem, weights)
            backend.hold(weights)
        self._inner = backend.inner.linearise(state)
        self._value, self._design = explicit_rows(problem, state)
        self.error = self._excess + self._inner.error + 0.5 * float(self._value @ self._value)

    def solve(self, damping: float) -> SchurStep:
        """Eliminate points, solve for the border, substitute back; RuntimeError for singular equations."""
        problem, z = self._backend.problem, self._backend.problem.n_free_unknowns
        damping = max(damping, problem.least_damping)
        blocks, own = self._inner.partial(damping)
        matrix = bordered(problem, self._backend.inner.structure.pattern, blocks, self._design)
        diagonal, images = np.diag(matrix).copy(), np.arange(len(matrix)) < z
        matrix[np.diag_indices(len(matrix))] += np.where(images, damping, problem.point_damping(damping) * diagonal)
        gradient = np.asarray(self._design.T @ self._value)
        gradient[:z] += own
        scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, np.diag(matrix), 1.0))
        factor, _ = cholesky(matrix * np.outer(scale, scale))
        step = -scale * lapack.dpotrs(factor, scale * gradient, lower=1)[0]
        inner = self._inner.substitute(step[:z], damping)
        return self._step(step, inner.ground, inner)

    def gradient(self) -> tuple[Array, Array]:
        """Return the gradient of the border (b,) and of the eliminated points (P, 3)."""
        own, ground = self._inner.gradient()
        out = np.asarray(self._design.T @ self._value)
        out[: len(own)] += own
        return out, ground

    def curvature(self, image: Array, ground: Array) -> float:
        """Return the squares of the whitened Jacobian times a direction (b,), (P, 3)."""
        own, z = self._design @ image, self._backend.problem.n_free_unknowns
        return self._inner.curvature(image[:z], ground) + float(own @ own)

    def given(self, image: Array, ground: Array) -> SchurStep:
        """Evaluate a given step (b,), (P, 3), with the error that the linear model predicts after it."""
        return self._step(image, ground, self._inner.given(image[: self._backend.problem.n_free_unknowns], ground))

    def _step(self, border: Array, ground: Array, inner: SchurStep) -> SchurStep:
        """Assemble the whole step from the step of the border and the steps of the eliminated points."""
        left, after = self._value + self._design @ border, inner.after
        moved = after.ground.copy()
        moved[self._backend.named] += border[self._backend.problem.n_free_unknowns :].reshape(-1, 3)
        error = self._excess + inner.predicted_error + 0.5 * float(left @ left)
        length = max(inner.length, float(np.abs(border).max()))
        return SchurStep(border, ground, length, error, self.state, State(after.image, moved))


class NamedBackend:
    """Problem with images and named points for ``fg_orient.adjustment.loop``; other points are eliminated.

    Parameters
    ----------
    problem : Problem

    Raises
    ------
    InputError
        Images and named points have too many unknowns for one matrix.
    """

    name = "schur"

    def __init__(self, problem: Problem) -> None:
        if not small_enough(problem):
            size = problem.n_free_unknowns + 3 * len(problem.named_points())
            raise InputError.of("adjust.schur", option="backend", value=f"{size} unknowns of images and named points")
        self.problem, self.named = problem, problem.named_points()
        #: Backend of the points to eliminate, and the rows of their image points in its order.
        self.inner = SchurBackend(eliminated_part(problem, problem.block.options.datum), reduced="blocks")
        rays = np.flatnonzero(~np.isin(problem.observations.point, self.named))
        self._rows = rays[self.inner.structure.row]
        self.robust: Robust | None = None

    def hold(self, weights: Weights) -> None:
        """Weight the rows of the eliminated points until the next call."""
        observed = self.inner.structure.observed
        self.inner.robust = FixedWeights(weights.image[self._rows], weights.control[observed])

    def linearise(self, state: State) -> NamedSystem:
        """Linearise at a state."""
        if self.robust is None:
            self.inner.robust = None
        return NamedSystem(self, state)

    def error(self, state: State) -> float:
        """Return half the weighted sum of squares, or the cost under the loss."""
        image, control = squares(self.problem, state)
        cost = 0.5 * float(image.sum() + control.sum()) if self.robust is None else self.robust.weigh(image, control)[2]
        prior = self.problem.prior_squares(state) if self.problem.block.options.priors else 0.0
        return cost + 0.5 * prior + half_extras(self.problem, state)

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``stages.RobustBackend``."""
        return squares(self.problem, state)

    def retract(self, state: State, step: SchurStep) -> State:
        """Return the state after a step that was computed at this state."""
        assert step.before is state
        return step.after

    def border(self, state: State) -> Border:
        """Return the border at a solution, for cofactors; under a loss with the weights there."""
        if self.robust is None:
            return Border(self.problem, state)
        return Border(weighted_problem(self.problem, weights_at(self.problem, state, self.robust)[0]), state)
