"""GDAL: rasterio imported on demand, and the locale that GDAL needs.

GDAL compares names without regard to case by the C library, and so by the user's locale. In Turkish and Azerbaijani, i
is not the lower case of I: GDAL then does not recognise its own options and writes dozens of lines to standard error.
It also resets the decimal point of the calling program to the "C" locale (seen with 3.12, writing a GeoPackage).
"""

from __future__ import annotations

import locale
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

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
