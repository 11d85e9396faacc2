"""Dense backend: it solves the same rows as the graph, as full matrices, by any registered linear solver.

Rows are whitened, so that their unit is one sigma. They are image points, control points,
priors and extra observations. Columns are the image unknowns (prior sigmas), then the
unknown ground points (m). The kernels are the same as in the factors. Therefore a
difference from the graph backend comes from the solver. GTSAM is not used.

Each step solves ``J x = -r``; Levenberg-Marquardt adds rows of a diagonal matrix. Memory
and time grow with the square and cube of the unknowns; more than :data:`MAX_UNKNOWNS` are
refused by default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from factors._contract import Equation, NotFiniteError, check_blocks, evaluate
from factors.arrays import Array
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.registry import solver as find_solver
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, LinearSystem
from fg_orient.adjustment.loop import Step, share_at_radius
from fg_orient.adjustment.problem import ExtraArgument, Problem, State
from fg_orient.adjustment.robust import Robust, control_squares, squares, together, two_ray_rows
from fg_orient.adjustment.rows import linearised, refuse, residuals, rows_by_image
from fg_orient.model.arrays import wrong
from fg_orient.model.block import ExtraObservation
from fg_orient.model.errors import InputError

#: Default solver. It is orthogonal, so that its error grows with cond(J). The error of
#: methods that use J^T J grows with the square of cond(J).
DEFAULT_SOLVER = "qr"
#: QR with columns of unit length, for unknowns of different magnitude.
SCALED_SOLVER = "qr_scaled"


def assemble(problem: Problem, state: State, *, jacobian: bool = True) -> tuple[Array, Array]:
    """Return the residuals (n,) of all observations and the Jacobian (n, u), columns as in ``Problem.vector``.

    Without ``jacobian`` the second array is (0, u).

    NotFiniteError: a residual or Jacobian is nan or inf; the message names the observation.
    """
    parts = [_image_rows(problem, state, jacobian), _control_rows(problem, state, jacobian)]
    if problem.block.options.priors:
        prior = problem.image_vector(state)
        own = np.zeros((len(prior) if jacobian else 0, problem.n_columns))
        if jacobian:
            own[np.arange(len(prior)), np.arange(len(prior)) if problem.ties is None else problem.ties.place] = 1.0
        parts.append((prior, own))
    parts += [_extra_rows(problem, extra, state, jacobian) for extra in problem.block.extra]
    return np.concatenate([r for r, _ in parts]), np.vstack([j for _, j in parts])


def _image_rows(problem: Problem, state: State, jacobian: bool) -> tuple[Array, Array]:
    """Return two rows per image point; NotFiniteError as in the callbacks of GTSAM factors."""
    rows = linearised(problem, state) if jacobian else None
    residual = residuals(problem, state) if rows is None else rows.residual
    for values in rows or (residual,):
        bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        if bad.any():
            refuse(problem, state, int(np.argmax(bad)))
    point, size = problem.observations.point, np.diff(problem.first)
    out = np.zeros((0 if rows is None else len(point), 2, problem.n_columns))
    if rows is not None:
        for k, own in enumerate(rows_by_image(problem)):
            out[own, :, problem.image_slice(k)] = rows.image[own, :, : size[k]]
        free = np.flatnonzero(problem.active[point])
        at = problem.point_columns[point[free], None] + np.arange(3)
        out[free[:, None, None], np.arange(2)[None, :, None], at[:, None, :]] = rows.ground[free]
    return residual.ravel(), out.reshape(-1, problem.n_columns)


def _control_rows(problem: Problem, state: State, jacobian: bool) -> tuple[Array, Array]:
    """Return three rows ``W (G - G_0)`` per observed control point."""
    observed = np.flatnonzero(problem.observed)
    residual, whitening = problem.control_residuals(state, observed).ravel(), problem.control_weights(observed)
    out = np.zeros((len(observed) if jacobian else 0, 3, problem.n_columns))
    for row, j in enumerate(observed if jacobian else ()):
        out[row, :, problem.point_slice(int(j))] = whitening[row]
    return residual, out.reshape(-1, problem.n_columns)


def extra_blocks(
    problem: Problem, extra: ExtraObservation, state: State, *, jacobian: bool
) -> tuple[Array, list[tuple[ExtraArgument, Array]]]:
    """Return residual and, if requested, Jacobians of an extra observation with their arguments, without constants.

    The output of the equation's kernel is checked in the same way as in a factor.
    """
    arguments = problem.extra_arguments(extra)
    x = [
        problem.unknowns(state, a.index)
        if a.is_image
        else np.ascontiguousarray(state.ground[a.index])
        if a.constant is None
        else a.constant
        for a in arguments
    ]
    try:
        blocks = extra.equation.kernel(extra.record, problem.extra_setup(extra), *x, jacobian)
    except NotFiniteError:
        raise
    except (ValueError, IndexError) as error:
        expected = f"constants of the equation {extra.equation.name}"
        raise wrong(f"{extra.label}, record", f"shape {extra.record.shape}", expected) from error
    sizes = tuple(a.size for a in arguments) if jacobian else ()
    check_blocks(extra.equation.name, extra.label, blocks if jacobian else blocks[:1], sizes, extra.n_residuals)
    if not jacobian:
        return blocks[0], []
    return blocks[0], [(a, block) for a, block in zip(arguments, blocks[1:], strict=True) if a.constant is None]


def _extra_rows(problem: Problem, extra: ExtraObservation, state: State, jacobian: bool) -> tuple[Array, Array]:
    """Return the rows of an extra observation."""
    residual, blocks = extra_blocks(problem, extra, state, jacobian=jacobian)
    out = np.zeros((extra.n_residuals if jacobian else 0, problem.n_columns))
    for a, block in blocks:
        out[:, problem.image_slice(a.index) if a.is_image else problem.point_slice(a.index)] += block
    return residual, out


class DenseSystem:
    """One linearisation ``J x = -r``; see ``loop.System``.

    Parameters
    ----------
    residual : (n,) array
    design : (n, u) array
        J.
    solver : str
        Name in the registry of linear solvers.
    excess : float
        Cost under a loss minus half the sum of squares of the weighted residuals.
    problem : Problem, optional
        Problem that defines the minimum damping and the damping of ground points; without
        it all columns have the same damping.
    limit : int
        Maximum number of unknowns.
    """

    def __init__(
        self,
        residual: Array,
        design: Array,
        solver: str,
        excess: float = 0.0,
        problem: Problem | None = None,
        limit: int = MAX_UNKNOWNS,
    ) -> None:
        self.residual, self.design, self._solver, self._excess = residual, design, solver, excess
        self._problem, self._least = problem, 0.0 if problem is None else problem.least_damping
        self._limit = limit
        self.error = excess + 0.5 * float(residual @ residual)

    def solve(self, damping: float) -> Step:
        """Solve the equations; raise Breakdown if the solver fails.

        ``damping`` is added to the diagonal of the images, ``Problem.point_damping`` to
        the diagonal of the points.
        """
        solution = solve(self._solver, self.equations(damping))
        return self._step(solution.x, math.nan if solution.kappa is None else solution.kappa)

    def equations(self, damping: float = 0.0) -> LinearSystem:
        """Return the equations of the step for a solver, with the rows of the damping.

        See :meth:`solve`.
        """
        design, observed, damping = self.design, -self.residual, max(damping, self._least)
        if damping > 0.0:
            u = design.shape[1]
            design = np.vstack([design, np.diag(self._damping_roots(damping))])
            observed = np.concatenate([observed, np.zeros(u)])
        return LinearSystem.from_design(design, observed, limit=self._limit)

    def _damping_roots(self, damping: float) -> Array:
        """Return the roots (u,) of the diagonal that a damping adds to the normal equations."""
        out = np.full(self.design.shape[1], np.sqrt(damping))
        if self._problem is not None:
            first = self._problem.n_free_unknowns
            out[first:] = np.sqrt(self._problem.point_damping(damping)) * np.linalg.norm(self.design[:, first:], axis=0)
        return out

    def dogleg(self, radius: float) -> Step:
        """Return a blend of the steepest-descent and the Gauss-Newton step."""
        newton = self.solve(0.0)
        if np.linalg.norm(newton.data) <= radius:
            return newton
        gradient = self.design.T @ self.residual
        along = self.design @ gradient
        steepest = -gradient * (gradient @ gradient) / (along @ along)
        length = float(np.linalg.norm(steepest))
        if length >= radius:
            return self._step(steepest * (radius / length))
        across = newton.data - steepest
        share = share_at_radius(float(across @ across), float(steepest @ across), length, radius)
        return self._step(steepest + share * across)

    def _step(self, x: Array, kappa: float = math.nan) -> Step:
        after = self.residual + self.design @ x
        return Step(x, float(np.abs(x).max()), self._excess + 0.5 * float(after @ after), kappa)


#: Whitened residuals (n,) and their derivatives (n, u) at a state; without derivatives (0, u).
DenseRows = Callable[[Array, bool], tuple[Array, Array]]


def equation_rows(equation: Equation, records: Array, setup: Array, fixed: Sequence[Array] = ()) -> DenseRows:
    """Return the rows of a registered equation whose first argument is the vector of unknowns.

    Parameters
    ----------
    equation : Equation
    records : (n, d) array
    setup : (2, k) array
    fixed : sequence of (n, k_i) arrays
        Values of the other arguments of the equation.
    """
    n = len(records)

    def rows(x: Array, want: bool) -> tuple[Array, Array]:
        if equation.arrays:
            value, jacobian = equation.kernel(records, setup, x, want)
            return value.ravel(), jacobian.reshape(-1, len(x))
        values, blocks = evaluate(equation, records, [setup] * n, [x] * n, *fixed, jacobian=want)
        return values.ravel(), np.concatenate(blocks[0]) if want else np.zeros((0, len(x)))

    return rows


class RowsBackend:
    """Rows of a small problem for ``fg_orient.adjustment.loop``.

    Parameters
    ----------
    rows : callable
        See :data:`DenseRows`.
    moved : callable
        Function that returns the state after a step.
    """

    def __init__(self, rows: DenseRows, moved: Callable[[Array, Array], Array] = np.add) -> None:
        self.rows, self._moved = rows, moved

    def linearise(self, state: Array) -> DenseSystem:
        """Linearise at a state."""
        return DenseSystem(*self.rows(state, True), SCALED_SOLVER)

    def error(self, state: Array) -> float:
        """Return half the weighted sum of squares."""
        with np.errstate(all="ignore"):  # outside its domain the model gives nan or inf; the loop rejects such steps
            residual, _ = self.rows(state, False)
            return 0.5 * float(residual @ residual)

    def retract(self, state: Array, step: Step) -> Array:
        """Return the state after a step."""
        return self._moved(state, step.data)


class DenseBackend:
    """The problem as full matrices; ``fg_orient.adjustment.loop`` iterates on it.

    Parameters
    ----------
    problem : Problem
    solver : str
        Name in the registry of linear solvers; a regularised solver regularises each step.
    limit : int, optional
        Maximum number of unknowns; default: :data:`MAX_UNKNOWNS`.

    Raises
    ------
    InputError
        Too many unknowns (checked before any matrix is allocated); there is no such solver.
    """

    name = "dense"

    def __init__(self, problem: Problem, solver: str = DEFAULT_SOLVER, limit: int | None = None) -> None:
        self._limit = MAX_UNKNOWNS if limit is None else limit
        if problem.n_unknowns > self._limit:
            raise InputError.of("linear.too_large", option="backend", value=problem.n_unknowns, limit=self._limit)
        self.problem, self.solver = problem, find_solver(solver).name
        self.robust: Robust | None = None

    def initial(self) -> State:
        """Return the start values."""
        return self.problem.start

    def linearise(self, state: State) -> DenseSystem:
        """Linearise at a state."""
        residual, design = assemble(self.problem, state)
        if self.problem.ties is not None:
            design = self.problem.ties.columns(design)
        if self.robust is None:
            return DenseSystem(residual, design, self.solver, 0.0, self.problem, self._limit)
        root, excess = self._weights(self.robust, residual, state)
        return DenseSystem(residual * root, design * root[:, None], self.solver, excess, self.problem, self._limit)

    def error(self, state: State) -> float:
        """Return half the weighted sum of squares, or the cost under the loss."""
        residual, _ = assemble(self.problem, state, jacobian=False)
        if self.robust is None:
            return 0.5 * float(residual @ residual)
        root, excess = self._weights(self.robust, residual, state)
        return excess + 0.5 * float(np.sum((root * residual) ** 2))

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``stages.RobustBackend``."""
        return squares(self.problem, state)

    def _weights(self, robust: Robust, residual: Array, state: State) -> tuple[Array, float]:
        """Return the roots of the weights (n,) of all rows, and the cost minus half the weighted sum of squares."""
        n = 2 * len(self.problem.observations)
        image_squares = together(np.sum(residual[:n].reshape(-1, 2) ** 2, axis=1), two_ray_rows(self.problem))
        observed_squares = control_squares(self.problem, state)
        image, control, cost = robust.weigh(image_squares, observed_squares)
        weights = np.ones(len(residual))
        weights[: n + 3 * len(control)] = np.concatenate([np.repeat(image, 2), np.repeat(control, 3)])
        return np.sqrt(weights), cost - 0.5 * float(image @ image_squares + control @ observed_squares)

    def retract(self, state: State, step: Step) -> State:
        """Return the state after a step."""
        ties = self.problem.ties
        return self.problem.moved(state, step.data if ties is None else ties.widened(step.data))
