"""Suspects: groups of observations that one gross error may lie in, with what a test needs of them.

With whitened residuals v of the group's rows, their cofactors ``Q = I - J N^-1 J^T`` and the columns E of the error in
these rows, the weighted sum of squares falls by

    T = (E^T v)^T (E^T Q E)^+ (E^T v)

when the error becomes unknown, and ``(E^T Q E)^+ E^T v`` is its estimate (Baarda 1968; Kok 1984). d, the rank of
``E^T Q E``, counts what the other observations check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import Rows, linearised, residuals, side_by_side
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.reliability import ResidualCofactors, residual_cofactors

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
#: What is suspected: image points, positions and heights; single coordinates; ground points with all they are seen in.
Kind = Literal["groups", "coordinates", "points"]
KINDS: Final = ("groups", "coordinates", "points")

#: Directions below this share of a free observation are not checked by the others.
CHECKED: Final = 1e-6


@dataclass(frozen=True)
class Suspects:
    """Suspects of one part.

    Parameters
    ----------
    part : str
        "image", "position", "height"; "line", "sample", "east", "north", "up"; "point".
    unit : str
        Of the error: "px line, sample", "m East, North", ...; "" for a whole point, whose error has no one unit.
    point : (n,) int array
        Ground points.
    row : (n,) int array
        Rows of ``problem.observations``; -1 for suspects that are no image points.
    v : (n, m) array
        Whitened residuals.
    q : (n, m, m) array
        Their cofactors.
    columns : (n, m, k) array
        Change of the whitened residuals with the error.
    """

    part: str
    unit: str
    point: Index
    row: Index
    v: Array
    q: Array
    columns: Array

    def quadratic(self) -> tuple[Array, Index, Array]:
        """T (n,), its degrees of freedom d (n,) and the estimated error (n, k), zero along what nothing checks."""
        length = np.linalg.norm(self.columns, axis=-2)
        e = self.columns / length[..., None, :]
        turned = np.swapaxes(e, -1, -2)
        t, d, error = quadratic(np.einsum("...km,...m->...k", turned, self.v), turned @ self.q @ e)
        return t, d, error / length


def quadratic(v: Array, q: Array) -> tuple[Array, Index, Array]:
    """``v^T Q^+ v`` (n,), the rank d of Q (n,) and ``Q^+ v`` (n, k), of v (n, k) with cofactors Q (n, k, k)."""
    size, axes = np.linalg.eigh(q)
    checked = size > CHECKED
    along = np.einsum("...ka,...k->...a", axes, v)
    share = np.where(checked, along / np.where(checked, size, 1.0), 0.0)
    return (
        np.sum(along * share, axis=-1), np.asarray(np.sum(checked, axis=-1), np.intp),
        np.einsum("...ka,...a->...k", axes, share),
    )  # fmt: skip


def suspects(
    problem: Problem, state: State, cofactors: Cofactors, kind: Kind = "groups", known: ResidualCofactors | None = None
) -> list[Suspects]:
    """Give all suspects of a kind.

    Parameters
    ----------
    problem, state, cofactors
        Of a solution of least squares.
    kind : str
        "groups": image points (line and sample), positions (East and North) and heights of weighted control points;
        "coordinates": each of their coordinates alone; "points": a ground point with all its image points and its
        coordinates. The first two take 20 us each, the third 0.5 ms.
    known : ResidualCofactors, optional
        Those of the solution, if they were computed before.

    Returns
    -------
    list of Suspects
    """
    if kind == "points":
        return _whole_points(problem, state, cofactors)
    found = known or residual_cofactors(problem, state, cofactors)
    o, given = problem.observations, np.flatnonzero(problem.observed)
    rows = np.arange(len(o))
    scale = np.zeros((len(o), 2, 2))
    scale[:, 0, 0], scale[:, 1, 1] = -1.0 / o.sigma_line_px, -1.0 / o.sigma_sample_px  # v: adjusted minus observed
    image = (o.point, rows, residuals(problem, state), found.image)
    w = problem.control_weights(given)
    at = problem.control_records[given, POINT.place]
    columns = -w @ np.swapaxes(problem.axes(at + problem.origin_m), 1, 2)
    v = problem.control_residuals(state, given)
    control = (given, np.full(len(given), -1), v, found.control)
    east, north, up = problem.axis_names
    if kind == "coordinates":
        return [
            Suspects("line", "px line", *image, scale[:, :, :1]),
            Suspects("sample", "px sample", *image, scale[:, :, 1:]),
            Suspects("east", f"m {east}", *control, columns[:, :, :1]),
            Suspects("north", f"m {north}", *control, columns[:, :, 1:2]),
            Suspects("up", f"m {up}", *control, columns[:, :, 2:]),
        ]
    return [
        Suspects("image", "px line, sample", *image, scale),
        Suspects("position", f"m {east}, {north}", *control, columns[:, :, :2]),
        Suspects("height", f"m {up}", *control, columns[:, :, 2:]),
    ]


def _whole_points(problem: Problem, state: State, cofactors: Cofactors) -> list[Suspects]:
    """Ground points with all their rays and their coordinates, those of as many rows together."""
    rays = linearised(problem, state)
    few = problem.n_image_unknowns <= WHOLE_LIMIT
    of_images = cofactors.joint(tuple(range(problem.n_images)), ()) if few else None
    arguments = (a for extra in problem.block.extra for a in problem.extra_arguments(extra))
    tied = {a.index for a in arguments if not a.is_image}
    found: dict[int, list[tuple[int, Array, Array]]] = {}
    for j, rows in problem.rows_by_point():
        control = problem.control_residuals(state, j) if problem.observed[j] else None
        of_point = Rows(*(part[rows] for part in rays))
        v, b, g, columns, images = point_rows(problem, j, problem.observations.image[rows], of_point, control)
        g = g[:, : 3 * int(problem.active[j])]
        if j in tied:  # more than its rays and its coordinates determines it
            q = np.eye(len(v)) - _propagated(np.hstack([b, g]), cofactors.joint(images, (j,)))
        else:
            own = cofactors.joint(images, ()) if of_images is None else of_images[np.ix_(columns, columns)]
            q = _left_over(g, np.eye(len(v)) - _propagated(b, own))
        found.setdefault(len(v), []).append((j, v, q))
    return [
        Suspects(
            "point", "", np.array([j for j, _, _ in members]), np.full(len(members), -1),
            np.stack([v for _, v, _ in members]), np.stack([q for _, _, q in members]),
            np.tile(np.eye(size), (len(members), 1, 1)),
        )
        for size, members in sorted(found.items())
    ]  # fmt: skip


def _propagated(design: Array, cofactors: Array) -> Array:
    """Cofactors ``J Q J^T``."""
    return np.asarray(design @ cofactors @ design.T)


def _left_over(d_ground: Array, q: Array) -> Array:
    """Cofactors of what the ground point's own coordinates leave of residuals with cofactors q."""
    if not d_ground.shape[1]:
        return q
    free = np.linalg.qr(d_ground, mode="complete")[0][:, d_ground.shape[1] :]
    return np.asarray(free @ (free.T @ q @ free) @ free.T)


def point_rows(
    problem: Problem, j: int, image: Index, rays: Rows, control: Array | None
) -> tuple[Array, Array, Array, Index, tuple[int, ...]]:
    """Whitened residuals (m,) of a ground point j, its image points first, then its coordinates.

    With them Jacobians (m, u) and (m, 3), the places of the u columns among the unknowns of all images, and the images.
    ``rays`` are its image points in the images ``image`` (n,), ``control`` the residuals (3,) of its coordinates.
    """
    v, g = rays.residual.ravel(), rays.ground.reshape(2 * len(image), 3)
    b, columns, images = side_by_side(problem, image, rays.image)
    if control is not None:
        v, b = np.concatenate([v, control]), np.pad(b, ((0, 3), (0, 0)))
        g = np.vstack([g, problem.control_weights(j)])
    return v, b, g, columns, images
