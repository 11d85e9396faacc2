"""Files .gcp of ASP are read with latitude first and the axes of their standard deviations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.asp_gcp import read_asp as read
from fg_orient.formats.exchange.asp_gcp import write_asp as write
from fg_orient.formats.registry import Settings
from fg_orient.geodesy import ecef_to_geodetic, to_ecef
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

LINES = """\
# a comment
01 41.5 31.25 120.5 0.3 0.3 0.3 left.tif 1034.25 512.5 0.5 0.25 right.tif 7 8 1 1

1, 41.6, 31.75, -3.25, 0.1, 0.2, 0.4
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.gcp"
    path.write_text(LINES, encoding="utf-8")
    return path


@pytest.mark.behaviour
def test_columns_by_hand(file: Path) -> None:
    found = read((file,), Settings(crs="EPSG:4979", sigma_axes="enu"))
    assert found.ids == ("01", "1") and found.images == ("left.tif", "right.tif")
    assert found.roles == (Role.CONTROL, Role.CONTROL)
    np.testing.assert_array_equal(found.coordinates, [[31.25, 41.5, 120.5], [31.75, 41.6, -3.25]])
    np.testing.assert_array_equal(found.sigma_enu_m, [[0.3, 0.3, 0.3], [0.1, 0.2, 0.4]])
    o = found.observed
    np.testing.assert_array_equal([o.line, o.sample], [[512.5, 8.0], [1034.25, 7.0]])
    np.testing.assert_array_equal([o.sigma_line_px, o.sigma_sample_px], [[0.25, 1.0], [0.5, 1.0]])


@pytest.mark.oracle
def test_geocentric_sigmas_are_those_of_drawn_points(file: Path, rng: np.random.Generator) -> None:
    """Sigmas along x, y, z become those along East, North, Up that 40 000 drawn points have, within 1.4 %."""
    enu = read((file,), Settings(crs="EPSG:4979")).sigma_enu_m[1]
    place = to_ecef("EPSG:4979", 31.75, 41.6, -3.25)
    lon, lat, height = ecef_to_geodetic(place + rng.normal(size=(40000, 3)) * [0.1, 0.2, 0.4])
    east = np.radians(lon - lon.mean()) * 6387e3 * np.cos(np.radians(41.6))  # radius of the prime vertical there
    north = np.radians(lat - lat.mean()) * 6363e3  # that of the meridian
    drawn = np.array([east.std(), north.std(), height.std()])
    # relative error of a standard deviation of 40 000 draws: 0.35 %; four of them
    np.testing.assert_allclose(enu, drawn, rtol=0.014)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("P 41,5 31,25 120 1 1 1", "wrong number of cells"),
        ("P 41.5 31.25 120 1 1", "wrong number of cells"),
        ("P 41.5 31.25 nan 1 1 1", "not a finite number"),
        ("P 41.5 31.25 1e400 1 1 1", "too large"),
        ("P 41.5 31.25 120 -1 1 1", "below zero"),
        ("P 41.5 31.25 120 1 1 1\nP 41.5 31.26 120 1 1 1", "used twice, first on line 1"),
        ("P 41.5 31.25 120 1 1 1 a 1 2 1 1 a 1 2 1 1", "measured twice"),
        ("# nothing", "no points"),
    ],
)
def test_bad_lines_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.gcp"
    path.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read((path,), Settings(crs="EPSG:4979"))


NAD27 = (
    'GEOGCS["NAD27",DATUM["North_American_Datum_1927",SPHEROID["Clarke 1866",6378206.4,294.978698213898]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4267"]]'
)


@pytest.mark.behaviour
def test_the_comment_with_wkt_is_the_crs_of_the_file(file: Path) -> None:
    text = file.read_text("utf-8")
    file.write_text(f"# WKT: {wkt('EPSG:4326')}\n{text}", "utf-8")
    assert read((file,), Settings()).crs == "EPSG:4979"  # heights above the ellipsoid
    assert read((file,), Settings(crs="EPSG:4326+5773")).crs == "EPSG:4326+5773"
    file.write_text(f"# id latitude longitude\n#wkt: {NAD27}\n{text}", "utf-8")
    assert read((file,), Settings()).crs == "EPSG:4267"
    with pytest.raises(InputError, match=r"EPSG:4267.*EPSG:4979|EPSG:4979.*EPSG:4267"):
        read((file,), Settings(crs="EPSG:4979"))
    file.write_text(f"# WKT: {wkt('EPSG:32636')}\n{text}", "utf-8")
    with pytest.raises(InputError, match=r"WKT: .*geographic"):
        read((file,), Settings())
    file.write_text(f"# WKT: GEOGCS[nonsense\n{text}", "utf-8")
    with pytest.raises(InputError, match="no EPSG code"):
        read((file,), Settings())
    survey = read((file,), Settings(crs="EPSG:4979"))
    assert "GEOGCS[nonsense" in str(survey.notes[0])
    write(survey, (file,), Settings())
    assert file.read_text("utf-8").startswith('# WKT: GEOGCS["WGS 84",')
    again = read((file,), Settings())
    assert again.crs == "EPSG:4979" and np.array_equal(again.coordinates, survey.coordinates)


@pytest.mark.behaviour
@pytest.mark.parametrize(("crs", "message"), [("", "does not state its CRS"), ("EPSG:32636", "geographic")])
def test_crs_has_to_be_given_and_geographic(file: Path, crs: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read((file,), Settings(crs=crs))
