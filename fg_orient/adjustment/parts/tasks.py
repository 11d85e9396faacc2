"""Tasks of a worker on a part of a block: functions of the part's file, the state and small arguments.

A task that another worker repeats gives identical bits. A process keeps some results in memory; another
process computes them again. Ground points are never sent: a step writes the points of its part to a
file of the work folder, named by the state.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Concatenate, Final, ParamSpec, TypeVar

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.parts.dissection import Front
from fg_orient.adjustment.parts.fronts import Added, Partial, front_of_part, write_front
from fg_orient.adjustment.parts.parts import START, read_ground, read_part, write_ground
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur import SchurBackend, SchurStep, SchurSystem

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class At:
    """A state of a part: image unknowns (M, k) in prior sigmas, and ground points in a file with the name of the state.

    ``threads`` is the number of threads of the kernels. ``robust`` contains the losses; ``loss`` is their number, which
    changes with them. At most ``kept`` parts stay open in a process (None: all).
    """

    folder: str
    part: int
    name: str
    image: Array
    threads: int | None
    kept: int | None = None
    robust: Robust | None = None
    loss: int = 0


class Sums(tuple[Any, ...]):
    """Results of some parts, which are added element by element."""

    def __add__(self, other: Any) -> Sums:
        return Sums(a + b for a, b in zip(self, other, strict=True))


class Largest(float):
    """Number whose sum with another one is the larger of both."""

    def __add__(self, other: float) -> Largest:
        return Largest(max(self, other))


class _Part:
    """A part in this process: its backend, its last linearisation, and the ground points of the last states."""

    def __init__(self, at: At) -> None:
        problem = read_part(at.folder, at.part)
        self.backend, self.lock = SchurBackend(problem, at.threads, "blocks"), threading.Lock()
        self._ground: dict[str, Array] = {START: problem.start.ground}
        self._system: tuple[str, int, SchurSystem] | None = None

    def state(self, at: At) -> State:
        """Return the state, its ground points from memory or from their file."""
        self.backend.robust = at.robust
        if at.name not in self._ground:
            self._ground = {START: self._ground[START], at.name: read_ground(at.folder, at.part, at.name)}
        return State(at.image, self._ground[at.name])

    def system(self, at: At) -> SchurSystem:
        """Return the linearisation at a state."""
        self.backend.robust = at.robust
        if self._system is None or self._system[:2] != (at.name, at.loss):
            self._system = at.name, at.loss, self.backend.linearise(self.state(at))
        return self._system[2]

    def moved(self, at: At, step: SchurStep, target: str) -> Sums:
        """Move the ground points; keep the points of this state and of the new state."""
        ground = self.backend.retract(self.state(at), step).ground
        write_ground(at.folder, at.part, target, ground)
        self._ground = {name: self._ground[name] for name in {START, at.name}} | {target: ground}
        size = np.abs(step.ground).max(initial=0.0)
        return Sums((Largest(size), float(np.sum(step.ground**2)), step.predicted_error))


_PARTS: dict[tuple[str, int], _Part] = {}
_OPENING: Final = threading.Lock()


def _task(function: Callable[Concatenate[_Part, At, P], T]) -> Callable[Concatenate[At, P], T]:
    """Convert a function to a task of a part.

    Only one runs at a time, although workers may have threads or run abandoned tasks.
    """

    @functools.wraps(function)
    def run(at: At, /, *arguments: P.args, **named: P.kwargs) -> T:
        key = at.folder, at.part
        with _OPENING:
            if key not in _PARTS:
                for other in {folder for folder, _ in _PARTS if not Path(folder).is_dir()}:
                    forget(other)  # the client of this folder has ended
                opened = [known for known in _PARTS if known[0] == at.folder]
                # parts follow each other, so the last one is needed last
                if len(opened) >= (at.kept or len(opened) + 1):
                    del _PARTS[opened[-1]]
                _PARTS[key] = _Part(at)
            part = _PARTS[key]
        with part.lock:
            return function(part, at, *arguments, **named)

    return run


def forget(folder: str) -> None:
    """Close the parts of a work folder, and of folders in it, in this process."""
    for key in [key for key in _PARTS if key[0].startswith(folder)]:
        del _PARTS[key]


@_task
def error(part: _Part, at: At) -> float:
    """Return half the weighted sum of squares of a part, without priors of the images."""
    return part.backend.error(part.state(at))


@_task
def squares(part: _Part, at: At) -> Sums:
    """Return squared whitened norms of image points and control points, unweighted: two lists, one array per part."""
    return Sums([values] for values in part.backend.squares(part.state(at)))


@_task
def eliminate(part: _Part, at: At, damping: float) -> Partial:
    """Linearise a part and eliminate its damped ground points; raise Singular if a point is not determined."""
    return _partial(part, at, damping)


@_task
def front(part: _Part, at: At, damping: float, node: Front, added: Added, name: str) -> float:
    """Eliminate the ground points of a part, then the images that are observed in this part only.

    The factor is written to the file of the front (:mod:`fg_orient.adjustment.parts.fronts`); the result is half the
    weighted sum of squares.
    """
    partial = _partial(part, at, damping)
    write_front(at.folder, name, node, front_of_part(node, part.backend.problem.first, partial), added)
    return partial.error


def _partial(part: _Part, at: At, damping: float) -> Partial:
    system, widest = part.system(at), int(np.diff(part.backend.problem.first).max())
    (blocks, gradient), s = system.partial(damping), system.structure
    row, column = s.block_row.astype(np.int64), s.block_column.astype(np.int64)
    return Partial(row, column, blocks[:, :widest, :widest].copy(), gradient, system.error)


@_task
def substitute(part: _Part, at: At, damping: float, image: Array, target: str) -> Sums:
    """Move the ground points of a part after a step (u,) of the images; ``target`` names the new state.

    The results are the largest coordinate (m), the sum of squares, and half the squares that the linear model predicts.
    """
    return part.moved(at, part.system(at).substitute(image, damping), target)


@_task
def gradient(part: _Part, at: At) -> Sums:
    """Return the gradient of the images (u,), and squares of the gradient of the ground points."""
    image, ground = part.system(at).gradient()
    return Sums((image, float(np.sum(ground**2))))


@_task
def bend(part: _Part, at: At, damping: float, slope: Array, newton: Array) -> Sums:
    """Return squares of the Jacobian times the gradient, and gradient times Newton step of the ground points.

    ``slope`` (u,) is the gradient of the images, ``newton`` (u,) their Newton step with this damping.
    """
    system = part.system(at)
    step = system.substitute(newton, damping).ground.copy()
    _, ground = system.gradient()
    return Sums((system.curvature(slope, ground), float(np.sum(ground * step))))


@_task
def blend(
    part: _Part, at: At, damping: float, slope: Array, newton: Array, multiples: tuple[float, float], target: str
) -> Sums:
    """Move a part by a multiple of the gradient plus a multiple of the Newton step; see :func:`substitute`."""
    system = part.system(at)
    step = system.substitute(newton, damping).ground.copy()
    _, ground = system.gradient()
    along_slope, along_newton = multiples
    image = along_slope * slope + along_newton * newton
    return part.moved(at, system.given(image, along_slope * ground + along_newton * step), target)
