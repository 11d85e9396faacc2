"""Joint cofactors by name: images, single parameters, points, adjusted observations, residuals.

All quantities are linear in the unknowns x. With whitened rows A, observations l of unit weight and ``Q = N^-1``::

    Q_xx = Q,   Q_x,lbar = Q A^T,   Q_lbar = A Q A^T,   Q_vv = I - A Q A^T,   Q_xv = 0,   Q_lbar,v = 0

(Mikhail & Ackermann 1976, 4.5; T(2.76) and T(2.77) in the corrected form with B = -I). Independent of a sign convention
of conditions ``Q_x,l = Q_x,lbar``: an unknown is correlated with the adjusted observation.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows
from fg_orient.model.errors import InputError
from fg_orient.quality.cofactors import Cofactors

if TYPE_CHECKING:
    import pandas


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
        """Values as ``pandas.DataFrame`` (extra "tables"), with the names as index and columns."""
        import pandas

        return pandas.DataFrame(self.values, list(self.names), list(self.names))

    @property
    def correlations(self) -> Array:
        """Correlations ``q_ij / sqrt(q_ii q_jj)``, T(2.75), clipped to -1 to 1; nan without variance."""
        sigma = np.sqrt(np.diag(self.values))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.clip(self.values / np.outer(sigma, sigma), -1.0, 1.0))


class _Rows(NamedTuple):
    """Rows of one name: names, units, and derivatives with respect to ("image", k) and ("point", j).

    ``residual``: row of ``problem.observations`` whose residuals these are; -1 for other quantities.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    blocks: dict[tuple[str, int], Array]
    residual: int = -1


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
    """Convert the rows of residuals, formed as adjusted observations, to residuals of these image coordinates."""
    o = problem.observations
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1).ravel()
    out = np.where(is_residual[:, None] == is_residual, q, 0.0)
    where = np.flatnonzero(is_residual)
    own = coordinate[where]
    out[np.ix_(where, where)] = np.where(own[:, None] == own, sigma[own] ** 2, 0.0) - out[np.ix_(where, where)]
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
    identifier = block.images[k].id if kind == "image" else block.points.ids[k]
    labels, own = tuple(f"{identifier}.{names[c]}" for c in chosen), tuple(units[c] for c in chosen)
    return _Rows(labels, own, {(kind, k): np.diag(scale)[chosen]})


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
    blocks = {("image", k): sigma * d_image[0]} | ({("point", j): sigma * d_ground[0]} if problem.active[j] else {})
    names = (f"{where}.{prefix}line", f"{where}.{prefix}sample")
    return _Rows(names, ("px", "px"), blocks, row if kind == "residual" else -1)
