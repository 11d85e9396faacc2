"""Own observations of single images on the Schur backend, and its steps.

An observation that names one image and no ground point adds ``J^T J`` to that image's own block of the reduced system,
and nothing else: elimination and back-substitution of the ground points do not know of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.schur_structure import Structure

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SchurStep:
    """A step; see ``loop.Step``. ``image`` (u,) prior sigmas, ``ground`` (P, 3) m, the states before and after it."""

    image: Array
    ground: Array
    length: float
    predicted_error: float
    before: State
    after: State

    @property
    def data(self) -> tuple[Array, Array]:
        """Both parts."""
        return self.image, self.ground

    @property
    def norm(self) -> float:
        """Euclidean norm."""
        return float(np.sqrt(np.sum(self.image**2) + np.sum(self.ground**2)))


class OwnOfImages:
    """The own observations of a problem, each of one image; rows are evaluated by their kernels as in a factor.

    Parameters
    ----------
    problem : Problem
        Every own observation names one image and no ground point.
    structure : Structure
    """

    def __init__(self, problem: Problem, structure: Structure) -> None:
        self._problem = problem
        self._images = [problem.extra_arguments(extra)[0].index for extra in problem.block.extra]
        own = structure.block_row == structure.block_column
        self._block = {int(structure.block_row[b]): int(b) for b in np.flatnonzero(own)}

    def rows(self, state: State) -> OwnRows:
        """Linearise at a state.

        Raises
        ------
        ValueError
            A residual or Jacobian is not finite, or of the wrong shape; names the observation.
        """
        found = [extra_blocks(self._problem, extra, state, jacobian=True) for extra in self._problem.block.extra]
        return OwnRows(self._problem, self._images, self._block, [(r, blocks[0][1]) for r, blocks in found])

    def half_squares(self, state: State) -> float:
        """Half the sum of squares of the residuals."""
        found = (extra_blocks(self._problem, extra, state, jacobian=False)[0] for extra in self._problem.block.extra)
        return 0.5 * sum(float(r @ r) for r in found)


@dataclass(frozen=True)
class OwnRows:
    """One linearisation: residuals (m,) and Jacobians (m, k) of each observation, and its image."""

    problem: Problem
    images: list[int]
    block_of: dict[int, int]
    rows: list[tuple[Array, Array]]

    def add_blocks(self, blocks: Array) -> None:
        """Add ``J^T J`` to the blocks (B, k, k) of the reduced system."""
        for k, (_, j) in zip(self.images, self.rows, strict=True):
            blocks[self.block_of[k], : j.shape[1], : j.shape[1]] += j.T @ j

    @cached_property
    def gradient(self) -> Array:
        """``J^T r`` (w,), each image's unknowns for themselves."""
        out = np.zeros(self.problem.n_image_unknowns)
        for k, (r, j) in zip(self.images, self.rows, strict=True):
            out[self.problem.first[k] : self.problem.first[k + 1]] += j.T @ r
        return out

    def squares_along(self, image: Array, share: float) -> float:
        """Squares of ``share`` of the residuals plus their Jacobian times a step (u,) of the images."""
        step = self.problem.image_matrix(image)
        parts = (share * r + j @ step[k, : j.shape[1]] for k, (r, j) in zip(self.images, self.rows, strict=True))
        return sum(float(v @ v) for v in parts)
