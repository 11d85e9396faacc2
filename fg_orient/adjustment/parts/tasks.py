"""Division of a problem by ground points, and the tasks of a worker on a part.

Images are never divided: every part contains the unknowns of all images. A part contains the whitened records of its
image points; workers need neither sensors nor metadata. Files are ``.npz`` without pickles, one per part.

A task is a function of the part's file, the state and small arguments. Repeated by another worker it gives the same
bits: results that a process keeps are computed again where they are missing. Ground points are never sent: a step
writes those of its part to a file of the work folder, named by the state.
"""

from __future__ import annotations

import functools
import io
import json
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Concatenate, Final, ParamSpec, TypeVar, cast
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, registered
from fg_orient import __version__
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur import SchurBackend, SchurStep, SchurSystem
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.block import (
    Block,
    Coordinates,
    GroundPoints,
    Image,
    ImagePoints,
    Options,
    WithheldCoordinates,
)
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import ImageParameters
from fg_orient.sensors.base import ImageModel, Sensor

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Default number of image points of a part. The number of parts then depends on the block only, so that the last bit of
#: a result does not depend on the machines. A task costs a few ms, a part of this size 10 ms.
PART_SIZE: Final = 20_000
MAX_PARTS: Final = 256


def default_parts(problem: Problem) -> int:
    """Number of parts of a block, from its image points."""
    return min(max(1, -(-len(problem.observations) // PART_SIZE)), MAX_PARTS)


def divide(problem: Problem, parts: int) -> list[Index]:
    """Ground points of each part, ascending.

    Points that the same images see are in one part, which then contributes to few blocks of the reduced system. Parts
    have about the same work: pairs of rays of their points.

    InputError: more parts than ground points, or less than one; a block that the Schur backend refuses.
    """
    if problem.block.extra:
        raise InputError.of("adjust.schur", option="parts", value="the block has extra observations")
    o = problem.observations
    seen, rays = np.unique(o.point, return_counts=True)
    if not 1 <= parts <= len(seen):
        raise InputError.of("parallel.parts", option="parts", value=parts, points=len(seen))
    order = np.lexsort((o.image, o.point))
    ends = np.cumsum(rays)
    image = o.image[order]
    sorted_points = np.lexsort((image[ends - 1], image[ends - rays]))
    work = np.cumsum((rays * (rays + 1) // 2)[sorted_points])
    bounds = np.searchsorted(work, work[-1] * np.arange(parts + 1) / parts, side="left")
    bounds[-1] = len(seen)
    least = np.arange(parts + 1)
    bounds = np.minimum(np.maximum.accumulate(np.maximum(bounds - least, 0)) + least, len(seen) - parts + least)
    return [np.sort(seen[sorted_points[a:b]]) for a, b in pairwise(bounds.tolist())]


@dataclass(frozen=True)
class PartModel:
    """Equation and unknowns of an image of a part, without its sensor, whose constants are in the records."""

    equation: Equation
    parameters: ImageParameters


def rows_of(problem: Problem, points: list[Index]) -> list[Index]:
    """Rows of ``problem.observations`` of each part."""
    owner = np.full(len(problem.active), len(points), dtype=np.intp)
    for number, members in enumerate(points):
        owner[members] = number
    of_row = owner[problem.observations.point]
    ends = np.cumsum(np.bincount(of_row, minlength=len(points) + 1))
    return np.split(np.argsort(of_row, kind="stable"), ends[:-1])[: len(points)]


def part_of(problem: Problem, points: Index, rows: Index) -> dict[str, npt.NDArray[Any]]:
    """Arrays of the file of a part: of some ground points (ascending) and their rows."""
    o = problem.observations
    setups = [model.parameters.setup for model in problem.models]
    return {
        "image": o.image[rows], "point": np.searchsorted(points, o.point[rows]), "records": problem.records[rows],
        "start": problem.start.ground[points], "active": problem.active[points], "observed": problem.observed[points],
        "control_records": problem.control_records[points], "origin_m": problem.origin_m,
        "equations": np.array([model.equation.name for model in problem.models]),
        "setups": np.concatenate(setups, axis=1), "first": problem.first,
        "image_ids": np.array([image.id.encode() for image in problem.block.images]),
        "ids": np.array([problem.block.points.ids[j].encode() for j in points.tolist()]),
        "version": np.array(__version__),
        "options": np.frombuffer(json.dumps(asdict(problem.block.options)).encode(), np.uint8),
    }  # fmt: skip


def part_problem(name: str, arrays: dict[str, npt.NDArray[Any]]) -> Problem:
    """Problem of a part; its images have no priors, which are added once, to the sum of all parts."""
    first, setups, images = arrays["first"], arrays["setups"], [i.decode() for i in arrays["image_ids"].tolist()]
    models = []
    for k, equation in enumerate(arrays["equations"].tolist()):
        codes, sigma = setups[:, first[k] : first[k + 1]]
        parameters = ImageParameters(tuple(codes.astype(int).tolist()), sigma, (), (), ())
        models.append(cast(ImageModel, PartModel(registered()[equation], parameters)))
    ids, nowhere = tuple(i.decode() for i in arrays["ids"].tolist()), np.zeros((0, 3))
    unknown = Coordinates(nowhere, nowhere, np.zeros(0, bool))
    nothing = np.zeros(len(arrays["image"]))
    observations = ImagePoints(arrays["image"], arrays["point"], nothing, nothing, nothing, nothing)
    options = Options(**(json.loads(arrays["options"].tobytes()) | {"priors": False}))
    block = Block(
        name, tuple(Image(i, cast(Sensor, None)) for i in images), GroundPoints(ids, (), unknown), observations,
        WithheldCoordinates((), lambda: unknown), options,
    )  # fmt: skip
    start = State(np.zeros((len(models), int(np.diff(first).max()))), arrays["start"])
    return Problem(
        block, tuple(models), observations, arrays["records"], arrays["origin_m"], start, arrays["active"],
        arrays["observed"], arrays["control_records"],
    )  # fmt: skip


def part_file(folder: str | Path, number: int) -> Path:
    """File of a part."""
    return Path(folder) / f"part-{number:04d}.npz"


def write_part(problem: Problem, points: Index, rows: Index, folder: Path, number: int) -> None:
    """Write the file of a part, whole or not at all; InputError if it cannot be written."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **part_of(problem, points, rows))
    # not durable: after a crash the work begins again
    write_bytes(part_file(folder, number), stream.getvalue(), durable=False)


def read_part(folder: str, number: int) -> Problem:
    """Read the problem of a part.

    InputError: the file is missing or incomplete, because this process has no access to the folder, or it was written
    by another version of this package.
    """
    path = part_file(folder, number)
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as content:
            arrays = dict(content)
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise InputError.of("parallel.folder", file=path, value=type(error).__name__) from error
    if str(arrays["version"]) != __version__:
        raise InputError.of("parallel.version", file=path, value=__version__, written=str(arrays["version"]))
    return part_problem(f"part {number}", arrays)


P = ParamSpec("P")
T = TypeVar("T")

#: Name of the state whose ground points are in the part files.
START: Final = "start"


@dataclass(frozen=True)
class At:
    """A state of a part: image unknowns (M, k) in prior sigmas, and ground points in a file with the name of the state.

    ``threads`` are those of the kernels; ``robust`` are losses, ``loss`` their number, which changes with them.
    """

    folder: str
    part: int
    name: str
    image: Array
    threads: int | None
    robust: Robust | None = None
    loss: int = 0


class Sums(tuple[Any, ...]):
    """Results of some parts, which are added element by element."""

    def __add__(self, other: Any) -> Sums:
        return Sums(a + b for a, b in zip(self, other, strict=True))


class Largest(float):
    """A number whose sum with another one is the larger of both."""

    def __add__(self, other: float) -> Largest:
        return Largest(max(self, other))


@dataclass(frozen=True)
class Partial:
    """Contribution of some parts to the reduced normal equations; blocks (B, k, k) of images row <= column, sorted."""

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
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


class _Part:
    """A part in this process: its backend, the last linearisation, and ground points of the last states."""

    def __init__(self, at: At) -> None:
        problem = read_part(at.folder, at.part)
        self.backend, self.lock = SchurBackend(problem, threads=at.threads), threading.Lock()
        self._ground: dict[str, Array] = {START: problem.start.ground}
        self._system: tuple[str, int, SchurSystem] | None = None

    def state(self, at: At) -> State:
        """The state, its ground points from memory or from their file."""
        self.backend.robust = at.robust
        if at.name not in self._ground:
            self._ground = {START: self._ground[START], at.name: read_ground(at.folder, at.part, at.name)}
        return State(at.image, self._ground[at.name])

    def system(self, at: At) -> SchurSystem:
        """The linearisation at a state."""
        self.backend.robust = at.robust
        if self._system is None or self._system[:2] != (at.name, at.loss):
            self._system = at.name, at.loss, self.backend.linearise(self.state(at))
        return self._system[2]

    def moved(self, at: At, step: SchurStep, target: str) -> Sums:
        """Move the ground points; keep those of this state and of the new one."""
        ground = self.backend.retract(self.state(at), step).ground
        write_ground(at.folder, at.part, target, ground)
        self._ground = {name: self._ground[name] for name in {START, at.name}} | {target: ground}
        length = Largest(np.abs(step.ground).max(initial=0.0))
        return Sums((length, float(np.sum(step.ground**2)), step.predicted_error))


_PARTS: dict[tuple[str, int], _Part] = {}
_OPENING: Final = threading.Lock()


def _task(function: Callable[Concatenate[_Part, At, P], T]) -> Callable[Concatenate[At, P], T]:
    """Make a task of a part. Only one runs at a time, although workers may have threads or run abandoned tasks."""

    @functools.wraps(function)
    def run(at: At, /, *arguments: P.args, **named: P.kwargs) -> T:
        key = at.folder, at.part
        with _OPENING:
            if key not in _PARTS:
                for other in {folder for folder, _ in _PARTS if not Path(folder).is_dir()}:
                    forget(other)  # its client has ended
                _PARTS[key] = _Part(at)
            part = _PARTS[key]
        with part.lock:
            return function(part, at, *arguments, **named)

    return run


def forget(folder: str) -> None:
    """Close the parts of a work folder in this process."""
    for key in [key for key in _PARTS if key[0] == folder]:
        del _PARTS[key]


def _ground_file(folder: str | Path, part: int, name: str) -> Path:
    return Path(folder) / f"ground-{part:04d}-{name}.npy"


def write_ground(folder: str | Path, part: int, name: str, ground: Array) -> None:
    """Write the ground points (P, 3) of a part at a state, whole or not at all."""
    stream = io.BytesIO()
    np.save(stream, ground)
    write_bytes(_ground_file(folder, part, name), stream.getvalue(), durable=False)


def read_ground(folder: str | Path, part: int, name: str) -> Array:
    """Read the ground points (P, 3) of a part; InputError if this process has no access to the file."""
    path = _ground_file(folder, part, name)
    try:
        return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise InputError.of("parallel.folder", file=path, value=type(error).__name__) from error


@_task
def error(part: _Part, at: At) -> float:
    """Half the weighted sum of squares of a part, without priors of the images."""
    return part.backend.error(part.state(at))


@_task
def squares(part: _Part, at: At) -> Sums:
    """Squared whitened norms of image points and of control points, unweighted: two lists, one array per part."""
    return Sums([values] for values in part.backend.squares(part.state(at)))


@_task
def eliminate(part: _Part, at: At, damping: float) -> Partial:
    """Linearise a part and eliminate its ground points, damped; Singular if a point is not determined."""
    system = part.system(at)
    blocks, gradient = system.partial(damping)
    s, widest = system.structure, int(np.diff(part.backend.problem.first).max())
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
    """Gradient of the images (u,), and squares of the gradient of the ground points."""
    image, ground = part.system(at).gradient()
    return Sums((image, float(np.sum(ground**2))))


@_task
def bend(part: _Part, at: At, damping: float, slope: Array, newton: Array) -> Sums:
    """Squares of the Jacobian times the gradient; product of gradient and Newton step of the ground points.

    ``slope`` and ``newton`` (u,) are gradient and Newton step of the images, the latter with this damping.
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
