"""The twin's terrain: hills through the heights of its points, as a GeoTIFF DEM.

The heights of the points are drawn independently; the terrain is the mean height plus Gaussian hills (one per point,
standard width 2.5 km) that take the surface through all of them. The bilinear surface of the DEM passes through the
points within the rounding of its values (float32): what rounds at a point is put into the four cells about it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.gdal import rasterio_of
from fg_orient.geodesy import from_geographic

Array = npt.NDArray[np.float64]

#: UTM zone 36 north: the twin's place.
CRS: Final = "EPSG:32636"
STEP_M: Final = 30.0
#: Distance at which a hill has fallen to 1/e.
HILL_M: Final = 3500.0
#: Terrain beyond the box of the points: the images reach so far, seen under 20 degrees from 832 km.
BORDER_M: Final = 15_000.0


@dataclass(frozen=True, eq=False)
class Terrain:
    """A DEM in UTM, heights above the ellipsoid.

    Parameters
    ----------
    left_m, top_m : float
        Corner of the first cell.
    step_m : float
    heights_m : (rows, columns) float32 array
    targets_m : (n, 2) array
        Easting, northing of the points.
    """

    left_m: float
    top_m: float
    step_m: float
    heights_m: npt.NDArray[np.float32]
    targets_m: Array

    def cells(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Row and column (n, 2), whole at centres of cells."""
        x, y = from_geographic(CRS, lon_deg, lat_deg)
        return np.stack([(self.top_m - y) / self.step_m - 0.5, (x - self.left_m) / self.step_m - 0.5], axis=1)


def terrain_through(lon_lat_height: Array, *, step_m: float = STEP_M, border_m: float = BORDER_M) -> Terrain:
    """Give a terrain through points (n, 3) longitude, latitude (degrees), height (m)."""
    targets = np.stack(from_geographic(CRS, lon_lat_height[:, 0], lon_lat_height[:, 1]), axis=1)
    height = lon_lat_height[:, 2]
    low, high = targets.min(axis=0) - border_m, targets.max(axis=0) + border_m
    (left, _), (_, top) = np.floor(low / step_m) * step_m, np.ceil(high / step_m) * step_m
    columns, rows = (int(n) for n in np.ceil((high - low) / step_m) + 1)
    difference = (targets[:, None] - targets[None]) / HILL_M
    weights = np.linalg.solve(np.exp(-(difference**2).sum(axis=2)), height - height.mean())
    east = left + (np.arange(columns) + 0.5) * step_m
    north = top - (np.arange(rows) + 0.5) * step_m
    across, down = (
        np.exp(-(((a[:, None] - t) / HILL_M) ** 2)) for a, t in ((east, targets[:, 0]), (north, targets[:, 1]))
    )
    heights = height.mean() + (down * weights) @ across.T
    terrain = Terrain(float(left), float(top), step_m, heights.astype(np.float32), targets)
    _through(terrain, lon_lat_height)
    return terrain


def _through(terrain: Terrain, lon_lat_height: Array) -> None:
    """Shift the four cells about each point so that the bilinear surface meets it (points share no cells)."""
    cell = terrain.cells(lon_lat_height[:, 0], lon_lat_height[:, 1])
    (i, j), (u, v) = np.floor(cell).astype(int).T, (cell - np.floor(cell)).T
    z = terrain.heights_m
    found = (z[i, j] * (1 - v) + z[i, j + 1] * v) * (1 - u) + (z[i + 1, j] * (1 - v) + z[i + 1, j + 1] * v) * u
    shift = (lon_lat_height[:, 2] - found).astype(np.float32)
    for a in (0, 1):
        for b in (0, 1):
            z[i + a, j + b] += shift


def write_terrain(path: Path, terrain: Terrain) -> None:
    """Write the DEM as GeoTIFF.

    Raises
    ------
    InputError
        rasterio is not installed.
    """
    rasterio = rasterio_of(path)
    rows, columns = terrain.heights_m.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float32", crs=CRS,
        transform=rasterio.Affine(terrain.step_m, 0.0, terrain.left_m, 0.0, -terrain.step_m, terrain.top_m),
        tiled=True, blockxsize=256, blockysize=256, compress="deflate", predictor=3,
    ) as sink:  # fmt: skip
        sink.write(terrain.heights_m, 1)
