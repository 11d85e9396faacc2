"""RPC in GDAL's virtual rasters: the metadata domain ``RPC`` of a ``.vrt`` (or ``.aux.xml``); read only.

The XML is read, not the raster: a virtual raster can name any file or address as its source.
"""

from __future__ import annotations

import os
import re
from typing import Any, Final

from fg_orient.formats.rpc_fields import AXES, POLYNOMIALS, Reading, RpcFields, build
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

#: GDAL counts RPC from the centre of the first pixel.
FIRST_PIXEL: Final = 0.0
NAME: Final = "GDAL RPC metadata"
_SCALARS: Final = {f"{axis}_{word}" for axis in AXES for word in ("OFF", "SCALE")} | {"ERR_BIAS", "ERR_RAND"}


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
    return build(fields, reading, NAME, FIRST_PIXEL, extra)
