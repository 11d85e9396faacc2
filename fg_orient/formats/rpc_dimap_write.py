"""RPC as DIMAP files: ``RPC_*.XML`` of version 2 or 3, or the RPC part of a PHR_DIMAP (1)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from lxml import etree

from fg_orient.formats.rpc_dimap import (
    DIRECT,
    DIRECT_STEMS,
    DOMAINS,
    FIRST_PIXEL,
    INVERSE,
    V1_AXES,
    V1_DIRECT,
    V1_NAME,
    V1_PAIRS,
)
from fg_orient.formats.rpc_fields import AXES, POLYNOMIALS, USUAL_ORDER, printed
from fg_orient.sensors.rpc import RpcModel

Array = npt.NDArray[np.float64]

#: Version and profile of models that come from another format: pixels counted from 1.
USUAL = ("2.15", "PHR_SENSOR")


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
