"""RPC in DIMAP: ``RPC_*.XML`` of Pléiades, SPOT 6/7 (version 2), Pléiades Neo (3), and the PHR_DIMAP of CNES (1).

The models to the ground ("direct") and to the image ("inverse") use the same offsets and scales;
Pléiades Neo names them ImagetoGround_Values and GroundtoImage_Values.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from lxml import etree

from factors.cameras.rfm import permutation
from factors.cameras.rfm_project import RANGE
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.rpc.fields import (
    AXES,
    POLYNOMIALS,
    USUAL_ORDER,
    Reading,
    RpcFields,
    build,
    printed,
    require_order,
    validity,
)
from fg_orient.formats.xml import XmlNode, read_xml
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.rpc import RpcModel

Array = npt.NDArray[np.float64]

#: Profile -> pixel coordinate of the first pixel's centre in the model and in its validity domain. The
#: readers of other programs disagree on SPOT 6/7 and Pléiades Neo; docs/rpc.md says how this was decided.
FIRST_PIXEL: Final = {"PHR": (1.0, 1.0), "S6": (0.0, 1.0), "S7": (0.0, 1.0), "PNEO": (0.0, 0.0)}
#: Vendors fit both directions to 0.03 px.
AGREEMENT_PX: Final = 0.5
#: Elements of the two models, and those of their validity, by version.
DIRECT: Final = {"2": "Direct_Model", "3": "ImagetoGround_Values"}
INVERSE: Final = {"2": "Inverse_Model", "3": "GroundtoImage_Values"}
DOMAINS: Final = {
    "2": ("Direct_Model_Validity_Domain", "Inverse_Model_Validity_Domain"),
    "3": ("ImagetoGround_Validity_Domain", "GroundtoImage_Validity_Domain"),
}
#: Stems of the model to the ground, longitude before latitude.
DIRECT_STEMS: Final = {
    "2": ("SAMP_NUM", "SAMP_DEN", "LINE_NUM", "LINE_DEN"),
    "3": ("LON_NUM", "LON_DEN", "LAT_NUM", "LAT_DEN"),
}
#: PHR_DIMAP: elements of offset and scale, and those of the polynomial pairs.
V1_AXES: Final = {"LINE": "Row", "SAMP": "Col", "LONG": "Lon", "LAT": "Lat", "HEIGHT": "Alt"}
V1_PAIRS: Final = {"LINE": "F_ROW", "SAMP": "F_COL"}
V1_DIRECT: Final = ("F_LON", "F_LAT")
V1_NAME: Final = "DIMAP 1 PHR_DIMAP"
#: Version and profile of models that come from another format: pixels counted from 1.
USUAL: Final = ("2.15", "PHR_SENSOR")


def read_rpc_dimap(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of a DIMAP file of version 2 or 3."""
    root = read_xml(path)
    head = root.one("Metadata_Identification")
    version = head.one("METADATA_FORMAT").element.get("version", "")
    profile = head.one("METADATA_PROFILE").text()
    rfm = root.one("Rational_Function_Model")
    order = rfm.maybe("Resource_Reference/RESOURCE_ID")
    if order is not None:
        require_order(root.file, order.place, order.text(), reading)
    model = rfm.one("Global_RFM")
    v = "2" if model.maybe(INVERSE["2"]) is not None else "3"
    ranges, fields = model.one("RFM_Validity"), RpcFields(root.file)
    for axis in AXES:
        for word in ("OFF", "SCALE"):
            node = ranges.one(f"{axis}_{word}")
            fields.add(f"{axis}_{word}", node.text(), node.place)
    _add_coefficients(fields, model.one(INVERSE[v]))
    first, domain_first, notes = _origin(profile, ranges.one(DOMAINS[v][0]))
    direct = model.maybe(DIRECT[v])
    extra: dict[str, Any] = {"notes": notes}
    if direct is not None:
        extra["direct"] = _direct(direct, DIRECT_STEMS[v], reading)
    return _with_domain(
        build(fields, reading, f"DIMAP {version} {profile}", first, extra), ranges, DOMAINS[v], domain_first
    )


def _add_coefficients(fields: RpcFields, node: XmlNode) -> None:
    """Take the elements ``LINE_NUM_COEFF_1`` and so on."""
    for child in node.children():
        if "_COEFF_" in child.tag:
            fields.add(child.tag, child.text(), child.place)


def _direct(node: XmlNode, stems: tuple[str, ...], reading: Reading) -> Array:
    """Coefficients to longitude and latitude: (4, 20), constants of denominators 1."""
    fields = RpcFields(node.file)
    _add_coefficients(fields, node)
    order = permutation(reading.order, USUAL_ORDER)
    rows = np.stack([fields.group(stem) for stem in stems])[:, order]
    return _of_unit_constant(rows, node)


def _of_unit_constant(rows: Array, node: XmlNode) -> Array:
    """Scale both pairs so that the denominators' constants are 1; some programs leave 0.9996."""
    for k in (0, 2):
        if rows[k + 1, 0] == 0.0:
            raise InputError.of("rpc.denominator_constant", file=node.file, place=node.place, value="0")
        rows[k : k + 2] /= rows[k + 1, 0]
    return rows


def _origin(profile: str, domain: XmlNode) -> tuple[float, float, tuple[Finding, ...]]:
    """First pixel of the model and of its domain, and what to say about it."""
    for prefix, (model, of_domain) in FIRST_PIXEL.items():
        if profile.upper().startswith(prefix):
            return model, of_domain, ()
    first = domain.one("FIRST_ROW").number()
    first = first if first in (0.0, 1.0) else 1.0
    return first, first, (finding("rpc.first_pixel_assumed", profile=profile, first=first),)


def _with_domain(model: RpcModel, ranges: XmlNode, names: tuple[str, str], first: float) -> RpcModel:
    """Give the model its stated validity; some SPOT 6 files have longitude and latitude exchanged."""
    image, ground = ranges.one(names[0]), ranges.one(names[1])
    domain = {
        ours: (image.one(f"FIRST_{tag}").number() - first, image.one(f"LAST_{tag}").number() - first)
        for ours, tag in (("line", "ROW"), ("sample", "COL"))
    }
    for ours, tag in (("lon", "LON"), ("lat", "LAT")):
        ends = [ground.one(f"{end}_{tag}").number() for end in ("FIRST", "LAST")]
        domain[ours] = (min(ends), max(ends))
    notes = model.notes
    lon, lat = float(model.offsets[RANGE.lon]), float(model.offsets[RANGE.lat])
    if not _holds(domain, lon, lat) and _holds(domain, lat, lon):
        domain["lon"], domain["lat"] = domain["lat"], domain["lon"]
        notes += (finding("rpc.domain_exchanged"),)
    whole = replace(model, stated_validity=validity(model.offsets, model.scales, domain))
    return replace(whole, notes=notes + _contradiction(whole))


def _contradiction(model: RpcModel) -> tuple[Finding, ...]:
    """Say by how much the file's two models disagree inside the image, if that can be seen in pixels."""
    if model.direct is None:
        return ()
    v = model.validity
    ends = (v.line, v.sample, v.height_m)
    line, sample, h = (a.ravel() for a in np.meshgrid(*(np.linspace(low, high, 5) for low, high in ends)))
    back = np.stack(model.project(*model.locate_directly(line, sample, h), h))
    worst = float(np.nanmax(np.abs(back - [line, sample])))
    if worst <= AGREEMENT_PX:
        return ()
    return (finding("rpc.contradiction", largest_px=worst),)


def _holds(domain: dict[str, tuple[float, float]], lon: float, lat: float) -> bool:
    return domain["lon"][0] <= lon <= domain["lon"][1] and domain["lat"][0] <= lat <= domain["lat"][1]


def read_rpc_dimap1(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of a PHR_DIMAP file of CNES: 40 numbers for each coordinate, A scale and B offset."""
    root = read_xml(path)
    model = root.one("Geoposition/Rational_Sensor_Model/Global_RFM")
    ranges, fields = model.one("RFM_Validity"), RpcFields(root.file)
    for axis, name in V1_AXES.items():
        for word, tag in (("OFF", "B"), ("SCALE", "A")):
            node = ranges.one(f"{name}/{tag}")
            fields.add(f"{axis}_{word}", node.text(), node.place)
    for axis, name in V1_PAIRS.items():
        node = model.one(f"Inverse_Model/{name}")
        words = node.text().split()
        fields.add_group(f"{axis}_NUM", words[:20], node.place)
        fields.add_group(f"{axis}_DEN", words[20:], node.place)
    order = permutation(reading.order, USUAL_ORDER)
    direct = model.one("Direct_Model")
    rows = np.vstack([direct.one(name).vector(40).reshape(2, 20) for name in V1_DIRECT])[:, order]
    first, domain_first = FIRST_PIXEL["PHR"]
    read = build(fields, reading, V1_NAME, first, {"direct": _of_unit_constant(rows, direct)})
    return _with_domain(read, ranges, DOMAINS["2"], domain_first)


# --- writing -------------------------------------------------------------------------------------


def format_rpc_dimap(model: RpcModel) -> bytes:
    """Give a model as a DIMAP file of the version and profile it was read from, else of Pléiades.

    Coefficients to the ground are written if the model has them; all digits are kept.
    """
    if model.format == V1_NAME:
        return _format_1(model)
    words = model.format.split()
    version, profile = words[1:3] if words[:1] == ["DIMAP"] else USUAL
    prefix = next((p for p in FIRST_PIXEL if profile.upper().startswith(p)), None)
    if prefix is None:
        (version, profile), prefix = USUAL, "PHR"
    v, (first, domain_first) = version[0], FIRST_PIXEL[prefix]
    root = etree.Element("Dimap_Document")
    head = etree.SubElement(root, "Metadata_Identification")
    etree.SubElement(head, "METADATA_FORMAT", version=version).text = "DIMAP"
    _texts(head, METADATA_PROFILE=profile, METADATA_SUBPROFILE="RPC", METADATA_LANGUAGE="en")
    rfm = etree.SubElement(root, "Rational_Function_Model")
    reference = etree.SubElement(rfm, "Resource_Reference")
    etree.SubElement(reference, "RESOURCE_TITLE", version="2.1").text = "NITF"
    _texts(reference, RESOURCE_ID=USUAL_ORDER)
    body = etree.SubElement(rfm, "Global_RFM")
    if model.direct is not None:
        _coefficients(etree.SubElement(body, DIRECT[v]), model.direct, DIRECT_STEMS[v])
    _coefficients(etree.SubElement(body, INVERSE[v]), model.coefficients, POLYNOMIALS)
    ranges = etree.SubElement(body, "RFM_Validity")
    _domains(ranges, model, DOMAINS[v], domain_first)
    for k, axis in enumerate(AXES):
        shift = first if k < 2 else 0.0
        _texts(ranges, **{
            f"{axis}_SCALE": printed(model.scales[k]), f"{axis}_OFF": printed(model.offsets[k] + shift),
        })  # fmt: skip
    return _bytes(root)


def _texts(parent: etree._Element, **texts: str) -> None:
    for tag, text in texts.items():
        etree.SubElement(parent, tag).text = text


def _coefficients(parent: etree._Element, rows: Array, stems: tuple[str, ...]) -> None:
    for stem, row in zip(stems, rows, strict=True):
        _texts(parent, **{f"{stem}_COEFF_{k}": printed(value) for k, value in enumerate(row, 1)})


def _domains(parent: etree._Element, model: RpcModel, names: tuple[str, str], first: float) -> None:
    v = model.validity
    image, ground = (etree.SubElement(parent, name) for name in names)
    for k, end in enumerate(("FIRST", "LAST")):
        _texts(image, **{f"{end}_ROW": printed(v.line[k] + first), f"{end}_COL": printed(v.sample[k] + first)})
        _texts(ground, **{f"{end}_LON": printed(v.lon_deg[k]), f"{end}_LAT": printed(v.lat_deg[k])})


def _format_1(model: RpcModel) -> bytes:
    """Give the RPC part of a PHR_DIMAP file."""
    first, domain_first = FIRST_PIXEL["PHR"]
    root = etree.Element("PHR_Dimap_Document")
    head = etree.SubElement(root, "Metadata_Identification")
    etree.SubElement(head, "METADATA_PROFILE", version="1.4").text = "PHR_SYSTEM_RECTIFIED_PRODUCT"
    _texts(head, METADATA_FORMAT="DIMAP_PHR")
    body = root
    for tag in ("Geoposition", "Rational_Sensor_Model", "Global_RFM"):
        body = etree.SubElement(body, tag)
    if model.direct is not None:
        _pairs(etree.SubElement(body, "Direct_Model"), V1_DIRECT, model.direct)
    _pairs(etree.SubElement(body, "Inverse_Model"), tuple(V1_PAIRS.values()), model.coefficients)
    ranges = etree.SubElement(body, "RFM_Validity")
    _domains(ranges, model, DOMAINS["2"], domain_first)
    for k, axis in enumerate(AXES):
        pair = etree.SubElement(ranges, V1_AXES[axis])
        _texts(pair, A=printed(model.scales[k]), B=printed(model.offsets[k] + (first if k < 2 else 0.0)))
    return _bytes(root)


def _pairs(parent: etree._Element, tags: tuple[str, ...], rows: Array) -> None:
    for tag, pair in zip(tags, rows.reshape(2, 40), strict=True):
        _texts(parent, **{tag: " ".join(printed(value) for value in pair)})


def _bytes(root: etree._Element) -> bytes:
    return bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True))


def is_rpc(head: str) -> bool:
    """Tell whether a file that begins with ``head`` is a DIMAP RPC file of version 2 or 3."""
    if xml_root(head) != "Dimap_Document":
        return False
    sub = re.search(r"<METADATA_SUBPROFILE>\s*(\w+)", head)
    return sub[1] == "RPC" if sub else "<Rational_Function_Model" in head


FORMAT = Format(
    name="dimap", title="DIMAP 2 or 3 RPC XML", suffixes=(".xml",),
    sniff=lambda _, head: is_rpc(head), read_rpc=read_rpc_dimap,
    write_rpc=lambda path, model: write_bytes(path, format_rpc_dimap(model)),
)  # fmt: skip
PHR_FORMAT = Format(
    name="phr-dimap", title="PHR_DIMAP", read_rpc=read_rpc_dimap1,
    sniff=lambda _, head: xml_root(head) == "PHR_Dimap_Document",
)  # fmt: skip
