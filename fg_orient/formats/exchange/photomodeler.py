"""Export files of PhotoModeler, and point files of DBAT, a program that reads these exports.

PhotoModeler exports a project as text ("Bundle Soln"). It also exports a table of 2D points.

Empty lines divide the text export into parts: image size and camera; each photo with its
projection centre and the angles kappa, phi, omega (degrees); known points; all points in
a shifted system; marks. Lengths of the camera are in mm. Its polynomial converts measured
to ideal coordinates, with y up. Photos are numbered from 0; in the tables, they are
numbered from 1. If the image size is missing, the size that fits the marks best is used,
with a note. Pixel coordinates point right and down. Marks and principal point have the
same origin, which neither file states. The centre of the first pixel is assumed, because
DBAT's results are then reproduced (docs/frame-cameras.md).

Point files of DBAT contain marks (image points) or control points. Commas separate the cells of a line.

The last comment before the first line states the order of the cells, as in DBAT's own
examples: ``# Format: image id, point id, x, y, sxy``. x points right and y down, in
pixels. The files do not state the origin. The centre of the first pixel is assumed,
because DBAT's results are then reproduced (docs/frame-cameras.md). A control point has
the cells id, name, X, Y, Z. Unless it is fixed, one standard deviation or three follow.
An observed projection centre has the cells photo, X, Y, Z, and one standard deviation or
three; ``closerange import`` reads it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.columns import finite
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, positions, require_once
from fg_orient.formats.exchange.ties import model_survey, tie_survey
from fg_orient.formats.faults import Faults
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role
from fg_orient.sensors.conventions import CONVENTIONS, Image
from fg_orient.sensors.frame import rotation_of_opk
from fg_orient.sensors.interior import Interior

Paragraph = list[tuple[int, list[str]]]

HEAD: Final = "Bundle Soln"
#: The header of the table of 2D points begins with these columns.
TABLE: Final = "Object Point ID,Photo #,X (pixels),Y (pixels)"
#: The image size from marks is rounded to whole pixels if its standard deviation is not larger than this, px.
SIZE_SIGMA_PX: Final = 0.25
#: Numbers of cells in the line of a point and in the line of a mark.
_POINT, _MARK = 7, 6
#: Number of lines before the camera of the first photo; numbers of cells in a line of a
#: camera, in the head and before each further photo.
_HEAD_LINES, _CAMERA = 3, (10, 11)


def read_photomodeler(path: str | Path, image_sizes: Mapping[str, tuple[int, int]] | None = None) -> FrameModel:
    """Read a text export in UTF-8 or Latin-1.

    Parameters
    ----------
    path : str or Path
    image_sizes : mapping of str to (n_lines, n_samples), optional
        Size of any photo, if the export does not contain it. By default, the size that fits the marks is used.

    Raises
    ------
    InputError
        The file cannot be read, has another format or a faulty line. Or the image size is
        not stated and cannot be determined.
    """
    text = TextLines(Path(path), latin1=True)
    rows = [(n, line.split()) for n, line in enumerate(text.lines, start=1)]
    if not text.lines[0].startswith(HEAD):
        text.refuse(1, f"{HEAD} ...")
    settings = 2 if len(rows) > 1 and len(rows[1][1]) == 2 else 4
    size, camera = (text.numbers(rows[k : k + 1] or [(k + 1, [])], n, "image size and camera")[0]
                    for k, n in ((1, settings), (3, 10)))  # fmt: skip
    if not ((size[2:] > 0).all() and (camera[3:5] > 0).all()):
        text.refuse(2 if (camera[3:5] > 0).all() else 4, "image size and camera")
    paragraphs = [list(group) for filled, group in groupby(rows, lambda row: bool(row[1])) if filled]
    poses = _poses(text, paragraphs)
    points, marks = _table(text, paragraphs[::-1], _POINT, "points"), _table(text, paragraphs, _MARK, "marks")
    ids, first = np.unique(points[:, 0], return_index=True)
    at = positions(ids, marks[:, 1])
    bad = marks[(at < 0) | (marks[:, 0] >= len(poses))]
    faults = Faults(text.path.name)
    for photo, point in bad[:, :2]:
        faults.add("photomodeler.mark", value=f"photo {photo:g}, point {point:g}")
    faults.raise_if_any()
    model = FrameModel(
        {}, poses, tuple(str(int(i)) for i in ids), points[first, 1:4], marks[:, 0].astype(np.intp), at, marks[:, 3],
        marks[:, 2], text.notes,
    )  # fmt: skip
    given = image_sizes or {}
    stated = [(int(size[3]), int(size[2]))] if len(size) == 4 else [given[p.name] for p in poses if p.name in given]
    (lines, samples), notes = (stated[0], ()) if stated else _size_of_marks(model, camera, text.path.name)
    return replace(model, cameras={"1": _interior(lines, samples, camera)}, notes=(*text.notes, *notes))


def _size_of_marks(model: FrameModel, camera: Array, file: str) -> tuple[tuple[int, int], tuple[Finding, ...]]:
    """Estimate lines and samples such that the marks fit the poses and points of the export; also return a note."""
    photo = model.poses[0].name if model.poses else "PHOTO"
    in_mm = replace(model, cameras={"1": _interior(1, 1, camera, 1.0)}, line=0.0 * model.line, sample=0.0 * model.line)
    computed, marks = in_mm.residuals_px(), np.column_stack([model.line, model.sample])
    seen = np.isfinite(computed).all(axis=1)
    computed, marks = computed[seen], marks[seen]
    squares = np.sum(computed**2, axis=0)
    with np.errstate(all="ignore"):
        scale = np.sum(computed * marks, axis=0) / squares
        sigma = np.sqrt(np.mean((marks - scale * computed) ** 2, axis=0) / squares)
        fit, sigma = scale * camera[[4, 3]], sigma * camera[[4, 3]]
    if not (seen.sum() > 3 and (fit >= 1.0).all() and (sigma <= SIZE_SIGMA_PX).all()):
        value = " x ".join(f"{n:.1f}" for n in fit)
        raise InputError.of("photomodeler.size", file=file, place="line 2", value=value, photo=photo)
    lines, samples = (round(n) for n in fit.tolist())
    note = finding("photomodeler.size_found", file=file, photo=photo, n_lines=lines, n_samples=samples,
                   fit_lines=fit[0], fit_samples=fit[1])  # fmt: skip
    return (lines, samples), (note,)


def _interior(n_lines: int, n_samples: int, camera: Array, px: float = 0.0) -> Interior:
    """Return the camera of the head: focal length, principal point, format (mm), k1 to k3, p1, p2.

    ``px`` is the number of pixels per mm.
    """
    image = Image(n_lines, n_samples, px or n_lines / float(camera[4]))
    return CONVENTIONS["photomodeler"].interior(np.delete(camera, [3, 4]), image, "1")


def _poses(text: TextLines, paragraphs: list[Paragraph]) -> tuple[Pose, ...]:
    """Return the photos.

    A photo has two lines of the camera, a line with number and file, and a line with
    number, projection centre, kappa, phi, omega and their standard deviations.
    """
    out: list[Pose] = []
    for paragraph in (paragraphs[0][_HEAD_LINES:], *paragraphs[1:]):
        if len(paragraph) != 5 or len(paragraph[0][1]) not in _CAMERA:
            continue
        (number, name), (at, cells) = paragraph[2:4]
        needed = "photo, X, Y, Z, kappa, phi, omega; photos count from 0"
        station = text.numbers([(at, cells)], 7, needed)[0]
        if len(name) < 2 or name[0] != str(len(out)):
            text.refuse(at, needed)
        rotation = rotation_of_opk(*np.radians(station[:3:-1]).tolist())
        file = re.split(r"[/\\]", text.lines[number - 1].strip())[-1].removeprefix(f"{len(out)} ").strip()
        out.append(Pose(file, "1", rotation, station[1:4]))
    return tuple(out)


def _table(text: TextLines, paragraphs: list[Paragraph], width: int, what: str) -> Array:
    """Return the first table (n, width) among the paragraphs."""
    for paragraph in paragraphs:
        if all(len(cells) == width for _, cells in paragraph):
            return text.numbers(paragraph, width, f"{width} numbers")
    raise InputError.of("photomodeler.part", file=text.path.name, value=what)


def read_points_2d(path: str | Path) -> Survey:
    """Read a table of 2D points; the numbers of the photos are their names.

    It raises the same errors as :func:`read_photomodeler`.
    """
    text = TextLines(Path(path), latin1=True)
    head = next((k for k, line in enumerate(text.lines) if line.startswith(TABLE)), None)
    if head is None:
        text.refuse(1, f"{HEAD} ..., or a table with {TABLE}")
    rows = [(n, line.split(",")[:4]) for n, line in enumerate(text.lines, start=1) if n > head + 1 and line.strip()]
    table = text.numbers(rows, 4, TABLE)
    photos, image = np.unique(table[:, 1], return_inverse=True)
    ids, point = np.unique(table[:, 0], return_inverse=True)
    require_once(
        image * len(ids) + point, "point in this photo", text.path.name,
        lambda k: (f"line {rows[k][0]}", ",".join(rows[k][1])),
    )  # fmt: skip
    names = [str(int(photo)) for photo in photos]
    return tie_survey(names, [str(int(i)) for i in ids], image, point, table[:, 3], table[:, 2], text.notes)


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the image points of a text export or of a table of 2D points."""
    if TextLines(paths[0], latin1=True).lines[0].startswith(HEAD):
        return model_survey(read_photomodeler(paths[0], settings.image_sizes))
    return read_points_2d(paths[0])


FORMAT: Final = Format(
    name="photomodeler",
    title="PhotoModeler text export, or table of 2D points",
    files=("export",),
    first_pixel=(0.0, 0.0),
    pixel_axes="x right, y down (pixels)",
    ground_axes="local X, Y, Z (left out: they are results)",
    holds=frozenset({Holds.IMAGE, Holds.TIES}),
    read=read,
    read_model=lambda paths, settings: read_photomodeler(paths[0], settings.image_sizes),
    evidence="the projects published with DBAT; the pixel origin is an assumption",
)

# --- DBAT ------------------------------------------------------------------------------------------

#: Words in the comment that name each kind of cell.
_WORDS: Final = {
    "image": "image", "image id": "image", "im": "image", "id": "point", "point id": "point", "op id": "point",
    "x": "x", "y": "y", "sxy": "sigma",
}  # fmt: skip
_CONTROL: Final = "id, name, X, Y, Z, then nothing (fixed), one sigma, or sigmaX, sigmaY, sigmaZ"
_CENTRES: Final = "photo, X, Y, Z, then one sigma, or sigmaX, sigmaY, sigmaZ"


def read_marks(path: Path) -> tuple[list[str], list[str], Array]:
    """Read image and point of each mark, and x, y, standard deviation (n, 3), px.

    The standard deviation is nan if the file does not contain it. InputError: no comment
    states the order of the cells, a line is faulty, or an image has two marks of a point.
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
    pairs = list(zip(points, images, strict=True))
    require_once(pairs, "mark", path.name, lambda k: ("", f"point {points[k]} in image {images[k]}"))
    return images, points, values


def read_control(path: Path) -> tuple[list[str], Array]:
    """Read the ids of control points, and X, Y, Z with three standard deviations (n, 6), nan for fixed points."""
    rows = _rows(path, 2, (3, 4, 6), _CONTROL)
    spread = {name: values[3:] if len(values) > 3 else [np.nan] for name, values in rows.items()}
    whole = [np.append(values[:3], np.broadcast_to(spread[name], 3)) for name, values in rows.items()]
    return list(rows), np.array(whole, float).reshape(-1, 6)


def read_centres(path: Path) -> dict[str, Array]:
    """Read X, Y, Z and three standard deviations (6,) of observed projection centres, by photo."""
    rows = _rows(path, 1, (4, 6), _CENTRES)
    return {name: np.append(values[:3], np.broadcast_to(values[3:], 3)) for name, values in rows.items()}


def _rows(path: Path, first: int, counts: tuple[int, ...], needed: str) -> dict[str, Array]:
    """Read three coordinates and the standard deviations from cell ``first`` on.

    The first cell is the name.
    """
    text, rows = TextLines(path), list[tuple[str, Array]]()
    content = text.content()
    for number, line in content:
        cells = [cell.strip() for cell in line.split(",")]
        values = finite(cells[first:])
        if values is None or len(values) not in counts or not cells[0] or (values[3:] <= 0.0).any():
            text.refuse(number, needed)
        rows.append((cells[0], values))
    names = [name for name, _ in rows]
    require_once(names, "name", path.name, lambda k: (f"line {content[k][0]}", names[k]))
    return dict(rows)


def read_dbat(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read marks and, from the second file, control points; the settings state their CRS."""
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


DBAT: Final = Format(
    name="dbat",
    title="Damped Bundle Adjustment Toolbox: marks and control points",
    files=("marks", "control"),
    first_pixel=(0.0, 0.0),
    pixel_axes="x right, y down (pixels)",
    ground_axes="X, Y, Z of any system",
    holds=frozenset({Holds.IMAGE, Holds.TIES, Holds.GROUND, Holds.HEIGHTS, Holds.SIGMA_GROUND, Holds.SIGMA_UP,
                     Holds.SIGMA_EAST_NORTH, Holds.SIGMA_IMAGE, Holds.FIXED}),
    read=read_dbat,
    evidence="the examples published with DBAT; the pixel origin is an assumption",
)  # fmt: skip
