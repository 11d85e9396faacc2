"""Determine the coordinates of ground points in tables of unknown form: columns, CRS and kind of heights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.exchange.survey import decided_crs
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.candidates import scene_box, usual_first
from fg_orient.formats.office.decisions import Choice, Decisions, Office, Question
from fg_orient.formats.office.fit import Evidence, Fit, Reading
from fg_orient.formats.office.ground import Triple, note_numbers
from fg_orient.formats.office.image_columns import ImagePart
from fg_orient.formats.office.rank import best_reading, readings
from fg_orient.formats.office.stated import stated_crs
from fg_orient.formats.office.table import Table, id_column, stated_heights
from fg_orient.geodesy import crs_kind
from fg_orient.geodesy.geoid import LIMIT_M, world_undulation_m
from fg_orient.model.errors import InputError

#: Vertical CRS that are proposed to the user: EGM96 and EGM2008.
_GEOIDS: Final = (("EPSG:5773", "above EGM96"), ("EPSG:3855", "above EGM2008"))


def read_coordinates(
    grounds: list[tuple[Table, list[Triple]]], row: Mapping[str, int], labels: list[tuple[str, ...]], fit: Fit,
    parts: Sequence[ImagePart], office: Office, decisions: Decisions,
) -> tuple[Reading | None, str, Array]:  # fmt: skip
    """Decide how to interpret the coordinates of all tables of ground points.

    Parameters
    ----------
    grounds : list of (Table, list of Triple)
        Tables of ground points with their possible triples of columns.
    row : mapping of str to int
        Row of each of the n ground points.
    labels : list of tuples of str
        Possible images for the labels in the tables of image points.
    fit : Fit
        Images and image points, with which readings are compared.
    parts : sequence of ImagePart
        Columns of the image points.
    office : Office
        Statements of the user.
    decisions : Decisions
        Collects the assumptions and questions.

    Returns
    -------
    reading : Reading or None
        Best reading of the largest table.
    crs : str
        Horizontal CRS together with the vertical CRS of the heights.
    coordinates : (n, 3) array
        Coordinates with easting or longitude first; nan if a table does not contain them.

    Raises
    ------
    InputError
        There are no columns of coordinates, no CRS fits the images, or the tables have different columns.
    """
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
    if not found and stated:
        tried = readings(spread, "", labels, fit, exchange)
        codes = sorted({one.crs for one in tried if one.evidence.believable}, key=usual_first)
        raise InputError.of("office.nowhere_in_crs", file=table.file, place=table.sheet.name, option="crs",
                            value=stated, others=codes)  # fmt: skip
    named = all(part.named for part in parts) if parts else True
    best = best_reading(table, triples, found, fit, named, decisions)
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
    """Conversion of triples from the rows of a table to the rows of the survey."""

    @staticmethod
    def of(table: Table, triple: Triple, row: Mapping[str, int]) -> Triple:
        """Return a triple whose coordinates (n, 3) have the rows of the survey.

        Rows of other tables are nan.
        """
        out = np.full((len(row), 3), np.nan)
        for k, name in enumerate(table.texts(id_column(table))):
            if name in row:
                out[row[name]] = triple.coordinates[k]
        return Triple(triple.kind, triple.columns, out, triple.named, triple.units)


def _take(table: Table, triple: Triple, row: Mapping[str, int], coordinates: Array, decisions: Decisions) -> None:
    """Add the coordinates of a table; they must agree with the coordinates of other tables."""
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
    """Return the CRS together with the vertical CRS of the heights.

    Ellipsoidal heights have no vertical CRS.
    """
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
        with_words = [Choice(one.value, " ".join(filter(None, (one.words, e.words() if e else ""))))
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
    """Return the evidence for this kind of heights; None without images.

    If the grid is missing, the undulation with the best evidence in the possible range is used.
    """
    if not fit.sensors or not len(fit.used):
        return None
    code = best.crs if choice.value == "ellipsoidal" else f"{best.crs}+{choice.value.partition(':')[2]}"
    ecef = fit.in_ecef(code, coordinates)
    if ecef is None:
        west, south, east, north = scene_box(fit.sensors)
        world = float(world_undulation_m(0.5 * (west + east), 0.5 * (south + north)))
        least = np.sign(world) * max(abs(world) - LIMIT_M, 0.0)
        ecef = fit.in_ecef(best.crs, coordinates + np.array([0.0, 0.0, least]))
    return None if ecef is None else fit.evidence(fit.predicted(ecef), best.images, best.exchanged)[0]
