"""Writes point tables, observation tables and project files in the formats we read.

Numbers are written with the fewest digits that read back to the same double. Files appear
whole or not at all (:mod:`fg_orient.io.atomic`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.block import Options
from fg_orient.geodesy import COORDINATE_COLUMNS, Kind
from fg_orient.io.atomic import write_text
from fg_orient.io.observations import COLUMNS
from fg_orient.io.points import FIXED, SIGMA_COLUMNS
from fg_orient.names import Role

Array = npt.NDArray[np.float64]

_ADJUSTMENT: Final = ("backend", "solver", "optimizer", "loss", "gnc", "inlier_probability",
                      "robust_start", "robust_scale", "snoop",
                      "outlier_test", "outlier_level", "multiple_testing", "variance_components", "max_iterations",
                      "check_points", "datum", "statistics", "memory_limit_gb")  # fmt: skip


def write_points(
    path: str | Path,
    ids: Sequence[str],
    roles: Sequence[Role],
    coordinates: Array,
    sigma_enu_m: Array,
    *,
    kind: Kind = "geographic",
    fixed: npt.NDArray[np.bool_] | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write a table of ground points.

    Parameters
    ----------
    path : str or Path
        Target file.
    ids, roles : sequences of length n
        Ids and roles.
    coordinates : (n, 3) array
        Longitude, latitude (degrees), height (m); easting, northing, height (m); or x, y, z
        (m), as ``kind`` says. nan rows become empty cells.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point, m; nan rows become empty cells.
    kind : str
        "geographic", "projected" or "geocentric".
    fixed : (n,) array of bool, optional
        Points whose sigma cells get the word ``fixed``.
    comments : sequence of str
        Lines put before the header, after ``#``.

    Raises
    ------
    ValueError
        An id or comment could not be read back, or lengths differ.
    InputError
        The file cannot be written.
    """
    constant = np.zeros(len(ids), bool) if fixed is None else fixed
    header = ("id", "role", *COORDINATE_COLUMNS[kind], *SIGMA_COLUMNS)
    records = (
        (_text(name), str(Role(role)), *_numbers(xyz), *([FIXED] * 3 if is_fixed else _numbers(sigma)))
        for name, role, xyz, sigma, is_fixed in zip(ids, roles, coordinates, sigma_enu_m, constant, strict=True)
    )
    _write(path, header, records, comments)


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
        Target file.
    image_ids, point_ids : sequences of length n
        Image and point of each record.
    pixels : (n, 2) array
        Line and sample; (0, 0) is the centre of the first pixel.
    sigma_px : (n, 2) array or broadcastable to it
        Standard deviations of line and sample.
    comments : sequence of str
        Lines put before the header, after ``#``.

    Raises
    ------
    ValueError
        An id or comment could not be read back, or lengths differ.
    InputError
        The file cannot be written.
    """
    sigma = np.broadcast_to(sigma_px, np.shape(pixels))
    records = (
        (_text(image), _text(point), *_numbers(pixel), *_numbers(s))
        for image, point, pixel, s in zip(image_ids, point_ids, pixels, sigma, strict=True)
    )
    _write(path, COLUMNS, records, comments)


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
    """Write a project file; paths are taken relative to its folder when it is read.

    Parameters
    ----------
    path : str or Path
        Target file.
    name : str
        Name of the block.
    images : sequence of (id, metadata path)
        The images.
    points, observations : str
        Paths of the tables.
    crs : str
        EPSG code of the points.
    options : Options, optional
        Every option is written out, also the defaults.
    points_seen_once : str
        "error" or "drop".
    comments : sequence of str
        Lines put at the top, after ``#``.

    Raises
    ------
    ValueError
        A comment holds a line break.
    InputError
        The file cannot be written.
    """
    chosen = options or Options()
    values = {f.name: getattr(chosen, f.name) for f in fields(Options)}
    lines = [*_comments(comments), "schema = 1", f"name = {_toml(name)}"]
    for image, metadata in images:
        lines += ["", "[[images]]", f"id = {_toml(image)}", f"metadata = {_toml(metadata)}"]
    lines += ["", "[points]", f"file = {_toml(points)}", f"crs = {_toml(crs)}"]
    lines += ["", "[observations]", f"file = {_toml(observations)}", "", "[orientation]"]
    lines += [f"{k} = {_toml(v)}" for k, v in values.items() if k not in _ADJUSTMENT and v is not None]
    lines += ["", "[adjustment]", *(f"{k} = {_toml(values[k])}" for k in _ADJUSTMENT if values[k] is not None)]
    lines += [f"points_seen_once = {_toml(points_seen_once)}", ""]
    write_text(path, "\n".join(lines))


# --- text ----------------------------------------------------------------------------------------


def _write(path: str | Path, header: Sequence[str], records: Iterable[Sequence[str]], comments: Sequence[str]) -> None:
    lines = [*_comments(comments), ",".join(header), *(",".join(cells) for cells in records), ""]
    write_text(path, "\n".join(lines))


def _comments(comments: Sequence[str]) -> list[str]:
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a comment must fit one line")
    return [f"# {line}" for line in comments]


def _text(name: str) -> str:
    """Cell of an id; quoted where a reader, or a spreadsheet, would take it for something else."""
    if not name or name != name.strip() or any(mark in name for mark in "\n\r\0"):
        raise ValueError(f"the id {name!r} cannot be written: it is empty, or has outer blanks or line breaks")
    return '"' + name.replace('"', '""') + '"' if any(mark in name for mark in ',"#') or name[0] in "=@" else name


def _numbers(values: Iterable[float]) -> list[str]:
    """Cells of a row of numbers: shortest text that reads back exactly; empty if all are nan."""
    row = [float(v) for v in values]
    return [""] * len(row) if np.isnan(row).all() else [repr(v) for v in row]


def _toml(value: object) -> str:
    """TOML text of a str, bool, int, float or tuple of floats."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return f"[{', '.join(_toml(v) for v in value)}]"
    if not isinstance(value, str):
        return repr(value)
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
