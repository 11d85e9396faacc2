"""Tables of unknown form as one survey: ground points, image points, roles and standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.exchange.survey import Survey, decided_crs, no_image_points
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Choice, Decisions, Question
from fg_orient.formats.office.fit import Evidence, Fit, Marks, Reading, in_ecef
from fg_orient.formats.office.layout import Table, names_columns, require_known, stated_heights, table_of
from fg_orient.formats.office.parts import (
    ImagePart,
    Triple,
    ground_triples,
    id_column,
    image_part,
    note_numbers,
)  # fmt: skip
from fg_orient.formats.office.pixels import first_pixel, read_marks, require_inside
from fg_orient.formats.office.rank import best_reading, label_images, readings, stated_crs
from fg_orient.formats.office.sheets import Sheet
from fg_orient.formats.office.weights import roles_and_sigmas
from fg_orient.geodesy import crs_kind
from fg_orient.geodesy.crs import WGS84
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Vertical CRS that are proposed: EGM96, EGM2008.
_GEOIDS: Final = (("EPSG:5773", "above EGM96"), ("EPSG:3855", "above EGM2008"))


@dataclass(frozen=True)
class Office:
    """What the user states; None or "" is found out or asked.

    Parameters
    ----------
    columns : mapping of str to str
        Header by key: E, N, H, lon, lat, X, Y, Z, id, image, line, sample, role, sE, sN, sH, sEN, sline, ssample, spx.
    crs, heights, decimal, role_column : str
        ``EPSG:n[+m]``; "ellipsoidal" or ``EPSG:m``; "comma" or "point"; header, or "none".
    units : mapping of str to str
        Unit by key, such as H to "ft".
    first_pixel : float or None
        Coordinate of the centre of the first pixel.
    images : mapping of str to str
        Image by its name in the table.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    crs: str = ""
    heights: str = ""
    decimal: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    role_column: str = ""
    first_pixel: float | None = None
    images: Mapping[str, str] = field(default_factory=dict)


def read_survey(sheets: Sequence[Sheet], office: Office, decisions: Decisions, sensors: Mapping[str, Any]) -> Survey:
    """Read sheets of ground points and image points.

    Parameters
    ----------
    sheets : sequence of Sheet
    office : Office
    decisions : Decisions
        Receives the assumptions, and asks.
    sensors : mapping of str to Sensor
        The images by id; empty if there are none.

    Returns
    -------
    Survey
        Heights and standard deviations are nan where no table has them.

    Raises
    ------
    InputError
        A table is faulty, or nothing decides on a question and nobody answers it.
    """
    columns = dict(office.columns)
    if office.role_column and office.role_column != "none":
        columns["role"] = office.role_column
    tables = []
    for sheet in sheets:
        for one in sheet.assumed:
            decisions.note(one.subject, one.value, one.reason)
        table = table_of(sheet, decisions, columns)
        if table is None and names_columns(sheet):
            raise InputError.of("office.no_numbers", file=sheet.path, place=sheet.name)
        if table is None:
            decisions.note(f"table {sheet.title}", "left out", "no rows of numbers")
        else:
            tables.append(table)
    if not tables:
        raise InputError.of("office.no_numbers", file=sheets[0].path, place=sheets[0].name)
    require_known(columns, tables)
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
    fit = Fit(georeferenced, marks, row) if len(georeferenced) == len(sensors) else Fit({}, marks, row)
    crs, coordinates, reading = "", np.full((len(row), 3), np.nan), None
    if grounds:
        reading, crs, coordinates = _ground(grounds, row, labels, fit, parts, office, decisions)
    elif len(labels) > 1:
        choices = [Choice(",".join(one)) for one in labels]
        chosen = decisions.settle(
            Question("image", "images of the table", choices, reason="no ground points decide"), file
        )
        labels = [one for one in labels if chosen is not None and ",".join(one) == chosen.value]
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


def _rows(grounds: list[tuple[Table, list[Triple]]]) -> tuple[dict[str, int], list[int]]:
    """Row of each id of the ground points, and their lines; ids may repeat in several tables, not in one."""
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


def _ground(
    grounds: list[tuple[Table, list[Triple]]], row: Mapping[str, int], labels: list[tuple[str, ...]], fit: Fit,
    parts: Sequence[ImagePart], office: Office, decisions: Decisions,
) -> tuple[Reading | None, str, Array]:  # fmt: skip
    """Best reading of the tables of ground points, its CRS with heights, and the coordinates of all points."""
    grounds = sorted(grounds, key=lambda one: -len(one[0]))
    table, triples = grounds[0]
    if not triples:
        raise InputError.of("office.no_columns", file=table.file, option="columns", value=", ".join(table.headers))
    stated, _ = decided_crs(stated_crs(table), office.crs, table.file) if stated_crs(table) or office.crs else ("", ())
    if stated:
        triples = [t for t in triples if t.kind == crs_kind(stated)] or triples
    if not stated and not fit.sensors and triples[0].kind != "geocentric":
        raise InputError.of("interchange.no_crs", file=table.file, place="CRS")
    exchange = bool(parts) and not all(part.table.stated & {k for pair in part.pairs for k in pair} for part in parts)
    spread = [Spread.of(table, triple, row) for triple in triples]
    found = readings(spread, stated, labels, fit, exchange)
    named = all(part.named for part in parts) if parts else True
    best = best_reading(table, triples, found, named, decisions)
    coordinates = np.full((len(row), 3), np.nan)
    for own, all_triples in grounds:
        same = own is table
        wanted = best.triple.words(table), best.triple.units
        others = [Spread.of(own, t, row) for t in all_triples]
        triple = best.triple if same else next((t for t in others if (t.words(own), t.units) == wanted), None)
        if triple is None:
            raise InputError.of(
                "office.other_columns", file=own.file, place=own.sheet.name, value=", ".join(own.headers)
            )
        _take(own, triple, row, coordinates, decisions)
    crs = best.crs
    if "+" not in crs and best.triple.kind != "geocentric":
        crs = _with_heights(table, best, fit, coordinates, office, decisions)
    return best, crs, coordinates


class Spread:
    """Triples of a table by the row of the survey."""

    @staticmethod
    def of(table: Table, triple: Triple, row: Mapping[str, int]) -> Triple:
        """Triple whose coordinates (n, 3) stand in the rows of the survey; nan in rows of other tables."""
        out = np.full((len(row), 3), np.nan)
        for k, name in enumerate(table.texts(id_column(table))):
            if name in row:
                out[row[name]] = triple.coordinates[k]
        return Triple(triple.kind, triple.columns, out, triple.named, triple.units)


def _take(table: Table, triple: Triple, row: Mapping[str, int], coordinates: Array, decisions: Decisions) -> None:
    """Take the coordinates of a table; they must agree with those of other tables."""
    columns = [k for k in triple.columns if k >= 0]
    filled = np.any([table.filled(k) for k in columns], axis=0)
    at = np.array([row[name] for name in table.texts(id_column(table))], np.intp)
    own = triple.coordinates[at]
    note_numbers(table, Triple(triple.kind, triple.columns, own, triple.named, triple.units), filled, decisions)
    faults = Faults(table.file)
    before = coordinates[at]
    for k in np.flatnonzero((np.abs(before - own) > 1e-9 * np.maximum(np.abs(own), 1.0)).any(axis=1)).tolist():
        faults.add("office.two_places", place=table.place(k), value=table.texts(id_column(table))[k])
    if triple.kind == "geographic":
        for k in np.flatnonzero(np.abs(own[:, 1]) > 90.0).tolist():
            faults.add("points.latitude", place=table.place(k), value=f"{own[k, 1]:.10g}")
    faults.raise_if_any()
    coordinates[at] = own


def _with_heights(
    table: Table, best: Reading, fit: Fit, coordinates: Array, office: Office, decisions: Decisions
) -> str:
    """CRS with the vertical CRS of the heights; ellipsoidal heights have none."""
    if office.heights:
        return best.crs if office.heights == "ellipsoidal" else f"{best.crs}+{office.heights.partition(':')[2]}"
    if best.triple.columns[2] < 0:
        return best.crs
    named = stated_heights(table, best.triple.columns[2])
    if named == "ellipsoidal" or (office.crs and not named):
        reason = "named in the table" if named else "a CRS without a vertical one was given"
        decisions.note("heights", "ellipsoidal", reason, "heights")
        return best.crs
    text = f"{table.titles} {table.headers[best.triple.columns[2]]}".upper().replace(" ", "")
    choices = [Choice("ellipsoidal")] * (not named) + [Choice(code, words) for code, words in _GEOIDS]
    told = [one for one in choices if one.words and one.words.removeprefix("above ") in text]
    if told:
        question = Question("heights", "heights", told, True, "named in the table")
    else:
        tried = [(one, _tried(best, one, fit, coordinates)) for one in choices]
        known = [(one, e) for one, e in tried if e is not None]
        first = min(known, key=lambda one: one[1].move_px)[0] if known else None
        clear = first is not None and all(
            o is first or (e is not None and dict(known)[first].beats(e)) for o, e in tried
        )
        with_words = [Choice(one.value, " ".join(filter(None, (one.words, e.words() if e else "grid missing"))))
                      for one, e in tried]  # fmt: skip
        if clear:
            with_words.sort(key=lambda one: first is None or one.value != first.value)
        reason = (
            "the table names heights above a geoid, not which"
            if named
            else "the table does not name the kind of its heights"
        )
        question = Question("heights", "heights", with_words, clear, "it fits the images best" if clear else reason)
    choice = decisions.settle(question, table.file, later=True)
    if choice is None or choice.value == "ellipsoidal":
        return best.crs
    return f"{best.crs}+{choice.value.partition(':')[2]}"


def _tried(best: Reading, choice: Choice, fit: Fit, coordinates: Array) -> Evidence | None:
    """Evidence with these heights; None if the grid of the geoid is missing or there are no images."""
    if not fit.sensors or not len(fit.used):
        return None
    code = best.crs if choice.value == "ellipsoidal" else f"{best.crs}+{choice.value.partition(':')[2]}"
    ecef = in_ecef(code, coordinates, fit.sensors)
    return None if ecef is None else fit.evidence(fit.predicted(ecef), best.images, best.exchanged)[0]
