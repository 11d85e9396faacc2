"""GeoTIFF files written whole or not at all, window by window."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from fg_orient.formats import atomic
from fg_orient.model.errors import InputError
from fg_orient.rectification.grid import MapGrid

#: Edge of the tiles inside a file.
TILE: Final = 512
#: Cache of GDAL for blocks of files, bytes: else it takes 5 % of the machine.
CACHE_BYTES: Final = 128 * 2**20


@contextlib.contextmanager
def staged_file(out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Give a hidden name beside ``out`` that is renamed to it if the block ends well, else removed.

    Raises
    ------
    InputError
        ``out`` exists (without ``overwrite``), or cannot be written.
    """
    if out.exists() and not overwrite:
        raise InputError.of("output.exists", file=out, option="out")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError.of("output.unwritable", file=out, option="out")
    with atomic.staged_file(out, place="<out>", suffix=".tif") as temporary:
        yield temporary


def profile(grid: MapGrid, *, bands: int, dtype: str, nodata: float | None, compress: str) -> dict[str, Any]:
    """Creation options of a tiled GeoTIFF on a map grid."""
    return {
        "driver": "GTiff", "width": grid.columns, "height": grid.rows, "count": bands, "dtype": dtype,
        "crs": grid.crs, "transform": grid.transform(), "nodata": nodata, "tiled": True, "blockxsize": TILE,
        "blockysize": TILE, "compress": compress, "interleave": "band", "BIGTIFF": "IF_SAFER",
    }  # fmt: skip


def as_cog(source: Path, target: Path, compress: str) -> None:
    """Copy a GeoTIFF into a cloud optimised one, with overviews."""
    from rasterio.shutil import copy

    copy(source, target, driver="COG", compress=compress, blocksize=TILE, overviews="AUTO")
