"""Tables of offices in any form: the reader finds encoding, separator, header, columns and units, or asks for them.

CSV and other text, workbooks (``.xlsx``, ``.ods``), GeoPackage and Shapefile with any columns, in one file or two.
Columns are recognised by usual names in English, Turkish, French, German and Spanish. With the metadata of the images,
axis order, units and CRS are found by projection into them. Each assumption gives a note; a question that the data do
not decide is an error that names the option.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.office.decisions import Decisions, Office
from fg_orient.formats.office.sheets import read_sheets
from fg_orient.formats.office.survey import read_survey
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.model.errors import finding


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read all tables of the files; the notes of the survey are the assumptions."""
    office = replace(settings.office or Office(), crs=settings.crs)
    decisions = Decisions(office.given)
    sheets = [sheet for path in paths for sheet in read_sheets(path)]
    survey = read_survey(sheets, office, decisions, settings.sensors)
    decisions.require_answers()
    notes = [finding("office.assumed", file=paths[0], subject=one.subject, seen=one.value, reason=one.reason)
             for one in decisions.assumed]  # fmt: skip
    return replace(survey, notes=tuple(notes))


FORMAT = Format(
    name="office",
    title="Tables of offices (text, Excel, OpenDocument, GeoPackage, Shapefile)",
    suffixes=(".xlsx", ".xlsm", ".ods", ".shp"),
    files=("ground", "images"),
    pixel_axes="by column name; the first pixel is stated or asked for",
    ground_axes="by column name, any EPSG code; found out with the images' metadata",
    holds=frozenset(Holds),
    read=read,
    evidence="workbooks saved by LibreOffice, layers written by GDAL (tests)",
)
