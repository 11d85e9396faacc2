"""Table of image observations: one record per image and point, pixels and their sigmas.

(line, sample) with (0, 0) in the centre of the first pixel; an image of n lines spans
-0.5 .. n - 0.5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.tables import Faults, Row, Table, did_you_mean, number, read_table
from fg_orient.model.block import ImagePoints, Index
from fg_orient.model.errors import Finding, finding

COLUMNS: Final = ("image", "id", "line", "sample", "sigma_line_px", "sigma_sample_px")
#: Standard deviations outside this range are more likely a wrong unit than a measurement.
PLAUSIBLE_SIGMA_PX: Final = (1e-4, 1e3)


@dataclass(frozen=True)
class ObservationFile:
    """Image observations as read, the SHA-256 of the file and remarks about it."""

    path: Path
    sha256: str
    observations: ImagePoints
    remarks: tuple[Finding, ...]


def read_observations(
    path: Path, sizes: Mapping[str, tuple[int, int] | None] | None, point_ids: Sequence[str] | None, faults: Faults
) -> ObservationFile | None:
    """Read a table of image observations.

    Parameters
    ----------
    path : Path
        CSV file with the columns ``image, id, line, sample, sigma_line_px, sigma_sample_px``.
    sizes : mapping of str to (n_lines, n_samples) or None, or None
        The images in the order of the block; None where the size is unknown (the pixel
        range is then not checked), or for all if the images are unknown.
    point_ids : sequence of str or None
        Ids of the ground points; None if they are unknown (ids are then not checked).
    faults : Faults
        Takes everything wrong with the file.

    Returns
    -------
    ObservationFile or None
        None if anything is wrong; the reasons are then in ``faults``.
    """
    table = read_table(path, [COLUMNS], faults)
    if table is None:
        return None
    image_row = {name: k for k, name in enumerate(sizes)} if sizes is not None else None
    point_row = {name: k for k, name in enumerate(point_ids)} if point_ids is not None else None
    observations = None if faults or sizes is None else _converted(table, sizes, image_row, point_row)
    if observations is None:
        _complain(table, sizes, image_row, point_row, faults)
        return None
    return ObservationFile(path, table.sha256, observations, _remarks(faults.file, table, observations))


def _converted(
    table: Table,
    sizes: Mapping[str, tuple[int, int] | None],
    image_row: Mapping[str, int] | None,
    point_row: Mapping[str, int] | None,
) -> ImagePoints | None:
    """The whole table at once; None if the names are unknown or anything is wrong with it."""
    values = table.numbers(*COLUMNS[2:])
    image, point = _positions(table.cells["image"], image_row), _positions(table.cells["id"], point_row)
    if values is None or image is None or point is None or point_row is None:
        return None
    size = np.array([n or (np.inf, np.inf) for n in sizes.values()], float).reshape(-1, 2)[image]
    inside = (values[:, :2] >= -0.5) & (values[:, :2] <= size - 0.5)
    key = np.sort(image * max(len(point_row), 1) + point)
    if not (inside.all() and (values[:, 2:] > 0.0).all() and np.diff(key).all()):
        return None
    return ImagePoints(image, point, *values.T)


def _positions(names: Sequence[str], known: Mapping[str, int] | None) -> Index | None:
    """Place of each name; None if one is unknown, or all are."""
    if known is None:
        return None
    try:
        return np.fromiter(map(known.__getitem__, names), np.intp, len(names))
    except KeyError:
        return None


def _complain(
    table: Table,
    sizes: Mapping[str, tuple[int, int] | None] | None,
    image_row: Mapping[str, int] | None,
    point_row: Mapping[str, int] | None,
    faults: Faults,
) -> None:
    """Note what is wrong, record by record."""
    first: dict[tuple[str, str], int] = {}
    for row in table.rows:
        _check_names(row, image_row, point_row, first, faults)
        _check_values(row, (sizes or {}).get(row.cells["image"]), faults)


def _check_names(
    row: Row,
    images: Mapping[str, int] | None,
    points: Mapping[str, int] | None,
    first: dict[tuple[str, str], int],
    faults: Faults,
) -> None:
    image, name = row.cells["image"], row.cells["id"]
    if images is not None and image not in images:
        hint = did_you_mean(image, list(images))
        faults.add("observations.image_unknown", place=row.place("image"), value=repr(image), hint=hint)
    if points is not None and name not in points:
        hint = did_you_mean(name, list(points))
        faults.add("observations.point_unknown", place=row.place("id"), value=repr(name), hint=hint)
    if (image, name) in first:
        place = row.place("id")
        faults.add("observations.twice", place=place, value=f"{name} in {image}", first=first[image, name])
    first.setdefault((image, name), row.line)


def _check_values(row: Row, size: tuple[int, int] | None, faults: Faults) -> None:
    """Note faults of line, sample and their sigmas of one record."""
    values = tuple(number(row, column, faults) for column in COLUMNS[2:])
    for axis, value, n in zip(("line", "sample"), values[:2], size or (), strict=False):
        if not -0.5 <= value <= n - 0.5 and not np.isnan(value):
            cell, image = row.cells[axis], row.cells["image"]
            faults.add("observations.outside", place=row.place(axis), value=cell, image=image, axis=axis, last=n - 0.5)
    for column, value in zip(COLUMNS[4:], values[2:], strict=True):
        if value <= 0.0:
            faults.add("observations.sigma_not_positive", place=row.place(column), value=row.cells[column])


def _remarks(file: str, table: Table, o: ImagePoints) -> tuple[Finding, ...]:
    sigma = np.stack([o.sigma_line_px, o.sigma_sample_px], axis=1)
    return remarks_on_sigmas(file, sigma, lambda k: table.row(k).place())


def remarks_on_sigmas(file: str, sigma: npt.NDArray[np.float64], place_of: Callable[[int], str]) -> tuple[Finding, ...]:
    """Remark on implausible standard deviations (n, 2), px; ``place_of`` names the place of a row."""
    low, high = PLAUSIBLE_SIGMA_PX
    odd = np.flatnonzero(((sigma < low) | (sigma > high)).any(axis=1))
    if not len(odd):
        return ()
    place, value = f"{place_of(int(odd[0]))}, sigma", " ".join(f"{s:g}" for s in sigma[odd[0]])
    return (finding("remark.sigma_image", file=file, place=place, value=value, low=low, high=high, count=len(odd)),)
