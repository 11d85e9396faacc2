"""Rejection of image points as in ISIS jigsaw: by the median of the residuals, after each iteration.

After each Gauss-Newton step the limit is the median of the residuals of the image points in use, plus a
multiple of 1.4826 times their median absolute deviation. A residual is the length of line and sample. A
rejected image point is used again when its residual is below the limit. In each ground point the largest
residual above the limit is rejected, if two image points or more remain. The rule has no level of
significance, and its result depends on the start values. ``fg_orient.orientation.outlier_search`` avoids both
disadvantages. The rule is provided for comparisons with jigsaw.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.adjustment.named_points import NamedBackend
from fg_orient.adjustment.problem import Problem, State, compile_problem, participates
from fg_orient.adjustment.robust import FixedWeights
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.model.block import Block
from fg_orient.model.distributions import MAD
from fg_orient.model.errors import Finding, NoSolutionError, finding

#: Weight of a rejected image point: its effect is below rounding.
OUT: Final = 1e-20
#: The iterations end when sigma0 changes by less than this, as in jigsaw, and no image point changes.
SIGMA0: Final = 1e-10


def without_rejected(block: Block, multiplier: float) -> tuple[Block, tuple[str, ...]]:
    """Return the block without the rejected image points, and their names.

    Raises
    ------
    NoSolutionError
        The set of rejected image points still changes after ``max_iterations``.
    """
    problem = compile_problem(block)
    out = _rejected(problem, multiplier)
    if not out.any():
        return block, ()
    o = problem.observations
    ids, images = block.points.ids, [image.id for image in block.images]
    names = [f"{ids[o.point[k]]} in {images[o.image[k]]}" for k in np.flatnonzero(out).tolist()]
    part = participates(block)
    keep = np.ones(len(part), bool)
    keep[np.flatnonzero(part)[out]] = False
    return replace(block, observations=block.observations.take(keep)), tuple(names)


def rejection_finding(names: tuple[str, ...], total: int) -> Finding:
    """Return a warning that names the rejected image points; ``total`` counts all image points."""
    return finding(
        "search.median (warning): the median rule of jigsaw rejected {n} of {total} image points: {names:5}"
        " -> compare with <snoop>, whose tests have a level of significance",
        n=len(names),
        total=total,
        names=names,
    )


def _rejected(problem: Problem, multiplier: float) -> Mask:
    """Return True for the rejected image points (n,) of a problem."""
    backend: Any = (NamedBackend if problem.named_points() else SchurBackend)(problem)
    order = slice(None) if isinstance(backend, NamedBackend) else backend.structure.row
    state, out, before = problem.start, np.zeros(len(problem.observations), bool), np.inf
    for _ in range(problem.block.options.max_iterations):
        weights = np.where(out, OUT, 1.0)
        backend.robust = FixedWeights(weights[order], np.ones(int(problem.observed.sum())))
        system = backend.linearise(state)
        state = _along_sphere(problem, state, backend.retract(state, system.solve(0.0)))
        latest = flagged(problem, problem.pixel_residuals(state), out, multiplier)
        sigma0 = _sigma0(problem, backend, state, out)
        if abs(sigma0 - before) <= SIGMA0 and (latest == out).all():
            return out
        out, before = latest, sigma0
    raise NoSolutionError.of("search.restless", place="image points", value=problem.block.options.max_iterations)


def _along_sphere(problem: Problem, before: State, after: State) -> State:
    """Return the state after moving points by the same steps of longitude, latitude and radius, as jigsaw does.

    In a normal adjustment the points move along straight lines. Both lead to the same minimum, but the
    rejection depends on the path.
    """
    if problem.block.body is None:
        return after
    ground, rows = after.ground.copy(), np.flatnonzero(problem.active)
    start = before.ground[rows] + problem.origin_m
    east, north, up = np.einsum("nij,nj->in", problem.axes(start), after.ground[rows] - before.ground[rows])
    x, y, z = start.T
    flat, radius = np.hypot(x, y), np.linalg.norm(start, axis=1)
    lon, lat, radius = np.arctan2(y, x) + east / flat, np.arctan2(z, flat) + north / radius, radius + up
    out = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    ground[rows] = radius[:, None] * np.stack(out, axis=1) - problem.origin_m
    return State(after.image, ground)


def _sigma0(problem: Problem, backend: Any, state: State, out: Mask) -> float:
    """Return the standard deviation of unit weight without the rejected image points."""
    return float(np.sqrt(2.0 * backend.error(state) / max(problem.redundancy - 2 * int(out.sum()), 1)))


def flagged(problem: Problem, residuals_px: Array, out: Mask, multiplier: float) -> Mask:
    """Return the rejected image points (n,) after an iteration in which ``out`` were rejected; residuals in px."""
    size, point = np.hypot(*residuals_px.T), problem.observations.point
    middle = np.median(size[~out])
    limit = middle + multiplier * MAD * np.median(np.abs(size[~out] - middle))
    latest: Mask = np.asarray(out & (size > limit))
    left = np.bincount(point[~latest], minlength=len(problem.active))
    above = np.flatnonzero(~latest & (size > limit) & (left[point] > 2))
    worst = above[np.argsort(size[above], kind="stable")]
    # dict keeps the last value of each key: the image point with the largest residual of the ground
    # point
    largest = dict(zip(point[worst].tolist(), worst.tolist(), strict=True))
    latest[list(largest.values())] = True
    return latest
