"""Read pixels of the images: find the raster of an image, read windows of it, or read a reduced picture.

The whole raster is never in memory. Pixels are (line, sample) of the sensor. A raster may
be only a part of the scene. Its first pixel then has an offset. The geotransform of the
file gives the offset if it has pixel size 1 and no CRS.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.gdal import opened, rasterio_of
from fg_orient.model.errors import InputError, finding

Grey = npt.NDArray[np.float32]
#: Suffixes of raster files.
ENDS: Final = (".tif", ".tiff", ".ntf", ".jp2", ".vrt", ".img", ".png", ".jpg", ".jpeg")
#: A metadata file may have the name of its raster plus one of these endings.
_METADATA_ENDS: Final = ("_rpc", ".rpc", "_rpb", "_metadata")
#: Size of GDAL's cache for blocks of a file, bytes.
CACHE_BYTES: Final = 32_000_000


def raster_beside(metadata: Path) -> Path | None:
    """Find the raster of a metadata file; None if it is not unique.

    The raster is the file itself, or the only raster with the same name in the same folder.
    """
    if metadata.suffix.lower() in ENDS:
        return metadata
    folder = metadata.parent
    if not folder.is_dir():
        return None
    rasters = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in ENDS and path.is_file()]
    if metadata.name.upper() == "METADATA.DIM":
        named = [path for path in rasters if path.stem.upper() == "IMAGERY"]
    else:
        stem = metadata.stem
        stems = {stem.casefold()}
        stems |= {stem[: -len(end)].casefold() for end in _METADATA_ENDS if stem.lower().endswith(end)}
        stems |= {f"img_{stem[4:]}".casefold() for start in ("dim_", "rpc_") if stem.lower().startswith(start)}
        named = [p for p in rasters if p.stem.casefold() in stems or p.stem.casefold().startswith(
            tuple(f"{s}_r1c1" for s in stems))]  # fmt: skip
    return named[0] if len(named) == 1 else None


@dataclass(frozen=True)
class Place:
    """Size of a raster and its position in the scene.

    Parameters
    ----------
    path : str
    line, sample : float
        Line and sample of the sensor at the centre of the first pixel of the raster.
    rows, columns : int
    nodata : float or None
        Value of empty pixels; 0 if the file does not state it.
    """

    path: str
    line: float
    sample: float
    rows: int
    columns: int
    nodata: float | None

    @property
    def centre(self) -> tuple[float, float]:
        """Return line and sample at the middle of the raster."""
        return self.line + 0.5 * (self.rows - 1), self.sample + 0.5 * (self.columns - 1)


def place_of(path: Path, origin: tuple[float, float] | None, image: str, project: str) -> Place:
    """Read the size and position of a raster.

    Raises
    ------
    InputError
        The package rasterio is not installed, or the file cannot be read.
    """
    rasterio = rasterio_of(path, "match.no_rasterio")
    try:
        with opened(rasterio, path) as source:
            t, crs, nodata = source.transform, source.crs, source.nodata
            rows, columns, kind = source.height, source.width, np.dtype(source.dtypes[0]).kind
    except rasterio.errors.RasterioError as error:
        raise InputError.of("match.pixels", file=project, place=f"image {image}", value=path, reason=error) from None
    if kind not in "iuf":
        raise InputError.of("match.pixels", file=project, place=f"image {image}", value=path, reason=f"kind {kind}")
    if origin is None:
        part = crs is None and (t.a, t.b, t.d, t.e) == (1.0, 0.0, 0.0, 1.0)
        origin = (float(t.f), float(t.c)) if part else (0.0, 0.0)
    return Place(str(path), *origin, rows, columns, 0.0 if nodata is None else float(nodata))


class Raster:
    """Raster from which windows are read; each process opens the file once."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self._rasterio = rasterio_of(place.path, "match.no_rasterio")
        self._env = self._rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES)
        with self._reading():
            self._source = opened(self._rasterio, place.path)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Convert errors of GDAL to InputError, and limit its cache."""
        try:
            with self._env:
                yield
        except self._rasterio.errors.RasterioError as error:
            reason = error.__cause__ or error
            raise InputError.of("match.pixels", file=self.place.path, reason=reason) from error

    def window(self, row: int, column: int, rows: int, columns: int) -> Grey:
        """Read grey values (rows, columns) from a first pixel on.

        Pixels outside the raster or without data are nan.
        """
        out = np.full((rows, columns), np.nan, np.float32)
        top, left = max(row, 0), max(column, 0)
        bottom, right = min(row + rows, self.place.rows), min(column + columns, self.place.columns)
        if bottom > top and right > left:
            window = self._rasterio.windows.Window(left, top, right - left, bottom - top)
            with self._reading():
                values = self._source.read(1, window=window, out_dtype="float32")
            out[top - row : bottom - row, left - column : right - column] = self._clean(values)
        return out

    def reduced(self, factor: int) -> Grey:
        """Return the whole raster as means of ``factor`` x ``factor`` pixels, without incomplete means at its ends."""
        rows, columns = self.place.rows // factor, self.place.columns // factor
        out = np.empty((rows, columns), np.float32)
        strip = max(1, 2_000_000 // (self.place.columns * factor))
        for first in range(0, rows, strip):
            n = min(strip, rows - first)
            values = self.window(first * factor, 0, n * factor, columns * factor)
            out[first : first + n] = values.reshape(n, factor, columns, factor).mean(axis=(1, 3))
        return out

    def decoded(self, factor: float) -> float:
        """Return how many pixels must be decoded for a picture that is reduced by a factor.

        The number is the size of the overview that is used.
        """
        overview = max((f for f in self._source.overviews(1) if f <= factor), default=1)
        return self.place.rows * self.place.columns / overview**2

    def decimated(self, rows: int, columns: int) -> Grey:
        """Return a picture of the whole raster with few pixels.

        Use the overviews of the file if there are any.
        """
        average = self._rasterio.enums.Resampling.average
        with self._reading():
            values = self._source.read(1, out_shape=(rows, columns), out_dtype="float32", resampling=average)
        return np.asarray(self._clean(values))

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def _clean(self, values: Any) -> Any:
        if self.place.nodata is not None and np.isfinite(self.place.nodata):
            values[values == np.float32(self.place.nodata)] = np.nan
        return values


def missing(image: str, project: str, metadata: Path) -> Any:
    """Return the finding that an image has no pixels."""
    return finding("match.no_pixels", file=project, place=f"image {image}", value=metadata)
