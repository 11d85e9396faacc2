"""Markers of Metashape with their positions in the images: the XML of *Export Markers*.

``markers/marker`` has a label and a ``reference`` with x, y, z (longitude or easting first), standard deviations
(``sx sy sz``, ``sxy sz`` or ``sxyz``) and ``enabled``: a control point if true, else a check point.
``frames/frame/markers/marker`` contains the ``location`` of a marker in each camera. x and y count from the corner of
the first pixel, whose centre is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from lxml import etree
from lxml.builder import E  # type: ignore[import-not-found]

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.exchange.text import digits, numbers, sigma
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Row
from fg_orient.formats.xml import XmlNode, read_xml
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Coordinate of the centre of the first pixel.
CENTRE_PX: Final = 0.5
_XYZ: Final = ("x", "y", "z")
_SIGMAS: Final = (("sx", "sy", "sz"), ("sxy", "sxy", "sz"), ("sxyz", "sxyz", "sxyz"))
_FALSE: Final = ("false", "0")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read markers of one chunk and one frame."""
    path = paths[0]
    chunk = read_xml(path).one("chunk")
    reference = chunk.maybe("reference")
    stated = (reference.element.text or "") if reference is not None else ""
    gathered = Gathering(path, settings.crs, stated)
    cameras, labels = _labels(chunk, "cameras", "camera"), _labels(chunk, "markers", "marker")
    for marker in _children(chunk.maybe("markers"), "marker"):
        _take(gathered, marker)
    frame = chunk.maybe("frames/frame")
    for marker in _children(frame.maybe("markers") if frame is not None else None, "marker"):
        _locate(gathered, marker, cameras, labels)
    return gathered.finished()


def _children(parent: XmlNode | None, name: str) -> Sequence[XmlNode]:
    return [] if parent is None else parent.every(name, at_least=0)


def _labels(chunk: XmlNode, group: str, name: str) -> dict[str, str]:
    """Labels by id; cameras may be nested in groups."""
    parent = chunk.maybe(group)
    elements = [] if parent is None else parent.element.iter(name)
    return {element.get("id", ""): element.get("label", "") for element in elements}


def _row(node: XmlNode) -> Row:
    """Attributes of an element as a record."""
    cells = {str(name): str(value).strip() for name, value in node.element.attrib.items()}
    return Row(_line(node), cells)


def _line(node: XmlNode) -> int:
    """Line of an element in its file."""
    line: Any = node.element.sourceline
    return int(line or 0)


def _take(gathered: Gathering, marker: XmlNode) -> None:
    """Take a marker: with coordinates a control or check point, else a tie point."""
    label, line = marker.element.get("label", ""), _line(marker)
    node = marker.maybe("reference")
    row = Row(line, {}) if node is None else _row(node)
    if not all(name in row.cells for name in _XYZ):
        gathered.point(label, Role.TIE, UNKNOWN, line=line)
        return
    role = Role.CHECK if row.cells.get("enabled", "true").lower() in _FALSE else Role.CONTROL
    names = next((names for names in _SIGMAS if all(name in row.cells for name in names)), ())
    sigmas = tuple(sigma(row, name, "m", gathered.faults) for name in names) or UNKNOWN
    gathered.point(label, role, numbers(row, _XYZ, gathered.faults), sigmas, line=line)


def _locate(gathered: Gathering, marker: XmlNode, cameras: dict[str, str], labels: dict[str, str]) -> None:
    """Take the image points of a marker; those marked as not valid are left out."""
    key = marker.element.get("marker_id", "")
    if key not in labels:
        raise marker.fault("interchange.unknown_camera", f"marker_id {key}")
    for node in _children(marker, "location"):
        row = _row(node)
        camera = row.cells.get("camera_id", "")
        if camera not in cameras:
            raise node.fault("interchange.unknown_camera", f"camera_id {camera}")
        if row.cells.get("valid", "true").lower() in _FALSE:
            continue
        x, y = numbers(Row(row.line, {"x": "", "y": "", **row.cells}), ("x", "y"), gathered.faults)
        gathered.measure(cameras[camera], labels[key], y - CENTRE_PX, x - CENTRE_PX, line=row.line)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write all markers and their positions in the images."""
    for name in (*survey.ids, *survey.images):
        if not name.isprintable():
            raise InputError.of("interchange.xml_name", file=paths[0], value=repr(name))
    o = survey.observed
    places = {p: E.marker(marker_id=str(p)) for p in dict.fromkeys(o.point.tolist())}
    for i, p, line, sample in zip(o.image.tolist(), o.point.tolist(), o.line, o.sample, strict=True):
        x, y = digits(sample + CENTRE_PX), digits(line + CENTRE_PX)
        places[p].append(E.location(camera_id=str(i), pinned="true", x=x, y=y))
    root = E.document(E.chunk(
        E.cameras(*(E.camera(id=str(k), label=name) for k, name in enumerate(survey.images))),
        E.markers(*(_marker(survey, k) for k in range(len(survey.ids)))),
        E.frames(E.frame(E.markers(*places.values()), id="0")), E.reference(wkt(survey.crs)),
    ), version="1.2.0")  # fmt: skip
    write_bytes(paths[0], etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True))


def _marker(survey: Survey, k: int) -> Any:
    """Element of a marker, with its reference if it has coordinates."""
    marker = E.marker(id=str(k), label=survey.ids[k])
    if survey.located[k]:
        values = dict(zip(_XYZ, survey.coordinates[k], strict=True))
        if np.isfinite(survey.sigma_enu_m[k]).all():
            values |= dict(zip(_SIGMAS[0], survey.sigma_enu_m[k], strict=True))
        enabled = "false" if survey.roles[k] is Role.CHECK else "true"
        marker.append(E.reference({name: digits(value) for name, value in values.items()}, enabled=enabled))
    return marker


FORMAT = Format(
    name="metashape-xml",
    title="Metashape markers (XML)",
    suffixes=(".xml",),
    files=("markers",),
    first_pixel=(CENTRE_PX, CENTRE_PX),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset(Holds) - {Holds.SIGMA_IMAGE, Holds.FIXED},
    needs=frozenset({Holds.HEIGHTS}),
    read=read,
    write=write,
)
