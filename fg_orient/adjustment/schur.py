"""Schur backend: the problem as arrays, with ground points eliminated by compiled kernels.

It solves the same normal equations as the graph, without Python calls per observation: linearisation, 3 x 3 point
blocks, reduced camera system, its solution (``fg_orient.adjustment.reduced_systems``), back-substitution. The order of
all sums, and therefore every bit of the results, is independent of the number of threads.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from factors.arrays import Array
from factors.conditions.control import POINT
from fg_orient.adjustment.iterative_reduced import ImplicitProduct
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.problem import Problem, State, no_point_is_named
from fg_orient.adjustment.reduced_choice import ITERATIVE, Choice, choice_of
from fg_orient.adjustment.reduced_systems import REDUCED, ReducedSystems
from fg_orient.adjustment.robust import Weighing, together, two_ray_rows
from fg_orient.adjustment.runtime import Index, Workers, threads_for
from fg_orient.adjustment.schur_reduced import Reduced, Singular
from fg_orient.adjustment.schur_stages import Buffers, ImageExtras, Stages, TileRows, half_extras
from fg_orient.adjustment.schur_structure import Grouping, Structure, Tile, compile_structure
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients, image_gradients
from fg_orient.kernels.batch_points import control_squares, move, product, scale_rows
from fg_orient.model.errors import InputError


@dataclass(frozen=True)
class SchurStep:
    """Step; see ``loop.Step``: ``image`` (u,) prior sigmas, ``ground`` (P, 3) m, states before and after it."""

    image: Array
    ground: Array
    length: float
    predicted_error: float
    before: State
    after: State

    @property
    def norm(self) -> float:
        """Euclidean norm."""
        return float(np.sqrt(np.sum(self.image**2) + np.sum(self.ground**2)))


class Blended(ABC):
    """Linearisation that also gives dogleg steps: for remaining unknowns (u,) and eliminated points (P, 3)."""

    @abstractmethod
    def solve(self, damping: float) -> SchurStep:
        """Return the step with ``damping`` times the identity added."""

    @abstractmethod
    def gradient(self) -> tuple[Array, Array]:
        """Return the gradient (u,), (P, 3)."""

    @abstractmethod
    def curvature(self, image: Array, ground: Array) -> float:
        """Return the squares of the whitened Jacobian times a direction (u,), (P, 3)."""

    @abstractmethod
    def given(self, image: Array, ground: Array) -> SchurStep:
        """Return a given step (u,), (P, 3), with the error that the linear model predicts after it."""

    def dogleg(self, radius: float) -> SchurStep:
        """Return a blend of the steepest-descent and the Gauss-Newton step."""
        newton = self.solve(0.0)
        if newton.norm <= radius:
            return newton
        image, ground = self.steepest()
        squares = np.sum(image**2) + np.sum(ground**2)
        length = float(np.sqrt(squares))
        if length >= radius:
            return self.given(image * (radius / length), ground * (radius / length))
        d_image, d_ground = newton.image - image, newton.ground - ground
        across = float(np.sum(d_image**2) + np.sum(d_ground**2))
        dot = float(np.sum(image * d_image) + np.sum(ground * d_ground))
        share = share_at_radius(across, dot, length, radius)
        return self.given(image + share * d_image, ground + share * d_ground)

    def steepest(self) -> tuple[Array, Array]:
        """Return the step (u,), (P, 3) to the minimum of the linear model along the negative gradient."""
        image, ground = self.gradient()
        factor = -float((np.sum(image**2) + np.sum(ground**2)) / self.curvature(image, ground))
        return image * factor, ground * factor


class SchurSystem(Blended):
    """One linearisation; see ``loop.System``.

    Its rows are in the buffers of the backend. If another linearisation has replaced them, they are computed again.
    """

    def __init__(self, backend: SchurBackend, state: State) -> None:
        self._backend, self.state = backend, state
        self._name = object()  # owner of the buffers; a reference to the system itself would be a cycle
        self._newton: SchurStep | None = None
        self._robust, self._excess = backend.robust, 0.0
        self._eliminated_at: float | None = None
        self._extras = ImageExtras(backend.problem, state)
        self._fill()
        values = (backend.buffers.value[slice(*tile.points)] for tile in self.structure.tiles)
        self.error = self._excess + backend.half_squares(values, state, backend.buffers.control)

    @property
    def backend(self) -> SchurBackend:
        """Backend that made this linearisation."""
        return self._backend

    @property
    def structure(self) -> Structure:
        """Arrays of the problem."""
        return self._backend.structure

    def _fill(self) -> None:
        b, backend = self._backend.buffers, self._backend
        b.held, b.root_weight, b.owner, self._eliminated_at = None, np.ones(0), self._name, None
        b.control = backend.problem.control_records
        if self._robust is None and backend.last_damping == 0.0:
            # the next Gauss-Newton step needs the elimination; now the rows are still in the cache
            with contextlib.suppress(Singular):
                self._eliminate(0.0, fresh=True)
                return
        b.held = None
        for tile in self.structure.tiles:
            backend.evaluate(b.rows(tile), self.state, want=tile.kept)
        if self._robust is not None:
            self._weigh(self._robust, b)

    def _weigh(self, robust: Weighing, b: Buffers) -> None:
        """Multiply all rows by the roots of their weights; store the cost minus half their sum of squares."""
        observed = self._backend.structure.observed
        control_squares = self._backend.control_squares(self.state)
        image_squares = together(np.einsum("ni,ni->n", b.value, b.value), self._backend.pairs)
        image, control, cost = robust.weigh(image_squares, control_squares)
        self._excess = cost - 0.5 * float(np.vdot(image, image_squares) + np.vdot(control, control_squares))
        b.root_weight = np.sqrt(image)
        for tile in self._backend.structure.tiles:
            if tile.kept:
                self._scale(b.rows(tile), b.root_weight)
            else:
                b.value[slice(*tile.points)] *= b.root_weight[slice(*tile.points), None]
        b.control = b.control.copy()
        b.control[observed, POINT.whitening] *= np.sqrt(control)[:, None]

    def _scale(self, rows: TileRows, root_weight: Array) -> None:
        part = root_weight[slice(*rows.tile.points)]
        self._backend.workers.run(scale_rows, len(part), part, rows.value, rows.d_image, rows.d_ground)

    def buffers(self) -> Buffers:
        """Return the arrays of this linearisation."""
        if self._backend.buffers.owner is not self._name:
            self._fill()
        return self._backend.buffers

    @property
    def choice(self) -> Choice | None:
        """Method for the reduced system, and its prediction."""
        return self._backend.reduced.choice

    def release(self) -> None:
        """Free the arrays of this linearisation, 0.1 kB for each image point; they are computed again if needed."""
        self._backend.buffers = Buffers(self.structure, self._backend.problem.control_records)
        self._backend.stages.release()

    def rows(self, tile: Tile) -> TileRows:
        """Return the whitened, weighted rows of a tile; rows that are not kept are overwritten by the next tile."""
        b = self.buffers()
        rows = b.rows(tile)
        if not tile.kept and b.held is not tile:
            self._backend.evaluate(rows, self.state, want=True)
            if len(b.root_weight):
                self._scale(rows, b.root_weight)
            b.held = tile
        return rows

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the points; return the reduced camera system with ``damping`` times the identity added.

        Singular if a ground point, or the reduced system, is not determined.
        """
        return self._reduced(self._eliminated(damping), damping)

    def _reduced(self, blocks: Array, damping: float) -> Reduced:
        """Return the reduced system of these blocks, with priors, damping and observations of several images."""
        backend = self._backend
        implicit = ImplicitProduct(self, damping) if backend.implicit else None
        return backend.reduced(blocks, backend.prior + damping, self._extras.matrix, 2.0 * self.error, implicit)

    @property
    def joined(self) -> Array | None:
        """``J^T J`` (z, z) of the observations of several images; None without such observations."""
        return self._extras.matrix

    def partial(self, damping: float) -> tuple[Array, Array]:
        """Eliminate the points.

        Return blocks (B, k, k) without priors and damping of the images, and the gradient (u,).

        Observations of several images are only in the gradient. The results are contributions to the reduced normal
        equations of a larger block. Singular if a ground point is not determined.
        """
        blocks = self._eliminated(damping)
        return blocks, self._gathered_gradient()

    def eliminated_buffers(self, damping: float) -> Buffers:
        """Return the arrays of this linearisation, with the points eliminated under this damping."""
        b = self.buffers()
        if self._eliminated_at != damping or not b.has_sums:
            self._eliminate(damping)
        return b

    def _eliminated(self, damping: float) -> Array:
        """Return the blocks (B, k, k) of the reduced system; point blocks and gradients are in the buffers."""
        s, b = self.structure, self.eliminated_buffers(damping)
        self._backend.workers.run(
            gather_blocks, s.block_begin, s.block_begin, s.block_slots, s.slot_own, s.block_row, s.block_column, b.sums,
            s.wide, s.scale, s.size, s.n_basis, s.n_components, b.blocks,
        )  # fmt: skip
        self._extras.add_blocks(s.own_block, b.blocks)
        return b.blocks

    def _eliminate(self, damping: float, *, fresh: bool = False) -> None:
        """Eliminate the points, one tile after the other; with ``fresh`` all rows are computed before."""
        s, backend = self.structure, self._backend
        b = backend.buffers if fresh else self.buffers()
        self._eliminated_at, backend.last_damping, wide = None, damping, s.widened(self.state.image)
        for tile in s.tiles:
            lo, hi = tile.chunks
            self._share_out(tile, backend.stages.chunks, s.cost[lo : hi + 1], wide, damping, b, fresh=fresh)
        self._eliminated_at = damping

    def _share_out(
        self, tile: Tile, stage: Callable[..., None], cuts: int | Index, wide: Array, *more: Any, fresh: bool = False
    ) -> None:  # fmt: skip
        """Run a stage over the chunks of a tile; it computes missing rows, or all rows if ``fresh``."""
        b = self._backend.buffers
        there = not fresh and (tile.kept or b.held is tile)
        at = (b.rows(tile), self.state, None if there else wide, *more)
        self._backend.workers.run(stage, cuts, *at, start=tile.chunks[0])
        b.held = b.held if tile.kept else tile

    def _gathered_gradient(self) -> Array:
        """Assemble the gradient (u,) of the image unknowns from the gradients of the chunks."""
        s, problem, own = self.structure, self._backend.problem, self._extras.gradient.copy()
        gather_gradients(
            s.block_begin, s.block_slots, s.slot_own, s.block_row, s.block_column, self.buffers().gradients,
            s.wide, s.scale, s.size, s.n_components, own,
        )  # fmt: skip
        free = own if problem.ties is None else problem.ties.summed(own)
        return free + self._backend.prior * problem.image_vector(self.state)

    def solve(self, damping: float) -> SchurStep:
        """Eliminate the points, solve for the images, substitute back; RuntimeError for singular equations."""
        damping = max(damping, self._backend.problem.least_damping)
        if damping == 0.0 and self._newton is not None:
            return self._newton
        blocks, gradient = self.partial(damping)
        step = self.substitute(self._reduced(blocks, damping).solve(gradient), damping)
        if damping == 0.0:
            self._newton = step
        return step

    def substitute(self, image: Array, damping: float) -> SchurStep:
        """Complete a step (u,) of the images, which was computed with this damping, by the steps of the points."""
        backend, s, b = self._backend, self.structure, self.buffers()
        if self._eliminated_at != damping:
            self._eliminate(damping)
        ground, wide = np.zeros((len(s.number), 3)), s.widened(backend.problem.image_matrix(image))
        own = s.widened(self.state.image)
        for tile in reversed(s.tiles):
            n_chunks = tile.chunks[1] - tile.chunks[0]
            self._share_out(tile, backend.stages.substituted, n_chunks, own, wide, b, ground)
        return self._step(image, ground, float(b.squares.sum()))

    def gradient(self) -> tuple[Array, Array]:
        """Return the gradient of the images (u,) and of the points (P, 3)."""
        s, b = self.structure, self.buffers()
        self._eliminated_at = None
        for tile in s.tiles:
            rows, (lo, hi), (begin, end) = self.rows(tile), tile.chunks, tile.places
            self._backend.workers.run(
                self._backend.stages.points, end - begin, rows, self.state, 0.0, b, start=begin
            )  # fmt: skip
            self._backend.workers.run(
                image_gradients, hi - lo, s.chunks, s.pieces, s.slots, s.slot_begin, s.image, s.n_basis, s.n_components,
                s.basis, tile.points[0], rows.value, rows.d_image, b.gradients, start=lo,
            )  # fmt: skip
        return self._gathered_gradient(), b.gradient.copy()

    def curvature(self, image: Array, ground: Array) -> float:
        """Return the squares of the whitened Jacobian times a direction (u,), (P, 3)."""
        own = self._backend.prior * np.sum(image**2) + self._extras.squares_along(image, 0.0)
        return float(self._squares_along(image, ground, 0.0) + own + self._whitened_squares(ground))

    def _squares_along(self, image: Array, ground: Array, share: float) -> float:
        """Return the squares of ``share`` of the residuals of the image points plus their Jacobian times a step."""
        backend, s, b = self._backend, self.structure, self.buffers()
        wide = s.widened(backend.problem.image_matrix(image))
        for tile in s.tiles:
            rows, (lo, hi) = self.rows(tile), tile.chunks
            backend.workers.run(
                product, hi - lo, s.chunk_places, s.first, s.free, s.image, s.n_basis, s.n_components, s.basis, wide,
                tile.points[0], share, rows.value, rows.d_image, rows.d_ground, ground, b.squares, start=lo,
            )  # fmt: skip
        return float(np.sum(b.squares))

    def _whitened_squares(self, ground: Array) -> float:
        """Return the sum of squares of the control-point rows times a step (P, 3)."""
        s = self._backend.structure
        w = self.buffers().control[s.observed, POINT.whitening].reshape(-1, 3, 3)
        return float(np.sum(np.einsum("nij,nj->ni", w, ground[s.free == 2]) ** 2))

    def given(self, image: Array, ground: Array) -> SchurStep:
        """Return a given step (u,), (P, 3), with the error that the linear model predicts after it."""
        return self._step(image, ground, self._squares_along(image, ground, 1.0))

    def _step(self, image: Array, ground: Array, squares: float) -> SchurStep:
        backend = self._backend
        moved = backend.moved(self.state, image, ground)
        own = self._extras.squares_along(image, 1.0)
        error = self._excess + backend.half_linear(moved, self.buffers().control) + 0.5 * (squares + own)
        length = max(float(np.abs(image).max()), float(np.abs(ground).max(initial=0.0)))
        return SchurStep(image, ground, length, error, self.state, moved)


class SchurBackend:
    """The problem compiled to arrays; ``fg_orient.adjustment.loop`` iterates on it.

    Parameters
    ----------
    problem : Problem
    threads : int, optional
        Threads of the kernels; by default by the number of image points, see ``runtime.threads_for``.
    reduced : str
        "dense", "banded": Cholesky factor of the reduced matrix or of its band; "graph": GTSAM on its blocks;
        "iterative", "implicit": conjugate gradients on its blocks, or on the rows without blocks. "auto": chosen by
        predicted work and memory (``fg_orient.adjustment.reduced_choice``); "blocks": chosen among the methods with
        blocks, for :meth:`SchurSystem.partial`.
    grouping : callable, optional
        Function that returns the number of the group of each ground point; a chunk contains points of one group.

    Raises
    ------
    InputError
        Extra observations name ground points.
    """

    name = "schur"

    def __init__(
        self, problem: Problem, threads: int | None = None, reduced: str = "auto", grouping: Grouping | None = None
    ) -> None:
        if not no_point_is_named(problem.block):
            raise InputError.of("adjust.schur", option="backend", value="extra observations name ground points")
        if reduced not in REDUCED:
            raise ValueError(f"reduced = {reduced!r}: one of {', '.join(REDUCED)}")
        self.problem, self._kind, self._choice = problem, reduced, None
        alone = problem.ties is None and not problem.block.extra and grouping is None
        if reduced == "auto" and alone and problem.n_image_unknowns > ITERATIVE:
            self._choice = choice_of(problem)
        kind = reduced if self._choice is None else self._choice.kind
        #: True if the reduced matrix is never formed.
        self.implicit = kind == "implicit" and alone
        self.structure = compile_structure(problem, grouping, diagonal=self.implicit)
        self.workers = Workers(threads_for(len(problem.observations)) if threads is None else threads)
        self.prior = 1.0 if problem.block.options.priors else 0.0
        self.stages = Stages(problem, self.structure)
        self.buffers = Buffers(self.structure, problem.control_records)
        self.robust: Weighing | None = None
        self.last_damping = None if problem.block.options.optimizer == "levenberg-marquardt" else 0.0

    @cached_property
    def reduced(self) -> ReducedSystems:
        """Reduced systems of the images."""
        at = self.structure.pattern, self.problem.first, self._kind, self.problem.ties
        return ReducedSystems(*at, self._choice, self.workers.threads)

    def initial(self) -> State:
        """Return the start values."""
        return self.problem.start

    def linearise(self, state: State) -> SchurSystem:
        """Linearise at a state; NotFiniteError names an observation with a residual or Jacobian of nan or inf."""
        return SchurSystem(self, state)

    def error(self, state: State) -> float:
        """Return half the weighted sum of squares, or the cost under the loss; see :meth:`linearise`."""
        if self.robust is None:
            return self.half_squares(self._values(state), state)
        _, _, cost = self.robust.weigh(*self.squares(state))
        return cost + 0.5 * self.prior * self.problem.prior_squares(state) + half_extras(self.problem, state)

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``stages.RobustBackend``; image points in the order of the structure."""
        image = [np.einsum("ni,ni->n", value, value) for value in self._values(state)]
        return together(np.concatenate(image), self.pairs), self.control_squares(state)

    @cached_property
    def pairs(self) -> Index:
        """Rows (p, 2) of ``robust.two_ray_rows`` in the order of the structure."""
        return np.asarray(np.argsort(self.structure.row)[two_ray_rows(self.problem)])

    def _values(self, state: State) -> Iterator[Array]:
        """Yield the residuals (n, 2) of one tile after the other; the next tile overwrites them."""
        for tile in self.structure.tiles:
            space = self.buffers.rows(tile)
            value = self.buffers.trial[: tile.points[1] - tile.points[0]]
            self.evaluate(TileRows(tile, value, space.d_image, space.d_ground), state, want=False)
            yield value

    def control_squares(self, state: State, records: Array | None = None) -> Array:
        """Return squared norms (m,) of whitened residuals of observed control points, from records (N, 12)."""
        out = np.empty(len(self.structure.observed))
        records = self.problem.control_records if records is None else records
        control_squares(state.ground, records, self.structure.observed, out)
        return out

    def retract(self, state: State, step: SchurStep) -> State:
        """Return the state after a step."""
        return step.after if state is step.before else self.moved(state, step.image, step.ground)

    def moved(self, state: State, image: Array, ground: Array) -> State:
        """Move a state by image unknowns (u,) and points (P, 3)."""
        moved = state.ground.copy()
        move(self.structure.number, ground, moved)
        return State(state.image + self.problem.image_matrix(image), moved)

    def evaluate(self, rows: TileRows, state: State, *, want: bool) -> None:
        """Write the residuals of a tile's image points and, if requested, their Jacobians; see :meth:`linearise`."""
        (lo, hi), wide = rows.tile.points, self.structure.widened(state.image)
        self.workers.run(self.stages.rows, hi - lo, rows, state, wide, want, start=lo)

    def half_squares(self, values: Iterable[Array], state: State, records: Array | None = None) -> float:
        """Return half the weighted sum of squares, from whitened residuals of the image points and control records."""
        return self.half_linear(state, records) + half_extras(self.problem, state) + 0.5 * sum(
            float(np.vdot(v, v)) for v in values
        )  # fmt: skip

    def half_linear(self, state: State, records: Array | None = None) -> float:
        """Return half the weighted sum of squares of control points and priors."""
        control = self.control_squares(state, records)
        return 0.5 * float(control.sum() + self.prior * self.problem.prior_squares(state))
