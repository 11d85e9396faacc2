"""RPC as ``.RPB`` of DigitalGlobe: groups of ``key = value;``, and the same fields in their XML (root ``isd``)."""

from __future__ import annotations

import os
import re
from typing import Final

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, has_line, xml_root
from fg_orient.formats.rpc.fields import Reading, RpcFields, build, read_text, require_order, texts_of
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.rpc import RpcModel

NAME: Final = "RPB"
ISD_NAME: Final = "DigitalGlobe ISD"
_AXES = {"line": "LINE", "samp": "SAMP", "lat": "LAT", "long": "LONG", "height": "HEIGHT"}
#: Key of the file -> name in ``_RPC.TXT``.
_KEYS = {
    "errBias": "ERR_BIAS", "errRand": "ERR_RAND",
    **{f"{short}Offset": f"{name}_OFF" for short, name in _AXES.items()},
    **{f"{short}Scale": f"{name}_SCALE" for short, name in _AXES.items()},
    "lineNumCoef": "LINE_NUM_COEFF", "lineDenCoef": "LINE_DEN_COEFF",
    "sampNumCoef": "SAMP_NUM_COEFF", "sampDenCoef": "SAMP_DEN_COEFF",
}  # fmt: skip
_ENTRY = re.compile(r'^[ \t]*(\w+)[ \t]*=\s*(\([^)]*\)|"[^"\n]*"|[^;\n("]*);', re.MULTILINE)


def read_rpc_rpb(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read an RPB file."""
    text = read_text(path)
    fields = RpcFields(os.fspath(path))
    for match in _ENTRY.finditer(text):
        key, value = match[1], match[2].strip()
        place = f"line {text.count(chr(10), 0, match.start(1)) + 1}"
        if key in _KEYS:
            listed = value.strip("()").replace(",", " ") if key.endswith("Coef") else value
            fields.take(_KEYS[key], listed, place)
        elif key.lower() == "specid":
            require_order(fields.file, f"{place}, SpecId", value.strip('"'), reading)
    return build(fields, reading, NAME)


def format_rpc_rpb(model: RpcModel) -> str:
    """Text of a model as RPB file, with all digits; unknown errors are 0."""
    texts = {"ERR_BIAS": "0.0", "ERR_RAND": "0.0", **texts_of(model)}
    lines = ['satId = "";', 'bandId = "";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    for key, name in _KEYS.items():
        words = ",\n\t\t\t".join(texts[name].split())
        lines.append(f"\t{key} = (\n\t\t\t{words});" if key.endswith("Coef") else f"\t{key} = {words};")
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
        tag = key.upper()
        node = image.one(f"{tag}List/{tag}") if key.endswith("Coef") else image.maybe(tag)
        if node is not None:
            fields.take(name, node.text(), node.place)
    extra = {}
    for name, tag in (("n_lines", "NUMROWS"), ("n_samples", "NUMCOLUMNS")):
        size = root.maybe(f"IMD/{tag}")
        extra[name] = None if size is None else size.integer(1, 10**7)
    return build(fields, reading, ISD_NAME, extra=extra)


FORMAT = Format(
    name="rpb", title=NAME, suffixes=(".rpb",), sniff=has_line("(?:lineOffset|lineNumCoef)\\s*="),
    read_rpc=read_rpc_rpb,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_rpb(model).encode("ascii")),
)  # fmt: skip
ISD_FORMAT = Format(
    name="digitalglobe-xml", title="DigitalGlobe XML", read_rpc=read_rpc_isd,
    sniff=lambda _, head: xml_root(head) == "isd",
)  # fmt: skip
