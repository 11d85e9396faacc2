"""Upper and lower case as GDAL expects them.

GDAL compares names without regard to case by the C library, and so by the user's locale. In Turkish and Azerbaijani i
is not the small form of I: GDAL then takes its own options for unknown and writes dozens of lines to standard error.
It also leaves the decimal point of the program that it works in at that of "C" (seen with 3.12, writing a GeoPackage).
"""

from __future__ import annotations

import locale
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def plain_case() -> Iterator[None]:
    """Classify letters as in the locale "C" while GDAL is imported or works; then the locale is as before."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_CTYPE, "C")
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)
