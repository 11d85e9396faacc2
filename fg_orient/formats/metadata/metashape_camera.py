"""Read an interior orientation and its covariance matrix from a camera file of Metashape (*Export Cameras*, XML).

``chunk/sensors/sensor`` contains a ``calibration`` of class "adjusted". It has the size
of the image and the values of f, cx, cy, b1, b2, k1 to k4, p1, p2; values that are 0 are
missing. It may also have a ``covariance`` with the names ``params`` and the elements
``coeffs`` of the matrix, row by row. A value that is not among the names was not
estimated, and its variance is 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.xml import XmlNode, read_xml

#: Names of the values in the convention "metashape".
NAMES: Final = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
LARGEST_SIDE: Final = 1_000_000


def read_metashape_camera(path: str | Path) -> dict[str, object]:
    """Read the file and return the entries of a camera file in the convention "metashape".

    Raises
    ------
    InputError
        The file has no frame sensor with an adjusted calibration, or has several; a value
        is not a number; or the covariance matrix does not fit its names.
    """
    group = read_xml(path).one("chunk/sensors")
    found = [(s, c) for s in group.every("sensor") if (c := _adjusted(s)) is not None]
    if len(found) != 1:
        raise group.fault("metashape.sensors", ", ".join(s.element.get("label", "?") for s, _ in found) or "none")
    ((sensor, calibration),) = found
    if (kind := calibration.element.get("type", "frame")) != "frame":
        raise calibration.fault("metashape.kind", kind)
    size = calibration.one("resolution")
    values = {name: 0.0 if (node := calibration.maybe(name)) is None else node.number() for name in NAMES}
    entries: dict[str, object] = {
        "schema": 1, "name": sensor.element.get("label") or "camera", "convention": "metashape",
        "lines": _side(size, "height"), "samples": _side(size, "width"), "values": values,
    }  # fmt: skip
    matrix = sensor.maybe("covariance")
    return entries if matrix is None else entries | {"covariance": _covariance(matrix).tolist()}


def _adjusted(sensor: XmlNode) -> XmlNode | None:
    """Return the adjusted calibration of a sensor."""
    return next((c for c in sensor.every("calibration", at_least=0) if c.element.get("class") == "adjusted"), None)


def _side(size: XmlNode, name: str) -> int:
    """Read the number of lines or samples."""
    text = size.element.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 10 and 0 < int(text) <= LARGEST_SIDE):
        raise size.fault("metashape.size", f"{name} = {text!r}")
    return int(text)


def _covariance(node: XmlNode) -> Array:
    """Return the covariance matrix (11, 11) of all values."""
    names = node.one("params").text().split()
    unknown = [name for name in names if name not in NAMES]
    if unknown or len(set(names)) != len(names):
        raise node.one("params").fault("metashape.params", " ".join(unknown or names))
    given = node.one("coeffs").vector(len(names) ** 2).reshape(len(names), len(names))
    place = [NAMES.index(name) for name in names]
    out = np.zeros((len(NAMES),) * 2)
    out[np.ix_(place, place)] = 0.5 * (given + given.T)
    return out
