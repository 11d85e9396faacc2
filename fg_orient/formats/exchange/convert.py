"""Reading any format, writing any other, and saying what is lost on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fg_orient.formats.exchange.ground import check_ground, transformed
from fg_orient.formats.exchange.losses import losses
from fg_orient.formats.exchange.registry import Format, Holds, Settings
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.scenes import Scene
from fg_orient.geodesy.crs import WGS84
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

Three = tuple[float, float, float]
Two = tuple[float, float]


@dataclass(frozen=True)
class Fill:
    """What stands where a file says nothing: sigmas (m; pixels), height (m), role of points with coordinates."""

    sigma_ground_m: Three | None = None
    sigma_image_px: Two | None = None
    height_m: float | None = None
    check: tuple[str, ...] = ()


def read_survey(
    paths: Sequence[Path], format_: Format, settings: Settings, *, accept_unverified: bool = False,
    scenes: Sequence[Scene] = (),
) -> tuple[Survey, tuple[Finding, ...]]:  # fmt: skip
    """Read the files of a format and check them.

    Parameters
    ----------
    paths : sequence of Path
        One file, or two of a format that has two.
    format_ : Format
        Of these files.
    settings : Settings
        What the files do not say.
    accept_unverified : bool
        Read a format whose conventions were never tried on a file of its program.
    scenes : sequence of Scene
        Where the images look: far points are refused.

    Returns
    -------
    tuple
        The survey and remarks.

    Raises
    ------
    InputError
        Anything is wrong with the files.
    """
    file = paths[0]
    if format_.read is None:
        raise InputError.of("interchange.no_reader", file=file, option="from", value=format_.name)
    require_accepted(paths, format_, accept_unverified)
    survey = format_.read(tuple(paths), settings)
    settings.require_images(survey.images, file)
    remarks = check_ground(survey, str(file), scenes) if survey.crs else ()
    if not format_.verified:
        remarks = (finding("remark.unverified", file=file, value=format_.name), *remarks)
    return survey, remarks


def require_accepted(paths: Sequence[Path], format_: Format, accept_unverified: bool) -> None:
    """Refuse more files than a format has, and a format that was never tried unless that is accepted.

    Raises
    ------
    InputError
        Either of these.
    """
    _require_few(paths, format_)
    if not (format_.verified or accept_unverified):
        raise InputError.of("interchange.unverified", file=paths[0], option="from", value=format_.name)


def filled(survey: Survey, fill: Fill) -> Survey:
    """Survey with given values where its file says nothing.

    Raises
    ------
    InputError
        A check point is asked for that is not there.
    """
    known = survey.located
    roles = list(survey.roles)
    for name in fill.check:
        if name not in survey.ids or not known[survey.ids.index(name)]:
            raise InputError.of("interchange.no_such_point", option="check", value=name)
        roles[survey.ids.index(name)] = Role.CHECK
    coordinates, sigma = survey.coordinates.copy(), survey.sigma_enu_m.copy()
    if fill.height_m is not None:
        coordinates[known & np.isnan(coordinates[:, 2]), 2] = fill.height_m
    if fill.sigma_ground_m is not None:
        without = np.isnan(sigma) & known[:, None]
        sigma = np.where(without, fill.sigma_ground_m, sigma)
    return replace(
        survey, roles=tuple(roles), coordinates=coordinates, sigma_enu_m=sigma,
        observed=_with_sigmas(survey.observed, fill.sigma_image_px),
    )  # fmt: skip


def _with_sigmas(o: ImagePoints, sigma_px: Two | None) -> ImagePoints:
    if sigma_px is None:
        return o
    line, sample = (
        np.where(np.isnan(s), given, s) for s, given in zip((o.sigma_line_px, o.sigma_sample_px), sigma_px, strict=True)
    )
    return ImagePoints(o.image, o.point, o.line, o.sample, line, sample)


def write_survey(
    survey: Survey, paths: Sequence[Path], format_: Format, settings: Settings, *, overwrite: bool = False
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    """Write a survey in a format.

    Parameters
    ----------
    survey : Survey
        Points in any CRS.
    paths : sequence of Path
        One name, or one for each file of the format.
    format_ : Format
        To be written.
    settings : Settings
        ``crs`` is that of the output; "" keeps the survey's, unless the format demands one.
    overwrite : bool
        Replace existing files.

    Returns
    -------
    tuple
        Files written, and one problem for each kind of information that is lost.

    Raises
    ------
    InputError
        The format cannot be written, something that it needs is missing, or a file exists.
    """
    if format_.write is None:
        raise InputError.of("interchange.no_writer", file=paths[0], option="to", value=format_.name)
    _require_few(paths, format_)
    targets = tuple(paths) if len(paths) == len(format_.files) else format_.paths(paths[0])
    wanted = [path for path, used in zip(targets, _used(survey, format_), strict=True) if used]
    for path in wanted:
        if path.exists() and not overwrite:
            raise InputError.of("output.exists", file=path, option="out")
    survey = placed(survey, format_, settings.crs, str(paths[0]))
    _require(survey, format_, str(paths[0]))
    lost = losses(survey, format_, str(paths[0]))
    lost = (*lost, *(format_.write(survey, targets, settings) or ()))
    return tuple(wanted), lost


def placed(survey: Survey, format_: Format, wanted: str, file: str) -> Survey:
    """Survey in the CRS that a user wants, or the format; the operation is among its notes.

    Raises
    ------
    InputError
        The survey's CRS is unknown, or no exact operation leads to the other one.
    """
    crs = wanted or format_.crs
    if Holds.GROUND not in format_.holds or (survey.crs and survey.crs == (crs or survey.crs)):
        return survey
    if not survey.located.any():
        return replace(survey, crs=crs or survey.crs or WGS84)  # without coordinates any will do
    if not survey.crs:
        raise InputError.of("interchange.no_crs", file=file, place="CRS")
    return transformed(survey, crs, file)


def _require_few(paths: Sequence[Path], format_: Format) -> None:
    """Refuse more files than a format has."""
    if len(paths) > len(format_.files):
        value, names = f"{len(paths)} files", ", ".join(format_.files)
        raise InputError.of("interchange.files", file=paths[0], value=value, format=format_.name, names=names)


def _used(survey: Survey, format_: Format) -> list[bool]:
    """Which files of a format are written: the second is left out without image points."""
    return [True, len(survey.observed) > 0][: len(format_.files)]


def _require(survey: Survey, format_: Format, file: str) -> None:
    """Refuse a survey that lacks what a format needs, with the option that gives it."""
    known, o = survey.located, survey.observed
    weighted = known & ~(survey.fixed & (Holds.FIXED in format_.holds))
    lacking: list[tuple[Holds, str, npt.NDArray[np.bool_], str]] = [
        (Holds.HEIGHTS, "interchange.needs_height", known & np.isnan(survey.coordinates[:, 2]), "point"),
        (
            Holds.SIGMA_GROUND, "interchange.needs_sigma_ground",
            weighted & np.isnan(survey.sigma_enu_m).any(axis=1), "point",
        ),
        (
            Holds.SIGMA_IMAGE, "interchange.needs_sigma_image",
            np.isnan(o.sigma_line_px) | np.isnan(o.sigma_sample_px), "image point",
        ),
    ]  # fmt: skip
    for what, code, rows, noun in lacking:
        if what in format_.needs and rows.any():
            k = int(np.flatnonzero(rows)[0])
            name = survey.ids[k] if noun == "point" else survey.ids[int(o.point[k])]
            value = f"{int(rows.sum())} without"
            raise InputError.of(code, file=file, place=f"{noun} {name}", value=value, what=f"format {format_.name}")
