"""RPC as ``.RPB`` of DigitalGlobe: groups of ``key = value;``, and the same fields in their XML (root ``isd``)."""

from __future__ import annotations

import os
import re
from typing import Final

from factors.cameras.rfm_project import RANGE
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, has_line, xml_root
from fg_orient.formats.rpc.fields import AXES, POLYNOMIALS, Reading, RpcFields, build, printed, read_text, require_order
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

#: RPC00B counts from the centre of the first pixel.
FIRST_PIXEL: Final = 0.0
NAME: Final = "RPB"
ISD_NAME: Final = "DigitalGlobe ISD"
_AXES = {"line": "LINE", "samp": "SAMP", "lat": "LAT", "long": "LONG", "height": "HEIGHT"}
#: Key of the file -> name in ``_RPC.TXT``.
_KEYS = {
    "errBias": "ERR_BIAS", "errRand": "ERR_RAND",
    **{f"{short}Offset": f"{name}_OFF" for short, name in _AXES.items()},
    **{f"{short}Scale": f"{name}_SCALE" for short, name in _AXES.items()},
}  # fmt: skip
_GROUPS = dict(zip(("lineNumCoef", "lineDenCoef", "sampNumCoef", "sampDenCoef"), POLYNOMIALS, strict=True))
_ENTRY = re.compile(r'^[ \t]*(\w+)[ \t]*=\s*(\([^)]*\)|"[^"\n]*"|[^;\n("]*);', re.MULTILINE)


def read_rpc_rpb(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read an RPB file."""
    text = read_text(path)
    fields = RpcFields(os.fspath(path))
    for match in _ENTRY.finditer(text):
        key, value = match[1], match[2].strip()
        place = f"line {text.count(chr(10), 0, match.start(1)) + 1}"
        if key in _KEYS:
            fields.add(_KEYS[key], value, place)
        elif key in _GROUPS:
            fields.add_group(_GROUPS[key], value.strip("()").replace(",", " ").split(), place)
        elif key.lower() == "specid":
            require_order(fields.file, f"{place}, SpecId", value.strip('"'), reading)
    return build(fields, reading, NAME, FIRST_PIXEL)


def format_rpc_rpb(model: RpcModel) -> str:
    """Give a model as the text of an RPB file; all digits are kept, unknown errors are 0."""
    offsets = model.offsets.copy()
    offsets[RANGE.image] += FIRST_PIXEL
    values = dict(zip([f"{name}_OFF" for name in AXES], offsets, strict=True))
    values |= zip([f"{name}_SCALE" for name in AXES], model.scales, strict=True)
    values |= {"ERR_BIAS": model.err_bias_m or 0.0, "ERR_RAND": model.err_rand_m or 0.0}
    lines = ['satId = "";', 'bandId = "";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    lines += [f"\t{key} = {printed(values[name])};" for key, name in _KEYS.items()]
    for key, row in zip(_GROUPS, model.coefficients, strict=True):
        body = ",\n".join(f"\t\t\t{printed(value)}" for value in row)
        lines.append(f"\t{key} = (\n{body});")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n"


def read_rpc_isd(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPB section of a DigitalGlobe XML file."""
    root = read_xml(path)
    section = root.maybe("RPB")
    if section is None:
        raise InputError.of("rpc.missing", file=root.file, field="element RPB")
    spec = section.one("SPECID")
    require_order(root.file, spec.place, spec.text(), reading)
    fields, image = RpcFields(root.file), section.one("IMAGE")
    for key, name in _KEYS.items():
        node = image.maybe(key.upper())
        if node is not None:
            fields.add(name, node.text(), node.place)
    for key, stem in _GROUPS.items():
        node = image.one(f"{key.upper()}List/{key.upper()}")
        fields.add_group(stem, node.text().split(), node.place)
    extra = {}
    for name, tag in (("n_lines", "NUMROWS"), ("n_samples", "NUMCOLUMNS")):
        size = root.maybe(f"IMD/{tag}")
        extra[name] = None if size is None else size.integer(1, 10**7)
    return build(fields, reading, ISD_NAME, FIRST_PIXEL, extra)


FORMAT = Format(
    name="rpb", title=NAME, suffixes=(".rpb",), sniff=has_line("(?:lineOffset|lineNumCoef)\\s*="),
    read_rpc=read_rpc_rpb,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_rpb(model).encode("ascii")),
)  # fmt: skip
ISD_FORMAT = Format(
    name="digitalglobe-xml", title="DigitalGlobe XML", read_rpc=read_rpc_isd,
    sniff=lambda _, head: xml_root(head) == "isd",
)  # fmt: skip
