"""Ceres runs through pyceres with the same compiled function for each image point and a sparse Schur complement."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pyceres
from numba import njit

from benchmarks.entries import LIMIT_S, MAX_EVALUATIONS, Outcome, ceres_outcome
from benchmarks.flat import FlatProblem
from benchmarks.own import repeated

Array = npt.NDArray[np.float64]


@cache
def _evaluation(fill: Any) -> Any:
    """Return the compiled function that writes residual and Jacobians of one image point to the arrays of Ceres."""

    @njit
    def evaluate(records, row, setup, x, ground, out, residual, d_image, d_ground, want):  # type: ignore[no-untyped-def]
        k = len(x)
        if not fill(records, row, setup, x, ground, out, want):
            return False
        for r in range(2):
            residual[r] = out[r, 0]
            if want:
                for c in range(k):
                    d_image[r * k + c] = out[r, 1 + c]
                for c in range(3):
                    d_ground[r * 3 + c] = out[r, 1 + k + c]
        return True

    return evaluate


def _point_cost(flat: FlatProblem) -> type[pyceres.CostFunction]:
    """Return the class of the costs of image points; all share the working arrays, because Ceres runs one thread."""
    fill = flat.problem.models[0].equation.fill
    evaluate, records, setup, k = _evaluation(fill), flat.problem.records, flat.setup, flat.k
    out, none = np.empty((2, k + 4)), np.empty(0)

    class ImagePoint(pyceres.CostFunction):
        """The cost has the whitened conditions of one image point."""

        def __init__(self, row: int) -> None:
            pyceres.CostFunction.__init__(self)
            self.row = row
            self.set_num_residuals(2)
            self.set_parameter_block_sizes([k, 3])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
            """Called by Ceres."""
            x, ground = parameters
            if jacobians is None:
                return bool(evaluate(records, self.row, setup, x, ground, out, residuals, none, none, False))
            return bool(evaluate(records, self.row, setup, x, ground, out, residuals, *jacobians, True))

    return ImagePoint


class Linear(pyceres.CostFunction):
    """The cost of a control point or of the priors of an image is ``w (x - known)``."""

    def __init__(self, w: Array, known: Array) -> None:
        pyceres.CostFunction.__init__(self)
        self.w, self.known = w, known
        self.set_num_residuals(len(w))
        self.set_parameter_block_sizes([w.shape[1]])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Called by Ceres."""
        residuals[:] = self.w @ (parameters[0] - self.known)
        if jacobians is not None and jacobians[0] is not None:
            jacobians[0][:] = self.w.ravel()
        return True


def _problem(flat: FlatProblem) -> tuple[pyceres.Problem, Array, Array, list[Any]]:
    """Return Ceres' problem, the arrays of its unknowns, and the costs, which Python must not delete."""
    images = flat.start[: flat.n_image_unknowns].reshape(flat.n_images, flat.k).copy()
    points = flat.start[flat.n_image_unknowns :].reshape(-1, 3).copy()
    if (flat.place < 0).any():
        raise ValueError("constant ground points are not needed here")
    kind, problem, kept = _point_cost(flat), pyceres.Problem(), []
    image_views, point_views = list(images), list(points)
    for row, (i, p) in enumerate(zip(flat.image.tolist(), flat.place.tolist(), strict=True)):
        cost = kind(row)
        problem.add_residual_block(cost, None, [image_views[i], point_views[p]])
        kept.append(cost)
    others = [(Linear(w, known), point_views[p]) for w, known, p in zip(flat.w, flat.known, flat.observed, strict=True)]
    if flat.priors:
        others += [(Linear(np.eye(flat.k), np.zeros(flat.k)), view) for view in image_views]
    for cost, view in others:
        problem.add_residual_block(cost, None, [view])
        kept.append(cost)
    return problem, images, points, [kept, image_views, point_views]


def sparse_schur(flat: FlatProblem) -> Callable[[], Outcome]:
    """Return Levenberg-Marquardt with Ceres' defaults and SPARSE_SCHUR. Costs in Python allow only one thread."""

    def once() -> Outcome:
        start = time.perf_counter()
        problem, _images, _points, kept = _problem(flat)
        options, summary = pyceres.SolverOptions(), pyceres.SolverSummary()
        options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
        options.num_threads = 1
        options.max_num_iterations = MAX_EVALUATIONS
        options.max_solver_time_in_seconds = LIMIT_S
        options.minimizer_progress_to_stdout = False
        options.logging_type = pyceres.LoggingType.SILENT
        made = time.perf_counter()
        pyceres.solve(options, problem, summary)
        seconds = time.perf_counter() - made
        del kept
        return ceres_outcome(summary, made - start, seconds, summary.linear_solver_type_used.name)

    return repeated(once)
