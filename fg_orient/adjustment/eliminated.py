"""Groups of ground points eliminated for given image vectors: what a factor of the reduced graph holds.

A group is a set of ground points with all their rays. For given image vectors x its points are intersected again with
the images held (variable projection: Golub & Pereyra 1973), and eliminated. What remains is a function of x alone, with
the cost c(x), its gradient g(x) and the reduced normal matrix S(x) of Gauss-Newton, which GTSAM is given as rows, see
:class:`GroupRows`. S of a group without control is singular. The rows are not the derivative of the error vector but
for the last; only the cost has a derivative.

Points are intersected by Newton's steps with 3 unknowns. They begin where the last linearised solution, moved along
the step of the images, predicts them; near the solution this start is exact to second order and no step is needed. The
elimination contains one further Newton step of each point. A step that does not decrease the cost of its point is
halved. A group with a point that cannot be intersected has the cost :data:`IMPOSSIBLE`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.conditions.control import POINT
from fg_orient.adjustment.point_groups import GroupRows, PointGroup, numbers_of_groups, vector_parts
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import FixedWeights, Weighing
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.schur_structure import Small, Tile
from fg_orient.kernels.batch_matrix import add_shared
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients
from fg_orient.kernels.batch_points import ROOT
from fg_orient.model.errors import NoSolutionError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: Newton decrement of a point, in sigmas, below which it is at the intersection of its rays. Cost, gradient and matrix
#: of the group then contain the rest of the way by their own Newton step.
INTERSECTED: Final = 1e-6
#: Largest step of the images, in prior sigmas, after which the predicted points are expected to be intersected.
SMALL_STEP: Final = 1e-4
#: Newton decrement, in sigmas, up to which steps are taken without a test of the cost, which hardly changes then.
SAFE: Final = 1e-4
#: Steps of the points until a group counts as impossible.
MAX_STEPS: Final = 40
#: Newton decrement, in sigmas, up to which a point that no step improves is at the intersection, but for rounding.
STALLED: Final = 1e-3
#: Cost of a group with a point that cannot be intersected: finite, because GTSAM's Gauss-Newton would accept infinity.
IMPOSSIBLE: Final = 1e30


class NotIntersected(RuntimeError):
    """A point moves on, step after step."""


class Elimination:
    """Groups of all ground points of a problem; a group is computed again when the vectors of its images change.

    The values do not depend on the order of calls, but for the start of the points (1e-12 of the cost), nor on the
    number of threads.

    Parameters
    ----------
    problem : Problem
        Its priors and extra observations are not part of the groups.
    threads : int, optional
        See :class:`SchurBackend`.
    """

    def __init__(self, problem: Problem, threads: int | None = None) -> None:
        size = np.diff(problem.first).astype(np.int64)
        self.problem = problem
        begins = np.zeros(0, np.int64)

        def grouping(first: Small, image: Small) -> Index:
            nonlocal begins
            number = numbers_of_groups(first, image, size)
            begins = np.cumsum(np.bincount(number)) - np.bincount(number)
            return number

        self.backend = SchurBackend(problem, threads, grouping=grouping)
        #: Part of the free unknowns of each vector, by its number.
        self.parts = dict(vector_parts(problem))
        self.groups = self._grouped(begins)
        #: Names of points that could not be intersected at the last evaluation, by group.
        self.impossible: dict[int, str] = {}
        self._free = problem.image_vector(problem.start)
        self._ground = problem.start.ground.copy()  # where the rows in the buffers were computed
        self._base: dict[int, tuple[Array, Array]] = {}  # free unknowns and points of the last linearised state
        self._rows: list[GroupRows | None] = [None] * len(self.groups)
        self._excess = np.zeros(len(self.groups))
        self._far = True
        self._shrink = 1.0  # factor by which the last step of the points shortened the largest decrement
        self._name = object()  # owner of the buffers; this object itself there would be a reference cycle

    def _grouped(self, begins: Index) -> tuple[PointGroup, ...]:
        """Groups by their first places, and the slots of their blocks."""
        s, problem = self.backend.structure, self.problem
        chunks = np.append(np.searchsorted(s.chunk_places, begins), len(s.chunk_places) - 1)
        slot_chunk = np.searchsorted(s.slot_begin, np.arange(len(s.slot_own)), side="right") - 1
        slot_block = np.empty(len(s.slot_own), np.int64)
        slot_block[s.block_slots] = np.repeat(np.arange(len(s.block_row)), np.diff(s.block_begin))
        slot_group = np.searchsorted(chunks, slot_chunk, side="right") - 1
        order = np.lexsort((np.arange(len(slot_block)), slot_block, slot_group))
        key = slot_group[order] * len(s.block_row) + slot_block[order]
        entry, begin = np.unique(key, return_index=True)
        self._slots = order.astype(s.block_slots.dtype)
        self._begin = np.append(begin, len(order)).astype(np.int64)
        block = entry % len(s.block_row)
        entries = np.searchsorted(entry // len(s.block_row), np.arange(len(chunks)))
        self._row, self._column = s.block_row[block], s.block_column[block]
        out = []
        for g in range(len(chunks) - 1):
            lo, hi = int(chunks[g]), int(chunks[g + 1])
            places = int(s.chunk_places[lo]), int(s.chunk_places[hi])
            points = int(s.first[places[0]]), int(s.first[places[1]])
            images = np.unique(s.image[slice(*points)]).astype(np.int64)
            wide = np.concatenate([np.arange(problem.first[k], problem.first[k + 1]) for k in images])
            own = wide if problem.ties is None else problem.ties.of[wide]
            vectors = [n for n, part in self.parts.items() if ((own >= part.start) & (own < part.stop)).any()]
            free = np.concatenate([np.arange(self.parts[n].start, self.parts[n].stop) for n in vectors] or [wide])
            fold = np.searchsorted(free, own) if problem.ties is not None else None
            out.append(PointGroup(
                (lo, hi), places, points, images, wide, tuple(vectors), free, fold,
                (int(entries[g]), int(entries[g + 1])),
            ))  # fmt: skip
        return tuple(out)

    def hold_weights(self, robust: Weighing | None, state: State) -> None:
        """Give the rows the weights of a loss at a state, until the next call; the cost there is that of the loss.

        Elsewhere the cost is not below the loss's. The weights are held because a redescending loss gives a point
        several minima.
        """
        backend, b = self.backend, self.backend.buffers
        backend.robust, b.root_weight, b.control = None, np.ones(0), self.problem.control_records
        self._excess[:], self._rows = 0.0, [None] * len(self.groups)
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
        """Rows of all groups where they were evaluated last; each must have been evaluated."""
        assert all(rows is not None for rows in self._rows)
        return tuple(rows for rows in self._rows if rows is not None)

    def require_possible(self) -> None:
        """Raise NoSolutionError if the rays of a point did not intersect at the last evaluation."""
        if self.impossible:
            why = next(iter(self.impossible.values()))
            raise NoSolutionError.of("adjust.broken_down", place=self.problem.block.name, why=why)

    def release(self) -> None:
        """Give the buffers to other users of the backend: all groups are computed again afterwards."""
        b = self.backend.buffers
        self._rows, self._base = [None] * len(self.groups), {}
        b.owner, b.held, b.root_weight, b.control = None, None, np.ones(0), self.problem.control_records

    def start_at(self, free: Array, ground: Array) -> None:
        """Begin at image unknowns (u,) and ground points (N, 3): all groups are computed again from there."""
        self._free, self._ground, self._base = free.copy(), ground.copy(), {}
        self._rows = [None] * len(self.groups)

    def rows(self, g: int, own: Array, everything: Callable[[], Array], *, accepted: bool) -> GroupRows:
        """Rows of a group.

        Parameters
        ----------
        g : int
        own : (n,) array
            Values of ``groups[g].free``.
        everything : callable
            Gives the values (u,) of all unknowns, nan for those without one: all groups whose unknowns have changed
            are computed together.
        accepted : bool
            Whether the optimiser linearises here: points are predicted from the last such place.
        """
        found = self._rows[g]
        if found is None or not np.array_equal(found.at, own):
            free = everything()
            self._evaluate([k for k in range(len(self.groups)) if self._stale(k, free)], free)
            found = self._rows[g]
            assert found is not None
        if accepted and g not in self.impossible:
            number = self.backend.structure.number[slice(*self.groups[g].places)]
            self._base[g] = found.at, self._ground[number]
        return found

    def _stale(self, g: int, free: Array) -> bool:
        rows, own = self._rows[g], free[self.groups[g].free]
        return bool(np.isfinite(own).all()) and (rows is None or not np.array_equal(rows.at, own))

    def state(self, free: Array, *, complete: bool = False) -> State:
        """State with the points of the last evaluation; ``complete`` moves them by their last Newton step."""
        image = self.problem.image_matrix(free)
        if not complete:
            return State(image, self._ground.copy())
        step = np.zeros((len(self.backend.structure.number), 3))
        self._substitute(list(range(len(self.groups))), np.zeros(len(free)), step)
        return self.backend.moved(State(image, self._ground), np.zeros(len(free)), step)

    # one evaluation

    def _evaluate(self, groups: Sequence[int], free: Array) -> None:
        """Compute groups: predict their points, intersect, eliminate, factorise."""
        full = np.where(np.isfinite(free), free, self._free)
        self._far = not self._base or float(np.abs(full - self._free).max(initial=0.0)) > SMALL_STEP
        self._predict(groups, full)
        self._free = full
        state = State(self.problem.image_matrix(full), self._ground)
        good = self._intersect(groups, state)
        self._assemble(good, full)
        for g in groups:
            if g not in good:
                own, places = full[self.groups[g].free], slice(*self.groups[g].places)
                number = self.backend.structure.number[places]
                self._ground[number] = self._base[g][1] if g in self._base else self.problem.start.ground[number]
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
                known.append(g)  # its elimination is in the buffers
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
                self._ground[s.number[places]] += ground[places]
        for g in back:
            self._ground[s.number[slice(*self.groups[g].places)]] = self._base[g][1]

    def _substitute(self, groups: Sequence[int], step: Array, ground: Array) -> None:
        """Steps (P, 3) of the points of groups after a step (u,) of the images, from the elimination in the buffers."""
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
        """Tiles, and the ranges of their chunks that belong to groups."""
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

    def _intersect(self, groups: Sequence[int], state: State) -> set[int]:
        """Intersect the points of groups with the images held; the groups that could be, eliminated."""
        self.impossible = {g: why for g, why in self.impossible.items() if g not in groups}
        try:
            self._newton(groups, state)
            return set(groups)
        except (NotFiniteError, NotIntersected, Singular):
            return {g for g in groups if self._is_possible(g, state)}

    def _is_possible(self, g: int, state: State) -> bool:
        """Whether the points of a group can be intersected; if not, the reason is recorded."""
        try:
            self._newton([g], state)
        except (NotFiniteError, NotIntersected, Singular) as error:
            self.impossible[g] = str(error)
            return False
        return True

    def _newton(self, groups: Sequence[int], state: State) -> None:
        """Newton's steps of the points of groups until all are intersected; the last elimination is in the buffers."""
        s, places = self.backend.structure, np.concatenate([np.arange(*self.groups[g].places) for g in groups])
        number = s.number[places]
        last_cost: Array | None = None
        last_ground, largest = state.ground[number], math.inf
        step = np.zeros((len(s.number), 3))
        near = not self._far
        for _ in range(MAX_STEPS):
            self._eliminate(groups, state, near=near)
            decrement, before = self._decrements(places), largest
            largest = float(decrement.max(initial=0.0))
            if before < math.inf:
                self._shrink = min(largest / before, 1.0)
            if largest <= INTERSECTED:
                break
            self._substitute(groups, np.zeros(len(self._free)), step)
            here = state.ground[number]
            ahead = here + step[places]
            if largest > SAFE or last_cost is not None:
                cost = self._point_costs(state)[places]
                if last_cost is not None:
                    worse = (cost > last_cost * (1.0 + 1e-12)) & (decrement > INTERSECTED)
                    ahead[worse] = 0.5 * (here[worse] + last_ground[worse])
                    here, cost = np.where(worse[:, None], last_ground, here), np.where(worse, last_cost, cost)
                last_cost, last_ground = cost, here
            state.ground[number] = ahead
            near = largest * self._shrink <= INTERSECTED
        else:
            if largest > STALLED:
                name = self.problem.block.points.ids[int(number[int(decrement.argmax())])]
                raise NotIntersected(f"the rays of point {name} do not intersect near its last position")
            self._eliminate(groups, state, near=near)
        self._sum(groups, state, near=near)

    def _eliminate(self, groups: Sequence[int], state: State, *, near: bool) -> None:
        """Rows and point blocks of groups at a state.

        Rows that are not kept are used for the sums of pairs, which cost most, if the points are ``near`` the
        intersection.
        """
        wide = self.backend.structure.widened(state.image)
        for tile, lo, hi in self._ranges(groups):
            self._chunks(tile, lo, hi, state, wide, pairs=near and not tile.kept)

    def _sum(self, groups: Sequence[int], state: State, *, near: bool) -> None:
        """Sums of the pairs of rays of eliminated groups; ``near``: of the kept rows only, the others are done."""
        wide = self.backend.structure.widened(state.image)
        for tile, lo, hi in self._ranges(groups):
            if tile.kept or not near:
                self._chunks(tile, lo, hi, state, None if tile.kept else wide, pairs=True)

    def _chunks(self, tile: Tile, lo: int, hi: int, state: State, wide: Array | None, *, pairs: bool) -> None:
        """Eliminate the points of chunks of a tile; see :meth:`Stages.chunks`."""
        backend, b = self.backend, self.backend.buffers
        b.owner = self._name
        backend.workers.run(
            backend.stages.chunks, backend.structure.cost[lo : hi + 1], b.rows(tile), state, wide, 0.0, b, pairs,
            start=lo,
        )  # fmt: skip
        b.held = b.held if tile.kept else None

    def _decrements(self, places: Index) -> Array:
        """Newton decrements (n,) of points in sigmas: roots of twice the decrease that a Newton step predicts."""
        b = self.backend.buffers
        return np.asarray(np.sqrt(_squares(b.root[places], b.gradient[places])))

    def _point_costs(self, state: State) -> Array:
        """Half the sum of squares (P,) of the rays and the control equations of each point."""
        s, b = self.backend.structure, self.backend.buffers
        squares = np.einsum("ni,ni->n", b.value, b.value)
        out = 0.5 * np.add.reduceat(squares, s.first[:-1])
        out[s.free == 2] += 0.5 * self.backend.control_squares(state, b.control)
        return np.asarray(out)

    def _assemble(self, groups: set[int], free: Array) -> None:
        """Matrix, gradient and cost of groups, as rows."""
        backend, s, b = self.backend, self.backend.structure, self.backend.buffers
        if not groups:
            return
        blocks = np.empty((len(self._row), s.wide.shape[1], s.wide.shape[1]))
        first, end = min(self.groups[g].entries[0] for g in groups), max(self.groups[g].entries[1] for g in groups)
        backend.workers.run(
            gather_blocks, end - first, self._begin, self._slots, s.slot_own, self._row, self._column, b.sums,
            s.wide, s.scale, s.size, s.n_basis, s.n_components, blocks, start=first,
        )  # fmt: skip
        control = backend.control_squares(State(self.problem.image_matrix(free), self._ground), b.control)
        place = np.flatnonzero(s.free == 2)
        for g in groups:
            group = self.groups[g]
            lo, hi = group.entries
            gradient = np.zeros(self.problem.n_image_unknowns)
            gather_gradients(
                self._begin[lo : hi + 1], self._slots, s.slot_own, self._row[lo:hi], self._column[lo:hi], b.gradients,
                s.wide, s.scale, s.size, s.n_components, gradient,
            )  # fmt: skip
            own = gradient[group.wide]
            if group.fold is None:
                matrix = self._matrix(group, blocks)
            else:
                own = np.bincount(group.fold, own, len(group.free)).astype(float)
                matrix = np.zeros((len(own), len(own)))
                of = np.zeros(len(gradient), np.int64)
                of[group.wide] = group.fold
                add_shared(
                    self._row[lo:hi], self._column[lo:hi], self.problem.first, of, s.size, blocks[lo:hi], matrix
                )  # fmt: skip
            value = b.value[slice(*group.points)]
            inside = slice(*np.searchsorted(place, group.places))
            at = slice(*group.places)
            points = control[inside].sum() - _squares(b.root[at], b.gradient[at]).sum()
            total = float(np.vdot(value, value) + points) + 2.0 * self._excess[g]
            self._rows[g] = GroupRows(free[group.free], matrix, own, total)

    def _matrix(self, group: PointGroup, blocks: Array) -> Array:
        """Reduced normal matrix (w, w) of the images of a group."""
        size, entries = self.backend.structure.size[group.images], slice(*group.entries)
        m, widest = len(size), int(size.max(initial=0))
        a, b = (np.searchsorted(group.images, k[entries]) for k in (self._row, self._column))
        own = blocks[entries, :widest, :widest]
        out = np.zeros((m, widest, m, widest))
        out[b, :, a, :] = own.transpose(0, 2, 1)
        out[a, :, b, :] = own
        used = np.flatnonzero(np.arange(widest) < size[:, None])
        whole = out.reshape(m * widest, m * widest)
        return whole if len(used) == len(whole) else whole[np.ix_(used, used)]


def _squares(root: Array, gradient: Array) -> Array:
    """Squares (n,) of R g of points: twice the decrease that a Newton step predicts."""
    r, g = root.T, gradient.T
    return np.asarray(
        (r[ROOT.r00] * g[0]) ** 2
        + (r[ROOT.r10] * g[0] + r[ROOT.r11] * g[1]) ** 2
        + (r[ROOT.r20] * g[0] + r[ROOT.r21] * g[1] + r[ROOT.r22] * g[2]) ** 2
    )
