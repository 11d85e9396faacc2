"""Exports of PhotoModeler: the text export of a project ("Bundle Soln") and the table of 2D points.

The text export is read in parts between empty lines: image size and camera; each photo with its projection centre and
the angles kappa, phi, omega (degrees); known points; all points, in a shifted system; marks. Lengths of the camera are
mm, its polynomial leads from measured to ideal coordinates with y up, photos count from 0 (from 1 in tables).
Pixels run right and down. Neither file says where they are counted from: marks and principal point have one origin,
which is taken for the centre of the first pixel, as DBAT's results are reproduced (docs/frame-cameras.md).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_lines
from fg_orient.formats.exchange.ties import model_survey, tie_survey
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, rotation_of_opk
from fg_orient.sensors.interior import Interior

Array = npt.NDArray[np.float64]
Paragraph = list[tuple[int, list[str]]]

HEAD: Final = "Bundle Soln"
#: First columns of the table of 2D points.
TABLE: Final = "Object Point ID,Photo #,X (pixels),Y (pixels)"
#: Cells of a line of known or all points, and of marks.
_POINT, _MARK = 7, 6
#: Lines before the camera of the first photo; cells of a line of a camera, in the head and before each further photo.
_HEAD_LINES, _CAMERA = 3, (10, 11)


def read_photomodeler(path: str | Path) -> FrameModel:
    """Read a text export.

    Raises
    ------
    InputError
        The file cannot be read, has another format, or a line is faulty.
    """
    path = Path(path)
    lines = read_lines(path)
    if not lines[0].startswith(HEAD):
        _refuse(path, 1, lines[0], f"{HEAD} ...")
    size, camera = (finite(lines[k].split()) if len(lines) > 4 else None for k in (1, 3))
    if size is None or len(size) != 4 or camera is None or len(camera) != 10 or not (size[2:] > 0).all():
        _refuse(path, 2 if size is None or len(size) != 4 else 4, " ".join(lines[1:4:2]), "image size and camera")
    interior = _interior(size, camera)
    paragraphs = _paragraphs(lines)
    poses = _poses(path, lines, paragraphs)
    tables = _tables(path, paragraphs)
    points, marks = tables[_POINT], tables[_MARK]
    ids, first = np.unique(points[:, 0], return_index=True)
    at = np.searchsorted(ids, marks[:, 1])
    known = at < len(ids)
    known[known] = ids[at[known]] == marks[known, 1]
    if not known.all() or (marks[:, 0] >= len(poses)).any():
        bad = marks[~known | (marks[:, 0] >= len(poses))][0]
        raise InputError.of("photomodeler.mark", file=path.name, value=f"photo {bad[0]:g}, point {bad[1]:g}")
    return FrameModel(
        {"1": interior}, poses, tuple(str(int(i)) for i in ids), points[first, 1:4],
        marks[:, 0].astype(np.intp), at, marks[:, 3], marks[:, 2],
    )  # fmt: skip


def _interior(size: Array, camera: Array) -> Interior:
    """Camera of the head: focal length, principal point, format (mm), k1 to k3, p1, p2."""
    f, x, y, _, height_mm, k1, k2, k3, p1, p2 = camera.tolist()
    px = float(size[3]) / height_mm
    polynomial = np.array([k1, k2, k3, -p2, p1])  # y up becomes y down
    return Interior(
        int(size[3]), int(size[2]), f * px, np.array([y, x]) * px, polynomial, MEASURED_TO_IDEAL, px, name="1"
    )  # fmt: skip


def _poses(path: Path, lines: list[str], paragraphs: list[Paragraph]) -> tuple[Pose, ...]:
    """Photos: two lines of the camera, number and file, then number, centre, kappa, phi, omega, and sigmas."""
    out: list[Pose] = []
    for paragraph in (paragraphs[0][_HEAD_LINES:], *paragraphs[1:]):
        if len(paragraph) != 5 or len(paragraph[0][1]) not in _CAMERA:
            continue
        (number, name), (at, cells) = paragraph[2:4]
        station = finite(cells)
        if station is None or len(station) != 7 or len(name) < 2 or name[0] != str(len(out)):
            _refuse(path, at, lines[at - 1], "photo, X, Y, Z, kappa, phi, omega; photos count from 0")
        rotation = rotation_of_opk(*np.radians(station[:3:-1]).tolist())
        file = re.split(r"[/\\]", lines[number - 1].strip())[-1].removeprefix(f"{len(out)} ").strip()
        out.append(Pose(file, "1", rotation, station[1:4]))
    return tuple(out)


def _tables(path: Path, paragraphs: list[Paragraph]) -> dict[int, Array]:
    """The last table of points and the first of marks among the paragraphs, by their number of cells."""
    found: dict[int, Array] = {}
    for paragraph in paragraphs:
        width = len(paragraph[0][1])
        if width not in (_POINT, _MARK) or any(len(cells) != width for _, cells in paragraph):
            continue
        values = finite([cell for _, cells in paragraph for cell in cells])
        if values is None:
            number, cells = next((n, cells) for n, cells in paragraph if finite(cells) is None)
            _refuse(path, number, " ".join(cells), f"{width} numbers")
        if width == _POINT or width not in found:
            found[width] = values.reshape(-1, width)
    for width, what in ((_POINT, "points"), (_MARK, "marks")):
        if width not in found:
            raise InputError.of("photomodeler.part", file=path.name, value=what)
    return found


def _paragraphs(lines: list[str]) -> list[Paragraph]:
    out: list[Paragraph] = [[]]
    for number, line in enumerate(lines, start=1):
        if line.strip():
            out[-1].append((number, line.split()))
        elif out[-1]:
            out.append([])
    return [paragraph for paragraph in out if paragraph]


def read_points_2d(path: str | Path) -> Survey:
    """Read a table of 2D points; photos are named by their numbers.

    Raises
    ------
    InputError
        The file cannot be read, has another format, or a line is faulty.
    """
    path = Path(path)
    lines = read_lines(path)
    head = next((k for k, line in enumerate(lines) if line.startswith(TABLE)), None)
    if head is None:
        _refuse(path, 1, lines[0], f"{HEAD} ..., or a table with {TABLE}")
    rows = [(n, line.split(",")[:4]) for n, line in enumerate(lines[head + 1 :], start=head + 2) if line.strip()]
    values = finite([cell for _, cells in rows for cell in cells]) if all(len(c) == 4 for _, c in rows) else None
    if values is None:
        number, cells = next((n, c) for n, c in rows if len(c) != 4 or finite(c) is None)
        _refuse(path, number, ",".join(cells), TABLE)
    table = values.reshape(-1, 4)
    photos, image = np.unique(table[:, 1], return_inverse=True)
    ids, point = np.unique(table[:, 0], return_inverse=True)
    pair = image * len(ids) + point
    if len(np.unique(pair)) < len(pair):
        again = int(np.setdiff1d(np.arange(len(pair)), np.unique(pair, return_index=True)[1])[0])
        raise InputError.of(
            "photomodeler.twice", file=path.name, place=f"line {rows[again][0]}", value=",".join(rows[again][1])
        )  # fmt: skip
    names = [str(int(photo)) for photo in photos]
    return tie_survey(names, [str(int(i)) for i in ids], image, point, table[:, 3], table[:, 2])


def _refuse(path: Path, number: int, found: str, needed: str) -> NoReturn:
    raise InputError.of(
        "photomodeler.cells", file=path.name, place=f"line {number}", value=repr(found), needed=needed
    )  # fmt: skip


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the image points of either file."""
    if read_lines(paths[0])[0].startswith(HEAD):
        return model_survey(read_photomodeler(paths[0]))
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
    read_model=lambda paths, settings: read_photomodeler(paths[0]),
    evidence="the projects published with DBAT; the pixel origin is an assumption",
)
