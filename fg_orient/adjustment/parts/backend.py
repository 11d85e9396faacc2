"""Backend that adjusts a block in parts: Helmert blocking of the reduced normal equations.

Each part eliminates its ground points and returns its contribution to the reduced system
of the images. The sum, with the priors, is solved in this process, or, for large systems,
in fronts by the workers (:mod:`fg_orient.adjustment.parts.multifrontal`). Then each part
moves its points according to the step of the images. The loop and its optimisers are the
same as for all backends.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.dissection import dissected
from fg_orient.adjustment.parts.fronts import Partial
from fg_orient.adjustment.parts.multifrontal import Multifrontal
from fg_orient.adjustment.parts.parts import START, read_ground, rows_of, write_ground, write_part
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.parts.system import PartedState, PartedStep, PartedSystem
from fg_orient.adjustment.parts.tasks import At
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_choice import Choice, Pattern
from fg_orient.adjustment.reduced_systems import ReducedSystems
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur_reduced import Reduced
from fg_orient.adjustment.schur_stages import ImageExtras, half_extras


class PartedBackend:
    """Problem in parts; ``fg_orient.adjustment.loop`` iterates on it.

    Parameters
    ----------
    problem : Problem
    pool : Pool
        Runs the tasks of the parts.
    folder : Path
        Work folder of this adjustment, accessible to all workers.
    parts : int
    kept : int, optional
        Number of parts that stay open in a process; default: all.

    Raises
    ------
    InputError
        There are more parts than ground points; the Schur backend refuses the block; the
        folder cannot be written.
    """

    name: Final = "schur"

    def __init__(self, problem: Problem, pool: Pool, folder: Path, parts: int, kept: int | None = None) -> None:
        self.problem, self.folder, self._pool, self._open = problem, folder, pool, kept
        self._dissection = dissected(problem, parts, joined=ImageExtras(problem, problem.start).joined)
        self.points = self._dissection.points
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
        """Return the start values."""
        return PartedState(self.problem.start.image, START, self._gathered)

    def linearise(self, state: State) -> PartedSystem:
        """Linearise at a state; see ``SchurBackend.linearise``."""
        here = self._parted(state)
        if here.name != self._kept[-1]:
            self._kept = [self._kept[-1], here.name]
            self._clean()
        return PartedSystem(self, here)

    def error(self, state: State) -> float:
        """Return half the weighted sum of squares."""
        here = self._parted(state)
        error = float(self.total(tasks.error, here)) + self.image_error(here)
        self._last_error = here.name, error
        return error

    def known_error(self, state: PartedState) -> float | None:
        """Return the error of a state if it is the state that was computed last; else None."""
        return self._last_error[1] if self._last_error and self._last_error[0] == state.name else None

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``fg_orient.adjustment.stages.RobustBackend``; one part after the other."""
        image, control = self.total(tasks.squares, self._parted(state))
        return np.concatenate(image), np.concatenate(control)

    def retract(self, state: State, step: PartedStep) -> PartedState:
        """Return the state after a step from this state."""
        if step.base != self._parted(state).name:
            raise ValueError("the step belongs to another state")
        return PartedState(state.image + self.problem.image_matrix(step.image), step.target, self._gathered)

    def total(self, task: Callable[..., Any], state: PartedState, *arguments: Any) -> Any:
        """Return the sum of a task over the parts."""
        return self._pool.total(task, [(at, *arguments) for at in self._at(state)])

    def _at(self, state: PartedState) -> list[At]:
        """Return the state of each part."""
        folder, threads = str(self.folder), self._pool.threads
        return [
            At(folder, number, state.name, state.image, threads, self._open, self._robust, self._losses)
            for number in range(len(self.points))
        ]

    def prior_error(self, image: Array) -> float:
        """Return half the squares of the priors."""
        return 0.5 * self.prior * float(np.sum(image**2))

    def image_error(self, state: State) -> float:
        """Return half the squares of priors and extra observations of the images."""
        return self.prior_error(state.image) + half_extras(self.problem, state)

    def new_name(self) -> str:
        """Return the name of a further state."""
        self._names += 1
        return f"{self._names:06d}"

    def reduced(self, partial: Partial, damping: float, added: Array | None = None) -> Reduced:
        """Return the reduced system from the sum of all parts. A matrix (z, z) adds observations of several images."""
        pattern = Pattern(np.diff(self.problem.first).astype(np.int64), partial.row, partial.column)
        if self._systems is None or not all(map(np.array_equal, self._systems.pattern.blocks, pattern.blocks)):
            self._systems = ReducedSystems(pattern, self.problem.first)
        return self._systems(partial.blocks, self.prior + damping, added)

    def multifrontal(self, state: PartedState, damping: float, extras: ImageExtras, gradient: Array) -> Multifrontal:
        """Return the factor in fronts, with the gradient (u,) of priors and extra observations of the images."""
        blocks, m = None, self.problem.n_images
        if self.problem.block.extra:
            blocks = np.zeros((m, *[int(np.diff(self.problem.first).max())] * 2))
            extras.add_blocks({k: k for k in range(m)}, blocks)
        out = Multifrontal(self.problem, self._dissection, self._pool, self.folder, self.new_name())
        out.eliminate(self._at(state), damping, self.prior + damping, gradient, blocks)
        return out

    @property
    def in_fronts(self) -> bool:
        """True if the reduced system is solved in fronts."""
        return bool(self._dissection.levels)

    @property
    def choice(self) -> Choice | None:
        """Method for the reduced system, and its prediction; None before the first solution."""
        if self.in_fronts:
            return self._dissection.choice
        return None if self._systems is None else self._systems.choice

    def _parted(self, state: State) -> PartedState:
        """Return the state with its points in files. Points of a state in memory are written first."""
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
        """Remove the files of ground points and fronts that are older than the last two linearised states."""
        oldest = min((name for name in self._kept if name != START), default="")
        for path in self.folder.glob("*.npy"):
            name = path.stem.rsplit("-", 1)[-1]
            if name < oldest and name not in self._kept:
                with contextlib.suppress(OSError):
                    path.unlink()
