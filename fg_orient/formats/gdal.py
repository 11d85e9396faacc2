"""Import rasterio (GDAL) on demand, set the locale that GDAL needs, and check the files that it writes.

GDAL ignores upper and lower case when it compares names. It uses the C library for this,
which follows the user's locale. In Turkish and Azerbaijani, i is not the lower case of I.
GDAL then does not recognise its own options and writes dozens of lines to standard error.
GDAL also resets the decimal point of the calling program to the "C" locale (observed with
version 3.12 when a GeoPackage is written).
"""

from __future__ import annotations

import errno
import locale
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from filecmp import cmp
from importlib import import_module
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from fg_orient.model.errors import InputError
from fg_orient.model.raster_limits import require_bounded, require_bounded_file

#: TIFF and BigTIFF files begin with one of these, depending on the byte order.
TIFF_MARKS: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def rasterio_of(file: object, code: str = "ortho.no_rasterio") -> Any:
    """Import rasterio.

    If it is not installed, raise InputError with this ``code`` for the ``file`` that needs it.
    """
    try:
        import rasterio
        import rasterio.windows
    except ImportError as error:
        raise InputError.of(code, file=file) from error
    return rasterio


def opened(rasterio: Any, path: str | os.PathLike[str], mode: str = "r") -> Any:
    """Open an image.

    GDAL's warning about missing map coordinates is not shown; errors are exceptions of rasterio.

    Raises
    ------
    InputError
        The file exceeds a limit (:mod:`fg_orient.model.raster_limits`).
    """
    require_bounded_file(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        source = rasterio.open(path, mode)
        try:
            require_bounded(rasterio, source, path)
        except BaseException:
            source.close()
            raise
    return source


class Written:
    """Raster that is being written, with a checksum of each window.

    GDAL does not report every failed call. Therefore the windows are read again and compared.

    Parameters
    ----------
    rasterio : module
    sink : dataset
        Dataset that is open for writing.
    """

    def __init__(self, rasterio: Any, sink: Any) -> None:
        self._rasterio, self._sink = rasterio, sink
        self._sums: list[tuple[int, Any, int]] = []

    def write(self, values: Any, band: int, window: Any) -> None:
        """Write a window of a band. A window must not be written twice."""
        self._sums.append((band, window, crc32(values.tobytes())))
        self._sink.write(values, band, window=window)

    def require(self, path: Path) -> None:
        """Read all windows again from this file or from a copy of it.

        Raise OSError if a value differs.
        """
        with opened(self._rasterio, path) as source:
            for band, window, known in self._sums:
                if crc32(source.read(band, window=window).tobytes()) != known:
                    raise OSError(errno.EIO, "the written pixels differ: the disk is full or damaged")


def copy_as_cog(rasterio: Any, source: Path, target: Path, written: Written, **options: Any) -> None:
    """Copy a raster to a cloud optimised GeoTIFF; raise OSError if the copy is not correct.

    The overviews have no checksums. Therefore the file is made twice, and both files must be equal.
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
    """Return the bytes of a PNG or JPEG file with grey values (rows, columns) uint8.

    GDAL encodes them in memory.
    """
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
    """Use the letter case rules of the locale "C" while GDAL is imported or runs.

    Then restore the locale.
    """
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)
