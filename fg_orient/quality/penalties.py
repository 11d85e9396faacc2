"""Penalties on the correction functions of images: first and second derivatives.

The coefficients of one component of an image, such as roll, form a function of one normalised variable t in
[-1, 1], line or sample: polynomial coefficients and the curves of ``factors.geometry.polynomials``. The
function is divided by the prior sigma of its first coefficient. A penalty is the mean square of a derivative
at :data:`TIMES` equally spaced values of t. Derivatives are divided differences, which are exact for
quadratics. Each component of each image has its own penalty. A constant has no penalty.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.arrays import Array
from factors.geometry import polynomials
from fg_orient.adjustment.problem import Problem
from fg_orient.model.parameters import ImageParameters, term_of

#: Number of values of t at which the derivatives of a function are computed.
TIMES: Final = 11
#: Derivatives smaller than this multiple of the rounding error of the function are set to zero.
ROUNDINGS: Final = 100.0
_ORDER: Final = {"gradient": 1, "laplace": 2}


def penalty_rows(problem: Problem) -> Array | None:
    """Return the rows L (k, z) of the free image unknowns in prior sigmas, by the options.

    None for the deviation alone.
    """
    options = problem.block.options
    if options.penalty == "deviation":
        return None
    order, rows = _ORDER[options.penalty], []
    for k, parameters in enumerate(problem.parameters):
        own = image_penalty(parameters, order, options.curve_intervals)
        wide = np.zeros((len(own), problem.n_image_unknowns))
        wide[:, problem.image_slice(k)] = own
        rows.append(wide if problem.ties is None else np.asarray(wide @ problem.ties.matrix))
    if options.penalty_deviation:
        rows.append(np.eye(problem.n_free_unknowns))
    return np.vstack(rows)


def image_penalty(parameters: ImageParameters, order: int, intervals: int) -> Array:
    """Return rows (k, u) of an image in prior sigmas, for an order of the derivative and a number of intervals."""
    functions: dict[str, list[int]] = {}
    for j, name in enumerate(parameters.names):
        if (term := term_of(name)) is not None and term.kind:
            functions.setdefault(name.rstrip("0123456789").removesuffix("c"), []).append(j)
    t = np.linspace(-1.0, 1.0, TIMES + order)
    rows = [np.zeros((0, len(parameters)))]
    for members in functions.values():
        values = np.stack([_values(parameters.names[j], t, intervals) for j in members], axis=1)
        values *= parameters.sigma[members] / parameters.sigma[members[0]] / np.sqrt(TIMES) / (t[1] - t[0]) ** order
        _, s, vt = np.linalg.svd(np.diff(values, n=order, axis=0), full_matrices=False)
        rank = int(np.count_nonzero(s > ROUNDINGS * np.finfo(float).eps * np.linalg.norm(values)))
        own = np.zeros((rank, len(parameters)))
        own[:, members] = s[:rank, None] * vt[:rank]
        rows.append(own)
    return np.vstack(rows)


def _values(name: str, t: Array, intervals: int) -> Array:
    """Return the values (n,) of the function of one coefficient at t."""
    number = int(name[len(name.rstrip("0123456789")) :])
    if name.rstrip("0123456789").endswith("c"):
        return np.asarray(polynomials.curves(t, intervals)[:, number])
    return np.asarray(t**number)
