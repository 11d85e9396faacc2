"""RPC files: what a file is, by its content, and which reader and writer take it.

One table holds every format; a new one is a module and a line here.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fg_orient.formats import rpc_dimap, rpc_dimap_write, rpc_geom, rpc_raster, rpc_rpb, rpc_text, rpc_vrt
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.rpc_fields import USUAL_ORDER, Reading, read_bytes
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

#: Bytes in which a file shows what it is.
HEAD_BYTES: Final = 2**16
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_ROOT = re.compile(r"<([A-Za-z_][\w.-]*)")


@dataclass(frozen=True)
class RpcFormat:
    """One format: how its files are told, read and written.

    Parameters
    ----------
    name : str
        As shown to users.
    is_one : callable
        Tells a file of this format from its first 64 kB, as text (bytes one to one).
    read : callable
        Path and ``Reading`` to model.
    write : callable, optional
        Path and model; None if the format is read only.
    suffix : str
        End of the names of written files, upper case.
    """

    name: str
    is_one: Callable[[str], bool]
    read: Callable[[str | os.PathLike[str], Reading], RpcModel]
    write: Callable[[str | os.PathLike[str], RpcModel], None] | None = None
    suffix: str = ""


def _root(head: str) -> str:
    """Name of the root element of an XML file, "" if it is none."""
    if not head.removeprefix("\xef\xbb\xbf").lstrip().startswith("<"):
        return ""
    bare = re.sub(r"<\?.*?\?>|<!--.*?-->", "", head, flags=re.DOTALL)
    match = _ROOT.search(bare)
    return match[1] if match else ""


def _is_dimap(head: str) -> bool:
    if _root(head) != "Dimap_Document":
        return False
    sub = re.search(r"<METADATA_SUBPROFILE>\s*(\w+)", head)
    return sub[1] == "RPC" if sub else "<Rational_Function_Model" in head


def _write_text(path: str | os.PathLike[str], model: RpcModel) -> None:
    write_bytes(path, rpc_text.format_rpc_text(model).encode("ascii"))


def _write_rpb(path: str | os.PathLike[str], model: RpcModel) -> None:
    write_bytes(path, rpc_rpb.format_rpc_rpb(model).encode("ascii"))


def _write_dimap(path: str | os.PathLike[str], model: RpcModel) -> None:
    write_bytes(path, rpc_dimap_write.format_rpc_dimap(model))


#: Every format, in the order in which they are tried.
FORMATS: Final = (
    RpcFormat("GeoTIFF", lambda head: head.encode("latin-1").startswith(_TIFF), rpc_raster.read_rpc_raster,
              rpc_raster.write_rpc_raster, ".TIF"),
    RpcFormat("GDAL VRT or .aux.xml", lambda head: _root(head) in ("VRTDataset", "PAMDataset"), rpc_vrt.read_rpc_vrt),
    RpcFormat("DIMAP 2 or 3 RPC XML", _is_dimap, rpc_dimap.read_rpc_dimap, _write_dimap, ".XML"),
    RpcFormat("PHR_DIMAP", lambda head: _root(head) == "PHR_Dimap_Document", rpc_dimap.read_rpc_dimap1),
    RpcFormat("DigitalGlobe XML", lambda head: _root(head) == "isd", rpc_rpb.read_rpc_isd),
    RpcFormat("RPB", rpc_rpb.is_rpb, rpc_rpb.read_rpc_rpb, _write_rpb, ".RPB"),
    RpcFormat("_RPC.TXT", rpc_text.is_text, rpc_text.read_rpc_text, _write_text, ".TXT"),
    RpcFormat("OSSIM .geom", rpc_geom.is_geom, rpc_geom.read_rpc_geom),
    RpcFormat("list of 90 numbers", rpc_text.is_list, rpc_text.read_rpc_list),
)  # fmt: skip


def rpc_format(path: str | os.PathLike[str]) -> RpcFormat | None:
    """Tell the RPC format of a file from its content; None if it is of no known one.

    Raises
    ------
    InputError
        The file does not exist or cannot be read.
    """
    head = read_bytes(path, HEAD_BYTES).decode("latin-1")
    return next((form for form in FORMATS if form.is_one(head)), None)


def read_rpc(path: str | os.PathLike[str], *, order: str = USUAL_ORDER, first_pixel: float | None = None) -> RpcModel:
    """Read the rational function model of a file of any known format.

    Parameters
    ----------
    path : path
        ``_RPC.TXT``, ``.RPB``, DIMAP ``RPC_*.XML`` (version 1, 2, 3), DigitalGlobe XML, an image with RPC
        tags (extra ``geo``), GDAL's ``.vrt`` and ``.aux.xml``, OSSIM ``.geom``, or a list of 90 numbers.
    order : str
        Order of the coefficients in the file: "RPC00B", "RPC00A", or "T2.54" (Terlemezoğlu 2019). A file that
        names another order is refused.
    first_pixel : float, optional
        Coordinate that the file gives the centre of its first pixel; default is what its format
        says (docs/rpc.md). Lists of numbers need it.

    Returns
    -------
    RpcModel
        Pixels with (0, 0) = centre of the first pixel, coefficients in RPC00B order.

    Raises
    ------
    InputError
        The file is not usable: one line with file, place, value and remedy.
    """
    reading = Reading(order, first_pixel)
    form = rpc_format(path)
    if form is None:
        seen = read_bytes(path, 40).decode("latin-1").strip()
        known = ", ".join(f.name for f in FORMATS)
        raise InputError.of("rpc.unknown_format", file=os.fspath(path), place="content", value=seen, known=known)
    return form.read(path, reading)


def write_rpc(path: str | os.PathLike[str], model: RpcModel) -> None:
    """Write a model whole or not at all; the name says the format.

    ``*.TXT`` (usually ``_RPC.TXT``), ``*.RPB``, ``*.XML`` (DIMAP of the version and profile the model was read
    from, else Pléiades), ``*.TIF`` (the tags of an existing GeoTIFF).

    Raises
    ------
    InputError
        The name ends otherwise, or the file cannot be written.
    """
    suffix = Path(path).suffix.upper().replace(".TIFF", ".TIF")
    for form in FORMATS:
        if form.write is not None and form.suffix == suffix:
            form.write(path, model)
            return
    raise InputError.of("rpc.target", file=os.fspath(path), value=Path(path).name)
