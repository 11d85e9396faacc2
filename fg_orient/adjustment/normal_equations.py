"""Reduced normal equations of the images at a state, plus a multiple of the identity.

Used for regularisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_choice import LARGEST_FULL
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.schur_reduced import LapackReduced, banded_order
from fg_orient.model.errors import InputError

#: Number of steps of the power method. Its start vector contains ones. The largest
#: eigenvalue is needed only within a factor of two.
STEPS = 20


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal matrix N (z, z) of the free image unknowns as blocks of images; points are eliminated, priors left out.

    Parameters
    ----------
    backend : SchurBackend
    blocks : (B, k, k) array
    added : (z, z) array or None
        Contribution of observations of several images.
    rhs : (z,) array
        ``A^T l`` of a step.
    squares : float
        Squares of the residuals after the elimination of the points, without priors.
    """

    backend: SchurBackend
    blocks: Array
    added: Array | None
    rhs: Array
    squares: float

    @classmethod
    def of(cls, problem: Problem, state: State) -> NormalEquations:
        """Linearise and eliminate; leave out the priors of the problem.

        Singular: a ground point is not determined. InputError: extra observations name
        ground points; the system has neither a narrow band nor at most 15000 unknowns.
        """
        backend = SchurBackend(problem, reduced="dense")
        linear, pattern = backend.linearise(state), backend.structure.pattern
        whole = problem.ties is not None or linear.joined is not None
        if problem.n_free_unknowns > LARGEST_FULL and (whole or banded_order(pattern, problem.first) is None):
            raise InputError.of("linear.too_large", place="N", value=problem.n_free_unknowns, limit=MAX_UNKNOWNS)
        blocks, gradient = linear.partial(0.0)
        x = problem.image_vector(state)
        squares = 2.0 * linear.substitute(np.zeros(len(x)), 0.0).predicted_error
        prior = backend.prior * x
        return cls(backend, blocks.copy(), linear.joined, prior - gradient, squares - float(prior @ x))

    def factor(self, diagonal: float) -> Callable[[Array], Array]:
        """Return a function that solves ``N + diagonal I`` for columns (z, k).

        Singular: the matrix is not positive definite.
        """
        pattern, problem = self.backend.structure.pattern, self.backend.problem
        whole = problem.ties is not None or self.added is not None
        order = None if whole else banded_order(pattern, problem.first)
        known = LapackReduced(pattern, problem.first, self.blocks, diagonal, order, problem.ties, self.added)
        return lambda columns: -known.solve(columns)

    def product(self, x: Array) -> Array:
        """Return N x (z,)."""
        problem, (row, column) = self.backend.problem, self.backend.structure.pattern.blocks
        wide = problem.image_matrix(x)
        out, other = np.zeros(wide.shape), row != column
        np.add.at(out, row, np.einsum("bij,bj->bi", self.blocks, wide[column]))
        np.add.at(out, column[other], np.einsum("bij,bi->bj", self.blocks[other], wide[row[other]]))
        flat = problem.image_columns(State(out, np.zeros((0, 3))))
        summed = flat if problem.ties is None else problem.ties.summed(flat)
        return np.asarray(summed if self.added is None else summed + self.added @ x)

    def largest(self) -> float:
        """Return the largest eigenvalue, by the power method."""
        x, size = np.ones(len(self.rhs)) / np.sqrt(len(self.rhs)), 0.0
        for _ in range(STEPS):
            moved = self.product(x)
            size = float(np.linalg.norm(moved))
            if size == 0.0:
                break
            x = moved / size
        return size
