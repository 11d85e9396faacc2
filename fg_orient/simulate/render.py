"""Terrain and images of the synthetic Zonguldak block.

The terrain is the mean height of the points plus Gaussian hills (one per point, standard width 2.5 km), such that the
surface contains all points. The bilinear surface of the DEM contains the points within the rounding of its values
(float32), because the four cells around each point are corrected for this rounding.

Images are rendered by ray tracing with the true orientation: the ray of every pixel corner is intersected with the
terrain. The texture of the ground (smooth noise; at every point a bright disc in a dark ring) is averaged over 4 x 4
positions in each pixel. Rendering uses image to ground only; rectification uses ground to image.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.gdal import Written, rasterio_of
from fg_orient.geodesy import ecef_to_geodetic, from_geographic
from fg_orient.kernels.rendering import RAY, TO_MAP, corners, expose
from fg_orient.kernels.resampling import SCALING
from fg_orient.model.names import Progress
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.options import require
from fg_orient.simulate.scene import as_read
from fg_orient.simulate.simulation import Simulation

#: UTM zone 36 north, which contains the synthetic block.
CRS: Final = "EPSG:32636"
STEP_M: Final = 30.0
#: Distance from the summit at which the height of a hill is 1/e.
HILL_M: Final = 3500.0
#: Width of the terrain around the box of the points: extent of the images at 20 degrees from 832 km.
BORDER_M: Final = 15_000.0


@dataclass(frozen=True, eq=False)
class Terrain:
    """DEM in UTM, heights above the ellipsoid.

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
        """Return the row and column (n, 2), whole numbers at centres of cells."""
        x, y = from_geographic(CRS, lon_deg, lat_deg)
        return np.stack([(self.top_m - y) / self.step_m - 0.5, (x - self.left_m) / self.step_m - 0.5], axis=1)


def terrain_through(lon_lat_height: Array, *, step_m: float = STEP_M) -> Terrain:
    """Return the terrain through points (n, 3) longitude, latitude (degrees), height (m)."""
    targets = np.stack(from_geographic(CRS, lon_lat_height[:, 0], lon_lat_height[:, 1]), axis=1)
    height = lon_lat_height[:, 2]
    low, high = targets.min(axis=0) - BORDER_M, targets.max(axis=0) + BORDER_M
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
    """Shift the four cells around each point so that the bilinear surface contains it (points share no cells)."""
    cell = terrain.cells(lon_lat_height[:, 0], lon_lat_height[:, 1])
    (i, j), (u, v) = np.floor(cell).astype(int).T, (cell - np.floor(cell)).T
    z = terrain.heights_m
    surface = (z[i, j] * (1 - v) + z[i, j + 1] * v) * (1 - u) + (z[i + 1, j] * (1 - v) + z[i + 1, j + 1] * v) * u
    shift = (lon_lat_height[:, 2] - surface).astype(np.float32)
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
        path,
        "w",
        driver="GTiff",
        width=columns,
        height=rows,
        count=1,
        dtype="float32",
        crs=CRS,
        transform=rasterio.Affine(terrain.step_m, 0.0, terrain.left_m, 0.0, -terrain.step_m, terrain.top_m),
        tiled=True, blockxsize=256, blockysize=256, compress="deflate", predictor=3,
    ) as sink:  # fmt: skip
        written = Written(rasterio, sink)
        written.write(terrain.heights_m, 1, rasterio.windows.Window(0, 0, columns, rows))
    written.require(path)


DEM_FILE: Final = "dem.tif"
#: Number of intervals between knots along an image axis. An interval has 75 of 12000 pixels,
#: and bilinear interpolation has errors of 0.003 px.
INTERVALS: Final = 160
#: Edge of the blocks and tiles, pixels.
BLOCK: Final = 512
#: Radii of disc and ring, m on the map: 2.5 and 6 pixels of 5 m.
RADII_M: Final = (12.5, 30.0)


@dataclass(frozen=True)
class RasterOptions:
    """Rasters of the synthetic Zonguldak block.

    Parameters
    ----------
    images : bool
        Render the images; otherwise only the DEM is written.
    window_px : int
        Render only a square of this size around every point; 0: the whole images.
    dem_step_m : float
        Edge of the DEM's cells.

    Raises
    ------
    InputError
        A size that is negative or beyond the image, cells that are too small or too large.
    """

    images: bool = True
    window_px: int = 0
    dem_step_m: float = STEP_M

    def __post_init__(self) -> None:
        require(0 <= self.window_px <= 12000, "raster_window", self.window_px, "0 (whole images) to 12000 px")
        require(10.0 <= self.dem_step_m <= 200.0, "dem_step", self.dem_step_m, "10 to 200 m")


class Renderer:
    """True geometry of one image over a terrain.

    Parameters
    ----------
    sensor : PushbroomSensor
    correction : Correction
        True minus metadata.
    terrain : Terrain
    """

    def __init__(self, sensor: PushbroomSensor, correction: Correction, terrain: Terrain) -> None:
        self._terrain, self._heights = terrain, terrain.heights_m.astype(float)
        low, high = float(self._heights.min()), float(self._heights.max())
        self._scaling = SCALING.pack(offset=0.5 * (low + high), scale=0.5 * (high - low) + 1.0)
        size = sensor.n_lines, sensor.n_samples
        self._step = np.array(size) / INTERVALS
        line, sample = (
            a.ravel() for a in np.meshgrid(*(np.linspace(-0.5, n - 0.5, INTERVALS + 1) for n in size), indexing="ij")
        )
        cells = []
        for t in (-1.0, 0.0, 1.0):
            height = float(self._scaling[SCALING.offset] + t * self._scaling[SCALING.scale])
            ground = sensor.locate(line, sample, height_m=height, correction=correction)
            lon, lat, _ = ecef_to_geodetic(ground)
            cells.append(terrain.cells(lon, lat))
        below, middle, above = cells
        knots = np.stack([middle, 0.5 * (above - below), 0.5 * (above + below) - middle], axis=2)
        self._knots = np.ascontiguousarray(knots.reshape(INTERVALS + 1, INTERVALS + 1, RAY.size))

    def cells(self, line: int, sample: int, rows: int, columns: int) -> Array:
        """Return cells (rows + 1, columns + 1, 2) of the terrain, row and column, at pixel corners; nan outside it."""
        out = np.empty((rows + 1, columns + 1, 2))
        corners(line, sample, self._step, self._knots, self._heights, self._scaling, out)
        return out

    def render(self, line: int, sample: int, rows: int, columns: int) -> npt.NDArray[np.uint8]:
        """Return grey values (rows, columns) of a block; 0 outside the terrain."""
        t, out = self._terrain, np.empty((rows, columns), np.uint8)
        to_map = TO_MAP.pack(x=t.left_m + 0.5 * t.step_m, y=t.top_m - 0.5 * t.step_m, cell=t.step_m)
        expose(self.cells(line, sample, rows, columns), to_map, t.targets_m, np.array(RADII_M), out)
        return out


def write_rasters(
    folder: Path, simulation: Simulation, options: RasterOptions, progress: Progress | None = None
) -> None:
    """Write ``dem.tif`` and ``<image>.tif`` of a simulated pair into its folder.

    Raises
    ------
    InputError
        rasterio is not installed.
    """
    terrain = terrain_through(simulation.truth.lon_lat_height, step_m=options.dem_step_m)
    write_terrain(folder / DEM_FILE, terrain)
    if not options.images:
        return
    for k, (name, written, correction) in enumerate(
        zip(simulation.truth.image_ids, simulation.metadata, simulation.truth.corrections, strict=True)
    ):
        sensor = as_read(written)
        pixels = simulation.truth.pixels[simulation.image == k]
        places = _places(pixels, sensor, options.window_px)
        _write_image(folder / f"{name}.tif", Renderer(sensor, correction, terrain), sensor, places, progress)


def _places(pixels: Array, sensor: PushbroomSensor, window_px: int) -> list[tuple[int, int, int, int]]:
    """Return the squares to render: first line and sample, number of lines and samples."""
    size = np.array([sensor.n_lines, sensor.n_samples])
    if window_px:
        first = np.clip(np.rint(pixels).astype(int) - window_px // 2, 0, size - window_px)
        return [(int(line), int(sample), window_px, window_px) for line, sample in first]
    return [
        (line, sample, min(BLOCK, sensor.n_lines - line), min(BLOCK, sensor.n_samples - sample))
        for line in range(0, sensor.n_lines, BLOCK)
        for sample in range(0, sensor.n_samples, BLOCK)
    ]


def _write_image(
    path: Path,
    renderer: Renderer,
    sensor: PushbroomSensor,
    places: list[tuple[int, int, int, int]],
    progress: Progress | None,
) -> None:
    """Write the blocks; other pixels remain 0 (nodata) and are not stored."""
    rasterio = rasterio_of(path)
    settings = {
        "driver": "GTiff",
        "width": sensor.n_samples,
        "height": sensor.n_lines,
        "count": 1,
        "dtype": "uint8",
        "nodata": 0,
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "compress": "deflate",
        "SPARSE_OK": True,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", **settings) as sink:
            for done, (line, sample, rows, columns) in enumerate(places):
                if progress is not None:
                    progress(done, len(places), path.name)
                window = rasterio.windows.Window(sample, line, columns, rows)
                sink.write(renderer.render(line, sample, rows, columns), 1, window=window)
