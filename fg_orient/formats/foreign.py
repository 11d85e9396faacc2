"""Read the points and image points of a project from files of other programs.

The command ``convert`` has the same readers. A table of the project file names the ``format`` of the
other file. It also gives the values that the other file does not contain. The data pass the same checks
as data from our own tables. The coordinates of check points stay sealed: the file is read again to open
them.
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
from fg_orient.formats.scenes import exchanged_pixels
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.block import Coordinates, GroundPoints, ImagePoints
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

if TYPE_CHECKING:
    from fg_orient.formats.scenes import Scene
    from fg_orient.formats.schema import ObservationsEntry, PointsEntry

#: Messages of the readers name options of ``convert``. These are the corresponding entries of a project file.
_ENTRIES: Final = {"from": "format", "accept_unverified": "accept_unverified = true"}
#: This format is refused in a project: its reader needs answers for which a project file has no entries.
OFFICE: Final = "office"


@dataclass(frozen=True)
class Table:
    """Table of a project file that names a file of another program.

    Parameters
    ----------
    name : str
        "points" or "observations".
    paths : tuple of Path
        The file; two files if the format consists of two.
    entry : PointsEntry or ObservationsEntry
    project : str
        Project file; used in messages.
    """

    name: str
    paths: tuple[Path, ...]
    entry: PointsEntry | ObservationsEntry
    project: str

    @property
    def path(self) -> Path:
        """Return the file that the table names."""
        return self.paths[-1 if self.name == "observations" else 0]

    @cached_property
    def absolute(self) -> tuple[Path, ...]:
        """Return the absolute paths of the files.

        The files may be read again after a change of the working directory.
        """
        return tuple(path.absolute() for path in self.paths)

    def read(self, faults: Faults) -> Survey | None:
        """Read the file.

        If this fails, note the errors and return None; messages name entries of the project file.
        """
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
    """Read ground points. If the file cannot be used, note the errors and return None.

    ``scenes`` contains the footprints of the images.
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
    """Note a fault for points that have coordinates but no height or no standard deviation."""
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
    """Read image points. Points of the file that have no ground point become tie points.

    If the file has a fault, the errors are noted and the result is None. For the
    parameters see :func:`fg_orient.formats.points.read_observations`. ``serials``
    contains the images by the serial numbers that other programs give them.
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
    """Return the position in the project of each image of the file.

    An image is found by the table ``images``, by its name with or without suffix, or by its serial number.
    """
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
    """Note faults of image points: outside the image, or without a standard deviation."""
    o = survey.observed
    size = np.array([n or (np.inf, np.inf) for _, n in sizes], float).reshape(-1, 2)[image[o.image]]
    exchanged, beyond = exchanged_pixels(image[o.image], np.stack([o.line, o.sample], axis=1), size)
    if beyond.any():
        names = [survey.images[k] for k in np.unique(o.image[exchanged]).tolist()]
        faults.add("observations.exchanged", place=_place(survey, int(np.argmax(beyond))), images=names,
                   outside=int(beyond.sum()), total=int(exchanged.sum()))  # fmt: skip
    for axis, values, last in (("line", o.line, size[:, 0] - 0.5), ("sample", o.sample, size[:, 1] - 0.5)):
        for k in np.flatnonzero(((values < -0.5) | (values > last)) & ~exchanged):
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
    """Return all points.

    A point that has image points but no entry among the points becomes a tie point.
    """
    known, old = set(points.points.ids), points.points
    seen = np.bincount(survey.observed.point, minlength=len(survey.ids)) > 0
    new = tuple(name for name, yes in zip(survey.ids, seen, strict=True) if yes and name not in known)
    if not new:
        return points
    none, k = np.full((len(new), 3), np.nan), old.known
    joined = Coordinates(np.vstack([k.ecef_m, none]), np.vstack([k.sigma_enu_m, none]),
                         np.append(k.fixed, np.zeros(len(new), bool)))  # fmt: skip
    return replace(points, points=GroundPoints(old.ids + new, old.roles + (Role.TIE,) * len(new), joined))
