"""Ground control of MicMac and Pix4D: one text file of points and one of image points, both without header.

MicMac writes ``name X Y Z precXY precZ`` and ``name image x y``, separated by blanks. X
is longitude or easting. The files do not state the CRS. MicMac's bilinear interpolation
gives the value of a pixel at whole coordinates. Therefore it is assumed that (0, 0) is
the centre of the first pixel.

Pix4D writes ``label, coordinate 1, coordinate 2, z``. The cells ``horizontal accuracy,
vertical accuracy`` may follow. The two coordinates have the order of the CRS definition;
for EPSG:4326, latitude is first. Marks have the cells ``image, label, x, y``. A scale may
follow, which is ignored. Pixels count from the corner of the first pixel, so that its
centre is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import Separator, digits, numbers, read_rows, require_plain, row_of, sigma
from fg_orient.formats.faults import Faults
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings
from fg_orient.geodesy.crs import north_first
from fg_orient.model.names import Role


@dataclass(frozen=True)
class Layout:
    """Layout of two text files without header, for the reader and the writer.

    Parameters
    ----------
    separator : str
        Separator; see :func:`fg_orient.formats.exchange.text.cells_of`. If cells are
        separated by blanks, the writer begins a file with a comment that names the cells.
    point : sequence of str
        Cells of a point: name, three coordinates, horizontal and vertical standard deviation.
    mark : sequence of str
        Cells of an image point: ``image``, ``x``, ``y`` and the name of the point as in ``point``.
    counts : two sequences of int
        Allowed numbers of cells of a point and of an image point.
    centre_px : float
        Coordinate of the centre of the first pixel.
    in_crs_order : bool
        Coordinates have the order of the CRS definition. If False, longitude or easting is first.
    """

    separator: Separator
    point: Sequence[str]
    mark: Sequence[str]
    counts: tuple[Sequence[int], Sequence[int]]
    centre_px: float = 0.0
    in_crs_order: bool = False

    def read(self, paths: tuple[Path, ...], settings: Settings) -> Survey:
        """Read control points; also read image points if there is a second file."""
        gathered = Gathering(paths[0], settings.crs)
        faults = gathered.faults
        backwards = self.in_crs_order and north_first(gathered.crs)
        for row in read_rows(paths[0], faults, self.separator, self.point, self.counts[0]):
            first, second, height = numbers(row, self.point[1:4], faults)
            across, up = (sigma(row, column, "m", faults) for column in self.point[4:])
            xyz = (second, first, height) if backwards else (first, second, height)
            gathered.point(row.cells[self.point[0]], Role.CONTROL, xyz, (across, across, up), line=row.line)
        faults.raise_if_any()
        if len(paths) > 1:
            faults = gathered.faults = Faults(str(paths[1]))
            for row in read_rows(paths[1], faults, self.separator, self.mark, self.counts[1]):
                x, y = (value - self.centre_px for value in numbers(row, ("x", "y"), faults))
                gathered.measure(row.cells["image"], row.cells[self.point[0]], y, x, line=row.line)
        return gathered.finished()

    def write(self, survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
        """Write files that :meth:`read` can read.

        The second file is written only if there are image points.
        """
        blank, o = self.separator == "blank", survey.observed
        if blank:
            require_plain((*survey.ids, *survey.images), "name", paths[0])
        join = " ".join if blank else row_of
        order = [1, 0, 2] if self.in_crs_order and north_first(survey.crs) else [0, 1, 2]
        points, marks = ([f"# {' '.join(names)}"] * blank for names in (self.point, self.mark))
        for k in np.flatnonzero(survey.located).tolist():
            east, north, up = survey.sigma_enu_m[k].tolist()
            across = east if east == north else float(np.hypot(east, north) / np.sqrt(2.0))
            sigmas = [] if np.isnan(up) else [digits(across), digits(up)]
            points.append(join([survey.ids[k], *map(digits, survey.coordinates[k, order]), *sigmas]))
        for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
            cells = {"image": survey.images[i], self.point[0]: survey.ids[p], "x": digits(sample + self.centre_px),
                     "y": digits(line + self.centre_px)}  # fmt: skip
            marks.append(join([cells[name] for name in self.mark if name in cells]))
        write_lines(paths[0], points)
        if len(o):
            write_lines(paths[1], marks)


_MICMAC: Final = Layout(
    "blank", ("name", "X", "Y", "Z", "precXY", "precZ"), ("name", "image", "x", "y"), ((4, 6), (4,))
)
MICMAC: Final = Format(
    name="micmac",
    title="MicMac control points (two text files)",
    suffixes=(".txt",),
    files=("points", "images"),
    first_pixel=(0.0, 0.0),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=POINTS_AND_MARKS,
    needs=frozenset({Holds.HEIGHTS, Holds.SIGMA_GROUND}),
    read=_MICMAC.read,
    write=_MICMAC.write,
)
_PIX4D: Final = Layout(
    "comma", ("label", "coordinate 1", "coordinate 2", "z", "horizontal accuracy", "vertical accuracy"),
    ("image", "label", "x", "y", "scale"), ((4, 5, 6), (4, 5)), centre_px=0.5, in_crs_order=True,
)  # fmt: skip
PIX4D: Final = Format(
    name="pix4d",
    title="Pix4D ground control points and marks (CSV)",
    suffixes=(".csv",),
    files=("points", "marks"),
    first_pixel=(0.5, 0.5),
    pixel_axes="x, y (pixels)",
    ground_axes="in the order of the definition of the CRS, then height (m)",
    holds=POINTS_AND_MARKS,
    needs=frozenset({Holds.HEIGHTS}),
    read=_PIX4D.read,
    write=_PIX4D.write,
)
