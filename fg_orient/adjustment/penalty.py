"""Linear rows of the image unknowns as observations: penalties of a regularisation, or directions held fixed.

A row r of the total deviation x of the image unknowns from the metadata is the
observation ``r x = 0``. Every backend adds it like another observation of images. The dense backend
adds rows, the graph adds a factor, and the Schur backend adds ``R^T R`` to the reduced matrix, with the
gradient ``R^T R x``. All backends therefore solve the same equations. Rows of one image are an
observation of this image, so that the reduced system stays sparse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from factors._contract import Argument, Equation
from factors.arrays import Array, Index
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.block import ExtraObservation

#: If the condition number of the image unknowns with all rows exceeds this, normal
#: equations lose the weakest direction: the square of the condition number must be well
#: below 1e16.
NORMAL_LIMIT: Final = 1e6


@dataclass(frozen=True)
class Penalty(ExtraObservation):
    """Rows of a regularisation.

    Parameters
    ----------
    condition : float
        Condition of the image unknowns, in prior sigmas, with all penalties.
    """

    condition: float = 1.0


def needs_rows(problem: Problem) -> bool:
    """Return whether a regularised problem is too ill-conditioned for an elimination of points in normal equations."""
    return any(isinstance(e, Penalty) and e.condition > NORMAL_LIMIT for e in problem.block.extra)


def without_penalties(problem: Problem) -> Problem:
    """Return the problem without the rows of a regularisation."""
    others = tuple(e for e in problem.block.extra if not isinstance(e, Penalty))
    return replace(problem, block=replace(problem.block, extra=others))


def penalty_squares(problem: Problem, state: State) -> float:
    """Return the sum of squares of a regularisation's rows at a state; 0 without a regularisation.

    These rows are not observations.
    """
    if problem.regularisation is None:
        return 0.0
    return float(np.sum((problem.regularisation.rows @ problem.image_vector(state)) ** 2))


def penalties(problem: Problem, rows: Any, source: str, condition: float) -> tuple[Penalty, ...]:
    """Return the penalties of the free image unknowns as rows (k, z), dense or sparse.

    There is one penalty per image, and one for all rows of several images. A shared
    unknown is read from the first image that has it.
    """
    from scipy import sparse

    elements = sparse.coo_array(rows)
    row, free = elements.coords
    column = np.asarray(free if problem.ties is None else problem.ties.place[free])
    wide = sparse.csr_array((elements.data, (row, column)), (rows.shape[0], problem.n_image_unknowns))
    image = np.repeat(np.arange(problem.n_images), np.diff(problem.first))[column]
    first, last = np.full(wide.shape[0], problem.n_images), np.full(wide.shape[0], -1)
    np.minimum.at(first, row, image)
    np.maximum.at(last, row, image)
    groups = [np.flatnonzero((first == k) & (last == k)) for k in np.unique(first[first == last])]
    out = []
    for own in (g for g in [*groups, np.flatnonzero(first < last)] if len(g)):
        of = np.unique(image[np.isin(row, own)])
        columns = np.concatenate([np.arange(problem.first[k], problem.first[k + 1]) for k in of])
        compressed = triangle(wide[own][:, columns].toarray())  # QR: at most as many observations as unknowns remain
        equation, unknowns, setup = linear_rows(problem, compressed, of, "penalty", source)
        named = unknowns[0].replace("image:", "image ") if len(of) == 1 else f"{len(of)} images"
        out.append(Penalty(equation, unknowns, np.zeros(0), setup, len(setup), f"penalty of {named}", condition))
    return tuple(out)


def held_rows(problem: Problem, rows: Array, name: str, source: str) -> tuple[Equation, tuple[str, ...], Array]:
    """Return equation, names and setup of rows (k, z) of the free unknowns of all images.

    See :func:`linear_rows`.
    """
    wide = rows
    if problem.ties is not None:  # a shared unknown is read from the first image that has it
        wide = np.zeros((len(rows), problem.n_image_unknowns))
        wide[:, problem.ties.place] = rows
    return linear_rows(problem, wide, np.flatnonzero(np.diff(problem.first)), name, source)


def linear_rows(
    problem: Problem, rows: Array, images: Index, name: str, source: str
) -> tuple[Equation, tuple[str, ...], Array]:
    """Return equation, names of unknowns and setup of rows (k, w) of these images' unknowns, which shall be zero."""

    def residual(_record: Any, setup: Any, *x: Any) -> Any:
        return setup @ np.concatenate(x)

    def kernel(record: Array, setup: Array, *x: Any) -> tuple[Array, ...]:
        *values, want = x
        ends = np.cumsum([len(v) for v in values])[:-1]
        return residual(record, setup, *values), *(np.split(setup, ends, axis=1) if want else ())

    arguments = tuple(Argument(f"x{k}", "prior sigma") for k in images.tolist())
    unknowns = tuple(f"image:{problem.block.images[k].id}" for k in images.tolist())
    return Equation(name, kernel, residual, arguments, source), unknowns, np.ascontiguousarray(rows)
