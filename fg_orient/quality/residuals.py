"""Residuals of a solution with their cofactors: input of reliability, outlier tests and variance components.

Cofactors of the residuals are ``Q_vv = I - A N^-1 A^T``; the traces are redundancy numbers, and their sum is the
redundancy (Baarda 1968). Residuals are whitened (divided by their a priori sigmas), adjusted minus observed. The
cofactors are formed point by point from the cofactors of the images (``fg_orient.adjustment.cofactors``). For ground
points named by extra observations they are formed from joint cofactors.

Order of all rows: image points (line, sample), weighted control points ``np.flatnonzero(problem.observed)`` (East,
North, Up; X, Y, Z in a local system), priors, extra observations.

Contributions of groups of observations are computed point by point; no matrix of all rows is formed. The ground points
are eliminated (``fg_orient.quality.elimination``): F and A are the projection and the Jacobian to the unknowns of the
images without the point. With the cofactors Q of these unknowns, the cofactors of the residuals of points p and q are

    R_pq = delta_pq F_p - A_p Q A_q^T

so R consists of one block per point and a matrix of low rank. E_j selects the rows of group j::

    M_j = sum_p A_p^T E_j A_p                     normal equations of the images from group j
    W_j = Q M_j Q,  sum_j W_j = Q                 contribution of group j to Q
    (R E_j R)_pp = F E_j F - F E_j H - H E_j F + A_p W_j A_p^T,   H = A_p Q A_p^T
    S_ij = tr(E_i R E_j R) = tr(Q M_i Q M_j) + sum_p sum_(k in i, l in j) (F_kl^2 - 2 F_kl H_kl)

These formulas are exact. Priors and extra observations are rows without a point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import CHUNK, RayCofactors, inverse_roots
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, linearised, residuals
from fg_orient.model.block import ExtraObservation
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.elimination import (
    PointRows,
    control_residuals,
    control_rows,
    eliminated_points,
    extra_rows,
    free_cofactors,
    single_rows,
)
from fg_orient.quality.hypotheses import CHECKED

#: Maximum number of elements of the matrices W_j of all groups, 0.5 GB each kind; for example 4 groups and 4000
#: unknowns.
LARGEST: Final = 2**26
#: The rows of a point are a full matrix if all unknowns are at most this many times the unknowns of the point.
FULL: Final = 8


def parts_of_rows(n: int) -> list[slice]:
    """Divide n rows into slices, at least one, so that temporary arrays of a slice fit into the cache."""
    return [slice(k, k + CHUNK) for k in range(0, max(n, 1), CHUNK)]


def by_parts(n: int, some: Callable[[slice], Sequence[npt.NDArray[Any]]]) -> list[npt.NDArray[Any]]:
    """Compute arrays of n rows slice by slice; ``some`` computes a slice."""
    out = list[npt.NDArray[Any]]()
    for k in parts_of_rows(n):
        found = some(k)
        out = out or [np.empty((n, *part.shape[1:]), part.dtype) for part in found]
        for whole, part in zip(out, found, strict=True):
            whole[k] = part
    return out


@dataclass(frozen=True, eq=False)
class ResidualCofactors:
    """Whitened residuals of a solution and their cofactors in prior scale; each is computed at first use.

    Parameters
    ----------
    problem : Problem
        Problem; under a loss with the weights at the solution (``fg_orient.adjustment.robust.weighted_problem``).
    state : State
        The solution.
    cofactors : Cofactors
        Cofactors of any backend.
    """

    problem: Problem
    state: State
    cofactors: Cofactors

    def compute(self) -> None:
        """Compute residuals and cofactors of the image points now. Their records can then be freed."""
        _ = self.v_image, self.rays

    @cached_property
    def v_image(self) -> Array:
        """Residuals (n, 2) of the image points, in the order of ``problem.observations``."""
        return residuals(self.problem, self.state)

    @cached_property
    def v_control(self) -> Array:
        """Residuals (m, 3) of the control points."""
        return control_residuals(self.problem, self.state)

    @cached_property
    def v_prior(self) -> Array:
        """Residuals (u,) of the priors, in the order of ``problem.image_vector``; empty without priors."""
        return self.problem.image_vector(self.state) if self.problem.block.options.priors else np.zeros(0)

    @cached_property
    def control_rows(self) -> Array:
        """Derivatives (m, 3, 3) of the residuals of control points with respect to the point, per metre."""
        return control_rows(self.problem, np.flatnonzero(self.problem.observed))

    @property
    def image(self) -> Array:
        """Cofactors (n, 2, 2) of the residuals of each image point."""
        return self.rays.residual

    @property
    def control(self) -> Array:
        """Cofactors (m, 3, 3) of the residuals of each control point."""
        w, points = self.control_rows, self.rays.points[self.problem.observed]
        return np.asarray(np.eye(3) - w @ points @ np.swapaxes(w, 1, 2))

    @property
    def prior(self) -> Array:
        """Redundancy numbers (u,) of the priors, shared unknowns once; empty without priors."""
        problem = self.problem
        if not problem.block.options.priors:
            return np.zeros(0)
        sizes = np.diff(problem.first).tolist()
        wide = np.concatenate([np.diag(q)[:size] for q, size in zip(self.rays.images, sizes, strict=True)])
        return np.asarray(1.0 - problem.free(wide))

    @cached_property
    def extra(self) -> tuple[Array, ...]:
        """Redundancy numbers (m_e,) of the rows of each extra observation."""
        return tuple(self._of_extra(extra) for extra in self.problem.block.extra)

    @property
    def redundancy_sum(self) -> float:
        """Sum of all redundancy numbers: ``problem.redundancy``, plus the redundancy numbers of a penalty's rows."""
        blocks = sum(float(np.einsum("nii->", block)) for block in (self.image, self.control))
        return blocks + sum(float(np.sum(numbers)) for numbers in (self.prior, *self.extra))

    @cached_property
    def rays(self) -> RayCofactors:
        """Cofactors of adjusted image points, points and images."""
        rays, named = self.cofactors.rays(self.problem, self.state), self.problem.named_points()
        if named and self.cofactors.star() is None:
            self._correct_named_points(rays, named)
        return rays

    def _correct_named_points(self, rays: RayCofactors, named: list[int]) -> None:
        """Correct the cofactors of ground points that extra observations name, and of their rays."""
        problem, o = self.problem, self.problem.observations
        for j in named:
            own_rays = np.flatnonzero(o.point == j)
            images = tuple(np.unique(o.image[own_rays]).tolist())
            q = self.cofactors.joint(images, (j,))
            first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
            rays.points[j] = q[-3:, -3:]
            for at, k in enumerate(images):
                rows = own_rays[o.image[own_rays] == k]
                _, d_image, d_ground = image_rows(problem, self.state, k, rows, jacobian=True)
                columns = np.r_[first[at] : first[at + 1], first[-1] : first[-1] + 3]
                design = np.concatenate([d_image, d_ground], axis=2)
                effect = q[:, columns] @ np.swapaxes(design, 1, 2)
                rays.residual[rows] = np.eye(2) - design @ effect[:, columns]
                rays.response[rows] = effect[:, -3:]
                root = inverse_roots(rays.images[k : k + 1], np.diff(first[at : at + 2]))[0, : d_image.shape[2]]
                own = root[:, : len(root)] @ effect[:, first[at] : first[at + 1]]
                rays.on_image[rows] = np.linalg.norm(own, axis=1)

    def _of_extra(self, extra: ExtraObservation) -> Array:
        """Return the redundancy numbers of the rows of an extra observation."""
        _, blocks = extra_blocks(self.problem, extra, self.state, jacobian=True)
        parts: dict[tuple[bool, int], Array] = {}
        for a, block in blocks:
            parts[a.is_image, a.index] = parts.get((a.is_image, a.index), 0.0) + block
        images, points = (tuple(index for is_image, index in parts if is_image is kind) for kind in (True, False))
        q = self.cofactors.joint(images, points)
        design = np.hstack([parts[True, k] for k in images] + [parts[False, j] for j in points])
        return np.asarray(1.0 - np.sum((design @ q) * design, axis=1))


# --- contributions of groups ----------------------------------------------------------------------


def cost(problem: Problem, n_groups: int) -> int:
    """Count the elements of the matrices of :class:`GroupCofactors`: one per group, and one of ungrouped rows."""
    return (n_groups + 1) * (problem.n_free_unknowns + 3 * len(problem.named_points())) ** 2


class GroupCofactors:
    """Contributions of the groups to the cofactors of unknowns and residuals of a solution.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of a solution by any backend.
    labels : (n,) int array
        Group of every row: image points, control points in East, North, Up, priors, extra observations; -1: no group.
    n_groups : int
    """

    def __init__(self, known: ResidualCofactors, labels: Index, n_groups: int) -> None:
        self._problem, self._state = problem, state = known.problem, known.state
        self._labels, self._size = np.where(labels < 0, n_groups, labels), n_groups + 1
        self._named, self._rows = problem.named_points(), linearised(problem, state)
        self._q = free_cofactors(problem, known.cofactors.joint, self._named)

    def _points(self, only: Index | None = None) -> Iterator[PointRows]:
        return eliminated_points(self._problem, self._rows, self._named, only=only, groups=self._size)

    def _all(self) -> Iterator[PointRows]:
        """Yield the rows of all ground points, priors and extra observations."""
        yield from self._points()
        problem = self._problem
        begin = 2 * len(problem.observations) + 3 * int(problem.observed.sum())
        if problem.block.options.priors:
            u = problem.n_free_unknowns
            yield single_rows(begin + np.arange(u), np.arange(u)[:, None], np.ones((u, 1)))
            begin += u
        yield from extra_rows(problem, self._state, self._named, begin)

    @cached_property
    def _gains(self) -> Array:
        """``Q M_j`` (g + 1, u, u) of all groups, the last of ungrouped observations."""
        from scipy import sparse

        normal = np.zeros((self._size, *self._q.shape))
        for part in self._all():
            n, r, c = part.design.shape
            columns = np.repeat(part.columns, r, axis=0).ravel()
            design = sparse.csr_array(
                (part.design.ravel(), columns, np.arange(0, n * r * c + 1, c)), shape=(n * r, len(self._q))
            )
            label, is_full = self._labels[part.rows.ravel()], FULL * c >= len(self._q)
            for j in np.unique(label):
                mine = design[label == j]
                if is_full:  # full matrices are multiplied by BLAS, which is faster
                    rows = mine.toarray()
                    normal[j] += rows.T @ rows
                else:
                    product = (mine.T @ mine).tocoo()
                    normal[j][product.coords] += product.data
        for own in normal:
            own[:] = self._q @ own
        return normal

    @cached_property
    def parts(self) -> Array:
        """Return W (g + 1, u, u): contributions to the cofactors of the image unknowns (shared unknowns once)."""
        u = self._problem.n_free_unknowns
        return np.asarray(self._wide_parts[:, :u, :u])

    @cached_property
    def _wide_parts(self) -> Array:
        return np.stack([gain @ self._q for gain in self._gains])

    @cached_property
    def shared(self) -> Array:
        """S (g + 1, g + 1) of all groups; last row and column: ungrouped observations."""
        turned = np.swapaxes(self._gains, 1, 2).reshape(self._size, -1)
        out = self._gains.reshape(self._size, -1) @ turned.T
        for part in self._all():
            label = self._labels[part.rows]
            pair = label[:, :, None] * self._size + label[:, None, :]
            own = part.free * (part.free - 2.0 * part.quadratic(self._q))
            out += np.bincount(pair.ravel(), own.ravel(), self._size**2).reshape(out.shape)
        return 0.5 * (out + out.T)

    def shares(self, points: Index, rows: Index, columns: Array) -> Array:
        """Return the shares c of the groups in the variances of errors.

        Parameters
        ----------
        points : (n,) int array
            Ground points of the suspects.
        rows : (n, m) int array
            Row numbers of the suspects; all rows of a suspect belong to its ground point.
        columns : (n, m, k) array
            Change of the residuals in these rows with the errors.

        Returns
        -------
        (n, g + 1) array
            ``tr((E^T R E)^+ E^T R E_j R E) / d``; the last column belongs to ungrouped observations, and each row has
            the sum 1.
        """
        out = np.zeros((len(points), self._size))
        for part in self._points(points):
            at = np.full(len(self._problem.active), -1)
            at[part.point] = np.arange(len(part.point))
            mine = np.flatnonzero(at[points] >= 0)
            of = at[points[mine]]
            q = part.quadratic(self._q)
            own = np.stack([part.quadratic(w) for w in self._wide_parts], axis=1)
            error = np.zeros((len(mine), part.rows.shape[1], columns.shape[2]))
            i, m, r = np.nonzero(rows[mine][:, :, None] == part.rows[of][:, None, :])
            error[i, r] = columns[mine[i], m]
            out[mine] = _shares(part.free[of], q[of], own[of], error, np.eye(self._size)[self._labels[part.rows[of]]])
        return out


def _shares(free: Array, q: Array, own: Array, error: Array, select: Array) -> Array:
    """Return shares (n, g) for errors (n, r, k).

    F, H (n, r, r), ``A W_j A^T`` (n, g, r, r), groups of the rows (n, r, g).
    """
    size, axes = np.linalg.eigh(np.swapaxes(error, 1, 2) @ (free - q) @ error)
    checked = size > CHECKED * np.maximum(size[:, -1:], np.finfo(float).tiny)
    scaled = error @ np.where(checked[:, None], axes / np.sqrt(np.where(checked, size, 1.0))[:, None], 0.0)
    within = np.sum((free @ scaled) * ((free - 2.0 * q) @ scaled), axis=2)
    whole = np.einsum("nrg,nr->ng", select, within) + np.einsum("nra,ngrs,nsa->ng", scaled, own, scaled, optimize=True)
    return np.asarray(whole / np.maximum(checked.sum(axis=1), 1)[:, None])
