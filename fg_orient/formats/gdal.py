"""GDAL: rasterio imported on demand, and the letter case that GDAL expects.

GDAL compares names without regard to case by the C library, and so by the user's locale. In Turkish and Azerbaijani i
is not the small form of I: GDAL then takes its own options for unknown and writes dozens of lines to standard error.
It also leaves the decimal point of the program that it works in at that of "C" (seen with 3.12, writing a GeoPackage).
"""

from __future__ import annotations

import locale
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fg_orient.model.errors import InputError


def rasterio_of(file: object, code: str = "ortho.no_rasterio") -> Any:
    """Import rasterio.

    Parameters
    ----------
    file : path
        File that needs it, for the message.
    code : str
        Message if it is not installed.

    Raises
    ------
    InputError
        It is not installed.
    """
    try:
        import rasterio
        import rasterio.windows
    except ImportError as error:
        raise InputError.of(code, file=file) from error
    return rasterio


@contextmanager
def plain_case() -> Iterator[None]:
    """Classify letters as in the locale "C" while GDAL is imported or works; then the locale is as before."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)
