"""Heights above a geoid: the tests check files, constants, names of vertical CRS and interpolation with PROJ."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient.formats.both_heights import estimated
from fg_orient.formats.heights import ZeroLevel
from fg_orient.formats.project import checked_project, read_project
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.geodesy.crs import vertical_code, with_codes
from fg_orient.geodesy.geoid import LIMIT_M, GeoidFile, world_undulation_m
from fg_orient.geodesy.heights import undulation_m
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.sensors.surface import RasterDem
from tests.support.command import in_process
from tests.support.pleiades_project import pleiades_project
from tests.support.project_folder import ProjectFolder

rasterio = pytest.importorskip("rasterio")
Array = np.ndarray

#: Nodes of a grid over the block, and undulations near those of EGM96 there.
LON, LAT = np.arange(31.0, 33.01, 0.25), np.arange(42.0, 40.99, -0.25)
UNDULATION = np.round(35.0 + 3.0 * np.sin(LON[None] / 1.3) + 2.0 * np.cos(LAT[:, None]), 3)
ISG = f"""begin_of_head ====
model name     : made
data type      : geoid
data units     : meters
data format    : grid
data ordering  : N-to-S, W-to-E
ref ellipsoid  : GRS80
tide system    : tide-free
coord type     : geodetic
coord units    : deg
lat min        = {LAT[-1]}
lat max        = {LAT[0]}
lon min        = {LON[0]}
lon max        = {LON[-1]}
delta lat      = 0.25
delta lon      = 0.25
nrows          = {len(LAT)}
ncols          = {len(LON)}
nodata         = -9999.0000
ISG format     = 2.0
end_of_head ====
"""


def write_grid(path: Path, values: Array = UNDULATION, unit: str = "", west: float = 31.0, step: float = 0.25) -> Path:
    """Write undulations at nodes in the format of the name's end."""
    if path.suffix == ".isg":
        rows = "\n".join(" ".join(f"{v:.4f}" for v in row) for row in values)
        path.write_text(f"{ISG}{rows}\n", encoding="ascii")
        return path
    driver, kind = {".gtx": ("GTX", "float32"), ".byn": ("BYN", "int32"), ".tif": ("GTiff", "float64")}[path.suffix]
    place = rasterio.Affine(step, 0, west - 0.5 * step, 0, -step, LAT[0] + 0.5 * step)
    with rasterio.open(
        path, "w", driver=driver, width=values.shape[1], height=values.shape[0], count=1, dtype=kind,
        crs="EPSG:4326", transform=place,
    ) as grid:  # fmt: skip
        if kind == "int32":
            grid.scales = (0.001,)
        grid.write((np.round(values * 1000.0) if kind == "int32" else values).astype(kind)[None])
        if unit:
            grid.units = (unit,)
    return path


def by_proj(grid: Path, lon: Array, lat: Array) -> Array:
    """Return the undulations by PROJ's step vgridshift."""
    there = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={grid} +multiplier=1"
    )
    return np.asarray(there.transform(lon, lat, np.zeros(len(lon)))[2])


@pytest.fixture
def points() -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    lon, lat = rng.uniform(LON[0], LON[-1], 500), rng.uniform(LAT[-1], LAT[0], 500)
    lon[:3], lat[:3] = (LON[0], LON[-1], LON[2]), (LAT[0], LAT[-1], LAT[1])  # corners and a node
    return lon, lat


# --- interpolation -------------------------------------------------------------------------------


@pytest.mark.oracle
@pytest.mark.parametrize("end", ["gtx", "tif", "byn", "isg"])
def test_interpolation_is_that_of_proj(tmp_path: Path, points: tuple[Array, Array], end: str) -> None:
    """Each geoid format gives the undulations of PROJ within 4 um.

    PROJ reads float32: half a unit is 2^-18 m at 35 m.
    """
    wanted = by_proj(write_grid(tmp_path / "proj.gtx"), *points)
    found = GeoidFile(write_grid(tmp_path / f"own.{end}")).undulation_m(*points)
    assert np.abs(found - wanted).max() < 4e-6
    assert wanted.max() - wanted.min() > 1.0


@pytest.mark.oracle
def test_a_grid_around_the_earth_has_no_seam(tmp_path: Path) -> None:
    lon_nodes = np.arange(-180.0, 180.0, 2.0)
    rows = np.arange(len(LAT))[:, None]
    values = world_undulation_m(*np.broadcast_arrays(lon_nodes[None], LAT[:, None])) + rows
    grid = write_grid(tmp_path / "world.gtx", values, west=-180.0, step=2.0)
    lon, lat = np.array([179.5, -180.0, 180.0, -179.5, 181.0]), np.array([41.0, 41.5, 41.5, 40.0, 41.0])
    found = GeoidFile(grid).undulation_m(lon, lat)
    # PROJ takes longitudes up to 180
    assert np.abs(found - by_proj(grid, np.where(lon > 180.0, lon - 360.0, lon), lat)).max() < 1e-5


@pytest.mark.real_data
@pytest.mark.oracle
def test_egm96_of_the_world(real_data: Path) -> None:
    """At 20 000 places EGM96 of a file equals PROJ, and the coarse geoid is within its stated limit."""
    grid, rng = real_data / "shareloc-ventoux" / "egm96_15.gtx", np.random.default_rng(1)
    lon, lat = rng.uniform(-180.0, 180.0, 20_000), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 20_000)))
    found = GeoidFile(grid).undulation_m(lon, lat)
    assert np.abs(found - by_proj(grid, lon, lat)).max() < 1e-9
    assert np.abs(found - world_undulation_m(lon, lat)).max() < LIMIT_M


# --- wrong files ---------------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("factor", "unit", "message"),
    [
        (-1.0, "", "has the opposite sign"),
        (1.0 / 0.3048, "", "is in feet"),
        (1000.0, "", "is in millimetres"),
        (10.0, "", "is no geoid in metres"),
        (1.0, "foot", r"not in metres \(found foot\)"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, factor: float, unit: str, message: str) -> None:
    grid = write_grid(tmp_path / "wrong.tif", factor * UNDULATION, unit)
    with pytest.raises(InputError, match=message) as caught:
        GeoidFile(grid).undulation_m([31.6, 32.0], [41.2, 41.4])
    assert str(caught.value).count("\n") == 0 and "wrong.tif" in str(caught.value)


@pytest.mark.behaviour
def test_points_without_a_value(tmp_path: Path) -> None:
    grid = GeoidFile(write_grid(tmp_path / "small.gtx"))
    for lon, lat in ((30.99, 41.5), (33.01, 41.5), (32.0, 42.01), (32.0, 40.9), (-148.0, 41.5)):
        with pytest.raises(InputError, match=r"does not cover this point \(found 1 of 2 points\)"):
            grid.undulation_m([32.0, lon], [41.5, lat])
    holed = UNDULATION.copy()
    holed[2, 4] = -88.8888
    holed_grid = GeoidFile(write_grid(tmp_path / "holed.gtx", holed))
    with pytest.raises(InputError, match="has no value at this point"):
        holed_grid.undulation_m([LON[4] + 0.01], [LAT[2]])
    assert np.isfinite(holed_grid.undulation_m([LON[5]], [LAT[2]])).all()  # a node beside the hole


@pytest.mark.behaviour
@pytest.mark.parametrize("end", ["gtx", "tif", "byn", "isg"])
def test_mutilated_files_are_refused_in_one_line(tmp_path: Path, end: str) -> None:
    """A cut, overwritten or empty geoid file gives an error of one line or finite values."""
    whole, rng = write_grid(tmp_path / f"whole.{end}").read_bytes(), np.random.default_rng(3)
    refused = 0
    for k in range(30):
        damaged = bytearray(whole[: rng.integers(0, len(whole))] if k % 2 else whole)
        for at in rng.integers(0, max(len(damaged), 1), 4 if damaged else 0):
            damaged[at] = rng.integers(0, 256)
        path = tmp_path / f"damaged{k}.{end}"
        path.write_bytes(bytes(damaged))
        try:
            values = GeoidFile(path).undulation_m([31.6, 32.6], [41.2, 41.8])
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
        else:
            assert np.isfinite(values).all()
    assert refused >= 10


# --- tables --------------------------------------------------------------------------------------

PLACES = np.array([[31.60, 41.20, 12.5], [32.05, 41.22, 250.0], [31.62, 41.45, 830.0], [32.00, 41.44, 1500.0]])


def expected_ecef(undulation: Array) -> Array:
    """Return the places of the control points by PROJ, heights of the table above the zero level."""
    there = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(there.transform(*PLACES[:, :2].T, PLACES[:, 2] + undulation), axis=1)


def state(folder: ProjectFolder, entry: str, crs: str = "EPSG:4979") -> None:
    folder.change("project.toml", 'crs = "EPSG:4979"', f'crs = "{crs}"\n{entry}')


@pytest.mark.oracle
def test_a_project_with_its_own_geoid_file(folder: ProjectFolder) -> None:
    undulation = by_proj(write_grid(folder.folder / "n.gtx"), *PLACES[:, :2].T)
    state(folder, 'geoid = "n.gtx"')
    block = read_project(folder.project)
    np.testing.assert_allclose(block.points.known.ecef_m[:4], expected_ecef(undulation), rtol=0, atol=1e-6)
    assert any("with the undulations of n.gtx" in str(note) for note in block.notes)
    assert [Path(source.path).name for source in block.sources].count("n.gtx") == 1
    # the sealed check points have the same zero level
    lon, lat, height = 31.80, 41.30, 640.0
    there = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    n = by_proj(folder.folder / "n.gtx", np.array([lon]), np.array([lat]))[0]
    opened = block.withheld.open().ecef_m[0]
    np.testing.assert_allclose(opened, there.transform(lon, lat, height + n), rtol=0, atol=1e-6)


@pytest.mark.oracle
def test_undulations_are_above_wgs84_for_an_older_datum(folder: ProjectFolder) -> None:
    """For UTM on ED50 the height above WGS84 is H + N within 0.01 m, although that ellipsoid is 70 m away."""
    grid = write_grid(folder.folder / "n.gtx")
    to_old = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:23036", always_xy=True)
    plane = np.stack(to_old.transform(*PLACES[:, :2].T), axis=1)
    rows = [f"{n},control,{e!r},{north!r},{h},1,1,1\n" for n, (e, north), h in zip(
        ("01", "1", "c3", "c4"), plane.tolist(), PLACES[:, 2].tolist(), strict=True)]  # fmt: skip
    header = "id,role,easting_m,northing_m,height_m,sigma_east_m,sigma_north_m,sigma_up_m\n"
    folder.points.write_text(header + "".join(rows) + "k1,tie,,,,,,\nk2,tie,,,,,,\nt1,tie,,,,,,\n", encoding="utf-8")
    state(folder, 'geoid = "n.gtx"', "EPSG:23036")
    found = read_project(folder.project).points.known.ecef_m[:4]
    expected = expected_ecef(by_proj(grid, *PLACES[:, :2].T))
    # PROJ picks its operation by area: accuracies of metres horizontally; the height does not depend on it
    assert np.abs(ecef_to_geodetic(found)[2] - ecef_to_geodetic(expected)[2]).max() < 0.01
    assert np.linalg.norm(found - expected, axis=1).max() < 10.0


@pytest.mark.truth
def test_a_constant_and_an_estimated_constant(folder: ProjectFolder) -> None:
    state(folder, "undulation_m = 34.25")
    block = read_project(folder.project)
    np.testing.assert_allclose(block.points.known.ecef_m[:4], expected_ecef(np.full(4, 34.25)), rtol=0, atol=1e-6)
    differences = np.array([34.20, 34.30, 34.27, 34.23])
    rows = [f"{k},{100.0 * k},{100.0 * k + d}" for k, d in enumerate(differences)]
    table = folder.folder / "both.csv"
    table.write_text("\n".join(["id,height_m,ellipsoidal_height_m", *rows]) + "\n", encoding="utf-8")
    found = estimated(table)
    assert found.undulation_m == pytest.approx(34.25, abs=1e-9)
    # by hand: deviations -5, 5, 2, -2 cm; 58 cm2 / 3 = 4.397^2; / sqrt(4)
    assert found.single_m == pytest.approx(0.04397, abs=1e-5)
    assert found.sigma_m == pytest.approx(0.02198, abs=1e-5)
    folder.change("project.toml", "undulation_m = 34.25", 'both_heights = "both.csv"')
    again = read_project(folder.project)
    np.testing.assert_allclose(again.points.known.ecef_m, block.points.known.ecef_m, rtol=0, atol=1e-6)
    assert any("Its standard deviation is 0.022 m" in str(note) for note in again.notes)


@pytest.mark.truth
def test_an_odd_point_of_both_heights_is_named_and_right_ones_are_not(tmp_path: Path) -> None:
    """A height wrong by 10 sigma is named; of 499 correct tables about 1 % name a point, the level of the test."""
    rng, path, named = np.random.default_rng(5), tmp_path / "both.csv", 0
    for k in range(500):
        n = 36.0 + rng.normal(0.0, 0.02, 6)
        n[3] += 0.3 if k == 0 else 0.0
        rows = [f"p{j},{j},{j + value!r}" for j, value in enumerate(n.tolist())]
        path.write_text("\n".join(["id,height_m,ellipsoidal_height_m", *rows]) + "\n", encoding="utf-8")
        odd = [note for note in estimated(path).notes if note.code == "heights.odd_point"]
        if k == 0:
            assert "point p3" in str(odd[0])
        else:
            named += bool(odd)
    assert named <= 14  # binomial (499, 0.01): beyond it with probability 1e-4
    path.write_text("id,height_m,ellipsoidal_height_m\nA,1,37\n", encoding="utf-8")
    assert "it is not checked" in str(estimated(path).notes[0])


@pytest.mark.behaviour
def test_what_is_said_of_heights(folder: ProjectFolder) -> None:
    assert any("EPSG:4979 (ellipsoidal height) to" in str(note) for note in read_project(folder.project).notes)
    state(folder, "", "EPSG:4326")
    _, remarks = checked_project(folder.project)
    assert any("assumed to be ellipsoidal, because EPSG:4326 does not" in str(p) for p in remarks)
    folder.change("project.toml", 'crs = "EPSG:4326"', 'crs = "EPSG:4979"\nundulation_m = -34.25')
    _, remarks = checked_project(folder.project)
    assert any("opposite sign it would fit" in str(p) and p.severity == "warning" for p in remarks)
    folder.change("project.toml", "undulation_m = -34.25", 'undulation_m = 34.25\ngeoid = "n.gtx"')
    _, problems = checked_project(folder.project)
    assert ["more than one method" in str(p) for p in problems] == [True]
    folder.change("project.toml", 'undulation_m = 34.25\ngeoid = "n.gtx"', 'geoid = "n.gtx"')
    _, problems = checked_project(folder.project)
    assert len(problems) == 1 and "n.gtx: the geoid file does not exist" in str(problems[0])


# --- names and PROJ's folders --------------------------------------------------------------------


@pytest.mark.behaviour
def test_vertical_crs_by_name(folder: ProjectFolder) -> None:
    assert with_codes("EPSG:32636 + EGM96") == "EPSG:32636+5773"
    assert with_codes("EPSG:25832+DHHN2016 height") == "EPSG:25832+7837"
    assert vertical_code("egm2008") == "EPSG:3855"
    for same in ("EPSG:4979", "EPSG:32636+5773", "WGS84 UTM 36N", ""):
        assert with_codes(same) == same
    state(folder, "", "EPSG:4326+EGM")
    _, problems = checked_project(folder.project)
    assert len(problems) == 1 and "EGM96 height (EPSG:5773)" in str(problems[0])


@pytest.fixture
def proj_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder named by PROJ_DATA; PROJ's own folders come back afterwards."""
    usual = pyproj.datadir.get_data_dir()
    grids = tmp_path / "grids"
    grids.mkdir()
    monkeypatch.setenv("PROJ_DATA", str(grids))
    yield grids
    pyproj.datadir.set_data_dir(usual)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["us_nga_egm96_15.tif", "egm96_15.gtx", "EGM96-15.isg", "egm96_15.byn"])
def test_a_grid_of_any_name_and_format_in_proj_data(folder: ProjectFolder, proj_data: Path, name: str) -> None:
    write_grid(proj_data / name)
    undulation = by_proj(write_grid(folder.folder / "n.gtx"), *PLACES[:, :2].T)
    state(folder, "", "EPSG:4326+EGM96")
    block = read_project(folder.project)
    np.testing.assert_allclose(block.points.known.ecef_m[:4], expected_ecef(undulation), rtol=0, atol=1e-5)
    text = f"{name} in its folders" if name.endswith(("isg", "byn")) else "EPSG:4326+5773 (EGM96 height) to"
    assert any(text in str(note) for note in block.notes)
    assert os.environ["PROJ_DATA"] == str(proj_data)
    assert undulation_m("EPSG:4326+5773", [31.6], [41.2]) == pytest.approx(undulation[:1], abs=1e-5)


@pytest.mark.real_data
@pytest.mark.oracle
@pytest.mark.parametrize("way", ["file", "PROJ_DATA"])
def test_real_points_with_heights_above_egm96(
    real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """The 86 Pléiades points given in UTM 36 with EGM96 heights have their ECEF coordinates within 1 um.

    PROJ computes the heights.
    """
    grids = real_data / "shareloc-ventoux"
    project, ecef = pleiades_project(real_data, tmp_path)
    usual = pyproj.datadir.get_data_dir()
    try:
        pyproj.datadir.append_data_dir(str(grids))
        there = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:32636+5773", always_xy=True, allow_ballpark=False)
        plane = np.stack(there.transform(*ecef.T), axis=1)
        pyproj.datadir.set_data_dir(usual)
        rows = (tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()
        begin = next(k for k, row in enumerate(rows) if row.startswith("id,"))
        cells = [row.split(",") for row in rows[begin + 1 :]]
        header = "id,role,easting_m,northing_m,height_m,sigma_east_m,sigma_north_m,sigma_up_m"
        made = [",".join([*c[:2], *map(repr, xyz), *c[5:]]) for c, xyz in zip(cells, plane.tolist(), strict=True)]
        (tmp_path / "points.csv").write_text("\n".join([header, *made]) + "\n", encoding="utf-8")
        crs = f'"EPSG:32636"\ngeoid = "{grids / "egm96_15.gtx"}"' if way == "file" else '"EPSG:32636+EGM96"'
        text = project.read_text(encoding="utf-8").replace('"EPSG:4978"', crs)
        project.write_text(text, encoding="utf-8")
        if way == "PROJ_DATA":
            monkeypatch.setenv("PROJ_DATA", str(grids))
        block = read_project(project)
    finally:
        pyproj.datadir.set_data_dir(usual)
    control = block.points.where(Role.CONTROL)
    assert np.abs(block.points.known.ecef_m[control] - ecef[control]).max() < 1e-6
    assert np.abs(plane[:, 2] - ecef_to_geodetic(ecef)[2]).min() > 20.0  # the geoid has a large effect here


@pytest.mark.truth
def test_convert_makes_heights_ellipsoidal(folder: ProjectFolder) -> None:
    """``convert --undulation`` replaces the missing grid of a compound CRS by a constant; only heights change."""
    out = folder.folder / "out.csv"
    given = ("--from", "csv", "--crs", "EPSG:9518", "--undulation", 34.25)
    ended = in_process("convert", folder.points, *given, "--to", "csv", "--out", out)
    assert ended.code == 0 and "constant undulation 34.250 m" in ended.stderr
    rows = [line.split(",") for line in out.read_text(encoding="utf-8").splitlines() if line[:2] in ("01", "c4")]
    assert [row[2:5] for row in rows] == [["31.6", "41.2", "46.75"], ["32.0", "41.44", "1534.25"]]
    assert "# crs: EPSG:4326" in out.read_text(encoding="utf-8")


@pytest.mark.oracle
def test_a_dem_above_a_geoid_file(tmp_path: Path) -> None:
    """Heights of a DEM above a geoid file are ellipsoidal by PROJ's interpolation, within 1 mm."""
    grid, dem = write_grid(tmp_path / "n.gtx"), tmp_path / "dem.tif"
    place = rasterio.Affine(0.01, 0, 31.5, 0, -0.01, 41.8)
    with rasterio.open(
        dem, "w", driver="GTiff", width=60, height=50, count=1, dtype="float64", crs="EPSG:4326", transform=place
    ) as raster:
        raster.write(np.full((1, 50, 60), 500.0))
    row, column = np.mgrid[:50, :60]
    expected = 500.0 + by_proj(grid, (31.5 + 0.01 * (column + 0.5)).ravel(), (41.8 - 0.01 * (row + 0.5)).ravel())
    found = RasterDem(dem, vertical_crs=str(grid)).heights_m
    assert np.abs(found.ravel() - expected).max() <= 1e-3


@pytest.mark.behaviour
def test_geocentric_coordinates_have_no_zero_level(folder: ProjectFolder) -> None:
    assert not ZeroLevel()
    folder.change("points.csv", "lon_deg,lat_deg,height_m", "x_m,y_m,z_m")
    state(folder, "undulation_m = 34.0", "EPSG:4978")
    _, problems = checked_project(folder.project)
    assert any("geocentric coordinates do not contain heights" in str(p) for p in problems)
