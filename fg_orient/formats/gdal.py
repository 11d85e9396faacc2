"""GDAL: rasterio imported on demand, and the locale that GDAL needs.

GDAL compares names without regard to case by the C library, and so by the user's locale. In Turkish and Azerbaijani, i
is not the lower case of I: GDAL then does not recognise its own options and writes dozens of lines to standard error.
It also resets the decimal point of the calling program to the "C" locale (seen with 3.12, writing a GeoPackage).
"""

from __future__ import annotations

import errno
import locale
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from filecmp import cmp
from importlib import import_module
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from fg_orient.model.errors import InputError

#: First bytes of TIFF and BigTIFF files in both byte orders.
TIFF_MARKS: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def rasterio_of(file: object, code: str = "ortho.no_rasterio") -> Any:
    """Import rasterio; InputError with this ``code`` for ``file``, which needs it, if it is not installed."""
    try:
        import rasterio
        import rasterio.windows
    except ImportError as error:
        raise InputError.of(code, file=file) from error
    return rasterio


def opened(rasterio: Any, path: object, mode: str = "r") -> Any:
    """Open an image without GDAL's warning that it has no map coordinates; errors are errors of rasterio."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        return rasterio.open(path, mode)


class Written:
    """Raster that is being written, with the checksums of its windows: GDAL does not report every failed call.

    Parameters
    ----------
    rasterio : module
    sink : dataset
        Opened to be written.
    """

    def __init__(self, rasterio: Any, sink: Any) -> None:
        self._rasterio, self._sink = rasterio, sink
        self._sums: list[tuple[int, Any, int]] = []

    def write(self, values: Any, band: int, window: Any) -> None:
        """Write a window of a band; no window is written twice."""
        self._sums.append((band, window, crc32(values.tobytes())))
        self._sink.write(values, band, window=window)

    def require(self, path: Path) -> None:
        """Read the windows again, from this file or a copy; OSError if a value differs."""
        with opened(self._rasterio, path) as source:
            for band, window, known in self._sums:
                if crc32(source.read(band, window=window).tobytes()) != known:
                    raise OSError(errno.EIO, "the written pixels differ: the disk is full or damaged")


def copy_as_cog(rasterio: Any, source: Path, target: Path, written: Written, **options: Any) -> None:
    """Copy a raster into a cloud optimised GeoTIFF; OSError if a part of it is not as it should be.

    The overviews have no checksums: the file is made twice, and both must be equal.
    """
    copy, second = import_module("rasterio.shutil").copy, target.with_suffix(".second.tif")
    try:
        for path in (target, second):
            copy(source, path, driver="COG", **options)
        written.require(target)
        if not cmp(target, second, shallow=False):
            raise OSError(errno.EIO, "the written pixels differ: the disk is full or damaged")
    finally:
        second.unlink(missing_ok=True)


def encoded(picture: Any, driver: str) -> bytes:
    """File of grey values (rows, columns) uint8 in memory, by GDAL's driver ``PNG`` or ``JPEG``."""
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.io import MemoryFile

    rows, columns = picture.shape
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(driver=driver, width=columns, height=rows, count=1, dtype="uint8") as sink:
            sink.write(picture, 1)
        return bytes(memory.getbuffer())


@contextmanager
def plain_case() -> Iterator[None]:
    """Use the letter case of the locale "C" while GDAL is imported or works; then restore the locale."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)
