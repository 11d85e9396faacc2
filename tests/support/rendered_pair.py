"""numpy renders images of known geometry with relief, walls, blur, noise and another radiometry.

The models are affine RPC, so that rays are straight lines of (x, y) against the height and each step is a closed
formula that shares nothing with the code under test. x and y are metres East and North of the middle of the scene. The
surface is a raster, followed from above to its first intersection with a ray: hidden ground is not seen. Pixels are
means of point samples under a Gaussian point spread function with a modulation of 0.15 at the Nyquist frequency.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from scipy import ndimage

from fg_orient.formats.exchange.gis import write_geopackage
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.registry import Settings
from fg_orient.model.names import Role

#: Standard deviation of the point spread function: exp(-2 pi^2 s^2 / 4) = 0.15.
BLUR_PX = np.sqrt(2.0 * np.log(1.0 / 0.15)) / np.pi
#: Point samples along each side of a pixel; ground sampling distance, m.
SAMPLES, GSD_M = 4, 0.5
#: Middle of the scene, degrees; metres per degree there (of the models, not of the Earth).
LON, LAT = 5.3, 44.1
PER_LON, PER_LAT = 80_000.0, 111_000.0
MEAN_GREY = 500.0


@dataclass(frozen=True)
class View:
    """An image: metres of x, y per metre of height along its rays, size, and rotation of its axes."""

    name: str
    lean: tuple[float, float]
    size: int
    rotation_deg: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0
    offset: float = 0.0

    @property
    def matrix(self) -> np.ndarray:
        """Return the matrix of (line, sample) - middle = matrix (x, y) / GSD."""
        c, s = np.cos(np.radians(self.rotation_deg)), np.sin(np.radians(self.rotation_deg))
        return np.array([[-s, -c], [c, -s]])  # line against y, sample along x

    def project(self, x: np.ndarray, y: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Return the true pixels (n, 2) of ground points."""
        at = np.stack([x - self.lean[0] * h, y - self.lean[1] * h])
        return (self.matrix @ at / GSD_M).T + 0.5 * (self.size - 1)

    def ray(self, pixel: np.ndarray, h: np.ndarray) -> np.ndarray:
        """Return x and y (2, n) of pixels at heights."""
        at = self.matrix.T @ (pixel - 0.5 * (self.size - 1)).T * GSD_M
        return at + np.outer(self.lean, np.broadcast_to(h, len(pixel)))

    def write_rpc(self, folder: Path) -> None:
        """Write the model, wrong by ``shift_px``."""
        scale = 0.5 * self.size
        m = self.matrix / GSD_M
        metres = np.array([PER_LON * 0.01, PER_LAT * 0.01])
        terms = {}
        for k, name in enumerate(("LINE", "SAMP")):
            row = np.zeros(20)
            row[1:3] = m[k] * metres / scale  # L (longitude), P (latitude)
            row[3] = -(m[k] @ np.array(self.lean)) * 200.0 / scale
            terms[name] = row
        lines = []
        for k, name in enumerate(("LINE", "SAMP")):
            lines += [f"{name}_OFF: {0.5 * (self.size - 1) + self.shift_px[k]:.6f}", f"{name}_SCALE: {scale}"]
        lines += [
            f"LAT_OFF: {LAT}",
            "LAT_SCALE: 0.01",
            f"LONG_OFF: {LON}",
            "LONG_SCALE: 0.01",
            "HEIGHT_OFF: 0",
            "HEIGHT_SCALE: 200",
        ]
        for name, row in terms.items():
            lines += [f"{name}_NUM_COEFF_{i + 1}: {v:.15e}" for i, v in enumerate(row)]
            lines += [f"{name}_DEN_COEFF_{i + 1}: {float(i == 0)}" for i in range(20)]
        (folder / f"{self.name}_RPC.TXT").write_text("\n".join(lines) + "\n", encoding="utf-8")


class Scene:
    """A surface with hills, steps and a texture.

    Parameters
    ----------
    extent_m : float
        Half the width.
    seed : int
    relief_m : float
        Standard deviation of the hills.
    walls : int
        Number of blocks with vertical walls.
    """

    CELL_M = 0.25

    def __init__(self, extent_m: float, seed: int, relief_m: float = 8.0, walls: int = 12) -> None:
        rng = np.random.default_rng(seed)
        n = int(2 * extent_m / self.CELL_M)
        self.extent_m, self.n = extent_m, n
        frequency = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None]) / self.CELL_M  # per m
        frequency[0, 0] = 1.0

        def noise(power: float, shortest_m: float, longest_m: float) -> np.ndarray:
            spectrum = np.fft.rfft2(rng.standard_normal((n, n))) * frequency**-power
            spectrum[(frequency > 1.0 / shortest_m) | (frequency < 1.0 / longest_m)] = 0.0
            field = np.fft.irfft2(spectrum, s=(n, n))
            return field / field.std()

        self.heights = relief_m * noise(2.5, 10.0, 2.0 * extent_m)
        for _ in range(walls):
            i, j = rng.integers(0, n, 2)
            a, b = (rng.integers(12, 40, 2) / self.CELL_M).astype(int)
            self.heights[i : i + a, j : j + b] += rng.uniform(4.0, 10.0)
        self.texture = np.float32(np.clip(MEAN_GREY * (1.0 + 0.2 * noise(1.0, 0.5, 40.0)), 20.0, None))
        self.top_m, self.bottom_m = float(self.heights.max()), float(self.heights.min())

    def _cells(self, xy: np.ndarray) -> np.ndarray:
        return (xy + self.extent_m) / self.CELL_M - 0.5

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Return the heights (n,) at x and y (2, n), bilinear."""
        return np.asarray(ndimage.map_coordinates(self.heights, self._cells(xy), order=1, mode="nearest"))

    def write_dem(self, path: Path, step_m: float, error_m: float = 0.0) -> None:
        """Write heights of the surface on a grid of longitude and latitude."""
        every = round(step_m / self.CELL_M)
        heights = self.heights[every // 2 :: every, every // 2 :: every]  # x by rows, y by columns
        west, north = LON - self.extent_m / PER_LON, LAT + self.extent_m / PER_LAT
        transform = rasterio.Affine(step_m / PER_LON, 0.0, west, 0.0, -step_m / PER_LAT, north)
        with rasterio.open(path, "w", driver="GTiff", width=heights.shape[0], height=heights.shape[1], count=1,
                           dtype="float32", crs="EPSG:4326", transform=transform) as sink:  # fmt: skip
            sink.write(np.float32(heights.T[::-1] + error_m), 1)

    def write_chips(self, package: Path, xy: np.ndarray, half: int, rng: np.random.Generator) -> np.ndarray:
        """Write control points (2, n) of sigma 0.1 m as GeoPackage, and orthoimages about them; their heights (n,)."""
        survey = Survey(
            "EPSG:4979", tuple(f"g{k}" for k in range(xy.shape[1])), (Role.CONTROL,) * xy.shape[1],
            np.stack([LON + xy[0] / PER_LON, LAT + xy[1] / PER_LAT, self.height(xy)], axis=1),
            np.full((xy.shape[1], 3), 0.1), np.zeros(xy.shape[1], bool),
        )  # fmt: skip
        write_geopackage(survey, (package,), Settings())
        folder = package.with_suffix("")
        folder.mkdir()
        blurred = ndimage.gaussian_filter(self.texture, BLUR_PX * GSD_M / self.CELL_M)
        for name, (x, y) in zip(survey.ids, xy.T, strict=True):
            # the point lies at a random place in its pixel
            west, north = x - (half + rng.uniform(0.2, 0.8)) * GSD_M, y + (half + rng.uniform(0.2, 0.8)) * GSD_M
            step = (np.arange(2 * half + 1) + 0.5) * GSD_M
            at = np.stack([a.ravel() for a in np.meshgrid(west + step, north - step)])
            grey = ndimage.map_coordinates(blurred, self._cells(at), order=1).reshape(2 * half + 1, -1)
            transform = rasterio.Affine(GSD_M / PER_LON, 0.0, LON + west / PER_LON,
                                        0.0, -GSD_M / PER_LAT, LAT + north / PER_LAT)  # fmt: skip
            with rasterio.open(folder / f"{name}.tif", "w", driver="GTiff", width=grey.shape[1], height=grey.shape[0],
                               count=1, dtype="float32", crs="EPSG:4326", transform=transform) as sink:  # fmt: skip
                sink.write(np.float32(grey), 1)
        return self.height(xy)

    def meet(self, view: View, pixel: np.ndarray) -> np.ndarray:
        """Return the ground points (3, n) that pixels (n, 2) see: first intersections from above."""
        lean = max(float(np.hypot(*view.lean)), 0.05)
        step = 0.5 * self.CELL_M / lean
        level = np.full(len(pixel), self.top_m + step)
        going = np.arange(len(pixel))
        while len(going):
            level[going] -= step
            going = going[self.height(view.ray(pixel[going], level[going])) < level[going]]
        above, below = level + step, level
        for _ in range(24):
            middle = 0.5 * (above + below)
            under = self.height(view.ray(pixel, middle)) >= middle
            below, above = np.where(under, middle, below), np.where(under, above, middle)
        return np.vstack([view.ray(pixel, below), below])

    def render(self, view: View, snr: float, rng: np.random.Generator) -> np.ndarray:
        """Return the image (size, size) with noise of ``MEAN_GREY / snr``."""
        n = view.size * SAMPLES
        out = np.empty((n, n), np.float32)
        place = (np.arange(n) + 0.5) / SAMPLES - 0.5
        for first in range(0, n, 128):
            rows = place[first : first + 128]
            pixel = np.stack([a.ravel() for a in np.meshgrid(rows, place, indexing="ij")], axis=1)
            ground = self.meet(view, pixel)
            grey = ndimage.map_coordinates(self.texture, self._cells(ground[:2]), order=1, mode="nearest")
            out[first : first + 128] = grey.reshape(len(rows), n)
        blurred = ndimage.gaussian_filter(out, BLUR_PX * SAMPLES)
        image = blurred.reshape(view.size, SAMPLES, view.size, SAMPLES)[:, 1:3, :, 1:3].mean(axis=(1, 3))
        noisy = image + rng.normal(0.0, MEAN_GREY / snr, image.shape)
        return np.asarray(np.clip(np.rint(view.gain * noisy + view.offset), 1, 65535).astype(np.uint16))

    def seen(self, first: View, second: View, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return true pixels (n, 2) in the second image of pixels of the first, and whether they are visible."""
        ground = self.meet(first, pixel)
        there = second.project(*ground)
        again = self.meet(second, there)
        return there, np.linalg.norm(again - ground, axis=0) < 1.0


def write_raster(path: Path, pixels: np.ndarray) -> None:
    """Write a GeoTIFF without map coordinates."""
    rows, columns = pixels.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="uint16", tiled=True,
                           blockxsize=256, blockysize=256) as sink:  # fmt: skip
            sink.write(pixels, 1)


def read_raster(path: Path) -> np.ndarray:
    """Read the pixels of a GeoTIFF without map coordinates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path) as source:
            return np.asarray(source.read(1))


def write_pair(folder: Path, scene: Scene, views: tuple[View, ...], snr: float, seed: int = 7) -> Path:
    """Write images, models and a project without tables; returns the project file."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for view in views:
        image = scene.render(view, snr, rng)
        write_raster(folder / f"{view.name}.tif", image)
        view.write_rpc(folder)
    return write_project(folder, {view.name: f"{view.name}_RPC.TXT" for view in views})


def write_project(folder: Path, metadata: dict[str, str]) -> Path:
    """Write a project of images without tables."""
    lines = ["# rendered", "schema = 1", 'name = "rendered"']
    for name, file in metadata.items():
        lines += ["", "[[images]]", f'id = "{name}"', f'metadata = "{file}"']
    path = folder / "project.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_example(folder: Path) -> None:
    """Write the pair of the how-to page."""
    views = (View("a", (0.25, -0.05), 160), View("b", (-0.25, 0.1), 160, 4.0, (2.5, -1.5), 1.3, 40.0))
    scene, rng = Scene(75.0, 3, relief_m=5.0, walls=2), np.random.default_rng(8)
    write_pair(folder, scene, views, 50.0)
    scene.write_dem(folder / "dem.tif", 1.0)
    scene.write_chips(folder / "chips.gpkg", rng.uniform(-20.0, 20.0, (2, 9)), 20, rng)
