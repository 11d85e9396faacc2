"""Resection and space intersection with one side held fixed: robust start values, and points located afterwards.

Start values that resist many gross errors are least median or least trimmed squares,
image by image. Random subsets of 5 to 9 control points of **one image** give its
orientation by resection at the measured coordinates. The subset whose residuals have the
least median (LMS, Rousseeuw 1984) or the least trimmed sum (LTS) of squared lengths is
kept. A subset of the whole block must be free of gross errors in hundreds of
observations, a subset of an image in five only. Observations that fit the best subset
within 2.5 scales are adjusted again by least squares, with the scale::

    s = c (1 + 5 / (n - u)) sqrt(med),   c = 1.4826 in one dimension, 0.8493 for image points (median of chi2_2)

with n residuals and u unknowns that they determine. Images with too few control points
are oriented afterwards, from points that two oriented images locate. The sigmas of
control and located points are propagated to the image: whitening uses ``I + C Q C^T``.
The start of a ground point is the candidate with the least sum of squares, each limited
to 2.5 scales. Candidates are the intersections of pairs of rays and the measured
coordinates. (The least median is useless for a point with two rays, whose intersection
always fits.)

The number of subsets is chosen so that all of them contain gross errors with a
probability below 1 - :data:`CERTAINTY`, if :data:`SHARE` of the image points are wrong.

Check points outside the adjustment are located afterwards (:func:`locate_points`): the
whitened conditions of all rays are minimised over the three coordinates with the adjusted
orientation held fixed. The same Jacobians propagate image noise and orientation
cofactors: ``G = (A^T A)^-1 A^T``, ``Q = G (I + B Q_ee B^T) G^T``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.adjustment.cofactors import cofactors_of_points
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import CONTROL, IMAGE, inlier_limit
from fg_orient.adjustment.rows import image_rows, linearised, rows_by_image, whitened_records
from fg_orient.model.distributions import chi_square_median
from fg_orient.model.errors import InputError, finding

METHODS: Final = ("lms", "lts")
#: Probability of at least one subset without gross errors, and the share of wrong image points assumed.
CERTAINTY: Final = 0.999
SHARE: Final = 0.4
#: Smallest and largest number of image points of a subset; within these limits half the
#: number of determined unknowns is used.
SIZES: Final = (5, 9)
#: Minimum number of points of an image that are not in a subset and test it.
JUDGES: Final = 2
SEED: Final = 1984
#: Number of linearisations: at the metadata, and at the result of the first.
ROUNDS: Final = 2
#: Probability of the limit above which observations are excluded (2.5 sigmas in one dimension).
KEPT: Final = 0.98758
#: Maximum number of pairs of rays tried per ground point.
MOST_PAIRS: Final = 28


class Resection(NamedTuple):
    """Orientation of one image from its control points, or from points located by other images.

    Fields: the unknowns (u,) in prior sigmas, the image points used (n,) with a mask of
    those that fit, and the scale s in sigmas.
    """

    unknowns: Array
    rows: Index
    kept: npt.NDArray[np.bool_]
    scale: float


def subset_count(size: int, share: float = SHARE, certainty: float = CERTAINTY) -> int:
    """Return the number of random subsets of this size for this certainty (Rousseeuw & Leroy 1987)."""
    return math.ceil(math.log(1.0 - certainty) / math.log(1.0 - (1.0 - share) ** size))


def resection_start(compiled: Problem, method: str, seed: int = SEED) -> tuple[State, tuple[Resection, ...]]:
    """Return the start of a robust adjustment, and the resections of all images.

    ``method`` is "lms" or "lts", ``seed`` is the seed of the random subsets. InputError:
    images have too few control points and located points (all these images are named), or
    share unknowns.
    """
    if compiled.ties is not None:
        raise InputError.of("frame.shared_not", option="robust_start", value=method, id=", ".join(compiled.ties.ids))
    image = compiled.start.image
    for _ in range(ROUNDS):
        last = _Pass(compiled, image, method, seed)
        last.run()
        resections = tuple(last.resections[k] for k in range(compiled.n_images))
        image = compiled.image_matrix(np.concatenate([r.unknowns for r in resections]))
    ground, _ = last.located(compiled.active, np.ones(len(compiled.observations), bool))
    return State(image, ground), resections


class _Pass:
    """Resections of all images, linearised at given unknowns: first images with control, then their neighbours.

    ``known`` are control points and located points, ``cofactors`` (N, 3, 3) their cofactors, m^2.
    """

    def __init__(self, compiled: Problem, image: Array, method: str, seed: int) -> None:
        self.compiled, self.image, self.method, self.seed = compiled, image.copy(), method, seed
        self.rows = rows_by_image(compiled)
        self.ground, self.cofactors = compiled.start.ground.copy(), np.zeros((len(compiled.active), 3, 3))
        self.known = compiled.observed | ~compiled.active
        w = compiled.control_weights(compiled.observed)
        self.cofactors[compiled.observed] = np.linalg.inv(w.transpose(0, 2, 1) @ w)
        self.resections: dict[int, Resection] = {}

    @property
    def state(self) -> State:
        """Present state."""
        return State(self.image, self.ground)

    def run(self) -> None:
        """Resect all images; errors: see :func:`resection_start`."""
        o, least = self.compiled.observations, SIZES[0] + JUDGES
        while len(self.resections) < self.compiled.n_images:
            left = {k: own[self.known[o.point[own]]] for k, own in enumerate(self.rows) if k not in self.resections}
            ready = [k for k, own in left.items() if len(own) >= least]
            if not ready:
                ids = [image.id for image in self.compiled.block.images]
                raise InputError(
                    *(
                        finding("adjust.few_control", place=f"image {ids[k]}", value=len(own), least=least)
                        for k, own in left.items()
                    )
                )
            resected = {
                k: _resect(self.compiled, self.state, self.cofactors, k, left[k], self.method, self.seed) for k in ready
            }
            for k, resection in resected.items():
                self.image[k, : len(resection.unknowns)] = resection.unknowns
            self.resections |= resected
            self._locate()

    def _locate(self) -> None:
        """Locate the points measured in two oriented images."""
        o = self.compiled.observations
        usable = np.isin(o.image, list(self.resections))
        wanted = ~self.known & (np.bincount(o.point[usable], minlength=len(self.known)) >= 2)
        self.ground, cofactors = self.located(wanted, usable)
        self.cofactors[wanted] = cofactors[wanted]
        self.known |= wanted

    def located(self, wanted: npt.NDArray[np.bool_], usable: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return coordinates (N, 3), local m, with the least limited sum of squares of usable rays, and cofactors."""
        compiled, o = self.compiled, self.compiled.observations
        scale = max(1.0, float(np.median([r.scale for r in self.resections.values()])))
        v, _, c = linearised(compiled, self.state)
        mine = np.flatnonzero(usable & wanted[o.point])
        order, count = mine[np.argsort(o.point[mine], kind="stable")], np.bincount(o.point[mine], minlength=len(wanted))
        first, ground, cofactors = np.cumsum(count) - count, self.ground.copy(), np.zeros_like(self.cofactors)
        rng = np.random.default_rng([self.seed, compiled.n_images])
        for rays in np.unique(count[count > 0]):
            for observed in (False, True):
                points = np.flatnonzero((count == rays) & (compiled.observed == observed))
                if len(points):
                    own = order[first[points, None] + np.arange(rays)]
                    a = c[own].reshape(len(points), -1, 3)
                    w = compiled.control_weights(points) if observed else None
                    ground[points] += _located(v[own], c[own], w, scale, rng)
                    cofactors[points] = np.linalg.pinv(a.transpose(0, 2, 1) @ a, rcond=1e-12, hermitian=True)
        return ground, cofactors


def _resect(
    compiled: Problem, state: State, cofactors: Array, k: int, rows: Index, method: str, seed: int
) -> Resection:
    """Resect an image by known points, linearised at a state."""
    v, b = _whitened(compiled, state, cofactors, k, rows)
    x, prior = compiled.unknowns(state, k), compiled.block.options.priors
    determined = int(np.count_nonzero(np.linalg.svd(b.reshape(-1, b.shape[2]), compute_uv=False) >= 1.0))
    size = min(max(math.ceil(0.5 * determined), SIZES[0]), SIZES[1], len(rows) - JUDGES)
    subsets = _draw(len(rows), size, np.random.default_rng([seed, k]))
    best = _best(v, b, x, prior, subsets, method)
    n, h = 2 * len(rows), _half(len(rows), size)
    squares = _squares(v, b, best)
    median = float(np.partition(squares, h - 1)[h - 1])
    scale = (1.0 + 5.0 / max(n - determined, 1)) * math.sqrt(median / float(chi_square_median(IMAGE)))
    kept = squares <= (inlier_limit(KEPT, IMAGE) * max(scale, 1.0)) ** 2
    final = _fit(v[None, kept], b[None, kept], x, prior)[0]
    return Resection(x + final, rows, kept, scale)


def _whitened(compiled: Problem, state: State, cofactors: Array, k: int, rows: Index) -> tuple[Array, Array]:
    """Return the residuals (n, 2) and Jacobians (n, 2, u), in sigmas of image point and known point together."""
    v, b, c = image_rows(compiled, state, k, rows, jacobian=True)
    total = np.eye(2) + c @ cofactors[compiled.observations.point[rows]] @ c.transpose(0, 2, 1)
    inverse = np.linalg.inv(np.linalg.cholesky(total))
    return np.einsum("nij,nj->ni", inverse, v), inverse @ b


def _draw(n: int, size: int, rng: np.random.Generator) -> Index:
    """Return random subsets (m, size) of n, or all subsets if there are not more."""
    m = subset_count(size)
    if math.comb(n, size) <= m:
        return np.array(list(combinations(range(n), size)), dtype=np.intp)
    return np.argsort(rng.random((m, n)), axis=1)[:, :size]


def _fit(v: Array, b: Array, x: Array, prior: bool) -> Array:
    """Solve m least-squares problems: steps (m, u) from x, residuals (m, n, 2), Jacobians (m, n, 2, u)."""
    m, u = len(b), b.shape[-1]
    a, right = b.reshape(m, -1, u), v.reshape(m, -1)
    normal, g = np.einsum("mru,mrw->muw", a, a), -np.einsum("mru,mr->mu", a, right)
    if prior:
        return np.asarray(np.linalg.solve(normal + np.eye(u), (g - x)[..., None])[..., 0])
    return np.asarray(np.einsum("muw,mw->mu", np.linalg.pinv(normal, rcond=1e-12, hermitian=True), g))


def _squares(v: Array, b: Array, step: Array) -> Array:
    """Return the squared lengths of the residuals after steps (..., u): (..., n)."""
    return np.asarray(np.sum((v + np.einsum("nru,...u->...nr", b, step)) ** 2, axis=-1))


def _half(n: int, size: int) -> int:
    """Return how many of n observations must fit: the majority as defined by Rousseeuw & Leroy (1987)."""
    return min((n + size + 1) // 2, n)


def _best(v: Array, b: Array, x: Array, prior: bool, subsets: Index, method: str) -> Array:
    """Return the step of the best subset."""
    steps = _fit(v[subsets], b[subsets], x, prior)
    h = _half(len(v), subsets.shape[1])
    ordered = np.sort(_squares(v, b, steps), axis=1)[:, :h]
    return np.asarray(steps[np.argmin(ordered[:, -1] if method == "lms" else ordered.sum(axis=1))])


def _located(v: Array, c: Array, w: Array | None, scale: float, rng: np.random.Generator) -> Array:
    """Return steps (m, 3) of m points from residuals (m, r, 2), Jacobians (m, r, 2, 3), and weights of coordinates."""
    m, r = v.shape[:2]
    candidates = [] if w is None else [np.zeros((m, 3))]
    pairs = list(combinations(range(r), 2))
    if len(pairs) > MOST_PAIRS:
        pairs = [pairs[i] for i in rng.choice(len(pairs), MOST_PAIRS, replace=False)]
    for pair in pairs:
        a, right = c[:, pair].reshape(m, 4, 3), v[:, pair].reshape(m, 4)
        inverse = np.linalg.pinv(np.einsum("mri,mrj->mij", a, a), rcond=1e-12, hermitian=True)
        candidates.append(-np.einsum("mij,mrj,mr->mi", inverse, a, right))
    if not candidates:
        return np.zeros((m, 3))
    steps = np.stack(candidates, axis=1)
    squares = np.sum((v[:, None] + np.einsum("mrij,mpj->mpri", c, steps)) ** 2, axis=-1)
    cost = np.minimum(squares, (scale * inlier_limit(KEPT, IMAGE)) ** 2).sum(axis=-1)
    if w is not None:
        own = np.sum(np.einsum("mij,mpj->mpi", w, steps) ** 2, axis=-1)
        cost += np.minimum(own, (scale * inlier_limit(KEPT, CONTROL)) ** 2)
    return np.asarray(steps[np.arange(m), np.argmin(cost, axis=1)])


MAX_STEPS = 10
STEP_M = 1e-6


@dataclass(frozen=True)
class LocatedPoints:
    """Ground points ``index`` (n,) located with the image unknowns of a state held fixed.

    ``problem`` contains all their rays, and only these points are unknowns. ``lost`` (m,)
    are points without coordinates: their steps do not converge, because their rays hardly
    intersect.
    """

    problem: Problem
    state: State
    index: Index
    lost: Index

    @property
    def ground_m(self) -> Array:
        """Coordinates (n, 3), ECEF m."""
        return np.asarray(self.state.ground[self.index] + self.problem.origin_m)

    def cofactors(self, blocks: Callable[[Index], Array]) -> Array:
        """Return the cofactors (n, 3, 3) m^2 from joint cofactors of the images.

        See ``cofactors_of_points``.
        """
        return cofactors_of_points(self.problem, self.state, self.index, blocks)


def locate_points(problem: Problem, state: State, start_m: Array, index: Index) -> LocatedPoints:
    """Locate ground points from all their rays, each by separate Gauss-Newton steps.

    Parameters
    ----------
    problem : Problem
    state : State
        State whose image unknowns are used.
    start_m : (N, 3) array
        Coordinates ECEF m near the points; they also define the weights. Other rows are ignored.
    index : (n,) int array
        Ground points, each measured in two or more images.
    """
    wanted = np.zeros(len(problem.active), bool)
    wanted[index] = True
    seen = problem.block.observations.take(wanted[problem.block.observations.point])
    records = whitened_records(problem.models, seen, start_m, problem.origin_m)
    own = replace(problem, observations=seen, records=records, active=wanted, observed=np.zeros_like(wanted))
    place = np.cumsum(wanted)[seen.point] - 1
    ground, ascending, rows = start_m - problem.origin_m, np.flatnonzero(wanted), rows_by_image(own)
    moving = np.ones(len(ascending), bool)
    for _ in range(MAX_STEPS):
        step = _steps(own, State(state.image, ground), rows, place, len(ascending))
        ground[ascending[moving]] -= step[moving]
        moving &= np.abs(step).max(axis=1) >= STEP_M
        if not moving.any():
            break
    lost = ascending[moving]
    wanted[lost] = False
    keep = wanted[seen.point]
    own = replace(own, observations=seen.take(keep), records=records[keep], active=wanted)
    return LocatedPoints(own, State(state.image, ground), index[wanted[index]], lost)


def _steps(problem: Problem, state: State, rows: list[Index], place: Index, n: int) -> Array:
    """Return the Gauss-Newton steps (n, 3) of the points; ``place``: index of each ray's point among them."""
    normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for k, own in enumerate(rows):
        value, _, d_ground = image_rows(problem, state, k, own, jacobian=True)
        np.add.at(normal, place[own], np.einsum("nri,nrj->nij", d_ground, d_ground))
        np.add.at(right, place[own], np.einsum("nri,nr->ni", d_ground, value))
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])
