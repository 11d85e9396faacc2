"""Whitened residuals and Jacobians of whole images, through the batches of ``factors.batch``.

For what looks at a block once, before or after the solver: no Python call per image point, and no more memory than
one image takes. An equation without a batch is evaluated row by row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors._contract import evaluate
from factors.batch import batch, has_batch

if TYPE_CHECKING:
    from fg_orient.adjustment.problem import Problem, State

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


def rows_by_image(problem: Problem) -> list[Index]:
    """Rows of ``problem.observations`` in each image, ascending."""
    image = problem.observations.image
    order = np.argsort(image, kind="stable")
    return np.split(order, np.cumsum(np.bincount(image, minlength=problem.n_images))[:-1])


def image_rows(problem: Problem, state: State, k: int, rows: Index, *, jacobian: bool) -> tuple[Array, Array, Array]:
    """Residuals (n, 2) of image points of one image and, if asked, Jacobians (n, 2, u) and (n, 2, 3); else empty.

    Parameters
    ----------
    problem, state
    k : int
        The image.
    rows : (n,) int array
        Rows of ``problem.observations``, all of image k.
    jacobian : bool
    """
    model, n = problem.models[k], len(rows)
    ground = np.ascontiguousarray(state.ground[problem.observations.point[rows]])
    x, records = problem.unknowns(state, k), problem.records[rows]
    if not has_batch(model.equation):
        found, blocks = evaluate(
            model.equation, records, [model.parameters.setup] * n, [x] * n, ground, jacobian=jacobian
        )
        d_x, d_point = (np.array(b).reshape(n, 2, -1 if jacobian and n else 0) for b in blocks)
        return found.reshape(n, 2), d_x, d_point
    kernel, columns = batch(model.equation, model.parameters.setup, records)
    basis, own = columns.values(records), np.arange(n, dtype=np.int32)
    wide = np.zeros((1, basis.shape[1] * columns.n_components))
    wide[0, columns.wide] = x * columns.scale
    value, d_image, d_ground = np.empty((n, 2)), np.zeros((n, 2, columns.n_components)), np.zeros((n, 2, 3))
    kernel(
        0, n, own, records, own, np.zeros(n, np.int32), own, columns.setup, basis.shape[1], basis, wide, ground, value,
        d_image, d_ground, jacobian,
    )  # fmt: skip
    if not jacobian:
        return value, np.empty((n, 2, 0)), np.empty((n, 2, 0))
    return value, d_image[:, :, columns.component] * (basis[:, columns.basis] * columns.scale)[:, None], d_ground


def residuals(problem: Problem, state: State) -> Array:
    """Whitened residuals (n, 2) of all image points."""
    out = np.empty((len(problem.observations), 2))
    for k, rows in enumerate(rows_by_image(problem)):
        out[rows] = image_rows(problem, state, k, rows, jacobian=False)[0]
    return out
