"""Twelve tables in the forms of five national offices each become a project in one command, or a question."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.command import Ended, in_process
from tests.support.office import (
    Grid,
    Place,
    differences,
    dms,
    made,
    number,
    pixel_rows,
    place,
    text,
    write_images,
    write_ods,
    write_xlsx,
)

#: Half of the last digit of the tables, m, and 0.15 mm between the ellipsoids of ETRS89 and WGS84; px.
GROUND_M, PIXEL = 2.5e-4, 1e-4
STATED = ("--sigma-ground", "0.05", "0.05", "0.1", "--sigma-image", "0.5", "0.5")


def new(folder: Path, *words: object) -> Ended:
    return in_process("new", folder / "in", "--out", folder / "project", "--yes", *STATED, *words)


def turkey(folder: Path, there: Place) -> None:
    """Write Turkish tables in Windows-1254 with semicolons, decimal commas and TM 33."""
    rows: Grid = [["Nokta Adı", "Sağa Değer (m)", "Yukarı Değer (m)", "Elipsoidal Yükseklik (m)"]]
    rows += [[i, *(number(v, ",") for v in p)] for i, p in zip(there.ids, there.map(), strict=True)]
    (folder / "YKN listesi.csv").write_bytes(text(rows).encode("cp1254"))
    rows = [["Görüntü", "Nokta Adı", "Satır", "Sütun"], *pixel_rows(there, ",", 1.0)]
    (folder / "görüntü ölçüleri.csv").write_bytes(text(rows).encode("cp1254"))


def turkey_utf16(folder: Path, there: Place) -> None:
    """Write Turkish tables in UTF-16 with tabs, two header lines, UTM and standard deviations in cm."""
    rows: Grid = [["Nokta", "Koordinatlar (m)", "", "", "Standart sapma (cm)", "", ""],
                  ["No", "Doğu", "Kuzey", "Elipsoidal yükseklik", "Doğu", "Kuzey", "Yükseklik"]]  # fmt: skip
    rows += [
        [i, *(number(v, ",") for v in p), "2,5", "2,5", "4"]
        for i, p in zip(there.ids, there.map("EPSG:32636"), strict=True)
    ]
    (folder / "ykn.txt").write_bytes(text(rows, "\t").encode("utf-16"))
    rows = [["", "left", "", "right", ""], ["No", "Satır", "Sütun", "Satır", "Sütun"]]
    rows += [[i, *(number(v + 1.0, ",") for v in there.pixels[:, k].ravel())] for k, i in enumerate(there.ids)]
    (folder / "ölçü.txt").write_bytes(text(rows, "\t").encode("utf-16"))


def germany(folder: Path, there: Place) -> None:
    """Write German tables in Windows-1252 with Hochwert before Rechtswert."""
    rows: Grid = [["Punkt-Nr.", "Hochwert", "Rechtswert", "Ellipsoidische Höhe"]]
    rows += [
        [i, number(n, ","), number(e, ","), number(h, ",")] for i, (e, n, h) in zip(there.ids, there.map(), strict=True)
    ]
    (folder / "Passpunkte.csv").write_bytes(text(rows).encode("cp1252"))
    rows = [["Bild", "Punkt-Nr.", "Zeile", "Spalte"], *pixel_rows(there, ",", 1.0)]
    (folder / "Bildmessungen.csv").write_bytes(text(rows).encode("cp1252"))


def france(folder: Path, there: Place) -> None:
    """Write a French workbook with title rows and a last row of means."""
    points = there.map()
    rows: Grid = [["Points d'appui, campagne 2024"], ["Projection : Lambert-93 (RGF93)"], [],
                  ["N° point", "Est (m)", "Nord (m)", "Hauteur ellipsoïdale (m)", "Nature"]]  # fmt: skip
    rows += [[int(i), *map(float, p), "appui" if k % 2 else "point de contrôle"]
             for k, (i, p) in enumerate(zip(there.ids, points, strict=True))]  # fmt: skip
    rows += [[], ["Moyenne", *map(float, points.mean(axis=0))]]
    marks: Grid = [["Image", "N° point", "Ligne", "Colonne"]]
    marks += [[a, int(b), float(c), float(d)] for a, b, c, d in pixel_rows(there, ".", 1.0)]
    write_xlsx(folder / "points.xlsx", Appui=rows, Mesures=marks)


def spain(folder: Path, there: Place) -> None:
    """Write a Spanish OpenDocument workbook with one sheet for each image."""
    rows: Grid = [["Nombre", "X UTM", "Y UTM", "Altura elipsoidal"]]
    rows += [[f"P{i}", *map(float, p)] for i, p in zip(there.ids, there.map(), strict=True)]
    sheets = {
        f"imagen {name}": [["Nombre", "Fila", "Columna"], *([f"P{i}", float(a + 1), float(b + 1)] for i, (a, b) in
                           zip(there.ids, there.pixels[k], strict=True))] for k, name in enumerate(("left", "right"))
    }  # fmt: skip
    write_ods(folder / "puntos.ods", Puntos=rows, **sheets)


def degrees(folder: Path, there: Place) -> None:
    """Write degrees, minutes and seconds with latitude first and hemispheres in Turkish."""
    rows: Grid = [["Nokta No", "Enlem", "Boylam", "Elipsoidal h (m)"]]
    rows += [
        [i, dms(lat, "KG"), dms(lon, "DB"), number(h, ",")]
        for i, (lon, lat, h) in zip(there.ids, there.lonlath, strict=True)
    ]
    (folder / "noktalar.csv").write_bytes(text(rows).encode("cp1254"))
    (folder / "olcu.csv").write_text(
        text([["resim", "nokta no", "satir", "sutun"], *pixel_rows(there, ",", 1.0)]), "utf-8"
    )


def ireland(folder: Path, there: Place) -> None:
    """Write tables with commas whose headers state different units."""
    rows: Grid = [["Point ID", "Easting [km]", "Northing [km]", "Ellipsoidal height [cm]"]]
    rows += [[i, number(e / 1000.0, digits=7), number(n / 1000.0, digits=7), number(h * 100.0, digits=2)]
             for i, (e, n, h) in zip(there.ids, there.map(), strict=True)]  # fmt: skip
    (folder / "gcp.csv").write_text(text(rows, ","), "utf-8")
    (folder / "image points.csv").write_text(
        text([["image", "point id", "row", "col"], *pixel_rows(there, ".", 1.0)], ","), "utf-8"
    )


def exchanged(folder: Path, there: Place) -> None:
    """Write tables in which X is north and Y is east, as in geodesy."""
    rows: Grid = [["Nokta", "X", "Y", "h elipsoidal"]]
    rows += [[i, number(n), number(e), number(h)] for i, (e, n, h) in zip(there.ids, there.map(), strict=True)]
    (folder / "koordinat.csv").write_text(text(rows), "utf-8")
    (folder / "piksel.csv").write_text(
        text([["resim", "nokta", "satır", "sütun"], *pixel_rows(there, ".", 1.0)]), "utf-8"
    )


def no_header(folder: Path, there: Place) -> None:
    """Write tables with blanks between cells and without a header, and one file for each image."""
    rows: Grid = [[i, *map(number, p)] for i, p in zip(there.ids, there.map("EPSG:32636"), strict=True)]
    (folder / "points.txt").write_text(text(rows, "   "), "utf-8")
    for k, name in enumerate(("left", "right")):
        rows = [[i, number(a + 1.0), number(b + 1.0)] for i, (a, b) in zip(there.ids, there.pixels[k], strict=True)]
        (folder / f"{name}.txt").write_text(text(rows, "   "), "utf-8")


def combined(folder: Path, there: Place) -> None:
    """Write one table for each image with geocentric coordinates and pixels in the same rows."""
    for k, name in enumerate(("left", "right")):
        rows: Grid = [["point_id", "line", "col", "X_ecef_m", "Y_ecef_m", "Z_ecef_m"]]
        rows += [[i, number(a + 1.0), number(b + 1.0), *map(number, x)]
                 for i, (a, b), x in zip(there.ids, there.pixels[k], there.ecef, strict=True)]  # fmt: skip
        (folder / f"points_{name}.csv").write_text(text(rows, ","), "utf-8")


def layer(folder: Path, there: Place) -> None:
    """Write a GeoPackage that states its CRS, with roles in Spanish."""
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    names = np.array(there.ids, object)
    use = np.array(["apoyo" if k % 2 else "chequeo" for k in range(len(names))], object)
    geometry = shapely.to_wkb(shapely.points(there.map()))
    pyogrio.raw.write(folder / "puntos.gpkg", geometry, [names, use], ["punto", "uso"], layer="puntos",
                      driver="GPKG", geometry_type="Point Z", crs=there.crs)  # fmt: skip
    (folder / "medidas.csv").write_text(
        text([["imagen", "punto", "fila", "columna"], *pixel_rows(there, ".", 1.0)]), "utf-8"
    )


FORMS: dict[str, tuple[str, Callable[[Path, Place], None], str, tuple[str, ...]]] = {
    "cp1254": ("tr", turkey, "EPSG:5254 EPSG:5255", ()),
    "utf16": ("tr", turkey_utf16, "EPSG:32636", ()),
    "germany": ("de", germany, "EPSG:32632", ()),
    "france": ("fr", france, "EPSG:2154", ()),
    "spain": ("es", spain, "EPSG:32630", ()),
    "degrees": ("tr", degrees, "EPSG:4979", ()),
    "units": ("ie", ireland, "EPSG:2157", ()),
    "exchanged": ("tr", exchanged, "EPSG:5255", ()),
    "no header": ("tr", no_header, "EPSG:32636", ("--heights", "ellipsoidal")),
    "geocentric": ("fr", combined, "EPSG:4978", ()),
    "layer": ("es", layer, "EPSG:25830", ("--heights", "ellipsoidal")),
}


@pytest.mark.oracle
@pytest.mark.parametrize("form", FORMS)
def test_a_table_becomes_a_project_in_one_command(tmp_path: Path, form: str) -> None:
    name, write, crs, words = FORMS[form]
    there = place(name)
    write_images(tmp_path / "in", there)
    write(tmp_path / "in", there)
    asked = new(tmp_path, *words)
    assert (asked.code, asked.stderr.count("error")) == (
        2,
        1,
    )  # the pixel origin cannot be seen: it is asked, nothing else
    assert "--first-pixel" in asked.stderr
    ended = new(tmp_path, "--first-pixel", "1", *words)
    assert ended.code == 0, ended.stderr
    survey = made(tmp_path / "project")
    assert survey.crs in crs
    if form == "spain":
        survey = replace(survey, ids=tuple(i.removeprefix("P") for i in survey.ids))
    ground, pixel = differences(survey, there)
    assert ground < GROUND_M, ended.stderr
    assert pixel < PIXEL


@pytest.mark.oracle
def test_heights_above_a_geoid_are_asked_for(tmp_path: Path) -> None:
    there = place("tr")
    write_images(tmp_path / "in", there)
    turkey(tmp_path / "in", there)
    file = tmp_path / "in" / "YKN listesi.csv"
    file.write_bytes(file.read_bytes().replace("Elipsoidal Yükseklik".encode("cp1254"), b"Ortometrik Kot"))
    asked = new(tmp_path, "--first-pixel", "1")
    assert (asked.code, asked.stderr.count("error")) == (2, 1)
    assert "--heights" in asked.stderr
    assert "EPSG:5773" in asked.stderr
    file.write_bytes(file.read_bytes().replace(b"Ortometrik Kot", b"Z"))
    asked = new(tmp_path, "--first-pixel", "1")
    assert (asked.code, asked.stderr.count("error")) == (2, 1)  # neither header nor images tell
    assert "--heights ellipsoidal" in asked.stderr
    assert new(tmp_path, "--first-pixel", "1", "--heights", "ellipsoidal").code == 0


@pytest.mark.oracle
def test_a_grid_that_proj_lacks_is_taken_from_the_folder_or_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``new`` uses a geoid file of the folder if PROJ lacks the grid; without the file it asks for --geoid.

    The undulations lie on a plane in longitude and latitude, which a bilinear grid has exactly.
    """
    rasterio = pytest.importorskip("rasterio")
    monkeypatch.delenv("PROJ_DATA", raising=False)
    there = place("tr")
    folder = tmp_path / "in"
    write_images(folder, there)

    def undulation(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
        return np.asarray(36.0 + 0.4 * (lon - 31.0) - 0.3 * (lat - 41.0))

    below = undulation(*there.lonlath[:, :2].T)
    turkey(folder, replace(there, lonlath=there.lonlath - np.stack([0.0 * below, 0.0 * below, below], axis=1)))
    file = folder / "YKN listesi.csv"
    file.write_bytes(file.read_bytes().replace("Elipsoidal Yükseklik".encode("cp1254"), b"Ortometrik Kot"))
    words = ("--first-pixel", "1", "--crs", "EPSG:5255", "--heights", "EPSG:5773")
    asked = new(tmp_path, *words)
    assert (asked.code, asked.stderr.count("error")) == (2, 1), asked.stderr
    assert "--geoid FILE" in asked.stderr and "EGM96 height" in asked.stderr
    # beside the other questions, in one round
    bare = in_process("new", folder, "--out", tmp_path / "project", "--yes", *words)
    assert bare.stderr.count("error") == 3 and "--geoid FILE" in bare.stderr
    lon, lat = np.arange(31.0, 33.01, 0.25), np.arange(42.0, 40.99, -0.25)
    with rasterio.open(
        folder / "egm96_15.gtx", "w", driver="GTX", width=len(lon), height=len(lat), count=1, dtype="float32",
        crs="EPSG:4326", transform=rasterio.Affine(0.25, 0, 30.875, 0, -0.25, 42.125),
    ) as grid:  # fmt: skip
        grid.write(np.float32(undulation(lon[None], lat[:, None]))[None])
    ended = new(tmp_path, *words)
    assert ended.code == 0, ended.stderr
    assert "egm96_15.gtx" in ended.stderr and "[--geoid]" in ended.stderr
    ground, pixel = differences(made(tmp_path / "project"), there)
    assert ground < GROUND_M and pixel < PIXEL  # float32 of GTX: 2e-6 m


@pytest.mark.behaviour
def test_missing_roles_are_assumed_and_check_points_given(tmp_path: Path) -> None:
    there = place("tr")
    write_images(tmp_path / "in", there)
    turkey(tmp_path / "in", there)
    ended = new(tmp_path, "--first-pixel", "1", "--check", "103", "--check", "110")
    assert ended.code == 0, ended.stderr
    assert "all points with coordinates are control" in (tmp_path / "project" / "project.toml").read_text("utf-8")
    survey = made(tmp_path / "project")
    assert [i for i, role in zip(survey.ids, survey.roles, strict=True) if role == "check"] == ["103", "110"]


@pytest.mark.behaviour
def test_without_a_terminal_assumptions_need_yes(tmp_path: Path) -> None:
    there = place("tr")
    write_images(tmp_path / "in", there)
    turkey(tmp_path / "in", there)
    ended = in_process("new", tmp_path / "in", "--out", tmp_path / "project", *STATED, "--first-pixel", "1")
    assert ended.code == 2
    assert "--yes" in ended.stderr.splitlines()[-1]
    assert not (tmp_path / "project").exists()


@pytest.mark.oracle
@pytest.mark.skipif(shutil.which("soffice") is None, reason="LibreOffice is not installed")
@pytest.mark.parametrize("end", ["xlsx", "ods"])
def test_a_workbook_saved_by_libreoffice(tmp_path: Path, end: str) -> None:
    there = place("fr")
    write_images(tmp_path / "in", there)
    (tmp_path / "made").mkdir()
    france(tmp_path / "made", there)
    subprocess.run(["soffice", "--headless", f"-env:UserInstallation=file://{tmp_path}/profile", "--convert-to", end,
                    "--outdir", str(tmp_path / "in"), str(tmp_path / "made" / "points.xlsx")], check=True, timeout=300,
                   capture_output=True)  # fmt: skip
    ended = new(tmp_path, "--first-pixel", "1")
    assert ended.code == 0, ended.stderr
    ground, pixel = differences(made(tmp_path / "project"), there)
    assert ground < GROUND_M
    assert pixel < PIXEL


@pytest.mark.oracle
def test_a_constant_undulation_makes_heights_ellipsoidal(tmp_path: Path) -> None:
    there = place("tr")
    write_images(tmp_path / "in", there)
    rows: Grid = [["Nokta", "Doğu", "Kuzey", "Ortometrik yükseklik"]]
    rows += [
        [i, *map(number, (e, n, h - 35.25))] for i, (e, n, h) in zip(there.ids, there.map("EPSG:32636"), strict=True)
    ]
    (tmp_path / "in" / "a.csv").write_text(text(rows), "utf-8")
    rows = [["Görüntü", "Nokta", "Satır", "Sütun"], *pixel_rows(there, ".", 1.0)]
    (tmp_path / "in" / "b.csv").write_text(text(rows), "utf-8")
    ended = new(tmp_path, "--first-pixel", "1", "--undulation", "35.25")
    assert ended.code == 0, ended.stderr
    assert "35.25" in (tmp_path / "project" / "project.toml").read_text("utf-8")
    assert "computed with the constant undulation" in ended.stderr + ended.stdout
    assert "assumed to be ellipsoidal" not in ended.stderr + ended.stdout  # they are no assumption any more
    assert differences(made(tmp_path / "project"), there)[0] < GROUND_M
