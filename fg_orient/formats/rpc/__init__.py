"""Readers and writers of RPC files; each module of this package registers one format or two related formats."""

from __future__ import annotations

import os
from pathlib import Path

from fg_orient.formats.registry import Format, format_claiming, formats, read_bytes
from fg_orient.formats.rpc.fields import USUAL_ORDER, Reading
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

__all__ = ["read_rpc", "write_rpc"]


def rpc_format(path: str | os.PathLike[str]) -> Format | None:
    """RPC format of a file by its content; None if it is unknown. InputError if the file cannot be read."""
    return format_claiming(Path(path), "rpc")


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
        Coordinate of the centre of the first pixel in the file; default: the convention of the format
        (docs/rpc.md). Lists of numbers need it.

    Returns
    -------
    RpcModel
        Pixels with (0, 0) = centre of the first pixel, coefficients in RPC00B order.

    Raises
    ------
    InputError
        The file is not usable: one message with file, place, value and remedy.
    """
    reading = Reading(order, first_pixel)
    form = rpc_format(path)
    if form is None or form.read_rpc is None:
        seen = read_bytes(path, 40).decode("latin-1").strip()
        known = ", ".join(f.title for f in formats("rpc").values())
        raise InputError.of("rpc.unknown_format", file=os.fspath(path), place="content", value=seen, known=known)
    return form.read_rpc(Path(path), reading)


def rpc_writer(path: Path) -> Format:
    """Format to write, by the suffix of a file; InputError if no RPC format with this suffix can be written."""
    for form in formats("rpc").values():
        if form.write_rpc and path.suffix.lower() in form.suffixes:
            return form
    raise InputError.of("rpc.target", file=path, value=path.name)


def write_rpc(path: str | os.PathLike[str], model: RpcModel) -> None:
    """Write a model whole or not at all, in the format of the file's name.

    ``*.TXT`` (usually ``_RPC.TXT``), ``*.RPB``, ``*.XML`` (DIMAP of the version and profile the model was read
    from, else Pléiades), ``*.TIF`` (the tags of an existing GeoTIFF).

    Raises
    ------
    InputError
        The name has another suffix, or the file cannot be written.
    """
    write = rpc_writer(Path(path)).write_rpc
    assert write is not None  # of a format that can be written
    write(Path(path), model)
