"""Writers of point tables, observation tables and project files in our own formats.

Numbers are written with the fewest digits that read back to the same double. Files are written whole or not at all
(:mod:`fg_orient.formats.atomic`). All writers raise ValueError if an id or comment could not be read back or lengths
differ, and InputError if the file cannot be written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.columns import rows_of_numbers
from fg_orient.formats.points import COLUMNS, FIXED, SIGMA_COLUMNS
from fg_orient.formats.toml import entries
from fg_orient.geodesy import COORDINATE_COLUMNS, Kind
from fg_orient.model.block import Options
from fg_orient.model.declaration import declared
from fg_orient.model.names import Role

__all__ = ["write_observations", "write_points", "write_project"]


def write_points(
    path: str | Path,
    ids: Sequence[str],
    roles: Sequence[Role],
    coordinates: Array,
    sigma_enu_m: Array,
    *,
    kind: Kind = "geographic",
    fixed: Mask | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write a table of ground points.

    Parameters
    ----------
    path : str or Path
    ids, roles : sequences of length n
    coordinates : (n, 3) array
        Longitude, latitude (degrees), height (m); easting, northing, height (m); or x, y, z (m), by ``kind``. nan rows
        become empty cells.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point, m; nan rows become empty cells.
    kind : str
        "geographic", "projected" or "geocentric".
    fixed : (n,) array of bool, optional
        Points whose sigma cells get the word ``fixed``.
    comments : sequence of str
        Lines before the header, after ``#``.
    """
    constant = [False] * len(ids) if fixed is None else np.asarray(fixed, bool).tolist()
    header = ("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS)
    words = {role: str(Role(role)) for role in set(roles)}
    xyz, sigma = rows_of_numbers(_triples(coordinates)), rows_of_numbers(_triples(sigma_enu_m))
    sigma = [",".join([FIXED] * 3) if fixed else text for text, fixed in zip(sigma, constant, strict=True)]
    _write(path, header, (_texts(ids), list(map(words.__getitem__, roles)), xyz, sigma), comments)


def write_observations(
    path: str | Path,
    image_ids: Sequence[str],
    point_ids: Sequence[str],
    pixels: Array,
    sigma_px: Array,
    *,
    comments: Sequence[str] = (),
) -> None:
    """Write a table of image observations.

    Parameters
    ----------
    path : str or Path
    image_ids, point_ids : sequences of length n
        Image and point of each record.
    pixels : (n, 2) array
        Line and sample; (0, 0) is the centre of the first pixel.
    sigma_px : (n, 2) array or broadcastable to it
        Standard deviations of line and sample.
    comments : sequence of str
        Lines before the header, after ``#``.
    """
    numbers = np.hstack([pixels, np.broadcast_to(sigma_px, np.shape(pixels))])
    _write(path, COLUMNS, (_texts(image_ids), _texts(point_ids), rows_of_numbers(numbers)), comments)


def write_project(
    path: str | Path,
    *,
    name: str,
    images: Sequence[tuple[str, str]],
    points: str = "points.csv",
    crs: str = "EPSG:4979",
    observations: str = "observations.csv",
    options: Options | None = None,
    points_seen_once: str = "error",
    comments: Sequence[str] = (),
) -> None:
    """Write a project file; its paths are relative to its folder.

    Parameters
    ----------
    path : str or Path
    name : str
        Name of the block.
    images : sequence of (id, metadata path)
    points, observations : str
        Paths of the tables.
    crs : str
        EPSG code of the points.
    options : Options, optional
        Every option is written, also the defaults.
    points_seen_once : str
        "error" or "drop".
    comments : sequence of str
        First lines, after ``#``.
    """
    lines = [*_comments(comments), *entries({"schema": 1, "name": name})]
    tables: list[tuple[str, Mapping[str, object]]] = [
        *(("[[images]]", {"id": image, "metadata": metadata}) for image, metadata in images),
        ("[points]", {"file": points, "crs": crs}), ("[observations]", {"file": observations}),
        ("[orientation]", _options(options or Options(), "orientation")),
        ("[adjustment]", {**_options(options or Options(), "adjustment"), "points_seen_once": points_seen_once}),
    ]  # fmt: skip
    for head, values in tables:
        lines += ["", head, *entries(values)]
    write_lines(path, lines)


# --- text ----------------------------------------------------------------------------------------


def _write(path: str | Path, header: Sequence[str], columns: Iterable[Sequence[str]], comments: Sequence[str]) -> None:
    lines = [*_comments(comments), ",".join(header), *map(",".join, zip(*columns, strict=True))]
    write_lines(path, lines)


def _comments(comments: Sequence[str]) -> list[str]:
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a comment must fit one line")
    return [f"# {line}" for line in comments]


def _text(name: str) -> str:
    """Cell of an id; in quotes if a reader or a spreadsheet would misinterpret it."""
    if not name or name != name.strip() or any(mark in name for mark in "\n\r\0"):
        raise ValueError(f"the id {name!r} cannot be written: it is empty, or has outer blanks or line breaks")
    return '"' + name.replace('"', '""') + '"' if any(mark in name for mark in ',"#') or name[0] in "=@" else name


def _texts(names: Sequence[str]) -> list[str]:
    """Cells of ids."""
    known = {name: _text(name) for name in set(names)}
    return list(map(known.__getitem__, names))


def _triples(values: Array) -> Array:
    return np.asarray(values, np.float64).reshape(-1, 3)


def _options(options: Options, table: str) -> dict[str, object]:
    """Options of a table of the project file by name."""
    return {name: getattr(options, name) for name, one in declared(Options).items() if one.group.table == table}
