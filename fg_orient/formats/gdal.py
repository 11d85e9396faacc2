"""Import rasterio (GDAL) on demand, set the locale that GDAL needs, and check the files that it writes.

GDAL ignores upper and lower case when it compares names. It uses the C library for this,
which follows the user's locale. In Turkish and Azerbaijani, i is not the lower case of I.
GDAL then does not recognise its own options and writes dozens of lines to standard error.
GDAL also resets the decimal point of the calling program to the "C" locale (observed with
version 3.12 when a GeoPackage is written).
"""

from __future__ import annotations

import contextlib
import errno
import locale
import os
import sqlite3
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from filecmp import cmp
from importlib import import_module
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from fg_orient.model.errors import InputError
from fg_orient.model.raster_limits import open_bounded

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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        return open_bounded(rasterio, path, mode)


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


def require_layers(path: Path, layers: Mapping[str, tuple[int, int]]) -> None:
    """Read back what GDAL wrote to a GeoPackage: it ignores failed writes of CRS, extent, count and index.

    Parameters
    ----------
    path : Path
    layers : mapping of str to (int, int)
        Number of rows and number of geometries of each layer.

    Raises
    ------
    OSError
        A layer is not complete.
    """
    with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        for layer, (rows, geometries) in layers.items():
            try:
                whole = _is_counted(database, layer, rows) and (
                    not geometries or _is_indexed(database, layer, geometries)
                )
            except (sqlite3.Error, TypeError):  # TypeError: a row is missing
                whole = False
            if not whole:
                raise OSError(errno.EIO, f"GDAL has not written all of layer {layer}")


def _one(database: sqlite3.Connection, query: str, *values: str) -> Any:
    """Single value of a query; TypeError if it has no row."""
    return database.execute(query, values).fetchone()[0]


def _has(database: sqlite3.Connection, *names: str) -> bool:
    """Whether a database has tables or triggers of all these names."""
    return all(_one(database, "SELECT count(*) FROM sqlite_master WHERE name = ?", name) for name in names)


def _rows(database: sqlite3.Connection, table: str) -> Any:
    quoted = table.replace('"', '""')
    return _one(database, f'SELECT count(*) FROM "{quoted}"')


def _is_counted(database: sqlite3.Connection, layer: str, rows: int) -> bool:
    """Whether a layer has this number of rows, in its table and as written, and the triggers that keep the number."""
    counted = _one(database, "SELECT feature_count FROM gpkg_ogr_contents WHERE table_name = ?", layer)
    triggers = (f"trigger_{event}_feature_count_{layer}" for event in ("insert", "delete"))
    return bool(_rows(database, layer) == counted == rows and _has(database, *triggers))


def _is_indexed(database: sqlite3.Connection, layer: str, geometries: int) -> bool:
    """Whether CRS and extent of a layer and its spatial index, with the triggers that keep it, are complete."""
    column = _one(database, "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?", layer)
    index = f"rtree_{layer}_{column}"
    extent = "SELECT count(min_x + min_y + max_x + max_y) FROM gpkg_contents WHERE table_name = ?"
    crs = "SELECT count(*) FROM gpkg_geometry_columns JOIN gpkg_spatial_ref_sys USING (srs_id) WHERE table_name = ?"
    named = "SELECT count(*) FROM gpkg_extensions WHERE table_name = ? AND extension_name = 'gpkg_rtree_index'"
    return bool(
        _one(database, extent, layer) == _one(database, crs, layer) == _one(database, named, layer) == 1
        and _has(database, index, f"{index}_insert", f"{index}_delete")
        and _rows(database, f"{index}_rowid") == geometries
    )
