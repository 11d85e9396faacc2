"""The module writes a problem as a vector of unknowns and a vector of residuals for general solvers.

Residuals and Jacobians come from the compiled scalar function that the factors call
(``Equation.fill``), in the same units and from the same start. Therefore half the sum of
squares is the cost that the backends of fg_orient report.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from numba import njit

from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem

Array = npt.NDArray[np.float64]


@cache
def loop_over(fill: Any) -> Any:
    """Return the compiled loop over the image points of a problem with one equation and one set of unknowns."""

    @njit
    def rows(records, setup, image, place, x, first_point, fixed, value, data, want):  # type: ignore[no-untyped-def]
        """Write the residuals (2 n) and, if wanted, the Jacobian's rows; image unknowns stand before point unknowns."""
        k = setup.shape[1]
        out, ground, at = np.empty((2, k + 4)), np.empty(3), 0
        for a in range(len(image)):
            p = place[a]
            for c in range(3):
                ground[c] = x[first_point + 3 * p + c] if p >= 0 else fixed[a, c]
            if not fill(records, a, setup, x[k * image[a] : k * (image[a] + 1)], ground, out, want):
                return a
            for r in range(2):
                value[2 * a + r] = out[r, 0]
                if want:
                    wide = k + 3 if p >= 0 else k
                    data[at : at + wide] = out[r, 1 : 1 + wide]
                    at += wide
        return -1

    return rows


class FlatProblem:
    """The unknowns are those of all images, followed by the coordinates of the unknown ground points (m, local).

    Parameters
    ----------
    problem : Problem
        All images have one equation and the same unknowns, with or without priors.
    """

    def __init__(self, problem: Problem) -> None:
        model = problem.models[0]
        equal = all(
            m.equation is model.equation and np.array_equal(m.parameters.setup, model.parameters.setup)
            for m in problem.models
        )
        if not equal or model.equation.fill is None:
            raise ValueError("all images must have the same equation, with a fill function, and the same unknowns")
        self.problem, self.setup = problem, np.ascontiguousarray(model.parameters.setup)
        self.k, self.n_images = self.setup.shape[1], problem.n_images
        self.points = np.flatnonzero(problem.active)
        place = np.full(len(problem.active), -1)
        place[self.points] = np.arange(len(self.points))
        o = problem.observations
        self.image, self.place = o.image.astype(np.int64), place[o.point].astype(np.int64)
        self.n_image_unknowns = self.k * self.n_images
        self.fixed = np.nan_to_num(problem.start.ground[o.point])
        self.priors = bool(problem.block.options.priors)
        self.start = np.concatenate([problem.image_vector(problem.start), problem.start.ground[self.points].ravel()])
        self.observed = place[np.flatnonzero(problem.observed)]
        records = problem.control_records[problem.observed]
        self.w, self.known = records[:, POINT.whitening].reshape(-1, 3, 3), records[:, POINT.place]
        self._rows = loop_over(model.equation.fill)
        self._indices, self._indptr, self._constant = self._pattern()
        self._n_data = int(self._indptr[2 * len(self.image)])

    @property
    def n_residuals(self) -> int:
        """Number of equations of image points, control points and priors."""
        return 2 * len(self.image) + 3 * len(self.observed) + self.priors * self.n_image_unknowns

    def _pattern(self) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], Array]:
        """Return the CSR columns and row starts, and the constant elements of control points and priors."""
        first = self.n_image_unknowns
        image = self.k * self.image[:, None] + np.arange(self.k)
        point = first + 3 * self.place[:, None] + np.arange(3)
        free = np.repeat(self.place >= 0, 2)
        both = np.repeat(np.hstack([image, point]), 2, axis=0)
        keep = np.hstack([np.ones((len(both), self.k), bool), np.repeat(free[:, None], 3, axis=1)])
        control = np.repeat(first + 3 * self.observed[:, None] + np.arange(3), 3, axis=0)
        priors = np.arange(first if self.priors else 0)
        lengths = np.concatenate([keep.sum(axis=1), np.full(len(control), 3), np.ones(len(priors), int)])
        indices = np.concatenate([both[keep], control.ravel(), priors]).astype(np.int32)
        indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        return indices, indptr, np.concatenate([self.w.ravel(), np.ones(len(priors))])

    def residuals(self, x: Array) -> Array:
        """Return all residuals."""
        return self._evaluate(x, np.empty(0), want=False)

    def _evaluate(self, x: Array, data: Array, *, want: bool) -> Array:
        n = 2 * len(self.image)
        value = np.empty(self.n_residuals)
        bad = self._rows(
            self.problem.records, self.setup, self.image, self.place, x, self.n_image_unknowns, self.fixed, value[:n],
            data, want,
        )  # fmt: skip
        if bad >= 0:
            raise FloatingPointError(self.problem.label(bad))
        ground = x[self.n_image_unknowns :].reshape(-1, 3)[self.observed]
        value[n : n + 3 * len(ground)] = np.einsum("nij,nj->ni", self.w, ground - self.known).ravel()
        if self.priors:
            value[n + 3 * len(ground) :] = x[: self.n_image_unknowns]
        return value

    def jacobian(self, x: Array) -> sp.csr_matrix:
        """Return all derivatives as a sparse matrix."""
        data = np.empty(len(self._indices))
        self._evaluate(x, data, want=True)
        data[self._n_data :] = self._constant
        return sp.csr_matrix((data, self._indices, self._indptr), shape=(self.n_residuals, len(x)))

    def sparsity(self) -> sp.csr_matrix:
        """Return the pattern of elements of the Jacobian that may differ from zero."""
        ones = np.ones(len(self._indices))
        return sp.csr_matrix((ones, self._indices, self._indptr), shape=(self.n_residuals, len(self.start)))

    def warm_up(self) -> None:
        """Compile the functions that the methods call."""
        self.residuals(self.start)
        self.jacobian(self.start)

    def cost(self, x: Array) -> float:
        """Return half the sum of squares."""
        value = self.residuals(x)
        return 0.5 * float(value @ value)
