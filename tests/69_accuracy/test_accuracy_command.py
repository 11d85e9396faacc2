"""The command ``accuracy`` is run on a result folder and a raster."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fg_orient.result.plain import read_table
from tests.support.command import in_process

rasterio = pytest.importorskip("rasterio")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the result of a small block."""
    base = tmp_path_factory.mktemp("accuracy")
    made = in_process("simulate", "block", "--rows", 1, "--columns", 2, "--points", 60, "--out", base / "block")
    assert made.code == 0, made.stderr
    ended = in_process("adjust", base / "block" / "project.toml", "--out", base / "result")
    assert ended.code == 0, ended.stderr
    return base / "result"


def raster(path: Path, height_m: float, crs: str = "EPSG:4326") -> Path:
    transform = rasterio.Affine(0.05, 0.0, 20.0, 0.0, -0.05, 60.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=600, height=600, count=1, dtype="float64", crs=crs, transform=transform
    ) as out:
        out.write(np.full((1, 600, 600), height_m))
    return path


@pytest.mark.oracle
def test_heights_against_a_raster(folder: Path, tmp_path: Path) -> None:
    dem = raster(tmp_path / "dem.tif", 40.0)
    found = in_process("accuracy", folder, "--dem", dem, "--role", "check", "--json").json
    points = read_table(folder / "points.csv")
    height = points.figures["height_m"][[role == "check" for role in points.words["role"]]]
    assert found["n"] == len(height)
    assert found["mean_m"] == pytest.approx(np.mean(height - 40.0), abs=1e-6)
    assert found["q95_m"] == pytest.approx(np.quantile(np.abs(height - 40.0), 0.95), abs=1e-6)
    assert found["shift"] is None
    assert "the shift is not estimated" in found["warnings"][0]
    told = in_process("accuracy", folder, "--dem", dem)
    assert told.code == 0
    assert "nmad_m" in told.stdout and "the shift is not estimated" in told.stderr


@pytest.mark.behaviour
def test_refusals(folder: Path, tmp_path: Path) -> None:
    dem = raster(tmp_path / "dem.tif", 0.0)
    for words, message in (
        (("--dem", tmp_path / "none.tif"), "none.tif"),
        (("--dem", dem, "--role", "pass"), "no points with this role"),
        (("--dem", raster(tmp_path / "geoid.tif", 0.0, "EPSG:4326+5773")), "geoid.tif"),
    ):
        ended = in_process("accuracy", folder, *words)
        assert ended.code == 2 and message in ended.stderr
