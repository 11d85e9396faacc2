"""Combine tables of unknown form to one survey: ground points, image points, roles and standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.exchange.survey import Survey, no_image_points
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.candidates import scene_box
from fg_orient.formats.office.coordinates import read_coordinates
from fg_orient.formats.office.decisions import Choice, Decisions, Office, Question
from fg_orient.formats.office.fit import RATIO, Fit, Marks
from fg_orient.formats.office.ground import Triple, ground_triples
from fg_orient.formats.office.image_columns import ImagePart, image_part
from fg_orient.formats.office.layout import names_columns, names_ties, require_known, table_of
from fg_orient.formats.office.pixels import first_pixel, read_marks, require_inside
from fg_orient.formats.office.sheets import Sheet
from fg_orient.formats.office.stated import label_images, named_pairs
from fg_orient.formats.office.table import Table, id_column
from fg_orient.formats.office.weights import roles_and_sigmas
from fg_orient.formats.office.words import Named
from fg_orient.geodesy.crs import WGS84
from fg_orient.geodesy.heights import undulation_m
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Before the adjustment, two rays to the same point may pass each other at this distance at most, m.
CROSSING_M: Final = 30.0


def read_survey(sheets: Sequence[Sheet], office: Office, decisions: Decisions, sensors: Mapping[str, Any]) -> Survey:
    """Read sheets of ground points and image points.

    Parameters
    ----------
    sheets : sequence of Sheet
    office : Office
    decisions : Decisions
        Collects the assumptions, and asks questions.
    sensors : mapping of str to Sensor
        Images by id; empty if there are no images.

    Returns
    -------
    Survey
        Survey. Heights and standard deviations are nan if no table contains them.

    Raises
    ------
    InputError
        A table has faults, or a question has no answer.
    """
    columns = dict(office.columns)
    if office.role_column and office.role_column != "none":
        columns["role"] = office.role_column
    tables = []
    for sheet in sheets:
        for one in sheet.assumed:
            decisions.note(one.subject, one.value, one.reason)
        table = table_of(sheet, decisions, columns)
        if table is None and names_columns(sheet) and not names_ties(sheet):
            raise InputError.of("office.no_numbers", file=sheet.path, place=sheet.name)
        if table is None:
            decisions.note(f"table {sheet.title}", "left out", "no rows of numbers")
        else:
            tables.append(table)
    if not tables:
        raise InputError.of("office.no_numbers", file=sheets[0].path, place=sheets[0].name)
    require_known(columns, tables)
    _settle_ids(tables, decisions)
    parts, grounds = [], []
    for table in tables:
        part, triples = image_part(table, list(sensors)), ground_triples(table, dict(office.units))
        if part is None and not triples:
            raise InputError.of("office.no_columns", file=table.file, place=table.sheet.name, option="columns",
                                value=", ".join(table.headers))  # fmt: skip
        if part is not None:
            parts.append(part)
        if triples:
            grounds.append((table, triples))
    georeferenced = {name: s for name, s in sensors.items() if s.georeferenced and s.orients}
    marks, sigmas = read_marks(parts)
    return _survey(grounds, parts, marks, sigmas, office, decisions, sensors, georeferenced)


def _survey(
    grounds: list[tuple[Table, list[Triple]]], parts: Sequence[ImagePart], marks: Marks, sigmas: Array, office: Office,
    decisions: Decisions, sensors: Mapping[str, Any], georeferenced: Mapping[str, Any],
) -> Survey:  # fmt: skip
    file = parts[0].table.file if parts else grounds[0][0].file
    labels = (
        label_images(marks.labels, list(sensors), office.images, decisions, file)
        if len(marks) and sensors
        else [marks.labels]
    )
    row, places = _rows(grounds)
    if grounds and len(marks):
        _require_common(marks, row, file)
    seen = georeferenced if len(georeferenced) == len(sensors) else {}
    fit = Fit(seen, marks, row, office.lift_m or _undulation_m(office.heights, seen))
    crs, coordinates, reading = "", np.full((len(row), 3), np.nan), None
    if grounds:
        reading, crs, coordinates = read_coordinates(grounds, row, labels, fit, parts, office, decisions)
    elif len(labels) > 1:
        labels = [_crossing(labels, marks, fit, decisions, file)]
    images = reading.images if reading is not None else labels[0]
    exchanged = reading is not None and reading.exchanged
    origin = (
        first_pixel(office.first_pixel, parts, marks, fit, reading, crs, coordinates, decisions) if len(marks) else 0.0
    )
    require_inside(marks, images, exchanged, fit.sensors, origin)
    known = list(row)
    extra = [name for name in dict.fromkeys(marks.ids) if name not in row]
    if extra and grounds:
        decisions.note("tie points", f"{len(extra)} ids", "image points without ground coordinates")
    ids = tuple(known + extra)
    at = {name: k for k, name in enumerate(ids)}
    role, sigma_enu, fixed = roles_and_sigmas(
        [table for table, _ in grounds], row, coordinates, office.units, office.role_column, decisions
    )
    n = len(extra)
    first, second = (marks.second, marks.first) if exchanged else (marks.first, marks.second)
    observed = no_image_points()
    if len(marks):
        point = np.array([at[name] for name in marks.ids], np.intp)
        observed = ImagePoints(
            marks.label, point, first - origin, second - origin, *(sigmas[:, ::-1] if exchanged else sigmas).T
        )
    return Survey(
        crs or WGS84, ids, (*role, *[Role.TIE] * n), np.vstack([coordinates, np.full((n, 3), np.nan)]),
        np.vstack([sigma_enu, np.full((n, 3), np.nan)]), np.append(fixed, np.zeros(n, bool)), tuple(images), observed,
        np.array([*places, *[0] * n], np.int64),
    )  # fmt: skip


def _crossing(
    labels: list[tuple[str, ...]], marks: Marks, fit: Fit, decisions: Decisions, file: str
) -> tuple[str, ...]:
    """Assign images to the labels of a tie-point table such that the rays to the same points intersect."""
    apart = {one: fit.crossing_m(one) if fit.sensors else float("inf") for one in labels}
    ranked = sorted(labels, key=lambda one: apart[one])
    clear = apart[ranked[0]] < CROSSING_M and apart[ranked[1]] > RATIO * CROSSING_M
    choices = [Choice(named_pairs(marks.labels, one), f"rays meet within {apart[one]:.3g} m") for one in ranked]
    reason = "the rays to the same points meet" if clear else "no ground points decide"
    chosen = decisions.settle(Question("image", "images of the table", choices, clear, reason), file)
    return next(
        (one for one in ranked if chosen is not None and named_pairs(marks.labels, one) == chosen.value), ranked[0]
    )


def _settle_ids(tables: Sequence[Table], decisions: Decisions) -> None:
    """If several columns look like ids, keep the column whose cells are also ids in other tables."""
    for table in tables:
        found = table.having("id")
        others = {cell for own in tables if own is not table for k in own.having("id") for cell in own.texts(k)}
        common = [k for k in found if others & set(table.texts(k))]
        if len(found) > 1 and len(common) == 1 and not table.stated & set(found):
            for k in set(found) - set(common):
                table.names[k] = Named("")
            header = table.headers[common[0]]
            decisions.note(f"ids of {table.sheet.title}", header, "another table has the same ids", "columns")


def _undulation_m(heights: str, sensors: Mapping[str, Any]) -> float:
    """Return the undulation of the stated vertical CRS in the middle of the images, m; 0 if PROJ has no grid."""
    if not sensors or heights in ("", "ellipsoidal"):
        return 0.0
    west, south, east, north = scene_box(sensors)
    with suppress(InputError):
        place = np.array([0.5 * (west + east)]), np.array([0.5 * (south + north)])
        return float(undulation_m(f"EPSG:4326+{heights.partition(':')[2]}", *place)[0])
    return 0.0


def _rows(grounds: list[tuple[Table, list[Triple]]]) -> tuple[dict[str, int], list[int]]:
    """Return the row of each ground point id, and the lines.

    An id may occur only once in each table.
    """
    row: dict[str, int] = {}
    places: list[int] = []
    for table, _ in grounds:
        faults, seen = Faults(table.file), dict[str, int]()
        for k, name in enumerate(table.texts(id_column(table))):
            if not name:
                faults.add("points.id_missing", place=table.place(k))
            elif name in seen and len(table.having("image")) == 0:
                faults.add("points.id_twice", place=table.place(k), value=name, first=table.place(seen[name]))
            seen.setdefault(name, k)
            if name not in row:
                row[name] = len(row)
                places.append(int(table.sheet.lines[table.rows[k]]))
        faults.raise_if_any()
    return row, places


def _require_common(marks: Marks, row: Mapping[str, int], file: str) -> None:
    common = set(marks.ids) & set(row)
    if not common:
        raise InputError.of("office.no_common", file=file, option="columns", value=f"{marks.ids[0]}, {next(iter(row))}")
