"""RPC of GDAL: GeoTIFF tag 50844, or files beside the image (extra ``geo``); metadata domain ``RPC`` of .vrt, .aux.xml.

The XML of a virtual raster is read, not the raster: it can name any file or address as its source. RPC count from the
centre of the first pixel, as RPC00B does.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import warnings
from pathlib import Path
from typing import Any, Final

from factors.cameras.rfm_project import RANGE
from fg_orient.formats.gdal import rasterio_of
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.rpc.fields import AXES, POLYNOMIALS, Reading, RpcFields, build, printed
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

FIRST_PIXEL: Final = 0.0
NAME: Final = "GeoTIFF RPC"
VRT_NAME: Final = "GDAL RPC metadata"
_SCALARS: Final = {f"{axis}_{word}" for axis in AXES for word in ("OFF", "SCALE")} | {"ERR_BIAS", "ERR_RAND"}
_TIFF: Final = ("II*\0", "MM\0*", "II+\0", "MM\0+")


def read_rpc_raster(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of an image, with the image's size.

    Raises
    ------
    InputError
        rasterio is missing, GDAL cannot read the image, or it holds no RPC.
    """
    file = os.fspath(path)
    rasterio = rasterio_of(file, "rpc.no_rasterio")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(path) as source:
                rpcs, size = source.rpcs, source.shape
    except (rasterio.errors.RasterioError, ValueError, KeyError) as error:  # the latter two: damaged tags
        raise InputError.of("rpc.unreadable", file=file, value=error) from error
    if rpcs is None:
        raise InputError.of("rpc.no_tags", file=file)
    fields = RpcFields(file)
    for axis in AXES:
        for word in ("OFF", "SCALE"):
            fields.add(f"{axis}_{word}", printed(getattr(rpcs, f"{axis}_{word}".lower())), "RPC tags")
    for name in ("ERR_BIAS", "ERR_RAND"):
        value = getattr(rpcs, name.lower())
        if value is not None:
            fields.add(name, printed(value), "RPC tags")
    for stem in POLYNOMIALS:
        fields.add_group(stem, [printed(v) for v in getattr(rpcs, f"{stem}_COEFF".lower())], "RPC tags")
    return build(fields, reading, NAME, FIRST_PIXEL, {"n_lines": size[0], "n_samples": size[1]})


def write_rpc_raster(path: str | os.PathLike[str], model: RpcModel) -> None:
    """Write the RPC tags of an existing GeoTIFF; its pixels stay. The file is replaced whole or not at all.

    Raises
    ------
    InputError
        There is no such image, or it cannot be written.
    """
    file, target = os.fspath(path), Path(path)
    rasterio = rasterio_of(file, "rpc.no_rasterio")
    if not target.is_file():
        raise InputError.of("rpc.tags_target", file=file)
    offsets = model.offsets.copy()
    offsets[RANGE.image] += FIRST_PIXEL
    values: dict[str, Any] = {"err_bias": model.err_bias_m, "err_rand": model.err_rand_m}
    for k, axis in enumerate(AXES):
        values[f"{axis}_OFF".lower()] = float(offsets[k])
        values[f"{axis}_SCALE".lower()] = float(model.scales[k])
    for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True):
        values[f"{stem}_COEFF".lower()] = [float(v) for v in row]
    copy = target.with_name(f".{secrets.token_hex(4)}.tmp.tif")
    try:
        shutil.copyfile(target, copy)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(copy, "r+") as image:
                image.rpcs = rasterio.rpc.RPC(**values)
        copy.replace(target)
    except (OSError, rasterio.errors.RasterioError) as error:
        raise InputError.of("output.unwritable", file=file, value=error) from error
    finally:
        copy.unlink(missing_ok=True)


def read_rpc_vrt(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC domain of a virtual raster.

    Raises
    ------
    InputError
        There is no RPC domain, or a field is missing or no number.
    """
    root = read_xml(path)
    domain = next((n for n in root.every("Metadata", 0) if n.element.get("domain") == "RPC"), None)
    if domain is None:
        raise InputError.of("rpc.no_tags", file=root.file)
    fields = RpcFields(root.file)
    for node in domain.every("MDI"):
        key = node.element.get("key", "")
        if key in _SCALARS:
            fields.add(key, node.text(), node.place)
        elif key.removesuffix("_COEFF") in POLYNOMIALS:
            fields.add_group(key.removesuffix("_COEFF"), node.text().split(), node.place)
    extra: dict[str, Any] = {}
    for name, attribute in (("n_lines", "rasterYSize"), ("n_samples", "rasterXSize")):
        text = root.element.get(attribute, "")
        extra[name] = int(text) if re.fullmatch(r"[1-9][0-9]{0,6}", text) else None
    return build(fields, reading, VRT_NAME, FIRST_PIXEL, extra)


FORMAT = Format(
    name="geotiff-tags", title="GeoTIFF", suffixes=(".tif", ".tiff"),
    sniff=lambda _, head: head.startswith(_TIFF), read_rpc=read_rpc_raster, write_rpc=write_rpc_raster,
)  # fmt: skip
VRT_FORMAT = Format(
    name="vrt", title="GDAL VRT or .aux.xml", read_rpc=read_rpc_vrt,
    sniff=lambda _, head: xml_root(head) in ("VRTDataset", "PAMDataset"),
)  # fmt: skip
