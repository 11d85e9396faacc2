"""The dense backend: the same rows as the graph, as full matrices, for any registered linear solver.

Rows are whitened (the unit is one sigma): image points, control points, priors, extra observations. Columns are image
unknowns (prior sigmas), then unknown ground points (m). The kernels are those of the factors, so that a difference from
the graph backend comes from the solver. GTSAM is not used.

Each step solves ``J x = -r``; Levenberg-Marquardt adds rows of a diagonal matrix. Memory and time grow with the square
and cube of the unknowns: more than :data:`MAX_UNKNOWNS` are refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, check_blocks, evaluate
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.registry import solver as find_solver
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, LinearSystem
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.problem import ExtraArgument, Problem, State
from fg_orient.adjustment.robust import Robust, control_squares, squares
from fg_orient.adjustment.rows import linearised, refuse, residuals, rows_by_image
from fg_orient.model.block import ExtraObservation
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Orthogonal, on J itself: its error grows with cond(J), the error of methods on J^T J with its square.
DEFAULT_SOLVER = "qr"
#: QR with columns of unit length, for unknowns of different magnitude.
SCALED_SOLVER = "qr_scaled"


@dataclass(frozen=True)
class Columns:
    """Columns of the unknowns of a problem: images, then unknown ground points.

    Parameters
    ----------
    images : (M + 1,) int array
        First column of each image's unknowns, and the number of all.
    ground : (p,) int array
        Ground points that are unknowns, in order.
    first : (N,) int array
        First column of each ground point; -1 for points that are not unknowns.
    """

    images: npt.NDArray[np.intp]
    ground: npt.NDArray[np.intp]
    first: npt.NDArray[np.intp]

    @classmethod
    def of(cls, problem: Problem) -> Columns:
        """Columns of a problem."""
        ground = np.flatnonzero(problem.active)
        first = np.full(len(problem.active), -1, dtype=np.intp)
        first[ground] = problem.n_image_unknowns + 3 * np.arange(len(ground))
        return cls(problem.first, ground, first)

    def __len__(self) -> int:
        return int(self.images[-1]) + 3 * len(self.ground)

    def image(self, k: int) -> slice:
        """Columns of an image."""
        return slice(int(self.images[k]), int(self.images[k + 1]))

    def point(self, j: int) -> slice:
        """Columns of an unknown ground point."""
        return slice(int(self.first[j]), int(self.first[j]) + 3)

    def vector(self, state: State) -> Array:
        """Unknowns of a state as one vector (u,)."""
        parts = [state.image[k, : self.images[k + 1] - self.images[k]] for k in range(len(self.images) - 1)]
        return np.concatenate([*parts, state.ground[self.ground].ravel()])

    def moved(self, state: State, step: Array) -> State:
        """State after a step (u,)."""
        image, ground = state.image.copy(), state.ground.copy()
        for k in range(len(image)):
            part = step[self.image(k)]
            image[k, : len(part)] += part
        ground[self.ground] += step[self.images[-1] :].reshape(-1, 3)
        return State(image, ground)


def assemble(problem: Problem, state: State, *, jacobian: bool = True) -> tuple[Array, Array]:
    """Residuals (n,) and Jacobian (n, u) of all observations; the Jacobian is (0, u) if not asked for.

    Raises
    ------
    NotFiniteError
        A residual or Jacobian is nan or inf; names the observation.
    """
    columns = Columns.of(problem)
    parts = [_image_rows(problem, state, columns, jacobian), _control_rows(problem, state, columns, jacobian)]
    if problem.block.options.priors:
        prior = problem.image_vector(state)
        own = np.zeros((len(prior) if jacobian else 0, len(columns)))
        if jacobian:
            own[np.arange(len(prior)), np.arange(len(prior)) if problem.ties is None else problem.ties.place] = 1.0
        parts.append((prior, own))
    parts += [_extra_rows(problem, extra, state, columns, jacobian) for extra in problem.block.extra]
    return np.concatenate([r for r, _ in parts]), np.vstack([j for _, j in parts])


def _image_rows(problem: Problem, state: State, columns: Columns, jacobian: bool) -> tuple[Array, Array]:
    """Two rows per image point."""
    if not jacobian:
        residual = residuals(problem, state)
        _require_finite(problem, state, residual)
        return residual.ravel(), np.zeros((0, len(columns)))
    residual, d_image, d_ground = linearised(problem, state)
    for values in (residual, d_image, d_ground):
        _require_finite(problem, state, values)
    n, o, size = len(residual), problem.observations, np.diff(problem.first)
    out = np.zeros((n, 2, len(columns)))
    for k, rows in enumerate(rows_by_image(problem)):
        out[rows, :, columns.image(k)] = d_image[rows, :, : size[k]]
    free = np.flatnonzero(problem.active[o.point])
    at = columns.first[o.point[free], None] + np.arange(3)
    out[free[:, None, None], np.arange(2)[None, :, None], at[:, None, :]] = d_ground[free]
    return residual.ravel(), out.reshape(2 * n, -1)


def _require_finite(problem: Problem, state: State, values: Array) -> None:
    """Refuse rows that are not finite, as GTSAM factors do in their callbacks."""
    bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    if bad.any():
        refuse(problem, state, int(np.argmax(bad)))


def _control_rows(problem: Problem, state: State, columns: Columns, jacobian: bool) -> tuple[Array, Array]:
    """Three rows ``W (G - G_0)`` per observed control point."""
    observed = np.flatnonzero(problem.observed)
    residual, whitening = problem.control_residuals(state, observed).ravel(), problem.control_weights(observed)
    out = np.zeros((len(observed) if jacobian else 0, 3, len(columns)))
    for row, j in enumerate(observed if jacobian else ()):
        out[row, :, columns.point(int(j))] = whitening[row]
    return residual, out.reshape(-1, len(columns))


def extra_blocks(
    problem: Problem, extra: ExtraObservation, state: State, *, jacobian: bool
) -> tuple[Array, list[tuple[ExtraArgument, Array]]]:
    """Residual and, if asked, Jacobians of an extra observation with their arguments, without constants.

    The kernel of its equation is checked as in a factor.
    """
    arguments = problem.extra_arguments(extra)
    x = [
        problem.unknowns(state, a.index) if a.is_image else np.ascontiguousarray(state.ground[a.index])
        for a in arguments
    ]
    blocks = extra.equation.kernel(extra.record, problem.extra_setup(extra), *x, jacobian)
    sizes = tuple(a.size for a in arguments) if jacobian else ()
    check_blocks(extra.equation.name, extra.label, blocks if jacobian else blocks[:1], sizes, extra.n_residuals)
    if not jacobian:
        return blocks[0], []
    return blocks[0], [(a, block) for a, block in zip(arguments, blocks[1:], strict=True) if a.constant is None]


def _extra_rows(
    problem: Problem, extra: ExtraObservation, state: State, columns: Columns, jacobian: bool
) -> tuple[Array, Array]:
    """Rows of an extra observation."""
    residual, blocks = extra_blocks(problem, extra, state, jacobian=jacobian)
    out = np.zeros((extra.n_residuals if jacobian else 0, len(columns)))
    for a, block in blocks:
        out[:, columns.image(a.index) if a.is_image else columns.point(a.index)] += block
    return residual, out


@dataclass(frozen=True)
class DenseStep:
    """A step (u,); see ``loop.Step``. ``kappa`` of a regularised solver, else nan."""

    data: Array
    length: float
    predicted_error: float
    kappa: float = math.nan


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
        Gives minimum damping and damping of the ground points; without it all columns are damped alike.
    """

    def __init__(
        self, residual: Array, design: Array, solver: str, excess: float = 0.0, problem: Problem | None = None
    ) -> None:
        self.residual, self.design, self._solver, self._excess = residual, design, solver, excess
        self._problem, self._least = problem, 0.0 if problem is None else problem.least_damping
        self.error = excess + 0.5 * float(residual @ residual)

    def solve(self, damping: float) -> DenseStep:
        """Solve with ``damping`` added to the diagonal of the images, ``Problem.point_damping`` to that of the points.

        Raises
        ------
        Breakdown
            The solver fails.
        """
        solution = solve(self._solver, self.equations(damping))
        return self._step(solution.x, math.nan if solution.kappa is None else solution.kappa)

    def equations(self, damping: float = 0.0) -> LinearSystem:
        """Equations of the step for a solver, with the rows of the damping; see :meth:`solve`."""
        design, observed, damping = self.design, -self.residual, max(damping, self._least)
        if damping > 0.0:
            u = design.shape[1]
            design = np.vstack([design, np.diag(self._damping_roots(damping))])
            observed = np.concatenate([observed, np.zeros(u)])
        return LinearSystem.from_design(design, observed)

    def _damping_roots(self, damping: float) -> Array:
        """Roots (u,) of the diagonal that a damping adds to the normal equations."""
        out = np.full(self.design.shape[1], np.sqrt(damping))
        if self._problem is not None:
            first = self._problem.n_free_unknowns
            out[first:] = np.sqrt(self._problem.point_damping(damping)) * np.linalg.norm(self.design[:, first:], axis=0)
        return out

    def dogleg(self, radius: float) -> DenseStep:
        """Blend of the steepest-descent and the Gauss-Newton step."""
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

    def _step(self, x: Array, kappa: float = math.nan) -> DenseStep:
        after = self.residual + self.design @ x
        return DenseStep(x, float(np.abs(x).max()), self._excess + 0.5 * float(after @ after), kappa)


#: Whitened residuals (n,) and their derivatives (n, u) at a state; without derivatives (0, u).
DenseRows = Callable[[Array, bool], tuple[Array, Array]]


def equation_rows(equation: Equation, records: Array, setup: Array, fixed: Sequence[Array] = ()) -> DenseRows:
    """Rows of a registered equation with a common first unknown.

    Parameters
    ----------
    equation : Equation
    records : (n, d) array
    setup : (2, k) array
    fixed : sequence of (n, k_i) arrays
        Values of its other arguments.
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
        State after a step.
    """

    def __init__(self, rows: DenseRows, moved: Callable[[Array, Array], Array] = np.add) -> None:
        self.rows, self._moved = rows, moved

    def linearise(self, state: Array) -> DenseSystem:
        """Linearise at a state."""
        return DenseSystem(*self.rows(state, True), SCALED_SOLVER)

    def error(self, state: Array) -> float:
        """Half the weighted sum of squares."""
        with np.errstate(all="ignore"):  # a trial step may leave the model: the loop rejects errors that are not finite
            residual, _ = self.rows(state, False)
            return 0.5 * float(residual @ residual)

    def retract(self, state: Array, step: DenseStep) -> Array:
        """State after a step."""
        return self._moved(state, step.data)


class DenseBackend:
    """The problem as full matrices, driven by ``fg_orient.adjustment.loop``.

    Parameters
    ----------
    problem : Problem
    solver : str
        Name in the registry of linear solvers; a regularised solver regularises each step.

    Raises
    ------
    InputError
        More than 2000 unknowns, before any matrix is allocated; no such solver.
    """

    name = "dense"

    def __init__(self, problem: Problem, solver: str = DEFAULT_SOLVER) -> None:
        if problem.n_unknowns > MAX_UNKNOWNS:
            raise InputError.of("linear.too_large", option="backend", value=problem.n_unknowns, limit=MAX_UNKNOWNS)
        self.problem, self.solver = problem, find_solver(solver).name
        self.columns = Columns.of(problem)
        self.robust: Robust | None = None

    def initial(self) -> State:
        """Start values."""
        return self.problem.start

    def linearise(self, state: State) -> DenseSystem:
        """Linearise at a state."""
        residual, design = assemble(self.problem, state)
        if self.problem.ties is not None:
            design = self.problem.ties.columns(design)
        if self.robust is None:
            return DenseSystem(residual, design, self.solver, problem=self.problem)
        root, excess = self._weights(self.robust, residual, state)
        return DenseSystem(residual * root, design * root[:, None], self.solver, excess, self.problem)

    def error(self, state: State) -> float:
        """Half the weighted sum of squares, or the cost under the loss."""
        residual, _ = assemble(self.problem, state, jacobian=False)
        if self.robust is None:
            return 0.5 * float(residual @ residual)
        root, excess = self._weights(self.robust, residual, state)
        return excess + 0.5 * float(np.sum((root * residual) ** 2))

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``."""
        return squares(self.problem, state)

    def _weights(self, robust: Robust, residual: Array, state: State) -> tuple[Array, float]:
        """Roots of the weights of all rows (n,); excess of the cost over half the weighted squares."""
        n = 2 * len(self.problem.observations)
        image_squares = np.sum(residual[:n].reshape(-1, 2) ** 2, axis=1)
        observed_squares = control_squares(self.problem, state)
        image, control, cost = robust.weigh(image_squares, observed_squares)
        weights = np.ones(len(residual))
        weights[: n + 3 * len(control)] = np.concatenate([np.repeat(image, 2), np.repeat(control, 3)])
        return np.sqrt(weights), cost - 0.5 * float(image @ image_squares + control @ observed_squares)

    def retract(self, state: State, step: DenseStep) -> State:
        """State after a step."""
        ties = self.problem.ties
        return self.columns.moved(state, step.data if ties is None else ties.widened(step.data))
