"""Read and write RPC files; each module of this package registers its formats."""

from __future__ import annotations

import os
from pathlib import Path

from fg_orient.formats.registry import Format, format_claiming, formats, read_bytes
from fg_orient.formats.rpc.fields import USUAL_ORDER, Reading
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

__all__ = ["read_rpc", "write_rpc"]


def rpc_format(path: str | os.PathLike[str]) -> Format | None:
    """Find the RPC format of a file from its content; None if it is unknown.

    InputError: the file cannot be read.
    """
    return format_claiming(Path(path), "rpc")


def read_rpc(path: str | os.PathLike[str], *, order: str = USUAL_ORDER, first_pixel: float | None = None) -> RpcModel:
    """Read the rational function model of a file of any known format.

    Parameters
    ----------
    path : path
        ``_RPC.TXT``, ``.RPB``, DIMAP ``RPC_*.XML`` (version 1, 2, 3), DigitalGlobe XML,
        an image with RPC tags (extra ``geo``), GDAL's ``.vrt`` and ``.aux.xml``, OSSIM
        ``.geom``, or a list of 90 numbers.
    order : str
        Order of the coefficients in the file: "RPC00B", "RPC00A", or "T2.54"
        (Terlemezoğlu 2019). If the file names another order, it is refused.
    first_pixel : float, optional
        Coordinate of the first pixel's centre in the file. The default is the convention
        of the format (docs/rpc.md). Lists of numbers have no default.

    Returns
    -------
    RpcModel
        Model whose pixel (0, 0) is the centre of the first pixel. Its coefficients are in RPC00B order.

    Raises
    ------
    InputError
        The file cannot be used; the message contains file, place, value and remedy.
    """
    reading = Reading(order, first_pixel)
    form = rpc_format(path)
    if form is None or form.read_rpc is None:
        seen = read_bytes(path, 40).decode("latin-1").strip()
        known = ", ".join(f.title for f in formats("rpc").values())
        raise InputError.of("rpc.unknown_format", file=os.fspath(path), place="content", value=seen, known=known)
    return form.read_rpc(Path(path), reading)


def rpc_writer(path: Path) -> Format:
    """Return the RPC format that writes files with this suffix.

    Raise InputError if there is none.
    """
    for form in formats("rpc").values():
        if form.write_rpc and path.suffix.lower() in form.suffixes:
            return form
    raise InputError.of("rpc.target", file=path, value=path.name)


def write_rpc(path: str | os.PathLike[str], model: RpcModel) -> None:
    """Write a model completely or not at all; the suffix of the file determines the format.

    Formats are ``*.TXT`` (usually ``_RPC.TXT``), ``*.RPB``, ``*.XML`` and ``*.TIF`` (the
    tags of an existing GeoTIFF). The XML is DIMAP. It has the version and profile of the
    file from which the model was read; for other models, the version and profile of Pléiades.

    Raises
    ------
    InputError
        The name has another suffix, or the file cannot be written.
    """
    write = rpc_writer(Path(path)).write_rpc
    assert write is not None  # rpc_writer returns only formats that can be written
    write(Path(path), model)
