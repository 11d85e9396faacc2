"""Make a project from the files of an office: images, tables of unknown form, and assumptions about them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import Contents, require_free, staged_folder
from fg_orient.formats.exchange.convert import filled
from fg_orient.formats.exchange.own_csv import write
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.heights import ZeroLevel, lacking_operation, without_vertical
from fg_orient.formats.office.decisions import Choice, Decisions, Office, Question
from fg_orient.formats.office.images import FoundImage, read_images, sorted_files
from fg_orient.formats.office.sheets import read_sheets
from fg_orient.formats.office.survey import read_survey
from fg_orient.formats.points_write import write_project
from fg_orient.formats.project import read_project_with_remarks
from fg_orient.formats.registry import Settings
from fg_orient.geodesy.crs import WGS84
from fg_orient.geodesy.heights import found_grid, vertical_reference
from fg_orient.model.errors import Finding, InputError
from fg_orient.model.names import Role

NO_LEVEL: Final = ZeroLevel()
#: Files of a new project.
PROJECT: Final = Contents("project.toml", ("project.toml", "points.csv", "observations.csv"))
_POINTS, _OBSERVATIONS = "points.csv", "observations.csv"


@dataclass(frozen=True)
class Given:
    """Values from the user that tables may not contain.

    Parameters
    ----------
    sigma_ground_m, sigma_image_px : tuple of float, optional
        Standard deviations East, North, Up, m; line, sample, px.
    height_m : float, optional
    check : sequence of str
        Ids of check points.
    level : ZeroLevel
        Zero level of the heights; the heights are converted to ellipsoidal heights.
    """

    sigma_ground_m: tuple[float, float, float] | None = None
    sigma_image_px: tuple[float, float] | None = None
    height_m: float | None = None
    check: Sequence[str] = ()
    level: ZeroLevel = NO_LEVEL


@dataclass(frozen=True, eq=False)
class Draft:
    """Project before it is written: images, survey (None without tables), and the files that were read.

    ``heights_known``: the user or an assumption that was printed states the kind of the heights.
    """

    images: list[FoundImage]
    survey: Survey | None
    files: list[Path]
    heights_known: bool = False


def draft(sources: Sequence[Path], out: Path, office: Office, given: Given, decisions: Decisions, *,
          overwrite: bool = False) -> Draft:  # fmt: skip
    """Read the files of an office.

    Parameters
    ----------
    sources : sequence of Path
        Files and folders.
    out : Path
        Folder of the project; it is not read as a source.
    office, given : Office, Given
        Statements of the user.
    decisions : Decisions
        Collects the assumptions, and asks questions.
    overwrite : bool

    Raises
    ------
    InputError
        A file cannot be used, or a question has no answer.
    """
    require_free(out, overwrite=overwrite, contents=PROJECT)
    image_files, tables = sorted_files(sources)
    inside = out.absolute()
    image_files = [one for one in image_files if inside not in one[0].absolute().parents]
    tables = [path for path in tables if inside not in path.absolute().parents]
    images = read_images(image_files, decisions)
    if not images:
        raise InputError.of("office.no_images", file=sources[0])
    sheets = [sheet for path in tables for sheet in read_sheets(path)]
    survey = None
    if sheets:
        if given.level:
            office = replace(office, heights="ellipsoidal", lift_m=_lift_m(given.level, images))
        survey = read_survey(sheets, office, decisions, {image.id: image.sensor for image in images})
        folders = [path for path in sources if path.is_dir()]
        given = replace(given, level=given.level or _found_level(survey, folders, decisions, str(sheets[0].path)))
        survey = _completed(survey, given, decisions, str(sheets[0].path))
    decisions.require_answers()
    known = bool(office.heights) or any(one.subject == "heights" for one in decisions.assumed)
    return Draft(images, survey, [*(image.path for image in images), *tables], known)


def _lift_m(level: ZeroLevel, images: Sequence[FoundImage]) -> float:
    """Return the height of the zero level above the ellipsoid in the middle of the first georeferenced image, m."""
    corners = next((image.sensor.footprint() for image in images if image.sensor.georeferenced), None)
    if corners is None:
        return 0.0
    place = np.array([[*corners.mean(axis=0), 0.0]])
    point = Survey(WGS84, ("middle",), (Role.CONTROL,), place, np.ones((1, 3)), np.zeros(1, bool))
    return float(level.applied(point).coordinates[0, 2])


def _found_level(survey: Survey, folders: Sequence[Path], decisions: Decisions, file: str) -> ZeroLevel:
    """Find the geoid file of the heights if PROJ does not have their grid.

    The geoid file is a file in the folders with the name of the grid; if there is no such file, the user is asked.
    """
    name = vertical_reference(survey.crs)[0] if survey.crs and survey.located.any() else ""
    error = lacking_operation(survey) if name else None
    if error is None or found_grid(error) is not None:
        return NO_LEVEL
    grid = found_grid(error, folders) if folders else None
    choices = () if grid is None else (Choice(str(grid.path)),)
    reason = f"the grid that {name} needs is not in PROJ's folders"
    reason += "" if grid is None else "; the file of its name is taken, and heights become ellipsoidal"
    answer = decisions.settle(Question("geoid", "the geoid file of the heights", choices, grid is not None, reason,
                                       "FILE"), file, later=True)  # fmt: skip
    return NO_LEVEL if answer is None else ZeroLevel(geoid=Path(answer.value))


def _completed(survey: Survey, given: Given, decisions: Decisions, file: str) -> Survey:
    """Fill in the given values; ask the user for values that are still missing."""
    survey = filled(survey, sigma_ground_m=given.sigma_ground_m, sigma_image_px=given.sigma_image_px,
                    height_m=given.height_m, check=given.check)  # fmt: skip
    known, o = survey.located & np.array([r is not Role.TIE for r in survey.roles], bool), survey.observed
    for option, lacking, subject, example, names in (
        ("height", known & np.isnan(survey.coordinates[:, 2]), "the height of points without one, m", "120", 1),
        ("sigma_ground", known & ~survey.fixed & np.isnan(survey.sigma_enu_m).any(axis=1),
         "standard deviations of ground points East, North, Up, m", "0.05 0.05 0.1", 3),
        ("sigma_image", np.isnan(o.sigma_line_px) | np.isnan(o.sigma_sample_px),
         "standard deviations of image points, line and sample, px", "0.5 0.5", 2),
    ):  # fmt: skip
        if not lacking.any():
            continue
        question = Question(option, subject, (), False, f"{int(lacking.sum())} without", example)
        answer = decisions.settle(question, file, later=True)
        if answer is None:
            continue
        values = _numbers(answer.value, names, option)
        survey = filled(survey, **{
            "height": {"height_m": values[0]}, "sigma_ground": {"sigma_ground_m": values},
            "sigma_image": {"sigma_image_px": values},
        }[option])  # type: ignore[arg-type]  # fmt: skip
    if given.level:
        survey = given.level.applied(without_vertical(survey))
        for note in survey.notes:
            decisions.note("heights", note.message, "the zero level was given")
    return survey


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    parts = text.replace(",", " ").split()
    try:
        values = tuple(float(part) for part in parts)
    except ValueError:
        values = ()
    if len(values) == 1:
        values *= count
    if len(values) != count or not np.isfinite(values).all() or (option != "height" and min(values) <= 0.0):
        raise InputError.of("office.value", option=option, value=text, expected=f"{count} number(s)")
    return values


def write_draft(made: Draft, out: Path, decisions: Decisions, *, overwrite: bool = False) -> tuple[Finding, ...]:
    """Write a project. The strict reader reads it again before it replaces the output.

    Returns
    -------
    tuple of Finding
        Remarks of the strict reader.

    Raises
    ------
    InputError
        The strict reader refuses the project, or it cannot be written.
    """
    target = out.absolute()
    comments = ["made by fg-orient new from " + ", ".join(path.name for path in made.files)]
    comments += [f"assumed: {_line(one.subject, one.value, one.reason, one.option)}" for one in decisions.assumed]
    with staged_folder(out, overwrite=overwrite, contents=PROJECT) as folder:
        tables = made.survey is not None
        if made.survey is not None:
            write(made.survey, (folder / _POINTS, folder / _OBSERVATIONS), Settings())
        write_project(
            folder / "project.toml", name=target.name, images=[(i.id, _relative(i.path, target)) for i in made.images],
            points=_POINTS if tables else None, crs=made.survey.crs if made.survey is not None else "",
            observations=_OBSERVATIONS,
            comments=comments,
        )  # fmt: skip
        if not tables or not len(made.survey.observed):  # type: ignore[union-attr]
            return ()
        try:
            remarks = read_project_with_remarks(folder / "project.toml")[1]
            stated = {"heights.ellipsoidal"} if made.heights_known else set()
            return _shown([one for one in remarks if one.code not in stated], folder, out)
        except InputError as error:
            raise InputError(*_shown(error.problems, folder, out)) from None


def _shown(found: Sequence[Finding], folder: Path, out: Path) -> tuple[Finding, ...]:
    """Return the findings with the file names of the output instead of those of the temporary folder."""
    return tuple(replace(one, file=one.file.replace(str(folder), str(out))) for one in found)


def _line(subject: str, value: str, reason: str, option: str) -> str:
    flag = f" [--{option.replace('_', '-')}]" if option else ""
    return " ".join(f"{subject}: {value} ({reason}){flag}".split())


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.absolute(), folder)).as_posix()
