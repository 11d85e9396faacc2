"""Point files of DBAT: marks (image points) and control points, lines of cells between commas.

The last comment before the first line states the order of the cells, as in DBAT's own examples: ``# Format: image id,
point id, x, y, sxy``. x runs right and y down, in pixels. The files do not state the origin. It is assumed to be the
centre of the first pixel, because DBAT's results are reproduced with it (docs/frame-cameras.md).
Control points: id, name, X, Y, Z and, unless they are fixed, one standard deviation or one for each axis.
Observed projection centres: photo, X, Y, Z, one standard deviation or three; ``closerange import`` reads them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, require_once
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]

#: Words of the comment for each kind of cell.
_WORDS: Final = {
    "image": "image", "image id": "image", "im": "image", "id": "point", "point id": "point", "op id": "point",
    "x": "x", "y": "y", "sxy": "sigma",
}  # fmt: skip
_CONTROL: Final = "id, name, X, Y, Z, then nothing (fixed), one sigma, or sigmaX, sigmaY, sigmaZ"
_CENTRES: Final = "photo, X, Y, Z, then one sigma, or sigmaX, sigmaY, sigmaZ"


def read_marks(path: Path) -> tuple[list[str], list[str], Array]:
    """Image and point of each mark, and x, y, sigma (n, 3) in pixels, nan if the file has no sigma.

    InputError if no comment states the order of the cells, a line is faulty, or a point is marked twice in an image.
    """
    text = TextLines(path)
    order: list[str] = []
    rows = [(number, [cell.strip() for cell in line.split(",")]) for number, line in text.content()]
    for line in text.lines[: rows[0][0] if rows else None]:
        words = [word.strip().lower() for word in line[1:].rpartition(":")[2].split(",")]
        if line.startswith("#") and all(word in _WORDS for word in words):
            order = [_WORDS[word] for word in words]
    if not {"image", "point", "x", "y"} <= set(order) or len(set(order)) < len(order):
        raise InputError.of("dbat.order", file=path.name, value=text.lines[0])
    for number, cells in rows:
        if len(cells) != len(order) or not all(cells):
            text.refuse(number, ", ".join(order))
    values = np.full((len(rows), 3), np.nan)
    for k, name in enumerate(("x", "y", "sigma")):
        if name in order:
            at = order.index(name)
            values[:, k] = text.numbers([(number, cells[at : at + 1]) for number, cells in rows], 1, name)[:, 0]
    for k in np.flatnonzero(values[:, 2] <= 0.0)[:1]:
        text.refuse(rows[k][0], "sigma")
    images, points = ([cells[order.index(name)] for _, cells in rows] for name in ("image", "point"))
    pairs = np.array([f"{point}\n{image}" for point, image in zip(points, images, strict=True)], str)
    require_once(pairs, "mark", path.name, lambda k: ("", f"point {points[k]} in image {images[k]}"))
    return images, points, values


def read_control(path: Path) -> tuple[list[str], Array]:
    """Ids of control points, and X, Y, Z, three sigmas (n, 6); sigmas of fixed points are nan."""
    rows = _rows(path, 2, (3, 4, 6), _CONTROL)
    spread = {name: values[3:] if len(values) > 3 else [np.nan] for name, values in rows.items()}
    whole = [np.append(values[:3], np.broadcast_to(spread[name], 3)) for name, values in rows.items()]
    return list(rows), np.array(whole, float).reshape(-1, 6)


def read_centres(path: Path) -> dict[str, Array]:
    """X, Y, Z and three sigmas (6,) of observed projection centres by photo."""
    rows = _rows(path, 1, (4, 6), _CENTRES)
    return {name: np.append(values[:3], np.broadcast_to(values[3:], 3)) for name, values in rows.items()}


def _rows(path: Path, first: int, counts: tuple[int, ...], needed: str) -> dict[str, Array]:
    """Numbers from cell ``first`` on, by the name in the first cell: three coordinates, then sigmas."""
    text, rows = TextLines(path), list[tuple[str, Array]]()
    content = text.content()
    for number, line in content:
        cells = [cell.strip() for cell in line.split(",")]
        values = finite(cells[first:])
        if values is None or len(values) not in counts or not cells[0] or (values[3:] <= 0.0).any():
            text.refuse(number, needed)
        rows.append((cells[0], values))
    names = np.array([name for name, _ in rows], str)
    require_once(names, "name", path.name, lambda k: (f"line {content[k][0]}", names[k]))
    return dict(rows)


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read marks and, as second file, control points; their CRS is that of the settings."""
    images, points, marks = read_marks(paths[0])
    names, control = read_control(paths[1]) if len(paths) > 1 else ([], np.empty((0, 6)))
    ids, image_ids = list(dict.fromkeys([*names, *points])), list(dict.fromkeys(images))
    point_row, image_row = ({name: k for k, name in enumerate(known)} for known in (ids, image_ids))
    at, of = np.array([point_row[p] for p in points], np.intp), np.array([image_row[i] for i in images], np.intp)
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
