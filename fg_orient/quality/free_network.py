"""Free networks: inner constraints and S-transformations.

The Jacobian of a network without control has a null space E: motions without effect on the observations. One constraint
per motion, ``E^T D (x - x_0) = 0``, selects one solution; the diagonal matrix D selects the unknowns of the datum. All
choices have the same residuals and the same shape, and each follows from any other by an S-transformation (Baarda
1973)::

    S = I - E (E^T D E)^-1 E^T D,    x_D = x_0 + S (x - x_0),    Q_D = S Q S^T

With all unknowns in D this is the solution of the pseudo-inverse, with the least trace of Q (Meissl 1962). With some
unknowns, the trace of their part of Q is least (Koch 1999, 3.3).

The adjustment uses a minimal datum: d image unknowns, one per motion, are each observed once. Pivoting
selects them so that the datum is well conditioned. These observations get no residual, so shape and
residuals are the same as in the free network. Every backend then solves regular equations, and no
factor connects more variables. (Inner constraints as factors would connect all points.) A motion is not
linear, so the state is moved to the requested datum in several steps, with an adjustment after each.
The cofactors come from the border of the normal equations (``fg_orient.adjustment.border``). Only
requested elements are transformed.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.linalg import qr

from factors._contract import Argument, Equation
from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.border import border_of
from fg_orient.adjustment.border_matrix import BorderMatrix
from fg_orient.adjustment.cofactors import (
    Datum,
    DenseUnknowns,
    RayCofactors,
    SpreadUnknowns,
    Star,
    UnknownCofactors,
    cofactors_of_rays,
    places_of_images,
    places_of_points,
    rays_of_star,
)
from fg_orient.adjustment.constraints import undamped
from fg_orient.adjustment.dense import DenseSystem
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import weighted_problem
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.errors import InputError, finding
from fg_orient.quality.cofactors import BorderCofactors, Cofactors, MatrixCofactors, StarCofactors, places_of
from fg_orient.quality.covariance import Indeterminate, NamedMatrix
from fg_orient.quality.elimination import UNOBSERVABLE, followed_by_ground, reduced_rows, spectrum
from fg_orient.quality.structure import analyse_structure
from fg_orient.quality.weakest import weakest

#: Maximum number of unknowns for which all cofactors of a free network are formed from GTSAM's
#: cofactors.
MAX_UNKNOWNS: Final = 3000
#: A datum is reached if the step is below this, in prior sigmas and metres.
REACHED: Final = 1e-9
#: Maximum number of steps to the datum. A linearised motion changes the residuals to second order, so a
#: Gauss-Newton step across the motions follows each step. In a well-determined network both converge
#: quadratically.
MAX_STEPS: Final = 60
_LABEL: Final = "minimal datum"


def _residual(record: Any, setup: Any, x: Any) -> Any:
    """Return ``(x - x_0) w`` of the unknowns with the numbers of the record."""
    return (x[record.astype(np.intp)] - setup[0]) * setup[1]


def _kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    jacobian = np.eye(len(x))[record.astype(np.intp)] * setup[1][:, None] if want else np.empty((0, 0))
    return _residual(record, setup, x), jacobian


#: Observation of some unknowns of an image. Each has the weight that its own image points give it, because a
#: small weight would only damp the steps, as in Levenberg-Marquardt.
HELD_UNKNOWNS: Final = Equation(
    "held_unknowns",
    _kernel,
    _residual,
    (Argument("x", "prior sigma"),),
    "minimal datum of a free network",
)


@dataclass(frozen=True)
class Motions:
    """Motions that do not change the observations.

    Parameters
    ----------
    whole : (n, d) array
        Image unknowns in prior sigmas, then unknown points in m; orthonormal in the image unknowns (shared ones once).
    border : BorderMatrix or None
        Border of the normal equations with its null space; None if the border does not determine the points.
    """

    whole: Array
    border: BorderMatrix | None


def motions_of(problem: Problem, state: State, near: BorderMatrix | None = None) -> Motions:
    """Compute the motions at a state; the minimal datum is not an observation.

    ``near``: border at a neighbouring state.
    """
    problem = _holding(problem, np.zeros(0, np.intp))
    with one_blas_thread():
        with contextlib.suppress(Singular):
            border = border_of(problem, state) if near is None else near.at(state)
            if border is not None:
                start = None if near is None else near.moves
                found = weakest(border, UNOBSERVABLE, analyse_structure(problem).n_parts, start)
                border.moves = found.directions
                return Motions(_widened(problem, border.images_of(found.directions), found.ground), border)
        rows = linearised(problem, state)
        s, vt = spectrum(reduced_rows(problem, rows, state))
        moves = np.asarray(vt[s <= UNOBSERVABLE].T)
        wide = moves if problem.ties is None else problem.ties.widened(moves)
        return Motions(_widened(problem, moves, followed_by_ground(problem, rows, wide)), None)


def _widened(problem: Problem, moves: Array, ground: Array) -> Array:
    """Assemble motions (n, d) from motions of the free image unknowns (z, d) and of the points (N, 3, d)."""
    wide = moves if problem.ties is None else problem.ties.widened(moves)
    own = ground[problem.active]
    return np.vstack([wide, own.reshape(3 * len(own), moves.shape[1])])


def _of_border(border: BorderMatrix, moves: Array) -> Array:
    """Assemble motions (n, d) from the motions of the border (b, d)."""
    return _widened(border.problem, *border.movements(moves))


def without_priors(block: Block) -> Block:
    """Return the block without prior observations, which would fix the network."""
    return replace(block, options=replace(block.options, priors=False))


def with_minimal_datum(problem: Problem, null: Array) -> Problem:
    """Hold one image unknown per motion at its start value; motions (z, d) of the unknowns, shared unknowns once."""
    motions = null if problem.ties is None else problem.ties.widened(null)
    d = motions.shape[1]
    chosen = np.sort(qr(motions.T, mode="r", pivoting=True)[1][:d]) if d else np.zeros(0)
    return _holding(problem, chosen.astype(np.intp))


def _holding(problem: Problem, chosen: Index) -> Problem:
    """Hold only these image unknowns (d,) by observations."""
    held = []
    for k, image in enumerate(problem.block.images):
        own = chosen[(chosen >= problem.first[k]) & (chosen < problem.first[k + 1])] - problem.first[k]
        if len(own):
            rays = np.flatnonzero(problem.observations.image == k)
            weight = np.linalg.norm(linearised(problem, problem.start, rays).image[:, :, own], axis=(0, 1))
            setup = np.stack([problem.unknowns(problem.start, k)[own], np.maximum(weight, 1.0)])
            held.append(
                ExtraObservation(
                    HELD_UNKNOWNS,
                    (f"image:{image.id}",),
                    own.astype(float),
                    setup,
                    len(own),
                    f"{_LABEL} of image {image.id}",
                )
            )
    others = tuple(e for e in problem.block.extra if e.equation is not HELD_UNKNOWNS)
    return replace(problem, block=replace(problem.block, extra=(*others, *held)))


def held_unknowns(problem: Problem) -> Index:
    """Select image unknowns (d,) that are held for the minimal datum, one per motion."""
    held = [
        problem.first[problem.block.image_index(e.unknowns[0].removeprefix("image:"))] + e.record.astype(np.intp)
        for e in problem.block.extra
        if e.equation is HELD_UNKNOWNS
    ]
    return np.concatenate([np.zeros(0, np.intp), *held])


def to_inner_datum(
    problem: Problem, estimate: Estimate, run: Callable[[Problem], Estimate]
) -> tuple[Problem, Estimate]:
    """Transform a minimally constrained adjustment to inner constraints on its ground points.

    Parameters
    ----------
    problem : Problem
        Problem with its minimal datum; the constraints refer to the coordinates of its start.
    estimate : Estimate
    run : callable
        Function that adjusts a problem from its start.

    Returns
    -------
    The problem with its minimal datum at the values of the result; the estimate, not converged if the datum is not
    reached.
    """
    chosen, reference, state = held_unknowns(problem), problem.vector(problem.start), estimate.state
    weighted = problem if estimate.weights is None else weighted_problem(problem, estimate.weights)
    datum, near, size = datum_points(problem), None, math.inf
    for _ in range(MAX_STEPS):
        motions = motions_of(weighted, state, near)
        if not len(chosen) or not estimate.converged:
            break
        near, before, least = motions.border, size, state
        if near is not None:
            try:
                with one_blas_thread():
                    least = near.newton()
            except Singular:  # the step to the datum was so large that the network diverged
                estimate = replace(estimate, converged=False, end=finding("loop.free_datum"))
                break
        size = float(np.abs(problem.vector(least) - problem.vector(state)).max())
        step = datum_step(problem.vector(least) - reference, motions.whole, datum)
        state = problem.moved(least, step)
        settled = size < REACHED or (before < math.inf and size**2 < REACHED * before)
        if settled and np.abs(step).max() < REACHED:
            break
        if near is None:
            state = run(_holding(undamped(replace(problem, start=state)), chosen)).state
    else:
        estimate = replace(estimate, converged=False, end=finding("loop.free_datum"))
        motions = motions_of(weighted, state, near)
    held = _holding(replace(problem, start=state), chosen)
    if motions.border is None or isinstance(estimate.linear, DenseSystem):
        estimate = replace(estimate, state=state, linear=run(replace(undamped(held), start=state)).linear)
    else:
        estimate = replace(estimate, state=state, linear=motions.border)
    return replace(held, start=problem.start), estimate


def datum_points(problem: Problem, names: tuple[str, ...] = ()) -> Mask:
    """Select the unknowns (n,) of a datum: of named images and ground points, or of all ground points.

    InputError: unknown image or point, or a point that is not an unknown.
    """
    out = np.zeros(problem.n_columns, bool)
    if not names:
        out[problem.n_image_unknowns :] = True
    for name in names:
        place = problem.block.find(name)
        if place is None:
            raise InputError.of("covariance.no_such", option="datum", value=name)
        kind, k = place
        if kind != "image" and not problem.active[k]:
            raise InputError.of("covariance.not_unknown", option="datum", value=name)
        out[problem.image_slice(k) if kind == "image" else problem.point_slice(k)] = True
    return out


@dataclass(frozen=True, eq=False)
class FreeNetwork:
    """A free network in one datum, with its cofactors (``fg_orient.quality.cofactors.Cofactors``).

    With the size ``A = (E^T D E)^-1 E^T D`` of each motion and the cofactors Q of any datum

        S Q S^T = Q - E (A Q) - (A Q)^T E^T + E (A Q A^T) E^T,

    Only the requested elements are formed.

    Parameters
    ----------
    problem : Problem
        Problem with its minimal datum.
    given : MatrixCofactors, BorderCofactors or StarCofactors
        Cofactors in another datum.
    state : State
    null_space : (n, d) array
        Motions at the state; unknowns of all images in prior sigmas, then of all unknown points in m.
    datum : (n,) bool array
        Unknowns of the datum.
    """

    problem: Problem
    given: MatrixCofactors | BorderCofactors | StarCofactors
    state: State
    null_space: Array
    datum: Mask

    @classmethod
    def of(cls, problem: Problem, state: State, given: Cofactors) -> FreeNetwork:
        """Apply inner constraints on the ground points to a solution and its cofactors in another datum.

        Indeterminate is raised for more than 3000 unknowns where only GTSAM determines them.
        """
        with one_blas_thread():
            if isinstance(given, BorderCofactors | StarCofactors):
                motions = _of_border(given.border, given.border.moves)
            else:
                motions = motions_of(problem, state).whole
            if not isinstance(given, MatrixCofactors | BorderCofactors | StarCofactors):
                if problem.n_unknowns > MAX_UNKNOWNS:
                    raise Indeterminate(
                        f"the free network has {problem.n_unknowns} unknowns that only GTSAM's QR "
                        f"determines; all its cofactors are formed up to {MAX_UNKNOWNS}"
                    )
                every = given.joint(tuple(range(problem.n_images)), tuple(np.flatnonzero(problem.active).tolist()))
                given = MatrixCofactors(problem, every)
            return cls(problem, given, state, motions, datum_points(problem))

    @cached_property
    def _moved(self) -> Datum:
        """Transformation to the datum: ``A``, with ``W = Q A^T`` and ``C = A Q A^T``."""
        a = _coordinates(self.null_space, self.datum)
        qa = self.given.times(a.T)
        return Datum(np.pad(self.null_space, ((0, 1), (0, 0))), np.pad(qa, ((0, 1), (0, 0))), a @ qa)

    def _in_datum(self, q: Array, rows: Index, columns: Index) -> Array:
        """See :meth:`Datum.elements`."""
        return self._moved.elements(q, rows, columns) if self.datum_defect else q

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        if self._star is None:
            return self.joint((k,), ())
        size = len(self.problem.parameters[k])
        return self._star.images[k, :size, :size]

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((), (j,)) if self.problem.active[j] else np.zeros((3, 3))

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        at = places_of_points(self.problem, index)
        return self._in_datum(self.given.points(index), at, at)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        index = places_of(self.problem, images, points)
        return self._in_datum(self.given.joint(images, points), index, index)

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        place = places_of_images(self.problem)
        return self._in_datum(self.given.blocks(pairs), place[pairs[:, 0]], place[pairs[:, 1]])

    def unknowns(self, places: Index) -> UnknownCofactors:
        """See :class:`Cofactors`."""
        given, d = self.given.unknowns(places), self.datum_defect
        if not isinstance(given, SpreadUnknowns):
            return DenseUnknowns(self._in_datum(given.matrix, places, places))
        e, w, aqa = self._moved
        core = np.block([[aqa, -np.eye(d)], [-np.eye(d), np.zeros((d, d))]])
        return given.changed(np.hstack([e[places], w[places]]), core)

    def star(self) -> Star | None:
        """See :class:`Cofactors`."""
        return self._star

    @cached_property
    def _star(self) -> Star | None:
        star, problem = self.given.star(), self.problem
        if star is None:
            return None
        place, points = places_of_images(problem), places_of_points(problem, np.flatnonzero(problem.active))
        return Star(
            self._in_datum(star.images, place, place),
            self._in_datum(star.across, place, points.ravel()),
            self._in_datum(star.points, points, points),
        )

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See :class:`Cofactors`."""
        if self._star is not None:
            return rays_of_star(problem, state, self._star)
        return cofactors_of_rays(problem, state, self.given.blocks, self._moved if self.datum_defect else None)

    @cached_property
    def cofactors(self) -> Array:
        """Cofactors (n, n) of all unknowns, columns as in ``Problem.vector``."""
        every = tuple(np.flatnonzero(self.problem.active).tolist())
        return self.joint(tuple(range(self.problem.n_images)), every)

    @property
    def datum_defect(self) -> int:
        """Number of motions without effect on the observations."""
        return int(self.null_space.shape[1])

    def in_datum(self, *names: str) -> FreeNetwork:
        """Transform to the datum of images ("image:3") and points ("point:12"); without names: of all points.

        The state is moved along the motions at the solution. This is exact to first order: the movement is a few sigmas
        of the start values, and the shape changes by its square. InputError: names are unknown, or too few for all
        motions.
        """
        problem, datum = self.problem, datum_points(self.problem, names)
        difference = problem.vector(self.state) - problem.vector(problem.start)
        state = problem.moved(self.state, datum_step(difference, self.null_space, datum))
        return FreeNetwork(problem, self.given, state, self.null_space, datum)

    def cofactor_matrix(self) -> NamedMatrix:
        """Return the cofactors of all unknowns in physical units: m, m/s, rad, px for images, m for points."""
        problem = self.problem
        ids = [problem.block.points.ids[j] for j in np.flatnonzero(problem.active)]
        names = [f"{i.id}.{n}" for i, p in zip(problem.block.images, problem.parameters, strict=True) for n in p.names]
        names += [f"{name}.{axis}" for name in ids for axis in "xyz"]
        units = [u for p in problem.parameters for u in p.units] + ["m"] * (3 * len(ids))
        scale = np.concatenate([*(p.sigma for p in problem.parameters), np.ones(3 * len(ids))])
        return NamedMatrix(tuple(names), tuple(units), self.cofactors * np.outer(scale, scale))


# --- S-transformations ----------------------------------------------------------------------------

#: Maximum condition number of the motions, restricted to the unknowns of a datum that fixes them.
FIXES: Final = 1e8


def datum_step(difference: Array, null_space: Array, select: Mask) -> Array:
    """Return the step ``(S - I) (x - x_0)`` along the motions to the datum (parameters: :func:`s_transform`)."""
    return np.asarray(-null_space @ (_coordinates(null_space, select) @ difference))


def _coordinates(null_space: Array, select: Mask) -> Array:
    """Return ``(E^T D E)^-1 E^T D`` (d, n): it gives the size of each motion from the unknowns of the datum."""
    part = null_space[select]
    out = np.zeros(null_space.T.shape)
    if not null_space.shape[1]:
        return out
    s = np.linalg.svd(part, compute_uv=False) if len(part) >= part.shape[1] else np.zeros(1)
    if not len(s) or s[-1] * FIXES <= np.linalg.norm(null_space, 2):
        raise InputError.of(
            "statistics.datum", option="datum", value=f"{int(select.sum())} unknowns", count=null_space.shape[1]
        )
    out[:, select] = np.linalg.pinv(part)
    return out
