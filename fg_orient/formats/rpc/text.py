"""RPC as ``_RPC.TXT``: one ``KEY: value unit`` on each line (IKONOS, GeoEye, GDAL), and plain lists of 90 numbers."""

from __future__ import annotations

import os
import re
from typing import Final

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, has_line
from fg_orient.formats.rpc.fields import ERRORS, POLYNOMIALS, Reading, RpcFields, build, read_text, texts_of
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

NAME: Final = "_RPC.TXT"
LIST_NAME: Final = "list of 90 numbers"
#: Axes in the order of most files, latitude before longitude, and their units.
_UNITS = {"LINE": "pixels", "SAMP": "pixels", "LAT": "degrees", "LONG": "degrees", "HEIGHT": "meters"}
_LINE = re.compile(r"\s*([A-Z][A-Z0-9_]*)\s*:\s*(\S+)(?:\s+[A-Za-z/]+)?\s*")
_NUMBERS = re.compile(r"\s*(?:[-+.0-9eEdD]+\s+){20,}")


def read_rpc_text(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read a ``_RPC.TXT``; unknown keys are refused."""
    fields = RpcFields(os.fspath(path))
    for number, line in enumerate(read_text(path).splitlines(), 1):
        match = _LINE.fullmatch(line)
        if line.strip() and not (match and fields.take(match[1], match[2], f"line {number}")):
            expected = "KEY: value, for instance LINE_OFF: 5124.0 pixels"
            raise InputError.of(
                "rpc.syntax", file=fields.file, place=f"line {number}", value=line.strip(), expected=expected
            )
    return build(fields, reading, NAME)


def format_rpc_text(model: RpcModel) -> str:
    """Text of a model as ``_RPC.TXT``, with all digits."""
    texts = texts_of(model)
    lines = [f"{name}: {texts[name]} meters" for name in ERRORS if name in texts]
    for word in ("OFF", "SCALE"):
        lines += [f"{axis}_{word}: {texts[f'{axis}_{word}']} {unit}" for axis, unit in _UNITS.items()]
    for stem in POLYNOMIALS:
        lines += [f"{stem}_COEFF_{k}: {text}" for k, text in enumerate(texts[f"{stem}_COEFF"].split(), 1)]
    return "\n".join(lines) + "\n"


def read_rpc_list(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read 90 numbers: offsets and scales of line, sample, latitude, longitude, height, then 4 x 20 coefficients.

    Raises
    ------
    InputError
        ``first_pixel``, which the list does not state, is not given, or there are not 90 numbers.
    """
    file, words = os.fspath(path), read_text(path).split()
    if len(words) != 90:
        raise InputError.of("rpc.list_count", file=file, value=f"{len(words)} numbers")
    if reading.first_pixel is None:
        raise InputError.of("rpc.origin", file=file)
    fields = RpcFields(file)
    names = [f"{axis}_{word}" for word in ("OFF", "SCALE") for axis in _UNITS]
    names += [f"{stem}_COEFF_{k}" for stem in POLYNOMIALS for k in range(1, 21)]
    for k, (name, text) in enumerate(zip(names, words, strict=True), 1):
        fields.add(name, text, f"number {k}")
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
