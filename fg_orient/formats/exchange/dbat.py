"""Point files of DBAT: marks (image points) and control points, lines of cells between commas.

The order of the cells is that of the last comment before the first line, such as ``# Format: image id, point id, x, y,
sxy``, which DBAT's own examples have. x runs right and y down, pixels; the files do not say where they are counted
from: the origin is taken for the centre of the first pixel, as DBAT's results are reproduced (docs/frame-cameras.md).
Control points: id, name, X, Y, Z and, unless they are fixed, one standard deviation or one for each axis.
Observed projection centres: photo, X, Y, Z, one standard deviation or three; ``closerange import`` reads them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_lines
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]

#: Words of the comment for the cells that are read.
_WORDS: Final = {
    "image": "image", "image id": "image", "im": "image", "id": "point", "point id": "point", "op id": "point",
    "x": "x", "y": "y", "sxy": "sigma",
}  # fmt: skip
_CONTROL: Final = "id, name, X, Y, Z, then nothing (fixed), one sigma, or sigmaX, sigmaY, sigmaZ"
_CENTRES: Final = "photo, X, Y, Z, then one sigma, or sigmaX, sigmaY, sigmaZ"


def read_marks(path: Path) -> tuple[list[str], list[str], Array]:
    """Image and point of each mark, and x, y, sigma (n, 3) in pixels, nan where the file gives no sigma.

    Raises
    ------
    InputError
        No comment tells the order of the cells, or a line is faulty.
    """
    lines = read_lines(path)
    order: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        if line.startswith("#") and not rows:
            words = [word.strip().lower() for word in line[1:].rpartition(":")[2].split(",")]
            order = [_WORDS[word] for word in words] if all(word in _WORDS for word in words) else order
        elif line.strip() and not line.startswith("#"):
            rows.append((number, [cell.strip() for cell in line.split(",")]))
    if not {"image", "point", "x", "y"} <= set(order) or len(set(order)) < len(order):
        raise InputError.of("dbat.order", file=path.name, value=lines[0])
    for number, cells in rows:
        if len(cells) != len(order) or not all(cells):
            raise InputError.of(
                "dbat.cells", file=path.name, place=f"line {number}", value=",".join(cells), needed=", ".join(order)
            )  # fmt: skip
    column = {name: [cells[k] for _, cells in rows] for k, name in enumerate(order)}
    values = np.full((len(rows), 3), np.nan)
    for k, name in enumerate(("x", "y", "sigma")):
        found = finite(column[name]) if name in column else np.full(len(rows), np.nan)
        if found is None or (name == "sigma" and (found <= 0.0).any()):
            bad = next(j for j, cell in enumerate(column[name]) if not _positive(cell, any_sign=name != "sigma"))
            place = f"line {rows[bad][0]}"
            raise InputError.of("dbat.cells", file=path.name, place=place, value=column[name][bad], needed=name)
        values[:, k] = found
    return column["image"], column["point"], values


def _positive(cell: str, *, any_sign: bool) -> bool:
    value = finite([cell])
    return value is not None and (any_sign or bool(value[0] > 0.0))


def read_control(path: Path) -> tuple[list[str], Array]:
    """Ids of control points, and X, Y, Z, three sigmas (n, 6); sigmas of fixed points are nan.

    Raises
    ------
    InputError
        A line is faulty, or an id occurs twice.
    """
    rows = _rows(path, 2, (3, 4, 6), _CONTROL)
    spread = {name: values[3:] if len(values) > 3 else [np.nan] for name, values in rows.items()}
    whole = [np.append(values[:3], np.broadcast_to(spread[name], 3)) for name, values in rows.items()]
    return list(rows), np.array(whole, float).reshape(-1, 6)


def read_centres(path: Path) -> dict[str, Array]:
    """X, Y, Z and three sigmas (6,) of observed projection centres by photo.

    Raises
    ------
    InputError
        A line is faulty, or a photo occurs twice.
    """
    rows = _rows(path, 1, (4, 6), _CENTRES)
    return {name: np.append(values[:3], np.broadcast_to(values[3:], 3)) for name, values in rows.items()}


def _rows(path: Path, first: int, counts: tuple[int, ...], needed: str) -> dict[str, Array]:
    """Numbers from cell ``first`` on by the name in the first cell; so many of them, sigmas behind three coordinates.

    Raises
    ------
    InputError
        A line is faulty, or a name occurs twice.
    """
    out: dict[str, Array] = {}
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        cells = [cell.strip() for cell in line.split(",")]
        values, place = finite(cells[first:]), f"line {number}"
        if values is None or len(values) not in counts or not cells[0] or (values[3:] <= 0.0).any():
            raise InputError.of("dbat.cells", file=path.name, place=place, value=line.strip(), needed=needed)
        if cells[0] in out:
            raise InputError.of("dbat.twice", file=path.name, place=place, value=cells[0])
        out[cells[0]] = values
    return out


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read marks and, as second file, control points; their CRS is that of the settings."""
    images, points, marks = read_marks(paths[0])
    names, control = read_control(paths[1]) if len(paths) > 1 else ([], np.empty((0, 6)))
    ids = list(dict.fromkeys([*names, *points]))
    image_ids = list(dict.fromkeys(images))
    point_row, image_row = ({name: k for k, name in enumerate(known)} for known in (ids, image_ids))
    at, of = np.array([point_row[p] for p in points], np.intp), np.array([image_row[i] for i in images], np.intp)
    pair, first = np.unique(of * max(len(ids), 1) + at, return_index=True)
    if len(pair) < len(at):
        again = int(np.setdiff1d(np.arange(len(at)), first)[0])
        value = f"point {points[again]} in image {images[again]}"
        raise InputError.of("dbat.twice", file=paths[0].name, value=value)
    rest = np.full((len(ids) - len(names), 6), np.nan)
    table = np.concatenate([control, rest])
    fixed = np.isfinite(table[:, 0]) & np.isnan(table[:, 3])
    roles = (Role.CONTROL,) * len(names) + (Role.TIE,) * len(rest)
    x, y, sigma = marks.T
    observed = ImagePoints(of, at, y, x, sigma, sigma)
    return Survey(settings.crs, tuple(ids), roles, table[:, :3], table[:, 3:], fixed, tuple(image_ids), observed)


FORMAT: Final = Format(
    name="dbat",
    title="Damped Bundle Adjustment Toolbox: marks and control points",
    files=("marks", "control"),
    first_pixel=(0.0, 0.0),
    pixel_axes="x right, y down (pixels)",
    ground_axes="X, Y, Z of any system",
    holds=frozenset({Holds.IMAGE, Holds.TIES, Holds.GROUND, Holds.HEIGHTS, Holds.SIGMA_GROUND, Holds.SIGMA_UP,
                     Holds.SIGMA_EAST_NORTH, Holds.SIGMA_IMAGE, Holds.FIXED}),
    read=read,
    evidence="the examples published with DBAT; the pixel origin is an assumption",
)  # fmt: skip
