"""Ground control in text files of the Ames Stereo Pipeline, OpenDroneMap and QGIS, each with its image points.

Ground control of the Ames Stereo Pipeline: ``.gcp``, one point a line with all its image points.

``id latitude longitude height sx sy sz`` and, for each image, ``name column row sigma_column sigma_row``; blanks or
commas. Latitude precedes longitude. A comment may state the datum: ``# WKT: GEOGCS[...]``. The three standard
deviations refer to geocentric x, y, z, or with ``bundle_adjust --use-lon-lat-height-gcp-error`` to longitude,
latitude, height in metres. Columns and rows count from 0, assumed to be the centre of the first pixel.

Ground control of OpenDroneMap: ``gcp_list.txt``, one image point a line with the coordinates of its ground point.

The first line states the CRS: ``EPSG:32632``, a PROJ string, or ``WGS84 UTM 32N``. Further lines contain, between
blanks, ``geo_x geo_y geo_z im_x im_y image`` and, if given, the name of the point; further words are ignored. geo_x is
longitude or easting; ``NaN`` is an unknown height. Without the first line the CRS must be given. (0, 0) is assumed to
be the centre of the first pixel.

Points of QGIS's georeferencer: ``.points``, the points of one image, without names and heights.

A line ``#CRS: WKT``, a header ``mapX,mapY,sourceX,sourceY,enable,dX,dY,residual`` (older versions: pixelX, pixelY for
sourceX, sourceY), then one point per line. sourceX is the column and **sourceY is minus the row**. Both count from the
corner of the first pixel, whose centre is (0.5, -0.5). For an image that was georeferenced before, QGIS writes map
coordinates instead: such a file is recognised only if a sourceY is above zero.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import cells_of, digits, named, numbers, require_plain, row_of, sigma, stated_in
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings
from fg_orient.formats.tables import Faults, Row
from fg_orient.geodesy import crs_kind, enu_from_ecef
from fg_orient.geodesy.crs import WGS84, wkt
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]

_ASP_GROUND: Final = ("id", "latitude", "longitude", "height", "sx", "sy", "sz")
_ASP_IMAGE: Final = ("image", "column", "row", "sigma_column", "sigma_row")
_ASP_EXPECTED: Final = "7 and 5 more for each image"
_WKT: Final = re.compile(r"^#\s*WKT:\s*(.+)$", re.MULTILINE | re.IGNORECASE)
#: Heights are ellipsoidal; the comment cannot state that.
_WITH_HEIGHTS: Final = {"EPSG:4326": WGS84}


def read_asp(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a ``.gcp``; the CRS of the settings or the comment must be geographic."""
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
    """Standard deviations (3,) along East, North, Up from geocentric ones, or the inverse; equal ones are unchanged.

    ``place_deg`` are longitude and latitude.
    """
    given = np.asarray(sigmas, float)
    if axes == "enu" or np.ptp(given) == 0.0 or not np.isfinite([*place_deg, *given]).all():
        return given
    enu = enu_from_ecef(*place_deg)[0]
    return np.asarray(np.sqrt((enu if to_enu else enu.T) ** 2 @ given**2))


def write_asp(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write the points with coordinates; their CRS must be geographic."""
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


# --- OpenDroneMap ----------------------------------------------------------------------------------

_ODM: Final = ("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image", "name")
_ODM_FEWEST: Final = 6
#: Horizontal CRS of a geographic CRS with heights, which the program does not read.
_ODM_FLAT: Final = {"EPSG:4979": "EPSG:4326"}


def read_odm(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a ``gcp_list.txt``; points without a name are distinguished by their coordinates and numbered."""
    path = paths[0]
    faults = Faults(str(path))
    lines = cells_of(path, faults, "blank")
    faults.raise_if_any()
    if not lines:
        raise InputError.of("interchange.empty", file=path)
    headless = _is_point(lines[0][1])
    gathered = Gathering(path, settings.crs, "" if headless else " ".join(lines[0][1]))
    faults = gathered.faults
    placed: dict[str, tuple[tuple[str, ...], int]] = {}
    numbered: dict[tuple[str, ...], str] = {}
    for n, cells in lines if headless else lines[1:]:
        if len(cells) < _ODM_FEWEST:
            faults.add("interchange.cell_count", place=f"line {n}", value=f"{len(cells)} cells", expected="6 or 7")
            continue
        row = named(n, cells[: len(_ODM)], _ODM)
        place = tuple(cells[:3])
        name = row.cells["name"] or numbered.setdefault(place, str(len(numbered) + 1))
        before = placed.setdefault(name, (place, n))
        if before[0] != place:
            faults.add("interchange.two_places", place=f"line {n}", value=name, first=before[1])
        elif before[1] == n:
            gathered.point(name, Role.CONTROL, _coordinates(row, faults), line=n)
        x, y = numbers(row, ("im_x", "im_y"), faults)
        gathered.measure(row.cells["image"], name, y, x, line=n)
    gathered.notes += (finding("points.numbered", n=len(numbered)),) if numbered else ()
    return gathered.finished()


def _is_point(cells: list[str]) -> bool:
    """Whether the first line is an image point, so that the file lacks its CRS."""
    try:
        return len([float(cell) for cell in cells[:2]]) == 2 and len(cells) >= _ODM_FEWEST
    except ValueError:
        return False


def _coordinates(row: Row, faults: Faults) -> tuple[float, ...]:
    """Coordinates of a line; the height may be nan."""
    if row.cells["geo_z"].lower() == "nan":
        return (*numbers(row, ("geo_x", "geo_y"), faults), np.nan)
    return numbers(row, ("geo_x", "geo_y", "geo_z"), faults)


def write_odm(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write the image points of the points with coordinates."""
    path, o = paths[0], survey.observed
    require_plain((*survey.ids, *survey.images), "name", path)
    flat = survey.crs.partition("+")[0].upper()
    lines, known = [_ODM_FLAT.get(flat, flat)], survey.located
    for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
        if known[p]:
            east, north, height = survey.coordinates[p]
            ground = [digits(east), digits(north), "NaN" if np.isnan(height) else digits(height)]
            lines.append(" ".join([*ground, digits(sample), digits(line), survey.images[i], survey.ids[p]]))
    write_lines(path, lines)


ODM = Format(
    name="odm",
    title="OpenDroneMap gcp_list.txt",
    suffixes=("gcp_list.txt",),
    first_pixel=(0.0, 0.0),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset({Holds.GROUND, Holds.IMAGE, Holds.IDS, Holds.IMAGES, Holds.HEIGHTS, Holds.CRS}),
    read=read_odm,
    write=write_odm,
)


# --- QGIS ------------------------------------------------------------------------------------------

_QGIS: Final = ("mapX", "mapY", "sourceX", "sourceY", "enable", "dX", "dY", "residual")
_QGIS_OLDER: Final = {"pixelX": "sourceX", "pixelY": "sourceY"}
_QGIS_NEEDED: Final = _QGIS[:4]
#: Column, and minus the row, of the centre of the first pixel.
CENTRE_PX: Final = 0.5
_QGIS_CRS: Final = re.compile(r"^#\s*CRS:\s*(.+)$", re.MULTILINE)


def read_qgis(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points of one image, numbered in their order: enabled ones are control, the others check points."""
    path = paths[0]
    gathered = Gathering(path, settings.crs, stated_in(path, _QGIS_CRS))
    faults = gathered.faults
    lines = cells_of(path, faults, "comma")
    faults.raise_if_any()
    image = settings.image or path.name.removesuffix(".points")
    names = _header(lines, path)
    for k, (n, cells) in enumerate(lines[1:], start=1):
        if not len(_QGIS_NEEDED) <= len(cells) <= len(names):
            value = f"{len(cells)} cells"
            faults.add("interchange.cell_count", place=f"line {n}", value=value, expected=f"4 to {len(names)}")
            continue
        _take(gathered, named(n, cells, names), str(k), image)
    return gathered.finished()


def _header(lines: list[tuple[int, list[str]]], path: Path) -> list[str]:
    """Names of the columns; names of older versions are replaced."""
    names = [_QGIS_OLDER.get(cell, cell) for cell in lines[0][1]] if lines else []
    for column in _QGIS_NEEDED:
        if column not in names:
            raise InputError.of("interchange.columns", file=path, place="header", value=",".join(names), column=column)
    return names


def _take(gathered: Gathering, row: Row, name: str, image: str) -> None:
    east, north, x, y = numbers(row, _QGIS_NEEDED, gathered.faults)
    if y > 0.0:
        gathered.faults.add("interchange.rows_positive", place=row.place("sourceY"), value=row.cells["sourceY"])
    role = Role.CHECK if row.cells.get("enable", "1") == "0" else Role.CONTROL
    gathered.point(name, role, (east, north, np.nan), line=row.line)
    gathered.measure(image, name, -y - CENTRE_PX, x - CENTRE_PX, line=row.line)


def write_qgis(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write the points of one image; the settings name it if there are several."""
    o, image = survey.observed, settings.image
    if not image and len(survey.images) == 1:
        image = survey.images[0]
    if image not in survey.images:
        raise InputError.of(
            "interchange.which_image", file=paths[0], option="image", value=image, count=len(survey.images)
        )
    lines, mine = [f"#CRS: {wkt(survey.crs.partition('+')[0])}", ",".join(_QGIS)], survey.images.index(image)
    known = survey.located
    for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
        if i == mine and known[p]:
            pixel = digits(sample + CENTRE_PX), digits(-(line + CENTRE_PX))
            enable = "0" if survey.roles[p] is Role.CHECK else "1"
            lines.append(row_of([*map(digits, survey.coordinates[p, :2]), *pixel, enable, "0", "0", "0"]))
    write_lines(paths[0], lines)
    others = int((o.image != mine).sum())
    return (finding("lost.images", file=paths[0], value=f"{others} points", format=QGIS.name),) if others else ()


QGIS = Format(
    name="qgis-points",
    title="QGIS georeferencer .points",
    suffixes=(".points",),
    first_pixel=(-CENTRE_PX, CENTRE_PX),
    pixel_axes="sourceX (column), sourceY (minus the row), pixels",
    ground_axes="longitude or easting, latitude or northing; no height",
    holds=frozenset({Holds.GROUND, Holds.IMAGE, Holds.ROLES, Holds.CRS}),
    read=read_qgis,
    write=write_qgis,
)
