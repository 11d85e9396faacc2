"""Backend that adjusts a block in parts: Helmert blocking of the reduced normal equations.

Each part eliminates its ground points and returns its contribution to the reduced system of the images. The sum,
with the priors, is solved in this process; then each part moves its points by the step of the images. The loop and its
optimisers are the same as for all backends.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import SummedSystem
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.parts import START, divide, read_ground, rows_of, write_ground, write_part
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.parts.tasks import At, Partial, Sums
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur_reduced import Pattern, Reduced, ReducedSystems

Array = npt.NDArray[np.float64]


class PartedState(State):
    """A state with ground points in the files of the parts; ``ground`` reads those of this name with ``gather``."""

    name: str
    _gather: Callable[[str], Array]

    def __init__(self, image: Array, name: str, gather: Callable[[str], Array]) -> None:
        for key, value in (("image", image), ("name", name), ("_gather", gather)):
            object.__setattr__(self, key, value)

    @property
    def ground(self) -> Array:
        """Ground points (N, 3), m in the local frame."""
        return self._gather(self.name)


@dataclass(frozen=True)
class PartedStep:
    """A step; see ``loop.Step``. ``base`` and ``target`` are the names of the states before and after it."""

    image: Array
    base: str
    target: str
    length: float
    predicted_error: float
    norm: float


class PartedSystem:
    """One linearisation; see ``loop.System``."""

    def __init__(self, backend: PartedBackend, state: PartedState) -> None:
        self._backend, self.state = backend, state
        self._prior_gradient = backend.prior * backend.problem.image_vector(state)
        self._newton: PartedStep | None = None
        self._known = backend.known_error(state)
        self._least = backend.problem.least_damping
        self._partial: Partial | None = None

    @property
    def error(self) -> float:
        """Half the weighted sum of squares, or the cost under a loss."""
        if self._known is None:
            self._eliminated(self._least)  # the next Gauss-Newton step requires it
        assert self._known is not None
        return self._known

    def _eliminated(self, damping: float) -> Partial:
        """Sum of all parts."""
        if damping == self._least and self._partial is not None:
            return self._partial
        partial: Partial = self._backend.total(tasks.eliminate, self.state, damping)
        self._known = partial.error + self._backend.prior_error(self.state.image)
        if damping == self._least:
            self._partial = partial
        return partial

    def solve(self, damping: float) -> PartedStep:
        """Eliminate the points of all parts, solve for the images, substitute back; see ``SchurSystem.solve``."""
        damping = max(damping, self._least)
        if damping == self._least and self._newton is not None:
            return self._newton
        partial, target = self._eliminated(damping), self._backend.new_name()
        image = self._backend.reduced(partial, damping).solve(partial.gradient + self._prior_gradient)
        step = self._step(image, target, self._backend.total(tasks.substitute, self.state, damping, image, target))
        if damping == self._least:
            self._newton = step
        return step

    def dogleg(self, radius: float) -> PartedStep:
        """Blend of the steepest-descent and the Gauss-Newton step."""
        newton, backend = self.solve(0.0), self._backend
        if newton.norm <= radius:
            return newton
        image, of_points = backend.total(tasks.gradient, self.state)
        image = image + self._prior_gradient
        squares = float(np.sum(image**2)) + of_points
        curvature, product = backend.total(tasks.bend, self.state, self._least, image, newton.image)
        factor = -squares / (curvature + backend.prior * float(np.sum(image**2)))
        length = abs(factor) * float(np.sqrt(squares))
        along_slope, along_newton = factor * min(1.0, radius / length), 0.0
        if length < radius:
            product = factor * (product + float(np.sum(image * newton.image)))
            across = max(newton.norm**2 - 2.0 * product + length**2, 0.0)
            along_newton = share_at_radius(across, product - length**2, length, radius)
            along_slope = factor * (1.0 - along_newton)
        target = backend.new_name()
        moved = backend.total(
            tasks.blend, self.state, self._least, image, newton.image, (along_slope, along_newton), target
        )  # fmt: skip
        return self._step(along_slope * image + along_newton * newton.image, target, moved)

    def _step(self, image: Array, target: str, moved: Sums) -> PartedStep:
        backend, (largest, squares, predicted) = self._backend, moved
        error = predicted + backend.prior_error(self.state.image + backend.problem.image_matrix(image))
        length, norm = max(float(np.abs(image).max()), float(largest)), float(np.sqrt(np.sum(image**2) + squares))
        return PartedStep(image, self.state.name, target, length, error, norm)

    def summed(self) -> SummedSystem:
        """Reduced system for the covariance, without the parts; a singular system raises its error when it is used."""
        partial: Partial | RuntimeError
        try:
            partial = self._eliminated(0.0)
        except RuntimeError as error:
            partial = error

        def reduced(damping: float) -> Reduced:
            if isinstance(partial, RuntimeError):
                raise partial
            return self._backend.reduced(partial, damping)

        return SummedSystem(State(self.state.image, self.state.ground), reduced)


class PartedBackend:
    """The problem in parts, driven by ``fg_orient.adjustment.loop``.

    Parameters
    ----------
    problem : Problem
    pool : Pool
        Runs the tasks of the parts.
    folder : Path
        Work folder of this adjustment, accessible to all workers.
    parts : int

    Raises
    ------
    InputError
        More parts than ground points; a block that the Schur backend refuses; a folder that cannot be written.
    """

    name: Final = "schur"

    def __init__(self, problem: Problem, pool: Pool, folder: Path, parts: int) -> None:
        self.problem, self.folder, self._pool = problem, folder, pool
        self.points = divide(problem, parts)
        for number, rows in enumerate(rows_of(problem, self.points)):
            write_part(problem, self.points[number], rows, folder, number)
        self.prior = 1.0 if problem.block.options.priors else 0.0
        self._names = 0
        self._kept = [START, START]
        self._systems: ReducedSystems | None = None
        self._last_error: tuple[str, float] | None = None
        self._robust: Robust | None = None
        self._losses = 0
        self._foreign: tuple[State, PartedState] | None = None

    @property
    def robust(self) -> Robust | None:
        """Losses; None for least squares."""
        return self._robust

    @robust.setter
    def robust(self, robust: Robust | None) -> None:
        self._robust, self._last_error = robust, None
        self._losses += 1

    def initial(self) -> PartedState:
        """Start values."""
        return PartedState(self.problem.start.image, START, self._gathered)

    def linearise(self, state: State) -> PartedSystem:
        """Linearise at a state; see ``SchurBackend.linearise``."""
        here = self._parted(state)
        if here.name != self._kept[-1]:
            self._kept = [self._kept[-1], here.name]
            self._clean()
        return PartedSystem(self, here)

    def error(self, state: State) -> float:
        """Half the weighted sum of squares."""
        here = self._parted(state)
        error = float(self.total(tasks.error, here)) + self.prior_error(here.image)
        self._last_error = here.name, error
        return error

    def known_error(self, state: PartedState) -> float | None:
        """The error of a state if it was computed last; else None."""
        return self._last_error[1] if self._last_error and self._last_error[0] == state.name else None

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``fg_orient.adjustment.stages.RobustBackend``; one part after the other."""
        image, control = self.total(tasks.squares, self._parted(state))
        return np.concatenate(image), np.concatenate(control)

    def retract(self, state: State, step: PartedStep) -> PartedState:
        """State after a step from this state."""
        if step.base != self._parted(state).name:
            raise ValueError("the step belongs to another state")
        return PartedState(state.image + self.problem.image_matrix(step.image), step.target, self._gathered)

    def total(self, task: Callable[..., Any], state: PartedState, *arguments: Any) -> Any:
        """Sum of a task over the parts."""
        folder, threads = str(self.folder), self._pool.threads
        return self._pool.total(task, [
            (At(folder, number, state.name, state.image, threads, self._robust, self._losses), *arguments)
            for number in range(len(self.points))
        ])  # fmt: skip

    def prior_error(self, image: Array) -> float:
        """Half the squares of the priors."""
        return 0.5 * self.prior * float(np.sum(image**2))

    def new_name(self) -> str:
        """Name of a further state."""
        self._names += 1
        return f"{self._names:06d}"

    def reduced(self, partial: Partial, damping: float) -> Reduced:
        """The reduced system of a sum."""
        pattern = Pattern(np.diff(self.problem.first).astype(np.int64), partial.row, partial.column)
        if self._systems is None or not all(map(np.array_equal, self._systems.pattern, pattern)):
            self._systems = ReducedSystems(pattern, self.problem.first)
        return self._systems(partial.blocks, self.prior + damping)

    def _parted(self, state: State) -> PartedState:
        """The state with its points in files; the points of another kind of state are written."""
        if isinstance(state, PartedState):
            return state
        if state is self.problem.start:
            return self.initial()
        if self._foreign is None or self._foreign[0] is not state:
            name = self.new_name()
            for number, points in enumerate(self.points):
                write_ground(self.folder, number, name, state.ground[points])
            self._foreign = state, PartedState(state.image, name, self._gathered)
        return self._foreign[1]

    def _gathered(self, name: str) -> Array:
        ground = self.problem.start.ground.copy()
        if name != START:
            for number, points in enumerate(self.points):
                ground[points] = read_ground(self.folder, number, name)
        return ground

    def _clean(self) -> None:
        """Remove the files of ground points, except for the last two linearised states and later ones."""
        oldest = min((name for name in self._kept if name != START), default="")
        for path in self.folder.glob("ground-*.npy"):
            name = path.stem.rsplit("-", 1)[-1]
            if name < oldest and name not in self._kept:
                with contextlib.suppress(OSError):
                    path.unlink()
