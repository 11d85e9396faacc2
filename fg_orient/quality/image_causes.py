"""Likely causes of a doubt in image points: wrong pixel origin, wrong point ids.

With whitened residuals v of all rows, ``R = I - A Q A^T`` and an error e of the observations, ``v ~ -R e`` and the
unknowns move by ``Q A^T e``. The ground points are eliminated (``fg_orient.quality.elimination``): with F and A of each
point p and the cofactors Q of the images::

    b = sum_p A_p^T e_p,   e^T R e = sum_p e_p^T F_p e_p - b^T Q b,   dx = Q b,   dX_p = (G^T G)^-1 G^T (e_p - B_p dx)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import WHOLE_LIMIT
from fg_orient.adjustment.rows import Rows, linearised
from fg_orient.quality import hypotheses, mended
from fg_orient.quality.cause import PAIRED, Cause, penalty_of, without_parameter
from fg_orient.quality.elimination import PointRows, eliminated_points, free_cofactors, image_columns
from fg_orient.quality.residuals import ResidualCofactors
from fg_orient.quality.suspects import suspects

#: Maximum number of rays of a point whose partitions in two groups are tested.
MOST_RAYS: Final = 8
#: Maximum number of image points of a block whose image points are tested.
MOST_OBSERVED: Final = 20_000
#: Maximum number of images for which another origin of the pixels is tested image by image.
MOST_IMAGES: Final = 30
#: Tested differences between origins of pixels.
ORIGINS_PX: Final = (0.5, 1.0, -0.5, -1.0)


@dataclass(frozen=True, eq=False)
class ImageErrors:
    """Errors of image points and control points at a solution with eliminated ground points.

    Parameters
    ----------
    known : ResidualCofactors
    v : (q,) array
        Whitened residuals of all image points, then of all control points in East, North, Up.
    rows : Rows
        Rows of all image points.
    points : tuple of PointRows
    q : (u, u) array
        Cofactors of the unknowns of all images, shared ones once.
    """

    known: ResidualCofactors
    v: Array
    rows: Rows
    points: tuple[PointRows, ...]
    q: Array

    @classmethod
    def of(cls, known: ResidualCofactors) -> ImageErrors | None:
        """Return the errors at a solution; None for large blocks, and if extra observations name points."""
        problem = known.problem
        large = len(problem.observations) > MOST_OBSERVED or problem.n_image_unknowns > WHOLE_LIMIT
        if large or problem.named_points():
            return None
        rows = linearised(problem, known.state)
        v = np.concatenate([known.v_image.ravel(), known.v_control.ravel()])
        return cls(known, v, rows, tuple(eliminated_points(problem, rows, groups=1)),
                   free_cofactors(problem, known.cofactors.joint, []))  # fmt: skip

    def normal(self, error: Array, points: Index) -> tuple[Array, Array, Array]:
        """Return ``-e^T v`` (p,), ``e^T R e`` (p, p) and movements (n, 3, p) m of points, for errors e (q, p)."""
        size, b = error.shape[1], np.zeros((len(self.q), error.shape[1]))
        own = np.zeros((size, size))
        for part in self.points:
            e = error[part.rows]
            touched = np.flatnonzero(e.any(axis=(1, 2)))
            if len(touched):
                free = part.free[touched] @ e[touched]
                own += np.einsum("nrp,nrs->ps", e[touched], free, optimize=True)
                turned = np.swapaxes(part.design[touched], 1, 2) @ e[touched]
                np.add.at(b, part.columns[touched].ravel(), turned.reshape(-1, size))
        moved = self.q @ b
        return -error.T @ self.v, own - b.T @ moved, self._of_points(error, moved, points)

    def _of_points(self, error: Array, moved: Array, points: Index) -> Array:
        """Return movements (n, 3, p) of ground points caused by errors and by movements (u, p) of the images."""
        problem, o = self.known.problem, self.known.problem.observations
        out = np.zeros((len(points), 3, error.shape[1]))
        wide = moved[image_columns(problem, o.image)]
        left = error[: 2 * len(o)].reshape(len(o), 2, -1) - np.einsum("nij,njp->nip", self.rows.image, wide)
        normal = problem.point_normals(o.point, self.rows.ground)
        for k, j in enumerate(points.tolist()):
            mine = np.flatnonzero(o.point == j)
            right = np.einsum("nri,nrp->ip", self.rows.ground[mine], left[mine])
            out[k] = np.linalg.solve(normal[j], right)
        return out

    def shifted(self, images: tuple[int, ...], shift_px: float) -> Array:
        """Return the whitened error (q,) of a shift of line and sample of all image points of some images."""
        o, out = self.known.problem.observations, np.zeros(len(self.v))
        mine = np.isin(o.image, images)[:, None]
        out[: 2 * len(o)] = np.where(
            mine, shift_px / np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1), 0.0
        ).ravel()
        return out

    def split(self, points: Index) -> Iterator[tuple[int, tuple[int, ...], Array, Array]]:
        """Yield partitions of the rays of a point into two groups that see different places.

        Each group determines its place.

        Each result contains the point, the images of the group without coordinates, and ``-E^T v`` (3,) and ``E^T R E``
        (3, 3) of its distance from the other place in metres.
        """
        o = self.known.problem.observations
        for part in self.points:
            wanted = np.flatnonzero(np.isin(part.point, points)).tolist()
            cofactors = part.free - part.quadratic(self.q) if wanted else part.free
            for k in wanted:
                j = int(part.point[k])
                rays = part.rows[k, : 2 * int(np.count_nonzero(o.point == j)) : 2] // 2
                v = self.v[part.rows[k]]
                for group in _groups(len(rays), bool(self.known.problem.observed[j])):
                    e = np.zeros((len(v), 3))
                    for ray in group:
                        e[2 * ray : 2 * ray + 2] = self.rows.ground[rays[ray]]
                    yield j, tuple(o.image[rays[list(group)]].tolist()), -e.T @ v, e.T @ cofactors[k] @ e


def _groups(n: int, is_control: bool) -> Iterator[tuple[int, ...]]:
    """Yield groups of two or more of n rays. Two other rays, or one ray and control coordinates, must remain."""
    if n > MOST_RAYS:
        return
    for size in range(2, n - (1 if is_control else 2) + 1):
        for group in combinations(range(n), size):
            # for a tie point, both groups of a partition would give the same result, so only one is used
            if is_control or 0 not in group:
                yield group


def image_causes(errors: ImageErrors, normal: Callable[[Array], tuple[Array, Array]]) -> Iterator[Cause]:
    """Yield other pixel origins, and two points under one id; ``normal``: see :meth:`GroundErrors.image_normal`."""
    problem = errors.known.problem
    ids, names, m = problem.block.points.ids, [image.id for image in problem.block.images], problem.n_images
    groups = [tuple(range(m)), *([(k,) for k in range(m)] if 1 < m <= MOST_IMAGES else [])]
    cases = [(group, shift) for group in groups for shift in ORIGINS_PX]
    g, square = normal(np.stack([errors.shifted(*case) for case in cases], axis=1))
    for (group, shift), gain in zip(cases, (2.0 * g - np.diag(square)).tolist(), strict=True):
        of = "all images" if len(group) == m else f"image {names[group[0]]}"
        yield without_parameter(
            f"another origin of the pixels of {of}: lines and samples are {abs(shift):g} px too "
            f"{'large' if shift > 0 else 'small'}",
            gain,
            "look at the origin of lines and samples in the table",
            "origin",
            partial(mended.with_shifted_pixels, images=group, shift_px=(-shift, -shift)),
        )
    penalty = penalty_of(problem)
    for j, group, g, square in errors.split(_worst_points(errors.known)):
        t, p, distance = hypotheses.quadratic(g, square)
        if p == 3:
            seen = ", ".join(names[k] for k in group)
            yield Cause(
                f"two points under the id {ids[j]}: images {seen} show another one, "
                f"{float(np.linalg.norm(distance)):.2f} m away",
                "give one of them its own id",
                float(t),
                3,
                float(t - 3 * penalty),
                "split",
                partial(mended.with_split_point, point=j, images=group),
            )


def single_rays(known: ResidualCofactors) -> Iterator[Cause]:
    """Yield the errors of single image points."""
    image, penalty = suspects(known)[0], penalty_of(known.problem)
    t, d, _ = image.quadratic()
    for j, gain, free in zip(image.point.tolist(), t.tolist(), d.tolist(), strict=True):
        if free:
            name = known.problem.block.points.ids[j]
            yield Cause("image points", "", gain, free, gain - free * penalty, "single", point=name)


def _worst_points(residuals: ResidualCofactors) -> Index:
    """Return the ground points with the largest errors, tested with all their observations.

    Only a few of a large block.
    """
    squares = np.zeros(len(residuals.problem.active))
    for family in suspects(residuals, "points"):
        squares[family.point] = family.quadratic()[0]
    return np.argsort(squares)[::-1][:PAIRED]
