"""``rectify area``, ``projection`` and ``scanner`` give the values of other programs and of print."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pyproj
import pytest

from tests.support.command import in_process as run

#: A square of 1 km and a triangle, m.
OUTLINES = "outline,easting_m,northing_m\n" + "".join(
    f"{name},{x},{y}\n" for name, x, y in (
        ("square", 500000, 4500000), ("square", 501000, 4500000), ("square", 501000, 4501000),
        ("square", 500000, 4501000), ("square", 500000, 4500000),
        ("triangle", 0, 0), ("triangle", 30, 0), ("triangle", 0, 40),
    )
)  # fmt: skip


@pytest.mark.truth
def test_areas_of_plane_outlines(tmp_path: Path) -> None:
    path = tmp_path / "outlines.csv"
    path.write_text(OUTLINES, "utf-8")
    square, triangle = run("rectify", "area", path, "--pixel-size", "10", "--json").json["outlines"]
    assert (square["vertices"], square["area_m2"], square["perimeter_m"], square["spacing_m"]) == (4, 1e6, 4000.0, 1e3)
    assert (triangle["vertices"], triangle["area_m2"], triangle["perimeter_m"]) == (3, 600.0, 120.0)
    assert square["pixel_area_m2"] == 100.0 * square["pixels"] == pytest.approx(1e6, rel=0.02)
    assert square["sigma_pixel_area_m2"] == pytest.approx(np.sqrt(0.0728 * 4000.0 * 1e3))
    assert square["ellipsoidal_area_m2"] is None
    assert "square" in run("rectify", "area", path).stdout


@pytest.mark.oracle
def test_areas_of_geographic_outlines_equal_pyproj(tmp_path: Path) -> None:
    corners = np.array([[29.0, 40.8], [29.2, 40.8], [29.2, 41.0], [29.0, 41.0]])
    path = tmp_path / "outlines.csv"
    np.savetxt(path, corners, delimiter=",", header="lon_deg,lat_deg", comments="")
    one = run("rectify", "area", path, "--projection", "utm:35", "--json").json["outlines"][0]
    area, length = pyproj.Geod(ellps="WGS84").polygon_area_perimeter(*corners.T)
    assert (one["ellipsoidal_area_m2"], one["ellipsoidal_perimeter_m"]) == pytest.approx((area, length), rel=1e-12)
    x, y = pyproj.Transformer.from_crs(4326, 32635, always_xy=True).transform(*corners.T)
    plane = 0.5 * abs(np.sum((x - x[0]) * np.roll(y - y[0], -1) - np.roll(x - x[0], -1) * (y - y[0])))
    assert one["area_m2"] == pytest.approx(plane, rel=1e-9)
    assert abs(one["area_m2"] / area - 1.0) > 1e-5  # UTM is not equal-area


@pytest.mark.oracle
def test_projection_and_its_inverse(tmp_path: Path) -> None:
    """``rectify projection`` agrees with the EPSG code, returns by its inverse, and states the scale."""
    path, plane = tmp_path / "points.csv", tmp_path / "plane.csv"
    path.write_text("id,lon_deg,lat_deg\nP1,31.5,41.25\nP2,33.0,41.0\n", "utf-8")
    done = run("rectify", "projection", path, "--to", "utm:36", "--out", plane, "--json")
    assert done.code == 0, done.stderr
    x, y = pyproj.Transformer.from_crs(4326, 32636, always_xy=True).transform([31.5, 33.0], [41.25, 41.0])
    found = done.json["points"]
    assert [p["easting_m"] for p in found] == pytest.approx(x) and [p["northing_m"] for p in found] == pytest.approx(y)
    assert found[1]["scale_area"] == pytest.approx(0.9996**2, rel=1e-9)  # on the central meridian
    with plane.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    lines = [",".join((row["id"], row["easting_m"], row["northing_m"])) for row in rows]
    path.write_text("\n".join(["id,easting_m,northing_m", *lines, ""]), "utf-8")
    back = run("rectify", "projection", path, "--to", "utm:36", "--inverse", "--json").json["points"]
    assert [(p["lon_deg"], p["lat_deg"]) for p in back] == [
        pytest.approx((31.5, 41.25), abs=1e-9), pytest.approx((33.0, 41.0), abs=1e-9)
    ]  # fmt: skip
    assert "utm" in run("rectify", "projection", path, "--to", "utm:36", "--inverse").stdout


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("area", "PATH", "--projection", "utm:36"), "projected already"),
        (("projection", "PATH", "--to", "utm:99"), "1 to 60"),
        (("projection", "PATH", "--to", "utm:x"), "not a projection of PROJ"),
        (("projection", "PATH", "--to", "nonsense"), "not a projection of PROJ"),
        (("scanner", "--height", "705e3", "--ifov-along", "4e-5"), "scan angles or a swath"),
        (("scanner", "--height", "705e3", "--ifov-along", "4e-5", "--angles", "a"), "numbers between commas"),
    ],
)
def test_refusals(words: tuple[str, ...], message: str, tmp_path: Path) -> None:
    path = tmp_path / "outlines.csv"
    path.write_text(OUTLINES, "utf-8")
    done = run("rectify", *(path if word == "PATH" else word for word in words))
    assert done.code == 2 and message in done.stderr and done.stderr.count("\n") <= 2, done.stderr


@pytest.mark.truth
def test_scanner_of_landsat() -> None:
    """``rectify scanner`` has the published angles and shifts of MSS and TM. MSS: 185 km from 915 km are 11.545 deg.

    TM at 7.5 deg: 531 m by the panorama, 13.2 m by 100 m of relief.
    """
    mss = run("rectify", "scanner", "--height", "915e3", "--ifov-along", "86e-6", "--swath", "185e3", "--json").json
    assert mss["total_angle_deg"] == pytest.approx(11.545, abs=5e-4) and len(mss["angles"]) == 5
    assert 2.0 * mss["angles"][-1]["ground_y_m"] == pytest.approx(185e3)
    assert mss["line_time_s"] is None and mss["angles"][0]["mirror_shift_m"] is None
    words = ("rectify", "scanner", "--height", "705e3", "--ifov-along", "42.5e-6", "--angles", "0,7.5", "--relief",
             "100", "--speed", "6800", "--rotation", "0.1", "--focal", "2.4")  # fmt: skip
    nadir, edge = run(*words, "--json").json["angles"]
    assert edge["panoramic_shift_m"] == pytest.approx(531.0, abs=0.5)
    assert edge["relief_shift_m"] == pytest.approx(13.2, abs=0.05)
    assert nadir["element_along_m"] == nadir["element_across_m"] == pytest.approx(29.96, abs=0.01)
    shown = run(*words)
    assert shown.code == 0 and "strip 29.96 m" in shown.stdout and "530.7" in shown.stdout
