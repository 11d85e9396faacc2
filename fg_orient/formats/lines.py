"""Read lines and splines that serve as control, and the image points on them; see docs/lines.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import numpy as np

from factors.arrays import Array
from fg_orient.formats.exchange.gis import libraries, require_plain_layers
from fg_orient.formats.gdal import plain_case
from fg_orient.formats.load import foreign_bytes
from fg_orient.formats.tables import Table, require_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.geodesy import COORDINATE_COLUMNS, crs_kind, to_ecef
from fg_orient.geodesy.crs import same_horizontal, with_codes
from fg_orient.model.block import Block, Source
from fg_orient.model.errors import InputError
from fg_orient.sensors.lines import LineFeature, LinePoints, with_lines

if TYPE_CHECKING:
    from fg_orient.formats.schema import LinesEntry

SIGMAS: Final = ("sigma_across_m", "sigma_up_m")
KINDS: Final = ("line", "spline")
LAYER: Final = "control_features"
IMAGE_SIGMAS: Final = ("sigma_line_px", "sigma_sample_px")


def read_features(path: Path, crs: str) -> tuple[LineFeature, ...]:
    """Read the vertices of control features in their order.

    A table has the columns feature, sigma_across_m, sigma_up_m and the coordinate columns
    of ``crs``. The column kind (line or spline; default: line) is optional. A GeoPackage
    has a layer ``control_features`` of lines with Z. Its fields are feature,
    sigma_across_m, sigma_up_m and optionally kind.

    Raises
    ------
    InputError
        A table has faults: all are listed. For a GeoPackage or a single feature, only the first fault is named.
    """
    rows = _of_geopackage(path, crs) if path.suffix.lower() == ".gpkg" else _of_table(path, crs)
    names, kinds, sigma, given = rows
    ecef = to_ecef(crs, *given.T)
    out = []
    for name in dict.fromkeys(names):
        mine = np.array([one == name for one in names])
        first = int(np.argmax(mine))
        if (sigma[mine] != sigma[first]).any() or {kinds[k] for k in np.flatnonzero(mine)} != {kinds[first]}:
            raise InputError.of("lines.unequal", file=path, place=f"feature {name}", value="two values")
        try:
            kind = cast(Literal["line", "spline"], kinds[first])
            out.append(LineFeature(name, kind, ecef[mine], sigma[first]))
        except InputError as error:
            raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    return tuple(out)


def _of_table(path: Path, crs: str) -> tuple[list[str], list[str], Array, Array]:
    names = ("feature", *COORDINATE_COLUMNS[crs_kind(crs)], *SIGMAS)
    table = require_table(path, [names, (*names, "kind")])
    values = table.numbers(*names[1:])
    _refuse_sigmas(table, SIGMAS, values[:, 3:])
    kinds = list(table.cells["kind"]) if "kind" in table.columns else ["line"] * len(table)
    table.refuse([kind not in KINDS for kind in kinds], "lines.kind", "kind", value=kinds, known=", ".join(KINDS))
    table.refuse([not name for name in table.cells["feature"]], "table.cell_empty", "feature")
    table.require_valid()
    return list(table.cells["feature"]), kinds, values[:, 3:], values[:, :3]


def _refuse_sigmas(table: Table, names: Sequence[str], values: Array) -> None:
    for name, column in zip(names, values.T, strict=True):
        table.refuse(column <= 0.0, "lines.sigma", name, value=column)


def _of_geopackage(path: Path, crs: str) -> tuple[list[str], list[str], Array, Array]:
    pyogrio, shapely = libraries(path)
    require_plain_layers(path, (LAYER,), "interchange.gpkg")
    with foreign_bytes("interchange.gpkg", path), plain_case():
        meta, _, geometry, columns = pyogrio.raw.read(path, layer=LAYER)
        if geometry is None or not len(geometry):
            raise ValueError(f"the layer {LAYER} contains no lines")
        shapes = shapely.from_wkb(geometry)
    if meta["crs"] and not same_horizontal(meta["crs"], crs):
        raise InputError.of("interchange.crs_differs", file=path, place="CRS", value=meta["crs"], given=crs)
    fields: dict[str, Any] = dict(zip(meta["fields"], columns, strict=True))
    for column in ("feature", *SIGMAS):
        if column not in fields:
            raise InputError.of("interchange.columns", file=path, place=f"layer {LAYER}", column=column)
    names, kinds, sigmas, vertices = list[str](), list[str](), list[Array](), list[Array]()
    for k, shape in enumerate(shapes):
        kind = "line" if "kind" not in fields or fields["kind"][k] is None else str(fields["kind"][k])
        sigma = np.array([fields[name][k] for name in SIGMAS], float)
        if shape is None or shape.geom_type != "LineString" or not shape.has_z or kind not in KINDS:
            value = kind if kind not in KINDS else "no line with Z"
            raise InputError.of("lines.kind", file=path, place=f"feature {k + 1}", value=value, known=", ".join(KINDS))
        own = np.array(shape.coords)[:, :3]
        names += [str(fields["feature"][k])] * len(own)
        kinds += [kind] * len(own)
        sigmas += [sigma] * len(own)
        vertices.append(own)
    return names, kinds, np.array(sigmas), np.vstack(vertices)


def read_line_points(path: Path) -> LinePoints:
    """Read a table of image points on control features.

    Its columns are image, feature, line, sample, sigma_line_px, sigma_sample_px.

    Raises
    ------
    InputError
        The table has faults; all are listed.
    """
    names = ("line", "sample", *IMAGE_SIGMAS)
    table = require_table(path, [("image", "feature", *names)])
    values = table.numbers(*names)
    _refuse_sigmas(table, IMAGE_SIGMAS, values[:, 2:])
    table.require_valid()
    features, images = (tuple(table.cells[name]) for name in ("feature", "image"))
    return LinePoints(features, images, values[:, 0], values[:, 1], values[:, 2:])


def lined(block: Block, entry: LinesEntry, folder: Path, file: str) -> Block:
    """Return the block with the control features that the table ``[lines]`` of its project names.

    Raises
    ------
    InputError
        A file is missing or has faults, or the CRS cannot be used.
    """
    paths = [folder / name for name in (entry.file, entry.observations)]
    for path, key in zip(paths, ("file", "observations"), strict=True):
        if not path.is_file():
            raise InputError.of("project.missing_file", file=file, place=f"lines.{key}", value=path.name, folder=folder)
    try:
        crs_kind(with_codes(entry.crs))
    except InputError as error:
        raise InputError(*(replace(p, file=file, place="lines.crs") for p in error.problems)) from None
    features, measured = read_features(paths[0], entry.crs), read_line_points(paths[1])
    try:
        block = with_lines(block, features, measured)
    except InputError as error:
        raise InputError(*(replace(p, file=str(paths[1])) for p in error.problems)) from None
    return replace(block, sources=(*block.sources, *(Source(str(path), sha256_of(path)) for path in paths)))
