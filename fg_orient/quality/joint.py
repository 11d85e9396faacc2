"""Joint cofactors by name: images, single parameters, points, adjusted observations, residuals.

All quantities are linear in the unknowns x. With whitened rows A, observations l of unit weight and ``Q = N^-1``::

    Q_xx = Q,   Q_x,lbar = Q A^T,   Q_lbar = A Q A^T,   Q_vv = I - A Q A^T,   Q_xv = 0,   Q_lbar,v = 0

(Mikhail & Ackermann 1976, 4.5; T(2.76) and T(2.77) in the corrected form with B = -I). Independent of a sign convention
of conditions ``Q_x,l = Q_x,lbar``: an unknown is correlated with the adjusted observation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows
from fg_orient.model.errors import InputError
from fg_orient.quality.covariance import Cofactors, NamedMatrix

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class _Rows:
    """Rows of one name: names, units, and derivatives with respect to images and points.

    ``observed``: row of ``problem.observations`` and coordinate (0 or 1) of residuals; row -1 for other quantities.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    images: dict[int, Array]
    points: dict[int, Array]
    observed: tuple[tuple[int, int], ...]


def joint_cofactors(problem: Problem, state: State, cofactors: Cofactors, names: tuple[str, ...]) -> NamedMatrix:
    """Joint cofactors (prior scale) in physical units.

    Parameters
    ----------
    problem : Problem
        Problem of the cofactors.
    state : State
    cofactors : Cofactors
    names : tuple of str
        "image:left" (all parameters), "image:left.x_0", "point:12", "point:12.z", "observation:left/12" (adjusted line
        and sample, px), "residual:left/12" (adjusted minus observed, px). Empty: all images.

    Raises
    ------
    InputError
        A name that does not exist, or a point that is not an unknown.
    """
    names = names or tuple(f"image:{image.id}" for image in problem.block.images)
    parts = [rows for name in names for rows in _find(problem, state, name)]
    images = tuple(dict.fromkeys(k for part in parts for k in part.images))
    points = tuple(dict.fromkeys(j for part in parts for j in part.points))
    sizes = {k: len(problem.parameters[k]) for k in images}
    first = np.concatenate([[0], np.cumsum([*sizes.values(), *[3] * len(points)])]).astype(np.intp)
    at_image, at_point = dict(zip(images, first, strict=False)), dict(zip(points, first[len(images) :], strict=False))
    design = np.zeros((sum(len(part.names) for part in parts), int(first[-1])))
    row = 0
    for part in parts:
        rows = slice(row, row := row + len(part.names))
        for k, block in part.images.items():
            design[rows, at_image[k] : at_image[k] + sizes[k]] = block
        for j, block in part.points.items():
            design[rows, at_point[j] : at_point[j] + 3] = block
    q = design @ cofactors.joint(images, points) @ design.T
    observed = [pair for part in parts for pair in part.observed]
    labels = tuple(name for part in parts for name in part.names)
    units = tuple(unit for part in parts for unit in part.units)
    q = _with_residuals(problem, 0.5 * (q + q.T), observed)
    return NamedMatrix(labels, units, q)


def _with_residuals(problem: Problem, q: Array, observed: list[tuple[int, int]]) -> Array:
    """Convert the rows of residuals, formed as adjusted observations, to residuals."""
    is_residual = np.array([row >= 0 for row, _ in observed], bool)
    out = np.where(is_residual[:, None] == is_residual, q, 0.0)
    where = np.flatnonzero(is_residual)
    o = problem.observations
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    out[np.ix_(where, where)] *= -1.0
    for a in where:
        for b in where:
            if observed[a] == observed[b]:
                out[a, b] += sigma[observed[a]] ** 2
    return out


def _find(problem: Problem, state: State, name: str) -> list[_Rows]:
    """Rows of a name; errors as of :func:`joint_cofactors`."""
    kind, _, rest = name.partition(":")
    if kind in ("observation", "residual"):
        rows = [_of_observation(problem, state, int(row), kind) for row in _image_points(problem, rest)]
    else:
        rows = [_of_unknown(problem, name)]
    if not rows:
        raise InputError.of("covariance.no_such", place="covariance", value=name)
    return rows


def _of_unknown(problem: Problem, name: str) -> _Rows:
    """Rows of an image, a point, or one of its unknowns."""
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
    rows = np.diag(scale)[chosen]
    identifier = block.images[k].id if kind == "image" else block.points.ids[k]
    return _Rows(
        tuple(f"{identifier}.{names[c]}" for c in chosen), tuple(units[c] for c in chosen),
        {k: rows} if kind == "image" else {}, {k: rows} if kind == "point" else {}, ((-1, 0),) * len(chosen),
    )  # fmt: skip


def _image_points(problem: Problem, rest: str) -> Index:
    """Rows of the image points of a point in an image, named "image/point"."""
    o, ids = problem.observations, problem.block.points.ids
    for k, image in enumerate(problem.block.images):
        point = rest.removeprefix(f"{image.id}/")
        if point != rest and point in ids:
            return np.flatnonzero((o.image == k) & (o.point == ids.index(point)))
    return np.zeros(0, np.intp)


def _of_observation(problem: Problem, state: State, row: int, kind: str) -> _Rows:
    """Adjusted line and sample of an image point in pixels, or its residuals."""
    o, block = problem.observations, problem.block
    k, j = int(o.image[row]), int(o.point[row])
    _, d_image, d_ground = image_rows(problem, state, k, np.array([row]), jacobian=True)
    sigma = np.array([[o.sigma_line_px[row]], [o.sigma_sample_px[row]]])
    where = f"{block.images[k].id}/{block.points.ids[j]}"
    prefix = "v_" if kind == "residual" else ""
    return _Rows(
        (f"{where}.{prefix}line", f"{where}.{prefix}sample"), ("px", "px"), {k: sigma * d_image[0]},
        {j: sigma * d_ground[0]} if problem.active[j] else {},
        ((row, 0), (row, 1)) if kind == "residual" else ((-1, 0),) * 2,
    )  # fmt: skip
