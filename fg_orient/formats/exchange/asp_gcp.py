"""Ground control files ``.gcp`` of the Ames Stereo Pipeline; each line is a ground point with all its image points.

A line contains ``id latitude longitude height sx sy sz`` and, for each image, ``name
column row sigma_column sigma_row``. Cells are separated by blanks or commas. Latitude
precedes longitude. A comment may state the datum: ``# WKT: GEOGCS[...]``. The three
standard deviations refer to geocentric x, y, z. With the option
``--use-lon-lat-height-gcp-error`` of ``bundle_adjust``, they refer to longitude,
latitude, height and are in metres. Columns and rows count from 0. It is assumed that 0 is
the centre of the first pixel.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import cells_of, digits, named, numbers, require_plain, sigma, stated_in
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings
from fg_orient.geodesy import crs_kind, enu_from_ecef
from fg_orient.geodesy.crs import WGS84, wkt
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

_ASP_GROUND: Final = ("id", "latitude", "longitude", "height", "sx", "sy", "sz")
_ASP_IMAGE: Final = ("image", "column", "row", "sigma_column", "sigma_row")
_ASP_EXPECTED: Final = "7 and 5 more for each image"
_WKT: Final = re.compile(r"^#\s*WKT:\s*(.+)$", re.MULTILINE | re.IGNORECASE)
#: Geographic CRS with heights, by the CRS without heights. Heights are ellipsoidal, but the comment cannot state it.
_WITH_HEIGHTS: Final = {"EPSG:4326": WGS84}


def read_asp(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a ``.gcp`` file; the CRS of the settings or of the comment must be geographic."""
    path = paths[0]
    gathered = Gathering(path, settings.crs, stated_in(path, _WKT))
    faults = gathered.faults
    if not settings.crs:
        gathered.crs = _WITH_HEIGHTS.get(gathered.crs, gathered.crs)
    if crs_kind(gathered.crs) != "geographic":
        place = "<crs>" if settings.crs else "WKT"
        raise InputError.of("interchange.geographic", file=path, place=place, value=gathered.crs)
    for n, cells in cells_of(path, faults, "either"):
        images, rest = divmod(len(cells) - len(_ASP_GROUND), len(_ASP_IMAGE))
        if rest or images < 0:
            faults.add("interchange.cell_count", place=f"line {n}", value=f"{len(cells)} cells", expected=_ASP_EXPECTED)
            continue
        row = named(n, cells[: len(_ASP_GROUND)], _ASP_GROUND)
        lat, lon, height = numbers(row, _ASP_GROUND[1:4], faults)
        stated = [sigma(row, name, "m", faults) for name in _ASP_GROUND[4:]]
        sigmas = _turned((lon, lat), stated, settings.sigma_axes, to_enu=True).tolist()
        gathered.point(row.cells["id"], Role.CONTROL, (lon, lat, height), sigmas, line=n)
        for k in range(images):
            start = len(_ASP_GROUND) + k * len(_ASP_IMAGE)
            mark = named(n, cells[start : start + len(_ASP_IMAGE)], _ASP_IMAGE)
            column, line = numbers(mark, _ASP_IMAGE[1:3], faults)
            along, across = (sigma(mark, name, "pixels", faults) for name in ("sigma_row", "sigma_column"))
            gathered.measure(mark.cells["image"], row.cells["id"], line, column, (along, across), line=n)
    return gathered.finished()


def _turned(place_deg: Sequence[float], sigmas: Sequence[float], axes: str, *, to_enu: bool) -> Array:
    """Convert standard deviations (3,) from geocentric axes to East, North, Up, or the inverse.

    Three equal values are not changed. ``place_deg`` contains longitude and latitude.
    """
    given = np.asarray(sigmas, float)
    if axes == "enu" or np.ptp(given) == 0.0 or not np.isfinite([*place_deg, *given]).all():
        return given
    enu = enu_from_ecef(*place_deg)[0]
    return np.asarray(np.sqrt((enu if to_enu else enu.T) ** 2 @ given**2))


def write_asp(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write all points that have coordinates; their CRS must be geographic."""
    path, o = paths[0], survey.observed
    if crs_kind(survey.crs) != "geographic":
        raise InputError.of("interchange.geographic", file=path, option="to_crs", value=survey.crs)
    require_plain((*survey.ids, *survey.images), "name", path)
    marks: dict[int, list[str]] = {}
    for image, point, line, sample, along, across in zip(
        o.image.tolist(), o.point.tolist(), o.line, o.sample, o.sigma_line_px, o.sigma_sample_px, strict=True
    ):
        marks.setdefault(point, []).extend([survey.images[image], *map(digits, (sample, line, across, along))])
    axes = "longitude, latitude, height" if settings.sigma_axes == "enu" else "geocentric x, y, z"
    datum = survey.crs.partition("+")[0]
    lines = [
        f"# WKT: {wkt(datum)}",
        f"# latitude longitude (degrees) height (m) of {survey.crs}; standard deviations (m) along {axes}",
    ]
    for k in np.flatnonzero(survey.located).tolist():
        lon, lat, height = survey.coordinates[k]
        sigmas = _turned((lon, lat), survey.sigma_enu_m[k], settings.sigma_axes, to_enu=False)
        ground = [survey.ids[k], *map(digits, (lat, lon, height, *sigmas))]
        lines.append(" ".join([*ground, *marks.get(k, [])]))
    write_lines(path, lines)
    given = survey.sigma_enu_m[survey.located]
    turned = 0 if settings.sigma_axes == "enu" else int((np.ptp(given, axis=1) > 0.0).sum())
    return (finding("lost.sigma_axes", file=path, value=f"{turned} point(s)"),) if turned else ()


ASP = Format(
    name="asp-gcp",
    title="Ames Stereo Pipeline .gcp",
    suffixes=(".gcp",),
    first_pixel=(0.0, 0.0),
    pixel_axes="column, row (pixels)",
    ground_axes="latitude, longitude (degrees), height (m)",
    holds=POINTS_AND_MARKS - {Holds.TIES} | {Holds.SIGMA_EAST_NORTH, Holds.SIGMA_IMAGE, Holds.CRS},
    needs=frozenset({Holds.HEIGHTS, Holds.SIGMA_GROUND, Holds.SIGMA_IMAGE}),
    read=read_asp,
    write=write_asp,
    crs="EPSG:4979",
)
