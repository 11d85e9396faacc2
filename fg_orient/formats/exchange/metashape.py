"""Markers of Metashape: the reference table, and the XML file of *Export Markers* with positions in the images.

The table has commas as separators. Users of Metashape choose its columns. Our writer
writes a line ``# CoordinateSystem:`` and the columns
``#Label,Enable,X,Y,Z,Accuracy_X_(m),Accuracy_Y_(m),Accuracy_Z_(m)``. The reader accepts
any header with known names. The accuracy may also be in one column: ``0.02``, or
``0.02/0.05`` (horizontal and vertical). X is longitude or easting. An enabled marker is a
control point, and a disabled marker is a check point. A marker without coordinates is a
tie point.

In the XML file, ``markers/marker`` contains a label and a ``reference`` with x, y, z,
standard deviations (``sx sy sz``, ``sxy sz`` or ``sxyz``) and ``enabled``.
``frames/frame/markers/marker`` contains the ``location`` of a marker in each camera. x
and y count from the corner of the first pixel, so that its centre is (0.5, 0.5).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from lxml import etree
from lxml.builder import E  # type: ignore[import-not-found]

from fg_orient.formats.atomic import write_bytes, write_lines
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.exchange.text import digits, named, numbers, row_of, separator_of, sigma, stated_in
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Row
from fg_orient.formats.text_files import delimited, read_text
from fg_orient.formats.xml import XmlNode, read_xml
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import Role

#: Known names of the columns, in lower case, without units, blanks and underscores.
_NAMES: Final = {
    "label": ("label", "name", "marker", "markers", "point"),
    "x": ("x", "x/longitude", "x/easting", "longitude", "easting"),
    "y": ("y", "y/latitude", "y/northing", "latitude", "northing"),
    "z": ("z", "z/altitude", "z/elevation", "z/height", "altitude", "elevation", "height"),
    "enabled": ("enable", "enabled"),
    "accuracy": ("accuracy",),
    "sx": ("accuracyx", "xaccuracy", "accuracyx/longitude", "accuracyx/easting"),
    "sy": ("accuracyy", "yaccuracy", "accuracyy/latitude", "accuracyy/northing"),
    "sz": ("accuracyz", "zaccuracy", "accuracyz/altitude"),
}
_COLUMN: Final = {name: column for column, names in _NAMES.items() for name in names}
_NEEDED: Final = ("label", "x", "y", "z")
_COLUMNS_SIGMA: Final = ("sx", "sy", "sz")
_ASIDE: Final = re.compile(r"\([^()]*+\)|[\s_]")
_CRS: Final = re.compile(r"^#\s*CoordinateSystem:\s*(.+)$", re.MULTILINE)
_HEADER: Final = (
    "#Label", "Enable", "X", "Y", "Z", "Accuracy_X_(m)", "Accuracy_Y_(m)", "Accuracy_Z_(m)",
)  # fmt: skip
_OFF: Final = ("0", "false", "no")


def read_table(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a reference table of markers."""
    path = paths[0]
    gathered = Gathering(path, settings.crs, stated_in(path, _CRS))
    faults = gathered.faults
    text = read_text(path, faults) or ""
    lines = list(enumerate(text.split("\n"), start=1))
    start, mark, columns, ignored = _header(lines, path)
    for n, line in lines[start:]:
        cells = None if not line.strip() or line.startswith("#") else delimited(n, line, faults, mark=mark)
        if cells and len(cells) > len(columns):
            value = f"{len(cells)} cells"
            faults.add("interchange.cell_count", place=f"line {n}", value=value, expected=f"up to {len(columns)}")
        elif cells:
            _take_row(gathered, named(n, cells, columns))
    gathered.notes += (finding("points.columns_ignored", columns=ignored),) if ignored else ()
    return gathered.finished()


def _header(lines: list[tuple[int, str]], path: Path) -> tuple[int, str, list[str], list[str]]:
    """Return the number of the header line, the separator, the columns, and the names of columns that are not read."""
    first = "an empty file"
    for n, line in lines:
        mark = separator_of(line)
        given = [cell.strip().strip('"') for cell in line.lstrip("#").split(mark)]
        columns = [_COLUMN.get(_ASIDE.sub("", cell.lower()), f"unread {k}") for k, cell in enumerate(given)]
        if "label" in columns and len(given) > 1:
            for column in _NEEDED:
                if columns.count(column) != 1:
                    raise InputError.of(
                        "interchange.columns", file=path, place=f"line {n}", value=line.strip(), column=column
                    )
            return n, mark, columns, [name for name, column in zip(given, columns, strict=True) if " " in column]
        if line.strip() and not line.startswith("#"):
            first = line.strip()
            break
    raise InputError.of("interchange.columns", file=path, place="header", value=first, column="label")


def _take_row(gathered: Gathering, row: Row) -> None:
    """Add one marker of the table to the survey."""
    faults = gathered.faults
    if not any(row.cells[column] for column in ("x", "y", "z")):
        gathered.point(row.cells["label"], Role.TIE, UNKNOWN, line=row.line)
        return
    role = Role.CHECK if row.cells.get("enabled", "").lower() in _OFF else Role.CONTROL
    if all(column in row.cells for column in _COLUMNS_SIGMA):
        sigmas = tuple(sigma(row, column, "m", faults) for column in _COLUMNS_SIGMA)
    else:
        across, _, up = row.cells.get("accuracy", "").partition("/")
        both = Row(row.line, {"accuracy": across.strip(), "accuracy z": (up or across).strip()})
        horizontal = sigma(both, "accuracy", "m", faults)
        sigmas = horizontal, horizontal, sigma(both, "accuracy z", "m", faults)
    gathered.point(row.cells["label"], role, numbers(row, ("x", "y", "z"), faults), sigmas, line=row.line)


def write_table(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write all markers to a reference table."""
    lines = [f"# CoordinateSystem: {wkt(survey.crs)}", ",".join(_HEADER)]
    for name, role, xyz, sigmas, located in zip(
        survey.ids, survey.roles, survey.coordinates, survey.sigma_enu_m, survey.located, strict=True
    ):
        cells = [digits(v) if located and np.isfinite(v) else "" for v in (*xyz, *sigmas)]
        lines.append(row_of([name, "0" if role is Role.CHECK else "1", *cells]))
    write_lines(paths[0], lines)


TABLE = Format(
    name="metashape-csv",
    title="Metashape reference table of markers (CSV)",
    suffixes=(".csv",),
    files=("markers",),
    ground_axes="longitude or easting, latitude or northing, height (m), by column name",
    holds=frozenset(Holds) - {Holds.IMAGE, Holds.IMAGES, Holds.SIGMA_IMAGE, Holds.FIXED},
    needs=frozenset({Holds.HEIGHTS}),
    read=read_table,
    write=write_table,
)


# --- XML -----------------------------------------------------------------------------------------

#: Coordinate of the first pixel's centre in the XML file.
CENTRE_PX: Final = 0.5
_XYZ: Final = ("x", "y", "z")
_SIGMAS: Final = (("sx", "sy", "sz"), ("sxy", "sxy", "sz"), ("sxyz", "sxyz", "sxyz"))
_FALSE: Final = ("false", "0")


def read_markers(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the markers of an XML file with one chunk and one frame."""
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
    """Return the labels by their ids; cameras may be nested in groups."""
    parent = chunk.maybe(group)
    elements = [] if parent is None else parent.element.iter(name)
    return {element.get("id", ""): element.get("label", "") for element in elements}


def _row(node: XmlNode) -> Row:
    """Return the attributes of an element as a record."""
    cells = {str(name): str(value).strip() for name, value in node.element.attrib.items()}
    line: Any = node.element.sourceline
    return Row(int(line or 0), cells)


def _take(gathered: Gathering, marker: XmlNode) -> None:
    """Add a marker: as control or check point if it has coordinates, otherwise as tie point."""
    label, line = marker.element.get("label", ""), _row(marker).line
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
    """Add the image points of a marker, except those that are marked as not valid."""
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


def write_markers(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write an XML file with all markers and their positions in the images."""
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
    """Make the element of a marker; it has a reference if the marker has coordinates."""
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
    read=read_markers,
    write=write_markers,
)
