"""RPC in images: GeoTIFF tag 50844, or what GDAL finds beside the image (extra ``geo``)."""

from __future__ import annotations

import os
import secrets
import shutil
import warnings
from pathlib import Path
from typing import Any, Final

from factors.cameras.rfm_project import RANGE
from fg_orient.formats.rpc_fields import AXES, POLYNOMIALS, Reading, RpcFields, build, printed
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

#: The tag follows RPC00B: it counts from the centre of the first pixel.
FIRST_PIXEL: Final = 0.0
NAME: Final = "GeoTIFF RPC"


def _rasterio(file: str) -> Any:
    try:
        import rasterio
    except ImportError as error:
        raise InputError.of("rpc.no_rasterio", file=file) from error
    return rasterio


def read_rpc_raster(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of an image, with the image's size.

    Raises
    ------
    InputError
        rasterio is missing, GDAL cannot read the image, or it holds no RPC.
    """
    file = os.fspath(path)
    rasterio = _rasterio(file)
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
    rasterio = _rasterio(file)
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
