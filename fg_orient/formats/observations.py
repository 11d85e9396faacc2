"""Table of image observations: one record per image and point.

A record has pixels and their standard deviations: (line, sample) with (0, 0) in the centre of
the first pixel. An image of n lines spans -0.5 .. n - 0.5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.faults import Faults, sigma_remarks
from fg_orient.formats.table_files import read_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding

#: Columns of a table of observations.
COLUMNS: Final = ("image", "id", "line", "sample", "sigma_line_px", "sigma_sample_px")
#: The same for image points: others are more likely a wrong unit than a measurement.
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
        range is then not checked); None instead of the mapping if the images are unknown.
    point_ids : sequence of str or None
        Ids of the ground points; None if they are unknown (ids are then not checked).
    faults : Faults
        Receives all faults of the file.

    Returns
    -------
    ObservationFile or None
        None if anything is wrong; the reasons are then in ``faults``.
    """
    table = read_table(path, [COLUMNS], faults)
    if table is None:
        return None
    image = table.positions("image", None if sizes is None else list(sizes), "observations.image_unknown")
    point = table.positions("id", point_ids, "observations.point_unknown")
    keys = image * (int(point.max(initial=0)) + 1) + point
    pair = {"value": lambda row: f"{row.cells['id']} in {row.cells['image']}"}
    table.refuse_repeated(keys, "observations.twice", "id", **pair)
    values = table.numbers(*COLUMNS[2:])
    size = np.array([n or (np.inf, np.inf) for n in (sizes or {"": None}).values()], float)
    last = np.append(size, [[np.inf, np.inf]], axis=0)[np.minimum(image, len(size))] - 0.5
    for j, axis in enumerate(("line", "sample")):
        outside = np.isfinite(last[:, j]) & ((values[:, j] < -0.5) | (values[:, j] > last[:, j]))
        fields = {"image": lambda row: row.cells["image"], "axis": axis, "last": last[:, j]}
        table.refuse(outside, "observations.outside", axis, **fields)
        table.refuse(values[:, 2 + j] <= 0.0, "observations.sigma_not_positive", COLUMNS[4 + j])
    table.report(faults)
    if faults or sizes is None or point_ids is None:
        return None
    remarks = sigma_remarks(
        "remark.sigma_image", faults.file, values[:, 2:], PLAUSIBLE_SIGMA_PX, lambda k: table.row(k).place()
    )
    return ObservationFile(path, sha256_of(path), ImagePoints(image, point, *values.T), remarks)
