"""The module writes the files that pages of the documentation mention: the twin, its result, RPC, tables."""

from __future__ import annotations

import csv
import shutil
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fg_orient.closerange.photo import Photo, PhotoInterior, rotation_from_ayhan
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import ecef_to_geodetic

from .command import in_process
from .rpc_block import rpc_twin, write_folder

_CAMERA = '[[photos]]\nname = "{}"\nfocal = 60.0\n\n'
_CONSTRAINTS = """[[constraints]]
kind = "distance"
members = ["p12", "p13"]
value_m = {!r}
sigma = 0.001
"""


def made(*words: object) -> None:
    """Run a command that has to succeed."""
    ended = in_process(*words)
    assert ended.code == 0, ended.stderr


def satellite_files(folder: Path) -> None:
    """Write the twin under every name that pages use, its terrain, its result and its RPC."""
    twin = folder / "twin"
    made("simulate", "zonguldak", "--dem", "--dem-step", 60, "--out", twin)
    ground = _rows(twin / "points.csv")
    for row in [row for row in ground if row["role"] == "check"][:5]:
        row.update(dict.fromkeys(row, ""), id=row["id"], role="tie")
    # points.csv are tables of other kinds on several pages
    _write(twin / "project_points.csv", tuple(ground[0]), [list(row.values()) for row in ground])
    (twin / "points.csv").unlink()
    text = (twin / "project.toml").read_text("utf-8").replace('"points.csv"', '"project_points.csv"')
    for name in ("project.toml", "PROJECT.toml"):
        (twin / name).write_text(text, "utf-8")
    for path in twin.glob("*.*"):
        shutil.copy(path, folder)
    shutil.rmtree(twin)
    made("adjust", folder / "project.toml", "--out", folder / "result")
    for name in ("IMAGE.DIM", "LEFT.DIM", "SPOT5.DIM", "DIM.XML"):
        shutil.copy(folder / "left.DIM", folder / name)
    shutil.copy(folder / "right.DIM", folder / "RIGHT.DIM")
    made("rpc", "fit", folder / "left.DIM", "--heights", 0, 3000, "--out", folder / "scene_RPC.TXT")
    for name in ("scene.RPB", "scene.xml"):
        made("rpc", "convert", folder / "scene_RPC.TXT", "--out", folder / name)
    (folder / "scene.xml").rename(folder / "RPC.XML")
    shutil.copy(folder / "RPC.XML", folder / "RPC_SPOT7.XML")


def two_campaigns(folder: Path) -> None:
    """Divide the image points of the project among two campaigns, every other point; adjust the first."""
    rows, text = _rows(folder / "observations.csv"), (folder / "project.toml").read_text("utf-8")
    number = {name: k for k, name in enumerate(dict.fromkeys(row["id"] for row in rows))}
    (folder / "first").mkdir()
    for k, name in enumerate(("first", "second")):
        mine = [list(row.values()) for row in rows if number[row["id"]] % 2 == k]
        _write(folder / f"observations_{name}.csv", tuple(rows[0]), mine)
        assert '"observations.csv"' in text
        own = text.replace('"observations.csv"', f'"observations_{name}.csv"')
        (folder / f"{name}.toml").write_text(own, "utf-8")
    made("adjust", folder / "first.toml", "--out", folder / "first" / "result")


def write_image(path: Path, lines: int = 12000, samples: int = 12000) -> None:
    """Write an image of the twin's size, nearly all of it without data; the file is small."""
    import rasterio

    with (
        warnings.catch_warnings(action="ignore", category=rasterio.errors.NotGeoreferencedWarning),
        rasterio.open(
            path, "w", driver="GTiff", width=samples, height=lines, count=1, dtype="uint8", sparse_ok=True
        ) as out,
    ):
        out.write(np.ones((1, 16, 16), "uint8"), window=((0, 16), (0, 16)))


def scene_points(folder: Path) -> list[dict[str, float]]:
    """Return 80 points in the left image of the twin with 0.3 px of noise, and their ground coordinates."""
    rng = np.random.default_rng(1)
    pixels, height = rng.uniform(100.0, 11900.0, (2, 80)), rng.uniform(0.0, 1500.0, 80)
    lon, lat, _ = ecef_to_geodetic(read_sensor(folder / "left.DIM").locate(*pixels, height_m=height))
    columns = np.stack([*(pixels + rng.normal(0.0, 0.3, (2, 80))), lon, lat, height], axis=1)
    return [
        dict(zip(("line", "sample", "lon_deg", "lat_deg", "height_m"), row, strict=True)) for row in columns.tolist()
    ]


def rpc_points(folder: Path) -> None:
    """Write points.csv for the commands of RPC, every fourth a check point, and an image to put tags into."""
    rows = [(k, *p.values(), "control" if k % 4 else "check") for k, p in enumerate(scene_points(folder))]
    _write(folder / "points.csv", ("id", "line", "sample", "lon_deg", "lat_deg", "height_m", "role"), rows)
    write_image(folder / "image.tif")


def rpc_project(folder: Path) -> None:
    """Write a project of two images with RPC, and their rasters."""
    project = write_folder(folder / "twin", rpc_twin("shift"))
    for path in project.parent.glob("*.*"):
        shutil.copy(path, folder)
    for name in ("left", "right"):
        write_image(folder / f"IMG_{name}.tif")


def foreign_ties(folder: Path) -> None:
    """Write two RPC files, and their tie points as a database of COLMAP and as matches of ASP."""
    rpc_project(folder)
    tables = [folder / name for name in ("points.csv", "observations.csv")]
    sizes = [word for name in ("left", "right") for word in ("--image-size", f"{name}=12000,12000")]
    for target, out, more in (("colmap-database", "database.db", sizes), ("asp-match", "matches", [])):
        words = (
            "convert",
            *tables,
            "--from",
            "csv",
            "--crs",
            "EPSG:4979",
            "--to",
            target,
            *more,
            "--out",
            folder / out,
        )
        assert in_process(*words).code == 0
    for path in (*tables, folder / "project.toml"):
        path.unlink()


def gcp_file(folder: Path) -> None:
    """Write points.gcp: id, line, sample, latitude, longitude, height."""
    order = ("line", "sample", "lat_deg", "lon_deg", "height_m")
    rows = [" ".join([str(k), *(repr(p[c]) for c in order)]) for k, p in enumerate(scene_points(folder))]
    (folder / "points.gcp").write_text("\n".join(rows) + "\n", "utf-8")


def map_points(folder: Path) -> None:
    """Write points.csv: pixels and UTM coordinates of a flat scene, 40 control and 20 check points, 2 m of noise."""
    rng = np.random.default_rng(1)
    line, sample = rng.uniform(0.0, 12000.0, (2, 60))
    east = 400_000.0 + 4.9 * sample + 1.1 * line + 1e-6 * sample**2 + rng.normal(0.0, 2.0, 60)
    north = 4_600_000.0 - 4.9 * line + 1.1 * sample + rng.normal(0.0, 2.0, 60)
    rows = [
        (k, *values, "control" if k < 40 else "check")
        for k, values in enumerate(np.stack([line, sample, east, north], axis=1).tolist())
    ]
    _write(folder / "points.csv", ("id", "line", "sample", "easting_m", "northing_m", "role"), rows)
    write_image(folder / "IMAGE.tif")


def photos_and_control(folder: Path) -> None:
    """Write two photos of 15 points, 12 of them control points, and a measured distance."""
    rng = np.random.default_rng(1)
    points = np.array([10.6, 25.0, 2.0]) + rng.uniform(-1.0, 1.0, (15, 3))
    photos = [
        Photo.of("left", PhotoInterior(60.0), rotation_from_ayhan(0.01, 0.02, 0.03), [10.0, 20.0, 2.0]),
        Photo.of("right", PhotoInterior(60.0), rotation_from_ayhan(0.0, -0.1, 0.01), [11.2, 20.1, 2.1]),
    ]
    image = [
        (f"p{k}", photo.name, *(xy + rng.normal(0.0, 1e-3, 2)).tolist(), *at.tolist())
        for photo in photos
        for k, (xy, at) in enumerate(zip(photo.project(points), points, strict=True))
    ]
    known = [row for row in image if int(row[0][1:]) < 12]
    _write(folder / "image.csv", ("id", "photo", "x", "y"), [row[:4] for row in image])
    _write(folder / "control.csv", ("id", "photo", "x", "y", "x_m", "y_m", "z_m"), known)
    _write(folder / "ground.csv", ("id", "x_m", "y_m", "z_m"), [(row[0], *row[4:]) for row in known[:12]])
    (folder / "cameras.toml").write_text("schema = 1\n\n" + "".join(_CAMERA.format(p.name) for p in photos), "utf-8")
    length = float(np.linalg.norm(points[12] - points[13]))
    (folder / "constraints.toml").write_text(_CONSTRAINTS.format(length), "utf-8")


def surface_points(folder: Path) -> None:
    """Write points.csv: 40 points on a spheroid with 1 mm of noise."""
    rng = np.random.default_rng(1)
    turn, level = rng.uniform(0.0, 2.0 * np.pi, 40), rng.uniform(-0.8, 0.8, 40)
    ring = 0.8 * np.sqrt(1.0 - level**2)
    at = np.stack([ring * np.cos(turn), 0.6 * level, ring * np.sin(turn)], axis=1) + rng.normal(0.0, 1e-3, (40, 3))
    _write(folder / "points.csv", ("id", "x_m", "y_m", "z_m"), [(k, *row) for k, row in enumerate(at.tolist())])


def _rows(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text("utf-8").splitlines() if line and not line.startswith("#")]
    return list(csv.DictReader(lines))


def _write(path: Path, columns: tuple[str, ...], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as out:
        csv.writer(out).writerows([columns, *rows])


def outlines(folder: Path) -> None:
    """Write the outline of an island of 14 km, and two points, as longitude and latitude."""
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    corners = np.column_stack([29.12 + 0.027 * np.cos(angle), 40.86 + 0.02 * np.sin(angle)])
    np.savetxt(folder / "outlines.csv", corners, delimiter=",", header="lon_deg,lat_deg", comments="", fmt="%.7f")
    (folder / "geographic.csv").write_text("id,lon_deg,lat_deg\nP1,29.1,40.85\nP2,29.15,40.88\n", "utf-8")
