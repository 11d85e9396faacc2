"""Tables of any form from offices. The reader finds encoding, separator, header, columns and units, or asks for them.

It reads CSV and other text, workbooks (``.xlsx``, ``.ods``), GeoPackage and Shapefile.
They may have any columns, in one file or two. The reader recognises columns by usual
names in English, Turkish, French, German and Spanish. If the metadata of the images are
given, it projects the points into the images and so finds axis order, units and CRS. Each
assumption gives a note. If the data do not answer a question, an error names the option
that answers it.
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
    """Read all tables of the files; the notes of the survey list the assumptions."""
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
