"""Text models of COLMAP (cameras.txt, images.txt, points3D.txt in one folder), its camera models, and its databases.

A pose leads from ground to camera axes (quaternion w x y z, then translation t = -R C); the axes are those of
``fg_orient.sensors.frame``. Pixels are (x, y) with (0.5, 0.5) in the centre of the first one. Each image has two
lines. The second one may be empty: it lists the keypoints, with -1 for a keypoint without a point. Further files of
COLMAP since 3.12 (rigs.txt, frames.txt) contain no additional data of images of single cameras.

Databases (SQLite) have images, keypoints and matches of image pairs. Their keypoints are in single precision: a place
at 10 000 px is rounded by up to 0.0005 px. ``matches`` contains all matches, ``two_view_geometries`` those that fit the
geometry of the pair. The number of a pair is 2147483647 times the smaller image id plus the larger one.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NoReturn
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fg_orient.formats.atomic import require_free_files, staged_file, write_lines
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, make_folder, positions, require_once, whole
from fg_orient.formats.exchange.ties import matched_survey, model_survey, pairs_of
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Coordinate of the centre of the first pixel in COLMAP's files.
FIRST_PIXEL: Final = 0.5
#: Names of the parameters of the models that are read, in the order of the files.
MODELS: Final = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
#: Coefficients in the order of ``Interior.distortion``.
_BROWN: Final = ("k1", "k2", "k3", "p1", "p2")
FILES: Final = ("cameras.txt", "images.txt", "points3D.txt")
#: Point id of a keypoint without a point: -1, or the same as an unsigned number.
NO_POINT: Final = -1.0
_UNSIGNED_NO_POINT: Final = 2.0**64
#: Largest deviation of the length of a quaternion from 1.
NORM: Final = 1e-3


def interior_of(
    model: str, size: tuple[int, int], parameters: Sequence[float], name: str, *, file: str = "", place: str = ""
) -> Interior:  # fmt: skip
    """Camera of COLMAP as an interior orientation.

    Parameters
    ----------
    model : str
        Name as in cameras.txt.
    size : (int, int)
        Width and height, px.
    parameters : sequence of float
        In COLMAP's order, px.
    name : str
    file, place : str
        For messages.

    Raises
    ------
    InputError
        The model or a parameter has no counterpart, the number of parameters is wrong, or a value is impossible.
    """
    if model not in MODELS:
        raise InputError.of("colmap.model", file=file, place=place, value=model, known=", ".join(MODELS))
    if len(parameters) != len(MODELS[model]):
        needed = f"{model} with {' '.join(MODELS[model])}"
        raise InputError.of(
            "interchange.cells", file=file, place=place, value=f"{len(parameters)} numbers", needed=needed
        )
    value = dict(zip(MODELS[model], parameters, strict=True))
    focal = value.get("f", value.get("fx", 0.0))
    beyond = {key: value[key] for key in ("k4", "k5", "k6") if value.get(key, 0.0) != 0.0}
    if value.get("fy", focal) != focal:
        beyond = {"fx": focal, "fy": value["fy"], **beyond}
    if beyond:
        shown = " ".join(f"{key} {number:g}" for key, number in beyond.items())
        raise InputError.of("colmap.camera", file=file, place=place, value=shown)
    principal = np.array([value["cy"], value["cx"]]) - FIRST_PIXEL
    distortion = np.array([value.get(key, 0.0) for key in _BROWN])
    return Interior(size[1], size[0], focal, principal, distortion, name=name)


def parameters_of(interior: Interior) -> tuple[str, tuple[float, ...], float]:
    """Camera for COLMAP by the smallest sufficient model.

    Returns
    -------
    model : str
    parameters : tuple of float
        In COLMAP's order, px.
    error_px : float
        Largest error. It is 0 unless the polynomial leads from measured to ideal coordinates: then a polynomial of the
        other direction is fitted (``fg_orient.sensors.interior.converted``).
    """
    fitted = converted(interior, IDEAL_TO_MEASURED)
    own = fitted.interior
    value = dict(zip(_BROWN, own.distortion.tolist(), strict=True))
    cy, cx = (own.principal_px + FIRST_PIXEL).tolist()
    value |= dict.fromkeys(("f", "fx", "fy"), float(own.focal_px)) | {"cx": cx, "cy": cy}
    needed = {key for key in _BROWN if value[key] != 0.0}
    names = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
    model = next(name for name in names if needed <= set(MODELS[name]))
    return model, tuple(value.get(key, 0.0) for key in MODELS[model]), fitted.max_px


def read_colmap_text(folder: str | Path) -> FrameModel:
    """Read a model.

    InputError if a file is missing, damaged (it names the first faulty line) or contradicts another, or a camera has no
    counterpart here.
    """
    folder = Path(folder)
    cameras = _read_cameras(TextLines(folder / FILES[0]))
    poses, keypoints = _read_images(TextLines(folder / FILES[1]), cameras)
    ids, points, n_tracked = _read_points(TextLines(folder / FILES[2]))
    image = np.repeat(np.arange(len(poses)), [len(k) for k in keypoints])
    rows = np.concatenate([np.empty((0, 3)), *keypoints])
    measured = (rows[:, 2] != NO_POINT) & (rows[:, 2] < _UNSIGNED_NO_POINT)
    image, rows = image[measured], rows[measured]
    point = positions(ids, rows[:, 2])
    if (point < 0).any():
        _no_reference(FILES[1], folder.name, int(rows[point < 0, 2][0]), "point", FILES[2])
    if n_tracked != len(rows):
        raise InputError.of("colmap.track", file=FILES[2], place=folder.name, n_tracks=n_tracked, n_images=len(rows))
    left_out = int((~measured).sum())
    notes = (finding("points.no_track", n=left_out),) if left_out else ()
    names = tuple(str(int(i)) for i in ids)
    line, sample = rows[:, 1] - FIRST_PIXEL, rows[:, 0] - FIRST_PIXEL
    return FrameModel(cameras, poses, names, points, image, point, line, sample, notes)


def _no_reference(file: str, place: str, value: object, kind: str, other: str) -> NoReturn:
    raise InputError.of("colmap.reference", file=file, place=place, value=value, kind=kind, other=other)


def _read_cameras(text: TextLines) -> dict[str, Interior]:
    rows = [(number, line.split()) for number, line in text.content()]
    cameras: dict[str, Interior] = {}
    for number, cells in rows:
        values, size = finite(cells[4:]), [whole(cell) for cell in cells[2:4]]
        if len(cells) < 5 or values is None or None in size:
            text.refuse(number, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        width, height = (n for n in size if n is not None)
        cameras[cells[0]] = interior_of(
            cells[1], (width, height), values.tolist(), cells[0], file=text.path.name, place=f"line {number}"
        )  # fmt: skip
    ids = np.array([cells[0] for _, cells in rows], str)
    require_once(ids, "camera", text.path.name, lambda k: (f"line {rows[k][0]}", ids[k]))
    return cameras


def _read_images(text: TextLines, cameras: dict[str, Interior]) -> tuple[tuple[Pose, ...], list[Array]]:
    """Poses and keypoints (k, 3): x, y, point id."""
    poses, keypoints = [], []
    upcoming = iter(enumerate(text.lines, start=1))
    for number, line in upcoming:
        if not line.strip() or line.startswith("#"):
            continue
        poses.append(_pose(text, number, line, cameras))
        second, keypoint_line = next(upcoming, (number, ""))
        cells = keypoint_line.split()
        values = finite(cells)
        if values is None or len(cells) % 3:
            text.refuse(second, "X Y POINT3D_ID of each keypoint")
        keypoints.append(values.reshape(-1, 3))
    return tuple(poses), keypoints


def _pose(text: TextLines, number: int, line: str, cameras: dict[str, Interior]) -> Pose:
    cells = line.split(maxsplit=9)
    values = finite(cells[1:8])
    if len(cells) < 10 or values is None or abs(np.linalg.norm(values[:4]) - 1.0) > NORM:
        text.refuse(number, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a quaternion of length 1")
    if cells[8] not in cameras:
        _no_reference(text.path.name, f"line {number}", cells[8], "camera", FILES[0])
    rotation = Rotation.from_quat(values[[1, 2, 3, 0]]).as_matrix()
    return Pose(cells[9].strip(), cells[8], rotation, -rotation.T @ values[4:7])


def _read_points(text: TextLines) -> tuple[Array, Array, int]:
    """Ids (N,), coordinates (N, 3), number of image points of all tracks."""
    needed = "POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]"
    content = text.content()
    counts = [len(line.split()) for _, line in content]
    for (number, _), count in zip(content, counts, strict=True):
        if count < 8 or count % 2:
            text.refuse(number, needed)
    rows = text.numbers([(number, line.split(maxsplit=4)[:4]) for number, line in content], 4, needed)
    require_once(rows[:, 0], "point", text.path.name, lambda k: ("", int(rows[k, 0])))
    return rows[:, 0], rows[:, 1:], (sum(counts) - 8 * len(counts)) // 2


def write_colmap_text(folder: str | Path, model: FrameModel, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a model; the folder is made if it is missing. The result is the information that is lost, in words.

    Ids of cameras, images and points count from 1, in the order of the model: other names of points and cameras are
    lost. InputError if a file exists, cannot be written, or the name of an image contains a blank: COLMAP would cut it
    there.
    """
    folder = Path(folder)
    paths = [folder / name for name in FILES]
    require_free_files(*paths, overwrite=overwrite)
    for pose in model.poses:
        if len(pose.name.split()) != 1:
            raise InputError.of(
                "interchange.cells", file=FILES[1], value=repr(pose.name), needed="a NAME without blanks"
            )
    cameras, lost = _camera_lines(model)
    order = np.lexsort((model.point, model.image))
    place = np.empty(len(order), np.intp)  # of an image point among those of its image
    place[order] = np.arange(len(order)) - np.searchsorted(model.image[order], model.image[order])
    make_folder(folder)
    write_lines(paths[0], ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", *cameras])
    write_lines(paths[1], [*_IMAGE_HEAD, *_image_lines(model, order)])
    write_lines(paths[2], [_POINT_HEAD, *_point_lines(model, place)])
    return lost


_IMAGE_HEAD: Final = (
    "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
    "# X Y POINT3D_ID of each keypoint; (0.5, 0.5) is the centre of the first pixel",
)
_POINT_HEAD: Final = "# POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]"


def _camera_lines(model: FrameModel) -> tuple[list[str], tuple[str, ...]]:
    lines, lost = [], []
    for k, (name, interior) in enumerate(model.cameras.items(), start=1):
        kind, values, error = parameters_of(interior)
        size = f"{interior.n_samples} {interior.n_lines}"
        lines.append(f"{k} {kind} {size} {' '.join(map(repr, values))}")
        if error > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {error:.2g} px in the image")
    return lines, tuple(lost)


def _image_lines(model: FrameModel, order: Index) -> Iterator[str]:
    """Two lines of each image; ``order`` sorts the image points by image."""
    ends = np.searchsorted(model.image[order], np.arange(len(model.poses) + 1))
    camera = {name: k for k, name in enumerate(model.cameras, start=1)}
    for k, pose in enumerate(model.poses):
        x, y, z, w = Rotation.from_matrix(pose.rotation).as_quat(canonical=True).tolist()
        t = (-pose.rotation @ pose.centre_m).tolist()
        yield f"{k + 1} {' '.join(map(repr, (w, x, y, z, *t)))} {camera[pose.camera]} {pose.name}"
        own = order[ends[k] : ends[k + 1]]
        xs, ys = (model.sample[own] + FIRST_PIXEL).tolist(), (model.line[own] + FIRST_PIXEL).tolist()
        yield " ".join(f"{x!r} {y!r} {p}" for x, y, p in zip(xs, ys, (model.point[own] + 1).tolist(), strict=True))


def _point_lines(model: FrameModel, place: Index) -> Iterator[str]:
    """Lines of the points with their tracks, grey, and the mean residual as COLMAP states it."""
    order = np.argsort(model.point, kind="stable")
    ends = np.searchsorted(model.point[order], np.arange(len(model.points_m) + 1)).tolist()
    residual = np.linalg.norm(model.residuals_px(), axis=1)[order]
    tokens = [f"{i} {p}" for i, p in zip((model.image[order] + 1).tolist(), place[order].tolist(), strict=True)]
    for k, xyz in enumerate(model.points_m.tolist()):
        first, last = ends[k], ends[k + 1]
        error = float(residual[first:last].mean()) if last > first else float("nan")
        error = error if np.isfinite(error) else -1.0
        yield " ".join([str(k + 1), *map(repr, xyz), "128 128 128", repr(error), *tokens[first:last]])


TEXT: Final = Format(
    name="colmap-text",
    title="COLMAP text model (folder of cameras.txt, images.txt, points3D.txt)",
    files=("model",),
    first_pixel=(FIRST_PIXEL, FIRST_PIXEL),
    pixel_axes="x column, y row (pixels)",
    ground_axes="local x, y, z (left out)",
    holds=TIES_ONLY,
    read=lambda paths, settings: model_survey(read_colmap_text(paths[0])),
    read_model=lambda paths, settings: read_colmap_text(paths[0]),
    write_model=lambda out, model, overwrite: write_colmap_text(out, model, overwrite=overwrite),
    evidence="models written by pycolmap 4.2; ours are read by it",
)


# --- databases -----------------------------------------------------------------------------------

#: A pair's number is this times its smaller image id plus its larger one.
PAIR: Final = 2147483647
#: COLMAP's number of the camera model with f, cx, cy.
SIMPLE_PINHOLE: Final = 0
#: Focal length of an unknown camera in longer sides of the image, as COLMAP guesses it.
FOCAL_GUESS: Final = 1.2
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
    """Read the tie points of a database: matches of ``two_view_geometries``, else those of ``matches``.

    An InputError for a damaged database names the table and the id.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError.of("ties.missing", file=path.name, value=str(path), needed="a database of COLMAP")
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)) as opened:
            return _read_database(opened, path.name)
    except (sqlite3.Error, TypeError) as error:  # columns of SQLite may have any type
        raise InputError.of("colmap.database", file=path.name, value=error) from None


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
    image, notes = (
        np.repeat(np.arange(len(rows)), np.diff(first)),
        [finding("points.matches", n=len(matches), kind=kind)],
    )
    return matched_survey(tuple(str(name) for _, name in rows), image, xy[:, 1], xy[:, 0], matches, notes)


def _matches(opened: sqlite3.Connection, file: str, position: Mapping[int, int], first: Index) -> tuple[Index, str]:
    """Rows of matched keypoints (m, 2), and the kind of the matches in words."""
    tables = {name for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    verified = "two_view_geometries" in tables and bool(
        opened.execute("SELECT sum(rows) FROM two_view_geometries").fetchone()[0]
    )
    table = "two_view_geometries" if verified else "matches"
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
    """Numbers (rows, columns) of a blob of the right length."""
    raw = data if isinstance(data, bytes) else b""
    if min(rows, columns) < 0 or len(raw) != rows * columns * np.dtype(kind).itemsize:
        raise InputError.of("colmap.blob", file=file, place=place, value=f"{len(raw)} bytes for {rows} x {columns}")
    return np.frombuffer(raw, kind).reshape(rows, columns)


def write_colmap_database(path: Path, survey: Survey, sizes: Mapping[str, tuple[int, int]]) -> float:
    """Write the image points of a survey as keypoints and matches of all pairs.

    Nothing is written to ``two_view_geometries``: COLMAP tests whether matches fit a geometry. ``sizes`` are lines and
    samples of the images. Each image gets a pinhole camera whose focal length is marked as a guess. An existing file is
    replaced.

    Returns
    -------
    float
        Largest rounding of a coordinate to single precision, px.

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
    """Write a database; the finding states the rounding to single precision."""
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
