"""Pixels in the report: pictures of the images under the residual vectors, and chips about the largest residuals.

Image points that the search for gross errors removed have no residual in the result. The estimated error of
their test, with the opposite sign, replaces it. These points come before all other points, which passed
the tests. A record contains the names of the rasters relative to the result folder. If a raster is
missing or cannot be read, a sentence on the page states this; it is never an error. Without rasterio
the page has no pictures.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fg_orient.formats.gdal import encoded, rasterio_of
from fg_orient.formats.rasters import Place, Raster, place_of, raster_beside
from fg_orient.model.errors import InputError
from fg_orient.report.chart import Picture
from fg_orient.report.plots import worst_images
from fg_orient.report.tables import largest_rows
from fg_orient.result.record import Result

if TYPE_CHECKING:
    from fg_orient.model.block import Image

#: Longer side of the picture of an image, and side of a chip, pixels.
SIDE_PX: Final = 240
CHIP_PX: Final = 64
#: Number of chips.
CHIPS: Final = 10
#: Maximum number of images that a sentence names.
NAMED: Final = 5
#: Maximum number of bytes of all pictures, so that the whole page stays below 8 MB.
BUDGET: Final = 600_000
#: Maximum number of pixels that GDAL decodes for the pictures of all images. Rasters with overviews need few.
DECODED: Final = 200_000_000
#: Reasons why an image has no picture.
ABSENT: Final = "the raster is not where result.json says"
UNREADABLE: Final = "the raster cannot be read"
OTHER: Final = (
    "the raster does not contain all of its image points; a part of the scene needs pixels_origin in the project file"
)
LARGE: Final = "the rasters are large and have no overviews, which gdaladdo makes"
FULL: Final = "the pictures of a page have 0.6 MB at most"
#: Quantiles of the grey values that become black and white, and the grey value of empty pixels.
STRETCH: Final = (2.0, 98.0)
EMPTY: Final = 128


class Measured(NamedTuple):
    """Image point with its residual v, in pixels and in standard deviations, and the round of its removal."""

    image: str
    id: str
    line: float
    sample: float
    v_line_px: float
    v_sample_px: float
    w: float
    removed: int = 0


@dataclass(frozen=True)
class Chip:
    """Picture of the pixels around an image point; ``x``, ``y`` is the point in pixels of the chip."""

    href: str
    point: Measured
    x: float
    y: float

    @property
    def arrow(self) -> str:
        """SVG path of the residual vector, at the scale of the pixels."""
        v = np.array([self.point.v_sample_px, self.point.v_line_px])
        length = float(np.hypot(*v))
        if not length > 0.0:
            return ""
        end, back = np.array([self.x, self.y]) + v, v / length * min(3.0, 0.5 * length)
        sides = [end - back + 0.5 * side * np.array([-back[1], back[0]]) for side in (-1.0, 1.0)]
        points = ((self.x, self.y), end, sides[0], end, sides[1])
        return "M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points)


@dataclass
class Pictures:
    """Pictures of a page.

    Parameters
    ----------
    images : dict
        Pictures by image.
    chips : list of Chip
        Chips of removed image points, then chips of the largest residuals.
    missing : dict
        Images without a picture, by reason.
    used : int
        Bytes of all pictures in the page.
    """

    images: dict[str, Picture] = field(default_factory=dict)
    chips: list[Chip] = field(default_factory=list)
    missing: dict[str, list[str]] = field(default_factory=dict)
    used: int = 0

    @property
    def notes(self) -> list[str]:
        """Return sentences on images without a picture."""
        return [f"No picture of image {', '.join(images[:NAMED])}{' and others' * (len(images) > NAMED)}: {reason}"
                for reason, images in self.missing.items()]  # fmt: skip

    def lacks(self, image: str, reason: str) -> None:
        """Record the reason why an image has no picture."""
        self.missing.setdefault(reason, []).append(image)

    def fits(self, href: str) -> bool:
        """Return whether the page has room for a picture; if so, count its bytes."""
        room = self.used + len(href) <= BUDGET
        self.used += len(href) if room else 0
        return room


def rasters_of(result: Result, images: Sequence[Image], folder: Path) -> dict[str, Any]:
    """Return the entry ``pixels`` of the record if images have rasters; files are relative to the result folder."""
    shown, base = set(_shown(result)), folder.resolve()
    out: dict[str, Any] = {}
    for image in (image for image in images if image.id in shown):
        metadata = Path(image.sensor.file)
        raster = Path(image.pixels) if image.pixels else raster_beside(metadata) if metadata.is_file() else None
        if raster is not None:
            origin = None if image.pixels_origin is None else list(image.pixels_origin)
            out[image.id] = {"file": Path(os.path.relpath(raster.resolve(), base)).as_posix(), "origin": origin}
    return {"pixels": out} if out else {}


def pictures_of(result: Result, folder: Path | None) -> Pictures:
    """Read the pictures of a result in a folder. There are none without a folder or without rasterio."""
    out = Pictures()
    if folder is None or not result.adjusted or not result.record.get("pixels"):
        return out
    try:
        rasterio_of(folder)
    except InputError:
        return out
    places = dict(_places(result, folder.resolve(), out))
    _add_chips(result, places, out)
    _add_images(result, places, out)
    return out


def _shown(result: Result) -> Iterator[str]:
    """Return images whose vectors are drawn, then images with the largest residuals."""
    yield from worst_images(result.residual_summary())
    yield from (point.image for point in worst_points(result))


def worst_points(result: Result) -> list[Measured]:
    """Return the image points of the chips: removed ones, then the points with the largest residuals."""
    removed = list[Measured]()
    gone = result.tables.get("outliers")
    if gone is not None:
        names = ("line", "sample", "error_line_px", "error_sample_px", "round", "readmitted")
        for image, name, (line, sample, e_line, e_sample, number, back) in zip(
            gone.words["image"], gone.words["id"], gone.numbers(*names).tolist(), strict=True
        ):
            if np.isnan(back) and np.isfinite([line, sample, e_line, e_sample]).all():
                removed.append(Measured(image, name, line, sample, -e_line, -e_sample, np.nan, int(number)))
    removed.sort(key=lambda one: -np.hypot(one.v_line_px, one.v_sample_px))
    table, ratio = result.residuals, np.nan_to_num(np.abs(result.normalised[0])).max(axis=1)
    rows = largest_rows(result, CHIPS)
    values = table.numbers("line", "sample", "v_line_px", "v_sample_px", rows=rows).tolist()
    kept = [Measured(table.words["image"][k], table.words["id"][k], line, sample, v_line, v_sample, float(ratio[k]))
            for k, (line, sample, v_line, v_sample) in zip(rows.tolist(), values, strict=True)]  # fmt: skip
    return [*removed, *kept][:CHIPS]


def _places(result: Result, folder: Path, out: Pictures) -> Iterator[tuple[str, Place]]:
    """Return, by image, the rasters that can be opened and contain the image points."""
    for image, entry in result.record["pixels"].items():
        path, origin = folder / entry["file"], entry["origin"]
        if not path.is_file():
            out.lacks(image, ABSENT)
            continue
        try:
            place = place_of(path, None if origin is None else tuple(origin), image, "")
        except InputError:
            out.lacks(image, UNREADABLE)
            continue
        at = result.residuals.numbers("line", "sample", rows=result.rows[image]) - [place.line, place.sample]
        if origin is None and not ((at >= -1.0) & (at <= [place.rows, place.columns])).all():
            out.lacks(image, OTHER)
            continue
        yield image, place


def _add_chips(result: Result, places: dict[str, Place], out: Pictures) -> None:
    """Add the chips; the window of each is read separately."""
    for point in worst_points(result):
        if point.image not in places:
            continue
        place = places[point.image]
        row, column = point.line - place.line, point.sample - place.sample
        top, left = round(row) - CHIP_PX // 2, round(column) - CHIP_PX // 2
        try:
            with closing(Raster(place)) as raster:
                grey = raster.window(top, left, CHIP_PX, CHIP_PX)
        except InputError:
            del places[point.image]
            out.lacks(point.image, UNREADABLE)
            continue
        href = _address(grey, "PNG")
        if np.isfinite(grey).any() and out.fits(href):
            out.chips.append(Chip(href, point, column - left + 0.5, row - top + 0.5))


def _add_images(result: Result, places: dict[str, Place], out: Pictures) -> None:
    """Add pictures of images, the largest residuals first, within the limits of bytes and decoded pixels."""
    decoded = 0.0
    for image in worst_images(result.residual_summary()):
        if image not in places:
            continue
        place = places[image]
        factor = max(1.0, max(place.rows, place.columns) / SIDE_PX)
        try:
            with closing(Raster(place)) as raster:
                needed = raster.decoded(factor)
                if decoded + needed > DECODED:
                    out.lacks(image, LARGE)
                    continue
                decoded += needed
                grey = raster.decimated(max(1, round(place.rows / factor)), max(1, round(place.columns / factor)))
        except InputError:
            out.lacks(image, UNREADABLE)
            continue
        href = _address(grey, "JPEG")
        if not out.fits(href):
            out.lacks(image, FULL)
            continue
        out.images[image] = Picture(href, (place.sample - 0.5, place.sample + place.columns - 0.5),
                                    (place.line - 0.5, place.line + place.rows - 0.5))  # fmt: skip


def _address(grey: npt.NDArray[np.float32], driver: str) -> str:
    """Return a picture as a data address. Grey values are stretched between quantiles; empty pixels are grey."""
    valid = np.isfinite(grey)
    low, high = np.percentile(grey[valid], STRETCH) if valid.any() else (0.0, 1.0)
    scaled = (np.where(valid, grey, low) - low) * (255.0 / ((high - low) or 1.0))
    picture = np.where(valid, np.clip(np.rint(scaled), 0, 255), EMPTY).astype(np.uint8)
    return f"data:image/{driver.lower()};base64,{base64.b64encode(encoded(picture, driver)).decode()}"
