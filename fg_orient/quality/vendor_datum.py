"""Datum of a block without control points: directions that the rays hardly determine stay at the metadata.

A movement x of the image unknowns moves the image points by ``J x``. The ground points move with the images.
The points cannot follow the whole movement; the remaining part appears in the residuals. N is ``J^T J``. S is
the normal matrix of the images without priors, after the elimination of all points. Their eigenvalues mu are

    S v = mu N v,    0 <= mu <= 1 without control points

mu is the share of the movement v that changes the residuals. Translations of the block have mu = 0. The smallest errors
of tie points and image models determine movements with a small mu: a y-parallax of 0.3 px moves an image by 0.3 /
sqrt(mu) px. A loose prior does not prevent this, because hundreds of tie points outweigh it. Such directions are
therefore held at the metadata, ``v^T N x = 0``. The condition is ``mu max(1, d^2) < SEEN`` with the RMS d of the
residuals of the rays at the metadata, in sigmas. These are inner constraints on the image unknowns, in the metric of
the image points. A movement as large as the disagreement of the images would add less than 0.2 sigma to the residuals
there. The other directions reduce the y-parallax and stay free. Of all corrections of the image points with these
y-parallaxes, the result is the smallest (minimum norm; Koch 1999, 1.5).

The cofactors Q of the solution then describe the shape. The held part of the error of the metadata is ``V V^T N x``
with ``x ~ N(0, 1)`` in prior sigmas. It is added if a position is compared with the Earth: at check points.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.linalg import eigh

from factors.arrays import Array, Index
from fg_orient.adjustment.border import Border, small_enough
from fg_orient.adjustment.constraint_rows import ConstraintObservation
from fg_orient.adjustment.penalty import held_rows
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.constraint import Constraint
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role
from fg_orient.model.parameters import chosen_datum, with_options
from fg_orient.quality.cofactors import CommonCofactors, PointCofactors
from fg_orient.quality.free_network import without_priors

#: Movements with a smaller mu are held (see above): a y-parallax would move the image by more than 5 times
#: its own size.
SEEN: Final = 0.04
#: RMS movement of the image points, in their sigmas, that a held direction still allows.
HELD: Final = 1e-3
#: Eigenvalues of the scaled N below this share of the largest one belong to movements that move no image point.
MOVES: Final = 1e-10


@dataclass(frozen=True)
class HeldDatum(ExtraObservation):
    """Directions held at the metadata.

    Parameters
    ----------
    image : (w, h) array
        Movements of the unknowns of all images. An error of the metadata, distributed by the prior sigmas, is the sum
        of these columns with independent factors N(0, 1).
    ground : (N, 3, h) array
        The same movements of the ground points, m.
    sigma_enu_m : tuple of float
        Standard deviation of the position of the whole block caused by these movements, m.
    """

    image: Array = field(default_factory=lambda: np.zeros((0, 0)))
    ground: Array = field(default_factory=lambda: np.zeros((0, 3, 0)))
    sigma_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def finding(self) -> Finding:
        """Return a note on the directions."""
        east, north, up = self.sigma_enu_m
        return finding("solution.vendor_datum", n=self.n_residuals, east=east, north=north, up=up)


@dataclass(frozen=True)
class WithDatum(CommonCofactors):
    """Cofactors of a solution (``covariance.PointCofactors``) plus cofactors of its held directions (from priors)."""

    problem: Problem
    shape: PointCofactors
    held: HeldDatum

    def point(self, j: int) -> Array:
        """See ``PointCofactors``."""
        return np.asarray(self.shape.point(j) + self.held.ground[j] @ self.held.ground[j].T)

    def points(self, index: Index) -> Array:
        """See ``PointCofactors``."""
        moved = self.held.ground[index]
        return np.asarray(self.shape.points(index) + moved @ np.swapaxes(moved, 1, 2))

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See ``PointCofactors``."""
        parts = [self.held.image[self.problem.image_slice(k)] for k in images]
        moved = np.vstack([*parts, *(self.held.ground[j] for j in points if self.problem.active[j])])
        return np.asarray(self.shape.joint(images, points) + moved @ moved.T)


def with_datum(block: Block) -> Block:
    """Replace the datum "auto" of a block: by "vendor" if only the metadata determine its position, else by "control".

    Constraints between points do not determine the position; other extra observations may determine it.
    """
    control = bool(block.points.where(Role.CONTROL).size) or not all(
        isinstance(extra, ConstraintObservation | Constraint) for extra in block.extra
    )
    return with_options(block, "adjust", datum=chosen_datum(block.options, block.images, control=control))


def absolute(problem: Problem, cofactors: PointCofactors | None) -> PointCofactors | None:
    """Return the cofactors of positions on the Earth: they include the held directions with the prior sigmas."""
    held = of_problem(problem)
    return cofactors if held is None or cofactors is None else WithDatum(problem, cofactors, held)


def with_vendor_datum(problem: Problem) -> Problem:
    """Hold the directions of a problem that the rays hardly determine at the metadata.

    InputError: the block is too large for the matrix of all its image unknowns, or a point is not determined.
    """
    if not small_enough(problem):
        raise InputError.of("adjust.vendor_datum", option="datum", value="vendor", n=problem.n_free_unknowns)
    with one_blas_thread():
        try:
            border = Border(replace(problem, block=without_priors(problem.block)), problem.start)
        except Singular as error:
            raise InputError.of("adjust.vendor_datum_points", place=problem.block.name, why=error) from None
        n, z, named = _movement(problem), border.n_images, _named_that_follow(border)
        s = border.matrix[:z, :z] + border.matrix[:z, z:] @ named
        scale = 1.0 / np.sqrt(np.maximum(np.diag(n), np.finfo(float).tiny))
        size, axes = eigh(n * np.outer(scale, scale))
        basis = scale[:, None] * axes[:, size > MOVES * size[-1]] / np.sqrt(size[size > MOVES * size[-1]])
        share, turn = eigh(basis.T @ s @ basis)
        disagreement = border.squares() / (2.0 * len(problem.observations))
        moves = basis @ turn[:, share * max(1.0, disagreement) < SEEN]
        rows = moves.T @ n
        ground = border.follow(np.vstack([moves, named @ moves])).ground
    if not len(rows):
        return problem
    size, axes = np.linalg.eigh(rows @ rows.T)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    wide = moves if problem.ties is None else problem.ties.widened(moves)
    mean = problem.axes(problem.origin_m[None])[0] @ ground[problem.active].mean(axis=0) @ root
    east, north, up = np.linalg.norm(mean, axis=1).tolist()
    held = _observation(problem, rows / (HELD * np.sqrt(2.0 * len(problem.observations))))
    held = replace(held, image=wide @ root, ground=ground @ root, sigma_enu_m=(east, north, up))
    return replace(problem, block=replace(problem.block, extra=(*problem.block.extra, held)))


def of_problem(problem: Problem) -> HeldDatum | None:
    """Return the held directions of a problem; None if no direction is held."""
    return next((extra for extra in problem.block.extra if isinstance(extra, HeldDatum)), None)


def _movement(problem: Problem) -> Array:
    """Return N (z, z): whitened squares of the movements of the image points by the free image unknowns."""
    design, image = linearised(problem, problem.start).image, problem.observations.image
    out = np.zeros((problem.n_image_unknowns,) * 2)
    for k in range(problem.n_images):
        own, part = design[image == k], problem.image_slice(k)
        rows = own.reshape(-1, own.shape[2])[:, : part.stop - part.start]
        out[part, part] = rows.T @ rows
    ties = problem.ties
    return out if ties is None else np.asarray(ties.matrix.T @ (ties.matrix.T @ out).T)


def _named_that_follow(border: Border) -> Array:
    """Return the movements (3n, z) of the named points that best follow the movements of the images."""
    z, scale = border.n_images, border.scale[border.n_images :]
    inverse = np.linalg.pinv(border.matrix[z:, z:] * np.outer(scale, scale), hermitian=True)
    return np.asarray(-(scale[:, None] * inverse * scale) @ border.matrix[z:, :z])


def _observation(problem: Problem, rows: Array) -> HeldDatum:
    """Return an observation that the rows (h, z) of the free unknowns are zero."""
    equation, unknowns, setup = held_rows(problem, rows, "vendor_datum", "inner constraints on images, Koch 1999, 1.5")
    return HeldDatum(equation, unknowns, np.zeros(0), setup, len(rows), "directions held at the metadata")
