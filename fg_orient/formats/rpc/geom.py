"""RPC in OSSIM keyword lists (``.geom`` of OSSIM and the Orfeo Toolbox); read only."""

from __future__ import annotations

import os
import re
from typing import Any, Final

from fg_orient.formats.registry import Format, has_line
from fg_orient.formats.rpc.fields import FIRST_PIXEL, Reading, RpcFields, build, read_text, require_order
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.rpc import RpcModel

#: OSSIM counts from the centre of the first pixel, and has subtracted 1 from the offsets of Pléiades. Newer versions
#: also subtract 1 from the offsets of SPOT 6/7, which count from 0 (docs/rpc.md).
SPOT_FIRST_PIXEL: Final = -1.0
NAME: Final = "OSSIM .geom"
_LINE = re.compile(r"([\w.]+):[ \t]*(.*)")
_PARAMETER = re.compile(r"adjustment_\d+\.adj_param_\d+\.parameter")
_COEFFICIENT = re.compile(r"(line|samp)_(num|den)_coeff_(\d+)")
_ERRORS = {"bias_error": "ERR_BIAS", "rand_error": "ERR_RAND"}


def read_rpc_geom(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of an OSSIM keyword list."""
    fields, other = RpcFields(os.fspath(path)), {}
    for number, line in enumerate(read_text(path).splitlines(), 1):
        match = _LINE.fullmatch(line.strip())
        if match is None:
            continue
        key, text, place = match[1], match[2].strip(), f"line {number}"
        coefficient = _COEFFICIENT.fullmatch(key)
        name = _ERRORS.get(key, key.upper())
        if coefficient:
            name = f"{coefficient[1]}_{coefficient[2]}_coeff_{int(coefficient[3]) + 1}".upper()
        if not fields.take(name, text, place):
            other[key] = (text, place)
    if "polynomial_format" in other:
        text, place = other["polynomial_format"]
        require_order(fields.file, f"{place}, polynomial_format", f"RPC00{text}", reading)
    shift, notes = _spot_origin(fields, other)
    extra: dict[str, Any] = {"notes": notes + _adjustment(other)}
    for name, key in (("n_lines", "number_lines"), ("n_samples", "number_samples")):
        extra[name] = _count(fields.file, other, key)
    return build(fields, reading, NAME, shift, extra)


def _count(file: str, other: dict[str, tuple[str, str]], key: str) -> int | None:
    if key not in other:
        return None
    text, place = other[key]
    if not re.fullmatch(r"[1-9][0-9]{0,6}", text):
        raise InputError.of("rpc.not_a_number", file=file, place=f"{place}, {key}", value=text)
    return int(text)


def _spot_origin(fields: RpcFields, other: dict[str, tuple[str, str]]) -> tuple[float, tuple[Finding, ...]]:
    """First pixel of SPOT 6/7: the vendor's offsets equal the scales; OSSIM has subtracted 1 if they are 1 less."""
    if other.get("type", ("", ""))[0] == "ossimSpot6Model" and all(
        fields.number(f"{axis}_OFF") == fields.number(f"{axis}_SCALE") - 1.0 for axis in ("LINE", "SAMP")
    ):
        return SPOT_FIRST_PIXEL, (finding("rpc.offsets_put_back"),)
    return FIRST_PIXEL, ()


def _adjustment(other: dict[str, tuple[str, str]]) -> tuple[Finding, ...]:
    values = [text for key, (text, _) in other.items() if _PARAMETER.fullmatch(key)]
    if any(text.strip("0.+-") for text in values):
        return (finding("rpc.adjustment_ignored"),)
    return ()


FORMAT = Format(
    name="ossim-geom", title=NAME, read_rpc=read_rpc_geom,
    sniff=has_line("(?:line_num_coeff_0?0|line_den_coeff_0?0|polynomial_format)\\s*:"),
)  # fmt: skip
