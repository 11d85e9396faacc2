"""Map rasters: their grid, and GeoTIFF files written whole or not at all, window by window."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats import atomic
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, positive

Array = npt.NDArray[np.float64]
Bounds = tuple[float, float, float, float]

#: Maximum number of pixels along an axis; with more the resolution has the wrong unit.
LARGEST: Final = 1_000_000
#: Edge of the tiles inside a file.
TILE: Final = 512
#: Size of GDAL's cache for blocks of files, bytes; GDAL's default is 5 % of the memory.
CACHE_BYTES: Final = 128 * 2**20


@dataclass(frozen=True)
class MapGrid:
    """A north-up raster of square pixels.

    Parameters
    ----------
    crs : str
        WKT of its coordinate system.
    left, top : float
        Corner of the first pixel (not its centre), units of the CRS.
    resolution : float
        Size of a pixel.
    rows, columns : int
    """

    crs: str
    left: float
    top: float
    resolution: float
    rows: int
    columns: int

    @classmethod
    def over(cls, bounds: Bounds, resolution: float, crs: str) -> MapGrid:
        """Grid over bounds (left, bottom, right, top), widened to whole multiples of the resolution.

        Raises
        ------
        InputError
            Bounds without area, a resolution that is not above 0, or more than a million pixels along an axis.
        """
        if finite("<bounds>", bounds).shape != (4,):
            raise InputError.of("rectify.numbers", option="bounds", value=f"{len(bounds)} numbers")
        left, bottom, right, top = bounds
        positive("<resolution>", resolution, "units of the map")
        sides = right - left, top - bottom
        if not all(math.isfinite(side) and 0.0 < side <= LARGEST * resolution for side in sides):
            raise InputError.of("ortho.grid", option="bounds, resolution", value=f"{sides[0]:g} x {sides[1]:g}",
                                resolution=resolution, most=LARGEST)  # fmt: skip
        # bounds given as multiples must not gain a pixel by rounding
        west, south = (math.floor(v / resolution + 1e-6) for v in (left, bottom))
        east, north = (math.ceil(v / resolution - 1e-6) for v in (right, top))
        return cls(crs, west * resolution, north * resolution, resolution, north - south, east - west)

    def centres(self, row: npt.ArrayLike, column: npt.ArrayLike) -> tuple[Array, Array]:
        """Map coordinates x, y of pixel centres; fractions allowed."""
        x = self.left + (np.asarray(column, float) + 0.5) * self.resolution
        return np.asarray(x), np.asarray(self.top - (np.asarray(row, float) + 0.5) * self.resolution)

    @property
    def bounds(self) -> Bounds:
        """Left, bottom, right, top."""
        bottom, right = self.top - self.rows * self.resolution, self.left + self.columns * self.resolution
        return self.left, bottom, right, self.top

    def profile(self, *, bands: int, dtype: str, nodata: float | None, compress: str) -> dict[str, Any]:
        """Creation options of a tiled GeoTIFF on this grid."""
        from rasterio import Affine

        corners = Affine(self.resolution, 0.0, self.left, 0.0, -self.resolution, self.top)
        return {
            "driver": "GTiff", "width": self.columns, "height": self.rows, "count": bands, "dtype": dtype,
            "crs": self.crs, "transform": corners, "nodata": nodata, "tiled": True, "blockxsize": TILE,
            "blockysize": TILE, "compress": compress, "interleave": "band", "BIGTIFF": "IF_SAFER",
        }  # fmt: skip


@contextlib.contextmanager
def staged_file(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Temporary file beside ``out`` that is renamed to it if the block ends without an exception, else removed.

    Raises
    ------
    InputError
        ``out`` exists (without ``overwrite``), or cannot be written.
    """
    atomic.require_free_files(out, overwrite=overwrite)
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError.of("output.unwritable", file=out, option="out")
    with atomic.staged_file(out, place="<out>", suffix=".tif") as temporary:
        yield temporary
