"""A block adjusted in parts: partial reduced normal equations summed, as Helmert did with networks of triangulation.

Each part eliminates its ground points and gives what it adds to the reduced system of the images; the sum with the
priors is solved here, the step of the images goes back, and each part moves its points. The loop and its optimisers
are those of every backend.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import SummedSystem
from fg_orient.adjustment.loop import share_at_radius
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.parts import divide, rows_of, write_part
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.parts.tasks import START, At, Moved, Partial, Squares
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur_reduced import Reduced, ReducedSystems

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]


class PartedState(State):
    """A state whose ground points lie in the files of the parts; ``ground`` reads them.

    Parameters
    ----------
    image : (M, k) array
        Prior sigmas.
    name : str
    gather : callable
        Gives the ground points (N, 3) of the state of this name.
    """

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
    """A step; see ``loop.Step``. ``target`` names the state after it, ``base`` the one before."""

    image: Array
    base: str
    target: str
    length: float
    predicted_error: float
    norm: float

    @property
    def data(self) -> tuple[Array, str]:
        """Image unknowns (u,), and the state that holds the ground points."""
        return self.image, self.target


@dataclass(frozen=True)
class Pattern:
    """Blocks of the summed system; see ``fg_orient.adjustment.schur_reduced.Pattern``."""

    size: Index
    block_row: Index
    block_column: Index


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
            self._eliminated(self._least)  # Gauss-Newton's step needs it next
        assert self._known is not None
        return self._known

    def _eliminated(self, damping: float) -> Partial:
        """Sum of all parts."""
        if damping == self._least and self._partial is not None:
            return self._partial
        found: Partial = self._backend.total(tasks.eliminate, self.state, damping)
        self._known = found.error + self._backend.prior_error(self.state.image)
        if damping == self._least:
            self._partial = found
        return found

    def eliminated(self, damping: float) -> tuple[Reduced, Array]:
        """Reduced system and gradient (u,), the sums of all parts and the priors.

        Raises
        ------
        Singular
            A ground point, or the reduced system, is not determined.
        """
        found = self._eliminated(damping)
        return self._backend.reduced(found, damping), found.gradient + self._prior_gradient

    def solve(self, damping: float) -> PartedStep:
        """Eliminate the points of all parts, solve for the images, substitute back.

        Raises
        ------
        RuntimeError
            The normal equations are singular.
        """
        damping = max(damping, self._least)
        if damping == self._least and self._newton is not None:
            return self._newton
        reduced, gradient = self.eliminated(damping)
        image, target = reduced.solve(gradient), self._backend.new_name()
        step = self._step(image, target, self._backend.total(tasks.substitute, self.state, damping, image, target))
        if damping == self._least:
            self._newton = step
        return step

    def dogleg(self, radius: float) -> PartedStep:
        """Blend of the steepest-descent and the Gauss-Newton step."""
        newton, backend = self.solve(0.0), self._backend
        if newton.norm <= radius:
            return newton
        slope = backend.total(tasks.gradient, self.state)
        image = slope.image + self._prior_gradient
        squares = float(np.sum(image**2)) + slope.squares
        bend = backend.total(tasks.bend, self.state, self._least, image, newton.image)
        factor = -squares / (bend.curvature + backend.prior * float(np.sum(image**2)))
        length = abs(factor) * float(np.sqrt(squares))
        along_slope, along_newton = factor * min(1.0, radius / length), 0.0
        if length < radius:
            product = factor * (bend.product + float(np.sum(image * newton.image)))
            across = max(newton.norm**2 - 2.0 * product + length**2, 0.0)
            along_newton = share_at_radius(across, product - length**2, length, radius)
            along_slope = factor * (1.0 - along_newton)
        target = backend.new_name()
        moved = backend.total(
            tasks.blend, self.state, self._least, image, newton.image, (along_slope, along_newton), target
        )  # fmt: skip
        return self._step(along_slope * image + along_newton * newton.image, target, moved)

    def _step(self, image: Array, target: str, moved: Moved) -> PartedStep:
        backend = self._backend
        after = self.state.image + backend.problem.image_matrix(image)
        length = max(float(np.abs(image).max()), moved.length)
        norm = float(np.sqrt(np.sum(image**2) + moved.squares))
        return PartedStep(image, self.state.name, target, length, moved.predicted + backend.prior_error(after), norm)

    def summed(self) -> SummedSystem:
        """What the covariance needs."""
        state = State(self.state.image, self.state.ground)
        try:
            found = self._eliminated(0.0)
        except RuntimeError as error:
            return SummedSystem(state, functools.partial(_raise, error))
        return SummedSystem(state, lambda damping: self._backend.reduced(found, damping))


def _raise(error: Exception, damping: float) -> Reduced:
    """Give no system, but the reason."""
    raise error


class PartedBackend:
    """The problem in parts, driven by ``fg_orient.adjustment.loop``.

    Parameters
    ----------
    problem : Problem
    pool : Pool
        Where the parts are worked on.
    folder : Path
        Work folder of this adjustment, seen by all workers.
    parts : int

    Raises
    ------
    InputError
        More parts than ground points; a block that the Schur backend cannot take; a folder that cannot be written.
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
        """Linearise at a state.

        Raises
        ------
        NotFiniteError
            A residual or Jacobian is nan or inf; names the observation.
        """
        here = self._parted(state)
        if here.name != self._kept[-1]:
            self._kept = [self._kept[-1], here.name]
            self._clean()
        return PartedSystem(self, here)

    def error(self, state: State) -> float:
        """Half the weighted sum of squares."""
        here = self._parted(state)
        found = float(self.total(tasks.error, here)) + self.prior_error(here.image)
        self._last_error = here.name, found
        return found

    def known_error(self, state: PartedState) -> float | None:
        """The error of a state if it was asked for last."""
        return self._last_error[1] if self._last_error and self._last_error[0] == state.name else None

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``fg_orient.adjustment.robust.RobustBackend``; one part after the other."""
        found: Squares = self.total(tasks.squares, self._parted(state))
        return found.image, found.control

    def retract(self, state: State, step: PartedStep) -> PartedState:
        """State after a step from this state."""
        if step.base != self._parted(state).name:
            raise ValueError("this step leads from another state")
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

    def reduced(self, found: Partial, damping: float) -> Reduced:
        """The reduced system of a sum."""
        pattern = None if self._systems is None else self._systems.pattern
        same = pattern is not None and np.array_equal(pattern.block_row, found.row)
        if self._systems is None or not (same and np.array_equal(self._systems.pattern.block_column, found.column)):
            size = np.diff(self.problem.first).astype(np.int64)
            self._systems = ReducedSystems(Pattern(size, found.row, found.column), self.problem.first)
        return self._systems(found.blocks, self.prior + damping)

    def _parted(self, state: State) -> PartedState:
        """The state with its points in files; those of a state from elsewhere are written."""
        if isinstance(state, PartedState):
            return state
        if state is self.problem.start:
            return self.initial()
        if self._foreign is None or self._foreign[0] is not state:
            name = self.new_name()
            for number, points in enumerate(self.points):
                tasks.write_ground(self.folder, number, name, state.ground[points])
            self._foreign = state, PartedState(state.image, name, self._gathered)
        return self._foreign[1]

    def _gathered(self, name: str) -> Array:
        ground = self.problem.start.ground.copy()
        if name != START:
            for number, points in enumerate(self.points):
                ground[points] = tasks.read_ground(self.folder, number, name)
        return ground

    def _clean(self) -> None:
        """Remove the ground points of states before the last two that were linearised."""
        oldest = min((name for name in self._kept if name != START), default="")
        for path in self.folder.glob("ground-*.npy"):
            name = path.stem.rsplit("-", 1)[-1]
            if name < oldest and name not in self._kept:
                with contextlib.suppress(OSError):
                    path.unlink()
