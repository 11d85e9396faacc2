"""GDAL: rasterio imported on demand, and the locale that GDAL needs.

GDAL compares names without regard to case by the C library, and so by the user's locale. In Turkish and Azerbaijani, i
is not the lower case of I: GDAL then does not recognise its own options and writes dozens of lines to standard error.
It also resets the decimal point of the calling program to that of "C" (seen with 3.12, writing a GeoPackage).
"""

from __future__ import annotations

import locale
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fg_orient.model.errors import InputError


def rasterio_of(file: object, code: str = "ortho.no_rasterio") -> Any:
    """Import rasterio; InputError with this ``code`` for ``file``, which needs it, if it is not installed."""
    try:
        import rasterio
        import rasterio.windows
    except ImportError as error:
        raise InputError.of(code, file=file) from error
    return rasterio


@contextmanager
def plain_case() -> Iterator[None]:
    """Use the letter case of the locale "C" while GDAL is imported or works; then restore the locale."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)
