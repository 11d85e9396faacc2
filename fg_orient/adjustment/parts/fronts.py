"""Files of the fronts of a dissected block, and the tasks on them.

With S the normal equations of a front, own unknowns I and border B, the file of a front
holds R of ``S_II = R^T R``, ``W = R^-T S_IB`` and ``R^-T g_I`` of the gradient g. Another
file contains the contribution to the parent, ``S_BB - W^T W`` and ``g_B - W^T R^-T g_I``.
The file of the inverse contains the cofactors of all unknowns of the front: with ``G =
R^-1 W`` and Q_BB from the parent, ``Q_IB = -G Q_BB`` and ``Q_II = (R^T R)^-1 + G Q_BB
G^T`` (Takahashi et al. 1973).

Tasks are functions of files and small arguments. Files are written completely or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack, solve_triangular

from factors.arrays import Array, Index
from fg_orient.adjustment.parts.dissection import Front
from fg_orient.adjustment.parts.parts import read_array, write_array
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.kernels.batch_matrix import add_shared


@dataclass(frozen=True)
class Partial:
    """Contribution of some parts to the reduced normal equations.

    Blocks (B, k, k) of images row <= column, sorted.
    """

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
    blocks: Array
    gradient: Array
    error: float

    def __add__(self, other: Partial) -> Partial:
        span = 1 + int(max(self.column.max(initial=0), other.column.max(initial=0)))
        mine, theirs = (p.row * span + p.column for p in (self, other))
        keys = np.union1d(mine, theirs)
        blocks = np.zeros((len(keys), *self.blocks.shape[1:]))
        blocks[np.searchsorted(keys, mine)] += self.blocks
        blocks[np.searchsorted(keys, theirs)] += other.blocks
        row, column = np.divmod(keys, span)
        return Partial(row, column, blocks, self.gradient + other.gradient, self.error + other.error)


@dataclass(frozen=True)
class Added:
    """Terms of the images that a front eliminates: priors, damping, observations of one image.

    ``diagonal`` is added to the diagonal, ``blocks`` are J^T J of each image (empty
    without such observations), ``gradient`` is (own,).
    """

    diagonal: float
    gradient: Array
    blocks: tuple[Array, ...]


def front_of_part(node: Front, first: Index, partial: Partial) -> Array:
    """Return the matrix (n + 1, n) of the front of a part; the gradient is its last row."""
    n, of, size = len(node.unknowns), np.full(int(first[-1]), -1), np.diff(first)
    of[node.unknowns] = np.arange(n)
    own = of[first[:-1]] >= 0
    kept = own[partial.row] & own[partial.column]
    out = np.zeros((n + 1, n))
    add_shared(partial.row[kept], partial.column[kept], first, of, size, partial.blocks[kept], out)
    out[n] = partial.gradient[node.unknowns]
    return out


def write_front(folder: str, name: str, node: Front, matrix: Array, added: Added) -> None:
    """Complete the normal equations (n + 1, n) of a front, eliminate its images, and write its files.

    Singular: the images are not determined.
    """
    own, place = node.own, 0
    matrix[np.arange(own), np.arange(own)] += added.diagonal
    for block in added.blocks:
        at = slice(place, place + len(block))
        matrix[at, at] += block
        place = at.stop
    matrix[-1, :own] += added.gradient
    if not np.diag(matrix)[:own].all():
        raise Singular("an unknown of an image is in no observation")
    rest = matrix[own:, own:]
    if own:
        with one_blas_thread():
            root, info = lapack.dpotrf(matrix[:own, :own])
            if info != 0:
                raise Singular("the reduced camera system is not positive definite")
            right = np.hstack([matrix[:own, own:], matrix[-1:, :own].T])
            half = solve_triangular(root, right, trans=1, check_finite=False)
            rest[:-1] -= half[:, :-1].T @ half[:, :-1]
            rest[-1] -= half[:, -1] @ half[:, :-1]
        write_array(front_file(folder, name, node), np.hstack([root, half]))
    if rest.size:
        write_array(rest_file(folder, name, node), rest)


def front_of_children(folder: str, name: str, node: Front, children: list[Front], added: Added) -> None:
    """Sum the contributions of the children's fronts, and eliminate; see :func:`write_front`."""
    n = len(node.unknowns)
    matrix = np.zeros((n + 1, n))
    for child in (c for c in children if len(c.above)):
        matrix[np.ix_(np.append(child.above, n), child.above)] += read_array(rest_file(folder, name, child))
    write_front(folder, name, node, matrix, added)


def _factor(folder: str, name: str, node: Front) -> tuple[Array, Array, Array]:
    """Return R (own, own), W (own, n - own) and ``R^-T g`` (own, 1) for the gradient g."""
    n, own = len(node.unknowns), node.own
    f = read_array(front_file(folder, name, node)) if own else np.zeros((0, n + 1))
    return f[:, :own], f[:, own:n], f[:, n:]


def forward(folder: str, name: str, node: Front, right: Array) -> tuple[Array, Array]:
    """Return ``y = R^-T b`` (own, c) of right sides b of the own unknowns, and ``W^T y`` (n - own, c)."""
    root, w, _ = _factor(folder, name, node)
    with one_blas_thread():
        y = solve_triangular(root, right, trans=1, check_finite=False)
        return y, w.T @ y


def backward(folder: str, name: str, node: Front, y: Array | None, border: Array) -> Array:
    """Solve ``R^-1 (y - W x)`` (own, c) for solutions x (n - own, c) of the border.

    Default of y: of the gradient.
    """
    root, w, of_gradient = _factor(folder, name, node)
    with one_blas_thread():
        right = (-of_gradient if y is None else y) - w @ border
        return np.asarray(solve_triangular(root, right, check_finite=False))


def product(folder: str, name: str, node: Front, x: Array | None) -> Array:
    """Return the contribution (n,) of a front to the product of S with a vector.

    If no vector is given, return the contribution to the diagonal of S.
    """
    f = np.hstack(_factor(folder, name, node)[:2])
    with one_blas_thread():
        return np.asarray(np.einsum("ij,ij->j", f, f) if x is None else f.T @ (f @ x))


def inverse(folder: str, name: str, node: Front, parent: Front | None) -> None:
    """Write the cofactors (n, n) of a front, from the cofactors of its parent."""
    (root, w, _), own, n = _factor(folder, name, node), node.own, len(node.unknowns)
    q = np.empty((n, n))
    with one_blas_thread():
        half = solve_triangular(root, np.hstack([np.eye(own), w]), check_finite=False)
        q[:own, :own] = half[:, :own] @ half[:, :own].T
        if parent is not None and own < n:
            q[own:, own:] = read_array(inverse_file(folder, name, parent))[np.ix_(node.above, node.above)]
            q[:own, own:] = -half[:, own:] @ q[own:, own:]
            q[own:, :own] = q[:own, own:].T
            q[:own, :own] -= q[:own, own:] @ half[:, own:].T
    write_array(inverse_file(folder, name, node), q)


def rest_file(folder: str | Path, name: str, node: Front) -> Path:
    """Return the file of the normal equations that a front leaves to its parent."""
    return Path(folder) / f"rest-{node.lo:04d}-{node.hi:04d}-{name}.npy"


def front_file(folder: str | Path, name: str, node: Front) -> Path:
    """Return the file of the factor of a front."""
    return Path(folder) / f"front-{node.lo:04d}-{node.hi:04d}-{name}.npy"


def inverse_file(folder: str | Path, name: str, node: Front) -> Path:
    """Return the file of the cofactors of a front."""
    return Path(folder) / f"inverse-{node.lo:04d}-{node.hi:04d}-{name}.npy"
