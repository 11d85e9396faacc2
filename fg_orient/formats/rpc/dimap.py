"""RPC in DIMAP: ``RPC_*.XML`` of Pléiades, SPOT 6/7 (version 2), Pléiades Neo (3), and the PHR_DIMAP of CNES (1).

A file has a model from image to ground ("direct") and a model from ground to image
("inverse"). Both use the same offsets and scales. Pléiades Neo uses the names
ImagetoGround_Values and GroundtoImage_Values.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from lxml import etree

from factors.arrays import Array
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
    printed,
    texts_of,
)
from fg_orient.formats.xml import XmlNode, element, read_xml
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.rpc import RpcModel, RpcValidity

#: For each profile: coordinate of the first pixel's centre in the model, and in its
#: validity domain. The readers of other programs do not agree for SPOT 6/7 and Pléiades
#: Neo. docs/rpc.md gives the reasons for these values.
FIRST_PIXEL: Final = {"PHR": (1.0, 1.0), "S6": (0.0, 1.0), "S7": (0.0, 1.0), "PNEO": (0.0, 0.0)}
#: Largest difference between both models without a note. Vendors fit both directions to 0.03 px.
AGREEMENT_PX: Final = 0.5


@dataclass(frozen=True)
class _Layout:
    """Names of the elements of both models.

    ``stems`` are the names of the coefficients of the model to the ground, longitude before latitude.
    """

    direct: str
    inverse: str
    stems: tuple[str, ...]

    @property
    def domains(self) -> tuple[str, str]:
        """Return the names of the validity elements in the image and on the ground."""
        image, ground = (name.removesuffix("_Values") for name in (self.direct, self.inverse))
        return f"{image}_Validity_Domain", f"{ground}_Validity_Domain"


LAYOUTS: Final = {
    "2": _Layout("Direct_Model", "Inverse_Model", ("SAMP_NUM", "SAMP_DEN", "LINE_NUM", "LINE_DEN")),
    "3": _Layout("ImagetoGround_Values", "GroundtoImage_Values", ("LON_NUM", "LON_DEN", "LAT_NUM", "LAT_DEN")),
}
#: Names of the offsets and scales in PHR_DIMAP.
V1_AXES: Final = {"LINE": "Row", "SAMP": "Col", "LONG": "Lon", "LAT": "Lat", "HEIGHT": "Alt"}
#: Names of the pairs of polynomials in PHR_DIMAP.
V1_PAIRS: Final = {"LINE": "F_ROW", "SAMP": "F_COL"}
V1_DIRECT: Final = ("F_LON", "F_LAT")
V1_NAME: Final = "DIMAP 1 PHR_DIMAP"
#: Version and profile for models from another format. Pixels are counted from 1.
USUAL: Final = ("2.15", "PHR_SENSOR")


def read_rpc_dimap(path: str | os.PathLike[str], reading: Reading) -> RpcModel:
    """Read the RPC of a DIMAP file of version 2 or 3."""
    root = read_xml(path)
    head = root.one("Metadata_Identification")
    version = head.one("METADATA_FORMAT").element.get("version", "")
    profile = head.one("METADATA_PROFILE").text()
    rfm, fields = root.one("Rational_Function_Model"), RpcFields(root.file, reading)
    order = rfm.maybe("Resource_Reference/RESOURCE_ID")
    if order is not None:
        fields.require_order(order.place, order.text())
    model = rfm.one("Global_RFM")
    layout = LAYOUTS["2" if model.maybe(LAYOUTS["2"].inverse) is not None else "3"]
    ranges, direct = model.one("RFM_Validity"), model.maybe(layout.direct)
    nodes = [ranges.one(f"{axis}_{word}") for axis in AXES for word in ("OFF", "SCALE")]
    _add(fields, [*nodes, *_coefficient_nodes(model.one(layout.inverse))])
    first, domain_first, notes = _origin(profile, ranges.one(layout.domains[0]))
    extra: dict[str, Any] = {"notes": notes}
    if direct is not None:
        coefficients = RpcFields(root.file, reading)
        _add(coefficients, _coefficient_nodes(direct))
        extra["direct"] = _direct(np.stack([coefficients.group(stem) for stem in layout.stems]), direct, reading)
    read = fields.model(f"DIMAP {version} {profile}", first, **extra)
    return _with_domain(read, ranges, layout.domains, domain_first)


def _coefficient_nodes(node: XmlNode) -> list[XmlNode]:
    """Return the elements ``LINE_NUM_COEFF_1`` etc."""
    return [child for child in node.children() if "_COEFF_" in child.tag]


def _add(fields: RpcFields, nodes: list[XmlNode]) -> None:
    for node in nodes:
        fields.add(node.tag, node.text(), node.place)


def _direct(rows: Array, node: XmlNode, reading: Reading) -> Array:
    """Read the coefficients (4, 20) to longitude and latitude, in our order.

    The denominators' constants become 1.
    """
    rows = rows[:, permutation(reading.order, USUAL_ORDER)]
    for k in (0, 2):
        if rows[k + 1, 0] == 0.0:
            raise InputError.of("rpc.denominator_constant", file=node.file, place=node.place, value="0")
        rows[k : k + 2] /= rows[k + 1, 0]
    return rows


def _origin(profile: str, domain: XmlNode) -> tuple[float, float, tuple[Finding, ...]]:
    """Return the first pixel of the model and of its domain, and a note if they are assumed."""
    for prefix, (model, of_domain) in FIRST_PIXEL.items():
        if profile.upper().startswith(prefix):
            return model, of_domain, ()
    first = domain.one("FIRST_ROW").number()
    first = first if first in (0.0, 1.0) else 1.0
    return first, first, (finding("rpc.first_pixel_assumed", profile=profile, first=first),)


def _with_domain(model: RpcModel, ranges: XmlNode, names: tuple[str, str], first: float) -> RpcModel:
    """Return the model with its stated validity.

    Some SPOT 6 files have longitude and latitude exchanged.
    """
    image, ground = ranges.one(names[0]), ranges.one(names[1])
    domain = {
        ours: (image.one(f"FIRST_{tag}").number() - first, image.one(f"LAST_{tag}").number() - first)
        for ours, tag in (("line", "ROW"), ("sample", "COL"))
    }
    for ours, tag in (("lon", "LON"), ("lat", "LAT")):
        ends = [ground.one(f"{end}_{tag}").number() for end in ("FIRST", "LAST")]
        domain[ours] = (min(ends), max(ends))
    notes, (lon, lat) = model.notes, model.offsets[[RANGE.lon, RANGE.lat]].tolist()
    if not _holds(domain, lon, lat) and _holds(domain, lat, lon):
        domain["lon"], domain["lat"] = domain["lat"], domain["lon"]
        notes += (finding("rpc.domain_exchanged"),)
    # the range of pixels is limited to offset -+ scale: a model fitted to a part of the image is valid only there
    low, high = ((model.offsets + sign * np.abs(model.scales)).tolist() for sign in (-1.0, 1.0))
    line, sample = (
        (max(domain[name][0], low[k]), min(domain[name][1], high[k])) for k, name in enumerate(("line", "sample"))
    )
    stated = RpcValidity(line, sample, domain["lon"], domain["lat"], (low[4], high[4]))
    whole = replace(model, stated_validity=stated)
    return replace(whole, notes=notes + _contradiction(whole))


def _contradiction(model: RpcModel) -> tuple[Finding, ...]:
    """Return a note with the largest difference of the file's two models in the image, if it exceeds the limit."""
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
    """Read the RPC of a PHR_DIMAP file of CNES.

    Each coordinate has 40 numbers, A is the scale and B the offset.
    """
    root = read_xml(path)
    model = root.one("Geoposition/Rational_Sensor_Model/Global_RFM")
    ranges, fields = model.one("RFM_Validity"), RpcFields(root.file, reading)
    for axis, name in V1_AXES.items():
        for word, tag in (("OFF", "B"), ("SCALE", "A")):
            node = ranges.one(f"{name}/{tag}")
            fields.add(f"{axis}_{word}", node.text(), node.place)
    for axis, name in V1_PAIRS.items():
        node = model.one(f"Inverse_Model/{name}")
        words = node.text().split()
        fields.take(f"{axis}_NUM_COEFF", " ".join(words[:20]), node.place)
        fields.take(f"{axis}_DEN_COEFF", " ".join(words[20:]), node.place)
    direct = model.one("Direct_Model")
    rows = np.vstack([direct.one(name).vector(40).reshape(2, 20) for name in V1_DIRECT])
    first, domain_first = FIRST_PIXEL["PHR"]
    read = fields.model(V1_NAME, first, direct=_direct(rows, direct, reading))
    return _with_domain(read, ranges, LAYOUTS["2"].domains, domain_first)


# --- writing -------------------------------------------------------------------------------------


def format_rpc_dimap(model: RpcModel) -> bytes:
    """Return the text of a DIMAP file with the model, with all digits.

    The file has the version and profile of the file from which the model was read; for
    other models, it has the version and profile of Pléiades. The model from image to ground is written
    if it is known.
    """
    words = model.format.split()
    version, profile = words[1:3] if words[:1] == ["DIMAP"] else USUAL
    prefix = next((p for p in FIRST_PIXEL if profile.upper().startswith(p)), None)
    if prefix is None:
        (version, profile), prefix = USUAL, "PHR"
    if model.format == V1_NAME:
        body = _body(model, replace(LAYOUTS["2"], stems=V1_DIRECT), tuple(V1_PAIRS.values()), *FIRST_PIXEL["PHR"])
        head = {"METADATA_PROFILE version=1.4": "PHR_SYSTEM_RECTIFIED_PRODUCT", "METADATA_FORMAT": "DIMAP_PHR"}
        content: dict[str, Any] = {"Geoposition": {"Rational_Sensor_Model": {"Global_RFM": body}}}
        root = element("PHR_Dimap_Document", {"Metadata_Identification": head, **content})
    else:
        body = _body(model, LAYOUTS[version[0]], POLYNOMIALS, *FIRST_PIXEL[prefix])
        head = {
            f"METADATA_FORMAT version={version}": "DIMAP", "METADATA_PROFILE": profile, "METADATA_SUBPROFILE": "RPC",
            "METADATA_LANGUAGE": "en",
        }  # fmt: skip
        reference = {"RESOURCE_TITLE version=2.1": "NITF", "RESOURCE_ID": USUAL_ORDER}
        content = {"Rational_Function_Model": {"Resource_Reference": reference, "Global_RFM": body}}
        root = element("Dimap_Document", {"Metadata_Identification": head, **content})
    return bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True))


def _body(
    model: RpcModel, layout: _Layout, stems: tuple[str, ...], first: float, domain_first: float
) -> dict[str, Any]:
    """Make the contents of ``Global_RFM``: both models, domains and ranges.

    PHR_DIMAP has pairs of polynomials.
    """
    v, texts = model.validity, texts_of(model, first)
    direct = {} if model.direct is None else {layout.direct: _coefficients(model.direct, layout.stems)}
    image, ground = dict[str, str](), dict[str, str]()
    for k, end in enumerate(("FIRST", "LAST")):
        image |= {
            f"{end}_ROW": printed([v.line[k] + domain_first]),
            f"{end}_COL": printed([v.sample[k] + domain_first]),
        }
        ground |= {f"{end}_LON": printed([v.lon_deg[k]]), f"{end}_LAT": printed([v.lat_deg[k]])}
    ranges: dict[str, Any] = dict(zip(layout.domains, (image, ground), strict=True))
    for axis, tag in V1_AXES.items():
        scale, offset = texts[f"{axis}_SCALE"], texts[f"{axis}_OFF"]
        pair = {f"{axis}_SCALE": scale, f"{axis}_OFF": offset}
        ranges |= {tag: {"A": scale, "B": offset}} if layout.stems == V1_DIRECT else pair
    return {**direct, layout.inverse: _coefficients(model.coefficients, stems), "RFM_Validity": ranges}


def _coefficients(rows: Array, stems: tuple[str, ...]) -> dict[str, str]:
    """Make the elements of four polynomials: one for each coefficient, or one for each of two pairs."""
    if len(stems) == 2:
        return {tag: printed(pair) for tag, pair in zip(stems, rows.reshape(2, 40), strict=True)}
    return {
        f"{stem}_COEFF_{k}": printed([value])
        for stem, row in zip(stems, rows, strict=True)
        for k, value in enumerate(row, 1)
    }


def is_rpc(head: str) -> bool:
    """Return whether a file that begins with ``head`` is a DIMAP RPC file of version 2 or 3."""
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
