"""Cofactors of images and points, in prior scale, from the linearisation at the solution.

One source of cofactors per backend; only the Jacobians are common: the triangular factor of the full Jacobian (dense),
the inverse of the reduced camera system (Schur), GTSAM Marginals (graph). The last two give the cofactors of the
images; points follow by back-substitution (``fg_orient.adjustment.cofactors``). Unknowns are prior sigmas (images) and
metres (points); ``fg_orient.quality.joint`` converts them to physical units. Points located after the adjustment:
``fg_orient.adjustment.resection``.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fg_orient.adjustment.border import Border, small_enough
from fg_orient.adjustment.border_matrix import BorderMatrix
from fg_orient.adjustment.cofactors import (
    WHOLE_LIMIT,
    RayCofactors,
    ReducedCofactors,
    Star,
    SummedSystem,
    blocks_of_images,
    cofactors_of_points,
    cofactors_of_rays,
    full_statistics,
)
from fg_orient.adjustment.constraints import has_constraints
from fg_orient.adjustment.dense import DenseSystem
from fg_orient.adjustment.images_border import ImagesBorder
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.solve import Estimate
from fg_orient.adjustment.unknown_cofactors import DenseUnknowns, UnknownCofactors
from fg_orient.model.arrays import Array, Index
from fg_orient.quality.star_cofactors import StarCofactors

if TYPE_CHECKING:
    import gtsam

#: Condition of the column-scaled Jacobian beyond which the dense backend withholds the covariance: there the
#: relative rounding error of a cofactor, about eps cond, exceeds 1e-3. GTSAM's Cholesky fails much earlier on some
#: well-posed systems (a condition of 3e4 was seen); the standard deviations given here are then correct and large.
CONDITION_LIMIT = 1e12
#: Points named by extra observations beyond which one inverse replaces GTSAM's joint marginals of each point, and the
#: largest number of unknowns of this inverse: 32 MB.
MANY_POINTS = 32
INVERTED = 2000


class Indeterminate(Exception):
    """There is no covariance; the text gives the reason."""


class PointCofactors(Protocol):
    """Cofactors of points with those of the images, in prior scale; images in prior sigmas, points in m, ECEF axes."""

    def point(self, j: int) -> Array:
        """Cofactors (3, 3) of a ground point; zero for a fixed one."""
        ...

    def points(self, index: Index) -> Array:
        """Cofactors (n, 3, 3) of many ground points."""
        ...

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """Joint cofactors of images, then unknown points, in the given order."""
        ...

    def blocks(self, pairs: Index) -> Array:
        """Joint blocks (B, k, k) of pairs of images (B, 2), row <= column; shorter blocks end with zeros."""
        ...


class Cofactors(PointCofactors, Protocol):
    """Joint cofactors at the solution."""

    def image(self, k: int) -> Array:
        """Cofactors (u, u) of an image's unknowns."""
        ...

    def unknowns(self, places: Index) -> UnknownCofactors:
        """Joint cofactors of image unknowns by their places (d,) in ``Problem.image_columns``, ascending."""
        ...

    def star(self) -> Star | None:
        """Cofactors of images and points where images are eliminated first; None for others."""
        ...

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """Cofactors of the image points of a problem; without :meth:`star` not valid for named points."""
        ...


def cofactors_of(problem: Problem, estimate: Estimate) -> Cofactors:
    """Cofactors from the backend of the solution; Indeterminate if the normal equations are nearly singular."""
    from fg_orient.adjustment.schur import SchurSystem

    linear = estimate.linear
    if isinstance(linear, DenseSystem):
        return dense_cofactors(problem, linear.design)
    try:
        if isinstance(linear, BorderMatrix):
            with one_blas_thread():
                return of_border(problem, linear)
        if not isinstance(linear, SchurSystem | SummedSystem):
            return GraphCofactors(problem, estimate.state, linear.linear, linear.zero)
        with one_blas_thread():
            return ReducedCofactors(problem, linear)
    except RuntimeError as error:
        reduced = isinstance(linear, SchurSystem | SummedSystem | BorderMatrix)
        if not reduced and has_constraints(problem.block) and small_enough(problem):
            with one_blas_thread(), contextlib.suppress(Singular):  # its scaled Cholesky factor exists more often
                return BorderCofactors(problem, Border(problem, estimate.state))
        raise Indeterminate(str(error) if reduced else "GTSAM finds the normal equations indeterminate") from error


def gives_statistics(problem: Problem, cofactors: Cofactors) -> bool:
    """Whether a run gives statistics of every observation; without a matrix of all images their number is no limit."""
    unknowns = problem.n_image_unknowns if cofactors.star() is None else 0
    return full_statistics(problem.block.options, len(problem.observations), unknowns)


def of_border(problem: Problem, border: BorderMatrix) -> BorderCofactors | StarCofactors:
    """Cofactors from a border; RuntimeError if the normal equations are too close to singular."""
    if isinstance(border, ImagesBorder):
        return StarCofactors(problem, border)
    assert isinstance(border, Border)
    return BorderCofactors(problem, border)


@dataclass(frozen=True, eq=False)
class MatrixCofactors:
    """Cofactors of all unknowns as one matrix.

    Parameters
    ----------
    problem : Problem
    cofactors : (n, n) array
        In prior scale, columns as in ``Problem.vector``.
    """

    problem: Problem
    cofactors: Array

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((k,), ())

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((), (j,)) if self.problem.active[j] else np.zeros((3, 3))

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        return np.array([self.point(j) for j in index.tolist()]).reshape(-1, 3, 3)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        parts = [self.problem.image_slice(k) for k in images]
        parts += [self.problem.point_slice(j) for j in points if self.problem.active[j]]
        index = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        return np.asarray(self.cofactors[np.ix_(index, index)])

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        return blocks_of_images(self.problem, lambda images: self.joint(images, ()), pairs)

    def unknowns(self, places: Index) -> DenseUnknowns:
        """See :class:`Cofactors`."""
        return DenseUnknowns(self.cofactors[np.ix_(places, places)])

    def star(self) -> None:
        """See :class:`Cofactors`."""

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See :class:`Cofactors`."""
        return cofactors_of_rays(problem, state, self.blocks)

    def times(self, columns: Array) -> Array:
        """Cofactors times columns (n, d)."""
        return np.asarray(self.cofactors @ columns)


class BorderCofactors:
    """Cofactors from the inverse of the border; see :class:`Cofactors`.

    Parameters
    ----------
    problem : Problem
    border : Border
        At the solution.

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, border: Border) -> None:
        self.problem, self.border, self._q = problem, border, border.inverse
        self._columns = [border.free_columns[problem.image_slice(k)] for k in range(problem.n_images)]

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        return np.asarray(self._q[np.ix_(self._columns[k], self._columns[k])])

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return np.asarray(self.points(np.array([j]))[0])

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        border = self.border
        out = cofactors_of_points(border.eliminated, border.state, index, self.blocks)
        for place in np.flatnonzero(np.isin(index, border.named)).tolist():
            at = border.columns_of(int(index[place]))
            out[place] = self._q[np.ix_(at, at)]
        return out

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        widest = max(len(columns) for columns in self._columns)
        place = np.full((len(self._columns), widest), len(self._q))
        for row, columns in zip(place, self._columns, strict=True):
            row[: len(columns)] = columns
        padded = np.pad(self._q, (0, 1))
        return np.asarray(padded[place[pairs[:, 0]][:, :, None], place[pairs[:, 1]][:, None, :]])

    def unknowns(self, places: Index) -> DenseUnknowns:
        """See :class:`Cofactors`."""
        at = self.border.free_columns[places]
        return DenseUnknowns(self._q[np.ix_(at, at)])

    def star(self) -> None:
        """See :class:`Cofactors`."""

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See :class:`Cofactors`."""
        return cofactors_of_rays(problem, state, self.blocks)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        border, unknown = self.border, [j for j in points if self.problem.active[j]]
        at = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in images)])
        if not unknown:
            return np.asarray(self._q[np.ix_(at, at)])
        if np.isin(unknown, border.named).all():
            at = np.concatenate([at, *(border.columns_of(j) for j in unknown)])
            return np.asarray(self._q[np.ix_(at, at)])
        n = len(at)
        effect, own = np.zeros((n + 3 * len(unknown), len(self._q))), np.zeros((n + 3 * len(unknown),) * 2)
        effect[np.arange(n), at] = 1.0
        gain, inverse = border.gains(np.array(unknown))
        effect[n:] = gain.reshape(-1, len(self._q))
        for a, (j, block) in enumerate(zip(unknown, inverse, strict=True)):
            for b in np.flatnonzero(np.equal(unknown, j)):
                own[n + 3 * a : n + 3 * a + 3, n + 3 * b : n + 3 * b + 3] = block
        out = effect @ self._q @ effect.T + own
        return np.asarray(0.5 * (out + out.T))

    def times(self, columns: Array) -> Array:
        """Cofactors times columns (n, d), as in ``Problem.vector``."""
        problem, d = self.problem, columns.shape[1]
        w, z = problem.n_image_unknowns, problem.n_free_unknowns
        right = np.zeros((len(self._q), d))
        np.add.at(right[:z], np.concatenate(self._columns), columns[:w])
        ground = np.zeros((len(problem.active), 3, d))
        ground[problem.active] = columns[w:].reshape(-1, 3, d)
        image, ground = self.border.times(right, ground)
        return np.vstack([image[np.concatenate(self._columns)], ground[problem.active].reshape(-1, d)])


def dense_cofactors(problem: Problem, design: Array) -> MatrixCofactors:
    """Cofactors ``D R^-1 R^-T D`` of the full Jacobian ``J = Q R D^-1``, columns scaled to length 1 by D.

    N is not formed, so the error grows with cond(J), not with its square.

    Parameters
    ----------
    problem : Problem
    design : (n, u) array
        Whitened Jacobian at the solution, columns as in ``Problem.vector``.

    Raises
    ------
    Indeterminate
        The condition of the scaled Jacobian, estimated by LAPACK from R, is beyond 1e12.
    """
    from scipy.linalg import lapack, qr, solve_triangular

    length = np.linalg.norm(design, axis=0)
    if not length.all() or len(design) < design.shape[1]:
        raise Indeterminate("some unknowns are in no observation")
    r = qr(design / length, mode="r", check_finite=False)[0][: len(length)]
    reciprocal, _ = lapack.dtrcon(r)
    if reciprocal * CONDITION_LIMIT < 1.0:
        raise Indeterminate(f"the condition of the scaled Jacobian is above {CONDITION_LIMIT:.0e}")
    half = solve_triangular(r, np.eye(len(r)), check_finite=False) / length[:, None]
    if problem.ties is not None:
        half = problem.ties.widened(half)
    return MatrixCofactors(problem, half @ half.T)


class GraphCofactors(ReducedCofactors):
    """Joint marginal cofactors of the linearised graph at the solution.

    GTSAM Marginals give the cofactors of the images; points follow by back-substitution. If extra observations name
    ground points, GTSAM gives the cofactors of the points, too.

    Parameters
    ----------
    problem : Problem
    state : State
        The solution.
    linear : gtsam.GaussianFactorGraph
        Linearised there, undamped.
    zero : gtsam.VectorValues
        Any values of the unknowns, which GTSAM requires.

    Raises
    ------
    RuntimeError
        GTSAM finds the system indeterminate.
    """

    def __init__(
        self, problem: Problem, state: State, linear: gtsam.GaussianFactorGraph, zero: gtsam.VectorValues
    ) -> None:
        import gtsam

        named = len(problem.named_points())
        self._marginals, self._named, self._linear = gtsam.Marginals(linear, zero), bool(named), linear
        self._inverts = named > MANY_POINTS and problem.n_unknowns <= INVERTED
        super().__init__(problem, SummedSystem(state, lambda damping: self))
        if problem.first[-1] <= WHOLE_LIMIT:
            # GTSAM finds some systems indeterminate only in the joint elimination of all images, not in that of one
            self._of(tuple(range(problem.n_images)))

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        if not self._named:
            return super().points(index)
        return np.array([self.point(j) for j in index.tolist()]).reshape(-1, 3, 3)

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        marginal = self._named and self._problem.active[j]
        return self.covariance((), (j,)) if marginal else super().point(j)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        return self.covariance(images, points) if self._named and points else super().joint(images, points)

    @cached_property
    def _inverse(self) -> Array:
        """Cofactors of all free unknowns of the images, then of all unknown points."""
        import gtsam
        from scipy.linalg import cho_factor, cho_solve

        from fg_orient.adjustment.explicit import point_key, vector_keys

        order = gtsam.Ordering()
        points = np.flatnonzero(self._problem.active).tolist()
        known = [*(key for key, _ in vector_keys(self._problem)), *map(point_key, points)]
        for key in (*known, *sorted({*self._linear.keys()} - {*known})):  # others are those of figures
            order.push_back(key)
        normal = np.asarray(self._linear.hessian(order)[0])
        length = np.sqrt(np.diag(normal))
        inverse = cho_solve(cho_factor(normal / np.outer(length, length)), np.eye(len(length)))
        return np.asarray(inverse / np.outer(length, length))

    def covariance(self, images: tuple[int, ...], points: tuple[int, ...] = ()) -> Array:
        """Joint cofactors of images, then unknown points: by GTSAM, or one inverse if many points are named."""
        from fg_orient.adjustment.explicit import point_key, vector_keys

        problem = self._problem
        free = np.arange(problem.n_image_unknowns) if problem.ties is None else problem.ties.of
        wanted = np.concatenate([free[:0], *(free[problem.first[k] : problem.first[k + 1]] for k in images)])
        if self._inverts:
            columns = problem.point_columns[[j for j in points if problem.active[j]], None] + np.arange(3)
            at = np.concatenate([wanted, (columns - problem.n_image_unknowns + problem.n_free_unknowns).ravel()])
            return np.asarray(self._inverse[np.ix_(at, at)])
        keys, place, n = list[int](), np.full(problem.n_free_unknowns, -1), 0
        for key, part in vector_keys(problem):
            if ((wanted >= part.start) & (wanted < part.stop)).any():
                keys.append(key)
                place[part] = n + np.arange(part.stop - part.start)
                n += part.stop - part.start
        ground = [point_key(j) for j in points if problem.active[j]]
        keys, at = keys + ground, np.concatenate([place[wanted], n + np.arange(3 * len(ground))]).astype(np.intp)
        if len(keys) == 1:
            q = np.asarray(self._marginals.marginalCovariance(keys[0]))
        else:
            blocks = self._marginals.jointMarginalCovariance(keys)
            q = np.block([[np.asarray(blocks.at(a, b)) for b in keys] for a in keys])
        return np.asarray(q[np.ix_(at, at)])
