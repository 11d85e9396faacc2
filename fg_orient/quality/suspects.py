"""Suspects: observations that may have a common gross error, and the inputs of their tests.

A suspect is an image point (line, sample), the position of a control point (East, North)
or its height (Up); or a single coordinate; or a whole ground point. Its error may have
any size and direction.

With whitened residuals v of the suspect's rows, their cofactors ``Q = I - J N^-1 J^T``
and the columns E of the error in these rows, the weighted sum of squares decreases by

    T = (E^T v)^T (E^T Q E)^+ (E^T v)

if the error becomes an unknown, and ``(E^T Q E)^+ E^T v`` is its estimate (Baarda 1968;
Kok 1984). d, the rank of ``E^T Q E``, is the number of directions that the other
observations check. If d is 0, the suspect cannot be tested.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import linearised
from fg_orient.quality import hypotheses
from fg_orient.quality.cofactors import Cofactors
from fg_orient.quality.elimination import PointRows, eliminated_points, free_cofactors
from fg_orient.quality.residuals import ResidualCofactors, by_parts

#: What a suspect is: an image point, a position or a height; a single coordinate; a ground point with all observations.
Kind = Literal["groups", "coordinates", "points"]

KINDS: Final = ("groups", "coordinates", "points")


@dataclass(frozen=True)
class Suspects:
    """Suspected observations of one part of the block.

    Parameters
    ----------
    part : str
        "image", "position", "height"; "line", "sample", "east", "north", "up"; "point".
    unit : str
        Unit of the error: "px line, sample", "m East, North", ...; "" for a whole point,
        whose error has several units.
    point : (n,) int array
        Ground points.
    row : (n,) int array
        Rows of ``problem.observations``; -1 for suspects that are not image points.
    rows : (n, m) int array
        Rows of v among all rows: image points, then control points in East, North, Up.
    v : (n, m) array
        Whitened residuals.
    q : (n, m, m) array
        Cofactors of v.
    columns : (n, m, k) array
        Change of the whitened residuals with the error.
    """

    part: str
    unit: str
    point: Index
    row: Index
    rows: Index
    v: Array
    q: Array
    columns: Array

    def quadratic(self) -> tuple[Array, Index, Array]:
        """Return T (n,), its degrees of freedom d (n,) and the estimated error (n, k), zero in unchecked directions."""
        if self.v.ndim > 2:  # v has an additional axis for many draws of the residuals
            return self._quadratic(slice(None))
        t, d, error = by_parts(len(self.v), self._quadratic)
        return t, d, error

    def _quadratic(self, rows: slice) -> tuple[Array, Index, Array]:
        length = np.linalg.norm(self.columns[rows], axis=-2)
        e = self.columns[rows] / length[..., None, :]
        turned = np.swapaxes(e, -1, -2)
        v = np.einsum("...km,...m->...k", turned, self.v[rows])
        t, d, error = hypotheses.quadratic(v, turned @ self.q[rows] @ e)
        return t, d, error / length


def suspects(known: ResidualCofactors, kind: Kind = "groups") -> list[Suspects]:
    """Return all suspects of a kind.

    Parameters
    ----------
    known : ResidualCofactors
        Residuals of a least-squares solution.
    kind : str
        "groups": image points (line and sample), positions (East and North) and heights
        of weighted control points; "coordinates": each coordinate alone; "points": a
        ground point with all its image points and its coordinates.
    """
    if kind == "points":
        return _whole_points(known)
    problem = known.problem
    o, given = problem.observations, np.flatnonzero(problem.observed)
    place, n = np.arange(len(o)), 2 * len(o)
    image = (o.point, place, 2 * place[:, None] + np.arange(2), known.v_image, known.image)
    rows = n + 3 * np.arange(len(given))[:, None] + np.arange(3)
    control = (given, np.full(len(given), -1), rows, known.v_control, known.control)
    # the sign is negative because residuals are adjusted minus observed
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    if len(o) and (sigma == sigma[0]).all():  # one matrix for all suspects
        pixel = np.broadcast_to(-np.eye(2) / sigma[0], (len(o), 2, 2))
    else:
        pixel = -np.eye(2) / sigma[:, None]
    metre = -np.eye(3) * np.linalg.norm(known.control_rows, axis=2)[:, None]
    east, north, up = problem.axis_names
    if kind == "coordinates":
        names = (("east", east), ("north", north), ("up", up))
        return [
            Suspects("line", "px line", *image, pixel[:, :, :1]),
            Suspects("sample", "px sample", *image, pixel[:, :, 1:]),
            *(Suspects(part, f"m {axis}", *control, metre[:, :, [k]]) for k, (part, axis) in enumerate(names)),
        ]
    return [
        Suspects("image", "px line, sample", *image, pixel),
        Suspects("position", f"m {east}, {north}", *control, metre[:, :, :2]),
        Suspects("height", f"m {up}", *control, metre[:, :, 2:]),
    ]


def _whole_points(known: ResidualCofactors) -> list[Suspects]:
    """Return ground points with all their observations.

    Points with the same number of rows form one family.
    """
    problem, cofactors = known.problem, known.cofactors
    v = np.concatenate([known.v_image.ravel(), known.v_control.ravel()])
    rays, named = linearised(problem, known.state), problem.named_points()
    whole = free_cofactors(problem, cofactors.joint, named) if problem.n_image_unknowns <= WHOLE_LIMIT else None
    by_size: dict[int, list[tuple[Index, Index, Array]]] = {}
    for part in eliminated_points(problem, rays, named, groups=1):
        joint = _joint_of_each(problem, cofactors, part, named) if whole is None else whole
        q = part.free - part.quadratic(joint)
        by_size.setdefault(part.rows.shape[1], []).append((part.point, part.rows, q))
    out = []
    for size, parts in sorted(by_size.items()):
        point, rows, q = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        order = np.argsort(point)
        unit = np.tile(np.eye(size), (len(point), 1, 1))
        out.append(
            Suspects("point", "", point[order], np.full(len(point), -1), rows[order], v[rows[order]], q[order], unit)
        )
    return out


def _joint_of_each(problem: Problem, cofactors: Cofactors, part: PointRows, named: list[int]) -> Array:
    """Compute joint cofactors (P, c, c) of the columns of each ground point, if all images have too many columns."""
    own, size, c = part.point[0] in named, np.diff(problem.first), part.columns.shape[1]
    out = np.empty((len(part.point), c, c))
    for place, images in enumerate(part.kind[:, : part.kind.shape[1] - own].tolist()):
        seen = tuple(dict.fromkeys(images))
        first = np.cumsum([0, *size[list(seen)]])
        begin = dict(zip(seen, first.tolist(), strict=False))
        at = [begin[k] + np.minimum(np.arange(size.max()), size[k] - 1) for k in images]
        columns = np.concatenate([*at, first[-1] + np.arange(3 * own)])
        out[place] = cofactors.joint(seen, (int(part.point[place]),) if own else ())[np.ix_(columns, columns)]
    return out
