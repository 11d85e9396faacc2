"""Cofactors of images and points, in prior scale, from the linearisation at the solution.

Each backend has its own source of cofactors: the triangular factor of the full Jacobian (dense), the inverse
of the reduced system of the images (Schur), or GTSAM Marginals (graph). Only the Jacobians are common. The
last two give the cofactors of the images; points follow by back-substitution
(``fg_orient.adjustment.cofactors``). Unknowns are prior sigmas (images) and metres (points). For points that
are located after the adjustment see ``fg_orient.adjustment.resection``.

:func:`joint_cofactors` gives them by name, in physical units: images, single parameters, points, adjusted observations,
residuals. All quantities are linear in the unknowns x. With whitened rows A, observations l of unit weight and
``Q = N^-1``::

    Q_xx = Q,   Q_x,lbar = Q A^T,   Q_lbar = A Q A^T,   Q_vv = I - A Q A^T,   Q_xv = 0,   Q_lbar,v = 0

(Mikhail & Ackermann 1976, 4.5; T(2.76) and T(2.77) in the corrected form with B = -I). ``Q_x,lbar`` is the
joint cofactor of an unknown and an adjusted observation, so it does not depend on the sign convention of the
conditions.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.border import Border, small_enough
from fg_orient.adjustment.border_matrix import BorderMatrix
from fg_orient.adjustment.cofactors import (
    WHOLE_LIMIT,
    blocks_of_images,
    full_statistics,
)
from fg_orient.adjustment.constraints import has_constraints
from fg_orient.adjustment.dense import DenseSystem
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_cofactors import ReducedCofactors, SummedSystem
from fg_orient.adjustment.rows import image_rows
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.errors import InputError
from fg_orient.quality.cofactors import BorderCofactors, Cofactors, MatrixCofactors, of_border

if TYPE_CHECKING:
    import gtsam
    import pandas

#: The dense backend gives no covariance if the condition number of the column-scaled Jacobian exceeds this.
#: The relative rounding error of a cofactor, about eps cond, is then above 1e-3. GTSAM's Cholesky
#: factorisation fails much earlier for some well-posed systems (for example at a condition number of 3e4).
#: For these systems the dense backend gives correct, large standard deviations.
CONDITION_LIMIT = 1e12
#: If extra observations name more points than the first number, one inverse of all unknowns replaces GTSAM's
#: joint marginals of each point. The second number is the largest size of this inverse (32 MB).
MANY_POINTS = 32
INVERTED = 2000


class Indeterminate(Exception):
    """Error: there is no covariance; the text gives the reason."""


def cofactors_of(problem: Problem, estimate: Estimate) -> Cofactors:
    """Compute cofactors from the backend of the solution; Indeterminate if the normal equations are nearly singular."""
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
            # for some systems only the Cholesky factor of scaled columns exists, but not GTSAM's factor
            with one_blas_thread(), contextlib.suppress(Singular):
                return BorderCofactors(problem, Border(problem, estimate.state))
        raise Indeterminate(str(error) if reduced else "GTSAM finds the normal equations indeterminate") from error


def gives_statistics(problem: Problem, cofactors: Cofactors) -> bool:
    """Return whether a run computes statistics of every observation."""
    no_limit = cofactors.star() is not None or (isinstance(cofactors, ReducedCofactors) and cofactors.selects)
    unknowns = 0 if no_limit else problem.n_image_unknowns
    return full_statistics(problem.block.options, len(problem.observations), unknowns)


def dense_cofactors(problem: Problem, design: Array) -> MatrixCofactors:
    """Compute cofactors ``D R^-1 R^-T D`` of the full Jacobian ``J = Q R D^-1``, columns scaled to length 1 by D.

    The normal matrix N is not formed, so the error is proportional to cond(J) and not to its square.

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
        Linearised graph at the solution, undamped.
    zero : gtsam.VectorValues
        Values of all unknowns, of any size, which GTSAM requires.

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
            # GTSAM finds some systems indeterminate only in the joint elimination of all images, not of a single image
            self._of(tuple(range(problem.n_images)))

    @property
    def selects(self) -> bool:
        """See :class:`ReducedCofactors`; False because GTSAM needs an elimination for each pair of images."""
        return False

    def selected(self, pairs: Index) -> Array:
        """See ``ImageCofactors``."""
        return blocks_of_images(self._problem, self.covariance, pairs)

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
        for key in (*known, *sorted({*self._linear.keys()} - {*known})):  # other keys belong to figures
            order.push_back(key)
        normal = np.asarray(self._linear.hessian(order)[0])
        length = np.sqrt(np.diag(normal))
        inverse = cho_solve(cho_factor(normal / np.outer(length, length)), np.eye(len(length)))
        return np.asarray(inverse / np.outer(length, length))

    def covariance(self, images: tuple[int, ...], points: tuple[int, ...] = ()) -> Array:
        """Return joint cofactors of images, then points: by GTSAM, or by one inverse if many points are named."""
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
        """Return the values as ``pandas.DataFrame`` (extra "tables"), with the names as index and columns."""
        import pandas

        return pandas.DataFrame(self.values, list(self.names), list(self.names))

    @property
    def correlations(self) -> Array:
        """Correlations ``q_ij / sqrt(q_ii q_jj)``, T(2.75), clipped to -1 to 1; nan without variance."""
        sigma = np.sqrt(np.diag(self.values))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.clip(self.values / np.outer(sigma, sigma), -1.0, 1.0))


class _Rows(NamedTuple):
    """Rows that one name selects in a joint covariance: names, units, derivatives by ("image", k) and ("point", j).

    ``residual``: row of ``problem.observations`` to which these residuals belong; -1 for other quantities.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    blocks: dict[tuple[str, int], Array]
    residual: int = -1


def joint_cofactors(problem: Problem, state: State, cofactors: Cofactors, names: tuple[str, ...]) -> NamedMatrix:
    """Compute joint cofactors (prior scale) in physical units.

    Parameters
    ----------
    problem : Problem
        Problem to which the cofactors belong.
    state : State
    cofactors : Cofactors
    names : tuple of str
        "image:left" (all parameters), "image:left.x_0", "point:12", "point:12.z", "observation:left/12" (adjusted line
        and sample, px), "residual:left/12" (adjusted minus observed, px). Empty: all images.

    Raises
    ------
    InputError
        InputError :: A name does not exist, or a point is not an unknown.
    """
    names = names or tuple(f"image:{image.id}" for image in problem.block.images)
    parts = [rows for name in names for rows in _find(problem, state, name)]
    places = sorted(dict.fromkeys(place for part in parts for place in part.blocks), key=itemgetter(0))
    images, points = (tuple(k for kind, k in places if kind == wanted) for wanted in ("image", "point"))
    sizes = [len(problem.parameters[k]) if kind == "image" else 3 for kind, k in places]
    design = np.block([
        [part.blocks.get(place, np.zeros((len(part.names), size))) for place, size in zip(places, sizes, strict=True)]
        for part in parts
    ])  # fmt: skip
    q = design @ cofactors.joint(images, points) @ design.T
    labels = tuple(name for part in parts for name in part.names)
    units = tuple(unit for part in parts for unit in part.units)
    coordinate = np.array([2 * part.residual + c for part in parts for c in range(len(part.names))], np.intp)
    is_residual = np.array([part.residual >= 0 for part in parts for _ in part.names], bool)
    return NamedMatrix(labels, units, _with_residuals(problem, 0.5 * (q + q.T), is_residual, coordinate))


def _with_residuals(problem: Problem, q: Array, is_residual: Mask, coordinate: Index) -> Array:
    """Convert rows that were formed as adjusted observations to residuals of these image coordinates."""
    o = problem.observations
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1).ravel()
    out = np.where(is_residual[:, None] == is_residual, q, 0.0)
    where = np.flatnonzero(is_residual)
    own = coordinate[where]
    out[np.ix_(where, where)] = np.where(own[:, None] == own, sigma[own] ** 2, 0.0) - out[np.ix_(where, where)]
    return out


def _find(problem: Problem, state: State, name: str) -> list[_Rows]:
    """Find the rows of a name; it raises the same errors as :func:`joint_cofactors`."""
    kind, _, rest = name.partition(":")
    if kind in ("observation", "residual"):
        rows = [_of_observation(problem, state, int(row), kind) for row in _image_points(problem, rest)]
    else:
        rows = [_of_unknown(problem, name)]
    if not rows:
        raise InputError.of("covariance.no_such", place="covariance", value=name)
    return rows


def _of_unknown(problem: Problem, name: str) -> _Rows:
    """Return the rows of an image, of a point, or of one of its unknowns."""
    block = problem.block
    place, only = block.find(name), ""
    if place is None:
        stem, _, only = name.rpartition(".")
        place = block.find(stem)
    kind, k = place or ("", 0)
    if kind == "image":
        p = problem.parameters[k]
        names, units, scale = p.names, p.units, p.sigma
    else:
        names, units, scale = ("x", "y", "z"), ("m",) * 3, np.ones(3)
    if not kind or (only and only not in names):
        raise InputError.of("covariance.no_such", place="covariance", value=name)
    if kind == "point" and not problem.active[k]:
        raise InputError.of("covariance.not_unknown", place="covariance", value=block.points.ids[k])
    chosen = [names.index(only)] if only else list(range(len(names)))
    identifier = block.images[k].id if kind == "image" else block.points.ids[k]
    labels, own = tuple(f"{identifier}.{names[c]}" for c in chosen), tuple(units[c] for c in chosen)
    return _Rows(labels, own, {(kind, k): np.diag(scale)[chosen]})


def _image_points(problem: Problem, rest: str) -> Index:
    """Return the rows of the image points of a point in an image, named "image/point"."""
    o, ids = problem.observations, problem.block.points.ids
    for k, image in enumerate(problem.block.images):
        point = rest.removeprefix(f"{image.id}/")
        if point != rest and point in ids:
            return np.flatnonzero((o.image == k) & (o.point == ids.index(point)))
    return np.zeros(0, np.intp)


def _of_observation(problem: Problem, state: State, row: int, kind: str) -> _Rows:
    """Return the adjusted line and sample of an image point in pixels, or their residuals."""
    o, block = problem.observations, problem.block
    k, j = int(o.image[row]), int(o.point[row])
    _, d_image, d_ground = image_rows(problem, state, k, np.array([row]), jacobian=True)
    sigma = np.array([[o.sigma_line_px[row]], [o.sigma_sample_px[row]]])
    where = f"{block.images[k].id}/{block.points.ids[j]}"
    prefix = "v_" if kind == "residual" else ""
    blocks = {("image", k): sigma * d_image[0]} | ({("point", j): sigma * d_ground[0]} if problem.active[j] else {})
    names = (f"{where}.{prefix}line", f"{where}.{prefix}sample")
    return _Rows(names, ("px", "px"), blocks, row if kind == "residual" else -1)
