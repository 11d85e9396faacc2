"""Tie points in the tables of a project, and the tables in its project file; nothing else of these files changes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.points import COLUMNS
from fg_orient.formats.points_write import write_observations, write_points
from fg_orient.formats.project import OWN, TABLES, ProjectImages
from fg_orient.formats.table_write import is_binary, quoted, texts
from fg_orient.formats.toml import entries
from fg_orient.geodesy import crs_kind
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.match.tracks import TiePoints

#: Ids of matched points: this prefix and a number.
PREFIX: Final = "match-"
_OWN_ID: Final = re.compile(rf'"?{PREFIX}\d+"?$')


def ids_of(n: int) -> list[str]:
    """Ids of n points."""
    width = max(6, len(str(n)))
    return [f"{PREFIX}{k + 1:0{width}d}" for k in range(n)]


def require_tables(path: Path, project: ProjectImages, *, overwrite: bool) -> None:
    """Refuse tables that tie points cannot be added to; call it before matching.

    Raises
    ------
    InputError
        A table of another format or of binary form, or one with matched points, which only ``overwrite`` replaces.
    """
    for name in TABLES:
        entry = getattr(project, name)
        file = path.parent / entry.file
        if entry.format != OWN or is_binary(file):
            raise InputError.of("match.table_form", file=path, place=f"{name}.file", value=entry.file)
        if file.exists() and not overwrite and any(_matched(line) for line in _lines(file)):
            raise InputError.of("match.matched", file=file, option="overwrite")


def write_tables(path: Path, project: ProjectImages, ties: TiePoints) -> list[str]:
    """Write tie points to the tables of a project, in place of those of an earlier run; returns the files."""
    folder, names = path.parent, ids_of(ties.n_points)
    points, observations = folder / project.points.file, folder / project.observations.file
    images = [entry.id for entry in project.entries]
    of_image = [images[k] for k in ties.image.tolist()]
    of_point = [names[k] for k in ties.point.tolist()]
    if points.exists():
        _append(points, {"id": names, "role": [str(Role.TIE)] * len(names)})
    else:
        empty = np.full((len(names), 3), np.nan)
        kind = crs_kind(project.points.crs or "")
        write_points(points, names, [Role.TIE] * len(names), empty, empty, kind=kind)
    pixel, sigma = np.round(ties.pixel, 4), np.round(ties.sigma_px, 4)
    if observations.exists():
        numbers = [texts(column) for column in (*pixel.T, *sigma.T)]
        _append(observations, dict(zip(COLUMNS, (of_image, of_point, *numbers), strict=True)))
    else:
        write_observations(observations, of_image, of_point, pixel, sigma)
    if project.missing:
        _add_tables(path, project)
    return [str(points), str(observations), *([str(path)] if project.missing else [])]


def _lines(file: Path) -> list[str]:
    try:
        return file.read_bytes().decode("utf-8-sig").replace("\r\n", "\n").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError.of("match.table_unreadable", file=file, value=type(error).__name__) from None


def _matched(line: str) -> bool:
    """Whether a record belongs to a matched point: its id is in the first or the second cell."""
    return any(_OWN_ID.match(cell.strip()) for cell in line.split(",")[:2])


def _append(file: Path, columns: dict[str, list[str]]) -> None:
    """Add records to a CSV table in the order of its columns; records of matched points are replaced."""
    lines = [line for line in _lines(file) if not _matched(line)]
    while lines and not lines[-1].strip():
        del lines[-1]
    header = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    order = [cell.strip().strip('"') for cell in header.split(",")]
    n = len(next(iter(columns.values())))
    cells = [[quoted(cell) for cell in columns[name]] if name in columns else [""] * n for name in order]
    write_lines(file, [*lines, *(",".join(row) for row in zip(*cells, strict=True))])


def _add_tables(path: Path, project: ProjectImages) -> None:
    """Name the tables at the end of the project file; all that is there stays."""
    text = path.read_bytes().decode("utf-8-sig").rstrip()
    lines = [text]
    for name in project.missing:
        lines += ["", f"[{name}]", *entries(TABLES[name])]
    write_lines(path, lines)
