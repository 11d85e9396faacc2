"""Ground coordinates of other programs: plausibility in their CRS, and transformation to another CRS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.scenes import Scene, check_positions
from fg_orient.formats.tables import Faults
from fg_orient.geodesy import area_of_use, crs_kind, to_ecef, to_ecef_with_operation, to_geographic
from fg_orient.geodesy.crs import from_ecef
from fg_orient.model.errors import Finding, InputError, finding

Array = npt.NDArray[np.float64]

#: Distance from the area of use of a CRS beyond which points cause a remark, degrees.
AREA_MARGIN_DEG: Final = 3.0


def check_ground(survey: Survey, file: str, scenes: Sequence[Scene] = ()) -> tuple[Finding, ...]:
    """Refuse coordinates that cannot be true in their CRS, and return remarks.

    Refused are latitudes and longitudes out of range, columns that look exchanged, and points far from all ``scenes``,
    the footprints of the images.
    """
    faults = Faults(file)
    remarks: tuple[Finding, ...] = ()
    rows = np.flatnonzero(survey.located)
    kind = crs_kind(survey.crs)
    if kind == "geographic":
        _check_ranges(survey, rows, faults)
    elif kind == "projected" and len(rows):
        remarks = _check_area(survey, rows, faults)
    faults.raise_if_any()
    if scenes and len(rows):
        given = np.where(np.isnan(survey.coordinates), 0.0, survey.coordinates)[rows]
        check_positions(scenes, survey.crs, given, to_ecef(survey.crs, *given.T), survey.lines[rows], faults)
        faults.raise_if_any()
    return remarks


def _check_ranges(survey: Survey, rows: npt.NDArray[np.intp], faults: Faults) -> None:
    for k in rows:
        lon, lat = survey.coordinates[k, :2]
        place = f"line {survey.lines[k]}, point {survey.ids[k]}"
        if abs(lat) > 90.0:
            code = "interchange.swapped_range" if abs(lon) <= 90.0 and abs(lat) <= 180.0 else "points.latitude"
            faults.add(code, place=place, value=f"{lat:.10g}")
        elif abs(lon) > 180.0:
            faults.add("points.longitude", place=place, value=f"{lon:.10g}")


def _check_area(survey: Survey, rows: npt.NDArray[np.intp], faults: Faults) -> tuple[Finding, ...]:
    """Check projected coordinates against the area of use of their CRS."""
    area = area_of_use(survey.crs)
    first, second = survey.coordinates[rows, :2].T
    outside = ~_in_area(survey.crs, first, second, area)
    if area is None or 2 * outside.sum() <= len(rows):
        return ()
    place, value = f"line {survey.lines[rows[0]]}, point {survey.ids[rows[0]]}", f"{first[0]:.10g} {second[0]:.10g}"
    if _in_area(survey.crs, second, first, area).sum() > outside.sum() // 2:
        faults.add("interchange.swapped", place=place, value=value, crs=survey.crs)
        return ()
    return (
        finding("remark.outside_area", file=faults.file, place=place, value=value, crs=survey.crs,
                count=int(outside.sum()), total=len(rows)),
    )  # fmt: skip


def _in_area(
    crs: str, first: Array, second: Array, area: tuple[float, float, float, float] | None
) -> npt.NDArray[np.bool_]:
    """Whether points lie in the area of use of a CRS, with a margin: (n,)."""
    if area is None:
        return np.ones(len(first), bool)
    west, south, east, north = area
    lon, lat = to_geographic(crs, first, second)
    across = np.mod(lon - west + AREA_MARGIN_DEG, 360.0) <= np.mod(east - west, 360.0) + 2.0 * AREA_MARGIN_DEG
    inside = across & (lat >= south - AREA_MARGIN_DEG) & (lat <= north + AREA_MARGIN_DEG)
    return np.asarray(inside & np.isfinite(lon))


def transformed(survey: Survey, crs: str, file: str) -> Survey:
    """Survey in another CRS; its notes name the operations. Sigmas East, North, Up do not change.

    InputError if there is no exact operation, or a point has no height.
    """
    if survey.crs == crs:
        return survey
    rows = np.flatnonzero(survey.located)
    if np.isnan(survey.coordinates[rows, 2]).any():
        k = rows[np.flatnonzero(np.isnan(survey.coordinates[rows, 2]))[0]]
        raise InputError.of("interchange.needs_height", file=file, place=f"point {survey.ids[k]}", what=f"CRS {crs}")
    coordinates, notes = survey.coordinates.copy(), survey.notes
    if len(rows):
        labels = [f"point {survey.ids[k]}" for k in rows]
        xyz, there = to_ecef_with_operation(survey.crs, *survey.coordinates[rows].T, labels=labels)
        coordinates[rows], back = from_ecef(crs, xyz, labels)
        done = finding("points.operation", place="coordinates", operation=there)
        notes = (*notes, done, finding("points.back", crs=crs, operation=back.name))
    return replace(survey, crs=crs, coordinates=coordinates, notes=notes)
