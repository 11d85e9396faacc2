"""What a worker does with a part: pure functions of its file, the state and small arguments.

A task may run again elsewhere when a worker has died: it gives the same bits. What a process has opened and computed is
kept, and computed again where it is missing. Ground points never travel: a step leaves those of its part in a file
of the work folder, named after the state.
"""

from __future__ import annotations

import functools
import io
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.parts.parts import read_part, write_whole
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur import SchurBackend, SchurStep, SchurSystem
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

F = TypeVar("F", bound=Callable[..., Any])

#: Name of the state whose ground points stand in the part files.
START: Final = "start"


@dataclass(frozen=True)
class At:
    """A state of a part.

    Parameters
    ----------
    folder : str
        Work folder.
    part : int
    name : str
        Of the state: its ground points are in a file of this name.
    image : (M, k) array
        Image unknowns, prior sigmas.
    threads : int or None
        Of the kernels.
    robust : Robust or None
        Losses; None for least squares.
    loss : int
        Number of the losses: another one means other losses.
    """

    folder: str
    part: int
    name: str
    image: Array
    threads: int | None
    robust: Robust | None = None
    loss: int = 0


@dataclass(frozen=True)
class Partial:
    """What some parts add to the reduced normal equations; blocks (B, k, k) of images row <= column, sorted."""

    row: Index
    column: Index
    blocks: Array
    gradient: Array
    error: float

    def __add__(self, other: Partial) -> Partial:
        span = 1 + int(max(self.column.max(initial=0), other.column.max(initial=0)))
        mine, theirs = (p.row * span + p.column for p in (self, other))
        keys = np.union1d(mine, theirs)
        blocks = np.zeros((len(keys), *self.blocks.shape[1:]))
        blocks[np.searchsorted(keys, mine)] += self.blocks
        blocks[np.searchsorted(keys, theirs)] += other.blocks
        row, column = np.divmod(keys, span)
        return Partial(row, column, blocks, self.gradient + other.gradient, self.error + other.error)


@dataclass(frozen=True)
class Moved:
    """A step of the ground points of some parts.

    Parameters
    ----------
    length : float
        Largest coordinate, m.
    squares : float
        Sum of squares.
    predicted : float
        Half the squares of the linear model after it.
    """

    length: float
    squares: float
    predicted: float

    def __add__(self, other: Moved) -> Moved:
        return Moved(
            max(self.length, other.length), self.squares + other.squares, self.predicted + other.predicted
        )  # fmt: skip


@dataclass(frozen=True)
class Slope:
    """Gradient of the images (u,), and squares of that of the ground points."""

    image: Array
    squares: float

    def __add__(self, other: Slope) -> Slope:
        return Slope(self.image + other.image, self.squares + other.squares)


@dataclass(frozen=True)
class Squares:
    """Squared whitened norms of image points and control points."""

    image: Array
    control: Array

    def __add__(self, other: Squares) -> Squares:
        return Squares(np.append(self.image, other.image), np.append(self.control, other.control))


@dataclass(frozen=True)
class Bend:
    """Squares of the Jacobian times the gradient, and the product of the ground points' gradient and Newton step."""

    curvature: float
    product: float

    def __add__(self, other: Bend) -> Bend:
        return Bend(self.curvature + other.curvature, self.product + other.product)


class _Open:
    """A part as this process has opened it: the backend, and the last linearisation."""

    def __init__(self, problem: Problem, threads: int | None) -> None:
        self.problem, self.backend, self.lock = problem, SchurBackend(problem, threads=threads), threading.Lock()
        self._at = ("", 0)
        self._system: SchurSystem | None = None
        self._ground: dict[str, Array] = {START: problem.start.ground}
        self._damping: float | None = None

    def state(self, at: At) -> State:
        """The state, its ground points as computed here or as in their file."""
        if at.name not in self._ground:
            self._ground = {START: self.problem.start.ground, at.name: read_ground(at.folder, at.part, at.name)}
        return State(at.image, self._ground[at.name])

    def keep(self, at: At, target: str, ground: Array) -> None:
        """Keep the ground points of this state and of the newest."""
        self._ground = {name: self._ground[name] for name in {START, at.name}} | {target: ground}

    def system(self, at: At) -> SchurSystem:
        """The linearisation at a state."""
        self.backend.robust = at.robust
        if self._system is None or self._at != (at.name, at.loss):
            self._system, self._at, self._damping = self.backend.linearise(self.state(at)), (at.name, at.loss), None
        return self._system

    def partial(self, at: At, damping: float) -> tuple[Array, Array]:
        """Eliminate the points."""
        system = self.system(at)
        self._damping = damping
        return system.partial(damping)

    def substitute(self, at: At, damping: float, image: Array) -> SchurStep:
        """Substitute back; what another task has eliminated since is eliminated again."""
        if self.system(at) and self._damping != damping:
            self.partial(at, damping)
        return self.system(at).substitute(image)

    def gradient(self, at: At) -> tuple[Array, Array]:
        """Gradient of images and points."""
        system, self._damping = self.system(at), None
        return system.gradient()


_OPEN: dict[tuple[str, int], _Open] = {}
_OPENING: Final = threading.Lock()


def _opened(at: At) -> _Open:
    key = at.folder, at.part
    with _OPENING:
        if key not in _OPEN:
            for other in {folder for folder, _ in _OPEN if not Path(folder).is_dir()}:
                forget(other)  # its client died
            _OPEN[key] = _Open(read_part(at.folder, at.part), at.threads)
        return _OPEN[key]


def _alone(task: F) -> F:
    """One task at a time on a part: a worker may have threads, and a failed sum leaves tasks behind that still run."""

    @functools.wraps(task)
    def run(at: At, *arguments: Any) -> Any:
        with _opened(at).lock:
            return task(at, *arguments)

    return cast(F, run)


def forget(folder: str) -> None:
    """Close the parts of a work folder in this process."""
    for key in [key for key in _OPEN if key[0] == folder]:
        del _OPEN[key]


def ground_file(folder: str | Path, part: int, name: str) -> Path:
    """File of the ground points of a part at a state."""
    return Path(folder) / f"ground-{part:04d}-{name}.npy"


def write_ground(folder: str | Path, part: int, name: str, ground: Array) -> None:
    """Write the ground points (P, 3) of a part, whole or not at all."""
    stream = io.BytesIO()
    np.save(stream, ground)
    write_whole(ground_file(folder, part, name), stream.getvalue())


def read_ground(folder: str | Path, part: int, name: str) -> Array:
    """Read the ground points of a part.

    Raises
    ------
    InputError
        The file is not there: the folder is another one for this process.
    """
    path = ground_file(folder, part, name)
    try:
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError.of("parallel.folder", file=path, value=type(error).__name__) from error


@_alone
def error(at: At) -> float:
    """Half the weighted sum of squares of a part, without priors of the images."""
    part = _opened(at)
    part.backend.robust = at.robust
    return part.backend.error(part.state(at))


@_alone
def squares(at: At) -> Squares:
    """Squared whitened norms of a part, unweighted."""
    part = _opened(at)
    return Squares(*part.backend.squares(part.state(at)))


@_alone
def eliminate(at: At, damping: float) -> Partial:
    """Linearise a part and eliminate its ground points, damped.

    Raises
    ------
    Singular
        A ground point is not determined.
    """
    part = _opened(at)
    blocks, gradient = part.partial(at, damping)
    s, widest = part.backend.structure, int(np.diff(part.problem.first).max())
    row, column = s.block_row.astype(np.int64), s.block_column.astype(np.int64)
    own = blocks[:, :widest, :widest].copy()
    return Partial(row, column, own, gradient, part.system(at).error)


@_alone
def substitute(at: At, damping: float, image: Array, target: str) -> Moved:
    """Move the ground points of a part after a step (u,) of the images; ``target`` names the new state."""
    part = _opened(at)
    return _moved(part, at, part.substitute(at, damping, image), target)


@_alone
def gradient(at: At) -> Slope:
    """Gradient of a part."""
    image, ground = _opened(at).gradient(at)
    return Slope(image, float(np.sum(ground**2)))


@_alone
def bend(at: At, damping: float, slope: Array, newton: Array) -> Bend:
    """What the dogleg needs of a part: ``slope`` and ``newton``, which has this damping, (u,) of the images."""
    part = _opened(at)
    step = part.substitute(at, damping, newton).ground.copy()
    _, ground = part.gradient(at)
    return Bend(part.system(at).curvature(slope, ground), float(np.sum(ground * step)))


@_alone
def blend(at: At, damping: float, slope: Array, newton: Array, multiples: tuple[float, float], target: str) -> Moved:
    """Move a part by a multiple of the gradient plus a multiple of the Newton step."""
    part = _opened(at)
    step = part.substitute(at, damping, newton).ground.copy()
    _, ground = part.gradient(at)
    along_slope, along_newton = multiples
    image = along_slope * slope + along_newton * newton
    return _moved(part, at, part.system(at).given(image, along_slope * ground + along_newton * step), target)


def _moved(part: _Open, at: At, step: SchurStep, target: str) -> Moved:
    ground = part.backend.retract(part.state(at), step).ground
    write_ground(at.folder, at.part, target, ground)
    part.keep(at, target, ground)
    length = float(np.abs(step.ground).max(initial=0.0))
    return Moved(length, float(np.sum(step.ground**2)), step.predicted_error)


def remove(folder: str | Path) -> None:
    """Remove a work folder and close its parts."""
    forget(str(folder))
    shutil.rmtree(folder, ignore_errors=True)
