"""Points and image points of a project in other programs' files, read by the readers of ``convert``.

A table of a project names the ``format`` of its file and gives the values that the file lacks. The checks are the same
as for our own tables; coordinates of check points stay sealed until the file is read again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Index
from fg_orient.formats.exchange.convert import filled, read_survey
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.faults import Faults, did_you_mean, sigma_remarks
from fg_orient.formats.heights import ZeroLevel
from fg_orient.formats.points import PLAUSIBLE_SIGMA_PX, ObservationFile, PointFile, point_file
from fg_orient.formats.registry import Holds, Settings, format_named
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.block import Coordinates, GroundPoints, ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

if TYPE_CHECKING:
    from fg_orient.formats.scenes import Scene
    from fg_orient.formats.schema import ObservationsEntry, PointsEntry

#: Options of ``convert`` in messages, and the corresponding entries of a project.
_ENTRIES: Final = {"from": "format", "accept_unverified": "accept_unverified = true"}
#: Format whose reader needs answers for which a project has no entry.
OFFICE: Final = "office"


@dataclass(frozen=True)
class Table:
    """A table of a project file that names a file of another program.

    Parameters
    ----------
    name : str
        "points" or "observations".
    paths : tuple of Path
        The file, or both files of a format that has two.
    entry : PointsEntry or ObservationsEntry
    project : str
        Project file, for messages.
    """

    name: str
    paths: tuple[Path, ...]
    entry: PointsEntry | ObservationsEntry
    project: str

    @property
    def path(self) -> Path:
        """The file that the table names."""
        return self.paths[-1 if self.name == "observations" else 0]

    @cached_property
    def absolute(self) -> tuple[Path, ...]:
        """Absolute paths when the project was read: the files may be read again from another working directory."""
        return tuple(path.absolute() for path in self.paths)

    def read(self, faults: Faults) -> Survey | None:
        """Read the file; if it is unusable, note the errors and return None. Messages name entries of the project."""
        entry, place = self.entry, f"{self.name}.format"
        try:
            format_ = format_named(entry.format, place=place)
            if format_.name == OFFICE:
                raise InputError.of("office.in_project", place=place, value=entry.format)
            needed = Holds.GROUND if self.name == "points" else Holds.IMAGE
            if format_.read is None or needed not in format_.holds:
                raise InputError.of("project.format", place=place, value=entry.format, what=needed)
            for path in self.absolute:
                if not path.exists():
                    raise InputError.of("project.missing_file", place=f"{self.name}.file", value=path.name,
                                        folder=path.parent)  # fmt: skip
            settings = Settings(entry.crs or "", entry.image, entry.sigma_axes)
            survey, _ = read_survey(self.absolute, format_, settings, accept_unverified=entry.accept_unverified)
            return filled(
                survey, sigma_ground_m=getattr(entry, "sigma_m", None), sigma_image_px=getattr(entry, "sigma_px", None),
                height_m=getattr(entry, "height_m", None), check=getattr(entry, "check", ()),
            )  # fmt: skip
        except InputError as error:
            named = dict(zip(map(str, self.absolute), map(str, self.paths), strict=True))
            for p in error.problems:
                place = f"{self.name}.{_ENTRIES.get(p.option, p.option)}" if p.option else p.place
                file = named.get(p.file, p.file) or self.project
                faults.take(replace(p, file=file, option="", place=place, names=_ENTRIES))
            return None


def read_foreign_points(table: Table, faults: Faults, scenes: list[Scene]) -> PointFile | None:
    """Read ground points; if the file is unusable, note the errors and return None.

    ``scenes`` are the footprints of the images.
    """

    def parse(faults: Faults) -> Survey | None:
        survey = table.read(faults)
        if survey is None:
            return None
        _require_whole(survey, faults)
        return replace(survey, coordinates=np.where(survey.located[:, None], survey.coordinates, np.nan))

    level = ZeroLevel.of(table.entry, Path(table.project).parent)
    return point_file(table.path, table.absolute, parse, faults, scenes, level)


def _require_whole(survey: Survey, faults: Faults) -> None:
    """Note points with coordinates that lack a height or a standard deviation."""
    known = survey.located
    for what, lacking, entry in (
        ("height", np.isnan(survey.coordinates[:, 2]), "height_m = METRES"),
        ("standard deviation", np.isnan(survey.sigma_enu_m).any(axis=1) & ~survey.fixed, "sigma_m = [E, N, U]"),
    ):
        for k in np.flatnonzero(known & lacking).tolist():
            line = f"{survey.place(k)}, " if survey.lines[k] else ""
            faults.add("project.lacks", place=f"{line}point {survey.ids[k]}", what=what, entry=f"{entry} to [points]")


def read_foreign_observations(
    table: Table,
    sizes: Mapping[str, tuple[int, int] | None] | None,
    points: PointFile | None,
    faults: Faults,
    serials: Mapping[str, str] | None = None,
) -> tuple[ObservationFile, PointFile] | None:
    """Read image points of known ground points; other points of the file become tie points.

    None, with noted errors, if anything is wrong; parameters as in
    :func:`fg_orient.formats.points.read_observations`. ``serials``: images by the names that other programs give them.
    """
    survey = table.read(faults)
    if survey is None or sizes is None or points is None:
        return None
    image = _images(survey, list(sizes), table.entry, faults, serials or {})
    _check_pixels(survey, image, list(sizes.items()), faults)
    if faults:
        return None
    points = _with_ties(points, survey)
    place = {name: k for k, name in enumerate(points.points.ids)}
    o, row = survey.observed, np.array([place[name] for name in survey.ids], np.intp)
    measured = ImagePoints(image[o.image], row[o.point], o.line, o.sample, o.sigma_line_px, o.sigma_sample_px)
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    remarks = sigma_remarks(
        "remark.sigma_image", faults.file, sigma, PLAUSIBLE_SIGMA_PX, lambda k: f"point {survey.ids[o.point[k]]}"
    )
    return ObservationFile(table.path, sha256_of(*table.absolute), measured, remarks), points


def _images(
    survey: Survey, known: list[str], entry: PointsEntry | ObservationsEntry, faults: Faults, serials: Mapping[str, str]
) -> Index:
    """Position of each image of the file in the project: by ``images``, its name with or without suffix, its serial."""
    renamed = getattr(entry, "images", {})
    out = np.zeros(len(survey.images), np.intp)
    for k, name in enumerate(survey.images):
        words = (renamed.get(name, ""), name, Path(name).stem, serials.get(name, ""))
        own = next((n for n in words if n in known), None)
        if own is None:
            hint = did_you_mean(name, known)
            faults.add("observations.image_unknown", place=f"image {name}", value=repr(name), times="", hint=hint)
        else:
            out[k] = known.index(own)
    if not faults and len(set(out.tolist())) < len(out):
        faults.add("project.images_alike", place="images", value=", ".join(survey.images))
    return out


def _check_pixels(
    survey: Survey, image: Index, sizes: list[tuple[str, tuple[int, int] | None]], faults: Faults
) -> None:
    """Note image points outside their image, or without a standard deviation."""
    o = survey.observed
    size = np.array([n or (np.inf, np.inf) for _, n in sizes], float).reshape(-1, 2)[image[o.image]]
    for axis, values, last in (("line", o.line, size[:, 0] - 0.5), ("sample", o.sample, size[:, 1] - 0.5)):
        for k in np.flatnonzero((values < -0.5) | (values > last)):
            faults.add("observations.outside", place=_place(survey, int(k)), value=f"{axis} {values[k]:.10g}",
                       image=survey.images[o.image[k]], axis=axis, last=float(last[k]))  # fmt: skip
    lacking = np.flatnonzero(np.isnan(o.sigma_line_px) | np.isnan(o.sigma_sample_px))
    if len(lacking):
        faults.add("project.lacks", place=_place(survey, int(lacking[0])), value=f"{len(lacking)} image points",
                   what="standard deviation", entry="sigma_px = [LINE, SAMPLE] to [observations]")  # fmt: skip


def _place(survey: Survey, k: int) -> str:
    o = survey.observed
    return f"point {survey.ids[o.point[k]]} in image {survey.images[o.image[k]]}"


def _with_ties(points: PointFile, survey: Survey) -> PointFile:
    """Return all points; points that only the image points name become tie points."""
    known, old = set(points.points.ids), points.points
    seen = np.bincount(survey.observed.point, minlength=len(survey.ids)) > 0
    new = tuple(name for name, yes in zip(survey.ids, seen, strict=True) if yes and name not in known)
    if not new:
        return points
    none, k = np.full((len(new), 3), np.nan), old.known
    joined = Coordinates(np.vstack([k.ecef_m, none]), np.vstack([k.sigma_enu_m, none]),
                         np.append(k.fixed, np.zeros(len(new), bool)))  # fmt: skip
    return replace(points, points=GroundPoints(old.ids + new, old.roles + (Role.TIE,) * len(new), joined))
