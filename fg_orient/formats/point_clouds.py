"""Point clouds: points with columns of numbers as LAS, LAZ or PLY.

LAS 1.4 (ASPRS 2019), point format 6: coordinates are whole multiples of a tenth of a millimetre or of 1e-9 degrees, or
of more if the extent needs it. The CRS is WKT 1; a line of text is the record "text area description". PLY (Turk 1994)
is binary, little-endian; coordinates are doubles; the CRS and the text are comments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import staged_file
from fg_orient.model.errors import InputError

#: Step of the coordinates in LAS, m or degrees, and the largest whole number.
STEP: Final = {"metre": 1e-4, "degree": 1e-9}
LARGEST: Final = 2**31 - 1
#: Record of a text in LAS: "text area description".
TEXT_RECORD: Final = 3
#: Names of types in PLY.
PLY_TYPES: Final = {"f8": "double", "f4": "float", "u1": "uchar", "u2": "ushort", "u4": "uint"}

Columns = Mapping[str, npt.NDArray[Any]]


def library(file: Path) -> Any:
    """Laspy, imported on demand; InputError if it or the compression of LAZ is missing."""
    try:
        import laspy
        import lazrs  # noqa: F401  # laspy finds it by itself
    except ImportError as error:
        raise InputError.of("cloud.no_laspy", file=file) from error
    return laspy


def write_las(
    path: Path, coordinates: Array, columns: Columns, *, wkt: str, unit: str, text: str, made: date, program: str
) -> None:
    """Write LAS or LAZ, by the end of the name.

    Parameters
    ----------
    path : Path
    coordinates : (n, 3) array
        m; or longitude, latitude in degrees and height in m.
    columns : mapping
        Names (at most 31 characters) and numbers (n,) of the extra dimensions, of the types of ``PLY_TYPES``.
    wkt : str
        Definition of the CRS; "" for none.
    unit : str
        Unit of the first two coordinates: ``metre`` or ``degree``.
    text : str
    made : date
    program : str
        Program that made the points, at most 31 characters.
    """
    laspy = library(path)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.creation_date, header.generating_software, header.system_identifier = made, program, ""
    header.offsets, header.scales = steps(coordinates, unit)
    header.add_extra_dims([laspy.ExtraBytesParams(name=name, type=values.dtype.str[1:])
                           for name, values in columns.items()])  # fmt: skip
    header.vlrs.append(laspy.VLR("LASF_Spec", TEXT_RECORD, "Text area description", text.encode()))
    if wkt:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
        header.global_encoding.wkt = True
    points = laspy.LasData(header)
    points.x, points.y, points.z = coordinates.T
    points.return_number[:] = points.number_of_returns[:] = points.classification[:] = 1
    for name, values in columns.items():
        points[name] = values
    with staged_file(path, suffix=path.suffix) as temporary, temporary.open("xb") as stream:
        points.write(stream, do_compress=path.suffix.lower() == ".laz")


def steps(coordinates: Array, unit: str) -> tuple[Array, Array]:
    """Offsets (3,), whole numbers, and steps (3,), powers of ten, of coordinates (n, 3) in LAS."""
    low, high = coordinates.min(axis=0), coordinates.max(axis=0)
    offset = np.floor(0.5 * (low + high))
    farthest = np.maximum(high - offset, offset - low)
    needed = 10.0 ** np.ceil(np.log10(np.maximum(farthest, 1e-9) / LARGEST))
    return offset, np.maximum([STEP[unit], STEP[unit], STEP["metre"]], needed)


def write_ply(path: Path, coordinates: Array, columns: Columns, *, comments: Sequence[str]) -> None:
    """Write binary PLY with the properties x, y, z and the columns; comments are single lines of ASCII."""
    values = {**dict(zip("xyz", coordinates.T, strict=True)), **columns}
    table = np.empty(len(coordinates), [(name, f"<{one.dtype.str[1:]}") for name, one in values.items()])
    for name, one in values.items():
        table[name] = one
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments),
             f"element vertex {len(table)}",
             *(f"property {PLY_TYPES[one.dtype.str[1:]]} {name}" for name, one in values.items()),
             "end_header"]  # fmt: skip
    with staged_file(path, suffix=path.suffix) as temporary, temporary.open("xb") as stream:
        stream.write("".join(f"{line}\n" for line in lines).encode("ascii", "replace"))
        table.tofile(stream)
