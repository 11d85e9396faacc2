"""Cofactors of images and points, in prior scale, from the linearisation at the solution.

Computations that share nothing but the Jacobians: GTSAM Marginals with back-substitution for the
points (graph backend), the triangular factor of the full Jacobian (dense backend), the inverse of the reduced camera
system (``fg_orient.adjustment.cofactors``). Unknowns are
prior sigmas (images) and metres (points); ``fg_orient.quality.joint`` turns them into physical units.
Points located after the adjustment: ``fg_orient.adjustment.resection``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.solve import Estimate

if TYPE_CHECKING:
    import gtsam
    import pandas

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


#: Above this many image unknowns their joint cofactors are not formed at once; points are asked one by one.
JOINT_LIMIT = 3000
#: Condition of the column-scaled Jacobian beyond which the dense backend withholds the covariance: there the
#: relative rounding error of a cofactor, some eps cond, passes 1e-3. GTSAM's Cholesky gives up much earlier on
#: some well-posed systems (a condition of 3e4 was seen); the sigmas given here are then right and large.
CONDITION_LIMIT = 1e12


class Indeterminate(Exception):
    """There is no covariance; the text says why."""


class Cofactors(Protocol):
    """Joint cofactors at the solution, in prior scale; images in prior sigmas, points in m, ECEF axes."""

    def image(self, k: int) -> Array:
        """Cofactors (u, u) of an image's unknowns."""
        ...

    def point(self, j: int) -> Array:
        """Cofactors (3, 3) of a ground point; zero for a fixed one."""
        ...

    def points(self, index: Index) -> Array:
        """Cofactors (n, 3, 3) of many ground points."""
        ...

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """Joint cofactors of images, then unknown points, in the order given."""
        ...


def cofactors_of(problem: Problem, estimate: Estimate) -> Cofactors:
    """Cofactors by the means of the backend that solved.

    Raises
    ------
    Indeterminate
        The normal equations are too close to singular.
    """
    from fg_orient.adjustment.dense import DenseSystem

    if isinstance(estimate.linear, DenseSystem):
        return DenseCofactors(problem, estimate.linear.design)
    from fg_orient.adjustment.cofactors import ReducedCofactors, SummedSystem
    from fg_orient.adjustment.schur import SchurSystem

    if isinstance(estimate.linear, SchurSystem | SummedSystem):
        try:
            with one_blas_thread():
                return ReducedCofactors(problem, estimate.linear)
        except RuntimeError as error:
            raise Indeterminate(str(error)) from error
    try:
        return GraphCofactors(problem, estimate.state, estimate.linear.linear, estimate.linear.zero)
    except RuntimeError as error:
        raise Indeterminate("GTSAM finds the normal equations indeterminate") from error


class MatrixCofactors:
    """Cofactors (n, n) of all unknowns as one matrix, columns as in ``Problem.vector``."""

    def __init__(self, problem: Problem, q: Array) -> None:
        self._problem, self._q = problem, q

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((k,), ())

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((), (j,)) if self._problem.active[j] else np.zeros((3, 3))

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        return np.array([self.point(j) for j in index.tolist()]).reshape(-1, 3, 3)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        parts = [self._problem.image_slice(k) for k in images]
        parts += [self._problem.point_slice(j) for j in points if self._problem.active[j]]
        index = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        return np.asarray(self._q[np.ix_(index, index)])


class DenseCofactors(MatrixCofactors):
    """Cofactors ``D R^-1 R^-T D`` of the full Jacobian ``J = Q R D^-1``, columns scaled to length 1 by D.

    N is never formed, so the error grows with cond(J), not with its square.

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

    def __init__(self, problem: Problem, design: Array) -> None:
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
        super().__init__(problem, half @ half.T)


class GraphCofactors:
    """Joint marginal cofactors of the linearised graph at the solution.

    Images come from GTSAM Marginals. Points follow from the images they are seen in,
    ``Q = N^-1 + G Q_ee G^T`` with ``N = A^T A + W^T W``, ``G = N^-1 A^T B`` (A, B the whitened Jacobians with
    respect to point and images): the back-substitution of the elimination, 30 us per point.

    Parameters
    ----------
    problem : Problem
    state : State
        The solution.
    linear : gtsam.GaussianFactorGraph
        Linearised there, undamped.
    zero : gtsam.VectorValues
        Any values of the unknowns (GTSAM asks for them).

    Raises
    ------
    RuntimeError
        GTSAM finds the system indeterminate.
    """

    def __init__(
        self, problem: Problem, state: State, linear: gtsam.GaussianFactorGraph, zero: gtsam.VectorValues
    ) -> None:
        import gtsam

        self._problem, self._state = problem, state
        self._marginals = gtsam.Marginals(linear, zero)
        self._all: Array | None = None
        if problem.n_image_unknowns <= JOINT_LIMIT and not problem.block.extra:
            self._all = self.joint(tuple(range(problem.n_images)), ())
        self._images: dict[int, Array] = {}
        self.image(0)  # GTSAM finds an indeterminate system when first asked, not when made
        self._points: dict[int, Array] = {}
        self._gains: dict[int, tuple[Array, npt.NDArray[np.intp]]] = {}

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        from fg_orient.adjustment.graph import image_key

        if k not in self._images and self._problem.ties is not None:
            self._images[k] = self.joint((k,), ())
        elif k not in self._images:
            part = slice(self._problem.first[k], self._problem.first[k + 1])
            found = self._marginals.marginalCovariance(image_key(k)) if self._all is None else self._all[part, part]
            self._images[k] = np.asarray(found)
        return self._images[k]

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        from fg_orient.adjustment.graph import point_key

        if not self._problem.active[j]:
            return np.zeros((3, 3))
        if self._all is not None and not self._points:
            self._points = self._substituted(self._all)
        if j not in self._points:
            self._points[j] = np.asarray(self._marginals.marginalCovariance(point_key(j)))
        return self._points[j]

    def _substituted(self, q_images: Array) -> dict[int, Array]:
        """Cofactors of all unknown points from those of all images; G and its columns are kept."""
        problem, first = self._problem, self._problem.first
        _, d_image, d_ground = linearised(problem, self._state)
        out = {}
        for j, rows in problem.rows_by_point():
            if not problem.active[j]:
                continue
            a = d_ground[rows].reshape(-1, 3)
            n = a.T @ a
            if problem.observed[j]:
                w = problem.control_weights(j)
                n += w.T @ w
            inverse = np.linalg.inv(n)
            images = problem.observations.image[rows].tolist()
            columns = np.concatenate([np.arange(first[k], first[k + 1]) for k in images])
            sizes = [len(problem.parameters[k]) for k in images]
            g = inverse @ np.hstack([d_ground[r].T @ d_image[r, :, :m] for r, m in zip(rows, sizes, strict=True)])
            out[j] = inverse + g @ q_images[np.ix_(columns, columns)] @ g.T
            self._gains[j] = g, columns
        return out

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        return np.array([self.point(j) for j in index.tolist()]).reshape(-1, 3, 3)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`; one point with its images follows from those of all images, if these are known."""
        from fg_orient.adjustment.graph import image_key, point_key

        if self._all is not None and len(points) <= 1:
            return self._with_point(self._all, images, points)
        keys = [image_key(k) for k in images] + [point_key(j) for j in points if self._problem.active[j]]
        if self._problem.ties is not None:
            return self._tied(images, keys[len(images) :])
        return self._marginal(keys)

    def _marginal(self, keys: list[int]) -> Array:
        if len(keys) == 1:
            return np.asarray(self._marginals.marginalCovariance(keys[0]))
        found = self._marginals.jointMarginalCovariance(keys)
        return np.block([[np.asarray(found.at(a, b)) for b in keys] for a in keys])

    def _tied(self, images: tuple[int, ...], points: list[int]) -> Array:
        """Joint cofactors of images that have unknowns in common, and of the points of these keys."""
        from fg_orient.adjustment.graph import vector_keys

        problem, ties = self._problem, self._problem.ties
        assert ties is not None
        wide = [ties.of[problem.first[k] : problem.first[k + 1]] for k in images]
        needed = np.concatenate([np.zeros(0, np.intp), *wide])
        keys, place, n = [], np.full(len(ties), -1), 0
        for key, part in vector_keys(problem):
            if ((needed >= part.start) & (needed < part.stop)).any():
                keys.append(key)
                place[part] = n + np.arange(part.stop - part.start)
                n += part.stop - part.start
        at = np.concatenate([place[needed], n + np.arange(3 * len(points))]).astype(np.intp)
        return self._marginal(keys + points)[np.ix_(at, at)]

    def _with_point(self, q_images: Array, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """Joint cofactors of images and at most one point, by back-substitution."""
        first = self._problem.first
        index = np.concatenate([np.arange(first[k], first[k + 1]) for k in images] or [np.zeros(0, np.intp)])
        q = np.asarray(q_images[np.ix_(index, index)])
        if not points or not self._problem.active[points[0]]:
            return q
        own = self.point(points[0])
        g, columns = self._gains[points[0]]
        cross = -g @ q_images[np.ix_(columns, index)]
        return np.block([[q, cross.T], [cross, own]])


@dataclass(frozen=True, repr=False)
class NamedMatrix:
    """A symmetric matrix with the names and units of its rows."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array

    def __repr__(self) -> str:
        names = ", ".join(self.names)
        return f"<NamedMatrix {self.values.shape}: {names if len(names) < 200 else names[:200] + ' ...'}>"

    def to_frame(self) -> pandas.DataFrame:
        """Give the values as ``pandas.DataFrame`` (extra "tables"); rows and columns have the names."""
        import pandas

        return pandas.DataFrame(self.values, list(self.names), list(self.names))

    @property
    def correlations(self) -> Array:
        """Correlations ``q_ij / sqrt(q_ii q_jj)``, T(2.75), in -1 to 1 whatever rounding says; nan without variance."""
        sigma = np.sqrt(np.diag(self.values))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.clip(self.values / np.outer(sigma, sigma), -1.0, 1.0))
