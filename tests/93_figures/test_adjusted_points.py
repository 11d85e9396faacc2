"""Other programs read four formats of ``fg-orient dsm-points`` with the data of the result tables."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
import shapely

from fg_orient.formats.point_clouds import steps
from fg_orient.report.adjusted_points import PURPOSE
from tests.support.command import Run
from tests.support.results import sealed

Columns = dict[str, Any]
#: UTM of the twin.
UTM = "EPSG:32636"
SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
COVARIANCES = ("covariance_east_north_m2", "covariance_east_up_m2", "covariance_north_up_m2")
PLY = {"double": "<f8", "float": "<f4", "uchar": "<u1", "ushort": "<u2", "uint": "<u4"}
#: Undulation of the geoid file of a test, m: a plane in longitude and latitude, which a bilinear grid has exactly.
GEOID = (36.0, 0.4, -0.3)
ROLES = {0: "tie", 1: "check", 2: "control"}


def rows_of(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def read_las(path: Path) -> tuple[np.ndarray, Columns, str, str]:
    """Return the coordinates, columns, name of the CRS and the text, by laspy."""
    cloud = laspy.read(path)
    text = next(v.record_data_bytes() for v in cloud.header.vlrs if (v.user_id, v.record_id) == ("LASF_Spec", 3))
    columns = {name: np.asarray(cloud[name]) for name in cloud.point_format.extra_dimension_names}
    crs = cloud.header.parse_crs()
    return np.stack([cloud.x, cloud.y, cloud.z], axis=1), columns, crs.name if crs else "", text.decode()


def read_ply(path: Path) -> tuple[np.ndarray, Columns, str, str]:
    """Return coordinates, columns, CRS and last comment of a binary PLY file."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    fields = [(line.split()[2], PLY[line.split()[1]]) for line in lines if line.startswith("property ")]
    table = np.frombuffer(body, fields)
    assert f"element vertex {len(table)}" in lines
    comments = [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]
    crs = pyproj.CRS(comments[0].removeprefix("crs ")).name if len(comments) > 1 else ""
    columns = {name: table[name] for name, _ in fields[3:]}
    return np.stack([table[a] for a in "xyz"], axis=1), columns, crs, comments[-1]


def read_gpkg(path: Path) -> tuple[np.ndarray, Columns, str, str]:
    meta, _, wkb, fields = pyogrio.raw.read(path)
    text = pyogrio.read_info(path)["layer_metadata"]["DESCRIPTION"]
    columns = dict(zip(meta["fields"], fields, strict=True))
    return shapely.get_coordinates(shapely.from_wkb(wkb), include_z=True), columns, pyproj.CRS(meta["crs"]).name, text


def read_csv(path: Path) -> tuple[np.ndarray, Columns, str, str]:
    rows = rows_of(path)
    text = path.read_text("utf-8").splitlines()[0].removeprefix("# ")
    texts = {name: np.array([row[name] for row in rows]) for name in ("id", "role")}
    numbers = {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0] if name not in texts}
    places = [numbers.pop(name) for name in list(numbers)[:3]]
    return np.stack(places, axis=1), {**texts, **numbers}, pyproj.CRS(text.split("; ")[1].split(",")[0]).name, text


READ = {".laz": read_las, ".las": read_las, ".ply": read_ply, ".csv": read_csv, ".gpkg": read_gpkg}


def joint_covariances(result: Path) -> dict[str, np.ndarray]:
    """Return the covariances (3, 3) East, North, Up of the points from the joint cofactors, posterior scale."""
    sigma0 = json.loads((result / "result.json").read_text("utf-8"))["sigma0"]
    with np.load(result / "covariance.npz") as stored:
        names, q, values = stored["names"].tolist(), stored["cofactors"], stored["values"]
    out = {}
    for k in [k for k, name in enumerate(names) if name.startswith("point:") and name.endswith(".x")]:
        lon, lat, _ = np.radians(pyproj.Transformer.from_crs(4978, 4979, always_xy=True).transform(*values[k : k + 3]))
        east = [-np.sin(lon), np.cos(lon), 0.0]
        up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
        turn = np.stack([east, np.cross(up, east), up])
        out[names[k][6:-2]] = sigma0**2 * turn @ q[k : k + 3, k : k + 3] @ turn.T
    return out


@pytest.mark.oracle
@pytest.mark.parametrize("suffix", list(READ))
def test_formats_hold_the_tables(run: Run, adjusted: Path, tmp_path: Path, suffix: str) -> None:
    """Each format has coordinates by pyproj, the numbers of the table and the joint covariances.

    CRS and purpose are stated.
    """
    out = tmp_path / f"points{suffix}"
    ended = run("dsm-points", adjusted, "--out", out, "--crs", UTM, "--control", "--json")
    assert ended.code == 0, ended.stderr
    record, table = ended.json, rows_of(adjusted / "points.csv")
    assert (record["points"], record["crs"], record["heights"]) == (47, UTM, "ellipsoidal")
    place, columns, crs, text = READ[suffix](out)
    ecef = np.array([[float(row[f"{a}_m"]) for a in "xyz"] for row in table])
    wanted = np.stack(
        pyproj.Transformer.from_crs(4978, pyproj.CRS(32636).to_3d(), always_xy=True).transform(*ecef.T), 1
    )
    # steps of 0.1 mm in LAS; rounding of metres of seven digits elsewhere
    assert np.abs(place - wanted).max() <= (5.1e-5 if suffix in (".laz", ".las") else 1e-7)
    assert crs == "WGS 84 / UTM zone 36N" and text.startswith(PURPOSE) and "posterior scale" in text
    single = 1e-6 if suffix in (".laz", ".las", ".ply") else 1e-15
    for name in (*SIGMAS, "n_rays"):
        assert np.allclose(columns[name], [float(row[name]) for row in table], rtol=single, atol=0.0), name
    roles = columns["role"].tolist()
    assert [ROLES.get(role, role) for role in roles] == [row["role"] for row in table]
    if "id" in columns:
        assert columns["id"].tolist() == [row["id"] for row in table]
    else:
        assert columns["number"].tolist() == list(range(1, 48))
    joint = joint_covariances(adjusted)
    assert set(joint) >= {row["id"] for row in table if row["role"] == "control"}
    for k, row in enumerate(table):
        if row["id"] in joint:
            q = joint[row["id"]]
            sigma = np.sqrt(np.diag(q))
            assert np.allclose([columns[name][k] for name in SIGMAS], sigma, rtol=1e-5)
            found = [columns[name][k] for name in COVARIANCES]
            scale = np.outer(sigma, sigma)[[0, 0, 1], [1, 2, 2]]
            assert np.abs(found - q[[0, 0, 1], [1, 2, 2]]).max() < 1e-5 * scale.max()


@pytest.mark.consistency
def test_covariances_of_check_points_are_predictions(run: Run, adjusted: Path, tmp_path: Path) -> None:
    """Sigmas and covariances of excluded check points form positive definite matrices."""
    run("dsm-points", adjusted, "--out", tmp_path / "a.csv", "--crs", UTM)
    _, columns, _, _ = read_csv(tmp_path / "a.csv")
    assert set(columns["role"]) == {"check"} and len(columns["role"]) == 10
    q = np.stack([np.diag([columns[name][k] ** 2 for name in SIGMAS]) for k in range(10)])
    for (i, j), name in zip(((0, 1), (0, 2), (1, 2)), COVARIANCES, strict=True):
        q[:, i, j] = q[:, j, i] = columns[name]
    assert (np.linalg.eigvalsh(q) > 0.0).all() and np.abs(q[:, 0, 2]).max() > 0.0


@pytest.fixture(scope="module")
def orthometric(project: Path, tmp_path_factory: pytest.TempPathFactory, run: Run) -> Path:
    """Return the result folder of the twin with UTM coordinates and heights above a geoid file.

    A tie point has a gross error.
    """
    folder = tmp_path_factory.mktemp("orthometric")
    shutil.copytree(project.parent, folder, dirs_exist_ok=True)
    step, west, north = 0.25, 31.0, 42.0
    lon, lat = np.arange(west, 33.1, step), np.arange(north, 40.9, -step)
    with rasterio.open(
        folder / "geoid.tif", "w", driver="GTiff", width=len(lon), height=len(lat), count=1, dtype="float64",
        crs="EPSG:4326", transform=rasterio.Affine(step, 0, west - 0.5 * step, 0, -step, north + 0.5 * step),
    ) as grid:  # fmt: skip
        grid.write(undulation(lon[None], lat[:, None])[None])
    rows = rows_of(project.parent / "points.csv")
    lon, lat, height = (np.array([float(row[name]) for row in rows]) for name in ("lon_deg", "lat_deg", "height_m"))
    east, north_m = pyproj.Transformer.from_crs(4326, 32636, always_xy=True).transform(lon, lat)
    lines, ties = ["id,role,easting_m,northing_m,height_m,sigma_east_m,sigma_north_m,sigma_up_m"], 0
    for k, row in enumerate(rows):
        ties += row["role"] == "check"
        cells: list[Any] = [row["id"], "tie", *[""] * 6]
        if row["role"] != "check" or ties > 6:
            cells[1:] = [
                row["role"],
                east[k],
                north_m[k],
                height[k] - undulation(lon[k], lat[k]),
                *map(row.get, SIGMAS),
            ]
        lines.append(",".join(map(str, cells)))
    (folder / "points.csv").write_text("\n".join(lines) + "\n", "utf-8")
    wrong = next(line.split(",")[0] for line in lines if ",tie," in line)
    observed = (folder / "observations.csv").read_text("utf-8").splitlines()
    for k, line in enumerate(observed):
        cells = line.split(",")
        if cells[:2] == ["left", wrong]:
            observed[k] = ",".join([*cells[:2], repr(float(cells[2]) + 20.0), *cells[3:]])
    (folder / "observations.csv").write_text("\n".join(observed) + "\n", "utf-8")
    text = (folder / "project.toml").read_text("utf-8")
    text = text.replace('crs = "EPSG:4979"', f'crs = "{UTM}"\ngeoid = "geoid.tif"', 1)
    (folder / "project.toml").write_text(text, "utf-8")
    ended = run("adjust", folder / "project.toml", "--out", folder / "result", "--snoop")
    assert ended.code in (0, 4), ended.stderr
    return folder


def undulation(lon: Any, lat: Any) -> Any:
    return GEOID[0] + GEOID[1] * (lon - 32.0) + GEOID[2] * (lat - 41.0)


@pytest.mark.oracle
def test_crs_and_heights_are_those_of_the_project(run: Run, orthometric: Path, tmp_path: Path) -> None:
    """Points are written in the project's CRS and heights, and a missing geoid file is asked for.

    Adjusted minus measured coordinates are the differences of the table.
    """
    result = orthometric / "result"
    ended = run("dsm-points", result, "--out", tmp_path / "a.gpkg", "--control", "--json")
    assert ended.json["crs"] == UTM and ended.json["heights"] == "above the geoid of geoid.tif"
    place, columns, crs, text = read_gpkg(tmp_path / "a.gpkg")
    assert crs == "WGS 84 / UTM zone 36N" and "heights above the geoid of geoid.tif" in text
    given = {row["id"]: row for row in rows_of(orthometric / "points.csv")}
    table = {row["id"]: row for row in rows_of(result / "points.csv")}
    for name, xyz in zip(columns["id"], place, strict=True):
        row = {key: float(value or "nan") for key, value in table[name].items() if key.endswith(("_m", "_deg"))}
        assert xyz[2] + undulation(row["lon_deg"], row["lat_deg"]) == pytest.approx(row["height_m"], abs=1e-8)
        if table[name]["difference_up_m"]:
            up = xyz[2] - float(given[name]["height_m"])
            # differences East and North of 3 m change the undulation by 0.015 mm
            assert up == pytest.approx(row["difference_up_m"], abs=2e-5)
    assert sum(bool(table[name]["difference_up_m"]) for name in columns["id"]) > 30
    # the file is gone: one line that names it
    moved = tmp_path / "moved"
    shutil.copytree(result, moved)
    ended = run("dsm-points", moved, "--out", tmp_path / "b.csv")
    assert ended.code == 2 and ended.stderr.count("\n") == 1 and "geoid.tif" in ended.stderr
    ended = run("dsm-points", moved, "--out", tmp_path / "b.csv", "--geoid", orthometric / "geoid.tif", "--control")
    assert ended.code in (0, 4) and np.array_equal(read_csv(tmp_path / "b.csv")[0], place)


@pytest.mark.behaviour
def test_selection(run: Run, orthometric: Path, tmp_path: Path) -> None:
    """Control and rejected points are omitted by default, and limits on rays and height sigmas select points."""
    result = orthometric / "result"
    table = rows_of(result / "points.csv")
    left_out = {row["id"] for row in rows_of(result / "outliers.csv") if not row["readmitted"]}
    assert left_out

    def ids(*words: object) -> set[str]:
        ended = run("dsm-points", result, "--out", tmp_path / "a.csv", "--overwrite", *words)
        assert ended.code in (0, 4), ended.stderr
        return set(read_csv(tmp_path / "a.csv")[1]["id"])

    whole = {row["id"] for row in table if row["x_m"]}
    others = {row["id"] for row in table if row["role"] != "control"}
    assert ids() == (whole & others) - left_out
    assert ids("--control") == whole - left_out
    assert ids("--control", "--rejected") == whole
    sigma = {row["id"]: float(row["sigma_up_m"]) for row in table if row["sigma_up_m"]}
    limit = sorted(sigma[name] for name in whole - left_out)[20]
    assert ids("--control", "--max-sigma-height", limit) == {name for name in whole - left_out if sigma[name] <= limit}
    ended = run("dsm-points", result, "--out", tmp_path / "b.csv", "--min-rays", 3)
    assert ended.code == 2 and ended.stderr.count("\n") == 1 and "few rays" in ended.stderr


@pytest.mark.behaviour
def test_local_coordinates_have_no_crs(run: Run, result: Path, tmp_path: Path) -> None:
    """Points of a local system are written as x, y, z without CRS and heights, and a CRS is refused."""
    table = rows_of(result / "points.csv")
    lines = [",".join("" if name in ("lon_deg", "lat_deg", "height_m") else row[name] for name in row) for row in table]
    (result / "points.csv").write_text("\n".join([",".join(table[0]), *lines]) + "\n", "utf-8")
    wanted = [[float(row[f"{a}_m"]) for a in "xyz"] for row in table]
    sealed(result)
    for suffix in (".laz", ".ply", ".csv", ".gpkg"):
        ended = run("dsm-points", result, "--out", tmp_path / f"a{suffix}", "--control", "--json")
        assert (ended.code, ended.json["crs"], ended.json["heights"]) == (0, None, "")
    assert np.abs(read_las(tmp_path / "a.laz")[0] - wanted).max() < 5.1e-5 and read_las(tmp_path / "a.laz")[2] == ""
    assert np.array_equal(read_ply(tmp_path / "a.ply")[0], wanted)
    assert "x_m,y_m,z_m" in (tmp_path / "a.csv").read_text("utf-8")
    assert pyogrio.read_info(tmp_path / "a.gpkg")["crs"] is None
    ended = run("dsm-points", result, "--out", tmp_path / "b.csv", "--crs", UTM)
    assert ended.code == 2 and "no geographic coordinates" in ended.stderr


@pytest.mark.behaviour
def test_doubt_is_heard(run: Run, result: Path, tmp_path: Path) -> None:
    """Points of a result that is not trustworthy are written with exit code 4 and a line that states the doubt."""
    record = json.loads((result / "result.json").read_text("utf-8"))
    (result / "result.json").write_text(json.dumps(record | {"status": "not_trustworthy"}), "utf-8")
    ended = run("dsm-points", sealed(result), "--out", tmp_path / "a.ply", "--crs", UTM)
    assert ended.code == 4 and (tmp_path / "a.ply").is_file()
    assert ended.stderr.startswith(f"doubt: {result}: this result is not trustworthy")
    assert PURPOSE in ended.stdout.splitlines()[0]


@pytest.mark.behaviour
@pytest.mark.parametrize("words, said", [
    (("--out", "a.xyz"), ".laz, .las, .ply, .csv, .gpkg"), (("--out", "a.csv", "--crs", "EPSG:9"), "EPSG:9"),
    (("--out", "a.csv", "--crs", "EPSG:32636+EGM97"), "EGM97"), (("--out", "none/a.laz"), "none"),
    (("--out", "a.csv", "--geoid", "none.gtx"), "none.gtx"), (("--out", "full.csv"), "--overwrite"),
])  # fmt: skip
def test_bad_input_is_one_line(
    run: Run, adjusted: Path, tmp_path: Path, words: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("full.csv").touch()
    ended = run("dsm-points", adjusted, *words)
    assert (ended.code, ended.stderr.count("\n")) == (2, 1), ended.stderr
    assert ended.stderr.startswith("error: ") and said in ended.stderr


@pytest.mark.behaviour
def test_missing_library_names_the_extra(
    run: Run, adjusted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "lazrs", None)
    ended = run("dsm-points", adjusted, "--out", tmp_path / "a.laz")
    assert ended.code == 2 and "pip install 'fg-orient[cloud]'" in ended.stderr


@pytest.mark.truth
def test_steps_of_las() -> None:
    """LAS steps are 0.1 mm up to 429 km, then 1 mm, and 1e-9 degrees for one scene, by hand."""
    offset, step = steps(np.array([[0.0, 0.0, 0.0], [400e3, 600e3, 10.0]]), "metre")
    assert offset.tolist() == [200e3, 300e3, 5.0] and step.tolist() == [1e-4, 1e-3, 1e-4]
    offset, step = steps(np.array([[31.0, 41.0, 0.0], [32.0, 52.0, 1.0]]), "degree")
    assert offset.tolist() == [31.0, 46.0, 0.0] and step.tolist() == [1e-9, 1e-8, 1e-4]
    assert steps(np.array([[7.25, 1.0, 2.0]]), "metre")[0].tolist() == [7.0, 1.0, 2.0]
