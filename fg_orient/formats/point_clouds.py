"""Write point clouds with columns of numbers in LAS, LAZ or PLY files.

LAS has version 1.4 (ASPRS 2019), point format 6. Its coordinates are whole multiples of
0.1 mm or of 1e-9 degrees. The step is larger if the extent requires it. The CRS is WKT 1.
A line of text is written as the record "text area description". PLY (Turk 1994) is
binary, little-endian. Its coordinates are doubles; the CRS and the text are comments.
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

#: Step of the coordinates in LAS, m or degrees.
STEP: Final = {"metre": 1e-4, "degree": 1e-9}
#: Largest whole number of a coordinate in LAS.
LARGEST: Final = 2**31 - 1
#: Number of the LAS record "text area description".
TEXT_RECORD: Final = 3
#: Names of numpy types in PLY.
PLY_TYPES: Final = {"f8": "double", "f4": "float", "u1": "uchar", "u2": "ushort", "u4": "uint"}

Columns = Mapping[str, npt.NDArray[Any]]


def library(file: Path) -> Any:
    """Import laspy.

    Raise InputError if laspy or the package for LAZ compression is not installed.
    """
    try:
        import laspy
        import lazrs  # noqa: F401  # laspy looks for it
    except ImportError as error:
        raise InputError.of("cloud.no_laspy", file=file) from error
    return laspy


def write_las(
    path: Path, coordinates: Array, columns: Columns, *, wkt: str, unit: str, text: str, made: date, program: str
) -> None:
    """Write a LAS or LAZ file; the suffix of the name decides.

    Parameters
    ----------
    path : Path
    coordinates : (n, 3) array
        Coordinates in m; or longitude and latitude in degrees, height in m.
    columns : mapping
        Extra dimensions: names of at most 31 characters, and numbers (n,) of a type in ``PLY_TYPES``.
    wkt : str
        Definition of the CRS; "" if there is no CRS.
    unit : str
        Unit of the first two coordinates: ``metre`` or ``degree``.
    text : str
    made : date
    program : str
        Program that computed the points; at most 31 characters.
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
    """Choose the offsets (3,), whole numbers, and the steps (3,), powers of ten, of LAS for coordinates (n, 3)."""
    low, high = coordinates.min(axis=0), coordinates.max(axis=0)
    offset = np.floor(0.5 * (low + high))
    farthest = np.maximum(high - offset, offset - low)
    needed = 10.0 ** np.ceil(np.log10(np.maximum(farthest, 1e-9) / LARGEST))
    return offset, np.maximum([STEP[unit], STEP[unit], STEP["metre"]], needed)


def write_ply(path: Path, coordinates: Array, columns: Columns, *, comments: Sequence[str]) -> None:
    """Write a binary PLY file with x, y, z and the columns as properties.

    A comment is one line of ASCII.
    """
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
