"""Databases of COLMAP (SQLite) with images, keypoints and matches of image pairs.

Keypoints are (x, y); (0.5, 0.5) is the centre of the first pixel. They are in single
precision. A coordinate of 10 000 px is therefore rounded by up to 0.0005 px. The table
``matches`` contains all matches. The table ``two_view_geometries`` contains only the
matches that fit the geometry of the pair. The number of a pair is 2147483647 times the
smaller image id plus the larger image id.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Index
from fg_orient.formats.atomic import staged_file
from fg_orient.formats.exchange.colmap_text import FIRST_PIXEL
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.ties import matched_survey, pairs_of
from fg_orient.formats.load import open_sqlite
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.model.errors import Finding, InputError, finding

#: The number of a pair is this value times its smaller image id plus its larger image id.
PAIR: Final = 2147483647
#: Number of COLMAP's camera model with the parameters f, cx, cy.
SIMPLE_PINHOLE: Final = 0
#: COLMAP assumes that the focal length of an unknown camera is this value times the longer side of the image.
FOCAL_GUESS: Final = 1.2
#: Names of the tables that are read.
_TABLES: Final = ("images", "keypoints", "matches", "two_view_geometries")
_SCHEMA: Final = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL,
    width INTEGER NOT NULL, height INTEGER NOT NULL, params BLOB, prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE,
    camera_id INTEGER NOT NULL, FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL,
    data BLOB, FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
"""


def read_colmap_database(path: str | Path) -> Survey:
    """Read the tie points of a database from ``two_view_geometries``; if it is empty, from ``matches``.

    InputError: the database is damaged; the message names the table and the id.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError.of("ties.missing", file=path.name, value=str(path), needed="a database of COLMAP")
    with open_sqlite(path, _TABLES, "colmap.database") as opened:
        return _read_database(opened, path.name)


def _read_database(opened: sqlite3.Connection, file: str) -> Survey:
    rows = opened.execute("SELECT image_id, name FROM images ORDER BY image_id").fetchall()
    position = {number: k for k, (number, _) in enumerate(rows)}
    keypoints = [np.empty((0, 2), np.float32)] * len(rows)
    for number, n, columns, data in opened.execute("SELECT image_id, rows, cols, data FROM keypoints"):
        place = f"keypoints of image {number}"
        if number not in position:
            raise InputError.of("colmap.reference", file=file, place=place, value=number, kind="image", other="images")
        values = _blob(file, place, data, n, columns, "<f4")
        if n and (columns < 2 or not np.isfinite(values[:, :2]).all()):
            raise InputError.of("colmap.blob", file=file, place=place, value=f"{n} x {columns}, or not finite")
        keypoints[position[number]] = values[:, :2]
    first = np.concatenate([[0], np.cumsum([len(k) for k in keypoints])]).astype(np.intp)
    matches, kind = _matches(opened, file, position, first)
    xy = np.concatenate([np.empty((0, 2), np.float32), *keypoints]).astype(float) - FIRST_PIXEL
    image = np.repeat(np.arange(len(rows)), np.diff(first))
    notes = [finding("points.matches", n=len(matches), kind=kind)]
    return matched_survey(tuple(str(name) for _, name in rows), image, xy[:, 1], xy[:, 0], matches, notes)


def _matches(opened: sqlite3.Connection, file: str, position: Mapping[int, int], first: Index) -> tuple[Index, str]:
    """Return the row numbers of matched keypoints (m, 2), and the kind of the matches in words."""
    tables = {name for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    table, verified = "two_view_geometries", False
    if table in tables:
        verified = bool(opened.execute(f"SELECT sum(rows) FROM {table}").fetchone()[0])
    table = table if verified else "matches"
    parts = [np.empty((0, 2), np.intp)]
    for pair, n, columns, data in opened.execute(f"SELECT pair_id, rows, cols, data FROM {table} WHERE rows > 0"):
        ids = divmod(pair, PAIR)
        place = f"{table} of images {ids[0]} and {ids[1]}"
        if any(k not in position for k in ids) or ids[0] == ids[1]:
            raise InputError.of("colmap.reference", file=file, place=place, value=pair, kind="pair", other="images")
        rows = _blob(file, place, data, n, columns, "<u4").astype(np.intp)
        start = np.array([first[position[k]] for k in ids])
        counts = np.array([first[position[k] + 1] for k in ids]) - start
        if columns != 2 or (rows >= counts).any():
            raise InputError.of("colmap.blob", file=file, place=place, value=f"keypoint {rows.max()} of {counts}")
        parts.append(rows + start)
    return np.concatenate(parts), "geometrically verified" if verified else "unverified"


def _blob(file: str, place: str, data: Any, rows: int, columns: int, kind: str) -> npt.NDArray[Any]:
    """Read a blob as an array (rows, columns); its length must fit."""
    raw = data if isinstance(data, bytes) else b""
    if min(rows, columns) < 0 or len(raw) != rows * columns * np.dtype(kind).itemsize:
        raise InputError.of("colmap.blob", file=file, place=place, value=f"{len(raw)} bytes for {rows} x {columns}")
    return np.frombuffer(raw, kind).reshape(rows, columns)


def write_colmap_database(path: Path, survey: Survey, sizes: Mapping[str, tuple[int, int]]) -> float:
    """Write the image points of a survey as keypoints, and as matches of all image pairs.

    The table ``two_view_geometries`` remains empty; COLMAP fills it when it tests whether
    matches fit a geometry. ``sizes`` contains lines and samples of the images. Each image
    gets a pinhole camera, and its focal length is marked as a guess. An existing file is
    replaced.

    Returns
    -------
    float
        Largest difference by rounding a coordinate to single precision, px.

    Raises
    ------
    InputError
        The size of an image is unknown, or the file cannot be written.
    """
    cameras = []
    for name in survey.images:
        if name not in sizes:
            raise InputError.of("ties.size", file=path.name, place=name)
        height, width = sizes[name]
        parameters = np.array([FOCAL_GUESS * max(width, height), width / 2, height / 2], "<f8")
        cameras.append((SIMPLE_PINHOLE, width, height, parameters.tobytes(), 0))
    o = survey.observed
    order = np.lexsort((o.point, o.image))
    image, point = o.image[order], o.point[order]
    xy = np.column_stack([o.sample[order], o.line[order]]) + FIRST_PIXEL
    single = xy.astype("<f4")
    first = np.searchsorted(image, np.arange(len(survey.images) + 1))
    with staged_file(path) as temporary, closing(sqlite3.connect(temporary)) as opened:
        opened.executescript(_SCHEMA)
        for k, (name, camera) in enumerate(zip(survey.images, cameras, strict=True)):
            own = single[first[k] : first[k + 1]]
            opened.execute("INSERT INTO cameras VALUES (?, ?, ?, ?, ?, ?)", (k + 1, *camera))
            opened.execute("INSERT INTO images VALUES (?, ?, ?)", (k + 1, name, k + 1))
            opened.execute("INSERT INTO keypoints VALUES (?, ?, 2, ?)", (k + 1, len(own), own.tobytes()))
        for (a, b), rows in pairs_of(image, point).items():
            data = (rows - first[[a, b]]).astype("<u4").tobytes()
            opened.execute("INSERT INTO matches VALUES (?, ?, 2, ?)", (PAIR * (a + 1) + b + 1, len(rows), data))
        opened.commit()
    return float(np.abs(single - xy).max(initial=0.0))


def _write_database(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write a database; the returned finding states the effect of single precision."""
    rounding = write_colmap_database(paths[0], survey, settings.image_sizes)
    if rounding == 0.0:
        return ()
    return (finding("lost.single", file=paths[0], value=f"up to {rounding:.1g} px", format=DATABASE.name),)


DATABASE: Final = Format(
    name="colmap-database",
    title="COLMAP database (SQLite)",
    suffixes=(".db",),
    files=("database",),
    first_pixel=(FIRST_PIXEL, FIRST_PIXEL),
    pixel_axes="x column, y row (pixels, single precision)",
    holds=TIES_ONLY,
    read=lambda paths, settings: read_colmap_database(paths[0]),
    write=_write_database,
    evidence="databases written by pycolmap 4.2; ours are read by it",
)
