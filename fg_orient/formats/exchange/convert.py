"""Convert points or frame models to another format.

Count the information that will be lost before writing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.formats.atomic import outputs, require_free_files
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import LONGEST, Faults, is_id
from fg_orient.formats.heights import on_found_grid
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.scenes import Scene, check_positions
from fg_orient.geodesy import area_of_use, crs_kind, to_ecef, to_ecef_with_operation, to_geographic
from fg_orient.geodesy.crs import WGS84, from_ecef
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import LARGEST, SMALLEST, Role

if TYPE_CHECKING:
    from fg_orient.formats.frame_model import FrameModel

Three = tuple[float, float, float]
Two = tuple[float, float]

#: Points that are farther than this from the area of use of their CRS, degrees, cause a remark.
AREA_MARGIN_DEG: Final = 3.0


def read_survey(
    paths: Sequence[Path], format_: Format, settings: Settings, *, accept_unverified: bool = False,
    scenes: Sequence[Scene] = (),
) -> tuple[Survey, tuple[Finding, ...]]:  # fmt: skip
    """Read and check the files of a format.

    Parameters
    ----------
    paths : sequence of Path
    format_ : Format
    settings : Settings
        Information that the files do not contain.
    accept_unverified : bool
        Accept a format whose reader was never tested with a file from its program.
    scenes : sequence of Scene
        Footprints of the images; points that are far from all images are refused.

    Returns
    -------
    Survey
    tuple of Finding
        Remarks on the data.

    Raises
    ------
    InputError
        A file has faults.
    """
    file = paths[0]
    if format_.read is None:
        raise InputError.of("interchange.no_reader", file=file, option="from", value=format_.name)
    require_usable(paths, format_, accept_unverified)
    survey = format_.read(tuple(paths), settings)
    _require_ids(survey, str(file))
    settings.require_images(survey.images, file)
    remarks = check_ground(survey, str(file), scenes) if survey.crs else ()
    if not format_.verified:
        remarks = (finding("remark.unverified", file=file, value=format_.name), *remarks)
    return survey, remarks


def _require_ids(survey: Survey, file: str) -> None:
    """Refuse ids that no table can contain, with the code of tables."""
    faults = Faults(file)
    for k, name in enumerate(survey.ids):
        if not is_id(name):
            place = survey.place(k) if survey.lines[k] else f"point {k + 1}"
            faults.add("table.text", place=f"{place}, id", value=repr(name), limit=LONGEST)
    for name in survey.images:
        if not is_id(name):
            faults.add("table.text", place="image", value=repr(name), limit=LONGEST)
    faults.raise_if_any()


def require_usable(paths: Sequence[Path], format_: Format, accept_unverified: bool) -> None:
    """Refuse too many files for a format, and an unverified format unless the user accepts it."""
    if len(paths) > len(format_.files):
        value, names = f"{len(paths)} files", ", ".join(format_.files)
        raise InputError.of("interchange.files", file=paths[0], value=value, format=format_.name, names=names)
    if not (format_.verified or accept_unverified):
        raise InputError.of("interchange.unverified", file=paths[0], option="from", value=format_.name)


def filled(
    survey: Survey, *, sigma_ground_m: Three | None = None, sigma_image_px: Two | None = None,
    height_m: float | None = None, check: Sequence[str] = (),
) -> Survey:  # fmt: skip
    """Fill in values that the file of a survey does not contain.

    Parameters
    ----------
    survey : Survey
    sigma_ground_m : (3,) floats, optional
        Standard deviations East, North, Up.
    sigma_image_px : (2,) floats, optional
        Standard deviations of line and sample.
    height_m : float, optional
    check : sequence of str
        Ids of points with coordinates that become check points.
    """
    for name, values in (("sigma_ground", sigma_ground_m), ("sigma_image", sigma_image_px)):
        if values is not None and not all(SMALLEST <= value <= LARGEST for value in values):
            expected = f"numbers from {SMALLEST:g} to {LARGEST:g}"
            raise InputError.of("options.value", option=name, value=" ".join(map(str, values)), expected=expected)
    known = survey.located
    roles = list(survey.roles)
    for name in check:
        if name not in survey.ids or not known[survey.ids.index(name)]:
            raise InputError.of("interchange.no_such_point", option="check", value=name)
        roles[survey.ids.index(name)] = Role.CHECK
    coordinates, sigma, o = survey.coordinates.copy(), survey.sigma_enu_m, survey.observed
    if height_m is not None:
        coordinates[known & np.isnan(coordinates[:, 2]), 2] = height_m
    if sigma_ground_m is not None:
        sigma = np.where(np.isnan(sigma) & known[:, None], sigma_ground_m, sigma)
    if sigma_image_px is not None:
        given = zip((o.sigma_line_px, o.sigma_sample_px), sigma_image_px, strict=True)
        o = ImagePoints(o.image, o.point, o.line, o.sample, *(np.where(np.isnan(s), px, s) for s, px in given))
    return replace(survey, roles=tuple(roles), coordinates=coordinates, sigma_enu_m=sigma, observed=o)


def write_survey(
    survey: Survey, paths: Sequence[Path], format_: Format, settings: Settings, *, overwrite: bool = False
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    """Write a survey in another format.

    Parameters
    ----------
    survey : Survey
    paths : sequence of Path
        One name, or a name for each file of the format.
    format_ : Format
    settings : Settings
        ``crs`` is the CRS of the output. If it is "", the CRS of the survey is kept,
        unless the format requires another.
    overwrite : bool

    Returns
    -------
    tuple of Path
        Written files.
    tuple of Finding
        One finding for each kind of lost information.

    Raises
    ------
    InputError
        The format cannot be written, information that it requires is missing, or a file exists.
    """
    if format_.write is None:
        raise InputError.of("interchange.no_writer", file=paths[0], option="to", value=format_.name)
    require_usable(paths, format_, True)
    targets = tuple(paths) if len(paths) == len(format_.files) else format_.paths(paths[0])
    wanted = targets if len(survey.observed) else targets[:1]  # the second file contains image points only
    require_free_files(*wanted, overwrite=overwrite)
    survey = placed(survey, format_, settings.crs, str(paths[0]))
    _require(survey, format_, str(paths[0]))
    lost = losses(survey, format_, str(paths[0]))
    with outputs(*wanted, overwrite=overwrite):
        lost = (*lost, *(format_.write(survey, targets, settings) or ()))
    return wanted, lost


def placed(survey: Survey, format_: Format, wanted: str, file: str) -> Survey:
    """Transform a survey to the CRS that the user gives or the format requires.

    Standard deviations East, North, Up do not change. Notes name the transformations.
    InputError: the CRS of the survey is unknown, there is no exact transformation, or a
    point has no height.
    """
    crs, rows = wanted or format_.crs, np.flatnonzero(survey.located)
    if Holds.GROUND not in format_.holds or (survey.crs and survey.crs == (crs or survey.crs)):
        return survey
    if not len(rows):
        return replace(survey, crs=crs or survey.crs or WGS84)  # without coordinates, any CRS is correct
    if not survey.crs:
        raise InputError.of("interchange.no_crs", file=file, place="CRS")
    labels = [f"point {survey.ids[k]}" for k in rows]
    for k in np.flatnonzero(np.isnan(survey.coordinates[rows, 2]))[:1]:
        raise InputError.of("interchange.needs_height", file=file, place=labels[k], what=f"CRS {crs}")
    survey = on_found_grid(survey)
    coordinates = survey.coordinates.copy()
    xyz, there = to_ecef_with_operation(survey.crs, *coordinates[rows].T, labels=labels)
    coordinates[rows], back = from_ecef(crs, xyz, labels)
    done = finding("points.operation", place="coordinates", operation=there)
    notes = (*survey.notes, done, finding("points.back", crs=crs, operation=back.name))
    return replace(survey, crs=crs, coordinates=coordinates, notes=notes)


def _require(survey: Survey, format_: Format, file: str) -> None:
    """Refuse a survey without information that the format requires.

    The message names the option that gives it.
    """
    known, o = survey.located, survey.observed
    weighted = known & ~(survey.fixed & (Holds.FIXED in format_.holds))
    lacking = {
        Holds.HEIGHTS: ("interchange.needs_height", known & np.isnan(survey.coordinates[:, 2])),
        Holds.SIGMA_GROUND: ("interchange.needs_sigma_ground", weighted & np.isnan(survey.sigma_enu_m).any(axis=1)),
        Holds.SIGMA_IMAGE: ("interchange.needs_sigma_image", np.isnan(o.sigma_line_px) | np.isnan(o.sigma_sample_px)),
    }
    for what, (code, rows) in lacking.items():
        if what in format_.needs and rows.any():
            k, of_image = int(np.argmax(rows)), what is Holds.SIGMA_IMAGE
            place = f"image point {survey.ids[o.point[k]]}" if of_image else f"point {survey.ids[k]}"
            value = f"{int(rows.sum())} without"
            raise InputError.of(code, file=file, place=place, value=value, what=f"format {format_.name}")


def convert_model(
    paths: Sequence[Path], reader: Format, out: Path, writer: Format, settings: Settings, *,
    accept_unverified: bool = False, overwrite: bool = False,
) -> tuple[FrameModel, tuple[Finding, ...]]:  # fmt: skip
    """Read a frame model and write it in another format; return the model and a finding for each loss.

    ``settings.image_sizes`` is needed if the format does not contain the sizes of the images.

    Raises
    ------
    InputError
        A file cannot be used, the new format cannot contain a camera, or the output exists.
    """
    if reader.read_model is None or writer.write_model is None:
        raise InputError.of("interchange.no_writer", file=out, option="to", value=writer.name)
    require_usable(paths, reader, accept_unverified)
    model = reader.read_model(tuple(paths), settings)
    settings.require_images([pose.name for pose in model.poses], paths[0])
    lost = writer.write_model(out, model, overwrite)
    return model, tuple(finding("lost.model", file=out, value=text, format=writer.name) for text in lost)


# --- plausibility --------------------------------------------------------------------------------


def check_ground(survey: Survey, file: str, scenes: Sequence[Scene] = ()) -> tuple[Finding, ...]:
    """Refuse coordinates that are impossible in their CRS; return remarks on the others.

    The function refuses latitudes and longitudes out of range, columns that seem to be
    exchanged, and points that are far from all ``scenes``, the footprints of the images.
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
        place = lambda k: survey.place(int(rows[k]))  # noqa: E731
        check_positions(scenes, survey.crs, given, to_ecef(survey.crs, *given.T), place, faults)
        faults.raise_if_any()
    return remarks


def _check_ranges(survey: Survey, rows: Index, faults: Faults) -> None:
    for k in rows:
        lon, lat = survey.coordinates[k, :2]
        place = f"{survey.place(k)}, point {survey.ids[k]}"
        if abs(lat) > 90.0:
            code = "interchange.swapped_range" if abs(lon) <= 90.0 and abs(lat) <= 180.0 else "points.latitude"
            faults.add(code, place=place, value=f"{lat:.10g}")
        elif abs(lon) > 180.0:
            faults.add("points.longitude", place=place, value=f"{lon:.10g}")


def _check_area(survey: Survey, rows: Index, faults: Faults) -> tuple[Finding, ...]:
    """Check whether projected coordinates lie in the area of use of their CRS."""
    area = area_of_use(survey.crs)
    first, second = survey.coordinates[rows, :2].T
    outside = ~_in_area(survey.crs, first, second, area)
    if area is None or 2 * outside.sum() <= len(rows):
        return ()
    place, value = f"{survey.place(int(rows[0]))}, point {survey.ids[rows[0]]}", f"{first[0]:.10g} {second[0]:.10g}"
    if _in_area(survey.crs, second, first, area).sum() > outside.sum() // 2:
        faults.add("interchange.swapped", place=place, value=value, crs=survey.crs)
        return ()
    return (
        finding("remark.outside_area", file=faults.file, place=place, value=value, crs=survey.crs,
                count=int(outside.sum()), total=len(rows)),
    )  # fmt: skip


def _in_area(crs: str, first: Array, second: Array, area: tuple[float, float, float, float] | None) -> Mask:
    """Return a mask (n,) of the points that lie in the area of use of a CRS, with a margin."""
    if area is None:
        return np.ones(len(first), bool)
    west, south, east, north = area
    lon, lat = to_geographic(crs, first, second)
    across = np.mod(lon - west + AREA_MARGIN_DEG, 360.0) <= np.mod(east - west, 360.0) + 2.0 * AREA_MARGIN_DEG
    inside = across & (lat >= south - AREA_MARGIN_DEG) & (lat <= north + AREA_MARGIN_DEG)
    return np.asarray(inside & np.isfinite(lon))


# --- losses --------------------------------------------------------------------------------------


def losses(survey: Survey, format_: Format, file: str) -> tuple[Finding, ...]:
    """List the information of the survey that the format cannot contain; ``file`` is used in messages."""
    lost, holds = [], format_.holds
    for what, (code, implied, count) in _COUNTED.items():
        if what is Holds.IDS and Holds.NUMBERS in holds:
            count = _no_numbers
        n = 0 if what in holds or (implied and implied not in holds) else count(survey)
        if n:
            lost.append(finding(code, file=file, value=f"{n} points" if n > 1 else "1 point", format=format_.name))
    code = ""
    if Holds.CRS not in holds and Holds.GROUND in holds and survey.crs:
        code = "lost.crs"
    elif Holds.HEIGHTS in holds and Holds.VERTICAL_CRS not in holds and "+" in survey.crs:
        code = "lost.vertical_crs"
    return (*lost, finding(code, file=file, value=survey.crs, format=format_.name)) if code else tuple(lost)


def _measured(survey: Survey) -> Mask:
    return np.asarray(np.bincount(survey.observed.point, minlength=len(survey.ids)) > 0)


def _numbered(survey: Survey) -> bool:
    """Return whether the ids are the same as if the points were numbered in the order of their image points."""
    _, first = np.unique(survey.observed.point, return_index=True)
    order = survey.observed.point[np.sort(first)]
    return [survey.ids[k] for k in order] == [str(k + 1) for k in range(len(survey.ids))]


def _no_numbers(survey: Survey) -> int:
    """Return the number of ids; return 0 if all ids are whole numbers without leading zeros."""
    return 0 if all(name.isdecimal() and name == str(int(name)) for name in survey.ids) else len(survey.ids)


def _weighted(survey: Survey) -> Mask:
    return np.asarray(np.isfinite(survey.sigma_enu_m).all(axis=1))


def _unequal(survey: Survey, axis: int) -> int:
    """Return the number of points whose standard deviation on this axis differs from the standard deviation East."""
    rows = survey.sigma_enu_m[_weighted(survey)]
    return int((rows[:, 0] != rows[:, axis]).sum())


#: For each kind of information: its message, the kind that includes it, and a function
#: that counts it. If a kind that includes it is also lost, only that kind is reported.
_COUNTED: Final[dict[Holds, tuple[str, Holds | None, Callable[[Survey], int]]]] = {
    Holds.GROUND: ("lost.ground", None, lambda s: int(s.located.sum())),
    Holds.IMAGE: ("lost.image", None, lambda s: len(s.observed)),
    Holds.IDS: ("lost.ids", None, lambda s: 0 if _numbered(s) else len(s.ids)),
    Holds.UNMEASURED: ("lost.unmeasured", Holds.GROUND, lambda s: int((s.located & ~_measured(s)).sum())),
    Holds.BARE_TIES: ("lost.bare_ties", Holds.TIES, lambda s: int((~s.located & ~_measured(s)).sum())),
    Holds.TIES: ("lost.ties", None, lambda s: int((~s.located).sum())),
    Holds.ROLES: ("lost.roles", Holds.GROUND, lambda s: sum(r is Role.CHECK for r in compress(s.roles, s.located))),
    Holds.HEIGHTS: ("lost.heights", Holds.GROUND, lambda s: int((s.located & np.isfinite(s.coordinates[:, 2])).sum())),
    Holds.SIGMA_GROUND: ("lost.sigma_ground", Holds.GROUND, lambda s: int(_weighted(s).sum())),
    Holds.SIGMA_EAST_NORTH: ("lost.sigma_east_north", Holds.SIGMA_GROUND, lambda s: _unequal(s, 1)),
    Holds.SIGMA_UP: ("lost.sigma_up", Holds.SIGMA_GROUND, lambda s: _unequal(s, 2)),
    Holds.SIGMA_IMAGE: ("lost.sigma_image", Holds.IMAGE, lambda s: int(np.isfinite(s.observed.sigma_line_px).sum())),
    Holds.FIXED: ("lost.fixed", Holds.GROUND, lambda s: int(s.fixed.sum())),
}
