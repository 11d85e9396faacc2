"""RPC that GDAL reads: GeoTIFF tag 50844, files beside the image (extra ``geo``), and .vrt and .aux.xml.

A virtual raster (.vrt) can name any file or network address as its raster. Therefore only
its XML is read, where the domain ``RPC`` contains the model. Pixel 0 is the centre of the
first pixel, as in RPC00B.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import staged_file
from fg_orient.formats.gdal import TIFF_MARKS, opened, rasterio_of
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.rpc.fields import NAMES, Reading, RpcFields, printed, texts_of
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

NAME: Final = "GeoTIFF RPC"
VRT_NAME: Final = "GDAL RPC metadata"


def read_rpc_raster(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of an image and the size of the image.

    Raises
    ------
    InputError
        The package rasterio is not installed, GDAL cannot read the image, or the image contains no RPC.
    """
    fields = RpcFields(os.fspath(path), reading)
    rasterio = rasterio_of(fields.file, "rpc.no_rasterio")
    try:
        with opened(rasterio, path) as source:
            rpcs, size = source.rpcs, source.shape
    except (rasterio.errors.RasterioError, ValueError, KeyError) as error:  # damaged tags raise ValueError or KeyError
        raise InputError.of("rpc.unreadable", file=fields.file, value=error) from error
    if rpcs is None:
        raise InputError.of("rpc.no_tags", file=fields.file)
    for name, values in rpcs.to_dict().items():
        if values is not None:
            fields.take(name.upper(), printed(np.atleast_1d(values)), "RPC tags")
    return fields.model(NAME, n_lines=size[0], n_samples=size[1])


def write_rpc_raster(path: str | os.PathLike[str], model: RpcModel) -> None:
    """Write the RPC tags of an existing GeoTIFF; its pixels are unchanged.

    The file is replaced completely or not at all.

    Raises
    ------
    InputError
        The image does not exist or cannot be written.
    """
    file, target = os.fspath(path), Path(path)
    rasterio = rasterio_of(file, "rpc.no_rasterio")
    if not target.is_file():
        raise InputError.of("rpc.tags_target", file=file)
    try:
        with staged_file(target, suffix=".tif") as copy:
            shutil.copyfile(target, copy)
            with opened(rasterio, copy, "r+") as image:
                image.rpcs = rasterio.rpc.RPC.from_gdal(texts_of(model))
    except rasterio.errors.RasterioError as error:
        raise InputError.of("output.unwritable", file=file, value=error) from error


def write_rpc_copy(path: Path, model: RpcModel, image: Path) -> None:
    """Write an image with a model, either as a GeoTIFF copy or as a virtual raster (``.vrt``) that refers to it.

    Raises
    ------
    InputError
        The image cannot be read, its size differs from the size in the model, or the file cannot be written.
    """
    rasterio = rasterio_of(path, "rpc.no_rasterio")
    from rasterio.shutil import copy as raster_copy

    kind = "VRT" if path.suffix.lower() == ".vrt" else "GTiff"
    try:
        with opened(rasterio, image) as source:
            size, stated = source.shape, (model.n_lines or source.height, model.n_samples or source.width)
            if size != stated:
                raise InputError.of("rpc.image_size", file=image, value=f"{size[0]} x {size[1]}", lines=stated[0],
                                    samples=stated[1])  # fmt: skip
        with staged_file(path, suffix=path.suffix) as copy:
            raster_copy(image, copy, driver=kind)
            with opened(rasterio, copy, "r+") as target:
                target.rpcs = rasterio.rpc.RPC.from_gdal(texts_of(model))
    except rasterio.errors.RasterioError as error:
        raise InputError.of("output.unwritable", file=path, value=error) from error


def read_rpc_vrt(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the domain ``RPC`` of a virtual raster.

    Raises
    ------
    InputError
        The domain ``RPC`` does not exist, or a field is missing or is not a number.
    """
    root = read_xml(path)
    domain = next((n for n in root.every("Metadata", 0) if n.element.get("domain") == "RPC"), None)
    if domain is None:
        raise InputError.of("rpc.no_tags", file=root.file)
    fields = RpcFields(root.file, reading)
    for node in domain.every("MDI"):
        key = node.element.get("key", "")
        if NAMES.fullmatch(key):
            fields.take(key, node.text(), node.place)
    texts = (root.element.get(attribute, "") for attribute in ("rasterYSize", "rasterXSize"))
    lines, samples = (int(text) if re.fullmatch(r"[1-9][0-9]{0,6}", text) else None for text in texts)
    return fields.model(VRT_NAME, n_lines=lines, n_samples=samples)


FORMAT = Format(
    name="geotiff-tags", title="GeoTIFF", suffixes=(".tif", ".tiff"),
    sniff=lambda _, head: head[:4].encode("latin-1") in TIFF_MARKS, read_rpc=read_rpc_raster,
    write_rpc=write_rpc_raster,
)  # fmt: skip
VRT_FORMAT = Format(
    name="vrt", title="GDAL VRT or .aux.xml", read_rpc=read_rpc_vrt,
    sniff=lambda _, head: xml_root(head) in ("VRTDataset", "PAMDataset"),
)  # fmt: skip
