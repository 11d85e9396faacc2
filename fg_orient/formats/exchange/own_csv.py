"""Our own tables of ground points and image observations, as a project uses them (docs/file-formats.md).

The suffix of the file name selects the format: .csv, .parquet, .feather or .arrow. All of
them have the format name "csv".
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.arrow import comments_of
from fg_orient.formats.exchange.survey import Survey, decided_crs
from fg_orient.formats.exchange.text import stated_in
from fg_orient.formats.faults import Faults
from fg_orient.formats.heights import without_vertical
from fg_orient.formats.points import COLUMNS, located, parse_points, read_observations
from fg_orient.formats.points_write import write_observations, write_points
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.table_write import BINARY, is_binary
from fg_orient.formats.tables import read_table
from fg_orient.geodesy import crs_kind
from fg_orient.model.errors import InputError

_CRS: Final = re.compile(r"^#\s*crs\s*[:=]\s*(\S+)\s*$", re.MULTILINE | re.IGNORECASE)


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read one or two tables.

    The settings or a comment ``# crs: EPSG:n`` state the CRS of the points.
    """
    faults = Faults(str(paths[0]))
    comments = comments_of(paths[0], faults) if is_binary(paths[0]) else None
    faults.raise_if_any()
    crs, notes = decided_crs(stated_in(paths[0], _CRS, comments), settings.crs, paths[0])
    points = parse_points(paths[0], crs, faults, incomplete=settings.incomplete)
    if points is not None:
        located(without_vertical(points), faults)
    faults.raise_if_any()
    if points is None:
        raise InputError.of("interchange.empty", file=paths[0])
    if len(paths) > 1:
        faults = Faults(str(paths[1]))
        table = read_table(paths[1], [COLUMNS[:4], COLUMNS] if settings.incomplete else [COLUMNS], faults)
        images = tuple(dict.fromkeys(table.cells["image"])) if table is not None else ()
        images_of = dict.fromkeys(images)
        read = (None if faults else
                read_observations(paths[1], images_of, points.ids, faults, incomplete=settings.incomplete))  # fmt: skip
        faults.raise_if_any()
        points = points if read is None else replace(points, images=images, observed=read.observations)
    return replace(points, notes=notes)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both tables; the second one is written only if there are image points."""
    o = survey.observed
    comments = (f"crs: {survey.crs}",)
    write_points(
        paths[0], survey.ids, survey.roles, survey.coordinates, survey.sigma_enu_m,
        kind=crs_kind(survey.crs), fixed=survey.fixed, comments=comments,
    )  # fmt: skip
    if len(o):
        write_observations(
            paths[1], [survey.images[k] for k in o.image], [survey.ids[k] for k in o.point],
            np.stack([o.line, o.sample], axis=1), np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1),
        )  # fmt: skip


FORMAT = Format(
    name="csv",
    title="fg_orient tables (CSV, Parquet, Arrow)",
    suffixes=(".csv", *BINARY),
    files=("points", "observations"),
    first_pixel=(0.0, 0.0),
    pixel_axes="line, sample (pixels)",
    ground_axes="by column name, any EPSG code; longitude or easting first",
    holds=frozenset(Holds),
    needs=frozenset({Holds.HEIGHTS, Holds.SIGMA_GROUND, Holds.SIGMA_IMAGE}),
    read=read,
    write=write,
    evidence="the format of this program",
)
