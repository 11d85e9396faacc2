"""The Schur backend: the problem as arrays, ground points eliminated by compiled kernels.

The same normal equations as the graph's, with no Python work per observation: linearise, 3 x 3 point blocks, reduced
camera system, solution (``fg_orient.adjustment.schur_reduced``), back-substitution. Priors and control points are those
of ``factors.control``. Sums run in an order that does not depend on the number of threads: the same bits for any.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.batch_pairs import gather_blocks, image_gradients, pair_blocks
from factors.batch_points import back_substitute, point_blocks, product
from factors.batch_weights import scale_rows
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur_reduced import REDUCED, Reduced, ReducedSystems, Singular
from fg_orient.adjustment.schur_structure import SERIAL_LIMIT, Structure, Workers, compile_structure, reason_against
from fg_orient.errors import InputError

Array = npt.NDArray[np.float64]

#: More threads are of no use: memory is shared.
MAX_THREADS: Final = 2


@dataclass(frozen=True)
class SchurStep:
    """A step; see ``loop.Step``. ``image`` (u,) prior sigmas, ``ground`` (P, 3) m."""

    image: Array
    ground: Array
    length: float
    predicted_error: float

    @property
    def data(self) -> tuple[Array, Array]:
        """Both parts."""
        return self.image, self.ground

    @property
    def norm(self) -> float:
        """Euclidean norm."""
        return float(np.sqrt(np.sum(self.image**2) + np.sum(self.ground**2)))


class _Buffers:
    """Arrays of one linearisation, used again by the next: fresh memory costs more than what is computed in it."""

    def __init__(self, backend: SchurBackend) -> None:
        s = backend.structure
        n, p = len(s.row), len(s.number)
        self.owner: SchurSystem | None = None
        self.value, self.after = np.empty((n, 2)), np.empty((n, 2))
        self.d_image, self.d_ground = np.zeros((n, 2, int(s.n_components.max()))), np.zeros((n, 2, 3))
        self.root, self.gradient = np.empty((p, 6)), np.empty((p, 3))
        self.sums = np.empty((len(s.cut) - 1, int(s.n_basis.max()) ** 2, int(s.n_components.max()) ** 2))
        self.blocks = np.zeros((len(s.block_row), s.wide.shape[1], s.wide.shape[1]))
        self.wide = np.empty((len(s.size), s.width))
        self.control = backend.problem.control_records  # under a loss, a copy with weights: see SchurSystem


class SchurSystem:
    """One linearisation; see ``loop.System``. It shares memory with its backend and is renewed when it has lost it."""

    def __init__(self, backend: SchurBackend, state: State) -> None:
        self._backend, self.state = backend, state
        self._newton: SchurStep | None = None
        self._robust, self._excess = backend.robust, 0.0
        self._fill()
        self.error = self._excess + backend.half_squares(backend.buffers.value, state, backend.buffers.control)

    @property
    def structure(self) -> Structure:
        """Arrays of the problem."""
        return self._backend.structure

    def _fill(self) -> None:
        b = self._backend.buffers
        self._backend.evaluate(self.state, b.value, want=True)
        b.control = self._backend.problem.control_records
        if self._robust is not None:
            self._weigh(self._robust, b)
        b.owner = self

    def _weigh(self, robust: Robust, b: _Buffers) -> None:
        """Multiply all rows by the roots of their weights; keep by how much the cost exceeds half their squares."""
        s, observed = self._backend.structure, self._backend.structure.observed
        image_squares, control_squares = self._backend.squares_of(b.value, self.state)
        image, control, cost = robust.weigh(image_squares, control_squares)
        self._excess = cost - 0.5 * float(np.vdot(image, image_squares) + np.vdot(control, control_squares))
        self._backend.workers.run(scale_rows, len(s.row), np.sqrt(image), b.value, b.d_image, b.d_ground)
        b.control = b.control.copy()
        b.control[observed, :9] *= np.sqrt(control)[:, None]

    def buffers(self) -> _Buffers:
        """Arrays that hold this linearisation."""
        if self._backend.buffers.owner is not self:
            self._fill()
        return self._backend.buffers

    def reduced(self, damping: float) -> Reduced:
        """Eliminate the points: the reduced camera system, damped by ``damping`` times the identity.

        Raises
        ------
        Singular
            A ground point, or the reduced system, is not determined.
        """
        return self._backend.reduced(self._eliminated(damping), self._backend.prior + damping)

    def partial(self, damping: float) -> tuple[Array, Array]:
        """Eliminate the points: blocks (B, k, k) without priors and damping of the images, and gradient (u,).

        They are what these points add to the reduced normal equations of a larger block.

        Raises
        ------
        Singular
            A ground point is not determined.
        """
        blocks = self._eliminated(damping)
        return blocks, self._image_gradient(True)

    def _eliminated(self, damping: float) -> Array:
        """Blocks (B, k, k) of the reduced system; leaves the point blocks in the buffers."""
        backend, s, problem, b = self._backend, self._backend.structure, self._backend.problem, self.buffers()
        bad = backend.workers.run(
            point_blocks, len(s.number), s.first, s.number, s.free, b.control, self.state.ground, b.value,
            b.d_ground, damping, b.root, b.gradient,
        )  # fmt: skip
        for p in bad:
            if p >= 0:
                raise Singular(f"point {problem.block.points.ids[s.number[p]]} is not determined by its rays")
        backend.workers.run(
            pair_blocks, s.cut, s.cut, s.left, s.right, s.image, s.place, s.n_basis, s.n_components, s.basis,
            b.d_image, b.d_ground, b.root, b.sums,
        )  # fmt: skip
        gather_blocks(
            0, len(s.block_row), s.segments, s.block_row, s.block_column, b.sums, s.wide, s.scale, s.size, s.n_basis,
            s.n_components, b.blocks,
        )  # fmt: skip
        return b.blocks

    def _image_gradient(self, reduced: bool) -> Array:
        """Gradient (u,) of the image unknowns; needs the point blocks."""
        backend, s, b = self._backend, self._backend.structure, self.buffers()
        backend.workers.run(
            image_gradients, s.begin, s.begin, s.order, s.place, s.n_basis, s.n_components, s.basis, b.value,
            b.d_image, b.d_ground, b.root, b.gradient, reduced, b.wide,
        )  # fmt: skip
        return s.narrowed(b.wide) + backend.prior * backend.problem.image_vector(self.state)

    def solve(self, damping: float) -> SchurStep:
        """Eliminate the points, solve for the images, substitute back.

        Raises
        ------
        RuntimeError
            The normal equations are singular.
        """
        damping = max(damping, self._backend.problem.least_damping)
        if damping == 0.0 and self._newton is not None:
            return self._newton
        blocks, gradient = self.partial(damping)
        step = self.substitute(self._backend.reduced(blocks, self._backend.prior + damping).solve(gradient))
        if damping == 0.0:
            self._newton = step
        return step

    def substitute(self, image: Array) -> SchurStep:
        """Step of the points after one (u,) of the images; the points must have been eliminated last."""
        backend, s, b = self._backend, self._backend.structure, self.buffers()
        ground, wide = np.zeros((len(s.number), 3)), s.widened(backend.problem.image_matrix(image))
        backend.workers.run(
            back_substitute, len(s.number), s.first, s.image, s.n_basis, s.n_components, s.basis, wide, b.value,
            b.d_image, b.d_ground, b.root, b.gradient, ground, b.after,
        )  # fmt: skip
        return self._step(image, ground, b.after)

    def dogleg(self, radius: float) -> SchurStep:
        """Blend of the steepest-descent and the Gauss-Newton step."""
        newton = self.solve(0.0)
        if newton.norm <= radius:
            return newton
        image, ground = self._steepest()
        squares = np.sum(image**2) + np.sum(ground**2)
        length = float(np.sqrt(squares))
        if length >= radius:
            return self.given(image * (radius / length), ground * (radius / length))
        d_image, d_ground = newton.image - image, newton.ground - ground
        across = float(np.sum(d_image**2) + np.sum(d_ground**2))
        dot = float(np.sum(image * d_image) + np.sum(ground * d_ground))
        share = share_at_radius(across, dot, length, radius)
        return self.given(image + share * d_image, ground + share * d_ground)

    def _steepest(self) -> tuple[Array, Array]:
        """Minimum along the negative gradient."""
        image, ground = self.gradient()
        factor = -float((np.sum(image**2) + np.sum(ground**2)) / self.curvature(image, ground))
        return image * factor, ground * factor

    def gradient(self) -> tuple[Array, Array]:
        """Gradient of the images (u,) and of the points (P, 3)."""
        b, state = self.buffers(), self.state
        self._backend.workers.run(
            point_blocks, len(self._backend.structure.number), self._backend.structure.first,
            self._backend.structure.number, self._backend.structure.free, b.control,
            state.ground, b.value, b.d_ground, 0.0, b.root, b.gradient,
        )  # fmt: skip
        return self._image_gradient(False), b.gradient.copy()

    def curvature(self, image: Array, ground: Array) -> float:
        """Squares of the whitened Jacobian times a direction (u,), (P, 3)."""
        along = self._product(image, ground)
        own = self._backend.prior * np.sum(image**2)
        return float(np.sum(along**2) + own + self._whitened_squares(ground))

    def _product(self, image: Array, ground: Array) -> Array:
        """Jacobian of the image points times a step; overwritten by the next."""
        backend, s, b = self._backend, self._backend.structure, self.buffers()
        wide = s.widened(backend.problem.image_matrix(image))
        backend.workers.run(
            product, len(s.number), s.first, s.free, s.image, s.n_basis, s.n_components, s.basis, wide, b.d_image,
            b.d_ground, ground, b.after,
        )  # fmt: skip
        return b.after

    def _whitened_squares(self, ground: Array) -> float:
        """Sum of squares of the control-point rows times a step (P, 3)."""
        s = self._backend.structure
        w = self.buffers().control[s.observed, :9].reshape(-1, 3, 3)
        return float(np.sum(np.einsum("nij,nj->ni", w, ground[s.free == 2]) ** 2))

    def given(self, image: Array, ground: Array) -> SchurStep:
        """The step (u,), (P, 3) with what the linear model predicts after it."""
        after = self._product(image, ground)
        after += self.buffers().value
        return self._step(image, ground, after)

    def _step(self, image: Array, ground: Array, after: Array) -> SchurStep:
        backend = self._backend
        moved = backend.moved(self.state, image, ground)
        error = self._excess + backend.half_squares(after, moved, self.buffers().control)
        length = max(float(np.abs(image).max()), float(np.abs(ground).max(initial=0.0)))
        return SchurStep(image, ground, length, error)


class SchurBackend:
    """The problem as arrays, driven by ``fg_orient.adjustment.loop``.

    Parameters
    ----------
    problem : Problem
    threads : int, optional
        Threads of the kernels; by default two where the machine has them, one below 2000 image points.
    reduced : str
        "dense": LAPACK on the full reduced matrix; "graph": GTSAM on its blocks; "auto": by size.

    Raises
    ------
    InputError
        The block has own observations, or a sensor whose equation has no batch.
    """

    name = "schur"

    def __init__(self, problem: Problem, threads: int | None = None, reduced: str = "auto") -> None:
        reason = reason_against(problem)
        if reason:
            raise InputError.of("adjust.schur", place="backend", value=reason)
        if reduced not in REDUCED:
            raise ValueError(f"reduced = {reduced!r}: one of {', '.join(REDUCED)}")
        self.problem, self.structure = problem, compile_structure(problem)
        available = min(MAX_THREADS, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else MAX_THREADS)
        automatic = available if len(problem.observations) >= SERIAL_LIMIT else 1
        self.workers = Workers(automatic if threads is None else threads)
        self.prior = 1.0 if problem.block.options.priors else 0.0
        self.reduced = ReducedSystems(self.structure, problem.first, reduced)
        self.buffers = _Buffers(self)
        self.robust: Robust | None = None

    def initial(self) -> State:
        """Start values."""
        return self.problem.start

    def linearise(self, state: State) -> SchurSystem:
        """Linearise at a state.

        Raises
        ------
        NotFiniteError
            A residual or Jacobian is nan or inf; names the observation.
        """
        return SchurSystem(self, state)

    def error(self, state: State) -> float:
        """Half the weighted sum of squares, or the cost under the loss; see :meth:`linearise`."""
        value = self.evaluate(state, self.buffers.after, want=False)
        if self.robust is None:
            return self.half_squares(value, state)
        _, _, cost = self.robust.weigh(*self.squares_of(value, state))
        return cost + 0.5 * self.prior * float(np.sum(state.image**2))

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``; image points in the order of the structure."""
        return self.squares_of(self.evaluate(state, self.buffers.after, want=False), state)

    def squares_of(self, value: Array, state: State) -> tuple[Array, Array]:
        """Squared norms of image points from their residuals (n, 2), and of control points."""
        control = self._control_residuals(state, self.problem.control_records)
        return np.einsum("ni,ni->n", value, value), np.asarray(np.sum(control**2, axis=1))

    def retract(self, state: State, step: SchurStep) -> State:
        """State after a step."""
        return self.moved(state, step.image, step.ground)

    def moved(self, state: State, image: Array, ground: Array) -> State:
        """State moved by image unknowns (u,) and points (P, 3)."""
        moved = state.ground.copy()
        moved[self.structure.number] += ground
        return State(state.image + self.problem.image_matrix(image), moved)

    def evaluate(self, state: State, value: Array, *, want: bool) -> Array:
        """Write the residuals of all image points into ``value`` and, if wanted, Jacobians into the buffers."""
        s, wide = self.structure, self.structure.widened(state.image)
        for group in s.groups:
            kernel: Callable[..., Any] = group.rows
            bad = self.workers.run(
                kernel, len(group.members), group.members, self.problem.records, s.row, s.image, s.point,
                group.columns.setup, group.n_basis, s.basis, wide, state.ground, value, self.buffers.d_image,
                self.buffers.d_ground, want,
            )  # fmt: skip
            for a in bad:
                if a >= 0:
                    label = self.problem.label(int(s.row[a]))
                    raise NotFiniteError(f"{label}: residual or Jacobian is not finite")
        return value

    def _control_residuals(self, state: State, records: Array) -> Array:
        """Whitened residuals (m, 3) of the observed control points, by their records (N, 12)."""
        observed = self.structure.observed
        difference = state.ground[observed] - records[observed, 9:]
        return np.asarray(np.einsum("nij,nj->ni", records[observed, :9].reshape(-1, 3, 3), difference))

    def half_squares(self, value: Array, state: State, records: Array | None = None) -> float:
        """Half the weighted sum of squares, from whitened residuals of the image points and control records."""
        control = self._control_residuals(state, self.problem.control_records if records is None else records)
        squares = np.vdot(value, value) + np.sum(control**2) + self.prior * np.sum(state.image**2)
        return 0.5 * float(squares)
