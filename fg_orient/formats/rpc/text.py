"""RPC in text files: ``_RPC.TXT``, lists of 90 numbers, ``.RPB``, DigitalGlobe's XML, and OSSIM keyword lists.

In ``_RPC.TXT`` (IKONOS, GeoEye, GDAL), each line is ``KEY: value unit``. A ``.RPB`` file
of DigitalGlobe contains groups of ``key = value;``. DigitalGlobe's XML (root ``isd``) has
the same fields; it can be read, but not written. Keyword lists (``.geom`` of OSSIM and
the Orfeo Toolbox) contain ``key: value``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from typing import Any, Final

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, has_line, xml_root
from fg_orient.formats.rpc.fields import ERRORS, FIRST_PIXEL, POLYNOMIALS, Reading, RpcFields, read_text, texts_of
from fg_orient.formats.xml import read_xml
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.rpc import RpcModel

NAME: Final = "_RPC.TXT"
LIST_NAME: Final = "list of 90 numbers"
RPB_NAME: Final = "RPB"
ISD_NAME: Final = "DigitalGlobe ISD"
GEOM_NAME: Final = "OSSIM .geom"
#: Axes in the order of most files; latitude precedes longitude.
_AXES: Final = ("LINE", "SAMP", "LAT", "LONG", "HEIGHT")
#: Names in ``_RPC.TXT`` by the keys of ``.RPB``.
_RPB_KEYS = {
    "errBias": "ERR_BIAS", "errRand": "ERR_RAND",
    **{f"{name.lower()}{word}": f"{name}_{short}"
       for word, short in (("Offset", "OFF"), ("Scale", "SCALE")) for name in _AXES},
    **{f"{name[:4].lower()}{name[5:].title()}Coef": f"{name}_COEFF" for name in POLYNOMIALS},
}  # fmt: skip
#: In OSSIM, 0 is the centre of the first pixel. OSSIM subtracts 1 from the offsets of
#: Pléiades. Newer versions also subtract 1 from the offsets of SPOT 6/7, although these
#: count from 0 (docs/rpc.md).
SPOT_FIRST_PIXEL: Final = -1.0
_OSSIM_ERRORS = {"bias_error": "ERR_BIAS", "rand_error": "ERR_RAND"}

_LINE = re.compile(r"\s*([A-Z][A-Z0-9_]*)\s*:\s*(\S+)(?:\s+[A-Za-z/]+)?\s*")
_NUMBERS = re.compile(r"\s*(?:[-+.0-9eEdD]+\s+){20,}")
_RPB_ENTRY = re.compile(r'^[ \t]*+(\w++)[ \t]*+=\s*+(\([^()=;]*+\)|"[^"\n]*+"|[^;\n("]*+);', re.MULTILINE)
_GEOM_ENTRY = re.compile(r"^[^\S\n]*+([\w.]++):[ \t]*(.*)$", re.MULTILINE)
_GEOM_COEFFICIENT = re.compile(r"(line|samp)_(num|den)_coeff_([0-9]{1,4})")
_GEOM_PARAMETER = re.compile(r"adjustment_\d+\.adj_param_\d+\.parameter")


def read_rpc_text(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read a ``_RPC.TXT`` file; unknown keys are refused."""
    fields = RpcFields(os.fspath(path), reading)
    for number, line in enumerate(read_text(path).splitlines(), 1):
        match = _LINE.fullmatch(line)
        if line.strip() and not (match and fields.take(match[1], match[2], f"line {number}")):
            place, expected = f"line {number}", "KEY: value, for instance LINE_OFF: 5124.0 pixels"
            raise InputError.of("rpc.syntax", file=fields.file, place=place, value=line.strip(), expected=expected)
    return fields.model(NAME)


def format_rpc_text(model: RpcModel) -> str:
    """Return the text of a model as ``_RPC.TXT`` with all digits.

    Units are left out, as GDAL does. If a file has units, GDAL passes them on as part of
    the numbers, and programs that read the tags of the image (for example rpcm) then
    refuse them.
    """
    texts = texts_of(model)
    lines = [f"{name}: {texts[name]}" for name in ERRORS if name in texts]
    for word in ("OFF", "SCALE"):
        lines += [f"{axis}_{word}: {texts[f'{axis}_{word}']}" for axis in _AXES]
    for stem in POLYNOMIALS:
        lines += [f"{stem}_COEFF_{k}: {text}" for k, text in enumerate(texts[f"{stem}_COEFF"].split(), 1)]
    return "\n".join(lines) + "\n"


def read_rpc_list(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read a list of 90 numbers.

    The list contains offsets and scales of line, sample, latitude, longitude and height,
    then 4 x 20 coefficients.

    Raises
    ------
    InputError
        The user does not give ``first_pixel``, which the list does not state; or there are not 90 numbers.
    """
    file, words = os.fspath(path), read_text(path).split()
    if len(words) != 90:
        raise InputError.of("rpc.list_count", file=file, value=f"{len(words)} numbers")
    if reading.first_pixel is None:
        raise InputError.of("rpc.origin", file=file)
    fields = RpcFields(file, reading)
    names = [f"{axis}_{word}" for word in ("OFF", "SCALE") for axis in _AXES]
    names += [f"{stem}_COEFF_{k}" for stem in POLYNOMIALS for k in range(1, 21)]
    for k, (name, text) in enumerate(zip(names, words, strict=True), 1):
        fields.add(name, text, f"number {k}")
    return fields.model(LIST_NAME)


# --- DigitalGlobe --------------------------------------------------------------------------------


def _entries(path: str | os.PathLike[str], pattern: re.Pattern[str]) -> Iterator[tuple[str, str, str]]:
    """Yield key, text and place of each match of a pattern."""
    text, line, at = read_text(path), 1, 0
    for match in pattern.finditer(text):
        line, at = line + text.count("\n", at, match.start(1)), match.start(1)
        yield match[1], match[2].strip(), f"line {line}"


def read_rpc_rpb(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read an RPB file."""
    fields = RpcFields(os.fspath(path), reading)
    for key, value, place in _entries(path, _RPB_ENTRY):
        if key in _RPB_KEYS:
            listed = value.strip("()").replace(",", " ") if key.endswith("Coef") else value
            fields.take(_RPB_KEYS[key], listed, place)
        elif key.lower() == "specid":
            fields.require_order(f"{place}, SpecId", value.strip('"'))
    return fields.model(RPB_NAME)


def format_rpc_rpb(model: RpcModel) -> str:
    """Return the text of a model as an RPB file with all digits; unknown errors are 0."""
    texts = {"ERR_BIAS": "0.0", "ERR_RAND": "0.0", **texts_of(model)}
    lines = ['satId = "";', 'bandId = "";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    for key, name in _RPB_KEYS.items():
        words = ",\n\t\t\t".join(texts[name].split())
        lines.append(f"\t{key} = (\n\t\t\t{words});" if key.endswith("Coef") else f"\t{key} = {words};")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;"]) + "\n"


def read_rpc_isd(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPB section of a DigitalGlobe XML file."""
    root = read_xml(path)
    section, fields = root.maybe("RPB"), RpcFields(root.file, reading)
    if section is None:
        raise InputError.of("rpc.missing", file=root.file, field="element RPB")
    spec, image = section.maybe("SPECID"), section.one("IMAGE")
    if spec is not None:  # files of the Ames Stereo Pipeline do not contain it
        fields.require_order(spec.place, spec.text())
    for key, name in _RPB_KEYS.items():
        tag = key.upper()
        node = image.one(f"{tag}List/{tag}") if key.endswith("Coef") else image.maybe(tag)
        if node is not None:
            fields.take(name, node.text(), node.place)
    sizes = (root.maybe(f"IMD/{tag}") for tag in ("NUMROWS", "NUMCOLUMNS"))
    lines, samples = (None if size is None else size.integer(1, 10**7) for size in sizes)
    return fields.model(ISD_NAME, n_lines=lines, n_samples=samples)


# --- OSSIM ---------------------------------------------------------------------------------------


def read_rpc_geom(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of an OSSIM keyword list."""
    fields, other = RpcFields(os.fspath(path), reading), {}
    for key, text, place in _entries(path, _GEOM_ENTRY):
        coefficient = _GEOM_COEFFICIENT.fullmatch(key)
        name = _OSSIM_ERRORS.get(key, key.upper())
        if coefficient:
            name = f"{coefficient[1]}_{coefficient[2]}_coeff_{int(coefficient[3]) + 1}".upper()
        if not fields.take(name, text, place):
            other[key] = (text, place)
    if "polynomial_format" in other:
        text, place = other["polynomial_format"]
        fields.require_order(f"{place}, polynomial_format", f"RPC00{text}")
    extra: dict[str, Any] = {}
    for name, key in (("n_lines", "number_lines"), ("n_samples", "number_samples")):
        text, place = other.get(key, ("", ""))
        if place and not re.fullmatch(r"[1-9][0-9]{0,6}", text):
            raise InputError.of("rpc.not_a_number", file=fields.file, place=f"{place}, {key}", value=text)
        extra[name] = int(text) if place else None
    shift, notes = FIRST_PIXEL, list[Finding]()
    # in the vendor's files of SPOT 6/7, offsets are equal to scales; if they are smaller by 1, OSSIM has subtracted 1
    if other.get("type", ("", ""))[0] == "ossimSpot6Model" and all(
        fields.number(f"{axis}_OFF") == fields.number(f"{axis}_SCALE") - 1.0 for axis in ("LINE", "SAMP")
    ):
        shift, notes = SPOT_FIRST_PIXEL, [finding("rpc.offsets_put_back")]
    if any(text.strip("0.+-") for key, (text, _) in other.items() if _GEOM_PARAMETER.fullmatch(key)):
        notes.append(finding("rpc.adjustment_ignored"))
    return fields.model(GEOM_NAME, shift, notes=tuple(notes), **extra)


def format_rpc_geom(model: RpcModel) -> str:
    """Return the text of a model as a keyword list with all digits; unknown errors are 0.

    The program shareloc recognises the file by the beginning of its type; OTB recognises
    it by the keys of the coefficients.
    """
    values = {"type": "ossimRpcModel", "polynomial_format": "B", **dict.fromkeys(_OSSIM_ERRORS, "0")}
    names = {name: key for key, name in _OSSIM_ERRORS.items()}
    for name, text in texts_of(model).items():
        stem = names.get(name, name.lower())
        words = text.split()
        values |= {f"{stem}_{k:02d}": word for k, word in enumerate(words)} if len(words) > 1 else {stem: text}
    sizes = {"number_lines": model.n_lines, "number_samples": model.n_samples}
    values |= {key: str(size) for key, size in sizes.items() if size is not None}
    return "".join(f"{key}:  {value}\n" for key, value in sorted(values.items()))


GEOM_FORMAT = Format(
    name="ossim-geom", title=GEOM_NAME, suffixes=(".geom",), read_rpc=read_rpc_geom,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_geom(model).encode("ascii")),
    sniff=has_line("(?:line_num_coeff_0?0|line_den_coeff_0?0|polynomial_format)\\s*:"),
)  # fmt: skip
RPB_FORMAT = Format(
    name="rpb", title=RPB_NAME, suffixes=(".rpb",), sniff=has_line("(?:lineOffset|lineNumCoef)\\s*="),
    read_rpc=read_rpc_rpb,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_rpb(model).encode("ascii")),
)  # fmt: skip
ISD_FORMAT = Format(
    name="digitalglobe-xml", title="DigitalGlobe XML", read_rpc=read_rpc_isd,
    sniff=lambda _, head: xml_root(head) == "isd",
)  # fmt: skip
FORMAT = Format(
    name="rpc-txt", title=NAME, suffixes=(".txt",),
    sniff=has_line("(?:LINE|SAMP|LAT|LONG|HEIGHT)_(?:OFF|SCALE)\\s*:"), read_rpc=read_rpc_text,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_text(model).encode("ascii")),
)  # fmt: skip
LIST_FORMAT = Format(
    name="rpc-list", title=LIST_NAME, sniff=lambda _, head: _NUMBERS.match(head) is not None,
    read_rpc=read_rpc_list,
)  # fmt: skip
