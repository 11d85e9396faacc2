"""The module makes images and surveyed points of a place, and tables of them as offices write them.

Pixels come from an evaluation of the rational functions apart from the package, map coordinates from PROJ.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np
import pyproj

from fg_orient.formats.exchange.own_csv import read as read_own
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.project import _read_toml
from fg_orient.formats.registry import Settings
from fg_orient.formats.rpc import write_rpc
from tests.support.rpc_model import reference_project, synthetic_model

#: Longitude and latitude of places, and the CRS of their offices.
PLACES: Final = {
    "tr": (31.8, 41.4, "EPSG:5255"), "fr": (2.4, 48.7, "EPSG:2154"), "de": (9.2, 49.1, "EPSG:25832"),
    "es": (-3.6, 40.4, "EPSG:25830"), "ie": (-7.9, 53.2, "EPSG:2157"),
}  # fmt: skip
IMAGES: Final = ("left", "right")
#: Errors of the orientation of both images: line, sample, px.
MOVES: Final = ((6.3, -4.2), (-5.1, 8.4))
#: Lines and columns of tables: a list of rows.
Grid = list[list[Any]]


@dataclass(frozen=True, eq=False)
class Place:
    """Truth of a place: RPC of both images, ids, longitude, latitude, ellipsoidal height (n, 3), pixels (2, n, 2)."""

    models: tuple[Any, Any]
    ids: tuple[str, ...]
    lonlath: np.ndarray
    pixels: np.ndarray
    crs: str

    def map(self, crs: str = "") -> np.ndarray:
        """Return the easting, northing (or longitude, latitude) and ellipsoidal height (n, 3) by PROJ."""
        to = pyproj.Transformer.from_crs("EPSG:4979", pyproj.CRS(crs or self.crs).to_3d(), always_xy=True)
        return np.stack(to.transform(*self.lonlath.T), axis=1)

    @property
    def ecef(self) -> np.ndarray:
        """Return the geocentric coordinates (n, 3), m."""
        to = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
        return np.stack(to.transform(*self.lonlath.T), axis=1)


@cache
def place(
    name: str, n: int = 20, seed: int = 3, relief_m: float = 250.0, moves: Any = MOVES, noise_px: float = 0.3
) -> Place:
    """Return two images of half a metre and n points, measured with noise."""
    lon, lat, crs = PLACES[name]
    rng = np.random.default_rng(seed)
    models = []
    for k, lift in enumerate(((0.02, -0.03), (-0.01, 0.09))):
        c = np.random.default_rng(k).normal(scale=1e-5, size=(4, 20))
        c[1::2, 0] = 1.0
        c[0, 1:4] += 0.05, -0.9, lift[0]
        c[2, 1:4] += 0.9, 0.05, lift[1]
        scales = [10000.0, 10000.0, 5000.0 / 111320.0 / np.cos(np.radians(lat)), 5000.0 / 111320.0, 500.0]
        models.append(synthetic_model(offsets=[10000.0, 10000.0, lon, lat, 500.0], scales=scales, coefficients=c))
    u = rng.uniform(-0.8, 0.8, (2, n))
    lonlath = np.stack([lon + models[0].scales[2] * u[0], lat + models[0].scales[3] * u[1],
                        300.0 + relief_m * rng.uniform(-1.0, 1.0, n)], axis=1)  # fmt: skip
    pixels = np.stack([
        np.stack([v.astype(float) for v in reference_project(m, *lonlath.T)], axis=1)
        + move + rng.normal(scale=noise_px, size=(n, 2))
        for m, move in zip(models, moves, strict=True)
    ])  # fmt: skip
    ids = tuple(str(k) for k in range(101, 101 + n))
    return Place((models[0], models[1]), ids, np.round(lonlath, 12), np.round(pixels, 4), crs)


def write_images(folder: Path, there: Place) -> None:
    """Write the RPC files of both images."""
    folder.mkdir(exist_ok=True, parents=True)
    for name, model in zip(IMAGES, there.models, strict=True):
        write_rpc(folder / f"{name}_RPC.TXT", model)


def number(value: float, decimal: str = ".", digits: int = 4) -> str:
    """Write a number with a decimal sign."""
    return f"{value:.{digits}f}".replace(".", decimal)


def dms(value: float, letters: str) -> str:
    """Write degrees with minutes, seconds and a hemisphere."""
    letter, value = letters[int(value < 0.0)], abs(value)
    d = int(value)
    m = int((value - d) * 60.0)
    return f"{d}°{m:02d}'{(value - d - m / 60.0) * 3600.0:09.6f}\"{letter}"


def pixel_rows(there: Place, decimal: str = ".", first_pixel: float = 0.0, names: Sequence[str] = IMAGES) -> Grid:
    """Return the rows of image, id, line, sample."""
    return [[name, i, *(number(v + first_pixel, decimal) for v in there.pixels[k][j])]
            for k, name in enumerate(names) for j, i in enumerate(there.ids)]  # fmt: skip


def text(rows: Grid, mark: str = ";") -> str:
    """Return the rows as lines."""
    return "".join(mark.join(str(cell) for cell in row) + "\r\n" for row in rows)


def write_xlsx(path: Path, **sheets: Grid) -> None:
    """Write a workbook by openpyxl."""
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)


def write_ods(path: Path, **sheets: Grid) -> None:
    """Write an OpenDocument workbook as LibreOffice does: repeated blank cells and rows up to the end of the sheet."""
    rest = '<table:table-cell table:number-columns-repeated="1000"/>'
    blank = f'<table:table-row table:number-rows-repeated="1048000">{rest}</table:table-row>'
    body = ""
    for name, rows in sheets.items():
        lines = "".join(f"<table:table-row>{''.join(map(_ods_cell, row))}{rest}</table:table-row>" for row in rows)
        body += f'<table:table table:name="{escape(name)}">{lines}{blank}</table:table>'
    spaces = " ".join(f'xmlns:{n}="urn:oasis:names:tc:opendocument:xmlns:{n}:1.0"' for n in ("office", "table", "text"))
    content = f"<office:body><office:spreadsheet>{body}</office:spreadsheet></office:body>"
    content = f"<office:document-content {spaces}>{content}</office:document-content>"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("content.xml", f'<?xml version="1.0" encoding="UTF-8"?>{content}')


def _ods_cell(value: Any) -> str:
    if value is None or value == "":
        return "<table:table-cell/>"
    if isinstance(value, (int, float)):
        cell = f'<table:table-cell office:value-type="float" office:value="{value!r}">'
        return f"{cell}<text:p>{value:.2f}</text:p></table:table-cell>"
    return f'<table:table-cell office:value-type="string"><text:p>{escape(str(value))}</text:p></table:table-cell>'


def office_files(folder: Path) -> None:
    """Write the files of :func:`office_folder` into the folder itself."""
    office_folder(folder)
    for path in (folder / "office").iterdir():
        path.rename(folder / path.name)


def office_folder(folder: Path) -> None:
    """Write ``office``: two RPC images and a workbook of a surveyor, as their how-to page describes it."""
    there = place("tr")
    write_images(folder / "office", there)
    points: Grid = [["Yer kontrol noktaları"], ["WGS84, UTM dilim 36"], [],
                    ["Nokta No", "Doğu (m)", "Kuzey (m)", "Elipsoidal yükseklik (m)", "Görev"]]  # fmt: skip
    points += [[int(i), *map(float, p), "denetim" if k % 4 == 3 else "kontrol"]
               for k, (i, p) in enumerate(zip(there.ids, there.map("EPSG:32636"), strict=True))]  # fmt: skip
    marks: Grid = [["Görüntü", "Nokta No", "Satır", "Sütun"]]
    marks += [[image, int(i), float(a), float(b)] for image, i, a, b in pixel_rows(there, ".", 1.0)]
    write_xlsx(folder / "office" / "noktalar.xlsx", YKN=points, Ölçüler=marks)


def made(project: Path) -> Survey:
    """Return the survey of the tables of a project, by the strict reader."""
    entry = _read_toml(project / "project.toml", {}).points
    return read_own((project / "points.csv", project / "observations.csv"), Settings(entry.crs or ""))


def differences(survey: Survey, there: Place) -> tuple[float, float]:
    """Return the largest differences of a survey from the truth: ground points in m, image points in px.

    Coordinates are transformed by PROJ.
    """
    crs = pyproj.CRS(survey.crs)
    to = pyproj.Transformer.from_crs(
        crs if crs.is_compound or crs.is_geocentric else crs.to_3d(), "EPSG:4978", always_xy=True
    )
    row = {name: k for k, name in enumerate(survey.ids)}
    rows = [row[name] for name in there.ids]
    ecef = np.stack(to.transform(*survey.coordinates[rows].T), axis=1)
    o = survey.observed
    worst = 0.0
    at = {name: k for k, name in enumerate(there.ids)}
    for image, point, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
        true = there.pixels[IMAGES.index(survey.images[image])][at[survey.ids[point]]]
        worst = max(worst, float(np.abs(true - (line, sample)).max()))
    assert len(o) == 2 * len(there.ids)
    return float(np.abs(ecef - there.ecef).max()), worst
