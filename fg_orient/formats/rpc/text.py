"""RPC as ``_RPC.TXT``: one ``KEY: value unit`` on each line (IKONOS, GeoEye, GDAL), and plain lists of 90 numbers."""

from __future__ import annotations

import os
import re
from typing import Final

from factors.cameras.rfm_project import RANGE
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, has_line
from fg_orient.formats.rpc.fields import (
    AXES,
    POLYNOMIALS,
    UNITS,
    Reading,
    RpcFields,
    build,
    printed,
    read_text,
)  # fmt: skip
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

#: RPC00B counts from the centre of the first pixel.
FIRST_PIXEL: Final = 0.0
NAME: Final = "_RPC.TXT"
LIST_NAME: Final = "list of 90 numbers"
#: Lists begin with line, sample, latitude, longitude, height.
_LIST_AXES = ("LINE", "SAMP", "LAT", "LONG", "HEIGHT")
_LINE = re.compile(r"\s*([A-Z][A-Z0-9_]*)\s*:\s*(\S+)(?:\s+[A-Za-z/]+)?\s*")
_NUMBERS = re.compile(r"\s*(?:[-+.0-9eEdD]+\s+){20,}")


def read_rpc_text(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read a ``_RPC.TXT``; keys that no RPC has are refused."""
    fields = RpcFields(os.fspath(path))
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        match = _LINE.fullmatch(line)
        if match is None or not _is_known(match[1]):
            expected = "KEY: value, for instance LINE_OFF: 5124.0 pixels"
            raise InputError.of(
                "rpc.syntax", file=fields.file, place=f"line {number}", value=line.strip(), expected=expected
            )
        fields.add(match[1], match[2], f"line {number}")
    return build(fields, reading, NAME, FIRST_PIXEL)


def _is_known(key: str) -> bool:
    stem = key.rsplit("_", 1)[0]
    return (
        stem.removesuffix("_COEFF") in POLYNOMIALS
        or (key.endswith(("_OFF", "_SCALE")) and stem in AXES)
        or key in ("ERR_BIAS", "ERR_RAND")
    )


def format_rpc_text(model: RpcModel) -> str:
    """Give a model as the text of a ``_RPC.TXT``; all digits are kept."""
    lines = [
        f"{key}: {printed(value)} meters"
        for key, value in (("ERR_BIAS", model.err_bias_m), ("ERR_RAND", model.err_rand_m))
        if value is not None
    ]
    offsets = model.offsets.copy()
    offsets[RANGE.image] += FIRST_PIXEL
    order = [0, 1, 3, 2, 4]  # latitude before longitude, as everybody writes it
    for word, values in (("OFF", offsets), ("SCALE", model.scales)):
        lines += [f"{AXES[k]}_{word}: {printed(values[k])} {UNITS[k]}" for k in order]
    for stem, row in zip(POLYNOMIALS, model.coefficients, strict=True):
        lines += [f"{stem}_COEFF_{k}: {printed(value)}" for k, value in enumerate(row, 1)]
    return "\n".join(lines) + "\n"


def read_rpc_list(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read 90 numbers: offsets and scales of line, sample, latitude, longitude, height, then 4 x 20 coefficients.

    Raises
    ------
    InputError
        ``first_pixel`` is not given, which such a list cannot say, or there are not 90 numbers.
    """
    file, words = os.fspath(path), read_text(path).split()
    if len(words) != 90:
        raise InputError.of("rpc.list_count", file=file, value=f"{len(words)} numbers")
    if reading.first_pixel is None:
        raise InputError.of("rpc.origin", file=file)
    fields = RpcFields(file)
    for k, axis in enumerate(_LIST_AXES):
        fields.add(f"{axis}_OFF", words[k], f"number {k + 1}")
        fields.add(f"{axis}_SCALE", words[5 + k], f"number {k + 6}")
    for k, stem in enumerate(POLYNOMIALS):
        fields.add_group(stem, words[10 + 20 * k : 30 + 20 * k], f"numbers {11 + 20 * k} to {30 + 20 * k}")
    return build(fields, reading, LIST_NAME, reading.first_pixel)


FORMAT = Format(
    name="rpc-txt", title=NAME, suffixes=(".txt",),
    sniff=has_line("(?:LINE|SAMP|LAT|LONG|HEIGHT)_(?:OFF|SCALE)\\s*:"), read_rpc=read_rpc_text,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_text(model).encode("ascii")),
)  # fmt: skip
LIST_FORMAT = Format(
    name="rpc-list", title=LIST_NAME, sniff=lambda _, head: _NUMBERS.match(head) is not None,
    read_rpc=read_rpc_list,
)  # fmt: skip
