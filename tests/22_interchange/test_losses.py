"""What a format cannot contain is named by kind and agrees with the registry; independent readers check it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient.formats.exchange.convert import placed, read_survey, write_survey
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.registry import Format, Holds, Settings, format_named, format_of, formats, register_format
from fg_orient.geodesy import ecef_to_geodetic, to_ecef
from fg_orient.geodesy.crs import from_ecef
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from tests.support.survey import random_survey, taken

UTM = "EPSG:32636"
#: Kinds of information that each format loses of a survey that has all of them.
LOST = {
    "csv": set(),
    "gpkg": set(),
    "asp-gcp": {"ties", "roles"},
    "metashape-csv": {"image"},
    "metashape-xml": {"sigma_image"},
    "pix4d": {"crs", "roles", "bare_ties", "sigma_east_north", "sigma_image"},
    "odm": {"ties", "roles", "unmeasured", "sigma_ground", "sigma_image", "vertical_crs"},
    "micmac": {"crs", "roles", "bare_ties", "sigma_east_north", "sigma_image"},
    "qgis-points": {"ids", "images", "ties", "unmeasured", "heights", "sigma_ground", "sigma_image"},
    "geojson": {"image"},
}


@pytest.fixture
def everything() -> Survey:
    """Return six points in a compound CRS: all known ones have sigmas, and only two are observed."""
    rng = np.random.default_rng(5)
    full = random_survey(rng, formats()["csv"], UTM, plain=True)
    n = 6
    roles = (Role.CONTROL, Role.CHECK, Role.TIE, Role.TIE, Role.CONTROL, Role.CONTROL)
    known = np.array([role is not Role.TIE for role in roles])[:, None]
    coordinates = np.where(known, np.array([4e5, 458e4, 100.0]) + rng.uniform(0.0, 1e3, (n, 3)), np.nan)
    observed = full.observed.take(np.isin(full.observed.point, (0, 2)))
    return replace(
        full, crs=UTM + "+5773", ids=tuple("abcdef"), roles=roles, coordinates=coordinates, observed=observed,
        sigma_enu_m=np.where(known, rng.uniform(0.1, 1.0, (n, 3)), np.nan), fixed=np.zeros(n, bool),
        lines=np.zeros(n, np.int64),
    )  # fmt: skip


@pytest.mark.behaviour
def test_the_table_of_losses_covers_all_formats_of_points() -> None:
    assert set(LOST) <= set(formats())


@pytest.mark.behaviour
@pytest.mark.parametrize("name", sorted(LOST))
def test_everything_lost_is_named(name: str, everything: Survey, tmp_path: Path) -> None:
    format_ = formats()[name]
    # formats in WGS84 need the grid of the geoid; the loss of heights is not tested here
    moved = replace(everything, crs=UTM)
    survey = placed(moved, format_named("csv"), format_.crs, "") if format_.crs else everything
    out = tmp_path / f"a{format_.suffixes[0]}"
    settings = Settings(image="left.tif", sigma_axes="enu")
    _, lost = write_survey(survey, [out], format_, settings)
    assert {p.code.removeprefix("lost.") for p in lost} == LOST[name]
    assert all(p.value and p.remedy for p in lost)


@pytest.mark.behaviour
def test_what_is_lost_is_counted(everything: Survey, tmp_path: Path) -> None:
    """``write_survey`` counts each kind of content that the format cannot contain.

    Points b, e and f are located and unseen; c and d are tie points, of which only d is unseen.
    """
    _, lost = write_survey(everything, [tmp_path / "gcp_list.txt"], formats()["odm"], Settings())
    counts = {p.code: p.value for p in lost}
    assert counts["lost.unmeasured"] == "3 points" and counts["lost.ties"] == "2 points"
    assert counts["lost.roles"] == "1 point" and counts["lost.sigma_ground"] == "4 points"
    _, lost = write_survey(everything, [tmp_path / "gcp.csv"], formats()["pix4d"], Settings())
    assert {p.code: p.value for p in lost}["lost.bare_ties"] == "1 point"


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["pix4d", "micmac"])
def test_one_horizontal_sigma_is_the_root_mean_square(name: str, everything: Survey, tmp_path: Path) -> None:
    format_ = formats()[name]
    written, _ = write_survey(everything, [tmp_path / f"a{format_.suffixes[0]}"], format_, Settings())
    found, _ = read_survey(written, format_, Settings(crs=UTM), accept_unverified=True)
    rows = [everything.ids.index(one) for one, sigma in zip(found.ids, found.sigma_enu_m, strict=True) if sigma[0] > 0]
    east, north, up = everything.sigma_enu_m[rows].T
    kept = found.sigma_enu_m[[found.ids.index(everything.ids[k]) for k in rows]]
    np.testing.assert_allclose(kept[:, 0], np.sqrt((east**2 + north**2) / 2.0), rtol=1e-15)
    np.testing.assert_array_equal(kept[:, 2], up)


@pytest.mark.behaviour
def test_points_of_another_image_are_lost_and_counted(everything: Survey, tmp_path: Path) -> None:
    format_ = formats()["qgis-points"]
    _, lost = write_survey(everything, [tmp_path / "left.tif.points"], format_, Settings(image="left.tif"))
    assert [p.value for p in lost if p.code == "lost.images"] == ["2 points"]
    with pytest.raises(InputError, match="option image"):
        write_survey(everything, [tmp_path / "b.points"], format_, Settings())


@pytest.mark.behaviour
def test_geocentric_axes_of_asp_lose_correlations_only_if_sigmas_differ(everything: Survey, tmp_path: Path) -> None:
    format_ = formats()["asp-gcp"]
    survey = placed(replace(everything, crs=UTM), format_named("csv"), "EPSG:4979", "")
    codes = {p.code for p in write_survey(survey, [tmp_path / "a.gcp"], format_, Settings())[1]}
    assert "lost.sigma_axes" in codes
    equal = replace(survey, sigma_enu_m=np.where(np.isnan(survey.sigma_enu_m), np.nan, 0.5))
    codes = {p.code for p in write_survey(equal, [tmp_path / "b.gcp"], format_, Settings())[1]}
    assert "lost.sigma_axes" not in codes
    found = read_survey([tmp_path / "b.gcp"], format_, Settings("EPSG:4979"), accept_unverified=True)[0]
    assert set(found.sigma_enu_m.ravel().tolist()) == {0.5}


# --- the way between reference systems -----------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("crs", [UTM, "EPSG:5254", "EPSG:4979", "EPSG:4978", "EPSG:4258"])
def test_from_ecef_is_what_proj_gives(crs: str, rng: np.random.Generator) -> None:
    lon, lat = np.array([[31.8], [41.4]]) + rng.uniform(-0.3, 0.3, (2, 20))
    xyz = to_ecef("EPSG:4979", lon, lat, rng.uniform(0.0, 2e3, 20))
    there, operation = from_ecef(crs, xyz)
    assert operation.crs == crs
    if crs in (UTM, "EPSG:4979"):  # no datum on the way: one operation, whatever grids are installed
        expected = pyproj.Transformer.from_crs("EPSG:4978", pyproj.CRS(crs).to_3d(), always_xy=True).transform(*xyz.T)
        limits = [1e-6, 1e-6, 2e-6] if crs == UTM else [1e-11, 1e-11, 2e-6]
        assert (np.abs(there - np.stack(expected, axis=1)) < limits).all()
    # PROJ's inverse of the geocentric conversion is good to a micrometre at these heights
    assert np.abs(to_ecef(crs, *there.T) - xyz).max() < 2e-6
    if crs == "EPSG:4979":
        np.testing.assert_array_equal(there, np.stack(ecef_to_geodetic(xyz), axis=1))


@pytest.mark.oracle
def test_a_survey_in_another_crs_says_by_which_operation(rng: np.random.Generator) -> None:
    survey = random_survey(rng, formats()["csv"], UTM)
    there = placed(survey, format_named("csv"), "EPSG:4979", "f")
    assert any("UTM zone 36N" in str(note) for note in there.notes)
    proj = pyproj.Transformer.from_crs(pyproj.CRS(UTM).to_3d(), "EPSG:4979", always_xy=True)
    expected = np.stack(proj.transform(*survey.coordinates.T), axis=1)
    known = np.isfinite(survey.coordinates).all(axis=1)
    assert (np.abs(there.coordinates - expected)[known] < [1e-10, 1e-10, 1e-5]).all()
    back = placed(there, format_named("csv"), UTM, "f")
    assert np.nanmax(np.abs(back.coordinates - survey.coordinates)) < 2e-6
    np.testing.assert_array_equal(np.isnan(back.coordinates), np.isnan(survey.coordinates))


# --- other programs ------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["geojson", "gpkg"])
def test_gdal_reads_what_we_write(name: str, tmp_path: Path, rng: np.random.Generator) -> None:
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    survey = random_survey(rng, formats()[name], "EPSG:4979")
    path = tmp_path / f"a{formats()[name].suffixes[0]}"
    write_survey(survey, [path], formats()[name], Settings())
    meta, _, geometry, columns = pyogrio.raw.read(path, layer=0)
    table = dict(zip(meta["fields"], columns, strict=True))
    assert table["id"].tolist() == list(survey.ids) and table["role"].tolist() == list(map(str, survey.roles))
    for k, point in enumerate(shapely.from_wkb(geometry)):
        if survey.roles[k] is Role.TIE:
            assert point is None
        else:
            assert [point.x, point.y, point.z] == survey.coordinates[k].tolist()
    np.testing.assert_array_equal(table["sigma_up_m"].astype(float), survey.sigma_enu_m[:, 2])


@pytest.mark.truth
def test_we_read_geojson_of_gdal(tmp_path: Path) -> None:
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    geometry = shapely.to_wkb(shapely.points([[31.5, 41.25, 100.5], [31.75, 41.5, 7.0]]))
    fields = [np.array(["01", "é"], object), np.array([0.5, 0.25])]
    path = tmp_path / "gdal.geojson"
    pyogrio.raw.write(
        path, geometry, fields, ["id", "other"], driver="GeoJSON", geometry_type="Point Z", crs="EPSG:4326"
    )  # fmt: skip
    found, remarks = read_survey([path], formats()["geojson"], Settings())
    assert remarks == () and found.ids == ("01", "é")
    np.testing.assert_array_equal(found.coordinates, [[31.5, 41.25, 100.5], [31.75, 41.5, 7.0]])


@pytest.mark.truth
def test_geopackage_of_points_without_our_columns(tmp_path: Path) -> None:
    """A GeoPackage layer with only an id and two dimensions is read as control points without heights.

    QGIS draws such layers; a file without the layer is refused.
    """
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    geometry = shapely.to_wkb(shapely.points([[4e5, 458e4]]))
    pyogrio.raw.write(
        tmp_path / "a.gpkg", geometry, [np.array([7])], ["id"], layer="ground_points", driver="GPKG",
        geometry_type="Point", crs=UTM,
    )  # fmt: skip
    found, _ = read_survey([tmp_path / "a.gpkg"], formats()["gpkg"], Settings())
    assert found.crs == UTM and found.ids == ("7",) and found.roles == (Role.CONTROL,)
    np.testing.assert_array_equal(found.coordinates, [[4e5, 458e4, np.nan]])
    with pytest.raises(InputError, match="no layer ground_points"):
        pyogrio.raw.write(tmp_path / "b.gpkg", geometry, [np.array([7])], ["id"], layer="x", driver="GPKG",
                          geometry_type="Point", crs=UTM)  # fmt: skip
        read_survey([tmp_path / "b.gpkg"], formats()["gpkg"], Settings())


# --- the registry --------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_formats_say_their_conventions() -> None:
    for name, format_ in formats().items():
        assert format_.name == name and format_.title and format_.files and format_.ground_axes and format_.pixel_axes
        assert (format_.first_pixel is None) or Holds.IMAGE in format_.holds
        assert all(suffix == suffix.lower() for suffix in format_.suffixes)
        assert format_.needs <= format_.holds


@pytest.mark.behaviour
def test_two_formats_cannot_have_one_name() -> None:
    other: Format = replace(formats()["odm"], title="another")
    with pytest.raises(ValueError, match="registered already"):
        register_format(other)


@pytest.mark.behaviour
def test_formats_are_told_by_the_end_of_the_name() -> None:
    assert format_of(Path("x.GCP"), place="--from").name == "asp-gcp"
    assert format_of(Path("my_gcp_list.txt"), place="--from").name == "odm"
    assert format_of(Path("scene.tif.points"), place="--from").name == "qgis-points"
    with pytest.raises(InputError, match="one of csv, metashape-csv, pix4d"):
        format_of(Path("a.csv"), place="--from")
    with pytest.raises(InputError, match="one of asp-gcp"):
        format_of(Path("a.unknown"), place="--from")


# --- tie points alone ----------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["csv", "gpkg", "metashape-xml", "pix4d", "geojson"])
def test_tie_points_alone_need_no_crs(name: str, everything: Survey, tmp_path: Path) -> None:
    """Tie points without a CRS are written and read back as tie points, as matches of other programs need."""
    format_ = formats()[name]
    ties = replace(taken(everything, (2,)), crs="")
    out = tmp_path / f"a{format_.suffixes[0]}"
    written, lost = write_survey(ties, [out], format_, Settings())
    assert "lost.ties" not in {p.code for p in lost}
    found, _ = read_survey(written, format_, Settings(crs="EPSG:4979"), accept_unverified=True)
    assert found.roles == (Role.TIE,) and found.ids == ("c",)


@pytest.mark.behaviour
def test_ids_that_are_numbers_are_not_lost_where_numbers_are_kept(everything: Survey, tmp_path: Path) -> None:
    format_ = formats()["micmac-ties"]
    for ids, codes in ((("7", "12"), set()), (("7", "012"), {"lost.ids"})):
        ties = replace(taken(everything, (0, 2)), ids=ids)
        lost = {p.code for p in write_survey(ties, [tmp_path / ids[1]], format_, Settings())[1]}
        assert lost & {"lost.ids"} == codes
        found, _ = read_survey([tmp_path / ids[1]], format_, Settings())
        assert (set(found.ids) == set(ids)) is not bool(codes)
