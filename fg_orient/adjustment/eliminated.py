"""Eliminate groups of ground points for given image vectors; this is the content of a factor of the reduced graph.

A group is a set of ground points with all their rays. For given image vectors x its points are intersected again with
the images held fixed (variable projection: Golub & Pereyra 1973), and eliminated. The result is a function of x alone:
the cost c(x), its gradient g(x) and the reduced normal matrix S(x) of Gauss-Newton. GTSAM receives them as rows, see
:class:`GroupRows`. S of a group without control is singular. Except for the last row, the rows are not the derivative
of the error vector; only the cost has a derivative. The sums of all groups are given as a matrix in blocks
(:meth:`Elimination.linearised`).

Points are intersected by Newton's steps with 3 unknowns. They begin at the positions that the last linearised solution
predicts for the step of the images. Near the solution this start is exact to second order, and no step is needed. The
elimination contains one further Newton step of each point. A step that does not decrease the cost of its point is
halved. A group with a point that cannot be intersected has the cost :data:`IMPOSSIBLE`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.arrays import Array
from factors.conditions.control import POINT
from fg_orient.adjustment.point_groups import GroupMatrices, GroupRows, numbers_of_groups, vector_parts
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import FixedWeights, Weighing
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.schur_structure import Small, Tile
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients
from fg_orient.kernels.batch_points import decreases, move, newton_steps
from fg_orient.model.errors import NoSolutionError

Index = npt.NDArray[np.int64]

#: A point counts as the intersection of its rays if its Newton decrement is below this, in sigmas. Cost, gradient and
#: matrix of the group contain one further Newton step, which covers the remaining distance.
INTERSECTED: Final = 1e-6
#: After a step of the images up to this size, in prior sigmas, the predicted points need no further step.
SMALL_STEP: Final = 1e-4
#: Up to this Newton decrement, in sigmas, steps are taken without a test of the cost, because it hardly changes.
SAFE: Final = 1e-4
#: If the points of a group need more steps, the group is treated as impossible.
MAX_STEPS: Final = 40
#: If no step improves a point and its Newton decrement is below this, in sigmas, it is intersected within rounding.
STALLED: Final = 1e-3
#: Cost of a group with a point that cannot be intersected: finite, because GTSAM's Gauss-Newton would accept infinity.
IMPOSSIBLE: Final = 1e30


class NotIntersected(RuntimeError):
    """Error: the steps of a point do not converge."""


class Elimination:
    """Groups of all ground points of a problem; a group is computed again when the vectors of its images change.

    The values do not depend on the order of calls, except for the start of the points (1e-12 of the cost), nor on the
    number of threads.

    Parameters
    ----------
    problem : Problem
        Problem; its priors and extra observations are not part of the groups.
    threads : int, optional
        See :class:`SchurBackend`.
    grouped : bool
        False: all points are one group.
    """

    def __init__(self, problem: Problem, threads: int | None = None, *, grouped: bool = True) -> None:
        size = np.diff(problem.first).astype(np.int64)
        self.problem = problem
        begins = np.zeros(1, np.int64)

        def grouping(first: Small, image: Small) -> Index:
            nonlocal begins
            number = numbers_of_groups(first, image, size)
            begins = np.cumsum(np.bincount(number)) - np.bincount(number)
            return number

        self.backend = SchurBackend(problem, threads, "blocks", grouping=grouping if grouped else None)
        #: Part of the free unknowns of each vector, by its number.
        self.parts = dict(vector_parts(problem))
        self._matrices = GroupMatrices(self.backend, begins, self.parts)
        self.groups = self._matrices.groups
        #: Names of points that could not be intersected at the last evaluation, by group.
        self.impossible: dict[int, str] = {}
        self._free = problem.image_vector(problem.start)
        self._ground = problem.start.ground.copy()  # ground points at which the rows in the buffers were computed
        # for each group, the state at its last linearisation: free unknowns, its ground points, and
        # their positions
        self._base: dict[int, tuple[Array, Array, Any]] = {}
        self._rows: list[GroupRows | None] = [None] * len(self.groups)
        # unknowns at which the cost of all groups was computed last, and the cost
        self._total: tuple[Array, float] | None = None
        self._excess = np.zeros(len(self.groups))
        self._far = True
        self._shrink = 1.0  # factor by which the last step of the points reduced the largest decrement
        # twice the decrease that a Newton step of each point predicts at the last elimination
        self._decrease = np.zeros(len(self.backend.structure.number))
        #: Groups without sums of the pairs of rays, which a cost does not need.
        self._unsummed: set[int] = set()
        self._name = object()  # owner of the buffers; a reference to this object would be a cycle

    def hold_weights(self, robust: Weighing | None, state: State) -> None:
        """Weight the rows with a loss at a state until the next call; the cost is then the cost of the loss.

        At other states the held cost is not below the cost of the loss. The weights are held because a redescending
        loss has several minima in a point.
        """
        backend, b = self.backend, self.backend.buffers
        backend.robust, b.root_weight, b.control = None, np.ones(0), self.problem.control_records
        self._excess[:], self._rows, self._total = 0.0, [None] * len(self.groups), None
        if robust is None:
            return
        image_squares, control_squares = backend.squares(state)
        image, control, _ = robust.weigh(image_squares, control_squares)
        backend.robust, b.root_weight = FixedWeights(image, control), np.sqrt(image)
        b.control = self.problem.control_records.copy()
        observed = backend.structure.observed
        b.control[observed, POINT.whitening] *= np.sqrt(control)[:, None]
        cost, control_cost = robust.costs(image_squares, control_squares)
        rest = cost - 0.5 * image * image_squares
        rest_control = control_cost - 0.5 * control * control_squares
        place = np.flatnonzero(backend.structure.free == 2)
        for g, group in enumerate(self.groups):
            inside = (place >= group.places[0]) & (place < group.places[1])
            self._excess[g] = rest[slice(*group.points)].sum() + rest_control[inside].sum()

    def last_rows(self) -> tuple[GroupRows, ...]:
        """Return the rows of all groups at their last evaluation; each group must have been evaluated."""
        assert all(rows is not None for rows in self._rows)
        return tuple(rows for rows in self._rows if rows is not None)

    def require_possible(self) -> None:
        """Raise NoSolutionError if the rays of a point did not intersect at the last evaluation."""
        if self.impossible:
            why = next(iter(self.impossible.values()))
            raise NoSolutionError.of("adjust.broken_down", place=self.problem.block.name, why=why)

    def release(self) -> None:
        """Release the buffers for other users of the backend; all groups are computed again afterwards."""
        b = self.backend.buffers
        self._rows, self._total, self._base = [None] * len(self.groups), None, {}
        b.owner, b.held, b.root_weight, b.control = None, None, np.ones(0), self.problem.control_records

    def start_at(self, free: Array, ground: Array) -> None:
        """Begin at image unknowns (u,) and ground points (N, 3).

        All groups are computed again from there.
        """
        self._free, self._ground, self._base = free.copy(), ground.copy(), {}
        self._rows, self._total = [None] * len(self.groups), None

    def rows(self, g: int, own: Array, everything: Callable[[], Array], *, accepted: bool) -> GroupRows:
        """Return the rows of a group.

        Parameters
        ----------
        g : int
        own : (n,) array
            Values of ``groups[g].free``.
        everything : callable
            Function that returns the values (u,) of all unknowns, nan for missing ones. All groups whose unknowns have
            changed are computed together.
        accepted : bool
            True if the optimiser linearises here; points are predicted from the last such state.
        """
        found = self._rows[g]
        if found is None or not found.has_matrix or not np.array_equal(found.at, own):
            self._refresh(everything(), matrices=True)
            found = self._rows[g]
            assert found is not None
        if accepted and g not in self.impossible:
            number = self.backend.structure.number[slice(*self.groups[g].places)]
            self._base[g] = found.at, self._ground[number], slice(None)
        return found

    def cost(self, free: Array) -> float:
        """Return the cost of all groups at image unknowns (u,)."""
        if self._total is None or not np.array_equal(self._total[0], free):
            self._refresh(free, matrices=False)
            self._total = free, sum(rows.cost for rows in self.last_rows())
        return self._total[1]

    def linearised(self, free: Array) -> tuple[Array, Array]:
        """Return sums of all groups at a linearisation: blocks (B, k, k) of S, overwritten later, and g (u,).

        ``backend.structure`` defines the blocks; groups that cannot be intersected contribute nothing.
        """
        self._refresh(free, matrices=False)
        backend, s, b = self.backend, self.backend.structure, self.backend.buffers
        if self._unsummed:
            self._sum(sorted(self._unsummed), State(self.problem.image_matrix(self._free), self._ground))
        ground = self._ground.copy()
        for g, rows in enumerate(self.last_rows()):
            if g in self.impossible:
                slots = slice(*s.slot_begin[list(self.groups[g].chunks)])
                b.sums[slots], b.gradients[slots] = 0.0, 0.0
            else:
                self._base[g] = rows.at, ground, s.number[slice(*self.groups[g].places)]
        of = (s.wide, s.scale, s.size)
        at = (s.block_begin, s.block_slots, s.slot_own, s.block_row, s.block_column)
        backend.workers.run(gather_blocks, s.block_begin, *at, b.sums, *of, s.n_basis, s.n_components, b.blocks)
        gradient = np.zeros(self.problem.n_image_unknowns)
        gather_gradients(*at, b.gradients, *of, s.n_components, gradient)
        return b.blocks, gradient if self.problem.ties is None else self.problem.ties.summed(gradient)

    def _refresh(self, free: Array, *, matrices: bool) -> None:
        """Compute the groups whose unknowns have changed; ``matrices``: also the matrix of each."""
        stale = [g for g in range(len(self.groups)) if self._stale(g, free, matrices)]
        if stale:
            self._total = None
            self._evaluate(stale, free, matrices)

    def _stale(self, g: int, free: Array, matrices: bool) -> bool:
        rows, own = self._rows[g], free[self.groups[g].free]
        same = rows is not None and (rows.has_matrix or not matrices) and np.array_equal(rows.at, own)
        return bool(np.isfinite(own).all()) and not same

    def state(self, free: Array, *, complete: bool = False) -> State:
        """Return the state with the points of the last evaluation; with ``complete``, after their last Newton step."""
        image = self.problem.image_matrix(free)
        if not complete:
            return State(image, self._ground.copy())
        step = newton_steps(self.backend.buffers.root, self.backend.buffers.gradient)
        return self.backend.moved(State(image, self._ground), np.zeros(len(free)), step)

    # one evaluation

    def _evaluate(self, groups: Sequence[int], free: Array, matrices: bool) -> None:
        """Compute groups: predict their points, intersect, eliminate."""
        full = np.where(np.isfinite(free), free, self._free)
        self._far = not self._base or float(np.abs(full - self._free).max(initial=0.0)) > SMALL_STEP
        self._predict(groups, full)
        self._free = full
        state = State(self.problem.image_matrix(full), self._ground)
        late = not matrices and len(self.backend.structure.tiles) == 1
        good = self._intersect(groups, state, late=late)
        self._assemble(good, full, matrices)
        for g in groups:
            if g not in good:
                own, places = full[self.groups[g].free], slice(*self.groups[g].places)
                number = self.backend.structure.number[places]
                self._ground[number] = self._kept_ground(g) if g in self._base else self.problem.start.ground[number]
                zero = np.zeros((len(own), len(own)))
                self._rows[g] = GroupRows(own, zero, np.zeros(len(own)), 2.0 * IMPOSSIBLE)

    def _predict(self, groups: Sequence[int], free: Array) -> None:
        """Move the points of groups to where the last linearised solution predicts them."""
        s, known, back = self.backend.structure, [], []
        for g in groups:
            base = self._base.get(g)
            if base is None:
                continue
            rows, own = self._rows[g], self.groups[g].free
            if rows is not None and np.array_equal(rows.at, base[0]):
                known.append(g)  # the buffers contain the elimination of this group
            else:
                back.append(g)
        if known:
            step, ground = np.zeros(len(free)), np.zeros((len(s.number), 3))
            for g in known:
                own = self.groups[g].free
                step[own] = free[own] - self._base[g][0]
            self._substitute(known, step, ground)
            for g in known:
                places = slice(*self.groups[g].places)
                move(s.number[places], ground[places], self._ground)
        for g in back:
            self._ground[s.number[slice(*self.groups[g].places)]] = self._kept_ground(g)

    def _kept_ground(self, g: int) -> Array:
        """Return the ground points (p, 3) of a group where it was linearised last."""
        _, ground, of_group = self._base[g]
        return np.asarray(ground[of_group])

    def _substitute(self, groups: Sequence[int], step: Array, ground: Array) -> None:
        """Write steps (P, 3) of points of groups after a step (u,) of the images, from elimination in the buffers."""
        backend, s, b = self.backend, self.backend.structure, self.backend.buffers
        wide, own = s.widened(self.problem.image_matrix(step)), s.widened(self.problem.image_matrix(self._free))
        state = State(self.problem.image_matrix(self._free), self._ground)
        for tile, lo, hi in self._ranges(groups):
            again = None if tile.kept or b.held is tile else own
            backend.workers.run(
                backend.stages.substituted, s.cost[lo : hi + 1], b.rows(tile), state, again, wide, b, ground, start=lo
            )  # fmt: skip
            b.held = b.held if tile.kept or again is None else None

    def _ranges(self, groups: Sequence[int]) -> Iterator[tuple[Tile, int, int]]:
        """Yield the tiles, and the ranges of their chunks that belong to groups."""
        s = self.backend.structure
        joined: list[list[int]] = []
        for g in groups:
            lo, hi = self.groups[g].chunks
            if joined and joined[-1][1] == lo:
                joined[-1][1] = hi
            else:
                joined.append([lo, hi])
        for tile in s.tiles:
            for lo, hi in joined:
                begin, end = max(lo, tile.chunks[0]), min(hi, tile.chunks[1])
                if begin < end:
                    yield tile, begin, end

    def _intersect(self, groups: Sequence[int], state: State, *, late: bool) -> set[int]:
        """Intersect the points of groups with the images held fixed.

        Return the groups that could be intersected, eliminated.

        ``late``: the pairs of rays are summed when the sums are needed.
        """
        self.impossible = {g: why for g, why in self.impossible.items() if g not in groups}
        try:
            self._newton(groups, state, late=late)
            return set(groups)
        except (NotFiniteError, NotIntersected, Singular):
            return {g for g in groups if self._is_possible(g, state, late=late)}

    def _is_possible(self, g: int, state: State, *, late: bool) -> bool:
        """Return whether the points of a group can be intersected.

        If not, the reason is recorded.
        """
        try:
            self._newton([g], state, late=late)
        except (NotFiniteError, NotIntersected, Singular) as error:
            self.impossible[g] = str(error)
            return False
        return True

    def _newton(self, groups: Sequence[int], state: State, *, late: bool) -> None:
        """Move points of groups by Newton's steps until all are intersected.

        The last elimination is in the buffers.
        """
        s = self.backend.structure
        places: Any = slice(None)  # a slice of all positions is a view and needs no copy
        whole, largest = len(groups) == len(self.groups), math.inf
        if not whole:
            places = np.concatenate([np.arange(*self.groups[g].places) for g in groups])
        b, number, last_cost, last_ground = self.backend.buffers, s.number[places], None, np.zeros(0)
        near, kept = not self._far, all(tile.kept for tile in s.tiles)
        for _ in range(MAX_STEPS):
            # otherwise a further step follows, and this one needs only derivatives by the points
            whole_rows = near or not kept
            self._eliminate(groups, state, near=near and not late, of_images=whole_rows)
            decrement, before = self._decrements(places), largest
            largest = float(decrement.max(initial=0.0))
            if before < math.inf:
                self._shrink = min(largest / before, 1.0)
            if largest <= INTERSECTED:
                if not whole_rows:
                    self._eliminate(groups, state, near=False)
                break
            step = newton_steps(b.root[places], b.gradient[places])
            near = self._shrink * largest <= INTERSECTED
            if largest <= SAFE and last_cost is None and whole:
                move(s.number, step, state.ground)
                continue
            here = state.ground[number]
            ahead = here + step
            if largest > SAFE or last_cost is not None:
                cost = self._point_costs(state)[places]
                if last_cost is not None:
                    worse = (cost > last_cost * (1.0 + 1e-12)) & (decrement > INTERSECTED)
                    ahead[worse] = 0.5 * (here[worse] + last_ground[worse])
                    here, cost = np.where(worse[:, None], last_ground, here), np.where(worse, last_cost, cost)
                last_cost, last_ground = cost, here
            state.ground[number] = ahead
        else:
            if largest > STALLED:
                name = self.problem.block.points.ids[int(number[int(decrement.argmax())])]
                raise NotIntersected(f"the rays of point {name} do not intersect near its last position")
            self._eliminate(groups, state, near=near and not late)
            self._decrements(places)
        self._unsummed |= set(groups)
        if not late:
            self._sum(groups, state, done=near)

    def _eliminate(self, groups: Sequence[int], state: State, *, near: bool, of_images: bool = True) -> None:
        """Compute rows and point blocks of groups at a state; if ``near`` the intersection, also sum the pairs of rays.

        Without ``of_images`` the rows have no derivatives by the images.
        """
        wide = self.backend.structure.widened(state.image)
        for tile, lo, hi in self._ranges(groups):
            self._chunks(tile, lo, hi, state, wide, pairs=near, of_images=of_images)

    def _sum(self, groups: Sequence[int], state: State, *, done: bool = False) -> None:
        """Sum the pairs of rays of eliminated groups, if not done."""
        self._unsummed -= set(groups)
        if done:
            return
        backend, b, wide = self.backend, self.backend.buffers, self.backend.structure.widened(state.image)
        alone = len(backend.structure.tiles) == 1  # otherwise other tiles have overwritten the reduced rows
        for tile, lo, hi in self._ranges(groups):
            if alone and tile.kept:
                cost = backend.structure.cost[lo : hi + 1]
                backend.workers.run(backend.stages.pairs, cost, b.rows(tile), b, start=lo)
            else:
                self._chunks(tile, lo, hi, state, None if tile.kept else wide, pairs=True)

    def _chunks(
        self, tile: Tile, lo: int, hi: int, state: State, wide: Array | None, *, pairs: bool, of_images: bool = True
    ) -> None:
        """Eliminate the points of chunks of a tile; see :meth:`Stages.chunks`."""
        backend, b = self.backend, self.backend.buffers
        b.owner = self._name
        backend.workers.run(
            backend.stages.chunks, backend.structure.cost[lo : hi + 1], b.rows(tile, of_images=of_images), state, wide,
            0.0, b, pairs, start=lo,
        )  # fmt: skip
        b.held = b.held if tile.kept else None

    def _decrements(self, places: Any) -> Array:
        """Return Newton decrements (n,) in sigmas: roots of twice the decrease that a Newton step predicts."""
        b = self.backend.buffers
        self._decrease[places] = decreases(b.root[places], b.gradient[places])
        return np.asarray(np.sqrt(self._decrease[places]))

    def _point_costs(self, state: State) -> Array:
        """Return half the sum of squares (P,) of the rays and the control equations of each point."""
        s, b = self.backend.structure, self.backend.buffers
        squares = np.einsum("ni,ni->n", b.value, b.value)
        out = 0.5 * np.add.reduceat(squares, s.first[:-1])
        out[s.free == 2] += 0.5 * self.backend.control_squares(state, b.control)
        return np.asarray(out)

    def _assemble(self, groups: set[int], free: Array, matrices: bool) -> None:
        """Compute the cost of groups and, with ``matrices``, their matrix and gradient, as rows."""
        backend, s, b = self.backend, self.backend.structure, self.backend.buffers
        if not groups:
            return
        blocks = self._matrices.blocks(groups) if matrices else None
        control = backend.control_squares(State(self.problem.image_matrix(free), self._ground), b.control)
        place = np.flatnonzero(s.free == 2)
        for g in groups:
            group = self.groups[g]
            value, at = b.value[slice(*group.points)], slice(*group.places)
            inside = slice(*np.searchsorted(place, group.places))
            points = float(control[inside].sum() - self._decrease[at].sum())
            total = float(np.vdot(value, value)) + points + 2.0 * self._excess[g]
            matrix, gradient = (None, None) if blocks is None else self._matrices.normal(group, blocks)
            self._rows[g] = GroupRows(free[group.free], matrix, gradient, total)
