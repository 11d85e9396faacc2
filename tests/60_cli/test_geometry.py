"""``locate``, ``project`` and ``intersect`` agree with the sensor, with each other and with real files."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest

from fg_orient.formats.sensor import read_sensor
from tests.support.published_rays import misses_m

GROUND = ["id", "line", "sample", "lon_deg", "lat_deg", "height_m", "x_m", "y_m", "z_m"]


def rows(path: Path) -> list[dict[str, str]]:
    """Return the records of a CSV file."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.oracle
def test_locate_one_pixel(run: Any, twin_source: Path) -> None:
    image = twin_source / "left.DIM"
    ended = run("locate", image, "--line", 6000, "--sample", "-0.5", "--height", 350, "--json")
    assert ended.code == 0
    (point,) = ended.json["points"]
    assert list(point) == GROUND
    expected = read_sensor(image).locate(6000.0, -0.5, height_m=350.0)[0]
    assert [point["x_m"], point["y_m"], point["z_m"]] == expected.tolist()
    assert misses_m(read_sensor(image).metadata, 6000.0, -0.5, expected[None])[0] < 1e-6
    assert point["height_m"] == pytest.approx(350.0, abs=1e-6)  # iterated height, rounding of 6e6 m


@pytest.mark.oracle
def test_csv_there_and_back(run: Any, twin_source: Path, tmp_path: Path) -> None:
    """Pixels located and projected by tables return within 1e-6 px, the bound of the projection."""
    image, pixels = twin_source / "right.DIM", tmp_path / "pixels.csv"
    given = [("a", 0.0, 0.0, 0.0), ("b b", 11999.0, 0.25, 900.0), ("c", 6000.5, 11999.0, 1800.0)]
    text = "id,line,sample,height_m\n" + "".join(",".join(map(str, row)) + "\n" for row in given)
    pixels.write_text(text, encoding="utf-8")
    ground, back = tmp_path / "ground.csv", tmp_path / "back.csv"
    assert run("locate", image, "--points", pixels, "--out", ground).code == 0
    located = rows(ground)
    assert list(located[0]) == GROUND
    there = np.array([[float(r[k]) for k in ("x_m", "y_m", "z_m")] for r in located])
    pixels_given = np.array([row[1:3] for row in given]).T
    assert misses_m(read_sensor(image).metadata, *pixels_given, there).max() < 1e-6
    table = [[r[k] for k in ("id", "lon_deg", "lat_deg", "height_m")] for r in located]
    text = "id,lon_deg,lat_deg,height_m\n" + "".join(",".join(r) + "\n" for r in table)
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    ended = run("project", image, "--points", tmp_path / "points.csv", "--out", back, "--json")
    assert ended.code == 0
    assert [p["id"] for p in ended.json["points"]] == ["a", "b b", "c"]
    assert all(p["inside"] for p in ended.json["points"])
    found = np.array([[float(r["line"]), float(r["sample"])] for r in rows(back)])
    assert np.abs(found - [[row[1], row[2]] for row in given]).max() < 1e-6
    assert [r["inside"] for r in rows(back)] == ["true"] * 3
    again = run("project", image, "--points", tmp_path / "points.csv", "--out", back, "--json")
    assert (again.code, again.json["errors"][0]["code"]) == (2, "output.exists")


@pytest.mark.behaviour
def test_point_far_outside_is_null_and_not_inside(run: Any, twin_source: Path) -> None:
    ended = run("project", twin_source / "left.DIM", "--lon", "-122", "--lat", 41.3, "--height", 0, "--json")
    assert ended.code == 0
    (point,) = ended.json["points"]
    assert (list(point), point["inside"]) == (["id", "line", "sample", "inside"], False)


@pytest.mark.oracle
def test_locate_on_a_dem(run: Any, twin_source: Path, tmp_path: Path) -> None:
    """``locate --dem`` on a raster of constant height gives the point of ``--height`` within 0.5 mm."""
    rasterio = pytest.importorskip("rasterio")

    dem = tmp_path / "dem.tif"
    with rasterio.open(
        dem, "w", driver="GTiff", width=40, height=40, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(0.05, 0.0, 30.85, 0.0, -0.05, 42.3),
    ) as raster:  # fmt: skip
        raster.write(np.full((1, 40, 40), 512.0, np.float32))
    pixel = ("locate", twin_source / "left.DIM", "--line", 5000, "--sample", 7000, "--json")
    on_dem, at_height = (run(*pixel, *words).json["points"][0] for words in (("--dem", dem), ("--height", 512)))
    x, y, z = (on_dem[k] for k in ("x_m", "y_m", "z_m"))
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    assert geodetic.transform(x, y, z)[2] == pytest.approx(512.0, abs=5e-4)
    assert misses_m(read_sensor(twin_source / "left.DIM").metadata, 5000.0, 7000.0, np.array([[x, y, z]]))[0] < 1e-4
    # the intersection with a DEM ends within 1e-4 m of it (fg_orient.sensors.surface)
    assert [on_dem[k] for k in ("x_m", "y_m", "z_m")] == pytest.approx(
        [at_height[k] for k in ("x_m", "y_m", "z_m")], abs=5e-4
    )


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("command", "words", "code"),
    [
        ("locate", (), "cli.no_pixel"),
        ("locate", ("--line", 1, "--sample", 1), "cli.no_height"),
        ("locate", ("--line", 1, "--sample", 1, "--height", 1, "--dem", "x.tif"), "cli.two_heights"),
        ("locate", ("--points", "TABLE", "--height", 1), "cli.two_heights"),
        ("locate", ("--line", 1, "--sample", 1, "--frame"), "cli.two_ways"),
        ("locate", ("--sample", 5, "--frame"), "cli.two_ways"),
        ("locate", ("--sample", 5, "--points", "x.csv"), "cli.two_ways"),
        ("locate", ("--frame", "--points", "x.csv"), "cli.two_ways"),
        ("locate", ("--line", 12000, "--sample", 1, "--height", 1), "sensor.pixel_outside"),
        ("locate", ("--line", "nan", "--sample", 1, "--height", 1), "options.value"),
        ("locate", ("--line", 1, "--sample", 1, "--height", "nan"), "options.value"),
        ("locate", ("--line", 1, "--sample", 1, "--height", "9e9"), "cli.height_range"),
        ("locate", ("--line", 1, "--sample", 1, "--dem", "none.tif"), "dem.missing"),
        ("locate", ("--points", "none.csv"), "table.missing_file"),
        ("project", ("--lon", 31.8), "cli.no_ground"),
        ("project", ("--lon", 31.8, "--points", "x.csv"), "cli.two_ways"),
        ("project", ("--lat", 41.3, "--points", "x.csv"), "cli.two_ways"),
        ("project", ("--height", 0, "--points", "x.csv"), "cli.two_ways"),
        ("project", ("--lon", "nan", "--lat", 41, "--height", 0), "options.value"),
        ("project", ("--lon", 31.8, "--lat", "inf", "--height", 0), "options.value"),
    ],
)
def test_locate_and_project_refuse(
    run: Any, twin_source: Path, tmp_path: Path, command: str, words: tuple[object, ...], code: str
) -> None:
    (tmp_path / "p.csv").write_text("id,line,sample,height_m\na,1,1,0\n", encoding="utf-8")
    given = [tmp_path / "p.csv" if word == "TABLE" else word for word in words]
    ended = run(command, twin_source / "left.DIM", *given, "--json")
    assert ended.code == 2, ended.stderr
    assert [e["code"] for e in ended.json["errors"]] == [code]
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.behaviour
def test_conflict_names_both_options(run: Any, twin_source: Path) -> None:
    for command, words, place in (
        ("locate", ("--sample", 5, "--frame"), "--sample, --frame"),
        ("project", ("--height", 0, "--points", "x.csv"), "--height, --points"),
    ):
        ended = run(command, twin_source / "left.DIM", *words, "--json")
        assert [e["place"] for e in ended.json["errors"]] == [place]


@pytest.mark.behaviour
def test_bad_cells_are_listed_together(run: Any, twin_source: Path, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text('id,line,sample\na,x,1\nb,1,"2,5"\n', encoding="utf-8")
    ended = run("locate", twin_source / "left.DIM", "--points", tmp_path / "p.csv", "--height", 1, "--json")
    found = [(e["code"], e["place"]) for e in ended.json["errors"]]
    assert found == [("table.not_a_number", "line 2, column line"), ("table.decimal_comma", "line 3, column sample")]


@pytest.mark.behaviour
def test_points_outside_the_image_are_named(run: Any, twin_source: Path) -> None:
    """``project`` warns of points outside the image, and tells if exchanged longitude and latitude lie inside."""
    image = twin_source / "left.DIM"
    inside = run("locate", image, "--line", 6000, "--sample", 6000, "--height", 350, "--json").json["points"][0]
    place = [str(inside[name]) for name in ("lon_deg", "lat_deg")]
    for (lon, lat), words in ((place, None), (place[::-1], "with longitude and latitude exchanged 1 of these lie"),
                              ([place[0], "45"], "1 of 1 point lies outside the image")):  # fmt: skip
        ended = run("project", image, "--lon", lon, "--lat", lat, "--height", 350, "--json")
        assert ended.code == 0
        if words is None:
            assert ended.stderr == ""
        else:
            assert words in ended.stderr and "1 of 1 point lies outside the image" in ended.stderr
        assert ("exchanged 1 of these" in ended.stderr) == (lon == place[1])


# --- intersection --------------------------------------------------------------------------------


@pytest.mark.oracle
def test_two_rays_miss_by_their_shortest_distance(run: Any, twin_source: Path) -> None:
    """``intersect`` states the miss of two rays as their shortest distance, within 1e-6 m.

    It is |(P2 - P1) . (u1 x u2)| / |u1 x u2|.
    """
    images = [twin_source / "left.DIM", twin_source / "right.DIM"]
    ended = run("intersect", *images, "--pixel", "6000,6000", "--pixel=5990.5,6010", "--json")
    assert ended.code == 0
    (point,) = ended.json["points"]
    assert list(point)[:9] == GROUND
    (p1, u1), (p2, u2) = (
        (a[0] for a in read_sensor(image).rays(*pixel))
        for image, pixel in zip(images, ((6000.0, 6000.0), (5990.5, 6010.0)), strict=True)
    )
    normal = np.cross(u1, u2)
    miss = abs(float((p2 - p1) @ normal)) / float(np.linalg.norm(normal))
    assert miss > 1.0  # the planted errors of the metadata leave metres
    # rounding of positions of 7e6 m, divided by the sine of the angle of the rays
    assert point["miss_m"] == pytest.approx(miss, abs=1e-6)
    assert point["pixels"][1] == {"image": "2", "line": 5990.5, "sample": 6010.0}


@pytest.mark.oracle
@pytest.mark.parametrize(("moved_px", "told"), [(0.0, False), (2.0, False), (40.0, True)])
def test_rays_beyond_the_sigmas_of_pixels_are_told(
    run: Any, twin: Path, twin_source: Path, tmp_path: Path, moved_px: float, told: bool
) -> None:
    """``intersect --result`` doubts rays that miss by more than 1 px allows; with the metadata it is a note."""
    result = tmp_path / "result"
    assert run("adjust", twin, "--out", result).code == 0
    images = [twin_source / "left.DIM", twin_source / "right.DIM"]
    with (twin.parent / "observations.csv").open(encoding="utf-8", newline="") as stream:
        table = [row for row in csv.DictReader(line for line in stream if not line.startswith("#"))]
    point = next(row["id"] for row in table if sum(other["id"] == row["id"] for other in table) == 2)
    (l0, s0), (l1, s1) = ((float(r["line"]), float(r["sample"])) for r in table if r["id"] == point)
    pixels = (f"--pixel={l0},{s0}", f"--pixel={l1 + moved_px},{s1 + moved_px}")
    ended = run("intersect", *images, *pixels, "--result", result, "--json")
    codes = [one["code"] for one in ended.json["findings"]]
    assert (ended.code, codes) == ((4, ["ground.rays_beyond"]) if told else (0, []))
    if told:
        words = run("intersect", *images, *pixels, "--result", result)
        assert words.stderr.startswith("doubt: 1 of 1 point has rays") and "standard deviations (limit" in words.stderr
        assert words.stdout.splitlines()[-1].startswith("not trustworthy: 1 of 1 point has rays")
        plain = run("intersect", *images, *pixels)
        assert plain.code == 0 and plain.stderr.startswith("note: 1 of 1 point") and "--result" in plain.stderr


@pytest.mark.behaviour
def test_project_file_uses_no_coordinates(run: Any, twin: Path) -> None:
    before = run("intersect", twin, "--json").json["points"]
    assert len(before) == 47
    path = twin.parent / "points.csv"
    text = path.read_text("utf-8")
    rows_ = text.splitlines()
    k = next(k for k, row in enumerate(rows_) if row.startswith("01,"))
    cells = rows_[k].split(",")
    cells[4] = repr(float(cells[4]) + 500.0)
    rows_[k] = ",".join(cells)
    path.write_text("\n".join(rows_) + "\n", encoding="utf-8")
    assert run("intersect", twin, "--json").json["points"] == before
    out = twin.parent / "stereo.csv"
    assert run("intersect", twin, "--out", out).code == 0
    assert len(rows(out)) == 47


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("images", "pixels", "code"),
    [("left right", "1,1", "cli.pixel_count"), ("left right", "1,1 1", "cli.pixel"),
     ("left right", "1,1 1,99999", "sensor.pixel_outside"), ("left right", "a,b 1,1", "cli.pixel"),
     ("left left", "5,5 5,5", "initial.no_intersection"), ("left", "5,5", "cli.one_image")],
)  # fmt: skip
def test_intersect_refuses(run: Any, twin_source: Path, images: str, pixels: str, code: str) -> None:
    words = [*(twin_source / f"{image}.DIM" for image in images.split()), *(f"--pixel={p}" for p in pixels.split())]
    ended = run("intersect", *words, "--json")
    assert (ended.code, [e["code"] for e in ended.json["errors"]]) == (2, [code])


@pytest.mark.behaviour
def test_what_follows_from_a_doubtful_adjustment_is_doubtful(
    run: Any, twin: Path, twin_source: Path, tmp_path: Path
) -> None:
    """Each command that takes an orientation from a result says first that the result is not trustworthy."""
    path = twin.parent / "observations.csv"
    rows_ = path.read_text("utf-8").splitlines()
    k = next(k for k, row in enumerate(rows_) if row.startswith("left,05,"))
    cells = rows_[k].split(",")
    rows_[k] = ",".join([*cells[:2], repr(float(cells[2]) + 50.0), *cells[3:]])
    path.write_text("\n".join(rows_) + "\n", encoding="utf-8")
    result, image, out = tmp_path / "result", twin_source / "left.DIM", tmp_path / "RPC.TXT"
    assert run("adjust", twin, "--out", result).code == 4
    for words in (
        ("locate", image, "--line", 6000, "--sample", 6000, "--height", 500),
        ("project", image, "--lon", 31.852, "--lat", 41.3, "--height", 500),
        ("footprint", image, "--height", 300),
        ("intersect", twin),
        ("rpc", "fit", image, "--heights", 0, 3000, "--out", out),
    ):
        done = run(*words, "--result", result)
        assert done.code == 4, words
        first = done.stderr.splitlines()[0]
        assert first.startswith("doubt: ") and "this result is not trustworthy: point 05 in image left: gross" in first
    assert not out.exists()  # an RPC that is not trustworthy is not written


# --- the file's own frame points -----------------------------------------------------------------

FRAME = ["file_lon_deg", "file_lat_deg", "misfit_m", "misfit_east_m", "misfit_north_m", "height_from", "note"]


@pytest.mark.oracle
def test_frame_of_the_twin(run: Any, twin_source: Path) -> None:
    ended = run("locate", twin_source / "left.DIM", "--frame", "--json")
    points = ended.json["points"]
    assert [p["id"] for p in points] == ["corner 1", "corner 2", "corner 3", "corner 4", "centre"]
    assert list(points[0]) == GROUND + FRAME
    # the twin's frame points come from the same model; a file prints at least 1e-6 degrees, 0.11 m
    metadata = read_sensor(twin_source / "left.DIM").metadata
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    for p in metadata.frame_points:
        ground = np.array(to_ecef.transform(p.lon_deg, p.lat_deg, 0.0))
        assert misses_m(metadata, p.line, p.sample, ground[None])[0] < 0.15
    assert max(p["misfit_m"] for p in points) < 0.15


@pytest.mark.oracle
def test_misfit_is_model_minus_file(run: Any, twin: Path) -> None:
    """The misfit of a frame point is model minus file: a corner moved to the east by 8.36 m misfits to the west.

    The corner is moved by 1e-4 degrees.
    """
    path = twin.parent / "left.DIM"
    before = run("locate", path, "--frame", "--json").json["points"][0]
    text = path.read_text("utf-8")
    tag = text.index("<FRAME_LON>") + len("<FRAME_LON>")
    end = text.index("<", tag)
    path.write_text(text[:tag] + repr(float(text[tag:end]) + 1e-4) + text[end:], encoding="utf-8")
    after = run("locate", path, "--frame", "--json").json["points"][0]
    metres = np.radians(1e-4) * np.hypot(before["x_m"], before["y_m"])
    assert after["misfit_east_m"] - before["misfit_east_m"] == pytest.approx(-metres, rel=1e-5)
    assert after["misfit_north_m"] == pytest.approx(before["misfit_north_m"], abs=1e-4)
    assert after["misfit_m"] == pytest.approx(np.hypot(after["misfit_east_m"], after["misfit_north_m"]))


@pytest.mark.truth
@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "limit_m", "flagged"),
    [("SPOT5.DIM", 0.15, False), ("SPOT1.DIM", 9.0, True), ("SPOT2.DIM", 5.0, True), ("SP2_METADATA.DIM", 3.0, True),
     ("SPOT4.DIM", 26.0, True)],
)  # fmt: skip
def test_frame_of_real_scenes(run: Any, real_data: Path, name: str, limit_m: float, flagged: bool) -> None:
    """``locate --frame`` has misfits below the limit of each real scene, and a note where attitudes are missing.

    The limits are the print resolution for SPOT 5, the file's model for the older ones.
    """
    ended = run("locate", real_data / "geocosicorr3d" / name, "--frame", "--json")
    points = ended.json["points"]
    assert ended.code == 0
    assert len(points) == 5
    assert max(p["misfit_m"] for p in points if p["id"] != "centre" or name == "SPOT5.DIM") <= limit_m
    assert all((p["note"] is not None) == flagged for p in points)
