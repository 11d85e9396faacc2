"""Division of a problem by ground points, and the files of the parts.

Images are never divided: every part contains the unknowns of all images. A part contains the whitened records of its
image points; workers need neither sensors nor metadata. Files are ``.npz`` without pickles, one per part. Ground
points of a state are in one ``.npy`` file per part.
"""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

from factors._contract import Equation, registered
from factors.arrays import Array, Index
from fg_orient import __version__
from fg_orient.adjustment.problem import Problem, State, no_point_is_named
from fg_orient.adjustment.rows import some_rows
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.load import KINDS, load_npz
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints, Options, WithheldCoordinates
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.model.parameters import ImageParameters
from fg_orient.sensors.base import ImageModel, Sensor

#: Name of the state whose ground points are in the part files.
START: Final = "start"


def rays_of_points(problem: Problem, parts: int) -> tuple[Index, Index, Index]:
    """Return observed ground points (P,), the number of rays (P,) of each, and the images of all rays in this order.

    Ground points, and images of a point, are in ascending order.

    InputError: there are more parts than ground points, or less than one part; the Schur backend refuses the block.
    """
    if not no_point_is_named(problem.block):
        raise InputError.of("adjust.schur", option="parts", value="extra observations name ground points")
    o = problem.observations
    seen, rays = np.unique(o.point, return_counts=True)
    if not 1 <= parts <= len(seen):
        raise InputError.of("parallel.parts", option="parts", value=parts, points=len(seen))
    return seen, rays, o.image[np.lexsort((o.image, o.point))]


def divide(problem: Problem, parts: int) -> list[Index]:
    """Divide the ground points into parts; the points of each part are in ascending order.

    Points that the same images see are in one part, so each part contributes to few blocks of the reduced system.
    Parts have about the same work: pairs of rays of their points. Errors as in :func:`rays_of_points`.
    """
    seen, rays, image = rays_of_points(problem, parts)
    ends = np.cumsum(rays)
    sorted_points = np.lexsort((image[ends - 1], image[ends - rays]))
    work = np.cumsum((rays * (rays + 1) // 2)[sorted_points])
    bounds = np.searchsorted(work, work[-1] * np.arange(parts + 1) / parts, side="left")
    bounds[-1] = len(seen)
    least = np.arange(parts + 1)
    bounds = np.minimum(np.maximum.accumulate(np.maximum(bounds - least, 0)) + least, len(seen) - parts + least)
    return [np.sort(seen[sorted_points[a:b]]) for a, b in pairwise(bounds.tolist())]


@dataclass(frozen=True)
class PartModel:
    """Equation and unknowns of an image in a part. The sensor is not needed, because records contain its constants."""

    equation: Equation
    parameters: ImageParameters


def rows_of(problem: Problem, points: list[Index]) -> list[Index]:
    """Return the rows of ``problem.observations`` of each part."""
    owner = np.full(len(problem.active), len(points), dtype=np.intp)
    for number, members in enumerate(points):
        owner[members] = number
    of_row = owner[problem.observations.point]
    ends = np.cumsum(np.bincount(of_row, minlength=len(points) + 1))
    return np.split(np.argsort(of_row, kind="stable"), ends[:-1])[: len(points)]


def part_of(problem: Problem, points: Index, rows: Index) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of the file of a part: of some ground points (ascending) and their rows."""
    o = problem.observations
    setups = [model.parameters.setup for model in problem.models]
    return {
        "image": o.image[rows], "point": np.searchsorted(points, o.point[rows]),
        "records": some_rows(problem, "records", rows),
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
    """Return the problem of a part.

    Its images have no priors, because priors are added once, to the sum of all parts.
    """
    first, setups, images = arrays["first"], arrays["setups"], [i.decode() for i in arrays["image_ids"].tolist()]
    models = []
    for k, equation in enumerate(arrays["equations"].tolist()):
        codes, sigma = setups[:, first[k] : first[k + 1]]
        parameters = ImageParameters(tuple(codes.astype(int).tolist()), sigma, (), (), ())
        models.append(cast(ImageModel, PartModel(registered()[equation], parameters)))
    ids = tuple(i.decode() for i in arrays["ids"].tolist())
    nowhere = np.full((len(ids), 3), np.nan)
    unknown = Coordinates(nowhere, nowhere, np.zeros(len(ids), bool))
    nothing, one = np.zeros(len(arrays["image"])), np.ones(len(arrays["image"]))
    observations = ImagePoints(arrays["image"], arrays["point"], nothing, nothing, one, one)
    options = Options(**(json.loads(arrays["options"].tobytes()) | {"priors": False}))
    block = Block(
        name,
        tuple(Image(i, cast(Sensor, None)) for i in images),
        GroundPoints(ids, (Role.TIE,) * len(ids), unknown),
        observations,
        WithheldCoordinates(),
        options,
    )
    start = State(np.zeros((len(models), int(np.diff(first).max()))), arrays["start"])
    return Problem(
        block,
        tuple(models),
        observations,
        arrays["records"],
        arrays["origin_m"],
        start,
        arrays["active"],
        arrays["observed"],
        arrays["control_records"],
    )


def part_file(folder: str | Path, number: int) -> Path:
    """Return the file of a part."""
    return Path(folder) / f"part-{number:04d}.npz"


def write_part(problem: Problem, points: Index, rows: Index, folder: Path, number: int) -> None:
    """Write the file of a part completely or not at all; InputError if it cannot be written."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **part_of(problem, points, rows))
    # not durable, because after a crash the work begins again
    write_bytes(part_file(folder, number), stream.getvalue(), durable=False)


def read_part(folder: str, number: int) -> Problem:
    """Read the problem of a part.

    InputError: the file is missing or incomplete, because this process has no access to the folder, or it was written
    by another version of this package.
    """
    path = part_file(folder, number)
    arrays = load_npz(path, "parallel.folder", kinds=KINDS + "S")
    if str(arrays["version"]) != __version__:
        raise InputError.of("parallel.version", file=path, value=__version__, written=str(arrays["version"]))
    return part_problem(f"part {number}", arrays)


def _ground_file(folder: str | Path, part: int, name: str) -> Path:
    return Path(folder) / f"ground-{part:04d}-{name}.npy"


def write_ground(folder: str | Path, part: int, name: str, ground: Array) -> None:
    """Write the ground points (P, 3) of a part at a state, completely or not at all."""
    write_array(_ground_file(folder, part, name), ground)


def read_ground(folder: str | Path, part: int, name: str) -> Array:
    """Read the ground points (P, 3) of a part. InputError if this process has no access to the file."""
    return np.array(read_array(_ground_file(folder, part, name)))


def write_array(path: Path, array: Array) -> None:
    """Write an array to a file completely or not at all."""
    stream = io.BytesIO()
    np.save(stream, array)
    write_bytes(path, stream.getvalue(), durable=False)


def read_array(path: Path) -> Array:
    """Map the array of a file; InputError if this process has no access to it."""
    try:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False), dtype=np.float64)
    # TypeError: the file contains an archive or records instead of an array
    except (OSError, ValueError, EOFError, TypeError) as error:
        raise InputError.of("parallel.folder", file=path, value=type(error).__name__) from error
