"""Check the limits of a raster after GDAL has opened its file and before it decodes a pixel.

To open a file, GDAL reads its directories. To read one pixel, GDAL allocates the table of all blocks
and decodes a whole block. Two examples (GDAL 3.10): a file of 274 bytes that states 2^31 lines and
samples took 8.6 GB and 29 s; a strip of 1.6 GB of zeros, compressed to 1.6 MB, took 1.6 GB.
"""

from __future__ import annotations

import html
import os
import re
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from fg_orient.model.errors import InputError
from fg_orient.model.limits import exceeded, limit, within, within_memory

#: Memory that GDAL needs for each block that it does not decode, bytes.
BLOCK_BYTES: Final = 24
#: For the first bytes of a TIFF or BigTIFF file: byte order, format of the number of entries of a
#: directory, bytes of an entry, format of the link to the next directory.
_TIFF: Final = {
    b"II*\0": ("<", "H", 12, "I"), b"MM\0*": (">", "H", 12, "I"),
    b"II+\0": ("<", "Q", 20, "Q"), b"MM\0+": (">", "Q", 20, "Q"),
}  # fmt: skip
#: Attributes and text of the elements of a virtual raster that name a file; attribute of a name relative to its folder.
_SOURCE: Final = re.compile(rb"<Source(?:Filename|Dataset)\b([^>]*)>([^<\0]*)</")
_BESIDE: Final = re.compile(rb"""relativeToVRT\s*=\s*["']1""", re.IGNORECASE)
#: Maximum number of virtual rasters that contain a file.
MAX_NESTED: Final = 32
#: Position in the file of the link to the first directory, by the format of the link.
_FIRST: Final = {"I": 4, "Q": 8}


def open_bounded(rasterio: Any, path: str | os.PathLike[str], mode: str = "r") -> Any:
    """Open a raster whose file and blocks do not exceed the limits.

    Parameters
    ----------
    rasterio : module
    path : path
    mode : str
        Mode of ``rasterio.open``.

    Raises
    ------
    InputError
        The raster exceeds a limit; or it is a virtual raster that contains itself or refers to a pipe or device.
        All other errors come from rasterio.
    """
    _require_bounded_file(path)
    _require_sources(Path(path), (), set())
    source = rasterio.open(path, mode)
    try:
        _require_bounded(rasterio, source, path)
    except BaseException:
        source.close()
        raise
    return source


def _require_bounded_file(path: str | os.PathLike[str]) -> None:
    """Raise InputError if a TIFF file has too many directories.

    Other and missing files are not read.
    """
    most, count = int(limit("tiff_directories")), 0
    if not Path(path).is_file():
        return
    with Path(path).open("rb") as stream:
        for count, _ in enumerate(_directories(stream), start=1):
            if count > most:
                raise exceeded("tiff_directories", f"more than {most}", file=os.fspath(path), unit="directories")


def _require_sources(path: Path, above: tuple[str, ...], done: set[str]) -> None:
    """Raise InputError if a virtual raster contains itself, is nested too deeply, or refers to a pipe or device.

    GDAL waits for a pipe without end. Missing files, other rasters and names with a prefix of GDAL are not read.

    Parameters
    ----------
    path : Path
    above : tuple of str
        Virtual rasters that contain this one, the outermost first.
    done : set of str
        Files that were examined. They are added.
    """
    name = os.path.realpath(path)
    if name in above or len(above) > MAX_NESTED:
        what = "itself" if name in above else f"more than {MAX_NESTED} nested virtual rasters"
        raise InputError.of("raster.source", file=above[0], value=path, what=what)
    if name in done or not path.exists():
        return
    done.add(name)
    if not path.is_file():
        if above and not path.is_dir():  # some formats are folders
            raise InputError.of("raster.source", file=above[-1], value=path, what="a pipe or device")
        return
    with path.open("rb") as stream:
        if b"<VRTDataset" not in stream.read(1024):
            return
        within("xml_bytes", path.stat().st_size, file=path)
        stream.seek(0)
        content = stream.read()
    for attributes, text in _SOURCE.findall(content):
        source = Path(html.unescape(text.decode("utf-8", "replace")).strip())
        _require_sources(path.parent / source if _BESIDE.search(attributes) else source, (*above, name), done)


def invertible(transform: Any) -> bool:
    """Return whether the geotransform of a raster can be inverted: cells with a size in the range of double numbers."""
    area = transform.determinant
    if not np.isfinite([*transform, area]).all() or transform.is_degenerate:
        return False
    return bool(np.isfinite([*~transform]).all())


def _directories(stream: BinaryIO) -> Iterator[int]:
    """Yield the position of each directory of a TIFF file, until the chain ends or leaves the file."""
    form = _TIFF.get(stream.read(4))
    if form is None:
        return
    order, number, entry, link = form
    at, width = _FIRST[link], struct.calcsize(link)
    while True:
        stream.seek(at)
        found = stream.read(width)
        if len(found) < width or not any(found):
            return
        (place,) = struct.unpack(order + link, found)
        if place >= 2**63:
            return
        stream.seek(place)
        found = stream.read(struct.calcsize(number))
        if len(found) < struct.calcsize(number):
            return
        yield place
        at = place + struct.calcsize(number) + entry * struct.unpack(order + number, found)[0]
        if at >= 2**63:
            return


def _require_bounded(rasterio: Any, source: Any, path: str | os.PathLike[str]) -> None:
    """Raise InputError if a raster has too many pixels, or its blocks are too many or too large for its file.

    Parameters
    ----------
    rasterio : module
    source : dataset of rasterio
        Raster that is open for reading. The rasters of a virtual raster are opened, too, because it
        does not state their blocks.
    path : path
        Its file.
    """
    rows, columns, n_bands = source.height, source.width, source.count
    place = f"{rows} x {columns} pixels"
    within("raster_pixels", float(rows) * columns, file=path, unit="pixels")
    if not n_bands or not Path(path).is_file():
        return
    size = Path(path).stat().st_size
    down, across = source.block_shapes[0]
    n_blocks = -(-rows // down) * -(-columns // across) * n_bands
    kind = source.dtypes[0]
    item = 16 if kind.startswith("complex") else np.dtype(kind).itemsize
    is_mixed = n_bands > 1 and getattr(source.interleaving, "name", "") != "band"  # bands are decoded together
    block = float(down) * across * item * (2 * n_bands if is_mixed else 1)
    within_memory(BLOCK_BYTES * float(n_blocks) + block, size, file=path, place=place)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        for one in source.files[1:] if source.driver == "VRT" else ():
            if one.lower().endswith((".tif", ".tiff", ".vrt")):
                open_bounded(rasterio, one).close()
