"""Fixtures are the twin rendered around its points and adjusted, and targets found in a map raster."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import from_geographic
from fg_orient.orientation.run import run_project
from fg_orient.rectification.ortho_models import SensorModel
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.surface import RasterDem
from fg_orient.simulate.render import RADII_M
from tests.support.command import in_process as run

Array = np.ndarray

CRS = "EPSG:32636"
RESOLUTION_M = 5.0
#: Coarser than usual, for speed.
DEM_STEP_M = 90.0


@dataclass(frozen=True)
class Twin:
    """Files of the twin, result folder of its adjustment, true map positions (n, 2) of the targets."""

    folder: Path
    result: Path
    targets: Array

    @cached_property
    def dem(self) -> RasterDem:
        return RasterDem(self.folder / "dem.tif")

    @cached_property
    def sensors(self) -> dict[str, PushbroomSensor]:
        return {image: read_sensor(self.folder / f"{image}.DIM") for image in ("left", "right")}

    @cached_property
    def left(self) -> SensorModel:
        """Return the left image by its metadata."""
        return SensorModel(self.sensors["left"], None, CRS, self.dem.range_m[1])


@pytest.fixture(scope="session")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Twin:
    """Return rendered squares of 80 pixels at the points of both images, and the block adjusted from its files."""
    folder = tmp_path_factory.mktemp("ortho") / "twin"
    done = run("simulate", "zonguldak", "--raster", "--raster-window", 80, "--dem-step", DEM_STEP_M, "--out", folder)
    assert done.code == 0, done.stderr
    run_project(folder / "project.toml", folder.parent / "result")
    return Twin(folder, folder.parent / "result", true_positions(folder))


def true_positions(folder: Path) -> Array:
    """Return the easting and northing of the points, from ``truth/``."""
    with (folder / "truth/points.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    lon, lat = (np.array([float(row[name]) for row in rows]) for name in ("lon_deg", "lat_deg"))
    return np.stack(from_geographic(CRS, lon, lat), axis=1)


def find_target(grey: Array) -> tuple[float, float]:
    """Return row and column of the target in a raster.

    The best correlation with disc and ring is refined to the disc's centroid.
    """
    reach = 7
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    distance = np.hypot(rows, columns) * RESOLUTION_M
    used = distance < RADII_M[1] + RESOLUTION_M
    looks = np.where(distance < RADII_M[0], 240.0, np.where(distance < RADII_M[1], 15.0, 110.0))[used]
    looks -= looks.mean()
    windows = np.lib.stride_tricks.sliding_window_view(grey.astype(float), rows.shape)[..., used]
    windows = windows - windows.mean(axis=-1, keepdims=True)
    length = np.sqrt((windows**2).sum(axis=-1)) * np.sqrt(looks @ looks)
    score = (windows @ looks) / np.maximum(length, 1e-9)
    assert score.max() > 0.7, "no target"
    i, j = np.unravel_index(int(score.argmax()), score.shape)
    part = grey[i + 3 : i + 12, j + 3 : j + 12].astype(float)
    y, x = np.mgrid[-4:5, -4:5]
    weight = np.clip(part - 15.0, 0.0, None) * (np.hypot(y, x) < 4.6)
    return i + reach + float((y * weight).sum() / weight.sum()), j + reach + float((x * weight).sum() / weight.sum())
