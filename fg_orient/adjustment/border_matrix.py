"""Normal matrix of a border, which contains the unknowns that remain after points or images are eliminated.

The border of a free network is singular. The unknowns are scaled such that S has a unit
diagonal. U is a basis of the null space, orthonormal in these scaled unknowns. Then ``(S
+ U U^T)^-1 - U U^T`` is the pseudo-inverse in this scale (Koch 1999, 1.59). No unknown is
held fixed. Therefore the condition number is a property of the network, for any datum.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
from scipy.linalg import lapack

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.schur_reduced import Singular, inverse_norm, require_regular

#: Number of rows of a part in :func:`triangle`. With it, 37 000 rows of 16 columns take a third of the time (measured).
PART: Final = 512


@dataclass(frozen=True)
class Followed:
    """Movements (b, d) of the border together with the best movements of the eliminated unknowns.

    Parameters
    ----------
    ground : (N, 3, d) array
        Movements of the ground points, m.
    effect : (q, d) array
        Whitened effect on all observations, compressed by QR. It has the singular values of all rows.
    gradient : (b, d) array
        ``S`` times the movements, computed from the rows without squaring them.
    """

    ground: Array
    effect: Array
    gradient: Array


class BorderMatrix(ABC):
    """Border of a problem, linearised at a state.

    Parameters
    ----------
    problem : Problem
    state : State
    matrix : (b, b) array
        S.
    gradient : (b,) array

    Raises
    ------
    Singular
        Singular :: An unknown of the border is in no observation.
    """

    def __init__(self, problem: Problem, state: State, matrix: Array, gradient: Array) -> None:
        self.problem, self.state, self.matrix, self.gradient = problem, state, matrix, gradient
        #: Basis U (b, d) of the null space of a free network, in scaled unknowns.
        self.null: Array | None = None
        diagonal = np.diag(matrix)
        if not (diagonal > 0.0).all():
            raise Singular("an unknown is in no observation")
        #: Units (b,) of the scaled unknowns.
        self.scale = 1.0 / np.sqrt(diagonal)

    def __len__(self) -> int:
        return len(self.gradient)

    @abstractmethod
    def at(self, state: State) -> Self:
        """Return the border of the same problem at another state.

        It keeps the motions of this border.
        """

    @abstractmethod
    def newton(self) -> State:
        """Return the state after a Gauss-Newton step."""

    @abstractmethod
    def images_of(self, moves: Array) -> Array:
        """Return the movements (z, d) of the image unknowns with movements (b, d) of the border."""

    @abstractmethod
    def follow(self, moves: Array) -> Followed:
        """Move the border by (b, d).

        The eliminated unknowns move such that the observations change least.
        """

    def movements(self, moves: Array) -> tuple[Array, Array]:
        """Return movements (z, d) of images and (N, 3, d) of the points that follow movements (b, d) of the border."""
        return self.images_of(moves), self.follow(moves).ground

    @abstractmethod
    def effect_of(self, images: Array, ground: Array) -> Array:
        """Return the effect (q, d) of movements (z, d) of the images and (N, 3, d) of the points in the border.

        The other unknowns follow.
        """

    @property
    def moves(self) -> Array:
        """Return the motions (b, d) that have no effect on the observations."""
        return np.zeros((len(self), 0)) if self.null is None else self.null * self.scale[:, None]

    @moves.setter
    def moves(self, moves: Array) -> None:
        self.null = np.linalg.qr(moves / self.scale[:, None])[0]

    @cached_property
    def _factor(self) -> tuple[Any, float]:
        """Return the Cholesky factor and the 1-norm of the scaled matrix after the null space is added."""
        s = self.matrix * np.outer(self.scale, self.scale)
        if self.null is not None:
            s += self.null @ self.null.T
        return cholesky(s)

    def condition(self) -> float:
        """Return the condition number of the scaled matrix in the 1-norm, without the null space of a free network."""
        factor, norm = self._factor
        return norm * inverse_norm(lambda right: np.asarray(lapack.dpotrs(factor, right, lower=1)[0]), len(self))

    @cached_property
    def inverse(self) -> Array:
        """Return the cofactors (b, b) of the border; for a free network, the pseudo-inverse in scaled unknowns.

        Singular: the condition number is too large.
        """
        require_regular(self.condition())
        half = np.tril(lapack.dpotri(self._factor[0], lower=1)[0])
        out = half + np.tril(half, -1).T
        if self.null is not None:
            out -= self.null @ self.null.T
        return np.asarray(out * np.outer(self.scale, self.scale))


def cholesky(matrix: Array) -> tuple[Any, float]:
    """Return LAPACK's lower Cholesky factor and the 1-norm of a symmetric matrix, which is overwritten.

    Singular: the matrix is not positive definite.
    """
    norm = float(np.abs(matrix).sum(axis=0).max())
    factor, info = lapack.dpotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
    if info != 0:
        raise Singular("the reduced normal equations are not positive definite")
    return factor, norm


def triangle(rows: Array) -> Array:
    """Compute the matrix R of the QR decomposition of rows (n, d).

    If there are not more rows than columns, return the rows.

    Many rows of few columns are processed in parts that stay in the cache; then their triangles are combined.
    """
    n, d = rows.shape
    if n >= 2 * PART and 4 * d <= PART:
        parts, rest = n // PART, n % PART
        each = np.asarray(np.linalg.qr(rows[: n - rest].reshape(parts, PART, d), mode="r"))
        rows = np.vstack([each.reshape(parts * d, d), rows[n - rest :]])
    return np.asarray(np.linalg.qr(rows, mode="r")) if n > d else rows
