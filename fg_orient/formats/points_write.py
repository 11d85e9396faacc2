"""Write point tables, observation tables and project files in our own formats.

Files are written completely or not at all (:mod:`fg_orient.formats.atomic`). The suffix
of its name determines the format of a table (:mod:`fg_orient.formats.table_write`). All
writers raise ValueError if an id or comment could not be read again, or if lengths
differ. They raise InputError if the file cannot be written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.faults import is_id
from fg_orient.formats.points import COLUMNS, FIXED, SIGMA_COLUMNS
from fg_orient.formats.table_write import Column, comment_lines, save_table
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
        ``kind`` determines the columns: longitude, latitude (degrees), height (m); or
        easting, northing, height (m); or x, y, z (m). Rows of nan become empty cells.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point, m. Rows of nan become empty cells.
    kind : str
        "geographic", "projected" or "geocentric".
    fixed : (n,) array of bool, optional
        Mask of the points whose sigma cells contain the word ``fixed``.
    comments : sequence of str
        Texts of comment lines before the header.
    """
    _require_readable(ids)
    words = {role: str(Role(role)) for role in set(roles)}
    sigmas: list[Column] = list(_triples(sigma_enu_m).T)
    if fixed is not None and np.any(fixed):
        sigmas = [np.where(fixed, np.array(FIXED, object), column) for column in sigmas]
    columns = {"id": ids, "role": [words[role] for role in roles]}
    columns |= zip(COORDINATE_COLUMNS[kind], _triples(coordinates).T, strict=True)
    save_table(path, {**columns, **dict(zip(SIGMA_COLUMNS, sigmas, strict=True))}, comments)


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
        Texts of comment lines before the header.
    """
    _require_readable(image_ids)
    _require_readable(point_ids)
    numbers = np.hstack([pixels, np.broadcast_to(sigma_px, np.shape(pixels))]).astype(float)
    save_table(path, dict(zip(COLUMNS, (image_ids, point_ids, *numbers.T), strict=True)), comments)


def write_project(
    path: str | Path,
    *,
    name: str,
    images: Sequence[tuple[str, str]],
    points: str | None = "points.csv",
    crs: str = "EPSG:4979",
    observations: str = "observations.csv",
    options: Options | None = None,
    points_seen_once: str = "error",
    comments: Sequence[str] = (),
) -> None:
    """Write a project file. The paths in it are relative to its folder.

    Parameters
    ----------
    path : str or Path
    name : str
        Name of the block.
    images : sequence of (id, metadata path)
    points, observations : str or None, str
        Paths of the tables. If ``points`` is None, the file names no point table.
    crs : str
        EPSG code of the points.
    options : Options, optional
        All options are written, also options with default values.
    points_seen_once : str
        "error" or "drop".
    comments : sequence of str
        Texts of comment lines at the beginning of the file.
    """
    lines = [*comment_lines(comments), *entries({"schema": 1, "name": name})]
    tables: list[tuple[str, Mapping[str, object]]] = [
        *(("[[images]]", {"id": image, "metadata": metadata}) for image, metadata in images),
        *((("[points]", {"file": points, "crs": crs}), ("[observations]", {"file": observations})) if points else ()),
        ("[orientation]", _options(options or Options(), "orientation")),
        ("[adjustment]", {**_options(options or Options(), "adjustment"), "points_seen_once": points_seen_once}),
    ]  # fmt: skip
    for head, values in tables:
        lines += ["", head, *entries(values)]
    write_lines(path, lines)


def _require_readable(names: Sequence[str]) -> None:
    """Raise ValueError if a reader would change or refuse an id."""
    for name in set(names):
        if not is_id(name):
            raise ValueError(
                f"the id {name!r} cannot be written: it is empty or too long, or has outer blanks or line breaks"
            )


def _triples(values: Array) -> Array:
    return np.asarray(values, np.float64).reshape(-1, 3)


def _options(options: Options, table: str) -> dict[str, object]:
    """Return the options of one table of the project file by their names."""
    return {name: getattr(options, name) for name, one in declared(Options).items() if one.group.table == table}
