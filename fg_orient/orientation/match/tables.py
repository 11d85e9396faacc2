"""Functions that add tie points to the tables of a project; other content of the files is kept."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.points import COLUMNS, SIGMA_COLUMNS
from fg_orient.formats.points_write import write_observations, write_points
from fg_orient.formats.project import NEW_OBSERVATIONS, OWN, ProjectImages
from fg_orient.formats.table_write import is_binary, own_cell, texts
from fg_orient.formats.tables import require_table
from fg_orient.formats.toml import entries
from fg_orient.geodesy import COORDINATE_COLUMNS, crs_kind
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.match.tracks import TiePoints

#: Table of points for a project without a table.
NEW_POINTS: Final = {"file": "points.csv", "crs": "EPSG:4979"}
#: Ids of matched points: this prefix and a number.
PREFIX: Final = "match-"
CHIP: Final = f"{PREFIX}chip-"
_OWN_ID: Final = re.compile(rf'"?({PREFIX}\d+|{CHIP}.+)"?$')


def ids_of(n: int) -> list[str]:
    """Return the ids of n points."""
    width = max(6, len(str(n)))
    return [f"{PREFIX}{k + 1:0{width}d}" for k in range(n)]


class ControlRows(NamedTuple):
    """Control points measured by chips: ids, coordinates (n, 3) in project's CRS, sigmas (n, 3) m, and their marks."""

    ids: list[str]
    coordinates: Array
    sigma_m: Array
    image: Index
    point: Index
    pixel: Array
    sigma_px: Array


def require_tables(path: Path, project: ProjectImages, *, overwrite: bool) -> None:
    """Refuse tables to which tie points cannot be added; call it before matching.

    Raises
    ------
    InputError
        A file is not a table with ids, has another format or a binary form, or contains matched points, which only
        ``overwrite`` replaces.
    """
    for name, entry in (("points", project.points), ("observations", project.observations)):
        if entry.file is None:
            continue
        file = path.parent / entry.file
        if entry.format != OWN or is_binary(file) or (file.exists() and "id" not in _header(_lines(file))):
            raise InputError.of("match.table_form", file=path, place=f"{name}.file", value=entry.file)
        if file.exists() and not overwrite and any(_matched(line) for line in _lines(file)):
            raise InputError.of("match.matched", file=file, option="overwrite")


def table_files(path: Path, project: ProjectImages) -> list[Path]:
    """Files that :func:`write_tables` may replace or make, the project file among them."""
    folder = path.parent
    return [path, folder / project.observations.file, folder / (project.points.file or NEW_POINTS["file"])]


def write_tables(path: Path, project: ProjectImages, ties: TiePoints, control: ControlRows | None = None) -> list[str]:
    """Write points to the tables of a project and replace the points of an earlier run; return the files."""
    folder, names = path.parent, ids_of(ties.n_points)
    observations, images = folder / project.observations.file, [entry.id for entry in project.entries]
    of_image, of_point = [images[k] for k in ties.image.tolist()], [names[k] for k in ties.point.tolist()]
    pixel, sigma, added = ties.pixel, ties.sigma_px, list[str]()
    if control is not None:
        added = [f"{CHIP}{name}" for name in control.ids]
        of_image += [images[k] for k in control.image.tolist()]
        of_point += [added[k] for k in control.point.tolist()]
        pixel, sigma = np.vstack([pixel, control.pixel]), np.vstack([sigma, control.sigma_px])
    written, entries_ = [observations], list[str]()
    if project.points.file is not None or added:
        # a project without a table of points has only tie points. If control points are
        # added, the new table must contain all ids
        others = _ids(observations) if project.points.file is None else []
        points = folder / (project.points.file or NEW_POINTS["file"])
        _write_points(points, project.points.crs or NEW_POINTS["crs"], [*others, *names], added, control)
        written.append(points)
        entries_ += [] if project.points.file else ["", "[points]", *entries(NEW_POINTS)]
    pixel, sigma = np.round(pixel, 4), np.round(sigma, 4)
    if observations.exists():
        columns = (of_image, of_point, *(texts(column) for column in (*pixel.T, *sigma.T)))
        _append(observations, dict(zip(COLUMNS, columns, strict=True)))
    else:
        write_observations(observations, of_image, of_point, pixel, sigma)
    entries_ += ["", "[observations]", *entries(NEW_OBSERVATIONS)] if project.is_new else []
    if entries_:
        write_lines(path, [path.read_bytes().decode("utf-8-sig").rstrip(), *entries_])
        written.append(path)
    return [str(file) for file in written]


def _write_points(file: Path, crs: str, ties: list[str], added: list[str], control: ControlRows | None) -> None:
    """Write tie points and control points to a table of points."""
    kind, names = crs_kind(crs), [*ties, *added]
    roles = [Role.TIE] * len(ties) + [Role.CONTROL] * len(added)
    coordinates, sigma_m = np.full((len(names), 3), np.nan), np.full((len(names), 3), np.nan)
    if control is not None:
        coordinates[len(ties) :], sigma_m[len(ties) :] = control.coordinates, control.sigma_m
    if not file.exists():
        write_points(file, names, roles, coordinates, sigma_m, kind=kind)
        return
    numbers = dict(zip(COORDINATE_COLUMNS[kind], coordinates.T, strict=True))
    numbers |= zip(SIGMA_COLUMNS, sigma_m.T, strict=True)
    words = {name: ["" if text == "nan" else text for text in texts(column)] for name, column in numbers.items()}
    _append(file, {"id": names, "role": [str(role) for role in roles], **words})


def _ids(observations: Path) -> list[str]:
    """Return the ids of the points in a table of image points, without matched points."""
    if not observations.exists():
        return []
    table = require_table(observations, [COLUMNS])
    return [name for name in dict.fromkeys(table.cells["id"]) if not _OWN_ID.match(name)]


def _lines(file: Path) -> list[str]:
    try:
        return file.read_bytes().decode("utf-8-sig").replace("\r\n", "\n").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError.of("match.table_unreadable", file=file, value=type(error).__name__) from None


def _matched(line: str) -> bool:
    """Return whether a record belongs to a matched point: its id is in the first or the second cell."""
    return any(_OWN_ID.match(cell.strip()) for cell in line.split(",")[:2])


def _header(lines: list[str]) -> list[str]:
    """Return the names of the columns of a CSV table; no names for an empty file."""
    header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    return [cell.strip().strip('"') for cell in header.split(",")]


def _append(file: Path, columns: dict[str, list[str]]) -> None:
    """Append records to a CSV table in the order of its columns; they replace records of matched points."""
    lines = [line for line in _lines(file) if not _matched(line)]
    while lines and not lines[-1].strip():
        del lines[-1]
    order = _header(lines)
    n = len(next(iter(columns.values())))
    cells = [[own_cell(cell) for cell in columns[name]] if name in columns else [""] * n for name in order]
    write_lines(file, [*lines, *(",".join(row) for row in zip(*cells, strict=True))])
