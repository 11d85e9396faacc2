"""Read lattices of lines of sight: ASTER XML from the Ames Stereo Pipeline, and a TOML description for others.

docs/line-scan.md describes both. In an ASTER file, ``WORLD_SIGHT_VECTOR`` contains
Earth-fixed directions at the pixels of ``LATTICE_POINT`` (sample, line). ``SAT_POS``
contains the position of the satellite for each row.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from factors.arrays import Array
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.metadata.pushbroom import RADIUS_M, ImageTable, LightTable
from fg_orient.formats.metadata.rpc_points import rpc_points
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.schema import FilePath, Table, Text, read_toml
from fg_orient.formats.tables import read_numbers
from fg_orient.formats.xml import XmlNode, read_xml
from fg_orient.model.errors import InputError
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.lattice import Lattice
from fg_orient.sensors.light_sizes import chosen, noted
from fg_orient.sensors.metadata import GeneralMetadata, LightEffects

#: Line period of ASTER's visible and near infrared telescopes, s; the file does not state it.
ASTER_LINE_S: Final = 2.199e-3
#: Pixels of the lattice are equal if they differ by less than this.
SAME_PX: Final = 1e-6
#: Maximum difference of the length of a direction from 1.
UNIT: Final = 1e-3
_KIND: Final = re.compile(r"""^[^\S\n]*+kind\s*=\s*["']lattice["']""", re.MULTILINE)
_DIRECTIONS: Final = ("line", "sample", "x", "y", "z")
_POSITIONS: Final = ("line", "x_m", "y_m", "z_m")


class GridTable(Table):
    """The ``[lattice]`` table."""

    directions: FilePath = Field(description="the path of the table of directions in quotes")
    positions: FilePath = Field(description="the path of the table of positions in quotes")
    line_period_s: Annotated[float, Field(strict=True, ge=1e-6, le=10.0)] = Field(
        description="seconds from one line to the next, 1e-6 to 10"
    )


class LatticeFile(Table):
    """Whole lattice description."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    kind: Literal["lattice"] = Field(description='kind = "lattice"')
    mission: Text = Field(description="the name of the satellite in quotes")
    instrument: str = Field(default="", description="the name of the instrument in quotes")
    image: ImageTable = Field(description="a table [image] with lines and samples")
    lattice: GridTable = Field(description="a table [lattice] with directions, positions and line_period_s")
    light: LightTable = Field(default_factory=LightTable, description="a table [light]")


def read_lattice_file(path: str | Path, light: tuple[str, ...] = ()) -> GeneralMetadata:
    """Read a lattice description and its two tables; their paths are relative to the description.

    Raises
    ------
    InputError
        The description or a table has faults; all faults of this file are listed. Or the
        tables are not a lattice of one camera.
    """
    path = Path(path)
    read = read_toml(path, LatticeFile)
    files = path.parent / read.lattice.directions, path.parent / read.lattice.positions
    cells, rows = read_numbers(files[0], [_DIRECTIONS])[0], read_numbers(files[1], [_POSITIONS])[0]
    line, sample, direction = _grid(cells, str(files[0]))
    if len(rows) != len(line) or np.abs(rows[:, 0] - line).max() > SAME_PX:
        raise InputError.of("lattice.rows (failure): positions must be given at the lines of the directions -> give a "
                            "position for each of {n} lines", file=files[1], place="column line",
                            value=f"{len(rows)} positions", n=len(line))  # fmt: skip
    lattice = Lattice(
        str(path), read.mission, read.instrument, "lattice description", read.image.lines, read.image.samples, line,
        sample, direction, _positions(rows[:, 1:], str(files[1])), read.lattice.line_period_s,
    )  # fmt: skip
    return lattice.metadata(chosen(light, LightEffects(**dict(read.light))))


def read_aster(path: str | Path, light: tuple[str, ...] = ()) -> GeneralMetadata:
    """Read the lattice of an ASTER band.

    Raises
    ------
    InputError
        A list is missing or damaged, or the directions are not a lattice of one camera.
    """
    root = read_xml(path)
    pixels = _rows(root.one("LATTICE_POINT"), 2)
    seen = root.one("WORLD_SIGHT_VECTOR")
    directions = _rows(seen, 3)
    if len(directions) != len(pixels):
        raise seen.fault("lattice.count", f"{len(directions)} directions", n=len(pixels), what="points")
    line, sample, direction = _grid(np.hstack([pixels[:, ::-1], directions]), root.file)
    where = root.one("SAT_POS")
    positions = _rows(where, 3)
    if len(positions) != len(line):
        raise where.fault("lattice.count", f"{len(positions)} positions", n=len(line), what="lines")
    size = [root.one(name).integer(2, checks.MAX_IMAGE_SIZE) for name in ("IMAGE_ROWS", "IMAGE_COLS")]
    name = root.maybe("RPB/SATID")
    lattice = Lattice(
        root.file, "ASTER", "" if name is None else name.text(), "ASTER lattice", size[0], size[1], line, sample,
        direction, _positions(positions, root.file), ASTER_LINE_S,
    )  # fmt: skip
    points, note = rpc_points(path, (size[0], size[1]))
    return replace(lattice.metadata(chosen(light, LightEffects())), frame_points=points, frame_note=note)


def _rows(node: XmlNode, columns: int) -> Array:
    """Read the numbers (n, columns) of an element that has one record in each line."""
    words = node.text().split()
    if len(words) % columns:
        raise node.fault("lattice.columns (failure): each record has {columns} numbers -> the file is truncated or "
                         "damaged: use the original file", f"{len(words)} numbers", columns=columns)  # fmt: skip
    return node.vector(len(words)).reshape(-1, columns)


def _grid(cells: Array, file: str) -> tuple[Array, Array, Array]:
    """Arrange records line, sample, x, y, z as a grid: lines (r,), samples (c,), unit directions (r, c, 3).

    The records may have any order.
    """
    cells = cells[np.lexsort((cells[:, 1], cells[:, 0]))]
    line, sample = np.unique(cells[:, 0]), np.unique(cells[:, 1])
    shape = len(line), len(sample)
    whole = np.stack(np.meshgrid(line, sample, indexing="ij"), axis=2).reshape(-1, 2)
    if not np.array_equal(cells[:, :2], whole):
        raise InputError.of("lattice.grid (failure): the pixels of the directions are not a lattice -> give each line "
                            "with each sample once", file=file, place="pixels of the lattice",
                            value=f"{len(cells)} directions of {shape[0]} lines and {shape[1]} samples")  # fmt: skip
    length = np.linalg.norm(cells[:, 2:], axis=1)
    worst = int(np.abs(length - 1.0).argmax())
    if abs(length[worst] - 1.0) > UNIT:
        raise InputError.of("lattice.unit (failure): a direction must have length 1 -> divide it by its length",
                            file=file, place=f"line {cells[worst, 0]:g}, sample {cells[worst, 1]:g}",
                            value=f"{length[worst]:.6g}")  # fmt: skip
    return line, sample, np.ascontiguousarray(cells[:, 2:] / length[:, None]).reshape(*shape, 3)


def _positions(positions_m: Array, file: str) -> Array:
    """Return the positions (r, 3) of the satellite.

    Refuse an impossible distance from the Earth's centre.
    """
    radius, (low, high) = np.linalg.norm(positions_m, axis=1), RADIUS_M
    bad = np.flatnonzero((radius < low) | (radius > high))
    if len(bad):
        raise InputError.of("earth.state", file=file, place=f"position {bad[0] + 1}", value=f"{radius[bad[0]]:g}",
                            what="distance from the Earth's centre", low=low, high=high)  # fmt: skip
    return np.ascontiguousarray(positions_m)


def _is_aster(_: Path, head: str) -> bool:
    return xml_root(head) == "isd" and "<LATTICE_POINT" in head


ASTER_FORMAT = Format(
    name="aster-lattice", title="ASTER lattice (XML of ASP)", sniff=_is_aster, beside_rpc=True, chooses_light=True,
    read_image=lambda path, light=(): noted(GeneralPushbroom(read_aster(path, light))),
)  # fmt: skip
FORMAT = Format(
    name="lattice", title='lattice description (TOML, kind = "lattice")', suffixes=(".toml",), chooses_light=True,
    sniff=lambda path, head: path.suffix.lower() == ".toml" and _KIND.search(head) is not None,
    read_image=lambda path, light=(): noted(GeneralPushbroom(read_lattice_file(path, light))),
)  # fmt: skip
