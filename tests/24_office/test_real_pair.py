"""The real Pléiades pair from a workbook of an office gives the same adjustment as tables of fg_orient."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest

import fg_orient as fg
from tests.support.command import in_process
from tests.support.office import Grid, write_xlsx
from tests.support.pleiades_project import pleiades_project

pytestmark = [pytest.mark.oracle, pytest.mark.real_data]


def undulations(grid: Path, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Return the undulations of a GTX grid, interpolated linearly here."""
    head, data = np.fromfile(grid, ">f8", 4), np.fromfile(grid, ">f4", offset=40)
    south, west, step_lat, step_lon = head
    rows, columns = np.fromfile(grid, ">i4", 2, offset=32)
    n = data.reshape(rows, columns)
    y, x = (lat - south) / step_lat, np.mod(lon - west, 360.0) / step_lon
    i, j = y.astype(int), x.astype(int)
    v, u = y - i, x - j
    k = (j + 1) % columns
    low, high = n[i, j] * (1.0 - u) + n[i, k] * u, n[i + 1, j] * (1.0 - u) + n[i + 1, k] * u
    return np.asarray(low * (1.0 - v) + high * v)


@pytest.fixture
def egm96(real_data: Path) -> Iterator[Path | None]:
    """Yield the grid of EGM96, where PROJ finds it; None if there is none."""
    grid = real_data / "shareloc-ventoux" / "egm96_15.gtx"
    before = pyproj.datadir.get_data_dir()
    if not grid.is_file():
        yield None
        return
    pyproj.datadir.append_data_dir(str(grid.parent))
    yield grid
    pyproj.datadir.set_data_dir(before)


def test_a_workbook_in_utm_with_heights_above_egm96_adjusts_as_our_own_tables(
    real_data: Path, tmp_path: Path, egm96: Path | None
) -> None:
    (tmp_path / "own").mkdir()
    own, ecef = pleiades_project(real_data, tmp_path / "own")
    lon, lat, h = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ecef.T)
    east, north = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32636", always_xy=True).transform(lon, lat)
    height = h if egm96 is None else h - undulations(egm96, lon, lat)
    title = "Elipsoidal yükseklikler" if egm96 is None else "Ortometrik yükseklikler, EGM96"
    tables = {k: np.genfromtxt(real_data / "geoetrim-pleiades" / f"points_img{k}.csv", delimiter=",", names=True)
              for k in (1, 3)}  # fmt: skip
    ids = tables[1]["point_id"].astype(int).tolist()
    points: Grid = [
        ["Zonguldak yer kontrol noktaları"],
        [title],
        [],
        ["Nokta No", "Sağa (m)", "Yukarı (m)", "H (m)", "Tür"],
    ]
    points += [[i, float(e), float(n), float(z), "denetim" if k % 8 else "kontrol"]
               for k, (i, e, n, z) in enumerate(zip(ids, east, north, height, strict=True))]  # fmt: skip
    marks: Grid = [["Görüntü", "Nokta No", "Satır", "Sütun"]]
    marks += [
        [f"img{k}", int(row["point_id"]), float(row["line"]), float(row["col"])] for k in (1, 3) for row in tables[k]
    ]
    office = tmp_path / "office"
    office.mkdir()
    for k in (1, 3):
        shutil.copy(real_data / "geoetrim-pleiades" / f"DIM_PHR1A_derived_img{k}.XML", office)
    write_xlsx(office / "noktalar.xlsx", YKN=points, Ölçüler=marks)
    ended = in_process("new", office, "--out", tmp_path / "project", "--yes", "--first-pixel", 1,
                       "--sigma-ground", 0.3, 0.3, 0.3, "--sigma-image", 0.3, 0.3)  # fmt: skip
    assert ended.code == 0, ended.stderr
    assert ("EPSG:32636+5773" if egm96 else "EPSG:32636") in (tmp_path / "project" / "project.toml").read_text("utf-8")
    expected, found = fg.adjust(fg.read_project(own)), fg.adjust(fg.read_project(tmp_path / "project" / "project.toml"))
    row = {name: k for k, name in enumerate(found.block.points.ids)}
    order = [row[name] for name in expected.block.points.ids]
    assert np.abs(found.ground_m[order] - expected.ground_m).max() < 1e-3
    assert np.abs(np.sort(found.residuals_px.ravel()) - np.sort(expected.residuals_px.ravel())).max() < 1e-3
