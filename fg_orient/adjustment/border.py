"""Normal equations reduced to a border: the image unknowns and the ground points that extra observations name.

All other ground points are eliminated one by one (``fg_orient.adjustment.schur``). B and
G are the derivatives of the rows of a point by the border and by the point. With H = G^T
G and K = H^-1 G^T B

    S = sum (B^T B - B^T G K) + extra observations + priors,    x_p = H^-1 g_p - K x_b

If images are eliminated first (:mod:`fg_orient.adjustment.images_first`), the border
consists of the shared unknowns of the images and all ground points. :func:`border_of`
chooses. :mod:`fg_orient.adjustment.border_matrix` contains the matrix of both kinds.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.border_matrix import BorderMatrix, Followed, triangle
from fg_orient.adjustment.cofactors import Part, order_by_point, parts_of
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.images_first import Images, Places, images_first
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_choice import FULL_BORDER, Pattern
from fg_orient.adjustment.rows import linearised, summed
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.schur_reduced import Singular, full_matrix
from fg_orient.model.block import ExtraObservation
from fg_orient.model.options import Datum

if TYPE_CHECKING:
    from scipy import sparse

#: Maximum number of image points whose Jacobians are kept; in larger blocks they are computed at each use.
KEPT: Final = 100_000


def divided(problem: Problem) -> tuple[Problem, Problem | None]:
    """Split a problem: the points to eliminate, and the named points with all extra observations.

    The second problem is None if no extra observation names a point; the first then has all extra observations.
    """
    points = problem.named_points()
    if not points:
        return problem, None
    named = np.zeros(len(problem.active), bool)
    named[points] = True
    ray = named[problem.observations.point]
    return _part(problem, ~ray, ~named, ()), _part(problem, ray, named, problem.block.extra)


def _part(problem: Problem, rays: Mask, points: Mask, extra: tuple[ExtraObservation, ...]) -> Problem:
    """Return the problem with some of the image points, ground points and extra observations.

    The images stay.
    """
    return replace(
        problem,
        block=replace(problem.block, extra=extra),
        observations=problem.observations.take(rays),
        records=problem.records[rays],
        active=problem.active & points,
        observed=problem.observed & points,
    )


def eliminated_part(problem: Problem, datum: Datum) -> Problem:
    """Return the problem of the points to eliminate, without priors and extra observations."""
    own, _ = divided(problem)
    options = replace(problem.block.options, priors=False, datum=datum)
    return replace(own, block=replace(own.block, options=options, extra=()))


def explicit_rows(problem: Problem, state: State) -> tuple[Array, sparse.csr_array]:
    """Return the whitened rows of named points, extra observations and priors.

    The rows are residuals (r,) and the Jacobian (r, b) by the unknowns of the border.
    """
    from scipy import sparse

    values, rows, columns, entries, count = [np.zeros(0)], [], [], [], 0
    for at, value, design in _pieces(problem, state):
        own = np.repeat(np.arange(count, count + len(value)), len(at)).reshape(design.shape)
        rows.append(own.ravel())
        columns.append(np.broadcast_to(at, design.shape).ravel())
        entries.append(design.ravel())
        values.append(value)
        count += len(value)
    if problem.block.options.priors:
        z = problem.n_free_unknowns
        rows.append(np.arange(count, count + z))
        columns.append(np.arange(z))
        entries.append(np.ones(z))
        values.append(problem.image_vector(state))
    value, none = np.concatenate(values), np.zeros(0, np.intp)
    places = np.concatenate([none, *rows]), np.concatenate([none, *columns])
    size = problem.n_free_unknowns + 3 * len(problem.named_points())
    data = np.concatenate([np.zeros(0), *entries])
    return value, sparse.coo_array((data, places), shape=(len(value), size)).tocsr()


def _pieces(problem: Problem, state: State) -> Iterator[tuple[Index, Array, Array]]:
    """Yield the rows of named points and of extra observations: columns (c,), residuals (r,), Jacobian (r, c).

    Columns may occur twice.
    """
    named, free, z = problem.named_points(), free_columns(problem), problem.n_free_unknowns
    place = {j: z + 3 * k for k, j in enumerate(named)}
    if named:
        o = problem.observations
        rays = np.flatnonzero(np.isin(o.point, named))
        for row, value, by_image, by_point in zip(rays.tolist(), *linearised(problem, state, rays), strict=True):
            k, j = int(o.image[row]), int(o.point[row])
            size = len(problem.parameters[k])
            own = free[problem.first[k] : problem.first[k] + size]
            yield np.append(own, place[j] + np.arange(3)), value, np.hstack([by_image[:, :size], by_point])
        for j in (j for j in named if problem.observed[j]):
            yield place[j] + np.arange(3), problem.control_residuals(state, j), problem.control_weights(j)
    for extra in problem.block.extra:
        value, blocks = extra_blocks(problem, extra, state, jacobian=True)
        at = [free[problem.image_slice(a.index)] if a.is_image else place[a.index] + np.arange(3) for a, _ in blocks]
        yield np.concatenate(at).astype(np.intp), value, np.hstack([block for _, block in blocks])


def free_columns(problem: Problem) -> Index:
    """Return the column (w,) of each unknown of all images."""
    return np.arange(problem.n_image_unknowns) if problem.ties is None else problem.ties.of


def bordered(problem: Problem, pattern: Pattern, blocks: Array, design: sparse.csr_array) -> Array:
    """Return the normal matrix (b, b) from blocks of eliminated points and the Jacobian of :func:`explicit_rows`."""
    out, z = (design.T @ design).toarray(), problem.n_free_unknowns
    out[:z, :z] += full_matrix(pattern, problem.first, blocks, problem.ties)
    return np.asarray(out)


class Border(BorderMatrix):
    """Border of a problem, linearised at a state.

    Its unknowns are the image unknowns (shared unknowns once, in prior sigmas), then
    three of each named ground point (m).

    Parameters
    ----------
    problem : Problem
    state : State
    near : Border, optional
        Border of the same problem at another state; arrays that do not depend on the state are copied from it.

    Raises
    ------
    Singular
        Singular :: The rays do not determine a ground point that is not named.
    """

    def __init__(self, problem: Problem, state: State, near: Border | None = None) -> None:
        self.problem, self.state, self.named = problem, state, problem.named_points()
        if near is None:
            self._backend = SchurBackend(eliminated_part(problem, "control"), reduced="blocks")
            self._order = order_by_point(self._backend.problem)
        else:
            self._backend, self._order = near._backend, near._order
        #: Problem of the eliminated points.
        self.eliminated = self._backend.problem
        self._kept: list[Part] = []
        self._system = self._backend.linearise(state)
        self._rows = explicit_rows(problem, state)
        super().__init__(problem, state, *self._normal())

    @property
    def n_images(self) -> int:
        """Number of unknowns of images."""
        return self.problem.n_free_unknowns

    def _normal(self) -> tuple[Array, Array]:
        """Return S (b, b), and the gradient (b,) with the points at the intersection of their rays."""
        blocks, gradient = self._system.partial(0.0)
        matrix = bordered(self.problem, self._system.structure.pattern, blocks, self._rows[1])
        self._backend.buffers.release()
        value, design = self._rows
        full = np.asarray(design.T @ value)
        full[: self.n_images] += gradient
        return matrix, full

    def squares(self) -> float:
        """Return the squares of the whitened residuals of the eliminated points.

        The points move, the images stay.
        """
        return 2.0 * self._system.substitute(np.zeros(self.n_images), 0.0).predicted_error

    def columns_of(self, j: int) -> Index:
        """Return the columns (3,) of a named point."""
        return self.n_images + 3 * self.named.index(j) + np.arange(3)

    def gains(self, points: Index) -> tuple[Array, Array]:
        """Return ``-K`` (n, 3, b) and H^-1 (n, 3, 3) of ground points.

        For a named point, the first array selects its own unknowns in the border, and the second one is
        zero.
        """
        gain, inverse = np.zeros((len(points), 3, len(self))), np.zeros((len(points), 3, 3))
        for place in np.flatnonzero(np.isin(points, self.named)).tolist():
            gain[place, :, self.columns_of(int(points[place]))] = np.eye(3)
        eliminated = np.setdiff1d(points, self.named)
        for part, design in self._with_rows(parts_of(self.eliminated, self.state, eliminated)):
            slope = np.einsum("nri,nrb->nib", part.d_ground, design.toarray().reshape(-1, 2, len(self)))
            mine = -(part.inverse @ summed(slope, part.first))
            at = np.searchsorted(part.points, points)
            for place in np.flatnonzero(np.isin(points, part.points)).tolist():
                gain[place], inverse[place] = mine[at[place]], part.inverse[at[place]]
        return gain, inverse

    @cached_property
    def free_columns(self) -> Index:
        """Column (w,) of each unknown of all images."""
        return free_columns(self.problem)

    def parts(self) -> Iterator[tuple[Part, sparse.csr_array]]:
        """Yield eliminated points with all their rays, and the derivatives (2n, b) of these rays by the border."""
        kept = len(self.eliminated.observations) <= KEPT
        if kept and not self._kept:
            self._kept = list(parts_of(self.eliminated, self.state, order=self._order))
        return self._with_rows(iter(self._kept) if kept else parts_of(self.eliminated, self.state, order=self._order))

    def _with_rows(self, parts: Iterator[Part]) -> Iterator[tuple[Part, sparse.csr_array]]:
        """Yield the parts with their rows to the border."""
        from scipy import sparse

        columns = np.append(self.free_columns, len(self))[np.minimum(self.problem.columns, len(self.free_columns))]
        for part in parts:
            n, _, k = part.d_image.shape
            at = np.repeat(columns[part.image], 2, axis=0).ravel()
            begin = np.arange(0, 2 * n * k + 1, k)
            full = bool((at < len(self)).all())  # all columns are used: their selection would take as long as a product
            wide = sparse.csr_array((part.d_image.reshape(-1), at, begin), shape=(2 * n, len(self) + (not full)))
            yield part, wide if full else wide[:, : len(self)]

    def follow(self, moves: Array) -> Followed:
        """See :class:`BorderMatrix`."""
        d = moves.shape[1]
        ground, gradient, rows = np.zeros((len(self.problem.active), 3, d)), np.zeros(moves.shape), [np.zeros((0, d))]
        for part, design in self.parts():
            seen = np.asarray(design @ moves).reshape(len(part.rows), 2, d)
            slope = summed(np.swapaxes(part.d_ground, 1, 2) @ seen, part.first)
            step = -(part.inverse @ slope)
            ground[part.points] = step
            left = seen + part.d_ground @ np.repeat(step, np.diff(part.first), axis=0)
            flat = left.reshape(2 * len(left), d)
            gradient += np.asarray(design.T @ flat)
            control = np.flatnonzero(self.eliminated.observed[part.points])
            held = self.eliminated.control_weights(part.points[control]) @ step[control]
            rows.append(triangle(np.vstack([flat, held.reshape(3 * len(held), d)])))
        _, jacobian = self._rows
        rows.append(np.asarray(jacobian @ moves))
        gradient += np.asarray(jacobian.T @ rows[-1])
        if self.named:
            ground[self.named] = moves[self.n_images :].reshape(len(self.named), 3, d)
        return Followed(ground, triangle(np.vstack(rows)), gradient)

    def images_of(self, moves: Array) -> Array:
        """See :class:`BorderMatrix`."""
        return moves[: self.n_images]

    def effect_of(self, images: Array, ground: Array) -> Array:
        """See :class:`BorderMatrix`; points that are not named follow."""
        return self.follow(np.vstack([images, ground[self.named].reshape(-1, images.shape[1])])).effect

    # --- solution ---------------------------------------------------------------------------------

    def times(self, border: Array, ground: Array) -> tuple[Array, Array]:
        """Multiply the cofactor matrix of all unknowns by columns (b, d) and (N, 3, d).

        The result has the same shapes.
        """
        right, own = border.copy(), np.zeros(ground.shape)
        if self.named:
            right[self.n_images :] += ground[self.named].reshape(-1, ground.shape[2])
        for part, design in self.parts():
            own[part.points] = part.inverse @ ground[part.points]
            along = part.d_ground @ np.repeat(own[part.points], np.diff(part.first), axis=0)
            right -= np.asarray(design.T @ along.reshape(-1, ground.shape[2]))
        solved = self.inverse @ right
        return solved, own + self.follow(solved).ground

    def at(self, state: State) -> Border:
        """See :class:`BorderMatrix`."""
        out = Border(self.problem, state, self)
        out.moves = self.moves
        return out

    def newton(self) -> State:
        """See :class:`BorderMatrix`."""
        step, s = -(self.inverse @ self.gradient), self._system.structure
        moved = self._system.substitute(step[: self.n_images], 0.0)
        ground = self.state.ground.copy()
        ground[s.number] += moved.ground
        if self.named:
            ground[self.named] += step[self.n_images :].reshape(-1, 3)
        return State(self.state.image + self.problem.image_matrix(step[: self.n_images]), ground)


def small_enough(problem: Problem) -> bool:
    """Return whether the matrix of the border is formed as a whole."""
    return problem.n_free_unknowns + 3 * len(problem.named_points()) <= FULL_BORDER


class ImagesBorder(BorderMatrix):
    """Border of a problem whose images are eliminated, linearised at a state.

    Parameters
    ----------
    problem : Problem
    state : State
    places : Places, optional
        Places of the problem.

    Raises
    ------
    Singular
        Singular :: Its points do not determine an image.
    """

    def __init__(self, problem: Problem, state: State, places: Places | None = None) -> None:
        self.places = places or Places(problem)
        #: The eliminated images.
        self.images = Images(self.places, state)
        super().__init__(problem, state, self.images.matrix, self.images.border_gradient)

    def at(self, state: State) -> ImagesBorder:
        """See :class:`BorderMatrix`."""
        out = ImagesBorder(self.problem, state, self.places)
        out.moves = self.moves
        return out

    def newton(self) -> State:
        """See :class:`BorderMatrix`."""
        places, step = self.places, -(self.inverse @ self.gradient)
        own = self.images.own_step + self.images.followed(step[:, None])[:, :, 0]
        return places.state(places.own_of(self.state) + own, places.border_of(self.state) + step)

    def images_of(self, moves: Array) -> Array:
        """See :class:`BorderMatrix`."""
        return self.places.joined(self.images.followed(moves), moves[: len(self.places.shared)])

    def follow(self, moves: Array) -> Followed:
        """See :class:`BorderMatrix`."""
        places, problem, d = self.places, self.problem, moves.shape[1]
        s, own = len(places.shared), self.images.followed(moves)
        flat = self.images.along(own, moves)
        gradient, rows = self.images.to_border(flat), [flat]
        ground = self._ground(moves)
        observed = np.flatnonzero(problem.observed)
        if len(observed):
            w = problem.control_weights(observed)
            held = w @ ground[observed]
            at = places.of_point[observed][:, None] + np.arange(3)
            gradient[at] += np.swapaxes(w, 1, 2) @ held
            rows.append(held.reshape(3 * len(held), d))
        for extra in self.images.extras:
            value = extra.border @ moves + (extra.own @ own[extra.image] if extra.image >= 0 else 0.0)
            gradient += extra.border.T @ value
            rows.append(value)
        if problem.block.options.priors:
            gradient[:s] += moves[:s]
            rows.append(places.joined(own, moves[:s]))
        return Followed(ground, triangle(np.vstack(rows)), gradient)

    def movements(self, moves: Array) -> tuple[Array, Array]:
        """See :class:`BorderMatrix`."""
        return self.images_of(moves), self._ground(moves)

    def _ground(self, moves: Array) -> Array:
        """Return the movements (N, 3, d) of the ground points."""
        active = self.problem.active
        out, points = np.zeros((len(active), 3, moves.shape[1])), int(active.sum())
        out[active] = moves[len(self.places.shared) :].reshape(points, 3, moves.shape[1])
        return out

    def effect_of(self, images: Array, ground: Array) -> Array:
        """See :class:`BorderMatrix`; the unknowns of single images follow."""
        moves = ground[self.problem.active].reshape(len(self) - len(self.places.shared), images.shape[1])
        return self.follow(np.vstack([images[self.places.shared], moves])).effect


def border_of(problem: Problem, state: State) -> BorderMatrix | None:
    """Return the border of a problem, of the kind that needs less work; None if it is too large.

    Raises
    ------
    Singular
        Singular :: The observations do not determine the eliminated unknowns.
    """
    if images_first(problem):
        with contextlib.suppress(Singular):
            return ImagesBorder(problem, state)
    return Border(problem, state) if small_enough(problem) else None
